//! Labels: short names next to agents, never one over another.

use super::agent::Sprite;
use super::canvas::Frame;
use super::ink::Ink;
use crate::city::Heading;
use embedded_graphics::mono_font::iso_8859_1::FONT_6X10;
use embedded_graphics::text::Alignment;

/// At most this many agents are labelled: more would be unreadable, and the search for room takes time.
const MOST: usize = 300;

/// The longest label in characters.
const LONGEST: usize = 10;

/// A rectangle in pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct PixelArea {
    pub(super) left: i32,
    pub(super) top: i32,
    pub(super) width: i32,
    pub(super) height: i32,
}

impl PixelArea {
    /// The common part's size in square pixels.
    pub(super) fn overlap(self, other: PixelArea) -> i32 {
        let common =
            |a: i32, a_length: i32, b: i32, b_length: i32| ((a + a_length).min(b + b_length) - a.max(b)).max(0);
        common(self.left, self.width, other.left, other.width) * common(self.top, self.height, other.top, other.height)
    }

    pub(super) fn contains(self, other: PixelArea) -> bool {
        self.overlap(other) == other.width * other.height
    }
}

/// `C12` for `Car_12`, `P3` for `Pedestrian_3`, else the name itself, shortened.
fn short(sprite: &Sprite<'_>) -> String {
    let number = sprite
        .name
        .strip_prefix(sprite.kind.name())
        .and_then(|rest| rest.strip_prefix('_'));
    match number {
        Some(number) if !number.is_empty() && number.len() < LONGEST && number.bytes().all(|b| b.is_ascii_digit()) => {
            format!("{}{number}", &sprite.kind.name()[..1])
        }
        _ => one_line(sprite.name, LONGEST),
    }
}

/// The text without control characters, cut with an ellipsis to that many characters.
pub(super) fn one_line(text: &str, most: usize) -> String {
    let mut chars = text.chars().map(|char| if char.is_control() { ' ' } else { char });
    let mut line: String = chars.by_ref().take(most).collect();
    if chars.next().is_some() {
        line.pop();
        line.push_str("..");
    }
    line
}

/// Finds room inside `bounds` for the label of each sprite, whose figure covers the area next to it. A label avoids
/// figures if it can and other labels always: one without room is left out.
pub(super) fn place(sprites: &[(Sprite<'_>, PixelArea)], bounds: PixelArea) -> Vec<(String, PixelArea)> {
    let mut placed: Vec<(String, PixelArea)> = Vec::new();
    for (sprite, figure) in sprites.iter().take(MOST) {
        let text = short(sprite);
        if text.is_empty() {
            continue;
        }
        // A character is 6 wide and 10 high, and the plate has a margin.
        let (width, height) = (6 * text.chars().count() as i32 + 3, 11);
        let free = candidates(*figure, sprite.heading, width, height)
            .filter(|&area| bounds.contains(area) && placed.iter().all(|(_, other)| area.overlap(*other) == 0));
        let covered = |area: PixelArea| sprites.iter().map(|(_, figure)| area.overlap(*figure)).sum::<i32>();
        let mut best: Option<(i32, PixelArea)> = None;
        for area in free {
            let cost = covered(area);
            if best.is_none_or(|(least, _)| cost < least) {
                best = Some((cost, area));
            }
            if cost == 0 {
                break;
            }
        }
        if let Some((_, area)) = best {
            placed.push((text, area));
        }
    }
    placed
}

/// Places around a figure, the best first: beside it but not behind it, then a little further off.
fn candidates(figure: PixelArea, heading: Option<Heading>, width: i32, height: i32) -> impl Iterator<Item = PixelArea> {
    [1, 6, 12].into_iter().flat_map(move |gap| {
        let (west, east) = (figure.left - gap - width, figure.left + figure.width + gap);
        let (ahead, behind) = if heading == Some(Heading::Left) {
            (west, east)
        } else {
            (east, west)
        };
        let (north, south) = (figure.top - gap - height, figure.top + figure.height + gap);
        let (middle_x, middle_y) = (
            figure.left + (figure.width - width) / 2,
            figure.top + (figure.height - height) / 2,
        );
        [
            (ahead, middle_y),
            (middle_x, north),
            (middle_x, south),
            (behind, middle_y),
            (east, north),
            (east, south),
            (west, north),
            (west, south),
        ]
        .map(|(left, top)| PixelArea {
            left,
            top,
            width,
            height,
        })
    })
}

/// Draws placed labels.
pub(super) fn draw(labels: &[(String, PixelArea)], frame: &mut Frame) {
    for (
        text,
        PixelArea {
            left,
            top,
            width,
            height,
        },
    ) in labels
    {
        frame.fill(*left, *top, *width, *height, Ink::PAPER);
        frame.text(text, left + 2, top + height / 2, &FONT_6X10, Ink::TEXT, Alignment::Left);
    }
}
