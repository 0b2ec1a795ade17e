//! Shields: rules that judge the actions of an ego by what it observes (Alshiekh et al.: Safe reinforcement learning
//! via shielding, 2018; Yang et al.: Safe reinforcement learning via probabilistic logic shields, 2023).
//!
//! An action is *appropriate* if the rules choose it. It is *safe* if it violates no clause. A joint action of several
//! egos is safe if, given the actions of all egos, no clause demands a different action of any of them. A deterministic
//! shield judges the observed facts. A probabilistic one computes the probability that an action is appropriate or
//! safe. It assumes that facts are independent, and compiles its circuits once for each number of entities.

use crate::cancel::Cancel;
use crate::city::{Action, AgentKind};
use crate::config::{SensorOutput, ShieldConfig, ShieldMode, ShieldQuery, SpfConfig};
use crate::datalog::codes;
use crate::datalog::{
    CircuitCompiler, CircuitOptions, Inexact, PredicateId, ProbabilityCircuit, Program, RandomVariable, Rules, Term,
    Value,
};
use crate::diag::{self, Diagnostic};
use crate::sim::observe::joint::Proposal;
use crate::sim::observe::observed::{Atoms, GivenActions, Observed};
use crate::sim::observe::observer::{Observer, Oracle};
use crate::sim::observe::rule_monitor::{JointMonitor, JointState, Violations, safety_rules};
use crate::sim::tick::simulation::Simulation;
use crate::sim::tick::vocabulary::Actions;
use crate::sim::tick::world::World;
use crate::yaml;
use std::collections::HashMap;
use std::sync::{Arc, OnceLock};

/// Rules that judge actions. Immutable and shared.
pub struct Shield {
    oracle: Arc<Oracle>,
    config: ShieldConfig,
    /// The actions that the ego can take, those of high priority first.
    possible: Vec<Action>,
    /// The same as a set.
    possible_set: Actions,
    /// By number of entities less one; empty for deterministic shields.
    circuits: Vec<OnceLock<Vec<ShieldCircuit>>>,
    /// The rules for several egos together; `None` in other modes.
    joint: Option<JointMonitor>,
}

/// What a shield says of the actions in a state.
#[derive(Clone, Debug, PartialEq)]
pub struct Verdict {
    /// The actions that it permits, at least one.
    pub permitted: Actions,
    /// The permitted action that replaces others.
    pub preferred: Action,
    probabilities: Probabilities,
}

/// The probability that each action is appropriate or safe.
#[derive(Clone, Debug, PartialEq)]
enum Probabilities {
    /// 1 for these actions, 0 for others.
    Certain(Actions),
    /// By action.
    Each(Box<[f64; Action::MAX]>),
}

impl Verdict {
    /// Returns the probability that an action is appropriate or safe; 0 or 1 in deterministic shields.
    pub fn probability(&self, action: Action) -> f64 {
        match &self.probabilities {
            Probabilities::Certain(actions) => f64::from(u8::from(actions.contains(action))),
            Probabilities::Each(probabilities) => probabilities[action.index()],
        }
    }
}

/// The probability of actions as a function of those of facts.
struct ShieldCircuit {
    circuit: ProbabilityCircuit,
    /// The positions in the observation of the facts that are its variables.
    places: Vec<usize>,
    /// The action of each output that counts.
    outputs: Vec<(usize, Action)>,
}

impl Shield {
    /// Returns a shield by the rules of an oracle, which need not be those of the city.
    ///
    /// # Errors
    /// `rule-mismatch` if the rules draw or read earlier ticks, or if a probabilistic shield has rules that read
    /// quantities or name agents; `limit-exceeded` if they aggregate over facts.
    pub fn new(oracle: Arc<Oracle>, config: ShieldConfig) -> Result<Shield, Diagnostic> {
        let world = oracle.world();
        let vocabulary = &world.vocabulary;
        world.without_draws("shields")?;
        world.without_time("shields")?;
        let probabilistic = config.mode == ShieldMode::Probabilistic;
        if probabilistic {
            vocabulary.without_quantities("probabilistic shields")?;
            without_names(world)?;
        }
        let table = vocabulary.actions();
        let (priority, _) = world.scenario.actions.order(AgentKind::Car);
        let can_take = |action: &Action| table.can_take(AgentKind::Car, *action);
        let others = table.all().filter(|action| !priority.contains(action));
        let possible: Vec<Action> = priority.iter().copied().chain(others).filter(can_take).collect();
        let counts = if probabilistic { oracle.entities() } else { 0 };
        let joint = match config.mode {
            ShieldMode::Joint => Some(JointMonitor::new(&world.program, vocabulary, world.limits)?),
            _ => None,
        };
        let shield = Shield {
            joint,
            circuits: std::iter::repeat_with(OnceLock::new).take(counts).collect(),
            possible_set: possible.iter().copied().collect(),
            possible,
            oracle,
            config,
        };
        if probabilistic {
            // Reports rules whose probabilities do not exist.
            shield.circuits(1, &Cancel::never())?;
        }
        Ok(shield)
    }

    /// Returns the safe joint action of egos that changes the fewest proposed actions. Among several, the first ego
    /// decides first: it keeps its action if it can, and otherwise takes the one that the rules choose, or the one of
    /// highest priority; then the second ego decides, and so on. Egos for which there is no safe joint action take what
    /// the rules choose. Each ego has its state, its observer and the proposed action. Afterwards,
    /// [`ShieldState::reasons`] of an ego whose action changed has the clauses that its proposed action violates; that
    /// of other egos is unspecified.
    ///
    /// # Errors
    /// `limit-exceeded` if the rules derive too many rows, or the search tries too many joint actions.
    ///
    /// # Panics
    /// If the mode is another one than `joint`.
    pub fn nearest_safe(
        &self,
        egos: &mut [(&mut ShieldState, &Observer, Action)],
        city: &Simulation,
    ) -> Result<Vec<Action>, Diagnostic> {
        let monitor = self.joint.as_ref().expect("the mode is `joint`");
        let vocabulary = &self.oracle.world().vocabulary;
        let agents: Vec<usize> = egos.iter().map(|(_, observer, _)| observer.ego()).collect();
        let mut fallback = Vec::with_capacity(egos.len());
        // For each ego, the observed egos: the entity and the ego.
        let mut scopes: Vec<Vec<(usize, usize)>> = Vec::with_capacity(egos.len());
        for (state, observer, _) in &mut *egos {
            let derived = state.derive(self, observer, city)?;
            fallback.push(vocabulary.decide(Some(AgentKind::Car.into()), derived));
            let others = observer.entities().enumerate().skip(1).filter(|_| monitor.reads_others);
            let ego_of = |agent: usize| agents.iter().position(|ego| *ego == agent);
            scopes.push(
                others
                    .filter_map(|(entity, agent)| Some((entity, ego_of(agent)?)))
                    .collect(),
            );
        }
        let alternatives = egos.iter().zip(&fallback).map(|((_, _, proposed), chosen)| {
            let rest = self.possible.iter().filter(|action| *action != chosen);
            let all = std::iter::once(chosen).chain(rest);
            all.filter(|action| *action != proposed).copied().collect()
        });
        let proposal = Proposal {
            actions: egos.iter().map(|(_, _, proposed)| *proposed).collect(),
            alternatives: alternatives.collect(),
            scopes: scopes
                .iter()
                .map(|scope| scope.iter().map(|(_, ego)| *ego).collect())
                .collect(),
        };
        let mut judge = |ego: usize, joint: &[Action]| -> Result<bool, Diagnostic> {
            let (state, observer, _) = &mut egos[ego];
            let mut given = GivenActions::default();
            given.give(0, joint[ego]);
            scopes[ego]
                .iter()
                .for_each(|&(entity, other)| given.give(entity, joint[other]));
            let facts = Observed {
                given: Some(&given),
                ..observed(&state.atoms, observer, city)
            };
            let of = (monitor, self.oracle.constraints());
            let checked = state.joint.get_or_insert_with(|| JointState::new(monitor));
            checked.violations(of, facts, joint[ego], &mut state.broken)?;
            Ok(state.broken.is_empty())
        };
        let nearest = proposal.nearest_safe(&fallback, &mut judge)?;
        for (ego, (action, proposed)) in nearest.iter().zip(&proposal.actions).enumerate() {
            if action != proposed {
                judge(ego, &proposal.actions)?;
            }
        }
        Ok(nearest)
    }

    /// Checks that the shield fits observations of an oracle with the sensors of a task.
    ///
    /// # Errors
    /// `invalid-value` if the shield is probabilistic and the sensors output facts, or if the oracle has other
    /// observations.
    pub fn check(&self, oracle: &Oracle, task: &SpfConfig) -> Result<(), Diagnostic> {
        let probabilistic = self.config.mode == ShieldMode::Probabilistic;
        let invalid = |message: &str| Diagnostic::new(yaml::codes::INVALID_VALUE, message);
        match &task.sensors {
            Some(sensors) if probabilistic && sensors.output == SensorOutput::Facts => {
                let fault = invalid("a probabilistic shield needs probabilities, but these sensors output facts");
                Err(fault
                    .at(sensors.span, "")
                    .help("set `output: belief` or `output: probabilities`"))
            }
            _ if !self.oracle.observes_like(oracle) => Err(invalid(
                "the shield observes other predicates, or another number or order of entities, than the environment",
            )),
            _ => Ok(()),
        }
    }

    /// Returns the error for an action that the mode `mask` does not permit.
    pub fn forbidden(&self, action: &str, permitted: Actions) -> Diagnostic {
        let table = self.oracle.world().vocabulary.actions();
        let names: Vec<&str> = permitted.iter().map(|action| table.name(action)).collect();
        let message = format!(
            "the shield does not permit {action} now; it permits {}",
            names.join(", ")
        );
        let fault = Diagnostic::new(yaml::codes::INVALID_VALUE, message);
        fault.help("choose among the actions of the mask, or use the mode `override`")
    }

    /// Returns how it judges.
    pub fn config(&self) -> ShieldConfig {
        self.config
    }

    /// Returns the oracle with its rules.
    pub fn oracle(&self) -> &Arc<Oracle> {
        &self.oracle
    }

    /// Returns the actions that the rules derive from the observed facts, without the default, and the action that they
    /// choose.
    ///
    /// # Errors
    /// `limit-exceeded` if the rules derive too many rows.
    pub fn decide(&self, observer: &Observer, city: &Simulation) -> Result<(Actions, Action), Diagnostic> {
        let mut state = ShieldState::new(self);
        let derived = state.derive(self, observer, city)?;
        let vocabulary = &self.oracle.world().vocabulary;
        let kind = Some(AgentKind::Car.into());
        let chosen = vocabulary.decide(kind, derived);
        Ok((vocabulary.before_default(kind, derived), chosen))
    }

    /// Returns the verdict without probabilities, given the derived actions. `safe` returns which ones are safe.
    fn judge_facts(
        &self,
        derived: Actions,
        safe: impl FnOnce(Actions) -> Result<Actions, Diagnostic>,
    ) -> Result<Verdict, Diagnostic> {
        let vocabulary = &self.oracle.world().vocabulary;
        let chosen = vocabulary.decide(Some(AgentKind::Car.into()), derived);
        let mut permitted = match self.config.query {
            ShieldQuery::Appropriate => [chosen].into_iter().collect(),
            ShieldQuery::Safe => safe(self.possible_set)?,
        };
        let probabilities = Probabilities::Certain(permitted);
        // Rules may contradict themselves, so that no action is safe.
        if permitted.is_empty() {
            permitted.insert(chosen);
        }
        let mut possible = self.possible.iter().copied();
        let preferred = match permitted.contains(chosen) {
            true => chosen,
            false => possible
                .find(|action| permitted.contains(*action))
                .expect("one is permitted"),
        };
        Ok(Verdict {
            permitted,
            preferred,
            probabilities,
        })
    }

    /// Returns the circuits for observations of this many entities.
    fn circuits(&self, entities: usize, cancel: &Cancel) -> Result<&[ShieldCircuit], Diagnostic> {
        let place = &self.circuits[entities - 1];
        if let Some(known) = place.get() {
            return Ok(known);
        }
        let world = self.oracle.world();
        let vocabulary = &world.vocabulary;
        let id = |action: Action| vocabulary.action(action);
        let order = || self.possible.iter().filter_map(|action| Some((*action, id(*action)?)));
        let made: Vec<ShieldCircuit> = match self.config.query {
            ShieldQuery::Appropriate => {
                let mut outputs: Vec<Action> = order().map(|(action, _)| action).collect();
                // The last output is the probability that the rules derive none of them.
                outputs.push(vocabulary.decide(Some(AgentKind::Car.into()), Actions::default()));
                let predicates: Vec<PredicateId> = order().map(|(_, predicate)| predicate).collect();
                let outputs = outputs.into_iter().enumerate().collect();
                vec![self.compile(&world.program, (&predicates, outputs), None, entities, cancel)?]
            }
            ShieldQuery::Safe => {
                let (rules, given) = safety_rules(world.program.rules(), vocabulary);
                let program = Program::new(rules)?;
                let circuit = |action: &Action| {
                    let others: Vec<PredicateId> = order()
                        .filter(|(other, _)| other != action)
                        .map(|(_, predicate)| predicate)
                        .collect();
                    let outputs = vec![(others.len(), *action)];
                    let given = given[action.index()];
                    self.compile(&program, (&others, outputs), given, entities, cancel)
                };
                self.possible.iter().map(circuit).collect::<Result<_, _>>()?
            }
        };
        // Another thread may have compiled the same.
        Ok(place.get_or_init(|| made))
    }

    /// Compiles the outputs of a program for an ego among `entities` entities. `given` is the predicate of the imposed
    /// action.
    fn compile(
        &self,
        program: &Program,
        (order, outputs): (&[PredicateId], Vec<(usize, Action)>),
        given: Option<PredicateId>,
        entities: usize,
        cancel: &Cancel,
    ) -> Result<ShieldCircuit, Diagnostic> {
        let (rules, oracle) = (program.rules(), &self.oracle);
        let vocabulary = &oracle.world().vocabulary;
        let mut compiler = CircuitCompiler::new(program, order, &[], &CircuitOptions::default());
        let names: Vec<Value> = (0..entities)
            .map(|entity| compiler.intern(&format!("e{entity}")))
            .collect();
        compiler.begin();
        if let Some(given) = given {
            compiler.insert(given, &names[..1], 1.0);
        }
        if let Some(sees) = vocabulary.predicates[vocabulary.sees].id {
            let pairs = names
                .iter()
                .flat_map(|first| names.iter().map(move |second| [*first, *second]));
            pairs.for_each(|pair| compiler.insert(sees, &pair, 1.0));
        }
        let mut places = HashMap::new();
        for (predicate, row, start) in oracle.observed_sets() {
            let known = &vocabulary.predicates[predicate];
            let Some(id) = known.id else { continue };
            for (entity, &name) in names.iter().enumerate() {
                let pair = row.filter(|row| *row < entities).map(|row| [names[row], name]);
                let words = match (row, &pair) {
                    (None, _) => std::slice::from_ref(&name),
                    (Some(row), Some(pair)) if row != entity || known.definition.may_be_reflexive() => &pair[..],
                    _ => continue,
                };
                compiler.insert(id, words, 0.5);
                let base = rules.predicates[id.index()].edb.unwrap_or(id);
                places.insert((base, Box::<[Value]>::from(words)), start + entity);
            }
        }
        let done = compiler.tick(&names[..1], &[], &[], cancel);
        let done = done.map_err(|error| error.diagnostic(rules))?;
        done.map_err(|inexact| too_complex(&inexact, rules, entities))?;
        let circuit = compiler.circuit();
        let place = |variable: &RandomVariable| match variable {
            RandomVariable::Fact { predicate, row, .. } => places[&(*predicate, row.clone())],
            RandomVariable::Draw(_) | RandomVariable::Weight(_) => unreachable!("the rules draw nothing"),
        };
        Ok(ShieldCircuit {
            places: circuit.variables.iter().map(place).collect(),
            circuit,
            outputs,
        })
    }
}

/// Checks that the rules name no agent, since circuits are about entities of any name.
fn without_names(world: &World) -> Result<(), Diagnostic> {
    let rules = world.program.rules();
    let known = |predicate| {
        world
            .vocabulary
            .predicates
            .iter()
            .any(|base| base.id == Some(predicate))
    };
    for clause in &rules.clauses {
        let atoms = clause.body.iter().filter_map(|literal| literal.atom());
        let named = atoms
            .filter(|atom| known(atom.predicate) || world.vocabulary.action_of(atom.predicate).is_some())
            .any(|atom| atom.terms.iter().any(|term| matches!(term, Term::Constant(_))));
        if named {
            let message = "probabilistic shields know entities, not the names of agents";
            let fault = Diagnostic::new(codes::RULE_MISMATCH, message).at(clause.span, "this clause names an agent");
            return Err(fault.help("use a variable, or the mode `override`"));
        }
    }
    Ok(())
}

fn too_complex(inexact: &Inexact, rules: &Rules, entities: usize) -> Diagnostic {
    let (message, help) = match inexact {
        Inexact::TooLarge => (
            format!("the probabilities of actions among {entities} entities are too complex"),
            "observe fewer `entities`, or use the mode `override`",
        ),
        reason => (
            format!("a probabilistic shield has no probabilities: {}", reason.show(rules)),
            "use rules that do not aggregate over facts, or the mode `override`",
        ),
    };
    Diagnostic::new(diag::codes::LIMIT_EXCEEDED, message).help(help)
}

fn observed<'a>(atoms: &'a Atoms, observer: &'a Observer, city: &'a Simulation) -> Observed<'a> {
    Observed::new(atoms, observer.entities_of(city), city.cancel())
}

/// The work of a shield for one ego.
pub struct ShieldState {
    violations: Violations,
    atoms: Atoms,
    facts: Vec<f32>,
    probabilities: Vec<f64>,
    broken: Vec<usize>,
    /// Made on demand.
    joint: Option<JointState>,
}

impl ShieldState {
    /// Returns the state before the first observation.
    pub fn new(shield: &Shield) -> ShieldState {
        ShieldState {
            violations: Violations::new(shield.oracle.monitor()),
            atoms: shield.oracle.no_atoms(),
            facts: Vec::new(),
            probabilities: Vec::new(),
            broken: Vec::new(),
            joint: None,
        }
    }

    /// Judges the actions of an observer's ego in the observed state.
    ///
    /// # Errors
    /// `limit-exceeded` if the rules derive too many rows, or the probabilities are too complex.
    pub fn judge(
        &mut self,
        shield: &Shield,
        observer: &mut Observer,
        city: &Simulation,
    ) -> Result<Verdict, Diagnostic> {
        if shield.config.mode == ShieldMode::Probabilistic {
            return self.judge_probabilities(shield, observer, city.cancel());
        }
        // The observer has just evaluated the same rules on the same facts.
        if observer.observes_exactly_for(&shield.oracle) {
            let derived = observer.derived(city)?;
            return shield.judge_facts(derived, |actions| observer.safe_actions(city, actions));
        }
        let derived = self.derive(shield, observer, city)?;
        let ShieldState {
            violations,
            atoms,
            broken,
            ..
        } = self;
        let observed = observed(atoms, observer, city);
        shield.judge_facts(derived, |actions| {
            violations.safe_actions(shield.oracle.monitor(), observed, actions, broken)
        })
    }

    /// Returns the actions that the rules derive from what the ego observes as facts.
    fn derive(&mut self, shield: &Shield, observer: &Observer, city: &Simulation) -> Result<Actions, Diagnostic> {
        observer.copy_facts(&mut self.atoms);
        self.violations.forget();
        let vocabulary = &shield.oracle.world().vocabulary;
        let observed = observed(&self.atoms, observer, city);
        self.violations.derived(shield.oracle.monitor(), vocabulary, observed)
    }

    /// Judges by the probabilities of the observed facts.
    fn judge_probabilities(
        &mut self,
        shield: &Shield,
        observer: &Observer,
        cancel: &Cancel,
    ) -> Result<Verdict, Diagnostic> {
        let circuits = shield.circuits(observer.entities().len(), cancel)?;
        self.facts.resize(shield.oracle.width(), 0.0);
        observer.write(&mut self.facts);
        let mut probabilities = Box::new([0.0; Action::MAX]);
        for circuit in circuits {
            self.probabilities.clear();
            (self.probabilities).extend(circuit.places.iter().map(|place| f64::from(self.facts[*place])));
            let outputs = circuit.circuit.outputs(&self.probabilities);
            for &(output, action) in &circuit.outputs {
                probabilities[action.index()] += outputs[output];
            }
        }
        let mut preferred = shield.possible[0];
        for &action in &shield.possible[1..] {
            if probabilities[action.index()] > probabilities[preferred.index()] {
                preferred = action;
            }
        }
        let mut permitted: Actions = (shield.possible.iter().copied())
            .filter(|action| probabilities[action.index()] >= shield.config.threshold)
            .collect();
        permitted.insert(preferred);
        Ok(Verdict {
            permitted,
            preferred,
            probabilities: Probabilities::Each(probabilities),
        })
    }

    /// Returns the clauses that the proposed action violates in the proposed joint action, as positions in
    /// [`Oracle::constraints`], after [`Shield::nearest_safe`] has changed it.
    pub fn reasons(&self) -> &[usize] {
        &self.broken
    }

    /// Returns the clauses of the shield's rules that an action of the ego violates in the state that was judged last,
    /// as positions in [`Oracle::constraints`].
    ///
    /// # Errors
    /// `limit-exceeded` if the rules derive too many rows.
    pub fn violations(
        &mut self,
        shield: &Shield,
        observer: &Observer,
        city: &Simulation,
        action: Action,
    ) -> Result<&[usize], Diagnostic> {
        observer.copy_facts(&mut self.atoms);
        self.violations.forget();
        let observed = observed(&self.atoms, observer, city);
        self.violations
            .violations(shield.oracle.monitor(), observed, action, &mut self.broken)?;
        Ok(&self.broken)
    }
}
