//! The rule files of the workspace, and the programs that they form.
//!
//! Every rule file is the entry of a program: itself and all that it includes. A name means one thing in all files of a
//! program that declares it. So two files share a name if a chain of such programs connects them.

use crate::builtin::BuiltinFiles;
use crate::cli::lsp::analysis::{Meaning, Occurrence, include_paths, occurrences};
use crate::cli::lsp::place::{Encoding, Text};
use crate::datalog;
use crate::diag::Sources;
use crate::files::{BUILTIN_FOLDER, ReadError, ReadFile, normalize};
use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::fs;
use std::path::{Path, PathBuf};

/// The most entries of folders that a search visits.
const ENTRIES_MAX: usize = 200_000;

/// The most bytes of rule files that a search reads.
const BYTES_MAX: usize = 256 << 20;

/// Files that mark a folder as made by a tool: a cache, such as Cargo's `target`, or a virtual environment of Python.
const MADE_BY_TOOLS: [&str; 2] = ["CACHEDIR.TAG", "pyvenv.cfg"];

/// The workspace as the editor sees it.
pub struct Workspace<'a> {
    pub folders: &'a [PathBuf],
    /// The open texts by normalized path.
    pub open: BTreeMap<&'a Path, &'a str>,
    pub encoding: Encoding,
    /// Whether the client no longer wants the answer.
    pub cancelled: &'a dyn Fn() -> bool,
}

/// The client has cancelled the search.
#[derive(Debug)]
pub struct Cancelled;

/// A rule file.
pub struct RuleFile {
    pub path: PathBuf,
    pub text: Text,
    pub names: Vec<Occurrence>,
    /// The number of syntax errors and warnings.
    pub faults: usize,
    includes: Vec<usize>,
}

impl RuleFile {
    pub fn new(path: &Path, text: Text) -> RuleFile {
        let (tree, faults) = parsed(path, text.as_str());
        RuleFile {
            path: path.to_owned(),
            names: occurrences(&tree),
            text,
            faults,
            includes: Vec::new(),
        }
    }

    pub fn is_builtin(&self) -> bool {
        self.path.starts_with(BUILTIN_FOLDER)
    }

    fn mentions(&self, meaning: &Meaning) -> bool {
        self.names.iter().any(|one| one.meaning == *meaning)
    }

    fn declares(&self, meaning: &Meaning) -> bool {
        self.names.iter().any(|one| one.meaning == *meaning && one.declares())
    }
}

/// Rule files and what they include.
pub struct Programs {
    pub files: Vec<RuleFile>,
    /// Whether the search saw the whole workspace. Otherwise it reached a limit.
    pub complete: bool,
}

/// Parses a text by itself, and returns its tree and the number of faults.
pub fn parsed(path: &Path, text: &str) -> (datalog::ast::File, usize) {
    let mut sources = Sources::new();
    let id = sources.add(path.display().to_string(), text);
    let parsed = datalog::parse(&sources, id);
    (parsed.file, parsed.diagnostics.len())
}

impl Programs {
    /// Reads the open texts, the files of the workspace that `wanted` accepts, and all that these include.
    ///
    /// # Errors
    /// If the client cancels the search.
    pub fn new(workspace: &Workspace<'_>, wanted: &dyn Fn(&str) -> bool) -> Result<Programs, Cancelled> {
        let (paths, complete) = rule_files(workspace)?;
        let canonical = workspace
            .open
            .keys()
            .filter_map(|path| Some((fs::canonicalize(path).ok()?, *path)));
        let mut loader = Loader {
            workspace,
            canonical: canonical.collect(),
            known: HashMap::new(),
            programs: Programs {
                files: Vec::new(),
                complete,
            },
            bytes: 0,
        };
        for path in workspace.open.keys() {
            loader.load(path, &|_| true);
        }
        for path in &paths {
            if (workspace.cancelled)() {
                return Err(Cancelled);
            }
            loader.load(path, wanted);
        }
        // Files that others include join the end of the list.
        let mut at = 0;
        while at < loader.programs.files.len() {
            if (workspace.cancelled)() {
                return Err(Cancelled);
            }
            loader.follow(at);
            at += 1;
        }
        Ok(loader.programs)
    }

    /// Returns the number of an open text.
    pub fn find(&self, path: &Path) -> Option<usize> {
        self.files.iter().position(|file| file.path == path)
    }

    /// Returns a file and all that it includes.
    fn reach(&self, entry: usize) -> Vec<usize> {
        let (mut seen, mut open) = (BTreeSet::from([entry]), vec![entry]);
        while let Some(file) = open.pop() {
            open.extend(self.files[file].includes.iter().filter(|&&next| seen.insert(next)));
        }
        seen.into_iter().collect()
    }

    /// Returns the files in which a predicate or a type means the same as in `file`. Without a declaration these are
    /// those of its own program.
    pub fn sharing(&self, file: usize, meaning: &Meaning) -> Vec<usize> {
        let mentions: Vec<bool> = self.files.iter().map(|file| file.mentions(meaning)).collect();
        let mut groups = Groups((0..self.files.len()).collect());
        let mut is_declared = false;
        for entry in 0..self.files.len() {
            let mut program = self.reach(entry);
            program.retain(|&file| mentions[file]);
            if program.iter().any(|&file| self.files[file].declares(meaning)) {
                is_declared |= program.contains(&file);
                program.windows(2).for_each(|pair| groups.join(pair[0], pair[1]));
            }
        }
        let group = groups.of(file);
        let shares = |other: &usize| mentions[*other] && groups.of(*other) == group;
        match is_declared {
            true => (0..self.files.len()).filter(shares).collect(),
            false => self.reach(file).into_iter().filter(|&file| mentions[file]).collect(),
        }
    }

    /// Returns the first file of the programs that contain one of `files` in which `name` is a predicate or a type.
    pub fn taken(&self, files: &[usize], name: &str) -> Option<&RuleFile> {
        let meanings = [Meaning::Predicate, Meaning::Type].map(|kind| kind(name.to_owned()));
        let mentions = |file: &&usize| meanings.iter().any(|meaning| self.files[**file].mentions(meaning));
        let programs = (0..self.files.len()).map(|entry| self.reach(entry));
        let mut programs = programs.filter(|program| program.iter().any(|file| files.contains(file)));
        programs.find_map(|program| program.iter().find(mentions).map(|&file| &self.files[file]))
    }
}

/// Disjoint sets of files: the representative of each, possibly through others.
struct Groups(Vec<usize>);

impl Groups {
    fn of(&self, mut file: usize) -> usize {
        while self.0[file] != file {
            file = self.0[file];
        }
        file
    }

    fn join(&mut self, one: usize, other: usize) {
        let (one, other) = (self.of(one), self.of(other));
        // The smaller number is nearer to the representative of long chains.
        self.0[one.max(other)] = one.min(other);
    }
}

struct Loader<'a> {
    workspace: &'a Workspace<'a>,
    /// The open texts by the path of their file without links.
    canonical: HashMap<PathBuf, &'a Path>,
    /// The files by path without links; `None` for those that cannot be read or are not wanted. Only for lookup.
    known: HashMap<PathBuf, Option<usize>>,
    programs: Programs,
    bytes: usize,
}

impl Loader<'_> {
    /// Reads and parses a file unless it is known or unwanted. Returns its number, if it is loaded.
    fn load(&mut self, path: &Path, wanted: &dyn Fn(&str) -> bool) -> Option<usize> {
        let path = self.open_path(path);
        let identity = match self.workspace.open.contains_key(path.as_path()) || path.starts_with(BUILTIN_FOLDER) {
            true => path.clone(),
            false => fs::canonicalize(&path).unwrap_or_else(|_| path.clone()),
        };
        if let Some(known) = self.known.get(&identity) {
            return *known;
        }
        let text = self.read(&path).ok().filter(|text| wanted(text));
        let loaded = text.and_then(|text| {
            self.bytes += text.len();
            if self.bytes > BYTES_MAX {
                self.programs.complete = false;
                return None;
            }
            let text = Text::new(text, self.workspace.encoding);
            self.programs.files.push(RuleFile::new(&path, text));
            Some(self.programs.files.len() - 1)
        });
        self.known.insert(identity, loaded);
        loaded
    }

    /// Returns the path by which the editor knows a file.
    fn open_path(&self, path: &Path) -> PathBuf {
        let path = normalize(path);
        if self.workspace.open.contains_key(path.as_path()) || path.starts_with(BUILTIN_FOLDER) {
            return path;
        }
        let canonical = fs::canonicalize(&path).ok();
        let open = canonical.and_then(|canonical| self.canonical.get(&canonical));
        open.map_or(path, |open| open.to_path_buf())
    }

    fn read(&self, path: &Path) -> Result<String, ReadError> {
        match self.workspace.open.get(path) {
            Some(text) => Ok((*text).to_owned()),
            None => BuiltinFiles.read(path),
        }
    }

    /// Loads the files that a file includes.
    fn follow(&mut self, file: usize) {
        let RuleFile { path, names, .. } = &self.programs.files[file];
        let from = path.clone();
        let paths = names.iter().filter_map(|one| match &one.meaning {
            Meaning::Include(path) => Some(path.clone()),
            _ => None,
        });
        for include in paths.collect::<Vec<_>>() {
            // An included file is wanted, whatever its text.
            let found = include_paths(&from, &include)
                .into_iter()
                .find_map(|path| self.included(&path));
            self.programs.files[file].includes.extend(found);
        }
    }

    fn included(&mut self, path: &Path) -> Option<usize> {
        let path = self.open_path(path);
        let identity = fs::canonicalize(&path).unwrap_or_else(|_| path.clone());
        if self.known.get(&identity) == Some(&None) {
            self.known.remove(&identity);
        }
        self.load(&path, &|_| true)
    }
}

/// Returns the rule files in the folders of the workspace, sorted, and whether these are all. Skips hidden folders,
/// those made by tools, and symbolic links, which may form loops.
fn rule_files(workspace: &Workspace<'_>) -> Result<(Vec<PathBuf>, bool), Cancelled> {
    let mut found = BTreeSet::new();
    let mut seen = BTreeSet::new();
    let mut open: Vec<PathBuf> = workspace.folders.to_vec();
    let mut visited = 0;
    while let Some(folder) = open.pop() {
        if (workspace.cancelled)() {
            return Err(Cancelled);
        }
        // A folder of the workspace may lie in another one.
        if !seen.insert(folder.clone()) {
            continue;
        }
        // A folder that cannot be read has no rule file that a program could include.
        let Ok(entries) = fs::read_dir(&folder) else { continue };
        let mut inside = Vec::new();
        for entry in entries.flatten() {
            visited += 1;
            if visited > ENTRIES_MAX {
                return Ok((found.into_iter().collect(), false));
            }
            let (Ok(kind), path, name) = (entry.file_type(), entry.path(), entry.file_name()) else {
                continue;
            };
            let name = name.to_string_lossy();
            if kind.is_dir() && !name.starts_with('.') && name != "node_modules" {
                inside.push(path);
            } else if kind.is_file() && path.extension().is_some_and(|ending| ending == "dl") {
                found.insert(normalize(&path));
            } else if kind.is_file() && MADE_BY_TOOLS.contains(&&*name) && !workspace.folders.contains(&folder) {
                inside.clear();
                found.retain(|path| path.parent() != Some(&folder));
                break;
            }
        }
        open.extend(inside);
    }
    Ok((found.into_iter().collect(), true))
}
