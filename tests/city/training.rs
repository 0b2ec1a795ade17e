//! Options of Safe Path Following that only training uses: the order of entities, demanding episodes, the curriculum
//! and the allowed actions.

use crate::shipped_world::{task, task_of};
use logicity::city::{Action, AgentName, Split};
use logicity::diag::{self, Diagnostic};
use logicity::rng::{Purpose, RngExt, Seed};
use logicity::sim::Observer;
use logicity::task::spf::{
    self, Autoreset, Begin, ControlMode, DRAWS_MAX, Env, EpisodeSource, ObservationKind, SpfTask, VectorEnv,
    reset_demanding,
};
use logicity::yaml::codes;
use std::sync::Arc;

/// An environment of the training split whose task has these keys.
fn env_of(mode: &str, task: &str) -> Env {
    env_in(mode, task, Split::Train, ControlMode::First)
}

fn env_in(mode: &str, task: &str, split: Split, control: ControlMode) -> Env {
    Env::new(loaded(mode, task), split, control).unwrap()
}

fn loaded(mode: &str, task: &str) -> Arc<SpfTask> {
    let loaded = task_of(&format!("base: configs/{mode}.yaml\ntask: {task}\n"));
    Arc::new(loaded.unwrap_or_else(|faults| panic!("{faults:?}")))
}

/// The first fault of a configuration whose task has these keys.
fn fault_of(task: &str) -> Diagnostic {
    let faults = task_of(&format!("base: configs/easy.yaml\ntask: {task}\n"))
        .err()
        .unwrap_or_default();
    faults
        .into_iter()
        .next()
        .unwrap_or_else(|| panic!("no fault in {task}"))
}

/// The positions of agents by their squared distance from the ego, then by position.
fn by_distance(env: &Env, mut agents: Vec<usize>) -> Vec<usize> {
    agents.sort_unstable_by_key(|&agent| (distance(env, agent), agent));
    agents
}

/// The squared distance of an agent from the ego.
fn distance(env: &Env, agent: usize) -> i32 {
    let [ego, other] = [0, agent].map(|agent| env.city().agents()[agent].cell);
    (other.row - ego.row).pow(2) + (other.col - ego.col).pow(2)
}

#[test]
fn the_nearest_entities_come_first_and_the_rules_require_the_same() {
    // 7 of 11 agents are few enough that not all in view are observed.
    for entities in [5, 7] {
        let [mut list, mut nearest] = ["list", "nearest"].map(|order| {
            env_of(
                "expert",
                &format!("{{entities: {entities}, state_agents: 4, order: {order}}}"),
            )
        });
        let task = Arc::clone(list.task());
        let (mut moved, mut ties) = (0, 0);
        for seed in 0..30 {
            list.reset(seed).unwrap();
            nearest.reset(seed).unwrap();
            while list.controlled_cars()[0].is_running() {
                let seen = |env: &Env| env.controlled_cars()[0].observer().entities().collect::<Vec<usize>>();
                let (plain, sorted) = (seen(&list), seen(&nearest));
                assert_eq!(sorted, by_distance(&list, plain.clone()), "seed {seed}");
                moved += usize::from(plain != sorted);
                ties += sorted
                    .windows(2)
                    .filter(|pair| distance(&list, pair[0]) == distance(&list, pair[1]))
                    .count();
                // The numbers of each predicate are permuted.
                let at = |entity: usize| plain.iter().position(|agent| *agent == sorted[entity]).unwrap();
                let written = |env: &Env| {
                    let mut out = vec![0.5; task.observation_width()];
                    env.observe(0, &mut out);
                    out
                };
                let (before, after) = (written(&list), written(&nearest));
                let mut base = 0;
                for column in task.oracle().columns() {
                    let width = column.width;
                    for first in 0..sorted.len() {
                        match width == entities {
                            true => assert_eq!(after[base + first], before[base + at(first)]),
                            false => {
                                for second in 0..sorted.len() {
                                    let place = |first, second| base + entities * first + second;
                                    let expected = before[place(at(first), at(second))];
                                    assert_eq!(after[place(first, second)], expected);
                                }
                            }
                        }
                    }
                    base += width;
                }
                let [cars, others] = [&list, &nearest].map(|env| env.controlled_cars()[0].derived());
                assert_eq!(cars, others);
                let action = match seed % 3 {
                    0 => Action::Normal,
                    _ => list.oracle_action(0),
                };
                list.step(&[action]).unwrap();
                nearest.step(&[action]).unwrap();
                assert_eq!(list.controlled_cars()[0].last(), nearest.controlled_cars()[0].last());
            }
        }
        assert!(moved > 500, "{moved} states in another order");
        assert!(ties > 0, "no two entities at the same distance");
    }
}

#[test]
fn rows_of_the_state_come_nearest_first() {
    let [mut list, mut nearest] =
        ["{state_agents: 11}", "{state_agents: 3, order: nearest}"].map(|it| env_of("hard", it));
    let width = list.task().state_shape()[1];
    let mut omitted = 0;
    for seed in 0..20 {
        list.reset(seed).unwrap();
        nearest.reset(seed).unwrap();
        for _ in 0..40 {
            if !list.controlled_cars()[0].is_running() {
                break;
            }
            let rows = |env: &Env| {
                let mut out = vec![0.5; env.task().state_shape().iter().product()];
                env.observe_state(0, &mut out);
                out.chunks_exact(width).map(<[f32]>::to_vec).collect::<Vec<_>>()
            };
            let mut expected: Vec<Vec<f32>> = rows(&list).into_iter().filter(|row| row[0] == 1.0).collect();
            // The sort is stable, and the rows are in list order.
            expected[1..].sort_by_key(|row| {
                #[allow(clippy::cast_possible_truncation)] // at most 25 cells
                let cells = |share: f32| (25.0 * share).round() as i32;
                cells(row[1]).pow(2) + cells(row[2]).pow(2)
            });
            omitted += usize::from(expected.len() > 3);
            expected.resize(3, vec![0.0; width]);
            assert_eq!(rows(&nearest), expected, "seed {seed}");
            let action = list.oracle_action(0);
            list.step(&[action]).unwrap();
            nearest.step(&[action]).unwrap();
        }
    }
    assert!(omitted > 50, "{omitted}");
}

/// The number of steps of the oracle's run of a drawn episode that the rules constrain.
fn constrained_steps(env: &mut Env, seed: u64, agents: Option<usize>) -> u32 {
    env.reset_with(seed, agents).unwrap();
    let mut count = 0;
    while env.controlled_cars()[0].is_running() {
        count += u32::from(!env.controlled_cars()[0].derived().is_empty());
        let action = env.oracle_action(0);
        env.step(&[action]).unwrap();
    }
    count
}

#[test]
fn demanding_episodes_are_the_first_that_the_rules_constrain() {
    for (mode, task, least) in [("easy", "{}", 1), ("expert", "{horizon: 60, constrained_steps: 6}", 6)] {
        let (mut env, mut plain) = (env_of(mode, task), env_of(mode, task));
        let (mut demanding, mut drawn) = (EpisodeSource::demanding(5), EpisodeSource::new(5, None));
        let mut draws = 0;
        for episode in 0..25 {
            demanding.begin(&mut env).unwrap();
            // The obvious computation: whole runs of the oracle.
            let first = drawn.next_seed();
            let seeds = std::iter::once(first).chain((1..).map(|draw| {
                let mut stream = Seed(first).stream(Purpose::EPISODE, draw, u64::MAX);
                stream.random::<u64>() >> 11
            }));
            let tried = seeds.enumerate().map(|(draw, seed)| (draw as u64 + 1, seed));
            let (count, expected) = tried
                .take(DRAWS_MAX as usize)
                .find(|(_, seed)| constrained_steps(&mut plain, *seed, None) >= least)
                .unwrap();
            draws += count;
            plain.reset(expected).unwrap();
            assert_eq!(env.episode(), plain.episode(), "{mode} {episode}");
            assert_eq!((env.steps(), env.horizon()), (0, plain.horizon()));
            assert_eq!(reset_demanding(&mut plain, first, None).unwrap(), count);
            assert_eq!((demanding.place(), env.taken().count()), (drawn.place(), 0));
            // The environment is at its start, as after a plain reset.
            for _ in 0..40 {
                let [own, other] = [&env, &plain].map(|env| {
                    let mut out = vec![0.0; env.task().observation_width()];
                    env.observe(0, &mut out);
                    (out, env.controlled_cars()[0].last().clone())
                });
                assert_eq!(own, other);
                if !env.controlled_cars()[0].is_running() {
                    break;
                }
                env.step(&[Action::Normal]).unwrap();
                plain.step(&[Action::Normal]).unwrap();
            }
        }
        assert!(draws > 30, "{mode}: {draws} draws");
    }
}

#[test]
fn demanding_episodes_do_not_depend_on_threads() {
    let task = loaded("expert", "{curriculum: [{until: 2, agents: 6}]}");
    let run = |threads: usize, count: u64| {
        let sources = (0..count).map(EpisodeSource::demanding);
        let view = ObservationKind::Groundings;
        let mut vector = VectorEnv::new(
            &task,
            (Split::Train, ControlMode::First),
            sources,
            Autoreset::SameStep,
            view,
            threads,
        )
        .unwrap();
        vector.judge_actions();
        let mut rows = vec![0.0; count as usize * vector.width()];
        vector
            .reset(&vec![Some(Begin::Next); count as usize], &mut rows)
            .unwrap();
        let mut results = Vec::new();
        for step in 0..80_usize {
            let actions: Vec<Action> = (0..count as usize)
                .map(|at| Action::STANDARD[(at + step / 9) % 4])
                .collect();
            vector.step(&actions, &mut rows).unwrap();
            let first = &vector.sub_envs()[..20];
            let infos: Vec<_> = first
                .iter()
                .map(|sub_env| (sub_env.outcome(0), sub_env.info(0).clone()))
                .collect();
            results.push((rows[..20 * vector.width()].to_vec(), infos));
        }
        results
    };
    let alone = run(1, 20);
    assert!(alone == run(3, 20) && alone == run(2, 33));
}

#[test]
fn a_search_for_demanding_episodes_ends() {
    // Alone in the city, the rules require nothing of the ego.
    let mut env = env_of("easy", "{horizon: 3, curriculum: [{until: 9, agents: 1}]}");
    let fault = EpisodeSource::demanding(1).begin(&mut env).unwrap_err();
    assert_eq!(fault.code, diag::codes::LIMIT_EXCEEDED);
    assert!(
        fault.message.contains("in none of 1000 drawn episodes"),
        "{}",
        fault.message
    );
    assert!(
        fault.primary.is_some() && fault.help[0].contains("constrained_steps"),
        "{fault:?}"
    );
    // The environment recovers.
    env.reset(1).unwrap();
    assert_eq!(env.city().agents().len(), 8);
    env.step(&[Action::Normal]).unwrap();
}

#[test]
fn a_curriculum_adds_agents_by_episodes() {
    let keys = "{curriculum: [{until: 3, agents: 2}, {until: 40, agents: 6}]}";
    let (mut env, mut whole, mut again) = (env_of("expert", keys), env_of("expert", "{}"), env_of("expert", keys));
    let mut source = EpisodeSource::new(7, None);
    let mut taken_part = vec![0; 11];
    for number in 0..45 {
        source.begin(&mut env).unwrap();
        let episode = env.episode().clone();
        let expected = match number {
            0..3 => 2,
            3..40 => 6,
            _ => 11,
        };
        assert_eq!(
            (episode.agents.len(), env.city().agents().len()),
            (expected, expected),
            "episode {number}"
        );
        // Its agents start as in the episode with all agents.
        whole.reset(episode.seed).unwrap();
        let all = &whole.episode().agents;
        let places: Vec<usize> = (episode.agents.iter())
            .map(|agent| all.iter().position(|other| other == agent).unwrap())
            .collect();
        assert!(places[0] == 0 && places.is_sorted());
        if expected == 6 {
            places.iter().for_each(|&place| taken_part[place] += 1);
        }
        // A new environment repeats it, and so does a jump to its number.
        let mut other = EpisodeSource::new(7, None);
        other.skip_to(number);
        let mut jumped = env_of("expert", keys);
        other.begin(&mut jumped).unwrap();
        assert_eq!(jumped.episode(), &episode);
        again.reset_to(&episode).unwrap();
        let mut fresh = Observer::new(Arc::clone(env.task().oracle()), 0);
        fresh.begin(env.city());
        for _ in 0..60 {
            if !env.controlled_cars()[0].is_running() {
                break;
            }
            fresh.look(env.city()).unwrap();
            assert_eq!(fresh.derived(env.city()).unwrap(), env.controlled_cars()[0].derived());
            let seen = |env: &Env| env.controlled_cars()[0].observer().atoms().collect::<Vec<_>>();
            assert!(seen(&env) == seen(&again) && seen(&env) == seen(&jumped) && fresh.atoms().eq(seen(&env)));
            let action = env.oracle_action(0);
            for env in [&mut env, &mut again, &mut jumped] {
                env.step(&[action]).unwrap();
            }
            assert_eq!(env.controlled_cars()[0].last(), again.controlled_cars()[0].last());
        }
    }
    // In 37 episodes, the ego and five of ten others take part: 18.5 of each on average.
    assert!(
        taken_part[0] == 37 && taken_part[1..].iter().all(|times| (8..30).contains(times)),
        "{taken_part:?}"
    );
}

#[test]
fn a_curriculum_is_for_drawn_episodes_of_training() {
    let keys = "{curriculum: [{until: 9, agents: 2}]}";
    for (split, control, count) in [
        (Split::Val, ControlMode::First, 14),
        (Split::Test, ControlMode::First, 18),
        (Split::Train, ControlMode::Egos, 11),
        (Split::Train, ControlMode::First, 2),
    ] {
        let mut env = env_in("expert", keys, split, control);
        EpisodeSource::new(1, None).begin(&mut env).unwrap();
        assert_eq!(env.city().agents().len(), count, "{split:?} {control:?}");
        assert_eq!(env.controlled_cars().len() > 1, control == ControlMode::Egos);
    }
    // An episode with fewer agents needs a stage of their number, in the order of the split, with the ego.
    let mut small = env_of("expert", keys);
    EpisodeSource::new(1, None).begin(&mut small).unwrap();
    let episode = small.episode().clone();
    let refused = |keys: &str, episode: &logicity::task::spf::Episode| {
        let fault = env_of("expert", keys).reset_to(episode).unwrap_err();
        assert_eq!(fault.code, spf::codes::INVALID_EPISODE);
        fault.message
    };
    assert_eq!(refused("{}", &episode), "the episode has 2 agents, the split has 11");
    let mut swapped = episode.clone();
    swapped.agents.reverse();
    assert!(refused(keys, &swapped).contains("instead of Car_1"));
    let mut twice = episode.clone();
    twice.agents[1] = twice.agents[0].clone();
    assert!(refused(keys, &twice).starts_with("the episode has Car_1"));
    let mut unknown = episode;
    unknown.agents[1].name = AgentName {
        number: 99,
        ..unknown.agents[1].name
    };
    assert!(refused(keys, &unknown).contains("_99"));
}

#[test]
fn faulty_options_are_reported() {
    for (keys, code, message) in [
        ("{order: nearst}", codes::INVALID_VALUE, "one of `list`, `nearest`"),
        (
            "{constrained_steps: 0}",
            codes::INVALID_VALUE,
            "a whole number from 1 to",
        ),
        (
            "{constraind_steps: 2}",
            codes::UNKNOWN_KEY,
            "unknown key `constraind_steps`",
        ),
        ("{curriculum: 5}", codes::INVALID_VALUE, "a list of stages"),
        (
            "{curriculum: [{until: 5}]}",
            codes::MISSING_KEY,
            "`agents` is missing in a stage of the curriculum",
        ),
        (
            "{curriculum: [{until: 5, agents: 0}]}",
            codes::INVALID_VALUE,
            "a whole number from 1 to",
        ),
        (
            "{curriculum: [{until: 5, agents: 2}, {until: 5, agents: 3}]}",
            codes::INVALID_VALUE,
            "more episodes than the 5 at which the stage before ends",
        ),
        (
            "{curriculum: [{until: 5, agents: 9}]}",
            codes::INVALID_VALUE,
            "the split `train` has 8 agents, not 9",
        ),
    ] {
        let fault = fault_of(keys);
        assert!(
            fault.code == code && fault.message.contains(message),
            "{keys}: {fault:?}"
        );
        assert!(fault.primary.is_some(), "{keys}");
    }
    assert!(fault_of("{order: nearst}").help[0].contains("did you mean `nearest`?"));
}

#[test]
fn allowed_actions_violate_no_clause() {
    let mut refused = [0; 4];
    for mode in ["easy", "expert"] {
        let task = task(mode, None);
        let mut env = Env::new(Arc::clone(&task), Split::Train, ControlMode::First).unwrap();
        let mut plain = Env::new(task, Split::Train, ControlMode::First).unwrap();
        env.judge_actions();
        let mut tried = 0;
        for seed in 0..60 {
            env.reset(seed).unwrap();
            let mut random = Seed(seed).stream(Purpose::POLICY, 1, 0);
            while env.controlled_cars()[0].is_running() {
                let allowed = env.controlled_cars()[0].allowed().unwrap();
                assert!(allowed.contains(env.oracle_action(0)));
                // Repeat the episode up to here, and try every action.
                if tried < 150 && (random.random_range(0..16) == 0 || allowed.len() < 4) {
                    tried += 1;
                    for action in Action::STANDARD {
                        plain.reset(seed).unwrap();
                        env.taken().for_each(|taken| plain.step(taken).unwrap());
                        assert_eq!(plain.controlled_cars()[0].allowed(), None);
                        plain.step(&[action]).unwrap();
                        let broken = !plain.controlled_cars()[0].last().broken.is_empty();
                        assert_eq!(allowed.contains(action), !broken, "{mode} seed {seed} {action:?}");
                        refused[action.index()] += usize::from(broken);
                    }
                }
                let action = Action::STANDARD[random.random_range(0..4)];
                let action = if allowed.contains(action) {
                    action
                } else {
                    env.oracle_action(0)
                };
                env.step(&[action]).unwrap();
                assert!(
                    env.controlled_cars()[0].last().broken.is_empty(),
                    "the actions are a shield"
                );
            }
        }
        assert_eq!(tried, 150, "{mode}");
    }
    assert!(refused[..3].iter().all(|count| *count > 20), "{refused:?}");
}
