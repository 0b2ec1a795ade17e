//! Vectorized environments: results equal those of the individual environments.

use crate::shipped_world::task;
use logicity::cancel::Cancel;
use logicity::city::{Action, Split};
use logicity::diag::codes;
use logicity::rng::{Purpose, RngExt, Seed};
use logicity::sim::Observer;
use logicity::task::spf::{
    Autoreset, Begin, ControlMode, Env, EpisodeSource, Info, ObservationKind, SubEnv, VectorEnv,
};
use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};

/// An individual environment with its last observation.
struct Alone {
    env: Env,
    source: EpisodeSource,
    shown: Vec<f32>,
    info: Info,
    over: bool,
}

impl Alone {
    fn begin(&mut self, view: ObservationKind) {
        self.source.begin(&mut self.env).unwrap();
        self.over = false;
        self.look(view);
    }

    fn look(&mut self, view: ObservationKind) {
        view.write(&self.env, 0, &mut self.shown);
        self.info.note(&self.env, 0);
    }
}

/// Compares a batch of `count` environments with individual ones under random actions. `steps` counts those of all
/// environments together.
fn compare(config: &str, split: Split, view: ObservationKind, autoreset: Autoreset, threads: usize, steps: usize) {
    const COUNT: usize = 24;
    let task = task(config, None);
    let width: usize = view.shape(&task).iter().product();
    let source = |sub_env: usize| EpisodeSource::new(100 + sub_env as u64, None);
    let mut batch = VectorEnv::new(
        &task,
        (split, ControlMode::First),
        (0..COUNT).map(source),
        autoreset,
        view,
        threads,
    )
    .unwrap();
    batch.keep_last_atoms();
    let mut alone: Vec<Alone> = (0..COUNT)
        .map(|sub_env| Alone {
            env: Env::new(Arc::clone(&task), split, ControlMode::First).unwrap(),
            source: source(sub_env),
            shown: vec![0.0; width],
            info: Info::default(),
            over: false,
        })
        .collect();
    let mut shown = vec![0.5; COUNT * width];
    batch.reset(&vec![Some(Begin::Next); COUNT], &mut shown).unwrap();
    alone.iter_mut().for_each(|one| one.begin(view));
    let (mut ended, mut random) = (0, Seed(1).stream(Purpose::POLICY, 0, 0));
    for step in 0..steps / COUNT {
        if autoreset == Autoreset::Disabled && alone.iter().any(|one| one.over) {
            let begin: Vec<Option<Begin>> = alone.iter().map(|one| one.over.then_some(Begin::Next)).collect();
            batch.reset(&begin, &mut shown).unwrap();
            alone.iter_mut().filter(|one| one.over).for_each(|one| one.begin(view));
        }
        let actions: Vec<Action> = (0..COUNT)
            .map(|_| Action::STANDARD[random.random_range(0..4)])
            .collect();
        batch.step(&actions, &mut shown).unwrap();
        for (sub_env, one) in alone.iter_mut().enumerate() {
            let together = &batch.sub_envs()[sub_env];
            let outcome = together.outcome(0);
            let result = (outcome.reward, outcome.terminated, outcome.truncated);
            if one.over {
                one.begin(view);
                assert_eq!(result, (0.0, false, false), "step {step}");
            } else {
                one.env.step(&actions[sub_env..=sub_env]).unwrap();
                let last = one.env.controlled_cars()[0].last();
                assert_eq!(result, (last.reward, last.terminated, last.truncated), "step {step}");
                one.over = last.terminated || last.truncated;
                one.look(view);
            }
            assert_eq!(together.ended().is_some(), one.over && autoreset == Autoreset::SameStep);
            if let Some((observation, infos)) = together.ended() {
                let atoms: Vec<_> = one.env.controlled_cars()[0].observer().atoms().collect();
                assert_eq!(together.ended_atoms(0).unwrap(), atoms, "step {step}");
                assert_eq!(observation, one.shown, "step {step}");
                assert_eq!(infos, std::slice::from_ref(&one.info), "step {step}");
                ended += 1;
                one.begin(view);
            }
            ended += usize::from(one.over);
            assert_eq!(shown[sub_env * width..(sub_env + 1) * width], one.shown, "step {step}");
            assert_eq!(*together.info(0), one.info, "step {step}");
        }
    }
    assert!(ended > 30, "{ended} episodes ended");
}

/// Compares 10^4 steps in each autoreset mode.
#[test]
fn slow_a_batch_equals_individual_environments() {
    compare(
        "expert",
        Split::Train,
        ObservationKind::Groundings,
        Autoreset::NextStep,
        1,
        10_000,
    );
    compare(
        "expert",
        Split::Train,
        ObservationKind::State,
        Autoreset::SameStep,
        3,
        10_000,
    );
    compare(
        "expert",
        Split::Train,
        ObservationKind::Groundings,
        Autoreset::Disabled,
        2,
        10_000,
    );
    compare(
        "medium",
        Split::Test,
        ObservationKind::Groundings,
        Autoreset::SameStep,
        1,
        10_000,
    );
    compare(
        "medium",
        Split::Test,
        ObservationKind::State,
        Autoreset::NextStep,
        2,
        10_000,
    );
}

/// A batch that replays the actions of another continues identically, in every autoreset mode.
#[test]
fn a_replayed_batch_continues_identically() {
    const COUNT: usize = 12;
    let (task, view) = (task("expert", None), ObservationKind::State);
    let width: usize = view.shape(&task).iter().product();
    for autoreset in [Autoreset::NextStep, Autoreset::SameStep, Autoreset::Disabled] {
        let make = |seeds: u64| {
            let sources = (0..COUNT as u64).map(|sub_env| EpisodeSource::new(seeds + sub_env, None));
            VectorEnv::new(&task, (Split::Train, ControlMode::First), sources, autoreset, view, 1).unwrap()
        };
        let (mut first, mut shown) = (make(7), vec![0.0; COUNT * width]);
        // The last environment has no episode yet.
        let mut begin = vec![Some(Begin::Next); COUNT];
        begin[COUNT - 1] = None;
        first.reset(&begin, &mut shown).unwrap();
        let mut random = Seed(5).stream(Purpose::POLICY, 0, 0);
        let mut actions = || -> Vec<Action> {
            (0..COUNT)
                .map(|_| Action::STANDARD[random.random_range(0..4)])
                .collect()
        };
        let proceed = |batch: &mut VectorEnv, actions: &[Action], shown: &mut [f32]| {
            let ready = |sub_env: &SubEnv| sub_env.is_ready(autoreset);
            let begin: Vec<_> = batch
                .sub_envs()
                .iter()
                .map(|each| (!ready(each)).then_some(Begin::Next))
                .collect();
            batch.reset(&begin, shown).unwrap();
            batch.step(actions, shown).unwrap();
        };
        for steps in [0, 1, 40] {
            for _ in 0..steps {
                proceed(&mut first, &actions(), &mut shown);
            }
            let mut twin = make(0);
            let mut episodes = Vec::new();
            for (position, sub_env) in first.sub_envs().iter().enumerate() {
                twin.set_source(position, sub_env.source().clone());
                let taken = sub_env.env().taken().flatten().copied().collect();
                let begun = sub_env.is_ready(Autoreset::NextStep);
                episodes.push(begun.then(|| (Arc::new(sub_env.env().episode().clone()), taken)));
            }
            let mut seen = vec![0.0; COUNT * width];
            twin.replay(&episodes, &mut seen).unwrap();
            assert_eq!(seen, shown, "{autoreset:?} after {steps}");
            for _ in 0..60 {
                let actions = actions();
                proceed(&mut first, &actions, &mut shown);
                proceed(&mut twin, &actions, &mut seen);
                assert_eq!(seen, shown, "{autoreset:?} after {steps}");
                for (one, other) in first.sub_envs().iter().zip(twin.sub_envs()) {
                    assert_eq!((one.outcome(0), one.info(0)), (other.outcome(0), other.info(0)));
                    assert_eq!(one.ended(), other.ended());
                }
            }
        }
    }
}

#[test]
fn the_seeds_of_episodes_are_functions_of_seed_and_number() {
    let mut source = EpisodeSource::new(7, None);
    let seeds: Vec<u64> = (0..5).map(|_| source.next_seed()).collect();
    assert_eq!(source.place(), [7, 5]);
    source.skip_to(3);
    assert_eq!(source.next_seed(), seeds[3]);
    assert!(seeds.iter().all(|seed| *seed < 1 << 53));
    let other = EpisodeSource::new(8, None).next_seed();
    assert!(!seeds.contains(&other));
}

#[test]
fn the_seed_chooses_recorded_episodes() {
    let task = task("easy", None);
    let mut env = Env::new(Arc::clone(&task), Split::Val, ControlMode::First).unwrap();
    let recorded: Arc<[_]> = (0..6)
        .map(|seed| {
            env.reset(seed).unwrap();
            env.episode().clone()
        })
        .collect();
    let source = |_| EpisodeSource::new(5, Some(Arc::clone(&recorded)));
    let mut batch = VectorEnv::new(
        &task,
        (Split::Val, ControlMode::First),
        (0..2).map(source),
        Autoreset::SameStep,
        ObservationKind::Groundings,
        1,
    )
    .unwrap();
    let mut shown = vec![0.0; 2 * task.observation_width()];
    let mut seen = Vec::new();
    for _ in 0..20 {
        batch.reset(&vec![Some(Begin::Next); 2], &mut shown).unwrap();
        let begun: Vec<_> = batch.sub_envs().iter().map(|sub_env| sub_env.env().episode()).collect();
        assert_eq!(begun[0], begun[1]);
        assert!(recorded.contains(begun[0]));
        seen.push(begun[0].seed);
    }
    seen.sort_unstable();
    seen.dedup();
    assert!(seen.len() > 3, "{seen:?}");
    // An episode from the options takes none from the source.
    let given = Begin::Given(Arc::new(recorded[4].clone()));
    batch.reset(&[Some(given), None], &mut shown).unwrap();
    assert_eq!(*batch.sub_envs()[0].env().episode(), recorded[4]);
    batch.reset(&vec![Some(Begin::Next); 2], &mut shown).unwrap();
    assert_eq!(batch.sub_envs()[0].env().episode(), batch.sub_envs()[1].env().episode());
}

/// After a cancelled step, the environments that took none need a reset, and the others can take the next step.
#[test]
fn after_cancellation_the_rest_of_a_batch_needs_a_reset() {
    const COUNT: usize = 64;
    let task = task("easy", None);
    for threads in [1, 3] {
        let left = Arc::new(AtomicI64::new(i64::MAX));
        let polls = Arc::clone(&left);
        let cancel = Cancel::when(move || polls.fetch_sub(1, Ordering::Relaxed) <= 0);
        let sources = (0..COUNT).map(|sub_env| EpisodeSource::new(sub_env as u64, None));
        let (autoreset, view) = (Autoreset::Disabled, ObservationKind::Groundings);
        let batch = VectorEnv::new_with(
            &task,
            (Split::Train, ControlMode::First),
            sources,
            autoreset,
            view,
            threads,
            &cancel,
        );
        let mut batch = batch.unwrap();
        let mut shown = vec![0.0; COUNT * task.observation_width()];
        batch.reset(&vec![Some(Begin::Next); COUNT], &mut shown).unwrap();
        left.store(3, Ordering::Relaxed);
        let fault = batch.step(&[Action::Stop; COUNT], &mut shown).unwrap_err();
        assert_eq!(fault.code, codes::CANCELLED);
        left.store(i64::MAX, Ordering::Relaxed);
        let gone: Vec<bool> = batch
            .sub_envs()
            .iter()
            .map(|sub_env| sub_env.env().steps() == 1)
            .collect();
        let reached = gone.iter().filter(|gone| **gone).count();
        assert!((1..COUNT).contains(&reached), "{reached} on {threads} threads");
        if threads == 1 {
            assert!(gone[..reached].iter().all(|gone| *gone), "{gone:?}");
        }
        let ready = |batch: &VectorEnv| -> Vec<bool> {
            let sub_envs = batch.sub_envs().iter();
            sub_envs.map(|sub_env| sub_env.is_ready(autoreset)).collect()
        };
        let again: Vec<Option<Begin>> = (ready(&batch).iter().zip(&gone))
            .map(|(ready, gone)| {
                assert!(*gone || !ready);
                (!ready).then_some(Begin::Next)
            })
            .collect();
        batch.reset(&again, &mut shown).unwrap();
        assert!(ready(&batch).iter().all(|ready| *ready));
        batch.step(&[Action::Stop; COUNT], &mut shown).unwrap();
    }
}

/// Environments of a batch share working memory and skip the rules where no observed fact has changed. They judge as an
/// observer does that has just been made.
#[test]
fn a_batch_judges_as_fresh_observers() {
    const COUNT: usize = 20;
    let task = task("expert", None);
    let view = ObservationKind::Groundings;
    let sources = (0..COUNT).map(|sub_env| EpisodeSource::new(sub_env as u64, None));
    let mut batch = VectorEnv::new(
        &task,
        (Split::Train, ControlMode::First),
        sources,
        Autoreset::NextStep,
        view,
        1,
    )
    .unwrap();
    let mut shown = vec![0.0; COUNT * batch.width()];
    batch.reset(&vec![Some(Begin::Next); COUNT], &mut shown).unwrap();
    let mut random = Seed(2).stream(Purpose::POLICY, 0, 0);
    let (mut unchanged, mut violated) = (0, 0);
    for _ in 0..200 {
        let before = shown.clone();
        let actions: Vec<Action> = (0..COUNT)
            .map(|_| Action::STANDARD[random.random_range(0..4)])
            .collect();
        let judged = batch.sub_envs().iter().zip(&actions).map(|(sub_env, &action)| {
            let env = sub_env.env();
            let car = &env.controlled_cars()[0];
            let mut fresh = Observer::new(Arc::clone(task.oracle()), car.agent());
            fresh.begin(env.city());
            fresh.look(env.city()).unwrap();
            assert_eq!(car.derived(), fresh.derived(env.city()).unwrap());
            car.is_running()
                .then(|| fresh.violations(env.city(), action).unwrap().to_vec())
        });
        let judged: Vec<Option<Vec<usize>>> = judged.collect();
        batch.step(&actions, &mut shown).unwrap();
        for (sub_env, judged) in batch.sub_envs().iter().zip(judged) {
            if let Some(judged) = judged {
                assert_eq!(sub_env.info(0).broken, judged);
                violated += usize::from(!judged.is_empty());
            }
        }
        let width = batch.width();
        let rows = before.chunks_exact(width).zip(shown.chunks_exact(width));
        unchanged += rows.filter(|(before, after)| before == after).count();
    }
    assert!(
        unchanged > 1000 && violated > 50,
        "{unchanged} unchanged, {violated} violations"
    );
}
