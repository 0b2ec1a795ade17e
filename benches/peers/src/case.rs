//! The cases: programs in the core language with their facts, which depend on this file alone.

#![allow(dead_code, reason = "each binary uses its own part")]

use std::collections::{BTreeSet, HashSet};
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
    /// Transitive closure of a random graph: 5,000 nodes, 25,000 edges
    Closure5000,
    /// Transitive closure of a random graph: 10,000 nodes, 100,000 edges
    Closure10000,
    /// Transitive closure of a random graph: 20,000 nodes, 400,000 edges
    Closure20000,
    /// Same generation on a random graph: 5,000 nodes, 25,000 edges
    Generation5000,
    /// Same generation on a random graph: 10,000 nodes, 100,000 edges
    Generation10000,
    /// Nodes that are reachable from one: 1,000,000 nodes, 5,000,000 edges
    Reach,
    /// Triangles of a star of 1,000,000 leaves, which are also a chain
    Triangles,
    /// Context-sensitive points-to analysis of 60,000 variables in functions of 60
    Cspa,
    /// Context-sensitive dataflow analysis: 500 sources in a control-flow graph of 50,000 points
    Csda,
    /// Andersen's points-to analysis of 10,000 variables
    Andersen,
    /// Completion of an EL ontology of 100,000 concepts
    El,
}

/// A program, whose facts differ by case.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    Closure,
    Generation,
    Pointsto,
    City,
    Reach,
    Triangles,
    Cspa,
    Csda,
    El,
}

impl fmt::Display for Case {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&name(*self))
    }
}

/// The name of a value on the command line.
pub fn name(value: impl clap::ValueEnum) -> String {
    let value = value.to_possible_value().expect("no value is left out");
    value.get_name().to_owned()
}

/// A pair of numbers.
pub type Pair = (u32, u32);

/// The changes of each predicate: pairs, and whether they are inserted or retracted.
pub type Changes = Vec<(&'static str, Vec<(Pair, bool)>)>;

/// The base facts of a case, by the name of the predicate.
#[derive(Default, PartialEq)]
pub struct Facts {
    pub unary: Vec<(&'static str, Vec<u32>)>,
    pub binary: Vec<(&'static str, Vec<Pair>)>,
    pub ternary: Vec<(&'static str, Vec<[u32; 3]>)>,
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

    /// The rows of a predicate of three columns.
    pub fn ternary(&self, name: &str) -> &[[u32; 3]] {
        let found = self.ternary.iter().find(|(other, _)| *other == name);
        &found.expect("the case has the predicate").1
    }
}

impl Case {
    /// The cases of the table of all peers, in its order.
    pub const SMALL: [Case; 5] = [Case::Random, Case::Chain, Case::Generation, Case::Pointsto, Case::City];

    /// The cases of the suite, in its order.
    pub const SUITE: [Case; 11] = [
        Case::Closure5000,
        Case::Closure10000,
        Case::Closure20000,
        Case::Generation5000,
        Case::Generation10000,
        Case::Reach,
        Case::Triangles,
        Case::Cspa,
        Case::Csda,
        Case::Andersen,
        Case::El,
    ];

    /// Its name in a table.
    pub fn title(self) -> &'static str {
        match self {
            Case::Random => "TC random",
            Case::Chain => "TC chain",
            Case::Generation => "same gen.",
            Case::Pointsto => "points-to",
            Case::City => "city",
            Case::Closure5000 => "transitive closure, 5,000 nodes",
            Case::Closure10000 => "transitive closure, 10,000 nodes",
            Case::Closure20000 => "transitive closure, 20,000 nodes",
            Case::Generation5000 => "same generation, 5,000 nodes",
            Case::Generation10000 => "same generation, 10,000 nodes",
            Case::Reach => "reachability",
            Case::Triangles => "triangles of a star",
            Case::Cspa => "CSPA",
            Case::Csda => "CSDA",
            Case::Andersen => "Andersen",
            Case::El => "EL completion",
        }
    }

    /// Its program.
    pub fn kind(self) -> Kind {
        match self {
            Case::Random | Case::Chain | Case::Closure5000 | Case::Closure10000 | Case::Closure20000 => Kind::Closure,
            Case::Generation | Case::Generation5000 | Case::Generation10000 => Kind::Generation,
            Case::Pointsto | Case::Andersen => Kind::Pointsto,
            Case::City => Kind::City,
            Case::Reach => Kind::Reach,
            Case::Triangles => Kind::Triangles,
            Case::Cspa => Kind::Cspa,
            Case::Csda => Kind::Csda,
            Case::El => Kind::El,
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
            Case::Pointsto => points_to(&mut facts, 3_000, &mut below),
            Case::City => city(&mut facts, 10_000, &mut below),
            Case::Closure5000 => graph(&mut facts, "Edge", (5_000, 25_000)),
            Case::Closure10000 => graph(&mut facts, "Edge", (10_000, 100_000)),
            Case::Closure20000 => graph(&mut facts, "Edge", (20_000, 400_000)),
            Case::Generation5000 => graph(&mut facts, "Parent", (5_000, 25_000)),
            Case::Generation10000 => graph(&mut facts, "Parent", (10_000, 100_000)),
            Case::Reach => {
                graph(&mut facts, "Edge", (1_000_000, 5_000_000));
                facts.unary.push(("Start", vec![0]));
            }
            Case::Triangles => {
                let leaves = 1..=1_000_000u32;
                let star = leaves.clone().flat_map(|leaf| [(0, leaf), (leaf, 0), (leaf, leaf + 1)]);
                facts.binary.push(("Edge", distinct(star)));
            }
            Case::Cspa => in_functions(&mut facts, (1_000, 60), &mut below),
            Case::Csda => control_flow(&mut facts, (50_000, 500), &mut below),
            Case::Andersen => points_to(&mut facts, 10_000, &mut below),
            Case::El => ontology(&mut facts, 100_000, &mut below),
        }
        facts
    }

    /// Retracts a share of the rows of the first binary predicate, at least one, and inserts as many new ones. A new row
    /// has the first number of a row and the second of another one.
    pub fn changes(self, facts: &Facts, share: f64) -> Changes {
        let (name, rows) = facts.binary.first().expect("every case has pairs");
        let known: HashSet<Pair> = rows.iter().copied().collect();
        let mut random = generator(1_000 + self as u64);
        let mut row = || rows[random() as usize % rows.len()];
        let count = ((rows.len() as f64 * share).round() as usize).max(1);
        let (mut gone, mut new) = (BTreeSet::new(), BTreeSet::new());
        while gone.len() < count {
            gone.insert(row());
        }
        while new.len() < count {
            let pair = (row().0, row().1);
            if !known.contains(&pair) {
                new.insert(pair);
            }
        }
        let gone = gone.into_iter().map(|pair| (pair, false));
        vec![(*name, gone.chain(new.into_iter().map(|pair| (pair, true))).collect())]
    }
}

impl Kind {
    /// The text of the program.
    pub fn program(self) -> &'static str {
        match self {
            Kind::Closure => include_str!("../programs/closure.dl"),
            Kind::Generation => include_str!("../programs/generation.dl"),
            Kind::Pointsto => include_str!("../programs/pointsto.dl"),
            Kind::City => include_str!("../programs/city.dl"),
            Kind::Reach => include_str!("../programs/reach.dl"),
            Kind::Triangles => include_str!("../programs/triangles.dl"),
            Kind::Cspa => include_str!("../programs/cspa.dl"),
            Kind::Csda => include_str!("../programs/csda.dl"),
            Kind::El => include_str!("../programs/el.dl"),
        }
    }

    /// The counted predicates, in the order of the program.
    pub fn derived(self) -> &'static [&'static str] {
        match self {
            Kind::Closure => &["Path"],
            Kind::Generation => &["Same"],
            Kind::Pointsto => &["PointsTo"],
            Kind::City => &["Stop", "Slow", "Fast", "Normal"],
            Kind::Reach => &["Reached"],
            Kind::Triangles => &["Triangle"],
            Kind::Cspa => &["ValueFlow", "MemoryAlias", "ValueAlias"],
            Kind::Csda => &["Null"],
            Kind::El => &["Subsumed", "Related"],
        }
    }
}

/// Pairs of nodes of a random graph. Graphs of the same size are equal.
fn graph(facts: &mut Facts, name: &'static str, (nodes, edges): (u32, u32)) {
    let mut random = generator(u64::from(nodes));
    let mut below = |bound: u32| random() % bound;
    let edges = (0..edges).map(|_| (below(nodes), below(nodes)));
    facts.binary.push((name, distinct(edges)));
}

/// Assignments, half as many addresses, and a fifteenth as many loads and stores as variables.
fn points_to(facts: &mut Facts, variables: u32, below: &mut impl FnMut(u32) -> u32) {
    for (name, count) in [
        ("AddressOf", variables / 2),
        ("Assign", variables),
        ("Load", variables / 15),
        ("Store", variables / 15),
    ] {
        let pairs = (0..count).map(|_| (below(variables), below(variables)));
        facts.binary.push((name, distinct(pairs)));
    }
}

/// Assignments and dereferences between the variables of functions, and calls, which assign to a variable of another
/// function.
fn in_functions(facts: &mut Facts, (functions, variables): (u32, u32), below: &mut impl FnMut(u32) -> u32) {
    let (mut assigned, mut dereferenced) = (Vec::new(), Vec::new());
    for function in 0..functions {
        let base = function * variables;
        let mut local = |count: u32, rows: &mut Vec<Pair>| {
            rows.extend((0..count).map(|_| (base + below(variables), base + below(variables))));
        };
        local(variables / 2, &mut assigned);
        local(variables / 3, &mut dereferenced);
        if function % 8 != 0 {
            assigned.push((base + below(variables), base - variables + below(variables)));
        }
    }
    facts.binary.push(("Assign", distinct(assigned.into_iter())));
    facts.binary.push(("Dereference", distinct(dereferenced.into_iter())));
}

/// Paths of 200 points with branches forward. Null values arise at some points.
fn control_flow(facts: &mut Facts, (points, sources): (u32, u32), below: &mut impl FnMut(u32) -> u32) {
    const PATH: u32 = 200;
    let mut edges = Vec::new();
    for point in 0..points {
        let left = PATH - 1 - point % PATH;
        if left > 0 {
            edges.push((point, point + 1));
            if below(5) == 0 {
                edges.push((point, point + 1 + below(left)));
            }
        }
        // Some paths call the next one.
        if left == 0 && point + 1 < points && below(8) > 0 {
            edges.push((point, point + 1));
        }
    }
    facts.binary.push(("Edge", distinct(edges.into_iter())));
    let nulls = (0..sources).map(|_| below(points)).map(|point| (point, point));
    facts.binary.push(("NullEdge", distinct(nulls)));
}

/// A hierarchy of concepts with roles, conjunctions and restrictions.
fn ontology(facts: &mut Facts, concepts: u32, below: &mut impl FnMut(u32) -> u32) {
    const ROLES: u32 = 20;
    facts.unary.push(("Concept", (0..concepts).collect()));
    let parents = (1..concepts).map(|concept| (concept, below(concept)));
    let mut sub: Vec<Pair> = parents.collect();
    sub.extend((0..concepts / 10).map(|_| {
        let concept = 1 + below(concepts - 1);
        (concept, below(concept))
    }));
    facts.binary.push(("Sub", distinct(sub.into_iter())));
    facts
        .binary
        .push(("SubRole", (1..ROLES).map(|role| (role, role / 2)).collect()));
    let mut triples = |name, count: u32, row: &mut dyn FnMut() -> [u32; 3]| {
        let rows: BTreeSet<[u32; 3]> = (0..count).map(|_| row()).collect();
        facts.ternary.push((name, rows.into_iter().collect()));
    };
    // Restrictions name concepts near the root, which many concepts are below.
    triples("Some", concepts / 2, &mut || {
        [below(concepts), below(ROLES), below(concepts)]
    });
    triples("Has", concepts / 20, &mut || {
        [below(ROLES), below(2_000), below(concepts)]
    });
    triples("And", concepts / 20, &mut || {
        [below(2_000), below(2_000), below(concepts)]
    });
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
        let expert = engine::counts(".include \"expert.dl\"", &facts, Kind::City.derived());
        assert_eq!(
            engine::counts(Kind::City.program(), &facts, Kind::City.derived()),
            expert
        );
    }

    #[test]
    fn facts_are_unchanged() {
        for case in Case::SMALL.into_iter().chain(Case::SUITE) {
            let (facts, again) = (case.facts(), case.facts());
            assert!(facts == again, "{case}");
            let sizes: Vec<usize> = (facts.unary.iter().map(|(_, rows)| rows.len()))
                .chain(facts.binary.iter().map(|(_, rows)| rows.len()))
                .chain(facts.ternary.iter().map(|(_, rows)| rows.len()))
                .collect();
            assert!(sizes.iter().all(|&size| size > 0), "{case}: {sizes:?}");
        }
    }

    #[test]
    fn changes_replace_rows() {
        for case in Case::SMALL {
            let facts = case.facts();
            let (name, rows) = &facts.binary[0];
            let changes = case.changes(&facts, 0.01);
            let [(changed, pairs)] = &changes[..] else {
                panic!("{case}: {changes:?}")
            };
            assert_eq!(changed, name);
            let (gone, new): (Vec<_>, Vec<_>) = pairs.iter().partition(|(_, present)| !present);
            assert_eq!(gone.len(), new.len());
            assert_eq!(gone.len(), (rows.len() as f64 * 0.01).round() as usize);
            assert!(gone.iter().all(|(pair, _)| rows.contains(pair)), "{case}");
            assert!(new.iter().all(|(pair, _)| !rows.contains(pair)), "{case}");
        }
    }
}
