//! Road networks of map files as networks of SUMO.
//!
//! A lane `NAME_0` belongs to the edge `NAME`. Each connection gets a lane inside its junction, and its junction a
//! request for it, so that SUMO yields as the map says. Signals have the phases of the map, one second a tick; at those
//! without any, one street after the other has green.

use crate::city::{Connection, Direction, LaneUse, Network, Point, RoadLane, Sign, SignalLink};
use crate::sumo::{escaped, meters};
use std::collections::{BTreeMap, HashMap};
use std::fmt::Write;

/// The speed limit of a lane without one, in km/h.
const LIMIT: u16 = 50;
/// The farthest junction at which a lane begins that no connection enters, in cells.
const NEAR: f64 = 20.0;
/// The times of green and yellow of a street at a signal, in seconds.
const GREEN: u32 = 31;
const YELLOW: u32 = 4;

/// Returns a network as the text of a `.net.xml` file.
pub fn network_file(network: &Network) -> String {
    Exporter::new(network).text()
}

/// An edge: lanes side by side, from right to left.
struct Edge {
    name: String,
    lanes: Vec<u32>,
    from: usize,
    to: usize,
}

/// A junction of the file: one of the map, or the end of a street.
struct Node {
    name: String,
    shape: Vec<Point>,
    at: Point,
    arriving: Vec<u32>,
    connections: Vec<u32>,
}

struct Exporter<'n> {
    network: &'n Network,
    edges: Vec<Edge>,
    nodes: Vec<Node>,
    /// The position of each lane for cars or along a street: its edge, and its place in it.
    place: HashMap<u32, (usize, usize)>,
    text: String,
}

impl<'n> Exporter<'n> {
    fn new(network: &'n Network) -> Self {
        let mut nodes: Vec<Node> = (network.junctions.iter())
            .map(|junction| Node {
                name: junction.name.clone(),
                at: middle(&junction.shape),
                shape: junction.shape.clone(),
                arriving: Vec::new(),
                connections: Vec::new(),
            })
            .collect();
        for lane in network.lanes.iter().filter(|lane| lane.usage == LaneUse::Drive) {
            if let Some(node) = lane.to.map(|to| &mut nodes[to as usize])
                && node.shape.is_empty()
            {
                node.at = last(lane);
            }
        }
        let mut groups: BTreeMap<&str, Vec<(usize, u32)>> = BTreeMap::new();
        for (lane, number) in network.lanes.iter().zip(0..) {
            if matches!(lane.usage, LaneUse::Drive | LaneUse::Walk) {
                let (edge, index) = edge_of(&lane.name);
                groups.entry(edge).or_default().push((index, number));
            }
        }
        // Names alone do not make a street of lanes that lead to different junctions.
        let leads_apart = |lanes: &[(usize, u32)]| {
            let drives = lanes.iter().map(|(_, lane)| &network.lanes[*lane as usize]);
            let ends: Vec<Option<u32>> = (drives.filter(|lane| lane.usage == LaneUse::Drive))
                .map(|lane| lane.to)
                .collect();
            ends.iter().any(|end| *end != ends[0])
        };
        let apart: Vec<&str> = (groups.iter())
            .filter(|(_, lanes)| leads_apart(lanes))
            .map(|(name, _)| *name)
            .collect();
        for name in apart {
            for (_, lane) in groups.remove(name).unwrap_or_default() {
                let own = network.lanes[lane as usize].name.as_str();
                groups.entry(own).or_default().push((0, lane));
            }
        }
        let mut exporter = Exporter {
            network,
            edges: Vec::new(),
            nodes,
            place: HashMap::new(),
            text: String::new(),
        };
        let mut entered: HashMap<u32, usize> = HashMap::new();
        for connection in &network.connections {
            if let Some(junction) = network.lanes[connection.from as usize].to {
                entered.insert(connection.to, junction as usize);
            }
        }
        for (name, mut lanes) in groups {
            lanes.sort_unstable();
            let lanes: Vec<u32> = lanes.into_iter().map(|(_, lane)| lane).collect();
            exporter.add_edge(name, lanes, &entered);
        }
        for (lane, number) in network.lanes.iter().zip(0..) {
            if lane.usage == LaneUse::Drive {
                let node = exporter.end(number);
                exporter.nodes[node].arriving.push(number);
            }
        }
        for (connection, number) in network.connections.iter().zip(0..) {
            let node = exporter.end(connection.from);
            exporter.nodes[node].connections.push(number);
        }
        exporter
    }

    fn lane(&self, lane: u32) -> &'n RoadLane {
        &self.network.lanes[lane as usize]
    }

    /// Returns the junction at the end of a lane for cars.
    fn end(&self, lane: u32) -> usize {
        let (edge, _) = self.place[&lane];
        self.edges[edge].to
    }

    fn add_edge(&mut self, name: &str, lanes: Vec<u32>, entered: &HashMap<u32, usize>) {
        let drives = |lane: &&u32| self.lane(**lane).usage == LaneUse::Drive;
        // Sidewalks know no junction: those of a street for cars are where its lanes are.
        let leading = *lanes.iter().find(drives).unwrap_or(&lanes[0]);
        let known = lanes.iter().find_map(|lane| self.lane(*lane).to);
        let to = match known {
            Some(junction) => junction as usize,
            None => self.node_at(last(self.lane(leading)), || format!("{name}.end")),
        };
        let from = match lanes.iter().find_map(|lane| entered.get(lane)) {
            Some(&junction) => junction,
            None => self.node_at(first(self.lane(leading)), || format!("{name}.begin")),
        };
        for (at, lane) in lanes.iter().enumerate() {
            self.place.insert(*lane, (self.edges.len(), at));
        }
        self.edges.push(Edge {
            name: name.to_owned(),
            lanes,
            from,
            to,
        });
    }

    /// Returns the nearest junction, or a new one.
    fn node_at(&mut self, at: Point, name: impl Fn() -> String) -> usize {
        let distance = |node: &Node| {
            let corners = node.shape.iter().chain([&node.at]);
            let distances = corners.map(|corner| (corner.x - at.x).hypot(corner.y - at.y));
            distances.min_by(f64::total_cmp).unwrap_or(f64::INFINITY)
        };
        let nearest = (self.nodes.iter().map(distance).enumerate()).min_by(|(_, one), (_, other)| one.total_cmp(other));
        match nearest.filter(|(_, distance)| *distance <= NEAR) {
            Some((number, _)) => number,
            None => {
                let mut name = name();
                while self.nodes.iter().any(|node| node.name == name) {
                    name.push('_');
                }
                self.nodes.push(Node {
                    name,
                    at,
                    shape: Vec::new(),
                    arriving: Vec::new(),
                    connections: Vec::new(),
                });
                self.nodes.len() - 1
            }
        }
    }

    fn meters(&self, point: Point) -> [f64; 2] {
        meters(self.network.origin, self.network.cell, point)
    }

    fn line(&mut self, depth: usize, text: &str) {
        let _ = writeln!(self.text, "{}{text}", "    ".repeat(depth));
    }

    fn text(mut self) -> String {
        let [rows, cols] = self.network.size.map(f64::from);
        let [left, top] = self.meters(Point { x: 0.0, y: 0.0 });
        let [right, bottom] = self.meters(Point { x: cols, y: rows });
        let bounds = format!("{left:.2},{bottom:.2},{right:.2},{top:.2}");
        self.text = "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n\
                     <!-- Written by `logicity map export`. -->\n<net version=\"1.20\">\n"
            .to_owned();
        self.line(
            1,
            &format!(
                "<location netOffset=\"0.00,0.00\" convBoundary=\"{bounds}\" origBoundary=\"{bounds}\" \
                 projParameter=\"!\"/>"
            ),
        );
        for node in 0..self.nodes.len() {
            self.inner_edges(node);
        }
        self.ways_on_foot();
        for edge in 0..self.edges.len() {
            self.edge(edge);
        }
        self.signals();
        for node in 0..self.nodes.len() {
            self.made_signal(node);
        }
        for node in 0..self.nodes.len() {
            self.junction(node);
        }
        self.connections();
        self.text.push_str("</net>\n");
        self.text
    }

    fn inner_name(&self, node: usize, at: usize) -> String {
        format!(":{}_{at}", escaped(&self.nodes[node].name))
    }

    fn inner_edges(&mut self, node: usize) {
        for (at, number) in self.nodes[node].connections.clone().into_iter().enumerate() {
            let connection = &self.network.connections[number as usize];
            let (from, to) = (self.lane(connection.from), self.lane(connection.to));
            let shape = match connection.shape.len() {
                0 | 1 => [vec![last(from)], connection.shape.clone(), vec![first(to)]].concat(),
                _ => connection.shape.clone(),
            };
            let name = self.inner_name(node, at);
            self.line(1, &format!("<edge id=\"{name}\" function=\"internal\">"));
            let limit = from.limit.into_iter().chain(to.limit).min().unwrap_or(LIMIT);
            let lane = Lane {
                id: &format!("{name}_0"),
                index: 0,
                limit,
                shape: &shape,
                width: from.width,
                more: "disallow=\"pedestrian\"",
            };
            let lane = self.lane_element(&lane);
            self.line(2, &lane);
            self.line(1, "</edge>");
        }
    }

    /// Writes crossings and places. Their names are those of an edge with one lane.
    fn ways_on_foot(&mut self) {
        let network = self.network;
        for lane in &network.lanes {
            let (function, fallback) = match lane.usage {
                LaneUse::Crossing => ("crossing", "c"),
                LaneUse::Place => ("walkingarea", "w"),
                LaneUse::Drive | LaneUse::Walk => continue,
            };
            let name = match edge_of(&lane.name) {
                (edge, 0) if edge != lane.name => edge.to_owned(),
                _ => format!(":{}_{fallback}", lane.name),
            };
            let name = escaped(&name);
            self.line(1, &format!("<edge id=\"{name}\" function=\"{function}\">"));
            let element = self.lane_element(&Lane {
                id: &format!("{name}_0"),
                index: 0,
                limit: 10,
                shape: &lane.shape,
                width: lane.width,
                more: "allow=\"pedestrian\"",
            });
            self.line(2, &element);
            self.line(1, "</edge>");
        }
    }

    fn edge(&mut self, edge: usize) {
        let Edge { name, from, to, lanes } = &self.edges[edge];
        let (name, lanes) = (escaped(name), lanes.clone());
        let [from, to] = [*from, *to].map(|node| escaped(&self.nodes[node].name));
        self.line(
            1,
            &format!("<edge id=\"{name}\" from=\"{from}\" to=\"{to}\" priority=\"-1\">"),
        );
        for (index, number) in lanes.iter().enumerate() {
            let lane = self.lane(*number);
            let right = index.checked_sub(1).map(|right| self.lane(lanes[right]));
            let is_open = right.is_none_or(|right| right.left == Some(*number));
            let more = match (lane.usage, is_open) {
                (LaneUse::Drive, true) => "disallow=\"pedestrian\"",
                (LaneUse::Drive, false) => "disallow=\"pedestrian\" changeRight=\"authority\"",
                _ => "allow=\"pedestrian\"",
            };
            let element = self.lane_element(&Lane {
                id: &format!("{name}_{index}"),
                index,
                limit: match lane.usage {
                    LaneUse::Drive => lane.limit.unwrap_or(LIMIT),
                    _ => 10,
                },
                shape: &lane.shape,
                width: lane.width,
                more,
            });
            self.line(2, &element);
        }
        self.line(1, "</edge>");
    }

    fn lane_element(&self, lane: &Lane<'_>) -> String {
        let &Lane {
            id,
            index,
            limit,
            shape,
            width,
            more,
        } = lane;
        let points: Vec<[f64; 2]> = shape.iter().map(|point| self.meters(*point)).collect();
        let length: f64 = (points.windows(2))
            .map(|pair| (pair[1][0] - pair[0][0]).hypot(pair[1][1] - pair[0][1]))
            .sum();
        format!(
            "<lane id=\"{id}\" index=\"{index}\" {more} speed=\"{:.2}\" length=\"{:.2}\" width=\"{:.2}\" \
             shape=\"{}\"/>",
            f64::from(limit) / 3.6,
            length.max(0.1),
            width * self.network.cell,
            shown(&points),
        )
    }

    /// Writes the signals of the map.
    fn signals(&mut self) {
        for signal in &self.network.signals {
            let (name, offset) = (escaped(&signal.name), signal.offset);
            self.line(
                1,
                &format!("<tlLogic id=\"{name}\" type=\"static\" programID=\"0\" offset=\"{offset}\">"),
            );
            for phase in &signal.phases {
                let state: String = phase.aspects.iter().map(|aspect| aspect.letter()).collect();
                self.line(2, &format!("<phase duration=\"{}\" state=\"{state}\"/>", phase.ticks));
            }
            self.line(1, "</tlLogic>");
        }
    }

    /// Returns the name of the signal that a junction gets for connections without a link of one.
    fn made_name(&self, node: usize) -> Option<String> {
        let mut connections = self.nodes[node].connections.iter();
        connections.find(|connection| {
            let connection = &self.network.connections[**connection as usize];
            connection.sign == Sign::Signal && connection.light.is_none()
        })?;
        let mut name = self.nodes[node].name.clone();
        while self.network.signals.iter().any(|signal| signal.name == name) {
            name.push('_');
        }
        Some(escaped(&name))
    }

    /// Writes the phases of a signal that a junction gets: green and yellow for one street after the other.
    fn made_signal(&mut self, node: usize) {
        let Some(name) = self.made_name(node) else { return };
        let connections = self.nodes[node].connections.clone();
        let street = |connection: &u32| self.place[&self.network.connections[*connection as usize].from].0;
        let streets: Vec<usize> = connections.iter().map(street).collect();
        let mut order = streets.clone();
        order.sort_unstable();
        order.dedup();
        self.line(
            1,
            &format!("<tlLogic id=\"{name}\" type=\"static\" programID=\"0\" offset=\"0\">"),
        );
        for green in order {
            for (seconds, light) in [(GREEN, 'G'), (YELLOW, 'y')] {
                let state: String = (streets.iter())
                    .map(|street| if *street == green { light } else { 'r' })
                    .collect();
                self.line(2, &format!("<phase duration=\"{seconds}\" state=\"{state}\"/>"));
            }
        }
        self.line(1, "</tlLogic>");
    }

    fn junction(&mut self, node: usize) {
        let Node {
            name,
            shape,
            at,
            arriving,
            connections,
        } = &self.nodes[node];
        let signs = connections
            .iter()
            .map(|connection| self.network.connections[*connection as usize].sign);
        let signs: Vec<Sign> = signs.collect();
        let kind = match signs.as_slice() {
            [] => "dead_end",
            signs if signs.contains(&Sign::Signal) => "traffic_light",
            signs if signs.contains(&Sign::AllWayStop) => "allway_stop",
            signs if signs.contains(&Sign::Right) => "right_before_left",
            signs if signs.contains(&Sign::Stop) => "priority_stop",
            _ => "priority",
        };
        let [x, y] = self.meters(*at);
        let incoming: Vec<String> = (arriving.iter())
            .map(|lane| {
                let (edge, index) = self.place[lane];
                format!("{}_{index}", escaped(&self.edges[edge].name))
            })
            .collect();
        let inner: Vec<String> = (0..connections.len())
            .map(|at| format!("{}_0", self.inner_name(node, at)))
            .collect();
        let corners: Vec<[f64; 2]> = shape.iter().map(|point| self.meters(*point)).collect();
        let mut element = format!(
            "<junction id=\"{}\" type=\"{kind}\" x=\"{x:.2}\" y=\"{y:.2}\" incLanes=\"{}\" intLanes=\"{}\" \
             shape=\"{}\"",
            escaped(name),
            incoming.join(" "),
            inner.join(" "),
            shown(&corners),
        );
        let connections = connections.clone();
        if connections.is_empty() {
            element.push_str("/>");
            self.line(1, &element);
            return;
        }
        element.push('>');
        self.line(1, &element);
        let yields = |one: &u32, other: &u32| self.network.connections[*one as usize].yields_to.contains(other);
        let bits = |holds: &dyn Fn(&u32) -> bool| -> String {
            (connections.iter().rev())
                .map(|other| if holds(other) { '1' } else { '0' })
                .collect()
        };
        let requests: Vec<String> = (connections.iter().enumerate())
            .map(|(index, one)| {
                format!(
                    "<request index=\"{index}\" response=\"{}\" foes=\"{}\" cont=\"0\"/>",
                    bits(&|other| yields(one, other)),
                    bits(&|other| yields(one, other) || yields(other, one)),
                )
            })
            .collect();
        for request in requests {
            self.line(2, &request);
        }
        self.line(1, "</junction>");
    }

    /// Writes the connections in their order, each with the way from its lane inside the junction.
    fn connections(&mut self) {
        let mut places = vec![(0, 0); self.network.connections.len()];
        for (node, of) in self.nodes.iter().enumerate() {
            for (at, connection) in of.connections.iter().enumerate() {
                places[*connection as usize] = (node, at);
            }
        }
        for (number, (node, at)) in places.into_iter().enumerate() {
            let connection: &Connection = &self.network.connections[number];
            let [(from, from_lane), (to, to_lane)] = [connection.from, connection.to].map(|lane| self.place[&lane]);
            let [from, to] = [from, to].map(|edge| escaped(&self.edges[edge].name));
            let direction = match connection.direction {
                Direction::Left => "l",
                Direction::Right => "r",
                Direction::Straight => "s",
                Direction::Around => "t",
            };
            let state = match connection.sign {
                Sign::Priority => "M",
                Sign::Yield => "m",
                Sign::Stop => "s",
                Sign::AllWayStop => "w",
                Sign::Right => "=",
                Sign::Signal if connection.yields_to.is_empty() => "O",
                Sign::Signal => "o",
            };
            let inner = self.inner_name(node, at);
            let light = match (connection.light, connection.sign) {
                (Some(SignalLink { signal, link }), _) => {
                    let name = escaped(&self.network.signals[signal as usize].name);
                    format!(" tl=\"{name}\" linkIndex=\"{link}\"")
                }
                (None, Sign::Signal) => {
                    let name = self.made_name(node).unwrap_or_default();
                    format!(" tl=\"{name}\" linkIndex=\"{at}\"")
                }
                (None, _) => String::new(),
            };
            let lanes = format!("fromLane=\"{from_lane}\" toLane=\"{to_lane}\"");
            self.line(
                1,
                &format!(
                    "<connection from=\"{from}\" to=\"{to}\" {lanes} via=\"{inner}_0\"{light} dir=\"{direction}\" \
                     state=\"{state}\"/>"
                ),
            );
            self.line(
                1,
                &format!(
                    "<connection from=\"{inner}\" to=\"{to}\" fromLane=\"0\" toLane=\"{to_lane}\" \
                     dir=\"{direction}\" state=\"M\"/>"
                ),
            );
        }
    }
}

/// What an element of a lane says.
struct Lane<'a> {
    id: &'a str,
    index: usize,
    limit: u16,
    shape: &'a [Point],
    width: f64,
    more: &'a str,
}

/// Returns the edge of a lane and its number from the right: `E1_2` is the third lane of `E1`.
fn edge_of(name: &str) -> (&str, usize) {
    match name.rsplit_once('_') {
        Some((edge, index)) if !edge.is_empty() => index.parse().map_or((name, 0), |index| (edge, index)),
        _ => (name, 0),
    }
}

fn first(lane: &RoadLane) -> Point {
    lane.shape[0]
}

fn last(lane: &RoadLane) -> Point {
    lane.shape[lane.shape.len() - 1]
}

fn middle(corners: &[Point]) -> Point {
    #[allow(clippy::cast_precision_loss)] // shapes have few points
    let count = corners.len().max(1) as f64;
    Point {
        x: corners.iter().map(|corner| corner.x).sum::<f64>() / count,
        y: corners.iter().map(|corner| corner.y).sum::<f64>() / count,
    }
}

fn shown(points: &[[f64; 2]]) -> String {
    let points: Vec<String> = points.iter().map(|[x, y]| format!("{x:.2},{y:.2}")).collect();
    points.join(" ")
}
