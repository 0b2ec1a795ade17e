//! Light and weather: change the color of every pixel by its place on the map.
//!
//! Each picture has one weather: clear, fog, rain, snow or dusk. Its values are functions of the place, so a part of
//! a picture has the same weather as the whole.

use crate::render::lattice::Lattice;
use crate::render::picture::{Picture, PixelBox, Rgb};
use crate::rng::{Purpose, RngExt, Seed};

impl Purpose {
    /// The light and the weather of a picture.
    pub const WEATHER: Purpose = Purpose::new(17);
}

/// The weather of pictures of one view.
#[derive(Clone, Debug)]
pub(super) struct Weather {
    width: usize,
    /// Light by channel; 256 leaves the color.
    tint: [i32; 3],
    /// Saturation; 256 leaves the color.
    saturation: i32,
    /// The color of the air.
    air: Rgb,
    /// Light of each pixel; 256 leaves the color.
    light: Vec<i16>,
    /// Share of the air in each pixel, 0..=255.
    haze: Vec<u8>,
}

/// The precipitation.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Fall {
    Dry,
    Rain,
    Snow,
}

impl Weather {
    /// Draws the weather of a seed. `noise` is the difficulty, 0..=1. `start` is the place of the first pixel on the
    /// map and `size` the size of the picture, in pixels.
    pub(super) fn drawn(seed: Seed, noise: f32, start: (i64, i64), size: (u32, u32)) -> Weather {
        let mut stream = seed.stream(Purpose::WEATHER, 0, 0);
        #[allow(clippy::cast_possible_truncation)]
        let noise = (noise * 256.0) as i32;
        let lattice = Lattice(stream.random());
        let mut between = |low: i32, high: i32| stream.random_range(low..=high);
        let kind = between(0, 4);
        // Each kind: light, saturation, haze, the color of the air, and what falls.
        let (light, saturation, haze, air, fall) = match kind {
            0 => (
                between(-25, 22),
                between(-10, 50),
                between(0, 20),
                [226, 224, 214],
                Fall::Dry,
            ),
            1 => (
                between(-30, 10),
                between(-140, -60),
                between(70, 125),
                [208, 212, 216],
                Fall::Dry,
            ),
            2 => (
                between(-85, -35),
                between(-110, -50),
                between(35, 70),
                [150, 158, 168],
                Fall::Rain,
            ),
            3 => (
                between(-20, 25),
                between(-120, -60),
                between(50, 90),
                [226, 230, 236],
                Fall::Snow,
            ),
            _ => (
                between(-150, -100),
                between(-120, -70),
                between(10, 40),
                [40, 48, 78],
                Fall::Dry,
            ),
        };
        let warm = between(-30, 30);
        let tint = [warm, between(-12, 12), -warm].map(|channel| 256 + (((light + channel) * noise) >> 8));
        let (width, height) = (size.0 as usize, size.1 as usize);
        let mut weather = Weather {
            width,
            tint,
            saturation: 256 + ((saturation * noise) >> 8),
            air,
            light: Vec::with_capacity(width * height),
            haze: Vec::with_capacity(width * height),
        };
        let haze = (haze * noise) >> 8;
        for y in (start.1..).take(height) {
            for x in (start.0..).take(width) {
                // The shadows of clouds and of what stands beyond the streets.
                let shade = 70 * lattice.wave(x, y, 311, 1) + 70 * lattice.wave(x, y, 97, 2);
                let light = 256 + ((shade * noise) >> 16);
                let swath = haze + ((haze * lattice.wave(x, y, 173, 3)) >> 9);
                let veil = match fall {
                    Fall::Dry => 0,
                    Fall::Rain => rain(lattice, x, y, noise),
                    Fall::Snow => snow(lattice, x, y, noise),
                };
                weather.light.push(i16::try_from(light).unwrap_or(256));
                weather.haze.push(u8::try_from(swath.max(veil)).unwrap_or(255));
            }
        }
        weather
    }

    /// Changes the pixels of a rectangle inside the picture.
    pub(super) fn apply(&self, picture: &mut Picture, area: PixelBox) {
        let (left, top) = (area.x.cast_unsigned() as usize, area.y.cast_unsigned() as usize);
        for y in top..top + area.height as usize {
            for x in left..left + area.width as usize {
                let at = y * self.width + x;
                let pixel = picture.pixel_mut(x, y);
                let [r, g, b] = [0, 1, 2].map(|channel| i32::from(pixel[channel]));
                let gray = (77 * r + 150 * g + 29 * b) >> 8;
                let (light, haze) = (i32::from(self.light[at]), i32::from(self.haze[at]));
                for (channel, value) in [r, g, b].into_iter().enumerate() {
                    let pale = gray + (((value - gray) * self.saturation) >> 8);
                    let lit = (((pale.clamp(0, 255) * self.tint[channel]) >> 8) * light) >> 8;
                    let lit = lit.clamp(0, 255);
                    pixel[channel] = (lit + (((i32::from(self.air[channel]) - lit) * haze) >> 8)).clamp(0, 255) as u8;
                }
            }
        }
    }
}

/// Returns the opacity of a streak of rain, 0..=255, or 0.
fn rain(lattice: Lattice, x: i64, y: i64, noise: i32) -> i32 {
    // Streaks lean: along one, three rows down are one column to the left.
    let lane = x + y.div_euclid(3);
    let offset = i64::from(lattice.hash(lane, 0, 4) % 40);
    let streak = lattice.hash(lane, (y + offset).div_euclid(20), 5);
    let is_on = (streak & 255) as i32 * 9 < noise;
    let opacity = 60 + ((streak >> 8) & 63) as i32;
    if is_on { opacity } else { 0 }
}

/// Returns the opacity of a flake of snow, 0..=255, or 0.
fn snow(lattice: Lattice, x: i64, y: i64, noise: i32) -> i32 {
    const SQUARE: i64 = 13;
    let (col, row) = (x.div_euclid(SQUARE), y.div_euclid(SQUARE));
    let flake = lattice.hash(col, row, 6);
    if (flake & 255) as i32 * 2 >= noise {
        return 0;
    }
    let radius = 1 + i64::from(flake >> 8 & 1) + i64::from(flake >> 9 & 1);
    let middle = |bits: u32| 3 + i64::from(bits & 7);
    let (dx, dy) = (
        x.rem_euclid(SQUARE) - middle(flake >> 12),
        y.rem_euclid(SQUARE) - middle(flake >> 16),
    );
    let inside = dx * dx + dy * dy <= radius * radius;
    if inside { 150 + (flake >> 20 & 63) as i32 } else { 0 }
}
