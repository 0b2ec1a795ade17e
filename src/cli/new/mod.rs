//! `logicity new`: creates a folder with files to start from.

use crate::cli::failure::Failure;
use crate::cli::terminal;
use crate::files::Output;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// The files of a new folder, with their contents.
const FILES: [(&str, &str); 3] = [
    ("rules.dl", include_str!("rules.dl")),
    ("city.yaml", include_str!("city.yaml")),
    ("scene.jsonl", include_str!("scene.jsonl")),
];

#[derive(clap::Args)]
pub struct Arguments {
    /// Folder to create; it must not exist
    #[arg(value_name = "NAME")]
    folder: PathBuf,
}

pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    let folder = &arguments.folder;
    let fail = |error: io::Error| match error.kind() {
        io::ErrorKind::AlreadyExists => {
            let message = format!("`{}` exists; `new` overwrites nothing", folder.display());
            Failure::Usage(format!("{message}\nhelp: choose a name that does not exist"))
        }
        _ => Failure::file("create", folder, error),
    };
    if let Some(parent) = folder.parent().filter(|parent| !parent.as_os_str().is_empty()) {
        std::fs::create_dir_all(parent).map_err(|error| Failure::file("create", parent, error))?;
    }
    // Fails if the folder exists, so nothing in it can be overwritten.
    std::fs::create_dir(folder).map_err(fail)?;
    for (name, text) in FILES {
        let path = folder.join(name);
        let fail = |error| Failure::file("write", &path, error);
        let mut file = Output::edit(&path).map_err(fail)?;
        file.write_all(text.as_bytes()).map_err(fail)?;
        file.finish().map_err(fail)?;
    }
    let path = |name: &str| quoted(&folder.join(name));
    let (config, scene, out) = (path("city.yaml"), path("scene.jsonl"), path("out"));
    let trace = quoted(&folder.join("out").join("trace.jsonl"));
    let mut shown = terminal::out();
    let names = FILES.map(|(name, _)| path(name)).join(", ");
    writeln!(shown, "created {names}")?;
    writeln!(shown, "next:")?;
    for command in [
        format!("check {config}"),
        format!("infer {scene} --config {config}"),
        format!("run {config} --out {out}"),
        format!("explain {trace} --agent Car_1"),
    ] {
        writeln!(shown, "  logicity {command}")?;
    }
    Ok(())
}

/// Returns a path as a shell reads it.
fn quoted(path: &Path) -> String {
    let text = path.display().to_string();
    // A path that begins with a hyphen would be an option.
    let text = if text.starts_with('-') {
        format!("./{text}")
    } else {
        text
    };
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "/._-+,=@%".contains(c);
    match text.chars().all(is_plain) {
        true => text,
        false => format!("'{}'", text.replace('\'', r"'\''")),
    }
}
