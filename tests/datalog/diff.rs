//! `diff`: whether two rule sets are equivalent, and a minimal counterexample if not.

use crate::cases::cases;
use crate::root::root;
use crate::rule_files::RuleFiles;
use logicity_datalog as datalog;
use logicity_datalog::diag::Sources;
use logicity_datalog::diff::{Cut, Difference, Equivalence, Options, diff};
use logicity_datalog::naive;
use logicity_datalog::{Constraint, InputPolicy, PredicateId, Rules, Value};
use proptest::prelude::*;

fn rules(text: &str) -> Rules {
    let mut sources = Sources::new();
    let entry = sources.add("test.dl", text);
    let loaded = datalog::load(&mut sources, entry, &RuleFiles);
    let rendered = logicity_datalog::diag::render(&loaded.diagnostics, &sources, false);
    loaded.rules.unwrap_or_else(|| panic!("{rendered}\n{text}"))
}

fn shipped(name: &str) -> Rules {
    rules(&std::fs::read_to_string(root().join("rules").join(name)).unwrap())
}

fn compare(left: &Rules, right: &Rules) -> Equivalence {
    diff(left, right, &Options::default()).unwrap()
}

fn difference(left: &Rules, right: &Rules) -> Difference {
    match compare(left, right) {
        Equivalence::Different(difference) => difference,
        other => panic!("{other:?}"),
    }
}

/// The rules of vap-easy, rewritten in `tests/fixtures/vap-easy-bloated.dl`.
fn bloated() -> String {
    std::fs::read_to_string(root().join("tests/fixtures/vap-easy-bloated.dl")).unwrap()
}

#[test]
fn vap_easy_is_proved_equal_to_a_shuffled_and_bloated_copy() {
    let (left, right) = (shipped("vap-easy.dl"), rules(&bloated()));
    for (left, right) in [(&left, &right), (&right, &left)] {
        let found = compare(left, right);
        assert!(
            matches!(found, Equivalence::Equivalent { entities: Some(entities) } if entities <= 10),
            "{found:?}"
        );
    }
    // Without the constraints they differ, and so they do after a small error.
    let slip = rules(&bloated().replace("IsInInter(A), IsCar(A)", "IsInInter(A), IsBus(A)"));
    let found = difference(&left, &slip);
    // No agent is at an intersection and inside it.
    assert_eq!(found.entities.len(), 2);
    assert!(found.smallest);
    let mut trusting = right.clone();
    trusting.constraints.clear();
    let mut plain = left.clone();
    plain.constraints.clear();
    difference(&plain, &trusting);
}

#[test]
fn every_shipped_rule_set_is_proved_equal_to_itself() {
    for name in [
        "easy",
        "medium",
        "hard",
        "expert",
        "transfer-medium",
        "vap-easy",
        "vap-hard",
    ] {
        let one = shipped(&format!("{name}.dl"));
        let found = compare(&one, &one);
        assert!(matches!(found, Equivalence::Equivalent { .. }), "{name}: {found:?}");
    }
    assert!(matches!(
        compare(&shipped("transfer-hard.dl"), &shipped("hard.dl")),
        Equivalence::Equivalent { .. }
    ));
}

#[test]
fn the_smallest_scene_between_medium_and_hard() {
    let found = difference(&shipped("medium.dl"), &shipped("hard.dl"));
    assert!(found.smallest);
    assert_eq!(found.entities, ["e0", "e1"]);
    let fact = |name: &str, rows: &[&[&str]]| {
        let rows = rows.iter().map(|row| row.iter().map(|&word| word.to_owned()).collect());
        (name.to_owned(), rows.collect::<Vec<Vec<String>>>())
    };
    // The constraints make the police a car, and closeness symmetric.
    let expected = [
        fact("IsCar", &[&["e0"], &["e1"]]),
        fact("IsPolice", &[&["e1"]]),
        fact("IsClose", &[&["e0", "e1"], &["e1", "e0"]]),
        fact("LeftOf", &[&["e1", "e0"]]),
    ];
    assert_eq!(found.facts, expected);
    let stop = ("Stop".to_owned(), vec!["e0".to_owned()]);
    assert!(!found.derived[0].contains(&stop) && found.derived[1].contains(&stop));
}

#[test]
fn rules_with_recursion_or_numbers_are_searched_without_a_proof() {
    let base = ".decl Edge(x: symbol, y: symbol) .input Edge .decl Path(x: symbol, y: symbol) .output Path
        Path(x, y) :- Edge(x, y).";
    let left = rules(&format!("{base} Path(x, z) :- Path(x, y), Path(y, z)."));
    let right = rules(&format!("{base} Path(x, z) :- Edge(x, y), Path(y, z)."));
    let few = Options {
        entities_max: 3,
        ..Options::default()
    };
    assert_eq!(
        diff(&left, &right, &few).unwrap(),
        Equivalence::NoneFound {
            entities: Some(3),
            proof: None,
            cut: Vec::new()
        }
    );
    let steps = rules(&format!("{base} Path(x, z) :- Edge(x, y), Edge(y, z)."));
    let found = difference(&left, &steps);
    assert_eq!(
        (found.entities.len(), found.facts[0].1.len()),
        (3, 3),
        "a cycle of three"
    );

    let speed = |rule: &str| {
        rules(&format!(
            ".decl V(x: symbol, v: number) .input V .decl F(x: symbol) .output F {rule}"
        ))
    };
    let (over, from) = (speed("F(x) :- V(x, v), v > 30."), speed("F(x) :- V(x, v), v >= 30."));
    assert_eq!(
        difference(&over, &from).facts,
        [("V".to_owned(), vec![vec!["e0".to_owned(), "30".to_owned()]])]
    );
    let next = speed("F(x) :- V(x, v), v >= 31.");
    assert!(matches!(
        diff(&over, &next, &few).unwrap(),
        Equivalence::NoneFound { proof: None, .. }
    ));
}

#[test]
fn incomparable_programs_are_errors() {
    let left = rules(".decl A(x: symbol) .input A .decl B(x: symbol) .output B B(x) :- A(x).");
    let right = rules(
        ".decl C(x: symbol) .input C .decl A(x: symbol) .decl B(x: symbol) .output B A(x) :- C(x). B(x) :- A(x).",
    );
    assert!(diff(&left, &right, &Options::default()).is_err());
    let options = Options {
        predicates: vec!["Absent".into()],
        ..Options::default()
    };
    assert!(diff(&left, &left, &options).is_err());
}

/// "Every entity has a successor" is a for-all over an exists, so the number of variables does not bound the size of a
/// counterexample: here it is a cycle of five labels.
#[test]
fn for_all_over_exists_is_not_proved() {
    let base = ".decl A, D(x: symbol) .decl L0, L1, L2, L3, L4(x: symbol) .decl R(x: symbol, y: symbol)
        .input A, D, L0, L1, L2, L3, L4, R .disjoint L0, L1, L2, L3, L4
        .decl Next(x: symbol) .decl P(x: symbol) .output P
        Next(y) :- R(y, _z).";
    let left = rules(&format!("{base} P(x) :- A(x)."));
    let mut right = format!(
        "{base} P(x) :- A(x), !D(x). P(x) :- A(x), D(y), !Next(y). P(x) :- A(x), R(_, z), !D(z).
        P(x) :- A(x), D(y), !L0(y), !L1(y), !L2(y), !L3(y), !L4(y).\n"
    );
    for label in 0..5 {
        right += &format!("P(x) :- A(x), R(y, z), L{label}(y), !L{}(z).\n", (label + 1) % 5);
    }
    let right = rules(&right);
    let few = Options {
        entities_max: 4,
        ..Options::default()
    };
    assert_eq!(
        diff(&left, &right, &few).unwrap(),
        Equivalence::NoneFound {
            entities: Some(4),
            proof: None,
            cut: Vec::new()
        }
    );
    assert_eq!(difference(&left, &right).entities.len(), 5);
    let hurried = Options {
        conflicts_max: 1,
        ..Options::default()
    };
    let found = diff(&left, &right, &hurried).unwrap();
    assert!(
        matches!(
            &found,
            Equivalence::NoneFound { entities: Some(..5), cut, .. } if *cut == [Cut::Conflicts]
        ),
        "{found:?}"
    );
}

/// No text makes the comparison panic or run without end.
#[test]
fn comparison_of_large_programs_is_bounded() {
    let mut chain = ".decl P0(x: symbol) .input P0\n".to_owned();
    for number in 1..5000 {
        chain += &format!(".decl P{number}(x: symbol) P{number}(x) :- P{}(x).\n", number - 1);
    }
    chain += ".output P4999";
    let [chain, longer] = ["", "P1(x) :- P0(x), P0(_)."].map(|more| rules(&format!("{chain}\n{more}")));
    assert!(matches!(
        compare(&chain, &longer),
        Equivalence::NoneFound { entities: Some(0), ref cut, .. } if *cut == [Cut::Size, Cut::Proof]
    ));
    assert_eq!(compare(&chain, &chain), Equivalence::Equivalent { entities: None });
    let wide: Vec<String> = (0..60).map(|number| format!("E(v{number}, v{})", number + 1)).collect();
    let wide = |more: &str| {
        rules(&format!(
            ".decl E(x: symbol, y: symbol) .input E .decl P(x: symbol) .output P P(v0) :- {}{more}.",
            wide.join(", ")
        ))
    };
    let found = compare(&wide(""), &wide(", v3 != v5"));
    assert!(matches!(found, Equivalence::Different(_)), "{found:?}");
}

/// One side writes the guard itself, so that only the other side has a scope.
#[test]
fn a_guard_on_one_side_is_complete_on_both() {
    let head = ".decl A(x: symbol) .decl Sees(x: symbol, y: symbol) .input A, Sees .decl P(x: symbol) .output P\n";
    let guarded = rules(&format!("{head}.scope Sees\nP(x) :- A(x), A(y), !Sees(y, x)."));
    let written = rules(&format!("{head}P(x) :- A(x), A(y), Sees(x, y), !Sees(y, x)."));
    assert!(matches!(compare(&guarded, &written), Equivalence::Equivalent { .. }));
    let other = rules(&format!("{head}P(x) :- A(x), A(y), !Sees(y, x)."));
    let Equivalence::Different(found) = compare(&guarded, &other) else {
        panic!("a difference")
    };
    assert_ne!(found.derived[0], found.derived[1]);
}

// --- comparison with exhaustive search

/// Makes a program over A, B (unary) and R (binary) from small numbers. It defines P, then S and T.
fn written(genes: &[(u8, u8, u8, u8)], constraints: u8) -> String {
    let mut text = ".decl A, B(x: symbol) .decl R(x: symbol, y: symbol) .input A, B, R
        .decl P(x: symbol) .decl S(x: symbol) .decl T(x: symbol, y: symbol) .output P, S, T\n"
        .to_owned();
    let directives = [
        ".disjoint A, B",
        ".implies A, B",
        ".irreflexive R",
        ".symmetric R",
        ".covering A, B",
        ".reflexive R",
        ".asymmetric R",
    ];
    for (bit, directive) in directives.iter().enumerate() {
        if constraints >> bit & 1 == 1 {
            text += directive;
            text.push('\n');
        }
    }
    let base = [
        "A(x)", "B(x)", "R(x, y)", "R(y, x)", "A(y)", "B(y)", "R(x, x)", "R(y, z)",
    ];
    let tests = [
        "!A(x)", "!B(x)", "!R(x, y)", "x != y", "!R(x, _)", "!B(y)", "!R(y, _)", "R(y, _)",
    ];
    for &(head, a, b, c) in genes {
        // A positive atom binds each tested variable.
        let mut body = vec![
            "A(x)".to_owned(),
            base[a as usize % 8].into(),
            tests[b as usize % 8].into(),
        ];
        let text_of = |body: &[String]| body.join(", ");
        let (head, more) = match head % 5 {
            0 | 1 => ("P(x)", ""),
            2 => ("S(x)", ["!P(x)", "P(x)", "P(y)", "!P(y)"][c as usize % 4]),
            3 => ("S(x)", ["B(x)", "A(y)", "T(x, y)", "!P(x)"][c as usize % 4]),
            _ => (
                "T(x, y)",
                ["T(y, x)", "R(x, y)", "T(x, z), T(z, y)", "P(y)"][c as usize % 4],
            ),
        };
        if !more.is_empty() {
            body.push(more.into());
        }
        if c >= 128 {
            body.remove(0);
        }
        let all = text_of(&body);
        for (name, atom) in [("x", "B(x)"), ("y", "R(x, y)"), ("z", "R(y, z)")] {
            let bound = body
                .iter()
                .any(|literal| !literal.starts_with('!') && !literal.contains('=') && literal.contains(name));
            if (head.contains(name) || all.contains(name)) && !bound {
                body.push(atom.into());
            }
        }
        text += &format!("{head} :- {}.\n", text_of(&body));
    }
    text
}

/// The rows of P, S and T in a scene, whose bits are A, B and R over the first entities.
fn outputs(rules: &Rules, entities: u32, scene: u32) -> Option<Vec<(PredicateId, Vec<Vec<Value>>)>> {
    let symbols = rules.symbols.clone();
    let names: Vec<Value> = (0..entities)
        .map(|index| Value(symbols.intern(&format!("e{index}")).0))
        .collect();
    let predicate = |name: &str| rules.predicate(name).unwrap();
    let mut facts = Vec::new();
    let mut bit = 0;
    for name in ["A", "B"] {
        for &x in &names {
            facts.extend((scene >> bit & 1 == 1).then(|| (predicate(name), vec![x])));
            bit += 1;
        }
    }
    for &x in &names {
        for &y in &names {
            facts.extend((scene >> bit & 1 == 1).then(|| (predicate("R"), vec![x, y])));
            bit += 1;
        }
    }
    let holds = |id: PredicateId, row: &[Value]| facts.iter().any(|(other, found)| *other == id && found == row);
    let kept = rules.constraints.iter().all(|constraint| {
        let in_domain = |id: &PredicateId, row: &[Value], test: &dyn Fn(Value) -> bool| {
            let columns = constraint.domain.iter().filter(|(one, _)| one == id);
            columns.into_iter().all(|&(_, column)| test(row[column]))
        };
        facts.iter().all(|(id, row)| match constraint.constraint {
            Constraint::Covering(ref cover) => {
                in_domain(id, row, &|value| cover.iter().any(|&one| holds(one, &[value])))
            }
            Constraint::Reflexive(a) => in_domain(id, row, &|value| holds(a, &[value, value])),
            Constraint::Asymmetric(a) => *id != a || !holds(a, &[row[1], row[0]]),
            Constraint::Disjoint(a, b) => *id != a || !holds(b, row),
            Constraint::Implies(a, b) => *id != a || holds(b, row),
            Constraint::Irreflexive(a) => *id != a || row[0] != row[1],
            Constraint::Symmetric(a) => *id != a || holds(a, &[row[1], row[0]]),
        })
    });
    let database = kept.then(|| naive::evaluate(rules, &symbols, facts))?;
    let rows = |name: &str| {
        (
            predicate(name),
            database[predicate(name).index()].iter().cloned().collect(),
        )
    };
    Some(["P", "S", "T"].map(rows).into())
}

proptest! {
    #![proptest_config(cases(150))]

    #[test]
    fn differences_equal_those_of_exhaustive_search(
        shared in proptest::collection::vec(any::<(u8, u8, u8, u8)>(), 0..4),
        left in proptest::collection::vec(any::<(u8, u8, u8, u8)>(), 0..2),
        right in proptest::collection::vec(any::<(u8, u8, u8, u8)>(), 0..2),
        constraints in 0..128_u8,
    ) {
        let left = rules(&written(&[left, shared.clone()].concat(), constraints));
        let right = rules(&written(&[shared, right].concat(), constraints));
        let found = diff(&left, &right, &Options { entities_max: 2, ..Options::default() }).unwrap();
        // The entities and facts of the smallest counterexample.
        let least = (1..=2_u32).find_map(|entities| {
            let scenes = 0..1_u32 << (2 * entities + entities * entities);
            let differs = |scene: &u32| outputs(&left, entities, *scene) != outputs(&right, entities, *scene);
            scenes.filter(differs).map(u32::count_ones).min().map(|facts| (entities as usize, facts as usize))
        });
        match found {
            Equivalence::Different(difference) => {
                let facts: usize = difference.facts.iter().map(|(_, rows)| rows.len()).sum();
                prop_assert!(difference.smallest);
                prop_assert_ne!(&difference.derived[0], &difference.derived[1]);
                let (entities, least) = least.expect("a difference that exhaustive search does not find");
                prop_assert_eq!(least, facts);
                prop_assert!(difference.entities.len() <= entities);
            }
            Equivalence::NoneFound { entities, .. } => {
                prop_assert_eq!(entities, Some(2));
                prop_assert_eq!(least, None);
            }
            Equivalence::Equivalent { .. } => prop_assert_eq!(least, None),
            Equivalence::NoneTried { .. } => prop_assert!(false, "these rules have a circuit"),
        }
        // A proof also holds for larger scenes: check one entity beyond its bound.
        let proved = diff(&left, &right, &Options { entities_max: 6, ..Options::default() }).unwrap();
        if let Equivalence::Equivalent { entities } = proved {
            for scene in (0..1_u32 << 15).step_by(97) {
                prop_assert_eq!(outputs(&left, 3, scene), outputs(&right, 3, scene), "{:?}", entities);
            }
        }
    }
}

// --- comparison by sampling

fn few() -> Options {
    Options {
        conflicts_max: 20_000,
        ..Options::default()
    }
}

/// Expressions, aggregates, floats, unsigned numbers and texts: sampling finds a small error, and nothing in equal
/// rules.
#[test]
fn expressions_and_aggregates_are_sampled_within_a_bound() {
    let base =
        ".decl A(x: symbol, v: number) .decl F(x: symbol, v: float) .decl U(x: symbol, v: unsigned) .input A, F, U
        .decl P(x: symbol) .output P\n";
    let pairs = [
        (
            "P(x) :- A(x, v), v * 2 > 30.",
            "P(x) :- A(x, v), v + v >= 31.",
            "P(x) :- A(x, v), v * 2 >= 30.",
        ),
        (
            "P(x) :- A(x, _), count : { A(x, _) } > 1.",
            "P(x) :- A(x, v), A(x, w), v != w.",
            "P(x) :- A(x, v), A(y, w), x != y, v != w.",
        ),
        (
            "P(x) :- F(x, v), v > 2.5.",
            "P(x) :- F(x, v), 2.5 < v.",
            "P(x) :- F(x, v), v >= 2.5.",
        ),
        (
            "P(x) :- U(x, v), v / 4 = 2.",
            "P(x) :- U(x, v), v >= 8, v < 12.",
            "P(x) :- U(x, v), v >= 8, v <= 12.",
        ),
        (
            "P(x) :- A(x, v), v > sum w : { A(y, w), y != x }.",
            "P(x) :- A(x, v), n = sum w : { A(y, w), y != x }, n < v.",
            "P(x) :- A(x, v), v > max w : { A(y, w), y != x }.",
        ),
        (
            "P(cat(x, \"!\")) :- A(x, _).",
            "P(y) :- A(x, _), A(x, _), y = cat(x, \"!\").",
            "P(cat(\"!\", x)) :- A(x, _).",
        ),
    ];
    for (one, same, other) in pairs {
        let [one, same, other] = [one, same, other].map(|text| rules(&format!("{base}{text}")));
        let found = diff(&one, &same, &few()).unwrap();
        assert!(
            matches!(
                found,
                Equivalence::NoneTried {
                    facts: Some(1..),
                    entities: 1..,
                    scenes: 1..
                }
            ),
            "{found:?}"
        );
        let Equivalence::Different(found) = diff(&one, &other, &few()).unwrap() else {
            panic!("a difference");
        };
        assert_ne!(found.derived[0], found.derived[1]);
        // The scene is minimal: no fact can be removed, so it has at most three.
        let facts: usize = found.facts.iter().map(|(_, rows)| rows.len()).sum();
        assert!((1..=3).contains(&facts), "{found:?}");
    }
}

/// Renaming variables and exchanging literals, clauses and declarations keeps the meaning. So such a copy is proved
/// equal, whatever the rules compute; an error is not.
#[test]
fn copies_of_expressions_and_aggregates_are_proved_equal() {
    let base = ".decl A(x: symbol, v: number) .input A .decl P(x: symbol, n: number) .output P\n";
    let one = ".decl Q(x: symbol) Q(x) :- A(x, 1); A(x, v), v * 2 > 30.
        P(x, n) :- Q(x), n = count : { A(x, v), v > 0, !Q(cat(x, \"!\")) }, n + 1 < max w : { A(_, w) }.
        P(x, 3) :- A(x, range(1, 5)), (Q(x) ; A(x, 7), n = strlen(x), n > 2).";
    let other = "P(y, 3) :- A(y, range(1, 5)), (Q(y) ; strlen(y) > 2, A(y, 7)).
        P(p, sum) :- sum = count : { A(p, b), b > 0, !Q(cat(p, \"!\")) }, Q(p), sum + 1 < max c : { A(_, c) }.
        .decl Q(z: symbol) Q(z) :- A(z, w), w * 2 > 30; A(z, 1).";
    let compared = |text: &str| {
        let [left, right] = [one, text].map(|text| rules(&format!("{base}{text}")));
        diff(&left, &right, &few()).unwrap()
    };
    assert_eq!(compared(other), Equivalence::Equivalent { entities: None });
    for (from, to) in [
        ("b > 0", "b > 1"),
        ("cat(p, \"!\")", "cat(\"!\", p)"),
        ("range(1, 5)", "range(1, 6)"),
        ("max c", "min c"),
    ] {
        let found = compared(&other.replace(from, to));
        assert!(!matches!(found, Equivalence::Equivalent { .. }), "{from}: {found:?}");
    }
}

/// A file and its formatted copy are proved equal, whatever they contain.
#[test]
fn formatted_copies_are_proved_equal() {
    for folder in [
        "aggregates",
        "arithmetic",
        "heads",
        "logic",
        "recursion",
        "text",
        "types",
    ] {
        for entry in std::fs::read_dir(root().join("tests/corpus").join(folder)).unwrap() {
            let path = entry.unwrap().path();
            let (mut sources, text) = (Sources::new(), std::fs::read_to_string(&path).unwrap());
            let name = path.display().to_string();
            let id = sources.add(&*name, text);
            let copy = sources.add(&*name, datalog::format(&sources, id).unwrap());
            let mut load = |id| datalog::load_with(&mut sources, id, &RuleFiles, InputPolicy::Extensible).rules;
            // Some files show errors.
            let Some(left) = load(id) else { continue };
            let right = load(copy).expect("a copy of a file without errors");
            let options = Options {
                entities_max: 1,
                ..few()
            };
            let found = diff(&left, &right, &options).unwrap();
            assert!(matches!(found, Equivalence::Equivalent { .. }), "{name}: {found:?}");
        }
    }
}

/// Random sampling finds a difference that needs more facts than exhaustive search covers, and minimizes it.
#[test]
fn larger_scenes_are_drawn_at_random() {
    let base = ".decl A(x: symbol) .decl R(x: symbol, y: symbol) .input A, R .decl P(x: symbol) .output P
        .irreflexive R\n";
    let left = rules(&format!(
        "{base}P(x) :- A(x), count : {{ R(x, _) }} >= 3, count : {{ R(_, x) }} >= 1."
    ));
    let right = rules(&format!(
        "{base}P(x) :- A(x), R(x, _), count : {{ R(x, _) }} >= 3, R(_, x), A(_), x = x."
    ));
    let found = diff(&left, &right, &few()).unwrap();
    assert!(matches!(found, Equivalence::NoneTried { .. }), "{found:?}");
    let wrong = rules(&format!("{base}P(x) :- A(x), count : {{ R(x, _) }} >= 3."));
    let Equivalence::Different(found) = diff(&left, &wrong, &few()).unwrap() else {
        panic!("a difference");
    };
    let facts: usize = found.facts.iter().map(|(_, rows)| rows.len()).sum();
    assert_eq!(facts, 4, "{found:?}");
    assert!(
        found
            .facts
            .iter()
            .all(|(name, rows)| name == "A" || rows.iter().all(|row| row[0] != row[1]))
    );
}

/// Sampling agrees with proofs. A clause with an expression makes `diff` sample the same rules.
#[test]
fn sampling_agrees_with_proofs() {
    for (left, right) in [
        ("easy.dl", "medium.dl"),
        ("medium.dl", "hard.dl"),
        ("hard.dl", "transfer-hard.dl"),
    ] {
        let right = shipped(right);
        let with = |more: &str| {
            let text = std::fs::read_to_string(root().join("rules").join(left)).unwrap();
            rules(&format!("{text}\n.scope\n.decl Odd(v: number)\n{more}"))
        };
        let proved = matches!(compare(&with(""), &right), Equivalence::Equivalent { .. });
        let found = diff(&with("Odd(v + 1) :- Odd(v), v < 0. Odd(1)."), &right, &few()).unwrap();
        match found {
            Equivalence::Different(_) => assert!(!proved),
            Equivalence::Equivalent { entities: None } => assert!(proved),
            Equivalence::NoneTried { .. } => {}
            other => panic!("{other:?}"),
        }
    }
}
