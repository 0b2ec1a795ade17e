//! Facts of a city or a scene in a session, updated by differences.

use crate::cancel::Cancel;
use crate::city::Action;
use crate::datalog::{EvalError, Limits, PredicateId, Program, Session, Value};
use crate::sim::tick::ground::Facts;
use crate::sim::tick::vocabulary::{Actions, Vocabulary};
use std::collections::HashMap;

/// A session that holds grounded facts.
pub struct GroundState {
    session: Session,
    entities: Vec<Value>,
    positions: HashMap<Value, usize>,
    predicates: Vec<Option<(PredicateId, usize)>>,
    facts: Facts,
    /// The limits of each evaluation, whose memory the facts share.
    limits: Limits,
}

impl GroundState {
    /// Creates a session for the entities of these names, without facts. `limits` applies to each evaluation.
    pub fn new<'n>(
        program: &Program,
        vocabulary: &Vocabulary,
        limits: Limits,
        names: impl Iterator<Item = &'n str>,
    ) -> Self {
        let predicates = vocabulary.predicates.iter();
        let predicates = predicates.map(|predicate| predicate.id.map(|declared| (declared, predicate.arity)));
        GroundState::over(program, predicates.collect(), limits, names)
    }

    /// Variant of [`new`](Self::new) for the given predicates, with one or two columns each.
    pub(crate) fn over<'n>(
        program: &Program,
        predicates: Vec<Option<(PredicateId, usize)>>,
        limits: Limits,
        names: impl Iterator<Item = &'n str>,
    ) -> Self {
        let mut session = program.session();
        let entities: Vec<Value> = names.map(|name| session.intern(name)).collect();
        GroundState {
            session,
            positions: entities
                .iter()
                .enumerate()
                .map(|(index, &value)| (value, index))
                .collect(),
            entities,
            facts: Facts {
                rows: vec![Vec::new(); predicates.len()],
            },
            predicates,
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
            let Some((predicate, arity)) = *predicate else { continue };
            let (old, new) = (&self.facts.rows[index], &facts.rows[index]);
            let row = |row: &[u32; 2]| row.map(|entity| self.entities[entity as usize]);
            for removed in old.iter().filter(|row| new.binary_search(row).is_err()) {
                let row = row(removed);
                self.session
                    .retract(predicate, &row[..arity])
                    .expect("bound predicates fit");
            }
            for added in new.iter().filter(|row| old.binary_search(row).is_err()) {
                let row = row(added);
                self.session
                    .insert(predicate, &row[..arity])
                    .expect("bound predicates fit");
            }
        }
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

    /// Returns the derived actions of an entity.
    pub fn derived(&self, vocabulary: &Vocabulary, entity: usize) -> Actions {
        let holds = |action: &Action| {
            let predicate = vocabulary.action(*action);
            predicate.is_some_and(|predicate| self.session.contains(predicate, [self.entities[entity]]))
        };
        Action::ALL.into_iter().filter(holds).collect()
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
        let nothing = Facts {
            rows: vec![Vec::new(); vocabulary.predicates.len()],
        };
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
