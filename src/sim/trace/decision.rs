//! Explains the decision of an agent in a tick.

use crate::cancel::Cancel;
use crate::city::{Action, Cell, Effect, Heading, KindId, MoveReason};
use crate::datalog::Session;
use crate::datalog::Value;
use crate::datalog::explain::{ExplainError, Explainer, Explanation, ExplanationPrinter};
use crate::diag::{Diagnostic, Sources};
use crate::sim::tick::simulation::Simulation;
use crate::sim::tick::vocabulary::Actions;
use crate::sim::tick::world::World;
use serde_json::json;
use std::fmt::Write;

/// The decision of one agent, with the session on which it was made.
#[derive(Clone)]
pub struct Decision<'a> {
    /// The world of the run.
    pub world: &'a World,
    /// The facts and the rows that the rules derive from them.
    pub session: &'a Session,
    /// The number of the tick.
    pub tick: u64,
    /// The name of the agent.
    pub agent: String,
    /// Its kind.
    pub kind: KindId,
    /// The value that represents the agent.
    pub value: Value,
    /// The cell before the move.
    pub at: Cell,
    /// The heading before the move.
    pub heading: Option<Heading>,
    /// The derived actions, without the default.
    pub derived: Actions,
    /// The action in effect: decided by the rules, imposed by the caller, or that which parked the agent.
    pub action: Action,
    /// The earlier tick in which the action parked the agent; `None` for an agent that is free to act.
    pub parked_since: Option<u64>,
}

/// The explanation of a [`Decision`].
pub struct Account<'a> {
    decision: Decision<'a>,
    /// The action that the caller asked about.
    why_not: Option<Action>,
    /// The explained actions. `None` if the rules do not declare the action.
    explanations: Vec<(Action, Option<Explanation>)>,
}

impl Simulation {
    /// Returns the decision of an agent in the last tick, given its position in the list. Before the first tick, the
    /// decision is what the rules derive now.
    ///
    /// # Errors
    /// As [`Simulation::snapshot`].
    ///
    /// # Panics
    /// If `agent` is outside the list.
    pub fn decision(&mut self, agent: usize) -> Result<Decision<'_>, Diagnostic> {
        let (name, report) = (self.agents()[agent].name().to_string(), self.report());
        let kind = self.agents()[agent].kind_id;
        let (tick, mut done) = (report.tick, report.agents[agent]);
        let is_before_first_tick = self.now() == 0;
        let parked = self.agents()[agent].parked;
        let snapshot = self.snapshot()?;
        if is_before_first_tick {
            let vocabulary = &snapshot.world().vocabulary;
            done.derived = snapshot.state.derived(vocabulary, agent);
            done.action = vocabulary.decide(Some(kind), done.derived);
        }
        let parked_since = match snapshot.world().vocabulary.actions().effect(done.action) {
            // The tick of the decision is the first of those for which it parks.
            Some(Effect::Park(ticks)) if done.moved.reason == MoveReason::Parked => {
                let passed = u64::from(ticks.saturating_sub(1).saturating_sub(parked));
                (passed > 0).then(|| tick.saturating_sub(passed))
            }
            _ => None,
        };
        Ok(Decision {
            world: snapshot.world(),
            session: snapshot.session(),
            tick,
            agent: name,
            kind,
            value: snapshot.value(agent),
            at: done.moved.from,
            heading: done.heading,
            derived: done.derived,
            action: done.action,
            parked_since,
        })
    }
}

impl<'a> Decision<'a> {
    /// Explains the decision: the derived actions, the chosen one first. If none was derived, it explains the default
    /// action, or why all were not derived. With `why_not`, it explains that action alone.
    ///
    /// # Errors
    /// If the work exceeds [`Explainer::LIMIT`], or on cancellation.
    pub fn account(self, why_not: Option<Action>, cancel: &Cancel) -> Result<Account<'a>, ExplainError> {
        let vocabulary = &self.world.vocabulary;
        let by_rules = vocabulary.decide(Some(self.kind), self.derived);
        let mut actions = match why_not {
            Some(action) => vec![action],
            None if self.derived.is_empty() => match vocabulary.action(by_rules) {
                Some(predicate) if self.session.contains(predicate, [self.value]) => vec![by_rules],
                _ => vocabulary.actions().all().collect(),
            },
            None => self.derived.iter().collect(),
        };
        actions.sort_by_key(|action| *action != by_rules);
        let mut explainer = Explainer::new_with(self.session, cancel);
        let mut explanations = Vec::new();
        for action in actions {
            let explanation = match vocabulary.action(action) {
                Some(predicate) => explainer.explain_either(predicate, &[Some(self.value)])?.1,
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

    /// Returns the explanation as text: the decision in one line, a remark, and a tree for each action. `sources` holds
    /// the rules.
    pub fn text(&self, sources: &Sources) -> String {
        let Decision {
            tick,
            agent,
            at,
            kind,
            derived,
            action,
            parked_since,
            ..
        } = &self.decision;
        let table = self.decision.world.vocabulary.actions();
        let heading = self
            .decision
            .heading
            .map(|heading| format!(", heading {}", heading.name()));
        let mut text = format!(
            "tick {tick}: {agent} at [{}, {}]{}: {}\n",
            at.row,
            at.col,
            heading.unwrap_or_default(),
            table.name(*action)
        );
        let by_rules = self.decision.world.vocabulary.decide(Some(*kind), *derived);
        if let Some(since) = parked_since {
            let by_rules = table.name(by_rules);
            let _ = writeln!(text, "it is parked since tick {since}; the rules say {by_rules}");
        } else if *action != by_rules {
            let _ = writeln!(
                text,
                "the action came from outside; the rules say {}",
                table.name(by_rules)
            );
        } else if derived.len() > 1 || !derived.is_empty() && !derived.contains(by_rules) {
            let names = |actions: Actions| actions.iter().map(|action| table.name(action)).collect::<Vec<&str>>();
            let possible: Actions = derived.iter().filter(|action| table.can_take(*kind, *action)).collect();
            let _ = write!(text, "derived: {}", names(*derived).join(", "));
            if possible != *derived {
                let kind = self.decision.world.scenario.kinds.key(*kind);
                let _ = write!(text, "; {kind} cannot take {}", names(*derived - possible).join(" or "));
            }
            let _ = match possible.len() {
                0 => writeln!(text, ", so the default was taken"),
                1 => writeln!(text),
                _ => writeln!(text, "; {} is first in the configured order", table.name(by_rules)),
            };
        } else if derived.is_empty() && self.explanations.len() > 1 {
            text += "no action was derived, so the default was taken\n";
        }
        if let Some(action) = self.why_not.filter(|action| derived.contains(*action)) {
            let _ = writeln!(text, "{} was derived as follows", table.name(action));
        }
        let printer = self.printer(sources);
        for (action, explanation) in &self.explanations {
            let _ = match explanation {
                Some(explanation) => write!(text, "\n{}", printer.tree(explanation)),
                None => writeln!(text, "\n{}: the rules do not declare it", table.name(*action)),
            };
        }
        text
    }

    /// Returns the explanation as JSON: `tick`, `agent`, `at`, `heading`, `derived`, `action` and `explanations`, plus
    /// `parked_since` for an agent that an earlier tick parked.
    ///
    /// Each explanation has its `action` and, if the rules declare it, the `nodes` of [`ExplanationPrinter::json`].
    pub fn json(&self, sources: &Sources) -> serde_json::Value {
        let printer = self.printer(sources);
        let table = self.decision.world.vocabulary.actions();
        let explanations: Vec<serde_json::Value> = (self.explanations.iter())
            .map(|(action, explanation)| {
                let mut entry = json!({ "action": table.name(*action) });
                if let Some(explanation) = explanation {
                    entry["nodes"] = printer.json(explanation)["nodes"].take();
                }
                entry
            })
            .collect();
        let decision = &self.decision;
        let mut account = json!({
            "tick": decision.tick,
            "agent": decision.agent,
            "at": [decision.at.row, decision.at.col],
            "heading": decision.heading.map(Heading::name),
            "derived": decision.derived.iter().map(|action| table.name(action)).collect::<Vec<_>>(),
            "action": table.name(decision.action),
            "explanations": explanations,
        });
        if let Some(since) = decision.parked_since {
            account["parked_since"] = json!(since);
        }
        account
    }
}
