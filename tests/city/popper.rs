//! The reader of Popper's tasks, and clauses learned from them.
//!
//! An independent evaluation checks what the learner says: the Datalog engine derives the target from all facts of the
//! task and the learned clauses.

use crate::popper_tasks::{TARGETS, Texts, family, pieces, trains};
use logicity::cancel::Cancel;
use logicity::datalog::{Limits, PredicateId, Program};
use logicity::diag::{Diagnostic, Sources, render};
use logicity::files::read_text;
use logicity::induce::{ActionRules, Atom, Body, LITERAL_COST, Link, Literal, Noise, Settings, VARIABLE_NAMES};
use logicity::popper::{Files, Options, Solution, Task, read};
use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

fn parse(texts: &[impl AsRef<str>; 3], options: &Options) -> (Option<Task>, Vec<Diagnostic>, Sources) {
    let mut sources = Sources::new();
    let [background, examples, bias] = ["bk.pl", "exs.pl", "bias.pl"]
        .iter()
        .zip(texts)
        .map(|(name, text)| sources.add(*name, text.as_ref()))
        .collect::<Vec<_>>()
        .try_into()
        .unwrap();
    let files = Files {
        background,
        examples,
        bias,
    };
    let (task, diagnostics) = read(&sources, &files, options);
    (task, diagnostics, sources)
}

/// Reads a task without errors.
fn task(texts: &[impl AsRef<str>; 3]) -> Task {
    let (task, diagnostics, sources) = parse(texts, &Options::default());
    task.unwrap_or_else(|| panic!("{}", render(&diagnostics, &sources, false)))
}

/// A task of the fixtures.
fn fixture(name: &str) -> Texts {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/fixtures/popper")
        .join(name);
    ["bk.pl", "exs.pl", "bias.pl"].map(|file| fs::read_to_string(folder.join(file)).unwrap())
}

fn solve(task: &Task, settings: &Settings) -> Solution {
    task.solve(|_| true, settings, &|_| (), &Cancel::never())
}

fn learned(task: &Task, settings: &Settings) -> ActionRules {
    let solution = solve(task, settings);
    assert_eq!(solution.rules.uncovered, 0, "{:?}", task.clauses(&solution.rules));
    assert!(!solution.is_cut);
    solution.rules
}

/// Returns the rows of the target that the program of a task derives.
fn derived(task: &Task, rules: &ActionRules) -> BTreeSet<Vec<String>> {
    let learned = task.program(rules);
    let text = learned.declarations + &learned.clauses.join("\n");
    let mut sources = Sources::new();
    let entry = sources.add("learned.dl", text);
    let (program, diagnostics) = Program::load(&mut sources, entry, &read_text);
    let program = program.unwrap_or_else(|| panic!("{}", render(&diagnostics, &sources, false)));
    let mut session = program.session();
    session.commit().unwrap();
    let predicates = &program.rules().predicates;
    let (_, target) = predicates
        .iter()
        .zip((0..).map(PredicateId))
        .find(|(predicate, _)| predicate.output)
        .unwrap();
    let names = session.symbols();
    let text = |value: &logicity::datalog::Value| names.resolve(logicity::symbol::Symbol(value.0)).unwrap().to_owned();
    session
        .encoded_rows(target)
        .map(|row| row.iter().map(text).collect())
        .collect()
}

/// Asserts that clauses derive the target for exactly the positive examples among all examples, and that the task says
/// the same about them.
fn explain_the_examples(task: &Task, rules: &ActionRules) {
    let derived = derived(task, rules);
    let said: Vec<Vec<bool>> = rules.clauses.iter().map(|clause| task.holds(&clause.body)).collect();
    for (number, case) in task.cases.iter().enumerate() {
        let found = derived.contains(&case.arguments);
        let clauses = task.clauses(rules);
        assert_eq!(found, case.is_positive, "{:?}\n{clauses:#?}", case.arguments);
        assert_eq!(said.iter().any(|said| said[number]), found, "{:?}", case.arguments);
    }
}

#[test]
fn the_fixtures_have_these_solutions() {
    for (name, expected) in [
        (
            "family",
            &[
                "grandmother(X, Y) :- mother(X, Z), mother(Z, Y).",
                "grandmother(X, Y) :- mother(X, Z), father(Z, Y).",
            ][..],
        ),
        ("roads", &["served(X) :- reach(X, Y), station(Y), large(X)."]),
        ("trains", &["east(X) :- has_car(X, Y), closed(Y), short(Y)."]),
    ] {
        let task = task(&fixture(name));
        let rules = learned(&task, &task.settings());
        assert_eq!(task.clauses(&rules), expected, "{name}");
        explain_the_examples(&task, &rules);
    }
}

#[test]
fn learned_clauses_explain_random_tasks() {
    for target in 0..TARGETS {
        for (seed, texts) in [trains(1, target, 40), pieces(2, target, 40), family(3, target, 40)]
            .iter()
            .enumerate()
        {
            let task = task(texts);
            for negation in [false, true] {
                let variables = if seed == 2 { 3 } else { 4 };
                // With negations, a short search for each clause keeps the test fast.
                let nodes = if negation { 200 } else { task.settings().nodes };
                let settings = Settings {
                    variables,
                    negation,
                    nodes,
                    ..task.settings()
                };
                let rules = learned(&task, &settings);
                let clauses = task.clauses(&rules);
                assert!(
                    negation || clauses.iter().all(|clause| !clause.contains("\\+")),
                    "{clauses:?}"
                );
                explain_the_examples(&task, &rules);
            }
        }
    }
}

/// Checks on the text that each literal follows those that bind its variables, from those of the head on.
#[test]
fn clauses_are_linked_as_directions_say() {
    let texts = pieces(4, 0, 40);
    let task = task(&texts);
    let settings = Settings {
        negation: true,
        nodes: 200,
        ..task.settings()
    };
    for clause in task.clauses(&learned(&task, &settings)) {
        let body = clause.trim_end_matches('.').split_once(" :- ").unwrap().1;
        let literals: Vec<&str> = body
            .split_inclusive(')')
            .map(|literal| literal.trim_matches([',', ' ']))
            .collect();
        let mut bound = BTreeSet::from([VARIABLE_NAMES[0]]);
        for literal in literals.iter().filter(|literal| !literal.is_empty()) {
            let (name, arguments) = literal.rsplit_once('(').unwrap();
            let arguments: Vec<&str> = arguments.trim_end_matches(')').split(", ").collect();
            let is_bound = match name.starts_with("\\+") {
                true => arguments.iter().all(|variable| bound.contains(variable)),
                false => bound.contains(arguments[0]),
            };
            assert!(is_bound, "{literal} in {clause}");
            bound.extend(arguments);
        }
    }
}

/// Returns the least cost of a linked clause without negations that explains all examples of a task alone, by trying all
/// clauses of up to four literals over three variables.
fn exhaustive(task: &Task) -> Option<u32> {
    let vocabulary = task.vocabulary();
    let atoms = vocabulary.atoms(3);
    // For each example and each assignment of constants to the two other variables, the true atoms.
    let facts: Vec<BTreeSet<Vec<&str>>> = (0..vocabulary.predicates().len())
        .map(|predicate| task.facts(predicate).collect())
        .collect();
    let inputs = |predicate: usize, arity: usize| match vocabulary.links().unwrap()[predicate] {
        Link::Any => panic!("the tasks have directions"),
        Link::Inputs(inputs) => (0..arity).filter(move |at| inputs >> at & 1 == 1),
    };
    let rows: Vec<(bool, BTreeSet<u64>)> = (task.cases.iter())
        .map(|case| {
            // The constants to which directions lead.
            let mut reached = BTreeSet::from([case.arguments[0].as_str()]);
            for _ in 0..2 {
                let all = facts
                    .iter()
                    .enumerate()
                    .flat_map(|(at, rows)| rows.iter().map(move |row| (at, row)));
                let linked = all.filter(|(at, row)| inputs(*at, row.len()).all(|input| reached.contains(row[input])));
                let more: Vec<&str> = linked.flat_map(|(_, row)| row.iter().copied()).collect();
                reached.extend(more);
            }
            let constants: Vec<&str> = reached.into_iter().collect();
            let row = |number: usize| {
                let binding = [
                    case.arguments[0].as_str(),
                    constants[number % constants.len()],
                    constants[number / constants.len()],
                ];
                let is_true = |atom: &Atom| {
                    let arguments: Vec<&str> = atom.arguments.iter().map(|&at| binding[usize::from(at)]).collect();
                    facts[atom.predicate].contains(&arguments)
                };
                (atoms.iter().enumerate()).fold(0, |row, (at, atom)| row | u64::from(is_true(atom)) << at)
            };
            (
                case.is_positive,
                (0..constants.len() * constants.len()).map(row).collect(),
            )
        })
        .collect();
    let is_linked = |chosen: &[usize]| {
        let mut bound = BTreeSet::from([0]);
        let mut left: Vec<&Atom> = chosen.iter().map(|&at| &atoms[at]).collect();
        while let Some(at) = (left.iter())
            .position(|atom| inputs(atom.predicate, atom.arguments.len()).all(|at| bound.contains(&atom.arguments[at])))
        {
            bound.extend(left.remove(at).arguments.iter().copied());
        }
        left.is_empty() && chosen.iter().any(|&at| atoms[at].arguments.contains(&0))
    };
    let explains = |chosen: &[usize]| {
        let clause = chosen.iter().fold(0, |clause, &at| clause | 1_u64 << at);
        (rows.iter()).all(|(is_positive, rows)| rows.iter().any(|row| row & clause == clause) == *is_positive)
    };
    let cost = |chosen: &[usize]| {
        let literals = chosen.iter().map(|&at| Literal {
            is_negated: false,
            atom: atoms[at].clone(),
        });
        Body::normalized(literals.collect(), vocabulary).cost(vocabulary)
    };
    let mut level: Vec<Vec<usize>> = vec![Vec::new()];
    let mut least = None;
    for _ in 0..4 {
        let longer = |chosen: Vec<usize>| {
            let first = chosen.last().map_or(0, |last| last + 1);
            (first..atoms.len()).map(move |at| [chosen.as_slice(), &[at]].concat())
        };
        level = level.into_iter().flat_map(longer).collect();
        let explaining = level.iter().filter(|chosen| is_linked(chosen) && explains(chosen));
        least = explaining.map(|chosen| cost(chosen)).chain(least).min();
    }
    least
}

#[test]
fn no_single_clause_is_cheaper() {
    let mut found = 0;
    for seed in 0..5 {
        for texts in [trains(seed, 2, 30), pieces(seed, 2, 30)] {
            let task = task(&texts);
            let solution = solve(&task, &task.settings());
            let clauses = solution.rules.clauses.iter();
            let cost: u32 = clauses
                .map(|clause| clause.body.cost(task.vocabulary()) + LITERAL_COST)
                .sum();
            if let Some(least) = exhaustive(&task) {
                found += 1;
                assert!(cost <= least + LITERAL_COST, "{:?}", task.clauses(&solution.rules));
            }
        }
    }
    assert!(found > 4, "{found} tasks have a solution of one clause");
}

#[test]
fn equal_constants_of_different_types_are_different() {
    // Only the number of wheels, which is the name of a train, would lead to the other color.
    let texts = [
        "wheels(1,2). color(2,red). color(1,blue). color(3,blue). wheels(3,3).",
        "pos(east(1)). neg(east(3)).",
        "head_pred(east,1). body_pred(wheels,2). body_pred(color,2). body_pred(red,1). max_vars(3).",
    ];
    let texts = texts.map(str::to_owned);
    let [background, examples, bias] = texts.clone();
    let background = format!("{background} red(red).");
    let clauses = |bias: String| {
        let task = task(&[background.clone(), examples.clone(), bias]);
        task.clauses(&solve(&task, &task.settings()).rules)
    };
    assert_eq!(
        clauses(bias.replace("max_vars(3)", "max_vars(4)")),
        ["east(X) :- wheels(X, Y), color(Y, Z), red(Z)."]
    );
    let types = "type(east,(train,)). type(wheels,(train,number)). type(color,(train,color)). type(red,(color,)).";
    assert!(clauses(format!("{bias} {types}")).is_empty());
}

#[test]
fn an_argument_that_occurs_twice_is_two_variables() {
    let task = task(&[
        "p(a,a). p(a,b). p(b,b).",
        "pos(f(a,a)). neg(f(b,a)).",
        "head_pred(f,2). body_pred(p,2). max_vars(2).",
    ]);
    explain_the_examples(&task, &learned(&task, &task.settings()));
}

#[test]
fn two_variables_can_have_one_constant() {
    // Of a clause with `p(X, Z), q(Z, Y)`, the only example has the same constant for X and Z.
    let task = task(&[
        "p(a,a). q(a,b). p(c,d). q(d,e). p(g,g). q(h,b). p(k,d). q(k,m). p(w,k).",
        "pos(f(a,b)). neg(f(d,b)). neg(f(g,b)). neg(f(a,e)). neg(f(c,b)). neg(f(h,b)). neg(f(k,m)).",
        "head_pred(f,2). body_pred(p,2). body_pred(q,2). max_vars(3).",
    ]);
    let rules = learned(&task, &task.settings());
    assert_eq!(task.clauses(&rules), ["f(X, Y) :- p(X, Z), q(Z, Y)."]);
    explain_the_examples(&task, &rules);
}

#[test]
fn the_closed_world_makes_negative_examples() {
    let texts = [
        "p(a,1). p(b,2). q(1). q(c).",
        "pos(f(a)).",
        "head_pred(f,1). body_pred(p,2). body_pred(q,1).",
    ];
    let open = parse(&texts, &Options::default());
    assert!(
        open.0.is_none() && open.1[0].message.contains("no negative example"),
        "{:?}",
        open.1
    );
    let closed = Options {
        closed_world: true,
        ..Options::default()
    };
    let arguments = |texts: &[&str; 3]| -> Vec<String> {
        let task = parse(texts, &closed).0.unwrap();
        task.cases
            .into_iter()
            .filter(|case| !case.is_positive)
            .map(|case| case.arguments.concat())
            .collect()
    };
    assert_eq!(arguments(&texts), ["1", "b", "2", "c"]);
    let typed = format!("{} type(f,(t,)). type(p,(t,n)). type(q,(n,)).", texts[2]);
    assert_eq!(arguments(&[texts[0], texts[1], &typed]), ["b"]);
}

const BACKGROUND: &str = "p(a,b). q(b).";
const EXAMPLES: &str = "pos(f(a)). neg(f(b)).";
const BIAS: &str = "head_pred(f,1). body_pred(p,2). body_pred(q,1).";

#[test]
fn faults_have_places() {
    // The file, its text, and the first message with its place.
    let cases: &[(usize, &str, &str)] = &[
        (0, "p(a,b)\nq(b).", "bk.pl:2:1 syntax: expected `.`"),
        (
            0,
            "p(a,b).\n  q(b",
            "bk.pl:2:6 syntax: expected `,` or `)`, found the end of the text",
        ),
        (
            0,
            "p(a,'b).\nq(b).",
            "bk.pl:1:5 syntax: this quote is not closed on its line",
        ),
        (0, "p(a,b). /* q(b).", "bk.pl:1:9 syntax: this comment is never closed"),
        (0, "p(a,0x1F). q(b).", "bk.pl:1:5 syntax: not a decimal number"),
        (0, "X :- q(b).", "bk.pl:1:1 syntax: a clause begins with a predicate"),
        (0, "p(a,[b]). q(b).", "bk.pl:1:5 unsupported: a list is not supported"),
        (
            0,
            "p(a,s(B)). q(b).",
            "bk.pl:1:5 unsupported: a function term with variables is not supported",
        ),
        (
            0,
            "p(a,Y). q(b).",
            "bk.pl:1:5 unbound-variable: a fact with the variable `Y`",
        ),
        (
            0,
            "p(X,Y) :- q(X), Y is X+1. q(1).",
            "bk.pl:1:19 unsupported: arithmetic is not supported",
        ),
        (
            0,
            "p(X,Y) :- q(X), q(Y), X < Y+1. q(1).",
            "bk.pl:1:28 unsupported: arithmetic is not supported",
        ),
        (
            0,
            "p(X,Y) :- q(X), q(Y), X #< Y. q(1).",
            "bk.pl:1:25 unsupported: a constraint between integers is not supported",
        ),
        (
            0,
            "p(X,X) :- q(X) ; q(X). q(b).",
            "bk.pl:1:16 unsupported: a disjunction is not supported",
        ),
        (
            0,
            "p(X,X) :- q(X), !. q(b).",
            "bk.pl:1:17 unsupported: a cut is not supported",
        ),
        (
            0,
            ":- consult(more). p(a,b). q(b).",
            "bk.pl:1:4 unsupported: this directive is not supported",
        ),
        (
            0,
            "p(X,Y) :- q(X). q(b).",
            "bk.pl:1:1 unbound-variable: no positive atom binds `Y`",
        ),
        (
            0,
            "p(X,X) :- r(X). q(b).",
            "bk.pl:1:11 unknown-predicate: the background knowledge has no facts and no rules of `r/1`",
        ),
        (
            0,
            "p(X,X) :- q(X), \\+ p(X,X). q(b).",
            "bk.pl:1:1 cyclic-negation: `p/2` depends on its own negation",
        ),
        (
            1,
            "pos(g(a)). neg(f(b)).",
            "exs.pl:1:1 invalid-fact: expected an example of `f/1`",
        ),
        (
            1,
            "pos(f(a)). neg(f(b,b)).",
            "exs.pl:1:12 invalid-fact: expected an example of `f/1`",
        ),
        (
            1,
            "pos(f(a)) :- q(b). neg(f(b)).",
            "exs.pl:1:1 invalid-fact: expected an example of `f/1`",
        ),
        (
            1,
            "pos(f(a)). neg(f(a)). neg(f(b)).",
            "exs.pl:1:12 invalid-fact: an example is positive and negative",
        ),
        (
            1,
            "pos(f(a)).",
            "exs.pl:1:11 invalid-fact: there is no negative example",
        ),
        (
            1,
            "pos(f([a])). neg(f(b)).",
            "exs.pl:1:7 unsupported: a list is not supported",
        ),
        (
            2,
            "body_pred(p,2).",
            "bias.pl:1:16 syntax: the bias names no predicate to learn",
        ),
        (
            2,
            "head_pred(f,1). head_pred(g,1).",
            "bias.pl:1:17 unsupported: a second target is not supported",
        ),
        (
            2,
            "head_pred(f,1). body_pred(f,1).",
            "bias.pl:1:17 unsupported: recursive clauses are not supported",
        ),
        (
            2,
            "head_pred(f,1). enable_recursion.",
            "bias.pl:1:17 unsupported: recursive clauses are not supported",
        ),
        (
            2,
            "head_pred(f,1). body_pred(p,7).",
            "bias.pl:1:17 unsupported: `p/7` is not supported",
        ),
        (
            2,
            "head_pred(f,1).\nbody_pred(P,1) :- constants(P).",
            "bias.pl:2:19 unknown-predicate: no fact of the bias has the predicate `constants/1`",
        ),
        (
            2,
            "head_pred(f,1). constant(q).\nbody_pred(P,A) :- constant(P).",
            "bias.pl:2:13 unbound-variable: nothing in this rule binds `A`",
        ),
        (
            2,
            "head_pred(f,1). constant(u).\nbody_pred(P,1) :- constant(P).",
            "bias.pl:2:1 unknown-predicate: the background knowledge has no facts and no rules of `u/1`",
        ),
        (
            2,
            "head_pred(f,0).",
            "bias.pl:1:1 unsupported: a target with 0 arguments is not supported",
        ),
        (2, "head_pred(f,x).", "bias.pl:1:13 syntax: expected a number"),
        (
            2,
            "head_pred(f).",
            "bias.pl:1:1 arity-mismatch: `head_pred` with 1 arguments",
        ),
        (
            2,
            "head_pred(f,1). direction(p,(in,up)).",
            "bias.pl:1:29 syntax: a direction is `in` or `out`",
        ),
        (
            2,
            "head_pred(f,1). body_pred(qq,1).",
            "bias.pl:1:17 unknown-predicate: ",
        ),
    ];
    for (file, text, expected) in cases {
        let mut texts = [BACKGROUND, EXAMPLES, BIAS];
        texts[*file] = text;
        let (task, diagnostics, sources) = parse(&texts, &Options::default());
        assert!(task.is_none(), "{text}");
        let shown = |fault: &Diagnostic| {
            let place = sources.locate(fault.primary.as_ref().unwrap().span);
            format!("{place} {}: {}", fault.code.name(), fault.message)
        };
        // A fault of the bias can have others in the examples as a consequence.
        let name = &expected[..expected.find(':').unwrap()];
        let mut found = diagnostics.iter().filter(|fault| fault.is_error()).map(shown);
        let found = found.find(|found| found.starts_with(name)).unwrap_or_default();
        assert!(
            found.starts_with(expected),
            "{text}\nexpected {expected}\nfound    {found}"
        );
    }
}

#[test]
fn an_example_can_be_linked_to_many_constants() {
    let many: String = (0..300)
        .map(|index| format!("p(a,x{index}). p(b,x{index}). "))
        .collect();
    let background = format!("{many} p(a,z). q(z). r(b,x0,x1,x2,x3,x4). r(a,x0,x1,x2,x3,z).");
    let task = task_of(&background, &format!("{BIAS} body_pred(r,6)."));
    let rules = learned(&task, &task.settings());
    explain_the_examples(&task, &rules);
    assert_eq!(task.clauses(&rules), ["f(X) :- p(X, Y), q(Y)."]);
}

fn task_of(background: &str, bias: &str) -> Task {
    task(&[background, EXAMPLES, bias])
}

#[test]
fn limits_bound_the_rules_and_the_examples() {
    let background = "p(X,Y) :- q(X), q(Y). q(a). q(b). q(c). q(d).";
    let limited = |limits| {
        let options = Options {
            limits,
            ..Options::default()
        };
        let (task, diagnostics, sources) = parse(&[background, EXAMPLES, BIAS], &options);
        (task.is_some(), render(&diagnostics, &sources, false))
    };
    assert!(limited(Limits::default()).0);
    let rows = limited(Limits {
        rows: 10,
        ..Limits::default()
    });
    assert!(!rows.0 && rows.1.contains("error[limit-exceeded]"), "{}", rows.1);
}

#[test]
fn clauses_have_at_most_the_variables_of_the_bias_or_of_the_option() {
    let texts = [
        "p(a,c). p(c,d). q(d). p(b,c).",
        "pos(f(a)). neg(f(c)). neg(f(b)).",
        BIAS,
    ];
    let texts = [&texts[0].replace("p(b,c)", "p(b,e). p(e,g)"), texts[1], texts[2]];
    for (variables, is_solved) in [
        (None, true),
        (Some(6), true),
        (Some(3), true),
        (Some(2), false),
        (Some(1), false),
    ] {
        let options = Options {
            variables,
            ..Options::default()
        };
        let task = parse(&texts, &options).0.unwrap();
        assert_eq!(task.settings().variables, variables.unwrap_or(6));
        let rules = solve(&task, &task.settings()).rules;
        assert_eq!(rules.uncovered == 0, is_solved, "{:?}", task.clauses(&rules));
    }
}

#[test]
fn programs_have_names_that_the_engine_accepts() {
    let texts = [
        "sum(a). sum(a,b). 'A b'('it''s'). 'é'(a). r(b). r('it''s'). r(a).",
        "pos(not(a)). pos(not('it''s')). neg(not(b)).",
        "head_pred(not,1). body_pred(sum,1). body_pred(sum,2). body_pred('A b',1). body_pred(r,1).",
    ];
    let task = task(&texts);
    let rules = learned(&task, &task.settings());
    explain_the_examples(&task, &rules);
    let clauses = task.clauses(&rules);
    assert!(clauses.contains(&"not(X) :- 'A b'(X).".to_owned()), "{clauses:?}");
    assert_eq!(task.example(1), "not('it\\'s')");
    let program = task.program(&rules);
    assert!(
        program.clauses.iter().any(|clause| clause.ends_with(":- A_b(X).")),
        "{program:?}"
    );
}

#[test]
fn examples_with_the_same_facts_are_inseparable() {
    // The constants of `a` and `b` play the same roles in another order.
    let background = "p(a,c). p(a,d). q(c). p(b,e). p(b,g). q(g). p(h,k). r(k).";
    let examples = "pos(f(a)). neg(f(b)). pos(f(h)).";
    let bias = "head_pred(f,1). body_pred(p,2). body_pred(q,1). body_pred(r,1). max_vars(2).";
    let task = task(&[background, examples, bias]);
    let solution = solve(&task, &task.settings());
    assert_eq!(task.clauses(&solution.rules), ["f(X) :- p(X, Y), r(Y)."]);
    assert_eq!(solution.rules.uncovered, 1);
    let without = task.solve(|case| case != 1, &task.settings(), &|_| (), &Cancel::never());
    assert_eq!(without.rules.uncovered, 0);
}

#[test]
fn literals_bind_the_variables_of_the_head() {
    let texts = [
        "p(a). r(b). r(c).",
        "pos(f(a,b)). pos(f(a,c)). pos(f(a,a)). neg(f(b,a)). neg(f(c,b)).",
        "head_pred(f,2). body_pred(p,1). body_pred(r,1). max_vars(2).",
    ];
    let task = task(&texts);
    let rules = learned(&task, &task.settings());
    let clauses = task.clauses(&rules);
    assert!(
        clauses.iter().all(|clause| clause.matches('Y').count() == 2),
        "{clauses:?}"
    );
    explain_the_examples(&task, &rules);
}

#[test]
fn one_variable_of_a_type_is_that_of_the_head() {
    // Through the same score of another game, there is a clause; within a game, there is none.
    let background = "score(g1,p1,0). score(g2,p2,0). special(g2). score(g3,p1,1). score(g4,p2,1).";
    let examples = "pos(behind(g1,p1)). neg(behind(g3,p1)).";
    let bias = "head_pred(behind,2). body_pred(score,3). body_pred(special,1). max_vars(5).";
    let types = "type(behind,(game,player)). type(score,(game,player,number)). type(special,(game,)).";
    let found = |bias: String| {
        let (task, diagnostics, _) = parse(&[background.to_owned(), examples.to_owned(), bias], &Options::default());
        let task = task.unwrap();
        let ignored = diagnostics
            .iter()
            .filter(|fault| fault.code.name() == "ignored")
            .count();
        (solve(&task, &task.settings()).rules.uncovered, ignored)
    };
    for (constraint, expected) in [
        ("", (0, 0)),
        (":- clause(C), #count{V : var_type(C,V,game)} != 1.", (1, 0)),
        (
            ":- clause(C), #count{V : clause_var(C,V),var_type(C,V,game)} != 1.",
            (1, 0),
        ),
        (":-\n    #count{V : clause_var(V),var_type(V,game)} != 1.", (1, 0)),
        (":- clause(C), #count{V : var_type(C,V,game)} != 2.", (0, 1)),
        (":- clause(C), #count{V : var_type(C,V,number)} != 1.", (0, 1)),
        (":- body_literal(C,P,_,_), #count{V : var_type(C,V,game)} != 1.", (0, 1)),
        // The same requirement of each literal.
        (
            "bad_body(score,Vars) :- vars(_,Vars), Vars = (V,_,_), V != 0.\n\
             bad_body(special,Vs) :- vars(_,Vs), Vs = (V,), V != 0.",
            (1, 0),
        ),
        // Arguments, variables and forms that no rule of this kind has.
        ("bad_body(score,Vars) :- vars(_,Vars), Vars = (V,_,_), V != 2.", (0, 1)),
        ("bad_body(score,Vars) :- vars(_,Vars), Vars = (V,_), V != 0.", (0, 1)),
        ("bad_body(score,Vars) :- vars(_,Vars), Vars = (V,_,_), V = 0.", (0, 1)),
    ] {
        assert_eq!(found(format!("{bias} {types} {constraint}")), expected, "{constraint}");
    }
    // Without types, the constraint has no effect.
    let constraint = ":- clause(C), #count{V : var_type(C,V,game)} != 1.";
    assert_eq!(found(format!("{bias} {constraint}")).1, 1);
}

/// Rules over facts of the bias declare the same as the facts that they stand for.
#[test]
fn rules_of_the_bias_make_declarations() {
    let background = "p(a,u). p(b,v). p(c,u). u(u). v(v).";
    let examples = "pos(f(a)). pos(f(c)). neg(f(b)).";
    let bias = "head_pred(f,1). body_pred(p,2). max_vars(2). type(f,(t,)). type(p,(t,value)).\n";
    let by_rules = "body_pred(C,1) :- constant(C,_).\ntype(C,(T,)) :- constant(C,T).\n\
                    direction(C,(in,)) :- constant(C,_).\nconstant(u,value). constant(v,value).";
    let written = "body_pred(u,1). body_pred(v,1). type(u,(value,)). type(v,(value,)).\n\
                   direction(u,(in,)). direction(v,(in,)).";
    let [one, other] = [by_rules, written].map(|more| {
        let texts = [background.to_owned(), examples.to_owned(), format!("{bias}{more}")];
        let (task, diagnostics, _) = parse(&texts, &Options::default());
        assert!(diagnostics.is_empty(), "{diagnostics:?}");
        let task = task.unwrap();
        let rules = learned(&task, &task.settings());
        explain_the_examples(&task, &rules);
        (task.vocabulary().clone(), task.clauses(&rules))
    });
    assert_eq!(one, other);
    assert_eq!(one.1, ["f(X) :- p(X, Y), u(Y)."]);
}

#[test]
fn noise_permits_exceptions() {
    for seed in 0..3 {
        let [background, examples, bias] = trains(seed, 2, 300);
        // Every twentieth example has the wrong label.
        let wrong = |(number, line): (usize, &str)| match (number % 20, line.strip_prefix("pos")) {
            (7, Some(rest)) => format!("neg{rest}\n"),
            (7, None) => format!("{}\n", line.replacen("neg", "pos", 1)),
            _ => format!("{line}\n"),
        };
        let noisy: String = examples.lines().enumerate().map(wrong).collect();
        let (clean, noisy) = (
            task(&[background.clone(), examples, bias.clone()]),
            task(&[background, noisy, bias]),
        );
        for noise in [Noise::Auto, Noise::Rate(0.05)] {
            let settings = Settings {
                noise,
                ..noisy.settings()
            };
            let rules = solve(&noisy, &settings).rules;
            explain_the_examples(&clean, &rules);
            assert_eq!(rules.clauses.len(), 1, "{:?}", noisy.clauses(&rules));
        }
        // Without noise, clauses fit the wrong labels or leave them.
        let rules = solve(&noisy, &noisy.settings()).rules;
        assert!(rules.uncovered > 0 || rules.clauses.len() > 1);
    }
}

#[test]
fn declarations_without_effect_are_warnings() {
    let bias = "max_vars(9). max_body(3). enable_pi. prop(x,y). :- clause(C), #count{V : v(C,V)} != 1.";
    let bias = format!("{BIAS} {bias}");
    let (task, diagnostics, _) = parse(&[BACKGROUND, EXAMPLES, &bias], &Options::default());
    assert!(task.is_some());
    let found: Vec<&str> = diagnostics.iter().map(|fault| fault.message.as_str()).collect();
    assert_eq!(
        found,
        [
            "`max_vars` above 7 has no effect",
            "`max_body` has no effect",
            "`enable_pi` has no effect",
            "`prop` has no effect",
            "a constraint on clauses has no effect",
        ]
    );
    assert!(
        diagnostics
            .iter()
            .all(|fault| fault.code.name() == "ignored" && !fault.is_error())
    );
}

#[test]
fn constants_are_equal_if_prolog_prints_them_alike() {
    let background = "p('a', 07). p(\"a\", 7.50). p('A b', -3). p('it''s', '7'). q(a). q(+) .";
    let (task, diagnostics, sources) = parse(&[background, EXAMPLES, BIAS], &Options::default());
    assert!(task.is_none(), "an operator is no constant");
    assert!(render(&diagnostics, &sources, false).contains("bk.pl:1:"));
    let task = task_of(&background.replace("q(+) .", ""), BIAS);
    let rows: BTreeSet<String> = task.facts(0).map(|row| row.join(" ")).collect();
    let expected = ["a 7", "\"a\" 7.5", "'A b' -3", "'it\\'s' '7'"];
    assert_eq!(rows, expected.map(str::to_owned).into());
}
