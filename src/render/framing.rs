//! How a picture shows an agent under difficulty: the sides of its box, the size and the place of its icon in the box,
//! and what hides a part of the icon. None of it depends on the class.

use crate::render::difficulty::Difficulty;
use crate::render::picture::{PixelBox, Silhouette, Stamp};
use crate::render::sketch::{Dice, Ink, Sketch};
use crate::rng::{Purpose, Rng, RngExt, Seed};
use resvg::tiny_skia::{Pixmap, Transform};
use std::sync::Arc;

impl Purpose {
    /// The look of what hides a part of an icon.
    pub const COVER: Purpose = Purpose::new(19);
}

/// The least and the greatest side of a box, in widths of a car.
const SIDES: (f32, f32) = (1.5, 2.5);

/// How a picture shows an agent, drawn independently of its class.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Framing {
    /// The sides of the box in widths of a car: along rows and along columns.
    sides: [f32; 2],
    /// The size of the icon as a share of its usual size, if that fits into the box.
    scale: f32,
    /// The part of the free space of the box before the icon, along rows and along columns.
    before: [f32; 2],
    /// The part of the framing in effect: 0 is none, and from 1 on boxes are independent of the class.
    share: f32,
    cover: Option<Cover>,
}

/// Something that hides a part of an icon.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Cover {
    /// Its center, in sides of the icon's box from the center of that box.
    middle: [f32; 2],
    /// Its radius in longer sides of the icon's box.
    radius: f32,
    /// Determines its shape and color.
    look: u64,
}

impl Framing {
    /// Draws a framing; `None` at difficulty 0.
    pub(super) fn drawn<R: Rng>(difficulty: Difficulty, dice: &mut Dice<R>) -> Option<Framing> {
        let noise = difficulty.share();
        let sides = [0; 2].map(|_| dice.between(SIDES.0, SIDES.1));
        let scale = dice.between(0.8, 1.15);
        let before = [0; 2].map(|_| dice.between(0.25, 0.75));
        let is_covered = dice.chance(0.6 * noise);
        let cover = Cover {
            middle: [0; 2].map(|_| dice.between(-0.38, 0.38)),
            radius: dice.between(0.12, 0.16 + 0.14 * noise),
            look: dice.0.random(),
        };
        (noise > 0.0).then_some(Framing {
            sides,
            scale,
            before,
            share: (noise / Difficulty::HALF.share()).min(1.0),
            cover: is_covered.then_some(cover),
        })
    }

    /// Returns the sides of the box in pixels. `width` is that of a car.
    #[allow(
        clippy::cast_precision_loss,
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss
    )]
    fn sides(&self, width: u32) -> [u32; 2] {
        self.sides.map(|side| (side * width as f32).round() as u32)
    }

    /// Returns the size of an icon in pixels, at least 1. `size` is its usual size, `width` that of a car.
    ///
    /// `body` returns the box of the body at a size. From a share of 1 on, the body fits into the sides of the box.
    #[allow(
        clippy::cast_precision_loss,
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss
    )]
    pub(super) fn size(&self, size: u32, width: u32, body: impl Fn(u32) -> PixelBox) -> u32 {
        let (usual, [wide, high]) = (body(size), self.sides(width));
        let fit = (wide as f32 / usual.width.max(1) as f32).min(high as f32 / usual.height.max(1) as f32);
        let full = size as f32 * self.scale.min(fit);
        let mut drawn = (size as f32 + self.share * (full - size as f32)).round().max(1.0) as u32;
        while self.share >= 1.0 && drawn > 1 {
            let area = body(drawn);
            if area.width <= wide && area.height <= high {
                break;
            }
            drawn -= 1;
        }
        drawn
    }

    /// Returns the box for a body with the box `body` in a picture of this size. It contains the part of the body in
    /// the picture. `None` if there is none.
    #[allow(
        clippy::cast_precision_loss,
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss
    )]
    pub(super) fn loosened(&self, body: PixelBox, width: u32, picture: (u32, u32)) -> Option<PixelBox> {
        body.clipped(picture.0, picture.1)?;
        let along = |start: i32, length: u32, side: u32, before: f32, end: u32| {
            let free = self.share * side.saturating_sub(length) as f32;
            let all = (length + free.round() as u32).min(end);
            let start = start - (free * before).round() as i32;
            // A box at the edge moves inside, so that its sides stay.
            (start.clamp(0, (end - all).cast_signed()), all)
        };
        let [wide, high] = self.sides(width);
        let (x, width) = along(body.x, body.width, wide, self.before[0], picture.0);
        let (y, height) = along(body.y, body.height, high, self.before[1], picture.1);
        Some(PixelBox { x, y, width, height })
    }

    /// Draws what hides a part of a body with this box. The stamp is relative to the center of the body's icon, as the
    /// box is.
    #[allow(clippy::cast_precision_loss, clippy::cast_possible_truncation)]
    pub(super) fn cover(&self, body: PixelBox) -> Option<Stamp> {
        let Cover { middle, radius, look } = self.cover?;
        let (wide, high) = (body.width as f32, body.height as f32);
        let radius = (radius * wide.max(high)).max(1.0);
        let along = |start: i32, side: f32, share: f32| (start as f32 + side * (0.5 + share)).round() as i32;
        let (x, y) = (along(body.x, wide, middle[0]), along(body.y, high, middle[1]));
        let mut dice = Dice(Seed(look).stream(Purpose::COVER, 0, 0));
        let mut sketch = Sketch::default();
        match dice.below(4) {
            0 | 1 => crown(&mut sketch, &mut dice),
            2 => sign(&mut sketch, &mut dice),
            _ => umbrella(&mut sketch, &mut dice),
        }
        // Sketches reach 1.4 radii from their center.
        let half = (1.4 * radius).ceil() as i32 + 1;
        let side = 2 * half.cast_unsigned();
        let mut pixmap = Pixmap::new(side, side).expect("covers are small");
        let center = half as f32;
        sketch.paint(
            &mut pixmap,
            Transform::from_scale(radius, radius).post_translate(center, center),
        );
        let area = PixelBox {
            x: x - half,
            y: y - half,
            width: side,
            height: side,
        };
        let opaque = |col: u32, row: u32| pixmap.pixel(col, row).is_some_and(|pixel| pixel.alpha() >= 128);
        Some(Stamp {
            area,
            body: Arc::new(Silhouette::new(area, opaque)),
            pixels: pixmap.data().to_vec(),
        })
    }
}

/// Draws the crown of a tree from above.
fn crown<R: Rng>(sketch: &mut Sketch, dice: &mut Dice<R>) {
    let leaf = dice.ink(&[0x3f7a3a, 0x5b8c3f, 0x2f5f38, 0x7d8f3a, 0xb0762e]);
    sketch.oval(0.18, 0.22, 0.95, 0.95, Ink::BLACK.faint(0.25));
    let around = [
        (0.55, 0.0),
        (0.3, 0.48),
        (-0.3, 0.48),
        (-0.55, 0.0),
        (-0.3, -0.48),
        (0.3, -0.48),
        (0.0, 0.0),
    ];
    for (x, y) in around {
        let size = dice.between(0.34, 0.46);
        sketch.oval(x, y, size, size, leaf.lit(-0.35));
    }
    for (x, y) in around {
        let size = dice.between(0.26, 0.36);
        let (dx, dy) = (dice.between(-0.1, 0.02), dice.between(-0.1, 0.02));
        sketch.oval(x + dx, y + dy, size, size, leaf.lit(dice.between(-0.1, 0.2)));
    }
    for _ in 0..12 {
        let (x, y) = (dice.between(-0.7, 0.6), dice.between(-0.7, 0.6));
        sketch.oval(x, y, 0.08, 0.06, leaf.lit(dice.between(0.1, 0.4)));
    }
}

/// Draws an overhead sign on a pole.
fn sign<R: Rng>(sketch: &mut Sketch, dice: &mut Dice<R>) {
    let ink = dice.ink(&[0x2d4d6e, 0x6d7278, 0x7a5a3a, 0x38664a, 0xc2bba8]);
    let (wide, high) = if dice.chance(0.5) { (1.0, 0.4) } else { (0.4, 1.0) };
    sketch.rect(
        [-wide + 0.12, -high + 0.14, wide + 0.12, high + 0.14],
        Ink::BLACK.faint(0.25),
    );
    sketch.rect([-wide, -high, wide, high], ink.lit(-0.45));
    sketch.rect([-wide + 0.07, -high + 0.07, wide - 0.07, high - 0.07], ink);
    for share in [-0.5, 0.0, 0.5] {
        let (x, y) = (3.0 * share * (wide - 0.3), 3.0 * share * (high - 0.3));
        let ends = if wide > high {
            [(-wide + 0.2, y), (wide - 0.2, y)]
        } else {
            [(x, -high + 0.2), (x, high - 0.2)]
        };
        sketch.line(&ends, 0.06, ink.lit(0.35));
    }
}

/// Draws an umbrella or an awning from above: sectors in two colors.
fn umbrella<R: Rng>(sketch: &mut Sketch, dice: &mut Dice<R>) {
    let ink = dice.ink(&[0xb8402f, 0x2f5d8a, 0xc9a33a, 0x4d7a52, 0x8a4a6d, 0x50555e]);
    let other = dice.ink(&[0xe8e2d2, 0xcfd3d6, 0x3a3d42]);
    const CORNERS: [(f32, f32); 8] = [
        (1.0, 0.0),
        (0.707, 0.707),
        (0.0, 1.0),
        (-0.707, 0.707),
        (-1.0, 0.0),
        (-0.707, -0.707),
        (0.0, -1.0),
        (0.707, -0.707),
    ];
    let shadow = CORNERS.map(|(x, y)| (x + 0.14, y + 0.18));
    sketch.polygon(&shadow, Ink::BLACK.faint(0.25));
    for (number, corner) in CORNERS.into_iter().enumerate() {
        let next = CORNERS[(number + 1) % CORNERS.len()];
        let sector = if number % 2 == 0 { ink } else { other };
        sketch.polygon(&[(0.0, 0.0), corner, next], sector);
    }
    sketch.oval(0.0, 0.0, 0.08, 0.08, ink.lit(-0.5));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn boxes_contain_the_visible_part_of_the_body() {
        let (mut inside, mut outside) = (0, 0);
        for case in 0..2000 {
            let mut stream = Seed(case).stream(Purpose::TEST, 0, 0);
            let percent = stream.random_range(1..=100);
            let difficulty = Difficulty::percent(percent).expect("a percentage");
            let framing = Framing::drawn(difficulty, &mut Dice(&mut stream)).expect("it is not clean");
            let car = stream.random_range(1..60);
            let picture = (stream.random_range(1..800), stream.random_range(1..800));
            // A body is `long` times as long as wide.
            let long = stream.random_range(1..=3);
            let body = |size: u32| PixelBox {
                x: 0,
                y: 0,
                width: size,
                height: long * size,
            };
            let size = framing.size(car, car, body);
            let body = PixelBox {
                x: stream.random_range(-200..600),
                y: stream.random_range(-200..600),
                ..body(size)
            };
            let area = framing.loosened(body, car, picture);
            let Some(part) = body.clipped(picture.0, picture.1) else {
                assert_eq!(area, None, "case {case}");
                outside += 1;
                continue;
            };
            let area = area.expect("a part of the body is in the picture");
            assert_eq!(area.clipped(picture.0, picture.1), Some(area), "case {case}");
            let both = PixelBox {
                x: part.x - area.x,
                y: part.y - area.y,
                ..part
            };
            assert_eq!(both.clipped(area.width, area.height), Some(both), "case {case}");
            if difficulty >= Difficulty::HALF {
                let [wide, high] = framing.sides(car);
                let sides = (wide.max(1).min(picture.0), high.max(long).min(picture.1));
                assert_eq!((area.width, area.height), sides, "case {case}");
            }
            inside += 1;
        }
        assert!(inside > 500 && outside > 500, "{inside} {outside}");
    }
}
