//! Pictures through the public interface: equal input, equal bytes; what is decoded is what was drawn; nothing panics.

use logicity::city::{Cell, CityMap, Heading};
use logicity::config::{AgentKind, Building, Buildings, Located, MapConfig, Speed, Widths};
use logicity::diag::{Sources, Span};
use logicity::render::{Animation, Frame, Painter, Sprite, write_png};
use proptest::prelude::*;
use std::io::{self, Cursor, Write};
use std::path::Path;
use std::sync::LazyLock;
use std::time::Duration;

/// A map of one row of blocks, every building type on it.
fn map(name: &str, block_cols: u32, widths: Widths) -> CityMap {
    let mut sources = Sources::new();
    let span = Span::new(sources.add("map", ""), 0..0);
    let types = [
        Building::House,
        Building::Office,
        Building::Garage,
        Building::Store,
        Building::GasStation,
    ];
    let row = |from: usize| {
        (from..)
            .take(2 * block_cols as usize)
            .map(|at| types[at % types.len()])
            .collect()
    };
    let config = MapConfig {
        name: name.into(),
        blocks: Located {
            value: [1, block_cols],
            span,
        },
        widths: Located { value: widths, span },
        buildings: Located {
            value: Buildings::Fixed(vec![row(0), row(3)]),
            span,
        },
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
static TINY: LazyLock<Painter> = LazyLock::new(|| {
    let widths = Widths {
        street: 7,
        sidewalk: 3,
        building: 6,
        inner_sidewalk: 3,
    };
    Painter::new(&map("tiny", 2, widths)).expect("it has cells")
});

/// An agent that owns what a [`Sprite`] borrows.
#[derive(Clone, Debug)]
struct Agent {
    name: String,
    kind: AgentKind,
    concepts: Vec<String>,
    at: Cell,
    heading: Option<Heading>,
    action: Option<Speed>,
}

impl Agent {
    fn sprite(&self) -> Sprite<'_> {
        Sprite {
            name: &self.name,
            kind: self.kind,
            concepts: &self.concepts,
            at: self.at,
            heading: self.heading,
            action: self.action,
        }
    }
}

fn draw(painter: &Painter, tick: u64, agents: &[Agent]) -> Frame {
    painter.frame(tick, &agents.iter().map(Agent::sprite).collect::<Vec<_>>())
}

/// Agents on the cells of a map of that size and up to `beyond` cells outside.
fn agents(rows: i32, cols: i32, beyond: i32, most: usize) -> impl Strategy<Value = Vec<Agent>> {
    let concept = prop_oneof![
        prop::sample::select(vec!["ambulance", "police", "bus", "tiro", "reckless", "old", "young"])
            .prop_map(str::to_owned),
        ".{0,30}",
    ];
    let name = prop_oneof!["Car_[0-9]{1,12}", "Pedestrian_[0-9]{1,2}", any::<String>()];
    let agent = (
        name,
        prop::sample::select(vec![AgentKind::Car, AgentKind::Pedestrian]),
        prop::collection::vec(concept, 0..3),
        (-beyond..rows + beyond, -beyond..cols + beyond),
        prop::option::of(prop::sample::select(Heading::ALL.to_vec())),
        prop::option::of(prop::sample::select(Speed::ALL.to_vec())),
    )
        .prop_map(|(name, kind, concepts, (row, col), heading, action)| Agent {
            name,
            kind,
            concepts,
            at: Cell::new(row, col),
            heading,
            action,
        });
    prop::collection::vec(agent, 0..most)
}

fn gif_of(painter: &Painter, frames: &[Frame]) -> Vec<u8> {
    let mut animation = Animation::new(Vec::new(), painter, Duration::from_millis(150)).unwrap();
    for frame in frames {
        animation.push(frame).unwrap();
    }
    animation.finish().unwrap()
}

fn png_of(frame: &Frame) -> Vec<u8> {
    let mut bytes = Vec::new();
    write_png(frame, &mut bytes).unwrap();
    bytes
}

/// What a viewer shows of a GIF, frame by frame, with the delay of each: each frame is laid over the ones before.
fn shown(bytes: &[u8]) -> Vec<(Vec<u8>, u16)> {
    let mut decoder = gif::DecodeOptions::new().read_info(bytes).unwrap();
    let (width, height) = (usize::from(decoder.width()), usize::from(decoder.height()));
    let mut canvas = vec![0; width * height];
    let mut all = Vec::new();
    while let Some(frame) = decoder.read_next_frame().unwrap() {
        assert_eq!(frame.dispose, gif::DisposalMethod::Keep);
        assert_eq!(frame.palette, None, "all frames use the palette of the file");
        for (row, line) in frame.buffer.chunks_exact(frame.width.into()).enumerate() {
            let start = (usize::from(frame.top) + row) * width + usize::from(frame.left);
            for (pixel, index) in canvas[start..].iter_mut().zip(line) {
                if Some(*index) != frame.transparent {
                    *pixel = *index;
                }
            }
        }
        all.push((canvas.clone(), frame.delay));
    }
    all
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(16))]

    #[test]
    fn a_gif_shows_the_frames_that_were_pushed(
        states in prop::collection::vec(agents(35, 63, 2, 6), 1..5),
        pause in prop::collection::vec(any::<bool>(), 5),
    ) {
        // A pause shows the same frame again.
        let frames: Vec<Frame> = states
            .iter()
            .zip(&pause)
            .enumerate()
            .flat_map(|(tick, (agents, pause))| vec![draw(&TINY, tick as u64, agents); 1 + usize::from(*pause)])
            .collect();
        let bytes = gif_of(&TINY, &frames);
        let decoded = shown(&bytes);
        prop_assert_eq!(decoded.len(), frames.len());
        for (frame, (pixels, delay)) in frames.iter().zip(decoded) {
            prop_assert!(frame.pixels() == pixels);
            prop_assert_eq!(delay, 15);
        }
        prop_assert!(gif_of(&TINY, &frames) == bytes);
    }

    #[test]
    fn any_agents_can_be_drawn_and_a_frame_depends_on_nothing_else(
        first in agents(35, 63, 3, 12),
        mut second in agents(35, 63, i32::MAX - 63, 12),
    ) {
        // The highest tick there is, and names longer than any line.
        let alone = draw(&TINY, u64::MAX, &first);
        prop_assert_eq!((alone.width(), alone.height()), TINY.size());
        for agent in &mut second {
            agent.concepts.push("x".repeat(5000));
        }
        draw(&TINY, 0, &second);
        prop_assert!(draw(&TINY, u64::MAX, &first) == alone);
    }
}

#[test]
fn a_gif_stores_only_what_changes() {
    let painter = Painter::new(&map("one", 1, ORDINARY)).unwrap();
    let car = |col| Agent {
        name: "Car_1".into(),
        kind: AgentKind::Car,
        concepts: Vec::new(),
        at: Cell::new(49, col),
        heading: Some(Heading::Right),
        action: Some(Speed::Normal),
    };
    let frames = [
        draw(&painter, 1, &[car(10)]),
        draw(&painter, 1, &[car(12)]),
        draw(&painter, 1, &[car(12)]),
    ];
    let bytes = gif_of(&painter, &frames);
    let mut decoder = gif::DecodeOptions::new().read_info(bytes.as_slice()).unwrap();
    assert!(
        decoder
            .global_palette()
            .unwrap()
            .starts_with(frames[0].palette().as_flattened())
    );
    let mut sizes = Vec::new();
    while let Some(frame) = decoder.read_next_frame().unwrap() {
        sizes.push((frame.width, frame.height));
    }
    assert_eq!(sizes[0], painter.size());
    assert!(sizes[1].0 < 200 && sizes[1].1 < 60, "{sizes:?}");
    assert_eq!(sizes[2], (1, 1), "nothing changed");
}

#[test]
fn a_png_holds_the_frame() {
    let frame = draw(&TINY, 7, &[]);
    let bytes = png_of(&frame);
    assert_eq!(bytes, png_of(&frame));
    let (pixels, palette) = decode_png(&bytes);
    assert!(pixels == frame.pixels());
    assert_eq!(palette, frame.palette().as_flattened());
}

/// Palette indices and palette.
fn decode_png(bytes: &[u8]) -> (Vec<u8>, Vec<u8>) {
    let mut reader = png::Decoder::new(Cursor::new(bytes)).read_info().unwrap();
    let palette = reader.info().palette.as_ref().expect("it is indexed").to_vec();
    let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
    reader.next_frame(&mut pixels).unwrap();
    (pixels, palette)
}

/// One agent of each look, stopped and moving, on a tiny map. `UPDATE_SNAPSHOTS=1` writes the file anew; look at it
/// then.
#[test]
fn the_picture_of_a_tiny_city() {
    let agent =
        |name: &str, concepts: &[&str], at: (i32, i32), heading: Option<Heading>, action: Option<Speed>| Agent {
            name: name.into(),
            kind: if name.starts_with("Car") {
                AgentKind::Car
            } else {
                AgentKind::Pedestrian
            },
            concepts: concepts.iter().map(|&concept| concept.to_owned()).collect(),
            at: Cell::new(at.0, at.1),
            heading,
            action,
        };
    use Heading::{Down, Left, Right, Up};
    use Speed::{Fast, Normal, Slow, Stop};
    let agents = [
        agent("Car_1", &[], (5, 12), Some(Right), Some(Normal)),
        agent("Car_2", &["ambulance"], (1, 24), Some(Left), Some(Fast)),
        agent("Car_3", &["police"], (20, 1), Some(Down), Some(Slow)),
        agent("Car_4", &["bus"], (33, 45), Some(Right), Some(Stop)),
        agent("Car_5", &["tiro"], (18, 33), Some(Up), Some(Stop)),
        agent("Car_6", &["reckless"], (5, 40), Some(Right), Some(Fast)),
        agent("Car_7", &["taxi"], (29, 12), Some(Left), Some(Normal)),
        agent("Car_8", &["ambulance", "reckless"], (1, 52), None, Some(Normal)),
        agent("Car_9", &[], (-1, 3), Some(Up), Some(Normal)),
        agent("Pedestrian_1", &[], (9, 36), Some(Right), Some(Normal)),
        agent("Pedestrian_2", &["old"], (25, 26), Some(Up), Some(Stop)),
        agent("Pedestrian_3", &["young"], (17, 18), None, Some(Normal)),
        agent("Pedestrian_4", &["jogger"], (9, 30), Some(Left), Some(Normal)),
    ];
    let frame = draw(&TINY, 42, &agents);
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/snapshots/tiny_city.png");
    if std::env::var_os("UPDATE_SNAPSHOTS").is_some() {
        std::fs::write(&path, png_of(&frame)).unwrap();
    }
    let (pixels, palette) = decode_png(&std::fs::read(&path).expect("the snapshot is there"));
    let advice = "if the change is meant, run with UPDATE_SNAPSHOTS=1 and look at tests/snapshots/tiny_city.png";
    assert!(
        pixels == frame.pixels() && palette == frame.palette().as_flattened(),
        "{advice}"
    );
}

#[test]
fn the_picture_of_a_huge_map_is_bounded() {
    // 57 x 4059 cells.
    let painter = Painter::new(&map("long", 88, ORDINARY)).unwrap();
    let (width, height) = painter.size();
    assert!(width < 2000 && height < 2000, "{width} x {height}");
}

#[test]
fn frames_of_another_size_are_refused() {
    let other = Painter::new(&map("other", 1, ORDINARY)).unwrap();
    let mut animation = Animation::new(Vec::new(), &TINY, Duration::ZERO).unwrap();
    let error = animation.push(&draw(&other, 0, &[])).unwrap_err();
    assert_eq!(error.kind(), io::ErrorKind::InvalidInput);
}

#[test]
fn a_failing_output_is_an_error_and_no_panic() {
    /// Takes so many bytes and then fails.
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
        let result = Animation::new(Full(room), &TINY, Duration::ZERO).and_then(|mut gif| {
            gif.push(&frame)?;
            gif.finish()
        });
        assert_eq!(result.err().map(|error| error.kind()), Some(io::ErrorKind::StorageFull));
        let result = write_png(&frame, Full(room));
        assert_eq!(result.err().map(|error| error.kind()), Some(io::ErrorKind::StorageFull));
    }
}
