//! The map without agents: streets, crossings, sidewalks and buildings.
//!
//! A pixel of the ground depends only on its place on the map, not on the part of the map in view.

use crate::city::{Building, Rectangle};
use crate::city::{Cell, CityMap, Ground, Heading};
use crate::render::class::{Class, Facing};
use crate::render::clutter;
use crate::render::icon::Icons;
use crate::render::lattice::Lattice;
use crate::render::picture::{Picture, Rgb};
use crate::render::view::{Scale, Viewport};
use crate::rng::{Purpose, RngExt, Seed};

impl Purpose {
    /// The texture of the ground.
    pub const TEXTURE: Purpose = Purpose::new(11);
}

/// The color of the mid line in every picture.
pub(super) const MID_LINE: Rgb = [255, 215, 0];
pub(super) const PAINT: Rgb = [236, 236, 230];

/// The parameters in which the grounds of one map differ.
#[derive(Clone, Copy, Debug)]
pub(super) struct Look {
    /// Seed of the textures.
    pub(super) seed: Seed,
    /// The instance of the map's first building; each following building shows the next instance.
    first_building: u32,
}

impl Look {
    /// Returns the look for a set of icons: their seed, and building instances from 0 on.
    pub(super) fn of(icons: &Icons) -> Look {
        Look {
            seed: icons.seed(),
            first_building: 0,
        }
    }

    /// Returns a random look.
    pub(super) fn drawn(seed: Seed) -> Look {
        Look {
            seed,
            first_building: seed.stream(Purpose::TEXTURE, 1, 0).random(),
        }
    }
}

/// The colors and the texture of the ground.
#[derive(Clone, Copy, Debug)]
pub(super) struct Texture {
    pub(super) asphalt: Rgb,
    pub(super) sidewalk: Rgb,
    pub(super) curb: Rgb,
    meadow: Rgb,
    /// Varies textures of equal colors.
    lattice: Lattice,
    /// The difficulty, 0..=256.
    noise: i32,
}

/// The content of a cell, as far as it affects colors.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Surface {
    Meadow,
    Building(Building),
    /// Whether asphalt borders each side, in the order of [`Heading::ALL`].
    Sidewalk([bool; 4]),
    /// The mid line, and whether it runs along a row.
    MidLine(bool),
    /// Whether each side has a stop line.
    Asphalt([bool; 4]),
    /// A crossing, and whether pedestrians walk along its row.
    Crossing(bool),
}

impl Surface {
    fn of(map: &CityMap, cell: Cell) -> Surface {
        let beside = |is: &dyn Fn(Cell) -> bool| Heading::ALL.map(|heading| is(cell.ahead(heading, 1)));
        if let Some(building) = map.building_at(cell) {
            return Surface::Building(building);
        }
        match map.ground_at(cell) {
            None | Some(Ground::Other) => Surface::Meadow,
            Some(Ground::Walking) => Surface::Sidewalk(beside(&|other| map.ground_at(other) == Some(Ground::Traffic))),
            Some(Ground::Crossing) => Surface::Crossing(walks_along_row(map, cell)),
            Some(Ground::Traffic) if map.is_mid_line(cell) => {
                let along = |heading: Heading| map.is_mid_line(cell.ahead(heading, 1));
                Surface::MidLine(along(Heading::Left) || along(Heading::Right))
            }
            Some(Ground::Traffic) if map.junction(cell).car_is_at() => Surface::Asphalt([false; 4]),
            Some(Ground::Traffic) => Surface::Asphalt(beside(&|other| {
                map.junction(other).car_is_at() && map.ground_at(other) == Some(Ground::Crossing)
            })),
        }
    }
}

impl Surface {
    /// Returns the number of the surface in a [`GroundPlan`].
    fn code(self) -> u32 {
        let sides = |sides: [bool; 4]| {
            let marked = (0..4).zip(sides).filter(|(_, marked)| *marked);
            marked.map(|(side, _)| 8 << side).sum::<u32>()
        };
        match self {
            Surface::Meadow => 0,
            Surface::Sidewalk(curbs) => 1 + sides(curbs),
            Surface::Asphalt(stops) => 2 + sides(stops),
            Surface::Crossing(along_row) => 4 - u32::from(along_row),
            Surface::MidLine(along_row) => 6 - u32::from(along_row),
            Surface::Building(_) => 7,
        }
    }
}

/// Returns whether pedestrians use this crossing cell along its row: neither end of the crossing in that row is a
/// traffic street.
fn walks_along_row(map: &CityMap, cell: Cell) -> bool {
    let end = |heading| {
        let mut ground = Some(Ground::Crossing);
        let mut cells = 0;
        while ground == Some(Ground::Crossing) {
            cells += 1;
            ground = map.ground_at(cell.ahead(heading, cells));
        }
        ground
    };
    end(Heading::Left) != Some(Ground::Traffic) && end(Heading::Right) != Some(Ground::Traffic)
}

impl Texture {
    /// Returns the texture of a seed at a difficulty, 0..=1.
    pub(super) fn new(seed: Seed, difficulty: f32) -> Texture {
        let mut stream = seed.stream(Purpose::TEXTURE, 0, 0);
        let mut tone = |rgb: Rgb, spread: i32| {
            let light = stream.random_range(-spread..=spread);
            rgb.map(|channel| (i32::from(channel) + light + stream.random_range(-4..=4)).clamp(0, 255) as u8)
        };
        Texture {
            asphalt: tone([118, 122, 128], 10),
            sidewalk: tone([206, 200, 188], 12),
            curb: tone([158, 152, 142], 8),
            meadow: tone([150, 184, 116], 10),
            lattice: Lattice(stream.random()),
            #[allow(clippy::cast_possible_truncation)]
            noise: (difficulty * 256.0) as i32,
        }
    }

    /// Varies the lightness of a color by place: clouds over some cells, specks, and uneven light under noise.
    fn weathered(self, rgb: Rgb, x: i64, y: i64, scale: Scale, layer: u32) -> Rgb {
        let cell = i64::from(scale.pixels);
        let mut light = (self.lattice.wave(x, y, 6 * cell, layer) * (5 * 256 + 18 * self.noise)) >> 16;
        // Specks under noise are 2 x 2 pixels, because single pixels would dominate the size of a PNG.
        let fine = i64::from(self.noise > 0);
        let speck = self.lattice.hash(x >> fine, y >> fine, layer);
        // Clean textures have few specks, which keeps PNG files small.
        if (speck & 255) < 14 + ((self.noise as u32 * 150) >> 8) {
            light += (((speck >> 8) as i32 % 19 - 9) * (256 + self.noise)) >> 8;
        }
        if self.noise > 0 {
            light += (self.lattice.wave(x, y, 37 * cell, layer + 1) * self.noise * 50) >> 16;
        }
        rgb.map(|channel| (i32::from(channel) + light).clamp(0, 255) as u8)
    }

    /// Returns the color of a pixel of a cell. `right` and `down` count from the cell's corner; `x` and `y` are the
    /// place on the map, in pixels.
    fn color(self, surface: Surface, cell: Cell, (right, down): (i32, i32), (x, y): (i64, i64), scale: Scale) -> Rgb {
        let side = scale.pixels;
        let touched = |beside: [bool; 4], deep: i32| {
            let at = [right < deep, right >= side - deep, down < deep, down >= side - deep];
            beside.into_iter().zip(at).any(|(beside, at)| beside && at)
        };
        match surface {
            Surface::Meadow => self.weathered(self.meadow, x, y, scale, 10),
            Surface::Building(building) => roof(building),
            Surface::Sidewalk(curbs) => {
                if side > 2 && touched(curbs, (side / 5).max(1)) {
                    return self.weathered(self.curb, x, y, scale, 20);
                }
                let slab = if side >= 6 { 2 } else { 5 };
                let joint = right == 0 && cell.col % slab == 0 || down == 0 && cell.row % slab == 0;
                let tint = (self
                    .lattice
                    .hash(i64::from(cell.col / slab), i64::from(cell.row / slab), 30)
                    & 7) as i32
                    - 4;
                let tint = if joint && side > 2 { -16 } else { tint };
                let stone = self
                    .sidewalk
                    .map(|channel| (i32::from(channel) + tint).clamp(0, 255) as u8);
                self.weathered(stone, x, y, scale, 20)
            }
            Surface::MidLine(along_row) => {
                let (along, across) = if along_row { (cell.col, down) } else { (cell.row, right) };
                let edge = 3 * side / 8;
                if (edge..side - edge).contains(&across) && along.rem_euclid(5) < 3 {
                    MID_LINE
                } else {
                    self.weathered(self.asphalt, x, y, scale, 40)
                }
            }
            Surface::Asphalt(stops) if side > 1 && touched(stops, side / 2) => self.paint(x, y),
            // Stripes run along the traffic, so they alternate along the walk.
            Surface::Crossing(along_row) if (if along_row { cell.col } else { cell.row }) % 2 == 0 => self.paint(x, y),
            Surface::Asphalt(_) | Surface::Crossing(_) => self.weathered(self.asphalt, x, y, scale, 40),
        }
    }

    /// Returns the color of white paint, which is worn in places under noise.
    fn paint(self, x: i64, y: i64) -> Rgb {
        let worn = ((self.lattice.hash(x >> 1, y >> 1, 50) & 255) as i32) < self.noise / 6;
        if worn { self.asphalt } else { PAINT }
    }
}

/// Returns the color of a building where a cell is less than a pixel.
pub(super) const fn roof(building: Building) -> Rgb {
    match building {
        Building::House => [176, 84, 60],
        Building::Office => [104, 138, 176],
        Building::Garage => [150, 142, 156],
        Building::Store => [214, 160, 92],
        Building::GasStation => [196, 60, 72],
    }
}

/// Draws a view without agents.
pub(super) fn draw(map: &CityMap, icons: &Icons, view: &Viewport, look: Look) -> Picture {
    let (width, height) = view.size();
    let mut picture = Picture::new(width, height, [0; 3]);
    let texture = Texture::new(look.seed, icons.difficulty().share());
    let scale = view.scale;
    let (left, top) = view.start();
    let side = scale.pixels as usize;
    // Steps from the cell of one pixel to that of the next.
    for (row, y) in (0..height as usize).step_by(side).enumerate() {
        for (col, x) in (0..width as usize).step_by(side).enumerate() {
            let cell = view.cell(row, col);
            let surface = Surface::of(map, cell);
            if scale.cells == 1 && matches!(surface, Surface::Building(_)) {
                continue;
            }
            for down in 0..side {
                for right in 0..side {
                    let (x, y) = (x + right, y + down);
                    let place = (left + x as i64, top + y as i64);
                    let rgb = texture.color(surface, cell, (right as i32, down as i32), place, scale);
                    picture.pixel_mut(x, y).copy_from_slice(&rgb);
                }
            }
        }
    }
    if scale.cells == 1 {
        clutter::draw(map, view, look.seed, icons.difficulty().share(), &mut picture);
        let corner = view.corner;
        let shown = Rectangle {
            rows: corner.row..corner.row.saturating_add(view.rows),
            cols: corner.col..corner.col.saturating_add(view.cols),
        };
        for site in sites(map, look.first_building, &shown) {
            let size = (i64::from(site.side) * i64::from(scale.pixels)) as u32;
            let stamp = icons.stamp(&Class::building(site.building), site.instance, Facing::Up, size);
            let along = |start: i32, corner: i32| {
                let pixels = scale.start(start) - scale.start(corner);
                i32::try_from(pixels + i64::from(size / 2)).expect("it is near the picture")
            };
            let corner = site.corner;
            let (x, y) = (along(corner.col, view.corner.col), along(corner.row, view.corner.row));
            picture.stamp(&stamp, x, y);
        }
    }
    picture
}

/// A building at its place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Site {
    /// Its type.
    pub building: Building,
    /// The instance of its icon.
    pub instance: u32,
    /// Its first cell.
    pub corner: Cell,
    /// Its side, in cells.
    pub side: i32,
}

/// Returns the buildings of the blocks that a rectangle touches.
fn sites<'m>(map: &'m CityMap, first: u32, near: &Rectangle) -> impl Iterator<Item = Site> + use<'m> {
    map.sites(near).map(move |(number, building, cells)| Site {
        building,
        instance: first.wrapping_add(number),
        corner: Cell::new(cells.rows.start, cells.cols.start),
        side: cells.rows.end - cells.rows.start,
    })
}

/// The ground as rectangles of equal cells, for drawing it at any scale. It has the colors and the buildings of the
/// pictures with the same icons, without specks and clouds.
#[derive(Clone, Debug)]
pub struct GroundPlan {
    /// The colors of [`GroundPlan::COLORS`], as red, green and blue.
    pub colors: [Rgb; 6],
    /// Runs of equal rows: the number of rows, and their cells as pairs of a surface and a number of columns. A
    /// surface is a position in [`GroundPlan::SURFACES`] plus 8 for each marked side, times 2 to the power of its
    /// position in [`Heading::ALL`]. Marked sides of sidewalk have a curb, those of asphalt a stop line.
    pub bands: Vec<(u32, Vec<(u32, u32)>)>,
    /// The buildings.
    pub sites: Vec<Site>,
}

impl GroundPlan {
    /// The names of the colors.
    pub const COLORS: [&'static str; 6] = ["meadow", "sidewalk", "curb", "asphalt", "paint", "mid line"];
    /// The names of the surfaces. Walkers along the row of a crossing cross stripes that alternate along the row.
    pub const SURFACES: [&'static str; 8] = [
        "meadow",
        "sidewalk",
        "asphalt",
        "crossing along row",
        "crossing along column",
        "mid line along row",
        "mid line along column",
        "building",
    ];

    /// Returns the plan of a map.
    pub fn new(map: &CityMap, icons: &Icons) -> GroundPlan {
        let look = Look::of(icons);
        let texture = Texture::new(look.seed, icons.difficulty().share());
        let mut bands: Vec<(u32, Vec<(u32, u32)>)> = Vec::new();
        for row in 0..map.rows() {
            let mut runs: Vec<(u32, u32)> = Vec::new();
            for col in 0..map.cols() {
                let surface = Surface::of(map, Cell { row, col }).code();
                match runs.last_mut() {
                    Some((before, count)) if *before == surface => *count += 1,
                    _ => runs.push((surface, 1)),
                }
            }
            match bands.last_mut() {
                Some((count, before)) if *before == runs => *count += 1,
                _ => bands.push((1, runs)),
            }
        }
        GroundPlan {
            colors: [
                texture.meadow,
                texture.sidewalk,
                texture.curb,
                texture.asphalt,
                PAINT,
                MID_LINE,
            ],
            bands,
            sites: sites(map, look.first_building, &map.whole()).collect(),
        }
    }
}
