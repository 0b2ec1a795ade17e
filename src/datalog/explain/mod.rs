//! Why a fact holds, and why another does not.
//!
//! Reach for [`Session::explain`] and [`Session::explain_absence`] to ask one question; for an [`Explainer`] to ask many about
//! the same state, since it keeps what it found out on the way; for [`ExplanationPrinter`] to turn an answer into text or JSON.
//!
//! ```text
//! Session --explain--> Explanation (nodes: what holds by which clause, what does not hold and for lack of what) --tell--> text
//! ```
//!
//! **A proof is shortest by height.** A fact that was inserted or stands in the text has height 0; a derived one has 1 more than
//! the highest fact its derivation needs. Negated literals, comparisons, expressions and aggregates
//! add nothing; the rows that an aggregate looks at are not told, only its value. To know the height of a fact, all instances
//! of clauses that it could rest on are collected backwards, and heights go forwards through them in ascending order, as Knuth
//! generalised Dijkstra's algorithm; if too much is relevant, whole strata are settled in that order until the fact is reached. Of
//! derivations equally high the first clause of the text is taken, of one clause's the one whose variables have the smallest words
//! (for symbols: interned first). So a proof never rests on itself and is always the same.
//!
//! **What does not hold** is told clause by clause: the literals that fail under the nearest binding. See [`Miss`].
//!
//! This module reads a session through its public functions only and so knows nothing of how relations are kept or evaluated.
//! WorkCounts is bounded: see [`Explainer::set_limit`].

mod explanation_printer;
mod heights;
mod search;

pub use explanation_printer::ExplanationPrinter;

use crate::cancel::Cancel;
use crate::datalog::check::{ClauseId, Literal, RelId};
use crate::datalog::session::Session;
use crate::datalog::value::Value;
use crate::diag::{Code, Diagnostic};
use search::{Binding, Search};
use std::collections::{HashMap, VecDeque};
use std::fmt;

/// A row of which some values may be left open.
pub type Pattern = Vec<Option<Value>>;

/// Names a node of an [`Explanation`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct NodeId(pub u32);

impl NodeId {
    /// Position in [`Explanation::nodes`].
    pub fn index(self) -> usize {
        self.0 as usize
    }
}

/// The answer to a question: nodes that refer to each other, the first being what was asked. Equal questions that come up on the
/// way share a node, so that an explanation is never larger than what it speaks of.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Explanation {
    nodes: Vec<Node>,
}

impl Explanation {
    /// All nodes; the first is what was asked.
    pub fn nodes(&self) -> &[Node] {
        &self.nodes
    }

    /// One node.
    pub fn node(&self, id: NodeId) -> &Node {
        &self.nodes[id.index()]
    }
}

/// One thing that is explained.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Node {
    /// A fact that holds.
    Fact(Fact),
    /// Something that does not hold.
    Absence(Absence),
}

/// A fact that holds, and why.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Fact {
    /// Its predicate.
    pub relation: RelId,
    /// Its values.
    pub row: Vec<Value>,
    /// The height of its shortest proof.
    pub height: u32,
    /// Where it comes from.
    pub origin: Origin,
}

/// Why a fact holds.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Origin {
    /// It was inserted.
    Input,
    /// It stands in the text.
    Text(ClauseId),
    /// A clause derives it.
    Derived(Derivation),
}

/// A clause and what its variables stand for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Derivation {
    /// The clause.
    pub clause: ClauseId,
    /// By variable of the clause; `None` for one that does not occur.
    pub binding: Pattern,
    /// What each literal of the body says then, in the order of the body.
    pub premises: Vec<Premise>,
}

/// A literal that holds.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Premise {
    /// A positive literal, or the guard of a scope: this fact holds.
    Fact(NodeId),
    /// A negated literal: nothing of this form holds.
    Absence(NodeId),
    /// A comparison of these values.
    Comparison {
        /// The left one.
        left: Value,
        /// The right one.
        right: Value,
    },
    /// An expression or aggregate, and this is its value. Why the rows of an aggregate hold is not unfolded; it can be asked.
    Computed {
        /// The value.
        value: Value,
    },
}

/// Something that does not hold, and why.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Absence {
    /// The predicate.
    pub relation: RelId,
    /// No row of it has these values.
    pub pattern: Pattern,
    /// Why.
    pub reason: AbsenceReason,
}

/// Why something does not hold.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum AbsenceReason {
    /// No clause speaks of the predicate, and it is not among the facts.
    NotAFact,
    /// No clause of the predicate holds: one entry for each clause with a body.
    NoClause(Vec<Miss>),
    /// Not looked into: the explanation has enough absences already. See [`Explainer::ABSENCES_MAX`].
    NotLookedInto,
}

/// Why a clause does not derive what was asked for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Miss {
    /// The clause.
    pub clause: ClauseId,
    /// What is in the way.
    pub obstacle: Obstacle,
}

/// What keeps a clause from deriving something.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Obstacle {
    /// The head has another value in this column.
    Head {
        /// Position of the column.
        column: usize,
    },
    /// Literals of the body fail.
    Body {
        /// The nearest binding, by variable of the clause. A variable may be open: nothing says what it could be.
        ///
        /// If literals fail that speak of the head's variables alone, those are the failures and nothing else is bound. Else the
        /// nearest binding is one with the fewest literals that fail; among those, one that gives different values to different
        /// variables; then one for which it is not a guard that fails; then one whose first failure comes late; then the one with
        /// the smallest words. Should that take too many steps, it is one that satisfies the most literals from the front.
        binding: Pattern,
        /// The literals that fail under it; at least one.
        failures: Vec<Failure>,
    },
}

/// A literal that does not hold.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Failure {
    /// Its position in the body.
    pub literal: usize,
    /// Why it does not hold.
    pub kind: FailureKind,
}

/// Why a literal does not hold.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum FailureKind {
    /// A positive literal or guard, and nothing of this form holds.
    Absent(NodeId),
    /// A positive literal or guard in which an open variable occurs twice, and nothing of this form holds.
    AbsentTwice,
    /// A negated literal, and this fact holds.
    Holds(NodeId),
    /// A comparison, and these are the values.
    Comparison {
        /// The left one.
        left: Value,
        /// The right one.
        right: Value,
    },
    /// An expression or aggregate, whose value is not what it should be.
    Computed {
        /// The value; `None` if it has none.
        value: Option<Value>,
    },
}

/// Why a question has no answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ExplainError {
    /// More rows would have to be looked at than allowed; see [`Explainer::set_limit`].
    TooMuchWork {
        /// The limit.
        limit: u64,
    },
    /// The caller cancelled it; see [`Explainer::new_with`].
    Cancelled,
}

impl fmt::Display for ExplainError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            ExplainError::TooMuchWork { limit } => write!(
                f,
                "no explanation was found within {limit} steps; the facts are too many for this search"
            ),
            ExplainError::Cancelled => write!(f, "the search for an explanation was cancelled"),
        }
    }
}

impl std::error::Error for ExplainError {}

/// Without a place: it is no text's fault.
impl From<ExplainError> for Diagnostic {
    fn from(error: ExplainError) -> Self {
        let code = match error {
            ExplainError::Cancelled => Code::CANCELLED,
            ExplainError::TooMuchWork { .. } => Code::LIMIT_EXCEEDED,
        };
        Diagnostic::new(code, error.to_string())
    }
}

impl Session {
    /// Why a fact holds: a shortest proof down to inserted facts and facts of the text. `None` if it does not hold.
    ///
    /// ```
    /// # use logicity::{datalog::{self, Program, explain::Node}, diag::Sources, files};
    /// # let mut sources = Sources::new();
    /// # let text = ".decl e(x: number, y: number) .input e .decl p(x: number, y: number)
    /// #     p(x, y) :- e(x, y). p(x, z) :- p(x, y), e(y, z).";
    /// # let entry = sources.add("path.dl", text);
    /// # let rules = datalog::load(&mut sources, entry, &files::read_text).rules.unwrap();
    /// # let program = Program::new(rules).expect("within limits");
    /// # let (e, p) = (program.relation("e").unwrap(), program.relation("p").unwrap());
    /// # let [a, b, c] = [1, 2, 3].map(datalog::Value::number);
    /// let mut session = program.session();      // p(x, y) :- e(x, y).   p(x, z) :- p(x, y), e(y, z).
    /// session.insert(e, &[a, b])?;
    /// session.insert(e, &[b, c])?;
    /// session.commit()?;
    /// let proof = session.explain(p, &[a, c])?.unwrap();
    /// let Node::Fact(fact) = &proof.nodes()[0] else { unreachable!() };
    /// assert_eq!(fact.height, 2);
    /// assert!(session.explain(p, &[c, a])?.is_none());
    /// assert!(session.explain_absence(p, &[Some(c), None])?.is_some());
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// If that is more work than [`Explainer::LIMIT`].
    pub fn explain(&self, rel: RelId, row: &[Value]) -> Result<Option<Explanation>, ExplainError> {
        Explainer::new(self).explain(rel, row)
    }

    /// Why no row of that form holds; `None` in the pattern is any value. `None` if some row of that form does hold.
    ///
    /// # Errors
    /// If that is more work than [`Explainer::LIMIT`].
    pub fn explain_absence(&self, rel: RelId, pattern: &[Option<Value>]) -> Result<Option<Explanation>, ExplainError> {
        Explainer::new(self).explain_absence(rel, pattern)
    }
}

/// Answers questions about one state of a session.
pub struct Explainer<'s> {
    search: Search<'s>,
    limit: u64,
}

impl<'s> Explainer<'s> {
    /// How many steps (rows looked at) one question may take unless told otherwise.
    pub const LIMIT: u64 = 20_000_000;
    /// How many absences one explanation looks into; a proof is always complete.
    pub const ABSENCES_MAX: usize = 256;

    /// Ready for questions about what `session` holds now.
    pub fn new(session: &'s Session) -> Self {
        Explainer::new_with(session, &Cancel::never())
    }

    /// Cancellable variant of [`new`](Explainer::new): every question polls `cancel` a few hundred times a second. On
    /// cancellation it fails with [`ExplainError::Cancelled`], and the explainer is ready for the next question.
    pub fn new_with(session: &'s Session, cancel: &Cancel) -> Self {
        Explainer {
            search: Search::new(session, cancel),
            limit: Self::LIMIT,
        }
    }

    /// Sets how many steps one question may take. A step is a row or a literal looked at; a million take well below a second.
    pub fn set_limit(&mut self, steps: u64) {
        self.limit = steps;
    }

    /// Why a row of that form holds, the first in order, or why none does: whatever is the case, which the first value tells.
    ///
    /// # Errors
    /// If that is more work than the limit.
    pub fn explain_either(
        &mut self,
        rel: RelId,
        pattern: &[Option<Value>],
    ) -> Result<(bool, Option<Explanation>), ExplainError> {
        let fits = |row: &&[Value]| {
            (pattern.iter().zip(*row)).all(|(wanted, value)| wanted.is_none_or(|wanted| wanted == *value))
        };
        match self.search.session.rows(rel).find(fits) {
            Some(row) => Ok((true, self.explain(rel, row)?)),
            None => Ok((false, self.explain_absence(rel, pattern)?)),
        }
    }

    /// Why a fact holds. See [`Session::explain`].
    ///
    /// # Errors
    /// If that is more work than the limit.
    pub fn explain(&mut self, rel: RelId, row: &[Value]) -> Result<Option<Explanation>, ExplainError> {
        self.search.refill(self.limit);
        if !self.search.session.contains(rel, row) {
            return Ok(None);
        }
        let mut making = Making::default();
        making.fact(rel, row.to_vec());
        making.finish(&mut self.search).map(Some)
    }

    /// Why no row of that form holds. See [`Session::explain_absence`].
    ///
    /// # Errors
    /// If that is more work than the limit.
    pub fn explain_absence(
        &mut self,
        rel: RelId,
        pattern: &[Option<Value>],
    ) -> Result<Option<Explanation>, ExplainError> {
        self.search.refill(self.limit);
        let known = self.search.rules().relations.get(rel.index());
        if known.is_none_or(|relation| relation.arity() != pattern.len()) || self.search.some_row(rel, pattern)? {
            return Ok(None);
        }
        let mut making = Making::default();
        making.absence(rel, pattern.to_vec());
        making.finish(&mut self.search).map(Some)
    }

    /// Every way in which some clause derives the fact in one step, in the order of the clauses and of the words of their
    /// variables; facts of the text are left out.
    ///
    /// # Errors
    /// If that is more work than the limit.
    pub fn derivations(&mut self, rel: RelId, row: &[Value]) -> Result<Vec<(ClauseId, Pattern)>, ExplainError> {
        self.search.refill(self.limit);
        let mut found = Vec::new();
        for clause in self.search.clauses_of(rel) {
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

    /// Whether the clause would derive a row that does not hold, were `literal` of its body left out. `None` if it cannot be left
    /// out, since it alone binds a variable of the head, of a comparison or of a negated literal.
    ///
    /// # Errors
    /// If that is more work than the limit.
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
            new = head.is_some_and(|row| !session.contains(clause.head.relation, &row));
            !new
        })?;
        Ok(Some(new))
    }
}

/// An explanation in the making: nodes are made when they are first spoken of and explained in that order.
#[derive(Default)]
struct Making {
    /// What is known of each node, and its explanation once it is there.
    nodes: Vec<(Question, Option<Node>)>,
    known: HashMap<Question, NodeId>,
    todo: VecDeque<NodeId>,
    absences: usize,
}

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
enum Question {
    Fact(RelId, Vec<Value>),
    Absence(RelId, Pattern),
}

impl Making {
    fn fact(&mut self, rel: RelId, row: Vec<Value>) -> NodeId {
        self.ask(Question::Fact(rel, row))
    }

    fn absence(&mut self, rel: RelId, pattern: Pattern) -> NodeId {
        self.ask(Question::Absence(rel, pattern))
    }

    fn ask(&mut self, question: Question) -> NodeId {
        if let Some(&id) = self.known.get(&question) {
            return id;
        }
        let id = NodeId(u32::try_from(self.nodes.len()).expect("nodes are bounded by the steps of a search"));
        self.nodes.push((question.clone(), None));
        self.known.insert(question, id);
        self.todo.push_back(id);
        id
    }

    fn finish(mut self, search: &mut Search<'_>) -> Result<Explanation, ExplainError> {
        while let Some(id) = self.todo.pop_front() {
            search.step()?;
            let node = match self.nodes[id.index()].0.clone() {
                Question::Fact(relation, row) => Node::Fact(self.explain_fact(search, relation, row)?),
                Question::Absence(relation, pattern) => Node::Absence(self.explain_absence(search, relation, pattern)?),
            };
            self.nodes[id.index()].1 = Some(node);
        }
        Ok(Explanation {
            nodes: self.nodes.into_iter().filter_map(|(_, node)| node).collect(),
        })
    }

    fn explain_fact(
        &mut self,
        search: &mut Search<'_>,
        relation: RelId,
        row: Vec<Value>,
    ) -> Result<Fact, ExplainError> {
        let (height, origin) = search.origin(relation, &row)?;
        let origin = match origin {
            heights::Best::Input => Origin::Input,
            heights::Best::Text(clause) => Origin::Text(clause),
            heights::Best::Derived { clause, binding, rows } => {
                let body = &search.rules().clauses[clause.index()].body;
                let premise = |(literal, row): (&Literal, Option<Vec<Value>>)| match literal {
                    Literal::Positive(atom) | Literal::Guard(atom) => {
                        Premise::Fact(self.fact(atom.relation, row.unwrap_or_default()))
                    }
                    Literal::Negative(atom) => {
                        Premise::Absence(self.absence(atom.relation, search::pattern(atom, &binding)))
                    }
                    Literal::Compare { left, right, .. } => Premise::Comparison {
                        left: search::value(left, &binding).unwrap_or_default(),
                        right: search::value(right, &binding).unwrap_or_default(),
                    },
                    // It holds, so what it is equal to is its value.
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
            relation,
            row,
            height,
            origin,
        })
    }

    fn explain_absence(
        &mut self,
        search: &mut Search<'_>,
        relation: RelId,
        pattern: Pattern,
    ) -> Result<Absence, ExplainError> {
        let reason = if !search.rules().relations[relation.index()].derived {
            AbsenceReason::NotAFact
        } else if self.absences == Explainer::ABSENCES_MAX {
            AbsenceReason::NotLookedInto
        } else {
            self.absences += 1;
            let mut misses = Vec::new();
            for clause in search.clauses_of(relation) {
                if let Some(obstacle) = self.obstacle(search, clause, &pattern)? {
                    misses.push(Miss { clause, obstacle });
                }
            }
            AbsenceReason::NoClause(misses)
        };
        Ok(Absence {
            relation,
            pattern,
            reason,
        })
    }

    /// What keeps a clause from deriving the pattern; `None` for a fact of the text.
    fn obstacle(
        &mut self,
        search: &mut Search<'_>,
        id: ClauseId,
        pattern: &Pattern,
    ) -> Result<Option<Obstacle>, ExplainError> {
        let clause = &search.rules().clauses[id.index()];
        if clause.body.is_empty() {
            return Ok(None);
        }
        let mut binding: Binding = vec![None; clause.variables.len()];
        if let Err(column) = search::bind_head(clause, pattern, &mut binding) {
            return Ok(Some(Obstacle::Head { column }));
        }
        let (binding, failing) = search.nearest(clause, binding)?;
        let mut failures = Vec::new();
        for literal in failing {
            let kind = match &clause.body[literal] {
                Literal::Positive(atom) | Literal::Guard(atom) if search::repeats(atom, &binding) => {
                    FailureKind::AbsentTwice
                }
                Literal::Positive(atom) | Literal::Guard(atom) => {
                    FailureKind::Absent(self.absence(atom.relation, search::pattern(atom, &binding)))
                }
                Literal::Negative(atom) => {
                    let Some(row) = search.first_row(atom.relation, &search::pattern(atom, &binding))? else {
                        continue;
                    };
                    FailureKind::Holds(self.fact(atom.relation, row))
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
}
