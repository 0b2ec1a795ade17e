//! Compares the executors on random clauses of up to eight variables over entities that are all close to each other.
//!
//! `cargo bench --bench dense` prints a table: for each number of entities and variables, the total times of both
//! executors from facts to answers, and the worst ratio of their times on one clause; then the same ratio for
//! evaluation alone, without loading facts. Below, it prints the median and the worst ratio of all clauses, how many
//! exceed 2, and the worst clause. Where a clause takes the dense executor more steps than [`Dense::steps_max`] allows,
//! its time includes that of the relational one, which then decides. A clause on which the relational executor gives up
//! has no ratio.
//!
//! `cargo bench --bench dense -- CLAUSES SEED` takes another number of clauses per line (50) and another seed (1). With
//! a third argument it prints each clause with a ratio above that.

#[path = "../tests/root.rs"]
mod root;
#[path = "../tests/datalog/written_program.rs"]
mod written_program;

use logicity_datalog::dense::{BitFacts, BitState, Dense, TrackFirings, has};
use logicity_datalog::{Limits, PredicateId, Program, Session, Value};
use std::fmt::Write;
use std::time::{Duration, Instant};
use written_program::program;

const DECLARATIONS: &str = ".type agent <: symbol
    .decl Sees(x: agent, y: agent)
    .decl IsClose(x: agent, y: agent)
    .decl HigherPri(x: agent, y: agent)
    .decl NextTo(x: agent, y: agent)
    .decl LeftOf(x: agent, y: agent)
    .decl IsOld(x: agent)
    .decl IsCar(x: agent)
    .input Sees, IsClose, HigherPri, NextTo, LeftOf, IsOld, IsCar
    .decl Stop(x: agent)";

/// A linear congruential generator with a fixed seed.
fn generator(seed: u64) -> impl FnMut(usize) -> usize {
    let mut state = seed;
    move |below| {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as usize % below
    }
}

/// A clause whose variables hang together: some atom relates each of them to an earlier one.
fn clause(variables: usize, random: &mut impl FnMut(usize) -> usize) -> String {
    let mut text = String::from(if random(2) == 0 { ".scope Sees\n" } else { "" });
    text += "Stop(v0) :- IsCar(v0)";
    for variable in 1..variables {
        // Half of the clauses' shapes are chains, the others trees.
        let to = if random(2) == 0 { variable - 1 } else { random(variable) };
        let name = ["IsClose", "IsClose", "IsClose", "HigherPri", "NextTo"][random(5)];
        write!(text, ", {name}(v{to}, v{variable})").expect("a string");
    }
    for _ in 0..random(variables + 1) {
        let (x, y) = (random(variables), random(variables));
        if x == y {
            let name = ["IsOld", "!IsOld", "IsCar", "!IsCar"][random(4)];
            write!(text, ", {name}(v{x})").expect("a string");
        } else {
            match random(9) {
                0..3 => write!(text, ", IsClose(v{x}, v{y})"),
                3 => write!(text, ", HigherPri(v{x}, v{y})"),
                4 => write!(text, ", !HigherPri(v{x}, v{y})"),
                5 => write!(text, ", NextTo(v{x}, v{y})"),
                6 => write!(text, ", !NextTo(v{x}, v{y})"),
                7 => write!(text, ", LeftOf(v{x}, v{y})"),
                _ => write!(text, ", v{x} != v{y}"),
            }
            .expect("a string");
        }
    }
    text + "."
}

/// The facts about entities that see and are close to each other. Priorities are a total order; `NextTo` and `LeftOf`
/// hold for some pairs.
fn facts(
    program: &Program,
    entities: usize,
    random: &mut impl FnMut(usize) -> usize,
) -> Vec<(PredicateId, Vec<usize>)> {
    let [sees, close, higher, next, left, old, car] =
        ["Sees", "IsClose", "HigherPri", "NextTo", "LeftOf", "IsOld", "IsCar"]
            .map(|name| program.predicate(name).expect("declared"));
    let mut facts = Vec::new();
    for x in 0..entities {
        if random(8) == 0 {
            facts.push((old, vec![x]));
        }
        if random(4) != 0 {
            facts.push((car, vec![x]));
        }
        for y in 0..entities {
            facts.push((sees, vec![x, y]));
            if x == y {
                continue;
            }
            facts.push((close, vec![x, y]));
            if x < y {
                facts.push((higher, vec![x, y]));
            }
            for (predicate, one_in) in [(next, 8), (left, 30)] {
                if random(one_in) == 0 {
                    facts.push((predicate, vec![x, y]));
                }
            }
        }
    }
    facts
}

/// A session with uncommitted facts.
fn session(program: &Program, facts: &[(PredicateId, Vec<usize>)], value: &[Value]) -> Session {
    let mut session = program.session();
    session.set_limits(Limits {
        steps: 1_000_000_000,
        ..Limits::default()
    });
    for (predicate, row) in facts {
        let row: Vec<Value> = row.iter().map(|&entity| value[entity]).collect();
        session.insert(*predicate, &row).expect("it fits");
    }
    session
}

/// The times to load facts and to evaluate the rules.
#[derive(Clone, Copy)]
struct Taken {
    load: Duration,
    evaluate: Duration,
}

impl Taken {
    fn all(self) -> Duration {
        self.load + self.evaluate
    }
}

/// The minimum times over the repetitions; no repetition begins after the first second.
fn least<T>(mut load: impl FnMut() -> T, mut evaluate: impl FnMut(&mut T)) -> Taken {
    let mut least = Taken {
        load: Duration::MAX,
        evaluate: Duration::MAX,
    };
    let begin = Instant::now();
    for _ in 0..5 {
        let start = Instant::now();
        let mut loaded = load();
        least.load = least.load.min(start.elapsed());
        let start = Instant::now();
        evaluate(&mut loaded);
        least.evaluate = least.evaluate.min(start.elapsed());
        if begin.elapsed() > Duration::from_secs(1) {
            break;
        }
    }
    least
}

/// The times of the dense and the relational executor; `None` for the latter if it gives up.
struct Times {
    dense: Taken,
    relational: Option<Taken>,
    fell_back: bool,
}

/// Measures both executors and compares their answers.
fn measure(program: &Program, entities: usize, facts: &[(PredicateId, Vec<usize>)]) -> Times {
    let rules = program.rules();
    let value: Vec<Value> = (0..entities)
        .map(|entity| Value(rules.symbols.intern(&format!("e{entity}")).0))
        .collect();
    let dense = Dense::new(rules, TrackFirings::Off, |_| false).expect("it supports the rules");
    let mut state: BitState<1> = BitState::new(&dense, entities);
    let mut fell_back = false;
    let mut taken = least(
        || {
            let mut bits: BitFacts<1> = BitFacts::new(&dense, entities);
            for (predicate, row) in facts {
                bits.insert(&dense, *predicate, row);
            }
            bits
        },
        |bits| {
            bits.load(&dense, &mut state);
            fell_back = state.run(&dense, bits).is_err();
        },
    );

    let stop = program.predicate("Stop").expect("declared");
    let mut answer: Option<Vec<bool>> = None;
    let relational = least(
        || session(program, facts, &value),
        |session| {
            answer = match session.commit() {
                Ok(_) => Some(value.iter().map(|value| session.contains(stop, [*value])).collect()),
                Err(_) => None,
            };
        },
    );
    if let (Some(answer), false) = (&answer, fell_back) {
        let set = state.set(&dense, stop).expect("derived");
        let found: Vec<bool> = (0..entities).map(|entity| has(set, entity)).collect();
        assert_eq!(&found, answer, "the executors differ");
    }
    if fell_back {
        taken.evaluate += relational.all();
    }
    Times {
        dense: taken,
        relational: answer.is_some().then_some(relational),
        fell_back,
    }
}

fn main() {
    let arguments: Vec<f64> = std::env::args()
        .skip(1)
        .filter_map(|argument| argument.parse().ok())
        .collect();
    let clauses = arguments.first().map_or(50, |&clauses| clauses as usize);
    let seed = arguments.get(1).map_or(1, |&seed| seed as u64);
    let shown = arguments.get(2).copied().unwrap_or(f64::INFINITY);
    println!(
        "{:>8} {:>9} {:>7} {:>11} {:>14} {:>11} {:>12} {:>9} {:>7}",
        "entities",
        "variables",
        "clauses",
        "dense ms",
        "relational ms",
        "worst ratio",
        "without load",
        "fallbacks",
        "gave up"
    );
    let mut all: [Ratios; 2] = Default::default();
    for entities in [20, 60] {
        for variables in 2..=8 {
            let mut random = generator(seed * 1_000 + variables as u64);
            let (mut dense, mut relational) = (Duration::ZERO, Duration::ZERO);
            let (mut worst, mut fallbacks, mut gave_up) = ([0.0_f64; 2], 0, 0);
            for _ in 0..clauses {
                let text = clause(variables, &mut random);
                let program = program(&format!("{DECLARATIONS}\n{text}\n"));
                let facts = facts(&program, entities, &mut random);
                let times = measure(&program, entities, &facts);
                fallbacks += u32::from(times.fell_back);
                dense += times.dense.all();
                let Some(taken) = times.relational else {
                    gave_up += 1;
                    continue;
                };
                relational += taken.all();
                let compared = [(times.dense.all(), taken.all()), (times.dense.evaluate, taken.evaluate)];
                for ((worst, all), (dense, relational)) in worst.iter_mut().zip(&mut all).zip(compared) {
                    let ratio = dense.as_secs_f64() / relational.as_secs_f64();
                    *worst = worst.max(ratio);
                    let case = format!("{dense:.2?} against {relational:.2?}, {entities} entities: {text}");
                    if ratio > shown {
                        println!("{ratio:.2}: {case}");
                    }
                    all.add(ratio, case);
                }
            }
            let [all, without_load] = worst;
            println!(
                "{entities:>8} {variables:>9} {clauses:>7} {:>11.3} {:>14.3} {all:>11.3} {without_load:>12.3} \
                 {fallbacks:>9} {gave_up:>7}",
                dense.as_secs_f64() * 1e3,
                relational.as_secs_f64() * 1e3,
            );
        }
    }
    for (what, ratios) in ["from facts to answers", "without loading facts"].iter().zip(all) {
        ratios.print(what);
    }
}

/// The ratios of the times of the two executors.
#[derive(Default)]
struct Ratios {
    ratios: Vec<f64>,
    /// The worst case in words.
    worst: String,
}

impl Ratios {
    fn add(&mut self, ratio: f64, case: String) {
        if self.ratios.iter().all(|other| *other < ratio) {
            self.worst = case;
        }
        self.ratios.push(ratio);
    }

    fn print(mut self, what: &str) {
        self.ratios.sort_by(f64::total_cmp);
        let Some(worst) = self.ratios.last() else { return };
        println!(
            "{what}: median ratio {:.3}, worst {worst:.3}, {} of {} clauses above 2\n  worst clause: {}",
            self.ratios[self.ratios.len() / 2],
            self.ratios.iter().filter(|ratio| **ratio > 2.0).count(),
            self.ratios.len(),
            self.worst.replace('\n', " "),
        );
    }
}
