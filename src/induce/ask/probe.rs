//! Random clauses that no answer has refuted. They stand for the clauses that are still unknown: the more of them hold
//! in a scene, the more its answer says.

use crate::induce::ask::hypothesis::{NegationRates, ground};
use crate::induce::ask::session::Session;
use crate::induce::bits::{self, Bits};
use crate::induce::examples::{State, majority, witnesses};
use crate::induce::vocabulary::{Assignment, Atom, Literal, Vocabulary, assignments};
use crate::rng::{Rng, RngExt};

/// Probes that are kept.
const PROBES: usize = 400;
/// Probes that are replaced before each question.
const REPLACED: usize = 20;
/// The literals with which a probe begins, and the most that it may have.
const LITERALS: (usize, usize) = (4, 10);
/// The share of probes with one variable beside those of the head, if there may be more.
const PAIRS: f64 = 0.5;
/// The share of negated literals.
const NEGATED: f64 = 0.5;
/// The maximum number of states of the examples that refute probes.
const REFUTING_MAX: usize = 1000;

/// A random clause of an action that holds in a random scene, its source. The first entities of the source are those of
/// the variables.
struct Probe {
    action: usize,
    literals: Vec<Literal>,
    variables: usize,
    source: State,
    /// By number of entities, the facts of each assignment: those that must hold, and those that must not.
    instances: Vec<Vec<(Bits, Bits)>>,
}

/// Random clauses that agree with all answers.
pub struct Probes {
    probes: Vec<Probe>,
    /// States with their actions that refute probes.
    states: Vec<(State, usize)>,
    /// Answers of the session that are among the states.
    seen: usize,
    /// By number of variables, the atoms of clauses.
    atoms: Vec<Vec<Atom>>,
    vocabulary: Vocabulary,
    sizes: usize,
}

impl Probes {
    /// Begins with the examples of a session.
    pub fn new(session: &Session<'_>) -> Probes {
        let vocabulary = session.examples.vocabulary().clone();
        let states = session.examples.states();
        let step = states.len().div_ceil(REFUTING_MAX).max(1);
        let most = session.variables().max(vocabulary.egos());
        Probes {
            probes: Vec::new(),
            states: (states.step_by(step))
                .map(|(state, tallies)| (state.clone(), majority(tallies)))
                .collect(),
            seen: session.log.len(),
            atoms: (0..=most).map(|variables| vocabulary.atoms(variables)).collect(),
            sizes: session.asking.entities.max(vocabulary.egos()),
            vocabulary,
        }
    }

    /// Specializes the probes that new answers refute, and replaces some by clauses of actions before `level`. `draw`
    /// returns a random scene.
    pub fn update(
        &mut self,
        session: &mut Session<'_>,
        level: usize,
        random: &mut impl Rng,
        draw: &mut dyn FnMut(&mut Session<'_>) -> Option<State>,
    ) {
        let rates = NegationRates::new(&session.hypothesis);
        let space = session.space(session.variables().max(self.vocabulary.egos()));
        let weigh = |atom: &Atom| {
            rates.probability(
                &space,
                self.vocabulary.fact(space.entities, atom.predicate, &atom.own()),
            )
        };
        let weights: Vec<Vec<f64>> = self
            .atoms
            .iter()
            .map(|atoms| atoms.iter().map(weigh).collect())
            .collect();
        let drawing = Drawing {
            vocabulary: &self.vocabulary,
            atoms: &self.atoms,
            weights: &weights,
            sizes: self.sizes,
        };
        for answer in &session.log[self.seen..] {
            let (state, action) = (&answer.state, answer.action);
            self.probes
                .retain_mut(|probe| drawing.exclude(probe, state, action, random));
            self.states.push((state.clone(), action));
        }
        self.seen = session.log.len();
        if self.probes.len() == PROBES {
            self.probes.drain(..REPLACED);
        }
        for _ in 0..2 * (PROBES - self.probes.len()) {
            let Some(source) = draw(session) else { continue };
            let most = session.variables().min(source.entities()).max(self.vocabulary.egos());
            let mut probe = drawing.probe(source, most, level, random);
            let mut excludes = |(state, action): &(State, usize)| drawing.exclude(&mut probe, state, *action, random);
            if self.states.iter().all(&mut excludes) {
                self.probes.push(probe);
            }
            if self.probes.len() == PROBES {
                break;
            }
        }
    }

    /// Returns how many probes a scene would refute if the oracle takes an action.
    pub fn count(&self, state: &State, action: usize) -> usize {
        let holds = |probe: &&Probe| probe.action < action && probe.holds_in(state);
        self.probes.iter().filter(holds).count()
    }
}

/// Draws literals.
struct Drawing<'a> {
    vocabulary: &'a Vocabulary,
    /// By number of variables.
    atoms: &'a [Vec<Atom>],
    /// The weights of the negations of the atoms.
    weights: &'a [Vec<f64>],
    /// The maximum number of entities of a random scene.
    sizes: usize,
}

impl Drawing<'_> {
    /// Draws a clause of an action before `level` that holds in a scene.
    fn probe(&self, source: State, most: usize, level: usize, random: &mut impl Rng) -> Probe {
        let egos = self.vocabulary.egos();
        let variables = if most > egos + 1 && random.random_bool(PAIRS) {
            egos + 1
        } else {
            random.random_range(egos..=most)
        };
        let mut probe = Probe {
            action: random.random_range(0..level.max(1)),
            literals: Vec::new(),
            variables,
            source,
            instances: Vec::new(),
        };
        for _ in 0..random.random_range(1..=LITERALS.0) {
            self.specialize(&mut probe, None, random);
        }
        self.ground(&mut probe);
        probe
    }

    /// Specializes a probe that an answer refutes. Returns false if that is impossible or the probe becomes too long.
    fn exclude(&self, probe: &mut Probe, state: &State, action: usize, random: &mut impl Rng) -> bool {
        if probe.action >= action || !probe.holds(self.vocabulary, state) {
            return true;
        }
        while let Some(witness) = witnesses(self.vocabulary, &probe.literals, probe.variables, state, 1).pop() {
            if probe.literals.len() >= LITERALS.1 || !self.specialize(probe, Some((state, &witness)), random) {
                return false;
            }
        }
        self.ground(probe);
        true
    }

    /// Adds a literal that is true in the source of a probe, and false in a state under an assignment.
    fn specialize(&self, probe: &mut Probe, refuting: Option<(&State, &Assignment)>, random: &mut impl Rng) -> bool {
        let atoms = &self.atoms[probe.variables];
        let (mut positive, mut negative) = (Vec::new(), Vec::new());
        for (at, atom) in atoms.iter().enumerate() {
            let is_true = probe.source.holds(self.vocabulary, atom.predicate, &atom.own());
            let differs = refuting.is_none_or(|(state, witness)| {
                state.holds(self.vocabulary, atom.predicate, &atom.under(witness)) != is_true
            });
            if differs {
                if is_true { &mut positive } else { &mut negative }.push(at);
            }
        }
        let is_negated = positive.is_empty() || (!negative.is_empty() && random.random_bool(NEGATED));
        let chosen = if is_negated {
            let weights = &self.weights[probe.variables];
            let mut left = random.random::<f64>() * negative.iter().map(|&at| weights[at]).sum::<f64>();
            let chosen = negative.iter().find(|&&at| {
                left -= weights[at];
                left <= 0.0
            });
            chosen.or(negative.last()).copied()
        } else {
            Some(positive[random.random_range(0..positive.len())])
        };
        let literal = chosen.map(|at| Literal {
            is_negated,
            atom: atoms[at].clone(),
        });
        match literal {
            Some(literal) if !probe.literals.contains(&literal) => probe.literals.push(literal),
            Some(_) => {}
            None => return false,
        }
        true
    }

    fn ground(&self, probe: &mut Probe) {
        let egos = self.vocabulary.egos();
        let sizes = (0..=self.sizes).map(|entities| {
            if entities < egos {
                return Vec::new();
            }
            let all = assignments(egos, probe.variables, entities);
            all.map(|assignment| ground(self.vocabulary, &probe.literals, &assignment, entities))
                .collect()
        });
        probe.instances = sizes.collect();
    }
}

impl Probe {
    /// Returns whether the probe holds in a scene that is not too large.
    fn holds_in(&self, state: &State) -> bool {
        let scene = state.fact_set();
        self.instances.get(state.entities()).is_some_and(|instances| {
            instances.iter().any(|(positive, negative)| {
                positive.iter().zip(scene).all(|(fact, scene)| fact & !scene == 0) && !bits::intersects(negative, scene)
            })
        })
    }

    fn holds(&self, vocabulary: &Vocabulary, state: &State) -> bool {
        if state.entities() < self.instances.len() {
            return self.holds_in(state);
        }
        !witnesses(vocabulary, &self.literals, self.variables, state, 1).is_empty()
    }
}
