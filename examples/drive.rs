//! Measures three policies on the recorded validation episodes of Safe Path Following: `cargo run --example drive`.
//!
//! ```text
//! oracle        success rate 1.00 [0.91, 1.00]
//! random        success rate 0.20 [0.10, 0.35]
//! always Normal success rate 0.00 [0.00, 0.09]
//! ```

use logicity::builtin::BuiltinFiles;
use logicity::city::{Action, Split};
use logicity::diag::{Sources, render};
use logicity::rng::Seed;
use logicity::sim::{LoadError, LoadedCity};
use logicity::task::spf::{ControlMode, Env, EpisodeSet, Policy, SpfTask, rollout, summarize};
use std::path::Path;
use std::sync::Arc;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut sources = Sources::new();
    let loaded = LoadedCity::load(&mut sources, Path::new("easy"), None, &BuiltinFiles);
    let city = loaded.map_err(|error| match error {
        LoadError::Config(faults) | LoadError::Rules(faults) => render(&faults, &sources, false),
        LoadError::RuleFile(path, error) => format!("{}: {error}", path.display()),
    })?;
    let world = city.world().map_err(|faults| render(&faults, &sources, false))?;
    let task = SpfTask::new(Arc::new(world), &sources).map_err(|faults| render(&faults, &sources, false))?;
    let set = EpisodeSet::load(&task, Split::Val, &mut sources, &BuiltinFiles);
    let set = set.map_err(|fault| render(&[fault], &sources, false))?;

    let task = Arc::new(task);
    let env = Env::new(Arc::clone(&task), Split::Val, ControlMode::First);
    let mut env = env.map_err(|fault| fault.message)?;
    for (name, policy) in [
        ("oracle", Policy::Oracle),
        ("random", Policy::Random(Seed(1))),
        ("always Normal", Policy::Always(Action::Normal)),
    ] {
        let mut rollouts = Vec::new();
        for episode in &set.episodes {
            env.reset_to(episode).map_err(|fault| fault.message)?;
            rollouts.push(rollout(&mut env, policy).map_err(|fault| fault.message)?);
        }
        let rate = summarize(&task, &rollouts, None).tsr;
        println!(
            "{name:13} success rate {:.2} [{:.2}, {:.2}]",
            rate.value, rate.low, rate.high
        );
    }
    Ok(())
}
