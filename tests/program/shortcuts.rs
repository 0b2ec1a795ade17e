//! `logicity shortcuts`: counts, labels, clauses and scenes of the shipped rules.

use super::cli::{code, err, fails, logicity, out};
use serde_json::Value;
use std::fs;

fn json<const N: usize>(arguments: [&str; N]) -> Value {
    let output = logicity(arguments);
    assert_eq!(code(&output), 0, "{}", err(&output));
    serde_json::from_slice(&output.stdout).unwrap()
}

#[test]
fn the_rules_of_the_paper_have_these_shortcuts() {
    for (mode, maps, shortcuts, labels) in [
        ("easy", 1, 0, vec![]),
        ("medium", 1, 0, vec![]),
        ("hard", 8, 4, vec!["IsClose"]),
        ("expert", 4, 0, vec![]),
        ("vap-easy", 1, 0, vec![]),
        ("vap-hard", 96, 92, vec!["IsYoung"]),
    ] {
        let found = json(["shortcuts", mode, "--json"]);
        assert_eq!(found["complete"], true, "{mode}");
        assert_eq!(found["maps"], maps, "{mode}");
        assert_eq!(found["shortcuts"].as_array().unwrap().len(), shortcuts, "{mode}");
        assert_eq!(found["labels"], Value::from(labels), "{mode}");
    }
    let found = json(["shortcuts", "hard", "--maps", "permutations", "--json"]);
    assert_eq!(found["maps"], 2);
    assert_eq!(
        found["shortcuts"][0]["confused"],
        Value::from(vec!["IsClose", "LeftOf"])
    );
    assert_eq!(found["shortcuts"][0]["images"]["IsClose"], "LeftOf");
}

/// The clause that would remove a shortcut does, and so do the labels.
#[test]
fn the_remedies_work() {
    let said = out(&logicity(["shortcuts", "hard"]));
    let clause = said
        .lines()
        .find_map(|line| line.trim().strip_prefix("would change decisions with "))
        .unwrap();
    let folder = tempfile::tempdir().unwrap();
    let rules = folder.path().join("more.dl");
    fs::write(&rules, fs::read_to_string("rules/hard.dl").unwrap() + clause + "\n").unwrap();
    let found = json(["shortcuts", rules.to_str().unwrap(), "--config", "hard", "--json"]);
    assert_eq!(
        (&found["maps"], found["shortcuts"].as_array().unwrap().len()),
        (&Value::from(4), 0)
    );
    let others = "IsPedestrian,IsCar,IsAmbulance,IsBus,IsPolice,IsOld,IsAtInter,IsInInter,NextTo,HigherPri,\
                  CollidingClose,LeftOf,RightOf";
    let found = json(["shortcuts", "hard", "--concepts", others, "--json"]);
    assert!(found["shortcuts"].as_array().unwrap().is_empty(), "{found}");
}

/// `infer` decides the scenes of `--pairs` as they say, and otherwise if the concepts are exchanged.
#[test]
fn infer_confirms_the_scenes_of_pairs() {
    let found = json(["shortcuts", "medium", "--pairs", "--json"]);
    let pairs = found["pairs"].as_array().unwrap();
    assert_eq!(pairs.len(), 6 * 5 / 2 + 4 * 3 / 2);
    let (mut scenes, mut expected) = (String::new(), Vec::new());
    for pair in pairs {
        let witness = &pair["witness"];
        let mut exchanged = witness["scene"].clone();
        let facts = exchanged["facts"].as_object_mut().unwrap();
        let [one, other] = [0, 1].map(|at| pair["concepts"][at].as_str().unwrap());
        let [first, second] = [one, other].map(|name| facts.remove(name));
        for (name, rows) in [(one, second), (other, first)] {
            if let Some(rows) = rows {
                facts.insert(name.to_owned(), rows);
            }
        }
        for (scene, at) in [(&witness["scene"], 0), (&exchanged, 1)] {
            scenes += &format!("{scene}\n");
            expected.push(witness["decisions"][at].clone());
        }
    }
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("scenes.jsonl");
    fs::write(&file, scenes).unwrap();
    let answers = out(&logicity(["infer", file.to_str().unwrap(), "--config", "medium"]));
    let actions: Vec<Value> = answers
        .lines()
        .map(|line| {
            let answer: Value = serde_json::from_str(line).unwrap();
            let ego = answer["egos"].as_object().unwrap().values().next().unwrap().clone();
            ego["action"].clone()
        })
        .collect();
    assert_eq!(actions, expected);
}

#[test]
fn faults_are_reported() {
    fails(
        &logicity(["shortcuts", "hard", "--concepts", "IsGreen"]),
        2,
        &["no decision depends on a concept `IsGreen`", "the concepts are"],
    );
    fails(
        &logicity(["shortcuts", "rules/traffic-lights.dl", "--config", "traffic-lights"]),
        1,
        &["shortcuts are not counted for expressions", "this clause has one"],
    );
    fails(
        &logicity(["shortcuts", "rules/vocabulary.dl", "--maps", "some"]),
        2,
        &["permutations, signed, all"],
    );
    fails(
        &logicity(["shortcuts", "configs/maps/square-5x5.yaml"]),
        2,
        &["name a rule file"],
    );
    fails(&logicity(["shortcuts", "missing.dl"]), 2, &["missing.dl"]);
    let one = logicity(["shortcuts", "hard", "--entities", "1", "--limit", "500"]);
    assert!(out(&one).contains("at least 500 maps"), "{}", out(&one));
    let folder = tempfile::tempdir().unwrap();
    let rules = folder.path().join("none.dl");
    fs::write(&rules, ".decl p(x: symbol)\n").unwrap();
    fails(
        &logicity(["shortcuts", rules.to_str().unwrap()]),
        1,
        &["derives no action", "derive one of"],
    );
    let few = logicity(["shortcuts", "vap-hard", "--limit", "5"]);
    assert!(
        out(&few).contains("at least 5 maps change no decision"),
        "{}",
        out(&few)
    );
    assert!(out(&few).contains("stopped at --limit maps"));
    let none = logicity(["shortcuts", "expert", "--effort", "0"]);
    assert!(
        out(&none).contains("the search ended before it found a map"),
        "{}",
        out(&none)
    );
}

/// Who sees whom is no concept, what temporal operators read is given, and constants are entities, too.
#[test]
fn concepts_are_what_perception_reports() {
    let folder = tempfile::tempdir().unwrap();
    let rules = folder.path().join("r.dl");
    let said = |body: &str| {
        fs::write(&rules, format!(".include \"vocabulary.dl\"\n{body}\n")).unwrap();
        out(&logicity(["shortcuts", rules.to_str().unwrap(), "--pairs"]))
    };
    let alone = said("Stop(X) :- IsTiro(X).");
    assert!(
        alone.starts_with("the decisions depend on 1 concept: IsTiro\n"),
        "{alone}"
    );
    let temporal = said("Slow(X) :- once[1,5] IsTiro(X), IsBus(X), Not(IsOld(X)).");
    for line in [
        "taken as given: once[1,5] IsTiro\n",
        "no decision depends on IsPedestrian, IsCar, IsAmbulance, IsPolice, IsReckless",
        "  if earlier ticks make these hold: once[1,5] IsTiro(e0)\n",
    ] {
        assert!(temporal.contains(line), "{temporal}");
    }
    let constant = said("Stop(X) :- IsTiro(\"Car_1\"), IsBus(X).");
    let pair = constant
        .lines()
        .find(|line| line.starts_with("IsBus and IsTiro: "))
        .unwrap();
    assert!(pair.contains("Stop") && pair.contains("Normal"), "{constant}");
}

/// Values of the city, such as headings, are no agents in the scenes.
#[test]
fn scenes_name_no_entity_after_a_value() {
    let folder = tempfile::tempdir().unwrap();
    let rules = folder.path().join("headings.dl");
    let text = ".decl IsCar(x: agent)\n.decl IsAtInter(x: agent)\n.decl Sees(x: agent, y: agent)\n\
                .decl Heading(x: agent, h: symbol)\n.input IsCar, IsAtInter, Sees, Heading\n\
                .type agent <: symbol\n.decl Stop(x: agent)\n.output Stop\n.scope Sees\n\
                Stop(X) :- IsCar(X), Heading(X, \"north\").\nStop(X) :- IsAtInter(X), Heading(X, \"south\").\n";
    fs::write(&rules, text).unwrap();
    let found = json(["shortcuts", rules.to_str().unwrap(), "--pairs", "--json"]);
    let scene = &found["pairs"][0]["witness"]["scene"];
    assert_eq!(scene["entities"], Value::from(vec!["e0"]), "{scene}");
    assert_eq!(scene["facts"]["Heading"][0][0], "e0", "{scene}");
}
