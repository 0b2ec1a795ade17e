//! `logicity induce`: rules learned from episodes, traces and scenes.

use super::cli::{logicity, run};
use std::fs;
use std::path::Path;
use std::process::{Command, Output};

pub fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_owned()).unwrap()
}

pub fn succeeds(output: &Output) -> String {
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    text(&output.stdout)
}

/// Asserts that a command fails with an exit code and a message that contains each of some texts.
pub fn fails(output: &Output, code: i32, parts: &[&str]) {
    let said = text(&output.stderr);
    assert_eq!(output.status.code(), Some(code), "{said}");
    for part in parts {
        assert!(said.contains(part), "`{part}` is missing in:\n{said}");
    }
}

/// Asserts that rules decide like those of a mode for every ego that is a car.
fn equal_for_cars(learned: &Path, mode: &str) {
    let rules = format!("rules/{mode}.dl");
    let said = succeeds(&logicity([
        "diff",
        learned.to_str().unwrap(),
        &rules,
        "--given",
        "IsCar(X)",
    ]));
    assert!(said.starts_with("equivalent: proved"), "{said}");
}

#[test]
fn episodes_yield_rules_that_are_equal_for_cars() {
    for mode in [
        "easy",
        "medium",
        "hard",
        "expert",
        "transfer-easy",
        "transfer-medium",
        "transfer-hard",
    ] {
        let folder = tempfile::tempdir().unwrap();
        let learned = folder.path().join("learned.dl");
        let said = succeeds(&logicity(["induce", "--config", mode, "-o", learned.to_str().unwrap()]));
        assert!(said.starts_with("wrote "), "{said}");
        equal_for_cars(&learned, mode);
        // Warnings would go to standard error.
        let checked = logicity(["check", learned.to_str().unwrap()]);
        succeeds(&checked);
        assert_eq!(text(&checked.stderr), "");
        succeeds(&logicity(["fmt", "--check", learned.to_str().unwrap()]));
    }
}

#[test]
fn a_city_runs_with_learned_rules() {
    let folder = tempfile::tempdir().unwrap();
    let learned = folder.path().join("learned.dl");
    let (learned, out) = (learned.to_str().unwrap(), folder.path().to_str().unwrap());
    succeeds(&logicity(["induce", "--config", "medium", "-o", learned]));
    let options = ["--ticks", "5", "--no-pictures", "--out", out];
    let [a, b, c, d, e] = options;
    succeeds(&logicity(["run", "medium", "--rules", learned, a, b, c, d, e]));
}

#[test]
fn threads_do_not_change_the_rules() {
    let rules = |threads| succeeds(&logicity(["induce", "--config", "hard", "--threads", threads]));
    let one = rules("1");
    assert_eq!(rules("3"), one);
}

#[test]
fn the_report_leaves_out_what_the_constraints_decide() {
    let folder = tempfile::tempdir().unwrap();
    let (learned, report) = (folder.path().join("learned.dl"), folder.path().join("report.json"));
    let [to, json] = [&learned, &report].map(|path| path.to_str().unwrap());
    succeeds(&logicity(["induce", "--config", "expert", "-o", to, "--report", json]));
    let rules = fs::read_to_string(&learned).unwrap();
    // `.covering IsCar, IsPedestrian` and `.disjoint IsCar, IsPedestrian` give both literals the same meaning.
    assert!(!rules.contains("could also be Not(IsCar(Y))"), "{rules}");
    // `.implies IsOld, IsPedestrian`, and the ego is never a pedestrian.
    assert!(
        rules.contains("// Never true in any example: IsPedestrian(X).\n"),
        "{rules}"
    );
    // Slow holds in some examples only as long as Stop does not.
    assert!(
        rules.contains("// Conflict: conditions of Stop and Slow both hold in "),
        "{rules}"
    );
    let report: serde_json::Value = serde_json::from_str(&fs::read_to_string(&report).unwrap()).unwrap();
    let clauses = report["clauses"].as_array().unwrap();
    let undecided = |body: &str| {
        let has_body = |clause: &&serde_json::Value| {
            let literals = clause["body"]
                .as_array()
                .unwrap()
                .iter()
                .map(|literal| literal.as_str().unwrap());
            literals.collect::<Vec<_>>().join(", ") == body
        };
        clauses.iter().find(has_body).unwrap()["undecided"].clone()
    };
    assert_eq!(
        undecided("IsAtInter(X), IsInInter(Y), Not(IsAmbulance(X))"),
        serde_json::json!(["IsCar(X)", "Not(CollidingClose(X, Y))", "Not(CollidingClose(Y, X))"])
    );
    let conflict = &report["conflicts"][0];
    assert_eq!(conflict["actions"], serde_json::json!(["Stop", "Slow"]));
    assert!(conflict["examples"].as_u64().unwrap() > 0);
    assert_eq!(report["contradictions"], 0);
}

#[test]
fn fewer_episodes_leave_more_open() {
    let report = |episodes| -> serde_json::Value {
        let said = succeeds(&logicity([
            "induce",
            "--config",
            "hard",
            "--episodes",
            episodes,
            "-o",
            "/dev/null",
            "--report",
            "-",
        ]));
        serde_json::from_str(&said).unwrap()
    };
    let (few, all) = (report("5"), report("100"));
    assert!(few["examples"].as_u64() < all["examples"].as_u64());
    for report in [&few, &all] {
        assert_eq!(report["wrong"], 0);
        assert_eq!(report["complete"], true);
        let clauses = report["clauses"].as_array().unwrap();
        let counted: u64 = report["actions"]
            .as_array()
            .unwrap()
            .iter()
            .map(|action| action["clauses"].as_u64().unwrap())
            .sum();
        assert_eq!(clauses.len() as u64, counted);
        for clause in clauses {
            assert!(clause["alone"].as_u64() <= clause["examples"].as_u64());
            assert_eq!(clause["against"], 0);
        }
    }
    assert_eq!(all["clauses"].as_array().unwrap().len(), 7);
    fails(
        &logicity(["induce", "--config", "hard", "--episodes", "101"]),
        2,
        &["100 recorded episodes"],
    );
}

#[test]
fn traces_teach_the_decisions_of_all_agents() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().to_str().unwrap();
    succeeds(&logicity([
        "run",
        "easy",
        "--ticks",
        "300",
        "--no-pictures",
        "--out",
        out,
    ]));
    let (trace, learned) = (folder.path().join("trace.jsonl"), folder.path().join("learned.dl"));
    succeeds(&logicity([
        "induce",
        trace.to_str().unwrap(),
        "--config",
        "easy",
        "-o",
        learned.to_str().unwrap(),
    ]));
    let learned = fs::read_to_string(&learned).unwrap();
    assert!(learned.contains("Stop(X) :- CollidingClose(X, Y)."), "{learned}");
    assert!(learned.contains("in tick "), "{learned}");
    assert!(
        learned.contains("The rules choose the action of every example."),
        "{learned}"
    );
}

/// Without `--config`, the learner uses the configuration in a trace. Traces of several ones need the option.
#[test]
fn traces_bring_their_configuration() {
    let folder = tempfile::tempdir().unwrap();
    let traces = ["easy", "hard"].map(|mode| {
        let out = folder.path().join(mode);
        let options = ["--ticks", "100", "--no-pictures", "--out", out.to_str().unwrap()];
        succeeds(&run(&[&["run", mode][..], &options].concat(), b""));
        out.join("trace.jsonl").to_str().unwrap().to_owned()
    });
    let [easy, hard] = &traces;
    let named = succeeds(&logicity(["induce", easy, "--config", "easy"]));
    assert_eq!(succeeds(&logicity(["induce", easy])), named);
    assert_eq!(
        succeeds(&logicity(["induce", easy, easy])).lines().last(),
        named.lines().last()
    );
    assert!(named.contains("Configuration easy "), "{named}");
    let different = ["have different configurations", "`--config FILE`"];
    fails(&logicity(["induce", easy, hard]), 2, &different);
    // A pipe can be read once only, so its configuration comes too late.
    let output = run(&["induce", "-"], &fs::read(easy).unwrap());
    fails(&output, 2, &["has the configuration `easy`", "`--config`"]);
    succeeds(&run(&["induce", "-", "--config", "easy"], &fs::read(easy).unwrap()));
}

/// Clauses use base predicates only, and a contradiction says so if the rules have other predicates.
#[test]
fn contradictions_name_the_derived_predicates() {
    let folder = tempfile::tempdir().unwrap();
    let rules = folder.path().join("vip.dl");
    let text = fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/rules/easy.dl")).unwrap();
    let vip = ".decl Vip(x: agent)\nVip(X) :- IsAmbulance(X).\nStop(X) :- Vip(X).\n";
    fs::write(&rules, format!("{text}\n{vip}")).unwrap();
    let scenes = folder.path().join("scenes.jsonl");
    let scene = |action: &str| {
        let facts = r#""entities": ["a"], "ego": "a", "facts": {"IsCar": ["a"]}"#;
        format!("{{{facts}, \"actions\": {{\"a\": \"{action}\"}}}}\n")
    };
    fs::write(&scenes, scene("Stop") + &scene("Normal")).unwrap();
    let scenes = scenes.to_str().unwrap();
    let said = [
        "contradicting-examples",
        "use base predicates only, not derived ones such as `Vip`",
    ];
    let output = logicity(["induce", scenes, "--config", "easy", "--rules", rules.to_str().unwrap()]);
    fails(&output, 1, &said);
    let plain = logicity(["induce", scenes, "--config", "easy"]);
    fails(&plain, 1, &["contradicting-examples"]);
    assert!(!self::text(&plain.stderr).contains("derived ones"));
}

#[test]
fn scenes_teach_their_actions() {
    let folder = tempfile::tempdir().unwrap();
    let scenes = folder.path().join("scenes.jsonl");
    let scene = |facts: &str, action: &str| {
        format!(
            "{{\"entities\": [\"a\", \"b\"], \"ego\": \"a\", \"facts\": {{{facts}}}, \"actions\": {{\"a\": \"{action}\"}}}}\n"
        )
    };
    let car = "\"IsCar\": [\"a\", \"b\"]";
    let lines = [
        scene(car, "Normal"),
        scene(&format!("{car}, \"IsBus\": [\"a\"]"), "fast"),
        scene(&format!("{car}, \"IsBus\": [\"b\"]"), "Normal"),
        scene(&format!("{car}, \"IsBus\": [\"a\"], \"IsPolice\": [\"b\"]"), "Slow"),
        scene(&format!("{car}, \"IsPolice\": [\"b\"]"), "Slow"),
    ];
    fs::write(&scenes, lines.concat()).unwrap();
    let learned = succeeds(&logicity(["induce", scenes.to_str().unwrap()]));
    assert!(
        learned.contains("\nSlow(X) :- Not(Stop(X)), IsPolice(Y), Sees(X, X).\n"),
        "{learned}"
    );
    assert!(
        learned.contains("\nFast(X) :- Not(Stop(X)), Not(Slow(X)), IsBus(X).\n"),
        "{learned}"
    );
    assert!(learned.contains("// No clause: 0 examples."), "{learned}");
    assert!(
        learned.contains("alone explains is scenes.jsonl, line 4, a.\n"),
        "{learned}"
    );
}

/// Names that a file gives to its entities cannot end a comment of the rule file.
#[test]
fn names_of_entities_add_no_clauses() {
    let folder = tempfile::tempdir().unwrap();
    let scene = |name: &str, fact: &str, action: &str| {
        let facts = serde_json::json!({"IsCar": [name], fact: [name]});
        serde_json::json!({"entities": [name], "ego": name, "facts": facts, "actions": {name: action}}).to_string()
    };
    let name = "a\nStop(X) :- IsCar(X).\r";
    let scenes = [scene(name, "IsBus", "Fast"), scene(name, "IsTiro", "Normal")].join("\n");
    let file = folder.path().join("scenes.jsonl");
    fs::write(&file, scenes).unwrap();
    let learned = succeeds(&logicity(["induce", file.to_str().unwrap()]));
    assert!(learned.contains("line 1, a_Stop(X) :- IsCar(X)._"), "{learned}");
    let clauses: Vec<&str> = learned
        .lines()
        .filter(|line| line.contains(":-") && !line.starts_with("//"))
        .collect();
    assert_eq!(clauses, ["Fast(X) :- Not(Stop(X)), Not(Slow(X)), IsBus(X)."]);
    let page = folder.path().join("page.html");
    let outputs = ["-o", "rules.dl", "--page", page.to_str().unwrap()];
    let [o, rules, p, page] = outputs;
    let refused = logicity(["induce", file.to_str().unwrap(), o, rules, p, page]);
    fails(&refused, 2, &["is not a trace", "logicity run"]);
    assert!(!Path::new(rules).exists());
    fails(&logicity(["induce", "-", "--test", "-"]), 2, &["read once only"]);
}

/// A pipe can be read once only.
#[test]
fn pipes_teach_like_files() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().to_str().unwrap();
    succeeds(&logicity([
        "run",
        "easy",
        "--ticks",
        "20",
        "--no-pictures",
        "--out",
        out,
    ]));
    let scene = "{\"entities\": [\"a\"], \"ego\": \"a\", \"facts\": {}, \"actions\": {\"a\": \"Fast\"}}\n";
    fs::write(folder.path().join("scene.jsonl"), scene).unwrap();
    let pipe = folder.path().join("pipe");
    assert!(Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    for name in ["trace.jsonl", "scene.jsonl"] {
        let clauses = |source: &str| {
            let line = format!("cat {out}/{name} {source} --config easy");
            let output = Command::new("sh")
                .args(["-c", &line])
                .env("PROGRAM", env!("CARGO_BIN_EXE_logicity"))
                .output()
                .unwrap();
            let learned = succeeds(&output);
            let start = learned.find("\n\n").unwrap();
            learned[start..]
                .replace(name, "standard input")
                .replace("pipe", "standard input")
        };
        let expected = clauses(&format!("> /dev/null; \"$PROGRAM\" induce {out}/{name}"));
        assert!(expected.contains(":-"), "{expected}");
        assert_eq!(clauses("| \"$PROGRAM\" induce -"), expected);
        let pipe = pipe.display();
        assert_eq!(clauses(&format!("> {pipe} & \"$PROGRAM\" induce {pipe}")), expected);
    }
}

#[test]
fn rules_are_measured_on_other_examples() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    for (seed, ticks, out) in [("1", "15", "a"), ("2", "100", "b")] {
        succeeds(&logicity([
            "run",
            "easy",
            "--ticks",
            ticks,
            "--seed",
            seed,
            "--no-pictures",
            "--out",
            &path(out),
        ]));
    }
    let (train, test) = (path("a/trace.jsonl"), path("b/trace.jsonl"));
    let (learned, page) = (path("learned.dl"), path("page.html"));
    let said = succeeds(&logicity([
        "induce", &train, "--config", "easy", "-o", &learned, "--test", &test, "--page", &page,
    ]));
    let line = said.lines().last().unwrap();
    assert!(line.starts_with("test: 1500 examples, accuracy 0."), "{line}");
    assert!(line.contains("recall Stop"), "{line}");
    let page = fs::read_to_string(page).unwrap();
    assert!(page.starts_with("<!DOCTYPE html>"));
    // The same examples are decided without a fault.
    let said = succeeds(&logicity([
        "induce", &train, "--config", "easy", "-o", &learned, "--test", &train,
    ]));
    assert!(
        said.contains("accuracy 1.0000, wAcc 1.0000; recall Stop 1.0000, Normal 1.0000"),
        "{said}"
    );
}

#[test]
fn data_sets_teach_the_labels_of_cars() {
    let folder = tempfile::tempdir().unwrap();
    let worlds = folder.path().join("worlds");
    let worlds = worlds.to_str().unwrap();
    succeeds(&logicity([
        "vap",
        "make",
        "--mode",
        "easy",
        "--split",
        "train",
        "--worlds",
        "1",
        "--no-pictures",
        "--out",
        worlds,
    ]));
    let learned = succeeds(&logicity(["induce", worlds, "--config", "vap-easy"]));
    assert!(learned.contains("Stop(X) :- CollidingClose(X, Y)."), "{learned}");
    assert!(learned.contains("worlds, world 0, tick "), "{learned}");
    assert!(
        learned.contains("// Never true in any example: IsPedestrian(X), IsBus(X)"),
        "{learned}"
    );
}

/// `logicity.demonstrations("easy", 2).to_parquet(...)` wrote it.
const STEPS: &str = "tests/fixtures/easy-steps.parquet";

#[test]
fn tables_of_steps_teach_like_the_episodes() {
    let clauses = |arguments: &[&str]| -> Vec<String> {
        let output = run(&[&["induce", "--config", "easy"], arguments].concat(), b"");
        let text = succeeds(&output);
        assert!(text.contains("// The rules choose the action of every example.\n"));
        let lines = text.lines().filter(|line| !line.starts_with("//"));
        lines.map(str::to_owned).collect()
    };
    assert_eq!(clauses(&[STEPS]), clauses(&["--episodes", "2"]));
    let said = succeeds(&logicity(["induce", STEPS, "--config", "easy"]));
    assert!(
        said.contains("alone explains is easy-steps.parquet, episode 0, step "),
        "{said}"
    );
    // A pipe has no name that ends in `.parquet`.
    let piped = run(&["induce", "-", "--config", "easy"], &fs::read(STEPS).unwrap());
    assert_eq!(succeeds(&piped), said.replace("easy-steps.parquet", "standard input"));
    let output = logicity(["induce", "--config", "easy", "--test", STEPS, "-o", "/dev/null"]);
    assert!(
        text(&output.stdout).contains("accuracy 1.0000"),
        "{}",
        text(&output.stdout)
    );
}

#[test]
fn other_tables_and_datasets_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let refuses = |name: &str, parts: &[&str]| {
        let output = logicity(["induce", name, "--config", "easy"]);
        fails(&output, 1, parts);
    };
    fs::write(path("a.parquet"), "no table").unwrap();
    refuses(
        &path("a.parquet"),
        &[
            "error[invalid-data-set]",
            "not a table of steps",
            "a.parquet",
            "to_parquet",
        ],
    );
    fs::write(path("a.hdf5"), b"\x89HDF\r\n\x1a\n").unwrap();
    refuses(
        &path("a.hdf5"),
        &["error[invalid-data-set]", "Minari", "call `logicity.induce` in Python"],
    );
    fs::create_dir_all(path("set/data")).unwrap();
    fs::write(path("set/data/metadata.json"), "{}").unwrap();
    refuses(&path("set"), &["Minari", "call `logicity.induce` in Python"]);
    refuses(&path("set/data"), &["Minari", "call `logicity.induce` in Python"]);
    let output = logicity(["induce", STEPS, "--config", "hard"]);
    fails(
        &output,
        1,
        &[
            "error[rule-mismatch]",
            "`IsOld(0)` instead of `IsBus(0)`",
            "of the mode easy",
        ],
    );
}

#[test]
fn bad_examples_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("scenes.jsonl");
    let refuses = |content: &str, code: i32, parts: &[&str]| {
        fs::write(&file, content).unwrap();
        fails(
            &logicity(["induce", file.to_str().unwrap(), "--config", "easy"]),
            code,
            parts,
        );
    };
    let car = "{\"entities\": [\"a\"], \"ego\": \"a\", \"facts\": {\"IsCar\": [\"a\"]}";
    refuses("", 1, &["no examples in"]);
    refuses(&format!("{car}}}\n"), 1, &["line 1", "has no actions", "\"actions\":"]);
    refuses(
        &format!("{car}, \"actions\": {{\"a\": \"Jump\"}}}}\n"),
        1,
        &["scenes.jsonl:1:", "not an action", "Stop"],
    );
    refuses(
        &format!("{car}, \"actions\": {{\"z\": \"Stop\"}}}}\n"),
        1,
        &["scenes.jsonl:1:", "no entity `z`"],
    );
    refuses("{\"trace\": 1}\n", 1, &["scenes.jsonl:1"]);
    refuses("nonsense\n", 1, &["scenes.jsonl:1:"]);
    let two = format!("{car}, \"actions\": {{\"a\": \"Stop\"}}}}\n\n{car}, \"actions\": {{\"a\": \"Normal\"}}}}\n");
    refuses(
        &two,
        1,
        &["contradicting-examples", "line 1, a", "line 3, a", "Stop", "Normal"],
    );
    // With noise, both are accepted.
    let tolerated = logicity(["induce", file.to_str().unwrap(), "--config", "easy", "--noise", "0.1"]);
    let learned = succeeds(&tolerated);
    assert!(learned.contains("// Noise: 10.00 % of the examples"), "{learned}");
    let unusable = logicity(["induce", file.to_str().unwrap(), "--config", "easy", "--noise", "0.7"]);
    fails(&unusable, 2, &["from 0 to 0.4"]);
    fails(&logicity(["induce", "no such file"]), 2, &["no such file"]);
    fails(&logicity(["induce", "--config", "metropolis"]), 1, &[]);
}

/// Clap does not check that an option requires another one while a third one excludes that.
#[test]
fn options_that_would_have_no_effect_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let scenes = folder.path().join("scenes.jsonl");
    fs::write(&scenes, "").unwrap();
    let scenes = scenes.to_str().unwrap();
    for (options, part) in [
        (&["--noise", "0.1", "--questions", "3"][..], "cannot be used with"),
        (&["--noise", "0.1", "--log", "log.jsonl"], "cannot be used with"),
        (&["--noise", "0.1", "--ask", "rules/easy.dl"], "cannot be used with"),
        (&["--closed-world"], "cannot be used with"),
        (&["--negation"], "cannot be used with"),
        (&["--agreements", "3"], "--ask <ORACLE>"),
        (&["--order", "Stop,Fast,Stop"], "--order: `Stop` occurs twice"),
    ] {
        fails(&run(&[&["induce", scenes], options].concat(), b""), 2, &[part]);
    }
}

/// A tolerant search has no limit that could cut it.
#[test]
fn clauses_learned_with_noise_are_not_cut() {
    let episodes = ["induce", "--config", "easy", "--episodes", "10"];
    let learned = |options: &[&str]| succeeds(&run(&[&episodes, options].concat(), b""));
    assert!(!learned(&["--noise", "0.01"]).contains("// Cut: "));
    assert!(!learned(&[]).contains("// Cut: "));
    assert!(learned(&["--effort", "1"]).contains("// Cut: "));
}

#[test]
fn examples_of_one_action_are_noted() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let scene =
        "{\"entities\": [\"a\"], \"ego\": \"a\", \"facts\": {\"IsCar\": [\"a\"]}, \"actions\": {\"a\": \"Slow\"}}\n";
    fs::write(path("scenes.jsonl"), scene).unwrap();
    let note = "All examples have the action Slow: they do not show when another action is taken.";
    let said = succeeds(&logicity(["induce", &path("scenes.jsonl"), "-o", &path("learned.dl")]));
    assert!(said.contains(note), "{said}");
    let learned = fs::read_to_string(path("learned.dl")).unwrap();
    assert!(learned.contains(&format!("// {note}\n")), "{learned}");
}

/// Runs write traces of the same name to different folders.
#[test]
fn places_distinguish_files_of_the_same_name() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    for (name, action) in [("one", "Slow"), ("two", "Stop")] {
        fs::create_dir(path(name)).unwrap();
        let scene = "{\"entities\": [\"a\"], \"ego\": \"a\", \"facts\": {\"IsCar\": [\"a\"]}, \"actions\": {\"a\": ";
        fs::write(
            path(&format!("{name}/scenes.jsonl")),
            format!("{scene}\"{action}\"}}}}\n"),
        )
        .unwrap();
    }
    let output = logicity(["induce", &path("one/scenes.jsonl"), &path("two/scenes.jsonl")]);
    fails(
        &output,
        1,
        &["one/scenes.jsonl, line 1, a; two/scenes.jsonl, line 1, a"],
    );
}

#[test]
fn declarations_outside_the_built_in_files_are_kept() {
    let folder = tempfile::tempdir().unwrap();
    let rules = folder.path().join("own.dl");
    let own = ".include \"vocabulary.dl\"\n\n/// Near an intersection.\n.decl NearInter(x: agent)\n\
               NearInter(X) :- IsAtInter(X).\nNearInter(X) :- IsInInter(X).\n\
               Stop(X) :- CollidingClose(X, Y).\n";
    fs::write(&rules, own).unwrap();
    let learned = succeeds(&logicity([
        "induce",
        "--config",
        "easy",
        "--rules",
        rules.to_str().unwrap(),
    ]));
    assert!(learned.contains("/// Near an intersection."), "{learned}");
    assert!(
        learned.contains("\n// The configuration has the rules in own.dl.\n"),
        "{learned}"
    );
    assert!(learned.contains("NearInter(X) :- IsInInter(X)."), "{learned}");
    assert_eq!(learned.matches("Stop(X) :-").count(), 1, "{learned}");
}
