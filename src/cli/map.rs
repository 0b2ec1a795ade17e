//! `logicity map`: maps from other programs. The Python package adds `map export`.

use crate::cli::failure::Failure;
use crate::cli::inputs::{self, Inputs};
use crate::cli::outputs::{ForceOption, finish, messages, unwritable};
use crate::cli::values::decimal;
use crate::diag::{Sources, counted};
use crate::sumo;
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
    /// OpenStreetMap are under the Open Database License, which asks to name its contributors
    network: PathBuf,
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
    let path = arguments.network.as_path();
    let is_osm = path.extension().is_some_and(|ending| ending == "osm");
    let text = match is_osm {
        true => converted(path)?,
        false => inputs::read(path)?,
    };
    let source = sources.add(path.display().to_string(), text);
    let network = sumo::import(sources, source, arguments.cell)?;
    let output = arguments.output.as_path();
    let mut file = arguments
        .force
        .create("logicity map import", output, &Inputs::new([path.to_owned()]))?;
    let name = path
        .file_name()
        .map(|name| name.to_string_lossy().into_owned())
        .unwrap_or_default();
    let made = format!(
        "# Made from {} by `logicity map import`.\n",
        name.replace(char::is_control, " ")
    );
    let written = (file.write_all(made.as_bytes())).and_then(|()| file.write_all(sumo::map_file(&network).as_bytes()));
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
