//! The content of a cell: its ground, and its relation to intersections.

use crate::city::AgentKind;

/// The ground of a cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u8)]
pub enum Ground {
    /// A building or the gap between buildings.
    Other,
    /// Walking street.
    Walking,
    /// Traffic street.
    Traffic,
    /// A crossing of a walking street and a traffic street.
    Crossing,
}

/// The content of a cell: a [`Ground`] in the lower two bits, and flags.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Square(u8);

pub(super) const CAR_AT: u8 = 1 << 2;
pub(super) const PEDESTRIAN_AT: u8 = 1 << 3;
pub(super) const INSIDE: u8 = 1 << 4;
/// Below the three flags of a [`Junction`].
const JUNCTION_SHIFT: u8 = 2;
pub(super) const MID_LINE: u8 = 1 << 5;
pub(super) const BUILDING: u8 = 1 << 6;
/// A lane of a road network starts or ends here.
pub(super) const NODE: u8 = 1 << 7;

impl Square {
    /// Returns a cell with this ground and without flags.
    pub(super) const fn of_ground(ground: Ground) -> Square {
        Square(ground as u8)
    }

    /// Sets flags.
    pub(super) fn set(&mut self, flags: u8) {
        self.0 |= flags;
    }

    /// Clears flags.
    pub(super) fn clear(&mut self, flags: u8) {
        self.0 &= !flags;
    }

    /// Returns whether one of these flags is set.
    pub(super) const fn has(self, flags: u8) -> bool {
        self.0 & flags != 0
    }

    pub(super) fn ground(self) -> Ground {
        [Ground::Other, Ground::Walking, Ground::Traffic, Ground::Crossing][usize::from(self.0 & 3)]
    }

    /// Returns its relation to intersections.
    pub(super) const fn junction(self) -> Junction {
        Junction(self.0 & (CAR_AT | PEDESTRIAN_AT | INSIDE))
    }
}

/// The relation of a cell to intersections.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Junction(u8);

impl Junction {
    /// All values, in the order of [`Junction::index`].
    pub(crate) const ALL: [Junction; 8] = {
        let mut all = [Junction(0); 8];
        let mut index = 0;
        while index < 8 {
            all[index as usize] = Junction(index << JUNCTION_SHIFT);
            index += 1;
        }
        all
    };

    /// Returns its position in [`Junction::ALL`].
    #[inline]
    pub(crate) const fn index(self) -> usize {
        (self.0 >> JUNCTION_SHIFT) as usize
    }

    /// Returns whether cars are *At* an intersection here: on its entrance line.
    pub const fn car_is_at(self) -> bool {
        self.0 & CAR_AT != 0
    }

    /// Returns whether pedestrians are *At* an intersection here: on its outline, which includes the entrance line.
    pub const fn pedestrian_is_at(self) -> bool {
        self.0 & PEDESTRIAN_AT != 0
    }

    /// Returns whether agents are *In* an intersection here.
    pub const fn is_inside(self) -> bool {
        self.0 & INSIDE != 0
    }

    /// Returns whether agents of a kind are *At* an intersection here.
    pub const fn is_at(self, kind: AgentKind) -> bool {
        match kind {
            AgentKind::Car => self.car_is_at(),
            AgentKind::Pedestrian => self.pedestrian_is_at(),
        }
    }
}
