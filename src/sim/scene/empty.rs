//! Warnings of base predicates that never hold in a city although clauses read them.

use crate::city::AgentKind;
use crate::config::{PredicateConfig, Scenario};
use crate::datalog::{Literal, PredicateId, Rules};
use crate::diag::{Diagnostic, Span};
use crate::predicate::{Concept, Definition, Kind, Static};
use crate::sim::codes;
use std::collections::{BTreeSet, HashMap};

/// The maximum number of literals that one warning shows.
const SHOWN_MAX: usize = 6;

/// A literal that an empty predicate concerns, and what follows for it.
type Label = (Span, String);

/// Warns of the predicates `empty`, with the literals that read them and the clauses that never fire for this reason.
pub(super) fn empty_predicates(rules: &Rules, scenario: &Scenario, empty: &[PredicateId]) -> Vec<Diagnostic> {
    let configs = scenario.predicates.iter();
    let configs: HashMap<&str, &PredicateConfig> = configs.map(|config| (config.name.value.as_str(), config)).collect();
    let labels = labels(rules, empty);
    let warnings = empty.iter().zip(labels).filter_map(|(predicate, labels)| {
        let config = configs.get(rules.predicates[predicate.index()].name.as_str())?;
        warning(scenario, config, &labels)
    });
    warnings.collect()
}

/// Returns the labels of each of the predicates `empty`, those of literals that read it first.
fn labels(rules: &Rules, empty: &[PredicateId]) -> Vec<Vec<Label>> {
    let mut spread = Spread::new(rules, empty);
    let is_hidden = |predicate: PredicateId| rules.predicates[predicate.index()].hidden;
    let given: BTreeSet<PredicateId> = empty.iter().copied().collect();
    let mut labels: Vec<Vec<Label>> = empty
        .iter()
        .map(|&predicate| direct(rules, spread.readers(predicate)))
        .collect();
    while let Some((predicate, cause)) = spread.next() {
        if given.contains(&predicate) {
            continue;
        }
        for &(clause, literal) in spread.readers(predicate) {
            let clause = &rules.clauses[clause];
            let Literal::Positive(atom) = &clause.body[literal] else {
                continue;
            };
            if is_hidden(clause.head.predicate) {
                continue;
            }
            labels[cause].push((
                atom.span,
                match is_hidden(predicate) {
                    true => "so this clause never fires".to_owned(),
                    false => {
                        let name = &rules.predicates[predicate.index()].name;
                        format!("nor does this one: `{name}` has no rows")
                    }
                },
            ));
        }
    }
    for list in &mut labels {
        let mut seen = BTreeSet::new();
        list.retain(|(span, _)| seen.insert(*span));
    }
    labels
}

/// Returns the labels of literals that read an empty predicate.
fn direct(rules: &Rules, readers: &[(usize, usize)]) -> Vec<Label> {
    let label = |&(clause, literal): &(usize, usize)| {
        let clause = &rules.clauses[clause];
        let is_hidden = rules.predicates[clause.head.predicate.index()].hidden;
        let literal = &clause.body[literal];
        let label = match literal {
            Literal::Positive(_) if !is_hidden => "so this clause never fires",
            Literal::Negative(_) => "so this always holds",
            _ => "so this finds nothing",
        };
        Some((literal.atom()?.span, label.to_owned()))
    };
    readers.iter().filter_map(label).collect()
}

/// The spread of emptiness: a derived predicate has no rows if each of its clauses needs a row of an empty predicate.
struct Spread<'r> {
    rules: &'r Rules,
    /// By predicate: the literals that read it, as positions of a clause and of a literal in it.
    readers: Vec<Vec<(usize, usize)>>,
    /// By predicate: the number of its clauses that may fire.
    firing: Vec<usize>,
    /// By clause: whether it never fires.
    never: Vec<bool>,
    /// The predicates found empty, each with the position of the given one that is its last cause.
    open: BTreeSet<(PredicateId, usize)>,
}

impl<'r> Spread<'r> {
    fn new(rules: &'r Rules, empty: &[PredicateId]) -> Spread<'r> {
        let mut readers = vec![Vec::new(); rules.predicates.len()];
        let mut firing = vec![0; rules.predicates.len()];
        for (at, clause) in rules.clauses.iter().enumerate() {
            firing[clause.head.predicate.index()] += 1;
            for (position, literal) in clause.body.iter().enumerate() {
                if let Some(atom) = literal.atom() {
                    readers[atom.predicate.index()].push((at, position));
                }
            }
        }
        Spread {
            rules,
            readers,
            firing,
            never: vec![false; rules.clauses.len()],
            open: empty.iter().copied().zip(0..).collect(),
        }
    }

    fn readers(&self, predicate: PredicateId) -> &[(usize, usize)] {
        &self.readers[predicate.index()]
    }

    /// Returns the next empty predicate and its cause, and finds those that are empty because of it.
    fn next(&mut self) -> Option<(PredicateId, usize)> {
        let (predicate, cause) = self.open.pop_first()?;
        for &(clause, literal) in &self.readers[predicate.index()] {
            let (Literal::Positive(_) | Literal::Guard(_)) = self.rules.clauses[clause].body[literal] else {
                continue;
            };
            if std::mem::replace(&mut self.never[clause], true) {
                continue;
            }
            let head = self.rules.clauses[clause].head.predicate;
            self.firing[head.index()] -= 1;
            if self.firing[head.index()] == 0 && !self.rules.predicates[head.index()].input {
                self.open.insert((head, cause));
            }
        }
        Some((predicate, cause))
    }
}

/// Returns the warning of an empty predicate, unless no literal is concerned.
fn warning(scenario: &Scenario, config: &PredicateConfig, labels: &[Label]) -> Option<Diagnostic> {
    let ((span, label), rest) = labels.split_first()?;
    let name = &config.name.value;
    let message = format!(
        "`{name}` never holds in `{}`: {}",
        scenario.name,
        reason(&config.definition)
    );
    let mut fault = Diagnostic::new(codes::EMPTY_PREDICATE, message).at(*span, label.clone());
    for (span, label) in rest.iter().take(SHOWN_MAX - 1) {
        fault = fault.also(*span, label.clone());
    }
    if labels.len() > SHOWN_MAX {
        fault = fault.note(format!("{} further literals are affected", labels.len() - SHOWN_MAX));
    }
    fault = fault.also(config.name.span, format!("`{name}` is defined here"));
    Some(match &config.definition {
        Definition::Static(Static::Concept(Concept {
            concept, is_kind: true, ..
        })) => fault.help(format!(
            "add agents of the kind to a split: `{concept}: [{{count: 1, priority: 1}}]`"
        )),
        Definition::Static(Static::Concept(Concept { concept, .. })) => {
            fault.help(format!("give agents the concept: `concepts: [{concept}]`"))
        }
        _ => fault,
    })
}

/// Explains why a predicate with this definition has no rows.
fn reason(definition: &Definition) -> String {
    match definition {
        Definition::Static(Static::Kind(Kind(AgentKind::Car))) => "no agent is a car".to_owned(),
        Definition::Static(Static::Kind(Kind(AgentKind::Pedestrian))) => "no agent is a pedestrian".to_owned(),
        Definition::Static(Static::Concept(Concept {
            concept, is_kind: true, ..
        })) => format!("no agent has the kind `{concept}`"),
        Definition::Static(Static::Concept(Concept { of, concept, .. })) => {
            format!("no {} has the concept `{concept}`", of.name().to_lowercase())
        }
        definition if definition.needs_roads() => "only a road network has it, and the map has blocks".to_owned(),
        _ => "there is no such situation in this city".to_owned(),
    }
}
