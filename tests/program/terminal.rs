//! Text of others on a terminal: no command passes on a character that controls it.
//!
//! Messages and tables are neutral in pipes and files, too. Data stays byte for byte in a pipe.

use nix::pty::openpty;
use serde_json::{Value, json};
use std::fs::{self, File};
use std::io::{Read, Write};
use std::path::PathBuf;
use std::process::{Command, Output, Stdio};
use std::thread;

/// The title of a window, colors, controls of one byte in ISO 8859, reordered text, an overwritten line, a rubout.
const HOSTILE: &str = "\u{1b}]0;owned\u{7}\u{1b}[31m\u{9b}2J\u{202e}gnp.\u{2066}\rok\u{7f}\u{8}";

fn is_active(c: char) -> bool {
    c.is_control() && c != '\n' && c != '\t'
        || "\u{61c}\u{200e}\u{200f}\u{2028}\u{2029}\u{202a}\u{202b}\u{202c}\u{202d}\u{202e}\u{2066}\u{2067}\u{2068}\u{2069}"
            .contains(c)
}

struct Folder(tempfile::TempDir);

impl Folder {
    /// A folder with hostile files: `x.dl` and others with hostile content, and the same with a hostile name.
    fn new() -> Folder {
        let folder = Folder(tempfile::tempdir().unwrap());
        let quoted = serde_json::to_string(HOSTILE).unwrap();
        let scene = json!({
            "entities": [HOSTILE, "b"], "ego": HOSTILE,
            "facts": { "IsCar": [HOSTILE], "IsPedestrian": ["b"], HOSTILE: ["b"] },
        });
        let good = json!({ "entities": [HOSTILE], "ego": HOSTILE, "facts": { "IsCar": [HOSTILE] } });
        let rules = ".decl e(x: symbol)\n.input e\n.decl r(x: symbol)\n.output r\n\
                     r(x) :- e(x).\nr(cat(x, \"!\")) :- e(x).\n";
        let files = [
            ("x.dl", format!("// {HOSTILE}\nA(\"{HOSTILE}\") :- B(y{HOSTILE}).\n")),
            (
                "note.dl",
                format!("// {HOSTILE}\n/// {HOSTILE}\n.decl A(x: symbol)\n  A(\"a\").\n"),
            ),
            (
                "string.dl",
                format!(".decl A(x: symbol)\n.output A\nA(\"{HOSTILE}\").\nA(x) :- B(x).\n"),
            ),
            ("good.dl", rules.to_owned()),
            ("include.dl", format!(".include \"{}\"\n", HOSTILE.replace('\r', ""))),
            ("e.facts", "a\u{1b}]0;owned\u{7}\u{9b}2J\u{202e}\u{7f}\nb\n".to_owned()),
            (
                "x.yaml",
                format!("{quoted}: 1\nrules: {quoted}\nmap: {quoted}\nagents:\n- {HOSTILE}\n"),
            ),
            ("x.jsonl", format!("{scene}\n{{\"{HOSTILE}\n\"{quoted}\"\n")),
            ("good.jsonl", format!("{good}\n")),
            ("episodes.json", format!("{{{quoted}: {quoted}}}")),
            ("rows.repl", "?- r(x).\n.r\nexplain r(_)\n".to_owned()),
            (
                "x.repl",
                format!(
                    ".load {HOSTILE}\n{HOSTILE}\n.decl A(x: symbol)\nA({quoted}).\nA(\"{HOSTILE}\").\n?- A(x).\n\
                     .predicates\n.A\nexplain A({quoted})\n.facts {HOSTILE}\n"
                ),
            ),
        ];
        for (name, text) in files {
            fs::write(folder.path(name), &text).unwrap();
            fs::write(folder.path(&format!("{HOSTILE}{name}").replace('/', "")), &text).unwrap();
        }
        fs::create_dir(folder.path(HOSTILE)).unwrap();
        folder
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn command(&self, arguments: &[String]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_logicity"));
        command.args(arguments).current_dir(self.0.path()).stdin(Stdio::null());
        command
    }

    /// Runs a command on pipes.
    fn run(&self, arguments: &[String]) -> Output {
        self.command(arguments).output().unwrap()
    }

    /// Runs a command on a terminal, and returns what the terminal gets.
    fn on_terminal(&self, arguments: &[String]) -> String {
        let pty = openpty(None, None).unwrap();
        let mut command = self.command(arguments);
        command.stdout(pty.slave.try_clone().unwrap()).stderr(pty.slave);
        let mut child = command.spawn().unwrap();
        // Only the child keeps the terminal open.
        drop(command);
        let mut bytes = Vec::new();
        // Reading fails when the child has closed the terminal.
        let _ = File::from(pty.master).read_to_end(&mut bytes);
        child.wait().unwrap();
        String::from_utf8(bytes).expect("UTF-8")
    }
}

fn words(arguments: &[&str]) -> Vec<String> {
    let word = |word: &&str| word.replace("{}", HOSTILE);
    arguments.iter().map(word).collect()
}

/// Returns the words of every command.
fn commands() -> Vec<Vec<String>> {
    fn collect(command: &Value, before: &[String], found: &mut Vec<Vec<String>>) {
        let words = [before, &[command["name"].as_str().unwrap().to_owned()]].concat();
        let inner = command["commands"].as_array().map_or(&[][..], Vec::as_slice);
        inner.iter().for_each(|command| collect(command, &words, found));
        found.push(words);
    }
    let printed = Command::new(env!("CARGO_BIN_EXE_logicity"))
        .arg("reference")
        .output()
        .unwrap();
    let all: Value = serde_json::from_slice(&printed.stdout).unwrap();
    let mut found = Vec::new();
    for command in all["commands"].as_array().unwrap() {
        collect(command, &[], &mut found);
    }
    found
}

/// Runs command lines on a few threads.
fn each(cases: &[Vec<String>], check: impl Fn(&[String]) + Sync) {
    let next = std::sync::atomic::AtomicUsize::new(0);
    thread::scope(|scope| {
        for _ in 0..4 {
            scope.spawn(|| {
                while let Some(case) = cases.get(next.fetch_add(1, std::sync::atomic::Ordering::Relaxed)) {
                    check(case);
                }
            });
        }
    });
}

fn assert_neutral(case: &[String], output: &Output) {
    for bytes in [&output.stdout, &output.stderr] {
        let shown = String::from_utf8(bytes.clone()).expect("UTF-8");
        assert!(!shown.contains(is_active), "{case:?}: {shown:?}");
    }
    let code = output.status.code().unwrap_or(-1);
    assert!(
        (0..=2).contains(&code),
        "{case:?} ended with {code}: {}",
        String::from_utf8_lossy(&output.stderr)
    );
}

/// A terminal gets styles, progress bars and `\r\n`, but nothing of [`HOSTILE`].
fn assert_controlled(case: &[String], shown: &str) {
    for part in [
        "\u{1b}]", "\u{9b}", "\u{202e}", "\u{2066}", "\u{7f}", "\u{8}", "\u{7}", "\rok",
    ] {
        assert!(!shown.contains(part), "{case:?}: {part:?} in {shown:?}");
    }
}

#[test]
fn arguments_do_not_reach_a_terminal_raw() {
    let folder = Folder::new();
    let mut cases = vec![words(&["{}"]), words(&["--{}"])];
    let found = commands();
    assert!(found.len() > 25, "{found:?}");
    for command in found
        .iter()
        .filter(|command| command[0] != "lsp" && command[0] != "help")
    {
        for tail in [
            &["--{}"][..],
            &["{}"],
            &["{}", "{}"],
            &["missing{}.dl", "--seed", "{}"],
            &["--config", "{}.yaml", "{}"],
        ] {
            cases.push([command.clone(), words(tail)].concat());
        }
    }
    each(&cases, |case| {
        // `new` creates a folder with any name.
        assert_neutral(case, &folder.run(case));
    });
    each(&cases[..40], |case| assert_controlled(case, &folder.on_terminal(case)));
}

/// Whether standard output is data, which stays byte for byte in a pipe.
type IsData = bool;

#[test]
fn content_does_not_reach_a_terminal_raw() {
    let folder = Folder::new();
    let run = folder.run(&words(&[
        "run",
        "easy",
        "--ticks",
        "2",
        "--out",
        "out",
        "--no-pictures",
        "--{}",
    ]));
    assert_eq!(run.status.code(), Some(2));
    let run = folder.run(&words(&[
        "run",
        "easy",
        "--ticks",
        "2",
        "--out",
        "out{}",
        "--no-pictures",
    ]));
    assert_neutral(&words(&["run"]), &run);
    let trace = fs::read_to_string(folder.path(&format!("out{HOSTILE}")).join("trace.jsonl")).unwrap();
    let name = serde_json::to_string(HOSTILE).unwrap();
    fs::write(folder.path("trace.jsonl"), trace.replace("\"Car_1\"", &name)).unwrap();
    let cases: Vec<(Vec<String>, IsData)> = [
        (
            &[
                "check",
                "x.dl",
                "{}x.dl",
                "note.dl",
                "string.dl",
                "include.dl",
                "x.yaml",
                "{}",
            ][..],
            false,
        ),
        (&["check", "--json", "x.dl", "{}x.dl", "x.yaml"], true),
        (&["check", "--coverage", "trace.jsonl", "good.dl"], false),
        (&["check", "good.dl", "--config", "x.yaml"], false),
        (&["fmt", "--check", "{}note.dl", "{}x.dl"], false),
        (&["diff", "{}x.dl", "good.dl"], false),
        (&["diff", "{}note.dl", "note.dl", "--given", "{}"], false),
        (&["diff", "string.dl", "note.dl"], false),
        (&["query", "x.dl"], false),
        (&["query", "good.dl", "-D", "-"], true),
        (&["query", "good.dl", "-D", "{}", "--profile"], false),
        (&["query", "good.dl", "--plan"], false),
        (&["query", "good.dl", "--explain", "r(\"b!\")"], false),
        (&["query", "good.dl", "--explain", "r(_)"], false),
        (&["query", "good.dl", "--why-not", "r(\"{}\")"], false),
        (&["query", "good.dl", "--explain", "{}"], false),
        (&["query", "string.dl", "-D", "-"], true),
        (&["infer", "x.jsonl"], true),
        (&["infer", "good.jsonl"], true),
        (&["infer", "good.jsonl", "--out", "/dev/stdout"], true),
        (&["infer", "good.jsonl", "--config", "{}x.yaml"], false),
        (&["induce", "x.jsonl", "--config", "easy"], false),
        (&["induce", "trace.jsonl", "-o", "-"], false),
        (
            &[
                "induce",
                "--config",
                "easy",
                "--episodes",
                "0",
                "--ask",
                "printf '\\033]0;owned\\007\\n'",
            ],
            false,
        ),
        (&["explain", "trace.jsonl", "--agent", "{}"], false),
        (&["explain", "trace.jsonl", "--agent", "none"], false),
        (&["explain", "x.jsonl", "--agent", "{}"], false),
        (&["view", "trace.jsonl", "--out", "{}"], false),
        (&["view", "x.jsonl"], false),
        (&["run", "{}x.yaml"], false),
        (&["episodes", "check", "{}x.yaml"], false),
        (&["questions", "{}x.yaml"], false),
        (&["vap", "check", "{}"], false),
        (
            &[
                "route", "--map", "{}x.yaml", "--type", "car", "--from", "1,1", "--to", "2,2",
            ],
            false,
        ),
        (&["icons", "sheet", "--pack", "{}", "-o", "{}.png"], false),
        (&["codes", "{}"], false),
    ]
    .into_iter()
    .map(|(case, is_data)| (words(case), is_data))
    .collect();
    let all: Vec<Vec<String>> = cases.iter().map(|(case, _)| case.clone()).collect();
    each(&all, |case| {
        let mut output = folder.run(case);
        if cases.iter().any(|(known, is_data)| known == case && *is_data) {
            output.stdout.clear();
        }
        assert_neutral(case, &output);
        assert_controlled(case, &folder.on_terminal(case));
    });
}

#[test]
fn data_stays_as_it_is_in_pipes_and_files() {
    let folder = Folder::new();
    let facts = fs::read_to_string(folder.path("e.facts")).unwrap();
    let printed = String::from_utf8(folder.run(&words(&["query", "good.dl", "-D", "-"])).stdout).unwrap();
    for row in facts.lines() {
        assert!(
            printed.contains(&format!("\n{row}\n")) && printed.contains(&format!("\n{row}!\n")),
            "{printed:?}"
        );
    }
    let on_terminal = folder.on_terminal(&words(&["query", "good.dl", "-D", "-"]));
    assert!(
        on_terminal.contains("a\\u001b]0;owned\\u0007\\u009b2J\\u202e\\u007f!"),
        "{on_terminal:?}"
    );
    folder.run(&words(&["query", "good.dl", "-D", "rows"]));
    let written = fs::read_to_string(folder.path("rows/r.csv")).unwrap();
    assert!(facts.lines().all(|row| written.contains(row)), "{written:?}");
    let answer = folder.run(&words(&["infer", "good.jsonl"])).stdout;
    assert!(answer.windows(2).any(|bytes| bytes == "\u{9b}".as_bytes()));
    let on_terminal = folder.on_terminal(&words(&["infer", "good.jsonl"]));
    let parsed: Value = serde_json::from_str(on_terminal.trim()).expect("JSON still");
    assert_eq!(parsed, serde_json::from_slice::<Value>(&answer).unwrap());
    let note = fs::read(folder.path("note.dl")).unwrap();
    let mut child = folder
        .command(&words(&["fmt", "-"]))
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    child.stdin.take().unwrap().write_all(&note).unwrap();
    let formatted = child.wait_with_output().unwrap().stdout;
    assert!(
        formatted.windows(8).any(|bytes| bytes == b"\x1b]0;owne"),
        "{formatted:?}"
    );
}

#[test]
fn the_prompt_is_neutral() {
    let folder = Folder::new();
    let row = "a\\u001b]0;owned\\u0007\\u009b2J\\u202e\\u007f!\n";
    for (input, part) in [("rows.repl", row), ("x.repl", "predicate")] {
        let mut command = folder.command(&words(&["repl", "good.dl", "-F", "."]));
        command.stdin(File::open(folder.path(input)).unwrap());
        let output = command.output().unwrap();
        assert_neutral(&words(&["repl", input]), &output);
        let shown = String::from_utf8(output.stdout).unwrap();
        assert!(shown.contains(part), "{shown}");
    }
}

/// Every other file prints through `src/cli/terminal.rs`, which no text of others can get around.
#[test]
fn only_one_file_prints() {
    let allowed = ["src/cli/terminal.rs", "src/cli/lsp/transport.rs", "src/files/output.rs"];
    let mut folders = vec![PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("src")];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                if !path.ends_with("examples") {
                    folders.push(path);
                }
                continue;
            }
            let name = path.strip_prefix(env!("CARGO_MANIFEST_DIR")).unwrap().to_str().unwrap();
            if !name.ends_with(".rs") || allowed.contains(&name) {
                continue;
            }
            for line in fs::read_to_string(&path).unwrap().lines() {
                let prints = ["println!", "print!(", "io::stdout()", "io::stderr()", "anstream::"];
                let is_harmless =
                    line.contains("is_terminal()") || line.contains("flush()") || line.trim().starts_with("//");
                assert!(
                    is_harmless || !prints.iter().any(|word| line.contains(word)),
                    "{name}: {line}"
                );
            }
        }
    }
}
