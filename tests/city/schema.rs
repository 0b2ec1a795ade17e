//! The JSON Schema of configurations, `configs/schema.json`, against the reader: both know the same keys, words, ranges
//! and defaults.
//!
//! The test walks the schema and writes a small configuration for each place in it. `python/tests/test_schema.py`
//! validates the shipped files.

use crate::config::load_memory;
use logicity::builtin::{self, BuiltinFiles};
use logicity::config::load_tree;
use logicity::diag::{Diagnostic, Sources};
use logicity::yaml::codes;
use serde_json::{Map, Value, json};
use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

/// A step from a value to a part of it.
#[derive(Clone, Debug, PartialEq)]
enum Step {
    Key(String),
    Item,
}

/// A value in a configuration.
struct Place {
    path: Vec<Step>,
    /// The part of the schema that describes the value, without references.
    schema: Value,
}

impl Place {
    /// The path as text, for example `task.ego.concepts[].weight`.
    fn name(&self) -> String {
        let steps = self.path.iter().map(|step| match step {
            Step::Key(key) => format!(".{key}"),
            Step::Item => "[]".to_owned(),
        });
        steps.collect::<String>().trim_start_matches('.').to_owned()
    }

    /// Loads a configuration with this text as value. Returns the faults on its line, and the hash if it loads.
    fn load(&self, text: &str) -> (Vec<Diagnostic>, Option<String>) {
        let json = serde_json::to_string_pretty(&self.configuration(json!("@@"))).unwrap();
        let line = json.lines().position(|line| line.contains("\"@@\"")).unwrap() + 1;
        let (sources, result) = load_memory(&[("main.yaml", &json.replace("\"@@\"", text))]);
        let here = |fault: &Diagnostic| {
            let place = fault.primary.as_ref().map(|label| label.span);
            place.is_some_and(|span| sources.name(span.source) == "main.yaml" && sources.position(span).line == line)
        };
        match result {
            Ok(scenario) => (Vec::new(), Some(scenario.hash)),
            Err(faults) => (faults.into_iter().filter(here).collect(), None),
        }
    }

    fn refuses(&self, text: &str) -> bool {
        self.load(text).0.iter().any(|fault| fault.code == codes::INVALID_VALUE)
    }

    /// Returns a run configuration with the value at this place, and with what the reader needs beside it.
    fn configuration(&self, value: Value) -> Value {
        let mut value = value;
        for (at, step) in self.path.iter().enumerate().rev() {
            let parent = &self.path[..at];
            value = match step {
                Step::Item
                    if ["blocks", "size", "origin"]
                        .iter()
                        .any(|key| parent.last() == Some(&Step::Key((*key).into()))) =>
                {
                    json!([value, 1])
                }
                Step::Item
                    if RANGES
                        .iter()
                        .any(|key| parent.last() == Some(&Step::Key((*key).into()))) =>
                {
                    json!([value, value])
                }
                Step::Item => json!([value]),
                Step::Key(key) => {
                    let mut entries = Map::new();
                    match parent.last() {
                        // Lists do not merge with those of the base.
                        Some(Step::Item) if parent.contains(&Step::Key("ego".into())) => {
                            entries.insert("weight".into(), json!(1));
                        }
                        Some(Step::Item) if parent.contains(&Step::Key("curriculum".into())) => {
                            entries.extend([("until".into(), json!(1)), ("agents".into(), json!(1))]);
                        }
                        Some(Step::Item) if parent.contains(&Step::Key("zones".into())) => {
                            entries.extend(companions(key));
                        }
                        Some(Step::Item) => {
                            entries.insert("priority".into(), json!(1));
                        }
                        // Its buildings are random, so that all keys of a map can be changed.
                        Some(Step::Key(above)) if above == "map" && at == 1 => {
                            entries.insert("base".into(), json!("random-8x8"));
                        }
                        Some(Step::Key(above)) if above == "share" => {
                            entries.insert("facts".into(), json!(1));
                            if key == "radius" {
                                entries.insert("from".into(), json!("cars"));
                            }
                        }
                        Some(Step::Key(above)) if above == "shield" && key != "mode" => {
                            entries.insert("mode".into(), json!("probabilistic"));
                        }
                        Some(Step::Key(above)) if above == SAMPLE_PREDICATE && key == "of" => {
                            entries.insert("concept".into(), json!("taxi"));
                        }
                        Some(Step::Key(above)) if above == SAMPLE_PREDICATE && key == "picture" => {
                            entries.extend([("concept".into(), json!("taxi")), ("of".into(), json!("Car"))]);
                        }
                        Some(Step::Key(above))
                            if above == SAMPLE_PREDICATE && ["near", "within"].contains(&&key[..]) =>
                        {
                            entries.extend([("near".into(), json!("Store")), ("within".into(), json!(8))]);
                        }
                        _ => {}
                    }
                    entries.insert(key.clone(), value);
                    Value::Object(entries)
                }
            };
        }
        if let (Some(entries), Some(Step::Key(first))) = (value.as_object_mut(), self.path.first()) {
            if first == "base" {
                return value;
            }
            entries.insert("base".into(), "expert".into());
        }
        value
    }
}

/// The keys of zones whose values are the first and the last number, or a row and a column.
const RANGES: [&str; 3] = ["rows", "cols", "block"];

/// Returns what a part of a zone needs beside a key.
fn companions(key: &str) -> Vec<(String, Value)> {
    let needed = match key {
        "rows" => vec![("cols", json!([0, 1]))],
        "cols" => vec![("rows", json!([0, 1]))],
        "within" => vec![("block", json!([1, 1]))],
        "near" => vec![("within", json!(8))],
        "sample" => vec![("near", json!("Store")), ("within", json!(8))],
        "seed" => vec![("sample_blocks", json!(1))],
        _ => Vec::new(),
    };
    needed.into_iter().map(|(key, value)| (key.to_owned(), value)).collect()
}

/// The names in samples of mappings with free keys.
const SAMPLE_PREDICATE: &str = "IsSample";
/// A predicate of the base, in samples of sensors.
const KNOWN_PREDICATE: &str = "IsClose";
const SAMPLE_CLAUSE: &str = "S1";

fn schema() -> Value {
    serde_json::from_str(builtin::text("configs/schema.json").unwrap()).unwrap()
}

/// Returns the alternatives of a schema, with references resolved.
fn alternatives(root: &Value, schema: &Value) -> Vec<Value> {
    if let Some(reference) = schema["$ref"].as_str() {
        let target = root.pointer(reference.trim_start_matches('#')).expect("a definition");
        return alternatives(root, target);
    }
    match schema["anyOf"].as_array() {
        Some(list) => list.iter().flat_map(|one| alternatives(root, one)).collect(),
        None => vec![schema.clone()],
    }
}

/// Adds a place and all places inside it.
fn walk(root: &Value, path: &[Step], schema: &Value, found: &mut Vec<Place>) {
    for one in alternatives(root, schema) {
        let below = |key: &str| [path, &[Step::Key(key.to_owned())]].concat();
        for (key, inner) in one["properties"].as_object().into_iter().flatten() {
            walk(root, &below(key), inner, found);
        }
        if one["additionalProperties"].is_object() {
            let sample = match path.last() {
                Some(Step::Key(key)) if key == "define" => SAMPLE_PREDICATE,
                Some(Step::Key(key)) if key == "predicates" => KNOWN_PREDICATE,
                _ => SAMPLE_CLAUSE,
            };
            walk(root, &below(sample), &one["additionalProperties"], found);
        }
        if one["items"].is_object() {
            walk(root, &[path, &[Step::Item]].concat(), &one["items"], found);
        }
        found.push(Place {
            path: path.to_vec(),
            schema: one,
        });
    }
}

fn places() -> Vec<Place> {
    let root = schema();
    let mut found = Vec::new();
    walk(&root, &[], &root["$defs"]["run"], &mut found);
    found
}

/// Returns the keys after `allowed keys: ` in the note of a diagnostic.
fn allowed(fault: &Diagnostic) -> BTreeSet<&str> {
    let list = fault.notes.iter().find_map(|note| note.strip_prefix("allowed keys: "));
    list.expect("a list of keys").split(", ").collect()
}

/// The reader lists its keys when it finds an unknown one.
#[test]
fn the_reader_and_the_schema_know_the_same_keys() {
    let mut mappings = BTreeSet::new();
    for place in places() {
        let Some(properties) = place.schema["properties"].as_object() else {
            continue;
        };
        let mut path = place.path.clone();
        path.push(Step::Key("unknown_key".into()));
        let inside = Place {
            path,
            schema: Value::Null,
        };
        let (faults, _) = inside.load("1");
        let fault = faults.iter().find(|fault| fault.code == codes::UNKNOWN_KEY);
        let fault = fault.unwrap_or_else(|| panic!("no unknown key in `{}`: {faults:?}", place.name()));
        let keys: BTreeSet<&str> = properties.keys().map(String::as_str).collect();
        assert_eq!(allowed(fault), keys, "`{}`", place.name());
        assert_eq!(place.schema["additionalProperties"], false, "`{}`", place.name());
        mappings.insert(fault.message.replace("unknown key `unknown_key` in ", ""));
    }
    // Every mapping that the sources read is in the schema.
    let mut read = BTreeSet::new();
    for folder in ["src/config", "src/predicate"] {
        for entry in fs::read_dir(Path::new(env!("CARGO_MANIFEST_DIR")).join(folder)).unwrap() {
            let text = fs::read_to_string(entry.unwrap().path()).unwrap();
            for call in text.split("Fields::open(").skip(1) {
                let what = call.split(')').next().unwrap().split(", ").nth(1).unwrap();
                match what.trim_matches('"') {
                    "what" => read.extend(["a car", "a pedestrian"].map(str::to_owned)),
                    what => _ = read.insert(what.to_owned()),
                }
            }
        }
    }
    assert!(read.len() > 15);
    assert_eq!(mappings, read);
}

#[test]
fn the_reader_and_the_schema_have_the_same_ranges_and_words() {
    let (mut ranges, mut words) = (0, 0);
    for place in places() {
        let name = place.name();
        let types = match &place.schema["type"] {
            Value::Array(types) => types.clone(),
            one => vec![one.clone()],
        };
        if let (Some(low), Some(high)) = (place.schema["minimum"].as_number(), place.schema["maximum"].as_number()) {
            for bound in [low, high] {
                assert!(!place.refuses(&bound.to_string()), "`{name}` refuses {bound}");
            }
            let outside = match types.contains(&json!("integer")) {
                true => {
                    let [low, high] = [low, high].map(|bound| bound.as_i128().unwrap());
                    assert!(place.refuses("1.5"), "`{name}` accepts 1.5");
                    [(low - 1).to_string(), (high + 1).to_string()]
                }
                false => {
                    let [low, high] = [low, high].map(|bound| bound.as_f64().unwrap());
                    [(low - 0.1).to_string(), (high + 0.1).to_string()]
                }
            };
            for value in outside {
                assert!(place.refuses(&value), "`{name}` accepts {value}");
            }
            ranges += 1;
        } else {
            assert!(
                !types.contains(&json!("integer")) && !types.contains(&json!("number")),
                "`{name}` has no range"
            );
        }
        if let Some(list) = place.schema["enum"].as_array() {
            let list: Vec<&str> = list.iter().filter_map(Value::as_str).collect();
            let (faults, _) = place.load("no-such-word");
            let fault = faults.iter().find(|fault| fault.code == codes::INVALID_VALUE);
            let message = &fault.unwrap_or_else(|| panic!("`{name}` accepts any word")).message;
            let quoted: Vec<&str> = message
                .split(", found ")
                .next()
                .unwrap()
                .split('`')
                .skip(1)
                .step_by(2)
                .collect();
            assert_eq!(quoted, list, "`{name}`");
            words += 1;
        }
        if types.contains(&json!("boolean")) {
            assert!(place.refuses("perhaps") && !place.refuses("true") && !place.refuses("false"));
        }
    }
    assert!(ranges >= 60 && words >= 8, "{ranges} ranges, {words} lists of words");
}

/// The files `common.yaml` have the defaults of keys that a base must give. The reader has the others.
#[test]
fn defaults_of_the_schema_are_those_of_the_reader() {
    let common = |path: &str| {
        let tree = load_tree(&mut Sources::new(), Path::new(path), "configs", &BuiltinFiles);
        tree.unwrap_or_else(|faults| panic!("{faults:?}")).to_json()
    };
    let mut given = common("configs/common.yaml");
    given["task"] = common("configs/tasks/common.yaml");
    let in_common = |place: &Place| {
        let steps = place.path.iter().map(|step| match step {
            Step::Key(key) => format!("/{key}"),
            Step::Item => "/-".to_owned(),
        });
        given.pointer(&steps.collect::<String>()).cloned()
    };
    let (mut shared, mut own) = (0, 0);
    for place in all_with_defaults() {
        let default = place.schema["default"].clone();
        if let Some(value) = in_common(&place) {
            assert_eq!(default, value, "`{}`", place.name());
            shared += 1;
            continue;
        }
        // With the default and without, the configuration is the same.
        let with = place.load(&default.to_string()).1;
        let without = place.load("~").1;
        assert!(with.is_some(), "`{}` refuses its default", place.name());
        assert_eq!(with, without, "`{}`", place.name());
        own += 1;
    }
    assert!(shared > 15 && own > 15, "{shared} and {own} defaults");
    // Conversely, the schema has every default of the files.
    let places = all_with_defaults();
    let mut leaves = Vec::new();
    collect(&given, String::new(), &mut leaves);
    for leaf in leaves {
        let known = places.iter().any(|place| {
            let name = place.name();
            leaf == name || leaf.starts_with(&(name + "."))
        });
        assert!(known, "the schema has no default of `{leaf}`");
    }
}

/// Adds the paths of all scalars and lists.
fn collect(value: &Value, path: String, found: &mut Vec<String>) {
    match value.as_object() {
        Some(entries) => {
            for (key, inner) in entries {
                let below = if path.is_empty() {
                    key.clone()
                } else {
                    format!("{path}.{key}")
                };
                collect(inner, below, found);
            }
        }
        None => found.push(path),
    }
}

/// The places with a default. [`places`] omits those of values with alternatives.
fn all_with_defaults() -> Vec<Place> {
    fn walk_all(root: &Value, path: &[Step], schema: &Value, found: &mut Vec<Place>) {
        if !schema["default"].is_null() {
            found.push(Place {
                path: path.to_vec(),
                schema: schema.clone(),
            });
        }
        for one in alternatives(root, schema) {
            for (key, inner) in one["properties"].as_object().into_iter().flatten() {
                walk_all(root, &[path, &[Step::Key(key.clone())]].concat(), inner, found);
            }
            if one["items"].is_object() {
                walk_all(root, &[path, &[Step::Item]].concat(), &one["items"], found);
            }
        }
    }
    let root = schema();
    let mut found = Vec::new();
    walk_all(&root, &[], &root["$defs"]["run"], &mut found);
    found
}

/// A person who edits a file sees a description of every key.
#[test]
fn every_key_has_a_description() {
    fn check(schema: &Value, path: &str) {
        for (key, inner) in schema["properties"].as_object().into_iter().flatten() {
            let description = inner["description"].as_str().unwrap_or_default();
            assert!(description.ends_with('.'), "`{path}.{key}`: {description:?}");
        }
        let inner = schema.as_object().into_iter().flatten();
        inner.for_each(|(key, inner)| check(inner, &format!("{path}.{key}")));
        let items = schema.as_array().into_iter().flatten();
        items.for_each(|inner| check(inner, path));
    }
    check(&schema(), "");
}
