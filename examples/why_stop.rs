//! Runs the expert city until a car stops, and prints why: `cargo run --example why_stop`.
//!
//! ```text
//! tick 1: Car_1 at [82, 94], heading Right: Stop
//!
//! Stop("Car_1")  by S6: an ambulance waits for the old on its right  [transfer-medium.dl:14]
//! ├─ IsAmbulance("Car_1")
//! ├─ RightOf("Pedestrian_6", "Car_1")
//! ├─ IsOld("Pedestrian_6")
//! └─ in view: Sees("Car_1", "Pedestrian_6")
//! ```

use logicity::builtin::BuiltinFiles;
use logicity::cancel::Cancel;
use logicity::city::{Action, Agent, AgentKind, Split};
use logicity::diag::{Sources, render};
use logicity::rng::Seed;
use logicity::sim::{AgentTick, LoadError, LoadedCity, Settings, Simulation};
use std::path::Path;
use std::sync::Arc;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut sources = Sources::new();
    let loaded = LoadedCity::load(&mut sources, Path::new("expert"), None, &BuiltinFiles);
    let city = loaded.map_err(|error| match error {
        LoadError::Config(faults) | LoadError::Rules(faults) => render(&faults, &sources, false),
        LoadError::RuleFile(path, error) => format!("{}: {error}", path.display()),
    })?;
    let world = city.world().map_err(|faults| render(&faults, &sources, false))?;
    let simulation = Simulation::new(Arc::new(world), Split::Test, Seed(4), Settings::default());
    let mut simulation = simulation.map_err(|fault| fault.message)?;
    for _ in 0..100 {
        simulation.tick(&[]).map_err(|fault| fault.message)?;
        let stops = |(done, agent): (&AgentTick, &Agent)| done.action == Action::Stop && agent.kind == AgentKind::Car;
        let stopped = (simulation.report().agents.iter().zip(simulation.agents())).position(stops);
        if let Some(agent) = stopped {
            let decision = simulation.decision(agent).map_err(|fault| fault.message)?;
            print!("{}", decision.account(None, &Cancel::never())?.text(&sources));
            return Ok(());
        }
    }
    println!("no car stopped in 100 ticks");
    Ok(())
}
