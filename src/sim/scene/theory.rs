//! The integrity constraints that hold in a city: declared ones that its configuration confirms, and further ones that
//! follow from the definitions of predicates and from the agents.

use crate::city::{AgentKind, AgentSet, CityMap, Junction};
use crate::config::{PredicateConfig, Scenario};
use crate::datalog::{BaseType, Constraint, DeclaredConstraint, Literal, RelId, Rules};
use crate::diag::{Code, Diagnostic, Span};
use crate::predicate::{Concept, Definition, Local, Situations, Static, Together};
use std::collections::BTreeSet;
use std::sync::Arc;

/// A configuration prepared to judge rules.
#[derive(Clone, Debug)]
pub struct CityTheory {
    /// The configuration.
    pub scenario: Scenario,
    situations: Situations,
    profiles: Vec<Profile>,
    /// Whether two agents of one set can have different priorities.
    ranked: bool,
    /// The most agents that are in the city at once.
    agents_max: usize,
}

/// The integrity constraints of rules in a city.
#[derive(Clone, Debug, Default)]
pub struct CityConstraints {
    /// The constraints that the definitions of predicates imply, and declared ones about which the configuration says
    /// nothing.
    pub by_definition: Vec<DeclaredConstraint>,
    /// These, and those that hold because the city has no other agents.
    pub of_agents: Vec<DeclaredConstraint>,
    /// The predicates without rows in the city.
    pub empty: Vec<RelId>,
    /// The faults of declared constraints that the configuration contradicts.
    pub faults: Vec<Diagnostic>,
}

/// What agents are: equal agents count once.
#[derive(Clone, Debug)]
struct Profile {
    kind: AgentKind,
    concepts: Arc<[String]>,
    /// The first of these agents, for messages.
    name: String,
    /// The place of its set.
    span: Span,
}

/// An input of the rules that the configuration defines.
#[derive(Clone, Copy)]
struct Known<'s> {
    relation: RelId,
    /// Its position in the configuration.
    position: usize,
    config: &'s PredicateConfig,
}

/// The maximum number of predicates of one arity among which constraints are derived.
const DERIVED_MAX: usize = 64;

impl CityTheory {
    /// Prepares a configuration.
    ///
    /// # Errors
    /// The map cannot be generated.
    pub fn new(scenario: Scenario) -> Result<CityTheory, Diagnostic> {
        let map = CityMap::generate(&scenario.map)?;
        let mut profiles: Vec<Profile> = Vec::new();
        let mut add = |kind, concepts: &Arc<[String]>, name: String, span| {
            let is_same = |known: &Profile| known.kind == kind && known.concepts == *concepts;
            if !profiles.iter().any(is_same) {
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
            for (kind, groups) in [(AgentKind::Car, &set.cars), (AgentKind::Pedestrian, &set.pedestrians)] {
                let mut number = 1;
                for group in groups {
                    let name = format!("`{}_{number}` of `{}`", kind.name(), split.name());
                    add(kind, &group.concepts, name, set.span);
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

    /// Returns the constraints that hold for the predicates of rules in this city.
    pub fn constraints(&self, rules: &Rules) -> CityConstraints {
        let known = self.known(rules);
        let mut found = CityConstraints::default();
        for declared in &rules.constraints {
            match self.judge(&declared.constraint, &declared.domain, &known) {
                Verdict::ByDefinition | Verdict::Unknown => {
                    found.by_definition.push(declared.clone());
                    found.of_agents.push(declared.clone());
                }
                Verdict::OfAgents => found.of_agents.push(declared.clone()),
                Verdict::Contradicted(reason, span) => {
                    let fault = self.contradiction(rules, declared, &known, reason, span);
                    found.faults.push(fault);
                }
            }
        }
        self.derive(rules, &known, &mut found);
        found
    }

    /// Returns the inputs of the rules that the configuration defines, without those that also have facts in the text.
    fn known(&self, rules: &Rules) -> Vec<Known<'_>> {
        let mut has_facts = vec![false; rules.relations.len()];
        for clause in &rules.clauses {
            has_facts[clause.head.relation.index()] = true;
        }
        let predicates = self.scenario.predicates.iter().enumerate();
        let known = predicates.filter_map(|(position, config)| {
            let relation = rules.relation(&config.name.value)?;
            let declared = &rules.relations[relation.index()];
            let fits = declared.arity() == config.definition.arity()
                && declared.columns.iter().all(|column| column.base == BaseType::Symbol);
            (declared.input && fits && !has_facts[relation.index()]).then_some(Known {
                relation,
                position,
                config,
            })
        });
        known.collect()
    }

    // --- what predicates can be at once

    /// Returns the truth values of two predicates over one agent for agents with any concepts.
    fn defined(&self, one: &Definition, other: &Definition) -> Together {
        let mut together = Together::default();
        let concept = |definition: &Definition| definition.concept().map(|Concept { concept, .. }| concept.clone());
        let concepts: BTreeSet<String> = [one, other].into_iter().filter_map(concept).collect();
        let concepts: Vec<String> = concepts.into_iter().collect();
        for kind in AgentKind::ALL {
            for chosen in 0..1_usize << concepts.len() {
                let carried = concepts.iter().enumerate().filter(|(bit, _)| chosen >> bit & 1 != 0);
                let carried: Vec<String> = carried.map(|(_, concept)| concept.clone()).collect();
                for junction in &self.situations.junctions[kind as usize] {
                    let [a, b] = [one, other].map(|definition| holds(definition, kind, &carried, *junction));
                    together.add(a, b);
                }
            }
        }
        together
    }

    /// Returns the truth values of two predicates over one agent for the agents of the city, and the first agent for
    /// which `wanted` holds of them.
    fn carried(
        &self,
        one: &Definition,
        other: &Definition,
        wanted: impl Fn(bool, bool) -> bool,
    ) -> (Together, Option<&Profile>) {
        let (mut together, mut first) = (Together::default(), None);
        for profile in &self.profiles {
            for junction in &self.situations.junctions[profile.kind as usize] {
                let [a, b] =
                    [one, other].map(|definition| holds(definition, profile.kind, &profile.concepts, *junction));
                together.add(a, b);
                if wanted(a, b) {
                    first.get_or_insert(profile);
                }
            }
        }
        (together, first)
    }

    /// Returns whether a predicate has no rows in the city.
    fn is_empty(&self, one: Known<'_>) -> bool {
        let definition = &one.config.definition;
        if definition.arity() == 1 {
            let (together, _) = self.carried(definition, definition, |_, _| false);
            return !together.both;
        }
        let alone = self.agents_max < 2 || definition.is_ranking() && !self.ranked;
        let never = self.situations.complete && !self.situations.pair(one.position, one.position).both;
        !definition.is_reflexive() && self.situations.covers(one.position) && (alone || never)
    }

    // --- declared constraints

    fn judge(&self, constraint: &Constraint, domain: &[(RelId, usize)], known: &[Known<'_>]) -> Verdict {
        let find = |relation: RelId| known.iter().find(|known| known.relation == relation).copied();
        let of = |relation: RelId| find(relation).map(|known| &known.config.definition);
        match *constraint {
            Constraint::Disjoint(a, b) | Constraint::Implies(a, b) => {
                let implies = matches!(constraint, Constraint::Implies(..));
                match (find(a), find(b)) {
                    (Some(a), Some(b)) if a.config.definition.arity() != b.config.definition.arity() => {
                        Verdict::Unknown
                    }
                    (Some(a), Some(b)) if a.config.definition.arity() == 1 => self.judge_unary(a, b, implies),
                    (Some(a), Some(b)) => self.judge_pair(a, b, implies),
                    _ => Verdict::Unknown,
                }
            }
            Constraint::Covering(ref relations) => {
                let definitions: Option<Vec<&Definition>> = relations.iter().map(|&relation| of(relation)).collect();
                let is_agent = |(relation, _): &(RelId, usize)| of(*relation).is_some_and(Definition::is_reflexive);
                match definitions {
                    Some(definitions) => self.judge_cover(&definitions, domain.iter().any(is_agent)),
                    None => Verdict::Unknown,
                }
            }
            Constraint::Reflexive(a) => match of(a) {
                Some(definition) if definition.is_reflexive() => Verdict::ByDefinition,
                Some(_) => Verdict::contradicted("it relates no agent to itself"),
                None => Verdict::Unknown,
            },
            Constraint::Irreflexive(a) => match of(a) {
                Some(definition) if definition.is_reflexive() => {
                    Verdict::contradicted("it relates every agent to itself")
                }
                Some(_) => Verdict::ByDefinition,
                None => Verdict::Unknown,
            },
            Constraint::Symmetric(a) | Constraint::Asymmetric(a) => {
                let symmetric = matches!(constraint, Constraint::Symmetric(_));
                match find(a) {
                    Some(a) => self.judge_reversed(a, symmetric),
                    None => Verdict::Unknown,
                }
            }
        }
    }

    fn judge_unary(&self, a: Known<'_>, b: Known<'_>, implies: bool) -> Verdict {
        let (one, other) = (&a.config.definition, &b.config.definition);
        let [first, second] = [a, b].map(|known| &known.config.name.value);
        let defined = self.defined(one, other);
        let (fails, only_vacuous) = match implies {
            true => (defined.first_only, !defined.both),
            false => (defined.both, !defined.first_only),
        };
        if !fails {
            return Verdict::ByDefinition;
        }
        if only_vacuous {
            return Verdict::contradicted(match implies {
                true => format!("no agent is both `{first}` and `{second}`"),
                false => format!("every `{first}` is `{second}`"),
            });
        }
        let (_, found) = self.carried(one, other, |a, b| a && b != implies);
        match found {
            Some(Profile { name, span, .. }) if implies => {
                Verdict::Contradicted(format!("{name} can be `{first}` without `{second}`"), Some(*span))
            }
            Some(Profile { name, span, .. }) => {
                Verdict::Contradicted(format!("{name} can be both `{first}` and `{second}`"), Some(*span))
            }
            None => Verdict::OfAgents,
        }
    }

    fn judge_pair(&self, a: Known<'_>, b: Known<'_>, implies: bool) -> Verdict {
        let situations = &self.situations;
        if !situations.covers(a.position) || !situations.covers(b.position) {
            return Verdict::Unknown;
        }
        if self.is_empty(a) || !implies && self.is_empty(b) {
            return Verdict::OfAgents;
        }
        let together = situations.pair(a.position, b.position);
        let fails = if implies { together.first_only } else { together.both };
        let [first, second] = [a, b].map(|known| &known.config.name.value);
        match fails {
            false if situations.complete => Verdict::ByDefinition,
            false => Verdict::Unknown,
            true => {
                let place = match situations.example(a.position, Some(b.position), !implies) {
                    Some([rows, cols]) => format!("for two agents {rows} rows and {cols} columns apart"),
                    None => "for an agent and itself".to_owned(),
                };
                Verdict::contradicted(match implies {
                    true => format!("`{first}` can hold without `{second}` {place}"),
                    false => format!("`{first}` and `{second}` can both hold {place}"),
                })
            }
        }
    }

    fn judge_reversed(&self, a: Known<'_>, symmetric: bool) -> Verdict {
        let (situations, name) = (&self.situations, &a.config.name.value);
        if !situations.covers(a.position) {
            return Verdict::Unknown;
        }
        if !symmetric && a.config.definition.is_reflexive() {
            return Verdict::contradicted("it relates every agent to itself");
        }
        if self.is_empty(a) {
            return Verdict::OfAgents;
        }
        let together = situations.reversed(a.position);
        let fails = if symmetric { together.first_only } else { together.both };
        match fails {
            false if situations.complete => Verdict::ByDefinition,
            false => Verdict::Unknown,
            true => {
                let [rows, cols] = situations.example(a.position, None, !symmetric).unwrap_or_default();
                let order = if symmetric {
                    "in one order only"
                } else {
                    "in both orders"
                };
                Verdict::contradicted(format!(
                    "`{name}` can hold {order} for two agents {rows} rows and {cols} columns apart"
                ))
            }
        }
    }

    /// Judges whether each agent has one of the predicates. `all` says whether the domain of the constraint has every
    /// agent.
    fn judge_cover(&self, definitions: &[&Definition], all: bool) -> Verdict {
        if definitions.iter().any(|definition| definition.arity() != 1) {
            return Verdict::Unknown;
        }
        let covers = |kind, concepts: &[String]| {
            let junctions = &self.situations.junctions[kind as usize];
            let covered = |junction: &Junction| {
                let mut definitions = definitions.iter();
                definitions.any(|definition| holds(definition, kind, concepts, *junction))
            };
            junctions.iter().all(covered)
        };
        if AgentKind::ALL.into_iter().all(|kind| covers(kind, &[])) {
            return Verdict::ByDefinition;
        }
        match self
            .profiles
            .iter()
            .find(|profile| !covers(profile.kind, &profile.concepts))
        {
            None => Verdict::OfAgents,
            Some(Profile { name, span, .. }) if all => {
                Verdict::Contradicted(format!("{name} can be none of these"), Some(*span))
            }
            Some(_) => Verdict::Unknown,
        }
    }

    fn contradiction(
        &self,
        rules: &Rules,
        declared: &DeclaredConstraint,
        known: &[Known<'_>],
        reason: String,
        agents: Option<Span>,
    ) -> Diagnostic {
        let message = format!(
            "{} contradicts the configuration `{}`: {reason}",
            declared.constraint.show(rules),
            self.scenario.name
        );
        let mut fault = Diagnostic::new(Code::CONSTRAINT_MISMATCH, message).at(declared.span, "declared here");
        for relation in declared.constraint.relations() {
            if let Some(known) = known.iter().find(|known| known.relation == relation) {
                let name = &known.config.name;
                fault = fault.also(name.span, format!("`{}` is defined here", name.value));
            }
        }
        if let Some(agents) = agents {
            fault = fault.also(agents, "these agents");
        }
        let kind = match (&declared.constraint, agents) {
            (Constraint::Implies(one, _), None) => known.iter().find(|known| known.relation == *one),
            _ => None,
        };
        let kind = kind.and_then(|one| {
            let mut kinds = known
                .iter()
                .filter(|other| matches!(other.config.definition, Definition::Static(Static::Kind(_))));
            let implied = kinds.find(|other| {
                !self
                    .defined(&one.config.definition, &other.config.definition)
                    .first_only
            })?;
            Some((one, implied))
        });
        fault.help(match kind {
            Some((one, kind)) => format!(
                "write `.implies {}, {}`, or change the definition",
                one.config.name.value, kind.config.name.value
            ),
            None => "remove the constraint, or change the configuration".to_owned(),
        })
    }

    // --- derived constraints

    fn derive(&self, rules: &Rules, known: &[Known<'_>], found: &mut CityConstraints) {
        let mut read = vec![false; rules.relations.len()];
        for atom in rules
            .clauses
            .iter()
            .flat_map(|clause| clause.body.iter().filter_map(Literal::atom))
        {
            read[atom.relation.index()] = true;
        }
        for constraint in &rules.constraints {
            constraint
                .constraint
                .relations()
                .for_each(|relation| read[relation.index()] = true);
        }
        let read: Vec<Known<'_>> = known
            .iter()
            .copied()
            .filter(|known| read[known.relation.index()])
            .collect();
        let mut add = |constraint: Constraint, domain: Vec<(RelId, usize)>, span: Span, of_agents: bool| {
            let is_same = |one: &DeclaredConstraint| {
                one.constraint == constraint
                    || match (&one.constraint, &constraint) {
                        (Constraint::Disjoint(a, b), Constraint::Disjoint(c, d)) => (a, b) == (d, c),
                        _ => false,
                    }
            };
            if found.of_agents.iter().any(is_same) {
                return;
            }
            let one = DeclaredConstraint {
                constraint,
                domain,
                span,
                inferred: true,
            };
            if !of_agents {
                found.by_definition.push(one.clone());
            }
            found.of_agents.push(one);
        };
        let agents = self.scenario.splits.first().map(|(_, set)| set.span);
        for one in &read {
            let span = one.config.name.span;
            if self.is_empty(*one) {
                found.empty.push(one.relation);
                add(
                    Constraint::Disjoint(one.relation, one.relation),
                    Vec::new(),
                    agents.unwrap_or(span),
                    true,
                );
            } else if one.config.definition.arity() == 2 {
                for constraint in [Constraint::Irreflexive, Constraint::Symmetric, Constraint::Asymmetric] {
                    let constraint = constraint(one.relation);
                    if matches!(self.judge(&constraint, &[], known), Verdict::ByDefinition) {
                        add(constraint, Vec::new(), span, false);
                    }
                }
            }
            if one.config.definition.is_reflexive() {
                let ty = rules.relations[one.relation.index()].columns[0].ty;
                add(Constraint::Reflexive(one.relation), rules.columns_of(ty), span, false);
            }
        }
        let kinds: Vec<&Known<'_>> = (read.iter())
            .filter(|one| matches!(one.config.definition, Definition::Static(Static::Kind(_))))
            .collect();
        if let Some(first) = kinds.first() {
            let cover = Constraint::Covering(kinds.iter().map(|kind| kind.relation).collect());
            let domain = rules.columns_of(rules.relations[first.relation.index()].columns[0].ty);
            if matches!(self.judge(&cover, &domain, known), Verdict::ByDefinition) {
                add(cover, domain, first.config.name.span, false);
            }
        }
        for arity in [1, 2] {
            let same: Vec<&Known<'_>> = (read.iter())
                .filter(|one| one.config.definition.arity() == arity && !self.is_empty(**one))
                .take(DERIVED_MAX)
                .collect();
            for (at, one) in same.iter().enumerate() {
                for other in &same[at + 1..] {
                    let (a, b) = (one.relation, other.relation);
                    for (constraint, span) in [
                        (Constraint::Disjoint(a, b), one.config.name.span),
                        (Constraint::Implies(a, b), one.config.name.span),
                        (Constraint::Implies(b, a), other.config.name.span),
                    ] {
                        match self.judge(&constraint, &[], known) {
                            Verdict::ByDefinition => add(constraint, Vec::new(), span, false),
                            Verdict::OfAgents => add(constraint, Vec::new(), agents.unwrap_or(span), true),
                            Verdict::Contradicted(..) | Verdict::Unknown => {}
                        }
                    }
                }
            }
        }
    }
}

/// What a configuration says about a constraint.
enum Verdict {
    /// The definitions imply it.
    ByDefinition,
    /// It holds for the agents of the city.
    OfAgents,
    /// It does not hold: the reason, and the place of the agents for which it does not.
    Contradicted(String, Option<Span>),
    Unknown,
}

impl Verdict {
    fn contradicted(reason: impl Into<String>) -> Verdict {
        Verdict::Contradicted(reason.into(), None)
    }
}

/// Returns whether two agents of a set have different priorities.
fn is_ranked(set: &AgentSet) -> bool {
    let mut priorities = set.entries().map(|group| group.priority);
    let first = priorities.next();
    priorities.any(|priority| Some(priority) != first)
}

/// Returns whether a predicate over one agent holds.
fn holds(definition: &Definition, kind: AgentKind, concepts: &[String], junction: Junction) -> bool {
    match definition {
        Definition::Static(predicate) => predicate.holds(kind, concepts),
        Definition::Local(predicate) => Local::table(predicate).holds(junction, kind),
        Definition::Pair(_) => false,
    }
}
