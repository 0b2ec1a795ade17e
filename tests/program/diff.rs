//! `logicity diff`: printed verdicts, bounds and scenes.

use super::cli::logicity;

#[test]
fn infer_answers_the_scene_differently_under_both_rule_sets() {
    let output = logicity(["diff", "rules/medium.dl", "rules/hard.dl", "--scene"]);
    assert_eq!(output.status.code(), Some(1));
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("scene.jsonl");
    std::fs::write(&file, &output.stdout).unwrap();
    let action = |rules: &str| {
        let output = logicity(["infer", file.to_str().unwrap(), "--rules", rules]);
        let answer: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        answer["egos"]["e0"]["action"].as_str().unwrap().to_owned()
    };
    assert_eq!(
        (action("rules/medium.dl"), action("rules/hard.dl")),
        ("Normal".into(), "Stop".into())
    );
}

#[test]
fn the_command_prints_its_verdict() {
    let copy = "tests/fixtures/vap-easy-bloated.dl";
    let output = logicity(["diff", "rules/vap-easy.dl", copy]);
    let said = String::from_utf8(output.stdout).unwrap();
    assert!(said.starts_with("equivalent: proved"), "{said}");
    assert_eq!(output.status.code(), Some(0));

    let output = logicity(["diff", "rules/vap-easy.dl", copy, "--entities", "2"]);
    let said = String::from_utf8(output.stdout).unwrap();
    assert!(
        said.starts_with("no difference in any scene of at most 2 entities; a proof requires"),
        "{said}"
    );

    let output = logicity(["diff", "rules/easy.dl", "rules/medium.dl", "--predicates", "Slow,Fast"]);
    assert_eq!(output.status.code(), Some(0));
    let output = logicity(["diff", "rules/easy.dl", "rules/medium.dl", "--json"]);
    let answer: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(answer["verdict"], "different");
}

/// Symbols are quoted as in rules, and the winner of two derived actions is named.
#[test]
fn the_command_says_which_action_wins() {
    let conflict = "tests/fixtures/diagnostics/action-conflict.dl";
    let output = logicity(["diff", conflict, "rules/easy.dl", "--predicates", "Slow"]);
    let said = String::from_utf8(output.stdout).unwrap();
    assert!(said.contains("derives Slow(\"e0\")"), "{said}");

    let folder = tempfile::tempdir().unwrap();
    let rules = folder.path().join("both.dl");
    std::fs::write(
        &rules,
        ".include \"vocabulary.dl\"\nStop(X) :- CollidingClose(X, Y).\nSlow(X) :- CollidingClose(X, Y).\n",
    )
    .unwrap();
    let output = logicity(["diff", rules.to_str().unwrap(), "rules/vocabulary.dl"]);
    let said = String::from_utf8(output.stdout).unwrap();
    assert!(said.contains("Slow(\"e0\"), Stop(\"e0\")"), "{said}");
    assert!(
        said.contains("  \"e0\" takes Stop, by the default order of actions"),
        "{said}"
    );
}

#[test]
fn the_command_reports_the_bound() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, body: &str| {
        let text = format!(".decl a(x: number)\n.input a\n.decl b(x: number)\n.output b\nb(x) :- {body}.\n");
        let file = folder.path().join(name);
        std::fs::write(&file, text).unwrap();
        file.to_str().unwrap().to_owned()
    };
    let (one, same, other) = (
        write("one.dl", "a(y), x = y + 1"),
        write("same.dl", "a(y), x = 1 + y"),
        write("other.dl", "a(y), x = y + 2"),
    );
    let output = logicity(["diff", &one, &same, "--effort", "2000"]);
    let said = String::from_utf8(output.stdout).unwrap();
    assert!(
        said.starts_with("no difference found in 200 scenes: all scenes of at most "),
        "{said}"
    );
    assert_eq!(output.status.code(), Some(0));
    let output = logicity(["diff", &one, &other]);
    let said = String::from_utf8(output.stdout).unwrap();
    assert!(said.starts_with("different; a scene that shows it"), "{said}");
    assert_eq!(output.status.code(), Some(1));
}
