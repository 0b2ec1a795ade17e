//! Counts how often the facts hold that sensors read, and how often they change.

use crate::cancel::Cancel;
use crate::city::Split;
use crate::diag::Diagnostic;
use crate::rng::{Purpose, RngExt, Seed};
use crate::sim::{FactCounts, SensorModel, Sensors, Settings};
use crate::task::spf::{ControlMode, Env, SpfTask};
use std::sync::Arc;

impl Purpose {
    /// The episodes in which facts are counted; index: the number of the episode.
    pub const SENSOR_MODEL: Purpose = Purpose::new(52);
}

/// The number of episodes in which facts are counted.
const EPISODES: u64 = 512;
/// The maximum number of counted steps.
const STEPS: u32 = 32_768;

/// Drives the ego as the rules want in drawn episodes of the first split that has agents, and counts the observed facts.
pub(super) fn count_facts(
    task: &Arc<SpfTask>,
    sensors: &Arc<Sensors>,
    cancel: &Cancel,
) -> Result<SensorModel, Diagnostic> {
    let mut splits = Split::ALL.into_iter();
    let split = splits.find(|split| task.world().scenario.agent_set(*split).is_some());
    let split = split.unwrap_or(Split::Train);
    let mut env = Env::without_sensors(Arc::clone(task), split, ControlMode::First, Settings::default(), cancel)?;
    let mut counts = FactCounts::new(Arc::clone(sensors));
    let mut steps = 0;
    for episode in 0..EPISODES {
        let mut stream = Seed(0).stream(Purpose::SENSOR_MODEL, episode, 0);
        env.reset(stream.random::<u64>() >> 11)?;
        counts.begin();
        env.controlled_cars()[0].observer().count(&mut counts);
        while env.controlled_cars()[0].is_running() {
            if steps == STEPS {
                return Ok(counts.model());
            }
            env.step(&[env.oracle_action(0)])?;
            env.controlled_cars()[0].observer().count(&mut counts);
            steps += 1;
        }
    }
    Ok(counts.model())
}
