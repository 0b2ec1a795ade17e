//! `logicity schema`: prints the JSON Schema of configuration files.

use crate::builtin;
use crate::cli::{Failure, one_of};
use serde_json::Value;
use std::io::{self, Write};

/// The path of the schema among the built-in files.
const SCHEMA: &str = "configs/schema.json";

/// What a file holds; the name is that of the definition in the schema.
#[derive(Clone, Copy, PartialEq, Eq)]
struct Part(&'static str);

const PARTS: [Part; 5] = [
    Part("run"),
    Part("map"),
    Part("agents"),
    Part("predicates"),
    Part("task"),
];

#[derive(clap::Args)]
pub struct Arguments {
    /// What the files hold: a run configuration, or a part of one
    #[arg(value_parser = one_of(&PARTS, |part| part.0), default_value = "run")]
    part: Part,
}

pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    let text = builtin::text(SCHEMA).expect("a built-in file");
    let mut schema: Value = serde_json::from_str(text).expect("JSON, as the tests check");
    schema["$ref"] = format!("#/$defs/{}", arguments.part.0).into();
    let title = schema["$defs"][arguments.part.0]["title"].clone();
    schema["title"] = title;
    writeln!(io::stdout(), "{schema:#}")?;
    Ok(())
}
