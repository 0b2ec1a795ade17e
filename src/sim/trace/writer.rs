//! Writes the trace of a run as JSON lines: a header, then one line per tick.
//! `docs/reference/traces.md` documents the format.

use crate::city::{Heading, Moved};
use crate::diag::{SourceId, Sources};
use crate::sim::tick::ground::json_value;
use crate::sim::tick::simulation::Simulation;
use crate::sim::trace::archive::{Archive, hash_sources};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};
use std::io::{self, Write};

/// The version of the format. It grows when an old reader would misread the new format.
pub const TRACE_VERSION: u32 = 2;

/// The trace entry of an agent that the caller controls in a tick. Readers that do not know it still read the action
/// correctly.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Driven {
    /// Names of the observed agents, the agent itself first.
    pub observes: Vec<String>,
    /// Name of the action that the rules choose given this observation.
    pub wanted: String,
    /// The clauses that its action violates: positions in [`World::clauses`](crate::sim::World::clauses).
    pub broken: Vec<usize>,
}

/// Writes a trace to an output.
pub struct TraceWriter<W: Write> {
    out: W,
    /// The predicates whose rows a replay cannot recompute: those that hold with a probability, external ones, and
    /// some quantities.
    recorded: Vec<usize>,
}

impl<W: Write> TraceWriter<W> {
    /// Writes the header, which contains the configuration and the rules. `rule_files` is the rule file, then the files
    /// it includes.
    ///
    /// # Errors
    /// The errors of `out`.
    pub fn new(mut out: W, simulation: &Simulation, sources: &Sources, rule_files: &[SourceId]) -> io::Result<Self> {
        let world = simulation.world();
        let archive = Archive::new(&world.scenario, sources, rule_files);
        let file_name = |id: SourceId| {
            let position = rule_files.iter().position(|file| *file == id);
            position.map_or("", |position| &archive.rule_files[position].name)
        };
        let rules = world.program.rules();
        let agents: Vec<Value> = simulation
            .agents()
            .iter()
            .map(|agent| {
                json!({
                    "id": agent.name().to_string(),
                    "type": agent.kind.name(),
                    "concepts": &*agent.concepts,
                    "priority": agent.priority,
                })
            })
            .collect();
        let clauses: Vec<Value> = simulation
            .clauses()
            .iter()
            .map(|clause| {
                let clause = &rules.clauses[clause.index()];
                let position = sources.position(clause.span);
                json!({
                    "head": rules.predicates[clause.head.predicate.index()].name,
                    "file": file_name(sources.written(clause.span).source),
                    "line": position.line,
                    "doc": clause.doc,
                    "text": sources.slice(clause.span),
                })
            })
            .collect();
        let header = json!({
            "trace": "logicity",
            "version": TRACE_VERSION,
            "config": world.scenario.name,
            "config_hash": world.scenario.hash,
            "rules": archive.rule_files.first().map(|file| &file.name),
            "rules_hash": hash_sources(sources, rule_files),
            "map": world.map().name,
            "routing": world.scenario.routing.name(),
            "split": simulation.split().name(),
            "seed": simulation.seed().0,
            "agents": agents,
            "clauses": clauses,
            "configuration": archive.configuration,
            "rule_files": archive.rule_files,
        });
        writeln!(out, "{header}")?;
        let recorded = (world.vocabulary.predicates.iter().enumerate())
            .filter(|(_, predicate)| predicate.definition.is_recorded())
            .map(|(index, _)| index)
            .collect();
        Ok(TraceWriter { out, recorded })
    }

    /// Writes the last tick of a simulation: the state before (`at`, `heading`, `goal`), the decision, and the cell
    /// after.
    ///
    /// # Errors
    /// The errors of the output.
    pub fn tick(&mut self, simulation: &Simulation) -> io::Result<()> {
        self.tick_driven(simulation, &[])
    }

    /// Variant of [`tick`](Self::tick) with the entries of controlled agents, given by their positions in the list.
    ///
    /// # Errors
    /// The errors of the output.
    ///
    /// # Panics
    /// If a position is outside the list.
    pub fn tick_driven(&mut self, simulation: &Simulation, driven: &[(usize, Driven)]) -> io::Result<()> {
        let report = simulation.report();
        let actions = simulation.world().vocabulary.actions();
        let mut agents: Vec<Value> = (report.agents.iter().zip(simulation.agents()).enumerate())
            .map(|(index, (tick, agent))| {
                let Moved {
                    from, to, replanned, ..
                } = tick.moved;
                // An agent with a new goal started from the old one.
                let goal = if replanned { from } else { agent.goal() };
                let mut entry = json!({
                    "at": [from.row, from.col],
                    "heading": tick.heading.map(Heading::name),
                    "goal": [goal.row, goal.col],
                    "derived": tick.derived.iter().map(|action| actions.name(action)).collect::<Vec<_>>(),
                    "action": actions.name(tick.action),
                    "clauses": simulation.fired(index).collect::<Vec<_>>(),
                    "next": [to.row, to.col],
                });
                if tick.moved.rerouted {
                    // The new route starts at the cell before the move.
                    entry["route"] = json!(agent.route().corners());
                }
                entry
            })
            .collect();
        for (agent, driven) in driven {
            agents[*agent]["driven"] = json!(driven);
        }
        let names = simulation.agents();
        let predicates = &simulation.world().vocabulary.predicates;
        let facts = simulation.facts(|index| self.recorded.contains(&index));
        let facts = facts.map_err(|fault| io::Error::other(fault.message))?;
        let name = |agent: u32| names[agent as usize].name().to_string();
        let rules = simulation.world().program.rules();
        let pasts = rules.pasts.iter();
        let given: Map<String, Value> = (self.recorded.iter())
            .map(|&index| {
                let unit = predicates[index].definition.unit();
                let values = facts.values[index].iter();
                let values = values.map(|value| unit.map(|unit| json_value(*value, unit)));
                let values = values.chain(std::iter::repeat(None));
                let rows = facts.rows[index].iter().zip(values).map(|(row, value)| {
                    let names = row[..predicates[index].arity].iter().map(|agent| json!(name(*agent)));
                    names.chain(value).collect::<Value>()
                });
                (predicates[index].name.clone(), rows.collect())
            })
            .chain(pasts.zip(&facts.past).map(|(past, rows)| {
                let hidden = &rules.predicates[past.predicate.index()];
                let rows = rows.iter().map(|(row, tick)| {
                    let names = row[..hidden.arity()].iter().map(|agent| json!(name(*agent)));
                    names.chain([json!(tick)]).collect::<Value>()
                });
                (hidden.name.clone(), rows.collect())
            }))
            .collect();
        writeln!(
            self.out,
            "{}",
            json!({ "tick": report.tick, "agents": agents, "given": given })
        )
    }

    /// Returns the output for changes.
    pub fn get_mut(&mut self) -> &mut W {
        &mut self.out
    }

    /// Returns the output.
    pub fn into_inner(self) -> W {
        self.out
    }
}
