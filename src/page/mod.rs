//! Builds an HTML page of a run: one self-contained file that animates the city and explains every decision.
//!
//! ```text
//! trace --Replay--> state of a tick --Page::push--> columns, explanations --Page::write--> HTML with everything in it
//! ```
//!
//! The engine computes all data; the script in the page only shows them and evaluates no rules. Explanations share
//! equal nodes over the whole run (`page::proofs`). The data are JSON, compressed with zlib and encoded in base 64.

mod proofs;

use crate::city::{Action, AgentKind};
use crate::city::{Cell, Heading, Route, field_of_view};
use crate::datalog::explain::{Explainer, ExplanationPrinter};
use crate::datalog::{ClauseId, Value};
use crate::diag::{Code, Diagnostic, Sources};
use crate::files::portable_name;
use crate::render::{Class, Facing, Icons};
use crate::sim::{
    LOOK_TICKS, Replay, STUCK_TICKS, TraceAgent, TraceHeader, TraceTick, WaitsFor, find_deadlocks, waits,
};
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use flate2::Compression;
use flate2::write::ZlibEncoder;
use proofs::Proofs;
use serde::Serialize;
use std::collections::BTreeMap;
use std::io::{self, BufWriter, Write};

/// The most decisions in a page; more make it slow to open.
pub const DECISIONS_MAX: usize = 400_000;

/// Upper bound of tick numbers: JavaScript represents smaller integers exactly.
const TICK_MAX: u64 = 1 << 53;

/// The most icon instances per class.
const ICON_VARIANTS: u32 = 20;

const TEMPLATE: &str = include_str!("page.html");
const STYLE: &str = include_str!("page.css");
/// The parts of the script, each after the parts that it depends on.
const SCRIPT: &str = concat!(
    include_str!("script/run.js"),
    include_str!("script/elements.js"),
    include_str!("script/agent.js"),
    include_str!("script/chart.js"),
    include_str!("script/map.js"),
    include_str!("script/summary.js"),
    include_str!("script/page.js"),
);

/// A page under construction.
#[derive(Serialize)]
pub struct Page {
    title: String,
    config: String,
    rules: String,
    split: String,
    seed: u64,
    hash: String,
    map: Map,
    agents: Vec<Agent>,
    /// Icons as PNG in base 64; see [`Agent::icons`].
    icons: Vec<String>,
    actions: [&'static str; 4],
    headings: [&'static str; 4],
    predicates: Vec<Predicate>,
    /// Number of clauses whose firings the trace records: the first ones in [`Proofs::clauses`], in the order of the
    /// trace.
    counted: usize,
    /// For each of these clauses, the number of rows it derived in all ticks, and whether it derives an action.
    firings: Vec<(u64, bool)>,
    #[serde(flatten)]
    proofs: Proofs,
    /// Number of the first tick.
    first: u64,
    /// The state of every tick before its decisions, and the decisions.
    ticks: Vec<Tick>,
    /// The cells of the agents after the last tick.
    last: Vec<[i32; 2]>,
    /// For each agent, its routes: the position in `ticks` where the route begins, and its corners.
    routes: Vec<Vec<(usize, Vec<[i32; 2]>)>>,
    deadlocks: Vec<Deadlock>,
    /// Number of deadlock searches that reached a limit.
    deadlock_searches_cut: u32,
    /// The steps of externally controlled agents, with the actions that the rules wanted.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    driven: Vec<Driven>,
    #[serde(skip)]
    most: usize,
    /// For each agent, the tick after its last move.
    #[serde(skip)]
    still_since: Vec<u64>,
    /// The rows of each predicate in the last tick.
    #[serde(skip)]
    rows: Vec<Vec<[u32; 2]>>,
}

/// The map with the ground of each cell.
#[derive(Serialize)]
struct Map {
    name: String,
    rows: i32,
    cols: i32,
    /// For each row, run lengths: pairs of a kind of ground and a number of cells.
    ground: Vec<Vec<u32>>,
    /// Names of the kinds of ground.
    kinds: [&'static str; 10],
}

#[derive(Serialize)]
struct Agent {
    id: String,
    kind: &'static str,
    concepts: Vec<String>,
    priority: i32,
    /// Positions in [`Page::icons`]: for a car one icon that faces up, for a pedestrian one per heading, in the order
    /// of `headings`.
    icons: Vec<usize>,
}

#[derive(Serialize)]
struct Predicate {
    name: String,
    arity: usize,
}

/// The state of a tick before its decisions, and the decisions.
#[derive(Serialize)]
struct Tick {
    at: Vec<[i32; 2]>,
    /// Positions in `headings`, or -1.
    heading: Vec<i8>,
    /// Positions in `actions`.
    action: Vec<u8>,
    /// The actions derived before the default, as a bit set.
    derived: Vec<u8>,
    goal: Vec<[i32; 2]>,
    /// First and last cell of each field of view.
    view: Vec<[i32; 4]>,
    /// The clauses that fired for each agent.
    fired: Vec<Vec<usize>>,
    /// For each agent and action, the node that explains why it was or was not derived; -1 if no rule has the action.
    why: Vec<[i64; 4]>,
    /// The predicates whose rows changed since the tick before, with their rows as positions of agents.
    facts: Vec<(usize, Vec<u32>)>,
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
    wanted: u8,
    /// The clauses that its action violated.
    broken: Vec<usize>,
}

impl Page {
    /// Returns a page without ticks for a trace with this header.
    pub fn new(replay: &Replay, header: &TraceHeader, icons: &Icons, sources: &Sources) -> Page {
        let world = replay.world();
        let printer = ExplanationPrinter::new(world.program.rules(), replay.session().symbols(), sources);
        let mut proofs = Proofs::default();
        let counted = world.clauses().map(|clause| proofs.clause(&printer, clause)).count();
        for index in 0..world.program.rules().clauses.len() {
            proofs.clause(
                &printer,
                ClauseId(u32::try_from(index).expect("fewer than 2^32 clauses")),
            );
        }
        let mut shown = Shown::default();
        let agents: Vec<Agent> = (header.agents.iter().zip(replay.kinds()).enumerate())
            .map(|(position, (agent, &kind))| Agent {
                id: agent.id.clone(),
                kind: kind.name(),
                concepts: agent.concepts.clone(),
                priority: agent.priority,
                icons: shown.of(icons, kind, agent, position),
            })
            .collect();
        let predicates = (world.vocabulary.predicates.iter()).map(|predicate| Predicate {
            name: predicate.name.clone(),
            arity: predicate.arity,
        });
        Page {
            title: format!("{} ({}), seed {}", header.config, header.split, header.seed),
            config: header.config.clone(),
            rules: portable_name(&header.rules),
            split: header.split.clone(),
            seed: header.seed,
            hash: header.rules_hash.clone(),
            map: Map::new(world.map()),
            actions: Action::ALL.map(Action::name),
            headings: Heading::ALL.map(Heading::name),
            predicates: predicates.collect(),
            counted,
            firings: (world.clauses())
                .map(|clause| {
                    let head = world.program.rules().clauses[clause.index()].head.relation;
                    let is_action = Action::ALL
                        .map(|action| world.vocabulary.action(action))
                        .contains(&Some(head));
                    (0, is_action)
                })
                .collect(),
            proofs,
            first: 0,
            ticks: Vec::new(),
            last: Vec::new(),
            routes: vec![Vec::new(); agents.len()],
            deadlocks: Vec::new(),
            deadlock_searches_cut: 0,
            driven: Vec::new(),
            most: DECISIONS_MAX,
            still_since: vec![0; agents.len()],
            rows: vec![Vec::new(); world.vocabulary.predicates.len()],
            agents,
            icons: shown.icons,
        }
    }

    /// Sets a limit other than [`DECISIONS_MAX`].
    pub fn set_limit(&mut self, decisions: usize) {
        self.most = decisions;
    }

    /// Adds a tick, which the caller has loaded into `replay`. Ticks must be consecutive.
    ///
    /// # Errors
    /// `invalid-trace`, without a place, for an inconsistent tick; `limit-exceeded` for more decisions than the limit,
    /// or an explanation that takes too many steps.
    pub fn push(&mut self, replay: &Replay, tick: &TraceTick, sources: &Sources) -> Result<(), Diagnostic> {
        if (self.ticks.len() + 1) * self.agents.len() > self.most {
            let message = format!("a page of more than {} decisions would be slow to open", self.most);
            return Err(Diagnostic::new(Code::LIMIT_EXCEEDED, message).help("choose ticks with `--from` and `--ticks`"));
        }
        let expected = match self.ticks.len() {
            0 => tick.tick,
            shown => self.first + shown as u64,
        };
        if tick.tick != expected || tick.tick >= TICK_MAX {
            let message = match tick.tick >= TICK_MAX {
                true => format!("tick number {} is too large", tick.tick),
                false => format!("found tick {} instead of tick {expected}", tick.tick),
            };
            return Err(Diagnostic::new(Code::INVALID_TRACE, message));
        }
        if self.ticks.is_empty() {
            self.first = tick.tick;
            self.still_since.fill(tick.tick);
        }
        self.follow_routes(replay, tick);
        let (world, view) = (replay.world(), replay.world().scenario.view);
        let mut column = Tick {
            at: tick.agents.iter().map(|agent| agent.at).collect(),
            heading: Vec::new(),
            action: Vec::new(),
            derived: Vec::new(),
            goal: tick.agents.iter().map(|agent| agent.goal).collect(),
            view: Vec::new(),
            fired: tick.agents.iter().map(|agent| agent.clauses.clone()).collect(),
            why: self.explain(replay, sources)?,
            facts: self.changed(replay),
        };
        for (position, agent) in tick.agents.iter().enumerate() {
            self.check_clauses(&agent.clauses)?;
            if let Some(driven) = &agent.driven {
                self.check_clauses(&driven.broken)?;
                self.driven.push(Driven {
                    tick: self.ticks.len(),
                    agent: position,
                    observes: positions(replay, &driven.observes)?,
                    wanted: driven.wanted()? as u8,
                    broken: driven.broken.clone(),
                });
            }
            let heading = agent.heading()?;
            let seen = field_of_view(cell(agent.at), heading, view, world.map());
            let derived = replay.derived(position).iter();
            column.heading.push(heading.map_or(-1, |heading| heading as i8));
            column.action.push(agent.action()? as u8);
            column
                .derived
                .push(derived.fold(0, |bits, action| bits | 1 << action as u8));
            column
                .view
                .push([seen.first.row, seen.first.col, seen.last.row, seen.last.col]);
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
        self.ticks.push(column);
        self.last = tick.agents.iter().map(|agent| agent.next).collect();
        if (tick.tick + 1).is_multiple_of(LOOK_TICKS) {
            self.look_for_deadlocks(replay, tick.tick);
        }
        Ok(())
    }

    /// Writes the page.
    ///
    /// # Errors
    /// Errors of `out`.
    pub fn write(&self, out: &mut impl Write) -> io::Result<()> {
        // The buffer collects the many small writes of the serializer for the encoder.
        let mut packed = BufWriter::with_capacity(1 << 16, ZlibEncoder::new(Vec::new(), Compression::best()));
        serde_json::to_writer(&mut packed, self)?;
        let data = STANDARD.encode(packed.into_inner()?.finish()?);
        let title = self.title.replace('&', "&amp;").replace('<', "&lt;");
        let parts = [
            ("TITLE", title.as_str()),
            ("STYLE", STYLE),
            ("DATA", &data),
            ("SCRIPT", SCRIPT),
        ];
        let mut rest = TEMPLATE;
        for (name, text) in parts {
            let (before, after) = rest
                .split_once(&format!("{{{{{name}}}}}"))
                .expect("the template has all parts in order");
            out.write_all(before.as_bytes())?;
            out.write_all(text.as_bytes())?;
            rest = after;
        }
        out.write_all(rest.as_bytes())
    }

    fn check_clauses(&self, clauses: &[usize]) -> Result<(), Diagnostic> {
        let Some(clause) = clauses.iter().find(|clause| **clause >= self.counted) else {
            return Ok(());
        };
        let message = format!("no clause {clause}: the rules have {}", self.counted);
        Err(Diagnostic::new(Code::INVALID_TRACE, message))
    }

    /// Explains for each agent why it did or did not take each action.
    fn explain(&mut self, replay: &Replay, sources: &Sources) -> Result<Vec<[i64; 4]>, Diagnostic> {
        let session = replay.session();
        let printer = ExplanationPrinter::new(session.program().rules(), session.symbols(), sources);
        let mut explainer = Explainer::new(session);
        let mut all = Vec::with_capacity(self.agents.len());
        for position in 0..self.agents.len() {
            let mut nodes = [-1; 4];
            for (node, action) in nodes.iter_mut().zip(Action::ALL) {
                let Some(relation) = replay.world().vocabulary.action(action) else {
                    continue;
                };
                let asked: [Option<Value>; 1] = [Some(replay.value(position))];
                if let (_, Some(explanation)) = explainer.explain_either(relation, &asked)? {
                    *node = i64::from(self.proofs.add(&printer, &explanation));
                }
            }
            all.push(nodes);
        }
        Ok(all)
    }

    /// Returns the rows of predicates that changed since the tick before.
    fn changed(&mut self, replay: &Replay) -> Vec<(usize, Vec<u32>)> {
        let mut changed = Vec::new();
        for (index, (rows, old)) in replay.facts().rows.iter().zip(&mut self.rows).enumerate() {
            if rows == old && !self.ticks.is_empty() {
                continue;
            }
            old.clone_from(rows);
            let arity = self.predicates[index].arity;
            changed.push((index, rows.iter().flat_map(|row| row[..arity].to_vec()).collect()));
        }
        changed
    }

    /// Plans the routes of agents with a new goal. A trace records only goals, but start and goal determine a route. An
    /// agent that reaches its goal starts the next route in the same tick; the next tick is the first to show the new
    /// goal.
    fn follow_routes(&mut self, replay: &Replay, tick: &TraceTick) {
        let router = &replay.world().router;
        for (position, agent) in tick.agents.iter().enumerate() {
            let (now, before) = (self.ticks.len(), self.ticks.last());
            let (since, start) = match before.map(|before| (before.at[position], before.goal[position])) {
                Some((_, goal)) if goal == agent.goal => continue,
                Some((at, goal)) if at == goal => (now - 1, at),
                _ => (now, agent.at),
            };
            let route = router.plan(replay.kinds()[position], cell(start), cell(agent.goal));
            let corners = route.map_or_else(|_| Vec::new(), |route| corners(&route));
            self.routes[position].push((since, corners));
        }
    }

    fn look_for_deadlocks(&mut self, replay: &Replay, now: u64) {
        let stuck: Vec<usize> = (0..self.agents.len())
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
        let unknown = || Diagnostic::new(Code::INVALID_TRACE, format!("no agent `{name}`"));
        replay.position(name).ok_or_else(unknown)
    };
    names.iter().map(position).collect()
}

/// The icons of a page, each stored once.
#[derive(Default)]
struct Shown {
    icons: Vec<String>,
    known: BTreeMap<(Class, u32, Facing), usize>,
}

impl Shown {
    /// The side of an icon, in pixels.
    const SIDE: u32 = 96;

    /// Returns the icons of an agent. The number in its name selects the instance, as in other pictures of the run,
    /// modulo [`ICON_VARIANTS`].
    fn of(&mut self, icons: &Icons, kind: AgentKind, agent: &TraceAgent, position: usize) -> Vec<usize> {
        let class = Class::agent(kind, &agent.concepts);
        let number = agent.id.rsplit('_').next().and_then(|number| number.parse().ok());
        let instance = number.unwrap_or(u32::try_from(position).unwrap_or(0)) % ICON_VARIANTS;
        let facings = match kind {
            AgentKind::Car => vec![Facing::Up],
            AgentKind::Pedestrian => Heading::ALL.map(Facing::from).to_vec(),
        };
        let mut one = |facing: Facing| {
            let next = self.icons.len();
            let place = *self.known.entry((class.clone(), instance, facing)).or_insert(next);
            if place == next {
                self.icons
                    .push(STANDARD.encode(icons.png(&class, instance, facing, Self::SIDE)));
            }
            place
        };
        facings.into_iter().map(&mut one).collect()
    }
}

impl Map {
    const KINDS: [&'static str; 10] = [
        "other",
        "walking",
        "traffic",
        "crossing",
        "mid line",
        "house",
        "office",
        "garage",
        "store",
        "gas station",
    ];

    fn new(map: &crate::city::CityMap) -> Map {
        let kind = |cell: Cell| match (map.building_at(cell), map.is_mid_line(cell)) {
            (Some(building), _) => 5 + building as u32,
            (None, true) => 4,
            (None, false) => map.ground_at(cell).map_or(0, |ground| ground as u32),
        };
        let row = |row: i32| {
            let mut runs: Vec<u32> = Vec::new();
            for col in 0..map.cols() {
                match (runs.len().checked_sub(2).map(|at| runs[at]), kind(Cell { row, col })) {
                    (Some(before), now) if before == now => *runs.last_mut().expect("there is a run") += 1,
                    (_, now) => runs.extend([now, 1]),
                }
            }
            runs
        };
        Map {
            name: map.name.clone(),
            rows: map.rows(),
            cols: map.cols(),
            ground: (0..map.rows()).map(row).collect(),
            kinds: Self::KINDS,
        }
    }
}

fn cell([row, col]: [i32; 2]) -> Cell {
    Cell { row, col }
}

/// Returns start and goal of a route, and the cells between them where it turns.
fn corners(route: &Route) -> Vec<[i32; 2]> {
    let mut corners: Vec<[i32; 2]> = Vec::new();
    for cell in route.cells() {
        let now = [cell.row, cell.col];
        if let [.., a, b] = corners[..]
            && (a[0] == b[0] && b[0] == now[0] || a[1] == b[1] && b[1] == now[1])
        {
            corners.pop();
        }
        corners.push(now);
    }
    corners
}
