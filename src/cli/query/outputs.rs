//! Where the rules of `query` may write, and how their results get there.
//!
//! Rules can come from others, so their outputs stay inside the folder of results, also where links lead, unless the
//! user permits more.

use crate::cli::failure::Failure;
use crate::cli::inputs::Inputs;
use crate::cli::outputs::{finish, unwritable};
use crate::cli::query::{Arguments, predicates, print_predicate, tables};
use crate::cli::terminal;
use crate::datalog::codes;
use crate::datalog::{Directive, MarkKind, Predicate, PredicateId, Program, RowEncoding, RowPlace, Session, facts};
use crate::diag::Diagnostic;
use crate::files::{FileId, Output, make_folder, normalize, real_path};
use flate2::Compression;
use flate2::write::GzEncoder;
use std::collections::BTreeMap;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// The streams that rules may name as files.
const STREAMS: [&str; 3] = ["/dev/stdout", "/dev/stderr", "/dev/null"];

/// The number of files that are written together: each is open until all are complete.
const TOGETHER: usize = 64;

/// One `.output` or `.printsize` directive.
struct Target<'a> {
    id: PredicateId,
    predicate: &'a Predicate,
    directive: &'a Directive,
    /// The file; `None` for standard output.
    path: Option<PathBuf>,
}

impl Target<'_> {
    /// Returns the path, unless it is that of a stream.
    fn file(&self) -> Option<&Path> {
        let is_stream = |path: &&Path| STREAMS.iter().any(|stream| *path == Path::new(stream));
        self.path.as_deref().filter(|path| !is_stream(path))
    }

    /// Returns the fault of two directives that name one file.
    fn clash(&self, first: &Target<'_>) -> Diagnostic {
        let (one, other) = (&first.predicate.name, &self.predicate.name);
        let message = format!("`{one}` and `{other}` have the same file");
        (Diagnostic::new(codes::INVALID_OUTPUT, message).at(self.directive.span, ""))
            .also(first.directive.span, "also written here")
            .help("write another `filename` for one of them")
    }
}

/// Returns the outputs of a program in source order.
fn targets<'a>(program: &'a Program, folder: &Path) -> Vec<Target<'a>> {
    let mut found: Vec<Target<'a>> = Vec::new();
    for (id, predicate) in predicates(program) {
        for directive in &predicate.directives {
            let path = match directive.kind {
                MarkKind::Input | MarkKind::LimitSize => continue,
                MarkKind::Output => path_of(folder, &predicate.name, directive),
                MarkKind::PrintSize => None,
            };
            found.push(Target {
                id,
                predicate,
                directive,
                path,
            });
        }
    }
    found
}

/// Returns the file of an output predicate, or `None` for standard output.
fn path_of(folder: &Path, predicate: &str, directive: &Directive) -> Option<PathBuf> {
    let inside = |name: &str| folder.join(normalize(Path::new(name)));
    match &directive.place {
        _ if folder == Path::new("-") => None,
        RowPlace::Terminal => None,
        RowPlace::Usual => {
            let end = directive.encoding.extension().unwrap_or("csv");
            let compressed = directive.compress && directive.encoding != RowEncoding::Parquet;
            let end = if compressed {
                format!("{end}.gz")
            } else {
                end.to_owned()
            };
            Some(inside(&format!("{predicate}.{end}")))
        }
        RowPlace::File(name) => Some(inside(name)),
    }
}

/// Returns the outputs that are files, each once. Makes the folder of results if there are any. Reports files that the
/// rules may not write.
fn files<'a>(targets: &'a [Target<'a>], arguments: &Arguments) -> Result<Vec<&'a Target<'a>>, Failure> {
    let folder = &arguments.output;
    let files: Vec<(&Target<'_>, &Path)> = targets
        .iter()
        .filter_map(|target| Some((target, target.file()?)))
        .collect();
    if files.is_empty() {
        return Ok(Vec::new());
    }
    make_folder(folder)?;
    let root = real_path(folder).map_err(|error| unwritable(folder, &error))?;
    let (mut faults, mut found) = (Vec::new(), Vec::new());
    let mut known: BTreeMap<PathBuf, &Target<'_>> = BTreeMap::new();
    for (target, path) in files {
        let leads_to = real_path(path).map_err(|error| unwritable(path, &error))?;
        if !arguments.output_anywhere && !leads_to.starts_with(&root) {
            let name = &target.predicate.name;
            let message = format!("`{name}` would be written outside of the folder of results");
            let fault = Diagnostic::new(codes::INVALID_OUTPUT, message).at(target.directive.span, "");
            faults.push(
                (fault.note(format!("it would be written to `{}`", leads_to.display())))
                    .help("use a name inside the folder of `-D`, or permit any file with `--output-anywhere`"),
            );
            continue;
        }
        match known.get(&leads_to) {
            // Files that are included twice may repeat a directive.
            Some(first) if is_repeated(first, target) => {}
            Some(first) => faults.push(target.clash(first)),
            None => {
                known.insert(leads_to, target);
                found.push(target);
            }
        }
    }
    if faults.is_empty() {
        Ok(found)
    } else {
        Err(faults.into())
    }
}

/// Makes the folders of the outputs, and reports files that the rules may not write or that cannot be written, before
/// the evaluation.
pub fn check(program: &Program, arguments: &Arguments, inputs: &Inputs) -> Result<(), Failure> {
    let targets = targets(program, &arguments.output);
    let files = files(&targets, arguments)?;
    let paths: Vec<&Path> = files.iter().filter_map(|target| target.file()).collect();
    for path in &paths {
        make_folder(path.parent().unwrap_or(Path::new(".")))?;
    }
    for group in paths.chunks(TOGETHER) {
        drop(arguments.force.create_all("query", group, inputs)?);
    }
    Ok(())
}

/// Returns whether two directives write the same rows in the same form.
fn is_repeated(one: &Target<'_>, other: &Target<'_>) -> bool {
    let form = |target: &Target<'_>| {
        let Directive {
            encoding,
            format,
            compress,
            ..
        } = target.directive;
        (target.id, *encoding, format.clone(), *compress)
    };
    form(one) == form(other)
}

/// Writes every output predicate to its file, or to `out` if its directive says so or the folder of results is `-`.
/// Writes the sizes of `.printsize` predicates to `out`. Prints the path of each file to standard error.
pub fn write(out: &mut dyn Write, session: &Session, arguments: &Arguments, inputs: &Inputs) -> Result<(), Failure> {
    let to_terminal = arguments.output == Path::new("-");
    let targets = targets(session.program(), &arguments.output);
    for target in targets.iter().filter(|target| target.file().is_none()) {
        let (id, name) = (target.id, &target.predicate.name);
        let mut format = target.directive.format.clone();
        // Soufflé does the same.
        format.headers |= to_terminal;
        let json = match target.directive.encoding {
            RowEncoding::Json { objects } => Some(objects),
            // A terminal shows a table as text.
            RowEncoding::Text | RowEncoding::Parquet => None,
        };
        let header = match json {
            Some(_) => String::new(),
            None => facts::header(target.predicate, &format),
        };
        let rows = |out: &mut dyn Write| match json {
            Some(objects) => facts::write_json(session, id, objects, out),
            None => facts::write_rows(session, id, &format, out),
        };
        match &target.path {
            _ if target.directive.kind == MarkKind::PrintSize => writeln!(out, "{name}\t{}", session.len(id))?,
            None => print_predicate(out, name, &header, rows)?,
            Some(stream) => {
                out.flush()?;
                let mut output = arguments.force.create("query", stream, inputs)?;
                write_rows(&mut output, target, session).map_err(|error| unwritable(stream, &error))?;
                finish(output, stream)?;
            }
        }
    }
    let mut written = BTreeMap::new();
    // Checks the links again: the evaluation may have taken long.
    for group in files(&targets, arguments)?.chunks(TOGETHER) {
        write_files(group, session, (arguments, inputs), &mut written)?;
    }
    Ok(())
}

/// Writes predicates to files, which appear once all are complete. `written` has the files of earlier calls.
fn write_files<'a>(
    targets: &[&'a Target<'a>],
    session: &Session,
    (arguments, inputs): (&Arguments, &Inputs),
    written: &mut BTreeMap<FileId, &'a Target<'a>>,
) -> Result<(), Failure> {
    let paths: Vec<&Path> = targets.iter().filter_map(|target| target.file()).collect();
    // Of names that look different, one file results if the file system ignores case, or normalizes names.
    let written_as = |path: &Path, written: &BTreeMap<FileId, &'a Target<'a>>| written.get(&FileId::of(path)?).copied();
    for (target, path) in targets.iter().zip(&paths) {
        if let Some(first) = written_as(path, written) {
            return Err(target.clash(first).into());
        }
    }
    let mut outputs: Vec<Output> = arguments.force.create_all("query", &paths, inputs)?;
    for ((target, path), output) in targets.iter().zip(&paths).zip(&mut outputs) {
        write_rows(output, target, session).map_err(|error| unwritable(path, &error))?;
    }
    Output::finish_all(outputs).map_err(|(position, error)| unwritable(paths[position], &error))?;
    for (target, path) in targets.iter().zip(&paths) {
        let _ = writeln!(
            terminal::err(),
            "wrote {}",
            path.strip_prefix(".").unwrap_or(path).display()
        );
        let first = FileId::of(path).and_then(|file| written.insert(file, target));
        if let Some(first) = first {
            return Err(target.clash(first).into());
        }
    }
    Ok(())
}

/// Writes a predicate in the encoding of its directive.
fn write_rows(output: &mut Output, target: &Target<'_>, session: &Session) -> io::Result<()> {
    let write = |out: &mut dyn Write| match target.directive.encoding {
        RowEncoding::Json { objects } => facts::write_json(session, target.id, objects, out),
        _ => {
            let format = &target.directive.format;
            out.write_all(facts::header(target.predicate, format).as_bytes())?;
            facts::write_rows(session, target.id, format, out)
        }
    };
    match (target.directive.encoding, target.directive.compress) {
        (RowEncoding::Parquet, _) => tables::write(session, target.id, output),
        (_, false) => write(output),
        (_, true) => {
            let mut stream = GzEncoder::new(output, Compression::default());
            write(&mut stream)?;
            stream.finish().map(drop)
        }
    }
}
