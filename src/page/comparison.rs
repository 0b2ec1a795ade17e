//! Two runs in step, and where they differ.

use crate::diag::Diagnostic;
use crate::page::file::{packed, write_parts};
use crate::page::run::Page;
use crate::sim::codes;
use serde::Serialize;
use std::io::{self, Write};

/// Two runs of the same agents on the same map, tick by tick.
#[derive(Serialize)]
pub struct Comparison<'a> {
    #[serde(skip)]
    runs: [&'a Page; 2],
    /// The names of the runs on the page.
    names: [String; 2],
    /// The number of ticks that both runs have.
    count: usize,
    /// The ticks in which the runs differ.
    differences: Vec<Difference>,
}

/// The difference of the runs in a tick.
#[derive(Serialize)]
struct Difference {
    /// Position of the tick.
    tick: usize,
    /// The agents that take different actions.
    acts: Vec<usize>,
    /// The agents that are in different cells.
    apart: Vec<usize>,
}

impl<'a> Comparison<'a> {
    /// Compares two runs.
    ///
    /// # Errors
    /// Without a place: `trace-mismatch` if the runs have different maps, agents or first ticks; `invalid-trace` if one
    /// has no ticks.
    pub fn new(runs: [&'a Page; 2], names: [String; 2]) -> Result<Comparison<'a>, Diagnostic> {
        let [left, right] = runs;
        let [a, b] = &names;
        let fault = |message: String| Diagnostic::new(codes::TRACE_MISMATCH, message);
        if !left.scenery.map.equals(&right.scenery.map) {
            let (one, other) = (&left.scenery.map.name, &right.scenery.map.name);
            let message = format!("the runs have different maps: `{one}` in `{a}`, `{other}` in `{b}`");
            return Err(fault(message).help("compare runs of one configuration, with different rules or policies"));
        }
        if let Some(position) = (0..left.header.agents.len().max(right.header.agents.len()))
            .find(|&position| left.header.agents.get(position) != right.header.agents.get(position))
        {
            let [one, other] = runs.map(|run| match run.header.agents.get(position) {
                None => "no more agents".to_owned(),
                Some(agent) => agent.to_string(),
            });
            let message = format!("the runs have different agents: {one} in `{a}`, {other} in `{b}`");
            return Err(fault(message).help("compare runs of one agent set and split"));
        }
        if left.first != right.first {
            let (one, other) = (left.first, right.first);
            let message = format!("the runs begin with different ticks: {one} in `{a}`, {other} in `{b}`");
            return Err(fault(message).help("choose the first tick with `--from`"));
        }
        let count = left.count.min(right.count);
        if count == 0 {
            let name = if left.count == 0 { a } else { b };
            return Err(Diagnostic::new(codes::INVALID_TRACE, format!("`{name}` has no ticks")));
        }
        let differences = (0..count).filter_map(|tick| Difference::of(runs, tick)).collect();
        Ok(Comparison {
            runs,
            names,
            count,
            differences,
        })
    }

    /// Returns the summary: the number of different decisions, the first difference, and which run ends earlier.
    pub fn summary(&self) -> String {
        let [left, right] = self.runs;
        let agents = left.header.agents.len();
        let last = left.first + self.count as u64 - 1;
        let different: usize = self.differences.iter().map(|difference| difference.acts.len()).sum();
        let mut text = match self.differences.first() {
            None => format!("the runs agree in all {} decisions", self.count * agents),
            Some(first) => {
                let tick = left.first + first.tick as u64;
                let place = match (first.acts.first(), first.apart.first()) {
                    (Some(&agent), _) => {
                        let [one, other] = self.runs.map(|run| run.action_name(first.tick, agent));
                        format!(
                            "{} chooses {one} in one run, {other} in the other",
                            left.header.agents[agent].id
                        )
                    }
                    (None, Some(&agent)) => format!("{} is in different cells", left.header.agents[agent].id),
                    (None, None) => unreachable!("a difference has an agent"),
                };
                let total = self.count * agents;
                format!("the runs differ in {different} of {total} decisions, first in tick {tick}: {place}")
            }
        };
        if left.count != right.count {
            let shorter = usize::from(right.count < left.count);
            text += &format!(
                "\n`{}` ends with tick {last}; later ticks are not shown",
                self.names[shorter]
            );
        }
        text
    }

    /// Writes the page.
    ///
    /// # Errors
    /// Errors of `out`.
    pub fn write(&self, out: &mut impl Write) -> io::Result<()> {
        let [left, right] = self.runs;
        let [a, b] = &self.names;
        let mut parts = vec![("scenery", 0, packed(&left.scenery)?)];
        parts.push(("pair", 0, packed(self)?));
        let (mut proofs, runs) = (Vec::new(), [left, right]);
        for (number, run) in runs.into_iter().enumerate() {
            parts.push(("run", number, packed(run)?));
            proofs.extend(run.proof_parts()?.into_iter().map(|part| ("proofs", number, part)));
        }
        parts.extend(proofs);
        write_parts(&format!("{a} and {b}"), &parts, out)
    }
}

impl Difference {
    /// Returns how the runs differ in a tick; `None` if they do not.
    fn of([left, right]: [&Page; 2], tick: usize) -> Option<Difference> {
        let agents = 0..left.header.agents.len();
        let acts: Vec<usize> = (agents.clone())
            .filter(|&agent| left.action(tick, agent) != right.action(tick, agent))
            .collect();
        let apart: Vec<usize> = agents
            .filter(|&agent| left.at(tick, agent) != right.at(tick, agent))
            .collect();
        (!acts.is_empty() || !apart.is_empty()).then_some(Difference { tick, acts, apart })
    }
}
