//! The cells that a picture shows, and their size.

use crate::city::{Cell, CityMap};
use crate::render::icon::ICON_MAX;
use crate::render::picture::PixelBox;
use std::fmt;

/// The scale of a picture: a cell is a square of pixels, or a pixel is a square of cells.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Scale {
    /// Side of a cell, in pixels.
    pub(super) pixels: i32,
    /// Cells per pixel along each axis. One of the two fields is 1.
    pub(super) cells: i32,
}

impl Scale {
    /// Returns a scale of 1 to 64 pixels per side of a cell; `None` otherwise.
    pub fn pixels(pixels: u32) -> Option<Scale> {
        let pixels = i32::try_from(pixels).ok().filter(|pixels| (1..=64).contains(pixels))?;
        Some(Scale { pixels, cells: 1 })
    }

    /// Returns a scale of 1 to 65,536 cells per side of a pixel; `None` otherwise.
    pub fn cells(cells: u32) -> Option<Scale> {
        let cells = i32::try_from(cells)
            .ok()
            .filter(|cells| (1..=1 << 16).contains(cells))?;
        Some(Scale { pixels: 1, cells })
    }

    /// Returns the largest scale at which `cells` cells fit into `pixels` pixels, with cells of at most `largest`
    /// pixels.
    pub(super) fn fit(cells: i32, pixels: i32, largest: i32) -> Scale {
        Scale {
            pixels: (pixels / cells).clamp(1, largest),
            // Rounded up.
            cells: (cells - 1) / pixels + 1,
        }
    }

    /// Returns the pixel where a cell begins, along one axis; cell 0 begins at pixel 0.
    pub(super) fn start(self, cell: i32) -> i64 {
        i64::from(cell.div_euclid(self.cells)) * i64::from(self.pixels)
    }

    /// Returns the pixel in the middle of a cell, along one axis.
    pub(super) fn middle(self, cell: i32) -> i64 {
        self.start(cell) + i64::from(self.pixels / 2)
    }

    /// Returns the length of `cells` cells from cell 0 on, in pixels.
    pub(super) fn length(self, cells: i32) -> i64 {
        self.start(cells - 1) + i64::from(self.pixels)
    }
}

/// The reason why a view is invalid.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum ViewportError {
    /// It has no cells.
    Empty,
    /// It has too many pixels: at most 16,384 per side and 2^26 in total.
    TooLarge,
    /// An icon size is outside 1..=[`ICON_MAX`] pixels.
    IconSize,
}

impl fmt::Display for ViewportError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            ViewportError::Empty => write!(f, "the view has no cells"),
            ViewportError::TooLarge => write!(
                f,
                "the picture has more than {SIDE_MAX} pixels per side or {PIXELS_MAX} in total"
            ),
            ViewportError::IconSize => write!(f, "an icon size is not from 1 to {ICON_MAX} pixels"),
        }
    }
}

impl std::error::Error for ViewportError {}

/// A rectangle of cells of a map.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Extent {
    /// The first cell.
    pub(super) corner: Cell,
    pub(super) rows: i32,
    pub(super) cols: i32,
}

impl Extent {
    /// Returns the whole map.
    pub fn whole(map: &CityMap) -> Extent {
        Extent {
            corner: Cell::new(0, 0),
            rows: map.rows(),
            cols: map.cols(),
        }
    }

    /// Returns the smallest part of a map that contains these cells with `margin` cells around them, and that splits
    /// no building, sidewalk or street; the whole map if no cell is on it.
    pub fn around(map: &CityMap, cells: impl IntoIterator<Item = Cell>, margin: u32) -> Extent {
        let (mut rows, mut cols) = (None, None);
        for cell in cells.into_iter().filter(|cell| map.contains(*cell)) {
            for (span, at) in [(&mut rows, cell.row), (&mut cols, cell.col)] {
                let (first, last) = span.unwrap_or((at, at));
                *span = Some((at.min(first), at.max(last)));
            }
        }
        let (Some(rows), Some(cols)) = (rows, cols) else {
            return Extent::whole(map);
        };
        let margin = i32::try_from(margin).unwrap_or(i32::MAX);
        let rounded = |(first, last): (i32, i32), end: i32| {
            let (first, last) = (first.saturating_sub(margin), last.saturating_add(margin));
            let (first, last) = (first.max(0), last.min(end - 1));
            let Some(layout) = map.layout() else {
                return (first, last + 1 - first);
            };
            let block = |at: i32| at.div_euclid(layout.period());
            let mut start = layout
                .strip_edges(block(first))
                .into_iter()
                .filter(|edge| *edge <= first);
            let stop = layout.strip_edges(block(last)).into_iter().find(|edge| *edge > last);
            let (start, stop) = (
                start.next_back().unwrap_or(first),
                stop.map_or(end, |stop| stop.min(end)),
            );
            (start, stop - start)
        };
        let ((top, rows), (left, cols)) = (rounded(rows, map.rows()), rounded(cols, map.cols()));
        Extent {
            corner: Cell::new(top, left),
            rows,
            cols,
        }
    }

    /// Returns the first cell, and the numbers of rows and columns.
    pub fn cells(&self) -> (Cell, [i32; 2]) {
        (self.corner, [self.rows, self.cols])
    }
}

const SIDE_MAX: i64 = 1 << 14;
const PIXELS_MAX: i64 = 1 << 26;

/// A rectangle of cells, its scale, and the sizes of agents. Cells off the map show as meadow.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Viewport {
    /// The first cell.
    pub(super) corner: Cell,
    pub(super) rows: i32,
    pub(super) cols: i32,
    pub(super) scale: Scale,
    /// Short side of a car, in pixels.
    pub(super) car: u32,
    /// Side of a pedestrian, in pixels.
    pub(super) pedestrian: u32,
}

impl Viewport {
    /// Returns a view of `rows` x `cols` cells from a corner on. Agents are four cells wide, with a minimum in pixels.
    ///
    /// # Errors
    /// If there are no cells, or too many pixels.
    pub fn new(corner: Cell, rows: u32, cols: u32, scale: Scale) -> Result<Viewport, ViewportError> {
        let side = |from: i32, cells: u32| {
            if cells == 0 {
                return Err(ViewportError::Empty);
            }
            let end = i32::try_from(cells).ok().and_then(|cells| from.checked_add(cells - 1));
            let length = end.map(|end| scale.start(end) - scale.start(from) + i64::from(scale.pixels));
            length
                .filter(|&length| length <= SIDE_MAX)
                .ok_or(ViewportError::TooLarge)
        };
        if side(corner.row, rows)? * side(corner.col, cols)? > PIXELS_MAX {
            return Err(ViewportError::TooLarge);
        }
        let size = (4 * scale.pixels).cast_unsigned();
        Ok(Viewport {
            corner,
            rows: rows.cast_signed(),
            cols: cols.cast_signed(),
            scale,
            car: size.max(7),
            pedestrian: size.max(9),
        })
    }

    /// Returns a view of the whole map.
    ///
    /// # Errors
    /// If the map has no cells, or the picture too many pixels.
    pub fn whole(map: &CityMap, scale: Scale) -> Result<Viewport, ViewportError> {
        Viewport::of(Extent::whole(map), scale)
    }

    /// Returns a view of a part of a map.
    ///
    /// # Errors
    /// If it has no cells, or the picture too many pixels.
    pub fn of(extent: Extent, scale: Scale) -> Result<Viewport, ViewportError> {
        let side = |cells: i32| u32::try_from(cells).unwrap_or(0);
        Viewport::new(extent.corner, side(extent.rows), side(extent.cols), scale)
    }

    /// Returns the view of the published visual data set: 128 x 128 cells of 8 pixels, so buildings of 10 cells have
    /// 80, cars 48 and pedestrians 32.
    ///
    /// # Errors
    /// If the view exceeds the range of coordinates.
    pub fn published(corner: Cell) -> Result<Viewport, ViewportError> {
        let scale = Scale::pixels(8).expect("within bounds");
        Viewport::new(corner, 128, 128, scale)?.with_agents(48, 32)
    }

    /// Returns this view with other sizes of agents: the short side of a car and the side of a pedestrian, in pixels.
    ///
    /// # Errors
    /// If a size is 0 or larger than [`ICON_MAX`].
    pub fn with_agents(self, car: u32, pedestrian: u32) -> Result<Viewport, ViewportError> {
        let fits = |size: u32| (1..=ICON_MAX).contains(&size);
        if !fits(car) || !fits(pedestrian) {
            return Err(ViewportError::IconSize);
        }
        Ok(Viewport {
            car,
            pedestrian,
            ..self
        })
    }

    /// Returns the first cell.
    pub fn corner(&self) -> Cell {
        self.corner
    }

    /// Returns width and height of the picture, in pixels.
    pub fn size(&self) -> (u32, u32) {
        let side = |from: i32, cells: i32| {
            let length = self.scale.start(from + (cells - 1)) - self.scale.start(from) + i64::from(self.scale.pixels);
            u32::try_from(length).expect("views are bounded")
        };
        (side(self.corner.col, self.cols), side(self.corner.row, self.rows))
    }

    /// Returns the whole picture as a rectangle.
    pub(super) fn area(&self) -> PixelBox {
        let (width, height) = self.size();
        PixelBox {
            x: 0,
            y: 0,
            width,
            height,
        }
    }

    /// Returns the cell of a square of pixels, given its row and column among the squares of the picture; if a pixel
    /// covers several cells, the middle one.
    pub(super) fn cell(&self, row: usize, col: usize) -> Cell {
        let along = |from: i32, at: usize| match self.scale.cells {
            1 => from + at as i32,
            cells => (from.div_euclid(cells) + at as i32)
                .saturating_mul(cells)
                .saturating_add(cells / 2),
        };
        Cell::new(along(self.corner.row, row), along(self.corner.col, col))
    }

    /// Returns the place of the first pixel on the map, as column and row.
    pub(super) fn start(&self) -> (i64, i64) {
        (self.scale.start(self.corner.col), self.scale.start(self.corner.row))
    }

    /// Returns the pixel in the middle of a cell, as column and row; `None` if it is far off the picture.
    pub fn middle(&self, cell: Cell) -> Option<(i32, i32)> {
        let along = |cell: i32, from: i32| {
            let at = self.scale.middle(cell) - self.scale.start(from);
            i32::try_from(at).ok().filter(|at| at.unsigned_abs() <= 1 << 20)
        };
        Some((along(cell.col, self.corner.col)?, along(cell.row, self.corner.row)?))
    }
}
