//! Questions, their answers, and the rules learned from them.

use crate::cancel::Cancel;
use crate::induce::ask::hypothesis::Hypothesis;
use crate::induce::ask::space::{Space, canonical};
use crate::induce::ask::support::{self, Support};
use crate::induce::constraints::Constraints;
use crate::induce::examples::{Examples, State, majority};
use crate::induce::learner::learn;
use crate::induce::rules::{LearnedRules, Settings};
use crate::induce::vocabulary::{Body, Literal};
use crate::rng::{Purpose, Rng, RngExt, Seed};
use std::collections::{HashMap, VecDeque};
use std::error::Error;
use std::rc::Rc;

impl Purpose {
    /// The choice of questions; the index is the number of answers before.
    pub const ASK: Purpose = Purpose::new(41);
}

/// Why an oracle has no answer.
pub type Failure = Box<dyn Error + Send + Sync>;

/// Knows the action that the rules to be learned take in a state.
pub trait Oracle {
    /// Returns the position of the action in [`Examples::actions`].
    ///
    /// # Errors
    /// The reason why there is no answer. It ends the questions.
    fn action(&mut self, state: &State) -> Result<usize, Failure>;
}

impl<F: FnMut(&State) -> Result<usize, Failure>> Oracle for F {
    fn action(&mut self, state: &State) -> Result<usize, Failure> {
        self(state)
    }
}

/// Why a question was asked.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Reason {
    /// The smallest scene in which a clause holds.
    Smallest(Body),
    /// A scene in which a clause holds together with facts that no example has shown with it.
    Extended(Body),
    /// A scene in which all literals of a clause but one hold.
    Without(Body, Literal),
    /// Between two scenes with different answers.
    Bisect,
    /// A scene with an unexpected answer, without some of its facts.
    Shrink,
    /// A random scene.
    Explore,
    /// One of all small scenes.
    Sweep,
    /// An earlier question once more, to find contradictions.
    Repeat,
}

/// A question with its answer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Answer {
    /// The state that the oracle decided.
    pub state: State,
    /// The position of the action.
    pub action: usize,
    /// Why it was asked.
    pub reason: Reason,
}

/// Settings of the questions.
#[derive(Clone, Debug)]
pub struct AskSettings {
    /// The seed of the choice of questions.
    pub seed: u64,
    /// The maximum number of questions, those of the sweep and of the log included.
    pub questions: usize,
    /// Consecutive random scenes without a surprise after which the rules count as learned.
    pub agreements: usize,
    /// The maximum number of entities of a random scene.
    pub entities: usize,
    /// Ask an earlier question again after this many answers; 0 for never. The sweep repeats none.
    pub repeat_after: usize,
    /// The learner asks all scenes of this size at the end.
    pub sweep: Option<Bound>,
}

impl Default for AskSettings {
    fn default() -> AskSettings {
        AskSettings {
            seed: 0,
            questions: 10_000_000,
            agreements: 400,
            entities: 4,
            repeat_after: 100,
            sweep: None,
        }
    }
}

/// The size of the scenes of a sweep.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Bound {
    /// The maximum number of facts, not counting covering facts and facts that follow from others.
    pub facts: usize,
    /// The maximum number of entities, the egos included.
    pub entities: usize,
}

/// Why the questions ended.
#[derive(Debug)]
pub enum End {
    /// The rules agreed with the oracle in as many random scenes as required.
    Agreed,
    /// The rules agree with the oracle in all scenes of a size: this number, up to the names of entities.
    Certified(Bound, u64),
    /// The number of questions reached its limit.
    Limit,
    /// The caller cancelled.
    Cancelled,
    /// The oracle answered the same question in two ways.
    Contradiction {
        /// The state.
        state: State,
        /// The positions of the actions, in the order of the answers.
        actions: [usize; 2],
    },
    /// The oracle takes another action than an example of the beginning.
    DeniedExample {
        /// The state.
        state: State,
        /// The positions of the actions: that of the example and that of the oracle.
        actions: [usize; 2],
    },
    /// No rules within the settings agree with all answers. An answer that the rules get wrong.
    Inseparable {
        /// The state.
        state: State,
        /// The position of the action that the oracle takes.
        action: usize,
    },
    /// The oracle failed to answer.
    Failed(Failure),
    /// The oracle returned an action that does not exist.
    UnknownAction(usize),
}

/// What happens during a refinement.
#[derive(Debug)]
pub enum Event<'a> {
    /// The oracle, or the log of an earlier run, gave an answer.
    Answered {
        /// The question and its answer.
        answer: &'a Answer,
        /// Whether it comes from the oracle.
        is_new: bool,
    },
    /// Rules were learned.
    Learned(&'a LearnedRules),
    /// A sweep begins. The number is an upper bound of its questions.
    Sweep(Bound, u128),
}

/// Receives events.
pub type Observer<'a> = &'a mut dyn FnMut(Event<'_>);

/// How many of the latest answers are checked if no rules agree with all.
const RECHECKED: usize = 64;
/// Wrongly predicted answers that are added to the examples at a time.
const ADDED: usize = 64;

/// The state of a refinement.
pub struct Session<'a> {
    pub examples: Examples,
    pub constraints: &'a Constraints,
    pub asking: &'a AskSettings,
    pub cancel: &'a Cancel,
    pub rules: LearnedRules,
    pub hypothesis: Hypothesis,
    /// For each clause of the hypothesis, what the examples say about it.
    pub supports: Vec<Support>,
    pub log: Vec<Answer>,
    learning: &'a Settings,
    oracle: &'a mut dyn Oracle,
    observe: Observer<'a>,
    /// Answers of an earlier run that this run did not ask for yet.
    earlier: HashMap<State, VecDeque<usize>>,
    /// Actions of all examples and answers, by the canonical form of the state, with whether the oracle was asked.
    known: HashMap<State, (usize, bool)>,
    /// By position in the log, whether the answer is among the examples.
    is_example: Vec<bool>,
    spaces: Vec<Option<Rc<Space>>>,
}

impl<'a> Session<'a> {
    #[allow(clippy::too_many_arguments)]
    pub fn new(
        examples: Examples,
        constraints: &'a Constraints,
        learning: &'a Settings,
        asking: &'a AskSettings,
        log: Vec<Answer>,
        oracle: &'a mut dyn Oracle,
        observe: Observer<'a>,
        cancel: &'a Cancel,
    ) -> Session<'a> {
        let mut earlier: HashMap<State, VecDeque<usize>> = HashMap::new();
        for answer in log {
            earlier.entry(answer.state).or_default().push_back(answer.action);
        }
        let vocabulary = examples.vocabulary();
        let known = (examples.states())
            .map(|(state, tallies)| (canonical(vocabulary, state), (majority(tallies), false)))
            .collect();
        let hypothesis = Hypothesis::new(vocabulary, &[], examples.actions().len() - 1);
        Session {
            known,
            hypothesis,
            examples,
            constraints,
            asking,
            cancel,
            learning,
            oracle,
            observe,
            earlier,
            rules: LearnedRules::default(),
            supports: Vec::new(),
            log: Vec::new(),
            is_example: Vec::new(),
            spaces: Vec::new(),
        }
    }

    /// Returns the scenes of a number of entities.
    pub fn space(&mut self, entities: usize) -> Rc<Space> {
        if self.spaces.len() <= entities {
            self.spaces.resize(entities + 1, None);
        }
        let (vocabulary, constraints) = (self.examples.vocabulary(), self.constraints);
        let space = self.spaces[entities].get_or_insert_with(|| Rc::new(Space::new(vocabulary, constraints, entities)));
        Rc::clone(space)
    }

    /// Returns the generator of the next random choices.
    pub fn random(&self, purpose: u64) -> impl Rng + use<> {
        Seed(self.asking.seed).stream(Purpose::ASK, self.log.len() as u64, purpose)
    }

    /// Returns the most variables of a clause.
    pub fn variables(&self) -> usize {
        self.learning.variables
    }

    /// Returns whether the action for a state is known.
    pub fn is_known(&self, state: &State) -> bool {
        self.known.contains_key(&canonical(self.examples.vocabulary(), state))
    }

    /// Returns the action for a state: the known one, or the answer to a question. The sweep also asks about states of
    /// examples, since a certificate rests on answers alone.
    pub fn ask(&mut self, state: &State, reason: Reason) -> Result<usize, End> {
        let state = canonical(self.examples.vocabulary(), state);
        let is_sweep = reason == Reason::Sweep;
        let known = self.known.get(&state).copied();
        match known {
            Some((action, is_asked)) if is_asked || !is_sweep => return Ok(action),
            _ => {}
        }
        let is_repeat_due = self.asking.repeat_after > 0
            && !is_sweep
            && !self.log.is_empty()
            && self.log.len().is_multiple_of(self.asking.repeat_after);
        if is_repeat_due {
            let at = self.random(0).random_range(0..self.log.len());
            self.repeat(at)?;
        }
        let action = self.answer(state.clone(), reason)?;
        if let Some((example, _)) = known.filter(|(example, _)| *example != action) {
            return Err(End::DeniedExample {
                state,
                actions: [example, action],
            });
        }
        self.known.insert(state.clone(), (action, true));
        let is_surprise = self.hypothesis.action(&state) != action;
        let is_example = !is_sweep || is_surprise;
        *self.is_example.last_mut().expect("the answer was logged") = is_example;
        if is_example {
            self.examples.push(state.clone(), action);
        }
        if !is_surprise {
            support::add(
                &mut self.supports,
                &self.hypothesis,
                self.examples.vocabulary(),
                &state,
                action,
            );
        }
        Ok(action)
    }

    /// Asks the question at a position of the log once more.
    fn repeat(&mut self, at: usize) -> Result<(), End> {
        let Answer { state, action, .. } = self.log[at].clone();
        let again = self.answer(state.clone(), Reason::Repeat)?;
        if again == action {
            return Ok(());
        }
        Err(End::Contradiction {
            state,
            actions: [action, again],
        })
    }

    /// Gets an answer from the log of the earlier run or from the oracle, and logs it.
    fn answer(&mut self, state: State, reason: Reason) -> Result<usize, End> {
        if self.cancel.requested() {
            return Err(End::Cancelled);
        }
        if self.log.len() >= self.asking.questions {
            return Err(End::Limit);
        }
        let earlier = self.earlier.get_mut(&state).and_then(VecDeque::pop_front);
        let action = match earlier {
            Some(action) => action,
            None => self.oracle.action(&state).map_err(End::Failed)?,
        };
        if action >= self.examples.actions().len() {
            return Err(End::UnknownAction(action));
        }
        let answer = Answer { state, action, reason };
        (self.observe)(Event::Answered {
            answer: &answer,
            is_new: earlier.is_none(),
        });
        self.log.push(answer);
        self.is_example.push(false);
        Ok(action)
    }

    /// Reports the beginning of a sweep.
    pub fn begin_sweep(&mut self, bound: Bound, most: u128) {
        (self.observe)(Event::Sweep(bound, most));
    }

    /// Learns rules that agree with all examples and answers.
    pub fn learn(&mut self) -> Result<(), End> {
        loop {
            let rules = learn(&self.examples, self.learning, self.cancel);
            if self.cancel.requested() {
                if self.rules.actions.is_empty() {
                    self.rules = rules;
                }
                return Err(End::Cancelled);
            }
            let default = self.examples.actions().len() - 1;
            self.hypothesis = Hypothesis::new(self.examples.vocabulary(), &rules.actions, default);
            self.rules = rules;
            (self.observe)(Event::Learned(&self.rules));
            let mut wrong: Vec<usize> = Vec::new();
            let mut inseparable = None;
            for (at, answer) in self.log.iter().enumerate() {
                if answer.reason == Reason::Repeat || self.hypothesis.action(&answer.state) == answer.action {
                    continue;
                }
                if self.is_example[at] {
                    inseparable = inseparable.or(Some(at));
                } else if wrong.len() < ADDED {
                    wrong.push(at);
                }
            }
            if let Some(at) = inseparable {
                return Err(self.recheck(at));
            }
            if wrong.is_empty() {
                break;
            }
            for at in wrong {
                self.is_example[at] = true;
                self.examples.push(self.log[at].state.clone(), self.log[at].action);
            }
        }
        self.supports = support::of_all(&self.hypothesis, &self.examples);
        Ok(())
    }

    /// Finds out whether the oracle contradicts itself, since no rules agree with the answer at a position of the log.
    fn recheck(&mut self, at: usize) -> End {
        let latest = self.log.len().saturating_sub(RECHECKED)..self.log.len();
        let latest = latest
            .rev()
            .filter(|&other| other != at && self.log[other].reason != Reason::Repeat);
        let checked: Vec<usize> = std::iter::once(at).chain(latest).collect();
        for other in checked {
            if let Err(end) = self.repeat(other) {
                return end;
            }
        }
        End::Inseparable {
            state: self.log[at].state.clone(),
            action: self.log[at].action,
        }
    }
}
