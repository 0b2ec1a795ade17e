//! The files that a command writes, of which one may be standard output.

use crate::cli::failure::Failure;
use crate::cli::inputs::Inputs;
use crate::cli::terminal;
use crate::files::{self, Output, Overwrite};
use std::io::{self, Write};
use std::path::Path;

/// The option to replace files of other programs.
#[derive(clap::Args)]
pub struct ForceOption {
    /// Replace output files that this command did not write, or that have changed since. Files that the command reads
    /// are never replaced
    #[arg(long)]
    force: bool,
}

impl ForceOption {
    pub fn overwrite(&self) -> Overwrite {
        if self.force { Overwrite::Any } else { Overwrite::Own }
    }

    /// Begins to write an output file of the command `by`; `-` means standard output. Fails if the command reads that
    /// file.
    pub fn create(&self, by: &str, path: &Path, inputs: &Inputs) -> Result<Output, Failure> {
        if path == Path::new("-") {
            return Ok(terminal::screened(Output::stdout()));
        }
        let outputs = self.create_all(by, &[path], inputs)?;
        Ok(outputs.into_iter().next().expect("one for each path"))
    }

    /// Begins to write several output files, none of which is standard output.
    pub fn create_all(&self, by: &str, paths: &[&Path], inputs: &Inputs) -> Result<Vec<Output>, Failure> {
        paths.iter().try_for_each(|path| inputs.refuse(path))?;
        let outputs = Output::create_all(paths, by, self.overwrite());
        let outputs = outputs.map_err(|(position, error)| unwritable(paths[position], &error))?;
        Ok(outputs.into_iter().map(terminal::screened).collect())
    }
}

/// Returns whether an output is standard output: `-`, `/dev/stdout` or a link to it.
pub fn is_stdout(path: &Path) -> bool {
    path == Path::new("-") || files::is_stdout(path)
}

/// Fails if several outputs, given with their options, are standard output.
pub fn refuse_mixing<'a>(outputs: impl IntoIterator<Item = (&'a str, &'a Path)>) -> Result<(), Failure> {
    let mixed = outputs.into_iter().filter(|(_, path)| is_stdout(path));
    match mixed.map(|(option, _)| option).collect::<Vec<_>>()[..] {
        [one, other, ..] => Err(Failure::Usage(format!(
            "{one} and {other} would both write to standard output; name a file for one of them"
        ))),
        _ => Ok(()),
    }
}

/// Fails if a folder for results is `-`, which means standard output where a command writes one file.
pub fn refuse_stdout_as_folder(folder: &Path) -> Result<(), Failure> {
    match folder == Path::new("-") {
        true => Err(Failure::Usage(
            "this command writes several files, so `-` cannot mean standard output\nhelp: name a folder; `./-` is the \
             folder with that name"
                .to_owned(),
        )),
        false => Ok(()),
    }
}

/// Returns where to print messages about the results: standard error if a result goes to standard output.
pub fn messages(results: &[&Path]) -> Box<dyn Write> {
    match results.iter().any(|path| is_stdout(path)) {
        true => Box::new(terminal::err()),
        false => Box::new(terminal::out()),
    }
}

/// Prints the paths of further results than the first, which the summary of a command names.
pub fn print_others(out: &mut dyn Write, others: &[Option<&Path>]) -> io::Result<()> {
    let mut others = others.iter().flatten().filter(|path| !is_stdout(path));
    others.try_for_each(|path| writeln!(out, "wrote {}", path.display()))
}

/// Gives a complete output file its name.
pub fn finish(output: Output, path: &Path) -> Result<(), Failure> {
    output.finish().map_err(|error| unwritable(path, &error))
}

/// Reports an output file that cannot be written.
pub fn unwritable(path: &Path, error: &io::Error) -> Failure {
    if is_stdout(path) {
        return io::Error::new(error.kind(), error.to_string()).into();
    }
    let help = match error.kind() {
        io::ErrorKind::AlreadyExists => "\nhelp: choose another path, or replace it with `--force`",
        _ => "",
    };
    Failure::Usage(format!("cannot write `{}`: {error}{help}", path.display()))
}

/// Reports a file of an earlier run that cannot be removed.
pub fn unremovable(path: &Path, error: &io::Error) -> Failure {
    Failure::Usage(format!(
        "cannot remove `{}`, which an earlier run wrote: {error}\nhelp: remove it, or choose another folder",
        path.display()
    ))
}
