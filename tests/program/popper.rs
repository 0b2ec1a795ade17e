//! `logicity induce --popper`: tasks in the format of the learner Popper.

use super::cli::{logicity, run};
use serde_json::{Value, json};
use std::fs;
use std::path::Path;
use std::process::Output;

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_owned()).unwrap()
}

fn succeeds(output: &Output) -> String {
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    text(&output.stdout)
}

fn fixture(name: &str) -> String {
    format!("tests/fixtures/popper/{name}")
}

#[test]
fn a_task_yields_clauses_of_prolog_with_their_support() {
    let said = succeeds(&logicity(["induce", "--popper", &fixture("family")]));
    let expected = "\
        % Rules learned by logicity VERSION from family.\n\
        % At most 3 variables, 20000 steps per search, seed 0.\n\
        % The clauses derive 5 of 5 positive and 0 of 8 negative examples.\n\
        % No cheaper set of the clauses found covers the examples.\n\
        \n";
    let said = said.replace(env!("CARGO_PKG_VERSION"), "VERSION");
    assert!(said.starts_with(expected), "{said}");
    for clause in [
        "\ngrandmother(X, Y) :- mother(X, Z), mother(Z, Y).\n",
        "\ngrandmother(X, Y) :- mother(X, Z), father(Z, Y).\n",
    ] {
        assert!(said.contains(clause), "{said}");
    }
    assert!(said.contains("alone; the first is grandmother("), "{said}");
    // Declarations without an effect are warnings.
    let trains = logicity(["induce", "--popper", &fixture("trains")]);
    let warned = text(&trains.stderr);
    assert!(
        warned.contains("warning[ignored]: `max_clauses` has no effect"),
        "{warned}"
    );
    assert!(warned.contains("trains/bias.pl:6:1"), "{warned}");
    let clause = "east(X) :- has_car(X, Y), closed(Y), short(Y).\n";
    assert!(succeeds(&trains).ends_with(clause));
}

#[test]
fn a_rule_file_derives_the_positive_examples() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["family", "roads", "trains"] {
        let learned = folder.path().join(format!("{name}.dl"));
        let learned = learned.to_str().unwrap();
        let said = succeeds(&logicity(["induce", "--popper", &fixture(name), "-o", learned]));
        let (first, second) = said.trim_end().split_once('\n').unwrap();
        assert!(first.starts_with("wrote ") && first.ends_with(" s"), "{said}");
        assert!(second.starts_with("The clauses derive "), "{said}");
        assert_eq!(text(&logicity(["check", learned]).stderr), "");
        // Of the rows that the rule file derives, those in the examples are the positive ones.
        let rows = succeeds(&logicity(["query", learned, "-D", "-"]));
        let derived: Vec<String> = rows.lines().map(|row| row.replace('\t', ",")).collect();
        let examples = fs::read_to_string(Path::new(&fixture(name)).join("exs.pl")).unwrap();
        for example in examples.lines().filter(|line| line.contains('(')) {
            let (label, atom) = example.split_once('(').unwrap();
            let row = atom.split_once('(').unwrap().1.trim_end_matches(").");
            let row = row.trim_end_matches(')').replace(", ", ",");
            assert_eq!(derived.contains(&row), label == "pos", "{example}\n{rows}");
        }
    }
}

#[test]
fn the_report_has_counts_and_seconds() {
    let said = succeeds(&logicity([
        "induce",
        "--popper",
        &fixture("roads"),
        "-o",
        "/dev/null",
        "--report",
        "-",
    ]));
    let mut report: Value = serde_json::from_str(&said).unwrap();
    for step in ["read", "learn"] {
        assert!(
            report["seconds"][step].as_f64().is_some_and(|seconds| seconds > 0.0),
            "{said}"
        );
    }
    let positive = report["positive"].clone();
    for (key, expected) in [
        ("target", json!("served/1")),
        ("complete", json!(true)),
        ("is_cheapest", json!(true)),
        ("closed_world", json!(false)),
        ("negation", json!(false)),
        ("uncovered", json!(0)),
        ("false_positives", json!(0)),
        ("true_positives", positive),
    ] {
        assert_eq!(report[key].take(), expected, "{key}");
    }
    let clauses = report["clauses"].as_array().unwrap();
    let [clause] = &clauses[..] else { panic!("{said}") };
    assert_eq!(clause["clause"], "served(X) :- reach(X, Y), station(Y), large(X).");
    assert_eq!(clause["is_best"], true);
    assert!(clause["alone"].as_u64() <= clause["examples"].as_u64());
}

#[test]
fn options_that_would_have_no_effect_are_refused() {
    let trains = fixture("trains");
    for (options, part) in [
        (&["--questions", "3"][..], "cannot be used with"),
        (&["--log", "log.jsonl"], "cannot be used with"),
        (&["--ask", "rules/easy.dl"], "cannot be used with"),
        (&["--config", "easy"], "cannot be used with"),
        (&["--variables", "7"], "--variables 7: the bias permits at most "),
    ] {
        let output = run(&[&["induce", "--popper", &trains], options].concat(), b"");
        let said = text(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{said}");
        assert!(said.contains(part), "{said}");
    }
    let output = logicity(["induce", "--popper", &fixture("trains/bk.pl")]);
    assert_eq!(output.status.code(), Some(2));
    assert!(text(&output.stderr).contains("bk.pl` is not a folder with a task"));
}

#[test]
fn the_closed_world_and_negation_are_options() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| fs::write(folder.path().join(name), text).unwrap();
    write("bk.pl", "bird(a). bird(b). bird(c). penguin(b). fish(d).");
    write("exs.pl", "pos(flies(a)). pos(flies(c)).");
    write(
        "bias.pl",
        "head_pred(flies,1). body_pred(bird,1). body_pred(penguin,1). body_pred(fish,1).",
    );
    let path = folder.path().to_str().unwrap();
    let open = logicity(["induce", "--popper", path]);
    assert_eq!(open.status.code(), Some(1));
    let said = text(&open.stderr);
    assert!(
        said.contains("exs.pl:1:30") && said.contains("`--closed-world`"),
        "{said}"
    );
    // Without negation, no clause excludes the penguin.
    let unsolved = logicity(["induce", "--popper", path, "--closed-world"]);
    assert_eq!(unsolved.status.code(), Some(1));
    let said = text(&unsolved.stderr);
    let expected = "error[uncovered-examples]: the clauses do not derive 2 of 2 positive examples\n";
    assert!(
        said.starts_with(expected) && said.contains("the first is flies(a)"),
        "{said}"
    );
    let positive = text(&unsolved.stdout);
    assert!(
        positive.contains("derive 0 of 2 positive and 0 of 2 negative"),
        "{positive}"
    );
    assert!(
        positive.contains("separates 2 positive examples from the negative examples"),
        "{positive}"
    );
    let negation = ["induce", "--popper", path, "--closed-world", "--negation"];
    let learned = succeeds(&logicity(negation));
    assert!(
        learned.ends_with("\nflies(X) :- bird(X), \\+ penguin(X).\n"),
        "{learned}"
    );
    assert!(learned.contains("seed 0, negated literals, closed world."), "{learned}");
    let rules = folder.path().join("learned.dl");
    let rules = rules.to_str().unwrap();
    let [a, b, c, d, e] = negation;
    succeeds(&logicity([a, b, c, d, e, "-o", rules]));
    let written = fs::read_to_string(rules).unwrap();
    assert!(written.ends_with("\nflies(X) :- bird(X), !penguin(X).\n"), "{written}");
    assert_eq!(
        succeeds(&logicity(["query", rules, "-D", "-"]))
            .matches("\na\nc\n")
            .count(),
        1
    );
}

#[test]
fn threads_do_not_change_the_clauses() {
    let clauses = |threads| {
        let task = fixture("trains");
        succeeds(&logicity(["induce", "--popper", &task, "--threads", threads]))
    };
    assert_eq!(clauses("1"), clauses("3"));
}
