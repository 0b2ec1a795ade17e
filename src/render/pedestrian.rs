//! Parametric drawings of pedestrians. A figure stands in a square of side 1 around the origin.

use crate::render::difficulty::Style;
use crate::render::sketch::{Dice, Ink, Sketch};
use crate::rng::Rng;

/// The concepts of a pedestrian.
#[derive(Clone, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Features {
    pub(super) old: bool,
    pub(super) young: bool,
}

/// The side of a figure that the viewer sees.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Side {
    /// It walks down the picture.
    Front,
    /// It walks up.
    Back,
    /// It walks to the left.
    Left,
    /// It walks to the right.
    Right,
}

const SKINS: [u32; 6] = [0xf6d3b3, 0xeabf97, 0xd9a273, 0xb97f52, 0x8d5a36, 0x633d26];
const HAIRS: [u32; 6] = [0x2a1d14, 0x4a2f1c, 0x7a4e26, 0xb98a44, 0x16161a, 0x93391f];
const CLOTHES: [u32; 10] = [
    0x2f5d8a, 0x8a2f3d, 0x3f6b4f, 0x4a4a55, 0xb8763a, 0x6d4b86, 0x2a8a8f, 0xd0c7b4, 0x25282e, 0x9a9f45,
];
const BRIGHT: [u32; 8] = [
    0xff4f5e, 0xffb400, 0x2fb8ff, 0x4ccf4f, 0xff7ac2, 0xa25bff, 0xff7a2f, 0xfff04a,
];
const MUTED: [u32; 7] = [0x7b6a57, 0x5f6b5d, 0x6a6f7c, 0x8c7d6a, 0x74596a, 0xa39a86, 0x4d5a68];
const TROUSERS: [u32; 6] = [0x2b3346, 0x3c3a38, 0x54606f, 0x6b5a48, 0x1f2226, 0x7d828a];

// The palettes of the test style.
const TEST_CLOTHES: [u32; 8] = [
    0xd9d2e0, 0x1f6b66, 0xc24f86, 0x8fb8d6, 0x5c3a2a, 0xe0c04a, 0x34405e, 0xa4b88a,
];
const TEST_BRIGHT: [u32; 6] = [0x9ed8c6, 0xd3b3e6, 0xf3c6a5, 0x6b8f3a, 0xc9dcf2, 0x8c5a3c];
const TEST_MUTED: [u32; 6] = [0x2b2b30, 0x5a1f2c, 0xe6e0d2, 0x1f3a4a, 0x46361f, 0x9fb0c0];

/// Draws a pedestrian, in clothes of `color` if it is given. `noise` is the difficulty, 0..=1: more of it makes the types
/// share clothes.
///
/// Figures have the proportions of their concepts in both styles. The test style has other colors, light and things.
pub(super) fn draw<R: Rng>(
    features: &Features,
    side: Side,
    dice: &mut Dice<R>,
    noise: f32,
    (style, color): (Style, Option<Ink>),
) -> Sketch {
    let Features { old, young } = *features;
    let clothes = style.choose(&CLOTHES[..], &TEST_CLOTHES[..]);
    let bright = style.choose(&BRIGHT[..], &TEST_BRIGHT[..]);
    let adult_coat = dice.ink(clothes);
    let coat = match (young, old) {
        (true, _) => dice.ink(bright),
        (_, true) => dice.ink(style.choose(&MUTED[..], &TEST_MUTED[..])),
        _ => dice.ink(clothes),
    };
    let hair = if old {
        dice.ink(&[0xf4f4f2, 0xd9d9d6, 0xbfc0c2])
    } else {
        dice.ink(&HAIRS)
    };
    // A child is smaller, with a larger head for its size.
    let tall = if young {
        dice.between(0.7, 0.78)
    } else if old {
        dice.between(0.88, 0.94)
    } else {
        dice.between(0.94, 1.0)
    };
    let head = tall
        * if young {
            dice.between(0.2, 0.225)
        } else {
            dice.between(0.132, 0.15)
        };
    let mut figure = Figure {
        tall,
        head,
        foot: 0.49,
        lean: if old { dice.between(0.07, 0.12) } else { 0.0 },
        stride: dice.between(0.04, 0.1) * if old { 0.6 } else { 1.0 },
        wide: dice.between(0.15, 0.19) * if young { 0.85 } else { 1.0 },
        coat: {
            let drawn = coat.mix(adult_coat, noise * dice.between(0.0, 0.8));
            color.unwrap_or(drawn)
        },
        trousers: dice.ink(if young { bright } else { &TROUSERS }),
        skin: dice.ink(&SKINS),
        hair,
        side,
        style,
        dice,
        sketch: Sketch::default(),
    };
    let is_common = style == Style::Common;
    if young && is_common {
        figure.satchel_behind();
    }
    figure.legs(young);
    figure.body(young, old);
    figure.face(old);
    match (old, young, is_common) {
        (true, _, true) => figure.cane(),
        (true, _, false) => figure.frame_and_hat(),
        (false, false, true) => figure.carried(),
        (false, false, false) => figure.umbrella(),
        (false, true, _) => {}
    }
    match (young, is_common) {
        (true, true) => figure.toy(),
        (true, false) => figure.scooter(),
        (false, _) => {}
    }
    figure.sketch
}

struct Figure<'a, R> {
    /// Heights and widths are in sides of the square.
    tall: f32,
    /// Radius.
    head: f32,
    /// The position of the feet.
    foot: f32,
    /// The distance of the head ahead of the feet.
    lean: f32,
    stride: f32,
    wide: f32,
    coat: Ink,
    trousers: Ink,
    skin: Ink,
    hair: Ink,
    side: Side,
    style: Style,
    dice: &'a mut Dice<R>,
    sketch: Sketch,
}

impl<R: Rng> Figure<'_, R> {
    /// Returns -1 if the figure faces left, else 1.
    fn ahead(&self) -> f32 {
        if self.side == Side::Left { -1.0 } else { 1.0 }
    }

    fn in_profile(&self) -> bool {
        matches!(self.side, Side::Left | Side::Right)
    }

    /// Returns a height: 0 is the top of the head, 1 the feet.
    fn level(&self, share: f32) -> f32 {
        self.foot - self.tall * (1.0 - share)
    }

    fn shoulder(&self) -> f32 {
        self.level(0.0) + 1.9 * self.head
    }

    fn hip(&self) -> f32 {
        let shoulder = self.shoulder();
        shoulder + 0.52 * (self.foot - shoulder)
    }

    /// Returns the center of the head.
    fn head_middle(&self) -> (f32, f32) {
        (self.ahead() * self.lean, self.level(0.0) + self.head + 0.4 * self.lean)
    }

    fn legs(&mut self, young: bool) {
        let (hip, foot, stride) = (self.hip(), self.foot - 0.03, self.stride);
        let thick = if young { 0.105 } else { 0.115 };
        let shoe = self.dice.ink(&[0x1b1b1e, 0x4a2d1c, 0xe9e9ea, 0x7a1f2a]);
        let apart = if self.in_profile() { stride } else { 0.065 };
        let bare = young && self.dice.chance(0.5);
        for side in [-1.0, 1.0] {
            let x = side * apart;
            let start = (side * 0.05, hip - 0.03);
            let knee = (x * 0.8, (hip + foot) / 2.0);
            let dark = if side < 0.0 { -0.18 } else { 0.0 };
            self.sketch
                .line(&[start, knee, (x, foot)], thick, self.trousers.lit(dark - 0.1));
            if bare {
                self.sketch.line(&[knee, (x, foot)], thick * 0.8, self.skin.lit(dark));
            }
            let toe = if self.in_profile() { 0.05 * self.ahead() } else { 0.0 };
            self.sketch.oval(x + toe * 0.6, foot, 0.07, 0.038, shoe);
        }
    }

    fn body(&mut self, young: bool, old: bool) {
        let (shoulder, hip) = (self.shoulder(), self.hip());
        let (wide, lean) = (
            self.wide * if self.in_profile() { 0.82 } else { 1.0 },
            self.ahead() * self.lean * 0.75,
        );
        let long = !young && self.dice.chance(0.35);
        let hem = if long { hip + 0.13 } else { hip + 0.03 };
        let flare = if long { 1.12 } else { 0.92 };
        let outline = self.coat.lit(self.style.choose(-0.5, 0.45));
        let swing = if self.in_profile() { 0.1 } else { 0.03 };
        let arm = |side: f32| {
            let out = if swing > 0.05 { 0.0 } else { side * (wide + 0.02) };
            [
                (lean + out * 0.9, shoulder + 0.05),
                (lean + out + side * swing * 0.6, (shoulder + hip) / 2.0 + 0.02),
                (lean * 0.6 + out + side * swing, hip + 0.01),
            ]
        };
        // The far arm, the body, the near arm.
        let sleeve = 0.085;
        self.sketch.line(&arm(-1.0), sleeve, self.coat.lit(-0.3));
        for (grow, ink) in [(0.02, outline), (0.0, self.coat)] {
            let points = [
                (lean - wide * 0.75 - grow, shoulder - grow),
                (lean + wide * 0.75 + grow, shoulder - grow),
                (lean + wide + grow, shoulder + 0.07),
                (wide * flare + grow, hem + grow),
                (-wide * flare - grow, hem + grow),
                (lean - wide - grow, shoulder + 0.07),
            ];
            self.sketch.polygon(&points, ink);
        }
        (self.sketch).polygon(
            &[
                (lean + wide * 0.3, shoulder),
                (lean + wide, shoulder + 0.07),
                (wide * flare, hem),
                (wide * 0.3, hem),
            ],
            Ink::BLACK.faint(0.15),
        );
        if self.side != Side::Back {
            match self.dice.below(4) {
                // Buttons, a band, a shirt and tie, or nothing.
                0 => self.sketch.line(&[(lean, shoulder + 0.03), (0.0, hem)], 0.018, outline),
                1 => (self.sketch).rect(
                    [lean - wide * 0.9, shoulder + 0.13, lean + wide * 0.9, shoulder + 0.18],
                    self.coat.lit(0.4),
                ),
                2 if !young && !old => {
                    let shirt = [
                        (lean - 0.05, shoulder),
                        (lean + 0.05, shoulder),
                        (lean, shoulder + 0.15),
                    ];
                    self.sketch.polygon(&shirt, Ink::WHITE);
                    self.sketch.line(
                        &[(lean, shoulder + 0.02), (lean, shoulder + 0.13)],
                        0.02,
                        Ink::hex(0x00a0_2030),
                    );
                }
                _ => {}
            }
        }
        self.sketch.line(&arm(1.0), sleeve, self.coat.lit(-0.12));
        let hand = arm(1.0)[2];
        self.sketch.oval(hand.0, hand.1 + 0.03, 0.04, 0.04, self.skin);
    }

    fn face(&mut self, old: bool) {
        let ((x, y), r, ahead) = (self.head_middle(), self.head, self.ahead());
        let dark = self.skin.lit(-0.45);
        let style = self.dice.below(4);
        let bald = old && style == 0;
        if !bald && style == 1 {
            // Long hair, or a bun.
            if old {
                self.sketch.oval(
                    x - ahead * r * 0.5,
                    y - r * 1.05,
                    r * 0.5,
                    r * 0.45,
                    self.hair.lit(-0.1),
                );
            } else {
                // In profile it falls only on the back.
                let (near, far) = if self.in_profile() {
                    (-ahead * 0.1, -ahead * 1.15)
                } else {
                    (1.1, -1.1)
                };
                let long = [x + r * near.min(far), y - r * 0.2, x + r * near.max(far), y + r * 1.5];
                self.sketch.round(long, r * 0.5, self.hair.lit(-0.15));
            }
        }
        self.sketch.oval(x, y, r * 1.08, r * 1.08, dark);
        self.sketch.oval(x, y, r, r, self.skin);
        if bald {
            for side in [-1.0, 1.0] {
                self.sketch
                    .oval(x + side * r * 0.9, y + r * 0.1, r * 0.3, r * 0.45, self.hair);
            }
        } else if self.side == Side::Back {
            self.sketch.oval(x, y - r * 0.05, r * 1.05, r, self.hair);
        } else {
            let back = if self.in_profile() { -ahead * r * 0.45 } else { 0.0 };
            let fringe = [
                (x - r * 1.1, y + r * 0.1),
                (x - r * 1.0, y - r * 1.1),
                (x, y - r * 1.45),
                (x + r * 1.0, y - r * 1.1),
                (x + r * 1.1, y + r * 0.1),
                (x + back, y - r * 0.35),
            ];
            self.sketch.polygon(&fringe, self.hair);
            if self.in_profile() {
                self.sketch
                    .oval(x + back * 1.3, y - r * 0.1, r * 0.62, r * 0.85, self.hair);
            }
        }
        if self.side == Side::Back {
            return;
        }
        let shift = if self.in_profile() { ahead * r * 0.4 } else { 0.0 };
        let eyes: &[f32] = if self.in_profile() { &[0.25] } else { &[-0.36, 0.36] };
        for &eye in eyes {
            let at = x + shift + ahead * eye * r;
            if old {
                // Glasses.
                self.sketch
                    .oval(at, y + r * 0.05, r * 0.33, r * 0.3, Ink::hex(0x0025_2628));
                self.sketch
                    .oval(at, y + r * 0.05, r * 0.22, r * 0.2, Ink::hex(0x00e4_eef4));
            } else {
                self.sketch
                    .oval(at, y + r * 0.05, r * 0.13, r * 0.17, Ink::hex(0x0020_1a18));
            }
        }
        if old && self.dice.chance(0.5) {
            // A beard.
            let beard = [
                (x + shift - r * 0.8, y + r * 0.35),
                (x + shift + r * 0.8, y + r * 0.35),
                (x + shift + r * 0.45, y + r * 1.25),
                (x + shift - r * 0.45, y + r * 1.25),
            ];
            self.sketch
                .blob(&beard.map(|point| [point, point]).concat(), self.hair.lit(0.1));
        } else {
            let smile = [
                (x + shift - r * 0.25, y + r * 0.5),
                (x + shift, y + r * 0.58),
                (x + shift + r * 0.25, y + r * 0.5),
            ];
            self.sketch.line(&smile, r * 0.12, dark);
        }
    }

    /// Draws the cane of an old figure, sometimes a walker instead.
    fn cane(&mut self) {
        let (ahead, hip, foot) = (self.ahead(), self.hip(), self.foot);
        let wood = self.dice.ink(&[0x5b3a1e, 0x2b2220, 0x8a5c2c]);
        let x = ahead * self.dice.between(0.3, 0.36);
        if self.dice.chance(0.25) {
            let metal = Ink::hex(0x0078_808a);
            let near = ahead * 0.2;
            (self.sketch).line(
                &[
                    (near, hip - 0.04),
                    (x + ahead * 0.06, hip - 0.04),
                    (x + ahead * 0.1, foot),
                ],
                0.035,
                metal,
            );
            (self.sketch).line(&[(near + ahead * 0.02, hip), (near, foot)], 0.035, metal);
            (self.sketch).line(&[(near, hip + 0.12), (x + ahead * 0.07, hip + 0.12)], 0.025, metal);
        } else {
            let top = hip - 0.06;
            let bow = [
                (x - ahead * 0.1, top + 0.01),
                (x - ahead * 0.06, top - 0.035),
                (x, top),
                (x + ahead * 0.01, foot),
            ];
            self.sketch.line(&bow, 0.04, wood);
        }
        // The hand on the cane.
        let shoulder = self.shoulder();
        let arm = [
            (ahead * 0.1, shoulder + 0.07),
            (ahead * 0.2, hip - 0.09),
            (x - ahead * 0.06, hip - 0.05),
        ];
        self.sketch.line(&arm, 0.08, self.coat.lit(-0.2));
        self.sketch.oval(x - ahead * 0.05, hip - 0.05, 0.042, 0.042, self.skin);
    }

    /// Draws what an adult carries: a case, a bag, a hat, or nothing.
    fn carried(&mut self) {
        let (hip, ahead) = (self.hip(), self.ahead());
        let ((x, y), r) = (self.head_middle(), self.head);
        let leather = self.dice.ink(&[0x5a3620, 0x24262b, 0x7a2a2a, 0xc9b48a]);
        match self.dice.below(4) {
            0 => {
                let left = -ahead * (self.wide + 0.07);
                self.sketch
                    .line(&[(left, hip), (left, hip + 0.06)], 0.03, leather.lit(-0.4));
                self.sketch
                    .round([left - 0.1, hip + 0.05, left + 0.1, hip + 0.2], 0.02, leather);
            }
            1 => {
                let strap = [
                    (-ahead * self.wide * 0.7, self.shoulder()),
                    (ahead * self.wide * 0.9, hip),
                ];
                self.sketch.line(&strap, 0.03, leather.lit(-0.3));
                let bag = ahead * self.wide;
                self.sketch
                    .round([bag - 0.07, hip - 0.04, bag + 0.07, hip + 0.1], 0.03, leather);
            }
            2 => {
                let hat = self.dice.ink(&CLOTHES);
                self.sketch.round(
                    [x - r * 1.5, y - r * 0.75, x + r * 1.5, y - r * 0.45],
                    r * 0.15,
                    hat.lit(-0.2),
                );
                self.sketch
                    .round([x - r * 0.85, y - r * 1.5, x + r * 0.85, y - r * 0.6], r * 0.3, hat);
            }
            _ => {}
        }
    }

    /// Draws the walking frame and the flat hat of an old figure in the test style.
    fn frame_and_hat(&mut self) {
        let (ahead, hip, foot) = (self.ahead(), self.hip(), self.foot);
        let metal = self.dice.ink(&[0x8a949c, 0x3a3f45, 0xb23a3a]);
        let (near, far) = (ahead * 0.17, ahead * self.dice.between(0.31, 0.37));
        let top = hip - 0.05;
        self.sketch.line(&[(near, top), (far, top), (far, foot)], 0.035, metal);
        self.sketch
            .line(&[(near + ahead * 0.03, top), (near + ahead * 0.03, foot)], 0.03, metal);
        (self.sketch).oval(far, foot - 0.02, 0.04, 0.04, Ink::hex(0x0022_2426));
        let shoulder = self.shoulder();
        let arm = [(ahead * 0.1, shoulder + 0.07), (ahead * 0.17, hip - 0.1), (near, top)];
        self.sketch.line(&arm, 0.08, self.coat.lit(-0.2));
        let ((x, y), r) = (self.head_middle(), self.head);
        let hat = self.dice.ink(&TEST_MUTED);
        let brim = [x - r * 1.25, y - r * 0.7, x + r * 1.25, y - r * 0.45];
        self.sketch.round(brim, r * 0.12, hat.lit(-0.25));
        self.sketch
            .round([x - r, y - r * 1.15, x + r, y - r * 0.55], r * 0.35, hat);
    }

    /// Draws the closed umbrella or the rucksack of an adult in the test style.
    fn umbrella(&mut self) {
        let (ahead, hip, shoulder) = (self.ahead(), self.hip(), self.shoulder());
        let ink = self.dice.ink(&TEST_CLOTHES);
        if self.dice.chance(0.5) {
            let x = ahead * (self.wide + 0.06);
            self.sketch
                .line(&[(x, hip - 0.02), (x + ahead * 0.03, hip + 0.24)], 0.05, ink.lit(-0.3));
        } else {
            let x = -ahead * self.wide * 0.9;
            let edges = [x - 0.08, shoulder + 0.03, x + 0.08, hip - 0.02];
            self.sketch.round(edges, 0.05, ink.lit(-0.2));
        }
    }

    /// Draws the scooter and the helmet of a child in the test style.
    fn scooter(&mut self) {
        let (ahead, hip, foot) = (self.ahead(), self.hip(), self.foot);
        let metal = self.dice.ink(&[0x4a5560, 0xc23a5a, 0x2a7ab0]);
        let (rear, front) = (-ahead * 0.22, ahead * 0.24);
        self.sketch.line(&[(rear, foot), (front, foot)], 0.04, metal);
        self.sketch
            .line(&[(front, foot), (front - ahead * 0.04, hip - 0.08)], 0.035, metal);
        for x in [rear, front] {
            self.sketch.oval(x, foot, 0.04, 0.04, Ink::hex(0x0022_2428));
        }
        let ((x, y), r) = (self.head_middle(), self.head);
        let helmet = self.dice.ink(&TEST_BRIGHT).lit(-0.1);
        let dome = [
            (x - r * 1.12, y - r * 0.2),
            (x - r * 0.95, y - r * 1.25),
            (x + r * 0.95, y - r * 1.25),
            (x + r * 1.12, y - r * 0.2),
        ];
        self.sketch.blob(&dome.map(|point| [point, point]).concat(), helmet);
        (self.sketch).line(
            &[(x - r * 0.4, y - r * 0.95), (x + r * 0.4, y - r * 0.95)],
            r * 0.16,
            helmet.lit(-0.4),
        );
    }

    /// Draws the satchel on a child's back.
    fn satchel_behind(&mut self) {
        let (shoulder, hip) = (self.shoulder(), self.hip());
        let ink = self.dice.ink(&BRIGHT).lit(-0.1);
        let x = if self.in_profile() { -self.ahead() * 0.15 } else { 0.0 };
        let wide = if self.in_profile() { 0.11 } else { 0.2 };
        self.sketch
            .round([x - wide, shoulder + 0.01, x + wide, hip + 0.01], 0.05, ink.lit(-0.45));
        self.sketch.round(
            [x - wide + 0.02, shoulder + 0.03, x + wide - 0.02, hip - 0.01],
            0.04,
            ink,
        );
    }

    /// Draws a cap, pigtails or a balloon.
    fn toy(&mut self) {
        let ((x, y), r, ahead) = (self.head_middle(), self.head, self.ahead());
        let ink = self.dice.ink(&BRIGHT);
        match self.dice.below(3) {
            0 => {
                let peak = [x + ahead * r * 0.3, y - r * 0.6, x + ahead * r * 1.55, y - r * 0.35];
                let peak = [peak[0].min(peak[2]), peak[1], peak[0].max(peak[2]), peak[3]];
                let dome = [
                    (x - r * 1.1, y - r * 0.35),
                    (x - r * 0.9, y - r * 1.3),
                    (x + r * 0.9, y - r * 1.3),
                    (x + r * 1.1, y - r * 0.35),
                ];
                let corners = dome.map(|point| [point, point]).concat();
                self.sketch.blob(&corners, ink);
                self.sketch.round(peak, r * 0.1, ink.lit(-0.35));
            }
            1 => {
                for side in [-1.0, 1.0] {
                    self.sketch
                        .oval(x + side * r * 1.25, y + r * 0.1, r * 0.35, r * 0.55, self.hair);
                    self.sketch
                        .oval(x + side * r * 1.05, y - r * 0.2, r * 0.18, r * 0.18, ink);
                }
            }
            _ => {
                let (bx, by) = (x - ahead * 0.28, self.level(0.0) - 0.08);
                let hand = (-ahead * self.wide, self.hip());
                self.sketch.line(&[(bx, by), hand], 0.015, Ink::hex(0x0055_5555));
                self.sketch.oval(bx, by, 0.1, 0.12, ink);
                self.sketch
                    .oval(bx - 0.03, by - 0.04, 0.025, 0.035, Ink::WHITE.faint(0.7));
            }
        }
    }
}
