//! The rules that the dense executor hands over: a session derives their rows before it runs.

use crate::cancel::Cancel;
use crate::city::Agent;
use crate::datalog::dense::members;
use crate::datalog::{ClauseId, Value};
use crate::diag::Diagnostic;
use crate::predicate::{Definition, External, PairRelation, Relation, Subject, Views, with_relation};
use crate::sim::tick::chance::{Chance, Draws};
use crate::sim::tick::executor::HandedRules;
use crate::sim::tick::external::ExternalFacts;
use crate::sim::tick::ground::{Facts, Stopped, bounded};
use crate::sim::tick::ground_state::{GroundPredicate, GroundState};
use crate::sim::tick::vocabulary::BasePredicate;
use crate::sim::tick::window::Plan;
use crate::sim::tick::world::World;
use std::sync::Arc;

/// The session of a city with these rules.
pub(super) struct HandedState {
    plan: Arc<Plan>,
    state: GroundState,
    facts: ExternalFacts,
    /// The fast forms of the predicates over two agents that the rules read, with their positions in the vocabulary.
    relations: Vec<(usize, PairRelation)>,
    views: Views,
}

impl HandedState {
    /// Creates the session for these agents; `None` if the plan hands nothing over.
    pub fn new(world: &World, plan: &Arc<Plan>, agents: &[Agent]) -> Option<HandedState> {
        let rules = plan.rules.handed.as_ref()?;
        let predicates = GroundPredicate::of(&world.vocabulary).zip(&rules.is_read);
        let predicates = predicates.map(|(predicate, read)| predicate.filter(|_| *read));
        let names: Vec<String> = agents.iter().map(|agent| agent.name().to_string()).collect();
        let arities = rules.predicates.iter().map(|(.., columns)| match columns {
            1 => External::Agent,
            _ => External::Pair,
        });
        let relation = |(position, known): (usize, &BasePredicate)| match &known.definition {
            Definition::Pair(pair) if rules.is_read[position] => Some((position, pair.relation(world.router.map()))),
            _ => None,
        };
        let known = world.vocabulary.predicates.iter().enumerate();
        Some(HandedState {
            relations: known.filter_map(relation).collect(),
            views: Views::new(world.scenario.view),
            state: GroundState::over(
                &rules.program,
                predicates.collect(),
                world.limits,
                names.iter().map(String::as_str),
            ),
            facts: ExternalFacts::new(arities, agents.len()),
            plan: Arc::clone(plan),
        })
    }

    /// Returns the rules.
    pub fn rules(&self) -> &HandedRules {
        self.plan.rules.handed.as_ref().expect("there is a session for them")
    }

    /// Returns what the dense executor reads.
    pub fn facts(&self) -> &ExternalFacts {
        &self.facts
    }

    /// Returns whether the caller grounds the predicate at this position in the vocabulary.
    pub fn lacks(&self, predicate: usize) -> bool {
        self.rules().is_read[predicate] && self.relations.iter().all(|(known, _)| *known != predicate)
    }

    /// Adds the facts that the caller does not ground, within these bounds.
    ///
    /// # Errors
    /// As [`ground_with`](crate::sim::tick::ground::ground_with).
    pub fn add_pairs(
        &self,
        subjects: &[Subject],
        draws: Draws,
        facts: &mut Facts,
        bounds: (u64, &Cancel),
    ) -> Result<(), Stopped> {
        let mut bits = vec![0; subjects.len()];
        for (predicate, relation) in &self.relations {
            let stop = bounded(facts, bounds);
            let rows = &mut facts.rows[*predicate];
            let draw = |x: usize, y: usize, probability: f64| draws.decides(*predicate, x, y, probability);
            let (views, bits) = (&self.views, &mut bits);
            with_relation!(relation, relation => relate((relation, views), subjects, draw, stop, bits, rows))?;
        }
        Ok(())
    }

    /// Derives the rows from these facts. Returns whether all of them are about agents: the dense executor cannot read
    /// one with a constant that names no agent.
    ///
    /// # Errors
    /// As [`GroundState::set_with`].
    pub fn evaluate(&mut self, facts: &Facts, cancel: &Cancel) -> Result<bool, Diagnostic> {
        let HandedState {
            plan,
            state,
            facts: derived,
            ..
        } = self;
        let rules = plan.rules.handed.as_ref().expect("there is a session for them");
        (state.set_with(facts, cancel)).map_err(|error| error.diagnostic(rules.program.rules()))?;
        derived.clear();
        for (position, &(_, predicate, columns)) in rules.predicates.iter().enumerate() {
            for row in state.session().encoded_rows(predicate) {
                let mut agents = row[..columns].iter().map(|value| state.entity(*value));
                let (Some(Some(first)), Some(second)) = (agents.next(), agents.next().unwrap_or(Some(0))) else {
                    return Ok(false);
                };
                derived.add(position, first, second);
            }
        }
        Ok(true)
    }

    /// Returns the rows that a clause derived; `None` if it is not handed over.
    pub fn fired(&self, clause: ClauseId) -> Option<Vec<Vec<Value>>> {
        let clauses = &self.rules().clauses;
        let position = clauses.binary_search_by_key(&clause, |(dense, _)| *dense).ok()?;
        Some(self.state.session().fired(clauses[position].1))
    }

    /// Returns the position in the list of the agent that a value represents.
    pub fn agent(&self, value: Value) -> Option<usize> {
        self.state.entity(value)
    }
}

/// Adds the rows of a relation. Asks `stop` before each first agent. `bits` has a word for each agent.
fn relate<R: Relation>(
    (relation, views): (&R, &Views),
    subjects: &[Subject],
    draw: impl Fn(usize, usize, f64) -> bool,
    stop: impl Fn(&[[u32; 2]]) -> Result<(), Stopped>,
    bits: &mut [u64],
    rows: &mut Vec<[u32; 2]>,
) -> Result<(), Stopped> {
    let number = |agent: usize| u32::try_from(agent).expect("fewer than 2^32 agents");
    if subjects.len() <= 64 {
        bits.fill(0);
        relation.relate(views, subjects.iter().copied(), draw, bits);
        for (x, related) in bits.iter().enumerate() {
            stop(rows)?;
            rows.extend(members(&[*related]).map(|y| [number(x), number(y)]));
        }
        return stop(rows);
    }
    for (x, first) in subjects.iter().enumerate() {
        stop(rows)?;
        for (y, second) in subjects.iter().enumerate() {
            let holds = match x == y {
                true => R::REFLEXIVE,
                false => relation.holds(views, first, second, |probability| draw(x, y, probability)),
            };
            if holds {
                rows.push([number(x), number(y)]);
            }
        }
    }
    stop(rows)
}
