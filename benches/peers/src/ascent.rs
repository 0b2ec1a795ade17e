//! ascent: a macro compiles the rules to Rust; relations are hashed.

use crate::case::{Case, Facts};

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

/// The number of rows of each derived relation.
pub fn counts(case: Case, facts: &Facts) -> Vec<usize> {
    match case {
        Case::Random | Case::Chain => {
            let mut program = closure::Program::default();
            program.edge = facts.binary("Edge").to_vec();
            program.run();
            vec![program.path.len()]
        }
        Case::Generation => {
            let mut program = generation::Program::default();
            program.parent = facts.binary("Parent").to_vec();
            program.run();
            vec![program.same.len()]
        }
        Case::Pointsto => {
            let mut program = pointsto::Program::default();
            program.address_of = facts.binary("AddressOf").to_vec();
            program.assign = facts.binary("Assign").to_vec();
            program.load = facts.binary("Load").to_vec();
            program.store = facts.binary("Store").to_vec();
            program.run();
            vec![program.points_to.len()]
        }
        Case::City => {
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
    }
}
