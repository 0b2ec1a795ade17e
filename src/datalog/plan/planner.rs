//! From a clause to the steps that evaluate it.
//!
//! Literals are ordered greedily: tests first, then the atom that shares bound variables and adds the fewest new ones. A program
//! is planned once, before there are any rows, and clauses are planned again when there are ([`crate::datalog::eval::adapt`]): then the atom that
//! finds the fewest rows comes next, and where several atoms wait for the same last variable, one step *meets* them all.

use crate::datalog::check::{Atom, Clause, Literal, RelId, Term, VarId};
use crate::datalog::plan::estimate::{Flow, Known, Reckoning, Size, cost_of_parts};
use crate::datalog::plan::steps::{ChangePlan, ClausePlans, IndexId, Indexes, List, Plan, Slot, Source, Step, Version};
use crate::datalog::syntax::ast::{BaseType, Comparison};
use crate::datalog::value::Value;
use crate::diag::{Code, Diagnostic};

/// At most this many literals in a body and this many variables in a clause: evaluation recurses once per atom, and planning
/// takes cubic time.
pub(crate) const CLAUSE_MAX: usize = 128;

/// A clause with more literals than this has no plans for maintenance, since there is one for each and planning one takes longer
/// the more there are. Its stratum is always recomputed.
const MAINTAINED_LITERALS_MAX: usize = 24;

/// A clause with more literals than this has no alternatives.
const ALTERNATIVE_LITERALS_MAX: usize = 8;

/// Putting a row into another order costs as much as looking at so many. Sorting costs more, but the order serves later commits.
const INDEX_ROW: f64 = 1.9;

/// So many atoms to begin with are tried when a clause is planned by sizes: those that find the fewest rows.
const STARTS_MAX: usize = 3;

/// Whether the change of the clause's rows can be had from the change of its inputs. An aggregate may change with any row.
pub(crate) fn is_maintainable(clause: &Clause) -> bool {
    let aggregates = |literal: &Literal| matches!(literal, Literal::Aggregate { .. });
    clause.body.len() <= MAINTAINED_LITERALS_MAX && !clause.body.iter().any(aggregates)
}

/// All plans of a clause. `stratum` holds the relations computed together with its head.
pub(crate) fn plan_clause(
    clause: &Clause,
    stratum: &[RelId],
    indexes: &mut Indexes,
) -> Result<ClausePlans, Diagnostic> {
    for (what, count) in [("literals", clause.body.len()), ("variables", clause.variables.len())] {
        if count > CLAUSE_MAX {
            let message = format!("the clause has {count} {what}; at most {CLAUSE_MAX} are possible");
            return Err(Diagnostic::new(Code::LIMIT_EXCEEDED, message).at(clause.span, ""));
        }
    }
    let recursive: Vec<usize> = (0..clause.body.len())
        .filter(|&position| match &clause.body[position] {
            Literal::Positive(atom) | Literal::Guard(atom) => stratum.contains(&atom.relation),
            _ => false,
        })
        .collect();
    let order = Order::Text { large: &[] };
    let complete = Planner::new(clause, indexes, order).plan(First::Any, &|_| Version::Complete)?;
    let (mut deltas, mut alternatives) = (Vec::new(), Vec::new());
    for &delta in &recursive {
        // Each derivation is found once: by the plan of its first atom that holds by a new row.
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
            if finished && clause.body.len() <= ALTERNATIVE_LITERALS_MAX {
                let other = Planner::new(clause, indexes, order).plan(First::Literal(position), &version)?;
                // An index over a relation that grows has to be kept up; an alternative must do without.
                let mut sources = other.steps.iter().flat_map(Step::sources);
                let own = |source: Source| source.version == Version::Complete || indexes.is_own(source.index);
                let cheap = sources.all(own) && !other.searches_new();
                drop(sources);
                if cheap {
                    others.push(other);
                }
            }
        }
        if let Some(atom) = clause.body[delta].atom() {
            deltas.push((atom.relation, plan));
            alternatives.push(others);
        }
    }
    // In maintenance a recursive relation is no longer small, as it is when a computation from scratch begins.
    let (changes, check) = match is_maintainable(clause) {
        true => plan_changes(clause, indexes, Order::Text { large: stratum })?,
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

/// The plans for maintenance.
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
            over: atom.relation,
            negated: matches!(literal, Literal::Negative(_)),
            plan: Planner::new(clause, indexes, order).plan(First::Change(position), &version)?,
        });
    }
    let check = Planner::new(clause, indexes, order).plan(First::Head, &|_| Version::Complete)?;
    Ok((changes, Some(check)))
}

/// The plan over finished relations of known sizes that looks at the fewest rows, of those that begin with one of the atoms that
/// find few.
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

/// What a plan begins with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum First {
    /// What is best.
    Any,
    /// The atom of the literal at this position of the body.
    Literal(usize),
    /// The same, to find heads that are not known yet. A negated atom is tested nevertheless if it has wildcards.
    Change(usize),
    /// Rows of the head.
    Head,
}

/// By what atoms are ordered.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Order<'a> {
    /// By what the clause says alone. Some relations are probably larger than others.
    Text { large: &'a [RelId] },
    /// By the sizes of relations, which are known for those in the body.
    Sizes(&'a [Option<Size>]),
}

/// What comes next.
enum Next {
    /// The atom of this literal.
    Scan(usize),
    /// The atoms of these literals, which lack no variable but this one.
    Leapfrog(Vec<usize>, VarId),
}

struct Planner<'a> {
    clause: &'a Clause,
    indexes: &'a mut Indexes,
    order: Order<'a>,
    /// How many rows there are at this point of the plan.
    flow: Flow,
    slots: Vec<Value>,
    /// By variable.
    bound: Vec<bool>,
    /// By variable: how often it occurs in the head and in what is left of the body.
    uses: Vec<usize>,
    /// Positions in the body, in the order of the text.
    left: Vec<usize>,
    steps: Vec<Step>,
    /// What the orders of rows cost that the plan needs besides relations' own; nothing if sizes are not known.
    ordering: f64,
    /// By step: what is expected behind it.
    trail: Vec<Reckoning>,
    /// Whether a scan stands before, so that the next step may run many times.
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
            .filter_map(variable_of)
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

    /// The plan, about how many rows it will look at if sizes are known, and the positions of the literals in the order in which
    /// it comes to them.
    fn run(mut self, first: First, version: &dyn Fn(usize) -> Version) -> Result<(Plan, f64), Diagnostic> {
        let clause = self.clause;
        let head = &clause.head;
        let head_variables: Vec<VarId> = head.terms.iter().filter_map(variable_of).collect();
        let mut fresh = None;
        let mut next = match first {
            First::Literal(position) | First::Change(position) => Some(Next::Scan(position)),
            First::Any | First::Head => None,
        };
        if first == First::Head {
            self.scan(head, Version::New);
        }
        loop {
            match next {
                Some(Next::Scan(position)) => {
                    let literal = &clause.body[position];
                    let atom = literal.atom();
                    if let Some(atom) = atom {
                        self.scan(atom, version(position));
                    }
                    // Another row may have the same values in the other columns.
                    let open = atom.is_some_and(|atom| atom.terms.contains(&Term::Wildcard));
                    if !(open && matches!(literal, Literal::Negative(_))) {
                        self.placed(position);
                    }
                }
                Some(Next::Leapfrog(positions, variable)) => self.leapfrog(&positions, variable, version),
                None => {}
            }
            let known = |planner: &Self| head_variables.iter().all(|variable| planner.bound[variable.index()]);
            // Whether the head is known is asked as early as possible: mostly it is.
            for tests_placed in [false, true] {
                if matches!(first, First::Change(_)) && fresh.is_none() && known(&self) {
                    fresh = Some(self.steps.len());
                    let key = head.terms.iter().filter_map(|term| self.slot(term)).collect();
                    let (index, version) = (IndexId(head.relation.0), Version::Complete);
                    let source = Source { index, version };
                    self.push(Step::AntiJoin { source, key });
                }
                if !tests_placed {
                    self.place_tests(version);
                }
            }
            next = self.next();
            if next.is_none() {
                break;
            }
        }
        if !self.left.is_empty() || !head_variables.iter().all(|variable| self.bound[variable.index()]) {
            return Err(self.unbound());
        }
        let output: Vec<Slot> = head.terms.iter().filter_map(|term| self.slot(term)).collect();
        let plan = Plan {
            head: head.relation,
            enough: enough(&self.steps, &output),
            output,
            steps: self.steps,
            slots: self.slots,
            fresh,
        };
        let cost = self.ordering + cost_of_parts(&self.trail, &plan.enough);
        Ok((plan, cost))
    }

    /// Appends a step with which the flow has been reckoned.
    fn push(&mut self, step: Step) {
        self.steps.push(step);
        self.trail.push(self.flow.reckoning());
    }

    /// What to say of a clause that checking should have refused.
    fn unbound(&self) -> Diagnostic {
        let names = self.clause.variables.iter().zip(&self.bound);
        let names: Vec<String> = names
            .filter(|(_, bound)| !**bound)
            .map(|(name, _)| format!("`{name}`"))
            .collect();
        let message = format!("no positive atom binds {}", names.join(", "));
        Diagnostic::new(Code::UNBOUND_VARIABLE, message).at(self.clause.span, "")
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
        variable_of(term).is_none_or(|variable| self.bound[variable.index()])
    }

    /// Places every literal that binds no variable by a scan and whose variables are bound.
    fn place_tests(&mut self, version: &dyn Fn(usize) -> Version) {
        // An equality may bind what an earlier literal waits for. A comparison costs less than finding a row, and a short row is
        // found faster than a long one.
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
        while let Some(position) = ready(self) {
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
                    let (source, key) = self.rows(atom);
                    let columns = &self.indexes[source.index].columns;
                    let place = column.and_then(|column| columns.iter().position(|other| *other as usize == column));
                    let Some((to, test)) = self.result(to) else { continue };
                    self.push(Step::Aggregate {
                        source,
                        key,
                        op: *op,
                        base: *base,
                        column: place.unwrap_or(0) as u16,
                        to,
                        test,
                    });
                }
            }
        }
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

    /// Whether any value will do for a term of a literal that is still to be placed: a wildcard, or a variable that is not
    /// bound and occurs nowhere else in what is left of the clause.
    fn is_unneeded(&self, term: &Term) -> bool {
        variable_of(term).is_none_or(|variable| !self.bound[variable.index()] && self.uses[variable.index()] == 1)
            && !matches!(term, Term::Constant(_))
    }

    /// Strikes a literal off what is left.
    fn placed(&mut self, position: usize) {
        self.left.retain(|&other| other != position);
        for variable in self.clause.body[position].terms().filter_map(variable_of) {
            self.uses[variable.index()] -= 1;
        }
    }

    /// The source and key of a test. All columns are bound, or any value will do.
    fn lookup(&mut self, atom: &Atom, version: Version) -> (Source, Vec<Slot>) {
        let bound = |&column: &u16| {
            let term = &atom.terms[column as usize];
            *term != Term::Wildcard && self.is_bound(term)
        };
        let columns: Vec<u16> = (0..atom.terms.len() as u16).filter(bound).collect();
        let (index, order) = self.indexes.prefix(atom.relation, [&columns, &[]]);
        let key = order[..columns.len()]
            .iter()
            .filter_map(|&column| self.slot(&atom.terms[column as usize]))
            .collect();
        (Source { index, version }, key)
    }

    /// The source and key of an aggregate: an index of all columns, the bound ones first.
    fn rows(&mut self, atom: &Atom) -> (Source, Vec<Slot>) {
        let bound = |&column: &u16| atom.terms[column as usize] != Term::Wildcard;
        let known: Vec<u16> = (0..atom.terms.len() as u16).filter(bound).collect();
        let (index, order) = self.indexes.prefix(atom.relation, [&known, &[]]);
        let key = (order[..known.len()].iter())
            .filter_map(|&column| self.slot(&atom.terms[column as usize]))
            .collect();
        let version = Version::Complete;
        (Source { index, version }, key)
    }

    /// The slot for a value, and whether something is there already.
    fn result(&mut self, to: &Term) -> Option<(Slot, bool)> {
        let test = self.is_bound(to);
        if test {
            self.flow.filter(Flow::EQUAL);
        }
        let slot = self.slot(to)?;
        if let Some(variable) = variable_of(to) {
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

    /// What to do next: scan an atom that is connected to what is bound, or meet several. If sizes are known, the atom that finds
    /// the fewest rows; then the fewest new variables, then the most bound columns, then one that is not probably large.
    fn next(&self) -> Option<Next> {
        let cost = |position: usize| {
            let atom = positive(&self.clause.body[position])?;
            let new = self.new_variables(atom).len();
            let known = (atom.terms.iter())
                .filter(|term| **term != Term::Wildcard && self.is_bound(term))
                .count();
            let (found, large) = match self.order {
                Order::Text { large } => (0.0, large.contains(&atom.relation)),
                Order::Sizes(_) => (self.found(atom), false),
            };
            // A single row may stand in front of anything.
            let apart = known == 0 && !(matches!(self.order, Order::Sizes(_)) && found <= 1.0);
            Some((apart, found, new, std::cmp::Reverse(known), large, position))
        };
        let best = (self.left.iter())
            .filter_map(|&position| cost(position))
            .min_by(|a, b| {
                (a.0.cmp(&b.0).then(a.1.total_cmp(&b.1))).then((a.2, a.3, a.4, a.5).cmp(&(b.2, b.3, b.4, b.5)))
            })?
            .5;
        Some(self.next_leapfrog(best).unwrap_or(Next::Scan(best)))
    }

    /// Whether the atom had better be met than scanned: several atoms lack nothing but the variable that it lacks, and rows
    /// are so skewed that whichever is scanned may have many more than are left when all have been asked.
    fn next_leapfrog(&self, best: usize) -> Option<Next> {
        let Order::Sizes(sizes) = self.order else { return None };
        let [variable] = self.new_variables(positive(&self.clause.body[best])?)[..] else {
            return None;
        };
        let once = |atom: &Atom| {
            (atom.terms.iter())
                .filter(|term| variable_of(term) == Some(variable))
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
            let costs = atoms().filter_map(|atom| Some(cost(atom, sizes[atom.relation.index()].as_ref()?)));
            costs.fold(f64::INFINITY, f64::min)
        };
        let count = lists.len() as f64;
        let scanned = 1.0 + count * least(&|atom, size| self.flow.found_often(size, &self.key(atom)));
        let met = count * (1.0 + least(&|atom, size| self.flow.found(size, &self.key(atom))));
        (met < scanned).then_some(Next::Leapfrog(lists, variable))
    }

    /// The variables of the atom that are not bound and needed, each once.
    fn new_variables(&self, atom: &Atom) -> Vec<VarId> {
        let needed = |term: &&Term| !self.is_bound(term) && !self.is_unneeded(term);
        let mut new: Vec<VarId> = atom.terms.iter().filter(needed).filter_map(variable_of).collect();
        new.sort_unstable();
        new.dedup();
        new
    }

    /// The bound columns of an atom with their variables; none for a constant.
    fn key(&self, atom: &Atom) -> Vec<Known> {
        let known = |term: &Term| *term != Term::Wildcard && self.is_bound(term);
        let columns = (0..).zip(&atom.terms).filter(|(_, term)| known(term));
        columns.map(|(column, term)| (column, variable_of(term))).collect()
    }

    /// How many rows the atom finds; none if sizes are not known.
    fn found(&self, atom: &Atom) -> f64 {
        match self.order {
            Order::Sizes(sizes) => {
                let size = sizes[atom.relation.index()].as_ref();
                size.map_or(0.0, |size| self.flow.found(size, &self.key(atom)))
            }
            Order::Text { .. } => 0.0,
        }
    }

    /// Reckons with what is about to be placed, if sizes are known.
    fn expect(&mut self, atom: &Atom, reckon: impl Fn(&mut Flow, &Size, &[Known])) {
        if let Order::Sizes(sizes) = self.order
            && let Some(size) = &sizes[atom.relation.index()]
        {
            let key = self.key(atom);
            reckon(&mut self.flow, size, &key);
        }
    }

    /// Appends a step that meets the atoms of these literals, which lack only the variable.
    fn leapfrog(&mut self, positions: &[usize], variable: VarId, version: &dyn Fn(usize) -> Version) {
        let mut lists = Vec::with_capacity(positions.len());
        for &position in positions {
            let Some(atom) = positive(&self.clause.body[position]) else {
                continue;
            };
            let place = (0..)
                .zip(&atom.terms)
                .find(|(_, term)| variable_of(term) == Some(variable));
            let Some((column, _)) = place else { continue };
            let known: Vec<u16> = self.key(atom).iter().map(|&(column, _)| column).collect();
            let (index, order) = self.indexes.prefix(atom.relation, [&known, &[column]]);
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
            let sized = atoms.filter_map(|atom| Some((sizes[atom.relation.index()].as_ref()?, self.key(atom))));
            let sized: Vec<_> = sized.collect();
            self.flow.leapfrog(&sized, variable);
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
        let own = IndexId(atom.relation.0);
        let mut distinct = 0;
        let index = if self.repeated && version != Version::New && !keys.is_empty() {
            let known: Vec<u16> = keys.iter().map(|&(column, _)| column).collect();
            let other: Vec<u16> = binds.iter().chain(&checks).map(|&(column, _)| column).collect();
            let (index, order) = self.indexes.prefix(atom.relation, [&known, &other]);
            if let (false, Order::Sizes(sizes)) = (self.indexes.is_own(index), self.order) {
                let rows = sizes[atom.relation.index()].as_ref().map_or(0, |size| size.rows);
                self.ordering += INDEX_ROW * rows as f64;
            }
            for (column, _) in keys.iter_mut().chain(&mut binds).chain(&mut checks) {
                *column = (order.iter().position(|other| other == column)).map_or(*column, |position| position as u16);
            }
            // The key is read in the order of the index.
            keys.sort_unstable_by_key(|&(column, _)| column);
            let needed = known.len() + other.len();
            if needed < order.len() {
                distinct = needed as u16;
            }
            index
        } else {
            // Run once, or with nothing known: an index would cost more than it saves. The relation's own order may still
            // begin with known columns.
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

/// By step: where a part of the plan ends of which one success is enough, or 0. See [`Plan::enough`].
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

/// The atom of a literal that may bind variables.
fn positive(literal: &Literal) -> Option<&Atom> {
    match literal {
        Literal::Positive(atom) | Literal::Guard(atom) => Some(atom),
        _ => None,
    }
}

fn variable_of(term: &Term) -> Option<VarId> {
    match *term {
        Term::Variable(variable) => Some(variable),
        Term::Constant(_) | Term::Wildcard => None,
    }
}
