//! Road networks of SUMO as map files.
//!
//! The reader takes what the city has: lanes for cars and for pedestrians, junctions with their shapes, connections
//! with their direction, their right of way, and what they must yield to, and signals with their phases, one tick a
//! second; of several programs of a signal, the first. The format is that of SUMO's network files:
//! an edge has lanes, a junction has the list of its links (`intLanes`), and `request` says for each link which others
//! have the right of way over it (`response`, a text of bits from the last link to the first).

use crate::city::{
    Aspect, Connection, Direction, LIMIT_MAX, LaneUse, Network, Phase, Point, RoadJunction, RoadLane, Sign, Signal,
    SignalLink, codes, distance,
};
use crate::diag::{Diagnostic, SourceId, Sources, Span};
use roxmltree::{Document, Node, ParsingOptions};
use std::collections::HashMap;
use std::fmt::Write;

/// The cells around the outermost point of a network.
const MARGIN: f64 = 2.0;
/// The width of a lane without one, in meters: SUMO's default.
const WIDTH: f64 = 3.2;
/// The distance within which the points of a shape are left out, in cells.
const TOLERANCE: f64 = 0.25;
/// The maximum number of elements and attributes of a file.
const NODES_MAX: u32 = 20_000_000;

/// A network that was read.
#[derive(Debug)]
pub struct Imported {
    /// The network.
    pub network: Network,
    /// The places that say of signals that their phases follow the traffic. The network repeats the phases of the file.
    pub adaptive: Vec<Span>,
}

/// Reads a network. A cell has sides of `cell` meters.
///
/// # Errors
/// `invalid-map` with the place for a text that is no XML, that is no network, or that refers to what it does not have.
pub fn import(sources: &Sources, source: SourceId, cell: f64) -> Result<Imported, Diagnostic> {
    let text = sources.text(source);
    let options = ParsingOptions {
        allow_dtd: false,
        nodes_limit: NODES_MAX,
        ..ParsingOptions::default()
    };
    let document = Document::parse_with_options(text, options).map_err(|error| {
        let position = error.pos();
        let at = offset(text, position.row, position.col);
        let end = text[at..].chars().next().map_or(at, |first| at + first.len_utf8());
        // The message of the parser ends with the place, which the diagnostic has.
        let message = error.to_string();
        let message = message.split(" at ").next().unwrap_or(&message).to_owned();
        Diagnostic::new(
            codes::INVALID_MAP,
            format!("the file is not well-formed XML: {message}"),
        )
        .at(Span::new(source, at..end), "")
        .help("export the network again, or repair this place")
    })?;
    let root = document.root_element();
    let reader = Reader { source, cell };
    if root.tag_name().name() != "net" {
        let message = format!(
            "the file is no network of SUMO: its root is `{}`, not `net`",
            root.tag_name().name()
        );
        let help = match root.tag_name().name() {
            "osm" => "name the file `….osm`, so that it is converted first",
            _ => "give a file that netconvert or netgenerate has written, such as `town.net.xml`",
        };
        return Err(reader.fault(root, message).help(help));
    }
    let signals = root.children().filter(|node| node.has_tag_name("tlLogic"));
    let types = signals.filter_map(|node| node.attribute_node("type"));
    let adaptive = types.filter(|kind| kind.value() != "static");
    Ok(Imported {
        adaptive: adaptive.map(|kind| Span::new(source, kind.range())).collect(),
        network: reader.network(root)?,
    })
}

/// Returns the offset of a place, whose row and column count from 1.
fn offset(text: &str, row: u32, col: u32) -> usize {
    let line_start = match row {
        0 | 1 => 0,
        _ => text
            .match_indices('\n')
            .nth(row as usize - 2)
            .map_or(text.len(), |(at, _)| at + 1),
    };
    let in_line = text[line_start..].char_indices().nth(col.saturating_sub(1) as usize);
    in_line.map_or(text.len(), |(at, _)| line_start + at)
}

struct Reader {
    source: SourceId,
    cell: f64,
}

/// A link of a junction: the positions of both.
type Link = (usize, usize);

/// A lane for cars or pedestrians, with what connections need.
struct FoundLane<'x> {
    lane: RoadLane,
    edge: &'x str,
    index: &'x str,
}

impl Reader {
    fn fault(&self, node: Node<'_, '_>, message: String) -> Diagnostic {
        // The start tag of a node says enough.
        let range = node.range();
        let text = &node.document().input_text()[range.clone()];
        let end = text.find('>').map_or(range.end, |end| range.start + end + 1);
        Diagnostic::new(codes::INVALID_MAP, message).at(Span::new(self.source, range.start..end), "")
    }

    fn attribute<'x>(&self, node: Node<'x, '_>, name: &str) -> Result<&'x str, Diagnostic> {
        node.attribute(name).ok_or_else(|| {
            let message = format!("the element `{}` has no attribute `{name}`", node.tag_name().name());
            self.fault(node, message).help("export the network again, or add it")
        })
    }

    /// Returns the name of an element, which lines of a map file hold as a word.
    fn name<'x>(&self, node: Node<'x, '_>) -> Result<&'x str, Diagnostic> {
        let name = self.attribute(node, "id")?;
        if name.is_empty() || name.contains(|letter: char| letter.is_whitespace() || letter.is_control()) {
            return Err(self
                .fault(node, format!("the name `{name}` is empty or has a space"))
                .help("rename it"));
        }
        Ok(name)
    }

    fn number(&self, node: Node<'_, '_>, name: &str, text: &str) -> Result<f64, Diagnostic> {
        let value = text.parse().ok().filter(|value: &f64| value.is_finite());
        value.ok_or_else(|| {
            self.fault(node, format!("the attribute `{name}` is no number: `{text}`"))
                .help("write for example `12.5`")
        })
    }

    /// Reads the points of a shape in meters; y grows upwards.
    fn shape(&self, node: Node<'_, '_>, text: &str) -> Result<Vec<Point>, Diagnostic> {
        let points = text.split_ascii_whitespace().map(|word| {
            let mut parts = word.split(',');
            let (Some(x), Some(y)) = (parts.next(), parts.next()) else {
                let message = format!("the attribute `shape` has no point at `{word}`");
                return Err(self
                    .fault(node, message)
                    .help("a point is two or three numbers with commas: `12.5,3`"));
            };
            Ok(Point {
                x: self.number(node, "shape", x)?,
                y: self.number(node, "shape", y)?,
            })
        });
        points.collect()
    }

    fn network(&self, root: Node<'_, '_>) -> Result<Network, Diagnostic> {
        let elements = |name: &'static str| root.children().filter(move |node| node.has_tag_name(name));
        let mut junctions = Vec::new();
        let mut junction_numbers: HashMap<&str, u32> = HashMap::new();
        // For each lane inside a junction, the junction and its number among the links.
        let mut links: HashMap<&str, Link> = HashMap::new();
        let mut requests: Vec<Vec<&str>> = Vec::new();
        for node in elements("junction").filter(|node| node.attribute("type") != Some("internal")) {
            let name = self.name(node)?;
            let number = junctions.len();
            for (link, lane) in node
                .attribute("intLanes")
                .unwrap_or("")
                .split_ascii_whitespace()
                .enumerate()
            {
                links.insert(lane, (number, link));
            }
            let mut responses = Vec::new();
            for request in node.children().filter(|node| node.has_tag_name("request")) {
                let index: usize = self.attribute(request, "index")?.parse().unwrap_or(usize::MAX);
                if index != responses.len() {
                    let message = format!("expected the request with the index {}", responses.len());
                    return Err(self
                        .fault(request, message)
                        .help("requests come in the order of their links"));
                }
                responses.push(self.attribute(request, "response")?);
            }
            requests.push(responses);
            junction_numbers.insert(name, u32::try_from(number).expect("a file has few junctions"));
            let shape = self.shape(node, node.attribute("shape").unwrap_or(""))?;
            junctions.push(RoadJunction {
                name: name.to_owned(),
                shape,
            });
        }
        let mut inner: HashMap<&str, Vec<Point>> = HashMap::new();
        let mut found: Vec<FoundLane<'_>> = Vec::new();
        for edge in elements("edge") {
            self.edge(edge, &junction_numbers, &mut inner, &mut found)?;
        }
        let of_edge: HashMap<(&str, &str), u32> = (found.iter().zip(0..))
            .map(|(found, number)| ((found.edge, found.index), number))
            .collect();
        // The lane behind each lane inside a junction: cars may wait between the two.
        let mut behind: HashMap<String, &str> = HashMap::new();
        for node in elements("connection").filter(|node| is_inner(node.attribute("from"))) {
            if let (Some(from), Some(index), Some(via)) = (
                node.attribute("from"),
                node.attribute("fromLane"),
                node.attribute("via"),
            ) {
                behind.insert(format!("{from}_{index}"), via);
            }
        }
        let mut signals: Vec<Signal> = Vec::new();
        let mut signal_numbers: HashMap<&str, u32> = HashMap::new();
        for node in elements("tlLogic") {
            let name = self.name(node)?;
            if !signal_numbers.contains_key(name) {
                signal_numbers.insert(name, u32::try_from(signals.len()).expect("a file has few signals"));
                signals.push(self.signal(node, name)?);
            }
        }
        let mut connections: Vec<(Connection, Option<Link>)> = Vec::new();
        for node in elements("connection").filter(|node| !is_inner(node.attribute("from"))) {
            let before = connections.len();
            connections.extend(self.connection(node, &of_edge, &found, &inner, &behind, &links)?);
            for (connection, _) in &mut connections[before..] {
                connection.light = self.light(node, &signal_numbers, &signals)?;
            }
        }
        let of_link: HashMap<Link, u32> = (connections.iter().zip(0..))
            .filter_map(|((_, link), number)| Some(((*link)?, number)))
            .collect();
        for (connection, link) in &mut connections {
            let Some((junction, link)) = *link else { continue };
            let Some(response) = requests[junction].get(link) else {
                continue;
            };
            let foes = response.bytes().rev().enumerate().filter(|(_, bit)| *bit == b'1');
            connection.yields_to = foes
                .filter_map(|(foe, _)| of_link.get(&(junction, foe)).copied())
                .collect();
            connection.yields_to.sort_unstable();
        }
        let mut network = Network {
            cell: self.cell,
            origin: [0.0; 2],
            size: [1, 1],
            junctions,
            lanes: found.into_iter().map(|found| found.lane).collect(),
            connections: connections.into_iter().map(|(connection, _)| connection).collect(),
            signals,
        };
        if network.lanes.iter().all(|lane| lane.usage != LaneUse::Drive) {
            return Err(self
                .fault(root, "the network has no lane for passenger cars".to_owned())
                .help("the city needs at least one; export the network with streets for cars"));
        }
        scale(&mut network);
        Ok(network)
    }

    /// Adds the lanes of an edge.
    fn edge<'x>(
        &self,
        edge: Node<'x, '_>,
        junctions: &HashMap<&str, u32>,
        inner: &mut HashMap<&'x str, Vec<Point>>,
        found: &mut Vec<FoundLane<'x>>,
    ) -> Result<(), Diagnostic> {
        let name = self.attribute(edge, "id")?;
        let function = edge.attribute("function").unwrap_or("normal");
        let junction = |name: &str| junctions.get(name).copied();
        let to = match function {
            "normal" => match junction(self.attribute(edge, "to")?) {
                Some(junction) => Some(junction),
                None => {
                    let message = format!("the edge `{name}` leads to a junction that the network does not have");
                    return Err(self.fault(edge, message).help("export the network again"));
                }
            },
            // Its name is that of its junction with a number: `:J1_c0`.
            _ => (name.strip_prefix(':'))
                .and_then(|name| name.rsplit_once('_'))
                .and_then(|(name, _)| junction(name)),
        };
        let first = found.len();
        for lane in edge.children().filter(|node| node.has_tag_name("lane")) {
            let id = self.name(lane)?;
            let shape = self.shape(lane, self.attribute(lane, "shape")?)?;
            let usage = match function {
                "internal" => {
                    inner.insert(id, shape);
                    continue;
                }
                "crossing" => LaneUse::Crossing,
                "walkingarea" => LaneUse::Place,
                "connector" => continue,
                _ if allows(lane, "passenger") => LaneUse::Drive,
                _ if allows(lane, "pedestrian") => LaneUse::Walk,
                _ => continue,
            };
            let least = if usage == LaneUse::Place { 3 } else { 2 };
            if shape.len() < least {
                // netconvert writes such places for junctions without room.
                if usage != LaneUse::Drive {
                    continue;
                }
                let message = format!("the lane `{id}` has {} points, expected at least {least}", shape.len());
                return Err(self.fault(lane, message).help("export the network again"));
            }
            let limit = (lane.attribute("speed"))
                .map(|text| self.number(lane, "speed", text))
                .transpose()?
                .filter(|_| usage == LaneUse::Drive)
                .map(|speed| (speed * 3.6).round().clamp(1.0, f64::from(LIMIT_MAX)));
            let width = lane
                .attribute("width")
                .map_or(Ok(WIDTH), |text| self.number(lane, "width", text))?;
            let number = u32::try_from(found.len()).expect("a file has few lanes");
            let beside = found[first..]
                .iter_mut()
                .last()
                .filter(|beside| usage == LaneUse::Drive && beside.lane.usage == LaneUse::Drive && allows_change(lane));
            if let Some(right) = beside {
                right.lane.left = Some(number);
            }
            found.push(FoundLane {
                lane: RoadLane {
                    name: id.to_owned(),
                    usage,
                    to: if usage == LaneUse::Walk { None } else { to },
                    left: None,
                    shape,
                    width: (width / self.cell * 100.0).round() / 100.0,
                    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // it is clamped
                    limit: limit.map(|limit| limit as u16),
                },
                edge: name,
                index: self.attribute(lane, "index")?,
            });
        }
        Ok(())
    }

    /// Reads the program of a signal.
    fn signal(&self, node: Node<'_, '_>, name: &str) -> Result<Signal, Diagnostic> {
        let seconds = |node: Node<'_, '_>, attribute: &str, text: &str, least: f64| -> Result<u32, Diagnostic> {
            let seconds = self.number(node, attribute, text)?.round();
            let most = f64::from(Signal::TICKS_MAX);
            if !(least..=most).contains(&seconds) {
                let message = format!("the attribute `{attribute}` is not from {least} to {most} seconds: `{text}`");
                return Err(self.fault(node, message).help("shorten the phase"));
            }
            #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // it is in the range
            Ok(seconds as u32)
        };
        let mut phases: Vec<Phase> = Vec::new();
        for phase in node.children().filter(|node| node.has_tag_name("phase")) {
            let duration = self.attribute(phase, "duration")?;
            let state = self.attribute(phase, "state")?;
            let aspects: Option<Vec<Aspect>> = (state.chars())
                .map(|letter| match letter {
                    // Red and yellow together, and red that lets cars turn right after a stop, are red.
                    'u' | 's' => Aspect::of('r'),
                    'O' => Aspect::of('o'),
                    'R' | 'Y' => Aspect::of(letter.to_ascii_lowercase()),
                    letter => Aspect::of(letter),
                })
                .collect();
            let Some(aspects) = aspects.filter(|aspects| !aspects.is_empty()) else {
                let message = format!("the attribute `state` has no letters of lights: `{state}`");
                return Err(self
                    .fault(phase, message)
                    .help("write a letter for each link, such as `GGrr`"));
            };
            if phases.first().is_some_and(|first| first.aspects.len() != aspects.len()) {
                let message = "the phases of the signal have different numbers of links".to_owned();
                return Err(self
                    .fault(phase, message)
                    .help("write a letter for each link in each phase"));
            }
            let ticks = seconds(phase, "duration", duration, 1.0)?;
            phases.push(Phase { ticks, aspects });
        }
        if phases.is_empty() {
            let message = format!("the signal `{name}` has no phase");
            return Err(self
                .fault(node, message)
                .help("export the network again, or remove the signal"));
        }
        let offset = match node.attribute("offset") {
            // SUMO also writes `begin` for the start of the simulation.
            Some(text) if text != "begin" => {
                let cycle: u32 = phases.iter().map(|phase| phase.ticks).fold(0, u32::saturating_add);
                let number = self.number(node, "offset", text)?.rem_euclid(f64::from(cycle));
                seconds(node, "offset", &number.to_string(), 0.0)?
            }
            _ => 0,
        };
        Ok(Signal {
            name: name.to_owned(),
            offset,
            phases,
        })
    }

    /// Reads the link of a signal that regulates a connection.
    fn light(
        &self,
        node: Node<'_, '_>,
        numbers: &HashMap<&str, u32>,
        signals: &[Signal],
    ) -> Result<Option<SignalLink>, Diagnostic> {
        // A network without programs has signals whose lights nobody knows.
        let Some(&signal) = node.attribute("tl").and_then(|name| numbers.get(name)) else {
            return Ok(None);
        };
        let text = self.attribute(node, "linkIndex")?;
        let link = text.parse().ok();
        match link.filter(|link: &u32| (*link as usize) < signals[signal as usize].links()) {
            Some(link) => Ok(Some(SignalLink { signal, link })),
            None => {
                let message = format!("the signal of the connection has no link `{text}`");
                Err(self.fault(node, message).help("export the network again"))
            }
        }
    }

    /// Reads a connection between two lanes for cars, with the number of its link; `None` for other lanes.
    fn connection(
        &self,
        node: Node<'_, '_>,
        of_edge: &HashMap<(&str, &str), u32>,
        found: &[FoundLane<'_>],
        inner: &HashMap<&str, Vec<Point>>,
        behind: &HashMap<String, &str>,
        links: &HashMap<&str, Link>,
    ) -> Result<Option<(Connection, Option<Link>)>, Diagnostic> {
        let lane = |edge: &str, index: &str| -> Result<Option<u32>, Diagnostic> {
            let (edge, index) = (self.attribute(node, edge)?, self.attribute(node, index)?);
            Ok(of_edge.get(&(edge, index)).copied())
        };
        let (Some(from), Some(to)) = (lane("from", "fromLane")?, lane("to", "toLane")?) else {
            return Ok(None);
        };
        if [from, to]
            .iter()
            .any(|&lane| found[lane as usize].lane.usage != LaneUse::Drive)
        {
            return Ok(None);
        }
        let direction = match node.attribute("dir").unwrap_or("s") {
            "l" | "L" => Direction::Left,
            "r" | "R" => Direction::Right,
            "t" => Direction::Around,
            _ => Direction::Straight,
        };
        let sign = match (node.attribute("tl"), node.attribute("state").unwrap_or("M")) {
            (Some(_), _) => Sign::Signal,
            (None, "=") => Sign::Right,
            (None, "s") => Sign::Stop,
            (None, "w") => Sign::AllWayStop,
            (None, "m") => Sign::Yield,
            (None, _) => Sign::Priority,
        };
        let mut shape = Vec::new();
        let mut link = None;
        let mut via = node.attribute("via");
        while let Some(lane) = via {
            let Some(points) = inner.get(lane) else {
                let message = format!("the connection goes over a lane `{lane}` that the network does not have");
                return Err(self.fault(node, message).help("export the network again"));
            };
            shape.extend(points);
            link = links.get(lane).copied().or(link);
            via = behind.get(lane).copied().filter(|_| shape.len() < 1000);
        }
        let connection = Connection {
            from,
            to,
            direction,
            sign,
            light: None,
            shape,
            yields_to: Vec::new(),
        };
        Ok(Some((connection, link)))
    }
}

fn is_inner(edge: Option<&str>) -> bool {
    edge.is_some_and(|edge| edge.starts_with(':'))
}

/// Returns whether a lane is open to a class of traffic.
fn allows(lane: Node<'_, '_>, class: &str) -> bool {
    let has = |list: &str| list.split_ascii_whitespace().any(|word| word == class || word == "all");
    match (lane.attribute("allow"), lane.attribute("disallow")) {
        (Some(allowed), _) => has(allowed),
        (None, Some(closed)) => !has(closed),
        (None, None) => true,
    }
}

/// Returns whether cars may change into a lane from the lane to its right.
fn allows_change(lane: Node<'_, '_>) -> bool {
    lane.attribute("changeRight").is_none_or(|classes| {
        classes
            .split_ascii_whitespace()
            .any(|word| word == "passenger" || word == "all")
    })
}

/// Turns positions in meters, whose y grows upwards, into cells, whose rows grow downwards.
fn scale(network: &mut Network) {
    let cell = network.cell;
    let [mut low, mut high] = [[f64::INFINITY; 2], [f64::NEG_INFINITY; 2]];
    let mut all: Vec<&mut Vec<Point>> = Vec::new();
    all.extend(network.junctions.iter_mut().map(|junction| &mut junction.shape));
    all.extend(network.lanes.iter_mut().map(|lane| &mut lane.shape));
    all.extend(network.connections.iter_mut().map(|connection| &mut connection.shape));
    all.iter_mut().for_each(|shape| simplify(shape, TOLERANCE * cell));
    for point in all.iter().flat_map(|shape| shape.iter()) {
        for (axis, value) in [point.x, point.y].into_iter().enumerate() {
            (low[axis], high[axis]) = (low[axis].min(value), high[axis].max(value));
        }
    }
    let round = |value: f64| (value * 100.0).round() / 100.0;
    let [left, top] = [round(low[0] - MARGIN * cell), round(high[1] + MARGIN * cell)];
    for point in all.into_iter().flatten() {
        *point = Point {
            x: round((point.x - left) / cell),
            y: round((top - point.y) / cell),
        };
    }
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // the reader of maps limits sizes
    let side = |axis: usize| ((high[axis] - low[axis]) / cell + 2.0 * MARGIN).ceil() as u32 + 1;
    network.size = [side(1), side(0)];
    network.origin = [left, top];
}

/// Leaves out the points of a shape that are near the line through those around them (Douglas and Peucker, 1973).
fn simplify(shape: &mut Vec<Point>, tolerance: f64) {
    if shape.len() < 3 {
        return;
    }
    let mut kept = vec![false; shape.len()];
    (kept[0], kept[shape.len() - 1]) = (true, true);
    let mut open = vec![(0, shape.len() - 1)];
    while let Some((first, last)) = open.pop() {
        let distances = (first + 1..last).map(|at| (at, distance(shape[at], shape[first], shape[last])));
        let farthest = distances.max_by(|(_, one), (_, other)| one.total_cmp(other));
        if let Some((at, _)) = farthest.filter(|(_, distance)| *distance > tolerance) {
            kept[at] = true;
            open.extend([(first, at), (at, last)]);
        }
    }
    let mut kept = kept.into_iter();
    shape.retain(|_| kept.next().unwrap_or(true));
}

/// Returns a network as the text of a map file.
pub fn map_file(network: &Network) -> String {
    let mut text = String::new();
    let points = |text: &mut String, shape: &[Point]| {
        for point in shape {
            let _ = write!(text, " {},{}", point.x, point.y);
        }
    };
    let ([rows, cols], [left, top]) = (network.size, network.origin);
    let _ = writeln!(
        text,
        "roads:\n  cell: {}\n  origin: [{left}, {top}]\n  size: [{rows}, {cols}]\n  junctions:",
        network.cell
    );
    for junction in &network.junctions {
        let _ = write!(text, "    - \"{}", yaml_quoted(&junction.name));
        points(&mut text, &junction.shape);
        text.push_str("\"\n");
    }
    text.push_str("  lanes:\n");
    for lane in &network.lanes {
        let _ = write!(text, "    - \"{} {}", yaml_quoted(&lane.name), lane.usage.name());
        if let Some(to) = lane.to {
            let _ = write!(text, " to={}", yaml_quoted(&network.junctions[to as usize].name));
        }
        if let Some(left) = lane.left {
            let _ = write!(text, " left={}", yaml_quoted(&network.lanes[left as usize].name));
        }
        let _ = write!(text, " width={}", lane.width);
        if let Some(limit) = lane.limit {
            let _ = write!(text, " limit={limit}");
        }
        points(&mut text, &lane.shape);
        text.push_str("\"\n");
    }
    let name = |lane: u32| yaml_quoted(&network.lanes[lane as usize].name);
    text.push_str("  connections:\n");
    for connection in &network.connections {
        let (direction, sign) = (connection.direction.name(), connection.sign.name());
        let _ = write!(
            text,
            "    - \"{} {} {direction} {sign}",
            name(connection.from),
            name(connection.to)
        );
        if let Some(SignalLink { signal, link }) = connection.light {
            let signal = yaml_quoted(&network.signals[signal as usize].name);
            let _ = write!(text, " light={signal}:{link}");
        }
        for &other in &connection.yields_to {
            let other = &network.connections[other as usize];
            let _ = write!(text, " yields={}>{}", name(other.from), name(other.to));
        }
        points(&mut text, &connection.shape);
        text.push_str("\"\n");
    }
    if !network.signals.is_empty() {
        text.push_str("  signals:\n");
    }
    for signal in &network.signals {
        let _ = write!(text, "    - \"{}", yaml_quoted(&signal.name));
        if signal.offset > 0 {
            let _ = write!(text, " offset={}", signal.offset);
        }
        for phase in &signal.phases {
            let letters: String = phase.aspects.iter().map(|aspect| aspect.letter()).collect();
            let _ = write!(text, " {}:{letters}", phase.ticks);
        }
        text.push_str("\"\n");
    }
    text
}

/// Returns a name as a part of a text in double quotes of YAML.
fn yaml_quoted(name: &str) -> String {
    name.replace('\\', "\\\\").replace('"', "\\\"")
}
