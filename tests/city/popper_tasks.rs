//! Random tasks in the format of Popper: trains and their cars, structures of pieces, families.
#![allow(dead_code, reason = "each target uses its own part")]

use logicity::rng::{Purpose, RngExt, Seed};
use std::fmt::Write;

/// The texts of a task: background knowledge, examples and bias.
pub type Texts = [String; 3];

/// The hidden rules of [`trains`], [`pieces`] and [`family`].
pub const TARGETS: usize = 4;

/// The stream of these tasks.
const TASKS: Purpose = Purpose::new(1 << 20);

/// Trains with up to four cars. A car has a length, a roof, wheels and up to two loads with a shape.
pub fn trains(seed: u64, target: usize, count: usize) -> Texts {
    let mut random = Seed(seed).stream(TASKS, target as u64, 0);
    let [mut background, mut examples] = [String::new(), String::new()];
    for train in 0..count {
        let (mut cars, mut loads) = (Vec::new(), Vec::new());
        for car in 0..random.random_range(1..5) {
            let drawn = [2, 2, 2].map(|kinds| random.random_range(0..kinds));
            let names = [
                ["short", "long"],
                ["roof_open", "roof_closed"],
                ["two_wheels", "three_wheels"],
            ];
            let _ = writeln!(background, "has_car(t{train},c{train}_{car}).");
            for (drawn, names) in drawn.iter().zip(names) {
                let _ = writeln!(background, "{}(c{train}_{car}).", names[*drawn]);
            }
            for load in 0..random.random_range(0..3) {
                let shape = random.random_range(0..3);
                let name = ["circle", "triangle", "rectangle"][shape];
                let _ = writeln!(
                    background,
                    "has_load(c{train}_{car},l{train}_{car}_{load}). {name}(l{train}_{car}_{load})."
                );
                loads.push((car, shape));
            }
            cars.push(drawn);
        }
        let any = |of: &dyn Fn(&[usize; 3]) -> bool| cars.iter().any(of);
        let holds = match target {
            0 => any(&|car| car[0] == 1 && car[1] == 1) && any(&|car| car[2] == 1),
            1 => (any(&|car| car[0] == 0 && car[1] == 1)) || any(&|car| car[0] == 1 && car[2] == 1),
            2 => loads.iter().any(|&(car, shape)| shape == 1 && cars[car][1] == 0),
            _ => any(&|car| car[1] == 0) && loads.iter().any(|&(car, shape)| shape == 2 && cars[car][0] == 0),
        };
        let _ = writeln!(examples, "{}(east(t{train})).", if holds { "pos" } else { "neg" });
    }
    let mut bias = "head_pred(east,1).\nmax_vars(4).\nbody_pred(has_car,2).\nbody_pred(has_load,2).\n".to_owned();
    bias += "direction(has_car,(in,out)).\ndirection(has_load,(in,out)).\n";
    for (names, kind) in [
        ("short long roof_open roof_closed two_wheels three_wheels", "car"),
        ("circle triangle rectangle", "load"),
    ] {
        for name in names.split(' ') {
            let _ = writeln!(
                bias,
                "body_pred({name},1).\ntype({name},({kind},)).\ndirection({name},(in,))."
            );
        }
    }
    bias += "type(east,(train,)).\ntype(has_car,(train,car)).\ntype(has_load,(car,load)).\n";
    background +=
        &"short long roof_open roof_closed two_wheels three_wheels circle triangle rectangle has_car/2 has_load/2"
            .split(' ')
            .map(|name| format!(":- dynamic {name}{}.\n", if name.contains('/') { "" } else { "/1" }))
            .collect::<String>();
    [background, examples, bias]
}

/// Structures of up to five pieces with a color, a size and contacts. Rules group the sizes.
pub fn pieces(seed: u64, target: usize, count: usize) -> Texts {
    let mut random = Seed(seed).stream(TASKS, target as u64, 1);
    let [mut background, mut examples] = [String::new(), String::new()];
    for structure in 0..count {
        let mut pieces = Vec::new();
        let mut contacts = Vec::new();
        for piece in 0..random.random_range(1..6) {
            let (color, size) = (random.random_range(0..3), random.random_range(0..10));
            let _ = writeln!(
                background,
                "piece({structure},p{structure}_{piece}). {}(p{structure}_{piece}). size(p{structure}_{piece},{size}).",
                ["red", "green", "blue"][color]
            );
            if piece > 0 && random.random_range(0..2) == 0 {
                let other = random.random_range(0..piece);
                contacts.push([piece, other]);
                let _ = writeln!(background, "touches(p{structure}_{piece},p{structure}_{other}).");
            }
            pieces.push((color, size));
        }
        let is_small = |piece: usize| pieces[piece].1 < 4;
        let touching =
            |of: &dyn Fn(usize, usize) -> bool| contacts.iter().any(|&[one, other]| of(one, other) || of(other, one));
        let holds = match target {
            0 => touching(&|one, other| pieces[one].0 == 0 && is_small(other)),
            1 => [0, 1, 2]
                .iter()
                .all(|color| pieces.iter().any(|piece| piece.0 == *color)),
            2 => pieces.iter().any(|piece| piece.0 == 2 && piece.1 >= 7),
            _ => {
                touching(&|one, other| pieces[one].0 == 1 && pieces[other].0 == 1) || (pieces.len() == 1 && is_small(0))
            }
        };
        let _ = writeln!(examples, "{}(good({structure})).", if holds { "pos" } else { "neg" });
    }
    background += "contact(X, Y) :- touches(X, Y).\ncontact(X, Y) :- touches(Y, X).\n:- dynamic touches/2.\n\
                   small(N) :- N < 4, size(_, N).\nlarge(N) :- size(_, N), 7 =< N.\n\
                   several(S) :- piece(S, A), piece(S, B), A \\= B.\nsingle(S) :- piece(S, _), \\+ several(S).\n\
                   :- dynamic red/1, green/1, blue/1.\n";
    let mut bias = "head_pred(good,1).\nmax_vars(4).\n".to_owned();
    for (declaration, types, directions) in [
        ("piece", "structure,piece", "in,out"),
        ("contact", "piece,piece", "in,out"),
        ("size", "piece,number", "in,out"),
        ("red", "piece,", "in,"),
        ("green", "piece,", "in,"),
        ("blue", "piece,", "in,"),
        ("small", "number,", "in,"),
        ("large", "number,", "in,"),
        ("single", "structure,", "in,"),
    ] {
        let arity = if types.ends_with(',') { 1 } else { 2 };
        let _ = writeln!(
            bias,
            "body_pred({declaration},{arity}). type({declaration},({types})). direction({declaration},({directions}))."
        );
    }
    bias += "type(good,(structure,)).\n";
    [background, examples, bias]
}

/// Families of three generations. The target relates two people.
pub fn family(seed: u64, target: usize, count: usize) -> Texts {
    let mut random = Seed(seed).stream(TASKS, target as u64, 2);
    let [mut background, mut examples] = [String::new(), String::new()];
    // The parents of each person; the first two generations are couples.
    let people = 24_usize;
    let parents: Vec<Option<[usize; 2]>> = (0..people)
        .map(|person| {
            (person >= 8).then(|| {
                let couple = random.random_range(0..(person.min(16) / 2));
                [2 * couple, 2 * couple + 1]
            })
        })
        .collect();
    for (person, own) in parents.iter().enumerate() {
        if let Some([mother, father]) = own {
            let _ = writeln!(background, "mother(p{mother},p{person}). father(p{father},p{person}).");
        }
    }
    let parent = |one: usize, other: usize| parents[other].is_some_and(|own| own.contains(&one));
    let holds = |one: usize, other: usize| match target {
        0 => (0..people).any(|middle| parent(one, middle) && parent(middle, other)),
        1 => one != other && parents[one].is_some() && parents[one] == parents[other],
        2 => one.is_multiple_of(2) && parent(one, other),
        _ => (0..people).any(|child| one != other && parent(one, child) && parent(other, child)),
    };
    for _ in 0..count {
        // Every second pair is a true one, if there is any.
        let pairs: Vec<[usize; 2]> = (0..people * people)
            .map(|pair| [pair / people, pair % people])
            .filter(|[one, other]| one != other)
            .collect();
        let wanted = random.random_range(0..2) == 0;
        let fitting: Vec<&[usize; 2]> = pairs
            .iter()
            .filter(|[one, other]| holds(*one, *other) == wanted)
            .collect();
        if let Some([one, other]) = fitting.get(random.random_range(0..fitting.len().max(1))) {
            let label = if wanted { "pos" } else { "neg" };
            let _ = writeln!(examples, "{label}(related(p{one},p{other})).");
        }
    }
    let bias = "head_pred(related,2).\nmax_vars(3).\nbody_pred(mother,2).\nbody_pred(father,2).\n";
    [background, examples, bias.to_owned()]
}
