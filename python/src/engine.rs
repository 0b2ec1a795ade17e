//! Programs and sessions.

use crate::arrow;
use crate::columns::{self, Maker, Target};
use crate::output::{overwrite_if, unwritable};
use crate::{LimitArguments, Shared, Signals, input_error, limits_of, read_error, threads_of, to_python};
use logicity::builtin::BuiltinFiles;
use logicity::datalog::explain::{ExplainError, Explainer, ExplanationPrinter};
use logicity::datalog::{self, export};
use logicity::datalog::{ClauseId, Column, InputPolicy, Predicate, PredicateId, Value, Workspace};
use logicity::datalog::{
    EvalError, FunctorBatch, Limits, MarginalOptions, Marginals, Probability, Program, RowError, SnapshotError,
    StratumStats, Threads,
};
use logicity::diag::{Diagnostic, Sources, did_you_mean, to_json};
use logicity::files::{self, Output, ReadError, ReadFile as _};
use pyo3::exceptions::{PyKeyError, PyKeyboardInterrupt, PyRuntimeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyCapsule, PyDict, PyList};
use serde_json::json;
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(check, module)?)?;
    module.add_class::<PyProgram>()?;
    module.add_class::<PySession>()?;
    module.add_class::<PyRows>()
}

/// Returns the diagnostics of the source of rules.
#[pyfunction]
fn check<'py>(py: Python<'py>, text: &str, name: &str) -> PyResult<Bound<'py, PyAny>> {
    let mut sources = Sources::new();
    let entry = sources.add(name, text);
    let (diagnostics, sources) = Signals::new().on_thread(py, move || {
        let (_, diagnostics) = Program::load(&mut sources, entry, &BuiltinFiles);
        (diagnostics, sources)
    })?;
    to_python(py, &to_json(&diagnostics, &sources))
}

/// A checked and planned program with its sources.
pub struct Loaded {
    workspace: Workspace,
    pub sources: Sources,
    pub program: Program,
    warnings: Vec<Diagnostic>,
    functors: Functors,
}

/// The functions that define functors.
#[derive(Default)]
struct Functors {
    functions: Vec<(String, Py<PyAny>)>,
    /// The last exception of one of them.
    raised: Arc<Mutex<Option<PyErr>>>,
}

impl Functors {
    /// Defines the functors of a program.
    fn of(program: Program, functions: Vec<(String, Py<PyAny>)>) -> PyResult<(Program, Functors)> {
        let functors = Functors {
            functions,
            raised: Arc::default(),
        };
        let mut program = program;
        for (name, function) in &functors.functions {
            let rules = program.rules();
            let Some(declared) = rules.functors.iter().find(|functor| functor.name == *name) else {
                let all = rules.functors.iter().map(|functor| functor.name.as_str());
                let near = did_you_mean(name, all);
                let hint = near.map_or_else(String::new, |near| format!("; did you mean `{near}`?"));
                return Err(PyValueError::new_err(format!(
                    "the program declares no functor `{name}`{hint}"
                )));
            };
            let (declared, types) = (declared.clone(), rules.types.clone());
            let function = Python::attach(|py| function.clone_ref(py));
            let raised = Arc::clone(&functors.raised);
            let apply = move |batch: &FunctorBatch<'_>, values: &mut Vec<Option<Value>>| {
                Python::attach(|py| {
                    let found = columns::call(function.bind(py), &declared, &types, batch);
                    found.map(|found| *values = found).map_err(|error| {
                        let reason = error.to_string();
                        raised.lock().unwrap_or_else(PoisonError::into_inner).replace(error);
                        reason
                    })
                })
            };
            program = (program.define_batch(name, apply)).map_err(|error| PyValueError::new_err(error.to_string()))?;
        }
        Ok((program, functors))
    }

    /// Returns the exception of the function that ended an evaluation.
    fn raised(&self) -> Option<PyErr> {
        self.raised.lock().unwrap_or_else(PoisonError::into_inner).take()
    }
}

impl Loaded {
    /// Returns the exception for a failed evaluation: that of the function of a functor, if it raised one.
    fn failed(&self, py: Python<'_>, error: &EvalError) -> PyErr {
        let raised = match error {
            EvalError::FailedFunctor { .. } => self.functors.raised(),
            _ => None,
        };
        raised.unwrap_or_else(|| input_error(py, &[error.diagnostic(self.program.rules())], &self.sources))
    }

    fn printer<'a>(&'a self, session: &'a datalog::Session) -> ExplanationPrinter<'a> {
        ExplanationPrinter::new(self.program.rules(), session.symbols(), &self.sources).quoting()
    }

    /// Returns the declared predicates.
    fn predicates(&self) -> impl Iterator<Item = (PredicateId, &Predicate)> + Clone {
        let predicates = (0..).map(PredicateId).zip(&self.program.rules().predicates);
        predicates.filter(|(_, predicate)| !predicate.hidden)
    }

    fn predicate(&self, name: &str) -> PyResult<(PredicateId, &Predicate)> {
        self.predicates()
            .find(|(_, predicate)| predicate.name == name)
            .ok_or_else(|| {
                let near = did_you_mean(name, self.predicates().map(|(_, predicate)| predicate.name.as_str()));
                let hint = near.map_or_else(String::new, |near| format!("; did you mean `{near}`?"));
                PyKeyError::new_err(format!("the program declares no predicate `{name}`{hint}"))
            })
    }
}

/// A checked and planned program.
#[pyclass(name = "Program", module = "logicity._logicity", frozen)]
pub struct PyProgram(Arc<Loaded>);

impl PyProgram {
    /// Returns the program and its sources.
    pub fn loaded(&self) -> &Loaded {
        &self.0
    }
}

/// The name and the source of a file.
type File = (String, String);

#[pymethods]
impl PyProgram {
    /// Loads the first of `files`. Includes come from the other files if there are any, and otherwise from disk.
    /// `functors` has functions for the functors that the program declares.
    #[new]
    fn new(py: Python<'_>, files: Vec<File>, functors: Vec<(String, Py<PyAny>)>) -> PyResult<Self> {
        let mut sources = Sources::new();
        let mut files = files.into_iter();
        let Some((name, text)) = files.next() else {
            return Err(PyValueError::new_err("a program needs at least one file"));
        };
        let entry = sources.add(name, text);
        let given: HashMap<PathBuf, String> = files.map(|(name, text)| (name.into(), text)).collect();
        let read = move |path: &Path| match (given.get(path), given.is_empty()) {
            (_, true) => BuiltinFiles.read_or_builtin(path),
            (Some(text), _) => Ok(String::clone(text)),
            (None, _) => Err(ReadError::NotFound),
        };
        let (loaded, sources) = Signals::new().on_thread(py, move || {
            let mut workspace = Workspace::new(InputPolicy::Extensible);
            workspace.add(&mut sources, entry, &read);
            let checked = workspace.check();
            let program = checked.rules.map(Program::new).transpose();
            ((workspace, checked.diagnostics, program), sources)
        })?;
        match loaded {
            (workspace, warnings, Ok(Some(program))) => {
                let (program, functors) = Functors::of(program, functors)?;
                Ok(PyProgram(Arc::new(Loaded {
                    workspace,
                    sources,
                    program,
                    warnings,
                    functors,
                })))
            }
            (_, faults, Ok(None)) => Err(input_error(py, &faults, &sources)),
            (_, _, Err(fault)) => Err(input_error(py, &[fault], &sources)),
        }
    }

    /// Returns the names and sources of all files, starting with the entry file.
    fn files(&self) -> Vec<(&str, &str)> {
        let sources = &self.0.sources;
        sources.ids().map(|id| (sources.name(id), sources.text(id))).collect()
    }

    /// Returns the functions that define functors, with their names.
    fn functors(&self, py: Python<'_>) -> Vec<(String, Py<PyAny>)> {
        let functions = self.0.functors.functions.iter();
        functions
            .map(|(name, function)| (name.clone(), function.clone_ref(py)))
            .collect()
    }

    fn predicates<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let (rules, sources) = (self.0.program.rules(), &self.0.sources);
        let predicates = self.0.predicates().map(|(_, predicate)| {
            let columns = predicate.columns.iter();
            let columns = columns.map(|column| {
                let named = &rules.types[column.ty.0 as usize].name;
                json!({ "name": column.name, "type": named, "base": column.base.name() })
            });
            let position = sources.position(predicate.span);
            json!({
                "name": predicate.name,
                "columns": columns.collect::<Vec<_>>(),
                "input": predicate.input,
                "output": predicate.output,
                "derived": predicate.derived,
                "doc": predicate.doc,
                "file": sources.file(predicate.span),
                "line": position.line,
            })
        });
        to_python(py, &predicates.collect())
    }

    fn strata(&self) -> Vec<Vec<String>> {
        let rules = self.0.program.rules();
        let shown =
            |predicate: &PredicateId| Some(&rules.predicates[predicate.index()]).filter(|predicate| !predicate.hidden);
        let names = (rules.strata.iter()).map(|stratum| stratum.predicates.iter().filter_map(shown));
        let names = names.map(|predicates| predicates.map(|predicate| predicate.name.clone()).collect());
        names.filter(|names: &Vec<_>| !names.is_empty()).collect()
    }

    fn clauses<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let Loaded { sources, program, .. } = &*self.0;
        let rules = program.rules();
        let printer = ExplanationPrinter::new(rules, &rules.symbols, sources);
        let shown = (rules.clauses.iter().zip((0..).map(ClauseId)))
            .filter(|(clause, _)| !rules.predicates[clause.head.predicate.index()].hidden);
        let clauses = shown.map(|(clause, id)| {
            let mut entry = printer.clause_json(id);
            entry["label"] = json!(printer.label(id));
            entry["text"] = json!(sources.slice(clause.span));
            entry["column"] = json!(sources.position(clause.span).column);
            entry
        });
        to_python(py, &clauses.collect())
    }

    fn warnings<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        to_python(py, &to_json(&self.0.warnings, &self.0.sources))
    }

    fn plan(&self) -> String {
        self.0.program.show_plans(&self.0.sources)
    }

    /// Returns the rules for another engine: as `sql`, otherwise as a plain program for Soufflé.
    fn export(&self, py: Python<'_>, sql: bool) -> PyResult<String> {
        let rules = self.0.program.rules();
        let written = if sql {
            export::sql(rules)
        } else {
            export::souffle(rules)
        };
        written.map_err(|faults| input_error(py, &faults, &self.0.sources))
    }
}

/// A database of facts and derived facts.
#[pyclass(name = "Session", module = "logicity._logicity", frozen)]
pub struct PySession {
    loaded: Arc<Loaded>,
    session: Shared<datalog::Session>,
}

fn row_error(error: &RowError) -> PyErr {
    PyValueError::new_err(error.to_string())
}

#[pymethods]
impl PySession {
    #[new]
    fn new(program: &PyProgram, threads: usize, limits: LimitArguments) -> PyResult<Self> {
        let mut session = program.0.program.session();
        session.set_limits(limits_of(limits, Limits::default()));
        PySession::of(program, session, threads)
    }

    /// Reads a session that `save` wrote.
    #[staticmethod]
    fn load(
        py: Python<'_>,
        program: &PyProgram,
        path: PathBuf,
        threads: usize,
        limits: LimitArguments,
    ) -> PyResult<Self> {
        let mut file = files::open_regular(&path).map_err(|error| read_error(py, &path, &error))?;
        let limits = limits_of(limits, Limits::default());
        let loaded = &program.0;
        let rules = &loaded.program;
        let session = py.detach(|| rules.load_session(&mut file, limits));
        let session = session.map_err(|error| match error {
            SnapshotError::Io(error) => read_error(py, &path, &error.into()),
            SnapshotError::TooMuchMemory { limit } => {
                let fault = Diagnostic::from(EvalError::TooManyInputs { limit });
                input_error(
                    py,
                    &[fault.note(format!("while loading `{}`", path.display()))],
                    &loaded.sources,
                )
            }
            error => PyValueError::new_err(format!("cannot load `{}`: {error}", path.display())),
        })?;
        PySession::of(program, session, threads)
    }

    /// Writes the session to a file; with `overwrite`, replaces any file.
    fn save(&self, py: Python<'_>, path: PathBuf, overwrite: bool) -> PyResult<()> {
        let output = Output::create(&path, "Session.save", overwrite_if(overwrite));
        let mut output = output.map_err(|error| unwritable(&path, &error))?;
        let saved = self.session.detached(py, |session, _| session.save(&mut output))?;
        saved
            .and_then(|()| output.finish())
            .map_err(|error| unwritable(&path, &error))
    }

    fn insert(&self, predicate: &str, rows: &Bound<'_, PyAny>) -> PyResult<usize> {
        self.change(predicate, rows, true)
    }

    fn retract(&self, predicate: &str, rows: &Bound<'_, PyAny>) -> PyResult<usize> {
        self.change(predicate, rows, false)
    }

    fn rollback(&self) -> PyResult<()> {
        self.session.with(|session| {
            session.rollback();
            Ok(())
        })
    }

    /// Commits the pending changes, in the next tick if `advance`. Returns the added and removed rows by predicate.
    fn commit<'py>(slf: &Bound<'py, Self>, advance: bool) -> PyResult<Bound<'py, PyDict>> {
        let (py, this) = (slf.py(), slf.get());
        let committed = this.session.detached(py, |session, cancel| match advance {
            true => session.advance_with(cancel),
            false => session.commit_with(cancel),
        })?;
        let delta = committed.map_err(|error| this.loaded.failed(py, &error))?;
        let program = &this.loaded.program;
        let changes = PyDict::new(py);
        for change in delta.changes() {
            let predicate = &program.rules().predicates[change.predicate.index()];
            if !predicate.hidden {
                let rows = |rows: &datalog::Rows| PyRows {
                    session: slf.clone().unbind(),
                    predicate: change.predicate,
                    rows: rows.clone(),
                };
                changes.set_item(&predicate.name, (rows(&change.added), rows(&change.removed)))?;
            }
        }
        Ok(changes)
    }

    /// Sets the seed of draws.
    fn set_seed(&self, seed: u64) -> PyResult<()> {
        self.session.with(|session| {
            session.set_seed(seed);
            Ok(())
        })
    }

    /// Returns the rows of these predicates with their probabilities: value, low and high end. `uncertain` has rows of
    /// base predicates, each list with its probabilities. The last result says why the probabilities are estimates.
    #[allow(clippy::type_complexity)]
    fn marginals<'py>(
        &self,
        py: Python<'py>,
        predicates: Vec<String>,
        uncertain: Vec<(String, Bound<'py, PyAny>, Vec<f64>)>,
        samples: u32,
        seed: u64,
    ) -> PyResult<(Vec<(Bound<'py, PyList>, Vec<(f64, f64, f64)>)>, Option<String>)> {
        let queries = predicates
            .iter()
            .map(|name| self.loaded.predicate(name).map(|(id, _)| id));
        let queries: Vec<PredicateId> = queries.collect::<PyResult<_>>()?;
        let options = MarginalOptions {
            samples,
            seed,
            ..MarginalOptions::default()
        };
        let mut made = self.session.with(|session| {
            Marginals::of_session(session, queries.iter().copied(), options).map_err(|error| row_error(&error))
        })?;
        for (name, rows, probabilities) in uncertain {
            let (id, predicate) = self.loaded.predicate(&name)?;
            let symbols = std::cell::RefCell::new(&mut made);
            let target = Target {
                maker: Maker {
                    symbol: &|text| Ok(symbols.borrow_mut().intern(text)),
                    types: &self.loaded.program.rules().types,
                },
                room: &|_| Ok(()),
            };
            let found = columns::rows(predicate, &rows, &target)?;
            let words: Vec<Value> = found.words.to_vec();
            let width = predicate.arity().max(1);
            if predicate.arity() == 0 {
                return Err(PyValueError::new_err(format!(
                    "`{name}` has no columns to tell uncertain rows apart"
                )));
            }
            for (row, probability) in words.chunks_exact(width).zip(probabilities) {
                made.insert(id, row, probability).map_err(|error| row_error(&error))?;
            }
        }
        let made = Shared::new("Marginals", made);
        let computed = made.detached(py, |made, cancel| made.compute(cancel))?;
        computed.map_err(|error| self.loaded.failed(py, &error))?;
        let program = &self.loaded.program;
        made.with(|made| {
            let all = queries.iter().map(|id| {
                let predicate = &program.rules().predicates[id.index()];
                let rows = columns::tuples(
                    py,
                    &predicate.columns,
                    made.rows(*id).map(|(row, _)| row),
                    made.symbols(),
                )?;
                let of = |probability: Probability| {
                    let (low, high) = probability.interval.unwrap_or((probability.value, probability.value));
                    (probability.value, low, high)
                };
                Ok((rows, made.rows(*id).map(|(_, probability)| of(probability)).collect()))
            });
            let inexact = made.inexact().map(|inexact| inexact.show(program.rules()));
            Ok((all.collect::<PyResult<_>>()?, inexact))
        })
    }

    /// Returns the number of the present tick.
    fn tick(&self) -> PyResult<u64> {
        self.session.with(|session| Ok(session.tick()))
    }

    fn rows(slf: &Bound<'_, Self>, predicate: &str) -> PyResult<PyRows> {
        let this = slf.get();
        let (predicate, _) = this.loaded.predicate(predicate)?;
        Ok(PyRows {
            session: slf.clone().unbind(),
            predicate,
            rows: this.session.with(|session| Ok(session.shared_rows(predicate)))?,
        })
    }

    fn columns<'py>(&self, py: Python<'py>, predicate: &str) -> PyResult<Bound<'py, PyDict>> {
        let (id, predicate) = self.loaded.predicate(predicate)?;
        let arrays = |session: &mut datalog::Session| {
            columns::arrays(py, &predicate.columns, || session.encoded_rows(id), session.symbols())
        };
        self.session.with(arrays)
    }

    fn count(&self, predicate: &str) -> PyResult<usize> {
        let (id, _) = self.loaded.predicate(predicate)?;
        self.session.with(|session| Ok(session.len(id)))
    }

    fn contains(&self, predicate: &str, row: &Bound<'_, PyAny>) -> PyResult<bool> {
        let (id, predicate) = self.loaded.predicate(predicate)?;
        self.session.with(|session| {
            let symbols = session.symbols();
            let maker = Maker {
                symbol: &|text| Ok(Value(symbols.get(text).map_or(u32::MAX, |symbol| symbol.0))),
                types: &self.loaded.program.rules().types,
            };
            let row = columns::row(predicate, row, false, maker)?;
            let row: Vec<Value> = row.into_iter().flatten().collect();
            Ok(session.contains(id, &row))
        })
    }

    /// Returns the answers of a query: one column for each of its variables.
    fn query(&self, py: Python<'_>, body: &str) -> PyResult<PyRows> {
        let mut sources = self.loaded.sources.clone();
        let question = sources.add("<query>", body);
        let answered = self.session.detached(py, |session, cancel| {
            let asked = (self.loaded.workspace).ask(&sources, question, session.symbols().clone());
            let query = Program::new(asked.rules.ok_or(asked.diagnostics)?).map_err(|fault| vec![fault])?;
            let failed = |error: EvalError| vec![error.diagnostic(query.rules())];
            let mut answer = session.query(&query, cancel).map_err(failed)?;
            let delta = answer.commit_with(cancel).map_err(failed)?;
            let predicate = query.predicate(Workspace::ANSWER).expect("every query has an answer");
            let rows = delta.of(predicate).map(|change| change.added.clone());
            Ok((query, answer, predicate, rows.unwrap_or_default()))
        })?;
        let answered = answered.map_err(|faults: Vec<Diagnostic>| match self.loaded.functors.raised() {
            Some(raised)
                if faults
                    .iter()
                    .any(|fault| fault.code == logicity::datalog::codes::FAILED_FUNCTOR) =>
            {
                raised
            }
            _ => input_error(py, &faults, &sources),
        });
        let (program, answer, predicate, rows) = answered?;
        let loaded = Loaded {
            workspace: Workspace::new(InputPolicy::Fixed),
            sources,
            program,
            warnings: Vec::new(),
            functors: Functors::default(),
        };
        let session = PySession {
            loaded: Arc::new(loaded),
            session: Shared::new("Session", answer),
        };
        Ok(PyRows {
            session: Py::new(py, session)?,
            predicate,
            rows,
        })
    }

    /// Returns the fact as text, whether it holds, the explanation as text, and the nodes of the explanation.
    fn explain<'py>(
        &self,
        py: Python<'py>,
        fact: &str,
        row: Option<&Bound<'py, PyAny>>,
        why_not: bool,
    ) -> PyResult<(String, bool, String, Bound<'py, PyAny>)> {
        let loaded = &*self.loaded;
        let (predicate, pattern) = self.session.with(|session| match row {
            Some(row) => {
                let (id, predicate) = loaded.predicate(fact)?;
                let symbols = session.symbols();
                let maker = Maker {
                    symbol: &|text| Ok(Value(symbols.intern(text).0)),
                    types: &loaded.program.rules().types,
                };
                Ok((id, columns::row(predicate, row, true, maker)?))
            }
            None => {
                let mut sources = loaded.sources.clone();
                let question = sources.add("<fact>", fact);
                let fact = loaded.workspace.fact(&sources, question, session.symbols());
                let fact = fact.map_err(|faults| input_error(py, &faults, &sources))?;
                Ok((fact.predicate, fact.values))
            }
        })?;
        let explained = self.session.detached(py, |session, cancel| {
            let mut explainer = Explainer::new_with(session, cancel);
            let (holds, explanation) = explainer.explain_either(predicate, &pattern)?;
            let printer = loaded.printer(session);
            let fact = printer.row(predicate, &pattern);
            let mut text = match (holds, why_not) {
                (false, false) => format!("{fact} does not hold, because:\n"),
                (true, true) => format!("{fact} holds, because:\n"),
                _ => String::new(),
            };
            let explanation = explanation.unwrap_or_default();
            text += &printer.tree(&explanation);
            Ok((fact, holds, text, printer.json(&explanation)["nodes"].take()))
        })?;
        let (fact, holds, text, nodes) =
            explained.map_err(|error: ExplainError| match (&error, loaded.functors.raised()) {
                (ExplainError::Functor { .. }, Some(raised)) => raised,
                _ => input_error(py, &[error.into()], &loaded.sources),
            })?;
        Ok((fact, holds, text, to_python(py, &nodes)?))
    }

    /// Returns the statistics of the last commit, by stratum.
    fn work<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let Loaded { program, sources, .. } = &*self.loaded;
        let rules = program.rules();
        self.session.with(|session| {
            let printer = ExplanationPrinter::new(rules, session.symbols(), sources);
            let strata = session.work().strata.iter().zip(&rules.strata).map(|(work, stratum)| {
                let names = stratum.predicates.iter().map(|id| &rules.predicates[id.index()]);
                let names: Vec<&str> = names.map(datalog::Predicate::title).collect();
                let how = match work {
                    StratumStats::Skipped => "skipped",
                    StratumStats::Maintained(_) => "maintained",
                    StratumStats::Recomputed(_) => "recomputed",
                };
                let done = work.work();
                let clauses = done.iter().flat_map(|work| &work.rules).map(|rule| {
                    json!({
                        "clause": printer.label(rule.clause),
                        "delta_rows": rule.delta_rows,
                        "rows_scanned": rule.rows_scanned,
                        "derived": rule.derived,
                    })
                });
                json!({
                    "predicates": names,
                    "how": how,
                    "rounds": done.map_or(0, |work| work.rounds),
                    "rows_scanned": done.map_or(0, |work| work.rows_scanned() + work.given_up),
                    "clauses": clauses.collect::<Vec<_>>(),
                })
            });
            to_python(py, &strata.collect())
        })
    }

    /// Returns the current plan of every clause.
    fn plan(&self) -> PyResult<String> {
        self.session
            .with(|session| Ok(session.show_plans(&self.loaded.sources)))
    }
}

impl PySession {
    fn of(program: &PyProgram, mut session: datalog::Session, threads: usize) -> PyResult<Self> {
        let threads = Threads::new(threads_of(threads)?);
        (session.set_threads(threads))
            .map_err(|error| PyRuntimeError::new_err(format!("cannot start {} threads: {error}", threads.count)))?;
        Ok(PySession {
            loaded: Arc::clone(&program.0),
            session: Shared::new("Session", session),
        })
    }

    fn change(&self, predicate: &str, rows: &Bound<'_, PyAny>, present: bool) -> PyResult<usize> {
        let (id, predicate) = self.loaded.predicate(predicate)?;
        let (limit, rest) = self.session.with(|session| {
            let rest = session.bytes() - session.symbols().bytes();
            Ok((session.limits().bytes, rest))
        })?;
        let checked = |bytes: u64| match bytes <= limit {
            true => Ok(()),
            false => {
                let fault = EvalError::TooManyInputs { limit }.into();
                Err(input_error(rows.py(), &[fault], &self.loaded.sources))
            }
        };
        // The caller's iterator may use this session, so the session stays unlocked during the conversion.
        let symbol = |text: &str| {
            self.session.with(|session| {
                checked(rest + session.symbols().bytes() + text.len() as u64)?;
                Ok(session.intern(text))
            })
        };
        let target = Target {
            maker: Maker {
                symbol: &symbol,
                types: &self.loaded.program.rules().types,
            },
            // The converted rows, and their copies among the pending changes.
            room: &|words| {
                let bytes = (words as u64).saturating_mul(2 * size_of::<Value>() as u64);
                self.session
                    .with(|session| checked(session.bytes().saturating_add(bytes)))
            },
        };
        let found = columns::rows(predicate, rows, &target)?;
        self.session.with(|session| {
            let width = predicate.arity().max(1);
            let noted = match (present, predicate.arity()) {
                (true, 1..) => session.insert_all(id, found.words.chunks_exact(width)),
                (true, 0) => (0..found.rows.min(1)).try_for_each(|_| session.insert(id, ())),
                (false, 0) => (0..found.rows.min(1)).try_for_each(|_| session.retract(id, ())),
                (false, 1..) => (found.words.chunks_exact(width)).try_for_each(|row| session.retract(id, row)),
            };
            noted.map_err(|error| row_error(&error))?;
            Ok(found.rows)
        })
    }
}

/// Rows of a predicate, or rows that a commit added or removed.
#[pyclass(name = "Rows", module = "logicity._logicity", frozen)]
pub struct PyRows {
    session: Py<PySession>,
    predicate: PredicateId,
    rows: datalog::Rows,
}

#[pymethods]
impl PyRows {
    fn __len__(&self) -> usize {
        self.rows.len()
    }

    /// Returns the rows in a half-open range of indices.
    fn tuples<'py>(&self, py: Python<'py>, start: usize, stop: usize) -> PyResult<Bound<'py, PyList>> {
        let PySession { loaded, session } = self.session.get();
        let predicate = &loaded.program.rules().predicates[self.predicate.index()];
        let rows = self.rows.range(start..stop);
        session.with(|session| columns::tuples(py, &predicate.columns, rows, session.symbols()))
    }

    fn columns<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let PySession { loaded, session } = self.session.get();
        let predicate = &loaded.program.rules().predicates[self.predicate.index()];
        session.with(|session| columns::arrays(py, &predicate.columns, || self.rows.iter(), session.symbols()))
    }

    fn __arrow_c_schema__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyCapsule>> {
        arrow::schema(py, self.declared())
    }

    #[pyo3(signature = (requested_schema=None))]
    fn __arrow_c_stream__<'py>(
        &self,
        py: Python<'py>,
        requested_schema: Option<Bound<'py, PyCapsule>>,
    ) -> PyResult<Bound<'py, PyCapsule>> {
        let made = self.session.get().session.detached(py, |session, cancel| {
            arrow::batches(self.declared(), &self.rows, session.symbols(), cancel)
        })?;
        match made.map_err(PyValueError::new_err)? {
            Some(batches) => arrow::stream(py, self.declared(), batches, requested_schema),
            None => Err(PyKeyboardInterrupt::new_err(())),
        }
    }
}

impl PyRows {
    /// Returns the columns.
    fn declared(&self) -> &[Column] {
        let rules = self.session.get().loaded.program.rules();
        &rules.predicates[self.predicate.index()].columns
    }
}
