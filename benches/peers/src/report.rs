//! Summarizes runs in tables.

use crate::case::{Case, name};
use crate::measure::{CHANGES, Limit, Limits, Outcome, Run};
use crate::peer::Peer;
use serde_json::{Value, json};
use std::fmt::Write;

/// All runs, in order.
pub struct Results {
    runs: Vec<(Peer, Case, Outcome)>,
    limits: Limits,
}

/// The medians of a peer on a case.
#[derive(Clone, Copy)]
struct Median {
    cpu_ms: f64,
    peak_mib: f64,
}

impl Results {
    /// No runs, which are going to have these limits.
    pub fn new(limits: Limits) -> Self {
        let runs = Vec::new();
        Results { runs, limits }
    }

    pub fn add(&mut self, peer: Peer, case: Case, run: Outcome) {
        self.runs.push((peer, case, run));
    }

    fn outcomes(&self, peer: Peer, case: Case) -> impl Iterator<Item = &Outcome> + Clone {
        let found = move |run: &&(Peer, Case, Outcome)| run.0 == peer && run.1 == case;
        self.runs.iter().filter(found).map(|run| &run.2)
    }

    /// The runs within the limits.
    fn runs(&self, peer: Peer, case: Case) -> impl Iterator<Item = &Run> + Clone {
        self.outcomes(peer, case).filter_map(|run| run.as_ref().ok())
    }

    fn exceeded(&self, peer: Peer, case: Case) -> Option<Limit> {
        self.outcomes(peer, case).find_map(|run| run.as_ref().err().copied())
    }

    /// Of the CPU times of a change, the median in seconds.
    fn change(&self, peer: Peer, case: Case, at: usize) -> Option<f64> {
        let times = self.runs(peer, case).filter_map(|run| Some(run.changes.get(at)?.0));
        let mut times: Vec<f64> = times.map(|time| time.as_secs_f64()).collect();
        times.sort_by(f64::total_cmp);
        times.get(times.len() / 2).copied()
    }

    fn median(&self, peer: Peer, case: Case) -> Option<Median> {
        let runs = || self.runs(peer, case);
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
            write!(out, "| {first:<21} |").expect(STRING);
            cells.for_each(|cell| write!(out, " {cell:>16} |").expect(STRING));
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

    /// Two tables with a row for each case: rows, seconds of CPU time and peak memory of each peer; and the seconds of a
    /// change.
    pub fn suite(&self, peers: &[Peer], cases: &[Case]) -> String {
        let mut out = String::new();
        let mut line = |cells: Vec<String>| writeln!(out, "| {} |", cells.join(" | ")).expect(STRING);
        let names: Vec<String> = peers.iter().map(|peer| format!("{peer}")).collect();
        line([&["program".into(), "rows".into()], &names[..]].concat());
        line([&["---".into(), "---:".into()], &vec!["---:".into(); peers.len()][..]].concat());
        for &case in cases {
            let rows = peers.iter().find_map(|&peer| self.runs(peer, case).next());
            let rows = rows.map_or(String::new(), |run| thousands(run.counts.iter().sum()));
            let mut cells = vec![case.title().to_owned(), rows];
            cells.extend(peers.iter().map(|&peer| self.cell(peer, case)));
            line(cells);
        }
        let updating: Vec<Peer> = peers
            .iter()
            .copied()
            .filter(|&peer| cases.iter().any(|&case| self.change(peer, case, 0).is_some()))
            .collect();
        if updating.is_empty() {
            return out;
        }
        out.push('\n');
        let mut line = |cells: Vec<String>| writeln!(out, "| {} |", cells.join(" | ")).expect(STRING);
        let mut head = vec!["change of a base predicate".to_owned()];
        for peer in &updating {
            head.extend(CHANGES.map(|share| format!("{peer}, {} %", share * 100.0)));
        }
        line(head.clone());
        line([&["---".into()], &vec!["---:".into(); head.len() - 1][..]].concat());
        for &case in cases {
            let mut cells = vec![case.title().to_owned()];
            for &peer in &updating {
                let time = |at| self.change(peer, case, at).map_or("-".into(), seconds);
                cells.extend((0..CHANGES.len()).map(time));
            }
            line(cells);
        }
        out
    }

    fn cell(&self, peer: Peer, case: Case) -> String {
        if let Some(limit) = self.exceeded(peer, case) {
            return match limit {
                Limit::Time => format!("> {} s", self.limits.seconds),
                Limit::Memory => format!("> {} GiB", self.limits.memory_kib >> 20),
            };
        }
        let median = self.median(peer, case);
        median.map_or("-".into(), |found| {
            format!("{}, {:.0} MiB", seconds(found.cpu_ms / 1e3), found.peak_mib)
        })
    }

    /// Every median and every run.
    pub fn json(&self, peers: &[Peer], cases: &[Case], versions: &[(&str, String)], earlier: &Value) -> String {
        let is_new = |row: &&Value| cases.iter().any(|case| row["case"] == name(*case));
        let mut list: Vec<Value> = (earlier["medians"].as_array().into_iter().flatten())
            .filter(|row| !is_new(row))
            .cloned()
            .collect();
        for &case in cases {
            for &peer in peers {
                if let Some(limit) = self.exceeded(peer, case) {
                    let exceeded = match limit {
                        Limit::Time => format!("{} s", self.limits.seconds),
                        Limit::Memory => format!("{} GiB", self.limits.memory_kib >> 20),
                    };
                    list.push(
                        json!({ "case": name(case), "title": case.title(), "peer": name(peer), "exceeded": exceeded }),
                    );
                    continue;
                }
                let (Some(own), Some(found)) = (self.median(Peer::Engine, case), self.median(peer, case)) else {
                    continue;
                };
                let runs = self.runs(peer, case);
                let counts = runs.clone().next().map(|run| run.counts.clone());
                let change_ms = (0..CHANGES.len()).map_while(|at| Some(self.change(peer, case, at)? * 1e3));
                list.push(json!({
                    "case": name(case),
                    "title": case.title(),
                    "peer": name(peer),
                    "whole_process": peer.is_whole(),
                    "counts": counts,
                    "cpu_ms": found.cpu_ms,
                    "peak_mib": found.peak_mib,
                    "cpu_ratio": found.cpu_ms / own.cpu_ms,
                    "peak_ratio": found.peak_mib / own.peak_mib,
                    "runs_cpu_ms": runs.clone().map(|run| run.cpu.as_secs_f64() * 1e3).collect::<Vec<_>>(),
                    "runs_peak_mib": runs.map(|run| run.peak_kib as f64 / 1024.0).collect::<Vec<_>>(),
                    "change_ms": change_ms.collect::<Vec<_>>(),
                }));
            }
        }
        let order = |row: &Value| {
            let found = Case::SUITE.iter().position(|case| row["case"] == name(*case));
            found.unwrap_or(Case::SUITE.len())
        };
        list.sort_by_key(order);
        let mut known = earlier["versions"].as_object().cloned().unwrap_or_default();
        let new = versions
            .iter()
            .map(|(name, version)| ((*name).to_owned(), json!(version)));
        known.extend(new);
        let versions = known;
        let all = json!({ "versions": versions, "changes": CHANGES, "medians": list });
        format!("{all:#}\n")
    }
}

const STRING: &str = "writing to a string cannot fail";

/// Seconds with three digits.
fn seconds(time: f64) -> String {
    match time {
        100.0.. => format!("{time:.0} s"),
        10.0.. => format!("{time:.1} s"),
        1.0.. => format!("{time:.2} s"),
        _ => format!("{:.3} s", time),
    }
}

/// A number with commas.
fn thousands(number: usize) -> String {
    let digits = number.to_string();
    let groups = digits.as_bytes().rchunks(3).rev();
    let groups: Vec<&str> = groups
        .map(|group| std::str::from_utf8(group).unwrap_or_default())
        .collect();
    groups.join(",")
}
