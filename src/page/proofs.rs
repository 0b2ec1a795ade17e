//! The explanations of a run, in which equal parts are stored once.

use crate::engine::provenance::{Explanation, Teller};
use crate::lang::ClauseId;
use serde::Serialize;
use serde_json::{Value, json};
use std::collections::HashMap;

/// Nodes as [`Teller::json`] tells them, under short names and with numbers that hold for the whole run.
#[derive(Default, Serialize)]
pub struct Proofs {
    /// Clauses: `head`, `file`, `line`, `doc`, `label`, `text`.
    pub clauses: Vec<Value>,
    /// A fact is `{"t": text, "by": ..}` and, if a clause derives it, `"c"` (position in `clauses`), `"b"` (binding) and `"p"`
    /// (premises); what does not hold is `{"f": text, "by": ..}` and, if clauses could derive it, `"m"`, for each
    /// `[clause, binding, what fails]`. A premise and what fails is `[text, kind, node or -1]`.
    pub nodes: Vec<Value>,
    #[serde(skip)]
    known_clauses: HashMap<String, usize>,
    #[serde(skip)]
    known_nodes: HashMap<String, u32>,
}

impl Proofs {
    /// The position of a clause.
    pub fn clause(&mut self, teller: &Teller<'_>, clause: ClauseId) -> usize {
        let mut told = teller.clause_json(clause);
        let key = told.to_string();
        told["label"] = teller.label(clause).into();
        told["text"] = teller.source(clause).into();
        self.number(key, told)
    }

    fn number(&mut self, key: String, told: Value) -> usize {
        let next = self.clauses.len();
        let position = *self.known_clauses.entry(key).or_insert(next);
        if position == next {
            self.clauses.push(told);
        }
        position
    }

    /// Adds an explanation; the number of its first node. Nodes that lead back to themselves, as what does not hold in a recursion may, are
    /// stored for each explanation anew.
    pub fn add(&mut self, teller: &Teller<'_>, explanation: &Explanation) -> u32 {
        let Value::Array(nodes) = teller.json(explanation)["nodes"].take() else {
            unreachable!("an explanation is told as a list of nodes")
        };
        let mut numbers: Vec<Option<u32>> = vec![None; nodes.len()];
        let mut state = vec![State::New; nodes.len()];
        let mut stack = vec![0];
        // Depth first, without recursion: proofs may be deep.
        while let Some(&at) = stack.last() {
            if state[at] == State::Done {
                stack.pop();
                continue;
            }
            state[at] = State::Open;
            let mut waiting = None;
            for child in children(&nodes[at]) {
                match state[child] {
                    State::New => waiting = waiting.or(Some(child)),
                    // A node that leads back to itself has its number before it is complete.
                    State::Open if numbers[child].is_none() => {
                        numbers[child] = Some(self.push(Value::Null));
                    }
                    State::Open | State::Done => {}
                }
            }
            if let Some(child) = waiting {
                stack.push(child);
                continue;
            }
            let told = self.short(&nodes[at], &numbers);
            match numbers[at] {
                Some(number) => self.nodes[number as usize] = told,
                None => numbers[at] = Some(self.share(told)),
            }
            state[at] = State::Done;
            stack.pop();
        }
        numbers[0].expect("the first node has been told")
    }

    fn push(&mut self, node: Value) -> u32 {
        self.nodes.push(node);
        u32::try_from(self.nodes.len() - 1).expect("fewer than 2^32 nodes")
    }

    fn share(&mut self, node: Value) -> u32 {
        let key = node.to_string();
        if let Some(&number) = self.known_nodes.get(&key) {
            return number;
        }
        let number = self.push(node);
        self.known_nodes.insert(key, number);
        number
    }

    fn short(&mut self, node: &Value, numbers: &[Option<u32>]) -> Value {
        let literals = |entries: &Value| -> Value {
            let literal = |entry: &Value| {
                let node = entry["node"]
                    .as_u64()
                    .and_then(|child| numbers[usize::try_from(child).ok()?]);
                json!([entry["literal"], entry["kind"], node.map_or(-1, i64::from)])
            };
            list(entries).map(literal).collect()
        };
        if let Some(text) = node.get("holds") {
            let mut short = json!({ "t": text, "by": node["by"] });
            if let Some(premises) = node.get("premises") {
                short["p"] = literals(premises);
                short["b"] = node["binding"].clone();
            }
            if let Some(clause) = node.get("clause") {
                short["c"] = self.told(clause).into();
            }
            return short;
        }
        let mut short = json!({ "f": node["absent"], "by": node["because"] });
        if let Some(clauses) = node["clauses"].as_array() {
            let misses = clauses.iter().map(|miss| {
                let clause = self.told(&miss["clause"]);
                json!([clause, miss["binding"], literals(&miss["fails"])])
            });
            short["m"] = misses.collect();
        }
        short
    }

    /// The position of a clause as an explanation tells it.
    fn told(&mut self, clause: &Value) -> usize {
        self.number(clause.to_string(), clause.clone())
    }
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum State {
    New,
    Open,
    Done,
}

/// The nodes that a node speaks of.
fn children(node: &Value) -> impl Iterator<Item = usize> + '_ {
    let fails = list(&node["clauses"]).flat_map(|miss| list(&miss["fails"]));
    (list(&node["premises"]).chain(fails)).filter_map(|entry| usize::try_from(entry["node"].as_u64()?).ok())
}

/// What stands in a list; nothing if there is none.
fn list(value: &Value) -> impl Iterator<Item = &Value> {
    value.as_array().into_iter().flatten()
}
