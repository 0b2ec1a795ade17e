//! The language server: runs the binary and exchanges messages with it.

use lsp_server::{Message, Notification, Request, RequestId};
use serde_json::{Value, json};
use std::collections::VecDeque;
use std::fs;
use std::io::BufReader;
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

struct Editor {
    process: Child,
    to: ChildStdin,
    from: BufReader<ChildStdout>,
    /// Diagnostics that arrived while the test waited for another message.
    published: VecDeque<Value>,
    folder: tempfile::TempDir,
    next: i32,
}

impl Editor {
    fn start() -> Editor {
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
        };
        let answer = editor.ask(
            "initialize",
            json!({ "capabilities": {}, "processId": null, "rootUri": null }),
        );
        assert_eq!(answer["capabilities"]["hoverProvider"], true);
        assert_eq!(answer["capabilities"]["positionEncoding"], "utf-16");
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
    let refused = editor.ask("textDocument/foldingRange", json!({}));
    assert_eq!(refused["code"], -32601);
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
