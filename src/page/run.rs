//! The page of one run: its decisions in columns, and their explanations.

use crate::city::Action;
use crate::city::{Cell, CityMap, Heading, field_of_view};
use crate::datalog::explain::{Explainer, ExplanationPrinter};
use crate::diag::{self, Diagnostic, Sources};
use crate::page::file::{packed, write_parts};
use crate::page::header::{Header, Values};
use crate::page::scenery::Scenery;
use crate::render::Icons;
use crate::sim::codes;
use crate::sim::{
    LOOK_TICKS, Replay, STUCK_TICKS, TraceHeader, TraceState, TraceTick, WaitsFor, find_deadlocks, waits,
};
use serde::Serialize;
use std::fmt::Write as _;
use std::io::{self, Write};

/// The maximum number of decisions in a page; more make it slow to open.
pub const DECISIONS_MAX: usize = 400_000;

/// The maximum number of cells of a map in a page.
const CELLS_MAX: i64 = 1 << 24;

/// Upper bound of tick numbers: JavaScript represents smaller integers exactly.
const TICK_MAX: u64 = 1 << 53;

/// A part with explanations ends after this number of nodes or ticks, so that the browser stays responsive while it
/// unpacks the parts.
const PART_NODES: usize = 8_000;
const PART_TICKS: usize = 100;

/// A page under construction.
#[derive(Serialize)]
pub struct Page {
    #[serde(flatten)]
    pub(super) header: Header,
    #[serde(skip)]
    pub(super) scenery: Scenery,
    /// For each counted clause, the number of rows it derived in all ticks, and whether it derives an action.
    firings: Vec<(u64, bool)>,
    /// Number of the first tick.
    pub(super) first: u64,
    /// Number of ticks.
    pub(super) count: usize,
    #[serde(flatten)]
    columns: Columns,
    /// The cells of the agents after the last tick.
    last: Vec<[i32; 2]>,
    /// For each agent, its routes: the position of the tick where the route begins, and its corners.
    routes: Vec<Vec<(usize, Vec<[i32; 2]>)>>,
    deadlocks: Vec<Deadlock>,
    /// Number of deadlock searches that reached a limit.
    deadlock_searches_cut: u32,
    /// The steps of externally controlled agents, with the actions that the rules wanted.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    driven: Vec<Driven>,
    /// What the examples say about learned rules: the report of `logicity induce`.
    #[serde(skip_serializing_if = "Option::is_none")]
    learned: Option<serde_json::Value>,
    #[serde(skip)]
    most: usize,
    /// For each agent, the tick after its last move.
    #[serde(skip)]
    still_since: Vec<u64>,
    /// The state of the last tick before its decisions; empty before the first tick.
    #[serde(skip)]
    places: Vec<Place>,
    /// For each tick, the cell and the action of each agent.
    #[serde(skip)]
    taken: Vec<Vec<([i32; 2], Action)>>,
    /// The rows of each predicate in the last tick, as numbers in ascending order.
    #[serde(skip)]
    rows: Vec<Vec<u64>>,
    /// The explanations in the last tick, for each agent and action.
    #[serde(skip)]
    why: Vec<Vec<i64>>,
    /// Packed explanations and facts.
    #[serde(skip)]
    parts: Vec<String>,
    /// Those that are not packed yet, without their nodes.
    #[serde(skip)]
    unpacked: Unpacked,
}

/// Cell and goal of an agent before a tick.
type Place = ([i32; 2], [i32; 2]);

/// The states of all agents before the decisions, and the decisions. The fields without a remark have an entry per
/// agent.
#[derive(Default, Serialize)]
struct Columns {
    /// Row and column in the first tick, then their changes from tick to tick.
    at: Vec<Vec<i32>>,
    /// A digit per tick: the position in `headings`, or 4 before the first move.
    heading: Vec<String>,
    /// A hexadecimal digit per tick: the position in `actions`.
    action: Vec<String>,
    /// The actions derived before the default, as a bit set: a hexadecimal digit per tick for every four actions.
    derived: Vec<String>,
    #[serde(skip)]
    derived_digits: usize,
    /// Position of a tick, row and column, where the goal changes.
    goal: Vec<Vec<(usize, i32, i32)>>,
    /// A position in `views` per tick.
    view: Vec<Vec<usize>>,
    /// First and last cell of a field of view, relative to the agent; not per agent.
    views: Vec<[i32; 4]>,
    /// A position in `fired_sets` per tick.
    fired: Vec<Vec<usize>>,
    /// Sets of clauses that fired together for an agent; not per agent.
    fired_sets: Vec<Vec<usize>>,
}

/// Explanations and facts of some consecutive ticks.
#[derive(Default, Serialize)]
struct Unpacked {
    /// For each tick, agent and action, the number of the node that explains why it was or was not derived (-1 if no
    /// rule has the action), as a difference from the tick before.
    why: Vec<Vec<i64>>,
    /// For each tick, predicates with the rows that appear or disappear: first the predicate, then the rows in
    /// ascending order, each as a difference from the row before. A row (x, y) is x times the number of agents plus y.
    facts: Vec<Vec<Vec<u64>>>,
    /// For each tick, the values of the quantities, if the configuration declares some.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    values: Vec<Vec<Values>>,
}

/// A part with explanations, as JSON.
#[derive(Serialize)]
struct ProofPart<'a> {
    nodes: &'a [serde_json::Value],
    #[serde(flatten)]
    rest: &'a Unpacked,
}

/// A cycle of agents that wait for each other.
#[derive(Serialize)]
struct Deadlock {
    /// Each agent waits for the next, the last one for the first.
    agents: Vec<usize>,
    /// The clause that makes each agent wait; `None` if it is not in the rule files.
    clauses: Vec<Option<usize>>,
    /// The tick in which the last of them stopped.
    since: u64,
    /// The last tick in which a search found the deadlock.
    until: u64,
}

/// An externally controlled agent in a tick.
#[derive(Serialize)]
struct Driven {
    /// Position of the tick in the page; `agent` is the position of the agent.
    tick: usize,
    agent: usize,
    /// The agents that it observed, itself first.
    observes: Vec<usize>,
    /// Position in `actions` of the action that the rules wanted.
    wanted: usize,
    /// The clauses that its action violated.
    broken: Vec<usize>,
}

impl Page {
    /// Returns a page without ticks for a trace with this header.
    ///
    /// # Errors
    /// `limit-exceeded`, without a place, for a map of more than 2^24 cells.
    pub fn new(replay: &Replay, header: &TraceHeader, icons: &Icons, sources: &Sources) -> Result<Page, Diagnostic> {
        let world = replay.world();
        let cells = i64::from(world.map().rows()) * i64::from(world.map().cols());
        if cells > CELLS_MAX {
            let message = format!("a page of a map of {cells} cells would be slow to open; the limit is {CELLS_MAX}");
            return Err(Diagnostic::new(diag::codes::LIMIT_EXCEEDED, message).help("run the rules on a smaller map"));
        }
        let count = header.agents.len();
        Ok(Page {
            scenery: Scenery::new(icons, &header.agents, replay),
            header: Header::new(replay, header, sources),
            firings: world
                .clause_actions()
                .map(|(_, action)| (0, action.is_some()))
                .collect(),
            first: 0,
            count: 0,
            columns: Columns::new(count, world.vocabulary.actions().all().len().div_ceil(4)),
            last: Vec::new(),
            routes: vec![Vec::new(); count],
            deadlocks: Vec::new(),
            deadlock_searches_cut: 0,
            driven: Vec::new(),
            learned: None,
            most: DECISIONS_MAX,
            still_since: vec![0; count],
            places: Vec::new(),
            taken: Vec::new(),
            rows: vec![Vec::new(); world.vocabulary.predicates.len()],
            why: vec![vec![0; world.vocabulary.actions().all().len()]; count],
            parts: Vec::new(),
            unpacked: Unpacked::default(),
        })
    }

    /// Sets a limit other than [`DECISIONS_MAX`].
    pub fn set_limit(&mut self, decisions: usize) {
        self.most = decisions;
    }

    /// Adds the report about learned rules: the page shows the support of the clauses with its labels.
    pub fn set_report(&mut self, report: serde_json::Value) {
        self.learned = Some(report);
    }

    /// Adds a tick, which the caller has loaded into `replay`. Ticks must be consecutive.
    ///
    /// # Errors
    /// `invalid-trace`, without a place, for an inconsistent tick; `limit-exceeded` for more decisions than the limit,
    /// or an explanation that takes too many steps.
    pub fn push(&mut self, replay: &Replay, tick: &TraceTick, sources: &Sources) -> Result<(), Diagnostic> {
        if (self.count + 1) * self.header.agents.len() > self.most {
            let message = format!("a page of more than {} decisions would be slow to open", self.most);
            return Err(
                Diagnostic::new(diag::codes::LIMIT_EXCEEDED, message).help("choose ticks with `--from` and `--ticks`")
            );
        }
        let expected = match self.count {
            0 => tick.tick,
            shown => self.first + shown as u64,
        };
        if tick.tick != expected || tick.tick >= TICK_MAX {
            let message = match tick.tick >= TICK_MAX {
                true => format!("tick number {} is too large", tick.tick),
                false => format!("found tick {} instead of tick {expected}", tick.tick),
            };
            return Err(Diagnostic::new(codes::INVALID_TRACE, message));
        }
        if self.count == 0 {
            self.first = tick.tick;
            self.still_since.fill(tick.tick);
        }
        self.follow_routes(replay, tick);
        self.explain(replay, sources)?;
        self.note_facts(replay);
        let (world, view) = (replay.world(), replay.world().scenario.view);
        let actions = world.vocabulary.actions();
        let mut taken = Vec::with_capacity(tick.agents.len());
        for (position, agent) in tick.agents.iter().enumerate() {
            self.check_clauses(&agent.clauses)?;
            if let Some(driven) = &agent.driven {
                self.check_clauses(&driven.broken)?;
                self.driven.push(Driven {
                    tick: self.count,
                    agent: position,
                    observes: positions(replay, &driven.observes)?,
                    wanted: driven.wanted(actions)?.index(),
                    broken: driven.broken.clone(),
                });
            }
            let heading = agent.heading()?;
            let action = agent.action(actions)?;
            let view = relative_view(agent.at, heading, view, world.map());
            let derived = replay.derived(position).bits();
            self.columns
                .push(position, self.places.get(position), agent, self.count);
            self.columns
                .note(position, (heading, action, derived), view, &agent.clauses);
            taken.push((agent.at, action));
            if agent.next != agent.at {
                self.still_since[position] = tick.tick + 1;
            }
        }
        for (clause, (count, is_action)) in world.clauses().zip(&mut self.firings) {
            // The trace records every firing of clauses that derive actions.
            if !*is_action {
                *count += replay.session().fired(clause).len() as u64;
            }
        }
        for &clause in tick.agents.iter().flat_map(|agent| &agent.clauses) {
            self.firings[clause].0 += 1;
        }
        self.places = tick.agents.iter().map(|agent| (agent.at, agent.goal)).collect();
        self.taken.push(taken);
        self.count += 1;
        self.last = tick.agents.iter().map(|agent| agent.next).collect();
        if (tick.tick + 1).is_multiple_of(LOOK_TICKS) {
            self.look_for_deadlocks(replay, tick.tick);
        }
        if self.header.proofs.nodes.len() >= PART_NODES || self.unpacked.why.len() >= PART_TICKS {
            let part = self.part().expect("writing to a vector cannot fail");
            self.parts.push(part);
            self.unpacked = Unpacked::default();
            self.header.proofs.forget();
        }
        Ok(())
    }

    /// Writes the page.
    ///
    /// # Errors
    /// Errors of `out`.
    pub fn write(&self, out: &mut impl Write) -> io::Result<()> {
        let mut parts = vec![("scenery", 0, packed(&self.scenery)?), ("run", 0, packed(self)?)];
        parts.extend(self.proof_parts()?.into_iter().map(|part| ("proofs", 0, part)));
        write_parts(&self.header.title, &parts, out)
    }

    /// Returns the packed explanations and facts.
    pub(super) fn proof_parts(&self) -> io::Result<Vec<String>> {
        let mut parts = self.parts.clone();
        if !self.unpacked.why.is_empty() {
            parts.push(self.part()?);
        }
        Ok(parts)
    }

    /// Packs the explanations and facts that are not packed yet.
    fn part(&self) -> io::Result<String> {
        packed(&ProofPart {
            nodes: &self.header.proofs.nodes,
            rest: &self.unpacked,
        })
    }

    /// Returns the cell of an agent before a tick, given the position of the tick.
    pub(super) fn at(&self, tick: usize, agent: usize) -> [i32; 2] {
        self.taken[tick][agent].0
    }

    /// Returns the action of an agent in a tick, given the position of the tick.
    pub(super) fn action(&self, tick: usize, agent: usize) -> Action {
        self.taken[tick][agent].1
    }

    /// Returns the name of the action of an agent in a tick, given the position of the tick.
    pub(super) fn action_name(&self, tick: usize, agent: usize) -> &str {
        &self.header.actions[self.action(tick, agent).index()]
    }

    fn check_clauses(&self, clauses: &[usize]) -> Result<(), Diagnostic> {
        let Some(clause) = clauses.iter().find(|clause| **clause >= self.header.counted) else {
            return Ok(());
        };
        let message = format!("no clause {clause}: the rules have {}", self.header.counted);
        Err(Diagnostic::new(codes::INVALID_TRACE, message))
    }

    /// Explains for each agent why it did or did not take each action.
    fn explain(&mut self, replay: &Replay, sources: &Sources) -> Result<(), Diagnostic> {
        let session = replay.session();
        let printer = ExplanationPrinter::new(session.program().rules(), session.symbols(), sources);
        let mut explainer = Explainer::new(session);
        let mut changes = Vec::with_capacity(self.why.iter().map(Vec::len).sum());
        for position in 0..self.header.agents.len() {
            let nodes = (self.header).explain(replay, (&mut explainer, &printer), position)?;
            changes.extend(
                nodes
                    .iter()
                    .zip(&self.why[position])
                    .map(|(node, before)| node - before),
            );
            self.why[position] = nodes;
        }
        self.unpacked.why.push(changes);
        Ok(())
    }

    /// Adds the rows of predicates that appear or disappear in a tick.
    fn note_facts(&mut self, replay: &Replay) {
        let mut changes = Vec::new();
        for (index, (now, old)) in self.header.rows(replay).zip(&mut self.rows).enumerate() {
            let (mut list, mut before) = (vec![index as u64], 0);
            for row in one_sided(old, &now) {
                list.push(row - before);
                before = row;
            }
            if list.len() > 1 {
                changes.push(list);
            }
            *old = now;
        }
        self.unpacked.facts.push(changes);
        let values = self.header.values(replay);
        if !values.is_empty() {
            self.unpacked.values.push(values);
        }
    }

    /// Plans the routes of agents with a new goal. A trace records only goals, but start and goal determine a route. An
    /// agent that reaches its goal starts the next route in the same tick; the next tick is the first to show the new
    /// goal. The trace has the routes that actions changed.
    fn follow_routes(&mut self, replay: &Replay, tick: &TraceTick) {
        let router = &replay.world().router;
        for (position, agent) in tick.agents.iter().enumerate() {
            let now = self.count;
            let routes = &mut self.routes[position];
            let planned = match self.places.get(position).copied() {
                Some((_, goal)) if goal == agent.goal => None,
                Some((at, goal)) if at == goal => {
                    let is_known = routes.last().is_some_and(|(since, _)| since + 1 == now);
                    (!is_known).then_some((now - 1, at))
                }
                _ => agent.route.is_none().then_some((now, agent.at)),
            };
            if let Some((since, start)) = planned {
                let route = router.plan(replay.kinds()[position], cell(start), cell(agent.goal));
                routes.push((since, route.map_or_else(|_| Vec::new(), |route| route.corners())));
            }
            routes.extend(agent.route.iter().map(|corners| (now, corners.clone())));
        }
    }

    fn look_for_deadlocks(&mut self, replay: &Replay, now: u64) {
        let stuck: Vec<usize> = (0..self.header.agents.len())
            .filter(|&agent| now + 1 - self.still_since[agent] >= STUCK_TICKS)
            .collect();
        if stuck.is_empty() {
            return;
        }
        let Ok(waits) = waits(&replay.snapshot(), &stuck) else {
            self.deadlock_searches_cut += 1;
            return;
        };
        let found = find_deadlocks(&stuck, &waits);
        for cycle in found.deadlocks {
            let agents: Vec<usize> = cycle.iter().map(|wait| wait.agent).collect();
            let same = |known: &&mut Deadlock| known.agents == agents && known.until + LOOK_TICKS >= now;
            if let Some(known) = self.deadlocks.iter_mut().find(same) {
                known.until = now;
                continue;
            }
            let position = |wait: &WaitsFor| replay.world().clauses().position(|clause| clause == wait.clause);
            self.deadlocks.push(Deadlock {
                clauses: cycle.iter().map(position).collect(),
                since: agents.iter().map(|&agent| self.still_since[agent]).max().unwrap_or(now),
                until: now,
                agents,
            });
        }
    }
}

/// Returns the positions of the agents with these names.
fn positions(replay: &Replay, names: &[String]) -> Result<Vec<usize>, Diagnostic> {
    let position = |name: &String| {
        let unknown = || Diagnostic::new(codes::INVALID_TRACE, format!("no agent `{name}`"));
        replay.position(name).ok_or_else(unknown)
    };
    names.iter().map(position).collect()
}

impl Columns {
    fn new(agents: usize, derived_digits: usize) -> Columns {
        Columns {
            derived_digits,
            at: vec![Vec::new(); agents],
            heading: vec![String::new(); agents],
            action: vec![String::new(); agents],
            derived: vec![String::new(); agents],
            goal: vec![Vec::new(); agents],
            view: vec![Vec::new(); agents],
            fired: vec![Vec::new(); agents],
            ..Columns::default()
        }
    }

    /// Adds cell and goal of an agent; `before` are those of the tick before.
    fn push(&mut self, agent: usize, before: Option<&Place>, now: &TraceState, tick: usize) {
        let (at, goal) = before.map_or(([0; 2], None), |&(at, goal)| (at, Some(goal)));
        self.at[agent].extend([now.at[0] - at[0], now.at[1] - at[1]]);
        if goal != Some(now.goal) {
            self.goal[agent].push((tick, now.goal[0], now.goal[1]));
        }
    }

    /// Adds the decision of an agent.
    fn note(
        &mut self,
        agent: usize,
        (heading, action, derived): (Option<Heading>, Action, u16),
        view: [i32; 4],
        fired: &[usize],
    ) {
        let digit = |number: usize| char::from_digit(number as u32, 16).expect("four bits");
        self.heading[agent].push(digit(heading.map_or(4, |heading| heading as usize)));
        self.action[agent].push(digit(action.index()));
        let width = self.derived_digits;
        let _ = write!(self.derived[agent], "{derived:0width$x}");
        self.view[agent].push(position_in(&mut self.views, view));
        self.fired[agent].push(position_in(&mut self.fired_sets, fired.to_vec()));
    }
}

/// Returns the position of an entry in a short list, and adds it if it is new.
fn position_in<T: PartialEq>(list: &mut Vec<T>, entry: T) -> usize {
    list.iter().position(|known| *known == entry).unwrap_or_else(|| {
        list.push(entry);
        list.len() - 1
    })
}

/// Returns the numbers that exactly one of two ascending lists has, in ascending order.
fn one_sided(left: &[u64], right: &[u64]) -> Vec<u64> {
    let (mut left, mut right) = (left.iter().peekable(), right.iter().peekable());
    let mut found = Vec::new();
    loop {
        match (left.peek(), right.peek()) {
            (Some(one), Some(other)) if one == other => {
                left.next();
                right.next();
            }
            (Some(one), other) if other.is_none_or(|other| one < other) => found.extend(left.next()),
            (_, Some(_)) => found.extend(right.next()),
            (_, None) => return found,
        }
    }
}

/// Returns first and last cell of a field of view, relative to the agent.
pub fn relative_view(at: [i32; 2], heading: Option<Heading>, view: u32, map: &CityMap) -> [i32; 4] {
    let seen = field_of_view(cell(at), heading, view, map);
    let [row, col] = at;
    [
        seen.first.row - row,
        seen.first.col - col,
        seen.last.row - row,
        seen.last.col - col,
    ]
}

fn cell([row, col]: [i32; 2]) -> Cell {
    Cell { row, col }
}
