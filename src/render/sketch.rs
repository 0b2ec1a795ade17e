//! Resolution-independent drawings: shapes that paint in order, at any scale and heading.
// Decision: docs/decisions/pictures.md#d062

use crate::rng::{Rng, RngExt};
use resvg::tiny_skia::{
    BlendMode, Color, FillRule, GradientStop, LineCap, LineJoin, LinearGradient, Paint, Path, PathBuilder, Pixmap,
    Point, Rect, Shader, SpreadMode, Stroke, Transform,
};

/// A color and its opacity.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Ink {
    pub(super) rgb: [u8; 3],
    alpha: u8,
}

impl Ink {
    pub(super) const WHITE: Ink = Ink::hex(0x00ff_ffff);
    pub(super) const BLACK: Ink = Ink::hex(0);

    /// Returns an opaque color, given as `0xrrggbb`.
    pub(super) const fn hex(rgb: u32) -> Ink {
        let [_, r, g, b] = rgb.to_be_bytes();
        Ink {
            rgb: [r, g, b],
            alpha: 255,
        }
    }

    /// Returns an opaque color by hue in turns, and saturation and lightness, both 0..=1.
    pub(super) fn hsl(hue: f32, saturation: f32, lightness: f32) -> Ink {
        let reach = saturation * lightness.min(1.0 - lightness);
        let channel = |shift: f32| {
            let k = (shift + 12.0 * hue.rem_euclid(1.0)).rem_euclid(12.0);
            byte(255.0 * (lightness - reach * (k - 3.0).min(9.0 - k).clamp(-1.0, 1.0)))
        };
        Ink {
            rgb: [channel(0.0), channel(8.0), channel(4.0)],
            alpha: 255,
        }
    }

    /// Interpolates between this color (0) and another (1).
    pub(super) fn mix(self, other: Ink, share: f32) -> Ink {
        let blend = |a: u8, b: u8| byte(f32::from(a) + (f32::from(b) - f32::from(a)) * share);
        let [r, g, b] = [0, 1, 2].map(|channel| blend(self.rgb[channel], other.rgb[channel]));
        Ink {
            rgb: [r, g, b],
            alpha: self.alpha,
        }
    }

    /// Mixes with white if `by` is positive, with black if it is negative; -1..=1.
    pub(super) fn lit(self, by: f32) -> Ink {
        self.mix(if by > 0.0 { Ink::WHITE } else { Ink::BLACK }, by.abs())
    }

    /// Returns the color with this opacity, 0..=1.
    pub(super) fn faint(self, opacity: f32) -> Ink {
        Ink {
            alpha: byte(255.0 * opacity),
            ..self
        }
    }

    fn color(self) -> Color {
        let [r, g, b] = self.rgb;
        Color::from_rgba8(r, g, b, self.alpha)
    }
}

/// Returns the nearest byte.
pub(super) fn byte(value: f32) -> u8 {
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    let byte = (value + 0.5).clamp(0.0, 255.0) as u8;
    byte
}

/// Random choices for drawings, from a stream.
pub(super) struct Dice<R>(pub(super) R);

impl<R: Rng> Dice<R> {
    pub(super) fn between(&mut self, low: f32, high: f32) -> f32 {
        // 24 bits make the quotient exact and the same on all platforms.
        let bits: u32 = self.0.random();
        #[allow(clippy::cast_precision_loss)]
        let share = (bits >> 8) as f32 / (1 << 24) as f32;
        low + (high - low) * share
    }

    pub(super) fn chance(&mut self, probability: f32) -> bool {
        self.between(0.0, 1.0) < probability
    }

    pub(super) fn below(&mut self, count: usize) -> usize {
        self.0.random_range(0..count.max(1))
    }

    pub(super) fn pick<T: Copy>(&mut self, from: &[T]) -> T {
        from[self.below(from.len())]
    }

    /// Returns one of the colors, slightly varied in lightness and tint.
    pub(super) fn ink(&mut self, from: &[u32]) -> Ink {
        let ink = Ink::hex(self.pick(from));
        let tint = Ink::hsl(self.between(0.0, 1.0), 0.5, 0.5);
        ink.mix(tint, self.between(0.0, 0.12)).lit(self.between(-0.12, 0.12))
    }
}

/// Left, top, right, bottom.
pub(super) type Edges = [f32; 4];

/// Shapes, painted in the order of insertion.
#[derive(Clone, Debug, Default)]
pub(super) struct Sketch {
    shapes: Vec<(Path, Paint<'static>)>,
    /// Whether new shapes show only over painted areas.
    inside: bool,
}

impl Sketch {
    /// Restricts the following shapes to painted areas.
    pub(super) fn stay_inside(&mut self) {
        self.inside = true;
    }

    /// Lets the following shapes show everywhere.
    pub(super) fn go_outside(&mut self) {
        self.inside = false;
    }

    /// Paints all shapes.
    pub(super) fn paint(&self, on: &mut Pixmap, transform: Transform) {
        for (path, paint) in &self.shapes {
            on.fill_path(path, paint, FillRule::Winding, transform, None);
        }
    }

    /// Paints all shapes except those restricted to painted areas. All pixels get the same opacities as with
    /// [`Sketch::paint`].
    pub(super) fn paint_outline(&self, on: &mut Pixmap, transform: Transform) {
        let outside = (self.shapes.iter()).filter(|(_, paint)| paint.blend_mode == BlendMode::SourceOver);
        for (path, paint) in outside {
            on.fill_path(path, paint, FillRule::Winding, transform, None);
        }
    }

    fn add(&mut self, path: Option<Path>, shader: Shader<'static>) {
        // A shape without an area has no path and shows nothing.
        let Some(path) = path else { return };
        let blend_mode = if self.inside {
            BlendMode::SourceAtop
        } else {
            BlendMode::SourceOver
        };
        let paint = Paint {
            shader,
            blend_mode,
            ..Paint::default()
        };
        self.shapes.push((path, paint));
    }

    fn fill(&mut self, path: Option<Path>, ink: Ink) {
        self.add(path, Shader::SolidColor(ink.color()));
    }

    pub(super) fn rect(&mut self, edges: Edges, ink: Ink) {
        self.fill(rectangle(edges).map(PathBuilder::from_rect), ink);
    }

    /// Adds a rectangle with a color gradient, from left to right or from top to bottom.
    pub(super) fn fade(&mut self, edges: Edges, from: Ink, to: Ink, downwards: bool) {
        let [left, top, right, bottom] = edges;
        let end = if downwards { (left, bottom) } else { (right, top) };
        let stops = vec![GradientStop::new(0.0, from.color()), GradientStop::new(1.0, to.color())];
        let shader = LinearGradient::new(
            Point::from_xy(left, top),
            Point::from(end),
            stops,
            SpreadMode::Pad,
            Transform::identity(),
        );
        if let Some(shader) = shader {
            self.add(rectangle(edges).map(PathBuilder::from_rect), shader);
        }
    }

    /// Adds a rectangle with round corners.
    pub(super) fn round(&mut self, [left, top, right, bottom]: Edges, radius: f32, ink: Ink) {
        let r = radius.min((right - left) / 2.0).min((bottom - top) / 2.0);
        let mut path = PathBuilder::new();
        path.move_to(left + r, top);
        path.line_to(right - r, top);
        path.quad_to(right, top, right, top + r);
        path.line_to(right, bottom - r);
        path.quad_to(right, bottom, right - r, bottom);
        path.line_to(left + r, bottom);
        path.quad_to(left, bottom, left, bottom - r);
        path.line_to(left, top + r);
        path.quad_to(left, top, left + r, top);
        path.close();
        self.fill(path.finish(), ink);
    }

    pub(super) fn oval(&mut self, x: f32, y: f32, wide: f32, high: f32, ink: Ink) {
        let edges = rectangle([x - wide, y - high, x + wide, y + high]);
        self.fill(edges.and_then(PathBuilder::from_oval), ink);
    }

    pub(super) fn polygon(&mut self, points: &[(f32, f32)], ink: Ink) {
        let mut path = PathBuilder::new();
        follow(&mut path, points);
        path.close();
        self.fill(path.finish(), ink);
    }

    /// Adds a closed curve that touches the midpoint of each side between the points.
    pub(super) fn blob(&mut self, points: &[(f32, f32)], ink: Ink) {
        let middle = |(ax, ay): (f32, f32), (bx, by): (f32, f32)| ((ax + bx) / 2.0, (ay + by) / 2.0);
        let mut path = PathBuilder::new();
        let next = |at: usize| points[(at + 1) % points.len()];
        let start = middle(points[0], next(0));
        path.move_to(start.0, start.1);
        for at in 1..=points.len() {
            let corner = points[at % points.len()];
            let end = middle(corner, next(at % points.len()));
            path.quad_to(corner.0, corner.1, end.0, end.1);
        }
        path.close();
        self.fill(path.finish(), ink);
    }

    /// Adds a line through points, with round ends.
    pub(super) fn line(&mut self, points: &[(f32, f32)], width: f32, ink: Ink) {
        let mut path = PathBuilder::new();
        follow(&mut path, points);
        let stroke = Stroke {
            width,
            line_cap: LineCap::Round,
            line_join: LineJoin::Round,
            ..Stroke::default()
        };
        // The resolution of curves suffices for units of some hundred pixels.
        self.fill(path.finish().and_then(|path| path.stroke(&stroke, 200.0)), ink);
    }

    /// Adds capital letters and digits around a center; other characters leave a gap.
    pub(super) fn letters(&mut self, text: &str, (x, y): (f32, f32), high: f32, bold: f32, ink: Ink) {
        #[allow(clippy::cast_precision_loss)]
        let count = text.chars().count() as f32;
        let grid = high / 4.0;
        let mut left = x - (3.0 * count - 1.0) * grid / 2.0;
        for letter in text.chars() {
            for stroke in strokes(letter).split('|') {
                let coordinate = |char: char| grid * f32::from(char as u8 - b'0');
                let points: Vec<(f32, f32)> = stroke
                    .split_whitespace()
                    .filter_map(|pair| {
                        let mut chars = pair.chars();
                        Some((
                            left + coordinate(chars.next()?),
                            y - high / 2.0 + coordinate(chars.next()?),
                        ))
                    })
                    .collect();
                self.line(&points, bold, ink);
            }
            left += 3.0 * grid;
        }
    }
}

/// Draws fallen leaves around a place; a leaf is about `size` long.
pub(super) fn leaves<R: Rng>(sketch: &mut Sketch, dice: &mut Dice<R>, (x, y): (f32, f32), size: f32) {
    for _ in 0..5 + dice.below(6) {
        let (x, y) = (x + dice.between(-1.9, 1.9) * size, y + dice.between(-1.9, 1.9) * size);
        let ink = dice.ink(&[0xc9742b, 0xd9a332, 0xa8452a, 0x8f8a34, 0xc4562c]);
        let half = size * dice.between(0.42, 0.6);
        // A direction without a sine: a point of a square, scaled to unit length.
        let (dx, dy) = (dice.between(-1.0, 1.0), dice.between(0.1, 1.0));
        let length = (dx * dx + dy * dy).sqrt();
        let (dx, dy) = (dx / length * half, dy / length * half);
        let at = |along: f32, across: f32| (x + along * dx - across * dy, y + along * dy + across * dx);
        let outline = [
            (-1.0, 0.0),
            (-0.3, 0.55),
            (0.4, 0.45),
            (1.0, 0.0),
            (0.4, -0.45),
            (-0.3, -0.55),
        ];
        sketch.polygon(&outline.map(|(along, across)| at(along, across)), ink);
        sketch.line(&[at(-1.5, 0.0), at(0.8, 0.0)], size * 0.1, ink.lit(-0.4));
    }
}

fn rectangle([left, top, right, bottom]: Edges) -> Option<Rect> {
    Rect::from_ltrb(left, top, right, bottom)
}

fn follow(path: &mut PathBuilder, points: &[(f32, f32)]) {
    for (at, &(x, y)) in points.iter().enumerate() {
        if at == 0 {
            path.move_to(x, y);
        } else {
            path.line_to(x, y);
        }
    }
}

/// Returns the lines of a letter on a grid of 3 columns and 5 rows: points as column and row, with `|` between lines.
const fn strokes(letter: char) -> &'static str {
    match letter {
        'A' => "04 01 10 21 24|02 22",
        'B' => "00 04 14 23 12 02|00 10 21 12",
        'C' => "21 10 01 03 14 23",
        'D' => "00 04 14 23 21 10 00",
        'E' => "20 00 04 24|02 12",
        'F' => "20 00 04|02 12",
        'G' => "21 10 01 03 14 23 22 12",
        'H' => "00 04|20 24|02 22",
        'I' => "10 14",
        'J' => "20 23 14 03",
        'K' => "00 04|20 02 24",
        'L' => "00 04 24",
        'M' => "04 00 12 20 24",
        'N' => "04 00 24 20",
        'O' | '0' => "10 01 03 14 23 21 10",
        'P' => "04 00 10 21 12 02",
        'Q' => "10 01 03 14 23 21 10|13 24",
        'R' => "04 00 10 21 12 02|12 24",
        'S' => "21 10 01 12 23 14 03",
        'T' => "00 20|10 14",
        'U' => "00 03 14 23 20",
        'V' => "00 14 20",
        'W' => "00 04 12 24 20",
        'X' => "00 24|20 04",
        'Y' => "00 12 20|12 14",
        'Z' => "00 20 04 24",
        '1' => "01 10 14",
        '2' => "01 10 21 04 24",
        '3' => "00 20 12 23 14 03",
        '4' => "14 10 03 23",
        '5' => "20 00 02 12 23 14 04",
        '6' => "20 11 03 14 23 12 03",
        '7' => "00 20 14",
        '8' => "12 01 10 21 12 03 14 23 12",
        '9' => "21 12 01 10 21 14",
        _ => "",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_letter_and_digit_has_lines_of_its_own() {
        let known: Vec<&str> = ('A'..='Z').chain('1'..='9').map(strokes).collect();
        for (at, lines) in known.iter().enumerate() {
            assert!(lines.len() >= 5 && !known[..at].contains(lines), "{lines}");
            let points = lines.split([' ', '|']);
            assert!(
                points
                    .clone()
                    .all(|point| ("00"..="24").contains(&point) && point.len() == 2)
            );
        }
        assert_eq!(strokes('?'), "");
    }

    #[test]
    fn hues_are_those_of_the_color_wheel() {
        assert_eq!(Ink::hsl(0.0, 1.0, 0.5).rgb, [255, 0, 0]);
        assert_eq!(Ink::hsl(1.0 / 3.0, 1.0, 0.5).rgb, [0, 255, 0]);
        assert_eq!(Ink::hsl(2.0 / 3.0, 1.0, 0.25).rgb, [0, 0, 128]);
        assert_eq!(Ink::hsl(0.4, 0.0, 0.6).rgb, [153; 3]);
    }
}
