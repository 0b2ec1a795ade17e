//! The choice of executor, and the compilation of rules for the dense one.

use crate::datalog::Rules;
use crate::datalog::dense::{Dense, TooManySteps, TrackFirings, choose};
use crate::diag::{self, Diagnostic, Span};
use crate::sim::codes;
use crate::sim::tick::vocabulary::Vocabulary;

/// The executor that evaluates the rules.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Executor {
    /// Dense if it can evaluate the rules for this number of agents, otherwise relational.
    #[default]
    Auto,
    /// Evaluates predicates as bit words.
    Dense,
    /// Evaluates predicates as sorted lists of rows, updated incrementally.
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
            Err(fault) if self == Executor::Auto => Ok(Choice::Relational(Some(fault))),
            Err(fault) => Err(fault.help("`--executor auto` falls back to the relational executor, for fewer agents")),
        }
    }
}

/// The executor that [`Executor::choose`] selects.
pub(crate) enum Choice<T> {
    /// The dense executor with the value of `make`.
    Dense(T),
    /// The relational executor; with the reason, if the dense one failed.
    Relational(Option<Diagnostic>),
}

/// Returns the diagnostic for rules that the dense executor cannot evaluate. `reason` follows "because".
pub(super) fn not_dense(reason: &str) -> Diagnostic {
    let message = format!("the dense executor cannot evaluate these rules, because {reason}");
    Diagnostic::new(codes::DENSE_UNSUPPORTED, message)
}

/// Returns the diagnostic for a run that the dense executor gives up.
pub(crate) fn given_up(error: TooManySteps) -> Diagnostic {
    Diagnostic::new(
        diag::codes::LIMIT_EXCEEDED,
        format!("the dense executor gave up: {error}"),
    )
    .help("`--executor auto` falls back to the relational executor")
}

/// Returns the fault of rules, with the place where the configuration names them if it has none of its own.
pub(crate) fn of_rules(fault: Diagnostic, rules: Span) -> Diagnostic {
    match fault.primary {
        Some(_) => fault,
        None => fault.at(rules, "these rules"),
    }
}

/// Compiles the rules for the dense executor.
///
/// # Errors
/// `dense-unsupported` if it cannot evaluate them; the message names the reason, at its place in the rules.
pub(crate) fn compile(rules: &Rules, vocabulary: &Vocabulary, counting: TrackFirings) -> Result<Dense, Diagnostic> {
    let choice = choose(rules);
    let reasons = || choice.relational.iter().flatten();
    let root = reasons().find(|reason| reason.reads.is_none());
    if let Some(reason) = root.or_else(|| reasons().next()) {
        let clause = rules.clauses[reason.clause.index()].span;
        let mut fault = not_dense(&reason.show(rules)).at(reason.span, "this is not supported");
        if clause.start != reason.span.start {
            fault = fault.also(clause, "in this clause");
        }
        return Err(reason.help().into_iter().fold(fault, Diagnostic::help));
    }
    let steady = |declared| {
        let mut predicates = vocabulary.predicates.iter();
        predicates.any(|predicate| predicate.id == Some(declared) && predicate.definition.is_static())
    };
    Ok(Dense::new(rules, &choice, counting, steady))
}
