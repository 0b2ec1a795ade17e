//! `logicity induce --ask`: rules learned from the answers of an oracle.

use super::cli::logicity;
use super::induce::{fails, succeeds, text};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::thread;
use std::time::{Duration, Instant};

/// Learns from questions alone.
const NOTHING: [&str; 5] = ["induce", "--config", "easy", "--episodes", "0"];

/// Answers Stop in scenes with an ambulance, and writes each scene to the file `asked`.
const AMBULANCE: &str = r#"while read -r scene; do
  printf '%s\n' "$scene" >> asked
  case $scene in *IsAmbulance*) action=Stop;; *) action=Normal;; esac
  echo "{\"action\": \"$action\"}"
done
"#;

/// A folder with an oracle, in which the command runs.
struct Folder(tempfile::TempDir);

impl Folder {
    fn new(oracle: &str) -> Folder {
        let folder = Folder(tempfile::tempdir().unwrap());
        fs::write(folder.path("oracle.sh"), oracle).unwrap();
        folder
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn read(&self, name: &str) -> String {
        fs::read_to_string(self.path(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
    }

    fn command(&self, arguments: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_logicity"));
        command
            .args(arguments)
            .current_dir(self.0.path())
            .env("PROGRAM", env!("CARGO_BIN_EXE_logicity"))
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped());
        command
    }

    fn run(&self, arguments: &[&str]) -> Output {
        self.command(arguments).output().unwrap()
    }

    /// Learns from questions to `oracle.sh`, with further options.
    fn ask(&self, options: &[&str]) -> Output {
        self.run(&[&NOTHING[..], &["--ask", "sh oracle.sh"], options].concat())
    }
}

fn equivalent(learned: &Path, rules: &str) {
    let said = succeeds(&logicity(["diff", learned.to_str().unwrap(), rules]));
    assert!(said.starts_with("equivalent: proved"), "{said}");
}

fn lines(text: &str) -> Vec<&str> {
    text.lines().collect()
}

#[test]
fn questions_to_hidden_rules_yield_equivalent_rules() {
    let folder = Folder::new("");
    let options = [
        "--ask",
        "rules/easy.dl",
        "--agreements",
        "60",
        "--sweep",
        "1,2",
        "-o",
        "learned.dl",
        "--report",
        "report.json",
        "--log",
        "log.jsonl",
    ];
    let said = succeeds(&folder.run(&[&NOTHING[..], &options].concat()));
    assert!(said.contains(" questions to the rules in easy.dl ("), "{said}");
    let certificate = "Certificate: the rules agree with the oracle on all 57 scenes of at most 1 fact and 2 entities.";
    assert!(said.contains(certificate), "{said}");
    equivalent(&folder.path("learned.dl"), "rules/easy.dl");
    let learned = folder.read("learned.dl");
    assert!(
        learned.starts_with("// Rules learned by logicity 0.1.0 from questions about scenes of easy.\n"),
        "{learned}"
    );
    assert!(learned.contains(&format!("// {certificate}\n")), "{learned}");
    assert!(learned.contains("explains is question "), "{learned}");

    let report: serde_json::Value = serde_json::from_str(&folder.read("report.json")).unwrap();
    let questions = &report["questions"];
    assert_eq!(questions["end"], "certified");
    assert_eq!(questions["certificate"]["scenes"], 57);
    let counted = questions["by_reason"].as_object().unwrap().values();
    let counted: u64 = counted.map(|count| count.as_u64().unwrap()).sum();
    assert_eq!(Some(counted), questions["asked"].as_u64());

    // The log has a header and one labeled scene for each question. It is data for the learner, and `infer` agrees.
    let log = folder.read("log.jsonl");
    assert_eq!(log.lines().count() as u64, counted + 1);
    let answers = succeeds(&folder.run(&["infer", "log.jsonl", "--config", "easy"]));
    assert_eq!(answers.lines().count() as u64, counted);
    for (answer, asked) in answers.lines().zip(log.lines().skip(1)) {
        let [answer, asked] = [answer, asked].map(|line| serde_json::from_str::<serde_json::Value>(line).unwrap());
        assert_eq!(answer["egos"]["e0"]["action"], asked["actions"]["e0"], "{asked}");
        assert!(asked["reason"].is_string());
    }
    succeeds(&folder.run(&["induce", "log.jsonl", "--config", "easy", "-o", "again.dl"]));
    equivalent(&folder.path("again.dl"), "rules/easy.dl");
}

#[test]
fn questions_complete_what_episodes_leave_open() {
    let folder = Folder::new("");
    let options = ["--ask", "rules/medium.dl", "--agreements", "5", "-o", "learned.dl"];
    succeeds(&folder.run(&[&["induce", "--config", "medium"], &options[..]].concat()));
    equivalent(&folder.path("learned.dl"), "rules/medium.dl");
    let learned = folder.read("learned.dl");
    assert!(learned.contains("100 recorded episodes of medium") || learned.contains("the recorded episodes of medium"));
    assert!(learned.contains("// Episodes "), "{learned}");
}

/// A command that evaluates the same rules gets the same questions.
#[test]
fn a_command_is_asked_like_a_rule_file() {
    let folder = Folder::new(
        r#"while read -r scene; do
  answer=$(printf '%s\n' "$scene" | "$PROGRAM" infer --config easy)
  action=${answer##*\"action\":\"}
  echo "{\"action\": \"${action%%\"*}\", \"remark\": \"ignored\"}"
done
"#,
    );
    let options = ["--questions", "30", "--log"];
    let by_command = folder.ask(&[&options[..], &["command.jsonl"]].concat());
    let rules = ["--ask", "rules/easy.dl"];
    let by_rules = folder.run(&[&NOTHING[..], &rules, &options, &["rules.jsonl"]].concat());
    let [one, other] = [by_command, by_rules].map(|output| succeeds(&output));
    assert!(one.contains("// 30 questions to a command ("), "{one}");
    assert!(
        one.contains("// The limit of questions was reached: the rules may differ from the oracle.\n"),
        "{one}"
    );
    assert_eq!(one.replace("a command (", "the rules in easy.dl ("), other);
    let [one, other] = ["command.jsonl", "rules.jsonl"].map(|name| folder.read(name));
    assert_ne!(lines(&one)[0], lines(&other)[0]);
    assert_eq!(lines(&one)[1..], lines(&other)[1..]);
    assert_eq!(lines(&one).len(), 31);
}

/// Waits until a file has a number of lines.
fn wait_for(path: &Path, count: usize, child: &mut Child) {
    let begin = Instant::now();
    while fs::read_to_string(path).map_or(0, |text| text.lines().count()) < count {
        assert!(begin.elapsed() < Duration::from_secs(60), "no progress");
        assert!(child.try_wait().unwrap().is_none(), "it has ended");
        thread::sleep(Duration::from_millis(5));
    }
}

#[test]
fn a_killed_run_continues_where_it_stopped() {
    let options = ["--agreements", "20", "-o", "learned.dl", "--log", "log.jsonl"];
    let whole = Folder::new(AMBULANCE);
    let said = succeeds(&whole.ask(&options));
    let (asked, log) = (whole.read("asked"), whole.read("log.jsonl"));
    let asked = lines(&asked);
    assert_eq!(asked.len() + 1, log.lines().count());
    assert!(asked.len() > 25, "{}", asked.len());

    let killed = Folder::new(&AMBULANCE.replace("case", "sleep 0.1\n  case"));
    let mut child = killed
        .command(&[&NOTHING[..], &["--ask", "sh oracle.sh"], &options].concat())
        .spawn()
        .unwrap();
    wait_for(&killed.path("log.jsonl"), 8, &mut child);
    child.kill().unwrap();
    child.wait().unwrap();
    assert!(!killed.path("learned.dl").exists());
    let kept = killed.read("log.jsonl").lines().count() - 1;
    assert!((7..asked.len()).contains(&kept), "{kept}");
    assert_eq!(lines(&killed.read("asked"))[..kept], asked[..kept]);
    // A kill in the middle of a write leaves a part of a line.
    let torn = killed.read("log.jsonl") + "{\"entities\":[\"e0\",";
    fs::write(killed.path("log.jsonl"), torn).unwrap();
    fs::remove_file(killed.path("asked")).unwrap();
    assert_eq!(succeeds(&killed.ask(&options)), said);
    assert_eq!(lines(&killed.read("asked")), asked[kept..]);
    for name in ["learned.dl", "log.jsonl"] {
        assert_eq!(killed.read(name), whole.read(name), "{name}");
    }
    // A complete log needs no oracle, and does not grow.
    fs::write(killed.path("oracle.sh"), "exit 1\n").unwrap();
    assert_eq!(succeeds(&killed.ask(&options)), said);
    assert_eq!(killed.read("log.jsonl"), log);
    // More agreements need more answers.
    let more = ["--agreements", "22", "-o", "learned.dl", "--log", "log.jsonl"];
    fails(&killed.ask(&more), 2, &["ended without an answer (exit status: 1)"]);
    fs::write(killed.path("oracle.sh"), AMBULANCE).unwrap();
    succeeds(&killed.ask(&more));
    assert!(killed.read("log.jsonl").starts_with(&log));
    assert_ne!(killed.read("log.jsonl"), log);
}

#[test]
fn an_interrupt_keeps_what_was_learned() {
    let folder = Folder::new(&AMBULANCE.replace("case", "sleep 0.05\n  case"));
    let options = ["--ask", "sh oracle.sh", "-o", "learned.dl", "--log", "log.jsonl"];
    let mut child = folder.command(&[&NOTHING[..], &options].concat()).spawn().unwrap();
    wait_for(&folder.path("log.jsonl"), 16, &mut child);
    let sent = Command::new("kill").args(["-INT", &child.id().to_string()]).status();
    assert!(sent.unwrap().success());
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(130), "{}", text(&output.stderr));
    let interrupted = "The questions were interrupted: the rules may differ from the oracle.";
    assert!(text(&output.stdout).contains(interrupted));
    let learned = folder.read("learned.dl");
    assert!(learned.contains(&format!("// {interrupted}\n")), "{learned}");
    assert!(learned.contains("Stop(X) :- "), "{learned}");
}

/// Each fault is named, and the rules learned so far are written.
#[test]
fn faults_of_oracles_are_reported() {
    let fixture = |name: &str| {
        let path = format!("{}/tests/fixtures/diagnostics/{name}.sh", env!("CARGO_MANIFEST_DIR"));
        fs::read_to_string(path).unwrap()
    };
    let after = |answers: usize, then: &str| {
        format!(
            "n=0\nwhile read -r scene; do\n  n=$((n+1))\n  if [ $n -gt {answers} ]; then {then}; fi\n  \
             case $scene in *IsAmbulance*) a=Stop;; *) a=Normal;; esac\n  \
             echo \"{{\\\"action\\\": \\\"$a\\\"}}\"\ndone\n"
        )
    };
    let said = |line: &str| after(14, &format!("printf '{line}\\n'; continue"));
    let cases: [(String, i32, &[&str]); 11] = [
        (
            fixture("invalid-answer"),
            1,
            &[
                "[invalid-answer]",
                "not an action: `stop`",
                "not JSON",
                "answer to question 1",
                "{\"action\": \"Stop\"}",
            ],
        ),
        (
            fixture("inseparable-answers"),
            1,
            &[
                "[inseparable-answers]",
                "at most 3 variables",
                "the scene: {\"entities\":[\"e0\"",
                "--variables",
            ],
        ),
        (
            after(100, "echo '{\"action\": \"Fast\"}'; continue"),
            1,
            &[
                "[contradicting-examples]",
                "contradicts itself: questions ",
                " and ",
                "the scene: {",
            ],
        ),
        (
            said("{\"action\": \"Jump\"}"),
            1,
            &["not an action: `{\"action\": \"Jump\"}`", "question 15"],
        ),
        (said("{\"action\": 3}"), 1, &["not an action: `{\"action\": 3}`"]),
        (said("\"Stop\""), 1, &["not an action: `\"Stop\"`"]),
        (said("\\377\\033[2J"), 1, &["not an action: `\u{fffd}\\u001b[2J`"]),
        (said(""), 1, &["not an action: ``"]),
        (
            said("{\"action\": \"Stop\"}\\n{\"action\": \"Stop\"}\\n{\"action\": \"Stop\"}"),
            1,
            &["a line before it is asked"],
        ),
        (
            after(14, "exit 7"),
            2,
            &["question 15: the oracle ended without an answer (exit status: 7)"],
        ),
        (
            after(14, "sleep 60; :"),
            2,
            &["question 15: the oracle gave no answer in 5 s", "--answer-timeout"],
        ),
    ];
    for (oracle, code, parts) in cases {
        let folder = Folder::new(&oracle);
        let output = folder.ask(&["-o", "learned.dl", "--report", "report.json", "--answer-timeout", "5"]);
        fails(&output, code, parts);
        let report: serde_json::Value = serde_json::from_str(&folder.read("report.json")).unwrap();
        let asked = report["questions"]["asked"].as_u64().unwrap();
        assert_eq!(
            report["examples"].as_u64(),
            Some(asked - report["questions"]["by_reason"]["repeat"].as_u64().unwrap_or(0))
        );
        let learned = folder.read("learned.dl");
        assert!(learned.contains(" differ from "), "{learned}");
        assert_eq!(learned.contains(":-"), asked > 0, "{oracle}\n{learned}");
    }
    let missing = Folder::new("").run(&[&NOTHING[..], &["--ask", "no-such-program"]].concat());
    fails(
        &missing,
        2,
        &["question 1: the oracle ended without an answer (exit status: 127)"],
    );
}

/// Oracles that answer too slowly, flood their outputs, or leave processes that hold a pipe end with the command.
#[cfg(unix)]
#[test]
fn no_oracle_outlives_or_delays_its_question() {
    let cases = [
        ("while :; do printf a; sleep 0.05; done", 2, "gave no answer in 0.5 s"),
        ("sleep 60 & exit", 2, "gave no answer in 0.5 s"),
        ("cat; exec cat /dev/zero", 1, "not an action"),
        ("exec yes", 1, "a line before it is asked"),
        ("exec cat /dev/zero", 1, "a line before it is asked"),
        ("head -c 1000000 /dev/zero >&2; sleep 60", 2, "gave no answer in 0.5 s"),
        ("exec >&- <&-; sleep 60", 2, "the oracle "),
        ("(sleep 1.5; touch alive) & read scene; echo", 1, "not an action"),
    ];
    for (oracle, code, part) in cases {
        let folder = Folder::new(oracle);
        let begin = Instant::now();
        let output = folder.ask(&["--answer-timeout", "0.5"]);
        assert_eq!(output.status.code(), Some(code), "{oracle}: {}", text(&output.stderr));
        // The answer may come before the question.
        let shown = text(&output.stderr);
        assert!(
            shown.contains(part) || code == 1 && shown.contains("not an action"),
            "{oracle}: {shown}"
        );
        assert!(begin.elapsed() < Duration::from_secs(10), "{oracle}");
        thread::sleep(Duration::from_millis(if oracle.contains("alive") { 2000 } else { 0 }));
        assert!(!folder.path("alive").exists(), "a process of the oracle lives on");
    }
}

#[test]
fn faults_of_rules_as_oracles_are_reported() {
    let folder = Folder::new("");
    let ask = |text: &str, options: &[&str]| {
        fs::write(folder.path("hidden.dl"), text).unwrap();
        folder.run(
            &[
                &NOTHING[..],
                &["--ask", "hidden.dl", "-o", "learned.dl", "--force"],
                options,
            ]
            .concat(),
        )
    };
    let endless = ".include \"vocabulary.dl\"\n.decl N(n: number)\nN(0).\nN(n + 1) :- N(n).\n\
                   Stop(X) :- IsCar(X), N(7).\n";
    fails(
        &ask(endless, &["--max-rows", "1000"]),
        1,
        &["limit-exceeded", "question 1", "bound them, for example with `n < 100`"],
    );
    let slow = ask(
        endless,
        &["--answer-timeout", "0.05", "--max-rows", "100G", "--max-memory", "100G"],
    );
    fails(&slow, 2, &["question 1: the oracle gave no answer in 0.05 s"]);
    assert!(
        folder
            .read("learned.dl")
            .contains("// 0 questions to the rules in hidden.dl.\n")
    );
    fails(&ask("Stop(X) :- ", &[]), 1, &["hidden.dl:1"]);
    fails(
        &ask(
            ".decl Stop(x: symbol)\n.decl Unknown(x: symbol)\n.input Unknown\nStop(X) :- Unknown(X).\n",
            &[],
        ),
        1,
        &["Unknown"],
    );
    let missing = folder.run(&[&NOTHING[..], &["--ask", "missing.dl"]].concat());
    fails(&missing, 2, &["missing.dl"]);
    // The rules of the oracle are an input.
    let overwrite = folder.run(&[&NOTHING[..], &["--ask", "hidden.dl", "-o", "hidden.dl", "--force"]].concat());
    fails(&overwrite, 2, &["this command reads it"]);
}

#[test]
fn an_example_that_the_oracle_denies_is_named() {
    let folder = Folder::new("while read -r scene; do echo '{\"action\": \"Normal\"}'; done\n");
    let example =
        "{\"entities\": [\"a\"], \"ego\": \"a\", \"facts\": {\"IsCar\": [\"a\"]}, \"actions\": {\"a\": \"Stop\"}}\n";
    fs::write(folder.path("scenes.jsonl"), example).unwrap();
    let options = [
        "--config",
        "easy",
        "--ask",
        "sh oracle.sh",
        "--agreements",
        "0",
        "--sweep",
        "0,1",
        "-o",
        "learned.dl",
    ];
    let output = folder.run(&[&["induce", "scenes.jsonl"], &options[..]].concat());
    let parts = [
        "[contradicting-examples]",
        "scenes.jsonl, line 1, a has the action Stop",
        "the answer Normal",
    ];
    fails(&output, 1, &parts);
    assert!(folder.read("learned.dl").contains("The oracle contradicts an example"));
}

#[test]
fn logs_of_other_questions_are_refused() {
    let folder = Folder::new(AMBULANCE);
    let options = ["--agreements", "3", "-o", "learned.dl", "--log", "log.jsonl"];
    succeeds(&folder.ask(&options));
    let log = folder.read("log.jsonl");
    let refuses = |arguments: &[&str], parts: &[&str]| {
        let output = folder.run(&[arguments, &["--log", "log.jsonl"]].concat());
        fails(&output, 2, parts);
        assert_eq!(folder.read("log.jsonl"), log);
    };
    let other = ["--ask", "cat; sh oracle.sh"];
    refuses(
        &[&NOTHING[..], &other].concat(),
        &["cannot continue `log.jsonl`", "its `oracle` is \"command "],
    );
    refuses(
        &[&NOTHING[..], &["--ask", "rules/easy.dl"]].concat(),
        &["that of this run \"rules "],
    );
    let same = ["--ask", "sh oracle.sh"];
    refuses(
        &[&NOTHING[..], &same, &["--seed", "1"]].concat(),
        &["its `seed` is 0, that of this run 1"],
    );
    refuses(
        &[&NOTHING[..], &same, &["--order", "Slow,Stop"]].concat(),
        &["its `actions` is"],
    );
    let medium = ["induce", "--config", "medium", "--episodes", "0"];
    refuses(&[&medium[..], &same].concat(), &["its `configuration` is \"easy "]);
    let examples = ["induce", "--config", "easy", "--episodes", "1"];
    refuses(&[&examples[..], &same].concat(), &["its `examples` is \"0 "]);
    refuses(
        &[&["induce", "log.jsonl", "--config", "easy"], &same[..]].concat(),
        &["this command reads it"],
    );
    refuses(&[&NOTHING[..], &same, &["-o", "log.jsonl"]].concat(), &["log.jsonl"]);

    // A faulty answer is reported at its place, and nothing is asked.
    let faulty = log.replacen("\"actions\":{\"e0\":\"Normal\"}", "\"actions\":{\"e0\":\"Jump\"}", 1);
    fs::write(folder.path("log.jsonl"), &faulty).unwrap();
    fails(&folder.ask(&options), 1, &["log.jsonl:", "`Jump` is not an action"]);
    assert_eq!(folder.read("log.jsonl"), faulty);
    // Other files stay as they are.
    for foreign in ["text\n", "text", "{\"a\": 1}\n", "\u{0}\u{0}"] {
        fs::write(folder.path("foreign"), foreign).unwrap();
        let output = folder.ask(&["--log", "foreign"]);
        fails(&output, 2, &["cannot continue `foreign`: it is not a log of questions"]);
        assert_eq!(folder.read("foreign"), foreign);
    }
    fails(&folder.ask(&["--log", "."]), 2, &["not a regular file"]);
    fails(&folder.ask(&["--log", "-"]), 2, &["--log needs a file"]);
    fails(&folder.ask(&["--log", "missing/log.jsonl"]), 2, &["missing/log.jsonl"]);
    let version = log.replacen("{\"questions\":1", "{\"questions\":2", 1);
    fs::write(folder.path("log.jsonl"), version).unwrap();
    fails(
        &folder.ask(&options),
        2,
        &["log of version 2; this program reads version 1"],
    );
}

#[test]
fn options_of_questions_need_an_oracle() {
    let folder = Folder::new("");
    fails(&folder.run(&NOTHING), 2, &["--episodes 0 leaves nothing to learn from"]);
    let refuses = |options: &[&str], parts: &[&str]| {
        fails(
            &folder.run(&[&["induce", "--config", "easy"], options].concat()),
            2,
            parts,
        );
    };
    for option in ["--questions", "--agreements", "--answer-timeout"] {
        refuses(&[option, "3"], &["--ask <ORACLE>"]);
    }
    refuses(&["--log", "x"], &["--ask <ORACLE>"]);
    refuses(&["--ask", "x.dl", "--noise", "auto"], &["cannot be used with"]);
    refuses(&["--ask", "x.dl", "--sweep", "3"], &["expected numbers of facts"]);
    refuses(&["--ask", "x.dl", "--sweep", "3,9"], &["from 1 to 5"]);
    refuses(&["--ask", "x.dl", "--answer-timeout", "-1"], &["from 0.001"]);
}
