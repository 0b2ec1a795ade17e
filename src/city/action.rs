//! Actions: the four of every city, and those that a configuration defines.

use crate::city::AgentKind;
use crate::located::Located;
use serde::ser::SerializeMap;
use serde::{Serialize, Serializer};
use std::fmt;

/// What an agent chooses for a tick: a position in the [`ActionTable`] of the scenario. The first four positions are
/// the standard actions, which every table has.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Action(u8);

impl fmt::Debug for Action {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.is_standard() {
            true => f.write_str(self.name()),
            false => write!(f, "Action({})", self.0),
        }
    }
}

#[allow(non_upper_case_globals)] // Variants of an open enumeration.
impl Action {
    /// Cars: 1 cell per tick.
    pub const Slow: Action = Action(0);
    /// Cars: 2 cells per tick; pedestrians: 1.
    pub const Normal: Action = Action(1);
    /// Cars: 3 cells per tick.
    pub const Fast: Action = Action(2);
    /// No move.
    pub const Stop: Action = Action(3);

    /// The four standard actions, in the order of their published indices.
    pub const STANDARD: [Action; 4] = [Action::Slow, Action::Normal, Action::Fast, Action::Stop];

    /// The default order of precedence: the safest action first.
    pub const SAFEST_FIRST: [Action; 4] = [Action::Stop, Action::Slow, Action::Fast, Action::Normal];

    /// The maximum number of actions of a scenario.
    pub const MAX: usize = 16;

    /// Returns the action at a position in a table, which is less than [`Action::MAX`].
    pub(crate) fn at(position: usize) -> Action {
        assert!(position < Self::MAX, "no action {position}");
        #[allow(clippy::cast_possible_truncation)] // It is less than 16.
        let position = position as u8;
        Action(position)
    }

    /// Returns its position in the table of the scenario.
    pub const fn index(self) -> usize {
        self.0 as usize
    }

    /// Returns whether every scenario has it.
    pub const fn is_standard(self) -> bool {
        self.index() < Self::STANDARD.len()
    }

    /// Returns the name of a standard action, which is also the name of its predicate. [`ActionTable::name`] names the
    /// others, too.
    pub const fn name(self) -> &'static str {
        match self {
            Action::Slow => "Slow",
            Action::Normal => "Normal",
            Action::Fast => "Fast",
            Action::Stop => "Stop",
            _ => "own action",
        }
    }
}

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

/// What an action changes besides the speed of a tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub enum Effect {
    /// The agent takes this direction at its next intersection, and the best route to its goal from there. Without a
    /// street in this direction, its route stays as it is.
    Turn(Turn),
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
    /// The cells per tick, in the order of [`AgentKind::ALL`]; `None` for a kind that cannot take it.
    pub cells: [Option<u8>; 2],
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
#[derive(Clone, Debug, Default)]
pub struct ActionTable {
    own: Vec<OwnAction>,
}

impl ActionTable {
    /// Returns the standard actions and these, at most [`Action::MAX`] in all.
    pub fn new(own: Vec<OwnAction>) -> ActionTable {
        assert!(Action::STANDARD.len() + own.len() <= Action::MAX, "too many actions");
        ActionTable { own }
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
    pub fn speed_cells(&self, kind: AgentKind, action: Action) -> Option<usize> {
        match self.definition(action) {
            None => super::speed_cells(kind, action),
            Some(own) => own.cells[kind as usize].map(usize::from),
        }
    }

    /// Returns what an action changes besides the speed.
    pub fn effect(&self, action: Action) -> Option<Effect> {
        self.definition(action)?.effect
    }

    /// Returns whether agents of a kind can take an action. Every agent can take the standard actions.
    pub fn can_take(&self, kind: AgentKind, action: Action) -> bool {
        (self.definition(action)).is_none_or(|own| own.cells[kind as usize].is_some())
    }

    fn definition(&self, action: Action) -> Option<&OwnAction> {
        self.own.get(action.index().checked_sub(Action::STANDARD.len())?)
    }
}
