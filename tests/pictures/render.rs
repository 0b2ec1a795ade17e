//! Pictures through the public interface. Equal input gives equal bytes, a crop equals a part of the whole, icons of a
//! class differ, a classifier distinguishes classes, and nothing panics.

use crate::cases::cases;
use logicity::city::{
    Action, AgentKind, Blocks, Building, Buildings, Landmarks, Look, MapConfig, OwnLook, Split, Terrain, Widths,
    ZoneConfig, ZonePart,
};
use logicity::city::{Cell, CityMap};
use logicity::diag::{Sources, Span};
use logicity::located::Located;
use logicity::render::{
    Animation, Class, Difficulty, Extent, Facing, Icons, Mode, Overview, Pack, Picture, PixelBox, Renderer, Scale,
    Sprite, Viewport, ViewportError, ZonePlan, sheet, write_png,
};
use logicity::rng::{Purpose, RngExt, Seed};
use logicity::sim::{Settings, Simulation};
use proptest::prelude::*;
use std::collections::BTreeMap;
use std::io::{self, Cursor, Write};
use std::path::Path;
use std::sync::{Arc, LazyLock};
use std::time::Duration;

/// A map of one row of blocks, with every building type.
fn map(name: &str, block_cols: u32, widths: Widths) -> CityMap {
    zoned(name, block_cols, widths, &[])
}

/// Such a map with zones, each the union of rectangles: rows, then columns, first and last.
fn zoned(name: &str, block_cols: u32, widths: Widths, zones: &[Vec<[[u32; 2]; 2]>]) -> CityMap {
    let mut sources = Sources::new();
    let span = Span::new(sources.add("map", ""), 0..0);
    let row = |from: usize| {
        (from..)
            .take(2 * block_cols as usize)
            .map(|at| Building::ALL[at % Building::ALL.len()])
            .collect()
    };
    let config = MapConfig {
        name: name.into(),
        terrain: Terrain::Blocks(Blocks {
            blocks: Located {
                value: [1, block_cols],
                span,
            },
            widths: Located { value: widths, span },
            buildings: Located {
                value: Buildings::Fixed(vec![row(0), row(3)]),
                span,
            },
        }),
        zones: zones
            .iter()
            .enumerate()
            .map(|(at, parts)| ZoneConfig {
                name: Located {
                    value: format!("zone_{at}"),
                    span,
                },
                parts: (parts.iter())
                    .map(|&[rows, cols]| Located {
                        value: ZonePart {
                            around: Landmarks::Cells { rows, cols },
                            within: 0,
                        },
                        span,
                    })
                    .collect(),
            })
            .collect(),
    };
    CityMap::generate(&config).unwrap_or_else(|fault| panic!("{fault:?}"))
}

const ORDINARY: Widths = Widths {
    street: 11,
    sidewalk: 5,
    building: 10,
    inner_sidewalk: 5,
};

/// 35 x 63 cells.
static TINY_MAP: LazyLock<CityMap> = LazyLock::new(|| {
    let widths = Widths {
        street: 7,
        sidewalk: 3,
        building: 6,
        inner_sidewalk: 3,
    };
    map("tiny", 2, widths)
});
static TINY: LazyLock<Overview> = LazyLock::new(|| Overview::new(&TINY_MAP, Arc::default()).expect("it has cells"));

/// An agent that owns the data that a [`Sprite`] borrows.
#[derive(Clone, Debug)]
struct Agent {
    name: String,
    kind: AgentKind,
    concepts: Vec<String>,
    at: Cell,
    facing: Facing,
    instance: u32,
    action: Option<Action>,
}

impl Agent {
    fn sprite(&self) -> Sprite<'_> {
        Sprite {
            name: &self.name,
            kind: self.kind,
            kind_name: None,
            concepts: &self.concepts,
            at: self.at,
            facing: self.facing,
            instance: self.instance,
            framing: None,
            action: self.action,
        }
    }
}

fn sprites(agents: &[Agent]) -> Vec<Sprite<'_>> {
    agents.iter().map(Agent::sprite).collect()
}

fn draw(overview: &Overview, tick: u64, agents: &[Agent]) -> Picture {
    overview.draw(tick, &sprites(agents))
}

/// Agents on the cells of a map of this size and up to `beyond` cells outside.
fn agents(rows: i32, cols: i32, beyond: i32, most: usize) -> impl Strategy<Value = Vec<Agent>> {
    let concept = prop_oneof![
        4 => prop::sample::select(vec!["ambulance", "police", "bus", "tiro", "reckless", "old", "young"])
            .prop_map(str::to_owned),
        1 => ".{0,30}",
    ];
    let name = prop_oneof!["Car_[0-9]{1,12}", "Pedestrian_[0-9]{1,2}", any::<String>()];
    let agent = (
        name,
        prop::sample::select(vec![AgentKind::Car, AgentKind::Pedestrian]),
        prop::collection::vec(concept, 0..3),
        (-beyond..rows + beyond, -beyond..cols + beyond),
        prop::sample::select(Facing::ALL.to_vec()),
        prop_oneof![0..3_u32, any::<u32>()],
        prop::option::of(prop::sample::select(Action::STANDARD.to_vec())),
    )
        .prop_map(|(name, kind, concepts, (row, col), facing, instance, action)| Agent {
            name,
            kind,
            concepts,
            at: Cell::new(row, col),
            facing,
            instance,
            action,
        });
    prop::collection::vec(agent, 0..most)
}

fn gif_of(sample: &Picture, pictures: &[Picture]) -> Vec<u8> {
    let mut animation = Animation::new(Vec::new(), sample, Duration::from_millis(150)).unwrap();
    for picture in pictures {
        animation.push(picture).unwrap();
    }
    animation.finish().unwrap()
}

fn png_of(picture: &Picture) -> Vec<u8> {
    let mut bytes = Vec::new();
    write_png(picture, &mut bytes).unwrap();
    bytes
}

/// The frames of a GIF as a viewer shows them, in red, green and blue, with their delays. Each frame covers the ones
/// before.
fn shown(bytes: &[u8]) -> Vec<(Vec<u8>, u16)> {
    let mut decoder = gif::DecodeOptions::new().read_info(bytes).unwrap();
    let palette = decoder.global_palette().unwrap().to_vec();
    let (width, height) = (usize::from(decoder.width()), usize::from(decoder.height()));
    let mut canvas = vec![0; 3 * width * height];
    let mut all = Vec::new();
    while let Some(frame) = decoder.read_next_frame().unwrap() {
        assert_eq!(frame.dispose, gif::DisposalMethod::Keep);
        assert_eq!(frame.palette, None, "all frames use the palette of the file");
        for (row, line) in frame.buffer.chunks_exact(frame.width.into()).enumerate() {
            let start = (usize::from(frame.top) + row) * width + usize::from(frame.left);
            for (pixel, index) in canvas[3 * start..].chunks_exact_mut(3).zip(line) {
                if Some(*index) != frame.transparent {
                    pixel.copy_from_slice(&palette[3 * usize::from(*index)..][..3]);
                }
            }
        }
        all.push((canvas.clone(), frame.delay));
    }
    all
}

/// The colors in the palette of a GIF that are nearest to the pixels of a picture, whose channels count in steps of 8.
fn nearest_colors(bytes: &[u8], picture: &Picture) -> Vec<u8> {
    let decoder = gif::DecodeOptions::new().read_info(bytes).unwrap();
    // The last of the 256 colors stands for unchanged pixels.
    let (palette, _) = decoder.global_palette().unwrap().as_chunks::<3>();
    let mut known = BTreeMap::new();
    let (pixels, _) = picture.pixels().as_chunks::<3>();
    pixels
        .iter()
        .flat_map(|pixel| {
            let middle = pixel.map(|channel| i32::from(channel / 8 * 8 + 4));
            let distance = |color: &&[u8; 3]| -> i32 {
                color
                    .iter()
                    .zip(middle)
                    .map(|(channel, middle)| (i32::from(*channel) - middle).pow(2))
                    .sum()
            };
            *known
                .entry(middle)
                .or_insert_with(|| *palette[..255].iter().min_by_key(distance).unwrap())
        })
        .collect()
}

/// The mean difference of two equally long lists of bytes.
fn mean_difference(a: &[u8], b: &[u8]) -> f64 {
    assert_eq!(a.len(), b.len());
    let sum: u64 = a.iter().zip(b).map(|(a, b)| u64::from(a.abs_diff(*b))).sum();
    sum as f64 / a.len() as f64
}

/// A part of a picture.
fn part(picture: &Picture, area: PixelBox) -> Vec<u8> {
    let row = 3 * picture.width() as usize;
    let from = 3 * area.x as usize;
    (area.y as usize..area.y as usize + area.height as usize)
        .flat_map(|y| &picture.pixels()[y * row + from..][..3 * area.width as usize])
        .copied()
        .collect()
}

proptest! {
    #![proptest_config(cases(6))]

    #[test]
    fn a_gif_shows_the_pushed_frames(
        states in prop::collection::vec(agents(35, 63, 2, 6), 1..4),
        pause in prop::collection::vec(any::<bool>(), 4),
    ) {
        // A pause shows the same frame again.
        let frames: Vec<Picture> = states
            .iter()
            .zip(&pause)
            .enumerate()
            .flat_map(|(tick, (agents, pause))| vec![draw(&TINY, tick as u64, agents); 1 + usize::from(*pause)])
            .collect();
        let bytes = gif_of(&frames[0], &frames);
        let decoded = shown(&bytes);
        prop_assert_eq!(decoded.len(), frames.len());
        // The palette has the colors of the first frame.
        prop_assert!(mean_difference(frames[0].pixels(), &decoded[0].0) < 4.0);
        for (frame, (pixels, delay)) in frames.iter().zip(decoded) {
            // The sum of the differences equals the frame alone.
            prop_assert!(shown(&gif_of(&frames[0], std::slice::from_ref(frame)))[0].0 == pixels);
            prop_assert!(nearest_colors(&bytes, frame) == pixels);
            prop_assert_eq!(delay, 15);
        }
        prop_assert!(gif_of(&frames[0], &frames) == bytes);
    }

    #[test]
    fn any_agents_can_be_drawn_and_a_picture_depends_only_on_its_input(
        first in agents(35, 63, 3, 12),
        mut second in agents(35, 63, i32::MAX - 63, 12),
    ) {
        // The highest tick, and names longer than any line.
        let alone = draw(&TINY, u64::MAX, &first);
        prop_assert_eq!((alone.width(), alone.height()), TINY.size());
        for agent in &mut second {
            agent.concepts.push("x".repeat(5000));
        }
        draw(&TINY, 0, &second);
        prop_assert!(draw(&TINY, u64::MAX, &first) == alone);
    }

    #[test]
    fn an_extent_is_the_smallest_one_that_splits_nothing(
        cells in prop::collection::vec((-5..40_i32, -5..70_i32), 0..4),
        margin in prop_oneof![0..12_u32, Just(u32::MAX)],
    ) {
        let cells: Vec<Cell> = cells.into_iter().map(|(row, col)| Cell::new(row, col)).collect();
        let (corner, [rows, cols]) = Extent::around(&TINY_MAP, cells.iter().copied(), margin).cells();
        let on_map: Vec<Cell> = cells.into_iter().filter(|cell| TINY_MAP.contains(*cell)).collect();
        // Where streets, sidewalks and buildings begin, and where the map ends.
        let period = [0, 7, 10, 16, 19, 25];
        let edges = |end: i32| (0..4).flat_map(|block| period.map(|at| 28 * block + at)).filter(move |at| *at < end)
            .chain([end]).collect::<Vec<_>>();
        let expected = |places: Vec<i32>, end: i32| {
            let margin = i64::from(margin);
            let Some((first, last)) = places.iter().min().zip(places.iter().max()) else { return (0, end) };
            let edges = edges(end);
            let first = edges.iter().rfind(|at| i64::from(**at) <= (i64::from(*first) - margin).max(0)).unwrap();
            let stop = (i64::from(*last) + margin + 1).min(i64::from(end));
            let stop = edges.iter().find(|at| i64::from(**at) >= stop).unwrap();
            (*first, stop - first)
        };
        prop_assert_eq!((corner.row, rows), expected(on_map.iter().map(|cell| cell.row).collect(), 35));
        prop_assert_eq!((corner.col, cols), expected(on_map.iter().map(|cell| cell.col).collect(), 63));
    }

    #[test]
    fn an_overview_of_a_part_shows_the_part_of_the_map(
        agents in agents(35, 63, 1, 6),
        cells in prop::collection::vec((0..35_i32, 0..63_i32), 1..3),
        pixels in 1..13_u32,
    ) {
        let agents: Vec<Agent> = agents.into_iter().map(|agent| Agent { name: String::new(), action: None, ..agent })
            .collect();
        let scale = Scale::pixels(pixels).expect("a scale");
        let part_of = Extent::around(&TINY_MAP, cells.into_iter().map(|(row, col)| Cell::new(row, col)), 0);
        let overview = Overview::of_part(&TINY_MAP, Arc::default(), part_of, Some(scale)).expect("it has cells");
        let whole = Renderer::new(&TINY_MAP, Arc::default(), Viewport::whole(&TINY_MAP, scale).expect("a view"));
        let (corner, [rows, cols]) = part_of.cells();
        let [x, y, width, height] = [corner.col, corner.row, cols, rows].map(|cells| cells * pixels as i32);
        let [width, height] = [width, height].map(i32::cast_unsigned);
        let shown = part(&draw(&overview, 0, &agents), PixelBox { x: 34, y: 42, width, height });
        let area = PixelBox { x, y, width, height };
        prop_assert!(shown == part(&whole.draw(&sprites(&agents)), area));
    }

    /// The slow reference finds the zones of every pixel, and whether a pixel near it is outside.
    #[test]
    fn zones_are_tinted_and_outlined(
        zones in prop::collection::vec(prop::collection::vec([[0..35_u32, 0..12], [0..63_u32, 0..12]], 1..4), 0..8),
        (row, col) in (-6..35_i32, -6..63_i32),
        (rows, cols) in (1..30_u32, 1..30_u32),
        pixels in 1..9_u32,
    ) {
        let ends = |[start, length]: [u32; 2], end: u32| [start, (start + length).min(end - 1)];
        let zones: Vec<Vec<_>> = zones.iter()
            .map(|parts| parts.iter().map(|[rows, cols]| [ends(*rows, 35), ends(*cols, 63)]).collect())
            .collect();
        let widths = Widths { street: 7, sidewalk: 3, building: 6, inner_sidewalk: 3 };
        let map = zoned("tiny", 2, widths, &zones);
        let plans = ZonePlan::all(&map);
        prop_assert_eq!(plans.len(), zones.len());
        let is_in = |zone: usize, row: i32, col: i32| zones[zone].iter().any(|[rows, cols]| {
            (rows[0] as i32..=rows[1] as i32).contains(&row) && (cols[0] as i32..=cols[1] as i32).contains(&col)
        });
        for (zone, plan) in plans.iter().enumerate() {
            let mut below = plan.bands.iter().flat_map(|(count, runs)| (0..*count).map(move |_| runs));
            for row in 0..35 {
                let runs = below.next().unwrap();
                for col in 0..63 {
                    let listed = runs.iter().any(|(first, count)| (*first..first + count).contains(&col));
                    prop_assert_eq!(listed, is_in(zone, row, col as i32));
                }
            }
            prop_assert!(below.next().is_none());
        }
        let view = Viewport::new(Cell::new(row, col), rows, cols, Scale::pixels(pixels).unwrap()).unwrap();
        let plain = Renderer::new(&map, Arc::default(), view);
        prop_assert!(plain.ground() == Renderer::new(&TINY_MAP, Arc::default(), view).ground());
        let shown = Renderer::with_zones(&map, Arc::default(), view);
        let side = pixels as i32;
        let cell = |y: i32, x: i32| (row + y.div_euclid(side), col + x.div_euclid(side));
        let pairs = plain.ground().pixels().chunks(3).zip(shown.ground().pixels().chunks(3));
        for (at, (before, after)) in pairs.enumerate() {
            let (y, x) = (at as i32 / (cols as i32 * side), at as i32 % (cols as i32 * side));
            let mut expected: [u8; 3] = before.try_into().unwrap();
            for (zone, ZonePlan { color, dash, .. }) in plans.iter().enumerate() {
                let holds = |(row, col): (i32, i32)| is_in(zone, row, col);
                if !holds(cell(y, x)) {
                    continue;
                }
                let reach = 1..=(side + 2) / 3;
                let line = |place: i32| place.rem_euclid(dash[0] + dash[1]) < dash[0];
                let along_row = reach.clone().any(|by| !holds(cell(y - by, x)) || !holds(cell(y + by, x)));
                let along_col = reach.clone().any(|by| !holds(cell(y, x - by)) || !holds(cell(y, x + by)));
                let (top, left) = (row * side, col * side);
                if along_row && line(left + x) || along_col && line(top + y) {
                    expected = *color;
                } else {
                    expected = std::array::from_fn(|at| {
                        (0.72 * f64::from(expected[at]) + 0.28 * f64::from(color[at])).round() as u8
                    });
                }
            }
            prop_assert_eq!(after, expected.as_slice());
        }
    }

    #[test]
    fn the_picture_of_a_crop_is_a_crop_of_the_picture(
        agents in agents(35, 63, 1, 10),
        (row, col) in (-6..35_i32, -6..63_i32),
        (rows, cols) in (1..30_u32, 1..30_u32),
        scale in prop_oneof![(1..13_u32).prop_map(Scale::pixels), (2..5_u32).prop_map(Scale::cells)],
        percent in 0..=100_u8,
        seed in 0..3_u64,
    ) {
        let scale = scale.expect("a scale");
        let icons = Arc::new(Icons::new(Seed(seed), Difficulty::percent(percent).expect("a percentage")));
        let whole = Viewport::new(Cell::new(-8, -8), 35 + 46, 63 + 46, scale).expect("a view");
        let view = Viewport::new(Cell::new(row, col), rows, cols, scale).expect("a view");
        let large = Renderer::new(&TINY_MAP, Arc::clone(&icons), whole);
        let small = Renderer::new(&TINY_MAP, Arc::new(Icons::new(Seed(seed), icons.difficulty())), view);
        let sprites = sprites(&agents);
        let picture = small.draw(&sprites);
        // The center of one cell in both pictures gives their offset.
        let (here, there) = (view.middle(Cell::new(row, col)).unwrap(), whole.middle(Cell::new(row, col)).unwrap());
        let (x, y) = (there.0 - here.0, there.1 - here.1);
        let area = PixelBox { x, y, width: picture.width(), height: picture.height() };
        prop_assert!(part(&large.draw(&sprites), area) == picture.pixels());
        // Boxes have the same offset, and the buffer's earlier content does not matter.
        let moved = large.boxes(&sprites).into_iter().map(|found| {
            let PixelBox { x, y, width, height } = found?;
            PixelBox { x: x - area.x, y: y - area.y, width, height }.clipped(picture.width(), picture.height())
        });
        prop_assert_eq!(moved.collect::<Vec<_>>(), small.boxes(&sprites));
        let mut buffer = TINY.draw(0, &[]);
        small.draw_into(&sprites, &mut buffer);
        prop_assert!(buffer == picture);
    }
}

/// An agent that is alone on the ground changes the picture mostly inside its box, and hardly at all far from it.
#[test]
fn boxes_contain_the_visible_agent() {
    let view = Viewport::published(Cell::new(0, 0)).unwrap();
    let renderer = Renderer::new(&map("one", 3, ORDINARY), Arc::default(), view);
    for class in Class::known() {
        let name = class.to_string();
        let kind = match name.as_str() {
            "car" | "ambulance" | "bus" | "police" | "tiro" | "reckless" => AgentKind::Car,
            "pedestrian" | "old" | "young" => AgentKind::Pedestrian,
            _ => continue,
        };
        for facing in Facing::ALL {
            let concepts = if name == "car" || name == "pedestrian" {
                Vec::new()
            } else {
                vec![name.clone()]
            };
            let agent = Agent {
                name: String::new(),
                kind,
                concepts,
                at: Cell::new(20, 30),
                facing,
                instance: 4,
                action: None,
            };
            let PixelBox { x, y, width, height } = renderer.boxes(&[agent.sprite()])[0].expect("it is in the picture");
            let picture = renderer.draw(&[agent.sprite()]);
            let (mut inside, mut outside) = (0, 0);
            for (at, (a, b)) in (0_i32..).zip(picture.pixels().chunks(3).zip(renderer.ground().pixels().chunks(3))) {
                let (px, py) = (at % 1024, at / 1024);
                let is_in = (x..x + width as i32).contains(&px) && (y..y + height as i32).contains(&py);
                let changed = a.iter().zip(b).any(|(a, b)| a.abs_diff(*b) > 40);
                *(if is_in { &mut inside } else { &mut outside }) += i32::from(changed);
            }
            let about = format!("{name} {facing:?}: {width} x {height}, {inside} inside, {outside} outside");
            assert!(f64::from(inside) > 0.3 * f64::from(width * height), "{about}");
            assert!(outside < inside / 2, "{about}");
            let (short, long) = (width.min(height), width.max(height));
            match (kind, facing) {
                (AgentKind::Car, Facing::Up | Facing::Right | Facing::Down | Facing::Left) => {
                    assert!((46..=54).contains(&short) && long > 75, "{about}");
                    assert_eq!(
                        width > height,
                        matches!(facing, Facing::Left | Facing::Right),
                        "{about}"
                    );
                }
                (AgentKind::Car, _) => assert!(long - short < 20, "a diagonal car has a square box; {about}"),
                (AgentKind::Pedestrian, _) => assert!((20..=34).contains(&long), "{about}"),
            }
        }
    }
}

/// The pixels of instances at 48 x 48 pixels, without transparent ones.
fn instances(icons: &Icons, class: &Class, numbers: std::ops::Range<u32>) -> Vec<Vec<u8>> {
    numbers
        .map(|number| {
            let bytes = icons.png(class, number, Facing::Up, 48);
            let mut reader = png::Decoder::new(Cursor::new(bytes)).read_info().unwrap();
            let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
            reader.next_frame(&mut pixels).unwrap();
            assert_eq!(pixels.len(), 4 * 48 * 48);
            let over_gray = |pixel: &[u8]| {
                let alpha = u32::from(pixel[3]);
                [0, 1, 2].map(|at| ((u32::from(pixel[at]) * alpha + 128 * (255 - alpha)) / 255) as u8)
            };
            pixels.chunks_exact(4).flat_map(over_gray).collect()
        })
        .collect()
}

/// Width and pixels of a PNG with transparency.
fn rgba(bytes: &[u8]) -> (u32, Vec<u8>) {
    let mut reader = png::Decoder::new(Cursor::new(bytes)).read_info().unwrap();
    let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
    reader.next_frame(&mut pixels).unwrap();
    (reader.info().width, pixels)
}

/// An icon in an atlas is the icon alone, in the middle of its square, and nothing else is in the square.
#[test]
fn an_atlas_has_every_icon_in_the_middle_of_its_square() {
    let icons = Icons::new(Seed(3), Difficulty::NOISY);
    let class = |name: &str| Class::from_name(name).unwrap();
    let names = [
        "car",
        "bus+tiro",
        "ambulance",
        "old",
        "house",
        "gas-station",
        "car+taxi",
    ];
    let list: Vec<(Class, u32, Facing)> = (names.iter().zip(0..).zip(Facing::ALL))
        .map(|((name, instance), facing)| (class(name), instance, facing))
        .collect();
    for (size, count) in [(40, 7), (31, 4), (9, 2), (20, 1)] {
        let atlas = icons.atlas(&list[..count], size);
        let (width, pixels) = rgba(&atlas.png);
        assert_eq!((atlas.size, width), (size, atlas.columns * atlas.side));
        for (number, icon) in (0..).zip(&list[..count]) {
            let alone = icons.atlas(std::slice::from_ref(icon), size);
            let (side, wanted) = rgba(&alone.png);
            assert_eq!((alone.side, alone.columns), (side, 1));
            let corner = (number % atlas.columns * atlas.side, number / atlas.columns * atlas.side);
            let margin = atlas.side / 2 - side / 2;
            let mut seen = 0;
            for (y, x) in (0..atlas.side).flat_map(|y| (0..atlas.side).map(move |x| (y, x))) {
                let at = 4 * ((corner.1 + y) * width + corner.0 + x) as usize;
                let inside = (margin..margin + side).contains(&x) && (margin..margin + side).contains(&y);
                let expected = match inside {
                    true => &wanted[4 * ((y - margin) * side + x - margin) as usize..][..4],
                    false => &[0; 4],
                };
                assert_eq!(&pixels[at..at + 4], expected, "{icon:?} at {x}, {y}");
                seen += u32::from(expected[3] > 0);
            }
            assert!(seen > size, "{icon:?}");
        }
    }
    // Without noise, a building fills its square, as in `Icons::png`.
    let icons = Icons::default();
    let house = (class("house"), 2, Facing::Up);
    let atlas = icons.atlas(std::slice::from_ref(&house), 64);
    assert_eq!(atlas.side, 64);
    assert_eq!(rgba(&atlas.png), rgba(&icons.png(&house.0, 2, Facing::Up, 64)));
}

#[test]
fn the_hundred_instances_of_a_class_differ() {
    let icons = Icons::default();
    let combined = ["bus+tiro", "car+taxi"].map(|name| Class::from_name(name).unwrap());
    for class in Class::known().into_iter().chain(combined) {
        assert_eq!(icons.instances(&class), 100);
        let all = instances(&icons, &class, 0..101);
        assert!(all[100] == all[0], "after a hundred, instances repeat");
        // Comparing a part of the bytes is enough.
        let some: Vec<Vec<u8>> = all[..100]
            .iter()
            .map(|one| one.iter().copied().step_by(11).collect())
            .collect();
        for (number, one) in some.iter().enumerate() {
            for (other, another) in some[..number].iter().enumerate() {
                let difference = mean_difference(one, another);
                assert!(difference > 1.0, "{class}: {number} and {other} differ by {difference}");
            }
        }
    }
}

/// The share of icons that a nearest-mean classifier, trained on other instances, assigns to their class.
fn accuracy(difficulty: Difficulty) -> f64 {
    const LEARNED: u32 = 30;
    let icons = Icons::new(Seed(3), difficulty);
    let classes = Class::known();
    let means: Vec<Vec<u8>> = classes
        .iter()
        .map(|class| {
            let all = instances(&icons, class, 0..LEARNED);
            (0..all[0].len())
                .map(|at| (all.iter().map(|one| u32::from(one[at])).sum::<u32>() / LEARNED) as u8)
                .collect()
        })
        .collect();
    let mut right = 0;
    let mut asked = 0;
    for (class, index) in classes.iter().zip(0..) {
        for one in instances(&icons, class, LEARNED..LEARNED + 15) {
            let far = means.iter().map(|mean| (mean_difference(mean, &one) * 1e6) as u64);
            let nearest = far.enumerate().min_by_key(|&(_, far)| far).map(|(at, _)| at);
            right += i32::from(nearest == Some(index));
            asked += 1;
        }
    }
    f64::from(right) / f64::from(asked)
}

#[test]
fn cleaner_classes_are_recognized_better() {
    let [clean, half, noisy] = [0, 50, 100].map(|percent| accuracy(Difficulty::percent(percent).unwrap()));
    println!("nearest mean of 14 classes: {clean:.2} clean, {half:.2} at 50, {noisy:.2} noisy");
    assert!(clean > 0.8, "{clean}");
    assert!(clean > half && half > noisy, "{clean} {half} {noisy}");
    // Guessing finds one of 14.
    assert!(noisy > 0.25 && noisy < 0.85, "{noisy}");
}

#[test]
fn pictures_are_the_same_on_any_number_of_threads() {
    let view = Viewport::new(Cell::new(0, 0), 35, 63, Scale::pixels(6).unwrap()).unwrap();
    let mut stream = Seed(5).stream(Purpose::TEST, 0, 0);
    let states: Vec<Vec<Agent>> = (0..8)
        .map(|_| {
            let agent = |_| Agent {
                name: String::new(),
                kind: AgentKind::Car,
                concepts: vec!["police".into()],
                at: Cell::new(stream.random_range(0..35), stream.random_range(0..63)),
                facing: Facing::ALL[stream.random_range(0..8)],
                instance: stream.random_range(0..5),
                action: None,
            };
            (0..6).map(agent).collect()
        })
        .collect();
    let alone = Renderer::new(&TINY_MAP, Arc::default(), view);
    let expected: Vec<Picture> = states.iter().map(|agents| alone.draw(&sprites(agents))).collect();
    let shared = Renderer::new(&TINY_MAP, Arc::default(), view);
    std::thread::scope(|scope| {
        for first in 0..4 {
            let (shared, states, expected) = (&shared, &states, &expected);
            scope.spawn(move || {
                for at in (0..states.len()).map(|at| (at + 2 * first) % states.len()) {
                    assert!(shared.draw(&sprites(&states[at])) == expected[at]);
                }
            });
        }
    });
}

/// A red car of 20 x 40 pixels with a blue front, as PNG and as SVG.
fn pack_files() -> Vec<(String, Vec<u8>)> {
    let pixels: Vec<u8> = (0..20 * 40)
        .flat_map(|at| if at < 200 { [0, 0, 255] } else { [255, 0, 0] })
        .collect();
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, 20, 40);
    encoder.set_color(png::ColorType::Rgb);
    encoder.write_header().unwrap().write_image_data(&pixels).unwrap();
    let svg = r##"<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 10 20"><rect width="10" height="20" fill="#f00"/>
        <rect width="10" height="5" fill="#00f"/></svg>"##;
    vec![("bus/b.svg".into(), svg.into()), ("bus/a.png".into(), bytes)]
}

#[test]
fn icons_of_a_pack_extend_or_replace_the_drawn_ones() {
    let [bus, learner] = ["bus", "bus+tiro"].map(|name| Class::from_name(name).unwrap());
    let drawn = Icons::default();
    for (mode, count) in [(Mode::Extend, 102), (Mode::Replace, 2)] {
        let pack = Pack::new(mode, pack_files()).unwrap();
        assert_eq!(
            pack.classes()
                .map(|(class, count)| (class.to_string(), count))
                .collect::<Vec<_>>(),
            [("bus".to_owned(), 2)]
        );
        let icons = Icons::default().with_pack(pack);
        assert_eq!((icons.instances(&bus), icons.instances(&learner)), (count, 100));
        assert!(
            instances(&icons, &learner, 0..3) == instances(&drawn, &learner, 0..3),
            "a class without a folder is drawn"
        );
        let all = instances(&icons, &bus, 0..3);
        let color = |pixels: &[u8], row: usize| <[u8; 3]>::try_from(&pixels[3 * (row * 48 + 24)..][..3]).unwrap();
        for of_pack in &all[..2] {
            assert_eq!(
                (color(of_pack, 6), color(of_pack, 30)),
                ([0, 0, 255], [255, 0, 0]),
                "front and rear"
            );
        }
        assert!(
            mean_difference(&all[0], &all[1]) < 3.0,
            "the PNG and the SVG show the same"
        );
        if mode == Mode::Extend {
            assert!(mean_difference(&all[0], &all[2]) > 10.0, "the drawn ones follow");
        } else {
            assert!(all[2] == all[0]);
        }
    }
}

/// Valid but odd drawings: each is drawn or is an error, without a stack overflow and within seconds.
#[test]
fn odd_drawings_are_drawn_or_give_errors() {
    let deep = |depth: usize| "<g opacity='.5'>".repeat(depth) + "<rect width='5' height='9'/>" + &"</g>".repeat(depth);
    let masks: String = (1..30)
        .map(|at| {
            format!(
                "<mask id='m{at}' mask='url(#m{})'><rect width='9' height='9' fill='#fff'/></mask>",
                at - 1
            )
        })
        .collect();
    let bodies = [
        deep(64),
        deep(400),
        deep(1000),
        "<rect width='1e30' height='1e30' fill='#123'/>".into(),
        "<path d='M0 0 L1e38 -1e38 L5 5' stroke='#000' stroke-width='1e20'/>".into(),
        "<path d='M0 0 H1e6' stroke='#000' stroke-dasharray='1e-6'/>".into(),
        "<path d='M0 0 Q 1e9 NaN 4 4'/>".into(),
        "<g transform='scale(1e-30)'><circle r='1e30'/></g>".into(),
        "<pattern id='p' width='.001' height='.001'><circle r='1'/></pattern><rect width='9' height='9' fill='url(#p)'/>"
            .into(),
        masks + "<rect width='9' height='9' mask='url(#m29)'/>",
        "<circle cx='5' cy='5' r='4' fill='url(#none)'/>".into(),
    ];
    for (number, body) in bodies.into_iter().enumerate() {
        let text = format!("<svg xmlns='http://www.w3.org/2000/svg' viewBox='0 0 10 20'>{body}</svg>");
        let Ok(pack) = Pack::new(Mode::Replace, vec![("car/1.svg".into(), text.into_bytes())]) else {
            continue;
        };
        let icons = Icons::default().with_pack(pack);
        let class = Class::from_name("car").unwrap();
        for facing in [Facing::Up, Facing::DownLeft] {
            assert!(!icons.png(&class, 0, facing, 96).is_empty(), "{number}");
        }
    }
}

#[test]
fn a_gif_stores_only_changed_pixels() {
    let overview = Overview::new(&map("one", 1, ORDINARY), Arc::default()).unwrap();
    let car = |col| Agent {
        name: "Car_1".into(),
        kind: AgentKind::Car,
        concepts: Vec::new(),
        at: Cell::new(49, col),
        facing: Facing::Right,
        instance: 1,
        action: Some(Action::Normal),
    };
    let frames = [10, 12, 12].map(|col| draw(&overview, 1, &[car(col)]));
    let bytes = gif_of(&frames[0], &frames);
    let mut decoder = gif::DecodeOptions::new().read_info(bytes.as_slice()).unwrap();
    let mut sizes = Vec::new();
    while let Some(frame) = decoder.read_next_frame().unwrap() {
        sizes.push((u32::from(frame.width), u32::from(frame.height)));
    }
    assert_eq!(sizes[0], overview.size());
    assert!(sizes[1].0 < 250 && sizes[1].1 < 90, "{sizes:?}");
    assert_eq!(sizes[2], (1, 1), "nothing changed");
}

/// Red, green and blue of a PNG.
fn decode_png(bytes: &[u8]) -> Vec<u8> {
    let mut reader = png::Decoder::new(Cursor::new(bytes)).read_info().unwrap();
    assert_eq!(reader.info().color_type, png::ColorType::Rgb);
    let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
    reader.next_frame(&mut pixels).unwrap();
    pixels
}

#[test]
fn a_png_holds_the_picture() {
    let picture = draw(&TINY, 7, &[]);
    let bytes = png_of(&picture);
    assert_eq!(bytes, png_of(&picture));
    assert!(decode_png(&bytes) == picture.pixels());
}

/// Compares a snapshot with the encoded picture. `UPDATE_SNAPSHOTS=1` writes the file; check the new picture then.
fn compare(name: &str, encode: impl FnOnce(&mut png::Encoder<'_, &mut Vec<u8>>) -> Vec<u8>, picture: &Picture) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/snapshots").join(name);
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, picture.width(), picture.height());
    encoder.set_compression(png::Compression::High);
    let data = encode(&mut encoder);
    encoder.write_header().unwrap().write_image_data(&data).unwrap();
    if std::env::var_os("UPDATE_SNAPSHOTS").is_some() {
        std::fs::write(&path, &bytes).unwrap();
    }
    let known = std::fs::read(&path).expect("the snapshot exists");
    assert!(known.len() < 300_000, "{name} has {} bytes", known.len());
    // Compare pixels, not bytes, since another compressor may give other bytes.
    let decoded = |bytes: &[u8]| {
        let mut reader = png::Decoder::new(Cursor::new(bytes)).read_info().unwrap();
        let palette = reader.info().palette.as_ref().map(|palette| palette.to_vec());
        let mut data = vec![0; reader.output_buffer_size().unwrap()];
        reader.next_frame(&mut data).unwrap();
        (palette, data)
    };
    let same = decoded(&known) == decoded(&bytes);
    assert!(
        same,
        "if the change is intended, run with UPDATE_SNAPSHOTS=1 and check {}",
        path.display()
    );
}

/// Compares every pixel.
fn compare_exactly(name: &str, picture: &Picture) {
    let rgb = |encoder: &mut png::Encoder<'_, &mut Vec<u8>>| {
        encoder.set_color(png::ColorType::Rgb);
        picture.pixels().to_vec()
    };
    compare(name, rgb, picture);
}

/// Compares a picture for README. It has the colors of an animation, so that the file stays small.
fn compare_palette(name: &str, picture: &Picture) {
    let indexed = |encoder: &mut png::Encoder<'_, &mut Vec<u8>>| {
        let bytes = gif_of(picture, std::slice::from_ref(picture));
        let mut decoder = gif::DecodeOptions::new().read_info(bytes.as_slice()).unwrap();
        encoder.set_color(png::ColorType::Indexed);
        encoder.set_palette(decoder.global_palette().unwrap().to_vec());
        encoder.set_filter(png::Filter::NoFilter);
        decoder.read_next_frame().unwrap().unwrap().buffer.to_vec()
    };
    compare(name, indexed, picture);
}

/// One agent of each appearance, stopped and moving, on a tiny map.
#[test]
fn the_picture_of_a_tiny_city() {
    let agent = |name: &str, concepts: &[&str], at: (i32, i32), facing: Facing, action: Option<Action>| Agent {
        name: name.into(),
        kind: if name.starts_with("Car") {
            AgentKind::Car
        } else {
            AgentKind::Pedestrian
        },
        concepts: concepts.iter().map(|&concept| concept.to_owned()).collect(),
        at: Cell::new(at.0, at.1),
        facing,
        instance: 0,
        action,
    };
    let [slow, normal, fast, stop] = Action::STANDARD;
    use Facing::{Down, Left, Right, Up, UpRight};
    let agents = [
        agent("Car_1", &[], (5, 12), Right, Some(normal)),
        agent("Car_2", &["ambulance"], (1, 24), Left, Some(fast)),
        agent("Car_3", &["police"], (20, 1), Down, Some(slow)),
        agent("Car_4", &["bus", "tiro"], (33, 45), Right, Some(stop)),
        agent("Car_5", &["tiro"], (18, 33), Up, Some(stop)),
        agent("Car_6", &["reckless"], (5, 40), Right, Some(fast)),
        agent("Car_7", &["taxi"], (29, 12), Left, Some(normal)),
        agent("Car_8", &["ambulance", "reckless"], (1, 52), UpRight, None),
        agent("Car_9", &[], (-1, 3), Up, Some(normal)),
        agent("Pedestrian_1", &[], (9, 36), Right, Some(normal)),
        agent("Pedestrian_2", &["old"], (25, 26), Up, Some(stop)),
        agent("Pedestrian_3", &["young"], (17, 18), Down, Some(normal)),
        agent("Pedestrian_4", &["jogger"], (9, 30), Left, Some(normal)),
    ];
    compare_exactly("tiny_city.png", &draw(&TINY, 42, &agents));
}

/// The expert city after some ticks: the picture of `run`, and a part as in a visual data set, clean and noisy.
#[test]
fn the_pictures_of_the_expert_city() {
    let world = crate::shipped_world::world("expert", None, |_| ());
    let mut city = Simulation::new(Arc::clone(&world), Split::Test, Seed(1), Settings::default()).unwrap();
    for _ in 0..60 {
        city.tick(&[]).unwrap();
    }
    let names: Vec<String> = city.agents().iter().map(|agent| agent.name().to_string()).collect();
    let decided = city.report().agents.iter().map(|done| Some(done.action));
    let agents = city.agents().iter().zip(&names).zip(decided);
    let sprites: Vec<_> = agents
        .map(|((agent, name), action)| Sprite::of(agent, name, action))
        .collect();
    compare_palette(
        "city.png",
        &Overview::new(world.map(), Arc::default())
            .unwrap()
            .draw(city.now(), &sprites),
    );
    for (name, difficulty) in [("crop.png", Difficulty::CLEAN), ("crop_noisy.png", Difficulty::NOISY)] {
        let view = Viewport::new(Cell::new(26, 26), 48, 64, Scale::pixels(8).unwrap()).unwrap();
        let view = view.with_agents(48, 32).unwrap();
        let icons = Arc::new(Icons::new(Seed(0), difficulty));
        compare_palette(name, &Renderer::new(world.map(), icons, view).draw(&sprites));
    }
}

#[test]
fn cars_turn_in_two_halves_and_keep_their_pose_when_they_stop() {
    let world = crate::shipped_world::world("expert", None, |_| ());
    let mut city = Simulation::new(world, Split::Test, Seed(2), Settings::default()).unwrap();
    let poses = |city: &Simulation| -> Vec<Facing> {
        let agents = city.agents().iter();
        agents.map(|agent| Sprite::of(agent, "", None).facing).collect()
    };
    let mut before = poses(&city);
    let (mut halves, mut stops) = (0, 0);
    for _ in 0..200 {
        city.tick(&[]).unwrap();
        let after = poses(&city);
        for (agent, (done, now)) in city.report().agents.iter().zip(&after).enumerate() {
            if done.moved.from == done.moved.to && !done.moved.replanned {
                assert_eq!(*now, before[agent]);
                stops += 1;
            } else if let Some(heading) = city.agents()[agent].heading {
                let straight = Facing::from(heading);
                let place = |facing| Facing::ALL.iter().position(|&one| one == facing).unwrap();
                let eighths = (place(*now) + 8 - place(straight)) % 8;
                assert!([0, 1, 7].contains(&eighths), "{straight:?} {now:?}");
                halves += usize::from(eighths != 0);
            }
        }
        before = after;
    }
    assert!(halves > 20 && stops > 100, "{halves} {stops}");
}

/// The legend names the first zones and counts the others.
#[test]
fn the_picture_of_a_city_with_many_zones() {
    let block = |at: u32| vec![[[4 * (at % 6), 4 * (at % 6) + 6], [4 * at, 4 * at + 9]]];
    let zones: Vec<_> = (0..13).map(block).collect();
    let map = zoned("zones", 2, ORDINARY, &zones);
    let picture = Overview::new(&map, Arc::default()).unwrap().draw(0, &[]);
    compare_palette("zones.png", &picture);
}

#[test]
fn the_picture_of_all_icons() {
    let more = [Class::from_name("bus+tiro").unwrap()];
    compare_palette("icons.png", &sheet(&Icons::default(), &more));
}

#[test]
fn the_size_of_the_picture_of_a_huge_map_is_bounded() {
    // 57 x 4059 cells.
    let long = map("long", 88, ORDINARY);
    let (width, height) = Overview::new(&long, Arc::default()).unwrap().size();
    assert!(width < 2000 && height < 2000, "{width} x {height}");
    assert_eq!(
        Viewport::whole(&long, Scale::pixels(8).unwrap()),
        Err(ViewportError::TooLarge)
    );
}

#[test]
fn views_that_cannot_be_drawn_are_errors() {
    let scale = Scale::pixels(8).unwrap();
    assert_eq!(Viewport::new(Cell::new(0, 0), 0, 1, scale), Err(ViewportError::Empty));
    assert_eq!(
        Viewport::new(Cell::new(0, 0), u32::MAX, 1, scale),
        Err(ViewportError::TooLarge)
    );
    assert_eq!(
        Viewport::new(Cell::new(i32::MAX, 0), 2, 1, scale),
        Err(ViewportError::TooLarge)
    );
    assert_eq!(
        Viewport::new(Cell::new(0, 0), 2000, 2000, scale),
        Err(ViewportError::TooLarge)
    );
    let view = Viewport::new(Cell::new(0, 0), 10, 10, scale).unwrap();
    assert_eq!(view.with_agents(0, 10), Err(ViewportError::IconSize));
    assert_eq!(
        (Scale::pixels(0), Scale::pixels(65), Scale::cells(0)),
        (None, None, None)
    );
    // The last possible cell.
    let last = Viewport::new(Cell::new(i32::MAX, i32::MIN), 1, 1, scale).unwrap();
    assert_eq!(
        Renderer::new(&TINY_MAP, Arc::default(), last).draw(&[]).pixels().len(),
        3 * 64
    );
}

#[test]
fn frames_of_another_size_are_errors() {
    let sample = draw(&TINY, 0, &[]);
    let other = draw(
        &Overview::new(&map("other", 1, ORDINARY), Arc::default()).unwrap(),
        0,
        &[],
    );
    let mut animation = Animation::new(Vec::new(), &sample, Duration::ZERO).unwrap();
    let error = animation.push(&other).unwrap_err();
    assert_eq!(error.kind(), io::ErrorKind::InvalidInput);
}

#[test]
fn a_failing_output_is_an_error_and_no_panic() {
    /// Accepts this number of bytes, then fails.
    struct Full(usize);
    impl Write for Full {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            if self.0 == 0 {
                return Err(io::ErrorKind::StorageFull.into());
            }
            let taken = bytes.len().min(self.0);
            self.0 -= taken;
            Ok(taken)
        }
        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }
    let frame = draw(&TINY, 0, &[]);
    for room in [0, 10, 1000, 2000] {
        let result = Animation::new(Full(room), &frame, Duration::ZERO).and_then(|mut gif| {
            gif.push(&frame)?;
            gif.finish()
        });
        assert_eq!(result.err().map(|error| error.kind()), Some(io::ErrorKind::StorageFull));
        let result = write_png(&frame, Full(room));
        assert_eq!(result.err().map(|error| error.kind()), Some(io::ErrorKind::StorageFull));
    }
}

/// The looks of a configuration, as loading gives them.
fn own_look(name: &str, of: AgentKind, look: Look) -> OwnLook {
    OwnLook {
        of,
        name: name.to_owned(),
        look,
    }
}

/// Icons with the looks of a configuration differ from each other, and change nothing for other agents.
#[test]
fn looks_of_a_configuration_can_be_told_apart() {
    let text = |text: &str| Some(text.to_owned());
    let svg = |color: &str| {
        let start = r#"<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 20 50">"#;
        Some(Arc::from(format!(
            r##"{start}<rect width="20" height="50" rx="4" fill="{color}"/></svg>"##
        )))
    };
    let looks = |of: AgentKind, icon: &str| {
        let plain = Look::default();
        let red = Some([0xd6, 0x2f, 0x2f]);
        let blue = Some([0x2f, 0x6f, 0xd0]);
        let all = [
            Look {
                color: red,
                ..plain.clone()
            },
            Look {
                color: blue,
                ..plain.clone()
            },
            Look {
                badge: text("A"),
                ..plain.clone()
            },
            Look {
                badge: text("AB"),
                ..plain.clone()
            },
            Look {
                badge: text("A"),
                color: red,
                ..plain.clone()
            },
            Look {
                icon: text(icon),
                ..plain.clone()
            },
            Look {
                icon: text(icon),
                color: blue,
                ..plain.clone()
            },
            Look {
                icon: text(icon),
                badge: text("7"),
                ..plain.clone()
            },
            Look {
                drawing: svg("#c8102e"),
                ..plain.clone()
            },
            Look {
                drawing: svg("#10c82e"),
                ..plain.clone()
            },
            Look {
                drawing: svg("#c8102e"),
                badge: text("1"),
                ..plain
            },
        ];
        let named = (all.into_iter().enumerate()).map(|(number, look)| own_look(&format!("own{number}"), of, look));
        named.collect::<Vec<_>>()
    };
    for (of, icon) in [
        (AgentKind::Car, "bus"),
        (AgentKind::Car, "bicycle"),
        (AgentKind::Pedestrian, "old"),
    ] {
        let own = looks(of, icon);
        let icons = Icons::new(Seed(5), Difficulty::CLEAN).with_looks(&own).unwrap();
        let drawn: Vec<Vec<u8>> = (own.iter())
            .map(|own| icons.png(&Class::agent(of, std::slice::from_ref(&own.name)), 0, Facing::Up, 48))
            .collect();
        for (one, other) in (0..drawn.len()).flat_map(|one| (0..one).map(move |other| (one, other))) {
            let difference = mean_difference(&rgba(&drawn[one]).1, &rgba(&drawn[other]).1);
            assert!(difference > 0.5, "{of:?} {icon}: {one} and {other}, {difference}");
        }
        // A drawing turns with a car, and not with a pedestrian.
        let class = Class::agent(of, &["own8".to_owned()]);
        let [up, left] = [Facing::Up, Facing::Left].map(|facing| rgba(&icons.png(&class, 0, facing, 48)).1);
        assert_eq!(mean_difference(&up, &left) > 10.0, of == AgentKind::Car);
        let plain = Icons::new(Seed(5), Difficulty::CLEAN);
        for class in Class::known() {
            assert_eq!(
                icons.png(&class, 3, Facing::Up, 32),
                plain.png(&class, 3, Facing::Up, 32)
            );
        }
    }
    // A chosen color covers most of a car; the hue of a drawing is kept.
    let own = looks(AgentKind::Car, "bus");
    let icons = Icons::new(Seed(5), Difficulty::CLEAN).with_looks(&own).unwrap();
    for (name, reddish) in [("own0", true), ("own1", false), ("own8", true)] {
        let class = Class::agent(AgentKind::Car, &[name.to_owned()]);
        for instance in 0..10 {
            let (_, pixels) = rgba(&icons.png(&class, instance, Facing::Up, 48));
            let colored = pixels.chunks_exact(4).filter(|pixel| {
                let (red, blue) = (i32::from(pixel[0]), i32::from(pixel[2]));
                pixel[3] > 200 && (red - blue).abs() > 50 && (red > blue) == reddish
            });
            let opaque = pixels.chunks_exact(4).filter(|pixel| pixel[3] > 200).count();
            assert!(3 * colored.count() > opaque, "{name}, instance {instance}");
        }
    }
    let faulty = own_look(
        "own",
        AgentKind::Car,
        Look {
            drawing: Some(Arc::from("<svg>")),
            ..Look::default()
        },
    );
    let fault = Icons::default().with_looks(&[faulty]).unwrap_err();
    assert!(fault.reason.contains("not an SVG drawing"), "{fault:?}");
}
