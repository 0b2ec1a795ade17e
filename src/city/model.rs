//! The configuration of maps and agents.
//!
//! The serialized form omits file names and places, so that equal content has equal hashes.

use crate::city::{AgentKind, AgentName, CityMap, KindId, KindName, Network, Rectangle};
use crate::diag::Span;
use crate::located::Located;
use serde::ser::SerializeStruct;
use serde::{Serialize, Serializer};
use std::sync::Arc;

/// A kind of building.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
pub enum Building {
    /// A house; letter H in map files.
    House,
    /// An office; letter O.
    Office,
    /// A garage; letter A.
    Garage,
    /// A store; letter S.
    Store,
    /// A gas station; letter G.
    GasStation,
}

impl Building {
    /// All five kinds.
    pub const ALL: [Building; 5] = [
        Building::House,
        Building::Office,
        Building::Garage,
        Building::Store,
        Building::GasStation,
    ];

    /// Returns its name in configurations.
    pub const fn name(self) -> &'static str {
        match self {
            Building::House => "House",
            Building::Office => "Office",
            Building::Garage => "Garage",
            Building::Store => "Store",
            Building::GasStation => "GasStation",
        }
    }
}

/// A map file (`configs/maps/*.yaml`).
#[derive(Clone, Debug, Serialize)]
pub struct MapConfig {
    /// The name of the file without its extension.
    #[serde(skip)]
    pub name: String,
    /// The streets.
    #[serde(flatten)]
    pub terrain: Terrain,
    /// The zones. The serialized form omits an empty list, so that hashes of maps without zones do not depend on it.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub zones: Vec<ZoneConfig>,
}

/// The streets of a map.
#[derive(Clone, Debug, Serialize)]
#[serde(untagged)]
pub enum Terrain {
    /// Equal blocks with streets between them.
    Blocks(Blocks),
    /// A road network.
    Roads {
        /// The network.
        roads: Located<Arc<Network>>,
    },
}

/// A map of equal blocks.
#[derive(Clone, Debug, Serialize)]
pub struct Blocks {
    /// Rows and columns of blocks, each 1 to 1000.
    pub blocks: Located<[u32; 2]>,
    /// Widths in cells.
    pub widths: Located<Widths>,
    /// The buildings.
    pub buildings: Located<Buildings>,
}

impl MapConfig {
    /// Returns the blocks; `None` for a road network.
    pub fn blocks(&self) -> Option<&Blocks> {
        match &self.terrain {
            Terrain::Blocks(blocks) => Some(blocks),
            Terrain::Roads { .. } => None,
        }
    }
}

/// A zone of a map: the union of its parts.
#[derive(Clone, Debug, Serialize)]
pub struct ZoneConfig {
    /// Its name, which predicates use.
    pub name: Located<String>,
    /// Its parts, at least one.
    pub parts: Vec<Located<ZonePart>>,
}

/// A part of a zone: landmarks and the cells around them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct ZonePart {
    /// The landmarks.
    pub around: Landmarks,
    /// The maximum distance from the nearest of their cells, in rows and in columns.
    pub within: u32,
}

/// Rectangles of a map to which a [`ZonePart`] refers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub enum Landmarks {
    /// The cells in these rows and columns: the first and the last, from 0.
    Cells {
        /// The rows.
        rows: [u32; 2],
        /// The columns.
        cols: [u32; 2],
    },
    /// The block in this row and column of blocks, from 1, with its sidewalks.
    Block([u32; 2]),
    /// Blocks drawn at random.
    SomeBlocks(Sample),
    /// The horizontal street with this number, from 1 at the upper edge, with its intersections.
    HorizontalStreet(u32),
    /// The vertical street with this number, from 1 at the left edge, with its intersections.
    VerticalStreet(u32),
    /// All buildings of a kind.
    Buildings(Building),
    /// Buildings of a kind drawn at random.
    SomeBuildings(Building, Sample),
}

/// A draw without replacement. A larger sample contains a smaller one with the same seed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Sample {
    /// The number of elements, at least 1.
    pub count: u32,
    /// The seed of the draw; if absent, that of random buildings, or 0.
    pub seed: Option<u64>,
}

/// Widths of the parts of a map, in cells.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Widths {
    /// A traffic street with both lanes; odd, since the mid line is one cell wide.
    pub street: u32,
    /// The sidewalk between street and building.
    pub sidewalk: u32,
    /// A side of a building, which is square.
    pub building: u32,
    /// The sidewalk between the buildings of a block.
    pub inner_sidewalk: u32,
}

/// The buildings of a map.
#[derive(Clone, Debug, Serialize)]
pub enum Buildings {
    /// Given rows of buildings; each block has two rows and two columns.
    Fixed(Vec<Vec<Building>>),
    /// Drawn independently with these weights.
    Random {
        /// Seed of the draw, independent of the seed of a run.
        seed: u64,
        /// Weight of each building type, non-negative and not all zero; the weights need not sum to one.
        weights: Vec<(Building, f64)>,
    },
}

/// The train, validation and test sets of a task.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
pub enum Split {
    /// The training set, `train`.
    Train,
    /// The validation set, `val`.
    Val,
    /// The test set, `test`.
    Test,
}

impl Split {
    /// All three splits.
    pub const ALL: [Split; 3] = [Split::Train, Split::Val, Split::Test];

    /// Returns its name in configurations: `train`, `val` or `test`.
    pub const fn name(self) -> &'static str {
        match self {
            Split::Train => "train",
            Split::Val => "val",
            Split::Test => "test",
        }
    }
}

/// An entry of an agent set: a number of equal agents.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AgentGroup {
    /// The number of agents, at least 1.
    pub count: u32,
    /// The concepts of each agent, for example `ambulance`; a predicate of the scenario defines each concept.
    pub concepts: Arc<[String]>,
    /// Right of way; a smaller number goes first.
    pub priority: i32,
}

/// One agent of an agent set.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AgentConfig {
    /// Its name.
    pub name: AgentName,
    /// Its concepts, shared by all agents of its entry.
    pub concepts: Arc<[String]>,
    /// Right of way; a smaller number goes first.
    pub priority: i32,
}

/// The entries of a kind that the configuration defines.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct OwnGroups {
    /// Its position in the table.
    pub kind: KindId,
    /// Its name.
    pub name: KindName,
    /// Whether the agents drive or walk.
    pub of: AgentKind,
    /// The entries. The first concept of each is the name of the kind.
    pub groups: Vec<AgentGroup>,
}

/// Where the agents of a split start and arrive.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(untagged)]
pub enum Region {
    /// In rows and columns below this.
    Side(u32),
    /// In the smallest rectangle around a zone of the map.
    Zone(String),
}

impl Region {
    /// Returns its cells on a map.
    pub(crate) fn extent(&self, map: &CityMap) -> Rectangle {
        match self {
            Region::Side(side) => {
                let side = i32::try_from(*side).unwrap_or(i32::MAX);
                Rectangle {
                    rows: 0..map.rows().min(side),
                    cols: 0..map.cols().min(side),
                }
            }
            Region::Zone(name) => map.zone(name).map(|zone| zone.bounds()).unwrap_or_default(),
        }
    }

    /// Returns its larger side in cells.
    pub(crate) fn side(&self, map: &CityMap) -> u32 {
        match self {
            Region::Side(side) => *side,
            Region::Zone(_) => {
                let Rectangle { rows, cols } = self.extent(map);
                rows.len().max(cols.len()).try_into().unwrap_or(u32::MAX)
            }
        }
    }
}

/// The agents of one split.
#[derive(Clone, Debug)]
pub struct AgentSet {
    /// The entries of cars.
    pub cars: Vec<AgentGroup>,
    /// The entries of pedestrians.
    pub pedestrians: Vec<AgentGroup>,
    /// The entries of kinds that the configuration defines, in its order.
    pub own: Vec<OwnGroups>,
    /// The number of repetitions of all entries, at least 1.
    pub repeat: u32,
    /// Where starts and goals lie; `None` for the whole map.
    pub region: Option<Located<Region>>,
    /// The maximum distance of a goal in rows and in columns; `None` for no limit.
    pub trip: Option<Located<u32>>,
    /// The place of its definition.
    pub span: Span,
}

impl AgentSet {
    /// Returns the number of agents that drive, or that walk.
    pub fn count(&self, kind: AgentKind) -> usize {
        let of_kind = self.kinds().filter(|(name, _)| name.kind == kind);
        of_kind.map(|(name, _)| self.count_of(name.kind_id())).sum()
    }

    /// Returns the number of agents of a kind, without those of kinds that the configuration derives from it.
    pub fn count_of(&self, kind: KindId) -> usize {
        let mut of_kind = self.kinds().filter(|(name, _)| name.kind_id() == kind);
        let groups = of_kind.next().map_or(&[][..], |(_, groups)| groups);
        groups.iter().map(|group| group.count as usize).sum::<usize>() * self.repeat as usize
    }

    /// Returns the number of agents.
    pub fn len(&self) -> usize {
        AgentKind::ALL.iter().map(|&kind| self.count(kind)).sum()
    }

    /// Returns whether there are no agents.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Returns all entries.
    pub fn entries(&self) -> impl Iterator<Item = &AgentGroup> {
        self.kinds().flat_map(|(_, groups)| groups)
    }

    /// Returns the entries of each kind, with the name of its first agent: cars, pedestrians, then the kinds that the
    /// configuration defines.
    pub fn kinds(&self) -> impl Iterator<Item = (AgentName, &[AgentGroup])> {
        let standard = [(AgentKind::Car, &self.cars), (AgentKind::Pedestrian, &self.pedestrians)];
        let standard = standard.map(|(kind, groups)| (AgentName::standard(kind, 1), groups.as_slice()));
        let own = self.own.iter().map(|own| {
            let name = AgentName {
                kind: own.of,
                own: Some((own.kind, own.name)),
                number: 1,
            };
            (name, own.groups.as_slice())
        });
        standard.into_iter().chain(own)
    }

    /// Returns the agents in list order: the first car (the ego of a task), all pedestrians, the other cars, then the
    /// agents of kinds that the configuration defines.
    pub fn agents(&self) -> impl Iterator<Item = AgentConfig> + '_ {
        self.members().map(AgentConfig::of)
    }

    /// Returns the name and the entry of each agent, in list order.
    pub fn members(&self) -> impl Iterator<Item = (AgentName, &AgentGroup)> {
        self.listed(self.repeat)
    }

    fn listed(&self, repeat: u32) -> impl Iterator<Item = (AgentName, &AgentGroup)> {
        let mut kinds = self.kinds().map(move |(name, groups)| {
            let groups = (0..repeat).flat_map(move |_| groups);
            let alike = groups.flat_map(|group| std::iter::repeat_n(group, group.count as usize));
            (1..)
                .zip(alike)
                .map(move |(number, group)| (AgentName { number, ..name }, group))
        });
        let mut cars = kinds.next().into_iter().flatten();
        let first = cars.next();
        let pedestrians = kinds.next().into_iter().flatten();
        first.into_iter().chain(pedestrians).chain(cars).chain(kinds.flatten())
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

/// Serializes the list of agents once, with the number of repetitions, so that the grouping into entries does not
/// matter.
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

/// The cells where trips of cars start and end.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub enum TripEnds {
    /// The curb: the outermost cells of a traffic street, on every side of a block (the paper).
    #[default]
    Curb,
    /// The lanes that lead right or down, so on the upper and the right side of a block (the published program that
    /// makes pictures).
    Lane,
}

impl TripEnds {
    /// Both values.
    pub const ALL: [TripEnds; 2] = [TripEnds::Curb, TripEnds::Lane];

    /// Returns its name: `curb` or `lane`.
    pub const fn name(self) -> &'static str {
        match self {
            TripEnds::Curb => "curb",
            TripEnds::Lane => "lane",
        }
    }

    /// Returns whether this is the default. The serialized form omits it, so that hashes of configurations without this
    /// key do not depend on it.
    pub(crate) fn is_default(&self) -> bool {
        *self == TripEnds::default()
    }
}

/// The algorithm by which agents choose routes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub enum Routing {
    /// Cars: the least length, where each turn and U-turn costs 30 cells more (the paper). Pedestrians: a shortest
    /// path.
    Weighted,
    /// The routes of the published program, cell by cell. Cars: the fewest nodes of the road graph. Pedestrians: the
    /// shortest path that its A* search finds.
    Hops,
}

impl Routing {
    /// Both algorithms.
    pub const ALL: [Routing; 2] = [Routing::Weighted, Routing::Hops];

    /// Returns its name: `weighted` or `hops`.
    pub const fn name(self) -> &'static str {
        match self {
            Routing::Weighted => "weighted",
            Routing::Hops => "hops",
        }
    }
}
