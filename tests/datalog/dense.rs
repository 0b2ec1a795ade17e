//! Compares the dense executor with the specification on random programs and scenes.

use crate::cases::cases;
use crate::written_program::program;
use logicity_datalog::dense::{BitFacts, BitState, Dense, Set, TrackFirings, costly, has};
use logicity_datalog::{ClauseId, Limits, PredicateId, Rules, Value};
use logicity_datalog::{Program, naive};
use proptest::prelude::*;
use std::collections::BTreeSet;
use std::fmt::Write;
use std::ops::Range;

/// Base predicates, unary ones first.
const BASE: [(&str, usize); 6] = [("A", 1), ("B", 1), ("C", 1), ("G", 2), ("R", 2), ("S", 2)];
const VARIABLES: [&str; 8] = ["x", "y", "z", "w", "a", "b", "c", "d"];

/// Raw material of a literal, before its predicates and variables are known.
#[derive(Clone, Debug)]
struct LiteralGene {
    predicate: usize,
    terms: [usize; 2],
    form: u8,
}

#[derive(Clone, Debug)]
struct ClauseGene {
    head_terms: [usize; 2],
    body: Vec<LiteralGene>,
}

#[derive(Clone, Debug)]
struct Genome {
    /// Columns of each derived predicate, and its clauses.
    derived: Vec<(usize, Vec<ClauseGene>)>,
    scoped: bool,
    /// The number of leading predicates that copy a base predicate. A program with more than 256 sets takes another
    /// code path.
    copies: usize,
    entities: usize,
    /// The probabilities, in sixteenths, that a unary and a binary fact hold.
    density: u8,
    seed: u64,
}

/// Programs whose clauses have up to this number of variables and literals, over few or many entities.
fn genomes(variables: usize, literals: usize, few: Range<usize>) -> impl Strategy<Value = Genome> {
    let terms = [0..variables, 0..variables];
    let literal = (0..64_usize, terms.clone(), 0..20_u8).prop_map(|(declared, terms, form)| LiteralGene {
        predicate: declared,
        terms,
        form,
    });
    let clause = (terms, prop::collection::vec(literal, 1..=literals))
        .prop_map(|(head_terms, body)| ClauseGene { head_terms, body });
    let predicate = (1..=2_usize, prop::collection::vec(clause, 1..4));
    let entities = prop_oneof![3 => few, 1 => 60..70_usize];
    (
        prop::collection::vec(predicate, 1..5),
        any::<bool>(),
        prop_oneof![4 => Just(0_usize), 1 => Just(256_usize)],
        entities,
        1..14_u8,
        any::<u64>(),
    )
        .prop_map(|(derived, scoped, copies, entities, density, seed)| Genome {
            derived,
            scoped,
            copies,
            entities,
            density,
            seed,
        })
}

impl Genome {
    /// The program as text. A positive atom binds every variable of a body.
    fn text(&self) -> String {
        let mut text = String::new();
        let mut known: Vec<(String, usize)> = BASE.iter().map(|&(name, arity)| (name.to_owned(), arity)).collect();
        let declare = |text: &mut String, name: &str, arity: usize| {
            let columns = ["x: symbol", "y: symbol"][..arity].join(", ");
            writeln!(text, ".decl {name}({columns})").unwrap();
        };
        for (name, arity) in BASE {
            declare(&mut text, name, arity);
            writeln!(text, ".input {name}").unwrap();
        }
        for (index, (arity, _)) in self.derived.iter().enumerate() {
            declare(&mut text, &format!("P{index}"), *arity);
        }
        for copy in 0..self.copies {
            declare(&mut text, &format!("Copy{copy}"), 1);
            writeln!(text, "Copy{copy}(x) :- {}(x).", ["A", "B", "C"][copy % 3]).unwrap();
        }
        if self.scoped {
            writeln!(text, ".scope G").unwrap();
        }
        for (index, (arity, clauses)) in self.derived.iter().enumerate() {
            let name = format!("P{index}");
            for clause in clauses {
                writeln!(text, "{}", self.clause(&name, *arity, clause, &known)).unwrap();
            }
            known.push((name, *arity));
        }
        text
    }

    fn clause(&self, name: &str, arity: usize, clause: &ClauseGene, known: &[(String, usize)]) -> String {
        // In a scope, the head's first variable is the middle one.
        let head: Vec<&str> = clause.head_terms[..arity].iter().map(|&term| VARIABLES[term]).collect();
        let mut used: BTreeSet<&str> = head.iter().copied().collect();
        let mut bound: BTreeSet<&str> = BTreeSet::new();
        let mut body = Vec::new();
        for gene in &clause.body {
            let (predicate, arity) = &known[gene.predicate % known.len()];
            let terms = gene.terms.map(|term| VARIABLES[term]);
            let terms = &terms[..*arity];
            let atom = |terms: &[&str]| format!("{predicate}({})", terms.join(", "));
            match gene.form {
                0..=8 => {
                    bound.extend(terms);
                    body.push(atom(terms));
                }
                9..=11 => body.push(format!("!{}", atom(terms))),
                12 if *arity == 2 => body.push(format!("!{}", atom(&[terms[0], "_"]))),
                13 if *arity == 2 => body.push(format!("!{}", atom(&["_", terms[1]]))),
                14 => {
                    let terms = gene.terms.map(|term| VARIABLES[term]);
                    used.extend(terms);
                    body.push(format!("{} != {}", terms[0], terms[1]));
                    continue;
                }
                15 => {
                    let terms = gene.terms.map(|term| VARIABLES[term]);
                    used.extend(terms);
                    body.push(format!("{} = {}", terms[0], terms[1]));
                    continue;
                }
                16..=19 if *arity == 2 => {
                    // In a scope, the counted agents must be those that the head's first variable sees.
                    let of = if self.scoped { head[0] } else { terms[0] };
                    used.insert(of);
                    let limit = i32::from(gene.form) - 17 + i32::try_from(gene.predicate % 3).unwrap();
                    let op = ["<", "<=", ">", ">=", "=", "!="][gene.predicate % 6];
                    let counted = match gene.form {
                        16 => atom(&["_", of]),
                        17 => atom(&[of, "v"]) + ", A(v)",
                        _ => atom(&[of, "_"]),
                    };
                    body.push(match gene.predicate % 2 {
                        0 => format!("count : {{ {counted} }} {op} {limit}"),
                        _ => format!(
                            "n{0} = count : {{ {counted} }}, {limit} {op} n{0}, n{0} != 1",
                            body.len()
                        ),
                    });
                    continue;
                }
                _ => {
                    bound.insert(terms[0]);
                    body.push(match arity {
                        1 => atom(terms),
                        _ => atom(&[terms[0], "_"]),
                    });
                    continue;
                }
            }
            used.extend(terms);
        }
        for variable in used.difference(&bound) {
            body.push(format!("{}({variable})", ["A", "B", "C"][self.density as usize % 3]));
        }
        format!("{name}({}) :- {}.", head.join(", "), body.join(", "))
    }

    fn facts(&self, rules: &Rules) -> Vec<(PredicateId, Vec<usize>)> {
        let mut state = self.seed;
        let mut holds = |of: u32| {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            ((state >> 33) as u32 % of) < u32::from(self.density)
        };
        let mut facts = Vec::new();
        // Among many entities, relate pairs more rarely, so that some searches fail.
        let crowd = 16 * u32::try_from(self.entities / 4 + 1).unwrap();
        for (name, arity) in BASE {
            let predicate = rules.predicate(name).unwrap();
            for x in 0..self.entities {
                if arity == 1 {
                    if holds(16) {
                        facts.push((predicate, vec![x]));
                    }
                    continue;
                }
                facts.extend(
                    (0..self.entities)
                        .filter(|_| holds(crowd))
                        .map(|y| (predicate, vec![x, y])),
                );
            }
        }
        facts
    }
}

/// Beyond this number of entities, the relational executor replaces `naive`, which is too slow. Other tests compare the
/// two.
const NAIVE_MAX: usize = 8;

/// The expected result: all facts that hold, and the number of rows that each clause derives. `None` if the relational
/// executor takes too long.
fn expected(
    program: &Program,
    value: &[Value],
    facts: &[(PredicateId, Vec<usize>)],
) -> Option<(naive::Database, Vec<usize>)> {
    let rules = program.rules();
    let rows = facts.iter().map(|(predicate, row)| {
        let row: Vec<Value> = row.iter().map(|&entity| value[entity]).collect();
        (*predicate, row)
    });
    if value.len() <= NAIVE_MAX {
        let database = naive::evaluate(rules, &rules.symbols, rows);
        let fired = |clause| naive::consequences(rules, clause, &rules.symbols, &database).len();
        let fired = rules.clauses.iter().map(fired).collect();
        return Some((database, fired));
    }
    let mut session = program.session();
    session.set_limits(Limits {
        steps: 2_000_000,
        ..Limits::default()
    });
    for (predicate, row) in rows {
        session.insert(predicate, &row).expect("it fits");
    }
    session.commit().ok()?;
    let predicates = u32::try_from(rules.predicates.len()).unwrap();
    let database = (0..predicates)
        .map(|predicate| {
            session
                .encoded_rows(PredicateId(predicate))
                .map(<[Value]>::to_vec)
                .collect()
        })
        .collect();
    let clauses = u32::try_from(rules.clauses.len()).unwrap();
    let fired = (0..clauses).map(|clause| session.fired(ClauseId(clause)).len());
    Some((database, fired.collect()))
}

/// Runs the dense executor and compares every derived predicate, and the counts of every clause if there are any.
fn check<const W: usize>(
    program: &Program,
    facts: &[(PredicateId, Vec<usize>)],
    entities: usize,
) -> Result<(), TestCaseError> {
    let rules = program.rules();
    let value: Vec<Value> = (0..entities)
        .map(|entity| Value(rules.symbols.intern(&format!("e{entity}")).0))
        .collect();
    let Some((expected, expected_fired)) = expected(program, &value, facts) else {
        return Ok(());
    };
    // The relational executor may store a count instead of the rows of a hidden predicate.
    let is_stored = |predicate: PredicateId| entities <= NAIVE_MAX || !rules.predicates[predicate.index()].hidden;
    for counting in [TrackFirings::Off, TrackFirings::Each] {
        let steady = |predicate: PredicateId| predicate.0.is_multiple_of(2);
        let dense = Dense::new(rules, counting, steady).expect("it supports the rules");
        let mut given: BitFacts<W> = BitFacts::new(&dense, entities);
        for (predicate, row) in facts {
            given.insert(&dense, *predicate, row);
        }
        // Facts about other entities from an earlier run are gone.
        let mut bit_state: BitState<W> = BitState::new(&dense, 64 * W);
        for input in 0..dense.inputs().len() {
            bit_state.set_input(&dense, input, [u64::MAX; W]);
        }
        bit_state
            .run(&dense, &BitFacts::new(&dense, 64 * W))
            .expect("few steps");
        bit_state.reset(&dense, entities);
        given.load(&dense, &mut bit_state);
        // The second run starts from the state of the first.
        let mut run = Ok(());
        for _ in 0..2 {
            run = bit_state.run(&dense, &given);
        }
        let too_costly = costly(rules, entities, entities);
        match run {
            Ok(()) => {}
            Err(_) if !too_costly.is_empty() => return Ok(()),
            Err(error) => panic!("no clause is costly, but {error}"),
        }
        for (predicate, expected) in rules
            .predicates
            .iter()
            .zip(&expected)
            .enumerate()
            .filter(|(_, (r, _))| r.derived)
            .map(|(index, (_, expected))| (PredicateId(u32::try_from(index).unwrap()), expected))
        {
            if !is_stored(predicate) {
                continue;
            }
            let name = &rules.predicates[predicate.index()].name;
            match rules.predicates[predicate.index()].arity() {
                1 => {
                    let set = bit_state.set(&dense, predicate).expect("derived");
                    for (entity, value) in value.iter().enumerate() {
                        let holds = expected.contains(&vec![*value]);
                        prop_assert_eq!(has(set, entity), holds, "{}({})", name, entity);
                    }
                }
                _ => {
                    for x in 0..entities {
                        let row = bit_state.row(&dense, predicate, x).expect("derived");
                        for y in 0..entities {
                            let holds = expected.contains(&vec![value[x], value[y]]);
                            prop_assert_eq!(has(row, y), holds, "{}({}, {})", name, x, y);
                        }
                    }
                }
            }
        }
        for (id, &fired) in (0..).map(ClauseId).zip(&expected_fired) {
            let head = rules.clauses[id.index()].head.predicate;
            if !is_stored(head) {
                continue;
            }
            match (counting, bit_state.count_fired(&dense, id)) {
                (TrackFirings::Off, count) => prop_assert_eq!(count, None),
                // The program does not contain clauses that can never fire.
                (TrackFirings::Each, count) => prop_assert_eq!(count.unwrap_or(0), fired),
            }
        }
        if dense.is_local() {
            check_egos(&dense, &given, &bit_state, rules)?;
        }
    }
    Ok(())
}

/// Evaluation for some entities gives the same facts about them.
fn check_egos<const W: usize>(
    program: &Dense,
    given: &BitFacts<W>,
    all: &BitState<W>,
    rules: &Rules,
) -> Result<(), TestCaseError> {
    let mut some = BitState::new(program, all.count());
    given.load(program, &mut some);
    let egos: Set<W> = [0x5555_5555_5555_5555; W];
    some.set_egos(egos);
    some.run(program, given).expect("few steps");
    for predicate in (0..u32::try_from(rules.predicates.len()).unwrap()).map(PredicateId) {
        if let (Some(all), Some(some)) = (all.set(program, predicate), some.set(program, predicate)) {
            let wanted: Set<W> = std::array::from_fn(|word| all[word] & egos[word]);
            prop_assert_eq!(some, &wanted);
        }
        for at in (0..all.count()).step_by(2) {
            prop_assert_eq!(some.row(program, predicate, at), all.row(program, predicate, at));
        }
    }
    Ok(())
}

proptest! {
    #![proptest_config(cases(256))]

    #[test]
    fn the_dense_executor_agrees_with_naive(genome in genomes(4, 5, 1..7)) {
        check_in_both_widths(&genome)?;
    }

    #[test]
    fn the_dense_executor_agrees_with_naive_on_clauses_of_many_variables(genome in genomes(8, 12, 1..4)) {
        check_in_both_widths(&genome)?;
    }
}

fn check_in_both_widths(genome: &Genome) -> Result<(), TestCaseError> {
    let program = program(&genome.text());
    let facts = genome.facts(program.rules());
    if genome.entities <= 64 {
        check::<1>(&program, &facts, genome.entities)?;
    }
    check::<2>(&program, &facts, genome.entities)
}

/// Runs a program of the base predicates in one word and returns the result and the steps of its searches.
fn steps_over(text: &str, entities: usize, holds: impl Fn(&str, usize, usize) -> bool) -> (bool, u64) {
    let mut all = String::new();
    for (name, arity) in BASE {
        let columns = ["x: symbol", "y: symbol"][..arity].join(", ");
        writeln!(all, ".decl {name}({columns})\n.input {name}").unwrap();
    }
    let program = program(&format!("{all}.decl P(x: symbol)\n{text}"));
    let rules = program.rules();
    let mut facts = Vec::new();
    for (name, arity) in BASE {
        let predicate = rules.predicate(name).unwrap();
        for x in 0..entities {
            match arity {
                1 if holds(name, x, x) => facts.push((predicate, vec![x])),
                1 => {}
                _ => facts.extend(
                    (0..entities)
                        .filter(|&y| holds(name, x, y))
                        .map(|y| (predicate, vec![x, y])),
                ),
            }
        }
    }
    check::<1>(&program, &facts, entities).unwrap();
    let dense = Dense::new(rules, TrackFirings::Off, |_| false).expect("it supports the rules");
    let mut given: BitFacts<1> = BitFacts::new(&dense, entities);
    for (predicate, row) in &facts {
        given.insert(&dense, *predicate, row);
    }
    let mut state: BitState<1> = BitState::new(&dense, entities);
    given.load(&dense, &mut state);
    let within = state.run(&dense, &given).is_ok();
    assert_eq!(within, state.steps() <= Dense::steps_max(entities));
    (within, state.steps())
}

/// Facts about entities that are all related by `R`; `S` relates even to odd ones, so that it has no odd cycle.
fn without_odd_cycles(name: &str, x: usize, y: usize) -> bool {
    match name {
        "R" => x != y,
        "S" => (x + y) % 2 == 1,
        _ => true,
    }
}

/// A chain over entities that are all close is a product of bit matrices: every pair of neighbors is tried at most
/// twice for each head.
#[test]
fn a_chain_takes_few_steps() {
    // Nothing holds, but each entity has neighbors in the triangle at the end.
    let chain = "R(x, a), R(a, b), R(b, c), R(c, d), S(d, e), S(e, f), S(f, d)";
    // In a scope, every variable relates to the head's.
    for scope in ["", ".scope G\n"] {
        let (within, steps) = steps_over(&format!("{scope}P(x) :- A(x), {chain}."), 60, without_odd_cycles);
        assert!(within && steps <= 2 * 60 * (60 * 4 + 60 * 60), "{steps} steps");
    }
}

/// An intermediate result may relate three variables.
#[test]
fn a_ladder_takes_few_steps() {
    let rungs = "R(x, a), R(a, b), R(b, c), R(a, d), R(b, e), R(c, f), R(d, e), R(e, f), S(c, f), S(f, g), S(g, c)";
    let (within, steps) = steps_over(&format!("P(x) :- A(x), {rungs}."), 60, without_odd_cycles);
    assert!(within && steps <= 60 * 60 * 7, "{steps} steps");
}

/// All conditions on the same two variables are tested together, so a search soon finds that they contradict each
/// other, for all heads at once.
#[test]
fn contradictions_take_few_steps() {
    let holds = |name: &str, x: usize, y: usize| match name {
        "R" => x != y,
        "S" => x < y,
        _ => true,
    };
    for scope in ["", ".scope G\n"] {
        let chain = "R(x, a), R(a, b), R(b, c), R(c, d), R(d, e), R(e, f), R(f, g)";
        let (within, steps) = steps_over(&format!("{scope}P(x) :- A(x), {chain}, S(f, g), S(g, f)."), 60, holds);
        assert!(within && steps <= 100, "{steps} steps");
        // A clause that contradicts itself is not evaluated.
        for contradiction in ["S(f, g), !S(f, g)", "B(f), !B(f)", "f = g, g != f"] {
            let (within, steps) = steps_over(&format!("{scope}P(x) :- A(x), {chain}, {contradiction}."), 60, holds);
            assert!(within && steps == 0, "{contradiction}: {steps} steps");
        }
    }
}

/// Whether the executor gives up depends on the facts only, and only clauses that it calls costly make it.
#[test]
fn the_steps_of_a_clique_are_bounded() {
    let names = ["x", "a", "b", "c", "d", "e", "f", "g"];
    let mut pairs = Vec::new();
    for (at, one) in names.iter().enumerate() {
        pairs.extend(names[at + 1..].iter().map(|other| format!("R({one}, {other})")));
    }
    let text = format!("P(x) :- A(x), {}.", pairs.join(", "));
    // Seven groups without predicates inside have no clique of eight.
    let groups = |name: &str, x: usize, y: usize| name == "A" || name == "R" && x % 7 != y % 7;
    let (within, steps) = steps_over(&text, 56, groups);
    assert!(!within);
    assert_eq!(steps_over(&text, 56, groups), (within, steps));
    assert!(steps_over(&text, 10, groups).0);
}
