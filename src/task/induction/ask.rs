//! Rules learned by questions: states as scenes, the log of questions, oracles, and what the answers prove.
//!
//! [`induce::ask`](crate::induce::ask) chooses the questions. This module connects it with oracles that decide scenes
//! of a city, and with a log from which an interrupted run continues.

use crate::cancel::Cancel;
use crate::diag::{self, Diagnostic, SourceId, Sources, Span};
use crate::files::{Journal, ReadError};
use crate::induce::ask::{
    Answer, AskSettings, End, Event, Failure, Observer, Oracle, Reason, Refined, Refinement, canonical,
};
use crate::induce::{Examples, LearnedRules, Settings, State};
use crate::rng::Seed;
use crate::sim::{self, Executor, Facts, Inference, SceneFacts};
use crate::task::induction::codes;
use crate::task::induction::text::plural;
use crate::task::induction::{InductionTask, Origin};
use serde_json::{Map, Value, json};
use sha2::{Digest, Sha256};
use std::cell::Cell;
use std::collections::HashMap;
use std::error::Error;
use std::fmt;
use std::io;
use std::path::Path;

/// How a log of questions begins.
pub const LOG_START: &str = "{\"questions\":";
/// The version of the log.
const LOG_VERSION: u64 = 1;

/// The reasons of questions with their names in logs and reports.
const REASONS: [&str; 8] = [
    "smallest", "extended", "without", "bisect", "shrink", "explore", "sweep", "repeat",
];

/// Why there is no action for a question.
#[derive(Debug)]
pub enum OracleError {
    /// The answer is not an action of the rules, or the rules of the oracle cannot be evaluated.
    Invalid(Box<Diagnostic>),
    /// There is no answer. The text is a clause that begins with the subject.
    Silent(String),
    /// The answer cannot be added to the log.
    Log(io::Error),
    /// The user cancelled while the oracle was working.
    Cancelled,
}

impl fmt::Display for OracleError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            OracleError::Invalid(fault) => f.write_str(&fault.message),
            OracleError::Silent(text) => f.write_str(text),
            OracleError::Log(error) => write!(f, "cannot write the log of questions: {error}"),
            OracleError::Cancelled => f.write_str("cancelled"),
        }
    }
}

impl Error for OracleError {}

impl From<Diagnostic> for OracleError {
    fn from(fault: Diagnostic) -> Self {
        match fault.code == diag::codes::CANCELLED {
            true => OracleError::Cancelled,
            false => OracleError::Invalid(fault.into()),
        }
    }
}

/// What to learn by questions, and from what.
#[derive(Clone, Debug)]
pub struct Inquiry {
    /// Examples known at the beginning.
    pub examples: Examples,
    /// Settings of the learner.
    pub learning: Settings,
    /// Settings of the questions.
    pub asking: AskSettings,
    /// The oracle in words, for reports.
    pub oracle: String,
    /// The answers in the log of an earlier run.
    pub answers: Vec<Answer>,
}

impl Inquiry {
    /// Creates an inquiry with the usual settings of questions, without an oracle and a log.
    pub fn new(examples: Examples, learning: Settings, seed: u64) -> Inquiry {
        let asking = AskSettings {
            seed,
            ..AskSettings::default()
        };
        Inquiry {
            examples,
            learning,
            asking,
            oracle: String::new(),
            answers: Vec::new(),
        }
    }

    /// Returns the first line of the log of the questions: everything that they depend on. `oracle` identifies the
    /// oracle.
    fn log_header(&self, task: &InductionTask, oracle: &str) -> Value {
        let scenario = &task.world().scenario;
        let constraints = task.constraints();
        let declarations = format!("{:?} {constraints:?}", task.vocabulary().predicates());
        let actions: Vec<&str> = task.actions().iter().map(|action| action.name()).collect();
        json!({
            "questions": LOG_VERSION,
            "configuration": format!("{} {}", scenario.name, short(&scenario.hash)),
            "declarations": short(&format!("{:x}", Sha256::digest(declarations))),
            "actions": actions.join(","),
            "oracle": oracle,
            "examples": format!("{} {}", self.examples.count(), short(&digest(&self.examples))),
            "variables": self.learning.variables,
            "effort": self.learning.nodes,
            "seed": self.asking.seed,
        })
    }
}

/// Returns the beginning of a hash.
fn short(hash: &str) -> String {
    hash.chars().take(12).collect()
}

/// Returns a hash of examples.
fn digest(examples: &Examples) -> String {
    let mut hash = Sha256::new();
    for (state, tallies) in examples.states() {
        hash.update((state.entities() as u64).to_le_bytes());
        for fact in state.facts() {
            hash.update((fact as u64).to_le_bytes());
        }
        for tally in tallies {
            hash.update(u64::MAX.to_le_bytes());
            hash.update(tally.count.to_le_bytes());
            hash.update(tally.first.to_le_bytes());
        }
    }
    format!("{:x}", hash.finalize())
}

/// Why a log cannot be continued.
#[derive(Debug)]
pub enum LogError {
    /// It is the log of other questions, or no log. A predicate of the sentence whose subject is the file.
    Other(String),
    /// An answer is faulty.
    Faults(Vec<Diagnostic>, Sources),
    /// It cannot be read or written.
    Io(io::Error),
}

impl From<io::Error> for LogError {
    fn from(error: io::Error) -> Self {
        match error.kind() {
            io::ErrorKind::InvalidData => LogError::Other(format!("is not a log of questions: {error}")),
            _ => LogError::Io(error),
        }
    }
}

/// Checks that a log begins with the header of this run.
fn check_header(line: &str, expected: &Value) -> Result<(), LogError> {
    let header: Option<Value> = serde_json::from_str(line).ok();
    let Some(header) = header.filter(|_| line.starts_with(LOG_START)) else {
        return Err(LogError::Other("is not a log of questions".to_owned()));
    };
    if header["questions"] != expected["questions"] {
        let version = &header["questions"];
        return Err(LogError::Other(format!(
            "is a log of version {version}; this program reads version {LOG_VERSION}"
        )));
    }
    for (key, value) in expected.as_object().expect("a header") {
        let logged = &header[key];
        if logged != value {
            return Err(LogError::Other(format!(
                "is the log of other questions: its `{key}` is {logged}, that of this run {value}"
            )));
        }
    }
    Ok(())
}

/// An oracle that follows rules.
pub struct RuleOracle<'a> {
    task: &'a InductionTask,
    inference: Inference,
    /// For each predicate of the task, its position in the facts.
    columns: Vec<usize>,
}

impl<'a> RuleOracle<'a> {
    /// Creates an oracle that follows the rules of an inference for the configuration of the task.
    ///
    /// # Errors
    /// `rule-mismatch` if the configurations differ.
    pub fn new(task: &'a InductionTask, inference: Inference) -> Result<RuleOracle<'a>, Diagnostic> {
        let columns = task.translator(inference.vocabulary())?.columns;
        Ok(RuleOracle {
            task,
            inference,
            columns,
        })
    }

    /// Returns the position of the action in a state.
    ///
    /// # Errors
    /// [`OracleError::Cancelled`] on cancellation; [`OracleError::Invalid`] if the rules exceed their limits or take an
    /// action that the task lacks.
    pub fn action(&self, state: &State, cancel: &Cancel) -> Result<usize, OracleError> {
        let known = self.inference.vocabulary();
        let mut facts = Facts::new(known.predicates.len());
        let entities = 0..state.entities() as u32;
        facts.rows[known.sees] = entities
            .clone()
            .flat_map(|one| entities.clone().map(move |other| [one, other]))
            .collect();
        self.task.each_fact(state, |predicate, row| {
            let second = row.get(1).copied().unwrap_or(0);
            facts.rows[self.columns[predicate]].push([row[0] as u32, second as u32]);
        });
        let scene = SceneFacts {
            kinds: Vec::new(),
            names: names(state),
            egos: vec![0],
            facts,
            actions: Vec::new(),
            uncertain: Vec::new(),
        };
        let answer = self.inference.answer_facts_with(&scene, cancel)?;
        let (_, action) = answer.actions().next().expect("the scene has an ego");
        self.task.answered_action(action)
    }
}

/// Returns the names of the entities of a state. The first one is the ego.
fn names(state: &State) -> Vec<String> {
    (0..state.entities()).map(|entity| format!("e{entity}")).collect()
}

impl InductionTask {
    /// Calls `visit` with the predicate and the arguments of each fact of a state.
    fn each_fact(&self, state: &State, mut visit: impl FnMut(usize, &[usize])) {
        let entities = state.entities();
        for (index, predicate) in self.vocabulary().predicates().iter().enumerate() {
            for number in 0..entities.pow(predicate.arity as u32) {
                let row = [number / entities, number % entities];
                let row = &row[2 - predicate.arity..];
                if state.holds(self.vocabulary(), index, row) {
                    visit(index, row);
                }
            }
        }
    }

    /// Returns a state as a symbolic scene, as `logicity infer` reads it. Its first entity is the ego.
    pub fn scene(&self, state: &State) -> Value {
        let names = names(state);
        let mut facts: Map<String, Value> = Map::new();
        self.each_fact(state, |predicate, row| {
            let row = match row {
                [only] => json!(names[*only]),
                row => row.iter().map(|&entity| names[entity].as_str()).collect(),
            };
            let rows = facts
                .entry(self.vocabulary().predicates()[predicate].name.clone())
                .or_insert_with(|| json!([]));
            rows.as_array_mut().expect("a list").push(row);
        });
        json!({ "entities": names, "ego": names[0], "facts": facts })
    }

    /// Reads the answers of an earlier run from its log. Writes the header of a new log, which identifies the `oracle`.
    ///
    /// # Errors
    /// The log belongs to other questions, has a faulty answer, or cannot be read or written. `name` is its name in
    /// messages.
    pub fn resume(
        &self,
        inquiry: &Inquiry,
        oracle: &str,
        log: &mut Journal,
        name: &str,
    ) -> Result<Vec<Answer>, LogError> {
        let header = inquiry.log_header(self, oracle);
        let mut lines = log.lines()?;
        let Some(first) = lines.next() else {
            let torn = log.torn()?;
            let length = torn.len().min(LOG_START.len());
            if torn[..length] != LOG_START.as_bytes()[..length] {
                return Err(LogError::Other("is not a log of questions".to_owned()));
            }
            log.append(&header.to_string())?;
            return Ok(Vec::new());
        };
        check_header(&first?, &header)?;
        let (scenario, program) = (self.world().scenario.clone(), self.world().program.clone());
        let no_maps = |_: &Path| Err(ReadError::NotFound);
        let scenes = Inference::new(scenario, program, Seed(0), Executor::Relational, no_maps);
        let mut scenes = scenes.map_err(|faults| LogError::Faults(faults, Sources::new()))?;
        let mut answers = Vec::new();
        for (line, number) in lines.zip(2..) {
            let mut sources = Sources::new();
            let source = sources.add_from(name, line?, number);
            match self.answer(&mut scenes, &sources, source) {
                Ok(answer) => answers.push(answer),
                Err(faults) => return Err(LogError::Faults(faults, sources)),
            }
        }
        Ok(answers)
    }

    /// Reads the line of a log.
    fn answer(&self, scenes: &mut Inference, sources: &Sources, line: SourceId) -> Result<Answer, Vec<Diagnostic>> {
        let scene = scenes.ground(sources, line)?;
        let [(ego, action)] = scene.actions[..] else {
            let fault = Diagnostic::new(sim::codes::INVALID_SCENE, "an answer has exactly one action");
            return Err(vec![
                fault.at(Span::new(line, 0..sources.text(line).len()), "in this line"),
            ]);
        };
        let translator = self.translator(scenes.vocabulary());
        let state = translator.and_then(|translator| translator.state(&scene.facts, ego));
        Ok(Answer {
            state: state.map_err(|fault| vec![fault])?,
            action: self.action(action).map_err(|fault| vec![fault])?,
            // The run that reads the log knows the reason.
            reason: Reason::Explore,
        })
    }

    /// Returns the line of a log for an answer: the scene with its action and the reason of the question.
    fn log_line(&self, answer: &Answer) -> Value {
        let mut scene = self.scene(&answer.state);
        let ego = scene["ego"].as_str().expect("a name").to_owned();
        scene["actions"] = json!({ ego: self.actions()[answer.action].name() });
        scene["reason"] = self.reason(&answer.reason).into();
        scene
    }

    /// Returns the reason of a question in words, the first of which is its name.
    fn reason(&self, reason: &Reason) -> String {
        let name = REASONS[position(reason)];
        match reason {
            Reason::Smallest(body) | Reason::Extended(body) => {
                format!("{name}: {}", body.texts(self.vocabulary()).join(", "))
            }
            Reason::Without(body, literal) => {
                let body = body.texts(self.vocabulary()).join(", ");
                format!("{name} {}: {body}", literal.text(self.vocabulary()))
            }
            _ => name.to_owned(),
        }
    }

    /// Returns the position of the action that an oracle takes.
    ///
    /// # Errors
    /// [`OracleError::Invalid`] if the rules do not declare it.
    pub fn answered_action(&self, action: crate::city::Action) -> Result<usize, OracleError> {
        self.action(action).map_err(|_| {
            let names: Vec<&str> = self.actions().iter().map(|action| action.name()).collect();
            let message = format!(
                "the oracle takes the action `{}`, which the rules do not declare",
                action.name()
            );
            let fault = Diagnostic::new(codes::INVALID_ANSWER, message);
            OracleError::Invalid(fault.note(format!("they declare {}", names.join(", "))).into())
        })
    }

    /// Asks an oracle until the learned rules agree with it. Each new answer is added to the log at once.
    pub fn ask(
        &self,
        inquiry: Inquiry,
        oracle: &mut dyn FnMut(&State) -> Result<usize, OracleError>,
        mut log: Option<&mut Journal>,
        observe: Observer<'_>,
        cancel: &Cancel,
    ) -> Asked {
        let refinement = Refinement {
            constraints: self.constraints(),
            log: inquiry.answers,
            examples: inquiry.examples,
            learning: inquiry.learning,
            asking: inquiry.asking.clone(),
        };
        let begin = refinement.examples.count();
        let unwritten: Cell<Option<io::Error>> = Cell::new(None);
        let mut questions = Questions {
            oracle: inquiry.oracle,
            begin,
            by_reason: [0; REASONS.len()],
            agreements: inquiry.asking.agreements,
            variables: refinement.learning.variables,
            last_explored: 0,
            log: Vec::new(),
            end: End::Cancelled,
        };
        let mut guarded = |state: &State| -> Result<usize, Failure> {
            match unwritten.take() {
                Some(error) => Err(OracleError::Log(error).into()),
                None => Ok(oracle(state)?),
            }
        };
        let mut observed = |event: Event<'_>| {
            if let Event::Answered { answer, is_new } = &event {
                questions.count(answer);
                if *is_new
                    && let Some(log) = &mut log
                    && let Err(error) = log.append(&self.log_line(answer).to_string())
                {
                    unwritten.set(Some(error));
                }
            }
            observe(event);
        };
        let Refined {
            rules,
            log,
            end,
            examples,
        } = refinement.run(&mut guarded as &mut dyn Oracle, &mut observed, cancel);
        questions.log = log;
        questions.end = match end {
            End::Failed(failure) => match failure.downcast_ref() {
                Some(OracleError::Cancelled) => End::Cancelled,
                _ => End::Failed(failure),
            },
            // The last answers of all.
            end => match unwritten.take() {
                Some(error) => End::Failed(OracleError::Log(error).into()),
                None => end,
            },
        };
        Asked {
            learned: rules,
            examples,
            questions,
        }
    }
}

/// Returns the position of a reason in [`REASONS`].
fn position(reason: &Reason) -> usize {
    match reason {
        Reason::Smallest(_) => 0,
        Reason::Extended(_) => 1,
        Reason::Without(..) => 2,
        Reason::Bisect => 3,
        Reason::Shrink => 4,
        Reason::Explore => 5,
        Reason::Sweep => 6,
        Reason::Repeat => 7,
    }
}

/// Rules learned by questions.
#[derive(Debug)]
pub struct Asked {
    /// The rules.
    pub learned: LearnedRules,
    /// The examples known at the beginning, and the answers from which the rules were learned.
    pub examples: Examples,
    /// The questions and their end.
    pub questions: Questions,
}

/// Questions, and why they ended.
#[derive(Debug)]
pub struct Questions {
    oracle: String,
    /// Number of examples known at the beginning.
    begin: u64,
    by_reason: [usize; REASONS.len()],
    agreements: usize,
    variables: usize,
    /// Number of random scenes at the end of the questions before the sweep.
    last_explored: usize,
    log: Vec<Answer>,
    end: End,
}

impl Questions {
    fn count(&mut self, answer: &Answer) {
        self.by_reason[position(&answer.reason)] += 1;
        match answer.reason {
            Reason::Explore => self.last_explored += 1,
            Reason::Sweep | Reason::Repeat => {}
            _ => self.last_explored = 0,
        }
    }

    /// Returns why the questions ended.
    pub fn end(&self) -> &End {
        &self.end
    }

    /// Returns the number of questions, those that an earlier run asked included.
    pub fn asked(&self) -> usize {
        self.log.len()
    }

    /// Names the examples that are answers.
    pub fn name_answers(&self, examples: &Examples, origin: &mut Origin) {
        let mut numbers: HashMap<State, usize> = HashMap::new();
        for (at, answer) in self.log.iter().enumerate() {
            numbers
                .entry(answer.state.clone().sorted(examples.vocabulary()))
                .or_insert(at + 1);
        }
        let mut answers: Vec<(u64, usize)> = Vec::new();
        for (state, tallies) in examples.states() {
            let first = tallies.iter().filter(|tally| tally.count > 0).map(|tally| tally.first);
            let number = numbers.get(state).copied();
            answers.extend(first.filter(|first| *first >= self.begin).zip(number));
        }
        answers.sort_unstable();
        for (first, number) in answers {
            origin.push(first, format!("question {number}"));
        }
    }

    /// Returns the names of the reasons with the number of their questions.
    fn reasons(&self) -> impl Iterator<Item = (&'static str, usize)> {
        let reasons = REASONS.into_iter().zip(self.by_reason);
        reasons.filter(|(_, count)| *count > 0)
    }

    /// Returns sentences about the questions and what they prove.
    pub fn lines(&self) -> Vec<String> {
        let by_reason: Vec<String> = self.reasons().map(|(name, count)| format!("{name} {count}")).collect();
        let by_reason = match by_reason.is_empty() {
            true => String::new(),
            false => format!(" ({})", by_reason.join(", ")),
        };
        let count = self.asked();
        let word = if count == 1 { "question" } else { "questions" };
        vec![format!("{count} {word} to {}{by_reason}.", self.oracle), self.result()]
    }

    /// Returns a sentence about what the questions prove.
    fn result(&self) -> String {
        match &self.end {
            End::Certified(bound, scenes) => {
                let facts = plural(bound.facts as u64, "fact", "facts");
                let entities = plural(bound.entities as u64, "entity", "entities");
                let all = match scenes {
                    1 => "the only scene".to_owned(),
                    scenes => format!("all {scenes} scenes"),
                };
                format!(
                    "Certificate: the rules agree with the oracle on {all} of at most {facts} and {entities}. Scenes \
                     that differ in the names of entities count once; facts that follow from others and facts of \
                     `.covering` predicates do not count."
                )
            }
            End::Agreed if self.last_explored >= self.agreements => format!(
                "The rules agreed with the oracle on {} random scenes in a row, which is not a proof.",
                self.agreements
            ),
            End::Agreed => "The rules agree with the oracle on every random scene that could be drawn, which is no \
                            proof."
                .to_owned(),
            End::Limit => "The limit of questions was reached: the rules may differ from the oracle.".to_owned(),
            End::Cancelled => "The questions were interrupted: the rules may differ from the oracle.".to_owned(),
            End::Contradiction { .. } => {
                "The oracle contradicts itself: the rules may differ from its answers.".to_owned()
            }
            End::DeniedExample { .. } => {
                "The oracle contradicts an example: the rules may differ from its answers.".to_owned()
            }
            End::Inseparable { .. } => format!(
                "No clauses of at most {} variables agree with all answers: the rules differ from the oracle.",
                self.variables
            ),
            End::Failed(_) | End::UnknownAction(_) => {
                "The oracle failed: the rules may differ from its answers.".to_owned()
            }
        }
    }

    /// Returns the number of the first question about a state that has this answer, or of the last one.
    fn number(&self, state: &State, action: usize, is_last: bool) -> usize {
        let is_it = |answer: &Answer| answer.state == *state && answer.action == action;
        let found = match is_last {
            true => self.log.iter().rposition(is_it),
            false => self.log.iter().position(is_it),
        };
        found.map_or(self.asked(), |at| at + 1)
    }

    /// Checks that nothing but the limits ended the questions. `examples` are those of the result, which `origin`
    /// names.
    ///
    /// # Errors
    /// The interrupt or the fault of the oracle that ended them.
    pub fn check(&self, task: &InductionTask, examples: &Examples, origin: &Origin) -> Result<(), OracleError> {
        let named = |actions: &[usize; 2]| actions.map(|action| task.actions()[action].name());
        let scene = |state: &State| format!("the scene: {}", task.scene(state));
        let fault = match &self.end {
            End::Agreed | End::Certified(..) | End::Limit => return Ok(()),
            End::Cancelled => return Err(OracleError::Cancelled),
            End::Failed(failure) => {
                let before = self.asked() + 1;
                return Err(match failure.downcast_ref() {
                    Some(OracleError::Invalid(fault)) => OracleError::Invalid(
                        fault
                            .as_ref()
                            .clone()
                            .note(format!("in the answer to question {before}"))
                            .into(),
                    ),
                    Some(OracleError::Log(error)) => OracleError::Log(io::Error::new(error.kind(), error.to_string())),
                    Some(OracleError::Cancelled) => OracleError::Cancelled,
                    _ => OracleError::Silent(failure.to_string()),
                });
            }
            End::UnknownAction(action) => Diagnostic::new(
                codes::INVALID_ANSWER,
                format!("the oracle takes action number {action}, which does not exist"),
            ),
            End::Contradiction { state, actions } => {
                let [first, second] = named(actions);
                let [one, other] = [
                    self.number(state, actions[0], false),
                    self.number(state, actions[1], true),
                ];
                let message = format!(
                    "the oracle contradicts itself: questions {one} and {other} are about the same scene, but have the \
                     answers {first} and {second}"
                );
                Diagnostic::new(codes::CONTRADICTING_EXAMPLES, message)
                    .note(scene(state))
                    .help("correct the oracle and begin with a new log")
            }
            End::DeniedExample { state, actions } => {
                let [first, second] = named(actions);
                let vocabulary = examples.vocabulary();
                let example = (examples.states())
                    .find(|(known, _)| canonical(vocabulary, known) == *state)
                    .and_then(|(_, tallies)| tallies.get(actions[0]))
                    .map_or_else(|| "an example".to_owned(), |tally| origin.describe(tally.first));
                let number = self.number(state, actions[1], true);
                let message = format!(
                    "the oracle contradicts an example: {example} has the action {first}, but question {number}, about \
                     the same scene, the answer {second}"
                );
                Diagnostic::new(codes::CONTRADICTING_EXAMPLES, message)
                    .note(scene(state))
                    .help("correct the example or the oracle, and begin with a new log")
            }
            End::Inseparable { state, action } => {
                let name = task.actions()[*action].name();
                let number = self.number(state, *action, false);
                let (all, check) = match self.begin {
                    0 => ("answers", "the answers of the oracle"),
                    _ => ("examples and answers", "the examples and the answers of the oracle"),
                };
                let message = format!(
                    "no clauses of at most {} variables agree with all {all}, for example with {name}, the answer to \
                     question {number}",
                    self.variables
                );
                Diagnostic::new(codes::INSEPARABLE_ANSWERS, message)
                    .note(scene(state))
                    .help(format!("permit more variables with `--variables`, or check {check}"))
            }
        };
        Err(OracleError::Invalid(fault.into()))
    }

    /// Returns the questions as JSON.
    pub fn json(&self) -> Value {
        let by_reason: Map<String, Value> = self
            .reasons()
            .map(|(name, count)| (name.to_owned(), count.into()))
            .collect();
        let certificate = match &self.end {
            End::Certified(bound, scenes) => {
                json!({ "facts": bound.facts, "entities": bound.entities, "scenes": scenes })
            }
            _ => Value::Null,
        };
        let end = match &self.end {
            End::Agreed => "agreed",
            End::Certified(..) => "certified",
            End::Limit => "limit",
            End::Cancelled => "interrupted",
            End::Contradiction { .. } => "contradiction",
            End::DeniedExample { .. } => "denied-example",
            End::Inseparable { .. } => "inseparable",
            End::Failed(_) | End::UnknownAction(_) => "failed",
        };
        json!({
            "oracle": self.oracle,
            "asked": self.asked(),
            "by_reason": by_reason,
            "end": end,
            "result": self.result(),
            "certificate": certificate,
        })
    }
}
