//! Programs of many parts of Soufflé's language at once: every session derives what the naive evaluator derives, at once
//! and by increments, and what Soufflé derives.

use crate::cases::cases;
use crate::choice::{Random, change_alike, program};
use logicity_datalog::{Program, facts};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::{env, fs};

/// What every program declares: the input, and types, functors and components of the parts.
const DECLARED: &str = ".decl e(x: symbol, y: number)\n.input e\n.decl i(x: symbol, y: number)\n.input i\n\
    .type Pair = [x: symbol, y: number]\n.type List = [head: Pair, tail: List]\n\
    .type Tree = Leaf {y: number} | Node {x: symbol, l: Tree, r: Tree}\n\
    .type Light = Red {} | Green {} | Timed {y: number}\n\
    .type Name <: symbol\n.type Small <: number\n.type Any = Name | Other\n.type Other <: symbol\n\
    .functor half(x: number): number\n.functor join(x: symbol, y: symbol): symbol\n\
    .comp Step<T, U> {\n  .decl given, step(x: T, y: U) overridable\n  step(x, y) :- given(x, y).\n  \
    step(x, z) :- step(x, y), given(_, z), y < z.\n}\n\
    .comp Back<T, U> : Step<T, U> {\n  .override step\n  step(x, z) :- given(x, y), given(_, z), z <= y.\n}\n\
    .comp Outer<T> : Back<T, number> {\n  .comp Inner<U> {\n    .decl kept(x: U, y: number)\n  }\n  \
    .init inner = Inner<T>\n  inner.kept(x, y) :- step(x, y), !given(x, y).\n}\n";

/// Returns a program whose parts read each other in order. `kinds` says how many kinds of parts it may have.
fn random_program(random: &mut Random, kinds: u64) -> String {
    let mut text = DECLARED.to_owned();
    let mut before = vec!["e".to_owned(), "i".to_owned()];
    for at in 0..3 + random.below(4) {
        let names: Vec<&str> = before.iter().map(String::as_str).collect();
        let (a, b) = (random.of(&names), random.of(&names));
        text += &part(random.below(kinds), at, a, b, random);
        before.push(format!("p{at}"));
    }
    text
}

/// The number of kinds of parts.
const KINDS: u64 = 31;

/// The number of kinds of parts that Soufflé evaluates to the only result they have.
const KINDS_OF_SOUFFLE: u64 = 28;

/// Returns the declaration and clauses of the predicate `p` of a part, which reads `a` and `b`. Predicates `k` of a part
/// have other rows in Soufflé.
fn part(kind: u64, at: u64, a: &str, b: &str, random: &mut Random) -> String {
    let p = format!("p{at}");
    let plain = format!(".decl {p}(x: symbol, y: number)\n");
    match kind {
        0 => format!(
            "{plain}{p}(x, y) :- {a}(x, y), {b}(_, y). {p}(x, y) :- {p}(x, z), {b}(_, y), !{a}(x, y), z != y.\n"
        ),
        1 => format!(
            ".decl q{at}(x: number, y: number) eqrel\nq{at}(x, y) :- {a}(s, x), {b}(s, y).\n\
             {plain}{p}(x, y) :- {a}(x, z), q{at}(z, y).\n"
        ),
        2 => format!(
            ".decl q{at}(x: symbol, y: symbol) eqrel\nq{at}(x, y) :- {a}(x, n), {b}(y, n).\n\
             {plain}{p}(x, y) :- q{at}(x, z), {b}(z, y), x != z.\n"
        ),
        3 => {
            let than = random.of(&["z < y", "z > y"]);
            format!(
                "{plain}{p}(x, y) :- {a}(x, y). {p}(x, y + 1) :- {p}(x, y), {b}(x, _), 0 <= y, y < 5.\n\
                 {p}(x, y) <= {p}(x, z) :- {than}.\n"
            )
        }
        4 => format!(
            "{plain}{p}(x, @half(y)) :- {a}(x, y). {p}(@join(x, z), 0) :- {a}(x, y), {b}(z, y), @half(y) != y.\n"
        ),
        5 => format!(
            ".decl l{at}(l: List, n: number)\nl{at}(nil, 0). l{at}([[x, y], l], n + 1) :- {a}(x, y), strlen(x) = 1, 0 <= y, y < 3, l{at}(l, n), n < 2.\n\
             {plain}{p}(x, y) :- l{at}([[x, _], [[_, y], nil]], _). {p}(x, n) :- l{at}([r, _], n), r = [x, 1], {b}(x, _).\n"
        ),
        6 => format!(
            ".decl t{at}(t: Tree)\nt{at}($Leaf(y)) :- {a}(_, y), 0 <= y, y < 4. t{at}($Node(x, l, $Leaf(y))) :- {b}(x, y), y < 3, l = $Leaf(z), t{at}(l), z != y.\n\
             {plain}{p}(x, y) :- t{at}($Node(x, $Leaf(y), r)), t{at}(r). {p}(x, y) :- {a}(x, y), !t{at}($Leaf(y)).\n"
        ),
        7 => {
            let component = random.of(&["Step", "Back"]);
            format!(
                ".init c{at} = {component}<symbol, number>\nc{at}.given(x, y) :- {a}(x, y).\n\
                 {plain}{p}(x, y) :- c{at}.step(x, y), !{b}(x, y).\n"
            )
        }
        8 => format!(
            "{plain}.limitsize {p}(n={})\n{p}(x, y) :- {a}(x, y). {p}(x, y + 1) :- {p}(x, y), {b}(x, _), 0 <= y, y < 20.\n",
            1 + random.below(9)
        ),
        9 => format!(
            "{plain}{p}(x, c) :- {a}(x, _), c = count : {{ {b}(x, y), {a}(_z, y) }}. {p}(x, m) :- {b}(x, _), m = max y : {{ {a}(x, y) }}.\n"
        ),
        10 => format!(
            ".decl near{at}(x: number, y: number) inline\nnear{at}(x, y) :- x < y, y < x + 3. near{at}(x, x) :- x > 1.\n\
             {plain}{p}(x, z) :- {a}(x, y), {b}(_, z), near{at}(y, z).\n"
        ),
        11 => {
            let (limit, odd) = (random.below(3), random.below(2));
            format!(
                "#define BOTH{at}(x, y) {a}(x, y), {b}(_, y)\n#define NAME{at}(n) p ## n\n\
                 #define SHOWN{at}(x) #x\n\
                 #if {limit} > 1 || !defined(BOTH{at})\n{plain}{p}(x, y) :- {a}(x, y), !{b}(x, y).\n\
                 #elif {odd}\n{plain}{p}(SHOWN{at}(a), {limit}). {p}(x, y) :- BOTH{at}(x, y). // {{\n\
                 #else\n.decl NAME{at}({at})(x: symbol, y: number)\n{p}(x, __LINE__ - __LINE__) :- BOTH{at}(x, \\\n  1). /* #endif */\n#endif\n"
            )
        }
        12 => format!(
            "{plain}.decl q{at}(y: number, x: symbol)\n{p}(x, y), q{at}(y, x) :- {a}(x, y), ({b}(x, _); {b}(_, z), z < y, z > 0).\n\
             {p}(x, 0) :- {a}(x, _), !q{at}(2, x).\n"
        ),
        13 => {
            let body = random.of(&[
                "contains(\"a\", x)",
                "match(\"[ab].*\", x)",
                "x < \"b\"",
                "strlen(x) = 1",
            ]);
            format!(
                "{plain}{p}(cat(x, z), strlen(z)) :- {a}(x, y), {b}(z, y), strlen(x) + strlen(z) < 3.\n\
                 {p}(substr(x, 0, 1), to_number(to_string(y))) :- {a}(x, y), {body}.\n\
                 {p}(max(x, z), y) :- {a}(x, y), {b}(z, y). {p}(to_string(y % 3), 1) :- {a}(_, y), !{b}(\"a\", y).\n"
            )
        }
        14 => {
            let value = random.of(&[
                "(y * 3 + z) % 5",
                "y band 3 bxor z band 3",
                "(y bor z) % 8",
                "(y bshl 1) % 8",
                "-y % 3 + 2",
                "(y % 9) ^ 2 % 7",
                "(y - z) / 2",
                "(bnot y) % 5",
                "max(y, z) - min(y, z, 2)",
                "y land z",
                "(y bshru 28) - (z bshr 2)",
            ]);
            format!("{plain}{p}(x, {value}) :- {a}(x, y), {b}(_, z), -9 < y, y < 9, -9 < z, z < 9.\n")
        }
        15 => format!(
            ".decl f{at}(x: symbol, v: float, u: unsigned)\n\
             f{at}(x, to_float(y) / 2, to_unsigned(y)) :- {a}(x, y), 0 <= y, y < 9. f{at}(x, -v, u - 1) :- f{at}(x, v, u), u > 0.\n\
             {plain}{p}(x, to_number(u)) :- f{at}(x, v, u), v > 0.5. {p}(x, to_number(m)) :- {b}(x, _), m = max v : {{ f{at}(x, v, _) }}.\n\
             {p}(x, to_number(m)) :- {a}(x, _), m = mean v : {{ f{at}(_, v, 1) }}. {p}(x, 1) :- {b}(x, y), !f{at}(x, to_float(y), 1).\n"
        ),
        16 => format!(
            "{plain}{p}(x, c) :- {a}(x, _), c = count : {{ {b}(x, y), y < max z : {{ {a}(_, z) }} }}.\n\
             {p}(x, s % 7) :- {b}(x, _), s = sum y : {{ {a}(z, y), z != x }}. {p}(x, m) :- m = max y : {{ {a}(x, y) }}.\n\
             {p}(x, m % 9) :- {a}(x, _), m = min y + z : {{ {a}(x, y), {b}(x, z) }}.\n"
        ),
        17 => {
            let range = random.of(&["range(0, y)", "range(y, 9, 3)", "range(y, 0, -2)", "range(y, 2)"]);
            format!("{plain}{p}(x, n) :- {a}(x, y), 0 <= y, y < 9, n = {range}. {p}(x, y) :- {b}(x, y), y < 0.\n")
        }
        18 => format!(
            ".init o{at} = Outer<symbol>\no{at}.given(x, y) :- {a}(x, y). o{at}.given(x, 2) :- {b}(x, 1).\n\
             {plain}{p}(x, y) :- o{at}.inner.kept(x, y). {p}(x, 0) :- o{at}.step(x, 2), {b}(x, _).\n"
        ),
        19 => format!(
            ".decl r{at}(x: symbol, y: number) magic\nr{at}(x, y) :- {a}(x, y). r{at}(x, z) :- r{at}(x, y), {b}(_, z), y < z.\n\
             {plain}{p}(x, y) :- r{at}(\"a\", y), {b}(x, y). {p}(x, 1) :- r{at}(x, 1), !r{at}(x, 2).\n"
        ),
        20 => format!(
            ".decl s{at}(x: Name, y: Small)\n.decl u{at}(x: Any)\ns{at}(as(x, Name), as(y, Small)) :- {a}(x, y), y != 1.\n\
             u{at}(x) :- s{at}(x, _). u{at}(as(x, Other)) :- {b}(x, 2).\n{plain}{p}(x, y) :- s{at}(x, y), u{at}(x). {p}(x, 1) :- u{at}(x).\n"
        ),
        21 => format!(
            ".decl k{at}(x: symbol, y: number) choice-domain x\nk{at}(x, y) :- {a}(x, y). k{at}(x, 1) :- {b}(x, 1).\n\
             {plain}{p}(x, c) :- {a}(x, _), c = count : {{ k{at}(x, _) }}. {p}(x, -1) :- k{at}(x, y), !{a}(x, y), y != 1.\n"
        ),
        22 => format!(
            ".decl k{at}(x: symbol, y: number, z: number, n: number)\nk{at}(x, y, z, autoinc()) :- {a}(x, y), {b}(x, z), z <= y.\n\
             {plain}{p}(x, c) :- {a}(x, y), c = count : {{ k{at}(x, y, _, _) }}.\n"
        ),
        23 => format!(
            "{plain}{p}(x, y) :- {a}(x, y), !({b}(x, _), {b}(_, y)). {p}(x, 3) :- {b}(x, 3), !(!{a}(x, 3); {a}(x, 2)).\n"
        ),
        24 => format!(
            "{plain}.decl q{at}(x: symbol, y: number)\n{p}(x, y) :- {a}(x, y), y > 0. {p}(x, y) :- q{at}(x, y), y != 1.\n\
             q{at}(x, z) :- {p}(x, y), {b}(_, z), z <= y. q{at}(z, y) :- {p}(x, y), {b}(z, _), x < z.\n"
        ),
        25 => format!(
            ".decl h{at}(x: symbol, l: Light)\nh{at}(x, $Red) :- {a}(x, 0). h{at}(x, $Green()) :- {b}(x, 1). h{at}(x, $Timed(y)) :- {a}(x, y), y > 1.\n\
             {plain}{p}(x, 0) :- h{at}(x, $Red). {p}(x, y) :- h{at}(x, $Timed(y)), !h{at}(x, $Green). {p}(x, c) :- {b}(x, _), c = count : {{ h{at}(x, _) }}.\n"
        ),
        26 => format!(
            ".decl big{at}(x: symbol, y: number) inline\nbig{at}(x, y) :- {a}(x, y), y > 1. big{at}(x, y) :- {b}(x, y), y = 0.\n\
             {plain}{p}(x, y) :- {a}(x, _), {b}(_, y), !big{at}(x, y). {p}(x, 1) :- big{at}(x, _).\n"
        ),
        27 => format!(
            "{plain}.decl v{at}(x: symbol, from: number, to: number)\nv{at}(x, y, z) :- {a}(x, y), {b}(x, z), 0 <= y, y <= z, z < 5.\n\
             v{at}(x, y, w) :- v{at}(x, y, z), v{at}(x, z, w).\nv{at}(x, y, z) <= v{at}(x, v, w) :- v <= y, z <= w.\n\
             {p}(x, z) :- v{at}(x, _, z). {p}(x, y) :- v{at}(x, y, y).\n"
        ),
        28 => {
            let key = random.of(&["x", "y", "x, y", "(x, y), y"]);
            let more = random.of(&["", "p(x, z) :- p(x, y), B(_, z), y != z.\n"]);
            let more = more.replace("p(", &format!("{p}(")).replace('B', b);
            format!(".decl {p}(x: symbol, y: number) choice-domain {key}\n{p}(x, y) :- {a}(x, y).\n{more}")
        }
        29 => format!(
            "{plain}{p}(x, y) :- {a}(x, y). {p}(x, y + 1) :- {p}(x, y), {b}(x, _), 0 <= y, y < 5.\n\
             {p}(x, y) <= {p}(x, z) :- z < y, {b}(x, z). {p}(x, y) :- {b}(x, y), ord([x, y]) = ord([x, y]).\n"
        ),
        _ => format!(
            "{plain}.decl k{at}(x: symbol, n: number)\nk{at}(x, autoinc()) :- {a}(x, y), {b}(_, y).\nk{at}(x, $) :- {b}(x, 1).\n\
             {p}(x, n % 7) :- k{at}(x, n). {p}(x, c) :- {a}(x, _), c = count : {{ {b}(x, y), {a}(_, y) }}.\n"
        ),
    }
}

/// Defines the functors, one of which has no value for some arguments.
fn defined(program: Program) -> Program {
    let with_half = program.define("half", |(x,): (i32,)| (x % 2 == 0).then_some(x / 2));
    let all = with_half.and_then(|program| program.define("join", |(x, y): (String, String)| Some(x.min(y))));
    all.expect("declared")
}

#[test]
fn random_programs_derive_what_the_naive_evaluator_derives() {
    change_alike(30, |random| random_program(random, KINDS), defined);
}

/// The functors for Soufflé, where each has a value for all arguments.
const FUNCTORS: &str = "#include <cstdint>\n#include <cstring>\nextern \"C\" {\n\
    int32_t half(int32_t x) { return x / 2; }\n\
    const char* join(const char* x, const char* y) { return std::strcmp(x, y) < 0 ? x : y; }\n}\n";

/// Compares with the program `souffle` whose path is the environment variable `SOUFFLE`, and prints each difference.
#[test]
#[ignore = "needs Soufflé and a C++ compiler; `make souffle` runs it"]
fn random_programs_derive_what_souffle_derives() {
    let souffle = env::var_os("SOUFFLE")
        .map(PathBuf::from)
        .expect("SOUFFLE is the path of Soufflé");
    let folder = tempfile::tempdir().expect("a folder");
    let at = |name: &str| folder.path().join(name);
    fs::write(at("functors.cpp"), FUNCTORS).expect("written");
    let compiled = Command::new("c++")
        .args(["-shared", "-fPIC", "-o", "libfunctors.so", "functors.cpp"])
        .current_dir(folder.path())
        .status();
    assert!(compiled.expect("a C++ compiler").success());
    let total = cases(200).cases;
    let mut different = 0;
    for seed in 0..u64::from(total) {
        let mut random = Random(seed);
        let mut text = written_for_souffle(&random_program(&mut random, KINDS_OF_SOUFFLE));
        let outputs = shown_predicates(&text);
        text += &format!(".output {}\n", outputs.join(", "));
        let ours = program(&text).define("half", |(x,): (i32,)| Some(x / 2));
        let ours = ours.and_then(|program| program.define("join", |(x, y): (String, String)| Some(x.min(y))));
        let mut session = ours.expect("declared").session();
        for name in ["e", "i"] {
            let rows = (0..random.below(9)).map(|_| (random.of(&["b", "a", "d", "c"]), random.below(5)));
            let rows: Vec<(&str, u64)> = rows.collect();
            let lines: String = rows.iter().map(|(x, y)| format!("{x}\t{y}\n")).collect();
            fs::write(at(&format!("{name}.facts")), lines).expect("written");
            rows.into_iter()
                .for_each(|row| session.insert(name, row).expect("a row"));
        }
        session.commit().expect("small");
        fs::write(at("a.dl"), &text).expect("written");
        let wrong = match run_souffle(&souffle, folder.path()) {
            Err(message) => vec![message],
            Ok(()) => outputs
                .iter()
                .filter_map(|name| {
                    let id = session.program().predicate(name).expect("declared");
                    difference(name, &facts::print(&session, id), &at(&format!("{name}.csv")))
                })
                .collect(),
        };
        if !wrong.is_empty() {
            different += 1;
            let given = ["e", "i"].map(|name| fs::read_to_string(at(&format!("{name}.facts"))).expect("a file"));
            eprintln!(
                "seed {seed}: {}\n{text}e:\n{}i:\n{}",
                wrong.join("\n"),
                given[0],
                given[1]
            );
        }
    }
    eprintln!("{total} programs, {different} differ");
    assert_eq!(different, 0, "of {total} programs have other results in Soufflé");
}

/// Returns a program of the same meaning without two forms: a branch has parentheses in Soufflé, and a `.limitsize` has
/// no effect beside `magic` predicates.
fn written_for_souffle(text: &str) -> String {
    let text = text.replace("$Red)", "$Red())").replace("$Green)", "$Green())");
    match text.contains(".limitsize") {
        true => text.replace(" magic\n", "\n"),
        false => text,
    }
}

/// Returns the predicates of parts whose rows Soufflé determines: those with rows that are not called `k`.
fn shown_predicates(text: &str) -> Vec<String> {
    let declarations = text.split(".decl ").skip(1).filter_map(|rest| rest.lines().next());
    let stored = declarations.filter(|declaration| !declaration.ends_with(" inline"));
    let names = stored.filter_map(|declaration| Some(declaration.split_once('(')?.0));
    let determined = |name: &&str| {
        let kind = name.trim_end_matches(|last: char| last.is_ascii_digit());
        kind.len() < name.len() && kind != "k" && kind.starts_with(|first: char| first.is_ascii_lowercase())
    };
    let distinct: BTreeSet<String> = names.filter(determined).map(str::to_owned).collect();
    distinct.into_iter().collect()
}

/// Runs `a.dl` in the folder, or returns what Soufflé says against it.
fn run_souffle(souffle: &Path, folder: &Path) -> Result<(), String> {
    let done = Command::new(souffle)
        .args(["--no-warn", "-F", ".", "-D", ".", "-L", ".", "a.dl"])
        .current_dir(folder)
        .output()
        .expect("Soufflé starts");
    let said = String::from_utf8_lossy(&done.stderr).into_owned();
    match done.status.success() && said.is_empty() {
        true => Ok(()),
        false => Err(format!("Soufflé: {said}")),
    }
}

/// Returns how the rows of a predicate differ from those in a file of Soufflé, if they do.
fn difference(name: &str, ours: &str, file: &Path) -> Option<String> {
    let theirs = fs::read_to_string(file).expect("written by Soufflé");
    let [ours, theirs] = [ours, &theirs].map(|text| text.lines().collect::<BTreeSet<&str>>());
    let only =
        |one: &BTreeSet<&str>, other: &BTreeSet<&str>| format!("{:?}", one.difference(other).collect::<Vec<_>>());
    (ours != theirs).then(|| {
        format!(
            "{name}: only here {}; only in Soufflé {}",
            only(&ours, &theirs),
            only(&theirs, &ours)
        )
    })
}
