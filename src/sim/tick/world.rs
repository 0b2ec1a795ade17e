//! The immutable part of a run: scenario, map, roads and rules.

use crate::city::{Action, AgentKind, AgentSet, Split};
use crate::city::{CityMap, Places, Router};
use crate::config::Scenario;
use crate::datalog::codes;
use crate::datalog::dense::TrackFirings;
use crate::datalog::{Clause, ClauseId, Literal};
use crate::datalog::{Limits, Program};
use crate::diag::Diagnostic;
use crate::sim::tick::executor::{DenseRules, compile, compile_divided};
use crate::sim::tick::external::{ExternalPredicates, check_names, missing};
use crate::sim::tick::memory::Watched;
use crate::sim::tick::vocabulary::Vocabulary;
use crate::sim::tick::window::Plan;
use std::sync::{Arc, OnceLock};

/// The default limits of an evaluation of one tick or scene by the relational executor. A city needs far less; the
/// defaults of a session would let a costly rule run for minutes.
pub const TICK_LIMITS: Limits = Limits {
    rows: 10_000_000,
    steps: 1_000_000_000,
    bytes: 4 << 30,
};

/// A prepared scenario. It is immutable and shared by all simulations that use it.
#[derive(Debug)]
pub struct World {
    /// The configuration.
    pub scenario: Scenario,
    /// The rules.
    pub program: Program,
    /// The predicates and actions that the scenario and the program share.
    pub vocabulary: Vocabulary,
    /// The map and the routes on it.
    pub router: Router,
    /// The limits of each evaluation of the rules by the relational executor. What the rules read of earlier ticks has the
    /// same limit of memory. [`World::new`] sets [`TICK_LIMITS`].
    pub limits: Limits,
    /// Computes the external predicates.
    external: Option<Arc<dyn ExternalPredicates>>,
    /// Cells for placing the agents of each split, computed once and shared by all simulations.
    places: [OnceLock<Arc<Places>>; 3],
    /// The dense plan without firing counts, compiled once and shared by all simulations.
    plan: OnceLock<Arc<Plan>>,
    /// The clauses whose firings are counted, listed once and shared by all simulations.
    counted: OnceLock<Arc<[ClauseId]>>,
}

impl World {
    /// Generates the map, builds its roads and binds the predicates to the rules.
    ///
    /// # Errors
    /// The map cannot be generated, or the rules do not fit the configuration.
    pub fn new(scenario: Scenario, program: Program) -> Result<World, Vec<Diagnostic>> {
        let vocabulary = Vocabulary::bind(&scenario, &program)?;
        let map = CityMap::generate(&scenario.map).map_err(|fault| vec![fault])?;
        Ok(World {
            router: Router::new(Arc::new(map), scenario.routing),
            scenario,
            program,
            vocabulary,
            limits: TICK_LIMITS,
            external: None,
            places: Default::default(),
            plan: OnceLock::new(),
            counted: OnceLock::new(),
        })
    }

    /// Sets what computes the external predicates of the configuration in the simulations of this world.
    ///
    /// # Errors
    /// `external-predicate` if it computes a predicate that is not external, or one twice.
    pub fn set_external(&mut self, external: Arc<dyn ExternalPredicates>) -> Result<(), Diagnostic> {
        check_names(&self.vocabulary, &self.scenario.name, &external.names())?;
        self.external = Some(external);
        Ok(())
    }

    /// Returns what computes the external predicates, if anything does.
    pub fn external(&self) -> Option<&Arc<dyn ExternalPredicates>> {
        self.external.as_ref()
    }

    /// Checks that each external predicate has a function.
    ///
    /// # Errors
    /// `external-predicate` if one lacks it.
    pub(super) fn check_external(&self) -> Result<(), Diagnostic> {
        let given = self
            .external
            .as_ref()
            .map_or_else(Vec::new, |external| external.names());
        let names = self.vocabulary.externals().map(|(known, _)| known.name.as_str());
        let lacking: Vec<&str> = names.filter(|name| !given.iter().any(|given| given == name)).collect();
        match lacking.as_slice() {
            [] => Ok(()),
            names => Err(missing(&self.scenario, names)),
        }
    }

    /// Returns the start and goal cells of a split with the agents `set`.
    pub(super) fn places(&self, split: Split, set: &AgentSet) -> Arc<Places> {
        let make = || {
            let region = set.region.as_ref().map(|region| &region.value);
            let trip = set.trip.map(|cells| cells.value);
            Arc::new(Places::of(&self.router, self.scenario.trip_ends, region, trip))
        };
        Arc::clone(self.places[split as usize].get_or_init(make))
    }

    /// Returns [`World::clauses`] as a list.
    pub(super) fn counted_clauses(&self) -> Arc<[ClauseId]> {
        Arc::clone(self.counted.get_or_init(|| self.clauses().collect()))
    }

    /// Returns the plan of the dense executor, which may hand over a part of the rules.
    ///
    /// # Errors
    /// `dense-unsupported` if nothing remains for it.
    pub(super) fn plan(&self, counting: TrackFirings) -> Result<Arc<Plan>, Diagnostic> {
        if let (TrackFirings::Off, Some(plan)) = (counting, self.plan.get()) {
            return Ok(Arc::clone(plan));
        }
        let sets = self.scenario.splits.iter().map(|(_, set)| set);
        let kinds = sets.flat_map(AgentSet::kinds);
        let members = kinds.flat_map(|(name, groups)| groups.iter().map(move |group| (name.kind, &group.concepts)));
        let task = self.scenario.task.iter().flat_map(|task| &task.ego);
        let egos = task.flat_map(|ego| ego.concepts.iter().map(|(_, concepts)| (AgentKind::Car, concepts)));
        let agents = egos.chain(members);
        let rules = compile_divided(self.program.rules(), &self.vocabulary, counting)?;
        let plan = Arc::new(Plan::new(
            rules,
            &self.vocabulary,
            self.router.map(),
            self.scenario.view,
            agents,
        ));
        Ok(match counting {
            TrackFirings::Off => Arc::clone(self.plan.get_or_init(|| plan)),
            _ => plan,
        })
    }

    /// Compiles the rules for the dense executor.
    ///
    /// # Errors
    /// `dense-unsupported` if it cannot evaluate them; the message names the reason.
    pub fn compile(&self, counting: TrackFirings) -> Result<DenseRules, Diagnostic> {
        compile(self.program.rules(), &self.vocabulary, counting)
    }

    /// Checks that the rules read no earlier ticks. `what` names things that have a single tick, in the plural.
    ///
    /// # Errors
    /// `rule-mismatch` if the rules have a temporal operator.
    pub fn without_time(&self, what: &str) -> Result<(), Diagnostic> {
        let rules = self.program.rules();
        rules.pasts.first().map_or(Ok(()), |past| {
            let message = format!("{what} have no earlier ticks, but the rules have temporal operators");
            let fault =
                Diagnostic::new(codes::RULE_MISMATCH, message).help("use rules without temporal operators here");
            Err(fault.at(rules.predicates[past.predicate.index()].span, "this looks back"))
        })
    }

    /// Checks that the rules draw nothing. `what` is known without draws, in the plural.
    ///
    /// # Errors
    /// `rule-mismatch` if they do.
    pub fn without_draws(&self, what: &str) -> Result<(), Diagnostic> {
        let rules = self.program.rules();
        let Some(chance) = rules.chance else { return Ok(()) };
        let message = format!("{what} draw nothing, but clauses of the rules have probabilities");
        let fault = Diagnostic::new(codes::RULE_MISMATCH, message).help("use rules without probabilities here");
        let reads =
            |clause: &&Clause| (clause.body.iter().filter_map(Literal::atom)).any(|atom| atom.predicate == chance);
        Err(match rules.clauses.iter().find(reads) {
            Some(clause) => fault.at(clause.span, "this draws"),
            None => fault,
        })
    }

    /// Checks that nothing goes beyond the published city: the rules read neither quantities, nor earlier ticks, nor
    /// facts that a function computes, and draw nothing; actions and kinds of agents are the standard ones. `what`
    /// knows only these, in the plural.
    ///
    /// # Errors
    /// `rule-mismatch` if something does.
    pub fn only_standard(&self, what: &str) -> Result<(), Diagnostic> {
        self.without_draws(what)?;
        self.vocabulary.without_quantities(what)?;
        self.vocabulary.without_externals(what)?;
        self.vocabulary.only_standard_actions(what)?;
        self.without_time(what)?;
        if let Some(own) = self.scenario.kinds.own().first() {
            let message = format!(
                "{what} have cars and pedestrians only, not `{}`",
                own.name.value.as_str()
            );
            let fault = Diagnostic::new(codes::RULE_MISMATCH, message).at(own.name.span, "defined here");
            return Err(fault.help("use a configuration without `kinds`"));
        }
        match self.scenario.kinds.is_standard() {
            true => Ok(()),
            false => {
                let message = format!("{what} have the usual speeds only, but `kinds` changes `cells`");
                let fault = Diagnostic::new(codes::RULE_MISMATCH, message);
                Err(fault.help("use a configuration without `kinds`"))
            }
        }
    }

    /// Returns the predicates that temporal operators are about, for this number of agents.
    pub(super) fn watched(&self, agents: usize) -> Watched {
        let rules = self.program.rules();
        Watched::of(&rules.pasts, agents, |predicate| {
            rules.predicates[predicate.index()].arity()
        })
    }

    /// Returns the clauses whose firings are counted: in source order those with a body and a visible head, then the
    /// facts of actions.
    pub fn clauses(&self) -> impl Iterator<Item = ClauseId> + '_ {
        let rules = self.program.rules();
        let all =
            || (0..rules.clauses.len()).map(|index| ClauseId(u32::try_from(index).expect("fewer than 2^32 clauses")));
        let is_visible_rule = |clause: &ClauseId| {
            let clause = &rules.clauses[clause.index()];
            !clause.body.is_empty() && !rules.predicates[clause.head.predicate.index()].hidden
        };
        let is_action_fact = |clause: &ClauseId| {
            let clause = &rules.clauses[clause.index()];
            clause.body.is_empty() && self.vocabulary.action_of(clause.head.predicate).is_some()
        };
        all().filter(is_visible_rule).chain(all().filter(is_action_fact))
    }

    /// Returns the clauses of [`World::clauses`], each with the action that it derives, if any.
    pub fn clause_actions(&self) -> impl Iterator<Item = (ClauseId, Option<Action>)> + '_ {
        let rules = self.program.rules();
        self.clauses().map(|clause| {
            let head = rules.clauses[clause.index()].head.predicate;
            (clause, self.vocabulary.action_of(head))
        })
    }

    /// Returns the map.
    pub fn map(&self) -> &CityMap {
        self.router.map()
    }

    /// Returns the map if a predicate says where routes leave intersections; otherwise nobody needs to look along them.
    pub(crate) fn map_of_exits(&self) -> Option<&CityMap> {
        self.vocabulary.has_exits.then(|| self.map())
    }
}
