//! Episodes (the initial state of a city and its agents), and files of them.
//!
//! An episode file has JSON lines. The first is a header: `episodes` (`"logicity"`), `version`, the names of `config`
//! and `split`, the `map` with its name and hash, the `seed` of the set, and the `agents` in list order with `id`,
//! `concepts` and `priority`. Every other line is an episode: `seed`; `trips` (row and column of start and of goal of each agent); `changes` (agents that
//! differ from the header, by name); and `oracle` (`steps`, `return`, and `constrained`: the number of constrained
//! steps, by action).
// Decision: docs/decisions/tasks.md#d043

use crate::city::{ActionTable, AgentConfig, AgentName, KindId, KindTable, Split};
use crate::city::{Agent, Cell, CityMap};
use crate::config::codes;
use crate::config::{PredicateConfig, SpfConfig};
use crate::diag::{self, Diagnostic, SourceId, Sources, Span, did_you_mean, json_error, listed};
use crate::files::{ReadError, ReadFile};
use crate::rng::{Rng, RngExt};
use crate::task::spf::{self, ControlMode, SpfTask};
use crate::yaml;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;
use std::io::{self, Write};
use std::sync::Arc;

/// Draws the seed of an episode, less than 2^53 so that all JSON readers represent it exactly.
pub(super) fn episode_seed(stream: &mut impl Rng) -> u64 {
    stream.random::<u64>() >> 11
}

/// Version of the file format. It increases when readers of the old version would misread the new one.
const VERSION: u32 = 1;

/// A fixed set of episodes for evaluation.
#[derive(Clone, Debug, PartialEq)]
pub struct EpisodeSet {
    /// Name of the configuration.
    pub config: String,
    /// The split of the agents.
    pub split: Split,
    /// The map that the trips fit.
    pub map: MapIdentity,
    /// The seed of the set.
    pub seed: u64,
    /// The episodes.
    pub episodes: Vec<Episode>,
}

/// The map of an episode set. Two maps are the same if their hashes are equal.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MapIdentity {
    /// The name of the map, for messages.
    pub name: String,
    /// SHA-256 of the widths and buildings, in hexadecimal.
    pub hash: String,
}

/// The start of an episode, and the oracle's result on it.
#[derive(Clone, Debug, PartialEq)]
pub struct Episode {
    /// Seed of all random events during the episode.
    pub seed: u64,
    /// The agents in list order.
    pub agents: Vec<EpisodeAgent>,
    /// The oracle's result, if known.
    pub oracle: Option<OracleRun>,
}

/// An agent at the start of an episode.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct EpisodeAgent {
    /// Name.
    pub name: AgentName,
    /// Concepts.
    pub concepts: Arc<[String]>,
    /// Priority for right of way; smaller numbers go first.
    pub priority: i32,
    /// Start cell.
    pub start: Cell,
    /// Goal cell.
    pub goal: Cell,
}

/// The result of the oracle, which does what the rules want.
#[derive(Clone, Debug, PartialEq)]
pub struct OracleRun {
    /// Number of steps to the goal.
    pub steps: u32,
    /// The sum of its rewards.
    pub total: f64,
    /// Number of steps in which the rules derived each action, in the order of
    /// [`Action::STANDARD`](crate::city::Action::STANDARD).
    pub constrained: BTreeMap<String, u32>,
}

impl MapIdentity {
    /// Returns the identity of a map.
    pub fn of(map: &CityMap) -> MapIdentity {
        let mut hash = Sha256::new();
        if let Some(layout) = map.layout() {
            let [rows, cols] = layout.blocks();
            let (street, sidewalk) = (layout.street_span(0).len(), layout.sidewalk());
            let (building, inner) = (layout.building_span(0, 0).len(), layout.inner_span(0).len());
            hash.update(format!("{rows} {cols} {street} {sidewalk} {building} {inner}"));
        }
        for building in map.buildings().iter().flatten() {
            hash.update(format!(" {building:?}"));
        }
        if let Some(network) = map.network() {
            hash.update(serde_json::to_vec(network).expect("a network has only finite numbers"));
        }
        MapIdentity {
            name: map.name.clone(),
            hash: format!("{:x}", hash.finalize()),
        }
    }
}

impl Episode {
    /// Returns the maximum number of steps when the first car is controlled: `patience` times the oracle's steps, or
    /// the configured horizon if these are unknown.
    pub fn horizon(&self, config: &SpfConfig) -> u32 {
        let oracle = self.oracle.as_ref();
        let horizon = oracle.map(|oracle| oracle.steps.saturating_mul(config.patience));
        horizon.unwrap_or(config.horizon).max(1)
    }
}

impl EpisodeAgent {
    fn of(agent: &Agent) -> EpisodeAgent {
        EpisodeAgent {
            name: agent.name(),
            concepts: Arc::clone(&agent.concepts),
            priority: agent.priority,
            start: agent.start(),
            goal: agent.goal(),
        }
    }

    /// Checks that an agent set could contain it: its concepts are distinct, and a predicate defines each for its type.
    fn check_concepts(&self, predicates: &[PredicateConfig]) -> Result<(), Diagnostic> {
        let (name, kind) = (self.name, self.name.kind);
        // The first concept of a kind that the configuration defines is its name.
        let own = name.own.map(|(_, own)| own.as_str().to_owned());
        if self.concepts.first() != own.as_ref() && own.is_some() {
            return Err(invalid(format!(
                "the first concept of {name} is not `{}`",
                name.kind_name()
            )));
        }
        for (position, carried) in self.concepts.iter().enumerate().skip(usize::from(own.is_some())) {
            if self.concepts[..position].contains(carried) {
                return Err(invalid(format!("{name} has the concept `{carried}` twice")));
            }
            let defined = predicates.iter().filter_map(|predicate| predicate.definition.concept());
            let mut kinds = defined
                .clone()
                .filter(|concept| concept.concept == *carried)
                .map(|concept| concept.of);
            if kinds.clone().any(|of| of == kind) {
                continue;
            }
            if let Some(other) = kinds.next() {
                let other = other.name().to_lowercase();
                return Err(invalid(format!("`{carried}` is a concept of a {other}, not of {name}")));
            }
            let known: Vec<&str> = (defined.filter(|concept| concept.of == kind))
                .map(|concept| concept.concept.as_str())
                .collect();
            let fault = invalid(format!("no predicate defines the concept `{carried}` of {name}"));
            return Err(match did_you_mean(carried, known.iter().copied()) {
                Some(near) => fault.help(format!("did you mean `{near}`?")),
                None => fault.help(format!(
                    "concepts of a {}: {}",
                    kind.name().to_lowercase(),
                    listed(&known)
                )),
            });
        }
        Ok(())
    }

    /// Updates this record from an agent of the same name.
    pub(super) fn note(&mut self, agent: &Agent) {
        if !Arc::ptr_eq(&self.concepts, &agent.concepts) {
            self.concepts = Arc::clone(&agent.concepts);
        }
        self.priority = agent.priority;
        (self.start, self.goal) = (agent.start(), agent.goal());
    }
}

impl Episode {
    pub(super) fn of(seed: u64, agents: &[Agent]) -> Episode {
        Episode {
            seed,
            agents: agents.iter().map(EpisodeAgent::of).collect(),
            oracle: None,
        }
    }

    /// Returns the agents at their starts. They must be those of the split, or some of them if a curriculum with one
    /// controlled car has a stage of their number. The world's predicates must define their concepts.
    pub(super) fn place(&self, task: &SpfTask, split: Split, control: ControlMode) -> Result<Vec<Agent>, Diagnostic> {
        let world = &**task.world();
        let set = world.scenario.agent_set(split).expect("a city has the split");
        let count = self.agents.len();
        let stages = task.config().curriculum.iter();
        let is_stage = (split, control) == (Split::Train, ControlMode::First)
            && stages.clone().any(|stage| stage.agents.value as usize == count);
        if count != set.len() && !is_stage {
            let message = format!("the episode has {count} agents, the split has {}", set.len());
            return Err(invalid(message));
        }
        // An episode of a stage leaves out agents after the ego.
        let mut left_out = set.len().saturating_sub(count);
        let mut names = set.members().map(|(name, _)| name);
        let agents = self.agents.iter().enumerate().map(|(position, agent)| {
            let mut name = names.next();
            while position > 0 && left_out > 0 && name != Some(agent.name) {
                (name, left_out) = (names.next(), left_out - 1);
            }
            if name != Some(agent.name) {
                let instead = name.map_or_else(String::new, |name| format!(" instead of {name}"));
                return Err(invalid(format!("the episode has {}{instead}", agent.name)));
            }
            agent.check_concepts(&world.scenario.predicates)?;
            let [start, goal] = [agent.start, agent.goal];
            let route = world.router.plan(agent.name.kind, start, goal).map_err(|_| {
                let (from, to) = (
                    format!("[{}, {}]", start.row, start.col),
                    format!("[{}, {}]", goal.row, goal.col),
                );
                invalid(format!("{} cannot go from {from} to {to}", agent.name))
                    .help("cars start and end on traffic streets beside a block, pedestrians on sidewalks")
            })?;
            let config = AgentConfig {
                name: agent.name,
                concepts: Arc::clone(&agent.concepts),
                priority: agent.priority,
            };
            Ok(Agent::new(&config, route))
        });
        agents.collect()
    }
}

/// The keys that headers of all versions share.
#[derive(Deserialize)]
struct Format {
    episodes: String,
    version: u32,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Header {
    episodes: String,
    version: u32,
    config: String,
    split: String,
    map: Option<MapIdentity>,
    seed: u64,
    agents: Vec<HeaderAgent>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct HeaderAgent {
    id: String,
    concepts: Arc<[String]>,
    priority: i32,
}

/// Concepts and priority of an agent.
#[derive(Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Character {
    concepts: Arc<[String]>,
    priority: i32,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Line {
    seed: u64,
    trips: Vec<[i32; 4]>,
    #[serde(default)]
    changes: BTreeMap<String, Character>,
    #[serde(default)]
    oracle: Option<LineOracle>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct LineOracle {
    steps: u32,
    #[serde(rename = "return")]
    total: f64,
    #[serde(default)]
    constrained: BTreeMap<String, u32>,
}

fn invalid(message: impl Into<String>) -> Diagnostic {
    Diagnostic::new(spf::codes::INVALID_EPISODE, message)
}

/// Parses the name of an agent.
fn agent_name(text: &str, kinds: &KindTable) -> Result<AgentName, Diagnostic> {
    let named = |kind: KindId| {
        let number = text.strip_prefix(kinds.name(kind))?.strip_prefix('_')?.parse().ok()?;
        Some(kinds.agent_name(kind, number)).filter(|name| name.to_string() == text)
    };
    let found = kinds.all().find_map(named);
    found.ok_or_else(|| {
        invalid(format!(
            "`{text}` is not an agent name such as `Car_1` or `Pedestrian_3`"
        ))
    })
}

impl EpisodeSet {
    /// Loads the recorded episodes of a split from the file in the task's configuration. Adds the file to `sources`.
    ///
    /// # Errors
    /// `missing-key` if the configuration names no file, `missing-file` if the file cannot be read, `invalid-episode`
    /// if it is faulty or belongs to another split or map.
    pub fn load(
        task: &SpfTask,
        split: Split,
        sources: &mut Sources,
        read: &dyn ReadFile,
    ) -> Result<EpisodeSet, Diagnostic> {
        let config = task.config();
        let Some(file) = &config.episodes[split as usize] else {
            let message = format!("the task has no episode file for the split `{}`", split.name());
            let fault = Diagnostic::new(yaml::codes::MISSING_KEY, message).at(config.span, "in this task");
            return Err(fault.help(format!(
                "set `episodes: {{{}: FILE}}` and create the file with `logicity episodes make`",
                split.name()
            )));
        };
        let (path, name) = (&file.value, file.value.display());
        let text = read.read(path).map_err(|error| {
            let code = match error {
                ReadError::NotText { .. } => diag::codes::NOT_TEXT,
                _ => codes::MISSING_FILE,
            };
            Diagnostic::new(code, format!("cannot read the episodes `{name}`: {error}"))
                .at(file.span, "named here")
                .help("create the file with `logicity episodes make`")
        })?;
        let source = sources.add(name.to_string(), text);
        let set = {
            let scenario = &task.world().scenario;
            EpisodeSet::read(sources, source, &scenario.kinds, &scenario.actions.table)?
        };
        if set.split != split {
            let message = format!(
                "the episodes are of the split `{}`, not `{}`",
                set.split.name(),
                split.name()
            );
            return Err(invalid(message).at(file.span, "named here"));
        }
        set.check_map(task).map_err(|fault| fault.at(file.span, "named here"))?;
        Ok(set)
    }

    /// Checks that the episodes are for the map of a task. On another map their trips may exist by chance, and the
    /// recorded results of the oracle do not hold.
    fn check_map(&self, task: &SpfTask) -> Result<(), Diagnostic> {
        let (world, split) = (task.world(), self.split.name());
        let map = MapIdentity::of(world.map());
        if self.map.hash == map.hash {
            return Ok(());
        }
        let name = &map.name;
        let message = match self.map.name == *name {
            true => format!("the recorded episodes are for an earlier version of the map `{name}`"),
            false => format!(
                "the recorded episodes are for the map `{}`, and the configuration has the map `{name}`",
                self.map.name
            ),
        };
        let config = &world.scenario.name;
        Err(invalid(message).help(format!(
            "draw your own: write `task: {{episodes: {{{split}: {config}-{split}.jsonl}}}}` in the configuration and \
             run `logicity episodes make {config}.yaml --split {split}`"
        )))
    }

    /// Reads an episode file.
    ///
    /// # Errors
    /// `invalid-episode` with line and column. [`Env::reset_to`](super::Env::reset_to) checks whether an episode fits a
    /// city.
    pub fn read(
        sources: &Sources,
        source: SourceId,
        kinds: &KindTable,
        actions: &ActionTable,
    ) -> Result<EpisodeSet, Diagnostic> {
        let text = sources.text(source);
        let mut at = 0;
        let mut lines = text.split_inclusive('\n').map(|line| {
            let start = at;
            at += line.len();
            (start, line.trim_end())
        });
        let (start, first) = lines.next().unwrap_or((0, ""));
        let what = "the header of an episode file";
        let Format { episodes: of, version } = parse(first, source, start, what)?;
        let here = |fault: Diagnostic| fault.at(Span::new(source, start..start + first.len()), "in this header");
        if of != "logicity" || version != VERSION {
            let message =
                format!("episodes of `{of}`, version {version}; this program reads `logicity`, version {VERSION}");
            return Err(here(invalid(message)));
        }
        let header: Header = parse(first, source, start, what)?;
        let split = Split::ALL.into_iter().find(|split| split.name() == header.split);
        let split = split.ok_or_else(|| here(invalid(format!("`{}` is not a split", header.split))))?;
        let map = header.map.ok_or_else(|| {
            here(invalid("the header does not contain the `map` of the episodes"))
                .help("draw the episodes again with `logicity episodes make`")
        })?;
        let agents: Vec<(AgentName, Character)> = header
            .agents
            .into_iter()
            .map(|agent| agent.read(kinds))
            .collect::<Result<_, _>>()
            .map_err(here)?;
        let mut episodes = Vec::new();
        for (start, text) in lines.filter(|(_, line)| !line.is_empty()) {
            let line: Line = parse(text, source, start, "an episode")?;
            let here = |fault: Diagnostic| fault.at(Span::new(source, start..start + text.len()), "in this episode");
            episodes.push(line.read(&agents, actions).map_err(here)?);
        }
        if episodes.is_empty() {
            return Err(here(invalid("the file has no episodes")).help("create some with `logicity episodes make`"));
        }
        Ok(EpisodeSet {
            config: header.config,
            split,
            map,
            seed: header.seed,
            episodes,
        })
    }

    /// Writes an episode file.
    ///
    /// # Errors
    /// Errors of `out`.
    ///
    /// # Panics
    /// If there are no episodes, or the names of their agents differ.
    pub fn write(&self, out: &mut impl Write) -> io::Result<()> {
        let first = self.episodes.first().expect("at least one episode");
        let header = Header {
            episodes: "logicity".to_owned(),
            version: VERSION,
            config: self.config.clone(),
            split: self.split.name().to_owned(),
            map: Some(self.map.clone()),
            seed: self.seed,
            agents: first.agents.iter().map(HeaderAgent::of).collect(),
        };
        writeln!(out, "{}", serde_json::to_string(&header)?)?;
        for episode in &self.episodes {
            writeln!(out, "{}", serde_json::to_string(&Line::of(episode, &first.agents))?)?;
        }
        Ok(())
    }

    /// Returns the SHA-256 of the file in hexadecimal, which identifies the set in results.
    pub fn hash(&self) -> String {
        let mut text = Vec::new();
        self.write(&mut text).expect("writing to a vector cannot fail");
        format!("{:x}", Sha256::digest(text))
    }
}

/// Parses a line that starts at a place of a source.
fn parse<'t, T: Deserialize<'t>>(line: &'t str, source: SourceId, start: usize, what: &str) -> Result<T, Diagnostic> {
    serde_json::from_str(line).map_err(|error| {
        // Columns count bytes from 1; 0 means that nothing was read.
        let at = start + error.column().saturating_sub(1).min(line.len());
        let at = (start..=at)
            .rev()
            .find(|at| line.is_char_boundary(at - start))
            .unwrap_or(start);
        invalid(format!("not {what}: {}", json_error(&error))).at(Span::new(source, at..start + line.len()), "here")
    })
}

impl HeaderAgent {
    fn of(agent: &EpisodeAgent) -> HeaderAgent {
        HeaderAgent {
            id: agent.name.to_string(),
            concepts: Arc::clone(&agent.concepts),
            priority: agent.priority,
        }
    }

    fn read(self, kinds: &KindTable) -> Result<(AgentName, Character), Diagnostic> {
        let HeaderAgent { id, concepts, priority } = self;
        Ok((agent_name(&id, kinds)?, Character { concepts, priority }))
    }
}

/// A line of a shard: an episode with its agents, and the number of its draw.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct DrawnLine {
    pub(super) draw: u64,
    agents: Vec<HeaderAgent>,
    episode: Line,
}

impl DrawnLine {
    pub(super) fn of(draw: u64, episode: &Episode) -> DrawnLine {
        DrawnLine {
            draw,
            agents: episode.agents.iter().map(HeaderAgent::of).collect(),
            episode: Line::of(episode, &episode.agents),
        }
    }

    pub(super) fn read(self, kinds: &KindTable, actions: &ActionTable) -> Result<Episode, Diagnostic> {
        let agents = self.agents.into_iter().map(|agent| agent.read(kinds));
        self.episode.read(&agents.collect::<Result<Vec<_>, _>>()?, actions)
    }
}

impl Line {
    /// Returns the line of an episode, whose agents have the names of the usual ones.
    fn of(episode: &Episode, usual: &[EpisodeAgent]) -> Line {
        let character = |agent: &EpisodeAgent| Character {
            concepts: Arc::clone(&agent.concepts),
            priority: agent.priority,
        };
        let agents = || episode.agents.iter().zip(usual);
        assert!(episode.agents.len() == usual.len() && agents().all(|(agent, usual)| agent.name == usual.name));
        let changed = agents().filter(|(agent, usual)| character(agent) != character(usual));
        Line {
            seed: episode.seed,
            trips: (episode.agents.iter())
                .map(|agent| [agent.start.row, agent.start.col, agent.goal.row, agent.goal.col])
                .collect(),
            changes: changed
                .map(|(agent, _)| (agent.name.to_string(), character(agent)))
                .collect(),
            oracle: episode.oracle.as_ref().map(|oracle| LineOracle {
                steps: oracle.steps,
                total: oracle.total,
                constrained: oracle.constrained.clone(),
            }),
        }
    }

    fn read(self, usual: &[(AgentName, Character)], actions: &ActionTable) -> Result<Episode, Diagnostic> {
        if self.trips.len() != usual.len() {
            let plural = if self.trips.len() == 1 { "" } else { "s" };
            let message = format!("{} trip{plural} of {} agents", self.trips.len(), usual.len());
            return Err(invalid(message));
        }
        if let Some(unknown) = self
            .changes
            .keys()
            .find(|name| usual.iter().all(|(known, _)| known.to_string() != **name))
        {
            return Err(invalid(format!("the header has no agent `{unknown}`")));
        }
        let agent = |((name, usual), &[row, col, goal_row, goal_col]): (&(AgentName, Character), &[i32; 4])| {
            let is = self.changes.get(&name.to_string()).unwrap_or(usual);
            EpisodeAgent {
                name: *name,
                concepts: Arc::clone(&is.concepts),
                priority: is.priority,
                start: Cell::new(row, col),
                goal: Cell::new(goal_row, goal_col),
            }
        };
        let oracle = self.oracle.as_ref().map(|oracle| {
            if let Some(name) = oracle.constrained.keys().find(|name| actions.find(name).is_none()) {
                return Err(invalid(format!("`{name}` is not an action")));
            }
            Ok::<_, Diagnostic>(OracleRun {
                steps: oracle.steps,
                total: oracle.total,
                constrained: oracle.constrained.clone(),
            })
        });
        Ok(Episode {
            seed: self.seed,
            agents: usual.iter().zip(&self.trips).map(agent).collect(),
            oracle: oracle.transpose()?,
        })
    }
}
