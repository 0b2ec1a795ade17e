//! The built-in rules and configurations.
// Decision: docs/decisions/safety.md#d069

use std::ffi::OsStr;
use std::path::{MAIN_SEPARATOR, Path};

use include_dir::{Dir, include_dir};

use crate::diag::{did_you_mean, similar_file, similar_file_in};
use crate::files::{BUILTIN_FOLDER, ReadError, ReadFile, names_in, open, read_text, read_whole, to_text};

static RULES: Dir<'_> = include_dir!("$CARGO_MANIFEST_DIR/rules");
static CONFIGS: Dir<'_> = include_dir!("$CARGO_MANIFEST_DIR/configs");

/// The extensions of files that a program or configuration can name. The folders also contain documentation.
const ENDINGS: [&str; 3] = ["dl", "yaml", "jsonl"];

/// Returns the repository paths of all built-in files, sorted, for example `rules/vocabulary.dl`.
pub fn paths() -> Vec<String> {
    fn walk(folder: &Dir<'_>, root: &str, found: &mut Vec<String>) {
        let files = folder.files().map(|file| file.path());
        let named = files.filter(|path| {
            path.extension()
                .is_some_and(|ending| ENDINGS.iter().any(|known| ending == *known))
        });
        found.extend(named.map(|path| format!("{root}/{}", path.display()).replace('\\', "/")));
        folder.dirs().for_each(|inner| walk(inner, root, found));
    }
    let mut found = Vec::new();
    walk(&RULES, "rules", &mut found);
    walk(&CONFIGS, "configs", &mut found);
    found.sort();
    found
}

/// Returns the text of a built-in file by its repository path, for example `configs/maps/square-5x5.yaml`.
pub fn text(path: &str) -> Option<&'static str> {
    let (root, inside) = path.split_once('/')?;
    let folder = match root {
        "rules" => &RULES,
        "configs" => &CONFIGS,
        _ => return None,
    };
    folder.get_file(inside)?.contents_utf8()
}

/// Returns the path of the file that a missing one most likely means: in the same folder, or built in.
pub fn similar(path: &Path) -> Option<String> {
    let written = path.to_str()?;
    if let Some(near) = similar_file_in(names_in, Path::new(""), path, None) {
        return Some(near);
    }
    let known = paths();
    let rules = || known.iter().map(String::as_str).filter(|known| known.ends_with(".dl"));
    let by_stem = || {
        let stem = |known: &'_ str| Some(Path::new(known).file_stem()?.to_str()?.to_owned());
        let stems: Vec<(String, &str)> = rules().filter_map(|known| Some((stem(known)?, known))).collect();
        let near = did_you_mean(&stem(written)?, stems.iter().map(|(stem, _)| stem.as_str()))?;
        stems.iter().find(|(stem, _)| stem == near).map(|(_, known)| *known)
    };
    let near = match path.extension().and_then(OsStr::to_str) {
        None | Some("dl") => match path.components().count() {
            1 => by_stem().or_else(|| similar_file(written, rules())),
            _ => similar_file(written, rules()),
        },
        Some("yaml") => similar_file(written, known.iter().map(String::as_str)),
        Some(_) => None,
    };
    near.map(str::to_owned)
}

/// Reads files from disk, and built-in files under [`BUILTIN_FOLDER`].
///
/// Paths there may omit the folder `rules/`, so that any rule file can include `vocabulary.dl`.
#[derive(Clone, Copy, Debug, Default)]
pub struct BuiltinFiles;

impl ReadFile for BuiltinFiles {
    fn read(&self, path: &Path) -> Result<String, ReadError> {
        let Ok(inside) = path.strip_prefix(BUILTIN_FOLDER) else {
            return read_text(path);
        };
        // On Windows, callers may also write `\`.
        let inside = inside.to_str().map(|inside| inside.replace(MAIN_SEPARATOR, "/"));
        let found = inside.and_then(|inside| text(&inside).or_else(|| text(&format!("rules/{inside}"))));
        found.map(str::to_owned).ok_or(ReadError::NotFound)
    }

    fn read_named(&self, path: &Path) -> Result<String, ReadError> {
        match path.starts_with(BUILTIN_FOLDER) {
            true => self.read(path),
            false => to_text(read_whole(open(path)?)?),
        }
    }

    fn builtin_paths(&self) -> Vec<String> {
        paths()
    }

    fn names_in(&self, folder: &Path) -> Vec<String> {
        names_in(folder)
    }
}

/// Reads files, built-in ones too, with a function. Messages suggest the built-in paths.
#[derive(Clone, Copy, Debug)]
pub struct ReadWith<F>(pub F);

impl<F: Fn(&Path) -> Result<String, ReadError>> ReadFile for ReadWith<F> {
    fn read(&self, path: &Path) -> Result<String, ReadError> {
        self.0(path)
    }

    fn builtin_paths(&self) -> Vec<String> {
        paths()
    }
}
