//! Reads the looks of concepts and kinds in pictures (`picture`), and the drawings that they name.

use crate::city::{AgentKind, Look, OwnLook, PICTURES};
use crate::config::compose::Composer;
use crate::diag::{self, Diagnostic, Span};
use crate::located::Located;
use crate::predicate::Definition;
use crate::yaml::codes;
use crate::yaml::read::{Fields, choice, invalid, text};
use crate::yaml::{Key, Value, YamlNode};
use std::path::Path;
use std::sync::Arc;

/// The maximum size of a drawing, in bytes: traces and pages contain it.
const DRAWING_MAX: usize = 256 << 10;

/// The colors with names.
const COLORS: [(&str, [u8; 3]); 12] = [
    ("red", [0xd6, 0x2f, 0x2f]),
    ("orange", [0xf2, 0x8c, 0x1e]),
    ("yellow", [0xf5, 0xcf, 0x1d]),
    ("green", [0x2f, 0x9e, 0x4f]),
    ("teal", [0x1f, 0xa5, 0xa5]),
    ("blue", [0x2f, 0x6f, 0xd0]),
    ("purple", [0x8a, 0x45, 0xc4]),
    ("pink", [0xf0, 0x7a, 0xb8]),
    ("brown", [0x80, 0x55, 0x34]),
    ("black", [0x22, 0x24, 0x29]),
    ("gray", [0x8c, 0x92, 0x99]),
    ("white", [0xf6, 0xf6, 0xf2]),
];

/// Returns the nodes of the pictures in the tree of a run configuration.
fn pictures(tree: &mut YamlNode) -> Vec<&mut YamlNode> {
    fn entries<'n>(node: &'n mut YamlNode, keys: &[&str]) -> Vec<&'n mut YamlNode> {
        let Value::Map(entries) = &mut node.value else {
            return Vec::new();
        };
        let found = entries
            .iter_mut()
            .filter(|(key, _)| keys.is_empty() || keys.contains(&&*key.text));
        found.map(|(_, node)| node).collect()
    }
    let mut owners = Vec::new();
    let Value::Map(parts) = &mut tree.value else {
        return Vec::new();
    };
    for (key, part) in parts {
        match key.text.as_str() {
            "kinds" => owners.extend(entries(part, &[])),
            "predicates" => owners.extend(
                entries(part, &["define"])
                    .into_iter()
                    .flat_map(|node| entries(node, &[])),
            ),
            _ => {}
        }
    }
    owners
        .into_iter()
        .flat_map(|owner| entries(owner, &["picture"]))
        .collect()
}

fn is_drawing(text: &str) -> bool {
    Path::new(text)
        .extension()
        .is_some_and(|ending| ending.eq_ignore_ascii_case("svg"))
}

/// Replaces each file of a drawing by its text under the key `svg`, so that the tree refers to no such file. Marks the
/// other values as text: JSON would write the badge `05` as a number.
pub(super) fn insert_drawings(tree: &mut YamlNode, composer: &mut Composer<'_>) {
    for node in pictures(tree) {
        if let Value::Map(entries) = &mut node.value {
            for (_, node) in entries.iter_mut().filter(|(_, node)| !node.is_null()) {
                if let Value::Scalar { plain, .. } = &mut node.value {
                    *plain = false;
                }
            }
        }
        let path = match &node.value {
            Value::Scalar { text, .. } if is_drawing(text) => node.clone(),
            Value::Map(entries) if !entries.iter().any(|(key, _)| key.text == "svg") => {
                match entries.iter().find(|(key, node)| key.text == "file" && !node.is_null()) {
                    Some((_, path)) => path.clone(),
                    None => continue,
                }
            }
            _ => continue,
        };
        let Some((drawing, name)) = composer.drawing(&path, DRAWING_MAX) else {
            node.value = Value::Absent;
            continue;
        };
        let scalar = |span: Span, text: String| YamlNode::new(span, Value::Scalar { text, plain: false });
        let (span, of_file) = (drawing.span, path.span);
        let key = |text: &str| Key {
            text: text.to_owned(),
            span: of_file,
        };
        let inserted = [
            (key("file"), scalar(of_file, name)),
            (key("svg"), scalar(span, drawing.value)),
        ];
        match &mut node.value {
            Value::Map(entries) => {
                entries.retain(|(key, _)| key.text != "file");
                entries.extend(inserted);
            }
            value => *value = Value::Map(inserted.into()),
        }
    }
}

/// Reads the looks of agents of a kind. `None` also if the drawing could not be read, which has been reported.
pub(super) fn look(node: &YamlNode, of: Option<AgentKind>, faults: &mut Vec<Diagnostic>) -> Option<Look> {
    match &node.value {
        Value::Absent => return None,
        Value::Scalar { .. } => {
            let before = faults.len();
            let icon = icon(node, of, faults);
            for fault in &mut faults[before..] {
                let help = "or write `{color: yellow, badge: TX}`, or the path of a drawing: `taxi.svg`";
                fault.help.push(help.to_owned());
            }
            return Some(Look {
                icon: Some(icon?),
                ..Look::default()
            });
        }
        _ => {}
    }
    let before = faults.len();
    let mut fields = Fields::open(node, "a picture", faults)?;
    let icon_node = fields.optional("icon");
    let color_node = fields.optional("color");
    let badge_node = fields.optional("badge");
    let file = fields.optional("file");
    let svg = fields.optional("svg");
    fields.close_with(
        Some("a picture is an icon with a color and a badge, or a drawing with a badge"),
        faults,
    );
    let drawing = svg.and_then(|node| drawing(node, faults));
    if let (Some(_), Some(own)) = (svg, icon_node.or(color_node)) {
        let message = "a drawing has its own shape and colors: `icon` and `color` do not apply";
        let fault = Diagnostic::new(codes::INVALID_VALUE, message).at(own.span, "");
        let place = file.or(svg).map_or(node.span, |node| node.span);
        faults.push(fault.also(place, "the drawing").help("remove them, or the drawing"));
    }
    if [icon_node, color_node, badge_node, svg].iter().all(Option::is_none) && faults.len() == before {
        let message = "an empty picture: expected `icon`, `color`, `badge` or `file`";
        let fault = Diagnostic::new(codes::INVALID_VALUE, message).at(node.span, "");
        faults.push(fault.help("write `{color: yellow, badge: TX}`, for example"));
    }
    let look = Look {
        icon: icon_node.and_then(|node| icon(node, of, faults)),
        color: color_node.and_then(|node| color(node, faults)),
        badge: badge_node.and_then(|node| badge(node, faults)),
        drawing,
    };
    (faults.len() == before).then_some(look)
}

/// Reads the name of a built-in icon.
pub(super) fn icon(node: &YamlNode, of: Option<AgentKind>, faults: &mut Vec<Diagnostic>) -> Option<String> {
    let of_kind = PICTURES.iter().filter(|(kind, _)| of.is_none_or(|of| of == *kind));
    let known: Vec<(&str, &str)> = of_kind.map(|(_, picture)| (*picture, *picture)).collect();
    choice(node, &known, faults).map(str::to_owned)
}

fn color(node: &YamlNode, faults: &mut Vec<Diagnostic>) -> Option<[u8; 3]> {
    let words = || COLORS.map(|(word, _)| format!("`{word}`")).join(", ");
    let before = faults.len();
    let text = text(node, "a color", faults);
    let named = COLORS.iter().find(|(word, _)| Some(*word) == text);
    let digits = text.map(|text| text.strip_prefix('#').unwrap_or(text));
    let digits = digits.filter(|digits| digits.len() == 6 && digits.bytes().all(|digit| digit.is_ascii_hexdigit()));
    let number = digits.and_then(|digits| u32::from_str_radix(digits, 16).ok());
    let found = named.map(|(_, color)| *color).or_else(|| {
        let [_, r, g, b] = number?.to_be_bytes();
        Some([r, g, b])
    });
    if found.is_none() {
        faults.truncate(before);
        invalid(
            node,
            format_args!("a color: {}, or \"#f5cf1d\" in quotes", words()),
            faults,
        );
    }
    found
}

fn badge(node: &YamlNode, faults: &mut Vec<Diagnostic>) -> Option<String> {
    let most = Look::BADGE_MAX;
    let wanted = format!("one or two letters or digits, as in `TX` ({most} at most)");
    let text = text(node, &wanted, faults)?;
    let fits = (1..=most).contains(&text.len()) && text.bytes().all(|byte| byte.is_ascii_alphanumeric());
    if !fits {
        invalid(node, wanted, faults);
    }
    fits.then(|| text.to_ascii_uppercase())
}

/// Reads the text of a drawing, and checks that it can be drawn.
fn drawing(node: &YamlNode, faults: &mut Vec<Diagnostic>) -> Option<Arc<str>> {
    let svg = text(node, "the text of an SVG drawing", faults)?;
    if svg.len() > DRAWING_MAX {
        let message = format!("a drawing of {} bytes, the limit is {DRAWING_MAX}", svg.len());
        faults.push(Diagnostic::new(diag::codes::LIMIT_EXCEEDED, message).at(node.span, ""));
        return None;
    }
    #[cfg(feature = "render")]
    if let Err(fault) = crate::render::check_drawing(svg) {
        // The node of a file covers its text.
        let Span { source, start, end } = node.span;
        let is_file = start == 0 && end as usize == svg.len();
        let place = match fault.place {
            Some(place) if is_file => Span::new(source, place),
            _ => Span::new(source, start as usize..end as usize),
        };
        let message = format!("invalid drawing: {}", fault.reason);
        faults.push(
            Diagnostic::new(codes::INVALID_VALUE, message)
                .at(place, "")
                .help("a drawing consists of shapes, without text, filters, scripts and references to other files"),
        );
        return None;
    }
    Some(svg.into())
}

/// Reads the looks that the definition of a predicate gives its concept.
pub(super) fn of_concept(
    node: &YamlNode,
    definition: &Definition,
    faults: &mut Vec<Diagnostic>,
) -> Option<Located<OwnLook>> {
    let Value::Map(entries) = &node.value else { return None };
    let (key, node) = entries
        .iter()
        .find(|(key, node)| key.text == "picture" && !node.is_null())?;
    let concept = definition.concept().filter(|concept| !concept.is_kind)?;
    if PICTURES.contains(&(concept.of, concept.concept.as_str())) {
        let message = format!(
            "`{}` is a built-in concept, whose picture cannot be changed",
            concept.concept
        );
        let fault = Diagnostic::new(codes::INVALID_VALUE, message).at(key.span, "");
        faults.push(fault.help("give your own concept a picture, and this one as its `icon`"));
        return None;
    }
    let value = OwnLook {
        of: concept.of,
        name: concept.concept.clone(),
        look: look(node, Some(concept.of), faults)?,
    };
    Some(Located { value, span: node.span })
}

/// Reports concepts with two pictures, and pictures that cannot be told apart.
pub(super) fn distinct(looks: Vec<Located<OwnLook>>, faults: &mut Vec<Diagnostic>) -> Vec<OwnLook> {
    let mut kept: Vec<Located<OwnLook>> = Vec::new();
    for one in looks {
        let same = kept
            .iter()
            .find(|other| (other.value.of, &other.value.name) == (one.value.of, &one.value.name));
        let alike = kept
            .iter()
            .find(|other| (other.value.of, &other.value.look) == (one.value.of, &one.value.look));
        match (same, alike) {
            (Some(same), _) if same.value.look == one.value.look => {}
            (Some(same), _) => {
                let message = format!("`{}` has two pictures", one.value.name);
                let fault = Diagnostic::new(codes::INVALID_VALUE, message).at(one.span, "");
                faults.push(fault.also(same.span, "the other one").help("give one of them"));
            }
            (None, Some(alike)) => {
                let message = format!("`{}` and `{}` have the same picture", alike.value.name, one.value.name);
                let fault = Diagnostic::new(codes::INVALID_VALUE, message).at(one.span, "");
                let fault = fault.also(alike.span, "the same picture");
                faults.push(
                    fault.help("give one of them another color, badge or icon, so that readers can tell them apart"),
                );
            }
            (None, None) => kept.push(one),
        }
    }
    kept.into_iter().map(|one| one.value).collect()
}
