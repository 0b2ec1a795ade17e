//! Runs the expert city until a car stops, and prints why: `cargo run --example why_stop`.

use logicity::builtin::BuiltinFiles;
use logicity::cancel::Cancel;
use logicity::city::{Action, AgentKind, Split};
use logicity::diag::{Sources, render};
use logicity::rng::Seed;
use logicity::sim::{LoadError, LoadedCity, Settings, Simulation};
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
        let report = simulation.tick(&[]).map_err(|fault| fault.message)?;
        let actions = report.agents.iter().map(|agent| agent.action);
        let stopped = (actions.zip(simulation.agents()))
            .position(|(action, agent)| action == Action::Stop && agent.kind == AgentKind::Car);
        if let Some(agent) = stopped {
            let decision = simulation.decision(agent).map_err(|fault| fault.message)?;
            print!("{}", decision.account(None, &Cancel::never())?.text(&sources));
            return Ok(());
        }
    }
    println!("no car stopped in 100 ticks");
    Ok(())
}
