//! The map without agents: streets, crossings, buildings.

use super::canvas::Frame;
use super::ink::Ink;
use crate::city::{Cell, CityMap, Ground, Heading};
use crate::config::Building;
use embedded_graphics::mono_font::MonoFont;
use embedded_graphics::mono_font::iso_8859_1::{FONT_5X8, FONT_6X13_BOLD, FONT_9X18_BOLD, FONT_10X20};
use embedded_graphics::text::Alignment;

/// How cells become pixels. One of the two numbers is 1: a cell is a square of pixels, or a pixel samples a square of
/// cells.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Zoom {
    /// Side of a cell in pixels.
    pub(super) pixels: i32,
    /// Cells a pixel stands for along each axis.
    pub(super) cells: i32,
}

impl Zoom {
    /// The longer side of a map is at most this many pixels when cells are enlarged.
    const ENLARGED: i32 = 1000;
    /// The longer side of a map is at most this many pixels.
    const MOST: i32 = 1600;
    /// The largest cell, in pixels.
    const LARGEST_CELL: i32 = 12;

    /// The zoom for a map of that many cells on its longer side, which is at least 1.
    pub(super) fn fit(side_cells: i32) -> Zoom {
        Zoom {
            pixels: (Self::ENLARGED / side_cells).clamp(1, Self::LARGEST_CELL),
            // Rounded up.
            cells: (side_cells - 1) / Self::MOST + 1,
        }
    }

    /// Length in pixels of a side of that many cells.
    pub(super) fn length(self, cells: i32) -> i32 {
        (cells - 1) / self.cells * self.pixels + self.pixels
    }

    /// The pixel in the middle of a cell on the map, along one axis.
    pub(super) fn middle(self, cell: i32) -> i32 {
        cell / self.cells * self.pixels + self.pixels / 2
    }

    /// The cell under a pixel and the pixel's offset inside the cell, along one axis.
    fn under(self, pixel: i32, side_cells: i32) -> (i32, i32) {
        if self.cells > 1 {
            ((pixel * self.cells + self.cells / 2).min(side_cells - 1), 0)
        } else {
            (pixel / self.pixels, pixel % self.pixels)
        }
    }
}

/// The colours and the name of a building type.
pub(super) struct BuildingStyle {
    pub(super) building: Building,
    pub(super) letter: &'static str,
    pub(super) name: &'static str,
    pub(super) roof: Ink,
    pub(super) edge: Ink,
    pub(super) ink: Ink,
}

/// All building types, as the legend lists them.
pub(super) const BUILDINGS: [BuildingStyle; 5] = [
    BuildingStyle {
        building: Building::House,
        letter: "H",
        name: "House",
        roof: Ink::HOUSE,
        edge: Ink::HOUSE_EDGE,
        ink: Ink::HOUSE_LETTER,
    },
    BuildingStyle {
        building: Building::Office,
        letter: "O",
        name: "Office",
        roof: Ink::OFFICE,
        edge: Ink::OFFICE_EDGE,
        ink: Ink::OFFICE_LETTER,
    },
    BuildingStyle {
        building: Building::Store,
        letter: "S",
        name: "Store",
        roof: Ink::STORE,
        edge: Ink::STORE_EDGE,
        ink: Ink::STORE_LETTER,
    },
    BuildingStyle {
        building: Building::Garage,
        letter: "A",
        name: "Garage",
        roof: Ink::GARAGE,
        edge: Ink::GARAGE_EDGE,
        ink: Ink::GARAGE_LETTER,
    },
    BuildingStyle {
        building: Building::GasStation,
        letter: "G",
        name: "Gas station",
        roof: Ink::GAS_STATION,
        edge: Ink::GAS_STATION_EDGE,
        ink: Ink::GAS_STATION_LETTER,
    },
];

impl BuildingStyle {
    pub(super) fn of(building: Building) -> &'static BuildingStyle {
        let position = match building {
            Building::House => 0,
            Building::Office => 1,
            Building::Store => 2,
            Building::Garage => 3,
            Building::GasStation => 4,
        };
        &BUILDINGS[position]
    }
}

/// Draws the whole map with its top left corner at (`left`, `top`).
pub(super) fn draw(map: &CityMap, zoom: Zoom, frame: &mut Frame, left: i32, top: i32) {
    let (rows, cols) = (map.rows(), map.cols());
    for y in 0..zoom.length(rows) {
        let (row, down) = zoom.under(y, rows);
        for x in 0..zoom.length(cols) {
            let (col, right) = zoom.under(x, cols);
            let ink = ink_at(map, zoom, Cell::new(row, col), down, right);
            frame.fill(left + x, top + y, 1, 1, ink);
        }
    }
    if zoom.cells == 1 {
        letters(map, zoom, frame, left, top);
    }
}

/// The building of a cell and its block: equal for cells of one roof.
fn roof(map: &CityMap, cell: Cell) -> Option<(Building, Option<u32>)> {
    map.building_at(cell)
        .map(|building| (building, map.layout.block_at(cell)))
}

/// The colour of one pixel of a cell, `down` and `right` of the cell's corner.
fn ink_at(map: &CityMap, zoom: Zoom, cell: Cell, down: i32, right: i32) -> Ink {
    // The neighbours that this pixel touches.
    let touched = Heading::ALL.into_iter().filter(|heading| match heading {
        Heading::Left => right == 0,
        Heading::Right => right == zoom.pixels - 1,
        Heading::Up => down == 0,
        Heading::Down => down == zoom.pixels - 1,
    });
    let fine = zoom.pixels > 2;
    if let Some(own) = roof(map, cell) {
        let style = BuildingStyle::of(own.0);
        let same = |other: Cell| roof(map, other) == Some(own);
        let edge = fine && touched.into_iter().any(|heading| !same(cell.ahead(heading, 1)));
        return if edge { style.edge } else { style.roof };
    }
    match map.ground_at(cell) {
        None | Some(Ground::Other) => Ink::GRASS,
        Some(Ground::Walking) => {
            let curb = |heading| map.ground_at(cell.ahead(heading, 1)) == Some(Ground::Traffic);
            if fine && touched.into_iter().any(curb) {
                Ink::CURB
            } else if fine && (cell.row % 5 == 0 && down == 0 || cell.col % 5 == 0 && right == 0) {
                Ink::JOINT
            } else {
                Ink::SIDEWALK
            }
        }
        Some(Ground::Traffic) => traffic(map, zoom, cell, down, right),
        // Stripes lie along the traffic, so they alternate along the walk.
        Some(Ground::Crossing) => match if walks_along_row(map, cell) { cell.col } else { cell.row } % 2 {
            0 => Ink::WHITE_PAINT,
            _ => Ink::ASPHALT,
        },
    }
}

/// Asphalt with its dashed mid line and the stop lines in front of crossings.
fn traffic(map: &CityMap, zoom: Zoom, cell: Cell, down: i32, right: i32) -> Ink {
    let size = zoom.pixels;
    let mid = |heading| map.is_mid_line(cell.ahead(heading, 1));
    if map.is_mid_line(cell) {
        let along_row = mid(Heading::Left) || mid(Heading::Right);
        let (along, across) = if along_row { (cell.col, down) } else { (cell.row, right) };
        let painted = (size / 3..size - size / 3).contains(&across) && along % 5 < 3;
        return if painted { Ink::YELLOW_PAINT } else { Ink::ASPHALT };
    }
    let stops = |heading| {
        let ahead = cell.ahead(heading, 1);
        map.junction(ahead).car_is_at() && map.ground_at(ahead) == Some(Ground::Crossing)
    };
    let far_half = |heading| match heading {
        Heading::Left => right >= size / 2,
        Heading::Right => right < size / 2,
        Heading::Up => down >= size / 2,
        Heading::Down => down < size / 2,
    };
    let line = size > 1
        && !map.junction(cell).car_is_at()
        && Heading::ALL
            .into_iter()
            .any(|heading| far_half(heading) && stops(heading));
    if line { Ink::WHITE_PAINT } else { Ink::ASPHALT }
}

/// Whether pedestrians use this crossing cell along its row: it ends, along the row, in no traffic street.
fn walks_along_row(map: &CityMap, cell: Cell) -> bool {
    let end = |heading| {
        let mut ground = Some(Ground::Crossing);
        let mut cells = 0;
        while ground == Some(Ground::Crossing) {
            cells += 1;
            ground = map.ground_at(cell.ahead(heading, cells));
        }
        ground
    };
    end(Heading::Left) != Some(Ground::Traffic) && end(Heading::Right) != Some(Ground::Traffic)
}

/// A letter on every building that has room for one.
fn letters(map: &CityMap, zoom: Zoom, frame: &mut Frame, left: i32, top: i32) {
    let cells = (0..map.rows()).flat_map(|row| (0..map.cols()).map(move |col| Cell::new(row, col)));
    for (corner, own) in cells.filter_map(|cell| Some((cell, roof(map, cell)?))) {
        let same = |other: Cell| roof(map, other) == Some(own);
        if same(corner.ahead(Heading::Left, 1)) || same(corner.ahead(Heading::Up, 1)) {
            continue;
        }
        let extent = |heading| {
            let mut cells = 1;
            while same(corner.ahead(heading, cells)) {
                cells += 1;
            }
            cells * zoom.pixels
        };
        let (width, height) = (extent(Heading::Right), extent(Heading::Down));
        let style = BuildingStyle::of(own.0);
        if let Some(font) = letter_font(width.min(height)) {
            let (x, y) = (
                left + corner.col * zoom.pixels + width / 2,
                top + corner.row * zoom.pixels + height / 2,
            );
            frame.text(style.letter, x, y, font, style.ink, Alignment::Center);
        }
    }
}

/// The font for a letter in a square of that side, in pixels.
pub(super) fn letter_font(side: i32) -> Option<&'static MonoFont<'static>> {
    match side {
        ..10 => None,
        10..16 => Some(&FONT_5X8),
        16..26 => Some(&FONT_6X13_BOLD),
        26..60 => Some(&FONT_9X18_BOLD),
        _ => Some(&FONT_10X20),
    }
}
