//! Things that lie on the ground and distract under noise: manhole covers, fallen leaves, and the shadows of trees.
//!
//! Each thing is a function of its place on the map, so a part of the ground shows the same things as the whole.
// Decision: docs/decisions/pictures.md#d047

use crate::city::{Cell, CityMap, Ground};
use crate::render::picture::{Picture, PixelBox};
use crate::render::sketch::{Dice, Ink, Sketch, byte, leaves};
use crate::render::view::Viewport;
use crate::rng::{Purpose, Rng, Seed};
use resvg::tiny_skia::{Pixmap, Transform};

/// Side of the squares of cells that have at most one thing each.
const SQUARE: i32 = 9;
/// The maximum number of cells from the middle of a thing to its edge along an axis.
const REACH: i32 = 6;
/// The opacity of shadows.
const SHADE: f32 = 0.34;

/// Draws a manhole cover: a frame, an iron lid with bars, and two holes to lift it.
fn manhole<R: Rng>(sketch: &mut Sketch, dice: &mut Dice<R>) {
    let iron = Ink::hex(0x004e_5154).lit(dice.between(-0.12, 0.12));
    for (radius, ink) in [
        (1.25, iron.lit(0.42)),
        (1.08, iron.lit(-0.45)),
        (0.96, iron),
        (0.78, iron.lit(0.3)),
        (0.68, iron),
    ] {
        sketch.oval(0.0, 0.0, radius, radius, ink);
    }
    let upright = dice.chance(0.5);
    for (across, half) in [(-0.38, 0.46), (0.0, 0.58), (0.38, 0.46)] {
        let ends = [(-half, across), (half, across)];
        let ends = ends.map(|(x, y)| if upright { (y, x) } else { (x, y) });
        sketch.line(&ends, 0.13, iron.lit(0.34));
    }
    for side in [-0.87, 0.87] {
        let (x, y) = if upright { (0.0, side) } else { (side, 0.0) };
        sketch.oval(x, y, 0.1, 0.1, iron.lit(-0.7));
    }
}

/// Draws the shadow of a tree: its trunk, two branches and a crown with gaps, away from the light at the upper left.
fn tree_shadow<R: Rng>(sketch: &mut Sketch, dice: &mut Dice<R>) {
    let (x, y) = (dice.between(0.9, 1.3), dice.between(0.9, 1.3));
    let foot = (x - 4.0, y - 4.0);
    sketch.line(&[foot, (x - 0.4, y - 0.4)], 0.42, Ink::BLACK);
    for (dx, dy) in [(-0.2, -1.3), (-1.3, -0.2)] {
        sketch.line(&[(x - 1.6, y - 1.6), (x + dx, y + dy)], 0.28, Ink::BLACK);
    }
    let clump = [
        (0.0, -1.75),
        (1.25, -1.25),
        (1.75, 0.0),
        (1.25, 1.25),
        (0.0, 1.75),
        (-1.25, 1.25),
        (-1.75, 0.0),
        (-1.25, -1.25),
        (0.55, -0.5),
        (-0.5, 0.6),
        (0.7, 0.75),
    ];
    for (dx, dy) in clump {
        let (x, y) = (x + dx + dice.between(-0.25, 0.25), y + dy + dice.between(-0.25, 0.25));
        let radius = dice.between(0.62, 0.95);
        // Leaves at the edge of a clump.
        for (dx, dy) in [
            (1.0, 0.2),
            (0.3, 1.0),
            (-1.0, 0.4),
            (-0.2, -1.0),
            (0.8, -0.7),
            (-0.7, -0.75),
        ] {
            sketch.oval(x + dx * radius, y + dy * radius, 0.2, 0.16, Ink::BLACK);
        }
        sketch.oval(x, y, radius, radius * 0.92, Ink::BLACK);
    }
}

/// An object on the ground of a square.
enum Thing {
    Leaves,
    Manhole,
    TreeShadow,
}

impl Thing {
    /// Returns what can lie at a cell.
    fn at<R: Rng>(map: &CityMap, cell: Cell, dice: &mut Dice<R>) -> Option<Thing> {
        let around = |is: &dyn Fn(Cell) -> bool| {
            let offsets = (-2..=2).flat_map(|row| (-2..=2).map(move |col| (row, col)));
            offsets
                .map(|(row, col)| Cell::new(cell.row + row, cell.col + col))
                .all(is)
        };
        let is_road = |cell: Cell| map.ground_at(cell) == Some(Ground::Traffic) && !map.is_mid_line(cell);
        let is_walk = |cell: Cell| map.ground_at(cell) == Some(Ground::Walking);
        match map.ground_at(cell)? {
            Ground::Traffic if around(&is_road) && dice.chance(0.65) => Some(Thing::Manhole),
            // The foot of the trunk is on the sidewalk.
            Ground::Walking if is_walk(Cell::new(cell.row - 3, cell.col - 3)) && dice.chance(0.7) => {
                Some(Thing::TreeShadow)
            }
            Ground::Walking | Ground::Traffic => Some(Thing::Leaves),
            Ground::Crossing | Ground::Other => None,
        }
    }
}

/// Draws the things in view. `noise` is the difficulty, 0..=1.
pub(super) fn draw(map: &CityMap, view: &Viewport, seed: Seed, noise: f32, picture: &mut Picture) {
    let squares = |from: i32, cells: i32| {
        let square = |cell: i32| cell.div_euclid(SQUARE);
        square(from.saturating_sub(REACH))..=square(from.saturating_add(cells + REACH))
    };
    for row in squares(view.corner.row, view.rows) {
        for col in squares(view.corner.col, view.cols) {
            let place = u64::from(row.cast_unsigned()) << 32 | u64::from(col.cast_unsigned());
            let mut dice = Dice(seed.stream(Purpose::TEXTURE, place, 1));
            if !dice.chance(0.5 * noise) {
                continue;
            }
            let mut inside = |from: i32| Some(from.checked_mul(SQUARE)? + i32::try_from(dice.below(9)).ok()?);
            let (Some(row), Some(col)) = (inside(row), inside(col)) else {
                continue;
            };
            let cell = Cell::new(row, col);
            if let Some(thing) = Thing::at(map, cell, &mut dice) {
                lay(&thing, &mut dice, cell, view, picture);
            }
        }
    }
}

/// Draws a thing whose middle is the middle of a cell.
fn lay<R: Rng>(thing: &Thing, dice: &mut Dice<R>, cell: Cell, view: &Viewport, picture: &mut Picture) {
    let Some((x, y)) = view.middle(cell) else { return };
    let mut sketch = Sketch::default();
    let opacity = match thing {
        Thing::Leaves => {
            leaves(&mut sketch, dice, (0.0, 0.0), 0.95);
            1.0
        }
        Thing::Manhole => {
            manhole(&mut sketch, dice);
            1.0
        }
        Thing::TreeShadow => {
            tree_shadow(&mut sketch, dice);
            SHADE
        }
    };
    let side = view.scale.pixels;
    let half = side * REACH;
    let mut pixmap = Pixmap::new(2 * half.cast_unsigned(), 2 * half.cast_unsigned()).expect("cells are small");
    #[allow(clippy::cast_precision_loss)]
    let (scale, middle) = (side as f32, half as f32);
    sketch.paint(
        &mut pixmap,
        Transform::from_scale(scale, scale).post_translate(middle, middle),
    );
    if opacity < 1.0 {
        for channel in pixmap.data_mut() {
            *channel = byte(f32::from(*channel) * opacity);
        }
    }
    let area = PixelBox {
        x: x - half,
        y: y - half,
        width: pixmap.width(),
        height: pixmap.height(),
    };
    picture.blend(area, pixmap.data());
}
