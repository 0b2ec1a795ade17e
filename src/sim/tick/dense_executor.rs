//! The dense executor: decides for all agents in one window, or in one window per tile.

use crate::city::Action;
use crate::city::{Agent, Cell, CityMap};
use crate::datalog::dense::{Set, TooManySteps, TrackFirings, has, members};
use crate::datalog::{ClauseId, PredicateId, Value};
use crate::diag::Diagnostic;
use crate::diag::codes;
use crate::sim::tick::agent_state::{AgentState, Position};
use crate::sim::tick::executor::not_dense;
use crate::sim::tick::ground::MAX_ENTITIES;
use crate::sim::tick::hidden::Now;
use crate::sim::tick::memory::Watched;
use crate::sim::tick::vocabulary::{Actions, Vocabulary};
use crate::sim::tick::width::{Width, in_words};
use crate::sim::tick::window::{Grounder, Near, Plan, Window};
use crate::sim::tick::world::World;
use rayon::prelude::*;
use std::ops::Range;
use std::sync::atomic::{AtomicU16, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};

/// The maximum number of entities in one window.
pub const WINDOW_MAX: usize = Width::SixtyFour.entities();
/// A city with more agents is cut into tiles, if its rules are local, and may use several threads.
pub const WHOLE_MAX: usize = Width::Four.entities();

/// The approximate number of entities in the window of a tile.
const TILE_ENTITIES: f64 = 40.0;

/// The decisions of the agents in a tick, before the default.
#[derive(Debug, Default)]
pub(super) struct Decisions {
    /// The bits of the [`Actions`] of each agent.
    derived: Vec<AtomicU16>,
    /// The number of rows that each counted clause derived; empty if clauses are not counted.
    pub firings: Vec<usize>,
    /// `words` words per agent: bit `i` is set if the counted clause `i` derived an action for it.
    fired: Vec<AtomicU64>,
    words: usize,
    /// The rows that temporal operators of later ticks read.
    pub watched: Watched,
}

impl Decisions {
    /// Creates empty decisions for this number of agents and counted clauses.
    pub fn new(agents: usize, clauses: usize, watched: Watched) -> Self {
        let words = clauses.div_ceil(64);
        Decisions {
            derived: (0..agents).map(|_| AtomicU16::new(0)).collect(),
            firings: vec![0; clauses],
            fired: (0..agents * words).map(|_| AtomicU64::new(0)).collect(),
            words,
            watched,
        }
    }

    /// Returns the number of agents.
    pub fn len(&self) -> usize {
        self.derived.len()
    }

    pub fn clear(&mut self) {
        self.derived.iter_mut().for_each(|bits| *bits.get_mut() = 0);
        self.firings.fill(0);
        self.fired.iter_mut().for_each(|bits| *bits.get_mut() = 0);
        self.watched.clear();
    }

    #[inline]
    pub fn derived(&self, agent: usize) -> Actions {
        Actions::from_bits(self.derived[agent].load(Ordering::Relaxed))
    }

    pub fn add(&self, agent: usize, action: Action) {
        // Only one window decides for an agent, so no other thread writes here.
        let bits = &self.derived[agent];
        bits.store(
            bits.load(Ordering::Relaxed) | [action].into_iter().collect::<Actions>().bits(),
            Ordering::Relaxed,
        );
    }

    pub fn add_fired(&self, agent: usize, clause: usize) {
        let word = &self.fired[agent * self.words + clause / 64];
        word.store(word.load(Ordering::Relaxed) | 1 << (clause % 64), Ordering::Relaxed);
    }

    /// Counts the rows that a counted clause derived. Those of an action are about agents; a constant may name none.
    pub fn count(
        &mut self,
        clause: usize,
        of_action: bool,
        rows: &[Vec<Value>],
        agent: impl Fn(Value) -> Option<usize>,
    ) {
        self.firings[clause] = match of_action {
            false => rows.len(),
            true => {
                let agents = rows.iter().filter_map(|row| agent(row[0]));
                agents.inspect(|&agent| self.add_fired(agent, clause)).count()
            }
        };
    }

    /// Returns the counted clauses that derived an action for the agent.
    pub fn fired(&self, agent: usize) -> impl Iterator<Item = usize> {
        let words = self.fired[agent * self.words..(agent + 1) * self.words]
            .iter()
            .enumerate();
        words.flat_map(|(at, word)| {
            let word = word.load(Ordering::Relaxed);
            (0..64)
                .filter(move |bit| word >> bit & 1 != 0)
                .map(move |bit| at * 64 + bit)
        })
    }
}

/// The results to read from an evaluated window.
#[derive(Clone, Debug)]
struct Reading {
    grounder: Grounder,
    actions: Vec<(Action, PredicateId)>,
    /// The counted clauses, each with whether its head is an action; `None` for those that are handed over.
    clauses: Vec<Option<(ClauseId, bool)>>,
    /// The predicates that temporal operators are about, with their numbers of columns.
    watched: Vec<(PredicateId, usize)>,
}

impl Reading {
    /// Variant of `read` for a window that contains the whole city.
    fn read_all<const W: usize>(&self, window: &Window<W>, out: &mut Decisions) {
        let (mut firings, mut watched) = (std::mem::take(&mut out.firings), std::mem::take(&mut out.watched));
        let all = crate::datalog::dense::first(window.bodies.len());
        self.read(window, &all, out, &mut firings);
        self.watch_all(window, &mut watched);
        (out.firings, out.watched) = (firings, watched);
    }

    /// Sets the rows of the watched predicates in a window that contains the whole city.
    fn watch_all<const W: usize>(&self, window: &Window<W>, watched: &mut Watched) {
        let dense = &self.grounder.rules.dense;
        for (position, &(predicate, arity)) in self.watched.iter().enumerate() {
            if arity < 2 {
                if let Some(set) = window.bit_state.set(dense, predicate) {
                    watched.set(position, set);
                }
                continue;
            }
            for ego in 0..window.bodies.len() {
                if let Some(row) = window.bit_state.row(dense, predicate, ego) {
                    watched.add_row(position, ego, row);
                }
            }
        }
    }

    /// Adds the rows of the watched predicates whose first column is one of `egos`, each with the position of its
    /// predicate.
    fn watch<const W: usize>(&self, window: &Window<W>, egos: &Set<W>, rows: &mut Vec<(usize, [u32; 2])>) {
        let dense = &self.grounder.rules.dense;
        let agent = |entity: usize| window.bodies[entity].agent;
        for (position, &(predicate, arity)) in self.watched.iter().enumerate() {
            if arity < 2 {
                let set = window.bit_state.set(dense, predicate);
                rows.extend(
                    set.into_iter()
                        .flat_map(members)
                        .map(|entity| (position, [agent(entity), 0])),
                );
                continue;
            }
            for ego in members(egos) {
                let row = window.bit_state.row(dense, predicate, ego);
                let row = row.into_iter().flat_map(members);
                rows.extend(row.map(|other| (position, [agent(ego), agent(other)])));
            }
        }
    }

    /// Adds the decisions of a window for its `egos` to `out`, and the firings of its clauses to `firings`.
    fn read<const W: usize>(&self, window: &Window<W>, egos: &Set<W>, out: &Decisions, firings: &mut [usize]) {
        let dense = &self.grounder.rules.dense;
        for &(action, predicate) in &self.actions {
            if let Some(set) = window.bit_state.set(dense, predicate) {
                debug_assert!(members(set).all(|entity| has(egos, entity)));
                for entity in members(set) {
                    out.add(window.bodies[entity].agent as usize, action);
                }
            }
        }
        for (position, (firings, clause)) in firings.iter_mut().zip(&self.clauses).enumerate() {
            let Some((clause, of_action)) = *clause else { continue };
            *firings += window.bit_state.count_fired(dense, clause).unwrap_or(0);
            if of_action && let Some(set) = window.bit_state.fired(dense, clause) {
                for entity in members(set) {
                    out.add_fired(window.bodies[entity].agent as usize, position);
                }
            }
        }
    }
}

/// The reason why the dense executor did not decide.
#[derive(Debug)]
pub(super) enum Undecided {
    /// Another executor can decide.
    TooManySteps(TooManySteps),
    /// More than [`WINDOW_MAX`] agents are around one cell.
    Crowded(Diagnostic),
}

impl From<TooManySteps> for Undecided {
    fn from(error: TooManySteps) -> Self {
        Undecided::TooManySteps(error)
    }
}

/// Evaluates the rules of one city as bits.
pub(super) struct DenseExecutor {
    reading: Reading,
    shape: Shape,
}

enum Shape {
    Few(Few),
    One(Box<dyn OneWindow>),
    Tiles(Box<Tiles>),
}

/// A city of at most [`Near::MAX`] agents.
#[derive(Default)]
struct Few {
    /// The inputs that do not depend on cells.
    steady: Vec<Set<1>>,
    /// The working memory, made on demand. It has no state between ticks.
    window: Option<Box<Window<1>>>,
}

impl Few {
    /// Returns the window with these agents.
    fn load(&mut self, grounder: &Grounder, map: &CityMap, agents: &[Agent]) -> &mut Window<1> {
        let window = (self.window).get_or_insert_with(|| Box::new(Window::new(grounder)));
        window.load_few(grounder, map, agents, &self.steady);
        window
    }
}

impl DenseExecutor {
    /// Creates an executor that counts the firings of `clauses`. It hands a part of the rules over only if `divides`.
    ///
    /// # Errors
    /// `dense-unsupported` if it cannot evaluate the rules for this number of agents; the message names the reason.
    pub fn new(
        world: &World,
        agents: &[Agent],
        clauses: &[ClauseId],
        (threads, divides): (usize, bool),
    ) -> Result<DenseExecutor, Diagnostic> {
        let rules = world.program.rules();
        let counting = match clauses {
            [] => TrackFirings::Off,
            _ => TrackFirings::Each,
        };
        let plan = world.plan(counting)?;
        if plan.rules.handed.is_some() && (!divides || agents.len() > MAX_ENTITIES) {
            let all = world.compile(counting).map(|_| ());
            return Err(all.expect_err("a part of the rules is handed over"));
        }
        let dense = &plan.rules.dense;
        let sees = world.vocabulary.predicates[world.vocabulary.sees].id;
        let in_tiles = dense.is_local() && sees.is_some_and(|sees| dense.is_guarded_by(sees));
        let width = Width::of(agents.len());
        if width.is_none() && !in_tiles {
            return Err(not_dense(&format!(
                "they read facts beyond the field of view, and there are more than {WINDOW_MAX} agents"
            )));
        }

        let vocabulary: &Vocabulary = &world.vocabulary;
        let action = |action: Action| Some((action, vocabulary.action(action)?));
        let actions: Vec<(Action, PredicateId)> = vocabulary.actions().all().filter_map(action).collect();
        let of_action = |clause: &ClauseId| {
            let head = rules.clauses[clause.index()].head.predicate;
            actions.iter().any(|(_, action)| *action == head)
        };
        let handed = plan.rules.handed.iter().flat_map(|handed| &handed.clauses);
        let handed: Vec<ClauseId> = handed.map(|(clause, _)| *clause).collect();
        let counted = |clause: &ClauseId| {
            let own = handed.binary_search(clause).is_err();
            own.then(|| (*clause, of_action(clause)))
        };
        let mut reading = Reading {
            grounder: Grounder::new(plan),
            clauses: clauses.iter().map(counted).collect(),
            actions,
            watched: world.watched(0).predicates().to_vec(),
        };
        if agents.len() <= Near::MAX {
            let mut few = Few::default();
            reading.grounder.steady_inputs(agents, &mut few.steady);
            let shape = Shape::Few(few);
            return Ok(DenseExecutor { reading, shape });
        }
        let mut bodies = Vec::new();
        list_bodies(&mut bodies, &mut reading.grounder, world.map(), agents);
        let shape = match width {
            Some(width) if agents.len() <= WHOLE_MAX || !in_tiles => {
                Shape::One(in_words!(width, W => Box::new(One::<W>::new(&reading.grounder, world.map(), bodies))))
            }
            _ => Shape::Tiles(Box::new(Tiles::new(&reading.grounder, world.map(), bodies, threads))),
        };
        Ok(DenseExecutor { reading, shape })
    }

    /// Returns the plan.
    pub fn plan(&self) -> &Arc<Plan> {
        self.reading.grounder.plan()
    }

    /// Replaces the agents by the same number of others.
    pub fn restart(&mut self, map: &CityMap, agents: &[Agent]) {
        let grounder = &mut self.reading.grounder;
        match &mut self.shape {
            Shape::Few(few) => grounder.steady_inputs(agents, &mut few.steady),
            Shape::One(one) => one.restart(grounder, map, agents),
            Shape::Tiles(tiles) => list_bodies(&mut tiles.bodies, grounder, map, agents),
        }
    }

    /// Decides for all agents. Clears `out` first, and leaves it empty on error.
    ///
    /// # Errors
    /// See [`Undecided`].
    pub fn decide(&mut self, map: &CityMap, now: Now<'_>, out: &mut Decisions) -> Result<(), Undecided> {
        out.clear();
        let decided = match &mut self.shape {
            Shape::Few(few) => {
                let window = few.load(&self.reading.grounder, map, now.agents);
                match window.run_few(&self.reading.grounder, now) {
                    Ok(()) => {
                        self.reading.read_all(window, out);
                        Ok(())
                    }
                    Err(error) => Err(Undecided::from(error)),
                }
            }
            Shape::One(one) => one.decide(&self.reading, now, out).map_err(Undecided::from),
            Shape::Tiles(tiles) => tiles.decide(&self.reading, map, now, out),
        };
        if decided.is_err() {
            out.clear();
        }
        decided
    }

    /// Computes all facts that the rules may read and returns their number. `None` for a city in tiles.
    pub fn count_facts(&mut self, map: &CityMap, now: Now<'_>) -> Option<u64> {
        let grounder = &self.reading.grounder;
        match &mut self.shape {
            Shape::Few(few) => Some(few.load(grounder, map, now.agents).count_few(grounder, now)),
            Shape::One(one) => Some(one.count_facts(grounder, now)),
            Shape::Tiles(_) => None,
        }
    }

    /// Exchanges the working memory of small cities, if the other one has the same rules.
    pub fn swap_memory(&mut self, other: &mut DenseExecutor) {
        if let (Shape::Few(few), Shape::Few(others)) = (&mut self.shape, &mut other.shape)
            && self.reading.grounder.has_plan_of(&other.reading.grounder)
        {
            std::mem::swap(&mut few.window, &mut others.window);
        }
    }

    /// Returns whether [`follow`](DenseExecutor::follow) takes positions, since the city is large.
    pub fn takes_positions(&self) -> bool {
        !matches!(self.shape, Shape::Few(_))
    }

    /// Updates the positions of the agents in a large city.
    pub fn follow(&mut self, map: &CityMap, positions: &[Position]) {
        match &mut self.shape {
            Shape::Few(_) => {}
            Shape::One(one) => one.follow(&self.reading.grounder, map, positions),
            Shape::Tiles(tiles) => tiles.follow(map, positions),
        }
    }
}

/// Fills `bodies` with the visible state of the agents.
fn list_bodies(bodies: &mut Vec<AgentState>, grounder: &mut Grounder, map: &CityMap, agents: &[Agent]) {
    let body = |(position, agent): (usize, &Agent)| AgentState {
        class: grounder.class_of(agent.kind, &agent.concepts),
        ..AgentState::new(map, position, agent)
    };
    bodies.clear();
    bodies.extend(agents.iter().enumerate().map(body));
}

/// A whole city in one window.
trait OneWindow: Send + Sync {
    fn restart(&mut self, grounder: &mut Grounder, map: &CityMap, agents: &[Agent]);
    fn decide(&mut self, reading: &Reading, now: Now<'_>, out: &mut Decisions) -> Result<(), TooManySteps>;
    fn follow(&mut self, grounder: &Grounder, map: &CityMap, positions: &[Position]);
    fn count_facts(&mut self, grounder: &Grounder, now: Now<'_>) -> u64;
}

struct One<const W: usize> {
    window: Window<W>,
}

impl<const W: usize> One<W> {
    fn new(grounder: &Grounder, map: &CityMap, bodies: Vec<AgentState>) -> Self {
        let mut one = One {
            window: Window::new(grounder),
        };
        one.window.bodies = bodies;
        one.fill(grounder, map);
        one
    }

    fn fill(&mut self, grounder: &Grounder, map: &CityMap) {
        (self.window).fill(grounder, Cell::new(0, 0), [map.rows(), map.cols()]);
    }
}

impl<const W: usize> OneWindow for One<W> {
    fn restart(&mut self, grounder: &mut Grounder, map: &CityMap, agents: &[Agent]) {
        list_bodies(&mut self.window.bodies, grounder, map, agents);
        self.fill(grounder, map);
    }

    fn decide(&mut self, reading: &Reading, now: Now<'_>, out: &mut Decisions) -> Result<(), TooManySteps> {
        self.window.run(&reading.grounder, now, true)?;
        reading.read_all(&self.window, out);
        Ok(())
    }

    fn follow(&mut self, grounder: &Grounder, map: &CityMap, positions: &[Position]) {
        for (entity, position) in positions.iter().enumerate() {
            self.window.shift(grounder, map, entity, *position);
        }
    }

    fn count_facts(&mut self, grounder: &Grounder, now: Now<'_>) -> u64 {
        self.window.count_facts(grounder, now)
    }
}

/// A city in tiles. Each tile decides for its agents in a window that contains all that they can see.
struct Tiles {
    /// Sorted by bin, row by row. Moves between ticks may leave a body outside its bin, but near it: sorting again
    /// accesses memory almost sequentially.
    bodies: Vec<AgentState>,
    /// The buffer that sorting writes to.
    sorted: Vec<AgentState>,
    /// The start of each bin in `bodies`, then the end of the last one.
    bins: Vec<u32>,
    /// The number of bins along each axis.
    size: [i32; 2],
    /// The side of a tile in cells. Tiles consist of whole bins, even after splitting.
    side: i32,
    view: i32,
    workers: Vec<Mutex<Worker>>,
}

/// The side of a bin in cells.
const BIN: i32 = 32;

/// The buffers of a thread.
struct Worker {
    narrow: Window<1>,
    pair: Window<2>,
    wide: Window<4>,
    wider: Window<16>,
    widest: Window<64>,
    found: Vec<AgentState>,
    tally: Tally,
}

/// What a thread adds to the decisions at the end of a tick.
#[derive(Default)]
struct Tally {
    firings: Vec<usize>,
    watched: Vec<(usize, [u32; 2])>,
}

/// A rectangle of cells.
#[derive(Clone, Copy, Debug)]
struct Area {
    first: Cell,
    rows: i32,
    cols: i32,
}

impl Area {
    fn contains(&self, cell: Cell) -> bool {
        let (row, col) = (cell.row - self.first.row, cell.col - self.first.col);
        (0..self.rows).contains(&row) && (0..self.cols).contains(&col)
    }
}

/// A rectangle of bins.
struct Bins {
    rows: Range<i32>,
    cols: Range<i32>,
}

impl Tiles {
    fn new(grounder: &Grounder, map: &CityMap, bodies: Vec<AgentState>, threads: usize) -> Self {
        let view = grounder.farthest_view();
        let area = f64::from(map.rows()) * f64::from(map.cols());
        #[allow(clippy::cast_precision_loss)]
        let wanted = (TILE_ENTITIES * area / bodies.len() as f64).sqrt() - 2.0 * f64::from(view);
        #[allow(clippy::cast_possible_truncation)] // it is at most the side of the map
        let side = wanted.min(f64::from(map.rows().max(map.cols()))).max(f64::from(BIN)) as i32;
        let size = [map.rows(), map.cols()].map(|cells| (cells + BIN - 1) / BIN);
        let worker = || {
            Mutex::new(Worker {
                narrow: Window::new(grounder),
                pair: Window::new(grounder),
                wide: Window::new(grounder),
                wider: Window::new(grounder),
                widest: Window::new(grounder),
                found: Vec::new(),
                tally: Tally::default(),
            })
        };
        Tiles {
            sorted: bodies.clone(),
            bins: vec![0; (size[0] * size[1]) as usize + 1],
            bodies,
            size,
            side: (side + BIN - 1) / BIN * BIN,
            view,
            workers: (0..threads).map(|_| worker()).collect(),
        }
    }

    fn bin(&self, cell: Cell) -> usize {
        (cell.row / BIN * self.size[1] + cell.col / BIN) as usize
    }

    /// Sorts the bodies into bins.
    fn sort(&mut self) {
        let mut bins = std::mem::take(&mut self.bins);
        bins.fill(0);
        for body in &self.bodies {
            bins[self.bin(body.at)] += 1;
        }
        let mut end = 0;
        for bin in &mut bins {
            end += *bin;
            *bin = end;
        }
        for body in self.bodies.iter().rev() {
            let place = &mut bins[self.bin(body.at)];
            *place -= 1;
            self.sorted[*place as usize] = *body;
        }
        self.bins = bins;
        std::mem::swap(&mut self.bodies, &mut self.sorted);
    }

    /// Updates the positions of the agents.
    fn follow(&mut self, map: &CityMap, positions: &[Position]) {
        let follow = |body: &mut AgentState| body.shift(map, positions[body.agent as usize]);
        match self.workers.len() {
            1 => self.bodies.iter_mut().for_each(follow),
            _ => self.bodies.par_iter_mut().with_min_len(4096).for_each(follow),
        }
    }

    fn decide(&mut self, reading: &Reading, map: &CityMap, now: Now<'_>, out: &mut Decisions) -> Result<(), Undecided> {
        self.sort();
        for worker in &mut self.workers {
            let tally = &mut worker.get_mut().expect("no thread has panicked").tally;
            tally.firings.clear();
            tally.firings.resize(out.firings.len(), 0);
            tally.watched.clear();
        }
        let lines = |cells: i32| (cells + self.side - 1) / self.side;
        let fault_in_row = |row: i32| {
            // One worker may run on any thread. Several workers run in the simulation's own pool.
            let thread = match self.workers.len() {
                1 => 0,
                _ => rayon::current_thread_index().unwrap_or(0),
            };
            let mut worker = self.workers[thread].lock().expect("no thread has panicked");
            (0..lines(map.cols())).find_map(|col| {
                let tile = Area {
                    first: Cell::new(row * self.side, col * self.side),
                    rows: self.side,
                    cols: self.side,
                };
                self.decide_tile(tile, &mut worker, reading, map, now, out).err()
            })
        };
        // Reports the first error in tile order, so that the number of threads does not matter.
        let mut rows = 0..lines(map.rows());
        let fault = match self.workers.len() {
            1 => rows.find_map(fault_in_row),
            _ => rows.into_par_iter().find_map_first(fault_in_row),
        };
        if let Some(fault) = fault {
            return Err(fault);
        }
        for worker in &mut self.workers {
            let tally = &worker.get_mut().expect("no thread has panicked").tally;
            for (sum, fired) in out.firings.iter_mut().zip(&tally.firings) {
                *sum += fired;
            }
            tally
                .watched
                .iter()
                .for_each(|(position, row)| out.watched.add(*position, *row));
        }
        Ok(())
    }

    fn decide_tile(
        &self,
        tile: Area,
        worker: &mut Worker,
        reading: &Reading,
        map: &CityMap,
        now: Now<'_>,
        out: &Decisions,
    ) -> Result<(), Undecided> {
        let found = &mut worker.found;
        found.clear();
        let inner = self.bins_of(tile);
        for row in inner.rows.clone() {
            found.extend_from_slice(self.run(row, inner.cols.clone()));
        }
        if found.is_empty() {
            return Ok(());
        }
        let egos = found.len();
        let first = Cell::new((tile.first.row - self.view).max(0), (tile.first.col - self.view).max(0));
        let window = Area {
            first,
            rows: (tile.first.row + tile.rows + self.view).min(map.rows()) - first.row,
            cols: (tile.first.col + tile.cols + self.view).min(map.cols()) - first.col,
        };
        let outer = self.bins_of(window);
        for row in outer.rows {
            let hole = match inner.rows.contains(&row) {
                true => inner.cols.clone(),
                false => outer.cols.start..outer.cols.start,
            };
            for cols in [outer.cols.start..hole.start, hole.end..outer.cols.end] {
                found.extend(self.run(row, cols).iter().filter(|body| window.contains(body.at)));
            }
        }
        let evaluate = Evaluate {
            reading,
            now,
            out,
            window,
            egos,
        };
        match Width::of(found.len()) {
            Some(Width::One) => evaluate.run(&mut worker.narrow, found, &mut worker.tally)?,
            Some(Width::Two) => evaluate.run(&mut worker.pair, found, &mut worker.tally)?,
            Some(Width::Four) => evaluate.run(&mut worker.wide, found, &mut worker.tally)?,
            _ if tile.rows > BIN || tile.cols > BIN => {
                // Splits the tile where the city is crowded.
                let half = |cells: i32| (cells / 2 + BIN - 1) / BIN * BIN;
                let (row, col) = (half(tile.rows), half(tile.cols));
                for (row, rows) in [(0, row), (row, tile.rows - row)] {
                    for (col, cols) in [(0, col), (col, tile.cols - col)] {
                        let part = Area {
                            first: Cell::new(tile.first.row + row, tile.first.col + col),
                            rows,
                            cols,
                        };
                        if rows > 0 && cols > 0 {
                            self.decide_tile(part, worker, reading, map, now, out)?;
                        }
                    }
                }
            }
            Some(Width::Sixteen) => evaluate.run(&mut worker.wider, found, &mut worker.tally)?,
            Some(Width::SixtyFour) => evaluate.run(&mut worker.widest, found, &mut worker.tally)?,
            None => {
                let (many, Cell { row, col }) = (found.len(), tile.first);
                let message = format!("{many} agents around the cell [{row}, {col}], the limit is {WINDOW_MAX}");
                let fault = Diagnostic::new(codes::LIMIT_EXCEEDED, message);
                return Err(Undecided::Crowded(fault.help("use a larger map or fewer agents")));
            }
        }
        Ok(())
    }

    /// Returns the bins that overlap an area.
    fn bins_of(&self, area: Area) -> Bins {
        let along = |first: i32, cells: i32, bins: i32| {
            let end = ((first + cells + BIN - 1) / BIN).min(bins);
            (first / BIN).min(end)..end
        };
        Bins {
            rows: along(area.first.row, area.rows, self.size[0]),
            cols: along(area.first.col, area.cols, self.size[1]),
        }
    }

    /// Returns the bodies in adjacent bins of a row.
    fn run(&self, row: i32, cols: Range<i32>) -> &[AgentState] {
        let [start, end] = [cols.start, cols.end].map(|col| self.bins[(row * self.size[1] + col) as usize]);
        &self.bodies[start as usize..end as usize]
    }
}

/// Evaluates the window of a tile.
struct Evaluate<'a> {
    reading: &'a Reading,
    now: Now<'a>,
    out: &'a Decisions,
    window: Area,
    /// The number of entities to decide for; they come first.
    egos: usize,
}

impl Evaluate<'_> {
    fn run<const W: usize>(
        &self,
        window: &mut Window<W>,
        found: &mut Vec<AgentState>,
        tally: &mut Tally,
    ) -> Result<(), TooManySteps> {
        std::mem::swap(&mut window.bodies, found);
        let Area { first, rows, cols } = self.window;
        window.fill(&self.reading.grounder, first, [rows, cols]);
        let egos = crate::datalog::dense::first(self.egos);
        window.bit_state.set_egos(egos);
        let decided = window.run(&self.reading.grounder, self.now, false);
        if decided.is_ok() {
            self.reading.read(window, &egos, self.out, &mut tally.firings);
            self.reading.watch(window, &egos, &mut tally.watched);
        }
        std::mem::swap(&mut window.bodies, found);
        decided
    }
}
