//! The language server: runs the binary and exchanges messages with it.

use crate::cases::cases;
use lsp_server::{Message, Notification, Request, RequestId};
use proptest::prelude::*;
use proptest::test_runner::TestRunner;
use serde_json::{Value, json};
use std::collections::{BTreeMap, VecDeque};
use std::fs;
use std::io::{BufReader, Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::time::{Duration, Instant};

struct Editor {
    process: Child,
    to: ChildStdin,
    from: BufReader<ChildStdout>,
    /// Diagnostics that arrived while the test waited for another message.
    published: VecDeque<Value>,
    folder: tempfile::TempDir,
    next: i32,
    /// The answer to `initialize`.
    welcome: Value,
}

impl Editor {
    fn start() -> Editor {
        let editor = Editor::with(json!({}), &[]);
        assert_eq!(editor.welcome["capabilities"]["positionEncoding"], "utf-16");
        editor
    }

    /// Starts a client with these capabilities and folders of its workspace, which lie in the folder of the test.
    fn with(capabilities: Value, folders: &[&str]) -> Editor {
        let folder = tempfile::tempdir().unwrap();
        let mut process = Command::new(env!("CARGO_BIN_EXE_logicity"))
            .arg("lsp")
            .env("XDG_CACHE_HOME", folder.path().join("cache"))
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let (to, from) = (process.stdin.take().unwrap(), process.stdout.take().unwrap());
        let mut editor = Editor {
            process,
            to,
            from: BufReader::new(from),
            published: VecDeque::new(),
            folder,
            next: 0,
            welcome: Value::Null,
        };
        let mut params = json!({ "capabilities": capabilities, "processId": std::process::id(), "rootUri": null });
        if !folders.is_empty() {
            let uris = folders
                .iter()
                .map(|name| json!({ "uri": editor.uri(name), "name": name }));
            params["workspaceFolders"] = uris.collect();
        }
        editor.welcome = editor.ask("initialize", params);
        assert_eq!(editor.welcome["capabilities"]["hoverProvider"], true);
        editor.notify("initialized", json!({}));
        editor
    }

    fn send(&mut self, message: Message) {
        message.write(&mut self.to).unwrap();
    }

    fn notify(&mut self, method: &str, params: Value) {
        self.send(Message::Notification(Notification::new(method.to_owned(), params)));
    }

    /// The answer, or the error with its `code` and `message`.
    fn ask(&mut self, method: &str, params: Value) -> Value {
        self.next += 1;
        let id = RequestId::from(self.next);
        self.send(Message::Request(Request::new(id.clone(), method.to_owned(), params)));
        loop {
            match Message::read(&mut self.from).unwrap().expect("the server lives") {
                Message::Response(response) => {
                    assert_eq!(response.id, id);
                    return match response.response_result {
                        Ok(answer) => answer,
                        Err(error) => json!({ "code": error.code, "message": error.message }),
                    };
                }
                Message::Notification(notification) => self.published.push_back(notification.params),
                Message::Request(request) => panic!("unexpected request {}", request.method),
            }
        }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn uri(&self, name: &str) -> String {
        format!("file://{}", self.path(name).display())
    }

    fn open(&mut self, name: &str, text: &str) -> Vec<Value> {
        let document = json!({ "uri": self.uri(name), "languageId": "logicity", "version": 1, "text": text });
        self.notify("textDocument/didOpen", json!({ "textDocument": document }));
        self.diagnostics(name)
    }

    fn change(&mut self, name: &str, text: &str) -> Vec<Value> {
        let document = json!({ "uri": self.uri(name), "version": 2 });
        let params = json!({ "textDocument": document, "contentChanges": [{ "text": text }] });
        self.notify("textDocument/didChange", params);
        self.diagnostics(name)
    }

    /// Sends changes of ranges: the positions of their ends, and the new text.
    fn edit(&mut self, name: &str, edits: &[([Value; 2], &str)]) -> Vec<Value> {
        let changes = edits
            .iter()
            .map(|([start, end], text)| json!({ "range": { "start": start, "end": end }, "text": text }));
        let document = json!({ "uri": self.uri(name), "version": 3 });
        let params = json!({ "textDocument": document, "contentChanges": changes.collect::<Value>() });
        self.notify("textDocument/didChange", params);
        self.diagnostics(name)
    }

    fn save(&mut self, name: &str) -> Vec<Value> {
        let params = json!({ "textDocument": { "uri": self.uri(name) } });
        self.notify("textDocument/didSave", params);
        self.diagnostics(name)
    }

    /// Writes a file, and its folder.
    fn write(&self, name: &str, text: &str) {
        let path = self.path(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, text).unwrap();
    }

    /// Returns the path of a URI below the folder of the test.
    fn name(&self, uri: &str) -> String {
        let prefix = self.uri("");
        uri.strip_prefix(&prefix)
            .unwrap_or_else(|| panic!("{uri} is outside of {prefix}"))
            .to_owned()
    }

    /// Renames the name at a place. Returns the new text of each file, given those that are open.
    fn rename(&mut self, name: &str, place: (u32, u32), new: &str, open: &[(&str, &str)]) -> BTreeMap<String, String> {
        let edit = self.at("textDocument/rename", name, place, json!({ "newName": new }));
        let changes = edit["changes"].as_object().unwrap_or_else(|| panic!("{edit}"));
        let texts = changes.iter().map(|(uri, edits)| {
            let file = self.name(uri);
            let text = match open.iter().find(|(name, _)| *name == file) {
                Some((_, text)) => (*text).to_owned(),
                None => fs::read_to_string(self.path(&file)).unwrap(),
            };
            let text = edited(&text, edits.as_array().unwrap());
            (file, text)
        });
        texts.collect()
    }

    /// The next diagnostics of a text. Keeps those of other texts.
    fn diagnostics(&mut self, name: &str) -> Vec<Value> {
        let uri = self.uri(name);
        loop {
            if let Some(at) = self.published.iter().position(|params| params["uri"] == uri.as_str()) {
                let params = self.published.remove(at).unwrap();
                return params["diagnostics"].as_array().unwrap().clone();
            }
            match Message::read(&mut self.from).unwrap().expect("the server lives") {
                Message::Notification(notification) => self.published.push_back(notification.params),
                other => panic!("expected diagnostics: {other:?}"),
            }
        }
    }

    /// Sends a request about a position: line and column in UTF-16 units, from 0.
    fn at(&mut self, method: &str, name: &str, place: (u32, u32), more: Value) -> Value {
        let mut params = json!({
            "textDocument": { "uri": self.uri(name) },
            "position": { "line": place.0, "character": place.1 },
        });
        for (key, value) in more.as_object().into_iter().flatten() {
            params[key] = value.clone();
        }
        self.ask(method, params)
    }

    fn of(&mut self, method: &str, name: &str) -> Value {
        let uri = self.uri(name);
        let options = json!({ "tabSize": 4, "insertSpaces": true });
        self.ask(method, json!({ "textDocument": { "uri": uri }, "options": options }))
    }

    fn end(mut self) {
        assert_eq!(self.ask("shutdown", Value::Null), Value::Null);
        self.notify("exit", Value::Null);
        assert!(self.process.wait().unwrap().success());
    }
}

fn range(line: u32, from: u32, to: u32) -> Value {
    json!({ "start": { "line": line, "character": from }, "end": { "line": line, "character": to } })
}

/// Returns the byte of a position by the words of the protocol, in UTF-16 units.
fn byte_of(text: &str, position: &Value) -> usize {
    let [mut line, mut units] = ["line", "character"].map(|part| position[part].as_u64().unwrap());
    let mut rest = text.char_indices().peekable();
    while line > 0 {
        match rest.next() {
            None => return text.len(),
            Some((_, '\n')) => line -= 1,
            Some((_, '\r')) if rest.peek().is_none_or(|(_, next)| *next != '\n') => line -= 1,
            Some(_) => {}
        }
    }
    while let Some(&(at, c)) = rest.peek() {
        if matches!(c, '\r' | '\n') || units < c.len_utf16() as u64 {
            return at;
        }
        units -= c.len_utf16() as u64;
        rest.next();
    }
    text.len()
}

/// Applies edits, which do not overlap, to a text.
fn edited(text: &str, edits: &[Value]) -> String {
    let range = |edit: &Value| ["start", "end"].map(|end| byte_of(text, &edit["range"][end]));
    let mut edits: Vec<([usize; 2], &str)> = edits
        .iter()
        .map(|edit| (range(edit), edit["newText"].as_str().unwrap()))
        .collect();
    edits.sort_by_key(|(range, _)| *range);
    let mut text = text.to_owned();
    for ([start, end], new) in edits.into_iter().rev() {
        text.replace_range(start..end, new);
    }
    text
}

fn codes(diagnostics: &[Value]) -> Vec<&str> {
    diagnostics.iter().map(|one| one["code"].as_str().unwrap()).collect()
}

/// Line 4 has characters of one, two and four bytes, and of one and two UTF-16 units, before the names of the test.
const RULES: &str = "\
.type place <: symbol
/// A road for cars.
.decl Road(x: place, y: place)
.decl Way(x: place, y: place)
/* \u{e9} \u{1f697} */ Way(x, z) :- Way(x, y), Road(y, z).
Way(x, y) :- Road(x, y).
Road(\"\u{1f697}\", \"b\").
";

#[test]
fn a_valid_text_can_be_navigated() {
    let mut editor = Editor::start();
    assert_eq!(editor.open("a.dl", RULES), Vec::<Value>::new());
    // `Road` on line 4: `/* é 🚗 */ ` takes 11 units.
    let column = "/* \u{e9} \u{1f697} */ Way(x, z) :- Way(x, y), ".encode_utf16().count() as u32;
    let hover = editor.at("textDocument/hover", "a.dl", (4, column + 1), json!({}));
    let shown = hover["contents"]["value"].as_str().unwrap();
    assert!(
        shown.contains(".decl Road(x: place, y: place)") && shown.contains("A road for cars."),
        "{shown}"
    );
    assert_eq!(hover["range"], range(4, column, column + 4));

    let definition = editor.at("textDocument/definition", "a.dl", (4, column), json!({}));
    assert_eq!(
        definition,
        json!({ "uri": editor.uri("a.dl"), "range": range(2, 6, 10) })
    );
    let definition = editor.at("textDocument/definition", "a.dl", (3, 15), json!({}));
    assert_eq!(definition["range"], range(0, 6, 11), "the type");
    assert_eq!(
        editor.at("textDocument/definition", "a.dl", (4, column - 3), json!({})),
        Value::Null,
        "a variable"
    );

    let asked = json!({ "context": { "includeDeclaration": true } });
    let all = editor.at("textDocument/references", "a.dl", (2, 7), asked);
    let ranges: Vec<&Value> = all.as_array().unwrap().iter().map(|place| &place["range"]).collect();
    let expected = [
        range(2, 6, 10),
        range(4, column, column + 4),
        range(5, 13, 17),
        range(6, 0, 4),
    ];
    assert_eq!(ranges, expected.iter().collect::<Vec<_>>());
    let asked = json!({ "context": { "includeDeclaration": false } });
    let uses = editor.at("textDocument/references", "a.dl", (2, 7), asked);
    assert_eq!(uses.as_array().unwrap().len(), 3);

    let symbols = editor.of("textDocument/documentSymbol", "a.dl");
    let names: Vec<&str> = symbols
        .as_array()
        .unwrap()
        .iter()
        .map(|one| one["name"].as_str().unwrap())
        .collect();
    assert_eq!(
        names,
        [
            "place",
            "Road",
            "Way",
            "Way(x, z)",
            "Way(x, y)",
            "Road(\"\u{1f697}\", \"b\")"
        ]
    );
    editor.end();
}

#[test]
fn faults_are_reported_as_the_text_changes() {
    let mut editor = Editor::start();
    assert!(editor.open("a.dl", RULES).is_empty());
    // The wrong name follows a character of two units.
    let faulty = RULES.replace("Road(y, z).", "Raod(y, z).");
    let diagnostics = editor.change("a.dl", &faulty);
    assert_eq!(codes(&diagnostics), ["unknown-predicate"]);
    let column = "/* \u{e9} \u{1f697} */ Way(x, z) :- Way(x, y), ".encode_utf16().count() as u32;
    assert_eq!(diagnostics[0]["range"], range(4, column, column + 4));
    assert_eq!(
        (&diagnostics[0]["severity"], &diagnostics[0]["source"]),
        (&json!(1), &json!("logicity"))
    );
    assert!(
        diagnostics[0]["message"]
            .as_str()
            .unwrap()
            .contains("did you mean `Road`?")
    );
    let related = &diagnostics[0]["relatedInformation"][0];
    assert_eq!(
        related["location"],
        json!({ "uri": editor.uri("a.dl"), "range": range(2, 6, 10) })
    );
    assert!(related["message"].as_str().unwrap().contains("is declared here"));

    let lone = RULES.replace("Way(x, y) :- Road(x, y).", "Way(x, x) :- Road(x, y).");
    let diagnostics = editor.change("a.dl", &lone);
    assert_eq!(
        (codes(&diagnostics), &diagnostics[0]["severity"]),
        (vec!["singleton-variable"], &json!(2))
    );
    let needless = ".decl A(x: symbol)\n.input A\n.decl B(x: symbol)\n.output B\n.decl C(x: symbol)\n.input C\n.implies A, C\nB(x) :- A(x), C(x).\n";
    let diagnostics = editor.change("a.dl", needless);
    assert_eq!(
        (codes(&diagnostics), &diagnostics[0]["severity"]),
        (vec!["redundant-literal"], &json!(3))
    );
    assert!(editor.change("a.dl", RULES).is_empty());
    editor.notify(
        "textDocument/didClose",
        json!({ "textDocument": { "uri": editor.uri("a.dl") } }),
    );
    assert!(editor.diagnostics("a.dl").is_empty());
    let refused = editor.of("textDocument/formatting", "a.dl");
    assert!(
        refused["message"].as_str().unwrap().contains("is not open"),
        "{refused}"
    );
    editor.end();
}

#[test]
fn rules_for_an_input_are_faulty_only_in_a_city() {
    let mut editor = Editor::start();
    let general = ".decl Edge(x: symbol, y: symbol)\n.input Edge\n.output Edge\nEdge(x, y) :- Edge(y, x).\n";
    assert_eq!(codes(&editor.open("general.dl", general)), ["extended-input"]);
    let city = ".include \"vocabulary.dl\"\nIsCar(X) :- IsBus(X).\nStop(X) :- CollidingClose(X, Y).\n";
    assert_eq!(codes(&editor.open("city.dl", city)), ["derived-input"]);
}

#[test]
fn branches_of_algebraic_data_types_are_names() {
    let mut editor = Editor::start();
    let text = "/// A figure.\n.type Shape = Circle {r: number} | Group {a: Shape, b: Shape}\n.decl s(s: Shape)\n.output s\n\
                s($Circle(1)).\ns(a) :- s($Group(a, $Circle(_))).\n";
    assert!(editor.open("a.dl", text).is_empty());
    let circle = 1 + "s($".len() as u32;
    let definition = editor.at("textDocument/definition", "a.dl", (4, circle), json!({}));
    assert_eq!(definition["range"], range(1, 14, 20));
    let definition = editor.at("textDocument/definition", "a.dl", (5, 12), json!({}));
    assert_eq!(definition["range"], range(1, 35, 40));
    let hover = editor.at("textDocument/hover", "a.dl", (4, circle), json!({}));
    let shown = hover["contents"]["value"].as_str().unwrap();
    assert!(
        shown.contains("Circle {r: number}") && shown.contains("A figure."),
        "{shown}"
    );
    let asked = json!({ "context": { "includeDeclaration": true } });
    let all = editor.at("textDocument/references", "a.dl", (1, 15), asked);
    assert_eq!(all.as_array().unwrap().len(), 3);
    let renamed = editor.at("textDocument/rename", "a.dl", (4, circle), json!({ "newName": "Disk" }));
    let edits = renamed.to_string();
    assert_eq!(edits.matches("\"Disk\"").count(), 3, "{edits}");
    let items = editor.at("textDocument/completion", "a.dl", (5, 11), json!({}));
    let labels: Vec<&str> = items
        .as_array()
        .unwrap()
        .iter()
        .map(|item| item["label"].as_str().unwrap())
        .collect();
    assert_eq!(labels, ["Circle", "Group"]);
    editor.end();
}

#[test]
fn open_texts_have_precedence_over_files() {
    let mut editor = Editor::start();
    fs::write(editor.path("parts.dl"), ".decl Old(x: symbol)\n.input Old\n").unwrap();
    let main = ".include \"parts.dl\"\n.include \"vocabulary.dl\"\n.decl Main(x: symbol)\nMain(x) :- New(x), Old(x).\n";
    assert_eq!(codes(&editor.open("main.dl", main)), ["unknown-predicate"]);
    editor.open("parts.dl", ".decl Old, New(x: symbol)\n.input Old, New\n");
    assert!(editor.diagnostics("main.dl").is_empty());

    let definition = editor.at("textDocument/definition", "main.dl", (3, 12), json!({}));
    assert_eq!(
        definition,
        json!({ "uri": editor.uri("parts.dl"), "range": range(0, 11, 14) })
    );
    let definition = editor.at("textDocument/definition", "main.dl", (0, 12), json!({}));
    assert_eq!(
        definition,
        json!({ "uri": editor.uri("parts.dl"), "range": range(0, 0, 0) })
    );
    // An editor opens a built-in file as a read-only copy.
    let copied = |editor: &mut Editor, place: (u32, u32)| {
        let definition = editor.at("textDocument/definition", "main.dl", place, json!({}));
        let copy = PathBuf::from(definition["uri"].as_str().unwrap().strip_prefix("file://").unwrap());
        assert!(copy.starts_with(editor.path("cache")), "{definition}");
        let text = fs::read_to_string(&copy).unwrap();
        assert_eq!(
            text,
            fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/rules/vocabulary.dl")).unwrap()
        );
        assert!(fs::metadata(&copy).unwrap().permissions().readonly());
        let line = definition["range"]["start"]["line"].as_u64().unwrap();
        text.lines().nth(line as usize).unwrap().to_owned()
    };
    copied(&mut editor, (1, 12));
    editor.change("main.dl", &main.replace("New(x), Old(x)", "New(x), Old(x), IsCar(x)"));
    assert!(copied(&mut editor, (3, 29)).starts_with(".decl IsCar("));
    editor.change("main.dl", main);

    // A fault in an included text is reported at the include.
    editor.change("parts.dl", ".decl Old, New(x: symbol)\n.input Old, New\nOld(1).\n");
    let diagnostics = editor.diagnostics("main.dl");
    assert_eq!(
        (codes(&diagnostics), &diagnostics[0]["range"]),
        (vec!["type-mismatch"], &range(0, 9, 19))
    );
    assert!(
        diagnostics[0]["message"].as_str().unwrap().contains("parts.dl:3:5"),
        "{diagnostics:?}"
    );
    assert_eq!(
        diagnostics[0]["relatedInformation"][0]["location"]["range"],
        range(2, 4, 5)
    );
    editor.end();
}

#[test]
fn names_are_completed_and_renamed_in_all_open_texts() {
    let mut editor = Editor::start();
    editor.open(
        "parts.dl",
        ".type place <: symbol\n/// Given.\n.decl Old(x: place)\n.input Old\n",
    );
    editor.open(
        "main.dl",
        ".include \"parts.dl\"\n.decl Main(x: place)\nMain(x) :- Old(x).\n",
    );
    let labels = |items: &Value| -> Vec<String> {
        let items = items.as_array().unwrap().iter();
        items.map(|item| item["label"].as_str().unwrap().to_owned()).collect()
    };
    let items = editor.at("textDocument/completion", "main.dl", (2, 12), json!({}));
    assert_eq!(labels(&items)[..3], ["Main", "Old", "Not"]);
    assert!(labels(&items).contains(&"count".to_owned()));
    assert_eq!(
        (&items[1]["detail"], &items[1]["documentation"]["value"]),
        (&json!(".decl Old(x: place)"), &json!("Given."))
    );
    let items = editor.at("textDocument/completion", "main.dl", (1, 16), json!({}));
    assert_eq!(labels(&items), ["symbol", "number", "unsigned", "float", "place"]);
    let items = editor.at("textDocument/completion", "main.dl", (1, 2), json!({}));
    assert!(labels(&items).contains(&"printsize".to_owned()));
    let items = editor.at("textDocument/completion", "main.dl", (3, 0), json!({}));
    assert!(labels(&items).contains(&".printsize".to_owned()) && labels(&items).contains(&"Main".to_owned()));
    assert!(!labels(&items).contains(&"count".to_owned()), "not in a body");
    let items = editor.at("textDocument/completion", "main.dl", (0, 12), json!({}));
    assert!(labels(&items).contains(&"vocabulary.dl".to_owned()));

    // A separate program, whose predicate only has the same name.
    editor.open("other.dl", ".decl Old(x: symbol)\nOld(\"a\").\n");
    let renamed = editor.at("textDocument/rename", "main.dl", (2, 12), json!({ "newName": "Given" }));
    let edit = |range: Value| json!({ "range": range, "newText": "Given" });
    let mut changes = serde_json::Map::new();
    changes.insert(editor.uri("main.dl"), json!([edit(range(2, 11, 14))]));
    changes.insert(
        editor.uri("parts.dl"),
        json!([edit(range(2, 6, 9)), edit(range(3, 7, 10))]),
    );
    assert_eq!(renamed, json!({ "changes": changes }));
    let place = editor.at("textDocument/prepareRename", "main.dl", (2, 12), json!({}));
    assert_eq!(place, range(2, 11, 14));
    for (new, words) in [
        ("not", "not a name"),
        ("A b", "not a name"),
        ("Main", "already declared"),
        ("place", "already declared"),
        ("symbol", "already declared"),
    ] {
        let refused = editor.at("textDocument/rename", "main.dl", (2, 12), json!({ "newName": new }));
        assert!(refused["message"].as_str().unwrap().contains(words), "{refused}");
    }
    editor.open("city.dl", ".include \"vocabulary.dl\"\nStop(X) :- IsCar(X).\n");
    let refused = editor.at(
        "textDocument/rename",
        "city.dl",
        (1, 12),
        json!({ "newName": "IsAuto" }),
    );
    assert!(
        refused["message"].as_str().unwrap().contains("read-only file"),
        "{refused}"
    );
    editor.end();
}

/// The titles of the quick fixes at a place, and the text after each.
fn fixes(editor: &mut Editor, name: &str, text: &str, place: (u32, u32)) -> Vec<(String, String)> {
    let position = json!({ "line": place.0, "character": place.1 });
    let params = json!({
        "textDocument": { "uri": editor.uri(name) },
        "range": { "start": position, "end": position },
        "context": { "diagnostics": [] },
    });
    let actions = editor.ask("textDocument/codeAction", params);
    let uri = editor.uri(name);
    let fixed = actions.as_array().unwrap().iter().map(|action| {
        assert_eq!(action["kind"], "quickfix");
        assert_eq!(action["diagnostics"][0]["source"], "logicity");
        let changes = action["edit"]["changes"].as_object().unwrap();
        assert_eq!(changes.keys().collect::<Vec<_>>(), [&uri]);
        let mut lines: Vec<Vec<u16>> = text.split('\n').map(|line| line.encode_utf16().collect()).collect();
        let mut edits = changes[&uri].as_array().unwrap().clone();
        edits.sort_by_key(|edit| {
            (
                edit["range"]["start"]["line"].as_u64(),
                edit["range"]["start"]["character"].as_u64(),
            )
        });
        for edit in edits.iter().rev() {
            let at = |end: &str, part: &str| edit["range"][end][part].as_u64().unwrap() as usize;
            let (first, last) = (at("start", "line"), at("end", "line"));
            let mut line = lines[first][..at("start", "character")].to_vec();
            line.extend(edit["newText"].as_str().unwrap().encode_utf16());
            line.extend(&lines[last][at("end", "character")..]);
            drop(lines.splice(first..=last, [line]));
        }
        let text: Vec<String> = lines.iter().map(|line| String::from_utf16(line).unwrap()).collect();
        (action["title"].as_str().unwrap().to_owned(), text.join("\n"))
    });
    fixed.collect()
}

#[test]
fn suggestions_are_quick_fixes() {
    let mut editor = Editor::start();
    editor.open("a.dl", RULES);
    let faulty = RULES.replace("Way(x, y), Road(y, z)", "Way(x, y), Raod(y, z)");
    assert_eq!(codes(&editor.change("a.dl", &faulty)), ["unknown-predicate"]);
    let column = "/* \u{e9} \u{1f697} */ Way(x, z) :- Way(x, y), Ra"
        .encode_utf16()
        .count() as u32;
    let found = fixes(&mut editor, "a.dl", &faulty, (4, column));
    assert_eq!(found, [("replace it with `Road`".to_owned(), RULES.to_owned())]);
    assert!(fixes(&mut editor, "a.dl", &faulty, (5, 0)).is_empty(), "no fault there");

    let doubled = format!("{RULES}Road(\"\u{1f697}\", \"b\").\n");
    assert_eq!(codes(&editor.change("a.dl", &doubled)), ["duplicate-clause"]);
    let found = fixes(&mut editor, "a.dl", &doubled, (7, 3));
    assert_eq!(found, [("remove it".to_owned(), RULES.to_owned())], "with its line");

    let lone = RULES.replace("Way(x, y) :- Road(x, y).", "Way(x, x) :- Road(x, y).");
    editor.change("a.dl", &lone);
    let titles: Vec<String> = fixes(&mut editor, "a.dl", &lone, (5, 21))
        .into_iter()
        .map(|(title, _)| title)
        .collect();
    assert_eq!(titles, ["replace it with `_`", "rename it to `_y`"]);

    let without = "Stop(X) :- IsCar(X), CollidingClose(X, Y).\n";
    editor.change("a.dl", without);
    for (title, text) in fixes(&mut editor, "a.dl", without, (0, 12)) {
        assert_eq!(title, "include vocabulary.dl");
        assert!(editor.change("a.dl", &text).is_empty(), "{text}");
    }
    editor.end();
}

#[test]
fn variables_are_renamed_in_their_clause() {
    let mut editor = Editor::start();
    editor.open("a.dl", RULES);
    // `y` of line 4 occurs twice there; that of line 5 is another variable.
    let column = "/* \u{e9} \u{1f697} */ Way(x, z) :- Way(x, ".encode_utf16().count() as u32;
    let place = editor.at("textDocument/prepareRename", "a.dl", (4, column), json!({}));
    assert_eq!(place, range(4, column, column + 1));
    let renamed = editor.at(
        "textDocument/rename",
        "a.dl",
        (4, column),
        json!({ "newName": "middle" }),
    );
    let edits = &renamed["changes"][editor.uri("a.dl")];
    let edit = |column: u32| json!({ "range": range(4, column, column + 1), "newText": "middle" });
    assert_eq!(*edits, json!([edit(column), edit(column + 9)]));
    let asked = json!({ "context": { "includeDeclaration": true } });
    let places = editor.at("textDocument/references", "a.dl", (5, 7), asked);
    assert_eq!(places.as_array().unwrap().len(), 2, "{places}");
    for (new, words) in [
        ("x", "already a variable"),
        ("count", "a word of the language"),
        ("not", "not a name"),
        ("a b", "not a name"),
    ] {
        let refused = editor.at("textDocument/rename", "a.dl", (4, column), json!({ "newName": new }));
        assert!(refused["message"].as_str().unwrap().contains(words), "{refused}");
    }
    editor.end();
}

#[test]
fn words_of_the_language_are_described() {
    let mut editor = Editor::start();
    let text = ".decl A(x: number)\n.output A\n// count\nA(n) :- n = count : { A(_) }, !match(\"count\", \"b\").\n";
    editor.open("a.dl", text);
    let mut hover = |line: u32, character: u32| {
        let shown = editor.at("textDocument/hover", "a.dl", (line, character), json!({}));
        (
            shown["contents"]["value"].as_str().map(str::to_owned),
            shown["range"].clone(),
        )
    };
    let (shown, place) = hover(1, 3);
    assert!(shown.unwrap().contains("a result of the program"));
    assert_eq!(place, range(1, 0, 7));
    let (shown, place) = hover(3, 14);
    assert!(shown.unwrap().contains("the number of ways in which the body holds"));
    assert_eq!(place, range(3, 12, 17));
    assert!(hover(3, 34).0.unwrap().contains("regular expression"));
    assert_eq!(hover(2, 5).0, None, "a comment");
    assert_eq!(hover(3, 39).0, None, "a string");
    editor.end();
}

#[test]
fn temporal_operators_are_described_colored_and_completed() {
    let mut editor = Editor::start();
    let text = ".decl A, once(x: number)\n.input once\n.output A\n\
                A(x) :- once[0,5] once(x), A(x) since once(x), !previous A(x).\n";
    assert_eq!(editor.open("a.dl", text), Vec::<Value>::new());
    let mut hover = |character: u32| {
        let shown = editor.at("textDocument/hover", "a.dl", (3, character), json!({}));
        shown["contents"]["value"]
            .as_str()
            .map(str::to_owned)
            .unwrap_or_default()
    };
    assert!(hover(9).contains("in some tick of the window"));
    assert!(hover(19).contains(".decl once(x: number)"));
    assert!(hover(33).contains("in every tick after that"));
    assert!(hover(50).contains("in the tick before"));
    let full = editor.of("textDocument/semanticTokens/full", "a.dl");
    let found = tokens(&editor, text, &full["data"]);
    let kinds = |word: &str| -> Vec<&str> {
        let found = found.iter().filter(|(_, found, _)| found == word);
        found.map(|(_, _, kind)| kind.as_str()).collect()
    };
    assert_eq!(
        kinds("once"),
        ["function declaration", "function", "keyword", "function", "function"]
    );
    assert_eq!((kinds("since"), kinds("previous")), (vec!["keyword"], vec!["keyword"]));
    let items = editor.at("textDocument/completion", "a.dl", (3, 8), json!({}));
    let items: BTreeMap<&str, &Value> = (items.as_array().unwrap().iter())
        .map(|item| (item["label"].as_str().unwrap(), &item["detail"]))
        .collect();
    for word in ["previous", "historically", "for", "since"] {
        assert!(items[word].as_str().unwrap().contains(word), "{items:?}");
    }
    editor.end();
}

#[test]
fn a_text_is_formatted() {
    let mut editor = Editor::start();
    editor.open("a.dl", ".decl A( x:symbol )\n\n\n\nA(\"\u{1f697}\").A(\"b\")  .");
    let edits = editor.of("textDocument/formatting", "a.dl");
    assert_eq!(
        edits[0]["newText"],
        ".decl A(x: symbol)\n\nA(\"\u{1f697}\"). A(\"b\").\n"
    );
    let end = "A(\"\u{1f697}\").A(\"b\")  .".encode_utf16().count();
    assert_eq!(edits[0]["range"]["end"], json!({ "line": 4, "character": end }));
    editor.change("a.dl", edits[0]["newText"].as_str().unwrap());
    assert_eq!(editor.of("textDocument/formatting", "a.dl"), json!([]));
    editor.change("a.dl", "A(");
    assert_eq!(editor.of("textDocument/formatting", "a.dl"), Value::Null);
    editor.end();
}

#[test]
fn no_message_ends_the_server() {
    let mut editor = Editor::start();
    let refused = editor.ask("textDocument/inlayHint", json!({}));
    assert_eq!(refused["code"], -32601);
    let refused = editor.ask("textDocument/foldingRange", json!({}));
    assert_eq!(refused["code"], -32602);
    let refused = editor.ask("textDocument/hover", json!({ "position": 3 }));
    assert_eq!(refused["code"], -32602);
    editor.notify("textDocument/didOpen", json!({ "nonsense": true }));
    editor.notify("$/setTrace", json!({ "value": "off" }));
    editor.notify("textDocument/didOpen", json!({ "textDocument": "a.dl" }));
    assert_eq!(editor.ask("shutdown?", Value::Null)["code"], -32601);
    let logged = editor.published.pop_back().expect("invalid messages are reported");
    assert_eq!(logged["type"], 1);
    assert!(
        logged["message"]
            .as_str()
            .unwrap()
            .starts_with("cannot parse `textDocument/didOpen`: ")
    );
    editor.open(
        "a.dl",
        "\u{feff}.decl A(x: symbol)\r\nA(\"\u{1f697}\u{1f697}\r\n.include \"\u{0}\"\n",
    );
    for line in 0..5 {
        for character in [0, 3, 7, 1_000_000] {
            editor.at("textDocument/hover", "a.dl", (line, character), json!({}));
            editor.at("textDocument/completion", "a.dl", (line, character), json!({}));
        }
    }
    let text = json!({ "uri": "untitled:Untitled-1", "languageId": "logicity", "version": 1, "text": RULES });
    editor.notify("textDocument/didOpen", json!({ "textDocument": text }));
    let at = json!({ "textDocument": { "uri": "untitled:Untitled-1" }, "position": { "line": 5, "character": 1 } });
    assert_eq!(editor.ask("textDocument/definition", at)["uri"], "untitled:Untitled-1");
    editor.end();
}

#[test]
fn the_shipped_rules_have_no_faults() {
    let mut editor = Editor::start();
    let rules = Path::new(env!("CARGO_MANIFEST_DIR")).join("rules");
    for name in ["vocabulary.dl", "expert.dl", "vap-hard.dl"] {
        let text = fs::read_to_string(rules.join(name)).unwrap();
        let diagnostics = editor.open(name, &text);
        let severe: Vec<&Value> = diagnostics.iter().filter(|one| one["severity"] != 3).collect();
        assert!(severe.is_empty(), "{name}: {severe:?}");
    }
    editor.end();
}

/// Two actions that one car can take at once; the second clause is on line 2.
const CONFLICT: &str = ".include \"vocabulary.dl\"
Stop(X) :- IsCar(X), CollidingClose(X, _).
Fast(X) :- IsAmbulance(X).
";

#[test]
fn conflicts_between_actions_appear_on_save() {
    let mut editor = Editor::start();
    assert_eq!(codes(&editor.open("a.dl", CONFLICT)), Vec::<&str>::new());
    let saved = editor.save("a.dl");
    assert_eq!(codes(&saved), ["action-conflict"]);
    assert_eq!(
        (&saved[0]["severity"], &saved[0]["range"]["start"]["line"]),
        (&json!(2), &json!(2))
    );
    let message = saved[0]["message"].as_str().unwrap();
    assert!(
        message.contains("the rules can derive Stop and Fast for one agent, and Stop wins"),
        "{message}"
    );
    assert_eq!(
        saved[0]["relatedInformation"][0]["location"]["range"]["start"]["line"],
        1
    );

    // The conflict moves with its clauses until one of them changes.
    let moved = editor.change("a.dl", &CONFLICT.replace("Stop(X) :-", "// \u{1f697}\n\nStop(X) :-"));
    assert_eq!(
        (codes(&moved), &moved[0]["range"]["start"]["line"]),
        (vec!["action-conflict"], &json!(4))
    );
    assert_eq!(
        moved[0]["relatedInformation"][0]["location"]["range"]["start"]["line"],
        3
    );
    let fixed = CONFLICT.replace("IsAmbulance(X).", "IsAmbulance(X), Not(Stop(X)).");
    assert!(editor.change("a.dl", &fixed).is_empty());
    assert!(editor.save("a.dl").is_empty());

    // A text that includes the saved one has the conflict at its include.
    assert!(editor.open("main.dl", ".include \"a.dl\"\n").is_empty());
    assert!(editor.diagnostics("a.dl").is_empty());
    editor.change("a.dl", CONFLICT);
    assert!(editor.diagnostics("main.dl").is_empty());
    assert_eq!(codes(&editor.save("a.dl")), ["action-conflict"]);
    let included = editor.diagnostics("main.dl");
    assert_eq!(
        (codes(&included), &included[0]["range"]),
        (vec!["action-conflict"], &range(0, 9, 15))
    );

    // Rules with errors have no conflicts.
    editor.change("a.dl", &CONFLICT.replace("IsCar", "IsCat"));
    editor.diagnostics("main.dl");
    assert_eq!(codes(&editor.save("a.dl")), ["unknown-predicate"]);
    editor.end();
}

/// A workspace in which `main.dl` joins the fragments `decls.dl` and `rules.dl`, and `apart/other.dl` uses the same
/// name for something else.
fn workspace(capabilities: Value) -> Editor {
    let editor = Editor::with(capabilities, &["one", "two"]);
    editor.write(
        "one/decls.dl",
        ".type place <: symbol\n.decl Old(x: place)\n.input Old\n",
    );
    editor.write("one/rules.dl", "New(x) :- Old(x), // \u{1f697}\r\n Old(x).\r\n");
    editor.write(
        "one/main.dl",
        ".include \"decls.dl\"\n.decl New(x: place)\n.output New\n.include \"rules.dl\"\n",
    );
    editor.write(
        "two/deep/user.dl",
        ".include \"../../one/decls.dl\"\n.decl A(x: place)\nA(x) :- Old(x).\n",
    );
    editor.write("two/apart.dl", ".decl Old(x: number)\nOld(1).\n");
    editor.write("two/.hidden/a.dl", ".include \"../../one/decls.dl\"\nOld(\"a\").\n");
    editor.write("two/made/CACHEDIR.TAG", "");
    editor.write("two/made/a.dl", ".include \"../../one/decls.dl\"\nOld(\"a\").\n");
    editor.write("outside.dl", ".include \"one/decls.dl\"\nOld(\"a\").\n");
    for (link, target) in [
        ("one/loop", "."),
        ("two/link", "../one"),
        ("one/link.dl", "rules.dl"),
        ("one/gone.dl", "no"),
    ] {
        std::os::unix::fs::symlink(target, editor.path(link)).unwrap();
    }
    editor
}

#[test]
fn references_and_renaming_search_the_folders_of_the_workspace() {
    let mut editor = workspace(json!({}));
    // The text of the editor differs from the file on disk.
    let rules = "New(x) :- Old(x).\n";
    editor.open("one/rules.dl", rules);
    let asked = json!({ "context": { "includeDeclaration": true } });
    let found = editor.at("textDocument/references", "one/rules.dl", (0, 11), asked);
    let places = |editor: &Editor, found: &Value| -> Vec<(String, Value)> {
        let found = found.as_array().unwrap_or_else(|| panic!("{found}")).iter();
        found
            .map(|one| (editor.name(one["uri"].as_str().unwrap()), one["range"].clone()))
            .collect()
    };
    let expected = [
        ("one/decls.dl".to_owned(), range(1, 6, 9)),
        ("one/decls.dl".to_owned(), range(2, 7, 10)),
        ("one/rules.dl".to_owned(), range(0, 10, 13)),
        ("two/deep/user.dl".to_owned(), range(2, 8, 11)),
    ];
    assert_eq!(places(&editor, &found), expected);

    let renamed = editor.rename("one/rules.dl", (0, 11), "Given", &[("one/rules.dl", rules)]);
    let expected = [
        (
            "one/decls.dl",
            ".type place <: symbol\n.decl Given(x: place)\n.input Given\n",
        ),
        ("one/rules.dl", "New(x) :- Given(x).\n"),
        (
            "two/deep/user.dl",
            ".include \"../../one/decls.dl\"\n.decl A(x: place)\nA(x) :- Given(x).\n",
        ),
    ];
    assert_eq!(
        renamed,
        expected.map(|(name, text)| (name.to_owned(), text.to_owned())).into()
    );
    // A type, from a file that only includes its declaration.
    let renamed = editor.rename("one/rules.dl", (0, 1), "Fresh", &[("one/rules.dl", rules)]);
    assert_eq!(renamed.keys().collect::<Vec<_>>(), ["one/main.dl", "one/rules.dl"]);

    // Names of programs that share a file with the renamed name, also of closed ones.
    for (new, words) in [
        ("New", "already declared"),
        ("A", "already declared"),
        ("place", "already declared"),
    ] {
        let refused = editor.at(
            "textDocument/rename",
            "one/rules.dl",
            (0, 11),
            json!({ "newName": new }),
        );
        assert!(refused["message"].as_str().unwrap().contains(words), "{refused}");
    }
    // Without the second folder, its files are out of reach.
    let folder = json!({ "uri": editor.uri("two"), "name": "two" });
    let event = json!({ "event": { "added": [], "removed": [folder] } });
    editor.notify("workspace/didChangeWorkspaceFolders", event);
    let renamed = editor.rename("one/rules.dl", (0, 11), "A", &[("one/rules.dl", rules)]);
    assert_eq!(renamed.keys().collect::<Vec<_>>(), ["one/decls.dl", "one/rules.dl"]);
    // A file that is deleted on disk is still open in the editor.
    fs::remove_file(editor.path("one/rules.dl")).unwrap();
    let renamed = editor.rename("one/rules.dl", (0, 11), "A", &[("one/rules.dl", rules)]);
    assert_eq!(renamed["one/rules.dl"], "New(x) :- A(x).\n");
    editor.end();
}

#[test]
fn edits_name_the_versions_of_open_texts() {
    let capabilities = json!({ "workspace": { "workspaceEdit": { "documentChanges": true } } });
    let mut editor = workspace(capabilities);
    editor.open("one/rules.dl", "New(x) :- Old(x).\n");
    editor.change("one/rules.dl", "New(x) :- Old(x), Old(_).\n");
    let edit = editor.at(
        "textDocument/rename",
        "one/rules.dl",
        (0, 11),
        json!({ "newName": "Given" }),
    );
    let changes = edit["documentChanges"].as_array().unwrap();
    let named: Vec<(String, &Value, usize)> = changes
        .iter()
        .map(|change| {
            let document = &change["textDocument"];
            let name = editor.name(document["uri"].as_str().unwrap());
            (name, &document["version"], change["edits"].as_array().unwrap().len())
        })
        .collect();
    let expected = [
        ("one/decls.dl".to_owned(), &Value::Null, 2),
        ("one/rules.dl".to_owned(), &json!(2), 2),
        ("two/deep/user.dl".to_owned(), &Value::Null, 1),
    ];
    assert_eq!(named, expected);
    editor.end();
}

/// Words of the language, and texts that are no names.
const WORDS: &[&str] = &[
    "count", "sum", "min", "max", "mean", "range", "cat", "as", "match", "contains", "strlen", "band", "lnot", "true",
    "false", "once", "for", "since", "not", "Not", "_", "1a", "a-b", "a b", "", "number", "\u{e9}",
];

#[test]
fn a_rename_never_changes_what_the_text_means() {
    let mut editor = Editor::start();
    let text = ".type t <: number\n.decl P, Q(x: t)\n.input Q\nP(x) :- Q(x), y = (x) + 1, y > 3, \
                n = count : { Q(x), Q(z), z > y }, n > 1.\nP(x) :- Q(x), x = as(3, t).\n";
    editor.open("a.dl", text);
    let places = [
        (1, 6),
        (3, 0),
        (3, 8),
        (0, 6),
        (3, 19),
        (3, 2),
        (3, 14),
        (4, 24),
        (3, 60),
    ];
    for place in places {
        for new in WORDS.iter().chain(&["P", "Q", "x", "t", "fine"]) {
            let answer = editor.at("textDocument/rename", "a.dl", place, json!({ "newName": new }));
            let Some(changes) = answer["changes"].as_object() else {
                assert!(answer["message"].is_string(), "{place:?} {new}: {answer}");
                continue;
            };
            let Some(edits) = changes.get(&editor.uri("a.dl")) else {
                continue;
            };
            let renamed = edited(text, edits.as_array().unwrap());
            let faults = editor.change("a.dl", &renamed);
            assert!(faults.is_empty(), "{place:?} {new}: {faults:?}\n{renamed}");
            // Renaming back restores the text, so nothing else has the new name.
            let line = text.lines().nth(place.0 as usize).unwrap();
            let old: String = line[place.1 as usize..]
                .chars()
                .take_while(char::is_ascii_alphanumeric)
                .collect();
            let shift = edits.as_array().unwrap().iter().filter(|edit| {
                let start = &edit["range"]["start"];
                start["line"] == place.0 && start["character"].as_u64().unwrap() < u64::from(place.1)
            });
            let shift = i64::try_from(shift.count()).unwrap() * (new.len() as i64 - old.len() as i64);
            let column = u32::try_from(i64::from(place.1) + shift).unwrap();
            let back = editor.at(
                "textDocument/rename",
                "a.dl",
                (place.0, column),
                json!({ "newName": old }),
            );
            let edits = back["changes"][editor.uri("a.dl")]
                .as_array()
                .unwrap_or_else(|| panic!("{new}: {back}"));
            assert_eq!(edited(&renamed, edits), text, "{place:?} {new}");
            editor.change("a.dl", text);
        }
    }
    for new in WORDS {
        let answer = editor.at("textDocument/rename", "a.dl", (3, 19), json!({ "newName": new }));
        assert!(answer["message"].is_string(), "{new}: {answer}");
    }
    // What nothing declares, and what the language declares, keeps its name.
    editor.change("a.dl", "P(x) :- Q(x).\n");
    let refused = editor.at("textDocument/rename", "a.dl", (0, 8), json!({ "newName": "R" }));
    assert!(
        refused["message"].as_str().unwrap().contains("not declared"),
        "{refused}"
    );
    editor.change("a.dl", text);
    let renamed = editor.at("textDocument/prepareRename", "a.dl", (0, 12), json!({}));
    assert_eq!(renamed, Value::Null, "a base type");
    editor.end();
}

#[test]
fn a_built_in_file_keeps_its_names() {
    let mut editor = Editor::start();
    let main = ".include \"vocabulary.dl\"\nStop(X) :- IsCar(X), CollidingClose(X, _).\n";
    editor.open("main.dl", main);
    let definition = editor.at("textDocument/definition", "main.dl", (1, 12), json!({}));
    let copy = definition["uri"].as_str().unwrap().to_owned();
    let name = editor.name(&copy);
    let text = fs::read_to_string(editor.path(&name)).unwrap();
    editor.open(&name, &text);
    let place = &definition["range"]["start"];
    let place = (
        place["line"].as_u64().unwrap() as u32,
        place["character"].as_u64().unwrap() as u32,
    );
    // The copy stands for the built-in file: it has the same references, and none of its names can change.
    let asked = json!({ "context": { "includeDeclaration": true } });
    let found = editor.at("textDocument/references", &name, place, asked.clone());
    assert_eq!(found, editor.at("textDocument/references", "main.dl", (1, 12), asked));
    assert!(
        found
            .as_array()
            .unwrap()
            .iter()
            .any(|one| one["uri"] == editor.uri("main.dl")),
        "{found}"
    );
    for (file, place) in [(name.as_str(), place), ("main.dl", (1, 12))] {
        let refused = editor.at("textDocument/rename", file, place, json!({ "newName": "IsAuto" }));
        assert!(refused["message"].as_str().unwrap().contains("read-only"), "{refused}");
    }
    editor.end();
}

/// What the server knows of a text.
fn known(editor: &mut Editor, name: &str, diagnostics: Vec<Value>) -> Value {
    let of = |editor: &mut Editor, method: &str| editor.of(method, name);
    let mut diagnostics = Value::from(diagnostics);
    for one in diagnostics.as_array_mut().unwrap() {
        one["relatedInformation"].take();
    }
    json!({
        "diagnostics": diagnostics,
        "tokens": of(editor, "textDocument/semanticTokens/full")["data"],
        "symbols": of(editor, "textDocument/documentSymbol").as_array().unwrap().iter().map(|one| one["location"]["range"].clone()).collect::<Value>(),
        "folds": of(editor, "textDocument/foldingRange"),
        "format": of(editor, "textDocument/formatting"),
    })
}

#[test]
fn incremental_changes_equal_the_whole_text() {
    let mut editor = Editor::start();
    editor.open("a.dl", "");
    editor.open("b.dl", "");
    editor.diagnostics("a.dl");
    let part = prop_oneof![
        Just(".decl A(x: symbol)"),
        Just("A(\"\u{1f697}\")."),
        Just("\n"),
        Just("\r\n"),
        Just("\r"),
        Just("// \u{1f697}\u{e9}"),
        Just("A(x) :- A(x), x != \"b\"."),
        Just("/* "),
        Just(" */"),
        Just("\""),
        Just("\u{1f697}"),
        Just(" "),
        Just("A"),
        Just("("),
        Just(","),
    ];
    let text = proptest::collection::vec(part, 0..12).prop_map(|parts| parts.concat());
    let position = || (0_u32..14, 0_u32..24);
    let edit = (position(), position(), text.clone());
    let strategy = (
        text,
        proptest::collection::vec(proptest::collection::vec(edit, 1..4), 1..5),
    );
    let mut runner = TestRunner::new(cases(64));
    let editor = std::cell::RefCell::new(editor);
    let checked = runner.run(&strategy, |(mut plain, batches)| {
        let editor = &mut *editor.borrow_mut();
        editor.change("a.dl", &plain);
        for batch in batches {
            let mut edits = Vec::new();
            for (one, other, new) in &batch {
                let [start, end] = [one.min(other), one.max(other)]
                    .map(|(line, character)| json!({ "line": line, "character": character }));
                let bytes = byte_of(&plain, &start)..byte_of(&plain, &end);
                plain.replace_range(bytes, new);
                edits.push(([start, end], new.as_str()));
            }
            let diagnostics = editor.edit("a.dl", &edits);
            let fast = known(editor, "a.dl", diagnostics);
            let diagnostics = editor.change("b.dl", &plain);
            let slow = known(editor, "b.dl", diagnostics);
            prop_assert_eq!(&fast.to_string(), &slow.to_string(), "{:?}", plain);
        }
        Ok(())
    });
    checked.unwrap();
    editor.into_inner().end();
}

#[test]
fn the_client_chooses_the_unit_of_columns() {
    for (encodings, chosen, column) in [
        (json!(["utf-8", "utf-16"]), "utf-8", 3 + 4 + 3),
        (json!(["utf-32"]), "utf-32", 3 + 1 + 3),
        (json!(["utf-7", "utf-16"]), "utf-16", 3 + 2 + 3),
        (json!(["utf-7"]), "utf-16", 3 + 2 + 3),
    ] {
        let mut editor = Editor::with(json!({ "general": { "positionEncodings": encodings } }), &[]);
        assert_eq!(editor.welcome["capabilities"]["positionEncoding"], chosen);
        editor.open("a.dl", ".decl A(x: symbol)\n/* \u{1f697} */A(\"b\").\n");
        let found = editor.at(
            "textDocument/references",
            "a.dl",
            (0, 6),
            json!({ "context": { "includeDeclaration": false } }),
        );
        assert_eq!(found[0]["range"], range(1, column, column + 1), "{chosen}");
        let shown = editor.at("textDocument/hover", "a.dl", (1, column), json!({}));
        assert_eq!(shown["range"], range(1, column, column + 1), "{chosen}");
        // Edits use the same unit.
        let at = |character: u32| json!({ "line": 1, "character": character });
        let faults = editor.edit("a.dl", &[([at(column), at(column + 1)], "B")]);
        assert_eq!(
            (codes(&faults), &faults[0]["range"]),
            (vec!["unknown-predicate"], &range(1, column, column + 1))
        );
        editor.end();
    }
}

/// Returns the words of a text with their types, from the numbers of the protocol.
fn tokens(editor: &Editor, text: &str, data: &Value) -> Vec<(usize, String, String)> {
    let legend = &editor.welcome["capabilities"]["semanticTokensProvider"]["legend"];
    let numbers: Vec<u64> = data
        .as_array()
        .unwrap()
        .iter()
        .map(|one| one.as_u64().unwrap())
        .collect();
    let (mut line, mut column) = (0, 0);
    let decoded = numbers.chunks(5).map(|token| {
        if token[0] > 0 {
            (line, column) = (line + token[0], 0);
        }
        column += token[1];
        let [start, end] = [column, column + token[2]]
            .map(|character| byte_of(text, &json!({ "line": line, "character": character })));
        let mut kind = legend["tokenTypes"][token[3] as usize].as_str().unwrap().to_owned();
        for (bit, modifier) in legend["tokenModifiers"].as_array().unwrap().iter().enumerate() {
            if token[4] >> bit & 1 == 1 {
                kind += &format!(" {}", modifier.as_str().unwrap());
            }
        }
        (start, text[start..end].to_owned(), kind)
    });
    decoded.collect()
}

#[test]
fn words_have_semantic_tokens() {
    let mut editor = Editor::start();
    let text = ".include \"vocabulary.dl\"\r\n/* \u{1f697}\r\n two */ .type t <: number // one\n\
                .decl P(x: t)\nP(x) :- Not(IsCar(y)), x = count : { Sees(y, _) }, x = 3 band strlen(\"\u{1f697}\").\n";
    editor.open("a.dl", text);
    let full = editor.of("textDocument/semanticTokens/full", "a.dl");
    let found = tokens(&editor, text, &full["data"]);
    let shown: Vec<(&str, &str)> = found
        .iter()
        .map(|(_, word, kind)| (word.as_str(), kind.as_str()))
        .collect();
    let expected = [
        (".include", "keyword"),
        ("\"vocabulary.dl\"", "string"),
        ("/* \u{1f697}", "comment"),
        (" two */", "comment"),
        (".type", "keyword"),
        ("t", "type declaration"),
        ("number", "type defaultLibrary"),
        ("// one", "comment"),
        (".decl", "keyword"),
        ("P", "function declaration"),
        ("x", "parameter declaration"),
        ("t", "type"),
        ("P", "function definition"),
        ("x", "variable"),
        ("Not", "keyword"),
        ("IsCar", "function defaultLibrary"),
        ("y", "variable"),
        ("x", "variable"),
        ("count", "keyword"),
        ("Sees", "function defaultLibrary"),
        ("y", "variable"),
        ("x", "variable"),
        ("3", "number"),
        ("band", "operator"),
        ("strlen", "function defaultLibrary"),
        ("\"\u{1f697}\"", "string"),
    ];
    assert_eq!(shown, expected);

    // A range has those of the whole that touch it.
    for (from, to) in [((0, 0), (99, 0)), ((3, 0), (4, 3)), ((1, 0), (2, 1)), ((5, 0), (6, 0))] {
        let [start, end] = [from, to].map(|(line, character)| json!({ "line": line, "character": character }));
        let bytes = byte_of(text, &start)..byte_of(text, &end);
        let params = json!({ "textDocument": { "uri": editor.uri("a.dl") }, "range": { "start": start, "end": end } });
        let part = editor.ask("textDocument/semanticTokens/range", params);
        let touching = found
            .iter()
            .filter(|(start, word, _)| *start < bytes.end && bytes.start < start + word.len());
        assert_eq!(
            tokens(&editor, text, &part["data"]),
            touching.cloned().collect::<Vec<_>>()
        );
    }

    // A delta turns the former answer into the new one.
    let mut data: Vec<Value> = full["data"].as_array().unwrap().clone();
    let mut name = full["resultId"].clone();
    for changed in [
        text.replace("3 band", "4 band 5 band"),
        text.to_owned(),
        text.to_owned(),
        String::new(),
        text.to_owned(),
    ] {
        editor.change("a.dl", &changed);
        let params = json!({ "textDocument": { "uri": editor.uri("a.dl") }, "previousResultId": name });
        let delta = editor.ask("textDocument/semanticTokens/full/delta", params);
        for edit in delta["edits"].as_array().unwrap() {
            let [start, count] = ["start", "deleteCount"].map(|key| edit[key].as_u64().unwrap() as usize);
            let added = edit["data"].as_array().into_iter().flatten().cloned();
            data.splice(start..start + count, added);
        }
        name = delta["resultId"].clone();
        let full = editor.of("textDocument/semanticTokens/full", "a.dl");
        assert_eq!(Value::from(data.clone()), full["data"]);
        name = if full["resultId"] == Value::Null {
            name
        } else {
            full["resultId"].clone()
        };
    }
    // An unknown result has no delta.
    let params = json!({ "textDocument": { "uri": editor.uri("a.dl") }, "previousResultId": "none" });
    let whole = editor.ask("textDocument/semanticTokens/full/delta", params);
    assert_eq!(whole["data"], Value::from(data));
    editor.end();
}

#[test]
fn parts_of_a_text_can_be_folded() {
    let text = "\
// one
// two
.include \"vocabulary.dl\"
.include \"vocabulary.dl\"
.decl P(
  x: agent
)
.scope Sees
Stop(X) :-
  IsCar(X),
  count : {
    IsClose(X, Y)
  } > 1.
.scope
/* three
*/
P(\"a\"). // four
";
    let mut editor = Editor::with(
        json!({ "textDocument": { "foldingRange": { "lineFoldingOnly": true } } }),
        &[],
    );
    editor.open("a.dl", text);
    let lines = |folds: &Value| -> Vec<(u64, u64, String)> {
        let folds = folds.as_array().unwrap().iter();
        folds
            .map(|fold| {
                assert!(fold.get("startCharacter").is_none(), "{fold}");
                let [start, end] = ["startLine", "endLine"].map(|key| fold[key].as_u64().unwrap());
                (start, end, fold["kind"].as_str().unwrap_or_default().to_owned())
            })
            .collect()
    };
    let expected = [
        (0, 1, "comment"),
        (2, 3, "imports"),
        (4, 6, ""),
        (7, 12, "region"),
        (8, 12, ""),
        (10, 12, ""),
        (14, 15, "comment"),
    ];
    let found = editor.of("textDocument/foldingRange", "a.dl");
    assert_eq!(
        lines(&found),
        expected.map(|(start, end, kind)| (start, end, kind.to_owned()))
    );
    editor.end();

    let mut editor = Editor::with(json!({ "textDocument": { "foldingRange": { "rangeLimit": 2 } } }), &[]);
    editor.open("a.dl", text);
    let found = editor.of("textDocument/foldingRange", "a.dl");
    assert_eq!(found.as_array().unwrap().len(), 2);
    assert_eq!(
        (&found[0]["startCharacter"], &found[0]["endCharacter"]),
        (&json!(0), &json!(6))
    );
    editor.end();
}

#[test]
fn occurrences_in_the_text_are_highlighted() {
    let mut editor = Editor::start();
    editor.open("a.dl", RULES);
    let found = editor.at("textDocument/documentHighlight", "a.dl", (5, 1), json!({}));
    let column = "/* \u{e9} \u{1f697} */ ".encode_utf16().count() as u32;
    let body = column + "Way(x, z) :- ".len() as u32;
    let expected = [(3, 6, 3), (4, column, 3), (4, body, 2), (5, 0, 3)];
    let expected = expected.map(|(line, start, kind)| json!({ "range": range(line, start, start + 3), "kind": kind }));
    assert_eq!(found, Value::from(expected.to_vec()));
    // A variable of one clause.
    let found = editor.at("textDocument/documentHighlight", "a.dl", (5, 4), json!({}));
    assert_eq!(found.as_array().unwrap().len(), 2);
    assert_eq!(
        editor.at("textDocument/documentHighlight", "a.dl", (99, 4), json!({})),
        Value::Null
    );
    editor.end();
}

#[test]
fn the_columns_of_an_atom_are_shown_while_it_is_written() {
    let mut editor = Editor::start();
    let text = "/// A road \u{1f697}.\n.decl Road(from: symbol, to: symbol)\n.decl P(x: symbol)\nP(x) :- Road(x, \"a, (\", y), n = count : { Road(";
    editor.open("a.dl", text);
    let line = text.lines().last().unwrap();
    let mut help = |before: &str| {
        let column = (line.find(before).unwrap() + before.len()) as u32;
        let answer = editor.at("textDocument/signatureHelp", "a.dl", (3, column), json!({}));
        let signature = &answer["signatures"][0];
        let parameters = signature["parameters"].as_array().into_iter().flatten();
        let labels: Vec<String> = parameters
            .map(|one| one["label"].as_str().unwrap().to_owned())
            .collect();
        (
            signature["label"].as_str().unwrap_or_default().to_owned(),
            labels.join("; "),
            answer["activeParameter"].clone(),
        )
    };
    let road = |active: u64| {
        (
            "Road(from: symbol, to: symbol)".to_owned(),
            "from: symbol; to: symbol".to_owned(),
            json!(active),
        )
    };
    let none = (String::new(), String::new(), Value::Null);
    assert_eq!(help("Road("), road(0));
    assert_eq!(help("Road(x,"), road(1));
    assert_eq!(help("\"a, ("), none, "in a string");
    assert_eq!(help("(\", y"), road(2));
    assert_eq!(help("y), n"), none, "after the atom");
    assert_eq!(help("{ "), none, "in an aggregate");
    assert_eq!(help("{ Road("), road(0));
    assert_eq!(
        help("P("),
        ("P(x: symbol)".to_owned(), "x: symbol".to_owned(), json!(0))
    );
    editor.change(
        "a.dl",
        ".decl A(x: symbol)\n.input A(filename=\"a\")\nA(x) :- x = cat(\"a\", \"b\", \"c\", substr( // f(\n",
    );
    let mut at = |line: u32, column: u32| {
        let answer = editor.at("textDocument/signatureHelp", "a.dl", (line, column), json!({}));
        (
            answer["signatures"][0]["label"].clone(),
            answer["activeParameter"].clone(),
        )
    };
    assert_eq!(at(0, 8).0, Value::Null, "a declaration");
    assert_eq!(at(1, 9).0, Value::Null, "the options of a directive");
    assert_eq!(at(2, 16), (json!("cat(s, t, ...)"), json!(0)));
    assert_eq!(at(2, 31), (json!("cat(s, t, ...)"), json!(2)));
    assert_eq!(at(2, 38), (json!("substr(s, from, length)"), json!(0)));
    assert_eq!(at(2, 44).0, Value::Null, "a comment");
    editor.end();
}

#[test]
fn symbols_of_the_workspace_are_found_by_their_letters() {
    let mut editor = workspace(json!({}));
    editor.open("two/new.dl", ".decl OlderName(x: symbol)\n");
    let mut named = |query: &str| -> Vec<String> {
        let found = editor.ask("workspace/symbol", json!({ "query": query }));
        let found = found.as_array().unwrap().iter();
        found
            .map(|one| {
                let uri = editor.name(one["location"]["uri"].as_str().unwrap());
                format!(
                    "{} {uri}:{}",
                    one["name"].as_str().unwrap(),
                    one["location"]["range"]["start"]["line"]
                )
            })
            .collect()
    };
    assert_eq!(
        named("old"),
        ["Old one/decls.dl:1", "Old two/apart.dl:0", "OlderName two/new.dl:0"]
    );
    assert_eq!(named("ON"), ["OlderName two/new.dl:0"]);
    assert_eq!(named("PLACE"), ["place one/decls.dl:0"]);
    assert_eq!(named("zz"), Vec::<String>::new());
    assert!(named("").len() >= 6);
    editor.end();
}

#[test]
fn changes_on_disk_reach_the_texts_that_include_a_file() {
    let capabilities = json!({ "workspace": { "didChangeWatchedFiles": { "dynamicRegistration": true } } });
    let mut editor = Editor::with(capabilities, &[]);
    // The server asks the client to watch rule files and configurations.
    match Message::read(&mut editor.from).unwrap() {
        Some(Message::Request(request)) => {
            assert_eq!(request.method, "client/registerCapability");
            assert_eq!(
                request.params["registrations"][0]["registerOptions"]["watchers"][0]["globPattern"],
                "**/*.{dl,yaml,yml}"
            );
            editor.send(Message::Response(lsp_server::Response::new_ok(request.id, Value::Null)));
        }
        other => panic!("{other:?}"),
    }
    assert_eq!(
        codes(&editor.open("main.dl", ".include \"parts.dl\"\nA(\"a\").\n")),
        ["missing-include"]
    );
    let changed = |editor: &mut Editor, kind: u32| {
        let change = json!({ "uri": editor.uri("parts.dl"), "type": kind });
        editor.notify("workspace/didChangeWatchedFiles", json!({ "changes": [change] }));
        editor.diagnostics("main.dl")
    };
    editor.write("parts.dl", ".decl A(x: symbol)\n");
    assert!(changed(&mut editor, 1).is_empty());
    editor.write("parts.dl", ".decl A(x: number)\n");
    assert_eq!(codes(&changed(&mut editor, 2)), ["type-mismatch"]);
    fs::rename(editor.path("parts.dl"), editor.path("part.dl")).unwrap();
    assert_eq!(codes(&changed(&mut editor, 3)), ["missing-include"]);
    editor.end();
}

/// Text that macros and instances of components wrote has the places that the user wrote.
#[test]
fn macros_and_components_have_places_in_the_text() {
    let mut editor = Editor::start();
    let text = "#define ARC(x) edge(x, x)\n.comp G<T> {\n.decl edge(x: T)\n.decl p(x: T)\n.output p\n.input edge\np(x) :- ARC(x).\n}\n\
                .init g = G<number>\n";
    let found = editor.open("main.dl", text);
    assert_eq!(codes(&found), ["arity-mismatch"]);
    assert_eq!(found[0]["range"], range(6, 8, 14));
    let related = found[0]["relatedInformation"].as_array().unwrap();
    let lines: Vec<u64> = related
        .iter()
        .map(|one| one["location"]["range"]["start"]["line"].as_u64().unwrap())
        .collect();
    assert!(lines.contains(&0) && lines.contains(&8), "{related:?}");
    for method in ["documentSymbol", "foldingRange", "semanticTokens/full", "formatting"] {
        let params = json!({ "textDocument": { "uri": editor.uri("main.dl") }, "options": { "tabSize": 4, "insertSpaces": true } });
        editor.ask(&format!("textDocument/{method}"), params);
    }
    assert!(
        editor
            .change("main.dl", &text.replace("edge(x, x)", "edge(x)"))
            .is_empty()
    );
    editor.end();
}

#[test]
fn a_client_gets_what_it_can_show() {
    let hover = json!({ "hover": { "contentFormat": ["plaintext"] }, "documentSymbol": { "hierarchicalDocumentSymbolSupport": true },
        "rename": { "prepareSupport": true }, "signatureHelp": { "signatureInformation": { "parameterInformation": { "labelOffsetSupport": true } } } });
    let mut editor = Editor::with(json!({ "textDocument": hover }), &[]);
    assert_eq!(
        editor.welcome["capabilities"]["renameProvider"],
        json!({ "prepareProvider": true })
    );
    editor.open("a.dl", RULES);
    let shown = editor.at("textDocument/hover", "a.dl", (5, 14), json!({}));
    assert_eq!(
        shown["contents"],
        json!({ "kind": "plaintext", "value": ".decl Road(x: place, y: place)\n\nA road for cars." })
    );
    let symbols = editor.of("textDocument/documentSymbol", "a.dl");
    assert_eq!(symbols[1]["selectionRange"], range(2, 6, 10));
    let help = editor.at("textDocument/signatureHelp", "a.dl", (5, 18), json!({}));
    assert_eq!(
        help["signatures"][0]["parameters"],
        json!([{ "label": [5, 13] }, { "label": [15, 23] }])
    );
    editor.end();

    let mut editor = Editor::start();
    assert_eq!(editor.welcome["capabilities"]["renameProvider"], true);
    editor.open("a.dl", RULES);
    let symbols = editor.of("textDocument/documentSymbol", "a.dl");
    assert_eq!(
        symbols[1]["location"],
        json!({ "uri": editor.uri("a.dl"), "range": range(2, 6, 10) })
    );
    editor.end();
}

/// Sends bytes to the server. Returns its exit code and what it wrote.
fn exchanged(messages: &[&str]) -> (Option<i32>, String) {
    let mut process = Command::new(env!("CARGO_BIN_EXE_logicity"))
        .arg("lsp")
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let mut to = process.stdin.take().unwrap();
    for text in messages {
        write!(to, "Content-Length: {}\r\n\r\n{text}", text.len()).unwrap();
    }
    drop(to);
    let mut written = String::new();
    process.stdout.take().unwrap().read_to_string(&mut written).unwrap();
    (process.wait().unwrap().code(), written)
}

#[test]
fn the_server_keeps_to_the_life_that_the_protocol_prescribes() {
    let begin = r#"{"jsonrpc":"2.0","id":1,"method":"initialize","params":{"capabilities":{}}}"#;
    let begun = r#"{"jsonrpc":"2.0","method":"initialized","params":{}}"#;
    let early = r#"{"jsonrpc":"2.0","id":"early","method":"textDocument/hover","params":{}}"#;
    let down = r#"{"jsonrpc":"2.0","id":2,"method":"shutdown"}"#;
    let late = r#"{"jsonrpc":"2.0","id":3,"method":"workspace/symbol","params":{"query":""}}"#;
    let exit = r#"{"jsonrpc":"2.0","method":"exit"}"#;
    // What it sends, the exit code, and parts of the answers.
    let cases: [(&[&str], i32, &[&str]); 9] = [
        (
            &[early, begin, begun, down, exit],
            0,
            &["-32002", r#""id":"early""#, r#""id":2,"result":null"#],
        ),
        (&[begin, down, late, exit], 0, &["-32600", r#""id":3"#]),
        (&[begin, begin, down, exit], 0, &["-32600"]),
        (&[begin, begun, exit], 1, &["capabilities"]),
        (&[exit], 1, &[]),
        (&[begin, begun], 0, &["capabilities"]),
        (&[begin, begun, down], 0, &[r#""id":2,"result":null"#]),
        (
            &[begin, "{", begun, down, exit],
            0,
            &["-32700", r#""id":null"#, r#""id":2,"result":null"#],
        ),
        (
            &[
                begin,
                "[]",
                r#"{"jsonrpc":"2.0"}"#,
                r#"{"id":{},"method":"x"}"#,
                "null",
                down,
                exit,
            ],
            0,
            &["-32700", r#""id":2,"result":null"#],
        ),
    ];
    for (messages, code, parts) in cases {
        let (found, written) = exchanged(messages);
        assert_eq!(found, Some(code), "{messages:?}: {written}");
        for part in parts {
            assert!(written.contains(part), "{messages:?}: {written}");
        }
    }
}

#[test]
fn a_cancelled_request_is_not_answered_in_full() {
    let mut editor = Editor::start();
    // The check of a long text keeps the server busy, so that it sees the cancellation first.
    let facts: String = (0..20_000).map(|number| format!("A({number}).\n")).collect();
    let document = json!({ "uri": editor.uri("a.dl"), "languageId": "logicity", "version": 1, "text": format!(".decl A(x: number)\n{facts}") });
    editor.notify("textDocument/didOpen", json!({ "textDocument": document }));
    let id = RequestId::from("long".to_owned());
    let params = json!({ "query": "" });
    editor.send(Message::Request(Request::new(
        id.clone(),
        "workspace/symbol".to_owned(),
        params,
    )));
    editor.notify("$/cancelRequest", json!({ "id": "long" }));
    editor.notify("$/cancelRequest", json!({ "id": 77 }));
    let answer = loop {
        if let Message::Response(response) = Message::read(&mut editor.from).unwrap().unwrap() {
            break response;
        }
    };
    assert_eq!(answer.id, id);
    assert_eq!(answer.response_result.unwrap_err().code, -32800);
    assert!(editor.ask("workspace/symbol", json!({ "query": "" })).is_array());
    editor.end();
}

#[test]
fn the_server_ends_with_the_process_of_its_client() {
    let mut client = Command::new("sleep").arg("100").spawn().unwrap();
    let mut server = Command::new(env!("CARGO_BIN_EXE_logicity"))
        .arg("lsp")
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut to = server.stdin.take().unwrap();
    let params = json!({ "processId": client.id(), "capabilities": {} });
    Message::Request(Request::new(1.into(), "initialize".to_owned(), params))
        .write(&mut to)
        .unwrap();
    let mut from = BufReader::new(server.stdout.take().unwrap());
    assert!(Message::read(&mut from).unwrap().is_some());
    client.kill().unwrap();
    client.wait().unwrap();
    // The connection stays open.
    assert_eq!(server.wait().unwrap().code(), Some(1));
    drop(to);
}

/// Long texts, for which a step that is quadratic in their length takes minutes.
#[test]
fn long_texts_are_checked_in_seconds() {
    const LINES: usize = 36_000;
    let many = |line: &dyn Fn(usize) -> String, lines: usize| (0..LINES / lines).map(line).collect::<String>();
    let begin = ".decl A, C(x: symbol)\n.input A, C\n.implies A, C\n";
    let texts = [
        many(&|n| format!(".decl P{n}(x: number)\n.output P{n}\nP{n}({n}).\n"), 3),
        many(
            &|n| format!(".decl P{n}(x: number)\n.pragma \"magic-transform\" \"P{n},*\"\n"),
            2,
        ),
        many(&|n| format!("/// doc\n.decl P{n}(x: number)\n"), 2),
        begin.to_owned()
            + &many(
                &|n| format!(".decl B{n}(x: symbol)\n.output B{n}\nB{n}(x) :- A(x), C(x), x != \"k{n}\".\n"),
                60,
            ),
        begin.to_owned()
            + ".decl B(x: symbol)\n.output B\n"
            + &many(&|n| format!("B(x) :- A(x), A(y), C(x), x != y, x != \"k{n}\".\n"), 60),
        many(
            &|n| {
                format!(
                    ".type t{n} <: number\n.type u{n} = t{n} | t0\n.decl P{n}(x: u{n})\nP{n}(x) :- P{n}(x), P0(x).\n"
                )
            },
            12,
        ),
        ".decl A(x: number)\n.output A\n".to_owned() + &many(&|n| format!("A({n}). /* \u{1f697} */ "), 6),
    ];
    let mut editor = Editor::start();
    editor.open("a.dl", "");
    for text in &texts {
        let start = Instant::now();
        // The number of lints has a bound, too.
        assert!(editor.change("a.dl", text).len() < 500);
        let last = text.lines().count() as u32;
        editor.edit(
            "a.dl",
            &[(
                [
                    json!({ "line": last, "character": 0 }),
                    json!({ "line": last, "character": 0 }),
                ],
                "A",
            )],
        );
        let found = editor.at("textDocument/completion", "a.dl", (last, 1), json!({}));
        let items = found.as_array().or(found["items"].as_array()).unwrap();
        assert!(items.len() < 1100, "{}", items.len());
        for method in [
            "textDocument/documentSymbol",
            "textDocument/foldingRange",
            "textDocument/semanticTokens/full",
        ] {
            editor.of(method, "a.dl");
        }
        editor.at("textDocument/documentHighlight", "a.dl", (2, 7), json!({}));
        assert!(
            start.elapsed() < Duration::from_secs(60),
            "{:?}: {}",
            start.elapsed(),
            &text[..60]
        );
    }
    editor.end();
}

/// Rules with a configuration beside them are checked for that city, as `check` of the configuration does.
#[test]
fn rules_are_checked_in_the_city_beside_them() {
    let mut editor = Editor::start();
    let text = ".include \"vocabulary.dl\"\n.decl IsTaxi(x: agent)\n.input IsTaxi\n.implies IsTaxi, IsPedestrian\n\
                Stop(X) :- CollidingClose(X, Y).\nSlow(X) :- Not(Stop(X)), IsTaxi(X), IsCar(X).\n";
    let codes = |found: Vec<Value>| -> Vec<(String, u64)> {
        let one = |fault: &Value| {
            let line = fault["range"]["start"]["line"].as_u64().unwrap();
            (fault["code"].as_str().unwrap().to_owned(), line)
        };
        found.iter().filter(|fault| fault["severity"] != 3).map(one).collect()
    };
    let alone = editor.open("taxi.dl", text);
    assert_eq!(codes(alone), [("contradictory-body".to_owned(), 5)]);
    fs::write(
        editor.path("city.yaml"),
        "base: expert\nrules: taxi.dl\npredicates:\n  base: standard\n  define: {IsTaxi: {concept: taxi, of: Car}}\n\
         agents:\n  test: {cars: [{count: 3, concepts: [taxi], priority: 1}]}\n",
    )
    .unwrap();
    let in_city = editor.change("taxi.dl", text);
    assert_eq!(codes(in_city), [("constraint-mismatch".to_owned(), 3)]);
    let unknown = editor.change(
        "taxi.dl",
        &text
            .replace(".implies IsTaxi, IsPedestrian", ".decl Odd(x: agent) .input Odd")
            .replace("IsCar(X).", "Odd(X)."),
    );
    assert_eq!(codes(unknown), [("rule-mismatch".to_owned(), 3)]);
    editor.end();
}

/// A configuration may have its rules from a base in another folder, and the editor may have changed that base.
#[test]
fn configurations_follow_their_bases_and_open_texts() {
    let mut editor = Editor::start();
    let codes = |found: &[Value]| -> Vec<String> {
        let severe = found.iter().filter(|fault| fault["severity"] != 3);
        severe.map(|fault| fault["code"].as_str().unwrap().to_owned()).collect()
    };
    let base = |kind: &str| {
        format!(
            "base: expert\nrules: ../taxi.dl\npredicates: {{base: standard, define: {{IsTaxi: {{kind: {kind}}}}}}}\n"
        )
    };
    fs::create_dir(editor.path("shared")).unwrap();
    fs::write(editor.path("shared/base.yaml"), base("Car")).unwrap();
    fs::write(editor.path("city.yaml"), "base: shared/base.yaml\n").unwrap();
    let text = ".include \"vocabulary.dl\"\n.decl IsTaxi(x: agent)\n.input IsTaxi\n.implies IsTaxi, IsCar\n\
                Stop(X) :- CollidingClose(X, Y).\nSlow(X) :- Not(Stop(X)), IsTaxi(X).\n";
    assert!(codes(&editor.open("taxi.dl", text)).is_empty());

    let (uri, version) = (editor.uri("shared/base.yaml"), 1);
    let document = json!({ "uri": uri, "languageId": "yaml", "version": version, "text": base("Pedestrian") });
    editor.notify("textDocument/didOpen", json!({ "textDocument": document }));
    assert_eq!(codes(&editor.diagnostics("taxi.dl")), ["constraint-mismatch"]);
    let changes = json!([{ "text": base("Car") }]);
    let change = json!({ "textDocument": { "uri": uri, "version": version + 1 }, "contentChanges": changes });
    editor.notify("textDocument/didChange", change);
    assert!(codes(&editor.diagnostics("taxi.dl")).is_empty());
    let refused = editor.at("textDocument/hover", "shared/base.yaml", (0, 0), json!({}));
    assert!(
        refused["message"].as_str().unwrap().ends_with("is not a rule file"),
        "{refused}"
    );
    editor.end();
}

/// A server that needs more memory than allowed ends, and the editor starts a new one.
#[test]
#[cfg(target_os = "linux")]
fn memory_is_limited() {
    let mut server = Command::new(env!("CARGO_BIN_EXE_logicity"))
        .args(["lsp", "--max-memory", "64"])
        .stdin(Stdio::piped())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut to = server.stdin.take().unwrap();
    let request = Request::new(
        RequestId::from(1),
        "initialize".to_owned(),
        json!({ "capabilities": {} }),
    );
    Message::Request(request).write(&mut to).unwrap();
    let text: String = (0..400_000).map(|number| format!("A({number}).\n")).collect();
    let document = json!({ "uri": "file:///a.dl", "languageId": "logicity", "version": 1, "text": text });
    let open = Notification::new("textDocument/didOpen".to_owned(), json!({ "textDocument": document }));
    // The server may end before it has read everything.
    let _ = Message::Notification(open).write(&mut to);
    let output = server.wait_with_output().unwrap();
    let printed = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{printed}");
    assert!(printed.contains("--max-memory"), "{printed}");
}
