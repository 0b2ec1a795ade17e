//! The options `--max-rows`, `--max-steps` and `--max-memory`, and the advice to raise them.

use crate::cli::memory;
use crate::cli::values::{count_of, memory_size};
use crate::datalog::Limits;
use crate::diag::{Diagnostic, Limit};
use clap::ArgMatches;

/// Resource limits of an evaluation, for every command that evaluates rules of the user.
#[derive(clap::Args, Default)]
pub struct LimitOptions {
    /// Fail if the rules derive more than COUNT rows; suffixes K, M, G and T are powers of 1000 [default: 100M for
    /// `query`; 1M for `repl`; 10M for each scene, tick or task; for each tick of a trace 100K plus 100 for each pair of
    /// agents, or 100M for rules that `--rules` names]
    #[arg(long, value_name = "COUNT", value_parser = count_of::<usize>)]
    pub max_rows: Option<usize>,
    /// Fail if the evaluation scans more than COUNT rows, with the same suffixes [default: 100G for `query` and `repl`;
    /// 1G for each scene, tick or task; for each tick of a trace 100M plus 1K for each row of the default of `--max-rows`]
    #[arg(long, value_name = "COUNT", value_parser = count_of::<u64>)]
    pub max_steps: Option<u64>,
    #[command(flatten)]
    pub memory: MemoryOption,
}

/// The limit of memory, for every command that reads files.
#[derive(clap::Args, Clone, Copy, Default)]
pub struct MemoryOption {
    /// Fail if input, rows, indexes, symbols and buffers need more than SIZE, in MiB or with a suffix: K, M, G, T or KiB,
    /// MiB, GiB, TiB (powers of 1024). Limits of the system (`ulimit -v`, control groups) lower it [default: 4096]
    #[arg(long, value_name = "SIZE", value_parser = memory_size)]
    pub max_memory: Option<u64>,
}

impl MemoryOption {
    /// Returns the bytes that the command may use, with `usual` for an unset option.
    pub fn bytes(self, usual: u64) -> u64 {
        let system = memory::system_limit().map_or(u64::MAX, |limit| limit.bytes);
        self.max_memory.unwrap_or(usual).min(system)
    }
}

impl LimitOptions {
    /// Returns these limits, with `usual` for unset ones.
    pub fn limits(&self, usual: Limits) -> Limits {
        Limits {
            rows: self.max_rows.unwrap_or(usual.rows),
            steps: self.max_steps.unwrap_or(usual.steps),
            bytes: self.memory.bytes(usual.bytes),
        }
    }
}

/// Returns the memory that a command may use, in bytes.
pub fn memory_limit(matches: &ArgMatches) -> u64 {
    if let Some((_, inner)) = matches.subcommand() {
        return memory_limit(inner);
    }
    // A command without the option has the usual limit.
    let max_memory = matches.try_get_one::<u64>("max_memory").ok().flatten().copied();
    MemoryOption { max_memory }.bytes(Limits::default().bytes)
}

/// Adds to diagnostics of exceeded limits how to raise them: by an option, or in the system if its limit is the lower
/// one.
pub fn advised(diagnostics: &[Diagnostic]) -> Vec<Diagnostic> {
    let raise = |limit: Limit| {
        let option = match limit {
            Limit::Rows => "--max-rows",
            Limit::Steps => "--max-steps",
            Limit::Memory(bytes) => match memory::system_limit().filter(|system| system.bytes == bytes) {
                Some(system) => return format!("{} leaves no more; raise that limit", system.origin),
                None => "--max-memory",
            },
        };
        format!("raise the limit with `{option}`")
    };
    let advised = diagnostics.iter().map(|fault| match fault.limit {
        Some(limit) => fault.clone().help(raise(limit)),
        None => fault.clone(),
    });
    advised.collect()
}
