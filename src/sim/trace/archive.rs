//! The configuration and the rule files in the header of a trace.
//!
//! A trace is self-contained: a replay needs no file that the header names, and opens none. The names hold no folder of
//! the machine that made the trace: built-in files keep their names, any other file has its name without folders.
// Decision: docs/decisions/safety.md#d066

use crate::config::{Scenario, load_scenario};
use crate::datalog;
use crate::datalog::ast::Item;
use crate::diag::{Diagnostic, SourceId, Sources};
use crate::files::{ReadError, ReadFile, builtin_path, normalize, portable_name};
use crate::sim::codes;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::path::{Path, PathBuf};

/// A rule file of a run.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ArchivedFile {
    /// The name, without folders unless the file is built in.
    pub name: String,
    /// The text. Includes that need a folder name the archived file instead.
    pub text: String,
}

/// The configuration and the rule files of a run.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Archive {
    /// The configuration with all its parts, without references to other files except `rules`.
    pub configuration: serde_json::Value,
    /// The rule file, then the files it includes.
    pub rule_files: Vec<ArchivedFile>,
}

impl Archive {
    /// Collects the configuration and the rules of a run. `rule_files` is the rule file, then the files it includes.
    pub fn new(scenario: &Scenario, sources: &Sources, rule_files: &[SourceId]) -> Archive {
        let paths: Vec<&str> = rule_files.iter().map(|&id| sources.name(id)).collect();
        let names = portable_names(&paths);
        let texts = rule_files.iter().zip(&names).map(|(&id, name)| ArchivedFile {
            name: name.clone(),
            text: with_includes(sources, id, &paths, &names),
        });
        let rule_files: Vec<ArchivedFile> = texts.collect();
        let mut configuration = scenario.composed.clone();
        configuration["rules"] = names.first().map_or("", String::as_str).into();
        Archive {
            configuration,
            rule_files,
        }
    }

    /// Loads the configuration, which has the name `name`, without its rules.
    ///
    /// # Errors
    /// As [`load_scenario`].
    pub fn scenario(&self, sources: &mut Sources, name: &str) -> Result<Scenario, Vec<Diagnostic>> {
        let name = format!("{name}.yaml");
        let text = self.configuration.to_string();
        let read = |path: &Path| match path == Path::new(&name) {
            true => Ok(text.clone()),
            false => self.read(path),
        };
        load_scenario(sources, Path::new(&name), &read)
    }

    /// Compares the configuration and the rules with the hashes that the header of their trace has. A configuration
    /// that cannot be loaded is left to its loader, which names its faults.
    ///
    /// # Errors
    /// `trace-mismatch`, without a source position.
    pub(super) fn verify(&self, name: &str, config_hash: &str, rules_hash: &str) -> Result<(), Diagnostic> {
        let loaded = self.scenario(&mut Sources::new(), name);
        let configuration = loaded.map_or_else(|_| config_hash.to_owned(), |scenario| scenario.hash);
        let rules = hash(self.rule_files.iter().map(|file| file.text.as_str()));
        for (what, found, expected) in [
            ("configuration differs from that", configuration.as_str(), config_hash),
            ("rules differ from those", &rules, rules_hash),
        ] {
            if found != expected {
                let short = |hash: &str| hash.chars().take(12).collect::<String>();
                let message = format!("the {what} of the run: the trace was edited, or it is damaged");
                let (found, expected) = (short(found), short(expected));
                return Err(Diagnostic::new(codes::TRACE_MISMATCH, message)
                    .note(format!(
                        "the hash of its content is {found}..., but its header has {expected}..."
                    ))
                    .help("run again; if another version of logicity wrote the trace, use that version"));
            }
        }
        Ok(())
    }
}

/// Returns the SHA-256 hash of the sources of rule files, in order, in hexadecimal: of those that an [`Archive`] would
/// have, so that it does not depend on the folders of the files.
pub fn hash_sources(sources: &Sources, files: &[SourceId]) -> String {
    let paths: Vec<&str> = files.iter().map(|&id| sources.name(id)).collect();
    let names = portable_names(&paths);
    let texts: Vec<String> = (files.iter())
        .map(|&id| with_includes(sources, id, &paths, &names))
        .collect();
    hash(texts.iter().map(String::as_str))
}

fn hash<'a>(texts: impl Iterator<Item = &'a str>) -> String {
    let mut hash = Sha256::new();
    for text in texts {
        hash.update((text.len() as u64).to_le_bytes());
        hash.update(text);
    }
    format!("{:x}", hash.finalize())
}

impl ReadFile for Archive {
    /// Returns the source of a rule file. Reads nothing from disk.
    fn read(&self, path: &Path) -> Result<String, ReadError> {
        let path = normalize(path);
        let found = self.rule_files.iter().find(|file| Path::new(&file.name) == path);
        found.map(|file| file.text.clone()).ok_or(ReadError::NotFound)
    }
}

/// Returns a unique [`portable_name`] for each path.
fn portable_names(paths: &[&str]) -> Vec<String> {
    let mut names: Vec<String> = Vec::new();
    for path in paths {
        let own = portable_name(path);
        let numbered = (2..).map(|number| format!("{number}-{own}"));
        let mut free = std::iter::once(own.clone())
            .chain(numbered)
            .filter(|name| !names.contains(name));
        let name = free.next().expect("finitely many names are taken");
        names.push(name);
    }
    names
}

/// Returns the position of the file that an include in the file `from` reaches, as [`datalog::load`] finds it.
fn included<S: AsRef<str>>(names: &[S], from: &str, written: &str) -> Option<usize> {
    let beside = Path::new(from).parent().unwrap_or(Path::new("")).join(written);
    let builtin = builtin_path(written);
    let position = |wanted: PathBuf| {
        let wanted = normalize(&wanted);
        names
            .iter()
            .position(|name| normalize(Path::new(name.as_ref())) == wanted)
    };
    position(beside).or_else(|| position(builtin))
}

/// Returns the source of a rule file. Replaces the path of each include that would not reach its file under the new
/// names.
fn with_includes(sources: &Sources, id: SourceId, paths: &[&str], names: &[String]) -> String {
    let mut text = sources.text(id).to_owned();
    // Parsing takes longer than this search.
    if !text.contains("include") {
        return text;
    }
    let Some(own) = paths.iter().position(|path| *path == sources.name(id)) else {
        return text;
    };
    let mut includes: Vec<_> = (datalog::parse(sources, id).file.items.into_iter())
        .filter_map(|item| match item {
            Item::Include(include) => Some(include),
            _ => None,
        })
        .collect();
    // From the end, so that the earlier places stay valid.
    includes.sort_by_key(|include| std::cmp::Reverse(include.place.0.start));
    for include in includes {
        let target = included(paths, paths[own], &include.path);
        if let Some(target) = target
            && included(names, &names[own], &include.path) != Some(target)
        {
            text.replace_range(include.place.0.range(), &format!("\"{}\"", names[target]));
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rule_files_have_names_without_folders_and_includes_reach_them() {
        let files = [
            (
                "/home/me/main.dl",
                ".include \"lib/a.dl\" // own\n.include \"/home/me/lib/b/a.dl\"\nA(1).\n",
            ),
            (
                "/home/me/lib/a.dl",
                ".include \"../lib/c.dl\"\n.include \"vocabulary.dl\"\n",
            ),
            ("/home/me/lib/c.dl", ""),
            ("<builtin>/vocabulary.dl", ".include \"types.dl\"\n"),
            ("<builtin>/types.dl", "// .include \"/home\"\n"),
            (
                "/home/me/lib/b/a.dl",
                ".include \"vocabulary.dl\"\n.include \"missing.dl\"\n",
            ),
            ("/home/me/lib/b/vocabulary.dl", ""),
        ];
        let mut sources = Sources::new();
        let ids: Vec<SourceId> = files.iter().map(|(name, text)| sources.add(*name, *text)).collect();
        let paths: Vec<&str> = files.iter().map(|(name, _)| *name).collect();
        let names = portable_names(&paths);
        let expected = [
            "main.dl",
            "a.dl",
            "c.dl",
            "<builtin>/vocabulary.dl",
            "<builtin>/types.dl",
            "2-a.dl",
            "vocabulary.dl",
        ];
        assert_eq!(names, expected);
        let texts: Vec<String> = (ids.iter())
            .map(|&id| with_includes(&sources, id, &paths, &names))
            .collect();
        let expected = [
            ".include \"a.dl\" // own\n.include \"2-a.dl\"\nA(1).\n",
            ".include \"c.dl\"\n.include \"<builtin>/vocabulary.dl\"\n",
            "",
            files[3].1,
            files[4].1,
            ".include \"vocabulary.dl\"\n.include \"missing.dl\"\n",
            "",
        ];
        assert_eq!(texts, expected);
        // Every include reaches the same file as before.
        for (file, text) in files.iter().zip(&texts) {
            let position = paths.iter().position(|path| *path == file.0).unwrap();
            let written = |text: &str| -> Vec<String> {
                let parts = text.split('"').skip(1).step_by(2);
                parts.map(str::to_owned).collect()
            };
            for (before, after) in written(file.1).iter().zip(written(text)) {
                let reached = included(&paths, file.0, before);
                assert_eq!(included(&names, &names[position], &after), reached, "{before} {after}");
            }
        }
    }
}
