//! The unpacked page of a run: its data equals the trace, and every explanation equals the engine's.

use base64::Engine as _;
use flate2::read::ZlibDecoder;
use logicity::cancel::Cancel;
use logicity::city::Cell;
use logicity::city::{Action, Split};
use logicity::datalog::explain::{Explainer, ExplanationPrinter};
use logicity::diag::{Code, Sources};
use logicity::page::Page;
use logicity::render::Icons;
use logicity::rng::Seed;
use logicity::sim::{Replay, Settings, Simulation, TraceHeader, TraceTick, TraceWriter, World};
use logicity::task::spf::{ControlMode, Env, Origin, RecordError, SpfTask, record};
use serde_json::{Value, json};
use std::io::Read;
use std::process::Command;
use std::sync::Arc;

use crate::shipped_world::with_sources;

/// A run of `ticks` ticks: its trace, and the route of every agent in every tick.
struct Run {
    world: Arc<World>,
    sources: Sources,
    trace: String,
    ways: Vec<Vec<Vec<Cell>>>,
}

fn run(config: &str, ticks: u64) -> Run {
    run_with(config, None, Seed(0), ticks)
}

fn run_with(config: &str, rules: Option<&str>, seed: Seed, ticks: u64) -> Run {
    let (world, sources) = with_sources(config, rules);
    let settings = Settings {
        count_firings: true,
        ..Settings::default()
    };
    let mut city = Simulation::new(Arc::clone(&world), Split::Test, seed, settings).unwrap();
    let rules = sources.ids().next().unwrap();
    let mut trace = TraceWriter::new(Vec::new(), &city, &sources, &[rules]).unwrap();
    let mut ways = Vec::new();
    for _ in 0..ticks {
        ways.push(
            city.agents()
                .iter()
                .map(|agent| agent.route().cells().collect())
                .collect(),
        );
        city.tick(&[]).unwrap();
        trace.tick(&city).unwrap();
    }
    Run {
        trace: String::from_utf8(trace.into_inner()).unwrap(),
        world,
        sources,
        ways,
    }
}

/// An episode in which the first car always takes this action, whatever the rules want. Also returns, for each step,
/// the observed agents, the wanted action, the violated clauses and the cell of the car.
fn drive(config: &str, seed: u64, action: Action) -> (Run, Vec<Value>) {
    let (world, sources) = with_sources(config, None);
    let task = Arc::new(SpfTask::new(Arc::clone(&world), &sources).unwrap());
    let mut env = Env::new(Arc::clone(&task), Split::Test, ControlMode::First).unwrap();
    env.reset(seed).unwrap();
    let episode = env.episode().clone();
    let (mut actions, mut steps) = (Vec::new(), Vec::new());
    while env.controlled_cars()[0].is_running() {
        let name = |agent: usize| env.city().agents()[agent].name().to_string();
        let observes: Vec<String> = env.controlled_cars()[0].observer().entities().map(name).collect();
        let (wanted, at) = (env.oracle_action(0).name(), env.city().agents()[0].cell);
        env.step(&[action]).unwrap();
        actions.push(action);
        let constraints = task.oracle().constraints();
        let position = |&constraint: &usize| {
            world
                .clauses()
                .position(|clause| clause == constraints[constraint].clause)
        };
        let broken: Option<Vec<usize>> = env.controlled_cars()[0].last().broken.iter().map(position).collect();
        steps.push(json!({"observes": observes, "wanted": wanted, "broken": broken.unwrap(), "at": [at.row, at.col]}));
    }
    let rules = world.scenario.rules.value.display().to_string();
    let rule_files: Vec<_> = sources.ids().skip_while(|id| sources.name(*id) != rules).collect();
    let origin = Origin {
        sources: &sources,
        rule_files: &rule_files,
    };
    let write = |actions: &[Action]| {
        let driven = (&episode, actions);
        record(&task, Split::Test, driven, origin, Vec::new(), &Cancel::never())
    };
    let trace = write(&actions).unwrap_or_else(|error| panic!("{error:?}"));
    // A policy must not act beyond the end of the episode.
    actions.push(action);
    let Err(RecordError::Fault(fault)) = write(&actions) else {
        panic!("the episode has ended")
    };
    assert_eq!(fault.code, Code::INVALID_VALUE);
    let run = Run {
        trace: String::from_utf8(trace).unwrap(),
        ways: Vec::new(),
        world,
        sources,
    };
    (run, steps)
}

impl Run {
    fn header(&self) -> TraceHeader {
        TraceHeader::read(self.trace.lines().next().unwrap()).unwrap()
    }

    fn replay(&self) -> Replay {
        Replay::new(Arc::clone(&self.world), &self.header()).unwrap()
    }

    fn ticks(&self) -> impl Iterator<Item = TraceTick> + '_ {
        self.trace.lines().skip(1).map(|line| TraceTick::read(line).unwrap())
    }

    fn page(&self) -> String {
        let mut replay = self.replay();
        let mut page = Page::new(&replay, &self.header(), &Icons::default(), &self.sources);
        for tick in self.ticks() {
            replay.set(&tick).unwrap();
            page.push(&replay, &tick, &self.sources).unwrap();
        }
        let mut out = Vec::new();
        page.write(&mut out).unwrap();
        String::from_utf8(out).unwrap()
    }
}

fn unpack(page: &str) -> Value {
    let (_, rest) = page.split_once(r#"<script id="data" type="text/plain">"#).unwrap();
    let packed = base64::engine::general_purpose::STANDARD
        .decode(rest.split_once('<').unwrap().0)
        .unwrap();
    let mut text = String::new();
    ZlibDecoder::new(&packed[..]).read_to_string(&mut text).unwrap();
    serde_json::from_str(&text).unwrap()
}

/// An explanation of the page, as a tree with the words of [`ExplanationPrinter::json`].
fn page_tree(data: &Value, number: i64) -> Value {
    let node = &data["nodes"][usize::try_from(number).unwrap()];
    let clause = |index: &Value| {
        let mut clause = data["clauses"][usize::try_from(index.as_u64().unwrap()).unwrap()].clone();
        let fields = clause.as_object_mut().unwrap();
        fields.retain(|name, _| ["head", "file", "line", "doc"].contains(&name.as_str()));
        clause
    };
    let literals = |list: &Value| -> Value {
        let one = |entry: &Value| {
            let child = entry[2].as_i64().unwrap();
            json!([entry[0], entry[1], (child >= 0).then(|| page_tree(data, child))])
        };
        list.as_array().unwrap().iter().map(one).collect()
    };
    match (node.get("t"), node.get("p"), node.get("m")) {
        (Some(text), Some(premises), _) => {
            json!([text, node["by"], clause(&node["c"]), node["b"], literals(premises)])
        }
        (Some(text), None, _) => json!([text, node["by"]]),
        (None, _, Some(misses)) => {
            let miss = |miss: &Value| json!([clause(&miss[0]), miss[1], literals(&miss[2])]);
            json!([
                node["f"],
                node["by"],
                misses.as_array().unwrap().iter().map(miss).collect::<Vec<_>>()
            ])
        }
        (None, ..) => json!([node["f"], node["by"]]),
    }
}

/// The same tree for an explanation of the engine.
fn engine_tree(nodes: &Value, number: u64) -> Value {
    let node = &nodes[usize::try_from(number).unwrap()];
    let literals = |list: &Value| -> Value {
        let one = |entry: &Value| {
            let child = entry
                .get("node")
                .map(|child| engine_tree(nodes, child.as_u64().unwrap()));
            json!([entry["literal"], entry["kind"], child])
        };
        list.as_array().unwrap().iter().map(one).collect()
    };
    match (node.get("holds"), node.get("premises"), node.get("clauses")) {
        (Some(text), Some(premises), _) => {
            json!([text, node["by"], node["clause"], node["binding"], literals(premises)])
        }
        (Some(text), None, _) => json!([text, node["by"]]),
        (None, _, Some(misses)) => {
            let miss = |miss: &Value| json!([miss["clause"], miss["binding"], literals(&miss["fails"])]);
            json!([
                node["absent"],
                node["because"],
                misses.as_array().unwrap().iter().map(miss).collect::<Vec<_>>()
            ])
        }
        (None, ..) => json!([node["absent"], node["because"]]),
    }
}

#[test]
fn a_page_shows_the_decisions_of_the_trace_and_why() {
    let run = run("expert", 25);
    let data = unpack(&run.page());
    let mut replay = run.replay();
    let mut rows: Vec<Value> = Vec::new();
    for (number, tick) in run.ticks().enumerate() {
        replay.set(&tick).unwrap();
        let shown = &data["ticks"][number];
        rows.resize(replay.facts().rows.len(), json!([]));
        for change in shown["facts"].as_array().unwrap() {
            rows[usize::try_from(change[0].as_u64().unwrap()).unwrap()] = change[1].clone();
        }
        for (predicate, (shown, rows)) in rows.iter().zip(&replay.facts().rows).enumerate() {
            let arity = usize::try_from(data["predicates"][predicate]["arity"].as_u64().unwrap()).unwrap();
            let flat: Vec<u32> = rows.iter().flat_map(|row| row[..arity].to_vec()).collect();
            assert_eq!(shown, &json!(flat), "predicate {predicate} in tick {number}");
        }
        let session = replay.session();
        let printer = ExplanationPrinter::new(session.program().rules(), session.symbols(), &run.sources);
        for (agent, state) in tick.agents.iter().enumerate() {
            let name = |list: &str, at: &Value| data[list][usize::try_from(at.as_u64().unwrap()).unwrap()].clone();
            assert_eq!(shown["at"][agent], json!(state.at));
            assert_eq!(shown["goal"][agent], json!(state.goal));
            assert_eq!(shown["fired"][agent], json!(state.clauses));
            assert_eq!(name("actions", &shown["action"][agent]), json!(state.action));
            match &state.heading {
                None => assert_eq!(shown["heading"][agent], json!(-1)),
                Some(heading) => assert_eq!(name("headings", &shown["heading"][agent]), json!(heading)),
            }
            for (action, number) in Action::ALL.into_iter().zip(shown["why"][agent].as_array().unwrap()) {
                let relation = run.world.vocabulary.action(action).unwrap();
                let (_, explanation) = (Explainer::new(session))
                    .explain_either(relation, &[Some(replay.value(agent))])
                    .unwrap();
                let nodes = printer.json(&explanation.unwrap())["nodes"].take().to_string();
                // A page names files without their folders.
                let nodes: Value = serde_json::from_str(&nodes.replace("\"file\":\"rules/", "\"file\":\"")).unwrap();
                assert_eq!(page_tree(&data, number.as_i64().unwrap()), engine_tree(&nodes, 0));
            }
        }
    }
    assert_eq!(data["ticks"].as_array().unwrap().len(), 25);
}

/// The corners that the page replans from start and goal equal those of the agent's route.
#[test]
fn routes_equal_the_driven_ones() {
    let run = run("expert", 250);
    let data = unpack(&run.page());
    let mut checked = 0;
    for (agent, routes) in data["routes"].as_array().unwrap().iter().enumerate() {
        for route in routes.as_array().unwrap() {
            let cell = |cell: &Value| Cell {
                row: i32::try_from(cell[0].as_i64().unwrap()).unwrap(),
                col: i32::try_from(cell[1].as_i64().unwrap()).unwrap(),
            };
            let corners: Vec<Cell> = route[1].as_array().unwrap().iter().map(cell).collect();
            // An agent that reaches its goal takes its next route within the tick.
            let since = usize::try_from(route[0].as_u64().unwrap()).unwrap();
            let way = &run.ways[since + usize::from(since > 0)][agent];
            let mut cells = vec![corners[0]];
            for pair in corners.windows(2) {
                let (rows, cols) = (pair[1].row - pair[0].row, pair[1].col - pair[0].col);
                assert!(rows == 0 || cols == 0, "the route is straight between corners");
                for step in 1..=rows.abs().max(cols.abs()) {
                    cells.push(Cell {
                        row: pair[0].row + step * rows.signum(),
                        col: pair[0].col + step * cols.signum(),
                    });
                }
            }
            assert_eq!(&cells, way, "agent {agent}");
            checked += 1;
        }
    }
    assert!(
        checked > run.header().agents.len(),
        "some agents have taken a second route"
    );
}

#[test]
fn the_page_shows_a_deadlock() {
    let run = run_with("expert", None, Seed(10), 300);
    let page = run.page();
    let data = unpack(&page);
    let deadlocks = data["deadlocks"].as_array().unwrap();
    let last = deadlocks.iter().find(|found| found["until"] == 299).unwrap();
    let position = |name: &str| run.header().agents.iter().position(|agent| agent.id == name).unwrap();
    assert_eq!(
        last["agents"],
        json!([position("Car_6"), position("Car_9"), position("Car_10")]),
        "as in the summary of `run`"
    );
    assert_eq!(last["since"], 5);
    assert!(page.len() < 500_000, "{} bytes", page.len());
}

#[test]
fn a_page_needs_no_other_file() {
    let page = run("easy", 3).page();
    for outside in ["http:", "https:", " src=", "url(", "import ", "fetch(", "<link"] {
        assert!(!page.contains(outside), "{outside}");
    }
}

/// The page distinguishes clauses with the same line and comment. Traces that were edited are errors.
#[test]
fn clauses_of_one_line_are_counted_separately() {
    let rules = "//! Two in one.\n.include \"vocabulary.dl\"\n// X: or\nStop(X) :- IsTiro(X); IsAmbulance(X).\nFast(X) :- IsBus(X).\n";
    let run = run_with("expert", Some(rules), Seed(0), 3);
    let data = unpack(&run.page());
    let counted = usize::try_from(data["counted"].as_u64().unwrap()).unwrap();
    assert_eq!(counted, run.world.clauses().count());
    let heads: Vec<&str> = (data["clauses"].as_array().unwrap()[..counted].iter())
        .map(|clause| clause["head"].as_str().unwrap())
        .collect();
    let rules = run.world.program.rules();
    let wanted: Vec<&str> = (run.world.clauses())
        .map(|clause| &*rules.relations[rules.clauses[clause.index()].head.relation.index()].name)
        .collect();
    assert_eq!(heads, wanted);
    assert_eq!(heads.iter().filter(|head| **head == "Stop").count(), 2);
    // The trace has every firing of the clauses that decide.
    for (clause, shown) in data["firings"].as_array().unwrap().iter().enumerate() {
        assert_eq!(shown[1], true);
        let fired = |agent: &Value| agent.as_array().unwrap().iter().any(|fired| *fired == clause);
        let ticks = data["ticks"].as_array().unwrap();
        let agents = ticks.iter().flat_map(|tick| tick["fired"].as_array().unwrap());
        assert_eq!(shown[0], agents.filter(|agent| fired(agent)).count());
    }
}

#[test]
fn ticks_are_consecutive() {
    let run = run("easy", 3);
    let mut replay = run.replay();
    let ticks: Vec<TraceTick> = run.ticks().collect();
    let push = |page: &mut Page, replay: &mut Replay, tick: &TraceTick| {
        replay.set(tick).unwrap();
        page.push(replay, tick, &run.sources)
    };
    let page = |replay: &Replay| Page::new(replay, &run.header(), &Icons::default(), &run.sources);
    let mut gap = page(&replay);
    push(&mut gap, &mut replay, &ticks[0]).unwrap();
    assert_eq!(
        push(&mut gap, &mut replay, &ticks[2]).unwrap_err().code,
        Code::INVALID_TRACE
    );
    assert_eq!(
        push(&mut gap, &mut replay, &ticks[0]).unwrap_err().code,
        Code::INVALID_TRACE
    );
    push(&mut gap, &mut replay, &ticks[1]).unwrap();
    let mut last = ticks[0].clone();
    last.tick = u64::MAX;
    assert_eq!(
        push(&mut page(&replay), &mut replay, &last).unwrap_err().code,
        Code::INVALID_TRACE
    );
}

#[test]
fn a_run_that_is_too_long_is_an_error() {
    let run = run("easy", 1);
    let mut replay = run.replay();
    let mut tick = run.ticks().next().unwrap();
    replay.set(&tick).unwrap();
    let mut page = Page::new(&replay, &run.header(), &Icons::default(), &run.sources);
    let agents = run.header().agents.len();
    page.set_limit(2 * agents);
    for number in 0..2 {
        tick.tick = number;
        page.push(&replay, &tick, &run.sources).unwrap();
    }
    tick.tick = 2;
    let fault = page.push(&replay, &tick, &run.sources).unwrap_err();
    assert_eq!(fault.code, Code::LIMIT_EXCEEDED);
}

/// For the driven car, trace and page show what the task computed in every step. For all other agents, they show what
/// the rules decide.
#[test]
fn the_trace_of_a_driven_car_matches_the_task() {
    let (mut broke, mut disobeyed, mut heeded) = (0, 0, 0);
    for (config, seed, action) in [
        ("easy", 3, Action::Fast),
        ("expert", 1, Action::Normal),
        ("expert", 4, Action::Fast),
        ("transfer-hard", 2, Action::Stop),
    ] {
        let (run, steps) = drive(config, seed, action);
        let data = unpack(&run.page());
        let names: Vec<String> = run.header().agents.into_iter().map(|agent| agent.id).collect();
        let shown = data["driven"].as_array().unwrap();
        assert_eq!(shown.len(), steps.len());
        let mut replay = run.replay();
        for (number, (tick, step)) in run.ticks().zip(&steps).enumerate() {
            replay.set(&tick).unwrap();
            let driven = &shown[number];
            assert_eq!((&driven["tick"], &driven["agent"]), (&json!(number), &json!(0)));
            assert_eq!(
                data["actions"][usize::try_from(driven["wanted"].as_u64().unwrap()).unwrap()],
                step["wanted"]
            );
            assert_eq!(driven["broken"], step["broken"]);
            let observes = driven["observes"].as_array().unwrap().iter();
            let observes: Vec<&String> = observes
                .map(|at| &names[usize::try_from(at.as_u64().unwrap()).unwrap()])
                .collect();
            assert_eq!(json!(observes), step["observes"]);
            assert_eq!(data["ticks"][number]["at"][0], step["at"]);
            for (agent, state) in tick.agents.iter().enumerate() {
                let derived: Vec<&str> = replay.derived(agent).iter().map(Action::name).collect();
                assert_eq!(
                    derived, state.derived,
                    "the derived actions do not depend on the driver"
                );
                assert_eq!(state.driven.is_some(), agent == 0);
                let by_rules = run.world.vocabulary.decide(replay.derived(agent));
                assert_eq!(state.action().unwrap(), if agent == 0 { action } else { by_rules });
            }
            let differs = step["wanted"] != action.name();
            disobeyed += usize::from(differs);
            heeded += usize::from(!differs);
            broke += usize::from(step["broken"] != json!([]));
        }
    }
    assert!(broke > 0 && disobeyed > 0 && heeded > 0, "{broke} {disobeyed} {heeded}");
}

#[test]
fn the_program_reads_the_trace_of_a_driven_car() {
    let (run, steps) = drive("expert", 4, Action::Fast);
    let folder = tempfile::tempdir().unwrap();
    let trace = folder.path().join("driven.jsonl");
    std::fs::write(&trace, &run.trace).unwrap();
    let logicity = |arguments: &[&str]| {
        let output = Command::new(env!("CARGO_BIN_EXE_logicity"))
            .args(arguments)
            .arg(&trace)
            .current_dir(folder.path())
            .output()
            .unwrap();
        let said = String::from_utf8(output.stderr).unwrap();
        assert!(output.status.success(), "{said}");
        String::from_utf8(output.stdout).unwrap()
    };
    let last = steps.last().unwrap();
    assert!(last["broken"] != json!([]), "the episode ends with a broken rule");
    let text = logicity(&["explain", "--agent", "Car_1"]);
    let wanted = last["wanted"].as_str().unwrap();
    assert!(
        text.starts_with("controlled externally: given its observation of (Car_1"),
        "{text}"
    );
    assert!(
        text.contains(&format!("the rules wanted {wanted}; its action violated S")),
        "{text}"
    );
    assert!(
        text.contains(&format!("the action came from outside; the rules say {wanted}")),
        "{text}"
    );
    let shown: Value = serde_json::from_str(&logicity(&["explain", "--json", "--agent", "Car_1"])).unwrap();
    for key in ["observes", "wanted", "broken"] {
        assert_eq!(shown["driven"][key], last[key]);
    }
    let other: Value = serde_json::from_str(&logicity(&["explain", "--json", "--agent", "Car_2"])).unwrap();
    assert!(other.get("driven").is_none());
    assert!(logicity(&["view"]).contains("wrote city.html"));
    let page = std::fs::read_to_string(folder.path().join("city.html")).unwrap();
    assert_eq!(unpack(&page)["driven"], unpack(&run.page())["driven"]);
    let covered = logicity(&["check", "--coverage"]);
    assert!(
        covered.contains(&format!("coverage: {} ticks", steps.len())),
        "{covered}"
    );
}

/// A trace whose record of a driven car does not fit its rules or agents is an error.
#[test]
fn an_impossible_record_of_a_driven_car_is_an_error() {
    let (run, _) = drive("easy", 3, Action::Fast);
    let mut replay = run.replay();
    for (key, wrong) in [
        ("broken", json!([99])),
        ("wanted", json!("Fly")),
        ("observes", json!(["Car_1", "Car_99"])),
    ] {
        let mut tick: Value = serde_json::from_str(run.trace.lines().nth(1).unwrap()).unwrap();
        tick["agents"][0]["driven"][key] = wrong;
        let tick = TraceTick::read(&tick.to_string()).unwrap();
        replay.set(&tick).unwrap();
        let mut page = Page::new(&replay, &run.header(), &Icons::default(), &run.sources);
        let fault = page.push(&replay, &tick, &run.sources).unwrap_err();
        assert_eq!(fault.code, Code::INVALID_TRACE, "{key}");
    }
}
