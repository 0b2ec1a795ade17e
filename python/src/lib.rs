//! The shim between Python and the `logicity` library. It adds no meaning of its own; `python/logicity` wraps it in types and
//! documents it.
//!
//! This file has what all parts need: exceptions, and objects that long work is done on ([`Shared`]). `engine` has programs and
//! sessions, `columns` their rows as Python values and numpy arrays, `city` scenes and simulations, `config` files that Python interprets, `task` what is to be driven, `episode` how
//! it begins, `env` one car that is driven or many of them in one call, `multi_car` every car of a city, `evaluate` how well policies drive, `vap` data
//! sets of pictures and what is true in them. Each part registers its own classes.

mod city;
mod columns;
mod config;
mod engine;
mod env;
mod episode;
mod evaluate;
mod multi_car;
mod task;
mod vap;

use logicity::builtin::read_or_builtin;
use logicity::cli::{Outcome, PYTHON_COMMANDS, run_with_python};
use logicity::diag::{Code, Diagnostic, Sources, render, to_json};
use logicity::files::ReadError;
use logicity::sim::Stop;
use numpy::ndarray::Dimension;
use numpy::{Element, PyReadwriteArray};
use pyo3::PyClass;
use pyo3::exceptions::{PyFileNotFoundError, PyKeyboardInterrupt, PyOSError, PyRuntimeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};
use std::any::Any;
use std::ffi::OsString;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, TryLockError};
use std::thread::{self, ThreadId};
use std::time::{Duration, Instant};

pyo3::import_exception!(logicity.errors, InputError);
pyo3::import_exception!(logicity.errors, LimitError);
pyo3::import_exception!(logicity.errors, UnsupportedError);

/// The exception for diagnostics, which it holds as text and as data.
fn input_error(py: Python<'_>, faults: &[Diagnostic], sources: &Sources) -> PyErr {
    let has = |code| faults.iter().any(|fault| fault.code == code);
    if has(Code::CANCELLED) {
        return PyKeyboardInterrupt::new_err(());
    }
    let arguments = match to_python(py, &to_json(faults, sources)) {
        Ok(diagnostics) => (render(faults, sources, false), diagnostics.unbind()),
        Err(error) => return error,
    };
    if has(Code::LIMIT_EXCEEDED) {
        LimitError::new_err(arguments)
    } else if has(Code::DENSE_UNSUPPORTED) {
        UnsupportedError::new_err(arguments)
    } else {
        InputError::new_err(arguments)
    }
}

/// The commands that Python implements: their words and summaries.
#[pyfunction]
fn python_commands() -> Vec<(Vec<&'static str>, &'static str)> {
    (PYTHON_COMMANDS.iter())
        .map(|(words, summary)| (words.to_vec(), *summary))
        .collect()
}

/// Runs a command line, without the name of the program. Returns the exit code, or the words and the remaining arguments of a command
/// that Python implements. Other Python threads run meanwhile; Python's handlers of signals do not.
#[pyfunction]
fn run_command_line(py: Python<'_>, arguments: Vec<OsString>) -> (i32, Vec<&'static str>, Vec<OsString>) {
    // The panic hook has printed the panic; 101 is the exit code of a Rust program that panics.
    match py.detach(|| catch_unwind(|| run_with_python(&arguments))) {
        Ok(Outcome::Exit(code)) => (i32::from(code), Vec::new(), Vec::new()),
        Ok(Outcome::Python(words, rest)) => (0, words.to_vec(), rest),
        Err(_) => (101, Vec::new(), Vec::new()),
    }
}

/// The exception for a file named by the caller that cannot be read.
fn read_error(py: Python<'_>, path: &Path, error: &ReadError) -> PyErr {
    let message = format!("cannot read `{}`: {error}", path.display());
    match error {
        ReadError::NotFound => PyFileNotFoundError::new_err(message),
        ReadError::NotText { .. } => input_error(py, &[Diagnostic::new(Code::NOT_TEXT, message)], &Sources::new()),
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

/// The numbers of an array that is to be written into, which must be as many as are wanted and lie side by side.
fn slice_of<'a, T: Element, D: Dimension>(
    array: &'a mut PyReadwriteArray<'_, T, D>,
    wanted: usize,
) -> PyResult<&'a mut [T]> {
    let slice = array
        .as_slice_mut()
        .map_err(|error| PyValueError::new_err(error.to_string()))?;
    match slice.len() == wanted {
        true => Ok(slice),
        false => Err(PyValueError::new_err(format!(
            "room for {} numbers, not {wanted}",
            slice.len()
        ))),
    }
}

/// Looks for signals, such as Ctrl-C, while Rust works.
pub struct Signals {
    /// The thread that called from Python, and when it looked last.
    looked: Mutex<(ThreadId, Instant)>,
    raised: AtomicBool,
    error: Mutex<Option<PyErr>>,
}

impl Signals {
    /// So often.
    const PAUSE: Duration = Duration::from_millis(50);
    /// What threads that load have for their stack, as much as main threads usually have.
    const STACK: usize = 8 << 20;

    fn new() -> Arc<Signals> {
        Arc::new(Signals {
            looked: Mutex::new((thread::current().id(), Instant::now())),
            raised: AtomicBool::new(false),
            error: Mutex::new(None),
        })
    }

    /// Whether a handler has raised an exception. Cheap, and made to be asked often. Handlers run on the main thread of Python only, so
    /// the one that called looks for all that help it, and where another one calls nothing is ever raised.
    fn raised(&self) -> bool {
        if self.raised.load(Ordering::Relaxed) {
            return true;
        }
        let Ok(mut looked) = self.looked.try_lock() else {
            return false;
        };
        if looked.1.elapsed() < Self::PAUSE || looked.0 != thread::current().id() {
            return false;
        }
        looked.1 = Instant::now();
        drop(looked);
        if let Err(error) = Python::attach(|py| py.check_signals()) {
            held(&self.error).get_or_insert(error);
            self.raised.store(true, Ordering::Relaxed);
        }
        self.raised.load(Ordering::Relaxed)
    }

    /// The same as a question that can be kept.
    fn stop(self: &Arc<Self>) -> Stop {
        let signals = Arc::clone(self);
        Arc::new(move || signals.raised())
    }

    /// Work that asks now and then whether a signal's handler has raised an exception, and is given up then; the exception is raised here.
    fn heed<R>(&self, work: impl FnOnce() -> R) -> PyResult<R> {
        held(&self.looked).0 = thread::current().id();
        let done = work();
        match self.raised.swap(false, Ordering::Relaxed) {
            true => Err(held(&self.error).take().expect("it is kept before it is told")),
            false => Ok(done),
        }
    }

    /// The same beside other threads of Python.
    fn detach<R: Send>(&self, py: Python<'_>, work: impl FnOnce() -> R + Send) -> PyResult<R> {
        self.heed(|| py.detach(work))
    }

    /// The same for work that does not ask, on a thread of its own. If it is given up, it goes on there to its end, and nobody hears of it.
    fn aside<R: Send + 'static>(&self, py: Python<'_>, work: impl FnOnce() -> R + Send + 'static) -> PyResult<R> {
        let (done, result) = mpsc::channel();
        let work = move || drop(done.send(catch_unwind(AssertUnwindSafe(work))));
        let thread = thread::Builder::new().stack_size(Self::STACK).spawn(work);
        thread.map_err(|error| PyOSError::new_err(format!("a thread cannot be started: {error}")))?;
        let told = self.detach(py, move || {
            loop {
                match result.recv_timeout(Self::PAUSE) {
                    Err(RecvTimeoutError::Timeout) if !self.raised() => {}
                    told => break told,
                }
            }
        })?;
        let done = told.expect("it tells unless it is given up");
        done.map_err(|panic| internal_error(&*panic))
    }
}

/// What a mutex holds, whatever became of those who held it before.
fn held<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// What a Python object holds, for one thread at a time: who comes second is told so instead of being made to wait, since
/// waiting for oneself, in a handler of a signal for example, would never end.
struct Shared<T> {
    what: &'static str,
    /// `None` after an internal error, which may have left it unfinished.
    content: Mutex<Option<T>>,
    signals: Arc<Signals>,
}

impl<T: Send> Shared<T> {
    fn new(what: &'static str, content: T) -> Self {
        Shared::asking(what, content, Signals::new())
    }

    /// Of something that keeps the question of these signals.
    fn asking(what: &'static str, content: T, signals: Arc<Signals>) -> Self {
        Shared {
            what,
            content: Mutex::new(Some(content)),
            signals,
        }
    }

    fn lock(&self) -> PyResult<MutexGuard<'_, Option<T>>> {
        let guard = match self.content.try_lock() {
            Ok(guard) => guard,
            Err(TryLockError::Poisoned(guard)) => guard.into_inner(),
            Err(TryLockError::WouldBlock) => {
                return Err(at_work(self.what));
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
        let signals = &*self.signals;
        let result = signals.detach(py, || {
            let work = || content.as_mut().map(|content| work(content, signals));
            let result = catch_unwind(AssertUnwindSafe(work));
            if result.is_err() {
                *content = None;
            }
            result
        })?;
        match result {
            Err(panic) => Err(internal_error(&*panic)),
            Ok(Some(result)) => Ok(result),
            Ok(None) => unreachable!("`lock` has looked"),
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

/// An environment, for one thread at a time: who comes second is told so.
fn borrowed<'py, T: PyClass>(environment: &Bound<'py, T>) -> PyResult<PyRef<'py, T>> {
    environment.try_borrow().map_err(|_| at_work("environment"))
}

/// The same, to change it.
fn borrowed_mut<'py, T: PyClass<Frozen = pyo3::pyclass::boolean_struct::False>>(
    environment: &Bound<'py, T>,
) -> PyResult<PyRefMut<'py, T>> {
    environment.try_borrow_mut().map_err(|_| at_work("environment"))
}

fn at_work(what: &str) -> PyErr {
    PyRuntimeError::new_err(format!(
        "this {what} is at work in another thread; give each thread one of its own, or guard it by a lock"
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
    module.add_function(wrap_pyfunction!(python_commands, module)?)?;
    module.add_function(wrap_pyfunction!(run_command_line, module)?)?;
    config::register(module)?;
    engine::register(module)?;
    city::register(module)?;
    task::register(module)?;
    env::register(module)?;
    multi_car::register(module)?;
    evaluate::register(module)?;
    vap::register(module)
}
