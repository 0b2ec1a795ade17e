//! Computes the observation of one agent, the action that the rules choose for it, and the clauses that an action
//! violates.
//!
//! In a simulation, the rules decide on everything in an agent's field of view. The ego of a task observes only a few
//! entities of it: itself and the first others in list order. An [`Oracle`] is the immutable part, an [`Observer`]
//! holds the facts of one state.
//!
//! The observed facts are those that hold for the observed entities; `Sees` relates the ego to all of them. To judge an
//! action, the observer fixes the action predicates in the bodies of all clauses: only this action holds, and only for
//! the ego. The others' next actions are not observable, so no action holds for them.

use crate::city::{Action, Agent, AgentKind};
use crate::city::{Area, Cell, FieldOfView};
use crate::config::SensorsConfig;
use crate::datalog::Session;
use crate::datalog::Value;
use crate::datalog::dense::{holding, members};
use crate::diag::Diagnostic;
use crate::predicate::{
    CellTable, Definition, External, Measured, PairRelation, Progress, Quantity, Relation, Static, Views, WORDS,
    with_relation,
};
use crate::rng::Purpose;
use crate::sim::observe::belief::SensorModel;
use crate::sim::observe::numbers::{Numbers, greatest_priority, places};
use crate::sim::observe::observed::{AtomLayout, Atoms, Entities, OBSERVED_MAX, Observed};
use crate::sim::observe::rule_monitor::{ActionConstraint, RuleMonitor, Violations};
use crate::sim::observe::sensors::{FactCounts, Sensing, Sensors};
use crate::sim::observe::share::{self, Fact};
use crate::sim::tick::agent_state::AgentState;
use crate::sim::tick::chance::{Chance, Draws};
use crate::sim::tick::external::ExternalFacts;
use crate::sim::tick::ground::word;
use crate::sim::tick::ground_state::GroundState;
use crate::sim::tick::simulation::Simulation;
use crate::sim::tick::vocabulary::Actions;
use crate::sim::tick::world::World;
use std::sync::Arc;

/// The immutable part of observations, shared by every [`Observer`]: predicates, rules and sizes.
#[derive(Debug)]
pub struct Oracle {
    world: Arc<World>,
    /// The maximum number of observed entities.
    entities: usize,
    /// Whether the nearest entity comes first after the ego, instead of the first in list order.
    nearest_first: bool,
    /// Indexed by predicate of the vocabulary.
    how: Vec<How>,
    layout: AtomLayout,
    /// The sets of [`Atoms`] in the order of an observation, each with the place of its first number there.
    sets: Vec<(usize, usize)>,
    /// What follows the sets.
    numbers: Numbers,
    /// See [`Oracle::priority_scale`].
    priority_scale: f32,
    views: Views,
    monitor: RuleMonitor,
}

/// Consecutive numbers of an observation: the truth values of a predicate, or the values of a quantity.
#[derive(Clone, Debug)]
pub struct ObservedColumn {
    /// The predicate's name. For a quantity of words, followed by the word, as in `Heading=Up`: such a column has
    /// truth values.
    pub name: String,
    /// The position of the predicate in the vocabulary.
    pub predicate: usize,
    /// The number of entities that each number is about, 1 or 2.
    pub arity: usize,
    /// The numbers in the column: those of all lists of so many entities, in lexicographic order.
    pub width: usize,
    /// If the column has values of a quantity, by what they are divided.
    pub scale: Option<f32>,
}

/// The fast form of a predicate.
#[derive(Debug)]
enum How {
    Static(Static),
    Local(CellTable),
    Place(Arc<Area>),
    Pair(PairRelation),
    Quantity(Quantity),
    /// The position among the external predicates.
    External(usize, External),
}

impl Oracle {
    /// Creates an oracle for egos that observe up to `entities` entities, including themselves.
    ///
    /// # Errors
    /// If the rules cannot be planned.
    ///
    /// # Panics
    /// If `entities` is 0 or exceeds [`OBSERVED_MAX`].
    pub fn new(world: Arc<World>, entities: usize) -> Result<Oracle, Diagnostic> {
        assert!((1..=OBSERVED_MAX).contains(&entities), "{entities} entities");
        let vocabulary = &world.vocabulary;
        let mut externals = 0..;
        let how = |definition: &Definition| match definition {
            Definition::Static(predicate) => How::Static(predicate.clone()),
            Definition::Local(predicate) => How::Local(predicate.table()),
            Definition::Place(predicate) => How::Place(predicate.area(world.map())),
            Definition::Pair(pair) => How::Pair(pair.relation(world.router.map())),
            Definition::Quantity(quantity) => How::Quantity(*quantity),
            Definition::External(arity) => How::External(externals.next().expect("it has no end"), *arity),
        };
        let definitions = vocabulary.predicates.iter().map(|predicate| &predicate.definition);
        let how: Vec<How> = definitions.map(how).collect();
        let predicates = how.len();
        let first_pair = how
            .iter()
            .position(|how| matches!(how, How::Pair(_) | How::External(_, External::Pair)));
        let layout = AtomLayout {
            predicates,
            first_pair: first_pair.unwrap_or(predicates),
            entities,
        };
        let observed = how
            .iter()
            .enumerate()
            .filter(|(predicate, _)| *predicate != vocabulary.sees);
        let sets = observed.flat_map(|(predicate, how)| match how {
            How::Pair(_) | How::External(_, External::Pair) => {
                layout.rows(predicate)..layout.rows(predicate) + entities
            }
            How::Static(_) | How::Local(_) | How::Place(_) | How::External(_, External::Agent) => {
                predicate..predicate + 1
            }
            How::Quantity(_) => 0..0,
        });
        Ok(Oracle {
            entities,
            nearest_first: false,
            layout,
            sets: sets.zip((0..).step_by(entities)).collect(),
            numbers: Numbers::new(&world.scenario, world.map(), &vocabulary.predicates, entities),
            priority_scale: greatest_priority(&world.scenario),
            how,
            views: Views::new(world.scenario.view),
            monitor: RuleMonitor::new(&world.program, vocabulary, world.limits)?,
            world,
        })
    }

    /// Returns the facts of an observation without facts.
    pub(super) fn no_atoms(&self) -> Atoms {
        let values = |how: &How| match how {
            How::Quantity(quantity) => vec![None; places(self.entities, quantity.agents())],
            _ => Vec::new(),
        };
        let mut values: Vec<Vec<_>> = self.how.iter().map(values).collect();
        if values.iter().all(Vec::is_empty) {
            values.clear();
        }
        Atoms {
            words: vec![0; self.layout.len()],
            values,
            layout: self.layout,
        }
    }

    /// Orders observed entities by their distance from the ego, those at the same distance in list order. Without it,
    /// all are in list order. Observers see the same entities in both cases.
    #[must_use]
    pub fn nearest_first(self, nearest_first: bool) -> Oracle {
        Oracle { nearest_first, ..self }
    }

    /// Returns the world: scenario, map, roads and rules.
    pub fn world(&self) -> &Arc<World> {
        &self.world
    }

    /// Returns the maximum number of observed entities.
    pub fn entities(&self) -> usize {
        self.entities
    }

    /// Returns the clauses that demand an action, in source order, without the default.
    pub fn constraints(&self) -> &[ActionConstraint] {
        self.monitor.constraints()
    }

    /// Returns for each observed set: its predicate, the first entity if it is about pairs, and the position of its
    /// first number in an observation.
    pub(super) fn observed_sets(&self) -> impl Iterator<Item = (usize, Option<usize>, usize)> {
        self.sets.iter().map(|&(set, start)| {
            let (predicate, row) = self.layout.predicate(set);
            (predicate, row, start)
        })
    }

    /// Returns the sensors of a configuration for observers of this oracle.
    pub fn sensors(&self, config: SensorsConfig) -> Sensors {
        Sensors::new(config, self.layout, &self.sets, &self.world.vocabulary.predicates)
    }

    /// Returns the clauses of the rules in the form that judges actions.
    pub(super) fn monitor(&self) -> &RuleMonitor {
        &self.monitor
    }

    /// Returns the field of view of the ego.
    fn view(&self, ego: &AgentState) -> FieldOfView {
        FieldOfView::around(ego.at, self.views.of(ego.heading))
    }

    /// Returns the greatest absolute priority that the configuration gives, at least 1.
    pub fn priority_scale(&self) -> f32 {
        self.priority_scale
    }

    /// Returns the sets of [`Atoms`] in the order of an observation, each with the place of its first number there.
    pub(super) fn sets(&self) -> &[(usize, usize)] {
        &self.sets
    }

    /// Returns the quantities of an observation.
    pub(super) fn numbers(&self) -> &Numbers {
        &self.numbers
    }

    /// Returns the length of the vector that [`Observer::write`] fills: all [`Oracle::columns`].
    pub fn width(&self) -> usize {
        self.atoms_width() + self.numbers.width()
    }

    /// Returns the length of the first part of the vector, the truth values of atoms.
    pub(super) fn atoms_width(&self) -> usize {
        self.sets.len() * self.entities
    }

    /// Returns whether observations have the same columns as those of another oracle.
    pub(super) fn observes_like(&self, other: &Oracle) -> bool {
        let columns = |oracle: &Oracle| {
            let columns = oracle.columns().into_iter();
            columns.map(|column| (column.name, column.width)).collect::<Vec<_>>()
        };
        self.nearest_first == other.nearest_first && columns(self) == columns(other)
    }

    /// Returns the columns of an observation; see [`observed_columns`].
    pub fn columns(&self) -> Vec<ObservedColumn> {
        observed_columns(&self.world, self.entities)
    }
}

/// Returns the columns of observations of up to `entities` entities in order: first the predicates without values
/// except `Sees`, in the order of the vocabulary, then the quantities in the same order.
pub fn observed_columns(world: &World, entities: usize) -> Vec<ObservedColumn> {
    let vocabulary = &world.vocabulary;
    let column = |predicate: usize, suffix: &str, arity, scale| ObservedColumn {
        name: format!("{}{suffix}", vocabulary.predicates[predicate].name),
        predicate,
        arity,
        width: places(entities, arity),
        scale,
    };
    let atoms = (vocabulary.predicates.iter().enumerate())
        .filter(|(position, predicate)| *position != vocabulary.sees && predicate.value.is_none())
        .map(|(position, predicate)| column(position, "", predicate.arity, None));
    let numbers = Numbers::new(&world.scenario, world.map(), &vocabulary.predicates, entities);
    let numbers = numbers.columns.iter().map(|known| match known.word {
        Some(word) => column(
            known.predicate,
            &format!("={}", WORDS[word as usize]),
            known.arity(),
            None,
        ),
        None => column(known.predicate, "", known.arity(), Some(known.scale)),
    });
    atoms.chain(numbers).collect()
}

/// Observes the city for one ego.
pub struct Observer {
    oracle: Arc<Oracle>,
    ego: usize,
    /// The static predicates that hold for each agent: a bit per predicate in `words` words.
    steady: Vec<u64>,
    /// The kind and concepts from which `steady` was computed, by agent.
    like: Vec<(AgentKind, Arc<[String]>)>,
    words: usize,
    /// The observed entities, the ego first.
    bodies: Vec<AgentState>,
    atoms: Atoms,
    violations: Violations,
    broken: Vec<usize>,
    /// What the ego reads through sensors.
    sensing: Option<Box<Sensing>>,
    /// Where the rules are applied to other facts than the true ones; `None` without sensors.
    hypothesis: Option<Box<Hypothesis>>,
}

/// Facts that need not be true, and what the rules make of them.
struct Hypothesis {
    atoms: Atoms,
    violations: Violations,
    broken: Vec<usize>,
}

impl Hypothesis {
    /// Returns the actions that the rules derive for the ego.
    fn derive(&mut self, oracle: &Oracle, bodies: &[AgentState], city: &Simulation) -> Result<Actions, Diagnostic> {
        self.violations.forget();
        let facts = observed(&self.atoms, bodies, city);
        self.violations
            .derived(&oracle.monitor, &oracle.world.vocabulary, facts)
    }

    /// Returns whether one of some actions of the ego violates a clause.
    fn applies(
        &mut self,
        oracle: &Oracle,
        bodies: &[AgentState],
        city: &Simulation,
        (clause, actions): (usize, &[Action]),
    ) -> Result<bool, Diagnostic> {
        self.violations.forget();
        for &action in actions {
            let facts = observed(&self.atoms, bodies, city);
            (self.violations).violations(&oracle.monitor, facts, action, &mut self.broken)?;
            if self.broken.contains(&clause) {
                return Ok(true);
            }
        }
        Ok(false)
    }
}

impl Observer {
    /// Creates an observer for an agent, given its position in the list. Call [`Observer::begin`] next.
    pub fn new(oracle: Arc<Oracle>, ego: usize) -> Observer {
        Observer {
            sensing: None,
            hypothesis: None,
            ego,
            steady: Vec::new(),
            like: Vec::new(),
            words: oracle.how.len().div_ceil(64),
            bodies: Vec::with_capacity(oracle.entities),
            atoms: oracle.no_atoms(),
            violations: Violations::new(&oracle.monitor),
            broken: Vec::with_capacity(oracle.constraints().len()),
            oracle,
        }
    }

    /// Adds sensors, which [`Observer::sense`] reads. Beliefs and probabilities need a model.
    ///
    /// # Panics
    /// If a [model](Sensors::needs_model) is needed and missing.
    #[must_use]
    pub fn with_sensors(self, sensors: Arc<Sensors>, model: Option<Arc<SensorModel>>) -> Observer {
        assert!(model.is_some() || !sensors.needs_model(), "these sensors need a model");
        let sensing = Sensing::new(sensors, model, self.oracle.no_atoms());
        Observer {
            hypothesis: Some(Box::new(Hypothesis {
                atoms: self.oracle.no_atoms(),
                violations: Violations::new(&self.oracle.monitor),
                broken: Vec::new(),
            })),
            sensing: Some(Box::new(sensing)),
            ..self
        }
    }

    /// Returns the oracle.
    pub fn oracle(&self) -> &Arc<Oracle> {
        &self.oracle
    }

    /// Returns the position of the ego in the list of agents.
    pub fn ego(&self) -> usize {
        self.ego
    }

    /// Returns the observed entities by their positions in the list of agents, the ego first.
    pub fn entities(&self) -> impl ExactSizeIterator<Item = usize> {
        self.bodies.iter().map(|body| body.agent as usize)
    }

    /// Updates the static predicates of the agents. Call it after every start and restart of the city.
    pub fn begin(&mut self, city: &Simulation) {
        self.violations.forget();
        if let Some(sensing) = &mut self.sensing {
            sensing.begin();
        }
        let agents = city.agents();
        if self.like.len() != agents.len() {
            self.like.clear();
            self.steady.resize(agents.len() * self.words, 0);
        }
        for (position, agent) in agents.iter().enumerate() {
            // Nearly all agents are unchanged, and then their concepts are the same allocation.
            let as_before = |(kind, concepts): &(AgentKind, Arc<[String]>)| {
                *kind == agent.kind && Arc::ptr_eq(concepts, &agent.concepts)
            };
            if self.like.get(position).is_some_and(as_before) {
                continue;
            }
            let is = (agent.kind, Arc::clone(&agent.concepts));
            match self.like.get_mut(position) {
                Some(like) => *like = is,
                None => self.like.push(is),
            }
            let words = &mut self.steady[position * self.words..][..self.words];
            words.fill(0);
            for (predicate, how) in self.oracle.how.iter().enumerate() {
                if let How::Static(fixed) = how
                    && fixed.holds(agent.kind, &agent.concepts)
                {
                    words[predicate / 64] |= 1 << (predicate % 64);
                }
            }
        }
    }

    /// Exchanges working memory. It has no state between observations, so that observers that take turns can share it
    /// and keep it in the cache.
    pub fn swap_memory(&mut self, other: &mut Observer) {
        if Arc::ptr_eq(&self.oracle, &other.oracle) {
            self.violations.swap_memory(&mut other.violations);
        }
    }

    /// Loads what an observation uses into the cache, while other work proceeds. Returns a meaningless sum of what it
    /// reads.
    pub fn prefetch(&self) -> u64 {
        let words = [&self.atoms.words[..], &self.steady];
        let words = words.map(|words| words.iter().step_by(8).fold(0, |sum: u64, word| sum ^ word));
        let bodies = self.bodies.iter().step_by(2);
        let sensed = self.sensing.as_ref().map_or(0, |sensing| sensing.prefetch());
        bodies.fold(words[0] ^ words[1] ^ sensed, |sum: u64, body| {
            sum ^ u64::from(body.agent)
        })
    }

    /// Observes the present state of the city, on which the next tick will be decided.
    ///
    /// # Errors
    /// `external-predicate` if a function that computes one fails.
    pub fn look(&mut self, city: &Simulation) -> Result<(), Diagnostic> {
        let draws = Draws {
            seed: city.seed(),
            time: city.now(),
        };
        self.look_with(city, &draws)
    }

    /// Reads the sensors, if there are any, and what others tell. Call it once per tick, after [`Observer::look`].
    ///
    /// # Errors
    /// `limit-exceeded` if the rules derive too many rows where they decide which facts are relevant.
    pub fn sense(&mut self, city: &Simulation) -> Result<(), Diagnostic> {
        let Some(sensing) = &mut self.sensing else {
            return Ok(());
        };
        let (oracle, bodies) = (&*self.oracle, &self.bodies);
        let of_city = (oracle.world.map(), city.agents());
        sensing.sense(&self.atoms, bodies, of_city, (city.seed(), city.now()));
        if let Some(share) = sensing.sensors().share().copied() {
            let facts = sensing.shareable(&self.atoms, bodies, of_city);
            let known = self.hypothesis.as_mut().expect("it was made with the sensors");
            let derive = |told: &[Fact]| {
                sensing.copy_facts(&mut known.atoms);
                for fact in told {
                    known.atoms.words[fact.set] |= 1 << fact.entity;
                }
                known.derive(oracle, bodies, city)
            };
            let random = city
                .seed()
                .words(Purpose::SHARE, u64::from(bodies[0].agent), city.now());
            let told = share::choose(&share, facts, bodies, derive, random)?;
            sensing.tell(&told);
        }
        Ok(())
    }

    /// Counts the clauses that apply to the ego, which are those that some action violates, by how far it observes
    /// them: fully, if they also apply given what it observes; partly, if it observes some of the facts that they need;
    /// and not at all. The facts that a clause needs are some that hold and without any of which it would not apply.
    /// Without sensors, all are observed fully.
    ///
    /// # Errors
    /// `limit-exceeded` if the rules derive too many rows.
    pub fn observed_clauses(&mut self, city: &Simulation, actions: &[Action]) -> Result<[u32; 3], Diagnostic> {
        let mut applying: Vec<usize> = Vec::new();
        for &action in actions {
            applying.extend_from_slice(self.violations(city, action)?);
        }
        applying.sort_unstable();
        applying.dedup();
        let count = u32::try_from(applying.len()).expect("fewer clauses than 2^32");
        let (Some(sensing), Some(known)) = (&self.sensing, &mut self.hypothesis) else {
            return Ok([count, 0, 0]);
        };
        let (oracle, bodies) = (&*self.oracle, &self.bodies);
        sensing.copy_facts(&mut known.atoms);
        let mut observed = oracle.no_atoms();
        observed.copy_from(&known.atoms);
        let mut counts = [0; 3];
        for clause in applying {
            known.atoms.copy_from(&observed);
            if known.applies(oracle, bodies, city, (clause, actions))? {
                counts[0] += 1;
                continue;
            }
            // Leaves out each fact that is not needed, unobserved ones first.
            known.atoms.copy_from(&self.atoms);
            for first in [true, false] {
                for &(set, _) in oracle.sets() {
                    let unobserved = known.atoms.words[set] & !observed.words[set];
                    let all = if first { unobserved } else { known.atoms.words[set] };
                    for entity in members(&[all]) {
                        known.atoms.words[set] &= !(1 << entity);
                        if !known.applies(oracle, bodies, city, (clause, actions))? {
                            known.atoms.words[set] |= 1 << entity;
                        }
                    }
                }
            }
            let partly = (oracle.sets().iter()).any(|&(set, _)| known.atoms.words[set] & observed.words[set] != 0);
            counts[if partly { 1 } else { 2 }] += 1;
        }
        Ok(counts)
    }

    /// Copies the observed facts: with sensors, those read as true, or more probable than 0.5.
    pub(super) fn copy_facts(&self, to: &mut Atoms) {
        match &self.sensing {
            Some(sensing) => sensing.copy_facts(to),
            None => to.copy_from(&self.atoms),
        }
    }

    /// Returns whether the ego observes exactly and the oracle is this observer's.
    pub(super) fn observes_exactly_for(&self, oracle: &Arc<Oracle>) -> bool {
        self.sensing.is_none() && Arc::ptr_eq(&self.oracle, oracle)
    }

    /// Returns the observed entities.
    pub(super) fn entities_of<'a>(&'a self, city: &'a Simulation) -> Entities<'a> {
        Entities::Agents {
            bodies: &self.bodies,
            agents: city.agents(),
        }
    }

    /// Counts the facts of the present state, after [`Observer::look`].
    pub fn count(&self, counts: &mut FactCounts) {
        counts.note(&self.atoms, &self.bodies);
    }

    /// Variant of [`Observer::look`] with `chance` as the source of random draws.
    ///
    /// # Errors
    /// As [`Observer::look`].
    pub fn look_with(&mut self, city: &Simulation, chance: &impl Chance) -> Result<(), Diagnostic> {
        let external = city.external()?;
        let (oracle, map, before) = (&*self.oracle, self.oracle.world.map(), self.bodies.len());
        self.bodies.clear();
        let ego = AgentState::new(map, self.ego, &city.agents()[self.ego]);
        let (view, ego_cell) = (oracle.view(&ego), ego.at);
        self.bodies.push(ego);
        for (position, agent) in city.agents().iter().enumerate() {
            if self.bodies.len() == oracle.entities {
                break;
            }
            if view.contains(agent.cell) && position != self.ego {
                self.bodies.push(AgentState::new(map, position, agent));
            }
        }
        if oracle.nearest_first {
            sort_by_distance(ego_cell, &mut self.bodies[1..]);
        }
        let changed = self.compute(city.agents(), external, chance);
        // In most steps nothing changes, except what is remembered.
        if changed || self.oracle.world.vocabulary.draws || !city.remembered().is_empty() || self.bodies.len() != before
        {
            self.violations.forget();
        }
        Ok(())
    }

    /// Computes the facts about the observed entities. Returns whether any fact has changed.
    fn compute(&mut self, agents: &[Agent], external: &ExternalFacts, chance: &impl Chance) -> bool {
        let (oracle, bodies) = (&*self.oracle, &self.bodies);
        let (mut changed, mut rows) = (false, [0; OBSERVED_MAX]);
        let rows = &mut rows[..oracle.entities];
        for (predicate, how) in oracle.how.iter().enumerate() {
            let holds: u64 = match how {
                How::Static(_) => {
                    let holds = bodies
                        .iter()
                        .map(|body| is_steadily(&self.steady, self.words, body, predicate));
                    holding(holds)
                }
                How::Local(table) => holding(bodies.iter().map(|body| table.holds(body.junction, body.kind))),
                How::Place(area) => holding(bodies.iter().map(|body| area.contains(body.at))),
                How::Quantity(quantity) => {
                    let bodies: Vec<Measured> = bodies.iter().map(|body| measured(oracle, body, agents)).collect();
                    let values = &mut self.atoms.values[predicate];
                    for (place, known) in values.iter_mut().enumerate() {
                        let value = measure(oracle, *quantity, chance.tick(), &bodies, place);
                        changed |= *known != value;
                        *known = value;
                    }
                    continue;
                }
                How::External(number, External::Agent) => {
                    holding(bodies.iter().map(|body| external.holds(*number, body.agent, 0)))
                }
                How::External(number, External::Pair) => {
                    rows.fill(0);
                    for (row, first) in rows.iter_mut().zip(bodies) {
                        let related = |second: &AgentState| external.holds(*number, first.agent, second.agent);
                        *row = holding(bodies.iter().map(related));
                    }
                    let known = self.atoms.rows_mut(predicate);
                    changed |= known != rows;
                    known.copy_from_slice(rows);
                    continue;
                }
                // `Sees` is the only predicate that relates an agent to itself.
                How::Pair(relation) => {
                    rows.fill(0);
                    if bodies.len() > 1 || matches!(relation, PairRelation::Sees(_)) {
                        let subjects = bodies.iter().map(AgentState::subject);
                        let draw = |first: usize, second: usize, probability| {
                            let [first, second] = [first, second].map(|entity| bodies[entity].agent as usize);
                            chance.decides(predicate, first, second, probability)
                        };
                        with_relation!(relation, relation => relation.relate(&oracle.views, subjects, draw, rows));
                    }
                    let known = self.atoms.rows_mut(predicate);
                    changed |= known != rows;
                    known.copy_from_slice(rows);
                    continue;
                }
            };
            changed |= self.atoms.words[predicate] != holds;
            self.atoms.words[predicate] = holds;
        }
        changed
    }

    /// Writes the observation: the [columns](Oracle::columns) with 1 for each true atom and 0 for each false one, then
    /// those with the values of quantities, divided by the scale of the column.
    ///
    /// Let n be [`Oracle::entities`]. A unary predicate P takes n numbers, with P(entity i) at i. A binary one takes n
    /// times n numbers, with P(i, j) at `n * i + j`. Absent entities and missing values have zeros. A quantity of the
    /// city is repeated for each entity. With sensors, the numbers of atoms are their output: readings or
    /// probabilities.
    ///
    /// # Panics
    /// If `out` is shorter than [`Oracle::width`].
    pub fn write(&self, out: &mut [f32]) {
        let oracle = &*self.oracle;
        // Few atoms hold.
        let (atoms, numbers) = out[..oracle.width()].split_at_mut(oracle.atoms_width());
        match &self.sensing {
            Some(sensing) => sensing.write(atoms),
            None => {
                atoms.fill(0.0);
                for &(set, start) in &oracle.sets {
                    for member in members(&[self.atoms.words[set]]) {
                        atoms[start + member] = 1.0;
                    }
                }
            }
        }
        oracle.numbers.write(&self.atoms.values, self.bodies.len(), numbers);
    }

    /// Returns the length of a row of the `state` observation; see [`Observer::write_state`].
    pub fn state_width(oracle: &Oracle) -> usize {
        let unary = oracle
            .how
            .iter()
            .filter(|how| !matches!(how, How::Pair(_) | How::Quantity(_) | How::External(_, External::Pair)));
        8 + unary.count() + oracle.numbers.about_one().count()
    }

    /// Writes the `state` observation: a row for the ego, then one for each other agent in its field of view, in the
    /// order of the oracle. It stops at the end of `out` and fills the rest with 0.
    ///
    /// A row has, in this order:
    /// - 1;
    /// - the rows and the columns from the ego to the agent, divided by the half-width of the field of view, -1 to 1;
    /// - the heading, one-hot over Left, Right, Up, Down, and all 0 before the first move;
    /// - the priority divided by [`Oracle::priority_scale`], clamped to -1 to 1;
    /// - 1 or 0 for each unary predicate, in the order of the vocabulary;
    /// - the [columns](Oracle::columns) of quantities that are about one entity.
    ///
    /// # Panics
    /// If the city has external predicates and was not [observed](Observer::look) in this state.
    pub fn write_state(&self, city: &Simulation, out: &mut [f32]) {
        let oracle = &*self.oracle;
        let external = city.external().expect("computed for the observation");
        out.fill(0.0);
        let width = Observer::state_width(oracle);
        let truths = width - oracle.numbers.about_one().count();
        let mut rows = out.chunks_exact_mut(width);
        #[allow(clippy::cast_precision_loss)] // a share of a field of view is of single precision
        let mut write = |body: &AgentState, ego: Cell| {
            let Some(row) = rows.next() else { return };
            let share = |cells: i32| cells as f32 / oracle.world.scenario.view as f32;
            row[..3].copy_from_slice(&[1.0, share(body.at.row - ego.row), share(body.at.col - ego.col)]);
            if let Some(heading) = body.heading {
                row[3 + heading as usize] = 1.0;
            }
            row[7] = (body.priority as f32 / oracle.priority_scale).clamp(-1.0, 1.0);
            let (row, numbers) = row.split_at_mut(truths);
            let unary = oracle.how.iter().enumerate().filter_map(|(predicate, how)| match how {
                How::Static(_) => Some(is_steadily(&self.steady, self.words, body, predicate)),
                How::Local(table) => Some(table.holds(body.junction, body.kind)),
                How::Place(area) => Some(area.contains(body.at)),
                How::External(number, External::Agent) => Some(external.holds(*number, body.agent, 0)),
                How::Pair(_) | How::Quantity(_) | How::External(_, External::Pair) => None,
            });
            for (holds, value) in unary.zip(&mut row[8..]) {
                *value = f32::from(u8::from(holds));
            }
            if numbers.is_empty() {
                return;
            }
            let measured = measured(oracle, body, city.agents());
            let value = |quantity: Quantity| quantity.measure(oracle.world.map(), city.now(), &[&measured]);
            oracle
                .numbers
                .write_entity(|quantity| value(quantity).map(word), numbers);
        };
        let ego = AgentState::new(oracle.world.map(), self.ego, &city.agents()[self.ego]);
        let view = oracle.view(&ego);
        write(&ego, ego.at);
        let agents = city.agents().iter().enumerate();
        let others = agents
            .filter(|(position, agent)| *position != self.ego && view.contains(agent.cell))
            .map(|(position, agent)| AgentState::new(oracle.world.map(), position, agent));
        if oracle.nearest_first {
            let mut others: Vec<AgentState> = others.collect();
            sort_by_distance(ego.at, &mut others);
            others.iter().for_each(|body| write(body, ego.at));
        } else {
            others.for_each(|body| write(&body, ego.at));
        }
    }

    /// Returns the true atoms without `Sees`: a predicate by its position in the vocabulary, and agents by their
    /// positions in the list.
    pub fn atoms(&self) -> impl Iterator<Item = (usize, Vec<usize>)> {
        let sees = self.oracle.world.vocabulary.sees;
        self.all_atoms().filter(move |(predicate, _)| *predicate != sees)
    }

    /// Variant of [`Observer::atoms`] with `Sees`.
    pub fn all_atoms(&self) -> impl Iterator<Item = (usize, Vec<usize>)> {
        let agent = |entity: usize| self.bodies[entity].agent as usize;
        (0..self.oracle.how.len()).flat_map(move |predicate| {
            let alone = members(&[self.atoms.unary(predicate)]).map(move |entity| vec![agent(entity)]);
            let pairs = (0..self.bodies.len())
                .flat_map(move |x| members(&[self.atoms.row(predicate, x)]).map(move |y| vec![agent(x), agent(y)]));
            alone
                .chain(pairs)
                .map(move |agents| (predicate, agents))
                .collect::<Vec<_>>()
        })
    }

    /// Returns a session with the observed facts and the rows derived from them, and the value of the ego in it.
    ///
    /// # Errors
    /// `limit-exceeded` if the rules derive too many rows.
    pub fn session(&self, city: &Simulation) -> Result<(Session, Value), Diagnostic> {
        self.session_of(&self.oracle, observed(&self.atoms, &self.bodies, city), city)
    }

    fn session_of(
        &self,
        oracle: &Oracle,
        observed: Observed<'_>,
        city: &Simulation,
    ) -> Result<(Session, Value), Diagnostic> {
        let world = &oracle.world;
        let names: Vec<String> = city.agents().iter().map(|agent| agent.name().to_string()).collect();
        let names = names.iter().map(String::as_str);
        let mut state = GroundState::new(&world.program, &world.vocabulary, world.limits, names);
        let facts = observed.facts(oracle.how.len());
        let set = state.set_with(&facts, city.cancel());
        set.map_err(|error| error.diagnostic(world.program.rules()))?;
        let (session, values) = state.into_parts();
        Ok((session, values[self.ego]))
    }

    /// Variant of [`Observer::session`] with what the ego observes as facts, under the rules of an oracle that do not
    /// look back.
    ///
    /// # Errors
    /// `limit-exceeded` if the rules derive too many rows.
    pub fn observed_session(&self, oracle: &Oracle, city: &Simulation) -> Result<(Session, Value), Diagnostic> {
        let mut atoms = oracle.no_atoms();
        self.copy_facts(&mut atoms);
        let facts = Observed {
            memory: None,
            ..observed(&atoms, &self.bodies, city)
        };
        self.session_of(oracle, facts, city)
    }

    /// Returns the derived actions of the ego, without the default.
    ///
    /// # Errors
    /// `limit-exceeded` if the rules derive too many rows.
    pub fn derived(&mut self, city: &Simulation) -> Result<Actions, Diagnostic> {
        let (oracle, vocabulary) = (&*self.oracle, &self.oracle.world.vocabulary);
        let derived = match self.violations.known() {
            Some(known) => known,
            None => {
                let observed = observed(&self.atoms, &self.bodies, city);
                self.violations.derived(&oracle.monitor, vocabulary, observed)?
            }
        };
        Ok(vocabulary.before_default(Some(AgentKind::Car.into()), derived))
    }

    /// Returns the clauses that an action of the ego violates, as positions in [`Oracle::constraints`]. An action
    /// violates a clause if the body holds given this action, and the head is another action.
    ///
    /// # Errors
    /// `limit-exceeded` if the rules derive too many rows.
    pub fn violations(&mut self, city: &Simulation, action: Action) -> Result<&[usize], Diagnostic> {
        let observed = observed(&self.atoms, &self.bodies, city);
        self.violations
            .violations(&self.oracle.monitor, observed, action, &mut self.broken)?;
        Ok(&self.broken)
    }

    /// Returns those of some actions of the ego that violate no clause.
    ///
    /// # Errors
    /// `limit-exceeded` if the rules derive too many rows.
    pub fn safe_actions(&mut self, city: &Simulation, actions: Actions) -> Result<Actions, Diagnostic> {
        let observed = observed(&self.atoms, &self.bodies, city);
        self.violations
            .safe_actions(&self.oracle.monitor, observed, actions, &mut self.broken)
    }
}

/// Returns whether a static predicate holds for an agent. `steady` has `words` words per agent.
#[inline]
fn is_steadily(steady: &[u64], words: usize, body: &AgentState, predicate: usize) -> bool {
    steady[body.agent as usize * words + predicate / 64] >> (predicate % 64) & 1 != 0
}

/// Sorts bodies by their distance from a cell; keeps the order of those at the same distance.
fn sort_by_distance(from: Cell, bodies: &mut [AgentState]) {
    bodies.sort_by_key(|body| {
        let [rows, cols] = [body.at.row - from.row, body.at.col - from.col].map(i64::from);
        rows * rows + cols * cols
    });
}

fn observed<'a>(atoms: &'a Atoms, bodies: &'a [AgentState], city: &'a Simulation) -> Observed<'a> {
    Observed {
        atoms,
        entities: Entities::Agents {
            bodies,
            agents: city.agents(),
        },
        given: None,
        memory: Some(city.remembered()),
        drawing: city.drawing(),
        cancel: city.cancel(),
    }
}

/// Returns what quantities read of an entity.
fn measured(oracle: &Oracle, body: &AgentState, agents: &[Agent]) -> Measured {
    Measured {
        subject: body.subject(),
        progress: Progress::of(&agents[body.agent as usize], oracle.world.map_of_exits()),
    }
}

/// Returns the value of a quantity at a place of [`Atoms::values`].
fn measure(oracle: &Oracle, quantity: Quantity, tick: u64, bodies: &[Measured], place: usize) -> Option<Value> {
    let (map, most) = (oracle.world.map(), oracle.entities);
    let measure = match quantity.agents() {
        0 => quantity.measure(map, tick, &[]),
        1 => quantity.measure(map, tick, &[bodies.get(place)?]),
        _ if place / most == place % most => None,
        _ => quantity.measure(map, tick, &[bodies.get(place / most)?, bodies.get(place % most)?]),
    };
    measure.map(word)
}
