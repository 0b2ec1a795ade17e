//! Decides on observations without a city.

use crate::cancel::Cancel;
use crate::city::{Action, AgentKind};
use crate::datalog::dense::holding;
use crate::diag::Diagnostic;
use crate::sim::observe::observed::{Atoms, Entities, Observed};
use crate::sim::observe::observer::Oracle;
use crate::sim::observe::rule_monitor::Violations;
use std::sync::Arc;

/// Applies rules to observations: vectors that [`Observer::write`](crate::sim::Observer::write) wrote.
pub struct Decider {
    oracle: Arc<Oracle>,
    atoms: Atoms,
    /// The entities of the observation.
    entities: Entities<'static>,
    violations: Violations,
    broken: Vec<usize>,
}

impl Decider {
    /// Creates a decider with the rules of an oracle.
    ///
    /// # Errors
    /// `rule-mismatch` if the rules draw or read earlier ticks, which observations do not contain.
    pub fn new(oracle: Arc<Oracle>) -> Result<Decider, Diagnostic> {
        let world = oracle.world();
        world.without_draws("observations")?;
        world.without_time("observations")?;
        Ok(Decider {
            atoms: oracle.no_atoms(),
            entities: Entities::Numbered {
                present: 1,
                most: oracle.entities(),
            },
            violations: Violations::new(oracle.monitor()),
            broken: Vec::new(),
            oracle,
        })
    }

    /// Returns the clauses that an action of the ego violates, as positions in [`Oracle::constraints`]. It reads the
    /// observation as [`Decider::action`] does.
    ///
    /// # Errors
    /// As [`Decider::action`].
    ///
    /// # Panics
    /// If the observation is shorter than [`Oracle::width`].
    pub fn violations(&mut self, observation: &[f32], action: Action, cancel: &Cancel) -> Result<&[usize], Diagnostic> {
        self.read(observation);
        let observed = Observed::new(&self.atoms, self.entities, cancel);
        let monitor = self.oracle.monitor();
        self.violations
            .violations(monitor, observed, action, &mut self.broken)?;
        Ok(&self.broken)
    }

    /// Returns the action of the ego. A fact holds if its number exceeds 0.5.
    ///
    /// Observations have neither the number of entities nor `Sees`. The entities are the ego, those with a fact or a
    /// number other than 0, and those before them. Each of them sees all of them.
    ///
    /// # Errors
    /// `limit-exceeded` if the rules derive too many rows; `cancelled` on cancellation.
    ///
    /// # Panics
    /// If the observation is shorter than [`Oracle::width`].
    pub fn action(&mut self, observation: &[f32], cancel: &Cancel) -> Result<Action, Diagnostic> {
        self.read(observation);
        let vocabulary = &self.oracle.world().vocabulary;
        let observed = Observed::new(&self.atoms, self.entities, cancel);
        let derived = self.violations.derived(self.oracle.monitor(), vocabulary, observed)?;
        Ok(vocabulary.decide(Some(AgentKind::Car.into()), derived))
    }

    /// Reads the facts of an observation.
    fn read(&mut self, observation: &[f32]) {
        let (oracle, atoms) = (&*self.oracle, &mut self.atoms);
        let vocabulary = &oracle.world().vocabulary;
        let most = oracle.entities();
        let (truths, numbers) = observation.split_at(oracle.atoms_width());
        let mut all = 1 | oracle.numbers().mentioned(numbers);
        for (&(set, _), values) in oracle.sets().iter().zip(truths.chunks_exact(most)) {
            atoms.words[set] = bits(values);
            let related = atoms.layout.related(set).filter(|_| atoms.words[set] != 0);
            all |= atoms.words[set] | related.map_or(0, |first| 1 << first);
        }
        let present = 64 - all.leading_zeros() as usize;
        let sees = atoms.rows_mut(vocabulary.sees);
        sees.fill(0);
        sees[..present].fill(u64::MAX >> (64 - present));
        oracle.numbers().read(numbers, present, &mut atoms.values);
        self.violations.forget();
        self.entities = Entities::Numbered { present, most };
    }
}

/// Returns the positions of the numbers above 0.5.
fn bits(values: &[f32]) -> u64 {
    holding(values.iter().map(|value| *value > 0.5))
}
