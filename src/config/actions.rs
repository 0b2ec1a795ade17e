//! Reads the actions of a configuration.

use crate::city::{Action, ActionTable, AgentKind, AgentSet, Effect, KindId, KindTable, OwnAction, Side, Split, Turn};
use crate::config::kinds::{Kinds, MOST};
use crate::config::model::*;
use crate::config::predicates::{Predicates, SEES};
use crate::diag::{self, Diagnostic};
use crate::located::Located;
use crate::yaml::YamlNode;
use crate::yaml::codes;
use crate::yaml::read::{Fields, choice, integer, is_name, list, present};

/// The maximum number of ticks for which an action parks an agent.
const MAX_PARKED: u32 = 1_000_000;

/// Reads the actions: their definitions, their order of precedence, and the default.
pub(super) fn actions(
    node: &YamlNode,
    kinds: &Kinds<'_>,
    predicates: Option<&Predicates>,
    splits: Option<&[(Split, AgentSet)]>,
    faults: &mut Vec<Diagnostic>,
) -> Option<ActionsConfig> {
    let mut fields = Fields::open(node, "the actions", faults)?;
    let table = fields.optional("define").map_or_else(
        || Some(ActionTable::new(Vec::new(), &kinds.table)),
        |node| definitions(node, &kinds.table, predicates, splits, faults),
    );
    let priority = fields.required("priority", faults);
    let default = fields.required("default", faults);
    fields.close(faults);
    let table = table?;
    let known: Vec<(&str, Action)> = table.names().zip(table.all()).collect();
    let beside = "beside `define`";
    let priority = priority.and_then(|node| precedence(node, &known, table.own(), beside, faults));
    let own_default = |kind: KindId| {
        kinds
            .orders
            .iter()
            .any(|order| order.kind == kind && order.default.is_some())
    };
    let usual: Vec<KindId> = kinds.table.all().filter(|kind| !own_default(*kind)).collect();
    let default = default.and_then(|node| default_of(&usual, node, &known, &table, &kinds.table, faults));
    let mut of_kinds = Vec::new();
    for order in &kinds.orders {
        let beside = format!("under `kinds: {{{}: ...}}`", kinds.table.name(order.kind));
        let own_priority = (order.priority).map(|node| precedence(node, &known, table.own(), &beside, faults));
        let own_default =
            (order.default).map(|node| default_of(&[order.kind], node, &known, &table, &kinds.table, faults));
        let own_priority = own_priority.unwrap_or_else(|| priority.clone());
        if let (Some(priority), Some(default)) = (own_priority, own_default.unwrap_or(default)) {
            of_kinds.push(KindActions {
                kind: order.kind,
                name: kinds.table.name(order.kind).to_owned(),
                priority,
                default,
            });
        }
    }
    let (priority, default) = (priority?, default?);
    Some(ActionsConfig {
        priority,
        default,
        of_kinds,
        table,
    })
}

/// Reads the default action of some kinds.
fn default_of(
    of: &[KindId],
    node: &YamlNode,
    known: &[(&str, Action)],
    table: &ActionTable,
    kinds: &KindTable,
    faults: &mut Vec<Diagnostic>,
) -> Option<Action> {
    let action = choice(node, known, faults)?;
    let Some(kind) = of.iter().find(|&&kind| !table.can_take(kind, action)) else {
        return Some(action);
    };
    let name = kinds.name(*kind);
    let message = format!("the default is an action of all agents, but a {name} cannot take it");
    let fault = Diagnostic::new(codes::INVALID_VALUE, message).at(node.span, "");
    faults.push(fault.help(format!("add `{name}` to its `cells`, or choose another default")));
    None
}

/// Reads the order of precedence: each action once. `own` has the definitions of the actions that are not standard
/// ones; `place` names the place of the order in help.
fn precedence(
    node: &YamlNode,
    known: &[(&str, Action)],
    own: &[OwnAction],
    place: &str,
    faults: &mut Vec<Diagnostic>,
) -> Option<Vec<Action>> {
    let what = match known.len() {
        4 => "the four actions",
        _ => "all actions",
    };
    let items = list(node, what, faults)?;
    let order: Option<Vec<_>> = items.iter().map(|item| choice(item, known, faults)).collect();
    let order = order?;
    let mut sorted = order.clone();
    sorted.sort_unstable();
    if sorted.iter().copied().eq(known.iter().map(|(_, action)| *action)) {
        return Some(order);
    }
    let names: Vec<String> = known.iter().map(|(name, _)| format!("`{name}`")).collect();
    let message = format!("expected each of {} exactly once", names.join(", "));
    let mut fault = Diagnostic::new(codes::INVALID_VALUE, message).at(node.span, "");
    let again = items
        .iter()
        .enumerate()
        .filter(|(at, _)| order[..*at].contains(&order[*at]));
    for (at, item) in again {
        let name = known.iter().find(|(_, action)| *action == order[at]);
        fault = fault.also(item.span, "a second time");
        fault = fault.help(format!("remove the second `{}`", name.expect("it was read").0));
    }
    let is_missing = |(_, action): &&(&str, Action)| !order.contains(action);
    let missing: Vec<(&str, Action)> = known.iter().filter(is_missing).copied().collect();
    let defined = |name: &str| own.iter().map(|own| &own.name).find(|own| own.value == name);
    for (name, _) in &missing {
        fault = fault.help(format!(
            "add `{name}`: the first action in the list wins over those after it"
        ));
        // The definition is in a file of the user; the order may be inherited from a built-in one.
        fault = match defined(name).filter(|defined| defined.span.source != node.span.source) {
            Some(defined) if fault.primary.as_ref().is_some_and(|label| label.span == node.span) => {
                fault.at(defined.span, "the inherited `priority` lacks it")
            }
            Some(defined) => fault.also(defined.span, "and this"),
            None => fault,
        };
    }
    if !missing.is_empty() {
        // The missing actions come after `Stop`, and each action once.
        let name = |action: &Action| known.iter().find(|(_, known)| known == action).map(|(name, _)| *name);
        let mut line: Vec<&str> = Vec::new();
        for name in order.iter().filter_map(name) {
            if !line.contains(&name) {
                line.push(name);
            }
        }
        let after_stop = line
            .iter()
            .position(|name| *name == Action::Stop.name())
            .map_or(0, |at| at + 1);
        line.splice(after_stop..after_stop, missing.iter().map(|(name, _)| *name));
        fault = fault.help(format!("write {place}: `priority: [{}]`", line.join(", ")));
    }
    faults.push(fault);
    None
}

fn definitions(
    node: &YamlNode,
    kinds: &KindTable,
    predicates: Option<&Predicates>,
    splits: Option<&[(Split, AgentSet)]>,
    faults: &mut Vec<Diagnostic>,
) -> Option<ActionTable> {
    let before = faults.len();
    let present = present(node, "definitions of actions", "action", &[], faults)?;
    let most = Action::MAX - Action::STANDARD.len();
    if present.len() > most {
        let message = format!("{} actions are defined, the limit is {most}", present.len());
        faults.push(Diagnostic::new(diag::codes::LIMIT_EXCEEDED, message).at(node.span, ""));
        return None;
    }
    let mut own = Vec::new();
    for (key, node) in present {
        let name = Located {
            value: key.text.clone(),
            span: key.span,
        };
        check_name(&name, predicates, faults);
        own.extend(definition(name, node, kinds, splits, faults));
    }
    (faults.len() == before).then(|| ActionTable::new(own, kinds))
}

/// Reports a name that is no predicate's, or another one's.
fn check_name(name: &Located<String>, predicates: Option<&Predicates>, faults: &mut Vec<Diagnostic>) {
    let Located { value, span } = name;
    if Action::STANDARD.iter().any(|action| action.name() == value) {
        let message = format!("`{value}` is a standard action, which every configuration has");
        let fault = Diagnostic::new(codes::INVALID_VALUE, message).at(*span, "");
        faults.push(fault.help("define an action of another name"));
    } else if !is_name(value) {
        let message = "expected the name of an action (letters, digits and `_`, no digit first)";
        faults.push(Diagnostic::new(codes::INVALID_VALUE, format!("{message}, found `{value}`")).at(*span, ""));
    } else if value == SEES {
        let message = format!("`{SEES}` is predefined: it is the field of view");
        faults.push(Diagnostic::new(codes::INVALID_VALUE, message).at(*span, ""));
    } else if let Some(predicate) = predicates.and_then(|predicates| predicates.definition(value)) {
        let message = format!("`{value}` is both an action and a base predicate");
        let fault = Diagnostic::new(codes::INVALID_VALUE, message).at(*span, "an action, which rules derive");
        faults.push(fault.also(predicate.name.span, "a predicate, which the city computes"));
    }
}

fn definition(
    name: Located<String>,
    node: &YamlNode,
    kinds: &KindTable,
    splits: Option<&[(Split, AgentSet)]>,
    faults: &mut Vec<Diagnostic>,
) -> Option<OwnAction> {
    let before = faults.len();
    let mut fields = Fields::open(node, "an action", faults)?;
    let cells_node = fields.required("cells", faults);
    let cells = cells_node.and_then(|node| cells(&name, node, kinds, splits, faults));
    let turns = Turn::ALL.map(|turn| (turn.name(), turn));
    let turn_node = fields.optional("turn");
    let turn = turn_node.and_then(|node| choice(node, &turns, faults));
    let change_node = fields.optional("change_lane");
    let change = change_node.and_then(|node| choice(node, &Side::ALL.map(|side| (side.name(), side)), faults));
    let reroute_node = fields.optional("reroute");
    let reroute = reroute_node.and_then(|node| choice(node, &[("true", true), ("false", false)], faults));
    let park_node = fields.optional("park");
    let park = park_node.and_then(|node| integer(node, 1..=MAX_PARKED, faults));
    let example = match park_node {
        Some(_) => "write the kinds that can take it, with 0 cells: `cells: {Car: 0}`",
        None => "write the cells per tick of each kind that can take it: `cells: {Car: 1}`",
    };
    fields.close_with(Some(example), faults);
    let effects: Vec<(&YamlNode, Effect)> = [
        turn_node.zip(turn.map(Effect::Turn)),
        change_node.zip(change.map(Effect::ChangeLane)),
        reroute_node.zip(reroute.filter(|reroute| *reroute).map(|_| Effect::Reroute)),
        park_node.zip(park.map(Effect::Park)),
    ]
    .into_iter()
    .flatten()
    .collect();
    if let [(first, _), (second, _), ..] = effects[..] {
        let message = format!(
            "`{}` has more than one of `turn`, `change_lane`, `reroute` and `park`",
            name.value
        );
        let fault = Diagnostic::new(codes::INVALID_VALUE, message).at(second.span, "");
        faults.push(
            fault
                .also(first.span, "and this")
                .help("define an action for each of them"),
        );
    }
    let (cells, effect) = (cells?, effects.first().copied());
    let walks = |kind: &KindId| kinds.base(*kind) == AgentKind::Pedestrian && cells[kind.index()].is_some();
    let walks = kinds.all().find(walks);
    match effect {
        Some((node, Effect::Turn(_) | Effect::ChangeLane(_) | Effect::Reroute)) if walks.is_some() => {
            let message = "pedestrians have no lanes, so they can neither `turn`, `change_lane` nor `reroute`";
            let fault = Diagnostic::new(codes::INVALID_VALUE, message).at(node.span, "");
            let walks = kinds.name(walks.expect("some kind"));
            faults.push(match cells_node {
                Some(node) => fault.also(node.span, format!("remove `{walks}` here")),
                None => fault,
            });
        }
        Some((node, Effect::Park(_))) if cells.iter().flatten().any(|cells| *cells > 0) => {
            let fault = Diagnostic::new(codes::INVALID_VALUE, "an agent that parks does not move");
            let fault = fault.at(node.span, "");
            faults.push(match cells_node {
                Some(node) => fault.also(node.span, "write 0 cells for each kind"),
                None => fault,
            });
        }
        _ => {}
    }
    (faults.len() == before).then(|| OwnAction {
        name,
        cells,
        effect: effect.map(|(_, effect)| effect),
    })
}

/// Reads the cells per tick of the kinds that can take an action. A kind of the configuration has those of the kind that
/// it derives from, unless it is given its own.
fn cells(
    name: &Located<String>,
    node: &YamlNode,
    kinds: &KindTable,
    splits: Option<&[(Split, AgentSet)]>,
    faults: &mut Vec<Diagnostic>,
) -> Option<Vec<Option<u8>>> {
    let before = faults.len();
    let mut fields = Fields::open(node, "the cells per tick of an action", faults)?;
    let mut found: Vec<Option<u8>> = Vec::new();
    for kind in kinds.all() {
        let node = fields.optional(kinds.name(kind).to_owned());
        let base = KindId::from(kinds.base(kind)).index();
        found.push(match node {
            Some(node) => integer(node, 0..=MOST, faults),
            None => found.get(base).copied().flatten(),
        });
    }
    fields.close_with(None, faults);
    if faults.len() > before {
        return None;
    }
    let able: Vec<KindId> = kinds.all().filter(|kind| found[kind.index()].is_some()).collect();
    let exist = |kind: &KindId| splits.is_none_or(|splits| splits.iter().any(|(_, set)| set.count_of(*kind) > 0));
    if able.iter().any(exist) {
        return Some(found);
    }
    let fault = Diagnostic::new(codes::INVALID_VALUE, format!("no agent can take `{}`", name.value));
    let fault = fault.at(node.span, "");
    faults.push(match able.as_slice() {
        [] => fault.help("write the cells per tick of each kind that can take it: `cells: {Car: 1}`"),
        [kind, ..] => fault.help(format!("the configuration has no {}", kinds.name(*kind))),
    });
    None
}
