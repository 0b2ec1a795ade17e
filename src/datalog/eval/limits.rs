//! The resource limits of an evaluation and the errors when it exceeds one.
// Decision: docs/decisions/safety.md#d020

use crate::check::{Clause, ClauseId, Literal, Rules, Term, VarId};
use crate::diag::codes;
use crate::diag::{Diagnostic, Limit, Span, counted};
use crate::eval::growth;
use crate::syntax::ast::Comparison;
use crate::syntax::functor::Functor;
use std::collections::BTreeSet;
use std::fmt;

/// Resource limits of a commit. Whether a commit exceeds them depends on the program and the facts alone, not on time
/// or the number of threads.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Maximum number of rows of all derived predicates together, with those that a subsumption removes. Default: 10^8.
    pub rows: usize,
    /// Maximum number of rows that scans and tests visit. Default: 10^11, which takes some minutes.
    pub steps: u64,
    /// Maximum memory of a commit, in bytes. Default: 4 GiB. It counts the session's rows, indexes and symbols, copies
    /// of the rows that change, buffers for derived rows, and kept values of aggregates. Memory that does not grow with
    /// the data is not counted. A search for an explanation counts the aggregates that it evaluates.
    pub bytes: u64,
}

impl Default for Limits {
    fn default() -> Self {
        Limits {
            rows: 100_000_000,
            steps: 100_000_000_000,
            bytes: 4 << 30,
        }
    }
}

/// The reason why a commit failed: it exceeds [`Limits`], or the caller cancelled it.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum EvalError {
    /// The derived predicates together have more rows than allowed.
    TooManyRows {
        /// The limit.
        limit: usize,
        /// A clause of the stratum that exceeded it.
        clause: ClauseId,
    },
    /// Scans and tests visited more rows than allowed.
    TooManySteps {
        /// The limit.
        limit: u64,
        /// The clause that was evaluated.
        clause: ClauseId,
    },
    /// The inserted rows take more memory than allowed.
    TooManyInputs {
        /// The limit, in bytes.
        limit: u64,
    },
    /// Rows, indexes and symbols take more memory than allowed.
    TooMuchMemory {
        /// The limit, in bytes.
        limit: u64,
        /// A clause of the stratum that exceeded it.
        clause: ClauseId,
    },
    /// The caller has defined no functor of this name; see [`Program::define`](crate::Program::define).
    UndefinedFunctor {
        /// The name of the functor.
        functor: String,
        /// The first clause that applies it.
        clause: ClauseId,
    },
    /// The definition of a functor failed.
    FailedFunctor {
        /// The name of the functor.
        functor: String,
        /// Why it failed.
        reason: String,
        /// The clause that was evaluated.
        clause: ClauseId,
    },
    /// The caller cancelled it; see [`Session::commit_with`](crate::session::Session::commit_with).
    Cancelled {
        /// The clause that was evaluated.
        clause: ClauseId,
    },
}

impl EvalError {
    /// Returns the clause that was being evaluated, or one of several evaluated together. `None` if the inserted rows
    /// alone exceed a limit.
    pub fn clause(&self) -> Option<ClauseId> {
        match *self {
            EvalError::TooManyInputs { .. } => None,
            EvalError::TooManyRows { clause, .. }
            | EvalError::TooManySteps { clause, .. }
            | EvalError::TooMuchMemory { clause, .. }
            | EvalError::UndefinedFunctor { clause, .. }
            | EvalError::FailedFunctor { clause, .. }
            | EvalError::Cancelled { clause } => Some(clause),
        }
    }

    /// Returns the exceeded limit. `None` for a cancelled evaluation and for functors.
    pub fn limit(&self) -> Option<Limit> {
        match *self {
            EvalError::TooManyRows { .. } => Some(Limit::Rows),
            EvalError::TooManySteps { .. } => Some(Limit::Steps),
            EvalError::TooMuchMemory { limit, .. } | EvalError::TooManyInputs { limit } => Some(Limit::Memory(limit)),
            EvalError::Cancelled { .. } | EvalError::UndefinedFunctor { .. } | EvalError::FailedFunctor { .. } => None,
        }
    }

    /// Returns a diagnostic at the clause that also points at the probable cause: a recursion that computes new values
    /// without end, or an atom that makes its join a product. `rules` are those of the session.
    pub fn diagnostic(&self, rules: &Rules) -> Diagnostic {
        let mut fault = Diagnostic::from(self.clone());
        let clause = self.clause().and_then(|clause| rules.clauses.get(clause.index()));
        let Some(clause) = clause else {
            return fault;
        };
        if let EvalError::UndefinedFunctor { functor, .. } | EvalError::FailedFunctor { functor, .. } = self {
            let declared = rules.functors.iter().find(|declared| declared.name == *functor);
            let applies = |literal: &&Literal| match literal {
                Literal::Compute {
                    functor: Functor::Call,
                    arguments,
                    ..
                } => rules.called(arguments).is_some_and(|called| called.name == *functor),
                _ => false,
            };
            let span = match clause.body.iter().find(applies) {
                Some(Literal::Compute { span, .. }) => *span,
                _ => clause.span,
            };
            fault = fault.at(span, "applied here");
            return match declared {
                Some(declared) => fault.also(declared.span, "declared here"),
                None => fault,
            };
        }
        let growth = self
            .limit()
            .and(self.clause())
            .and_then(|id| growth::endless(rules, id));
        if let Some(growth) = growth {
            // No limit suffices.
            fault.limit = None;
            return fault
                .at(clause.span, "in the evaluation of this clause")
                .also(growth.span, "each round of the recursion computes new values here")
                .help(format!("bound them, for example with {}", growth.bound));
        }
        let mut fault = fault.at(clause.span, "in the evaluation of this clause");
        if matches!(self, EvalError::TooMuchMemory { .. }) {
            let counted =
                "counted before it is used, with the copies that merging rows and building indexes would make";
            fault = fault.note(format!("memory is {counted}; the process may use half of the limit"));
        }
        match unjoined(clause) {
            Some(span) => fault
                .also(span, "shares no variable with the atoms before it")
                .note("the join is a Cartesian product: it combines each of its rows with all rows of the other atoms")
                .help("add an atom that relates it to the others"),
            None => fault,
        }
    }
}

impl fmt::Display for EvalError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            EvalError::TooManyRows { limit, .. } => {
                write!(f, "the rules derive more than {}", counted(limit, "row"))
            }
            EvalError::TooManySteps { limit, .. } => {
                write!(f, "the rules scan more than {}", counted(limit, "row"))
            }
            EvalError::TooManyInputs { limit } => write!(f, "the inserted rows take more than {}", size(*limit)),
            EvalError::TooMuchMemory { limit, .. } => {
                write!(f, "rows, indexes and symbols take more than {}", size(*limit))
            }
            EvalError::UndefinedFunctor { functor, .. } => write!(f, "the functor `{functor}` has no definition"),
            EvalError::FailedFunctor { functor, reason, .. } => write!(f, "the functor `{functor}` failed: {reason}"),
            EvalError::Cancelled { .. } => write!(f, "the evaluation was cancelled"),
        }
    }
}

/// Formats a number of bytes in the largest unit that divides it.
pub fn size(bytes: u64) -> String {
    let units = [(20, "MiB"), (10, "KiB"), (0, "bytes")].into_iter();
    let mut fitting = units.filter(|(scale, _)| bytes >> scale << scale == bytes);
    let (scale, unit) = fitting.next().unwrap_or((0, "bytes"));
    format!("{} {unit}", bytes >> scale)
}

impl std::error::Error for EvalError {}

/// A diagnostic without a place, for callers that do not have the sources.
impl From<EvalError> for Diagnostic {
    fn from(error: EvalError) -> Self {
        if let EvalError::UndefinedFunctor { functor, .. } = &error {
            return Diagnostic::new(crate::codes::FAILED_FUNCTOR, error.to_string()).help(format!(
                "define it in Rust with `program.define(\"{functor}\", ...)`, or in Python with \
                 `Program(..., functors={{\"{functor}\": ...}})`; the commands have no functors"
            ));
        }
        match error.limit() {
            None if matches!(error, EvalError::FailedFunctor { .. }) => {
                Diagnostic::new(crate::codes::FAILED_FUNCTOR, error.to_string())
            }
            Some(limit) => Diagnostic::new(codes::LIMIT_EXCEEDED, error.to_string()).exceeds(limit),
            None => Diagnostic::new(codes::CANCELLED, error.to_string()),
        }
    }
}

/// Returns the first atom that no chain of shared variables or equalities connects to the first atom. With such an atom
/// the join is a Cartesian product.
fn unjoined(clause: &Clause) -> Option<Span> {
    let variables = |literal: &Literal| -> Vec<usize> { literal.variables().map(VarId::index).collect() };
    // By variable: the representative of the variables that it is connected to.
    let mut joined: Vec<usize> = (0..clause.variables.len()).collect();
    let positive = |literal: &&Literal| matches!(literal, Literal::Positive(_) | Literal::Guard(_));
    let found: BTreeSet<usize> = clause.body.iter().filter(positive).flat_map(&variables).collect();
    let joins = |literal: &&Literal| match literal {
        Literal::Positive(_) | Literal::Guard(_) => true,
        Literal::Compare { op, .. } => *op == Comparison::Equal,
        // A literal that only tests a computed value runs for every combination of rows.
        Literal::Compute {
            to: Term::Variable(to), ..
        } => found.contains(&to.index()),
        _ => false,
    };
    for literal in clause.body.iter().filter(joins) {
        if let [first, rest @ ..] = &variables(literal)[..] {
            for other in rest {
                let (from, to) = (joined[*other], joined[*first]);
                joined.iter_mut().filter(|at| **at == from).for_each(|at| *at = to);
            }
        }
    }
    let atoms = clause.body.iter().filter_map(|literal| match literal {
        Literal::Positive(atom) => Some((atom.span, *variables(literal).first()?)),
        _ => None,
    });
    let mut atoms = atoms.map(|(span, variable)| (span, joined[variable]));
    let (_, first) = atoms.next()?;
    atoms.find(|(_, other)| *other != first).map(|(span, _)| span)
}
