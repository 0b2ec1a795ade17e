//! Actions.

use std::fmt;

/// What an agent chooses for a tick: a position in the `ActionTable` of the scenario. The first four positions are
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

    /// Returns the standard action of a name in any case.
    pub fn standard_ignoring_case(name: &str) -> Option<Action> {
        let mut standard = Self::STANDARD.into_iter();
        standard.find(|action| action.name().eq_ignore_ascii_case(name))
    }

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

    /// Returns the name of a standard action, which is also the name of its predicate. `ActionTable::name` names the
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
