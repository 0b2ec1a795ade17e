//! Includes: the files of a program as one list of items, in reading order.

use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};

use crate::codes;
use crate::diag::{self, Diagnostic, Faults, SourceId, Sources, Span};
use crate::files::{ReadError, ReadFile, builtin_path, normalize};

use crate::syntax::ast::{File, Include, Item};
use crate::syntax::locate::{BUILTIN_RULES, ENDING, Wanted};
use crate::syntax::packed::FactRuns;
use crate::syntax::parser;
use crate::syntax::preprocess::{self, Files, Preprocessing};

/// Maximum size of a rule file in bytes.
const MAX_TEXT_BYTES: usize = 64 << 20;

/// Maximum length of a chain of includes.
const MAX_DEPTH: usize = 64;

/// Maximum number of files of a program. Symbolic links give one file any number of names.
const MAX_FILES: usize = 10_000;

/// The built-in files that declare predicates and types, by these names, as an `.include` writes them.
pub(crate) type Offered = HashMap<String, String>;

/// The items of all files of a program.
#[derive(Clone, Debug, Default)]
pub(crate) struct Gathered {
    /// The items, without any [`Item::Include`] and without the facts below.
    pub items: Vec<Item>,
    /// The facts of plain constants.
    pub facts: FactRuns,
    /// Whether text is missing, such as an included file. If so, its declarations may explain unknown names.
    pub incomplete: bool,
    /// The names that built-in files declare, if the items lack a declaration.
    pub offered: Offered,
    /// The normalized paths of all files so far. Only for lookup, never iterated.
    seen: HashSet<PathBuf>,
}

/// Adds the items of a source and of all files it includes. Skips files that `gathered` already contains.
pub(crate) fn gather(
    gathered: &mut Gathered,
    sources: &mut Sources,
    entry: SourceId,
    read: &dyn ReadFile,
    settings: &Preprocessing,
    faults: &mut Faults,
) {
    let key = normalize(Path::new(sources.name(entry)));
    if !gathered.seen.insert(key.clone()) {
        return;
    }
    let mut walk = Walk {
        sources,
        read,
        settings,
        faults,
        open: vec![(key, None)],
        included: Files::new(),
        gathered,
    };
    walk.source(entry);
}

/// Returns the names that built-in files declare, without those that include others: these are programs.
pub(crate) fn offered(read: &dyn ReadFile) -> Offered {
    let mut offered = Offered::new();
    for path in read.builtin_paths() {
        let written = path.strip_prefix(BUILTIN_RULES).unwrap_or(&path);
        if Path::new(written).extension().is_none_or(|ending| ending != ENDING) {
            continue;
        }
        let Ok(text) = read.read(&builtin_path(written)) else {
            continue;
        };
        let mut sources = Sources::new();
        let id = sources.add(written, text);
        let items = parse_one(&sources, id, &mut Faults::default()).items;
        if items.iter().any(|item| matches!(item, Item::Include(_))) {
            continue;
        }
        for item in items {
            let names = match item {
                Item::Decl(decl) => decl.names,
                Item::Type(decl) => vec![decl.name],
                _ => continue,
            };
            for name in names {
                offered.entry(name.text).or_insert_with(|| written.to_owned());
            }
        }
    }
    offered
}

pub(crate) fn parse_one(sources: &Sources, id: SourceId, faults: &mut Faults) -> File {
    match small_source(sources, id, faults) {
        Some(text) => parser::parse(id, text, faults),
        None => File::default(),
    }
}

/// Returns the source of a rule file, or reports that it is too large.
pub(super) fn small_source<'s>(sources: &'s Sources, id: SourceId, faults: &mut Faults) -> Option<&'s str> {
    let text = sources.text(id);
    if text.len() > MAX_TEXT_BYTES {
        let fault = Diagnostic::new(diag::codes::LIMIT_EXCEEDED, "rule file too large")
            .at(Span::new(id, 0..0), "")
            .note(format!(
                "a rule file has at most {} MiB; put facts into `.facts` files",
                MAX_TEXT_BYTES >> 20
            ));
        faults.push(fault);
        return None;
    }
    Some(text)
}

struct Walk<'a> {
    sources: &'a mut Sources,
    read: &'a dyn ReadFile,
    settings: &'a Preprocessing,
    faults: &'a mut Faults,
    /// The files that are open, outermost first: the normalized path, and the include that led to it.
    open: Vec<(PathBuf, Option<Span>)>,
    /// The sources that this walk has added, by normalized path.
    included: Files,
    gathered: &'a mut Gathered,
}

impl Walk<'_> {
    fn source(&mut self, id: SourceId) {
        if small_source(self.sources, id, self.faults).is_none() {
            return;
        }
        let (settings, included) = (self.settings, &mut self.included);
        let unit = preprocess::preprocess(self.sources, id, self.read, settings, included, self.faults);
        self.gathered.incomplete |= unit.incomplete;
        self.gathered.seen.extend(unit.included);
        let (file, mut packed) = parser::parse_packed(unit.source, self.sources.text(unit.source), self.faults);
        let mut runs = std::mem::take(&mut packed.runs).into_iter().peekable();
        let to = self.gathered.facts.add_file(packed);
        let mut items = file.items.into_iter().enumerate();
        loop {
            let next = items.next();
            let at = next.as_ref().map_or(usize::MAX, |(at, _)| *at);
            while let Some((_, facts)) = runs.next_if(|(before, _)| *before <= at) {
                let before = self.gathered.items.len();
                self.gathered.facts.add_run(before, to, facts);
            }
            match next {
                None => break,
                Some((_, Item::Include(include))) => self.include(&include),
                Some((_, other)) => self.gathered.items.push(other),
            }
        }
    }

    fn include(&mut self, include: &Include) {
        let span = self.sources.written(include.place.0);
        let from = self.sources.name(span.source).to_owned();
        let wanted = Wanted {
            path: &include.path,
            from: &from,
            elsewhere: false,
            span,
        };
        let candidates = wanted.candidates(&self.settings.folders);
        let mut error = (candidates[0].clone(), ReadError::NotFound);
        for path in candidates {
            let key = normalize(&path);
            if let Some(position) = self.open.iter().position(|(open, _)| *open == key) {
                return self.cycle(position, span);
            }
            if self.gathered.seen.contains(&key) {
                return;
            }
            if let Some(&id) = self.included.get(&key) {
                return self.open(id, key, span);
            }
            if self.included.len() >= MAX_FILES {
                return self.too_many(span);
            }
            match self.read.read(&path) {
                Ok(text) => {
                    let id = self.sources.add(path.display().to_string(), text);
                    self.included.insert(key.clone(), id);
                    return self.open(id, key, span);
                }
                Err(ReadError::NotFound) => {}
                Err(other) => {
                    error = (path, other);
                    break;
                }
            }
        }
        self.gathered.incomplete = true;
        let fault = wanted.unreadable(&self.settings.folders, (&error.0, error.1), self.read);
        self.faults.push(fault);
    }

    fn too_many(&mut self, span: Span) {
        self.gathered.incomplete = true;
        let fault = Diagnostic::new(diag::codes::LIMIT_EXCEEDED, "too many included files").at(span, "");
        self.faults
            .push(fault.note(format!("a program has at most {MAX_FILES} files")));
    }

    fn open(&mut self, id: SourceId, key: PathBuf, span: Span) {
        if self.open.len() >= MAX_DEPTH {
            self.gathered.incomplete = true;
            let fault = Diagnostic::new(diag::codes::LIMIT_EXCEEDED, "includes nested too deeply")
                .at(span, "")
                .note(format!("a chain of includes has at most {MAX_DEPTH} files"));
            self.faults.push(fault);
            return;
        }
        self.gathered.seen.insert(key.clone());
        self.open.push((key, Some(span)));
        self.source(id);
        self.open.pop();
    }

    /// Reports that `span` includes the open file at `position`.
    fn cycle(&mut self, position: usize, span: Span) {
        let name = self.sources.name(span.source).to_owned();
        let on_cycle: Vec<Span> = self.open[position + 1..]
            .iter()
            .filter_map(|(_, include)| *include)
            .collect();
        let mut fault = match on_cycle.as_slice() {
            [] => Diagnostic::new(codes::INCLUDE_CYCLE, format!("`{name}` includes itself")).at(span, ""),
            _ => Diagnostic::new(codes::INCLUDE_CYCLE, "files include each other in a cycle")
                .at(span, "this include closes the cycle"),
        };
        for step in on_cycle {
            fault = fault.also(step, "on the cycle");
        }
        self.faults
            .push(fault.help("move the shared rules into a separate file, and include that"));
    }
}
