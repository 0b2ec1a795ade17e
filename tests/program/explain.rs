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

/// The message without an agent names them, and the questions that need none.
#[test]
fn an_explanation_needs_an_agent_or_a_question() {
    let folder = tempfile::tempdir().unwrap();
    let trace = trace(folder.path());
    let parts = ["`--agent`", "Car_1", "`--clause`", "`--why-not`"];
    fails(&run(&["explain", &trace], b""), 2, &parts);
}

#[test]
fn explain_takes_any_fact() {
    let folder = tempfile::tempdir().unwrap();
    let trace = trace(folder.path());
    for (arguments, said) in [
        (
            vec!["--agent", "Car_1", "--why", "IsCar"],
            "tick 1: IsCar(\"Car_1\") holds: it is a base fact, ",
        ),
        (
            vec!["--agent", "Car_1", "--why", "IsPedestrian"],
            "IsPedestrian(\"Car_1\") does not hold: it is a base fact, ",
        ),
        (
            vec!["--why-not", "IsBus(Pedestrian_1)"],
            "IsBus(\"Pedestrian_1\") does not hold: it is a base fact, ",
        ),
        (
            vec!["--why", "Sees(Car_1, \"Car_1\")."],
            "Sees(\"Car_1\", \"Car_1\") holds: it is a base fact, ",
        ),
        (vec!["--why", "Sees(Car_1, _)"], "Sees(\"Car_1\", _) holds, as Sees("),
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

/// No clause derives a base fact, so its explanation says what computes it, from which values.
#[test]
fn base_facts_are_explained_by_their_definitions() {
    let folder = tempfile::tempdir().unwrap();
    let trace = trace(folder.path());
    for (option, fact, said) in [
        (
            "--why",
            "IsCar(Car_1)",
            "tick 1: IsCar(\"Car_1\") holds: it is a base fact, computed as `{kind: Car}` from the kind and the concepts of \
             the agent\n",
        ),
        (
            "--why-not",
            "IsBus(Pedestrian_1)",
            "IsBus(\"Pedestrian_1\") does not hold: it is a base fact, computed as `{concept: bus, of: Car}` from the",
        ),
        (
            "--why",
            "Sees(Car_1, _)",
            ": it is a base fact, computed from the cells of both agents and the field of view\n",
        ),
    ] {
        let output = run(&["explain", &trace, option, fact], b"");
        assert_eq!(code(&output), 0, "{}", err(&output));
        assert!(out(&output).contains(said), "{fact}: {}", out(&output));
    }
    let output = run(&["explain", &trace, "--why", "IsCar(Car_1)", "--json"], b"");
    let json: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert!(
        json["base"].as_str().unwrap().starts_with("computed as `{kind: Car}`"),
        "{json}"
    );
}

/// Records 12 ticks of a city whose cars park at the entrances of intersections. Returns the path of the trace.
fn parking(folder: &std::path::Path) -> String {
    let rules = ".include \"vocabulary.dl\"\n.decl Park(x: agent)\n.output Park\nStop(X) :- CollidingClose(X, Y).\n\
                 /// P1: rest at the line\nPark(X) :- IsCar(X), IsAtInter(X), Not(Stop(X)).\n\
                 /// P2: has parked\nSlow(X) :- once[1,3] Park(X), Not(Stop(X)), Not(Park(X)).\n";
    write(folder, "park.dl", rules);
    let config = write(
        folder,
        "park.yaml",
        "base: expert\nrules: park.dl\ntask: ~\nactions: {priority: [Stop, Park, Slow, Fast, Normal], \
         define: {Park: {cells: {Car: 0}, park: 4}}}\n",
    );
    let to = folder.join("parked");
    let to = to.to_str().unwrap();
    let output = run(&["run", &config, "--ticks", "40", "--no-pictures", "--out", to], b"");
    assert_eq!(code(&output), 0, "{}", err(&output));
    format!("{to}/trace.jsonl")
}

/// The states of the ticks of a trace.
fn ticks(trace: &str) -> Vec<Value> {
    let text = std::fs::read_to_string(trace).unwrap();
    text.lines()
        .skip(1)
        .map(|line| serde_json::from_str(line).unwrap())
        .collect()
}

/// The explanation of a parked agent has the proof of the tick in which it was decided.
#[test]
fn parked_agents_are_explained_by_the_decision_that_parked_them() {
    let folder = tempfile::tempdir().unwrap();
    let trace = parking(folder.path());
    let ticks = ticks(&trace);
    let agents = ticks[0]["agents"].as_array().unwrap().len();
    let begins = |tick: &usize, agent: usize| {
        let action = |tick: usize| ticks[tick]["agents"][agent]["action"].as_str().unwrap();
        action(*tick) == "Park" && (*tick == 0 || action(tick - 1) != "Park")
    };
    let found = (0..agents).find_map(|agent| Some((agent, (0..30).find(|tick| begins(tick, agent))?)));
    let (agent, begin) = found.expect("a car at a line");
    let text = std::fs::read_to_string(&trace).unwrap();
    let header: Value = serde_json::from_str(text.lines().next().unwrap()).unwrap();
    let name = header["agents"][agent]["id"].as_str().unwrap();
    for (after, parked) in [(0, false), (1, true), (3, true), (4, false)] {
        let tick = (begin + after).to_string();
        let output = run(&["explain", &trace, "--agent", name, "--tick", &tick], b"");
        assert_eq!(code(&output), 0, "{}", err(&output));
        let said = out(&output);
        assert_eq!(
            said.contains(&format!("it is parked since tick {begin}; ")),
            parked,
            "{said}"
        );
        let proof = format!("tick {begin}: {name} at [");
        let decided = said.find(&proof).map(|at| &said[at..]);
        let has_proof = decided.is_some_and(|decided| decided.contains("by P1: rest at the line"));
        assert_eq!(has_proof, parked || after == 0, "{said}");
    }
    let tick = (begin + 2).to_string();
    let output = run(&["explain", &trace, "--agent", name, "--tick", &tick, "--json"], b"");
    let json: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(
        (&json["parked_since"], &json["parked"]["tick"]),
        (&begin.into(), &begin.into())
    );
    assert_eq!(json["parked"]["explanations"][0]["nodes"][0]["by"], "clause");
}

/// Questions with temporal operators agree with the literals of rules, and with the actions of the trace.
#[test]
fn explain_takes_temporal_literals() {
    let folder = tempfile::tempdir().unwrap();
    let trace = parking(folder.path());
    let recorded = ticks(&trace);
    let parks = |tick: usize| {
        let derived = recorded[tick]["agents"][0]["derived"].as_array().unwrap();
        derived.iter().any(|action| action == "Park")
    };
    let answer = |tick: usize, question: &str| -> Value {
        let tick = tick.to_string();
        let output = run(
            &[
                "explain", &trace, "--agent", "Car_1", "--tick", &tick, "--why", question, "--json",
            ],
            b"",
        );
        assert_eq!(code(&output), 0, "{question}: {}", err(&output));
        serde_json::from_slice(&output.stdout).unwrap()
    };
    let mut held = [0; 3];
    for tick in (0..40_usize).step_by(3) {
        let window = |first: usize, last: usize| (first..=last).filter_map(move |back| tick.checked_sub(back));
        let complete = |last: usize| tick >= last;
        for (kind, question, expected) in [
            (0, "once[1,3] Park", window(1, 3).any(parks)),
            (1, "for[3] Park", complete(2) && window(0, 2).all(parks)),
            (2, "previous Park(Car_1)", window(1, 1).any(parks)),
        ] {
            let answer = answer(tick, question);
            assert_eq!(answer["holds"], expected, "tick {tick}: {answer}");
            held[kind] += usize::from(answer["holds"] == true);
            if answer["holds"] == true && kind == 0 {
                let nearest = window(1, 3).find(|&at| parks(at)).unwrap();
                assert_eq!(answer["witness"]["tick"], nearest, "{answer}");
                assert_eq!(answer["witness"]["nodes"][0]["by"], "clause", "{answer}");
                let because = format!("Park(\"Car_1\") held in tick {nearest}");
                assert_eq!(answer["because"], because);
            }
        }
    }
    assert!(held[0] > 0 && held[2] > 0, "{held:?}");
    let text = run(
        &[
            "explain",
            &trace,
            "--tick",
            "2",
            "--why",
            "historically[0,5] IsCar(Car_1).",
        ],
        b"",
    );
    let said = "tick 2: historically[0,5] IsCar(\"Car_1\") does not hold, because the window begins before the first \
                tick, 0, and nothing held then\ntick 2: IsCar(\"Car_1\") holds: it is a base fact";
    assert!(out(&text).starts_with(said), "{}", out(&text));
    let text = run(
        &[
            "explain",
            &trace,
            "--tick",
            "9",
            "--why",
            "IsCar(Car_1) since[2,5] Sees(Car_1, Car_1)",
        ],
        b"",
    );
    let said = "tick 9: IsCar(\"Car_1\") since[2,5] Sees(\"Car_1\", \"Car_1\") holds, because Sees(\"Car_1\", \"Car_1\") \
                held in tick 7, and IsCar(\"Car_1\") in every later one\n";
    assert!(out(&text).starts_with(said), "{}", out(&text));
    let text = run(
        &[
            "explain",
            &trace,
            "--tick",
            "9",
            "--why-not",
            "IsPedestrian(Car_1) since[2,5] IsCar(Car_1)",
        ],
        b"",
    );
    let said = "does not hold, because IsCar(\"Car_1\") held in tick 7, but IsPedestrian(\"Car_1\") did not in tick 9\n\
                tick 9: IsPedestrian(\"Car_1\") does not hold: it is a base fact";
    assert!(out(&text).contains(said), "{}", out(&text));
    for (question, words) in [
        (
            "once[5,0] IsCar(Car_1)",
            ["error[syntax]", "the nearer tick comes first"],
        ),
        ("for IsCar(Car_1)", ["error[syntax]", "`for[5] P(X)`"]),
        ("once[0,5] IsCr(Car_1)", ["--why:1:11", "did you mean `IsCar`?"]),
        ("once[0,5]", ["error[syntax]", "--why:1"]),
    ] {
        fails(&run(&["explain", &trace, "--why", question], b""), 2, &words);
    }
    // A scene has no earlier ticks that a question could read.
    let scene = b"{\"entities\": [\"me\"], \"ego\": \"me\", \"facts\": {\"IsCar\": [\"me\"]}}\n";
    let refused = run(&["infer", "--config", "easy", "--why", "once[0,5] IsCar(me)"], scene);
    fails(
        &refused,
        2,
        &["only the trace of a run knows earlier ticks", "logicity explain TRACE"],
    );
}
