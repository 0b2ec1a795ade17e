//! Scenes: one state of a city, or of something more abstract, as a line of JSON. `configs/README.md` documents the format.

use crate::city::{Cell, CityMap, Heading};
use crate::config::AgentKind;
use crate::diag::{Code, Diagnostic, SourceId, Sources, Span, did_you_mean};
use indexmap::IndexMap;
use indexmap::map::Entry;
use serde::Deserialize;
use serde::de::{self, Deserializer, MapAccess, Visitor};
use serde_json::value::RawValue;
use std::collections::HashMap;

/// The most agents or entities of a scene: facts about pairs of them take memory in the square of their number.
pub const MAX_ENTITIES: usize = 2000;

/// A scene.
#[derive(Clone, Debug)]
pub enum Scene {
    /// Agents on a map; the base predicates are computed.
    Geometric(GeometricScene),
    /// Entities and facts; the base predicates are given.
    Symbolic(SymbolicScene),
}

/// Agents on a map.
#[derive(Clone, Debug)]
pub struct GeometricScene {
    /// Name of the map.
    pub map: String,
    /// Where the name stands.
    pub map_span: Span,
    /// The agents in list order.
    pub agents: Vec<SceneAgent>,
    /// Positions in `agents` of those to decide for.
    pub egos: Vec<usize>,
    /// Predicates whose true rows are given instead of computed.
    pub given: Vec<GivenPredicate>,
}

/// An agent of a scene.
#[derive(Clone, Debug)]
pub struct SceneAgent {
    /// Its name.
    pub id: String,
    /// Car or pedestrian.
    pub kind: AgentKind,
    /// Names of its concepts.
    pub concepts: Vec<String>,
    /// Right of way.
    pub priority: i32,
    /// Where it is.
    pub at: Cell,
    /// The direction of its last move.
    pub heading: Option<Heading>,
    /// Where the agent stands in the text.
    pub span: Span,
}

/// The true rows of a predicate.
#[derive(Clone, Debug)]
pub struct GivenPredicate {
    /// The predicate's name.
    pub name: String,
    /// Rows of positions in the scene's agents or entities, sorted.
    pub rows: Vec<Vec<usize>>,
}

/// Entities and facts.
#[derive(Clone, Debug)]
pub struct SymbolicScene {
    /// Names of the entities, in order.
    pub entities: Vec<String>,
    /// Position of the one to decide for.
    pub ego: usize,
    /// The true facts.
    pub facts: Vec<GivenPredicate>,
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
    #[serde(default)]
    priority: i32,
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
}

/// A JSON object in the order of the text, whose values are read later.
#[derive(Default)]
struct Entries<'a>(IndexMap<String, &'a RawValue>);

impl<'de: 'a, 'a> Deserialize<'de> for Entries<'a> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Visit;
        impl<'de> Visitor<'de> for Visit {
            type Value = Entries<'de>;

            fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
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

/// Which predicates a scene may speak of, and which concepts its agents may carry.
pub struct Terms<'a> {
    /// Base predicates with their number of columns.
    pub predicates: Vec<(&'a str, usize)>,
    /// Concepts and the kind of agent that carries them.
    pub concepts: Vec<(AgentKind, &'a str)>,
}

/// Reads a scene.
///
/// # Errors
/// `invalid-scene` at the place of the fault, `limit-exceeded` for more than [`MAX_ENTITIES`].
pub fn parse_scene(sources: &Sources, source: SourceId, terms: &Terms<'_>) -> Result<Scene, Diagnostic> {
    let reader = Reader {
        source,
        text: sources.text(source),
        terms,
    };
    reader.scene()
}

struct Reader<'a> {
    source: SourceId,
    text: &'a str,
    terms: &'a Terms<'a>,
}

impl<'a> Reader<'a> {
    fn scene(&self) -> Result<Scene, Diagnostic> {
        let whole: &RawValue = self.read(self.text, 0)?;
        let Entries(keys) = self.read(whole.get(), self.offset(whole))?;
        if keys.contains_key("entities") {
            self.symbolic(whole).map(Scene::Symbolic)
        } else {
            self.geometric(whole).map(Scene::Geometric)
        }
    }

    fn geometric(&self, whole: &'a RawValue) -> Result<GeometricScene, Diagnostic> {
        let raw: RawGeometric<'a> = self.read(whole.get(), self.offset(whole))?;
        self.bounded(&raw.agents, "agents")?;
        let agents = raw
            .agents
            .iter()
            .map(|agent| self.agent(agent))
            .collect::<Result<Vec<_>, _>>()?;
        let names = self.names(agents.iter().map(|agent| (agent.id.as_str(), agent.span)))?;
        let egos = match &raw.egos {
            None => (0..agents.len()).collect(),
            Some(egos) => egos
                .iter()
                .map(|ego| self.named(ego, &names, "agent"))
                .collect::<Result<_, _>>()?,
        };
        Ok(GeometricScene {
            map: self.value(raw.map)?,
            map_span: self.span(raw.map),
            given: self.rows(raw.given, &names, "agent")?,
            agents,
            egos,
        })
    }

    fn agent(&self, raw: &'a RawValue) -> Result<SceneAgent, Diagnostic> {
        let agent: RawAgent<'a> = self.value(raw)?;
        let name: String = self.value(agent.kind)?;
        let kind = AgentKind::ALL.into_iter().find(|kind| kind.name() == name);
        let kind = kind.ok_or_else(|| {
            let message = format!("`{name}` is not a type of agent");
            self.fault(agent.kind, message, "expected \"Car\" or \"Pedestrian\"")
        })?;
        let heading = match agent.heading {
            None => None,
            Some(raw) => {
                let name: String = self.value(raw)?;
                let expected = "expected \"Left\", \"Right\", \"Up\", \"Down\" or null";
                let heading = Heading::from_name(&name);
                Some(heading.ok_or_else(|| self.fault(raw, format!("`{name}` is not a heading"), expected))?)
            }
        };
        let mut concepts = Vec::new();
        for raw in agent.concepts {
            let concept: String = self.value(raw)?;
            let known = || {
                (self.terms.concepts.iter())
                    .filter(|(of, _)| *of == kind)
                    .map(|(_, name)| *name)
            };
            if !known().any(|name| name == concept) {
                let fault = self.fault(
                    raw,
                    format!(
                        "no predicate of the configuration reads the concept `{concept}` of a {}",
                        kind.name()
                    ),
                    "unknown concept",
                );
                return Err(match did_you_mean(&concept, known()) {
                    Some(name) => fault.help(format!("did you mean `{name}`?")),
                    None => fault.help(format!(
                        "a {} can be: {}",
                        kind.name(),
                        known().collect::<Vec<_>>().join(", ")
                    )),
                });
            }
            concepts.push(concept);
        }
        let [row, col]: [i32; 2] = self.value(agent.at)?;
        Ok(SceneAgent {
            id: agent.id,
            kind,
            concepts,
            priority: agent.priority,
            at: Cell::new(row, col),
            heading,
            span: self.span(raw),
        })
    }

    fn symbolic(&self, whole: &'a RawValue) -> Result<SymbolicScene, Diagnostic> {
        let raw: RawSymbolic<'a> = self.read(whole.get(), self.offset(whole))?;
        self.bounded(&raw.entities, "entities")?;
        let entities = raw
            .entities
            .iter()
            .map(|name| self.value::<String>(name))
            .collect::<Result<Vec<_>, _>>()?;
        let spans = raw.entities.iter().map(|raw| self.span(raw));
        let names = self.names(entities.iter().map(String::as_str).zip(spans))?;
        Ok(SymbolicScene {
            ego: self.named(raw.ego, &names, "entity")?,
            facts: self.rows(raw.facts, &names, "entity")?,
            entities,
        })
    }

    fn bounded(&self, list: &[&'a RawValue], what: &str) -> Result<(), Diagnostic> {
        match list.get(MAX_ENTITIES) {
            None => Ok(()),
            Some(first) => {
                let message = format!("a scene with {} {what}, the limit is {MAX_ENTITIES}", list.len());
                let fault = Diagnostic::new(Code::LimitExceeded, message);
                Err(fault.at(self.span(first), "the first that is too many"))
            }
        }
    }

    /// Positions by name.
    fn names<'n>(&self, list: impl Iterator<Item = (&'n str, Span)>) -> Result<HashMap<String, usize>, Diagnostic> {
        let mut names = HashMap::new();
        let mut spans = Vec::new();
        for (index, (name, span)) in list.enumerate() {
            if let Some(first) = names.insert(name.to_owned(), index) {
                let fault = Diagnostic::new(Code::InvalidScene, format!("the name `{name}` is given twice"));
                return Err(fault.at(span, "again here").also(spans[first], "first here"));
            }
            spans.push(span);
        }
        Ok(names)
    }

    /// The position of the agent or entity (`what`) that a JSON string names.
    fn named(&self, raw: &'a RawValue, names: &HashMap<String, usize>, what: &str) -> Result<usize, Diagnostic> {
        let name: String = self.value(raw)?;
        names
            .get(&name)
            .copied()
            .ok_or_else(|| self.fault(raw, format!("the scene has no {what} `{name}`"), "unknown name"))
    }

    fn rows(
        &self,
        Entries(entries): Entries<'a>,
        names: &HashMap<String, usize>,
        what: &str,
    ) -> Result<Vec<GivenPredicate>, Diagnostic> {
        let mut given = Vec::new();
        for (name, raw) in entries {
            let Some(&(_, arity)) = self.terms.predicates.iter().find(|(known, _)| *known == name) else {
                let fault = self.fault(
                    raw,
                    format!("`{name}` is not a base predicate"),
                    "rows of an unknown predicate",
                );
                let known = self.terms.predicates.iter().map(|(known, _)| *known);
                return Err(match did_you_mean(&name, known.clone()) {
                    Some(known) => fault.help(format!("did you mean `{known}`?")),
                    None => fault.help(format!("base predicates are: {}", known.collect::<Vec<_>>().join(", "))),
                });
            };
            let mut rows = self
                .value::<Vec<&RawValue>>(raw)?
                .into_iter()
                .map(|row| self.row(row, arity, names, what))
                .collect::<Result<Vec<_>, _>>()?;
            rows.sort_unstable();
            rows.dedup();
            given.push(GivenPredicate { name, rows });
        }
        Ok(given)
    }

    /// A row: a list of names; a single name may stand alone.
    fn row(
        &self,
        raw: &'a RawValue,
        arity: usize,
        names: &HashMap<String, usize>,
        what: &str,
    ) -> Result<Vec<usize>, Diagnostic> {
        let terms = if raw.get().starts_with('[') {
            self.value::<Vec<&RawValue>>(raw)?
        } else {
            vec![raw]
        };
        if terms.len() != arity {
            let found = terms.len();
            return Err(self.fault(
                raw,
                format!("a row of {found} where the predicate has {arity}"),
                "wrong number of names",
            ));
        }
        terms.into_iter().map(|term| self.named(term, names, what)).collect()
    }

    fn value<T: Deserialize<'a>>(&self, raw: &'a RawValue) -> Result<T, Diagnostic> {
        self.read(raw.get(), self.offset(raw))
    }

    /// Reads JSON that begins at byte `offset` of the scene.
    fn read<T: Deserialize<'a>>(&self, json: &'a str, offset: usize) -> Result<T, Diagnostic> {
        serde_json::from_str(json).map_err(|error| {
            // A scene is a line, so its columns are bytes from its beginning; `column` is 0 where the fault is the value as a whole.
            let text = error.to_string();
            let text = text.split(" at line ").next().unwrap_or(&text);
            let lines_before = json.split('\n').take(error.line().saturating_sub(1));
            let byte = lines_before.map(|line| line.len() + 1).sum::<usize>() + error.column().saturating_sub(1);
            let start = offset + byte.min(json.len());
            let span = if error.column() == 0 {
                offset..offset + json.len()
            } else {
                start..start + 1
            };
            Diagnostic::new(Code::InvalidScene, format!("not a scene: {text}"))
                .at(Span::new(self.source, span), "")
                .help("configs/README.md describes the two forms of a scene")
        })
    }

    /// Where a part of the scene begins: its text is a part of ours.
    fn offset(&self, raw: &RawValue) -> usize {
        (raw.get().as_ptr() as usize).saturating_sub(self.text.as_ptr() as usize)
    }

    fn span(&self, raw: &RawValue) -> Span {
        let start = self.offset(raw);
        Span::new(self.source, start..start + raw.get().len())
    }

    fn fault(&self, raw: &RawValue, message: String, label: &str) -> Diagnostic {
        Diagnostic::new(Code::InvalidScene, message).at(self.span(raw), label)
    }
}

impl GeometricScene {
    /// Checks that every agent is on the map.
    ///
    /// # Errors
    /// `invalid-scene` at the first agent that is not.
    pub fn check_cells(&self, map: &CityMap) -> Result<(), Diagnostic> {
        match self.agents.iter().find(|agent| !map.contains(agent.at)) {
            None => Ok(()),
            Some(agent) => Err(Diagnostic::new(
                Code::InvalidScene,
                format!("`{}` is not on the map `{}`", agent.id, map.name),
            )
            .at(agent.span, format!("at [{}, {}]", agent.at.row, agent.at.col))
            .help(format!(
                "rows are 0 to {}, columns 0 to {}",
                map.rows() - 1,
                map.cols() - 1
            ))),
        }
    }
}
