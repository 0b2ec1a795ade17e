//! Sessions: facts, their changes and what follows from them.

use std::fmt;
use std::sync::Arc;

use crate::cancel::Cancel;
use crate::check::{ClauseId, Literal, Predicate, PredicateId, Term};
use crate::convert::{AsPredicate, FromRow, IntoRow, RowError, check_words, encode, words_of};
use crate::eval::calls::Calls;
use crate::eval::delta::{Delta, Rows};
use crate::eval::exec::{self, CommitOptions, Store};
use crate::eval::limits::{EvalError, Limits};
use crate::eval::output::Abort;
use crate::eval::stats::{EvalEvent, EvalStats, Strategy};
use crate::eval::workers::{Threads, Workers};
use crate::history::History;
use crate::program::Program;
use crate::symbol::{Symbols, WordSize};
use crate::syntax::functor::{AggregateOp, Functor};
use crate::value::Value;

mod saved;

/// Facts and everything that the rules derive from them.
///
/// [`insert`](Session::insert) and [`retract`](Session::retract) record pending changes, which no query sees.
/// [`commit`](Session::commit) applies all of them at once and updates the derived predicates. Every query answers as of
/// the last commit.
pub struct Session {
    pub(super) program: Program,
    symbols: Symbols,
    pub(super) store: Box<dyn Store>,
    limits: Limits,
    strategy: Strategy,
    workers: Workers,
    work: EvalStats,
    history: History,
}

impl Program {
    /// Returns the predicate if the caller may set its rows, and the one that stores them.
    pub(crate) fn base(&self, predicate: impl AsPredicate) -> Result<(&Predicate, PredicateId), RowError> {
        let (id, predicate) = predicate.resolve(self.rules())?;
        if predicate.derived && predicate.edb.is_none() {
            return Err(RowError::Derived {
                predicate: predicate.name.clone(),
            });
        }
        Ok((predicate, predicate.edb.unwrap_or(id)))
    }

    /// Creates a session without inserted facts.
    ///
    /// Every predicate is empty until the first commit, even one with facts in the source.
    pub fn session(&self) -> Session {
        self.session_with(self.rules().symbols.clone())
    }

    /// Creates a session with this symbol table, which begins with the symbols of the program.
    pub(crate) fn session_with(&self, symbols: Symbols) -> Session {
        let mut session = Session {
            store: exec::store(&self.0),
            symbols,
            program: self.clone(),
            limits: Limits::default(),
            strategy: Strategy::Auto,
            workers: Workers::default(),
            work: EvalStats::default(),
            history: History::new(self.rules()),
        };
        session.stage(0);
        session
    }
}

impl Session {
    /// Returns the program that the session runs.
    pub fn program(&self) -> &Program {
        &self.program
    }

    /// Returns the symbol table: the symbols of the program and those interned in this session.
    pub fn symbols(&self) -> &Symbols {
        &self.symbols
    }

    /// Returns the word for a symbol, for use in rows of this session.
    pub fn intern(&mut self, text: &str) -> Value {
        Value(self.symbols.intern(text).0)
    }

    /// Sets the limits of a commit. A commit that would exceed one fails.
    pub fn set_limits(&mut self, limits: Limits) {
        self.limits = limits;
    }

    /// Returns the limits of a commit.
    pub fn limits(&self) -> Limits {
        self.limits
    }

    /// Returns the bytes of the rows, indexes, pending changes and symbols.
    pub fn bytes(&self) -> u64 {
        self.store.bytes() + self.symbols.bytes() + self.history.bytes()
    }

    /// Returns the bytes that the limit leaves for work on the committed rows.
    pub(crate) fn bytes_left(&self) -> u64 {
        self.limits.bytes.saturating_sub(self.bytes())
    }

    /// Sets the number of evaluation threads; the default is one.
    ///
    /// The number changes neither rows nor their order, deltas or statistics.
    ///
    /// # Errors
    /// If the operating system cannot start the threads.
    pub fn set_threads(&mut self, threads: Threads) -> std::io::Result<()> {
        self.workers = Workers::new(threads)?;
        Ok(())
    }

    /// Sets how commits update strata; the default is [`Strategy::Auto`].
    ///
    /// Other strategies serve tests and measurements.
    pub fn set_strategy(&mut self, strategy: Strategy) {
        self.strategy = strategy;
    }

    /// Marks a row to hold from the next commit on. The last change of a row before the commit wins.
    ///
    /// The predicate is a name or an id, the row a tuple, an array or a slice of Rust values; see [`IntoRow`]. Ids and
    /// rows of [`Value`]s are fastest.
    ///
    /// ```
    /// # use logicity_datalog::Program;
    /// let program = Program::parse(".decl age(person: symbol, years: number) .input age")?;
    /// let mut session = program.session();
    /// session.insert("age", ("Ada", 36))?;
    ///
    /// let error = session.insert("age", (36, "Ada")).unwrap_err();
    /// assert_eq!(error.to_string(), "the column `person` of `age` expects a symbol, not 36");
    /// let error = session.insert("aeg", ("Ada", 36)).unwrap_err();
    /// assert_eq!(error.to_string(), "the program declares no predicate `aeg`; did you mean `age`?");
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// If the program has no such predicate, the row does not fit it, or rules alone define it.
    pub fn insert(&mut self, predicate: impl AsPredicate, row: impl IntoRow) -> Result<(), RowError> {
        self.change(predicate, &row, true)
    }

    /// Records a change of a row.
    fn change(&mut self, predicate: impl AsPredicate, row: &impl IntoRow, holds: bool) -> Result<(), RowError> {
        let (predicate, to) = self.program.base(predicate)?;
        let mut encoded = Vec::new();
        let types = &self.program.rules().types;
        let words = words_of(predicate, row, types, &self.symbols.encoder(), &mut encoded)?;
        check_words(predicate, words, &self.symbols)?;
        if !holds && !self.history.given.is_empty() {
            self.history.given.remove(&(to, words.into()));
        }
        self.store.change(to, words, holds);
        Ok(())
    }

    /// Replaces the symbol table by one that begins with it.
    pub(crate) fn set_symbols(&mut self, symbols: Symbols) {
        self.symbols = symbols;
    }

    /// Records a change of a row that fits the predicate, which stores rows.
    pub(crate) fn change_row(&mut self, to: PredicateId, words: &[Value], holds: bool) {
        self.store.change(to, words, holds);
    }

    /// Marks many rows to hold from the next commit on; faster than repeated [`insert`](Session::insert).
    ///
    /// ```
    /// # use logicity_datalog::Program;
    /// let program = Program::parse(".decl edge(x: number, y: number) .input edge")?;
    /// let mut session = program.session();
    /// session.insert_all("edge", (1..100).map(|x| (x, x + 1)))?;
    /// session.commit()?;
    /// assert_eq!(session.len("edge"), 99);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// If one of the rows is invalid. In that case the call changes nothing.
    pub fn insert_all(
        &mut self,
        predicate: impl AsPredicate,
        rows: impl IntoIterator<Item = impl IntoRow>,
    ) -> Result<(), RowError> {
        /// Words per call of the store.
        const PART: usize = 1 << 12;
        let (predicate, to) = self.program.base(predicate)?;
        let arity = predicate.arity();
        let mut encoded = Vec::new();
        let types = &self.program.rules().types;
        let is_long = self.symbols.word_size() == WordSize::Bits64;
        let symbolic = is_long || predicate.columns.iter().any(|column| column.base.is_interned());
        let before = self.store.pending(to);
        let mut words: Vec<Value> = Vec::with_capacity(PART);
        let rows = rows.into_iter();
        self.store.reserve(to, rows.size_hint().0);
        for row in rows {
            let row = match row.words() {
                Some(words) if !symbolic && words.len() == arity => Ok(words),
                Some(words) => check_words(predicate, words, &self.symbols).map(|()| words),
                None => {
                    encoded.clear();
                    encode(predicate, &row, types, &self.symbols.encoder(), &mut encoded)
                        .and_then(|()| check_words(predicate, &encoded, &self.symbols))
                        .map(|()| encoded.as_slice())
                }
            };
            let row = match row {
                Ok(row) => row,
                Err(error) => {
                    self.store.forget(to, before);
                    return Err(error);
                }
            };
            if arity == 0 {
                self.store.change(to, row, true);
            }
            words.extend_from_slice(row);
            if words.len() >= PART {
                self.store.insert_all(to, &words, arity);
                words.clear();
            }
        }
        if !words.is_empty() {
            self.store.insert_all(to, &words, arity);
        }
        Ok(())
    }

    /// Marks a row not to hold from the next commit on.
    ///
    /// This undoes an [`insert`](Session::insert), not a rule: a fact of the source holds nevertheless.
    ///
    /// # Errors
    /// As [`insert`](Session::insert).
    pub fn retract(&mut self, predicate: impl AsPredicate, row: impl IntoRow) -> Result<(), RowError> {
        self.change(predicate, &row, false)
    }

    /// Discards the changes since the last commit. What earlier ticks imply for the present one stays pending.
    pub fn rollback(&mut self) {
        self.store.rollback();
        self.stage(0);
    }

    /// Begins the next tick with the pending changes and commits them. All other facts stay as they are.
    ///
    /// [`commit`](Session::commit) stays in the present tick. If a tick has several commits, temporal operators of
    /// later ticks read the state after the last one.
    ///
    /// ```
    /// # use logicity_datalog::Program;
    /// let program = Program::parse(
    ///     ".decl button(x: symbol) .input button
    ///      .decl light(x: symbol)
    ///      light(x) :- once[0,2] button(x).",
    /// )?;
    /// let mut session = program.session();
    /// session.insert("button", ("hall",))?;
    /// session.commit()?; // tick 0
    /// session.retract("button", ("hall",))?;
    /// session.advance()?; // tick 1
    /// session.advance()?;
    /// assert!(session.contains("light", ("hall",)));
    /// session.advance()?;
    /// assert_eq!((session.tick(), session.contains("light", ("hall",))), (3, false));
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// As [`commit`](Session::commit). The next tick has begun nevertheless; the changes are still pending.
    pub fn advance(&mut self) -> Result<Delta, EvalError> {
        self.advance_with(&Cancel::never())
    }

    /// Cancellable variant of [`advance`](Session::advance), as [`commit_with`](Session::commit_with).
    ///
    /// # Errors
    /// As [`advance`](Session::advance).
    pub fn advance_with(&mut self, cancel: &Cancel) -> Result<Delta, EvalError> {
        self.run_advance(None, cancel)
    }

    /// Variant of [`advance`](Session::advance) that calls `watch` as [`commit_watched`](Session::commit_watched) does.
    ///
    /// # Errors
    /// As [`advance`](Session::advance).
    pub fn advance_watched(&mut self, watch: &dyn Fn(EvalEvent)) -> Result<Delta, EvalError> {
        self.run_advance(Some(watch), &Cancel::never())
    }

    fn run_advance(&mut self, watch: Option<&dyn Fn(EvalEvent)>, cancel: &Cancel) -> Result<Delta, EvalError> {
        let before = self.history.staged.len();
        self.history.advance();
        self.stage(before);
        self.run_commit(watch, cancel)
    }

    /// Makes the staged changes from this position on pending.
    fn stage(&mut self, from: usize) {
        for (predicate, row, holds) in &self.history.staged[from..] {
            self.store.change(*predicate, row, *holds);
        }
    }

    /// Sets the seed of the draws of clauses with probabilities, from the next commit on; 0 by default. Without such
    /// clauses it has no effect.
    ///
    /// A draw is a function of the seed, the [tick](Session::tick), the clause and the values of its variables. So
    /// [`commit`](Session::commit) repeats the draws of the tick, and [`advance`](Session::advance) makes new ones.
    ///
    /// ```
    /// # use logicity_datalog::Program;
    /// let program = Program::parse(
    ///     ".decl coin(x: symbol) .input coin
    ///      .decl heads(x: symbol)
    ///      0.5 :: heads(x) :- coin(x).",
    /// )?;
    /// let mut session = program.session();
    /// session.set_seed(7);
    /// session.insert("coin", ("penny",))?;
    /// session.commit()?;
    /// let mut heads = 0;
    /// for _ in 0..1000 {
    ///     session.advance()?;
    ///     heads += session.len("heads");
    /// }
    /// assert!((450..550).contains(&heads));
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn set_seed(&mut self, seed: u64) {
        let before = self.history.staged.len();
        self.history.set_seed(seed);
        self.stage(before);
    }

    /// Sets the word from which the draws of this tick follow, for a caller that counts the ticks itself.
    #[doc(hidden)]
    pub fn set_chance(&mut self, word: u64) {
        let before = self.history.staged.len();
        self.history.set_word(word);
        self.stage(before);
    }

    /// Inserts a row of a predicate of [`Rules::pasts`](crate::Rules), with the tick that explanations name. The caller
    /// keeps the memory of earlier ticks itself and does not call [`advance`](Session::advance).
    ///
    /// # Errors
    /// As [`insert`](Session::insert).
    pub fn insert_past(&mut self, predicate: PredicateId, row: &[Value], tick: u64) -> Result<(), RowError> {
        self.insert(predicate, row)?;
        self.history.given.insert((predicate, row.into()), tick);
        Ok(())
    }

    /// Returns the tick that explains a row of a predicate of [`Rules::pasts`](crate::Rules): the nearest tick of its
    /// window in which the operand held, or the first one if it held in all of them.
    pub(crate) fn witness(&self, predicate: PredicateId, row: &[Value]) -> Option<u64> {
        self.history.witness(predicate, row)
    }

    /// Returns the number of the present tick, from 0: how often [`advance`](Session::advance) was called.
    pub fn tick(&self) -> u64 {
        self.history.tick()
    }

    /// Applies the pending changes, derives what follows and returns the difference.
    ///
    /// The [`Delta`] lists, for every predicate, exactly the rows that became true and those that became false.
    ///
    /// # Errors
    /// If the evaluation exceeds a limit. In that case the session stays as before the call, with the same changes
    /// pending; see [`rollback`](Session::rollback).
    pub fn commit(&mut self) -> Result<Delta, EvalError> {
        self.run_commit(None, &Cancel::never())
    }

    /// Commits and calls `watch` on the calling thread whenever the evaluation of a clause begins or ends.
    ///
    /// The engine reads no clock; the callback may.
    ///
    /// # Errors
    /// As [`commit`](Session::commit).
    pub fn commit_watched(&mut self, watch: &dyn Fn(EvalEvent)) -> Result<Delta, EvalError> {
        self.run_commit(Some(watch), &Cancel::never())
    }

    /// Cancellable variant of [`commit`](Session::commit). On cancellation the session is as before the call, with the
    /// same changes pending.
    ///
    /// The calling thread polls `cancel`: up to a few thousand times a second while it evaluates rules, less often
    /// while it sorts rows.
    ///
    /// # Errors
    /// [`EvalError::Cancelled`] on cancellation.
    pub fn commit_with(&mut self, cancel: &Cancel) -> Result<Delta, EvalError> {
        self.run_commit(None, cancel)
    }

    fn run_commit(&mut self, watch: Option<&dyn Fn(EvalEvent)>, cancel: &Cancel) -> Result<Delta, EvalError> {
        let limits = Limits {
            bytes: self.limits.bytes.saturating_sub(self.history.bytes()),
            ..self.limits
        };
        let options = CommitOptions {
            strategy: self.strategy,
            limits,
            workers: &self.workers,
            watch,
            cancel,
            calls: None,
        };
        let calls = match self.program.rules().functors.is_empty() {
            true => None,
            false => Some(self.calls()?),
        };
        let options = CommitOptions {
            calls: calls.as_ref(),
            ..options
        };
        let known = self.symbols.len();
        match self.store.commit(&self.program.0, &self.symbols, options) {
            Ok((delta, work)) => {
                self.work = work;
                self.history.note(&delta);
                Ok(delta)
            }
            Err(mut error) => {
                self.symbols.truncate(known);
                if let EvalError::TooManyInputs { limit } | EvalError::TooMuchMemory { limit, .. } = &mut error {
                    // The history takes part of it.
                    *limit = self.limits.bytes;
                }
                Err(error)
            }
        }
    }

    /// Returns the functors of the program; an error if a clause applies one without a definition.
    fn calls(&self) -> Result<Arc<Calls>, EvalError> {
        let rules = self.program.rules();
        for (clause, id) in rules.clauses.iter().zip((0..).map(ClauseId)) {
            let applied = clause.body.iter().filter_map(|literal| match literal {
                Literal::Compute {
                    functor: Functor::Call,
                    arguments,
                    ..
                } => rules.called(arguments),
                _ => None,
            });
            if let Some(functor) = applied.into_iter().find(|functor| !functor.is_defined()) {
                return Err(EvalError::UndefinedFunctor {
                    functor: functor.name.clone(),
                    clause: id,
                });
            }
        }
        Ok(Calls::new(&rules.functors))
    }

    /// Returns whether the row holds. A row that does not fit the predicate does not.
    ///
    /// ```
    /// # use logicity_datalog::Program;
    /// let program = Program::parse(".decl capital(city: symbol, of: symbol) capital(\"Paris\", \"France\").")?;
    /// let mut session = program.session();
    /// session.commit()?;
    /// assert!(session.contains("capital", ("Paris", "France")));
    /// assert!(!session.contains("capital", ("Lyon", "France")));
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn contains(&self, predicate: impl AsPredicate, row: impl IntoRow) -> bool {
        let Some((id, predicate)) = self.stored(predicate) else {
            return false;
        };
        if let Some(words) = row.words() {
            return words.len() == predicate.arity() && self.store.contains(id, words);
        }
        let mut words = Vec::new();
        let encoded = encode(
            predicate,
            &row,
            &self.program.rules().types,
            &self.symbols.finder(),
            &mut words,
        );
        encoded.is_ok() && self.store.contains(id, &words)
    }

    /// Returns the aggregate over the rows of a predicate that begin with `key`, if that predicate [is
    /// aggregated](Program::is_aggregated).
    pub(crate) fn group(&self, id: PredicateId, key: &[Value], op: AggregateOp) -> Option<Value> {
        self.store.group(id, key, op)
    }

    /// Returns the value of a correlated aggregate for these parameters, and the number of rows scanned. It stops after
    /// about `budget` rows, or if it takes more than `bytes`.
    pub(crate) fn correlated(
        &self,
        aggregate: &Literal,
        parameters: &[Value],
        (budget, bytes): (u64, u64),
        cancel: &Cancel,
    ) -> (Result<Option<Value>, Abort>, u64) {
        let functors = &self.program.rules().functors;
        let calls = (!functors.is_empty()).then(|| Calls::new(functors));
        (self.store).correlated(
            aggregate,
            parameters,
            &self.symbols,
            (budget, bytes, cancel),
            calls.as_ref(),
        )
    }

    /// Returns the rows that hold, as tuples, arrays or vectors of Rust values; see [`FromRow`]. Their order is that of
    /// [`encoded_rows`](Session::encoded_rows).
    ///
    /// ```
    /// # use logicity_datalog::Program;
    /// let program = Program::parse(".decl age(person: symbol, years: number) age(\"Ada\", 36). age(\"Alan\", 41).")?;
    /// let mut session = program.session();
    /// session.commit()?;
    /// let ages: Vec<(&str, i64)> = session.rows("age")?.collect();
    /// assert_eq!(ages, [("Ada", 36), ("Alan", 41)]);
    ///
    /// let error = session.rows::<(&str, &str)>("age").err().unwrap();
    /// assert_eq!(error.to_string(), "the column `years` of `age` has type number; expected type symbol");
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// If the program has no such predicate, or its columns have other types.
    pub fn rows<'s, T: FromRow<'s>>(
        &'s self,
        predicate: impl AsPredicate,
    ) -> Result<impl ExactSizeIterator<Item = T>, RowError> {
        let (id, predicate) = predicate.resolve(self.program.rules())?;
        T::check(predicate, self.symbols().word_size())?;
        let row = move |position| T::from_row(self.row(id, position), &predicate.columns, &self.symbols);
        Ok((0..self.len(id)).map(row))
    }

    /// Returns the rows that hold as words, in the order of their words. For symbols this is the order of interning. A
    /// predicate that [is aggregated](Program::is_aggregated) has none.
    pub fn encoded_rows(&self, id: PredicateId) -> impl Iterator<Item = &[Value]> {
        let arity = self.stored(id).map_or(0, |(_, predicate)| predicate.arity());
        (0..self.len(id)).map(move |position| &self.store.row(id, position)[..arity])
    }

    /// Returns the rows that hold as a value that later commits do not change. It shares the rows, so it takes no copy;
    /// they stay in memory until it is dropped. A predicate that [is aggregated](Program::is_aggregated) has none.
    ///
    /// ```
    /// # use logicity_datalog::Program;
    /// let program = Program::parse(".decl edge(x: number, y: number) .input edge")?;
    /// let mut session = program.session();
    /// session.insert("edge", (1, 2))?;
    /// session.commit()?;
    /// let before = session.shared_rows("edge");
    /// session.retract("edge", (1, 2))?;
    /// session.commit()?;
    /// assert_eq!((before.len(), session.len("edge")), (1, 0));
    /// assert_eq!(session.decode::<(i64, i64)>("edge", &before)?.collect::<Vec<_>>(), [(1, 2)]);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn shared_rows(&self, predicate: impl AsPredicate) -> Rows {
        let stored = self.stored(predicate);
        stored.map_or_else(Rows::default, |(id, predicate)| self.store.rows(id, predicate.arity()))
    }

    /// Returns rows of a [`Delta`] as Rust values, as [`rows`](Session::rows) does.
    ///
    /// ```
    /// # use logicity_datalog::Program;
    /// let program = Program::parse(".decl edge(x: number, y: number) .input edge")?;
    /// let mut session = program.session();
    /// session.insert("edge", (1, 2))?;
    /// let delta = session.commit()?;
    /// let added = session.decode::<(i64, i64)>("edge", &delta.changes()[0].added)?;
    /// assert_eq!(added.collect::<Vec<_>>(), [(1, 2)]);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// As [`rows`](Session::rows).
    pub fn decode<'s, T: FromRow<'s>>(
        &'s self,
        predicate: impl AsPredicate,
        rows: &'s Rows,
    ) -> Result<impl Iterator<Item = T>, RowError> {
        let (_, predicate) = predicate.resolve(self.program.rules())?;
        T::check(predicate, self.symbols().word_size())?;
        let columns = &predicate.columns;
        Ok(rows.iter().map(move |row| T::from_row(row, columns, &self.symbols)))
    }

    /// Returns the row at a position below [`Session::len`].
    pub(crate) fn row(&self, id: PredicateId, position: usize) -> &[Value] {
        &self.store.row(id, position)[..self.stored(id).map_or(0, |(_, predicate)| predicate.arity())]
    }

    /// Returns the number of rows that hold; 0 for a predicate that the program does not have.
    pub fn len(&self, predicate: impl AsPredicate) -> usize {
        self.stored(predicate).map_or(0, |(id, _)| self.store.len(id))
    }

    /// Returns whether no row of the predicate holds.
    pub fn is_empty(&self, predicate: impl AsPredicate) -> bool {
        self.len(predicate) == 0
    }

    /// Returns a predicate whose rows are stored.
    fn stored(&self, predicate: impl AsPredicate) -> Option<(PredicateId, &Predicate)> {
        let (id, predicate) = predicate.resolve(self.program.rules()).ok()?;
        (!self.program.is_aggregated(id)).then_some((id, predicate))
    }

    /// Returns the distinct rows that one clause derives from the current facts, sorted.
    ///
    /// For a fact of the source this is the fact itself. Several clauses may derive the same row. For a predicate
    /// that [is aggregated](Program::is_aggregated) the result is empty.
    pub fn fired(&self, clause: ClauseId) -> Vec<Vec<Value>> {
        if clause.index() < self.program.rules().clauses.len() {
            let bytes = self.bytes_left() / 4;
            let mut rows = self.store.fired(&self.program.0, &self.symbols, clause, bytes);
            let rules = self.program.rules();
            let head = rules.clauses[clause.index()].head.predicate;
            if rules.predicates[head.index()].depends_on_rounds() {
                rows.retain(|row| self.store.contains(head, row));
            }
            rows
        } else {
            Vec::new()
        }
    }

    /// Returns a session of a query with the rows that the query reads. Its commit answers the query.
    ///
    /// `query` is the program of [`Workspace::ask`](crate::Workspace::ask) for the workspace of this session's program
    /// and the symbols of this session. It has the functors of this session's program. Its limits are those of this session, and of memory what this session leaves.
    ///
    /// ```
    /// # use logicity_datalog::cancel::Cancel;
    /// # use logicity_datalog::{InputPolicy, Program, Workspace, diag::Sources};
    /// let mut sources = Sources::new();
    /// let mut workspace = Workspace::new(InputPolicy::Fixed);
    /// let rules = sources.add("edges.dl", ".decl edge(x: number, y: number) edge(1, 2). edge(1, 3). edge(2, 3).");
    /// workspace.add(&mut sources, rules, &|_: &std::path::Path| unreachable!());
    /// let mut session = Program::new(workspace.check().rules.unwrap()).unwrap().session();
    /// session.commit()?;
    ///
    /// let question = sources.add("<query>", "edge(1, x), !edge(2, x)");
    /// let query = workspace.ask(&sources, question, session.symbols().clone()).rules.unwrap();
    /// let query = Program::new(query).unwrap();
    /// let mut answer = session.query(&query, &Cancel::never())?;
    /// answer.commit()?;
    /// let rows: Vec<(i64,)> = answer.rows(Workspace::ANSWER)?.collect();
    /// assert_eq!(rows, [(2,)]);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// If the rows take too much memory, and on cancellation.
    pub fn query(&self, query: &Program, cancel: &Cancel) -> Result<Session, EvalError> {
        /// Rows between two tests of the limit and of `cancel`.
        const PART: usize = 1 << 12;
        let query = &query.clone().defined_as(&self.program);
        let mut session = query.session();
        let limit = self.bytes_left();
        session.set_limits(Limits {
            bytes: limit,
            ..self.limits
        });
        let rules = query.rules();
        let atoms = || (rules.clauses.iter()).flat_map(|clause| clause.body.iter().filter_map(Literal::atom));
        for (id, predicate) in (0..)
            .map(PredicateId)
            .zip(&rules.predicates)
            .filter(|(_, predicate)| predicate.input)
        {
            let reading: Vec<_> = atoms().filter(|atom| atom.predicate == id).collect();
            let matches = |row: &[Value], terms: &[Term]| {
                (terms.iter().zip(row)).all(|(term, value)| !matches!(term, Term::Constant(wanted) if wanted != value))
            };
            let read = |row: &&[Value]| reading.iter().any(|atom| matches(row, &atom.terms));
            let length = if reading.is_empty() { 0 } else { self.len(id) };
            for start in (0..length).step_by(PART) {
                if cancel.requested() {
                    return Err(EvalError::Cancelled { clause: ClauseId(0) });
                }
                if session.bytes() > limit {
                    return Err(EvalError::TooManyInputs { limit });
                }
                let part = start..length.min(start + PART);
                let rows = part.map(|position| &self.store.row(id, position)[..predicate.arity()]);
                (session.insert_all(id, rows.filter(read)))
                    .expect("an input of the query has the columns of the predicate");
            }
        }
        Ok(session)
    }

    /// Returns the statistics of the last successful commit.
    pub fn work(&self) -> &EvalStats {
        &self.work
    }
}

impl fmt::Debug for Session {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let predicates = self.program.rules().predicates.iter().zip(0..);
        f.debug_map()
            .entries(predicates.map(|(predicate, id)| (&predicate.name, self.len(PredicateId(id)))))
            .finish()
    }
}
