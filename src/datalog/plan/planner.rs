//! The planner: translates a clause to the steps that evaluate it.
//!
//! The planner orders literals greedily: tests first, then the atom that shares bound variables and adds the fewest new
//! ones. It plans a program once before there are rows. [`crate::eval::adapt`] replans clauses when the sizes
//! of predicates are known. Then the atom with the fewest matching rows comes next. Where several atoms lack only the
//! same variable, one leapfrog join can bind it.
// Decision: docs/decisions/evaluation.md#d016

use crate::check::{Atom, Clause, Field, Literal, PredicateId, Term, VarId};
use crate::codes;
use crate::diag::{self, Diagnostic};
use crate::plan::estimate::{Flow, Known, Reckoning, Size, cost_of_parts};
use crate::plan::steps::{
    ChangePlan, ClausePlans, Grouping, IndexId, Indexes, List, Plan, Slot, Source, Step, Version,
};
use crate::syntax::ast::{BaseType, Comparison};
use crate::syntax::functor::Functor;
use crate::value::Value;
use std::sync::Arc;

/// The maximum number of literals in a body and of variables in a clause. Evaluation recurses once per atom, and
/// planning takes cubic time.
pub(crate) const CLAUSE_MAX: usize = 128;

/// A clause with more literals than this has no maintenance plans, so its stratum is always recomputed. A clause needs
/// one such plan per literal, and planning time grows with the number of literals.
const MAINTAINED_LITERALS_MAX: usize = 24;

/// A clause with more literals than this has no alternative plans.
const ALTERNATIVE_LITERALS_MAX: usize = 8;

/// The cost of adding one row to an index, in rows scanned. Sorting costs more, but later commits reuse the index.
const INDEX_ROW: f64 = 1.9;

/// The number of first atoms that planning by size tries: those with the fewest matching rows.
const STARTS_MAX: usize = 3;

/// Whether the clause can be maintained incrementally from the changes of its inputs. A clause with an aggregate
/// cannot: any row may change the aggregate.
pub(crate) fn is_maintainable(clause: &Clause) -> bool {
    let aggregates = |literal: &Literal| matches!(literal, Literal::Aggregate { .. });
    clause.body.len() <= MAINTAINED_LITERALS_MAX && !clause.body.iter().any(aggregates)
}

/// Makes all plans of a clause. `stratum` holds the predicates of the head's stratum in ascending order. `grouping` aggregates the head.
pub(crate) fn plan_clause(
    clause: &Clause,
    stratum: &[PredicateId],
    grouping: Option<&Grouping>,
    indexes: &mut Indexes,
) -> Result<ClausePlans, Diagnostic> {
    check_size(clause)?;
    let recursive: Vec<usize> = (0..clause.body.len())
        .filter(|&position| match &clause.body[position] {
            Literal::Positive(atom) | Literal::Guard(atom) => stratum.binary_search(&atom.predicate).is_ok(),
            _ => false,
        })
        .collect();
    let order = Order::Clause { large: &[] };
    let mut complete = Planner::new(clause, indexes, order).plan(First::Any, &|_| Version::Complete)?;
    if let Some(grouping) = grouping {
        complete = complete.grouped(grouping);
    }
    let (mut deltas, mut alternatives) = (Vec::new(), Vec::new());
    for &delta in &recursive {
        // Each derivation is found once: by the plan of its first atom that matches a new row.
        let version = |position: usize| match position.cmp(&delta) {
            _ if !recursive.contains(&position) => Version::Complete,
            std::cmp::Ordering::Less => Version::Old,
            std::cmp::Ordering::Equal => Version::New,
            std::cmp::Ordering::Greater => Version::All,
        };
        let plan = Planner::new(clause, indexes, order).plan(First::Literal(delta), &version)?;
        let mut others = Vec::new();
        for (position, literal) in clause.body.iter().enumerate() {
            let finished =
                matches!(literal, Literal::Positive(_) | Literal::Guard(_)) && !recursive.contains(&position);
            if !finished || clause.body.len() > ALTERNATIVE_LITERALS_MAX {
                continue;
            }
            let shares =
                |term: Term| term.variable().is_some() && clause.body[delta].terms().any(|other| *other == term);
            let connected = literal.terms().copied().any(shares);
            let first = [
                Some(First::Literal(position)),
                connected.then_some(First::Literals(delta, position)),
            ];
            for first in first.into_iter().flatten() {
                let known = indexes.len();
                let other = Planner::new(clause, indexes, order).plan(first, &version)?;
                // Evaluation must update an index over a growing predicate, so an alternative uses no secondary one.
                let own = |source: &Source| source.version == Version::Complete || indexes.is_own(source.index);
                let sources = |plan: &Plan| plan.steps.iter().flat_map(Step::sources).collect::<Vec<_>>();
                let found = sources(&other);
                // Only a plan over the new rows begins with all of them.
                let begins = first == First::Literals(delta, position);
                let cheap = found.iter().all(own) && (begins || !other.searches_new());
                if cheap && found != sources(&plan) {
                    others.push(other);
                } else {
                    indexes.truncate(known);
                }
            }
        }
        if let Some(atom) = clause.body[delta].atom() {
            deltas.push((atom.predicate, plan));
            alternatives.push(others);
        }
    }
    // In maintenance a recursive predicate is already large; in a computation from scratch it begins empty.
    let (changes, check) = match is_maintainable(clause) && grouping.is_none() {
        true => plan_changes(clause, indexes, Order::Clause { large: stratum })?,
        false => (Vec::new(), None),
    };
    Ok(ClausePlans {
        complete,
        deltas,
        alternatives,
        changes,
        check,
    })
}

/// Makes the plan of a clause of a correlated predicate. It begins with the parameters, which are the first columns of
/// the head.
pub(crate) fn plan_correlated(
    clause: &Clause,
    parameters: usize,
    grouping: Option<&Grouping>,
    indexes: &mut Indexes,
    order: Order<'_>,
) -> Result<Plan, Diagnostic> {
    check_size(clause)?;
    let first = First::Parameters(parameters);
    let plan = Planner::new(clause, indexes, order).plan(first, &|_| Version::Complete)?;
    Ok(match grouping {
        Some(grouping) => plan.grouped(grouping),
        None => plan,
    })
}

/// Fails if the clause has too many literals or variables.
fn check_size(clause: &Clause) -> Result<(), Diagnostic> {
    let counts = [("literals", clause.body.len()), ("variables", clause.variables.len())];
    let large = counts.into_iter().find(|(_, count)| *count > CLAUSE_MAX);
    large.map_or(Ok(()), |(what, count)| Err(too_large(clause, what, count)))
}

/// The diagnostic for a clause that is too large.
pub(crate) fn too_large(clause: &Clause, what: &str, count: usize) -> Diagnostic {
    let message = format!("the clause has {count} {what}; the maximum is {CLAUSE_MAX}");
    let fault = Diagnostic::new(diag::codes::LIMIT_EXCEEDED, message).at(clause.span, "");
    match what {
        "literals" if count > clause.body.len() => fault.note("those of the aggregates evaluated in place count, too"),
        _ => fault,
    }
}

/// Makes the maintenance plans.
pub(crate) fn plan_changes(
    clause: &Clause,
    indexes: &mut Indexes,
    order: Order<'_>,
) -> Result<(Vec<ChangePlan>, Option<Plan>), Diagnostic> {
    let mut changes = Vec::new();
    for (position, literal) in clause.body.iter().enumerate() {
        let Some(atom) = literal.atom() else { continue };
        let version = |other: usize| {
            if other == position {
                Version::New
            } else {
                Version::Complete
            }
        };
        changes.push(ChangePlan {
            over: atom.predicate,
            negated: matches!(literal, Literal::Negative(_)),
            plan: Planner::new(clause, indexes, order).plan(First::Change(position), &version)?,
        });
    }
    let check = Planner::new(clause, indexes, order).plan(First::Head, &|_| Version::Complete)?;
    Ok((changes, Some(check)))
}

/// Returns the cheapest plan over finished predicates of known sizes. It tries the [`STARTS_MAX`] first atoms with the
/// fewest matching rows.
pub(crate) fn plan_complete(clause: &Clause, indexes: &mut Indexes, sizes: &[Option<Size>]) -> Option<Plan> {
    let order = Order::Sizes(sizes);
    let planner = Planner::new(clause, indexes, order);
    let found = |position: usize| Some((planner.found(positive(&clause.body[position])?), position));
    let mut starts: Vec<(f64, usize)> = (0..clause.body.len()).filter_map(found).collect();
    starts.sort_by(|a, b| a.0.total_cmp(&b.0));
    starts.truncate(STARTS_MAX);
    let version = |_| Version::Complete;
    if starts.len() > 1 {
        for (cost, start) in &mut starts {
            let known = indexes.len();
            *cost = Planner::new(clause, indexes, order)
                .run(First::Literal(*start), &version)
                .ok()?
                .1;
            indexes.truncate(known);
        }
        starts.sort_by(|a, b| a.0.total_cmp(&b.0));
    }
    let first = starts.first().map_or(First::Any, |&(_, start)| First::Literal(start));
    let (plan, _) = Planner::new(clause, indexes, order).run(first, &version).ok()?;
    Some(plan)
}

/// The first step of a plan.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum First {
    /// The planner's choice.
    Any,
    /// The atom of the literal at this position of the body.
    Literal(usize),
    /// The atoms of these two literals, in this order. The second becomes a test if the first binds all its variables.
    Literals(usize, usize),
    /// Like `Literal`, but skips heads that are already known. A negated atom with wildcards is tested as well.
    Change(usize),
    /// Head rows.
    Head,
    /// The values of this number of parameters: the first columns of the head.
    Parameters(usize),
}

/// The criterion that orders atoms.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Order<'a> {
    /// By the clause alone. The predicates in `large` are probably larger than the others.
    Clause { large: &'a [PredicateId] },
    /// By the sizes of predicates. The sizes of all predicates in the body are known.
    Sizes(&'a [Option<Size>]),
}

/// The next step to place.
enum Next {
    /// Scan the atom of this literal.
    Scan(usize),
    /// Leapfrog-join the atoms of these literals. The variable is the only one that they lack.
    LeapfrogJoin(Vec<usize>, VarId),
}

struct Planner<'a> {
    clause: &'a Clause,
    indexes: &'a mut Indexes,
    order: Order<'a>,
    /// The expected number of rows at this point of the plan.
    flow: Flow,
    slots: Vec<Value>,
    /// Indexed by variable.
    bound: Vec<bool>,
    /// Indexed by variable: the number of its occurrences in the head and in the literals still to be placed.
    uses: Vec<usize>,
    /// Positions of the literals still to be placed, in source order.
    left: Vec<usize>,
    steps: Vec<Step>,
    /// The cost of the secondary indexes that the plan needs; 0 if sizes are unknown.
    ordering: f64,
    /// Indexed by step: the estimate after it.
    trail: Vec<Reckoning>,
    /// Whether a scan precedes, so that the next step may run many times.
    repeated: bool,
}

impl<'a> Planner<'a> {
    fn new(clause: &'a Clause, indexes: &'a mut Indexes, order: Order<'a>) -> Self {
        let mut uses = vec![0; clause.variables.len()];
        let terms = clause
            .head
            .terms
            .iter()
            .chain(clause.body.iter().flat_map(Literal::terms));
        terms
            .filter_map(Term::variable)
            .for_each(|variable| uses[variable.index()] += 1);
        Planner {
            clause,
            indexes,
            order,
            flow: Flow::new(clause.variables.len()),
            slots: vec![Value(0); clause.variables.len()],
            bound: vec![false; clause.variables.len()],
            uses,
            left: (0..clause.body.len()).collect(),
            steps: Vec::new(),
            ordering: 0.0,
            trail: Vec::new(),
            repeated: false,
        }
    }

    fn plan(self, first: First, version: &dyn Fn(usize) -> Version) -> Result<Plan, Diagnostic> {
        self.run(first, version).map(|(plan, _)| plan)
    }

    /// Returns the plan and, if sizes are known, the estimated number of rows it scans.
    fn run(mut self, first: First, version: &dyn Fn(usize) -> Version) -> Result<(Plan, f64), Diagnostic> {
        let clause = self.clause;
        let head = &clause.head;
        let head_variables: Vec<VarId> = head.terms.iter().filter_map(Term::variable).collect();
        let mut fresh = None;
        let mut second = match first {
            First::Literals(_, second) => Some(second),
            _ => None,
        };
        let mut next = match first {
            First::Literal(position) | First::Literals(position, _) | First::Change(position) => {
                Some(Next::Scan(position))
            }
            First::Any | First::Head | First::Parameters(_) => None,
        };
        if first == First::Head {
            self.scan(head, Version::New);
        } else if let First::Parameters(count) = first {
            let terms = head.terms[..count].to_vec();
            // The body need not use a parameter that is aggregated itself.
            let parameters = terms.iter().filter_map(Term::variable);
            parameters.for_each(|variable| self.uses[variable.index()] += 1);
            self.scan(&Atom { terms, ..head.clone() }, Version::New);
        }
        loop {
            match next {
                Some(Next::Scan(position)) => {
                    let literal = &clause.body[position];
                    let atom = literal.atom();
                    if let Some(atom) = atom {
                        self.scan(atom, version(position));
                    }
                    // A negated atom with wildcards stays: another row may match its other columns.
                    let open = atom.is_some_and(|atom| atom.terms.contains(&Term::Wildcard));
                    if !(open && matches!(literal, Literal::Negative(_))) {
                        self.placed(position);
                    }
                }
                Some(Next::LeapfrogJoin(positions, variable)) => self.leapfrog_join(&positions, variable, version),
                None => {}
            }
            let known = |planner: &Self| head_variables.iter().all(|variable| planner.bound[variable.index()]);
            // Test as early as possible whether the head is known: it usually is.
            for tests_placed in [false, true] {
                if matches!(first, First::Change(_)) && fresh.is_none() && known(&self) {
                    fresh = Some(self.steps.len());
                    let key = head.terms.iter().filter_map(|term| self.slot(term)).collect();
                    let (index, version) = (IndexId(head.predicate.0), Version::Complete);
                    let source = Source { index, version };
                    self.push(Step::AntiJoin { source, key });
                }
                if !tests_placed {
                    self.place_tests(version);
                }
            }
            next = match second.take().filter(|second| self.left.contains(second)) {
                Some(second) => Some(Next::Scan(second)),
                None => self.next(),
            };
            if next.is_none() {
                break;
            }
        }
        if !self.left.is_empty() || !head_variables.iter().all(|variable| self.bound[variable.index()]) {
            return Err(self.unbound());
        }
        let output: Vec<Slot> = head.terms.iter().filter_map(|term| self.slot(term)).collect();
        let plan = Plan {
            head: head.predicate,
            enough: enough(&self.steps, &output),
            output,
            fold: None,
            steps: self.steps,
            slots: self.slots,
            fresh,
        };
        let cost = self.ordering + cost_of_parts(&self.trail, &plan.enough);
        Ok((plan, cost))
    }

    /// Appends a step after the flow has accounted for it.
    fn push(&mut self, step: Step) {
        self.steps.push(step);
        self.trail.push(self.flow.reckoning());
    }

    /// The diagnostic for an unsafe clause. The checker rejects such clauses first.
    fn unbound(&self) -> Diagnostic {
        let names = self.clause.variables.iter().zip(&self.bound);
        let names: Vec<String> = names
            .filter(|(_, bound)| !**bound)
            .map(|(name, _)| format!("`{name}`"))
            .collect();
        let message = format!("no positive atom binds {}", names.join(", "));
        Diagnostic::new(codes::UNBOUND_VARIABLE, message).at(self.clause.span, "")
    }

    /// The slot of a term; `None` for a wildcard.
    fn slot(&mut self, term: &Term) -> Option<Slot> {
        match *term {
            Term::Variable(variable) => Some(variable.index() as Slot),
            Term::Constant(value) => {
                let first = self.clause.variables.len();
                let known = self.slots[first..].iter().position(|&constant| constant == value);
                let position = known.unwrap_or_else(|| {
                    self.slots.push(value);
                    self.slots.len() - 1 - first
                });
                Some((first + position) as Slot)
            }
            Term::Wildcard => None,
        }
    }

    fn is_bound(&self, term: &Term) -> bool {
        term.variable().is_none_or(|variable| self.bound[variable.index()])
    }

    /// Places every literal whose variables are bound and that needs no scan.
    fn place_tests(&mut self, version: &dyn Fn(usize) -> Version) {
        // Placing an equality can make an earlier literal ready, so search again after each placement. Prefer
        // comparisons to lookups, and narrow rows to wide ones.
        let clause = self.clause;
        let cost = |position: usize| clause.body[position].atom().map_or(0, |atom| atom.terms.len());
        let ready = |planner: &Self| {
            let ready = planner
                .left
                .iter()
                .copied()
                .filter(|&position| planner.is_ready(position));
            ready.min_by_key(|&position| cost(position))
        };
        loop {
            let Some(position) = ready(self) else {
                match self.place_record() {
                    true => continue,
                    false => break,
                }
            };
            self.placed(position);
            match &self.clause.body[position] {
                Literal::Positive(atom) | Literal::Guard(atom) => {
                    self.expect(atom, |flow, size, key| flow.exists(size, key));
                    let (source, key) = self.lookup(atom, version(position));
                    self.push(Step::Exists { source, key });
                }
                Literal::Negative(atom) => {
                    self.expect(atom, |flow, size, key| flow.absent(size, key));
                    let (source, key) = self.lookup(atom, Version::Complete);
                    self.push(Step::AntiJoin { source, key });
                }
                Literal::Compare {
                    op, left, right, base, ..
                } => self.compare(*op, left, right, *base),
                Literal::Compute {
                    to,
                    functor,
                    base,
                    arguments,
                    ..
                } => {
                    let arguments = arguments.iter().filter_map(|argument| self.slot(argument)).collect();
                    let Some((to, test)) = self.result(to) else { continue };
                    self.push(Step::Compute {
                        functor: *functor,
                        base: *base,
                        arguments,
                        to,
                        test,
                    });
                }
                Literal::Aggregate {
                    to,
                    op,
                    base,
                    atom,
                    column,
                } => {
                    let (op, base) = (*op, *base);
                    if let Some(plans) = self.indexes.correlated(atom.predicate).map(Arc::clone) {
                        let key = atom.terms.iter().filter_map(|term| self.slot(term)).collect();
                        let Some((to, test)) = self.result(to) else { continue };
                        self.push(Step::Correlated {
                            predicate: atom.predicate,
                            plans,
                            key,
                            op,
                            base,
                            column: *column,
                            to,
                            test,
                        });
                        continue;
                    }
                    let (source, key) = self.rows(atom);
                    let Some((to, test)) = self.result(to) else { continue };
                    let columns = &self.indexes[source.index].columns;
                    let place = column.and_then(|column| columns.iter().position(|other| *other as usize == column));
                    let column = place.unwrap_or(0) as u16;
                    self.push(match self.indexes.is_grouped(atom.predicate) {
                        true => Step::Group {
                            source,
                            key,
                            op,
                            base,
                            to,
                            test,
                        },
                        false => Step::Aggregate {
                            source,
                            key,
                            op,
                            base,
                            column,
                            to,
                            test,
                        },
                    });
                }
            }
        }
    }

    /// Replaces the literals that take a record apart by a search for the record, if all its fields are bound. The
    /// record can then be the key of a scan. Returns whether there is such a record.
    ///
    /// ```text
    /// A(x, y), B(r), x = field 0 of r, y = field 1 of r
    /// ```
    fn place_record(&mut self) -> bool {
        let clause = self.clause;
        let read = |position: &usize| clause.body[*position].field()?.record.variable();
        let unbound = |record: &VarId| !self.bound[record.index()] && is_stored(clause, *record);
        let mut records = self.left.iter().filter_map(read).filter(unbound);
        let Some((record, fields)) = records.find_map(|record| Some((record, self.known_fields(record)?))) else {
            return false;
        };
        let shape = Term::Constant(Value(fields[0].1.shape.0));
        let terms = std::iter::once(shape).chain(fields.iter().map(|(_, field)| field.value));
        let arguments = terms.filter_map(|term| self.slot(&term)).collect();
        fields.iter().for_each(|(position, _)| self.placed(*position));
        self.bound[record.index()] = true;
        self.push(Step::Compute {
            functor: Functor::Find,
            base: BaseType::Record,
            arguments,
            to: record.index() as Slot,
            test: false,
        });
        true
    }

    /// Returns the fields of a record in order, with the positions of their literals; `None` unless all are bound.
    fn known_fields(&self, record: VarId) -> Option<Vec<(usize, Field)>> {
        let field = |&position: &usize| Some((position, self.clause.body[position].field()?));
        let own = |(_, field): &(usize, Field)| field.record == Term::Variable(record);
        let mut fields: Vec<_> = self.left.iter().filter_map(field).filter(own).collect();
        fields.sort_by_key(|(_, field)| field.at);
        fields.dedup_by_key(|(_, field)| field.at);
        let shape = fields.first()?.1.shape;
        let is_known =
            |field: &Field| field.shape == shape && self.is_bound(&field.value) && field.value != Term::Wildcard;
        let is_whole = self.indexes.fields(shape) == Some(fields.len());
        (is_whole && fields.iter().all(|(_, field)| is_known(field))).then_some(fields)
    }

    fn is_ready(&self, position: usize) -> bool {
        match &self.clause.body[position] {
            Literal::Positive(atom) | Literal::Guard(atom) => {
                let terms = || atom.terms.iter();
                terms().all(|term| self.is_bound(term) || self.is_unneeded(term))
            }
            Literal::Negative(atom) | Literal::Aggregate { atom, .. } => {
                atom.terms.iter().all(|term| self.is_bound(term))
            }
            Literal::Compute { arguments, .. } => arguments.iter().all(|argument| self.is_bound(argument)),
            Literal::Compare {
                op: Comparison::Equal,
                left,
                right,
                ..
            } => self.is_bound(left) || self.is_bound(right),
            Literal::Compare { left, right, .. } => self.is_bound(left) && self.is_bound(right),
        }
    }

    /// Whether any value matches a term of a literal still to be placed. The term is a wildcard, or an unbound variable
    /// that occurs nowhere else in the rest of the clause.
    fn is_unneeded(&self, term: &Term) -> bool {
        term.variable()
            .is_none_or(|variable| !self.bound[variable.index()] && self.uses[variable.index()] == 1)
            && !matches!(term, Term::Constant(_))
    }

    /// Removes a literal from those still to be placed.
    fn placed(&mut self, position: usize) {
        self.left.retain(|&other| other != position);
        for variable in self.clause.body[position].terms().filter_map(Term::variable) {
            self.uses[variable.index()] -= 1;
        }
    }

    /// The source and key of a test. Each column is bound or matches any value.
    fn lookup(&mut self, atom: &Atom, version: Version) -> (Source, Vec<Slot>) {
        let bound = |&column: &u16| {
            let term = &atom.terms[column as usize];
            *term != Term::Wildcard && self.is_bound(term)
        };
        let columns: Vec<u16> = (0..atom.terms.len() as u16).filter(bound).collect();
        let (index, order) = self.indexes.prefix(atom.predicate, [&columns, &[]]);
        let key = order[..columns.len()]
            .iter()
            .filter_map(|&column| self.slot(&atom.terms[column as usize]))
            .collect();
        (Source { index, version }, key)
    }

    /// The source and key of an aggregate: an index of all columns that begins with the bound ones.
    fn rows(&mut self, atom: &Atom) -> (Source, Vec<Slot>) {
        let bound = |&column: &u16| atom.terms[column as usize] != Term::Wildcard;
        let known: Vec<u16> = (0..atom.terms.len() as u16).filter(bound).collect();
        let (index, order) = self.indexes.prefix(atom.predicate, [&known, &[]]);
        let key = (order[..known.len()].iter())
            .filter_map(|&column| self.slot(&atom.terms[column as usize]))
            .collect();
        let version = Version::Complete;
        (Source { index, version }, key)
    }

    /// The slot for a computed value, and whether it is already bound.
    fn result(&mut self, to: &Term) -> Option<(Slot, bool)> {
        let test = self.is_bound(to);
        if test {
            self.flow.filter(Flow::EQUAL);
        }
        let slot = self.slot(to)?;
        if let Some(variable) = to.variable() {
            self.bound[variable.index()] = true;
        }
        Some((slot, test))
    }

    fn compare(&mut self, op: Comparison, left: &Term, right: &Term, base: BaseType) {
        let bound = (self.is_bound(left), self.is_bound(right));
        let (Some(left), Some(right)) = (self.slot(left), self.slot(right)) else {
            return;
        };
        let (to, from) = match bound {
            (true, true) => {
                self.flow.filter(match op {
                    Comparison::Equal => Flow::EQUAL,
                    _ => Flow::COMPARED,
                });
                self.push(Step::Compare { op, left, right, base });
                return;
            }
            (false, _) => (left, right),
            (true, false) => (right, left),
        };
        self.bound[to as usize] = true;
        self.push(Step::Copy { to, from });
    }

    /// Chooses the next scan or leapfrog join. It prefers atoms that share a bound variable. Then it prefers, in this
    /// order: the fewest matching rows (if sizes are known), the fewest new variables, the most bound columns, and
    /// predicates that are not probably large.
    fn next(&self) -> Option<Next> {
        let cost = |position: usize| {
            let atom = positive(&self.clause.body[position])?;
            let new = self.new_variables(atom).len();
            let known = (atom.terms.iter())
                .filter(|term| **term != Term::Wildcard && self.is_bound(term))
                .count();
            let (found, large) = match self.order {
                Order::Clause { large } => (0.0, large.contains(&atom.predicate)),
                Order::Sizes(_) => (self.found(atom), false),
            };
            // An atom that matches at most one row may come anywhere.
            let apart = known == 0 && !(matches!(self.order, Order::Sizes(_)) && found <= 1.0);
            Some((apart, found, new, std::cmp::Reverse(known), large, position))
        };
        let best = (self.left.iter())
            .filter_map(|&position| cost(position))
            .min_by(|a, b| {
                (a.0.cmp(&b.0).then(a.1.total_cmp(&b.1))).then((a.2, a.3, a.4, a.5).cmp(&(b.2, b.3, b.4, b.5)))
            })?
            .5;
        Some(self.next_leapfrog_join(best).unwrap_or(Next::Scan(best)))
    }

    /// Returns a leapfrog join in place of the scan of `best`, if several atoms lack only its variable and the join is
    /// cheaper. With skewed rows, a scan of any one list may return many more rows than the intersection has.
    fn next_leapfrog_join(&self, best: usize) -> Option<Next> {
        let Order::Sizes(sizes) = self.order else { return None };
        let [variable] = self.new_variables(positive(&self.clause.body[best])?)[..] else {
            return None;
        };
        let once = |atom: &Atom| {
            (atom.terms.iter())
                .filter(|term| term.variable() == Some(variable))
                .count()
                == 1
        };
        let lacks = |position: &usize| {
            let atom = positive(&self.clause.body[*position]);
            atom.is_some_and(|atom| self.new_variables(atom) == [variable] && once(atom))
        };
        let lists: Vec<usize> = self.left.iter().copied().filter(lacks).collect();
        if lists.len() < 2 {
            return None;
        }
        let atoms = || {
            lists
                .iter()
                .filter_map(|&position| positive(&self.clause.body[position]))
        };
        let least = |cost: &dyn Fn(&Atom, &Size) -> f64| {
            let costs = atoms().filter_map(|atom| Some(cost(atom, sizes[atom.predicate.index()].as_ref()?)));
            costs.fold(f64::INFINITY, f64::min)
        };
        let count = lists.len() as f64;
        let scanned = 1.0 + count * least(&|atom, size| self.flow.found_often(size, &self.key(atom)));
        let joined = count * (1.0 + least(&|atom, size| self.flow.found(size, &self.key(atom))));
        (joined < scanned).then_some(Next::LeapfrogJoin(lists, variable))
    }

    /// The unbound variables of the atom that the rest of the clause needs, without duplicates.
    fn new_variables(&self, atom: &Atom) -> Vec<VarId> {
        let needed = |term: &&Term| !self.is_bound(term) && !self.is_unneeded(term);
        let mut new: Vec<VarId> = atom.terms.iter().filter(needed).filter_map(Term::variable).collect();
        new.sort_unstable();
        new.dedup();
        new
    }

    /// The bound columns of an atom with their variables, or `None` for a constant.
    fn key(&self, atom: &Atom) -> Vec<Known> {
        let known = |term: &Term| *term != Term::Wildcard && self.is_bound(term);
        let columns = (0..).zip(&atom.terms).filter(|(_, term)| known(term));
        columns.map(|(column, term)| (column, term.variable())).collect()
    }

    /// The estimated number of rows that match the atom; 0 if sizes are unknown.
    fn found(&self, atom: &Atom) -> f64 {
        match self.order {
            Order::Sizes(sizes) => {
                let size = sizes[atom.predicate.index()].as_ref();
                size.map_or(0.0, |size| self.flow.found(size, &self.key(atom)))
            }
            Order::Clause { .. } => 0.0,
        }
    }

    /// Updates the estimate for an atom about to be placed, if sizes are known.
    fn expect(&mut self, atom: &Atom, reckon: impl Fn(&mut Flow, &Size, &[Known])) {
        if let Order::Sizes(sizes) = self.order
            && let Some(size) = &sizes[atom.predicate.index()]
        {
            let key = self.key(atom);
            reckon(&mut self.flow, size, &key);
        }
    }

    /// Appends a leapfrog join of the atoms of these literals, which lack only the variable.
    fn leapfrog_join(&mut self, positions: &[usize], variable: VarId, version: &dyn Fn(usize) -> Version) {
        let mut lists = Vec::with_capacity(positions.len());
        for &position in positions {
            let Some(atom) = positive(&self.clause.body[position]) else {
                continue;
            };
            let place = (0..)
                .zip(&atom.terms)
                .find(|(_, term)| term.variable() == Some(variable));
            let Some((column, _)) = place else { continue };
            let known: Vec<u16> = self.key(atom).iter().map(|&(column, _)| column).collect();
            let (index, order) = self.indexes.prefix(atom.predicate, [&known, &[column]]);
            let key = (order[..known.len()].iter())
                .filter_map(|&column| self.slot(&atom.terms[column as usize]))
                .collect();
            let source = Source {
                index,
                version: version(position),
            };
            lists.push(List { source, key });
        }
        if let Order::Sizes(sizes) = self.order {
            let atoms = positions
                .iter()
                .filter_map(|&position| positive(&self.clause.body[position]));
            let sized = atoms.filter_map(|atom| Some((sizes[atom.predicate.index()].as_ref()?, self.key(atom))));
            let sized: Vec<_> = sized.collect();
            self.flow.leapfrog_join(&sized, variable);
        }
        self.bound[variable.index()] = true;
        positions.iter().for_each(|&position| self.placed(position));
        self.push(Step::LeapfrogJoin {
            lists,
            to: variable.index() as Slot,
        });
        self.repeated = true;
    }

    /// Appends a scan of the atom.
    fn scan(&mut self, atom: &Atom, version: Version) {
        // (column, slot) of every column whose value matters.
        let mut keys: Vec<(u16, Slot)> = Vec::new();
        let mut binds: Vec<(u16, Slot)> = Vec::new();
        let mut checks: Vec<(u16, Slot)> = Vec::new();
        for (column, term) in (0u16..).zip(&atom.terms) {
            let bound = self.is_bound(term);
            let unneeded = self.is_unneeded(term);
            let Some(slot) = self.slot(term) else { continue };
            if bound {
                keys.push((column, slot));
            } else if binds.iter().any(|&(_, other)| other == slot) {
                checks.push((column, slot));
            } else if !unneeded {
                binds.push((column, slot));
            }
        }
        if version != Version::New {
            self.expect(atom, |flow, size, key| flow.scan(size, key, &binds));
        }
        for &(_, slot) in &binds {
            self.bound[slot as usize] = true;
        }
        let own = IndexId(atom.predicate.0);
        let mut distinct = 0;
        let index = if self.repeated && version != Version::New && !keys.is_empty() {
            let known: Vec<u16> = keys.iter().map(|&(column, _)| column).collect();
            let other: Vec<u16> = binds.iter().chain(&checks).map(|&(column, _)| column).collect();
            let (index, order) = self.indexes.prefix(atom.predicate, [&known, &other]);
            if let (false, Order::Sizes(sizes)) = (self.indexes.is_own(index), self.order) {
                let rows = sizes[atom.predicate.index()].as_ref().map_or(0, |size| size.rows);
                self.ordering += INDEX_ROW * rows as f64;
            }
            for (column, _) in keys.iter_mut().chain(&mut binds).chain(&mut checks) {
                *column = (order.iter().position(|other| other == column)).map_or(*column, |position| position as u16);
            }
            // The key follows the column order of the index.
            keys.sort_unstable_by_key(|&(column, _)| column);
            let needed = known.len() + other.len();
            if needed < order.len() {
                distinct = needed as u16;
            }
            index
        } else {
            // A scan that runs once, or without bound columns, does not repay an index. The primary index may still
            // begin with bound columns.
            let prefix = if version == Version::New && !self.repeated {
                0
            } else {
                (0..).zip(&keys).take_while(|(at, key)| *at == key.0).count()
            };
            if prefix < keys.len() && version != Version::New {
                self.expect(atom, |flow, size, _| flow.passes(size));
            }
            checks.extend(keys.drain(prefix..));
            own
        };
        self.push(Step::Scan {
            source: Source { index, version },
            key: keys.into_iter().map(|(_, slot)| slot).collect(),
            bind: binds,
            check: checks,
            distinct,
        });
        self.repeated = true;
    }
}

/// Indexed by step: the end of the existential group that begins with it, or 0. See [`Plan::enough`].
fn enough(steps: &[Step], output: &[Slot]) -> Vec<u16> {
    let ends_at = |start: usize| {
        let mut filled = Vec::new();
        (start + 1..=steps.len()).find(|&end| {
            filled.extend(steps[end - 1].fills());
            let needed = |slot: &Slot| output.contains(slot) || steps[end..].iter().any(|step| step.reads(*slot));
            !filled.iter().any(needed)
        })
    };
    let parts = (0..steps.len()).map(|start| match steps[start].branches() {
        true => ends_at(start).unwrap_or(0) as u16,
        false => 0,
    });
    parts.collect()
}

/// Whether every value of the variable is in a row, or in a record that is in a row.
fn is_stored(clause: &Clause, variable: VarId) -> bool {
    let mut waiting = vec![variable];
    let mut next = 0;
    while let Some(&variable) = waiting.get(next) {
        next += 1;
        let same = Term::Variable(variable);
        for literal in &clause.body {
            let other = match literal {
                Literal::Positive(atom) | Literal::Guard(atom) if atom.terms.contains(&same) => return true,
                Literal::Compare {
                    op: Comparison::Equal,
                    left,
                    right,
                    ..
                } if *left == same => right.variable(),
                Literal::Compare {
                    op: Comparison::Equal,
                    left,
                    right,
                    ..
                } if *right == same => left.variable(),
                _ => (literal.field().filter(|field| field.value == same)).and_then(|field| field.record.variable()),
            };
            waiting.extend(other.filter(|other| !waiting.contains(other)));
        }
    }
    false
}

/// The atom of a literal that may bind variables.
fn positive(literal: &Literal) -> Option<&Atom> {
    match literal {
        Literal::Positive(atom) | Literal::Guard(atom) => Some(atom),
        _ => None,
    }
}
