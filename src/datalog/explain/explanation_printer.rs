//! Explanations as text for readers and as JSON for programs.

use crate::check::witness::written;
use crate::check::{
    Atom, Clause, ClauseId, Literal, PastOperator, Predicate, PredicateId, Rules, Term, VarId, temporal,
};
use crate::diag::Sources;
use crate::explain::{
    Absence, AbsenceReason, Explanation, Fact, Failure, FailureKind, Miss, Node, NodeId, Obstacle, Origin, Premise,
};
use crate::record;
use crate::symbol::{Symbol, Symbols};
use crate::syntax::ast::{BaseType, Comparison};
use crate::syntax::functor::Functor;
use crate::syntax::quoted;
use crate::value::{Value, record_text, shown_number};
use indexmap::IndexSet;
use serde_json::{Map, json};
use std::collections::{BTreeMap, HashSet};

/// Prints explanations in the notation of the paper: `Not(IsAmbulance(Car_3))`.
///
/// A scope guard prints as `in view`. A hidden predicate, which represents a negated atom with `_` in view, prints as
/// that atom.
#[derive(Clone, Copy)]
pub struct ExplanationPrinter<'a> {
    rules: &'a Rules,
    symbols: &'a Symbols,
    sources: &'a Sources,
    /// Whether symbols always stand in quotes, even if they read as names.
    quotes: bool,
}

/// The number of clauses to name whose heads have other values.
const HEADS_SHOWN: usize = 5;

/// A line with its child lines.
struct Item {
    text: String,
    children: Vec<Item>,
}

impl Item {
    fn leaf(text: impl Into<String>) -> Item {
        Item {
            text: text.into(),
            children: Vec::new(),
        }
    }

    fn draw(&self, first: &str, rest: &str, out: &mut String) {
        out.push_str(first);
        out.push_str(&self.text);
        out.push('\n');
        for (at, child) in self.children.iter().enumerate() {
            let (corner, line) = if at + 1 < self.children.len() {
                ("├─ ", "│  ")
            } else {
                ("└─ ", "   ")
            };
            child.draw(&format!("{rest}{corner}"), &format!("{rest}{line}"), out);
        }
    }
}

impl<'a> ExplanationPrinter<'a> {
    /// Maximum depth of the printed tree; [`ExplanationPrinter::json`] is complete.
    pub const DEPTH_MAX: usize = 40;

    /// Creates a printer. `symbols` are those of the session, `sources` those of the rules.
    pub fn new(rules: &'a Rules, symbols: &'a Symbols, sources: &'a Sources) -> Self {
        ExplanationPrinter {
            rules,
            symbols,
            sources,
            quotes: false,
        }
    }

    /// Puts all symbols in quotes, as in rules, so that the output parses again.
    pub fn quoting(self) -> Self {
        ExplanationPrinter { quotes: true, ..self }
    }

    /// Returns the explanation as a tree of lines. The tree expands each node once. All symbols stand in quotes, so
    /// that readers can copy atoms into rules.
    pub fn tree(&self, explanation: &Explanation) -> String {
        let mut out = String::new();
        if !explanation.nodes().is_empty() {
            let mut drawing = Drawing {
                printer: self.quoting(),
                explanation,
                printed: HashSet::new(),
                open: Vec::new(),
            };
            let mut item = drawing.node(NodeId(0), 0);
            // Without these words, the tree would only repeat the question.
            match explanation.node(NodeId(0)) {
                Node::Fact(Fact {
                    origin: Origin::Input, ..
                }) => item.text.push_str("  a given fact"),
                Node::Absence(Absence {
                    reason: AbsenceReason::NotAFact,
                    ..
                }) => item.text.push_str(": not a given fact, and no clause derives it"),
                _ => {}
            }
            item.draw("", "", &mut out);
        }
        out
    }

    /// Returns the explanation as JSON: `{"nodes": [..]}`.
    ///
    /// The first node is the subject of the query; nodes refer to others by position.
    ///
    /// A node is `{"holds", "height", "by": "input" | "past" | "text" | "clause" | "range", "tick", "clause",
    /// "binding", "premises"}` or `{"absent", "because": "not-a-fact" | "no-clause" | "not-looked-into" | "range",
    /// "clauses": [{"clause", "binding", "fails"}]}`. For `past`, `holds` also names the ticks.
    ///
    /// An entry of `premises` and `fails` has the `literal` under the binding and the `kind`: `fact`, `in-view`, `not`,
    /// `comparison`, `expression`, `aggregate` or `draw`. For the first three kinds, `node` refers to the explanation of the
    /// literal. A `clause` has `head`, `file`, `line` and `doc`. If only the head does not match, `fails` is empty. The
    /// references between absences of a recursion may form cycles.
    pub fn json(&self, explanation: &Explanation) -> serde_json::Value {
        let nodes = explanation.nodes().iter().map(|node| self.node_json(node));
        json!({ "nodes": nodes.collect::<Vec<serde_json::Value>>() })
    }

    /// Returns one node of [`ExplanationPrinter::json`].
    pub fn node_json(&self, node: &Node) -> serde_json::Value {
        match node {
            Node::Fact(fact) => self.fact_json(fact),
            Node::Absence(absence) => self.absence_json(absence),
        }
    }

    fn fact_json(&self, fact: &Fact) -> serde_json::Value {
        let pattern: Vec<Option<Value>> = fact.row.iter().copied().map(Some).collect();
        let holds = self.row(fact.predicate, &pattern);
        if self.is_range(fact.predicate) {
            return json!({ "holds": holds, "height": fact.height, "by": "range" });
        }
        match &fact.origin {
            Origin::Input => json!({ "holds": holds, "height": fact.height, "by": "input" }),
            Origin::Removed => json!({ "holds": holds, "height": fact.height, "by": "removed-rows" }),
            Origin::Past(tick) => json!({
                "holds": holds, "height": fact.height, "by": "past", "tick": tick,
                "when": self.ticks(fact.predicate, *tick),
            }),
            Origin::Source(clause) => json!({
                "holds": holds, "height": fact.height, "by": "text", "clause": self.clause_json(*clause),
            }),
            Origin::Derived(derivation) => {
                let clause = &self.rules.clauses[derivation.clause.index()];
                let premises: Vec<serde_json::Value> = (derivation.premises.iter().enumerate())
                    .filter(|(literal, _)| self.is_shown(clause, *literal))
                    .map(|(literal, premise)| {
                        let node = match premise {
                            Premise::Fact(node) | Premise::Absence(node) => Some(node.0),
                            Premise::Comparison { .. } | Premise::Computed { .. } => None,
                        };
                        self.literal_json(clause, literal, &derivation.binding, node)
                    })
                    .collect();
                json!({
                    "holds": holds,
                    "height": fact.height,
                    "by": "clause",
                    "clause": self.clause_json(derivation.clause),
                    "binding": self.binding_json(clause, &derivation.binding),
                    "premises": premises,
                })
            }
        }
    }

    fn absence_json(&self, absence: &Absence) -> serde_json::Value {
        let absent = self.row(absence.predicate, &absence.pattern);
        if self.is_range(absence.predicate) {
            return json!({ "absent": absent, "because": "range" });
        }
        match &absence.reason {
            AbsenceReason::NotAFact => json!({ "absent": absent, "because": "not-a-fact" }),
            AbsenceReason::NotLookedInto => json!({ "absent": absent, "because": "not-looked-into" }),
            AbsenceReason::NoClause(misses) => {
                let clauses: Vec<serde_json::Value> = (misses.iter())
                    .map(|miss| {
                        let clause = &self.rules.clauses[miss.clause.index()];
                        if let Obstacle::Excluded { binding, by } = &miss.obstacle {
                            let binding = self.binding_json(clause, binding);
                            let clause = self.clause_json(miss.clause);
                            return json!({
                                "clause": clause, "binding": binding, "fails": [], "excluded-by": by.map(|by| by.0)
                            });
                        }
                        let (binding, fails) = match &miss.obstacle {
                            Obstacle::Head { .. } | Obstacle::Excluded { .. } => (Map::new(), Vec::new()),
                            Obstacle::Body { binding, failures } => {
                                let fails = failures.iter().map(|failure| {
                                    let node = match failure.kind {
                                        FailureKind::Absent(node) | FailureKind::Holds(node) => Some(node.0),
                                        FailureKind::AbsentTwice
                                        | FailureKind::Comparison { .. }
                                        | FailureKind::Computed { .. } => None,
                                    };
                                    self.literal_json(clause, failure.literal, binding, node)
                                });
                                (self.binding_json(clause, binding), fails.collect())
                            }
                        };
                        json!({ "clause": self.clause_json(miss.clause), "binding": binding, "fails": fails })
                    })
                    .collect();
                json!({ "absent": absent, "because": "no-clause", "clauses": clauses })
            }
        }
    }

    fn literal_json(
        &self,
        clause: &Clause,
        literal: usize,
        binding: &[Option<Value>],
        node: Option<u32>,
    ) -> serde_json::Value {
        let literal = &clause.body[literal];
        let kind = match literal {
            Literal::Positive(_) => "fact",
            Literal::Guard(_) => "in-view",
            Literal::Negative(_) => "not",
            _ if self.drawn(clause, literal, binding).is_some() => "draw",
            Literal::Compare { .. } => "comparison",
            Literal::Compute { .. } => "expression",
            Literal::Aggregate { .. } => "aggregate",
        };
        let mut entry = json!({ "literal": self.literal(clause, literal, binding), "kind": kind });
        if let Some(node) = node {
            entry["node"] = json!(node);
        }
        entry
    }

    /// Returns a clause as `{"head", "file", "line", "doc"}`.
    pub fn clause_json(&self, clause: ClauseId) -> serde_json::Value {
        let clause = &self.rules.clauses[clause.index()];
        let head = &self.rules.predicates[clause.head.predicate.index()];
        json!({
            "head": head.title(),
            "file": self.sources.file(clause.span),
            "line": self.sources.position(clause.span).line,
            "doc": clause.doc,
        })
    }

    fn binding_json(&self, clause: &Clause, binding: &[Option<Value>]) -> Map<String, serde_json::Value> {
        self.named(clause, binding)
            .map(|(name, value, base)| {
                let value = match base {
                    BaseType::Number => json!(value.to_number(self.symbols)),
                    BaseType::Unsigned => json!(value.to_unsigned(self.symbols)),
                    // JSON has no infinities and no NaN.
                    BaseType::Float => {
                        let text = shown_number(base, value, self.symbols);
                        match text.parse::<f64>() {
                            Ok(float) if float.is_finite() => json!(float),
                            _ => json!(text),
                        }
                    }
                    BaseType::Record => json!(record_text(value, self.symbols)),
                    BaseType::Symbol => json!(self.symbols.resolve(Symbol(value.0)).unwrap_or_default()),
                };
                (name.to_owned(), value)
            })
            .collect()
    }

    /// Returns the named variables that are bound.
    fn named<'b>(
        &self,
        clause: &'b Clause,
        binding: &'b [Option<Value>],
    ) -> impl Iterator<Item = (&'b str, Value, BaseType)> {
        let bases = self.rules.bases(clause);
        // Those that the checker adds for a draw mean nothing to readers.
        let draw = self.rules.draw(clause).map(|draw| draw.literals);
        let added: Vec<VarId> = draw.map_or_else(Vec::new, |[word, choice, _]| {
            let result = match &clause.body[choice] {
                Literal::Compute { to, .. } => to.variable(),
                _ => None,
            };
            clause.body[word].variables().chain(result).collect()
        });
        (clause.variables.iter().zip(binding).zip(bases).enumerate())
            .filter(move |(at, _)| !added.iter().any(|added| added.index() == *at))
            .map(|(_, ((name, value), base))| (name, written(name), value, base))
            // A variable within an aggregate may have the name of one outside.
            .filter(|(name, written, ..)| {
                *written != "_" && (name == written || !clause.variables.iter().any(|other| other == written))
            })
            .filter_map(|(_, written, value, base)| Some((written, (*value)?, base)))
    }

    /// Returns the base type of the value that a literal computes.
    fn computed_base(&self, clause: &Clause, literal: &Literal) -> BaseType {
        match literal {
            Literal::Compute {
                to: Term::Variable(to), ..
            } => self.rules.bases(clause)[to.index()],
            Literal::Compute { functor, base, .. } => functor.result_base(*base).unwrap_or(*base),
            Literal::Aggregate { op, base, .. } => op.result_base(*base),
            _ => BaseType::Number,
        }
    }

    /// Returns the title and place of a clause: the first line of its doc comment, or else its text, and `file:line`.
    pub fn title(&self, clause_id: ClauseId) -> String {
        let clause = &self.rules.clauses[clause_id.index()];
        let title = match clause.doc.lines().next() {
            Some(line) if !line.trim().is_empty() => line.trim().to_owned(),
            _ => {
                let words: Vec<&str> = self.sources.slice(clause.span).split_whitespace().collect();
                words.join(" ")
            }
        };
        format!("{title}  [{}]", self.place(clause_id))
    }

    /// Returns the short name of a clause: its doc comment up to the first colon (`S2`), or else `file:line`.
    pub fn label(&self, clause_id: ClauseId) -> String {
        let clause = &self.rules.clauses[clause_id.index()];
        match clause.doc.split_once(':') {
            Some((label, _)) if !label.is_empty() && !label.contains(char::is_whitespace) => label.to_owned(),
            _ => self.place(clause_id),
        }
    }

    /// Returns a row that a clause derived, as a fact.
    pub fn head(&self, clause: ClauseId, row: &[Value]) -> String {
        let row: Vec<Option<Value>> = row.iter().copied().map(Some).collect();
        self.row(self.rules.clauses[clause.index()].head.predicate, &row)
    }

    /// Returns a clause as its source has it.
    pub fn source(&self, clause: ClauseId) -> &'a str {
        self.sources.slice(self.rules.clauses[clause.index()].span)
    }

    /// Returns `file:line` of a clause, without the folder.
    pub fn place(&self, clause: ClauseId) -> String {
        let clause = &self.rules.clauses[clause.index()];
        let name = self.sources.file(clause.span);
        let file = name.rsplit(['/', '\\']).next().unwrap_or(name);
        format!("{file}:{}", self.sources.position(clause.span).line)
    }

    /// Returns a value as text.
    ///
    /// Symbols that read as names have no quotes, unless the printer is [`quoting`](ExplanationPrinter::quoting).
    pub fn value(&self, value: Value, base: BaseType) -> String {
        match base {
            BaseType::Number | BaseType::Unsigned | BaseType::Float => shown_number(base, value, self.symbols),
            BaseType::Record => record_text(value, self.symbols),
            BaseType::Symbol => {
                let text = self.symbols.resolve(Symbol(value.0)).unwrap_or_default();
                let bare = |c: char| c.is_alphanumeric() || "_-.".contains(c);
                if !self.quotes && !text.is_empty() && text.chars().all(bare) {
                    text.to_owned()
                } else {
                    quoted(text)
                }
            }
        }
    }

    /// Returns a row or pattern as an atom. Open columns are `_`.
    pub fn row(&self, predicate: PredicateId, pattern: &[Option<Value>]) -> String {
        self.row_within(predicate, pattern, 0)
    }

    /// Returns the words for the ticks in which the operand of a temporal operator held.
    fn ticks(&self, predicate: PredicateId, tick: u64) -> String {
        let past = self.rules.pasts.iter().find(|past| past.predicate == predicate);
        match past.map(|past| (&past.operator, past.first, past.last)) {
            Some((PastOperator::Always, first, Some(last))) if last > first => {
                format!("in the ticks {tick} to {}", tick + u64::from(last - first))
            }
            Some((PastOperator::Since(..), ..)) => format!("since tick {tick}"),
            _ => format!("in tick {tick}"),
        }
    }

    fn row_within(&self, id: PredicateId, pattern: &[Option<Value>], depth: usize) -> String {
        let predicate = &self.rules.predicates[id.index()];
        if is_unfolded(predicate) {
            return self.unfold(id, pattern, depth);
        }
        let columns = predicate.columns.iter().zip(pattern);
        let values: Vec<String> = columns
            .map(|(column, value)| value.map_or("_".to_owned(), |value| self.value(value, column.base)))
            .collect();
        self.named_atom(id, &values)
    }

    /// Returns an atom of a predicate that is not unfolded.
    fn named_atom(&self, id: PredicateId, arguments: &[String]) -> String {
        if let Some(shown) = temporal::shown(&self.rules.predicates[id.index()], arguments) {
            return shown;
        }
        let arguments = arguments.join(", ");
        match self.rules.predicates.iter().find(|predicate| predicate.edb == Some(id)) {
            Some(owner) => format!("given {}({arguments})", owner.name),
            None => format!("{}({arguments})", self.rules.predicates[id.index()].name),
        }
    }

    /// Returns whether a hidden predicate holds the values of a `range`: no other hidden one is recursive. The printer
    /// does not unfold these.
    fn is_range(&self, id: PredicateId) -> bool {
        let itself = |literal: &Literal| literal.atom().is_some_and(|atom| atom.predicate == id);
        let mut clauses = self.rules.clauses.iter().filter(|clause| clause.head.predicate == id);
        let hidden = self.rules.predicates[id.index()].hidden;
        hidden && clauses.any(|clause| clause.body.iter().any(itself))
    }

    /// Returns the definition of a hidden predicate: the bodies of its clauses.
    fn unfold(&self, id: PredicateId, pattern: &[Option<Value>], depth: usize) -> String {
        const UNFOLD_MAX: usize = 8;
        let predicate = &self.rules.predicates[id.index()];
        if depth == UNFOLD_MAX {
            return predicate.doc.clone();
        }
        let clauses = self
            .rules
            .clauses
            .iter()
            .filter(|clause| clause.head.predicate == id && !clause.body.is_empty());
        if self.is_range(id) {
            let columns = predicate.columns.iter().zip(pattern);
            let values: Vec<String> = columns
                .map(|(column, value)| value.map_or("_".to_owned(), |value| self.value(value, column.base)))
                .collect();
            let (value, arguments) = values.split_last().unwrap_or((&predicate.doc, &[]));
            return format!("{value} = {}", applied(Functor::Range, arguments));
        }
        let bodies: Vec<String> = clauses
            .map(|clause| {
                let mut binding = vec![None; clause.variables.len()];
                for (term, value) in clause.head.terms.iter().zip(pattern) {
                    if let Term::Variable(variable) = term {
                        binding[variable.index()] = *value;
                    }
                }
                let written = clause
                    .body
                    .iter()
                    .filter(|literal| !matches!(literal, Literal::Guard(_)));
                let text: Vec<String> = written
                    .map(|literal| self.literal_within(clause, literal, &binding, depth + 1))
                    .collect();
                let guarded = clause.body.len() > text.len();
                format!("{}{}", text.join(", "), if guarded { " in view" } else { "" })
            })
            .collect();
        bodies.join(" or ")
    }

    /// Returns a literal under a binding. Unbound variables appear by name.
    pub fn literal(&self, clause: &Clause, literal: &Literal, binding: &[Option<Value>]) -> String {
        self.literal_within(clause, literal, binding, 0)
    }

    fn literal_within(&self, clause: &Clause, literal: &Literal, binding: &[Option<Value>], depth: usize) -> String {
        if let Some(drawn) = self.drawn(clause, literal, binding) {
            return drawn;
        }
        match literal {
            Literal::Positive(atom) | Literal::Guard(atom) => self.atom(clause, atom, binding, depth),
            Literal::Negative(atom) => format!("Not({})", self.atom(clause, atom, binding, depth)),
            Literal::Compare {
                op, left, right, base, ..
            } => {
                let left = self.term(clause, left, *base, binding);
                let right = self.term(clause, right, *base, binding);
                match op {
                    Comparison::Match | Comparison::Contains => format!("{op}({left}, {right})"),
                    Comparison::NotMatch | Comparison::NotContains => {
                        format!("Not({}({left}, {right}))", op.opposite())
                    }
                    _ => format!("{left} {op} {right}"),
                }
            }
            Literal::Compute {
                to,
                functor,
                base,
                arguments,
                ..
            } => {
                if let Some(read) = literal.field() {
                    let shape = self.symbols.resolve(read.shape).unwrap_or_default();
                    let mut fields = vec!["_".to_owned(); record::parts(shape).1.len() + 1];
                    shape.clone_into(&mut fields[0]);
                    if let Some(field) = fields.get_mut(read.at + 1) {
                        *field = self.term(clause, to, *base, binding);
                    }
                    let whole = self.term(clause, &read.record, BaseType::Record, binding);
                    return format!("{whole} = {}", applied(Functor::Pack, &fields));
                }
                let base = &|at: usize| match (functor, arguments.first()) {
                    (Functor::Pack, Some(Term::Constant(shape))) if at > 0 => {
                        let shape = self.symbols.resolve(Symbol(shape.0)).unwrap_or_default();
                        let kind = record::parts(shape).1.get(at - 1);
                        kind.map_or(BaseType::Symbol, |kind| BaseType::of_kind(*kind))
                    }
                    _ => self
                        .rules
                        .argument_base(*functor, *base, arguments, at)
                        .unwrap_or(*base),
                };
                let shown: Vec<String> = (arguments.iter().enumerate())
                    .map(|(at, term)| self.term(clause, term, base(at), binding))
                    .collect();
                let to = self.term(clause, to, self.computed_base(clause, literal), binding);
                if let (Functor::Call, Some(called)) = (functor, self.rules.called(arguments)) {
                    return format!("{to} = @{}({})", called.name, shown[1..].join(", "));
                }
                if *functor == Functor::Counter {
                    return format!("{to} = autoinc()");
                }
                format!("{to} = {}", applied(*functor, &shown))
            }
            Literal::Aggregate {
                to, op, atom, column, ..
            } => {
                let to = self.term(clause, to, self.computed_base(clause, literal), binding);
                let target = column.map(|column| (column, self.column(atom.predicate, column)));
                let rows = self.aggregated(clause, atom, binding, depth, target);
                let of = target.map_or(String::new(), |(_, name)| format!(" {name}"));
                format!("{to} = {}{of} : {{ {rows} }}", op.name())
            }
        }
    }

    /// Returns whether explanations show a literal: of the three literals of a draw only the last one.
    fn is_shown(&self, clause: &Clause, literal: usize) -> bool {
        let draw = self.rules.draw(clause);
        draw.is_none_or(|draw| !draw.literals[..2].contains(&literal))
    }

    /// Returns the words for a choice, or its comparison, in a draw: `drawn: 0.8, yes`. `None` for other literals.
    fn drawn(&self, clause: &Clause, literal: &Literal, binding: &[Option<Value>]) -> Option<String> {
        let draw = self.rules.draw(clause)?;
        let [_, choice, comparison] = draw.literals.map(|at| &clause.body[at]);
        if !std::ptr::eq(literal, choice) && !std::ptr::eq(literal, comparison) {
            return None;
        }
        let probability = &draw.probabilities[draw.alternative];
        let probability = match super::search::value(probability, binding) {
            // As it was written: 0.3, not 0.300000012.
            Some(value) => value.as_float().to_string(),
            None => self.term(clause, probability, BaseType::Float, binding),
        };
        let Literal::Compute { to, .. } = choice else {
            return None;
        };
        let chosen = super::search::value(to, binding).map(|value| value.0 as usize);
        Some(match chosen {
            Some(chosen) if chosen == draw.alternative => format!("drawn: {probability}, yes"),
            Some(_) => format!("drawn: {probability}, no"),
            None => format!("drawn: {probability}"),
        })
    }

    /// Returns the name of a column. For a hidden predicate this is the variable in its definition.
    fn column(&self, id: PredicateId, column: usize) -> &str {
        let mut clauses = self.rules.clauses.iter();
        match clauses.find(|clause| self.rules.predicates[id.index()].hidden && clause.head.predicate == id) {
            Some(clause) => match clause.head.terms[column] {
                Term::Variable(variable) => written(&clause.variables[variable.index()]),
                _ => "_",
            },
            None => &self.rules.predicates[id.index()].columns[column].name,
        }
    }

    fn atom(&self, clause: &Clause, atom: &Atom, binding: &[Option<Value>], depth: usize) -> String {
        self.aggregated(clause, atom, binding, depth, None)
    }

    /// Returns an atom whose column `target`, if any, has that name.
    fn aggregated(
        &self,
        clause: &Clause,
        atom: &Atom,
        binding: &[Option<Value>],
        depth: usize,
        target: Option<(usize, &str)>,
    ) -> String {
        let predicate = &self.rules.predicates[atom.predicate.index()];
        if is_unfolded(predicate) {
            return self.unfold(atom.predicate, &super::search::pattern(atom, binding), depth);
        }
        let columns = predicate.columns.iter().zip(&atom.terms);
        let terms: Vec<String> = (columns.enumerate())
            .map(|(index, (column, term))| match target {
                Some((target, name)) if target == index => name.to_owned(),
                _ => self.term(clause, term, column.base, binding),
            })
            .collect();
        self.named_atom(atom.predicate, &terms)
    }

    fn term(&self, clause: &Clause, term: &Term, base: BaseType, binding: &[Option<Value>]) -> String {
        match (super::search::value(term, binding), term) {
            (Some(value), _) => self.value(value, base),
            (None, Term::Variable(variable)) => written(&clause.variables[variable.index()]).to_owned(),
            (None, _) => "_".to_owned(),
        }
    }
}

/// Returns whether the definition of a hidden predicate stands for it.
fn is_unfolded(predicate: &Predicate) -> bool {
    predicate.derived && predicate.is_numbered()
}

/// Returns a functor application as text.
fn applied(functor: Functor, arguments: &[String]) -> String {
    let name = functor.name();
    match (functor, arguments) {
        (Functor::Pack, [shape, fields @ ..]) => {
            let fields = fields.join(", ");
            match record::parts(shape.trim_matches('"')).0 {
                Some(branch) => format!("${branch}({fields})"),
                None => format!("[{fields}]"),
            }
        }
        (Functor::Negate, [only]) => format!("-({only})"),
        (Functor::BitNot | Functor::Not, [only]) => format!("{name} {only}"),
        (_, [left, right]) if functor.is_infix() => format!("{left} {name} {right}"),
        _ => format!("{name}({})", arguments.join(", ")),
    }
}

/// A tree under construction.
struct Drawing<'a> {
    printer: ExplanationPrinter<'a>,
    explanation: &'a Explanation,
    printed: HashSet<NodeId>,
    /// The ancestors of the current line.
    open: Vec<NodeId>,
}

impl Drawing<'_> {
    fn node(&mut self, id: NodeId, depth: usize) -> Item {
        match self.explanation.node(id) {
            Node::Fact(fact) => {
                let pattern: Vec<Option<Value>> = fact.row.iter().copied().map(Some).collect();
                let mut item = Item::leaf(self.printer.row(fact.predicate, &pattern));
                match &fact.origin {
                    Origin::Input => {}
                    Origin::Removed => {
                        item.text = format!("{}  derived from rows that a subsumption has removed", item.text);
                    }
                    Origin::Past(tick) => {
                        item.text = format!("{}  {}", item.text, self.printer.ticks(fact.predicate, *tick));
                    }
                    Origin::Source(clause) => {
                        item.text = format!("{}  [{}]", item.text, self.printer.place(*clause));
                    }
                    Origin::Derived(derivation) => {
                        // In the present tick, the fact of a temporal operator is its operand: show it once.
                        if let [Premise::Fact(same)] = derivation.premises[..]
                            && self.printer.rules.predicates[fact.predicate.index()].hidden
                            && let Node::Fact(read) = self.explanation.node(same)
                            && self.printer.row(read.predicate, &pattern) == item.text
                        {
                            return self.node(same, depth);
                        }
                        self.below(id, depth, &mut item);
                    }
                }
                item
            }
            Node::Absence(absence) => {
                let mut item = Item::leaf(format!(
                    "Not({})",
                    self.printer.row(absence.predicate, &absence.pattern)
                ));
                self.below(id, depth, &mut item);
                item
            }
        }
    }

    /// Adds the children of a node, unless the tree already shows them or is too deep.
    fn below(&mut self, id: NodeId, depth: usize, item: &mut Item) {
        let node = self.explanation.node(id);
        let predicate = match node {
            Node::Absence(Absence {
                reason: AbsenceReason::NotAFact,
                ..
            }) => return,
            Node::Fact(fact) => fact.predicate,
            Node::Absence(absence) => absence.predicate,
        };
        if self.printer.is_range(predicate) {
            return;
        }
        if self.open.contains(&id) {
            item.text.push_str("  (circular)");
        } else if !self.printed.insert(id) {
            item.text.push_str("  (see above)");
        } else if depth == ExplanationPrinter::DEPTH_MAX {
            self.printed.remove(&id);
            item.text.push_str("  ...");
        } else {
            self.open.push(id);
            match node {
                Node::Fact(fact) => self.premises(fact, depth, item),
                Node::Absence(absence) => self.misses(absence, depth, item),
            }
            self.open.pop();
        }
    }

    fn premises(&mut self, fact: &Fact, depth: usize, item: &mut Item) {
        let Origin::Derived(derivation) = &fact.origin else {
            return;
        };
        let clause = &self.printer.rules.clauses[derivation.clause.index()];
        if !self.printer.rules.predicates[fact.predicate.index()].hidden {
            item.text = format!("{}  by {}", item.text, self.printer.title(derivation.clause));
        }
        for (at, (literal, premise)) in clause.body.iter().zip(&derivation.premises).enumerate() {
            if !self.printer.is_shown(clause, at) {
                continue;
            }
            let child = match premise {
                Premise::Fact(node) => {
                    let mut child = self.node(*node, depth + 1);
                    if matches!(literal, Literal::Guard(_)) {
                        child.text = format!("in view: {}", child.text);
                    }
                    child
                }
                Premise::Absence(node) => self.node(*node, depth + 1),
                Premise::Comparison { .. } | Premise::Computed { .. } => {
                    Item::leaf(self.printer.literal(clause, literal, &derivation.binding))
                }
            };
            item.children.push(child);
        }
    }

    fn misses(&mut self, absence: &Absence, depth: usize, item: &mut Item) {
        let predicate = &self.printer.rules.predicates[absence.predicate.index()];
        match &absence.reason {
            AbsenceReason::NotAFact => {}
            AbsenceReason::NotLookedInto => item.text.push_str("  (not looked into)"),
            AbsenceReason::NoClause(misses) if predicate.hidden => {
                for miss in misses {
                    item.children.extend(self.failures(miss, depth));
                }
            }
            AbsenceReason::NoClause(misses) => {
                item.text = format!("{}: no clause of {} holds", item.text, predicate.name);
                let bodies = |miss: &&Miss| !matches!(miss.obstacle, Obstacle::Head { .. });
                let (bodies, heads): (Vec<&Miss>, Vec<&Miss>) = misses.iter().partition(bodies);
                // The alternatives of a clause follow each other.
                let span = |miss: &Miss| self.printer.rules.clauses[miss.clause.index()].span;
                for alternatives in bodies.chunk_by(|one, other| span(one) == span(other)) {
                    let mut child = Item::leaf(self.printer.title(alternatives[0].clause));
                    let mut known = HashSet::new();
                    for miss in alternatives {
                        if known.insert(self.failing(miss)) {
                            child.children.extend(self.failures(miss, depth));
                        }
                    }
                    item.children.push(child);
                }
                item.children.extend(self.other_heads(&heads));
            }
        }
    }

    /// Returns the failing literals of a clause under the nearest binding, as text.
    fn failing(&self, miss: &Miss) -> Vec<String> {
        let clause = &self.printer.rules.clauses[miss.clause.index()];
        match &miss.obstacle {
            Obstacle::Head { .. } => Vec::new(),
            Obstacle::Excluded { by, .. } => vec![format!("excluded by {by:?}")],
            Obstacle::Body { binding, failures } => {
                let literals = failures.iter().map(|failure| &clause.body[failure.literal]);
                literals
                    .map(|literal| self.printer.literal(clause, literal, binding))
                    .collect()
            }
        }
    }

    /// Describes clauses whose heads have other values, with one line for all of a column.
    fn other_heads(&self, misses: &[&Miss]) -> Vec<Item> {
        let mut by_column: BTreeMap<usize, Vec<ClauseId>> = BTreeMap::new();
        for miss in misses {
            if let Obstacle::Head { column } = miss.obstacle {
                by_column.entry(column + 1).or_default().push(miss.clause);
            }
        }
        for clauses in by_column.values_mut() {
            // The alternatives of a clause follow each other.
            clauses.dedup_by_key(|clause| self.printer.rules.clauses[clause.index()].span);
        }
        let described = by_column.into_iter().map(|(column, clauses)| match &clauses[..] {
            [clause] => Item {
                text: self.printer.title(*clause),
                children: vec![Item::leaf(format!("its head has another value in column {column}"))],
            },
            all => {
                let place = |clause: &ClauseId| self.printer.place(*clause);
                let mut places: Vec<String> = all.iter().take(HEADS_SHOWN).map(place).collect();
                if all.len() > HEADS_SHOWN {
                    places.push("...".to_owned());
                }
                let (count, places) = (all.len(), places.join(", "));
                Item::leaf(format!(
                    "the heads of {count} clauses have another value in column {column}  [{places}]"
                ))
            }
        });
        described.collect()
    }

    fn failures(&mut self, miss: &Miss, depth: usize) -> Vec<Item> {
        let clause = &self.printer.rules.clauses[miss.clause.index()];
        let (binding, failures) = match &miss.obstacle {
            Obstacle::Head { .. } => return self.other_heads(&[miss]),
            Obstacle::Excluded { by: None, .. } => {
                let has_limit = self.printer.rules.predicates[clause.head.predicate.index()]
                    .size_limit
                    .is_some();
                let text = match has_limit {
                    true => "the recursion had ended at its limit of rows",
                    false => "a row that no longer holds excluded it",
                };
                return vec![Item::leaf(text.to_owned())];
            }
            Obstacle::Excluded { by: Some(by), .. } => {
                let text = match self.explanation.node(*by) {
                    Node::Fact(fact) => {
                        let row: Vec<Option<Value>> = fact.row.iter().copied().map(Some).collect();
                        self.printer.row(fact.predicate, &row)
                    }
                    Node::Absence(_) => "another row".to_owned(),
                };
                let mut item = Item::leaf(format!("{text} holds instead"));
                item.children.push(self.node(*by, depth + 1));
                return vec![item];
            }
            Obstacle::Body { binding, failures } => (binding, failures),
        };
        // An expression that occurs twice fails twice.
        let (mut known, open) = (HashSet::new(), vec![None; binding.len()]);
        let written = |failure: &Failure| self.printer.literal(clause, &clause.body[failure.literal], &open);
        let failures: Vec<&Failure> = (failures.iter())
            .filter(|failure| known.insert(written(failure)))
            .collect();
        let in_head = |name: &str| {
            (clause.head.terms.iter())
                .any(|term| matches!(term, Term::Variable(variable) if clause.variables[variable.index()] == name))
        };
        let nearest: IndexSet<String> = (self.printer.named(clause, binding))
            .filter(|(name, ..)| !in_head(name))
            .map(|(name, value, base)| format!("{name} = {}", self.printer.value(value, base)))
            .collect();
        let nearest: Vec<String> = nearest.into_iter().collect();
        let nearest = if nearest.is_empty() {
            String::new()
        } else {
            format!("nearest {}", nearest.join(", "))
        };
        // A single failure stands on the line of its binding, several stand below it.
        let inline = if nearest.is_empty() || failures.len() > 1 {
            String::new()
        } else {
            format!("{nearest}: ")
        };
        let items: Vec<Item> = (failures.iter())
            .map(|failure| {
                let literal = &clause.body[failure.literal];
                let text = self.printer.literal(clause, literal, binding);
                let drawn = self.printer.drawn(clause, literal, binding);
                let (text, node) = match (&failure.kind, literal) {
                    _ if drawn.is_some() => (text, None),
                    (FailureKind::Absent(node), Literal::Guard(_)) => (format!("not in view: {text}"), Some(*node)),
                    (FailureKind::Absent(node), _) => (format!("{text} does not hold"), Some(*node)),
                    (FailureKind::AbsentTwice, _) => (format!("{text} does not hold"), None),
                    (FailureKind::Holds(node), _) => (format!("{text} fails"), Some(*node)),
                    (FailureKind::Comparison { .. }, _) => (format!("{text} fails"), None),
                    (FailureKind::Computed { value: None }, _) => (format!("{text} fails: it has no value"), None),
                    (FailureKind::Computed { value: Some(value) }, _) => {
                        let base = self.printer.computed_base(clause, literal);
                        (
                            format!("{text} fails: it is {}", self.printer.value(*value, base)),
                            None,
                        )
                    }
                };
                let mut item = Item::leaf(format!("{inline}{text}"));
                if let Some(id) = node {
                    match self.explanation.node(id) {
                        // The line states it already.
                        Node::Absence(Absence { reason, .. }) => match reason {
                            AbsenceReason::NoClause(_) => self.below_absence(id, depth, &mut item),
                            AbsenceReason::NotAFact | AbsenceReason::NotLookedInto => {}
                        },
                        Node::Fact(Fact {
                            origin: Origin::Input, ..
                        }) => {}
                        Node::Fact(Fact {
                            predicate,
                            origin: Origin::Past(tick),
                            ..
                        }) => item.text = format!("{}  {}", item.text, self.printer.ticks(*predicate, *tick)),
                        Node::Fact(_) => item.children.push(self.node(id, depth + 1)),
                    }
                }
                item
            })
            .collect();
        if nearest.is_empty() || items.len() == 1 {
            items
        } else {
            vec![Item {
                text: nearest,
                children: items,
            }]
        }
    }

    /// Adds the reasons why a positive literal does not hold below its line.
    fn below_absence(&mut self, id: NodeId, depth: usize, item: &mut Item) {
        let mut inner = self.node(id, depth + 1);
        if inner.children.is_empty() {
            if let Some((_, remark)) = inner.text.split_once("  ") {
                item.text = format!("{}  {remark}", item.text);
            }
        } else {
            item.children.append(&mut inner.children);
        }
    }
}
