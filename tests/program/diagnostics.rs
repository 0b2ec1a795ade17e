//! Every message has a stable name, a fixture that produces it, and a section in a reference.
//!
//! `tests/datalog/lang.rs` and `tests/city/config.rs` run the fixtures of rules and configurations. This file runs
//! those that need a whole city, scenes or facts, and checks that no code lacks a fixture.

use crate::pages::{blocks, pages};
use crate::readme::shell;
use logicity::builtin::BuiltinFiles;
use logicity::cancel::Cancel;
use logicity::datalog::{Limits, Program};
use logicity::diag::codes;
use logicity::diag::{Example, Sources};
use logicity::{city, config, datalog, diag, sim, task, yaml};
use regex::Regex;
use serde_json::Value;
use std::collections::BTreeSet;
use std::fs;
use std::path::PathBuf;
use std::process::{Command, Output};
use std::sync::atomic::{AtomicUsize, Ordering};

fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

fn fixtures() -> PathBuf {
    root().join("tests/fixtures/diagnostics")
}

fn logicity(arguments: &[&str]) -> Output {
    let program = env!("CARGO_BIN_EXE_logicity");
    Command::new(program)
        .args(arguments)
        .current_dir(root())
        .output()
        .unwrap()
}

#[test]
fn every_code_has_a_fixture() {
    let codes = [
        diag::codes::CODES,
        datalog::codes::CODES,
        yaml::codes::CODES,
        config::codes::CODES,
        city::codes::CODES,
        sim::codes::CODES,
        task::codes::CODES,
        task::spf::codes::CODES,
        task::vap::codes::CODES,
        task::induction::codes::CODES,
    ]
    .concat();
    let names: BTreeSet<&str> = codes.iter().map(|code| code.name()).collect();
    assert_eq!(names.len(), codes.len(), "a code is declared twice");
    let found: BTreeSet<String> = fs::read_dir(fixtures())
        .unwrap()
        .map(|entry| entry.unwrap().path().file_stem().unwrap().to_str().unwrap().to_owned())
        .collect();
    assert_eq!(found.iter().map(String::as_str).collect::<BTreeSet<_>>(), names);
}

/// Runs each example with its command: the wrong one yields exactly its code, the right one no diagnostic.
#[test]
fn examples_of_codes_yield_exactly_their_code() {
    let catalogs = [
        diag::codes::CATALOG,
        datalog::codes::CATALOG,
        yaml::codes::CATALOG,
        config::codes::CATALOG,
        city::codes::CATALOG,
        sim::codes::CATALOG,
        task::codes::CATALOG,
        task::spf::codes::CATALOG,
        task::vap::codes::CATALOG,
        task::induction::codes::CATALOG,
    ];
    let mut examples = Vec::new();
    for catalog in catalogs {
        let explained = diag::explanations(&catalog);
        let names: Vec<&str> = explained.iter().map(|one| one.code.name()).collect();
        let expected: Vec<&str> = catalog.summaries.iter().map(|(code, _)| code.name()).collect();
        assert_eq!(names, expected, "a section is missing or incomplete");
        let sections = catalog.text.matches("## ").count();
        assert_eq!(sections, names.len(), "a section has no code");
        for one in explained {
            examples.push((one.code.name(), one.command, one.wrong, vec![one.code.name()]));
            examples.push((one.code.name(), one.command, one.right, vec![]));
        }
    }
    // Tests of the documentation run those in Rust.
    examples.retain(|(_, _, example, _)| example.language != "rust");
    assert!(examples.len() > 100);
    let next = AtomicUsize::new(0);
    std::thread::scope(|scope| {
        for _ in 0..4 {
            scope.spawn(|| {
                while let Some((code, command, example, expected)) = examples.get(next.fetch_add(1, Ordering::Relaxed))
                {
                    let (found, said) = codes_of(*command, example);
                    let expected: BTreeSet<String> = expected.iter().map(|&code| code.to_owned()).collect();
                    assert_eq!(found, expected, "{code}:\n{}\n{said}", example.text);
                }
            });
        }
    });
}

/// Writes the files of an example to a folder and runs its command there. Returns the codes in the output, and the
/// output.
fn codes_of(command: Option<&str>, example: &Example) -> (BTreeSet<String>, String) {
    let folder = tempfile::tempdir().unwrap();
    let extension = if example.language == "json" {
        "jsonl"
    } else {
        example.language
    };
    let mut file = format!("main.{extension}");
    let command = command.map_or_else(|| format!("logicity check {file}"), str::to_owned);
    let mut text = String::new();
    for line in example.text.lines() {
        let name = ["// file: ", "# file: "]
            .iter()
            .find_map(|start| line.strip_prefix(start));
        match name {
            Some(name) => {
                fs::write(folder.path().join(&file), std::mem::take(&mut text)).unwrap();
                name.clone_into(&mut file);
            }
            None => text += &format!("{line}\n"),
        }
    }
    fs::write(folder.path().join(&file), text).unwrap();
    let said = shell(&command, folder.path());
    let pattern = Regex::new(r#"(?:error|warning)\[([a-z-]+)\]|"code": ?"([a-z-]+)""#).unwrap();
    let found = pattern
        .captures_iter(&said)
        .map(|found| found[if found.get(1).is_some() { 1 } else { 2 }].to_owned());
    (found.collect(), said)
}

#[test]
fn codes_prints_explanations() {
    let text = |output: &Output| String::from_utf8(output.stdout.clone()).unwrap();
    let listed = text(&logicity(&["codes"]));
    let json = logicity(&["codes", "--json"]);
    let lines = text(&json);
    assert_eq!(
        listed.lines().filter(|line| line.starts_with("  ")).count(),
        lines.lines().count()
    );
    let first: Value = serde_json::from_str(lines.lines().next().unwrap()).unwrap();
    assert_eq!(first["code"], "syntax");
    // As in a message, or the name alone.
    let one = logicity(&["codes", "error[unbound-variable]"]);
    assert_eq!(one.stdout, logicity(&["codes", "unbound-variable"]).stdout);
    assert!(text(&one).starts_with("error[unbound-variable]: A variable that no positive atom"));
    let unknown = logicity(&["codes", "unbound-varaible"]);
    assert_eq!(unknown.status.code(), Some(2));
    let said = String::from_utf8(unknown.stderr).unwrap();
    assert_eq!(
        said,
        "error: no code `unbound-varaible`\nhelp: did you mean `unbound-variable`?\n"
    );
}

#[test]
fn cities_fail_as_their_fixtures_expect() {
    let out = tempfile::tempdir().unwrap();
    let out = out.path().to_str().unwrap();
    for code in [
        "unknown-split",
        "rule-mismatch",
        "invalid-map",
        "no-start-cell",
        "no-route",
        "external-predicate",
    ] {
        let path = fixtures().join(code).with_extension("yaml");
        let split = if code == "unknown-split" { "train" } else { "test" };
        let output = logicity(&[
            "run",
            path.to_str().unwrap(),
            "--ticks",
            "1",
            "--split",
            split,
            "--out",
            out,
        ]);
        let said = String::from_utf8(output.stderr).unwrap();
        // The split comes from an option.
        let exit = if code == "unknown-split" { 2 } else { 1 };
        assert_eq!(output.status.code(), Some(exit), "{said}");
        assert!(said.contains(&format!("error[{code}]")), "{said}");
        let text = fs::read_to_string(&path).unwrap();
        let file = path.file_name().unwrap().to_str().unwrap();
        for (line, _) in text.lines().enumerate().filter(|(_, text)| text.contains("# error[")) {
            assert!(
                said.contains(&format!("{file}:{}:", line + 1)),
                "line {} of {file} is not named:\n{said}",
                line + 1
            );
        }
    }
}

#[test]
fn the_dense_executor_rejects_its_fixture() {
    let config = fixtures().join("dense-unsupported/main.yaml");
    let config = config.to_str().unwrap();
    let run = |executor| logicity(&["run", config, "--ticks", "1", "--no-trace", "--executor", executor]);
    let output = run("dense");
    let said = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{said}");
    for part in [
        "error[dense-unsupported]",
        "because `Reach` depends on itself",
        "reach.dl:5:16",
    ] {
        assert!(said.contains(part), "{part} is missing in:\n{said}");
    }
    assert_eq!(run("auto").status.code(), Some(0));
}

#[test]
fn a_cancelled_commit_has_its_own_code() {
    let mut sources = Sources::new();
    let text = fs::read_to_string(fixtures().join("cancelled.dl")).unwrap();
    let entry = sources.add("cancelled.dl", text);
    let (program, _) = Program::load(&mut sources, entry, &BuiltinFiles);
    let program = program.unwrap();
    let code = |limits: Limits, cancelled: bool| {
        let mut session = program.session();
        session.set_limits(limits);
        let error = session.commit_with(&Cancel::when(move || cancelled)).unwrap_err();
        error.diagnostic(program.rules()).code
    };
    assert_eq!(code(Limits::default(), true), codes::CANCELLED);
    let few = Limits {
        rows: 1000,
        ..Limits::default()
    };
    assert_eq!(code(few, false), codes::LIMIT_EXCEEDED);
}

#[test]
fn scenes_and_facts_fail_as_their_fixtures_expect() {
    let scenes = fixtures().join("invalid-scene.jsonl");
    let output = logicity(&["infer", scenes.to_str().unwrap()]);
    assert_eq!(output.status.code(), Some(1));
    let lines = fs::read_to_string(&scenes).unwrap();
    let answers = String::from_utf8(output.stdout).unwrap();
    assert_eq!(answers.lines().count(), lines.lines().count());
    for (answer, line) in answers.lines().zip(1..) {
        let answer: Value = serde_json::from_str(answer).unwrap();
        assert_eq!(answer["error"][0]["code"], "invalid-scene");
        assert_eq!(answer["error"][0]["labels"][0]["line"], line);
    }

    let folder = fixtures().join("invalid-fact");
    let folder = folder.to_str().unwrap();
    let output = logicity(&["query", &format!("{folder}/main.dl"), "-F", folder, "-D", "-"]);
    let said = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{said}");
    for part in ["error[invalid-fact]", "age.facts:2:5", "age.facts:3:1"] {
        assert!(said.contains(part), "{part} is missing in:\n{said}");
    }
}

#[test]
fn functors_fail_as_their_fixture_expects() {
    let path = fixtures().join("failed-functor.dl");
    let output = logicity(&["query", path.to_str().unwrap(), "-D", "-"]);
    let said = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{said}");
    for part in [
        "error[failed-functor]: the functor `twice` has no definition",
        "failed-functor.dl:5:6",
        "program.define(\"twice\", ...)",
        "functors={\"twice\": ...}",
    ] {
        assert!(said.contains(part), "{part} is missing in:\n{said}");
    }
}

#[test]
fn traces_fail_as_their_fixtures_expect() {
    let given: [(&str, &[&str]); 2] = [
        ("invalid-trace", &[]),
        ("trace-mismatch", &["--config", "configs/easy.yaml"]),
    ];
    for (code, options) in given {
        let path = fixtures().join(code).with_extension("jsonl");
        let output = logicity(&[&["explain", path.to_str().unwrap(), "--agent", "Car_1"], options].concat());
        let said = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(1), "{said}");
        assert!(said.contains(&format!("error[{code}]")), "{said}");
    }
}

#[test]
fn episodes_fail_as_their_fixture_expects() {
    let path = fixtures().join("invalid-episode/main.yaml");
    let output = logicity(&["episodes", "check", path.to_str().unwrap()]);
    let said = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{said}");
    for part in ["error[invalid-episode]: 1 trip of 2 agents", "short.jsonl:3:1"] {
        assert!(said.contains(part), "{part} is missing in:\n{said}");
    }
}

#[test]
fn planning_problems_and_plans_fail_as_their_fixtures_expect() {
    let path = |name: &str| fixtures().join(name).to_str().unwrap().to_owned();
    let out = tempfile::tempdir().unwrap();
    let out = out.path().to_str().unwrap();
    let (config, plan) = (path("pddl-unsupported/main.yaml"), path("invalid-plan.txt"));
    for (arguments, parts) in [
        (
            ["pddl", &config, "--out", out],
            ["error[pddl-unsupported]: PDDL cannot state aggregates", "main.dl:3:1"],
        ),
        (
            ["pddl", "easy", "--replay", &plan],
            [
                "error[invalid-plan]: `(go-north t0 t1 p0 p2)` is no action",
                "invalid-plan.txt:2:1",
            ],
        ),
    ] {
        let output = logicity(&arguments);
        let said = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(1), "{said}");
        for part in parts {
            assert!(said.contains(part), "{part} is missing in:\n{said}");
        }
    }
}

#[test]
fn facts_that_violate_constraints_are_errors() {
    let folder = fixtures().join("constraint-violation");
    let folder = folder.to_str().unwrap();
    let output = logicity(&["query", &format!("{folder}/main.dl"), "-F", folder, "-D", "-"]);
    let said = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert!(output.stdout.is_empty());
    for part in [
        "error[constraint-violation]: both `Car(\"b\")` and `Walker(\"b\")` hold",
        "`Bus(\"c\")` holds, `Car(\"c\")` does not",
        "`Near(\"b\", \"b\")` holds",
        "`Near(\"a\", \"b\")` holds, `Near(\"b\", \"a\")` does not",
        "`Bus(\"c\")` holds, none of `Car(\"c\")`, `Walker(\"c\")` does",
        "`Car(\"b\")` holds, `Sees(\"b\", \"b\")` does not",
        "both `Before(\"a\", \"b\")` and `Before(\"b\", \"a\")` hold",
        "main.dl:8:1",
    ] {
        assert!(said.contains(part), "{part} is missing in:\n{said}");
    }
}

/// Lints are on the lines that the fixtures mark, and nowhere else.
#[test]
fn lints_are_reported_as_their_fixtures_expect() {
    const ALWAYS: [&str; 4] = [
        "contradictory-body",
        "action-conflict",
        "no-collision-clause",
        "unquoted-agent",
    ];
    for code in ALWAYS.into_iter().chain(["redundant-literal", "repeated-body"]) {
        let path = fixtures().join(code).with_extension("dl");
        let text = fs::read_to_string(&path).unwrap();
        let marked: Vec<usize> = text
            .lines()
            .zip(1..)
            .filter(|(line, _)| line.contains("// warning["))
            .map(|(_, number)| number)
            .collect();
        let output = logicity(&["check", "--lints", "--json", path.to_str().unwrap()]);
        assert_eq!(output.status.code(), Some(0));
        let answer: Value = serde_json::from_slice(&output.stdout).unwrap();
        let found = answer["diagnostics"].as_array().unwrap();
        assert!(
            found
                .iter()
                .all(|lint| lint["code"] == code && lint["severity"] == "warning"),
            "{answer}"
        );
        let lines: Vec<usize> = found
            .iter()
            .map(|lint| lint["labels"][0]["line"].as_u64().unwrap() as usize)
            .collect();
        assert_eq!(lines, marked, "{answer}");
        let quiet = logicity(&["check", path.to_str().unwrap()]);
        assert_eq!(quiet.stderr.is_empty(), !ALWAYS.contains(&code));
    }
}

/// `check` of a configuration and `run` warn of names that no agent has, on the lines that the fixture marks.
#[test]
fn unknown_agents_are_reported_as_their_fixture_expects() {
    let folder = fixtures().join("unknown-agent");
    let text = fs::read_to_string(folder.join("main.dl")).unwrap();
    let lines = text.lines().zip(1..);
    let marked: Vec<usize> = lines
        .filter(|(line, _)| line.contains("// warning["))
        .map(|(_, number)| number)
        .collect();
    assert_eq!(marked.len(), 4);
    let config = folder.join("main.yaml");
    let config = config.to_str().unwrap();
    for arguments in [
        &["check", config] as &[&str],
        &["run", config, "--ticks", "5", "--no-trace"],
    ] {
        let output = logicity(arguments);
        let said = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(0), "{said}");
        assert_eq!(said.matches("no agent has the name").count(), marked.len(), "{said}");
        for line in &marked {
            assert!(said.contains(&format!("main.dl:{line}:")), "{line}: {said}");
        }
        assert!(said.contains("did you mean `\"Pedestrian_1\"`?"), "{said}");
        assert!(said.contains("the agents are Car_1 to Car_"), "{said}");
    }
    // Rules alone may be for scenes, in which agents have any names.
    let output = logicity(&["check", folder.join("main.dl").to_str().unwrap()]);
    assert!(!String::from_utf8(output.stderr).unwrap().contains("unknown-agent"));
}

/// `check` warns of parts of a configuration that nothing uses, on the lines that the fixtures mark. Those of a base,
/// or of a map with a file of its own, may serve others.
#[test]
fn unused_parts_of_configurations_are_reported() {
    for code in ["unused-definition", "unused-kind", "unused-zone"] {
        let path = fixtures().join(code).with_extension("yaml");
        let text = fs::read_to_string(&path).unwrap();
        let marked = text.lines().position(|line| line.contains("# warning[")).unwrap() + 1;
        let found = |path: &std::path::Path| -> Vec<(String, u64)> {
            let output = logicity(&["check", "--json", path.to_str().unwrap()]);
            assert_eq!(output.status.code(), Some(0));
            let answer: Value = serde_json::from_slice(&output.stdout).unwrap();
            let faults = answer["diagnostics"].as_array().unwrap().iter();
            let place = |fault: &Value| fault["labels"][0]["line"].as_u64().unwrap();
            faults
                .map(|fault| (fault["code"].as_str().unwrap().to_owned(), place(fault)))
                .collect()
        };
        assert_eq!(found(&path), [(code.to_owned(), marked as u64)]);
        let folder = tempfile::tempdir().unwrap();
        let other = folder.path().join("other.yaml");
        fs::write(&other, format!("base: {}\n", path.display())).unwrap();
        assert_eq!(found(&other), []);
    }
}

/// `check` of a configuration reports what does not fit it, on the lines that the fixtures mark, and `check --config`
/// the same.
#[test]
fn faults_of_rules_in_a_city_are_reported_as_their_fixtures_expect() {
    for (code, exit) in [
        ("constraint-mismatch", 1),
        ("empty-predicate", 0),
        ("unused-output", 0),
        ("unread-predicate", 0),
        ("unused-action", 0),
    ] {
        let folder = fixtures().join(code);
        let text = fs::read_to_string(folder.join("main.dl")).unwrap();
        let lines = text.lines().zip(1..);
        let marked: Vec<u64> = lines
            .filter(|(line, _)| line.contains(&format!("[{code}]")))
            .map(|(_, number)| number)
            .collect();
        assert!(!marked.is_empty());
        let [config, rules] = ["main.yaml", "main.dl"].map(|name| folder.join(name).to_str().unwrap().to_owned());
        for arguments in [
            vec!["check", "--json", &config],
            vec!["check", "--json", &rules, "--config", &config],
        ] {
            let output = logicity(&arguments);
            assert_eq!(output.status.code(), Some(exit));
            let answer: Value = serde_json::from_slice(&output.stdout).unwrap();
            let found = answer["diagnostics"].as_array().unwrap();
            assert!(found.iter().all(|fault| fault["code"] == code), "{answer}");
            let lines = found.iter().map(|fault| fault["labels"][0]["line"].as_u64().unwrap());
            assert_eq!(lines.collect::<Vec<u64>>(), marked, "{answer}");
        }
        // Rules alone may be for another city.
        let output = logicity(&["check", &rules]);
        assert!(!String::from_utf8(output.stderr).unwrap().contains(&format!("[{code}]")));
    }
}

/// The only diagnostic concerns the published rules of `vap-hard`.
#[test]
fn the_shipped_rules_pass_without_a_diagnostic() {
    for entry in fs::read_dir(root().join("rules")).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_some_and(|extension| extension == "dl") {
            let output = logicity(&["check", path.to_str().unwrap()]);
            let said = String::from_utf8_lossy(&output.stderr);
            match path.file_name().unwrap().to_str() {
                Some("vap-hard.dl") => assert_eq!(said.matches("warning[action-conflict]").count(), 1, "{said}"),
                // Cars keep their distance by a predicate of their configuration.
                Some("town.dl") => assert_eq!(said.matches("warning[no-collision-clause]").count(), 1, "{said}"),
                _ => assert!(said.is_empty(), "{said}"),
            }
            assert!(!said.contains("error"), "{said}");
        }
    }
}

/// Scenes in the reference get the documented answers.
#[test]
fn the_scenes_of_the_reference_behave_as_documented() {
    let mut last = Value::Null;
    let mut count = 0;
    for (page, text) in pages() {
        for block in blocks(&text) {
            if block.kind == "json answer" {
                count += 1;
                assert_eq!(serde_json::from_str::<Value>(&block.text).unwrap(), last);
            }
            // The documented scenes satisfy the constraints of the rules.
            let option = match block.kind.as_str() {
                "json scene" => "--check-constraints",
                "json marginals" => "--marginals",
                _ => continue,
            };
            count += 1;
            let folder = tempfile::tempdir().unwrap();
            let file = folder.path().join("scene.jsonl");
            fs::write(&file, &block.text).unwrap();
            let output = logicity(&["infer", option, file.to_str().unwrap()]);
            let said = String::from_utf8_lossy(&output.stderr);
            assert_eq!(
                output.status.code(),
                Some(0),
                "{}:{}\n{said}",
                page.display(),
                block.line
            );
            last = serde_json::from_slice(&output.stdout).unwrap();
        }
    }
    assert!(count >= 5);
}

/// `query` accepts rules for an input, and so do `check` and `diff` unless they are rules for a city, which computes its
/// input.
#[test]
fn commands_warn_of_a_derived_input_outside_of_cities() {
    let folder = fixtures().join("extended-input");
    let folder = folder.to_str().unwrap();
    let rules = format!("{folder}/main.dl");
    let output = logicity(&["query", &rules, "-F", folder, "-D", "-"]);
    let said = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(0), "{said}");
    assert!(said.contains("warning[extended-input]"), "{said}");
    assert!(said.contains("main.dl:4:1"), "{said}");
    let answer = String::from_utf8(output.stdout).unwrap();
    assert_eq!(
        answer,
        "---------------\nEdge\nx\ty\n===============\na\tb\nb\ta\n===============\n"
    );

    let folder = tempfile::tempdir().unwrap();
    let other = |name: &str, clause: &str| {
        let path = folder.path().join(name);
        let text = format!(".decl Edge(x: symbol, y: symbol)\n.input Edge\n.output Edge\n{clause}\n");
        std::fs::write(&path, text).unwrap();
        path.to_str().unwrap().to_owned()
    };
    let same = other("same.dl", "Edge(b, a) :- Edge(a, b), a != b.");
    let less = other("less.dl", "");
    let counting = other("counting.dl", "Edge(x, y) :- Edge(y, x), 0 < count : { Edge(y, x) }.");
    for (arguments, code, words) in [
        (vec!["check", &rules], 0, ""),
        (vec!["diff", &rules, &same], 0, "no difference in any scene"),
        (
            vec!["diff", &same, &rules, "--given", "X != Y"],
            0,
            "no difference in any scene",
        ),
        (
            vec!["diff", &rules, &less],
            1,
            r#"derives Edge("e0", "e1"), Edge("e1", "e0")"#,
        ),
        (vec!["diff", &less, &rules], 1, r#""facts":{"Edge":[["#),
    ] {
        let output = logicity(&arguments);
        let said = String::from_utf8(output.stderr).unwrap();
        let answer = String::from_utf8(output.stdout).unwrap();
        assert_eq!(output.status.code(), Some(code), "{arguments:?} {answer} {said}");
        assert!(
            said.contains("warning[extended-input]") && answer.contains(words),
            "{answer} {said}"
        );
    }
    let output = logicity(&["diff", &less, &counting]);
    assert!(
        String::from_utf8(output.stderr)
            .unwrap()
            .contains("error[cyclic-negation]")
    );

    let city = tempfile::tempdir().unwrap();
    let city = city.path().join("city.dl");
    let text =
        ".include \"vocabulary.dl\"\nNextTo(X, Y) :- NextTo(Y, X).\nStop(X) :- CollidingClose(X, Y), NextTo(X, Y).\n";
    std::fs::write(&city, text).unwrap();
    let city = city.to_str().unwrap();
    for arguments in [&["check"][..], &["check", "--config", "easy"], &["diff", city]] {
        let output = logicity(&[arguments, &[city]].concat());
        let said = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(1), "{said}");
        assert!(said.contains("error[derived-input]"), "{said}");
    }
    let output = logicity(&["check", "--config", "easy", &rules]);
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(said.contains("error[derived-input]"), "{said}");
}

/// Natural mistakes, and the words that help.
#[test]
fn natural_mistakes_get_help() {
    let rules = |clause: &str| {
        format!(".decl P(x: symbol)\n.decl Q(x: symbol)\n.decl R(x: symbol)\n.input P, Q\n.output R\n{clause}\n")
    };
    let city = |lines: &str| format!("base: expert\ntask: ~\n{lines}\n");
    let cases = [
        (
            "main.dl",
            rules("R(X) :- once 20 P(X)."),
            "the window is in brackets: `once[0,20] P(X)`",
        ),
        (
            "main.dl",
            rules("R(X) :- P(X), for 5 Q(X)."),
            "the window is in brackets: `for[5] P(X)`",
        ),
        (
            "main.dl",
            rules("R(X) :- Not(P(X)) since Q(X)."),
            "an atom stands before `since`",
        ),
        (
            "main.dl",
            rules("R(X) :- 0.3 :: P(X)."),
            "a probability stands before the head",
        ),
        (
            "main.dl",
            rules("once[0,5] R(X) :- P(X)."),
            "temporal operators stand in bodies",
        ),
        (
            "main.yaml",
            city("predicates: {InSchool: {zone: school}}"),
            "definitions stand under `define`: `define: {InSchool: ...}`",
        ),
        (
            "main.yaml",
            city("zones: {school: [{block: [1, 1]}]}"),
            "it is a key of the map",
        ),
        (
            "main.yaml",
            city("agents: {cars: [{count: 1, priority: 1}]}"),
            "agents belong to a split: `test: {cars: ...}`",
        ),
        (
            "main.yaml",
            city(
                "kinds: {Tram: {of: Car, cells: {Normal: 2}}}\npredicates: {define: {IsWild: {concept: wild, of: Tram}}}",
            ),
            "write what the kind is `of`, `Car` or `Pedestrian`",
        ),
    ];
    let folder = tempfile::tempdir().unwrap();
    let said = |path: &std::path::Path| String::from_utf8(logicity(&["check", path.to_str().unwrap()]).stderr).unwrap();
    for (file, text, help) in cases {
        let path = folder.path().join(file);
        fs::write(&path, &text).unwrap();
        let said = said(&path);
        assert!(said.contains(help), "{text}\n{said}");
    }
    let waits = ".include \"vocabulary.dl\"\n.decl Waited(x: agent, n: number)\n.decl IsTram(x: agent)\n\
                 .input Waited, IsTram\nStop(X) :- CollidingClose(X, Y), Waited(X, n), n < 40, Not(IsTram(X)).\n";
    fs::write(folder.path().join("waits.dl"), waits).unwrap();
    let path = folder.path().join("main.yaml");
    let kind = "kinds: {Tram: {of: Car, cells: {Normal: 2}}}\nrules: waits.dl\n";
    let lists = "predicates: {define: {Waited: {quantity: waited}, IsTram: {kind: Tram}}}";
    fs::write(&path, city(&format!("{kind}{lists}"))).unwrap();
    let warned = said(&path);
    assert!(warned.contains("no agent has the kind `Tram`"), "{warned}");
    assert!(warned.contains("`Tram: [{count: 1, priority: 1}]`"), "{warned}");
    let used = lists.replace("predicates: {", "predicates: {use: [IsCar, CollidingClose, IsTram], ");
    fs::write(
        &path,
        format!(
            "base: common\nmap: square-5x5\n{kind}{used}\nagents: {{test: {{cars: [{{count: 1, priority: 1}}]}}}}\n"
        ),
    )
    .unwrap();
    let unlisted = said(&path);
    assert!(unlisted.contains("defines but does not use"), "{unlisted}");
    assert!(
        unlisted.contains("add `Waited` to `use`: `predicates: {use: [IsCar, CollidingClose, IsTram, Waited]}`"),
        "{unlisted}"
    );
    // A question about a quantity is answered with its value.
    let used = used.replace("IsTram], ", "IsTram, Waited], ");
    fs::write(&path, format!("base: common\nmap: square-5x5\nregion: ~\n{kind}{used}\nagents: {{test: {{cars: [{{count: 1, priority: 1}}]}}}}\n")).unwrap();
    let run = folder.path().join("run");
    let done = logicity(&[
        "run",
        path.to_str().unwrap(),
        "--ticks",
        "3",
        "--no-pictures",
        "--out",
        run.to_str().unwrap(),
    ]);
    assert_eq!(done.status.code(), Some(0), "{}", String::from_utf8_lossy(&done.stderr));
    let trace = run.join("trace.jsonl");
    let answer = logicity(&[
        "explain",
        trace.to_str().unwrap(),
        "--agent",
        "Car_1",
        "--why",
        "Waited(Car_1, 99)",
    ]);
    let answer = String::from_utf8(answer.stdout).unwrap();
    assert!(
        answer.contains("does not hold: it is a base fact, computed as `{quantity: waited}`"),
        "{answer}"
    );
    assert!(answer.contains("; Waited(\"Car_1\", 0) holds"), "{answer}");
}
