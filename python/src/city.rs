//! Scenes and simulations.

use crate::output::{overwrite_if, unwritable};
use crate::predicate::Functions;
use crate::{
    LimitArguments, Shared, Signals, input_error, limits_of, missing_file_error, read_error, threads_of, to_python,
};
use logicity::builtin::{BuiltinFiles, ReadWith};
use logicity::cancel::Cancel;
use logicity::city::{Action, AgentKind, Split};
use logicity::city::{Agent, Cell, CityMap, Heading, Lane, MoveReason};
use logicity::config::{Loaded as AnyFile, load_any, missing_file};
use logicity::datalog::MarginalOptions;
use logicity::datalog::codes::RULE_MISMATCH;
use logicity::datalog::explain::{Explainer, ExplanationPrinter};
use logicity::diag::codes;
use logicity::diag::{Diagnostic, SourceId, Sources};
use logicity::files::{Output, ReadError, ReadFile};
use logicity::rng::Seed;
use logicity::sim::{
    AskedFact, Executor, Inference, LoadError, LoadedCity, MAX_ENTITIES, Settings, Simulation, TraceWriter, World,
};
use numpy::ndarray::{Array1, Array2};
use numpy::{IntoPyArray, PyArray1, PyArray2, PyArray3};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::cell::RefCell;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("ACTIONS", Action::STANDARD.map(Action::name))?;
    module.add("HEADINGS", Heading::ALL.map(Heading::name))?;
    module.add("REASONS", REASONS.map(|(_, name)| name))?;
    module.add_function(wrap_pyfunction!(lanes, module)?)?;
    module.add_function(wrap_pyfunction!(network_file, module)?)?;
    module.add_function(wrap_pyfunction!(roads, module)?)?;
    module.add_class::<PyInference>()?;
    module.add_class::<PySimulation>()
}

/// The reasons for moves. Arrays store indices into this list.
const REASONS: [(MoveReason, &str); 5] = [
    (MoveReason::Decided, "decided"),
    (MoveReason::OnlyMove, "only-move"),
    (MoveReason::Drawn, "drawn"),
    (MoveReason::Resting, "resting"),
    (MoveReason::Parked, "parked"),
];

/// The name of the source with overrides.
const OVERRIDES: &str = "<overrides>";

/// The sources of files by path.
pub type Files = BTreeMap<PathBuf, String>;

/// A loaded city and its sources.
pub struct Loaded {
    pub sources: Sources,
    pub city: LoadedCity,
    /// The files that were read.
    pub files: Files,
    /// The configuration, if other rules replace its own.
    pub replaced: Option<String>,
}

impl Loaded {
    /// Reads a configuration and its rules. `rules` is a rule file that replaces the configuration's.
    ///
    /// The text comes from `files` if present, and otherwise from disk and the built-in files. `overrides` is a JSON
    /// object whose key `base` names the configuration. `limits` applies to each tick or scene.
    pub fn new(
        py: Python<'_>,
        signals: &Signals,
        config: PathBuf,
        rules: Option<PathBuf>,
        limits: LimitArguments,
        files: Option<Files>,
        overrides: Option<String>,
    ) -> PyResult<Loaded> {
        let replaced = rules.is_some().then(|| config.display().to_string());
        let (loaded, sources) = signals.on_thread(py, move || {
            let mut sources = Sources::new();
            let loaded = Loaded::read(&mut sources, &config, rules, files, overrides.as_deref());
            (loaded, sources)
        })?;
        match loaded {
            Ok((mut city, files)) => {
                city.limits = limits_of(limits, city.limits);
                Ok(Loaded {
                    sources,
                    city,
                    files,
                    replaced,
                })
            }
            Err(LoadError::RuleFile(path, error)) => Err(read_error(py, &path, &error)),
            Err(LoadError::Rules(faults)) => Err(input_error(py, &faults, &sources)),
            Err(LoadError::Config(faults)) => Err(match missing_file(&faults) {
                Some(fault) => missing_file_error(fault),
                None => input_error(py, &faults, &sources),
            }),
        }
    }

    fn read(
        sources: &mut Sources,
        config: &Path,
        rules: Option<PathBuf>,
        files: Option<Files>,
        overrides: Option<&str>,
    ) -> Result<(LoadedCity, Files), LoadError> {
        let read = RefCell::new(Files::new());
        let reader = ReadWith(|path: &Path| match (overrides, &files) {
            (Some(text), _) if path == Path::new(OVERRIDES) => Ok(text.to_owned()),
            (_, files) => {
                let text = match files {
                    Some(files) => files.get(path).cloned().ok_or(ReadError::NotFound),
                    None => BuiltinFiles.read(path),
                };
                text.inspect(|text| drop(read.borrow_mut().insert(path.to_owned(), text.clone())))
            }
        });
        let entry = overrides.map_or(config, |_| Path::new(OVERRIDES));
        let mut city = LoadedCity::load(sources, entry, rules.as_deref(), &reader)?;
        if overrides.is_some() {
            city.scenario.name = config.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        }
        Ok((city, read.into_inner()))
    }
}

/// Returns the exception for a city that cannot run. If rules replace those of the configuration `replaced`, it says
/// which one they do not fit.
pub fn city_error(py: Python<'_>, faults: Vec<Diagnostic>, sources: &Sources, replaced: Option<&str>) -> PyErr {
    let advised =
        faults.into_iter().map(|fault| {
            match replaced.filter(|_| fault.code == RULE_MISMATCH) {
        Some(config) => fault.help(format!(
            "the rules are checked against the configuration `{config}`; name another one with the argument `config`, or the option `--modes` of `logicity evaluate`"
        )),
        None => fault,
    }
        });
    input_error(py, &advised.collect::<Vec<_>>(), sources)
}

/// Finds a value by its name.
pub fn one_of<T: Copy>(what: &str, given: &str, all: &[T], name: impl Fn(T) -> &'static str) -> PyResult<T> {
    all.iter().copied().find(|&value| name(value) == given).ok_or_else(|| {
        let names: Vec<String> = all.iter().map(|&value| format!("\"{}\"", name(value))).collect();
        PyValueError::new_err(format!("{what} must be one of {}, not \"{given}\"", names.join(", ")))
    })
}

/// Applies the rules to scenes.
#[pyclass(name = "Inference", module = "logicity._logicity", frozen)]
struct PyInference {
    inference: Shared<Inference>,
    /// The memory that an answer may take.
    bytes_max: u64,
    files: Files,
}

#[pymethods]
impl PyInference {
    #[new]
    fn new(
        py: Python<'_>,
        config: PathBuf,
        rules: Option<PathBuf>,
        seed: u64,
        executor: &str,
        limits: LimitArguments,
        files: Option<Files>,
    ) -> PyResult<Self> {
        let executor = one_of("executor", executor, &Executor::ALL, Executor::name)?;
        let loaded = Loaded::new(py, &Signals::new(), config, rules, limits, files, None)?;
        let Loaded {
            sources,
            city,
            files,
            replaced,
        } = loaded;
        let limits = city.limits;
        let mut inference = Inference::new(city.scenario, city.program, Seed(seed), executor, BuiltinFiles)
            .map_err(|faults| city_error(py, faults, &sources, replaced.as_deref()))?;
        inference.name_clauses(&sources);
        inference.set_limits(limits);
        Ok(PyInference {
            inference: Shared::new("Inference", inference),
            bytes_max: limits.bytes,
            files,
        })
    }

    /// Applies the rules to a scene in JSON. The answer has the key `fallback` only if the relational executor replaced
    /// the dense one.
    fn answer<'py>(&self, py: Python<'py>, scene: &str) -> PyResult<Bound<'py, PyAny>> {
        let mut sources = Sources::new();
        let source = sources.add("<scene>", scene);
        let answer = self.inference.detached(py, |inference, cancel| {
            let answer = inference.answer_with(&sources, source, cancel)?;
            let mut json = answer.to_json(self.bytes_max).map_err(|fault| vec![fault])?;
            if let Some(fallback) = answer.fallback {
                json["fallback"] = fallback.into();
            }
            Ok::<_, Vec<Diagnostic>>(json)
        })?;
        match answer {
            Ok(json) => to_python(py, &json),
            Err(faults) => Err(input_error(py, &faults, &sources)),
        }
    }

    /// Returns the rows over entities of some predicates, base or derived, in a scene in JSON.
    fn rows(&self, py: Python<'_>, scene: &str, predicates: Vec<String>) -> PyResult<Vec<Vec<Vec<String>>>> {
        let mut sources = Sources::new();
        let source = sources.add("<scene>", scene);
        let rows = (self.inference).detached(py, |inference, cancel| {
            inference.rows((&sources, source), &predicates, cancel)
        })?;
        rows.map_err(|faults| input_error(py, &faults, &sources))
    }

    /// Returns the predicates of the rules about agents alone: the name, the number of columns, and whether clauses derive
    /// it.
    fn agent_predicates(&self) -> PyResult<Vec<(String, usize, bool)>> {
        self.inference.with(|inference| Ok(inference.agent_predicates()))
    }

    /// Returns the probabilities of the actions in a scene in JSON.
    fn marginals<'py>(&self, py: Python<'py>, scene: &str, samples: u32, seed: u64) -> PyResult<Bound<'py, PyAny>> {
        let mut sources = Sources::new();
        let source = sources.add("<scene>", scene);
        let options = MarginalOptions {
            samples,
            seed,
            ..MarginalOptions::default()
        };
        let answer = self.inference.detached(py, |inference, cancel| {
            let answer = inference.marginals(&sources, source, options, cancel)?;
            Ok::<_, Vec<Diagnostic>>(answer.to_json())
        })?;
        match answer {
            Ok(json) => to_python(py, &json),
            Err(faults) => Err(input_error(py, &faults, &sources)),
        }
    }

    /// Returns the files that were read, with their sources.
    fn files(&self) -> Files {
        self.files.clone()
    }
}

/// A lane: its heading, the numbers of its street and its block, its first and last cell, and the zones that contain the
/// middle between them.
type LaneInfo = (&'static str, i32, i32, (i32, i32), (i32, i32), Vec<String>);

/// The geometry of a map, as [`lanes`] returns it.
type GridInfo = (String, [i32; 2], [i32; 2], i32, Vec<LaneInfo>);

/// Returns the map in a map file or a configuration.
fn map_at(py: Python<'_>, path: &Path) -> PyResult<CityMap> {
    let mut sources = Sources::new();
    let made = load_any(&mut sources, path, &BuiltinFiles).and_then(|loaded| {
        let config = match loaded {
            AnyFile::Scenario(scenario) => scenario.map,
            AnyFile::Map(map) => map,
        };
        CityMap::generate(&config).map_err(|fault| vec![fault])
    });
    made.map_err(|faults| match missing_file(&faults) {
        Some(fault) => missing_file_error(fault),
        None => input_error(py, &faults, &sources),
    })
}

/// Returns the road network of the map in a map file or a configuration as a network of SUMO; `None` for a map of
/// blocks.
#[pyfunction]
fn network_file(py: Python<'_>, path: PathBuf) -> PyResult<Option<String>> {
    Ok(map_at(py, &path)?.network().map(logicity::sumo::network_file))
}

/// A lane for cars: its cells with the direction of travel, its points in cells, its width, whether an intersection is
/// at its end, and the zones that contain its middle.
type RoadLaneInfo = (Vec<((i32, i32), &'static str)>, Vec<(f64, f64)>, f64, bool, Vec<String>);

/// The geometry of a road network, as [`roads`] returns it.
type RoadInfo = (
    String,
    [i32; 2],
    f64,
    [f64; 2],
    Vec<RoadLaneInfo>,
    Vec<(usize, usize, Vec<(i32, i32)>)>,
);

/// Returns the geometry of the road network of the map in a map file or a configuration: its name, the numbers of rows
/// and columns of cells, the side of a cell and the position of the upper left corner in meters, the lanes for cars,
/// and the connections: two lanes and the cells between them. `None` for a map of blocks.
#[pyfunction]
fn roads(py: Python<'_>, path: PathBuf) -> PyResult<Option<RoadInfo>> {
    let map = map_at(py, &path)?;
    let Some(network) = map.network() else { return Ok(None) };
    let pair = |cell: &Cell| (cell.row, cell.col);
    let (mut numbers, mut lanes) = (BTreeMap::new(), Vec::new());
    for (number, lane) in network.lanes.iter().enumerate() {
        let cells = map.lane_cells(number);
        let Some(last) = cells.last() else { continue };
        let middle = cells[cells.len() / 2];
        let headings = map.lane_headings(number).iter().map(|heading| heading.name());
        let zones = map.zones().filter(|zone| map.in_zone(zone, middle)).map(str::to_owned);
        numbers.insert(number, lanes.len());
        lanes.push((
            cells.iter().map(pair).zip(headings).collect(),
            lane.shape.iter().map(|point| (point.x, point.y)).collect(),
            lane.width,
            map.at_intersection(AgentKind::Car, *last).is_some(),
            zones.collect(),
        ));
    }
    let links = network
        .connections
        .iter()
        .enumerate()
        .filter_map(|(number, connection)| {
            let [from, to] = [connection.from, connection.to].map(|lane| numbers.get(&(lane as usize)));
            let (from, to) = (from?, to?);
            Some((*from, *to, map.connection_cells(number).iter().map(pair).collect()))
        });
    Ok(Some((
        map.name.clone(),
        [map.rows(), map.cols()],
        network.cell,
        network.origin,
        lanes,
        links.collect(),
    )))
}

/// Returns the geometry of the map in a map file or a configuration: its name, the numbers of rows and columns of cells
/// and of blocks, the cells from a lane to the mid line of its street, and all lanes.
#[pyfunction]
fn lanes(py: Python<'_>, path: PathBuf) -> PyResult<GridInfo> {
    let map = map_at(py, &path)?;
    let lane = |(street, block, lane): (i32, i32, Lane)| {
        let middle = Cell::new((lane.start.row + lane.end.row) / 2, (lane.start.col + lane.end.col) / 2);
        let zones = map.zones().filter(|zone| map.in_zone(zone, middle)).map(str::to_owned);
        let cell = |cell: Cell| (cell.row, cell.col);
        (
            lane.heading.name(),
            street,
            block,
            cell(lane.start),
            cell(lane.end),
            zones.collect(),
        )
    };
    let layout = map.layout().ok_or_else(|| {
        let name = &map.name;
        PyValueError::new_err(format!(
            "the map `{name}` is a road network; a map of blocks is needed here"
        ))
    })?;
    let lanes = layout.lanes().map(lane).collect();
    Ok((
        map.name.clone(),
        [map.rows(), map.cols()],
        layout.blocks(),
        layout.lane_offset(),
        lanes,
    ))
}

/// A running city.
#[pyclass(name = "Simulation", module = "logicity._logicity", frozen)]
struct PySimulation {
    city: Shared<Simulation>,
    world: Arc<World>,
    sources: Sources,
    rule_files: Vec<SourceId>,
    files: Files,
    functions: Option<Arc<Functions>>,
}

/// A tick: its number, the positions and headings before it, the derived actions, the actions, the positions after it,
/// the reasons for the moves, and whether agents received a new goal.
type Tick<'py> = (
    u64,
    Bound<'py, PyArray2<i32>>,
    Bound<'py, PyArray1<i8>>,
    Bound<'py, PyArray2<bool>>,
    Bound<'py, PyArray1<i8>>,
    Bound<'py, PyArray2<i32>>,
    Bound<'py, PyArray1<i8>>,
    Bound<'py, PyArray1<bool>>,
);

/// The name, type, concepts and priority of an agent.
type AgentInfo = (String, String, Vec<String>, i32);

/// The reason why a run ended early.
enum Failure {
    Fault(Diagnostic),
    File(std::io::Error),
}

#[pymethods]
impl PySimulation {
    #[new]
    #[expect(clippy::too_many_arguments, reason = "each is an argument in Python")]
    fn new(
        py: Python<'_>,
        config: PathBuf,
        rules: Option<PathBuf>,
        split: &str,
        seed: u64,
        threads: usize,
        executor: &str,
        count_firings: bool,
        limits: LimitArguments,
        predicates: Option<Bound<'_, PyAny>>,
        files: Option<Files>,
    ) -> PyResult<Self> {
        let functions = predicates.as_ref().map(Functions::new).transpose()?;
        let split = one_of("split", split, &Split::ALL, Split::name)?;
        let executor = one_of("executor", executor, &Executor::ALL, Executor::name)?;
        let signals = Signals::new();
        let threads = threads_of(threads)?.get();
        let Loaded {
            sources,
            city,
            files,
            replaced,
        } = Loaded::new(py, &signals, config, rules, limits, files, None)?;
        let rule_files = city.rule_files.clone();
        let settings = Settings {
            executor,
            count_firings,
            threads,
        };
        let cancel = signals.cancel();
        let external = functions.clone();
        let made = signals.on_thread(py, move || {
            let mut world = city.world()?;
            if let Some(external) = external {
                world.set_external(external).map_err(|fault| vec![fault])?;
            }
            let world = Arc::new(world);
            let city = Simulation::new_with(Arc::clone(&world), split, Seed(seed), settings, &cancel);
            Ok((city.map_err(|fault| vec![fault])?, world))
        })?;
        let (city, world) = made.map_err(|faults| city_error(py, faults, &sources, replaced.as_deref()))?;
        Ok(PySimulation {
            city: Shared::with_signals("Simulation", city, signals),
            world,
            sources,
            rule_files,
            files,
            functions,
        })
    }

    /// Returns the files that were read, with their sources.
    fn files(&self) -> Files {
        self.files.clone()
    }

    fn agents(&self) -> PyResult<Vec<AgentInfo>> {
        let info = |agent: &Agent| {
            (
                agent.name().to_string(),
                agent.name().kind_name().to_owned(),
                agent.concepts.to_vec(),
                agent.priority,
            )
        };
        self.city.with(|city| Ok(city.agents().iter().map(info).collect()))
    }

    /// Returns the name of the map and its numbers of rows and columns.
    fn map(&self) -> (&str, i32, i32) {
        let map = self.world.map();
        (&map.name, map.rows(), map.cols())
    }

    fn executor(&self) -> PyResult<&'static str> {
        self.city.with(|city| Ok(city.executor().name()))
    }

    fn now(&self) -> PyResult<u64> {
        self.city.with(|city| Ok(city.now()))
    }

    fn positions<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<i32>>> {
        self.city
            .with(|city| Ok(cells(py, city.agents().iter().map(|agent| agent.cell))))
    }

    fn goals<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<i32>>> {
        self.city
            .with(|city| Ok(cells(py, city.agents().iter().map(Agent::goal))))
    }

    fn headings<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray1<i8>>> {
        self.city
            .with(|city| Ok(codes(py, city.agents().iter().map(|agent| heading(agent.heading)))))
    }

    fn semantic_map<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray3<f32>>> {
        let drawn = self.city.detached(py, |city, _| city.semantic_map())?;
        let layers = drawn.map_err(|fault| self.error(py, fault))?;
        Ok(layers.into_pyarray(py))
    }

    /// Returns the names of the actions, in the order of their numbers.
    fn action_names(&self) -> Vec<String> {
        self.world.vocabulary.actions().names().map(str::to_owned).collect()
    }

    /// Runs a tick. Each element of `controls` is the index of an agent and the index of the action that it takes.
    fn tick<'py>(&self, py: Python<'py>, controls: Vec<(usize, usize)>) -> PyResult<Tick<'py>> {
        let controls: Vec<(usize, Action)> = (controls.into_iter())
            .map(|(agent, action)| Ok((agent, self.action(action)?)))
            .collect::<PyResult<_>>()?;
        let done = self.city.detached(py, |city, _| city.tick(&controls).map(|_| ()))?;
        done.map_err(|fault| self.error(py, fault))?;
        self.last(py)
    }

    /// Returns the last tick.
    fn last<'py>(&self, py: Python<'py>) -> PyResult<Tick<'py>> {
        self.city.with(|city| {
            let report = city.report();
            let agents = &report.agents;
            let actions: Vec<Action> = self.world.vocabulary.actions().all().collect();
            let derived = |(agent, action): (usize, usize)| agents[agent].derived.contains(actions[action]);
            let reason = |reason| REASONS.iter().position(|(known, _)| *known == reason);
            Ok((
                report.tick,
                cells(py, agents.iter().map(|done| done.moved.from)),
                codes(py, agents.iter().map(|done| heading(done.heading))),
                Array2::from_shape_fn((agents.len(), actions.len()), derived).into_pyarray(py),
                codes(py, agents.iter().map(|done| Some(done.action.index()))),
                cells(py, agents.iter().map(|done| done.moved.to)),
                codes(py, agents.iter().map(|done| reason(done.moved.reason))),
                agents
                    .iter()
                    .map(|done| done.moved.replanned)
                    .collect::<Array1<bool>>()
                    .into_pyarray(py),
            ))
        })
    }

    /// Runs ticks, and writes their trace to a file if `trace` names one; with `overwrite`, replaces any file.
    fn run(&self, py: Python<'_>, ticks: u64, trace: Option<PathBuf>, overwrite: bool) -> PyResult<()> {
        let output = (trace.as_deref())
            .map(|path| Output::create(path, "run", overwrite_if(overwrite)).map_err(|error| unwritable(path, &error)))
            .transpose()?;
        let done = self.city.detached(py, |city, cancel| match output {
            None => run(city, ticks, cancel, |_| Ok(())),
            Some(output) => self.run_traced(city, ticks, cancel, output),
        })?;
        done.map_err(|failure| match failure {
            Failure::Fault(fault) => self.error(py, fault),
            Failure::File(error) => unwritable(&trace.unwrap_or_default(), &error),
        })
    }

    /// Returns the base facts of the last tick by predicate, as indices of agents.
    fn facts<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let found = self.city.detached(py, |city, cancel| match city.agents().len() {
            0..=MAX_ENTITIES => city.facts_with(|_| true, cancel),
            agents => Err(too_many(agents, "binary facts")),
        })?;
        let facts = found.map_err(|fault| self.error(py, fault))?;
        let dict = PyDict::new(py);
        for (predicate, rows) in self.world.vocabulary.predicates.iter().zip(&facts.rows) {
            let shape = (rows.len(), predicate.arity);
            // The number of agents fits an i32.
            let array = Array2::from_shape_fn(shape, |(row, column)| rows[row][column].cast_signed());
            dict.set_item(&predicate.name, array.into_pyarray(py))?;
        }
        Ok(dict)
    }

    /// Explains an agent's action in the last tick, or why the rules did not derive another action, as text and as
    /// data.
    fn explain<'py>(
        &self,
        py: Python<'py>,
        agent: usize,
        why_not: Option<usize>,
    ) -> PyResult<(String, Bound<'py, PyAny>)> {
        let why_not = why_not.map(|action| self.action(action)).transpose()?;
        let explained = self.city.detached(py, |city, cancel| {
            let account = city.decision(agent)?.account(why_not, cancel)?;
            Ok((account.text(&self.sources), account.json(&self.sources)))
        })?;
        let (text, json) = explained.map_err(|fault: Diagnostic| self.error(py, fault))?;
        Ok((text, to_python(py, &json)?))
    }

    /// Returns the fact as text, whether it holds in the state of the last tick, the explanation as text, and the nodes
    /// of the explanation.
    fn explain_fact<'py>(
        &self,
        py: Python<'py>,
        agent: usize,
        fact: &str,
    ) -> PyResult<(String, bool, String, Bound<'py, PyAny>)> {
        let mut sources = self.sources.clone();
        let question = sources.add("<fact>", fact);
        let explained = self.city.detached(py, |city, cancel| {
            let names: Vec<String> = city.agents().iter().map(|agent| agent.name().to_string()).collect();
            let names: Vec<&str> = names.iter().map(String::as_str).collect();
            let decision = city.decision(agent).map_err(|fault| vec![fault])?;
            let known = (&decision.world.scenario, decision.session);
            let asked = AskedFact::read(&sources, question, known, &names, Some(names[agent]))?;
            let mut explainer = Explainer::new_with(decision.session, cancel);
            let account = asked.explain(&mut explainer).map_err(|error| vec![error.into()])?;
            let mut json = account.json(decision.session, &sources);
            Ok((
                account.fact(decision.session, &sources),
                account.holds,
                account.text(decision.session, &sources),
                json["nodes"].take(),
            ))
        })?;
        let explained = explained.map_err(|faults: Vec<Diagnostic>| {
            let raised = faults.iter().find_map(|fault| self.raised(fault));
            raised.unwrap_or_else(|| input_error(py, &faults, &sources))
        });
        let (fact, holds, text, nodes) = explained?;
        Ok((fact, holds, text, to_python(py, &nodes)?))
    }

    /// Returns the label of each clause and the number of rows it derived in the last tick.
    fn firings(&self) -> PyResult<Vec<(String, usize)>> {
        let rules = self.world.program.rules();
        let printer = ExplanationPrinter::new(rules, &rules.symbols, &self.sources);
        self.city.with(|city| {
            let counts = city.clauses().iter().zip(city.firings());
            Ok(counts.map(|(&clause, &count)| (printer.label(clause), count)).collect())
        })
    }
}

impl PySimulation {
    /// Returns the action with a number.
    fn action(&self, number: usize) -> PyResult<Action> {
        let action = self.world.vocabulary.actions().all().nth(number);
        action.ok_or_else(|| PyValueError::new_err(format!("{number} is not an action")))
    }

    /// Returns the exception of a predicate that is the cause of a fault.
    fn raised(&self, fault: &Diagnostic) -> Option<PyErr> {
        self.functions.as_ref()?.exception(fault)
    }

    fn error(&self, py: Python<'_>, fault: Diagnostic) -> PyErr {
        let raised = self.raised(&fault);
        raised.unwrap_or_else(|| input_error(py, &[fault], &self.sources))
    }

    fn run_traced(&self, city: &mut Simulation, ticks: u64, cancel: &Cancel, output: Output) -> Result<(), Failure> {
        if city.agents().len() > MAX_ENTITIES {
            return Err(Failure::Fault(too_many(city.agents().len(), "a trace")));
        }
        let writer = TraceWriter::new(output, city, &self.sources, &self.rule_files);
        let mut writer = writer.map_err(Failure::File)?;
        let done = run(city, ticks, cancel, |city| writer.tick(city).map_err(Failure::File));
        // After a failure, the trace keeps the earlier ticks.
        let written = writer.into_inner().finish().map_err(Failure::File);
        done.and(written)
    }
}

/// Runs ticks until the end or cancellation.
fn run(
    city: &mut Simulation,
    ticks: u64,
    cancel: &Cancel,
    mut record: impl FnMut(&Simulation) -> Result<(), Failure>,
) -> Result<(), Failure> {
    for _ in 0..ticks {
        if cancel.requested() {
            break;
        }
        city.tick(&[]).map_err(Failure::Fault)?;
        record(city)?;
    }
    Ok(())
}

fn too_many(agents: usize, what: &str) -> Diagnostic {
    let message = format!("too many agents for {what}: {agents}; the limit is {MAX_ENTITIES}");
    Diagnostic::new(codes::LIMIT_EXCEEDED, message)
}

/// Converts cells to an array with the columns row and column.
fn cells(py: Python<'_>, cells: impl ExactSizeIterator<Item = Cell>) -> Bound<'_, PyArray2<i32>> {
    let mut array = Array2::zeros((cells.len(), 2));
    for (mut row, cell) in array.rows_mut().into_iter().zip(cells) {
        (row[0], row[1]) = (cell.row, cell.col);
    }
    array.into_pyarray(py)
}

/// Converts indices into a short list to an array, with -1 for `None`.
fn codes(py: Python<'_>, positions: impl Iterator<Item = Option<usize>>) -> Bound<'_, PyArray1<i8>> {
    let code = |position: Option<usize>| position.and_then(|position| i8::try_from(position).ok()).unwrap_or(-1);
    positions.map(code).collect::<Array1<i8>>().into_pyarray(py)
}

fn heading(heading: Option<Heading>) -> Option<usize> {
    heading.and_then(|heading| Heading::ALL.iter().position(|known| *known == heading))
}
