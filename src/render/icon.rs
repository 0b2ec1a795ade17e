//! Icons: from a class, an instance, a facing and a size to pixels.

use super::class::{Class, Facing, Subject};
use super::pack::{Mode, Pack, shrunk};
use super::sketch::{Dice, Ink, Sketch, byte};
use super::{building, car, pedestrian};
use crate::config::AgentKind;
use crate::rng::{Purpose, Rng, Seed};
use resvg::tiny_skia::{FilterQuality, Pixmap, PixmapPaint, Transform};
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

/// How hard icons are to tell apart, in percent: 0 is clean; the higher, the more their colours, light, sharpness and markings vary and
/// the more lies on and around them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Difficulty(u8);

impl Difficulty {
    /// Nothing but the class and the instance differ.
    pub const CLEAN: Difficulty = Difficulty(0);
    /// The hardest.
    pub const NOISY: Difficulty = Difficulty(100);

    /// From 0 to 100 percent; `None` above.
    pub const fn percent(percent: u8) -> Option<Difficulty> {
        if percent > 100 { None } else { Some(Difficulty(percent)) }
    }

    /// 0..=1.
    pub(super) fn share(self) -> f32 {
        f32::from(self.0) / 100.0
    }
}

/// The largest icon: the short side of a car, the side of a pedestrian or building, in pixels.
pub const ICON_MAX: u32 = 512;

/// Instances of a class that are drawn, not taken from a pack.
const DRAWN: u32 = 100;

/// Kept icons take at most about this much memory, in bytes.
const KEPT: usize = 64 << 20;

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
    /// The part inside a picture of that size; `None` if there is none.
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

/// An icon of one size and facing: pixels around a middle.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Stamp {
    /// What its pixels cover, relative to the middle.
    pub(super) area: PixelBox,
    /// What the agent itself covers, without shadow and the like, relative to the middle.
    pub(super) body: PixelBox,
    /// Red, green, blue, each times opacity, and opacity; row after row.
    pub(super) pixels: Vec<u8>,
}

type Key = (Class, u32, Facing, u32);

/// All icons there are: drawn by parameters, from a pack, or both. Each is a function of seed, difficulty, pack, class, instance, facing
/// and size; what has been drawn once is kept for a while. Several threads can share one.
#[derive(Debug)]
pub struct Icons {
    seed: Seed,
    difficulty: Difficulty,
    pack: Option<Pack>,
    kept: Mutex<(BTreeMap<Key, Arc<Stamp>>, usize)>,
}

impl Default for Icons {
    fn default() -> Self {
        Icons::new(Seed(0), Difficulty::CLEAN)
    }
}

impl Icons {
    /// Icons that are drawn.
    pub fn new(seed: Seed, difficulty: Difficulty) -> Icons {
        Icons {
            seed,
            difficulty,
            pack: None,
            kept: Mutex::default(),
        }
    }

    /// The same with a pack beside or instead of what is drawn.
    #[must_use]
    pub fn with_pack(self, pack: Pack) -> Icons {
        Icons {
            pack: Some(pack),
            kept: Mutex::default(),
            ..self
        }
    }

    /// The seed of everything random in the drawings.
    pub fn seed(&self) -> Seed {
        self.seed
    }

    /// The difficulty.
    pub fn difficulty(&self) -> Difficulty {
        self.difficulty
    }

    /// How many instances of a class there are before they repeat.
    pub fn instances(&self, class: &Class) -> u32 {
        let art = self.art(class);
        #[allow(clippy::cast_possible_truncation)]
        let count = art.len() as u32;
        match self.pack.as_ref().map(Pack::mode) {
            Some(Mode::Replace) if count > 0 => count,
            _ => count + DRAWN,
        }
    }

    fn art(&self, class: &Class) -> &[Pixmap] {
        self.pack.as_ref().map_or(&[], |pack| pack.of(class))
    }

    /// An icon. Instances are counted from 0 and repeat after [`Icons::instances`]. The size is the short side of a car and the side of a
    /// pedestrian or building in pixels, 1 to [`ICON_MAX`]; others are brought into that range.
    pub fn stamp(&self, class: &Class, instance: u32, facing: Facing, size: u32) -> Arc<Stamp> {
        let size = size.clamp(1, ICON_MAX);
        let key = (class.clone(), instance % self.instances(class), facing, size);
        let lock = || self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(stamp) = lock().0.get(&key) {
            return Arc::clone(stamp);
        }
        let stamp = Arc::new(self.draw(class, instance, facing, size));
        let mut kept = lock();
        if kept.1 > KEPT {
            *kept = Default::default();
        }
        kept.1 += stamp.pixels.len();
        kept.0.insert(key, Arc::clone(&stamp));
        stamp
    }

    /// An icon, drawn anew.
    pub(super) fn draw(&self, class: &Class, instance: u32, facing: Facing, size: u32) -> Stamp {
        let instance = instance % self.instances(class);
        let name = class.to_string();
        // FNV-1a: stable for ever, unlike the hasher of the standard library.
        let hash = name.bytes().fold(0xcbf2_9ce4_8422_2325_u64, |hash, byte| {
            (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3)
        });
        let mut dice = Dice(self.seed.stream(Purpose::Icon, hash, instance.into()));
        let noise = self.difficulty.share();
        let art = self.art(class).get(instance as usize);
        let layers = match (&class.0, art) {
            (_, Some(art)) => Layers::of_art(art, class, facing, size),
            (Subject::Building(building), None) => {
                let sketch = building::draw(*building, &mut dice, noise);
                Layers::square(size, |on, transform| sketch.paint(on, transform))
            }
            (Subject::Agent(AgentKind::Pedestrian, concepts), None) => {
                let (_, features) = Class::features(concepts);
                let mut sketch = pedestrian::draw(&features, facing.side(), &mut dice, noise);
                badges(&mut sketch, AgentKind::Pedestrian, concepts, (0.0, 0.12), 0.14);
                Layers::square(size, |on, transform| sketch.paint(on, transform))
            }
            (Subject::Agent(AgentKind::Car, concepts), None) => {
                let (features, _) = Class::features(concepts);
                let mut car = car::draw(&features, &mut dice, noise);
                badges(&mut car.body, AgentKind::Car, concepts, (0.0, 0.36 * car.length), 0.19);
                Layers::of_car(&car, facing, size)
            }
        };
        let is_agent = matches!(class.0, Subject::Agent(..));
        layers.finish(&mut dice, noise, size, is_agent)
    }

    /// An icon as a square PNG with transparent ground, the whole of it fitted into `side` pixels, 1 to [`ICON_MAX`].
    pub fn png(&self, class: &Class, instance: u32, facing: Facing, side: u32) -> Vec<u8> {
        let side = side.clamp(1, ICON_MAX);
        let reach = |stamp: &Stamp| {
            let PixelBox { x, y, width, height } = stamp.area;
            let far = |from: i32, length: u32| {
                from.unsigned_abs()
                    .max((i64::from(from) + i64::from(length)).unsigned_abs() as u32)
            };
            2 * far(x, width).max(far(y, height))
        };
        let mut size = side;
        let mut stamp = self.stamp(class, instance, facing, size);
        while reach(&stamp) > side && size > 1 {
            size = (size * side / reach(&stamp)).clamp(1, size - 1);
            stamp = self.stamp(class, instance, facing, size);
        }
        let mut pixels = vec![0; 4 * (side * side) as usize];
        #[allow(clippy::cast_possible_wrap)]
        let half = (side / 2) as i32;
        for (row, line) in stamp.pixels.chunks_exact(4 * stamp.area.width as usize).enumerate() {
            for (col, pixel) in line.chunks_exact(4).enumerate() {
                let at = |from: i32, offset: usize| usize::try_from(from + half).ok().map(|start| start + offset);
                let (Some(y), Some(x)) = (at(stamp.area.y, row), at(stamp.area.x, col)) else {
                    continue;
                };
                if x < side as usize && y < side as usize {
                    let alpha = u32::from(pixel[3]);
                    let straight = |channel: u8| match alpha {
                        0 => 0,
                        alpha => ((u32::from(channel) * 255 + alpha / 2) / alpha).min(255) as u8,
                    };
                    let rgba = [straight(pixel[0]), straight(pixel[1]), straight(pixel[2]), pixel[3]];
                    pixels[4 * (y * side as usize + x)..][..4].copy_from_slice(&rgba);
                }
            }
        }
        let mut bytes = Vec::new();
        super::encode::write_rgba(&pixels, side, side, &mut bytes).expect("a vector takes all that is written");
        bytes
    }
}

/// A round badge with a letter for each concept without looks of its own, its colour by the name.
fn badges(sketch: &mut Sketch, kind: AgentKind, concepts: &[String], (x, y): (f32, f32), radius: f32) {
    let others = concepts.iter().filter(|concept| !Class::is_drawn(kind, concept));
    for (number, concept) in (0_u8..3).zip(others) {
        let sum = concept
            .bytes()
            .fold(7_u32, |sum, byte| sum.wrapping_mul(31).wrapping_add(byte.into()));
        #[allow(clippy::cast_precision_loss)]
        let ink = Ink::hsl((sum % 17) as f32 / 17.0, 0.85, 0.42);
        let y = y - f32::from(number) * 2.1 * radius;
        sketch.oval(x, y, radius, radius, Ink::WHITE);
        sketch.oval(x, y, radius * 0.88, radius * 0.88, ink);
        let letter: String = concept.chars().take(1).flat_map(char::to_uppercase).collect();
        sketch.letters(&letter, (x, y), radius * 0.95, radius * 0.24, Ink::WHITE);
    }
}

/// An icon before light and shadow: what lies below it, and itself, both around the middle of pixmaps of one size.
struct Layers {
    ground: Pixmap,
    body: Pixmap,
}

/// An empty pixmap that holds what reaches so many pixels from the middle, with room for a shadow, and the transformation that moves the
/// origin to its middle.
fn canvas(reach: f32) -> (Pixmap, Transform) {
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    let half = reach.max(1.0).ceil() as u32 + 4;
    let pixmap = Pixmap::new(2 * half, 2 * half).expect("icons are bounded");
    #[allow(clippy::cast_precision_loss)]
    let middle = half as f32;
    (pixmap, Transform::from_translate(middle, middle))
}

fn turned(facing: Facing, scale: f32) -> Transform {
    let (sine, cosine) = facing.turn();
    Transform::from_row(cosine * scale, sine * scale, -sine * scale, cosine * scale, 0.0, 0.0)
}

#[allow(clippy::cast_precision_loss)]
impl Layers {
    /// What fills a square of that side.
    fn square(size: u32, paint: impl FnOnce(&mut Pixmap, Transform)) -> Layers {
        let (mut body, middle) = canvas(size as f32 * 0.75);
        // An odd side begins half a pixel before the middle's corner, as the cells it lies on do.
        let half = if size % 2 == 1 { 0.5 } else { 0.0 };
        let scale = Transform::from_scale(size as f32, size as f32);
        paint(&mut body, scale.post_concat(middle).post_translate(half, half));
        let ground = Pixmap::new(body.width(), body.height()).expect("as large as the other");
        Layers { ground, body }
    }

    fn of_car(car: &car::Drawing, facing: Facing, size: u32) -> Layers {
        let reach = size as f32 * (car.length / 2.0 + 1.0);
        let (mut body, middle) = canvas(reach);
        let (mut ground, _) = canvas(reach);
        let transform = turned(facing, size as f32).post_concat(middle);
        car.ground.paint(&mut ground, transform);
        car.body.paint(&mut body, transform);
        Layers { ground, body }
    }

    /// A car's short side has the size; others fit into a square.
    fn of_art(art: &Pixmap, class: &Class, facing: Facing, size: u32) -> Layers {
        let (width, height) = (art.width() as f32, art.height() as f32);
        let turns = matches!(class.0, Subject::Agent(AgentKind::Car, _));
        let scale = size as f32 / if turns { width.min(height) } else { width.max(height) };
        let (wide, high) = (width * scale, height * scale);
        let (mut body, middle) = canvas((wide * wide + high * high).sqrt() / 2.0);
        let mirrored = !turns && facing.side() == pedestrian::Side::Left && !matches!(class.0, Subject::Building(_));
        let turn = match (turns, mirrored) {
            (true, _) => turned(facing, 1.0),
            (false, true) => Transform::from_scale(-1.0, 1.0),
            (false, false) => Transform::identity(),
        };
        let transform = Transform::from_translate(-wide / 2.0, -high / 2.0)
            .post_concat(turn)
            .post_concat(middle);
        let side = |length: f32| u32::from(length.round().max(1.0) as u16);
        let small = shrunk(art, side(wide), side(high));
        let (rest_x, rest_y) = (wide / small.width() as f32, high / small.height() as f32);
        let paint = PixmapPaint {
            quality: if rest_x > 1.5 {
                FilterQuality::Bicubic
            } else {
                FilterQuality::Bilinear
            },
            ..PixmapPaint::default()
        };
        let transform = transform.pre_scale(rest_x, rest_y);
        body.draw_pixmap(0, 0, small.as_ref(), &paint, transform, None);
        let ground = Pixmap::new(body.width(), body.height()).expect("as large as the other");
        Layers { ground, body }
    }

    /// Adds what the difficulty adds, and a shadow, and cuts off what is empty.
    fn finish<R: Rng>(mut self, dice: &mut Dice<R>, noise: f32, size: u32, shadow: bool) -> Stamp {
        let (width, height) = (self.body.width(), self.body.height());
        let body = bounds(&self.body, 128).unwrap_or((width / 2, height / 2, width / 2 + 1, height / 2 + 1));
        if noise > 0.0 {
            disturb(&mut self.body, dice, noise, size);
        }
        let mut all = self.ground;
        if shadow {
            let (dx, dy) = (
                dice.between(0.03, 0.06 + 0.08 * noise),
                dice.between(0.04, 0.08 + 0.08 * noise),
            );
            let opacity = dice.between(0.3, 0.4 + 0.2 * noise);
            let offset = |share: f32| (share * size as f32).round() as i32;
            let mut shade = self.body.clone();
            for pixel in shade.data_mut().chunks_exact_mut(4) {
                pixel.copy_from_slice(&[0, 0, 0, byte(f32::from(pixel[3]) * opacity)]);
            }
            let paint = PixmapPaint::default();
            all.draw_pixmap(
                offset(dx),
                offset(dy),
                shade.as_ref(),
                &paint,
                Transform::identity(),
                None,
            );
        }
        all.draw_pixmap(
            0,
            0,
            self.body.as_ref(),
            &PixmapPaint::default(),
            Transform::identity(),
            None,
        );
        let (left, top, right, bottom) = bounds(&all, 1).unwrap_or(body);
        let mut pixels = Vec::with_capacity(4 * ((right - left) * (bottom - top)) as usize);
        for row in top..bottom {
            let start = 4 * (row * width + left) as usize;
            pixels.extend_from_slice(&all.data()[start..start + 4 * (right - left) as usize]);
        }
        let around = |(left, top, right, bottom): (u32, u32, u32, u32)| PixelBox {
            x: left.cast_signed() - (width / 2).cast_signed(),
            y: top.cast_signed() - (height / 2).cast_signed(),
            width: right - left,
            height: bottom - top,
        };
        Stamp {
            area: around((left, top, right, bottom)),
            body: around(body),
            pixels,
        }
    }
}

/// Where a pixmap is at least so opaque: left, top, right, bottom, the last two exclusive.
fn bounds(pixmap: &Pixmap, least: u8) -> Option<(u32, u32, u32, u32)> {
    let mut found: Option<(u32, u32, u32, u32)> = None;
    for (pixel, at) in pixmap.data().chunks_exact(4).zip(0_u32..) {
        if pixel[3] >= least {
            let (x, y) = (at % pixmap.width(), at / pixmap.width());
            found = Some(found.map_or((x, y, x + 1, y + 1), |(left, top, right, bottom)| {
                (left.min(x), top.min(y), right.max(x + 1), bottom.max(y + 1))
            }));
        }
    }
    found
}

/// Changes colours, light and sharpness, and adds grain.
#[allow(clippy::cast_precision_loss)]
fn disturb<R: Rng>(pixmap: &mut Pixmap, dice: &mut Dice<R>, noise: f32, size: u32) {
    let tint = [0; 3].map(|_| 1.0 + noise * dice.between(-0.22, 0.22));
    let light = 1.0 + noise * dice.between(-0.35, 0.25);
    let slope = [0; 2].map(|_| noise * dice.between(-0.45, 0.45));
    let grain = noise * dice.between(4.0, 22.0);
    let width = pixmap.width();
    let side = size.max(1) as f32;
    let middle = width as f32 / 2.0;
    for (pixel, at) in pixmap.data_mut().chunks_exact_mut(4).zip(0_u32..) {
        if pixel[3] == 0 {
            continue;
        }
        let along = |at: u32| (at as f32 - middle) / side;
        let shade = light + slope[0] * along(at % width) + slope[1] * along(at / width);
        let rough = grain * dice.between(-1.0, 1.0) * f32::from(pixel[3]) / 255.0;
        for (channel, tint) in [0, 1, 2].into_iter().zip(tint) {
            // No channel of a colour times its opacity exceeds the opacity.
            pixel[channel] = byte(f32::from(pixel[channel]) * shade.max(0.2) * tint + rough).min(pixel[3]);
        }
    }
    let radius = (noise * dice.between(0.0, 0.045) * side).round();
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    blur(pixmap, radius as usize);
}

/// Every pixel becomes the mean of those up to `radius` to its sides, first along rows, then along columns.
fn blur(pixmap: &mut Pixmap, radius: usize) {
    if radius == 0 {
        return;
    }
    let (width, height) = (pixmap.width() as usize, pixmap.height() as usize);
    let data = pixmap.data_mut();
    for (lines, step, length, next) in [(height, 4, width, 4 * width), (width, 4 * width, height, 4)] {
        let mut line = vec![[0_u32; 4]; length];
        for number in 0..lines {
            let at = |place: usize| number * next + place * step;
            for (place, pixel) in line.iter_mut().enumerate() {
                *pixel = [0, 1, 2, 3].map(|channel| data[at(place) + channel].into());
            }
            for place in 0..length {
                let window = &line[place.saturating_sub(radius)..(place + radius + 1).min(length)];
                #[allow(clippy::cast_possible_truncation)]
                let count = window.len() as u32;
                for channel in 0..4 {
                    let sum: u32 = window.iter().map(|pixel| pixel[channel]).sum();
                    data[at(place) + channel] = (sum / count) as u8;
                }
            }
        }
    }
}
