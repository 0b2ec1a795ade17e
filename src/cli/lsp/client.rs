//! What the client can do, and what the server announces in return.

use crate::cli::lsp::place::{Encoding, path_of};
use crate::cli::lsp::tokens;
use serde_json::{Value, json};
use std::path::PathBuf;

/// The capabilities of the client that change what the server sends.
#[derive(Clone, Debug, Default)]
pub struct Client {
    pub encoding: Encoding,
    /// It accepts edits that name the version of a document.
    pub versioned_edits: bool,
    /// It accepts symbols with the range of the whole item.
    pub symbol_ranges: bool,
    /// It shows plain text only.
    pub plain_hover: bool,
    pub plain_completion: bool,
    /// The maximum number of folding ranges that it wants.
    pub folding_max: Option<usize>,
    /// It folds whole lines only.
    pub folds_lines: bool,
    /// It accepts parameters as ranges of the label.
    pub label_ranges: bool,
    /// It watches the files that the server names.
    pub watches: bool,
    prepares_renames: bool,
}

impl Client {
    /// Reads the parameters of `initialize`. Ignores what is malformed.
    pub fn new(params: &Value) -> Client {
        let capability = |path: &str| params.pointer(&format!("/capabilities/{path}"));
        let can = |path: &str| capability(path).and_then(Value::as_bool).unwrap_or(false);
        let is_plain = |path: &str| {
            let formats = capability(path).and_then(Value::as_array);
            formats.is_some_and(|formats| !formats.is_empty() && !formats.contains(&json!("markdown")))
        };
        let encodings = capability("general/positionEncodings").and_then(Value::as_array);
        let encodings = encodings.into_iter().flatten().filter_map(Value::as_str);
        let folding_max = capability("textDocument/foldingRange/rangeLimit").and_then(Value::as_u64);
        Client {
            encoding: { encodings }.find_map(Encoding::named).unwrap_or_default(),
            versioned_edits: can("workspace/workspaceEdit/documentChanges"),
            symbol_ranges: can("textDocument/documentSymbol/hierarchicalDocumentSymbolSupport"),
            plain_hover: is_plain("textDocument/hover/contentFormat"),
            plain_completion: is_plain("textDocument/completion/completionItem/documentationFormat"),
            folding_max: folding_max.and_then(|most| usize::try_from(most).ok()),
            folds_lines: can("textDocument/foldingRange/lineFoldingOnly"),
            label_ranges: can(
                "textDocument/signatureHelp/signatureInformation/parameterInformation/labelOffsetSupport",
            ),
            watches: can("workspace/didChangeWatchedFiles/dynamicRegistration"),
            prepares_renames: can("textDocument/rename/prepareSupport"),
        }
    }

    /// Returns the result of `initialize`.
    pub fn welcome(&self) -> Value {
        let rename = match self.prepares_renames {
            true => json!({ "prepareProvider": true }),
            false => json!(true),
        };
        let capabilities = json!({
            "positionEncoding": self.encoding.name(),
            "textDocumentSync": { "openClose": true, "change": 2, "save": true },
            "hoverProvider": true,
            "definitionProvider": true,
            "referencesProvider": true,
            "documentHighlightProvider": true,
            "documentSymbolProvider": true,
            "workspaceSymbolProvider": true,
            "documentFormattingProvider": true,
            "foldingRangeProvider": true,
            "completionProvider": { "triggerCharacters": ["."] },
            "signatureHelpProvider": { "triggerCharacters": ["(", ","] },
            "renameProvider": rename,
            "codeActionProvider": { "codeActionKinds": ["quickfix"] },
            "semanticTokensProvider": {
                "legend": { "tokenTypes": tokens::TYPES, "tokenModifiers": tokens::MODIFIERS },
                "range": true,
                "full": { "delta": true },
            },
            "workspace": { "workspaceFolders": { "supported": true, "changeNotifications": true } },
        });
        let server = json!({ "name": "logicity", "version": env!("CARGO_PKG_VERSION") });
        json!({ "capabilities": capabilities, "serverInfo": server })
    }
}

/// Returns the folders of the workspace from the parameters of `initialize`.
pub fn folders(params: &Value) -> Vec<PathBuf> {
    if let Some(folders) = params["workspaceFolders"].as_array() {
        return folders_of(folders);
    }
    let root = params["rootUri"].as_str().and_then(folder);
    let root = root.or_else(|| params["rootPath"].as_str().map(PathBuf::from));
    root.filter(|root| root.is_absolute()).into_iter().collect()
}

/// Returns the paths of a list of workspace folders.
pub fn folders_of(list: &[Value]) -> Vec<PathBuf> {
    list.iter().filter_map(|one| folder(one["uri"].as_str()?)).collect()
}

fn folder(uri: &str) -> Option<PathBuf> {
    uri.starts_with("file:").then(|| path_of(uri))
}
