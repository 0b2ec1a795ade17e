//! Short name labels next to agents, without overlaps, and frames around marked agents.

use crate::render::class::Facing;
use crate::render::picture::PixelBox;
use crate::render::picture::{Picture, Rgb};
use crate::render::sprite::Sprite;
use embedded_graphics::mono_font::iso_8859_1::FONT_6X10;
use embedded_graphics::text::Alignment;

pub(super) const PAPER: Rgb = [0xfb, 0xfa, 0xf7];
pub(super) const TEXT: Rgb = [0x26, 0x2b, 0x33];
/// The color that marks agents.
pub(super) const MARK: Rgb = [0xc8, 0x1e, 0xb4];

/// The maximum number of agents with labels. More would be unreadable, and the search for room takes time.
const MOST: usize = 300;

/// The usual longest label, in characters.
pub(super) const LONGEST: usize = 10;

/// Returns the common area of two rectangles, in square pixels.
pub(super) fn overlap(a: PixelBox, b: PixelBox) -> i32 {
    let common = |a: i32, a_length: u32, b: i32, b_length: u32| {
        ((a + a_length.cast_signed()).min(b + b_length.cast_signed()) - a.max(b)).max(0)
    };
    common(a.x, a.width, b.x, b.width) * common(a.y, a.height, b.y, b.height)
}

/// Returns `C12` for `Car_12`, `P3` for `Pedestrian_3`, `Cyc3` for `Cyclist_3` of a configured kind, else the shortened
/// name.
fn short(sprite: &Sprite<'_>, longest: usize) -> String {
    let kind = sprite.kind_name.unwrap_or(sprite.kind.name());
    let prefix = match sprite.kind_name {
        Some(own) => own_prefix(own),
        None => &kind[..1],
    };
    let number = sprite.name.strip_prefix(kind).and_then(|rest| rest.strip_prefix('_'));
    let is_number = |text: &&str| !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
    match number.filter(is_number) {
        Some(number) if prefix.len() + number.len() <= longest => format!("{prefix}{number}"),
        _ => one_line(sprite.name, longest),
    }
}

/// Returns the prefix of labels of a kind that a configuration defines: three letters of its name.
pub(super) fn own_prefix(kind: &str) -> &str {
    kind.char_indices().nth(3).map_or(kind, |(end, _)| &kind[..end])
}

/// Returns the text without control characters, truncated with an ellipsis to `most` characters.
pub(super) fn one_line(text: &str, most: usize) -> String {
    let mut chars = text.chars().map(|char| if char.is_control() { ' ' } else { char });
    let mut line: String = chars.by_ref().take(most).collect();
    if chars.next().is_some() {
        line.pop();
        line.push_str("..");
    }
    line
}

/// Places labels of at most `longest` characters inside `bounds` next to the figure of each sprite. A label avoids
/// figures if possible, and other labels always: one without room is omitted.
pub(super) fn place(sprites: &[(Sprite<'_>, PixelBox)], bounds: PixelBox, longest: usize) -> Vec<(String, PixelBox)> {
    let mut placed: Vec<(String, PixelBox)> = Vec::new();
    for (sprite, figure) in sprites.iter().take(MOST) {
        let text = short(sprite, longest);
        if text.is_empty() {
            continue;
        }
        // Characters are 6 x 10 pixels; the plate adds a margin.
        let (width, height) = (6 * text.chars().count() as i32 + 3, 11);
        let free = candidates(*figure, sprite.facing, width, height)
            .filter(|&area| bounds.contains(area) && placed.iter().all(|(_, other)| overlap(area, *other) == 0));
        let covered = |area: PixelBox| sprites.iter().map(|(_, figure)| overlap(area, *figure)).sum::<i32>();
        let mut best: Option<(i32, PixelBox)> = None;
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

/// Returns the places around a figure, the best first: next to it but not behind it, then farther away.
fn candidates(figure: PixelBox, facing: Facing, width: i32, height: i32) -> impl Iterator<Item = PixelBox> {
    [1, 6, 12].into_iter().flat_map(move |gap| {
        let (figure_wide, figure_high) = (figure.width.cast_signed(), figure.height.cast_signed());
        let (west, east) = (figure.x - gap - width, figure.x + figure_wide + gap);
        let (ahead, behind) = if matches!(facing, Facing::Left | Facing::UpLeft | Facing::DownLeft) {
            (west, east)
        } else {
            (east, west)
        };
        let (north, south) = (figure.y - gap - height, figure.y + figure_high + gap);
        let (middle_x, middle_y) = (
            figure.x + (figure_wide - width) / 2,
            figure.y + (figure_high - height) / 2,
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
        .map(|(x, y)| PixelBox {
            x,
            y,
            width: width.cast_unsigned(),
            height: height.cast_unsigned(),
        })
    })
}

/// Draws placed labels.
pub(super) fn draw(labels: &[(String, PixelBox)], picture: &mut Picture) {
    for (text, area) in labels {
        picture.fill(*area, PAPER);
        let middle = area.y + area.height.cast_signed() / 2;
        picture.text(text, (area.x + 2, middle), &FONT_6X10, TEXT, Alignment::Left);
    }
}

/// Draws a frame around the figure of a marked agent.
pub(super) fn frame(figure: PixelBox, picture: &mut Picture) {
    let area = PixelBox {
        x: figure.x - 3,
        y: figure.y - 3,
        width: figure.width + 6,
        height: figure.height + 6,
    };
    border(area, picture);
}

/// Draws the edge of a rectangle in the color of marked agents, two pixels wide.
pub(super) fn border(area: PixelBox, picture: &mut Picture) {
    let PixelBox { x, y, width, height } = area;
    let (right, bottom) = (x + width.cast_signed() - 2, y + height.cast_signed() - 2);
    for edge in [
        PixelBox { height: 2, ..area },
        PixelBox {
            y: bottom,
            height: 2,
            ..area
        },
        PixelBox { width: 2, ..area },
        PixelBox {
            x: right,
            width: 2,
            ..area
        },
    ] {
        picture.fill(edge, MARK);
    }
}
