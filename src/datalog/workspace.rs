//! Editable programs: sources that grow and shrink, and queries over their predicates.
//!
//! ```text
//! ?- Path(x, y), y > 3.    becomes    .decl ?-(x: number, y: number)    ?-(x, y) :- Path(x, y), y > 3.
//! ```
//!
//! `check` treats a query as a separate program in which every declared predicate is input. So a query re-checks no
//! clause of the program, and its body may use everything that a clause body may use.

use std::borrow::Cow;
use std::collections::{HashMap, HashSet};

use crate::codes;
use crate::diag::{Diagnostic, Faults, SourceId, Sources, Span};
use crate::files::ReadFile;
use crate::symbol::{Symbol, Symbols, WordSize};

use crate::check::clause;
use crate::check::witness::{renamed, renamed_term};
use crate::check::{self as rules, Comparing, PredicateId, Rules, TypeId, VarId};
use crate::check::{Elsewhere, InputPolicy, Policy, check, inline, names, temporal};
use crate::component::Instances;
use crate::eqrel;
use crate::record;
use crate::syntax::Preprocessing;
use crate::syntax::ast::{Atom, Clause, ColumnDecl, Decl, Item, Literal, Mark, MarkKind, Name, Place, Term, TermKind};
use crate::syntax::ast::{BaseType, Comparison, TypeDefinition};
use crate::syntax::ast::{names_in, names_of};
use crate::syntax::include;
use crate::syntax::include::Gathered;
use crate::syntax::lexer;
use crate::syntax::lexer::Kind;
use crate::syntax::packed::FactRuns;
use crate::syntax::parser;
use crate::value::Value;

/// The predicate that holds the answers of a query.
const ANSWER: &str = "?-";

/// The result of [`load`].
#[derive(Clone, Debug)]
pub struct Loaded {
    /// The rules; `None` if a diagnostic is an error.
    pub rules: Option<Rules>,
    /// Errors and warnings of all files, in source order.
    pub diagnostics: Vec<Diagnostic>,
    /// The work of the search for subsumed clauses.
    pub compared: Comparing,
}

impl Loaded {
    /// A failed load with these diagnostics.
    fn failed(diagnostics: Vec<Diagnostic>) -> Self {
        Loaded {
            rules: None,
            diagnostics,
            compared: Comparing::default(),
        }
    }
}

/// Reads and checks the rules of the source `entry` and of all files it includes.
///
/// For `.include "x"`, `read` first looks for `x` in the folder of the including source, whose path is its name in
/// `sources`. If that file does not exist, `read` looks for [`BUILTIN_FOLDER`](crate::files::BUILTIN_FOLDER)`/x`, where
/// the caller may serve rule files. `load` adds the included files to `sources`.
pub fn load(sources: &mut Sources, entry: SourceId, read: &dyn ReadFile) -> Loaded {
    load_with(sources, entry, read, InputPolicy::Fixed)
}

/// Loads as [`load`] does; `inputs` determines whether rules may derive `.input` predicates.
pub fn load_with(sources: &mut Sources, entry: SourceId, read: &dyn ReadFile, inputs: InputPolicy) -> Loaded {
    let mut workspace = Workspace::new(inputs);
    workspace.add(sources, entry, read);
    workspace.into_checked()
}

/// A declared predicate; see [`Workspace::declared`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Declaration {
    /// The name.
    pub name: String,
    /// The place of the name.
    pub span: Span,
    /// The base types of the columns; `None` for an unknown type.
    pub columns: Vec<Option<BaseType>>,
    /// Whether it is input.
    pub input: bool,
}

/// The parsed sources of a program, which can grow and shrink between checks.
#[derive(Clone, Debug, Default)]
pub struct Workspace {
    gathered: Gathered,
    policy: Policy,
    preprocessing: Preprocessing,
    instances: Instances,
    /// The number of declarations of equivalence relations whose clauses are there.
    equivalences: usize,
    faults: Faults,
}

/// A fact with wildcards: a value or `_` for each column.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FactPattern {
    /// The predicate.
    pub predicate: PredicateId,
    /// The values by column; `None` for `_`.
    pub values: Vec<Option<Value>>,
}

/// A predicate and one of its rows.
pub type FactRow = (PredicateId, Vec<Value>);

impl Workspace {
    /// The name of the answer predicate in the rules that [`Workspace::ask`] returns.
    pub const ANSWER: &str = ANSWER;

    /// Creates an empty workspace.
    pub fn new(inputs: InputPolicy) -> Self {
        let policy = Policy {
            inputs,
            ..Policy::default()
        };
        Workspace {
            policy,
            ..Workspace::default()
        }
    }

    /// Parses the source `entry` and all files it includes, as [`load`](crate::workspace::load) does.
    ///
    /// Skips files that the workspace already contains.
    pub fn add(&mut self, sources: &mut Sources, entry: SourceId, read: &dyn ReadFile) {
        include::gather(
            &mut self.gathered,
            sources,
            entry,
            read,
            &self.preprocessing,
            &mut self.faults,
        );
        let made = (self.instances).next(&self.gathered.items, sources, &mut self.faults);
        self.gathered.items.extend(made);
        let closed = eqrel::clauses(&self.gathered.items, &mut self.equivalences, &mut self.faults);
        self.gathered.items.extend(closed);
        if !read.builtin_paths().is_empty() && lacks_declaration(&self.gathered) {
            self.gathered.offered = include::offered(read);
        }
        // The checker replaces inline predicates and temporal operators in syntax trees.
        if self.uses_inline() || self.gathered.items.iter().any(temporal::in_item) {
            self.gathered.facts.unpack(&mut self.gathered.items);
        }
    }

    /// Sets whether rules may derive `.input` predicates.
    pub fn set_inputs(&mut self, inputs: InputPolicy) {
        self.policy.inputs = inputs;
    }

    /// Sets the size of numbers: 64 bits for programs that Soufflé compiles with `SOUFFLE_DOMAIN_64BIT`. Such programs have
    /// no draws and no temporal operators. Call it before adding sources.
    pub fn set_word_size(&mut self, size: WordSize) {
        self.policy.word_size = size;
        self.preprocessing.word_size = size;
    }

    /// Sets whether the program is in the types of Soufflé's option `--legacy`: a head takes values of any type with the
    /// base type of its column. Forms of older versions then cause no warning.
    pub fn set_legacy(&mut self, legacy: bool) {
        self.policy.legacy = legacy;
    }

    /// Sets how the sources that are added from now on are preprocessed, and the folders of the files they include.
    pub fn set_preprocessing(&mut self, preprocessing: Preprocessing) {
        self.preprocessing = preprocessing;
        self.preprocessing.word_size = self.policy.word_size;
    }

    /// Returns whether a predicate of this name is declared.
    pub fn declares(&self, name: &str) -> bool {
        let mut items = self.gathered.items.iter();
        items.any(|item| matches!(item, Item::Decl(decl) if decl.names.iter().any(|found| found.text == name)))
    }

    /// Returns the declarations of predicates, also of a program with faults.
    pub fn declared(&self) -> Vec<Declaration> {
        let items = &self.gathered.items;
        let mut types: HashMap<&str, &TypeDefinition> = HashMap::new();
        for item in items {
            if let Item::Type(decl) = item {
                types.insert(&decl.name.text, &decl.definition);
            }
        }
        let base = |ty: &Name| {
            let mut name = ty.text.as_str();
            // A cycle of types has no base type.
            for _ in 0..=types.len() {
                if let Some(base) = BaseType::ALL.into_iter().find(|base| base.name() == name) {
                    return Some(base);
                }
                name = match types.get(name)? {
                    TypeDefinition::Subtype(parent) | TypeDefinition::Alias(parent) => &parent.text,
                    TypeDefinition::Union(members) => &members.first()?.text,
                    TypeDefinition::Record(_) | TypeDefinition::Branches(_) => return Some(BaseType::Record),
                    TypeDefinition::Faulty => return None,
                };
            }
            None
        };
        let inputs: HashSet<&str> = (items.iter())
            .filter_map(|item| match item {
                Item::Mark(mark) if mark.kind == MarkKind::Input => Some(&mark.names),
                _ => None,
            })
            .flatten()
            .map(|name| name.text.as_str())
            .collect();
        let declarations = items.iter().filter_map(|item| match item {
            Item::Decl(decl) => Some((&decl.names, decl.columns.as_ref()?)),
            _ => None,
        });
        let all = declarations.flat_map(|(names, columns)| {
            names.iter().map(|name| Declaration {
                name: name.text.clone(),
                span: name.place.0,
                columns: columns.iter().map(|column| base(&column.ty)).collect(),
                input: inputs.contains(name.text.as_str()),
            })
        });
        all.collect()
    }

    /// Checks the program as a whole. `rules` is `None` if any diagnostic is an error.
    pub fn check(&self) -> Loaded {
        let items = Cow::Borrowed(&self.gathered.items[..]);
        self.checked(items, Cow::Borrowed(&self.gathered.facts), self.faults.clone())
    }

    /// Checks the program as [`check`](Workspace::check) does, and frees the syntax trees as early as possible.
    pub fn into_checked(mut self) -> Loaded {
        let (items, facts, faults) = (
            std::mem::take(&mut self.gathered.items),
            std::mem::take(&mut self.gathered.facts),
            std::mem::take(&mut self.faults),
        );
        self.checked(Cow::Owned(items), Cow::Owned(facts), faults)
    }

    fn checked(&self, items: Cow<'_, [Item]>, facts: Cow<'_, FactRuns>, mut faults: Faults) -> Loaded {
        let elsewhere = Elsewhere {
            complete: !(self.gathered.incomplete || self.instances.incomplete),
            offered: &self.gathered.offered,
        };
        let (rules, compared) = check(
            (items, facts),
            elsewhere,
            self.policy,
            Symbols::of_words(self.policy.word_size),
            &mut faults,
        );
        let mut diagnostics = faults.finish();
        if self.policy.legacy {
            diagnostics.retain(|fault| fault.code != codes::OLD_FORM);
        }
        Loaded {
            rules,
            diagnostics,
            compared,
        }
    }

    /// Returns the places of the heads of every clause that equals `clause` up to variable names and comments.
    pub fn find(&self, clause: &Clause) -> Vec<Span> {
        let wanted = canonical(clause);
        let written = self.gathered.items.iter().filter_map(|item| match item {
            Item::Clause(clause) => Some(Cow::Borrowed(clause)),
            _ => None,
        });
        let packed = self.gathered.facts.clauses().map(Cow::Owned);
        let mut places = Vec::new();
        for clause in written.chain(packed).filter(|clause| canonical(clause) == wanted) {
            places.extend(clause.heads.iter().map(|head| head.place.0));
        }
        places
    }

    /// Removes the heads at these places, and every clause that loses its last head.
    pub fn remove_heads(&mut self, places: &HashSet<Span>) {
        self.gathered.facts.unpack(&mut self.gathered.items);
        for item in &mut self.gathered.items {
            if let Item::Clause(clause) = item {
                clause.heads.retain(|head| !places.contains(&head.place.0));
            }
        }
        (self.gathered.items).retain(|item| !matches!(item, Item::Clause(clause) if clause.heads.is_empty()));
    }

    /// Returns the rules that answer a query: the body of a clause, optionally after `?-`.
    ///
    /// Every declared predicate is input and keeps its id of [`Workspace::check`]. The answer is the predicate
    /// [`Workspace::ANSWER`]. It has a column for each variable that occurs outside of aggregates and does not begin
    /// with `_`. `symbols` must contain the symbols of the rows that the caller will insert. No `.scope` applies.
    ///
    /// The workspace itself must be free of errors.
    pub fn ask(&self, sources: &Sources, question: SourceId, symbols: Symbols) -> Loaded {
        let mut faults = Faults::default();
        let parsed = parser::parse_question(question, sources.text(question), &mut faults);
        if let Some((body, place)) = &parsed
            && body.iter().any(temporal::is_temporal)
        {
            let fault = Diagnostic::new(codes::INVALID_TEMPORAL, "a query concerns the present tick");
            let help = "derive a predicate with the temporal operator by a rule, and ask for that";
            faults.push(fault.at(place.0, "this looks back").help(help));
        }
        match parsed.filter(|_| !faults.failed()) {
            Some((body, place)) => self.answer(&body, place, symbols),
            None => Loaded::failed(faults.finish()),
        }
    }

    /// Parses a fact with wildcards, such as `Path(1, _)`, and interns its symbols in `symbols`.
    ///
    /// The full stop is optional.
    ///
    /// # Errors
    /// All faults of the fact.
    pub fn fact(
        &self,
        sources: &Sources,
        question: SourceId,
        symbols: &Symbols,
    ) -> Result<FactPattern, Vec<Diagnostic>> {
        let mut faults = Faults::default();
        let parsed = parser::parse_question(question, sources.text(question), &mut faults);
        let Some((body, place)) = parsed.filter(|_| !faults.failed()) else {
            return Err(faults.finish());
        };
        let [Literal::Atom { negated: false, atom }] = body.as_slice() else {
            let fault = Diagnostic::new(codes::INVALID_FACT, "this is not a single fact");
            return Err(vec![fault.at(place.0, "expected a predicate and its values")]);
        };
        for term in &atom.terms {
            let mut variable = None;
            names_of(term, true, &mut |name| {
                variable.get_or_insert(name);
            });
            if let Some(name) = variable {
                let fault = Diagnostic::new(codes::INVALID_FACT, format!("`{name}` is a variable, not a value"));
                let help = format!("write strings in double quotes: `\"{name}\"`; `_` matches any value");
                faults.push(fault.at(term.place.0, "").help(help));
            }
        }
        if faults.failed() {
            return Err(faults.finish());
        }
        // A body would match a record by its fields, so check a fact without wildcards as a clause.
        let computes = |term: &Term| matches!(term.kind, TermKind::Functor(..) | TermKind::Cast(..));
        if atom.terms.iter().any(computes) && !atom.terms.iter().any(has_wildcard) {
            return self.fact_of(atom, symbols);
        }
        let loaded = self.answer(&body, place, Symbols::of_words(self.policy.word_size));
        let Some(rules) = loaded.rules else {
            return Err(loaded.diagnostics);
        };
        let answer = rules.predicate(ANSWER);
        let clause = rules
            .clauses
            .iter()
            .find(|clause| Some(clause.head.predicate) == answer);
        match clause.map(|clause| clause.body.as_slice()) {
            Some([rules::Literal::Positive(atom)]) => Ok(FactPattern {
                predicate: atom.predicate,
                values: constants(atom, &rules, symbols).collect(),
            }),
            _ if !atom.terms.iter().any(has_wildcard) => {
                let message = format!("`{}` is inline, so it has no rows", atom.predicate.text);
                let fault = Diagnostic::new(codes::INVALID_FACT, message).at(atom.predicate.place.0, "");
                Err(vec![fault.help("ask about a predicate that uses it")])
            }
            _ => {
                let fault = Diagnostic::new(
                    codes::INVALID_FACT,
                    "a fact cannot combine `_` with a record or an expression",
                );
                let help = "give all values of the fact, or write `_` in place of the record or expression, too";
                Err(vec![fault.at(place.0, "").help(help)])
            }
        }
    }

    /// Parses a source that consists of facts and interns their symbols in `symbols`.
    ///
    /// Returns `None` if the source contains anything else, or a fact with an expression that has no value.
    ///
    /// # Errors
    /// All faults of the facts.
    pub fn facts(
        &self,
        sources: &Sources,
        id: SourceId,
        symbols: &Symbols,
    ) -> Result<Option<Vec<FactRow>>, Vec<Diagnostic>> {
        let mut faults = Faults::default();
        let file = include::parse_one(sources, id, &mut faults);
        if faults.failed() {
            return Err(faults.finish());
        }
        let is_fact = |item: &Item| matches!(item, Item::Clause(clause) if clause.body.is_empty());
        if !file.items.iter().all(is_fact) {
            return Ok(None);
        }
        self.facts_of(file.items, id, symbols)
    }

    /// Returns a fact without wildcards. The variables in it have been reported.
    fn fact_of(&self, atom: &Atom, symbols: &Symbols) -> Result<FactPattern, Vec<Diagnostic>> {
        let clause = Clause {
            heads: vec![atom.clone()],
            probabilities: Vec::new(),
            body: Vec::new(),
            doc: String::new(),
            place: atom.place,
        };
        let found = self.facts_of(vec![Item::Clause(clause)], atom.place.0.source, symbols)?;
        match found.and_then(|mut rows| rows.pop()) {
            Some((predicate, row)) => Ok(FactPattern {
                predicate,
                values: row.into_iter().map(Some).collect(),
            }),
            None => {
                let fault = Diagnostic::new(
                    codes::INVALID_FACT,
                    "an expression in this fact cannot be evaluated here",
                );
                Err(vec![fault.at(atom.place.0, "")])
            }
        }
    }

    /// Returns the rows of facts in the source `id`.
    fn facts_of(
        &self,
        facts: Vec<Item>,
        id: SourceId,
        symbols: &Symbols,
    ) -> Result<Option<Vec<FactRow>>, Vec<Diagnostic>> {
        let mut faults = Faults::default();
        let mut items = self.declarations(false);
        items.extend(facts);
        let (rules, _) = check(
            (Cow::Owned(items), Cow::Owned(FactRuns::default())),
            self.elsewhere(),
            self.policy,
            Symbols::of_words(self.policy.word_size),
            &mut faults,
        );
        let Some(rules) = rules else {
            return Err(of(id, faults));
        };
        let row = |clause: &rules::Clause| {
            let row: Option<Vec<Value>> = constants(&clause.head, &rules, symbols).collect();
            Some((clause.head.predicate, row?))
        };
        Ok(rules.clauses.iter().map(row).collect())
    }

    /// Returns what is known of declarations outside of a query or of facts, for which the program is complete.
    fn elsewhere(&self) -> Elsewhere<'_> {
        Elsewhere {
            complete: true,
            offered: &self.gathered.offered,
        }
    }

    /// Returns the declarations of types and predicates; with `input`, all predicates are input.
    fn declarations(&self, input: bool) -> Vec<Item> {
        let declared = |item: &&Item| matches!(item, Item::Type(_) | Item::Decl(_) | Item::Functor(_));
        let mut items: Vec<Item> = self.gathered.items.iter().filter(declared).cloned().collect();
        let mut names = Vec::new();
        for item in &mut items {
            if let Item::Decl(decl) = item {
                // `Workspace::check` reports the warnings about qualifiers.
                decl.qualifiers.clear();
                decl.choices.clear();
                names.extend(decl.names.iter().cloned());
            }
        }
        if input && !names.is_empty() {
            items.push(Item::Mark(Mark {
                kind: MarkKind::Input,
                names,
                options: Vec::new(),
            }));
        }
        items
    }

    /// Returns the clause with every `inline` predicate replaced by its bodies.
    fn inlined(&self, clause: Clause, faults: &mut Faults) -> Clause {
        let mut items: Vec<Item> = (self.gathered.items.iter())
            .filter(|item| matches!(item, Item::Decl(_) | Item::Clause(_)))
            .cloned()
            .collect();
        items.push(Item::Clause(clause.clone()));
        match inline::replace(&items, faults).and_then(|mut items| items.pop()) {
            Some(Item::Clause(replaced)) => replaced,
            _ => clause,
        }
    }

    fn uses_inline(&self) -> bool {
        let is_inline = |item: &Item| match item {
            Item::Decl(decl) => decl.qualifiers.iter().any(|word| word.text == "inline"),
            _ => false,
        };
        self.gathered.items.iter().any(is_inline)
    }

    fn answer(&self, body: &[Literal], place: Place, symbols: Symbols) -> Loaded {
        let mut clause = Clause {
            heads: vec![Atom {
                predicate: answer_name(place),
                terms: Vec::new(),
                place,
            }],
            probabilities: Vec::new(),
            body: body.to_vec(),
            doc: String::new(),
            place,
        };
        let mut faults = Faults::default();
        if self.uses_inline() {
            clause = self.inlined(clause, &mut faults);
        }
        let variables = variables(body);
        let names: Vec<&str> = variables.iter().map(|(name, _)| *name).collect();
        let types = self.types(&clause, &names, &mut faults);
        if faults.failed() {
            let mut found = of(place.0.source, faults);
            found.retain(Diagnostic::is_error);
            return Loaded::failed(found);
        }
        let columns = (variables.iter().zip(types))
            .map(|(&(name, place), text)| ColumnDecl {
                name: Name {
                    text: name.to_owned(),
                    place,
                },
                ty: Name { text, place },
            })
            .collect();
        clause.heads[0].terms = (variables.iter())
            .map(|&(name, place)| Term {
                kind: TermKind::Variable(name.to_owned()),
                place,
            })
            .collect();
        let items = self.asked(columns, clause);
        let mut faults = Faults::default();
        let (rules, compared) = check(
            (Cow::Owned(items), Cow::Owned(FactRuns::default())),
            self.elsewhere(),
            self.policy,
            symbols,
            &mut faults,
        );
        Loaded {
            rules,
            diagnostics: of(place.0.source, faults),
            compared,
        }
    }

    /// Returns the names of types of the variables in the body of a clause whose head has no columns: of a record that of
    /// a column or field where it occurs, and otherwise the base type.
    fn types(&self, clause: &Clause, variables: &[&str], faults: &mut Faults) -> Vec<String> {
        let items = self.asked(Vec::new(), clause.clone());
        let mut known = names::declare(&items, true, self.policy, faults);
        let checked = clause::check(
            (&items, &FactRuns::default()),
            &mut known,
            Symbols::of_words(self.policy.word_size),
            faults,
        );
        known.report_unknown(&self.gathered.offered, faults);
        let checked_symbols = checked.symbols.clone();
        let type_of = |name: &&str| {
            checked.clauses.iter().find_map(|checked| {
                let position = checked.clause.variables.iter().position(|known| known == name)?;
                let base = checked.bases[position]?;
                Some(match base {
                    BaseType::Record => {
                        let id = VarId(u32::try_from(position).ok()?);
                        let ty = record_type(&checked.clause, id, (&known, &checked_symbols), &mut Vec::new());
                        ty.map(|ty| known.type_name(ty).to_owned())
                    }
                    base => Some(base.name().to_owned()),
                })
            })
        };
        let mut types = Vec::with_capacity(variables.len());
        for name in variables {
            types.push(match type_of(name) {
                Some(Some(text)) => text,
                Some(None) => {
                    let message = format!("nothing determines the type of the record `{name}`");
                    let fault = Diagnostic::new(codes::UNKNOWN_TYPE, message).at(clause.place.0, "");
                    faults.push(fault.help(format!("use it in a predicate, or name its type: `as({name}, T)`")));
                    BaseType::Symbol.name().to_owned()
                }
                None => BaseType::Symbol.name().to_owned(),
            });
        }
        types
    }

    /// Returns the program of a query: all predicates as input, and the answer clause.
    fn asked(&self, columns: Vec<ColumnDecl>, clause: Clause) -> Vec<Item> {
        let mut items = self.declarations(true);
        items.push(Item::Decl(Decl {
            names: vec![answer_name(clause.place)],
            columns: Some(columns),
            qualifiers: Vec::new(),
            choices: Vec::new(),
            doc: String::new(),
        }));
        items.push(Item::Clause(clause));
        items
    }
}

/// Returns whether the items use a name that none of them declares.
fn lacks_declaration(gathered: &Gathered) -> bool {
    let mut declared: HashSet<&str> = BaseType::ALL.into_iter().map(BaseType::name).collect();
    for item in &gathered.items {
        match item {
            Item::Decl(decl) => declared.extend(decl.names.iter().map(|name| name.text.as_str())),
            Item::Type(decl) => _ = declared.insert(&decl.name.text),
            _ => {}
        }
    }
    let is_unknown = |name: &Name| !declared.contains(name.text.as_str());
    let lacks = |item: &Item| match item {
        Item::Decl(decl) => (decl.columns.iter().flatten()).any(|column| is_unknown(&column.ty)),
        Item::Mark(mark) => mark.names.iter().any(is_unknown),
        Item::Clause(clause) => {
            let mut found = clause.heads.iter().any(|head| is_unknown(&head.predicate));
            let mut see = |_: bool, atom: &Atom| found |= is_unknown(&atom.predicate);
            inline::each_atom(&clause.body, &mut see);
            let terms = clause.heads.iter().flat_map(|head| &head.terms);
            terms.for_each(|term| inline::each_atom_of(term, &mut see));
            found
        }
        _ => false,
    };
    let mut packed = gathered.facts.files().iter().flat_map(|file| file.names());
    gathered.items.iter().any(lacks) || packed.any(|name| !declared.contains(name.as_str()))
}

fn answer_name(place: Place) -> Name {
    Name {
        text: ANSWER.to_owned(),
        place,
    }
}

/// Returns the constants of an atom with their symbols interned in `symbols`; `None` for a column without a constant.
fn constants<'r>(
    atom: &'r rules::Atom,
    rules: &'r rules::Rules,
    symbols: &'r Symbols,
) -> impl Iterator<Item = Option<Value>> + 'r {
    let columns = &rules.predicates[atom.predicate.index()].columns;
    atom.terms.iter().zip(columns).map(|(term, column)| match *term {
        rules::Term::Constant(value) => Some(moved(value, column.base, &rules.symbols, symbols)),
        rules::Term::Variable(_) | rules::Term::Wildcard => None,
    })
}

/// Returns the type of a variable that holds records: that of a column, or of a field of a record with a type. `seen` holds
/// the variables that have been asked for.
fn record_type(
    clause: &rules::Clause,
    id: VarId,
    (names, symbols): (&names::Names, &Symbols),
    seen: &mut Vec<VarId>,
) -> Option<TypeId> {
    if seen.contains(&id) {
        return None;
    }
    seen.push(id);
    let own = rules::Term::Variable(id);
    clause.body.iter().find_map(|literal| match literal {
        rules::Literal::Compare {
            op: Comparison::Equal,
            left,
            right,
            ..
        } if *left == own || *right == own => {
            let other = if *left == own { right } else { left };
            record_type(clause, other.variable()?, (names, symbols), seen)
        }
        literal if literal.field().is_some_and(|field| field.value == own) => {
            let field = literal.field()?;
            let ty = record_type(clause, field.record.variable()?, (names, symbols), seen)?;
            let (branch, _) = record::parts(symbols.resolve(field.shape)?);
            let mut shapes = names.shapes(ty).iter();
            let shape = shapes.find(|shape| shape.branch.as_deref() == branch)?;
            Some(shape.fields.get(field.at)?.1)
        }
        literal => {
            let atom = literal.atom()?;
            let column = atom.terms.iter().position(|term| *term == own)?;
            Some(names.predicate(atom.predicate).columns[column].ty)
        }
    })
}

fn has_wildcard(term: &Term) -> bool {
    match &term.kind {
        TermKind::Wildcard => true,
        TermKind::Functor(_, arguments) => arguments.iter().any(has_wildcard),
        TermKind::Cast(inner, _) => has_wildcard(inner),
        _ => false,
    }
}

/// Returns the diagnostics whose primary place lies in one source, and those without a place.
fn of(source: SourceId, faults: Faults) -> Vec<Diagnostic> {
    let here = |fault: &Diagnostic| (fault.primary.as_ref()).is_none_or(|label| label.span.source == source);
    faults.finish().into_iter().filter(here).collect()
}

/// Returns the variables that a query asks for, each with its first place.
fn variables(body: &[Literal]) -> Vec<(&str, Place)> {
    fn of_term<'t>(term: &'t Term, each: &mut impl FnMut(&'t str, Place)) {
        match &term.kind {
            TermKind::Variable(name) => each(name, term.place),
            TermKind::Functor(_, arguments) => arguments.iter().for_each(|argument| of_term(argument, each)),
            TermKind::Cast(inner, _) => of_term(inner, each),
            _ => {}
        }
    }
    fn of_literal<'t>(literal: &'t Literal, each: &mut impl FnMut(&'t str, Place)) {
        match literal {
            Literal::Atom { atom, .. } => atom.terms.iter().for_each(|term| of_term(term, each)),
            Literal::Compare { left, right, .. } => [left, right].into_iter().for_each(|term| of_term(term, each)),
            Literal::Temporal { temporal, .. } => {
                let terms = temporal.atoms().flat_map(|atom| &atom.terms);
                terms.for_each(|term| of_term(term, each));
            }
            Literal::Any(alternatives) => alternatives.iter().flatten().for_each(|one| of_literal(one, each)),
        }
    }
    let mut seen = HashSet::new();
    let mut found = Vec::new();
    for one in body {
        of_literal(one, &mut |name, place| {
            if !name.starts_with('_') && seen.insert(name) {
                found.push((name, place));
            }
        });
    }
    found
}

/// Returns the clause without its doc comment, with variables numbered in the order of occurrence.
fn canonical(clause: &Clause) -> Clause {
    let mut order: Vec<&str> = Vec::new();
    let mut seen = HashSet::new();
    let mut note = |name| {
        if seen.insert(name) {
            order.push(name);
        }
    };
    let heads = clause.heads.iter().flat_map(|head| &head.terms);
    heads
        .chain(&clause.probabilities)
        .for_each(|term| names_of(term, true, &mut note));
    clause
        .body
        .iter()
        .for_each(|literal| names_in(literal, true, &mut note));
    let names = (order.iter().enumerate())
        .map(|(at, name)| ((*name).to_owned(), TermKind::Variable(format!("+{at}"))))
        .collect();
    let head = |head: &Atom| Atom {
        terms: head.terms.iter().map(|term| renamed_term(term, &names)).collect(),
        ..head.clone()
    };
    Clause {
        heads: clause.heads.iter().map(head).collect(),
        probabilities: (clause.probabilities.iter())
            .map(|term| renamed_term(term, &names))
            .collect(),
        body: clause.body.iter().map(|literal| renamed(literal, &names)).collect(),
        doc: String::new(),
        place: clause.place,
    }
}

/// Translates a value from one symbol table to another.
pub fn moved(value: Value, base: BaseType, from: &Symbols, to: &Symbols) -> Value {
    match base {
        BaseType::Symbol => Value(to.intern(from.resolve(Symbol(value.0)).unwrap_or_default()).0),
        BaseType::Record => Value(record::copied(value.0, from, to)),
        BaseType::Number | BaseType::Unsigned | BaseType::Float => Value(to.number_of(value.0, from)),
    }
}

/// Returns whether text typed at a prompt is complete.
///
/// Complete text has no open parenthesis, and its last clause ends with a full stop. A directive ends with its line,
/// and a query once it parses.
pub fn is_complete(text: &str) -> bool {
    let mut sources = Sources::new();
    let id = sources.add("", text);
    let mut faults = Faults::default();
    let lexed = lexer::lex(id, text, &mut faults);
    let mut depth = 0_usize;
    for token in &lexed.tokens {
        match token.kind {
            Kind::LParen | Kind::LBrace | Kind::LBracket => depth += 1,
            Kind::RParen | Kind::RBrace | Kind::RBracket => depth = depth.saturating_sub(1),
            _ => {}
        }
    }
    // The last token is the end of input.
    let Some(last) = lexed.tokens.iter().rev().nth(1) else {
        // A doc comment needs the item it documents.
        return lexed.docs.is_empty() && !has_open_comment(text, &lexed);
    };
    if depth > 0 || has_open_comment(text, &lexed) {
        return false;
    }
    match last.kind {
        Kind::Dot => true,
        Kind::Comma | Kind::Colon | Kind::Pipe | Kind::Subtype | Kind::Equal | Kind::If | Kind::Semicolon => false,
        _ if text.trim_start().starts_with("?-") => {
            parser::parse_question(id, text, &mut faults).is_some() && !faults.failed()
        }
        _ => {
            let (_, starts) = parser::parse_tokens(id, text, &lexed, &mut faults);
            starts
                .last()
                .is_some_and(|&start| matches!(lexed.tokens[start].kind, Kind::Dot | Kind::RBrace | Kind::Preprocessor))
        }
    }
}

/// Returns whether a comment is unclosed. The lexer stops at a `/*` without `*/` and records no comment there.
fn has_open_comment(text: &str, lexed: &lexer::Lexed) -> bool {
    let read = (lexed.comments.iter().map(|comment| comment.end))
        .chain(lexed.tokens.iter().rev().nth(1).map(|token| token.end))
        .max()
        .unwrap_or(0);
    text[read as usize..].contains("/*")
}

#[cfg(test)]
mod tests {
    use crate::check::InputPolicy;
    use crate::diag::Sources;
    use crate::files::ReadError;
    use crate::syntax::ast::Item;
    use crate::workspace::{Workspace, is_complete};
    use std::path::Path;

    /// A random program, mostly of facts, some of them faulty.
    fn facts_among_items(state: &mut u32) -> String {
        const DECLARATIONS: &str = ".decl A(n: number, s: symbol)
            .decl C(n: number)
            .decl D(u: unsigned, f: float)
            .decl E(s: symbol, t: symbol)
            .decl None()\n";
        const CONSTANTS: [&str; 18] = [
            "1",
            "2",
            "-7",
            "0x1f",
            "2147483647",
            "4294967295",
            "99999999999",
            "1u",
            "2.5",
            "10.0.0.1",
            "\"a\"",
            "\"b c\"",
            "\"\\n\\\"\"",
            "\"\"",
            "\"é\"",
            "1 + 2",
            "x",
            "_",
        ];
        const ITEMS: [&str; 10] = [
            "C(x) :- A(x, _).",
            ".plan 0:(1)",
            "/// said",
            ".scope E",
            ".scope",
            "A(1, \"a\"), C(1).",
            ".output C",
            "C(x) :- A(x, \"a\"), ! None().",
            ".include \"other.dl\"",
            "// a comment",
        ];
        let mut random = |below: usize| {
            *state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (*state >> 8) as usize % below
        };
        let mut text = DECLARATIONS.to_owned();
        // A third of the programs have no faults.
        let faults = random(3) > 0;
        for _ in 0..random(40) {
            if random(6) == 0 {
                text += ITEMS[random(if faults { 10 } else { 5 })];
                text += "\n";
                continue;
            }
            let (name, terms) = [
                ("A", &["1", "\"a\""][..]),
                ("C", &["3"]),
                ("D", &["4", "5"]),
                ("E", &["\"a\"", "\"b\""]),
                ("None", &[]),
                ("Unknown", &["1"]),
            ][random(if faults { 6 } else { 5 })];
            let mut terms = terms.to_vec();
            for term in &mut terms {
                if faults && random(4) == 0 {
                    *term = CONSTANTS[random(CONSTANTS.len())];
                }
            }
            if faults && random(12) == 0 {
                terms.push("6");
            }
            let space = ["", " ", "\n  "][random(3)];
            let end = if faults && random(30) == 0 { "\n" } else { ".\n" };
            let terms = terms.join([",", ", "][random(2)]);
            text += &format!("{name}({space}{terms}{space}){space}{end}");
        }
        text
    }

    #[test]
    fn packed_facts_are_checked_as_syntax_trees_are() {
        let mut state = 1;
        let (mut packed, mut sound) = (0, 0);
        for _ in 0..300 {
            let mut sources = Sources::new();
            let other = facts_among_items(&mut state);
            let entry = sources.add("main.dl", facts_among_items(&mut state));
            let read = |path: &Path| match path == Path::new("other.dl") {
                true => Ok(other.clone()),
                false => Err(ReadError::NotFound),
            };
            let mut workspace = Workspace::new(InputPolicy::Fixed);
            workspace.add(&mut sources, entry, &read);
            let mut trees = workspace.clone();
            trees.gathered.facts.unpack(&mut trees.gathered.items);
            packed += trees.gathered.items.len() - workspace.gathered.items.len();
            let found = format!("{:?}", workspace.check());
            assert_eq!(found, format!("{:?}", trees.check()), "{}", sources.text(entry));
            for item in &trees.gathered.items {
                if let Item::Clause(clause) = item {
                    let places = |workspace: &Workspace| {
                        let mut places = workspace.find(clause);
                        places.sort();
                        places
                    };
                    assert!(places(&workspace) == places(&trees) && !places(&trees).is_empty());
                }
            }
            let loaded = workspace.into_checked();
            sound += usize::from(loaded.rules.is_some());
            assert_eq!(found, format!("{loaded:?}"));
        }
        assert!(packed > 2_000 && sound > 30, "{packed} {sound}");
    }

    #[test]
    fn a_text_is_complete_at_the_full_stop_and_at_the_end_of_a_directive() {
        let whole = [
            "",
            "A(1).",
            "A(x) :-\n B(x).",
            ".decl A(x: number)",
            ".input A",
            ".decl A(x: number)\nA(1).",
            "?- A(x), x > 1.",
            "?- A(x), x > 1.5",
            "?- A(x)",
            "// said\n",
            "/// said\nA(1).",
            "A(\"a.\").",
            "/* a */",
            ".comp A { .decl p(x: number) p(1). }",
            ".init a = A<number>",
        ];
        let open = [
            "A(1)",
            "A(x) :-",
            "A(x) :- B(x),\n",
            ".decl A(x: number,",
            ".decl A(",
            ".input A,",
            ".type t =",
            "A(1). B(",
            "?-",
            "?- A(x), x >",
            "?- A(x), x > 1.5 +",
            "?- A(x,",
            "/// said\n",
            "/* a",
            "A(1). /* b",
            ".comp A { .decl p(x: number)",
            ".comp A {",
            "A(1). // a /* b */\nB",
        ];
        for text in whole {
            assert!(is_complete(text), "{text}");
        }
        for text in open {
            assert!(!is_complete(text), "{text}");
        }
    }
}
