//! Programs of many parts of Soufflé's language at once: every session derives what the naive evaluator derives, at once
//! and by increments.

use crate::choice::{Random, change_alike};
use logicity_datalog::Program;

/// What every program declares: the input, and types, functors and components of the parts.
const DECLARED: &str = ".decl e(x: symbol, y: number)\n.input e\n.decl i(x: symbol, y: number)\n.input i\n\
    .type Pair = [x: symbol, y: number]\n.type List = [head: Pair, tail: List]\n\
    .type Tree = Leaf {y: number} | Node {x: symbol, l: Tree, r: Tree}\n\
    .functor half(x: number): number\n.functor join(x: symbol, y: symbol): symbol\n\
    .comp Step<T, U> {\n  .decl given, step(x: T, y: U) overridable\n  step(x, y) :- given(x, y).\n  \
    step(x, z) :- step(x, y), given(_, z), y < z.\n}\n\
    .comp Back<T, U> : Step<T, U> {\n  .override step\n  step(x, z) :- given(x, y), given(_, z), z <= y.\n}\n";

/// Returns a program whose parts read each other in order.
fn random_program(random: &mut Random) -> String {
    let mut text = DECLARED.to_owned();
    let mut before = vec!["e".to_owned(), "i".to_owned()];
    for at in 0..3 + random.below(4) {
        let names: Vec<&str> = before.iter().map(String::as_str).collect();
        let (a, b) = (random.of(&names), random.of(&names));
        text += &part(at, a, b, random);
        before.push(format!("p{at}"));
    }
    text
}

/// Returns the declaration and clauses of the predicate `p` of a part, which reads `a` and `b`.
fn part(at: u64, a: &str, b: &str, random: &mut Random) -> String {
    let plain = format!(".decl p{at}(x: symbol, y: number)\n");
    match random.below(13) {
        0 => {
            format!(
                "{plain}p{at}(x, y) :- {a}(x, y), {b}(_, y). p{at}(x, y) :- p{at}(x, z), {b}(_, y), !{a}(x, y), z != y.\n"
            )
        }
        1 => format!(
            ".decl q{at}(x: number, y: number) eqrel\nq{at}(x, y) :- {a}(s, x), {b}(s, y).\n\
             {plain}p{at}(x, y) :- {a}(x, z), q{at}(z, y).\n"
        ),
        2 => format!(
            ".decl q{at}(x: symbol, y: symbol) eqrel\nq{at}(x, y) :- {a}(x, n), {b}(y, n).\n\
             {plain}p{at}(x, y) :- q{at}(x, z), {b}(z, y), x != z.\n"
        ),
        3 => {
            let key = random.of(&["x", "y", "x, y", "(x, y), y"]);
            let more = random.of(&["", "p(x, z) :- p(x, y), B(_, z), y != z.\n"]);
            let more = more.replace("p(", &format!("p{at}(")).replace('B', b);
            format!(".decl p{at}(x: symbol, y: number) choice-domain {key}\np{at}(x, y) :- {a}(x, y).\n{more}")
        }
        4 => {
            let than = random.of(&["z < y", "z > y", "z < y, B(x, z)"]).replace('B', b);
            format!(
                "{plain}p{at}(x, y) :- {a}(x, y). p{at}(x, y + 1) :- p{at}(x, y), {b}(x, _), y < 5.\n\
                 p{at}(x, y) <= p{at}(x, z) :- {than}.\n"
            )
        }
        5 => format!("{plain}p{at}(x, autoinc()) :- {a}(x, y), {b}(_, y).\np{at}(x, $) :- {b}(x, 1).\n"),
        6 => format!(
            ".decl l{at}(l: List, n: number)\nl{at}(nil, 0). l{at}([[x, y], l], n + 1) :- {a}(x, y), l{at}(l, n), n < 2.\n\
             {plain}p{at}(x, y) :- l{at}([[x, _], [[_, y], nil]], _). p{at}(x, n) :- l{at}([r, _], n), r = [x, 1], {b}(x, _).\n"
        ),
        7 => format!(
            ".decl t{at}(t: Tree)\nt{at}($Leaf(y)) :- {a}(_, y). t{at}($Node(x, l, $Leaf(y))) :- {b}(x, y), l = $Leaf(z), t{at}(l), z != y.\n\
             {plain}p{at}(x, y) :- t{at}($Node(x, $Leaf(y), r)), t{at}(r). p{at}(x, y) :- {a}(x, y), !t{at}($Leaf(y)).\n"
        ),
        8 => format!(
            "{plain}p{at}(x, @half(y)) :- {a}(x, y). p{at}(@join(x, z), 0) :- {a}(x, y), {b}(z, y), @half(y) != y.\n"
        ),
        9 => {
            let component = random.of(&["Step", "Back"]);
            format!(
                ".init c{at} = {component}<symbol, number>\nc{at}.given(x, y) :- {a}(x, y).\n\
                 {plain}p{at}(x, y) :- c{at}.step(x, y), !{b}(x, y).\n"
            )
        }
        10 => format!(
            "{plain}.limitsize p{at}(n={})\np{at}(x, y) :- {a}(x, y). p{at}(x, y + 1) :- p{at}(x, y), {b}(x, _), y < 20.\n",
            1 + random.below(9)
        ),
        11 => format!(
            "{plain}p{at}(x, c) :- {a}(x, _), c = count : {{ {b}(x, y), {a}(_, y) }}. p{at}(x, m) :- {b}(x, _), m = max y : {{ {a}(x, y) }}.\n"
        ),
        _ => format!(
            ".decl near{at}(x: number, y: number) inline\nnear{at}(x, y) :- x < y, y < x + 3. near{at}(x, x) :- x > 1.\n\
             {plain}p{at}(x, z) :- {a}(x, y), {b}(_, z), near{at}(y, z). p{at}(x, y) :- {b}(x, y), ord([x, y]) = ord([x, y]).\n"
        ),
    }
}

fn defined(program: Program) -> Program {
    let with_half = program.define("half", |(x,): (i32,)| (x % 2 == 0).then_some(x / 2));
    let all = with_half.and_then(|program| program.define("join", |(x, y): (String, String)| Some(x.min(y))));
    all.expect("declared")
}

#[test]
fn random_programs_derive_what_the_naive_evaluator_derives() {
    change_alike(30, random_program, defined);
}
