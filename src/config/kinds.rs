//! Reads the kinds of agents of a configuration.

use crate::city::{Action, AgentKind, KindId, KindName, KindTable, Look, OwnKind, OwnLook};
use crate::config::looks::look;
use crate::diag::{self, Diagnostic, listed};
use crate::located::Located;
use crate::predicate::{Concept, Definition};
use crate::yaml::codes;
use crate::yaml::read::{Fields, choice, integer, present};
use crate::yaml::{Key, Value, YamlNode};

/// The maximum number of cells per tick.
pub(super) const MOST: u8 = 3;

/// The actions whose cells a kind can give. An agent that stops never moves.
const MOVES: [Action; 3] = [Action::Slow, Action::Normal, Action::Fast];

/// The kinds of a configuration.
#[derive(Default)]
pub(super) struct Kinds<'n> {
    pub table: KindTable,
    /// The looks of kinds that have no icon of a concept.
    pub looks: Vec<Located<OwnLook>>,
    /// What kinds say of precedence, read after the actions.
    pub orders: Vec<Order<'n>>,
}

/// The order of precedence of the actions of a kind, and its default.
pub(super) struct Order<'n> {
    pub kind: KindId,
    pub priority: Option<&'n YamlNode>,
    pub default: Option<&'n YamlNode>,
}

/// Reads the kinds.
pub(super) fn kinds<'n>(node: &'n YamlNode, faults: &mut Vec<Diagnostic>) -> Option<Kinds<'n>> {
    let before = faults.len();
    let is_own = |(key, _): &&(Key, YamlNode)| AgentKind::ALL.iter().all(|kind| kind.name() != key.text);
    let present = present(
        node,
        "the kinds of agents",
        "kind of agents",
        &AgentKind::ALL.map(AgentKind::name),
        faults,
    )?;
    let count = present.iter().filter(|entry| is_own(entry)).count();
    if count > KindTable::OWN_MAX {
        let message = format!("{count} kinds are defined, the limit is {}", KindTable::OWN_MAX);
        faults.push(Diagnostic::new(diag::codes::LIMIT_EXCEEDED, message).at(node.span, ""));
        return None;
    }
    let mut found = Kinds::default();
    // A kind can have the speeds of a standard kind, so these come first.
    let (own, standard): (Vec<_>, Vec<_>) = present.into_iter().partition(|entry| is_own(entry));
    for (key, node) in standard.into_iter().chain(own) {
        kind(key, node, &mut found, faults);
    }
    (faults.len() == before).then_some(found)
}

fn kind<'n>(key: &Key, node: &'n YamlNode, found: &mut Kinds<'n>, faults: &mut Vec<Diagnostic>) {
    let Some(mut fields) = Fields::open(node, "a kind of agents", faults) else {
        return;
    };
    let standard = AgentKind::ALL.into_iter().find(|kind| kind.name() == key.text);
    let of = match standard {
        Some(kind) => Some(kind),
        None => fields.required("of", faults).and_then(|node| {
            let names = AgentKind::ALL.map(|kind| (kind.name(), kind));
            choice(node, &names, faults)
        }),
    };
    let usual = of.map_or([None; 4], |of| found.table.cells(of.into()));
    let cells = fields
        .optional("cells")
        .map_or(Some(usual), |node| cells(node, usual, faults));
    let picture_node = match standard {
        Some(_) => None,
        None => fields.optional("picture"),
    };
    // A word names an icon; other looks belong to the name of the kind.
    let is_icon = picture_node.is_none_or(|node| matches!(node.value, Value::Scalar { .. }));
    let look = picture_node.map_or(Some(Look::default()), |node| look(node, of, faults));
    let order = (fields.optional("priority"), fields.optional("default"));
    let usual = "`of: Car` drives on streets, `of: Pedestrian` walks on sidewalks";
    fields.close_with(Some(usual), faults);
    let (Some(of), Some(cells)) = (of, cells) else {
        return;
    };
    // A kind with a faulty picture is known, so that its uses are no further faults.
    let look = look.unwrap_or_default();
    let kind = match standard {
        Some(kind) => {
            found.table.set_cells(kind.into(), cells);
            KindId::from(kind)
        }
        None => {
            let Some(name) = own_name(key, &found.table, faults) else {
                return;
            };
            let shown = key.text.clone();
            let picture = match look.icon.clone().filter(|_| is_icon) {
                Some(icon) => icon,
                None => shown.clone(),
            };
            if let Some(node) = picture_node.filter(|_| !is_icon) {
                let value = OwnLook { of, name: shown, look };
                found.looks.push(Located { value, span: node.span });
            }
            found.table.add(OwnKind { name, of, picture }, cells);
            found.table.all().last().expect("it was added")
        }
    };
    if let (None, None) = order {
        return;
    }
    found.orders.push(Order {
        kind,
        priority: order.0,
        default: order.1,
    });
}

/// Reads the name of a kind, which no other kind has in upper or lower case.
fn own_name(key: &Key, table: &KindTable, faults: &mut Vec<Diagnostic>) -> Option<Located<KindName>> {
    let known = table.find_ignoring_case(&key.text);
    let message = match (
        known,
        KindName::new(&key.text).filter(|_| key.text.starts_with(|first: char| first.is_ascii_uppercase())),
    ) {
        (Some(known), _) => format!(
            "`{}` differs from the kind `{}` only by case",
            key.text,
            table.name(known)
        ),
        (None, Some(value)) => return Some(Located { value, span: key.span }),
        (None, None) => format!(
            "expected the name of a kind (a capital letter, then letters, digits and `_`, at most {} in all), found `{}`",
            KindName::MAX,
            key.text
        ),
    };
    let mut fault = Diagnostic::new(codes::INVALID_VALUE, message).at(key.span, "");
    let mut letters = key.text.chars();
    if let (None, Some(first)) = (known, letters.next().filter(char::is_ascii_lowercase)) {
        let capital = format!("{}{}", first.to_ascii_uppercase(), letters.as_str());
        fault = fault.help(format!("write `{capital}`"));
    }
    faults.push(fault);
    None
}

/// Reads the cells per tick of a kind; those that the mapping does not give are the usual ones.
fn cells(node: &YamlNode, mut cells: [Option<u8>; 4], faults: &mut Vec<Diagnostic>) -> Option<[Option<u8>; 4]> {
    let before = faults.len();
    let mut fields = Fields::open(node, "the cells per tick of a kind", faults)?;
    for action in MOVES {
        if let Some(node) = fields.optional(action.name()) {
            cells[action.index()] = integer(node, 0..=MOST, faults);
        }
    }
    fields.close_with(None, faults);
    for fault in &mut faults[before..] {
        (fault.help).push("give the cells per tick under `Slow`, `Normal` and `Fast`; `Stop` is always 0".to_owned());
    }
    if faults.len() > before {
        return None;
    }
    if cells.iter().flatten().all(|cells| *cells == 0) {
        let fault = Diagnostic::new(codes::INVALID_VALUE, "agents of this kind would never move");
        faults.push(
            fault
                .at(node.span, "")
                .help("give at least one action a positive number of cells"),
        );
        return None;
    }
    Some(cells)
}

/// Returns the definition of a predicate that `{kind: ...}` gives for a kind of the configuration.
pub(super) fn of_own_kind(
    node: &YamlNode,
    kinds: &KindTable,
    faults: &mut Vec<Diagnostic>,
) -> Option<Option<Definition>> {
    let Value::Map(entries) = &node.value else { return None };
    let [(key, value)] = entries.as_slice() else {
        return None;
    };
    if key.text != "kind" {
        return None;
    }
    let names: Vec<(&str, KindId)> = kinds.all().map(|kind| (kinds.name(kind), kind)).collect();
    let Some(kind) = choice(value, &names, faults) else {
        if let (Value::Scalar { text, .. }, Some(fault)) = (&value.value, faults.last_mut())
            && fault.help.is_empty()
        {
            fault.help.push(format!(
                "define the kind: `kinds: {{{text}: {{of: Car}}}}`, or `of: Pedestrian`"
            ));
        }
        return Some(None);
    };
    if kind.is_standard() {
        return None;
    }
    Some(Some(
        Concept {
            of: kinds.base(kind),
            concept: kinds.name(kind).to_owned(),
            is_kind: true,
        }
        .into(),
    ))
}

/// Describes the kinds of a configuration, for help.
pub(super) fn kinds_help(kinds: &KindTable) -> String {
    let own: Vec<&str> = kinds.own().iter().map(|own| own.name.value.as_str()).collect();
    match own.is_empty() {
        true => "define a kind of your own under `kinds`: `kinds: {Cyclist: {of: Car}}`".to_owned(),
        false => format!("the configuration defines the kinds {}", listed(&own)),
    }
}
