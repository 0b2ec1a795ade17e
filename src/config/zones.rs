//! Reads the zones of a map, and finds predicates that name a zone which the map does not have.

use crate::city::{Building, Landmarks, MapConfig, Sample, ZoneConfig, ZonePart};
use crate::diag::{self, Diagnostic, MAX_FAULTS, did_you_mean, listed};
use crate::located::Located;
use crate::predicate::NEAR_MAX;
use crate::yaml::read::{Fields, choice, integer, invalid, is_name, list, present};
use crate::yaml::{YamlNode, codes};

/// The maximum number of zones of a map.
const MAX_ZONES: usize = 64;
/// The maximum number of parts of a zone.
const MAX_PARTS: usize = 1000;
/// The maximum number of a row or column of cells, the limit of a map.
const MAX_CELL: u32 = (1 << 20) - 1;
/// The maximum number of a row or column of blocks. There is one street more.
const MAX_BLOCK: u32 = 1000;
/// The maximum size of a sample.
const MAX_SAMPLE: u32 = 1_000_000;

pub(super) fn zones(node: &YamlNode, faults: &mut Vec<Diagnostic>) -> Option<Vec<ZoneConfig>> {
    let before = faults.len();
    let entries = present(node, "the zones of a map", "zone", &[], faults)?;
    let limit = |count: usize, what: &str, most: usize, node: &YamlNode| {
        let message = format!("{count} {what}, the limit is {most}");
        (count > most).then(|| Diagnostic::new(diag::codes::LIMIT_EXCEEDED, message).at(node.span, ""))
    };
    if let Some(fault) = limit(entries.len(), "zones", MAX_ZONES, node) {
        faults.push(fault);
        return None;
    }
    let mut zones = Vec::new();
    for (key, node) in entries {
        if !is_name(&key.text) {
            let message = format!(
                "expected the name of a zone (letters, digits and `_`, no digit first), found `{}`",
                key.text
            );
            faults.push(Diagnostic::new(codes::INVALID_VALUE, message).at(key.span, ""));
            continue;
        }
        let Some(items) = list(node, "parts of a zone", faults) else {
            continue;
        };
        if items.is_empty() {
            let message = format!("the zone `{}` has no parts", key.text);
            let fault = Diagnostic::new(codes::INVALID_VALUE, message).at(node.span, "");
            faults.push(fault.help("give it one, for example `{near: Store, within: 8}`, or remove it"));
            continue;
        }
        if let Some(fault) = limit(items.len(), "parts of a zone", MAX_PARTS, node) {
            faults.push(fault);
            continue;
        }
        let mut parts = Vec::new();
        for item in items {
            if faults.len() <= MAX_FAULTS {
                parts.extend(part(item, faults).map(|value| Located { value, span: item.span }));
            }
        }
        let (value, span) = (key.text.clone(), key.span);
        zones.push(ZoneConfig {
            name: Located { value, span },
            parts,
        });
    }
    (faults.len() == before).then_some(zones)
}

/// The keys of which a part of a zone has exactly one; `rows` comes with `cols`.
const FORMS: [&str; 6] = [
    "rows",
    "block",
    "sample_blocks",
    "horizontal_street",
    "vertical_street",
    "near",
];

fn part(node: &YamlNode, faults: &mut Vec<Diagnostic>) -> Option<ZonePart> {
    let before = faults.len();
    let mut fields = Fields::open(node, "a part of a zone", faults)?;
    let forms = FORMS.map(|key| fields.optional(key));
    let [cols, within, sample, seed] = ["cols", "within", "sample", "seed"].map(|key| fields.optional(key));
    fields.close(faults);
    if faults.len() > before {
        return None;
    }
    let needs = |key: &str, other: &str, example: &str, faults: &mut Vec<Diagnostic>| {
        let message = format!("`{key}` needs the key `{other}`, too");
        let fault = Diagnostic::new(codes::MISSING_KEY, message).at(node.span, "");
        faults.push(fault.help(format!("write for example `{example}`")));
    };
    let cells = "{rows: [41, 61], cols: [41, 61]}";
    let present: Vec<&str> = (FORMS.iter().zip(&forms))
        .filter(|(_, node)| node.is_some())
        .map(|(key, _)| *key)
        .collect();
    match (present.as_slice(), cols) {
        (["rows"], None) => needs("rows", "cols", cells, faults),
        ([], Some(_)) => needs("cols", "rows", cells, faults),
        ([], None) if sample.is_some() => needs("sample", "near", "{near: Store, within: 8, sample: 2}", faults),
        (["near"], None) if within.is_none() => needs("near", "within", "{near: Store, within: 8}", faults),
        (["rows"], Some(_)) | ([_], None) => {}
        (_, cols) => {
            let found: Vec<String> = (present.iter().copied().chain(cols.map(|_| "cols")))
                .map(|key| format!("`{key}`"))
                .collect();
            let found = if found.is_empty() {
                "none".to_owned()
            } else {
                found.join(", ")
            };
            let message = format!(
                "expected exactly one of `rows` with `cols`, `{}`, found {found}",
                FORMS[1..].join("`, `")
            );
            let fault = Diagnostic::new(codes::INVALID_VALUE, message).at(node.span, "");
            faults.push(fault.help("a zone is a list of parts, and a part has one of these forms"));
        }
    }
    let is_drawn = sample.is_some() || present.contains(&"sample_blocks");
    if let (Some(sample), true) = (sample, !present.contains(&"near") && faults.len() == before) {
        invalid(sample, "no `sample` here: it draws buildings, beside `near`", faults);
    }
    if let (Some(seed), false, true) = (seed, is_drawn, faults.len() == before) {
        invalid(
            seed,
            "no `seed` here: it belongs to `sample` and `sample_blocks`",
            faults,
        );
    }
    let within = within.map_or(Some(0), |node| integer(node, 0..=NEAR_MAX, faults));
    let seed = seed.map_or(Some(None), |node| integer(node, 0..=u64::MAX, faults).map(Some));
    let [rows, block, sample_blocks, horizontal, vertical, near] = forms;
    let mut span = |node: &YamlNode, what: &str| {
        let span = pair(node, what, 0..=MAX_CELL, faults)?;
        if span[0] > span[1] {
            let message = format!(
                "expected {what} in ascending order, found {} before {}",
                span[0], span[1]
            );
            let fault = Diagnostic::new(codes::INVALID_VALUE, message).at(node.span, "");
            faults.push(fault.help(format!("write `[{}, {}]`", span[1], span[0])));
            return None;
        }
        Some(span)
    };
    let around = if let (Some(rows), Some(cols)) = (rows, cols) {
        let (rows, cols) = (
            span(rows, "the first and the last row"),
            span(cols, "the first and the last column"),
        );
        Landmarks::Cells {
            rows: rows?,
            cols: cols?,
        }
    } else if let Some(node) = block {
        Landmarks::Block(pair(node, "the row and the column of a block", 1..=MAX_BLOCK, faults)?)
    } else if let Some(node) = horizontal {
        Landmarks::HorizontalStreet(integer(node, 1..=MAX_BLOCK + 1, faults)?)
    } else if let Some(node) = vertical {
        Landmarks::VerticalStreet(integer(node, 1..=MAX_BLOCK + 1, faults)?)
    } else if let Some(node) = sample_blocks {
        let count = integer(node, 1..=MAX_SAMPLE, faults);
        Landmarks::SomeBlocks(Sample {
            count: count?,
            seed: seed?,
        })
    } else {
        let kind = choice(
            near?,
            &Building::ALL.map(|building| (building.name(), building)),
            faults,
        );
        match sample {
            None => Landmarks::Buildings(kind?),
            Some(node) => {
                let count = integer(node, 1..=MAX_SAMPLE, faults);
                Landmarks::SomeBuildings(
                    kind?,
                    Sample {
                        count: count?,
                        seed: seed?,
                    },
                )
            }
        }
    };
    (faults.len() == before).then_some(ZonePart {
        around,
        within: within?,
    })
}

/// Reads two whole numbers within a range.
fn pair(
    node: &YamlNode,
    what: &str,
    range: std::ops::RangeInclusive<u32>,
    faults: &mut Vec<Diagnostic>,
) -> Option<[u32; 2]> {
    let what = format!("two numbers: {what}");
    let [first, second] = list(node, &what, faults)? else {
        invalid(node, what, faults);
        return None;
    };
    let [first, second] = [first, second].map(|node| integer(node, range.clone(), faults));
    Some([first?, second?])
}

/// Reports the names of zones that the map does not have.
pub(super) fn unknown_zones(
    map: &MapConfig,
    named: impl Iterator<Item = Located<String>>,
    faults: &mut Vec<Diagnostic>,
) {
    let mut known: Vec<&str> = map.zones.iter().map(|zone| zone.name.value.as_str()).collect();
    known.sort_unstable();
    for zone in named {
        if known.contains(&zone.value.as_str()) {
            continue;
        }
        let message = format!("the map `{}` has no zone `{}`", map.name, zone.value);
        let fault = Diagnostic::new(codes::INVALID_VALUE, message).at(zone.span, "");
        faults.push(match did_you_mean(&zone.value, known.iter().copied()) {
            Some(near) => fault.did_you_mean(near, &[zone.span]),
            None if known.is_empty() => fault.help(format!(
                "add it to the map: `zones: {{{}: [{{near: Office, within: 8}}]}}`",
                zone.value
            )),
            None => fault.note(format!("the zones of the map: {}", listed(&known))),
        });
    }
}
