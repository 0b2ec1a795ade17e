//! Where included files are: beside the including one, in the folders of the caller, or among the built-in ones.

use std::path::{Path, PathBuf};

use crate::codes;
use crate::diag::{self, Diagnostic, Span, similar_file, similar_file_in};
use crate::files::{BUILTIN_FOLDER, ReadError, ReadFile, builtin_path, portable, slash_help};

/// The extension of rule files.
pub(super) const ENDING: &str = "dl";

/// The folder of the built-in rule files, which includes omit.
pub(super) const BUILTIN_RULES: &str = "rules/";

/// A file that another one includes.
pub(super) struct Wanted<'a> {
    /// The path as the include writes it.
    pub path: &'a str,
    /// The name of the including file.
    pub from: &'a str,
    /// Whether the folder of the including file does not count: `#include <file>`.
    pub elsewhere: bool,
    pub span: Span,
}

impl Wanted<'_> {
    fn folder(&self) -> &Path {
        Path::new(self.from).parent().unwrap_or(Path::new(""))
    }

    /// Returns the paths to try, in order.
    pub(super) fn candidates(&self, folders: &[PathBuf]) -> Vec<PathBuf> {
        let beside = (!self.elsewhere).then(|| self.folder().join(self.path));
        let builtin = builtin_path(self.path);
        // `join` with an absolute path returns that path, so all candidates are the same.
        let builtin = builtin.starts_with(BUILTIN_FOLDER).then_some(builtin);
        let mut paths: Vec<PathBuf> = beside.into_iter().collect();
        paths.extend(folders.iter().map(|folder| folder.join(self.path)));
        paths.extend(builtin);
        paths.into_iter().map(portable).collect()
    }

    /// Reports that no candidate can be read.
    pub(super) fn unreadable(&self, folders: &[PathBuf], error: (&Path, ReadError), read: &dyn ReadFile) -> Diagnostic {
        let (path, error) = (error.0.display(), error.1);
        match error {
            ReadError::NotFound => self.missing(folders, read),
            ReadError::NotText { .. } => {
                Diagnostic::new(diag::codes::NOT_TEXT, format!("`{path}` is {error}")).at(self.span, "included here")
            }
            ReadError::TooLarge(_) => Diagnostic::new(diag::codes::LIMIT_EXCEEDED, format!("`{path}` is {error}"))
                .at(self.span, "included here"),
            ReadError::Folder | ReadError::Io(_) => {
                Diagnostic::new(codes::MISSING_INCLUDE, format!("cannot read `{path}`: {error}"))
                    .at(self.span, "included here")
            }
        }
    }

    fn missing(&self, folders: &[PathBuf], read: &dyn ReadFile) -> Diagnostic {
        let (mut tried, mut builtin) = (Vec::new(), false);
        for path in self.candidates(folders) {
            match path.starts_with(BUILTIN_FOLDER) {
                true => builtin = true,
                false => tried.push(format!("`{}`", path.display())),
            }
        }
        tried.dedup();
        let tried = tried.join(", ");
        let fault = Diagnostic::new(codes::MISSING_INCLUDE, format!("no file `{}` to include", self.path))
            .at(self.span, "")
            .note(match (builtin, tried.is_empty()) {
                (true, false) => format!("looked for {tried} and for a built-in rule file of that name"),
                (true, true) => "looked for a built-in rule file of that name".to_owned(),
                (false, _) => format!("looked for {tried}"),
            });
        match self.similar(read) {
            Some(near) if !self.elsewhere => fault
                .help(format!("did you mean `{near}`?"))
                .fix(format!("include `{near}`"), [(self.span, format!("\"{near}\""))]),
            _ if slash_help(self.path).is_some() => fault.help(slash_help(self.path).unwrap_or_default()),
            _ if self.elsewhere => fault.help("name the folder of the file with the option `-I`"),
            _ if Path::new(self.path).is_relative() && self.path.contains('/') => {
                fault.help("write the path from the folder of this file, or name a folder with the option `-I`")
            }
            _ => fault,
        }
    }

    /// Returns a similar name of an existing file: with the usual extension, or a built-in file.
    fn similar(&self, read: &dyn ReadFile) -> Option<String> {
        let (folder, path) = (self.folder(), self.path);
        let ended = format!("{path}.{ENDING}");
        let beside = read.read(&folder.join(&ended)).is_ok().then_some(ended.as_str());
        let known = read.builtin_paths();
        let builtin = known.iter().filter_map(|known| known.strip_prefix(BUILTIN_RULES));
        let near = similar_file(path, beside.into_iter().chain(builtin)).map(str::to_owned);
        near.or_else(|| similar_file_in(|folder| read.names_in(folder), folder, Path::new(path), Some(ENDING)))
    }
}
