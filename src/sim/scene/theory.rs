//! What the predicates of a configuration can be at once, by their definitions and for the agents of its city.

use crate::city::{AgentKind, AgentSet, Cell, CityMap};
use crate::config::{PredicateConfig, Scenario};
use crate::datalog::{BaseType, PredicateId, Rules};
use crate::diag::{Diagnostic, Span};
use crate::predicate::{Concept, Definition, Situations, Together};
use std::collections::{BTreeSet, HashMap, HashSet};
use std::sync::Arc;

/// A configuration prepared to judge rules.
#[derive(Clone, Debug)]
pub struct CityTheory {
    /// The configuration.
    pub scenario: Scenario,
    map: Arc<CityMap>,
    pub(super) situations: Situations,
    pub(super) profiles: Vec<Profile>,
    /// Whether two agents of one set can have different priorities.
    ranked: bool,
    /// The maximum number of agents that are in the city at once.
    agents_max: usize,
}

/// What agents are: equal agents count once.
#[derive(Clone, Debug)]
pub(super) struct Profile {
    pub kind: AgentKind,
    pub concepts: Arc<[String]>,
    /// The first of these agents, for messages.
    pub name: String,
    /// The place of its set.
    pub span: Span,
}

/// An input of the rules that the configuration defines.
#[derive(Clone, Copy)]
pub(super) struct Known<'s> {
    pub predicate: PredicateId,
    /// Its position in the configuration.
    pub position: usize,
    pub config: &'s PredicateConfig,
}

/// The inputs of rules that the configuration defines, without those that also have facts in the source.
pub(super) struct KnownInputs<'s> {
    /// In the order of the configuration.
    pub list: Vec<Known<'s>>,
    /// The positions in the list.
    by_predicate: HashMap<PredicateId, usize>,
}

impl<'s> KnownInputs<'s> {
    pub fn new(scenario: &'s Scenario, rules: &Rules) -> KnownInputs<'s> {
        let mut has_facts = vec![false; rules.predicates.len()];
        for clause in &rules.clauses {
            has_facts[clause.head.predicate.index()] = true;
        }
        let by_name = rules.predicates_by_name();
        let known = scenario.predicates.iter().enumerate().filter_map(|(position, config)| {
            let predicate = *by_name.get(config.name.value.as_str())?;
            let declared = &rules.predicates[predicate.index()];
            let fits = declared.arity() == config.definition.arity()
                && declared.columns.iter().all(|column| column.base == BaseType::Symbol);
            (declared.input && fits && !has_facts[predicate.index()]).then_some(Known {
                predicate,
                position,
                config,
            })
        });
        let list: Vec<Known<'_>> = known.collect();
        let by_predicate = list.iter().map(|known| known.predicate).zip(0..).collect();
        KnownInputs { list, by_predicate }
    }

    pub fn find(&self, predicate: PredicateId) -> Option<Known<'s>> {
        self.by_predicate.get(&predicate).map(|&at| self.list[at])
    }
}

impl CityTheory {
    /// Prepares a configuration.
    ///
    /// # Errors
    /// The map cannot be generated.
    pub fn new(scenario: Scenario) -> Result<CityTheory, Diagnostic> {
        let map = Arc::new(CityMap::generate(&scenario.map)?);
        let mut profiles: Vec<Profile> = Vec::new();
        let mut known: HashSet<(AgentKind, Arc<[String]>)> = HashSet::new();
        let mut add = |kind, concepts: &Arc<[String]>, name: String, span| {
            if known.insert((kind, Arc::clone(concepts))) {
                let concepts = Arc::clone(concepts);
                profiles.push(Profile {
                    kind,
                    concepts,
                    name,
                    span,
                });
            }
        };
        for (split, set) in &scenario.splits {
            for (first, groups) in set.kinds() {
                let mut number = 1;
                for group in groups {
                    let name = format!("`{}_{number}` of `{}`", first.kind_name(), split.name());
                    add(first.kind, &group.concepts, name, set.span);
                    number += u64::from(group.count);
                }
            }
        }
        let ego = scenario.task.iter().filter_map(|task| Some((task, task.ego.as_ref()?)));
        let mut ranked = scenario.splits.iter().any(|(_, set)| is_ranked(set));
        for (task, ego) in ego {
            for (weight, concepts) in &ego.concepts {
                if *weight > 0.0 {
                    add(AgentKind::Car, concepts, "the ego".to_owned(), task.span);
                }
            }
            ranked |= ego.priority.iter().any(|most| *most > 1);
        }
        let kinds: Vec<AgentKind> = (AgentKind::ALL.into_iter())
            .filter(|kind| profiles.iter().any(|profile| profile.kind == *kind))
            .collect();
        let definitions = scenario.predicates.iter().map(|predicate| &predicate.definition);
        Ok(CityTheory {
            situations: Situations::new(definitions, &kinds, &map, scenario.view),
            map,
            profiles,
            ranked,
            agents_max: scenario.splits.iter().map(|(_, set)| set.len()).max().unwrap_or(0),
            scenario,
        })
    }

    /// Returns the most agents that are in the city at once.
    pub fn agents_max(&self) -> usize {
        self.agents_max
    }

    /// Returns the truth values of two predicates over one agent for agents with any concepts.
    pub(super) fn defined(&self, one: &Definition, other: &Definition) -> Together {
        let mut together = Together::default();
        let concept = |definition: &Definition| definition.concept().map(|Concept { concept, .. }| concept.clone());
        let concepts: BTreeSet<String> = [one, other].into_iter().filter_map(concept).collect();
        let concepts: Vec<String> = concepts.into_iter().collect();
        for kind in AgentKind::ALL {
            for chosen in 0..1_usize << concepts.len() {
                let carried = concepts.iter().enumerate().filter(|(bit, _)| chosen >> bit & 1 != 0);
                let carried: Vec<String> = carried.map(|(_, concept)| concept.clone()).collect();
                for cell in &self.situations.cells[kind as usize] {
                    let [a, b] = [one, other].map(|definition| self.holds(definition, kind, &carried, *cell));
                    together.add(a, b);
                }
            }
        }
        together
    }

    /// Returns the truth values of two predicates over one agent for the agents of the city, and the first agent for
    /// which `wanted` holds of them.
    pub(super) fn carried(
        &self,
        one: &Definition,
        other: &Definition,
        wanted: impl Fn(bool, bool) -> bool,
    ) -> (Together, Option<&Profile>) {
        let (mut together, mut first) = (Together::default(), None);
        for profile in &self.profiles {
            for cell in &self.situations.cells[profile.kind as usize] {
                let [a, b] =
                    [one, other].map(|definition| self.holds(definition, profile.kind, &profile.concepts, *cell));
                together.add(a, b);
                if wanted(a, b) {
                    first.get_or_insert(profile);
                }
            }
        }
        (together, first)
    }

    /// Returns whether the known situations of one agent have all truth values of a predicate.
    pub(super) fn distinguishes(&self, definition: &Definition) -> bool {
        match definition {
            Definition::Place(_) => self.situations.distinguish_places,
            Definition::External(_) => false,
            _ => true,
        }
    }

    /// Returns whether a predicate over one agent holds.
    pub(super) fn holds(&self, definition: &Definition, kind: AgentKind, concepts: &[String], at: Cell) -> bool {
        match definition {
            Definition::Static(predicate) => predicate.holds(kind, concepts),
            Definition::Local(predicate) => predicate.holds(&self.map, kind, at),
            Definition::Place(predicate) => predicate.holds(&self.map, at),
            Definition::Pair(_) | Definition::Quantity(_) | Definition::External(_) => false,
        }
    }

    /// Returns the inputs that only a road network can have rows of, on a map of blocks.
    pub(super) fn without_roads(&self, rules: &Rules) -> Vec<PredicateId> {
        let predicates = self.scenario.predicates.iter();
        let needy = predicates.filter(|config| self.map.network().is_none() && config.definition.needs_roads());
        let names: HashSet<&str> = needy.map(|config| config.name.value.as_str()).collect();
        let declared = rules.predicates.iter().zip((0..).map(PredicateId));
        let inputs = declared.filter(|(predicate, _)| predicate.input && names.contains(predicate.name.as_str()));
        inputs.map(|(_, id)| id).collect()
    }

    /// Returns whether a predicate has no rows in the city.
    pub(super) fn is_empty(&self, one: Known<'_>) -> bool {
        let definition = &one.config.definition;
        if definition.arity() == 1 {
            if !self.distinguishes(definition) {
                return false;
            }
            let (together, _) = self.carried(definition, definition, |_, _| false);
            return !together.both;
        }
        let alone = self.agents_max < 2 || definition.is_ranking() && !self.ranked;
        let never = self.situations.complete && !self.situations.pair(one.position, one.position).both;
        !definition.is_reflexive() && self.situations.covers(one.position) && (alone || never)
    }
}

/// Returns whether two agents of a set have different priorities.
fn is_ranked(set: &AgentSet) -> bool {
    let mut priorities = set.entries().map(|group| group.priority);
    let first = priorities.next();
    priorities.any(|priority| Some(priority) != first)
}
