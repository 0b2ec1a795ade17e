//! The colours.

use embedded_graphics::pixelcolor::{PixelColor, raw::RawU8};

/// A colour of the palette.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Ink(pub(super) u8);

impl PixelColor for Ink {
    type Raw = RawU8;
}

/// Declares the inks in palette order.
macro_rules! inks {
    ($($name:ident = $rgb:literal,)*) => {
        #[allow(non_camel_case_types, clippy::upper_case_acronyms)]
        enum Index { $($name,)* }
        impl Ink {
            $(pub(super) const $name: Ink = Ink(Index::$name as u8);)*
        }
        /// Red, green and blue of each palette index.
        pub const PALETTE: &[[u8; 3]] = &[$([($rgb >> 16) as u8, ($rgb >> 8 & 0xff) as u8, ($rgb & 0xff) as u8],)*];
    };
}

inks! {
    // Never drawn: in an animation it means "as before".
    UNCHANGED = 0x000000,
    PAPER = 0xfbfaf7,
    TEXT = 0x262b33,
    MUTED = 0x747a85,
    GRASS = 0xd6e4c8,
    SIDEWALK = 0xece6da,
    JOINT = 0xe2dbcc,
    CURB = 0xc4bcab,
    ASPHALT = 0xa3a8b0,
    WHITE_PAINT = 0xf6f6f3,
    YELLOW_PAINT = 0xf7cf4f,
    HOUSE = 0xeac3a9,
    HOUSE_EDGE = 0xc99372,
    HOUSE_LETTER = 0x9a5f3d,
    OFFICE = 0xb7cce4,
    OFFICE_EDGE = 0x819fc4,
    OFFICE_LETTER = 0x456a98,
    GARAGE = 0xcdc5d8,
    GARAGE_EDGE = 0x9f93b2,
    GARAGE_LETTER = 0x6a5c81,
    STORE = 0xc1deba,
    STORE_EDGE = 0x88b580,
    STORE_LETTER = 0x487d40,
    GAS_STATION = 0xf4de9f,
    GAS_STATION_EDGE = 0xd0b05a,
    GAS_STATION_LETTER = 0x8b6c17,
    OUTLINE = 0x20252d,
    GLASS = 0x2b3a49,
    PALE_GLASS = 0xbfdcf0,
    HEADLIGHT = 0xfff2a8,
    SIGNAL_RED = 0xe5232b,
    SIGNAL_BLUE = 0x3d8bff,
    CAR = 0x2f74cc,
    AMBULANCE = 0xffffff,
    BUS = 0xf28a1e,
    POLICE = 0x1d2b4d,
    TIRO = 0x2fa35d,
    RECKLESS = 0x9440c4,
    PEDESTRIAN = 0x12908f,
    OLD = 0x85624a,
    YOUNG = 0xee5c9f,
    HEAD = 0xf6d9bd,
    GREY_HEAD = 0xf0f0f0,
    OTHER_0 = 0x00b3d6,
    OTHER_1 = 0xb0820c,
    OTHER_2 = 0xc01f5e,
    OTHER_3 = 0x6e8f23,
    OTHER_4 = 0x5a38b5,
    OTHER_5 = 0xff7d68,
    OTHER_6 = 0x0b5a4a,
    OTHER_7 = 0xa98d82,
    OTHER_8 = 0xd3e04f,
    OTHER_9 = 0xffaccb,
}

// GIF codes take 6 bits a pixel at first; one colour more would make it 7.
const _: () = assert!(PALETTE.len() <= 64);

impl Ink {
    /// For concepts that have no colour of their own.
    pub(super) const OTHER: [Ink; 10] = [
        Ink::OTHER_0,
        Ink::OTHER_1,
        Ink::OTHER_2,
        Ink::OTHER_3,
        Ink::OTHER_4,
        Ink::OTHER_5,
        Ink::OTHER_6,
        Ink::OTHER_7,
        Ink::OTHER_8,
        Ink::OTHER_9,
    ];
}
