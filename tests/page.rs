//! The page of a run, unpacked: it has what the trace has, and every explanation is the engine's.

use base64::Engine as _;
use flate2::read::ZlibDecoder;
use logicity::city::Cell;
use logicity::config::{Speed, Split};
use logicity::diag::{Code, Sources};
use logicity::engine::provenance::{Explainer, Teller};
use logicity::page::Page;
use logicity::render::Icons;
use logicity::rng::Seed;
use logicity::sim::{Replay, Settings, Simulation, TraceHeader, TraceTick, TraceWriter, World, hash_sources};
use serde_json::{Value, json};
use std::io::Read;
use std::sync::Arc;

mod shipped_world;
use shipped_world::with_sources;

/// A run of `ticks` ticks: its trace, and the way that every agent was on in every tick.
struct Run {
    world: Arc<World>,
    sources: Sources,
    trace: String,
    ways: Vec<Vec<Vec<Cell>>>,
}

fn run(config: &str, ticks: u64) -> Run {
    let (world, sources) = with_sources(config);
    let settings = Settings {
        count_firings: true,
        ..Settings::default()
    };
    let mut city = Simulation::new(Arc::clone(&world), Split::Test, Seed(0), settings).unwrap();
    let rules = sources.ids().next().unwrap();
    let hash = hash_sources(&sources, &[rules]);
    let mut trace = TraceWriter::new(Vec::new(), &city, &sources, config, rules, &hash).unwrap();
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

/// An explanation of the page as a tree of the words of [`Teller::json`].
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

/// The same of an explanation of the engine.
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
fn a_page_tells_the_decisions_of_the_trace_and_why() {
    let run = run("expert", 25);
    let data = unpack(&run.page());
    let mut replay = run.replay();
    let mut rows: Vec<Value> = Vec::new();
    for (number, tick) in run.ticks().enumerate() {
        replay.set(&tick).unwrap();
        let told = &data["ticks"][number];
        rows.resize(replay.facts().rows.len(), json!([]));
        for change in told["facts"].as_array().unwrap() {
            rows[usize::try_from(change[0].as_u64().unwrap()).unwrap()] = change[1].clone();
        }
        for (predicate, (told, rows)) in rows.iter().zip(&replay.facts().rows).enumerate() {
            let arity = usize::try_from(data["predicates"][predicate]["arity"].as_u64().unwrap()).unwrap();
            let flat: Vec<u32> = rows.iter().flat_map(|row| row[..arity].to_vec()).collect();
            assert_eq!(told, &json!(flat), "predicate {predicate} in tick {number}");
        }
        let session = replay.session();
        let teller = Teller::new(session.program().rules(), session.symbols(), &run.sources);
        for (agent, state) in tick.agents.iter().enumerate() {
            let name = |list: &str, at: &Value| data[list][usize::try_from(at.as_u64().unwrap()).unwrap()].clone();
            assert_eq!(told["at"][agent], json!(state.at));
            assert_eq!(told["goal"][agent], json!(state.goal));
            assert_eq!(told["fired"][agent], json!(state.clauses));
            assert_eq!(name("actions", &told["action"][agent]), json!(state.action));
            match &state.heading {
                None => assert_eq!(told["heading"][agent], json!(-1)),
                Some(heading) => assert_eq!(name("headings", &told["heading"][agent]), json!(heading)),
            }
            for (action, number) in Speed::ALL.into_iter().zip(told["why"][agent].as_array().unwrap()) {
                let relation = run.world.vocabulary.action(action).unwrap();
                let (_, explanation) = (Explainer::new(session))
                    .explain_either(relation, &[Some(replay.value(agent))])
                    .unwrap();
                let nodes = teller.json(&explanation.unwrap())["nodes"].take();
                assert_eq!(page_tree(&data, number.as_i64().unwrap()), engine_tree(&nodes, 0));
            }
        }
    }
    assert_eq!(data["ticks"].as_array().unwrap().len(), 25);
}

/// The corners that the page plans again from start and goal are those of the way the agent really was on.
#[test]
fn routes_are_those_that_were_driven() {
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
            // Who sets out again does so within the tick.
            let since = usize::try_from(route[0].as_u64().unwrap()).unwrap();
            let way = &run.ways[since + usize::from(since > 0)][agent];
            let mut cells = vec![corners[0]];
            for pair in corners.windows(2) {
                let (rows, cols) = (pair[1].row - pair[0].row, pair[1].col - pair[0].col);
                assert!(rows == 0 || cols == 0, "between corners it goes straight");
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
    assert!(checked > run.header().agents.len(), "some agents had set out again");
}

#[test]
fn a_deadlock_is_on_the_page() {
    let run = run("expert", 300);
    let page = run.page();
    let data = unpack(&page);
    let deadlocks = data["deadlocks"].as_array().unwrap();
    let last = deadlocks.iter().find(|found| found["until"] == 299).unwrap();
    let position = |name: &str| run.header().agents.iter().position(|agent| agent.id == name).unwrap();
    assert_eq!(
        last["agents"],
        json!([position("Car_6"), position("Car_8")]),
        "as `run` tells"
    );
    assert_eq!(last["since"], 201);
    assert!(page.len() < 3_000_000, "{} bytes", page.len());
}

#[test]
fn a_page_needs_nothing_but_itself() {
    let page = run("easy", 3).page();
    for outside in ["http:", "https:", " src=", "url(", "import ", "fetch(", "<link"] {
        assert!(!page.contains(outside), "{outside}");
    }
}

#[test]
fn too_long_a_run_is_refused() {
    let run = run("easy", 1);
    let mut replay = run.replay();
    let tick = run.ticks().next().unwrap();
    replay.set(&tick).unwrap();
    let mut page = Page::new(&replay, &run.header(), &Icons::default(), &run.sources);
    let agents = run.header().agents.len();
    page.set_limit(2 * agents);
    assert!(page.push(&replay, &tick, &run.sources).is_ok());
    assert!(page.push(&replay, &tick, &run.sources).is_ok());
    let fault = page.push(&replay, &tick, &run.sources).unwrap_err();
    assert_eq!(fault.code, Code::LimitExceeded);
}
