//! The choice of executor, and the compilation of rules for the dense one.

use crate::datalog::Rules;
use crate::datalog::dense::{Dense, TooManySteps, TrackFirings, choose};
use crate::diag::{Code, Diagnostic};
use crate::sim::tick::vocabulary::Vocabulary;

/// The executor that evaluates the rules.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Executor {
    /// Dense if it can evaluate the rules for this number of agents, otherwise relational.
    #[default]
    Auto,
    /// Evaluates relations as bit words.
    Dense,
    /// Evaluates relations as sorted lists of rows, updated incrementally.
    Relational,
}

impl Executor {
    /// All executors.
    pub const ALL: [Executor; 3] = [Executor::Auto, Executor::Dense, Executor::Relational];

    /// Returns the name on the command line.
    pub const fn name(self) -> &'static str {
        match self {
            Executor::Auto => "auto",
            Executor::Dense => "dense",
            Executor::Relational => "relational",
        }
    }

    /// Calls `make` unless the relational executor is selected, and returns its value or the reason to use the
    /// relational executor.
    ///
    /// # Errors
    /// The error of `make`, if the dense executor is selected.
    pub(crate) fn choose<T>(self, make: impl FnOnce() -> Result<T, Diagnostic>) -> Result<Choice<T>, Diagnostic> {
        if self == Executor::Relational {
            return Ok(Choice::Relational(None));
        }
        match make() {
            Ok(made) => Ok(Choice::Dense(made)),
            Err(fault) if self == Executor::Auto => Ok(Choice::Relational(Some(fault.message))),
            Err(fault) => Err(fault.help("`--executor auto` falls back to the relational executor, for fewer agents")),
        }
    }
}

/// The executor that [`Executor::choose`] selects.
pub(crate) enum Choice<T> {
    /// The dense executor with the value of `make`.
    Dense(T),
    /// The relational executor; with the reason, if the dense one failed.
    Relational(Option<String>),
}

/// Returns the diagnostic for rules that the dense executor cannot evaluate. `reason` follows "because".
pub(super) fn not_dense(reason: &str) -> Diagnostic {
    let message = format!("the dense executor cannot evaluate these rules, because {reason}");
    Diagnostic::new(Code::DENSE_UNSUPPORTED, message)
}

/// Returns the diagnostic for a run that the dense executor gives up.
pub(crate) fn given_up(error: TooManySteps) -> Diagnostic {
    Diagnostic::new(Code::LIMIT_EXCEEDED, format!("the dense executor gave up: {error}"))
        .help("`--executor auto` falls back to the relational executor")
}

/// Compiles the rules for the dense executor.
///
/// # Errors
/// `dense-unsupported` if it cannot evaluate them; the message names the reason.
pub(crate) fn compile(rules: &Rules, vocabulary: &Vocabulary, counting: TrackFirings) -> Result<Dense, Diagnostic> {
    let choice = choose(rules);
    if let Some(reason) = choice.relational.iter().flatten().next() {
        return Err(not_dense(&reason.show(rules)));
    }
    let steady = |relation| {
        let mut predicates = vocabulary.predicates.iter();
        predicates.any(|predicate| predicate.relation == Some(relation) && predicate.definition.is_static())
    };
    Ok(Dense::new(rules, &choice, counting, steady))
}
