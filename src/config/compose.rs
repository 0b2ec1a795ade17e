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
//!   null (`~`) removes it.
//! - A path is relative to the file that contains it. If it is not on disk, the composer searches the built-in files.
//!
//! This module does not know what the keys mean.

use crate::config::yaml;
use crate::config::yaml::{Node, Value};
use crate::diag::{Code, Diagnostic, SourceId, Sources, did_you_mean};
use crate::files::{BUILTIN_FOLDER, ReadError, ReadFile, normalize};
use std::collections::HashMap;
use std::path::{Path, PathBuf};

/// The maximum depth of files that build on each other.
const MAX_CHAIN: usize = 16;

/// Reads a file: returns its text, or the reason why it cannot.
pub type Read<'a> = &'a dyn ReadFile;

pub(super) struct Composer<'a> {
    pub faults: Vec<Diagnostic>,
    sources: &'a mut Sources,
    read: Read<'a>,
    /// The path of each text read.
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
    /// `folder`.
    pub fn root(&mut self, path: &Path, folder: &str, parts: &[&str]) -> Option<Node> {
        let mut found = match self.read.read_named(path) {
            Err(ReadError::NotFound) => self.find(path, path),
            read => read.map(|text| (path.to_owned(), text)),
        };
        if matches!(found, Err(ReadError::NotFound)) && path.extension().is_none() && path.components().count() == 1 {
            let named = Path::new(folder).join(path).with_extension("yaml");
            found = self.find(&named, &named);
        }
        match found {
            Ok((path, text)) => self.file(path, text, parts, &mut Vec::new()),
            Err(error) => {
                let known = self.read.builtin_paths();
                let names = known
                    .iter()
                    .filter_map(|known| known.strip_prefix(folder)?.strip_prefix('/')?.strip_suffix(".yaml"));
                let near = path.to_str().and_then(|name| did_you_mean(name, names));
                let mut fault = unreadable(path, &error);
                fault.help.extend(near.map(|near| format!("did you mean `{near}`?")));
                self.faults.push(fault);
                None
            }
        }
    }

    /// Returns the path of the existing file that a value names.
    pub fn locate(&mut self, node: &Node) -> Option<PathBuf> {
        self.refer(node).map(|(path, _)| path)
    }

    /// Returns the path of the file that a value names; the file need not exist.
    pub fn name_file(&mut self, node: &Node) -> Option<PathBuf> {
        let reference = super::read::text(node, "the path of a file", &mut self.faults)?;
        let folder = self.path_of(node).parent().unwrap_or(Path::new(""));
        Some(normalize(&folder.join(reference)))
    }

    /// Returns the name of the file that a tree came from, without its extension.
    pub fn name_of(&self, node: &Node) -> String {
        let stem = self.path_of(node).file_stem().unwrap_or_default();
        stem.to_string_lossy().into_owned()
    }

    fn path_of(&self, node: &Node) -> &Path {
        let file = self.files.iter().find(|(id, _)| *id == node.span.source);
        file.map_or(Path::new(""), |(_, path)| path)
    }

    fn refer(&mut self, node: &Node) -> Option<(PathBuf, String)> {
        let path = self.name_file(node)?;
        let reference = super::read::text(node, "the path of a file", &mut self.faults)?;
        match self.find(&path, Path::new(reference)) {
            Ok(found) => Some(found),
            Err(error) => {
                let mut fault = unreadable(&path, &error).at(node.span, "");
                if error == ReadError::NotFound {
                    fault = fault
                        .note("a path is relative to the file that names it; there is no such built-in file either");
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
            let builtin = Path::new(BUILTIN_FOLDER).join(inside);
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
    fn file(&mut self, path: PathBuf, text: String, parts: &[&str], chain: &mut Vec<PathBuf>) -> Option<Node> {
        if text.len() > yaml::MAX_BYTES {
            let (length, limit) = (text.len(), yaml::MAX_BYTES);
            let message = format!("`{}` has {length} bytes, the limit is {limit}", path.display());
            self.faults.push(Diagnostic::new(Code::LIMIT_EXCEEDED, message));
            return None;
        }
        let id = self.sources.add(path.display().to_string(), text);
        let mut node = yaml::parse(self.sources, id, &mut self.nodes_left, &mut self.faults)?;
        chain.push(path.clone());
        self.files.push((id, path));
        if let Value::Map(entries) = &mut node.value {
            for (_, part) in entries.iter_mut().filter(|(key, _)| parts.contains(&key.text.as_str())) {
                self.part(part, chain);
            }
        }
        self.base(&mut node, parts, chain);
        chain.pop();
        node.whole = true;
        (!matches!(node.value, Value::Absent)).then_some(node)
    }

    /// Replaces a path by the tree of its file, and inserts the base into a part written in place. A part that cannot
    /// be loaded becomes absent; its diagnostic has been pushed.
    fn part(&mut self, part: &mut Node, chain: &mut Vec<PathBuf>) {
        match &part.value {
            Value::Map(_) => self.base(part, &[], chain),
            Value::Scalar { .. } if !part.is_null() => {
                let span = part.span;
                *part = self
                    .referred(part, &[], chain)
                    .unwrap_or(Node::new(span, Value::Absent));
            }
            _ => {}
        }
    }

    fn referred(&mut self, node: &Node, parts: &[&str], chain: &mut Vec<PathBuf>) -> Option<Node> {
        let (path, text) = self.refer(node)?;
        if chain.contains(&path) || chain.len() == MAX_CHAIN {
            let fault = if chain.len() == MAX_CHAIN {
                Diagnostic::new(
                    Code::LIMIT_EXCEEDED,
                    format!("more than {MAX_CHAIN} files build on each other"),
                )
            } else {
                Diagnostic::new(Code::INCLUDE_CYCLE, format!("`{}` builds on itself", path.display()))
            };
            self.faults.push(fault.at(node.span, ""));
            return None;
        }
        self.file(path, text, parts, chain)
    }

    /// Removes the key `base` and merges the other keys over the file that it names.
    fn base(&mut self, node: &mut Node, parts: &[&str], chain: &mut Vec<PathBuf>) {
        let Value::Map(entries) = &mut node.value else { return };
        let Some(at) = entries.iter().position(|(key, _)| key.text == "base") else {
            return;
        };
        let (_, reference) = entries.remove(at);
        node.whole = true;
        match self.referred(&reference, parts, chain) {
            Some(mut base) => {
                base.span = node.span;
                let over = std::mem::replace(node, base);
                merge(node, Node { whole: false, ..over });
            }
            None => node.value = Value::Absent,
        }
        node.whole = true;
    }
}

fn merge(base: &mut Node, over: Node) {
    match (&mut base.value, over.value) {
        (Value::Map(kept), Value::Map(entries)) if !over.whole => {
            let index: HashMap<String, usize> = kept
                .iter()
                .enumerate()
                .map(|(at, (key, _))| (key.text.clone(), at))
                .collect();
            for (key, node) in entries {
                match index.get(&key.text) {
                    Some(&at) => {
                        kept[at].0 = key;
                        merge(&mut kept[at].1, node);
                    }
                    None => kept.push((key, node)),
                }
            }
            kept.retain(|(_, node)| !node.is_null());
            // A missing key is reported in the file that overrides the others.
            base.span = over.span;
        }
        (_, value) => *base = Node { value, ..over },
    }
}

fn unreadable(path: &Path, error: &ReadError) -> Diagnostic {
    let code = match error {
        ReadError::NotText { .. } => Code::NOT_TEXT,
        ReadError::TooLarge => Code::LIMIT_EXCEEDED,
        ReadError::NotFound | ReadError::Io(_) => Code::MISSING_FILE,
    };
    Diagnostic::new(code, format!("`{}` cannot be read: {error}", path.display()))
}
