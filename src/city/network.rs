//! Road networks, as a configuration describes them.
//!
//! A network consists of lanes with a direction, junctions, and connections, which lead cars through a junction from one
//! lane to another. Pedestrians walk on sidewalks, places and crossings. Positions are [`Point`]s in cells.
// Decision: docs/decisions/city.md#d078

use crate::city::{Cell, Signal, SignalLink};
use serde::{Serialize, Serializer};
use std::ops::Range;

/// A position in cells: the cell in row r and column c has its corners at (c, r) and (c + 1, r + 1).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// To the right, from the left edge of the map.
    pub x: f64,
    /// Downwards, from the upper edge.
    pub y: f64,
}

impl Point {
    /// Returns the cell that contains it.
    pub(super) fn cell(self) -> Cell {
        // A reader limits positions to a map.
        #[allow(clippy::cast_possible_truncation)]
        Cell::new(self.y.floor() as i32, self.x.floor() as i32)
    }
}

impl Serialize for Point {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        [self.x, self.y].serialize(serializer)
    }
}

/// A road network as a map file describes it.
#[derive(Clone, Debug, Serialize)]
pub struct Network {
    /// The length of the side of a cell in meters.
    pub cell: f64,
    /// The position of the upper left corner in meters, in the coordinates of the network that it was imported from,
    /// where y grows upward.
    pub origin: [f64; 2],
    /// Rows and columns of cells.
    pub size: [u32; 2],
    /// The junctions.
    pub junctions: Vec<RoadJunction>,
    /// The lanes. A car changes only between lanes that [`RoadLane::left`] joins.
    pub lanes: Vec<RoadLane>,
    /// The connections. Each leads through the junction at the end of its first lane.
    pub connections: Vec<Connection>,
    /// The signals.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub signals: Vec<Signal>,
}

/// A place where lanes end and begin.
#[derive(Clone, Debug, Serialize)]
pub struct RoadJunction {
    /// Its name.
    pub name: String,
    /// The corners of its area; fewer than three for none.
    pub shape: Vec<Point>,
}

/// What a lane is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub enum LaneUse {
    /// Cars drive on it, from the first point of its shape to the last.
    Drive,
    /// Pedestrians walk on it, in both directions.
    Walk,
    /// Pedestrians cross a street on it.
    Crossing,
    /// Pedestrians walk in the polygon of its shape.
    Place,
}

impl LaneUse {
    /// All uses.
    pub const ALL: [LaneUse; 4] = [LaneUse::Drive, LaneUse::Walk, LaneUse::Crossing, LaneUse::Place];

    /// Returns its name in map files.
    pub const fn name(self) -> &'static str {
        match self {
            LaneUse::Drive => "drive",
            LaneUse::Walk => "walk",
            LaneUse::Crossing => "crossing",
            LaneUse::Place => "place",
        }
    }
}

/// The highest speed limit in km/h.
pub(crate) const LIMIT_MAX: u16 = 1000;

/// A lane.
#[derive(Clone, Debug, Serialize)]
pub struct RoadLane {
    /// Its name.
    pub name: String,
    /// What it is for.
    #[serde(rename = "use")]
    pub usage: LaneUse,
    /// The junction at its end, or the one that it belongs to.
    pub to: Option<u32>,
    /// The lane to its left into which cars may change, and back.
    pub left: Option<u32>,
    /// Its center line, at least two points; the corners of a [`LaneUse::Place`].
    pub shape: Vec<Point>,
    /// Its width in cells.
    pub width: f64,
    /// The speed limit in km/h.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub limit: Option<u16>,
}

/// A direction in which a connection leaves a junction.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub enum Direction {
    /// To the left.
    Left,
    /// To the right.
    Right,
    /// Straight on.
    Straight,
    /// Back.
    Around,
}

impl Direction {
    /// All directions.
    pub const ALL: [Direction; 4] = [
        Direction::Left,
        Direction::Right,
        Direction::Straight,
        Direction::Around,
    ];

    /// Returns its name in map files.
    pub const fn name(self) -> &'static str {
        match self {
            Direction::Left => "left",
            Direction::Right => "right",
            Direction::Straight => "straight",
            Direction::Around => "around",
        }
    }
}

/// What regulates the right of way of a connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
pub enum Sign {
    /// It has priority.
    Priority,
    /// A sign to yield.
    Yield,
    /// A sign to stop.
    Stop,
    /// All stop, and the first to arrive goes first.
    AllWayStop,
    /// No sign: who comes from the right goes first.
    Right,
    /// A signal.
    Signal,
}

impl Sign {
    /// All signs.
    pub const ALL: [Sign; 6] = [
        Sign::Priority,
        Sign::Yield,
        Sign::Stop,
        Sign::AllWayStop,
        Sign::Right,
        Sign::Signal,
    ];

    /// Returns its name in configurations.
    pub const fn name(self) -> &'static str {
        match self {
            Sign::Priority => "priority",
            Sign::Yield => "yield",
            Sign::Stop => "stop",
            Sign::AllWayStop => "all-way-stop",
            Sign::Right => "right",
            Sign::Signal => "signal",
        }
    }
}

/// A way through a junction from one lane to another.
#[derive(Clone, Debug, Serialize)]
pub struct Connection {
    /// The lane that it leaves.
    pub from: u32,
    /// The lane that it enters.
    pub to: u32,
    /// Its direction.
    pub direction: Direction,
    /// What regulates its right of way.
    pub sign: Sign,
    /// The link of a signal that regulates it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub light: Option<SignalLink>,
    /// The points between the two lanes.
    pub shape: Vec<Point>,
    /// The connections to which it must yield.
    pub yields_to: Vec<u32>,
}

/// Which of two cars must let the other go first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RightOfWay {
    /// The first must yield.
    Yields,
    /// The second must yield.
    First,
    /// Each must yield to the other.
    Mutual,
}

impl RightOfWay {
    /// All values.
    pub const ALL: [RightOfWay; 3] = [RightOfWay::Yields, RightOfWay::First, RightOfWay::Mutual];

    /// Returns its name in rules, scenes and traces.
    pub const fn name(self) -> &'static str {
        match self {
            RightOfWay::Yields => "yields",
            RightOfWay::First => "first",
            RightOfWay::Mutual => "mutual",
        }
    }
}

impl Network {
    /// Places a network to the right of this one, `gap` columns apart, and returns the rows and the columns that it takes.
    /// Its names begin with `prefix`.
    pub fn place_beside(&mut self, mut other: Network, gap: u32, prefix: &str) -> [Range<u32>; 2] {
        let [rows, cols] = other.size;
        let first = if self.lanes.is_empty() { 0 } else { self.size[1] + gap };
        let counts = [
            self.junctions.len(),
            self.lanes.len(),
            self.connections.len(),
            self.signals.len(),
        ];
        let [junctions, lanes, connections, signals] =
            counts.map(|count| u32::try_from(count).expect("a network has few parts"));
        let name = |name: &mut String| name.insert_str(0, prefix);
        let shift = |shape: &mut Vec<Point>| shape.iter_mut().for_each(|point| point.x += f64::from(first));
        for junction in &mut other.junctions {
            name(&mut junction.name);
            shift(&mut junction.shape);
        }
        for lane in &mut other.lanes {
            name(&mut lane.name);
            shift(&mut lane.shape);
            lane.to = lane.to.map(|to| to + junctions);
            lane.left = lane.left.map(|left| left + lanes);
        }
        for connection in &mut other.connections {
            (connection.from, connection.to) = (connection.from + lanes, connection.to + lanes);
            shift(&mut connection.shape);
            connection.yields_to.iter_mut().for_each(|foe| *foe += connections);
            if let Some(light) = &mut connection.light {
                light.signal += signals;
            }
        }
        other.signals.iter_mut().for_each(|signal| name(&mut signal.name));
        self.junctions.append(&mut other.junctions);
        self.lanes.append(&mut other.lanes);
        self.connections.append(&mut other.connections);
        self.signals.append(&mut other.signals);
        self.size = [self.size[0].max(rows), first + cols];
        [0..rows, first..first + cols]
    }
}
