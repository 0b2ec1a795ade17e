//! The actions of a scenario: the four of every city, and those that a configuration defines.

use crate::city::{Action, KindId, KindTable};
use crate::located::Located;
use serde::ser::SerializeMap;
use serde::{Serialize, Serializer};

/// A direction at an intersection.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub enum Turn {
    /// To the left.
    Left,
    /// To the right.
    Right,
    /// Straight on.
    Straight,
}

impl Turn {
    /// All three directions.
    pub const ALL: [Turn; 3] = [Turn::Left, Turn::Right, Turn::Straight];

    /// Returns its name in configurations: `left`, `right` or `straight`.
    pub const fn name(self) -> &'static str {
        match self {
            Turn::Left => "left",
            Turn::Right => "right",
            Turn::Straight => "straight",
        }
    }
}

/// A side of a car.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub enum Side {
    /// To the left.
    Left,
    /// To the right.
    Right,
}

impl Side {
    /// Both sides.
    pub const ALL: [Side; 2] = [Side::Left, Side::Right];

    /// Returns its name in configurations: `left` or `right`.
    pub const fn name(self) -> &'static str {
        match self {
            Side::Left => "left",
            Side::Right => "right",
        }
    }
}

/// What an action changes besides the speed of a tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub enum Effect {
    /// The agent takes this direction at its next intersection, and the best route to its goal from there. Without a
    /// street in this direction, its route stays as it is.
    Turn(Turn),
    /// The agent changes into the lane on this side of its own on a road network, and takes the best route to its goal
    /// from there. Without a lane there, or too near to an end of it, its route stays as it is.
    ChangeLane(Side),
    /// The agent takes the best route that leaves its next intersection in another direction than its route did.
    Reroute,
    /// The agent stands for this number of ticks, whatever the rules decide.
    Park(u32),
}

/// An action that a configuration defines.
#[derive(Clone, Debug)]
pub struct OwnAction {
    /// Its name, which is also the name of its predicate.
    pub name: Located<String>,
    /// The cells per tick, in the order of the [`KindTable`]; `None` for a kind that cannot take it.
    pub cells: Vec<Option<u8>>,
    /// What it changes besides the speed.
    pub effect: Option<Effect>,
}

/// Serializes the content without its place.
impl Serialize for OwnAction {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(None)?;
        map.serialize_entry("name", &self.name.value)?;
        map.serialize_entry("cells", &self.cells)?;
        map.serialize_entry("effect", &self.effect)?;
        map.end()
    }
}

/// The actions of a scenario: the four standard ones, then its own.
#[derive(Clone, Debug)]
pub struct ActionTable {
    own: Vec<OwnAction>,
    /// The cells per tick of each kind under each action.
    cells: Vec<[Option<u8>; Action::MAX]>,
    /// The maximum of these for each kind.
    reach: Vec<u8>,
}

/// The standard actions of the standard kinds.
impl Default for ActionTable {
    fn default() -> Self {
        ActionTable::new(Vec::new(), &KindTable::default())
    }
}

impl ActionTable {
    /// Returns the standard actions and these, at most [`Action::MAX`] in all.
    pub fn new(own: Vec<OwnAction>, kinds: &KindTable) -> ActionTable {
        assert!(Action::STANDARD.len() + own.len() <= Action::MAX, "too many actions");
        let cells: Vec<[Option<u8>; Action::MAX]> = (kinds.all())
            .map(|kind| {
                let own = own.iter().map(|action| action.cells[kind.index()]);
                let mut cells = [None; Action::MAX];
                for (known, given) in cells.iter_mut().zip(kinds.cells(kind).into_iter().chain(own)) {
                    *known = given;
                }
                cells
            })
            .collect();
        let reach = cells
            .iter()
            .map(|cells| cells.iter().flatten().copied().max().unwrap_or(0));
        ActionTable {
            reach: reach.collect(),
            own,
            cells,
        }
    }

    /// Returns the actions that the configuration defines.
    pub fn own(&self) -> &[OwnAction] {
        &self.own
    }

    /// Returns all actions, the standard ones first.
    pub fn all(&self) -> impl ExactSizeIterator<Item = Action> + Clone + use<> {
        (0..Action::STANDARD.len() + self.own.len()).map(Action::at)
    }

    /// Returns the names of all actions.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.all().map(|action| self.name(action))
    }

    /// Returns the name of an action of this table.
    pub fn name(&self, action: Action) -> &str {
        self.definition(action).map_or(action.name(), |own| &own.name.value)
    }

    /// Returns the action with a name.
    pub fn find(&self, name: &str) -> Option<Action> {
        self.all().find(|&action| self.name(action) == name)
    }

    /// Returns the action with a name, in upper or lower case.
    pub fn find_ignoring_case(&self, name: &str) -> Option<Action> {
        self.all().find(|&action| self.name(action).eq_ignore_ascii_case(name))
    }

    /// Returns the cells per tick that agents of a kind move. `None` if the kind has no such speed: pedestrians under
    /// [`Action::Slow`] and [`Action::Fast`], and kinds that cannot take an action of the configuration.
    pub fn speed_cells(&self, kind: impl Into<KindId>, action: Action) -> Option<usize> {
        self.cells[kind.into().index()][action.index()].map(usize::from)
    }

    /// Returns the maximum number of cells per tick of a kind.
    pub fn reach(&self, kind: impl Into<KindId>) -> usize {
        self.reach[kind.into().index()].into()
    }

    /// Returns what an action changes besides the speed.
    pub fn effect(&self, action: Action) -> Option<Effect> {
        self.definition(action)?.effect
    }

    /// Returns whether agents of a kind can take an action. Every agent can take the standard actions.
    pub fn can_take(&self, kind: impl Into<KindId>, action: Action) -> bool {
        action.is_standard() || self.speed_cells(kind, action).is_some()
    }

    fn definition(&self, action: Action) -> Option<&OwnAction> {
        self.own.get(action.index().checked_sub(Action::STANDARD.len())?)
    }
}
