//! Parametric drawings of buildings: a front and its surroundings, in a square of side 1 around the origin.

use crate::city::Building;
use crate::render::sketch::{Dice, Edges, Ink, Sketch, leaves};
use crate::rng::Rng;

const GLASS: [u32; 4] = [0x7fb2d6, 0x9cc7e0, 0x5f8fb5, 0xf4e3a1];
const LAWNS: [u32; 4] = [0x86b463, 0x7aa658, 0x96bd74, 0x6f9c55];
const PAVING: [u32; 4] = [0xb9b5aa, 0xc6c1b4, 0xa9a8a4, 0xbdb4a3];

/// Draws a building. `noise` is the difficulty, 0..=1: more of it adds clutter and makes building types share colors.
pub(super) fn draw<R: Rng>(building: Building, dice: &mut Dice<R>, noise: f32) -> Sketch {
    let mut lot = Lot {
        dice,
        noise,
        sketch: Sketch::default(),
    };
    match building {
        Building::House => lot.house(),
        Building::Office => lot.office(),
        Building::Garage => lot.garage(),
        Building::Store => lot.store(),
        Building::GasStation => lot.gas_station(),
    }
    lot.clutter();
    lot.sketch
}

/// A lot under construction.
struct Lot<'a, R> {
    dice: &'a mut Dice<R>,
    noise: f32,
    sketch: Sketch,
}

impl<R: Rng> Lot<'_, R> {
    /// Fills the whole lot and draws its edge.
    fn ground(&mut self, inks: &[u32]) {
        let ink = self.dice.ink(inks);
        self.sketch.rect([-0.5, -0.5, 0.5, 0.5], ink.lit(-0.25));
        self.sketch.rect([-0.485, -0.485, 0.485, 0.485], ink);
        self.sketch.stay_inside();
        for _ in 0..8 {
            let (x, y) = (self.dice.between(-0.5, 0.5), self.dice.between(-0.5, 0.5));
            let size = self.dice.between(0.05, 0.16);
            let shade = self.dice.between(-0.2, 0.15);
            self.sketch.oval(x, y, size, size * 0.7, ink.lit(shade).faint(0.4));
        }
    }

    /// Returns one of the given colors, mixed under noise with a color that all buildings share.
    fn wall(&mut self, inks: &[u32]) -> Ink {
        let own = self.dice.ink(inks);
        let any = self.dice.ink(&[0xc8b39a, 0xa9adb3, 0xd8d3c6, 0x9a7b66, 0x8fa3a0]);
        own.mix(any, self.noise * self.dice.between(0.0, 0.8))
    }

    /// Draws a box with an outline, lit from the left, and its shadow on the right.
    fn block(&mut self, edges: Edges, ink: Ink) {
        let [left, top, right, bottom] = edges;
        (self.sketch).rect(
            [left + 0.03, top + 0.05, right + 0.05, bottom + 0.03],
            Ink::BLACK.faint(0.25),
        );
        (self.sketch).rect(
            [left - 0.012, top - 0.012, right + 0.012, bottom + 0.012],
            ink.lit(-0.55),
        );
        self.sketch.rect(edges, ink);
        (self.sketch).fade(edges, Ink::WHITE.faint(0.12), Ink::BLACK.faint(0.18), false);
    }

    fn window(&mut self, [left, top, right, bottom]: Edges, frame: Ink) {
        let glass = self.dice.ink(&GLASS);
        self.sketch.rect([left, top, right, bottom], frame);
        let edge = 0.012;
        let pane = [left + edge, top + edge, right - edge, bottom - edge];
        self.sketch.rect(pane, glass);
        (self.sketch).polygon(
            &[(pane[0], pane[3]), (pane[0], pane[1]), (pane[2], pane[1])],
            Ink::WHITE.faint(0.28),
        );
    }

    fn tree(&mut self, x: f32, y: f32, size: f32) {
        let leaf = self.dice.ink(&[0x3f7a3a, 0x4f8c3f, 0x2f6b3c, 0x6a9440]);
        self.sketch.oval(x + 0.02, y + 0.03, size, size, Ink::BLACK.faint(0.25));
        self.sketch.oval(x, y, size, size, leaf.lit(-0.35));
        self.sketch
            .oval(x - size * 0.08, y - size * 0.08, size * 0.85, size * 0.85, leaf);
        self.sketch.oval(
            x - size * 0.28,
            y - size * 0.3,
            size * 0.38,
            size * 0.35,
            leaf.lit(0.25),
        );
    }

    /// Draws walls, a pitched roof, a chimney, a door, windows and a garden.
    fn house(&mut self) {
        self.ground(&LAWNS);
        let wall = self.wall(&[0xf1e3c8, 0xe8d6b0, 0xf5f0e6, 0xd9c3a5, 0xcfd8dc, 0xe9c7b0, 0xb55a44]);
        let roof = self.wall(&[0xa8402f, 0x8c3b2e, 0x6d4434, 0x54606c, 0xb85c38, 0x3f4a55]);
        let half = self.dice.between(0.28, 0.35);
        let (eaves, base) = (self.dice.between(-0.1, 0.0), self.dice.between(0.33, 0.38));
        let ridge = eaves - self.dice.between(0.27, 0.34);
        let path = self.dice.ink(&PAVING);
        let door_x = self.dice.pick(&[-0.16, 0.0, 0.0, 0.16]);
        (self.sketch).polygon(
            &[
                (door_x - 0.05, base),
                (door_x + 0.05, base),
                (door_x + 0.08, 0.5),
                (door_x - 0.08, 0.5),
            ],
            path,
        );
        let chimney = self.dice.pick(&[-0.6, 0.55]) * half;
        self.block(
            [chimney - 0.045, ridge + 0.02, chimney + 0.045, eaves],
            Ink::hex(0x008a_4a3a),
        );
        self.block([-half, eaves, half, base], wall);
        let over = half + 0.07;
        let gable = self.dice.chance(0.55);
        let outline = if gable {
            vec![(-over, eaves + 0.03), (0.0, ridge), (over, eaves + 0.03)]
        } else {
            vec![
                (-over, eaves + 0.03),
                (-half * 0.6, ridge),
                (half * 0.6, ridge),
                (over, eaves + 0.03),
            ]
        };
        self.sketch.polygon(&outline, roof);
        // Rows of tiles.
        for row in 1..5_u8 {
            let share = f32::from(row) / 5.0;
            let y = ridge + (eaves + 0.03 - ridge) * share;
            let top = if gable { 0.0 } else { half * 0.6 };
            let x = top + (over - top) * share - 0.02;
            self.sketch.line(&[(-x, y), (x, y)], 0.012, roof.lit(-0.3));
        }
        let closed: Vec<_> = outline.iter().copied().chain([outline[0]]).collect();
        self.sketch.line(&closed, 0.02, roof.lit(-0.5));
        if gable && self.dice.chance(0.6) {
            self.sketch
                .oval(0.0, (ridge + eaves) / 2.0 + 0.05, 0.05, 0.05, Ink::WHITE);
            self.sketch
                .oval(0.0, (ridge + eaves) / 2.0 + 0.05, 0.036, 0.036, Ink::hex(0x0060_88a8));
        }
        let door = self.dice.ink(&[0x7a4a26, 0x2f5d4a, 0x8a2430, 0x2b4a7a, 0xc98a2c]);
        (self.sketch).rect([door_x - 0.062, base - 0.21, door_x + 0.062, base], wall.lit(-0.5));
        self.sketch.rect([door_x - 0.05, base - 0.2, door_x + 0.05, base], door);
        self.sketch
            .oval(door_x + 0.03, base - 0.09, 0.01, 0.01, Ink::hex(0x00f0_d060));
        for x in [-half + 0.09, 0.0, half - 0.09] {
            if (x - door_x).abs() > 0.12 {
                self.window([x - 0.055, base - 0.21, x + 0.055, base - 0.09], Ink::WHITE);
            }
        }
        for _ in 0..1 + self.dice.below(3) {
            let x = self.dice.pick(&[-0.42, 0.42]) + self.dice.between(-0.03, 0.03);
            let y = self.dice.between(0.1, 0.42);
            let size = self.dice.between(0.05, 0.085);
            self.tree(x, y, size);
        }
    }

    /// Draws a tower of many equal windows.
    fn office(&mut self) {
        self.ground(&PAVING);
        let wall = self.wall(&[0x7d8ea3, 0x9aa7b5, 0x5c6f86, 0xb8bec6, 0x4a5a70, 0xa79f93]);
        let half = self.dice.between(0.24, 0.36);
        let (top, base) = (self.dice.between(-0.46, -0.4), 0.43);
        if self.dice.chance(0.35) {
            // A lower wing.
            let side = self.dice.pick(&[-1.0_f32, 1.0]);
            let (a, b) = (side * half * 0.5, side * 0.45);
            let top = self.dice.between(-0.1, 0.1);
            self.block([a.min(b), top, a.max(b), base], wall.lit(-0.15));
        }
        self.block([-half, top, half, base], wall);
        self.sketch.rect([-half, top, half, top + 0.045], wall.lit(-0.35));
        let (cols, rows) = (4 + self.dice.below(3), 6 + self.dice.below(3));
        let glass = self.dice.ink(&[0x9fd0ee, 0x6fa9d4, 0xbfe0f0, 0x4f86b8]);
        #[allow(clippy::cast_precision_loss)]
        let (step_x, step_y) = ((2.0 * half - 0.04) / cols as f32, (base - top - 0.21) / rows as f32);
        let band = self.dice.chance(0.3);
        for row in 0..rows {
            for col in 0..cols {
                #[allow(clippy::cast_precision_loss)]
                let (x, y) = (-half + 0.02 + step_x * col as f32, top + 0.065 + step_y * row as f32);
                let lit = if self.dice.chance(0.12) {
                    Ink::hex(0x00ff_e9a0)
                } else {
                    glass.lit(self.dice.between(-0.15, 0.2))
                };
                let gap = if band { 0.0 } else { 0.012 };
                (self.sketch).rect([x + gap, y + 0.01, x + step_x - gap, y + step_y - 0.012], lit);
            }
        }
        self.sketch.rect([-0.1, base - 0.12, 0.1, base], Ink::hex(0x0020_3040));
        self.sketch.rect([-0.085, base - 0.105, -0.006, base], glass.lit(0.2));
        self.sketch.rect([0.006, base - 0.105, 0.085, base], glass.lit(0.2));
        (self.sketch).rect([-0.14, base - 0.15, 0.14, base - 0.115], wall.lit(0.35));
        // On the roof.
        let x = self.dice.between(-half * 0.6, half * 0.4);
        (self.sketch).rect([x, top - 0.035, x + 0.12, top], wall.lit(-0.45));
        if self.dice.chance(0.6) {
            (self.sketch).line(&[(-x, top), (-x, top - 0.05)], 0.014, Ink::hex(0x0033_3333));
        }
        for x in [-0.42, 0.42] {
            if self.dice.chance(0.4) {
                self.tree(x, 0.38, 0.055);
            }
        }
    }

    /// Draws a low hall with roller doors and a sign.
    fn garage(&mut self) {
        self.ground(&[0x8d9096, 0x9b9c9e, 0x83868a, 0xa3a09a]);
        let wall = self.wall(&[0xc9c4b8, 0xa8a29a, 0xb7642f, 0x8c97a3, 0xd6cfc0, 0x9c5040]);
        let door = self.dice.ink(&[0xe9ebec, 0xd9dcdf, 0xb8c4cf, 0xd4b04a, 0x9fb0a8]);
        let (top, base) = (self.dice.between(-0.32, -0.22), self.dice.between(0.24, 0.3));
        let doors: u8 = self.dice.pick(&[1, 2, 2, 3]);
        let half = if doors == 1 { 0.33 } else { 0.44 };
        self.block([-half, top, half, base], wall);
        let roof = self.wall(&[0x5a5f66, 0x45484d, 0x77695c]);
        self.sketch
            .rect([-half - 0.02, top - 0.06, half + 0.02, top + 0.02], roof);
        let sign = self.dice.ink(&[0x1d4fa0, 0x17181c, 0xd0a516, 0x2f6b3c]);
        let (y, text) = (top + 0.075, self.dice.pick(&["GARAGE", "GARAGE", "AUTO", "REPAIR"]));
        self.sketch.rect([-0.27, y - 0.05, 0.27, y + 0.05], sign);
        self.sketch.letters(text, (0.0, y), 0.062, 0.017, Ink::WHITE);
        let step = 2.0 * (half - 0.03) / f32::from(doors);
        for number in 0..doors {
            let left = -half + 0.03 + step * f32::from(number) + 0.025;
            let right = left + step - 0.05;
            let head = top + 0.16;
            self.sketch
                .rect([left - 0.012, head - 0.012, right + 0.012, base], wall.lit(-0.55));
            if self.dice.chance(0.35) {
                // An open door shows a car inside.
                self.sketch.rect([left, head, right, base], Ink::hex(0x001c_1d20));
                let (x, wide) = ((left + right) / 2.0, (right - left).min(0.3) * 0.38);
                let paint = self.dice.ink(&[0xb3352f, 0x2f5fa8, 0xd8dade, 0x3a7d54]);
                self.sketch.round(
                    [x - wide * 0.7, base - 0.17, x + wide * 0.7, base - 0.08],
                    0.03,
                    paint.lit(-0.2),
                );
                self.sketch.round(
                    [x - wide * 0.55, base - 0.155, x + wide * 0.55, base - 0.1],
                    0.02,
                    Ink::hex(0x00a8_c8dc),
                );
                self.sketch
                    .round([x - wide, base - 0.11, x + wide, base - 0.02], 0.03, paint);
                for side in [-0.7, 0.7] {
                    self.sketch
                        .oval(x + side * wide, base - 0.07, 0.018, 0.018, Ink::hex(0x00ff_f2b0));
                }
                self.sketch.rect([left, head, right, head + 0.04], door);
            } else {
                self.sketch.rect([left, head, right, base], door);
                for line in 1..6_u8 {
                    let y = head + (base - head) * f32::from(line) / 6.0;
                    self.sketch.line(&[(left, y), (right, y)], 0.012, door.lit(-0.35));
                }
            }
            // The driveway.
            (self.sketch).polygon(
                &[(left, base), (right, base), (right + 0.03, 0.5), (left - 0.03, 0.5)],
                Ink::hex(0x0060_6468).faint(0.5),
            );
        }
        if self.dice.chance(0.5) {
            // Tires.
            let x = self.dice.pick(&[-0.42, 0.42]);
            for y in [0.36, 0.42] {
                self.sketch.oval(x, y, 0.045, 0.035, Ink::hex(0x0018_181a));
                self.sketch.oval(x, y, 0.018, 0.014, Ink::hex(0x0077_7a7e));
            }
        }
    }

    /// Draws shop windows below a striped awning and a sign.
    fn store(&mut self) {
        self.ground(&PAVING);
        let wall = self.wall(&[0xe7c9a0, 0xd89f7a, 0xbfd3b8, 0xe9e2d0, 0xb5cbd8, 0xd9a8a0]);
        let (top, base, half) = (self.dice.between(-0.4, -0.32), 0.34, self.dice.between(0.38, 0.44));
        self.block([-half, top, half, base], wall);
        (self.sketch).rect([-half - 0.02, top - 0.035, half + 0.02, top + 0.02], wall.lit(-0.4));
        let sign = self.dice.ink(&[0xc22f3a, 0x1f7a4a, 0x274f9a, 0x5a2f6b, 0x2b2b2e]);
        let y = top + 0.12;
        self.sketch
            .round([-half + 0.04, y - 0.075, half - 0.04, y + 0.075], 0.03, sign);
        let text = self
            .dice
            .pick(&["SHOP", "STORE", "MARKET", "DELI", "BOOKS", "TOYS", "STORE"]);
        self.sketch.letters(text, (0.0, y), 0.09, 0.024, Ink::WHITE);
        // Windows, goods, a door.
        let awning = top + 0.24;
        let door_left = self.dice.pick(&[-half + 0.06, -0.08, half - 0.22]);
        self.window([-half + 0.05, awning + 0.06, half - 0.05, base - 0.06], wall.lit(-0.5));
        for _ in 0..6 + self.dice.below(5) {
            let x = self.dice.between(-half + 0.08, half - 0.16);
            let goods = self.dice.ink(&[0xe04f3f, 0xf2b632, 0x4fa35c, 0x3f77c2, 0xb65fb0]);
            let high = self.dice.between(0.04, 0.11);
            self.sketch
                .round([x, base - 0.07 - high, x + 0.07, base - 0.07], 0.015, goods);
        }
        let door = self.dice.ink(&[0x6b3f22, 0x25282c, 0x2f5d4a]);
        self.sketch
            .rect([door_left, awning + 0.05, door_left + 0.16, base], door);
        (self.sketch).rect(
            [door_left + 0.025, awning + 0.07, door_left + 0.135, base - 0.09],
            Ink::hex(0x00a9_d3e6),
        );
        let stripe = self.dice.ink(&[0xd8323c, 0x2f8a4f, 0x2f62b8, 0xe08a1e, 0x8a3f9a]);
        let stripes: u8 = self.dice.pick(&[7, 9, 11]);
        let wide = (2.0 * half + 0.04) / f32::from(stripes);
        for number in 0..stripes {
            let left = -half - 0.02 + wide * f32::from(number);
            let ink = if number % 2 == 0 { stripe } else { Ink::WHITE };
            self.sketch.rect([left, awning - 0.04, left + wide, awning + 0.06], ink);
            self.sketch
                .oval(left + wide / 2.0, awning + 0.06, wide / 2.0, 0.03, ink.lit(-0.08));
        }
        if self.dice.chance(0.5) {
            // Crates in front.
            for number in 0..3_u8 {
                let x = -0.36 + 0.12 * f32::from(number);
                self.sketch
                    .rect([x, base + 0.03, x + 0.1, base + 0.1], Ink::hex(0x008a_5f34));
                let fruit = self.dice.ink(&[0xe2442f, 0xf3a71f, 0x6fae3c]);
                for dot in [0.02, 0.05, 0.08] {
                    self.sketch.oval(x + dot, base + 0.035, 0.02, 0.02, fruit);
                }
            }
        }
    }

    /// Draws a canopy on posts over pumps, and a price board.
    fn gas_station(&mut self) {
        self.ground(&[0x77797d, 0x6b6e73, 0x85868a, 0x7d7a74]);
        let brand = self
            .dice
            .ink(&[0xd8232a, 0x1f8a4a, 0xf2b705, 0x1f5fc0, 0xe8641b, 0x12908f]);
        let brand = self.wall(&[u32::from_be_bytes([0, brand.rgb[0], brand.rgb[1], brand.rgb[2]])]);
        let wall = self.wall(&[0xe5e6e6, 0xd3d6d8, 0xeae4d8]);
        // The kiosk behind.
        let kiosk = self.dice.pick(&[-0.42, -0.05]);
        self.block([kiosk, -0.42, kiosk + 0.42, -0.12], wall);
        self.window([kiosk + 0.04, -0.34, kiosk + 0.26, -0.2], wall.lit(-0.5));
        self.sketch
            .rect([kiosk + 0.3, -0.34, kiosk + 0.38, -0.12], Ink::hex(0x0030_4050));
        // Canopy and posts.
        let (top, low) = (self.dice.between(-0.2, -0.12), self.dice.between(0.0, 0.05));
        let (left, right) = (-0.46, 0.28);
        for x in [left + 0.07, right - 0.07] {
            self.sketch.rect([x - 0.02, low, x + 0.02, 0.38], Ink::hex(0x00d0_d4d6));
            self.sketch.rect([x + 0.01, low, x + 0.02, 0.38], Ink::hex(0x0080_8488));
        }
        (self.sketch).polygon(
            &[
                (left + 0.05, 0.42),
                (right + 0.05, 0.42),
                (right + 0.1, 0.34),
                (left + 0.1, 0.34),
            ],
            Ink::BLACK.faint(0.3),
        );
        // Pumps on an island.
        let middle = (left + right) / 2.0;
        self.sketch
            .round([left + 0.13, 0.35, right - 0.13, 0.42], 0.03, Ink::hex(0x00d9_d6cc));
        let pumps: &[f32] = self.dice.pick(&[&[-0.11, 0.11], &[-0.16, 0.0, 0.16], &[-0.1, 0.1]]);
        for offset in pumps {
            let x = middle + offset;
            self.sketch
                .round([x - 0.062, 0.1, x + 0.062, 0.39], 0.02, Ink::hex(0x0022_2428));
            self.sketch.round([x - 0.05, 0.112, x + 0.05, 0.385], 0.015, brand);
            self.sketch
                .rect([x - 0.035, 0.14, x + 0.035, 0.2], Ink::hex(0x00e6_f2e0));
            self.sketch.rect([x - 0.035, 0.24, x + 0.035, 0.3], Ink::WHITE);
            let hose = [(x + 0.05, 0.16), (x + 0.09, 0.2), (x + 0.085, 0.3), (x + 0.055, 0.33)];
            self.sketch.line(&hose, 0.018, Ink::hex(0x0015_1618));
        }
        self.block([left, top, right, low], Ink::hex(0x00f2_f2ef));
        let band = if self.dice.chance(0.5) {
            [left, low - 0.07, right, low]
        } else {
            [left, top, right, top + 0.07]
        };
        self.sketch.rect(band, brand);
        let text = self.dice.pick(&["GAS", "GAS", "FUEL", "PETROL"]);
        let ink = self.dice.pick(&[brand.lit(-0.3), Ink::hex(0x0015_1618)]);
        self.sketch
            .letters(text, (middle, (top + low) / 2.0), 0.085, 0.024, ink);
        // The price board.
        let (x, high) = (0.39, self.dice.between(-0.3, -0.2));
        self.sketch
            .rect([x - 0.015, high, x + 0.015, 0.42], Ink::hex(0x0048_4c50));
        self.sketch.round(
            [x - 0.085, high - 0.1, x + 0.085, high + 0.28],
            0.02,
            Ink::hex(0x001c_1e22),
        );
        self.sketch
            .round([x - 0.072, high - 0.088, x + 0.072, high + 0.04], 0.015, brand);
        // A drop-shaped logo.
        (self.sketch).polygon(
            &[(x, high - 0.075), (x + 0.035, high - 0.01), (x - 0.035, high - 0.01)],
            Ink::WHITE,
        );
        self.sketch.oval(x, high - 0.008, 0.036, 0.032, Ink::WHITE);
        for row in 0..3_u8 {
            let y = high + 0.085 + 0.065 * f32::from(row);
            let price = ["1 79", "1 65", "1 82", "0 99", "2 05"][self.dice.below(5)];
            self.sketch.letters(price, (x, y), 0.036, 0.012, Ink::hex(0x00ff_c83c));
        }
    }

    /// Draws trees, boxes and fallen leaves around the building under noise.
    fn clutter(&mut self) {
        let most = 9.0 * self.noise;
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
        for _ in 0..self.dice.between(0.0, most) as u32 {
            let (x, y) = (self.dice.between(-0.46, 0.46), self.dice.between(-0.46, 0.46));
            match self.dice.below(3) {
                0 => {
                    let size = self.dice.between(0.04, 0.09);
                    self.tree(x, y, size);
                }
                1 => {
                    let box_ink = self.dice.ink(&[0x8a6a42, 0x4f6f8a, 0x9a3f35, 0x6d6f72]);
                    (self.sketch).rect([x, y, x + self.dice.between(0.03, 0.09), y + 0.06], box_ink);
                }
                _ => leaves(&mut self.sketch, self.dice, (x, y), 0.075),
            }
        }
    }
}
