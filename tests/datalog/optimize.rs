//! The optimizer preserves answers and firings, and its lints are correct.

use crate::cases::cases;
use crate::random_program::{genomes, recursive_genomes};
use crate::root::root;
use crate::rule_files::RuleFiles;
use logicity_datalog as datalog;
use logicity_datalog::codes;
use logicity_datalog::diag::{Diagnostic, Sources, render};
use logicity_datalog::{ClauseId, Constraint, DeclaredConstraint, PredicateId, Rules, Value};
use logicity_datalog::{Options, Program, Session, constraints, naive, optimize};
use proptest::prelude::*;
use std::collections::BTreeSet;

fn rules(text: &str) -> (Sources, Rules) {
    let mut sources = Sources::new();
    let entry = sources.add("test.dl", text);
    let loaded = datalog::load(&mut sources, entry, &RuleFiles);
    let rendered = render(&loaded.diagnostics, &sources, false);
    let rules = loaded.rules.unwrap_or_else(|| panic!("{rendered}\n{text}"));
    (sources, rules)
}

fn holds(
    constraint: &DeclaredConstraint,
    facts: &BTreeSet<(PredicateId, Vec<Value>)>,
    id: PredicateId,
    row: &[Value],
) -> bool {
    let has = |id: PredicateId, row: &[Value]| facts.contains(&(id, row.to_vec()));
    let columns = constraint.domain.iter().filter(|(one, _)| *one == id);
    let mut values = columns.map(|&(_, column)| row[column]);
    match constraint.constraint {
        Constraint::Covering(ref cover) => values.all(|value| cover.iter().any(|&one| has(one, &[value]))),
        Constraint::Reflexive(a) => values.all(|value| has(a, &[value, value])),
        Constraint::Asymmetric(a) => id != a || !has(a, &[row[1], row[0]]),
        Constraint::Disjoint(a, b) => id != a || !has(b, row),
        Constraint::Implies(a, b) => id != a || has(b, row),
        Constraint::Irreflexive(a) => id != a || row[0] != row[1],
        Constraint::Symmetric(a) => id != a || has(a, &[row[1], row[0]]),
    }
}

/// The largest subset of the facts that satisfies the constraints.
fn kept(rules: &Rules, mut facts: BTreeSet<(PredicateId, Vec<Value>)>) -> BTreeSet<(PredicateId, Vec<Value>)> {
    loop {
        let bad: Vec<_> = facts
            .iter()
            .filter(|(id, row)| {
                !rules
                    .constraints
                    .iter()
                    .all(|constraint| holds(constraint, &facts, *id, row))
            })
            .cloned()
            .collect();
        if bad.is_empty() {
            return facts;
        }
        bad.iter().for_each(|one| _ = facts.remove(one));
    }
}

/// All rows, and the rows that each clause derives.
type Answer = (naive::Database, Vec<Vec<Vec<Value>>>);

fn answer(session: &Session) -> Answer {
    let rules = session.program().rules();
    let rows = |id: u32| session.encoded_rows(PredicateId(id)).map(<[Value]>::to_vec).collect();
    let fired = |clause: u32| session.fired(ClauseId(clause));
    (
        (0..rules.predicates.len() as u32).map(rows).collect(),
        (0..rules.clauses.len() as u32).map(fired).collect(),
    )
}

fn check(rules: &Rules, facts: &BTreeSet<(PredicateId, Vec<Value>)>, constraints: bool) -> Result<(), TestCaseError> {
    let modes = [
        Options {
            optimize: false,
            constraints: false,
        },
        Options {
            optimize: true,
            constraints: false,
        },
        Options {
            optimize: true,
            constraints,
        },
    ];
    for options in modes {
        let mut session = Program::with(rules.clone(), options).unwrap().session();
        // Two batches, to test maintenance, too.
        for part in [0, 1] {
            for (number, (id, row)) in facts.iter().enumerate() {
                if number % 2 == part {
                    session.insert(*id, row).unwrap();
                }
            }
            if part == 1 || !constraints {
                session.commit().unwrap();
            }
        }
        let database = naive::evaluate(rules, session.symbols(), facts.iter().cloned());
        let (rows, fired) = answer(&session);
        prop_assert_eq!(&rows, &database, "{:?}", options);
        for (clause, fired) in rules.clauses.iter().zip(&fired) {
            prop_assert!(
                fired.iter().eq(&naive::consequences(
                    session.program().rules(),
                    clause,
                    session.symbols(),
                    &database
                )),
                "{:?}",
                options
            );
        }
        if constraints {
            prop_assert!(constraints::violations(&session).is_empty());
        }
    }
    Ok(())
}

const BASE: &str = ".decl A, B, C(x: symbol) .decl R, S(x: symbol, y: symbol) .input A, B, C, R, S
    .decl P(x: symbol) .decl T(x: symbol, y: symbol) .decl Q(x: symbol) .output P, T, Q\n";

const CONSTRAINTS: [&str; 12] = [
    ".disjoint A, B",
    ".implies C, A",
    ".implies C, B",
    ".irreflexive R",
    ".symmetric R",
    ".implies S, R",
    ".disjoint R, S",
    ".implies A, C",
    ".irreflexive S",
    ".covering A, B",
    ".asymmetric S",
    REFLEXIVE,
];

const REFLEXIVE: &str = ".reflexive R";

/// Makes rules over those predicates from small numbers.
fn written(clauses: &[Vec<u8>], constraints: u16) -> String {
    let mut text = BASE.to_owned();
    for (bit, constraint) in CONSTRAINTS.iter().enumerate() {
        if constraints >> bit & 1 == 1 {
            text += constraint;
            text.push('\n');
        }
    }
    let variable = |gene: u8| ["x", "y", "z"][gene as usize % 3];
    for genes in clauses {
        let mut body: Vec<String> = vec!["A(x)".into(), "R(x, y)".into(), "S(y, z)".into()];
        body.rotate_left(genes[0] as usize % 3);
        body.truncate(genes[0] as usize / 3 % 4);
        for pair in genes[1..].chunks(2) {
            let (kind, terms) = (pair[0], *pair.last().unwrap());
            let (a, b) = (variable(terms), variable(terms / 3));
            let not = if kind >= 160 { "!" } else { "" };
            body.push(match kind % 11 {
                0 => format!("{not}A({a})"),
                1 => format!("{not}B({a})"),
                2 => format!("{not}C({a})"),
                3 | 4 => format!("{not}R({a}, {b})"),
                5 | 6 => format!("{not}S({a}, {b})"),
                7 => format!("{not}R({a}, _)"),
                8 => format!("{a} {} {b}", ["=", "!=", "<", "<=", ">", ">="][terms as usize % 6]),
                9 => format!("{not}S(_, {a})"),
                _ => format!("T({a}, {b})"),
            });
        }
        let head = ["P(x)", "T(x, y)", "T(y, x)", "Q(x)"][genes[0] as usize % 4];
        if head == "Q(x)" {
            body.push("!P(x)".into());
        }
        let all = format!("{head} {}", body.join(" "));
        for name in ["x", "y", "z"] {
            let names = |text: &str| text.split(|c: char| !c.is_alphanumeric()).any(|word| word == name);
            let bound = body
                .iter()
                .any(|one| !one.starts_with('!') && one.contains('(') && names(one));
            if names(&all) && !bound {
                body.push(format!("A({name})"));
            }
        }
        text += &format!("{head} :- {}.\n", body.join(", "));
    }
    text
}

proptest! {
    #![proptest_config(cases(400))]

    #[test]
    fn slow_constraints_change_no_answer_for_facts_that_satisfy_them(
        clauses in proptest::collection::vec(proptest::collection::vec(any::<u8>(), 3..10), 1..5),
        constraints in 0..4096_u16,
        facts in proptest::collection::vec((0..5_u8, 0..3_u8, 0..3_u8), 0..24),
    ) {
        let (_, rules) = rules(&(written(&clauses, constraints) + "P(\"a\") :- A(\"b\"), R(\"c\", \"c\").\n"));
        let names = ["a", "b", "c"].map(|name| (0..rules.symbols.len() as u32)
            .map(Value)
            .find(|value| rules.symbols.resolve(logicity_datalog::symbol::Symbol(value.0)) == Some(name))
            .unwrap());
        // Symmetric facts come in pairs and reflexive ones with loops, so that some remain.
        let loops = rules.constraints.iter().any(|one| matches!(one.constraint, Constraint::Reflexive(_)));
        let loops = names.into_iter().filter(|_| loops).map(|name| (rules.predicate("R").unwrap(), vec![name; 2]));
        let facts: BTreeSet<(PredicateId, Vec<Value>)> = facts.iter().flat_map(|&(id, x, y)| {
            let predicate = rules.predicate(["A", "B", "C", "R", "S"][id as usize]).unwrap();
            let (x, y) = (names[x as usize], names[y as usize]);
            if id < 3 { vec![(predicate, vec![x])] } else { vec![(predicate, vec![x, y]), (predicate, vec![y, x])] }
        }).chain(loops).collect();
        check(&rules, &kept(&rules, facts), true)?;
    }

    #[test]
    fn slow_optimizing_without_constraints_changes_nothing(
        genome in genomes(1..2),
        recursive in recursive_genomes(1..2),
    ) {
        for genome in [genome, recursive] {
            let rules = genome.rules();
            let mut facts = BTreeSet::new();
            for (present, id, row) in genome.batch(&rules, 0) {
                if present { facts.insert((id, row)); } else { facts.remove(&(id, row)); }
            }
            check(&rules, &facts, false)?;
        }
    }
}

// --- work

fn with(rules: &Rules, optimize: bool) -> Program {
    let constraints = false;
    Program::with(rules.clone(), Options { optimize, constraints }).unwrap()
}

/// Inserts the facts of a city of 1,000 agents that each see some others. Also returns one in a hundred of the binary
/// facts.
fn insert_city(session: &mut Session) -> Vec<(PredicateId, Vec<Value>)> {
    let program = session.program().clone();
    let inputs = program
        .rules()
        .predicates
        .iter()
        .zip((0..).map(PredicateId))
        .filter(|(predicate, _)| predicate.input);
    let (unary, binary): (Vec<_>, Vec<_>) = inputs.partition(|(predicate, _)| predicate.arity() == 1);
    let agents: Vec<Value> = (0..1000).map(|agent| session.intern(&format!("a{agent}"))).collect();
    let mut state = 3_u64;
    let mut random = |below: u64| {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) % below
    };
    let mut moving = Vec::new();
    for (position, &x) in agents.iter().enumerate() {
        for &(_, id) in &unary {
            if random(4) == 0 {
                session.insert(id, [x]).unwrap();
            }
        }
        for _ in 0..14 {
            let y = agents[(position + random(60) as usize) % agents.len()];
            for (predicate, id) in &binary {
                if predicate.name == "Sees" || random(6) == 0 {
                    session.insert(*id, [x, y]).unwrap();
                    if random(100) == 0 {
                        moving.push((*id, vec![x, y]));
                    }
                }
            }
        }
    }
    moving
}

/// Simplified clauses scan no more rows, neither in the first commit nor from tick to tick.
#[test]
fn simplified_rules_scan_no_more_rows() {
    let files = [
        "rules/easy.dl",
        "rules/medium.dl",
        "rules/hard.dl",
        "rules/expert.dl",
        "rules/transfer-medium.dl",
        "rules/vap-easy.dl",
        "rules/vap-hard.dl",
        "tests/fixtures/rules/traffic-code.dl",
    ];
    for file in files {
        let text = std::fs::read_to_string(root().join(file)).unwrap();
        let (_, rules) = rules(&text);
        let rows_scanned = |optimize| {
            let mut session = with(&rules, optimize).session();
            let moving = insert_city(&mut session);
            let mut counts = Vec::new();
            for step in 0..3 {
                for (id, row) in moving.iter().filter(|_| step > 0) {
                    match step {
                        1 => session.retract(*id, row).unwrap(),
                        _ => session.insert(*id, row).unwrap(),
                    }
                }
                session.commit().unwrap();
                let works = session.work().strata.iter().filter_map(|work| work.work());
                counts.push(works.map(|work| work.rows_scanned() + work.given_up).sum::<u64>());
            }
            counts
        };
        for (simplified, written) in rows_scanned(true).iter().zip(&rows_scanned(false)) {
            assert!(simplified * 20 <= written * 21, "{file}: {simplified} of {written}");
        }
    }
}

/// All pairs of comparisons of two values, in both orders, and of a value with a number.
#[test]
fn pairs_of_comparisons_are_simplified() {
    let ops = ["=", "!=", "<", "<=", ">", ">="];
    let mut text = ".decl N(x: number) .input N .decl P(x: number, y: number) .output P\n".to_owned();
    for one in ops {
        for other in ops {
            for sides in [
                "x {1} y, x {2} y",
                "x {1} y, y {2} x",
                "x {1} 1, y {2} 1",
                "x {1} 1, 1 {2} x",
                "1 {1} 2, x {2} y",
            ] {
                let body = sides.replace("{1}", one).replace("{2}", other);
                text += &format!("P(x, y) :- N(x), N(y), {body}.\n");
            }
        }
    }
    let (_, rules) = rules(&text);
    let number = rules.predicate("N").unwrap();
    let facts = [0, 1, 2].map(|value| (number, vec![Value::number(value)])).into();
    check(&rules, &facts, true).unwrap();
}

// --- lints

fn lints(text: &str) -> Vec<Diagnostic> {
    let (sources, rules) = rules(text);
    optimize::lints(&rules, &sources).diagnostics
}

fn city(clauses: &str) -> String {
    format!(".include \"vocabulary.dl\"\n{clauses}")
}

#[test]
fn the_simpler_form_is_suggested() {
    let found = lints(&city(
        "Stop(X) :- IsCar(X), IsBus(X), Not(IsPedestrian(X)), NextTo(X, Y), NextTo(Y, X), X != Y.",
    ));
    let codes: Vec<&str> = found.iter().map(|lint| lint.code.name()).collect();
    assert_eq!(codes, ["redundant-literal"; 4], "{found:?}");
    assert!(
        found[0].help[0].contains("`Stop(X) :- IsBus(X), NextTo(X, Y).`"),
        "{found:?}"
    );
}

/// Under a scope, a separate predicate has the same view only if its first variable is the same agent.
#[test]
fn repeated_bodies_are_reported() {
    let three = |part: &str| {
        let clause = |head: &str, more: &str| format!("{head}(X) :- {part}, {more}(X).\n");
        lints(&city(
            &(clause("Stop", "IsBus") + &clause("Slow", "IsTiro") + &clause("Fast", "IsPolice")),
        ))
    };
    let found = three("IsClose(X, Y), IsOld(Y), LeftOf(Y, X)");
    assert_eq!(
        found.iter().map(|lint| lint.code).collect::<Vec<_>>(),
        [codes::REPEATED_BODY]
    );
    assert!(
        found[0].help[0].contains("`Name(X) :- IsClose(X, Y), IsOld(Y), LeftOf(Y, X).`"),
        "{found:?}"
    );
    assert_eq!(three("IsClose(Z, Y), IsOld(Y), LeftOf(Y, Z)"), []);
    assert_eq!(three("IsClose(X, Y), IsOld(Y)"), []);
}

#[test]
fn contradictions_are_reported_and_never_evaluated() {
    let text = city("Slow(X) :- IsBus(X), IsClose(X, Y), IsOld(X).\nFast(X) :- IsTiro(X), NextTo(X, X).");
    let found = lints(&text);
    assert_eq!(
        found.iter().map(|lint| lint.code).collect::<Vec<_>>(),
        [codes::CONTRADICTORY_BODY; 2]
    );
    let (_, rules) = rules(&text);
    let program = Program::with(
        rules,
        Options {
            optimize: true,
            constraints: true,
        },
    )
    .unwrap();
    let mut session = program.session();
    let me = session.intern("me");
    for name in ["IsBus", "IsCar"] {
        session.insert(program.predicate(name).unwrap(), [me]).unwrap();
    }
    session.commit().unwrap();
    assert!(session.is_empty(program.predicate("Slow").unwrap()));
}

#[test]
fn clauses_that_others_cover_under_the_constraints_are_reported_and_not_run() {
    let text =
        city("Stop(X) :- IsAtInter(X), IsClose(X, Y), IsCar(Y).\nStop(X) :- IsClose(Y, X), IsBus(Y), IsAtInter(X).");
    let found = lints(&text);
    assert_eq!(
        found.iter().map(|lint| lint.code).collect::<Vec<_>>(),
        [codes::SUBSUMED_CLAUSE]
    );

    let (_, rules) = rules(&text);
    let derived = |constraints| {
        let program = Program::with(
            rules.clone(),
            Options {
                optimize: true,
                constraints,
            },
        )
        .unwrap();
        let mut session = program.session();
        let [x, y] = ["x", "y"].map(|name| session.intern(name));
        let mut insert = |name: &str, row: &[Value]| session.insert(program.predicate(name).unwrap(), row).unwrap();
        for (name, rows) in [("IsAtInter", vec![x]), ("IsCar", vec![y]), ("IsBus", vec![y])] {
            insert(name, &rows);
        }
        for row in [[x, y], [y, x]] {
            insert("IsClose", &row);
            insert("Sees", &row);
        }
        session.commit().unwrap();
        assert_eq!(session.len(program.predicate("Stop").unwrap()), 1);
        let clauses = session.program().rules().clauses.iter().zip(0..);
        let stop = program.predicate("Stop").unwrap();
        let fired = clauses.filter(|(clause, _)| clause.head.predicate == stop);
        assert_eq!(
            fired
                .map(|(_, id)| session.fired(ClauseId(id)).len())
                .collect::<Vec<_>>(),
            [1, 1]
        );
        session.work().strata[0].work().map_or(0, |work| work.derived())
    };
    assert_eq!((derived(false), derived(true)), (2, 1));
}

/// The lints of the paper's clauses: the known repetitions, and no contradiction.
#[test]
fn the_shipped_rules_have_no_contradiction() {
    for name in [
        "easy",
        "medium",
        "hard",
        "expert",
        "transfer-medium",
        "vap-easy",
        "vap-hard",
    ] {
        let found = lints(&std::fs::read_to_string(root().join(format!("rules/{name}.dl"))).unwrap());
        assert!(
            found.iter().all(|lint| lint.code == codes::REDUNDANT_LITERAL),
            "{name}: {found:?}"
        );
    }
}

/// The search for clauses that others cover compares a clause only with those that have all of its traits.
#[test]
fn searching_twice_the_clauses_takes_little_more_than_twice_the_steps() {
    let kinds = ["IsCar", "IsBus", "IsPedestrian", "IsOld"];
    let program = |count: usize| {
        let clause = |at: usize| {
            let (kind, speed) = (kinds[at % 4], at / 2);
            format!("Stop(X) :- IsTiro(X), NextTo(Y, X), {kind}(Y), Action(X, {speed}).\n")
        };
        let speed = ".decl Action(x: agent, v: number)\n.input Action\n";
        city(&format!("{speed}{}", (0..count).map(clause).collect::<String>()))
    };
    let [one, two] = [1_000, 2_000].map(|count| {
        let (sources, rules) = rules(&program(count));
        let lints = optimize::lints(&rules, &sources);
        let covered = lints
            .diagnostics
            .iter()
            .filter(|lint| lint.code == codes::SUBSUMED_CLAUSE);
        assert_eq!(covered.count(), count / 2, "a bus is a car, an old agent a pedestrian");
        assert_eq!(lints.unfinished, [""; 0]);
        lints.steps
    });
    assert!(one > 1_000 && two < one * 5 / 2, "{one} and {two} steps");
}

/// The search ends at its limit: it looks for a closed walk of nine steps in a graph whose closed walks have even
/// length.
#[test]
fn incomplete_searches_are_reported() {
    let graph: Vec<String> = (0..4)
        .flat_map(|a| (0..4).map(move |b| format!("NextTo(A{a}, B{b})")))
        .collect();
    let walk: Vec<String> = (0..9).map(|at| format!("NextTo(C{at}, C{})", (at + 1) % 9)).collect();
    let text = city(&format!(
        "Stop(A0) :- IsTiro(A0), {}.\nStop(C0) :- {}.\n",
        graph.join(", "),
        walk.join(", ")
    ));
    let (sources, rules) = rules(&text);
    let lints = optimize::lints(&rules, &sources);
    assert_eq!(lints.unfinished, ["clauses that others cover under the constraints"]);
}
