//! Hand-written differential-dataflow: the same joins as a dataflow, loaded at once on one thread.

#![allow(dead_code, reason = "each binary uses its own part")]

use crate::case::{Changes, Facts, Kind};
use differential_dataflow::VecCollection;
use differential_dataflow::input::{Input, InputSession};
use differential_dataflow::operators::iterate::Iterate;
use std::cell::{Cell, RefCell};
use std::rc::Rc;
use timely::dataflow::Scope;
use timely::dataflow::operators::probe::Handle;
use timely::worker::Worker;

type Pairs<'s> = VecCollection<'s, u32, (u32, u32)>;
type Ones<'s> = VecCollection<'s, u32, u32>;

/// The base facts as collections.
struct Base<'a, 's> {
    scope: Scope<'s, u32>,
    facts: &'a Facts,
    /// The input of a binary relation.
    inputs: RefCell<Edb>,
}

/// Keyed by the name of the relation.
type Edb = Vec<(String, InputSession<u32, (u32, u32), isize>)>;

/// A program as a dataflow that waits for changes of its pairs.
pub struct Dataflow {
    inputs: Edb,
    probe: Handle<u32>,
    /// Of each derived relation, the number of its rows.
    counters: Vec<Rc<Cell<isize>>>,
    now: u32,
}

/// Whether [`Dataflow::new`] has the program.
pub fn has(kind: Kind) -> bool {
    !matches!(
        kind,
        Kind::Triangles | Kind::Cspa | Kind::El | Kind::Borrows | Kind::Crdt
    )
}

impl Dataflow {
    /// Loads the facts. [`has`] says for which programs.
    pub fn new(worker: &mut Worker, kind: Kind, facts: &Facts) -> Self {
        let probe = Handle::new();
        let counters: Vec<Rc<Cell<isize>>> = kind.derived().iter().map(|_| Rc::default()).collect();
        let inputs = worker.dataflow::<u32, _, _>(|scope| {
            let base = Base {
                scope,
                facts,
                inputs: RefCell::default(),
            };
            let counted = |at: usize| {
                let counter = counters[at].clone();
                move |change: isize| counter.set(counter.get() + change)
            };
            let count_pairs = |pairs: Pairs<'_>| {
                let add = counted(0);
                pairs.inspect(move |(_, _, change)| add(*change)).probe_with(&probe);
            };
            let count_ones = |at: usize, ones: Ones<'_>| {
                let add = counted(at);
                ones.inspect(move |(_, _, change)| add(*change)).probe_with(&probe);
            };
            match kind {
                Kind::City => {
                    let derived = city(&base).into_iter().enumerate();
                    derived.for_each(|(at, ones)| count_ones(at, ones));
                }
                Kind::Reach => count_ones(0, reach(base.pairs("Edge"), base.ones("Start"))),
                Kind::Closure => count_pairs(closure(base.pairs("Edge"))),
                Kind::Generation => count_pairs(generation(base.pairs("Parent"))),
                Kind::Pointsto => count_pairs(points_to(&base)),
                Kind::Csda => count_pairs(flow(base.pairs("Edge"), base.pairs("NullEdge"))),
                Kind::Triangles | Kind::Cspa | Kind::El | Kind::Borrows | Kind::Crdt => unreachable!("`has` is false"),
            }
            base.inputs.into_inner()
        });
        let mut dataflow = Dataflow {
            inputs,
            probe,
            counters,
            now: 0,
        };
        dataflow.tick(worker, &Changes::new());
        dataflow
    }

    /// Applies changes: by relation, pairs and whether they are inserted or retracted.
    pub fn tick(&mut self, worker: &mut Worker, changes: &Changes) {
        self.now += 1;
        for (name, input) in &mut self.inputs {
            for (_, pairs) in changes.iter().filter(|(other, _)| other == name) {
                for &(pair, present) in pairs {
                    input.update(pair, if present { 1 } else { -1 });
                }
            }
            input.advance_to(self.now);
            input.flush();
        }
        worker.step_while(|| self.probe.less_than(&self.now));
    }

    /// The current number of rows of each derived relation.
    pub fn counts(&self) -> Vec<usize> {
        self.counters.iter().map(|counter| counter.get() as usize).collect()
    }
}

impl<'s> Base<'_, 's> {
    fn pairs(&self, name: &str) -> Pairs<'s> {
        let (input, pairs) = self.scope.clone().new_collection_from(self.facts.binary(name).to_vec());
        self.inputs.borrow_mut().push((name.to_string(), input));
        pairs
    }

    fn ones(&self, name: &str) -> Ones<'s> {
        self.scope
            .clone()
            .new_collection_from(self.facts.unary(name).to_vec())
            .1
    }
}

fn closure(edge: Pairs<'_>) -> Pairs<'_> {
    flow(edge.clone(), edge)
}

/// The pairs of `from` and the paths that continue them.
fn flow<'s>(edge: Pairs<'s>, from: Pairs<'s>) -> Pairs<'s> {
    from.clone().iterate(|scope, path| {
        path.map(|(x, y)| (y, x))
            .join_map(edge.enter(scope), |_, &x, &z| (x, z))
            .concat(from.enter(scope))
            .distinct()
    })
}

fn reach<'s>(edge: Pairs<'s>, start: Ones<'s>) -> Ones<'s> {
    start.clone().iterate(|scope, reached| {
        edge.enter(scope)
            .semijoin(reached)
            .map(|(_, y)| y)
            .concat(start.enter(scope))
            .distinct()
    })
}

fn generation(parent: Pairs<'_>) -> Pairs<'_> {
    let children = parent.map(|(x, p)| (p, x));
    let siblings = children
        .clone()
        .join_map(children.clone(), |_, &x, &y| (x, y))
        .distinct();
    siblings.clone().iterate(|scope, same| {
        let children = children.enter(scope).arrange_by_key();
        same.arrange_by_key()
            .join_core(children.clone(), |_, &q, &x| Some((q, x)))
            .arrange_by_key()
            .join_core(children, |_, &x, &y| Some((x, y)))
            .concat(siblings.enter(scope))
            .distinct()
    })
}

fn points_to<'s>(base: &Base<'_, 's>) -> Pairs<'s> {
    let address_of = base.pairs("AddressOf");
    let (assign, load, store) = (base.pairs("Assign"), base.pairs("Load"), base.pairs("Store"));
    address_of.clone().iterate(|scope, points_to| {
        let points_to = points_to.arrange_by_key();
        let copied = assign
            .enter(scope)
            .map(|(y, z)| (z, y))
            .arrange_by_key()
            .join_core(points_to.clone(), |_, &y, &x| Some((y, x)));
        let loaded = load
            .enter(scope)
            .map(|(y, x)| (x, y))
            .arrange_by_key()
            .join_core(points_to.clone(), |_, &y, &z| Some((z, y)))
            .arrange_by_key()
            .join_core(points_to.clone(), |_, &y, &w| Some((y, w)));
        let stored = store
            .enter(scope)
            .arrange_by_key()
            .join_core(points_to.clone(), |_, &x, &z| Some((x, z)))
            .arrange_by_key()
            .join_core(points_to, |_, &z, &w| Some((z, w)));
        address_of
            .enter(scope)
            .concat(copied)
            .concat(loaded)
            .concat(stored)
            .distinct()
    })
}

fn city<'s>(base: &Base<'_, 's>) -> [Ones<'s>; 4] {
    let keyed = |ones: Ones<'s>| ones.map(|x| (x, ()));
    let without = |ones: Ones<'s>, other: &Ones<'s>| keyed(ones).antijoin(other.clone()).map(|(x, ())| x);
    // Of (x, y), those with y in the second.
    let to = |pairs: Pairs<'s>, ones: &Ones<'s>| pairs.map(|(x, y)| (y, x)).semijoin(ones.clone()).map(|(y, x)| (x, y));
    let both = |pairs: Pairs<'s>, other: Pairs<'s>| pairs.map(|pair| (pair, ())).semijoin(other).map(|(pair, ())| pair);
    let first = |pairs: Pairs<'s>| pairs.map(|(x, _)| x);
    let back = |pairs: Pairs<'s>| pairs.map(|(x, y)| (y, x));

    let [
        pedestrian,
        car,
        ambulance,
        bus,
        police,
        tiro,
        reckless,
        old,
        young,
        at_inter,
        in_inter,
    ] = [
        "IsPedestrian",
        "IsCar",
        "IsAmbulance",
        "IsBus",
        "IsPolice",
        "IsTiro",
        "IsReckless",
        "IsOld",
        "IsYoung",
        "IsAtInter",
        "IsInInter",
    ]
    .map(|name| base.ones(name));
    let [close, next_to, higher_pri, colliding, left_of, right_of, sees] = [
        "IsClose",
        "NextTo",
        "HigherPri",
        "CollidingClose",
        "LeftOf",
        "RightOf",
        "Sees",
    ]
    .map(|name| base.pairs(name));
    let sees_from = |ones: Ones<'s>| sees.clone().semijoin(ones);
    let lawful = |ones: &Ones<'s>| without(without(ones.clone(), &ambulance), &old);
    let away = |ones: &Ones<'s>| without(without(ones.clone(), &in_inter), &at_inter);

    let waiting = sees_from(lawful(&at_inter));
    let stop = first(to(waiting.clone(), &in_inter))
        .concat(first(both(to(waiting, &at_inter), back(higher_pri))))
        .concat(first(to(to(sees_from(lawful(&in_inter)), &in_inter), &ambulance)))
        .concat(first(both(
            to(sees_from(ambulance.clone()), &old),
            back(right_of.clone()),
        )))
        .concat(first(both(
            colliding.semijoin(without(
                without(sees.clone().map(|(x, _)| x).distinct(), &ambulance),
                &old,
            )),
            sees.clone(),
        )))
        .concat(first(both(
            both(to(sees_from(away(&bus)), &pedestrian), back(right_of)),
            back(next_to.clone()),
        )))
        .concat(first(both(
            both(
                to(sees_from(away(&without(without(car, &ambulance), &police))), &police),
                back(left_of),
            ),
            back(close.clone()),
        )))
        .distinct();

    let beginner = without(tiro, &stop);
    let patrol = without(police, &stop);
    // (x, y) with a young y; then (x, z) with z next to such a y.
    let children = to(sees_from(patrol.clone()), &young);
    let beside = children
        .map(|(x, y)| (y, x))
        .join_map(to(next_to, &young), |_, &x, &z| (x, z));
    let slow = first(both(to(close.semijoin(beginner.clone()), &pedestrian), sees.clone()))
        .concat(first(to(
            sees_from(keyed(beginner).semijoin(in_inter.clone()).map(|(x, ())| x)),
            &at_inter,
        )))
        .concat(first(both(beside, sees.clone())))
        .distinct();

    let fast = first(to(
        sees_from(without(without(reckless.clone(), &stop), &slow)),
        &at_inter,
    ))
    .concat(without(without(bus, &stop), &slow))
    .concat(first(to(sees_from(without(patrol, &slow)), &reckless)))
    .distinct();

    let all = sees.filter(|(x, y)| x == y).map(|(x, _)| x);
    let normal = without(without(without(all, &stop), &slow), &fast);
    [stop, slow, fast, normal]
}
