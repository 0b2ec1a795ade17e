//! Which agents a sensor of the ego reaches.

use crate::city::{Agent, Cell, CityMap};
use crate::config::Sensor;
use crate::sim::observe::observed::all_of;
use crate::sim::tick::agent_state::AgentState;

/// What can hide an agent from a sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Visibility {
    range: Option<u32>,
    buildings: bool,
    agents: bool,
}

impl Visibility {
    pub fn of(sensor: &Sensor) -> Visibility {
        Visibility {
            range: sensor.range,
            buildings: sensor.occluded_by_buildings,
            agents: sensor.occluded_by_agents,
        }
    }

    /// Returns the entities that are not hidden from a viewer, which is never hidden from itself. `at` is the cell of
    /// the viewer.
    pub fn visible(self, map: &CityMap, (viewer, at): (u32, Cell), bodies: &[AgentState], agents: &[Agent]) -> u64 {
        let all = all_of(bodies.len());
        if self.range.is_none() && !self.buildings && !self.agents {
            return all;
        }
        let hidden = |body: &AgentState| {
            let line = Line::new(at, body.at);
            let far = self.range.is_some_and(|range| line.is_longer_than(range));
            let third = |(place, agent): (usize, &Agent)| {
                place != viewer as usize && place != body.agent as usize && line.crosses(agent.cell)
            };
            far || self.buildings && line.between().any(|cell| map.building_at(cell).is_some())
                || self.agents && agents.iter().enumerate().any(third)
        };
        let others = bodies.iter().enumerate().filter(|(_, body)| body.agent != viewer);
        others.fold(all, |visible, (entity, body)| {
            visible & !(u64::from(hidden(body)) << entity)
        })
    }

    /// Returns whether two cells are within a distance, or there is no bound.
    pub fn is_within(radius: Option<u32>, from: Cell, to: Cell) -> bool {
        radius.is_none_or(|radius| !Line::new(from, to).is_longer_than(radius))
    }
}

/// The cells between two cells: one in each row or column of the longer direction, rounded to the nearest one.
#[derive(Clone, Copy)]
struct Line {
    from: Cell,
    rows: i32,
    cols: i32,
    /// The number of steps.
    steps: i32,
}

impl Line {
    fn new(from: Cell, to: Cell) -> Line {
        let (rows, cols) = (to.row - from.row, to.col - from.col);
        Line {
            from,
            rows,
            cols,
            steps: rows.abs().max(cols.abs()),
        }
    }

    fn is_longer_than(self, range: u32) -> bool {
        let [rows, cols, range] = [self.rows.into(), self.cols.into(), i64::from(range)];
        rows * rows + cols * cols > range * range
    }

    /// Returns the cell after some steps.
    fn at(self, step: i32) -> Cell {
        let along = |whole: i32| (2 * step * whole + self.steps).div_euclid(2 * self.steps);
        Cell::new(self.from.row + along(self.rows), self.from.col + along(self.cols))
    }

    /// Returns the cells between the ends.
    fn between(self) -> impl Iterator<Item = Cell> {
        (1..self.steps).map(move |step| self.at(step))
    }

    /// Returns whether a cell is between the ends.
    fn crosses(self, cell: Cell) -> bool {
        let (rows, cols) = (cell.row - self.from.row, cell.col - self.from.col);
        let step = match self.rows.abs() >= self.cols.abs() {
            true => rows * self.rows.signum(),
            false => cols * self.cols.signum(),
        };
        (1..self.steps).contains(&step) && self.at(step) == cell
    }
}
