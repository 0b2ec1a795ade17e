//! The probabilities of the actions of egos, in scenes with uncertain facts and under rules with probabilities.

use crate::cancel::Cancel;
use crate::city::{Action, Heading};
use crate::datalog::{BaseType, MarginalOptions, Marginals, PredicateId, Probability, Value};
use crate::diag::{Diagnostic, SourceId, Sources, Span};
use crate::sim::codes;
use crate::sim::scene::answer::{SceneFacts, comma};
use crate::sim::scene::infer::Inference;
use crate::sim::tick::ground_state::GroundPredicate;
use serde_json::json;
use smallvec::SmallVec;
use std::io::{self, Write};
use std::sync::Arc;

/// The probabilities of the actions of the egos of a scene.
#[derive(Clone, Debug)]
pub struct MarginalAnswer {
    /// The egos, in the order of the scene.
    pub egos: Vec<MarginalEgo>,
    /// Why the probabilities are estimates, as a sentence without a full stop; `None` if they are exact.
    pub inexact: Option<String>,
}

/// The probabilities of the actions of an ego. Those of impossible actions are left out.
#[derive(Clone, Debug)]
pub struct MarginalEgo {
    /// The name of the ego.
    pub id: String,
    /// The probability that the rules derive each action.
    pub derived: Vec<(String, Probability)>,
    /// The probability that the ego takes each action; they add up to 1.
    pub decided: Vec<(String, Probability)>,
}

/// The actions that an agent can take, in order of precedence, and its default.
#[derive(PartialEq)]
struct Order {
    actions: Vec<(Action, PredicateId)>,
    default: Action,
}

impl MarginalAnswer {
    /// Writes the answer as JSON: `{"egos": {ID: {"derived": {ACTION: 0.4}, "action": {ACTION: 0.4}}}, "exact": true}`.
    /// An estimate is `{"value", "low", "high"}`, and the answer then has the key `because`.
    ///
    /// # Errors
    /// The errors of `out`.
    pub fn write_json(&self, out: &mut dyn Write) -> io::Result<()> {
        out.write_all(b"{\"egos\":{")?;
        for (position, ego) in self.egos.iter().enumerate() {
            write_key(out, position, &ego.id)?;
            out.write_all(b"{\"derived\":")?;
            write_probabilities(out, &ego.derived)?;
            out.write_all(b",\"action\":")?;
            write_probabilities(out, &ego.decided)?;
            out.write_all(b"}")?;
        }
        match &self.inexact {
            None => out.write_all(b"},\"exact\":true}"),
            Some(reason) => write!(out, "}},\"exact\":false,\"because\":{}}}", json!(reason)),
        }
    }

    /// Returns the answer as JSON; see [`MarginalAnswer::write_json`].
    pub fn to_json(&self) -> serde_json::Value {
        let mut text = Vec::new();
        self.write_json(&mut text).expect("writing to memory cannot fail");
        serde_json::from_slice(&text).expect("it has been written as JSON")
    }
}

/// Writes the key of an entry of an object.
fn write_key(out: &mut dyn Write, position: usize, key: &str) -> io::Result<()> {
    out.write_all(comma(position).as_bytes())?;
    serde_json::to_writer(&mut *out, key)?;
    out.write_all(b":")
}

/// Returns a probability with 15 significant digits, which hide the errors of rounding: 0.011, not 0.011000000000000001.
fn shown(probability: f64) -> f64 {
    format!("{probability:.14e}").parse().unwrap_or(probability)
}

fn write_probabilities(out: &mut dyn Write, list: &[(String, Probability)]) -> io::Result<()> {
    out.write_all(b"{")?;
    for (position, (action, probability)) in list.iter().enumerate() {
        write_key(out, position, action)?;
        match probability.interval {
            None => serde_json::to_writer(&mut *out, &shown(probability.value))?,
            Some((low, high)) => {
                let estimate = json!({ "value": shown(probability.value), "low": shown(low), "high": shown(high) });
                write!(out, "{estimate}")?;
            }
        }
    }
    out.write_all(b"}")
}

impl Inference {
    /// Returns the probabilities of the actions of each ego of the scene in `source`, which may state rows with a
    /// probability. Clauses with probabilities draw nothing, but count with all their alternatives.
    ///
    /// # Errors
    /// As [`Inference::answer`]; `invalid-scene` for a list of scenes if what temporal operators read of the earlier
    /// ones is uncertain.
    pub fn marginals(
        &mut self,
        sources: &Sources,
        source: SourceId,
        options: MarginalOptions,
        cancel: &Cancel,
    ) -> Result<MarginalAnswer, Vec<Diagnostic>> {
        let scene = self.ground_with(sources, source, cancel)?;
        let whole = Span::new(source, 0..sources.text(source).len());
        if !scene.facts.past.is_empty() {
            self.check_certain_past().map_err(|fault| vec![fault.at(whole, "")])?;
        }
        let found = self.probabilities(&scene, options, cancel);
        found.map_err(|fault| vec![fault.at(whole, "in this scene")])
    }

    /// Checks that no operand of a temporal operator depends on a draw.
    fn check_certain_past(&self) -> Result<(), Diagnostic> {
        let rules = self.program.rules();
        let Some(drawn) = rules.drawn_operand() else {
            return Ok(());
        };
        let message = format!(
            "temporal operators read `{}` of the earlier ticks of this list, which is uncertain, since the rules draw \
             it",
            rules.predicates[drawn.index()].title()
        );
        let fault = Diagnostic::new(codes::INVALID_SCENE, message);
        Err(fault.help("use rules in which the operands depend on no draw, or a scene of one tick"))
    }

    fn probabilities(
        &mut self,
        scene: &SceneFacts,
        options: MarginalOptions,
        cancel: &Cancel,
    ) -> Result<MarginalAnswer, Diagnostic> {
        let vocabulary = Arc::clone(&self.vocabulary);
        let order = self.scenario.actions.priority.iter();
        let order: Vec<(Action, PredicateId)> = order
            .filter_map(|action| Some((*action, vocabulary.action(*action)?)))
            .collect();
        let options = MarginalOptions {
            limits: self.limits,
            ..options
        };
        let ids = || order.iter().map(|(_, predicate)| *predicate);
        let known = self.marginals.take().filter(|known| *known.options() == options);
        let mut marginals = match known {
            Some(mut known) => {
                known.clear();
                known
            }
            None => Marginals::new(&self.program, ids(), options).expect("actions are predicates"),
        };
        let names: Vec<Value> = scene.names.iter().map(|name| marginals.intern(name)).collect();
        let headings = Heading::ALL.map(|heading| marginals.intern(heading.name()));
        let words = |row: &[u32; 2], arity: usize| -> SmallVec<[Value; 4]> {
            // Columns that the predicate does not have contain 0, also in a scene without entities.
            let both = row.map(|entity| names.get(entity as usize).copied().unwrap_or_default());
            SmallVec::from_slice(&both[..arity])
        };
        for (index, predicate) in GroundPredicate::of(&vocabulary).enumerate() {
            let Some(GroundPredicate { id, arity, value }) = predicate else {
                continue;
            };
            let (rows, values) = (&scene.facts.rows[index], &scene.facts.values[index]);
            let uncertain = scene.uncertain.iter().filter(|(of, ..)| *of == index);
            let inserted = if values.is_empty() {
                // Both are sorted.
                let mut uncertain = uncertain.peekable();
                let rows = rows.iter().map(|row| {
                    let known = uncertain.next_if(|(_, uncertain, _)| uncertain == row);
                    (words(row, arity), known.map_or(1.0, |(.., probability)| *probability))
                });
                let inserted = marginals.insert_all(id, rows);
                debug_assert!(uncertain.peek().is_none(), "all uncertain rows are among the rows");
                inserted
            } else {
                let value = |at: Value| match value {
                    Some(BaseType::Symbol) => headings[at.0 as usize],
                    _ => at,
                };
                let rows = rows.iter().zip(values).map(|(row, at)| {
                    let mut words = words(row, arity);
                    words.push(value(*at));
                    (words, 1.0)
                });
                marginals.insert_all(id, rows)
            };
            inserted.expect("facts of the vocabulary fit");
        }
        let rules = self.program.rules();
        for (past, rows) in rules.pasts.iter().zip(&scene.facts.past) {
            let arity = rules.predicates[past.predicate.index()].arity();
            let inserted = marginals.insert_all(past.predicate, rows.iter().map(|(row, _)| (words(row, arity), 1.0)));
            inserted.expect("facts of the vocabulary fit");
        }
        let rows: Vec<[Value; 1]> = scene.egos.iter().map(|ego| [names[*ego]]).collect();
        let rows: Vec<&[Value]> = rows.iter().map(|row| &row[..]).collect();
        marginals.set_rows(Some(&rows));
        let mut egos: Vec<Option<MarginalEgo>> = scene.egos.iter().map(|_| None).collect();
        while let Some(next) = egos.iter().position(Option::is_none) {
            let order = self.order_of(scene, scene.egos[next]);
            let ordered = marginals.set_order(order.actions.iter().map(|(_, predicate)| *predicate));
            ordered.expect("actions are predicates");
            marginals.compute(cancel).map_err(|error| self.exceeded(&error))?;
            let open = scene.egos.iter().zip(&mut egos);
            for (&ego, answer) in open.filter(|(ego, _)| self.order_of(scene, **ego) == order) {
                let row = [names[ego]];
                *answer = Some(self.marginal_ego(&scene.names[ego], &row, &order, &marginals));
            }
        }
        let answer = MarginalAnswer {
            egos: egos.into_iter().flatten().collect(),
            inexact: marginals.inexact().map(|inexact| inexact.show(self.program.rules())),
        };
        self.marginals = Some(marginals);
        Ok(answer)
    }

    /// Returns the actions that an ego can take, in order of precedence, and its default.
    fn order_of(&self, scene: &SceneFacts, ego: usize) -> Order {
        let config = &self.scenario.actions;
        let kind = scene.kinds.get(ego).copied();
        let usual = (config.priority.as_slice(), config.default);
        let (priority, default) = kind.map_or(usual, |kind| config.order(kind));
        let can_take = |action: &&Action| kind.is_none_or(|kind| config.table.can_take(kind, **action));
        let actions = priority.iter().filter(can_take);
        Order {
            actions: (actions.filter_map(|action| Some((*action, self.vocabulary.action(*action)?)))).collect(),
            default,
        }
    }

    /// Returns the probabilities of an ego, whose row this is, for actions in order of precedence.
    fn marginal_ego(&self, id: &str, row: &[Value], order: &Order, marginals: &Marginals) -> MarginalEgo {
        let table = self.vocabulary.actions();
        let name = |action: Action| table.name(action).to_owned();
        let derived = order.actions.iter().filter_map(|(action, predicate)| {
            let probability = marginals.probability(*predicate, row)?;
            Some((name(*action), probability))
        });
        let mut decided: Vec<(Action, Probability)> = Vec::new();
        let actions = order.actions.iter().map(|(action, _)| *action);
        let actions = actions.chain([order.default]);
        for (action, probability) in actions.zip(marginals.first(row)) {
            match decided.iter_mut().find(|(known, _)| *known == action) {
                Some((_, known)) => *known = known.or(probability),
                None if probability.value > 0.0 => decided.push((action, probability)),
                None => {}
            }
        }
        MarginalEgo {
            id: id.to_owned(),
            derived: derived.collect(),
            decided: decided
                .into_iter()
                .map(|(action, value)| (name(action), value))
                .collect(),
        }
    }
}
