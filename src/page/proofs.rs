//! The explanations of a run, with equal nodes stored once.
// Decision: docs/decisions/tools.md#d051

use crate::datalog;
use crate::datalog::ClauseId;
use crate::datalog::explain::{
    Absence, AbsenceReason, Explanation, ExplanationPrinter, Fact, Failure, FailureKind, Miss, Node, NodeId, Obstacle,
    Origin, Premise,
};
use crate::files::portable_name;
use serde::Serialize;
use serde_json::{Value, json};
use std::collections::HashMap;

/// The nodes of [`ExplanationPrinter::json`], with short keys and with numbers that are unique in the run.
#[derive(Default, Serialize)]
pub struct Proofs {
    /// Clauses: `head`, `file`, `line`, `doc`, `label`, `text`.
    pub clauses: Vec<Value>,
    /// A fact is `{"t": text, "by": ..}`. One that follows from earlier ticks also has `"w"`, these ticks in words. If
    /// a clause derives it, it also has `"c"` (position in `clauses`), `"b"` (binding) and `"p"` (premises). An
    /// absent fact is `{"f": text, "by": ..}`. If clauses could derive it, it also has `"m"`: for each, `[clause,
    /// binding, failures]`. A premise or failure is `[text, kind, node or -1]`. Only the nodes since the last
    /// [`Proofs::forget`].
    #[serde(skip)]
    pub nodes: Vec<Value>,
    /// Number of nodes before these.
    #[serde(skip)]
    forgotten: usize,
    #[serde(skip)]
    known_clauses: HashMap<ClauseId, usize>,
    /// Keyed by the output of [`write_key`].
    #[serde(skip)]
    known_nodes: HashMap<Box<[u32]>, u32>,
    /// The key of the node in progress; reuses its memory.
    #[serde(skip)]
    key: Vec<u32>,
}

impl Proofs {
    /// Drops the nodes, but keeps their numbers for sharing.
    pub fn forget(&mut self) {
        self.forgotten += self.nodes.len();
        self.nodes.clear();
    }

    /// Removes the nodes and returns them. The next one has number 0.
    pub fn take(&mut self) -> Vec<Value> {
        self.known_nodes.clear();
        self.forgotten = 0;
        std::mem::take(&mut self.nodes)
    }

    /// Returns the position of a clause, and adds it if it is new.
    pub fn clause(&mut self, printer: &ExplanationPrinter<'_>, clause: ClauseId) -> usize {
        let next = self.clauses.len();
        let position = *self.known_clauses.entry(clause).or_insert(next);
        if position == next {
            let mut json = printer.clause_json(clause);
            json["file"] = portable_name(json["file"].as_str().unwrap_or_default()).into();
            json["label"] = printer.label(clause).into();
            json["text"] = printer.source(clause).into();
            self.clauses.push(json);
        }
        position
    }

    /// Adds an explanation and returns the number of its first node. Cyclic nodes, which explain absences in a
    /// recursion, are not shared between explanations.
    pub fn add(&mut self, printer: &ExplanationPrinter<'_>, explanation: &Explanation) -> u32 {
        let nodes = explanation.nodes();
        let mut numbers: Vec<Option<u32>> = vec![None; nodes.len()];
        let mut state = vec![State::New; nodes.len()];
        let mut stack = vec![0];
        // Depth first, without recursion, because proofs may be deep.
        while let Some(&at) = stack.last() {
            if state[at] == State::Done {
                stack.pop();
                continue;
            }
            state[at] = State::Open;
            let mut waiting = None;
            for child in children(&nodes[at]).map(NodeId::index) {
                match state[child] {
                    State::New => waiting = waiting.or(Some(child)),
                    // A node on a cycle gets its number before it is complete.
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
            match numbers[at] {
                Some(number) => {
                    let place = number as usize - self.forgotten;
                    self.nodes[place] = self.format(printer, &nodes[at], &numbers);
                }
                None => numbers[at] = Some(self.share(printer, &nodes[at], &numbers)),
            }
            state[at] = State::Done;
            stack.pop();
        }
        numbers[0].expect("the search visits the first node")
    }

    fn push(&mut self, node: Value) -> u32 {
        self.nodes.push(node);
        u32::try_from(self.forgotten + self.nodes.len() - 1).expect("fewer than 2^32 nodes")
    }

    /// Returns the number of a node whose children have theirs. Most nodes are already known, so `share` formats a node
    /// only if its key is new.
    fn share(&mut self, printer: &ExplanationPrinter<'_>, node: &Node, numbers: &[Option<u32>]) -> u32 {
        self.key.clear();
        write_key(node, numbers, &mut self.key);
        if let Some(&number) = self.known_nodes.get(self.key.as_slice()) {
            return number;
        }
        let json = self.format(printer, node, numbers);
        let number = self.push(json);
        self.known_nodes.insert(self.key.as_slice().into(), number);
        number
    }

    fn format(&mut self, printer: &ExplanationPrinter<'_>, node: &Node, numbers: &[Option<u32>]) -> Value {
        let clauses: Vec<usize> = clauses_of(node)
            .into_iter()
            .map(|clause| self.clause(printer, clause))
            .collect();
        short(&printer.node_json(node), &clauses, numbers)
    }
}

/// Returns a node with short keys and the positions of its clauses.
fn short(node: &Value, clauses: &[usize], numbers: &[Option<u32>]) -> Value {
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
        if let Some(when) = node.get("when") {
            short["w"] = when.clone();
        }
        if let Some(premises) = node.get("premises") {
            short["p"] = literals(premises);
            short["b"] = node["binding"].clone();
        }
        if let [clause] = clauses {
            short["c"] = (*clause).into();
        }
        return short;
    }
    let mut short = json!({ "f": node["absent"], "by": node["because"] });
    if node.get("clauses").is_some() {
        let misses = list(&node["clauses"]).zip(clauses);
        short["m"] = misses
            .map(|(miss, clause)| json!([clause, miss["binding"], literals(&miss["fails"])]))
            .collect();
    }
    short
}

/// Returns the clauses of a node in the order of [`ExplanationPrinter::json`].
fn clauses_of(node: &Node) -> Vec<ClauseId> {
    match node {
        Node::Fact(fact) => match &fact.origin {
            Origin::Input | Origin::Past(_) | Origin::Removed => Vec::new(),
            Origin::Source(clause) => vec![*clause],
            Origin::Derived(derivation) => vec![derivation.clause],
        },
        Node::Absence(absence) => match &absence.reason {
            AbsenceReason::NoClause(misses) => misses.iter().map(|miss| miss.clause).collect(),
            AbsenceReason::NotAFact | AbsenceReason::NotLookedInto => Vec::new(),
        },
    }
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum State {
    New,
    Open,
    Done,
}

/// Returns the children of a node in the order of [`ExplanationPrinter::json`].
fn children(node: &Node) -> impl Iterator<Item = NodeId> + '_ {
    let (premises, misses): (&[Premise], &[Miss]) = match node {
        Node::Fact(Fact {
            origin: Origin::Derived(derivation),
            ..
        }) => (&derivation.premises, &[]),
        Node::Absence(Absence {
            reason: AbsenceReason::NoClause(misses),
            ..
        }) => (&[], misses),
        Node::Fact(_) | Node::Absence(_) => (&[], &[]),
    };
    let failures = misses.iter().flat_map(|miss| failures(&miss.obstacle));
    let excluding = misses.iter().filter_map(|miss| match miss.obstacle {
        Obstacle::Excluded { by, .. } => by,
        _ => None,
    });
    let premises = premises.iter().filter_map(premise_node).chain(excluding);
    premises.chain(failures.filter_map(|failure| failure_node(&failure.kind)))
}

fn premise_node(premise: &Premise) -> Option<NodeId> {
    match premise {
        Premise::Fact(node) | Premise::Absence(node) => Some(*node),
        Premise::Comparison { .. } | Premise::Computed { .. } => None,
    }
}

fn failure_node(kind: &FailureKind) -> Option<NodeId> {
    match kind {
        FailureKind::Absent(node) | FailureKind::Holds(node) => Some(*node),
        FailureKind::AbsentTwice | FailureKind::Comparison { .. } | FailureKind::Computed { .. } => None,
    }
}

fn failures(obstacle: &Obstacle) -> &[Failure] {
    match obstacle {
        Obstacle::Head { .. } | Obstacle::Excluded { .. } => &[],
        Obstacle::Body { failures, .. } => failures,
    }
}

/// Writes a key that identifies a node by its content; `numbers` are those of its children. A list of variable length
/// follows its length.
fn write_key(node: &Node, numbers: &[Option<u32>], key: &mut Vec<u32>) {
    let number = |node: Option<NodeId>| node.and_then(|node| numbers[node.index()]).unwrap_or(u32::MAX);
    let count = |count: usize| u32::try_from(count).expect("a list of a clause");
    let write_pattern = |pattern: &[Option<datalog::Value>], key: &mut Vec<u32>| {
        for value in pattern {
            key.extend([u32::from(value.is_some()), value.map_or(0, |value| value.0)]);
        }
    };
    match node {
        Node::Fact(fact) => {
            key.extend([0, fact.predicate.0]);
            key.extend(fact.row.iter().map(|value| value.0));
            match &fact.origin {
                Origin::Input => key.push(0),
                Origin::Removed => key.push(4),
                // A tick has fewer than 2^64 numbers of its kind before it, so its halves identify it.
                Origin::Past(tick) => key.extend([3, (tick >> 32) as u32, (tick & u64::from(u32::MAX)) as u32]),
                Origin::Source(clause) => key.extend([1, clause.0]),
                Origin::Derived(derivation) => {
                    key.extend([2, derivation.clause.0]);
                    write_pattern(&derivation.binding, key);
                    key.extend(derivation.premises.iter().map(|premise| number(premise_node(premise))));
                }
            }
        }
        Node::Absence(absence) => {
            key.extend([1, absence.predicate.0]);
            write_pattern(&absence.pattern, key);
            match &absence.reason {
                AbsenceReason::NotAFact => key.push(0),
                AbsenceReason::NotLookedInto => key.push(1),
                AbsenceReason::NoClause(misses) => {
                    key.extend([2, count(misses.len())]);
                    for Miss { clause, obstacle } in misses {
                        key.push(clause.0);
                        if let Obstacle::Excluded { binding, by } = obstacle {
                            key.push(u32::MAX - 1);
                            write_pattern(binding, key);
                            key.push(number(*by));
                        }
                        let Obstacle::Body { binding, failures } = obstacle else {
                            key.push(u32::MAX);
                            continue;
                        };
                        key.push(count(failures.len()));
                        write_pattern(binding, key);
                        for failure in failures {
                            key.extend([count(failure.literal), number(failure_node(&failure.kind))]);
                        }
                    }
                }
            }
        }
    }
}

/// Returns the items of a JSON list; nothing for other values.
fn list(value: &Value) -> impl Iterator<Item = &Value> {
    value.as_array().into_iter().flatten()
}
