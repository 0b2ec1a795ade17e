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

/// The maximum number of entries of folders that a search visits.
const ENTRIES_MAX: usize = 200_000;

/// The maximum number of bytes of rule files that a search reads.
const BYTES_MAX: usize = 256 << 20;

/// Files that mark a folder as made by a tool: a cache, such as Cargo's `target`, or a virtual environment of Python.
const MADE_BY_TOOLS: [&str; 2] = ["CACHEDIR.TAG", "pyvenv.cfg"];

/// The workspace as the editor sees it.
pub struct EditorWorkspace<'a> {
    pub folders: &'a [PathBuf],
    /// The open documents by normalized path.
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

/// Parses a document by itself, and returns its tree and the number of faults.
pub fn parsed(path: &Path, text: &str) -> (datalog::ast::File, usize) {
    let mut sources = Sources::new();
    let id = sources.add(path.display().to_string(), text);
    let parsed = datalog::parse(&sources, id);
    (parsed.file, parsed.diagnostics.len())
}

impl Programs {
    /// Reads the open documents, the files of the workspace that `wanted` accepts, and all that these include.
    ///
    /// # Errors
    /// If the client cancels the search.
    pub fn new(workspace: &EditorWorkspace<'_>, wanted: &dyn Fn(&str) -> bool) -> Result<Programs, Cancelled> {
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

    /// Returns the number of an open document.
    pub fn find(&self, path: &Path) -> Option<usize> {
        self.files.iter().position(|file| file.path == path)
    }

    /// Returns the files in which a predicate or a type means the same as in `file`. Without a declaration these are
    /// those of its own program.
    ///
    /// # Errors
    /// If the client cancels the search.
    pub fn sharing(
        &self,
        file: usize,
        meaning: &Meaning,
        cancelled: &dyn Fn() -> bool,
    ) -> Result<Vec<usize>, Cancelled> {
        let mentions = self.select(|one| one.mentions(meaning), cancelled)?;
        let declares = self.select(|one| one.declares(meaning), cancelled)?;
        let (includes, includers) = (self.includes(), self.includers());
        // The files of the programs that declare the name.
        let declaring = reached(&includes, members(&reached(&includers, members(&declares))));
        if !declaring[file] || !mentions[file] {
            let own = reached(&includes, [file]);
            return Ok(members(&own).filter(|&file| mentions[file]).collect());
        }
        // In these programs, all files that mention the name share it. An include connects such files if it leads to one.
        let leads = reached(&includers, members(&mentions));
        let neighbors = |file: usize| -> Vec<usize> {
            let above = includers[file].iter().filter(|&&other| declaring[other] && leads[file]);
            let below = includes[file].iter().filter(|&&other| declaring[file] && leads[other]);
            above.chain(below).copied().collect()
        };
        let connected = reached(&(0..self.files.len()).map(neighbors).collect::<Vec<_>>(), [file]);
        Ok(members(&connected).filter(|&file| mentions[file]).collect())
    }

    /// Returns the first file of the programs that contain one of `files` in which `name` is a predicate or a type.
    ///
    /// # Errors
    /// If the client cancels the search.
    pub fn taken(
        &self,
        files: &[usize],
        name: &str,
        cancelled: &dyn Fn() -> bool,
    ) -> Result<Option<&RuleFile>, Cancelled> {
        let meanings =
            [Meaning::Predicate, Meaning::Type, Meaning::Functor, Meaning::Branch].map(|kind| kind(name.to_owned()));
        let mentions = self.select(|one| meanings.iter().any(|meaning| one.mentions(meaning)), cancelled)?;
        let entries = reached(&self.includers(), files.iter().copied());
        let programs = reached(&self.includes(), members(&entries));
        let found = members(&programs).find(|&file| mentions[file]);
        Ok(found.map(|file| &self.files[file]))
    }

    /// Returns for each file whether a test accepts it, unless the client cancels the search.
    fn select(&self, test: impl Fn(&RuleFile) -> bool, cancelled: &dyn Fn() -> bool) -> Result<Vec<bool>, Cancelled> {
        let tested = |file| match cancelled() {
            true => Err(Cancelled),
            false => Ok(test(file)),
        };
        self.files.iter().map(tested).collect()
    }

    /// Returns the files that each file includes.
    fn includes(&self) -> Vec<&[usize]> {
        self.files.iter().map(|file| file.includes.as_slice()).collect()
    }

    /// Returns the files that include each file.
    fn includers(&self) -> Vec<Vec<usize>> {
        let mut includers = vec![Vec::new(); self.files.len()];
        for (at, file) in self.files.iter().enumerate() {
            file.includes.iter().for_each(|&included| includers[included].push(at));
        }
        includers
    }
}

/// Returns for each file whether the graph leads to it from one of these files.
fn reached(graph: &[impl AsRef<[usize]>], from: impl IntoIterator<Item = usize>) -> Vec<bool> {
    let mut reached = vec![false; graph.len()];
    let mut open: Vec<usize> = from.into_iter().collect();
    while let Some(file) = open.pop() {
        if !std::mem::replace(&mut reached[file], true) {
            open.extend(graph[file].as_ref());
        }
    }
    reached
}

/// Returns the files of a set, in their order.
fn members(set: &[bool]) -> impl Iterator<Item = usize> {
    set.iter()
        .enumerate()
        .filter(|(_, is_member)| **is_member)
        .map(|(file, _)| file)
}

struct Loader<'a> {
    workspace: &'a EditorWorkspace<'a>,
    /// The open documents by the path of their file without links.
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
fn rule_files(workspace: &EditorWorkspace<'_>) -> Result<(Vec<PathBuf>, bool), Cancelled> {
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
