//! The five cases: programs in the core language with their facts, which depend on this file alone.

#![allow(dead_code, reason = "each binary uses its own part")]

use std::fmt;

/// A program with facts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Case {
    /// Transitive closure of a random graph: 2,000 nodes, 6,000 edges
    Random,
    /// Transitive closure of a chain of 2,000 nodes
    Chain,
    /// Same generation on a tree of 4,000 nodes
    Generation,
    /// Andersen's points-to analysis of 3,000 variables
    Pointsto,
    /// The expert rules over a city of 10,000 agents
    City,
}

impl fmt::Display for Case {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Case::Random => "random",
            Case::Chain => "chain",
            Case::Generation => "generation",
            Case::Pointsto => "pointsto",
            Case::City => "city",
        })
    }
}

/// A pair of numbers.
pub type Pair = (u32, u32);

/// The changes of each predicate: pairs, and whether they are inserted or retracted.
pub type Changes = Vec<(&'static str, Vec<(Pair, bool)>)>;

/// The base facts of a case, by the name of the predicate.
#[derive(Default)]
pub struct Facts {
    pub unary: Vec<(&'static str, Vec<u32>)>,
    pub binary: Vec<(&'static str, Vec<Pair>)>,
}

impl Facts {
    /// The rows of a predicate of one column.
    pub fn unary(&self, name: &str) -> &[u32] {
        let found = self.unary.iter().find(|(other, _)| *other == name);
        &found.expect("the case has the predicate").1
    }

    /// The rows of a predicate of two columns.
    pub fn binary(&self, name: &str) -> &[Pair] {
        let found = self.binary.iter().find(|(other, _)| *other == name);
        &found.expect("the case has the predicate").1
    }
}

impl Case {
    /// All cases, in the order of the table.
    pub const ALL: [Case; 5] = [Case::Random, Case::Chain, Case::Generation, Case::Pointsto, Case::City];

    /// Its name in the table.
    pub fn title(self) -> &'static str {
        match self {
            Case::Random => "TC random",
            Case::Chain => "TC chain",
            Case::Generation => "same gen.",
            Case::Pointsto => "points-to",
            Case::City => "city",
        }
    }

    /// The program.
    pub fn program(self) -> &'static str {
        match self {
            Case::Random | Case::Chain => include_str!("../programs/closure.dl"),
            Case::Generation => include_str!("../programs/generation.dl"),
            Case::Pointsto => include_str!("../programs/pointsto.dl"),
            Case::City => include_str!("../programs/city.dl"),
        }
    }

    /// The counted predicates, in the order of the program.
    pub fn derived(self) -> &'static [&'static str] {
        match self {
            Case::Random | Case::Chain => &["Path"],
            Case::Generation => &["Same"],
            Case::Pointsto => &["PointsTo"],
            Case::City => &["Stop", "Slow", "Fast", "Normal"],
        }
    }

    /// The base facts, the same in every run.
    pub fn facts(self) -> Facts {
        let mut random = generator(1 + self as u64);
        let mut below = |bound: u32| random() % bound;
        let mut facts = Facts::default();
        match self {
            Case::Random => {
                let edges = (0..6_000).map(|_| (below(2_000), below(2_000)));
                facts.binary.push(("Edge", distinct(edges)));
            }
            Case::Chain => facts
                .binary
                .push(("Edge", (1..2_000).map(|node| (node - 1, node)).collect())),
            Case::Generation => {
                let parents = (1..4_000u32).map(|child| (child, below(child)));
                facts.binary.push(("Parent", distinct(parents)));
            }
            Case::Pointsto => {
                for (name, count) in [("AddressOf", 1_500), ("Assign", 3_000), ("Load", 200), ("Store", 200)] {
                    let pairs = (0..count).map(|_| (below(3_000), below(3_000)));
                    facts.binary.push((name, distinct(pairs)));
                }
            }
            Case::City => city(&mut facts, 10_000, &mut below),
        }
        facts
    }
}

/// Agents that see few others, all of them near. Near agents have near numbers.
pub fn city(facts: &mut Facts, agents: u32, below: &mut impl FnMut(u32) -> u32) {
    const UNARY: [&str; 11] = [
        "IsPedestrian",
        "IsCar",
        "IsAmbulance",
        "IsBus",
        "IsPolice",
        "IsTiro",
        "IsReckless",
        "IsOld",
        "IsYoung",
        "IsAtInter",
        "IsInInter",
    ];
    const BINARY: [&str; 6] = ["IsClose", "NextTo", "HigherPri", "CollidingClose", "LeftOf", "RightOf"];
    for name in UNARY {
        facts
            .unary
            .push((name, (0..agents).filter(|_| below(4) == 0).collect()));
    }
    let mut seen: Vec<Pair> = (0..agents).map(|agent| (agent, agent)).collect();
    for agent in 0..agents {
        seen.extend((0..14).map(|_| (agent, (agent + 1 + below(60)) % agents)));
    }
    let seen = distinct(seen.into_iter());
    for name in BINARY {
        let related = seen.iter().copied().filter(|(x, y)| x != y && below(6) == 0);
        facts.binary.push((name, related.collect()));
    }
    facts.binary.push(("Sees", seen));
}

fn distinct(pairs: impl Iterator<Item = Pair>) -> Vec<Pair> {
    let mut pairs: Vec<Pair> = pairs.collect();
    pairs.sort_unstable();
    pairs.dedup();
    pairs
}

/// A linear congruential generator with a fixed seed.
pub fn generator(seed: u64) -> impl FnMut() -> u32 {
    let mut state = seed;
    move || {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as u32
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine;

    #[test]
    fn the_city_has_the_expert_rules() {
        let facts = Case::City.facts();
        let expert = engine::counts(".include \"expert.dl\"", &facts, Case::City.derived());
        assert_eq!(
            engine::counts(Case::City.program(), &facts, Case::City.derived()),
            expert
        );
    }

    #[test]
    fn facts_are_unchanged() {
        for case in Case::ALL {
            let facts = case.facts();
            let sizes: Vec<usize> = (facts.unary.iter().map(|(_, rows)| rows.len()))
                .chain(facts.binary.iter().map(|(_, rows)| rows.len()))
                .collect();
            assert!(sizes.iter().all(|&size| size > 0), "{case}: {sizes:?}");
        }
    }
}
