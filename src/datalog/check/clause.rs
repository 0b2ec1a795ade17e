//! From the syntax of clauses to checked clauses. Disjunctions and multiple heads become separate clauses;
//! [`super::body`] checks each of them.

use std::borrow::Cow;
use std::cell::OnceCell;
use std::collections::{HashMap, HashSet};
use std::ops::Range;

use crate::codes;
use crate::diag::{self, Diagnostic, Faults, Span};
use crate::symbol::Symbols;

use crate::check::body;
use crate::check::body::UnguardedClause;
use crate::check::clauses::{Checked, Clauses, Known, VariableType, reads_as_constant};
use crate::check::inline;
use crate::check::names::Names;
use crate::check::rules::{Atom, Clause, Literal, Predicate, PredicateId, Term, VarId};
use crate::check::scope;
use crate::check::scope::Scope;
use crate::check::strata;
use crate::check::witness;
use crate::syntax::ast;
use crate::syntax::ast::{BaseType, Comparison, Item, names_in, names_of};
use crate::syntax::packed::{Constant, FactRuns, PackedFacts};
use crate::value::Value;

/// Maximum number of literals in a body.
const MAX_LITERALS: usize = 1024;

/// Maximum number of combinations of alternatives and heads of one clause.
const MAX_ALTERNATIVES: usize = 1024;

/// Checks all clauses and packed facts, and interns their constants in `symbols`.
pub(crate) fn check(
    (items, facts): (&[Item], &FactRuns),
    names: &mut Names,
    symbols: Symbols,
    faults: &mut Faults,
) -> Clauses {
    let mut clauses = Clauses {
        symbols,
        ..Clauses::default()
    };
    names.components = components(items, names);
    let mut scopes = scope::Scopes::default();
    let mut before: Option<Cow<'_, ast::Clause>> = None;
    let signatures: Vec<Vec<Option<Signature>>> = facts.files().iter().map(|file| signatures(file, names)).collect();
    let mut runs = facts.runs().peekable();
    for at in 0..=items.len() {
        while let Some((_, file, run)) = runs.next_if(|(before, ..)| *before == at) {
            let packed = &facts.files()[file];
            before = run.clone().last().map(|fact| Cow::Owned(packed.clause(fact)));
            let packed = (packed, signatures[file].as_slice());
            packed_facts(packed, run, &mut scopes, names, &mut clauses, faults);
        }
        match items.get(at) {
            Some(Item::Scope(scope)) => scopes.enter(scope, names, faults),
            Some(Item::Clause(clause)) => {
                one(clause, &mut scopes, names, &mut clauses, faults);
                before = Some(Cow::Borrowed(clause));
            }
            Some(Item::Plan(plan)) => check_plan(plan, before.as_deref(), faults),
            _ => {}
        }
    }
    for index in 0..names.predicates.len() {
        let predicate = &names.predicates[index];
        let is_head = |checked: &Checked| checked.clause.head.predicate.index() == index;
        let decides = !predicate.choices.is_empty() || predicate.subsumption.is_some();
        if decides && (predicate.input || clauses.clauses.iter().any(is_head)) {
            // Rounds decide about facts and inserted rows, too.
            names.predicates[index].derived = true;
        }
        let predicate = &names.predicates[index];
        if predicate.input && predicate.derived && predicate.edb.is_none() {
            split_input(
                PredicateId(u32::try_from(index).expect("fewer than 2^32 predicates")),
                names,
                &mut clauses,
            );
        }
    }
    clauses
}

/// A declared predicate and the base types of its columns.
type Signature = (PredicateId, Vec<BaseType>);

/// Returns the signatures of the predicates of packed facts, by their positions there.
fn signatures(packed: &PackedFacts, names: &Names) -> Vec<Option<Signature>> {
    let signature = |name: &String| {
        let predicate = names.find(name)?;
        let columns = names.signatures[predicate.index()].columns.as_ref()?;
        let bases: Option<Vec<BaseType>> = columns.iter().map(|ty| Some(names.base((*ty)?))).collect();
        Some((predicate, bases?))
    };
    packed.names().iter().map(signature).collect()
}

/// Checks packed facts with the signatures of their predicates. Those that do not fit these are checked as syntax
/// trees, which reports them.
fn packed_facts(
    (packed, signatures): (&PackedFacts, &[Option<Signature>]),
    run: Range<usize>,
    scopes: &mut scope::Scopes,
    names: &mut Names,
    out: &mut Clauses,
    faults: &mut Faults,
) {
    out.clauses.reserve(run.len());
    for fact in run {
        let constants = packed.constants(fact);
        let fitting = signatures[packed.name(fact)].as_ref();
        let fitting = fitting.filter(|(_, bases)| bases.len() == constants.len());
        let checked = fitting.and_then(|(predicate, bases)| {
            let terms: Option<Vec<Term>> = (bases.iter().zip(constants))
                .map(|(&base, constant)| constant_of(base, constant, &out.symbols).map(Term::Constant))
                .collect();
            Some((*predicate, terms?))
        });
        match checked {
            Some((predicate, terms)) => out.clauses.push(Checked {
                clause: Clause {
                    head: Atom {
                        predicate,
                        terms,
                        span: packed.atom_span(fact),
                    },
                    body: Vec::new(),
                    variables: Vec::new(),
                    variable_spans: Vec::new(),
                    doc: String::new(),
                    span: packed.clause_span(fact),
                },
                bases: Vec::new(),
                sound: true,
            }),
            None => one(&packed.clause(fact), scopes, names, out, faults),
        }
    }
}

/// Returns the word of a constant in a column of this base type, if it fits.
fn constant_of(base: BaseType, constant: Constant<'_>, symbols: &Symbols) -> Option<Value> {
    match (base, constant) {
        (BaseType::Symbol, Constant::Symbol(text)) => Some(Value(symbols.intern(text).0)),
        (BaseType::Number, Constant::Number(number)) => Value::of_number(number.into(), symbols),
        (BaseType::Unsigned, Constant::Number(number)) => u64::try_from(number)
            .ok()
            .and_then(|number| Value::of_unsigned(number, symbols)),
        (BaseType::Float, Constant::Number(number)) => Some(Value::of_float(number.into(), symbols)),
        _ => None,
    }
}

/// Returns the component of each declared predicate: those that depend on each other have the same number.
fn components(items: &[Item], names: &Names) -> Vec<usize> {
    let mut successors: Vec<Vec<usize>> = vec![Vec::new(); names.predicates.len()];
    let mut scope = None;
    for item in items {
        let clause = match item {
            Item::Clause(clause) => clause,
            Item::Scope(entered) => {
                scope = entered.predicate.as_ref().and_then(|name| names.find(&name.text));
                continue;
            }
            _ => continue,
        };
        let mut read: Vec<usize> = Vec::new();
        let mut note =
            |_: bool, atom: &ast::Atom| read.extend(names.find(&atom.predicate.text).map(PredicateId::index));
        inline::each_atom(&clause.body, &mut note);
        let terms = clause.heads.iter().flat_map(|head| &head.terms);
        terms.for_each(|term| inline::each_atom_of(term, &mut note));
        if !clause.body.is_empty() {
            read.extend(scope.map(PredicateId::index));
        }
        if !read.is_empty() {
            let heads = clause.heads.iter().filter_map(|head| names.find(&head.predicate.text));
            heads.for_each(|head| successors[head.index()].extend(&read));
        }
    }
    strata::components(&successors).0
}

/// Reports a `.plan` whose orders do not fit the preceding clause, as Soufflé does.
fn check_plan(plan: &ast::Plan, clause: Option<&ast::Clause>, faults: &mut Faults) {
    let positive = |literal: &ast::Literal| matches!(literal, ast::Literal::Atom { negated: false, .. });
    let is_flat = |clause: &&ast::Clause| {
        !clause
            .body
            .iter()
            .any(|literal| matches!(literal, ast::Literal::Any(_)))
    };
    if let Some(clause) = clause.filter(is_flat) {
        let count = clause.body.iter().filter(|literal| positive(literal)).count();
        for (version, order) in &plan.orders {
            let mut sorted = order.clone();
            sorted.sort_unstable();
            if sorted.len() > count || !sorted.iter().copied().eq(1..=sorted.len() as i128) {
                let fault = Diagnostic::new(
                    codes::SYNTAX,
                    format!("version {version} does not list the clause's atoms"),
                )
                .at(plan.place.0, "")
                .also(
                    clause.place.0,
                    format!("the positive atoms of the clause before it: {count}"),
                );
                faults.push(fault.help("name each atom once by its number, or remove `.plan`: it has no effect"));
                return;
            }
        }
    }
    let fault = Diagnostic::new(codes::IGNORED, "`.plan` has no effect").at(plan.place.0, "");
    faults.push(fault.help("remove it; the planner chooses the order of literals"));
}

/// Moves the inserted rows of a predicate that is input and derived to a hidden predicate: `P(x, y) :- +1(x, y).`
fn split_input(id: PredicateId, names: &mut Names, out: &mut Clauses) {
    let edb = PredicateId(u32::try_from(names.predicates.len()).expect("fewer than 2^32 predicates"));
    let owner = names.predicate(id);
    let name = format!("+{}", names.hidden() + 1);
    let doc = format!("the inserted rows of `{}`", owner.name);
    let mut hidden = Predicate::made(name, owner.columns.clone(), doc, owner.span);
    hidden.derived = false;
    let span = hidden.span;
    let terms: Vec<Term> = (0..hidden.columns.len())
        .map(|column| Term::Variable(VarId(u32::try_from(column).expect("few columns"))))
        .collect();
    let atom = |predicate| Atom {
        predicate,
        terms: terms.clone(),
        span,
    };
    out.hidden.push(Clause {
        head: atom(id),
        body: vec![Literal::Positive(atom(edb))],
        variables: hidden.columns.iter().map(|column| column.name.clone()).collect(),
        variable_spans: vec![span; hidden.columns.len()],
        doc: String::new(),
        span,
    });
    names.signatures.push(names.signatures[id.index()].clone());
    names.predicates.push(hidden);
    names.predicates[id.index()].edb = Some(edb);
}

fn one(clause: &ast::Clause, scopes: &mut scope::Scopes, names: &mut Names, out: &mut Clauses, faults: &mut Faults) {
    let alternatives = count(&clause.body);
    let too_many = |message: String, note: String| {
        Diagnostic::new(diag::codes::LIMIT_EXCEEDED, message)
            .at(clause.heads[0].place.0, "")
            .note(note)
    };
    if clause.body.len() > MAX_LITERALS {
        let message = format!("clause with {} literals", clause.body.len());
        faults.push(too_many(message, format!("a body has at most {MAX_LITERALS}")));
        out.incomplete = true;
        return;
    }
    if alternatives.saturating_mul(clause.heads.len()) > MAX_ALTERNATIVES {
        let note = format!("alternatives and heads make at most {MAX_ALTERNATIVES} combinations");
        faults.push(too_many("clause with too many alternatives".to_owned(), note));
        out.incomplete = true;
        return;
    }
    let mut bodies = Vec::with_capacity(alternatives);
    if alternatives > 0 {
        expand(vec![&clause.body], Vec::new(), &mut bodies);
    }
    if bodies.is_empty() {
        // A body that is `false` derives nothing, but its heads still need name resolution.
        for head in &clause.heads {
            names.resolve(&head.predicate);
        }
    }
    let first_edge = out.edges.len();
    for body in &bodies {
        for head in &clause.heads {
            alternative(clause, head, body, scopes, names, out, faults);
        }
    }
    if bodies.len() > 1 {
        let mut seen = HashSet::new();
        let edges = out.edges.split_off(first_edge);
        out.edges.extend(edges.into_iter().filter(|edge| seen.insert(*edge)));
    }
}

/// Returns the number of alternatives of a body.
fn count(body: &[ast::Literal]) -> usize {
    body.iter().fold(1_usize, |product, literal| match literal {
        ast::Literal::Any(alternatives) => {
            let sum = (alternatives.iter()).fold(0_usize, |sum, alternative| sum.saturating_add(count(alternative)));
            product.saturating_mul(sum)
        }
        _ => product,
    })
}

/// Appends every choice of one alternative per disjunction to `out`. `rest` is the stack of literal lists still to
/// process, the next one last.
fn expand<'c>(
    mut rest: Vec<&'c [ast::Literal]>,
    mut done: Vec<&'c ast::Literal>,
    out: &mut Vec<Vec<&'c ast::Literal>>,
) {
    while let Some(list) = rest.pop() {
        let Some((literal, others)) = list.split_first() else {
            continue;
        };
        rest.push(others);
        match literal {
            ast::Literal::Any(alternatives) => {
                for alternative in alternatives {
                    let mut rest = rest.clone();
                    rest.push(alternative);
                    expand(rest, done.clone(), out);
                }
                return;
            }
            _ => done.push(literal),
        }
    }
    out.push(done);
}

/// Checks one head with one alternative of the body.
fn alternative(
    clause: &ast::Clause,
    head: &ast::Atom,
    body: &[&ast::Literal],
    scopes: &mut scope::Scopes,
    names: &mut Names,
    out: &mut Clauses,
    faults: &mut Faults,
) {
    let written_out = match witness::write_out(head, body, MAX_LITERALS) {
        Ok(written_out) => written_out,
        Err(witness::TooLong) => {
            let fault = Diagnostic::new(diag::codes::LIMIT_EXCEEDED, "clause with too many nested aggregates");
            let note = format!("the witnesses of its `min` and `max` copy more than {MAX_LITERALS} literals");
            faults.push(fault.at(head.place.0, "").note(note));
            out.incomplete = true;
            return;
        }
    };
    let written_out: Option<Vec<&ast::Literal>> = written_out.as_ref().map(|literals| literals.iter().collect());
    let body = written_out.as_deref().unwrap_or(body);
    let checked = body::check(clause, head, body, scopes.current(), names, out, faults);
    let Some(UnguardedClause {
        head,
        body: mut literals,
        variables,
        sound,
    }) = checked
    else {
        out.incomplete = true;
        return;
    };
    let is_fact = literals.is_empty();
    let mut scoped = Scope {
        head: &head,
        body: &mut literals,
        names: variables.iter().map(|variable| variable.name.clone()).collect(),
        types: variables.iter().map(|variable| variable.ty).collect(),
        guarded: vec![false; variables.len()],
    };
    let sound = scopes.guard(&mut scoped, sound, names, out, faults) && sound;
    let Scope {
        names: variable_names,
        guarded,
        ..
    } = scoped;
    if sound && !is_fact {
        let is_scoped = scopes.current().is_some();
        lone_variables(clause, body, &variables, (&guarded, is_scoped), names, faults);
    }
    let bases = variables.iter().map(|variable| base(variable.ty, names)).collect();
    let derived = &mut names.predicates[head.predicate.index()].derived;
    *derived |= !is_fact;
    out.clauses.push(Checked {
        clause: Clause {
            head,
            body: literals,
            variable_spans: {
                let first = variables.iter().map(|variable| variable.first);
                // Guards may add variables.
                let added = std::iter::repeat(clause.place.0);
                first.chain(added).take(variable_names.len()).collect()
            },
            variables: variable_names,
            doc: clause.doc.clone(),
            span: clause.place.0,
        },
        bases,
        sound,
    });
}

fn base(ty: VariableType, names: &Names) -> Option<BaseType> {
    match ty {
        VariableType::Unknown => None,
        VariableType::Base(base) => Some(base),
        VariableType::Type(id) => Some(names.base(id)),
    }
}

/// Warns of equations that are always true, and of other variables that occur once. A guarded variable means "some
/// agent in view" and needs no second occurrence, unless another variable differs from it in case only. Nor does a
/// variable of an aggregate under a scope.
fn lone_variables<'c>(
    clause: &'c ast::Clause,
    body: &[&'c ast::Literal],
    variables: &'c [Known],
    (guarded, is_scoped): (&[bool], bool),
    names: &Names,
    faults: &mut Faults,
) {
    let mut lone = LoneVariables {
        clause,
        counts: OnceCell::new(),
        reported: Vec::new(),
        faults,
    };
    lone.in_equations(body, variables, names);
    lone.outside_of_aggregates(variables, guarded, names);
    if !is_scoped {
        lone.in_aggregates(body);
    }
}

/// The warnings of the variables of a clause that occur once.
struct LoneVariables<'c, 'f> {
    clause: &'c ast::Clause,
    /// The number of occurrences of each variable in all alternatives, once a warning depends on it.
    counts: OnceCell<HashMap<&'c str, usize>>,
    reported: Vec<&'c str>,
    faults: &'f mut Faults,
}

impl<'c> LoneVariables<'c, '_> {
    /// Whether a variable occurs once. One that occurs once in this alternative may occur in others.
    fn is_lone(&self, name: &str) -> bool {
        self.counts().get(name) == Some(&1)
    }

    fn counts(&self) -> &HashMap<&'c str, usize> {
        self.counts.get_or_init(|| {
            let mut counts: HashMap<&str, usize> = HashMap::new();
            let mut count = |name| *counts.entry(name).or_default() += 1;
            for term in self.clause.heads.iter().flat_map(|head| &head.terms) {
                names_of(term, true, &mut count);
            }
            for literal in &self.clause.body {
                names_in(literal, true, &mut count);
            }
            counts
        })
    }

    /// Returns the variable that differs from `name` in case only. Of two that occur once, the later one is at fault.
    fn twin(&self, name: &str) -> Option<&'c str> {
        let is_twin = |other: &&str| *other != name && other.eq_ignore_ascii_case(name);
        let twin = self.counts().keys().copied().filter(is_twin).min()?;
        let comes_first = || {
            let mut order = Vec::new();
            for literal in &self.clause.body {
                names_in(literal, true, &mut |other| order.push(other));
            }
            order.iter().find(|other| [twin, name].contains(other)) == Some(&twin)
        };
        (self.counts()[twin] > 1 || comes_first()).then_some(twin)
    }

    /// Returns the warning of a variable that occurs once.
    fn singleton(&self, name: &str, place: Span) -> Diagnostic {
        let message = format!("the variable `{name}` occurs only once");
        let fault = Diagnostic::new(codes::SINGLETON_VARIABLE, message).at(place, "");
        let (fault, or) = match self.twin(name) {
            Some(twin) => (fault.did_you_mean(twin, &[place]), "or "),
            None => (fault, ""),
        };
        fault
            .help(format!("{or}write `_` or `_{name}` if its value does not matter"))
            .fix("replace it with `_`", [(place, "_".to_owned())])
            .fix(format!("rename it to `_{name}`"), [(place, format!("_{name}"))])
    }

    fn report(&mut self, name: &'c str, fault: Diagnostic) {
        self.faults.push(fault);
        self.reported.push(name);
    }

    fn in_equations(&mut self, body: &[&'c ast::Literal], variables: &[Known], names: &Names) {
        for literal in body {
            let ast::Literal::Compare {
                op: Comparison::Equal,
                left,
                right,
                place,
            } = literal
            else {
                continue;
            };
            let (ast::TermKind::Variable(one), ast::TermKind::Variable(other)) = (&left.kind, &right.kind) else {
                continue;
            };
            // The checker writes the result of `n = min x : { ... }` as such an equation.
            let result = match (one.starts_with('+'), other.starts_with('+')) {
                (false, false) => None,
                (true, _) => Some((other, right)),
                (false, true) => Some((one, left)),
            };
            if let Some((name, term)) = result {
                if is_explicit(name) && self.is_lone(name) && !self.reported.contains(&name.as_str()) {
                    let fault = self.singleton(name, term.place.0);
                    self.report(name, fault);
                }
                continue;
            }
            if one == other {
                let fault = Diagnostic::new(codes::VACUOUS_EQUATION, format!("`{one} = {other}` is always true"));
                self.faults.push(fault.at(place.0, "").help("remove it"));
                continue;
            }
            // Of two that could be meant, the right side.
            let sides = [(one, left, other), (other, right, one)].into_iter();
            let lone = sides.filter(|(name, ..)| is_explicit(name) && self.is_lone(name));
            let Some((name, term, same)) = lone.max_by_key(|(name, ..)| reads_as_constant(name)) else {
                continue;
            };
            let known = variables.iter().find(|variable| variable.name == *name);
            let is_symbol = known.is_some_and(|variable| base(variable.ty, names) == Some(BaseType::Symbol));
            let fault = vacuous_equation([one, other], (name, same), is_symbol, term.place.0);
            self.report(name, fault);
        }
    }

    fn outside_of_aggregates(&mut self, variables: &'c [Known], guarded: &[bool], names: &Names) {
        for (variable, guarded) in variables.iter().zip(guarded) {
            let name = variable.name.as_str();
            let once = variable.count == 1 && !variable.hidden && is_explicit(name);
            if !once || self.reported.contains(&name) || !self.is_lone(name) {
                continue;
            }
            if *guarded && self.twin(name).is_none() {
                continue;
            }
            let mut fault = self.singleton(name, variable.first);
            let is_symbol = base(variable.ty, names) == Some(BaseType::Symbol);
            if is_symbol && name.len() > 1 && name.starts_with(|first: char| first.is_ascii_uppercase()) {
                fault = fault.help(format!(
                    "if you mean the symbol `{name}`, write it in quotes: `\"{name}\"`"
                ));
            }
            self.report(name, fault);
        }
    }

    fn in_aggregates(&mut self, body: &[&'c ast::Literal]) {
        let mut inside: Vec<(&str, Span)> = Vec::new();
        let mut add = |name, span| inside.push((name, span));
        for term in self.clause.heads.iter().flat_map(|head| &head.terms) {
            variables_of_aggregates(term, false, &mut add);
        }
        for literal in body {
            for term in sides(literal) {
                variables_of_aggregates(term, false, &mut add);
            }
        }
        for &(name, span) in &inside {
            let written = witness::written(name);
            let is_once = match witness::is_shadow(name) {
                true => inside.iter().filter(|(other, _)| *other == name).count() == 1,
                false => self.is_lone(name),
            };
            if !is_once || !is_explicit(written) || self.reported.contains(&name) {
                continue;
            }
            let fault = self.singleton(written, span);
            let fault = match witness::is_shadow(name) {
                true => fault.note(format!(
                    "the `{written}` outside of this aggregate is another variable: it gets its value from the result"
                )),
                false => fault,
            };
            self.report(name, fault);
        }
    }
}

fn is_explicit(name: &str) -> bool {
    !name.starts_with('_')
}

/// Warns of an equation of variables of which `name` occurs nowhere else; `same` is the other one.
fn vacuous_equation(
    [one, other]: [&String; 2],
    (name, same): (&String, &String),
    is_symbol: bool,
    place: Span,
) -> Diagnostic {
    let message = format!("`{one} = {other}` is always true: the variable `{name}` occurs nowhere else");
    // The name that the author may have meant as a symbol.
    let symbol = match reads_as_constant(same) && !reads_as_constant(name) {
        true => same,
        false => name,
    };
    let label = match symbol == name {
        true => "a variable, since it has no quotes",
        false => "",
    };
    let fault = Diagnostic::new(codes::VACUOUS_EQUATION, message).at(place, label);
    if !is_symbol {
        return fault.help("remove the equation");
    }
    let [one, other] = [one, other].map(|side| match side == symbol {
        true => format!("\"{side}\""),
        false => side.clone(),
    });
    fault.help(format!(
        "if you mean the symbol `{symbol}`, write it in quotes: `{one} = {other}`"
    ))
}

/// Calls `each` with the variables in the aggregates of a term except their targets, and with all if the term itself is
/// `inside` of an aggregate.
fn variables_of_aggregates<'c>(term: &'c ast::Term, inside: bool, each: &mut impl FnMut(&'c str, Span)) {
    match &term.kind {
        ast::TermKind::Variable(name) if inside => each(name, term.place.0),
        ast::TermKind::Functor(_, arguments) => {
            for argument in arguments {
                variables_of_aggregates(argument, inside, each);
            }
        }
        ast::TermKind::Cast(inner, _) => variables_of_aggregates(inner, inside, each),
        ast::TermKind::Aggregate(aggregate) => {
            for target in aggregate.target.iter().filter(|_| inside) {
                variables_of_aggregates(target, true, each);
            }
            for term in aggregate.body.iter().flat_map(sides) {
                variables_of_aggregates(term, true, each);
            }
        }
        _ => {}
    }
}

/// Returns the terms of an atom or a comparison.
fn sides(literal: &ast::Literal) -> Vec<&ast::Term> {
    match literal {
        ast::Literal::Atom { atom, .. } => atom.terms.iter().collect(),
        ast::Literal::Compare { left, right, .. } => vec![left, right],
        ast::Literal::Temporal { temporal, .. } => temporal.atoms().flat_map(|atom| &atom.terms).collect(),
        ast::Literal::Any(_) => Vec::new(),
    }
}
