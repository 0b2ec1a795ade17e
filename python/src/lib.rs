//! The shim between Python and the `logicity` library. It adds no meaning of its own; `python/logicity` wraps it in types and
//! documents it.
//!
//! This file has what all parts need: exceptions, and objects that long work is done on ([`Shared`]). `engine` has programs and
//! sessions, `columns` their rows as Python values and numpy arrays, `city` scenes and simulations, `env` environments, `evaluate` how
//! well policies drive. Each part registers its own classes.

mod city;
mod columns;
mod engine;
mod env;
mod evaluate;

use logicity::diag::{Code, Diagnostic, Sources, render, to_json};
use logicity::files::{ReadError, read_or_builtin};
use pyo3::exceptions::{PyFileNotFoundError, PyOSError, PyRuntimeError};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};
use std::any::Any;
use std::cell::{Cell, RefCell};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, TryLockError};
use std::time::{Duration, Instant};

pyo3::import_exception!(logicity.errors, InputError);
pyo3::import_exception!(logicity.errors, LimitError);

/// The exception for faults of the input: drawn, and as data.
fn input_error(py: Python<'_>, faults: &[Diagnostic], sources: &Sources) -> PyErr {
    let arguments = match to_python(py, &to_json(faults, sources)) {
        Ok(diagnostics) => (render(faults, sources, false), diagnostics.unbind()),
        Err(error) => return error,
    };
    match faults.iter().any(|fault| fault.code == Code::LimitExceeded) {
        true => LimitError::new_err(arguments),
        false => InputError::new_err(arguments),
    }
}

/// The exception for a file named by the caller that cannot be read.
fn read_error(py: Python<'_>, path: &Path, error: &ReadError) -> PyErr {
    let message = format!("cannot read `{}`: {error}", path.display());
    match error {
        ReadError::NotFound => PyFileNotFoundError::new_err(message),
        ReadError::NotText { .. } => input_error(py, &[Diagnostic::new(Code::NotText, message)], &Sources::new()),
        ReadError::TooLarge | ReadError::Io(_) => PyOSError::new_err(message),
    }
}

/// The text of a file, on disk or built in.
#[pyfunction]
fn read_file(py: Python<'_>, path: PathBuf) -> PyResult<String> {
    read_or_builtin(&path).map_err(|error| read_error(py, &path, &error))
}

/// JSON as Python has it.
fn to_python<'py>(py: Python<'py>, value: &serde_json::Value) -> PyResult<Bound<'py, PyAny>> {
    use serde_json::Value;
    Ok(match value {
        Value::Null => py.None().into_bound(py),
        Value::Bool(value) => value.into_pyobject(py)?.to_owned().into_any(),
        Value::Number(number) => match (number.as_i64(), number.as_u64()) {
            (Some(number), _) => number.into_pyobject(py)?.into_any(),
            (None, Some(number)) => number.into_pyobject(py)?.into_any(),
            (None, None) => number.as_f64().into_pyobject(py)?,
        },
        Value::String(text) => text.into_pyobject(py)?.into_any(),
        Value::Array(values) => {
            let values: PyResult<Vec<_>> = values.iter().map(|value| to_python(py, value)).collect();
            PyList::new(py, values?)?.into_any()
        }
        Value::Object(entries) => {
            let dict = PyDict::new(py);
            for (key, value) in entries {
                dict.set_item(key, to_python(py, value)?)?;
            }
            dict.into_any()
        }
    })
}

/// Looks for signals, such as Ctrl-C, while Rust works.
struct Signals {
    looked: Cell<Instant>,
    raised: RefCell<Option<PyErr>>,
}

impl Signals {
    /// So often.
    const PAUSE: Duration = Duration::from_millis(50);

    fn new() -> Self {
        Signals {
            looked: Cell::new(Instant::now()),
            raised: RefCell::new(None),
        }
    }

    /// Whether a handler has raised an exception. Cheap, and made to be asked often. Handlers run on the main thread only, so
    /// elsewhere nothing is ever raised.
    fn raised(&self) -> bool {
        if self.looked.get().elapsed() >= Self::PAUSE {
            self.looked.set(Instant::now());
            if let Err(error) = Python::attach(|py| py.check_signals()) {
                self.raised.borrow_mut().get_or_insert(error);
            }
        }
        self.raised.borrow().is_some()
    }
}

/// What a Python object holds, for one thread at a time: who comes second is told so instead of being made to wait, since
/// waiting for oneself, in a handler of a signal for example, would never end.
struct Shared<T> {
    what: &'static str,
    /// `None` after an internal error, which may have left it unfinished.
    content: Mutex<Option<T>>,
}

impl<T: Send> Shared<T> {
    fn new(what: &'static str, content: T) -> Self {
        Shared {
            what,
            content: Mutex::new(Some(content)),
        }
    }

    fn lock(&self) -> PyResult<MutexGuard<'_, Option<T>>> {
        let guard = match self.content.try_lock() {
            Ok(guard) => guard,
            Err(TryLockError::Poisoned(guard)) => guard.into_inner(),
            Err(TryLockError::WouldBlock) => {
                let what = self.what;
                return Err(PyRuntimeError::new_err(format!(
                    "this {what} is at work in another thread; give each thread a {what} of its own, or guard it by a lock"
                )));
            }
        };
        match guard.is_some() {
            true => Ok(guard),
            false => Err(PyRuntimeError::new_err(format!(
                "an internal error has left this {} unfinished; make another",
                self.what
            ))),
        }
    }

    /// Short work, for which other threads of Python wait.
    fn with<R>(&self, work: impl FnOnce(&mut T) -> PyResult<R>) -> PyResult<R> {
        match &mut *self.lock()? {
            Some(content) => work(content),
            None => unreachable!("`lock` has looked"),
        }
    }

    /// Long work, beside other threads of Python. It is given up when it finds that a signal's handler has raised an exception,
    /// which is then raised here.
    fn detached<R: Send>(&self, py: Python<'_>, work: impl FnOnce(&mut T, &Signals) -> R + Send) -> PyResult<R> {
        let mut guard = self.lock()?;
        let content = &mut *guard;
        let result = py.detach(|| {
            let signals = Signals::new();
            let work = || content.as_mut().map(|content| work(content, &signals));
            let result = catch_unwind(AssertUnwindSafe(work));
            if result.is_err() {
                *content = None;
            }
            (result, signals.raised.into_inner())
        });
        match result {
            (Err(panic), _) => Err(internal_error(&*panic)),
            (Ok(_), Some(raised)) => Err(raised),
            (Ok(Some(result)), None) => Ok(result),
            (Ok(None), None) => unreachable!("`lock` has looked"),
        }
    }
}

/// A fault of ours, told instead of ending the process.
fn internal_error(panic: &(dyn Any + Send)) -> PyErr {
    let message =
        (panic.downcast_ref::<String>().map(String::as_str)).or_else(|| panic.downcast_ref::<&str>().copied());
    PyRuntimeError::new_err(format!(
        "internal error, please report it: {}",
        message.unwrap_or("unknown")
    ))
}

/// The known name most like another, if one is likely to have been meant.
#[pyfunction]
fn did_you_mean(name: &str, known: Vec<String>) -> Option<String> {
    logicity::diag::did_you_mean(name, known.iter().map(String::as_str)).map(str::to_owned)
}

#[pymodule]
fn _logicity(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add_function(wrap_pyfunction!(did_you_mean, module)?)?;
    module.add_function(wrap_pyfunction!(read_file, module)?)?;
    engine::register(module)?;
    city::register(module)?;
    env::register(module)?;
    evaluate::register(module)
}
