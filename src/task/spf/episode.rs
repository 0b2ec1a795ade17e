//! Episodes: how a city begins; and files of them.
//!
//! A file of episodes has JSON lines. The first is a header: `episodes` (`"logicity"`), `version`, the names of `config` and `split`, the
//! `seed` the set was made from, and the `agents` in list order with `id`, `concepts` and `priority`. Every other line is an episode:
//! `seed`, `trips` (for each agent row and column of its start and of its goal), `changes` (agents that are otherwise than the header
//! has them, by name) and `oracle` (`steps`, `return`, and `constrained`: how many steps rules asked an action, by action).

use crate::city::{Action, AgentConfig, AgentKind, AgentName, Split};
use crate::city::{Agent, Cell};
use crate::config::PredicateConfig;
use crate::diag::{Code, Diagnostic, SourceId, Sources, Span, did_you_mean};
use crate::files::ReadFile;
use crate::sim::World;
use crate::task::spf::{SpfTask, constrained_by_name};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;
use std::io::{self, Write};
use std::sync::Arc;

/// Version of the format of files; it grows when a reader of the old one would misread the new one.
const VERSION: u32 = 1;

/// Episodes that everybody is measured on.
#[derive(Clone, Debug, PartialEq)]
pub struct EpisodeSet {
    /// Name of the configuration they are for.
    pub config: String,
    /// The split whose agents they have.
    pub split: Split,
    /// What they were made from.
    pub seed: u64,
    /// The episodes.
    pub episodes: Vec<Episode>,
}

/// How an episode begins, and what the oracle made of it.
#[derive(Clone, Debug, PartialEq)]
pub struct Episode {
    /// Of everything that is drawn during the episode.
    pub seed: u64,
    /// The agents in list order.
    pub agents: Vec<EpisodeAgent>,
    /// What the oracle made of it, if it is known.
    pub oracle: Option<OracleRun>,
}

/// An agent as an episode begins.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct EpisodeAgent {
    /// Its name.
    pub name: AgentName,
    /// What it is.
    pub concepts: Arc<[String]>,
    /// Right of way; a smaller number goes first.
    pub priority: i32,
    /// Where it starts.
    pub start: Cell,
    /// Where it goes.
    pub goal: Cell,
}

/// An episode in which the ego does what the rules want.
#[derive(Clone, Debug, PartialEq)]
pub struct OracleRun {
    /// How many steps it took to the goal.
    pub steps: u32,
    /// The sum of its rewards.
    pub total: f64,
    /// In how many steps the rules asked an action, by action in the order of [`Action::ALL`](crate::city::Action::ALL).
    pub constrained: [u32; 4],
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

    /// Whether it carries what an agent set could give it: concepts of its kind that a predicate tells, none of them twice.
    fn check_concepts(&self, predicates: &[PredicateConfig]) -> Result<(), Diagnostic> {
        let (name, kind) = (self.name, self.name.kind);
        for (position, carried) in self.concepts.iter().enumerate() {
            if self.concepts[..position].contains(carried) {
                return Err(invalid(format!("the concept `{carried}` is given twice to {name}")));
            }
            let told = predicates.iter().filter_map(|predicate| predicate.definition.concept());
            let mut kinds = told.clone().filter(|told| told.concept == *carried).map(|told| told.of);
            if kinds.clone().any(|of| of == kind) {
                continue;
            }
            if let Some(other) = kinds.next() {
                let other = other.name().to_lowercase();
                return Err(invalid(format!("`{carried}` is a concept of a {other}, not of {name}")));
            }
            let known: Vec<&str> = (told.filter(|told| told.of == kind))
                .map(|told| told.concept.as_str())
                .collect();
            let fault = invalid(format!("no predicate tells whether {name} is `{carried}`"));
            return Err(match did_you_mean(carried, known.iter().copied()) {
                Some(near) => fault.help(format!("did you mean `{near}`?")),
                None => fault.help(format!(
                    "concepts of a {}: {}",
                    kind.name().to_lowercase(),
                    known.join(", ")
                )),
            });
        }
        Ok(())
    }

    /// Takes note of an agent of the same name.
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

    /// The agents at their starts, which must be named as these are and be what predicates of the world can tell.
    pub(super) fn place(&self, world: &World, like: &[Agent]) -> Result<Vec<Agent>, Diagnostic> {
        if self.agents.len() != like.len() {
            let message = format!(
                "the episode has {} agents, the split has {}",
                self.agents.len(),
                like.len()
            );
            return Err(invalid(message));
        }
        let agents = self.agents.iter().zip(like).map(|(agent, like)| {
            if agent.name != like.name() {
                return Err(invalid(format!(
                    "the episode has {} where {} is",
                    agent.name,
                    like.name()
                )));
            }
            agent.check_concepts(&world.scenario.predicates)?;
            let [start, goal] = [agent.start, agent.goal];
            let route = world.router.plan(agent.name.kind, start, goal).map_err(|_| {
                let (from, to) = (
                    format!("[{}, {}]", start.row, start.col),
                    format!("[{}, {}]", goal.row, goal.col),
                );
                invalid(format!("{} cannot go from {from} to {to}", agent.name))
                    .help("cars start and arrive at kerb cells of traffic streets, pedestrians on sidewalks")
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

/// What a header of any version has.
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

/// What an agent is.
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
    Diagnostic::new(Code::INVALID_EPISODE, message)
}

/// The name that is written so.
fn agent_name(text: &str) -> Result<AgentName, Diagnostic> {
    let named = |kind: AgentKind| {
        let number = text.strip_prefix(kind.name())?.strip_prefix('_')?.parse().ok()?;
        Some(AgentName { kind, number }).filter(|name| name.to_string() == text)
    };
    let found = AgentKind::ALL.into_iter().find_map(named);
    found.ok_or_else(|| {
        invalid(format!(
            "`{text}` is not the name of an agent, such as `Car_1` or `Pedestrian_3`"
        ))
    })
}

impl EpisodeSet {
    /// Loads the recorded episodes of a split, from the file that the configuration of a task names. The text is added to `sources`.
    ///
    /// # Errors
    /// `missing-key` if the configuration names no file, `missing-file` if it cannot be read, `invalid-episode` for a faulty one or one of
    /// another split.
    pub fn load(
        task: &SpfTask,
        split: Split,
        sources: &mut Sources,
        read: &dyn ReadFile,
    ) -> Result<EpisodeSet, Diagnostic> {
        let config = task.config();
        let Some(file) = &config.episodes[split as usize] else {
            let message = format!("the task names no file of episodes for the split `{}`", split.name());
            let fault = Diagnostic::new(Code::MISSING_KEY, message).at(config.span, "in this task");
            return Err(fault.help(format!(
                "`episodes: {{{}: FILE}}` names one, `logicity episodes make` makes it",
                split.name()
            )));
        };
        let (path, name) = (&file.value, file.value.display());
        let text = read.read(path).map_err(|error| {
            let fault = Diagnostic::new(
                Code::MISSING_FILE,
                format!("cannot read the episodes `{name}`: {error}"),
            );
            fault
                .at(file.span, "named here")
                .help("`logicity episodes make` makes them")
        })?;
        let source = sources.add(name.to_string(), text);
        let set = EpisodeSet::read(sources, source)?;
        if set.split != split {
            let message = format!("episodes of the split `{}`, not `{}`", set.split.name(), split.name());
            return Err(invalid(message).at(file.span, "named here"));
        }
        Ok(set)
    }

    /// Reads a file of episodes.
    ///
    /// # Errors
    /// `invalid-episode` with its line and column. Whether the episodes fit a city is asked when they begin.
    pub fn read(sources: &Sources, source: SourceId) -> Result<EpisodeSet, Diagnostic> {
        let text = sources.text(source);
        let mut at = 0;
        let mut lines = text.split_inclusive('\n').map(|line| {
            let start = at;
            at += line.len();
            (start, line.trim_end())
        });
        let (start, first) = lines.next().unwrap_or((0, ""));
        let what = "the header of a file of episodes";
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
        let agent = |HeaderAgent { id, concepts, priority }| Ok((agent_name(&id)?, Character { concepts, priority }));
        let agents: Vec<(AgentName, Character)> = header
            .agents
            .into_iter()
            .map(agent)
            .collect::<Result<_, _>>()
            .map_err(here)?;
        let mut episodes = Vec::new();
        for (start, text) in lines.filter(|(_, line)| !line.is_empty()) {
            let line: Line = parse(text, source, start, "an episode")?;
            let here = |fault: Diagnostic| fault.at(Span::new(source, start..start + text.len()), "in this episode");
            episodes.push(line.read(&agents).map_err(here)?);
        }
        if episodes.is_empty() {
            return Err(here(invalid("there are no episodes")).help("`logicity episodes make` makes some"));
        }
        Ok(EpisodeSet {
            config: header.config,
            split,
            seed: header.seed,
            episodes,
        })
    }

    /// Writes a file of episodes.
    ///
    /// # Errors
    /// Whatever `out` reports.
    ///
    /// # Panics
    /// If there are no episodes, or their agents are named otherwise.
    pub fn write(&self, out: &mut impl Write) -> io::Result<()> {
        let first = self.episodes.first().expect("at least one episode");
        let character = |agent: &EpisodeAgent| Character {
            concepts: Arc::clone(&agent.concepts),
            priority: agent.priority,
        };
        let agent = |agent: &EpisodeAgent| HeaderAgent {
            id: agent.name.to_string(),
            concepts: Arc::clone(&agent.concepts),
            priority: agent.priority,
        };
        let header = Header {
            episodes: "logicity".to_owned(),
            version: VERSION,
            config: self.config.clone(),
            split: self.split.name().to_owned(),
            seed: self.seed,
            agents: first.agents.iter().map(agent).collect(),
        };
        writeln!(out, "{}", serde_json::to_string(&header)?)?;
        for episode in &self.episodes {
            let agents = || episode.agents.iter().zip(&first.agents);
            assert!(
                episode.agents.len() == first.agents.len() && agents().all(|(agent, usual)| agent.name == usual.name)
            );
            let changed = agents().filter(|(agent, usual)| character(agent) != character(usual));
            let line = Line {
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
                    constrained: constrained_by_name(oracle.constrained)
                        .map(|(action, steps)| (action.to_owned(), steps))
                        .collect(),
                }),
            };
            writeln!(out, "{}", serde_json::to_string(&line)?)?;
        }
        Ok(())
    }

    /// SHA-256 of the file, in hexadecimal: names this very set of episodes in results.
    pub fn hash(&self) -> String {
        let mut text = Vec::new();
        self.write(&mut text).expect("memory does not fail");
        format!("{:x}", Sha256::digest(text))
    }
}

/// Reads a line that starts at a place of a source.
fn parse<'t, T: Deserialize<'t>>(line: &'t str, source: SourceId, start: usize, what: &str) -> Result<T, Diagnostic> {
    serde_json::from_str(line).map_err(|error| {
        // Columns of bytes from 1; 0 if nothing was read.
        let at = start + error.column().saturating_sub(1).min(line.len());
        let at = (start..=at)
            .rev()
            .find(|at| line.is_char_boundary(at - start))
            .unwrap_or(start);
        // The line of a text that has but one; the place in the file is told with the source.
        let place = format!(" at line {} column {}", error.line(), error.column());
        let told = error.to_string();
        let told = told.strip_suffix(&place).unwrap_or(&told);
        invalid(format!("not {what}: {told}")).at(Span::new(source, at..start + line.len()), "here")
    })
}

impl Line {
    fn read(self, usual: &[(AgentName, Character)]) -> Result<Episode, Diagnostic> {
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
            let mut constrained = [0; 4];
            for (name, steps) in &oracle.constrained {
                let action = Action::ALL.into_iter().find(|action| action.name() == name);
                let action = action.ok_or_else(|| invalid(format!("`{name}` is not an action")))?;
                constrained[action as usize] = *steps;
            }
            Ok::<_, Diagnostic>(OracleRun {
                steps: oracle.steps,
                total: oracle.total,
                constrained,
            })
        });
        Ok(Episode {
            seed: self.seed,
            agents: usual.iter().zip(&self.trips).map(agent).collect(),
            oracle: oracle.transpose()?,
        })
    }
}
