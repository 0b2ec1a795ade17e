//! A running city for the viewer of a page: ticks and explanations as JSON, without a file.

use crate::city::{ActionTable, Agent, corners};
use crate::datalog::explain::{Explainer, ExplanationPrinter};
use crate::diag::{Diagnostic, SourceId, Sources};
use crate::page::header::{Header, Values};
use crate::page::run::relative_view;
use crate::page::scenery::Scenery;
use crate::render::Icons;
use crate::sim::{Actions, Replay, Simulation, TraceHeader, TraceState, TraceTick, TraceWriter, trace_limits};
use serde::Serialize;
use serde_json::Value;
use std::collections::VecDeque;
use std::sync::Arc;

/// The number of past ticks that [`Live`] keeps.
pub const LIVE_TICKS: usize = 1000;

/// A running city with its recent ticks.
///
/// A tick goes through the trace format, so explanations of a running city and of a recorded one are the same.
pub struct Live {
    simulation: Simulation,
    sources: Sources,
    trace: TraceWriter<Vec<u8>>,
    replay: Replay,
    header: Header,
    /// The number of the tick in `replay`.
    replayed: Option<u64>,
    /// The last ticks, in order.
    past: VecDeque<Past>,
    /// For each agent, start and goal of the last route in a [`LiveTick`].
    routes: Vec<Option<[[i32; 2]; 2]>>,
}

/// A past tick.
struct Past {
    /// The agents before the tick.
    agents: Vec<Agent>,
    tick: TraceTick,
}

/// A tick for the viewer. Every list has one entry per agent.
#[derive(Serialize)]
pub struct LiveTick {
    tick: u64,
    at: Vec<[i32; 2]>,
    next: Vec<[i32; 2]>,
    goal: Vec<[i32; 2]>,
    /// The position in [`Heading::ALL`](crate::city::Heading::ALL); `None` before the first move.
    heading: Vec<Option<u8>>,
    /// The position in `actions` of the header.
    action: Vec<usize>,
    /// The actions derived before the default, as a bit set.
    derived: Vec<u16>,
    /// First and last cell of the field of view, relative to the agent.
    view: Vec<[i32; 4]>,
    /// The clauses that fired.
    fired: Vec<Vec<usize>>,
    /// The corners of the rest of the route, for agents with a new route.
    ways: Vec<Option<Vec<[i32; 2]>>>,
}

/// Why an agent acts as it does in a tick.
#[derive(Serialize)]
pub struct LiveExplanation {
    tick: u64,
    agent: usize,
    /// For each action, the position of a node, or -1 if no rule has the action.
    why: Vec<i64>,
    nodes: Vec<Value>,
    /// For each predicate, its rows. A row (x, y) is x times the number of agents plus y.
    rows: Vec<Vec<u64>>,
    /// The values of the quantities.
    values: Vec<Values>,
}

impl Live {
    /// Starts to record a simulation, which must count firings
    /// ([`count_firings`](crate::sim::Settings::count_firings)). `rule_files` is the rule file, then the files it
    /// includes.
    ///
    /// # Errors
    /// `invalid-trace`, without a place, for a simulation whose agents have equal names.
    pub fn new(simulation: Simulation, sources: Sources, rule_files: &[SourceId]) -> Result<Live, Diagnostic> {
        let mut trace = TraceWriter::new(Vec::new(), &simulation, &sources, rule_files).expect("a vector grows");
        let line = String::from_utf8(std::mem::take(trace.get_mut())).expect("JSON is UTF-8");
        let header = TraceHeader::read(&line)?;
        let mut replay = Replay::new(Arc::clone(simulation.world()), &header)?;
        replay.set_limits(trace_limits(header.agents.len()));
        Ok(Live {
            header: Header::new(&replay, &header, &sources),
            routes: vec![None; simulation.agents().len()],
            simulation,
            sources,
            trace,
            replay,
            replayed: None,
            past: VecDeque::new(),
        })
    }

    /// Returns the simulation.
    pub fn simulation(&self) -> &Simulation {
        &self.simulation
    }

    /// Returns the sources of the rules and the configuration.
    pub fn sources(&self) -> &Sources {
        &self.sources
    }

    /// Returns names, agents, predicates and clauses, as the viewer reads them.
    pub fn header(&self) -> impl Serialize + '_ {
        &self.header
    }

    /// Returns the map and the icons, as the viewer reads them.
    pub fn scenery(&self, icons: &Icons) -> impl Serialize + use<> {
        let agents = self.replay.agents();
        Scenery::new(icons, agents, &self.replay)
    }

    /// Runs a tick.
    ///
    /// # Errors
    /// As [`Simulation::tick`]. On error the city is unchanged.
    pub fn tick(&mut self) -> Result<LiveTick, Diagnostic> {
        let agents = self.simulation.agents().to_vec();
        self.simulation.tick(&[])?;
        self.trace.tick(&self.simulation).expect("a vector grows");
        let line = String::from_utf8(std::mem::take(self.trace.get_mut())).expect("JSON is UTF-8");
        let tick = TraceTick::read(&line)?;
        let shown = self.show(&tick, &agents)?;
        self.past.push_back(Past { agents, tick });
        if self.past.len() > LIVE_TICKS {
            self.past.pop_front();
        }
        Ok(shown)
    }

    fn show(&mut self, tick: &TraceTick, agents: &[Agent]) -> Result<LiveTick, Diagnostic> {
        let (world, states) = (self.simulation.world(), &tick.agents);
        let mut shown = LiveTick {
            tick: tick.tick,
            at: states.iter().map(|agent| agent.at).collect(),
            next: states.iter().map(|agent| agent.next).collect(),
            goal: states.iter().map(|agent| agent.goal).collect(),
            heading: Vec::new(),
            action: Vec::new(),
            derived: Vec::new(),
            view: Vec::new(),
            fired: states.iter().map(|agent| agent.clauses.clone()).collect(),
            ways: Vec::new(),
        };
        for ((state, agent), route) in states.iter().zip(agents).zip(&mut self.routes) {
            let heading = state.heading()?;
            shown.heading.push(heading.map(|heading| heading as u8));
            let actions = world.vocabulary.actions();
            shown.action.push(state.action(actions)?.index());
            shown.derived.push(derived_bits(state, actions));
            shown
                .view
                .push(relative_view(state.at, heading, world.scenario.view, world.map()));
            let ends = Some([agent.start(), agent.goal()].map(|cell| [cell.row, cell.col]));
            let is_new = *route != ends;
            *route = ends;
            shown
                .ways
                .push(is_new.then(|| corners(agent.route().cells().skip(agent.position()))));
        }
        Ok(shown)
    }

    /// Explains what an agent did in a kept tick; `None` for another tick or an unknown agent.
    ///
    /// # Errors
    /// `limit-exceeded` if the explanation takes too many steps.
    pub fn explain(&mut self, tick: u64, agent: usize) -> Result<Option<LiveExplanation>, Diagnostic> {
        let Some(past) = find(&self.past, tick).filter(|past| agent < past.agents.len()) else {
            return Ok(None);
        };
        if self.replayed != Some(tick) {
            self.replayed = None;
            self.replay.set(&past.tick)?;
            self.replayed = Some(tick);
        }
        let session = self.replay.session();
        let printer = ExplanationPrinter::new(session.program().rules(), session.symbols(), &self.sources);
        let mut explainer = Explainer::new(session);
        let why = self.header.explain(&self.replay, (&mut explainer, &printer), agent);
        // After an error, the next explanation begins without the nodes of this one.
        let nodes = self.header.proofs.take();
        Ok(Some(LiveExplanation {
            tick,
            agent,
            why: why?,
            nodes,
            rows: self.header.rows(&self.replay).collect(),
            values: self.header.values(&self.replay),
        }))
    }

    /// Returns the agents before a kept tick, or before the next tick. [`Simulation::resume`] continues from them.
    pub fn agents_before(&self, tick: u64) -> Option<&[Agent]> {
        match tick == self.simulation.now() {
            true => Some(self.simulation.agents()),
            false => find(&self.past, tick).map(|past| past.agents.as_slice()),
        }
    }
}

fn find(past: &VecDeque<Past>, tick: u64) -> Option<&Past> {
    let first = past.front()?.tick.tick;
    past.get(usize::try_from(tick.checked_sub(first)?).ok()?)
}

fn derived_bits(state: &TraceState, actions: &ActionTable) -> u16 {
    let derived: Actions = state.derived.iter().filter_map(|name| actions.find(name)).collect();
    derived.bits()
}
