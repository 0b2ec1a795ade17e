//! Safe Path Following: what is observed, wanted, judged and rewarded.

mod recorded_cases;

use flate2::read::GzDecoder;
use logicity::city::{Agent, Cell, Heading};
use logicity::config::{AgentConfig, AgentKind, Speed, Split, load_scenario};
use logicity::diag::Sources;
use logicity::engine::{Program, naive};
use logicity::files::{read_or_builtin, read_text};
use logicity::lang::{ClauseId, Literal, Value};
use logicity::rng::Seed;
use logicity::sim::{Actions, Chance, Entity, Observer, Settings, Simulation, World, ground};
use logicity::task::path::{Egos, Env, PathTask};
use serde_json::Value as Json;
use std::collections::BTreeSet;
use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::sync::Arc;

fn task(config: &str) -> Arc<PathTask> {
    task_of(config, None)
}

/// The task of a configuration, with other rules if a text is given.
fn task_of(config: &str, rules: Option<&str>) -> Arc<PathTask> {
    let mut sources = Sources::new();
    let scenario = load_scenario(&mut sources, Path::new(config), &read_text).expect("it is built in");
    let text = rules.map_or_else(|| read_or_builtin(&scenario.rules.value).unwrap(), str::to_owned);
    let entry = sources.add(scenario.rules.value.display().to_string(), text);
    let (program, faults) = Program::load(&mut sources, entry, &read_or_builtin);
    let world = World::new(scenario, program.unwrap_or_else(|| panic!("{faults:?}"))).expect("they fit");
    Arc::new(PathTask::new(Arc::new(world), &sources).unwrap_or_else(|faults| panic!("{faults:?}")))
}

const MODES: [&str; 7] = [
    "easy",
    "medium",
    "hard",
    "expert",
    "transfer-easy",
    "transfer-medium",
    "transfer-hard",
];

/// From every recorded state of the published environment: observation, wanted action, reward and violation are the recorded ones.
#[test]
fn recorded_steps() {
    for mode in ["easy", "hard"] {
        let Some(folder) = recorded_cases::folder() else {
            return;
        };
        let file = File::open(folder.join(format!("gym_{mode}.jsonl.gz"))).unwrap();
        let lines = BufReader::new(GzDecoder::new(file));
        let task = task(mode);
        let world = task.world();
        let mut city = Simulation::new(Arc::clone(world), Split::Test, Seed(0), Settings::default()).unwrap();
        let mut observer = Observer::new(Arc::clone(task.oracle()), 0);
        let mut out = vec![0.0; task.observation_width()];
        let mut steps = 0;
        for line in lines.lines() {
            let step: Json = serde_json::from_str(&line.unwrap()).unwrap();
            let Some(recorded) = step["agents"].as_array() else {
                if step["meta"] == true {
                    assert_eq!(step["obs_dim"], task.observation_width());
                }
                continue;
            };
            let agents: Vec<Agent> = recorded
                .iter()
                .zip(city.agents())
                .map(|(agent, like)| placed(agent, like, world))
                .collect();
            city.restart(Seed(0), agents);
            observer.begin(&city);
            let ones: BTreeSet<usize> = step["obs_ones"].as_array().unwrap().iter().map(index).collect();
            let entities: Vec<usize> = step["ents"]
                .as_array()
                .unwrap()
                .iter()
                .map(|id| index(id) - 3)
                .collect();
            let drawn = Recorded {
                task: &task,
                entities: &entities,
                ones: &ones,
            };
            observer.look_with(&city, &drawn);

            assert_eq!(observer.entities().collect::<Vec<_>>(), entities, "{mode} step {steps}");
            observer.write(&mut out);
            let written: BTreeSet<usize> = (0..out.len()).filter(|&at| out[at] == 1.0).collect();
            assert_eq!(written, ones, "{mode} step {steps}");
            let derived = observer.derived(&city).unwrap();
            let wanted = world.vocabulary.decide(derived);
            assert_eq!(wanted, Speed::ALL[index(&step["expert"])], "{mode} step {steps}");
            let action = Speed::ALL[index(&step["action"])];
            let broken = observer.broken(&city, action).unwrap().to_vec();
            assert_eq!(
                !broken.is_empty(),
                step["fail"].as_bool().unwrap(),
                "{mode} step {steps}"
            );
            let reward = task.reward(action, &broken, index(&step["path_length4"]) / 4);
            let expected = step["reward"].as_f64().unwrap();
            assert!(
                (reward - expected).abs() < 1e-6,
                "{mode} step {steps}: {reward}, recorded {expected}"
            );
            steps += 1;
        }
        assert!(steps > 200, "{mode}: {steps} steps");
    }
}

fn index(json: &Json) -> usize {
    usize::try_from(json.as_u64().unwrap()).unwrap()
}

/// An agent in a recorded state.
fn placed(recorded: &Json, like: &Agent, world: &World) -> Agent {
    let cell = |key: &str| {
        let pair: Vec<i32> = recorded[key]
            .as_array()
            .unwrap()
            .iter()
            .map(|n| i32::try_from(n.as_i64().unwrap()).unwrap())
            .collect();
        Cell::new(pair[0], pair[1])
    };
    let config = AgentConfig {
        name: like.name(),
        concepts: recorded["concepts"]
            .as_array()
            .unwrap()
            .iter()
            .map(|name| name.as_str().unwrap().to_owned())
            .collect(),
        priority: i32::try_from(recorded["pri"].as_i64().unwrap()).unwrap(),
    };
    let route = world.router.plan(like.kind, cell("start"), cell("goal")).unwrap();
    let mut agent = Agent::new(&config, route);
    agent.cell = cell("pos");
    agent.heading = recorded["dir"]
        .as_str()
        .map(|name| Heading::ALL.into_iter().find(|heading| heading.name() == name).unwrap());
    agent
}

/// The draws of the published program, read off the recorded observation.
struct Recorded<'a> {
    task: &'a PathTask,
    entities: &'a [usize],
    ones: &'a BTreeSet<usize>,
}

impl Chance for Recorded<'_> {
    fn happens(&self, predicate: usize, first: usize, second: usize, _: f64) -> bool {
        let n = self.task.oracle().entities();
        let columns = self.task.oracle().columns();
        let base: usize = columns
            .take_while(|(before, _)| *before != predicate)
            .map(|(_, width)| width)
            .sum();
        let place = |agent| self.entities.iter().position(|&entity| entity == agent).unwrap();
        self.ones.contains(&(base + n * place(first) + place(second)))
    }
}
