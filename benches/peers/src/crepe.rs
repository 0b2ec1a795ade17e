//! crepe: a macro compiles the rules to Rust; relations are hashed.

use crate::case::{Facts, Kind};

mod closure {
    crepe::crepe! {
        @input
        pub struct Edge(pub u32, pub u32);
        @output
        pub struct Path(pub u32, pub u32);
        Path(x, y) <- Edge(x, y);
        Path(x, z) <- Path(x, y), Edge(y, z);
    }
}

mod generation {
    crepe::crepe! {
        @input
        pub struct Parent(pub u32, pub u32);
        @output
        pub struct Same(pub u32, pub u32);
        Same(x, y) <- Parent(x, p), Parent(y, p);
        Same(x, y) <- Same(p, q), Parent(x, p), Parent(y, q);
    }
}

mod pointsto {
    crepe::crepe! {
        @input
        pub struct AddressOf(pub u32, pub u32);
        @input
        pub struct Assign(pub u32, pub u32);
        @input
        pub struct Load(pub u32, pub u32);
        @input
        pub struct Store(pub u32, pub u32);
        @output
        pub struct PointsTo(pub u32, pub u32);
        PointsTo(y, x) <- AddressOf(y, x);
        PointsTo(y, x) <- Assign(y, z), PointsTo(z, x);
        PointsTo(y, w) <- Load(y, x), PointsTo(x, z), PointsTo(z, w);
        PointsTo(z, w) <- Store(y, x), PointsTo(y, z), PointsTo(x, w);
    }
}

mod city {
    crepe::crepe! {
        @input
        pub struct Pedestrian(pub u32);
        @input
        pub struct Car(pub u32);
        @input
        pub struct Ambulance(pub u32);
        @input
        pub struct Bus(pub u32);
        @input
        pub struct Police(pub u32);
        @input
        pub struct Tiro(pub u32);
        @input
        pub struct Reckless(pub u32);
        @input
        pub struct Old(pub u32);
        @input
        pub struct Young(pub u32);
        @input
        pub struct AtInter(pub u32);
        @input
        pub struct InInter(pub u32);
        @input
        pub struct Close(pub u32, pub u32);
        @input
        pub struct NextTo(pub u32, pub u32);
        @input
        pub struct HigherPri(pub u32, pub u32);
        @input
        pub struct Colliding(pub u32, pub u32);
        @input
        pub struct LeftOf(pub u32, pub u32);
        @input
        pub struct RightOf(pub u32, pub u32);
        @input
        pub struct Sees(pub u32, pub u32);
        @output
        pub struct Stop(pub u32);
        @output
        pub struct Slow(pub u32);
        @output
        pub struct Fast(pub u32);
        @output
        pub struct Normal(pub u32);

        Stop(x) <- AtInter(x), !Ambulance(x), !Old(x), Sees(x, y), InInter(y);
        Stop(x) <- AtInter(x), !Ambulance(x), !Old(x), Sees(x, y), AtInter(y), HigherPri(y, x);
        Stop(x) <- InInter(x), !Ambulance(x), !Old(x), Sees(x, y), InInter(y), Ambulance(y);
        Stop(x) <- Ambulance(x), Sees(x, y), Old(y), RightOf(y, x);
        Stop(x) <- Colliding(x, y), !Ambulance(x), !Old(x), Sees(x, y);
        Stop(x) <- Bus(x), !InInter(x), !AtInter(x), Sees(x, y), Pedestrian(y), RightOf(y, x), NextTo(y, x);
        Stop(x) <- Car(x), !Ambulance(x), !Police(x), !InInter(x), !AtInter(x), Sees(x, y), Police(y),
            LeftOf(y, x), Close(y, x);

        Slow(x) <- Tiro(x), !Stop(x), Close(x, y), Pedestrian(y), Sees(x, y);
        Slow(x) <- Tiro(x), InInter(x), !Stop(x), Sees(x, y), AtInter(y);
        Slow(x) <- Police(x), !Stop(x), Sees(x, y), Young(y), NextTo(y, z), Young(z), Sees(x, z);

        Fast(x) <- Reckless(x), !Stop(x), !Slow(x), Sees(x, y), AtInter(y);
        Fast(x) <- Bus(x), !Stop(x), !Slow(x);
        Fast(x) <- Police(x), !Stop(x), !Slow(x), Sees(x, y), Reckless(y);

        Normal(x) <- Sees(x, y), (x == y), !Stop(x), !Slow(x), !Fast(x);
    }
}

/// The number of rows of each derived relation, if the program is here.
pub fn counts(kind: Kind, facts: &Facts) -> Option<Vec<usize>> {
    let unary = |name: &str| facts.unary(name).iter().copied();
    let binary = |name: &str| facts.binary(name).iter().copied();
    Some(match kind {
        Kind::Closure => {
            use closure::{Crepe, Edge};
            let mut program = Crepe::new();
            program.extend(binary("Edge").map(|(x, y)| Edge(x, y)));
            let (path,) = program.run();
            vec![path.len()]
        }
        Kind::Generation => {
            use generation::{Crepe, Parent};
            let mut program = Crepe::new();
            program.extend(binary("Parent").map(|(x, y)| Parent(x, y)));
            let (same,) = program.run();
            vec![same.len()]
        }
        Kind::Pointsto => {
            use pointsto::{AddressOf, Assign, Crepe, Load, Store};
            let mut program = Crepe::new();
            program.extend(binary("AddressOf").map(|(x, y)| AddressOf(x, y)));
            program.extend(binary("Assign").map(|(x, y)| Assign(x, y)));
            program.extend(binary("Load").map(|(x, y)| Load(x, y)));
            program.extend(binary("Store").map(|(x, y)| Store(x, y)));
            let (points_to,) = program.run();
            vec![points_to.len()]
        }
        Kind::City => {
            let mut program = city::Crepe::new();
            program.extend(unary("IsPedestrian").map(city::Pedestrian));
            program.extend(unary("IsCar").map(city::Car));
            program.extend(unary("IsAmbulance").map(city::Ambulance));
            program.extend(unary("IsBus").map(city::Bus));
            program.extend(unary("IsPolice").map(city::Police));
            program.extend(unary("IsTiro").map(city::Tiro));
            program.extend(unary("IsReckless").map(city::Reckless));
            program.extend(unary("IsOld").map(city::Old));
            program.extend(unary("IsYoung").map(city::Young));
            program.extend(unary("IsAtInter").map(city::AtInter));
            program.extend(unary("IsInInter").map(city::InInter));
            program.extend(binary("IsClose").map(|(x, y)| city::Close(x, y)));
            program.extend(binary("NextTo").map(|(x, y)| city::NextTo(x, y)));
            program.extend(binary("HigherPri").map(|(x, y)| city::HigherPri(x, y)));
            program.extend(binary("CollidingClose").map(|(x, y)| city::Colliding(x, y)));
            program.extend(binary("LeftOf").map(|(x, y)| city::LeftOf(x, y)));
            program.extend(binary("RightOf").map(|(x, y)| city::RightOf(x, y)));
            program.extend(binary("Sees").map(|(x, y)| city::Sees(x, y)));
            let (stop, slow, fast, normal) = program.run();
            vec![stop.len(), slow.len(), fast.len(), normal.len()]
        }
        _ => return None,
    })
}
