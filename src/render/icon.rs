//! Icons: maps a class, an instance, a facing and a size to pixels.

use crate::city::{AgentKind, OwnLook, Split};
use crate::render::class::{Class, Facing, Subject};
use crate::render::difficulty::{Difficulty, DrawingVersion, Style};
use crate::render::framing::Framing;
use crate::render::pack::{DrawingFault, Mode, Pack, drawing, shrunk};
use crate::render::picture::{PixelBox, Silhouette, Stamp};
use crate::render::sketch::{Dice, Ink, Sketch, byte};
use crate::render::{building, car, pedestrian};
use crate::rng::{Purpose, Rng, Seed};
use resvg::tiny_skia::{FilterQuality, Pixmap, PixmapPaint, Transform};
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

impl Purpose {
    /// The look of an icon; index: its class, tick: the instance.
    pub const ICON: Purpose = Purpose::new(10);

    /// Whether an icon of the test split has the style of that split; index: its class, tick: the instance.
    pub const STYLE: Purpose = Purpose::new(18);
}

/// The largest icon, in pixels: the short side of a car, or the side of a pedestrian or building.
pub const ICON_MAX: u32 = 512;

/// Number of generated instances per class, not counting those of a pack.
const DRAWN: u32 = 100;

/// Approximate limit of the icon cache, in bytes.
const KEPT: usize = 64 << 20;

/// Approximate limit of the cache of bodies, in bytes.
const BODIES_KEPT: usize = 32 << 20;

type Key = (Class, u32, Facing, u32);

/// The caches of drawn icons.
#[derive(Debug, Default)]
struct Kept {
    stamps: BTreeMap<Key, Arc<Stamp>>,
    /// Total size of the stamps' pixels, in bytes.
    bytes: usize,
    /// Bodies, also of icons without a stamp.
    bodies: BTreeMap<Key, Arc<Silhouette>>,
    /// Total size of the bodies, in bytes.
    body_bytes: usize,
}

/// All icons: generated, from a pack, or both. Each is a function of seed, difficulty, version, split, pack, class,
/// instance, facing and size. A bounded cache holds drawn icons. Several threads can share one `Icons`.
#[derive(Debug)]
pub struct Icons {
    seed: Seed,
    difficulty: Difficulty,
    version: DrawingVersion,
    split: Split,
    pack: Option<Pack>,
    looks: Looks,
    kept: Mutex<Kept>,
}

/// The looks that a configuration gives to concepts and kinds, with rasterized drawings.
#[derive(Debug, Default)]
struct Looks(BTreeMap<(AgentKind, String), (OwnLook, Option<Pixmap>)>);

impl Looks {
    /// Returns the looks of the concepts of an agent, in their order.
    fn of<'l, 'c>(
        &'l self,
        kind: AgentKind,
        concepts: &'c [String],
    ) -> impl Iterator<Item = &'l (OwnLook, Option<Pixmap>)> + use<'l, 'c> {
        let look = move |concept: &'c String| self.0.get(&(kind, concept.clone()));
        // Most cities have none.
        let concepts = if self.0.is_empty() { &[] } else { concepts };
        concepts.iter().filter_map(look)
    }

    /// Returns the concepts with the concepts whose icons they have.
    fn with_icons<'c>(&self, kind: AgentKind, concepts: &'c [String]) -> Cow<'c, [String]> {
        let icons: Vec<String> = self
            .of(kind, concepts)
            .filter_map(|(own, _)| own.look.icon.clone())
            .collect();
        match icons.is_empty() {
            true => concepts.into(),
            false => icons.into_iter().chain(concepts.iter().cloned()).collect(),
        }
    }

    /// Returns the color of the agents with these concepts.
    fn color(&self, kind: AgentKind, concepts: &[String]) -> Option<Ink> {
        let [r, g, b] = self.of(kind, concepts).find_map(|(own, _)| own.look.color)?;
        Some(Ink::hex(u32::from_be_bytes([0, r, g, b])))
    }
}

impl Kept {
    fn note_body(&mut self, key: &Key, body: &Arc<Silhouette>) {
        if self.body_bytes > BODIES_KEPT {
            (self.bodies, self.body_bytes) = Default::default();
        }
        if self.bodies.insert(key.clone(), Arc::clone(body)).is_none() {
            self.body_bytes += body.bytes();
        }
    }
}

impl Default for Icons {
    fn default() -> Self {
        Icons::new(Seed(0), Difficulty::CLEAN)
    }
}

impl Icons {
    /// Returns generated icons of the training split, in the newest version.
    pub fn new(seed: Seed, difficulty: Difficulty) -> Icons {
        Icons {
            seed,
            difficulty,
            version: DrawingVersion::default(),
            split: Split::Train,
            pack: None,
            looks: Looks::default(),
            kept: Mutex::default(),
        }
    }

    /// Returns these icons with the looks that a configuration gives to its concepts and kinds.
    ///
    /// # Errors
    /// The first drawing that cannot be used; those of a loaded configuration can.
    pub fn with_looks(self, looks: &[OwnLook]) -> Result<Icons, DrawingFault> {
        let rasterized = looks.iter().map(|own| {
            let art = own.look.drawing.as_deref().map(drawing).transpose()?;
            Ok(((own.of, own.name.clone()), (own.clone(), art)))
        });
        Ok(Icons {
            looks: Looks(rasterized.collect::<Result<_, DrawingFault>>()?),
            kept: Mutex::default(),
            ..self
        })
    }

    /// Returns these icons with a pack that extends or replaces the generated ones, as its mode says.
    #[must_use]
    pub fn with_pack(self, pack: Pack) -> Icons {
        Icons {
            pack: Some(pack),
            kept: Mutex::default(),
            ..self
        }
    }

    /// Returns these icons as another version draws them.
    #[must_use]
    pub fn with_version(self, version: DrawingVersion) -> Icons {
        Icons {
            version,
            kept: Mutex::default(),
            ..self
        }
    }

    /// Returns these icons as another split shows them. The seed stays.
    #[must_use]
    pub fn with_split(self, split: Split) -> Icons {
        Icons {
            split,
            kept: Mutex::default(),
            ..self
        }
    }

    /// Returns the version of the drawing code.
    pub fn version(&self) -> DrawingVersion {
        self.version
    }

    /// Returns the difficulty as far as it concerns boxes, style and weather: 0 in version 1.
    pub(super) fn disguise(&self) -> Difficulty {
        match self.version {
            DrawingVersion::V1 => Difficulty::CLEAN,
            DrawingVersion::V2 => self.difficulty,
        }
    }

    /// Draws how a picture shows an agent, independently of its class. `None` at difficulty 0 and in version 1.
    pub fn framing(&self, stream: &mut impl Rng) -> Option<Framing> {
        Framing::drawn(self.disguise(), &mut Dice(stream))
    }

    /// Returns the style of an instance of a class, by the hash of its name. From difficulty 50 to 100, the share of
    /// the instances of the test split in its style rises from none to all.
    fn style(&self, class: u64, instance: u32) -> Style {
        let share = 2.0 * self.disguise().share() - 1.0;
        let mut dice = Dice(self.seed.stream(Purpose::STYLE, class, instance.into()));
        match self.split == Split::Test && dice.chance(share) {
            true => Style::Test,
            false => Style::Common,
        }
    }

    /// Returns the seed of the generated icons.
    pub fn seed(&self) -> Seed {
        self.seed
    }

    /// Returns the difficulty.
    pub fn difficulty(&self) -> Difficulty {
        self.difficulty
    }

    /// Returns the pack, if there is one.
    pub fn pack(&self) -> Option<&Pack> {
        self.pack.as_ref()
    }

    /// Returns the number of distinct instances of a class.
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

    /// Returns an icon. Instances count from 0 and repeat after [`Icons::instances`]. `size` is the short side of a car
    /// or the side of a pedestrian or building, in pixels, clamped to 1..=[`ICON_MAX`].
    pub(super) fn stamp(&self, class: &Class, instance: u32, facing: Facing, size: u32) -> Arc<Stamp> {
        let key = self.key(class, instance, facing, size);
        if let Some(stamp) = self.kept().stamps.get(&key) {
            return Arc::clone(stamp);
        }
        let stamp = Arc::new(self.draw(class, key.1, facing, key.3));
        let mut kept = self.kept();
        if kept.bytes > KEPT {
            (kept.stamps, kept.bytes) = Default::default();
        }
        kept.bytes += stamp.pixels.len();
        kept.note_body(&key, &stamp.body);
        kept.stamps.insert(key, Arc::clone(&stamp));
        stamp
    }

    /// Returns the body of an icon, as in its stamp; does not draw the stamp.
    pub(super) fn body(&self, class: &Class, instance: u32, facing: Facing, size: u32) -> Arc<Silhouette> {
        let key = self.key(class, instance, facing, size);
        if let Some(body) = self.kept().bodies.get(&key) {
            return Arc::clone(body);
        }
        let (drawing, _) = self.drawing(class, key.1, facing);
        let body = Arc::new(body_of(&drawing.outline(facing, key.3)));
        self.kept().note_body(&key, &body);
        body
    }

    fn key(&self, class: &Class, instance: u32, facing: Facing, size: u32) -> Key {
        (
            class.clone(),
            instance % self.instances(class),
            facing,
            size.clamp(1, ICON_MAX),
        )
    }

    fn kept(&self) -> MutexGuard<'_, Kept> {
        self.kept.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Draws an icon without the cache.
    pub(super) fn draw(&self, class: &Class, instance: u32, facing: Facing, size: u32) -> Stamp {
        let (drawing, mut dice) = self.drawing(class, instance % self.instances(class), facing);
        let is_agent = matches!(class.0, Subject::Agent(..));
        let layers = drawing.layers(facing, size);
        layers.finish(&mut dice, self.difficulty.share(), self.version, size, is_agent)
    }

    /// Returns the parts of an icon, and the random numbers for its noise. `instance` is less than
    /// [`Icons::instances`].
    fn drawing(&self, class: &Class, instance: u32, facing: Facing) -> (Drawing<'_>, Dice<impl Rng + use<>>) {
        let name = class.to_string();
        // FNV-1a, because the standard library's hasher may change between releases.
        let hash = name.bytes().fold(0xcbf2_9ce4_8422_2325_u64, |hash, byte| {
            (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3)
        });
        let mut dice = Dice(self.seed.stream(Purpose::ICON, hash, instance.into()));
        let (noise, style) = (self.difficulty.share(), self.style(hash, instance));
        let drawing = match (&class.0, self.art(class).get(instance as usize)) {
            (Subject::Agent(AgentKind::Car, _), Some(art)) => Drawing::CarArt(art, Sketch::default()),
            (Subject::Agent(AgentKind::Pedestrian, _), Some(art)) => Drawing::PedestrianArt(art, Sketch::default()),
            (Subject::Building(_), Some(art)) => Drawing::BuildingArt(art),
            (Subject::Building(building), None) => Drawing::Square(building::draw(*building, &mut dice, noise)),
            (Subject::Agent(kind, concepts), None) => {
                let own_art = self.looks.of(*kind, concepts).find_map(|(_, art)| art.as_ref());
                let with_icons = self.looks.with_icons(*kind, concepts);
                let (car_features, pedestrian_features) = Class::features(&with_icons);
                let color = self.looks.color(*kind, concepts);
                match (kind, own_art) {
                    (AgentKind::Pedestrian, None) => {
                        let looks = (style, color);
                        let mut sketch = pedestrian::draw(&pedestrian_features, facing.side(), &mut dice, noise, looks);
                        self.badges(&mut sketch, AgentKind::Pedestrian, concepts, (0.0, 0.12), 0.14);
                        Drawing::Square(sketch)
                    }
                    (AgentKind::Pedestrian, Some(art)) => {
                        let mut sketch = Sketch::default();
                        self.badges(&mut sketch, AgentKind::Pedestrian, concepts, (0.0, 0.3), 0.14);
                        Drawing::PedestrianArt(art, sketch)
                    }
                    (AgentKind::Car, None) => {
                        let mut car = car::draw(&car_features, &mut dice, noise, (style, color));
                        self.badges(&mut car.body, AgentKind::Car, concepts, (0.0, 0.36 * car.length), 0.19);
                        Drawing::Car(car)
                    }
                    (AgentKind::Car, Some(art)) => {
                        let (short, long) = (art.width().min(art.height()), art.width().max(art.height()));
                        #[allow(clippy::cast_precision_loss)]
                        let length = long as f32 / short as f32;
                        let mut sketch = Sketch::default();
                        self.badges(&mut sketch, AgentKind::Car, concepts, (0.0, 0.3 * length), 0.19);
                        Drawing::CarArt(art, sketch)
                    }
                }
            }
        };
        (drawing, dice)
    }

    /// Adds round badges: those of the looks, and a letter for each concept without looks, in a color derived from its
    /// name. A badge beside a chosen color is dark.
    fn badges(&self, sketch: &mut Sketch, kind: AgentKind, concepts: &[String], (x, y): (f32, f32), radius: f32) {
        let letter = |concept: &String| concept.chars().take(1).flat_map(char::to_uppercase).collect();
        let badge = |concept: &'_ String| -> Option<(String, Ink)> {
            let sum = concept
                .bytes()
                .fold(7_u32, |sum, byte| sum.wrapping_mul(31).wrapping_add(byte.into()));
            #[allow(clippy::cast_precision_loss)]
            let ink = Ink::hsl((sum % 17) as f32 / 17.0, 0.85, 0.42);
            match self.looks.of(kind, std::slice::from_ref(concept)).next() {
                Some((own, _)) => {
                    let ink = own.look.color.map_or(ink, |_| Ink::hex(0x0026_2a33));
                    Some((own.look.badge.clone()?, ink))
                }
                None if Class::is_drawn(kind, concept) => None,
                None => Some((letter(concept), ink)),
            }
        };
        for (number, (text, ink)) in (0_u8..3).zip(concepts.iter().filter_map(badge)) {
            let y = y - f32::from(number) * 2.1 * radius;
            // Two characters are as wide as a larger badge.
            let (radius, high, bold) = match text.chars().count() {
                0 | 1 => (radius, radius * 0.95, radius * 0.24),
                _ => (radius * 1.2, radius * 0.85, radius * 0.21),
            };
            sketch.oval(x, y, radius, radius, Ink::WHITE);
            sketch.oval(x, y, radius * 0.88, radius * 0.88, ink);
            sketch.letters(&text, (x, y), high, bold, Ink::WHITE);
        }
    }

    /// Returns an icon as a square PNG on a transparent ground, scaled to fit into `side` pixels, 1 to [`ICON_MAX`].
    pub fn png(&self, class: &Class, instance: u32, facing: Facing, side: u32) -> Vec<u8> {
        let side = side.clamp(1, ICON_MAX);
        let mut size = side;
        let mut stamp = self.stamp(class, instance, facing, size);
        while reach(&stamp) > side && size > 1 {
            size = (size * side / reach(&stamp)).clamp(1, size - 1);
            stamp = self.stamp(class, instance, facing, size);
        }
        let mut pixels = vec![0; 4 * (side * side) as usize];
        lay(&stamp, &mut pixels, (side, side), (side / 2, side / 2));
        let mut bytes = Vec::new();
        super::encode::write_rgba(&pixels, side, side, &mut bytes).expect("writing to a vector cannot fail");
        bytes
    }

    /// Returns icons of one size as squares of a single PNG, on a transparent ground. `size` is that of pictures: the
    /// short side of a car, or the side of a pedestrian or building.
    ///
    /// # Panics
    /// If `icons` is empty.
    pub fn atlas(&self, icons: &[(Class, u32, Facing)], size: u32) -> Atlas {
        let stamps: Vec<Arc<Stamp>> = (icons.iter())
            .map(|(class, instance, facing)| self.stamp(class, *instance, *facing, size))
            .collect();
        let side = stamps
            .iter()
            .map(|stamp| reach(stamp))
            .max()
            .expect("at least one icon");
        let count = u32::try_from(stamps.len()).expect("few icons");
        let columns = (1..count).find(|columns| columns * columns >= count).unwrap_or(1);
        let (width, height) = (columns * side, count.div_ceil(columns) * side);
        let mut pixels = vec![0; 4 * width as usize * height as usize];
        for (number, stamp) in (0..).zip(&stamps) {
            let (x, y) = (number % columns * side + side / 2, number / columns * side + side / 2);
            lay(stamp, &mut pixels, (width, height), (x, y));
        }
        let mut png = Vec::new();
        super::encode::write_rgba_small(&pixels, width, height, &mut png).expect("writing to a vector cannot fail");
        Atlas {
            png,
            size: size.clamp(1, ICON_MAX),
            side,
            columns,
        }
    }
}

/// Icons of one size in a grid of squares, row by row.
#[derive(Clone, Debug)]
pub struct Atlas {
    /// The picture as PNG with transparency.
    pub png: Vec<u8>,
    /// The size of the icons, in pixels.
    pub size: u32,
    /// The side of a square, in pixels. Each icon is centered in its square.
    pub side: u32,
    /// The number of squares per row.
    pub columns: u32,
}

/// Returns the side of the smallest square around the center of an icon that holds the icon.
fn reach(stamp: &Stamp) -> u32 {
    let PixelBox { x, y, width, height } = stamp.area;
    let far = |from: i32, length: u32| {
        let end = (i64::from(from) + i64::from(length)).unsigned_abs() as u32;
        from.unsigned_abs().max(end)
    };
    2 * far(x, width).max(far(y, height))
}

/// Copies an icon into RGBA pixels, centered on a pixel; undoes the premultiplication of its colors.
fn lay(stamp: &Stamp, pixels: &mut [u8], (width, height): (u32, u32), (x, y): (u32, u32)) {
    let place = |middle: u32, from: i32, offset: usize, end: u32| {
        let at = i64::from(middle) + i64::from(from) + offset as i64;
        usize::try_from(at).ok().filter(|at| *at < end as usize)
    };
    for (row, line) in stamp.pixels.chunks_exact(4 * stamp.area.width as usize).enumerate() {
        let Some(y) = place(y, stamp.area.y, row, height) else {
            continue;
        };
        for (col, pixel) in line.chunks_exact(4).enumerate() {
            let Some(x) = place(x, stamp.area.x, col, width) else {
                continue;
            };
            let alpha = u32::from(pixel[3]);
            let straight = |channel: u8| match alpha {
                0 => 0,
                alpha => ((u32::from(channel) * 255 + alpha / 2) / alpha).min(255) as u8,
            };
            let rgba = [straight(pixel[0]), straight(pixel[1]), straight(pixel[2]), pixel[3]];
            pixels[4 * (y * width as usize + x)..][..4].copy_from_slice(&rgba);
        }
    }
}

/// The parts of an icon, at any size.
enum Drawing<'a> {
    /// Fills a square.
    Square(Sketch),
    Car(car::Drawing),
    /// A picture whose short side has the size, and badges on it.
    CarArt(&'a Pixmap, Sketch),
    /// A picture that fits into a square, and badges on it.
    PedestrianArt(&'a Pixmap, Sketch),
    BuildingArt(&'a Pixmap),
}

/// An icon before light and shadow: the ground below it and the body, on pixmaps of one size around the center.
struct Layers {
    ground: Pixmap,
    body: Pixmap,
}

/// Returns an empty pixmap that reaches `reach` pixels from its center, with room for a shadow, and the transformation
/// that moves the origin to the center.
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
impl Drawing<'_> {
    /// Returns an empty pixmap for a sketch of this size, and the transformation from the sketch to it.
    fn canvas(&self, facing: Facing, size: u32) -> (Pixmap, Transform) {
        let side = size as f32;
        match self {
            Drawing::Car(car) => {
                let (pixmap, middle) = canvas(side * (car.length / 2.0 + 1.0));
                (pixmap, turned(facing, side).post_concat(middle))
            }
            _ => {
                let (pixmap, middle) = canvas(side * 0.75);
                // With an odd side, the center is the middle of a pixel, as for the cells below.
                let half = if size % 2 == 1 { 0.5 } else { 0.0 };
                let scale = Transform::from_scale(side, side);
                (pixmap, scale.post_concat(middle).post_translate(half, half))
            }
        }
    }

    /// Draws all parts.
    fn layers(&self, facing: Facing, size: u32) -> Layers {
        let (mut body, transform) = match self.art(facing, size) {
            Some(body) => (body, Transform::identity()),
            None => self.canvas(facing, size),
        };
        let mut ground = Pixmap::new(body.width(), body.height()).expect("as large as the other");
        match self {
            Drawing::Square(sketch) => sketch.paint(&mut body, transform),
            Drawing::Car(car) => {
                car.ground.paint(&mut ground, transform);
                car.body.paint(&mut body, transform);
            }
            Drawing::CarArt(..) | Drawing::PedestrianArt(..) | Drawing::BuildingArt(_) => {}
        }
        Layers { ground, body }
    }

    /// Draws the body with correct opacities; its colors may be incomplete.
    fn outline(&self, facing: Facing, size: u32) -> Pixmap {
        if let Some(body) = self.art(facing, size) {
            return body;
        }
        let (mut body, transform) = self.canvas(facing, size);
        if let Drawing::Square(sketch) | Drawing::Car(car::Drawing { body: sketch, .. }) = self {
            sketch.paint_outline(&mut body, transform);
        }
        body
    }

    /// Returns the body if it is a picture. A car rotates, and its short side has the size. Others fit into a square, and
    /// pedestrians face left or right.
    fn art(&self, facing: Facing, size: u32) -> Option<Pixmap> {
        let (art, turn) = match self {
            Drawing::CarArt(art, _) => (art, turned(facing, 1.0)),
            Drawing::PedestrianArt(art, _) if facing.side() == pedestrian::Side::Left => {
                (art, Transform::from_scale(-1.0, 1.0))
            }
            Drawing::PedestrianArt(art, _) | Drawing::BuildingArt(art) => (art, Transform::identity()),
            Drawing::Square(_) | Drawing::Car(_) => return None,
        };
        let (width, height) = (art.width() as f32, art.height() as f32);
        let fitted = match self {
            Drawing::CarArt(..) => width.min(height),
            _ => width.max(height),
        };
        let scale = size as f32 / fitted;
        let (wide, high) = (width * scale, height * scale);
        let (mut body, middle) = canvas((wide * wide + high * high).sqrt() / 2.0);
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
        let side = size as f32;
        match self {
            Drawing::CarArt(_, badges) => badges.paint(&mut body, turned(facing, side).post_concat(middle)),
            Drawing::PedestrianArt(_, badges) => {
                badges.paint(&mut body, Transform::from_scale(side, side).post_concat(middle));
            }
            Drawing::BuildingArt(_) | Drawing::Square(_) | Drawing::Car(_) => {}
        }
        Some(body)
    }
}

#[allow(clippy::cast_precision_loss)]
impl Layers {
    /// Adds noise and a shadow, and crops the result.
    fn finish<R: Rng>(
        mut self,
        dice: &mut Dice<R>,
        noise: f32,
        version: DrawingVersion,
        size: u32,
        shadow: bool,
    ) -> Stamp {
        let (width, height) = (self.body.width(), self.body.height());
        let body = Arc::new(body_of(&self.body));
        if noise > 0.0 {
            disturb(&mut self.body, dice, noise, version, size);
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
        let area = bounds(&all, 1).unwrap_or(body.area);
        let pixel = |from: i32, side: u32| (from + (side / 2).cast_signed()).cast_unsigned();
        let (left, top) = (pixel(area.x, width), pixel(area.y, height));
        let mut pixels = Vec::with_capacity(4 * (area.width * area.height) as usize);
        for row in top..top + area.height {
            let start = 4 * (row * width + left) as usize;
            pixels.extend_from_slice(&all.data()[start..start + 4 * area.width as usize]);
        }
        Stamp { area, body, pixels }
    }
}

/// The least opacity of the pixels of a body.
const HALF_OPAQUE: u8 = 128;

/// Returns the pixels of a body that are at least half opaque.
fn body_of(pixmap: &Pixmap) -> Silhouette {
    let area = bounds(pixmap, HALF_OPAQUE).unwrap_or(PixelBox {
        x: 0,
        y: 0,
        width: 1,
        height: 1,
    });
    let pixel = |from: i32, side: u32| (from + (side / 2).cast_signed()).cast_unsigned();
    let (left, top) = (pixel(area.x, pixmap.width()), pixel(area.y, pixmap.height()));
    let alpha = |col, row| pixmap.pixel(left + col, top + row).map_or(0, |pixel| pixel.alpha());
    Silhouette::new(area, |col, row| alpha(col, row) >= HALF_OPAQUE)
}

/// Returns the box of pixels with at least this opacity, relative to the center.
fn bounds(pixmap: &Pixmap, least: u8) -> Option<PixelBox> {
    let rows = || pixmap.data().chunks_exact(4 * pixmap.width() as usize);
    let opaque = |pixel: &[u8]| pixel[3] >= least;
    let is_in = |row: &[u8]| row.chunks_exact(4).any(opaque);
    let (top, last) = (rows().position(is_in)?, rows().rposition(is_in)?);
    let (mut left, mut right) = (pixmap.width() as usize, 0);
    for row in rows().take(last + 1).skip(top) {
        // Pixels between the two do not change the box.
        let (before, behind) = (&row[..4 * left], &row[4 * right..]);
        left = before.chunks_exact(4).position(opaque).unwrap_or(left);
        right += behind.chunks_exact(4).rposition(opaque).map_or(0, |at| at + 1);
    }
    #[allow(clippy::cast_possible_wrap, clippy::cast_possible_truncation)]
    let place = |at: usize, side: u32| at as i32 - (side / 2).cast_signed();
    #[allow(clippy::cast_possible_truncation)]
    let length = |from: usize, to: usize| (to - from) as u32;
    Some(PixelBox {
        x: place(left, pixmap.width()),
        y: place(top, pixmap.height()),
        width: length(left, right),
        height: length(top, last + 1),
    })
}

/// Varies colors, light and sharpness, and adds grain.
#[allow(clippy::cast_precision_loss)]
fn disturb<R: Rng>(pixmap: &mut Pixmap, dice: &mut Dice<R>, noise: f32, version: DrawingVersion, size: u32) {
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
            // A premultiplied channel never exceeds the opacity.
            pixel[channel] = byte(f32::from(pixel[channel]) * shade.max(0.2) * tint + rough).min(pixel[3]);
        }
    }
    // The largest radius, in sizes of the icon.
    let most = match version {
        DrawingVersion::V1 => 0.045,
        DrawingVersion::V2 => 0.075,
    };
    let radius = (noise * dice.between(0.0, most) * side).round();
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    blur(pixmap, radius as usize);
}

/// Box blur: replaces every pixel by the mean of those within `radius`, first along rows, then along columns.
#[allow(clippy::cast_possible_truncation)] // means of bytes, and at most 2^32 places
fn blur(pixmap: &mut Pixmap, radius: usize) {
    if radius == 0 {
        return;
    }
    let (width, height) = (pixmap.width() as usize, pixmap.height() as usize);
    let data = pixmap.data_mut();
    for (lines, step, length, next) in [(height, 4, width, 4 * width), (width, 4 * width, height, 4)] {
        let mut line = vec![0_u8; length];
        for first in (0..lines).flat_map(|number| number * next..number * next + 4) {
            for (place, value) in line.iter_mut().enumerate() {
                *value = data[first + place * step];
            }
            // The sum and the number of the values within `radius`, at first of those before the next value to enter.
            let ahead = &line[..radius.min(length)];
            let (mut sum, mut count) = (
                ahead.iter().map(|&value| u32::from(value)).sum::<u32>(),
                ahead.len() as u32,
            );
            for place in 0..length {
                if place + radius < length {
                    sum += u32::from(line[place + radius]);
                    count += 1;
                }
                if place > radius {
                    sum -= u32::from(line[place - radius - 1]);
                    count -= 1;
                }
                data[first + place * step] = (sum / count) as u8;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::RngExt;

    /// An SVG that is opaque in its lower half.
    const ART: &str =
        r#"<svg xmlns="http://www.w3.org/2000/svg" width="30" height="50"><circle cx="14" cy="30" r="13"/></svg>"#;

    #[test]
    fn a_blurred_picture_has_the_means_of_windows() {
        let mut stream = Seed(3).stream(Purpose::TEST, 0, 1);
        for _ in 0..40 {
            let (cols, rows) = (stream.random_range(1..9_usize), stream.random_range(1..9_usize));
            let radius = stream.random_range(0..6);
            let mut pixmap = Pixmap::new(cols as u32, rows as u32).expect("a size");
            pixmap.data_mut().fill_with(|| stream.random());
            let mut expected = pixmap.data().to_vec();
            for along_row in [true, false] {
                let before = expected.clone();
                for (at, value) in expected.iter_mut().enumerate() {
                    let near = |other: &usize| {
                        let across = (other / 4 % cols).abs_diff(at / 4 % cols);
                        let down = (other / 4 / cols).abs_diff(at / 4 / cols);
                        let (along, beside) = if along_row { (across, down) } else { (down, across) };
                        other % 4 == at % 4 && beside == 0 && along <= radius
                    };
                    let window = (0..before.len()).filter(near).map(|other| u32::from(before[other]));
                    *value = (window.clone().sum::<u32>() / window.count() as u32) as u8;
                }
            }
            blur(&mut pixmap, radius);
            assert_eq!(pixmap.data(), expected, "{cols} x {rows}, radius {radius}");
        }
    }

    #[test]
    fn outlines_are_those_of_what_is_drawn() {
        let concepts = ["bus", "tiro", "ambulance", "taxi", "old", "young", "police", "reckless"].map(str::to_owned);
        for case in 0..60 {
            let mut stream = Seed(3).stream(Purpose::TEST, case, 0);
            let difficulty = Difficulty::percent(stream.random_range(0..=100)).expect("a percentage");
            let files = ["car/a.svg", "old/a.svg"].map(|name| (name.to_owned(), ART.as_bytes().to_vec()));
            let pack = Pack::new(Mode::Extend, files.to_vec()).unwrap_or_else(|faults| panic!("{faults:?}"));
            let icons = Icons::new(Seed(case), difficulty).with_pack(pack);
            let first = stream.random_range(0..concepts.len());
            let carried = &concepts[first..stream.random_range(first..=concepts.len())];
            let class = match stream.random_range(0..6) {
                0 => Class::known()[stream.random_range(0..Class::known().len())].clone(),
                1 => Class::agent(AgentKind::Car, &[]),
                2 => Class::agent(AgentKind::Pedestrian, &["old".to_owned()]),
                3 => Class::agent(AgentKind::Pedestrian, carried),
                _ => Class::agent(AgentKind::Car, carried),
            };
            let (instance, facing) = (stream.random_range(0..4), Facing::ALL[stream.random_range(0..8)]);
            let size = stream.random_range(1..90);
            let (drawing, _) = icons.drawing(&class, instance, facing);
            let opacities = |body: &Pixmap| -> Vec<u8> { body.pixels().iter().map(|pixel| pixel.alpha()).collect() };
            let (drawn, outline) = (drawing.layers(facing, size).body, drawing.outline(facing, size));
            assert!(opacities(&drawn) == opacities(&outline), "case {case}: {class}");
            let body = icons.body(&class, instance, facing, size);
            assert_eq!(
                body,
                icons.stamp(&class, instance, facing, size).body,
                "case {case}: {class}"
            );
            assert_eq!(body.area, slow_bounds(&drawn), "case {case}: {class}");
            let (width, height) = (drawn.width().cast_signed(), drawn.height().cast_signed());
            let places = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
            for ((x, y), pixel) in places.zip(drawn.pixels()) {
                let is_in = body.contains(x - width / 2, y - height / 2);
                assert_eq!(is_in, pixel.alpha() >= 128, "case {case}: {class}");
            }
            assert!(!body.contains(i32::MIN, 0) && !body.contains(0, i32::MAX));
        }
    }

    /// Reference implementation of the box of pixels that are at least half opaque.
    fn slow_bounds(pixmap: &Pixmap) -> PixelBox {
        let (width, height) = (pixmap.width().cast_signed(), pixmap.height().cast_signed());
        let places = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
        let pixels = places.zip(pixmap.pixels()).filter(|(_, pixel)| pixel.alpha() >= 128);
        let (xs, ys): (Vec<i32>, Vec<i32>) = pixels.map(|((x, y), _)| (x - width / 2, y - height / 2)).unzip();
        let along = |places: &[i32]| {
            let first = places.iter().min().copied().unwrap_or(0);
            (
                first,
                (places.iter().max().map_or(1, |last| last + 1 - first)).cast_unsigned(),
            )
        };
        let ((x, width), (y, height)) = (along(&xs), along(&ys));
        PixelBox { x, y, width, height }
    }
}
