//! Frames to PNG and GIF.

use super::canvas::Frame;
use super::ink::{Ink, PALETTE};
use super::painter::Painter;
use std::borrow::Cow;
use std::io::{self, Write};
use std::time::Duration;

/// Writes a frame as an indexed PNG.
///
/// # Errors
/// Those of the output.
pub fn write_png(frame: &Frame, out: impl Write) -> io::Result<()> {
    let mut encoder = png::Encoder::new(out, frame.width().into(), frame.height().into());
    encoder.set_color(png::ColorType::Indexed);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_palette(frame.palette().as_flattened());
    // Neighbouring palette indices are unrelated numbers: a filter only hides the repetition from the compressor.
    encoder.set_compression(png::Compression::Balanced);
    encoder.set_filter(png::Filter::NoFilter);
    let written = encoder.write_header().and_then(|mut writer| {
        writer.write_image_data(frame.pixels())?;
        writer.finish()
    });
    written.map_err(|error| match error {
        png::EncodingError::IoError(error) => error,
        other => io::Error::other(other),
    })
}

/// A GIF being written; it repeats for ever.
///
/// The first frame is stored whole, each later one as the smallest rectangle that holds all changes, with the unchanged
/// pixels in it transparent. A viewer shows exactly the frames that were pushed.
pub struct Animation<W: Write> {
    encoder: gif::Encoder<W>,
    /// The pixels that a viewer shows now; empty before the first frame.
    shown: Vec<u8>,
    size: (u16, u16),
    /// In hundredths of a second.
    delay: u16,
}

impl<W: Write> Animation<W> {
    /// Begins an animation of the frames of a painter, each shown for `frame_delay`: GIF rounds it to hundredths of a
    /// second, at most 655.35 s. Many viewers slow delays under 0.02 s down to 0.1 s.
    pub fn new(out: W, painter: &Painter, frame_delay: Duration) -> io::Result<Animation<W>> {
        let size = painter.size();
        let mut encoder = gif::Encoder::new(out, size.0, size.1, PALETTE.as_flattened()).map_err(to_io)?;
        encoder.set_repeat(gif::Repeat::Infinite).map_err(to_io)?;
        let hundredths = (frame_delay.as_millis() + 5) / 10;
        Ok(Animation {
            encoder,
            shown: Vec::new(),
            size,
            delay: u16::try_from(hundredths).unwrap_or(u16::MAX),
        })
    }

    /// Appends a frame.
    ///
    /// # Errors
    /// Those of the output, and `InvalidInput` for a frame of another size than the painter's.
    pub fn push(&mut self, frame: &Frame) -> io::Result<()> {
        if (frame.width(), frame.height()) != self.size {
            return Err(io::Error::new(
                io::ErrorKind::InvalidInput,
                "the frames of an animation must have one size",
            ));
        }
        let mut image = if self.shown.is_empty() {
            gif::Frame {
                width: frame.width(),
                height: frame.height(),
                buffer: Cow::Borrowed(frame.pixels()),
                ..gif::Frame::default()
            }
        } else {
            difference(&self.shown, frame.pixels(), frame.width().into())
        };
        image.delay = self.delay;
        image.dispose = gif::DisposalMethod::Keep;
        self.encoder.write_frame(&image).map_err(to_io)?;
        self.shown.clear();
        self.shown.extend_from_slice(frame.pixels());
        Ok(())
    }

    /// Ends the file and hands the output back, not flushed.
    pub fn finish(self) -> io::Result<W> {
        self.encoder.into_inner().map_err(to_io)
    }
}

/// What turns the pixels `old` into `new`, both of this width and one height. Without a difference: one transparent
/// pixel, since a GIF frame is never empty.
fn difference(old: &[u8], new: &[u8], width: usize) -> gif::Frame<'static> {
    let mut rows = 0..0;
    let mut columns = width..0;
    let pairs = || old.chunks_exact(width).zip(new.chunks_exact(width));
    for (row, (before, after)) in pairs().enumerate().filter(|(_, (before, after))| before != after) {
        let differs = |(a, b): (&u8, &u8)| a != b;
        let first = before.iter().zip(after).position(differs).unwrap_or(0);
        let last = before.iter().zip(after).rposition(differs).unwrap_or(0);
        columns = columns.start.min(first)..columns.end.max(last + 1);
        rows = if rows.is_empty() {
            row..row + 1
        } else {
            rows.start..row + 1
        };
    }
    if rows.is_empty() {
        (rows, columns) = (0..1, 0..1);
    }
    let mut buffer = Vec::with_capacity(rows.len() * columns.len());
    for (before, after) in pairs().skip(rows.start).take(rows.len()) {
        let (before, after) = (&before[columns.clone()], &after[columns.clone()]);
        buffer.extend(
            before
                .iter()
                .zip(after)
                .map(|(a, b)| if a == b { Ink::UNCHANGED.0 } else { *b }),
        );
    }
    // Every one of these is at most a side of the frame, which is a u16.
    gif::Frame {
        left: columns.start as u16,
        top: rows.start as u16,
        width: columns.len() as u16,
        height: rows.len() as u16,
        buffer: Cow::Owned(buffer),
        transparent: Some(Ink::UNCHANGED.0),
        ..gif::Frame::default()
    }
}

fn to_io(error: gif::EncodingError) -> io::Error {
    match error {
        gif::EncodingError::Io(error) => error,
        other => io::Error::other(other),
    }
}
