//! The unpacked page of a run: its data equals the trace, and every explanation equals the engine's.

use base64::Engine as _;
use flate2::read::ZlibDecoder;
use logicity::cancel::Cancel;
use logicity::city::{Action, Cell, Split, field_of_view};
use logicity::datalog::explain::{Explainer, ExplanationPrinter};
use logicity::diag::{self, Sources};
use logicity::page::{Comparison, LIVE_TICKS, Live, Page};
use logicity::render::{Class, Difficulty, Icons, Overview, Renderer, Scale, Sprite, Viewport, write_png};
use logicity::rng::Seed;
use logicity::sim::codes;
use logicity::sim::{Replay, Settings, Simulation, TraceHeader, TraceTick, TraceWriter, World};
use logicity::task::spf::{ControlMode, Env, Origin, RecordError, SpfTask, record};
use logicity::yaml;
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io::Read;
use std::process::Command;
use std::sync::Arc;

use crate::shipped_world::{configured, with_sources};

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
    run_in(with_sources(config, rules), seed, ticks)
}

fn run_in((world, sources): (Arc<World>, Sources), seed: Seed, ticks: u64) -> Run {
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
    assert_eq!(fault.code, yaml::codes::INVALID_VALUE);
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
        written(|out| self.loaded().write(out))
    }

    fn loaded(&self) -> Page {
        let mut replay = self.replay();
        let mut page = Page::new(&replay, &self.header(), &Icons::default(), &self.sources).unwrap();
        for tick in self.ticks() {
            replay.set(&tick).unwrap();
            page.push(&replay, &tick, &self.sources).unwrap();
        }
        page
    }
}

/// A picture with a number shows the state that the tick with this number decided, and its actions, as the trace, the
/// page and `explain` do.
#[test]
fn pictures_pages_traces_and_explanations_number_ticks_alike() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let logicity = |arguments: &[&str]| -> String {
        let command = Command::new(env!("CARGO_BIN_EXE_logicity")).args(arguments).output();
        let output = command.unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        String::from_utf8(output.stdout).unwrap()
    };
    let (out, html, trace) = (path("out"), path("page.html"), path("out/trace.jsonl"));
    let options = ["--seed", "3", "--ticks", "7", "--out", &out, "--html", &html];
    logicity(&[&["run", "expert"], &options[..]].concat());

    let world = crate::shipped_world::world("expert", None, |_| ());
    let mut city = Simulation::new(Arc::clone(&world), Split::Test, Seed(3), Settings::default()).unwrap();
    for _ in 0..6 {
        city.tick(&[]).unwrap();
    }
    let names: Vec<String> = city.agents().iter().map(|agent| agent.name().to_string()).collect();
    let before = city.agents().to_vec();
    city.tick(&[]).unwrap();
    let decided: Vec<Action> = city.report().agents.iter().map(|done| done.action).collect();
    let agents = before.iter().zip(&names).zip(&decided);
    let sprites: Vec<Sprite<'_>> = agents
        .map(|((agent, name), action)| Sprite::of(agent, name, Some(*action)))
        .collect();
    let icons = Arc::new(Icons::new(Seed(3), Difficulty::default()));
    let picture = Overview::new(world.map(), icons).unwrap().draw(6, &sprites);
    let mut expected = Vec::new();
    write_png(&picture, &mut expected).unwrap();
    assert!(
        fs::read(path("out/last.png")).unwrap() == expected,
        "the picture of tick 6"
    );
    let mut frames = gif::DecodeOptions::new()
        .read_info(fs::File::open(path("out/city.gif")).unwrap())
        .unwrap();
    let count = std::iter::from_fn(|| frames.read_next_frame().unwrap().map(|_| ())).count();
    assert_eq!(count, 7, "one frame for each tick");

    let text = fs::read_to_string(&trace).unwrap();
    let ticks: Vec<TraceTick> = text
        .lines()
        .skip(1)
        .map(|line| TraceTick::read(line).unwrap())
        .collect();
    assert_eq!((ticks.len(), ticks[6].tick), (7, 6));
    let shown = unpack(&fs::read_to_string(&html).unwrap());
    assert_eq!((&shown["first"], &shown["count"]), (&json!(0), &json!(7)));
    for (agent, sprite) in sprites.iter().enumerate() {
        let state: Value = serde_json::from_str(text.lines().last().unwrap()).unwrap();
        let at = json!([sprite.at.row, sprite.at.col]);
        assert_eq!(state["agents"][agent]["at"], at);
        assert_eq!(shown["ticks"][6]["at"][agent], at);
        assert_eq!(shown["ticks"][6]["action"][agent], json!(decided[agent].index()));
    }
    let proof = logicity(&["explain", &trace, "--agent", &names[0]]);
    let place = format!(
        "tick 6: {} at [{}, {}]",
        names[0], before[0].cell.row, before[0].cell.col
    );
    assert!(proof.starts_with(&place), "{proof}");
}

/// A trace contains the drawings of its configuration: a page of the trace alone shows them.
#[test]
fn a_page_shows_the_pictures_that_its_trace_records() {
    let folder = tempfile::tempdir().unwrap();
    let config = "base: expert\npredicates: {define: {IsTaxi: {concept: taxi, of: Car, picture: taxi.svg}}}\n\
                  agents: {test: {cars: [{priority: 1, concepts: [taxi], count: 2}, {priority: 2}]}}\n";
    let svg = |color: &str| {
        let start = r#"<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 20 50">"#;
        format!(r#"{start}<rect width="20" height="50" fill="{color}"/></svg>"#)
    };
    let logicity = |arguments: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_logicity"));
        let output = command.args(arguments).current_dir(folder.path()).output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    };
    let cars = |page: &str| {
        let page = fs::read_to_string(folder.path().join(page)).unwrap();
        let (.., scenery) = parts(&page).into_iter().find(|(kind, ..)| kind == "scenery").unwrap();
        scenery["atlases"][0]["png"].as_str().unwrap().to_owned()
    };
    fs::write(folder.path().join("city.yaml"), config).unwrap();
    let run = [
        "run",
        "city.yaml",
        "--ticks",
        "2",
        "--no-pictures",
        "--html",
        "run.html",
    ];
    let mut seen = BTreeSet::new();
    for color in ["red", "blue"] {
        fs::write(folder.path().join("taxi.svg"), svg(color)).unwrap();
        logicity(&run);
        fs::remove_file(folder.path().join("taxi.svg")).unwrap();
        logicity(&["view", "out/trace.jsonl", "-o", "view.html"]);
        assert_eq!(cars("run.html"), cars("view.html"));
        seen.insert(cars("view.html"));
    }
    assert_eq!(seen.len(), 2, "the drawings differ");
}

fn written(write: impl FnOnce(&mut Vec<u8>) -> std::io::Result<()>) -> String {
    let mut out = Vec::new();
    write(&mut out).unwrap();
    String::from_utf8(out).unwrap()
}

/// Returns the parts of a page: kind, run, data.
fn parts(page: &str) -> Vec<(String, usize, Value)> {
    let mut parts = Vec::new();
    for part in page
        .split(r#"<script class="data" type="text/plain" data-kind=""#)
        .skip(1)
    {
        let (kind, rest) = part.split_once(r#"" data-run=""#).unwrap();
        let (run, rest) = rest.split_once(r#"">"#).unwrap();
        let packed = base64::engine::general_purpose::STANDARD
            .decode(rest.split_once('<').unwrap().0)
            .unwrap();
        let mut text = String::new();
        ZlibDecoder::new(&packed[..]).read_to_string(&mut text).unwrap();
        parts.push((
            kind.to_owned(),
            run.parse().unwrap(),
            serde_json::from_str(&text).unwrap(),
        ));
    }
    parts
}

fn unpack(page: &str) -> Value {
    unpack_run(page, 0)
}

/// Returns the data of a run with all ticks unfolded.
fn unpack_run(page: &str, number: usize) -> Value {
    let parts = parts(page);
    let of = |wanted: &str| {
        let wanted = wanted.to_owned();
        let found = parts
            .iter()
            .filter(move |(kind, run, _)| *kind == wanted && *run == number);
        found.map(|(_, _, data)| data)
    };
    let mut run = of("run").next().unwrap().clone();
    let all = |key: &str| -> Vec<Value> { of("proofs").flat_map(|part| list(&part[key]).to_vec()).collect() };
    let (whys, changes) = (all("why"), all("facts"));
    let agents = list(&run["agents"]).len();
    let arities: Vec<usize> = list(&run["predicates"])
        .iter()
        .map(|one| whole(&one["arity"]))
        .collect();
    let mut rows: Vec<BTreeSet<usize>> = vec![BTreeSet::new(); arities.len()];
    let mut why = vec![[0_i64; 4]; agents];
    let mut at = vec![[0_i64; 2]; agents];
    let mut goal = vec![Value::Null; agents];
    let digit = |key: &str, agent: usize, tick: usize| {
        let digit = run[key][agent].as_str().unwrap().chars().nth(tick).unwrap();
        digit.to_digit(16).unwrap()
    };
    let mut ticks = Vec::new();
    for tick in 0..whole(&run["count"]) {
        let mut state: BTreeMap<&str, Vec<Value>> = BTreeMap::new();
        for agent in 0..agents {
            for (axis, place) in at[agent].iter_mut().enumerate() {
                *place += run["at"][agent][2 * tick + axis].as_i64().unwrap();
            }
            for (action, node) in why[agent].iter_mut().enumerate() {
                *node += whys[tick][4 * agent + action].as_i64().unwrap();
            }
            if let Some(new) = list(&run["goal"][agent]).iter().find(|new| new[0] == tick) {
                goal[agent] = json!([new[1], new[2]]);
            }
            let heading = match digit("heading", agent, tick) {
                4 => -1,
                heading => i64::from(heading),
            };
            let offsets = &run["views"][whole(&run["view"][agent][tick])];
            let corner = |at: usize| at_i64(offsets, at);
            let [row, col] = at[agent];
            for (key, value) in [
                ("at", json!(at[agent])),
                ("goal", goal[agent].clone()),
                ("heading", json!(heading)),
                ("action", json!(digit("action", agent, tick))),
                ("derived", json!(digit("derived", agent, tick))),
                ("fired", run["fired_sets"][whole(&run["fired"][agent][tick])].clone()),
                ("why", json!(why[agent])),
                (
                    "view",
                    json!([row + corner(0), col + corner(1), row + corner(2), col + corner(3)]),
                ),
            ] {
                state.entry(key).or_default().push(value);
            }
        }
        for change in list(&changes[tick]) {
            let predicate = whole(&change[0]);
            let mut row = 0;
            for step in &list(change)[1..] {
                row += whole(step);
                if !rows[predicate].remove(&row) {
                    rows[predicate].insert(row);
                }
            }
        }
        let flat = |(rows, arity): (&BTreeSet<usize>, &usize)| -> Value {
            let row = |&row: &usize| match arity {
                2 => vec![row / agents, row % agents],
                _ => vec![row],
            };
            rows.iter().flat_map(row).collect()
        };
        let mut state = json!(state);
        state["rows"] = rows.iter().zip(&arities).map(flat).collect();
        ticks.push(state);
    }
    run["ticks"] = ticks.into();
    run["nodes"] = all("nodes").into();
    run
}

fn list(value: &Value) -> &[Value] {
    value.as_array().unwrap()
}

fn whole(value: &Value) -> usize {
    usize::try_from(value.as_u64().unwrap()).unwrap()
}

fn at_i64(value: &Value, at: usize) -> i64 {
    value[at].as_i64().unwrap()
}

/// Returns the name of a rule file as the page has it.
fn shown_file(file: &Value) -> Value {
    let file = file.as_str().unwrap();
    match file.starts_with("<builtin>") {
        true => json!(file),
        false => json!(file.rsplit('/').next()),
    }
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
        (Some(text), None, _) => json!([text, node["by"], node["w"]]),
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
    let clause = |clause: &Value| {
        let mut clause = clause.clone();
        clause["file"] = shown_file(&clause["file"]);
        clause
    };
    match (node.get("holds"), node.get("premises"), node.get("clauses")) {
        (Some(text), Some(premises), _) => {
            json!([
                text,
                node["by"],
                clause(&node["clause"]),
                node["binding"],
                literals(premises)
            ])
        }
        (Some(text), None, _) => json!([text, node["by"], node["when"]]),
        (None, _, Some(misses)) => {
            let miss = |miss: &Value| json!([clause(&miss["clause"]), miss["binding"], literals(&miss["fails"])]);
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
    for (number, tick) in run.ticks().enumerate() {
        replay.set(&tick).unwrap();
        let shown = &data["ticks"][number];
        for (predicate, rows) in replay.facts().rows.iter().enumerate() {
            let arity = whole(&data["predicates"][predicate]["arity"]);
            let mut rows = rows.clone();
            rows.sort_unstable();
            let flat: Vec<u32> = rows.iter().flat_map(|row| row[..arity].to_vec()).collect();
            let shown = &shown["rows"][predicate];
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
            let seen = field_of_view(
                Cell::new(state.at[0], state.at[1]),
                state.heading().unwrap(),
                run.world.scenario.view,
                run.world.map(),
            );
            let view = json!([seen.first.row, seen.first.col, seen.last.row, seen.last.col]);
            assert_eq!(shown["view"][agent], view);
            match &state.heading {
                None => assert_eq!(shown["heading"][agent], json!(-1)),
                Some(heading) => assert_eq!(name("headings", &shown["heading"][agent]), json!(heading)),
            }
            for (action, number) in Action::STANDARD
                .into_iter()
                .zip(shown["why"][agent].as_array().unwrap())
            {
                let declared = run.world.vocabulary.action(action).unwrap();
                let (_, explanation) = (Explainer::new(session))
                    .explain_either(declared, &[Some(replay.value(agent))])
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

/// A running city shows the decisions and the explanations that the page of its run shows.
#[test]
fn a_live_city_equals_the_page_of_its_run() {
    let run = run("expert", 60);
    let data = unpack(&run.page());
    let mut live = live("expert");
    let header = json!(live.header());
    for key in ["agents", "predicates", "clauses", "actions", "headings", "counted"] {
        assert_eq!(header[key], data[key], "{key}");
    }
    let mut compared = 0;
    for number in 0..60 {
        let (tick, shown) = (json!(live.tick().unwrap()), &data["ticks"][number]);
        assert_eq!(tick["tick"], number);
        for key in ["at", "goal", "action", "derived", "fired"] {
            assert_eq!(tick[key], shown[key], "{key} in tick {number}");
        }
        for agent in 0..list(&tick["at"]).len() {
            let heading = tick["heading"][agent].as_i64().unwrap_or(-1);
            assert_eq!(json!(heading), shown["heading"][agent]);
            let [row, col] = [0, 1].map(|axis| at_i64(&tick["at"][agent], axis));
            let from = |at: usize| at_i64(&tick["view"][agent], at);
            let view = json!([row + from(0), col + from(1), row + from(2), col + from(3)]);
            assert_eq!(view, shown["view"][agent]);
            if let Some(next) = data["ticks"].get(number + 1) {
                assert_eq!(tick["next"][agent], next["at"][agent]);
            }
            // The first route begins in the first tick; another one is new if start or goal differ.
            let way = |tick: usize| &run.ways[tick][agent];
            let is_new = number == 0 || way(number) != way(number - 1);
            assert_eq!(tick["ways"][agent].is_array(), is_new, "agent {agent} in tick {number}");
            if is_new {
                // An agent that set out in the tick before has left the start.
                let (corners, goal) = (list(&tick["ways"][agent]), way(number).last().unwrap());
                assert_eq!(corners.first(), Some(&tick["at"][agent]));
                assert_eq!(corners.last(), Some(&json!([goal.row, goal.col])));
            }
            compared += compare_explanations(&mut live, (&header, &data), number, agent);
        }
    }
    // The last ticks can be explained in any order.
    for number in [59, 0, 31] {
        compared += compare_explanations(&mut live, (&header, &data), number, 3);
    }
    assert!(compared > 4000, "{compared}");
    assert!(live.explain(60, 0).unwrap().is_none() && live.explain(3, 99).unwrap().is_none());
    let cells = |tick| -> Option<Value> {
        let agents = live.agents_before(tick)?.iter();
        Some(agents.map(|agent| json!([agent.cell.row, agent.cell.col])).collect())
    };
    assert_eq!(cells(31).unwrap(), data["ticks"][31]["at"]);
    assert!(cells(60).is_some() && cells(61).is_none());
}

fn live(config: &str) -> Live {
    live_in(with_sources(config, None))
}

fn live_in((world, sources): (Arc<World>, Sources)) -> Live {
    let settings = Settings {
        count_firings: true,
        ..Settings::default()
    };
    let city = Simulation::new(world, Split::Test, Seed(0), settings).unwrap();
    let rules = sources.ids().next().unwrap();
    Live::new(city, sources, &[rules]).unwrap()
}

/// Compares the explanations and the rows of a tick with those of a page, and returns the number of explanations.
fn compare_explanations(live: &mut Live, (header, data): (&Value, &Value), tick: usize, agent: usize) -> usize {
    let explained = json!(live.explain(tick as u64, agent).unwrap().unwrap());
    let shown = &data["ticks"][tick];
    assert_eq!((&explained["tick"], &explained["agent"]), (&json!(tick), &json!(agent)));
    let own = json!({"nodes": explained["nodes"], "clauses": header["clauses"]});
    for (node, known) in list(&explained["why"]).iter().zip(list(&shown["why"][agent])) {
        let [tree, known] = [(&own, node), (data, known)].map(|(of, node)| page_tree(of, node.as_i64().unwrap()));
        assert_eq!(tree, known, "agent {agent} in tick {tick}");
    }
    let agents = list(&data["agents"]).len();
    for (predicate, rows) in list(&explained["rows"]).iter().enumerate() {
        let flat = list(rows).iter().map(whole).flat_map(|row| {
            let is_binary = data["predicates"][predicate]["arity"] == 2;
            if is_binary {
                vec![row / agents, row % agents]
            } else {
                vec![row]
            }
        });
        assert_eq!(json!(flat.collect::<Vec<_>>()), shown["rows"][predicate]);
    }
    list(&explained["why"]).len()
}

/// The page and a running city show the quantities of an agent, of the city, and of an agent and those that it sees.
#[test]
fn a_page_shows_the_values_of_quantities() {
    let config = "base: expert\ntask: ~\npredicates:\n  define:\n    Waited: {quantity: waited}\n    \
                  Clock: {quantity: tick}\n    Gap: {quantity: distance}\n    Heading: {quantity: heading}\n";
    let rules = ".include \"vocabulary.dl\"\n\
                 .decl Waited(x: agent, ticks: number)\n.decl Clock(tick: number)\n\
                 .decl Gap(x: agent, y: agent, cells: float)\n.decl Heading(x: agent, to: symbol)\n\
                 .input Waited, Clock, Gap, Heading\n\
                 Stop(X) :- Gap(X, Y, D), D < 4.0.\nSlow(X) :- Waited(X, N), N > 3.\n";
    let run = run_in(configured(config, rules, |_| ()), Seed(0), 12);
    let page = run.page();
    let data = unpack(&page);
    let parts = parts(&page);
    let proofs = parts.iter().filter(|(kind, ..)| kind == "proofs");
    let values: Vec<&Value> = proofs.flat_map(|(.., part)| list(&part["values"])).collect();
    assert_eq!(values.len(), 12);
    let mut live = live_in(configured(config, rules, |_| ()));
    let mut replay = run.replay();
    let agents = list(&data["agents"]).len();
    let mut counts = BTreeMap::new();
    for (tick, shown) in run.ticks().zip(values) {
        replay.set(&tick).unwrap();
        live.tick().unwrap();
        let explained = json!(live.explain(tick.tick, 0).unwrap().unwrap());
        assert_eq!(explained["values"], *shown);
        let mut expected = Vec::new();
        let facts = replay.facts();
        for (index, predicate) in list(&data["predicates"]).iter().enumerate() {
            let Some(quantity) = predicate.get("quantity") else {
                continue;
            };
            let mut rows = Vec::new();
            for (&[x, y], value) in facts.rows[index].iter().zip(&facts.values[index]) {
                let (x, y) = (x as usize, y as usize);
                let (number, value) = match quantity.as_str().unwrap() {
                    "tick" => (0, json!(tick.tick)),
                    "waited" => (x, json!(value.as_number())),
                    "heading" => (x, json!(tick.agents[x].heading)),
                    "distance" => {
                        let sees = facts.rows[run.world.vocabulary.sees].contains(&[x as u32, y as u32]);
                        if !sees {
                            continue;
                        }
                        let [[row, col], [to_row, to_col]] = [x, y].map(|agent| tick.agents[agent].at);
                        let distance = f64::from(row - to_row).hypot(f64::from(col - to_col));
                        (x * agents + y, json!(distance as f32))
                    }
                    other => panic!("{other}"),
                };
                *counts.entry(quantity.to_string()).or_insert(0) += 1;
                rows.push(json!([number, value]));
            }
            expected.push(json!([index, rows]));
        }
        assert_eq!(*shown, json!(expected), "tick {}", tick.tick);
    }
    assert!(
        counts.len() == 4 && counts.values().all(|count| *count >= 12),
        "{counts:?}"
    );
}

/// The page has the zones of the map, and that of a map without zones has none.
#[test]
fn a_page_shows_the_zones_of_the_map() {
    let zones = |config: &str| {
        let page = run(config, 1).page();
        let parts = parts(&page);
        let (.., scenery) = parts.into_iter().find(|(kind, ..)| kind == "scenery").unwrap();
        scenery["map"].get("zones").cloned()
    };
    assert_eq!(zones("expert"), None);
    let rails = zones("tram-line").unwrap();
    let expected = json!([{
        "name": "rails", "color": "#0072b2", "dash": [1, 0], "bands": [[92, []], [11, [[0, 241]]], [138, []]],
    }]);
    assert_eq!(rails, expected);
}

#[test]
fn a_live_city_keeps_its_last_ticks() {
    let mut live = live("easy");
    for _ in 0..LIVE_TICKS + 3 {
        live.tick().unwrap();
    }
    assert!(live.explain(2, 0).unwrap().is_none() && live.agents_before(2).is_none());
    assert!(live.explain(3, 0).unwrap().is_some() && live.agents_before(3).is_some());
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
    assert!(page.len() < 600_000, "{} bytes", page.len());
}

/// Explanations of a long run are in several parts. Nodes keep their numbers.
#[test]
fn a_long_run_has_several_parts_with_explanations() {
    let page = run("easy", 230).page();
    let proofs = parts(&page).into_iter().filter(|(kind, ..)| kind == "proofs").count();
    assert!(proofs >= 3, "{proofs}");
    let data = unpack(&page);
    let nodes = list(&data["nodes"]);
    for tick in list(&data["ticks"]) {
        for node in list(&tick["why"]).iter().flat_map(list) {
            let node = &nodes[usize::try_from(node.as_i64().unwrap()).unwrap()];
            assert!(node.get("t").or(node.get("f")).is_some());
        }
    }
}

/// The ground of the page is that of the pictures, and every building has its icon.
#[test]
fn the_page_has_the_ground_and_the_buildings_of_the_pictures() {
    let run = run("easy", 1);
    let (map, icons) = (run.world.map(), Icons::default());
    let page = run.page();
    let (_, _, scenery) = parts(&page).into_iter().find(|(kind, ..)| kind == "scenery").unwrap();
    let side = 8;
    let view = Viewport::whole(map, Scale::pixels(side).unwrap()).unwrap();
    let renderer = Renderer::new(map, Arc::new(icons), view);
    let ground = renderer.ground();
    let pixel = |x: u32, y: u32| -> [u8; 3] {
        let at = 3 * (y as usize * ground.width() as usize + x as usize);
        ground.pixels()[at..at + 3].try_into().unwrap()
    };
    let (mut row, mut checked) = (0, 0);
    let code = |surface: u64| {
        scenery["map"]["surfaces"][usize::try_from(surface % 8).unwrap()]
            .as_str()
            .unwrap()
    };
    for band in list(&scenery["map"]["bands"]) {
        for _ in 0..whole(&band[0]) {
            let mut col = 0;
            for run in list(&band[1]) {
                for _ in 0..whole(&run[1]) {
                    let surface = code(run[0].as_u64().unwrap());
                    let color = match surface {
                        "meadow" | "sidewalk" => surface,
                        "asphalt" => "asphalt",
                        "crossing along row" if col % 2 == 0 => "paint",
                        "crossing along column" if row % 2 == 0 => "paint",
                        "crossing along row" | "crossing along column" => "asphalt",
                        "mid line along row" if col % 5 < 3 => "mid line",
                        "mid line along column" if row % 5 < 3 => "mid line",
                        "mid line along row" | "mid line along column" => "asphalt",
                        _ => {
                            assert_eq!(surface, "building");
                            col += 1;
                            continue;
                        }
                    };
                    // The middle of an unmarked cell, or of the half beside a curb or a stop line.
                    let sides = run[0].as_u64().unwrap() / 8;
                    let (x, y) = ((sides & 1) as u32 * 2, (sides >> 2 & 1) as u32 * 2);
                    let (x, y) = (col * side + 3 + x, row * side + 3 + y);
                    let wanted = scenery["map"]["colors"][color].as_str().unwrap();
                    for (channel, found) in (0..3).zip(pixel(x, y)) {
                        let wanted = u8::from_str_radix(&wanted[1 + 2 * channel..3 + 2 * channel], 16).unwrap();
                        assert!(
                            found.abs_diff(wanted) <= 32,
                            "{surface} at [{row}, {col}]: {wanted} {found}"
                        );
                    }
                    (checked, col) = (checked + 1, col + 1);
                }
            }
            assert_eq!(col, u32::try_from(map.cols()).unwrap());
            row += 1;
        }
    }
    assert_eq!(row, u32::try_from(map.rows()).unwrap());
    assert!(checked > 40_000, "{checked}");
    let buildings = &scenery["atlases"][2];
    let bytes = base64::engine::general_purpose::STANDARD
        .decode(buildings["png"].as_str().unwrap())
        .unwrap();
    assert!(bytes.starts_with(b"\x89PNG"));
    let sites = list(&scenery["map"]["sites"]);
    assert_eq!(sites.len(), 100);
    for site in sites {
        let cell = Cell::new(
            i32::try_from(at_i64(site, 2)).unwrap(),
            i32::try_from(at_i64(site, 3)).unwrap(),
        );
        let building = map.building_at(cell).unwrap();
        assert_eq!(site[1], Class::building(building).to_string());
        assert_eq!(
            map.building_at(Cell::new(cell.row - 1, cell.col)),
            None,
            "the site begins at {cell:?}"
        );
    }
}

/// A page does not show the folders of its author.
#[test]
fn a_page_names_no_folder_of_the_author() {
    let folder = tempfile::tempdir().unwrap();
    let home = folder.path().join("home-of-the-author");
    std::fs::create_dir_all(home.join("lib")).unwrap();
    std::fs::write(home.join("lib/inner.dl"), "Slow(X) :- IsTiro(X).\n").unwrap();
    let rules = "//! Mine.\n.include \"vocabulary.dl\"\n.include \"lib/inner.dl\"\nStop(X) :- IsAmbulance(X).\n";
    std::fs::write(home.join("mine.dl"), rules).unwrap();
    let path = |name: &str| home.join(name).display().to_string();
    let (rules, out, page) = (path("mine.dl"), path("out"), path("page.html"));
    let output = Command::new(env!("CARGO_BIN_EXE_logicity"))
        .args([
            "run",
            "expert",
            "--ticks",
            "3",
            "--no-pictures",
            "--rules",
            &rules,
            "--out",
            &out,
            "--html",
            &page,
        ])
        .current_dir(folder.path())
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let page = std::fs::read_to_string(page).unwrap();
    let data = unpack(&page);
    for text in std::iter::once(page.clone()).chain(parts(&page).into_iter().map(|(_, _, data)| data.to_string())) {
        assert!(!text.contains("home-of-the-author"));
    }
    let files: BTreeSet<&str> = list(&data["clauses"])
        .iter()
        .map(|clause| clause["file"].as_str().unwrap())
        .collect();
    assert!(files.contains("mine.dl") && files.contains("inner.dl"), "{files:?}");
    assert_eq!(data["rules"], "mine.dl");
}

/// Two runs: the page has both with their explanations, and every decision in which they differ.
#[test]
fn a_comparison_marks_every_difference() {
    let rules = "//! Less.\n.include \"vocabulary.dl\"\n// S7: queue\nStop(X) :- CollidingClose(X, Y).\n";
    let (left, right) = (run("expert", 30), run_with("expert", Some(rules), Seed(0), 20));
    compare(&left, &right, "\n`right` ends with tick 19; later ticks are not shown");
    // An action in tick 3, and another agent in another cell in tick 6.
    let (left, mut right) = (run("expert", 10), run("expert", 10));
    let mut lines: Vec<Value> = right
        .trace
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    let action = &mut lines[4]["agents"][2]["action"];
    *action = json!(if *action == "Fast" { "Stop" } else { "Fast" });
    lines[7]["agents"][5]["at"] = json!([60, 60]);
    right.trace = lines.iter().map(|line| format!("{line}\n")).collect();
    let differences = compare(&left, &right, "");
    assert_eq!(
        differences,
        json!([{"tick": 3, "acts": [2], "apart": []}, {"tick": 6, "acts": [], "apart": [5]}])
    );
}

/// Two policies in one episode, which is as long as the policy lets it be.
#[test]
fn two_policies_are_compared() {
    let ((fast, _), (normal, _)) = (drive("expert", 4, Action::Fast), drive("expert", 4, Action::Normal));
    let counts = [fast.ticks().count(), normal.ticks().count()];
    let (long, short) = if counts[0] > counts[1] {
        (fast, normal)
    } else {
        (normal, fast)
    };
    let last = counts.into_iter().min().unwrap() - 1;
    assert_ne!(counts[0], counts[1]);
    compare(
        &long,
        &short,
        &format!("\n`right` ends with tick {last}; later ticks are not shown"),
    );
}

/// Checks the page of two runs and the summary, which ends with the given text. Returns the differences.
fn compare(left: &Run, right: &Run, end: &str) -> Value {
    let pages = [left.loaded(), right.loaded()];
    let names = ["left", "right"].map(str::to_owned);
    let comparison = Comparison::new([&pages[0], &pages[1]], names).unwrap();
    let page = written(|out| comparison.write(out));
    let (_, _, pair) = parts(&page).into_iter().find(|(kind, ..)| kind == "pair").unwrap();
    assert_eq!(pair["names"], json!(["left", "right"]));
    let count = right.ticks().count();
    assert_eq!(pair["count"], count);
    let (mut wanted, mut decisions, mut first) = (Vec::new(), 0, None);
    for (tick, (one, other)) in left.ticks().zip(right.ticks()).enumerate() {
        let both = || one.agents.iter().zip(&other.agents).enumerate();
        let acts: Vec<usize> = (both().filter(|(_, (a, b))| a.action != b.action))
            .map(|(at, _)| at)
            .collect();
        let apart: Vec<usize> = both().filter(|(_, (a, b))| a.at != b.at).map(|(at, _)| at).collect();
        decisions += acts.len();
        if wanted.is_empty()
            && let Some(&agent) = acts.first()
        {
            let id = &left.header().agents[agent].id;
            let actions = [&one, &other].map(|tick| &*tick.agents[agent].action);
            let [one, other] = actions;
            first = Some(format!("{tick}: {id} chooses {one} in one run, {other} in the other"));
        }
        if !acts.is_empty() || !apart.is_empty() {
            wanted.push(json!({"tick": tick, "acts": acts, "apart": apart}));
        }
    }
    assert_eq!(pair["differences"], json!(wanted));
    let total = count * left.header().agents.len();
    let first = first.expect("the first difference is an action");
    assert_eq!(
        comparison.summary(),
        format!("the runs differ in {decisions} of {total} decisions, first in tick {first}{end}")
    );
    for (number, run) in [left, right].into_iter().enumerate() {
        assert_eq!(
            unpack_run(&page, number),
            unpack(&run.page()),
            "each run is as on its own page"
        );
    }
    pair["differences"].clone()
}

/// Runs of other maps or agents are not compared.
#[test]
fn runs_of_other_cities_are_not_compared() {
    let fault = |left: &Run, right: &Run| {
        let (one, other) = (left.loaded(), right.loaded());
        let fault = Comparison::new([&one, &other], ["a", "b"].map(str::to_owned))
            .err()
            .expect("they differ");
        assert_eq!(fault.code, codes::TRACE_MISMATCH);
        assert!(!fault.help.is_empty());
        fault.message
    };
    let expert = run("expert", 2);
    assert_eq!(
        fault(&expert, &run("easy", 2)),
        "the runs have different agents: Car_1 (Car, ambulance, priority 1) in `a`, Car_1 (Car, priority 1) in `b`"
    );
    let mut late = run("expert", 2);
    let mut lines = late.trace.lines();
    late.trace = [lines.next().unwrap(), lines.nth(1).unwrap()].join("\n");
    assert_eq!(
        fault(&expert, &late),
        "the runs begin with different ticks: 0 in `a`, 1 in `b`"
    );
}

#[test]
fn a_run_without_ticks_is_not_compared() {
    let (whole, mut empty) = (run("easy", 2), run("easy", 2));
    empty.trace = empty.trace.lines().next().unwrap().to_owned();
    let (whole, empty) = (whole.loaded(), empty.loaded());
    for pages in [[&whole, &empty], [&empty, &whole], [&empty, &empty]] {
        let fault = Comparison::new(pages, ["a", "b"].map(str::to_owned))
            .err()
            .expect("no ticks");
        assert!(
            fault.message.ends_with("has no ticks") || fault.code == codes::TRACE_MISMATCH,
            "{}",
            fault.message
        );
    }
    let fault = Comparison::new([&empty, &empty], ["a", "b"].map(str::to_owned))
        .err()
        .expect("no ticks");
    assert_eq!(
        (fault.code, fault.message.as_str()),
        (codes::INVALID_TRACE, "`a` has no ticks")
    );
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
        .map(|clause| &*rules.predicates[rules.clauses[clause.index()].head.predicate.index()].name)
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
    let page = |replay: &Replay| Page::new(replay, &run.header(), &Icons::default(), &run.sources).unwrap();
    let mut gap = page(&replay);
    push(&mut gap, &mut replay, &ticks[0]).unwrap();
    assert_eq!(
        push(&mut gap, &mut replay, &ticks[2]).unwrap_err().code,
        codes::INVALID_TRACE
    );
    assert_eq!(
        push(&mut gap, &mut replay, &ticks[0]).unwrap_err().code,
        codes::INVALID_TRACE
    );
    push(&mut gap, &mut replay, &ticks[1]).unwrap();
    let mut last = ticks[0].clone();
    last.tick = u64::MAX;
    assert_eq!(
        push(&mut page(&replay), &mut replay, &last).unwrap_err().code,
        codes::INVALID_TRACE
    );
}

#[test]
fn a_run_that_is_too_long_is_an_error() {
    let run = run("easy", 1);
    let mut replay = run.replay();
    let mut tick = run.ticks().next().unwrap();
    replay.set(&tick).unwrap();
    let mut page = Page::new(&replay, &run.header(), &Icons::default(), &run.sources).unwrap();
    let agents = run.header().agents.len();
    page.set_limit(2 * agents);
    for number in 0..2 {
        tick.tick = number;
        page.push(&replay, &tick, &run.sources).unwrap();
    }
    tick.tick = 2;
    let fault = page.push(&replay, &tick, &run.sources).unwrap_err();
    assert_eq!(fault.code, diag::codes::LIMIT_EXCEEDED);
}

/// A page of a map that no browser could show is refused at once.
#[test]
fn a_map_that_is_too_large_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let config = folder.path().join("large.yaml");
    std::fs::write(
        &config,
        "base: configs/expert.yaml\nmap: configs/maps/metropolis.yaml\n",
    )
    .unwrap();
    let output = Command::new(env!("CARGO_BIN_EXE_logicity"))
        .args([
            "run",
            "large.yaml",
            "--ticks",
            "1",
            "--no-pictures",
            "--html",
            "city.html",
        ])
        .current_dir(folder.path())
        .output()
        .unwrap();
    let said = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert!(
        said.contains("limit-exceeded") && said.contains("cells would be slow to open"),
        "{said}"
    );
    assert!(!folder.path().join("city.html").exists());
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
                let by_rules = run
                    .world
                    .vocabulary
                    .decide(Some(replay.kind_id(agent)), replay.derived(agent));
                assert_eq!(
                    state.action(run.world.vocabulary.actions()).unwrap(),
                    if agent == 0 { action } else { by_rules }
                );
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
        let mut page = Page::new(&replay, &run.header(), &Icons::default(), &run.sources).unwrap();
        let fault = page.push(&replay, &tick, &run.sources).unwrap_err();
        assert_eq!(fault.code, codes::INVALID_TRACE, "{key}");
    }
}
