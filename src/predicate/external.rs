//! `{external: agent}`: a function of the caller decides in each tick for which agents the predicate holds.

#[cfg(test)]
use crate::predicate::Definition;
use crate::predicate::{Phrase, PredicateKind, Syntax};
use crate::yaml::read::choice;
use serde::{Serialize, Serializer};

/// A predicate whose facts the caller provides, see `ExternalPredicates` of [`sim`](crate::sim).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum External {
    /// About one agent.
    Agent,
    /// About two agents, which may be the same one.
    Pair,
}

impl External {
    /// All external predicates.
    pub const ALL: [External; 2] = [External::Agent, External::Pair];

    /// Returns the name in a configuration.
    pub const fn name(self) -> &'static str {
        match self {
            External::Agent => "agent",
            External::Pair => "pair",
        }
    }

    /// Returns the number of agents that the predicate relates.
    pub const fn agents(self) -> usize {
        match self {
            External::Agent => 1,
            External::Pair => 2,
        }
    }
}

impl Serialize for External {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.name())
    }
}

impl PredicateKind for External {
    const SYNTAX: Syntax = Syntax::Keys(&["external"], |nodes, faults| {
        let choices = External::ALL.map(|external| (external.name(), external));
        choice(nodes[0], &choices, faults).map(External::into)
    });

    fn phrase(&self) -> Phrase {
        Phrase::new(match self {
            External::Agent => "is chosen by a function of the caller",
            External::Pair => "is related by a function of the caller to",
        })
    }

    #[cfg(test)]
    fn samples() -> Vec<Definition> {
        External::ALL.map(Definition::External).to_vec()
    }
}
