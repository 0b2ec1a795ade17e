//! Measures the cost of updating the decisions in a city of 10,000 agents when a part of the binary facts changes.
//! Compares the engine with differential-dataflow and with a full recomputation in hand-written datafrog.
//!
//! `cargo run --release --manifest-path benches/peers/Cargo.toml --bin churn` prints CPU times and ratios. A tick
//! replaces a part of the binary facts, chosen at random, by as many others. The engine and differential-dataflow get
//! the difference, and their time begins with the first change. datafrog gets all facts. In every tick, all three must
//! derive the same numbers of decisions.

#[path = "../case.rs"]
mod case;
#[path = "../datafrog.rs"]
mod datafrog;
#[path = "../differential.rs"]
mod differential;
#[path = "../engine.rs"]
mod engine;

use case::{Changes, Facts, Kind, Pair};
use clap::Parser;
use cpu_time::ThreadTime;
use logicity::datalog::{Strategy, StratumStats};
use std::collections::BTreeSet;
use std::time::Duration;

/// Measure the cost of a tick when a part of the facts changes.
#[derive(Parser)]
struct Arguments {
    /// Measured ticks of each case, of which the table has the median
    #[arg(long, default_value_t = 200)]
    ticks: usize,
    /// Percentages of the binary facts to replace in a tick; 0 replaces a single fact
    #[arg(long, value_delimiter = ',', default_value = "0,1,5,30")]
    percent: Vec<f64>,
    /// Sizes of the city
    #[arg(long, value_delimiter = ',', default_value = "10000,40")]
    agents: Vec<u32>,
    /// Measure only the engine, with one strategy: auto, maintain or recompute
    #[arg(long, value_parser = strategy)]
    alone: Option<Strategy>,
}

fn main() {
    let arguments = Arguments::parse();
    println!(
        "{:>6} {:>13} {:>6} {:>12} {:>13} {:>12} {:>12} {:>12}  strata",
        "agents", "binary facts", "change", "engine us", "differential", "datafrog", "engine/diff.", "engine/frog"
    );
    for &agents in &arguments.agents {
        for &percent in &arguments.percent {
            let strategy = arguments.alone.unwrap_or_default();
            measure(agents, percent, arguments.ticks, strategy, arguments.alone.is_none());
        }
    }
}

fn strategy(text: &str) -> Result<Strategy, &'static str> {
    match text {
        "auto" => Ok(Strategy::Auto),
        "maintain" => Ok(Strategy::Maintain),
        "recompute" => Ok(Strategy::Recompute),
        _ => Err("auto, maintain or recompute"),
    }
}

/// The pairs of every binary predicate, and their next change.
struct City {
    agents: u32,
    below: Box<dyn FnMut(u32) -> u32 + Send + Sync>,
    facts: Facts,
    sets: Vec<BTreeSet<Pair>>,
}

impl City {
    fn new(agents: u32) -> Self {
        let mut random = case::generator(5);
        let mut below = Box::new(move |bound: u32| random() % bound);
        let mut facts = Facts::default();
        case::city(&mut facts, agents, &mut below);
        let sets = facts
            .binary
            .iter()
            .map(|(_, rows)| rows.iter().copied().collect())
            .collect();
        City {
            agents,
            below,
            facts,
            sets,
        }
    }

    fn size(&self) -> usize {
        self.sets.iter().map(BTreeSet::len).sum()
    }

    /// Replaces this percentage of the pairs; 0 replaces a single pair.
    fn change(&mut self, percent: f64) -> Changes {
        let mut changes = Changes::new();
        for ((name, rows), set) in self.facts.binary.iter_mut().zip(&mut self.sets) {
            let mut changed = BTreeSet::new();
            let count = match percent {
                0.0 => usize::from(*name == "IsClose"),
                _ => ((rows.len() as f64 * percent / 100.0).round() as usize).max(1),
            };
            // Every agent still sees itself.
            while changed.len() < count {
                let (x, y) = rows[(self.below)(rows.len() as u32) as usize];
                if x != y {
                    changed.insert(((x, y), false));
                }
            }
            for ((x, y), _) in changed.clone() {
                set.remove(&(x, y));
            }
            while changed.len() < 2 * count {
                let x = (self.below)(self.agents);
                let pair = (x, (x + 1 + (self.below)(60)) % self.agents);
                if pair.0 != pair.1 && !changed.contains(&(pair, false)) && set.insert(pair) {
                    changed.insert((pair, true));
                }
            }
            *rows = set.iter().copied().collect();
            changes.push((*name, changed.into_iter().collect()));
        }
        changes
    }
}

fn measure(agents: u32, percent: f64, ticks: usize, strategy: Strategy, peers: bool) {
    let mut city = City::new(agents);
    let mut session = engine::load(Kind::City.program(), &city.facts);
    session.set_strategy(strategy);
    session.commit().expect("within the limit");
    let (times, strata) = timely::execute_directly(move |worker| {
        let mut dataflow = peers.then(|| differential::Dataflow::new(worker, Kind::City, &city.facts));
        let mut times: [Vec<Duration>; 3] = Default::default();
        let mut strata = String::new();
        // Warm up.
        for tick in 0..ticks + 10 {
            let changes = city.change(percent);
            let start = ThreadTime::now();
            let delta = engine::change(&mut session, &changes);
            let mut took = [start.elapsed(), Duration::ZERO, Duration::ZERO];
            drop(delta);
            strata = (session.work().strata.iter())
                .map(|work| match work {
                    StratumStats::Skipped => '-',
                    StratumStats::Maintained(_) => 'm',
                    StratumStats::Recomputed(work) if work.given_up > 0 => 'R',
                    StratumStats::Recomputed(_) => 'r',
                })
                .collect();
            if let Some(dataflow) = &mut dataflow {
                let counts = engine::lengths(&session, Kind::City.derived());
                let start = ThreadTime::now();
                dataflow.tick(worker, &changes);
                took[1] = start.elapsed();
                assert_eq!(dataflow.counts(), counts, "differential-dataflow");
                let start = ThreadTime::now();
                let recomputed = datafrog::counts(Kind::City, &city.facts).expect("it has the program");
                took[2] = start.elapsed();
                assert_eq!(recomputed, counts, "datafrog");
            }
            if tick >= 10 {
                times.iter_mut().zip(took).for_each(|(times, took)| times.push(took));
            }
        }
        (times, strata)
    });
    let [engine, differential, datafrog] = times.map(|mut times| {
        times.sort_unstable();
        times.get(times.len() / 2).map_or(0.0, |time| time.as_secs_f64() * 1e6)
    });
    let change = match percent {
        0.0 => "1 pair".to_string(),
        _ => format!("{percent} %"),
    };
    println!(
        "{agents:>6} {:>13} {change:>6} {engine:>12.1} {differential:>13.1} {datafrog:>12.1} {:>12.2} {:>12.2}  {strata} {strategy:?}",
        City::new(agents).size(),
        engine / differential,
        engine / datafrog,
    );
}
