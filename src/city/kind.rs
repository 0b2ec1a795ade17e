//! Kinds of agents: the two of every city, and those that a configuration defines.

use crate::city::Action;
use crate::located::Located;
use serde::ser::SerializeMap;
use serde::{Serialize, Serializer};
use std::borrow::Cow;
use std::fmt;

/// Whether an agent drives or walks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
pub enum AgentKind {
    /// A car, which drives on traffic streets.
    Car,
    /// A pedestrian, who walks on walking streets and crossings.
    Pedestrian,
}

impl AgentKind {
    /// Both kinds.
    pub const ALL: [AgentKind; 2] = [AgentKind::Car, AgentKind::Pedestrian];

    /// Returns its name in configurations, scenes and traces: `Car` or `Pedestrian`.
    pub const fn name(self) -> &'static str {
        match self {
            AgentKind::Car => "Car",
            AgentKind::Pedestrian => "Pedestrian",
        }
    }
}

/// Returns the number of cells that agents of a kind move in one tick under a standard action. `None` for speeds that
/// pedestrians do not have. [`ActionTable::speed_cells`](crate::city::ActionTable::speed_cells) knows all actions.
pub const fn speed_cells(kind: AgentKind, action: Action) -> Option<usize> {
    match (kind, action) {
        (_, Action::Stop) => Some(0),
        (AgentKind::Pedestrian, Action::Normal) | (AgentKind::Car, Action::Slow) => Some(1),
        (AgentKind::Car, Action::Normal) => Some(2),
        (AgentKind::Car, Action::Fast) => Some(3),
        _ => None,
    }
}

/// The position of a kind in the [`KindTable`] of a scenario. The first two are those of [`AgentKind::ALL`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct KindId(u8);

impl From<AgentKind> for KindId {
    fn from(kind: AgentKind) -> KindId {
        KindId(kind as u8)
    }
}

impl KindId {
    /// Returns the position.
    pub const fn index(self) -> usize {
        self.0 as usize
    }

    /// Returns whether every scenario has it.
    pub const fn is_standard(self) -> bool {
        self.index() < AgentKind::ALL.len()
    }
}

/// The name of a kind that a configuration defines.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct KindName([u8; KindName::MAX]);

impl KindName {
    /// The maximum length.
    pub const MAX: usize = 24;

    /// Returns the name; `None` if it is empty, too long, or has other characters than letters, digits and `_`.
    pub fn new(name: &str) -> Option<KindName> {
        let fits = (1..=Self::MAX).contains(&name.len());
        if !fits || !name.bytes().all(|byte| byte.is_ascii_alphanumeric() || byte == b'_') {
            return None;
        }
        let mut bytes = [0; Self::MAX];
        bytes[..name.len()].copy_from_slice(name.as_bytes());
        Some(KindName(bytes))
    }

    /// Returns the text.
    pub fn as_str(&self) -> &str {
        let end = self.0.iter().position(|byte| *byte == 0).unwrap_or(Self::MAX);
        std::str::from_utf8(&self.0[..end]).expect("it is ASCII")
    }
}

impl fmt::Debug for KindName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Debug::fmt(self.as_str(), f)
    }
}

/// The name of an agent, displayed as `Car_1`, `Pedestrian_3`, `Cyclist_2`, ...
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct AgentName {
    /// Whether it drives or walks.
    pub kind: AgentKind,
    /// Its kind, if the configuration defines it.
    pub own: Option<(KindId, KindName)>,
    /// Its number within the kind, from 1.
    pub number: u32,
}

impl AgentName {
    /// Returns the name of a car or a pedestrian.
    pub const fn standard(kind: AgentKind, number: u32) -> AgentName {
        AgentName {
            kind,
            own: None,
            number,
        }
    }

    /// Returns its kind.
    pub fn kind_id(&self) -> KindId {
        self.own.map_or(self.kind.into(), |(kind, _)| kind)
    }

    /// Returns the name of its kind.
    pub fn kind_name(&self) -> &str {
        self.own.as_ref().map_or(self.kind.name(), |(_, name)| name.as_str())
    }
}

impl fmt::Display for AgentName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}_{}", self.kind_name(), self.number)
    }
}

/// The concepts with looks of their own in pictures, in the order in which a name lists them. A kind can look like any
/// of them. The standard predicates define the first seven.
pub const PICTURES: [(AgentKind, &str); 8] = [
    (AgentKind::Car, "ambulance"),
    (AgentKind::Car, "bus"),
    (AgentKind::Car, "police"),
    (AgentKind::Car, "tiro"),
    (AgentKind::Car, "reckless"),
    (AgentKind::Pedestrian, "old"),
    (AgentKind::Pedestrian, "young"),
    (AgentKind::Car, "bicycle"),
];

/// A kind that a configuration defines: cars or pedestrians with a name, speeds and looks of their own. The agents
/// carry the name as their first concept.
#[derive(Clone, Debug)]
pub struct OwnKind {
    /// Its name.
    pub name: Located<KindName>,
    /// The kind that says where it moves.
    pub of: AgentKind,
    /// The concept whose looks it has in pictures; without another choice its name.
    pub picture: String,
}

/// The kinds of a scenario: the two standard ones, then its own.
#[derive(Clone, Debug, PartialEq)]
pub struct KindTable {
    own: Vec<OwnKind>,
    /// For each kind the cells per tick under the standard actions; `None` for a speed that it does not have.
    cells: Vec<[Option<u8>; 4]>,
}

impl PartialEq for OwnKind {
    fn eq(&self, other: &OwnKind) -> bool {
        (self.name.value, self.of, &self.picture) == (other.name.value, other.of, &other.picture)
    }
}

/// The standard kinds.
impl Default for KindTable {
    fn default() -> Self {
        let cells = |kind| Action::STANDARD.map(|action| standard_cells(kind, action));
        KindTable {
            own: Vec::new(),
            cells: AgentKind::ALL.map(cells).into(),
        }
    }
}

fn standard_cells(kind: AgentKind, action: Action) -> Option<u8> {
    speed_cells(kind, action).map(|cells| u8::try_from(cells).expect("at most three cells"))
}

impl KindTable {
    /// The maximum number of kinds that a configuration defines.
    pub const OWN_MAX: usize = 14;

    /// Sets the cells per tick of a kind.
    pub(crate) fn set_cells(&mut self, kind: KindId, cells: [Option<u8>; 4]) {
        self.cells[kind.index()] = cells;
    }

    /// Adds a kind with its cells per tick; at most [`KindTable::OWN_MAX`].
    pub(crate) fn add(&mut self, own: OwnKind, cells: [Option<u8>; 4]) {
        assert!(self.own.len() < Self::OWN_MAX, "too many kinds");
        self.own.push(own);
        self.cells.push(cells);
    }

    /// Returns whether these are the standard kinds with their usual speeds.
    pub fn is_standard(&self) -> bool {
        *self == KindTable::default()
    }

    /// Returns the kinds that the configuration defines.
    pub fn own(&self) -> &[OwnKind] {
        &self.own
    }

    /// Returns all kinds, the standard ones first.
    pub fn all(&self) -> impl ExactSizeIterator<Item = KindId> + Clone + use<> {
        #[allow(clippy::cast_possible_truncation)] // There are at most 16.
        (0..self.cells.len()).map(|index| KindId(index as u8))
    }

    /// Returns the kinds that the configuration defines, with their positions.
    pub fn own_with_ids(&self) -> impl Iterator<Item = (KindId, &OwnKind)> {
        self.all().skip(AgentKind::ALL.len()).zip(&self.own)
    }

    /// Returns the name of a kind of this table.
    pub fn name(&self, kind: KindId) -> &str {
        match self.definition(kind) {
            Some(own) => own.name.value.as_str(),
            None => self.base(kind).name(),
        }
    }

    /// Returns the name of an agent of a kind, given its number within the kind.
    pub fn agent_name(&self, kind: KindId, number: u32) -> AgentName {
        AgentName {
            kind: self.base(kind),
            own: self.definition(kind).map(|own| (kind, own.name.value)),
            number,
        }
    }

    /// Returns the key of a kind in agent sets: `cars`, `pedestrians`, or its name.
    pub fn key(&self, kind: KindId) -> &str {
        match (self.definition(kind), self.base(kind)) {
            (Some(own), _) => own.name.value.as_str(),
            (None, AgentKind::Car) => "cars",
            (None, AgentKind::Pedestrian) => "pedestrians",
        }
    }

    /// Returns the kind that says where agents of a kind move.
    pub fn base(&self, kind: KindId) -> AgentKind {
        self.definition(kind)
            .map_or_else(|| AgentKind::ALL[kind.index()], |own| own.of)
    }

    /// Returns the kind with a name, in upper or lower case.
    pub fn find_ignoring_case(&self, name: &str) -> Option<KindId> {
        self.all().find(|&kind| self.name(kind).eq_ignore_ascii_case(name))
    }

    /// Returns the kind of agents with these concepts.
    pub fn of(&self, base: AgentKind, concepts: &[String]) -> KindId {
        let carried = concepts.first().map_or("", String::as_str);
        let is_it = |(_, own): &(KindId, &OwnKind)| own.of == base && own.name.value.as_str() == carried;
        self.own_with_ids().find(is_it).map_or(base.into(), |(id, _)| id)
    }

    /// Returns the cells per tick of a kind under the standard actions.
    pub fn cells(&self, kind: KindId) -> [Option<u8>; 4] {
        self.cells[kind.index()]
    }

    /// Returns the concepts that agents show in pictures: the picture of their kind in place of its name.
    pub fn shown<'c>(&self, base: AgentKind, concepts: &'c [String]) -> Cow<'c, [String]> {
        match self.definition(self.of(base, concepts)) {
            Some(own) => std::iter::once(&own.picture).chain(&concepts[1..]).cloned().collect(),
            None => concepts.into(),
        }
    }

    fn definition(&self, kind: KindId) -> Option<&OwnKind> {
        self.own.get(kind.index().checked_sub(AgentKind::ALL.len())?)
    }
}

/// Serializes each kind without its place.
impl Serialize for KindTable {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(self.all().map(|kind| Entry(self, kind)))
    }
}

struct Entry<'t>(&'t KindTable, KindId);

impl Serialize for Entry<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let Entry(table, kind) = *self;
        let mut map = serializer.serialize_map(None)?;
        map.serialize_entry("name", table.name(kind))?;
        map.serialize_entry("of", &table.base(kind))?;
        map.serialize_entry("cells", &table.cells(kind))?;
        if let Some(own) = table.definition(kind) {
            map.serialize_entry("picture", &own.picture)?;
        }
        map.end()
    }
}
