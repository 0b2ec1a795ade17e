//! `{kind: Car}`: the agent is of this kind.

use crate::city::AgentKind;
use crate::diag::Diagnostic;
#[cfg(test)]
use crate::predicate::Definition;
use crate::predicate::{Phrase, PredicateKind, StaticKind, Syntax};
use crate::yaml::YamlNode;
use crate::yaml::read::choice;
use serde::Serialize;

/// The agent is of this kind.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Kind(pub AgentKind);

impl PredicateKind for Kind {
    const SYNTAX: Syntax = Syntax::Keys(&["kind"], |nodes, faults| Some(Kind(read(nodes[0], faults)?).into()));

    fn phrase(&self) -> Phrase {
        let phrase = match self.0 {
            AgentKind::Car => Phrase::new("is a car"),
            AgentKind::Pedestrian => Phrase::new("is a pedestrian"),
        };
        Phrase {
            noun: Some(self.0.name()),
            ..phrase
        }
    }

    #[cfg(test)]
    fn samples() -> Vec<Definition> {
        AgentKind::ALL.map(|kind| Kind(kind).into()).into()
    }
}

impl StaticKind for Kind {
    fn holds(&self, kind: AgentKind, _concepts: &[String]) -> bool {
        kind == self.0
    }
}

/// Parses a kind of agent.
pub(super) fn read(node: &YamlNode, faults: &mut Vec<Diagnostic>) -> Option<AgentKind> {
    choice(node, &AgentKind::ALL.map(|kind| (kind.name(), kind)), faults)
}
