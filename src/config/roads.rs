//! Reads the road network of a map.
//!
//! Junctions, lanes and connections are lists of lines of words, so that a large network stays small.

use crate::city::{
    Aspect, Connection, Direction, LIMIT_MAX, LaneUse, Network, Phase, Point, RoadJunction, RoadLane, Sign, Signal,
    SignalLink,
};
use crate::diag::{self, Diagnostic, MAX_FAULTS, did_you_mean, listed};
use crate::yaml::read::{Fields, integer, invalid, list, number, text};
use crate::yaml::{YamlNode, codes};
use std::collections::HashMap;
use std::ops::RangeInclusive;

/// The maximum number of cells of a network, which take five bytes each.
const MAX_CELLS: u64 = 1 << 25;
/// The maximum number of rows, and of columns.
const MAX_SIDE: u32 = 1 << 20;
/// The maximum number of points of a shape.
const MAX_POINTS: usize = 1000;
/// The maximum width of a lane in cells.
const MAX_WIDTH: f64 = 100.0;

/// What each line holds, for messages.
const JUNCTION: &str = "a junction: `NAME X,Y X,Y ...`";
const LANE: &str =
    "a lane: `NAME USE X,Y X,Y ...`, and before the points `to=JUNCTION`, `left=LANE`, `width=CELLS` and `limit=KMH`";
const CONNECTION: &str = "a connection: `LANE LANE DIRECTION SIGN X,Y ...`, and before the points `yields=LANE>LANE` for each that it yields to, and `light=SIGNAL:LINK`";
const SIGNAL: &str = "a signal: `NAME TICKS:LIGHTS TICKS:LIGHTS ...`, such as `S1 30:Gr 4:yr 30:rG 4:ry`, and before the phases `offset=TICKS`";

pub(super) fn network<'n>(node: &'n YamlNode, faults: &mut Vec<Diagnostic>) -> Option<Network> {
    let before = faults.len();
    let mut fields = Fields::open(node, "a road network", faults)?;
    let meters = "a length from 0.1 to 100 meters";
    let cell = (fields.required("cell", faults)).and_then(|node| number(node, 0.1..=100.0, meters, faults));
    let origin = fields
        .optional("origin")
        .map_or(Some([0.0; 2]), |node| origin(node, faults));
    let size = fields.required("size", faults).and_then(|node| size(node, faults));
    let [junctions, lanes, connections] = ["junctions", "lanes", "connections"].map(|key| fields.required(key, faults));
    let signals = fields.optional("signals");
    fields.close(faults);
    let (cell, origin, size) = (cell?, origin?, size?);
    let mut lines = |of: Option<&'n YamlNode>, what: &str| {
        let nodes = list(of?, what, faults)?;
        let lines = nodes.iter().map(|node| {
            Some(Line {
                node,
                text: text(node, what, faults)?,
            })
        });
        Some(lines.collect::<Vec<Option<Line<'_>>>>())
    };
    let lists = [
        lines(junctions, "lines, each with a junction"),
        lines(lanes, "lines, each with a lane"),
        lines(connections, "lines, each with a connection"),
        match signals {
            Some(_) => lines(signals, "lines, each with a signal"),
            None => Some(Vec::new()),
        },
    ];
    let [Some(junctions), Some(lanes), Some(connections), Some(signals)] = lists else {
        return None;
    };
    let mut reader = Reader {
        size,
        junctions: Names::new("junction"),
        lanes: Names::new("lane"),
        signals: Names::new("signal"),
        connections: HashMap::new(),
        faults,
    };
    let junctions: Vec<RoadJunction> = reader.all(junctions, Reader::junction);
    let signals: Vec<Signal> = reader.all(signals, Reader::signal);
    let names: Vec<Line<'_>> = lanes.iter().flatten().copied().collect();
    for line in names {
        reader.name_lane(line);
    }
    let lanes: Vec<RoadLane> = reader.all(lanes, Reader::lane);
    if reader.faults.len() > before {
        return None;
    }
    let of_connections: Vec<Line<'_>> = connections.iter().flatten().copied().collect();
    for (line, number) in of_connections.iter().zip(0..) {
        let mut words = line.words();
        if let (Some((from, _)), Some((to, _))) = (words.next(), words.next()) {
            reader.connections.insert((from, to), number);
        }
    }
    let connections: Vec<Connection> =
        reader.all(connections, |reader, line| reader.connection(line, &lanes, &signals));
    if lanes.iter().all(|lane| lane.usage != LaneUse::Drive) && faults.len() == before {
        let message = "the road network has no lane for cars";
        let fault = Diagnostic::new(codes::INVALID_VALUE, message).at(node.span, "");
        faults.push(fault.help("add one: `E1 drive 0,5 60,5`"));
    }
    (faults.len() == before).then_some(Network {
        cell,
        origin,
        size,
        junctions,
        lanes,
        connections,
        signals,
    })
}

/// The range of coordinates in meters.
const METERS: RangeInclusive<f64> = -1e8..=1e8;

fn origin(node: &YamlNode, faults: &mut Vec<Diagnostic>) -> Option<[f64; 2]> {
    let what = "two numbers: X and Y in meters";
    let [x, y] = list(node, what, faults)? else {
        invalid(node, what, faults);
        return None;
    };
    let [x, y] = [x, y].map(|node| number(node, METERS, "a number of meters from -100000000 to 100000000", faults));
    Some([x?, y?])
}

fn size(node: &YamlNode, faults: &mut Vec<Diagnostic>) -> Option<[u32; 2]> {
    let what = "two numbers: rows and columns of cells";
    let [rows, cols] = list(node, what, faults)? else {
        invalid(node, what, faults);
        return None;
    };
    let [rows, cols] = [rows, cols].map(|node| integer(node, 1..=MAX_SIDE, faults));
    let (rows, cols) = (rows?, cols?);
    let cells = u64::from(rows) * u64::from(cols);
    if cells > MAX_CELLS {
        let message = format!("a road network of {rows} x {cols} cells is too large");
        let fault = Diagnostic::new(diag::codes::LIMIT_EXCEEDED, message).at(node.span, "");
        faults.push(fault.help(format!(
            "the limit is {MAX_CELLS} cells: use longer cells, or a part of the map"
        )));
        return None;
    }
    Some([rows, cols])
}

/// A line of words.
#[derive(Clone, Copy)]
struct Line<'n> {
    node: &'n YamlNode,
    text: &'n str,
}

impl<'n> Line<'n> {
    /// The words, each with its number from 1.
    fn words(self) -> impl Iterator<Item = (&'n str, usize)> {
        self.text.split_ascii_whitespace().zip(1..)
    }
}

/// The positions of names.
struct Names<'n> {
    what: &'static str,
    numbers: HashMap<&'n str, u32>,
}

impl Names<'_> {
    fn new(what: &'static str) -> Self {
        Names {
            what,
            numbers: HashMap::new(),
        }
    }
}

struct Reader<'n, 'f> {
    size: [u32; 2],
    junctions: Names<'n>,
    lanes: Names<'n>,
    signals: Names<'n>,
    /// By the names of both lanes.
    connections: HashMap<(&'n str, &'n str), u32>,
    faults: &'f mut Vec<Diagnostic>,
}

impl<'n> Reader<'n, '_> {
    /// Reads all lines, until there are many faults.
    fn all<T>(
        &mut self,
        lines: Vec<Option<Line<'n>>>,
        mut read: impl FnMut(&mut Self, Line<'n>) -> Option<T>,
    ) -> Vec<T> {
        let mut all = Vec::with_capacity(lines.len());
        for line in lines.into_iter().flatten() {
            if self.faults.len() > MAX_FAULTS {
                break;
            }
            all.extend(read(self, line));
        }
        all
    }

    fn fault(&mut self, line: Line<'_>, message: String, help: &str) {
        let fault = Diagnostic::new(codes::INVALID_VALUE, message).at(line.node.span, "");
        self.faults.push(fault.help(help));
    }

    fn number_of(&mut self, line: Line<'_>, name: &str, of: fn(&Self) -> &Names<'n>) -> Option<u32> {
        let names = of(self);
        if let Some(number) = names.numbers.get(name) {
            return Some(*number);
        }
        let message = format!("the road network has no {} `{name}`", names.what);
        let fault = Diagnostic::new(codes::INVALID_VALUE, message).at(line.node.span, "");
        let fault = match did_you_mean(name, names.numbers.keys().copied().take(1000)) {
            Some(near) => fault.help(format!("did you mean `{near}`?")),
            None => {
                let mut known: Vec<&str> = names.numbers.keys().copied().collect();
                known.sort_unstable();
                fault.note(format!("its {}s: {}", names.what, listed(&known)))
            }
        };
        self.faults.push(fault);
        None
    }

    /// Reads a point `X,Y`; the edges of the map belong to it.
    fn point(&mut self, line: Line<'_>, (word, number): (&str, usize), form: &str) -> Option<Point> {
        let both = word
            .split_once(',')
            .and_then(|(x, y)| Some([x.parse::<f64>().ok()?, y.parse::<f64>().ok()?]));
        let Some([x, y]) = both.filter(|both| both.iter().all(|value| value.is_finite())) else {
            self.fault(
                line,
                format!("word {number} `{word}` is no point"),
                &format!("write {form}"),
            );
            return None;
        };
        let [rows, cols] = self.size.map(f64::from);
        if !(0.0..cols).contains(&x) || !(0.0..rows).contains(&y) {
            let message = format!("the point `{word}` is not on the map");
            let help = format!("X is at least 0 and less than {cols}, Y at least 0 and less than {rows}");
            self.fault(line, message, &help);
            return None;
        }
        Some(Point { x, y })
    }

    fn points(&mut self, line: Line<'n>, skip: usize, least: usize, form: &str) -> Option<Vec<Point>> {
        let words = line.words().skip(skip).filter(|(word, _)| !word.contains('='));
        let words: Vec<_> = words.collect();
        if words.len() < least || words.len() > MAX_POINTS {
            let message = format!(
                "the line has {}, expected {least} to {MAX_POINTS}",
                diag::counted(words.len(), "point")
            );
            self.fault(line, message, &format!("write {form}"));
            return None;
        }
        words.into_iter().map(|word| self.point(line, word, form)).collect()
    }

    fn register(&mut self, line: Line<'n>, of: fn(&mut Self) -> &mut Names<'n>, form: &str) -> Option<&'n str> {
        let Some((name, _)) = line.words().next() else {
            self.fault(line, "the line is empty".into(), &format!("write {form}"));
            return None;
        };
        let names = of(self);
        let number = u32::try_from(names.numbers.len()).expect("a configuration has few values");
        if names.numbers.insert(name, number).is_some() {
            let message = format!("there are two {}s `{name}`", names.what);
            self.fault(line, message, "give each its own name");
            return None;
        }
        Some(name)
    }

    fn junction(&mut self, line: Line<'n>) -> Option<RoadJunction> {
        let name = self.register(line, |reader| &mut reader.junctions, JUNCTION)?;
        Some(RoadJunction {
            name: name.to_owned(),
            shape: self.points(line, 1, 0, JUNCTION)?,
        })
    }

    fn name_lane(&mut self, line: Line<'n>) {
        self.register(line, |reader| &mut reader.lanes, LANE);
    }

    fn lane(&mut self, line: Line<'n>) -> Option<RoadLane> {
        let mut words = line.words();
        let (name, _) = words.next()?;
        let usage = words.next().map_or("", |(word, _)| word);
        let usage = self.one_of(line, usage, &LaneUse::ALL.map(|usage| (usage.name(), usage)), LANE)?;
        let (mut to, mut left, mut width, mut limit) = (None, None, 1.0, None);
        for (word, _) in words {
            let Some((key, value)) = word.split_once('=') else {
                continue;
            };
            match key {
                "to" => to = Some(self.number_of(line, value, |reader| &reader.junctions)?),
                "left" => left = Some(self.number_of(line, value, |reader| &reader.lanes)?),
                "width" => {
                    let given = value.parse().ok().filter(|width| (0.0..=MAX_WIDTH).contains(width));
                    let Some(given) = given else {
                        self.fault(
                            line,
                            format!("`{word}` is no width"),
                            "give a number of cells from 0 to 100",
                        );
                        return None;
                    };
                    width = given;
                }
                "limit" => {
                    limit = value.parse().ok().filter(|limit| (1..=LIMIT_MAX).contains(limit));
                    if limit.is_none() {
                        let help = format!("give a whole number of km/h from 1 to {LIMIT_MAX}");
                        self.fault(line, format!("`{word}` is no speed limit"), &help);
                        return None;
                    }
                }
                _ => {
                    self.fault(line, format!("`{word}` is unknown"), &format!("write {LANE}"));
                    return None;
                }
            }
        }
        let least = if usage == LaneUse::Place { 3 } else { 2 };
        let shape = self.points(line, 2, least, LANE)?;
        Some(RoadLane {
            name: name.to_owned(),
            usage,
            to,
            left,
            shape,
            width,
            limit,
        })
    }

    fn signal(&mut self, line: Line<'n>) -> Option<Signal> {
        let name = self.register(line, |reader| &mut reader.signals, SIGNAL)?;
        let (mut offset, mut phases) = (0, Vec::<Phase>::new());
        for (word, number) in line.words().skip(1) {
            if let Some(ticks) = word.strip_prefix("offset=") {
                match ticks.parse().ok().filter(|ticks| *ticks <= Signal::TICKS_MAX) {
                    Some(ticks) => offset = ticks,
                    None => {
                        let help = format!("give a whole number of ticks from 0 to {}", Signal::TICKS_MAX);
                        self.fault(line, format!("`{word}` is no offset"), &help);
                        return None;
                    }
                }
                continue;
            }
            let phase = word.split_once(':').and_then(|(ticks, lights)| {
                let ticks = ticks
                    .parse()
                    .ok()
                    .filter(|ticks| (1..=Signal::TICKS_MAX).contains(ticks))?;
                let aspects: Vec<Aspect> = lights.chars().map(Aspect::of).collect::<Option<_>>()?;
                (!aspects.is_empty()).then_some(Phase { ticks, aspects })
            });
            let Some(phase) = phase else {
                let help = format!(
                    "write `TICKS:LIGHTS` with 1 to {} ticks and a letter for each link: r (red), y (yellow), G (green), \
                     g (green, must yield) or o (off)",
                    Signal::TICKS_MAX
                );
                self.fault(line, format!("word {number} `{word}` is no phase"), &help);
                return None;
            };
            if let Some(first) = phases
                .first()
                .filter(|first| first.aspects.len() != phase.aspects.len())
            {
                let [links, others] = [&phase, first].map(|phase| diag::counted(phase.aspects.len(), "light"));
                let message = format!("the phase `{word}` has {links}, the first one has {others}");
                self.fault(line, message, "give each phase a letter for each link");
                return None;
            }
            phases.push(phase);
        }
        if phases.is_empty() {
            self.fault(line, "the signal has no phase".into(), &format!("write {SIGNAL}"));
            return None;
        }
        Some(Signal {
            name: name.to_owned(),
            offset,
            phases,
        })
    }

    /// Reads `SIGNAL:LINK`.
    fn light(&mut self, line: Line<'n>, value: &str, signals: &[Signal]) -> Option<SignalLink> {
        let Some((name, link)) = value.rsplit_once(':') else {
            self.fault(
                line,
                format!("`light={value}` names no link"),
                "write `light=SIGNAL:LINK` with the name of a signal and a number from 0",
            );
            return None;
        };
        let signal = self.number_of(line, name, |reader| &reader.signals)?;
        let links = signals.get(signal as usize).map_or(0, Signal::links);
        match link.parse().ok().filter(|link: &u32| (*link as usize) < links) {
            Some(link) => Some(SignalLink { signal, link }),
            None => {
                let help = format!("give a number from 0 to {}", links.saturating_sub(1));
                self.fault(line, format!("the signal `{name}` has no link `{link}`"), &help);
                None
            }
        }
    }

    fn connection(&mut self, line: Line<'n>, lanes: &[RoadLane], signals: &[Signal]) -> Option<Connection> {
        let words: Vec<(&str, usize)> = line.words().collect();
        let [(from, _), (to, _), (direction, _), (sign, _), ..] = words[..] else {
            self.fault(
                line,
                "the line has fewer than four words".into(),
                &format!("write {CONNECTION}"),
            );
            return None;
        };
        let mut drives = |name: &str| {
            let number = self.number_of(line, name, |reader| &reader.lanes)?;
            if lanes[number as usize].usage != LaneUse::Drive {
                let message = format!("the lane `{name}` is not for cars");
                self.fault(line, message, "connections lead cars from one lane to another");
                return None;
            }
            Some(number)
        };
        let (from, to) = (drives(from)?, drives(to)?);
        let directions = Direction::ALL.map(|direction| (direction.name(), direction));
        let direction = self.one_of(line, direction, &directions, CONNECTION)?;
        let sign = self.one_of(line, sign, &Sign::ALL.map(|sign| (sign.name(), sign)), CONNECTION)?;
        let (mut yields_to, mut light) = (Vec::new(), None);
        for (word, _) in &words[4..] {
            let Some((key, value)) = word.split_once('=') else {
                continue;
            };
            if key == "light" {
                light = Some(self.light(line, value, signals)?);
                continue;
            }
            let other = (value.split_once('>')).and_then(|names| self.connections.get(&names).copied());
            match (key, other) {
                ("yields", Some(other)) => yields_to.push(other),
                _ => {
                    let message = format!("`{word}` names no connection");
                    self.fault(
                        line,
                        message,
                        "write `yields=LANE>LANE` with the two lanes of another connection",
                    );
                    return None;
                }
            }
        }
        let shape = self.points(line, 4, 0, CONNECTION)?;
        Some(Connection {
            from,
            to,
            direction,
            sign,
            light,
            shape,
            yields_to,
        })
    }

    fn one_of<T: Copy>(&mut self, line: Line<'_>, word: &str, of: &[(&str, T)], form: &str) -> Option<T> {
        let found = of.iter().find(|(name, _)| *name == word).map(|(_, value)| *value);
        if found.is_none() {
            let names: Vec<&str> = of.iter().map(|(name, _)| *name).collect();
            let message = format!("expected one of {}, found `{word}`", names.join(", "));
            let help = match did_you_mean(word, names.iter().copied()) {
                Some(near) => format!("did you mean `{near}`?"),
                None => format!("write {form}"),
            };
            self.fault(line, message, &help);
        }
        found
    }
}
