//! Several egos: vectors, evaluations and traces equal what individual environments do.

use crate::shipped_world::task_of;
use logicity::builtin::BuiltinFiles;
use logicity::city::{Action, Split};
use logicity::config::{ShieldConfig, ShieldMode, ShieldQuery};
use logicity::diag::Sources;
use logicity::rng::{Purpose, RngExt, Seed};
use logicity::sim::Shield;
use logicity::task::spf::{
    Autoreset, Baseline, BatchEvaluator, Begin, ControlMode, Ending, Env, EpisodeSet, EpisodeSource, Info, Layer,
    ObservationKind, Policy, PolicyNetwork, RANDOM_RUNS, Rate, Rollout, Score, SpfTask, Trajectories, VectorEnv,
    rollout, rollouts, summarize,
};
use logicity::yaml::codes;
use std::sync::Arc;

const VIEW: ObservationKind = ObservationKind::Groundings;

fn task(mode: &str, keys: &str) -> Arc<SpfTask> {
    let config = format!("base: {mode}\ntask: {keys}\n");
    Arc::new(task_of(&config).unwrap_or_else(|faults| panic!("{faults:?}")))
}

fn env(task: &Arc<SpfTask>, split: Split) -> Env {
    Env::new(Arc::clone(task), split, ControlMode::Egos).unwrap()
}

fn vector(task: &Arc<SpfTask>, count: u64, autoreset: Autoreset, threads: usize) -> VectorEnv {
    let sources = (0..count).map(|seed| EpisodeSource::new(seed, None));
    VectorEnv::new(
        task,
        (Split::Train, ControlMode::Egos),
        sources,
        autoreset,
        VIEW,
        threads,
    )
    .unwrap()
}

/// What an ego sees and knows in an individual environment.
fn seen(env: &Env, ego: usize) -> (Vec<f32>, Info) {
    let (mut row, mut info) = (vec![0.5; env.task().observation_width()], Info::default());
    VIEW.write(env, ego, &mut row);
    info.note(env, ego);
    (row, info)
}

/// Every ego of a vector observes, acts and ends as in an individual environment, in every autoreset mode. An ego whose
/// episode has ended gets nothing until the episodes of all egos have ended.
#[test]
fn vectors_equal_individual_environments() {
    const COUNT: usize = 6;
    const EGOS: usize = 3;
    let task = task("expert", "{egos: 3, horizon: 60}");
    let width = task.observation_width();
    for (autoreset, threads) in [
        (Autoreset::NextStep, 1),
        (Autoreset::SameStep, 2),
        (Autoreset::Disabled, 3),
    ] {
        let mut vector = vector(&task, COUNT as u64, autoreset, threads);
        assert_eq!((vector.egos(), vector.width()), (EGOS, width));
        vector.keep_last_atoms();
        let mut alone: Vec<(Env, EpisodeSource)> = (0..COUNT as u64)
            .map(|seed| (env(&task, Split::Train), EpisodeSource::new(seed, None)))
            .collect();
        let mut shown = vec![0.5; COUNT * EGOS * width];
        vector.reset(&[const { Some(Begin::Next) }; COUNT], &mut shown).unwrap();
        alone.iter_mut().for_each(|(env, source)| source.begin(env).unwrap());
        let mut random = Seed(1).stream(Purpose::POLICY, 0, 0);
        let (mut absent, mut ends) = (0, 0);
        for step in 0..300 {
            if autoreset == Autoreset::Disabled {
                let begin: Vec<_> = (alone.iter().map(|(env, _)| (!env.is_running()).then_some(Begin::Next))).collect();
                vector.reset(&begin, &mut shown).unwrap();
                let over = alone.iter_mut().filter(|(env, _)| !env.is_running());
                over.for_each(|(env, source)| source.begin(env).unwrap());
            }
            // Some egos obey, so that they end at different times.
            let actions: Vec<Action> = (alone.iter().flat_map(|(env, _)| (0..EGOS).map(move |ego| (env, ego))))
                .map(|(env, ego)| match random.random_range(0..12) {
                    0 => Action::STANDARD[random.random_range(0..4)],
                    _ => env.oracle_action(ego),
                })
                .collect();
            vector.step(&actions, &mut shown).unwrap();
            for (at, (env, source)) in alone.iter_mut().enumerate() {
                let sub_env = &vector.sub_envs()[at];
                let running: Vec<bool> = env.controlled_cars().iter().map(|car| car.is_running()).collect();
                let began = !env.is_running();
                if began {
                    source.begin(env).unwrap();
                } else {
                    env.step(&actions[at * EGOS..][..EGOS]).unwrap();
                }
                for (ego, was_running) in running.into_iter().enumerate() {
                    let (last, outcome) = (env.controlled_cars()[ego].last().clone(), sub_env.outcome(ego));
                    let result = (outcome.reward, outcome.terminated, outcome.truncated);
                    if began || !was_running {
                        absent += usize::from(!began);
                        assert_eq!(result, (0.0, false, false));
                    } else {
                        assert_eq!(result, (last.reward, last.terminated, last.truncated), "step {step}");
                    }
                }
                let over = !env.is_running();
                ends += usize::from(over);
                assert_eq!(sub_env.ended().is_some(), over && autoreset == Autoreset::SameStep);
                if let Some((rows, infos)) = sub_env.ended() {
                    for ego in 0..EGOS {
                        let expected = seen(env, ego);
                        assert_eq!(
                            (&rows[ego * width..][..width], &infos[ego]),
                            (&expected.0[..], &expected.1)
                        );
                        let atoms: Vec<_> = env.controlled_cars()[ego].observer().atoms().collect();
                        assert_eq!(sub_env.ended_atoms(ego).unwrap(), atoms);
                    }
                    source.begin(env).unwrap();
                }
                for ego in 0..EGOS {
                    let (row, info) = seen(env, ego);
                    assert_eq!(shown[(at * EGOS + ego) * width..][..width], row, "step {step}");
                    assert_eq!(*sub_env.info(ego), info, "step {step}");
                    assert_eq!(sub_env.is_active(ego), env.controlled_cars()[ego].is_running());
                }
            }
        }
        assert!(absent > 50 && ends > 20, "{absent} {ends}");
        // What was taken determines the state.
        let mut twin = self::vector(&task, COUNT as u64, autoreset, 1);
        let episodes: Vec<_> = (vector.sub_envs().iter())
            .map(|sub_env| {
                let taken = sub_env.env().taken().flatten().copied().collect();
                Some((Arc::new(sub_env.env().episode().clone()), taken))
            })
            .collect();
        let mut rows = vec![0.5; shown.len()];
        twin.replay(&episodes, &mut rows).unwrap();
        assert_eq!(rows, shown);
    }
}

/// Priority and concepts of every ego are drawn, those of the first one as if it were alone; all agents start as usual.
#[test]
fn every_ego_is_drawn() {
    let several = task("expert", "{egos: 4}");
    let (mut four, mut every) = (env(&several, Split::Train), env(&task("expert", "{}"), Split::Train));
    let mut one = Env::new(Arc::clone(&several), Split::Train, ControlMode::First).unwrap();
    assert_eq!((four.controlled_cars().len(), one.controlled_cars().len()), (4, 1));
    assert_eq!(every.controlled_cars().len(), 7);
    let mut differ = [0; 4];
    for seed in 0..40 {
        four.reset(seed).unwrap();
        one.reset(seed).unwrap();
        every.reset(seed).unwrap();
        assert_eq!(one.episode(), every.episode());
        let egos: Vec<usize> = four.controlled_cars().iter().map(|car| car.agent()).collect();
        let pairs = four.episode().agents.iter().zip(&one.episode().agents);
        for (place, (agent, of_one)) in pairs.enumerate() {
            assert_eq!((agent.start, agent.goal), (of_one.start, of_one.goal));
            match egos.iter().position(|ego| *ego == place) {
                Some(number @ 1..) => differ[number] += usize::from(agent.priority != of_one.priority),
                _ => assert_eq!(agent, of_one),
            }
        }
    }
    assert!(differ[1..].iter().all(|count| *count > 20), "{differ:?}");
}

#[test]
fn too_many_egos_are_reported() {
    let fault = |keys: &str, split| match task_of(&format!("base: easy\ntask: {keys}\n")) {
        Ok(task) => Env::new(Arc::new(task), split, ControlMode::Egos).err().unwrap(),
        Err(mut faults) => faults.swap_remove(0),
    };
    let shield = fault("{shield: {mode: joint, query: appropriate}}", Split::Train);
    assert_eq!(
        shield.message,
        "the mode `joint` does not support the query `appropriate`"
    );
    assert!(
        shield.primary.is_some() && shield.help[0].contains("query: safe"),
        "{shield:?}"
    );
    for keys in ["{egos: 0}", "{egos: two}", "{egos: 2000}"] {
        let fault = fault(keys, Split::Train);
        assert!(
            fault.code == codes::INVALID_VALUE && fault.primary.is_some(),
            "{fault:?}"
        );
    }
    let most = fault("{egos: 10}", Split::Train);
    assert_eq!(most.message, "no split has 10 cars; the largest has 9");
    let fault = fault("{egos: 7}", Split::Train);
    assert_eq!(fault.message, "the split `train` has 6 cars, not 7");
    assert!(
        fault.primary.is_some() && fault.help[0].contains("lower `egos`"),
        "{fault:?}"
    );
    // The other splits have more cars.
    let task = task("easy", "{egos: 7}");
    assert_eq!(env(&task, Split::Val).controlled_cars().len(), 7);
}

/// A network with a hidden layer, whose weights are drawn.
fn network(width: usize, seed: u64) -> PolicyNetwork {
    let mut random = Seed(seed).stream(Purpose::POLICY, 9, 9);
    let mut layer = |inputs: usize, outputs: usize| Layer {
        weights: (0..inputs * outputs).map(|_| random.random_range(-0.5..0.5)).collect(),
        bias: (0..outputs).map(|_| random.random_range(-0.5..0.5)).collect(),
    };
    let all = vec![(0..width).map(Some).collect()];
    PolicyNetwork::new(width, &all, vec![layer(width, 8), layer(8, 5)]).unwrap()
}

/// The steps of a network by the obvious computation: one call of the vector per step.
fn plain_trajectories(
    vector: &mut VectorEnv,
    networks: &[&PolicyNetwork],
    random: &[f32],
    shown: &mut [f32],
) -> Vec<[Vec<f32>; 5]> {
    let (count, egos, width) = (vector.sub_envs().len(), vector.egos(), vector.width());
    let (rows, steps) = (count * egos, random.len() / (count * egos));
    let of = |row: usize| networks[(row % egos).min(networks.len() - 1)];
    let value = |row: usize, observation: &[f32]| {
        let mut out = [0.0; 5];
        of(row).evaluate(observation, &mut out);
        out
    };
    // For each row: actions, rewards, endings, values of the states, and values after the steps.
    let mut done = vec![[const { Vec::new() }; 5]; rows];
    for step in 0..steps {
        let acts: Vec<bool> = (0..rows)
            .map(|row| vector.sub_envs()[row / egos].is_active(row % egos))
            .collect();
        let outputs: Vec<[f32; 5]> = (0..rows)
            .map(|row| value(row, &shown[row * width..][..width]))
            .collect();
        let choose = |row: usize| {
            let most = outputs[row][..4].iter().copied().fold(f32::NEG_INFINITY, f32::max);
            let weights: Vec<f32> = outputs[row][..4].iter().map(|logit| (logit - most).exp()).collect();
            let (mut sum, all) = (0.0, weights.iter().sum::<f32>());
            let mut below = |weight: &f32| {
                sum += weight;
                sum <= random[row * steps + step] * all
            };
            weights.iter().take(3).filter(|weight| below(weight)).count()
        };
        let actions: Vec<usize> = (0..rows).map(|row| if acts[row] { choose(row) } else { 0 }).collect();
        let taken: Vec<Action> = actions.iter().map(|action| Action::STANDARD[*action]).collect();
        vector.step(&taken, shown).unwrap();
        for row in 0..rows {
            let (sub_env, ego) = (&vector.sub_envs()[row / egos], row % egos);
            let outcome = sub_env.outcome(ego);
            let info = sub_env.ended().map_or(sub_env.info(ego), |(_, infos)| &infos[ego]);
            let ending = match outcome {
                _ if !acts[row] => Ending::Inactive,
                outcome if outcome.truncated => Ending::Horizon,
                outcome if !outcome.terminated => Ending::None,
                _ if info.success => Ending::Success,
                _ => Ending::Violation,
            };
            let after = match ending {
                Ending::None => value(row, &shown[row * width..][..width])[4],
                Ending::Horizon => value(row, &sub_env.ended().unwrap().0[ego * width..][..width])[4],
                _ => 0.0,
            };
            let here = if acts[row] { outputs[row][4] } else { 0.0 };
            #[allow(clippy::cast_possible_truncation, clippy::cast_precision_loss)]
            let step = [
                actions[row] as f32,
                outcome.reward as f32,
                ending as u8 as f32,
                here,
                after,
            ];
            done[row].iter_mut().zip(step).for_each(|(all, value)| all.push(value));
        }
    }
    done
}

/// Trajectories under one network for all egos, or one for each, equal those of single steps, on any number of threads.
#[test]
fn trajectories_equal_single_steps() {
    const COUNT: usize = 5;
    let task = task("medium", "{egos: 3, horizon: 25}");
    let width = task.observation_width();
    let own: Vec<PolicyNetwork> = (0..3).map(|seed| network(width, seed)).collect();
    for networks in [vec![&own[0]], own.iter().collect()] {
        let (rows, steps) = (COUNT * 3, 80);
        let mut random = Seed(4).stream(Purpose::POLICY, 0, 0);
        let numbers: Vec<f32> = (0..rows * steps).map(|_| random.random::<f32>()).collect();
        let collect = |threads: usize| {
            let mut vector = vector(&task, COUNT as u64, Autoreset::SameStep, threads);
            let mut shown = vec![0.0; rows * width];
            vector.reset(&[const { Some(Begin::Next) }; COUNT], &mut shown).unwrap();
            (vector.collect(&networks, &numbers, &mut shown).unwrap(), shown)
        };
        let (found, shown) = collect(1);
        let all = |trajectories: &[Trajectories]| format!("{trajectories:?}");
        let again = collect(3);
        assert_eq!((all(&found), &shown), (all(&again.0), &again.1));
        let mut plain = vector(&task, COUNT as u64, Autoreset::SameStep, 1);
        let mut seen = vec![0.0; rows * width];
        plain.reset(&[const { Some(Begin::Next) }; COUNT], &mut seen).unwrap();
        let expected = plain_trajectories(&mut plain, &networks, &numbers, &mut seen);
        assert_eq!(shown, seen);
        let (mut absent, mut endings) = (0, [0; 5]);
        for (row, [actions, rewards, ends, values, after]) in expected.iter().enumerate() {
            let (network, place) = match networks.len() {
                1 => (0, row),
                _ => (row % 3, row / 3),
            };
            let found = &found[network];
            for step in 0..steps {
                let at = place * steps + step;
                #[allow(clippy::float_cmp)] // equal computations
                let same = f32::from(found.actions[at]) == actions[step]
                    && found.rewards[at] == rewards[step]
                    && f32::from(found.endings[at]) == ends[step];
                assert!(same, "row {row}, step {step}");
                assert!(
                    (found.next_values[at] - after[step]).abs() < 1e-5,
                    "row {row}, step {step}"
                );
                endings[usize::from(found.endings[at])] += 1;
                if found.endings[at] == Ending::Inactive as u8 {
                    absent += 1;
                    assert_eq!(found.states[at], 0);
                } else {
                    let value = found.outputs[found.states[at] as usize * 5 + 4];
                    assert!((value - values[step]).abs() < 1e-5, "row {row}, step {step}");
                }
            }
        }
        assert!(absent > 50 && endings[0] > 100 && endings[1] > 10, "{endings:?}");
    }
}

fn recorded(task: &SpfTask, split: Split, count: usize) -> EpisodeSet {
    let mut set = EpisodeSet::load(task, split, &mut Sources::new(), &BuiltinFiles).unwrap();
    set.episodes.truncate(count);
    set
}

/// Evaluates `policy` for all egos.
fn evaluated(task: &Arc<SpfTask>, set: &EpisodeSet, policy: impl Fn(&Env, usize) -> Action) -> BatchEvaluator {
    let mut evaluator = BatchEvaluator::new(task, set).unwrap();
    while evaluator.running().any(|running| running) {
        let egos = evaluator.egos();
        let actions: Vec<Action> = (evaluator.envs().iter())
            .flat_map(|env| (0..egos).map(|ego| policy(env, ego)))
            .collect();
        evaluator.step(&actions).unwrap();
    }
    evaluator
}

/// An evaluation counts every ego, and all egos of an episode together.
#[test]
fn rates_count_egos_alone_and_together() {
    let task = task("expert", "{egos: 3}");
    let set = recorded(&task, Split::Test, 12);
    let mut env = env(&task, Split::Test);
    // The second ego always takes Normal.
    let evaluator = evaluated(&task, &set, |env, ego| match ego {
        1 => Action::Normal,
        _ => env.oracle_action(ego),
    });
    let mut alone: Vec<Rollout> = Vec::new();
    let mut baseline = Baseline::default();
    for episode in &set.episodes {
        env.reset_to(episode).unwrap();
        env.set_horizon(1000);
        let oracle = rollouts(&mut env, Policy::Oracle).unwrap();
        let horizon = match oracle.iter().all(|rollout| rollout.success) {
            true => task.config().patience * env.steps(),
            false => task.config().horizon,
        };
        env.reset_to(episode).unwrap();
        env.set_horizon(horizon);
        let mut done = vec![Rollout::default(); 3];
        while env.is_running() {
            let cars: Vec<_> = (env.controlled_cars().iter())
                .map(|car| car.is_running().then(|| car.derived()))
                .collect();
            let actions = [env.oracle_action(0), Action::Normal, env.oracle_action(2)];
            env.step(&actions).unwrap();
            for (ego, asked) in cars.into_iter().enumerate() {
                if let Some(asked) = asked {
                    done[ego].add(&env, ego, actions[ego], asked.iter());
                }
            }
        }
        alone.extend(done);
        baseline.add(&mut env, episode).unwrap();
    }
    assert_eq!(evaluator.rollouts(), alone);
    assert_eq!(baseline.rollouts().len(), 12 * 3 * usize::from(RANDOM_RUNS));
    let summary = summarize(&task, &alone, Some(baseline.returns()));
    let groups: Vec<&[Rollout]> = alone.chunks_exact(3).collect();
    let successes = |group: &[Rollout]| group.iter().filter(|rollout| rollout.success).count();
    assert_eq!(summary.tsr, Rate::of(groups.iter().map(|group| [successes(group), 3])));
    let joint = summary.joint.unwrap();
    let together = groups.iter().map(|group| [usize::from(successes(group) == 3), 1]);
    assert_eq!(joint.tsr, Rate::of(together));
    assert!(
        joint.tsr.value < summary.tsr.value && summary.tsr.value < 1.0,
        "{summary:?}"
    );
    let obeys = groups.iter().map(|group| {
        let constrained = |rollout: &Rollout| rollout.constrained.iter().any(|steps| *steps > 0);
        let keeps = group.iter().all(|rollout| rollout.broken.is_empty());
        [usize::from(keeps && group.iter().any(constrained)), 1]
    });
    assert_eq!(joint.dsr, Rate::of(obeys));
    let mean = |group: &[Rollout]| group.iter().map(|rollout| rollout.total).sum::<f64>() / 3.0;
    let scores = groups
        .iter()
        .zip(baseline.returns())
        .map(|(group, random)| mean(group) - random);
    assert_eq!(summary.score, Some(Score::of(scores)));
    let random = baseline.summary(&task);
    assert_eq!((random.tsr.runs, random.joint.unwrap().tsr.runs), (12 * 30, 12 * 10));
    // One ego is measured as the first car.
    let one = self::task("expert", "{egos: 1}");
    let first = evaluated(&one, &set, |env, ego| env.oracle_action(ego));
    let mut single = Env::new(Arc::clone(&one), Split::Test, ControlMode::First).unwrap();
    let expected = set.episodes.iter().map(|episode| {
        single.reset_to(episode).unwrap();
        rollout(&mut single, Policy::Oracle).unwrap()
    });
    assert_eq!(first.rollouts(), expected.collect::<Vec<_>>());
    assert_eq!(summarize(&one, first.rollouts(), None).joint, None);
}

/// Rules in which the actions of other cars matter.
const COUPLED: &str = "\
.include \"vocabulary.dl\"

Fast(X) :- IsAmbulance(X).
Slow(X) :- Fast(Y), IsClose(X, Y), IsCar(X).
Stop(X) :- Slow(Y), CollidingClose(X, Y), IsCar(X).
Stop(X) :- IsAtInter(X), IsInInter(Y), IsClose(X, Y).
";

/// Returns whether the action of an ego is safe in a joint action, by the definition of the rules above.
fn is_safe(env: &Env, ego: usize, joint: &[Action]) -> bool {
    let observer = env.controlled_cars()[ego].observer();
    let predicates = &env.task().world().vocabulary.predicates;
    let atoms: Vec<(&str, Vec<usize>)> = observer
        .atoms()
        .map(|(predicate, agents)| (predicates[predicate].name.as_str(), agents))
        .collect();
    let holds = |name: &str, agents: &[usize]| atoms.iter().any(|(known, of)| *known == name && of == agents);
    let me = observer.ego();
    let takes = |agent: usize, action: Action| {
        let of = env.controlled_cars().iter().position(|car| car.agent() == agent);
        of.is_some_and(|other| env.controlled_cars()[other].is_running() && joint[other] == action)
    };
    let any = |test: &dyn Fn(usize) -> bool| observer.entities().any(|agent| agent != me && test(agent));
    let mut demanded = Vec::new();
    if holds("IsAmbulance", &[me]) {
        demanded.push(Action::Fast);
    }
    if any(&|y| takes(y, Action::Fast) && holds("IsClose", &[me, y])) {
        demanded.push(Action::Slow);
    }
    if any(&|y| takes(y, Action::Slow) && holds("CollidingClose", &[me, y]))
        || holds("IsAtInter", &[me]) && any(&|y| holds("IsInInter", &[y]) && holds("IsClose", &[me, y]))
    {
        demanded.push(Action::Stop);
    }
    demanded.iter().all(|action| *action == joint[ego])
}

fn joint_shield(rules: &Arc<SpfTask>) -> Arc<Shield> {
    let config = ShieldConfig {
        mode: ShieldMode::Joint,
        query: ShieldQuery::Safe,
        threshold: ShieldConfig::THRESHOLD,
    };
    Arc::new(Shield::new(Arc::clone(rules.oracle()), config).unwrap())
}

/// A joint shield changes as few actions as any safe joint action requires, of all there are.
#[test]
fn joint_shields_change_the_fewest_actions() {
    const EGOS: usize = 5;
    let shield = joint_shield(&crate::shipped_world::task("expert", Some(COUPLED)));
    let mut env = env(&task("expert", "{egos: 5}"), Split::Train);
    env.set_shield(Some(shield)).unwrap();
    let mut random = Seed(11).stream(Purpose::POLICY, 0, 0);
    let (mut changes, mut none) = ([0; EGOS + 1], 0);
    for seed in 0..40 {
        env.reset(seed).unwrap();
        for _ in 0..60 {
            let running: Vec<usize> = (0..EGOS)
                .filter(|ego| env.controlled_cars()[*ego].is_running())
                .collect();
            let Some(most) = (running.len() as u32 > 1).then(|| 4usize.pow(running.len() as u32)) else {
                break;
            };
            let proposed: Vec<Action> = (0..EGOS).map(|_| Action::STANDARD[random.random_range(0..4)]).collect();
            let joint_of = |number: usize| {
                let mut joint = proposed.clone();
                for (place, &ego) in running.iter().enumerate() {
                    joint[ego] = Action::STANDARD[number / 4usize.pow(place as u32) % 4];
                }
                joint
            };
            let changed = |joint: &[Action]| running.iter().filter(|ego| joint[**ego] != proposed[**ego]).count();
            let safe = |joint: &[Action]| running.iter().all(|ego| is_safe(&env, *ego, joint));
            let fewest = (0..most)
                .map(joint_of)
                .filter(|joint| safe(joint))
                .map(|joint| changed(&joint))
                .min();
            let before: Vec<bool> = running.iter().map(|&ego| is_safe(&env, ego, &proposed)).collect();
            // Keeps a copy of the state in which the shield decided.
            let (start, taken) = (
                env.episode().clone(),
                env.taken().flatten().copied().collect::<Vec<_>>(),
            );
            env.step_shielded(&proposed).unwrap();
            let executed = env.taken().next_back().unwrap().to_vec();
            let mut earlier = Env::new(Arc::clone(env.task()), Split::Train, ControlMode::Egos).unwrap();
            earlier.reset_to(&start).unwrap();
            taken
                .chunks_exact(EGOS)
                .for_each(|actions| earlier.step(actions).unwrap());
            match fewest {
                Some(fewest) => {
                    assert!(
                        running.iter().all(|ego| is_safe(&earlier, *ego, &executed)),
                        "{executed:?}"
                    );
                    assert_eq!(changed(&executed), fewest);
                    changes[fewest] += 1;
                }
                None => none += 1,
            }
            for (&ego, was_safe) in running.iter().zip(before) {
                let replaced = env.controlled_cars()[ego].replaced();
                assert_eq!(replaced.is_some(), executed[ego] != proposed[ego]);
                if let Some((action, reasons)) = replaced {
                    assert_eq!((action, reasons.is_empty()), (proposed[ego], was_safe));
                }
            }
        }
    }
    assert!(
        changes[..3].iter().all(|count| *count > 20) && changes[3] > 0,
        "{changes:?} {none}"
    );
}

/// Where no rule reads the actions of others, a joint shield does what each ego's own shield does.
#[test]
fn joint_shields_of_independent_egos_are_those_of_each() {
    let [joint, alone] = ["joint", "override"].map(|mode| {
        task(
            "expert",
            &format!("{{egos: 4, shield: {{mode: {mode}, query: safe}}, sensors: {{range: 15}}}}"),
        )
    });
    let [mut joint, mut alone] = [&joint, &alone].map(|task| env(task, Split::Train));
    let mut random = Seed(12).stream(Purpose::POLICY, 0, 0);
    let mut replaced = 0;
    for seed in 0..20 {
        joint.reset(seed).unwrap();
        alone.reset(seed).unwrap();
        while joint.is_running() {
            let proposed: Vec<Action> = (0..4).map(|_| Action::STANDARD[random.random_range(0..4)]).collect();
            joint.step_shielded(&proposed).unwrap();
            alone.step_shielded(&proposed).unwrap();
            let [of_joint, of_alone] = [&joint, &alone].map(|env| env.taken().next_back().unwrap().to_vec());
            assert_eq!(of_joint, of_alone);
            for (one, other) in joint.controlled_cars().iter().zip(alone.controlled_cars()) {
                replaced += usize::from(one.replaced().is_some());
                assert_eq!(one.replaced(), other.replaced());
            }
        }
    }
    assert!(replaced > 300, "{replaced}");
}
