//! Many cities on several threads.

use crate::city::Action;
use crate::diag::Diagnostic;
use crate::sim::tick::pool::{start_threads, threads_of};
use crate::sim::tick::simulation::Simulation;
use crate::threads::Pool;
use rayon::prelude::*;

/// Independent cities that advance in lockstep. Each gives the same results as it does alone.
pub struct Batch {
    cities: Vec<Simulation>,
    threads: Option<Pool>,
}

impl Batch {
    /// Creates a batch that runs on `threads` threads. Each city itself should use one thread.
    ///
    /// # Errors
    /// `limit-exceeded` if the threads cannot be started.
    pub fn new(cities: Vec<Simulation>, threads: usize) -> Result<Batch, Diagnostic> {
        Ok(Batch {
            cities,
            threads: start_threads(threads)?,
        })
    }

    /// Returns the cities.
    pub fn cities(&self) -> &[Simulation] {
        &self.cities
    }

    /// Returns the cities for changes, for example [`Simulation::restart`].
    pub fn cities_mut(&mut self) -> &mut [Simulation] {
        &mut self.cities
    }

    /// Runs one tick of every city. `controls` maps the position of a city to its controls (see [`Simulation::tick`]).
    ///
    /// # Errors
    /// As [`Simulation::tick`]: the error of the first city that fails. The other cities advance.
    pub fn tick<'c>(&mut self, controls: impl Fn(usize) -> &'c [(usize, Action)] + Sync) -> Result<(), Diagnostic> {
        let fault = |(position, city): (usize, &mut Simulation)| Some((position, city.tick(controls(position)).err()?));
        let faults = match &threads_of(self.threads.as_ref())? {
            Some(pool) => pool.install(|| {
                let faults = self.cities.par_iter_mut().enumerate().filter_map(fault);
                faults.min_by_key(|(position, _)| *position)
            }),
            None => (self.cities.iter_mut().enumerate().filter_map(fault)).min_by_key(|(position, _)| *position),
        };
        faults.map_or(Ok(()), |(_, fault)| Err(fault))
    }
}
