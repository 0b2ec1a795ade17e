//! Grounding: from the state of the agents to the base facts that are true in it.
//!
//! This is the definition of every base predicate, written to be read.

use crate::cancel::Cancel;
use crate::city::AgentKind;
use crate::city::{Cell, CityMap, Heading, field_of_view};
use crate::config::Definition;
use crate::sim::vocabulary::{Predicate, Vocabulary};

/// What the predicates can see of an agent.
#[derive(Clone, Copy, Debug)]
pub struct Entity<'a> {
    /// Car or pedestrian.
    pub kind: AgentKind,
    /// Names of its concepts.
    pub concepts: &'a [String],
    /// Right of way; a smaller number goes first.
    pub priority: i32,
    /// Where it is.
    pub at: Cell,
    /// The direction of its last move; none before the first.
    pub heading: Option<Heading>,
}

/// The true rows of each predicate of a [`Vocabulary`], in its order. A row holds positions in the list of entities; the second
/// is 0 where the predicate has only one column. Rows are sorted.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Facts {
    /// The rows of each predicate.
    pub rows: Vec<Vec<[u32; 2]>>,
}

/// Decides whether a predicate that holds only with a probability holds now, for the pair (first, second) of entities.
pub trait Chance {
    /// `predicate` is its position in the vocabulary; `probability` is in 0..=1.
    fn happens(&self, predicate: usize, first: usize, second: usize, probability: f64) -> bool;
}

/// The facts that are true of `entities` on `map`. `view` is the half-width of the field of view in cells. The predicates for
/// which `skip` holds are left empty.
pub fn ground(
    vocabulary: &Vocabulary,
    map: &CityMap,
    view: u32,
    entities: &[Entity<'_>],
    chance: &impl Chance,
    skip: impl Fn(usize) -> bool,
) -> Facts {
    let facts = ground_with(vocabulary, map, view, entities, chance, skip, &Cancel::never());
    facts.expect("never cancelled")
}

/// Cancellable variant of [`ground`], `None` on cancellation. Polls `cancel` for every entity.
pub(super) fn ground_with(
    vocabulary: &Vocabulary,
    map: &CityMap,
    view: u32,
    entities: &[Entity<'_>],
    chance: &impl Chance,
    skip: impl Fn(usize) -> bool,
    cancel: &Cancel,
) -> Option<Facts> {
    let mut facts = Facts {
        rows: vec![Vec::new(); vocabulary.predicates.len()],
    };
    for (index, Predicate { definition, arity, .. }) in vocabulary.predicates.iter().enumerate() {
        if skip(index) {
            continue;
        }
        let rows = &mut facts.rows[index];
        for (x, first) in entities.iter().enumerate() {
            if cancel.requested() {
                return None;
            }
            if *arity == 1 {
                if unary(definition, map, first) {
                    rows.push([number(x), 0]);
                }
                continue;
            }
            let field = field_of_view(first.at, first.heading, view, map);
            for (y, second) in entities.iter().enumerate() {
                let holds = match definition {
                    Definition::Sees => x == y || field.contains(second.at),
                    _ if x == y => false,
                    _ => {
                        let probability = binary(definition, first, second);
                        probability >= 1.0 || (probability > 0.0 && chance.happens(index, x, y, probability))
                    }
                };
                if holds {
                    rows.push([number(x), number(y)]);
                }
            }
        }
    }
    Some(facts)
}

fn number(index: usize) -> u32 {
    u32::try_from(index).expect("fewer than 2^32 entities")
}

pub(super) fn unary(definition: &Definition, map: &CityMap, x: &Entity<'_>) -> bool {
    match definition {
        Definition::Kind(kind) => x.kind == *kind,
        Definition::Concept { of, concept } => x.kind == *of && x.concepts.contains(concept),
        Definition::AtIntersection => map.at_intersection(x.kind, x.at).is_some(),
        Definition::InIntersection => map.in_intersection(x.at).is_some(),
        _ => unreachable!("a binary definition"),
    }
}

/// The probability that a binary predicate holds of two different entities.
pub(super) fn binary(definition: &Definition, x: &Entity<'_>, y: &Entity<'_>) -> f64 {
    let holds = match definition {
        Definition::Distance { .. } => {
            let d = x.at.distance(y.at);
            is_far_enough(definition, d) && is_near_enough(definition, d)
        }
        Definition::HigherPriority => x.priority < y.priority,
        Definition::LeftOf => side(x, y) > 0,
        Definition::RightOf => side(x, y) < 0,
        Definition::Colliding {
            car_range,
            pedestrian_range,
            angle,
            pedestrian_chance,
            same_cell_chance,
        } => {
            let Some(heading) = x.heading else { return 0.0 };
            let (range, chance) = match x.kind {
                AgentKind::Car => (*car_range, 1.0),
                AgentKind::Pedestrian => (*pedestrian_range, *pedestrian_chance),
            };
            let d = x.at.distance(y.at);
            return if d > range {
                0.0
            } else if x.at == y.at {
                *same_cell_chance
            } else if angle_between(heading, x.at, y.at) < *angle {
                chance
            } else {
                0.0
            };
        }
        _ => unreachable!("a unary definition, or the field of view"),
    };
    f64::from(u8::from(holds))
}

/// Whether a distance is within the lower bounds of a predicate. What is not by distance has none.
pub(super) fn is_far_enough(definition: &Definition, d: f64) -> bool {
    let Definition::Distance { above, at_least, .. } = definition else {
        return true;
    };
    above.is_none_or(|bound| d > bound) && at_least.is_none_or(|bound| d >= bound)
}

/// Whether a distance is within the upper bounds of a predicate. What is not by distance has none.
pub(super) fn is_near_enough(definition: &Definition, d: f64) -> bool {
    let Definition::Distance { below, at_most, .. } = definition else {
        return true;
    };
    below.is_none_or(|bound| d < bound) && at_most.is_none_or(|bound| d <= bound)
}

/// Where x lies, seen along y's heading: see [`side_of`]. Zero if y has no heading.
pub(super) fn side(x: &Entity<'_>, y: &Entity<'_>) -> i64 {
    y.heading.map_or(0, |heading| side_of(heading, x.at, y.at))
}

/// Where x lies, seen from y along a heading (dr, dc): positive left, negative right, zero straight. With (rr, rc) = x - y it is
/// dr * rc - dc * rr.
pub(super) fn side_of(heading: Heading, x: Cell, y: Cell) -> i64 {
    let (dr, dc) = heading.delta();
    let (rr, rc) = x.offset_from(y);
    i64::from(dr) * rc - i64::from(dc) * rr
}

/// The angle between a heading and the way between two different cells, in radians, 0 to pi.
#[allow(clippy::cast_precision_loss)] // exact: offsets fit 33 bits
fn angle_between(heading: Heading, from: Cell, to: Cell) -> f64 {
    let (dr, dc) = heading.delta();
    let (dr, dc) = (i64::from(dr), i64::from(dc));
    let (rr, rc) = to.offset_from(from);
    ((dr * rc - dc * rr).abs() as f64).atan2((dr * rr + dc * rc) as f64)
}
