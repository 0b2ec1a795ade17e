//! The shim between Python and the `logicity` library: text in, text out. It adds no meaning of its own; `python/logicity` wraps
//! it in types.

mod env;
mod evaluate;

use logicity::config::{Scenario, load_scenario};
use logicity::diag::{Code, Diagnostic, Sources, render, to_json};
use logicity::engine::Program;
use logicity::files::{ReadError, read_or_builtin, read_text};
use logicity::rng::Seed;
use logicity::sim::{Executor, Inference};
use pyo3::exceptions::{PyFileNotFoundError, PyOSError, PyValueError};
use pyo3::prelude::*;
use std::path::{Path, PathBuf};

pyo3::create_exception!(
    _logicity,
    InputError,
    PyValueError,
    "Faulty input: arguments are the message and the diagnostics as JSON."
);

fn input_error(faults: &[Diagnostic], sources: &Sources) -> PyErr {
    InputError::new_err((render(faults, sources, false), to_json(faults, sources).to_string()))
}

fn read_rules(path: &Path) -> PyResult<String> {
    read_or_builtin(path).map_err(|error| {
        let message = format!("cannot read `{}`: {error}", path.display());
        match error {
            ReadError::NotFound => PyFileNotFoundError::new_err(message),
            ReadError::NotText { .. } => input_error(&[Diagnostic::new(Code::NotText, message)], &Sources::new()),
            ReadError::TooLarge | ReadError::Io(_) => PyOSError::new_err(message),
        }
    })
}

/// The diagnostics of a rule text, as a JSON array.
#[pyfunction]
fn check(text: &str, name: &str) -> String {
    let mut sources = Sources::new();
    let entry = sources.add(name, text);
    let (_, diagnostics) = Program::load(&mut sources, entry, &read_or_builtin);
    to_json(&diagnostics, &sources).to_string()
}

/// The file that stands for a configuration with something changed.
const OVERRIDES: &str = "<overrides>";

/// A configuration and its rules, or those of `rules`. `overrides` is a mapping as JSON that the configuration is the base of.
fn load(config: &Path, rules: Option<PathBuf>, overrides: Option<&str>) -> PyResult<(Scenario, Program, Sources)> {
    let mut sources = Sources::new();
    let read = |path: &Path| match overrides {
        Some(text) if path == Path::new(OVERRIDES) => Ok(text.to_owned()),
        _ => read_text(path),
    };
    let entry = if overrides.is_some() {
        Path::new(OVERRIDES)
    } else {
        config
    };
    let scenario = load_scenario(&mut sources, entry, &read).map_err(|faults| match faults.as_slice() {
        // The file named by the caller: it has no place in any text.
        [fault] if fault.code == Code::MissingFile && fault.primary.is_none() => {
            let help = fault.help.iter().map(|help| format!("; {help}"));
            PyFileNotFoundError::new_err(fault.message.clone() + &help.collect::<String>())
        }
        _ => input_error(&faults, &sources),
    })?;
    let rules = rules.unwrap_or_else(|| scenario.rules.value.clone());
    let entry = sources.add(rules.display().to_string(), read_rules(&rules)?);
    let (program, diagnostics) = Program::load(&mut sources, entry, &read_or_builtin);
    let program = program.ok_or_else(|| input_error(&diagnostics, &sources))?;
    Ok((scenario, program, sources))
}

/// Answers scenes.
#[pyclass(name = "Inference")]
struct PyInference(Inference);

#[pymethods]
impl PyInference {
    #[new]
    fn new(config: PathBuf, rules: Option<PathBuf>, seed: u64) -> PyResult<Self> {
        let (scenario, program, sources) = load(&config, rules, None)?;
        let inference = Inference::new(scenario, program, Seed(seed), Executor::Auto, read_text)
            .map_err(|faults| input_error(&faults, &sources))?;
        Ok(PyInference(inference))
    }

    /// The answer to a scene, both as JSON.
    fn answer(&mut self, scene: &str) -> PyResult<String> {
        let mut sources = Sources::new();
        let source = sources.add("<scene>", scene);
        match self.0.answer(&sources, source) {
            Ok(answer) => Ok(answer.to_json().to_string()),
            Err(faults) => Err(input_error(&faults, &sources)),
        }
    }
}

#[pymodule]
fn _logicity(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add("InputError", module.py().get_type::<InputError>())?;
    module.add_function(wrap_pyfunction!(check, module)?)?;
    module.add_class::<PyInference>()?;
    module.add_class::<env::PyTask>()?;
    module.add_class::<env::PyEnvironments>()?;
    module.add_class::<env::PyCars>()?;
    module.add_class::<evaluate::PyBaseline>()?;
    module.add_class::<evaluate::PyExam>()?;
    module.add_function(wrap_pyfunction!(evaluate::describe, module)?)
}
