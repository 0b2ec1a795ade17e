//! What one agent observes of its city, what the rules want of it there, and which of them an action breaks.
//!
//! An agent of a simulation is judged on everything in its field of view; the ego of a task on a few entities of it: itself and the
//! first others in the order of the list. [`Oracle`] holds what does not change, an [`Observer`] the facts of a moment.
//!
//! The facts are those that are true of the observed entities; `Sees` relates the ego to all of them. What the ego does is given
//! when an action is judged: of the four action predicates just this one holds, of the ego, in the bodies of all clauses. What the
//! others do next nobody can observe, so no action holds of them there.

use super::executor::compile;
use super::ground::{Chance, Facts};
use super::infer::{Draws, GroundState};
use super::simulation::Simulation;
use super::vocabulary::{Actions, Vocabulary};
use super::window::{Body, Reach, Relation, holds_of, views};
use super::world::World;
use crate::city::{Agent, Cell, View};
use crate::config::{Definition, Speed};
use crate::diag::Diagnostic;
use crate::engine::dense::{Axis, Counting, Dense, Frame, Input, List, Pairs, Set, first, has, members};
use crate::engine::{Program, Session};
use crate::lang::{self, ClauseId, Literal, RelId, Rules, Value};
use std::sync::Arc;

/// The most entities that are observed.
pub const OBSERVED_MAX: usize = 64;

/// A clause that asks an action of an agent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Demand {
    /// The clause.
    pub clause: ClauseId,
    /// The action of its head.
    pub action: Speed,
}

/// What the rules say of one agent and what it observes. Immutable, shared by every [`Observer`].
#[derive(Debug)]
pub struct Oracle {
    world: Arc<World>,
    /// How many entities are observed.
    entities: usize,
    demands: Vec<Demand>,
    /// By predicate of the vocabulary.
    how: Vec<How>,
    views: [Reach; 5],
    /// What the rules derive.
    wanted: Evaluator,
    /// Which bodies hold if the ego's action is given.
    judged: Evaluator,
}

/// How a predicate is computed.
#[derive(Debug)]
enum How {
    Steady(Definition),
    AtIntersection,
    InIntersection,
    Pair(Relation),
}

/// Rules, ready to be evaluated.
#[derive(Debug)]
enum Evaluator {
    Dense(Box<DenseRules>),
    Relational {
        program: Program,
        /// With its number of columns, by predicate of the vocabulary and then by action that is given.
        relations: Vec<Option<(RelId, usize)>>,
    },
}

#[derive(Debug)]
struct DenseRules {
    dense: Dense,
    /// Of the predicate that is an input of the program: its place among those of the vocabulary and then the actions that are given.
    inputs: Vec<Option<(usize, bool)>>,
    lists: Vec<(Option<usize>, Axis)>,
}

/// The rules with the actions in all bodies replaced by predicates that are given, which come last.
fn with_actions_given(rules: &Rules, vocabulary: &Vocabulary) -> (Rules, [Option<RelId>; 4]) {
    let mut rules = rules.clone();
    let given = Speed::ALL.map(|speed| {
        let action = vocabulary.action(speed)?;
        let place = RelId(u32::try_from(rules.relations.len()).expect("fewer than 2^32 predicates"));
        let relation = lang::Relation {
            name: format!("+given {}", speed.name()),
            doc: format!("the action `{}` that is given", speed.name()),
            input: true,
            given: None,
            output: false,
            printsize: false,
            derived: false,
            hidden: true,
            directives: Vec::new(),
            ..rules.relations[action.index()].clone()
        };
        rules.relations.push(relation);
        Some((action, place))
    });
    for literal in rules.clauses.iter_mut().flat_map(|clause| &mut clause.body) {
        let (Literal::Positive(atom)
        | Literal::Negative(atom)
        | Literal::Guard(atom)
        | Literal::Aggregate { atom, .. }) = literal
        else {
            continue;
        };
        if let Some((_, place)) = given.iter().flatten().find(|(action, _)| *action == atom.relation) {
            atom.relation = *place;
        }
    }
    (rules, given.map(|given| given.map(|(_, place)| place)))
}

/// The clauses that ask an action. The default is none: a clause for it that looks only at the other actions and the ego itself.
fn demands(rules: &Rules, vocabulary: &Vocabulary) -> Vec<Demand> {
    let action_of = |relation| (Speed::ALL.into_iter()).find(|&speed| vocabulary.action(speed) == Some(relation));
    let sees = vocabulary.predicates[vocabulary.sees].relation;
    let is_default = |clause: &lang::Clause| {
        clause.body.iter().all(|literal| match literal {
            Literal::Negative(atom) => action_of(atom.relation).is_some() && atom.terms == clause.head.terms,
            Literal::Positive(atom) | Literal::Guard(atom) => {
                Some(atom.relation) == sees && atom.terms.iter().all(|term| Some(term) == clause.head.terms.first())
            }
            _ => false,
        })
    };
    let demand = |(position, clause): (u32, &lang::Clause)| {
        let action = action_of(clause.head.relation)?;
        let default = action == vocabulary.default_action() && is_default(clause);
        (!clause.body.is_empty() && !default).then_some(Demand {
            clause: ClauseId(position),
            action,
        })
    };
    (0..).zip(&rules.clauses).filter_map(demand).collect()
}

impl Evaluator {
    fn new(program: Program, vocabulary: &Vocabulary, given: [Option<RelId>; 4], counting: Counting) -> Evaluator {
        let Ok(dense) = compile(&program, vocabulary, counting) else {
            let predicates = vocabulary.predicates.iter();
            let predicates = predicates.map(|predicate| predicate.relation.map(|relation| (relation, predicate.arity)));
            let given = given.into_iter().map(|relation| relation.map(|relation| (relation, 1)));
            return Evaluator::Relational {
                program,
                relations: predicates.chain(given).collect(),
            };
        };
        let bound = vocabulary.predicates.iter().map(|predicate| predicate.relation);
        let bound: Vec<Option<RelId>> = bound.chain(given).collect();
        let place = |relation: RelId| bound.iter().position(|bound| *bound == Some(relation));
        let input = |input: &Input| match *input {
            Input::Unary(relation) => place(relation).map(|place| (place, false)),
            Input::Diagonal(relation) => place(relation).map(|place| (place, true)),
        };
        Evaluator::Dense(Box::new(DenseRules {
            inputs: dense.inputs().iter().map(input).collect(),
            lists: dense
                .lists()
                .iter()
                .map(|&List(relation, axis)| (place(relation), axis))
                .collect(),
            dense,
        }))
    }
}

impl Oracle {
    /// For egos that observe so many entities, themselves included.
    ///
    /// # Errors
    /// Rules that cannot be planned.
    ///
    /// # Panics
    /// If the entities are none or more than [`OBSERVED_MAX`].
    pub fn new(world: Arc<World>, entities: usize) -> Result<Oracle, Diagnostic> {
        assert!((1..=OBSERVED_MAX).contains(&entities), "{entities} entities");
        let (rules, vocabulary) = (world.program.rules(), &world.vocabulary);
        let (judged, given) = with_actions_given(rules, vocabulary);
        let how = |(position, definition): (usize, &Definition)| match definition {
            Definition::Kind(_) | Definition::Concept { .. } => How::Steady(definition.clone()),
            Definition::AtIntersection => How::AtIntersection,
            Definition::InIntersection => How::InIntersection,
            pair => How::Pair(Relation::new(position, pair)),
        };
        let definitions = vocabulary.predicates.iter().map(|predicate| &predicate.definition);
        Ok(Oracle {
            entities,
            demands: demands(rules, vocabulary),
            how: definitions.enumerate().map(how).collect(),
            views: views(world.scenario.view),
            wanted: Evaluator::new(world.program.clone(), vocabulary, [None; 4], Counting::Off),
            judged: Evaluator::new(Program::new(judged)?, vocabulary, given, Counting::Each),
            world,
        })
    }

    /// The city and its rules.
    pub fn world(&self) -> &Arc<World> {
        &self.world
    }

    /// How many entities are observed, at most.
    pub fn entities(&self) -> usize {
        self.entities
    }

    /// The clauses that ask an action, in the order of the text. The default is not among them.
    pub fn demands(&self) -> &[Demand] {
        &self.demands
    }

    fn sees(&self, ego: &Body, at: Cell) -> bool {
        let reach = self.views[ego.heading.map_or(0, |heading| heading as usize + 1)];
        View::around(ego.at, reach).contains(at)
    }

    /// How many numbers [`Observer::write`] writes: for each predicate, `Sees` left out, one for each entity or pair of entities.
    pub fn width(&self) -> usize {
        self.columns().map(|(_, width)| width).sum()
    }

    /// The predicates of the observation in its order, and how many numbers each has.
    pub fn columns(&self) -> impl Iterator<Item = (usize, usize)> {
        let vocabulary = &self.world.vocabulary;
        let observed = vocabulary
            .predicates
            .iter()
            .enumerate()
            .filter(|(position, _)| *position != vocabulary.sees);
        observed.map(|(position, predicate)| {
            (
                position,
                self.entities.pow(u32::try_from(predicate.arity).expect("1 or 2")),
            )
        })
    }
}

/// What an ego observes at a moment.
pub struct Observer {
    oracle: Arc<Oracle>,
    ego: usize,
    /// For each agent a bit for each predicate that depends on what it is, `words` words.
    steady: Vec<u64>,
    words: usize,
    /// The observed entities, the ego first.
    bodies: Vec<Body>,
    atoms: Atoms,
    wanted: State,
    judged: State,
    broken: Vec<usize>,
}

/// The facts about up to 64 entities.
#[derive(Clone, Debug, Default)]
struct Atoms {
    /// By predicate of the vocabulary, and then by action that is given: the entities of which it holds.
    unary: Vec<u64>,
    /// For each predicate [`OBSERVED_MAX`] sets or as many as there are entities at most: what it relates the first entity to, the second, ...
    rows: Vec<u64>,
    entities: usize,
}

enum State {
    Dense(Box<Frame<1>>),
    Relational(Option<Box<GroundState>>),
}

impl Atoms {
    fn row(&self, predicate: usize, entity: usize) -> u64 {
        self.rows[predicate * self.entities + entity]
    }
}

/// Answers what a dense program asks about pairs.
struct Related<'a> {
    atoms: &'a Atoms,
    lists: &'a [(Option<usize>, Axis)],
}

impl Pairs<1> for Related<'_> {
    #[inline]
    fn narrow(&self, list: usize, at: usize, among: Set<1>) -> Set<1> {
        match self.lists[list] {
            (None, _) => [0],
            (Some(predicate), Axis::Second) => [among[0] & self.atoms.row(predicate, at)],
            (Some(predicate), Axis::First) => {
                let related = |first: &usize| self.atoms.row(predicate, *first) >> at & 1 != 0;
                [members(&among).filter(related).fold(0, |set, first| set | 1 << first)]
            }
        }
    }
}

impl State {
    fn new(evaluator: &Evaluator) -> State {
        match evaluator {
            Evaluator::Dense(rules) => State::Dense(Box::new(Frame::new(&rules.dense, 0))),
            Evaluator::Relational { .. } => State::Relational(None),
        }
    }

    /// Evaluates the rules on the facts.
    fn run(
        &mut self,
        evaluator: &Evaluator,
        observed: Observed<'_>,
        stop: &dyn Fn() -> bool,
    ) -> Result<(), Diagnostic> {
        let atoms = observed.atoms;
        match (self, evaluator) {
            (State::Dense(frame), Evaluator::Dense(rules)) => {
                let count = observed.bodies.len();
                if frame.count() != count {
                    frame.reset(&rules.dense, count);
                    if rules.dense.is_local() {
                        frame.set_egos(first(1));
                    }
                }
                for (input, source) in rules.inputs.iter().enumerate() {
                    let set = match *source {
                        None => 0,
                        Some((predicate, false)) => atoms.unary[predicate],
                        Some((predicate, true)) => {
                            (0..count).fold(0, |set, at| set | atoms.row(predicate, at) & 1 << at)
                        }
                    };
                    frame.set_input(&rules.dense, input, [set]);
                }
                let lists = &rules.lists;
                frame.run(&rules.dense, &Related { atoms, lists });
                Ok(())
            }
            (State::Relational(state), Evaluator::Relational { program, relations }) => {
                let state = state.get_or_insert_with(|| {
                    let names: Vec<String> = observed.agents.iter().map(|agent| agent.name().to_string()).collect();
                    let names = names.iter().map(String::as_str);
                    Box::new(GroundState::over(program, relations.clone(), names))
                });
                let facts = observed.facts(relations.len());
                let set = state.set_until(&facts, stop);
                set.map_err(|error| error.diagnostic(program.rules()))
            }
            _ => unreachable!("a state is made for its evaluator"),
        }
    }
}

/// What a state is set from.
#[derive(Clone, Copy)]
struct Observed<'a> {
    atoms: &'a Atoms,
    bodies: &'a [Body],
    agents: &'a [Agent],
}

impl<'a> Observed<'a> {
    fn new(atoms: &'a Atoms, bodies: &'a [Body], city: &'a Simulation) -> Self {
        Observed {
            atoms,
            bodies,
            agents: city.agents(),
        }
    }

    /// The facts by their positions in the list of agents.
    fn facts(&self, predicates: usize) -> Facts {
        let agent = |entity: usize| self.bodies[entity].agent;
        let rows = (0..predicates).map(|predicate| {
            let alone = members(&[self.atoms.unary[predicate]]).map(|entity| [agent(entity), 0]);
            let pairs = (0..self.bodies.len())
                .filter(|_| (predicate + 1) * self.atoms.entities <= self.atoms.rows.len())
                .flat_map(|x| members(&[self.atoms.row(predicate, x)]).map(move |y| (x, y)));
            let mut rows: Vec<[u32; 2]> = alone.chain(pairs.map(|(x, y)| [agent(x), agent(y)])).collect();
            rows.sort_unstable();
            rows
        });
        Facts { rows: rows.collect() }
    }
}

impl Observer {
    /// Observes for one agent, by its position in the list. [`Observer::begin`] comes next.
    pub fn new(oracle: Arc<Oracle>, ego: usize) -> Observer {
        let predicates = oracle.how.len();
        let unary = vec![0; predicates + Speed::ALL.len()];
        Observer {
            ego,
            steady: Vec::new(),
            words: predicates.div_ceil(64),
            bodies: Vec::with_capacity(oracle.entities),
            atoms: Atoms {
                unary,
                rows: vec![0; predicates * oracle.entities],
                entities: oracle.entities,
            },
            wanted: State::new(&oracle.wanted),
            judged: State::new(&oracle.judged),
            broken: Vec::with_capacity(oracle.demands.len()),
            oracle,
        }
    }

    /// What does not change.
    pub fn oracle(&self) -> &Arc<Oracle> {
        &self.oracle
    }

    /// The agent, by its position in the list.
    pub fn ego(&self) -> usize {
        self.ego
    }

    /// The observed entities by their positions in the list of agents, the ego first.
    pub fn entities(&self) -> impl ExactSizeIterator<Item = usize> {
        self.bodies.iter().map(|body| body.agent as usize)
    }

    /// Takes note of what the agents of a city are. They may have changed since the last time if the city was restarted.
    pub fn begin(&mut self, city: &Simulation) {
        self.steady.clear();
        self.steady.resize(city.agents().len() * self.words, 0);
        for (agent, words) in city.agents().iter().zip(self.steady.chunks_exact_mut(self.words)) {
            for (predicate, how) in self.oracle.how.iter().enumerate() {
                if let How::Steady(definition) = how
                    && holds_of(definition, agent.kind, &agent.concepts)
                {
                    words[predicate / 64] |= 1 << (predicate % 64);
                }
            }
        }
    }

    /// Observes the present state of the city, the one on which the next tick will be decided.
    pub fn look(&mut self, city: &Simulation) {
        let draws = Draws {
            seed: city.seed(),
            time: city.now(),
        };
        self.look_with(city, &draws);
    }

    /// As [`Observer::look`], but `chance` decides about predicates that hold with a probability.
    pub fn look_with(&mut self, city: &Simulation, chance: &impl Chance) {
        let (oracle, map) = (&*self.oracle, self.oracle.world.map());
        self.bodies.clear();
        let ego = Body::new(map, self.ego, &city.agents()[self.ego]);
        self.bodies.push(ego);
        for (position, agent) in city.agents().iter().enumerate() {
            if self.bodies.len() == oracle.entities {
                break;
            }
            if position != self.ego && oracle.sees(&ego, agent.cell) {
                self.bodies.push(Body::new(map, position, agent));
            }
        }
        self.compute(chance);
    }

    /// Computes the facts about the observed entities.
    fn compute(&mut self, chance: &impl Chance) {
        let (oracle, bodies) = (&*self.oracle, &self.bodies);
        let unary = &mut self.atoms.unary;
        unary.fill(0);
        for (entity, body) in bodies.iter().enumerate() {
            let of = &self.steady[body.agent as usize * self.words..][..self.words];
            for predicate in of
                .iter()
                .enumerate()
                .flat_map(|(word, bits)| members(&[*bits]).map(move |bit| 64 * word + bit))
            {
                unary[predicate] |= 1 << entity;
            }
        }
        let collect = |holds: fn(&Body) -> bool| {
            let entities = bodies.iter().enumerate();
            entities.fold(0, |set, (entity, body)| set | u64::from(holds(body)) << entity)
        };
        for (predicate, how) in oracle.how.iter().enumerate() {
            match how {
                How::Steady(_) => {}
                How::AtIntersection => unary[predicate] = collect(|body| body.junction.is_at(body.kind)),
                How::InIntersection => unary[predicate] = collect(|body| body.junction.is_inside()),
                How::Pair(relation) => {
                    for (first, x) in bodies.iter().enumerate() {
                        let mut row = 0;
                        for (second, y) in bodies.iter().enumerate() {
                            row |= u64::from(relation.holds(&oracle.views, chance, x, y)) << second;
                        }
                        self.atoms.rows[predicate * self.atoms.entities + first] = row;
                    }
                }
            }
        }
    }

    /// Writes the observation: for each predicate in the order of the vocabulary, `Sees` left out, 1 where it is true and else 0.
    /// A predicate P with one column takes the next n numbers, P(entity i) at i; one with two columns n times n, P(i, j) at n i + j,
    /// where n is [`Oracle::entities`]. Of entities that are not there nothing is true.
    ///
    /// # Panics
    /// If there is not room for [`Oracle::width`] numbers.
    pub fn write(&self, out: &mut [f32]) {
        let (n, sees) = (self.oracle.entities, self.oracle.world.vocabulary.sees);
        let out = &mut out[..self.oracle.width()];
        out.fill(0.0);
        let mut base = 0;
        for (predicate, how) in self
            .oracle
            .how
            .iter()
            .enumerate()
            .filter(|(predicate, _)| *predicate != sees)
        {
            if let How::Pair(_) = how {
                for first in 0..self.bodies.len() {
                    for second in members(&[self.atoms.row(predicate, first)]) {
                        out[base + n * first + second] = 1.0;
                    }
                }
                base += n * n;
            } else {
                for entity in members(&[self.atoms.unary[predicate]]) {
                    out[base + entity] = 1.0;
                }
                base += n;
            }
        }
    }

    /// How many numbers a point of the exact observation has, see [`Observer::write_points`].
    pub fn point_width(oracle: &Oracle) -> usize {
        let unary = oracle.how.iter().filter(|how| !matches!(how, How::Pair(_)));
        8 + unary.count()
    }

    /// Writes the exact observation: a point for the ego, then one for each other agent in its field of view in the order of the list, as
    /// many as there is room for; the rest is 0. A point has: 1; the rows and the columns from the ego to it, as shares of the half-width of
    /// the field of view, -1 to 1; 1 for its heading among Left, Right, Up, Down, all 0 before its first move; its priority as a share of
    /// `priority_scale`, -1 to 1; 1 or 0 for each predicate with one column, in the order of the vocabulary.
    pub fn write_points(&self, city: &Simulation, priority_scale: f32, out: &mut [f32]) {
        let oracle = &*self.oracle;
        out.fill(0.0);
        let width = Observer::point_width(oracle);
        let mut points = out.chunks_exact_mut(width);
        #[allow(clippy::cast_precision_loss)] // a share of a field of view is of single precision
        let mut write = |body: &Body, ego: Cell| {
            let Some(point) = points.next() else { return };
            let share = |cells: i32| cells as f32 / oracle.world.scenario.view as f32;
            point[..3].copy_from_slice(&[1.0, share(body.at.row - ego.row), share(body.at.col - ego.col)]);
            if let Some(heading) = body.heading {
                point[3 + heading as usize] = 1.0;
            }
            point[7] = (body.priority as f32 / priority_scale).clamp(-1.0, 1.0);
            let unary = oracle
                .how
                .iter()
                .enumerate()
                .filter(|(_, how)| !matches!(how, How::Pair(_)));
            for ((predicate, how), value) in unary.zip(&mut point[8..]) {
                let holds = match how {
                    How::Steady(_) => self.is_steadily(body, predicate),
                    How::AtIntersection => body.junction.is_at(body.kind),
                    How::InIntersection => body.junction.is_inside(),
                    How::Pair(_) => false,
                };
                *value = f32::from(u8::from(holds));
            }
        };
        let ego = Body::new(oracle.world.map(), self.ego, &city.agents()[self.ego]);
        write(&ego, ego.at);
        for (position, agent) in city.agents().iter().enumerate() {
            if position != self.ego && oracle.sees(&ego, agent.cell) {
                write(&Body::new(oracle.world.map(), position, agent), ego.at);
            }
        }
    }

    fn is_steadily(&self, body: &Body, predicate: usize) -> bool {
        self.steady[body.agent as usize * self.words + predicate / 64] >> (predicate % 64) & 1 != 0
    }

    /// The true atoms, `Sees` left out: the predicate by its position in the vocabulary, and agents by theirs in the list.
    pub fn atoms(&self) -> impl Iterator<Item = (usize, Vec<usize>)> {
        let sees = self.oracle.world.vocabulary.sees;
        let agent = |entity: usize| self.bodies[entity].agent as usize;
        let predicates = (0..self.oracle.how.len()).filter(move |predicate| *predicate != sees);
        predicates.flat_map(move |predicate| {
            let alone = members(&[self.atoms.unary[predicate]]).map(move |entity| vec![agent(entity)]);
            let pairs = (0..self.bodies.len())
                .flat_map(move |x| members(&[self.atoms.row(predicate, x)]).map(move |y| vec![agent(x), agent(y)]));
            alone
                .chain(pairs)
                .map(move |agents| (predicate, agents))
                .collect::<Vec<_>>()
        })
    }

    /// A session with the observed facts and what the rules derive from them, and the value that stands for the ego in it.
    ///
    /// # Errors
    /// `limit-exceeded` for rules that derive too much.
    pub fn session(&self, city: &Simulation) -> Result<(Session, Value), Diagnostic> {
        let world = &self.oracle.world;
        let names: Vec<String> = city.agents().iter().map(|agent| agent.name().to_string()).collect();
        let mut state = GroundState::new(&world.program, &world.vocabulary, names.iter().map(String::as_str));
        let observed = Observed::new(&self.atoms, &self.bodies, city);
        let set = state.set_until(&observed.facts(self.oracle.how.len()), city.stop());
        set.map_err(|error| error.diagnostic(world.program.rules()))?;
        let (session, values) = state.into_parts();
        Ok((session, values[self.ego]))
    }

    /// The actions that the rules derive for the ego before the default.
    ///
    /// # Errors
    /// `limit-exceeded` for rules that derive too much.
    pub fn derived(&mut self, city: &Simulation) -> Result<Actions, Diagnostic> {
        let oracle = &*self.oracle;
        self.atoms.unary[oracle.how.len()..].fill(0);
        let observed = Observed::new(&self.atoms, &self.bodies, city);
        self.wanted.run(&oracle.wanted, observed, city.stop())?;
        let vocabulary = &oracle.world.vocabulary;
        let derived = match (&self.wanted, &oracle.wanted) {
            (State::Dense(frame), Evaluator::Dense(rules)) => {
                let holds = |speed: &Speed| {
                    let relation = vocabulary.action(*speed);
                    relation.is_some_and(|action| frame.set(&rules.dense, action).is_some_and(|set| has(set, 0)))
                };
                Speed::ALL.into_iter().filter(holds).collect()
            }
            (State::Relational(Some(state)), _) => state.derived(vocabulary, self.ego),
            _ => unreachable!("it has been evaluated"),
        };
        Ok(vocabulary.before_default(derived))
    }

    /// The clauses that an action breaks: those whose body holds if the ego takes it, and whose head is another action. They are named by
    /// their positions in [`Oracle::demands`].
    ///
    /// # Errors
    /// `limit-exceeded` for rules that derive too much.
    pub fn broken(&mut self, city: &Simulation, action: Speed) -> Result<&[usize], Diagnostic> {
        let oracle = &*self.oracle;
        let given = &mut self.atoms.unary[oracle.how.len()..];
        given.fill(0);
        given[action as usize] = 1;
        let observed = Observed::new(&self.atoms, &self.bodies, city);
        self.judged.run(&oracle.judged, observed, city.stop())?;
        self.broken.clear();
        let (judged, ego) = (&self.judged, self.ego);
        let holds = |clause: ClauseId| match (judged, &oracle.judged) {
            (State::Dense(frame), Evaluator::Dense(rules)) => {
                frame.fired(&rules.dense, clause).is_some_and(|set| has(set, 0))
            }
            (State::Relational(Some(state)), _) => {
                let value = state.value(ego);
                state.session().fired(clause).iter().any(|row| row[0] == value)
            }
            _ => unreachable!("it has been evaluated"),
        };
        let demands = oracle.demands.iter().enumerate();
        let broken = demands.filter(|(_, demand)| demand.action != action && holds(demand.clause));
        self.broken.extend(broken.map(|(position, _)| position));
        Ok(&self.broken)
    }
}
