//! `logicity route`: plans a route.

use crate::city::codes;
use crate::city::{AgentKind, Routing};
use crate::city::{Cell, CityMap, NoRoute, Router};
use crate::cli::failure::Failure;
use crate::cli::limits::MemoryOption;
use crate::cli::load::find_map;
use crate::cli::terminal;
use crate::cli::values::one_of;
use crate::diag::{Diagnostic, Sources};
use std::io::{BufWriter, Write};
use std::sync::Arc;

#[derive(clap::Args)]
pub struct Arguments {
    /// Name of a built-in map, or path to a map file
    #[arg(long, default_value = "square-5x5")]
    map: String,
    /// Type of agent that travels
    #[arg(long = "type", value_parser = one_of(&AgentKind::ALL, traveler))]
    kind: AgentKind,
    /// Cell where the route starts
    #[arg(long, value_name = "ROW,COL", value_parser = cell, allow_hyphen_values = true)]
    from: Cell,
    /// Cell where the route ends
    #[arg(long, value_name = "ROW,COL", value_parser = cell, allow_hyphen_values = true)]
    to: Cell,
    /// Routing of cars: the shortest weighted path (as in the paper), or the fewest nodes of the road graph (as in the
    /// published program)
    #[arg(long, value_parser = one_of(&Routing::ALL, Routing::name), default_value = "weighted")]
    routing: Routing,
    #[command(flatten)]
    _memory: MemoryOption,
}

fn traveler(kind: AgentKind) -> &'static str {
    match kind {
        AgentKind::Car => "car",
        AgentKind::Pedestrian => "pedestrian",
    }
}

fn cell(text: &str) -> Result<Cell, String> {
    let expected = || "expected row and column as two integers, for example `46,20`".to_owned();
    let (row, col) = text.split_once(',').ok_or_else(expected)?;
    let number = |text: &str| text.trim().parse::<i32>().map_err(|_| expected());
    Ok(Cell::new(number(row)?, number(col)?))
}

/// Prints one `row,col` per line, from the first cell to the last.
pub fn run(arguments: &Arguments, sources: &mut Sources) -> Result<(), Failure> {
    let map = CityMap::generate(&find_map(sources, &arguments.map)?)?;
    let kind = arguments.kind;
    let router = Router::new(Arc::new(map), arguments.routing);
    let (from, to) = (arguments.from, arguments.to);
    let map = router.map();
    let route = router.plan(kind, from, to).map_err(|reason| {
        let place = |cell: Cell| format!("[{}, {}]", cell.row, cell.col);
        let what = traveler(kind);
        let outside = |cell: Cell| {
            let bounds = format!("rows 0 to {}, columns 0 to {}", map.rows() - 1, map.cols() - 1);
            (!map.contains(cell)).then(|| format!("{} is not on the map, which has {bounds}", place(cell)))
        };
        let rule = match kind {
            AgentKind::Car => "cars start and end on a traffic street, next to the mid line and outside intersections",
            AgentKind::Pedestrian => "pedestrians start and end on walking streets and crossings",
        };
        let (message, cell) = match reason {
            NoRoute::Start => (format!("a {what} cannot start at {}", place(from)), Some(from)),
            NoRoute::Goal => (format!("a {what} cannot arrive at {}", place(to)), Some(to)),
            NoRoute::Unconnected => (format!("no {what} can go from {} to {}", place(from), place(to)), None),
            NoRoute::TooFar => {
                let message =
                    "the published search for walking routes exceeds its limit; `--routing weighted` needs no search";
                (message.to_owned(), None)
            }
        };
        let fault = Diagnostic::new(codes::NO_ROUTE, format!("{message} on `{}`", map.name));
        match cell {
            Some(cell) => Failure::option([fault.help(outside(cell).unwrap_or_else(|| rule.to_owned()))]),
            None => fault.into(),
        }
    })?;
    let mut out = BufWriter::new(terminal::data());
    for cell in route.cells() {
        writeln!(out, "{},{}", cell.row, cell.col)?;
    }
    out.flush()?;
    Ok(())
}
