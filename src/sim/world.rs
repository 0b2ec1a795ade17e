//! What does not change during a run: the scenario, its map, roads and rules.

use super::executor::compile;
use super::vocabulary::Vocabulary;
use crate::city::{CityMap, Router};
use crate::config::Scenario;
use crate::diag::Diagnostic;
use crate::engine::Program;
use crate::engine::dense::{Counting, Dense};
use std::sync::Arc;

/// A scenario made ready: immutable, shared by every simulation over it.
#[derive(Debug)]
pub struct World {
    /// The configuration.
    pub scenario: Scenario,
    /// The rules.
    pub program: Program,
    /// The predicates and actions of both.
    pub vocabulary: Vocabulary,
    /// The map and the routes on it.
    pub router: Router,
}

impl World {
    /// Generates the map, builds its roads and binds the predicates to the rules.
    ///
    /// # Errors
    /// A map that cannot be generated, or rules that do not fit the configuration.
    pub fn new(scenario: Scenario, program: Program) -> Result<World, Vec<Diagnostic>> {
        let vocabulary = Vocabulary::bind(&scenario, &program)?;
        let map = CityMap::generate(&scenario.map).map_err(|fault| vec![fault])?;
        Ok(World {
            router: Router::new(Arc::new(map), scenario.routing),
            scenario,
            program,
            vocabulary,
        })
    }

    /// The rules for the dense executor.
    ///
    /// # Errors
    /// `limit-exceeded` if it cannot evaluate them; the message tells why.
    pub fn compile(&self, counting: Counting) -> Result<Dense, Diagnostic> {
        compile(&self.program, &self.vocabulary, counting)
    }

    /// The map.
    pub fn map(&self) -> &CityMap {
        self.router.map()
    }
}
