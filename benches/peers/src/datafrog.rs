//! Hand-written datafrog: joins with an explicit order and explicit indexes.

#![allow(dead_code, reason = "each binary uses its own part")]

use crate::case::{Facts, Kind, Pair};
use datafrog::{Iteration, Relation, RelationLeaper};

/// The number of rows of each derived relation, if the program is here.
pub fn counts(kind: Kind, facts: &Facts) -> Option<Vec<usize>> {
    Some(match kind {
        Kind::Closure => vec![closure(facts.binary("Edge"))],
        Kind::Generation => vec![generation(facts.binary("Parent"))],
        Kind::Pointsto => vec![points_to(facts)],
        Kind::City => city(facts),
        _ => return None,
    })
}

fn swapped(&(x, y): &Pair) -> Pair {
    (y, x)
}

fn closure(edges: &[Pair]) -> usize {
    let edge: Relation<Pair> = edges.iter().collect();
    let mut iteration = Iteration::new();
    // Path(x, y) as (y, x).
    let path = iteration.variable::<Pair>("path");
    path.extend(edges.iter().map(swapped));
    while iteration.changed() {
        path.from_join(&path, &edge, |_, &x, &z| (z, x));
    }
    path.complete().len()
}

fn generation(parents: &[Pair]) -> usize {
    let children: Relation<Pair> = parents.iter().map(swapped).collect();
    let mut iteration = Iteration::new();
    let same = iteration.variable::<Pair>("same");
    let half = iteration.variable::<Pair>("half");
    same.insert(Relation::from_join(&children, &children, |_, &x, &y| (x, y)));
    while iteration.changed() {
        half.from_join(&same, &children, |_, &q, &x| (q, x));
        same.from_join(&half, &children, |_, &x, &y| (x, y));
    }
    same.complete().len()
}

fn points_to(facts: &Facts) -> usize {
    let swap = |name: &str| facts.binary(name).iter().map(swapped).collect::<Relation<Pair>>();
    let (assign_from, load_from) = (swap("Assign"), swap("Load"));
    let store: Relation<Pair> = facts.binary("Store").iter().collect();
    let mut iteration = Iteration::new();
    let points_to = iteration.variable::<Pair>("points_to");
    // Load(y, x), PointsTo(x, z) as (z, y); Store(y, x), PointsTo(y, z) as (x, z).
    let loaded = iteration.variable::<Pair>("loaded");
    let stored = iteration.variable::<Pair>("stored");
    points_to.extend(facts.binary("AddressOf"));
    while iteration.changed() {
        points_to.from_join(&points_to, &assign_from, |_, &x, &y| (y, x));
        loaded.from_join(&points_to, &load_from, |_, &z, &y| (z, y));
        points_to.from_join(&loaded, &points_to, |_, &y, &w| (y, w));
        stored.from_join(&points_to, &store, |_, &z, &x| (x, z));
        points_to.from_join(&stored, &points_to, |_, &z, &w| (z, w));
    }
    points_to.complete().len()
}

type One = (u32, ());

/// Every clause is one multiway join that begins with the relation with the fewest rows, or with pairs in view.
fn city(facts: &Facts) -> Vec<usize> {
    let one = |name: &str| facts.unary(name).iter().map(|&x| (x, ())).collect::<Relation<One>>();
    let any = |name: &str| {
        facts
            .unary(name)
            .iter()
            .map(|&x| ((), x))
            .collect::<Relation<((), u32)>>()
    };
    let two = |name: &str| facts.binary(name).iter().collect::<Relation<Pair>>();
    let back = |name: &str| facts.binary(name).iter().map(swapped).collect::<Relation<Pair>>();
    let all = |parts: Vec<Relation<One>>| parts.into_iter().fold(Relation::from_vec(Vec::new()), Relation::merge);

    let [ambulance, bus, car, police, tiro, reckless, old, at_inter, in_inter] = [
        "IsAmbulance",
        "IsBus",
        "IsCar",
        "IsPolice",
        "IsTiro",
        "IsReckless",
        "IsOld",
        "IsAtInter",
        "IsInInter",
    ]
    .map(one);
    let [
        is_at_inter,
        is_in_inter,
        is_ambulance,
        is_old,
        is_pedestrian,
        is_police,
        is_young,
        is_reckless,
    ] = [
        "IsAtInter",
        "IsInInter",
        "IsAmbulance",
        "IsOld",
        "IsPedestrian",
        "IsPolice",
        "IsYoung",
        "IsReckless",
    ]
    .map(any);
    let [sees, close, next_to, colliding] = ["Sees", "IsClose", "NextTo", "CollidingClose"].map(two);
    let [from_higher_pri, from_right_of, from_next_to, from_left_of, from_close] =
        ["HigherPri", "RightOf", "NextTo", "LeftOf", "IsClose"].map(back);

    let itself = |&(x, ()): &One| (x, ());
    let key = |&(x, ()): &One| x;
    let nothing = |_: &One| ();
    let head = |&(x, ()): &One, _: &u32| (x, ());

    let lawful = |source: &Relation<One>| {
        let rows = source.iter().copied();
        let free = rows.filter(|row| ambulance.binary_search(row).is_err() && old.binary_search(row).is_err());
        Relation::from_vec(free.collect())
    };
    let away = |source: &Relation<One>| {
        let rows = source.iter().copied();
        let free = rows.filter(|row| in_inter.binary_search(row).is_err() && at_inter.binary_search(row).is_err());
        Relation::from_vec(free.collect())
    };
    let waiting = lawful(&at_inter);
    let stop = all(vec![
        Relation::from_leapjoin(
            &waiting,
            (sees.extend_with(key), is_in_inter.extend_with(nothing)),
            head,
        ),
        Relation::from_leapjoin(
            &waiting,
            (
                sees.extend_with(key),
                from_higher_pri.extend_with(key),
                is_at_inter.extend_with(nothing),
            ),
            head,
        ),
        Relation::from_leapjoin(
            &lawful(&in_inter),
            (
                sees.extend_with(key),
                is_in_inter.extend_with(nothing),
                is_ambulance.extend_with(nothing),
            ),
            head,
        ),
        Relation::from_leapjoin(
            &ambulance,
            (
                sees.extend_with(key),
                from_right_of.extend_with(key),
                is_old.extend_with(nothing),
            ),
            head,
        ),
        Relation::from_vec(
            (colliding.iter())
                .filter(|pair| ambulance.binary_search(&(pair.0, ())).is_err())
                .filter(|pair| old.binary_search(&(pair.0, ())).is_err())
                .filter(|pair| sees.binary_search(pair).is_ok())
                .map(|pair| (pair.0, ()))
                .collect(),
        ),
        Relation::from_leapjoin(
            &away(&bus),
            (
                sees.extend_with(key),
                from_right_of.extend_with(key),
                from_next_to.extend_with(key),
                is_pedestrian.extend_with(nothing),
            ),
            head,
        ),
        Relation::from_leapjoin(
            &away(&car),
            (
                ambulance.filter_anti(itself),
                police.filter_anti(itself),
                sees.extend_with(key),
                from_left_of.extend_with(key),
                from_close.extend_with(key),
                is_police.extend_with(nothing),
            ),
            head,
        ),
    ]);

    let moving = |source: &Relation<One>| {
        let rows = source.iter().copied();
        Relation::from_vec(
            rows.filter(|row| stop.binary_search(row).is_err())
                .collect::<Vec<One>>(),
        )
    };
    let (beginner, patrol) = (moving(&tiro), moving(&police));
    // Police and a young y that it sees.
    let children: Relation<Pair> = Relation::from_leapjoin(
        &patrol,
        (sees.extend_with(key), is_young.extend_with(nothing)),
        |&(x, ()), &y| (x, y),
    );
    let slow = all(vec![
        Relation::from_leapjoin(
            &beginner,
            (
                close.extend_with(key),
                sees.extend_with(key),
                is_pedestrian.extend_with(nothing),
            ),
            head,
        ),
        Relation::from_leapjoin(
            &beginner,
            (
                in_inter.filter_with(itself),
                sees.extend_with(key),
                is_at_inter.extend_with(nothing),
            ),
            head,
        ),
        Relation::from_leapjoin(
            &children,
            (
                next_to.extend_with(|&(_, y)| y),
                sees.extend_with(|&(x, _)| x),
                is_young.extend_with(|_: &Pair| ()),
            ),
            |&(x, _), _| (x, ()),
        ),
    ]);

    let hasty = |source: &Relation<One>| {
        let rows = source.iter().copied();
        let free = rows.filter(|row| stop.binary_search(row).is_err() && slow.binary_search(row).is_err());
        Relation::from_vec(free.collect::<Vec<One>>())
    };
    let fast = all(vec![
        Relation::from_leapjoin(
            &hasty(&reckless),
            (sees.extend_with(key), is_at_inter.extend_with(nothing)),
            head,
        ),
        hasty(&bus),
        Relation::from_leapjoin(
            &hasty(&police),
            (sees.extend_with(key), is_reckless.extend_with(nothing)),
            head,
        ),
    ]);

    let normal = (sees.iter())
        .filter(|(x, y)| x == y)
        .map(|&(x, _)| (x, ()))
        .filter(|row| {
            [&stop, &slow, &fast]
                .iter()
                .all(|acts| acts.binary_search(row).is_err())
        });
    let normal = Relation::from_vec(normal.collect::<Vec<One>>());
    [stop, slow, fast, normal].iter().map(|acts| acts.len()).collect()
}
