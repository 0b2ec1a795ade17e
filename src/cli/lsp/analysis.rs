//! One rule file with its includes: its diagnostics, and the names in it with their meanings.

use crate::builtin;
use crate::datalog;
use crate::datalog::ast;
use crate::datalog::ast::{Item, Literal, Name, Term, TermKind, TypeDefinition};
use crate::datalog::print;
use crate::datalog::{Program, optimize};
use crate::diag::{Code, Diagnostic, Fix, SourceId, Sources, Span};
use crate::files::{BUILTIN_FOLDER, ReadFile, normalize};
use crate::sim::city_lints;
use std::path::{Path, PathBuf};

/// The meaning of a name.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Meaning {
    Predicate(String),
    Type(String),
    /// An include, and the text it refers to if that exists.
    Include(Option<SourceId>),
    /// A variable of the clause at this place.
    Variable(Span, String),
}

/// A name in the text.
#[derive(Clone, Debug)]
pub struct Occurrence {
    pub span: Span,
    pub meaning: Meaning,
    /// Whether this occurrence declares the name.
    pub declares: bool,
}

/// The result for one file, which is the first text of `sources`.
pub struct Analysis {
    pub sources: Sources,
    pub entry: SourceId,
    pub diagnostics: Vec<Diagnostic>,
    /// Lints: literals and clauses that are always true or redundant.
    pub hints: Vec<Diagnostic>,
    pub files: Vec<(SourceId, ast::File)>,
    pub occurrences: Vec<Occurrence>,
    /// The clause whose names are being collected.
    clause: Option<Span>,
}

impl Analysis {
    /// Reads, checks and lints a text with this path.
    pub fn new(path: &Path, text: &str, read: &dyn ReadFile) -> Analysis {
        let mut sources = Sources::new();
        let entry = sources.add(path.display().to_string(), text);
        let loaded = datalog::load(&mut sources, entry, read);
        let mut diagnostics = loaded.diagnostics;
        let mut hints = Vec::new();
        if let Some(rules) = loaded.rules {
            for lint in optimize::lints(&rules).diagnostics {
                match lint.code {
                    Code::CONTRADICTORY_BODY => diagnostics.push(lint),
                    _ => hints.push(lint),
                }
            }
            diagnostics.extend(city_lints(&rules, None));
            diagnostics.extend(Program::new(rules).err());
        }
        let files: Vec<(SourceId, ast::File)> = (sources.ids())
            .map(|id| (id, datalog::parse(&sources, id).file))
            .collect();
        let mut analysis = Analysis {
            sources,
            entry,
            diagnostics,
            hints,
            files: Vec::new(),
            occurrences: Vec::new(),
            clause: None,
        };
        for (id, file) in &files {
            file.items.iter().for_each(|item| analysis.item(*id, item));
        }
        analysis.files = files;
        analysis
    }

    /// Returns the name at a byte of the file itself.
    pub fn at(&self, byte: usize) -> Option<&Occurrence> {
        self.occurrences.iter().find(|one| {
            let bytes = one.span.range();
            one.span.source == self.entry && bytes.start <= byte && byte <= bytes.end
        })
    }

    /// Returns the span of the declaration.
    pub fn declaration(&self, meaning: &Meaning) -> Option<Span> {
        if let Meaning::Include(target) = meaning {
            return target.map(|target| Span::new(target, 0..0));
        }
        let found = self
            .occurrences
            .iter()
            .find(|one| one.declares && one.meaning == *meaning);
        found.map(|one| one.span)
    }

    /// Returns the declaration as text, and its doc comment.
    pub fn described(&self, meaning: &Meaning) -> Option<(String, String)> {
        let items = self.files.iter().flat_map(|(_, file)| &file.items);
        let mut items = items.filter_map(|item| match (item, meaning) {
            (Item::Decl(decl), Meaning::Predicate(name)) => {
                let name = decl.names.iter().find(|known| known.text == *name)?;
                let (names, doc) = (vec![name.clone()], String::new());
                Some((
                    Item::Decl(ast::Decl {
                        names,
                        doc,
                        ..decl.clone()
                    }),
                    &decl.doc,
                ))
            }
            (Item::Type(decl), Meaning::Type(name)) if decl.name.text == *name => {
                let doc = String::new();
                Some((Item::Type(ast::TypeDecl { doc, ..decl.clone() }), &decl.doc))
            }
            _ => None,
        });
        let (item, doc) = items.next()?;
        let file = ast::File { items: vec![item] };
        Some((print(&file).trim_end().to_owned(), doc.clone()))
    }

    /// Returns all declared names, each once, in source order.
    pub fn declared(&self) -> impl Iterator<Item = &Meaning> {
        self.occurrences
            .iter()
            .filter(|one| one.declares)
            .map(|one| &one.meaning)
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
            .filter(|_| fault.code == Code::UNKNOWN_PREDICATE)?;
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

    /// Returns the include in the file itself that reaches a text, directly or through others.
    pub fn include_of(&self, mut id: SourceId) -> Option<Span> {
        // A chain of includes is at most as long as the number of texts.
        for _ in &self.files {
            let include = (self.occurrences.iter()).find(|one| one.meaning == Meaning::Include(Some(id)))?;
            if include.span.source == self.entry {
                return Some(include.span);
            }
            id = include.span.source;
        }
        None
    }

    fn add(&mut self, name: &Name, meaning: fn(String) -> Meaning, declares: bool) {
        self.occurrences.push(Occurrence {
            span: name.place.0,
            meaning: meaning(name.text.clone()),
            declares,
        });
    }

    fn item(&mut self, id: SourceId, item: &Item) {
        match item {
            Item::Include(include) => {
                let meaning = Meaning::Include(self.target(id, &include.path));
                self.occurrences.push(Occurrence {
                    span: include.place.0,
                    meaning,
                    declares: false,
                });
            }
            Item::Type(decl) => {
                self.add(&decl.name, Meaning::Type, true);
                match &decl.definition {
                    TypeDefinition::Subtype(name) | TypeDefinition::Alias(name) => self.add(name, Meaning::Type, false),
                    TypeDefinition::Union(names) => names.iter().for_each(|name| self.add(name, Meaning::Type, false)),
                    TypeDefinition::Faulty => {}
                }
            }
            Item::Decl(decl) => {
                decl.names
                    .iter()
                    .for_each(|name| self.add(name, Meaning::Predicate, true));
                let columns = decl.columns.iter().flatten();
                columns.for_each(|column| self.add(&column.ty, Meaning::Type, false));
            }
            Item::Mark(ast::Mark { names, .. }) | Item::Constraint(ast::ConstraintDecl { names, .. }) => {
                names.iter().for_each(|name| self.add(name, Meaning::Predicate, false));
            }
            Item::Scope(scope) => scope
                .predicate
                .iter()
                .for_each(|name| self.add(name, Meaning::Predicate, false)),
            Item::Clause(clause) => {
                self.clause = Some(clause.place.0);
                clause.heads.iter().for_each(|head| self.atom(head));
                clause.body.iter().for_each(|literal| self.literal(literal));
            }
            Item::Plan(_) | Item::Pragma(_) => {}
        }
    }

    fn atom(&mut self, atom: &ast::Atom) {
        self.add(&atom.predicate, Meaning::Predicate, false);
        atom.terms.iter().for_each(|term| self.term(term));
    }

    fn literal(&mut self, literal: &Literal) {
        match literal {
            Literal::Atom { atom, .. } => self.atom(atom),
            Literal::Compare { left, right, .. } => [left, right].into_iter().for_each(|term| self.term(term)),
            Literal::Any(alternatives) => alternatives.iter().flatten().for_each(|one| self.literal(one)),
        }
    }

    fn term(&mut self, term: &Term) {
        match &term.kind {
            TermKind::Variable(name) => {
                if let Some(clause) = self.clause {
                    self.occurrences.push(Occurrence {
                        span: term.place.0,
                        meaning: Meaning::Variable(clause, name.clone()),
                        declares: false,
                    });
                }
            }
            TermKind::Functor(_, arguments) => arguments.iter().for_each(|argument| self.term(argument)),
            TermKind::Cast(inner, ty) => {
                self.term(inner);
                self.add(ty, Meaning::Type, false);
            }
            TermKind::Aggregate(aggregate) => {
                aggregate.target.iter().for_each(|target| self.term(target));
                aggregate.body.iter().for_each(|literal| self.literal(literal));
            }
            _ => {}
        }
    }

    /// Resolves an include as `datalog::load` does.
    fn target(&self, from: SourceId, path: &str) -> Option<SourceId> {
        let beside = Path::new(self.sources.name(from)).parent()?.join(path);
        let builtin = Path::new(BUILTIN_FOLDER).join(path);
        let named = |wanted: PathBuf| {
            let wanted = normalize(&wanted);
            self.sources
                .ids()
                .find(|&id| normalize(Path::new(self.sources.name(id))) == wanted)
        };
        named(beside).or_else(|| named(builtin))
    }
}
