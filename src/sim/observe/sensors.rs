//! What the ego observes through sensors, instead of the facts themselves.
//!
//! [`Sensors`] is the immutable part. A [`Sensing`] holds the readings of one ego in one episode. In each tick it draws
//! noise, hides agents, and reads the facts of this tick or of an earlier one. What belongs to an agent follows it to
//! another place among the observed entities; it is forgotten when the agent leaves them.

use crate::city::{Agent, AgentKind, CityMap};
use crate::config::{Sender, Sensor, SensorOutput, SensorsConfig, ShareConfig};
use crate::datalog::dense::members;
use crate::predicate::Definition;
use crate::rng::{Purpose, Seed, Words};
use crate::sim::observe::belief::{Chain, Counts, FactModel, Joint, Reading, Role, SensorModel};
use crate::sim::observe::belief::{Likelihoods, assume, condition, fresh, likelihoods, marginal, predict, update};
use crate::sim::observe::noise::{Threshold, below};
use crate::sim::observe::observed::{AtomLayout, Atoms, OBSERVED_MAX, all_of};
use crate::sim::observe::share::Fact;
use crate::sim::observe::visibility::Visibility;
use crate::sim::tick::agent_state::AgentState;
use crate::sim::tick::vocabulary::BasePredicate;
use smallvec::SmallVec;
use std::collections::VecDeque;
use std::sync::Arc;

impl Purpose {
    /// The noise of sensors; index: the ego.
    pub const SENSORS: Purpose = Purpose::new(51);
}

/// The sensors of an ego, with what a tick needs of them. Immutable and shared.
#[derive(Debug)]
pub struct Sensors {
    config: SensorsConfig,
    layout: AtomLayout,
    /// The length of the part of an observation that sensors write.
    width: usize,
    groups: Vec<Group>,
    /// The different ways in which agents are hidden.
    views: Vec<Visibility>,
    /// The greatest delay in ticks.
    delay: usize,
    /// Whether noise depends on that of the tick before.
    correlated: bool,
    /// Whether observations follow from the readings and beliefs of this tick alone: no delay, sharing or exact ego.
    current: bool,
    /// Whether readings and observations depend only on the facts and the noise of this tick.
    is_stateless: bool,
    /// The sets that no sensor reads.
    unsensed: Vec<usize>,
    /// The predicates whose facts never change.
    fixed: Vec<bool>,
}

/// The predicates with the same sensor.
#[derive(Debug)]
struct Group {
    sensor: Sensor,
    rates: [Threshold; 2],
    likelihoods: Likelihoods,
    dropout: Threshold,
    correlation: Threshold,
    /// The position in [`Sensors::views`].
    view: usize,
    /// Whether readings are current, without dropout, correlation and exact facts.
    is_simple: bool,
    sets: Vec<SensedSet>,
}

impl Group {
    /// Draws five bits for each lane: whether a true fact is read as true, whether a false one is, whether the reading
    /// is dropped, and whether noise and dropout each stay as they were.
    fn draw(&self, lanes: u64, random: &mut Words) -> [u64; 5] {
        let [detected, alarmed] = below(self.rates, lanes, random);
        let [dropped] = below([self.dropout], lanes, random);
        let [kept] = below([self.correlation], lanes, random);
        let [kept_dropped] = match self.dropout.is_never() {
            true => [0],
            false => below([self.correlation], lanes, random),
        };
        [detected, alarmed, dropped, kept, kept_dropped]
    }
}

/// A set of entities whose membership sensors read.
#[derive(Clone, Copy, Debug)]
struct SensedSet {
    /// The place in [`Atoms::words`].
    set: usize,
    predicate: usize,
    /// The first entity of the pairs; `None` if facts are about one agent.
    row: Option<usize>,
    /// `row` as a set; empty without one.
    row_set: u64,
    /// The entities without a fact: `row_set`, or none if the predicate may be reflexive.
    without: u64,
    /// The position of the first number in the observation.
    start: usize,
}

impl SensedSet {
    /// Returns those of some entities whose facts exist.
    #[inline]
    fn lanes(self, among: u64) -> u64 {
        match among & self.row_set == self.row_set {
            true => among & !self.without,
            false => 0,
        }
    }

    /// Returns the models of the fact about the ego and of those about other entities.
    #[inline]
    fn models(self, model: &SensorModel) -> [&FactModel; 2] {
        let of = |entity| &model.facts[self.predicate][Role::of(self.row, entity) as usize];
        [of(0), of(1)]
    }
}

impl Sensors {
    /// Prepares sensors for the observed sets of atoms, each with the place of its first number in an observation.
    pub(super) fn new(
        config: SensorsConfig,
        layout: AtomLayout,
        observed: &[(usize, usize)],
        predicates: &[BasePredicate],
    ) -> Sensors {
        let (mut groups, mut views): (Vec<Group>, Vec<Visibility>) = (Vec::new(), Vec::new());
        for &(set, start) in observed {
            let (predicate, row) = layout.predicate(set);
            let known = &predicates[predicate];
            let sensor = config.of(&known.name);
            let found = groups.iter().position(|group| group.sensor == sensor);
            let group = found.unwrap_or_else(|| {
                let view = Visibility::of(&sensor);
                let place = views.iter().position(|known| *known == view);
                groups.push(Group {
                    is_simple: sensor.delay == 0
                        && sensor.dropout == 0.0
                        && sensor.correlation == 0.0
                        && !config.exact_ego,
                    rates: [sensor.true_positive_rate, sensor.false_positive_rate].map(Threshold::new),
                    likelihoods: likelihoods(&sensor),
                    dropout: Threshold::new(sensor.dropout),
                    correlation: Threshold::new(sensor.correlation),
                    view: place.unwrap_or_else(|| {
                        views.push(view);
                        views.len() - 1
                    }),
                    sets: Vec::new(),
                    sensor,
                });
                groups.len() - 1
            });
            let row_set = row.map_or(0, |row| 1 << row);
            groups[group].sets.push(SensedSet {
                set,
                predicate,
                row,
                row_set,
                without: if known.definition.may_be_reflexive() {
                    0
                } else {
                    row_set
                },
                start,
            });
        }
        let sensors = || groups.iter().map(|group| &group.sensor);
        let simple = config.share.is_none() && groups.iter().all(|group| group.is_simple);
        Sensors {
            is_stateless: simple && config.output != SensorOutput::Belief,
            unsensed: (0..layout.len())
                .filter(|set| observed.iter().all(|(known, _)| known != set))
                .collect(),
            delay: sensors().map(|sensor| sensor.delay as usize).max().unwrap_or(0),
            correlated: sensors().any(|sensor| sensor.correlation > 0.0),
            current: !config.exact_ego && config.share.is_none() && sensors().all(|sensor| sensor.delay == 0),
            fixed: (predicates.iter())
                .map(|predicate| matches!(predicate.definition, Definition::Static(_)))
                .collect(),
            width: observed.len() * layout.entities,
            layout,
            groups,
            views,
            config,
        }
    }

    /// Returns the configuration.
    pub fn config(&self) -> &SensorsConfig {
        &self.config
    }

    /// Returns whether the ego knows a fact about an entity without a sensor.
    #[inline]
    fn is_exact(&self, set: SensedSet, entity: usize) -> bool {
        self.config.exact_ego && set.row.is_none() && entity == 0
    }

    /// Returns what others tell the ego, if they do.
    pub(super) fn share(&self) -> Option<&ShareConfig> {
        self.config.share.as_ref()
    }

    /// Returns whether observations need a [`SensorModel`].
    pub fn needs_model(&self) -> bool {
        self.config.output != SensorOutput::Facts
    }
}

/// The places that observed entities had earlier.
struct Origins {
    /// By entity; only those in `known` count.
    from: [u8; OBSERVED_MAX],
    /// The entities that were observed.
    known: u64,
    /// Whether every known entity has kept its place.
    same: bool,
    /// Whether the entities are those that were observed, in the same order.
    unchanged: bool,
}

impl Origins {
    fn new(now: &[u32], before: &[u32]) -> Origins {
        let (mut from, mut known, mut same) = ([0; OBSERVED_MAX], 0, true);
        if now == before {
            return Origins {
                from,
                known: all_of(now.len()),
                same,
                unchanged: true,
            };
        }
        for (entity, (agent, origin)) in now.iter().zip(&mut from).enumerate() {
            if let Some(place) = before.iter().position(|earlier| earlier == agent) {
                *origin = place as u8;
                known |= 1 << entity;
                same &= place == entity;
            }
        }
        Origins {
            from,
            known,
            same,
            unchanged: false,
        }
    }

    /// Returns the place that an entity had.
    fn of(&self, entity: usize) -> Option<usize> {
        match self.known >> entity & 1 {
            0 => None,
            _ if self.same => Some(entity),
            _ => Some(self.from[entity].into()),
        }
    }

    /// Returns the entities that were observed together with the first one of their pairs, if they have one.
    fn known_with(&self, row: Option<usize>) -> u64 {
        match row {
            Some(row) if self.known >> row & 1 == 0 => 0,
            _ => self.known,
        }
    }

    /// Moves members of a set to their present places.
    fn carry(&self, set: u64) -> u64 {
        if self.same {
            return set & self.known;
        }
        let moved = members(&[self.known]).map(|entity| (set >> self.from[entity] & 1) << entity);
        moved.fold(0, |sum, bit| sum | bit)
    }

    /// Returns a set of an earlier tick for the present places; `words` has all sets of that tick.
    fn carried(&self, words: &[u64], of: SensedSet) -> u64 {
        match of.row {
            None => self.carry(words[of.set]),
            Some(row) => self
                .of(row)
                .map_or(0, |origin| self.carry(words[of.set - row + origin])),
        }
    }
}

/// What was true and visible in a tick.
#[derive(Debug, Default)]
struct Frame {
    agents: Vec<u32>,
    words: Vec<u64>,
    /// By view.
    visible: Vec<u64>,
}

/// The sensors of an ego, with their model and readings.
#[derive(Debug)]
pub(super) struct Sensing {
    sensors: Arc<Sensors>,
    model: Option<Arc<SensorModel>>,
    readings: Readings,
}

/// The readings of an ego in an episode.
#[derive(Debug)]
struct Readings {
    /// The number of observed agents.
    count: usize,
    /// The observed agents, by their positions in the list; empty with stateless sensors.
    agents: Vec<u32>,
    /// For each of them, the number of ticks since it was first observed.
    ages: Vec<u32>,
    /// What the sensors read as true, and the facts that no sensor reads.
    atoms: Atoms,
    /// The facts with a reading, as sets.
    read: Vec<u64>,
    /// The facts that others told in this tick, as sets; empty if nobody tells any.
    told: Vec<u64>,
    /// By set, the facts that are read as holding if they hold, and if they do not.
    noise: Vec<[u64; 2]>,
    /// The facts without a reading because of dropout, as sets.
    dropped: Vec<u64>,
    /// The last ticks, the latest one last; one more than the greatest delay.
    frames: VecDeque<Frame>,
    /// The probabilities of the facts, by the positions of their numbers in the observation.
    belief: Vec<f32>,
    /// The same together with the noise, where noise is correlated.
    joint: Vec<Joint>,
}

impl Sensing {
    /// Returns sensors without readings; `no_atoms` are the facts of an observation without facts.
    pub fn new(sensors: Arc<Sensors>, model: Option<Arc<SensorModel>>, no_atoms: Atoms) -> Sensing {
        let (sets, simple) = (sensors.layout.len(), sensors.groups.iter().all(|group| group.is_simple));
        let believes = sensors.config.output == SensorOutput::Belief;
        let numbers = if believes { sensors.width } else { 0 };
        let readings = Readings {
            count: 0,
            agents: Vec::with_capacity(sensors.layout.entities),
            ages: Vec::with_capacity(sensors.layout.entities),
            atoms: no_atoms,
            read: vec![0; sets],
            told: vec![0; if sensors.config.share.is_some() { sets } else { 0 }],
            noise: vec![[0; 2]; if simple { 0 } else { sets }],
            dropped: vec![0; if simple { 0 } else { sets }],
            frames: VecDeque::with_capacity(sensors.delay + 1),
            belief: vec![0.0; numbers],
            joint: vec![[[0.0; 3]; 2]; if sensors.correlated { numbers } else { 0 }],
        };
        Sensing {
            sensors,
            model,
            readings,
        }
    }

    /// Copies the facts that are read as true or are more probable than not, and those that no sensor reads.
    pub fn copy_facts(&self, to: &mut Atoms) {
        to.copy_from(&self.readings.atoms);
        if self.sensors.config.output != SensorOutput::Facts {
            let sets = self.sensors.groups.iter().flat_map(|group| &group.sets);
            sets.for_each(|set| to.words[set.set] = 0);
            self.probabilities(|set, entity, probability| {
                to.words[set.set] |= u64::from(probability > 0.5) << entity;
            });
        }
    }

    /// Loads what a reading uses into the cache. Returns a meaningless sum of what it reads.
    pub fn prefetch(&self) -> u64 {
        let words = [&self.readings.atoms.words[..], &self.readings.read];
        let words = words.map(|words| words.iter().step_by(8).fold(0, |sum: u64, word| sum ^ word));
        let belief = self.readings.belief.iter().step_by(16);
        belief.fold(words[0] ^ words[1], |sum, number| sum ^ u64::from(number.to_bits()))
    }

    /// Begins an episode.
    pub fn begin(&mut self) {
        self.readings.count = 0;
        self.readings.agents.clear();
        self.readings.frames.clear();
        self.readings.belief.fill(0.0);
    }

    /// Returns the sensors.
    pub fn sensors(&self) -> &Arc<Sensors> {
        &self.sensors
    }

    /// Reads the facts of a tick. `bodies` are the observed entities, the ego first.
    pub fn sense(&mut self, truth: &Atoms, bodies: &[AgentState], city: (&CityMap, &[Agent]), now: (Seed, u64)) {
        if self.sensors.is_stateless {
            return self.readings.sense_now(&self.sensors, truth, bodies, city, now);
        }
        self.readings.told.fill(0);
        let origins = self.readings.sense(&self.sensors, truth, bodies, city, now);
        if self.sensors.config.output == SensorOutput::Belief {
            let model = self.model.as_ref().expect("beliefs have a model");
            self.readings.filter(&self.sensors, model, &origins);
        }
    }

    /// Returns the facts that other agents can tell: true facts without a reading that some sender knows.
    pub fn shareable(&self, truth: &Atoms, bodies: &[AgentState], (map, agents): (&CityMap, &[Agent])) -> Vec<Fact> {
        let Some(share) = &self.sensors.config.share else {
            return Vec::new();
        };
        let present = all_of(bodies.len());
        // By sender and view, the entities that it sees.
        let senders: Vec<Vec<u64>> = match share.from {
            Sender::Assistant => vec![vec![present; self.sensors.views.len()]],
            Sender::Cars { radius } => {
                let cars = (0..).zip(agents).filter(|(car, agent): &(u32, &Agent)| {
                    let is_other = agent.kind_id == AgentKind::Car.into() && *car != bodies[0].agent;
                    is_other && Visibility::is_within(radius, bodies[0].at, agent.cell)
                });
                let sees = |(car, agent): (u32, &Agent)| {
                    let views = self.sensors.views.iter();
                    views
                        .map(|view| view.visible(map, (car, agent.cell), bodies, agents))
                        .collect()
                };
                cars.map(sees).collect()
            }
        };
        let mut facts = Vec::new();
        for (number, group) in self.sensors.groups.iter().enumerate() {
            for &set in &group.sets {
                let missed = set.lanes(present) & truth.words[set.set] & !self.readings.read[set.set];
                for entity in members(&[missed]) {
                    let about = 1 << entity | set.row.map_or(0, |row| 1 << row);
                    if senders.iter().any(|views| views[group.view] & about == about) {
                        facts.push(Fact {
                            set: set.set,
                            row: set.row,
                            entity,
                            place: set.start + entity,
                            group: number,
                        });
                    }
                }
            }
        }
        facts
    }

    /// Adds facts that others told in this tick.
    pub fn tell(&mut self, facts: &[Fact]) {
        let readings = &mut self.readings;
        for fact in facts {
            readings.told[fact.set] |= 1 << fact.entity;
            readings.atoms.words[fact.set] |= 1 << fact.entity;
            let sensor = &self.sensors.groups[fact.group].sensor;
            // A told fact is of this tick, so it sets the belief only if readings have no delay.
            if sensor.delay == 0 && !readings.belief.is_empty() {
                readings.belief[fact.place] = 1.0;
                if sensor.correlation > 0.0 {
                    assume(sensor, &mut readings.joint[fact.place]);
                }
            }
        }
    }

    /// Calls `take` with each fact that the ego may observe, as an entity of a set, and its probability.
    fn probabilities(&self, mut take: impl FnMut(SensedSet, usize, f32)) {
        let (sensors, readings) = (&self.sensors, &self.readings);
        let present = all_of(readings.count);
        let Some(model) = &self.model else { return };
        for group in &sensors.groups {
            for &set in &group.sets {
                for entity in members(&[set.lanes(present)]) {
                    let fact: &FactModel = &model.facts[set.predicate][Role::of(set.row, entity) as usize];
                    let (reading, age) = (readings.reading(set, entity), readings.age(set, entity));
                    let probability = match sensors.config.output {
                        _ if readings.is_told(set, entity) => 1.0,
                        _ if sensors.is_exact(set, entity) => f32::from(u8::from(reading == Reading::Positive)),
                        SensorOutput::Belief if age < group.sensor.delay => fact.chain.later(fact.chain.initial, age),
                        SensorOutput::Belief => fact.ahead[0] + fact.ahead[1] * readings.belief[set.start + entity],
                        _ => fact.after[reading as usize],
                    };
                    take(set, entity, probability);
                }
            }
        }
    }

    /// Writes the first part of an observation, the numbers of the facts.
    pub fn write(&self, out: &mut [f32]) {
        match (self.sensors.config.output, &self.model) {
            (SensorOutput::Facts, _) => {}
            (SensorOutput::Belief, _) if self.sensors.current && !self.sensors.correlated => {
                return out.copy_from_slice(&self.readings.belief);
            }
            (SensorOutput::Probabilities, Some(model)) if self.sensors.current => {
                return self.readings.write_probabilities(&self.sensors, model, out);
            }
            _ => {
                out.fill(0.0);
                return self.probabilities(|set, entity, probability| out[set.start + entity] = probability);
            }
        }
        out.fill(0.0);
        for set in self.sensors.groups.iter().flat_map(|group| &group.sets) {
            for member in members(&[self.readings.atoms.words[set.set]]) {
                out[set.start + member] = 1.0;
            }
        }
    }
}

impl Readings {
    /// Returns the number of ticks since both agents of a fact, or its only one, were first observed; 0 without delays.
    #[inline]
    fn age(&self, set: SensedSet, entity: usize) -> u32 {
        let age = |entity: usize| self.ages.get(entity).copied().unwrap_or_default();
        set.row.map_or(age(entity), |row| age(row).min(age(entity)))
    }

    /// Returns whether others told a fact in this tick.
    #[inline]
    fn is_told(&self, set: SensedSet, entity: usize) -> bool {
        (self.told.get(set.set)).is_some_and(|told| told >> entity & 1 != 0)
    }

    /// Returns the reading of a fact about an entity.
    #[inline]
    fn reading(&self, set: SensedSet, entity: usize) -> Reading {
        let bit = |words: &[u64]| words[set.set] >> entity & 1;
        Reading::of(bit(&self.read), bit(&self.atoms.words))
    }

    /// Fast path of [`Readings::sense`] for stateless sensors, with equal results.
    fn sense_now(
        &mut self,
        sensors: &Sensors,
        truth: &Atoms,
        bodies: &[AgentState],
        (map, agents): (&CityMap, &[Agent]),
        (seed, tick): (Seed, u64),
    ) {
        self.count = bodies.len();
        self.atoms.copy_values(truth);
        for &set in &sensors.unsensed {
            self.atoms.words[set] = truth.words[set];
        }
        let (present, ego) = (all_of(bodies.len()), (bodies[0].agent, bodies[0].at));
        let views = sensors.views.iter();
        let seen: SmallVec<[u64; 4]> = views.map(|view| view.visible(map, ego, bodies, agents)).collect();
        let mut random = seed.words(Purpose::SENSORS, u64::from(ego.0), tick);
        for group in &sensors.groups {
            self.read_simply(group, &truth.words, (present, seen[group.view]), &mut random);
        }
    }

    /// Reads the facts of a tick. Returns the places that the observed entities had in the tick before.
    fn sense(
        &mut self,
        sensors: &Sensors,
        truth: &Atoms,
        bodies: &[AgentState],
        (map, agents): (&CityMap, &[Agent]),
        (seed, tick): (Seed, u64),
    ) -> Origins {
        let mut now = [0; OBSERVED_MAX];
        for (place, body) in now.iter_mut().zip(bodies) {
            *place = body.agent;
        }
        let (now, present) = (&now[..bodies.len()], all_of(bodies.len()));
        let origins = Origins::new(now, &self.agents);
        if !origins.same {
            self.move_state(sensors, &origins);
        }
        self.count = now.len();
        self.agents.clear();
        self.agents.extend_from_slice(now);
        if sensors.delay > 0 {
            let ages = (0..now.len()).map(|entity| origins.of(entity).map_or(0, |origin| self.ages[origin] + 1));
            self.ages = ages.collect();
        }
        self.atoms.copy_from(truth);
        let mut frame = match self.frames.len() > sensors.delay {
            true => self.frames.pop_front().expect("it is not empty"),
            false => Frame::default(),
        };
        frame.visible.clear();
        let ego = (bodies[0].agent, bodies[0].at);
        (frame.visible).extend(sensors.views.iter().map(|view| view.visible(map, ego, bodies, agents)));
        if sensors.delay > 0 {
            frame.agents.clone_from(&self.agents);
            frame.words.clone_from(&truth.words);
        }
        self.frames.push_back(frame);
        let mut random = seed.words(Purpose::SENSORS, u64::from(now[0]), tick);
        let (each, lanes) = noisy_lanes(bodies.len());
        for group in &sensors.groups {
            let delay = group.sensor.delay as usize;
            let frame = self.frames.len().checked_sub(delay + 1).map(|at| &self.frames[at]);
            let earlier = frame
                .filter(|_| delay > 0)
                .map(|frame| Origins::new(now, &frame.agents));
            let seen = match (frame, &earlier) {
                (None, _) => 0,
                (Some(frame), None) => frame.visible[group.view],
                (Some(frame), Some(origins)) => origins.carry(frame.visible[group.view]),
            };
            if group.is_simple {
                self.read_simply(group, &truth.words, (present, seen), &mut random);
                continue;
            }
            let (mut drawn, mut left) = ([0; 5], 0);
            for &set in &group.sets {
                if set.row.is_some_and(|row| row >= bodies.len()) {
                    self.read[set.set] = 0;
                    continue;
                }
                if left == 0 {
                    (drawn, left) = (group.draw(lanes, &mut random), each);
                }
                let [detected, alarmed, dropped, kept, kept_dropped] = drawn;
                drawn = drawn.map(|bits| bits.checked_shr(bodies.len() as u32).unwrap_or(0));
                left -= 1;
                let read = set.lanes(present & seen);
                let known = origins.known_with(set.row);
                let mix = |kept: u64, old: u64, new: u64| old & kept & known | new & !(kept & known);
                let noise = &mut self.noise[set.set];
                *noise = [mix(kept, noise[0], detected), mix(kept, noise[1], alarmed)];
                let out = &mut self.dropped[set.set];
                *out = mix(kept_dropped, *out, dropped);
                let held = match (frame, &earlier) {
                    (Some(frame), Some(origins)) => origins.carried(&frame.words, set),
                    _ => truth.words[set.set],
                };
                let mut read = read & !*out;
                let mut holds = (held & noise[0] | !held & noise[1]) & read;
                if sensors.is_exact(set, 0) {
                    read |= 1;
                    holds = holds & !1 | truth.words[set.set] & 1;
                }
                self.read[set.set] = read;
                self.atoms.words[set.set] = holds;
            }
        }
        origins
    }

    /// Reads the facts of a [simple](Group::is_simple) group, as the loop of [`Readings::sense`] does for others.
    fn read_simply(&mut self, group: &Group, truth: &[u64], (present, seen): (u64, u64), random: &mut Words) {
        let count = present.count_ones();
        let (each, lanes) = noisy_lanes(count as usize);
        let (mut detected, mut alarmed, mut left) = (0, 0, 0);
        for &set in &group.sets {
            if set.row_set & !present != 0 {
                (self.read[set.set], self.atoms.words[set.set]) = (0, 0);
                continue;
            }
            if left == 0 {
                ([detected, alarmed], left) = (below(group.rates, lanes, random), each);
            }
            let (held, read) = (truth[set.set], set.lanes(present & seen));
            self.read[set.set] = read;
            self.atoms.words[set.set] = (held & detected | !held & alarmed) & read;
            // With 64 entities the shift wraps, but then no set is left to read these bits.
            (detected, alarmed) = (detected.wrapping_shr(count), alarmed.wrapping_shr(count));
            left -= 1;
        }
    }

    /// Writes the probability of each fact given its reading.
    fn write_probabilities(&self, sensors: &Sensors, model: &SensorModel, out: &mut [f32]) {
        // Most readings are negative.
        out.copy_from_slice(&model.negative[self.count]);
        let present = all_of(self.count);
        for &set in sensors.groups.iter().flat_map(|group| &group.sets) {
            let (read, positive) = (self.read[set.set], self.atoms.words[set.set]);
            let models = set.models(model);
            for (entities, reading) in [
                (set.lanes(present) & !read, Reading::Missing),
                (set.lanes(present) & read & positive, Reading::Positive),
            ] {
                for entity in members(&[entities]) {
                    out[set.start + entity] = models[usize::from(entity > 0)].after[reading as usize];
                }
            }
        }
    }

    /// Moves noise and beliefs to the present places of their agents.
    fn move_state(&mut self, sensors: &Sensors, origins: &Origins) {
        let sets = || sensors.groups.iter().flat_map(|group| &group.sets);
        if sensors.correlated {
            let (noise, dropped) = (self.noise.clone(), self.dropped.clone());
            let [yes, no] = [0, 1].map(|which| noise.iter().map(|noise| noise[which]).collect::<Vec<u64>>());
            for &set in sets() {
                self.noise[set.set] = [&yes, &no].map(|words| origins.carried(words, set));
                self.dropped[set.set] = origins.carried(&dropped, set);
            }
        }
        if !self.belief.is_empty() {
            let (belief, joint) = (self.belief.clone(), self.joint.clone());
            for &set in sets() {
                let start = match set.row {
                    None => Some(set.start),
                    Some(row) => {
                        let first = set.start - row * sensors.layout.entities;
                        origins.of(row).map(|origin| first + origin * sensors.layout.entities)
                    }
                };
                for entity in members(&[origins.known]) {
                    let Some((start, origin)) = start.zip(origins.of(entity)) else {
                        continue;
                    };
                    self.belief[set.start + entity] = belief[start + origin];
                    if !joint.is_empty() {
                        self.joint[set.start + entity] = joint[start + origin];
                    }
                }
            }
        }
    }

    /// Updates the beliefs by the readings of this tick. Facts whose agents have origins had a belief before.
    fn filter(&mut self, sensors: &Sensors, model: &SensorModel, origins: &Origins) {
        let present = all_of(self.agents.len());
        for group in &sensors.groups {
            let sensor = &group.sensor;
            if sensor.delay == 0 && sensor.correlation == 0.0 {
                self.filter_simply(group, model, present, origins);
                continue;
            }
            for &set in &group.sets {
                let facts = &model.facts[set.predicate];
                let known = set.lanes(origins.known);
                for entity in members(&[set.lanes(present)]) {
                    let fact = &facts[Role::of(set.row, entity) as usize];
                    let age = self.age(set, entity);
                    // The belief is about the tick of the reading: the first one is about the first common tick.
                    let known = known >> entity & 1 != 0 && (sensor.delay == 0 || age > sensor.delay);
                    let (place, reading) = (set.start + entity, self.reading(set, entity));
                    if sensor.correlation == 0.0 {
                        let before = match known {
                            true => fact.chain.next(self.belief[place]),
                            false => fact.chain.initial,
                        };
                        self.belief[place] = update(&group.likelihoods, before, reading);
                    } else {
                        let mut joint = match known {
                            true => predict(sensor, fact.chain, &self.joint[place]),
                            false => fresh(sensor, fact.chain.initial),
                        };
                        condition(sensor, &mut joint, reading);
                        self.joint[place] = joint;
                        self.belief[place] = marginal(&joint);
                    }
                }
            }
        }
    }

    /// Variant of [`Readings::filter`] for a group without delay and correlation. Sets beliefs of facts that do not exist
    /// to 0.
    fn filter_simply(&mut self, group: &Group, model: &SensorModel, present: u64, origins: &Origins) {
        let entities = self.atoms.layout.entities;
        for &set in &group.sets {
            let beliefs = &mut self.belief[set.start..][..entities];
            let (lanes, known) = (set.lanes(present), set.lanes(origins.known));
            let read = self.read[set.set];
            let readings = [read, read & self.atoms.words[set.set]];
            let chains = set.models(model).map(|model| model.chain);
            // Facts about the ego have another chain than others.
            for (lanes, chain) in [lanes & 1, lanes & !1].into_iter().zip(chains) {
                advance(beliefs, (lanes, known), readings, chain, &group.likelihoods);
            }
            if !origins.unchanged {
                let absent = beliefs.iter_mut().enumerate();
                let absent = absent.filter(|(entity, _)| lanes >> entity & 1 == 0);
                absent.for_each(|(_, belief)| *belief = 0.0);
            }
        }
    }
}

/// Updates the beliefs of the facts in `lanes`, which have the same chain, by their readings: those with a reading, and
/// those with a positive one. The `known` ones had a belief before.
#[inline]
fn advance(
    beliefs: &mut [f32],
    (lanes, known): (u64, u64),
    [read, positive]: [u64; 2],
    chain: Chain,
    likelihoods: &Likelihoods,
) {
    for lane in members(&[lanes]) {
        let belief = &mut beliefs[lane];
        let before = match known >> lane & 1 {
            0 => chain.initial,
            _ => chain.next(*belief),
        };
        *belief = update(likelihoods, before, Reading::of(read >> lane & 1, positive >> lane & 1));
    }
}

/// Returns how many sets of this many entities fit in 64 random bits, and the mask of the bits that they use.
#[inline]
fn noisy_lanes(entities: usize) -> (usize, u64) {
    let each = 64 / entities;
    (each, u64::MAX >> (64 - each * entities))
}

/// Counts the facts of many observations, for a [`SensorModel`].
#[derive(Debug)]
pub struct FactCounts {
    sensors: Arc<Sensors>,
    counts: Vec<[Counts; Role::COUNT]>,
    /// The observed agents and the facts of the tick before.
    before: Frame,
}

impl FactCounts {
    /// Returns the counts of no observation.
    pub fn new(sensors: Arc<Sensors>) -> FactCounts {
        FactCounts {
            counts: vec![Default::default(); sensors.layout.predicates],
            before: Frame::default(),
            sensors,
        }
    }

    /// Begins an episode.
    pub fn begin(&mut self) {
        self.before.agents.clear();
    }

    /// Counts the facts of a tick.
    pub(super) fn note(&mut self, truth: &Atoms, bodies: &[AgentState]) {
        let now: Vec<u32> = bodies.iter().map(|body| body.agent).collect();
        let origins = Origins::new(&now, &self.before.agents);
        let present = all_of(now.len());
        for &set in self.sensors.groups.iter().flat_map(|group| &group.sets) {
            let known = origins.known_with(set.row);
            let held = match known {
                0 => 0,
                _ => origins.carried(&self.before.words, set),
            };
            for entity in members(&[set.lanes(present)]) {
                let counts = &mut self.counts[set.predicate][Role::of(set.row, entity) as usize];
                let holds = truth.words[set.set] >> entity & 1;
                counts.ticks += 1;
                counts.holds += holds;
                if known >> entity & 1 != 0 {
                    let before = (held >> entity & 1) as usize;
                    counts.after[before] += 1;
                    counts.holds_after[before] += holds;
                } else {
                    counts.first += 1;
                    counts.holds_first += holds;
                }
            }
        }
        self.before.agents = now;
        self.before.words.clone_from(&truth.words);
    }

    /// Returns the model that follows from the counts.
    pub fn model(&self) -> SensorModel {
        let sensor = |predicate: usize| {
            let of = |group: &&Group| group.sets.iter().any(|set| set.predicate == predicate);
            self.sensors
                .groups
                .iter()
                .find(of)
                .map(|group| group.sensor)
                .unwrap_or_default()
        };
        let facts = self.counts.iter().enumerate().map(|(predicate, counts)| {
            let sensor = sensor(predicate);
            counts.map(|counts| FactModel::new(&sensor, counts.chain(self.sensors.fixed[predicate])))
        });
        let mut model = SensorModel {
            facts: facts.collect(),
            negative: Vec::new(),
        };
        // Only these observations copy them.
        let copied = self.sensors.current && self.sensors.config.output == SensorOutput::Probabilities;
        let counts = if copied { self.sensors.layout.entities + 1 } else { 0 };
        for count in 0..counts {
            let mut numbers = vec![0.0; self.sensors.width];
            for &set in self.sensors.groups.iter().flat_map(|group| &group.sets) {
                let models = set.models(&model);
                for entity in members(&[set.lanes(all_of(count))]) {
                    let after = &models[usize::from(entity > 0)].after;
                    numbers[set.start + entity] = after[Reading::Negative as usize];
                }
            }
            model.negative.push(numbers);
        }
        model
    }
}
