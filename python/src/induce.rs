//! Rules learned from demonstrations.

use crate::city::one_of;
use crate::task::PyTask;
use crate::{Signals, input_error, read_error, threads_of, to_python};
use logicity::city::Action;
use logicity::datalog::Limits;
use logicity::diag::codes;
use logicity::diag::{Diagnostic, Sources};
use logicity::files::{self, Journal, ReadError, read_whole};
use logicity::induce::ask::Bound as SweepBound;
use logicity::induce::{
    ActionRules, Atom, Body, Examples, LearnedClause, LearnedRules, Literal, NOISE_MAX, Noise, Settings, State,
    VARIABLES_MAX, learn_with, support,
};
use logicity::rng::Seed;
use logicity::sim::{Executor, Inference, hash_sources};
use logicity::task::induction::{
    Asked, InductionTask, Inquiry, LogError, OracleError, Origin, RuleOracle, Steps, report_json, rule_file,
};
use numpy::ndarray::Array2;
use numpy::{IntoPyArray, PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::exceptions::{PyKeyboardInterrupt, PyOSError, PyTypeError, PyValueError};
use pyo3::prelude::*;
use std::path::{Path, PathBuf};
use std::sync::Arc;

pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("NOISE_MAX", NOISE_MAX)?;
    module.add("VARIABLES_MAX", VARIABLES_MAX)?;
    module.add_class::<PyLearnedRules>()?;
    module.add_function(wrap_pyfunction!(restore_rules, module)?)?;
    module.add_function(wrap_pyfunction!(read_steps, module)?)?;
    module.add_function(wrap_pyfunction!(induce, module)?)
}

/// Learned rules. They decide on observations without an engine.
#[pyclass(name = "LearnedRules", module = "logicity._logicity", frozen)]
struct PyLearnedRules {
    /// The task of environments, for copies.
    shared: Py<PyTask>,
    task: Arc<InductionTask>,
    learned: LearnedRules,
    /// Number of entities in an observation, and its length.
    shape: [usize; 2],
    #[pyo3(get)]
    text: String,
    report: serde_json::Value,
}

#[pymethods]
impl PyLearnedRules {
    /// Pickles the task, the clauses and their texts, so that unpickling does not learn again.
    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> PyResult<(Bound<'py, PyAny>, Parts)> {
        let (py, rules) = (slf.py(), slf.get());
        let literal = |literal: &Literal| {
            let arguments = literal.atom.arguments.iter().map(|&variable| variable.into());
            (literal.is_negated, literal.atom.predicate, arguments.collect())
        };
        let clauses = rules.learned.actions.iter().map(|rules| {
            let bodies = rules
                .clauses
                .iter()
                .map(|clause| clause.body.0.iter().map(literal).collect());
            bodies.collect()
        });
        let order = rules.task.actions().iter().map(|action| action.name().to_owned());
        let parts = (
            rules.shared.clone_ref(py),
            order.collect(),
            clauses.collect(),
            rules.text.clone(),
            rules.report.to_string(),
        );
        let restore = py.import("logicity._logicity")?.getattr("restore_rules")?;
        Ok((restore, parts))
    }

    /// Returns the report as Python values.
    fn report<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        to_python(py, &self.report)
    }

    /// Returns the action for each observation of a batch.
    fn decide<'py>(
        &self,
        py: Python<'py>,
        observations: PyReadonlyArray2<'py, f32>,
    ) -> PyResult<Bound<'py, PyArray1<i64>>> {
        let states = states(&self.task, self.shape, &observations)?;
        let decided = py.detach(|| {
            let states: Vec<&State> = states.iter().collect();
            let chosen = self.learned.decide(self.task.vocabulary(), &states);
            chosen
                .into_iter()
                .map(|action| self.task.actions()[action].index() as i64)
                .collect::<Vec<_>>()
        });
        Ok(decided.into_pyarray(py))
    }
}

/// The bodies of the clauses of each action: whether a literal is negated, its predicate and its variables.
type Bodies = Vec<Vec<Vec<(bool, usize, Vec<usize>)>>>;

/// The parts of pickled rules: the task, the actions in order, the clauses, the text and the report.
type Parts = (Py<PyTask>, Vec<String>, Bodies, String, String);

/// Returns rules from the parts of `__reduce__`.
#[pyfunction]
fn restore_rules(
    py: Python<'_>,
    task: Py<PyTask>,
    order: Vec<String>,
    clauses: Bodies,
    text: String,
    report: &str,
) -> PyResult<PyLearnedRules> {
    let invalid = || PyValueError::new_err("these are not the parts of learned rules");
    let learning = induction_task(py, task.get(), &order)?;
    let vocabulary = learning.vocabulary();
    let mut actions = Vec::new();
    for bodies in clauses {
        let mut rules = ActionRules {
            clauses: Vec::new(),
            is_cheapest: false,
            variables_limit: None,
            uncovered: 0,
        };
        for body in bodies {
            let mut literals = Vec::new();
            for (is_negated, predicate, arguments) in body {
                let declared = vocabulary.predicates().get(predicate).ok_or_else(invalid)?;
                if declared.arity != arguments.len() || arguments.iter().any(|&variable| variable >= VARIABLES_MAX) {
                    return Err(invalid());
                }
                #[allow(clippy::cast_possible_truncation)] // less than `VARIABLES_MAX`
                let arguments = arguments.into_iter().map(|variable| variable as u8).collect();
                let atom = Atom { predicate, arguments };
                literals.push(Literal { is_negated, atom });
            }
            rules.clauses.push(LearnedClause {
                body: Body(literals),
                is_best: false,
            });
        }
        actions.push(rules);
    }
    if actions.len() + 1 != learning.actions().len() {
        return Err(invalid());
    }
    Ok(PyLearnedRules {
        shape: shape_of(task.get()),
        shared: task,
        task: learning,
        learned: LearnedRules {
            actions,
            ..LearnedRules::default()
        },
        text,
        report: serde_json::from_str(report).map_err(|_| invalid())?,
    })
}

/// Returns the task of learning, with the actions in this order.
fn induction_task(py: Python<'_>, shared: &PyTask, order: &[String]) -> PyResult<Arc<InductionTask>> {
    let order: Vec<Action> = (order.iter())
        .map(|name| one_of("order", name, &Action::STANDARD, Action::name))
        .collect::<PyResult<_>>()?;
    let world = Arc::clone(shared.task.world());
    let task = InductionTask::new(world, &order).map_err(|fault| shared.error(py, fault))?;
    Ok(Arc::new(task))
}

/// Returns the number of entities in an observation, and its length.
fn shape_of(shared: &PyTask) -> [usize; 2] {
    [shared.task.oracle().entities(), shared.task.observation_width()]
}

/// Returns the states in observations. An entity without facts is absent.
fn states(
    task: &InductionTask,
    [entities, width]: [usize; 2],
    observations: &PyReadonlyArray2<'_, f32>,
) -> PyResult<Vec<State>> {
    let array = observations.as_array();
    if array.ncols() != width {
        let message = format!("expected observations of {width} numbers, not {}", array.ncols());
        return Err(PyValueError::new_err(message));
    }
    let row = |row: numpy::ndarray::ArrayView1<'_, f32>| match row.as_slice() {
        Some(row) => task.observed_state(row, entities, None),
        None => task.observed_state(&row.to_vec(), entities, None),
    };
    Ok(array.rows().into_iter().map(row).collect())
}

/// The columns `observation`, `action`, `episode` and `step` of a table of steps.
type StepArrays<'py> = (
    Bound<'py, PyArray2<f32>>,
    Bound<'py, PyArray1<i64>>,
    Bound<'py, PyArray1<i32>>,
    Bound<'py, PyArray1<i32>>,
);

/// Reads a table of steps. Returns its mode, its split, the hash of its episodes and its atoms, and its columns.
#[pyfunction]
fn read_steps(py: Python<'_>, path: PathBuf) -> PyResult<(String, String, String, Vec<String>, StepArrays<'_>)> {
    let bytes = py
        .detach(|| files::open(&path).and_then(read_whole))
        .map_err(|error| read_error(py, &path, &error))?;
    let read = py.detach(|| {
        let steps = Steps::open(bytes)?;
        // `induce` copies the steps of all episodes into one array.
        let (needed, limit) = (steps.bytes().saturating_mul(2), Limits::default().bytes);
        let too_large = || {
            let message = format!("the steps take {} MiB; the limit is {} MiB", needed >> 20, limit >> 20);
            let fault = Diagnostic::new(codes::LIMIT_EXCEEDED, message);
            fault.help("split the table, or learn with `logicity induce`, which keeps the facts as bits")
        };
        if needed > limit {
            return Err(too_large());
        }
        let (mut observations, mut actions) = (Vec::new(), Vec::new());
        let (mut episodes, mut numbers) = (Vec::new(), Vec::new());
        (observations.try_reserve_exact(steps.count().saturating_mul(steps.atoms.len()))).map_err(|_| too_large())?;
        steps.for_each(|step| {
            observations.extend_from_slice(step.observation);
            actions.push(step.action.index() as i64);
            episodes.push(step.episode);
            numbers.push(step.step);
            Ok::<_, Diagnostic>(())
        })?;
        let shape = (actions.len(), steps.atoms.len());
        let observations = Array2::from_shape_vec(shape, observations).expect("one number for each atom");
        Ok((steps, observations, actions, episodes, numbers))
    });
    let (steps, observations, actions, episodes, numbers) = read.map_err(|fault: Diagnostic| {
        let fault = fault.note(format!("in `{}`", path.display()));
        input_error(py, &[fault], &Sources::new())
    })?;
    let Steps {
        mode,
        split,
        episodes_hash,
        atoms,
        ..
    } = steps;
    let columns = (
        observations.into_pyarray(py),
        actions.into_pyarray(py),
        episodes.into_pyarray(py),
        numbers.into_pyarray(py),
    );
    Ok((mode, split, episodes_hash, atoms, columns))
}

/// What to ask: the oracle, its identity and its name in reports, the limit of questions, the number of agreements, the
/// numbers of facts and entities of the sweep, and the log. The oracle is a task with rules, or a function from scenes
/// to names of actions.
type Asking = (
    Py<PyAny>,
    String,
    String,
    usize,
    usize,
    Option<(usize, usize)>,
    Option<PathBuf>,
);

/// Learns rules from observations and actions. `parts` are the numbers of the first examples of each episode, with its
/// name; `lines` are sentences about the source. `noise` is the share of wrong actions, NaN to estimate it.
///
/// Returns the rules and, if an oracle failed, the exception. The rules are then those learned before.
#[pyfunction]
#[pyo3(signature = (task, observations, actions, parts, lines, order, variables, effort, seed, threads, noise, ask))]
#[allow(clippy::too_many_arguments)]
fn induce(
    py: Python<'_>,
    task: &Bound<'_, PyTask>,
    observations: PyReadonlyArray2<'_, f32>,
    actions: PyReadonlyArray1<'_, i64>,
    parts: Vec<(u64, String)>,
    lines: Vec<String>,
    order: Vec<String>,
    variables: usize,
    effort: u32,
    seed: u64,
    threads: usize,
    noise: Option<f64>,
    ask: Option<Asking>,
) -> PyResult<(PyLearnedRules, Option<Py<PyAny>>)> {
    let shared = task.get();
    let shape = shape_of(shared);
    let learning = induction_task(py, shared, &order)?;
    let states = states(&learning, shape, &observations)?;
    let mut origin = Origin::default();
    origin.lines = lines;
    for (begin, name) in parts {
        origin.push_episode(begin, name);
    }
    let mut examples: Examples = learning.examples();
    for (state, &action) in states.into_iter().zip(actions.as_array()) {
        let known = usize::try_from(action)
            .ok()
            .and_then(|action| Action::STANDARD.get(action));
        let known = known.ok_or_else(|| PyValueError::new_err(format!("{action} is not an action")))?;
        let position = learning.action(*known).map_err(|fault| shared.error(py, fault))?;
        examples.push(state, position);
    }
    if noise.is_none() {
        learning
            .check(&examples, &origin)
            .map_err(|fault| shared.error(py, fault))?;
    }
    let settings = Settings {
        noise: match noise {
            None => Noise::None,
            Some(rate) if rate.is_nan() => Noise::Auto,
            Some(rate) => Noise::Rate(rate),
        },
        variables,
        nodes: effort,
        seed,
        threads: Some(threads_of(threads)?),
        ..Settings::default()
    };
    origin.lines.push(learning.describe(&settings));
    let signals = Signals::new();
    let mut failed: Option<PyErr> = None;
    let (learned, examples, questions) = match ask {
        None => {
            let cancel = signals.cancel();
            let learned = signals.detach(py, || learn_with(&examples, &settings, &|_| (), &cancel))?;
            (learned, examples, None)
        }
        Some(asking) => {
            let inquiry = Inquiry::new(examples, settings, seed);
            let (asked, error) = ask_oracle(py, &learning, inquiry, asking, &signals)?;
            asked.questions.name_answers(&asked.examples, &mut origin);
            origin.lines.extend(asked.questions.lines());
            failed = error.or_else(|| fault(py, shared, &learning, &asked, &origin));
            (asked.learned, asked.examples, Some(asked.questions))
        }
    };
    let support = py.detach(|| support(&examples, &learned, &learning.constraints()));
    let (sources, rule_files) = shared.rule_texts();
    let mut report = report_json(&learning, &learned, &support, &origin);
    if let Some(questions) = &questions {
        report["questions"] = questions.json();
    }
    let rules = PyLearnedRules {
        shared: task.clone().unbind(),
        text: rule_file(&learning, &learned, &support, &origin, (&sources, rule_files)),
        report,
        learned,
        task: learning,
        shape,
    };
    Ok((rules, failed.map(|error| error.into_value(py).into_any())))
}

/// Learns from questions. Returns the exception that the oracle, or a signal handler, raised.
fn ask_oracle(
    py: Python<'_>,
    task: &InductionTask,
    mut inquiry: Inquiry,
    (oracle, identity, name, questions, agreements, sweep, log): Asking,
    signals: &Arc<Signals>,
) -> PyResult<(Asked, Option<PyErr>)> {
    inquiry.oracle = name;
    inquiry.asking.questions = questions;
    inquiry.asking.agreements = agreements;
    inquiry.asking.sweep = sweep.map(|(facts, entities)| SweepBound { facts, entities });
    let rules = match oracle.bind(py).cast::<PyTask>() {
        Ok(hidden) => Some(rule_oracle(py, hidden.get(), task)?),
        Err(_) => None,
    };
    let identity = match &rules {
        Some((_, hash)) => format!("rules {}", hash.chars().take(12).collect::<String>()),
        None => identity,
    };
    let mut log = match log {
        Some(path) => {
            let unusable = |error| log_error(py, error, &path);
            let mut log = Journal::open(&path).map_err(|error| unusable(LogError::Io(error)))?;
            inquiry.answers =
                (task.resume(&inquiry, &identity, &mut log, &path.display().to_string())).map_err(unusable)?;
            Some(log)
        }
        None => None,
    };
    let cancel = signals.cancel();
    let mut raised: Option<PyErr> = None;
    let mut asked: Option<Asked> = None;
    let ended = signals.detach(py, || {
        let mut answer = |state: &State| match &rules {
            Some((rules, _)) => rules.action(state, &cancel),
            None => {
                let called = Python::attach(|py| call(py, &oracle, task, state));
                let action = called.map_err(|error| {
                    raised = Some(error);
                    OracleError::Silent("the function raised an exception".to_owned())
                })?;
                task.answered_action(action)
            }
        };
        asked = Some(task.ask(inquiry, &mut answer, log.as_mut(), &mut |_| {}, &cancel));
    });
    let asked = asked.expect("`detach` runs the work");
    let error = raised.or(ended.err());
    Ok((asked, error))
}

/// Returns the oracle that follows the rules of a task, and their hash.
fn rule_oracle<'a>(py: Python<'_>, hidden: &PyTask, task: &'a InductionTask) -> PyResult<(RuleOracle<'a>, String)> {
    let world = hidden.task.world();
    let (sources, rule_files) = hidden.rule_texts();
    let no_maps = |_: &Path| Err(ReadError::NotFound);
    let (scenario, program) = (world.scenario.clone(), world.program.clone());
    let inference = Inference::new(scenario, program, Seed(0), Executor::Auto, no_maps);
    let mut inference = inference.map_err(|faults| input_error(py, &faults, &sources))?;
    inference.set_limits(world.limits);
    inference.name_clauses(&sources);
    let oracle = RuleOracle::new(task, inference).map_err(|fault| hidden.error(py, fault))?;
    Ok((oracle, hash_sources(&sources, rule_files)))
}

/// Calls a function with a scene and returns the action that it names.
fn call(py: Python<'_>, oracle: &Py<PyAny>, task: &InductionTask, state: &State) -> PyResult<Action> {
    let answer = oracle.bind(py).call1((to_python(py, &task.scene(state))?,))?;
    let name: String = answer.extract().map_err(|_| {
        let kind = answer
            .get_type()
            .name()
            .map_or_else(|_| "it".to_owned(), |name| name.to_string());
        PyTypeError::new_err(format!(
            "ask: expected a function that returns the name of an action, not {kind}"
        ))
    })?;
    one_of("the answer to a question", &name, &Action::STANDARD, Action::name)
}

/// Returns the exception for an oracle that failed.
fn fault(py: Python<'_>, shared: &PyTask, task: &InductionTask, asked: &Asked, origin: &Origin) -> Option<PyErr> {
    let error = asked.questions.check(task, &asked.examples, origin).err()?;
    Some(match error {
        OracleError::Invalid(fault) => shared.error(py, *fault),
        OracleError::Log(_) => PyOSError::new_err(error.to_string()),
        OracleError::Silent(text) => PyOSError::new_err(text),
        OracleError::Cancelled => PyKeyboardInterrupt::new_err(()),
    })
}

/// Returns the exception for a log that cannot be continued.
fn log_error(py: Python<'_>, error: LogError, path: &Path) -> PyErr {
    let path = path.display();
    match error {
        LogError::Other(what) => PyValueError::new_err(format!("log: `{path}` {what}; choose another file")),
        LogError::Faults(faults, sources) => input_error(py, &faults, &sources),
        LogError::Io(error) => PyOSError::new_err(format!("cannot use `{path}` as a log: {error}")),
    }
}
