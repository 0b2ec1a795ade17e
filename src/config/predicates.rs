//! Reads the base predicates of a configuration, and the concepts that they define.

use crate::city::{Action, AgentKind, KindTable, OwnLook};
use crate::config::kinds::of_own_kind;
use crate::config::looks::of_concept;
use crate::config::model::*;
use crate::diag::{self, Diagnostic, MAX_FAULTS, Span, did_you_mean, listed};
use crate::located::Located;
use crate::predicate::{Concept, Definition, Sees};
use crate::yaml::YamlNode;
use crate::yaml::codes;
use crate::yaml::read::{Fields, is_name, list, name, present};
use std::collections::HashMap;

/// The maximum number of base predicates of a scenario.
const MAX_PREDICATES: usize = 1000;
/// The predicate of the field of view. It is always defined, so configurations cannot define it.
pub const SEES: &str = "Sees";

/// The base predicates of a configuration.
pub(super) struct Predicates {
    pub used: Vec<PredicateConfig>,
    /// All definitions, used or not.
    defined: Vec<PredicateConfig>,
    /// The looks of concepts.
    pub looks: Vec<Located<OwnLook>>,
}

pub(super) fn predicates(node: &YamlNode, kinds: &KindTable, faults: &mut Vec<Diagnostic>) -> Option<Predicates> {
    let before = faults.len();
    let mut fields = Fields::open(node, "the predicates", faults)?;
    fields.hint(|key| Some(format!("definitions stand under `define`: `define: {{{key}: ...}}`")));
    fields.optional("base");
    let define = fields.required("define", faults);
    let selection = fields.optional("use");
    fields.close(faults);
    let entries = present(define?, "definitions of predicates", "predicate", &[], faults)?;
    if entries.len() > MAX_PREDICATES {
        let message = format!(
            "{} predicates are defined, the limit is {MAX_PREDICATES}",
            entries.len()
        );
        faults.push(Diagnostic::new(diag::codes::LIMIT_EXCEEDED, message).at(define?.span, ""));
        return None;
    }
    let (mut defined, mut looks) = (Vec::new(), Vec::new());
    for (key, node) in entries {
        let fault = if key.text == SEES {
            Some(format!("`{SEES}` is predefined: it is the field of view"))
        } else if Action::STANDARD.iter().any(|action| action.name() == key.text) {
            Some(format!("`{}` is an action, which rules derive", key.text))
        } else if !is_name(&key.text) {
            let message = "expected the name of a predicate (letters, digits and `_`, no digit first)";
            Some(format!("{message}, found `{}`", key.text))
        } else {
            None
        };
        if let Some(message) = fault {
            faults.push(Diagnostic::new(codes::INVALID_VALUE, message).at(key.span, ""));
            continue;
        }
        let name = Located {
            value: key.text.clone(),
            span: key.span,
        };
        let definition = of_own_kind(node, kinds, faults).unwrap_or_else(|| definition_of(node, faults));
        looks.extend(
            definition
                .as_ref()
                .and_then(|definition| of_concept(node, definition, faults)),
        );
        defined.extend(definition.map(|definition| PredicateConfig { name, definition }));
    }
    let used = match selection {
        None => Some(defined.clone()),
        // The names that the base defines are unknown.
        Some(_) if define?.partial => None,
        Some(node) => selected(node, &defined, faults),
    };
    // A failed definition, or one of the missing base, would make each use of it a second fault.
    if faults.len() > before || node.partial {
        return None;
    }
    let mut used = used?;
    used.push(PredicateConfig {
        name: Located {
            value: SEES.into(),
            span: node.span,
        },
        definition: Sees.into(),
    });
    Some(Predicates { used, defined, looks })
}

/// Reads a definition. Drops the faults after the last unknown key, which it may have caused.
fn definition_of(node: &YamlNode, faults: &mut Vec<Diagnostic>) -> Option<Definition> {
    let before = faults.len();
    let definition = Definition::read(node, faults);
    let is_unknown = |fault: &Diagnostic| fault.code == codes::UNKNOWN_KEY;
    if let Some(last) = faults[before..].iter().rposition(is_unknown) {
        faults.truncate(before + last + 1);
    }
    definition
}

/// Returns the predicates that `use` names, in its order.
fn selected(
    node: &YamlNode,
    defined: &[PredicateConfig],
    faults: &mut Vec<Diagnostic>,
) -> Option<Vec<PredicateConfig>> {
    let mut used: Vec<PredicateConfig> = Vec::new();
    for item in list(node, "names of predicates", faults)? {
        let Some(wanted) = name(item, "the name of a predicate", faults) else {
            continue;
        };
        if let Some(first) = used.iter().find(|predicate| predicate.name.value == wanted) {
            let fault = Diagnostic::new(codes::INVALID_VALUE, format!("`{wanted}` is used twice"));
            faults.push(
                fault
                    .at(item.span, "used again")
                    .also(first.name.span, "first used here"),
            );
            continue;
        }
        match defined.iter().find(|predicate| predicate.name.value == wanted) {
            Some(predicate) => used.push(PredicateConfig {
                name: Located {
                    value: wanted.to_owned(),
                    span: item.span,
                },
                definition: predicate.definition.clone(),
            }),
            None => {
                let mut fault = Diagnostic::new(codes::INVALID_VALUE, format!("no predicate `{wanted}` is defined"));
                let names = defined.iter().map(|predicate| predicate.name.value.as_str());
                if wanted == SEES {
                    fault = fault.help(format!("remove it: `{SEES}` is predefined"));
                } else if let Some(near) = did_you_mean(wanted, names) {
                    fault = fault.did_you_mean(near, &[item.span]);
                }
                faults.push(fault.at(item.span, ""));
            }
        }
        if faults.len() > MAX_FAULTS {
            return None;
        }
    }
    Some(used)
}

impl Predicates {
    /// Returns the definition of a predicate, used or not.
    pub fn definition(&self, name: &str) -> Option<&PredicateConfig> {
        self.defined.iter().find(|predicate| predicate.name.value == name)
    }
}

/// Reports kinds with the name of a concept.
pub(super) fn check_kinds(kinds: &KindTable, predicates: &Predicates, faults: &mut Vec<Diagnostic>) {
    for own in kinds.own() {
        let name = own.name.value.as_str();
        let same = predicates.used.iter().find(|predicate| {
            let concept = predicate.definition.concept();
            concept.is_some_and(|concept| !concept.is_kind && concept.concept == name)
        });
        if let Some(same) = same {
            let message = format!("`{name}` is both a kind of agents and a concept");
            let fault = Diagnostic::new(codes::INVALID_VALUE, message).at(own.name.span, "a kind");
            let help = format!("write `{{kind: {name}}}` for the agents of the kind, or rename the concept");
            faults.push(fault.also(same.name.span, "its concept has this name").help(help));
        }
    }
}

/// The concepts that agents can carry.
pub(super) struct Concepts<'p> {
    used: HashMap<&'p str, Vec<AgentKind>>,
    predicates: &'p Predicates,
}

impl<'p> Concepts<'p> {
    pub fn new(predicates: &'p Predicates) -> Self {
        let mut used: HashMap<&str, Vec<AgentKind>> = HashMap::new();
        for predicate in &predicates.used {
            if let Some(Concept {
                of,
                concept,
                is_kind: false,
            }) = predicate.definition.concept()
            {
                used.entry(concept).or_default().push(*of);
            }
        }
        Concepts { used, predicates }
    }

    fn check(&self, concept: &str, span: Span, kind: AgentKind, faults: &mut Vec<Diagnostic>) {
        let kinds = self.used.get(concept);
        if kinds.is_some_and(|kinds| kinds.contains(&kind)) {
            return;
        }
        let carried = |predicate: &&PredicateConfig| {
            let defined = predicate.definition.concept();
            defined.is_some_and(|defined| defined.of == kind && defined.concept == concept && !defined.is_kind)
        };
        let fault = if kinds.is_some() {
            let other = if kind == AgentKind::Car { "pedestrians" } else { "cars" };
            Diagnostic::new(
                codes::INVALID_VALUE,
                format!("`{concept}` is a concept of {other} only"),
            )
            .at(span, "")
        } else if let Some(unused) = self.predicates.defined.iter().find(carried) {
            let predicate = &unused.name.value;
            Diagnostic::new(
                codes::INVALID_VALUE,
                format!("no predicate in use defines the concept `{concept}`"),
            )
            .at(span, "")
            .help(format!("add `{predicate}` to the predicates' `use`"))
        } else {
            let fault = Diagnostic::new(codes::INVALID_VALUE, format!("unknown concept `{concept}`")).at(span, "");
            let mut known: Vec<_> = self
                .used
                .iter()
                .filter(|(_, kinds)| kinds.contains(&kind))
                .map(|(&name, _)| name)
                .collect();
            known.sort_unstable();
            match did_you_mean(concept, known.iter().copied()) {
                Some(near) => fault.help(format!("did you mean `{near}`?")),
                None => fault.help("a predicate defines it, for example `IsTaxi: {concept: taxi, of: Car}`"),
            }
            .note(format!(
                "concepts of a {}: {}",
                kind.name().to_lowercase(),
                listed(&known)
            ))
        };
        faults.push(fault);
    }
}

/// Reads the concepts of one entry of an agent list.
pub(super) fn carried(
    node: &YamlNode,
    kind: AgentKind,
    known: Option<&Concepts<'_>>,
    faults: &mut Vec<Diagnostic>,
) -> Option<Vec<Located<String>>> {
    let items = list(node, "concepts", faults)?;
    if items.len() > MAX_PREDICATES {
        let message = format!("{} concepts, the limit is {MAX_PREDICATES}", items.len());
        faults.push(Diagnostic::new(diag::codes::LIMIT_EXCEEDED, message).at(node.span, ""));
        return None;
    }
    let mut concepts: Vec<Located<String>> = Vec::new();
    for item in items {
        let Some(concept) = name(item, "the name of a concept", faults) else {
            continue;
        };
        if let Some(first) = concepts.iter().find(|given| given.value == concept) {
            let fault = Diagnostic::new(codes::INVALID_VALUE, format!("the concept `{concept}` is given twice"));
            faults.push(fault.at(item.span, "given again").also(first.span, "first given here"));
            continue;
        }
        if let Some(known) = known {
            known.check(concept, item.span, kind, faults);
        }
        let (value, span) = (concept.to_owned(), item.span);
        concepts.push(Located { value, span });
    }
    Some(concepts)
}
