//! Runs as floating car data: the positions of all agents over time, as SUMO writes them with `--fcd-output`.

use crate::city::{AgentKind, Cell, CityMap, Heading, Point};
use crate::sumo::{escaped, meters};
use std::io::{self, Write};

/// The cells behind and ahead of a place on a lane that determine the direction there.
const AROUND: usize = 4;

/// The plane in which positions are written.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plane {
    /// The side of a cell in meters.
    pub cell: f64,
    /// The position of the upper left corner of the map in meters; y grows upward.
    pub origin: [f64; 2],
    /// The length of a tick in seconds.
    pub tick: f64,
}

/// An agent before and after the move of a tick.
#[derive(Clone, Copy, Debug)]
pub struct Moving<'a> {
    /// Its name.
    pub name: &'a str,
    /// The number of its trip, from 0: each is a vehicle or a person of its own, as in SUMO.
    pub trip: u32,
    /// The name of its kind.
    pub kind_name: &'a str,
    /// Whether it drives or walks.
    pub kind: AgentKind,
    /// Its cell before the move.
    pub at: Cell,
    /// Its cell after it.
    pub next: Cell,
    /// The direction of its last move before the tick.
    pub heading: Option<Heading>,
}

/// Writes a run tick by tick. Cars are vehicles, pedestrians are persons.
pub struct FcdWriter<'m, W> {
    out: W,
    map: &'m CityMap,
    plane: Plane,
    /// The last angle of each agent.
    angles: Vec<f64>,
}

impl<'m, W: Write> FcdWriter<'m, W> {
    /// Begins a file.
    ///
    /// # Errors
    /// Errors of the output.
    pub fn new(mut out: W, map: &'m CityMap, plane: Plane) -> io::Result<Self> {
        writeln!(out, "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<fcd-export>")?;
        Ok(FcdWriter {
            out,
            map,
            plane,
            angles: Vec::new(),
        })
    }

    /// Writes the agents after the moves of a tick, always in the same order.
    ///
    /// # Errors
    /// Errors of the output.
    pub fn tick<'a>(&mut self, number: u64, agents: impl Iterator<Item = Moving<'a>>) -> io::Result<()> {
        #[allow(clippy::cast_precision_loss)] // a time
        let time = number as f64 * self.plane.tick;
        writeln!(self.out, "    <timestep time=\"{time:.2}\">")?;
        for (at, agent) in agents.enumerate() {
            if self.angles.len() == at {
                self.angles.push(0.0);
            }
            let angle = self.angle(agent).unwrap_or(self.angles[at]);
            self.angles[at] = angle;
            let [x, y] = meters(self.plane.origin, self.plane.cell, self.point(agent));
            let speed = agent.at.distance(agent.next) * self.plane.cell / self.plane.tick;
            let (name, trip, kind) = (escaped(agent.name), agent.trip, escaped(agent.kind_name));
            let element = match agent.kind {
                AgentKind::Car => "vehicle",
                AgentKind::Pedestrian => "person",
            };
            let lane = match agent.kind {
                AgentKind::Car => self.map.lane_name(agent.next),
                AgentKind::Pedestrian => None,
            };
            let lane = lane.map_or(String::new(), |lane| format!(" lane=\"{}\"", escaped(lane)));
            writeln!(
                self.out,
                "        <{element} id=\"{name}.{trip}\" x=\"{x:.2}\" y=\"{y:.2}\" angle=\"{angle:.2}\" type=\"{kind}\" \
                 speed=\"{speed:.2}\"{lane} slope=\"0.00\"/>"
            )?;
        }
        writeln!(self.out, "    </timestep>")
    }

    /// Ends the file, and returns the output.
    ///
    /// # Errors
    /// Errors of the output.
    pub fn finish(mut self) -> io::Result<W> {
        writeln!(self.out, "</fcd-export>")?;
        Ok(self.out)
    }

    /// Returns the middle of an agent's cell; for a car on a lane, the nearest point of the middle of the lane.
    fn point(&self, agent: Moving<'_>) -> Point {
        let middle = Point {
            x: f64::from(agent.next.col) + 0.5,
            y: f64::from(agent.next.row) + 0.5,
        };
        match agent.kind {
            AgentKind::Car => self.map.lane_point(agent.next, middle).unwrap_or(middle),
            AgentKind::Pedestrian => middle,
        }
    }

    /// Returns the direction of an agent in degrees clockwise from north: along its lane, or else that of its move.
    fn angle(&self, agent: Moving<'_>) -> Option<f64> {
        let along = match agent.kind {
            AgentKind::Car => self.map.lane_direction(agent.next, AROUND),
            AgentKind::Pedestrian => None,
        };
        let moved = (agent.at != agent.next).then_some((agent.at, agent.next));
        match (along.or(moved), agent.heading) {
            (Some((from, to)), _) => {
                // A trace may have any numbers.
                let [right, down] = [(from.col, to.col), (from.row, to.row)].map(|(a, b)| f64::from(b) - f64::from(a));
                Some(right.atan2(-down).to_degrees().rem_euclid(360.0))
            }
            (None, Some(heading)) => Some(match heading {
                Heading::Up => 0.0,
                Heading::Right => 90.0,
                Heading::Down => 180.0,
                Heading::Left => 270.0,
            }),
            (None, None) => None,
        }
    }
}
