//! The model of the facts that sensors read, from how often they hold and change.

use crate::cancel::Cancel;
use crate::city::Split;
use crate::diag::Diagnostic;
use crate::rng::{Purpose, Seed};
use crate::sim::{FactCounts, SensorModel, Sensors, Settings};
use crate::task::spf::episode::episode_seed;
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

impl SpfTask {
    /// Returns the model of the facts that sensors read. It is a function of the task. `None` if the sensors' output needs
    /// no model.
    ///
    /// # Errors
    /// As [`Env::new`] and [`Env::reset`]; `cancelled` on cancellation.
    pub fn sensor_model(self: &Arc<Self>, cancel: &Cancel) -> Result<Option<&Arc<SensorModel>>, Diagnostic> {
        let Some(sensors) = self.sensors.as_ref().filter(|sensors| sensors.needs_model()) else {
            return Ok(None);
        };
        if self.sensor_model.get().is_none() {
            let model = count_facts(self, sensors, cancel)?;
            // Another thread may have counted the same.
            let _ = self.sensor_model.set(Arc::new(model));
        }
        Ok(self.sensor_model.get())
    }
}

/// Counts the observed facts in drawn episodes of the oracle, in the first split that has agents. It ends after
/// [`EPISODES`] episodes or [`STEPS`] steps.
fn count_facts(task: &Arc<SpfTask>, sensors: &Arc<Sensors>, cancel: &Cancel) -> Result<SensorModel, Diagnostic> {
    let mut splits = Split::ALL.into_iter();
    let split = splits.find(|split| task.world().scenario.agent_set(*split).is_some());
    let split = split.unwrap_or(Split::Train);
    let mut env =
        Env::without_sensors_and_shield(Arc::clone(task), split, ControlMode::First, Settings::default(), cancel)?;
    let mut counts = FactCounts::new(Arc::clone(sensors));
    let mut steps = 0;
    for episode in 0..EPISODES {
        let mut stream = Seed(0).stream(Purpose::SENSOR_MODEL, episode, 0);
        env.reset(episode_seed(&mut stream))?;
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
