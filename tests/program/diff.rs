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
    // The values 0, 1 and 2, so three facts.
    assert!(
        said.starts_with("no difference found in 200 scenes: all scenes of at most 3 facts "),
        "{said}"
    );
    assert_eq!(output.status.code(), Some(0));
    let output = logicity(["diff", &one, &other]);
    let said = String::from_utf8(output.stdout).unwrap();
    assert!(said.starts_with("different; a scene that shows it"), "{said}");
    assert_eq!(output.status.code(), Some(1));
}

/// Scenes that cannot be evaluated within their limits count more, and without input there is only one scene.
#[test]
fn the_time_of_the_search_is_bounded() {
    let folder = tempfile::tempdir().unwrap();
    for (input, scenes) in [("", "1 scene:"), ("a(_), ", "3 scenes:")] {
        let files = ["x + 1", "1 + x"].map(|next| {
            let declared = ".decl a(x: number)\n.input a\n.decl b(x: number)\n.output b\n";
            let text = format!("{declared}b(1).\nb({next}) :- {input}b(x), x > 0.\n");
            let file = folder.path().join(format!("{next}.dl"));
            std::fs::write(&file, text).unwrap();
            file.to_str().unwrap().to_owned()
        });
        let output = logicity(["diff", &files[0], &files[1], "--effort", "30000"]);
        let said = String::from_utf8(output.stdout).unwrap();
        assert!(said.starts_with(&format!("no difference found in {scenes}")), "{said}");
    }
}

/// A variable that no column restricts would only say that some value exists.
#[test]
fn the_variables_of_a_condition_are_columns() {
    let given = |condition: &str| {
        let output = logicity(["diff", "rules/easy.dl", "rules/medium.dl", "--given", condition]);
        (String::from_utf8(output.stderr).unwrap(), output.status.code())
    };
    for (condition, parts) in [
        (
            "IsCar(x)",
            ["`x` in the condition is not a column", "did you mean `X`?"],
        ),
        (
            "IsCar(Q)",
            ["`Q` in the condition is not a column", "the column of `Fast` is `X`"],
        ),
        ("IsCar(X), Sees(X, Z), IsBus(Y)", ["`Y` in the condition", "write `_`"]),
    ] {
        let (said, code) = given(condition);
        assert_eq!(code, Some(2), "{said}");
        for part in parts {
            assert!(said.contains(part), "{condition}: {part} is missing in:\n{said}");
        }
        assert!(said.contains("--> --given:1:") && !said.contains("_given"), "{said}");
    }
    // These are meant so.
    for condition in [
        "IsCar(X)",
        "IsCar(X).",
        "IsCar(_)",
        "IsCar(_Some)",
        "Sees(X, Y), IsBus(Y)",
    ] {
        let (said, code) = given(condition);
        assert_eq!((said.as_str(), code), ("", Some(1)), "{condition}");
    }
    let output = logicity([
        "diff",
        "rules/easy.dl",
        "rules/easy.dl",
        "--predicates",
        "Sees",
        "--given",
        "IsClose(X, y)",
    ]);
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(said.contains("the columns of `Sees` are `X`, `Y`"), "{said}");
}

/// Faults of a condition are shown once, at their place in it.
#[test]
fn faults_of_a_condition_show_it_as_typed() {
    for (condition, part, column) in [
        ("IsCr(X)", "did you mean `IsCar`?", 1),
        ("IsBus(X), IsCr(X)", "did you mean `IsCar`?", 11),
        ("IsCar(X", "expected `,` or `)`", 8),
        ("IsCar(X), 3", "expected a comparison operator", 12),
    ] {
        let output = logicity(["diff", "rules/easy.dl", "rules/medium.dl", "--given", condition]);
        let said = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(2), "{said}");
        assert!(
            said.contains(part) && said.contains(&format!("--> --given:1:{column}\n")),
            "{said}"
        );
        assert!(said.contains(&format!("1 | {condition}\n")), "{said}");
        assert!(
            !said.contains("_given") && said.matches("error[").count() == 1,
            "{said}"
        );
    }
}

/// A faulty value of an option is wrong usage, whichever option it is: exit code 1 means that the rules differ. The
/// message stands alone, and the warnings of the rules follow an answer.
#[test]
fn faulty_options_are_wrong_usage() {
    let folder = tempfile::tempdir().unwrap();
    let rules = folder.path().join("warned.dl");
    let text = ".include \"vocabulary.dl\"\nStop(X) :- IsCar(X), IsBus(X).\nStop(X) :- IsBus(X), IsCar(X).\n";
    std::fs::write(&rules, text).unwrap();
    let rules = rules.to_str().unwrap();
    for (option, value, part) in [
        ("--predicates", "Stp", "did you mean `Stop`?"),
        ("--given", "IsCr(X)", "did you mean `IsCar`?"),
    ] {
        let output = logicity(["diff", rules, "rules/easy.dl", option, value]);
        let said = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(2), "{said}");
        assert!(said.contains(part) && !said.contains("warning"), "{option}: {said}");
    }
    let output = logicity(["diff", rules, rules]);
    let said = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(0), "{said}");
    assert_eq!(said.matches("warning[duplicate-clause]").count(), 1, "{said}");
}

/// A scene names agents as scenes do, and after constants of other columns only if such a name matters.
#[test]
fn scenes_name_agents_as_scenes_do() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, clauses: &str| {
        let text = format!(
            ".include \"vocabulary.dl\"\n.decl Heading(x: agent, h: symbol)\n.decl Waited(x: agent, n: number)\n.input \
             Heading, Waited\nStop(X) :- CollidingClose(X, Y).\n{clauses}\n"
        );
        let file = folder.path().join(name);
        std::fs::write(&file, text).unwrap();
        file.to_str().unwrap().to_owned()
    };
    let scene = |left: &str, right: &str| -> serde_json::Value {
        let files = [write("left.dl", left), write("right.dl", right)];
        let output = logicity(["diff", &files[0], &files[1], "--scene"]);
        assert_eq!(output.status.code(), Some(1));
        serde_json::from_slice(&output.stdout).unwrap()
    };
    for (left, right, entities) in [
        (
            "Slow(X) :- Heading(X, \"east\"), Not(Stop(X)).",
            "Slow(X) :- Heading(X, \"north\"), Not(Stop(X)).",
            vec!["e0"],
        ),
        // Rules with numbers have another search.
        (
            "Slow(X) :- Waited(X, n), n > 3, Heading(X, \"Left\"), Not(Stop(X)).",
            "Slow(X) :- Waited(X, n), n > 4, Heading(X, \"Left\"), Not(Stop(X)).",
            vec!["e0"],
        ),
        // The name of the agent matters.
        (
            "Slow(X) :- IsBus(\"Car_1\"), IsCar(X), Not(Stop(X)).",
            "Slow(X) :- IsBus(Y), IsBus(\"Car_1\"), IsTiro(Y), IsCar(X), Not(Stop(X)).",
            vec!["Car_1"],
        ),
    ] {
        let found = scene(left, right);
        assert_eq!(found["entities"], serde_json::json!(entities), "{found}");
    }
    // Conflicts have the same scenes.
    let file = write(
        "both.dl",
        "Slow(X) :- Heading(X, \"east\"), Not(Stop(X)).\nFast(X) :- IsBus(X), Not(Stop(X)).",
    );
    let output = logicity(["check", &file, "--json"]);
    let answer: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let conflicts = answer["conflicts"].as_array().unwrap();
    let scenes: Vec<_> = conflicts.iter().filter(|one| one["finding"] == "together").collect();
    assert_eq!(scenes.len(), 1);
    assert_eq!(
        scenes[0]["scene"]["facts"]["Heading"],
        serde_json::json!([["e0", "east"]])
    );
}
