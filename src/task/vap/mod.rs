//! Visual Action Prediction: predict the next action of every car from a picture of the city.
//!
//! - [`DatasetWriter`] writes the worlds of a split to a folder. [`Dataset`] opens and checks such a folder.
//! - [`Worlds`] computes the worlds of one split. A world has [`TICKS`] ticks; those from [`FIRST_TICK`] on are
//!   [`Frame`]s. A [`Renderer`] draws them on the ground of the world.
//! - [`table`] stores the facts of frames as columns.
// Decision: docs/decisions/pictures.md#d046

mod card;
mod check;
pub mod codes;
mod dataset;
mod error;
mod folder;
mod merge;
mod stats;
pub mod table;

pub use check::Dataset;
pub use dataset::{DatasetRequest, DatasetSummary, DatasetWriter, WORLDS_MAX};
pub use error::{DatasetError, Occupied};
pub use folder::{DatasetSettings, FileRecord, MANIFEST, Manifest, ShardFile, WorldRecord};
pub use merge::merge;
pub use stats::{Estimate, Statistics, WorldCounts};

use crate::city::{Action, AgentGroup, AgentKind, AgentName, AgentSet, Split};
use crate::city::{Cell, Heading};
use crate::config::Scenario;
use crate::datalog::Program;
use crate::diag::Diagnostic;
use crate::render::{Class, Facing, Framing, Icons, Picture, PixelBox, Placement, Renderer, Scale, Sprite, Viewport};
use crate::rng::{Purpose, Rng, RngExt, Seed};
use crate::sim::{Facts, Settings, Simulation, Vocabulary, World};
use std::collections::BTreeMap;
use std::sync::Arc;

impl Purpose {
    /// The seeds of the worlds of a data set; index: number of the world, tick: the split.
    pub const WORLD: Purpose = Purpose::new(13);

    /// The drawn agents of a world.
    pub const CAST: Purpose = Purpose::new(14);

    /// How a picture shows an agent: the instance of its class, and its framing; index: agent, tick: the tick.
    pub const LOOK: Purpose = Purpose::new(15);
}

/// The number of ticks of a world.
pub const TICKS: u64 = 100;

/// The first tick that is a frame. Earlier, agents may have no heading yet.
pub const FIRST_TICK: u64 = 11;

/// The concepts of random cars. Each has the weight [`CONCEPT`]; no concept has the weight [`PLAIN`].
const CONCEPTS: [&str; 5] = ["ambulance", "bus", "police", "reckless", "tiro"];
const CONCEPT: u32 = 18;
const PLAIN: u32 = 10;

/// The rules of a data set, in the paper's terms.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mode {
    /// Easy mode.
    Easy,
    /// Hard mode.
    Hard,
}

impl Mode {
    /// Both modes.
    pub const ALL: [Mode; 2] = [Mode::Easy, Mode::Hard];

    /// Returns the name: `easy` or `hard`.
    pub const fn name(self) -> &'static str {
        match self {
            Mode::Easy => "easy",
            Mode::Hard => "hard",
        }
    }

    /// Returns the name of the built-in configuration: `vap-easy` or `vap-hard`.
    pub const fn config(self) -> &'static str {
        match self {
            Mode::Easy => "vap-easy",
            Mode::Hard => "vap-hard",
        }
    }

    /// Returns the label counts of the paper's fixed test set, in the order of [`Action::STANDARD`].
    pub const fn published_actions(self) -> [u64; 4] {
        match self {
            Mode::Easy => [3042, 3978, 0, 7220],
            Mode::Hard => [4155, 2882, 715, 6488],
        }
    }
}

/// The agents of the worlds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Agents {
    /// The agents of the configuration.
    Fixed,
    /// Agents drawn for each world.
    Random,
}

impl Agents {
    /// Both variants.
    pub const ALL: [Agents; 2] = [Agents::Fixed, Agents::Random];

    /// Returns the name: `fixed` or `random`.
    pub const fn name(self) -> &'static str {
        match self {
            Agents::Fixed => "fixed",
            Agents::Random => "random",
        }
    }
}

/// The side of a picture in pixels.
pub const SIDE: u32 = 1024;

/// Returns the seed of the icons of a split. Training and test icons thus differ.
pub fn icon_seed(seed: u64, split: Split) -> Seed {
    Seed(Seed(seed).stream(Purpose::ICON, split as u64, 0).random())
}

/// Returns the number of worlds of the published set.
pub const fn published_worlds(split: Split) -> u32 {
    match split {
        Split::Train => 100,
        Split::Val | Split::Test => 20,
    }
}

/// The worlds of a split. World `k` is a function of seed, split and `k`, so any process can compute any world.
pub struct Worlds {
    world: Arc<World>,
    placement: Placement,
    agents: Agents,
    split: Split,
    seed: u64,
}

/// A state of a city, with the actions that the rules choose in it.
#[derive(Clone, Debug)]
pub struct Frame {
    /// The tick.
    pub tick: u64,
    /// The agents in list order.
    pub agents: Vec<FrameAgent>,
    /// All base facts about the agents.
    pub facts: Facts,
}

/// An agent of a frame.
#[derive(Clone, Debug)]
pub struct FrameAgent {
    /// The name, which includes the kind.
    pub name: AgentName,
    /// The names of its concepts.
    pub concepts: Arc<[String]>,
    /// The priority; a smaller number goes first.
    pub priority: i32,
    /// The cell.
    pub at: Cell,
    /// The direction of the last move.
    pub heading: Option<Heading>,
    /// The direction in which the icon faces.
    pub facing: Facing,
    /// The instance of its class in the picture, from 0; less than [`Icons::instances`].
    pub instance: u32,
    /// How the picture shows it; `None` at difficulty 0 and in drawing version 1.
    pub framing: Option<Framing>,
    /// The action that the rules choose.
    pub action: Action,
}

impl FrameAgent {
    /// Returns the icon of the agent in a picture.
    pub fn sprite<'a>(&'a self, name: &'a str) -> Sprite<'a> {
        Sprite {
            name,
            kind: self.name.kind,
            kind_name: None,
            concepts: &self.concepts,
            at: self.at,
            facing: self.facing,
            instance: self.instance,
            framing: self.framing,
            action: None,
        }
    }
}

impl Frame {
    /// Returns the icons of all agents in a picture.
    pub fn sprites(&self) -> Vec<Sprite<'_>> {
        self.agents.iter().map(|agent| agent.sprite("")).collect()
    }
}

impl Worlds {
    /// Prepares the common part of all worlds. The icons should have the seed [`icon_seed`] and the split `split`.
    ///
    /// # Errors
    /// As [`World::new`] and [`Simulation::new`].
    pub fn new(
        scenario: Scenario,
        program: Program,
        icons: Arc<Icons>,
        agents: Agents,
        split: Split,
        seed: u64,
    ) -> Result<Worlds, Vec<Diagnostic>> {
        let world = Arc::new(World::new(scenario, program)?);
        let standard = world.only_standard("data sets of pictures");
        standard.map_err(|fault| vec![fault])?;
        // Detects a missing split, and agents that cannot be placed.
        Simulation::new(Arc::clone(&world), split, Seed(seed), Settings::default()).map_err(|fault| vec![fault])?;
        let view = Viewport::published(Cell::new(0, 0)).expect("the first cell is a corner");
        Ok(Worlds {
            placement: Placement::new(world.map(), icons, view),
            world,
            agents,
            split,
            seed,
        })
    }

    /// Returns the world that all cities share: scenario, map, roads and rules.
    pub fn world(&self) -> &Arc<World> {
        &self.world
    }

    /// Returns the renderer of a world. It shows the first 128 rows and columns, 8 pixels per cell, with the textures
    /// and buildings of this world.
    pub fn renderer(&self, number: u32) -> Renderer {
        Renderer::with_ground(self.world.map(), self.placement.clone(), Seed(self.seed(number)))
    }

    /// Returns which agent each pixel of the picture of a frame shows, as [`Placement::mask`].
    pub fn mask(&self, frame: &Frame) -> Vec<u8> {
        self.placement.mask(&frame.sprites())
    }

    /// Returns a small picture that contains all drawn elements: a corner of the ground of world 0, and overlapping
    /// agents of every known class in every facing. Most changes of the drawing code change it.
    pub fn specimen(&self) -> Picture {
        let scale = Scale::pixels(8).expect("within bounds");
        let view = Viewport::new(Cell::new(0, 0), 20, 40, scale).and_then(|view| view.with_agents(48, 32));
        let placement = Placement::new(
            self.world.map(),
            Arc::clone(self.placement.icons()),
            view.expect("it is small"),
        );
        let renderer = Renderer::with_ground(self.world.map(), placement, Seed(self.seed(0)));
        let classes = Class::known();
        let facings = |place| {
            Facing::ALL
                .into_iter()
                .enumerate()
                .map(move |(turn, facing)| (place, turn, facing))
        };
        let mut stream = Seed(self.seed(0)).stream(Purpose::LOOK, 0, TICKS);
        let agents = (0..classes.len())
            .flat_map(facings)
            .filter_map(|(place, turn, facing)| {
                let (kind, concepts) = classes[place].of_agent()?;
                Some(Sprite {
                    name: "",
                    kind,
                    kind_name: None,
                    concepts,
                    at: Cell::new(1 + 2 * turn as i32, 2 + 4 * place as i32),
                    facing,
                    instance: place as u32,
                    framing: self.placement.icons().framing(&mut stream),
                    action: None,
                })
            });
        renderer.draw(&agents.collect::<Vec<_>>())
    }

    /// Returns the seed of a world. With fixed agents, `logicity run` with this seed shows the same city.
    pub fn seed(&self, number: u32) -> u64 {
        Seed(self.seed)
            .stream(Purpose::WORLD, number.into(), self.split as u64)
            .random()
    }

    /// Computes the frames of a world.
    ///
    /// # Errors
    /// As [`Simulation::new`] and [`Simulation::tick`].
    pub fn frames(&self, number: u32) -> Result<Vec<Frame>, Diagnostic> {
        let seed = Seed(self.seed(number));
        let world = match self.agents {
            Agents::Fixed => Arc::clone(&self.world),
            Agents::Random => self.with_drawn_agents(seed)?,
        };
        let mut city = Simulation::new(world, self.split, seed, Settings::default())?;
        let mut frames = Vec::new();
        for tick in 0..TICKS {
            // A frame shows the agents before they move, in the state of the decision.
            let agents = city.agents().iter().enumerate().map(|(index, agent)| {
                let sprite = Sprite::of(agent, "", None);
                let mut look = seed.stream(Purpose::LOOK, index as u64, tick);
                let drawn: u32 = look.random();
                FrameAgent {
                    name: agent.name(),
                    concepts: Arc::clone(&agent.concepts),
                    priority: agent.priority,
                    at: agent.cell,
                    heading: agent.heading,
                    facing: sprite.facing,
                    instance: drawn % self.placement.icons().instances(&sprite.class()),
                    framing: self.placement.icons().framing(&mut look),
                    action: Action::Stop,
                }
            });
            let mut agents: Vec<FrameAgent> = agents.collect();
            city.tick(&[])?;
            if tick < FIRST_TICK {
                continue;
            }
            for (agent, done) in agents.iter_mut().zip(&city.report().agents) {
                agent.action = done.action;
            }
            frames.push(Frame {
                tick,
                agents,
                facts: city.facts(|_| true)?,
            });
        }
        Ok(frames)
    }

    /// Returns the box of each agent of a frame in pixels, as [`Placement::boxes`]; `None` outside the picture.
    pub fn boxes(&self, frame: &Frame) -> Vec<Option<PixelBox>> {
        self.placement.boxes(&frame.sprites())
    }

    /// Returns the visible fraction of each agent of a frame, as [`Placement::visible`].
    pub fn visible(&self, frame: &Frame) -> Vec<Option<f32>> {
        self.placement.visible(&frame.sprites())
    }

    /// Returns the shared world with drawn agents.
    fn with_drawn_agents(&self, seed: Seed) -> Result<Arc<World>, Diagnostic> {
        let mut scenario = self.world.scenario.clone();
        for (split, set) in &mut scenario.splits {
            if *split == self.split {
                *set = draw_agents(set, *split, &mut seed.stream(Purpose::CAST, 0, 0));
            }
        }
        // Changing the agents cannot make valid rules invalid.
        let world = World::new(scenario, self.world.program.clone());
        Ok(Arc::new(world.map_err(|mut faults| faults.swap_remove(0))?))
    }
}

/// Draws agents as in the paper: 12 in training, otherwise 13 to 15.
///
/// Of these, 3 to 5 are pedestrians, or 5 to 7 in the test set; at least one is old and two are young. Cars have the
/// priorities 1, 2, ... in random order.
fn draw_agents(like: &AgentSet, split: Split, stream: &mut impl Rng) -> AgentSet {
    let count = match split {
        Split::Train => 12,
        Split::Val | Split::Test => stream.random_range(13..=15),
    };
    let walking = match split {
        Split::Test => stream.random_range(5..=7),
        Split::Train | Split::Val => stream.random_range(3..=5),
    };
    let group = |concepts: &[&str], priority: i32| AgentGroup {
        count: 1,
        concepts: concepts.iter().map(|&concept| concept.to_owned()).collect(),
        priority,
    };
    let mut pedestrians = vec![group(&["old"], 0), group(&["young"], 0), group(&["young"], 0)];
    while pedestrians.len() < walking {
        pedestrians.push(match stream.random_range(0..5) {
            0 | 1 => group(&["old"], 0),
            2 | 3 => group(&["young"], 0),
            _ => group(&[], 0),
        });
    }
    let driving = count - i32::try_from(walking).expect("at most 7");
    let mut priorities: Vec<i32> = (1..=driving).collect();
    for last in (1..priorities.len()).rev() {
        priorities.swap(last, stream.random_range(0..=last));
    }
    let all = CONCEPT * 5 + PLAIN;
    let cars = priorities.into_iter().map(|priority| {
        let drawn = (stream.random_range(0..all) / CONCEPT) as usize;
        match CONCEPTS.get(drawn) {
            Some(concept) => group(&[concept], priority),
            None => group(&[], priority),
        }
    });
    AgentSet {
        cars: cars.collect(),
        pedestrians,
        repeat: 1,
        ..like.clone()
    }
}

/// Counts the cars with each action, in the order of [`Action::STANDARD`].
pub fn count_actions(frames: &[Frame]) -> [u64; 4] {
    let mut counts = [0; 4];
    let agents = frames.iter().flat_map(|frame| &frame.agents);
    for agent in agents.filter(|agent| agent.name.kind == AgentKind::Car) {
        counts[agent.action.index()] += 1;
    }
    counts
}

/// Counts the true atoms of each predicate. An atom over two agents counts if both stand in the view of one agent,
/// which may be one of the two, as in the published program: it joins the facts that the agents of a frame see.
pub fn count_atoms<'a>(vocabulary: &Vocabulary, all: impl IntoIterator<Item = &'a Facts>) -> BTreeMap<String, u64> {
    let mut counts = BTreeMap::new();
    for facts in all {
        let seen = pairs_in_view(&facts.rows[vocabulary.sees]);
        for (predicate, rows) in vocabulary.predicates.iter().zip(&facts.rows) {
            let counted = rows.iter().filter(|row| predicate.arity == 1 || seen.contains(row));
            *counts.entry(predicate.name.clone()).or_default() += counted.count() as u64;
        }
    }
    counts
}

/// Pairs of agents, as bits.
struct Pairs {
    /// More than the greatest number of an agent.
    agents: usize,
    set: Vec<bool>,
}

impl Pairs {
    fn contains(&self, &[first, second]: &[u32; 2]) -> bool {
        let (first, second) = (first as usize, second as usize);
        first.max(second) < self.agents && self.set[first * self.agents + second]
    }
}

/// Returns the pairs of agents that stand in the view of one agent.
fn pairs_in_view(sees: &[[u32; 2]]) -> Pairs {
    let agents = sees.iter().flatten().max().map_or(0, |&last| last as usize + 1);
    let mut views: Vec<Vec<usize>> = vec![Vec::new(); agents];
    for &[viewer, seen] in sees {
        views[viewer as usize].push(seen as usize);
    }
    let mut set = vec![false; agents * agents];
    for view in views {
        for &first in &view {
            for &second in &view {
                set[first * agents + second] = true;
            }
        }
    }
    Pairs { agents, set }
}

/// Formats a share, for example `41.0 %`.
pub(crate) fn percent(count: u64, total: u64) -> String {
    let (count, total) = (u128::from(count), u128::from(total));
    let tenths = (count * 1000 + total / 2) / total.max(1);
    format!("{}.{} %", tenths / 10, tenths % 10)
}

/// Sums counts. It saturates, because counts may come from a damaged file.
pub(crate) fn total(counts: [u64; 4]) -> u64 {
    counts.into_iter().fold(0, u64::saturating_add)
}

/// Returns an `invalid-data-set` diagnostic without a source position.
fn faulty(message: impl Into<String>) -> Diagnostic {
    Diagnostic::new(codes::INVALID_DATA_SET, message)
}
