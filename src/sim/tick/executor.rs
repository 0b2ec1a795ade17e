//! Which executor evaluates the rules, and the rules made ready for the dense one.

use crate::datalog::Rules;
use crate::datalog::dense::{Dense, TrackFirings, choose};
use crate::diag::{Code, Diagnostic};
use crate::sim::tick::vocabulary::Vocabulary;

/// What evaluates the rules.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Executor {
    /// The dense one if it can take the rules and the number of agents, else the relational one.
    #[default]
    Auto,
    /// Bit words.
    Dense,
    /// Sorted lists of rows, kept up to date by differences.
    Relational,
}

impl Executor {
    /// All three.
    pub const ALL: [Executor; 3] = [Executor::Auto, Executor::Dense, Executor::Relational];

    /// Its name on the command line.
    pub const fn name(self) -> &'static str {
        match self {
            Executor::Auto => "auto",
            Executor::Dense => "dense",
            Executor::Relational => "relational",
        }
    }

    /// What the dense executor is made into, if it is to evaluate the rules and can; else why the relational one does.
    ///
    /// # Errors
    /// That of `make`, if the dense executor has to and cannot.
    pub(crate) fn choose<T>(self, make: impl FnOnce() -> Result<T, Diagnostic>) -> Result<Choice<T>, Diagnostic> {
        if self == Executor::Relational {
            return Ok(Choice::Relational(None));
        }
        match make() {
            Ok(made) => Ok(Choice::Dense(made)),
            Err(fault) if self == Executor::Auto => Ok(Choice::Relational(Some(fault.message))),
            Err(fault) => {
                Err(fault
                    .help("`--executor auto` takes the relational one, for fewer agents, where the dense one cannot"))
            }
        }
    }
}

/// Which executor evaluates the rules.
pub(crate) enum Choice<T> {
    /// The dense one, made into this.
    Dense(T),
    /// The relational one; if it was not asked for, why the dense one does not.
    Relational(Option<String>),
}

/// The diagnostic of rules that the dense executor cannot evaluate. `reason` goes after "because".
pub(super) fn not_dense(reason: &str) -> Diagnostic {
    let message = format!("the dense executor cannot evaluate these rules, because {reason}");
    Diagnostic::new(Code::DENSE_UNSUPPORTED, message)
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
