//! `logicity fcd`: writes a run as floating car data of SUMO.

use crate::city::{AgentKind, Cell, CityMap, Heading};
use crate::cli::failure::Failure;
use crate::cli::inputs::Inputs;
use crate::cli::limits::MemoryOption;
use crate::cli::outputs::{ForceOption, finish, messages, unwritable};
use crate::cli::trace::TraceReader;
use crate::cli::values::decimal;
use crate::diag::{Diagnostic, Sources, counted};
use crate::sim::codes;
use crate::sumo::{FcdWriter, Moving, Plane};
use std::io::Write;
use std::path::PathBuf;

#[derive(clap::Args)]
pub struct Arguments {
    /// Trace written by `logicity run`
    trace: PathBuf,
    /// File to write: traffic.xml; `-` for standard output
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Length of the side of a cell in meters, for a map of blocks, whose upper left corner is at 0,0; road networks
    /// state both [default: 1]
    #[arg(long, value_name = "METERS", value_parser = decimal(0.1..=100.0))]
    cell: Option<f64>,
    /// Length of a tick in seconds
    #[arg(long, value_name = "SECONDS", value_parser = decimal(0.01..=3600.0), default_value_t = 1.0)]
    tick: f64,
    #[command(flatten)]
    force: ForceOption,
    #[command(flatten)]
    _memory: MemoryOption,
}

pub fn run(arguments: &Arguments, sources: &mut Sources) -> Result<(), Failure> {
    let output = arguments.output.as_path();
    let mut trace = TraceReader::open(&arguments.trace)?;
    let scenario = trace.city(sources, None, None)?.scenario;
    let map = CityMap::generate(&scenario.map)?;
    let plane = match (map.network(), arguments.cell) {
        (Some(network), None) => Plane {
            cell: network.cell,
            origin: network.origin,
            tick: arguments.tick,
        },
        (Some(network), Some(_)) => {
            let message = format!(
                "--cell: the map of the run is a road network, which states the side of its cells ({} m); omit the \
                 option",
                network.cell
            );
            return Err(Failure::Usage(message));
        }
        (None, cell) => Plane {
            cell: cell.unwrap_or(1.0),
            origin: [0.0; 2],
            tick: arguments.tick,
        },
    };
    let mut kinds = Vec::new();
    for agent in &trace.header.agents {
        let Some(base) = AgentKind::ALL.into_iter().find(|base| base.name() == agent.kind) else {
            let message = format!("`{}` of `{}` is not a type of agent", agent.kind, agent.id);
            return Err(trace.placed(Diagnostic::new(codes::INVALID_TRACE, message)));
        };
        let kind = scenario.kinds.name(scenario.kinds.of(base, &agent.concepts));
        kinds.push((agent.id.clone(), kind.to_owned(), base));
    }
    let file = arguments
        .force
        .create("fcd", output, &Inputs::new([arguments.trace.clone()]))?;
    let fail = |error| unwritable(output, &error);
    let mut writer = FcdWriter::new(file, &map, plane).map_err(fail)?;
    let mut ticks = 0_usize;
    // The goal and the number of the trip of each agent.
    let mut trips: Vec<([i32; 2], u32)> = Vec::new();
    while let Some(tick) = trace.tick()? {
        if tick.agents.len() != kinds.len() {
            let message = format!(
                "the tick has {}, but the header of the trace has {}",
                counted(tick.agents.len(), "agent"),
                kinds.len()
            );
            return Err(trace.placed(Diagnostic::new(codes::INVALID_TRACE, message)));
        }
        if trips.is_empty() {
            trips = tick.agents.iter().map(|state| (state.goal, 0)).collect();
        }
        for (state, (goal, trip)) in tick.agents.iter().zip(&mut trips) {
            if state.goal != *goal {
                (*goal, *trip) = (state.goal, *trip + 1);
            }
        }
        let agents =
            (tick.agents.iter().zip(&kinds).zip(&trips)).map(|((state, (name, kind_name, kind)), (_, trip))| Moving {
                name,
                trip: *trip,
                kind_name,
                kind: *kind,
                at: Cell::new(state.at[0], state.at[1]),
                next: Cell::new(state.next[0], state.next[1]),
                heading: (state.heading.as_deref())
                    .and_then(|name| Heading::ALL.into_iter().find(|known| known.name() == name)),
            });
        writer.tick(tick.tick, agents).map_err(fail)?;
        ticks += 1;
    }
    finish(writer.finish().map_err(fail)?, output)?;
    let mut out = messages(&[output]);
    writeln!(
        out,
        "{}: {} of {}",
        output.display(),
        counted(ticks, "tick"),
        counted(kinds.len(), "agent")
    )?;
    Ok(())
}
