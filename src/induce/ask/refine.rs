//! Asks questions until the learned rules agree with an oracle.

use crate::cancel::Cancel;
use crate::induce::ask::explore::explore;
use crate::induce::ask::session::{Answer, AskSettings, End, Observer, Oracle, Session};
use crate::induce::ask::sweep::sweep;
use crate::induce::ask::verify::verify;
use crate::induce::constraints::Constraints;
use crate::induce::examples::Examples;
use crate::induce::rules::{LearnedRules, Settings};

/// What to learn, and from what.
#[derive(Clone, Debug)]
pub struct Refinement {
    /// Examples known at the beginning. They count as answers of the oracle.
    pub examples: Examples,
    /// What is true of all states. Questions satisfy it.
    pub constraints: Constraints,
    /// Settings of the learner.
    pub learning: Settings,
    /// Settings of the questions.
    pub asking: AskSettings,
    /// The log of an interrupted run with the same examples and settings. It answers the same questions, so the run
    /// continues where the earlier one ended.
    pub log: Vec<Answer>,
}

/// The result of a refinement.
#[derive(Debug)]
pub struct Refined {
    /// The rules that were learned last.
    pub rules: LearnedRules,
    /// All questions with their answers, in order. Answers from an earlier log that this run asked for are included.
    pub log: Vec<Answer>,
    /// Why the questions ended.
    pub end: End,
    /// The examples and those answers from which the rules were learned.
    pub examples: Examples,
}

impl Refinement {
    /// Asks questions until the rules agree with the oracle, or until one of the limits. The same seed and the same
    /// answers give the same questions.
    pub fn run(self, oracle: &mut dyn Oracle, observe: Observer<'_>, cancel: &Cancel) -> Refined {
        let mut session = Session::new(
            self.examples,
            &self.constraints,
            &self.learning,
            &self.asking,
            self.log,
            oracle,
            observe,
            cancel,
        );
        let end = ask(&mut session).unwrap_or_else(|end| end);
        Refined {
            rules: session.rules,
            log: session.log,
            examples: session.examples,
            end,
        }
    }
}

fn ask(session: &mut Session<'_>) -> Result<End, End> {
    session.learn()?;
    verify(session)?;
    explore(session)?;
    let Some(bound) = session.asking.sweep else {
        return Ok(End::Agreed);
    };
    let scenes = sweep(session, bound)?;
    Ok(End::Certified(bound, scenes))
}
