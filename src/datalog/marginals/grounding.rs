//! What there may be: a session derives the instances of all clauses that an uncertain row can take part in.

use crate::cancel::Cancel;
use crate::check::{
    Atom, Clause, ClauseId, Column, Draw, Literal, Predicate, PredicateId, Rules, Stratum, Term, TypeId, VarId,
    restratified,
};
use crate::diagram::Formula;
use crate::eval::limits::EvalError;
use crate::marginals::facts::{AskedRows, FactRow, FactTables, asked_rows, find_row};
use crate::program::Program;
use crate::session::Session;
use crate::symbol::Symbols;
use crate::syntax::ast::BaseType;
use crate::value::Value;
use smallvec::SmallVec;
use std::cmp::Ordering;
use std::collections::{BTreeMap, BTreeSet};

/// Why probabilities are estimates.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Inexact {
    /// The decision diagrams would have more nodes than [`MarginalOptions::nodes_max`](super::MarginalOptions::nodes_max).
    TooLarge,
    /// An aggregate ranges over uncertain rows of this predicate, or of a hidden one.
    Aggregate(PredicateId),
    /// Rounds decide which of its uncertain rows hold: it has keys, a limit, a subsumption or numbers.
    Rounds(PredicateId),
}

impl Inexact {
    /// Returns the reason as a sentence without a full stop.
    pub fn show(self, rules: &Rules) -> String {
        match self {
            Inexact::TooLarge => "the formulas of the probabilities are too large".to_owned(),
            Inexact::Aggregate(predicate) => {
                let title = rules.predicates[predicate.index()].title();
                format!("an aggregate ranges over uncertain rows ({title})")
            }
            Inexact::Rounds(predicate) => {
                let title = rules.predicates[predicate.index()].title();
                format!("rounds decide which uncertain rows hold ({title})")
            }
        }
    }
}

/// The maximum number of certain facts that count as uncertain, unless more are grounded in advance.
pub(super) const LIFTED_MAX: usize = 512;

/// A session that derives what there may be, and the clauses of what is uncertain.
pub(super) struct Grounding {
    pub session: Session,
    /// By predicate: whether it is an input of which the session keeps all rows that there ever were.
    pub is_lifted: Vec<bool>,
    /// The number of these rows.
    pub lifted_rows: usize,
    /// Whether facts of the session have changed since its commit.
    pub changed: bool,
    /// The predicates whose rows may be uncertain and that the queries depend on.
    pub uncertain: Vec<bool>,
    /// The input predicates among them.
    pub inputs: Vec<GroundInput>,
    pub strata: Vec<GroundStratum>,
    pub inexact: Option<Inexact>,
    /// What the queries depend on. Made on demand; every commit and other queried rows clear it.
    pub needed: Option<Needed>,
}

/// The rows on which the queried rows depend.
pub(super) struct Needed {
    /// Formulas of all rows before the first clause is evaluated.
    pub formulas: Formulas,
    /// By input and position of a row: the rank of its variable, see [`variable_ranks`], or [`NOWHERE`] if it is not
    /// needed.
    pub ranks: Vec<Vec<u32>>,
}

/// An input predicate whose rows may be uncertain.
pub(super) struct GroundInput {
    pub predicate: PredicateId,
    /// Its rows in the session, sorted.
    pub rows: Vec<FactRow>,
    /// The positions of the given facts among them, with their probabilities.
    pub given: Vec<(u32, f64)>,
}

/// Returns the rank of each input row in the variable order.
///
/// Without an ego, rows keep their order. With an ego, rows are sorted by their greatest symbol, the ego first: rows about
/// the ego alone, then those that add the next symbol. Formulas that join one subformula for each symbol then have small
/// diagrams.
fn variable_ranks(inputs: &[Vec<(u32, FactRow)>], ego: Option<Value>) -> Vec<u32> {
    let Some(ego) = ego else {
        let rows: usize = inputs.iter().map(Vec::len).sum();
        return (0..rows as u32).collect();
    };
    let rows = inputs
        .iter()
        .enumerate()
        .flat_map(|(input, rows)| rows.iter().map(move |(_, row)| (input, row)));
    let mut keys: Vec<(SmallVec<[u32; 4]>, usize, usize)> = rows
        .enumerate()
        .map(|(number, (input, row))| {
            let rank = |value: &Value| {
                if *value == ego { 0 } else { value.0.saturating_add(1) }
            };
            let mut ranks: SmallVec<[u32; 4]> = row.iter().map(rank).collect();
            ranks.sort_unstable_by(|one, other| other.cmp(one));
            (ranks, input, number)
        })
        .collect();
    keys.sort_unstable();
    let mut ranks = vec![0; keys.len()];
    for (rank, (_, _, number)) in (0..).zip(keys) {
        ranks[number] = rank;
    }
    ranks
}

/// The formulas of the rows of the uncertain predicates.
#[derive(Clone)]
pub(super) struct Formulas {
    /// By predicate: the place of its first row; `None` for predicates that are certain.
    pub starts: Vec<Option<usize>>,
    pub all: Vec<Formula>,
}

impl Formulas {
    /// The formula of the row at this position; of a certain predicate, that it holds.
    #[inline]
    pub fn at(&self, predicate: PredicateId, row: usize) -> Formula {
        self.starts[predicate.index()].map_or(Formula::TRUE, |start| self.all[start + row])
    }

    #[inline]
    pub fn set(&mut self, predicate: PredicateId, row: usize, formula: Formula) {
        if let Some(start) = self.starts[predicate.index()] {
            self.all[start + row] = formula;
        }
    }
}

/// The clauses of the uncertain predicates of a stratum.
pub(super) struct GroundStratum {
    pub clauses: Vec<GroundClause>,
}

/// A clause of an uncertain predicate. Its terms are columns of the rows of its instances.
pub(super) struct GroundClause {
    pub head: Atom,
    /// The predicate of its instances; `None` for a certain fact.
    pub instances: Option<PredicateId>,
    /// Uncertain atoms of lower strata, and whether they are negated.
    pub lower: Vec<(Atom, bool)>,
    /// Uncertain atoms of its stratum.
    pub recursive: Vec<Atom>,
    pub draw: Option<Draw>,
    /// The number of its weight.
    pub weight: Option<usize>,
    /// The instances that the session derives.
    pub found: Instances,
}

/// The positions of the rows of each instance of a clause: of the head, of the atoms of lower strata, and of those of
/// its stratum.
#[derive(Default)]
pub(super) struct Instances {
    pub positions: Vec<u32>,
    /// The rows that match negated atoms with `_`.
    pub groups: Vec<Vec<u32>>,
    /// The numbers of the instances on which the queried rows depend, sorted.
    pub needed: Vec<u32>,
}

/// The position of a row that there cannot be.
pub(super) const NOWHERE: u32 = u32::MAX;

impl Grounding {
    pub fn new(
        program: &Program,
        (inputs, lifted): (&BTreeSet<PredicateId>, BTreeSet<PredicateId>),
        queries: &[PredicateId],
        weights: &BTreeMap<ClauseId, usize>,
        symbols: &Symbols,
    ) -> Grounding {
        let rules = program.rules();
        let inputs: BTreeSet<PredicateId> = inputs.union(&lifted).copied().collect();
        let uncertain = relevant(rules, uncertain(rules, &inputs, weights), queries);
        let is_uncertain = |atom: &Atom| uncertain[atom.predicate.index()];
        let mut inexact = None;
        let mut made = rules.clone();
        made.clauses = Vec::with_capacity(rules.clauses.len());
        (made.pasts, made.chance) = (Vec::new(), None);
        let mut ground: Vec<Option<GroundClause>> = Vec::with_capacity(rules.clauses.len());
        for (clause, id) in rules.clauses.iter().zip((0..).map(ClauseId)) {
            if !is_uncertain(&clause.head) {
                made.clauses.push(clause.clone());
                ground.push(None);
                continue;
            }
            let aggregated = clause.body.iter().find_map(|literal| match literal {
                Literal::Aggregate { atom, .. } if is_uncertain(atom) => Some(atom.predicate),
                _ => None,
            });
            let head = clause.head.predicate;
            let reason = match aggregated.map(Inexact::Aggregate) {
                None if rules.predicates[head.index()].depends_on_rounds() => Some(Inexact::Rounds(head)),
                reason => reason,
            };
            if let Some(reason) = reason {
                inexact.get_or_insert(reason);
                ground.push(None);
                continue;
            }
            let weight = weights.get(&id).copied();
            ground.push(Some(split(rules, (clause, weight), &is_uncertain, &mut made)));
        }
        let in_stratum = |stratum: &Stratum, atom: &Atom| stratum.predicates.contains(&atom.predicate);
        let strata = rules.strata.iter().filter_map(|stratum| {
            let is_empty = !stratum.predicates.iter().any(|predicate| uncertain[predicate.index()]);
            let clauses = stratum.clauses.iter().filter_map(|clause: &ClauseId| {
                let mut clause = ground[clause.index()].take()?;
                let (recursive, lower) = clause
                    .lower
                    .into_iter()
                    .partition(|(atom, _)| in_stratum(stratum, atom));
                clause.lower = lower;
                // Positive atoms first: most facts are false, so these make a conjunction false sooner.
                clause.lower.sort_by_key(|(_, negated)| *negated);
                let recursive: Vec<(Atom, bool)> = recursive;
                clause.recursive = recursive.into_iter().map(|(atom, _)| atom).collect();
                Some(clause)
            });
            let clauses = clauses.collect();
            (!is_empty).then_some(GroundStratum { clauses })
        });
        let strata = strata.collect();
        let inputs = inputs.iter().filter(|input| uncertain[input.index()]);
        let inputs = inputs.map(|&predicate| GroundInput {
            predicate,
            rows: Vec::new(),
            given: Vec::new(),
        });
        let inputs = inputs.collect();
        let mut is_lifted = vec![false; rules.predicates.len()];
        lifted.iter().for_each(|predicate| is_lifted[predicate.index()] = true);
        let made = Program::new(restratified(made)).expect("the clauses have fewer literals than those of the program");
        Grounding {
            session: made.session_with(symbols.clone()),
            is_lifted,
            lifted_rows: 0,
            changed: true,
            uncertain,
            inputs,
            strata,
            inexact,
            needed: None,
        }
    }

    /// Notes a change of a fact, unless [`update`](Grounding::update) will find it.
    pub fn note(&mut self, to: PredicateId, words: &[Value], holds: bool) {
        if !self.is_lifted[to.index()] {
            self.changed = true;
            self.session.change_row(to, words, holds);
        }
    }

    /// Commits the facts, which are sorted, and finds their positions. Adds the rows that the session lacks.
    pub fn update(&mut self, facts: &FactTables, cancel: &Cancel) -> Result<(), EvalError> {
        for input in &mut self.inputs {
            let lacking = input.match_facts(facts.of(input.predicate));
            // The others have been noted.
            if self.is_lifted[input.predicate.index()] && !lacking.is_empty() {
                (lacking.iter()).for_each(|row| self.session.change_row(input.predicate, row, true));
                self.lifted_rows += lacking.len();
                self.changed = true;
            }
        }
        if self.changed {
            self.commit(cancel)?;
            for input in &mut self.inputs {
                input.match_facts(facts.of(input.predicate));
            }
        }
        Ok(())
    }

    /// Derives what there may be, and finds the rows of all instances.
    fn commit(&mut self, cancel: &Cancel) -> Result<(), EvalError> {
        if !self.changed {
            return Ok(());
        }
        self.session.commit_with(cancel)?;
        self.changed = false;
        for input in &mut self.inputs {
            input.rows.clear();
            input
                .rows
                .extend(self.session.encoded_rows(input.predicate).map(FactRow::from_slice));
        }
        let clauses = self.strata.iter_mut().flat_map(|stratum| &mut stratum.clauses);
        clauses.for_each(|clause| clause.find(&self.session));
        self.needed = None;
        Ok(())
    }

    /// Finds the rows and instances on which the queried rows depend.
    pub fn find_needed(&mut self, queries: &[PredicateId], asked: Option<&AskedRows>) {
        if self.needed.is_some() {
            return;
        }
        let rows = |predicate: u32| match self.uncertain[predicate as usize] {
            true => vec![false; self.session.len(PredicateId(predicate))],
            false => Vec::new(),
        };
        let mut needed: Vec<Vec<bool>> = (0..self.uncertain.len() as u32).map(rows).collect();
        for query in queries.iter().filter(|query| self.uncertain[query.index()]) {
            for (at, _) in asked_rows(&self.session, *query, asked) {
                needed[query.index()][at] = true;
            }
        }
        // From the last stratum to the first, so that all readers come before.
        for stratum in self.strata.iter_mut().rev() {
            stratum
                .clauses
                .iter_mut()
                .for_each(|clause| clause.found.needed.clear());
            let mut more = true;
            while std::mem::take(&mut more) {
                for clause in &mut stratum.clauses {
                    more |= clause.find_needed(&mut needed);
                }
            }
        }
        let rows_of = |input: &GroundInput| {
            let rows = (0..).zip(&input.rows).zip(&needed[input.predicate.index()]);
            let needed = rows.filter(|(_, needed)| **needed);
            needed.map(|((at, row), _)| (at, row.clone())).collect()
        };
        let rows: Vec<Vec<(u32, FactRow)>> = self.inputs.iter().map(rows_of).collect();
        let ego = asked
            .filter(|asked| asked.len() == 1)
            .and_then(|asked| match &**asked.first()? {
                [ego] => Some(*ego),
                _ => None,
            });
        let mut found = variable_ranks(&rows, ego).into_iter();
        let ranks = self.inputs.iter().zip(&rows).map(|(input, rows)| {
            let mut ranks = vec![NOWHERE; input.rows.len()];
            rows.iter()
                .zip(&mut found)
                .for_each(|((at, _), rank)| ranks[*at as usize] = rank);
            ranks
        });
        let ranks = ranks.collect();
        let mut next = 0;
        let start = |(rows, uncertain): (&Vec<bool>, &bool)| {
            uncertain.then(|| {
                next += rows.len();
                next - rows.len()
            })
        };
        let starts = needed.iter().zip(&self.uncertain).map(start).collect();
        self.needed = Some(Needed {
            formulas: Formulas {
                starts,
                all: vec![Formula::FALSE; next],
            },
            ranks,
        });
    }
}

/// Compares rows of a predicate. Most have one or two columns, for which this is faster than comparing slices.
#[inline]
fn compare(one: &[Value], other: &[Value]) -> Ordering {
    match (one, other) {
        ([x], [y]) => x.cmp(y),
        ([x, y], [z, w]) => (x, y).cmp(&(z, w)),
        _ => one.cmp(other),
    }
}

impl GroundInput {
    /// Finds the positions of sorted facts, and returns those that are not among the rows.
    fn match_facts<'f>(&mut self, facts: &'f [(FactRow, f64)]) -> Vec<&'f FactRow> {
        let mut rows = (0..).zip(&self.rows).peekable();
        let mut lacking = Vec::new();
        self.given.clear();
        for (row, probability) in facts {
            loop {
                match rows.peek().map(|(_, known)| compare(known, row)) {
                    Some(Ordering::Less) => _ = rows.next(),
                    Some(Ordering::Equal) => {
                        let (at, _) = rows.next().expect("it has been seen");
                        self.given.push((at, *probability));
                        break;
                    }
                    _ => {
                        lacking.push(row);
                        break;
                    }
                }
            }
        }
        lacking
    }
}

impl GroundClause {
    /// Returns the number of positions of an instance.
    pub fn width(&self) -> usize {
        1 + self.lower.len() + self.recursive.len()
    }

    /// Finds the instances of needed rows, and marks the rows that they read. Returns whether there are further ones.
    fn find_needed(&mut self, needed: &mut [Vec<bool>]) -> bool {
        let width = self.width();
        let found = &mut self.found;
        let before = found.needed.len();
        found.needed.clear();
        for (number, positions) in (0..).zip(found.positions.chunks_exact(width)) {
            let heads = &needed[self.head.predicate.index()];
            if !heads.get(positions[0] as usize).is_some_and(|needed| *needed) {
                continue;
            }
            found.needed.push(number);
            let lower = self.lower.iter().map(|(atom, negated)| (atom, *negated));
            let atoms = lower.chain(self.recursive.iter().map(|atom| (atom, false)));
            for ((atom, negated), &at) in atoms.zip(&positions[1..]) {
                let rows = &mut needed[atom.predicate.index()];
                let grouped = negated && atom.terms.contains(&Term::Wildcard);
                match (grouped, at) {
                    (true, group) => found.groups[group as usize]
                        .iter()
                        .for_each(|at| rows[*at as usize] = true),
                    (false, NOWHERE) => {}
                    (false, at) => rows[at as usize] = true,
                }
            }
        }
        found.needed.len() > before
    }

    /// Finds the rows of all instances.
    fn find(&mut self, session: &Session) {
        let mut found = Instances::default();
        let position = |atom: &Atom, instance: &[Value]| find(session, atom, instance).unwrap_or(NOWHERE);
        let mut add = |instance: &[Value]| {
            found.positions.push(position(&self.head, instance));
            for (atom, negated) in &self.lower {
                found
                    .positions
                    .push(match *negated && atom.terms.contains(&Term::Wildcard) {
                        false => position(atom, instance),
                        true => {
                            found.groups.push(matching(session, atom, instance));
                            found.groups.len() as u32 - 1
                        }
                    });
            }
            let own = self.recursive.iter().map(|atom| position(atom, instance));
            found.positions.extend(own);
        };
        match self.instances {
            None => add(&[]),
            Some(instances) => session.encoded_rows(instances).for_each(add),
        }
        self.found = found;
    }
}

/// Returns the position of the row of an atom, all of whose terms have values.
fn find(session: &Session, atom: &Atom, instance: &[Value]) -> Option<u32> {
    let wanted = atom.terms.iter().map(|term| value(term, instance));
    let wanted: SmallVec<[Value; 4]> = wanted.collect::<Option<_>>()?;
    find_row(session, atom.predicate, &wanted)
}

/// Returns the positions of the rows that match an atom.
fn matching(session: &Session, atom: &Atom, instance: &[Value]) -> Vec<u32> {
    let pattern: Vec<Option<Value>> = atom.terms.iter().map(|term| value(term, instance)).collect();
    let rows = (0..).zip(session.encoded_rows(atom.predicate));
    let matches = rows.filter(|(_, row)| {
        let mut columns = pattern.iter().zip(*row);
        columns.all(|(wanted, found)| wanted.is_none_or(|wanted| wanted == *found))
    });
    matches.map(|(at, _)| at).collect()
}

/// Returns the inputs whose facts may count as uncertain: those of symbols that no aggregate and no key
/// depends on.
pub(super) fn liftable(rules: &Rules) -> BTreeSet<PredicateId> {
    let aggregates = rules.clauses.iter().flat_map(|clause| &clause.body);
    let mut open: Vec<PredicateId> = aggregates
        .filter_map(|literal| match literal {
            Literal::Aggregate { atom, .. } => Some(atom.predicate),
            _ => None,
        })
        .collect();
    let by_rounds = (0..).map(PredicateId).zip(&rules.predicates);
    open.extend(by_rounds.filter_map(|(id, predicate)| predicate.depends_on_rounds().then_some(id)));
    let mut read: BTreeSet<PredicateId> = BTreeSet::new();
    while let Some(predicate) = open.pop() {
        if read.insert(predicate) {
            let clauses = rules.clauses.iter().filter(|clause| clause.head.predicate == predicate);
            open.extend(clauses.flat_map(|clause| rules.reads(clause)));
        }
    }
    let ids = (0..).map(PredicateId).zip(&rules.predicates);
    let liftable = ids.filter(|(id, predicate)| {
        let symbols = predicate.columns.iter().all(|column| column.base == BaseType::Symbol);
        !predicate.derived && symbols && !read.contains(id)
    });
    liftable.map(|(id, _)| id).collect()
}

/// Returns the value of a term whose variables are columns of a row.
pub(super) fn value(term: &Term, row: &[Value]) -> Option<Value> {
    match *term {
        Term::Constant(constant) => Some(constant),
        Term::Variable(column) => Some(row[column.index()]),
        Term::Wildcard => None,
    }
}

/// Returns for each predicate whether a row may be uncertain.
fn uncertain(rules: &Rules, inputs: &BTreeSet<PredicateId>, weights: &BTreeMap<ClauseId, usize>) -> Vec<bool> {
    let mut uncertain: Vec<bool> = (0..rules.predicates.len() as u32)
        .map(|id| inputs.contains(&PredicateId(id)))
        .collect();
    for clause in weights.keys() {
        uncertain[rules.clauses[clause.index()].head.predicate.index()] = true;
    }
    let mut changed = true;
    while std::mem::take(&mut changed) {
        for clause in &rules.clauses {
            let head = clause.head.predicate.index();
            let may_vary = |read: PredicateId| uncertain[read.index()] || Some(read) == rules.chance;
            if !uncertain[head] && rules.reads(clause).any(may_vary) {
                uncertain[head] = true;
                changed = true;
            }
        }
    }
    uncertain
}

/// Keeps the predicates on which the queries depend.
fn relevant(rules: &Rules, mut uncertain: Vec<bool>, queries: &[PredicateId]) -> Vec<bool> {
    let needed = rules.dependencies(queries.iter().copied());
    uncertain
        .iter_mut()
        .zip(needed)
        .for_each(|(uncertain, needed)| *uncertain &= needed);
    uncertain
}

/// Splits a clause of an uncertain predicate: adds the clause of its instances and that of its head to the rules that
/// derive what there may be, and returns the rest.
fn split(
    rules: &Rules,
    (clause, weight): (&Clause, Option<usize>),
    is_uncertain: &impl Fn(&Atom) -> bool,
    made: &mut Rules,
) -> GroundClause {
    if clause.body.is_empty() {
        made.clauses.push(clause.clone());
        return GroundClause {
            head: clause.head.clone(),
            instances: None,
            lower: Vec::new(),
            recursive: Vec::new(),
            draw: None,
            weight: None,
            found: Instances::default(),
        };
    }
    let mut draw = rules.draw(clause);
    let drawn = draw.as_ref().map_or([usize::MAX; 3], |draw| draw.literals);
    let mut atoms: Vec<(Atom, bool)> = Vec::new();
    let mut body = Vec::new();
    for (at, literal) in clause.body.iter().enumerate() {
        match literal {
            _ if drawn.contains(&at) => continue,
            Literal::Negative(atom) if is_uncertain(atom) => {
                atoms.push((atom.clone(), true));
                continue;
            }
            Literal::Positive(atom) | Literal::Guard(atom) if is_uncertain(atom) => {
                atoms.push((atom.clone(), false));
            }
            _ => {}
        }
        body.push(literal.clone());
    }
    // A `_` of a positive atom needs a value, to know the row.
    let mut variables = clause.variables.clone();
    let mut bases = rules.bases(clause);
    let mut next = 0;
    for literal in &mut body {
        let (Literal::Positive(atom) | Literal::Guard(atom)) = literal else {
            continue;
        };
        if !is_uncertain(atom) {
            continue;
        }
        let columns = &rules.predicates[atom.predicate.index()].columns;
        for (term, column) in atom.terms.iter_mut().zip(columns) {
            if *term == Term::Wildcard {
                *term = Term::Variable(VarId(variables.len() as u32));
                variables.push("_".to_owned());
                bases.push(column.base);
            }
        }
        let positive = atoms[next..].iter().position(|(_, negated)| !negated);
        if let Some(position) = positive {
            atoms[next + position].0 = atom.clone();
            next += position + 1;
        }
    }
    let mut head = clause.head.clone();
    // The columns of the instances: the variables of what remains to be evaluated.
    let mut columns: Vec<VarId> = Vec::new();
    let terms = (head.terms.iter_mut())
        .chain(atoms.iter_mut().flat_map(|(atom, _)| &mut atom.terms))
        .chain(
            draw.iter_mut()
                .flat_map(|draw| draw.probabilities.iter_mut().chain(&mut draw.values)),
        );
    for term in terms {
        if let Term::Variable(variable) = term {
            let column = columns.iter().position(|known| known == variable).unwrap_or_else(|| {
                columns.push(*variable);
                columns.len() - 1
            });
            *variable = VarId(column as u32);
        }
    }
    if weight.is_some() {
        // The weight counts for each combination of values.
        let mut bound = vec![false; variables.len()];
        let positive = body.iter().filter_map(|literal| match literal {
            Literal::Positive(atom) | Literal::Guard(atom) => Some(atom),
            _ => None,
        });
        for term in positive.flat_map(|atom| &atom.terms) {
            if let Term::Variable(variable) = term {
                bound[variable.index()] = true;
            }
        }
        let all = (0..variables.len() as u32).map(VarId);
        let more = all.filter(|variable| bound[variable.index()] && !columns.contains(variable));
        let more: Vec<VarId> = more.collect();
        columns.extend(more);
    }
    let instances = PredicateId(made.predicates.len() as u32);
    let column = |variable: &VarId| Column {
        name: variables[variable.index()].clone(),
        ty: TypeId(0),
        base: bases[variable.index()],
    };
    made.predicates.push(Predicate::made(
        format!("+instances {}", made.clauses.len()),
        columns.iter().map(column).collect(),
        "instances of a clause".to_owned(),
        clause.span,
    ));
    let atom = Atom {
        predicate: instances,
        terms: columns.iter().map(|variable| Term::Variable(*variable)).collect(),
        span: clause.span,
    };
    made.clauses.push(Clause {
        head: atom.clone(),
        body,
        variable_spans: vec![clause.span; variables.len()],
        variables: variables.clone(),
        doc: String::new(),
        span: clause.span,
    });
    made.clauses.push(Clause {
        body: vec![Literal::Positive(Atom {
            terms: (0..columns.len() as u32)
                .map(|column| Term::Variable(VarId(column)))
                .collect(),
            ..atom
        })],
        head: head.clone(),
        variable_spans: vec![clause.span; columns.len()],
        variables: columns
            .iter()
            .map(|variable| variables[variable.index()].clone())
            .collect(),
        doc: String::new(),
        span: clause.span,
    });
    GroundClause {
        head,
        instances: Some(instances),
        lower: atoms,
        recursive: Vec::new(),
        draw,
        weight,
        found: Instances::default(),
    }
}
