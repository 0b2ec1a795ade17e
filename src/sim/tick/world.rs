//! What does not change during a run: the scenario, its map, roads and rules.

use crate::city::{AgentSet, Split};
use crate::city::{CityMap, Places, Router};
use crate::config::Scenario;
use crate::datalog::ClauseId;
use crate::datalog::Program;
use crate::datalog::dense::{Dense, TrackFirings};
use crate::diag::Diagnostic;
use crate::sim::tick::executor::compile;
use crate::sim::tick::vocabulary::Vocabulary;
use crate::sim::tick::window::Plan;
use std::sync::{Arc, OnceLock};

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
    /// What all cities of a split need to place agents, made with the first one.
    places: [OnceLock<Arc<Places>>; 3],
    /// What all cities that count no firings need to decide, made with the first one.
    plan: OnceLock<Arc<Plan>>,
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
            places: Default::default(),
            plan: OnceLock::new(),
        })
    }

    /// Where the agents of a split start and arrive; `set` are those.
    pub(super) fn places(&self, split: Split, set: &AgentSet) -> Arc<Places> {
        let make = || {
            let [region, trip] = [&set.region, &set.trip].map(|cells| cells.as_ref().map(|cells| cells.value));
            Arc::new(Places::new(&self.router, region, trip))
        };
        Arc::clone(self.places[split as usize].get_or_init(make))
    }

    /// How cities decide by the dense executor.
    ///
    /// # Errors
    /// As [`World::compile`].
    pub(super) fn plan(&self, counting: TrackFirings) -> Result<Arc<Plan>, Diagnostic> {
        if let (TrackFirings::Off, Some(plan)) = (counting, self.plan.get()) {
            return Ok(Arc::clone(plan));
        }
        let plan = Plan::new(self.compile(counting)?, &self.vocabulary, self.scenario.view);
        let plan = Arc::new(plan);
        Ok(match counting {
            TrackFirings::Off => Arc::clone(self.plan.get_or_init(|| plan)),
            _ => plan,
        })
    }

    /// The rules for the dense executor.
    ///
    /// # Errors
    /// `dense-unsupported` if it cannot evaluate them; the message names the reason.
    pub fn compile(&self, counting: TrackFirings) -> Result<Dense, Diagnostic> {
        compile(self.program.rules(), &self.vocabulary, counting)
    }

    /// The clauses whose firings are counted, in the order of the text: those with a body that the author wrote.
    pub fn clauses(&self) -> impl Iterator<Item = ClauseId> + '_ {
        let rules = self.program.rules();
        let counted = |clause: &ClauseId| {
            let clause = &rules.clauses[clause.index()];
            !clause.body.is_empty() && !rules.relations[clause.head.relation.index()].hidden
        };
        (0..rules.clauses.len())
            .map(|index| ClauseId(u32::try_from(index).expect("fewer than 2^32 clauses")))
            .filter(counted)
    }

    /// The map.
    pub fn map(&self) -> &CityMap {
        self.router.map()
    }
}
