//! The options of Soufflé with which commands read programs.

use crate::datalog::symbol::WordSize;
use crate::datalog::{InputPolicy, Preprocessing, Workspace};
use clap::builder::{PossibleValuesParser, TypedValueParser as _};
use std::path::PathBuf;

/// Options for every command that reads rule files as programs of their own. Their names are those of Soufflé.
#[derive(clap::Args, Clone, Debug, Default)]
pub struct SouffleOptions {
    /// Define macros in all rule files: `NAME=VALUE`, or `NAME` for the value 1; several stand between spaces
    #[arg(short = 'M', long = "macro", value_name = "NAME=VALUE", value_parser = definition)]
    macros: Vec<String>,
    /// Look for included files here too, after the folder of the including file
    #[arg(short = 'I', long = "include-dir", value_name = "DIR")]
    folders: Vec<PathBuf>,
    /// Follow no directives such as `#define`: they are errors
    #[arg(long, conflicts_with = "macros")]
    no_preprocessor: bool,
    /// Read a program for Soufflé's option `--legacy`: a head takes values of any type with the same base type, and old
    /// forms cause no warning
    #[arg(long)]
    legacy: bool,
    /// The bits of `number`, `unsigned` and `float`: 64 as in a Soufflé built with `SOUFFLE_DOMAIN_64BIT`. Floats, and
    /// numbers that are negative or at least 2^31, then take more memory and time
    #[arg(long, value_name = "BITS", default_value = "32", value_parser = PossibleValuesParser::new(["32", "64"]).map(size))]
    word_size: WordSize,
}

impl SouffleOptions {
    /// Returns an empty workspace that reads programs with these options.
    pub fn workspace(&self, inputs: InputPolicy) -> Workspace {
        let mut workspace = Workspace::new(inputs);
        workspace.set_preprocessing(self.preprocessing());
        workspace.set_legacy(self.legacy);
        workspace.set_word_size(self.word_size);
        workspace
    }

    /// Returns the size of numbers.
    pub fn word_size(&self) -> WordSize {
        self.word_size
    }

    fn preprocessing(&self) -> Preprocessing {
        let mut preprocessing = Preprocessing::default();
        preprocessing.enabled = !self.no_preprocessor;
        preprocessing.folders.clone_from(&self.folders);
        for macros in &self.macros {
            preprocessing
                .define(macros)
                .expect("the parser of the option has checked it");
        }
        preprocessing
    }
}

fn size(bits: String) -> WordSize {
    match bits.as_str() {
        "64" => WordSize::Bits64,
        _ => WordSize::Bits32,
    }
}

fn definition(text: &str) -> Result<String, String> {
    match Preprocessing::default().define(text) {
        Ok(()) => Ok(text.to_owned()),
        Err(word) => Err(format!("`{word}` defines no macro: write `NAME=VALUE` or `NAME`")),
    }
}
