//! Pixels, and operations that draw icons, rectangles and text on them.

use embedded_graphics::Pixel;
use embedded_graphics::draw_target::DrawTarget;
use embedded_graphics::geometry::{OriginDimensions, Point, Size};
use embedded_graphics::mono_font::{MonoFont, MonoTextStyle};
use embedded_graphics::pixelcolor::{Rgb888, RgbColor};
use embedded_graphics::prelude::Drawable;
use embedded_graphics::text::{Alignment, Baseline, Text, TextStyleBuilder};
use std::convert::Infallible;
use std::sync::Arc;

/// A rectangle in a picture, in pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PixelBox {
    /// First column.
    pub x: i32,
    /// First row.
    pub y: i32,
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
}

impl PixelBox {
    /// Returns whether two rectangles have a pixel in common.
    pub fn overlaps(self, other: PixelBox) -> bool {
        let along = |from: i32, length: u32, other_from: i32, other_length: u32| {
            let end = |from: i32, length: u32| i64::from(from) + i64::from(length);
            i64::from(from) < end(other_from, other_length) && i64::from(other_from) < end(from, length)
        };
        along(self.x, self.width, other.x, other.width) && along(self.y, self.height, other.y, other.height)
    }

    /// Returns whether all pixels of another rectangle are in this one.
    pub fn contains(self, other: PixelBox) -> bool {
        let along = |from: i32, length: u32, other_from: i32, other_length: u32| {
            let end = |from: i32, length: u32| i64::from(from) + i64::from(length);
            from <= other_from && end(other_from, other_length) <= end(from, length)
        };
        along(self.x, self.width, other.x, other.width) && along(self.y, self.height, other.y, other.height)
    }

    /// Returns the part inside a picture of this size; `None` if there is none.
    pub fn clipped(self, width: u32, height: u32) -> Option<PixelBox> {
        let along = |from: i32, length: u32, end: u32| {
            let clip = |at: i64| at.clamp(0, i64::from(end));
            let (start, stop) = (clip(from.into()), clip(i64::from(from) + i64::from(length)));
            Some((
                i32::try_from(start).ok()?,
                u32::try_from(stop - start).ok().filter(|&length| length > 0)?,
            ))
        };
        let ((x, width), (y, height)) = (along(self.x, self.width, width)?, along(self.y, self.height, height)?);
        Some(PixelBox { x, y, width, height })
    }
}

/// The pixels of an agent itself, without shadow or marks: those where its icon is at least half opaque.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Silhouette {
    /// Their box, relative to the center of the icon; the center if there are no such pixels.
    pub(super) area: PixelBox,
    /// One bit per pixel of the box, row by row.
    bits: Box<[u64]>,
}

impl Silhouette {
    /// Returns the body with the pixels of the box for which `is_in` returns true, by column and row of the box.
    pub(super) fn new(area: PixelBox, is_in: impl Fn(u32, u32) -> bool) -> Silhouette {
        let mut bits = vec![0; (area.width as usize * area.height as usize).div_ceil(64)];
        for (row, col) in (0..area.height).flat_map(|row| (0..area.width).map(move |col| (row, col))) {
            let bit = row as usize * area.width as usize + col as usize;
            bits[bit / 64] |= u64::from(is_in(col, row)) << (bit % 64);
        }
        Silhouette {
            area,
            bits: bits.into(),
        }
    }

    /// Returns whether a pixel belongs to the body, by its place relative to the center.
    pub(super) fn contains(&self, x: i32, y: i32) -> bool {
        let PixelBox {
            x: left,
            y: top,
            width,
            height,
        } = self.area;
        let (col, row) = (
            x.wrapping_sub(left).cast_unsigned(),
            y.wrapping_sub(top).cast_unsigned(),
        );
        let bit = row as usize * width as usize + col as usize;
        col < width && row < height && self.bits[bit / 64] >> (bit % 64) & 1 == 1
    }

    /// Returns its size in memory, in bytes.
    pub(super) fn bytes(&self) -> usize {
        size_of::<Silhouette>() + size_of_val(&*self.bits)
    }
}

/// An icon of one size and facing, centered on the origin.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Stamp {
    /// The area of the pixels, relative to the center.
    pub(super) area: PixelBox,
    /// The pixels of the agent itself, without shadow or marks.
    pub(super) body: Arc<Silhouette>,
    /// Premultiplied RGBA, row by row.
    pub(super) pixels: Vec<u8>,
}

/// Red, green and blue.
pub(super) type Rgb = [u8; 3];

/// An RGB picture, row by row.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Picture {
    width: u32,
    height: u32,
    pixels: Vec<u8>,
}

impl Picture {
    /// Returns a picture of one color.
    pub(super) fn new(width: u32, height: u32, rgb: Rgb) -> Picture {
        Picture {
            width,
            height,
            pixels: rgb.repeat(width as usize * height as usize),
        }
    }

    /// Returns a picture of the given RGB bytes.
    pub(super) fn from_pixels(width: u32, height: u32, pixels: Vec<u8>) -> Picture {
        debug_assert_eq!(pixels.len(), 3 * width as usize * height as usize);
        Picture { width, height, pixels }
    }

    /// Returns the width in pixels.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Returns the height in pixels.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// Returns three bytes per pixel, `width` x `height` pixels, the top row first.
    pub fn pixels(&self) -> &[u8] {
        &self.pixels
    }

    /// Returns the bytes without a copy.
    pub fn into_pixels(self) -> Vec<u8> {
        self.pixels
    }

    /// Copies another picture and reuses this one's memory.
    pub(super) fn copy_from(&mut self, other: &Picture) {
        (self.width, self.height) = (other.width, other.height);
        self.pixels.clone_from(&other.pixels);
    }

    /// Returns the columns and rows of a rectangle that are on the picture.
    fn clip(&self, area: PixelBox) -> Option<(usize, usize, usize, usize)> {
        let PixelBox { x, y, width, height } = area.clipped(self.width, self.height)?;
        Some((
            x.cast_unsigned() as usize,
            y.cast_unsigned() as usize,
            width as usize,
            height as usize,
        ))
    }

    pub(super) fn pixel_mut(&mut self, x: usize, y: usize) -> &mut [u8] {
        let at = 3 * (y * self.width as usize + x);
        &mut self.pixels[at..at + 3]
    }

    /// Fills the part of a rectangle that is on the picture.
    pub(super) fn fill(&mut self, area: PixelBox, rgb: Rgb) {
        let Some((left, top, width, height)) = self.clip(area) else {
            return;
        };
        for row in top..top + height {
            let start = 3 * (row * self.width as usize + left);
            for pixel in self.pixels[start..start + 3 * width].as_chunks_mut::<3>().0 {
                *pixel = rgb;
            }
        }
    }

    /// Copies a rectangle from another picture of the same size; both contain it.
    pub(super) fn copy_area(&mut self, other: &Picture, area: PixelBox) {
        let Some((left, top, width, height)) = self.clip(area) else {
            return;
        };
        for row in top..top + height {
            let start = 3 * (row * self.width as usize + left);
            self.pixels[start..start + 3 * width].copy_from_slice(&other.pixels[start..start + 3 * width]);
        }
    }

    /// Copies a picture onto a part of this one.
    pub(super) fn lay(&mut self, other: &Picture, x: i32, y: i32) {
        let area = PixelBox {
            x,
            y,
            width: other.width,
            height: other.height,
        };
        let Some((left, top, width, height)) = self.clip(area) else {
            return;
        };
        let (skip_x, skip_y) = (skipped(left, x), skipped(top, y));
        for row in 0..height {
            let to = 3 * ((top + row) * self.width as usize + left);
            let from = 3 * ((skip_y + row) * other.width as usize + skip_x);
            self.pixels[to..to + 3 * width].copy_from_slice(&other.pixels[from..from + 3 * width]);
        }
    }

    /// Blends an icon onto the picture, centered on a place.
    pub(super) fn stamp(&mut self, stamp: &Stamp, x: i32, y: i32) {
        let area = PixelBox {
            x: x.saturating_add(stamp.area.x),
            y: y.saturating_add(stamp.area.y),
            ..stamp.area
        };
        self.blend(area, &stamp.pixels);
    }

    /// Blends a rectangle of premultiplied RGBA onto the picture.
    pub(super) fn blend(&mut self, area: PixelBox, pixels: &[u8]) {
        let Some((left, top, width, height)) = self.clip(area) else {
            return;
        };
        let (skip_x, skip_y) = (skipped(left, area.x), skipped(top, area.y));
        for row in 0..height {
            let to = 3 * ((top + row) * self.width as usize + left);
            let from = 4 * ((skip_y + row) * area.width as usize + skip_x);
            let below = self.pixels[to..to + 3 * width].as_chunks_mut::<3>().0;
            let over = pixels[from..from + 4 * width].as_chunks::<4>().0;
            for (below, &[r, g, b, alpha]) in below.iter_mut().zip(over) {
                match alpha {
                    0 => {}
                    255 => *below = [r, g, b],
                    _ => {
                        let rest = 255 - u32::from(alpha);
                        for (below, over) in below.iter_mut().zip([r, g, b]) {
                            // At most 255, because no channel exceeds the opacity.
                            *below = over + ((u32::from(*below) * rest + 127) / 255) as u8;
                        }
                    }
                }
            }
        }
    }

    /// Draws one line of text; `x` is its left edge, center or right edge and `y` its middle.
    pub(super) fn text(&mut self, text: &str, (x, y): (i32, i32), font: &MonoFont<'_>, rgb: Rgb, align: Alignment) {
        let style = TextStyleBuilder::new()
            .alignment(align)
            .baseline(Baseline::Middle)
            .build();
        let color = MonoTextStyle::new(font, Rgb888::new(rgb[0], rgb[1], rgb[2]));
        let Ok(_) = Text::with_text_style(text, Point::new(x, y), color, style).draw(&mut Target(self));
    }
}

/// Returns how far a place on the picture is from the start of an overlay, which may be off the picture.
fn skipped(at: usize, start: i32) -> usize {
    (at as i64 - i64::from(start)).unsigned_abs() as usize
}

/// A draw target over [`Picture`]; keeps the drawing crate out of the public interface.
struct Target<'a>(&'a mut Picture);

impl OriginDimensions for Target<'_> {
    fn size(&self) -> Size {
        Size::new(self.0.width, self.0.height)
    }
}

impl DrawTarget for Target<'_> {
    type Color = Rgb888;
    type Error = Infallible;

    fn draw_iter<I: IntoIterator<Item = Pixel<Rgb888>>>(&mut self, pixels: I) -> Result<(), Infallible> {
        let (width, height) = (self.0.width as usize, self.0.height as usize);
        for Pixel(Point { x, y }, color) in pixels {
            if let (Ok(x), Ok(y)) = (usize::try_from(x), usize::try_from(y))
                && x < width
                && y < height
            {
                (self.0.pixel_mut(x, y)).copy_from_slice(&[color.r(), color.g(), color.b()]);
            }
        }
        Ok(())
    }
}
