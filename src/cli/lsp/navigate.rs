//! What a name means and where it occurs: hover, definition, highlights, references and renaming.

use crate::cli::lsp::analysis::{Analysis, Meaning, Occurrence, Role, occurrences};
use crate::cli::lsp::search::{Programs, RuleFile, parsed};
use crate::cli::lsp::{Document, Refusal, Request, Server, builtin, cancelled, location, markup, search, words};
use crate::datalog;
use crate::datalog::{BaseType, TokenKind, tokens};
use crate::diag::Span;
use lsp_server::ErrorCode;
use lsp_types::{DocumentHighlightKind, RenameParams, SymbolKind, TextDocumentPositionParams};
use serde_json::{Map, Value, json};
use std::ops::Range;
use std::path::Path;

/// The maximum number of symbols of the workspace that an answer lists.
const SYMBOLS_MAX: usize = 1000;

impl Server {
    pub(super) fn hover(&self, at: &TextDocumentPositionParams) -> Result<Value, Refusal> {
        let (document, byte, found) = self.named(at)?;
        let Some(one) = found else {
            return Ok(self.hover_word(document, byte).unwrap_or(Value::Null));
        };
        let analysis = &document.analysis;
        let text = match &one.meaning {
            Meaning::Include(path) => {
                let target = analysis.target(one.span.source, path);
                target.map(|target| format!("`{}`", analysis.sources.name(target)))
            }
            meaning => described(analysis, meaning),
        };
        let range = document.text.range_of(one.span);
        let shown = text.map(|text| json!({ "contents": markup(text, self.client.plain_hover), "range": range }));
        Ok(shown.unwrap_or(Value::Null))
    }

    /// Describes the word of the language at a byte.
    fn hover_word(&self, document: &Document, byte: usize) -> Option<Value> {
        let text = document.text.as_str();
        let tokens = tokens(document.analysis.entry, text);
        let after = tokens.partition_point(|(_, bytes)| bytes.start <= byte);
        let (kind, bytes) = tokens[..after].last().filter(|(_, bytes)| byte <= bytes.end)?;
        let word = match kind {
            TokenKind::Directive => words::find(&text[bytes.start + 1..bytes.end], true),
            TokenKind::Name => words::find(&text[bytes.clone()], false),
            _ => None,
        }?;
        let shown = format!("```prolog\n{}\n```\n\n{}\n", word.form, word.meaning);
        let range = document.text.range(bytes.clone());
        Some(json!({ "contents": markup(shown, self.client.plain_hover), "range": range }))
    }

    /// Returns the place of a declaration. An editor can open built-in files only as copies on the disk.
    pub(super) fn definition(&self, at: &TextDocumentPositionParams) -> Result<Value, Refusal> {
        let (document, _, Some(one)) = self.named(at)? else {
            return Ok(Value::Null);
        };
        let Analysis { sources, .. } = &document.analysis;
        let place = document
            .analysis
            .declaration(one.span.source, &one.meaning)
            .and_then(|span| {
                self.location(&document.analysis, span).or_else(|| {
                    let copy = builtin::copy(Path::new(sources.name(span.source)), sources.text(span.source))?;
                    Some(location(&copy, document.analysis.text(span.source), &span.range()))
                })
            });
        Ok(place.unwrap_or(Value::Null))
    }

    /// Lists the occurrences of a name in one document.
    pub(super) fn highlights(&self, at: &TextDocumentPositionParams) -> Result<Value, Refusal> {
        let (document, _, Some(one)) = self.named(at)? else {
            return Ok(Value::Null);
        };
        let own = document.analysis.all(&one.meaning);
        let own = own.filter(|other| other.span.source == document.analysis.entry);
        let shown = own.map(|one| {
            let kind = match one.role {
                Role::Declares | Role::Derives => DocumentHighlightKind::WRITE,
                Role::Uses => DocumentHighlightKind::READ,
            };
            json!({ "range": document.text.range_of(one.span), "kind": kind })
        });
        Ok(shown.collect())
    }

    /// Lists the occurrences of a name in all files that share it.
    pub(super) fn references(
        &self,
        at: &TextDocumentPositionParams,
        declared: bool,
        request: &Request<'_>,
    ) -> Result<Value, Refusal> {
        let (document, _, Some(one)) = self.named(at)? else {
            return Ok(Value::Null);
        };
        let listed = |one: &&Occurrence| declared || !one.declares();
        if let Meaning::Variable(..) = one.meaning {
            let places = document.analysis.all(&one.meaning).filter(listed);
            let shown = places.map(|one| json!({ "uri": document.uri, "range": document.text.range_of(one.span) }));
            return Ok(shown.collect());
        }
        if let Meaning::Include(_) = one.meaning {
            return Ok(Value::Null);
        }
        let programs = self.programs(&[one.meaning.name()], request)?;
        let files = sharing(&programs, document, &one.meaning, request)?;
        let mut places: Vec<(String, Range<usize>, Value)> = Vec::new();
        for file in files.iter().map(|&file| &programs.files[file]) {
            let Some(uri) = self.uri_of(&file.path) else { continue };
            let named = file
                .names
                .iter()
                .filter(|other| other.meaning == one.meaning)
                .filter(listed);
            places.extend(named.map(|one| {
                let shown = json!({ "uri": uri, "range": file.text.range_of(one.span) });
                (uri.clone(), one.span.range(), shown)
            }));
        }
        places.sort_by(|one, other| (&one.0, one.1.start).cmp(&(&other.0, other.1.start)));
        Ok(places.into_iter().map(|(.., shown)| shown).collect())
    }

    pub(super) fn prepare_rename(&self, at: &TextDocumentPositionParams) -> Result<Value, Refusal> {
        let (document, _, found) = self.named(at)?;
        let renamed = found.filter(|one| !matches!(one.meaning, Meaning::Include(_)) && !is_base_type(&one.meaning));
        Ok(renamed.map_or(Value::Null, |one| json!(document.text.range_of(one.span))))
    }

    pub(super) fn rename(&self, params: &RenameParams, request: &Request<'_>) -> Result<Value, Refusal> {
        let new = params.new_name.as_str();
        let (document, _, found) = self.named(&params.text_document_position)?;
        let found = found.filter(|one| !matches!(one.meaning, Meaning::Include(_)) && !is_base_type(&one.meaning));
        let Some(one) = found else {
            return refuse("only predicates, types, branches, functors and variables can be renamed".to_owned());
        };
        if !datalog::is_name(new) {
            return refuse(format!("`{new}` is not a name"));
        }
        if new == one.meaning.name() {
            return Ok(self.edit([]));
        }
        let is_variable = matches!(one.meaning, Meaning::Variable(..));
        let is_base = BaseType::ALL.iter().any(|base| base.name() == new);
        if words::find(new, false).is_some() && (is_variable || !is_base) {
            return refuse(format!("`{new}` is a word of the language"));
        }
        if is_variable {
            if document.analysis.all(&one.meaning.renamed(new)).next().is_some() {
                return refuse(format!("`{new}` is already a variable of this clause"));
            }
            let file = RuleFile::new(&document.path, document.text.clone());
            return Ok(self.edit([self.edits(&file, &one.meaning, new)?]));
        }
        let programs = self.programs(&[one.meaning.name(), new], request)?;
        if !programs.complete {
            return refuse("the workspace is too large to find all uses of the name: open a smaller folder".to_owned());
        }
        let files = sharing(&programs, document, &one.meaning, request)?;
        // Predicates and types share a namespace.
        let taken = programs.taken(&files, new, &|| request.is_cancelled());
        if is_base || taken.map_err(|search::Cancelled| cancelled())?.is_some() {
            return refuse(format!("`{new}` is already declared"));
        }
        let files = files.iter().map(|&file| &programs.files[file]);
        let declares = |file: &RuleFile| {
            file.names
                .iter()
                .any(|other| other.meaning == one.meaning && other.declares())
        };
        if files.clone().any(RuleFile::is_builtin) {
            return refuse("a read-only file declares the name".to_owned());
        }
        if !files.clone().any(declares) {
            return refuse(format!("`{}` is not declared", one.meaning.name()));
        }
        let edits = files.map(|file| match request.is_cancelled() {
            true => Err(cancelled()),
            false => self.edits(file, &one.meaning, new),
        });
        let edits = edits.collect::<Result<Vec<_>, _>>()?;
        Ok(self.edit(edits))
    }

    /// Returns the edits of one file that rename a name, after a check that the new text has the same names otherwise.
    fn edits(&self, file: &RuleFile, meaning: &Meaning, new: &str) -> Result<FileEdits, Refusal> {
        let places = file
            .names
            .iter()
            .filter(|one| one.meaning == *meaning)
            .map(|one| one.span.range());
        let places: Vec<Range<usize>> = places.collect();
        let (old, mut text, mut done) = (file.text.as_str(), String::new(), 0);
        for place in &places {
            text += &old[done..place.start];
            text += new;
            done = place.end;
        }
        text += &old[done..];
        let (tree, faults) = parsed(&file.path, &text);
        let kind_and_name = |one: &Occurrence| match &one.meaning {
            Meaning::Variable(_, name) => (0, name.clone()),
            Meaning::Predicate(name) => (1, name.clone()),
            Meaning::Type(name) => (2, name.clone()),
            Meaning::Include(path) => (3, path.clone()),
            Meaning::Functor(name) => (4, name.clone()),
            Meaning::Branch(name) => (5, name.clone()),
        };
        let expected = file.names.iter().map(|one| match one.meaning == *meaning {
            true => kind_and_name(&Occurrence {
                meaning: meaning.renamed(new),
                ..one.clone()
            }),
            false => kind_and_name(one),
        });
        if faults > file.faults || !expected.eq(occurrences(&tree).iter().map(kind_and_name)) {
            return refuse(format!("with the name `{new}`, the program means something else"));
        }
        let ranges = places
            .into_iter()
            .map(|place| json!({ "range": file.text.range(place), "newText": new }));
        Ok((file.path.clone(), ranges.collect()))
    }

    /// Returns edits of files as the client wants them.
    fn edit(&self, edits: impl IntoIterator<Item = FileEdits>) -> Value {
        let edits = edits
            .into_iter()
            .filter_map(|(path, edits)| Some((self.uri_of(&path)?, path, edits)));
        let mut edits: Vec<_> = edits.filter(|(.., edits)| !edits.is_empty()).collect();
        edits.sort_by(|one, other| one.0.cmp(&other.0));
        self.changes(edits.into_iter().map(|(uri, path, edits)| {
            let version = self.documents.get(&path).map(|document| document.version);
            (uri, version, edits)
        }))
    }

    /// Returns an edit of the workspace: for each URI the version of the document and its edits.
    pub(super) fn changes(&self, edits: impl Iterator<Item = (String, Option<i32>, Vec<Value>)>) -> Value {
        if self.client.versioned_edits {
            let changes = edits.map(
                |(uri, version, edits)| json!({ "textDocument": { "uri": uri, "version": version }, "edits": edits }),
            );
            return json!({ "documentChanges": changes.collect::<Value>() });
        }
        let changes: Map<String, Value> = edits.map(|(uri, _, edits)| (uri, Value::Array(edits))).collect();
        json!({ "changes": changes })
    }

    /// Lists the predicates and types of the workspace whose names contain the letters of the query in their order.
    pub(super) fn workspace_symbols(&self, query: &str, request: &Request<'_>) -> Result<Value, Refusal> {
        let programs = self.programs(&[], request)?;
        let mut found = Vec::new();
        for file in &programs.files {
            let Some(uri) = self.uri_of(&file.path) else { continue };
            for one in file.names.iter().filter(|one| one.declares()) {
                let name = one.meaning.name();
                if let Some(rank) = rank(query, name) {
                    found.push((rank, name.to_owned(), uri.clone(), &file.text, one));
                }
            }
        }
        found.sort_by(|one, other| {
            let key = |(rank, name, uri, _, one): &(usize, String, String, _, &Occurrence)| {
                (*rank, name.clone(), uri.clone(), one.span.start)
            };
            key(one).cmp(&key(other))
        });
        let shown = found.into_iter().take(SYMBOLS_MAX).map(|(_, name, uri, text, one)| {
            let kind = match one.meaning {
                Meaning::Type(_) => SymbolKind::CLASS,
                Meaning::Branch(_) => SymbolKind::ENUM_MEMBER,
                _ => SymbolKind::FUNCTION,
            };
            json!({ "name": name, "kind": kind, "location": { "uri": uri, "range": text.range_of(one.span) } })
        });
        Ok(shown.collect())
    }

    /// Returns the document, the byte of a position in it, and the name there.
    fn named(&self, at: &TextDocumentPositionParams) -> Result<Named<'_>, Refusal> {
        let document = self.document(at.text_document.uri.as_str())?;
        let byte = document.text.byte(at.position);
        Ok((document, byte, document.analysis.at(byte)))
    }
}

/// An open document, a byte of it, and the name there.
type Named<'d> = (&'d Document, usize, Option<&'d Occurrence>);

/// The path of a file and its edits.
type FileEdits = (std::path::PathBuf, Vec<Value>);

fn refuse<T>(message: String) -> Result<T, Refusal> {
    Err((ErrorCode::RequestFailed, message))
}

/// Returns the files in which a name means the same as in a document.
fn sharing(
    programs: &Programs,
    document: &Document,
    meaning: &Meaning,
    request: &Request<'_>,
) -> Result<Vec<usize>, Refusal> {
    let Some(own) = programs.find(&document.path) else {
        return Ok(Vec::new());
    };
    let found = programs.sharing(own, meaning, &|| request.is_cancelled());
    found.map_err(|search::Cancelled| cancelled())
}

fn is_base_type(meaning: &Meaning) -> bool {
    matches!(meaning, Meaning::Type(name) if BaseType::ALL.iter().any(|base| base.name() == name))
}

/// Returns how well a name fits a query, best first; `None` if it lacks a letter.
fn rank(query: &str, name: &str) -> Option<usize> {
    let (query, name) = (query.to_lowercase(), name.to_lowercase());
    if name.starts_with(&query) {
        return Some(usize::from(name != query));
    }
    if name.contains(&query) {
        return Some(2);
    }
    let mut letters = name.chars();
    query
        .chars()
        .all(|wanted| letters.any(|letter| letter == wanted))
        .then_some(3)
}

/// Returns the declaration, followed by its doc comment.
fn described(analysis: &Analysis, meaning: &Meaning) -> Option<String> {
    let (declaration, doc) = analysis.described(meaning)?;
    let mut text = format!("```prolog\n{declaration}\n```\n");
    if !doc.is_empty() {
        text += &format!("\n{doc}\n");
    }
    let declared: Option<Span> = analysis.declaration(analysis.entry, meaning);
    if let Some(span) = declared.filter(|span| span.source != analysis.entry) {
        text += &format!("\n`{}`\n", analysis.sources.name(span.source));
    }
    Some(text)
}
