//! `{colliding: {...}}`: the first is about to run into the second, which lies ahead of it within a narrow angle. The
//! predicate may hold with a probability.
//!
//! The fast form tests only the smallest rectangle of cells in which the definition can hold.

use crate::city::{AgentKind, Cell, CityMap, Heading};
use crate::diag::Diagnostic;
#[cfg(test)]
use crate::predicate::Definition;
use crate::predicate::{PairKind, Phrase, PredicateKind, Reach, Relation, Sight, Subject, Syntax, Views};
use crate::yaml::YamlNode;
use crate::yaml::read::{Fields, number};
use serde::Serialize;
use std::sync::Arc;

/// The first is about to run into the second.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Colliding {
    /// Maximum distance in cells if the first is a car.
    pub car_range: f64,
    /// Maximum distance in cells if the first is a pedestrian.
    pub pedestrian_range: f64,
    /// Exclusive upper bound, in radians, of the angle between the first's heading and the direction to the second.
    pub angle: f64,
    /// Probability that the predicate holds if the first is a pedestrian.
    pub pedestrian_chance: f64,
    /// Probability that the predicate holds if both are on one cell.
    pub same_cell_chance: f64,
}

impl PredicateKind for Colliding {
    const SYNTAX: Syntax = Syntax::Keys(&["colliding"], |nodes, faults| Some(read(nodes[0], faults)?.into()));

    fn phrase(&self) -> Phrase {
        Phrase::new("is about to run into").meaning(format!(
            "An agent can only be about to run into another one that is straight ahead of it: a car at most {} cells, a \
             pedestrian at most {} cells away.",
            self.car_range, self.pedestrian_range
        ))
    }

    #[cfg(test)]
    fn samples() -> Vec<Definition> {
        let colliding = |angle, chance| Colliding {
            car_range: 8.0,
            pedestrian_range: 3.0,
            angle,
            pedestrian_chance: chance,
            same_cell_chance: chance,
        };
        vec![
            colliding(0.1, 1.0).into(),
            colliding(0.6, 0.5).into(),
            colliding(2.0, 0.0).into(),
        ]
    }
}

fn read(node: &YamlNode, faults: &mut Vec<Diagnostic>) -> Option<Colliding> {
    let mut fields = Fields::open(node, "the definition of a collision", faults)?;
    let mut value = |key, most: f64, what| {
        fields
            .required(key, faults)
            .and_then(|node| number(node, 0.0..=most, what, faults))
    };
    let car_range = value("car_range", 1e9, "a distance from 0 to 1e9 cells");
    let pedestrian_range = value("pedestrian_range", 1e9, "a distance from 0 to 1e9 cells");
    let angle = value("angle", 3.2, "an angle from 0 to 3.2 radians");
    let pedestrian_chance = value("pedestrian_chance", 1.0, "a probability from 0 to 1");
    let same_cell_chance = value("same_cell_chance", 1.0, "a probability from 0 to 1");
    fields.close(faults);
    Some(Colliding {
        car_range: car_range?,
        pedestrian_range: pedestrian_range?,
        angle: angle?,
        pedestrian_chance: pedestrian_chance?,
        same_cell_chance: same_cell_chance?,
    })
}

impl Colliding {
    fn range(&self, kind: AgentKind) -> f64 {
        match kind {
            AgentKind::Car => self.car_range,
            AgentKind::Pedestrian => self.pedestrian_range,
        }
    }

    /// Returns the probability that the predicate holds for two agents.
    fn probability(&self, x: &Subject, y: &Subject) -> f64 {
        let Some(heading) = x.heading else { return 0.0 };
        if x.at.distance(y.at) > self.range(x.kind) {
            0.0
        } else if x.at == y.at {
            self.same_cell_chance
        } else if angle_between(heading, x.at, y.at) < self.angle {
            match x.kind {
                AgentKind::Car => 1.0,
                AgentKind::Pedestrian => self.pedestrian_chance,
            }
        } else {
            0.0
        }
    }
}

impl PairKind for Colliding {
    type Relation = Box<Cones>;

    const READS: [bool; 2] = [true, false];

    const DRAWN: bool = true;

    fn holds(&self, _: Sight<'_>, x: &Subject, y: &Subject, draw: impl FnOnce(f64) -> bool) -> bool {
        draw(self.probability(x, y))
    }

    fn relation(&self, _: &Arc<CityMap>) -> Box<Cones> {
        let cones = |kind| Heading::ALL.map(|heading| cone(self, kind, heading));
        Box::new(Cones {
            cones: AgentKind::ALL.map(cones),
            definition: *self,
        })
    }

    fn horizon(&self, _: u32) -> f64 {
        self.car_range.max(self.pedestrian_range)
    }
}

/// The definition, and the possible cells of the second agent by kind and heading of the first.
#[derive(Clone, Debug)]
pub(crate) struct Cones {
    cones: [[[i32; 4]; 4]; 2],
    definition: Colliding,
}

impl Relation for Box<Cones> {
    #[inline]
    fn reach(&self, _: &Views, kind: AgentKind, heading: Option<Heading>) -> Reach {
        heading.map_or(Reach::Nowhere, |heading| {
            Reach::Within(self.cones[kind as usize][heading as usize])
        })
    }

    #[inline]
    fn test(&self, x: &Subject, y: &Subject, draw: impl FnOnce(f64) -> bool) -> bool {
        draw(self.definition.probability(x, y))
    }
}

/// Returns the smallest rectangle that contains all cells of possible collisions for this kind and heading.
fn cone(definition: &Colliding, kind: AgentKind, heading: Heading) -> [i32; 4] {
    /// Beyond this range, in cells, the full square is used instead of testing single cells.
    const LOOK: i32 = 32;
    #[allow(clippy::cast_possible_truncation)] // a number beyond the limits becomes the limit
    let range = (definition.range(kind).max(0.0).floor() as i32).min(Reach::FARTHEST);
    if range > LOOK {
        return [range; 4];
    }
    let agent = |at| Subject {
        kind,
        priority: 0,
        at,
        heading: Some(heading),
    };
    let here = agent(Cell::new(0, 0));
    let mut reach = [0; 4];
    for row in -range..=range {
        for col in -range..=range {
            if definition.probability(&here, &agent(Cell::new(row, col))) > 0.0 {
                for (reach, cells) in reach.iter_mut().zip([-row, row, -col, col]) {
                    *reach = cells.max(*reach);
                }
            }
        }
    }
    reach
}

/// Returns the angle between a heading and the direction from one cell to another, in radians, 0 to pi.
#[allow(clippy::cast_precision_loss)] // exact: offsets fit 33 bits
fn angle_between(heading: Heading, from: Cell, to: Cell) -> f64 {
    let (dr, dc) = heading.delta();
    let (dr, dc) = (i64::from(dr), i64::from(dc));
    let (rr, rc) = to.offset_from(from);
    ((dr * rc - dc * rr).abs() as f64).atan2((dr * rr + dc * rc) as f64)
}
