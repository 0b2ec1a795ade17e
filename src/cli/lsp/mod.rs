//! `logicity lsp`: runs a language server.
//!
//! An editor sends its open texts with their changes, and queries positions in them. When no message waits, the server
//! checks the changed texts and those that include them. An open text takes precedence over the file on disk. When a
//! text is saved, a thread also searches for conflicts between its actions.

mod analysis;
mod builtin;
mod city;
mod client;
mod complete;
mod navigate;
mod outline;
mod place;
mod search;
mod signature;
mod tokens;
mod transport;
mod words;

use crate::builtin::BuiltinFiles;
use crate::cli::failure::Failure;
use crate::cli::limits::MemoryOption;
use crate::config::ActionsConfig;
use crate::datalog;
use crate::datalog::Rules;
use crate::diag::{Diagnostic, Fix, Label, Severity, SourceId, Sources, Span};
use crate::files::{ReadError, ReadFile, builtin_path, normalize};
use crate::sim::{conflict_lints, conflicts};
use analysis::Analysis;
use client::Client;
use lsp_server::{Connection, ErrorCode, Message, Notification, RequestId, Response};
use lsp_types::{
    CodeActionParams, CompletionParams, DiagnosticSeverity, DidChangeTextDocumentParams, DidCloseTextDocumentParams,
    DidOpenTextDocumentParams, DidSaveTextDocumentParams, DocumentFormattingParams, DocumentHighlightParams,
    DocumentSymbolParams, FoldingRangeParams, GotoDefinitionParams, HoverParams, MarkupContent, MarkupKind,
    MessageType, ReferenceParams, RenameParams, SemanticTokensDeltaParams, SemanticTokensParams,
    SemanticTokensRangeParams, SignatureHelpParams, TextDocumentPositionParams, WorkspaceSymbolParams,
};
use place::{Text, path_of, uri_of};
use search::{EditorWorkspace, Programs};
use serde::de::DeserializeOwned;
use serde_json::{Value, json};
use std::cell::RefCell;
use std::collections::{BTreeMap, VecDeque};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::thread;
use std::thread::JoinHandle;
use std::time::Duration;

#[derive(clap::Args)]
pub struct Arguments {
    /// Communicate over standard input and output; this is the only transport
    #[arg(long)]
    stdio: bool,
    #[command(flatten)]
    _memory: MemoryOption,
}

pub fn run(_: &Arguments) -> Result<(), Failure> {
    let (connection, transport) = transport::start();
    let served = serve(&connection);
    // The writer thread ends when no sender is left.
    drop(connection);
    // A failed connection also breaks the protocol; its cause says more.
    transport
        .finish()
        .map_err(|error| Failure::Usage(format!("the connection failed: {error}")))?;
    served
}

/// The maximum number of messages that wait for the server. The transport keeps further ones from the client.
const WAITING_MAX: usize = 64;

/// The time between two looks at a search that runs.
const POLL: Duration = Duration::from_millis(10);

/// The phase of the life of a server.
enum Phase {
    /// Before `initialize`.
    New,
    Running(Server),
    /// After `shutdown`.
    Down,
}

/// Serves one editor until it ends the server or disconnects.
fn serve(connection: &Connection) -> Result<(), Failure> {
    let incoming = Incoming {
        connection,
        waiting: RefCell::default(),
    };
    let mut phase = Phase::New;
    loop {
        let message = match &mut phase {
            Phase::Running(server) => incoming.next(server),
            Phase::New | Phase::Down => incoming.wait(),
        };
        let Some(message) = message else {
            return match phase {
                Phase::New => Err(Failure::Usage("the editor disconnected before `initialize`".to_owned())),
                Phase::Running(_) | Phase::Down => Ok(()),
            };
        };
        let replies = match (message, &mut phase) {
            (Message::Notification(note), Phase::Down) if note.method == "exit" => return Ok(()),
            // Without `shutdown` before it, this is a fault of the editor.
            (Message::Notification(note), _) if note.method == "exit" => return Err(Failure::Reported),
            (Message::Notification(note), Phase::Running(server)) => server.note(note),
            (Message::Request(request), Phase::New) if request.method == "initialize" => {
                let server = Server::new(&request.params);
                let welcome = Response::new_ok(request.id, server.client.welcome());
                phase = Phase::Running(server);
                vec![Message::Response(welcome)]
            }
            (Message::Request(request), Phase::Running(server)) if request.method == "shutdown" => {
                let mut replies = server.settle();
                replies.push(Message::Response(Response::new_ok(request.id, Value::Null)));
                phase = Phase::Down;
                replies
            }
            (Message::Request(request), Phase::Running(server)) => {
                let mut replies = server.settle();
                replies.extend(server.respond(request, &incoming));
                replies
            }
            (Message::Request(request), Phase::New) => {
                let message = "the first request is `initialize`".to_owned();
                let code = ErrorCode::ServerNotInitialized as i32;
                vec![Message::Response(Response::new_err(request.id, code, message))]
            }
            (Message::Request(request), Phase::Down) => {
                let message = "the server has shut down".to_owned();
                let code = ErrorCode::InvalidRequest as i32;
                vec![Message::Response(Response::new_err(request.id, code, message))]
            }
            // The server needs no answers: it only asks the client to watch files.
            (Message::Response(_), _) | (Message::Notification(_), Phase::New | Phase::Down) => Vec::new(),
        };
        if !incoming.send(replies) {
            return Ok(());
        }
    }
}

/// The messages of the client.
struct Incoming<'c> {
    connection: &'c Connection,
    /// Messages that have arrived.
    waiting: RefCell<VecDeque<Message>>,
}

impl Incoming<'_> {
    /// Sends messages. Returns whether the client is still there.
    fn send(&self, messages: Vec<Message>) -> bool {
        let mut messages = messages.into_iter();
        messages.all(|message| self.connection.sender.send(message).is_ok())
    }

    /// Moves messages that have arrived to `waiting`, so that a request can see whether it is cancelled.
    fn take(&self) {
        let mut waiting = self.waiting.borrow_mut();
        let room = WAITING_MAX.saturating_sub(waiting.len());
        waiting.extend(self.connection.receiver.try_iter().take(room));
    }

    /// Returns the next message, or `None` if the client has disconnected.
    fn wait(&self) -> Option<Message> {
        let waiting = self.waiting.borrow_mut().pop_front();
        waiting.or_else(|| self.connection.receiver.recv().ok())
    }

    /// Returns the next message. Until it arrives, checks the documents and sends their diagnostics.
    fn next(&self, server: &mut Server) -> Option<Message> {
        loop {
            self.take();
            if let Some(message) = self.waiting.borrow_mut().pop_front() {
                return Some(message);
            }
            let mut messages = server.settle();
            messages.extend(server.finish_search());
            if !self.send(messages) {
                return None;
            }
            if server.search.is_none() {
                return self.connection.receiver.recv().ok();
            }
            match self.connection.receiver.recv_timeout(POLL) {
                Ok(message) => return Some(message),
                Err(error) if error.is_timeout() => {}
                Err(_) => return None,
            }
        }
    }

    /// Returns whether the client has cancelled a request.
    fn cancelled(&self, id: &RequestId) -> bool {
        self.take();
        let cancels = |message: &Message| match message {
            Message::Notification(note) if note.method == "$/cancelRequest" => {
                serde_json::from_value(note.params["id"].clone()).is_ok_and(|other: RequestId| other == *id)
            }
            _ => false,
        };
        self.waiting.borrow().iter().any(cancels)
    }
}

/// A request that the server answers.
struct Request<'c> {
    id: &'c RequestId,
    incoming: &'c Incoming<'c>,
}

impl Request<'_> {
    fn is_cancelled(&self) -> bool {
        self.incoming.cancelled(self.id)
    }
}

/// An open document.
struct Document {
    path: PathBuf,
    uri: String,
    text: Text,
    version: i32,
    analysis: Analysis,
    /// Whether the document or an included one has changed since the analysis.
    stale: bool,
    /// Whether the document was saved, so that the client waits for its conflicts.
    saved: bool,
    /// The conflicts between actions when it was saved last.
    conflicts: Vec<Diagnostic>,
    /// The number of the analysis, from 1.
    round: u64,
    /// The last semantic tokens that the client got, with their name.
    tokens: RefCell<(String, Vec<u32>)>,
}

impl Document {
    /// Returns whether the document is a configuration, or a part of one: the server reads it only for rules.
    fn is_configuration(&self) -> bool {
        city::is_configuration(&self.path)
    }
}

/// A search for conflicts between the actions of a document.
struct ConflictSearch {
    path: PathBuf,
    /// The analysis whose rules it searches.
    round: u64,
    thread: JoinHandle<Vec<Diagnostic>>,
}

/// Reads open documents from the editor, other files from disk.
struct OpenDocuments<'a>(&'a BTreeMap<PathBuf, Document>);

impl ReadFile for OpenDocuments<'_> {
    fn read(&self, path: &Path) -> Result<String, ReadError> {
        match self.0.get(&normalize(path)) {
            Some(document) => Ok(document.text.as_str().to_owned()),
            None => BuiltinFiles.read(path),
        }
    }

    fn builtin_paths(&self) -> Vec<String> {
        BuiltinFiles.builtin_paths()
    }

    fn names_in(&self, folder: &Path) -> Vec<String> {
        BuiltinFiles.names_in(folder)
    }
}

struct Server {
    client: Client,
    /// The folders of the workspace.
    folders: Vec<PathBuf>,
    /// Keyed by normalized path.
    documents: BTreeMap<PathBuf, Document>,
    search: Option<ConflictSearch>,
    cities: city::Cities,
}

/// The error code of the protocol and a message for the user.
type Refusal = (ErrorCode, String);

impl Server {
    fn new(params: &Value) -> Server {
        transport::end_with(params["processId"].as_u64());
        Server {
            client: Client::new(params),
            folders: client::folders(params),
            documents: BTreeMap::new(),
            search: None,
            cities: city::Cities::default(),
        }
    }

    // --- documents

    /// Handles a notification. The protocol has no answer to a malformed one, so the server writes it to the editor's
    /// log.
    fn note(&mut self, Notification { method, params }: Notification) -> Vec<Message> {
        let done = match method.as_str() {
            "initialized" if self.client.watches => return vec![watch()],
            "textDocument/didOpen" => noted(params).map(|it: DidOpenTextDocumentParams| {
                let it = it.text_document;
                self.open(it.uri.as_str(), it.text, it.version);
                Vec::new()
            }),
            "textDocument/didChange" => noted(params).and_then(|it| self.change(it)).map(|()| Vec::new()),
            "textDocument/didClose" => noted(params).map(|it: DidCloseTextDocumentParams| {
                let uri = it.text_document.uri.as_str();
                self.documents.remove(&key(uri));
                self.check_again();
                vec![published(uri, None, Vec::new())]
            }),
            "textDocument/didSave" => noted(params).map(|it: DidSaveTextDocumentParams| {
                self.save(&key(it.text_document.uri.as_str()));
                Vec::new()
            }),
            "workspace/didChangeWatchedFiles" => {
                self.check_again();
                Ok(Vec::new())
            }
            "workspace/didChangeWorkspaceFolders" => {
                let list = |name: &str| {
                    params["event"][name]
                        .as_array()
                        .map_or(Vec::new(), |list| client::folders_of(list))
                };
                let removed = list("removed");
                self.folders.retain(|folder| !removed.contains(folder));
                self.folders.extend(list("added"));
                Ok(Vec::new())
            }
            _ => Ok(Vec::new()),
        };
        done.unwrap_or_else(|error| vec![logged(format!("cannot parse `{method}`: {error}"))])
    }

    fn open(&mut self, uri: &str, text: String, version: i32) {
        let path = key(uri);
        let encoding = self.client.encoding;
        let document = Document {
            path: path.clone(),
            uri: uri.to_owned(),
            analysis: Analysis::new(&path, "", &BuiltinFiles, encoding, None),
            text: Text::new(text, encoding),
            version,
            stale: true,
            saved: false,
            conflicts: Vec::new(),
            round: 0,
            tokens: RefCell::default(),
        };
        self.documents.insert(path, document);
        self.check_again();
    }

    /// Applies changes in their order: each to a range of the text that the ones before it leave, or to the whole text.
    fn change(&mut self, params: DidChangeTextDocumentParams) -> Result<(), String> {
        let uri = params.text_document.uri.as_str();
        let path = key(uri);
        let document = self.documents.get_mut(&path);
        let document = document.ok_or_else(|| format!("`{uri}` is not open"))?;
        for change in params.content_changes {
            match change.range {
                None => document.text = Text::new(change.text, self.client.encoding),
                Some(range) => {
                    let [start, end] = [range.start, range.end].map(|position| document.text.byte(position));
                    document.text.replace(start..end, &change.text);
                }
            }
        }
        document.version = params.text_document.version;
        document.stale = true;
        document.saved = false;
        let is_configuration = document.is_configuration();
        for other in self.documents.values_mut() {
            other.stale |= is_configuration || other.analysis.depends_on(&path);
        }
        Ok(())
    }

    /// Requests the conflicts of a document and of those that include it.
    fn save(&mut self, path: &Path) {
        for document in self.documents.values_mut() {
            document.saved |= document.path == path || document.analysis.depends_on(path);
        }
    }

    /// Requests a check of all documents: files may have appeared or changed.
    fn check_again(&mut self) {
        self.documents.values_mut().for_each(|document| document.stale = true);
    }

    /// Checks the changed texts, and returns their diagnostics as messages. Those of saved texts follow with the
    /// conflicts.
    fn settle(&mut self) -> Vec<Message> {
        let read: &dyn ReadFile = &OpenDocuments(&self.documents);
        let open = |path: &Path| self.documents.get(path).map(|document| document.text.as_str());
        self.cities.keep_beside(self.documents.keys().map(PathBuf::as_path));
        let stale = self
            .documents
            .iter()
            .filter(|(_, document)| document.stale && !document.is_configuration());
        let analyses = stale.map(|(path, document)| {
            let city = self.cities.of(path, read, &open);
            let analysis = Analysis::new(
                path,
                document.text.as_str(),
                read,
                self.client.encoding,
                city.as_deref(),
            );
            (path.clone(), analysis)
        });
        let analyses: Vec<(PathBuf, Analysis)> = analyses.collect();
        let mut checked = Vec::new();
        for (path, analysis) in analyses {
            let Some(document) = self.documents.get_mut(&path) else {
                continue;
            };
            document.conflicts = analysis.carry(&document.analysis, &document.conflicts);
            document.analysis = analysis;
            document.round += 1;
            document.stale = false;
            checked.push(path);
        }
        let mut messages = self.begin_search();
        let checked = checked.iter().filter_map(|path| self.documents.get(path));
        messages.extend(
            checked
                .filter(|document| !document.saved)
                .map(|document| self.publish(document)),
        );
        messages
    }

    /// Begins the next search for conflicts of a saved text. Publishes the diagnostics of texts without rules at once.
    fn begin_search(&mut self) -> Vec<Message> {
        let mut searched = Vec::new();
        for document in self.documents.values_mut().filter(|document| document.saved) {
            match &document.analysis.deciding {
                None => {
                    document.saved = false;
                    document.conflicts.clear();
                    searched.push(document.path.clone());
                }
                Some(deciding) if self.search.is_none() => {
                    let (rules, actions) = deciding.clone();
                    self.search = Some(ConflictSearch {
                        path: document.path.clone(),
                        round: document.round,
                        thread: thread::spawn(move || search_conflicts(&rules, &actions)),
                    });
                }
                Some(_) => {}
            }
        }
        let searched = searched.iter().filter_map(|path| self.documents.get(path));
        searched.map(|document| self.publish(document)).collect()
    }

    /// Publishes the result of a search that has ended, unless the document has changed, and begins the next one.
    fn finish_search(&mut self) -> Vec<Message> {
        let Some(search) = self.search.take_if(|search| search.thread.is_finished()) else {
            return Vec::new();
        };
        // A thread that panics has printed why.
        let found = search.thread.join().unwrap_or_default();
        let mut messages = Vec::new();
        if let Some(document) = self.documents.get_mut(&search.path)
            && document.saved
            && document.round == search.round
            && !document.stale
        {
            document.saved = false;
            document.conflicts = found
                .iter()
                .map(|fault| document.analysis.sources.traced(fault))
                .collect();
            messages.extend(self.documents.get(&search.path).map(|document| self.publish(document)));
        }
        messages.extend(self.begin_search());
        messages
    }

    // --- diagnostics

    fn publish(&self, document: &Document) -> Message {
        let shown = faults(document).map(|(fault, severity)| self.diagnostic(document, fault, severity));
        published(&document.uri, Some(document.version), shown.collect())
    }

    /// Converts a diagnostic. One in an included file appears at the include.
    fn diagnostic(&self, document: &Document, fault: &Diagnostic, severity: DiagnosticSeverity) -> Value {
        let Analysis { sources, entry, .. } = &document.analysis;
        let primary = fault.primary.as_ref();
        let elsewhere = primary.filter(|label| label.span.source != *entry);
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
                let location = self.location(&document.analysis, *span)?;
                Some(json!({ "location": location, "message": message }))
            })
            .collect();
        json!({
            "range": document.analysis.text(*entry).range(shown_at(&document.analysis, fault)),
            "severity": severity,
            "code": fault.code.name(),
            "source": "logicity",
            "message": message,
            "relatedInformation": related,
        })
    }

    /// Returns the location of a span, or `None` for a built-in file.
    fn location(&self, analysis: &Analysis, span: Span) -> Option<Value> {
        let uri = self.uri(&analysis.sources, span.source)?;
        Some(json!({ "uri": uri, "range": analysis.text(span.source).range_of(span) }))
    }

    fn uri(&self, sources: &Sources, id: SourceId) -> Option<String> {
        self.uri_of(Path::new(sources.name(id)))
    }

    /// Returns the URI of a document: the editor's own if the document is open. `None` for a built-in file.
    fn uri_of(&self, path: &Path) -> Option<String> {
        let path = normalize(path);
        match self.documents.get(&path) {
            Some(document) => Some(document.uri.clone()),
            None => uri_of(&path),
        }
    }

    // --- requests

    /// Answers a request, unless the client has cancelled it.
    fn respond(&self, request: lsp_server::Request, incoming: &Incoming<'_>) -> Vec<Message> {
        let lsp_server::Request { id, method, params } = request;
        let answer = match incoming.cancelled(&id) {
            true => Err(cancelled()),
            false => self.answer(&method, params, &Request { id: &id, incoming }),
        };
        vec![Message::Response(match answer {
            Ok(value) => Response::new_ok(id, value),
            Err((code, message)) => Response::new_err(id, code as i32, message),
        })]
    }

    fn answer(&self, method: &str, params: Value, request: &Request<'_>) -> Result<Value, Refusal> {
        match method {
            "textDocument/hover" => {
                read(params).and_then(|it: HoverParams| self.hover(&it.text_document_position_params))
            }
            "textDocument/definition" => {
                read(params).and_then(|it: GotoDefinitionParams| self.definition(&it.text_document_position_params))
            }
            "textDocument/references" => read(params).and_then(|it: ReferenceParams| {
                self.references(&it.text_document_position, it.context.include_declaration, request)
            }),
            "textDocument/documentHighlight" => {
                read(params).and_then(|it: DocumentHighlightParams| self.highlights(&it.text_document_position_params))
            }
            "textDocument/documentSymbol" => read(params).and_then(|it: DocumentSymbolParams| {
                let document = self.document(it.text_document.uri.as_str())?;
                Ok(outline::listed(&document.analysis, &document.uri, &self.client))
            }),
            "workspace/symbol" => {
                read(params).and_then(|it: WorkspaceSymbolParams| self.workspace_symbols(&it.query, request))
            }
            "textDocument/foldingRange" => read(params).and_then(|it: FoldingRangeParams| {
                let document = self.document(it.text_document.uri.as_str())?;
                Ok(outline::folds(&document.analysis, &self.client))
            }),
            "textDocument/formatting" => {
                read(params).and_then(|it: DocumentFormattingParams| self.format(it.text_document.uri.as_str()))
            }
            "textDocument/completion" => read(params).and_then(|it: CompletionParams| {
                let (document, byte) = self.place(&it.text_document_position)?;
                Ok(complete::complete(&document.analysis, byte, &self.client))
            }),
            "textDocument/signatureHelp" => read(params).and_then(|it: SignatureHelpParams| {
                let (document, byte) = self.place(&it.text_document_position_params)?;
                Ok(signature::signature(&document.analysis, byte, &self.client).unwrap_or(Value::Null))
            }),
            "textDocument/semanticTokens/full" => read(params).and_then(|it: SemanticTokensParams| {
                let document = self.document(it.text_document.uri.as_str())?;
                Ok(all_tokens(document, None))
            }),
            "textDocument/semanticTokens/full/delta" => read(params).and_then(|it: SemanticTokensDeltaParams| {
                let document = self.document(it.text_document.uri.as_str())?;
                Ok(all_tokens(document, Some(&it.previous_result_id)))
            }),
            "textDocument/semanticTokens/range" => read(params).and_then(|it: SemanticTokensRangeParams| {
                let document = self.document(it.text_document.uri.as_str())?;
                let asked = document.text.byte(it.range.start)..document.text.byte(it.range.end);
                Ok(json!({ "data": tokens::encoded(&document.analysis, &asked) }))
            }),
            "textDocument/prepareRename" => {
                read(params).and_then(|it: TextDocumentPositionParams| self.prepare_rename(&it))
            }
            "textDocument/rename" => read(params).and_then(|it: RenameParams| self.rename(&it, request)),
            "textDocument/codeAction" => read(params).and_then(|it: CodeActionParams| self.code_actions(&it)),
            "initialize" => Err((ErrorCode::InvalidRequest, "the server is initialized".to_owned())),
            other => Err((ErrorCode::MethodNotFound, format!("`{other}` is not supported"))),
        }
    }

    fn document(&self, uri: &str) -> Result<&Document, Refusal> {
        let document = self.documents.get(&key(uri));
        let document = document.ok_or_else(|| (ErrorCode::InvalidParams, format!("`{uri}` is not open")))?;
        match document.is_configuration() {
            true => Err((ErrorCode::RequestFailed, format!("`{uri}` is not a rule file"))),
            false => Ok(document),
        }
    }

    fn place(&self, at: &TextDocumentPositionParams) -> Result<(&Document, usize), Refusal> {
        let document = self.document(at.text_document.uri.as_str())?;
        Ok((document, document.text.byte(at.position)))
    }

    /// Reads the programs of the workspace with files that contain one of the names, or all without names.
    fn programs(&self, names: &[&str], request: &Request<'_>) -> Result<Programs, Refusal> {
        let open = self.documents.iter();
        let workspace = EditorWorkspace {
            folders: &self.folders,
            open: open
                .filter(|(_, document)| !document.is_configuration())
                .map(|(path, document)| (path.as_path(), document.text.as_str()))
                .collect(),
            encoding: self.client.encoding,
            cancelled: &|| request.is_cancelled(),
        };
        let wanted =
            |text: &str| names.is_empty() || text.contains("include") || names.iter().any(|name| text.contains(name));
        Programs::new(&workspace, &wanted).map_err(|search::Cancelled| cancelled())
    }

    /// Returns the fixes of the diagnostics in a range as quick fixes.
    fn code_actions(&self, params: &CodeActionParams) -> Result<Value, Refusal> {
        let document = self.document(params.text_document.uri.as_str())?;
        let asked = document.text.byte(params.range.start)..document.text.byte(params.range.end);
        let mut actions = Vec::new();
        for (fault, severity) in faults(document) {
            let place = shown_at(&document.analysis, fault);
            if place.end < asked.start || asked.end < place.start {
                continue;
            }
            let fixes = fault.fixes.iter().cloned();
            for fix in fixes.chain(document.analysis.include_vocabulary(fault)) {
                if let Some(edit) = self.fixed(&document.analysis, &fix) {
                    actions.push(json!({
                        "title": fix.title,
                        "kind": "quickfix",
                        "diagnostics": [self.diagnostic(document, fault, severity)],
                        "edit": edit,
                    }));
                }
            }
        }
        Ok(Value::Array(actions))
    }

    /// Returns the edit of a fix; `None` if it changes a built-in file.
    fn fixed(&self, analysis: &Analysis, fix: &Fix) -> Option<Value> {
        let mut edits: BTreeMap<String, (Option<i32>, Vec<Value>)> = BTreeMap::new();
        for (span, text) in &fix.edits {
            let path = normalize(Path::new(analysis.sources.name(span.source)));
            let span = match text.is_empty() {
                true => whole_lines(&analysis.sources, *span),
                false => *span,
            };
            let version = self.documents.get(&path).map(|document| document.version);
            let entry = edits.entry(self.uri_of(&path)?).or_insert((version, Vec::new()));
            entry
                .1
                .push(json!({ "range": analysis.text(span.source).range_of(span), "newText": text }));
        }
        Some(self.changes(edits.into_iter().map(|(uri, (version, edits))| (uri, version, edits))))
    }

    /// Returns `null` for a document with syntax errors, which its diagnostics report.
    fn format(&self, uri: &str) -> Result<Value, Refusal> {
        let document = self.document(uri)?;
        let Analysis { sources, entry, .. } = &document.analysis;
        Ok(match datalog::format(sources, *entry) {
            Ok(formatted) if formatted != document.text.as_str() => {
                json!([{ "range": document.text.whole(), "newText": formatted }])
            }
            Ok(_) => json!([]),
            Err(_) => Value::Null,
        })
    }
}

/// Returns the diagnostics of a document with their severities.
fn faults(document: &Document) -> impl Iterator<Item = (&Diagnostic, DiagnosticSeverity)> {
    let Analysis { diagnostics, hints, .. } = &document.analysis;
    let severe = diagnostics.iter().chain(&document.conflicts);
    let severe = severe.map(|fault| match fault.severity() {
        Severity::Error => (fault, DiagnosticSeverity::ERROR),
        Severity::Warning => (fault, DiagnosticSeverity::WARNING),
    });
    severe.chain(hints.iter().map(|lint| (lint, DiagnosticSeverity::INFORMATION)))
}

/// Returns the bytes of the text at which a diagnostic appears: the include for one in an included file.
fn shown_at(analysis: &Analysis, fault: &Diagnostic) -> Range<usize> {
    let span = fault.primary.as_ref().map(|label| label.span);
    let span = span.and_then(|span| match span.source == analysis.entry {
        true => Some(span),
        false => analysis.include_of(span.source),
    });
    span.map_or(0..0, Span::range)
}

/// Searches for pairs of actions that the rules can derive together.
fn search_conflicts(rules: &Rules, actions: &ActionsConfig) -> Vec<Diagnostic> {
    match conflicts(rules, &actions.table) {
        Ok(overlaps) => conflict_lints(&overlaps, rules, actions),
        Err(faults) => faults,
    }
}

/// Returns the semantic tokens of a document: as edits of the result with this name, if that is the last one.
fn all_tokens(document: &Document, previous: Option<&str>) -> Value {
    let data = tokens::encoded(&document.analysis, &(0..document.text.as_str().len()));
    let mut last = document.tokens.borrow_mut();
    let edits = previous
        .filter(|name| **name == last.0)
        .map(|_| tokens::edits(&last.1, &data));
    if edits.is_none() || data != last.1 {
        let number: u64 = last.0.parse().unwrap_or(0);
        *last = ((number + 1).to_string(), data);
    }
    match edits {
        Some(edits) => json!({ "resultId": last.0, "edits": edits }),
        None => json!({ "resultId": last.0, "data": last.1 }),
    }
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

/// Returns the key of a document in the table of open ones. The copy of a built-in file has the path of that file.
fn key(uri: &str) -> PathBuf {
    let path = normalize(&path_of(uri));
    let inside = builtin::folder().and_then(|folder| Some(path.strip_prefix(normalize(&folder)).ok()?.to_owned()));
    inside.map_or(path, builtin_path)
}

/// Returns a location in a file.
fn location(path: &Path, text: &Text, bytes: &Range<usize>) -> Value {
    json!({ "uri": uri_of(path), "range": text.range(bytes.clone()) })
}

fn read<T: DeserializeOwned>(params: Value) -> Result<T, Refusal> {
    serde_json::from_value(params).map_err(|error| (ErrorCode::InvalidParams, error.to_string()))
}

fn noted<T: DeserializeOwned>(params: Value) -> Result<T, String> {
    serde_json::from_value(params).map_err(|error| error.to_string())
}

fn cancelled() -> Refusal {
    (ErrorCode::RequestCanceled, "the request was cancelled".to_owned())
}

/// Wraps text of documentation.
fn markup(value: String, is_plain: bool) -> MarkupContent {
    let kind = match is_plain {
        true => MarkupKind::PlainText,
        false => MarkupKind::Markdown,
    };
    // Plain text has no fences around code.
    let value = match is_plain {
        true => value
            .lines()
            .filter(|line| !line.starts_with("```"))
            .collect::<Vec<_>>()
            .join("\n"),
        false => value,
    };
    MarkupContent { kind, value }
}

/// Asks the client to report changes of rule files and configurations on disk.
fn watch() -> Message {
    let options = json!({ "watchers": [{ "globPattern": "**/*.{dl,yaml,yml}" }] });
    let method = "workspace/didChangeWatchedFiles";
    let registration = json!({ "id": "rule-files", "method": method, "registerOptions": options });
    Message::Request(lsp_server::Request::new(
        RequestId::from("watch".to_owned()),
        "client/registerCapability".to_owned(),
        json!({ "registrations": [registration] }),
    ))
}

/// Writes to the log of the editor.
fn logged(message: String) -> Message {
    let params = json!({ "type": MessageType::ERROR, "message": message });
    Message::Notification(Notification::new("window/logMessage".to_owned(), params))
}

fn published(uri: &str, version: Option<i32>, diagnostics: Vec<Value>) -> Message {
    let params = json!({ "uri": uri, "version": version, "diagnostics": diagnostics });
    Message::Notification(Notification::new("textDocument/publishDiagnostics".to_owned(), params))
}
