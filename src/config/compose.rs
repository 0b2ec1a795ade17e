//! Composes one tree from many files.
//!
//! ```text
//! path --read, or built in--> text --yaml--> tree --insert parts and `base`--> tree without references --read--> typed
//! ```
//!
//! Three rules apply everywhere:
//!
//! - A part is a path or is written in place.
//! - `base: path` starts from another file. Mappings merge key by key, any other value replaces that of the base, and
//!   null (`~`) removes it. If the base has no such key, the null value stays, so that readers can report a misspelled
//!   key.
//! - A path is relative to the file that contains it. If it is not on disk, the composer searches the built-in files.
//!
//! This module does not know what the keys mean.

use crate::config::codes;
use crate::datalog::codes::INCLUDE_CYCLE;
use crate::diag::{self, Diagnostic, SourceId, Sources, Span, similar_file, similar_file_in};
use crate::files::{BUILTIN_FOLDER, ReadError, ReadFile, builtin_path, name_a_file, normalize, slash_help};
use crate::located::Located;
use crate::yaml;
use crate::yaml::{Value, YamlNode};
use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};

/// The maximum depth of files that build on each other.
const MAX_CHAIN: usize = 16;

/// A kind of file. A bare name, such as `expert`, means the file with this name and ending in the folder.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Kind {
    folder: &'static str,
    ending: &'static str,
    /// The kind in messages, with its article.
    what: &'static str,
}

pub(super) const RUN: Kind = Kind::yaml("configs", "a run configuration");
pub(super) const MAP: Kind = Kind::yaml("configs/maps", "a map");
pub(super) const AGENTS: Kind = Kind::yaml("configs/agents", "agent sets");
pub(super) const PREDICATES: Kind = Kind::yaml("configs/predicates", "predicates");
pub(super) const TASK: Kind = Kind::yaml("configs/tasks", "a task");
const BASELINE: Kind = Kind::yaml("configs/baselines", "a configuration of `logicity train`");
const EXPERIMENT: Kind = Kind::yaml("configs/experiments", "an experiment of `logicity experiment`");
const RULES: Kind = Kind {
    folder: "rules",
    ending: "dl",
    what: "rules",
};

const DRAWING: Kind = Kind {
    folder: "pictures",
    ending: "svg",
    what: "a drawing",
};

/// The kinds of built-in files, and the key of a run configuration for each part.
const KINDS: [(Kind, &str); 8] = [
    (RUN, ""),
    (MAP, "map"),
    (AGENTS, "agents"),
    (PREDICATES, "predicates"),
    (TASK, "task"),
    (BASELINE, ""),
    (EXPERIMENT, ""),
    (RULES, "rules"),
];

impl Kind {
    const fn yaml(folder: &'static str, what: &'static str) -> Kind {
        let ending = "yaml";
        Kind { folder, ending, what }
    }

    /// Returns the kind of the built-in files in a folder; run configurations if it has none.
    pub fn of_folder(folder: &str) -> Kind {
        let found = KINDS.iter().find(|(kind, _)| kind.folder == folder);
        found.map_or(RUN, |(kind, _)| *kind)
    }

    /// Returns the path that a bare name means.
    fn named(self, name: &Path) -> Option<PathBuf> {
        let is_bare = name.extension().is_none() && name.components().count() == 1 && !name.as_os_str().is_empty();
        is_bare.then(|| Path::new(self.folder).join(name).with_extension(self.ending))
    }

    /// Returns the bare name of a built-in file of this kind.
    fn name_of(self, path: &str) -> Option<&str> {
        let name = path
            .strip_prefix(self.folder)?
            .strip_prefix('/')?
            .strip_suffix(self.ending)?;
        name.strip_suffix('.').filter(|name| !name.contains('/'))
    }
}

/// Returns the path of a rule file that the user named. A bare name such as `hard`, if no file has it, means
/// `rules/hard.dl`, on disk or built in.
pub fn rule_file(path: &Path, read: Read<'_>) -> PathBuf {
    let named = RULES.named(path).filter(|named| read.read_or_builtin(named).is_ok());
    let named = named.filter(|_| matches!(read.read(path), Err(ReadError::NotFound | ReadError::Folder)));
    named.unwrap_or_else(|| path.to_owned())
}

/// Reads a file: returns its text, or the reason why it cannot.
pub type Read<'a> = &'a dyn ReadFile;

pub(super) struct Composer<'a> {
    pub faults: Vec<Diagnostic>,
    sources: &'a mut Sources,
    read: Read<'a>,
    /// The path of each file read.
    files: Vec<(SourceId, PathBuf)>,
    nodes_left: usize,
}

impl<'a> Composer<'a> {
    pub fn new(sources: &'a mut Sources, read: Read<'a>) -> Self {
        Composer {
            faults: Vec::new(),
            sources,
            read,
            files: Vec::new(),
            nodes_left: yaml::MAX_NODES,
        }
    }

    /// Returns the tree of a file that the user named. A bare name such as `expert` means the file with this name in
    /// the folder of `kind`.
    pub fn root(&mut self, path: &Path, kind: Kind, parts: &[(&str, Kind)]) -> Option<YamlNode> {
        let mut found = match self.read.read_named(path) {
            Err(ReadError::NotFound) => self.find(path, path),
            read => read.map(|text| (path.to_owned(), text)),
        };
        if let (Err(ReadError::NotFound | ReadError::Folder), Some(named)) = (&found, kind.named(path)) {
            found = self.find(&named, &named).or(found);
        }
        match found {
            _ if path.extension().is_some_and(|ending| ending == RULES.ending) => {
                let path = path.display();
                let message = format!("`{path}` is a rule file, not a configuration");
                let help = format!("name the rules in a configuration: `rules: {path}`");
                self.faults
                    .push(Diagnostic::new(yaml::codes::INVALID_VALUE, message).help(help));
                None
            }
            Ok((path, text)) => self.file(path, text, kind, parts, &mut Vec::new()),
            Err(error) => {
                let mut fault = self.unreadable(path, &error);
                if error == ReadError::NotFound {
                    fault
                        .help
                        .extend(self.suggestion(Path::new(""), &path.to_string_lossy(), kind));
                }
                self.faults.push(fault);
                None
            }
        }
    }

    fn unreadable(&self, path: &Path, error: &ReadError) -> Diagnostic {
        let code = match error {
            ReadError::NotText { .. } => diag::codes::NOT_TEXT,
            ReadError::TooLarge(_) => diag::codes::LIMIT_EXCEEDED,
            ReadError::NotFound | ReadError::Folder | ReadError::Io(_) => codes::MISSING_FILE,
        };
        let mut fault = Diagnostic::new(code, format!("cannot read `{}`: {error}", path.display()));
        if *error == ReadError::Folder {
            fault.help.extend(name_a_file(path, &self.read.names_in(path)));
        }
        fault
    }

    /// Returns help for a missing file of a kind: a similar name, or what else has this name.
    fn suggestion(&self, folder: &Path, written: &str, kind: Kind) -> Option<String> {
        let did_you_mean_this = |near: &str| Some(format!("did you mean `{near}`?"));
        let known = self.read.builtin_paths();
        let of = |kind: Kind| {
            let names = known.iter().filter_map(move |known| kind.name_of(known));
            names.collect::<Vec<&str>>()
        };
        if kind.named(Path::new(written)).is_some() {
            let with_ending = format!("{written}.{}", kind.ending);
            let beside = self.read.read(&folder.join(&with_ending)).is_ok();
            let beside = beside.then_some(with_ending.as_str());
            if let Some(near) = similar_file(written, beside.into_iter().chain(of(kind))) {
                return did_you_mean_this(near);
            }
            if let Some((other, key)) = KINDS.iter().find(|(other, _)| of(*other).contains(&written)) {
                let is = format!("`{written}` is {}", other.what);
                return Some(match *key {
                    "" => is,
                    key => format!(
                        "{is}, a part of a run configuration: write one with `base: expert` and `{key}: {written}`"
                    ),
                });
            }
            if let Some(near) = similar_file_in(
                |folder| self.read.names_in(folder),
                folder,
                Path::new(written),
                Some(kind.ending),
            ) {
                return did_you_mean_this(&near);
            }
            let mut names = of(kind);
            if names.iter().any(|name| name.starts_with(written)) {
                names.retain(|name| name.starts_with(written));
            }
            return Some(format!("built in as {}: {}", kind.what, names.join(", ")));
        }
        // Paths from another folder differ in their beginning.
        let trimmed = written.trim_start_matches(['.', '/']);
        let near = similar_file_in(
            |folder| self.read.names_in(folder),
            folder,
            Path::new(written),
            Some(kind.ending),
        );
        let near = near.or_else(|| similar_file(trimmed, known.iter().map(String::as_str)).map(str::to_owned));
        let bare = Path::new(written)
            .file_stem()
            .filter(|_| Path::new(written).components().count() == 1);
        let bare = bare.and_then(|bare| similar_file(bare.to_str()?, of(kind)).map(str::to_owned));
        near.or(bare).and_then(|near| did_you_mean_this(&near))
    }

    /// Returns the path of the existing rule file that a value names.
    pub fn rule_file(&mut self, node: &YamlNode) -> Option<PathBuf> {
        self.refer(node, RULES).map(|(path, _)| path)
    }

    /// Returns the path of the file that a value names; the file need not exist.
    pub fn name_file(&mut self, node: &YamlNode) -> Option<PathBuf> {
        let reference = crate::yaml::read::text(node, "the path of a file", &mut self.faults)?;
        let folder = self.path_of(node).parent().unwrap_or(Path::new(""));
        Some(normalize(&folder.join(reference)))
    }

    /// Returns the text of the drawing that a value names, with its place, and the name of the file.
    pub fn drawing(&mut self, node: &YamlNode, most: usize) -> Option<(Located<String>, String)> {
        let (path, text) = self.refer(node, DRAWING)?;
        if text.len() > most {
            let message = format!("`{}` has {} bytes, the limit is {most}", path.display(), text.len());
            let fault = Diagnostic::new(diag::codes::LIMIT_EXCEEDED, message).at(node.span, "");
            self.faults
                .push(fault.help("simplify the drawing: traces and pages contain it"));
            return None;
        }
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let source = self.sources.add(path.display().to_string(), text.clone());
        let span = Span::new(source, 0..text.len());
        Some((Located { value: text, span }, name))
    }

    /// Returns the name of the file that a tree came from, without its extension.
    pub fn name_of(&self, node: &YamlNode) -> String {
        let stem = self.path_of(node).file_stem().unwrap_or_default();
        stem.to_string_lossy().into_owned()
    }

    /// Returns the path of the file that a tree came from.
    pub fn path_of(&self, node: &YamlNode) -> &Path {
        let file = self.files.iter().find(|(id, _)| *id == node.span.source);
        file.map_or(Path::new(""), |(_, path)| path)
    }

    fn refer(&mut self, node: &YamlNode, kind: Kind) -> Option<(PathBuf, String)> {
        let path = self.name_file(node)?;
        let reference = crate::yaml::read::text(node, "the path of a file", &mut self.faults)?;
        let folder = self.path_of(node).parent().unwrap_or(Path::new("")).to_owned();
        let mut found = self.find(&path, Path::new(reference));
        if let (Err(ReadError::NotFound | ReadError::Folder), Some(named)) = (&found, kind.named(Path::new(reference)))
        {
            found = self.find(&normalize(&folder.join(&named)), &named).or(found);
        }
        match found {
            Ok(found) => Some(found),
            Err(error) => {
                let mut fault = self.unreadable(&path, &error).at(node.span, "");
                if error == ReadError::NotFound {
                    fault = fault
                        .note("a path is relative to the file that names it; there is no such built-in file either");
                    let help = node.missing_space();
                    fault.help.extend(
                        help.or_else(|| slash_help(reference))
                            .or_else(|| self.suggestion(&folder, reference, kind)),
                    );
                }
                self.faults.push(fault);
                None
            }
        }
    }

    /// Searches the disk first, then the built-in files: under the full path, then under the path as written. Built-in
    /// files refer to built-in files only, so their meaning does not depend on the current folder.
    fn find(&self, path: &Path, written: &Path) -> Result<(PathBuf, String), ReadError> {
        if !path.starts_with(BUILTIN_FOLDER) {
            match self.read.read(path) {
                Err(ReadError::NotFound) => {}
                read => return read.map(|text| (path.to_owned(), text)),
            }
        }
        for path in [normalize(path), normalize(written)] {
            let inside = path.strip_prefix(BUILTIN_FOLDER).unwrap_or(&path);
            let builtin = builtin_path(inside);
            // An absolute path would leave the folder.
            if inside.is_relative()
                && let Ok(text) = self.read.read(&builtin)
            {
                return Ok((builtin, text));
            }
        }
        Err(ReadError::NotFound)
    }

    /// Returns the tree of one file with its parts and its base inserted. `chain` lists the files that wait for this
    /// one.
    fn file(
        &mut self,
        path: PathBuf,
        text: String,
        kind: Kind,
        parts: &[(&str, Kind)],
        chain: &mut Vec<PathBuf>,
    ) -> Option<YamlNode> {
        if text.len() > yaml::MAX_BYTES {
            let (length, limit) = (text.len(), yaml::MAX_BYTES);
            let message = format!("`{}` has {length} bytes, the limit is {limit}", path.display());
            self.faults.push(Diagnostic::new(diag::codes::LIMIT_EXCEEDED, message));
            return None;
        }
        let id = self.sources.add(path.display().to_string(), text);
        let mut node = yaml::parse(self.sources, id, &mut self.nodes_left, &mut self.faults)?;
        chain.push(path.clone());
        self.files.push((id, path));
        if let Value::Map(entries) = &mut node.value {
            for (key, part) in entries {
                if let Some((_, kind)) = parts.iter().find(|(name, _)| *name == key.text) {
                    self.part(part, *kind, chain);
                }
            }
        }
        self.base(&mut node, kind, parts, chain);
        chain.pop();
        node.whole = true;
        (!matches!(node.value, Value::Absent)).then_some(node)
    }

    /// Replaces a path by the tree of its file, and inserts the base into a part written in place. A part that cannot
    /// be loaded becomes absent; its diagnostic has been pushed.
    fn part(&mut self, part: &mut YamlNode, kind: Kind, chain: &mut Vec<PathBuf>) {
        match &part.value {
            Value::Map(_) => self.base(part, kind, &[], chain),
            Value::Scalar { .. } if !part.is_null() => {
                let span = part.span;
                *part = self
                    .referred(part, kind, &[], chain)
                    .unwrap_or(YamlNode::new(span, Value::Absent));
            }
            _ => {}
        }
    }

    fn referred(
        &mut self,
        node: &YamlNode,
        kind: Kind,
        parts: &[(&str, Kind)],
        chain: &mut Vec<PathBuf>,
    ) -> Option<YamlNode> {
        let (path, text) = self.refer(node, kind)?;
        if chain.contains(&path) || chain.len() == MAX_CHAIN {
            let fault = if chain.len() == MAX_CHAIN {
                Diagnostic::new(
                    diag::codes::LIMIT_EXCEEDED,
                    format!("more than {MAX_CHAIN} files build on each other"),
                )
            } else {
                Diagnostic::new(INCLUDE_CYCLE, format!("`{}` builds on itself", path.display()))
            };
            self.faults.push(fault.at(node.span, ""));
            return None;
        }
        self.file(path, text, kind, parts, chain)
    }

    /// Removes the key `base` and merges the other keys over the file that it names. If that file cannot be loaded, the
    /// other keys remain, marked as partial.
    fn base(&mut self, node: &mut YamlNode, kind: Kind, parts: &[(&str, Kind)], chain: &mut Vec<PathBuf>) {
        let Value::Map(entries) = &mut node.value else { return };
        let Some(at) = entries.iter().position(|(key, _)| key.text == "base") else {
            return;
        };
        let (_, reference) = entries.remove(at);
        node.whole = true;
        match self.referred(&reference, kind, parts, chain) {
            Some(mut base) => {
                base.span = node.span;
                let over = std::mem::replace(node, base);
                merge(node, YamlNode { whole: false, ..over });
                if node.partial {
                    node.mark_partial();
                }
            }
            None => node.mark_partial(),
        }
        node.whole = true;
    }
}

fn merge(base: &mut YamlNode, over: YamlNode) {
    match (&mut base.value, over.value) {
        (Value::Map(kept), Value::Map(entries)) if !over.whole => {
            let index: HashMap<String, usize> = kept
                .iter()
                .enumerate()
                .map(|(at, (key, _))| (key.text.clone(), at))
                .collect();
            let mut removed = HashSet::new();
            for (key, node) in entries {
                match index.get(&key.text) {
                    Some(&at) => {
                        if node.is_null() && !kept[at].1.is_null() {
                            removed.insert(at);
                        }
                        kept[at].0 = key;
                        merge(&mut kept[at].1, node);
                    }
                    // Also a null value, so that the reader finds misspelled keys.
                    None => kept.push((key, node)),
                }
            }
            let mut positions = 0..;
            kept.retain(|_| !positions.next().is_some_and(|at| removed.contains(&at)));
            // A missing key is reported in the file that overrides the others.
            base.span = over.span;
        }
        (_, value) => *base = YamlNode { value, ..over },
    }
}
