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
    /// Polonius: the loans of 2,000 functions of 100 points
    Borrows,
    /// Order of the characters of a text after 260,000 operations (CRDT)
    Crdt,
    /// CRDT on the published trace: `insert.txt` and `remove.txt` of `problems/crdt` in
    /// github.com/frankmcsherry/dynamic-datalog, in the folder `$LOGICITY_CRDT`
    CrdtTrace,
    /// Context-sensitive points-to analysis of 60,000 variables in functions of 600
    CspaLarge,
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
    Borrows,
    Crdt,
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

/// The environment variable with the folder of the published trace.
pub const CRDT: &str = "LOGICITY_CRDT";

/// The base facts of a case, by the name of the predicate.
#[derive(Default, PartialEq)]
pub struct Facts {
    pub unary: Vec<(&'static str, Vec<u32>)>,
    pub binary: Vec<(&'static str, Vec<Pair>)>,
    pub ternary: Vec<(&'static str, Vec<[u32; 3]>)>,
    pub quaternary: Vec<(&'static str, Vec<[u32; 4]>)>,
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

    /// The rows of a predicate of four columns.
    pub fn quaternary(&self, name: &str) -> &[[u32; 4]] {
        let found = self.quaternary.iter().find(|(other, _)| *other == name);
        &found.expect("the case has the predicate").1
    }
}

impl Case {
    /// The cases of the table of all peers, in its order.
    pub const SMALL: [Case; 5] = [Case::Random, Case::Chain, Case::Generation, Case::Pointsto, Case::City];

    /// The cases of the suite, in its order.
    pub const SUITE: [Case; 14] = [
        Case::Closure5000,
        Case::Closure10000,
        Case::Closure20000,
        Case::Generation5000,
        Case::Generation10000,
        Case::Reach,
        Case::Triangles,
        Case::Cspa,
        Case::CspaLarge,
        Case::Csda,
        Case::Andersen,
        Case::El,
        Case::Borrows,
        Case::Crdt,
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
            Case::CspaLarge => "CSPA, large functions",
            Case::Csda => "CSDA",
            Case::Andersen => "Andersen",
            Case::El => "EL completion",
            Case::Borrows => "Polonius",
            Case::Crdt => "CRDT",
            Case::CrdtTrace => "CRDT, published trace",
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
            Case::Cspa | Case::CspaLarge => Kind::Cspa,
            Case::Csda => Kind::Csda,
            Case::El => Kind::El,
            Case::Borrows => Kind::Borrows,
            Case::Crdt | Case::CrdtTrace => Kind::Crdt,
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
            Case::CspaLarge => in_functions(&mut facts, (100, 600), &mut below),
            Case::Csda => control_flow(&mut facts, (50_000, 500), &mut below),
            Case::Andersen => points_to(&mut facts, 10_000, &mut below),
            Case::El => ontology(&mut facts, 100_000, &mut below),
            Case::Borrows => loans(&mut facts, (2_000, 100), &mut below),
            Case::Crdt => edits(&mut facts, (180_000, 80_000), &mut below),
            Case::CrdtTrace => recorded_edits(&mut facts),
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
            Kind::Borrows => include_str!("../programs/borrows.dl"),
            Kind::Crdt => include_str!("../programs/crdt.dl"),
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
            Kind::Borrows => &["Subset", "Contains", "Fault"],
            Kind::Crdt => &["Next", "Visible"],
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

/// A hierarchy of concepts. Half have a restriction (some r d), and one in eight is defined by its first parent and the
/// restriction, which has a concept of its own. Parents and restrictions name earlier concepts.
fn ontology(facts: &mut Facts, concepts: u32, below: &mut impl FnMut(u32) -> u32) {
    const ROLES: u32 = 20;
    let (mut sub, mut some, mut has, mut and) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    let mut all = concepts;
    for concept in 1..concepts {
        let parent = below(concept);
        sub.push((concept, parent));
        if below(3) == 0 {
            sub.push((concept, below(concept)));
        }
        if below(2) == 0 {
            let (role, filler) = (below(ROLES), below(concept));
            some.push([concept, role, filler]);
            if below(4) == 0 {
                has.push([role, filler, all]);
                and.push([parent, all, concept]);
                all += 1;
            }
        }
    }
    facts.unary.push(("Concept", (0..all).collect()));
    facts.binary.push(("Sub", distinct(sub.into_iter())));
    facts
        .binary
        .push(("SubRole", (1..ROLES).map(|role| (role, role / 2)).collect()));
    for (name, mut rows) in [("Some", some), ("Has", has), ("And", and)] {
        rows.sort_unstable();
        rows.dedup();
        facts.ternary.push((name, rows));
    }
}

/// Functions of points, with branches forward and loops back. Each function has origins that are live in one interval of
/// points, loans with these origins, and subset constraints at some points.
fn loans(facts: &mut Facts, (functions, points): (u32, u32), below: &mut impl FnMut(u32) -> u32) {
    const ORIGINS: u32 = 20;
    const LOANS: u32 = 10;
    let (mut edges, mut live, mut killed, mut invalidated) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    let (mut outlives, mut issued) = (Vec::new(), Vec::new());
    for function in 0..functions {
        let (point, origin, loan) = (function * points, function * ORIGINS, function * LOANS);
        for at in 1..points {
            edges.push((point + at - 1, point + at));
            match below(10) {
                0 => edges.push((point + at, point + at + below(points - at))),
                1 => edges.push((point + at, point + below(at))),
                _ => {}
            }
            if below(3) == 0 {
                outlives.push([origin + below(ORIGINS), origin + below(ORIGINS), point + at]);
            }
        }
        for at in 0..ORIGINS {
            let first = below(points);
            live.extend((first..first + 1 + below(points - first)).map(|end| (origin + at, point + end)));
        }
        for at in 0..LOANS {
            issued.push([origin + below(ORIGINS), loan + at, point + below(points)]);
            killed.push((loan + at, point + below(points)));
            invalidated.extend((0..3).map(|_| (loan + at, point + below(points))));
        }
    }
    for (name, pairs) in [
        ("Edge", edges),
        ("Live", live),
        ("Killed", killed),
        ("Invalidated", invalidated),
    ] {
        facts.binary.push((name, distinct(pairs.into_iter())));
    }
    for (name, mut rows) in [("Outlives", outlives), ("Issued", issued)] {
        rows.sort_unstable();
        rows.dedup();
        facts.ternary.push((name, rows));
    }
}

/// Two authors insert characters at a cursor, which sometimes moves, and remove characters backwards from it.
fn edits(facts: &mut Facts, (inserted, removed): (u32, u32), below: &mut impl FnMut(u32) -> u32) {
    // Character 0 is the beginning of the text.
    let mut characters = vec![(0, 0)];
    let mut parents = vec![0];
    let (mut gone, mut cursor, mut clock) = (BTreeSet::new(), 0, 0);
    let mut rows = Vec::new();
    while rows.len() < inserted as usize || gone.len() < removed as usize {
        if below(50) == 0 {
            cursor = below(characters.len() as u32) as usize;
        }
        // The removals come in runs.
        let removes = below(inserted + removed) < removed && !rows.is_empty();
        for _ in 0..1 + below(8) {
            clock += 1;
            if removes && gone.len() < removed as usize {
                if cursor > 0 {
                    gone.insert(characters[cursor]);
                }
                cursor = parents[cursor];
            } else if !removes && rows.len() < inserted as usize {
                let (id, (parent, author)) = ((clock, u32::from(below(30) == 0)), characters[cursor]);
                rows.push([id.0, id.1, parent, author]);
                parents.push(cursor);
                cursor = characters.len();
                characters.push(id);
            }
        }
    }
    facts.quaternary.push(("Insert", rows));
    facts.binary.push(("Remove", gone.into_iter().collect()));
}

/// The operations in the folder of [`CRDT`].
fn recorded_edits(facts: &mut Facts) {
    let folder = std::env::var(CRDT).unwrap_or_else(|_| panic!("set {CRDT} to the folder of the trace"));
    let numbers = |file: &str| -> Vec<u32> {
        let text = std::fs::read_to_string(std::path::Path::new(&folder).join(file));
        let text = text.unwrap_or_else(|error| panic!("{folder}/{file}: {error}"));
        let number = |word: &str| {
            word.parse()
                .unwrap_or_else(|_| panic!("{folder}/{file}: `{word}` is not a number"))
        };
        text.split_whitespace().map(number).collect()
    };
    let rows = numbers("insert.txt");
    assert_eq!(rows.len() % 4, 0, "{folder}/insert.txt: the last row is incomplete");
    let rows = rows
        .chunks_exact(4)
        .map(|row| [row[0], row[1], row[2], row[3]])
        .collect();
    facts.quaternary.push(("Insert", rows));
    let pairs = numbers("remove.txt");
    assert_eq!(pairs.len() % 2, 0, "{folder}/remove.txt: the last row is incomplete");
    let pairs = pairs.chunks_exact(2).map(|pair| (pair[0], pair[1]));
    facts.binary.push(("Remove", distinct(pairs)));
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
                .chain(facts.quaternary.iter().map(|(_, rows)| rows.len()))
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
