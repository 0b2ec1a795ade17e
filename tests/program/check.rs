//! Static claims about rules hold in the city at hand, and say what they rest on: `check`, `diff`, the language server.

use crate::cli::{code, err, fails, out, run, write};
use serde_json::Value;
use std::path::Path;
use std::time::{Duration, Instant};

const TAXI: &str = "base: expert\nrules: taxi.dl\n\
                    predicates:\n  base: standard\n  define: {IsTaxi: {concept: taxi, of: Car}}\n\
                    agents:\n  test:\n    cars: [{count: 3, concepts: [taxi], priority: 1}]\n    \
                    pedestrians: [{count: 1, priority: 2}]\n";

/// Rules that declare `IsTaxi`, with further clauses.
fn taxi(clauses: &str) -> String {
    format!(
        ".include \"vocabulary.dl\"\n.decl IsTaxi(x: agent)\n.input IsTaxi\nStop(X) :- CollidingClose(X, Y).\n{clauses}"
    )
}

/// Returns the codes of the diagnostics, each with the line of its place.
fn found(folder: &Path, arguments: &[&str]) -> Vec<(String, u64)> {
    let arguments: Vec<String> = (arguments.iter())
        .map(|one| match folder.join(one).exists() {
            true => folder.join(one).to_str().unwrap().to_owned(),
            false => (*one).to_owned(),
        })
        .collect();
    let mut all = vec!["check", "--json"];
    all.extend(arguments.iter().map(String::as_str));
    let output = run(&all, b"");
    let answer: Value = serde_json::from_str(out(&output).lines().next().unwrap_or_default())
        .unwrap_or_else(|error| panic!("{error}: {}{}", out(&output), err(&output)));
    let found = answer["diagnostics"].as_array().unwrap().iter();
    let place = |fault: &Value| {
        let line = fault["labels"][0]["line"].as_u64().unwrap_or(0);
        (fault["code"].as_str().unwrap().to_owned(), line)
    };
    found.map(place).collect()
}

fn is(expected: &[(&str, u64)]) -> Vec<(String, u64)> {
    expected
        .iter()
        .map(|(code, line)| ((*code).to_owned(), *line))
        .collect()
}

/// A false constraint is an error with both places. No claim rests on it: the clause fires in every tick.
#[test]
fn declared_constraints_are_compared_with_the_configuration() {
    let folder = tempfile::tempdir().unwrap();
    let rules = taxi(".implies IsTaxi, IsPedestrian\nSlow(X) :- Not(Stop(X)), IsTaxi(X), IsCar(X).\n");
    let rules = write(folder.path(), "taxi.dl", rules);
    let config = write(folder.path(), "taxi.yaml", TAXI);
    let message = "error[constraint-mismatch]: `.implies IsTaxi, IsPedestrian` contradicts the configuration `taxi`: \
                   no agent is both `IsTaxi` and `IsPedestrian`";
    for arguments in [
        vec!["check", &config],
        vec!["check", &rules, "--config", &config],
        vec!["diff", &rules, &rules, "--config", &config],
    ] {
        let output = run(&arguments, b"");
        let places = ["taxi.dl:5:1", "taxi.yaml:5:12", "help: write `.implies IsTaxi, IsCar`"];
        fails(&output, 1, &[message, places[0], places[1], places[2]]);
        assert!(!err(&output).contains("never fires"), "{}", err(&output));
    }
    // Without a configuration, the claim names what it rests on.
    let said = err(&run(&["check", &rules], b""));
    for part in [
        "this clause never fires",
        "note: given `.implies IsTaxi, IsPedestrian` at ",
        "taxi.dl:5:1",
        "note: given `.disjoint IsCar, IsPedestrian` at <builtin>/vocabulary.dl:",
    ] {
        assert!(said.contains(part), "`{part}` is missing in:\n{said}");
    }
    // The clause fires indeed.
    let output = run(&["run", &config, "--ticks", "20", "--no-trace"], b"");
    assert!(out(&output).contains("Slow"), "{}", out(&output));
}

/// Each kind of constraint: what the configuration confirms, and what it contradicts.
#[test]
fn every_kind_of_constraint_is_compared() {
    let folder = tempfile::tempdir().unwrap();
    write(folder.path(), "taxi.yaml", TAXI);
    let holds = [
        ".implies IsTaxi, IsCar",
        ".disjoint IsTaxi, IsPedestrian",
        ".disjoint IsClose, NextTo",
        ".implies CollidingClose, NextTo",
        ".covering IsPedestrian, IsCar",
        ".symmetric NextTo",
        ".irreflexive HigherPri",
        ".asymmetric HigherPri",
        ".reflexive Sees",
        // No taxi is a bus, since the agents are given.
        ".disjoint IsTaxi, IsBus",
    ];
    let slow = "Slow(X) :- Not(Stop(X)), IsTaxi(X).";
    write(
        folder.path(),
        "taxi.dl",
        taxi(&format!("{}\n{slow}\n", holds.join("\n"))),
    );
    assert_eq!(found(folder.path(), &["taxi.yaml"]), is(&[]));
    let fails = [
        ".implies IsTaxi, IsPedestrian",
        ".implies IsTaxi, IsBus",
        ".implies IsCar, IsTaxi",
        ".disjoint IsTaxi, IsCar",
        ".disjoint IsClose, Sees",
        ".implies NextTo, IsClose",
        ".implies Sees, NextTo",
        ".covering IsTaxi, IsPedestrian",
        ".symmetric LeftOf",
        ".symmetric HigherPri",
        ".irreflexive Sees",
        ".asymmetric NextTo",
        ".reflexive NextTo",
    ];
    write(
        folder.path(),
        "taxi.dl",
        taxi(&format!("{}\n{slow}\n", fails.join("\n"))),
    );
    let lines: Vec<(&str, u64)> = (5..)
        .zip(fails)
        .map(|(line, _)| ("constraint-mismatch", line))
        .collect();
    assert_eq!(found(folder.path(), &["taxi.yaml"]), is(&lines));
    // Facts in the rules add rows that the configuration does not know.
    let facts = "IsTaxi(\"Pedestrian_1\").\n.implies IsTaxi, IsPedestrian\nSlow(X) :- Not(Stop(X)), IsTaxi(X).\n";
    write(folder.path(), "taxi.dl", taxi(facts));
    assert_eq!(found(folder.path(), &["taxi.yaml"]), is(&[]));
}

/// What the definitions imply makes claims sharper than the rules alone allow.
#[test]
fn constraints_follow_from_definitions() {
    let folder = tempfile::tempdir().unwrap();
    write(folder.path(), "taxi.yaml", TAXI);
    for (clause, lints) in [
        (
            "Slow(X) :- Not(Stop(X)), IsTaxi(X), IsPedestrian(X).",
            [("contradictory-body", 5)],
        ),
        (
            "Slow(X) :- Not(Stop(X)), IsTaxi(X), IsClose(X, Y), NextTo(X, Y).",
            [("contradictory-body", 5)],
        ),
        (
            "Slow(X) :- Not(Stop(X)), IsTaxi(X), IsBus(X).",
            [("contradictory-body", 5)],
        ),
        (
            "Slow(X) :- Not(Stop(X)), IsTaxi(X), IsCar(X).",
            [("redundant-literal", 5)],
        ),
        (
            "Slow(X) :- Not(Stop(X)), IsTaxi(X), CollidingClose(X, Y), NextTo(X, Y).",
            [("redundant-literal", 5)],
        ),
    ] {
        write(folder.path(), "taxi.dl", taxi(&format!("{clause}\n")));
        assert_eq!(found(folder.path(), &["--lints", "taxi.dl"]), is(&[]), "{clause}");
        assert_eq!(found(folder.path(), &["--lints", "taxi.yaml"]), is(&lints), "{clause}");
        assert_eq!(
            found(folder.path(), &["--lints", "taxi.dl", "--config", "taxi.yaml"]),
            is(&lints),
            "{clause}"
        );
    }
    let said = err(&run(
        &["check", folder.path().join("taxi.yaml").to_str().unwrap(), "--lints"],
        b"",
    ));
    assert!(
        said.contains("given `.implies CollidingClose, NextTo`, which follows from "),
        "{said}"
    );
}

/// `check --config` reports what `run` with these rules would.
#[test]
fn check_reports_what_run_refuses() {
    let folder = tempfile::tempdir().unwrap();
    for (text, message) in [
        (
            taxi("Slow(X) :- Not(Stop(X)), IsTaxi(X).\n"),
            "error[rule-mismatch]: the rules read `IsTaxi`, which the configuration `expert` does not define",
        ),
        (
            ".decl IsCar(x: symbol, y: symbol)\n.input IsCar\n.decl Stop(x: symbol)\n.output Stop\n\
             Stop(X) :- IsCar(X, Y), IsCar(Y, X).\n"
                .to_owned(),
            "error[rule-mismatch]: the declaration of `IsCar` does not match its definition",
        ),
        (
            ".decl Brake(x: symbol)\n.output Brake\n.decl IsCar(x: symbol)\n.input IsCar\nBrake(X) :- IsCar(X).\n"
                .to_owned(),
            "error[rule-mismatch]: the rules have none of the actions",
        ),
        (
            ".include \"vocabulary.dl\"\nStop(X) :- CollidingClose(X, Y).\nStop(X) :- NextTo(X, \"Car_999\").\n"
                .to_owned(),
            "warning[unknown-agent]: no agent has the name `Car_999`",
        ),
    ] {
        let rules = write(folder.path(), "rules.dl", text);
        let checked = run(&["check", &rules, "--config", "expert"], b"");
        let ran = run(&["run", "expert", "--rules", &rules, "--ticks", "1", "--no-trace"], b"");
        for output in [&checked, &ran] {
            assert!(
                err(output).contains(message),
                "{message} is missing in:\n{}",
                err(output)
            );
        }
        assert_eq!(code(&checked), code(&ran), "{message}");
    }
}

#[test]
fn predicates_of_road_networks_are_empty_on_blocks() {
    let folder = tempfile::tempdir().unwrap();
    let rules = ".include \"right-of-way-roads.dl\"\nStop(X) :- IsAtInter(X), Clearance(X, Y, n), n < 3.\n";
    write(folder.path(), "gaps.dl", rules);
    let config = |map: &str| format!("base: right-of-way-roads\nmap: {map}\nregion: ~\nrules: gaps.dl\n");
    for (map, count) in [("roundabout", 0), ("square-5x5", 3)] {
        let config = write(folder.path(), "gaps.yaml", config(map));
        let said = err(&run(&["check", &config], b""));
        assert_eq!(said.matches("warning[empty-predicate]").count(), count, "{map}: {said}");
        assert_eq!(
            said.contains("only a road network has it, and the map has blocks"),
            count > 0,
            "{said}"
        );
    }
}

#[test]
fn absent_agents_and_unread_outputs_are_reported() {
    let folder = tempfile::tempdir().unwrap();
    let clauses = ".decl Fleet(x: agent)\nFleet(X) :- IsTaxi(X), IsAtInter(X).\n\
                   Slow(X) :- Not(Stop(X)), Fleet(X).\nSlow(X) :- Not(Stop(X)), IsOld(X), Not(IsTaxi(X)).\n\
                   .decl stop(x: agent)\n.output stop\nstop(X) :- IsCar(X).\n";
    let rules = write(folder.path(), "taxi.dl", taxi(clauses));
    let config = write(folder.path(), "taxi.yaml", TAXI.replace("concepts: [taxi], ", ""));
    assert_eq!(found(folder.path(), &["taxi.dl"]), is(&[]), "rules alone");
    assert_eq!(
        found(folder.path(), &["taxi.yaml"]),
        is(&[("empty-predicate", 6), ("unused-output", 9)])
    );
    let said = err(&run(&["check", &rules, "--config", &config], b""));
    for part in [
        "`IsTaxi` never holds in `taxi`: no car has the concept `taxi`",
        "so this clause never fires",
        "nor does this one: `Fleet` has no rows",
        "so this always holds",
        "`.output stop` has no effect in a city: it is not an action, and no clause reads it",
        "did you mean `Stop`?",
    ] {
        assert!(said.contains(part), "`{part}` is missing in:\n{said}");
    }
    // A taxi, and a reader of the output.
    write(folder.path(), "taxi.yaml", TAXI);
    write(
        folder.path(),
        "taxi.dl",
        taxi(&format!("{clauses}Fast(X) :- Not(Stop(X)), Not(Slow(X)), stop(X).\n")),
    );
    assert_eq!(found(folder.path(), &["taxi.yaml"]), is(&[]));
}

/// Rules alone may be for another city.
#[test]
fn runs_report_unread_predicates() {
    let folder = tempfile::tempdir().unwrap();
    let text = ".include \"vocabulary.dl\"\nStop(X) :- CollidingClose(X, Y).\n\
                .decl Old(x: agent)\nOld(X) :- IsOld(X).\n\
                .decl Young(x: agent)\n.output Young\nYoung(X) :- IsYoung(X).\n";
    let rules = write(folder.path(), "own.dl", text);
    assert_eq!(found(folder.path(), &["own.dl"]), is(&[]));
    let out = folder.path().join("out");
    let ran = [
        "run",
        "expert",
        "--rules",
        &rules,
        "--ticks",
        "1",
        "--no-pictures",
        "--out",
    ];
    let output = run(&[&ran[..], &[out.to_str().unwrap()]].concat(), b"");
    let said = err(&output);
    assert!(said.contains("`Old` has no effect in a city"), "{said}");
    assert!(said.contains("`.output Young` has no effect in a city"), "{said}");
    assert!(!said.contains("no clause derives an action"), "{said}");
    write(
        folder.path(),
        "own.dl",
        text.replace("Stop(X) :- CollidingClose(X, Y).\n", ""),
    );
    let said = err(&run(&[&ran[..], &[out.to_str().unwrap(), "--force"]].concat(), b""));
    assert!(said.contains("[unused-action]: no clause derives an action"), "{said}");
}

/// Only `true` and `false` are values of the options that are on or off.
#[test]
fn other_values_than_true_are_reported() {
    let folder = tempfile::tempdir().unwrap();
    let text = ".decl a, b(x: symbol)\n.input a(headers=yes, rfc4180=false)\n.output b(compress=1)\nb(x) :- a(x).\n";
    let rules = write(folder.path(), "a.dl", text);
    let said = run(&["check", &rules], b"");
    assert_eq!(code(&said), 0);
    for (option, line) in [("headers=yes", 2), ("compress=1", 3)] {
        let message = format!("warning[ignored]: `{option}` means `false`");
        assert!(
            err(&said).contains(&message) && err(&said).contains(&format!("a.dl:{line}:")),
            "{}",
            err(&said)
        );
    }
    assert_eq!(err(&said).matches("warning[ignored]").count(), 2, "{}", err(&said));
}

/// Names of agents are those of all kinds of the configuration, also in comparisons.
#[test]
fn names_of_agents_of_own_kinds_are_known() {
    let folder = tempfile::tempdir().unwrap();
    let config = "base: expert\nrules: kinds.dl\nkinds: {Cyclist: {of: Car}}\n\
                  agents: {test: {cars: [{count: 2, priority: 1}], Cyclist: [{count: 1, priority: 1}]}}\n";
    write(folder.path(), "kinds.yaml", config);
    let rules = ".include \"vocabulary.dl\"\nStop(X) :- CollidingClose(X, Y).\n\
                 Slow(X) :- IsBus(Cyclist_1), NextTo(X, Cyclist_1), Not(Stop(X)).\n\
                 Slow(X) :- NextTo(X, Y), Y = \"Car_99\", Not(Stop(X)).\n\
                 Slow(X) :- NextTo(X, Y), Y != \"Cyclist_1\", Not(Stop(X)).\n";
    write(folder.path(), "kinds.dl", rules);
    let found: Vec<(String, u64)> = (found(folder.path(), &["kinds.yaml"]).into_iter())
        .filter(|(code, _)| code.ends_with("-agent"))
        .collect();
    assert_eq!(found, is(&[("unquoted-agent", 3), ("unknown-agent", 4)]));
}

/// Without a task, agents take only the actions that clauses derive for their kinds.
#[test]
fn actions_that_no_agent_takes_are_reported() {
    let folder = tempfile::tempdir().unwrap();
    let actions = "actions:\n  priority: [Stop, Left, Park, Slow, Fast, Normal]\n  define:\n    Left: {cells: {Car: 1}, turn: left}\n    Park: {cells: {Car: 0}, park: 5}\n";
    let config = format!("base: expert\nrules: turn.dl\ntask: ~\n{actions}");
    write(folder.path(), "turn.yaml", &config);
    let rules = ".include \"vocabulary.dl\"\n.decl Left(x: agent)\nStop(X) :- CollidingClose(X, Y).\n";
    let rules = format!("{rules}Left(X) :- IsPedestrian(X), IsAtInter(X), Not(Stop(X)).\n");
    write(folder.path(), "turn.dl", &rules);
    assert_eq!(
        found(folder.path(), &["turn.yaml"]),
        is(&[("unused-action", 8), ("unused-action", 4)])
    );
    // The default is taken without a clause, and the clause is for cars, too.
    write(
        folder.path(),
        "turn.yaml",
        format!("{config}  default: Park\n").replace("{Car: 0}", "{Car: 0, Pedestrian: 0}"),
    );
    write(folder.path(), "turn.dl", rules.replace("IsPedestrian(X), ", ""));
    assert_eq!(found(folder.path(), &["turn.yaml"]), is(&[]));
    // The ego of a task may take what no clause derives.
    write(folder.path(), "turn.yaml", config.replace("task: ~\n", ""));
    assert_eq!(found(folder.path(), &["turn.yaml"]), is(&[]));
}

/// A clause never fires if an alternative or another predicate without rows is the reason. Long chains of such clauses
/// take time in proportion to their length.
#[test]
fn all_that_an_absent_agent_empties_is_found_in_seconds() {
    let folder = tempfile::tempdir().unwrap();
    let mut clauses = "Slow(X) :- Not(Stop(X)), IsCar(X), (IsTaxi(X) ; IsTaxi(Y), IsAtInter(Y)).\n.decl P0(x: agent)\n\
                       P0(X) :- IsTaxi(X).\n"
        .to_owned();
    for number in 0..10_000 {
        clauses += &format!(".decl P{0}(x: agent)\nP{0}(X) :- P{number}(X).\n", number + 1);
    }
    write(
        folder.path(),
        "taxi.dl",
        taxi(&format!("{clauses}Slow(X) :- Not(Stop(X)), P10000(X).\n")),
    );
    let config = write(folder.path(), "taxi.yaml", TAXI.replace("concepts: [taxi], ", ""));
    let begin = Instant::now();
    let said = err(&run(&["check", &config], b""));
    assert!(begin.elapsed() < Duration::from_secs(60), "{:?}", begin.elapsed());
    assert_eq!(said.matches("warning[empty-predicate]").count(), 1, "{said}");
    // Six are shown of the literals in both alternatives and in the 10,002 clauses of the chain.
    assert!(said.contains("9998 further literals are affected"), "{said}");
}

/// A difference that needs an agent which the city cannot have is none there.
#[test]
fn diff_compares_in_a_city() {
    let folder = tempfile::tempdir().unwrap();
    let one = write(folder.path(), "taxi.dl", taxi("Slow(X) :- Not(Stop(X)), IsTaxi(X).\n"));
    let other = write(
        folder.path(),
        "other.dl",
        taxi("Slow(X) :- Not(Stop(X)), IsTaxi(X), IsCar(X).\n"),
    );
    let config = write(folder.path(), "taxi.yaml", TAXI);
    let apart = run(&["diff", &one, &other], b"");
    assert_eq!(code(&apart), 1, "{}", out(&apart));
    assert!(out(&apart).contains("IsPedestrian"), "a taxi on foot: {}", out(&apart));
    let equal = run(&["diff", &one, &other, "--config", &config], b"");
    assert_eq!(code(&equal), 0, "{}{}", out(&equal), err(&equal));
    assert!(
        out(&equal).starts_with("in the city `taxi`: equivalent"),
        "{}",
        out(&equal)
    );
    assert!(
        out(&equal).contains("\ngiven `.implies IsTaxi, IsCar`, which follows from "),
        "{}",
        out(&equal)
    );
    let unknown = run(&["diff", &one, &other, "--config", "expert"], b"");
    fails(&unknown, 1, &["error[rule-mismatch]: the rules read `IsTaxi`"]);
    assert_eq!(
        err(&unknown).matches("error[rule-mismatch]").count(),
        2,
        "{}",
        err(&unknown)
    );
}

/// "Equivalent" names the constraints that the proof needs, and no others.
#[test]
fn proofs_name_their_premises() {
    let folder = tempfile::tempdir().unwrap();
    let rules = |name: &str, clause: &str| {
        let text = format!(".include \"vocabulary.dl\"\nStop(X) :- CollidingClose(X, Y).\n{clause}\n");
        write(folder.path(), name, text)
    };
    let one = rules("one.dl", "Stop(X) :- IsTiro(X), IsAtInter(X).");
    let other = rules("other.dl", "Stop(X) :- IsTiro(X), IsAtInter(X), IsCar(X).");
    let output = run(&["diff", &one, &other], b"");
    let given: Vec<String> = out(&output)
        .lines()
        .filter(|line| line.starts_with("given"))
        .map(str::to_owned)
        .collect();
    assert_eq!(given.len(), 1, "{}", out(&output));
    assert!(
        given[0].starts_with("given `.implies IsTiro, IsCar` at <builtin>/vocabulary.dl:"),
        "{}",
        given[0]
    );
    let same = run(&["diff", &one, &one], b"");
    assert!(!out(&same).contains("given"), "{}", out(&same));

    let exclusive = rules("exclusive.dl", "Fast(X) :- IsTiro(X), IsOld(X).");
    let output = run(&["check", &exclusive], b"");
    let said = out(&output) + &err(&output);
    for part in [
        "given `.implies IsTiro, IsCar` at ",
        "given `.implies IsOld, IsPedestrian` at ",
    ] {
        assert!(said.contains(part), "`{part}` is missing in:\n{said}");
    }
}

#[test]
fn conditions_that_never_hold_are_refused() {
    let rules = ["rules/medium.dl", "rules/hard.dl"];
    for condition in [
        "IsCar(X), IsPedestrian(X)",
        "Sees(X, Y), HigherPri(X, Y), HigherPri(Y, X)",
        "X != X",
    ] {
        let output = run(&["diff", rules[0], rules[1], "--given", condition], b"");
        fails(
            &output,
            2,
            &["the condition of `--given` never holds, so nothing would be compared"],
        );
    }
    let output = run(
        &["diff", rules[0], rules[1], "--given", "IsCar(X), IsPedestrian(X)"],
        b"",
    );
    assert!(
        err(&output).contains("given `.disjoint IsCar, IsPedestrian` at "),
        "{}",
        err(&output)
    );
    // In this city, no bus is a police car.
    let condition = ["--given", "IsBus(X), IsPolice(X)", "--predicates", "Fast"];
    let free = run(
        &[&["diff", "rules/expert.dl", "rules/expert.dl"], &condition[..]].concat(),
        b"",
    );
    assert_eq!(code(&free), 0, "{}", err(&free));
    let in_city = [
        &["diff", "rules/expert.dl", "rules/expert.dl", "--config", "expert"],
        &condition[..],
    ]
    .concat();
    fails(&run(&in_city, b""), 2, &["never holds"]);
}

/// The reason is the clause at the root, with its place, and not what depends on it.
#[test]
fn reasons_against_the_dense_executor_name_the_clause_at_the_root() {
    let folder = tempfile::tempdir().unwrap();
    let text = |clause: &str| {
        format!(
            ".include \"vocabulary.dl\"\n.decl Emergency(x: agent)\nEmergency(X) :- IsAmbulance(X), IsInInter(X).\n\
             .decl Crowd(x: agent)\n{clause}\nStop(X) :- CollidingClose(X, Y).\nSlow(X) :- Not(Stop(X)), Crowd(X).\n"
        )
    };
    for (clause, reason, place, help) in [
        (
            "Crowd(X) :- IsCar(X), count : { Emergency(Y), NextTo(X, Y) } > count : { NextTo(X, Y) }.",
            "a clause of `Crowd` aggregates with `count`",
            "crowd.dl:5:23",
            Some("compare the count with constants"),
        ),
        (
            "Crowd(X) :- Emergency(Y), NextTo(X, Y).\nCrowd(X) :- Crowd(Y), NextTo(X, Y).",
            "`Crowd` depends on itself",
            "crowd.dl:6:13",
            Some("write out the steps"),
        ),
        (
            "Crowd(X) :- Emergency(X), NextTo(X, \"Car_1\").",
            "a clause of `Crowd` names a constant",
            "crowd.dl:5:27",
            Some("give the agent a concept"),
        ),
        (
            ".decl Near(x: agent, n: number)\nNear(X, n) :- IsCar(X), n = count : { Emergency(Y), NextTo(X, Y) }.\n\
             Crowd(X) :- Near(X, n), n > 2.",
            "a clause of `Near` aggregates with `count`",
            "crowd.dl:6:29",
            Some("compare the count with constants"),
        ),
        (
            ".decl At(x: agent, y: agent, z: agent)\nAt(X, Y, Z) :- Emergency(X), NextTo(X, Y), NextTo(Y, Z).\n\
             Crowd(X) :- At(X, Y, Z).",
            "a clause of `At` uses `At`, which has 3 columns, not one or two",
            "crowd.dl:6:1",
            Some("use predicates of one or two columns"),
        ),
    ] {
        let rules = write(folder.path(), "crowd.dl", text(clause));
        let checked = out(&run(&["check", &rules], b""));
        assert!(
            checked.contains(&format!("{reason} at ")) && checked.contains(place),
            "{place}: {checked}"
        );
        assert!(!checked.contains("needs `Emergency`"), "{checked}");
        if let Some(help) = help {
            assert!(checked.contains(help), "{checked}");
        }
        let ran = out(&run(
            &["run", "expert", "--rules", &rules, "--ticks", "1", "--no-trace"],
            b"",
        ));
        let line = format!("the relational executor evaluates some clauses, the first because {reason} at ");
        assert!(ran.contains(&line) && ran.contains(&format!("{place}\n")), "{ran}");
        let demanded = [
            "run",
            "expert",
            "--rules",
            &rules,
            "--ticks",
            "1",
            "--no-trace",
            "--executor",
            "dense",
        ];
        fails(&run(&demanded, b""), 1, &["error[dense-unsupported]", reason, place]);
    }
}

/// Every predicate with a probability floats_64 the truth values of a situation. Claims about the first ones stay.
#[test]
fn many_predicates_with_probabilities_are_checked_in_seconds() {
    const COUNT: usize = 20;
    let folder = tempfile::tempdir().unwrap();
    let collisions = (0..COUNT).map(|number| {
        let range = 8 + number;
        format!(
            "    C{number}: {{colliding: {{car_range: {range}, pedestrian_range: 3, angle: 0.1, pedestrian_chance: 0.5, \
             same_cell_chance: 0.5}}}}\n"
        )
    });
    let predicates = "predicates:\n  base: standard\n  define:\n".to_owned() + &collisions.collect::<String>();
    let config = format!("base: expert\nrules: rules.dl\n{predicates}");
    write(folder.path(), "city.yaml", config);
    let names: Vec<String> = (0..COUNT).map(|number| format!("C{number}")).collect();
    let names = names.join(", ");
    let clauses = "Stop(X) :- CollidingClose(X, Y).\nSlow(X) :- Not(Stop(X)), C0(X, Y), C19(X, Y).\n";
    let rules = format!(
        ".include \"vocabulary.dl\"\n.decl {names}(x: agent, y: agent)\n.input {names}\n.symmetric C0\n\
         .symmetric C19\n{clauses}"
    );
    write(folder.path(), "rules.dl", rules);
    let begin = Instant::now();
    assert_eq!(found(folder.path(), &["city.yaml"]), is(&[("constraint-mismatch", 4)]));
    assert!(begin.elapsed() < Duration::from_secs(60), "{:?}", begin.elapsed());
}

/// A declaration that does not fit the configuration is reported where it stands, with the expected one, also if the
/// rules have other faults because of it.
#[test]
fn declarations_are_compared_with_the_configuration() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let config = write(
        folder,
        "main.yaml",
        "base: expert\nrules: main.dl\ntask: ~\npredicates: {define: {Tick: {quantity: tick}, Waited: {quantity: waited}}}\n",
    );
    let rules = ".include \"vocabulary.dl\"\n.decl Tick(t: float)\n.decl Waited(x: agent, n: number)\n.input Tick, \
                 Waited\nStop(X) :- CollidingClose(X, Y).\nSlow(X) :- Waited(X, n), Tick(t), n > t, Not(Stop(X)).\n";
    let file = write(folder, "main.dl", rules);
    for arguments in [
        vec!["check", &config],
        vec!["check", &file, "--config", &config],
        vec!["run", &config, "--ticks", "1", "--no-trace"],
    ] {
        let output = run(&arguments, b"");
        let words = [
            "the declaration of `Tick` does not match its definition in the configuration",
            "main.dl:2:7",
            "declare it with `.decl Tick(n: number)`",
            "error[type-mismatch]",
        ];
        fails(&output, 1, &words);
        let said = err(&output);
        assert!(!said.contains("declaration of `Waited`"), "{said}");
        assert_eq!(said.matches("declaration of `Tick`").count(), 1, "{said}");
    }
}

/// A message about rules that do not fit a configuration names the one that a command takes by default.
#[test]
fn default_configurations_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let rules =
        ".include \"vocabulary.dl\"\n.decl Tick(t: number)\n.input Tick\nStop(X) :- CollidingClose(X, Y), Tick(3).\n";
    let file = write(folder, "alone.dl", rules);
    let help =
        "without `--config`, this is about `configs/expert.yaml`; choose another configuration with `--config FILE`";
    let output = run(&["infer", "--rules", &file], b"");
    fails(&output, 1, &["error[rule-mismatch]", help]);
    let output = run(&["induce", "--rules", &file, "-"], b"");
    fails(&output, 1, &["error[rule-mismatch]", help]);
    let output = run(&["infer", "--rules", &file, "--config", "easy"], b"");
    assert!(err(&output).contains("rule-mismatch") && !err(&output).contains("without `--config`"));
    let episodes = folder.join("episodes.jsonl");
    let output = run(
        &["episodes", "make", "--rules", &file, "-o", episodes.to_str().unwrap()],
        b"",
    );
    fails(
        &output,
        1,
        &["this is about `configs/expert.yaml`, the default", "argument `CONFIG`"],
    );
}

/// `episodes make` says before its search that no ego can satisfy the clauses of an action.
#[test]
fn episodes_need_egos_that_can_satisfy_the_rules() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write(
        folder,
        "main.dl",
        ".include \"vocabulary.dl\"\nStop(X) :- CollidingClose(X, Y).\nSlow(X) :- IsTiro(X), IsAtInter(X), Not(Stop(X)).\n",
    );
    let make = |task: &str, agents: &str| {
        let text = format!("base: expert\nrules: main.dl\ntask: {{{task}}}\nagents: {{test: {{{agents}}}}}\n");
        let config = write(folder, "main.yaml", &text);
        let to = folder.join("episodes.jsonl");
        run(
            &["episodes", "make", &config, "--count", "10", "-o", to.to_str().unwrap()],
            b"",
        )
    };
    let said = "no ego of the split `test` can satisfy a clause of `Slow`";
    let one = "ego: {priority: {train: 3, val: 3, test: 3}, concepts: [{weight: 1, concepts: [bus]}]}";
    let help = "add a variant of the ego to the task: `{weight: 1, concepts: [tiro]}`";
    let words = [said, "main.dl:3:1", "no ego has the concept `tiro`", help];
    fails(&make(one, "repeat: 1"), 1, &words);
    let first = "cars: [{concepts: [bus], priority: 1}, {concepts: [tiro], priority: 2}]";
    fails(
        &make("ego: ~", first),
        1,
        &[
            said,
            "the ego is the first car of `agents: test`: give it `concepts: [tiro]`",
        ],
    );
}
