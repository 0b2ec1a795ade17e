//! One rule file with its includes: its diagnostics, and the names in it with their meanings.
// Decision: docs/decisions/tools.md#d031

use crate::builtin;
use crate::cli::load::inputs_of;
use crate::cli::lsp::city::City;
use crate::cli::lsp::place::{Encoding, Text};
use crate::config::ActionsConfig;
use crate::datalog;
use crate::datalog::ast;
use crate::datalog::ast::{Item, Literal, Name, Term, TermKind, TypeDefinition};
use crate::datalog::codes;
use crate::datalog::print;
use crate::datalog::{Functor, InputPolicy, Program, Rules, Workspace};
use crate::diag::{Diagnostic, Fix, MAX_FAULTS, SourceId, Sources, Span};
use crate::files::{ReadFile, builtin_path, normalize};
use crate::sim::{Vocabulary, examine};
use std::collections::{BTreeMap, HashMap};
use std::ops::Range;
use std::path::{Path, PathBuf};

/// The meaning of a name.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub enum Meaning {
    Predicate(String),
    Type(String),
    /// A user-defined functor.
    Functor(String),
    /// A branch of an algebraic data type.
    Branch(String),
    /// The path of an include.
    Include(String),
    /// A variable of the clause at this place.
    Variable(Span, String),
}

impl Meaning {
    /// Returns the name, or the path of an include.
    pub fn name(&self) -> &str {
        match self {
            Meaning::Predicate(name)
            | Meaning::Type(name)
            | Meaning::Functor(name)
            | Meaning::Branch(name)
            | Meaning::Include(name)
            | Meaning::Variable(_, name) => name,
        }
    }

    /// Returns the same kind of meaning with another name.
    pub fn renamed(&self, name: &str) -> Meaning {
        let name = name.to_owned();
        match self {
            Meaning::Predicate(_) => Meaning::Predicate(name),
            Meaning::Type(_) => Meaning::Type(name),
            Meaning::Functor(_) => Meaning::Functor(name),
            Meaning::Branch(_) => Meaning::Branch(name),
            Meaning::Include(_) => Meaning::Include(name),
            Meaning::Variable(clause, _) => Meaning::Variable(*clause, name),
        }
    }
}

/// What an occurrence does with its name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// It declares the name.
    Declares,
    /// It is the head of a clause.
    Derives,
    Uses,
}

/// A name in the document.
#[derive(Clone, Debug)]
pub struct Occurrence {
    pub span: Span,
    pub meaning: Meaning,
    pub role: Role,
}

impl Occurrence {
    pub fn declares(&self) -> bool {
        self.role == Role::Declares
    }
}

/// The result for one file, the source `entry` of `sources`. Those of its configuration come before it.
pub struct Analysis {
    pub sources: Sources,
    pub entry: SourceId,
    pub diagnostics: Vec<Diagnostic>,
    /// Lints: literals and clauses that are always true or redundant.
    pub hints: Vec<Diagnostic>,
    /// The rules with the constraints of the city, and the actions; `None` for faulty rules.
    pub deciding: Option<(Rules, ActionsConfig)>,
    pub files: Vec<(SourceId, ast::File)>,
    /// All names, in the order of the documents.
    pub occurrences: Vec<Occurrence>,
    /// The lines of each text.
    texts: BTreeMap<SourceId, Text>,
    /// The positions of a name in `occurrences`.
    by_meaning: HashMap<Meaning, Vec<usize>>,
    /// The file, the item in it, and the name in that, where a name is declared first.
    declarations: HashMap<Meaning, [usize; 3]>,
    /// The documents by normalized path.
    by_path: HashMap<PathBuf, SourceId>,
    /// The first include of each text.
    included_by: BTreeMap<SourceId, Span>,
}

impl Analysis {
    /// Reads, checks and lints a document with this path, as rules of the city if there is one.
    pub fn new(path: &Path, text: &str, read: &dyn ReadFile, encoding: Encoding, city: Option<&City>) -> Analysis {
        let mut sources = city.map_or_else(Sources::new, |city| city.sources.clone());
        let entry = sources.add(path.display().to_string(), text);
        let mut workspace = Workspace::new(InputPolicy::Fixed);
        workspace.add(&mut sources, entry, read);
        workspace.set_inputs(inputs_of(&workspace, city.is_some()));
        let loaded = workspace.into_checked();
        let mut diagnostics = loaded.diagnostics;
        let mut hints = Vec::new();
        let mut deciding = None;
        if let Some(rules) = loaded.rules {
            let theory = city.map(|city| &city.theory);
            let examined = examine(&rules, theory, &sources);
            diagnostics.extend(examined.diagnostics);
            hints = examined.hints;
            match Program::new(rules) {
                Ok(planned) => {
                    let mut actions = ActionsConfig::default();
                    if let Some(theory) = theory {
                        let mut scenario = theory.scenario.clone();
                        scenario.rules.span = Span::new(entry, 0..0);
                        actions.clone_from(&scenario.actions);
                        diagnostics.extend(Vocabulary::bind(&scenario, &planned).err().into_iter().flatten());
                    }
                    deciding = Some((examined.in_city, actions));
                }
                Err(fault) => diagnostics.push(fault),
            }
        }
        hints = sources.all_traced(&hints);
        diagnostics = sources.all_traced(&diagnostics);
        cap(&mut hints);
        cap(&mut diagnostics);
        // The documents before are those of the configuration.
        let files: Vec<(SourceId, ast::File)> = (sources.ids().skip_while(|id| *id != entry))
            .map(|id| (id, datalog::parse(&sources, id).file))
            .collect();
        let occurrences: Vec<Occurrence> = files.iter().flat_map(|(_, file)| occurrences(file)).collect();
        let mut by_meaning: HashMap<Meaning, Vec<usize>> = HashMap::new();
        for (at, one) in occurrences.iter().enumerate() {
            by_meaning.entry(one.meaning.clone()).or_default().push(at);
        }
        let texts = sources
            .ids()
            .map(|id| (id, Text::new(sources.text(id).to_owned(), encoding)));
        let mut by_path = HashMap::new();
        for id in sources.ids() {
            by_path.entry(normalize(Path::new(sources.name(id)))).or_insert(id);
        }
        let mut analysis = Analysis {
            entry,
            diagnostics,
            hints,
            deciding,
            texts: texts.collect(),
            by_meaning,
            declarations: declarations(&files),
            by_path,
            included_by: BTreeMap::new(),
            sources,
            files,
            occurrences,
        };
        for one in &analysis.occurrences {
            if let Meaning::Include(path) = &one.meaning
                && let Some(target) = analysis.target(one.span.source, path)
            {
                analysis.included_by.entry(target).or_insert(one.span);
            }
        }
        analysis
    }

    /// Returns a document with its lines.
    pub fn text(&self, id: SourceId) -> &Text {
        &self.texts[&id]
    }

    /// Returns whether the analysis read this file, or did not find an included one.
    pub fn depends_on(&self, path: &Path) -> bool {
        self.by_path.contains_key(path)
            || self.occurrences.iter().any(|one| match &one.meaning {
                Meaning::Include(include) => self.target(one.span.source, include).is_none(),
                _ => false,
            })
    }

    /// Returns the name at a byte of the file itself.
    pub fn at(&self, byte: usize) -> Option<&Occurrence> {
        let place = |one: &Occurrence| (one.span.source, one.span.start as usize);
        let after = self.occurrences.partition_point(|one| place(one) <= (self.entry, byte));
        let found = self.occurrences[..after].last()?;
        (found.span.source == self.entry && byte <= found.span.range().end).then_some(found)
    }

    /// Returns the occurrences of a name, in the order of the documents.
    pub fn all(&self, meaning: &Meaning) -> impl Iterator<Item = &Occurrence> {
        let found = self.by_meaning.get(meaning).map_or(&[][..], Vec::as_slice);
        found.iter().map(|&at| &self.occurrences[at])
    }

    /// Returns the span of the declaration of a name, or the start of the document that an include at `from` reads.
    pub fn declaration(&self, from: SourceId, meaning: &Meaning) -> Option<Span> {
        if let Meaning::Include(path) = meaning {
            return self.target(from, path).map(|target| Span::new(target, 0..0));
        }
        self.all(meaning).find(|one| one.declares()).map(|one| one.span)
    }

    /// Returns the declaration as text, and its doc comment.
    pub fn described(&self, meaning: &Meaning) -> Option<(String, String)> {
        let &[file, item, name] = self.declarations.get(meaning)?;
        let doc = String::new();
        let (item, doc) = match &self.files[file].1.items[item] {
            Item::Decl(decl) => {
                let (columns, qualifiers) = (decl.columns.clone(), decl.qualifiers.clone());
                let choices = decl.choices.clone();
                let names = vec![decl.names[name].clone()];
                let own = ast::Decl {
                    names,
                    columns,
                    qualifiers,
                    choices,
                    doc,
                };
                (Item::Decl(own), &decl.doc)
            }
            Item::Functor(decl) => (Item::Functor(ast::FunctorDecl { doc, ..decl.clone() }), &decl.doc),
            Item::Type(decl) => (Item::Type(ast::TypeDecl { doc, ..decl.clone() }), &decl.doc),
            _ => return None,
        };
        let file = ast::File { items: vec![item] };
        Some((print(&file).trim_end().to_owned(), doc.clone()))
    }

    /// Returns the declaration of a predicate.
    pub fn decl(&self, predicate: &str) -> Option<&ast::Decl> {
        let &[file, item, _] = self.declarations.get(&Meaning::Predicate(predicate.to_owned()))?;
        match &self.files[file].1.items[item] {
            Item::Decl(decl) => Some(decl),
            _ => None,
        }
    }

    /// Returns the declared names in source order, once per declaration.
    pub fn declared(&self) -> impl Iterator<Item = &Meaning> {
        self.occurrences
            .iter()
            .filter(|one| one.declares())
            .map(|one| &one.meaning)
    }

    /// Returns the items of the file itself.
    pub fn items(&self) -> &[Item] {
        let own = self.files.iter().find(|(id, _)| *id == self.entry);
        own.map_or(&[], |(_, file)| &file.items)
    }

    /// Returns whether a byte of the file itself is in the body of a clause, complete or not.
    pub fn in_body(&self, byte: usize) -> bool {
        let text = self.sources.text(self.entry);
        let before = &text[..byte.min(text.len())];
        // A full stop before white space ends a clause. One in a string or a comment is rare, and only hides words.
        let ends = [". ", ".\n", ".\r\n", ".\t"].map(|end| before.rfind(end));
        let from = ends.into_iter().flatten().max().map_or(0, |end| end + 1);
        before[from..].contains(":-")
    }

    /// Returns the fix for an unknown predicate that the vocabulary of the city declares.
    pub fn include_vocabulary(&self, fault: &Diagnostic) -> Option<Fix> {
        const VOCABULARY: &str = "vocabulary.dl";
        let label = fault
            .primary
            .as_ref()
            .filter(|_| fault.code == codes::UNKNOWN_PREDICATE)?;
        let name = self.sources.slice(label.span);
        let mut sources = Sources::new();
        let id = sources.add(VOCABULARY, builtin::text(&format!("rules/{VOCABULARY}"))?);
        let declares = |item: &Item| match item {
            Item::Decl(decl) => decl.names.iter().any(|declared| declared.text == name),
            _ => false,
        };
        let start = Span::new(self.entry, 0..0);
        datalog::parse(&sources, id)
            .file
            .items
            .iter()
            .any(declares)
            .then(|| Fix {
                title: format!("include {VOCABULARY}"),
                edits: vec![(start, format!(".include \"{VOCABULARY}\"\n"))],
            })
    }

    /// Returns the include in the file itself that reaches a document, directly or through others.
    pub fn include_of(&self, mut id: SourceId) -> Option<Span> {
        // A chain of includes is at most as long as the number of documents.
        for _ in &self.files {
            let include = *self.included_by.get(&id)?;
            if include.source == self.entry {
                return Some(include);
            }
            id = include.source;
        }
        None
    }

    /// Resolves an include as `datalog::load` does.
    pub fn target(&self, from: SourceId, path: &str) -> Option<SourceId> {
        let [beside, builtin] = include_paths(Path::new(self.sources.name(from)), path);
        let named = |wanted: &PathBuf| self.by_path.get(wanted).copied();
        named(&beside).or_else(|| named(&builtin))
    }

    /// Returns diagnostics of an earlier analysis with their places in this one. Drops those at text that has changed.
    pub fn carry(&self, earlier: &Analysis, faults: &[Diagnostic]) -> Vec<Diagnostic> {
        let mut changes: BTreeMap<SourceId, Option<Change>> = BTreeMap::new();
        let mut moved = |span: Span| {
            let change = changes.entry(span.source).or_insert_with(|| {
                let id = *self
                    .by_path
                    .get(&normalize(Path::new(earlier.sources.name(span.source))))?;
                Some(Change::new(
                    id,
                    earlier.sources.text(span.source),
                    self.sources.text(id),
                ))
            });
            change.as_ref()?.moved(span.range())
        };
        let mut carried = Vec::new();
        for fault in faults {
            let mut fault = fault.clone();
            let labels = fault.primary.iter_mut().chain(&mut fault.secondary);
            let spans = labels.map(|label| moved(label.span).map(|span| label.span = span));
            if spans.collect::<Option<Vec<()>>>().is_some() {
                carried.push(fault);
            }
        }
        carried
    }
}

/// The change from one document to another: all between their common beginning and their common end.
struct Change {
    source: SourceId,
    /// The changed bytes of the earlier text.
    bytes: Range<usize>,
    /// The length of the new text in place of these.
    length: usize,
}

impl Change {
    fn new(source: SourceId, old: &str, new: &str) -> Change {
        let same = old
            .bytes()
            .zip(new.bytes())
            .take_while(|(one, other)| one == other)
            .count();
        let (rest, other) = (&old.as_bytes()[same..], &new.as_bytes()[same..]);
        let ends = rest.iter().rev().zip(other.iter().rev());
        let end = ends.take_while(|(one, other)| one == other).count();
        Change {
            source,
            bytes: same..old.len() - end,
            length: other.len() - end,
        }
    }

    /// Returns the new place of bytes of the earlier text, unless they have changed.
    fn moved(&self, bytes: Range<usize>) -> Option<Span> {
        let move_by = |byte: usize| byte - self.bytes.len() + self.length;
        if self.bytes.is_empty() && self.length == 0 || bytes.end <= self.bytes.start {
            return Some(Span::new(self.source, bytes));
        }
        let is_after = bytes.start >= self.bytes.end;
        is_after.then(|| Span::new(self.source, move_by(bytes.start)..move_by(bytes.end)))
    }
}

/// Shortens a list of diagnostics to the number that an editor can show.
fn cap(faults: &mut Vec<Diagnostic>) {
    let hidden = faults.len().saturating_sub(2 * MAX_FAULTS + 1);
    faults.truncate(2 * MAX_FAULTS + 1);
    if hidden > 0
        && let Some(last) = faults.last_mut()
    {
        last.notes.push(format!("{hidden} more are not shown"));
    }
}

/// Returns where an include looks for its file: beside the including one, then among the built-in files.
pub fn include_paths(from: &Path, path: &str) -> [PathBuf; 2] {
    let beside = from.parent().unwrap_or(Path::new("")).join(path);
    [beside, builtin_path(path)].map(|path| normalize(&path))
}

/// Returns where names are declared first: the file, the item in it, and the name in that.
fn declarations(files: &[(SourceId, ast::File)]) -> HashMap<Meaning, [usize; 3]> {
    let mut found = HashMap::new();
    for (file, (_, tree)) in files.iter().enumerate() {
        for (item, one) in tree.items.iter().enumerate() {
            match one {
                Item::Decl(decl) => {
                    for (at, name) in decl.names.iter().enumerate() {
                        let meaning = Meaning::Predicate(name.text.clone());
                        found.entry(meaning).or_insert([file, item, at]);
                    }
                }
                Item::Functor(decl) => {
                    let meaning = Meaning::Functor(decl.name.text.clone());
                    found.entry(meaning).or_insert([file, item, 0]);
                }
                Item::Type(decl) => {
                    let meaning = Meaning::Type(decl.name.text.clone());
                    found.entry(meaning).or_insert([file, item, 0]);
                    if let TypeDefinition::Branches(branches) = &decl.definition {
                        for branch in branches {
                            let meaning = Meaning::Branch(branch.name.text.clone());
                            found.entry(meaning).or_insert([file, item, 0]);
                        }
                    }
                }
                _ => {}
            }
        }
    }
    found
}

/// Returns all names of a file in the order of its source.
pub fn occurrences(file: &ast::File) -> Vec<Occurrence> {
    let mut names = Names::default();
    file.items.iter().for_each(|item| names.item(item));
    // A negation such as `x != y` in other notations, or an aggregate, may be read in another order.
    names.found.sort_by_key(|one| one.span.start);
    names.found
}

/// Collects the names of a file.
#[derive(Default)]
struct Names {
    found: Vec<Occurrence>,
    /// The clause whose names are being collected.
    clause: Option<Span>,
}

impl Names {
    fn add(&mut self, name: &Name, meaning: fn(String) -> Meaning, role: Role) {
        self.found.push(Occurrence {
            span: name.place.0,
            meaning: meaning(name.text.clone()),
            role,
        });
    }

    fn item(&mut self, item: &Item) {
        let types = |names: &mut Names, list: &[&Name]| {
            list.iter().for_each(|name| names.add(name, Meaning::Type, Role::Uses));
        };
        match item {
            Item::Include(include) => self.found.push(Occurrence {
                span: include.place.0,
                meaning: Meaning::Include(include.path.clone()),
                role: Role::Uses,
            }),
            Item::Functor(decl) => {
                self.add(&decl.name, Meaning::Functor, Role::Declares);
                types(self, &decl.arguments.iter().map(|(_, ty)| ty).collect::<Vec<_>>());
                types(self, &[&decl.result]);
            }
            Item::Type(decl) => {
                self.add(&decl.name, Meaning::Type, Role::Declares);
                match &decl.definition {
                    TypeDefinition::Subtype(name) | TypeDefinition::Alias(name) => types(self, &[name]),
                    TypeDefinition::Union(names) => types(self, &names.iter().collect::<Vec<_>>()),
                    TypeDefinition::Record(fields) => {
                        types(self, &fields.iter().map(|field| &field.ty).collect::<Vec<_>>());
                    }
                    TypeDefinition::Branches(branches) => {
                        for branch in branches {
                            self.add(&branch.name, Meaning::Branch, Role::Declares);
                            types(self, &branch.fields.iter().map(|field| &field.ty).collect::<Vec<_>>());
                        }
                    }
                    TypeDefinition::Faulty => {}
                }
            }
            Item::Decl(decl) => {
                for name in &decl.names {
                    self.add(name, Meaning::Predicate, Role::Declares);
                }
                let columns = decl.columns.iter().flatten();
                types(self, &columns.map(|column| &column.ty).collect::<Vec<_>>());
            }
            Item::Mark(ast::Mark { names, .. }) | Item::Constraint(ast::ConstraintDecl { names, .. }) => {
                for name in names {
                    self.add(name, Meaning::Predicate, Role::Uses);
                }
            }
            Item::Scope(scope) => {
                if let Some(name) = &scope.predicate {
                    self.add(name, Meaning::Predicate, Role::Uses);
                }
            }
            Item::Subsumption(subsumption) => {
                self.clause = Some(subsumption.place.0);
                self.atom(&subsumption.weaker, Role::Derives);
                self.atom(&subsumption.stronger, Role::Uses);
                subsumption.body.iter().for_each(|literal| self.literal(literal));
            }
            Item::Clause(clause) => {
                self.clause = Some(clause.place.0);
                clause.heads.iter().for_each(|head| self.atom(head, Role::Derives));
                clause.body.iter().for_each(|literal| self.literal(literal));
            }
            // A name in a component means something only in an instance.
            Item::Plan(_) | Item::Pragma(_) | Item::Component(_) | Item::Init(_) | Item::Override(_) => {}
        }
    }

    fn atom(&mut self, atom: &ast::Atom, role: Role) {
        self.add(&atom.predicate, Meaning::Predicate, role);
        atom.terms.iter().for_each(|term| self.term(term));
    }

    fn literal(&mut self, literal: &Literal) {
        match literal {
            Literal::Atom { atom, .. } => self.atom(atom, Role::Uses),
            Literal::Compare { left, right, .. } => [left, right].into_iter().for_each(|term| self.term(term)),
            Literal::Temporal { temporal, .. } => temporal.atoms().for_each(|atom| self.atom(atom, Role::Uses)),
            Literal::Any(alternatives) => alternatives.iter().flatten().for_each(|one| self.literal(one)),
        }
    }

    fn term(&mut self, term: &Term) {
        match &term.kind {
            TermKind::Variable(name) => {
                if let Some(clause) = self.clause {
                    self.found.push(Occurrence {
                        span: term.place.0,
                        meaning: Meaning::Variable(clause, name.clone()),
                        role: Role::Uses,
                    });
                }
            }
            // The first argument is the name of the functor or of the branch, which is empty for a record.
            TermKind::Functor(functor @ (Functor::Call | Functor::Pack), arguments) => {
                if let Some((
                    Term {
                        kind: TermKind::Symbol(name),
                        place,
                    },
                    arguments,
                )) = arguments.split_first()
                {
                    let meaning = match functor {
                        Functor::Call => Meaning::Functor(name.clone()),
                        _ => Meaning::Branch(name.clone()),
                    };
                    if !name.is_empty() {
                        self.found.push(Occurrence {
                            span: place.0,
                            meaning,
                            role: Role::Uses,
                        });
                    }
                    arguments.iter().for_each(|argument| self.term(argument));
                }
            }
            TermKind::Functor(_, arguments) => arguments.iter().for_each(|argument| self.term(argument)),
            TermKind::Cast(inner, ty) => {
                self.term(inner);
                self.add(ty, Meaning::Type, Role::Uses);
            }
            TermKind::Aggregate(aggregate) => {
                aggregate.target.iter().for_each(|target| self.term(target));
                aggregate.body.iter().for_each(|literal| self.literal(literal));
            }
            _ => {}
        }
    }
}
