//! Explanations: why a fact holds, and why another one does not.
//!
//! [`Session::explain`] and [`Session::explain_absence`] answer one query. An [`Explainer`] answers many queries about
//! the same state and keeps its intermediate results. An [`ExplanationPrinter`] converts an answer to text or JSON.
//!
//! ```text
//! Session --explain--> Explanation (facts with their clauses, absences with their reasons) --print--> text
//! ```
//!
//! **A proof has minimal height.** An inserted fact or a fact of the source has height 0. A derived fact has the height
//! of the highest fact in its derivation plus 1. Negated literals, comparisons, expressions and aggregates add nothing.
//! A proof shows the value of an aggregate, not its rows.
//!
//! To find the height of a fact, the search collects backwards all clause instances that the fact could rest on. It
//! then computes heights forwards through them in ascending order: Knuth's generalization of Dijkstra's algorithm. If
//! too many instances are relevant, it processes whole strata in that order until it reaches the fact. Among
//! derivations of equal height, the first clause in source order wins. Among derivations by one clause, the smallest
//! binding wins, by words (for symbols, by the order of interning). So a proof is never circular and always the same.
//!
//! **An absence names the failing literals**, clause by clause, under the nearest binding; see [`Miss`].
//!
//! This module uses only the public functions of a session, so it is independent of storage and evaluation. The work is
//! bounded; see [`Explainer::set_limit`].
// Decision: docs/decisions/analysis.md#d027

mod explanation_printer;
mod search;

pub use explanation_printer::ExplanationPrinter;

use crate::cancel::Cancel;
use crate::check::{Clause, ClauseId, Literal, PredicateId};
use crate::diag::codes;
use crate::diag::{Diagnostic, Limit, counted};
use crate::eval::limits::size;
use crate::session::Session;
use crate::value::Value;
use search::{Binding, ProofSearch};
use std::collections::{HashMap, VecDeque};
use std::fmt;

/// A row in which some values are open (`None`).
pub type Pattern = Vec<Option<Value>>;

/// The id of a node of an [`Explanation`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct NodeId(pub u32);

impl NodeId {
    /// Returns the position in [`Explanation::nodes`].
    pub fn index(self) -> usize {
        self.0 as usize
    }
}

/// The answer to a query: a graph of nodes, of which the first one is the subject of the query.
///
/// Equal subgoals share a node, which bounds the size of the graph.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Explanation {
    nodes: Vec<Node>,
}

impl Explanation {
    /// Returns all nodes; the first one is the subject of the query.
    pub fn nodes(&self) -> &[Node] {
        &self.nodes
    }

    /// Returns one node.
    pub fn node(&self, id: NodeId) -> &Node {
        &self.nodes[id.index()]
    }
}

/// One explained fact or absence.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Node {
    /// A fact that holds.
    Fact(Fact),
    /// A pattern without a matching fact.
    Absence(Absence),
}

/// A fact with the reason why it holds.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Fact {
    /// The predicate.
    pub predicate: PredicateId,
    /// The values.
    pub row: Vec<Value>,
    /// The height of its shortest proof.
    pub height: u32,
    /// The reason why it holds.
    pub origin: Origin,
}

/// The reason why a fact holds.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Origin {
    /// The caller inserted it.
    Input,
    /// It follows from earlier ticks, for a predicate of [`Rules::pasts`](crate::Rules). The number is the nearest tick
    /// of the window in which the operand held, or the first tick if it held in all.
    Past(u64),
    /// The source contains it.
    Source(ClauseId),
    /// A clause derives it.
    Derived(Derivation),
    /// A clause derived it from rows that a subsumption has removed.
    Removed,
}

/// A clause with the values of its variables.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Derivation {
    /// The clause.
    pub clause: ClauseId,
    /// The values by variable of the clause; `None` for a variable that does not occur.
    pub binding: Pattern,
    /// The instances of the literals, in the order of the body.
    pub premises: Vec<Premise>,
}

/// An instance of a literal that holds.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Premise {
    /// A positive literal or guard: this fact holds.
    Fact(NodeId),
    /// A negated literal: no fact matches this pattern.
    Absence(NodeId),
    /// A comparison of these values.
    Comparison {
        /// The left value.
        left: Value,
        /// The right value.
        right: Value,
    },
    /// An expression or aggregate with this value. The explanation does not unfold the rows of an aggregate; query them
    /// separately.
    Computed {
        /// The value.
        value: Value,
    },
}

/// A pattern without a matching fact, with the reason.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Absence {
    /// The predicate.
    pub predicate: PredicateId,
    /// The pattern: no row of the predicate has these values.
    pub pattern: Pattern,
    /// The reason.
    pub reason: AbsenceReason,
}

/// The reason why no fact matches a pattern.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum AbsenceReason {
    /// No clause derives the predicate, and no such fact was inserted.
    NotAFact,
    /// No clause derives a match: one entry for each clause with a body.
    NoClause(Vec<Miss>),
    /// The explanation contains enough absences already; see [`Explainer::ABSENCES_MAX`].
    NotLookedInto,
}

/// The reason why a clause does not derive a match.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Miss {
    /// The clause.
    pub clause: ClauseId,
    /// The obstacle.
    pub obstacle: Obstacle,
}

/// The part of a clause that prevents a derivation.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Obstacle {
    /// The head has a different value in this column.
    Head {
        /// The position of the column.
        column: usize,
    },
    /// Literals of the body fail.
    Body {
        /// The nearest binding, by variable of the clause; `None` for a variable without any candidate value.
        ///
        /// If literals over the head's variables alone fail, these are the failures, and nothing else is bound.
        /// Otherwise the nearest binding minimizes the number of failing literals. Ties go to the binding with the
        /// fewest pairs of variables of one type and equal value, then to one with fewer failing guards, then to one
        /// whose first failure comes later, then to the smallest words. If that search takes too many steps, the
        /// binding instead satisfies as many literals from the front as possible; among up to 100 such bindings, it is
        /// one with the fewest pairs of variables of one type and equal value.
        binding: Pattern,
        /// The literals that fail under the binding; at least one.
        failures: Vec<Failure>,
    },
    /// The body holds, but the rounds of a recursion exclude the row.
    Excluded {
        /// The binding, by variable of the clause.
        binding: Pattern,
        /// The fact that holds instead. `None` if a limit of the size ended the recursion, or if what excluded the row
        /// no longer holds itself.
        by: Option<NodeId>,
    },
}

/// A literal that does not hold.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Failure {
    /// Its position in the body.
    pub literal: usize,
    /// The reason why it does not hold.
    pub kind: FailureKind,
}

/// The reason why a literal does not hold.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum FailureKind {
    /// A positive literal or guard without a matching fact.
    Absent(NodeId),
    /// A positive literal or guard with a repeated open variable and without a matching fact.
    AbsentTwice,
    /// A negated literal that this fact contradicts.
    Holds(NodeId),
    /// A comparison of these values.
    Comparison {
        /// The left value.
        left: Value,
        /// The right value.
        right: Value,
    },
    /// An expression or aggregate with a different value.
    Computed {
        /// The value; `None` if it has none.
        value: Option<Value>,
    },
}

/// The reason why a query has no answer.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum ExplainError {
    /// The search would exceed its limit of steps; see [`Explainer::set_limit`].
    TooMuchWork {
        /// The limit.
        limit: u64,
    },
    /// The search takes more memory than the [limits](Session::limits) of the session leave: for indexes, aggregates,
    /// new symbols, or the explanation itself.
    TooMuchMemory {
        /// The limit, in bytes.
        limit: u64,
    },
    /// The definition of a functor failed.
    Functor {
        /// Why it failed.
        reason: String,
    },
    /// The caller cancelled it; see [`Explainer::new_with`].
    Cancelled,
}

impl fmt::Display for ExplainError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            ExplainError::TooMuchWork { limit } => write!(
                f,
                "no explanation found within {}; there are too many facts for this search",
                counted(limit, "step")
            ),
            ExplainError::TooMuchMemory { limit } => {
                write!(f, "the search for an explanation takes more than {}", size(*limit))
            }
            ExplainError::Functor { reason } => write!(f, "a functor failed: {reason}"),
            ExplainError::Cancelled => write!(f, "the search for an explanation was cancelled"),
        }
    }
}

impl std::error::Error for ExplainError {}

/// A diagnostic without a place, because no source is at fault.
impl From<ExplainError> for Diagnostic {
    fn from(error: ExplainError) -> Self {
        let fault = |code| Diagnostic::new(code, error.to_string());
        match error {
            ExplainError::Cancelled => fault(codes::CANCELLED),
            ExplainError::Functor { .. } => fault(crate::codes::FAILED_FUNCTOR),
            // Raising the limits of the session beyond this one does not raise it.
            ExplainError::TooMuchWork { limit } if limit < Explainer::LIMIT => {
                fault(codes::LIMIT_EXCEEDED).exceeds(Limit::Steps)
            }
            ExplainError::TooMuchWork { .. } => fault(codes::LIMIT_EXCEEDED),
            ExplainError::TooMuchMemory { limit } => fault(codes::LIMIT_EXCEEDED).exceeds(Limit::Memory(limit)),
        }
    }
}

impl Session {
    /// Explains why a fact holds: a proof of minimal height, down to inserted facts and facts of the source.
    ///
    /// `None` if the fact does not hold.
    ///
    /// ```
    /// # use logicity_datalog::{Program, Value, explain::Node};
    /// # let program = Program::parse(".decl e(x: number, y: number) .input e .decl p(x: number, y: number)
    /// #     p(x, y) :- e(x, y). p(x, z) :- p(x, y), e(y, z).")?;
    /// let mut session = program.session();      // p(x, y) :- e(x, y).   p(x, z) :- p(x, y), e(y, z).
    /// session.insert_all("e", [(1, 2), (2, 3)])?;
    /// session.commit()?;
    /// let p = program.predicate("p").unwrap();
    /// let [a, c] = [1, 3].map(Value::number);
    /// let proof = session.explain(p, &[a, c])?.unwrap();
    /// let Node::Fact(fact) = &proof.nodes()[0] else { unreachable!() };
    /// assert_eq!(fact.height, 2);
    /// assert!(session.explain(p, &[c, a])?.is_none());
    /// assert!(session.explain_absence(p, &[Some(c), None])?.is_some());
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// If the search exceeds [`Explainer::LIMIT`].
    pub fn explain(&self, id: PredicateId, row: &[Value]) -> Result<Option<Explanation>, ExplainError> {
        Explainer::new(self).explain(id, row)
    }

    /// Explains why no row matches the pattern, in which `None` matches any value. Returns `None` if some row matches.
    ///
    /// # Errors
    /// If the search exceeds [`Explainer::LIMIT`].
    pub fn explain_absence(
        &self,
        id: PredicateId,
        pattern: &[Option<Value>],
    ) -> Result<Option<Explanation>, ExplainError> {
        Explainer::new(self).explain_absence(id, pattern)
    }
}

/// Answers queries about one state of a session.
pub struct Explainer<'s> {
    search: ProofSearch<'s>,
    limit: u64,
}

impl<'s> Explainer<'s> {
    /// The default limit of steps for one query, unless the [limits](Session::limits) of the session are lower; see
    /// [`Explainer::set_limit`].
    pub const LIMIT: u64 = 20_000_000;
    /// The memory of a node: its query, its explanation, and its lines when it is printed.
    const NODE_BYTES: usize = 1 << 10;
    /// Maximum number of absences that one explanation explores. Proofs are always complete.
    pub const ABSENCES_MAX: usize = 256;

    /// Creates an explainer for the current state of `session`.
    pub fn new(session: &'s Session) -> Self {
        Explainer::new_with(session, &Cancel::never())
    }

    /// Cancellable variant of [`new`](Explainer::new): every query polls `cancel` a few hundred times a second. On
    /// cancellation it fails with [`ExplainError::Cancelled`], and the explainer is ready for the next query.
    pub fn new_with(session: &'s Session, cancel: &Cancel) -> Self {
        Explainer {
            search: ProofSearch::new(session, cancel),
            limit: Self::LIMIT.min(session.limits().steps),
        }
    }

    /// Sets the maximum number of steps for one query.
    ///
    /// A step visits a row or a literal; a million steps take well below a second.
    pub fn set_limit(&mut self, steps: u64) {
        self.limit = steps;
    }

    /// Explains the first row that matches the pattern, or why none matches.
    ///
    /// The first value states whether a row matches.
    ///
    /// # Errors
    /// If the search exceeds the limit.
    pub fn explain_either(
        &mut self,
        id: PredicateId,
        pattern: &[Option<Value>],
    ) -> Result<(bool, Option<Explanation>), ExplainError> {
        let fits = |row: &&[Value]| {
            (pattern.iter().zip(*row)).all(|(wanted, value)| wanted.is_none_or(|wanted| wanted == *value))
        };
        match self.search.session.encoded_rows(id).find(fits) {
            Some(row) => Ok((true, self.explain(id, row)?)),
            None => Ok((false, self.explain_absence(id, pattern)?)),
        }
    }

    /// Explains why a fact holds; see [`Session::explain`].
    ///
    /// # Errors
    /// If the search exceeds the limit.
    pub fn explain(&mut self, id: PredicateId, row: &[Value]) -> Result<Option<Explanation>, ExplainError> {
        self.search.refill(self.limit);
        if !self.search.session.contains(id, row) {
            return Ok(None);
        }
        let mut making = Making::default();
        making.fact(id, row.to_vec());
        making.finish(&mut self.search).map(Some)
    }

    /// Explains why no row matches; see [`Session::explain_absence`].
    ///
    /// # Errors
    /// If the search exceeds the limit.
    pub fn explain_absence(
        &mut self,
        id: PredicateId,
        pattern: &[Option<Value>],
    ) -> Result<Option<Explanation>, ExplainError> {
        self.search.refill(self.limit);
        let known = self.search.rules().predicates.get(id.index());
        if known.is_none_or(|predicate| predicate.arity() != pattern.len()) || self.search.some_row(id, pattern)? {
            return Ok(None);
        }
        let mut making = Making::default();
        making.absence(id, pattern.to_vec());
        making.finish(&mut self.search).map(Some)
    }

    /// Returns every one-step derivation of the fact by a clause with a body, ordered by clause and then by binding.
    ///
    /// # Errors
    /// If the search exceeds the limit.
    pub fn derivations(&mut self, id: PredicateId, row: &[Value]) -> Result<Vec<(ClauseId, Pattern)>, ExplainError> {
        self.search.refill(self.limit);
        let mut found = Vec::new();
        for clause in self.search.clauses_of(id) {
            let rules = self.search.rules();
            let clause_text = &rules.clauses[clause.index()];
            let mut binding: Binding = vec![None; clause_text.variables.len()];
            let pattern: Pattern = row.iter().copied().map(Some).collect();
            if clause_text.body.is_empty() || search::bind_head(clause_text, &pattern, &mut binding).is_err() {
                continue;
            }
            let first = found.len();
            let all = vec![true; clause_text.body.len()];
            self.search.solve(clause_text, &all, binding, 0, &mut |solution| {
                found.push((clause, solution.binding.to_vec()));
                true
            })?;
            found[first..].sort();
            found.dedup();
        }
        Ok(found)
    }

    /// Returns whether the clause would derive further rows without `literal` of its body.
    ///
    /// `None` if the literal is necessary, because it alone binds a variable of the head, of a comparison or of a
    /// negated literal.
    ///
    /// # Errors
    /// If the search exceeds the limit.
    pub fn matters(&mut self, clause: ClauseId, literal: usize) -> Result<Option<bool>, ExplainError> {
        self.search.refill(self.limit);
        let Some(clause) = self.search.rules().clauses.get(clause.index()) else {
            return Ok(None);
        };
        let mut pending = vec![true; clause.body.len()];
        if literal < pending.len() {
            pending[literal] = false;
        }
        if !search::safe(clause, &pending) {
            return Ok(None);
        }
        let mut new = false;
        let session = self.search.session;
        let binding = vec![None; clause.variables.len()];
        self.search.solve(clause, &pending, binding, 0, &mut |solution| {
            let head: Option<Vec<Value>> = (clause.head.terms.iter())
                .map(|term| search::value(term, solution.binding))
                .collect();
            new = head.is_some_and(|row| !session.contains(clause.head.predicate, &row));
            !new
        })?;
        Ok(Some(new))
    }
}

/// An explanation under construction: a queue of nodes in the order of their first mention.
#[derive(Default)]
struct Making {
    /// Each node's query, and its explanation once it exists.
    nodes: Vec<(Query, Option<Node>)>,
    known: HashMap<Query, NodeId>,
    todo: VecDeque<NodeId>,
    absences: usize,
}

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
enum Query {
    Fact(PredicateId, Vec<Value>),
    Absence(PredicateId, Pattern),
}

impl Making {
    fn fact(&mut self, id: PredicateId, row: Vec<Value>) -> NodeId {
        self.ask(Query::Fact(id, row))
    }

    fn absence(&mut self, id: PredicateId, pattern: Pattern) -> NodeId {
        self.ask(Query::Absence(id, pattern))
    }

    fn ask(&mut self, query: Query) -> NodeId {
        if let Some(&id) = self.known.get(&query) {
            return id;
        }
        let id = NodeId(u32::try_from(self.nodes.len()).expect("nodes are bounded by the steps of a search"));
        self.nodes.push((query.clone(), None));
        self.known.insert(query, id);
        self.todo.push_back(id);
        id
    }

    fn finish(mut self, search: &mut ProofSearch<'_>) -> Result<Explanation, ExplainError> {
        while let Some(id) = self.todo.pop_front() {
            search.step()?;
            search.reserve(Explainer::NODE_BYTES)?;
            let node = match self.nodes[id.index()].0.clone() {
                Query::Fact(predicate, row) => Node::Fact(self.explain_fact(search, predicate, row)?),
                Query::Absence(predicate, pattern) => Node::Absence(self.explain_absence(search, predicate, pattern)?),
            };
            self.nodes[id.index()].1 = Some(node);
        }
        Ok(Explanation {
            nodes: self.nodes.into_iter().filter_map(|(_, node)| node).collect(),
        })
    }

    fn explain_fact(
        &mut self,
        search: &mut ProofSearch<'_>,
        predicate: PredicateId,
        row: Vec<Value>,
    ) -> Result<Fact, ExplainError> {
        let (height, origin) = search.origin(predicate, &row)?;
        let origin = match origin {
            search::heights::Best::Input => match search.session.witness(predicate, &row) {
                Some(tick) => Origin::Past(tick),
                None => Origin::Input,
            },
            search::heights::Best::Removed => Origin::Removed,
            search::heights::Best::Source(clause) => Origin::Source(clause),
            search::heights::Best::Derived { clause, binding, rows } => {
                let body = &search.rules().clauses[clause.index()].body;
                let premise = |(literal, row): (&Literal, Option<Vec<Value>>)| match literal {
                    Literal::Positive(atom) | Literal::Guard(atom) => {
                        Premise::Fact(self.fact(atom.predicate, row.unwrap_or_default()))
                    }
                    Literal::Negative(atom) => {
                        Premise::Absence(self.absence(atom.predicate, search::pattern(atom, &binding)))
                    }
                    Literal::Compare { left, right, .. } => Premise::Comparison {
                        left: search::value(left, &binding).unwrap_or_default(),
                        right: search::value(right, &binding).unwrap_or_default(),
                    },
                    // The literal holds, so the result equals its value.
                    Literal::Compute { to, .. } | Literal::Aggregate { to, .. } => Premise::Computed {
                        value: search::value(to, &binding).unwrap_or_default(),
                    },
                };
                let premises = body.iter().zip(rows).map(premise).collect();
                Origin::Derived(Derivation {
                    clause,
                    binding,
                    premises,
                })
            }
        };
        Ok(Fact {
            predicate,
            row,
            height,
            origin,
        })
    }

    fn explain_absence(
        &mut self,
        search: &mut ProofSearch<'_>,
        predicate: PredicateId,
        pattern: Pattern,
    ) -> Result<Absence, ExplainError> {
        let reason = if !search.rules().predicates[predicate.index()].derived {
            AbsenceReason::NotAFact
        } else if self.absences == Explainer::ABSENCES_MAX {
            AbsenceReason::NotLookedInto
        } else {
            self.absences += 1;
            let mut misses = Vec::new();
            for clause in search.clauses_of(predicate) {
                if let Some(obstacle) = self.obstacle(search, clause, &pattern)? {
                    misses.push(Miss { clause, obstacle });
                }
            }
            AbsenceReason::NoClause(misses)
        };
        Ok(Absence {
            predicate,
            pattern,
            reason,
        })
    }

    /// Returns what prevents a clause from deriving the pattern; `None` for a fact of the source.
    fn obstacle(
        &mut self,
        search: &mut ProofSearch<'_>,
        id: ClauseId,
        pattern: &Pattern,
    ) -> Result<Option<Obstacle>, ExplainError> {
        let clause = &search.rules().clauses[id.index()];
        let by_rounds = search.rules().predicates[clause.head.predicate.index()].depends_on_rounds();
        if clause.body.is_empty() && !by_rounds {
            return Ok(None);
        }
        let mut binding: Binding = vec![None; clause.variables.len()];
        if let Err(column) = search::bind_head(clause, pattern, &mut binding) {
            return Ok((!clause.body.is_empty()).then_some(Obstacle::Head { column }));
        }
        if by_rounds {
            let mut holds = None;
            let all = vec![true; clause.body.len()];
            search.solve(clause, &all, binding.clone(), 0, &mut |solution| {
                holds.get_or_insert_with(|| solution.binding.to_vec());
                false
            })?;
            if let Some(binding) = holds {
                return self.excluded(search, clause, binding).map(Some);
            }
        }
        let (binding, failing) = search.nearest(clause, binding)?;
        let mut failures = Vec::new();
        for literal in failing {
            let kind = match &clause.body[literal] {
                Literal::Positive(atom) | Literal::Guard(atom) if search::repeats(atom, &binding) => {
                    FailureKind::AbsentTwice
                }
                Literal::Positive(atom) | Literal::Guard(atom) => {
                    FailureKind::Absent(self.absence(atom.predicate, search::pattern(atom, &binding)))
                }
                Literal::Negative(atom) => {
                    let Some(row) = search.first_row(atom.predicate, &search::pattern(atom, &binding))? else {
                        continue;
                    };
                    FailureKind::Holds(self.fact(atom.predicate, row))
                }
                Literal::Compare { left, right, .. } => {
                    match (search::value(left, &binding), search::value(right, &binding)) {
                        (Some(left), Some(right)) => FailureKind::Comparison { left, right },
                        _ => continue,
                    }
                }
                Literal::Compute { .. } | Literal::Aggregate { .. } => {
                    match search.result(&clause.body[literal], &binding)? {
                        Some(value) => FailureKind::Computed { value },
                        None => continue,
                    }
                }
            };
            failures.push(Failure { literal, kind });
        }
        Ok(Some(Obstacle::Body { binding, failures }))
    }

    /// Returns what excludes the row that a clause derives with this binding.
    fn excluded(
        &mut self,
        search: &ProofSearch<'_>,
        clause: &Clause,
        binding: Binding,
    ) -> Result<Obstacle, ExplainError> {
        let head = clause.head.predicate;
        let predicate = &search.rules().predicates[head.index()];
        let row = search::pattern(&clause.head, &binding);
        let same = |key: &Vec<usize>| -> Pattern {
            let columns = row.iter().enumerate();
            columns.map(|(at, value)| value.filter(|_| key.contains(&at))).collect()
        };
        let mut by = None;
        for pattern in predicate.choices.iter().map(same) {
            if by.is_none() {
                by = search.first_row(head, &pattern)?;
            }
        }
        if let (None, Some(pairs)) = (&by, predicate.subsumption) {
            by = search.stronger(head, pairs, &row)?;
        }
        let by = by.map(|row| self.fact(head, row));
        Ok(Obstacle::Excluded { binding, by })
    }
}
