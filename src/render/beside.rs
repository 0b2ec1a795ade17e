//! Pictures side by side, as the frame of a video.

use crate::render::label::{PAPER, TEXT, one_line};
use crate::render::picture::{Picture, PixelBox};
use embedded_graphics::mono_font::iso_8859_1::FONT_9X15_BOLD;
use embedded_graphics::text::Alignment;

/// The height of the line with a title, in pixels.
const TITLE: i32 = 26;
/// The space before a title, in pixels, and the width of the line between two pictures.
const SPACE: i32 = 14;
const LINE: i32 = 2;
/// The width of a letter of a title, in pixels.
const LETTER: i32 = 9;

/// Returns pictures side by side, each below its title if any has one. Both sides of the result are even, as encoders
/// of videos demand.
pub fn beside(pictures: &[(&str, &Picture)]) -> Picture {
    let top = if pictures.iter().any(|(title, _)| !title.is_empty()) {
        TITLE
    } else {
        0
    };
    let even = |length: i32| (length + length % 2).cast_unsigned();
    let width: i32 = pictures
        .iter()
        .map(|(_, picture)| picture.width().cast_signed() + LINE)
        .sum();
    let height = pictures
        .iter()
        .map(|(_, picture)| picture.height().cast_signed())
        .max()
        .unwrap_or(0);
    let mut all = Picture::new(even((width - LINE).max(1)), even((top + height).max(1)), PAPER);
    let mut left = 0;
    for (number, (title, picture)) in pictures.iter().enumerate() {
        if number > 0 {
            let line = PixelBox {
                x: left - LINE,
                y: 0,
                width: LINE.cast_unsigned(),
                height: all.height(),
            };
            all.fill(line, [0xb8, 0xb4, 0xaa]);
        }
        let wide = picture.width().cast_signed();
        let most = usize::try_from((wide - 2 * SPACE) / LETTER).unwrap_or(0);
        let title = one_line(title, most.max(1));
        all.text(
            &title,
            (left + SPACE, TITLE / 2),
            &FONT_9X15_BOLD,
            TEXT,
            Alignment::Left,
        );
        all.lay(picture, left, top);
        left += wide + LINE;
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_stand_side_by_side_with_even_sides() {
        let one = Picture::new(31, 20, [1, 2, 3]);
        let other = Picture::new(50, 35, [4, 5, 6]);
        let alone = beside(&[("", &one)]);
        assert_eq!((alone.width(), alone.height()), (32, 20));
        let pixel = |picture: &Picture, x: u32, y: u32| {
            let at = 3 * (y * picture.width() + x) as usize;
            picture.pixels()[at..at + 3].to_vec()
        };
        assert_eq!(pixel(&alone, 30, 19), [1, 2, 3]);
        assert_eq!(pixel(&alone, 31, 0), PAPER);
        let pair = beside(&[("left", &one), ("right", &other)]);
        assert_eq!((pair.width(), pair.height()), (84, 62));
        assert_eq!(pixel(&pair, 0, 26), [1, 2, 3]);
        assert_eq!(pixel(&pair, 33, 26), [4, 5, 6]);
        assert_eq!(pixel(&pair, 82, 60), [4, 5, 6]);
        assert_eq!(pixel(&pair, 0, 61), PAPER);
        let titles = |picture: &Picture| picture.pixels()[..3 * 26 * picture.width() as usize].to_vec();
        assert_ne!(titles(&pair), titles(&beside(&[("left", &one), ("other", &other)])));
    }
}
