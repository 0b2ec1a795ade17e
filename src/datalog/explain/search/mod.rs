//! Backtracking search for bindings that satisfy the literals of a clause, or all but a few, over the facts of a
//! session.

pub(super) mod heights;

use crate::cancel::Cancel;
use crate::check::{Atom, Clause, ClauseId, Literal, PredicateId, Rules, Term, bind_all};
use crate::eval::correlated::CorrelatedValues;
use crate::eval::output::Abort;
use crate::explain::search::heights::Heights;
use crate::explain::{ExplainError, Pattern};
use crate::session::Session;
use crate::symbol::Symbol;
use crate::syntax::ast::{BaseType, Comparison};
use crate::syntax::functor::Functor;
use crate::syntax::lexer::is_name;
use crate::value::{Patterns, Value};
use std::cell::{Cell, OnceCell, RefCell};
use std::cmp::Reverse;
use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::rc::Rc;

/// The value of each variable of a clause; `None` while unbound.
pub(super) type Binding = Vec<Option<Value>>;

/// Row positions by the values of some columns.
type Index = HashMap<Vec<Value>, Rc<[u32]>>;

/// Limits of the search for the nearest binding: failing literals, and steps for each clause.
const FAILURES_MAX: usize = 3;
const NEAREST_STEPS: u64 = 200_000;

/// Maximum number of bindings that the search for the longest prefix compares.
const PREFIX_BINDINGS: usize = 100;

/// The rows of a predicate, with indexes on bound columns that are built on first use.
struct Table<'s> {
    rows: Vec<&'s [Value]>,
    /// The indexes by the bit set of bound columns.
    indexes: RefCell<HashMap<u64, Rc<Index>>>,
}

/// A search over a session that counts its steps.
pub(super) struct ProofSearch<'s> {
    pub(super) session: &'s Session,
    /// The tables, by [`PredicateId`].
    tables: Vec<OnceCell<Table<'s>>>,
    /// The clauses for each predicate in source order, by [`PredicateId`].
    clauses: Vec<Vec<ClauseId>>,
    limit: Cell<u64>,
    left: Cell<u64>,
    /// Polled every [`ProofSearch::POLL_INTERVAL`] steps.
    cancel: Cancel,
    /// Whether a poll of the current query returned true.
    cancelled: Cell<bool>,
    patterns: RefCell<Patterns>,
    /// The correlated aggregates evaluated so far.
    correlated: RefCell<CorrelatedValues>,
    /// The maximum memory of the evaluation of a correlated aggregate, in bytes.
    bytes_max: u64,
    /// The bytes left for indexes and explanations.
    bytes_left: Cell<u64>,
    /// The maximum size of the symbol table, in bytes.
    symbol_bytes: u64,
    heights: Heights,
}

/// Rows of a predicate, by position.
enum Rows {
    All(u32),
    Some(Rc<[u32]>),
    None,
}

impl Rows {
    fn len(&self) -> usize {
        match self {
            Rows::All(count) => *count as usize,
            Rows::Some(list) => list.len(),
            Rows::None => 0,
        }
    }

    fn get(&self, at: usize) -> u32 {
        match self {
            Rows::Some(list) => list[at],
            _ => at as u32,
        }
    }
}

/// A binding under which the requested literals hold.
pub(super) struct Solution<'a> {
    pub(super) binding: &'a [Option<Value>],
    /// Indexed by literal: the position of the row that matches a positive literal.
    pub(super) rows: &'a [Option<u32>],
    /// Indexed by literal: whether it is one of the permitted failures.
    pub(super) failed: &'a [bool],
}

/// Determines which rows may match positive literals.
type Usable<'a> = &'a dyn Fn(PredicateId, u32) -> bool;
/// Receives every solution; returns whether to continue.
type Visit<'a> = &'a mut dyn FnMut(Solution<'_>) -> bool;

/// A partial solution of a clause.
pub(super) struct Attempt<'a> {
    pub(super) clause: &'a Clause,
    /// Indexed by literal: whether the search still has to satisfy it.
    pub(super) pending: Vec<bool>,
    pub(super) binding: Binding,
    pub(super) rows: Vec<Option<u32>>,
    failed: Vec<bool>,
    /// The number of literals that may still fail.
    failures: usize,
}

impl<'a> Attempt<'a> {
    pub(super) fn new(clause: &'a Clause, pending: &[bool], binding: Binding, failures: usize) -> Self {
        Attempt {
            clause,
            pending: pending.to_vec(),
            binding,
            rows: vec![None; clause.body.len()],
            failed: vec![false; clause.body.len()],
            failures,
        }
    }
}

/// The changes that restore an [`Attempt`].
#[derive(Default)]
struct Undo {
    settled: Vec<usize>,
    failed: Vec<usize>,
    bound: Vec<usize>,
}

impl<'s> ProofSearch<'s> {
    /// Cancellation polling interval, in steps.
    const POLL_INTERVAL: u64 = 1 << 14;

    pub(super) fn new(session: &'s Session, cancel: &Cancel) -> Self {
        let rules = session.program().rules();
        let mut clauses = vec![Vec::new(); rules.predicates.len()];
        for (clause, id) in rules.clauses.iter().zip(0..) {
            clauses[clause.head.predicate.index()].push(ClauseId(id));
        }
        let left = session.bytes_left();
        ProofSearch {
            session,
            tables: (0..rules.predicates.len()).map(|_| OnceCell::new()).collect(),
            clauses,
            limit: Cell::new(0),
            left: Cell::new(0),
            cancel: cancel.clone(),
            cancelled: Cell::new(false),
            patterns: RefCell::default(),
            // The other parts of the memory are for the evaluations, for the indexes of the search, and for new
            // symbols, which an explanation repeats.
            correlated: RefCell::new(CorrelatedValues::caching(left / 4)),
            bytes_max: left / 4,
            bytes_left: Cell::new(left / 16 * 7),
            symbol_bytes: session.symbols().bytes() + left / 16,
            heights: Heights::new(rules),
        }
    }

    pub(super) fn rules(&self) -> &'s Rules {
        self.session.program().rules()
    }

    pub(super) fn clauses_of(&self, id: PredicateId) -> Vec<ClauseId> {
        self.clauses[id.index()].clone()
    }

    /// Resets the number of steps available.
    pub(super) fn refill(&mut self, steps: u64) {
        self.limit.set(steps);
        self.left.set(steps);
        self.cancelled.set(false);
    }

    /// Returns the number of steps left.
    pub(super) fn left(&self) -> u64 {
        self.left.get()
    }

    /// Sets the number of steps left.
    pub(super) fn set_left(&self, steps: u64) {
        self.left.set(steps);
    }

    /// Counts a step.
    pub(super) fn step(&self) -> Result<(), ExplainError> {
        match self.left.get().checked_sub(1) {
            Some(left) => {
                self.left.set(left);
                if left.is_multiple_of(Self::POLL_INTERVAL) && self.cancel.requested() {
                    self.cancelled.set(true);
                }
                match self.cancelled.get() {
                    true => Err(ExplainError::Cancelled),
                    false => Ok(()),
                }
            }
            None if self.cancelled.get() => Err(ExplainError::Cancelled),
            None => Err(ExplainError::TooMuchWork {
                limit: self.limit.get(),
            }),
        }
    }

    /// Counts memory that the search keeps.
    pub(super) fn reserve(&self, bytes: usize) -> Result<(), ExplainError> {
        match self.bytes_left.get().checked_sub(bytes as u64) {
            Some(left) => {
                self.bytes_left.set(left);
                Ok(())
            }
            None => Err(self.too_much_memory()),
        }
    }

    fn too_much_memory(&self) -> ExplainError {
        ExplainError::TooMuchMemory {
            limit: self.session.limits().bytes,
        }
    }

    fn table(&self, id: PredicateId) -> &Table<'s> {
        self.tables[id.index()].get_or_init(|| Table {
            rows: self.session.encoded_rows(id).collect(),
            indexes: RefCell::default(),
        })
    }

    /// Returns the row at a position.
    pub(super) fn row(&self, id: PredicateId, position: u32) -> &'s [Value] {
        self.table(id).rows[position as usize]
    }

    pub(super) fn len(&self, id: PredicateId) -> usize {
        self.table(id).rows.len()
    }

    /// Returns the position of a row.
    pub(super) fn position(&self, id: PredicateId, row: &[Value]) -> Result<Option<u32>, ExplainError> {
        let pattern: Pattern = row.iter().copied().map(Some).collect();
        let rows = self.rows(id, &pattern)?;
        Ok((rows.len() > 0).then(|| rows.get(0)))
    }

    /// Returns the rows that match a pattern.
    fn rows(&self, id: PredicateId, pattern: &[Option<Value>]) -> Result<Rows, ExplainError> {
        /// The memory of a row in an index: its key, its list and their places in a hash table.
        const INDEX_ROW: usize = 128;
        if self.tables[id.index()].get().is_none() {
            self.reserve(self.session.len(id) * size_of::<&[Value]>())?;
        }
        let table = self.table(id);
        let bound = |column: &usize| pattern[*column].is_some();
        let columns: Vec<usize> = (0..pattern.len()).filter(bound).collect();
        if columns.is_empty() {
            return Ok(Rows::All(u32::try_from(table.rows.len()).unwrap_or(u32::MAX)));
        }
        let mask = columns.iter().fold(0, |mask, column| mask | 1 << column);
        let mut indexes = table.indexes.borrow_mut();
        let index = match indexes.entry(mask) {
            Entry::Occupied(known) => known.into_mut(),
            Entry::Vacant(place) => {
                self.reserve(table.rows.len() * (INDEX_ROW + columns.len() * size_of::<Value>()))?;
                let mut lists: HashMap<Vec<Value>, Vec<u32>> = HashMap::new();
                for (row, position) in table.rows.iter().zip(0..) {
                    let key = columns.iter().map(|&column| row[column]).collect();
                    lists.entry(key).or_default().push(position);
                }
                place.insert(Rc::new(
                    lists.into_iter().map(|(key, list)| (key, list.into())).collect(),
                ))
            }
        };
        let key: Vec<Value> = pattern.iter().flatten().copied().collect();
        Ok(index.get(&key).map_or(Rows::None, |list| Rows::Some(Rc::clone(list))))
    }

    /// Returns the first row that matches a pattern.
    pub(super) fn first_row(
        &self,
        id: PredicateId,
        pattern: &[Option<Value>],
    ) -> Result<Option<Vec<Value>>, ExplainError> {
        self.step()?;
        let rows = self.rows(id, pattern)?;
        Ok((rows.len() > 0).then(|| self.row(id, rows.get(0)).to_vec()))
    }

    /// Returns a row that makes a row of the predicate superfluous. `pairs` has such pairs.
    pub(super) fn stronger(
        &self,
        id: PredicateId,
        pairs: PredicateId,
        row: &[Option<Value>],
    ) -> Result<Option<Vec<Value>>, ExplainError> {
        for position in 0..u32::try_from(self.len(id)).unwrap_or(u32::MAX) {
            self.step()?;
            let stronger = self.row(id, position).to_vec();
            let pair: Pattern = row.iter().copied().chain(stronger.iter().copied().map(Some)).collect();
            for clause in self.clauses_of(pairs) {
                let clause = &self.rules().clauses[clause.index()];
                let mut binding: Binding = vec![None; clause.variables.len()];
                if bind_head(clause, &pair, &mut binding).is_err() {
                    continue;
                }
                let (binding, failing) = self.nearest(clause, binding)?;
                // The weaker row itself does not hold.
                let is_weaker = |literal: &usize| match &clause.body[*literal] {
                    Literal::Positive(atom) => atom.predicate == id && pattern(atom, &binding) == row,
                    _ => false,
                };
                if failing.iter().all(is_weaker) {
                    return Ok(Some(stronger));
                }
            }
        }
        Ok(None)
    }

    pub(super) fn some_row(&self, id: PredicateId, pattern: &[Option<Value>]) -> Result<bool, ExplainError> {
        Ok(self.first_row(id, pattern)?.is_some())
    }

    /// Calls `visit` with every binding that extends `binding` and satisfies all `pending` literals except `failures`
    /// of them, until `visit` returns `false`.
    pub(super) fn solve(
        &self,
        clause: &Clause,
        pending: &[bool],
        binding: Binding,
        failures: usize,
        visit: Visit<'_>,
    ) -> Result<(), ExplainError> {
        let mut attempt = Attempt::new(clause, pending, binding, failures);
        self.advance(&mut attempt, &|_, _| true, visit).map(|_| ())
    }

    /// Variant of [`ProofSearch::solve`] that starts from a partial solution and uses only some rows.
    pub(super) fn advance(
        &self,
        attempt: &mut Attempt<'_>,
        usable: Usable<'_>,
        visit: Visit<'_>,
    ) -> Result<bool, ExplainError> {
        self.step()?;
        let mut undo = Undo::default();
        let result = self.proceed(attempt, &mut undo, usable, visit);
        for literal in undo.settled {
            attempt.pending[literal] = true;
        }
        for literal in undo.failed {
            attempt.failed[literal] = false;
            attempt.failures += 1;
        }
        for variable in undo.bound {
            attempt.binding[variable] = None;
        }
        result
    }

    fn proceed(
        &self,
        attempt: &mut Attempt<'_>,
        undo: &mut Undo,
        usable: Usable<'_>,
        visit: Visit<'_>,
    ) -> Result<bool, ExplainError> {
        let clause = attempt.clause;
        // While literals may fail, an equality must not bind a variable before the atoms had their chance.
        let mut force = attempt.failures == 0;
        let chosen = loop {
            if !self.test(attempt, undo, force)? {
                return Ok(true);
            }
            let mut best: Option<(usize, Rows)> = None;
            for (literal, body) in clause.body.iter().enumerate() {
                if let (true, Literal::Positive(atom) | Literal::Guard(atom)) = (attempt.pending[literal], body) {
                    let rows = self.rows(atom.predicate, &pattern(atom, &attempt.binding))?;
                    if best.as_ref().is_none_or(|(_, fewest)| rows.len() < fewest.len()) {
                        best = Some((literal, rows));
                    }
                }
            }
            match best {
                Some(best) => break Some(best),
                None if force => break None,
                None => force = true,
            }
        };
        let Some((literal, rows)) = chosen else {
            // The remaining literals have variables that nothing can bind, so they count as failing.
            let open = attempt.pending.iter().filter(|pending| **pending).count();
            return Ok(open > attempt.failures
                || visit(Solution {
                    binding: &attempt.binding,
                    rows: &attempt.rows,
                    failed: &attempt.failed,
                }));
        };
        let (Literal::Positive(atom) | Literal::Guard(atom)) = &clause.body[literal] else {
            return Ok(true);
        };
        attempt.pending[literal] = false;
        undo.settled.push(literal);
        for at in 0..rows.len() {
            self.step()?;
            let position = rows.get(at);
            if !usable(atom.predicate, position) {
                continue;
            }
            let mut bound = Vec::new();
            if unify(
                &atom.terms,
                self.row(atom.predicate, position),
                &mut attempt.binding,
                &mut bound,
            ) {
                attempt.rows[literal] = Some(position);
                let more = self.advance(attempt, usable, visit);
                attempt.rows[literal] = None;
                if !more? {
                    return Ok(false);
                }
            }
            for variable in bound {
                attempt.binding[variable] = None;
            }
        }
        let open = || {
            let unbound = |term: &Term| matches!(term, Term::Variable(v) if attempt.binding[v.index()].is_none());
            atom.terms.iter().any(unbound)
        };
        if attempt.failures > 0 && (rows.len() == 0 || open()) {
            attempt.failures -= 1;
            attempt.failed[literal] = true;
            let more = self.advance(attempt, usable, visit);
            attempt.failures += 1;
            attempt.failed[literal] = false;
            return more;
        }
        Ok(true)
    }

    /// Tests the negated literals, comparisons, expressions and aggregates whose variables are bound. Returns whether
    /// the attempt can succeed.
    fn test(&self, attempt: &mut Attempt<'_>, undo: &mut Undo, force: bool) -> Result<bool, ExplainError> {
        let clause = attempt.clause;
        loop {
            let mut changed = false;
            for (literal, body) in clause.body.iter().enumerate() {
                if !attempt.pending[literal] {
                    continue;
                }
                let holds = match body {
                    Literal::Positive(_) | Literal::Guard(_) => continue,
                    _ => match self.decide(body, &attempt.binding)? {
                        Some(holds) => holds,
                        None if force => match self.learn(body, &attempt.binding)? {
                            Some((variable, value)) => {
                                attempt.binding[variable] = Some(value);
                                undo.bound.push(variable);
                                true
                            }
                            None => continue,
                        },
                        None => continue,
                    },
                };
                changed = true;
                attempt.pending[literal] = false;
                undo.settled.push(literal);
                if !holds {
                    if attempt.failures == 0 {
                        return Ok(false);
                    }
                    attempt.failures -= 1;
                    attempt.failed[literal] = true;
                    undo.failed.push(literal);
                }
            }
            if !changed {
                return Ok(true);
            }
        }
    }

    /// Returns whether a literal holds; `None` while a variable is unbound.
    fn decide(&self, literal: &Literal, binding: &[Option<Value>]) -> Result<Option<bool>, ExplainError> {
        match literal {
            Literal::Positive(atom) | Literal::Guard(atom) if determined(atom, binding) => {
                self.some_row(atom.predicate, &pattern(atom, binding)).map(Some)
            }
            Literal::Negative(atom) if determined(atom, binding) => self
                .some_row(atom.predicate, &pattern(atom, binding))
                .map(|some| Some(!some)),
            Literal::Compare {
                op, left, right, base, ..
            } => Ok(match (value(left, binding), value(right, binding)) {
                (Some(left), Some(right)) => Some(self.compare(*op, left, right, *base)),
                _ => None,
            }),
            Literal::Compute { to, .. } | Literal::Aggregate { to, .. } => {
                Ok(match (self.result(literal, binding)?, value(to, binding)) {
                    (None, _) | (Some(Some(_)), None) => None,
                    (Some(None), _) => Some(false),
                    (Some(Some(found)), Some(to)) => Some(found == to),
                })
            }
            _ => Ok(None),
        }
    }

    /// Returns the value of an expression or aggregate; the inner `None` means that it has none. The outer `None` means
    /// another kind of literal or an unbound variable.
    pub(super) fn result(
        &self,
        literal: &Literal,
        binding: &[Option<Value>],
    ) -> Result<Option<Option<Value>>, ExplainError> {
        match literal {
            Literal::Compute {
                functor,
                base,
                arguments,
                ..
            } => {
                let arguments: Option<Vec<Value>> = arguments.iter().map(|term| value(term, binding)).collect();
                let Some(arguments) = arguments else { return Ok(None) };
                if let (Functor::Counter, [of, values @ ..]) = (functor, &arguments[..]) {
                    let pattern: Pattern = std::iter::once(None).chain(values.iter().copied().map(Some)).collect();
                    let row = self.first_row(PredicateId(of.0), &pattern)?;
                    return Ok(Some(row.map(|row| row[0])));
                }
                let symbols = self.session.symbols();
                let longest = functor.symbol_length(*base, &arguments, symbols);
                if longest > 0 && symbols.bytes() + longest > self.symbol_bytes {
                    return Err(self.too_much_memory());
                }
                if *functor == Functor::Call {
                    self.step()?;
                    let failed = |reason| ExplainError::Functor { reason };
                    return self.rules().call(&arguments, symbols).map(Some).map_err(failed);
                }
                Ok(Some(functor.apply(*base, &arguments, symbols)))
            }
            Literal::Aggregate {
                op, base, atom, column, ..
            } if determined(atom, binding) => {
                if self.rules().is_correlated(atom.predicate) {
                    return self.correlated(literal, atom, binding).map(Some);
                }
                if self.session.program().is_aggregated(atom.predicate) {
                    self.step()?;
                    let key: Vec<Value> = atom.terms.iter().map_while(|term| value(term, binding)).collect();
                    return Ok(Some(self.session.group(atom.predicate, &key, *op)));
                }
                let rows = self.rows(atom.predicate, &pattern(atom, binding))?;
                (0..rows.len()).try_for_each(|_| self.step())?;
                let values = (0..rows.len()).map(|at| match column {
                    Some(column) => self.row(atom.predicate, rows.get(at))[*column],
                    None => Value(0),
                });
                Ok(Some(op.of(*base, values, self.session.symbols())))
            }
            _ => Ok(None),
        }
    }

    /// Returns the value of a correlated aggregate whose parameters are bound.
    fn correlated(
        &self,
        literal: &Literal,
        atom: &Atom,
        binding: &[Option<Value>],
    ) -> Result<Option<Value>, ExplainError> {
        self.step()?;
        let parameters: Vec<Value> = atom.terms.iter().map_while(|term| value(term, binding)).collect();
        if let Some(known) = self.correlated.borrow().get(atom.predicate, &parameters) {
            return Ok(known);
        }
        let (found, rows_scanned) =
            (self.session).correlated(literal, &parameters, (self.left.get(), self.bytes_max), &self.cancel);
        self.left.set(self.left.get().saturating_sub(rows_scanned));
        self.cancelled
            .set(self.cancelled.get() || found == Err(Abort::Cancelled));
        match found {
            Ok(value) => {
                self.correlated.borrow_mut().insert(atom.predicate, &parameters, value);
                Ok(value)
            }
            Err(Abort::Memory) => Err(self.too_much_memory()),
            Err(_) => {
                // No steps are left, or the caller cancelled the search.
                self.left.set(0);
                self.step().and(Ok(None))
            }
        }
    }

    /// Returns the value that an equality, expression or aggregate gives to its only unbound variable.
    fn learn(&self, literal: &Literal, binding: &[Option<Value>]) -> Result<Option<(usize, Value)>, ExplainError> {
        match literal {
            Literal::Compute {
                to: to @ Term::Variable(variable),
                ..
            }
            | Literal::Aggregate {
                to: to @ Term::Variable(variable),
                ..
            } if value(to, binding).is_none() => Ok(self
                .result(literal, binding)?
                .flatten()
                .map(|value| (variable.index(), value))),
            _ => Ok(copy(literal, binding)),
        }
    }

    fn compare(&self, op: Comparison, left: Value, right: Value, base: BaseType) -> bool {
        let symbols = self.session.symbols();
        op.holds(base, left, right, symbols, || {
            let text = symbols.resolve(Symbol(right.0)).unwrap_or_default();
            self.patterns.borrow_mut().matches(left, text, symbols)
        })
    }

    /// Returns the nearest binding of a clause that does not hold, and the literals that fail under it. See
    /// [`Obstacle::Body`](super::Obstacle::Body).
    pub(super) fn nearest(&self, clause: &Clause, binding: Binding) -> Result<(Binding, Vec<usize>), ExplainError> {
        let mut failing = Vec::new();
        for (literal, body) in clause.body.iter().enumerate() {
            if self.decide(body, &binding)? == Some(false) {
                failing.push(literal);
            }
        }
        if !failing.is_empty() {
            return Ok((binding, failing));
        }
        let outer = self.left.get();
        let inner = outer.min(NEAREST_STEPS);
        self.left.set(inner);
        let found = self.fewest_failures(clause, &binding);
        self.left.set(outer - (inner - self.left.get()));
        match found {
            Ok(Some(found)) => Ok(found),
            Err(error) if inner == outer => Err(error),
            Ok(None) | Err(_) => self.longest_prefix(clause, binding),
        }
    }

    fn fewest_failures(
        &self,
        clause: &Clause,
        binding: &Binding,
    ) -> Result<Option<(Binding, Vec<usize>)>, ExplainError> {
        let all = vec![true; clause.body.len()];
        let named = self.named(clause);
        for failures in 1..=FAILURES_MAX.min(clause.body.len()) {
            let mut best = None;
            self.solve(clause, &all, binding.clone(), failures, &mut |solution| {
                let failing: Vec<usize> = (0..all.len()).filter(|&literal| solution.failed[literal]).collect();
                let guards = failing
                    .iter()
                    .filter(|&&literal| matches!(clause.body[literal], Literal::Guard(_)));
                let key = (
                    coincidences(&named, solution.binding),
                    guards.count(),
                    Reverse(failing.first().copied()),
                    solution.binding.to_vec(),
                );
                if best.as_ref().is_none_or(|(least, _)| key < *least) {
                    best = Some((key, failing));
                }
                true
            })?;
            if let Some(((.., binding), failing)) = best {
                return Ok(Some((binding, failing)));
            }
        }
        Ok(None)
    }

    /// Returns the base type of each variable that the source names; `None` for the values of expressions.
    fn named(&self, clause: &Clause) -> Vec<Option<BaseType>> {
        let bases = self.rules().bases(clause);
        let names = clause.variables.iter().zip(bases);
        names
            .map(|(name, base)| (name == "_" || is_name(name)).then_some(base))
            .collect()
    }

    /// Returns a binding for the longest prefix of literals that can hold together, and the literal after it. Literals
    /// come in source order, but one that binds nothing waits for its variables.
    fn longest_prefix(&self, clause: &Clause, binding: Binding) -> Result<(Binding, Vec<usize>), ExplainError> {
        let named = self.named(clause);
        let mut satisfied = binding.clone();
        let mut pending = vec![false; clause.body.len()];
        for literal in in_order(clause, &binding) {
            pending[literal] = true;
            let mut found: Option<(usize, Binding)> = None;
            let mut seen = 0;
            self.solve(clause, &pending, binding.clone(), 0, &mut |solution| {
                let pairs = coincidences(&named, solution.binding);
                if found.as_ref().is_none_or(|(fewest, _)| pairs < *fewest) {
                    found = Some((pairs, solution.binding.to_vec()));
                }
                seen += 1;
                pairs > 0 && seen < PREFIX_BINDINGS
            })?;
            match found {
                Some((_, binding)) => satisfied = binding,
                None => return Ok((satisfied, vec![literal])),
            }
        }
        Ok((satisfied, Vec::new()))
    }
}

/// Returns the number of pairs of variables with equal values. `named` gives the base types of those that count.
fn coincidences(named: &[Option<BaseType>], binding: &[Option<Value>]) -> usize {
    let bound: Vec<(BaseType, Value)> = (named.iter().zip(binding))
        .filter_map(|(base, value)| Some(((*base)?, (*value)?)))
        .collect();
    let pairs = bound.iter().enumerate();
    pairs
        .map(|(at, value)| bound[..at].iter().filter(|other| *other == value).count())
        .sum()
}

/// Returns the literals, each after those that bind its variables.
fn in_order(clause: &Clause, binding: &Binding) -> Vec<usize> {
    let mut bound: Vec<bool> = binding.iter().map(Option::is_some).collect();
    let mut order = Vec::new();
    while order.len() < clause.body.len() {
        let ready = |literal: &usize| !order.contains(literal) && clause.body[*literal].binds(&bound).is_some();
        let Some(next) = (0..clause.body.len()).find(ready) else {
            break;
        };
        for variable in clause.body[next].binds(&bound).unwrap_or_default() {
            bound[variable.index()] = true;
        }
        order.push(next);
    }
    order
}

/// Returns whether the pending literals bind every variable that they or the head need.
pub(super) fn safe(clause: &Clause, pending: &[bool]) -> bool {
    let mut bound = vec![false; clause.variables.len()];
    let literals = clause.body.iter().zip(pending);
    let literals = literals.filter_map(|(literal, pending)| pending.then_some(literal));
    let all_hold = bind_all(literals, &mut bound);
    let head = clause.head.terms.iter();
    all_hold
        && head
            .into_iter()
            .all(|term| !matches!(term, Term::Variable(variable) if !bound[variable.index()]))
}

/// Returns the value of a term.
pub(super) fn value(term: &Term, binding: &[Option<Value>]) -> Option<Value> {
    match *term {
        Term::Constant(constant) => Some(constant),
        Term::Variable(variable) => binding[variable.index()],
        Term::Wildcard => None,
    }
}

/// Returns the known values of an atom's arguments.
pub(super) fn pattern(atom: &Atom, binding: &[Option<Value>]) -> Pattern {
    atom.terms.iter().map(|term| value(term, binding)).collect()
}

/// Returns whether every variable of an atom is bound.
fn determined(atom: &Atom, binding: &[Option<Value>]) -> bool {
    let bound = |term: &Term| !matches!(term, Term::Variable(variable) if binding[variable.index()].is_none());
    atom.terms.iter().all(bound)
}

/// Returns whether an unbound variable occurs twice in an atom.
pub(super) fn repeats(atom: &Atom, binding: &[Option<Value>]) -> bool {
    let open = |term: &&Term| matches!(term, Term::Variable(variable) if binding[variable.index()].is_none());
    let mut terms = atom.terms.iter().enumerate().filter(|(_, term)| open(term));
    terms.any(|(at, term)| atom.terms[..at].contains(term))
}

/// Returns the value that an equality gives to its only unbound variable.
fn copy(literal: &Literal, binding: &[Option<Value>]) -> Option<(usize, Value)> {
    let Literal::Compare {
        op: Comparison::Equal,
        left,
        right,
        ..
    } = literal
    else {
        return None;
    };
    match (left, value(left, binding), right, value(right, binding)) {
        (Term::Variable(variable), None, _, Some(value)) | (_, Some(value), Term::Variable(variable), None) => {
            Some((variable.index(), value))
        }
        _ => None,
    }
}

/// Binds the variables of the terms to the values of the row and appends the newly bound ones to `bound`. Returns
/// `false` if they do not match; the caller then unbinds the variables in `bound`.
pub(super) fn unify(terms: &[Term], row: &[Value], binding: &mut Binding, bound: &mut Vec<usize>) -> bool {
    terms.iter().zip(row).all(|(term, &found)| match *term {
        Term::Wildcard => true,
        Term::Constant(constant) => constant == found,
        Term::Variable(variable) => match binding[variable.index()] {
            Some(known) => known == found,
            None => {
                binding[variable.index()] = Some(found);
                bound.push(variable.index());
                true
            }
        },
    })
}

/// Binds the variables of the head to the values of the pattern. On failure returns the column that does not match.
pub(super) fn bind_head(clause: &Clause, pattern: &[Option<Value>], binding: &mut Binding) -> Result<(), usize> {
    for (column, (term, &wanted)) in clause.head.terms.iter().zip(pattern).enumerate() {
        let Some(wanted) = wanted else { continue };
        if !unify(std::slice::from_ref(term), &[wanted], binding, &mut Vec::new()) {
            return Err(column);
        }
    }
    Ok(())
}
