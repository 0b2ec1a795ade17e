//! Configuration files whose keys the caller interprets, such as those of training in Python.

use crate::config::compose::{Composer, Kind, Read};
use crate::config::load::finish;
use crate::diag::{Code, Diagnostic, Sources};
use crate::yaml::codes;
use crate::yaml::{Value, YamlNode};
use serde_json::Value as Json;
use std::path::Path;

/// A configuration file with its `base` merged in.
pub struct Tree(YamlNode);

/// Loads a configuration file without interpreting its keys. A bare name such as `dqn-easy` means `dqn-easy.yaml` in
/// `folder`. Otherwise like [`load_scenario`](super::load_scenario).
///
/// # Errors
/// All faults of all files.
pub fn load_tree(sources: &mut Sources, path: &Path, folder: &str, read: Read<'_>) -> Result<Tree, Vec<Diagnostic>> {
    let mut composer = Composer::new(sources, read);
    let tree = composer.root(path, Kind::of_folder(folder), &[]).map(Tree);
    finish(tree, composer.faults)
}

impl Tree {
    /// Returns the values as JSON. Plain scalars follow the core schema of YAML 1.2; numbers that JSON cannot represent
    /// become text.
    pub fn to_json(&self) -> Json {
        self.0.to_json()
    }

    /// Returns a diagnostic at the value that `path` leads to. The path consists of keys of mappings and positions in
    /// lists, from the root. For an unknown key the place is the key. If the path ends early, the place is its last
    /// existing value.
    pub fn fault(&self, path: &[&str], code: Code, message: impl Into<String>) -> Diagnostic {
        let mut span = self.0.span;
        let mut node = &self.0;
        for step in path {
            let next = match &node.value {
                Value::Map(entries) => entries.iter().find(|(key, _)| key.text == *step).map(|(key, value)| {
                    span = if code == codes::UNKNOWN_KEY {
                        key.span
                    } else {
                        value.span
                    };
                    value
                }),
                Value::List(items) => step.parse().ok().and_then(|at: usize| items.get(at)).inspect(|item| {
                    span = item.span;
                }),
                Value::Scalar { .. } | Value::Absent => None,
            };
            match next {
                Some(next) => node = next,
                None => break,
            }
        }
        Diagnostic::new(code, message).at(span, "")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::files::ReadError;

    fn load(files: &[(&str, &str)]) -> (Sources, Tree) {
        let mut sources = Sources::new();
        let read = |path: &Path| {
            let found = files.iter().find(|(name, _)| Path::new(name) == path);
            found.map(|(_, text)| (*text).to_owned()).ok_or(ReadError::NotFound)
        };
        let tree = load_tree(&mut sources, Path::new("main.yaml"), "configs", &read);
        let tree = tree.unwrap_or_else(|faults| panic!("{faults:?}"));
        (sources, tree)
    }

    #[test]
    fn scalars_follow_the_core_schema() {
        let text =
            "a: [1, -2, 0x1f, 0o17, 3e-5, .5, 2.e1, 1e999, inf, .nan, true, yes, ~, \"1\", +3, 18446744073709551615]";
        let (_, tree) = load(&[("main.yaml", text)]);
        let expected =
            r#"{"a":[1,-2,31,15,0.00003,0.5,20.0,"1e999","inf",".nan",true,"yes",null,"1",3,18446744073709551615]}"#;
        assert_eq!(tree.to_json().to_string(), expected);
    }

    #[test]
    fn faults_are_placed_in_the_file_that_has_the_value() {
        let base = "a: 1\nb:\n  c: 2\n  d: [3, 4]\n";
        let (sources, tree) = load(&[("main.yaml", "base: base.yaml\nb: {c: 5}\n"), ("base.yaml", base)]);
        assert_eq!(tree.to_json().to_string(), r#"{"a":1,"b":{"c":5,"d":[3,4]}}"#);
        let place = |path: &[&str], code| {
            let span = tree.fault(path, code, "").primary.unwrap().span;
            let at = sources.position(span);
            format!("{}:{}:{}", sources.name(span.source), at.line, at.column)
        };
        assert_eq!(place(&["b", "c"], codes::INVALID_VALUE), "main.yaml:2:8");
        assert_eq!(place(&["b", "d", "1"], codes::INVALID_VALUE), "base.yaml:4:10");
        assert_eq!(place(&["b", "d"], codes::UNKNOWN_KEY), "base.yaml:4:3");
        assert_eq!(
            place(&["b", "x"], codes::MISSING_KEY),
            place(&["b"], codes::MISSING_KEY)
        );
    }
}
