//! `logicity route`

use super::{Failure, find_map};
use crate::city::{Cell, CityMap, Router};
use crate::config::{AgentKind, Routing};
use crate::diag::{Code, Diagnostic, Sources};
use clap::ValueEnum;
use std::io::{self, BufWriter, Write};

#[derive(clap::Args)]
pub struct Arguments {
    /// Name of a built-in map, or path to a map file
    #[arg(long, default_value = "square-5x5")]
    map: String,
    /// Who travels
    #[arg(long = "type", value_enum)]
    kind: Traveller,
    /// First cell
    #[arg(long, value_name = "ROW,COL", value_parser = cell)]
    from: Cell,
    /// Last cell
    #[arg(long, value_name = "ROW,COL", value_parser = cell)]
    to: Cell,
    /// How cars choose: least weighted length (the paper), or fewest nodes of the road graph (the published program)
    #[arg(long, value_enum, default_value = "weighted")]
    routing: Choice,
}

#[derive(Clone, Copy, ValueEnum)]
enum Traveller {
    Car,
    Pedestrian,
}

#[derive(Clone, Copy, ValueEnum)]
enum Choice {
    Weighted,
    Hops,
}

fn cell(text: &str) -> Result<Cell, String> {
    let expected = || "expected two whole numbers, row and column, as in `46,20`".to_owned();
    let (row, col) = text.split_once(',').ok_or_else(expected)?;
    let number = |text: &str| text.trim().parse::<i32>().map_err(|_| expected());
    Ok(Cell::new(number(row)?, number(col)?))
}

/// Prints one `row,col` a line, from the first cell to the last.
pub fn run(arguments: &Arguments, sources: &mut Sources) -> Result<(), Failure> {
    let map = CityMap::generate(&find_map(sources, &arguments.map)?)?;
    let kind = match arguments.kind {
        Traveller::Car => AgentKind::Car,
        Traveller::Pedestrian => AgentKind::Pedestrian,
    };
    let routing = match arguments.routing {
        Choice::Weighted => Routing::Weighted,
        Choice::Hops => Routing::Hops,
    };
    let (from, to) = (arguments.from, arguments.to);
    let Some(route) = Router::new(&map).plan(&map, kind, routing, from, to) else {
        let place = |cell: Cell| format!("[{}, {}]", cell.row, cell.col);
        let rule = match kind {
            AgentKind::Car => "cars start and end at curb cells of traffic streets",
            AgentKind::Pedestrian => "pedestrians walk on walking streets and crossings",
        };
        let message = format!(
            "no {} route on `{}` from {} to {}",
            kind.name().to_lowercase(),
            map.name,
            place(from),
            place(to)
        );
        return Err(Diagnostic::new(Code::NoRoute, message)
            .note(format!(
                "the map has rows 0 to {} and columns 0 to {}; {rule}",
                map.rows() - 1,
                map.cols() - 1
            ))
            .into());
    };
    let mut out = BufWriter::new(io::stdout().lock());
    for cell in route.cells {
        writeln!(out, "{},{}", cell.row, cell.col)?;
    }
    out.flush()?;
    Ok(())
}
