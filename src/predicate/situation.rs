//! What the definitions of predicates exclude and imply, whatever the agents do.

use crate::city::{AgentKind, Cell, CityMap, Heading, Junction};
use crate::predicate::{Definition, Pair, PairRelation, Relation as _, Subject, Views, with_relation};
use std::cell;
use std::collections::{BTreeMap, BTreeSet};

/// The pairs of truth values that two predicates can have at once.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Together {
    /// Both can hold.
    pub both: bool,
    /// The first can hold without the second.
    pub first_only: bool,
    /// The second can hold without the first.
    pub second_only: bool,
}

impl Together {
    /// Adds what one situation shows.
    pub fn add(&mut self, first: bool, second: bool) {
        self.both |= first && second;
        self.first_only |= first && !second;
        self.second_only |= !first && second;
    }
}

/// The situations of two different agents on a map, as far as predicates over two agents distinguish them.
#[derive(Clone, Debug)]
pub struct Situations {
    /// For each definition, its bit; `None` for predicates over one agent, and beyond [`PAIRS_MAX`] and [`DRAWN_MAX`].
    bits: Vec<Option<u32>>,
    reflexive: Vec<bool>,
    /// The predicates that hold for two agents in this order, and in the other order, as bits; with an offset in rows
    /// and columns from the first agent to the second for which they do.
    found: BTreeMap<[u64; 2], [i32; 2]>,
    /// Whether these are all situations.
    pub complete: bool,
    /// The junctions on which agents of each kind can be, in the order of [`AgentKind::ALL`].
    pub junctions: [Vec<Junction>; 2],
}

/// The maximum number of predicates over two agents.
const PAIRS_MAX: usize = 64;

/// The maximum number of predicates that hold with a probability. Each doubles the truth values of a situation.
const DRAWN_MAX: u32 = 4;

/// The maximum distance of two agents in rows and in columns. Beyond it, the situations are incomplete.
const OFFSET_MAX: i32 = 100;

/// The maximum distance of two agents in one row or column.
const AXIS_MAX: i32 = 5_000;

/// The kind and heading of an agent.
type Pose = (AgentKind, Option<Heading>);

/// For one agent of a pair: the bits of predicates in the given order of the agents and in the other order.
type Bits = [u64; 2];

impl Situations {
    /// Returns the situations of agents of these kinds.
    ///
    /// `definitions` are those of predicates. A field of view extends `half_width` cells.
    pub fn new<'d>(
        definitions: impl Iterator<Item = &'d Definition>,
        kinds: &[AgentKind],
        map: &CityMap,
        half_width: u32,
    ) -> Situations {
        let views = Views::new(half_width);
        let mut pairs: Vec<&Pair> = Vec::new();
        let (mut bits, mut reflexive) = (Vec::new(), Vec::new());
        for definition in definitions {
            reflexive.push(definition.is_reflexive());
            bits.push(match definition {
                Definition::Pair(pair) if pairs.len() < PAIRS_MAX => {
                    pairs.push(pair);
                    Some(pairs.len() as u32 - 1)
                }
                _ => None,
            });
        }
        let mut search = Search {
            relations: pairs.iter().map(|pair| pair.relation()).collect(),
            reads: pairs.iter().map(|pair| pair.reads()).collect(),
            poses: kinds
                .iter()
                .flat_map(|&kind| {
                    let headings = std::iter::once(None).chain(Heading::ALL.map(Some));
                    headings.map(move |heading| (kind, heading))
                })
                .collect(),
            views,
            drawn: cell::Cell::new(0),
            skipped: cell::Cell::new(0),
            found: BTreeMap::new(),
        };
        // Beyond the horizon only the direction matters, so one more row and column shows all there is.
        let horizon = pairs.iter().map(|pair| pair.horizon(half_width)).fold(0.0, f64::max);
        #[allow(clippy::cast_possible_truncation)] // a number beyond the limits becomes the limit
        let horizon = (horizon.min(1e6).ceil() as i32).saturating_add(1);
        let largest = horizon.min(OFFSET_MAX);
        let [rows, cols] = [map.rows(), map.cols()].map(|cells| (cells - 1).min(largest));
        let is_seen = |cells: i32| largest == horizon || cells - 1 <= largest;
        let complete = is_seen(map.rows()) && is_seen(map.cols());
        for row in -rows..=rows {
            for col in -cols..=cols {
                search.add([row, col]);
            }
        }
        // Farther away, situations along rows and columns still contradict constraints.
        let farther = |cells: i32| largest + 1..cells.min(AXIS_MAX).min(horizon.saturating_add(1));
        for row in farther(map.rows()) {
            search.add([row, 0]);
            search.add([-row, 0]);
        }
        for col in farther(map.cols()) {
            search.add([0, col]);
            search.add([0, -col]);
        }
        let skipped = search.skipped.get();
        let is_known = |bit: &u32| skipped >> bit & 1 == 0;
        Situations {
            bits: bits.into_iter().map(|bit| bit.filter(is_known)).collect(),
            reflexive,
            found: search.found,
            complete,
            junctions: AgentKind::ALL.map(|kind| map.junctions(kind)),
        }
    }

    /// Returns whether the situations decide about the predicate.
    pub fn covers(&self, predicate: usize) -> bool {
        self.bits[predicate].is_some()
    }

    /// Returns the truth values that two predicates can have for two agents, or for one agent and itself. Without
    /// [`Situations::complete`] there may be more.
    pub fn pair(&self, one: usize, other: usize) -> Together {
        let mut together = Together::default();
        if let (Some(a), Some(b)) = (self.bits[one], self.bits[other]) {
            together.add(self.reflexive[one], self.reflexive[other]);
            self.found
                .keys()
                .for_each(|[given, _]| together.add(given >> a & 1 != 0, given >> b & 1 != 0));
        }
        together
    }

    /// Returns the truth values that a predicate can have for two agents and for these in the other order.
    pub fn reversed(&self, one: usize) -> Together {
        let mut together = Together::default();
        if let Some(bit) = self.bits[one] {
            self.found
                .keys()
                .for_each(|bits| together.add(bits[0] >> bit & 1 != 0, bits[1] >> bit & 1 != 0));
        }
        together
    }

    /// Returns the offset of two agents in a situation in which the first predicate holds, and the second does or does
    /// not; with `other` `None`, the first in the other order.
    pub fn example(&self, one: usize, other: Option<usize>, holds: bool) -> Option<[i32; 2]> {
        let (a, b) = (self.bits[one]?, self.bits[other.unwrap_or(one)]?);
        let wanted = |[given, reversed]: &[u64; 2]| {
            let second = if other.is_some() { given } else { reversed };
            given >> a & 1 != 0 && (second >> b & 1 != 0) == holds
        };
        let mut found = self.found.iter().filter(|(bits, _)| wanted(bits));
        found.next().map(|(_, offset)| *offset)
    }
}

struct Search {
    relations: Vec<PairRelation>,
    /// By relation: whether kind and heading of the first and of the second agent matter.
    reads: Vec<[bool; 2]>,
    poses: Vec<Pose>,
    views: Views,
    /// The relations that hold with a probability in some situation, as bits: at most [`DRAWN_MAX`].
    drawn: cell::Cell<u64>,
    /// The further ones, as bits. Situations ignore them.
    skipped: cell::Cell<u64>,
    found: BTreeMap<[u64; 2], [i32; 2]>,
}

impl Search {
    /// Adds the situations of two agents with this offset.
    fn add(&mut self, offset: [i32; 2]) {
        let back = offset.map(|cells| -cells);
        let pose = self.poses.first().copied().unwrap_or((AgentKind::Car, None));
        let only = |wanted: [bool; 2]| {
            let all = 0..self.relations.len();
            all.filter(|&at| self.reads[at] == wanted).collect::<Vec<usize>>()
        };
        let [of_none, of_x, of_y] = [[false, false], [true, false], [false, true]].map(only);
        let mut neither: BTreeSet<Bits> = BTreeSet::new();
        for priorities in [[1, 2], [1, 1], [2, 1]] {
            let [one, other] = priorities;
            let given = self.values(&of_none, offset, [(pose, one), (pose, other)]);
            let reversed = self.values(&of_none, back, [(pose, other), (pose, one)]);
            product(&given, &reversed, &mut neither);
        }
        let (mut of_first, mut of_second): (BTreeSet<Bits>, BTreeSet<Bits>) = Default::default();
        for &own in &self.poses {
            let (own, any) = ((own, 1), (pose, 1));
            let given = self.values(&of_x, offset, [own, any]);
            let reversed = self.values(&of_y, back, [any, own]);
            product(&given, &reversed, &mut of_first);
            let given = self.values(&of_y, offset, [any, own]);
            let reversed = self.values(&of_x, back, [own, any]);
            product(&given, &reversed, &mut of_second);
        }
        let parts = [&of_first, &of_second, &neither];
        let [of_first, of_second, neither] = parts.map(|part| part.iter().copied().collect::<Vec<Bits>>());
        for one in &of_first {
            for two in &of_second {
                for three in &neither {
                    let bits = [one[0] | two[0] | three[0], one[1] | two[1] | three[1]];
                    self.found.entry(bits).or_insert(offset);
                }
            }
        }
    }

    /// Returns the possible truth values of relations for two agents with this offset, as bits. More than one is
    /// possible if a relation holds with a probability.
    fn values(&self, relations: &[usize], offset: [i32; 2], poses: [(Pose, i32); 2]) -> BTreeSet<u64> {
        let subject = |((kind, heading), priority): (Pose, i32), at| Subject {
            kind,
            priority,
            at,
            heading,
        };
        let x = subject(poses[0], Cell::new(0, 0));
        let y = subject(poses[1], Cell::new(offset[0], offset[1]));
        let mut values = BTreeSet::from([0]);
        for &at in relations {
            let test = |least: f64| {
                let draw = |probability: f64| probability > least || probability >= 1.0;
                with_relation!(&self.relations[at], relation => relation.holds(&self.views, &x, &y, draw))
            };
            let (can_hold, must_hold) = (test(0.0), test(1.0));
            let with: BTreeSet<u64> = values.iter().map(|value| value | 1 << at).collect();
            match (can_hold, must_hold) {
                (_, true) => values = with,
                (true, false) if self.admits_drawn(at) => values.extend(with),
                _ => {}
            }
        }
        values
    }

    /// Returns whether situations include a relation that holds with a probability.
    fn admits_drawn(&self, at: usize) -> bool {
        let (drawn, bit) = (self.drawn.get(), 1 << at);
        let admits = drawn & bit != 0 || drawn.count_ones() < DRAWN_MAX;
        let list = if admits { &self.drawn } else { &self.skipped };
        list.set(list.get() | bit);
        admits
    }
}

fn product(given: &BTreeSet<u64>, reversed: &BTreeSet<u64>, into: &mut BTreeSet<Bits>) {
    for &one in given {
        into.extend(reversed.iter().map(|&other| [one, other]));
    }
}
