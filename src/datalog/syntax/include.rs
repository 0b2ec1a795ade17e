//! Includes: the files of a program as one list of items, in reading order.

use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};

use crate::codes;
use crate::diag::{self, Diagnostic, Faults, SourceId, Sources, Span, similar_file, similar_file_in};
use crate::files::{BUILTIN_FOLDER, ReadError, ReadFile, normalize};

use crate::syntax::ast::{File, Include, Item};
use crate::syntax::packed::FactRuns;
use crate::syntax::parser;
use crate::syntax::parser::Macros;

/// Maximum size of a rule file in bytes.
const MAX_TEXT_BYTES: usize = 64 << 20;

/// The extension of rule files.
const ENDING: &str = "dl";

/// The folder of the built-in rule files, which includes omit.
const BUILTIN_RULES: &str = "rules/";

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
    /// Whether an included file was missing. If so, its declarations may explain unknown names.
    pub incomplete: bool,
    /// The macros of all files.
    pub macros: Macros,
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
    faults: &mut Faults,
) {
    let key = normalize(Path::new(sources.name(entry)));
    if !gathered.seen.insert(key.clone()) {
        return;
    }
    let (items, facts, incomplete) = (gathered.items.len(), gathered.facts.len(), gathered.incomplete);
    let mark = faults.mark();
    let mut walk = Walk {
        sources,
        read,
        faults,
        open: vec![(key, None)],
        included: HashMap::new(),
        gathered,
    };
    walk.source(entry);
    if !walk.gathered.macros.is_empty() && !walk.included.is_empty() {
        // A file that uses macros is parsed before the files it includes, which define them.
        walk.faults.rewind(mark);
        walk.gathered.items.truncate(items);
        walk.gathered.facts.truncate(facts);
        walk.gathered.incomplete = incomplete;
        let included = &walk.included;
        walk.gathered.seen.retain(|key| !included.contains_key(key));
        walk.source(entry);
    }
}

/// Returns the names that built-in files declare, without those that include others: these are programs.
pub(crate) fn offered(read: &dyn ReadFile) -> Offered {
    let mut offered = Offered::new();
    for path in read.builtin_paths() {
        let written = path.strip_prefix(BUILTIN_RULES).unwrap_or(&path);
        if Path::new(written).extension().is_none_or(|ending| ending != ENDING) {
            continue;
        }
        let Ok(text) = read.read(&Path::new(BUILTIN_FOLDER).join(written)) else {
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
    faults: &'a mut Faults,
    /// The files that are open, outermost first: the normalized path, and the include that led to it.
    open: Vec<(PathBuf, Option<Span>)>,
    /// The sources that this walk has added, by normalized path.
    included: HashMap<PathBuf, SourceId>,
    gathered: &'a mut Gathered,
}

impl Walk<'_> {
    fn source(&mut self, id: SourceId) {
        let Some(text) = small_source(self.sources, id, self.faults) else {
            return;
        };
        let (file, mut packed) = parser::parse_packed(id, text, &mut self.gathered.macros, self.faults);
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
                Some((_, Item::Include(include))) => self.include(id, &include),
                Some((_, other)) => self.gathered.items.push(other),
            }
        }
    }

    fn include(&mut self, from: SourceId, include: &Include) {
        let span = include.place.0;
        let beside = Path::new(self.sources.name(from))
            .parent()
            .unwrap_or(Path::new(""))
            .join(&include.path);
        let builtin = Path::new(BUILTIN_FOLDER).join(&include.path);
        // `join` with an absolute path returns that path, so both candidates are the same.
        let builtin = builtin.starts_with(BUILTIN_FOLDER).then_some(builtin);
        let mut error = ReadError::NotFound;
        for path in std::iter::once(&beside).chain(&builtin) {
            let key = normalize(path);
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
            match self.read.read(path) {
                Ok(text) => {
                    let id = self.sources.add(path.display().to_string(), text);
                    self.included.insert(key.clone(), id);
                    return self.open(id, key, span);
                }
                Err(ReadError::NotFound) => {}
                Err(other) => {
                    error = other;
                    break;
                }
            }
        }
        self.gathered.incomplete = true;
        let path = beside.display();
        let fault = match error {
            ReadError::NotFound => {
                let fault = Diagnostic::new(codes::MISSING_INCLUDE, format!("no file `{}` to include", include.path))
                    .at(span, "")
                    .note(match builtin {
                        Some(_) => format!("looked for `{path}` and for a built-in rule file of that name"),
                        None => format!("looked for `{path}`"),
                    });
                match self.similar(from, &include.path) {
                    Some(near) => fault
                        .help(format!("did you mean `{near}`?"))
                        .fix(format!("include `{near}`"), [(span, format!("\"{near}\""))]),
                    None if Path::new(&include.path).is_relative() && include.path.contains('/') => {
                        fault.help("write the path from the folder of this file")
                    }
                    None => fault,
                }
            }
            ReadError::NotText { .. } => {
                Diagnostic::new(diag::codes::NOT_TEXT, format!("`{path}` is {error}")).at(span, "included here")
            }
            ReadError::TooLarge(_) => {
                Diagnostic::new(diag::codes::LIMIT_EXCEEDED, format!("`{path}` is {error}")).at(span, "included here")
            }
            ReadError::Folder | ReadError::Io(_) => {
                Diagnostic::new(codes::MISSING_INCLUDE, format!("cannot read `{path}`: {error}"))
                    .at(span, "included here")
            }
        };
        self.faults.push(fault);
    }

    fn too_many(&mut self, span: Span) {
        self.gathered.incomplete = true;
        let fault = Diagnostic::new(diag::codes::LIMIT_EXCEEDED, "too many included files").at(span, "");
        self.faults
            .push(fault.note(format!("a program has at most {MAX_FILES} files")));
    }

    /// Returns a similar name of an existing file: with the usual extension, or a built-in file.
    fn similar(&self, from: SourceId, path: &str) -> Option<String> {
        let folder = Path::new(self.sources.name(from)).parent().unwrap_or(Path::new(""));
        let ended = format!("{path}.{ENDING}");
        let beside = self.read.read(&folder.join(&ended)).is_ok().then_some(ended.as_str());
        let known = self.read.builtin_paths();
        let builtin = known.iter().filter_map(|known| known.strip_prefix(BUILTIN_RULES));
        let near = similar_file(path, beside.into_iter().chain(builtin)).map(str::to_owned);
        near.or_else(|| {
            similar_file_in(
                |folder| self.read.names_in(folder),
                folder,
                Path::new(path),
                Some(ENDING),
            )
        })
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
