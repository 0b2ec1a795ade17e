//! `{kind: Car}`: the agent is of this kind.

use crate::city::AgentKind;
use crate::config::read::choice;
use crate::config::yaml::Node;
use crate::diag::Diagnostic;
#[cfg(test)]
use crate::predicate::Definition;
use crate::predicate::{PredicateKind, StaticKind, Syntax};
use serde::Serialize;

/// The agent is of this kind.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Kind(pub AgentKind);

impl PredicateKind for Kind {
    const SYNTAX: Syntax = Syntax::Keys(&["kind"], |nodes, faults| Some(Kind(read(nodes[0], faults)?).into()));

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
pub(super) fn read(node: &Node, faults: &mut Vec<Diagnostic>) -> Option<AgentKind> {
    choice(node, &AgentKind::ALL.map(|kind| (kind.name(), kind)), faults)
}
