//! Rules for other engines: plain programs mean the same.

use crate::cases::cases;
use crate::random_program::{Genome, computing_genomes, genomes, recursive_genomes};
use crate::written_program::program;
use logicity_datalog as datalog;
use logicity_datalog::diag::{Sources, render};
use logicity_datalog::symbol::Symbol;
use logicity_datalog::{BaseType, PredicateId, Program, Session, export, facts};
use proptest::prelude::*;
use std::collections::BTreeMap;
use std::path::Path;

/// The rows of all visible predicates as text.
fn rows(session: &Session) -> BTreeMap<String, String> {
    let predicates = (0..).map(PredicateId).zip(&session.program().rules().predicates);
    let shown = predicates.filter(|(_, predicate)| !predicate.hidden);
    shown
        .map(|(id, predicate)| (predicate.name.clone(), facts::print(session, id)))
        .collect()
}

/// Runs a program and what is written of it on the same facts. Returns whether it could be written.
fn check(genome: &Genome) -> Result<bool, TestCaseError> {
    let rules = genome.rules();
    let text = match export::souffle(&rules) {
        Ok(text) => text,
        Err(faults) => {
            // Infinite constants.
            for fault in faults {
                prop_assert_eq!(fault.message, "plain Soufflé cannot express this constant");
            }
            return Ok(false);
        }
    };
    let plain = Program::parse(&text).map_err(|error| TestCaseError::fail(format!("{text}\n{error}")))?;
    let program = Program::new(rules.clone()).expect("the program is safe and small");
    let (mut one, mut other) = (program.session(), plain.session());
    for batch in genome.batches(&rules) {
        for (present, id, row) in &batch {
            let predicate = &rules.predicates[id.index()];
            let words: Vec<_> = row
                .iter()
                .zip(&predicate.columns)
                .map(|(word, column)| match column.base {
                    BaseType::Symbol => other.intern(rules.symbols.resolve(Symbol(word.0)).unwrap()),
                    _ => *word,
                })
                .collect();
            match present {
                true => {
                    one.insert(*id, row).expect("the row fits");
                    other.insert(&predicate.name, &words).expect("the row fits");
                }
                false => {
                    one.retract(*id, row).expect("the row fits");
                    other.retract(&predicate.name, &words).expect("the row fits");
                }
            }
        }
        one.commit().expect("the program is small");
        other.commit().expect("the program is small");
        prop_assert_eq!(rows(&one), rows(&other), "{}", text);
    }
    Ok(true)
}

proptest! {
    #![proptest_config(cases(300))]

    #[test]
    fn plain_programs_mean_the_same(genome in genomes(1..3)) {
        check(&genome)?;
    }

    #[test]
    fn plain_recursive_programs_mean_the_same(genome in recursive_genomes(1..2)) {
        prop_assume!(check(&genome)?);
    }

    #[test]
    fn plain_programs_with_functors_mean_the_same(genome in computing_genomes(1..3)) {
        check(&genome)?;
    }
}

#[test]
fn everything_is_written_out() {
    let text = "
        #define LIMIT 3
        .type City <: symbol
        .comp Graph<T> { .decl edge(x: T, y: T) .decl path(x: T, y: T)
            path(x, y) :- edge(x, y). path(x, z) :- path(x, y), edge(y, z). }
        .init roads = Graph<City>
        .input roads.edge(filename=\"my roads.csv\", delimiter=\",\", headers=true)
        .decl same(x: City, y: City) eqrel
        same(x, y) :- roads.path(x, y), roads.path(y, x).
        .decl far(x: City, n: number)
        far(x, n) :- roads.edge(x, _), n = count : { roads.path(x, _) }, n >= LIMIT.
        far(x, n + 1) :- far(x, n), n < 2 * LIMIT; roads.edge(x, \"a\"), n = 1.
        .decl two(n: number) inline
        two(2).
        .decl even(n: number) even(0). even(n + m) :- even(n), two(m), n < 9, !(n = 4).
        .output far(IO=jsonfile, format=object)
        .output roads.path
        .printsize even
    ";
    let plain = export::souffle(program(text).rules()).expect("Soufflé has all of it");
    for absent in [".comp", ".init", "#define", "eqrel", "inline", "City", ";"] {
        assert!(!plain.contains(absent), "{absent}\n{plain}");
    }
    for present in [
        ".input roads_edge(IO=\"file\", filename=\"my roads.csv\", delimiter=\",\", headers=\"true\")\n",
        ".output far(IO=\"jsonfile\", filename=\"far.json\", format=\"object\")\n",
        ".output roads_path(IO=\"file\", filename=\"roads.path.csv\")\n",
        ".printsize even\n",
    ] {
        assert!(plain.contains(present), "{present}\n{plain}");
    }
    let (mut one, mut other) = (program(text).session(), program(&plain).session());
    for (x, y) in [("a", "b"), ("b", "c"), ("c", "a"), ("c", "d"), ("d", "e")] {
        one.insert("roads.edge", (x, y)).unwrap();
        other.insert("roads_edge", (x, y)).unwrap();
    }
    one.commit().unwrap();
    other.commit().unwrap();
    let renamed = rows(&one)
        .into_iter()
        .map(|(name, rows)| (name.replace('.', "_"), rows));
    let (expected, found) = (renamed.collect::<BTreeMap<_, _>>(), rows(&other));
    for (name, rows) in expected {
        assert_eq!(found.get(&name), Some(&rows), "{name}\n{plain}");
    }
}

#[test]
fn what_others_lack_is_refused_at_its_place() {
    let text = "
.type P = [n: number]
.decl e(x: number, y: number)
.input e
.decl p(a: P)
p([x]) :- e(x, _).
.decl one(x: number, y: number) choice-domain x
one(x, y) :- e(x, y).
.decl past(x: number)
past(x) :- once[1,2] e(x, _).
.decl cast(x: symbol)
cast(as(x, symbol)) :- e(x, _).
";
    let mut sources = Sources::new();
    let entry = sources.add("test.dl", text);
    let rules = datalog::load(&mut sources, entry, &|_: &Path| unreachable!())
        .rules
        .unwrap();
    for faults in [export::souffle(&rules).unwrap_err(), export::sql(&rules).unwrap_err()] {
        let drawn = render(&faults, &sources, false);
        for part in [
            "the records of `p`",
            "which row `one` chooses",
            "temporal operators",
            "`as`",
            "test.dl:12:6",
        ] {
            assert!(drawn.contains(part), "{part}\n{drawn}");
        }
    }
    let only_sql = [
        ("q(x, y) :- e(x, y). q(x, z) :- q(x, y), q(y, z).", "reads `q` twice"),
        (
            "q(x, y) :- e(x, y), r(x). r(x) :- q(x, _). r(1).",
            "recursion of `q` and `r` through each other",
        ),
        ("q(x, x / y) :- e(x, y).", "`/` here"),
        ("q(x, strlen(y)) :- e(x, _), y = to_string(x).", "`strlen` here"),
        ("q(x, x) :- e(x, _), match(\"a.*\", to_string(x)).", "`match`"),
    ];
    for (clauses, message) in only_sql {
        let text = format!(
            ".decl e(x: number, y: number)\n.input e\n.decl q(x: number, y: number)\n.decl r(x: number)\n{clauses}\n"
        );
        let program = program(&text);
        assert!(export::souffle(program.rules()).is_ok(), "{clauses}");
        let faults = export::sql(program.rules()).expect_err(clauses);
        assert!(
            faults.iter().any(|fault| fault.message.contains(message)),
            "{clauses}: {faults:?}"
        );
        assert!(faults.iter().all(|fault| fault.primary.is_some()), "{clauses}");
    }
}

#[test]
fn operands_keep_their_sign_and_zero_divides_nothing() {
    let text = ".decl p(x: number, y: number) .input p
        .decl q(x: number) q(z) :- p(x, y), z = (-2 ^ 2) + x / y.
        .decl r(x: number) r(z) :- p(_, y), z = (0 - 3) % y, y > -9, z != -2 ^ y.";
    let plain = export::souffle(program(text).rules()).expect("Soufflé has all of it");
    let (one, other) = (program(text), Program::parse(&plain).expect(&plain));
    let answers = [one, other].map(|program| {
        let mut session = program.session();
        for row in [(7, 0), (7, 2), (-8, -3)] {
            session.insert("p", row).expect("a row");
        }
        session.commit().expect("small");
        rows(&session)
    });
    assert_eq!(answers[0], answers[1], "{plain}");
    assert!(plain.contains("!= 0, "), "{plain}");
}

#[test]
fn long_expressions_are_refused() {
    let steps = |count: usize| {
        let steps: Vec<String> = (1..count).map(|at| format!(", a{at} = a{0} + a{0}", at - 1)).collect();
        format!(
            ".decl q(x: number) .input q .decl p(x: number) p(a{}) :- q(a0){}.",
            count - 1,
            steps.concat()
        )
    };
    let message = |count| export::sql(program(&steps(count)).rules()).map_err(|faults| faults[0].message.clone());
    assert!(message(6).is_ok());
    assert_eq!(
        message(64).unwrap_err(),
        "SQL cannot express an expression of this length"
    );
}
