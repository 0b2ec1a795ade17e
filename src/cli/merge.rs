//! `logicity merge`: joins the shards of a data set.

use crate::cli::failure::Failure;
use crate::cli::inputs::read;
use crate::cli::limits::LimitOptions;
use crate::cli::outputs::ForceOption;
use crate::cli::{episodes, questions, vap};
use crate::diag::Sources;
use crate::task::questions::QUESTION_SHARDS;
use crate::task::shard;
use crate::task::spf::EPISODE_SHARDS;
use std::path::PathBuf;

#[derive(clap::Args)]
pub struct Arguments {
    /// All shards, in any order: the files of `logicity episodes make` or `logicity questions`, or the folders of
    /// `logicity vap make`, made with `--shard`
    #[arg(required = true)]
    shards: Vec<PathBuf>,
    /// Write the joined episodes or questions to FILE, `-` means standard output; or the joined worlds to a folder
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    #[command(flatten)]
    force: ForceOption,
    #[command(flatten)]
    limits: LimitOptions,
}

pub fn run(arguments: &Arguments, sources: &mut Sources) -> Result<(), Failure> {
    let Arguments {
        shards,
        output,
        force,
        limits,
    } = arguments;
    let folders = shards.iter().filter(|path| path.is_dir()).count();
    if folders == shards.len() {
        return vap::merge(shards, output, force, sources);
    }
    if folders > 0 {
        let message = "some of the shards are folders, and some are files: join those of one data set";
        return Err(shard::invalid(message).into());
    }
    let mut found = Vec::new();
    for path in shards {
        found.push(sources.add(path.display().to_string(), read(path)?));
    }
    let mut kinds = Vec::new();
    for &source in &found {
        kinds.push(shard::kind_of(sources.text(source), source)?);
    }
    match kinds[0].as_str() {
        _ if kinds.iter().any(|kind| *kind != kinds[0]) => {
            let message = "some of the shards are of episodes, and some of questions: join those of one data set";
            Err(shard::invalid(message).into())
        }
        EPISODE_SHARDS => episodes::merge(&found, output, (force, limits), sources),
        QUESTION_SHARDS => questions::merge(&found, output, (force, limits), sources),
        other => Err(shard::invalid(format!("unknown kind of shard `{other}`")).into()),
    }
}
