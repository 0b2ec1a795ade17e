//! Summarizes runs in one table of ratios.

use crate::case::Case;
use crate::measure::Run;
use crate::peer::{Peer, name};
use serde_json::json;
use std::fmt::Write;

/// All runs, in order.
#[derive(Default)]
pub struct Results(Vec<(Peer, Case, Run)>);

/// The medians of a peer on a case.
#[derive(Clone, Copy)]
struct Median {
    cpu_ms: f64,
    peak_mib: f64,
}

impl Results {
    pub fn add(&mut self, peer: Peer, case: Case, run: Run) {
        self.0.push((peer, case, run));
    }

    fn median(&self, peer: Peer, case: Case) -> Option<Median> {
        let runs = || {
            self.0
                .iter()
                .filter(|run| run.0 == peer && run.1 == case)
                .map(|run| &run.2)
        };
        let middle = |mut values: Vec<f64>| {
            values.sort_by(f64::total_cmp);
            values.get(values.len() / 2).copied()
        };
        Some(Median {
            cpu_ms: middle(runs().map(|run| run.cpu.as_secs_f64() * 1e3).collect())?,
            peak_mib: middle(runs().map(|run| run.peak_kib as f64 / 1024.0).collect())?,
        })
    }

    /// A table of `CPU / memory` as multiples of the engine's, whose own line has milliseconds and MiB.
    pub fn table(&self, peers: &[Peer], cases: &[Case]) -> String {
        let mut out = String::new();
        let mut line = |first: String, cells: &mut dyn Iterator<Item = String>| {
            write!(out, "| {first:<21} |").expect("writing to a string cannot fail");
            cells.for_each(|cell| write!(out, " {cell:>16} |").expect("writing to a string cannot fail"));
            out.push('\n');
        };
        line(
            "CPU / peak memory".into(),
            &mut cases.iter().map(|case| case.title().into()),
        );
        line("-".repeat(21), &mut cases.iter().map(|_| "-".repeat(15) + ":"));
        for &peer in peers {
            let cell = |&case: &Case| {
                let (Some(own), Some(found)) = (self.median(Peer::Engine, case), self.median(peer, case)) else {
                    return String::new();
                };
                if peer == Peer::Engine {
                    format!("{:.1} ms / {:.0} MiB", own.cpu_ms, own.peak_mib)
                } else {
                    format!(
                        "{:.2} / {:.2}",
                        found.cpu_ms / own.cpu_ms,
                        found.peak_mib / own.peak_mib
                    )
                }
            };
            line(peer.to_string(), &mut cases.iter().map(cell));
        }
        out.push_str(
            "\nOurs = 1.00; more is slower or larger. * is a whole process that reads its facts from files.\n",
        );
        out
    }

    /// Every median and every run.
    pub fn json(&self, peers: &[Peer], cases: &[Case], souffle: Option<&str>) -> String {
        let mut list = Vec::new();
        for &case in cases {
            for &peer in peers {
                let (Some(own), Some(found)) = (self.median(Peer::Engine, case), self.median(peer, case)) else {
                    continue;
                };
                let runs = self
                    .0
                    .iter()
                    .filter(|run| run.0 == peer && run.1 == case)
                    .map(|run| &run.2);
                let counts = runs.clone().next().map(|run| run.counts.clone());
                list.push(json!({
                    "case": name(case),
                    "peer": name(peer),
                    "whole_process": peer.is_whole(),
                    "counts": counts,
                    "cpu_ms": found.cpu_ms,
                    "peak_mib": found.peak_mib,
                    "cpu_ratio": found.cpu_ms / own.cpu_ms,
                    "peak_ratio": found.peak_mib / own.peak_mib,
                    "runs_cpu_ms": runs.clone().map(|run| run.cpu.as_secs_f64() * 1e3).collect::<Vec<_>>(),
                    "runs_peak_mib": runs.map(|run| run.peak_kib as f64 / 1024.0).collect::<Vec<_>>(),
                }));
            }
        }
        let all = json!({ "souffle": souffle, "medians": list });
        format!("{all:#}\n")
    }
}
