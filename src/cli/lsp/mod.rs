//! `logicity lsp`: runs a language server.
//!
//! An editor sends its open texts and queries positions in them. After every change the server
//! checks all open texts and their includes again. An open text takes precedence over the file on disk.

mod analysis;
mod builtin;
mod place;
mod transport;
mod words;

use crate::builtin::BuiltinFiles;
use crate::cli::Failure;
use crate::datalog;
use crate::datalog::{DIRECTIVES, ast};
use crate::diag::{Diagnostic, Fix, Label, Severity, SourceId, Sources, Span};
use crate::files::{ReadError, ReadFile, normalize};
use analysis::{Analysis, Meaning};
use lsp_server::{Connection, ErrorCode, Message, Notification, ProtocolError, Request, Response};
use lsp_types::{
    CodeActionParams, CompletionItem, CompletionItemKind, CompletionParams, DiagnosticSeverity,
    DidChangeTextDocumentParams, DidCloseTextDocumentParams, DidOpenTextDocumentParams, DocumentFormattingParams,
    DocumentSymbolParams, Documentation, GotoDefinitionParams, HoverParams, MarkupContent, MarkupKind, MessageType,
    Position, ReferenceParams, RenameParams, SymbolKind, TextDocumentPositionParams,
};
use place::{Lines, path_of, uri_of};
use serde::de::DeserializeOwned;
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use words::Word;

#[derive(clap::Args)]
pub struct Arguments {
    /// Communicate over standard input and output; this is the only transport
    #[arg(long)]
    stdio: bool,
}

pub fn run(_: &Arguments) -> Result<(), Failure> {
    let fail = |error: ProtocolError| Failure::Usage(format!("the editor violated the protocol: {error}"));
    let (connection, transport) = transport::start();
    let served = serve(&connection).map_err(fail);
    // The writer thread ends when no sender is left.
    drop(connection);
    // A failed connection also breaks the protocol; its cause says more.
    transport
        .finish()
        .map_err(|error| Failure::Usage(format!("the connection failed: {error}")))?;
    served
}

/// Serves one editor until it shuts down the server or disconnects.
fn serve(connection: &Connection) -> Result<(), ProtocolError> {
    let (id, _) = connection.initialize_start()?;
    let capabilities = json!({
        "positionEncoding": "utf-16",
        "textDocumentSync": { "openClose": true, "change": 1 },
        "hoverProvider": true,
        "definitionProvider": true,
        "referencesProvider": true,
        "documentSymbolProvider": true,
        "documentFormattingProvider": true,
        "completionProvider": { "triggerCharacters": ["."] },
        "renameProvider": { "prepareProvider": true },
        "codeActionProvider": { "codeActionKinds": ["quickfix"] },
    });
    let server = json!({ "name": "logicity", "version": env!("CARGO_PKG_VERSION") });
    connection.initialize_finish(id, json!({ "capabilities": capabilities, "serverInfo": server }))?;
    let mut server = Server::default();
    for message in &connection.receiver {
        let replies = match message {
            Message::Request(request) => {
                if connection.handle_shutdown(&request)? {
                    return Ok(());
                }
                vec![Message::Response(server.answer(request))]
            }
            Message::Notification(notification) => server.note(notification),
            // The server sends no requests, so it expects no responses.
            Message::Response(_) => Vec::new(),
        };
        for reply in replies {
            if connection.sender.send(reply).is_err() {
                return Ok(());
            }
        }
    }
    Ok(())
}

/// An open text.
struct Document {
    uri: String,
    text: String,
    version: i32,
    analysis: Analysis,
}

/// Reads open documents from the editor, other files from disk.
struct OpenDocuments<'a>(&'a BTreeMap<PathBuf, Document>);

impl ReadFile for OpenDocuments<'_> {
    fn read(&self, path: &Path) -> Result<String, ReadError> {
        match self.0.get(&normalize(path)) {
            Some(document) => Ok(document.text.clone()),
            None => BuiltinFiles.read(path),
        }
    }

    fn builtin_paths(&self) -> Vec<String> {
        BuiltinFiles.builtin_paths()
    }
}

#[derive(Default)]
struct Server {
    /// Keyed by normalized path.
    documents: BTreeMap<PathBuf, Document>,
}

/// The error code of the protocol and a message for the user.
type Refusal = (ErrorCode, String);

impl Server {
    // --- texts

    /// Handles a notification. The protocol has no answer to a malformed one, so the server writes it to the editor's
    /// log.
    fn note(&mut self, Notification { method, params }: Notification) -> Vec<Message> {
        let done = match method.as_str() {
            "textDocument/didOpen" => serde_json::from_value(params)
                .map(|DidOpenTextDocumentParams { text_document: it }| self.set(it.uri.as_str(), it.text, it.version)),
            "textDocument/didChange" => serde_json::from_value(params).map(|it: DidChangeTextDocumentParams| {
                // Full synchronization: each change is the whole text, so the last one counts.
                match it.content_changes.into_iter().next_back() {
                    Some(change) => self.set(it.text_document.uri.as_str(), change.text, it.text_document.version),
                    None => Vec::new(),
                }
            }),
            "textDocument/didClose" => {
                serde_json::from_value(params).map(|DidCloseTextDocumentParams { text_document }| {
                    self.documents.remove(&key(text_document.uri.as_str()));
                    let mut messages = self.check();
                    messages.push(published(text_document.uri.as_str(), None, Vec::new()));
                    messages
                })
            }
            "textDocument/didSave" | "workspace/didChangeWatchedFiles" => Ok(self.check()),
            _ => Ok(Vec::new()),
        };
        done.unwrap_or_else(|error| {
            let message = format!("cannot parse `{method}`: {error}");
            let params = json!({ "type": MessageType::ERROR, "message": message });
            vec![Message::Notification(Notification::new(
                "window/logMessage".to_owned(),
                params,
            ))]
        })
    }

    fn set(&mut self, uri: &str, text: String, version: i32) -> Vec<Message> {
        let document = Document {
            uri: uri.to_owned(),
            analysis: Analysis::new(&key(uri), "", &BuiltinFiles),
            text,
            version,
        };
        self.documents.insert(key(uri), document);
        self.check()
    }

    /// Checks all open texts, which may include each other, and returns their diagnostics as messages.
    fn check(&mut self) -> Vec<Message> {
        let read: &dyn ReadFile = &OpenDocuments(&self.documents);
        let analyses: Vec<Analysis> = (self.documents.iter())
            .map(|(path, document)| Analysis::new(path, &document.text, read))
            .collect();
        for (document, analysis) in self.documents.values_mut().zip(analyses) {
            document.analysis = analysis;
        }
        let messages = self.documents.values().map(|document| {
            let found = self.diagnostics(document);
            published(&document.uri, Some(document.version), found)
        });
        messages.collect()
    }

    // --- diagnostics

    fn diagnostics(&self, document: &Document) -> Vec<Value> {
        let Analysis { diagnostics, hints, .. } = &document.analysis;
        let severe = diagnostics
            .iter()
            .map(|fault| self.diagnostic(document, fault, severity_of(fault)));
        let hints = hints
            .iter()
            .map(|lint| self.diagnostic(document, lint, DiagnosticSeverity::INFORMATION));
        severe.chain(hints).collect()
    }

    /// Converts a diagnostic. One in an included file appears at the include.
    fn diagnostic(&self, document: &Document, fault: &Diagnostic, severity: DiagnosticSeverity) -> Value {
        let Analysis { sources, entry, .. } = &document.analysis;
        let lines = Lines::of(sources, *entry);
        let primary = fault.primary.as_ref();
        let elsewhere = primary.filter(|label| label.span.source != *entry);
        let span = match (primary, elsewhere) {
            (_, Some(label)) => document.analysis.include_of(label.span.source),
            (Some(label), None) => Some(label.span),
            (None, None) => None,
        };
        let mut message = match elsewhere {
            Some(label) => format!("{}: {}", sources.locate(label.span), fault.message),
            None => fault.message.clone(),
        };
        if let Some(label) = primary.filter(|label| !label.message.is_empty()) {
            message += &format!(": {}", label.message);
        }
        let notes = fault.notes.iter().map(|note| format!("\nnote: {note}"));
        let help = fault.help.iter().map(|help| format!("\nhelp: {help}"));
        message.extend(notes.chain(help));
        let related: Vec<Value> = (elsewhere.into_iter().chain(&fault.secondary))
            .filter_map(|Label { span, message }| {
                let message = if message.is_empty() { &fault.message } else { message };
                Some(json!({ "location": self.location(sources, *span)?, "message": message }))
            })
            .collect();
        json!({
            "range": span.map_or(lines.range(Span::new(*entry, 0..0)), |span| lines.range(span)),
            "severity": severity,
            "code": fault.code.name(),
            "source": "logicity",
            "message": message,
            "relatedInformation": related,
        })
    }

    /// Returns the location of a span, or `None` for a built-in file.
    fn location(&self, sources: &Sources, span: Span) -> Option<Value> {
        let uri = self.uri(sources, span.source)?;
        Some(json!({ "uri": uri, "range": Lines::of(sources, span.source).range(span) }))
    }

    /// Returns the URI of a text: the editor's own if the text is open.
    fn uri(&self, sources: &Sources, id: SourceId) -> Option<String> {
        let path = normalize(Path::new(sources.name(id)));
        match self.documents.get(&path) {
            Some(document) => Some(document.uri.clone()),
            None => uri_of(&path),
        }
    }

    // --- requests

    fn answer(&self, request: Request) -> Response {
        let Request { id, method, params } = request;
        let answer = match method.as_str() {
            "textDocument/hover" => {
                read(params).and_then(|params: HoverParams| self.hover(&params.text_document_position_params))
            }
            "textDocument/definition" => read(params)
                .and_then(|params: GotoDefinitionParams| self.definition(&params.text_document_position_params)),
            "textDocument/references" => read(params).and_then(|params: ReferenceParams| {
                let declared = params.context.include_declaration;
                self.references(&params.text_document_position, declared)
            }),
            "textDocument/documentSymbol" => {
                read(params).and_then(|params: DocumentSymbolParams| self.symbols(params.text_document.uri.as_str()))
            }
            "textDocument/formatting" => {
                read(params).and_then(|params: DocumentFormattingParams| self.format(params.text_document.uri.as_str()))
            }
            "textDocument/completion" => {
                read(params).and_then(|params: CompletionParams| self.complete(&params.text_document_position))
            }
            "textDocument/prepareRename" => {
                read(params).and_then(|params: TextDocumentPositionParams| self.prepare_rename(&params))
            }
            "textDocument/rename" => read(params).and_then(|params: RenameParams| self.rename(&params)),
            "textDocument/codeAction" => read(params).and_then(|params: CodeActionParams| self.code_actions(&params)),
            other => Err((ErrorCode::MethodNotFound, format!("`{other}` is not supported"))),
        };
        match answer {
            Ok(value) => Response::new_ok(id, value),
            Err((code, message)) => Response::new_err(id, code as i32, message),
        }
    }

    fn document(&self, uri: &str) -> Result<&Document, Refusal> {
        let document = self.documents.get(&key(uri));
        document.ok_or_else(|| (ErrorCode::InvalidParams, format!("`{uri}` is not open")))
    }

    /// Returns the document, and the name at a position in it with its meaning.
    fn named(&self, at: &TextDocumentPositionParams) -> Result<Named<'_>, Refusal> {
        let document = self.document(at.text_document.uri.as_str())?;
        let byte = Lines::new(&document.text).byte(at.position);
        let found = document.analysis.at(byte);
        Ok((document, found.map(|one| (one.span, &one.meaning))))
    }

    fn hover(&self, at: &TextDocumentPositionParams) -> Result<Value, Refusal> {
        let (document, found) = self.named(at)?;
        let Some((span, meaning)) = found else {
            return Ok(hover_word(document, at.position).unwrap_or(Value::Null));
        };
        let Analysis { sources, entry, .. } = &document.analysis;
        let text = match meaning {
            Meaning::Include(Some(target)) => format!("`{}`", sources.name(*target)),
            _ => match described(&document.analysis, meaning) {
                Some(text) => text,
                None => return Ok(Value::Null),
            },
        };
        Ok(json!({ "contents": markdown(text), "range": Lines::of(sources, *entry).range(span) }))
    }

    /// Returns the place of a declaration. An editor can open built-in files only as copies on the disk.
    fn definition(&self, at: &TextDocumentPositionParams) -> Result<Value, Refusal> {
        let (document, Some((_, meaning))) = self.named(at)? else {
            return Ok(Value::Null);
        };
        let Analysis { sources, .. } = &document.analysis;
        let place = document.analysis.declaration(meaning).and_then(|span| {
            self.location(sources, span).or_else(|| {
                let copy = builtin::copy(Path::new(sources.name(span.source)), sources.text(span.source))?;
                Some(json!({ "uri": uri_of(&copy)?, "range": Lines::of(sources, span.source).range(span) }))
            })
        });
        Ok(place.unwrap_or(Value::Null))
    }

    /// Returns the open texts in which a name has the same meaning: both declare it in the same place, or one of them
    /// has no location for the declaration.
    fn sharing<'d>(&'d self, document: &'d Document, meaning: &'d Meaning) -> impl Iterator<Item = &'d Document> {
        let declared = |one: &Document| {
            let span = one.analysis.declaration(meaning)?;
            Some(self.location(&one.analysis.sources, span))
        };
        let here = declared(document);
        (self.documents.values()).filter(move |one| match (&here, declared(one)) {
            (Some(here), Some(there)) => *here == there,
            _ => true,
        })
    }

    /// Returns all occurrences of a name, by URI, in the open texts that share it and in their includes. Also returns
    /// whether built-in files use it.
    fn places(
        &self,
        document: &Document,
        meaning: &Meaning,
        declared: bool,
    ) -> (BTreeMap<String, BTreeSet<Place>>, bool) {
        let mut places: BTreeMap<String, BTreeSet<Place>> = BTreeMap::new();
        let mut builtin = false;
        // A variable belongs to a clause of one text.
        let is_variable = matches!(meaning, Meaning::Variable(..));
        let sharing = self.sharing(document, meaning);
        let own = |one: &&Document| !is_variable || std::ptr::eq(*one, document);
        for document in sharing.filter(own) {
            let sources = &document.analysis.sources;
            let named = document
                .analysis
                .occurrences
                .iter()
                .filter(|one| one.meaning == *meaning);
            for one in named.filter(|one| declared || !one.declares) {
                let Some(uri) = self.uri(sources, one.span.source) else {
                    builtin = true;
                    continue;
                };
                let range = Lines::of(sources, one.span.source).range(one.span);
                let place = [range.start, range.end].map(|position| (position.line, position.character));
                places.entry(uri).or_default().insert(place);
            }
        }
        (places, builtin)
    }

    fn references(&self, at: &TextDocumentPositionParams, declared: bool) -> Result<Value, Refusal> {
        let (document, Some((_, meaning))) = self.named(at)? else {
            return Ok(Value::Null);
        };
        if matches!(meaning, Meaning::Include(_)) {
            return Ok(Value::Null);
        }
        let (places, _) = self.places(document, meaning, declared);
        let places = places
            .iter()
            .flat_map(|(uri, ranges)| ranges.iter().map(move |range| (uri, range)));
        Ok(places
            .map(|(uri, range)| json!({ "uri": uri, "range": range_json(range) }))
            .collect())
    }

    fn prepare_rename(&self, at: &TextDocumentPositionParams) -> Result<Value, Refusal> {
        let (document, found) = self.named(at)?;
        let Some((span, Meaning::Predicate(_) | Meaning::Type(_) | Meaning::Variable(..))) = found else {
            return Ok(Value::Null);
        };
        Ok(json!(Lines::new(&document.text).range(span)))
    }

    fn rename(&self, params: &RenameParams) -> Result<Value, Refusal> {
        let refuse = |message: String| Err((ErrorCode::RequestFailed, message));
        let (document, found) = self.named(&params.text_document_position)?;
        let Some((_, meaning @ (Meaning::Predicate(_) | Meaning::Type(_) | Meaning::Variable(..)))) = found else {
            return refuse("only predicates, types and variables can be renamed".to_owned());
        };
        if !datalog::is_name(&params.new_name) {
            return refuse(format!("`{}` is not a name", params.new_name));
        }
        if let Meaning::Variable(clause, _) = meaning {
            let new = Meaning::Variable(*clause, params.new_name.clone());
            if document.analysis.occurrences.iter().any(|one| one.meaning == new) {
                return refuse(format!("`{}` is already a variable of this clause", params.new_name));
            }
            if words::find(&params.new_name, false).is_some() {
                return refuse(format!("`{}` is a word of the language", params.new_name));
            }
            let (places, _) = self.places(document, meaning, true);
            return Ok(renamed(places, &params.new_name));
        }
        // Predicates and types share a namespace.
        let new = [Meaning::Predicate, Meaning::Type].map(|kind| kind(params.new_name.clone()));
        let is_taken = |one: &Document| new.iter().any(|new| one.analysis.declaration(new).is_some());
        let is_base = datalog::BaseType::ALL.iter().any(|base| base.name() == params.new_name);
        if is_base || self.sharing(document, meaning).any(is_taken) {
            return refuse(format!("`{}` is already declared", params.new_name));
        }
        let (places, builtin) = self.places(document, meaning, true);
        if builtin || document.analysis.declaration(meaning).is_none() {
            return refuse("a read-only file declares the name".to_owned());
        }
        Ok(renamed(places, &params.new_name))
    }

    /// Returns the fixes of the diagnostics in a range as quick fixes.
    fn code_actions(&self, params: &CodeActionParams) -> Result<Value, Refusal> {
        let document = self.document(params.text_document.uri.as_str())?;
        let Analysis { diagnostics, hints, .. } = &document.analysis;
        let own_lines = Lines::new(&document.text);
        let asked = own_lines.byte(params.range.start)..own_lines.byte(params.range.end);
        let mut actions = Vec::new();
        let severities = [None, Some(DiagnosticSeverity::INFORMATION)];
        for (faults, severity) in [diagnostics, hints].into_iter().zip(severities) {
            for fault in faults {
                let severity = severity.unwrap_or(severity_of(fault));
                let shown = self.diagnostic(document, fault, severity);
                let range: lsp_types::Range = serde_json::from_value(shown["range"].clone()).expect("made from one");
                let place = own_lines.byte(range.start)..own_lines.byte(range.end);
                if place.end < asked.start || asked.end < place.start {
                    continue;
                }
                let fixes = fault.fixes.iter().cloned();
                for fix in fixes.chain(document.analysis.include_vocabulary(fault)) {
                    if let Some(changes) = self.changes(&document.analysis.sources, &fix) {
                        actions.push(json!({
                            "title": fix.title,
                            "kind": "quickfix",
                            "diagnostics": [shown.clone()],
                            "edit": { "changes": changes },
                        }));
                    }
                }
            }
        }
        Ok(Value::Array(actions))
    }

    /// Returns the edits of a fix by URI; `None` if one is in a built-in file.
    fn changes(&self, sources: &Sources, fix: &Fix) -> Option<serde_json::Map<String, Value>> {
        let mut changes: BTreeMap<String, Vec<Value>> = BTreeMap::new();
        for (span, text) in &fix.edits {
            let uri = self.uri(sources, span.source)?;
            let span = if text.is_empty() {
                whole_lines(sources, *span)
            } else {
                *span
            };
            let range = Lines::of(sources, span.source).range(span);
            changes
                .entry(uri)
                .or_default()
                .push(json!({ "range": range, "newText": text }));
        }
        Some(
            changes
                .into_iter()
                .map(|(uri, edits)| (uri, Value::Array(edits)))
                .collect(),
        )
    }

    /// Lists declarations, types and clauses in source order.
    fn symbols(&self, uri: &str) -> Result<Value, Refusal> {
        let document = self.document(uri)?;
        let lines = Lines::new(&document.text);
        let symbol = |name: &str, detail: &str, kind: SymbolKind, whole: Span, name_span: Span| {
            json!({
                "name": name, "detail": detail, "kind": kind,
                "range": lines.range(whole), "selectionRange": lines.range(name_span),
            })
        };
        let title = |doc: &str| doc.lines().next().unwrap_or_default().to_owned();
        let mut symbols = Vec::new();
        let own = document
            .analysis
            .files
            .iter()
            .filter(|(id, _)| *id == document.analysis.entry);
        for item in own.flat_map(|(_, file)| &file.items) {
            match item {
                ast::Item::Decl(decl) => symbols.extend(decl.names.iter().map(|name| {
                    let span = name.place.0;
                    symbol(&name.text, &title(&decl.doc), SymbolKind::FUNCTION, span, span)
                })),
                ast::Item::Type(decl) => {
                    let span = decl.name.place.0;
                    symbols.push(symbol(
                        &decl.name.text,
                        &title(&decl.doc),
                        SymbolKind::CLASS,
                        span,
                        span,
                    ));
                }
                ast::Item::Clause(clause) => symbols.extend(clause.heads.iter().take(1).map(|head| {
                    let name = document.analysis.sources.slice(head.place.0);
                    symbol(
                        name,
                        &title(&clause.doc),
                        SymbolKind::EVENT,
                        clause.place.0,
                        head.place.0,
                    )
                })),
                _ => {}
            }
        }
        Ok(Value::Array(symbols))
    }

    /// Returns `null` for a text with syntax errors, which its diagnostics report.
    fn format(&self, uri: &str) -> Result<Value, Refusal> {
        let document = self.document(uri)?;
        let Analysis { sources, entry, .. } = &document.analysis;
        Ok(match datalog::format(sources, *entry) {
            Ok(formatted) if formatted != document.text => {
                json!([{ "range": Lines::new(&document.text).whole(), "newText": formatted }])
            }
            Ok(_) => json!([]),
            Err(_) => Value::Null,
        })
    }

    /// Completes directives at the start of a line, files in an include, types after a colon, else predicates and, in
    /// bodies, words of the language.
    fn complete(&self, at: &TextDocumentPositionParams) -> Result<Value, Refusal> {
        let document = self.document(at.text_document.uri.as_str())?;
        let lines = Lines::new(&document.text);
        let start = lines.byte(Position::new(at.position.line, 0));
        let line = &document.text[start..lines.byte(at.position)];
        let before = line.trim_end_matches(|c: char| c.is_ascii_alphanumeric() || c == '_' || c == '?');
        let before = before.trim();
        let item = |name: &str, kind: CompletionItemKind| {
            let analysis = &document.analysis;
            let meaning = match kind {
                CompletionItemKind::CLASS => Meaning::Type(name.to_owned()),
                _ => Meaning::Predicate(name.to_owned()),
            };
            let (detail, doc) = analysis.described(&meaning).unzip();
            let doc = doc.filter(|doc| !doc.is_empty());
            CompletionItem {
                label: name.to_owned(),
                kind: Some(kind),
                detail,
                documentation: doc.map(|doc| Documentation::MarkupContent(markdown(doc))),
                ..CompletionItem::default()
            }
        };
        let keyword = |word: &Word, label: String| CompletionItem {
            label,
            kind: Some(CompletionItemKind::KEYWORD),
            detail: Some(word.form.to_owned()),
            documentation: Some(Documentation::MarkupContent(markdown(word.meaning.to_owned()))),
            ..CompletionItem::default()
        };
        let directives = |dot: &'static str| {
            let words = DIRECTIVES.iter().filter_map(|name| words::find(name, true));
            words.map(move |word| keyword(word, format!("{dot}{}", word.name)))
        };
        if before == "." {
            return Ok(json!(directives("").collect::<Vec<_>>()));
        }
        if before.starts_with(".include") && before.contains('"') {
            let known = BuiltinFiles.builtin_paths();
            let names = known.iter().filter_map(|path| path.strip_prefix("rules/"));
            let file = |name: &str| CompletionItem {
                label: name.to_owned(),
                kind: Some(CompletionItemKind::FILE),
                ..CompletionItem::default()
            };
            return Ok(json!(names.map(file).collect::<Vec<_>>()));
        }
        let of_types = (before.starts_with(".decl") && before.ends_with(':'))
            || (before.starts_with(".type") && before.ends_with([':', '=', '|']));
        let mut items = Vec::new();
        if of_types {
            items.extend(datalog::BaseType::ALL.map(|base| item(base.name(), CompletionItemKind::CLASS)));
        }
        let mut seen = BTreeSet::new();
        for meaning in document.analysis.declared() {
            match meaning {
                Meaning::Type(name) if of_types && seen.insert(name) => {
                    items.push(item(name, CompletionItemKind::CLASS))
                }
                Meaning::Predicate(name) if !of_types && seen.insert(name) => {
                    items.push(item(name, CompletionItemKind::FUNCTION));
                }
                _ => {}
            }
        }
        let in_clause = !before.starts_with('.') && document.analysis.in_body(start + line.len());
        if in_clause {
            let words = words::WORDS.iter();
            let words = words.filter(|word| matches!(word.place, words::Place::Body | words::Place::Operator));
            items.extend(words.map(|word| keyword(word, word.name.to_owned())));
        } else if before.is_empty() {
            items.extend(directives("."));
        }
        Ok(json!(items))
    }
}

fn severity_of(fault: &Diagnostic) -> DiagnosticSeverity {
    match fault.severity() {
        Severity::Error => DiagnosticSeverity::ERROR,
        Severity::Warning => DiagnosticSeverity::WARNING,
    }
}

/// Returns the description of the word of the language at a position.
fn hover_word(document: &Document, position: Position) -> Option<Value> {
    let text = document.text.as_str();
    let lines = Lines::new(text);
    let at = lines.byte(position);
    let is_part = |c: char| c.is_ascii_alphanumeric() || c == '_';
    let start = at - text[..at].chars().rev().take_while(|c| is_part(*c)).count();
    let end = at + text[at..].chars().take_while(|c| is_part(*c)).count();
    // A position past the end of the text maps to that end.
    let line = lines.byte(Position::new(position.line, 0)).min(start);
    let directive = text[line..start].trim_start() == ".";
    // Not in comments and strings.
    let before = &text[line..start];
    if before.contains("//") || before.matches('"').count() % 2 == 1 {
        return None;
    }
    let word = words::find(&text[start..end], directive)?;
    let shown = format!("```prolog\n{}\n```\n\n{}\n", word.form, word.meaning);
    let span = Span::new(document.analysis.entry, start - usize::from(directive)..end);
    Some(json!({ "contents": markdown(shown), "range": lines.range(span) }))
}

/// Returns the edits that write a new name in all places.
fn renamed(places: BTreeMap<String, BTreeSet<Place>>, name: &str) -> Value {
    let changes = places.into_iter().map(|(uri, ranges)| {
        let edits = ranges
            .iter()
            .map(|range| json!({ "range": range_json(range), "newText": name }));
        (uri, edits.collect::<Value>())
    });
    json!({ "changes": changes.collect::<serde_json::Map<_, _>>() })
}

/// Extends a span that is alone on its lines to whole lines.
fn whole_lines(sources: &Sources, span: Span) -> Span {
    let text = sources.text(span.source);
    let bytes = span.range();
    let (before, after) = (&text[..bytes.start], &text[bytes.end..]);
    let start = before.rfind('\n').map_or(0, |newline| newline + 1);
    let rest = after.find('\n').map_or(after.len(), |newline| newline + 1);
    let is_alone = before[start..].trim().is_empty() && after[..rest].trim().is_empty();
    match is_alone {
        true => Span::new(span.source, start..bytes.end + rest),
        false => span,
    }
}

/// An open text, and a name in it with its span.
type Named<'d> = (&'d Document, Option<(Span, &'d Meaning)>);

/// The first and last position of a range as (line, column), which makes ranges sortable.
type Place = [(u32, u32); 2];

fn range_json(place: &Place) -> Value {
    let [start, end] = place.map(|(line, column)| Position::new(line, column));
    json!({ "start": start, "end": end })
}

/// Returns the key of a document in the table of open ones.
fn key(uri: &str) -> PathBuf {
    normalize(&path_of(uri))
}

fn read<T: DeserializeOwned>(params: Value) -> Result<T, Refusal> {
    serde_json::from_value(params).map_err(|error| (ErrorCode::InvalidParams, error.to_string()))
}

fn markdown(value: String) -> MarkupContent {
    MarkupContent {
        kind: MarkupKind::Markdown,
        value,
    }
}

/// Returns the declaration, followed by its doc comment.
fn described(analysis: &Analysis, meaning: &Meaning) -> Option<String> {
    let (declaration, doc) = analysis.described(meaning)?;
    let mut text = format!("```prolog\n{declaration}\n```\n");
    if !doc.is_empty() {
        text += &format!("\n{doc}\n");
    }
    if let Some(span) = analysis.declaration(meaning)
        && span.source != analysis.entry
    {
        text += &format!("\n`{}`\n", analysis.sources.name(span.source));
    }
    Some(text)
}

fn published(uri: &str, version: Option<i32>, diagnostics: Vec<Value>) -> Message {
    let params = json!({ "uri": uri, "version": version, "diagnostics": diagnostics });
    Message::Notification(Notification::new("textDocument/publishDiagnostics".to_owned(), params))
}
