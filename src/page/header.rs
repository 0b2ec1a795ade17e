//! What a page shows of a run besides its ticks: names, agents, predicates and clauses.

use crate::city::Heading;
use crate::datalog::explain::{Explainer, ExplanationPrinter};
use crate::datalog::{ClauseId, Value};
use crate::diag::{Diagnostic, Sources};
use crate::files::portable_name;
use crate::page::proofs::Proofs;
use crate::predicate::Quantity;
use crate::sim::{Replay, TraceHeader, json_value};
use serde::Serialize;
use std::collections::HashSet;
use std::fmt;

/// The constant part of a run. The positions in its lists identify agents, actions, predicates and clauses.
#[derive(Serialize)]
pub struct Header {
    pub title: String,
    config: String,
    rules: String,
    split: String,
    /// The seed as text, since JavaScript rounds large integers.
    seed: String,
    hash: String,
    pub agents: Vec<Agent>,
    pub actions: Vec<String>,
    headings: [&'static str; 4],
    predicates: Vec<Predicate>,
    /// Number of clauses whose firings the trace records: the first ones in [`Proofs::clauses`], in the order of the
    /// trace.
    pub counted: usize,
    #[serde(flatten)]
    pub proofs: Proofs,
}

/// An agent, as the trace names it.
#[derive(Serialize, PartialEq, Eq)]
pub struct Agent {
    pub id: String,
    kind: &'static str,
    concepts: Vec<String>,
    priority: i32,
}

impl fmt::Display for Agent {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} ({}", self.id, self.kind)?;
        for concept in &self.concepts {
            write!(f, ", {concept}")?;
        }
        write!(f, ", priority {})", self.priority)
    }
}

#[derive(Serialize)]
struct Predicate {
    name: String,
    /// The number of columns for agents.
    arity: usize,
    /// The quantity whose value is the last column, if the predicate holds one.
    #[serde(skip_serializing_if = "Option::is_none")]
    quantity: Option<&'static str>,
}

/// The position of a quantity among the predicates, and its rows with their values.
pub type Values = (usize, Vec<(u64, serde_json::Value)>);

impl Header {
    pub fn new(replay: &Replay, header: &TraceHeader, sources: &Sources) -> Header {
        let world = replay.world();
        let printer = ExplanationPrinter::new(world.program.rules(), replay.session().symbols(), sources);
        let mut proofs = Proofs::default();
        let counted = world.clauses().map(|clause| proofs.clause(&printer, clause)).count();
        for index in 0..world.program.rules().clauses.len() {
            let index = u32::try_from(index).expect("fewer than 2^32 clauses");
            proofs.clause(&printer, ClauseId(index));
        }
        let agents = (header.agents.iter().zip(replay.kinds())).map(|(agent, &kind)| Agent {
            id: agent.id.clone(),
            kind: kind.name(),
            concepts: agent.concepts.clone(),
            priority: agent.priority,
        });
        let predicates = (world.vocabulary.predicates.iter()).map(|predicate| Predicate {
            name: predicate.name.clone(),
            arity: predicate.arity,
            quantity: predicate.quantity().map(Quantity::name),
        });
        Header {
            title: format!("{} ({}), seed {}", header.config, header.split, header.seed),
            config: header.config.clone(),
            rules: portable_name(&header.rules),
            split: header.split.clone(),
            seed: header.seed.to_string(),
            hash: header.rules_hash.clone(),
            agents: agents.collect(),
            actions: world.vocabulary.actions().names().map(str::to_owned).collect(),
            headings: Heading::ALL.map(Heading::name),
            predicates: predicates.collect(),
            counted,
            proofs,
        }
    }

    /// Explains why an agent did or did not take each action in the state of `replay`. Returns the numbers of the
    /// nodes, or -1 for an action that no rule has.
    ///
    /// # Errors
    /// `limit-exceeded` if an explanation takes too many steps.
    pub fn explain(
        &mut self,
        replay: &Replay,
        (explainer, printer): (&mut Explainer<'_>, &ExplanationPrinter<'_>),
        agent: usize,
    ) -> Result<Vec<i64>, Diagnostic> {
        let vocabulary = &replay.world().vocabulary;
        let mut nodes = vec![-1; vocabulary.actions().all().len()];
        for (node, action) in nodes.iter_mut().zip(vocabulary.actions().all()) {
            let Some(predicate) = vocabulary.action(action) else {
                continue;
            };
            let asked: [Option<Value>; 1] = [Some(replay.value(agent))];
            if let (_, Some(explanation)) = explainer.explain_either(predicate, &asked)? {
                *node = i64::from(self.proofs.add(printer, &explanation));
            }
        }
        Ok(nodes)
    }

    /// Returns for each predicate its rows in the state of `replay`, as numbers in ascending order. A row (x, y) is x
    /// times the number of agents plus y. A quantity has no rows here; see [`Header::values`].
    pub fn rows(&self, replay: &Replay) -> impl Iterator<Item = Vec<u64>> {
        let predicates = self.predicates.iter().zip(&replay.facts().rows);
        predicates.map(move |(predicate, rows)| {
            let rows = rows.iter().filter(|_| predicate.quantity.is_none());
            let mut numbers: Vec<u64> = rows.map(|row| self.number(predicate, *row)).collect();
            numbers.sort_unstable();
            numbers
        })
    }

    /// Returns the number of a row of a predicate.
    fn number(&self, predicate: &Predicate, row: [u32; 2]) -> u64 {
        match predicate.arity {
            2 => u64::from(row[0]) * self.agents.len() as u64 + u64::from(row[1]),
            _ => u64::from(row[0]),
        }
    }

    /// Returns the quantities in the state of `replay`: rows as in [`Header::rows`], with values. A quantity of two
    /// agents has only the rows in which the first agent sees the second.
    pub fn values(&self, replay: &Replay) -> Vec<Values> {
        let (vocabulary, facts) = (&replay.world().vocabulary, replay.facts());
        let sees: HashSet<[u32; 2]> = facts.rows[vocabulary.sees].iter().copied().collect();
        let predicates = self.predicates.iter().zip(&vocabulary.predicates).enumerate();
        let quantities = predicates.filter_map(|(index, (predicate, known))| {
            let unit = known.definition.unit()?;
            let rows = facts.rows[index].iter().zip(&facts.values[index]);
            let rows = rows.filter(|(row, _)| predicate.arity < 2 || sees.contains(*row));
            let rows = rows.map(|(row, value)| (self.number(predicate, *row), json_value(*value, unit)));
            Some((index, rows.collect()))
        });
        quantities.collect()
    }
}
