//! What the definitions of predicates exclude and imply, whatever the agents do.

use crate::city::{AgentKind, Cell, CityMap, Heading};
use crate::predicate::{Definition, Pair, PairRelation, Relation as _, Subject, Views, with_relation};
use std::cell;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

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
    /// For each definition, its bit; `None` for predicates over one agent, for those that depend on the places of two
    /// agents, and beyond [`PAIRS_MAX`] and [`DRAWN_MAX`].
    bits: Vec<Option<u32>>,
    reflexive: Vec<bool>,
    found: Found,
    /// Whether these are all situations.
    pub complete: bool,
    /// Cells on which agents of each kind can be, in the order of [`AgentKind::ALL`]: all situations of one agent, as
    /// far as predicates over one agent distinguish them.
    pub cells: [Vec<Cell>; 2],
    /// Whether the cells distinguish the truth values of [places](crate::predicate::Place).
    pub distinguish_places: bool,
}

/// The maximum number of predicates over two agents.
const PAIRS_MAX: usize = 64;

/// The maximum number of predicates that hold with a probability. Each floats_64 the truth values of a situation.
const DRAWN_MAX: u32 = 4;

/// The maximum distance of two agents in rows and in columns. Beyond it, the situations are incomplete.
const OFFSET_MAX: i32 = 100;

/// The maximum distance of two agents in one row or column.
const AXIS_MAX: i32 = 5_000;

/// The kind and heading of an agent.
type Pose = (AgentKind, Option<Heading>);

/// The predicates that hold in a situation: those for two agents in this order, and [`REVERSED`] bits higher those for
/// them in the other order.
type Bits = u128;

const REVERSED: u32 = u64::BITS;

/// What can be true at once: for each pair of predicates, whether some situation has the first, with or without the
/// second.
#[derive(Clone, Debug, Default)]
struct Found {
    /// By the bit of a predicate: what holds in some situation in which it does.
    with: Vec<Bits>,
    /// By the bit of a predicate: what does not hold in some situation in which it does.
    without: Vec<Bits>,
    /// By two bits, and whether the second holds: the nearest offset in rows and columns from the first agent to the
    /// second.
    examples: BTreeMap<(u32, u32, bool), [i32; 2]>,
}

impl Found {
    /// Adds situations in which the predicate `one` holds with each of the predicates `with`, and without each of
    /// `without`.
    fn add(&mut self, one: u32, with: Bits, without: Bits, offset: [i32; 2]) {
        for (known, more, holds) in [(&mut self.with, with, true), (&mut self.without, without, false)] {
            let known = &mut known[one as usize];
            for other in ones(more & !*known) {
                self.examples.insert((one, other, holds), offset);
            }
            *known |= more;
        }
    }

    fn together(&self, one: u32, other: u32) -> Together {
        let has = |list: &[Bits], one: u32, other: u32| list[one as usize] >> other & 1 != 0;
        Together {
            both: has(&self.with, one, other),
            first_only: has(&self.without, one, other),
            // The situations of two agents include those of the two in the other order.
            second_only: match other.checked_sub(REVERSED) {
                None => has(&self.without, other, one),
                Some(other) => has(&self.without, other, one + REVERSED),
            },
        }
    }
}

/// Returns the positions of the ones among the bits.
fn ones(mut bits: Bits) -> impl Iterator<Item = u32> {
    std::iter::from_fn(move || {
        let lowest = (bits != 0).then(|| bits.trailing_zeros())?;
        bits &= bits - 1;
        Some(lowest)
    })
}

impl Situations {
    /// Returns the situations of agents of these kinds.
    ///
    /// `definitions` are those of predicates. A field of view extends `half_width` cells.
    pub fn new<'d>(
        definitions: impl Iterator<Item = &'d Definition>,
        kinds: &[AgentKind],
        map: &Arc<CityMap>,
        half_width: u32,
    ) -> Situations {
        let views = Views::new(half_width);
        let mut pairs: Vec<&Pair> = Vec::new();
        let (mut bits, mut reflexive, mut areas) = (Vec::new(), Vec::new(), Vec::new());
        for definition in definitions {
            reflexive.push(definition.is_reflexive());
            if let Definition::Place(place) = definition {
                areas.push(place.area(map));
            }
            bits.push(match definition {
                Definition::Pair(pair) if pairs.len() < PAIRS_MAX && pair.reads() != [true; 2] => {
                    pairs.push(pair);
                    Some(pairs.len() as u32 - 1)
                }
                _ => None,
            });
        }
        let relations = pairs.iter().map(|pair| pair.relation(map)).collect::<Vec<_>>();
        let mut search = SituationSearch {
            groups: groups(&pairs),
            found: Found {
                with: vec![0; relations.len()],
                without: vec![0; relations.len()],
                examples: BTreeMap::new(),
            },
            relations,
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
        };
        // Beyond the horizon only the direction matters, so one more row and column shows all there is.
        let horizon = pairs.iter().map(|pair| pair.horizon(half_width)).fold(0.0, f64::max);
        #[allow(clippy::cast_possible_truncation)] // a number beyond the limits becomes the limit
        let horizon = (horizon.min(1e6).ceil() as i32).saturating_add(1);
        let largest = horizon.min(OFFSET_MAX);
        let [rows, cols] = [map.rows(), map.cols()].map(|cells| (cells - 1).min(largest));
        let is_seen = |cells: i32| largest == horizon || cells - 1 <= largest;
        let complete = is_seen(map.rows()) && is_seen(map.cols());
        let offsets = (-rows..=rows).flat_map(|row| (-cols..=cols).map(move |col| [row, col]));
        let mut offsets: Vec<[i32; 2]> = offsets.collect();
        // The examples are the nearest ones, and of these one with positive numbers.
        offsets.sort_by_key(|&[row, col]| (row.abs() + col.abs(), [-row, -col]));
        offsets.into_iter().for_each(|offset| search.add(offset));
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
        let distinct = |areas| {
            let cells = AgentKind::ALL.map(|kind| map.distinct_cells(kind, areas));
            let [Some(of_cars), Some(of_pedestrians)] = cells else {
                return None;
            };
            Some([of_cars, of_pedestrians])
        };
        let cells = distinct(&areas);
        Situations {
            distinguish_places: cells.is_some(),
            cells: cells.or_else(|| distinct(&[])).unwrap_or_default(),
            bits: bits.into_iter().map(|bit| bit.filter(is_known)).collect(),
            reflexive,
            found: search.found,
            complete,
        }
    }

    /// Returns whether the situations decide about the predicate.
    pub fn covers(&self, predicate: usize) -> bool {
        self.bits[predicate].is_some()
    }

    /// Returns the truth values that two predicates can have for two agents, or for one agent and itself. Without
    /// [`Situations::complete`] there may be more.
    pub fn pair(&self, one: usize, other: usize) -> Together {
        let (Some(a), Some(b)) = (self.bits[one], self.bits[other]) else {
            return Together::default();
        };
        let mut together = self.found.together(a, b);
        together.add(self.reflexive[one], self.reflexive[other]);
        together
    }

    /// Returns the truth values that a predicate can have for two agents and for these in the other order.
    pub fn reversed(&self, one: usize) -> Together {
        let bit = self.bits[one];
        bit.map_or_else(Together::default, |bit| self.found.together(bit, bit + REVERSED))
    }

    /// Returns the offset of two agents in a situation in which the first predicate holds, and the second does or does
    /// not; with `other` `None`, the first in the other order.
    pub fn example(&self, one: usize, other: Option<usize>, holds: bool) -> Option<[i32; 2]> {
        let first = self.bits[one]?;
        let second = match other {
            Some(other) => self.bits[other]?,
            None => first + REVERSED,
        };
        self.found.examples.get(&(first, second, holds)).copied()
    }
}

/// Relations whose truth values depend on the same properties of the agents besides their offset, in both orders of the
/// agents. The truth values of different groups are independent of each other.
#[derive(Clone, Debug, Default)]
struct Group {
    /// The relations for the agents in the given order.
    given: Vec<usize>,
    /// Those for the agents in the other order.
    reversed: Vec<usize>,
    /// All of them.
    members: Bits,
}

impl Group {
    fn new(given: Vec<usize>, reversed: Vec<usize>) -> Group {
        let bits = |list: &[usize]| list.iter().fold(0, |bits: Bits, &at| bits | 1 << at);
        Group {
            members: bits(&given) | bits(&reversed) << REVERSED,
            given,
            reversed,
        }
    }
}

/// Returns the relations that read kind and heading of the first agent, of the second one, and of neither.
fn groups(pairs: &[&Pair]) -> [Group; 3] {
    let reads: Vec<[bool; 2]> = pairs.iter().map(|pair| pair.reads()).collect();
    let only = |wanted: [bool; 2]| -> Vec<usize> { (0..reads.len()).filter(|&at| reads[at] == wanted).collect() };
    let [of_none, of_x, of_y] = [[false, false], [true, false], [false, true]].map(only);
    [
        Group::new(of_x.clone(), of_y.clone()),
        Group::new(of_y, of_x),
        Group::new(of_none.clone(), of_none),
    ]
}

struct SituationSearch {
    relations: Vec<PairRelation>,
    /// The relations of the first agent, of the second one, and of neither.
    groups: [Group; 3],
    poses: Vec<Pose>,
    views: Views,
    /// The relations that hold with a probability in some situation, as bits: at most [`DRAWN_MAX`].
    drawn: cell::Cell<u64>,
    /// The further ones, as bits. Situations ignore them.
    skipped: cell::Cell<u64>,
    found: Found,
}

impl SituationSearch {
    /// Adds the situations of two agents with this offset.
    fn add(&mut self, offset: [i32; 2]) {
        let pose = self.poses.first().copied().unwrap_or((AgentKind::Car, None));
        let [of_first, of_second, of_neither] = &self.groups;
        let (mut first, mut second, mut neither): (BTreeSet<Bits>, BTreeSet<Bits>, BTreeSet<Bits>) = Default::default();
        for [one, other] in [[1, 2], [1, 1], [2, 1]] {
            self.values(of_neither, offset, [(pose, one), (pose, other)], &mut neither);
        }
        for &own in &self.poses {
            self.values(of_first, offset, [(own, 1), (pose, 1)], &mut first);
            self.values(of_second, offset, [(pose, 1), (own, 1)], &mut second);
        }
        let possible = [first, second, neither];
        if possible.iter().any(BTreeSet::is_empty) {
            return;
        }
        let all = self.groups.iter().fold(0, |all, group| all | group.members);
        let any = |values: &BTreeSet<Bits>| values.iter().fold(0, |any, value| any | value);
        let can_hold = possible.iter().fold(0, |can, values| can | any(values));
        let can_fail = possible.iter().zip(&self.groups).fold(0, |can, (values, group)| {
            can | values.iter().fold(0, |any, value| any | group.members & !value)
        });
        for (group, values) in self.groups.iter().zip(&possible) {
            let others = all & !group.members;
            for value in values {
                for one in ones(value & Bits::from(u64::MAX)) {
                    let (with, without) = (value | can_hold & others, group.members & !value | can_fail & others);
                    self.found.add(one, with, without, offset);
                }
            }
        }
    }

    /// Adds the possible truth values of a group for two agents with this offset, given pose and priority of each.
    fn values(&self, group: &Group, offset: [i32; 2], agents: [(Pose, i32); 2], into: &mut BTreeSet<Bits>) {
        let [x, y] = agents;
        let given = self.possible(&group.given, offset, [x, y]);
        let reversed = self.possible(&group.reversed, offset.map(|cells| -cells), [y, x]);
        for one in given {
            into.extend(
                reversed
                    .iter()
                    .map(|&other| Bits::from(one) | Bits::from(other) << REVERSED),
            );
        }
    }

    /// Returns the possible truth values of relations for two agents with this offset, as bits. More than one is
    /// possible if a relation holds with a probability.
    fn possible(&self, relations: &[usize], offset: [i32; 2], poses: [(Pose, i32); 2]) -> Vec<u64> {
        let subject = |((kind, heading), priority): (Pose, i32), at| Subject {
            kind,
            priority,
            at,
            heading,
        };
        let x = subject(poses[0], Cell::new(0, 0));
        let y = subject(poses[1], Cell::new(offset[0], offset[1]));
        let mut values = vec![0];
        for &at in relations {
            let test = |least: f64| {
                let draw = |probability: f64| probability > least || probability >= 1.0;
                with_relation!(&self.relations[at], relation => relation.holds(&self.views, &x, &y, draw))
            };
            let bit = 1 << at;
            match (test(0.0), test(1.0)) {
                (_, true) => values.iter_mut().for_each(|value| *value |= bit),
                (true, false) if self.admits_drawn(at) => {
                    for index in 0..values.len() {
                        values.push(values[index] | bit);
                    }
                }
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
