//! Evaluates the rules for one ego: the actions that they derive, and the clauses that an action violates.
//!
//! One evaluation gives both if bodies use the action predicates only for the agent of the head: the other literals do
//! not depend on the ego's action ([`Conditions`]). Other rules are evaluated unchanged for the derived actions, and
//! once more for each judged action with the action predicates of all bodies replaced by inputs.
// Decision: docs/decisions/executors.md#d042

use crate::city::{Action, AgentKind};
use crate::datalog;
use crate::datalog::Program;
use crate::datalog::dense::{Argument, BinaryFacts, BitState, Input, List, Set, TrackFirings, first, has, members};
use crate::datalog::{ClauseId, Limits, Literal, PredicateId, Rules};
use crate::diag::Diagnostic;
use crate::sim::observe::observed::{GivenActions, OBSERVED_MAX, Observed};
use crate::sim::tick::chance::Drawing;
use crate::sim::tick::executor::{DenseRules, compile};
use crate::sim::tick::ground_state::{GroundPredicate, GroundState};
use crate::sim::tick::vocabulary::{Actions, Vocabulary};

/// A clause that demands an action of an agent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ActionConstraint {
    /// The clause.
    pub clause: ClauseId,
    /// The action of its head.
    pub action: Action,
}

/// The rules, prepared to judge the actions of one agent. Immutable; a [`Violations`] holds the state.
#[derive(Debug)]
pub(super) struct RuleMonitor {
    constraints: Vec<ActionConstraint>,
    how: How,
}

#[derive(Debug)]
enum How {
    Once(Conditions),
    Twice {
        /// Evaluates the unchanged rules.
        wanted: Evaluator,
        /// Evaluates the rules with the ego's action as input.
        checked: Evaluator,
    },
}

/// The action clauses, split into literals on the ego's actions and the others.
#[derive(Debug)]
struct Conditions {
    /// The rules without action literals in bodies.
    rules: Box<BoundRules>,
    /// The clauses in stratum order: earlier clauses derive the actions that a clause reads.
    clauses: Vec<Condition>,
}

#[derive(Debug)]
struct Condition {
    clause: ClauseId,
    action: Action,
    /// The actions that must hold for the ego.
    given: Actions,
    /// The actions that must not hold for the ego.
    refused: Actions,
    /// The actions of which it demands another one, for an ego that has only this action.
    wrong: Actions,
    /// Its position in the constraints; `None` for the default.
    constraint: Option<usize>,
}

impl Condition {
    /// Returns whether the action literals hold if the ego has these actions.
    fn allows(&self, actions: Actions) -> bool {
        let (given, refused) = (self.given.bits(), self.refused.bits());
        actions.bits() & (given | refused) == given
    }

    /// Returns the condition with the actions of which it demands another one.
    fn with_wrong(self) -> Condition {
        let all = (0..Action::MAX).map(Action::at);
        let wrong = all.filter(|action| self.action != *action && self.allows([*action].into_iter().collect()));
        Condition {
            wrong: wrong.collect(),
            ..self
        }
    }
}

/// Rules with their executor.
#[derive(Debug)]
enum Evaluator {
    Dense(Box<BoundRules>),
    Relational {
        program: Program,
        /// First the predicates of the vocabulary, then the imposed actions.
        predicates: Vec<Option<GroundPredicate>>,
        limits: Limits,
    },
}

#[derive(Debug)]
struct BoundRules {
    compiled: DenseRules,
    /// Each input of the program, and whether it is the diagonal.
    inputs: Vec<(Given, bool)>,
    lists: Vec<(Given, Argument)>,
}

/// Where the facts of an input come from.
#[derive(Clone, Copy, Debug)]
enum Given {
    /// It has none.
    Nowhere,
    /// A predicate of the vocabulary or, after those, an imposed action.
    Predicate(usize),
    /// A condition on quantities.
    Condition(usize),
    /// What a temporal operator reads of earlier ticks.
    Past(usize),
}

/// Returns the rules with the action predicates of all bodies replaced by input predicates, and these predicates. They
/// come last.
fn with_actions_given(rules: &Rules, vocabulary: &Vocabulary) -> (Rules, Vec<Option<PredicateId>>) {
    let mut rules = rules.clone();
    let table = vocabulary.actions();
    let give = |action: Action| {
        let derived = vocabulary.action(action)?;
        let place = PredicateId(u32::try_from(rules.predicates.len()).expect("fewer than 2^32 predicates"));
        let predicate = datalog::Predicate {
            name: format!("+given {}", table.name(action)),
            doc: format!("the imposed action `{}`", table.name(action)),
            input: true,
            edb: None,
            output: false,
            printsize: false,
            derived: false,
            hidden: true,
            directives: Vec::new(),
            ..rules.predicates[derived.index()].clone()
        };
        rules.predicates.push(predicate);
        Some((derived, place))
    };
    let given: Vec<Option<(PredicateId, PredicateId)>> = table.all().map(give).collect();
    for literal in rules.clauses.iter_mut().flat_map(|clause| &mut clause.body) {
        let (Literal::Positive(atom)
        | Literal::Negative(atom)
        | Literal::Guard(atom)
        | Literal::Aggregate { atom, .. }) = literal
        else {
            continue;
        };
        if let Some((_, place)) = given.iter().flatten().find(|(action, _)| *action == atom.predicate) {
            atom.predicate = *place;
        }
    }
    let places = given.into_iter().map(|given| given.map(|(_, place)| place));
    (rules, places.collect())
}

/// Returns rules that derive an action for the ego if and only if a clause demands it under an imposed action. Also
/// returns the predicate of each imposed action. These predicates replace the action predicates in all bodies; clauses
/// of the default derive nothing.
pub(super) fn safety_rules(rules: &Rules, vocabulary: &Vocabulary) -> (Rules, Vec<Option<PredicateId>>) {
    let demanding = constraints(rules, vocabulary);
    let (mut rules, given) = with_actions_given(rules, vocabulary);
    let Some(like) = given.iter().flatten().next() else {
        return (rules, given);
    };
    // An input without facts, so that a clause that reads it derives nothing.
    let never = PredicateId(u32::try_from(rules.predicates.len()).expect("fewer than 2^32 predicates"));
    let predicate = datalog::Predicate {
        name: "+never".to_owned(),
        ..rules.predicates[like.index()].clone()
    };
    rules.predicates.push(predicate);
    for (position, clause) in (0..).zip(&mut rules.clauses) {
        let is_demand = demanding.iter().any(|demand| demand.clause == ClauseId(position));
        if vocabulary.action_of(clause.head.predicate).is_some() && !is_demand {
            let atom = datalog::Atom {
                predicate: never,
                ..clause.head.clone()
            };
            clause.body.push(Literal::Positive(atom));
        }
    }
    (rules, given)
}

/// Returns the clauses that demand an action. It excludes the default: a clause of the default action that reads only
/// the other actions and the ego itself.
fn constraints(rules: &Rules, vocabulary: &Vocabulary) -> Vec<ActionConstraint> {
    let constraint = |(position, clause): (u32, &datalog::Clause)| {
        let action = vocabulary.action_of(clause.head.predicate)?;
        // An ego is a car, so it cannot violate clauses of other actions.
        if !vocabulary.actions().can_take(AgentKind::Car, action) {
            return None;
        }
        (!clause.body.is_empty() && !vocabulary.is_default_clause(clause)).then_some(ActionConstraint {
            clause: ClauseId(position),
            action,
        })
    };
    (0..).zip(&rules.clauses).filter_map(constraint).collect()
}

impl Conditions {
    /// Splits the rules. `None` if a body uses an action otherwise than for the agent of the head, or the dense
    /// executor cannot evaluate the rules.
    fn new(rules: &Rules, vocabulary: &Vocabulary, constraints: &[ActionConstraint]) -> Option<Conditions> {
        // Rules that are dense without the actions in their bodies may not be dense with them.
        compile(rules, vocabulary, TrackFirings::Off).ok()?;
        let mut others = rules.clone();
        let mut clauses = Vec::new();
        for id in rules.strata.iter().flat_map(|stratum| &stratum.clauses) {
            let body = &mut others.clauses[id.index()].body;
            let clause = &rules.clauses[id.index()];
            body.retain(|literal| {
                literal
                    .atom()
                    .is_none_or(|atom| vocabulary.action_of(atom.predicate).is_none())
            });
            let mut asked = [Actions::default(); 2];
            for literal in &clause.body {
                let Some((atom, action)) = literal
                    .atom()
                    .and_then(|atom| Some((atom, vocabulary.action_of(atom.predicate)?)))
                else {
                    continue;
                };
                let holds = match literal {
                    Literal::Positive(_) => 0,
                    Literal::Negative(_) => 1,
                    _ => return None,
                };
                if atom.terms != clause.head.terms {
                    return None;
                }
                asked[holds].insert(action);
            }
            let [given, refused] = asked;
            match vocabulary.action_of(clause.head.predicate) {
                // The rest of the body must bind the head variable, so it must not be empty.
                Some(_) if body.is_empty() => return None,
                Some(action) => {
                    let condition = Condition {
                        clause: *id,
                        action,
                        given,
                        refused,
                        wrong: Actions::default(),
                        constraint: constraints.iter().position(|constraint| constraint.clause == *id),
                    };
                    clauses.push(condition.with_wrong());
                }
                None if given.is_empty() && refused.is_empty() => {}
                None => return None,
            }
        }
        let rules = BoundRules::new(&others, vocabulary, &[], TrackFirings::Each)?;
        Some(Conditions {
            rules: Box::new(rules),
            clauses,
        })
    }

    /// Finds the conditions that hold, unless they are known, and returns the derived actions.
    fn evaluate(
        &self,
        bit_state: &mut Option<Box<BitState<1>>>,
        held: &mut Vec<usize>,
        known: &mut Option<Actions>,
        observed: Observed<'_>,
    ) -> Actions {
        if let Some(derived) = *known {
            return derived;
        }
        let bit_state = bit_state.get_or_insert_with(|| Box::new(BitState::new(&self.rules.compiled.dense, 0)));
        self.rules.run(bit_state, observed);
        let holds = |clause| {
            bit_state
                .fired(&self.rules.compiled.dense, clause)
                .is_some_and(|set| has(set, 0))
        };
        let clauses = self.clauses.iter().enumerate();
        held.clear();
        held.extend(
            clauses
                .filter(|(_, condition)| holds(condition.clause))
                .map(|(position, _)| position),
        );
        *known.insert(self.derived(held))
    }

    /// Returns the derived actions, given the positions of the conditions that hold, in ascending order.
    fn derived(&self, held: &[usize]) -> Actions {
        held.iter().fold(Actions::default(), |mut derived, &position| {
            let condition = &self.clauses[position];
            if condition.allows(derived) {
                derived.insert(condition.action);
            }
            derived
        })
    }

    /// Collects the constraints that an action violates, in ascending order.
    fn violations(&self, held: &[usize], action: Action, broken: &mut Vec<usize>) {
        broken.extend(self.refusing(held, action));
        broken.sort_unstable();
    }

    /// Returns the clauses that an action violates, in any order.
    fn refusing(&self, held: &[usize], action: Action) -> impl Iterator<Item = usize> {
        let conditions = held.iter().map(|&position| &self.clauses[position]);
        let refusing = conditions.filter(move |condition| condition.wrong.contains(action));
        refusing.filter_map(|condition| condition.constraint)
    }

    /// Returns the actions that violate a constraint.
    fn wrong(&self, held: &[usize]) -> Actions {
        let conditions = held.iter().map(|&position| &self.clauses[position]);
        let constraints = conditions.filter(|condition| condition.constraint.is_some());
        constraints.fold(Actions::default(), |wrong, condition| wrong | condition.wrong)
    }
}

impl BoundRules {
    /// Compiles the rules. `None` if the dense executor cannot evaluate them in a bounded number of steps.
    fn new(
        rules: &Rules,
        vocabulary: &Vocabulary,
        given: &[Option<PredicateId>],
        counting: TrackFirings,
    ) -> Option<BoundRules> {
        let compiled = compile(rules, vocabulary, counting).ok()?;
        let dense = &compiled.dense;
        let egos = if dense.is_local() { 1 } else { OBSERVED_MAX };
        if !compiled.costly(OBSERVED_MAX, egos).is_empty() {
            return None;
        }
        let bound = vocabulary.predicates.iter().map(|predicate| predicate.id);
        let bound: Vec<Option<PredicateId>> = bound.chain(given.iter().copied()).collect();
        let place = |predicate: PredicateId| {
            let known = bound.iter().position(|bound| *bound == Some(predicate));
            let condition = || compiled.conditions.find(predicate).map(Given::Condition);
            let past = || compiled.past(predicate).map(Given::Past);
            known
                .map(Given::Predicate)
                .or_else(condition)
                .or_else(past)
                .unwrap_or(Given::Nowhere)
        };
        let input = |input: &Input| match *input {
            Input::Unary(predicate) => (place(predicate), false),
            Input::Diagonal(predicate) => (place(predicate), true),
        };
        Some(BoundRules {
            inputs: dense.inputs().iter().map(input).collect(),
            lists: (dense.lists().iter())
                .map(|&List(predicate, axis)| (place(predicate), axis))
                .collect(),
            compiled,
        })
    }

    /// Evaluates the rules for the first entity.
    fn run(&self, bit_state: &mut BitState<1>, observed: Observed<'_>) {
        let (atoms, count, dense) = (observed.atoms, observed.entities.count(), &self.compiled.dense);
        if bit_state.count() != count {
            bit_state.reset(dense, count);
            if dense.is_local() {
                bit_state.set_egos(first(1));
            }
        }
        let related = Related { observed, rules: self };
        for (input, &(given, diagonal)) in self.inputs.iter().enumerate() {
            let set = match given {
                Given::Nowhere => 0,
                Given::Predicate(predicate) if !diagonal => observed.unary(predicate),
                Given::Predicate(predicate) => (0..count).fold(0, |set, at| set | atoms.row(predicate, at) & 1 << at),
                Given::Condition(condition) => {
                    (0..count).fold(0, |set, at| set | u64::from(related.meets(condition, [at, at])) << at)
                }
                Given::Past(past) if !diagonal => (0..count).fold(0, |set, at| {
                    set | u64::from(
                        observed
                            .memory
                            .is_some_and(|memory| memory.holds_alone(past, observed.entities.position(at))),
                    ) << at
                }),
                Given::Past(_) => (0..count).fold(0, |set, at| set | u64::from(related.relates(given, at, at)) << at),
            };
            bit_state.set_input(dense, input, [set]);
        }
        let run = bit_state.run(dense, &related);
        run.expect("no clause is costly");
    }
}

impl Evaluator {
    fn new(
        program: Program,
        vocabulary: &Vocabulary,
        limits: Limits,
        given: &[Option<PredicateId>],
        counting: TrackFirings,
    ) -> Evaluator {
        if let Some(rules) = BoundRules::new(program.rules(), vocabulary, given, counting) {
            return Evaluator::Dense(Box::new(rules));
        }
        let given = given.iter().map(|id| {
            Some(GroundPredicate {
                id: (*id)?,
                arity: 1,
                value: None,
            })
        });
        Evaluator::Relational {
            program,
            predicates: GroundPredicate::of(vocabulary).chain(given).collect(),
            limits,
        }
    }
}

impl RuleMonitor {
    /// Prepares the rules of a program. `limits` applies to each evaluation by the relational executor.
    ///
    /// # Errors
    /// If the rules cannot be planned.
    pub fn new(program: &Program, vocabulary: &Vocabulary, limits: Limits) -> Result<RuleMonitor, Diagnostic> {
        let rules = program.rules();
        let constraints = constraints(rules, vocabulary);
        let how = match Conditions::new(rules, vocabulary, &constraints) {
            Some(conditions) => How::Once(conditions),
            None => {
                let (checked, given) = with_actions_given(rules, vocabulary);
                How::Twice {
                    wanted: Evaluator::new(program.clone(), vocabulary, limits, &[], TrackFirings::Off),
                    checked: Evaluator::new(Program::new(checked)?, vocabulary, limits, &given, TrackFirings::Each),
                }
            }
        };
        Ok(RuleMonitor { constraints, how })
    }

    /// Returns the clauses that demand an action, in source order, without the default.
    pub fn constraints(&self) -> &[ActionConstraint] {
        &self.constraints
    }
}

/// The rules, prepared to judge the actions of several agents together: those in all bodies are inputs.
#[derive(Debug)]
pub(super) struct JointMonitor {
    checked: Evaluator,
    /// Whether a clause reads the actions of other agents than that of its head.
    pub reads_others: bool,
}

impl JointMonitor {
    /// Variant of [`RuleMonitor::new`].
    ///
    /// # Errors
    /// If the rules cannot be planned.
    pub fn new(program: &Program, vocabulary: &Vocabulary, limits: Limits) -> Result<JointMonitor, Diagnostic> {
        let rules = program.rules();
        let reads = |clause: &datalog::Clause| {
            let is_of_head = |atom: &datalog::Atom| {
                vocabulary.action_of(clause.head.predicate).is_some() && atom.terms == clause.head.terms
            };
            let actions = clause.body.iter().filter_map(|literal| literal.atom());
            let mut actions = actions.filter(|atom| vocabulary.action_of(atom.predicate).is_some());
            actions.any(|atom| !is_of_head(atom))
        };
        let reads_others = rules.clauses.iter().any(reads);
        let (checked, given) = with_actions_given(rules, vocabulary);
        let checked = Evaluator::new(Program::new(checked)?, vocabulary, limits, &given, TrackFirings::Each);
        Ok(JointMonitor { checked, reads_others })
    }
}

/// The state of a [`JointMonitor`] for one observation.
pub(super) struct JointState(State);

impl JointState {
    pub fn new(monitor: &JointMonitor) -> JointState {
        JointState(State::new(&monitor.checked))
    }

    /// Collects the constraints that demand another action of the ego than `action`, in ascending order. The imposed
    /// actions of `observed` contain it.
    ///
    /// # Errors
    /// `limit-exceeded` if the rules derive too many rows.
    pub fn violations(
        &mut self,
        (monitor, constraints): (&JointMonitor, &[ActionConstraint]),
        observed: Observed<'_>,
        action: Action,
        broken: &mut Vec<usize>,
    ) -> Result<(), Diagnostic> {
        let ego = observed.entities.position(0) as usize;
        broken.clear();
        self.0.run(&monitor.checked, observed)?;
        broken.extend(self.0.demands(&monitor.checked, constraints, (ego, action)));
        Ok(())
    }
}

/// Provides binary facts to a dense program.
struct Related<'a> {
    observed: Observed<'a>,
    rules: &'a BoundRules,
}

impl Related<'_> {
    /// Returns whether entities meet a condition on quantities.
    fn meets(&self, condition: usize, of: [usize; 2]) -> bool {
        let value = |predicate, _, places: &[usize]| {
            let mut entities = [0; 2];
            for (entity, place) in entities.iter_mut().zip(places) {
                *entity = of[*place];
            }
            self.observed.atoms.value(predicate, &entities[..places.len()])
        };
        let Drawing { word, names } = self.observed.drawing;
        let hashes = of.map(|entity| {
            let name = names.get(self.observed.entities.position(entity) as usize);
            name.copied().unwrap_or_default()
        });
        (self.rules.compiled.conditions).holds(condition, value, word, hashes)
    }

    /// Returns whether an input relates two entities.
    fn relates(&self, given: Given, first: usize, second: usize) -> bool {
        match given {
            Given::Nowhere => false,
            Given::Predicate(predicate) => self.observed.atoms.row(predicate, first) >> second & 1 != 0,
            Given::Condition(condition) => self.meets(condition, [first, second]),
            Given::Past(past) => {
                let [x, y] = [first, second].map(|entity| self.observed.entities.position(entity));
                self.observed.memory.is_some_and(|memory| memory.holds(past, x, y))
            }
        }
    }
}

impl BinaryFacts<1> for Related<'_> {
    #[inline]
    fn narrow(&self, list: usize, at: usize, among: Set<1>) -> Set<1> {
        let related = |first: usize, second: usize, given| self.relates(given, first, second);
        let keep = |related: &dyn Fn(usize) -> bool| {
            let related = members(&among).filter(|other| related(*other));
            [related.fold(0, |set, other| set | 1 << other)]
        };
        match self.rules.lists[list] {
            (Given::Predicate(predicate), Argument::Second) => [among[0] & self.observed.atoms.row(predicate, at)],
            (given, Argument::Second) => keep(&|other| related(at, other, given)),
            (given, Argument::First) => keep(&|other| related(other, at, given)),
        }
    }
}

/// The state of a [`RuleMonitor`] for one observation.
pub(super) enum Violations {
    Once {
        /// The working memory, made on demand. It has no state between evaluations.
        bit_state: Option<Box<BitState<1>>>,
        /// The conditions that hold, by position.
        held: Vec<usize>,
        /// The actions that they derive; `None` unless both are up to date.
        known: Option<Actions>,
    },
    Twice {
        wanted: State,
        checked: State,
    },
}

pub(super) enum State {
    Dense(Box<BitState<1>>),
    Relational(Option<Box<GroundState>>),
}

impl State {
    fn new(evaluator: &Evaluator) -> State {
        match evaluator {
            Evaluator::Dense(rules) => State::Dense(Box::new(BitState::new(&rules.compiled.dense, 0))),
            Evaluator::Relational { .. } => State::Relational(None),
        }
    }

    /// Evaluates the rules on the facts.
    fn run(&mut self, evaluator: &Evaluator, observed: Observed<'_>) -> Result<(), Diagnostic> {
        match (self, evaluator) {
            (State::Dense(bit_state), Evaluator::Dense(rules)) => {
                rules.run(bit_state, observed);
                Ok(())
            }
            (
                State::Relational(state),
                Evaluator::Relational {
                    program,
                    predicates,
                    limits,
                },
            ) => {
                let state = state.get_or_insert_with(|| {
                    let names = observed.entities.names();
                    let names = names.iter().map(String::as_str);
                    Box::new(GroundState::over(program, predicates.clone(), *limits, names))
                });
                let facts = observed.facts(predicates.len());
                let set = state.set_with(&facts, observed.cancel);
                set.map_err(|error| error.diagnostic(program.rules()))
            }
            _ => unreachable!("a state is made for its evaluator"),
        }
    }

    /// Returns the derived actions of the ego.
    fn derived(&self, evaluator: &Evaluator, vocabulary: &Vocabulary, ego: usize) -> Actions {
        match (self, evaluator) {
            (State::Dense(bit_state), Evaluator::Dense(rules)) => {
                let holds = |action: &Action| {
                    let predicate = vocabulary.action(*action);
                    predicate.is_some_and(|action| {
                        bit_state
                            .set(&rules.compiled.dense, action)
                            .is_some_and(|set| has(set, 0))
                    })
                };
                vocabulary.actions().all().filter(holds).collect()
            }
            (State::Relational(Some(state)), _) => state.derived(vocabulary, ego),
            _ => unreachable!("it has been evaluated"),
        }
    }

    /// Returns the positions of the constraints that demand another action of the ego.
    fn demands<'a>(
        &'a self,
        evaluator: &'a Evaluator,
        constraints: &'a [ActionConstraint],
        (ego, action): (usize, Action),
    ) -> impl Iterator<Item = usize> + 'a {
        let constraints = constraints.iter().enumerate();
        let demands = move |constraint: &ActionConstraint| {
            constraint.action != action && self.fired(evaluator, constraint.clause, ego)
        };
        constraints
            .filter(move |(_, constraint)| demands(constraint))
            .map(|(position, _)| position)
    }

    /// Returns whether a clause derives its head for the ego.
    fn fired(&self, evaluator: &Evaluator, clause: ClauseId, ego: usize) -> bool {
        match (self, evaluator) {
            (State::Dense(bit_state), Evaluator::Dense(rules)) => bit_state
                .fired(&rules.compiled.dense, clause)
                .is_some_and(|set| has(set, 0)),
            (State::Relational(Some(state)), _) => {
                let value = state.value(ego);
                state.session().fired(clause).iter().any(|row| row[0] == value)
            }
            _ => unreachable!("it has been evaluated"),
        }
    }
}

impl Violations {
    pub fn new(monitor: &RuleMonitor) -> Violations {
        match &monitor.how {
            How::Once(conditions) => Violations::Once {
                bit_state: None,
                held: Vec::with_capacity(conditions.clauses.len()),
                known: None,
            },
            How::Twice { wanted, checked } => Violations::Twice {
                wanted: State::new(wanted),
                checked: State::new(checked),
            },
        }
    }

    /// Exchanges the working memory with the violations of the same monitor.
    pub fn swap_memory(&mut self, other: &mut Violations) {
        if let (Violations::Once { bit_state, .. }, Violations::Once { bit_state: others, .. }) = (self, other) {
            std::mem::swap(bit_state, others);
        }
    }

    /// Invalidates the results after a change of the facts.
    pub fn forget(&mut self) {
        if let Violations::Once { known, .. } = self {
            *known = None;
        }
    }

    /// Returns what [`derived`](Violations::derived) returned since the last change of the facts, if that is known.
    pub fn known(&self) -> Option<Actions> {
        match self {
            Violations::Once { known, .. } => *known,
            Violations::Twice { .. } => None,
        }
    }

    /// Returns the actions that the rules derive for the ego, the first of the observed entities.
    ///
    /// # Errors
    /// `limit-exceeded` if the rules derive too many rows.
    pub fn derived(
        &mut self,
        monitor: &RuleMonitor,
        vocabulary: &Vocabulary,
        observed: Observed<'_>,
    ) -> Result<Actions, Diagnostic> {
        let ego = observed.entities.position(0) as usize;
        match (self, &monitor.how) {
            (Violations::Once { bit_state, held, known }, How::Once(conditions)) => {
                Ok(conditions.evaluate(bit_state, held, known, observed))
            }
            (Violations::Twice { wanted: state, .. }, How::Twice { wanted, .. }) => {
                state.run(wanted, observed)?;
                Ok(state.derived(wanted, vocabulary, ego))
            }
            _ => unreachable!("violations are computed by their own monitor"),
        }
    }

    /// Collects the constraints that an action of the ego violates, in ascending order.
    ///
    /// # Errors
    /// `limit-exceeded` if the rules derive too many rows.
    pub fn violations(
        &mut self,
        monitor: &RuleMonitor,
        observed: Observed<'_>,
        action: Action,
        broken: &mut Vec<usize>,
    ) -> Result<(), Diagnostic> {
        let ego = observed.entities.position(0) as usize;
        broken.clear();
        match (self, &monitor.how) {
            (Violations::Once { bit_state, held, known }, How::Once(conditions)) => {
                conditions.evaluate(bit_state, held, known, observed);
                conditions.violations(held, action, broken);
            }
            (Violations::Twice { checked: state, .. }, How::Twice { checked, .. }) => {
                let mut given = GivenActions::default();
                given.give(0, action);
                let given = Some(&given);
                state.run(checked, Observed { given, ..observed })?;
                broken.extend(state.demands(checked, &monitor.constraints, (ego, action)));
            }
            _ => unreachable!("violations are computed by their own monitor"),
        }
        Ok(())
    }

    /// Returns those of some actions that violate no clause; `broken` is working memory.
    ///
    /// # Errors
    /// As [`Violations::violations`].
    pub fn safe_actions(
        &mut self,
        monitor: &RuleMonitor,
        observed: Observed<'_>,
        actions: Actions,
        broken: &mut Vec<usize>,
    ) -> Result<Actions, Diagnostic> {
        if let (Violations::Once { bit_state, held, known }, How::Once(conditions)) = (&mut *self, &monitor.how) {
            conditions.evaluate(bit_state, held, known, observed);
            return Ok(actions - conditions.wrong(held));
        }
        let mut safe = Actions::default();
        for action in actions.iter() {
            self.violations(monitor, observed, action, broken)?;
            if broken.is_empty() {
                safe.insert(action);
            }
        }
        Ok(safe)
    }
}
