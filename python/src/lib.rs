//! Python bindings of the `logicity` library. The package `python/logicity` wraps, types and documents them.
//!
//! This file has the exceptions, the command line, and [`Shared`], the wrapper of objects with long-running calls. Each
//! other module registers its classes:
//!
//! - `engine`: programs and sessions; `columns`: rows as Python values and numpy arrays; `arrow`: rows as data frames;
//! - `checked`: checked rules for Python code that evaluates them;
//! - `circuits`: exact probabilities of decisions, with gradients;
//! - `city`: scenes and simulations; `config`: configuration files that Python interprets;
//! - `task`: the task of environments; `episode`: the start of an episode; `env`: environments with one or several
//!   controlled cars; `actor`: networks that run in environments; `evaluate`: metrics of policies;
//! - `induce`: rules learned from demonstrations;
//! - `predicate`: base predicates that Python functions compute;
//! - `vap`: data sets of Visual Action Prediction.
// Decision: docs/decisions/tools.md#d028

mod actor;
mod arrow;
mod checked;
mod circuits;
mod city;
mod columns;
mod config;
mod engine;
mod env;
mod episode;
mod evaluate;
mod induce;
mod output;
mod policy;
mod predicate;
mod task;
mod vap;

use logicity::builtin::{self, BuiltinFiles};
use logicity::cancel::Cancel;
use logicity::cli::{Outcome, PYTHON_COMMANDS, run_with_python};
use logicity::config::rule_file;
use logicity::datalog::Limits;
use logicity::diag::{self, Diagnostic, Limit, Sources, render, to_json};
use logicity::files::{self, MAX_BYTES, ReadError, ReadFile as _};
use logicity::sim::codes;
use numpy::ndarray::Dimension;
use numpy::{Element, PyReadwriteArray};
use pyo3::PyClass;
use pyo3::exceptions::{PyFileNotFoundError, PyKeyboardInterrupt, PyOSError, PyRuntimeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};
use std::any::Any;
use std::ffi::OsString;
use std::num::NonZeroUsize;
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

/// The limits that Python sets: `max_rows`, `max_steps` and `max_bytes`.
type LimitArguments = (Option<usize>, Option<u64>, Option<u64>);

/// Returns limits, with `usual` for those that Python does not set.
fn limits_of((rows, steps, bytes): LimitArguments, usual: Limits) -> Limits {
    Limits {
        rows: rows.unwrap_or(usual.rows),
        steps: steps.unwrap_or(usual.steps),
        bytes: bytes.unwrap_or(usual.bytes),
    }
}

/// Adds to the diagnostic of an exceeded limit the argument that raises it.
fn advised(fault: &Diagnostic) -> Diagnostic {
    let name = match fault.limit {
        None => return fault.clone(),
        Some(Limit::Rows) => "max_rows",
        Some(Limit::Steps) => "max_steps",
        Some(Limit::Memory(_)) => "max_bytes",
    };
    fault.clone().help(format!("raise the limit `{name}`"))
}

/// Returns the exception for diagnostics, with their text and their data.
fn input_error(py: Python<'_>, faults: &[Diagnostic], sources: &Sources) -> PyErr {
    let faults: &[Diagnostic] = &faults.iter().map(advised).collect::<Vec<_>>();
    let has = |code| faults.iter().any(|fault| fault.code == code);
    if has(diag::codes::CANCELLED) {
        return PyKeyboardInterrupt::new_err(());
    }
    let arguments = match to_python(py, &to_json(faults, sources)) {
        Ok(diagnostics) => (render(faults, sources, false), diagnostics.unbind()),
        Err(error) => return error,
    };
    if has(diag::codes::LIMIT_EXCEEDED) {
        LimitError::new_err(arguments)
    } else if has(codes::DENSE_UNSUPPORTED) {
        UnsupportedError::new_err(arguments)
    } else {
        InputError::new_err(arguments)
    }
}

/// Returns the words and the summary of each command that Python implements.
#[pyfunction]
fn python_commands() -> Vec<(Vec<&'static str>, &'static str)> {
    (PYTHON_COMMANDS.iter())
        .map(|(words, summary)| (words.to_vec(), *summary))
        .collect()
}

/// Runs a command line, given without the program name.
///
/// Returns the exit code, or the words and the remaining arguments of a command that Python implements. Releases the
/// GIL. Python's signal handlers do not run meanwhile.
#[pyfunction]
fn run_command_line(py: Python<'_>, arguments: Vec<OsString>) -> (i32, Vec<&'static str>, Vec<OsString>) {
    // The panic hook has printed the panic; 101 is the exit code of a Rust program that panics.
    match py.detach(|| catch_unwind(|| run_with_python(&arguments))) {
        Ok(Outcome::Exit(code)) => (i32::from(code), Vec::new(), Vec::new()),
        Ok(Outcome::Python(words, rest)) => (0, words.to_vec(), rest),
        Err(_) => (101, Vec::new(), Vec::new()),
    }
}

/// Makes the next signal end a forked process. The thread that handles signals for commands remains in its parent.
#[pyfunction]
fn end_forked() {
    logicity::cli::end_forked();
}

/// Returns the exception for a configuration that the caller named and that cannot be read.
fn missing_file_error(fault: &Diagnostic) -> PyErr {
    let help = fault.help.iter().map(|help| format!("; {help}")).collect::<String>();
    let message = fault.message.clone() + &help;
    match fault.message.ends_with(&ReadError::NotFound.to_string()) {
        true => PyFileNotFoundError::new_err(message),
        false => PyOSError::new_err(message),
    }
}

/// Returns the exception for an unreadable file that the caller named.
fn read_error(py: Python<'_>, path: &Path, error: &ReadError) -> PyErr {
    let mut message = format!("cannot read `{}`: {error}", path.display());
    if let (ReadError::NotFound, Some(near)) = (error, builtin::similar(path)) {
        message += &format!("; did you mean `{near}`?");
    }
    match error {
        ReadError::NotFound => PyFileNotFoundError::new_err(message),
        ReadError::NotText { .. } => {
            input_error(py, &[Diagnostic::new(diag::codes::NOT_TEXT, message)], &Sources::new())
        }
        _ => PyOSError::new_err(message),
    }
}

/// Returns the text of a file on disk or a built-in file.
#[pyfunction]
fn read_file(py: Python<'_>, path: PathBuf) -> PyResult<String> {
    BuiltinFiles
        .read_or_builtin(&path)
        .map_err(|error| read_error(py, &path, &error))
}

/// Returns the path of a rule file and its text. A bare name such as `hard`, if no file has it, means `rules/hard.dl`,
/// on disk or built in.
#[pyfunction]
fn read_rules(py: Python<'_>, path: PathBuf) -> PyResult<(String, String)> {
    let path = rule_file(&path, &BuiltinFiles);
    let text = BuiltinFiles.read_or_builtin(&path);
    let text = text.map_err(|error| read_error(py, &path, &error))?;
    Ok((path.display().to_string(), text))
}

/// Checks that a file that the caller named can be read, without opening it. If it is to be read as a whole, it must
/// not be too large.
#[pyfunction]
fn check_readable(py: Python<'_>, path: PathBuf, whole: bool) -> PyResult<()> {
    let checked = files::check_readable(&path).and_then(|()| match path.metadata() {
        Ok(found) if whole && found.is_file() && found.len() > MAX_BYTES => Err(ReadError::TooLarge(MAX_BYTES)),
        _ => Ok(()),
    });
    checked.map_err(|error| read_error(py, &path, &error))
}

/// Converts JSON to Python values.
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

/// Returns the elements of an output array, which must be contiguous and have the expected length.
fn slice_of<'a, T: Element, D: Dimension>(
    array: &'a mut PyReadwriteArray<'_, T, D>,
    expected: usize,
) -> PyResult<&'a mut [T]> {
    let slice = array
        .as_slice_mut()
        .map_err(|error| PyValueError::new_err(error.to_string()))?;
    match slice.len() == expected {
        true => Ok(slice),
        false => Err(PyValueError::new_err(format!(
            "expected an array of {expected} elements, not {}",
            slice.len()
        ))),
    }
}

/// Checks for signals, such as Ctrl-C, during long-running Rust calls.
pub struct Signals {
    /// The Python thread of the call, and the time of its last check.
    last_check: Mutex<(ThreadId, Instant)>,
    raised: AtomicBool,
    error: Mutex<Option<PyErr>>,
}

impl Signals {
    /// The cancellation polling interval.
    const POLL_INTERVAL: Duration = Duration::from_millis(50);
    /// The stack size of loading threads: the usual size of a main thread.
    const STACK: usize = 8 << 20;

    fn new() -> Arc<Signals> {
        Arc::new(Signals {
            last_check: Mutex::new((thread::current().id(), Instant::now())),
            raised: AtomicBool::new(false),
            error: Mutex::new(None),
        })
    }

    /// Returns whether a signal handler has raised an exception. Cheap enough for frequent calls.
    ///
    /// Only the calling thread checks, on behalf of its workers. Python runs handlers on its main thread only, so a
    /// call from another Python thread is never cancelled.
    fn raised(&self) -> bool {
        if self.raised.load(Ordering::Relaxed) {
            return true;
        }
        let Ok(mut last_check) = self.last_check.try_lock() else {
            return false;
        };
        if last_check.1.elapsed() < Self::POLL_INTERVAL || last_check.0 != thread::current().id() {
            return false;
        }
        last_check.1 = Instant::now();
        drop(last_check);
        if let Err(error) = Python::attach(|py| py.check_signals()) {
            self.fail(error);
        }
        self.raised.load(Ordering::Relaxed)
    }

    /// Cancels the call, which then raises this exception. The first exception counts.
    fn fail(&self, error: PyErr) {
        locked(&self.error).get_or_insert(error);
        self.raised.store(true, Ordering::Relaxed);
    }

    /// Returns a token that requests cancellation when a signal handler has raised an exception.
    fn cancel(self: &Arc<Self>) -> Cancel {
        let signals = Arc::clone(self);
        Cancel::when(move || signals.raised())
    }

    /// Runs work that polls [`Signals::cancel`]. On cancellation, returns the exception of the handler.
    fn run_polled<R>(&self, work: impl FnOnce() -> R) -> PyResult<R> {
        locked(&self.last_check).0 = thread::current().id();
        let done = work();
        match self.raised.swap(false, Ordering::Relaxed) {
            true => Err(locked(&self.error).take().expect("stored before `raised` is set")),
            false => Ok(done),
        }
    }

    /// Variant of `run_polled` that releases the GIL.
    fn detach<R: Send>(&self, py: Python<'_>, work: impl FnOnce() -> R + Send) -> PyResult<R> {
        self.run_polled(|| py.detach(work))
    }

    /// Runs work that does not poll on another thread. On cancellation, that thread continues and its result is
    /// dropped.
    fn on_thread<R: Send + 'static>(&self, py: Python<'_>, work: impl FnOnce() -> R + Send + 'static) -> PyResult<R> {
        let (done, result) = mpsc::channel();
        let work = move || drop(done.send(catch_unwind(AssertUnwindSafe(work))));
        let thread = thread::Builder::new().stack_size(Self::STACK).spawn(work);
        thread.map_err(|error| PyOSError::new_err(format!("cannot start a thread: {error}")))?;
        let finished = self.detach(py, move || {
            loop {
                match result.recv_timeout(Self::POLL_INTERVAL) {
                    Err(RecvTimeoutError::Timeout) if !self.raised() => {}
                    received => break received,
                }
            }
        })?;
        let done = finished.expect("the thread sends a result");
        done.map_err(|panic| internal_error(&*panic))
    }
}

/// Locks a mutex, even if it is poisoned.
fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The content of a Python object that is not thread-safe.
///
/// Concurrent use raises `RuntimeError`. Waiting for the lock could deadlock, if a signal handler uses the object.
struct Shared<T> {
    what: &'static str,
    /// `None` after an internal error, which may leave the content inconsistent.
    content: Mutex<Option<T>>,
    signals: Arc<Signals>,
}

impl<T: Send> Shared<T> {
    fn new(what: &'static str, content: T) -> Self {
        Shared::with_signals(what, content, Signals::new())
    }

    /// Variant of `new` for content that polls these signals.
    fn with_signals(what: &'static str, content: T, signals: Arc<Signals>) -> Self {
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
                return Err(busy(self.what));
            }
        };
        match guard.is_some() {
            true => Ok(guard),
            false => Err(PyRuntimeError::new_err(format!(
                "an internal error made this {} unusable; create another",
                self.what
            ))),
        }
    }

    /// Runs short work while holding the GIL.
    fn with<R>(&self, work: impl FnOnce(&mut T) -> PyResult<R>) -> PyResult<R> {
        match &mut *self.lock()? {
            Some(content) => work(content),
            None => unreachable!("`lock` returns content"),
        }
    }

    /// Runs long work without the GIL. An exception of a signal handler cancels the work and is returned.
    fn detached<R: Send>(&self, py: Python<'_>, work: impl FnOnce(&mut T, &Cancel) -> R + Send) -> PyResult<R> {
        let mut guard = self.lock()?;
        let content = &mut *guard;
        let cancel = self.signals.cancel();
        let result = self.signals.detach(py, || {
            let work = || content.as_mut().map(|content| work(content, &cancel));
            let result = catch_unwind(AssertUnwindSafe(work));
            if result.is_err() {
                *content = None;
            }
            result
        })?;
        match result {
            Err(panic) => Err(internal_error(&*panic)),
            Ok(Some(result)) => Ok(result),
            Ok(None) => unreachable!("`lock` returns content"),
        }
    }
}

/// Returns the exception for a panic.
fn internal_error(panic: &(dyn Any + Send)) -> PyErr {
    let message =
        (panic.downcast_ref::<String>().map(String::as_str)).or_else(|| panic.downcast_ref::<&str>().copied());
    PyRuntimeError::new_err(format!(
        "internal error, please report it: {}",
        message.unwrap_or("unknown")
    ))
}

/// Borrows an environment. Concurrent use raises `RuntimeError`.
fn borrowed<'py, T: PyClass>(environment: &Bound<'py, T>) -> PyResult<PyRef<'py, T>> {
    environment.try_borrow().map_err(|_| busy("environment"))
}

/// Mutable variant of `borrowed`.
fn borrowed_mut<'py, T: PyClass<Frozen = pyo3::pyclass::boolean_struct::False>>(
    environment: &Bound<'py, T>,
) -> PyResult<PyRefMut<'py, T>> {
    environment.try_borrow_mut().map_err(|_| busy("environment"))
}

fn busy(what: &str) -> PyErr {
    PyRuntimeError::new_err(format!(
        "another thread is using this {what}; create one per thread, or guard it with a lock"
    ))
}

/// Returns the known name closest to `name`, if `name` is likely a misspelling of it.
#[pyfunction]
fn did_you_mean(name: &str, known: Vec<String>) -> Option<String> {
    logicity::diag::did_you_mean(name, known.iter().map(String::as_str)).map(str::to_owned)
}

#[pymodule]
fn _logicity(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add("THREADS_MAX", THREADS_MAX)?;
    module.add("ENVS_MAX", ENVS_MAX)?;
    module.add_function(wrap_pyfunction!(did_you_mean, module)?)?;
    module.add_function(wrap_pyfunction!(read_file, module)?)?;
    module.add_function(wrap_pyfunction!(read_rules, module)?)?;
    module.add_function(wrap_pyfunction!(check_readable, module)?)?;
    module.add_function(wrap_pyfunction!(python_commands, module)?)?;
    module.add_function(wrap_pyfunction!(run_command_line, module)?)?;
    module.add_function(wrap_pyfunction!(end_forked, module)?)?;
    config::register(module)?;
    engine::register(module)?;
    checked::register(module)?;
    circuits::register(module)?;
    city::register(module)?;
    output::register(module)?;
    task::register(module)?;
    actor::register(module)?;
    env::register(module)?;
    evaluate::register(module)?;
    induce::register(module)?;
    policy::register(module)?;
    predicate::register(module)?;
    vap::register(module)
}

/// The largest number of environments that step together. More take gigabytes, and are no faster.
const ENVS_MAX: usize = 1 << 16;

/// The largest number of threads, as on the command line.
const THREADS_MAX: usize = 1024;

/// Returns the number of threads, where 0 means one per core.
fn threads_of(given: usize) -> PyResult<NonZeroUsize> {
    match NonZeroUsize::new(given) {
        None => Ok(std::thread::available_parallelism().unwrap_or(NonZeroUsize::MIN)),
        Some(threads) if given <= THREADS_MAX => Ok(threads),
        Some(_) => Err(PyValueError::new_err(format!(
            "threads: expected 0 to {THREADS_MAX}, not {given}"
        ))),
    }
}
