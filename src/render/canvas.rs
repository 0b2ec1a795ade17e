//! Pixels, and how to put shapes and text on them.

use super::ink::{Ink, PALETTE};
use embedded_graphics::Pixel;
use embedded_graphics::draw_target::DrawTarget;
use embedded_graphics::geometry::{OriginDimensions, Point, Size};
use embedded_graphics::mono_font::{MonoFont, MonoTextStyle};
use embedded_graphics::prelude::Drawable;
use embedded_graphics::primitives::{Circle, Primitive, PrimitiveStyle, Rectangle};
use embedded_graphics::text::{Alignment, Baseline, Text, TextStyleBuilder};
use std::convert::Infallible;

/// A picture: palette indices, row after row.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Frame {
    width: u16,
    height: u16,
    pixels: Vec<u8>,
}

impl Frame {
    /// A picture of one colour.
    pub(super) fn new(width: u16, height: u16, ink: Ink) -> Frame {
        Frame {
            width,
            height,
            pixels: vec![ink.0; usize::from(width) * usize::from(height)],
        }
    }

    /// Width in pixels.
    pub fn width(&self) -> u16 {
        self.width
    }

    /// Height in pixels.
    pub fn height(&self) -> u16 {
        self.height
    }

    /// The palette indices, `width` x `height`, the top row first.
    pub fn pixels(&self) -> &[u8] {
        &self.pixels
    }

    /// Red, green and blue of each palette index; the same for every frame.
    pub fn palette(&self) -> &'static [[u8; 3]] {
        PALETTE
    }

    /// Fills the part of a rectangle that is on the picture.
    pub(super) fn fill(&mut self, left: i32, top: i32, width: i32, height: i32, ink: Ink) {
        let clip = |from: i32, length: i32, end: u16| {
            let at = |position: i32| position.clamp(0, i32::from(end)) as usize;
            at(from)..at(from.saturating_add(length.max(0)))
        };
        let columns = clip(left, width, self.width);
        for row in clip(top, height, self.height) {
            let start = row * usize::from(self.width);
            self.pixels[start + columns.start..start + columns.end].fill(ink.0);
        }
    }

    /// A filled circle of odd diameter 2 `radius` + 1.
    pub(super) fn disc(&mut self, x: i32, y: i32, radius: i32, ink: Ink) {
        let diameter = 2 * radius.max(0).unsigned_abs() + 1;
        let Ok(()) = Circle::with_center(Point::new(x, y), diameter)
            .into_styled(PrimitiveStyle::with_fill(ink))
            .draw(&mut Target(self));
    }

    /// One line of text; `x` is its left edge, centre or right edge and `y` its middle.
    pub(super) fn text(&mut self, text: &str, x: i32, y: i32, font: &MonoFont<'_>, ink: Ink, align: Alignment) {
        let style = TextStyleBuilder::new()
            .alignment(align)
            .baseline(Baseline::Middle)
            .build();
        let Ok(_) =
            Text::with_text_style(text, Point::new(x, y), MonoTextStyle::new(font, ink), style).draw(&mut Target(self));
    }
}

/// A frame as something to draw on; apart from [`Frame`] so that the drawing crate stays out of the public interface.
struct Target<'a>(&'a mut Frame);

impl OriginDimensions for Target<'_> {
    fn size(&self) -> Size {
        Size::new(self.0.width.into(), self.0.height.into())
    }
}

impl DrawTarget for Target<'_> {
    type Color = Ink;
    type Error = Infallible;

    fn draw_iter<I: IntoIterator<Item = Pixel<Ink>>>(&mut self, pixels: I) -> Result<(), Infallible> {
        let (width, height) = (usize::from(self.0.width), usize::from(self.0.height));
        for Pixel(Point { x, y }, ink) in pixels {
            if let (Ok(x), Ok(y)) = (usize::try_from(x), usize::try_from(y))
                && x < width
                && y < height
            {
                self.0.pixels[y * width + x] = ink.0;
            }
        }
        Ok(())
    }

    fn fill_solid(&mut self, area: &Rectangle, ink: Ink) -> Result<(), Infallible> {
        let side = |length: u32| i32::try_from(length).unwrap_or(i32::MAX);
        self.0.fill(
            area.top_left.x,
            area.top_left.y,
            side(area.size.width),
            side(area.size.height),
            ink,
        );
        Ok(())
    }
}
