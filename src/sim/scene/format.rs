//! The scene format: one state of a city, or of abstract entities, as a line of JSON.
//! `docs/reference/scenes.md` documents it.

use crate::city::{Action, AgentKind, KindId, KindTable};
use crate::city::{Cell, CityMap, Heading};
use crate::datalog::Value;
use crate::diag::{self, Diagnostic, Faults, SourceId, Sources, Span, counted, did_you_mean, json_error, listed};
use crate::predicate::{Progress, Unit, Words};
use crate::sim::codes;
use crate::sim::scene::plain::{NameIndex, PlainFacts, PlainScene, plain_rows, plain_scene};
use crate::sim::tick::ground::MAX_ENTITIES;
use indexmap::IndexMap;
use indexmap::map::Entry;
use serde::Deserialize;
use serde::de::{self, Deserializer, MapAccess, Visitor};
use serde_json::error::Category;
use serde_json::value::RawValue;
use std::collections::HashMap;
use std::fmt;

/// A scene.
#[derive(Clone, Debug)]
pub enum Scene {
    /// Agents on a map; base facts are computed.
    Geometric(GeometricScene),
    /// Entities and their base facts.
    Symbolic(SymbolicScene),
}

/// A scene of agents on a map.
#[derive(Clone, Debug)]
pub struct GeometricScene {
    /// The map.
    pub map: MapName,
    /// The source position of its name.
    pub map_span: Span,
    /// The agents in list order.
    pub agents: Vec<SceneAgent>,
    /// The egos: positions in `agents`.
    pub egos: Vec<usize>,
    /// Distinguishes the random draws of one seed, as ticks do in a run.
    pub tick: u64,
    /// Predicates whose rows the scene states, so that they are not computed.
    pub given: Vec<GivenPredicate>,
    /// The actions that agents took, by their positions in `agents`: labels for learning.
    pub actions: Vec<(usize, Action)>,
}

/// How a scene names its map.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub enum MapName {
    /// The name of a built-in map, or the path of a map file.
    Map(String),
    /// The name of a built-in configuration, or the path of a configuration: the map of that configuration.
    Config(String),
}

impl fmt::Display for MapName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            MapName::Map(name) => write!(f, "map `{name}`"),
            MapName::Config(name) => write!(f, "map of the configuration `{name}`"),
        }
    }
}

/// An agent of a scene.
#[derive(Clone, Debug)]
pub struct SceneAgent {
    /// The name.
    pub id: String,
    /// The kind.
    pub kind: AgentKind,
    /// The names of the concepts.
    pub concepts: Vec<String>,
    /// The priority.
    pub priority: i32,
    /// The cell.
    pub at: Cell,
    /// The direction of the last move.
    pub heading: Option<Heading>,
    /// What only quantities read.
    pub progress: Progress,
    /// The source position of the agent.
    pub span: Span,
}

/// The rows of a predicate, as stated in a scene.
#[derive(Clone, Debug)]
pub struct GivenPredicate {
    /// The position of the predicate in [`Terms::predicates`].
    pub predicate: usize,
    /// Rows of positions in the scene's agents or entities, with 0 in columns that the predicate does not have; sorted,
    /// each once.
    pub rows: Vec<[u32; 2]>,
    /// The value of each row, if the predicate is a quantity. For a heading, its position in [`Heading::ALL`].
    pub values: Vec<Value>,
    /// The rows that hold only with a probability, which is above 0 and below 1.
    pub uncertain: Vec<([u32; 2], f64)>,
}

/// A scene of entities and facts.
#[derive(Clone, Debug)]
pub struct SymbolicScene {
    /// The names of the entities, in order.
    pub entities: Vec<String>,
    /// The position of the ego in `entities`.
    pub ego: usize,
    /// The true facts.
    pub facts: Vec<GivenPredicate>,
    /// The actions that entities took, by their positions in `entities`: labels for learning.
    pub actions: Vec<(usize, Action)>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawGeometric<'a> {
    #[serde(borrow)]
    map: &'a RawValue,
    #[serde(borrow)]
    agents: Vec<&'a RawValue>,
    #[serde(borrow)]
    egos: Option<Vec<&'a RawValue>>,
    #[serde(borrow, default)]
    given: Entries<'a>,
    #[serde(default)]
    tick: u64,
    #[serde(borrow, default)]
    actions: Entries<'a>,
}

/// A map of a configuration.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawConfigMap<'a> {
    #[serde(borrow)]
    config: &'a RawValue,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawAgent<'a> {
    id: String,
    #[serde(rename = "type", borrow)]
    kind: &'a RawValue,
    #[serde(borrow)]
    at: &'a RawValue,
    #[serde(borrow)]
    heading: Option<&'a RawValue>,
    #[serde(borrow, default)]
    concepts: Vec<&'a RawValue>,
    #[serde(borrow)]
    priority: Option<&'a RawValue>,
    #[serde(borrow)]
    speed: Option<&'a RawValue>,
    #[serde(borrow)]
    waited: Option<&'a RawValue>,
    #[serde(borrow)]
    remaining: Option<&'a RawValue>,
    #[serde(borrow)]
    exit: Option<&'a RawValue>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawUncertain<'a> {
    #[serde(borrow)]
    row: &'a RawValue,
    #[serde(borrow)]
    probability: &'a RawValue,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawSymbolic<'a> {
    #[serde(borrow)]
    entities: Vec<&'a RawValue>,
    #[serde(borrow)]
    ego: &'a RawValue,
    #[serde(borrow, default)]
    facts: Entries<'a>,
    #[serde(borrow, default)]
    actions: Entries<'a>,
    /// Why a learner asked for the scene; has no effect.
    #[serde(default, rename = "reason")]
    _reason: String,
}

/// A JSON object in source order with unparsed values.
#[derive(Default)]
struct Entries<'a>(IndexMap<String, &'a RawValue>);

impl<'de: 'a, 'a> Deserialize<'de> for Entries<'a> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Visit;
        impl<'de> Visitor<'de> for Visit {
            type Value = Entries<'de>;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("an object from predicate names to lists of rows")
            }

            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Self::Value, A::Error> {
                let mut entries: IndexMap<String, &RawValue> = IndexMap::new();
                while let Some((key, value)) = map.next_entry::<String, &RawValue>()? {
                    match entries.entry(key) {
                        Entry::Vacant(entry) => drop(entry.insert(value)),
                        Entry::Occupied(entry) => {
                            return Err(de::Error::custom(format!("`{}` is given twice", entry.key())));
                        }
                    }
                }
                Ok(Entries(entries))
            }
        }
        deserializer.deserialize_map(Visit)
    }
}

/// The predicates and concepts that a scene may use.
pub struct Terms<'a> {
    /// Base predicates with the number of agents in a row and, for a quantity, the type of the value.
    pub predicates: Vec<(&'a str, usize, Option<Unit>)>,
    /// Concepts with the kind of agent that carries them.
    pub concepts: Vec<(AgentKind, &'a str)>,
    /// The kinds of agents.
    pub kinds: &'a KindTable,
}

/// Parses a scene, or a list of scenes, which are successive ticks. The result is not empty.
///
/// # Errors
/// All errors of the scenes: `invalid-scene` at their positions, `limit-exceeded` for more than [`MAX_ENTITIES`] agents
/// or entities.
pub fn parse_scenes(sources: &Sources, source: SourceId, terms: &Terms<'_>) -> Result<Vec<Scene>, Vec<Diagnostic>> {
    let reader = Reader {
        source,
        text: sources.text(source),
        terms,
    };
    (reader.scenes()).map_err(|faults| faults.into_iter().collect::<Faults>().finish())
}

/// A parsed value, or all errors in it.
type Read<T> = Result<T, Vec<Diagnostic>>;

/// The maximum number of names that a suggestion searches.
const SEARCHED: usize = 1000;

/// Collects all values, or the errors of all of them.
fn all<T>(results: impl Iterator<Item = Read<T>>) -> Read<Vec<T>> {
    let mut faults = Vec::new();
    let values: Vec<T> = results.filter_map(|result| keep(&mut faults, result)).collect();
    if faults.is_empty() { Ok(values) } else { Err(faults) }
}

/// Returns the position at which the JSON value begins that ends with the text.
fn value_start(text: &str) -> usize {
    match text.strip_suffix('"') {
        Some(inside) => inside.rfind('"').unwrap_or(inside.len()),
        None => {
            let is_scalar = |char: char| char.is_ascii_alphanumeric() || matches!(char, '.' | '-' | '+');
            let start = text.trim_end_matches(is_scalar).len();
            text.floor_char_boundary(start.min(text.len().saturating_sub(1)))
        }
    }
}

/// Returns the value, or adds its errors to `faults`.
fn keep<T>(faults: &mut Vec<Diagnostic>, result: Read<T>) -> Option<T> {
    result.map_err(|more| faults.extend(more)).ok()
}

struct Reader<'a> {
    source: SourceId,
    text: &'a str,
    terms: &'a Terms<'a>,
}

impl<'a> Reader<'a> {
    fn scenes(&self) -> Read<Vec<Scene>> {
        // Most scenes are symbolic: one pass. Other scenes and errors take more.
        if let Some(plain) = plain_scene(self.text, &self.terms.predicates)
            && let Ok(scene) = self.plain(plain)
        {
            return Ok(vec![Scene::Symbolic(scene)]);
        }
        let whole: &RawValue = self.read(self.text, 0)?;
        if !whole.get().starts_with('[') {
            return Ok(vec![self.scene(whole)?]);
        }
        let list: Vec<&RawValue> = self.value(whole)?;
        if list.is_empty() {
            let label = "expected the scenes of successive ticks, the present one last";
            return Err(vec![self.fault(whole, "a list without scenes".into(), label)]);
        }
        all(list.into_iter().map(|scene| self.scene(scene)))
    }

    fn scene(&self, whole: &'a RawValue) -> Read<Scene> {
        if !whole.get().starts_with('{') {
            return Err(vec![self.fault(whole, "a scene is a JSON object".into(), FORMS)]);
        }
        let Entries(keys) = self.value(whole)?;
        if keys.contains_key("entities") {
            let raw = self.keyed(whole, "a scene of entities", &SYMBOLIC_KEYS)?;
            self.symbolic(raw).map(Scene::Symbolic)
        } else if keys.contains_key("agents") || keys.contains_key("map") {
            self.geometric(whole).map(Scene::Geometric)
        } else {
            let known = |key: &str| SYMBOLIC_KEYS.contains(&key) || GEOMETRIC_KEYS.contains(&key);
            let misspelled = keys.iter().filter(|(key, _)| !known(key)).find_map(|(key, raw)| {
                let near = did_you_mean(key, ["entities", "agents", "map"])?;
                let fault = Diagnostic::new(codes::INVALID_SCENE, format!("unknown key `{key}` in a scene"));
                Some(fault.at(self.key_span(raw), "").help(format!("did you mean `{near}`?")))
            });
            let none = || self.fault(whole, "a scene without agents or entities".into(), FORMS);
            Err(vec![misspelled.unwrap_or_else(none)])
        }
    }

    /// Parses an object with these keys. Reports all others instead of the first.
    fn keyed<T: Deserialize<'a>>(&self, raw: &'a RawValue, what: &str, keys: &[&str]) -> Read<T> {
        self.value(raw).map_err(|faults| {
            let Ok(Entries(entries)) = self.value(raw) else {
                return faults;
            };
            let unknown = entries.iter().filter(|(key, _)| !keys.contains(&key.as_str()));
            let unknown = unknown.take(diag::MAX_FAULTS + 1).map(|(key, raw)| {
                let message = format!("unknown key `{key}` in {what}");
                let fault = Diagnostic::new(codes::INVALID_SCENE, message).at(self.key_span(raw), "");
                match did_you_mean(key, keys.iter().copied()) {
                    Some(near) => fault.help(format!("did you mean `{near}`?")),
                    None => fault.note(format!("allowed keys: {}", keys.join(", "))),
                }
            });
            let unknown: Vec<Diagnostic> = unknown.collect();
            if unknown.is_empty() { faults } else { unknown }
        })
    }

    fn geometric(&self, whole: &'a RawValue) -> Read<GeometricScene> {
        let raw: RawGeometric<'a> = self.keyed(whole, "a scene of agents", &GEOMETRIC_KEYS)?;
        self.bounded(&raw.agents, "agents")?;
        let mut faults = Vec::new();
        let map = keep(&mut faults, self.map(raw.map));
        let agents = keep(&mut faults, all(raw.agents.iter().map(|agent| self.agent(agent))));
        let (Some(map), Some(agents)) = (map, agents) else {
            return Err(faults);
        };
        let names = self.names(agents.iter().map(|agent| (agent.id.as_str(), agent.span)))?;
        let egos = match &raw.egos {
            None => Some((0..agents.len()).collect()),
            Some(egos) => keep(&mut faults, self.egos(egos, &names)),
        };
        let given = keep(&mut faults, self.rows(raw.given, &names, "agent"));
        let actions = keep(&mut faults, self.actions(raw.actions, &names, "agent"));
        match (egos, given, actions) {
            (Some(egos), Some(given), Some(actions)) => Ok(GeometricScene {
                map,
                map_span: self.span(raw.map),
                tick: raw.tick,
                agents,
                egos,
                given,
                actions,
            }),
            _ => Err(faults),
        }
    }

    /// Returns the positions of the agents that are egos.
    fn egos(&self, written: &[&'a RawValue], names: &NameIndex<'_>) -> Read<Vec<usize>> {
        let egos = all(written.iter().map(|ego| self.named(ego, names, "agent")))?;
        let mut first: HashMap<usize, &RawValue> = HashMap::new();
        for (ego, raw) in egos.iter().zip(written) {
            if let Some(first) = first.insert(*ego, raw) {
                let fault = self.fault(raw, "an ego is given twice".to_owned(), "again here");
                return Err(vec![fault.also(self.span(first), "first here")]);
            }
        }
        Ok(egos)
    }

    /// Parses the name of a map: a text, or `{"config": text}`. A text is the name of a built-in file or the path of a
    /// YAML file. Rejects other paths, so that a scene opens no other files.
    fn map(&self, raw: &'a RawValue) -> Read<MapName> {
        let (written, what) = if raw.get().starts_with('{') {
            (self.value::<RawConfigMap<'a>>(raw)?.config, "configuration")
        } else {
            (raw, "map")
        };
        let name: String = self.value(written)?;
        let is_name = name.chars().all(|c| c.is_alphanumeric() || c == '-' || c == '_');
        if is_name || name.ends_with(".yaml") || name.ends_with(".yml") {
            return Ok(match what {
                "map" => MapName::Map(name),
                _ => MapName::Config(name),
            });
        }
        let label = format!("expected the name of a built-in {what} or the path of a file ending in .yaml");
        Err(vec![self.fault(written, format!("not a {what}"), &label)])
    }

    fn agent(&self, raw: &'a RawValue) -> Read<SceneAgent> {
        let agent: RawAgent<'a> = self.keyed(raw, "an agent", &AGENT_KEYS)?;
        let mut faults = Vec::new();
        let named = keep(&mut faults, self.kind(agent.kind));
        let kind = named.map(|kind| self.terms.kinds.base(kind));
        // Traces give the name of a kind of the configuration as the first concept.
        let as_concept = |named: KindId| {
            let name: String = serde_json::from_str(agent.concepts.first()?.get()).ok()?;
            let own = self.terms.kinds.of(kind?, &[name]);
            (named.is_standard() && !own.is_standard()).then_some(own)
        };
        let own = named.and_then(as_concept);
        let others = &agent.concepts[usize::from(own.is_some())..];
        let named = own.or(named);
        let [heading, exit] =
            [agent.heading, agent.exit].map(|raw| keep(&mut faults, raw.map(|raw| self.heading(raw)).transpose()));
        let at = keep(&mut faults, self.value::<[i32; 2]>(agent.at));
        let priority = keep(&mut faults, agent.priority.map_or(Ok(0), |raw| self.value(raw)));
        let mut count = |raw: Option<&'a RawValue>| keep(&mut faults, raw.map_or(Ok(0), |raw| self.value::<u32>(raw)));
        let [speed, waited, remaining] = [agent.speed, agent.waited, agent.remaining].map(&mut count);
        let concepts = kind.and_then(|kind| {
            let concepts = others.iter().map(|raw| self.concept(raw, kind));
            let concepts: Vec<String> = keep(&mut faults, all(concepts))?;
            // The first concept of a kind of the configuration is its name.
            let own = named.filter(|kind| !kind.is_standard());
            let own = own.map(|kind| self.terms.kinds.name(kind).to_owned());
            Some(own.into_iter().chain(concepts).collect())
        });
        let progress = speed
            .zip(waited)
            .zip(remaining)
            .zip(exit)
            .map(|(((speed, waited), remaining), exit)| Progress {
                speed,
                waited,
                remaining,
                exit,
            });
        match (kind, heading, at, priority.zip(progress), concepts) {
            (Some(kind), Some(heading), Some([row, col]), Some((priority, progress)), Some(concepts)) => {
                Ok(SceneAgent {
                    id: agent.id,
                    kind,
                    concepts,
                    priority,
                    at: Cell::new(row, col),
                    heading,
                    progress,
                    span: self.span(raw),
                })
            }
            _ => Err(faults),
        }
    }

    fn kind(&self, raw: &'a RawValue) -> Read<KindId> {
        let name: String = self.value(raw)?;
        let kinds = self.terms.kinds;
        kinds.find_ignoring_case(&name).ok_or_else(|| {
            let message = format!("`{name}` is not a type of agent");
            let names: Vec<String> = kinds.all().map(|kind| format!("\"{}\"", kinds.name(kind))).collect();
            let (last, first) = names.split_last().expect("the standard kinds");
            let fault = self.fault(raw, message, &format!("expected {} or {last}", first.join(", ")));
            vec![suggest(fault, &name, kinds.all().map(|kind| kinds.name(kind)))]
        })
    }

    /// Returns the position of a word in [`WORDS`], whatever the case of its letters. `or` ends the list of what is
    /// expected.
    fn word(&self, raw: &'a RawValue, words: Words, or: &str) -> Read<u32> {
        let name: String = self.value(raw)?;
        let mut known = words.range().zip(words.names());
        let found = known.find(|(_, known)| known.eq_ignore_ascii_case(&name));
        found.map(|(word, _)| word).ok_or_else(|| {
            let names: Vec<String> = words.names().iter().map(|name| format!("\"{name}\"")).collect();
            let expected = format!("expected {}{or}", names.join(", "));
            let fault = self.fault(raw, format!("`{name}` is not a {}", words.what()), &expected);
            vec![suggest(fault, &name, words.names().iter().copied())]
        })
    }

    fn heading(&self, raw: &'a RawValue) -> Read<Heading> {
        Ok(Heading::ALL[self.word(raw, Words::Headings, " or null")? as usize])
    }

    fn concept(&self, raw: &'a RawValue, kind: AgentKind) -> Read<String> {
        let concept: String = self.value(raw)?;
        let of_kind = self.terms.concepts.iter().filter(|(of, _)| *of == kind);
        let known: Vec<&str> = of_kind.map(|(_, name)| *name).collect();
        if known.contains(&concept.as_str()) {
            return Ok(concept);
        }
        let kind = kind.name();
        let message = format!("no predicate of the configuration reads the concept `{concept}` of a {kind}");
        let fault = self.fault(raw, message, "unknown concept");
        Err(vec![match did_you_mean(&concept, known.iter().copied()) {
            Some(name) => fault.help(format!("did you mean `{name}`?")),
            None => fault.help(format!("a {kind} can be: {}", listed(&known))),
        }])
    }

    fn symbolic(&self, raw: RawSymbolic<'a>) -> Read<SymbolicScene> {
        self.bounded(&raw.entities, "entities")?;
        let entities: Vec<String> = all(raw.entities.iter().map(|name| self.value(name)))?;
        let spans = raw.entities.iter().map(|raw| self.span(raw));
        let names = self.names(entities.iter().map(String::as_str).zip(spans))?;
        let mut faults = Vec::new();
        let ego = keep(&mut faults, self.named(raw.ego, &names, "entity"));
        let facts = keep(&mut faults, self.rows(raw.facts, &names, "entity"));
        let actions = keep(&mut faults, self.actions(raw.actions, &names, "entity"));
        match (ego, facts, actions) {
            (Some(ego), Some(facts), Some(actions)) => Ok(SymbolicScene {
                entities,
                ego,
                facts,
                actions,
            }),
            _ => Err(faults),
        }
    }

    /// Completes a scene that was parsed in one pass.
    fn plain(&self, plain: PlainScene<'a>) -> Read<SymbolicScene> {
        let facts = plain.facts.into_iter().map(|(predicate, facts)| match facts {
            PlainFacts::Rows((rows, uncertain)) => Ok(GivenPredicate {
                predicate,
                rows,
                values: Vec::new(),
                uncertain,
            }),
            PlainFacts::Quantity(raw) => self.checked_rows(raw, predicate, &plain.names, "entity"),
        });
        Ok(SymbolicScene {
            facts: all(facts)?,
            entities: plain.entities.into_iter().map(str::to_owned).collect(),
            ego: plain.ego,
            actions: plain.actions,
        })
    }

    fn bounded(&self, list: &[&'a RawValue], what: &str) -> Read<()> {
        match list.get(MAX_ENTITIES) {
            None => Ok(()),
            Some(first) => {
                let message = format!("a scene with {} {what}, the limit is {MAX_ENTITIES}", list.len());
                let fault = Diagnostic::new(diag::codes::LIMIT_EXCEEDED, message);
                Err(vec![fault.at(self.span(first), "the first one beyond the limit")])
            }
        }
    }

    /// Returns the positions by name.
    fn names<'n>(&self, list: impl Iterator<Item = (&'n str, Span)>) -> Read<NameIndex<'n>> {
        let mut names = NameIndex::default();
        let mut spans = Vec::new();
        let mut faults = Vec::new();
        for (name, span) in list {
            if let Some(first) = names.add(name) {
                let fault = Diagnostic::new(codes::INVALID_SCENE, format!("the name `{name}` is given twice"));
                faults.push(fault.at(span, "again here").also(spans[first], "first here"));
            }
            spans.push(span);
        }
        if faults.is_empty() { Ok(names) } else { Err(faults) }
    }

    /// Returns the position of the agent or entity (`what`) that a JSON string names.
    fn named(&self, raw: &'a RawValue, names: &NameIndex<'_>, what: &str) -> Read<usize> {
        let name: String = self.value(raw)?;
        names.get(&name).ok_or_else(|| {
            let fault = self.fault(raw, format!("the scene has no {what} `{name}`"), "unknown name");
            vec![suggest_name(fault, &name, names)]
        })
    }

    /// Parses labels: the name of an action for each agent or entity (`what`).
    fn actions(&self, Entries(entries): Entries<'a>, names: &NameIndex<'_>, what: &str) -> Read<Vec<(usize, Action)>> {
        all(entries.into_iter().map(|(name, raw)| {
            let position = names.get(&name).ok_or_else(|| {
                let fault = Diagnostic::new(codes::INVALID_SCENE, format!("the scene has no {what} `{name}`"));
                vec![suggest_name(fault.at(self.key_span(raw), "unknown name"), &name, names)]
            })?;
            let named: String = self.value(raw)?;
            let action = Action::standard_ignoring_case(&named).ok_or_else(|| {
                let names = Action::STANDARD.map(Action::name);
                let label = format!("expected one of {}", names.join(", "));
                let fault = self.fault(raw, format!("`{named}` is not an action"), &label);
                vec![suggest(fault, &named, names)]
            })?;
            Ok((position, action))
        }))
    }

    fn rows(&self, Entries(entries): Entries<'a>, names: &NameIndex<'_>, what: &str) -> Read<Vec<GivenPredicate>> {
        all(entries.into_iter().map(|(name, raw)| {
            let known = self.terms.predicates.iter().position(|(known, ..)| *known == name);
            let Some((predicate, &(_, arity, unit))) = known.map(|at| (at, &self.terms.predicates[at])) else {
                let message = format!("`{name}` is not a base predicate");
                let fault = Diagnostic::new(codes::INVALID_SCENE, message).at(self.key_span(raw), "unknown predicate");
                let known = self.terms.predicates.iter().map(|(known, ..)| *known);
                return Err(vec![match did_you_mean(&name, known.clone()) {
                    Some(known) => fault.help(format!("did you mean `{known}`?")),
                    None => fault.help(format!("base predicates are: {}", listed(&known.collect::<Vec<_>>()))),
                }]);
            };
            if let (None, Some((rows, uncertain))) = (unit, plain_rows(raw, arity, names)) {
                return Ok(GivenPredicate {
                    predicate,
                    rows,
                    values: Vec::new(),
                    uncertain,
                });
            }
            self.checked_rows(raw, predicate, names, what)
        }))
    }

    /// Parses the rows of a predicate, and finds the places of faults in them.
    fn checked_rows(
        &self,
        raw: &'a RawValue,
        predicate: usize,
        names: &NameIndex<'_>,
        what: &str,
    ) -> Read<GivenPredicate> {
        let (name, arity, unit) = self.terms.predicates[predicate];
        let written: Vec<&RawValue> = self.value(raw)?;
        // One row without the brackets of the list of rows.
        let length = arity + usize::from(unit.is_some());
        if length > 1 && written.len() == length && written.iter().all(|raw| !raw.get().starts_with(['[', '{'])) {
            let message = format!("expected a list of rows of `{name}`, found one row");
            let row: Vec<&str> = written.iter().map(|raw| raw.get()).collect();
            let row = row.join(", ");
            let fault = self.fault(raw, message, "");
            return Err(vec![match row.len() {
                ..ROW_SHOWN => fault.help(format!("write `[[{row}]]`")),
                _ => fault.help("put brackets around each row, too"),
            }]);
        }
        let mut uncertain = Vec::new();
        let mut rows = all(written.iter().map(|raw| {
            let (row, probability) = self.uncertain(raw, unit)?;
            let row = self.row(row, (arity, unit), names, what)?;
            uncertain.extend(probability.map(|probability| (row.0, probability)));
            Ok(row)
        }))?;
        uncertain.sort_by_key(|(row, _)| *row);
        let mut stated: HashMap<[u32; 2], &RawValue> = HashMap::new();
        let is_uncertain = |row: &[u32; 2]| uncertain.binary_search_by_key(row, |(row, _)| *row).is_ok();
        for ((row, _), raw) in rows.iter().zip(&written).filter(|((row, _), _)| is_uncertain(row)) {
            if let Some(first) = stated.insert(*row, raw) {
                let message = format!("a row of `{name}` with a probability is given twice");
                let fault = self.fault(raw, message, "given again here");
                return Err(vec![fault.also(self.span(first), "first given here")]);
            }
        }
        let mut spans: HashMap<[u32; 2], &RawValue> = HashMap::new();
        for (&(row, value), &raw) in rows.iter().zip(&written).filter(|_| unit.is_some()) {
            // A quantity has one value.
            if let Some(first) = spans.insert(row, raw)
                && rows.iter().any(|&(other, known)| other == row && known != value)
            {
                let fault = self.fault(raw, format!("a second value of `{name}`"), "given again here");
                return Err(vec![fault.also(self.span(first), "first given here")]);
            }
        }
        rows.sort_unstable();
        rows.dedup();
        let (rows, values): (Vec<_>, Vec<_>) = rows.into_iter().unzip();
        Ok(GivenPredicate {
            predicate,
            rows,
            values: if unit.is_some() { values } else { Vec::new() },
            uncertain,
        })
    }

    /// Parses a row that may have a probability, `{"row": .., "probability": 0.7}`, and returns both.
    fn uncertain(&self, raw: &'a RawValue, unit: Option<Unit>) -> Read<(&'a RawValue, Option<f64>)> {
        if !raw.get().starts_with('{') {
            return Ok((raw, None));
        }
        let RawUncertain { row, probability } = self.keyed(raw, "a row", &ROW_KEYS)?;
        if unit.is_some() {
            let message = "the value of a quantity has no probability".to_owned();
            return Err(vec![self.fault(raw, message, "expected a row")]);
        }
        match self.value::<f64>(probability).ok() {
            Some(1.0) => Ok((row, None)),
            Some(found) if found > 0.0 && found < 1.0 => Ok((row, Some(found))),
            None => {
                let fault = self.fault(
                    probability,
                    "not a probability".to_owned(),
                    "expected a number from 0 to 1",
                );
                let number = probability.get().trim_matches('"');
                let (digits, divisor) = number.strip_suffix('%').map_or((number, 1.0), |digits| (digits, 100.0));
                let meant = digits.trim().parse::<f64>().map(|value| value / divisor);
                Err(vec![match meant.ok().filter(|meant| *meant > 0.0 && *meant <= 1.0) {
                    Some(meant) => fault.help(format!("write `{meant}`")),
                    None => fault,
                }])
            }
            Some(_) => {
                let label = "expected a number above 0 and at most 1; leave out a row that cannot hold";
                Err(vec![self.fault(probability, "not a probability".to_owned(), label)])
            }
        }
    }

    /// Parses a row: a list of names, then the value of a quantity; or the only one of these.
    fn row(
        &self,
        raw: &'a RawValue,
        (arity, unit): (usize, Option<Unit>),
        names: &NameIndex<'_>,
        what: &str,
    ) -> Read<([u32; 2], Value)> {
        let terms = if raw.get().starts_with('[') {
            self.value::<Vec<&RawValue>>(raw)?
        } else {
            vec![raw]
        };
        if terms.len() != arity + usize::from(unit.is_some()) {
            let message = match unit {
                None => format!("a row of {}; the predicate takes {arity}", counted(terms.len(), "name")),
                Some(_) => format!(
                    "a row of {}; the quantity takes {} and a value",
                    counted(terms.len(), "term"),
                    counted(arity, "name")
                ),
            };
            let fault = self.fault(raw, message, "wrong length");
            return Err(vec![
                fault.help(format!("write `{}`", row_like(&terms, arity, unit, names))),
            ]);
        }
        // The value comes last.
        if unit.is_some() && terms[..arity].iter().any(|term| !term.get().starts_with('"')) {
            let message = "expected the names of a row before its value".to_owned();
            let fault = self.fault(raw, message, "");
            return Err(vec![
                fault.help(format!("write `{}`", row_like(&terms, arity, unit, names))),
            ]);
        }
        let mut row = [0; 2];
        for (position, term) in row.iter_mut().zip(&terms[..arity]) {
            *position = u32::try_from(self.named(term, names, what)?).expect("fewer than 2^32 entities");
        }
        let value = match unit {
            None => Value::default(),
            Some(Unit::Number) => Value::number(self.value(terms[arity])?),
            Some(Unit::Float) => Value::float(self.value(terms[arity])?),
            Some(Unit::Word(words)) => Value(self.word(terms[arity], words, "")?),
        };
        Ok((row, value))
    }

    fn value<T: Deserialize<'a>>(&self, raw: &'a RawValue) -> Read<T> {
        self.read(raw.get(), self.offset(raw))
    }

    /// Parses JSON that starts at byte `offset` of the scene.
    fn read<T: Deserialize<'a>>(&self, json: &'a str, offset: usize) -> Read<T> {
        serde_json::from_str(json).map_err(|error| {
            // `column` is 0 if the error is about the value as a whole.
            let lines_before = json.split('\n').take(error.line().saturating_sub(1));
            let byte = lines_before.map(|line| line.len() + 1).sum::<usize>() + error.column().saturating_sub(1);
            // The parser counts bytes, and may stop within a character.
            let byte = json.floor_char_boundary(byte);
            let start = offset + byte;
            let span = match error.classify() {
                _ if error.column() == 0 => offset..offset + json.len(),
                // The position is that of the last character of a value of the wrong type.
                Category::Data => offset + value_start(&json[..json.ceil_char_boundary(byte + 1)])..start + 1,
                _ => start..start + 1,
            };
            let fault = Diagnostic::new(codes::INVALID_SCENE, format!("not a scene: {}", json_error(&error)));
            let fault = fault.at(Span::new(self.source, span), "");
            let before = json[..byte].trim_end();
            let fault = match error.classify() {
                Category::Eof => fault.help("a scene is one line; `jq -c . FILE` writes an object without line breaks"),
                Category::Syntax if before.ends_with(',') => {
                    fault.help("remove the comma: in JSON none stands after the last value")
                }
                _ => fault,
            };
            vec![fault.help(HELP)]
        })
    }

    /// Returns the byte offset of a part of the scene. `raw` must borrow from the scene's text.
    fn offset(&self, raw: &RawValue) -> usize {
        (raw.get().as_ptr() as usize).saturating_sub(self.text.as_ptr() as usize)
    }

    fn span(&self, raw: &RawValue) -> Span {
        let start = self.offset(raw);
        Span::new(self.source, start..start + raw.get().len())
    }

    /// Returns the span of the key of a value in an object.
    fn key_span(&self, raw: &RawValue) -> Span {
        let before = self.text[..self.offset(raw)].trim_end_matches([' ', '\t', ':']);
        let inside = before.strip_suffix('"').unwrap_or(before);
        let start = inside.rfind('"').unwrap_or(inside.len());
        Span::new(self.source, start..before.len())
    }

    fn fault(&self, raw: &RawValue, message: String, label: &str) -> Diagnostic {
        Diagnostic::new(codes::INVALID_SCENE, message).at(self.span(raw), label)
    }
}

/// Adds a similar word as help.
fn suggest<'w>(fault: Diagnostic, written: &str, words: impl IntoIterator<Item = &'w str>) -> Diagnostic {
    match did_you_mean(written, words) {
        Some(near) => fault.help(format!("did you mean `{near}`?")),
        None => fault,
    }
}

/// Adds a similar name of an agent or entity, or all of them, as help.
fn suggest_name(fault: Diagnostic, written: &str, names: &NameIndex<'_>) -> Diagnostic {
    match did_you_mean(written, names.list().iter().copied().take(SEARCHED)) {
        Some(near) => fault.help(format!("did you mean `{near}`?")),
        None if names.list().is_empty() => fault,
        None => fault.help(format!("the scene has: {}", listed(names.list()))),
    }
}

/// Returns whether a term is one of some words, whatever the case of its letters.
fn is_word(words: Words, term: &str) -> bool {
    let term = term.trim_matches('"');
    words.names().iter().any(|name| name.eq_ignore_ascii_case(term))
}

/// Returns a row of the right form, with the names and the value of a wrong one where it has them.
fn row_like(terms: &[&RawValue], arity: usize, unit: Option<Unit>, names: &NameIndex<'_>) -> String {
    let (example, is_value): (&str, fn(&str) -> bool) = match unit {
        None => ("", |_| false),
        Some(Unit::Number) => ("3", |term| term.parse::<i32>().is_ok()),
        Some(Unit::Float) => ("3.5", |term| term.parse::<f32>().is_ok()),
        Some(Unit::Word(Words::Headings)) => ("\"Up\"", |term| is_word(Words::Headings, term)),
        Some(Unit::Word(Words::Lights)) => ("\"green\"", |term| is_word(Words::Lights, term)),
        Some(Unit::Word(Words::RightsOfWay)) => ("\"yields\"", |term| is_word(Words::RightsOfWay, term)),
    };
    let written = || {
        terms
            .iter()
            .map(|term| term.get())
            .filter(|term| term.len() < ROW_SHOWN)
    };
    let is_name = |term: &&str| term.starts_with('"') && !is_value(term);
    let mut row: Vec<String> = written().filter(is_name).take(arity).map(str::to_owned).collect();
    let others = names.list().iter().map(|name| format!("\"{name}\"")).take(SEARCHED);
    for name in others {
        if row.len() < arity && !row.contains(&name) {
            row.push(name);
        }
    }
    row.resize(arity, "..".to_owned());
    if unit.is_some() {
        row.push(written().find(|term| is_value(term)).unwrap_or(example).to_owned());
    }
    format!("[{}]", row.join(", "))
}

/// The length from which on a message does not repeat a row.
const ROW_SHOWN: usize = 100;

/// The keys of a scene of agents.
const GEOMETRIC_KEYS: [&str; 6] = ["map", "agents", "egos", "given", "tick", "actions"];
/// The keys of an agent.
const AGENT_KEYS: [&str; 10] = [
    "id",
    "type",
    "at",
    "heading",
    "concepts",
    "priority",
    "speed",
    "waited",
    "remaining",
    "exit",
];
/// The keys of a row with a probability.
const ROW_KEYS: [&str; 2] = ["row", "probability"];
/// The keys of a scene of entities.
const SYMBOLIC_KEYS: [&str; 5] = ["entities", "ego", "facts", "actions", "reason"];

const FORMS: &str = "expected {\"map\": .., \"agents\": [..]} or {\"entities\": [..], \"ego\": .., \"facts\": {..}}";
const HELP: &str = "a scene is {\"map\": .., \"agents\": [{\"id\": .., \"type\": .., \"at\": [..]}]} or {\"entities\": [..], \
                    \"ego\": .., \"facts\": {..}}; `logicity new FOLDER` writes examples";

impl GeometricScene {
    /// Checks that every agent is on the map and outside its buildings.
    ///
    /// # Errors
    /// `invalid-scene` for each agent outside the map or in a building.
    pub fn check_cells(&self, map: &CityMap) -> Result<(), Vec<Diagnostic>> {
        let check = |agent: &SceneAgent| {
            let Cell { row, col } = agent.at;
            let fault = |message: String| {
                Diagnostic::new(codes::INVALID_SCENE, message).at(agent.span, format!("at [{row}, {col}]"))
            };
            if !map.contains(agent.at) {
                let (rows, cols) = (map.rows() - 1, map.cols() - 1);
                return Some(
                    fault(format!("`{}` is not on the map `{}`", agent.id, map.name))
                        .help(format!("rows are 0 to {rows}, columns 0 to {cols}")),
                );
            }
            let building = map.building_at(agent.at)?;
            let message = format!("`{}` is in a building of the map `{}`", agent.id, map.name);
            let fault = fault(message).note(format!(
                "the cell [{row}, {col}] belongs to a building ({})",
                building.name()
            ));
            let (what, may) = match agent.kind {
                AgentKind::Car => ("street", CityMap::is_drivable as fn(&CityMap, Cell) -> bool),
                AgentKind::Pedestrian => ("sidewalk", CityMap::is_walkable as fn(&CityMap, Cell) -> bool),
            };
            Some(match nearest(map, agent.at, may) {
                Some(Cell { row, col }) => fault.help(format!("the nearest cell on a {what} is [{row}, {col}]")),
                None => fault.help(format!("choose a cell on a {what}")),
            })
        };
        let faults: Faults = self.agents.iter().filter_map(check).collect();
        if faults.failed() { Err(faults.finish()) } else { Ok(()) }
    }
}

/// Returns the nearest cell, by rows and columns, on which agents of a kind may be.
fn nearest(map: &CityMap, to: Cell, may: fn(&CityMap, Cell) -> bool) -> Option<Cell> {
    let rings = 1..=map.rows().max(map.cols());
    let mut found = rings.filter_map(|away| {
        let ring = (-away..=away).flat_map(|along| {
            let across = away - along.abs();
            [(along, across), (along, -across)]
        });
        let mut cells = ring.map(|(row, col)| Cell::new(to.row + row, to.col + col));
        cells.find(|cell| may(map, *cell))
    });
    found.next()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::{Purpose, RngExt, Seed};
    use std::collections::BTreeSet;

    /// A list is no scene, even if its elements would fill the fields of one.
    #[test]
    fn a_scene_is_an_object() {
        let kinds = KindTable::default();
        let terms = Terms {
            predicates: vec![("P", 1, None)],
            concepts: Vec::new(),
            kinds: &kinds,
        };
        for (text, is_scene) in [
            (r#"{"entities": ["a"], "ego": "a", "facts": {"P": ["a"]}}"#, true),
            (r#" [{"entities": ["a"], "ego": "a"}]"#, true),
            (r#"[["a"], "a", {"P": ["a"]}]"#, false),
            (r#"[["a"], "a"]"#, false),
        ] {
            let mut sources = Sources::new();
            let source = sources.add("scene", text);
            assert_eq!(parse_scenes(&sources, source, &terms).is_ok(), is_scene, "{text}");
        }
    }

    #[test]
    fn the_lists_of_keys_are_those_of_the_types() {
        fn keys_of<'a, T: Deserialize<'a>>() -> BTreeSet<String> {
            let error = serde_json::from_str::<T>(r#"{"?": 0}"#)
                .err()
                .expect("no such key")
                .to_string();
            let (_, known) = error.split_once("expected").expect("a list of keys");
            known.split('`').skip(1).step_by(2).map(str::to_owned).collect()
        }
        let listed = |keys: &[&str]| keys.iter().map(|key| (*key).to_owned()).collect::<BTreeSet<_>>();
        assert_eq!(keys_of::<RawGeometric<'_>>(), listed(&GEOMETRIC_KEYS));
        assert_eq!(keys_of::<RawAgent<'_>>(), listed(&AGENT_KEYS));
        assert_eq!(keys_of::<RawSymbolic<'_>>(), listed(&SYMBOLIC_KEYS));
        assert_eq!(keys_of::<RawUncertain<'_>>(), listed(&ROW_KEYS));
    }

    #[test]
    fn mistakes_in_scenes_are_explained() {
        let kinds = KindTable::default();
        let terms = Terms {
            predicates: vec![("NextTo", 2, None), ("Waited", 1, Some(Unit::Number))],
            concepts: Vec::new(),
            kinds: &kinds,
        };
        let facts = |facts: &str| format!(r#"{{"entities": ["me", "you"], "ego": "me", "facts": {{{facts}}}}}"#);
        let car = |keys: &str| format!(r#"{{"map": "square-5x5", "agents": [{{"id": "a", "at": [1, 2], {keys}}}]}}"#);
        for (text, words) in [
            (
                r#"{"entites": ["me"], "ego": "me"}"#.to_owned(),
                vec!["unknown key `entites`", "did you mean `entities`?"],
            ),
            (
                r#"{"entities": ["me"], "ego": "me", "fact": {}}"#.to_owned(),
                vec!["unknown key `fact` in a scene of entities", "did you mean `facts`?"],
            ),
            (
                r#"{"entities": ["me"], "ego": "mee"}"#.to_owned(),
                vec!["the scene has no entity `mee`", "did you mean `me`?"],
            ),
            (
                r#"{"entities": ["me"], "ego": "me", "actions": {"me": "Stpo"}}"#.to_owned(),
                vec!["`Stpo` is not an action", "did you mean `Stop`?"],
            ),
            (
                r#"{"entities": 3, "ego": "me"}"#.to_owned(),
                vec!["expected a list", "`logicity new FOLDER` writes examples"],
            ),
            (
                facts(r#""NextTo": ["me","you"]"#),
                vec!["found one row", r#"write `[["me", "you"]]`"#],
            ),
            (
                facts(r#""NextTo": [["you"]]"#),
                vec!["a row of 1 name; the predicate takes 2", r#"write `["you", "me"]`"#],
            ),
            (
                facts(r#""NextTo": [["me", "yuo"]]"#),
                vec!["no entity `yuo`", "did you mean `you`?"],
            ),
            (
                facts(r#""NextTo": [{"row": ["me", "you"], "probability": "40%"}]"#),
                vec!["expected a number from 0 to 1", "write `0.4`"],
            ),
            (
                facts(r#""NextTo": [{"row": ["me", "you"], "probabilty": 0.4}]"#),
                vec!["unknown key `probabilty`", "did you mean `probability`?"],
            ),
            (
                facts(r#""Waited": [[3, "me"]]"#),
                vec!["the names of a row before its value", r#"write `["me", 3]`"#],
            ),
            (
                facts(r#""Waited": ["you"]"#),
                vec!["the quantity takes 1 name and a value", r#"write `["you", 3]`"#],
            ),
            (
                facts(r#""Waited": ["me", 5]"#),
                vec!["found one row", r#"write `[["me", 5]]`"#],
            ),
            (
                car(r#""type": "Carr""#),
                vec!["`Carr` is not a type of agent", "did you mean `Car`?"],
            ),
            (
                car(r#""type": "Car", "headin": "Up""#),
                vec!["unknown key `headin` in an agent", "did you mean `heading`?"],
            ),
        ] {
            let mut sources = Sources::new();
            let source = sources.add("scene", text.as_str());
            let faults = parse_scenes(&sources, source, &terms).expect_err(&text);
            assert_eq!(faults.len(), 1, "{text}: {faults:?}");
            let fault = &faults[0];
            let label = fault.primary.as_ref().expect("a place");
            let said = format!("{}\n{}\n{}", fault.message, label.message, fault.help.join("\n"));
            for word in words {
                assert!(said.contains(word), "{text}: `{word}` is missing in:\n{said}");
            }
        }
    }

    /// One-pass parsing equals the parts of [`Reader::scene`].
    #[test]
    fn plain_scenes_equal_checked_scenes() {
        const ENTITIES: [&str; 8] = [
            r#""entities":["a","b"]"#,
            r#""entities":["a","b","ä"]"#,
            r#""entities":["b","\u0061","c"]"#,
            r#""entities":["a","a"]"#,
            r#""entities":["a","b","c","d","e","f","g","h","i","j","k","l","m","n","o","p"]"#,
            r#""entities":["a","b","c","d","e","f","g","h","i","j","k","l","m","n","o","p","q","r"]"#,
            r#""entities":["pedestrian_1","pedestrian_2","pedestria","a"]"#,
            r#""entities":3"#,
        ];
        const OTHERS: [&str; 15] = [
            r#""facts":{"P":["ä",["a"]]}"#,
            r#""ego":"a""#,
            r#""ego":"b""#,
            r#""ego":"z""#,
            r#""ego":"pedestrian_2""#,
            r#""facts":{"P":["pedestria"],"Q":[["pedestrian_2","pedestrian_1"],["pedestrian_1","a"]]}"#,
            r#""facts":{"P":["a",["b"]],"Q":[["a","b"],{"row":["b","a"],"probability":0.5}]}"#,
            r#""facts":{"Q":[["b","a"],["b","b"]],"V":[["b",3],["a",-1]]}"#,
            r#""facts":{"V":[["b",3],["b",4]]}"#,
            r#""facts":{"P":["a"],"P":["b"]}"#,
            r#""facts":{"R":["a"]}"#,
            r#""actions":{"a":"stop","b":"Fast"}"#,
            r#""actions":{"a":"Stop","a":"Fast"}"#,
            r#""reason":"a test""#,
            r#""more":1"#,
        ];
        let kinds = KindTable::default();
        let terms = Terms {
            predicates: vec![("P", 1, None), ("Q", 2, None), ("V", 1, Some(Unit::Number))],
            concepts: Vec::new(),
            kinds: &kinds,
        };
        let mut counts = [0; 2];
        for case in 0..4000 {
            let mut random = Seed(case).stream(Purpose::TEST, 0, 0);
            let mut parts = vec![ENTITIES[random.random_range(0..8)], OTHERS[random.random_range(0..6)]];
            parts.extend((0..random.random_range(0..4)).map(|_| OTHERS[random.random_range(0..15)]));
            if random.random_bool(0.2) {
                parts.rotate_left(1);
            }
            let mut sources = Sources::new();
            let mut text = format!(" {{{}}} ", parts.join(", "));
            if random.random_bool(0.2) {
                // Drops, floats_64 or replaces one character.
                let at = text.floor_char_boundary(random.random_range(0..text.len()));
                let found = &text[at..].chars().next().expect("a character").to_string();
                let changed = ["", &found.repeat(2), "\"", "\t", "]", ",", "0"][random.random_range(0..7)].to_owned();
                text.replace_range(at..at + found.len(), &changed);
            }
            let source = sources.add("scene", text);
            let reader = Reader {
                source,
                text: sources.text(source),
                terms: &terms,
            };
            let whole: Result<&RawValue, _> = serde_json::from_str(reader.text);
            let checked = whole.map_err(drop).and_then(|whole| reader.scene(whole).map_err(drop));
            let plain = plain_scene(reader.text, &terms.predicates).and_then(|plain| reader.plain(plain).ok());
            counts[usize::from(plain.is_some())] += 1;
            if let Some(plain) = plain {
                let expected = checked.unwrap_or_else(|()| panic!("it has a fault: {}", reader.text));
                assert_eq!(
                    format!("{:?}", Scene::Symbolic(plain)),
                    format!("{expected:?}"),
                    "{}",
                    reader.text
                );
            } else if checked.is_ok() {
                let refused = reader.text.contains("\\u0061") || !reader.text.trim_start().starts_with("{\"entities");
                assert!(refused, "{}", reader.text);
            }
        }
        assert!(counts.iter().all(|count| *count > 200), "{counts:?}");
    }

    /// One-pass parsing equals `checked_rows`, and rejects the same rows.
    #[test]
    fn plain_rows_equal_checked_rows() {
        const PARTS: [&str; 23] = [
            r#"["a"]"#,
            r#"["b"]"#,
            r#""a""#,
            r#"["a","b"]"#,
            r#"["b","a"]"#,
            r#"["a","a"]"#,
            r#"{"row":["a","b"],"probability":0.25}"#,
            r#"{"probability":0.5,"row":["b"]}"#,
            r#"{"row":"b","probability":1}"#,
            r#"{"row":["b","b"],"probability":1.0}"#,
            r#"{"row":["a"],"probability":0}"#,
            r#"{"row":{"row":["a"],"probability":1},"probability":1}"#,
            r#"{"row":["a"]}"#,
            r#"["c"]"#,
            r#"["a","b","a"]"#,
            "3",
            r#"{"row":["a"],"probability":1e400}"#,
            r#"{"row":["a"],"probability":1e-400}"#,
            r#"{"row":["a"],"probability":-0.5}"#,
            r#"{"row":["a"],"probability":"0.5"}"#,
            r#"{"row":["a"],"probability":null}"#,
            r#"{"row":["a"],"probability":0.99999999999999999999}"#,
            r#"{"row":["a"],"probability":0.5 }"#,
        ];
        let mut counts = [0; 2];
        let mut names = NameIndex::default();
        for name in ["a", "b"] {
            assert_eq!(names.add(name), None);
        }
        let kinds = KindTable::default();
        for case in 0..4000 {
            let mut random = Seed(case).stream(Purpose::TEST, 0, 0);
            // Most rows have no fault.
            let usual = if random.random_bool(0.2) { PARTS.len() } else { 10 };
            let rows: Vec<&str> = (0..random.random_range(0..5))
                .map(|_| PARTS[random.random_range(0..usual)])
                .collect();
            let mut sources = Sources::new();
            let source = sources.add("scene", format!("[{}]", rows.join(" , ")));
            let arity = random.random_range(1..3);
            let terms = Terms {
                predicates: vec![("P", arity, None)],
                concepts: Vec::new(),
                kinds: &kinds,
            };
            let reader = Reader {
                source,
                text: sources.text(source),
                terms: &terms,
            };
            let raw: &RawValue = serde_json::from_str(reader.text).expect("it is JSON");
            let found = plain_rows(raw, arity, &names);
            let checked = reader.checked_rows(raw, 0, &names, "entity");
            let checked = checked.ok().map(|checked| (checked.rows, checked.uncertain));
            assert_eq!(found, checked, "{}", reader.text);
            counts[usize::from(found.is_some())] += 1;
        }
        assert!(counts.iter().all(|count| *count > 300), "{counts:?}");
    }
}
