//! Facts of a city or a scene in a session, updated by differences.

use crate::cancel::Cancel;
use crate::city::Action;
use crate::datalog::{BaseType, EvalError, Limits, Past, PredicateId, Program, Session, Value};
use crate::predicate::WORDS;
use crate::sim::tick::ground::Facts;
use crate::sim::tick::memory::Watched;
use crate::sim::tick::vocabulary::{Actions, Vocabulary};
use std::cmp::Ordering;
use std::collections::HashMap;

/// A session that holds grounded facts.
pub struct GroundState {
    session: Session,
    entities: Vec<Value>,
    positions: HashMap<Value, usize>,
    predicates: Vec<Option<GroundPredicate>>,
    /// The hidden predicates about earlier ticks.
    pasts: Vec<GroundPredicate>,
    /// The symbols of [`WORDS`].
    words: [Value; WORDS.len()],
    facts: Facts,
    /// The limits of each evaluation, whose memory the facts share.
    limits: Limits,
}

/// A predicate whose facts are grounded.
#[derive(Clone, Copy, Debug)]
pub(crate) struct GroundPredicate {
    pub id: PredicateId,
    /// The number of columns for entities.
    pub arity: usize,
    /// The base type of the last column, if it holds a value.
    pub value: Option<BaseType>,
}

impl GroundPredicate {
    /// Returns the number of columns.
    fn columns(self) -> usize {
        self.arity + usize::from(self.value.is_some())
    }

    /// Returns the predicates of a vocabulary, in its order; `None` for those that the rules do not declare.
    pub fn of(vocabulary: &Vocabulary) -> impl Iterator<Item = Option<GroundPredicate>> {
        vocabulary.predicates.iter().map(|predicate| {
            Some(GroundPredicate {
                id: predicate.id?,
                arity: predicate.arity,
                value: predicate.value,
            })
        })
    }
}

impl GroundState {
    /// Creates a session for the entities of these names, without facts. `limits` applies to each evaluation.
    pub fn new<'n>(
        program: &Program,
        vocabulary: &Vocabulary,
        limits: Limits,
        names: impl Iterator<Item = &'n str>,
    ) -> Self {
        GroundState::over(program, GroundPredicate::of(vocabulary).collect(), limits, names)
    }

    /// Variant of [`new`](Self::new) for the given predicates.
    pub(crate) fn over<'n>(
        program: &Program,
        predicates: Vec<Option<GroundPredicate>>,
        limits: Limits,
        names: impl Iterator<Item = &'n str>,
    ) -> Self {
        let mut session = program.session();
        let rules = program.rules();
        let past = |past: &Past| GroundPredicate {
            id: past.predicate,
            arity: rules.predicates[past.predicate.index()].arity(),
            value: None,
        };
        let entities: Vec<Value> = names.map(|name| session.intern(name)).collect();
        GroundState {
            positions: entities
                .iter()
                .enumerate()
                .map(|(index, &value)| (value, index))
                .collect(),
            entities,
            words: WORDS.map(|word| session.intern(word)),
            session,
            facts: Facts::new(predicates.len()),
            predicates,
            pasts: rules.pasts.iter().map(past).collect(),
            limits,
        }
    }

    /// Sets the limits of later evaluations.
    pub(crate) fn set_limits(&mut self, limits: Limits) {
        self.limits = limits;
    }

    /// Replaces the current facts by `facts`: inserts and retracts the difference and commits.
    ///
    /// # Errors
    /// As [`Session::commit`]. On error `self` is unchanged.
    pub fn set(&mut self, facts: &Facts) -> Result<(), EvalError> {
        self.set_with(facts, &Cancel::never())
    }

    /// Cancellable variant of [`set`](Self::set).
    ///
    /// # Errors
    /// As [`Session::commit_with`]. On error `self` is unchanged.
    pub fn set_with(&mut self, facts: &Facts, cancel: &Cancel) -> Result<(), EvalError> {
        let limit = self.limits.bytes;
        let held = facts.bytes() + self.facts.bytes();
        // The session stores the facts once more, and this state copies them.
        if held + 2 * facts.bytes() > limit {
            return Err(EvalError::TooManyInputs { limit });
        }
        for (index, predicate) in self.predicates.iter().enumerate() {
            let Some(predicate) = *predicate else { continue };
            // Both lists are sorted.
            let (mut before, mut after) = (0, 0);
            loop {
                let old = self.facts.rows[index].get(before);
                let new = facts.rows[index].get(after);
                let order = match (old, new) {
                    (None, None) => break,
                    (Some(old), Some(new)) => old.cmp(new),
                    (Some(_), None) => Ordering::Less,
                    (None, Some(_)) => Ordering::Greater,
                };
                let [of_old, of_new] =
                    [(&self.facts, before), (facts, after)].map(|(of, row)| of.values[index].get(row));
                let is_same = order.is_eq() && of_old == of_new;
                if let Some(row) = old.filter(|_| order.is_le() && !is_same) {
                    let words = self.words(predicate, *row, of_old);
                    (self.session.retract(predicate.id, &words[..predicate.columns()])).expect("bound predicates fit");
                }
                if let Some(row) = new.filter(|_| order.is_ge() && !is_same) {
                    let words = self.words(predicate, *row, of_new);
                    (self.session.insert(predicate.id, &words[..predicate.columns()])).expect("bound predicates fit");
                }
                before += usize::from(order.is_le());
                after += usize::from(order.is_ge());
            }
        }
        for (index, predicate) in self.pasts.iter().enumerate() {
            let [old, new] = [&self.facts, facts].map(|of| of.past.get(index).map_or(&[][..], Vec::as_slice));
            for (row, _) in old {
                if new.binary_search_by_key(row, |(row, _)| *row).is_err() {
                    let words = self.words(*predicate, *row, None);
                    (self.session.retract(predicate.id, &words[..predicate.arity])).expect("bound predicates fit");
                }
            }
            // Also those that hold already, since their ticks change.
            for (row, tick) in new {
                let words = self.words(*predicate, *row, None);
                let inserted = self.session.insert_past(predicate.id, &words[..predicate.arity], *tick);
                inserted.expect("bound predicates fit");
            }
        }
        self.session.set_chance(facts.chance);
        self.session.set_limits(Limits {
            bytes: limit - held,
            ..self.limits
        });
        if let Err(mut error) = self.session.commit_with(cancel) {
            self.session.rollback();
            if let EvalError::TooManyInputs { limit: left } | EvalError::TooMuchMemory { limit: left, .. } = &mut error
            {
                *left = limit;
            }
            return Err(error);
        }
        self.facts.clone_from(facts);
        Ok(())
    }

    /// Returns the row of a session for a row of [`Facts`].
    fn words(&self, predicate: GroundPredicate, row: [u32; 2], value: Option<&Value>) -> [Value; 3] {
        let mut words = [Value::default(); 3];
        for (word, entity) in words.iter_mut().zip(&row[..predicate.arity]) {
            *word = self.entities[*entity as usize];
        }
        if let (Some(base), Some(&value)) = (predicate.value, value) {
            words[predicate.arity] = match base {
                BaseType::Symbol => self.words[value.0 as usize],
                _ => value,
            };
        }
        words
    }

    /// Returns the derived actions of an entity.
    pub fn derived(&self, vocabulary: &Vocabulary, entity: usize) -> Actions {
        let holds = |action: &Action| {
            let predicate = vocabulary.action(*action);
            predicate.is_some_and(|predicate| self.session.contains(predicate, [self.entities[entity]]))
        };
        vocabulary.actions().all().filter(holds).collect()
    }

    /// Adds the rows of the predicates that temporal operators are about.
    pub(crate) fn watch(&self, watched: &mut Watched) {
        self.watch_as(watched, |entity| entity);
    }

    /// Variant of [`watch`](Self::watch) with another number for each entity.
    pub(crate) fn watch_as(&self, watched: &mut Watched, number: impl Fn(usize) -> usize) {
        watched.clear();
        for position in 0..watched.predicates().len() {
            let (predicate, arity) = watched.predicates()[position];
            for words in self.session.encoded_rows(predicate) {
                let mut row = [0; 2];
                let agents = row.iter_mut().zip(&words[..arity]).try_for_each(|(agent, word)| {
                    // A constant may name no agent.
                    *agent = u32::try_from(number(self.entity(*word)?)).expect("fewer than 2^32 agents");
                    Some(())
                });
                if agents.is_some() {
                    watched.add(position, row);
                }
            }
        }
        watched.sort();
    }

    /// Returns the session.
    pub fn session(&self) -> &Session {
        &self.session
    }

    /// Returns the session and the values that represent the entities.
    pub fn into_parts(self) -> (Session, Vec<Value>) {
        (self.session, self.entities)
    }

    /// Returns the value that represents an entity.
    pub fn value(&self, entity: usize) -> Value {
        self.entities[entity]
    }

    /// Returns the position of the entity that a value represents.
    pub fn entity(&self, value: Value) -> Option<usize> {
        self.positions.get(&value).copied()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::builtin::BuiltinFiles;
    use crate::config::load_scenario;
    use crate::diag::Sources;
    use std::path::Path;

    #[test]
    fn facts_that_derive_too_much_leave_no_trace() {
        let mut sources = Sources::new();
        let scenario = load_scenario(&mut sources, Path::new("expert"), &BuiltinFiles).expect("built in");
        let rules = sources.add("test.dl", ".include \"vocabulary.dl\"\nStop(X) :- IsBus(X).");
        let loaded = crate::datalog::load(&mut sources, rules, &BuiltinFiles);
        let program = Program::new(loaded.rules.expect("no errors")).expect("within limits");
        let vocabulary = Vocabulary::bind(&scenario, &program).expect("they fit");
        let bus = vocabulary
            .predicates
            .iter()
            .position(|predicate| predicate.name == "IsBus")
            .expect("it is in use");
        let nothing = Facts::new(vocabulary.predicates.len());
        let mut one_bus = nothing.clone();
        one_bus.rows[bus].push([0, 0]);

        let rows = |rows| Limits {
            rows,
            ..Limits::default()
        };
        let mut state = GroundState::new(&program, &vocabulary, rows(0), ["Car_1"].into_iter());
        assert!(state.set(&one_bus).is_err());
        state.set(&nothing).expect("it derives nothing");
        state.set_limits(rows(10));
        assert!(state.derived(&vocabulary, 0).is_empty());
        state.set(&one_bus).expect("within the limit");
        assert_eq!(state.derived(&vocabulary, 0), [Action::Stop].into_iter().collect());
    }
}
