//! The raster of a road network: the cells of lanes and connections, and what lies at and inside intersections.
//!
//! The raster gives each cell its ground, its relation to intersections, and its nearest lane; each lane and each
//! connection becomes a path of cells whose consecutive cells share a side.
// Decision: docs/decisions/city.md#d078

use crate::city::network::{Direction, LaneUse, Network, Point, RightOfWay, RoadLane, Sign};
use crate::city::route::facings;
use crate::city::signal::together;
use crate::city::square::{CAR_AT, INSIDE, MID_LINE, NODE, PEDESTRIAN_AT, Square};
use crate::city::{Cell, Ground, Heading, Light, Rectangle, Side, SignalLink};
use std::collections::BTreeSet;
use std::sync::Arc;

/// The raster of a network.
#[derive(Clone, Debug)]
pub(crate) struct RoadMap {
    network: Arc<Network>,
    rows: i32,
    cols: i32,
    squares: Box<[Square]>,
    /// For each cell: one more than the position in `paths` of the nearest cell of a lane for cars; or the number of its
    /// intersection with [`OF_INTERSECTION`]; or 0.
    marks: Box<[u32]>,
    /// The cells of all lanes for cars, lane by lane.
    paths: Vec<Cell>,
    /// The direction of travel at each cell of `paths`.
    facings: Vec<Heading>,
    /// The first position in `paths` of each lane, and the length; empty for other lanes.
    firsts: Vec<u32>,
    /// The cells of each connection between its lanes.
    links: Vec<Vec<Cell>>,
    /// The cells of `links` as numbers of cells of the map, each with its connection and its position there, sorted.
    inside: Vec<(u32, u32, u32)>,
    /// The connections that leave each lane.
    leaving: Vec<Vec<u32>>,
    /// The lane to the right of each.
    right: Vec<Option<u32>>,
    /// The lanes to which each must yield, in ascending order.
    yields: Vec<Vec<u32>>,
    /// The number of the intersection of each junction, from 1; 0 for a junction where no ways meet.
    intersections: Vec<u32>,
    /// The most rows or columns between two cells of an intersection.
    extent: i32,
}

/// Marks a number of an intersection in [`RoadMap::marks`].
const OF_INTERSECTION: u32 = 1 << 31;

/// A cell on the path of a lane for cars.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(super) struct Spot {
    /// The lane.
    pub lane: u32,
    /// Steps from its start.
    pub at: u32,
}

/// What is left of the way of a car through a junction.
#[derive(Clone, Copy, Debug)]
struct Way {
    /// The connection.
    connection: u32,
    /// The number of moves to its first cell; 0 for a car inside.
    before: u32,
    /// The position of the car in the cells of the connection; 0 before them.
    at: u32,
}

impl RoadMap {
    /// Makes the raster of a network.
    pub fn new(network: Arc<Network>) -> RoadMap {
        let [rows, cols] = network.size.map(u32::cast_signed);
        let cells = rows as usize * cols as usize;
        let drives = |lane: &RoadLane| lane.usage == LaneUse::Drive;
        let (mut paths, mut firsts, mut directions) = (Vec::new(), Vec::new(), Vec::new());
        for lane in &network.lanes {
            firsts.push(u32::try_from(paths.len()).expect("a map has few cells"));
            if drives(lane) {
                let path = trace(&lane.shape);
                directions.extend(facings(&path));
                paths.extend(path);
            }
        }
        firsts.push(u32::try_from(paths.len()).expect("a map has few cells"));
        let mut map = RoadMap {
            rows,
            cols,
            squares: vec![Square::of_ground(Ground::Other); cells].into(),
            marks: vec![0; cells].into(),
            paths,
            facings: directions,
            firsts,
            links: Vec::new(),
            inside: Vec::new(),
            leaving: vec![Vec::new(); network.lanes.len()],
            right: vec![None; network.lanes.len()],
            yields: vec![Vec::new(); network.lanes.len()],
            intersections: Vec::new(),
            extent: 0,
            network,
        };
        map.join();
        map.pave();
        map.mark_intersections();
        map
    }

    /// Joins the lanes by connections, and finds the intersections.
    fn join(&mut self) {
        let network = Arc::clone(&self.network);
        for (lane, number) in network.lanes.iter().zip(0..) {
            if let Some(left) = lane.left {
                self.right[left as usize] = Some(number);
            }
        }
        for (connection, number) in network.connections.iter().zip(0..) {
            self.leaving[connection.from as usize].push(number);
            let [from, to] = [connection.from, connection.to].map(|lane| self.path(lane));
            let center = |cell: &Cell| Point {
                x: f64::from(cell.col) + 0.5,
                y: f64::from(cell.row) + 0.5,
            };
            let mut points: Vec<Point> = from.last().map(center).into_iter().collect();
            points.extend(&connection.shape);
            points.extend(to.first().map(center));
            let all = trace(&points);
            let between = if all.len() > 2 { &all[1..all.len() - 1] } else { &[] };
            self.links.push(between.to_vec());
        }
        for (cells, connection) in self.links.iter().zip(0..) {
            let places = cells.iter().map(|&cell| place_of(cell, self.rows, self.cols));
            let known = places
                .zip(0..)
                .filter_map(|(place, at)| Some((u32::try_from(place?).ok()?, connection, at)));
            self.inside.extend(known);
        }
        self.inside.sort_unstable();
        let ahead = network
            .connections
            .iter()
            .filter(|connection| connection.direction != Direction::Around);
        for connection in ahead {
            let foes = connection
                .yields_to
                .iter()
                .map(|&other| network.connections[other as usize].from);
            let foes = foes.filter(|&foe| foe != connection.from);
            self.yields[connection.from as usize].extend(foes);
        }
        for lanes in &mut self.yields {
            lanes.sort_unstable();
            lanes.dedup();
        }
        let mut meets = vec![false; network.junctions.len()];
        let mut of_junction: Vec<Vec<usize>> = vec![Vec::new(); network.junctions.len()];
        for (number, connection) in network.connections.iter().enumerate() {
            if let Some(junction) = network.lanes[connection.from as usize].to {
                of_junction[junction as usize].push(number);
            }
        }
        for lane in network.lanes.iter().filter(|lane| lane.usage == LaneUse::Crossing) {
            if let Some(junction) = lane.to {
                meets[junction as usize] = true;
            }
        }
        for (connections, meets) in of_junction.iter().zip(&mut meets) {
            *meets = *meets || self.ways_meet(&network, connections);
        }
        let mut count = 0;
        self.intersections = (meets.into_iter())
            .map(|meets| {
                count += u32::from(meets);
                if meets { count } else { 0 }
            })
            .collect();
    }

    /// Whether two of these connections come from different lanes that are not side by side, and share a cell or end in
    /// one lane. A way back alone does not make an intersection.
    fn ways_meet(&self, network: &Network, connections: &[usize]) -> bool {
        let rightmost = |mut lane: u32| {
            while let Some(right) = self.right[lane as usize] {
                lane = right;
            }
            lane
        };
        let ways: Vec<(u32, u32, BTreeSet<Cell>)> = (connections.iter())
            .filter(|&&number| network.connections[number].direction != Direction::Around)
            .map(|&number| {
                let connection = &network.connections[number];
                let cells = self.links[number].iter().copied().collect();
                (rightmost(connection.from), connection.to, cells)
            })
            .collect();
        (ways.iter().enumerate()).any(|(at, (from, to, cells))| {
            (ways[at + 1..].iter())
                .any(|(other, end, theirs)| from != other && (to == end || !cells.is_disjoint(theirs)))
        })
    }

    /// Gives each cell its ground and its nearest lane.
    fn pave(&mut self) {
        let network = Arc::clone(&self.network);
        let mut nearest = vec![f32::INFINITY; self.marks.len()];
        for junction in &network.junctions {
            for cell in interior(&junction.shape) {
                self.set_ground(cell, Ground::Traffic);
            }
        }
        let drives = |lane: &RoadLane| lane.usage == LaneUse::Drive;
        for lane in network.lanes.iter().filter(|lane| drives(lane)) {
            for cell in stroke(&lane.shape, lane.width / 2.0) {
                self.set_ground(cell, Ground::Traffic);
            }
        }
        for (lane, number) in network.lanes.iter().zip(0..).filter(|(lane, _)| drives(lane)) {
            for at in self.firsts[number]..self.firsts[number + 1] {
                let middle = self.paths[at as usize];
                self.set_ground(middle, Ground::Traffic);
                for (cell, distance) in disc(middle, lane.width / 2.0 + 1.0) {
                    let Some(place) = self.place(cell) else { continue };
                    if self.squares[place].ground() == Ground::Traffic && distance < nearest[place] {
                        (nearest[place], self.marks[place]) = (distance, at + 1);
                    }
                }
            }
        }
        let on_path: BTreeSet<Cell> = (self.paths.iter())
            .chain(self.links.iter().flatten())
            .copied()
            .collect();
        for cell in self.links.iter().flatten() {
            // `links` holds cells of the map only, since points are on it.
            if let Some(place) = place_of(*cell, self.rows, self.cols) {
                self.squares[place] = Square::of_ground(Ground::Traffic);
            }
        }
        self.pave_walks(&network, &on_path);
        self.draw_mid_lines(&on_path);
    }

    /// Paves sidewalks, places and crossings. Where they meet a path of cars, pedestrians cross it.
    fn pave_walks(&mut self, network: &Network, on_path: &BTreeSet<Cell>) {
        let mut walks = Vec::new();
        for lane in &network.lanes {
            let (path, reach) = match lane.usage {
                LaneUse::Drive => continue,
                LaneUse::Place => {
                    let closed = lane.shape.iter().chain(lane.shape.first()).copied();
                    walks.extend(interior(&lane.shape).map(|cell| (cell, LaneUse::Place, false)));
                    (trace(&closed.collect::<Vec<_>>()), 0.0)
                }
                LaneUse::Walk | LaneUse::Crossing => (trace(&lane.shape), lane.width / 2.0),
            };
            let ends = [path.first(), path.last()].into_iter().flatten();
            // The raster of a lane and that of what it leads to may touch in a corner only.
            walks.extend(ends.flat_map(|&end| disc(end, 1.0).map(|(cell, _)| (cell, lane.usage, false))));
            for cell in &path {
                walks.extend(disc(*cell, reach).map(|(cell, distance)| (cell, lane.usage, distance == 0.0)));
            }
        }
        for (cell, usage, on_line) in walks {
            let Some(place) = self.place(cell) else { continue };
            let ground = match (self.squares[place].ground(), usage) {
                (Ground::Crossing, _) | (Ground::Other | Ground::Walking | Ground::Traffic, LaneUse::Crossing) => {
                    Ground::Crossing
                }
                (Ground::Traffic, _) if on_path.contains(&cell) => match on_line {
                    true => Ground::Crossing,
                    false => Ground::Traffic,
                },
                (Ground::Traffic, _) if !on_line => Ground::Traffic,
                _ => Ground::Walking,
            };
            self.squares[place] = Square::of_ground(ground);
        }
    }

    /// Marks the cells of a lane beside a lane in the opposite direction, where they are not on a path.
    fn draw_mid_lines(&mut self, on_path: &BTreeSet<Cell>) {
        let direction = |cell: Cell| {
            let mark = self.marks[self.place(cell)?];
            (1..OF_INTERSECTION)
                .contains(&mark)
                .then(|| self.facings[mark as usize - 1])
        };
        let mut lines = Vec::new();
        for row in 0..self.rows {
            for col in 0..self.cols {
                let cell = Cell::new(row, col);
                // Of two cells side by side, the one whose cars go left or down.
                let Some(facing @ (Heading::Left | Heading::Down)) = direction(cell) else {
                    continue;
                };
                let left = facing.clockwise().opposite();
                let is_beside = direction(cell.ahead(left, 1)) == Some(facing.opposite());
                if is_beside && !on_path.contains(&cell) && self.ground(cell) == Some(Ground::Traffic) {
                    lines.extend(self.place(cell));
                }
            }
        }
        for place in lines {
            self.squares[place].set(MID_LINE);
        }
    }

    /// Marks what lies at and inside intersections.
    fn mark_intersections(&mut self) {
        let mut inside: Vec<(Cell, u32)> = Vec::new();
        for (junction, &number) in self.network.junctions.iter().zip(&self.intersections) {
            if number > 0 {
                let cells = interior(&junction.shape).filter(|&cell| self.contains(cell));
                inside.extend(cells.map(|cell| (cell, number)));
            }
        }
        for (connection, cells) in self.network.connections.iter().zip(&self.links) {
            let junction = self.network.lanes[connection.from as usize].to;
            let number = junction.map_or(0, |junction| self.intersections[junction as usize]);
            if number > 0 {
                inside.extend(cells.iter().map(|&cell| (cell, number)));
            }
        }
        let mut extents = vec![[i32::MAX, i32::MIN, i32::MAX, i32::MIN]; self.intersections.len() + 1];
        let widen = |extents: &mut Vec<[i32; 4]>, number: u32, cell: Cell| {
            let [top, bottom, left, right] = &mut extents[number as usize];
            (*top, *bottom) = ((*top).min(cell.row), (*bottom).max(cell.row));
            (*left, *right) = ((*left).min(cell.col), (*right).max(cell.col));
        };
        for &(cell, number) in &inside {
            if let Some(place) = self.place(cell) {
                self.squares[place].set(INSIDE);
                self.marks[place] = OF_INTERSECTION | number;
                widen(&mut extents, number, cell);
            }
        }
        for lane in 0..self.network.lanes.len() {
            let (first, end) = (self.firsts[lane], self.firsts[lane + 1]);
            if first == end {
                continue;
            }
            let junction = self.network.lanes[lane].to;
            let number = junction.map_or(0, |junction| self.intersections[junction as usize]);
            for at in [first, end - 1] {
                let cell = self.paths[at as usize];
                if let Some(place) = self.place(cell) {
                    self.squares[place].clear(INSIDE);
                    self.squares[place].set(NODE);
                    self.marks[place] = at + 1;
                    if at == end - 1 && number > 0 {
                        self.squares[place].set(CAR_AT);
                        widen(&mut extents, number, cell);
                    }
                }
            }
        }
        // The outline for pedestrians: walkable cells that touch the inside.
        let mut outline = Vec::new();
        for &(cell, number) in &inside {
            for (row, col) in [(-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1)] {
                let beside = Cell::new(cell.row + row, cell.col + col);
                let Some(place) = self.place(beside) else { continue };
                let square = self.squares[place];
                if matches!(square.ground(), Ground::Walking | Ground::Crossing) && !square.has(INSIDE | CAR_AT | NODE)
                {
                    outline.push((place, beside, number));
                }
            }
        }
        for (place, cell, number) in outline {
            self.squares[place].set(PEDESTRIAN_AT);
            self.marks[place] = OF_INTERSECTION | number;
            widen(&mut extents, number, cell);
        }
        let spans = extents.iter().filter(|[top, bottom, ..]| top <= bottom);
        let most = spans
            .map(|[top, bottom, left, right]| (bottom - top).max(right - left))
            .max();
        self.extent = most.unwrap_or(0);
    }

    fn set_ground(&mut self, cell: Cell, ground: Ground) {
        if let Some(place) = self.place(cell) {
            self.squares[place] = Square::of_ground(ground);
        }
    }

    /// Returns the network.
    pub fn network(&self) -> &Network {
        &self.network
    }

    pub fn rows(&self) -> i32 {
        self.rows
    }

    pub fn cols(&self) -> i32 {
        self.cols
    }

    /// Returns the number of intersections: junctions where ways meet.
    pub fn intersections(&self) -> u32 {
        self.intersections.iter().copied().max().unwrap_or(0)
    }

    /// Returns the most rows or columns between two cells of an intersection.
    pub fn extent(&self) -> i32 {
        self.extent
    }

    fn contains(&self, cell: Cell) -> bool {
        self.place(cell).is_some()
    }

    #[inline]
    fn place(&self, cell: Cell) -> Option<usize> {
        place_of(cell, self.rows, self.cols)
    }

    #[inline]
    pub(super) fn square(&self, cell: Cell) -> Option<Square> {
        self.place(cell).map(|place| self.squares[place])
    }

    fn ground(&self, cell: Cell) -> Option<Ground> {
        self.square(cell).map(Square::ground)
    }

    /// Returns the number of the intersection of a cell at or inside one.
    pub fn intersection_near(&self, cell: Cell) -> u32 {
        let Some(place) = self.place(cell) else { return 0 };
        match self.marks[place] {
            mark if mark & OF_INTERSECTION != 0 => mark ^ OF_INTERSECTION,
            _ => {
                let junction = self
                    .spot(cell)
                    .and_then(|spot| self.network.lanes[spot.lane as usize].to);
                junction.map_or(0, |junction| self.intersections[junction as usize])
            }
        }
    }

    /// Returns the nearest cell of a lane for cars; `None` off the lanes, and inside intersections.
    pub(super) fn spot(&self, cell: Cell) -> Option<Spot> {
        let mark = self.marks[self.place(cell)?];
        if mark == 0 || mark & OF_INTERSECTION != 0 {
            return None;
        }
        let at = mark - 1;
        // Lanes that are not for cars have no cells.
        let lane = self.firsts.partition_point(|&first| first <= at) - 1;
        Some(Spot {
            lane: u32::try_from(lane).ok()?,
            at: at - self.firsts[lane],
        })
    }

    /// Returns the direction of travel on the lane of a cell.
    pub fn lane_heading(&self, cell: Cell) -> Option<Heading> {
        let spot = self.spot(cell)?;
        Some(self.facings[(self.firsts[spot.lane as usize] + spot.at) as usize])
    }

    /// Returns the cells of a lane for cars; none for other lanes.
    pub fn path(&self, lane: u32) -> &[Cell] {
        let ends = self.firsts.get(lane as usize).zip(self.firsts.get(lane as usize + 1));
        ends.map_or(&[], |(&first, &end)| &self.paths[first as usize..end as usize])
    }

    /// Returns the direction of travel at each cell of a lane for cars.
    pub fn path_headings(&self, lane: u32) -> &[Heading] {
        let ends = self.firsts.get(lane as usize).zip(self.firsts.get(lane as usize + 1));
        ends.map_or(&[], |(&first, &end)| &self.facings[first as usize..end as usize])
    }

    /// Returns the cells of a connection between its lanes.
    pub fn link(&self, connection: u32) -> &[Cell] {
        self.links.get(connection as usize).map_or(&[], Vec::as_slice)
    }

    /// Returns the connections that leave a lane.
    pub fn leaving(&self, lane: u32) -> &[u32] {
        &self.leaving[lane as usize]
    }

    /// Returns the lanes to the left and to the right into which a car may change.
    pub fn beside(&self, lane: u32) -> impl Iterator<Item = u32> {
        Side::ALL
            .into_iter()
            .filter_map(move |side| self.lane_beside(lane, side))
    }

    /// Returns the lane on a side into which a car may change.
    pub fn lane_beside(&self, lane: u32, side: Side) -> Option<u32> {
        match side {
            Side::Left => self.network.lanes[lane as usize].left,
            Side::Right => self.right[lane as usize],
        }
    }

    /// Returns the lanes of the largest part of the network in which a car on any lane can drive to each other one and
    /// back, by its number of cells in `extent`; all lanes if no part has a way back there.
    pub fn circulating(&self, extent: &Rectangle) -> Vec<u32> {
        let lanes = || 0..u32::try_from(self.leaving.len()).expect("a map has fewer than 2^32 lanes");
        let mut next: Vec<Vec<u32>> = vec![Vec::new(); self.leaving.len()];
        let mut before = next.clone();
        for lane in lanes() {
            let connected = self.leaving(lane).iter();
            let connected = connected.map(|&number| self.network.connections[number as usize].to);
            for other in connected.chain(self.beside(lane)) {
                next[lane as usize].push(other);
                before[other as usize].push(lane);
            }
        }
        // Sharir's algorithm: the parts are what reaches a lane, in the opposite order of the ends of a search.
        let mut part: Vec<Option<u32>> = vec![None; next.len()];
        let ended = ends_of_search(&next);
        for &root in ended.iter().rev() {
            if part[root as usize].is_some() {
                continue;
            }
            part[root as usize] = Some(root);
            let mut open = vec![root];
            while let Some(lane) = open.pop() {
                for &other in &before[lane as usize] {
                    if part[other as usize].is_none() {
                        part[other as usize] = Some(root);
                        open.push(other);
                    }
                }
            }
        }
        let (mut cells, mut has_way_back) = (vec![0; next.len()], vec![false; next.len()]);
        for connection in &self.network.connections {
            let [from, to] = [connection.from, connection.to].map(|lane| part[lane as usize]);
            if let Some(root) = from.filter(|_| from == to) {
                // It has a way back: a change between lanes is none.
                has_way_back[root as usize] = true;
            }
        }
        for lane in lanes() {
            let root = part[lane as usize].map_or(0, |root| root as usize);
            let inside = self.path(lane).iter().filter(|cell| extent.contains(**cell));
            cells[root] += if has_way_back[root] { inside.count() } else { 0 };
        }
        let largest = lanes().filter(|lane| cells[*lane as usize] > 0);
        let largest = largest.min_by_key(|lane| (std::cmp::Reverse(cells[*lane as usize]), *lane));
        lanes()
            .filter(|lane| largest.is_none() || part[*lane as usize] == largest)
            .collect()
    }

    /// Returns the most cells across a lane for cars.
    pub fn lane_width(&self) -> i32 {
        let drives = self.network.lanes.iter().filter(|lane| lane.usage == LaneUse::Drive);
        #[allow(clippy::cast_possible_truncation)] // a reader limits widths
        drives.map(|lane| lane.width.ceil() as i32 + 1).max().unwrap_or(0)
    }

    /// Returns what regulates the connections that leave the lane of a cell, except for ways back.
    pub fn signs_ahead(&self, cell: Cell) -> impl Iterator<Item = Sign> {
        let lane = self.spot(cell).map(|spot| spot.lane);
        let leaving = lane.into_iter().flat_map(|lane| self.leaving(lane));
        let connections = leaving.map(|&connection| &self.network.connections[connection as usize]);
        let ahead = connections.filter(|connection| connection.direction != Direction::Around);
        ahead.map(|connection| connection.sign)
    }

    /// Returns the name of the lane of a cell.
    #[cfg(feature = "cli")]
    pub fn lane_name(&self, cell: Cell) -> Option<&str> {
        Some(&self.network.lanes[self.spot_of(cell)?.lane as usize].name)
    }

    /// Returns the lane whose path contains a cell.
    #[cfg(feature = "cli")]
    fn spot_of(&self, cell: Cell) -> Option<Spot> {
        self.spot(cell)
            .filter(|spot| self.path(spot.lane)[spot.at as usize] == cell)
    }

    /// Returns the point in the middle of the lane of a cell that is nearest to a point.
    #[cfg(feature = "cli")]
    pub fn lane_point(&self, cell: Cell, near: Point) -> Option<Point> {
        let shape = &self.network.lanes[self.spot_of(cell)?.lane as usize].shape;
        let feet = shape.windows(2).map(|pair| foot(near, pair[0], pair[1]));
        let away = |point: &Point| (point.x - near.x).hypot(point.y - near.y);
        feet.min_by(|one, other| away(one).total_cmp(&away(other)))
    }

    /// Returns two different cells of the lane of a cell, at most `around` steps behind and ahead of it.
    #[cfg(feature = "cli")]
    pub fn lane_direction(&self, cell: Cell, around: usize) -> Option<(Cell, Cell)> {
        let spot = self.spot_of(cell)?;
        let (path, at) = (self.path(spot.lane), spot.at as usize);
        let [from, to] = [at.saturating_sub(around), (at + around).min(path.len() - 1)].map(|at| path[at]);
        (from != to).then_some((from, to))
    }

    /// Returns the speed limit on the lane of a cell in km/h.
    pub fn limit(&self, cell: Cell) -> Option<u16> {
        self.network.lanes[self.spot(cell)?.lane as usize].limit
    }

    /// Returns the light in a tick for a car on the lane of a cell whose route leaves the junction in a direction. If no
    /// connection goes there, or the direction is unknown, any that is no way back counts; of several lights, the one
    /// with which a car drives on. `None` without a signal, or if it is off.
    pub fn light(&self, cell: Cell, exit: Option<Heading>, tick: u64) -> Option<Light> {
        let lane = self.spot(cell)?.lane;
        let of = |number: u32| {
            let SignalLink { signal, link } = self.network.connections[number as usize].light?;
            self.network.signals.get(signal as usize)?.aspect(link, tick)?.light()
        };
        let mut there = self.leaving_to(lane, exit).peekable();
        if there.peek().is_some() {
            return together(there.filter_map(of));
        }
        let connections = self.leaving(lane).iter().copied();
        let ahead =
            connections.filter(|&number| self.network.connections[number as usize].direction != Direction::Around);
        together(ahead.filter_map(of))
    }

    /// Returns the connections that leave a lane in a direction.
    fn leaving_to(&self, lane: u32, exit: Option<Heading>) -> impl Iterator<Item = u32> {
        let leaving = self.leaving(lane).iter().copied();
        leaving.filter(move |&number| exit.is_some() && self.entered(number) == exit)
    }

    /// Returns which of two cars on the lanes of cells must yield, if their routes leave the junction in these
    /// directions; `None` if their ways do not meet, or one is on no lane or ends before.
    pub fn right_of_way(&self, one: (Cell, Option<Heading>), other: (Cell, Option<Heading>)) -> Option<RightOfWay> {
        let [one, other] = [one, other].map(|(cell, exit)| Some((self.spot(cell)?.lane, exit)));
        let ((lane, exit), (other, other_exit)) = (one?, other?);
        let (mut yields, mut first) = (false, false);
        for number in self.leaving_to(lane, exit) {
            for foe in self.leaving_to(other, other_exit) {
                let must = |way: u32, foe: u32| self.network.connections[way as usize].yields_to.contains(&foe);
                yields |= must(number, foe);
                first |= must(foe, number);
            }
        }
        match (yields, first) {
            (true, true) => Some(RightOfWay::Mutual),
            (true, false) => Some(RightOfWay::Yields),
            (false, true) => Some(RightOfWay::First),
            (false, false) => None,
        }
    }

    /// Returns the number of cells that a car drives until it has left the way of another in their next junction, by
    /// their cells and by the directions in which their routes leave it; `None` if their ways do not meet, or no longer.
    pub fn clearance(&self, other: (Cell, Option<Heading>), car: (Cell, Option<Heading>)) -> Option<u32> {
        let from = |way: &Way| self.network.connections[way.connection as usize].from;
        let junction = |way: &Way| self.network.lanes[from(way) as usize].to;
        let left = self.ways(car.0, car.1).filter_map(|way| {
            // Mostly none, as few of the cars in view come to the same junction.
            let crossing = self
                .ways(other.0, other.1)
                .filter(|other| junction(other) == junction(&way) && from(other) != from(&way));
            let crossed: Vec<Cell> = crossing.flat_map(|other| self.cells_of(other)).collect();
            let (_, last) = (self.cells_of(way).zip(0..).filter(|(cell, _)| crossed.contains(cell))).last()?;
            Some(way.before + last + 1)
        });
        left.max()
    }

    /// Returns the ways of a car in a cell through its next junction, or through the one in which it is, if its route
    /// leaves it in a direction.
    fn ways(&self, cell: Cell, exit: Option<Heading>) -> impl Iterator<Item = Way> {
        let spot = self.spot(cell);
        let on_lane = spot.into_iter().flat_map(move |spot| {
            let length = u32::try_from(self.path(spot.lane).len()).expect("a map has few cells");
            let way = move |connection| Way {
                connection,
                before: length - spot.at,
                at: 0,
            };
            self.leaving_to(spot.lane, exit).map(way)
        });
        let place = self.place(cell).filter(|_| spot.is_none());
        let inside = place.map_or(&[][..], |place| {
            let first = self.inside.partition_point(|&(other, ..)| (other as usize) < place);
            let count = self.inside[first..].partition_point(|&(other, ..)| other as usize == place);
            &self.inside[first..first + count]
        });
        let inside = inside.iter().map(|&(_, connection, at)| Way {
            connection,
            before: 0,
            at,
        });
        on_lane.chain(inside.filter(move |way| exit.is_some() && self.entered(way.connection) == exit))
    }

    /// Returns the cells of a way from the first or the present one inside the junction to the first after it.
    fn cells_of(&self, way: Way) -> impl Iterator<Item = Cell> {
        let end = self.path(self.network.connections[way.connection as usize].to).first();
        self.link(way.connection)[way.at as usize..].iter().chain(end).copied()
    }

    /// Returns the direction of travel on the first cell to which a connection leads.
    fn entered(&self, connection: u32) -> Option<Heading> {
        let to = self.network.connections[connection as usize].to;
        self.facings.get(self.firsts[to as usize] as usize).copied()
    }

    /// Returns whether a connection that leaves the lane of the first cell, and is no way back, must yield to one that
    /// leaves the lane of the second.
    pub fn must_yield(&self, cell: Cell, other: Cell) -> bool {
        let (Some(one), Some(other)) = (self.spot(cell), self.spot(other)) else {
            return false;
        };
        self.yields[one.lane as usize].binary_search(&other.lane).is_ok()
    }

    /// Returns the cells for which `holds` is true.
    pub fn cells(&self, holds: impl Fn(Cell) -> bool) -> Vec<Cell> {
        let all = (0..self.rows).flat_map(|row| (0..self.cols).map(move |col| Cell::new(row, col)));
        all.filter(|&cell| holds(cell)).collect()
    }
}

/// Returns the nodes of a graph in the order in which a depth-first search leaves them.
fn ends_of_search(next: &[Vec<u32>]) -> Vec<u32> {
    let (mut seen, mut ended) = (vec![false; next.len()], Vec::new());
    for root in 0..u32::try_from(next.len()).expect("a map has fewer than 2^32 lanes") {
        // Each open node with the number of its neighbors that were tried.
        let mut open: Vec<(u32, usize)> = Vec::new();
        if !std::mem::replace(&mut seen[root as usize], true) {
            open.push((root, 0));
        }
        while let Some((node, tried)) = open.last_mut() {
            match next[*node as usize].get(*tried) {
                Some(&other) => {
                    *tried += 1;
                    if !std::mem::replace(&mut seen[other as usize], true) {
                        open.push((other, 0));
                    }
                }
                None => {
                    ended.push(*node);
                    open.pop();
                }
            }
        }
    }
    ended
}

#[inline]
fn place_of(cell: Cell, rows: i32, cols: i32) -> Option<usize> {
    ((0..rows).contains(&cell.row) && (0..cols).contains(&cell.col))
        .then(|| cell.row as usize * cols as usize + cell.col as usize)
}

/// Returns the cells along a line through these points. Consecutive cells share a side, and none comes twice in a row.
fn trace(points: &[Point]) -> Vec<Cell> {
    let mut cells: Vec<Cell> = points.first().map(|point| point.cell()).into_iter().collect();
    for pair in points.windows(2) {
        let (from, to) = (pair[0], pair[1]);
        let end = to.cell();
        while let Some(&at) = cells.last().filter(|&&at| at != end) {
            let (rows, cols) = ((end.row - at.row).signum(), (end.col - at.col).signum());
            let down = Cell::new(at.row + rows, at.col);
            let aside = Cell::new(at.row, at.col + cols);
            let next = match (rows, cols) {
                (0, _) => aside,
                (_, 0) => down,
                _ if off_line(from, to, down) < off_line(from, to, aside) => down,
                _ => aside,
            };
            // A line that comes back over its last cell has a spike of one cell, which no car drives.
            match cells.len().checked_sub(2).map(|before| cells[before]) {
                Some(before) if before == next => {
                    cells.pop();
                }
                _ => cells.push(next),
            }
        }
    }
    cells
}

/// Returns a measure of the distance of the center of a cell from the line through two points.
fn off_line(from: Point, to: Point, cell: Cell) -> f64 {
    let (x, y) = (f64::from(cell.col) + 0.5 - from.x, f64::from(cell.row) + 0.5 - from.y);
    ((to.x - from.x) * y - (to.y - from.y) * x).abs()
}

/// The longest part of a line that [`stroke`] fills at once, in cells.
const STROKE: f64 = 8.0;

/// Returns the cells whose centers are at most `half` cells away from a line; some of them several times.
fn stroke(points: &[Point], half: f64) -> impl Iterator<Item = Cell> {
    points.windows(2).flat_map(move |pair| {
        let (from, to) = (pair[0], pair[1]);
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // points are on a map
        let parts = ((to.x - from.x).hypot(to.y - from.y) / STROKE).ceil().max(1.0) as u32;
        let between = move |part: u32| {
            let share = f64::from(part) / f64::from(parts);
            Point {
                x: from.x + share * (to.x - from.x),
                y: from.y + share * (to.y - from.y),
            }
        };
        (0..parts).flat_map(move |part| {
            let (from, to) = (between(part), between(part + 1));
            #[allow(clippy::cast_possible_truncation)]
            let span =
                |one: f64, other: f64| (one.min(other) - half).floor() as i32..=(one.max(other) + half).floor() as i32;
            let cols = span(from.x, to.x);
            span(from.y, to.y).flat_map(move |row| {
                let near = cols.clone().filter(move |&col| {
                    let center = Point {
                        x: f64::from(col) + 0.5,
                        y: f64::from(row) + 0.5,
                    };
                    distance(center, from, to) <= half
                });
                near.map(move |col| Cell::new(row, col))
            })
        })
    })
}

/// Returns the distance of a point from the segment between two others.
pub(crate) fn distance(point: Point, from: Point, to: Point) -> f64 {
    let foot = foot(point, from, to);
    (point.x - foot.x).hypot(point.y - foot.y)
}

/// Returns the nearest point of the segment between two others.
fn foot(point: Point, from: Point, to: Point) -> Point {
    let (x, y) = (to.x - from.x, to.y - from.y);
    let length = x * x + y * y;
    let along = if length > 0.0 {
        (((point.x - from.x) * x + (point.y - from.y) * y) / length).clamp(0.0, 1.0)
    } else {
        0.0
    };
    Point {
        x: from.x + along * x,
        y: from.y + along * y,
    }
}

/// Returns the cells whose centers are at most `radius` cells away from that of a cell, with the distance.
fn disc(middle: Cell, radius: f64) -> impl Iterator<Item = (Cell, f32)> {
    #[allow(clippy::cast_possible_truncation)] // lanes are at most 100 cells wide
    let reach = radius.floor() as i32;
    (-reach..=reach).flat_map(move |row| {
        (-reach..=reach).filter_map(move |col| {
            let distance = f64::from(row * row + col * col).sqrt();
            #[allow(clippy::cast_possible_truncation)]
            (distance <= radius).then(|| (Cell::new(middle.row + row, middle.col + col), distance as f32))
        })
    })
}

/// Returns the cells whose centers are inside a polygon, row by row.
fn interior(corners: &[Point]) -> impl Iterator<Item = Cell> {
    let bounds = corners
        .iter()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), point| {
            (low.min(point.y), high.max(point.y))
        });
    #[allow(clippy::cast_possible_truncation)] // a reader limits positions to a map
    let rows = match corners.len() {
        0..3 => 0..0,
        _ => bounds.0.floor() as i32..bounds.1.ceil() as i32 + 1,
    };
    rows.flat_map(move |row| {
        let y = f64::from(row) + 0.5;
        let mut cuts: Vec<f64> = (0..corners.len())
            .filter_map(|at| {
                let (a, b) = (corners[at], corners[(at + 1) % corners.len()]);
                ((a.y <= y) != (b.y <= y)).then(|| a.x + (y - a.y) / (b.y - a.y) * (b.x - a.x))
            })
            .collect();
        cuts.sort_unstable_by(f64::total_cmp);
        let spans: Vec<(i32, i32)> = (cuts.chunks_exact(2))
            .map(|pair| {
                #[allow(clippy::cast_possible_truncation)]
                ((pair[0] - 0.5).ceil() as i32, (pair[1] - 0.5).floor() as i32)
            })
            .collect();
        spans
            .into_iter()
            .flat_map(move |(first, last)| (first..=last).map(move |col| Cell::new(row, col)))
    })
}
