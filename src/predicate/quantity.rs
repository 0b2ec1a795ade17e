//! `{quantity: waited}`: a value of an agent, of two agents, or of the city. It is the last column of the predicate.
//!
//! A quantity has at most one value for the agents before it.

use crate::city::{Agent, AgentKind, CityMap, Heading, Light, RightOfWay};
#[cfg(test)]
use crate::predicate::Definition;
use crate::predicate::{Phrase, PredicateKind, Subject, Syntax};
use crate::yaml::read::choice;
use serde::{Serialize, Serializer};
use std::ops::Range;

/// A quantity.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quantity {
    /// The number of cells that the agent moved in the last tick; 0 in the first tick.
    Speed,
    /// The direction of the agent's last move; no value before the first move on a route.
    Heading,
    /// The agent's priority; a smaller number goes first.
    Priority,
    /// The number of ticks since the agent's last move, or since the start of the run.
    Waited,
    /// The number of cells to the agent's goal along its route.
    Remaining,
    /// The number of the intersection at or in which the agent is, from 1, row by row; no value elsewhere.
    Intersection,
    /// The direction in which the agent's route leaves the intersection at or in which it is, or else its next one; no
    /// value if the route ends before. The corners of the map count as intersections here.
    Exit,
    /// The speed limit on the agent's lane in km/h; no value for pedestrians, inside intersections, on lanes without
    /// one, and on a map of blocks.
    Limit,
    /// The light of the signal at the end of the agent's lane for its route, on a road network with signals; no value
    /// for pedestrians, inside intersections, and where no signal shows a light.
    Light,
    /// Whether the first of two cars on lanes of a road network must yield to the second on its route: `yields`, `first`
    /// if the second must yield, or `mutual`; no value if their ways do not meet in their next intersection.
    RightOfWay,
    /// The number of cells that the second of two cars on a road network drives until it has left the way of the first in
    /// their next intersection, or in the one in which they are; no value if their ways do not meet there, or no longer.
    Clearance,
    /// The Euclidean distance of two different agents in cells.
    Distance,
    /// The number of the tick, from 0.
    Tick,
}

/// The value of a quantity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Measure {
    Number(i32),
    Float(f32),
    Heading(Heading),
    Light(Light),
    RightOfWay(RightOfWay),
}

/// The type of the values of a quantity.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unit {
    /// A whole number.
    Number,
    /// A number with single precision.
    Float,
    /// One of some words.
    Word(Words),
}

/// The words that are values of a quantity.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Words {
    /// The names of headings: `Left`, `Right`, `Up` and `Down`.
    Headings,
    /// The names of lights: `red`, `yellow` and `green`.
    Lights,
    /// `yields`, `first` and `mutual`.
    RightsOfWay,
}

/// All words that are values of quantities.
pub(crate) const WORDS: [&str; 10] = [
    Heading::Left.name(),
    Heading::Right.name(),
    Heading::Up.name(),
    Heading::Down.name(),
    Light::Red.name(),
    Light::Yellow.name(),
    Light::Green.name(),
    RightOfWay::Yields.name(),
    RightOfWay::First.name(),
    RightOfWay::Mutual.name(),
];

impl Words {
    /// Returns their positions in [`WORDS`].
    pub(crate) const fn range(self) -> Range<u32> {
        match self {
            Words::Headings => 0..4,
            Words::Lights => 4..7,
            Words::RightsOfWay => 7..10,
        }
    }

    /// Returns what one of them is, for messages.
    pub(crate) const fn what(self) -> &'static str {
        match self {
            Words::Headings => "heading",
            Words::Lights => "light",
            Words::RightsOfWay => "right of way",
        }
    }

    /// Returns the words.
    pub(crate) fn names(self) -> &'static [&'static str] {
        let Range { start, end } = self.range();
        &WORDS[start as usize..end as usize]
    }

    /// Returns the position of one of them in [`WORDS`].
    pub(crate) fn find(self, name: &str) -> Option<u32> {
        self.range().find(|word| WORDS[*word as usize] == name)
    }
}

/// What an agent did before the present tick and what is before it. Only quantities read it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Progress {
    /// See [`Quantity::Speed`].
    pub speed: u32,
    /// See [`Quantity::Waited`].
    pub waited: u32,
    /// See [`Quantity::Remaining`].
    pub remaining: u32,
    /// See [`Quantity::Exit`].
    pub exit: Option<Heading>,
}

impl Progress {
    /// Returns the progress of an agent. Without the map it has no `exit`, for which the function looks along the route.
    pub(crate) fn of(agent: &Agent, map: Option<&CityMap>) -> Progress {
        Progress {
            speed: agent.speed.into(),
            waited: agent.waited,
            remaining: agent.remaining(),
            exit: map.and_then(|map| agent.exit(map)),
        }
    }
}

impl Quantity {
    /// All quantities.
    pub const ALL: [Quantity; 13] = [
        Quantity::Speed,
        Quantity::Heading,
        Quantity::Priority,
        Quantity::Waited,
        Quantity::Remaining,
        Quantity::Intersection,
        Quantity::Exit,
        Quantity::Limit,
        Quantity::Light,
        Quantity::RightOfWay,
        Quantity::Clearance,
        Quantity::Distance,
        Quantity::Tick,
    ];

    /// Returns the name in a configuration.
    pub const fn name(self) -> &'static str {
        match self {
            Quantity::Speed => "speed",
            Quantity::Heading => "heading",
            Quantity::Priority => "priority",
            Quantity::Waited => "waited",
            Quantity::Remaining => "remaining",
            Quantity::Intersection => "intersection",
            Quantity::Exit => "exit",
            Quantity::Limit => "limit",
            Quantity::Light => "light",
            Quantity::RightOfWay => "right_of_way",
            Quantity::Clearance => "clearance",
            Quantity::Distance => "distance",
            Quantity::Tick => "tick",
        }
    }

    /// Returns the number of agents that have the quantity together: 0 if it belongs to the city.
    pub const fn agents(self) -> usize {
        match self {
            Quantity::Tick => 0,
            Quantity::Distance | Quantity::RightOfWay | Quantity::Clearance => 2,
            _ => 1,
        }
    }

    /// Returns the type of the values.
    pub const fn unit(self) -> Unit {
        match self {
            Quantity::Distance => Unit::Float,
            Quantity::Heading | Quantity::Exit => Unit::Word(Words::Headings),
            Quantity::Light => Unit::Word(Words::Lights),
            Quantity::RightOfWay => Unit::Word(Words::RightsOfWay),
            _ => Unit::Number,
        }
    }

    /// Returns whether the value follows from the cells, headings and priorities of agents and the number of the tick.
    pub(crate) const fn is_visible(self) -> bool {
        !matches!(
            self,
            Quantity::Speed
                | Quantity::Waited
                | Quantity::Remaining
                | Quantity::Exit
                | Quantity::Light
                | Quantity::RightOfWay
                | Quantity::Clearance
        )
    }

    /// Returns whether the value follows from where the agent's route leaves its next intersection.
    pub(crate) const fn reads_exit(self) -> bool {
        matches!(
            self,
            Quantity::Exit | Quantity::Light | Quantity::RightOfWay | Quantity::Clearance
        )
    }

    /// Returns the value for these agents on a map, as many as [`agents`](Quantity::agents).
    pub(crate) fn measure(self, map: &CityMap, tick: u64, agents: &[&Measured]) -> Option<Measure> {
        let count = |number: u32| Some(Measure::Number(i32::try_from(number).unwrap_or(i32::MAX)));
        match (self, agents) {
            (Quantity::Tick, _) => count(u32::try_from(tick).unwrap_or(u32::MAX)),
            (Quantity::Speed, [x, ..]) => count(x.progress.speed),
            (Quantity::Waited, [x, ..]) => count(x.progress.waited),
            (Quantity::Remaining, [x, ..]) => count(x.progress.remaining),
            (Quantity::Priority, [x, ..]) => Some(Measure::Number(x.subject.priority)),
            (Quantity::Intersection, [x, ..]) => map.intersection(x.subject.kind, x.subject.at).and_then(count),
            (Quantity::Limit, [x, ..]) => {
                (map.limit(x.subject.kind, x.subject.at)).and_then(|limit| count(limit.into()))
            }
            (Quantity::Light, [x, ..]) => {
                let Subject { kind, at, .. } = x.subject;
                map.light(kind, at, x.progress.exit, tick).map(Measure::Light)
            }
            (Quantity::Heading, [x, ..]) => x.subject.heading.map(Measure::Heading),
            (Quantity::Exit, [x, ..]) => x.progress.exit.map(Measure::Heading),
            (Quantity::RightOfWay | Quantity::Clearance, [x, y]) => {
                let is_car = |agent: &Measured| agent.subject.kind == AgentKind::Car;
                let way = |agent: &Measured| (agent.subject.at, agent.progress.exit);
                if !is_car(x) || !is_car(y) {
                    return None;
                }
                match self {
                    Quantity::Clearance => map.clearance(way(x), way(y)).and_then(count),
                    _ => map.right_of_way(way(x), way(y)).map(Measure::RightOfWay),
                }
            }
            #[allow(clippy::cast_possible_truncation)] // a column of type float has single precision
            (Quantity::Distance, [x, y]) => Some(Measure::Float(x.subject.at.distance(y.subject.at) as f32)),
            _ => None,
        }
    }
}

/// The state of an agent that quantities read.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Measured {
    pub subject: Subject,
    pub progress: Progress,
}

impl Serialize for Quantity {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.name())
    }
}

impl PredicateKind for Quantity {
    const SYNTAX: Syntax = Syntax::Keys(&["quantity"], |nodes, faults| {
        let choices = Quantity::ALL.map(|quantity| (quantity.name(), quantity));
        choice(nodes[0], &choices, faults).map(Quantity::into)
    });

    fn phrase(&self) -> Phrase {
        Phrase::new(match self {
            Quantity::Speed => "moved this number of cells in the last tick:",
            Quantity::Heading => "heads",
            Quantity::Priority => "has the priority",
            Quantity::Waited => "has not moved for this number of ticks:",
            Quantity::Remaining => "has this number of cells before it:",
            Quantity::Intersection => "is at or inside the intersection with this number:",
            Quantity::Limit => "has this speed limit in km/h:",
            Quantity::Light => "sees this light:",
            Quantity::RightOfWay => "has this right of way against",
            Quantity::Clearance => "has its way free after this number of cells of",
            Quantity::Exit => "leaves its next intersection in the direction",
            Quantity::Distance => "has this distance in cells from",
            Quantity::Tick => "The tick is",
        })
    }

    #[cfg(test)]
    fn samples() -> Vec<Definition> {
        Quantity::ALL.map(Definition::Quantity).to_vec()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_are_in_the_order_of_their_types() {
        assert_eq!(Words::Headings.names(), Heading::ALL.map(Heading::name));
        assert_eq!(Words::Lights.names(), Light::ALL.map(Light::name));
        assert_eq!(Words::RightsOfWay.names(), RightOfWay::ALL.map(RightOfWay::name));
        assert_eq!(Words::RightsOfWay.range().end as usize, WORDS.len());
    }
}
