//! Encodes pictures as PNG and GIF, and decodes PNG.
// Decision: docs/decisions/pictures.md#d048

use crate::render::picture::{Picture, Rgb};
use std::borrow::Cow;
use std::io::{self, Cursor, Write};
use std::time::Duration;

/// Writes a picture as an RGB PNG, with settings that favor decoding and encoding speed over size.
///
/// # Errors
/// Errors of the output.
pub fn write_png(picture: &Picture, out: impl Write) -> io::Result<()> {
    let (width, height) = (picture.width(), picture.height());
    let pixels = picture.pixels();
    write(pixels, (width, height), png::ColorType::Rgb, (png::Filter::Up, 2), out)
}

/// Writes a mask, such as that of [`Placement::mask`](crate::render::Placement::mask), as a grayscale PNG.
///
/// # Errors
/// Errors of the output.
///
/// # Panics
/// If there is not one byte per pixel.
pub fn write_mask(mask: &[u8], (width, height): (u32, u32), out: impl Write) -> io::Result<()> {
    assert_eq!(mask.len(), width as usize * height as usize);
    let settings = (png::Filter::Up, 6);
    write(mask, (width, height), png::ColorType::Grayscale, settings, out)
}

/// Reads a grayscale PNG with eight bits per pixel, of known width and height, into `mask`, row by row.
///
/// # Errors
/// A message if the bytes are not such a PNG, or it has another size.
///
/// # Panics
/// If `mask` does not have one byte per pixel.
pub fn read_mask_into(bytes: &[u8], size: (u32, u32), mask: &mut [u8]) -> Result<(), String> {
    let (reader, found) = begin(bytes, png::ColorType::Grayscale)?;
    check_size(found, size)?;
    assert_eq!(mask.len(), size.0 as usize * size.1 as usize);
    decode(reader, mask)
}

/// Reads an RGB PNG with eight bits per channel.
///
/// # Errors
/// A message if the bytes are not such a PNG, or a side has more than 16,384 pixels.
pub fn read_png(bytes: &[u8]) -> Result<Picture, String> {
    let (reader, (width, height)) = begin(bytes, png::ColorType::Rgb)?;
    if width.max(height) > DECODED_SIDE_MAX {
        return Err(format!(
            "{width} x {height} pixels; no side may have more than {DECODED_SIDE_MAX}"
        ));
    }
    let mut pixels = vec![0; 3 * width as usize * height as usize];
    decode(reader, &mut pixels)?;
    Ok(Picture::from_pixels(width, height, pixels))
}

/// Reads the pixels of such a PNG of known width and height into `pixels`, row by row.
///
/// # Errors
/// A message if the bytes are not such a PNG, or it has another size.
///
/// # Panics
/// If `pixels` does not have three bytes per pixel.
pub fn read_png_into(bytes: &[u8], size: (u32, u32), pixels: &mut [u8]) -> Result<(), String> {
    let (reader, found) = begin(bytes, png::ColorType::Rgb)?;
    check_size(found, size)?;
    assert_eq!(pixels.len(), 3 * size.0 as usize * size.1 as usize);
    decode(reader, pixels)
}

type PngReader<'a> = png::Reader<Cursor<&'a [u8]>>;

/// Reads the header; returns the reader with width and height.
fn begin(bytes: &[u8], colors: png::ColorType) -> Result<(PngReader<'_>, (u32, u32)), String> {
    let reader = png::Decoder::new(Cursor::new(bytes)).read_info().map_err(unreadable)?;
    let info = reader.info();
    if (info.color_type, info.bit_depth) != (colors, png::BitDepth::Eight) {
        let expected = match colors {
            png::ColorType::Rgb => "RGB",
            _ => "grayscale",
        };
        return Err(format!("the pixels are not 8-bit {expected}"));
    }
    let size = info.size();
    Ok((reader, size))
}

fn check_size(found: (u32, u32), expected: (u32, u32)) -> Result<(), String> {
    match found == expected {
        true => Ok(()),
        false => Err(format!(
            "{} x {} pixels instead of {} x {}",
            found.0, found.1, expected.0, expected.1
        )),
    }
}

fn decode(mut reader: PngReader<'_>, pixels: &mut [u8]) -> Result<(), String> {
    reader.next_frame(pixels).map_err(unreadable)?;
    // Reports truncated files.
    reader.finish().map_err(unreadable)
}

fn unreadable(error: png::DecodingError) -> String {
    format!("not a valid PNG: {error}")
}

/// The longest side to decode, in pixels, which bounds the memory for untrusted files.
const DECODED_SIDE_MAX: u32 = 1 << 14;

/// Writes RGBA pixels as a PNG, with settings that favor speed.
pub(super) fn write_rgba(pixels: &[u8], width: u32, height: u32, out: impl Write) -> io::Result<()> {
    let settings = (png::Filter::Up, 2);
    write(pixels, (width, height), png::ColorType::Rgba, settings, out)
}

/// Writes RGBA pixels as a small PNG.
pub(super) fn write_rgba_small(pixels: &[u8], width: u32, height: u32, out: impl Write) -> io::Result<()> {
    let settings = (png::Filter::Adaptive, 9);
    write(pixels, (width, height), png::ColorType::Rgba, settings, out)
}

/// Writes pixels with a filter and a compression level. Decoders undo the Up filter many bytes at a time and the other
/// filters byte by byte; for large pictures, levels above 2 save little.
fn write(
    pixels: &[u8],
    (width, height): (u32, u32),
    colors: png::ColorType,
    (filter, level): (png::Filter, u8),
    out: impl Write,
) -> io::Result<()> {
    let mut encoder = png::Encoder::new(out, width, height);
    encoder.set_color(colors);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_filter(filter);
    encoder.set_deflate_compression(png::DeflateCompression::Level(level));
    let written = encoder.write_header().and_then(|mut writer| {
        writer.write_image_data(pixels)?;
        writer.finish()
    });
    written.map_err(|error| match error {
        png::EncodingError::IoError(error) => error,
        other => io::Error::other(other),
    })
}

/// The index of an unchanged pixel in a frame.
const UNCHANGED: u8 = 255;

/// A palette of at most 255 colors, and the palette entry for each RGB color.
struct Palette {
    colors: Vec<Rgb>,
    /// Palette indices by the upper five bits of red, green and blue.
    nearest: Vec<u8>,
}

/// The mean color of a bin, and its weight.
#[derive(Clone, Copy)]
struct Weighed {
    rgb: Rgb,
    weight: u64,
}

fn bin([r, g, b]: Rgb) -> usize {
    usize::from(r >> 3) << 10 | usize::from(g >> 3) << 5 | usize::from(b >> 3)
}

impl Palette {
    /// Computes the palette of a picture by median cut: splits the most uneven box of colors at its median weight until
    /// there are enough boxes. The result is deterministic.
    fn of(picture: &Picture) -> Palette {
        let mut boxes = vec![ColorBox::new(weighed(picture))];
        while boxes.len() < usize::from(UNCHANGED) {
            let worst = (0..boxes.len()).max_by_key(|&at| (boxes[at].uneven, usize::MAX - at));
            let Some(worst) = worst.filter(|&at| boxes[at].uneven > 0) else {
                break;
            };
            let (low, high) = boxes.swap_remove(worst).cut();
            boxes.extend([low, high]);
        }
        let mut colors: Vec<Rgb> = boxes.iter().map(ColorBox::mean).collect();
        colors.sort_unstable();
        let nearest = (0..1 << 15).map(|bin: usize| {
            let rgb = [bin >> 10, bin >> 5 & 31, bin & 31].map(|part| (part as u8) << 3 | 4);
            let far = |color: &Rgb| -> i32 {
                (0..3)
                    .map(|at| (i32::from(color[at]) - i32::from(rgb[at])).pow(2))
                    .sum()
            };
            let best = colors.iter().enumerate().min_by_key(|(_, color)| far(color));
            best.map_or(0, |(index, _)| index as u8)
        });
        Palette {
            nearest: nearest.collect(),
            colors,
        }
    }

    /// Returns the palette indices of a picture's pixels.
    fn indices(&self, picture: &Picture) -> Vec<u8> {
        picture
            .pixels()
            .as_chunks::<3>()
            .0
            .iter()
            .map(|&rgb| self.nearest[bin(rgb)])
            .collect()
    }
}

/// Returns the colors of a picture, one per bin. Caps the weight of frequent colors, because icons are small and the
/// ground is large.
fn weighed(picture: &Picture) -> Vec<Weighed> {
    let mut bins = vec![([0_u64; 3], 0_u64); 1 << 15];
    for rgb in picture.pixels().as_chunks::<3>().0 {
        let (sum, count) = &mut bins[bin(*rgb)];
        *count += 1;
        for (sum, &channel) in sum.iter_mut().zip(rgb) {
            *sum += u64::from(channel);
        }
    }
    let present = bins.into_iter().filter(|&(_, count)| count > 0);
    present
        .map(|(sum, count)| Weighed {
            rgb: sum.map(|sum| (sum / count) as u8),
            weight: count.isqrt().clamp(1, 200),
        })
        .collect()
}

/// A box of colors in median cut.
struct ColorBox {
    colors: Vec<Weighed>,
    weight: u64,
    /// The channel with the widest range.
    channel: usize,
    /// The range in that channel times the weight.
    uneven: u64,
}

impl ColorBox {
    fn new(colors: Vec<Weighed>) -> ColorBox {
        let width = |channel: usize| {
            let values = || colors.iter().map(|color| u64::from(color.rgb[channel]));
            values().max().unwrap_or(0) - values().min().unwrap_or(0)
        };
        let widths = [0, 1, 2].map(width);
        let channel = (0..3).rev().max_by_key(|&channel| widths[channel]).unwrap_or(0);
        let weight = colors.iter().map(|color| color.weight).sum();
        ColorBox {
            uneven: widths[channel] * weight,
            colors,
            weight,
            channel,
        }
    }

    /// Splits the box into two of about equal weight. The box must have at least two colors.
    fn cut(self) -> (ColorBox, ColorBox) {
        let mut low = self.colors;
        low.sort_by_key(|color| (color.rgb[self.channel], color.rgb));
        let mut sum = 0;
        let half = low.iter().position(|color| {
            sum += color.weight;
            2 * sum >= self.weight
        });
        let high = low.split_off((half.unwrap_or(0) + 1).clamp(1, low.len() - 1));
        (ColorBox::new(low), ColorBox::new(high))
    }

    fn mean(&self) -> Rgb {
        [0, 1, 2].map(|channel| {
            let weighted = |color: &Weighed| u64::from(color.rgb[channel]) * color.weight;
            let sum: u64 = self.colors.iter().map(weighted).sum();
            ((sum + self.weight / 2) / self.weight.max(1)) as u8
        })
    }
}

/// A writer of GIF animations that loop.
///
/// All frames share one palette, computed from a sample. The first frame is complete; each later frame is the smallest
/// rectangle with all changes, in which unchanged pixels are transparent.
pub struct Animation<W: Write> {
    encoder: gif::Encoder<W>,
    palette: Palette,
    /// The pixels that a viewer shows now; empty before the first frame.
    shown: Vec<u8>,
    size: (u16, u16),
    /// The delay in hundredths of a second.
    delay: u16,
}

impl<W: Write> Animation<W> {
    /// Begins an animation of pictures with the size and roughly the colors of `sample`. GIF rounds `frame_delay` to
    /// hundredths of a second, at most 655.35 s. Many viewers slow delays under 0.02 s down to 0.1 s.
    ///
    /// # Errors
    /// Errors of the output, and `InvalidInput` for a side of more than 65,535 pixels.
    pub fn new(out: W, sample: &Picture, frame_delay: Duration) -> io::Result<Animation<W>> {
        let side = |length: u32| u16::try_from(length).map_err(|_| wrong("a side has more than 65,535 pixels"));
        let size = (side(sample.width())?, side(sample.height())?);
        let palette = Palette::of(sample);
        let mut encoder = gif::Encoder::new(out, size.0, size.1, palette.colors.as_flattened()).map_err(to_io)?;
        encoder.set_repeat(gif::Repeat::Infinite).map_err(to_io)?;
        let hundredths = (frame_delay.as_millis() + 5) / 10;
        Ok(Animation {
            encoder,
            palette,
            shown: Vec::new(),
            size,
            delay: u16::try_from(hundredths).unwrap_or(u16::MAX),
        })
    }

    /// Appends a frame.
    ///
    /// # Errors
    /// Errors of the output, and `InvalidInput` for a picture of another size than the sample.
    pub fn push(&mut self, picture: &Picture) -> io::Result<()> {
        if (picture.width(), picture.height()) != (self.size.0.into(), self.size.1.into()) {
            return Err(wrong("the frames of an animation must have the same size"));
        }
        let pixels = self.palette.indices(picture);
        let mut image = if self.shown.is_empty() {
            gif::Frame {
                width: self.size.0,
                height: self.size.1,
                buffer: Cow::Borrowed(&pixels),
                ..gif::Frame::default()
            }
        } else {
            difference(&self.shown, &pixels, self.size.0.into())
        };
        image.delay = self.delay;
        image.dispose = gif::DisposalMethod::Keep;
        self.encoder.write_frame(&image).map_err(to_io)?;
        drop(image);
        self.shown = pixels;
        Ok(())
    }

    /// Ends the file and returns the output, which is not flushed.
    ///
    /// # Errors
    /// Errors of the output.
    pub fn finish(self) -> io::Result<W> {
        self.encoder.into_inner().map_err(to_io)
    }
}

fn wrong(message: &str) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidInput, message)
}

/// Returns the frame that turns the pixels `old` into `new`, both of this width and of equal height. Without a change
/// it is one transparent pixel, because a GIF frame must not be empty.
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
                .map(|(a, b)| if a == b { UNCHANGED } else { *b }),
        );
    }
    // Each value is at most a side of the frame, which fits a u16.
    gif::Frame {
        left: columns.start as u16,
        top: rows.start as u16,
        width: columns.len() as u16,
        height: rows.len() as u16,
        buffer: Cow::Owned(buffer),
        transparent: Some(UNCHANGED),
        ..gif::Frame::default()
    }
}

fn to_io(error: gif::EncodingError) -> io::Error {
    match error {
        gif::EncodingError::Io(error) => error,
        other => io::Error::other(other),
    }
}
