//! `logicity map`: maps from other programs. The Python package adds `map export`.

use crate::city::Network;
use crate::cli::failure::Failure;
use crate::cli::inputs::{self, Inputs};
use crate::cli::outputs::{ForceOption, finish, messages, unwritable};
use crate::cli::report::report;
use crate::cli::values::decimal;
use crate::datalog::codes;
use crate::diag::{Diagnostic, Sources, Span, counted};
use crate::sumo;
use crate::yaml::read::is_name;
use std::fmt::Write as _;
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Command;

#[derive(clap::Args)]
pub struct Arguments {
    #[command(subcommand)]
    command: MapCommand,
}

#[derive(clap::Subcommand)]
enum MapCommand {
    /// Convert a road network of SUMO (.net.xml), or of OpenStreetMap (.osm) with netconvert, to a map file
    Import(ImportArguments),
}

#[derive(clap::Args)]
struct ImportArguments {
    /// Network: town.net.xml; or town.osm, if SUMO's netconvert is installed (`pip install eclipse-sumo`). Data of
    /// OpenStreetMap are under the Open Database License, which asks to name its contributors. Several are placed side
    /// by side, each in a zone with the name of its file
    #[arg(required = true, value_name = "NETWORK")]
    networks: Vec<PathBuf>,
    /// Map file to write; `-` for standard output
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Length of the side of a cell in meters. Pictures draw a car four cells wide
    #[arg(long, value_name = "METERS", value_parser = decimal(0.1..=100.0), default_value_t = 1.0)]
    cell: f64,
    #[command(flatten)]
    force: ForceOption,
}

pub fn run(arguments: &Arguments, sources: &mut Sources) -> Result<(), Failure> {
    match &arguments.command {
        MapCommand::Import(arguments) => import(arguments, sources),
    }
}

fn import(arguments: &ImportArguments, sources: &mut Sources) -> Result<(), Failure> {
    let mut networks = Vec::new();
    for path in &arguments.networks {
        let is_osm = path.extension().is_some_and(|ending| ending == "osm");
        let text = match is_osm {
            true => converted(path)?,
            false => inputs::read(path)?,
        };
        let source = sources.add(path.display().to_string(), text);
        let imported = sumo::import(sources, source, arguments.cell)?;
        warn_of_signals(&imported.adaptive, sources);
        networks.push((path.as_path(), imported.network));
    }
    let (network, zones) = side_by_side(networks)?;
    let output = arguments.output.as_path();
    let mut file = arguments
        .force
        .create("logicity map import", output, &Inputs::new(arguments.networks.clone()))?;
    let names: Vec<_> = (arguments.networks.iter())
        .map(|path| path.file_name().unwrap_or_default().to_string_lossy())
        .collect();
    let made = format!(
        "# Made from {} by `logicity map import`.\n",
        names.join(", ").replace(char::is_control, " ")
    );
    let text = made + &sumo::map_file(&network) + &zones;
    let written = file.write_all(text.as_bytes());
    written.map_err(|error| unwritable(output, &error))?;
    finish(file, output)?;
    let [rows, cols] = network.size;
    let counts = [
        counted(network.lanes.len(), "lane"),
        counted(network.junctions.len(), "junction"),
        counted(network.connections.len(), "connection"),
    ];
    let mut out = messages(&[output]);
    writeln!(
        out,
        "{}: {}, {rows} x {cols} cells",
        output.display(),
        counts.join(", ")
    )?;
    Ok(())
}

/// Warns of signals whose phases the map repeats, although they follow the traffic.
fn warn_of_signals(adaptive: &[Span], sources: &Sources) {
    let Some((&first, others)) = adaptive.split_first() else {
        return;
    };
    let message = "the phases of this signal follow the traffic, but not on the map";
    let mut fault = Diagnostic::new(codes::IGNORED, message).at(first, "the map repeats its phases as they stand here");
    if !others.is_empty() {
        fault = fault.note(format!("{} like it", counted(others.len(), "further signal")));
    }
    report(
        &[fault.help("make the network with static signals: `netgenerate --tls.default-type static`")],
        sources,
    );
}

/// The columns between two networks on a map.
const GAP: u32 = 20;

/// Places networks side by side, and returns the zones of several as text.
fn side_by_side(networks: Vec<(&Path, Network)>) -> Result<(Network, String), Failure> {
    let count = networks.len();
    let mut all: Option<Network> = None;
    let mut zones = String::from("zones:\n");
    let mut taken: Vec<String> = Vec::new();
    for (path, network) in networks {
        if count == 1 {
            return Ok((network, String::new()));
        }
        let file = path.file_name().unwrap_or_default().to_string_lossy();
        let name = file.split('.').next().unwrap_or_default().replace('-', "_");
        if !is_name(&name) || taken.contains(&name) {
            let message = match taken.contains(&name) {
                true => format!("two networks have the name `{name}`"),
                false => format!("the name `{name}` of a network cannot be that of a zone"),
            };
            let help = "rename a file: letters, digits and `_`, no digit first";
            return Err(Failure::Usage(format!("{}: {message}\nhelp: {help}", path.display())));
        }
        let empty = || Network {
            size: [0, 0],
            junctions: Vec::new(),
            lanes: Vec::new(),
            connections: Vec::new(),
            signals: Vec::new(),
            ..network
        };
        let all = all.get_or_insert_with(empty);
        let [rows, cols] = all.place_beside(network, GAP, &format!("{name}."));
        let [rows, cols] = [rows, cols].map(|span| format!("[{}, {}]", span.start, span.end - 1));
        let _ = writeln!(zones, "  {name}:\n    - {{rows: {rows}, cols: {cols}}}");
        taken.push(name);
    }
    Ok((all.expect("there is one"), zones))
}

/// Converts a file of OpenStreetMap by SUMO's netconvert.
fn converted(path: &Path) -> Result<String, Failure> {
    if let Err(error) = fs::metadata(path) {
        return Err(Failure::file("read", path, error));
    }
    let folder = std::env::temp_dir().join(format!("logicity-{}", std::process::id()));
    fs::create_dir_all(&folder).map_err(|error| Failure::file("create", &folder, error))?;
    let network = folder.join("town.net.xml");
    let result = Command::new("netconvert")
        .args([
            "--osm-files".as_ref(),
            path.as_os_str(),
            "--output-file".as_ref(),
            network.as_os_str(),
        ])
        .args([
            "--geometry.remove",
            "--junctions.join",
            "--roundabouts.guess",
            "--tls.discard-simple",
        ])
        .args(["--sidewalks.guess", "--crossings.guess", "--no-warnings"])
        .output();
    let text = match result {
        Err(_) => Err(Failure::Usage(
            "cannot run `netconvert`, which converts files of OpenStreetMap\nhelp: install SUMO: `pip install \
             eclipse-sumo`"
                .to_owned(),
        )),
        Ok(output) if !output.status.success() => {
            let message = String::from_utf8_lossy(&output.stderr);
            Err(Failure::Usage(format!(
                "netconvert cannot convert `{}`: {}",
                path.display(),
                message.lines().next().unwrap_or("it gave no reason")
            )))
        }
        Ok(_) => inputs::read(&network),
    };
    // A folder that cannot be removed must not hide the result.
    let _ = fs::remove_dir_all(&folder);
    text
}
