//! Why an agent did what it did in a tick.

use crate::cancel::Cancel;
use crate::city::Action;
use crate::city::{Cell, Heading};
use crate::datalog::Session;
use crate::datalog::Value;
use crate::datalog::explain::{ExplainError, Explainer, Explanation, ExplanationPrinter};
use crate::diag::{Diagnostic, Sources};
use crate::sim::tick::simulation::Simulation;
use crate::sim::tick::vocabulary::Actions;
use crate::sim::tick::world::World;
use serde_json::json;
use std::fmt::Write;

/// The decision of one agent, and the session with what it was decided on.
#[derive(Clone)]
pub struct Decision<'a> {
    /// What does not change.
    pub world: &'a World,
    /// The facts, and what the rules derive from them.
    pub session: &'a Session,
    /// Number of the tick.
    pub tick: u64,
    /// Name of the agent.
    pub agent: String,
    /// The value that stands for it.
    pub value: Value,
    /// Where it was.
    pub at: Cell,
    /// Its heading.
    pub heading: Option<Heading>,
    /// The actions derived before the default.
    pub derived: Actions,
    /// What it did: by the rules, or from outside.
    pub action: Action,
}

/// Why a [`Decision`] was as it was.
pub struct Account<'a> {
    decision: Decision<'a>,
    /// Whether it is told why this action was not derived.
    why_not: Option<Action>,
    /// The actions spoken of, and why they were derived or not; nothing if the rules do not mention one.
    explanations: Vec<(Action, Option<Explanation>)>,
}

impl Simulation {
    /// The decision of an agent, by its position in the list, in the last tick.
    ///
    /// # Errors
    /// As [`Simulation::snapshot`].
    ///
    /// # Panics
    /// If there is no such agent.
    pub fn decision(&mut self, agent: usize) -> Result<Decision<'_>, Diagnostic> {
        let (name, report) = (self.agents()[agent].name().to_string(), self.report());
        let (tick, done) = (report.tick, report.agents[agent]);
        let snapshot = self.snapshot()?;
        Ok(Decision {
            world: snapshot.world(),
            session: snapshot.session(),
            tick,
            agent: name,
            value: snapshot.value(agent),
            at: done.moved.from,
            heading: done.heading,
            derived: done.derived,
            action: done.action,
        })
    }
}

impl<'a> Decision<'a> {
    /// Why it was so: the actions that were derived, the one that the rules take first; if none was derived, the default, or why all four
    /// were not. With `why_not`, that action alone.
    ///
    /// # Errors
    /// If that is more work than [`Explainer::LIMIT`], or on cancellation.
    pub fn account(self, why_not: Option<Action>, cancel: &Cancel) -> Result<Account<'a>, ExplainError> {
        let vocabulary = &self.world.vocabulary;
        let by_rules = vocabulary.decide(self.derived);
        let mut actions = match why_not {
            Some(action) => vec![action],
            None if self.derived.is_empty() => match vocabulary.action(by_rules) {
                Some(relation) if self.session.contains(relation, &[self.value]) => vec![by_rules],
                _ => Action::ALL.to_vec(),
            },
            None => self.derived.iter().collect(),
        };
        actions.sort_by_key(|action| *action != by_rules);
        let mut explainer = Explainer::new_with(self.session, cancel);
        let mut explanations = Vec::new();
        for action in actions {
            let explanation = match vocabulary.action(action) {
                Some(relation) => explainer.explain_either(relation, &[Some(self.value)])?.1,
                None => None,
            };
            explanations.push((action, explanation));
        }
        drop(explainer);
        Ok(Account {
            decision: self,
            why_not,
            explanations,
        })
    }
}

impl Account<'_> {
    fn printer<'s>(&'s self, sources: &'s Sources) -> ExplanationPrinter<'s> {
        let session = self.decision.session;
        ExplanationPrinter::new(session.program().rules(), session.symbols(), sources)
    }

    /// For readers: the decision in a line, what is special about it, and a tree for each action. `sources` are those of the rules.
    pub fn text(&self, sources: &Sources) -> String {
        let Decision {
            tick,
            agent,
            at,
            derived,
            action,
            ..
        } = &self.decision;
        let heading = self
            .decision
            .heading
            .map(|heading| format!(", heading {}", heading.name()));
        let mut text = format!(
            "tick {tick}: {agent} at [{}, {}]{}: {}\n",
            at.row,
            at.col,
            heading.unwrap_or_default(),
            action.name()
        );
        let by_rules = self.decision.world.vocabulary.decide(*derived);
        if *action != by_rules {
            let _ = writeln!(text, "the action came from outside; the rules say {}", by_rules.name());
        } else if derived.len() > 1 {
            let names: Vec<&str> = derived.iter().map(|action| action.name()).collect();
            let _ = writeln!(
                text,
                "derived were {}; the first by the configured order was taken",
                names.join(", ")
            );
        } else if derived.is_empty() && self.explanations.len() > 1 {
            text += "no action was derived, so the default was taken\n";
        }
        if let Some(action) = self.why_not.filter(|action| derived.contains(*action)) {
            let _ = writeln!(text, "{} was derived, and this is why", action.name());
        }
        let printer = self.printer(sources);
        for (action, explanation) in &self.explanations {
            let _ = match explanation {
                Some(explanation) => write!(text, "\n{}", printer.tree(explanation)),
                None => writeln!(text, "\n{}: the rules do not mention it", action.name()),
            };
        }
        text
    }

    /// For programs: `tick`, `agent`, `at`, `heading`, `derived`, `action`, and `explanations`, each with its `action` and, unless the
    /// rules do not mention it, the `nodes` of [`ExplanationPrinter::json`].
    pub fn json(&self, sources: &Sources) -> serde_json::Value {
        let printer = self.printer(sources);
        let explanations: Vec<serde_json::Value> = (self.explanations.iter())
            .map(|(action, explanation)| {
                let mut entry = json!({ "action": action.name() });
                if let Some(explanation) = explanation {
                    entry["nodes"] = printer.json(explanation)["nodes"].take();
                }
                entry
            })
            .collect();
        let decision = &self.decision;
        json!({
            "tick": decision.tick,
            "agent": decision.agent,
            "at": [decision.at.row, decision.at.col],
            "heading": decision.heading.map(Heading::name),
            "derived": decision.derived.iter().map(Action::name).collect::<Vec<_>>(),
            "action": decision.action.name(),
            "explanations": explanations,
        })
    }
}
