//! The predicates of a dense program without a fast form: conditions on quantities, what temporal operators read of earlier
//! ticks, and facts that the caller or a session provides.

use crate::city::{Agent, CityMap, Heading};
use crate::datalog::dense::{EntityDraw, Set, TickDraw, and, first, holding};
use crate::datalog::{Comparison, PredicateId, Value};
use crate::predicate::{Measure, Measured, Progress, Quantity, headings};
use crate::sim::tick::agent_state::AgentState;
use crate::sim::tick::chance::{Drawing, Draws};
use crate::sim::tick::executor::{Conditions, DenseRules, Threshold};
use crate::sim::tick::external::ExternalFacts;
use crate::sim::tick::ground::word;
use crate::sim::tick::memory::Memory;
use crate::sim::tick::vocabulary::Vocabulary;

/// The state of the city that windows read besides their bodies.
#[derive(Clone, Copy)]
pub(crate) struct Now<'a> {
    pub draws: Draws,
    /// All agents, in list order. Only quantities read them.
    pub agents: &'a [Agent],
    /// What temporal operators read of earlier ticks.
    pub memory: &'a Memory,
    /// What draws of clauses read.
    pub drawing: Drawing<'a>,
    /// The facts of the external predicates.
    pub external: &'a ExternalFacts,
    /// The facts of the rules that a session evaluates.
    pub handed: &'a ExternalFacts,
}

impl Now<'_> {
    #[inline]
    pub fn given(&self, source: Source) -> &ExternalFacts {
        match source {
            Source::Caller => self.external,
            Source::Session => self.handed,
        }
    }

    /// Returns the entities whose number is within a threshold. `whole`: the bodies are all agents, in list order.
    #[inline]
    fn within<const W: usize>(
        &self,
        map: &CityMap,
        threshold: &Threshold,
        bodies: &[AgentState],
        whole: bool,
    ) -> Set<W> {
        let holds = |number: Option<i32>| number.is_some_and(|number| threshold.holds(number));
        // The most frequent quantities have loops of their own.
        match threshold.quantity {
            Quantity::Waited if whole => set_of(self.agents, |agent| holds(carried(Quantity::Waited, agent))),
            Quantity::Speed if whole => set_of(self.agents, |agent| holds(carried(Quantity::Speed, agent))),
            Quantity::Priority => set_of(bodies, |body| threshold.holds(body.priority)),
            quantity => set_of(bodies, |body| holds(self.number(map, quantity, body))),
        }
    }

    /// Returns a whole number of an agent.
    #[inline]
    fn number(&self, map: &CityMap, quantity: Quantity, body: &AgentState) -> Option<i32> {
        carried(quantity, &self.agents[body.agent as usize]).or_else(|| match quantity {
            Quantity::Priority => Some(body.priority),
            Quantity::Tick => Some(self.tick()),
            quantity => self.value(map, quantity, [body; 2], &[0]).map(Value::as_number),
        })
    }

    /// Returns whether a draw succeeds for two agents.
    #[inline(always)]
    pub fn succeeds(&self, draw: &TickDraw, bodies: [&AgentState; 2]) -> bool {
        let names = self.drawing.names;
        draw.succeeds(bodies.map(|body| names.get(body.agent as usize).copied().unwrap_or_default()))
    }

    fn tick(&self) -> i32 {
        i32::try_from(self.draws.time).unwrap_or(i32::MAX)
    }

    /// Returns the value of a quantity for the agents at these places of `bodies`.
    fn value(&self, map: &CityMap, quantity: Quantity, bodies: [&AgentState; 2], places: &[usize]) -> Option<Value> {
        let measured = bodies.map(|body| Measured {
            subject: body.subject(),
            progress: Progress::of(&self.agents[body.agent as usize], quantity.reads_exit().then_some(map)),
        });
        let measure = match *places {
            [x] => quantity.measure(map, self.draws.time, &[&measured[x]]),
            // Two agents are different ones.
            [x, y] if bodies[x].agent == bodies[y].agent => None,
            [x, y] => quantity.measure(map, self.draws.time, &[&measured[x], &measured[y]]),
            _ => quantity.measure(map, self.draws.time, &[]),
        };
        measure.map(word)
    }
}

/// A predicate without a fast form that a dense program reads.
#[derive(Clone, Debug)]
pub(super) enum Hidden {
    /// A condition on whole numbers of one agent.
    Thresholds(Vec<Threshold>),
    /// A comparison of whole numbers of two agents.
    Comparison(Quantity, Comparison, Quantity),
    /// A condition on the heading of an agent: those for which it holds.
    Headings(HeadingSet),
    /// A condition, by its position, on the heading of an agent and the tick, or on the tick alone.
    TickAndHeading(usize),
    Tick(usize),
    /// A draw with constant probabilities about at most two agents.
    Draw(EntityDraw),
    /// Another condition on quantities, by its position.
    Condition(usize),
    /// What a temporal operator reads of earlier ticks, by its position in the memory.
    Past(usize),
    /// A predicate whose facts come from this source, by its position there.
    Given(Source, usize),
}

/// The headings, and the lack of one, for which a condition holds.
#[derive(Clone, Copy, Debug)]
pub(super) struct HeadingSet(u8);

impl HeadingSet {
    /// Finds the headings of an agent for which a condition on its heading and the tick holds in this tick.
    fn new(conditions: &Conditions, condition: usize, tick: i32) -> HeadingSet {
        let holds = |heading: Option<Heading>| {
            let value = |_, quantity, _: &[usize]| match quantity {
                Quantity::Heading => heading.map(|heading| word(Measure::Heading(heading))),
                _ => Some(Value::number(tick)),
            };
            conditions.holds(condition, value, 0, [0; 2])
        };
        let bits = headings()
            .into_iter()
            .enumerate()
            .map(|(bit, heading)| u8::from(holds(heading)) << bit);
        HeadingSet(bits.fold(0, |set, bit| set | bit))
    }

    #[inline]
    fn contains(self, heading: Option<Heading>) -> bool {
        self.0 >> heading.map_or(0, |heading| heading as usize + 1) & 1 != 0
    }
}

/// Who computes the facts of predicates.
#[derive(Clone, Copy, Debug)]
pub(super) enum Source {
    /// The caller: external predicates.
    Caller,
    /// A session: what the rules of the dense executor lack.
    Session,
}

impl Hidden {
    /// Returns the form of a predicate; `None` if it has none, or a fast one.
    pub fn of(rules: &DenseRules, vocabulary: &Vocabulary, predicate: PredicateId) -> Option<Hidden> {
        let condition = rules.conditions.find(predicate).map(|condition| {
            let conditions = &rules.conditions;
            let thresholds = conditions.thresholds(condition).map(Hidden::Thresholds);
            let comparison = |(first, op, second)| Hidden::Comparison(first, op, second);
            let known = thresholds
                .or_else(|| conditions.comparison(condition).map(comparison))
                .or_else(|| conditions.entity_draw(condition).map(Hidden::Draw));
            known.unwrap_or_else(|| match conditions.reads(condition).as_deref() {
                Some([Quantity::Tick, rest @ ..]) if rest.iter().all(|of| *of == Quantity::Tick) => {
                    Hidden::Tick(condition)
                }
                Some(reads) if reads.iter().all(|of| *of == Quantity::Heading) => {
                    Hidden::Headings(HeadingSet::new(conditions, condition, 0))
                }
                Some(reads) if reads.iter().all(|of| matches!(of, Quantity::Heading | Quantity::Tick)) => {
                    Hidden::TickAndHeading(condition)
                }
                _ => Hidden::Condition(condition),
            })
        });
        let mut externals = vocabulary.externals();
        let mut handed = rules.handed.iter().flat_map(|handed| &handed.predicates);
        condition
            .or_else(|| rules.past(predicate).map(Hidden::Past))
            .or_else(|| {
                let position = externals.position(|(known, _)| known.id == Some(predicate))?;
                Some(Hidden::Given(Source::Caller, position))
            })
            .or_else(|| {
                let position = handed.position(|(dense, ..)| *dense == predicate)?;
                Some(Hidden::Given(Source::Session, position))
            })
    }

    /// Returns whether the predicate holds for agents.
    pub fn holds(&self, conditions: &Conditions, map: &CityMap, now: Now<'_>, bodies: [&AgentState; 2]) -> bool {
        match *self {
            Hidden::Thresholds(ref thresholds) => thresholds.iter().all(|threshold| {
                let number = now.number(map, threshold.quantity, bodies[0]);
                number.is_some_and(|number| threshold.holds(number))
            }),
            Hidden::Comparison(first, op, second) => {
                let [x, y] = bodies;
                let numbers = (now.number(map, first, x), now.number(map, second, y));
                matches!(numbers, (Some(left), Some(right)) if op.accepts(left.cmp(&right)))
            }
            Hidden::Headings(headings) => headings.contains(bodies[0].heading),
            Hidden::Draw(draw) => now.succeeds(&draw.in_tick(now.drawing.word), bodies),
            Hidden::Condition(condition) | Hidden::Tick(condition) | Hidden::TickAndHeading(condition) => {
                let value = |_, quantity, places: &[usize]| now.value(map, quantity, bodies, places);
                let Drawing { word, names } = now.drawing;
                let hashes = bodies.map(|body| names.get(body.agent as usize).copied().unwrap_or_default());
                conditions.holds(condition, value, word, hashes)
            }
            Hidden::Past(past) => now.memory.holds(past, bodies[0].agent, bodies[1].agent),
            Hidden::Given(source, predicate) => (now.given(source)).holds(predicate, bodies[0].agent, bodies[1].agent),
        }
    }

    /// Returns the entities for which the predicate holds, or with `diagonal` those that it relates to themselves.
    /// `whole`: the bodies are all agents, in list order.
    pub fn members<const W: usize>(
        &self,
        conditions: &Conditions,
        map: &CityMap,
        now: Now<'_>,
        bodies: &[AgentState],
        (diagonal, whole): (bool, bool),
    ) -> Set<W> {
        match self {
            Hidden::Thresholds(thresholds) => {
                let within = thresholds
                    .iter()
                    .map(|threshold| now.within(map, threshold, bodies, whole));
                within.fold(first(bodies.len()), |all, within| and(all, &within))
            }
            Hidden::Draw(draw) => {
                let Drawing { word, names } = now.drawing;
                let draw = draw.in_tick(word);
                match whole && names.len() == bodies.len() {
                    true => set_of(names, |hash| draw.succeeds([*hash; 2])),
                    false => set_of(bodies, |body| now.succeeds(&draw, [body, body])),
                }
            }
            Hidden::Headings(headings) => set_of(bodies, |body| headings.contains(body.heading)),
            Hidden::TickAndHeading(condition) => {
                let headings = HeadingSet::new(conditions, *condition, now.tick());
                set_of(bodies, |body| headings.contains(body.heading))
            }
            Hidden::Tick(_) => {
                let holds = bodies
                    .first()
                    .is_some_and(|body| self.holds(conditions, map, now, [body, body]));
                if holds { first(bodies.len()) } else { [0; W] }
            }
            Hidden::Past(past) if !diagonal => match now.memory.holding(*past).filter(|_| whole) {
                Some(holding) => set_of_words(holding),
                None => set_of(bodies, |body| now.memory.holds_alone(*past, body.agent)),
            },
            Hidden::Given(source, predicate) if !diagonal && whole => {
                set_of_words(now.given(*source).members(*predicate))
            }
            _ => set_of(bodies, |body| self.holds(conditions, map, now, [body, body])),
        }
    }
}

/// Returns the set of the entities whose bits are set.
pub(super) fn set_of_words<const W: usize>(words: &[u64]) -> Set<W> {
    std::array::from_fn(|word| words.get(word).copied().unwrap_or(0))
}

/// Returns a whole number that an agent carries; `None` for other quantities.
#[inline(always)]
fn carried(quantity: Quantity, agent: &Agent) -> Option<i32> {
    match quantity {
        Quantity::Waited => Some(i32::try_from(agent.waited).unwrap_or(i32::MAX)),
        Quantity::Speed => Some(i32::from(agent.speed)),
        _ => None,
    }
}

/// Returns the set of the entities for which `holds` is true.
#[inline(always)]
fn set_of<T, const W: usize>(entities: &[T], holds: impl Fn(&T) -> bool) -> Set<W> {
    let mut set = [0; W];
    for (word, entities) in set.iter_mut().zip(entities.chunks(64)) {
        *word = holding(entities.iter().map(&holds));
    }
    set
}
