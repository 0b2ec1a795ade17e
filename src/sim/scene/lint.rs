//! Warnings of rules that mean something else in the city than they seem to.

use crate::city::{Action, ActionTable, AgentKind, AgentSet, KindId, OwnKind, Region};
use crate::config::{ActionsConfig, PredicateConfig, SEES, Scenario};
use crate::datalog::diff::Difference;
use crate::datalog::optimize::{self, Lints};
use crate::datalog::{
    self, Atom, Clause, ClauseId, Comparison, Constraint, DeclaredConstraint, Function, Literal, Predicate,
    PredicateId, Rules, Term, TypeId, Value, VarId,
};
use crate::diag::{Diagnostic, Faults, MAX_FAULTS, SourceId, Sources, Span, did_you_mean, listed};
use crate::located::Located;
use crate::predicate::{Definition, Static};
use crate::sim::codes;
use crate::sim::scene::conflict::{Finding, Overlap, earlier_facts};
use crate::sim::scene::empty::empty_predicates;
use crate::sim::scene::theory::CityTheory;
use crate::symbol::Symbol;
use std::collections::{BTreeMap, BTreeSet, HashMap, HashSet};
use std::path::Path;

/// The predicate of the shipped vocabulary that announces collisions.
const SHIPPED_COLLISION: &str = "CollidingClose";

/// What static checks find in rules.
#[derive(Clone, Debug)]
pub struct Examined {
    /// The rules with the constraints that the definitions of predicates imply, instead of the declared ones. Without a
    /// configuration, the rules as they are.
    pub rules: Rules,
    /// The rules with all constraints that hold in the city. Without a configuration, the rules as they are.
    pub in_city: Rules,
    /// Errors and warnings.
    pub diagnostics: Vec<Diagnostic>,
    /// Literals and clauses that are always true or redundant.
    pub hints: Vec<Diagnostic>,
    /// The checks for hints that hit a limit.
    pub unfinished: Vec<&'static str>,
}

/// Checks rules that decide in a city. Reports
///
/// - declared constraints that the configuration contradicts;
/// - clauses whose bodies contradict themselves, given the constraints that hold in the city;
/// - constants that name no agent ([`agent_lints`]), variables with the names of agents, and missing clauses against
///   collisions, for rules that decide actions;
/// - predicates that no agent has, with the clauses that never fire for this reason;
/// - predicates that are not actions and that no clause reads;
/// - actions that no clause derives, and clauses that derive actions of other kinds of agents;
/// - definitions of predicates that the rules do not declare;
/// - kinds that no agent has, and zones that no predicate tests.
///
/// Without a configuration, the declared constraints count, collisions are announced by the predicate of the shipped
/// vocabulary, and only the rules alone are judged.
pub fn examine(rules: &Rules, city: Option<&CityTheory>, sources: &Sources) -> Examined {
    let functions = city.map_or_else(Vec::new, |city| city.functions(rules));
    let given = |constraints: &[DeclaredConstraint]| Rules {
        constraints: constraints.to_vec(),
        functions: functions.clone(),
        ..rules.clone()
    };
    let (mut by_definition, mut in_city) = (rules.clone(), rules.clone());
    let (mut diagnostics, mut empty) = (Vec::new(), Vec::new());
    if let Some(city) = city {
        let found = city.constraints(rules);
        by_definition = given(&found.by_definition);
        in_city = given(&found.of_agents);
        diagnostics = found.faults;
        empty = found.empty;
        diagnostics.extend(unknown_values(rules, &functions));
    }
    let Lints {
        diagnostics: lints,
        unfinished,
        ..
    } = optimize::lints(&by_definition, sources);
    let (contradictions, hints): (Vec<_>, Vec<_>) = lints
        .into_iter()
        .partition(|lint| lint.code == datalog::codes::CONTRADICTORY_BODY);
    diagnostics.extend(contradictions);
    if city.is_some() {
        // `empty_predicates` reports clauses that read an empty predicate.
        let is_reported =
            |one: &DeclaredConstraint| one.inferred && matches!(one.constraint, Constraint::Disjoint(a, b) if a == b);
        let mut of_agents = in_city.clone();
        of_agents.constraints.retain(|one| !is_reported(one));
        let lints = optimize::lints(&of_agents, sources).diagnostics;
        let place = |fault: &Diagnostic| fault.primary.as_ref().map(|label| label.span);
        let known: BTreeSet<Option<Span>> = diagnostics.iter().map(place).collect();
        let is_new =
            |lint: &Diagnostic| lint.code == datalog::codes::CONTRADICTORY_BODY && !known.contains(&place(lint));
        diagnostics.extend(lints.into_iter().filter(is_new));
    }
    let scenario = city.map(|city| &city.scenario);
    diagnostics.extend(scenario.into_iter().flat_map(|scenario| {
        let mut found = agent_lints(rules, scenario.splits.iter().map(|(_, set)| set));
        found.extend(empty_predicates(rules, scenario, &empty));
        found.extend(unread_predicates(rules, &scenario.actions.table));
        found.extend(unused_actions(rules, scenario));
        found.extend(unused_definitions(rules, scenario, sources));
        found.extend(unused_kinds(scenario, sources));
        found.extend(unused_zones(scenario));
        found
    }));
    let standard = ActionTable::default();
    let table = scenario.map_or(&standard, |scenario| &scenario.actions.table);
    let actions = decided_actions(rules, table);
    if !actions.is_empty() {
        let collisions: Vec<&str> = match scenario {
            Some(scenario) => (scenario.predicates.iter())
                .filter(|predicate| predicate.definition.is_collision())
                .map(|predicate| predicate.name.value.as_str())
                .collect(),
            None => vec![SHIPPED_COLLISION],
        };
        let kinds: Vec<String> = match scenario {
            Some(scenario) => (scenario.kinds.all())
                .map(|kind| scenario.kinds.name(kind).to_owned())
                .collect(),
            None => AgentKind::ALL.map(|kind| kind.name().to_owned()).into(),
        };
        diagnostics.extend(unquoted_agents(rules, &kinds));
        diagnostics.extend(no_collision_clause(rules, &collisions, &actions));
    }
    Examined {
        rules: by_definition,
        in_city,
        diagnostics: diagnostics.into_iter().collect::<Faults>().finish(),
        hints,
        unfinished,
    }
}

/// Warns of clauses that ask for a value that a quantity never has.
fn unknown_values(rules: &Rules, functions: &[Function]) -> Vec<Diagnostic> {
    let lint = |literal: &Literal| {
        let Literal::Positive(atom) = literal else { return None };
        let function = functions.iter().find(|function| function.predicate == atom.predicate)?;
        let (symbols, Some(Term::Constant(value))) = (function.symbols.as_ref()?, atom.terms.last()) else {
            return None;
        };
        let text = rules.symbols.resolve(Symbol(value.0))?;
        if symbols.iter().any(|symbol| symbol == text) {
            return None;
        }
        let name = &rules.predicates[atom.predicate.index()].name;
        let message = format!("this clause never fires: `{name}` never has the value `{text}`");
        let fault = Diagnostic::new(datalog::codes::DEAD_CLAUSE, message).at(atom.span, "");
        let quoted: Vec<String> = symbols.iter().map(|symbol| format!("`\"{symbol}\"`")).collect();
        Some(match did_you_mean(text, symbols.iter().map(String::as_str)) {
            Some(near) => fault.help(format!("did you mean `\"{near}\"`?")),
            None => fault.help(format!("its values are {}", listed(&quoted))),
        })
    };
    let literals = rules.clauses.iter().flat_map(|clause| &clause.body);
    literals.filter_map(lint).collect()
}

/// Warns of predicates that are not actions and that no clause reads: outputs, which a city does not write, and others
/// with clauses in a file that decides.
pub fn unread_predicates(rules: &Rules, table: &ActionTable) -> Vec<Diagnostic> {
    let atoms = (rules.clauses.iter()).flat_map(|clause| clause.body.iter().filter_map(Literal::atom));
    let read: BTreeSet<PredicateId> = atoms.map(|atom| atom.predicate).collect();
    let derived: BTreeSet<PredicateId> = rules.clauses.iter().map(|clause| clause.head.predicate).collect();
    // A file without a clause for an action offers words, of which a city may leave some unread.
    let decides = |clause: &&Clause| {
        let head = &rules.predicates[clause.head.predicate.index()];
        table.find(&head.name).is_some() && !clause.body.is_empty()
    };
    let deciding: HashSet<SourceId> = (rules.clauses.iter().filter(decides))
        .map(|clause| clause.span.source)
        .collect();
    let warn = |(predicate, id): (&Predicate, PredicateId)| {
        let name = &predicate.name;
        let is_unread = !predicate.hidden && !predicate.input && !read.contains(&id) && table.find(name).is_none();
        let (code, message) = match (predicate.output, derived.contains(&id)) {
            (true, _) if is_unread => (
                codes::UNUSED_OUTPUT,
                format!("`.output {name}` has no effect in a city: it is not an action, and no clause reads it"),
            ),
            (false, true) if is_unread && deciding.contains(&predicate.span.source) => (
                codes::UNREAD_PREDICATE,
                format!("`{name}` has no effect in a city: it is not an action, and no clause reads it"),
            ),
            _ => return None,
        };
        let fault = Diagnostic::new(code, message).at(predicate.span, "declared here");
        if let Some(near) = did_you_mean(name, table.names()) {
            return Some(fault.help(format!("did you mean `{near}`?")));
        }
        let names: Vec<String> = table.names().map(|action| format!("`{action}`")).collect();
        let (last, first) = names.split_last().expect("the standard actions");
        let mut actions = format!("the actions are {} and {last}", first.join(", "));
        if predicate.output {
            actions += "; `logicity query` prints other outputs";
        }
        let fault = fault.help(actions);
        Some(match predicate.columns.len() {
            1 => fault.help(format!(
                "if agents take `{name}`, define it: `actions: {{define: {{{name}: {{cells: {{Car: 1}}}}}}}}` in the \
                 configuration"
            )),
            _ => fault,
        })
    };
    rules
        .predicates
        .iter()
        .zip((0..).map(PredicateId))
        .filter_map(warn)
        .collect()
}

/// Warns of actions that no clause derives, unless there is a task, whose egos may take them, and of clauses that
/// derive an action only for kinds of agents that cannot take it.
fn unused_actions(rules: &Rules, scenario: &Scenario) -> Vec<Diagnostic> {
    let table = &scenario.actions.table;
    let own = || table.all().skip(Action::STANDARD.len()).zip(table.own());
    let clauses_of = |name: &str| {
        let predicate = rules.predicate(name);
        rules
            .clauses
            .iter()
            .filter(move |clause| Some(clause.head.predicate) == predicate)
    };
    let is_default = |action| {
        let orders = scenario.actions.of_kinds.iter().map(|own| own.default);
        orders
            .chain([scenario.actions.default])
            .any(|default| default == action)
    };
    let mut faults = Vec::new();
    for (action, own) in own().filter(|_| scenario.task.is_none()) {
        let name = &own.name.value;
        if !is_default(action) && clauses_of(name).next().is_none() {
            let message = format!("no clause derives the action `{name}`, so no agent takes it");
            let fault = Diagnostic::new(codes::UNUSED_ACTION, message).at(own.name.span, "defined here");
            let mut heads = rules
                .clauses
                .iter()
                .map(|clause| &rules.predicates[clause.head.predicate.index()].name);
            faults.push(match heads.find(|head| head.eq_ignore_ascii_case(name)) {
                Some(head) => fault.help(format!("the rules derive `{head}`: write the same name in both files")),
                None => fault.help(format!("add a clause for it, for example `{name}(X) :- IsAtInter(X).`")),
            });
        }
    }
    for (action, own) in own() {
        for clause in clauses_of(&own.name.value) {
            let kinds = kinds_of(clause, rules, scenario);
            if kinds.is_empty() || kinds.iter().any(|kind| table.can_take(*kind, action)) {
                continue;
            }
            let kinds: Vec<&str> = kinds.iter().map(|kind| scenario.kinds.name(*kind)).collect();
            let (name, kinds) = (&own.name.value, listed(&kinds));
            let message = format!("this clause derives `{name}` only for agents that cannot take it");
            faults.push(
                Diagnostic::new(codes::UNUSED_ACTION, message)
                    .at(clause.span, format!("holds only for {kinds}"))
                    .also(own.name.span, "its `cells` has none of these kinds")
                    .help("add the kind to `cells` of the action in the configuration"),
            );
        }
    }
    faults
}

/// Returns whether the configuration itself, not its base, has a place.
fn is_here(span: Span, scenario: &Scenario, sources: &Sources) -> bool {
    let stem = Path::new(sources.name(span.source)).file_stem();
    stem.is_some_and(|stem| stem.to_string_lossy() == scenario.name.as_str())
}

/// Warns of predicates that the configuration itself defines and that the rules do not declare, unless there is a task,
/// which observes them.
fn unused_definitions(rules: &Rules, scenario: &Scenario, sources: &Sources) -> Vec<Diagnostic> {
    let unused = scenario.predicates.iter().filter(|known| {
        let name = &known.name;
        scenario.task.is_none()
            && name.value != SEES
            && rules.predicate(&name.value).is_none()
            && is_here(name.span, scenario, sources)
    });
    let warn = |known: &PredicateConfig| {
        let name = &known.name.value;
        let message = format!("the rules do not declare `{name}`, so its definition has no effect");
        let fault = Diagnostic::new(codes::UNUSED_DEFINITION, message).at(known.name.span, "defined or used here");
        // Suggest only inputs that the configuration does not define.
        let is_defined = |name: &str| scenario.predicates.iter().any(|known| known.name.value == name);
        let inputs = (rules.predicates.iter()).filter(|predicate| predicate.input && !is_defined(&predicate.name));
        match did_you_mean(name, inputs.map(|predicate| predicate.name.as_str())) {
            Some(near) => fault.help(format!("did you mean `{near}`, which the rules declare?")),
            None => fault.help(format!(
                "declare it in the rules, `.decl {name}(...)` and `.input {name}`, or remove it"
            )),
        }
    };
    unused.map(warn).collect()
}

/// Warns of kinds that the configuration itself, not its base, defines, and that no agent has.
fn unused_kinds(scenario: &Scenario, sources: &Sources) -> Vec<Diagnostic> {
    let unused = scenario.kinds.own_with_ids().filter(|(kind, own)| {
        let has_agents = scenario.splits.iter().any(|(_, set)| set.count_of(*kind) > 0);
        is_here(own.name.span, scenario, sources) && !has_agents
    });
    let warn = |(_, own): (KindId, &OwnKind)| {
        let name = own.name.value.as_str();
        let message = format!("no agent of `{}` is a {name}", scenario.name);
        let fault = Diagnostic::new(codes::UNUSED_KIND, message).at(own.name.span, "defined here");
        fault.help(format!(
            "add agents to a split: `{name}: [{{count: 1, priority: 1}}]`, or remove the kind"
        ))
    };
    unused.map(warn).collect()
}

/// Warns of zones that no predicate tests and no region is, unless the map has a file of its own.
fn unused_zones(scenario: &Scenario) -> Vec<Diagnostic> {
    if scenario.map.name != scenario.name {
        return Vec::new();
    }
    let tested = scenario.predicates.iter().filter_map(|known| known.definition.zone());
    let regions = (scenario.splits.iter()).filter_map(|(_, set)| match &set.region.as_ref()?.value {
        Region::Zone(name) => Some(name.as_str()),
        Region::Side(_) => None,
    });
    let tested: BTreeSet<&str> = tested.map(|zone| zone.value.as_str()).chain(regions).collect();
    let zones = scenario.map.zones.iter().map(|zone| &zone.name);
    let warn = |zone: &Located<String>| {
        let name = &zone.value;
        let message = format!("no predicate tests the zone `{name}`, so it has no effect on the rules");
        let fault = Diagnostic::new(codes::UNUSED_ZONE, message).at(zone.span, "defined here");
        fault.help(format!(
            "define one: `predicates: {{define: {{In{}: {{zone: {name}}}}}}}`",
            capitalized(name)
        ))
    };
    zones
        .filter(|zone| !tested.contains(zone.value.as_str()))
        .map(warn)
        .collect()
}

/// Returns a name with a capital letter first, as names of predicates are.
fn capitalized(name: &str) -> String {
    let mut letters = name.chars();
    letters
        .next()
        .map_or_else(String::new, |first| first.to_uppercase().chain(letters).collect())
}

/// Returns the kinds of agents that can satisfy the body of a clause, judged by its atoms about kinds and concepts.
fn kinds_of(clause: &Clause, rules: &Rules, scenario: &Scenario) -> BTreeSet<KindId> {
    let definition = |atom: &Atom| {
        let name = rules.predicates[atom.predicate.index()].name.as_str();
        let config = scenario.predicates.iter().find(|config| config.name.value == name)?;
        match &config.definition {
            Definition::Static(definition) if atom.terms == clause.head.terms => Some(definition),
            _ => None,
        }
    };
    let (mut asked, mut refused) = (Vec::new(), Vec::new());
    for literal in &clause.body {
        match literal {
            Literal::Positive(atom) => asked.extend(definition(atom)),
            Literal::Negative(atom) => refused.extend(definition(atom)),
            _ => {}
        }
    }
    let sets = scenario.splits.iter().flat_map(|(_, set)| set.kinds());
    let groups = sets.flat_map(|(name, groups)| groups.iter().map(move |group| (name, group)));
    let fitting = groups.filter(|(name, group)| {
        let holds = |definition: &&Static| definition.holds(name.kind, &group.concepts);
        asked.iter().all(holds) && !refused.iter().any(holds)
    });
    fitting.map(|(name, _)| name.kind_id()).collect()
}

/// Returns one warning for each constant that stands for an agent, but names none of these agent sets.
pub fn agent_lints<'s>(rules: &Rules, sets: impl Iterator<Item = &'s AgentSet>) -> Vec<Diagnostic> {
    let action = Action::STANDARD
        .iter()
        .find_map(|action| rules.predicate(action.name()));
    let Some([agent]) = action.map(|action| rules.predicates[action.index()].columns.as_slice()) else {
        return Vec::new();
    };
    let agents = Agents::new(sets);
    let mut faults = Faults::default();
    let (mut reported, mut similar) = (HashSet::new(), HashMap::new());
    for (span, value) in (rules.clauses.iter()).flat_map(|clause| agent_constants(rules, clause, agent.ty)) {
        let Some(name) = rules.symbols.resolve(Symbol(value.0)) else {
            continue;
        };
        if agents.include(name) || !reported.insert((span, name)) {
            continue;
        }
        let fault = Diagnostic::new(codes::UNKNOWN_AGENT, format!("no agent has the name `{name}`"))
            .at(span, "holds for no agent")
            .note(format!("the agents are {}", agents.ranges));
        // `faults` drops the warnings of further names.
        if similar.len() < MAX_FAULTS {
            similar.entry(name).or_insert_with(|| agents.similar(name));
        }
        faults.push(match similar.get(name) {
            Some(Some(near)) => fault.help(format!("did you mean `\"{near}\"`?")),
            _ => fault,
        });
    }
    faults.finish()
}

/// The maximum number of agents of a kind among whose names a search finds a similar one.
const SIMILAR_MAX: usize = 1000;

/// The agents of some sets.
struct Agents {
    /// By the name of the kind: the number of agents in the largest set.
    counts: BTreeMap<KindId, (String, usize)>,
    /// Their names, for messages.
    ranges: String,
}

impl Agents {
    fn new<'s>(sets: impl Iterator<Item = &'s AgentSet>) -> Agents {
        let mut counts: BTreeMap<KindId, (String, usize)> = BTreeMap::new();
        for set in sets {
            for (name, _) in set.kinds() {
                let known = counts.entry(name.kind_id());
                let (_, count) = known.or_insert_with(|| (name.kind_name().to_owned(), 0));
                *count = set.count_of(name.kind_id()).max(*count);
            }
        }
        let ranges = counts.values().filter_map(|(kind, count)| match count {
            0 => None,
            1 => Some(format!("{kind}_1")),
            _ => Some(format!("{kind}_1 to {kind}_{count}")),
        });
        let ranges: Vec<String> = ranges.collect();
        Agents {
            counts,
            ranges: ranges.join(" and "),
        }
    }

    /// Returns whether an agent has this name.
    fn include(&self, name: &str) -> bool {
        self.counts.values().any(|(kind, count)| {
            let number = name.strip_prefix(kind.as_str()).and_then(|rest| rest.strip_prefix('_'));
            let number: Option<u32> = number.and_then(|number| number.parse().ok());
            number.is_some_and(|number| {
                let is_spelled_so = format!("{kind}_{number}") == name;
                is_spelled_so && number >= 1 && number as usize <= *count
            })
        })
    }

    /// Returns the name of an agent that is similar to this one.
    fn similar(&self, name: &str) -> Option<String> {
        let names = self.counts.values().flat_map(|(kind, count)| {
            let numbers = 1..=(*count).min(SIMILAR_MAX);
            numbers.map(move |number| format!("{kind}_{number}"))
        });
        let names: Vec<String> = names.collect();
        did_you_mean(name, names.iter().map(String::as_str)).map(str::to_owned)
    }
}

/// Returns the constants of a clause in columns of this type, and those that it equates with variables in such
/// columns, with the places of their literals.
fn agent_constants(rules: &Rules, clause: &Clause, agent: TypeId) -> Vec<(Span, Value)> {
    let atoms = clause.body.iter().filter_map(Literal::atom);
    let of_agents: Vec<(Span, Term)> = std::iter::once(&clause.head)
        .chain(atoms)
        .flat_map(|atom| {
            let columns = &rules.predicates[atom.predicate.index()].columns;
            let terms = atom.terms.iter().zip(columns).filter(|(_, column)| column.ty == agent);
            terms.map(|(term, _)| (atom.span, *term))
        })
        .collect();
    let is_agent = |term: &Term| of_agents.iter().any(|(_, known)| known == term);
    let compared = clause.body.iter().filter_map(|literal| match literal {
        Literal::Compare {
            op: Comparison::Equal,
            left,
            right,
            span,
            ..
        } => match (left, right) {
            (Term::Variable(_), Term::Constant(value)) if is_agent(left) => Some((*span, *value)),
            (Term::Constant(value), Term::Variable(_)) if is_agent(right) => Some((*span, *value)),
            _ => None,
        },
        _ => None,
    });
    let constants = of_agents.iter().filter_map(|(span, term)| match term {
        Term::Constant(value) => Some((*span, *value)),
        _ => None,
    });
    constants.chain(compared).collect()
}

/// Returns one warning for each pair of actions that can be derived together. The order of precedence decides which
/// action wins. There is no warning if the losing action is derived by default only.
pub fn conflict_lints(overlaps: &[Overlap], rules: &Rules, actions: &ActionsConfig) -> Vec<Diagnostic> {
    let together = overlaps.iter().filter_map(|overlap| match &overlap.finding {
        Finding::Together { clauses, scene } => Some((overlap, clauses, scene)),
        Finding::Excluded { .. } | Finding::NotFound(_) => None,
    });
    let decided = decided_actions(rules, &actions.table);
    let is_default = |action: Action| {
        let predicate = rules.predicate(actions.table.name(action));
        predicate.is_none_or(|predicate| !decided.contains(&predicate))
    };
    let together = together.filter(|(overlap, ..)| !is_default(overlap.loser(&actions.priority)));
    let lint = |(overlap, clauses, scene): (&Overlap, &[ClauseId; 2], &Difference)| {
        let spans = clauses.map(|clause| rules.clauses[clause.index()].span);
        let (winner, loser) = (overlap.winner(&actions.priority), overlap.loser(&actions.priority));
        let span_of = |action| spans[usize::from(action != overlap.actions[0])];
        let [wins, loses] = [winner, loser].map(|action| actions.table.name(action));
        let message = format!("the rules can derive {wins} and {loses} for one agent, and {wins} wins");
        let help = match span_of(winner) == span_of(loser) {
            true => Some("derive each action in a separate clause".to_owned()),
            false if is_default(winner) => None,
            false => Some(format!(
                "if {wins} should win, add `Not({wins}(X))` to the clause of {loses}"
            )),
        };
        let order = format!("if {loses} should win, put it before {wins} in `actions.priority`");
        let lint = Diagnostic::new(codes::ACTION_CONFLICT, message)
            .at(span_of(loser), format!("this clause derives {loses}"))
            .also(span_of(winner), format!("this one derives {wins}"))
            .note("`actions.priority` of the configuration is the order of precedence");
        let lint = match earlier_facts(scene, rules).as_slice() {
            [] => lint,
            earlier => lint.note(format!(
                "the example needs earlier ticks that make {} hold; whether there are such ticks is not decided",
                listed(earlier)
            )),
        };
        let others = (actions.of_kinds.iter()).filter(|own| overlap.winner(&own.priority) != winner);
        let others: Vec<&str> = others.map(|own| own.name.as_str()).collect();
        let lint = match others.is_empty() {
            true => lint,
            false => lint.note(format!("by their own `priority`, {loses} wins for {}", listed(&others))),
        };
        help.into_iter().fold(lint, Diagnostic::help).help(order)
    };
    together.map(lint).collect()
}

/// Returns the action predicates with a clause other than the default: one whose body is more than negated actions.
fn decided_actions(rules: &Rules, table: &ActionTable) -> Vec<PredicateId> {
    let actions: Vec<PredicateId> = (table.names())
        .filter_map(|action| rules.predicate(action))
        .filter(|predicate| rules.predicates[predicate.index()].columns.len() == 1)
        .collect();
    let own_view = |atom: &Atom| matches!(atom.terms.as_slice(), [one, other] if one == other);
    let is_default = |clause: &Clause| {
        clause.body.iter().all(|literal| match literal {
            Literal::Negative(atom) => actions.contains(&atom.predicate),
            Literal::Positive(atom) | Literal::Guard(atom) => own_view(atom),
            _ => false,
        })
    };
    let decided = |action: &PredicateId| {
        let mut clauses = rules.clauses.iter().filter(|clause| clause.head.predicate == *action);
        clauses.any(|clause| !is_default(clause))
    };
    actions.iter().copied().filter(decided).collect()
}

/// Warns if no clause derives an action other than the default one. In a run, the car of a task follows the rules, too.
pub fn no_decision(rules: &Rules, scenario: &Scenario) -> Option<Diagnostic> {
    let table = &scenario.actions.table;
    let default = rules.predicate(table.name(scenario.actions.default));
    let decided = decided_actions(rules, table);
    if decided.into_iter().any(|action| Some(action) != default) {
        return None;
    }
    let names: Vec<String> = table.names().map(|action| format!("`{action}`")).collect();
    let message = "no clause derives an action: all agents take the default one and may collide";
    let fault = Diagnostic::new(codes::UNUSED_ACTION, message);
    Some(fault.help(format!("the actions are {}", listed(&names))))
}

/// Warns if no clause for an action depends on a predicate that announces collisions.
fn no_collision_clause(rules: &Rules, collisions: &[&str], actions: &[PredicateId]) -> Option<Diagnostic> {
    let known = |name: &&str| {
        rules
            .predicate(name)
            .is_some_and(|known| rules.predicates[known.index()].input)
    };
    let collision = *collisions.iter().find(|name| known(name))?;
    let mut reads: BTreeMap<PredicateId, BTreeSet<PredicateId>> = BTreeMap::new();
    for clause in &rules.clauses {
        let atoms = clause.body.iter().filter_map(Literal::atom);
        let read = reads.entry(clause.head.predicate).or_default();
        read.extend(atoms.map(|atom| atom.predicate));
    }
    let (mut open, mut seen) = (actions.to_vec(), BTreeSet::new());
    while let Some(predicate) = open.pop() {
        if seen.insert(predicate) {
            open.extend(reads.get(&predicate).into_iter().flatten());
        }
    }
    let is_read = |name: &&str| rules.predicate(name).is_some_and(|predicate| seen.contains(&predicate));
    if collisions.iter().any(is_read) {
        return None;
    }
    let mut clauses = rules.clauses.iter();
    let first = clauses.find(|clause| actions.contains(&clause.head.predicate))?;
    let message = format!("no clause for an action reads `{collision}`, so cars drive through others");
    let fault = Diagnostic::new(codes::NO_COLLISION_CLAUSE, message).at(first.head.span, "these rules decide actions");
    Some(fault.help(format!("add `Stop(X) :- {collision}(X, Y).`")))
}

/// Warns of variables whose names are those of agents: `Car_2` without quotes.
fn unquoted_agents(rules: &Rules, kinds: &[String]) -> Vec<Diagnostic> {
    let mut found: BTreeMap<Span, Diagnostic> = BTreeMap::new();
    for clause in &rules.clauses {
        let variables = clause.variables.iter().zip(&clause.variable_spans);
        for ((name, &span), id) in variables.zip((0..).map(VarId)) {
            let uses = |literal: &&Literal| {
                !matches!(literal, Literal::Guard(_)) && literal.terms().any(|term| *term == Term::Variable(id))
            };
            if !is_agent(name, kinds) {
                continue;
            }
            let literals: Vec<&Literal> = clause.body.iter().filter(uses).collect();
            let in_head = clause.head.terms.contains(&Term::Variable(id));
            // Loading reports an equation that is always true.
            if matches!(literals.as_slice(), [Literal::Compare { .. }]) && !in_head {
                continue;
            }
            let message = format!("`{name}` is a variable, not the agent of that name");
            let fault = Diagnostic::new(codes::UNQUOTED_AGENT, message)
                .at(span, "stands for any agent")
                .help(format!(
                    "write `\"{name}\"` for the agent, or rename the variable, for example to `Y`"
                ));
            found.entry(span).or_insert(fault);
        }
    }
    found.into_values().collect()
}

/// Returns whether a name is that of an agent of one of these kinds: `Car_1`, `Pedestrian_12`.
fn is_agent(name: &str, kinds: &[String]) -> bool {
    let number = (kinds.iter()).find_map(|kind| name.strip_prefix(kind.as_str())?.strip_prefix('_'));
    number.is_some_and(|number| !number.is_empty() && number.bytes().all(|byte| byte.is_ascii_digit()))
}
