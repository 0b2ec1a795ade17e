//! Where the rules of `query` may write, and how their results get there.
//!
//! Rules can come from others, so their outputs stay inside the folder of results, also where links lead, unless the
//! user permits more.

use crate::cli::query::{Arguments, print_relation, relations};
use crate::cli::{Failure, Inputs, finish, terminal, unwritable};
use crate::datalog::{Directive, MarkKind, Program, RelId, Relation, RowPlace, Session, facts};
use crate::diag::{Code, Diagnostic};
use crate::files::{is_same_file, make_folder, normalize, real_path};
use flate2::Compression;
use flate2::write::GzEncoder;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// The streams that rules may name as files.
const STREAMS: [&str; 3] = ["/dev/stdout", "/dev/stderr", "/dev/null"];

/// One `.output` or `.printsize` directive.
struct Target<'a> {
    id: RelId,
    relation: &'a Relation,
    directive: &'a Directive,
    /// The file; `None` for standard output.
    path: Option<PathBuf>,
}

/// Returns the outputs of a program in source order.
fn targets<'a>(program: &'a Program, folder: &Path) -> Vec<Target<'a>> {
    let mut found: Vec<Target<'a>> = Vec::new();
    for (id, relation) in relations(program) {
        for directive in &relation.directives {
            let path = match directive.kind {
                MarkKind::Input => continue,
                MarkKind::Output => path_of(folder, &relation.name, directive),
                MarkKind::PrintSize => None,
            };
            found.push(Target {
                id,
                relation,
                directive,
                path,
            });
        }
    }
    found
}

/// Returns the file of an output relation, or `None` for standard output.
fn path_of(folder: &Path, relation: &str, directive: &Directive) -> Option<PathBuf> {
    let inside = |name: &str| folder.join(normalize(Path::new(name)));
    match &directive.place {
        _ if folder == Path::new("-") => None,
        RowPlace::Terminal => None,
        RowPlace::Usual => {
            let end = if directive.compress { "csv.gz" } else { "csv" };
            Some(inside(&format!("{relation}.{end}")))
        }
        RowPlace::File(name) => Some(inside(name)),
    }
}

/// Makes the folders of the outputs, and reports files that the rules may not write or that cannot be written, before
/// the evaluation.
pub fn check(program: &Program, arguments: &Arguments, inputs: &Inputs) -> Result<(), Failure> {
    let folder = &arguments.output;
    let targets = targets(program, folder);
    let files: Vec<(&Target<'_>, &Path)> = (targets.iter())
        .filter_map(|target| Some((target, target.path.as_deref()?)))
        .filter(|(_, path)| !STREAMS.iter().any(|stream| *path == Path::new(stream)))
        .collect();
    if files.is_empty() {
        return Ok(());
    }
    make_folder(folder)?;
    let root = real_path(folder).map_err(|error| unwritable(folder, &error))?;
    let mut faults = Vec::new();
    let mut real: Vec<(PathBuf, &Target<'_>)> = Vec::new();
    for (target, path) in &files {
        let Target {
            directive, relation, ..
        } = target;
        let fault = |message: String| Diagnostic::new(Code::INVALID_OUTPUT, message).at(directive.span, "");
        let leads_to = real_path(path).map_err(|error| unwritable(path, &error))?;
        if !arguments.output_anywhere && !leads_to.starts_with(&root) {
            let message = format!("`{}` would be written outside of the folder of results", relation.name);
            let place = format!("it would be written to `{}`", leads_to.display());
            faults.push(
                (fault(message).note(place))
                    .help("use a name inside the folder of `-D`, or permit any file with `--output-anywhere`"),
            );
            continue;
        }
        match real.iter().find(|(known, _)| *known == leads_to) {
            // Files that are included twice may repeat a directive.
            Some((_, first)) if is_repeated(first, target) => {}
            Some((_, first)) => {
                let message = format!("`{}` and `{}` have the same file", first.relation.name, relation.name);
                faults.push(
                    (fault(message).also(first.directive.span, "also written here"))
                        .help("write another `filename` for one of them"),
                );
            }
            None => real.push((leads_to, target)),
        }
    }
    if !faults.is_empty() {
        return Err(faults.into());
    }
    for (_, path) in &files {
        make_folder(path.parent().unwrap_or(Path::new(".")))?;
        arguments.force.check("query", path, inputs)?;
    }
    Ok(())
}

/// Returns whether two directives write the same rows in the same form.
fn is_repeated(one: &Target<'_>, other: &Target<'_>) -> bool {
    let form = |target: &Target<'_>| (target.id, target.directive.format.clone(), target.directive.compress);
    form(one) == form(other)
}

/// Writes every output relation to its file, or to `out` if its directive says so or the folder of results is `-`.
/// Writes the sizes of `.printsize` relations to `out`. Prints the path of each file to standard error.
pub fn write(out: &mut dyn Write, session: &Session, arguments: &Arguments, inputs: &Inputs) -> Result<(), Failure> {
    let to_terminal = arguments.output == Path::new("-");
    let targets = targets(session.program(), &arguments.output);
    let mut written: Vec<&Target<'_>> = Vec::new();
    for target in &targets {
        let Target {
            id,
            relation,
            directive,
            path,
        } = target;
        if directive.kind == MarkKind::PrintSize {
            writeln!(out, "{}\t{}", relation.name, session.len(*id))?;
            continue;
        }
        let mut format = directive.format.clone();
        // Soufflé does the same.
        format.headers |= to_terminal;
        let header = facts::header(relation, &format);
        let rows = |out: &mut dyn Write| facts::write_rows(session, *id, &format, out);
        let Some(path) = path else {
            print_relation(out, &relation.name, &header, rows)?;
            continue;
        };
        let same = |known: &&&Target<'_>| known.path.as_deref().is_some_and(|known| is_same_file(known, path));
        match written.iter().find(same) {
            Some(known) if is_repeated(known, target) => continue,
            // The file system ignores case, or normalizes names.
            Some(known) => {
                let message = format!("`{}` and `{}` have the same file", known.relation.name, relation.name);
                let fault = Diagnostic::new(Code::INVALID_OUTPUT, message).at(directive.span, "");
                return Err(fault.help("write another `filename` for one of them").into());
            }
            None => {}
        }
        write_relation(path, directive.compress, (inputs, arguments), &header, rows)?;
        if !STREAMS.iter().any(|stream| path == Path::new(stream)) {
            let shown = path.strip_prefix(".").unwrap_or(path).display();
            let _ = writeln!(terminal::err(), "wrote {shown}");
        }
        written.push(target);
    }
    Ok(())
}

/// Writes a relation to a file, which appears only once it is complete.
fn write_relation(
    path: &Path,
    compress: bool,
    (inputs, arguments): (&Inputs, &Arguments),
    header: &str,
    rows: impl Fn(&mut dyn Write) -> io::Result<()>,
) -> Result<(), Failure> {
    let fail = |error: io::Error| unwritable(path, &error);
    let mut file = arguments.force.create("query", path, inputs)?;
    if compress {
        let mut stream = GzEncoder::new(&mut file, Compression::default());
        stream.write_all(header.as_bytes()).map_err(fail)?;
        rows(&mut stream).map_err(fail)?;
        stream.finish().map_err(fail)?;
    } else {
        file.write_all(header.as_bytes()).map_err(fail)?;
        rows(&mut file).map_err(fail)?;
    }
    finish(file, path)
}
