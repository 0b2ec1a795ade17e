//! Naive evaluation: the specification of what a program means.
//!
//! The evaluator goes through the strata in order. In each stratum it tries every clause on every combination of rows
//! until it derives nothing new. It shares no code with the real executor and stays unoptimized; tests compare the two.

use crate::chance;
use crate::check::{Atom, Clause, Literal, Past, PastOperator, Predicate, PredicateId, Rules, Stratum, Term};
use crate::symbol::{Symbol, Symbols};
use crate::syntax::ast::{BaseType, Comparison};
use crate::syntax::functor::Functor;
use crate::value::{self, Patterns, Value};
use std::cmp::Ordering;
use std::collections::BTreeSet;

/// All rows that hold, indexed by [`PredicateId`].
pub type Database = Vec<BTreeSet<Vec<Value>>>;

/// The value of each variable of a clause; `None` while unbound.
type Binding = Vec<Option<Value>>;

/// Returns the perfect model of the rules and `facts`. `symbols` must contain every symbol of both. Without a fact for
/// the word of the tick, draws are those of tick 0 and seed 0.
pub fn evaluate(
    rules: &Rules,
    symbols: &Symbols,
    facts: impl IntoIterator<Item = (PredicateId, Vec<Value>)>,
) -> Database {
    let mut database: Database = vec![BTreeSet::new(); rules.predicates.len()];
    for (predicate, row) in facts {
        database[predicate.index()].insert(row);
    }
    if let Some(chance) = rules.chance
        && database[chance.index()].is_empty()
    {
        database[chance.index()].insert(chance::halves(chance::word(0, 0)).map(Value).to_vec());
    }
    for stratum in &rules.strata {
        let predicates = stratum.predicates.iter();
        if predicates
            .map(|id| &rules.predicates[id.index()])
            .any(Predicate::depends_on_rounds)
        {
            by_rounds(rules, stratum, symbols, &mut database);
            continue;
        }
        loop {
            let mut changed = false;
            for &clause in &stratum.clauses {
                let clause = &rules.clauses[clause.index()];
                for row in consequences(rules, clause, symbols, &database) {
                    changed |= database[clause.head.predicate.index()].insert(row);
                }
            }
            if !changed {
                break;
            }
        }
    }
    database
}

/// Evaluates a stratum in rounds: first the clauses that read no predicate of it, then all clauses on the rows of the
/// rounds before. Of the new rows of a round, those with a key that another row has do not hold. Then, in the order of
/// values, each row ceases to hold that another row makes superfluous. The rounds end when a predicate has as many rows as
/// its limit.
fn by_rounds(rules: &Rules, stratum: &Stratum, symbols: &Symbols, database: &mut Database) {
    if let [id] = stratum.predicates[..]
        && let Some(numbering) = &rules.predicates[id.index()].numbering
    {
        let columns = &rules.predicates[id.index()].columns[1..];
        let mut rows: Vec<Vec<Value>> = database[numbering.solutions.index()].iter().cloned().collect();
        rows.sort_by(|one, other| {
            let columns = columns.iter().zip(one.iter().zip(other));
            let orders = columns.map(|(column, (one, other))| value::compare(column.base, *one, *other, symbols));
            orders.fold(Ordering::Equal, Ordering::then)
        });
        let before = numbering.before.iter();
        let mut next: u32 = before.map(|(of, each)| database[of.index()].len() as u32 * each).sum();
        for row in rows {
            database[id.index()].insert([&[Value(next)], &row[..]].concat());
            next += numbering.each;
        }
        return;
    }
    let recursive = |clause: &Clause| {
        let mut atoms = clause.body.iter().filter_map(Literal::atom);
        atoms.any(|atom| stratum.predicates.contains(&atom.predicate))
    };
    // The rows that have ceased to hold.
    let mut gone: Database = vec![BTreeSet::new(); database.len()];
    let pairs: Vec<PredicateId> = (stratum.predicates.iter())
        .filter_map(|id| rules.predicates[id.index()].subsumption)
        .collect();
    let order = |id: PredicateId, one: &[Value], other: &[Value]| {
        let columns = rules.predicates[id.index()].columns.iter().zip(one.iter().zip(other));
        let orders = columns.map(|(column, (one, other))| value::compare(column.base, *one, *other, symbols));
        orders.fold(Ordering::Equal, Ordering::then)
    };
    let mut round = 0;
    loop {
        let mut found: Database = vec![BTreeSet::new(); database.len()];
        for &clause in &stratum.clauses {
            let clause = &rules.clauses[clause.index()];
            if (round > 0 || !recursive(clause)) && !pairs.contains(&clause.head.predicate) {
                found[clause.head.predicate.index()].extend(consequences(rules, clause, symbols, database));
            }
        }
        let mut changed = false;
        for &id in &stratum.predicates {
            let predicate = &rules.predicates[id.index()];
            let held = &mut database[id.index()];
            let new = found[id.index()]
                .difference(held)
                .filter(|row| !gone[id.index()].contains(*row));
            let mut new: Vec<Vec<Value>> = new.cloned().collect();
            new.sort_by(|one, other| order(id, one, other));
            for row in new {
                let agrees =
                    |other: &Vec<Value>, key: &Vec<usize>| key.iter().all(|&column| row[column] == other[column]);
                let is_taken = |key: &Vec<usize>| held.iter().any(|other| agrees(other, key));
                if !predicate.choices.iter().any(is_taken) {
                    changed |= held.insert(row);
                }
            }
        }
        for &id in &stratum.predicates {
            let Some(of) = rules.predicates[id.index()].subsumption else {
                continue;
            };
            let clauses = rules.clauses.iter().filter(|clause| clause.head.predicate == of);
            let pairs: BTreeSet<Vec<Value>> = clauses
                .flat_map(|clause| consequences(rules, clause, symbols, database))
                .collect();
            let held = &mut database[id.index()];
            let mut rows: Vec<Vec<Value>> = held.iter().cloned().collect();
            rows.sort_by(|one, other| order(id, one, other));
            for row in rows {
                let is_stronger = |other: &Vec<Value>| *other != row && pairs.contains(&[&row[..], other].concat());
                if held.iter().any(is_stronger) {
                    held.remove(&row);
                    gone[id.index()].insert(row);
                }
            }
        }
        let is_full = |id: &PredicateId| {
            let limit = rules.predicates[id.index()].size_limit;
            limit.is_some_and(|limit| database[id.index()].len() >= limit)
        };
        if !stratum.recursive || !changed || stratum.predicates.iter().any(is_full) {
            return;
        }
        round += 1;
    }
}

/// Returns the models of successive ticks with these facts, each with all facts of its tick. Draws have seed 0.
pub fn evaluate_ticks(
    rules: &Rules,
    symbols: &Symbols,
    ticks: impl IntoIterator<Item = Vec<(PredicateId, Vec<Value>)>>,
) -> Vec<Database> {
    let mut history: Vec<Database> = Vec::new();
    for mut facts in ticks {
        for past in &rules.pasts {
            let rows = remembered(past, &history);
            facts.extend(rows.into_iter().map(|row| (past.predicate, row)));
        }
        let word = chance::word(0, history.len() as u64);
        facts.extend(
            rules
                .chance
                .map(|chance| (chance, chance::halves(word).map(Value).to_vec())),
        );
        history.push(evaluate(rules, symbols, facts));
    }
    history
}

/// Returns the rows of a hidden predicate in the tick after `history`.
fn remembered(past: &Past, history: &[Database]) -> BTreeSet<Vec<Value>> {
    let now = history.len();
    let held = |predicate: PredicateId, row: &Vec<Value>, tick: usize| history[tick][predicate.index()].contains(row);
    // The ticks of the window, as far as there are ticks.
    let last = past.last.map_or(now, |last| last as usize);
    let window: Vec<usize> = (past.first as usize..=last.min(now)).map(|ago| now - ago).collect();
    let rows = history.iter().flat_map(|database| &database[past.operand.index()]);
    let holds = |row: &&Vec<Value>| match &past.operator {
        // once[a,b] P(x)
        PastOperator::Once => window.iter().any(|&tick| held(past.operand, row, tick)),
        // historically[a,b] P(x), not before the first tick
        PastOperator::Always => last <= now && window.iter().all(|&tick| held(past.operand, row, tick)),
        // Q(x) since[a,b] P(x)
        PastOperator::Since(first, columns) => {
            let key: Vec<Value> = columns.iter().map(|&column| row[column]).collect();
            let still = |since: usize| (since + 1..now).all(|tick| held(*first, &key, tick));
            window.iter().any(|&tick| held(past.operand, row, tick) && still(tick))
        }
    };
    rows.filter(holds).cloned().collect()
}

/// Returns the head rows that a clause of the rules derives from the database.
pub fn consequences(rules: &Rules, clause: &Clause, symbols: &Symbols, database: &Database) -> BTreeSet<Vec<Value>> {
    derived(rules, clause, vec![None; clause.variables.len()], symbols, database)
}

/// Returns the head rows that a clause derives if its variables have these values.
fn derived(
    rules: &Rules,
    clause: &Clause,
    known: Binding,
    symbols: &Symbols,
    database: &Database,
) -> BTreeSet<Vec<Value>> {
    let mut bindings: Vec<Binding> = vec![known];

    // P(x, y): one binding for each row of P that agrees with the bindings so far.
    for literal in &clause.body {
        if let Literal::Positive(atom) | Literal::Guard(atom) = literal {
            let rows = &database[atom.predicate.index()];
            bindings = bindings
                .iter()
                .flat_map(|known| rows.iter().filter_map(|row| unify(atom, row, known)))
                .collect();
        }
    }

    // x = y, x = y + 1, x = sum z : { P(y, z) }: the known side binds the other one. The loop repeats once per literal
    // of the body, the longest possible chain of such literals.
    for _ in &clause.body {
        for known in &mut bindings {
            for literal in &clause.body {
                match literal {
                    Literal::Compare {
                        op: Comparison::Equal,
                        left,
                        right,
                        ..
                    } => {
                        learn(left, value(right, known), known);
                        learn(right, value(left, known), known);
                    }
                    Literal::Compute { to, .. } | Literal::Aggregate { to, .. } => {
                        learn(to, result(rules, literal, known, database, symbols), known);
                    }
                    _ => {}
                }
            }
        }
    }

    // x < y, !P(x, _): tests, once every variable is bound.
    bindings.retain(|known| {
        clause.body.iter().all(|literal| match literal {
            Literal::Positive(_) | Literal::Guard(_) => true,
            Literal::Negative(atom) => !database[atom.predicate.index()]
                .iter()
                .any(|row| unify(atom, row, known).is_some()),
            Literal::Compare {
                op, left, right, base, ..
            } => match (value(left, known), value(right, known)) {
                (Some(left), Some(right)) => compare(*op, left, right, *base, symbols),
                _ => false,
            },
            Literal::Compute { to, .. } | Literal::Aggregate { to, .. } => {
                value(to, known).is_some() && value(to, known) == result(rules, literal, known, database, symbols)
            }
        })
    });

    // P(x, y) :- ...
    let head = |known: &Binding| clause.head.terms.iter().map(|term| value(term, known)).collect();
    bindings.iter().filter_map(head).collect()
}

/// Extends the bindings so that the atom matches the row; `None` if it cannot match.
fn unify(atom: &Atom, row: &[Value], known: &Binding) -> Option<Binding> {
    let mut known = known.clone();
    for (term, &found) in atom.terms.iter().zip(row) {
        match *term {
            Term::Wildcard => {}
            Term::Constant(constant) if constant == found => {}
            Term::Constant(_) => return None,
            Term::Variable(variable) => {
                if *known[variable.index()].get_or_insert(found) != found {
                    return None;
                }
            }
        }
    }
    Some(known)
}

/// Binds `to` to `found` if it is an unbound variable.
fn learn(to: &Term, found: Option<Value>, known: &mut Binding) {
    if let Term::Variable(variable) = to {
        known[variable.index()] = known[variable.index()].or(found);
    }
}

/// Returns the value of an expression or aggregate; `None` if it has none or an operand is unbound.
fn result(rules: &Rules, literal: &Literal, known: &Binding, database: &Database, symbols: &Symbols) -> Option<Value> {
    match literal {
        Literal::Compute {
            functor,
            base,
            arguments,
            ..
        } => {
            let arguments: Option<Vec<Value>> = arguments.iter().map(|argument| value(argument, known)).collect();
            let arguments = arguments?;
            match functor {
                Functor::Call => rules.call(&arguments, symbols).ok()?,
                _ => functor.apply(*base, &arguments, symbols),
            }
        }
        Literal::Aggregate {
            op, base, atom, column, ..
        } => {
            let ready = |term: &Term| *term == Term::Wildcard || value(term, known).is_some();
            if !atom.terms.iter().all(ready) {
                return None;
            }
            let correlated;
            let rows = match rules.is_correlated(atom.predicate) {
                true => {
                    correlated = correlated_rows(rules, atom, known, symbols, database);
                    &correlated
                }
                false => &database[atom.predicate.index()],
            };
            let rows = rows.iter().filter(|row| unify(atom, row, known).is_some());
            op.of(
                *base,
                rows.map(|row| column.map_or(Value(0), |column| row[column])),
                symbols,
            )
        }
        _ => None,
    }
}

/// Returns the rows of a predicate with parameters for the parameters that the binding gives an atom of it.
fn correlated_rows(
    rules: &Rules,
    atom: &Atom,
    known: &Binding,
    symbols: &Symbols,
    database: &Database,
) -> BTreeSet<Vec<Value>> {
    let mut rows = BTreeSet::new();
    for clause in rules
        .clauses
        .iter()
        .filter(|clause| clause.head.predicate == atom.predicate)
    {
        // +1(x, y) :- P(y), y < x. with the value of x.
        let mut inner = vec![None; clause.variables.len()];
        let parameters = rules.predicates[atom.predicate.index()].parameters;
        for (term, actual) in clause.head.terms.iter().zip(&atom.terms).take(parameters) {
            learn(term, value(actual, known), &mut inner);
        }
        rows.extend(derived(rules, clause, inner, symbols, database));
    }
    rows
}

fn value(term: &Term, known: &Binding) -> Option<Value> {
    match *term {
        Term::Constant(constant) => Some(constant),
        Term::Variable(variable) => known[variable.index()],
        Term::Wildcard => None,
    }
}

fn compare(op: Comparison, left: Value, right: Value, base: BaseType, symbols: &Symbols) -> bool {
    let text = |value: Value| symbols.resolve(Symbol(value.0)).unwrap_or_default();
    let less = |left: Value, right: Value| match base {
        BaseType::Number => left.to_number(symbols) < right.to_number(symbols),
        BaseType::Symbol => text(left) < text(right),
        BaseType::Unsigned => left.to_unsigned(symbols) < right.to_unsigned(symbols),
        BaseType::Record => left.0 < right.0,
        BaseType::Float => left.to_float(symbols) < right.to_float(symbols),
    };
    let nan = base == BaseType::Float && [left, right].iter().any(|value| value.to_float(symbols).is_nan());
    match op {
        Comparison::Equal => left == right,
        Comparison::NotEqual => left != right,
        Comparison::Less => less(left, right),
        Comparison::LessEqual => !nan && !less(right, left),
        Comparison::Greater => less(right, left),
        Comparison::GreaterEqual => !nan && !less(left, right),
        Comparison::Contains => text(right).contains(text(left)),
        Comparison::NotContains => !text(right).contains(text(left)),
        Comparison::Match => Patterns::default().matches(left, text(right), symbols),
        Comparison::NotMatch => !Patterns::default().matches(left, text(right), symbols),
    }
}
