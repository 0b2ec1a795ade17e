//! `{concept: taxi, of: Car}`: the agent is of this kind and carries this concept.

use crate::city::AgentKind;
use crate::predicate::{Definition, Phrase, PredicateKind, Static, StaticKind, Syntax, kind};
use crate::yaml::read::name;
use serde::Serialize;

/// The agent is of this kind and carries this concept.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Concept {
    /// The kind of agents that can carry the concept.
    pub of: AgentKind,
    /// The name in agent sets and scenes.
    pub concept: String,
    /// Whether it is the name of a kind that the configuration defines, which `{kind: ...}` tests.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub is_kind: bool,
}

impl PredicateKind for Concept {
    const SYNTAX: Syntax = Syntax::Keys(&["concept", "of"], |nodes, faults| {
        let concept = name(nodes[0], "the name of a concept", faults).map(str::to_owned);
        let before = faults.len();
        let of = kind::read(nodes[1], faults);
        for fault in &mut faults[before..] {
            let help = "for agents of your own kind, write what the kind is `of`, `Car` or `Pedestrian`; a test for the \
                        kind itself is `{kind: NAME}`";
            fault.help.push(help.to_owned());
        }
        let (concept, of) = (concept?, of?);
        let is_kind = false;
        Some(Concept { of, concept, is_kind }.into())
    });

    fn phrase(&self) -> Phrase {
        match (self.of, self.concept.as_str()) {
            (AgentKind::Car, "ambulance") => Phrase::new("is an ambulance"),
            (AgentKind::Car, "bus") => Phrase::new("is a bus"),
            (AgentKind::Car, "police") => Phrase::new("is a police car"),
            (AgentKind::Car, "tiro") => Phrase::new("has a beginner at the wheel"),
            (AgentKind::Car, "reckless") => Phrase::new("is driven recklessly"),
            (AgentKind::Pedestrian, "old") => Phrase::new("is old"),
            (AgentKind::Pedestrian, "young") => Phrase::new("is young"),
            (_, kind) if self.is_kind => Phrase::new(format!("is a {kind}")),
            (_, concept) => Phrase::new(format!("has the property {concept}")),
        }
    }

    #[cfg(test)]
    fn samples() -> Vec<Definition> {
        let concept = |of| Concept {
            of,
            concept: "old".into(),
            is_kind: false,
        };
        AgentKind::ALL.map(|of| concept(of).into()).into()
    }
}

impl StaticKind for Concept {
    fn holds(&self, kind: AgentKind, concepts: &[String]) -> bool {
        kind == self.of && concepts.contains(&self.concept)
    }
}

impl Definition {
    /// Returns the concept that the predicate tests, if it tests one.
    pub fn concept(&self) -> Option<&Concept> {
        match self {
            Definition::Static(Static::Concept(concept)) => Some(concept),
            _ => None,
        }
    }
}
