//! The zones of a map: tinted areas with an outline.

use crate::city::{Area, Cell, CityMap};
use crate::render::picture::{Picture, Rgb};
use crate::render::view::Viewport;

/// The colors of zones, which color-blind readers can distinguish (Okabe and Ito, "Color Universal Design", 2008).
const COLORS: [Rgb; 7] = [
    [0x00, 0x72, 0xb2],
    [0xd5, 0x5e, 0x00],
    [0x00, 0x9e, 0x73],
    [0xcc, 0x79, 0xa7],
    [0xe6, 0x9f, 0x00],
    [0x56, 0xb4, 0xe9],
    [0xf0, 0xe4, 0x42],
];

/// The weight of the tint in the color of a pixel, in percent.
pub(super) const TINT: u32 = 28;

/// How pictures show a zone.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct ZoneLook {
    pub(super) color: Rgb,
    /// The dashes of the outline: pixels with and without color in turn. An outline without gaps has no second ones.
    pub(super) dash: [i32; 2],
}

impl ZoneLook {
    /// Returns the look of a zone, given its position. Zones of one color have different outlines.
    pub(super) fn of(position: usize) -> ZoneLook {
        let dashes = [[1, 0], [10, 6], [3, 3]];
        ZoneLook {
            color: COLORS[position % COLORS.len()],
            dash: dashes[position / COLORS.len() % dashes.len()],
        }
    }

    /// Tints a pixel of the zone.
    pub(super) fn tint(self, pixel: &mut [u8]) {
        for (channel, tint) in pixel.iter_mut().zip(self.color) {
            *channel = ((u32::from(*channel) * (100 - TINT) + u32::from(tint) * TINT + 50) / 100) as u8;
        }
    }

    /// Returns whether the outline is drawn here, given a place along it in pixels.
    pub(super) fn has_line(self, at: i64) -> bool {
        at.rem_euclid(i64::from(self.dash[0] + self.dash[1])) < i64::from(self.dash[0])
    }
}

/// Tints the zones of a map on a picture of this view, and draws their outlines.
pub(super) fn draw(map: &CityMap, view: &Viewport, picture: &mut Picture) {
    for (position, (_, area)) in map.zone_areas().enumerate() {
        draw_zone(area, ZoneLook::of(position), view, picture);
    }
}

fn draw_zone(area: &Area, look: ZoneLook, view: &Viewport, picture: &mut Picture) {
    let side = view.scale.pixels as usize;
    let width = side.div_ceil(3);
    let (left, top) = view.start();
    let (rows, cols) = (picture.height() as usize / side, picture.width() as usize / side);
    // A neighbor off the picture is on the map.
    let beside = |row: usize, col: usize, [down, right]: [i32; 2]| {
        let mut cell = view.cell(row, col);
        cell.row = cell.row.saturating_add(down * view.scale.cells);
        cell.col = cell.col.saturating_add(right * view.scale.cells);
        area.contains(cell)
    };
    for (row, col) in (0..rows).flat_map(|row| (0..cols).map(move |col| (row, col))) {
        if !beside(row, col, [0, 0]) {
            continue;
        }
        let [above, below, before, after] = [[-1, 0], [1, 0], [0, -1], [0, 1]].map(|step| !beside(row, col, step));
        for (down, right) in (0..side).flat_map(|down| (0..side).map(move |right| (down, right))) {
            let (x, y) = (col * side + right, row * side + down);
            let is_along_row = above && down < width || below && down + width >= side;
            let is_along_col = before && right < width || after && right + width >= side;
            let is_line =
                is_along_row && look.has_line(left + x as i64) || is_along_col && look.has_line(top + y as i64);
            let pixel = picture.pixel_mut(x, y);
            match is_line {
                true => pixel.copy_from_slice(&look.color),
                false => look.tint(pixel),
            }
        }
    }
}

/// A zone as rectangles of cells, for drawing it at any scale.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ZonePlan {
    /// Its name.
    pub name: String,
    /// Its color, as red, green and blue.
    pub color: Rgb,
    /// The dashes of its outline in pixels: with and without color in turn, `[1, 0]` without gaps.
    pub dash: [i32; 2],
    /// Runs of equal rows from the top: the number of rows, and the first column and the number of columns of each run
    /// of cells in the zone.
    pub bands: Vec<(u32, Vec<(u32, u32)>)>,
}

impl ZonePlan {
    /// Returns the zones of a map, in the order of the configuration.
    pub fn all(map: &CityMap) -> Vec<ZonePlan> {
        let zones = map.zone_areas().enumerate();
        zones
            .map(|(position, (name, area))| {
                let ZoneLook { color, dash } = ZoneLook::of(position);
                ZonePlan {
                    name: name.to_owned(),
                    color,
                    dash,
                    bands: bands(area),
                }
            })
            .collect()
    }
}

fn bands(area: &Area) -> Vec<(u32, Vec<(u32, u32)>)> {
    let [row_classes, col_classes] = area.classes();
    let mut bands: Vec<(u32, Vec<(u32, u32)>)> = Vec::new();
    let mut row = 0;
    for equal in row_classes.chunk_by(|class, next| class == next) {
        let (mut runs, mut col): (Vec<(u32, u32)>, u32) = (Vec::new(), 0);
        for across in col_classes.chunk_by(|class, next| class == next) {
            let width = u32::try_from(across.len()).expect("maps have at most 2^20 columns");
            if area.contains(Cell::new(row, col.cast_signed())) {
                match runs.last_mut() {
                    Some((first, count)) if *first + *count == col => *count += width,
                    _ => runs.push((col, width)),
                }
            }
            col += width;
        }
        let height = u32::try_from(equal.len()).expect("maps have at most 2^20 rows");
        match bands.last_mut() {
            Some((count, before)) if *before == runs => *count += height,
            _ => bands.push((height, runs)),
        }
        row += height.cast_signed();
    }
    bands
}
