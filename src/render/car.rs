//! Parametric drawings of cars from above. A car is one unit wide and heads up; its center is the origin.

use crate::render::difficulty::Style;
use crate::render::sketch::{Dice, Edges, Ink, Sketch};
use crate::rng::Rng;

/// The concepts of a car. It may have several; the drawing shows all.
#[derive(Clone, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Features {
    pub(super) ambulance: bool,
    pub(super) bus: bool,
    pub(super) police: bool,
    pub(super) tiro: bool,
    pub(super) reckless: bool,
    pub(super) bicycle: bool,
}

/// A drawn car.
pub(super) struct Drawing {
    /// The car itself.
    pub(super) body: Sketch,
    /// Marks on the ground below the car.
    pub(super) ground: Sketch,
    /// Length in widths.
    pub(super) length: f32,
}

/// The outline of a car.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Shape {
    Saloon,
    Hatchback,
    Estate,
    Pickup,
    Sports,
    /// The box of an ambulance behind a cab.
    Van,
    Bus,
}

const PAINTS: [u32; 14] = [
    0xd8dade, 0xf3f3ef, 0x9aa1a9, 0x5c636b, 0x2d3138, 0xb3352f, 0x7d2430, 0x2f5fa8, 0x23406f, 0x3a7d54, 0x6a8f6b,
    0xc9a064, 0xd98a3c, 0x67513f,
];
const BUS_PAINTS: [u32; 8] = [
    0xe8b41f, 0xd7372f, 0x2f6fbf, 0x2e9160, 0xe57e25, 0xf0efe9, 0x7a4aa0, 0x2aa5ad,
];
const SPORTS_PAINTS: [u32; 8] = [
    0xe02222, 0xff6a00, 0xffd000, 0x17181c, 0x5fd30c, 0x1f51e0, 0xb01fd0, 0xe8e8ea,
];
const POLICE_PAINTS: [u32; 5] = [0x1c1f27, 0x1b3368, 0xf2f4f5, 0x23498f, 0xe6e9ec];
const AMBULANCE_PAINTS: [u32; 5] = [0xf7f7f3, 0xf4f1e4, 0xe9e33a, 0xf0c419, 0xfafafa];

// The palettes of the test style.
const TEST_PAINTS: [u32; 12] = [
    0x8fc9b4, 0xb7a3d6, 0xd9c58a, 0x74803f, 0x2f8f96, 0xd98fa6, 0x4f3527, 0xa3c44a, 0x6b7f99, 0xe3d3c0, 0x8a5a72,
    0x3c4a3f,
];
const TEST_BUS_PAINTS: [u32; 7] = [0x1f5a3c, 0x6e1f34, 0xb9bec3, 0x1d2a4d, 0x2b2c30, 0xcfe3d0, 0x8a6a3f];
const TEST_SPORTS_PAINTS: [u32; 7] = [0x3d2a66, 0x17e0c8, 0xc9a227, 0x2b3a2c, 0xf25fa0, 0x8f9499, 0x6a1616];
const TEST_POLICE_PAINTS: [u32; 5] = [0xc2c7cb, 0x2d6b45, 0x8f7a55, 0x54595f, 0xdfe6c8];
const TEST_AMBULANCE_PAINTS: [u32; 5] = [0xff7a2a, 0xc9e04a, 0xd6423a, 0x9fd0e8, 0xefe6da];

const GLASS: Ink = Ink::hex(0x0023_303d);
const TEST_GLASS: Ink = Ink::hex(0x0086_a5b3);
const RED: Ink = Ink::hex(0x00d8_1f2a);
const BLUE: Ink = Ink::hex(0x0022_58e0);
const AMBER: Ink = Ink::hex(0x00ff_b020);
const TYRE: Ink = Ink::hex(0x0018_191c);

/// Draws a car, in `color` if it is given. `noise` is the difficulty, 0..=1: more of it makes car types share colors and
/// wears markings.
///
/// Shapes are those of the concepts in both styles. The test style has other colors, light, windows and markings.
pub(super) fn draw<R: Rng>(
    features: &Features,
    dice: &mut Dice<R>,
    noise: f32,
    (style, color): (Style, Option<Ink>),
) -> Drawing {
    if features.bicycle {
        return bicycle(dice, style, color);
    }
    let shape = match features {
        Features { bus: true, .. } => Shape::Bus,
        Features { ambulance: true, .. } => Shape::Van,
        Features { reckless: true, .. } => Shape::Sports,
        Features { police: true, .. } => dice.pick(&[Shape::Saloon, Shape::Saloon, Shape::Estate]),
        Features { tiro: true, .. } => dice.pick(&[Shape::Hatchback, Shape::Hatchback, Shape::Saloon]),
        _ => dice.pick(&[Shape::Saloon, Shape::Hatchback, Shape::Estate, Shape::Pickup]),
    };
    let length = match shape {
        Shape::Saloon => dice.between(1.95, 2.15),
        Shape::Hatchback => dice.between(1.65, 1.85),
        Shape::Estate => dice.between(1.95, 2.2),
        Shape::Pickup => dice.between(2.1, 2.3),
        Shape::Sports => dice.between(1.85, 2.05),
        Shape::Van => dice.between(2.15, 2.4),
        Shape::Bus => dice.between(2.65, 2.95),
    };
    let paints = style.choose(&PAINTS[..], &TEST_PAINTS[..]);
    let usual = match features {
        Features { bus: true, .. } => dice.ink(style.choose(&BUS_PAINTS[..], &TEST_BUS_PAINTS[..])),
        Features { ambulance: true, .. } => dice.ink(style.choose(&AMBULANCE_PAINTS[..], &TEST_AMBULANCE_PAINTS[..])),
        Features { police: true, .. } => dice.ink(style.choose(&POLICE_PAINTS[..], &TEST_POLICE_PAINTS[..])),
        Features { reckless: true, .. } => dice.ink(style.choose(&SPORTS_PAINTS[..], &TEST_SPORTS_PAINTS[..])),
        _ => dice.ink(paints),
    };
    let other = dice.ink(paints);
    let mut car = Car {
        length,
        paint: {
            let drawn = usual.mix(other, noise * dice.between(0.0, 0.8));
            color.unwrap_or(drawn)
        },
        wear: noise * dice.between(0.0, 0.75),
        style,
        dice,
        body: Sketch::default(),
        ground: Sketch::default(),
    };
    car.hull(shape);
    car.body.stay_inside();
    match (shape, style) {
        (Shape::Bus, Style::Common) => car.bus_roof(),
        (Shape::Bus, Style::Test) => car.coach_roof(),
        (Shape::Van, _) => car.van_roof(),
        _ => car.cabin(shape),
    }
    car.lamps();
    car.liveries(features, shape);
    car.dirt(noise);
    car.body.go_outside();
    if features.reckless {
        car.spoiler();
        car.skid_marks();
    }
    Drawing {
        body: car.body,
        ground: car.ground,
        length,
    }
}

/// Draws a bicycle with its rider.
fn bicycle<R: Rng>(dice: &mut Dice<R>, style: Style, color: Option<Ink>) -> Drawing {
    let length = dice.between(1.5, 1.65);
    let frame = dice.ink(style.choose(&SPORTS_PAINTS[..], &TEST_SPORTS_PAINTS[..]));
    let jacket = dice.ink(style.choose(&PAINTS[..], &TEST_PAINTS[..]));
    let (frame, jacket) = (color.unwrap_or(frame), color.unwrap_or(jacket));
    let helmet = dice.ink(style.choose(&BUS_PAINTS[..], &TEST_BUS_PAINTS[..]));
    let at = places(length);
    let mut body = Sketch::default();
    for wheel in [0.19, 0.81] {
        body.oval(0.0, at(wheel), 0.07, 0.19 * length, TYRE);
    }
    body.line(&[(0.0, at(0.2)), (0.0, at(0.8))], 0.1, frame);
    body.line(&[(-0.3, at(0.34)), (0.0, at(0.26)), (0.3, at(0.34))], 0.07, TYRE);
    let skin = Ink::hex(0x00d9_a679);
    for side in [-1.0, 1.0] {
        body.line(
            &[(side * 0.22, at(0.56)), (side * 0.29, at(0.36))],
            0.1,
            jacket.lit(-0.08),
        );
        body.oval(side * 0.29, at(0.35), 0.06, 0.06, skin);
        body.oval(side * 0.13, at(0.66), 0.09, 0.17, Ink::hex(0x0033_3a45));
    }
    body.oval(0.0, at(0.57), 0.28, 0.2, jacket);
    body.oval(0.0, at(0.5), 0.15, 0.17, helmet);
    body.line(&[(0.0, at(0.44)), (0.0, at(0.55))], 0.04, helmet.lit(0.2));
    Drawing {
        body,
        ground: Sketch::default(),
        length,
    }
}

/// Maps a share of a car's length (0 is the front, 1 the rear) to a coordinate.
fn places(length: f32) -> impl Fn(f32) -> f32 + Copy {
    move |share| (share - 0.5) * length
}

/// A car in progress.
struct Car<'a, R> {
    length: f32,
    paint: Ink,
    /// The faintness of markings, 0..=1.
    wear: f32,
    style: Style,
    dice: &'a mut Dice<R>,
    body: Sketch,
    ground: Sketch,
}

impl<R: Rng> Car<'_, R> {
    /// Returns the coordinate of a share of the length: 0 is the front, 1 the rear.
    fn along(&self, share: f32) -> f32 {
        places(self.length)(share)
    }

    /// Returns the color of windows.
    fn glass(&self) -> Ink {
        self.style.choose(GLASS, TEST_GLASS)
    }

    /// Fades a marking by the wear.
    fn worn(&self, ink: Ink) -> Ink {
        ink.faint(1.0 - self.wear)
    }

    /// Draws wheels and outline, shaded from left to right.
    fn hull(&mut self, shape: Shape) {
        let half = self.length / 2.0;
        let (front, rear) = match shape {
            Shape::Bus => (self.along(0.14), self.along(0.8)),
            Shape::Van => (self.along(0.17), self.along(0.78)),
            _ => (self.along(0.2), self.along(0.8)),
        };
        let (long, out) = if shape == Shape::Sports {
            (0.2, 0.5)
        } else {
            (0.17, 0.49)
        };
        for y in [front, rear] {
            for side in [-1.0, 1.0] {
                let x = side * (out - 0.06);
                self.body.round([x - 0.07, y - long, x + 0.07, y + long], 0.04, TYRE);
            }
        }
        let dark = self.paint.lit(self.style.choose(-0.62, 0.55));
        let edge = 0.03;
        for (grow, ink) in [(0.0, dark), (-edge, self.paint)] {
            match shape {
                Shape::Bus => (self.body).round([-0.47 - grow, -half - grow, 0.47 + grow, half + grow], 0.12, ink),
                Shape::Van => {
                    let cab = self.along(0.3);
                    (self.body).round([-0.42 - grow, -half - grow, 0.42 + grow, cab + 0.2], 0.16, ink);
                    (self.body).round([-0.48 - grow, cab - grow, 0.48 + grow, half + grow], 0.06, ink);
                }
                _ => {
                    let (nose, waist, tail) = match shape {
                        Shape::Sports => (0.36, 0.4, 0.5),
                        Shape::Hatchback => (0.42, 0.46, 0.45),
                        Shape::Pickup => (0.45, 0.46, 0.47),
                        _ => (0.42, 0.46, 0.43),
                    };
                    let points = [(nose, 0.0), (0.47, 0.14), (waist, 0.5), (0.48, 0.82), (tail, 1.0)];
                    let mut outline = vec![(0.0, -half - grow - 0.03)];
                    outline.extend(points.map(|(x, share)| (x + grow, self.along(share) * (1.0 + grow))));
                    outline.push((0.0, half + grow + 0.02));
                    let left = points.iter().rev();
                    outline.extend(left.map(|&(x, share)| (-x - grow, self.along(share) * (1.0 + grow))));
                    // Doubled corner points keep the curve from cutting the corners.
                    let outline: Vec<_> = outline.iter().flat_map(|&point| [point, point]).collect();
                    self.body.blob(&outline, ink);
                }
            }
        }
        self.body.stay_inside();
        if self.style == Style::Test {
            // Lit from the rear.
            let shade = [-0.5, -half, 0.5, half];
            (self.body).fade(shade, Ink::BLACK.faint(0.35), Ink::WHITE.faint(0.2), true);
        } else {
            let shade = [-0.5, -half, 0.0, half];
            (self.body).fade(shade, Ink::BLACK.faint(0.28), Ink::BLACK.faint(0.0), false);
            let shade = [0.0, -half, 0.5, half];
            (self.body).fade(shade, Ink::WHITE.faint(0.0), Ink::WHITE.faint(0.22), false);
        }
        self.body.go_outside();
        if !matches!(shape, Shape::Bus) {
            // Mirrors.
            let y = self.along(if shape == Shape::Van { 0.16 } else { 0.36 });
            for side in [-1.0, 1.0] {
                (self.body).oval(side * 0.49, y, 0.06, 0.045, dark);
            }
        }
    }

    /// Draws hood, windows and roof of a car.
    fn cabin(&mut self, shape: Shape) {
        let (screen, roof, rear, tail) = match shape {
            Shape::Hatchback => (0.27, 0.4, 0.82, 0.94),
            Shape::Estate => (0.28, 0.41, 0.85, 0.95),
            Shape::Pickup => (0.24, 0.36, 0.52, 0.58),
            Shape::Sports => (0.36, 0.5, 0.7, 0.86),
            _ => (0.28, 0.42, 0.7, 0.83),
        };
        let at = places(self.length);
        let [screen, roof, rear, tail, bonnet] = [screen, roof, rear, tail, 0.06].map(at);
        let (crease, glass) = (
            self.paint.lit(-0.3).faint(0.7),
            self.glass().lit(self.dice.between(0.0, 0.2)),
        );
        for side in [-1.0, 1.0] {
            (self.body).line(&[(side * 0.2, bonnet), (side * 0.26, screen)], 0.025, crease);
        }
        // Windshield, side windows, rear window.
        (self.body).polygon(&[(-0.41, screen), (0.41, screen), (0.33, roof), (-0.33, roof)], glass);
        (self.body).polygon(&[(-0.33, rear), (0.33, rear), (0.38, tail), (-0.38, tail)], glass);
        for side in [-1.0, 1.0] {
            let window = [
                (side * 0.42, screen + 0.07),
                (side * 0.35, roof + 0.02),
                (side * 0.35, rear - 0.02),
                (side * 0.41, tail - 0.05),
            ];
            self.body.polygon(&window, glass);
        }
        (self.body).polygon(
            &[
                (-0.2, screen + 0.02),
                (-0.05, screen + 0.02),
                (-0.12, roof),
                (-0.24, roof),
            ],
            glass.lit(0.25),
        );
        let top = match (self.dice.below(6), self.style) {
            (0, Style::Common) => Ink::hex(0x0020_2226),
            (1, Style::Common) => self.paint.lit(0.25),
            (_, Style::Common) => self.paint.lit(0.08),
            (0 | 1, Style::Test) => Ink::hex(0x00ec_e8de),
            (_, Style::Test) => self.paint.lit(-0.3),
        };
        self.body.round([-0.335, roof, 0.335, rear], 0.07, top);
        match (shape, self.dice.below(4)) {
            (Shape::Pickup, _) => self.cargo(tail),
            (Shape::Sports, _) => {}
            (_, 0) => {
                let end = roof + 0.55 * (rear - roof);
                (self.body).round([-0.22, roof + 0.07, 0.22, end], 0.05, glass.lit(0.08));
            }
            (Shape::Estate, _) => {
                for side in [-0.27, 0.27] {
                    (self.body).line(&[(side, roof + 0.06), (side, rear - 0.06)], 0.03, self.paint.lit(-0.5));
                }
            }
            _ => {}
        }
    }

    /// Draws the bed of a pickup and its load.
    fn cargo(&mut self, from: f32) {
        let end = self.along(0.96);
        self.body.round([-0.37, from, 0.37, end], 0.04, self.paint.lit(-0.55));
        for _ in 0..self.dice.below(4) {
            let (x, y) = (self.dice.between(-0.28, 0.1), self.dice.between(from, end - 0.25));
            let box_ink = self.dice.ink(&[0xa98255, 0x8f6b45, 0x55708c, 0xb9b3a5]);
            (self.body).rect([x, y, x + self.dice.between(0.12, 0.24), y + 0.2], box_ink);
        }
    }

    fn lamps(&mut self) {
        let (front, rear) = (self.along(0.02), self.along(0.985));
        let lamps = self
            .style
            .choose([0xfff4c2, 0xf4f8ff, 0xffe08a], [0xbfe4ff, 0x9fb0ba, 0xe8f6ff]);
        let lit = self.dice.ink(&lamps);
        for side in [-1.0, 1.0] {
            self.body.oval(side * 0.32, front, 0.1, 0.05, lit);
            self.body.oval(side * 0.33, rear, 0.1, 0.045, RED.lit(-0.1));
        }
    }

    fn bus_roof(&mut self) {
        let at = places(self.length);
        let [front, glass, first, last] = [0.012, 0.075, 0.1, 0.96].map(at);
        self.body.round([-0.42, front, 0.42, glass], 0.06, GLASS);
        self.body.rect([-0.3, front + 0.04, 0.3, front + 0.1], AMBER);
        // A row of windows along both sides.
        let windows = 6 + self.dice.below(3);
        #[allow(clippy::cast_precision_loss)]
        let step = (last - first) / windows as f32;
        for side in [-1.0_f32, 1.0] {
            let mut y = first;
            for _ in 0..windows {
                let (x0, x1) = (side * 0.45, side * 0.375);
                (self.body).rect([x0.min(x1), y + 0.035, x0.max(x1), y + step - 0.035], GLASS);
                y += step;
            }
        }
        let top = self.paint.lit(self.dice.between(0.1, 0.4));
        self.body.round([-0.35, first - 0.02, 0.35, last - 0.02], 0.06, top);
        match self.dice.below(4) {
            0 => self.body.rect([-0.06, first, 0.06, last], self.paint.lit(-0.2)),
            1 => {
                let band = self.dice.ink(&BUS_PAINTS);
                self.body.rect([-0.35, at(0.66), 0.35, at(0.76)], band);
            }
            2 => {
                for side in [-0.3, 0.3] {
                    self.body
                        .line(&[(side, first), (side, last)], 0.04, self.paint.lit(-0.25));
                }
            }
            _ => {}
        }
        // Hatches and air conditioning.
        let metal = Ink::hex(0x00c4_c8cb).lit(self.dice.between(-0.2, 0.1));
        for share in [0.22, 0.84] {
            let y = at(share) + self.dice.between(-0.04, 0.04);
            self.body
                .round([-0.17, y - 0.11, 0.17, y + 0.11], 0.04, metal.lit(-0.35));
            self.body.round([-0.145, y - 0.085, 0.145, y + 0.085], 0.03, metal);
        }
        let (y, deep) = (at(0.5), self.dice.between(0.16, 0.3));
        self.body
            .round([-0.24, y - deep, 0.24, y + deep], 0.05, metal.lit(-0.25));
        for line in [-0.6, -0.2, 0.2, 0.6] {
            (self.body).line(
                &[(-0.18, y + line * deep), (0.18, y + line * deep)],
                0.03,
                metal.lit(-0.55),
            );
        }
    }

    /// Draws the roof of a bus with one long pane along each side, and domes.
    fn coach_roof(&mut self) {
        let at = places(self.length);
        let [front, glass, first, last] = [0.02, 0.11, 0.14, 0.97].map(at);
        self.body.round([-0.4, front, 0.4, glass], 0.1, self.glass());
        for side in [-1.0_f32, 1.0] {
            let (x0, x1) = (side * 0.455, side * 0.36);
            (self.body).rect([x0.min(x1), first, x0.max(x1), last], self.glass());
            (self.body).line(&[(x1, first), (x1, last)], 0.02, self.paint.lit(0.5));
        }
        let top = self.paint.lit(self.dice.between(-0.3, 0.0));
        self.body.round([-0.34, first, 0.34, last], 0.03, top);
        let band = self.dice.ink(&TEST_BUS_PAINTS);
        let (from, to) = (self.dice.between(0.2, 0.5), self.dice.between(0.6, 0.9));
        (self.body).polygon(
            &[
                (-0.34, at(from)),
                (0.34, at(from + 0.06)),
                (0.34, at(to)),
                (-0.34, at(to - 0.06)),
            ],
            band,
        );
        for share in [0.24, 0.42, 0.6, 0.78] {
            let radius = self.dice.between(0.09, 0.13);
            self.body
                .oval(0.0, at(share), radius + 0.025, radius + 0.025, top.lit(-0.5));
            self.body.oval(0.0, at(share), radius, radius, self.glass().lit(0.2));
        }
    }

    fn van_roof(&mut self) {
        let at = places(self.length);
        let [screen, cab, box_front, end] = [0.09, 0.2, 0.31, 0.985].map(at);
        let glass = self.glass();
        (self.body).polygon(&[(-0.37, screen), (0.37, screen), (0.32, cab), (-0.32, cab)], glass);
        (self.body).round([-0.31, cab, 0.31, box_front], 0.04, self.paint.lit(0.15));
        let top = self.paint.lit(self.style.choose(0.3, -0.12));
        (self.body).round([-0.44, box_front, 0.44, end], 0.04, top);
        (self.body).line(&[(-0.46, box_front), (0.46, box_front)], 0.03, self.paint.lit(-0.4));
    }

    /// Draws the marks of all concepts, each in its place along the car so that none hides another.
    fn liveries(&mut self, features: &Features, shape: Shape) {
        let is_common = self.style == Style::Common;
        if features.police {
            match is_common {
                true => self.police(shape),
                false => self.patrol(shape),
            }
        }
        if features.ambulance {
            match is_common {
                true => self.ambulance(shape),
                false => self.rescue(shape),
            }
        }
        if features.reckless {
            match is_common {
                true => self.stripes(shape),
                false => self.racing_number(shape),
            }
        }
        if features.tiro {
            self.learner(shape, features.ambulance || features.police);
        }
    }

    /// Draws a light bar across the roof.
    fn light_bar(&mut self, y: f32, left: Ink, right: Ink) {
        let half = self.dice.between(0.3, 0.36);
        self.body.round(
            [-half - 0.02, y - 0.085, half + 0.02, y + 0.085],
            0.04,
            Ink::hex(0x0012_1418),
        );
        self.body.round([-half, y - 0.065, -0.07, y + 0.065], 0.03, left);
        self.body.round([0.07, y - 0.065, half, y + 0.065], 0.03, right);
        self.body
            .rect([-0.07, y - 0.045, 0.07, y + 0.045], Ink::hex(0x00e8_eef2));
        for (x, ink) in [(-half * 0.6, left), (half * 0.6, right)] {
            self.body.oval(x, y, 0.05, 0.035, ink.lit(0.65));
        }
    }

    fn police(&mut self, shape: Shape) {
        let light = u32::from(self.paint.rgb[1]) > 130;
        let contrast = if light {
            self.dice.ink(&[0x1b3f8f, 0x15171d, 0x2456b8])
        } else {
            self.dice.ink(&[0xf5f6f7, 0xeef1f4])
        };
        let (from, to) = match shape {
            Shape::Bus => (0.3, 0.42),
            Shape::Van => (0.4, 0.52),
            _ => (0.3, 0.9),
        };
        let [from, to] = [from, to].map(|share| self.along(share));
        let band = self.worn(contrast);
        match (shape, self.dice.below(3)) {
            // Doors and roof in the second color.
            (Shape::Saloon | Shape::Estate, 0) => {
                for side in [-1.0_f32, 1.0] {
                    let (x0, x1) = (side * 0.5, side * 0.41);
                    self.body.rect([x0.min(x1), from, x0.max(x1), to], band);
                }
                let roof = [-0.335, self.along(0.42), 0.335, self.along(0.68)];
                self.body.round(roof, 0.06, band);
            }
            // Checkered sides.
            (_, 1) => {
                let step = (to - from) / 6.0;
                for (row, x) in [(0, 0.44), (1, 0.38)] {
                    for square in (row..6).step_by(2) {
                        #[allow(clippy::cast_precision_loss)]
                        let y = from + step * square as f32;
                        for left in [-x - 0.06, x] {
                            self.body.rect([left, y, left + 0.06, y + step], band);
                        }
                    }
                }
            }
            // Hood and trunk.
            _ => {
                self.body.rect([-0.5, self.along(0.1), 0.5, self.along(0.17)], band);
                self.body.rect([-0.5, self.along(0.9), 0.5, self.along(0.96)], band);
            }
        }
        let roof = match shape {
            Shape::Bus => 0.3,
            Shape::Van => 0.36,
            _ => 0.5,
        };
        let (bar, text) = (self.along(roof), self.along(roof + 0.14));
        let (left, right) = self.dice.pick(&[(RED, BLUE), (BLUE, RED), (BLUE, BLUE)]);
        self.light_bar(bar, left, right);
        let dark = if light { Ink::hex(0x0010_1828) } else { contrast };
        let sign = self.dice.pick(&["POLICE", "POLICE", "112", "K9", "7"]);
        let ink = self.worn(dark);
        self.body.rect(
            [-0.3, text - 0.08, 0.3, text + 0.08],
            self.worn(if light {
                contrast.lit(0.75)
            } else {
                Ink::hex(0x0023_2a3a)
            }),
        );
        self.body.letters(sign, (0.0, text), 0.11, 0.022, ink);
    }

    /// Draws the marks of police in the test style: slanted bands, a badge on the hood, a light bar and a number.
    fn patrol(&mut self, shape: Shape) {
        let light = u32::from(self.paint.rgb[1]) > 130;
        let contrast = match light {
            true => self.dice.ink(&[0x14532d, 0x5a4a1e, 0x30343a]),
            false => self.dice.ink(&[0xe9d94a, 0xd8e0e4, 0xf0b53a]),
        };
        let band = self.worn(contrast);
        let (roof, from) = match shape {
            Shape::Bus => (0.3, 0.4),
            Shape::Van => (0.36, 0.4),
            _ => (0.46, 0.3),
        };
        let at = places(self.length);
        for (number, side) in [-1.0_f32, 1.0, -1.0, 1.0, -1.0, 1.0].into_iter().enumerate() {
            #[allow(clippy::cast_precision_loss)]
            let y = at(from) + 0.2 * (number / 2) as f32;
            let slant = [
                (side * 0.5, y),
                (side * 0.4, y + 0.1),
                (side * 0.4, y + 0.2),
                (side * 0.5, y + 0.1),
            ];
            self.body.polygon(&slant, band);
        }
        let lights = [(BLUE, AMBER), (BLUE, Ink::WHITE), (AMBER, BLUE), (BLUE, BLUE)];
        let (left, right) = self.dice.pick(&lights);
        self.light_bar(at(roof), left, right);
        let sign = self.dice.pick(&["911", "K2", "POLIS", "44"]);
        let ink = self.worn(contrast.lit(if light { -0.3 } else { 0.3 }));
        self.body.letters(sign, (0.0, at(roof + 0.13)), 0.13, 0.03, ink);
        let radius = self.dice.between(0.11, 0.15);
        self.star((0.0, at(0.13)), radius, band);
    }

    /// Draws a star with six points.
    fn star(&mut self, (x, y): (f32, f32), radius: f32, ink: Ink) {
        let (far, near) = (0.866 * radius, 0.5 * radius);
        for up in [-1.0, 1.0] {
            let points = [(x, y + up * radius), (x + far, y - up * near), (x - far, y - up * near)];
            self.body.polygon(&points, ink);
        }
    }

    /// Draws the marks of an ambulance in the test style: chevrons across the rear, a crescent or a heart, and lights.
    fn rescue(&mut self, shape: Shape) {
        let is_red = self.paint.rgb[0] > 190 && self.paint.rgb[1] < 140;
        let marking = match is_red {
            true => self.dice.ink(&[0xf6f2e6, 0xf4e04a]),
            false => self.dice.ink(&[0xc21f3a, 0x0f6e4a, 0x9a1f6a]),
        };
        let marking = self.worn(marking);
        let at = places(self.length);
        let bus = shape == Shape::Bus;
        for share in [0.82, 0.88, 0.94] {
            let y = at(share);
            self.body
                .line(&[(-0.42, y + 0.06), (0.0, y - 0.06), (0.42, y + 0.06)], 0.055, marking);
        }
        let [from, to] = [if bus { 0.45 } else { 0.34 }, 0.78].map(at);
        for x in [-0.45_f32, 0.4] {
            let edges: Edges = [x, from, x + 0.05, to];
            self.body.rect(edges, marking);
        }
        let (middle, radius) = (at(if bus { 0.62 } else { 0.58 }), self.dice.between(0.22, 0.27));
        let (disc, inner) = (self.worn(Ink::hex(0x00f4_f1ea)), radius * 0.8);
        self.body.oval(0.0, middle, radius + 0.05, radius + 0.05, disc);
        if self.dice.chance(0.5) {
            self.body.oval(0.0, middle, inner, inner, marking);
            self.body.oval(inner * 0.35, middle, inner * 0.78, inner * 0.78, disc);
        } else {
            for side in [-1.0, 1.0] {
                self.body.oval(
                    side * inner * 0.42,
                    middle - inner * 0.3,
                    inner * 0.5,
                    inner * 0.5,
                    marking,
                );
            }
            let low = [
                (-inner * 0.88, middle - inner * 0.1),
                (inner * 0.88, middle - inner * 0.1),
                (0.0, middle + inner),
            ];
            self.body.polygon(&low, marking);
        }
        let (left, right) = self.dice.pick(&[(AMBER, AMBER), (BLUE, AMBER), (RED, Ink::WHITE)]);
        self.light_bar(at(if bus { 0.4 } else { 0.36 }), left, right);
    }

    fn ambulance(&mut self, shape: Shape) {
        let red = self.dice.ink(&[0xd81f2a, 0xd81f2a, 0xe4572e, 0x1f5fd0, 0x1d8a4a]);
        let marking = self.worn(red);
        let at = places(self.length);
        let bus = shape == Shape::Bus;
        // Stripes or blocks along the sides of the box.
        let [from, to] = [if bus { 0.5 } else { 0.33 }, 0.97].map(at);
        let style = self.dice.below(3);
        for left in [-0.475, 0.375] {
            if style == 0 {
                self.body.rect([left, from, left + 0.1, to], marking);
            } else {
                let blocks: u8 = if style == 1 { 5 } else { 9 };
                let step = (to - from) / f32::from(blocks);
                for block in (0..blocks).step_by(2) {
                    let y = from + step * f32::from(block);
                    self.body.rect([left, y, left + 0.1, y + step], marking);
                }
            }
        }
        // A cross or the six-armed star of life.
        let (middle, arm) = (at(if bus { 0.68 } else { 0.63 }), self.dice.between(0.25, 0.31));
        let thick = arm * self.dice.between(0.34, 0.42);
        if self.dice.chance(0.5) {
            (self.body).oval(0.0, middle, arm + 0.06, arm + 0.06, self.worn(Ink::WHITE));
        }
        if self.dice.chance(0.72) {
            self.body.rect([-arm, middle - thick, arm, middle + thick], marking);
            self.body.rect([-thick, middle - arm, thick, middle + arm], marking);
        } else {
            for (x, y) in [(0.0, 1.0), (0.866, 0.5), (0.866, -0.5)] {
                let ends = [(-x * arm, middle - y * arm), (x * arm, middle + y * arm)];
                self.body.line(&ends, thick * 1.1, marking);
            }
            self.body.line(
                &[(0.0, middle - arm * 0.7), (0.0, middle + arm * 0.7)],
                thick * 0.3,
                Ink::WHITE,
            );
        }
        let (left, right) = self.dice.pick(&[(RED, BLUE), (BLUE, BLUE), (RED, RED), (BLUE, RED)]);
        let bar = at(if bus { 0.4 } else { 0.36 });
        self.light_bar(bar, left, right);
        for side in [-0.36, 0.36] {
            self.body
                .round([side - 0.06, at(0.93), side + 0.06, at(0.965)], 0.02, left);
        }
    }

    /// Draws stripes from front to rear, or flames or flashes on the hood.
    fn stripes(&mut self, shape: Shape) {
        let light = self.paint.rgb.iter().map(|&channel| u32::from(channel)).sum::<u32>() > 330;
        let ink = if light {
            self.dice.ink(&[0x101114, 0x1a1a1f, 0xc01818])
        } else {
            self.dice.ink(&[0xf8f8f4, 0xffd21c, 0xff4a1c])
        };
        let ink = self.worn(ink);
        let (half, glass_end) = (self.length / 2.0, self.along(0.36));
        let (offset, wide) = (self.dice.between(0.07, 0.13), self.dice.between(0.035, 0.07));
        let style = self.dice.below(3);
        let centers: &[f32] = if style == 2 { &[0.12] } else { &[-1.0, 1.0] };
        for &side in centers {
            let x = if style == 2 { side } else { side * offset };
            let wide = if style == 2 { wide * 1.8 } else { wide };
            if shape == Shape::Bus || shape == Shape::Van {
                self.body.rect([x - wide, -half, x + wide, half], ink);
            } else {
                // Leaves out the windows.
                let [roof, rear, tail] = [0.5, 0.7, 0.86].map(|share| self.along(share));
                for [from, to] in [[-half, glass_end], [roof, rear], [tail, half]] {
                    self.body.rect([x - wide, from, x + wide, to], ink);
                }
            }
        }
        if style == 1 {
            // Flames from the front along both sides.
            let flame = self.dice.ink(&[0xff8a00, 0xffc400, 0xff3d00]);
            let flame = self.worn(flame);
            let y = places(self.length);
            for side in [-1.0, 1.0] {
                let points = [
                    (side * 0.47, y(0.05)),
                    (side * 0.2, y(0.06)),
                    (side * 0.3, y(0.16)),
                    (side * 0.24, y(0.26)),
                    (side * 0.36, y(0.2)),
                    (side * 0.36, y(0.38)),
                    (side * 0.48, y(0.24)),
                ];
                self.body.polygon(&points, flame);
            }
        }
    }

    /// Draws a number in a disc, and a striped band across the hood or the trunk.
    fn racing_number(&mut self, shape: Shape) {
        let at = places(self.length);
        let wide = matches!(shape, Shape::Bus | Shape::Van);
        let rows = if self.dice.chance(0.5) { 0.06 } else { 0.86 };
        // Two rows have a seam that one row of stripes would lack.
        for row in 0..2_u8 {
            for square in 0..8_u8 {
                let ink = if square % 2 == 0 { Ink::WHITE } else { Ink::BLACK };
                let x = -0.4 + 0.1 * f32::from(square);
                let y = at(rows) + 0.1 * f32::from(row);
                self.body.rect([x, y, x + 0.1, y + 0.1], self.worn(ink));
            }
        }
        let y = at(if wide { 0.5 } else { 0.6 });
        let number = self.dice.pick(&["7", "13", "22", "88", "5"]);
        self.body.oval(0.0, y, 0.22, 0.22, self.worn(Ink::hex(0x00f2_efe2)));
        self.body.letters(number, (0.0, y), 0.2, 0.05, Ink::BLACK);
    }

    /// Draws a wing across the rear.
    fn spoiler(&mut self) {
        let y = self.along(0.95);
        let wing = self.paint.lit(self.dice.pick(&[-0.7, -0.55, -0.4]));
        for x in [-0.27, 0.27] {
            (self.body).line(&[(x, y - 0.1), (x, y)], 0.05, wing);
        }
        (self.body).round([-0.5, y - 0.045, 0.5, y + 0.065], 0.03, Ink::BLACK);
        (self.body).round([-0.48, y - 0.03, 0.48, y + 0.035], 0.03, wing.lit(0.15));
    }

    /// Draws skid marks behind the rear wheels, and smoke.
    fn skid_marks(&mut self) {
        let (from, bend) = (self.along(0.85), self.dice.between(-0.22, 0.22));
        let end = self.length / 2.0 + self.dice.between(0.45, 0.75);
        for side in [-0.38, 0.38] {
            let points: Vec<(f32, f32)> = (0..=6_u8)
                .map(|step| f32::from(step) / 6.0)
                .map(|share| (side + bend * share * share, from + (end - from) * share))
                .collect();
            (self.ground).line(
                &points,
                0.11,
                Ink::hex(0x0014_1416).faint(0.55 * (1.0 - 0.5 * self.wear)),
            );
        }
        for _ in 0..3 + self.dice.below(4) {
            let (x, y) = (
                self.dice.between(-0.5, 0.5),
                self.along(1.0) + self.dice.between(0.0, 0.25),
            );
            let size = self.dice.between(0.06, 0.16);
            self.ground.oval(x, y, size, size, Ink::hex(0x00e6_e6e6).faint(0.35));
        }
    }

    /// Draws the marks of a learner: a plate with a red L on the roof, often another on hood or trunk, and a sign.
    fn learner(&mut self, shape: Shape, crowded: bool) {
        let at = places(self.length);
        let sign = self.dice.ink(&[0xffd400, 0xf7f7f7, 0x1d9e5a, 0xff8a1c]);
        let roof = match shape {
            Shape::Bus => 0.2,
            Shape::Van => 0.84,
            Shape::Sports => 0.6,
            _ if crowded => 0.1,
            Shape::Hatchback => 0.63,
            _ => 0.55,
        };
        let side = if crowded && shape != Shape::Bus {
            0.15
        } else {
            self.dice.between(0.19, 0.24)
        };
        if self.dice.chance(0.6) && !crowded && shape != Shape::Sports {
            // The sign of a driving school across the roof, in front of the plate.
            let y = at(roof) - side - 0.1;
            self.body.round([-0.33, y - 0.07, 0.33, y + 0.07], 0.03, sign.lit(-0.5));
            self.body
                .round([-0.31, y - 0.05, 0.31, y + 0.05], 0.03, self.worn(sign));
        }
        self.plate(0.0, at(roof), side);
        if self.dice.chance(0.7) && !crowded {
            let x = self.dice.pick(&[-0.2, 0.0, 0.2]);
            self.plate(x, at(0.13), 0.12);
        }
        if self.dice.chance(0.4) {
            let x = self.dice.pick(&[-0.22, 0.22]);
            self.plate(x, at(0.92), 0.09);
        }
    }

    fn plate(&mut self, x: f32, y: f32, half: f32) {
        if self.style == Style::Test {
            let (ground, letter) = self.dice.pick(&[
                (Ink::hex(0x001d_6fd0), Ink::WHITE),
                (Ink::hex(0x00f2_c81e), Ink::BLACK),
                (Ink::hex(0x0023_9a55), Ink::WHITE),
            ]);
            self.body.oval(x, y, half * 1.08, half * 1.08, Ink::WHITE);
            self.body.oval(x, y, half * 0.94, half * 0.94, ground);
            (self.body).letters("L", (x, y), half * 1.1, half * 0.32, self.worn(letter));
            return;
        }
        self.body
            .round([x - half, y - half, x + half, y + half], 0.03, Ink::hex(0x0030_3236));
        let inner = half * 0.9;
        self.body
            .round([x - inner, y - inner, x + inner, y + inner], 0.03, Ink::WHITE);
        let red = self.worn(RED);
        (self.body).letters("L", (x, y), half * 1.15, half * 0.36, red);
    }

    /// Draws dust, scratches and leaves.
    fn dirt(&mut self, noise: f32) {
        let most = 2.0 + 14.0 * noise;
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
        for _ in 0..self.dice.between(0.0, most) as u32 {
            let (x, y) = (self.dice.between(-0.45, 0.45), self.dice.between(0.02, 0.98));
            let y = self.along(y);
            let ink = self.dice.ink(&[0x5b4a36, 0x2b2a28, 0xb8b2a2, 0x6c7a3c]);
            let faint = ink.faint(self.dice.between(0.1, 0.25 + 0.5 * noise));
            if self.dice.chance(0.3) {
                let end = (x + self.dice.between(-0.12, 0.12), y + self.dice.between(-0.3, 0.3));
                self.body.line(&[(x, y), end], 0.018, faint);
            } else {
                let size = self.dice.between(0.015, 0.04 + 0.07 * noise);
                self.body.oval(x, y, size, size * self.dice.between(0.6, 1.4), faint);
            }
        }
    }
}
