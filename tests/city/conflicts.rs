//! Conflicts of actions: `infer` confirms each scene that the search reports, and brute force finds no smaller scene.

use crate::cases::cases;
use crate::shipped_world::{MODES, world};
use crate::written_program::program;
use logicity::city::{Action, ActionTable, Split};
use logicity::datalog::diff::{Cut, Difference, Equivalence, Options, diff};
use logicity::datalog::{BaseType, Column, Function, PredicateId, Value};
use logicity::datalog::{Program, constraints};
use logicity::diag::{Sources, render};
use logicity::files::read_text;
use logicity::rng::Seed;
use logicity::sim::{
    Actions, EgoAnswer, Executor, Finding, Inference, Overlap, Settings, Simulation, conflicts, earlier_facts,
    scene_json,
};
use proptest::prelude::*;

/// The finding for a pair of actions.
fn finding(text: &str, pair: [Action; 2]) -> Finding {
    let program = program(text);
    let found = conflicts(program.rules(), &ActionTable::default()).unwrap();
    for overlap in &found {
        if let Finding::Together { scene, .. } = &overlap.finding {
            assert!(holds(&program, scene, overlap.actions), "{scene:?}");
        }
    }
    let overlap = found.into_iter().find(|overlap| overlap.actions == pair);
    overlap.expect("clauses for both actions").finding
}

/// Whether the rules derive both actions for the first entity, and the scene satisfies the constraints.
fn holds(program: &Program, scene: &Difference, actions: [Action; 2]) -> bool {
    let mut session = program.session();
    let given = |name: &str| scene.facts.iter().any(|(given, _)| given == name);
    let pairs = scene
        .entities
        .iter()
        .flat_map(|x| scene.entities.iter().map(|y| vec![x.clone(), y.clone()]));
    let sees = [("Sees".to_owned(), pairs.collect::<Vec<_>>())];
    for (name, rows) in scene.facts.iter().chain(sees.iter().filter(|_| !given("Sees"))) {
        let id = program.predicate(name).unwrap();
        let columns = program.rules().predicates[id.index()].columns.clone();
        for row in rows {
            let value = |(text, column): (&String, &Column)| match column.base {
                BaseType::Symbol => session.intern(text),
                _ => Value::number(text.parse().unwrap()),
            };
            let row: Vec<Value> = row.iter().zip(&columns).map(value).collect();
            session.insert(id, &row).unwrap();
        }
    }
    session.commit().unwrap();
    let ego = session.intern(&scene.entities[0]);
    let action = |action: Action| program.predicate(action.name()).unwrap();
    constraints::violations(&session).is_empty()
        && actions.iter().all(|&wanted| session.contains(action(wanted), [ego]))
}

fn rules(body: &str) -> String {
    format!(".include \"vocabulary.dl\"\n{body}")
}

fn scene(text: &str, pair: [Action; 2]) -> String {
    let text = rules(text);
    match finding(&text, pair) {
        Finding::Together { scene, .. } => scene_json(&scene, &[program(&text).rules()]).to_string(),
        other => panic!("{other:?}"),
    }
}

/// An agent has one value of a quantity, and headings are no agents.
#[test]
fn quantities_are_functions() {
    let pair = [Action::Slow, Action::Stop];
    let find = |slow: &str, stop: &str| {
        let mut rules = program(&rules(&format!(
            ".decl Heading(x: agent, h: symbol) .input Heading\n.decl Waited(x: agent, n: number) .input Waited\n\
             Slow(X) :- {slow}.\nStop(X) :- {stop}."
        )))
        .rules()
        .clone();
        let headings = ["Up", "Down", "Left", "Right"].map(str::to_owned).to_vec();
        rules.functions = [("Heading", Some(headings)), ("Waited", None)]
            .map(|(name, symbols)| {
                let predicate = rules.predicate(name).unwrap();
                Function { predicate, symbols }
            })
            .to_vec();
        let found = conflicts(&rules, &ActionTable::default()).unwrap();
        found
            .into_iter()
            .find(|overlap| overlap.actions == pair)
            .unwrap()
            .finding
    };
    let entities = |slow: &str, stop: &str| match find(slow, stop) {
        Finding::Together { scene, .. } => scene.entities,
        other => panic!("{slow}, {stop}: {other:?}"),
    };
    let is_found = |slow: &str, stop: &str| matches!(find(slow, stop), Finding::Together { .. });
    let up = "IsCar(X), Heading(X, \"Up\")";
    assert_eq!(entities(up, "IsAtInter(X), Heading(X, h)"), ["e0"]);
    assert!(!is_found(up, "Heading(X, \"Left\"), IsAtInter(X)"));
    assert!(!is_found(up, "Heading(X, h), h != \"Up\""));
    // With numbers, `check` tries scenes one by one.
    let waits = |range: &str| format!("{up}, Waited(X, n), n {range}");
    assert_eq!(entities(&waits("> 3"), "Waited(X, n), n < 5, Heading(X, h)"), ["e0"]);
    assert!(!is_found(&waits("> 3"), "Waited(X, n), n < 2"));
    assert!(!is_found(&waits("> 3"), "Waited(X, n), n < 5, Heading(X, \"Left\")"));
}

/// Numbers are numbers, and what follows from earlier ticks is no fact of the scene.
#[test]
fn scenes_with_values_and_earlier_ticks() {
    let program = program(&rules(
        ".decl Waited(x: agent, n: number) .input Waited\n.decl Tick(t: number) .input Tick\n\
         Stop(X) :- Waited(X, n), n > 3.\nSlow(X) :- IsCar(X), Tick(t), t > 8.\n\
         Fast(X) :- IsBus(X), once[1,3] IsAtInter(X).",
    ));
    let found = conflicts(program.rules(), &ActionTable::default()).unwrap();
    let scenes = found.into_iter().filter_map(|overlap| match overlap.finding {
        Finding::Together { scene, .. } => Some((overlap.actions, scene)),
        _ => None,
    });
    let (mut numbers, mut earlier) = (0, 0);
    for (actions, scene) in scenes {
        let json = scene_json(&scene, &[program.rules()]);
        let facts = json["facts"].as_object().unwrap();
        assert!(facts.keys().all(|name| !name.contains(' ')), "{json}");
        if actions.contains(&Action::Stop) {
            assert!(facts["Waited"][0][1].as_i64().unwrap() > 3, "{json}");
            numbers += 1;
        }
        if actions.contains(&Action::Slow) {
            assert!(facts["Tick"][0].as_i64().unwrap() > 8, "{json}");
            numbers += 1;
        }
        if actions.contains(&Action::Fast) {
            let ego = json["ego"].as_str().unwrap();
            let expected = format!("once[1,3] IsAtInter({ego})");
            assert!(earlier_facts(&scene, program.rules()).contains(&expected), "{json}");
            earlier += 1;
        }
    }
    assert!(numbers > 1 && earlier > 0, "{numbers} {earlier}");
}

#[test]
fn the_modes_of_the_paper() {
    for file in MODES.iter().filter(|mode| **mode != "vap-hard") {
        let text = format!(".include \"{file}.dl\"");
        let found = conflicts(program(&text).rules(), &ActionTable::default()).unwrap();
        assert!(!found.is_empty());
        assert!(
            found
                .iter()
                .all(|overlap| matches!(overlap.finding, Finding::Excluded { .. })),
            "{file}: {found:?}"
        );
    }
    let hard = program(".include \"vap-hard.dl\"");
    for overlap in conflicts(hard.rules(), &ActionTable::default()).unwrap() {
        let together = matches!(overlap.finding, Finding::Together { .. });
        assert_eq!(together, overlap.actions == [Action::Slow, Action::Fast], "{overlap:?}");
    }
    let Finding::Together { scene, .. } = finding(".include \"vap-hard.dl\"", [Action::Slow, Action::Fast]) else {
        panic!()
    };
    assert_eq!(
        scene_json(&scene, &[hard.rules()]).to_string(),
        r#"{"entities":["e0","e1"],"ego":"e0","facts":{"IsPedestrian":["e1"],"IsCar":["e0"],"IsAmbulance":["e0"],"IsTiro":["e0"],"IsOld":["e1"],"IsClose":[["e0","e1"],["e1","e0"]],"RightOf":[["e1","e0"]]}}"#
    );
}

#[test]
fn the_smallest_scene_is_reported() {
    let both = [Action::Slow, Action::Stop];
    assert_eq!(
        scene(
            "Stop(X) :- IsAtInter(X), IsCar(Y). Slow(X) :- IsTiro(X), IsCar(Y).",
            both
        ),
        r#"{"entities":["e0"],"ego":"e0","facts":{"IsCar":["e0"],"IsTiro":["e0"],"IsAtInter":["e0"]}}"#
    );
    // A single agent would have to be at an intersection and inside it.
    assert_eq!(
        scene(
            "Stop(X) :- IsAtInter(X), IsInInter(Y). Slow(X) :- IsTiro(X), IsCar(Y).",
            both
        ),
        r#"{"entities":["e0","e1"],"ego":"e0","facts":{"IsPedestrian":["e1"],"IsCar":["e0"],"IsTiro":["e0"],"IsAtInter":["e0"],"IsInInter":["e1"]}}"#
    );
    // A single agent would have to be next to itself.
    assert_eq!(
        scene("Stop(X) :- NextTo(X, Y). Slow(X) :- NextTo(Z, X).", both),
        r#"{"entities":["e0","e1"],"ego":"e0","facts":{"IsPedestrian":["e0"],"IsCar":["e1"],"NextTo":[["e0","e1"],["e1","e0"]]}}"#
    );
    // The clauses need different Y, so the scene has three agents.
    assert_eq!(
        scene(
            "Stop(X) :- LeftOf(Y, X), Not(IsCar(Y)). Slow(X) :- LeftOf(Y, X), IsCar(Y), IsBus(Y), Not(IsBus(X)).",
            both
        ),
        r#"{"entities":["e0","e1","e2"],"ego":"e0","facts":{"IsPedestrian":["e1"],"IsCar":["e0","e2"],"IsBus":["e2"],"LeftOf":[["e1","e0"],["e2","e0"]]}}"#
    );
}

#[test]
fn slow_derived_predicates_are_searched() {
    let text = ".decl Busy(x: agent)
        .decl Near(x: agent, y: agent)
        Near(X, Y) :- NextTo(X, Y).
        Near(X, Z) :- Near(X, Y), NextTo(Y, Z).
        Busy(X) :- Near(X, Y), IsOld(Y).
        Stop(X) :- Busy(X).
        Slow(X) :- IsTiro(X), Not(IsOld(_)), IsBus(X).
        Fast(X) :- IsTiro(X), Not(NextTo(X, _)), IsBus(X).
        Fast(X) :- Near(X, Y), Not(NextTo(X, Y)), IsBus(Y).";
    // No scene shows a conflict, and paths along `Near` have any length.
    let found = finding(&rules(text), [Action::Slow, Action::Stop]);
    assert!(
        matches!(
            found,
            Finding::NotFound(Equivalence::NoneFound {
                entities: Some(4..),
                proof: None,
                ..
            })
        ),
        "{found:?}"
    );
    assert_eq!(
        scene(text, [Action::Fast, Action::Stop]),
        r#"{"entities":["e0","e1"],"ego":"e0","facts":{"IsPedestrian":["e1"],"IsCar":["e0"],"IsBus":["e0"],"IsOld":["e1"],"NextTo":[["e0","e1"],["e1","e0"]]}}"#
    );
    // `Held` must not hold, so `Free` must hold, which no clause of the actions mentions.
    let text = ".decl Held, Free(x: agent)
        Fast(X) :- IsBus(X), Not(Held(X)).
        Held(X) :- IsBus(X), Not(Free(X)).
        Free(X) :- IsOld(Y), NextTo(X, Y).
        Stop(X) :- IsBus(X).";
    assert_eq!(
        scene(text, [Action::Fast, Action::Stop]),
        r#"{"entities":["e0","e1"],"ego":"e0","facts":{"IsPedestrian":["e1"],"IsCar":["e0"],"IsBus":["e0"],"IsOld":["e1"],"NextTo":[["e0","e1"],["e1","e0"]]}}"#
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
        r#"{"entities":["Car_1","e1"],"ego":"Car_1","facts":{"IsCar":["Car_1","e1"],"IsBus":["e1"],"NextTo":[["Car_1","e1"],["e1","Car_1"]]}}"#
    );
    let never = "Stop(X) :- IsCar(X), X = \"Car_1\". Slow(X) :- IsCar(X), X = \"Car_2\".";
    assert!(matches!(finding(&rules(never), both), Finding::Excluded { .. }));
    // A fact in the text also derives an action.
    let given = "Stop(\"a\"). Slow(X) :- IsCar(X).";
    assert_eq!(
        scene(given, both),
        r#"{"entities":["a"],"ego":"a","facts":{"IsCar":["a"]}}"#
    );
    let numbers = ".decl age(x: agent, n: number) .input age Stop(X) :- age(X, 5). Slow(X) :- IsCar(X).";
    assert_eq!(
        scene(numbers, both),
        r#"{"entities":["e0"],"ego":"e0","facts":{"IsCar":["e0"],"age":[["e0",5]]}}"#
    );
    let many =
        "Stop(X) :- LeftOf(A, X), LeftOf(B, X), LeftOf(C, X), LeftOf(D, X), A < B, B < C, C < D, Not(LeftOf(X, X)).
        Slow(X) :- IsCar(X).";
    assert!(scene(many, both).contains("e4"));
}

/// Constraints exclude pairs, and scenes with a partial view satisfy them.
#[test]
fn the_search_relies_on_constraints() {
    let both = [Action::Slow, Action::Stop];
    let text = "Stop(X) :- IsBus(X). Slow(X) :- IsOld(X).";
    assert!(matches!(finding(&rules(text), both), Finding::Excluded { .. }));
    // Two buses that see each other are both `Met`. So e1 must not see e0.
    let text = ".decl Met(x: agent) Met(X) :- IsBus(X), IsBus(Y), X != Y. Stop(X) :- Met(X).
        Slow(X) :- IsBus(Y), Not(Met(Y)), NextTo(X, Y).";
    let shown = scene(text, both);
    assert!(
        shown.contains(r#""Sees":[["e0","e0"],["e0","e1"],["e1","e1"]]"#),
        "{shown}"
    );
}

/// Rules with expressions and aggregates have no circuit, so the search samples scenes and proves nothing.
#[test]
fn rules_without_a_circuit_are_sampled() {
    let both = [Action::Slow, Action::Stop];
    let computed = "Stop(X) :- IsCar(X), 5 = strlen(X). Slow(X) :- IsCar(X).";
    let found = finding(&rules(computed), both);
    assert!(
        matches!(found, Finding::NotFound(Equivalence::NoneTried { .. })),
        "{found:?}"
    );
    let counted = "Stop(X) :- IsBus(X). Slow(X) :- IsCar(X), n = count : { NextTo(X, _) }, n > 0.";
    assert_eq!(
        scene(counted, both),
        r#"{"entities":["e0","e1"],"ego":"e0","facts":{"IsCar":["e0","e1"],"IsBus":["e0"],"NextTo":[["e0","e1"],["e1","e0"]]}}"#
    );
    let none_near = "Stop(X) :- IsBus(X). Slow(X) :- IsCar(X), 0 = count : { NextTo(X, _) }.";
    assert_eq!(
        scene(none_near, both),
        r#"{"entities":["e0"],"ego":"e0","facts":{"IsCar":["e0"],"IsBus":["e0"]}}"#
    );
    // The clauses that have a circuit suggest the scene of seven facts.
    let counted = "Slow(X) :- IsCar(X), n = count : { NextTo(X, _) }, n > 3.";
    let found = finding(
        &format!(".include \"vap-hard.dl\"\n{counted}"),
        [Action::Slow, Action::Fast],
    );
    assert!(matches!(found, Finding::Together { .. }), "{found:?}");
    // If each clause negates the other action, its other literals do not matter.
    let excluded = "Stop(X) :- IsBus(X). Slow(X) :- IsCar(X), Not(Stop(X)), 5 = strlen(X).";
    assert!(matches!(finding(&rules(excluded), both), Finding::Excluded { .. }));
}

/// The search finds a conflict if and only if brute force finds one among all sets of facts over two entities that
/// satisfy the constraints.
#[test]
fn the_search_agrees_with_brute_force() {
    let bodies = [
        "IsCar(X)",
        "Not(IsCar(X)), IsBus(X)",
        "IsCar(Y), Not(IsBus(Y)), Sees(X, Y)",
        "HigherPri(X, Y), Not(IsCar(Y))",
        "HigherPri(Y, X), Not(HigherPri(X, Y))",
        "IsBus(X), Not(IsCar(_))",
        "IsCar(X), IsBus(Y), Not(HigherPri(X, Y)), X != Y",
        "IsBus(X), Not(HigherPri(X, _))",
    ];
    for a in bodies {
        for b in bodies {
            let text = rules(&format!("Stop(X) :- {a}. Slow(X) :- {b}."));
            let found = matches!(finding(&text, [Action::Slow, Action::Stop]), Finding::Together { .. });
            let program = program(&text);
            let predicate = |name: &str| program.predicate(name).unwrap();
            let exists = (0..256_u32).any(|bits| {
                let mut session = program.session();
                let names = ["e0", "e1"].map(|name| session.intern(name));
                let insert = |session: &mut logicity::datalog::Session, id: PredicateId, row: &[Value]| {
                    session.insert(id, row).unwrap();
                };
                for (at, &x) in names.iter().enumerate() {
                    let kind = if bits >> at & 1 == 1 { "IsCar" } else { "IsPedestrian" };
                    insert(&mut session, predicate(kind), &[x]);
                    if bits >> (2 + at) & 1 == 1 {
                        insert(&mut session, predicate("IsBus"), &[x]);
                    }
                    for (other, &y) in names.iter().enumerate() {
                        insert(&mut session, predicate("Sees"), &[x, y]);
                        if bits >> (4 + 2 * at + other) & 1 == 1 {
                            insert(&mut session, predicate("HigherPri"), &[x, y]);
                        }
                    }
                }
                session.commit().unwrap();
                constraints::violations(&session).is_empty()
                    && ["Stop", "Slow"]
                        .iter()
                        .all(|action| session.contains(predicate(action), &names[..1]))
            });
            assert!(!exists || found, "{a} / {b}");
        }
    }
}

#[test]
fn slow_hostile_rules_end_soon() {
    let both = [Action::Slow, Action::Stop];
    let wide: Vec<String> = (0..60).map(|at| format!("LeftOf(X, Y{at})")).collect();
    let wide = wide.join(", ");
    let text = rules(&format!(
        "Stop(X) :- {wide}, Not(LeftOf(X, Y1)), X != Y1. Slow(X) :- {wide}, X != Y2."
    ));
    let found = finding(&text, both);
    assert!(
        matches!(&found, Finding::NotFound(Equivalence::NoneFound { cut, .. }) if *cut == [Cut::Size]),
        "{found:?}"
    );
    let deep: Vec<String> = (0..60)
        .map(|at| format!(".decl p{at}(x: agent) p{at}(X) :- p{}(X). p{at}(X) :- q(X).", at + 1))
        .collect();
    let text = rules(&format!(
        ".decl q(x: agent) q(X) :- IsCar(X), IsBus(X). .decl p60(x: agent) p60(X) :- IsTiro(X), Not(IsTiro(X)). {}
         Stop(X) :- p0(X), Not(IsCar(X)). Slow(X) :- p0(X).",
        deep.join("\n")
    ));
    assert!(matches!(finding(&text, both), Finding::Excluded { .. }));
}

// --- scenes that `check` and `diff` print

/// Rules for actions from small numbers; with `count` one of them contains an aggregate, so that scenes are sampled.
fn written(genes: &[(u8, [u8; 3])], count: bool) -> String {
    const LITERALS: [&str; 24] = [
        "IsCar(X)",
        "IsPedestrian(X)",
        "IsBus(X)",
        "IsOld(Y)",
        "IsAtInter(X)",
        "IsInInter(Y)",
        "IsAtInter(Y)",
        "IsClose(X, Y)",
        "NextTo(Y, X)",
        "HigherPri(X, Y)",
        "HigherPri(Y, X)",
        "CollidingClose(X, Y)",
        "LeftOf(Y, X)",
        "RightOf(X, Y)",
        "Sees(X, Y)",
        "X = Y",
        "X != Y",
        "Not(IsCar(X))",
        "Not(IsPedestrian(Y))",
        "Not(HigherPri(X, Y))",
        "Not(NextTo(X, Y))",
        "Not(IsClose(X, _))",
        "Not(Sees(Y, X))",
        "Not(Stop(X))",
    ];
    let mut text = ".include \"vocabulary.dl\"\n".to_owned();
    for (number, (head, literals)) in genes.iter().enumerate() {
        let head = ["Stop", "Slow", "Fast"][usize::from(*head) % 3];
        let mut body: Vec<&str> = literals
            .iter()
            .map(|&one| LITERALS[usize::from(one) % LITERALS.len()])
            .collect();
        if head == "Stop" {
            body.retain(|literal| *literal != "Not(Stop(X))");
        }
        if count && number == 0 {
            body.push("count : { NextTo(X, _) } < 2");
        }
        body.push("Sees(X, X)");
        if body.iter().any(|literal| literal.contains('Y')) {
            body.push("Sees(X, Y)");
        }
        text += &format!("{head}(X) :- {}.\n", body.join(", "));
    }
    text
}

/// The answer of `infer --check-constraints` for a scene under the rules of a text and the actions of a configuration.
fn inferred(config: &str, text: &str, scene: &Difference) -> EgoAnswer {
    let world = world(config, Some(text), |_| ());
    let (scenario, program) = (world.scenario.clone(), world.program.clone());
    let mut inference = Inference::new(scenario, program, Seed(0), Executor::Auto, read_text).expect("rules fit");
    inference.check_constraints();
    let mut sources = Sources::new();
    let source = sources.add("scene", scene_json(scene, &[world.program.rules()]).to_string());
    let answer = inference.answer(&sources, source);
    let answer = answer.unwrap_or_else(|faults| panic!("{text}{}", render(&faults, &sources, false)));
    answer.egos().last().expect("a scene has an ego")
}

fn clauses() -> impl Strategy<Value = Vec<(u8, [u8; 3])>> {
    proptest::collection::vec(any::<(u8, [u8; 3])>(), 2..5)
}

proptest! {
    #![proptest_config(cases(60))]

    /// The scene of a conflict satisfies the constraints, derives both actions, and the announced one is taken.
    #[test]
    fn slow_scenes_of_conflicts_are_what_infer_says(genes in clauses(), count in 0..10_u8, published in any::<bool>()) {
        let text = written(&genes, count == 0);
        let config = if published { "vap-hard" } else { "expert" };
        let precedence = world(config, None, |_| ()).scenario.actions.priority.clone();
        for overlap in conflicts(program(&text).rules(), &ActionTable::default()).unwrap() {
            let Finding::Together { scene, .. } = &overlap.finding else { continue };
            let answer = inferred(config, &text, scene);
            prop_assert!(overlap.actions.iter().all(|&action| answer.derived.contains(action)), "{text}{answer:?}");
            let of_two: Vec<Action> = answer.derived.iter().filter(|action| overlap.actions.contains(action)).collect();
            prop_assert_eq!(of_two.len(), 2);
            if answer.derived.len() == 2 {
                prop_assert_eq!(answer.action, overlap.winner(&precedence));
            }
        }
    }

    /// The scene of a difference satisfies the constraints, and each side derives in it what `diff` prints.
    #[test]
    fn slow_scenes_of_differences_are_what_infer_says(left in clauses(), right in clauses(), count in 0..10_u8) {
        let texts = [written(&left, count == 0), written(&right, false)];
        let [one, other] = texts.each_ref().map(|text| program(text));
        let options = Options { entities_max: 3, conflicts_max: 5_000, ..Options::default() };
        let found = diff(one.rules(), other.rules(), &options).unwrap();
        if let Equivalence::Different(scene) = found {
            prop_assert_ne!(&scene.derived[0], &scene.derived[1]);
            for (text, derived) in texts.iter().zip(&scene.derived) {
                let answer = inferred("expert", text, &scene);
                let of_ego = |action: &Action| {
                    derived.contains(&(action.name().to_owned(), vec![scene.entities[0].clone()]))
                };
                let mut expected: Actions = Action::STANDARD.into_iter().filter(of_ego).collect();
                if expected == [Action::Normal].into_iter().collect() {
                    expected = Actions::default();
                }
                prop_assert_eq!(answer.derived, expected, "{}{:?}", text, scene);
            }
        }
    }
}

/// An agent is a car or a pedestrian, never both and never neither.
#[test]
fn types_exclude_conflicts() {
    for text in [
        "Stop(X) :- IsCar(X), IsAtInter(X). Fast(X) :- IsPedestrian(X).",
        "Stop(X) :- Not(IsCar(X)), IsAtInter(X). Fast(X) :- Not(IsPedestrian(X)), IsAtInter(X).",
        "Stop(X) :- IsAtInter(X). Fast(X) :- IsInInter(X).",
        "Stop(X) :- HigherPri(X, Y), HigherPri(Y, X). Fast(X) :- IsCar(X).",
        "Stop(X) :- IsCar(X), Not(Sees(X, X)). Fast(X) :- IsCar(X).",
    ] {
        let found = finding(&rules(text), [Action::Fast, Action::Stop]);
        assert!(matches!(found, Finding::Excluded { .. }), "{text}: {found:?}");
    }
}

#[test]
fn the_order_of_actions_decides_conflicts() {
    let overlap = |actions| Overlap {
        actions,
        finding: Finding::Excluded { given: Vec::new() },
    };
    let published = Action::STANDARD;
    for (pair, safest, first) in [
        ([Action::Slow, Action::Stop], Action::Stop, Action::Slow),
        ([Action::Fast, Action::Stop], Action::Stop, Action::Fast),
        ([Action::Slow, Action::Fast], Action::Slow, Action::Slow),
        ([Action::Slow, Action::Normal], Action::Slow, Action::Slow),
    ] {
        assert_eq!(overlap(pair).winner(&Action::SAFEST_FIRST), safest);
        assert_eq!(overlap(pair).winner(&published), first);
        assert_ne!(overlap(pair).loser(&published), first);
    }
    let priority = |mode: &str| world(mode, None, |_| ()).scenario.actions.priority.clone();
    for mode in MODES {
        let expected = if mode.starts_with("vap") {
            published
        } else {
            Action::SAFEST_FIRST
        };
        assert_eq!(priority(mode), expected, "{mode}");
    }
}

/// The facts of running cities satisfy the constraints of `vocabulary.dl`; see also the recorded scenes.
#[test]
fn slow_every_mode_keeps_the_constraints_of_the_vocabulary() {
    for mode in MODES {
        let world = world(mode, None, |_| ());
        for seed in 0..2 {
            let settings = Settings {
                executor: Executor::Relational,
                ..Settings::default()
            };
            let mut city = Simulation::new(world.clone(), Split::Test, Seed(seed), settings).unwrap();
            for _ in 0..25 {
                city.tick(&[]).unwrap();
                let snapshot = city.snapshot().unwrap();
                let known = |predicate| world.vocabulary.defines(&world.program, predicate);
                let broken = constraints::violations_among(snapshot.session(), known);
                assert!(broken.is_empty(), "{mode}: {broken:?}");
            }
        }
    }
}
