//! The subject of an icon, and its facing.

use crate::city::Heading;
use crate::city::{AgentKind, Building, PICTURES};
use crate::render::car;
use crate::render::pedestrian;
use std::fmt;

/// The number of concepts that the standard predicates define.
const STANDARD: usize = 7;

/// The subject of an icon: a building, or a type of agent with its concepts, all of which show.
///
/// The name is the building type (`gas-station`), the concepts joined by `+` (`bus+tiro`), or the agent type (`car`,
/// `pedestrian`). A concept without its own looks follows one with looks, or the agent type: `car+taxi`.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Class(pub(super) Subject);

#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Subject {
    Building(Building),
    /// Concepts without duplicates, in the order of the name.
    Agent(AgentKind, Vec<String>),
}

impl Class {
    /// Returns the class of a building.
    pub const fn building(building: Building) -> Class {
        Class(Subject::Building(building))
    }

    /// Returns the class of an agent. The order of the concepts does not matter.
    pub fn agent(kind: AgentKind, concepts: &[String]) -> Class {
        let rank = |name: &str| PICTURES.iter().position(|&known| known == (kind, name));
        let mut concepts = concepts.to_vec();
        concepts.sort_by(|a, b| {
            let place = |name: &str| rank(name).unwrap_or(PICTURES.len());
            (place(a), a).cmp(&(place(b), b))
        });
        concepts.dedup();
        Class(Subject::Agent(kind, concepts))
    }

    /// Returns the class with this name, whose concepts may be in any order; `None` if there is none.
    pub fn from_name(name: &str) -> Option<Class> {
        if let Some(building) = Building::ALL
            .into_iter()
            .find(|&building| building_name(building) == name)
        {
            return Some(Class::building(building));
        }
        let mut parts: Vec<&str> = name.split('+').collect();
        let kind = parts.iter().find_map(|part| {
            let of_concept = PICTURES.iter().find(|(_, known)| known == part).map(|(kind, _)| *kind);
            of_concept.or_else(|| AgentKind::ALL.into_iter().find(|&kind| kind_name(kind) == *part))
        })?;
        if parts[0] == kind_name(kind) {
            parts.remove(0);
        }
        let plain = parts.iter().all(|part| {
            let foreign = PICTURES.iter().any(|(other, known)| known == part && *other != kind);
            !part.is_empty() && !foreign && !AgentKind::ALL.into_iter().any(|kind| kind_name(kind) == *part)
        });
        plain.then(|| Class::agent(kind, &parts.into_iter().map(str::to_owned).collect::<Vec<_>>()))
    }

    /// Returns all classes of buildings, and of agents with at most one concept of the standard predicates.
    pub fn known() -> Vec<Class> {
        let plain = AgentKind::ALL.map(|kind| (kind, None));
        let mut agents: Vec<_> = PICTURES[..STANDARD]
            .iter()
            .map(|&(kind, name)| (kind, Some(name)))
            .chain(plain)
            .collect();
        // Agents without concepts first.
        agents.sort_by_key(|&(kind, concept)| (kind, concept.is_some()));
        let agents = agents.into_iter().map(|(kind, concept)| {
            let concepts: Vec<String> = concept.map(str::to_owned).into_iter().collect();
            Class::agent(kind, &concepts)
        });
        agents.chain(Building::ALL.map(Class::building)).collect()
    }

    /// Returns type and concepts of an agent class; `None` for buildings.
    pub fn of_agent(&self) -> Option<(AgentKind, &[String])> {
        match &self.0 {
            Subject::Agent(kind, concepts) => Some((*kind, concepts)),
            Subject::Building(_) => None,
        }
    }

    /// Returns the features for drawing a car and a pedestrian with these concepts.
    pub(super) fn features(concepts: &[String]) -> (car::Features, pedestrian::Features) {
        let has = |name: &str| concepts.iter().any(|concept| concept == name);
        let car = car::Features {
            ambulance: has("ambulance"),
            bus: has("bus"),
            police: has("police"),
            tiro: has("tiro"),
            reckless: has("reckless"),
            bicycle: has("bicycle"),
        };
        let pedestrian = pedestrian::Features {
            old: has("old"),
            young: has("young"),
        };
        (car, pedestrian)
    }

    /// Returns whether a concept has its own looks.
    pub(super) fn is_drawn(kind: AgentKind, concept: &str) -> bool {
        PICTURES.contains(&(kind, concept))
    }
}

/// Writes the name.
impl fmt::Display for Class {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.0 {
            Subject::Building(building) => f.write_str(building_name(*building)),
            Subject::Agent(kind, concepts) => {
                let named = concepts.first().is_some_and(|first| Class::is_drawn(*kind, first));
                let kind = (!named).then(|| kind_name(*kind));
                let parts: Vec<&str> = kind.into_iter().chain(concepts.iter().map(String::as_str)).collect();
                f.write_str(&parts.join("+"))
            }
        }
    }
}

const fn kind_name(kind: AgentKind) -> &'static str {
    match kind {
        AgentKind::Car => "car",
        AgentKind::Pedestrian => "pedestrian",
    }
}

const fn building_name(building: Building) -> &'static str {
    match building {
        Building::House => "house",
        Building::Office => "office",
        Building::Garage => "garage",
        Building::Store => "store",
        Building::GasStation => "gas-station",
    }
}

/// The direction of an icon: one of the four headings, or halfway between two during a turn.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Facing {
    /// Toward row 0.
    Up,
    /// Between up and right.
    UpRight,
    /// Toward the last column.
    Right,
    /// Between down and right.
    DownRight,
    /// Toward the last row.
    Down,
    /// Between down and left.
    DownLeft,
    /// Toward column 0.
    Left,
    /// Between up and left.
    UpLeft,
}

impl Facing {
    /// All facings, clockwise.
    pub const ALL: [Facing; 8] = [
        Facing::Up,
        Facing::UpRight,
        Facing::Right,
        Facing::DownRight,
        Facing::Down,
        Facing::DownLeft,
        Facing::Left,
        Facing::UpLeft,
    ];

    /// Returns the facing of an agent that turns: halfway between the headings, or the second one if they are opposite.
    pub fn turning(from: Heading, to: Heading) -> Facing {
        use Heading::{Down, Left, Right, Up};
        match (from, to) {
            (Up, Right) | (Right, Up) => Facing::UpRight,
            (Up, Left) | (Left, Up) => Facing::UpLeft,
            (Down, Right) | (Right, Down) => Facing::DownRight,
            (Down, Left) | (Left, Down) => Facing::DownLeft,
            (_, to) => to.into(),
        }
    }

    /// Returns sine and cosine of the clockwise rotation from `Up`.
    pub(super) const fn turn(self) -> (f32, f32) {
        const HALF: f32 = std::f32::consts::FRAC_1_SQRT_2;
        match self {
            Facing::Up => (0.0, 1.0),
            Facing::UpRight => (HALF, HALF),
            Facing::Right => (1.0, 0.0),
            Facing::DownRight => (HALF, -HALF),
            Facing::Down => (0.0, -1.0),
            Facing::DownLeft => (-HALF, -HALF),
            Facing::Left => (-1.0, 0.0),
            Facing::UpLeft => (-HALF, HALF),
        }
    }

    /// Returns the side from which the viewer sees a figure that does not rotate.
    pub(super) const fn side(self) -> pedestrian::Side {
        match self {
            Facing::Up => pedestrian::Side::Back,
            Facing::Down => pedestrian::Side::Front,
            Facing::Left | Facing::UpLeft | Facing::DownLeft => pedestrian::Side::Left,
            Facing::Right | Facing::UpRight | Facing::DownRight => pedestrian::Side::Right,
        }
    }
}

impl From<Heading> for Facing {
    fn from(heading: Heading) -> Facing {
        match heading {
            Heading::Up => Facing::Up,
            Heading::Right => Facing::Right,
            Heading::Down => Facing::Down,
            Heading::Left => Facing::Left,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_read_as_they_are_written() {
        let names = [
            "car",
            "bus+tiro",
            "car+taxi",
            "old",
            "pedestrian+jogger",
            "old+jogger",
            "gas-station",
            "bus+taxi+van",
            "bicycle",
        ];
        for name in names {
            assert_eq!(Class::from_name(name).expect(name).to_string(), name);
        }
        assert_eq!(Class::from_name("tiro+bus").expect("a class").to_string(), "bus+tiro");
        for class in Class::known() {
            assert_eq!(Class::from_name(&class.to_string()), Some(class));
        }
        assert_eq!(Class::known().len(), 14);
        for wrong in ["", "taxi", "old+bus", "car+", "car+old", "car+pedestrian", "Bus"] {
            assert_eq!(Class::from_name(wrong), None, "{wrong}");
        }
    }

    #[test]
    fn a_turn_is_halfway() {
        for from in Heading::ALL {
            assert_eq!(Facing::turning(from, from), from.into());
            for to in Heading::ALL {
                let ((dr, dc), (other_dr, other_dc)) = (from.delta(), to.delta());
                let (sum_r, sum_c) = (dr + other_dr, dc + other_dc);
                let (sine, cosine) = Facing::turning(from, to).turn();
                let opposite = (sum_r, sum_c) == (0, 0);
                let (want_r, want_c) = if opposite { to.delta() } else { (sum_r, sum_c) };
                assert_eq!(
                    (-cosine * want_r as f32 > 0.0, sine * want_c as f32 > 0.0),
                    (want_r != 0, want_c != 0)
                );
            }
        }
    }
}
