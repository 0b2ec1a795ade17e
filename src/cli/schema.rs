//! `logicity schema`: prints the JSON Schema of configuration files, training configurations and experiments.

use crate::builtin;
use crate::cli::failure::Failure;
use crate::cli::terminal;
use crate::cli::values::one_of;
use serde_json::Value;
use std::io::Write;

/// The paths of the schemas among the built-in files.
const SCHEMA: &str = "configs/schema.json";
const TRAINING_SCHEMA: &str = "configs/baselines/schema.json";
const EXPERIMENT_SCHEMA: &str = "configs/experiments/schema.json";

/// The content of a file; the name is that of the definition in [`SCHEMA`], unless the content has its own schema.
#[derive(Clone, Copy, PartialEq, Eq)]
struct SchemaPart(&'static str);

const TRAINING: SchemaPart = SchemaPart("training");
const EXPERIMENT: SchemaPart = SchemaPart("experiment");
const PARTS: [SchemaPart; 7] = [
    SchemaPart("run"),
    SchemaPart("map"),
    SchemaPart("agents"),
    SchemaPart("predicates"),
    SchemaPart("task"),
    TRAINING,
    EXPERIMENT,
];

#[derive(clap::Args)]
pub struct Arguments {
    /// Content of the files: a run configuration, a part of one, a training configuration, or an experiment
    #[arg(value_parser = one_of(&PARTS, |part| part.0), default_value = "run")]
    part: SchemaPart,
}

pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    let own = match arguments.part {
        TRAINING => Some(TRAINING_SCHEMA),
        EXPERIMENT => Some(EXPERIMENT_SCHEMA),
        _ => None,
    };
    if let Some(path) = own {
        let text = builtin::text(path).expect("a built-in file");
        write!(terminal::data(), "{text}")?;
        return Ok(());
    }
    let text = builtin::text(SCHEMA).expect("a built-in file");
    let mut schema: Value = serde_json::from_str(text).expect("JSON, as the tests check");
    schema["$ref"] = format!("#/$defs/{}", arguments.part.0).into();
    let title = schema["$defs"][arguments.part.0]["title"].clone();
    schema["title"] = title;
    writeln!(terminal::data(), "{schema:#}")?;
    Ok(())
}
