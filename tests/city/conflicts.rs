//! Actions that can be derived together: each scene that is told is asked again, and a brute force finds nothing smaller.

use crate::shipped_world::MODES;
use crate::written_program::program;
use logicity::city::Action;
use logicity::datalog::Program;
use logicity::datalog::{RelId, Value};
use logicity::sim::{Cut, ENTITIES_MAX, Example, Finding, conflicts};

/// The finding for a pair of actions.
fn finding(text: &str, pair: [Action; 2]) -> Finding {
    let program = program(text);
    let found = conflicts(&program);
    for overlap in &found {
        if let Finding::Together { scene, .. } = &overlap.finding {
            assert!(holds(&program, scene, overlap.actions), "{scene:?}");
        }
    }
    let overlap = found.into_iter().find(|overlap| overlap.actions == pair);
    overlap.expect("both actions have clauses").finding
}

/// Whether both actions follow for the first entity.
fn holds(program: &Program, scene: &Example, actions: [Action; 2]) -> bool {
    let mut session = program.session();
    let names: Vec<Value> = scene.entities.iter().map(|name| session.intern(name)).collect();
    for (name, rows) in &scene.facts {
        let rel = program.relation(name).unwrap();
        for row in rows {
            let row: Vec<Value> = row.iter().map(|&entity| names[entity]).collect();
            session.insert(rel, &row).unwrap();
        }
    }
    let sees = program.relation("Sees").unwrap();
    if !scene.facts.contains_key("Sees") {
        for &x in &names {
            names.iter().for_each(|&y| session.insert(sees, &[x, y]).unwrap());
        }
    }
    session.commit().unwrap();
    let action = |action: Action| program.relation(action.name()).unwrap();
    actions
        .iter()
        .all(|speed| session.contains(action(*speed), &names[..1]))
}

fn rules(body: &str) -> String {
    format!(".include \"vocabulary.dl\"\n{body}")
}

fn scene(text: &str, pair: [Action; 2]) -> String {
    match finding(&rules(text), pair) {
        Finding::Together { scene, .. } => scene.to_json().to_string(),
        other => panic!("{other:?}"),
    }
}

#[test]
fn the_modes_of_the_paper() {
    for file in MODES.iter().filter(|mode| **mode != "vap-hard") {
        let text = format!(".include \"{file}.dl\"");
        let found = conflicts(&program(&text));
        assert!(!found.is_empty());
        assert!(
            found.iter().all(|overlap| overlap.finding == Finding::Excluded),
            "{file}: {found:?}"
        );
    }
    let hard = program(".include \"vap-hard.dl\"");
    for overlap in conflicts(&hard) {
        let together = matches!(overlap.finding, Finding::Together { .. });
        assert_eq!(together, overlap.actions == [Action::Slow, Action::Fast], "{overlap:?}");
    }
    let Finding::Together { scene, .. } = finding(".include \"vap-hard.dl\"", [Action::Slow, Action::Fast]) else {
        panic!()
    };
    assert_eq!(
        scene.to_json().to_string(),
        r#"{"entities":["e0","e1"],"ego":"e0","facts":{"IsAmbulance":["e0"],"IsClose":[["e0","e1"]],"IsOld":["e1"],"IsPedestrian":["e1"],"IsTiro":["e0"],"RightOf":[["e1","e0"]]}}"#
    );
}

#[test]
fn the_smallest_scene_is_told() {
    let both = [Action::Slow, Action::Stop];
    assert_eq!(
        scene(
            "Stop(X) :- IsAtInter(X), IsInInter(Y). Slow(X) :- IsTiro(X), IsCar(Y).",
            both
        ),
        r#"{"entities":["e0"],"ego":"e0","facts":{"IsAtInter":["e0"],"IsCar":["e0"],"IsInInter":["e0"],"IsTiro":["e0"]}}"#
    );
    // One agent alone would have to stand next to itself.
    assert_eq!(
        scene("Stop(X) :- NextTo(X, Y). Slow(X) :- NextTo(Z, X).", both),
        r#"{"entities":["e0","e1"],"ego":"e0","facts":{"NextTo":[["e0","e1"],["e1","e0"]]}}"#
    );
    // The same Y must not be it: three are needed.
    assert_eq!(
        scene(
            "Stop(X) :- LeftOf(Y, X), Not(IsCar(Y)). Slow(X) :- LeftOf(Y, X), IsCar(Y), IsBus(Y), Not(IsBus(X)).",
            both
        ),
        r#"{"entities":["e0","e1","e2"],"ego":"e0","facts":{"IsBus":["e1"],"IsCar":["e1"],"LeftOf":[["e1","e0"],["e2","e0"]]}}"#
    );
}

#[test]
fn slow_derived_predicates_are_unfolded() {
    let text = ".decl Busy(x: agent)
        .decl Near(x: agent, y: agent)
        Near(X, Y) :- NextTo(X, Y).
        Near(X, Z) :- Near(X, Y), NextTo(Y, Z).
        Busy(X) :- Near(X, Y), IsOld(Y).
        Stop(X) :- Busy(X).
        Slow(X) :- IsTiro(X), Not(IsOld(_)), IsBus(X).
        Fast(X) :- IsTiro(X), Not(NextTo(X, _)), IsBus(X).
        Fast(X) :- Near(X, Y), Not(NextTo(X, Y)), IsBus(Y).";
    assert!(matches!(
        finding(&rules(text), [Action::Slow, Action::Stop]),
        Finding::NotFound { .. }
    ));
    assert_eq!(
        scene(text, [Action::Fast, Action::Stop]),
        r#"{"entities":["e0","e1"],"ego":"e0","facts":{"IsBus":["e0"],"IsOld":["e0"],"NextTo":[["e0","e1"],["e1","e0"]]}}"#
    );
    // Held must not hold, so Free has to, of which neither action speaks.
    let text = ".decl Held, Free(x: agent)
        Fast(X) :- IsBus(X), Not(Held(X)).
        Held(X) :- IsBus(X), Not(Free(X)).
        Free(X) :- IsOld(Y), NextTo(X, Y).
        Stop(X) :- IsBus(X).";
    assert_eq!(
        scene(text, [Action::Fast, Action::Stop]),
        r#"{"entities":["e0","e1"],"ego":"e0","facts":{"IsBus":["e0"],"IsOld":["e1"],"NextTo":[["e0","e1"]]}}"#
    );
}

#[test]
fn constants_and_comparisons_are_respected() {
    let both = [Action::Slow, Action::Stop];
    assert_eq!(
        scene(
            "Stop(X) :- IsCar(X), X = \"Car_1\". Slow(X) :- IsBus(Y), Y != X, NextTo(X, \"e1\"), IsCar(X).",
            both
        ),
        r#"{"entities":["Car_1","e1"],"ego":"Car_1","facts":{"IsBus":["e1"],"IsCar":["Car_1"],"NextTo":[["Car_1","e1"]]}}"#
    );
    let never = "Stop(X) :- IsCar(X), X = \"Car_1\". Slow(X) :- IsCar(X), X = \"Car_2\".";
    let none = |cut: &[Cut]| Finding::NotFound {
        scenes: 0,
        cut: cut.iter().copied().collect(),
    };
    assert_eq!(finding(&rules(never), both), none(&[]));
    let constants =
        r#"Stop(X) :- NextTo(X, "a"), NextTo(X, "b"), NextTo(X, "c"), NextTo(X, "d"). Slow(X) :- IsCar(X)."#;
    assert_eq!(finding(&rules(constants), both), none(&[Cut::Constants]));
    let numbers = ".decl age(x: agent, n: number) .input age Stop(X) :- age(X, 5). Slow(X) :- IsCar(X).";
    assert_eq!(finding(&rules(numbers), both), none(&[Cut::NotEntities]));
    let computed = "Stop(X) :- IsCar(X), 5 = strlen(X). Slow(X) :- IsCar(X).";
    let tried = Finding::NotFound {
        scenes: 1,
        cut: [Cut::Beyond].into(),
    };
    assert_eq!(finding(&rules(computed), both), tried);
    // What an aggregate looks at is put up, too.
    let counted = "Stop(X) :- IsBus(X). Slow(X) :- IsCar(X), n = count : { NextTo(X, _) }, n > 0.";
    assert_eq!(
        scene(counted, both),
        r#"{"entities":["e0","e1"],"ego":"e0","facts":{"IsBus":["e0"],"IsCar":["e0"],"NextTo":[["e0","e1"]]}}"#
    );
    let none_near = "Stop(X) :- IsBus(X). Slow(X) :- IsCar(X), 0 = count : { NextTo(X, _) }.";
    assert_eq!(
        scene(none_near, both),
        r#"{"entities":["e0"],"ego":"e0","facts":{"IsBus":["e0"],"IsCar":["e0"]}}"#
    );
    let many =
        "Stop(X) :- LeftOf(A, X), LeftOf(B, X), LeftOf(C, X), LeftOf(D, X), A < B, B < C, C < D, Not(LeftOf(X, X)).
        Slow(X) :- IsCar(X).";
    assert!(matches!(finding(&rules(many), both), Finding::NotFound { .. }));
    assert_eq!(ENTITIES_MAX, 4);
}

/// Every set of facts over one or two entities, for rules over a few predicates: the search finds a conflict exactly where there
/// is one.
#[test]
fn a_brute_force_agrees() {
    let bodies = [
        "IsCar(X)",
        "Not(IsCar(X)), IsBus(X)",
        "IsCar(Y), Not(IsBus(Y)), Sees(X, Y)",
        "NextTo(X, Y), Not(IsCar(Y))",
        "NextTo(Y, X), Not(NextTo(X, Y))",
        "IsBus(X), Not(IsCar(_))",
        "IsCar(X), IsBus(Y), Not(NextTo(X, Y)), X != Y",
        "IsBus(X), Not(NextTo(X, _))",
    ];
    for a in bodies {
        for b in bodies {
            let text = rules(&format!("Stop(X) :- {a}. Slow(X) :- {b}."));
            let found = matches!(finding(&text, [Action::Slow, Action::Stop]), Finding::Together { .. });
            let program = program(&text);
            let relation = |name: &str| program.relation(name).unwrap();
            let exists = (0..256_u32).any(|bits| {
                let mut session = program.session();
                let names = ["e0", "e1"].map(|name| session.intern(name));
                let insert = |session: &mut logicity::datalog::Session, rel: RelId, row: &[Value]| {
                    session.insert(rel, row).unwrap();
                };
                for (at, &x) in names.iter().enumerate() {
                    if bits >> at & 1 == 1 {
                        insert(&mut session, relation("IsCar"), &[x]);
                    }
                    if bits >> (2 + at) & 1 == 1 {
                        insert(&mut session, relation("IsBus"), &[x]);
                    }
                    for (other, &y) in names.iter().enumerate() {
                        insert(&mut session, relation("Sees"), &[x, y]);
                        if bits >> (4 + 2 * at + other) & 1 == 1 {
                            insert(&mut session, relation("NextTo"), &[x, y]);
                        }
                    }
                }
                session.commit().unwrap();
                ["Stop", "Slow"]
                    .iter()
                    .all(|action| session.contains(relation(action), &names[..1]))
            });
            assert!(!exists || found, "{a} / {b}");
        }
    }
}

#[test]
fn slow_hostile_rules_end_soon() {
    let cut = |text: &str| match finding(text, [Action::Slow, Action::Stop]) {
        Finding::NotFound { cut, .. } => Vec::from_iter(cut),
        other => panic!("{other:?}"),
    };
    let wide: Vec<String> = (0..60).map(|at| format!("LeftOf(X, Y{at})")).collect();
    let wide = wide.join(", ");
    let text = rules(&format!(
        "Stop(X) :- {wide}, Not(LeftOf(X, Y1)), X != Y1. Slow(X) :- {wide}, X != Y2."
    ));
    assert_eq!(cut(&text), [Cut::Many]);
    let deep: Vec<String> = (0..60)
        .map(|at| format!(".decl p{at}(x: agent) p{at}(X) :- p{}(X). p{at}(X) :- q(X).", at + 1))
        .collect();
    let text = rules(&format!(
        ".decl q(x: agent) q(X) :- IsCar(X), IsBus(X). .decl p60(x: agent) p60(X) :- IsTiro(X), Not(IsTiro(X)). {}
         Stop(X) :- p0(X), Not(IsCar(X)). Slow(X) :- p0(X).",
        deep.join("\n")
    ));
    assert_eq!(cut(&text), [Cut::Deep]);
}
