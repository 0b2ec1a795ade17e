//! The kinds of input files. A command that gets a file of another kind names both kinds in one message, instead of one
//! fault per line.

use crate::datalog;
use crate::diag::Diagnostic;
use crate::sim::codes;
use crate::yaml;
use std::ffi::OsStr;
use std::path::Path;

/// A kind of file that some command reads.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    Rules,
    Configuration,
    Trace,
    Scenes,
}

impl Kind {
    /// Returns the kind of a file by the begin of its text and by its name; `None` if unknown or empty.
    pub fn of(path: &Path, begin: &str) -> Option<Kind> {
        let begin = begin.trim_start();
        let ending = path.extension().and_then(OsStr::to_str);
        match ending {
            _ if begin.is_empty() => None,
            _ if begin.starts_with("{\"trace\":") => Some(Kind::Trace),
            Some("yaml" | "yml") => Some(Kind::Configuration),
            _ if begin.starts_with('{') => Some(Kind::Scenes),
            Some("dl") => Some(Kind::Rules),
            _ => None,
        }
    }

    fn name(self) -> &'static str {
        match self {
            Kind::Rules => "a rule file",
            Kind::Configuration => "a configuration",
            Kind::Trace => "a trace",
            Kind::Scenes => "a file of scenes",
        }
    }

    /// Returns the commands that read files of this kind.
    fn help(self) -> &'static str {
        match self {
            Kind::Rules => "`check`, `diff`, `query` and the option `--rules` of other commands read rule files",
            Kind::Configuration => {
                "`run`, `check` and the option `--config` of other commands read configurations; name the file after \
                 `rules:` in it to use its rules"
            }
            Kind::Trace => "`explain`, `view`, `induce` and `check --coverage` read traces",
            Kind::Scenes => "`infer` and `induce` read scenes",
        }
    }

    /// Returns the fault of a file of another kind; `None` if its kind is this one or unknown. A trace with a damaged
    /// header is of unknown kind.
    pub fn mismatch(self, path: &Path, begin: &str) -> Option<Diagnostic> {
        let code = match self {
            Kind::Rules => datalog::codes::SYNTAX,
            Kind::Configuration => yaml::codes::INVALID_VALUE,
            Kind::Trace => codes::INVALID_TRACE,
            Kind::Scenes => codes::INVALID_SCENE,
        };
        let found = Kind::of(path, begin).filter(|found| *found != self)?;
        let found_name = match (self, found) {
            (Kind::Trace, Kind::Scenes) => return None,
            (_, Kind::Scenes) => "a JSON file",
            _ => found.name(),
        };
        let message = format!("`{}` is {found_name}, not {}", path.display(), self.name());
        Some(Diagnostic::new(code, message).help(found.help()))
    }
}
