//! Shields: what they permit, against the definition, and what they do to the episodes of a policy.

use crate::shipped_world::{configured, task_of};
use logicity::city::{Action, Split};
use logicity::config::{ShieldConfig, ShieldMode, ShieldQuery};
use logicity::rng::{Purpose, RngExt, Seed};
use logicity::sim::{Actions, Decider, Oracle, Shield};
use logicity::task::spf::{ControlMode, Env, EpisodeSource, Policy, SpfTask, rollout};
use std::sync::Arc;

fn task(mode: &str, task: &str) -> Arc<SpfTask> {
    let config = format!("base: {mode}\ntask: {task}\n");
    Arc::new(task_of(&config).unwrap_or_else(|faults| panic!("{faults:?}")))
}

fn env(task: &Arc<SpfTask>) -> Env {
    Env::new(Arc::clone(task), Split::Test, ControlMode::First).unwrap()
}

/// Drives randomly chosen actions through the shield. Calls `each` before every step. Returns the number of violations.
fn drive(env: &mut Env, episodes: u64, mut each: impl FnMut(&mut Env)) -> usize {
    let mut violations = 0;
    for seed in 0..episodes {
        env.reset(seed).unwrap();
        let mut random = Seed(seed).stream(Purpose::POLICY, 0, 0);
        while env.controlled_cars()[0].is_running() {
            env.ask_shield().unwrap();
            each(env);
            let proposed = Action::STANDARD[random.random_range(0..4)];
            env.step_shielded(&[proposed]).unwrap();
            violations += env.controlled_cars()[0].last().broken.len();
        }
    }
    violations
}

/// With exact facts, an action is appropriate if the oracle takes it, and safe if it violates no clause; no episode
/// under a shield ends with a violation.
#[test]
fn exact_shields_permit_what_the_rules_do() {
    for mode in ["easy", "expert"] {
        for query in ["appropriate", "safe"] {
            let mut replaced = 0;
            let task = task(mode, &format!("{{shield: {{mode: override, query: {query}}}}}"));
            let mut env = env(&task);
            env.judge_actions();
            let violations = drive(&mut env, 20, |env| {
                let car = &env.controlled_cars()[0];
                let permitted = car.verdict().unwrap().permitted;
                let expected: Actions = match query {
                    "safe" => car.allowed().unwrap(),
                    _ => [env.oracle_action(0)].into_iter().collect(),
                };
                assert_eq!(permitted, expected, "{mode} {query}");
                if let Some((action, reasons)) = car.replaced() {
                    replaced += 1;
                    let last = env.taken().next_back().unwrap()[0];
                    assert!(last != action && (query == "appropriate" || !reasons.is_empty()));
                }
            });
            assert!(
                violations == 0 && replaced > 20,
                "{mode} {query}: {violations} {replaced}"
            );
        }
    }
}

/// A crisp shield judges by what the sensors read, as a decider does on the observation.
#[test]
fn shields_see_what_the_sensors_read() {
    for output in ["facts", "probabilities", "belief"] {
        let sensors = format!("{{output: {output}, true_positive_rate: .8, false_positive_rate: .2}}");
        let task = task("expert", &format!("{{sensors: {sensors}, shield: {{mode: override}}}}"));
        let mut decider = Decider::new(Arc::clone(task.oracle())).unwrap();
        let mut observation = vec![0.0; task.observation_width()];
        let (mut all, mut oracles) = (0, 0);
        drive(&mut env(&task), 20, |env| {
            env.observe(0, &mut observation);
            let wanted = decider.action(&observation, env.city().cancel()).unwrap();
            let permitted = env.controlled_cars()[0].verdict().unwrap().permitted;
            assert_eq!(permitted, [wanted].into_iter().collect(), "{output}");
            oracles += u32::from(permitted == [env.oracle_action(0)].into_iter().collect());
            all += 1;
        });
        assert!(oracles < all, "{output}: {oracles} of {all}");
    }
}

/// The probability of an action is the share of random facts, drawn with the observed probabilities, for which a crisp
/// shield permits it.
#[test]
fn probabilities_of_actions_are_frequencies() {
    for (mode, query) in [("easy", "appropriate"), ("expert", "appropriate"), ("expert", "safe")] {
        let sensors = "{output: probabilities, true_positive_rate: .9, false_positive_rate: .1}";
        let shield = format!("{{mode: probabilistic, query: {query}, threshold: .4}}");
        let task = task(mode, &format!("{{entities: 4, sensors: {sensors}, shield: {shield}}}"));
        let mut decider = Decider::new(Arc::clone(task.oracle())).unwrap();
        let mut observation = vec![0.0; task.observation_width()];
        let mut random = Seed(5).stream(Purpose::TEST, 0, 0);
        let mut states = 0;
        drive(&mut env(&task), 4, |env| {
            states += 1;
            if states % 16 != 1 {
                return;
            }
            env.observe(0, &mut observation);
            let verdict = env.controlled_cars()[0].verdict().unwrap();
            let draws = 1500;
            let mut counts = [0u32; 4];
            let mut drawn = observation.clone();
            for _ in 0..draws {
                for (fact, probability) in drawn.iter_mut().zip(&observation) {
                    *fact = f32::from(u8::from(random.random::<f32>() < *probability));
                }
                let chosen = decider.action(&drawn, env.city().cancel()).unwrap();
                match query {
                    "safe" => {
                        for action in Action::STANDARD {
                            let broken = decider.violations(&drawn, action, env.city().cancel()).unwrap();
                            counts[action.index()] += u32::from(broken.is_empty());
                        }
                    }
                    _ => counts[chosen.index()] += 1,
                }
            }
            for action in Action::STANDARD {
                let probability = verdict.probability(action);
                let share = f64::from(counts[action.index()]) / f64::from(draws);
                let deviation = (probability * (1.0 - probability) / f64::from(draws)).sqrt();
                assert!(
                    (share - probability).abs() < 5.0 * deviation + 1e-6,
                    "{mode} {query} {action:?}: {probability} {share}"
                );
                let best = verdict.probability(verdict.preferred);
                assert!(probability <= best, "{action:?}");
                let permits = probability >= 0.4 || action == verdict.preferred;
                assert_eq!(verdict.permitted.contains(action), permits, "{action:?}");
            }
        });
        assert!(states > 16);
    }
}

/// Where no action is safe, the rules choose.
#[test]
fn contradictory_rules_permit_what_they_choose() {
    let task = task("easy", "{}");
    let rules = ".include \"vocabulary.dl\"\nStop(X) :- IsCar(X).\nSlow(X) :- Stop(X).\nFast(X) :- Stop(X).\nNormal(X) :- IsCar(X).\n";
    for mode in [ShieldMode::Override, ShieldMode::Probabilistic] {
        let (world, _) = configured("base: easy", rules, |_| ());
        let oracle = Arc::new(Oracle::new(world, task.config().entities as usize).unwrap());
        let config = ShieldConfig {
            mode,
            query: ShieldQuery::Safe,
            threshold: 0.5,
        };
        let mut env = env(&task);
        env.set_shield(Some(Arc::new(Shield::new(oracle, config).unwrap())))
            .unwrap();
        env.reset(1).unwrap();
        env.ask_shield().unwrap();
        let verdict = env.controlled_cars()[0].verdict().unwrap();
        assert_eq!(verdict.permitted, [Action::Stop].into_iter().collect());
        let mut all = task.world().vocabulary.actions().all();
        assert!(all.all(|action| verdict.probability(action) == 0.0));
    }
}

/// Probabilistic shields refuse rules without probabilities for all scenes.
#[test]
fn rules_without_probabilities_are_refused() {
    for (clause, message) in [
        (
            "Stop(X) :- Sees(X, X), n = count : { IsPedestrian(Y), IsClose(X, Y) }, n > 1.",
            "aggregate",
        ),
        ("Stop(X) :- CollidingClose(X, \"Car_2\").", "not the names of agents"),
    ] {
        let rules = format!(".include \"vocabulary.dl\"\n{clause}\n");
        let (world, _) = configured("base: expert", &rules, |_| ());
        let oracle = Arc::new(Oracle::new(world, 5).unwrap());
        let config = |mode| ShieldConfig {
            mode,
            query: ShieldQuery::Appropriate,
            threshold: 0.5,
        };
        let fault = Shield::new(Arc::clone(&oracle), config(ShieldMode::Probabilistic))
            .err()
            .unwrap();
        assert!(fault.message.contains(message), "{fault:?}");
        assert!(Shield::new(oracle, config(ShieldMode::Mask)).is_ok(), "{clause}");
    }
}

/// Shields may have other rules than the city.
#[test]
fn the_rules_of_a_shield_may_be_others() {
    let task = task("expert", "{}");
    let rules = ".include \"vocabulary.dl\"\nStop(X) :- IsAtInter(X), IsInInter(Y).\n";
    let (world, _) = configured("base: expert", rules, |_| ());
    let oracle = Arc::new(Oracle::new(world, task.config().entities as usize).unwrap());
    let config = ShieldConfig {
        mode: ShieldMode::Override,
        query: ShieldQuery::Safe,
        threshold: ShieldConfig::THRESHOLD,
    };
    let mut env = env(&task);
    env.set_shield(Some(Arc::new(Shield::new(oracle, config).unwrap())))
        .unwrap();
    let (mut stops, mut all) = (0, 0);
    drive(&mut env, 30, |env| {
        let permitted = env.controlled_cars()[0].verdict().unwrap().permitted;
        assert!(permitted.contains(Action::Stop) && (permitted.len() == 1 || permitted.len() == 4));
        stops += u32::from(permitted.len() == 1);
        all += 1;
    });
    assert!(stops > 0 && stops < all, "{stops} of {all}");
}

/// The mode `mask` refuses other actions before a car moves; policies of the oracle and drawn episodes know no shield.
#[test]
fn masks_refuse_and_oracles_are_free() {
    let noise = "{true_positive_rate: .5, false_positive_rate: .5}";
    let with = |mode: &str| task("easy", &format!("{{sensors: {noise}, shield: {{mode: {mode}}}}}"));
    let mut env = env(&with("mask"));
    env.reset(1).unwrap();
    env.ask_shield().unwrap();
    let permitted = env.controlled_cars()[0].verdict().unwrap().permitted;
    let forbidden = Action::STANDARD
        .into_iter()
        .find(|action| !permitted.contains(*action))
        .unwrap();
    let fault = env.step_shielded(&[forbidden]).unwrap_err();
    assert!(
        fault.message.contains(&format!("does not permit {}", forbidden.name())),
        "{fault:?}"
    );
    assert_eq!((env.steps(), env.city().now()), (0, 0));
    env.step_shielded(&[permitted.iter().next().unwrap()]).unwrap();
    assert_eq!(env.steps(), 1);
    let mut shielded = Env::new(with("override"), Split::Train, ControlMode::First).unwrap();
    let mut free = Env::new(task("easy", "{}"), Split::Train, ControlMode::First).unwrap();
    for seed in 0..5 {
        let run = |env: &mut Env| {
            EpisodeSource::demanding(seed).begin(env).unwrap();
            (env.episode().seed, rollout(env, Policy::Oracle).unwrap())
        };
        assert_eq!(run(&mut shielded), run(&mut free));
    }
}

#[test]
fn faulty_shields_are_reported() {
    let fault = |task: &str| {
        let faults = task_of(&format!("base: expert\ntask: {task}\n"))
            .err()
            .unwrap_or_default();
        assert_eq!(faults.len(), 1, "{task}: {faults:?}");
        assert!(faults[0].primary.is_some(), "{task}: {faults:?}");
        faults[0].message.clone()
    };
    for (task, message) in [
        ("{shield: {mode: guard}}", "one of `mask`, `override`, `probabilistic`"),
        ("{shield: {query: safe}}", "the key `mode` is missing"),
        (
            "{shield: {mode: mask, threshold: .5}}",
            "the mode `mask` has no threshold",
        ),
        (
            "{shield: {mode: probabilistic}, sensors: {dropout: .1}}",
            "these sensors output facts",
        ),
    ] {
        let said = fault(task);
        assert!(said.contains(message), "{task}: {said}");
    }
}
