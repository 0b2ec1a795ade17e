//! ascent: a macro compiles the rules to Rust; relations are hashed.

use crate::case::{Facts, Kind};

mod closure {
    ascent::ascent! {
        pub struct Program;
        relation edge(u32, u32);
        relation path(u32, u32);
        path(x, y) <-- edge(x, y);
        path(x, z) <-- path(x, y), edge(y, z);
    }
}

mod generation {
    ascent::ascent! {
        pub struct Program;
        relation parent(u32, u32);
        relation same(u32, u32);
        same(x, y) <-- parent(x, p), parent(y, p);
        same(x, y) <-- same(p, q), parent(x, p), parent(y, q);
    }
}

mod pointsto {
    ascent::ascent! {
        pub struct Program;
        relation address_of(u32, u32);
        relation assign(u32, u32);
        relation load(u32, u32);
        relation store(u32, u32);
        relation points_to(u32, u32);
        points_to(y, x) <-- address_of(y, x);
        points_to(y, x) <-- assign(y, z), points_to(z, x);
        points_to(y, w) <-- load(y, x), points_to(x, z), points_to(z, w);
        points_to(z, w) <-- store(y, x), points_to(y, z), points_to(x, w);
    }
}

mod city {
    ascent::ascent! {
        pub struct Program;
        relation pedestrian(u32);
        relation car(u32);
        relation ambulance(u32);
        relation bus(u32);
        relation police(u32);
        relation tiro(u32);
        relation reckless(u32);
        relation old(u32);
        relation young(u32);
        relation at_inter(u32);
        relation in_inter(u32);
        relation close(u32, u32);
        relation next_to(u32, u32);
        relation higher_pri(u32, u32);
        relation colliding(u32, u32);
        relation left_of(u32, u32);
        relation right_of(u32, u32);
        relation sees(u32, u32);
        relation stop(u32);
        relation slow(u32);
        relation fast(u32);
        relation normal(u32);

        stop(x) <-- at_inter(x), !ambulance(x), !old(x), sees(x, y), in_inter(y);
        stop(x) <-- at_inter(x), !ambulance(x), !old(x), sees(x, y), at_inter(y), higher_pri(y, x);
        stop(x) <-- in_inter(x), !ambulance(x), !old(x), sees(x, y), in_inter(y), ambulance(y);
        stop(x) <-- ambulance(x), sees(x, y), old(y), right_of(y, x);
        stop(x) <-- colliding(x, y), !ambulance(x), !old(x), sees(x, y);
        stop(x) <-- bus(x), !in_inter(x), !at_inter(x), sees(x, y), pedestrian(y), right_of(y, x), next_to(y, x);
        stop(x) <-- car(x), !ambulance(x), !police(x), !in_inter(x), !at_inter(x), sees(x, y), police(y),
            left_of(y, x), close(y, x);

        slow(x) <-- tiro(x), !stop(x), close(x, y), pedestrian(y), sees(x, y);
        slow(x) <-- tiro(x), in_inter(x), !stop(x), sees(x, y), at_inter(y);
        slow(x) <-- police(x), !stop(x), sees(x, y), young(y), next_to(y, z), young(z), sees(x, z);

        fast(x) <-- reckless(x), !stop(x), !slow(x), sees(x, y), at_inter(y);
        fast(x) <-- bus(x), !stop(x), !slow(x);
        fast(x) <-- police(x), !stop(x), !slow(x), sees(x, y), reckless(y);

        normal(x) <-- sees(x, y), if x == y, !stop(x), !slow(x), !fast(x);
    }
}

mod reach {
    ascent::ascent! {
        pub struct Program;
        relation edge(u32, u32);
        relation reached(u32);
        reached(y) <-- reached(x), edge(x, y);
    }
}

mod triangles {
    ascent::ascent! {
        pub struct Program;
        relation edge(u32, u32);
        relation triangle(u32, u32, u32);
        triangle(x, y, z) <-- edge(x, y), edge(y, z), edge(z, x);
    }
}

mod cspa {
    ascent::ascent! {
        pub struct Program;
        relation assign(u32, u32);
        relation dereference(u32, u32);
        relation value_flow(u32, u32);
        relation memory_alias(u32, u32);
        relation value_alias(u32, u32);
        value_flow(y, x) <-- assign(y, x);
        value_flow(x, x), value_flow(y, y), memory_alias(x, x), memory_alias(y, y) <-- assign(x, y);
        value_flow(x, z) <-- memory_alias(y, z), assign(x, y);
        value_flow(x, z) <-- value_flow(x, y), value_flow(y, z);
        memory_alias(x, w) <-- value_alias(y, z), dereference(y, x), dereference(z, w);
        value_alias(x, y) <-- value_flow(z, x), value_flow(z, y);
        value_alias(x, y) <-- memory_alias(z, w), value_flow(z, x), value_flow(w, y);
    }
}

mod csda {
    ascent::ascent! {
        pub struct Program;
        relation edge(u32, u32);
        relation null(u32, u32);
        null(x, z) <-- null(x, y), edge(y, z);
    }
}

mod el {
    ascent::ascent! {
        pub struct Program;
        relation sub(u32, u32);
        relation and(u32, u32, u32);
        relation some(u32, u32, u32);
        relation has(u32, u32, u32);
        relation sub_role(u32, u32);
        relation subsumed(u32, u32);
        relation related(u32, u32, u32);
        subsumed(x, d) <-- subsumed(x, c), sub(c, d);
        subsumed(x, e) <-- subsumed(x, c), and(c, d, e), subsumed(x, d);
        related(x, r, d) <-- subsumed(x, c), some(c, r, d);
        related(x, s, y) <-- related(x, r, y), sub_role(r, s);
        subsumed(x, d) <-- related(x, r, y), subsumed(y, c), has(r, c, d);
    }
}

mod borrows {
    ascent::ascent! {
        pub struct Program;
        relation edge(u32, u32);
        relation live(u32, u32);
        relation killed(u32, u32);
        relation invalidated(u32, u32);
        relation subset(u32, u32, u32);
        relation contains(u32, u32, u32);
        relation loan_live(u32, u32);
        relation fault(u32, u32);
        subset(a, c, p) <-- subset(a, b, p), subset(b, c, p);
        subset(a, b, q) <-- subset(a, b, p), edge(p, q), live(a, q), live(b, q);
        contains(b, l, p) <-- contains(a, l, p), subset(a, b, p);
        contains(a, l, q) <-- contains(a, l, p), !killed(l, p), edge(p, q), live(a, q);
        loan_live(l, p) <-- contains(a, l, p), live(a, p);
        fault(l, p) <-- invalidated(l, p), loan_live(l, p);
    }
}

mod crdt {
    ascent::ascent! {
        pub struct Program;
        relation insert(u32, u32, u32, u32);
        relation remove(u32, u32);
        relation has_child(u32, u32);
        relation later_child(u32, u32, u32, u32);
        relation first_child(u32, u32, u32, u32);
        relation later_sibling(u32, u32, u32, u32);
        relation much_later(u32, u32, u32, u32);
        relation has_next(u32, u32);
        relation after(u32, u32, u32, u32);
        relation next(u32, u32, u32, u32);
        relation shown(u32, u32);
        relation blank(u32, u32, u32, u32);
        relation reach(u32, u32, u32, u32);
        relation visible(u32, u32, u32, u32);
        has_child(p, q) <-- insert(_, _, p, q);
        later_sibling(c, n, d, m) <-- insert(c, n, p, q), insert(d, m, p, q), if c > d;
        later_sibling(c, n, d, m) <-- insert(c, n, p, q), insert(d, m, p, q), if c == d && n > m;
        later_child(p, q, d, m) <-- insert(d, m, p, q), later_sibling(c, n, d, m);
        first_child(p, q, c, n) <-- insert(c, n, p, q), !later_child(p, q, c, n);
        much_later(c, n, e, k) <-- later_sibling(c, n, d, m), later_sibling(d, m, e, k);
        has_next(c, n) <-- later_sibling(c, n, _, _);
        after(c, n, d, m) <-- later_sibling(c, n, d, m), !much_later(c, n, d, m);
        after(c, n, d, m) <-- after(p, q, d, m), insert(c, n, p, q), !has_next(c, n);
        next(c, n, d, m) <-- first_child(c, n, d, m);
        next(c, n, d, m) <-- after(c, n, d, m), !has_child(c, n);
        shown(c, n) <-- insert(c, n, _, _), !remove(c, n);
        blank(c, n, d, m) <-- next(c, n, d, m), !shown(c, n);
        reach(c, n, d, m) <-- next(c, n, d, m), shown(c, n);
        reach(c, n, e, k) <-- reach(c, n, d, m), blank(d, m, e, k);
        visible(c, n, d, m) <-- reach(c, n, d, m), shown(d, m);
    }
}

/// The number of rows of each derived relation.
pub fn counts(kind: Kind, facts: &Facts) -> Vec<usize> {
    match kind {
        Kind::Closure => {
            let mut program = closure::Program::default();
            program.edge = facts.binary("Edge").to_vec();
            program.run();
            vec![program.path.len()]
        }
        Kind::Generation => {
            let mut program = generation::Program::default();
            program.parent = facts.binary("Parent").to_vec();
            program.run();
            vec![program.same.len()]
        }
        Kind::Pointsto => {
            let mut program = pointsto::Program::default();
            program.address_of = facts.binary("AddressOf").to_vec();
            program.assign = facts.binary("Assign").to_vec();
            program.load = facts.binary("Load").to_vec();
            program.store = facts.binary("Store").to_vec();
            program.run();
            vec![program.points_to.len()]
        }
        Kind::City => {
            let unary = |name: &str| facts.unary(name).iter().map(|&x| (x,)).collect::<Vec<_>>();
            let binary = |name: &str| facts.binary(name).to_vec();
            let mut program = city::Program::default();
            program.pedestrian = unary("IsPedestrian");
            program.car = unary("IsCar");
            program.ambulance = unary("IsAmbulance");
            program.bus = unary("IsBus");
            program.police = unary("IsPolice");
            program.tiro = unary("IsTiro");
            program.reckless = unary("IsReckless");
            program.old = unary("IsOld");
            program.young = unary("IsYoung");
            program.at_inter = unary("IsAtInter");
            program.in_inter = unary("IsInInter");
            program.close = binary("IsClose");
            program.next_to = binary("NextTo");
            program.higher_pri = binary("HigherPri");
            program.colliding = binary("CollidingClose");
            program.left_of = binary("LeftOf");
            program.right_of = binary("RightOf");
            program.sees = binary("Sees");
            program.run();
            vec![
                program.stop.len(),
                program.slow.len(),
                program.fast.len(),
                program.normal.len(),
            ]
        }
        Kind::Reach => {
            let mut program = reach::Program::default();
            program.edge = facts.binary("Edge").to_vec();
            program.reached = facts.unary("Start").iter().map(|&x| (x,)).collect();
            program.run();
            vec![program.reached.len()]
        }
        Kind::Triangles => {
            let mut program = triangles::Program::default();
            program.edge = facts.binary("Edge").to_vec();
            program.run();
            vec![program.triangle.len()]
        }
        Kind::Cspa => {
            let mut program = cspa::Program::default();
            program.assign = facts.binary("Assign").to_vec();
            program.dereference = facts.binary("Dereference").to_vec();
            program.run();
            vec![
                program.value_flow.len(),
                program.memory_alias.len(),
                program.value_alias.len(),
            ]
        }
        Kind::Csda => {
            let mut program = csda::Program::default();
            program.edge = facts.binary("Edge").to_vec();
            program.null = facts.binary("NullEdge").to_vec();
            program.run();
            vec![program.null.len()]
        }
        Kind::El => {
            let triples = |name: &str| facts.ternary(name).iter().map(|&[x, y, z]| (x, y, z)).collect();
            let mut program = el::Program::default();
            program.sub = facts.binary("Sub").to_vec();
            program.sub_role = facts.binary("SubRole").to_vec();
            program.and = triples("And");
            program.some = triples("Some");
            program.has = triples("Has");
            program.subsumed = facts.unary("Concept").iter().map(|&x| (x, x)).collect();
            program.run();
            vec![program.subsumed.len(), program.related.len()]
        }
        Kind::Borrows => {
            let triples = |name: &str| facts.ternary(name).iter().map(|&[x, y, z]| (x, y, z)).collect();
            let mut program = borrows::Program::default();
            program.edge = facts.binary("Edge").to_vec();
            program.live = facts.binary("Live").to_vec();
            program.killed = facts.binary("Killed").to_vec();
            program.invalidated = facts.binary("Invalidated").to_vec();
            program.subset = triples("Outlives");
            program.contains = triples("Issued");
            program.run();
            vec![program.subset.len(), program.contains.len(), program.fault.len()]
        }
        Kind::Crdt => {
            let mut program = crdt::Program::default();
            let rows = facts.quaternary("Insert").iter();
            program.insert = rows.map(|&[c, n, p, q]| (c, n, p, q)).collect();
            program.remove = facts.binary("Remove").to_vec();
            program.run();
            vec![program.next.len(), program.visible.len()]
        }
    }
}
