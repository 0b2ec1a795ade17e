//! Agents: what each looks like, and how it is drawn.

use super::canvas::Frame;
use super::ink::Ink;
use crate::city::{Agent, Cell, Heading};
use crate::config::{AgentKind, Speed};

/// What a picture shows of an agent.
#[derive(Clone, Copy, Debug)]
pub struct Sprite<'a> {
    /// Its name. `Car_12` is labelled `C12`, `Pedestrian_3` is labelled `P3`; any other name labels itself, shortened.
    pub name: &'a str,
    /// What it is.
    pub kind: AgentKind,
    /// Its concepts, for example `ambulance`. One without a colour of its own gets one from a palette by its name.
    pub concepts: &'a [String],
    /// Where it is. An agent off the map is counted but not drawn.
    pub at: Cell,
    /// Where it is heading; `None` if it has not moved since it began its route.
    pub heading: Option<Heading>,
    /// What it decided; `None` if nothing yet.
    pub action: Option<Speed>,
}

impl<'a> Sprite<'a> {
    /// An agent as it is, its name, and what it decided.
    pub fn of(agent: &'a Agent, name: &'a str, action: Option<Speed>) -> Sprite<'a> {
        Sprite {
            name,
            kind: agent.kind,
            concepts: &agent.concepts,
            at: agent.cell,
            heading: agent.heading,
            action,
        }
    }
}

/// What tells agents apart besides the colour.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Mark {
    Plain,
    Cross,
    Windows,
    Lights,
    Learner,
    Stripes,
    Grey,
    Small,
}

/// The looks of a concept.
struct ConceptStyle {
    kind: AgentKind,
    name: &'static str,
    body: Ink,
    mark: Mark,
}

/// The concepts with looks of their own. An agent with several is drawn as the first of this list.
const CONCEPTS: [ConceptStyle; 7] = [
    ConceptStyle {
        kind: AgentKind::Car,
        name: "ambulance",
        body: Ink::AMBULANCE,
        mark: Mark::Cross,
    },
    ConceptStyle {
        kind: AgentKind::Car,
        name: "police",
        body: Ink::POLICE,
        mark: Mark::Lights,
    },
    ConceptStyle {
        kind: AgentKind::Car,
        name: "bus",
        body: Ink::BUS,
        mark: Mark::Windows,
    },
    ConceptStyle {
        kind: AgentKind::Car,
        name: "tiro",
        body: Ink::TIRO,
        mark: Mark::Learner,
    },
    ConceptStyle {
        kind: AgentKind::Car,
        name: "reckless",
        body: Ink::RECKLESS,
        mark: Mark::Stripes,
    },
    ConceptStyle {
        kind: AgentKind::Pedestrian,
        name: "old",
        body: Ink::OLD,
        mark: Mark::Grey,
    },
    ConceptStyle {
        kind: AgentKind::Pedestrian,
        name: "young",
        body: Ink::YOUNG,
        mark: Mark::Small,
    },
];

/// How one concept of a kind of agent looks, or an agent without concepts. The order is that of the legend.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Look<'a> {
    Plain(AgentKind),
    /// Position in [`CONCEPTS`].
    Known(AgentKind, usize),
    Other(AgentKind, &'a str),
}

impl<'a> Look<'a> {
    /// The looks of an agent's concepts, the one it is drawn as first.
    fn all(sprite: &Sprite<'a>) -> Vec<Look<'a>> {
        let known = |name: &str| {
            CONCEPTS
                .iter()
                .position(|style| style.kind == sprite.kind && style.name == name)
        };
        let mut looks: Vec<_> = sprite
            .concepts
            .iter()
            .map(|name| match known(name) {
                Some(position) => Look::Known(sprite.kind, position),
                None => Look::Other(sprite.kind, name),
            })
            .collect();
        if looks.is_empty() {
            looks.push(Look::Plain(sprite.kind));
        }
        looks.sort_unstable();
        looks.dedup();
        looks
    }

    pub(super) fn kind(self) -> AgentKind {
        match self {
            Look::Plain(kind) | Look::Known(kind, _) | Look::Other(kind, _) => kind,
        }
    }

    /// The name for the legend, in lower case as in agent sets.
    pub(super) fn name(self) -> &'a str {
        match self {
            Look::Plain(AgentKind::Car) => "car",
            Look::Plain(AgentKind::Pedestrian) => "pedestrian",
            Look::Known(_, position) => CONCEPTS[position].name,
            Look::Other(_, name) => name,
        }
    }

    fn mark(self) -> Mark {
        match self {
            Look::Known(_, position) => CONCEPTS[position].mark,
            Look::Plain(_) | Look::Other(..) => Mark::Plain,
        }
    }
}

/// The looks that occur among some agents, in the order of the legend, with the number of agents that have each.
pub(super) struct Wardrobe<'a> {
    pub(super) looks: Vec<(Look<'a>, usize)>,
    /// The colours of the concepts without one of their own, sorted by name.
    other: Vec<(&'a str, Ink)>,
}

impl<'a> Wardrobe<'a> {
    pub(super) fn of(agents: &[Sprite<'a>]) -> Wardrobe<'a> {
        let mut all: Vec<Look<'a>> = agents.iter().flat_map(Look::all).collect();
        // By kind first: `Look` sorts by variant, and the legend lists cars before pedestrians.
        all.sort_unstable_by_key(|&look| (look.kind(), look));
        let looks: Vec<_> = all
            .chunk_by(|a, b| a == b)
            .map(|equal| (equal[0], equal.len()))
            .collect();
        let mut names: Vec<&str> = looks
            .iter()
            .filter_map(|&(look, _)| match look {
                Look::Other(_, name) => Some(name),
                Look::Plain(_) | Look::Known(..) => None,
            })
            .collect();
        names.sort_unstable();
        names.dedup();
        Wardrobe {
            looks,
            other: colours(&names),
        }
    }

    fn body(&self, look: Look<'_>) -> Ink {
        match look {
            Look::Plain(AgentKind::Car) => Ink::CAR,
            Look::Plain(AgentKind::Pedestrian) => Ink::PEDESTRIAN,
            Look::Known(_, position) => CONCEPTS[position].body,
            Look::Other(_, name) => {
                let found = self.other.binary_search_by_key(&name, |&(other, _)| other);
                found.map_or(Ink::MUTED, |position| self.other[position].1)
            }
        }
    }

    /// Draws an agent with its middle at a pixel.
    pub(super) fn draw(&self, sprite: &Sprite<'_>, x: i32, y: i32, size: Size, frame: &mut Frame) {
        let looks = Look::all(sprite);
        let second = looks.get(1).map(|&look| self.body(look));
        let figure = Figure {
            look: looks[0],
            body: self.body(looks[0]),
            second,
            x,
            y,
            heading: sprite.heading,
        };
        figure.draw(sprite.action, size, frame);
    }

    /// Draws what the legend shows for a look.
    pub(super) fn sample(&self, look: Look<'_>, x: i32, y: i32, frame: &mut Frame) {
        let heading = Some(Heading::Right);
        Figure {
            look,
            body: self.body(look),
            second: None,
            x,
            y,
            heading,
        }
        .draw(None, Size::LEGEND, frame);
    }
}

/// Draws an ordinary car or pedestrian that takes an action.
pub(super) fn sample_action(kind: AgentKind, action: Speed, x: i32, y: i32, frame: &mut Frame) {
    let body = match kind {
        AgentKind::Car => Ink::CAR,
        AgentKind::Pedestrian => Ink::PEDESTRIAN,
    };
    let heading = Some(Heading::Right);
    Figure {
        look: Look::Plain(kind),
        body,
        second: None,
        x,
        y,
        heading,
    }
    .draw(Some(action), Size::LEGEND, frame);
}

/// A colour for each of the names, which are sorted: the one its name hashes to, or the next that is free. So a concept
/// has the same colour wherever no other claims it, and two share one only when there are more concepts than colours.
fn colours<'a>(names: &[&'a str]) -> Vec<(&'a str, Ink)> {
    let mut taken = [false; Ink::OTHER.len()];
    names
        .iter()
        .map(|&name| {
            // FNV-1a: stable for ever, unlike the hasher of the standard library.
            let hash = name.bytes().fold(0xcbf2_9ce4_8422_2325_u64, |hash, byte| {
                (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3)
            });
            let slots = Ink::OTHER.len();
            let wish = (hash % slots as u64) as usize;
            let slot = (wish..wish + slots)
                .map(|slot| slot % slots)
                .find(|&slot| !taken[slot])
                .unwrap_or(wish);
            taken[slot] = true;
            (name, Ink::OTHER[slot])
        })
        .collect()
}

/// How large agents are drawn: larger than life, since a cell can be a few pixels only.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Size {
    /// In eighths of a pixel: at 8 a figure has about the extents that are written next to its shape.
    unit: i32,
}

impl Size {
    const LEGEND: Size = Size { unit: 10 };

    /// The size for cells of that many pixels.
    pub(super) fn for_cell(pixels: i32) -> Size {
        Size {
            unit: (5 * pixels / 2).max(4),
        }
    }

    fn scale(self, length: i32) -> i32 {
        length * self.unit / 8
    }

    /// How far a figure reaches from its middle, in pixels: to left and right, and up and down.
    pub(super) fn reach(self, sprite: &Sprite<'_>) -> (i32, i32) {
        let (length, width) = self.half(Look::all(sprite)[0], sprite.heading);
        let along = match (sprite.kind, sprite.heading) {
            (AgentKind::Pedestrian, Some(_)) => length + 2 * nose(length),
            _ => length,
        };
        match sprite.heading {
            Some(Heading::Up | Heading::Down) => (width, along),
            _ => (along, width),
        }
    }

    /// Half the length and half the width of a figure in pixels.
    fn half(self, look: Look<'_>, heading: Option<Heading>) -> (i32, i32) {
        match (look.kind(), look.mark(), heading) {
            (AgentKind::Pedestrian, Mark::Small, _) => (self.scale(3), self.scale(3)),
            (AgentKind::Pedestrian, ..) => (self.scale(4), self.scale(4)),
            (AgentKind::Car, _, None) => (self.scale(6), self.scale(6)),
            (AgentKind::Car, Mark::Windows, _) => (self.scale(11), self.scale(5)),
            (AgentKind::Car, ..) => (self.scale(8), self.scale(5)),
        }
    }
}

/// Half the length of what shows where a pedestrian of that radius heads.
fn nose(radius: i32) -> i32 {
    (radius / 3).max(1)
}

/// An agent that is ready to be drawn.
struct Figure<'a> {
    look: Look<'a>,
    body: Ink,
    /// The colour of its second concept.
    second: Option<Ink>,
    x: i32,
    y: i32,
    heading: Option<Heading>,
}

impl Figure<'_> {
    fn draw(&self, action: Option<Speed>, size: Size, frame: &mut Frame) {
        let (length, width) = size.half(self.look, self.heading);
        match self.look.kind() {
            AgentKind::Car => self.car(action, length, width, frame),
            AgentKind::Pedestrian => self.pedestrian(action, length, frame),
        }
    }

    /// Fills a rectangle given in the figure's own axes, ends included: `along` grows ahead, `across` to its right.
    /// Without a heading it looks right.
    fn fill(&self, frame: &mut Frame, along: (i32, i32), across: (i32, i32), ink: Ink) {
        let (dr, dc) = self.heading.unwrap_or(Heading::Right).delta();
        let place = |along: i32, across: i32| (self.x + along * dc - across * dr, self.y + along * dr + across * dc);
        let (ax, ay) = place(along.0, across.0);
        let (bx, by) = place(along.1, across.1);
        frame.fill(ax.min(bx), ay.min(by), (ax - bx).abs() + 1, (ay - by).abs() + 1, ink);
    }

    /// A rectangle without its corners.
    fn rounded(&self, frame: &mut Frame, length: i32, width: i32, cut: i32, ink: Ink) {
        self.fill(frame, (-length, length), (cut - width, width - cut), ink);
        self.fill(frame, (cut - length, length - cut), (-width, width), ink);
    }

    fn car(&self, action: Option<Speed>, length: i32, width: i32, frame: &mut Frame) {
        let stopped = action == Some(Speed::Stop);
        let cut = (width / 4).max(1);
        if stopped {
            let ring = (width / 5).max(2);
            self.rounded(frame, length + ring, width + ring, cut + 1, Ink::SIGNAL_RED);
        }
        if self.heading.is_some() {
            // One dash behind it for each cell a tick.
            let dashes = match action {
                None | Some(Speed::Stop) => 0,
                Some(Speed::Slow) => 1,
                Some(Speed::Normal) => 2,
                Some(Speed::Fast) => 3,
            };
            let (gap, half) = ((width * 4 / 5).max(2), (width / 2).max(1));
            for dash in 0..dashes {
                let from = -length - 2 - dash * gap;
                self.fill(frame, (from - gap / 4, from), (-half, half), Ink::WHITE_PAINT);
            }
        }
        self.rounded(frame, length, width, cut, Ink::OUTLINE);
        self.rounded(frame, length - 1, width - 1, cut, self.body);
        let side = width - 1;
        if self.heading.is_some() {
            let glass = if self.look.mark() == Mark::Lights {
                Ink::PALE_GLASS
            } else {
                Ink::GLASS
            };
            let (front, thick) = (length * 3 / 8, length / 4);
            self.fill(frame, (front, front + thick), (1 - side, side - 1), glass);
            let rear = 2 - length;
            self.fill(
                frame,
                (rear, rear + (length / 8 - 1).max(0)),
                (1 - side, side - 1),
                glass,
            );
            let lamp = width / 5;
            for across in [(-side, lamp - side), (side - lamp, side)] {
                self.fill(frame, (length - 1, length), across, Ink::HEADLIGHT);
                if stopped {
                    self.fill(frame, (-length, -length + lamp.max(1)), across, Ink::SIGNAL_RED);
                }
            }
        }
        self.mark(length, width, frame);
        if let Some(ink) = self.second {
            let half = (width / 3).max(1);
            // At the rear, where it hides no mark.
            let middle = 1 + half - length;
            self.fill(frame, (middle - half, middle + half), (-half, half), Ink::OUTLINE);
            self.fill(frame, (middle - half + 1, middle + half - 1), (1 - half, half - 1), ink);
        }
    }

    /// What shows a car's concept on its roof.
    fn mark(&self, length: i32, width: i32, frame: &mut Frame) {
        let (half, thick) = (width - 2, width / 4);
        let middle = -length / 8;
        match self.look.mark() {
            Mark::Cross => {
                self.fill(frame, (middle - half, middle + half), (-thick, thick), Ink::SIGNAL_RED);
                self.fill(frame, (middle - thick, middle + thick), (-half, half), Ink::SIGNAL_RED);
            }
            Mark::Lights => {
                let along = (middle - thick, middle + thick);
                self.fill(frame, along, (1 - width, -1), Ink::SIGNAL_RED);
                self.fill(frame, along, (1, width - 1), Ink::SIGNAL_BLUE);
                self.fill(frame, along, (0, 0), Ink::WHITE_PAINT);
            }
            Mark::Windows => {
                let step = (width * 4 / 5).max(2);
                let mut from = 3 - length + step / 2;
                while from + step / 2 < length * 3 / 8 {
                    for across in [(1 - width, 1 - width + width / 5), (width - 1 - width / 5, width - 1)] {
                        self.fill(frame, (from, from + step / 2), across, Ink::GLASS);
                    }
                    from += step;
                }
            }
            Mark::Learner => {
                let plate = (width / 2).max(1);
                self.fill(
                    frame,
                    (middle - plate, middle + plate),
                    (-plate, plate),
                    Ink::WHITE_PAINT,
                );
                let (inner, pen) = (plate - 1, width / 8);
                self.fill(
                    frame,
                    (middle - inner, middle + inner),
                    (-inner, pen - inner),
                    Ink::SIGNAL_RED,
                );
                self.fill(
                    frame,
                    (middle - inner, middle + pen - inner),
                    (-inner, inner),
                    Ink::SIGNAL_RED,
                );
            }
            Mark::Stripes => {
                let at = (width / 3).max(1);
                for across in [-at, at] {
                    let across = (across - width / 10, across + width / 10);
                    self.fill(frame, (1 - length, length * 3 / 8 - 1), across, Ink::WHITE_PAINT);
                    self.fill(frame, (length * 5 / 8 + 1, length - 2), across, Ink::WHITE_PAINT);
                }
            }
            Mark::Plain | Mark::Grey | Mark::Small => {}
        }
    }

    fn pedestrian(&self, action: Option<Speed>, radius: i32, frame: &mut Frame) {
        let stopped = action == Some(Speed::Stop);
        let ink = if stopped { Ink::SIGNAL_RED } else { Ink::OUTLINE };
        if self.heading.is_some() {
            let nose = nose(radius);
            self.fill(frame, (radius, radius + nose), (-nose, nose), ink);
            self.fill(frame, (radius + nose, radius + 2 * nose), (0, 0), ink);
        }
        if stopped {
            frame.disc(self.x, self.y, radius + (radius / 4).max(1), ink);
            frame.disc(self.x, self.y, radius, Ink::WHITE_PAINT);
        } else {
            frame.disc(self.x, self.y, radius, ink);
        }
        frame.disc(self.x, self.y, radius - 1, self.body);
        let head = if self.look.mark() == Mark::Grey {
            Ink::GREY_HEAD
        } else {
            Ink::HEAD
        };
        frame.disc(self.x, self.y, (radius - 1) / 2, self.second.unwrap_or(head));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unknown_concepts_have_distinct_stable_colours() {
        let names = ["cyclist", "delivery", "drone", "jogger", "taxi", "tram", "truck", "van"];
        let all = colours(&names);
        for (position, (_, ink)) in all.iter().enumerate() {
            assert!(all[..position].iter().all(|(_, other)| other != ink));
        }
        assert_eq!(colours(&["taxi"]), colours(&["taxi"]));
        // More names than colours: all get one.
        let many: Vec<String> = (10..40).map(|number| number.to_string()).collect();
        let many: Vec<&str> = many.iter().map(String::as_str).collect();
        assert_eq!(colours(&many).len(), many.len());
    }
}
