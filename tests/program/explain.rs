//! `explain` and `infer` explain any fact of a city: base and derived predicates, pairs, negative answers.

use crate::cli::{code, err, fails, out, run, write};
use serde_json::Value;

/// Records a run of two ticks with one more derived predicate. Returns the path of the trace.
fn trace(folder: &std::path::Path) -> String {
    let rules = write(
        folder,
        "rules.dl",
        ".include \"vocabulary.dl\"\n.decl Crowded(x: agent)\n/// C1: another agent is near\n\
         Crowded(X) :- NextTo(X, Y).\nStop(X) :- CollidingClose(X, Y).\nSlow(X) :- Not(Stop(X)), Crowded(X), IsTiro(X).\n",
    );
    let to = folder.join("out");
    let to = to.to_str().unwrap();
    let output = run(
        &[
            "run",
            "expert",
            "--rules",
            &rules,
            "--ticks",
            "2",
            "--no-pictures",
            "--out",
            to,
        ],
        b"",
    );
    assert_eq!(code(&output), 0, "{}", err(&output));
    format!("{to}/trace.jsonl")
}

#[test]
fn explain_takes_any_fact() {
    let folder = tempfile::tempdir().unwrap();
    let trace = trace(folder.path());
    for (arguments, said) in [
        (
            vec!["--agent", "Car_1", "--why", "IsCar"],
            "tick 1: IsCar(\"Car_1\") holds, because:\n",
        ),
        (
            vec!["--agent", "Car_1", "--why", "IsPedestrian"],
            "IsPedestrian(\"Car_1\") does not hold, because:\n",
        ),
        (
            vec!["--why-not", "IsBus(Pedestrian_1)"],
            "IsBus(\"Pedestrian_1\") does not hold, because:\n",
        ),
        (
            vec!["--why", "Sees(Car_1, \"Car_1\")."],
            "Sees(\"Car_1\", \"Car_1\") holds, because:\n",
        ),
        (vec!["--why", "Sees(Car_1, _)"], "Sees(\"Car_1\", _) holds, because:\n"),
        (
            vec!["--agent", "Car_2", "--why-not", "NextTo(Car_1, Car_1)"],
            "NextTo(\"Car_1\", \"Car_1\") does not hold",
        ),
        (vec!["--agent", "Car_1", "--why-not", "Slow(Car_2)"], "Slow(\"Car_2\")"),
        (vec!["--why", "Crowded(_)"], "C1: another agent is near"),
        (vec!["--agent", "Car_1", "--why-not", "Fast"], "tick 1: Car_1 at ["),
    ] {
        let output = run(&[vec!["explain", &trace], arguments.clone()].concat(), b"");
        assert_eq!(code(&output), 0, "{arguments:?}: {}", err(&output));
        assert!(out(&output).contains(said), "{arguments:?}: {}", out(&output));
    }
    let json = run(
        &[
            "explain",
            &trace,
            "--tick",
            "0",
            "--why",
            "Sees(Car_1, Car_1)",
            "--json",
        ],
        b"",
    );
    let json: Value = serde_json::from_slice(&json.stdout).unwrap();
    assert_eq!(
        (&json["tick"], &json["holds"], &json["fact"]),
        (&0.into(), &true.into(), &"Sees(\"Car_1\", \"Car_1\")".into())
    );
    assert!(!json["nodes"].as_array().unwrap().is_empty());
}

#[test]
fn faulty_questions_are_explained_at_their_places() {
    let folder = tempfile::tempdir().unwrap();
    let trace = trace(folder.path());
    for (fact, place, words) in [
        (
            "Crowdd",
            "--why:1:1",
            &["error[unknown-predicate]", "did you mean `Crowded`?"] as &[&str],
        ),
        (
            "IsClose(Car_1)",
            "--why:1:1",
            &[
                "error[arity-mismatch]",
                "has 2 columns, but 1 value is given",
                "declared here",
            ],
        ),
        (
            "IsClose(Car_1, Car_99)",
            "--why:1:16",
            &["error[invalid-fact]", "there is no agent `Car_99`", "did you mean"],
        ),
        ("IsClose(Car_1, \"Car", "--why:1:1", &["error[syntax]"]),
        ("IsClose(Car_1 Car_2)", "--why:1:9", &["error[syntax]"]),
        ("!Stop(Car_1)", "--why:1:1", &["error[syntax]", "for example `Stop`"]),
        ("", "--why:1:1", &["error[syntax]"]),
        (
            "Stop",
            "--why:1:1",
            &["error[invalid-fact]", "`Stop` needs an agent", "`Stop(Car_1)`"],
        ),
    ] {
        let output = run(&["explain", &trace, "--why", fact], b"");
        fails(&output, 2, &[&[place], words].concat());
    }
    fails(&run(&["explain", &trace], b""), 2, &["--agent"]);
}

#[test]
fn infer_explains_facts_of_scenes() {
    let scene = b"{\"entities\": [\"me\", \"you\"], \"ego\": \"me\", \
                  \"facts\": {\"IsCar\": [\"me\", \"you\"], \"IsAtInter\": [\"me\"], \"IsInInter\": [\"you\"]}}\n";
    let answer = |option: &str, fact: &str| -> Value {
        let output = run(&["infer", "--config", "easy", option, fact], scene);
        assert_eq!(code(&output), 0, "{}", err(&output));
        serde_json::from_slice(&output.stdout).unwrap()
    };
    let why = answer("--why", "Stop");
    assert_eq!(why["egos"]["me"]["action"], "Stop");
    assert_eq!(why["explanations"][0]["fact"], "Stop(\"me\")");
    assert_eq!(why["explanations"][0]["holds"], true);
    let why_not = answer("--why-not", "IsAtInter(you)");
    assert_eq!(why_not["explanations"][0]["holds"], false);
    assert_eq!(why_not["explanations"][0]["nodes"][0]["because"], "not-a-fact");
    let wrong = run(&["infer", "--config", "easy", "--why", "IsAtInter(her)"], scene);
    fails(
        &wrong,
        2,
        &["error[invalid-fact]: there is no agent `her`", "--why:1:11"],
    );
    assert!(out(&wrong).contains("\"error\""), "{}", out(&wrong));
}

/// Ticks have the numbers that successive scenes state; otherwise they count from 0.
#[test]
fn proofs_number_the_ticks_of_scenes_as_these_do() {
    let folder = tempfile::tempdir().unwrap();
    let rules = write(
        folder.path(),
        "t.dl",
        ".include \"vocabulary.dl\"\nStop(X) :- IsCar(X), previous IsBus(X).\n",
    );
    let scene = |tick: u32| {
        format!(
            r#"{{"map": "square-5x5", "tick": {tick}, "agents": [{{"id": "Bus", "type": "Car", "at": [102, 20], "concepts": ["bus"]}}]}}"#
        )
    };
    for (ticks, shown) in [([19, 20], "in tick 19"), ([0, 0], "in tick 0"), ([7, 9], "in tick 0")] {
        let scenes = format!("[{}, {}]\n", scene(ticks[0]), scene(ticks[1]));
        let output = run(&["infer", "--rules", &rules, "--why", "Stop(Bus)"], scenes.as_bytes());
        assert_eq!(code(&output), 0, "{}", err(&output));
        assert!(
            out(&output).contains(&format!("\"when\":\"{shown}\"")),
            "{}",
            out(&output)
        );
    }
}
