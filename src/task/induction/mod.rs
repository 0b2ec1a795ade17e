//! Learning rules for a city: examples from episodes, traces and scenes, and learned rules as a rule file.
//!
//! The module [`induce`](crate::induce) learns. This one translates between it and the city.

mod ask;
pub mod codes;
mod popper;
mod recalls;
#[cfg(feature = "parquet")]
mod steps;
mod text;

pub use ask::{Asked, Inquiry, LOG_START, LogError, OracleError, Questions, RuleOracle};
pub use popper::TargetRules;
pub use recalls::Recalls;
#[cfg(feature = "parquet")]
pub use steps::{Step, Steps};
pub use text::{Origin, broken_constraints, only_action, report_json, rule_file};

use crate::city::Action;
use crate::datalog::{self, Constraint, PredicateId};
use crate::diag::{self, Diagnostic, listed};
use crate::induce::{Constraints, ENTITIES_MAX, Examples, Predicate, Settings, State, Vocabulary, tuples};
use crate::sim::{self, Facts, OBSERVED_MAX, World};
use crate::task::spf::{Env, Episode};
use std::sync::Arc;

/// What rules for a city are learned from: its predicates and actions.
#[derive(Clone, Debug)]
pub struct InductionTask {
    world: Arc<World>,
    vocabulary: Vocabulary,
    actions: Vec<Action>,
}

impl InductionTask {
    /// Creates the task of learning rules for a world. Clauses may use every base predicate that its rules declare.
    ///
    /// Clauses are learned for the actions that the rules declare, except the default one. In learned rules the first
    /// of `order` has precedence over the others; actions that it lacks follow in the order of
    /// [`Action::SAFEST_FIRST`]. Learned rules derive at most one action, so the precedence of the configuration does
    /// not matter.
    ///
    /// # Errors
    /// `rule-mismatch` if the configuration defines actions.
    pub fn new(world: Arc<World>, order: &[Action]) -> Result<InductionTask, Diagnostic> {
        world.vocabulary.only_standard_actions("learned rules")?;
        let known = &world.vocabulary;
        let symmetric = |predicate: &sim::BasePredicate| {
            (world.program.rules().constraints.iter()).any(|declared| match declared.constraint {
                Constraint::Symmetric(declared) => Some(declared) == predicate.id,
                _ => false,
            })
        };
        let predicates = observed(known).map(|(_, predicate)| Predicate {
            name: predicate.name.clone(),
            arity: predicate.arity,
            is_symmetric: symmetric(predicate),
        });
        let guard = known.predicates[known.sees].name.clone();
        let default = known.default_action();
        let declared = |action: &Action| *action != default && known.action(*action).is_some();
        let mut ordered: Vec<Action> = Vec::new();
        for action in order.iter().copied().chain(Action::SAFEST_FIRST).filter(declared) {
            if !ordered.contains(&action) {
                ordered.push(action);
            }
        }
        ordered.push(default);
        Ok(InductionTask {
            vocabulary: Vocabulary::new(predicates.collect(), 1, Some(guard)),
            actions: ordered,
            world,
        })
    }

    /// Returns the world.
    pub fn world(&self) -> &Arc<World> {
        &self.world
    }

    /// Returns the predicates of clauses.
    pub fn vocabulary(&self) -> &Vocabulary {
        &self.vocabulary
    }

    /// Returns the integrity constraints of the rules, as far as they are about predicates of clauses and, if covering
    /// or reflexive, about every entity that `Sees` relates.
    pub fn constraints(&self) -> Constraints {
        let mut constraints = Constraints::default();
        let known = &self.world.vocabulary;
        let predicates: Vec<Option<PredicateId>> = observed(known).map(|(_, predicate)| predicate.id).collect();
        let position = |declared: PredicateId| predicates.iter().position(|known| *known == Some(declared));
        let has_all = |domain: &[(PredicateId, usize)]| {
            known.predicates[known.sees]
                .id
                .is_some_and(|sees| domain.contains(&(sees, 1)))
        };
        for declared in &self.world.program.rules().constraints {
            match &declared.constraint {
                Constraint::Disjoint(one, other) => {
                    let pair = [one, other].map(|declared| position(*declared));
                    if let [Some(one), Some(other)] = pair {
                        constraints.disjoint.push(vec![one, other]);
                    }
                }
                Constraint::Implies(premise, conclusion) => {
                    constraints
                        .implies
                        .extend(position(*premise).zip(position(*conclusion)));
                }
                Constraint::Covering(of) if has_all(&declared.domain) => {
                    constraints
                        .covering
                        .extend(of.iter().map(|one| position(*one)).collect::<Option<Vec<_>>>());
                }
                Constraint::Reflexive(of) if has_all(&declared.domain) => {
                    constraints.reflexive.extend(position(*of));
                }
                Constraint::Covering(_) | Constraint::Reflexive(_) => {}
                Constraint::Irreflexive(of) => constraints.irreflexive.extend(position(*of)),
                Constraint::Symmetric(of) => constraints.symmetric.extend(position(*of)),
                Constraint::Asymmetric(of) => constraints.asymmetric.extend(position(*of)),
            }
        }
        constraints
    }

    /// Returns the actions, the one with the highest precedence first and the default last.
    pub fn actions(&self) -> &[Action] {
        &self.actions
    }

    /// Returns a set without examples.
    pub fn examples(&self) -> Examples {
        let names = self.actions.iter().map(|action| action.name().to_owned());
        Examples::new(self.vocabulary.clone(), names.collect())
    }

    /// Returns the position of an action in [`InductionTask::actions`].
    ///
    /// # Errors
    /// `rule-mismatch` if the rules do not declare it.
    pub fn action(&self, action: Action) -> Result<usize, Diagnostic> {
        let position = self.actions.iter().position(|known| *known == action);
        position.ok_or_else(|| {
            let names: Vec<&str> = self.actions.iter().map(|action| action.name()).collect();
            let message = format!(
                "an example has the action `{}`, which the rules do not declare",
                action.name()
            );
            Diagnostic::new(datalog::codes::RULE_MISMATCH, message).note(format!("they declare {}", names.join(", ")))
        })
    }

    /// Returns a sentence that names the configuration and the settings of a search.
    pub fn describe(&self, settings: &Settings) -> String {
        let scenario = &self.world.scenario;
        let hash: String = scenario.hash.chars().take(12).collect();
        format!(
            "Configuration {} {hash}; at most {} variables, {} per search, seed {}.",
            scenario.name,
            settings.variables,
            text::plural(settings.nodes.into(), "step", "steps"),
            settings.seed
        )
    }

    /// Checks that no two examples have the same facts and different actions.
    ///
    /// # Errors
    /// `contradicting-examples`
    pub fn check(&self, examples: &Examples, origin: &Origin) -> Result<(), Diagnostic> {
        let mut contradictions = examples.contradictions();
        let Some(contradiction) = contradictions.next() else {
            return Ok(());
        };
        let more = contradictions.count();
        let [one, other] = contradiction.examples.map(|example| origin.describe(example));
        let [first, second] = contradiction.actions.map(|action| self.actions[action].name());
        let message = format!("two examples have the same facts but the actions {first} and {second}: {one}; {other}");
        let fault = Diagnostic::new(codes::CONTRADICTING_EXAMPLES, message);
        let fault = match more {
            0 => fault,
            1 => fault.note("1 other state has several actions, too"),
            more => fault.note(format!("{more} other states have several actions, too")),
        }
        .help("correct the labels, add predicates that distinguish the states, or allow wrong actions with `noise`");
        Err(match self.unused_predicates() {
            Some(unused) => fault.help(unused),
            None => fault,
        })
    }

    /// Returns a sentence about the derived predicates of the rules, which clauses cannot use, if there are any.
    fn unused_predicates(&self) -> Option<String> {
        let actions = Action::STANDARD.map(Action::name);
        let predicates = self.world.program.rules().predicates.iter();
        let derived = predicates.filter(|declared| declared.derived && !declared.input && !declared.hidden);
        let names: Vec<String> = derived
            .filter(|declared| !actions.contains(&declared.name.as_str()))
            .map(|declared| format!("`{}`", declared.name))
            .collect();
        (!names.is_empty()).then(|| {
            format!(
                "learned clauses use base predicates only, not derived ones such as {}: define those in the \
                 configuration, if a kind of base predicate can express them",
                listed(&names)
            )
        })
    }

    /// Returns a translator of facts whose predicates are in the order of `known`.
    ///
    /// # Errors
    /// `rule-mismatch` if `known` lacks a predicate of the task.
    pub fn translator(&self, known: &sim::Vocabulary) -> Result<Translator<'_>, Diagnostic> {
        let columns = self.vocabulary.predicates().iter().map(|predicate| {
            let named = |of: &sim::BasePredicate| of.name == predicate.name && of.arity == predicate.arity;
            known.predicates.iter().position(named).ok_or_else(|| {
                let message = format!("the examples have no facts of the predicate `{}`", predicate.name);
                Diagnostic::new(datalog::codes::RULE_MISMATCH, message)
                    .help("learn with the configuration that the examples come from")
            })
        });
        Ok(Translator {
            vocabulary: &self.vocabulary,
            columns: columns.collect::<Result<_, _>>()?,
            sees: known.sees,
        })
    }

    /// Drives an episode with the rules of the world, and adds what the ego observes and does in each step.
    ///
    /// # Errors
    /// As [`Env::reset_to`] and [`Env::step`].
    pub fn add_episode(&self, env: &mut Env, episode: &Episode, examples: &mut Examples) -> Result<(), Diagnostic> {
        let n = env.task().oracle().entities();
        let mut observation = vec![0.0; env.task().observation_width()];
        env.reset_to(episode)?;
        while env.controlled_cars()[0].is_running() {
            let observer = env.controlled_cars()[0].observer();
            observer.write(&mut observation);
            let action = env.oracle_action(0);
            let state = self.observed_state(&observation, n, Some(observer.entities().len()));
            examples.push(state, self.action(action)?);
            env.step(&[action])?;
        }
        Ok(())
    }

    /// Returns the atoms of an observation of `entities` entities, in the order of its numbers, such as `IsCar(0)`; for
    /// quantities, their names with the entities, such as `Waited(0)`.
    pub fn observed_atoms(&self, entities: usize) -> Vec<String> {
        let columns = sim::observed_columns(&self.world, entities);
        let atoms = columns.iter().flat_map(|column| {
            tuples(column.arity, entities).map(|entities| {
                let numbers: Vec<String> = entities.iter().map(usize::to_string).collect();
                format!("{}({})", column.name, numbers.join(","))
            })
        });
        atoms.collect()
    }

    /// Returns the number of entities in observations with these atoms.
    ///
    /// # Errors
    /// `rule-mismatch` if observations of the configuration have other atoms.
    pub fn observed_entities(&self, atoms: &[String]) -> Result<usize, Diagnostic> {
        let arguments = |atom: &str| Some(atom.split_once('(')?.1.strip_suffix(')')?.to_owned());
        let numbers = atoms.iter().filter_map(|atom| arguments(atom)).flat_map(|list| {
            let numbers = list.split(',').map(|number| number.parse::<usize>().ok());
            numbers.collect::<Vec<_>>()
        });
        let entities = numbers
            .flatten()
            .max()
            .map_or(1, |last| last.saturating_add(1))
            .min(OBSERVED_MAX);
        let expected = self.observed_atoms(entities);
        if atoms == expected {
            return Ok(entities);
        }
        let differs = expected.iter().zip(atoms).find(|(expected, found)| expected != found);
        let message = match differs {
            Some((expected, found)) => format!("the examples have the atom `{found}` instead of `{expected}`"),
            None => format!("the examples have {} atoms instead of {}", atoms.len(), expected.len()),
        };
        Err(Diagnostic::new(datalog::codes::RULE_MISMATCH, message)
            .help("learn with the configuration that the examples come from"))
    }

    /// Returns the state in an observation of `entities` entities, of which `present` exist; by default, those with a
    /// fact and those before them. The layout is that of [`Observer::write`](sim::Observer::write).
    ///
    /// # Panics
    /// If the observation is shorter than the layout.
    pub fn observed_state(&self, observation: &[f32], entities: usize, present: Option<usize>) -> State {
        let known = &self.world.vocabulary;
        let mut facts: Vec<(usize, [usize; 2])> = Vec::new();
        let (mut rest, mut learned) = (observation, 0);
        let observed = known.predicates.iter().enumerate();
        for (_, predicate) in observed.filter(|(at, predicate)| *at != known.sees && predicate.value.is_none()) {
            let (values, after) = rest.split_at(entities.pow(predicate.arity as u32));
            rest = after;
            if predicate.id.is_none() {
                continue;
            }
            for (at, _) in values.iter().enumerate().filter(|(_, value)| **value > 0.5) {
                facts.push((learned, [at / entities, at % entities]));
            }
            learned += 1;
        }
        let last = facts.iter().flat_map(|(_, row)| row).max().copied().unwrap_or(0);
        let mut state = State::new(&self.vocabulary, present.unwrap_or(last + 1));
        for (predicate, row) in facts {
            let skipped = 2 - self.vocabulary.predicates()[predicate].arity;
            state.insert(&self.vocabulary, predicate, &row[skipped..]);
        }
        state
    }
}

/// Returns the predicates that clauses may use, with their positions: those that the rules declare, except `Sees`.
fn observed(known: &sim::Vocabulary) -> impl Iterator<Item = (usize, &sim::BasePredicate)> {
    let declared = |(position, predicate): &(usize, &sim::BasePredicate)| {
        *position != known.sees && predicate.id.is_some() && predicate.value.is_none()
    };
    known.predicates.iter().enumerate().filter(declared)
}

/// Translates facts of a city into states.
#[derive(Clone, Debug)]
pub struct Translator<'a> {
    vocabulary: &'a Vocabulary,
    /// For each predicate of the vocabulary, its position in the facts.
    columns: Vec<usize>,
    sees: usize,
}

impl Translator<'_> {
    /// Returns what an entity observes: the facts about itself and the entities that it sees.
    ///
    /// # Errors
    /// `limit-exceeded` if these are more than [`ENTITIES_MAX`].
    pub fn state(&self, facts: &Facts, ego: usize) -> Result<State, Diagnostic> {
        let seen = rows_of(&facts.rows[self.sees], ego);
        let mut entities = vec![ego];
        entities.extend(seen.iter().map(|row| row[1] as usize).filter(|entity| *entity != ego));
        if entities.len() > ENTITIES_MAX {
            let message = format!("an ego sees {} entities; the limit is {ENTITIES_MAX}", entities.len());
            return Err(Diagnostic::new(diag::codes::LIMIT_EXCEEDED, message));
        }
        let mut state = State::new(self.vocabulary, entities.len());
        for (index, (predicate, &column)) in self.vocabulary.predicates().iter().zip(&self.columns).enumerate() {
            let rows = &facts.rows[column];
            for (first, &entity) in entities.iter().enumerate() {
                for row in rows_of(rows, entity) {
                    if predicate.arity == 1 {
                        state.insert(self.vocabulary, index, &[first]);
                    } else if let Some(second) = entities.iter().position(|entity| *entity == row[1] as usize) {
                        state.insert(self.vocabulary, index, &[first, second]);
                    }
                }
            }
        }
        Ok(state)
    }
}

/// Returns the rows that begin with an entity. The rows are sorted.
fn rows_of(rows: &[[u32; 2]], entity: usize) -> &[[u32; 2]] {
    let begin = rows.partition_point(|row| (row[0] as usize) < entity);
    let count = rows[begin..].partition_point(|row| row[0] as usize == entity);
    &rows[begin..begin + count]
}
