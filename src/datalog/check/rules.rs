//! Checked rules: the input of planning and evaluation.
//!
//! [`load`](crate::load) makes a [`Rules`] from source text once every check has passed. It never changes
//! afterwards. Checking resolves all names, flattens expressions, aggregates and disjunctions, and writes `.scope`
//! guards as ordinary atoms. Every clause is safe: a positive atom binds each variable, or an expression computes it
//! from bound ones. In the clause of a hidden predicate a guard may bind variables too, and a correlated aggregate
//! binds parameters. The predicates are stratified.

use crate::diag::{Sources, Span, counted};
use crate::symbol::{Symbol, Symbols};
use crate::syntax::ast::{BaseType, Comparison, MarkKind};
use crate::value::Value;
use std::collections::HashMap;

use crate::check::functors::{Definition, FunctorBatch};
use crate::syntax::functor::{AggregateOp, Functor};
use std::sync::Arc;

/// The id of a type: its position in [`Rules::types`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct TypeId(pub u32);

/// A type: a base type, a declared subtype, or a union of types.
#[derive(Clone, Debug)]
pub struct Type {
    /// The name of the type.
    pub name: String,
    /// The base type of its values.
    pub base: BaseType,
    /// The declared supertype; for a union its base type; `None` for a base type.
    pub parent: Option<TypeId>,
    /// The members of a union; empty for other types.
    pub members: Vec<TypeId>,
    /// What its records look like: one shape for a record type, one for each branch of an algebraic data type; empty for
    /// other types.
    pub shapes: Vec<RecordShape>,
    /// The text of the doc comment.
    pub doc: String,
}

/// The fields of a record.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RecordShape {
    /// The name of the branch; `None` for a record type, whose values include `nil`.
    pub branch: Option<String>,
    /// The names and types of the fields.
    pub fields: Vec<(String, TypeId)>,
}

/// The type of all records; see [`Rules::types`].
pub(crate) const RECORDS: TypeId = TypeId(4);

/// Returns the shapes of the records of a type; of a subtype, those of its supertype.
pub fn shapes(types: &[Type], mut ty: TypeId) -> &[RecordShape] {
    loop {
        let Some(found) = types.get(ty.0 as usize) else {
            return &[];
        };
        match found.parent {
            Some(parent) if found.shapes.is_empty() => ty = parent,
            _ => return &found.shapes,
        }
    }
}

/// The id of a predicate: its position in [`Rules::predicates`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct PredicateId(pub u32);

impl PredicateId {
    /// Returns the position in [`Rules::predicates`].
    pub fn index(self) -> usize {
        self.0 as usize
    }
}

/// A column of a declared predicate.
#[derive(Clone, Debug)]
pub struct Column {
    /// The name of the column.
    pub name: String,
    /// The declared type.
    pub ty: TypeId,
    /// The base type of the declared type.
    pub base: BaseType,
}

/// A predicate: declared, or hidden.
///
/// The checker makes hidden ones, whose names no source can write: they begin with `+` or contain a space.
#[derive(Clone, Debug)]
pub struct Predicate {
    /// The name of the predicate.
    pub name: String,
    /// The columns; may be empty.
    pub columns: Vec<Column>,
    /// The text of the doc comment, without the slashes.
    pub doc: String,
    /// The place of the declaration.
    pub span: Span,
    /// Whether `.input` names it.
    pub input: bool,
    /// The hidden predicate for inserted rows if rules derive further ones. The last of these rules reads it.
    pub edb: Option<PredicateId>,
    /// Whether `.output` names it.
    pub output: bool,
    /// Whether `.printsize` names it.
    pub printsize: bool,
    /// Whether it is the head of a clause with a body (IDB). Facts in the text do not count.
    pub derived: bool,
    /// Whether the checker made it.
    pub hidden: bool,
    /// Whether it is declared `inline` and its clauses bind their variables.
    pub inline: bool,
    /// Whether `magic` or `.pragma "magic-transform"` names it, and no `no_magic` does.
    pub magic: bool,
    /// For the hidden predicate of a correlated aggregate: the number of leading columns that its clauses do not bind.
    /// The literals that aggregate it bind them. Such a predicate stores no rows and is in no stratum; each of
    /// these literals evaluates its clauses in place. 0 for any other predicate.
    pub parameters: usize,
    /// `choice-domain`: lists of columns. Of the rows with equal values in one of them, only one holds.
    pub choices: Vec<Vec<usize>>,
    /// The hidden predicate with the pairs of rows of which the second one makes the first one superfluous.
    pub subsumption: Option<PredicateId>,
    /// What numbers its rows, for the hidden predicate of a clause with `autoinc()`.
    pub numbering: Option<Numbering>,
    /// `.limitsize`: the number of rows after which its recursion ends.
    pub size_limit: Option<usize>,
    /// Its `.input`, `.output` and `.printsize` directives with their options.
    pub directives: Vec<Directive>,
}

/// The numbers of the solutions of a body: in the order of their values, each as many as the clause needs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Numbering {
    /// The predicate with the solutions: the columns behind the number.
    pub solutions: PredicateId,
    /// The numbers that each solution takes.
    pub each: u32,
    /// The solutions that are numbered before, with the numbers that each of them takes.
    pub before: Vec<(PredicateId, u32)>,
}

/// One `.input`, `.output` or `.printsize` directive of a predicate.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Directive {
    /// The kind of directive.
    pub kind: MarkKind,
    /// The source or destination of the rows.
    pub place: RowPlace,
    /// The encoding of the rows.
    pub encoding: RowEncoding,
    /// The text format of the rows, if they are text.
    pub format: RowFormat,
    /// Whether a file of results is compressed with gzip.
    pub compress: bool,
    /// The place of the name of the file, or of the predicate.
    pub span: Span,
}

/// The source or destination of rows.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum RowPlace {
    /// The file named after the predicate.
    Usual,
    /// `filename=`: a file.
    File(String),
    /// `IO=stdin` or `IO=stdout`: the standard streams.
    Terminal,
}

/// The encoding of rows in a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RowEncoding {
    /// Lines of text in a [`RowFormat`].
    Text,
    /// `IO=jsonfile`: a list of rows.
    Json {
        /// `format=object`: whether each row is written as an object with the names of the columns, not as a list.
        objects: bool,
    },
    /// `format=parquet`, or a name that ends with `.parquet`: a Parquet table.
    Parquet,
}

impl RowEncoding {
    /// Returns the end of the name of a file with such rows, if it is the same for inputs and outputs.
    pub fn extension(self) -> Option<&'static str> {
        match self {
            RowEncoding::Text => None,
            RowEncoding::Json { .. } => Some("json"),
            RowEncoding::Parquet => Some("parquet"),
        }
    }
}

/// The text format of rows.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RowFormat {
    /// `delimiter=`: the separator between the values of a row.
    pub delimiter: String,
    /// `headers=`: whether the first line names the columns.
    pub headers: bool,
    /// `columns=`: for each column of the predicate, the position of its value in a row of the file, from 0. If empty,
    /// rows contain exactly the columns of the predicate.
    pub columns: Vec<usize>,
    /// `rfc4180=`: whether strings stand in double quotes, with double quotes inside doubled.
    pub quoted: bool,
}

impl Default for RowFormat {
    fn default() -> Self {
        RowFormat {
            delimiter: "\t".to_owned(),
            headers: false,
            columns: Vec::new(),
            quoted: false,
        }
    }
}

impl Predicate {
    /// Creates a hidden predicate, which clauses made by the checker or planner derive.
    pub(crate) fn made(name: String, columns: Vec<Column>, doc: String, span: Span) -> Self {
        Predicate {
            name,
            columns,
            doc,
            span,
            input: false,
            edb: None,
            output: false,
            printsize: false,
            derived: true,
            hidden: true,
            inline: false,
            magic: false,
            parameters: 0,
            choices: Vec::new(),
            subsumption: None,
            numbering: None,
            size_limit: None,
            directives: Vec::new(),
        }
    }

    /// Returns whether the rounds in which rows are derived determine which rows hold.
    pub(crate) fn depends_on_rounds(&self) -> bool {
        let decides = !self.choices.is_empty() || self.subsumption.is_some();
        decides || self.numbering.is_some() || self.size_limit.is_some()
    }

    /// Returns what messages call it: its name, or what it stands for if its name is only a number.
    pub fn title(&self) -> &str {
        match self.is_numbered() {
            true => &self.doc,
            false => &self.name,
        }
    }

    /// Returns whether it is hidden, and its name only a number.
    pub(crate) fn is_numbered(&self) -> bool {
        self.hidden && self.name.starts_with('+')
    }

    /// Returns the number of columns.
    pub fn arity(&self) -> usize {
        self.columns.len()
    }

    /// Returns the position of each column among the columns of a table: by name if the names are the same, and
    /// otherwise in order.
    ///
    /// # Errors
    /// If the number of columns differs, or if the name of a column stands at another position.
    pub fn positions_in(&self, table: &[&str]) -> Result<Vec<usize>, String> {
        let places = self.columns.iter();
        let places: Vec<Option<usize>> = places
            .map(|column| table.iter().position(|name| *name == column.name))
            .collect();
        if let (true, Some(named)) = (table.len() == self.arity(), places.iter().copied().collect()) {
            return Ok(named);
        }
        let in_order = (0..)
            .zip(&places)
            .all(|(at, place)| place.is_none_or(|place| place == at));
        if table.len() == self.arity() && in_order {
            return Ok((0..self.arity()).collect());
        }
        let wanted: Vec<&str> = self.columns.iter().map(|column| column.name.as_str()).collect();
        let (wanted, name, found) = (wanted.join(", "), &self.name, table.join(", "));
        Err(format!("expected the columns [{wanted}] of `{name}`, not [{found}]"))
    }
}

/// The id of a variable of one clause: its position in [`Clause::variables`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct VarId(pub u32);

impl VarId {
    /// Returns the position in [`Clause::variables`].
    pub fn index(self) -> usize {
        self.0 as usize
    }
}

/// An argument or operand.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Term {
    /// A variable of the clause.
    Variable(VarId),
    /// A constant of the column's type.
    Constant(Value),
    /// `_`: any value. Occurs in body atoms only. A negated atom quantifies it inside: `!P(x, _)` holds if no row of
    /// `P` begins with x.
    Wildcard,
}

impl Term {
    /// Returns the variable, if it is one.
    pub fn variable(&self) -> Option<VarId> {
        match self {
            Term::Variable(id) => Some(*id),
            Term::Constant(_) | Term::Wildcard => None,
        }
    }
}

/// A predicate applied to arguments.
#[derive(Clone, Debug)]
pub struct Atom {
    /// The predicate.
    pub predicate: PredicateId,
    /// One term for each column.
    pub terms: Vec<Term>,
    /// The place in the source.
    pub span: Span,
}

/// A literal of a body.
#[derive(Clone, Debug)]
pub enum Literal {
    /// The atom holds.
    Positive(Atom),
    /// The atom does not hold. Its predicate is in a lower stratum.
    Negative(Atom),
    /// A comparison of variables or constants of the same base type. Symbols compare by their text, character by
    /// character.
    ///
    /// An `=` with one bound side binds the other side. So a chain of equalities that starts at a constant or at a
    /// bound variable binds variables.
    Compare {
        /// The operator.
        op: Comparison,
        /// Left side.
        left: Term,
        /// Right side.
        right: Term,
        /// The base type of both sides.
        base: BaseType,
        /// The place in the source.
        span: Span,
    },
    /// `to` equals the value of the functor; if there is none, the literal does not hold.
    ///
    /// The arguments are variables or constants. Once all of them are bound, the literal binds `to`.
    Compute {
        /// The result; a variable.
        to: Term,
        /// The functor.
        functor: Functor,
        /// The base type of the first argument, which selects the operation.
        base: BaseType,
        /// The arguments.
        arguments: Vec<Term>,
        /// The place in the source.
        span: Span,
    },
    /// `to` equals the aggregate over the rows that match the atom; if it has no value, the literal does not hold.
    ///
    /// The predicate of the atom is in a lower stratum. Once all variables of the atom are bound, the literal binds
    /// `to`.
    Aggregate {
        /// The result; a variable.
        to: Term,
        /// The aggregate function.
        op: AggregateOp,
        /// The base type of the values.
        base: BaseType,
        /// The pattern of the rows.
        atom: Atom,
        /// The column of the values; `None` for `count`.
        column: Option<usize>,
    },
    /// A `.scope` guard: like `Positive`, but added by the checker.
    Guard(Atom),
}

/// A literal that reads a field of a record.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Field {
    pub(crate) record: Term,
    /// The symbol of the shape that the record must have.
    pub(crate) shape: Symbol,
    /// The position of the field.
    pub(crate) at: usize,
    pub(crate) value: Term,
}

impl Literal {
    /// Returns the field that the literal reads, if it reads one.
    pub(crate) fn field(&self) -> Option<Field> {
        let Literal::Compute {
            to,
            functor: Functor::Unpack,
            arguments,
            ..
        } = self
        else {
            return None;
        };
        match arguments[..] {
            [Term::Constant(shape), Term::Constant(at), record] => Some(Field {
                record,
                shape: Symbol(shape.0),
                at: at.0 as usize,
                value: *to,
            }),
            _ => None,
        }
    }

    /// Returns the atom of the literal, if it has one.
    pub fn atom(&self) -> Option<&Atom> {
        match self {
            Literal::Positive(atom)
            | Literal::Negative(atom)
            | Literal::Guard(atom)
            | Literal::Aggregate { atom, .. } => Some(atom),
            Literal::Compare { .. } | Literal::Compute { .. } => None,
        }
    }

    /// Returns the variables, constants and wildcards of the literal.
    pub fn terms(&self) -> impl Iterator<Item = &Term> {
        let (list, further): (&[Term], [Option<&Term>; 2]) = match self {
            Literal::Positive(atom) | Literal::Negative(atom) | Literal::Guard(atom) => (&atom.terms, [None; 2]),
            Literal::Compare { left, right, .. } => (&[], [Some(left), Some(right)]),
            Literal::Compute { to, arguments, .. } => (arguments, [Some(to), None]),
            Literal::Aggregate { to, atom, .. } => (&atom.terms, [Some(to), None]),
        };
        list.iter().chain(further.into_iter().flatten())
    }

    /// Returns the variables of the literal, each as often as it occurs.
    pub fn variables(&self) -> impl Iterator<Item = VarId> {
        self.terms().filter_map(Term::variable)
    }

    /// Returns the variables that the literal binds if it holds; `None` while it needs further bound variables.
    pub(crate) fn binds(&self, bound: &[bool]) -> Option<Vec<VarId>> {
        let known = |term: &Term| term.variable().is_none_or(|variable| bound[variable.index()]);
        let variables = |terms: &[Term]| terms.iter().filter_map(Term::variable).collect();
        match self {
            Literal::Positive(atom) | Literal::Guard(atom) => Some(variables(&atom.terms)),
            Literal::Negative(atom) => atom.terms.iter().all(known).then(Vec::new),
            Literal::Compare { op, left, right, .. } => match (known(left), known(right)) {
                (true, true) => Some(Vec::new()),
                (false, false) => None,
                _ if *op == Comparison::Equal => Some(variables(&[*left, *right])),
                _ => None,
            },
            Literal::Compute { to, arguments, .. } => arguments.iter().all(known).then(|| variables(&[*to])),
            Literal::Aggregate { to, atom, .. } => atom.terms.iter().all(known).then(|| variables(&[*to])),
        }
    }

    /// Mutable variant of `terms`.
    pub(crate) fn terms_mut(&mut self) -> impl Iterator<Item = &mut Term> {
        let (list, further): (&mut [Term], [Option<&mut Term>; 2]) = match self {
            Literal::Positive(atom) | Literal::Negative(atom) | Literal::Guard(atom) => (&mut atom.terms, [None, None]),
            Literal::Compare { left, right, .. } => (&mut [], [Some(left), Some(right)]),
            Literal::Compute { to, arguments, .. } => (arguments, [Some(to), None]),
            Literal::Aggregate { to, atom, .. } => (&mut atom.terms, [Some(to), None]),
        };
        list.iter_mut().chain(further.into_iter().flatten())
    }
}

/// Binds the variables that these literals bind, in any order. Returns whether none of them lacks a variable then.
pub(crate) fn bind_all<'l>(literals: impl Iterator<Item = &'l Literal>, bound: &mut [bool]) -> bool {
    let mut waiting: Vec<&Literal> = literals.collect();
    loop {
        let before = waiting.len();
        waiting.retain(|literal| match literal.binds(bound) {
            Some(variables) => {
                variables
                    .into_iter()
                    .for_each(|variable| bound[variable.index()] = true);
                false
            }
            None => true,
        });
        if waiting.len() == before {
            return waiting.is_empty();
        }
    }
}

/// The id of a clause: its position in [`Rules::clauses`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ClauseId(pub u32);

impl ClauseId {
    /// Returns the position in [`Rules::clauses`].
    pub fn index(self) -> usize {
        self.0 as usize
    }
}

/// A clause. A clause without a body is a fact; all its terms are constants.
#[derive(Clone, Debug)]
pub struct Clause {
    /// The head.
    pub head: Atom,
    /// The body: a conjunction.
    pub body: Vec<Literal>,
    /// The names of the variables, for messages.
    pub variables: Vec<String>,
    /// For each variable, the place where it first occurs; the whole clause for one that the checker added.
    pub variable_spans: Vec<Span>,
    /// The text of the doc comment before the clause, without the slashes.
    pub doc: String,
    /// The place in the source, from the head to the full stop.
    pub span: Span,
}

/// An integrity constraint on the facts of base predicates. The author declares it; no rule implies it.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub enum Constraint {
    /// No row is in both predicates. With one predicate twice, that has no rows.
    Disjoint(PredicateId, PredicateId),
    /// Every row of the first predicate is in the second one.
    Implies(PredicateId, PredicateId),
    /// Every value of the domain is in one of the predicates.
    Covering(Vec<PredicateId>),
    /// Every value of the domain is related to itself.
    Reflexive(PredicateId),
    /// No row relates a value to itself.
    Irreflexive(PredicateId),
    /// With every row the reversed row holds too.
    Symmetric(PredicateId),
    /// A row and its reversed row never both hold, so no row relates a value to itself.
    Asymmetric(PredicateId),
}

impl Constraint {
    /// Returns the predicates that the constraint names.
    pub fn predicates(&self) -> impl Iterator<Item = PredicateId> {
        let (listed, single): (&[PredicateId], &[PredicateId]) = match self {
            Constraint::Disjoint(a, b) | Constraint::Implies(a, b) => {
                (std::slice::from_ref(a), std::slice::from_ref(b))
            }
            Constraint::Covering(predicates) => (predicates, &[]),
            Constraint::Reflexive(a)
            | Constraint::Irreflexive(a)
            | Constraint::Symmetric(a)
            | Constraint::Asymmetric(a) => (&[], std::slice::from_ref(a)),
        };
        listed.iter().chain(single).copied()
    }

    /// Returns the directive that declares the constraint, in backquotes.
    pub fn show(&self, rules: &Rules) -> String {
        let kind = match self {
            Constraint::Disjoint(a, b) if a == b => {
                return format!("that `{}` has no rows", rules.predicates[a.index()].name);
            }
            Constraint::Disjoint(..) => "disjoint",
            Constraint::Implies(..) => "implies",
            Constraint::Covering(_) => "covering",
            Constraint::Reflexive(_) => "reflexive",
            Constraint::Irreflexive(_) => "irreflexive",
            Constraint::Symmetric(_) => "symmetric",
            Constraint::Asymmetric(_) => "asymmetric",
        };
        let names: Vec<&str> = (self.predicates())
            .map(|predicate| rules.predicates[predicate.index()].name.as_str())
            .collect();
        format!("`.{kind} {}`", names.join(", "))
    }
}

/// A constraint with its domain and its place.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DeclaredConstraint {
    /// The constraint.
    pub constraint: Constraint,
    /// The columns whose values are the domain of a covering or reflexive constraint: those of visible predicates
    /// without rules that have the type of the constraint's predicates or a subtype of it. Empty for other constraints.
    pub domain: Vec<(PredicateId, usize)>,
    /// The place of the directive, or of what the constraint follows from.
    pub span: Span,
    /// Whether the caller inferred the constraint from what is at the place instead of reading a directive.
    pub inferred: bool,
}

impl DeclaredConstraint {
    /// Returns the constraint with its place: `` `.implies IsTaxi, IsCar` at taxi.dl:5:1 ``.
    pub fn show(&self, rules: &Rules, sources: &Sources) -> String {
        let constraint = self.constraint.show(rules);
        let place = sources.locate(self.span);
        match self.inferred {
            true => format!("{constraint}, which follows from {place}"),
            false => format!("{constraint} at {place}"),
        }
    }
}

/// A stratum: predicates that evaluation computes together, after everything they negate or aggregate.
#[derive(Clone, Debug)]
pub struct Stratum {
    /// The predicates, each with at least one clause.
    pub predicates: Vec<PredicateId>,
    /// All clauses, including facts, with these heads, in source order.
    pub clauses: Vec<ClauseId>,
    /// Whether a body of the stratum uses a predicate of the stratum.
    pub recursive: bool,
}

/// Checked rules.
#[derive(Clone, Debug)]
pub struct Rules {
    /// The types; the base types come first, in the order of [`BaseType::ALL`], then the type of all records.
    pub types: Vec<Type>,
    /// The predicates in the order of declaration, hidden ones last.
    pub predicates: Vec<Predicate>,
    /// The clauses in source order, those of hidden predicates last.
    pub clauses: Vec<Clause>,
    /// The strata: strongly connected components of the predicates with clauses, in topological order. Predicates with
    /// [parameters](Predicate::parameters) are in none.
    pub strata: Vec<Stratum>,
    /// The declared integrity constraints, in source order.
    pub constraints: Vec<DeclaredConstraint>,
    /// What the caller knows of base predicates with values. Loading leaves it empty; comparisons of rules read it.
    pub functions: Vec<Function>,
    /// The functors that the caller defines.
    pub functors: Arc<[UserFunctor]>,
    /// The symbols of all constants.
    pub symbols: Symbols,
    /// The memory of earlier ticks that temporal operators read.
    pub pasts: Vec<Past>,
    /// The hidden predicate that draws read, if clauses have probabilities. Its row is the word of the tick.
    pub chance: Option<PredicateId>,
}

/// A functor that `.functor` declares and the caller defines.
#[derive(Clone, Debug)]
pub struct UserFunctor {
    /// The name, without `@`.
    pub name: String,
    /// The arguments.
    pub arguments: Vec<Column>,
    /// The type of the value.
    pub result: TypeId,
    /// The base type of the value.
    pub base: BaseType,
    /// The text of the doc comment.
    pub doc: String,
    /// The place of the name in the declaration.
    pub span: Span,
    /// What computes the values; `None` until [`Program::define`](crate::Program::define) gives it.
    pub(crate) definition: Option<Definition>,
}

impl UserFunctor {
    /// Sets what computes the values.
    pub(crate) fn define(
        &mut self,
        apply: impl Fn(&FunctorBatch<'_>, &mut Vec<Option<Value>>) -> Result<(), String> + Send + Sync + 'static,
    ) {
        self.definition = Some(Definition(Arc::new(apply)));
    }

    /// Returns the functor with the definition that one of its name has.
    pub(crate) fn defined_as(mut self, functors: &[UserFunctor]) -> UserFunctor {
        let same = functors.iter().find(|functor| functor.name == self.name);
        self.definition = same.and_then(|functor| functor.definition.clone());
        self
    }

    /// Returns whether it has a definition.
    pub fn is_defined(&self) -> bool {
        self.definition.is_some()
    }

    /// Computes the values for `count` rows of arguments, in row-major order.
    pub(crate) fn apply(
        &self,
        (rows, count): (&[Value], usize),
        symbols: &Symbols,
        values: &mut Vec<Option<Value>>,
    ) -> Result<(), String> {
        let missing = || format!("the functor `{}` has no definition", self.name);
        let definition = self.definition.as_ref().ok_or_else(missing)?;
        values.clear();
        let batch = FunctorBatch::new(rows, (count, self.arguments.len()), symbols);
        (definition.0)(&batch, values)?;
        if values.len() != count {
            let (values, calls) = (counted(values.len(), "value"), counted(count, "call"));
            return Err(format!("{values} for {calls}"));
        }
        let known = |value: &Value| (value.0 as usize) < symbols.len();
        match matches!(self.base, BaseType::Symbol | BaseType::Record) && !values.iter().flatten().all(known) {
            true => Err("a value is no symbol of this session".to_owned()),
            false => Ok(()),
        }
    }
}

/// A base predicate whose last column is a function of the others.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Function {
    /// The predicate.
    pub predicate: PredicateId,
    /// The symbols in the range of the function, which name no entity; `None` if the last column has numbers.
    pub symbols: Option<Vec<String>>,
}

/// A hidden predicate whose rows follow from earlier ticks. Before the first tick, no row of any predicate held.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Past {
    /// The hidden predicate. No clause derives it.
    pub predicate: PredicateId,
    /// The predicate that the operator is about, with the same columns.
    pub operand: PredicateId,
    /// What must have held.
    pub operator: PastOperator,
    /// The tick nearest to the present in the window: the number of ticks before the present, at least 1.
    pub first: u32,
    /// The farthest tick of the window, in the same way; `None` for all earlier ticks.
    pub last: Option<u32>,
}

/// What must have held in a [`Past`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum PastOperator {
    /// The row held in some tick of the window.
    Once,
    /// The row held in all ticks of the window.
    Always,
    /// The row held in some tick of the window, and a row of this predicate in all ticks between that one and the
    /// present. That row has the values of these columns.
    Since(PredicateId, Vec<usize>),
}

impl Past {
    /// Returns the predicates of earlier ticks that the rows follow from: that before `since`, and the operand.
    pub fn operands(&self) -> impl Iterator<Item = PredicateId> {
        let held = match self.operator {
            PastOperator::Since(held, _) => Some(held),
            PastOperator::Once | PastOperator::Always => None,
        };
        held.into_iter().chain([self.operand])
    }
}

impl Rules {
    /// Returns the predicate with that name, if there is one.
    pub fn predicate(&self, name: &str) -> Option<PredicateId> {
        let index = self.predicates.iter().position(|predicate| predicate.name == name)?;
        Some(PredicateId(u32::try_from(index).expect("fewer than 2^32 predicates")))
    }

    /// Returns a predicate that temporal operators read and whose rows depend on draws.
    pub fn drawn_operand(&self) -> Option<PredicateId> {
        let chance = self.chance?;
        let mut operands = self.pasts.iter().flat_map(Past::operands);
        operands.find(|operand| self.depends_on(*operand, chance))
    }

    /// Returns whether the rows of a predicate depend on those of another, through any number of clauses.
    pub fn depends_on(&self, predicate: PredicateId, other: PredicateId) -> bool {
        self.dependencies([predicate])[other.index()]
    }

    /// Returns, by predicate, whether the rows of the given predicates depend on its rows in the same tick, through any
    /// number of clauses. Each given predicate depends on itself.
    pub fn dependencies(&self, predicates: impl IntoIterator<Item = PredicateId>) -> Vec<bool> {
        let by_head = self.clauses_by_head();
        let mut found = vec![false; self.predicates.len()];
        let mut open: Vec<PredicateId> = predicates.into_iter().collect();
        while let Some(predicate) = open.pop() {
            if !std::mem::replace(&mut found[predicate.index()], true) {
                open.extend(by_head[predicate.index()].iter().flat_map(|clause| self.reads(clause)));
            }
        }
        found
    }

    /// Returns the rules of a single tick: what they read of earlier ticks is input, and so are draws.
    pub fn of_one_tick(&self) -> Rules {
        let mut rules = self.with_draws_as_facts();
        for past in rules.pasts.drain(..) {
            rules.predicates[past.predicate.index()].input = true;
        }
        rules
    }

    /// Returns the base types of the variables of a clause.
    pub(crate) fn bases(&self, clause: &Clause) -> Vec<BaseType> {
        let mut bases = vec![BaseType::Symbol; clause.variables.len()];
        let mut see = |term: &Term, base: BaseType| {
            if let Term::Variable(variable) = term {
                bases[variable.index()] = base;
            }
        };
        for literal in &clause.body {
            match literal {
                Literal::Positive(atom) | Literal::Negative(atom) | Literal::Guard(atom) => {
                    let columns = &self.predicates[atom.predicate.index()].columns;
                    (atom.terms.iter().zip(columns)).for_each(|(term, column)| see(term, column.base));
                }
                Literal::Compare { left, right, base, .. } => {
                    see(left, *base);
                    see(right, *base);
                }
                Literal::Compute {
                    to,
                    functor,
                    base,
                    arguments,
                    ..
                } => {
                    for (at, argument) in arguments.iter().enumerate() {
                        let base = self.argument_base(*functor, *base, arguments, at);
                        base.into_iter().for_each(|base| see(argument, base));
                    }
                    functor.result_base(*base).into_iter().for_each(|base| see(to, base));
                }
                Literal::Aggregate { to, op, base, atom, .. } => {
                    let columns = &self.predicates[atom.predicate.index()].columns;
                    (atom.terms.iter().zip(columns)).for_each(|(term, column)| see(term, column.base));
                    see(to, op.result_base(*base));
                }
            }
        }
        let columns = &self.predicates[clause.head.predicate.index()].columns;
        (clause.head.terms.iter().zip(columns)).for_each(|(term, column)| see(term, column.base));
        bases
    }

    /// Returns the base type of an argument of a functor; `None` if it may have any.
    pub(crate) fn argument_base(
        &self,
        functor: Functor,
        base: BaseType,
        arguments: &[Term],
        at: usize,
    ) -> Option<BaseType> {
        match (functor, at) {
            (Functor::Call, 0) => Some(BaseType::Unsigned),
            (Functor::Call, _) => Some(self.called(arguments)?.arguments.get(at - 1)?.base),
            _ => functor.argument_base(base, at),
        }
    }

    /// Returns the value of [`Functor::Call`]; `None` if it has none.
    pub(crate) fn call(&self, arguments: &[Value], symbols: &Symbols) -> Result<Option<Value>, String> {
        let functor = arguments.first().and_then(|at| self.functors.get(at.0 as usize));
        let functor = functor.ok_or("no such functor")?;
        let mut values = Vec::new();
        functor.apply((&arguments[1..], 1), symbols, &mut values)?;
        Ok(values.pop().flatten())
    }

    /// Returns the functor that these arguments of [`Functor::Call`] name.
    pub(crate) fn called(&self, arguments: &[Term]) -> Option<&UserFunctor> {
        match arguments.first() {
            Some(Term::Constant(at)) => self.functors.get(at.0 as usize),
            _ => None,
        }
    }

    /// Returns whether the predicate has [parameters](Predicate::parameters).
    pub(crate) fn is_correlated(&self, predicate: PredicateId) -> bool {
        let predicate = self.predicates.get(predicate.index());
        predicate.is_some_and(|predicate| predicate.parameters > 0)
    }

    /// Returns the predicates on whose rows those of a clause depend directly, with repetitions: its atoms, and what is
    /// numbered before it.
    pub(crate) fn reads<'r>(&'r self, clause: &'r Clause) -> impl Iterator<Item = PredicateId> + use<'r> {
        let numbering = self.predicates[clause.head.predicate.index()].numbering.as_ref();
        let before = numbering.into_iter().flat_map(|numbering| &numbering.before);
        let atoms = clause.body.iter().filter_map(Literal::atom);
        atoms.map(|atom| atom.predicate).chain(before.map(|(of, _)| *of))
    }

    /// Returns the predicates that the bodies of clauses read, with repetitions, and the
    /// [correlated](Rules::is_correlated) ones, sorted. The former include what the clauses of the latter read.
    pub(crate) fn read_by(&self, clauses: impl IntoIterator<Item = ClauseId>) -> (Vec<PredicateId>, Vec<PredicateId>) {
        let clauses = clauses.into_iter().map(|id| &self.clauses[id.index()]);
        let mut read: Vec<PredicateId> = clauses.flat_map(|clause| self.reads(clause)).collect();
        let mut correlated = Vec::new();
        let mut position = 0;
        while let Some(&predicate) = read.get(position) {
            if !self.is_correlated(predicate) {
                position += 1;
                continue;
            }
            read.remove(position);
            if !correlated.contains(&predicate) {
                correlated.push(predicate);
                let clauses = self.clauses.iter().filter(|clause| clause.head.predicate == predicate);
                read.extend(clauses.flat_map(|clause| self.reads(clause)));
            }
        }
        correlated.sort_unstable();
        (read, correlated)
    }

    /// Returns the clauses of each predicate, for many lookups.
    pub(crate) fn clauses_by_head(&self) -> Vec<Vec<&Clause>> {
        let mut by_head = vec![Vec::new(); self.predicates.len()];
        for clause in &self.clauses {
            by_head[clause.head.predicate.index()].push(clause);
        }
        by_head
    }

    /// Returns whether the clause is a fact that is a row from the start: no clause with a body derives its predicate.
    pub(crate) fn is_row(&self, clause: &Clause) -> bool {
        clause.body.is_empty() && !self.predicates[clause.head.predicate.index()].derived
    }

    /// Returns the columns of base predicates with a type or one of its subtypes, except unions; see
    /// [`DeclaredConstraint::domain`].
    pub fn columns_of(&self, ty: TypeId) -> Vec<(PredicateId, usize)> {
        let parent = |id: &TypeId| self.types[id.0 as usize].parent;
        let within = |column: &Column| std::iter::successors(Some(column.ty), parent).any(|id| id == ty);
        let base =
            (self.predicates.iter().zip((0..).map(PredicateId))).filter(|(known, _)| !known.derived && !known.hidden);
        base.flat_map(|(known, id)| {
            let columns = known.columns.iter().enumerate().filter(|(_, column)| within(column));
            columns.map(move |(column, _)| (id, column))
        })
        .collect()
    }

    /// Returns all predicates by name, for many lookups.
    pub fn predicates_by_name(&self) -> HashMap<&str, PredicateId> {
        let names = self.predicates.iter().map(|predicate| predicate.name.as_str());
        names.zip((0..).map(PredicateId)).collect()
    }
}
