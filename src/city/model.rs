//! What maps and agents are made of, as configurations describe them.
//!
//! The serialized form holds the content without file names and places, so that equal content has equal hashes.

use crate::diag::{Located, Span};
use serde::ser::SerializeStruct;
use serde::{Serialize, Serializer};
use std::fmt;
use std::sync::Arc;

/// Written as the value alone, so that equal content is written alike wherever it stands.
impl<T: Serialize> Serialize for Located<T> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.value.serialize(serializer)
    }
}

/// What an agent is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
pub enum AgentKind {
    /// Drives on traffic streets.
    Car,
    /// Walks on walking streets and crossings.
    Pedestrian,
}

impl AgentKind {
    /// Both.
    pub const ALL: [AgentKind; 2] = [AgentKind::Car, AgentKind::Pedestrian];

    /// Its name in configurations, scenes and traces: `Car` or `Pedestrian`.
    pub const fn name(self) -> &'static str {
        match self {
            AgentKind::Car => "Car",
            AgentKind::Pedestrian => "Pedestrian",
        }
    }
}

/// A kind of building.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
pub enum Building {
    /// H
    House,
    /// O
    Office,
    /// A
    Garage,
    /// S
    Store,
    /// G
    GasStation,
}

impl Building {
    /// All five.
    pub const ALL: [Building; 5] = [
        Building::House,
        Building::Office,
        Building::Garage,
        Building::Store,
        Building::GasStation,
    ];
}

/// A map file (`configs/maps/*.yaml`).
#[derive(Clone, Debug, Serialize)]
pub struct MapConfig {
    /// The name of the file without its extension.
    #[serde(skip)]
    pub name: String,
    /// Rows and columns of blocks, each 1 to 1000.
    pub blocks: Located<[u32; 2]>,
    /// Widths in cells.
    pub widths: Located<Widths>,
    /// What stands where.
    pub buildings: Located<Buildings>,
}

/// Widths of the parts of a map, in cells.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Widths {
    /// A traffic street with both its lanes; odd, since the mid line is a cell wide.
    pub street: u32,
    /// The sidewalk between street and building.
    pub sidewalk: u32,
    /// A building (square).
    pub building: u32,
    /// The sidewalk between the buildings of a block.
    pub inner_sidewalk: u32,
}

/// What stands where on a map.
#[derive(Clone, Debug, Serialize)]
pub enum Buildings {
    /// One row of buildings after another (two rows and two columns a block).
    Fixed(Vec<Vec<Building>>),
    /// Drawn independently with these weights.
    Random {
        /// Seed of the draw, apart from the seed of a run.
        seed: u64,
        /// Weight of each building type, not negative, not all zero; they need not sum to one.
        weights: Vec<(Building, f64)>,
    },
}

/// The train, validation and test sets of a task.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
pub enum Split {
    /// `train`
    Train,
    /// `val`
    Val,
    /// `test`
    Test,
}

impl Split {
    /// All three.
    pub const ALL: [Split; 3] = [Split::Train, Split::Val, Split::Test];

    /// Its name.
    pub const fn name(self) -> &'static str {
        match self {
            Split::Train => "train",
            Split::Val => "val",
            Split::Test => "test",
        }
    }
}

/// The name of an agent, as it is written: `Car_1`, `Pedestrian_3`, ...
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct AgentName {
    /// What it is.
    pub kind: AgentKind,
    /// Its number within the kind, from 1.
    pub number: u32,
}

impl fmt::Display for AgentName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}_{}", self.kind.name(), self.number)
    }
}

/// An entry of an agent set: agents that are alike.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AgentGroup {
    /// How many, at least 1.
    pub count: u32,
    /// The concepts of each, for example `ambulance`; each is defined by a predicate of the scenario.
    pub concepts: Arc<[String]>,
    /// Right of way; a smaller number goes first.
    pub priority: i32,
}

/// One agent of an agent set.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AgentConfig {
    /// Its name.
    pub name: AgentName,
    /// Its concepts, which all agents of its entry share.
    pub concepts: Arc<[String]>,
    /// Right of way; a smaller number goes first.
    pub priority: i32,
}

/// The agents of one split.
#[derive(Clone, Debug)]
pub struct AgentSet {
    /// The entries of cars.
    pub cars: Vec<AgentGroup>,
    /// The entries of pedestrians.
    pub pedestrians: Vec<AgentGroup>,
    /// How many times all of them are there, at least 1.
    pub repeat: u32,
    /// Starts and goals lie in rows and columns below this; `None` for the whole map.
    pub region: Option<Located<u32>>,
    /// A goal lies at most so many rows and columns from where the agent is; `None` for anywhere.
    pub trip: Option<Located<u32>>,
    /// Where the set is defined.
    pub span: Span,
}

impl AgentSet {
    /// How many agents of a kind there are.
    pub fn count(&self, kind: AgentKind) -> usize {
        let once: usize = self.groups(kind).iter().map(|group| group.count as usize).sum();
        once * self.repeat as usize
    }

    /// How many agents there are.
    pub fn len(&self) -> usize {
        AgentKind::ALL.iter().map(|&kind| self.count(kind)).sum()
    }

    /// Whether there is no agent.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// All entries.
    pub fn entries(&self) -> impl Iterator<Item = &AgentGroup> {
        self.cars.iter().chain(&self.pedestrians)
    }

    fn groups(&self, kind: AgentKind) -> &[AgentGroup] {
        match kind {
            AgentKind::Car => &self.cars,
            AgentKind::Pedestrian => &self.pedestrians,
        }
    }

    /// The agents in list order: first car, which is the ego of a task, all pedestrians, the other cars.
    pub fn agents(&self) -> impl Iterator<Item = AgentConfig> + '_ {
        self.members().map(AgentConfig::of)
    }

    /// The same: the name of each and its entry.
    pub fn members(&self) -> impl Iterator<Item = (AgentName, &AgentGroup)> {
        self.listed(self.repeat)
    }

    fn listed(&self, repeat: u32) -> impl Iterator<Item = (AgentName, &AgentGroup)> {
        let of = move |kind| {
            let groups = (0..repeat).flat_map(move |_| self.groups(kind));
            let alike = groups.flat_map(|group| std::iter::repeat_n(group, group.count as usize));
            (1..)
                .zip(alike)
                .map(move |(number, group)| (AgentName { kind, number }, group))
        };
        let mut cars = of(AgentKind::Car);
        (cars.next().into_iter()).chain(of(AgentKind::Pedestrian)).chain(cars)
    }
}

impl AgentConfig {
    fn of((name, group): (AgentName, &AgentGroup)) -> AgentConfig {
        AgentConfig {
            name,
            concepts: Arc::clone(&group.concepts),
            priority: group.priority,
        }
    }
}

/// Written as the list of agents that is repeated, so that it does not matter how entries count them.
impl Serialize for AgentSet {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut set = serializer.serialize_struct("AgentSet", 4)?;
        set.serialize_field("agents", &Listed(self))?;
        set.serialize_field("region", &self.region)?;
        if self.repeat > 1 {
            set.serialize_field("repeat", &self.repeat)?;
        }
        if self.trip.is_some() {
            set.serialize_field("trip", &self.trip)?;
        }
        set.end()
    }
}

struct Listed<'a>(&'a AgentSet);

impl Serialize for Listed<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(self.0.listed(1).map(AgentConfig::of))
    }
}

impl Serialize for AgentConfig {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut agent = serializer.serialize_struct("AgentConfig", 4)?;
        agent.serialize_field("name", &format_args!("{}", self.name))?;
        agent.serialize_field("kind", &self.name.kind)?;
        agent.serialize_field("concepts", &self.concepts[..])?;
        agent.serialize_field("priority", &self.priority)?;
        agent.end()
    }
}

/// A speed a decision asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
pub enum Action {
    /// Cars: 1 cell a tick.
    Slow,
    /// Cars: 2 cells a tick; pedestrians: 1.
    Normal,
    /// Cars: 3 cells a tick.
    Fast,
    /// No move.
    Stop,
}

impl Action {
    /// All four, in the order of their published indices.
    pub const ALL: [Action; 4] = [Action::Slow, Action::Normal, Action::Fast, Action::Stop];

    /// Its name, which is also the name of its predicate.
    pub const fn name(self) -> &'static str {
        match self {
            Action::Slow => "Slow",
            Action::Normal => "Normal",
            Action::Fast => "Fast",
            Action::Stop => "Stop",
        }
    }
}

/// How agents choose a route.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub enum Routing {
    /// Cars: least length, where each turn and U-turn costs 30 cells more (the paper). Pedestrians: a shortest way.
    Weighted,
    /// The ways of the published program, cell by cell. Cars: fewest nodes of the road graph. Pedestrians: the shortest way that its A* finds.
    Hops,
}

impl Routing {
    /// Both.
    pub const ALL: [Routing; 2] = [Routing::Weighted, Routing::Hops];

    /// Its name: `weighted` or `hops`.
    pub const fn name(self) -> &'static str {
        match self {
            Routing::Weighted => "weighted",
            Routing::Hops => "hops",
        }
    }
}
