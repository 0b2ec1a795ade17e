//! External predicates: a function of the caller computes their facts before each tick.
//!
//! A [`World`](crate::sim::World) has one [`ExternalPredicates`]. Every simulation of the world calls it once per tick, on the thread that
//! runs the tick, so that both executors, observers and traces read the same facts.
// Decision: docs/decisions/city.md#d004

use crate::city::{Agent, CityMap};
use crate::config::Scenario;
use crate::datalog::internal::size;
use crate::diag::{self, Diagnostic, Limit, did_you_mean, listed};
use crate::predicate::{Definition, External};
use crate::sim::codes;
use crate::sim::tick::vocabulary::{BasePredicate, Vocabulary};
use std::fmt::Debug;

/// Computes the facts of the external predicates of a configuration: `IsGreen: {external: agent}`.
///
/// The facts must depend on the [`CityState`] only. Otherwise runs with the same seed differ.
pub trait ExternalPredicates: Debug + Send + Sync {
    /// Returns the names of the predicates that it computes.
    fn names(&self) -> Vec<String>;

    /// Adds the facts that hold in this state to `facts`, which has none.
    ///
    /// # Errors
    /// A reason that ends the sentence "the external predicates failed in tick 3: ".
    fn compute(&self, state: &CityState<'_>, facts: &mut ExternalFacts) -> Result<(), String>;
}

/// The state of a city on which a tick is decided.
#[derive(Clone, Copy, Debug)]
pub struct CityState<'a> {
    /// The configuration.
    pub scenario: &'a Scenario,
    /// The base predicates, with the [external ones](Vocabulary::externals).
    pub vocabulary: &'a Vocabulary,
    /// The map.
    pub map: &'a CityMap,
    /// The number of the tick, from 0.
    pub tick: u64,
    /// The agents, in list order.
    pub agents: &'a [Agent],
}

/// The facts of the external predicates in a tick, or of the predicates that a session derives for the dense executor.
///
/// There is one set of agents per predicate over one agent, and one set per agent and predicate over two.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ExternalFacts {
    agents: usize,
    /// The words of a set.
    words: usize,
    tables: Vec<Table>,
}

#[derive(Clone, Debug, PartialEq, Eq)]
struct Table {
    arity: External,
    bits: Vec<u64>,
}

impl ExternalFacts {
    /// Facts of no predicates.
    pub(super) const NONE: ExternalFacts = ExternalFacts {
        agents: 0,
        words: 0,
        tables: Vec::new(),
    };

    /// Creates facts about this number of agents, none of which hold.
    pub(super) fn new(predicates: impl Iterator<Item = External>, agents: usize) -> ExternalFacts {
        let words = agents.div_ceil(64);
        let table = |arity: External| Table {
            arity,
            bits: vec![
                0;
                match arity {
                    External::Agent => words,
                    External::Pair => words * agents,
                }
            ],
        };
        ExternalFacts {
            agents,
            words,
            tables: predicates.map(table).collect(),
        }
    }

    /// Variant of [`new`](ExternalFacts::new) for the agents of a state.
    ///
    /// # Errors
    /// `limit-exceeded` if an array with a byte per pair of agents exceeds `limit` bytes.
    pub(super) fn within(state: &CityState<'_>, limit: u64) -> Result<ExternalFacts, Diagnostic> {
        let agents = state.agents.len();
        let mut pairs = state
            .vocabulary
            .externals()
            .filter(|(_, arity)| *arity == External::Pair);
        match pairs.next() {
            Some((known, _)) if (agents as u64).saturating_pow(2) > limit => {
                let message = format!(
                    "the facts of `{}` about {agents} agents take more than {}",
                    known.name,
                    size(limit)
                );
                Err(Diagnostic::new(diag::codes::LIMIT_EXCEEDED, message).exceeds(Limit::Memory(limit)))
            }
            _ => {
                let predicates = state.vocabulary.externals().map(|(_, arity)| arity);
                Ok(ExternalFacts::new(predicates, agents))
            }
        }
    }

    /// Sets for which agents a predicate holds: `holds` has one element per agent, or one per pair of agents, with that
    /// of the agents i and j at i times the number of agents plus j. No agent is related to itself.
    ///
    /// `predicate` is its position among [`Vocabulary::externals`].
    ///
    /// # Panics
    /// If the number of elements differs.
    pub fn set(&mut self, predicate: usize, holds: &[bool]) {
        let (agents, words) = (self.agents, self.words);
        let Table { arity, bits } = &mut self.tables[predicate];
        let expected = agents.pow(if *arity == External::Pair { 2 } else { 1 });
        assert!(holds.len() == expected, "{} elements, not {expected}", holds.len());
        bits.fill(0);
        if agents == 0 {
            return;
        }
        for (row, (set, holds)) in bits.chunks_exact_mut(words).zip(holds.chunks_exact(agents)).enumerate() {
            for (word, holds) in set.iter_mut().zip(holds.chunks(64)) {
                *word = (holds.iter().rev()).fold(0, |word, holds| word << 1 | u64::from(*holds));
            }
            if *arity == External::Pair {
                set[row / 64] &= !(1 << (row % 64));
            }
        }
    }

    /// Removes all facts.
    pub(super) fn clear(&mut self) {
        self.tables.iter_mut().for_each(|table| table.bits.fill(0));
    }

    /// Adds a fact; the second agent counts only in predicates over two.
    pub(super) fn add(&mut self, predicate: usize, first: usize, second: usize) {
        let table = &mut self.tables[predicate];
        let (row, member) = match table.arity {
            External::Agent => (0, first),
            External::Pair => (first, second),
        };
        table.bits[row * self.words + member / 64] |= 1 << (member % 64);
    }

    /// Returns whether a predicate holds; the second agent counts only in predicates over two.
    #[inline]
    pub(crate) fn holds(&self, predicate: usize, first: u32, second: u32) -> bool {
        let table = &self.tables[predicate];
        let (row, member) = match table.arity {
            External::Agent => (0, first as usize),
            External::Pair => (first as usize, second as usize),
        };
        table.bits[row * self.words + member / 64] >> (member % 64) & 1 != 0
    }

    /// Returns the agents for which a predicate over one agent holds, as bits.
    pub(crate) fn members(&self, predicate: usize) -> &[u64] {
        &self.tables[predicate].bits
    }

    /// Returns the agents that a predicate over two relates to an agent, as bits.
    pub(crate) fn row(&self, predicate: usize, agent: usize) -> &[u64] {
        &self.tables[predicate].bits[agent * self.words..][..self.words]
    }

    /// Returns the rows of a predicate as in [`Facts`](crate::sim::Facts).
    pub(crate) fn rows(&self, predicate: usize) -> Vec<[u32; 2]> {
        let Table { arity, bits } = &self.tables[predicate];
        let sets = bits.chunks_exact(self.words.max(1)).zip(0..);
        let rows = sets.flat_map(|(set, row)| {
            let members = set.iter().zip((0..).step_by(64)).flat_map(|(&word, first)| {
                let bits = (0..64).filter(move |bit| word >> bit & 1 != 0);
                bits.map(move |bit| first + bit)
            });
            members.map(move |member| match arity {
                External::Agent => [member, 0],
                External::Pair => [row, member],
            })
        });
        rows.collect()
    }
}

impl Vocabulary {
    /// Returns the external predicates in the order of the scenario.
    pub fn externals(&self) -> impl Iterator<Item = (&BasePredicate, External)> {
        let predicates = self.predicates.iter();
        predicates.filter_map(|predicate| match predicate.definition {
            Definition::External(arity) => Some((predicate, arity)),
            _ => None,
        })
    }

    /// Checks that the configuration has no external predicates. `what` lacks a function that computes them, in the
    /// plural.
    ///
    /// # Errors
    /// `external-predicate` if it has one.
    pub fn without_externals(&self, what: &str) -> Result<(), Diagnostic> {
        self.externals().next().map_or(Ok(()), |(known, _)| {
            let message = format!(
                "{what} know no function for the external predicate `{}` of the configuration",
                known.name
            );
            let fault = Diagnostic::new(codes::EXTERNAL_PREDICATE, message);
            Err(fault.help("select other predicates with `use`"))
        })
    }
}

/// Stands for functions that are not known, where no tick runs: no fact holds.
#[cfg(feature = "cli")]
#[derive(Clone, Debug)]
pub(crate) struct Unprovided(Vec<String>);

#[cfg(feature = "cli")]
impl Unprovided {
    /// Stands for all external predicates of a vocabulary.
    pub fn of(vocabulary: &Vocabulary) -> Unprovided {
        let names = vocabulary.externals().map(|(known, _)| known.name.clone());
        Unprovided(names.collect())
    }
}

#[cfg(feature = "cli")]
impl ExternalPredicates for Unprovided {
    fn names(&self) -> Vec<String> {
        self.0.clone()
    }

    fn compute(&self, _: &CityState<'_>, _: &mut ExternalFacts) -> Result<(), String> {
        Ok(())
    }
}

/// Checks that `names` are external predicates of a vocabulary.
pub(super) fn check_names(vocabulary: &Vocabulary, config: &str, names: &[String]) -> Result<(), Diagnostic> {
    let known: Vec<&str> = vocabulary.externals().map(|(known, _)| known.name.as_str()).collect();
    for (position, name) in names.iter().enumerate() {
        if names[..position].contains(name) {
            let message = format!("two functions are given for the predicate `{name}`");
            return Err(Diagnostic::new(codes::EXTERNAL_PREDICATE, message).help("give one"));
        }
        if known.contains(&name.as_str()) {
            continue;
        }
        let message = format!("`{name}` is no external predicate of the configuration `{config}`");
        let fault = Diagnostic::new(codes::EXTERNAL_PREDICATE, message);
        return Err(match (did_you_mean(name, known.iter().copied()), known.is_empty()) {
            (Some(near), _) => fault.help(format!("did you mean `{near}`?")),
            (None, true) => fault.help(format!(
                "define it under `predicates`: `define: {{{name}: {{external: agent}}}}`, or `pair` for two agents"
            )),
            (None, false) => fault.help(format!("it has: {}", listed(&known))),
        });
    }
    Ok(())
}

/// Returns the diagnostic for external predicates without a function.
pub(super) fn missing(scenario: &Scenario, names: &[&str]) -> Diagnostic {
    let place = |name: &str| {
        let config = scenario
            .predicates
            .iter()
            .find(|predicate| predicate.name.value == name);
        config.map(|config| config.name.span)
    };
    let quoted: Vec<String> = names.iter().map(|name| format!("`{name}`")).collect();
    let message = format!("no function computes {}", quoted.join(", "));
    let mut fault = Diagnostic::new(codes::EXTERNAL_PREDICATE, message);
    for (position, span) in names.iter().filter_map(|name| place(name)).enumerate() {
        fault = match position {
            0 => fault.at(span, "this predicate is external"),
            _ => fault.also(span, "and this one"),
        };
    }
    fault
        .help("pass a Python function to a simulation or an environment: `predicates=[...]`")
        .note("a trace of such a run replays without the function")
}
