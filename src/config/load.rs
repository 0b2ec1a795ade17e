//! Reads typed configurations from composed trees: the meaning and the range of each key.
//!
//! `docs/reference/configuration.md` documents the keys for users. The city checks whether the values are consistent,
//! for example whether a street has room for its lanes.

use crate::city::{
    ActionTable, AgentGroup, AgentKind, AgentSet, Blocks, Building, Buildings, KindName, KindTable, MapConfig,
    OwnGroups,
};
use crate::city::{Region, Routing, Split, Terrain, TripEnds, Widths};
use crate::config::actions::actions;
use crate::config::codes;
use crate::config::compose::{AGENTS, Composer, Kind, MAP, PREDICATES, RUN, Read, TASK};
use crate::config::kinds::{Kinds, kinds, kinds_help};
use crate::config::looks::{distinct, insert_drawings};
use crate::config::model::*;
use crate::config::predicates::{Concepts, Predicates, carried, check_kinds, predicates};
use crate::config::roads;
use crate::config::task;
use crate::config::zones::{unknown_zones, zones};
use crate::diag::{self, Diagnostic, Faults, MAX_FAULTS, Sources, Span};
use crate::files::BUILTIN_FOLDER;
use crate::located::Located;
use crate::yaml;
use crate::yaml::read::{Fields, choice, integer, invalid, is_name, list, number, text};
use crate::yaml::{Value, YamlNode};
use sha2::{Digest, Sha256};
use std::path::Path;
use std::sync::Arc;

/// The maximum number of agents of a split before repetition, plus the concepts that they carry.
const MAX_AGENTS: u32 = 1_000_000;
/// The maximum number of agents of a split.
const MAX_REPEATED: u32 = 10_000_000;
/// The maximum number of blocks in a row or column of a map.
const MAX_BLOCKS: u32 = 1000;
/// The maximum width of a part of a map, in cells.
const MAX_WIDTH: u32 = 1000;
/// The maximum half-width of the field of view, in cells.
const MAX_VIEW: u32 = 10_000;
/// The maximum length of a run, in ticks.
const MAX_TICKS: u32 = 1_000_000_000;
/// The maximum size of a region, in cells.
const MAX_REGION: u32 = 1_000_000;

/// Buildings with their letters in a map file.
const BUILDINGS: [(char, Building); 5] = [
    ('H', Building::House),
    ('O', Building::Office),
    ('A', Building::Garage),
    ('S', Building::Store),
    ('G', Building::GasStation),
];

/// Loads a run configuration composed of all its files. A bare name such as `expert` means `configs/expert.yaml`.
///
/// It reads files through `read`, and built-in files where `read` finds none. It adds each file to `sources`.
///
/// # Errors
/// All faults of all files.
pub fn load_scenario(sources: &mut Sources, path: &Path, read: Read<'_>) -> Result<Scenario, Vec<Diagnostic>> {
    let mut composer = Composer::new(sources, read);
    let scenario = composer
        .root(path, RUN, &PARTS_OF_RUN)
        .and_then(|mut tree| scenario(&mut composer, &mut tree));
    finish(scenario, composer.faults)
}

/// The content of a configuration file.
#[derive(Clone, Debug)]
pub enum Loaded {
    /// A run configuration.
    Scenario(Box<Scenario>),
    /// A map.
    Map(MapConfig),
}

/// Loads a run configuration or a map, whichever the file holds. Otherwise like [`load_scenario`].
///
/// # Errors
/// All faults of all files.
pub fn load_any(sources: &mut Sources, path: &Path, read: Read<'_>) -> Result<Loaded, Vec<Diagnostic>> {
    let mut composer = Composer::new(sources, read);
    let tree = composer.root(path, RUN, &PARTS_OF_RUN);
    let loaded = tree.and_then(|mut tree| match part_of_run(&tree) {
        Some(("map", _)) => map(&tree, composer.name_of(&tree), &mut composer.faults).map(Loaded::Map),
        _ => scenario(&mut composer, &mut tree).map(|scenario| Loaded::Scenario(Box::new(scenario))),
    });
    finish(loaded, composer.faults)
}

/// Loads a map file. A bare name such as `square-5x5` means `configs/maps/square-5x5.yaml`. Otherwise like
/// [`load_scenario`].
///
/// # Errors
/// All faults of all files.
pub fn load_map(sources: &mut Sources, path: &Path, read: Read<'_>) -> Result<MapConfig, Vec<Diagnostic>> {
    let mut composer = Composer::new(sources, read);
    let map = composer
        .root(path, MAP, &[])
        .and_then(|tree| map(&tree, composer.name_of(&tree), &mut composer.faults));
    finish(map, composer.faults)
}

/// Returns the fault of the loaded file itself, if it is the only one: the file is missing or cannot be read.
pub fn missing_file(faults: &[Diagnostic]) -> Option<&Diagnostic> {
    match faults {
        [fault] if fault.code == codes::MISSING_FILE && fault.primary.is_none() => Some(fault),
        _ => None,
    }
}

pub(super) fn finish<T>(value: Option<T>, faults: Vec<Diagnostic>) -> Result<T, Vec<Diagnostic>> {
    match value {
        Some(value) if faults.is_empty() => Ok(value),
        _ => Err(faults.into_iter().collect::<Faults>().finish()),
    }
}

/// The parts of a run configuration that may be separate files.
const PARTS_OF_RUN: [(&str, Kind); 4] = [
    ("map", MAP),
    ("agents", AGENTS),
    ("predicates", PREDICATES),
    ("task", TASK),
];

/// The keys of the parts of a run configuration, what each part is, and the keys that only such a part has.
const PARTS: [(&str, &str, &[&str]); 4] = [
    ("map", "a map", &["blocks", "widths", "buildings", "roads", "zones"]),
    ("agents", "agent sets", &["train", "val", "test"]),
    ("predicates", "predicates", &["define", "use"]),
    (
        "task",
        "a task",
        &[
            "entities",
            "state_agents",
            "horizon",
            "patience",
            "reward",
            "ego",
            "egos",
            "episodes",
        ],
    ),
];

/// Returns the key and the description of the part that a tree holds instead of a run configuration.
fn part_of_run(tree: &YamlNode) -> Option<(&'static str, &'static str)> {
    let Value::Map(entries) = &tree.value else { return None };
    let has = |keys: &[&str]| entries.iter().any(|(key, _)| keys.contains(&key.text.as_str()));
    if has(&PARTS.map(|(key, ..)| key)) || has(&["rules"]) {
        return None;
    }
    let part = PARTS.iter().find(|(_, _, keys)| has(keys));
    part.map(|(key, what, _)| (*key, *what))
}

/// Reports a file that holds a part of a run configuration instead of one.
fn is_part(composer: &mut Composer<'_>, tree: &YamlNode) -> bool {
    let Some((key, what)) = part_of_run(tree) else {
        return false;
    };
    let path = composer.path_of(tree).display().to_string();
    let path = path
        .strip_prefix(BUILTIN_FOLDER)
        .map_or(path.as_str(), |inside| inside.trim_start_matches('/'));
    let message = format!("expected a run configuration, found {what}");
    let fault = Diagnostic::new(yaml::codes::INVALID_VALUE, message).at(tree.span, "");
    let help = format!("write a run configuration with `base: expert` and `{key}: {path}`");
    composer.faults.push(fault.help(help));
    true
}

fn scenario(composer: &mut Composer<'_>, tree: &mut YamlNode) -> Option<Scenario> {
    insert_drawings(tree, composer);
    let tree = &*tree;
    if is_part(composer, tree) {
        return None;
    }
    let mut fields = Fields::open(tree, "a run configuration", &mut composer.faults)?;
    fields.hint(|key| {
        let of_map = matches!(key, "blocks" | "widths" | "buildings" | "zones");
        of_map.then(|| format!("it is a key of the map: `map: {{base: square-5x5, {key}: ...}}`"))
    });
    fields.optional("base");
    let rules = fields
        .required("rules", &mut composer.faults)
        .and_then(|node| composer.rule_file(node).map(|value| Located { value, span: node.span }));
    let faults = &mut composer.faults;
    let map_node = fields.required("map", faults);
    let map = map_node.and_then(|node| map(node, composer.name_of(node), &mut composer.faults));
    let faults = &mut composer.faults;
    let kinds = fields
        .optional("kinds")
        .map_or_else(|| Some(Kinds::default()), |node| kinds(node, faults));
    let predicates = (fields.required("predicates", faults))
        .zip(kinds.as_ref())
        .and_then(|(node, kinds)| predicates(node, &kinds.table, faults));
    let mut looks = Vec::new();
    if let (Some(kinds), Some(predicates)) = (&kinds, &predicates) {
        check_kinds(&kinds.table, predicates, faults);
        let all = kinds.looks.iter().chain(&predicates.looks).cloned();
        looks = distinct(all.collect(), faults);
    }
    let regions = fields
        .optional("region")
        .map(|node| regions(node, faults))
        .unwrap_or_default();
    let splits = fields
        .required("agents", faults)
        .zip(kinds.as_ref())
        .and_then(|(node, kinds)| splits(node, &kinds.table, predicates.as_ref(), &regions, faults));
    let actions = (fields.required("actions", faults))
        .zip(kinds.as_ref())
        .and_then(|(node, kinds)| actions(node, kinds, predicates.as_ref(), splits.as_deref(), faults));
    let routing = fields
        .required("routing", faults)
        .and_then(|node| choice(node, &Routing::ALL.map(|routing| (routing.name(), routing)), faults));
    let trip_ends = fields.optional("trip_ends").map_or(Some(TripEnds::default()), |node| {
        choice(node, &TripEnds::ALL.map(|ends| (ends.name(), ends)), faults)
    });
    let view = fields
        .required("view", faults)
        .and_then(|node| integer(node, 1..=MAX_VIEW, faults));
    let ticks = fields
        .required("ticks", faults)
        .and_then(|node| integer(node, 1..=MAX_TICKS, faults));
    let task_node = fields.optional("task");
    let table = actions
        .as_ref()
        .map_or_else(ActionTable::default, |actions| actions.table.clone());
    let task = task_node.map(|node| task::spf(composer, node, predicates.as_ref(), &table));
    let faults = &mut composer.faults;
    if let (Some(map), Some(predicates)) = (&map, &predicates) {
        let of_regions = regions.iter().flatten().filter_map(|region| match &region.value {
            Region::Zone(value) => Some(Located {
                value: value.clone(),
                span: region.span,
            }),
            Region::Side(_) => None,
        });
        let of_predicates = (predicates.used.iter()).filter_map(|predicate| predicate.definition.zone().cloned());
        unknown_zones(map, of_predicates.chain(of_regions), faults);
    }
    let usual = "`base: configs/common.yaml` has defaults for all keys except `rules` and `agents`";
    fields.close_with(Some(usual), faults);
    let mut scenario = Scenario {
        name: composer.name_of(tree),
        map: map?,
        rules: rules?,
        splits: splits?,
        predicates: predicates?.used,
        kinds: kinds?.table,
        looks,
        actions: actions?,
        routing: routing?,
        trip_ends: trip_ends?,
        view: view?,
        ticks: ticks?,
        task: task.map_or(Some(None), |task| task.map(Some))?,
        hash: String::new(),
        composed: composed(tree),
    };
    scenario.hash = hash(&scenario);
    Some(scenario)
}

/// Returns the value of [`Scenario::composed`].
fn composed(tree: &YamlNode) -> serde_json::Value {
    let mut json = tree.to_json();
    if let Some(keys) = json.as_object_mut() {
        keys.shift_remove("rules");
        if let Some(task) = keys.get_mut("task").and_then(serde_json::Value::as_object_mut) {
            task.shift_remove("episodes");
        }
    }
    json
}

/// Hashes the JSON form of the scenario, which omits file names and places. Its keys are in the order of the types.
fn hash(scenario: &Scenario) -> String {
    let json = serde_json::to_vec(scenario).expect("a scenario holds no map with keys that are not text");
    format!("{:x}", Sha256::digest(json))
}

fn map(map: &YamlNode, name: String, faults: &mut Vec<Diagnostic>) -> Option<MapConfig> {
    let mut fields = Fields::open(map, "a map", faults)?;
    fields.optional("base");
    let roads = fields.optional("roads");
    let terrain = match roads {
        Some(node) => {
            let of_blocks = ["blocks", "widths", "buildings"].map(|key| fields.optional(key));
            if let Some(other) = of_blocks.into_iter().flatten().next() {
                let message = "a map has either blocks or `roads`";
                let fault = Diagnostic::new(yaml::codes::INVALID_VALUE, message).at(other.span, "beside `roads`");
                faults.push(fault.also(node.span, "the roads").help("remove one of the two"));
            }
            roads::network(node, faults).map(|network| Terrain::Roads {
                roads: Located {
                    value: Arc::new(network),
                    span: node.span,
                },
            })
        }
        None => map_of_blocks(map, &mut fields, faults).map(Terrain::Blocks),
    };
    let zones = fields
        .optional("zones")
        .map_or(Some(Vec::new()), |node| zones(node, faults));
    fields.close(faults);
    Some(MapConfig {
        name,
        terrain: terrain?,
        zones: zones?,
    })
}

fn map_of_blocks(map: &YamlNode, fields: &mut Fields<'_>, faults: &mut Vec<Diagnostic>) -> Option<Blocks> {
    let blocks = fields.required("blocks", faults).and_then(|node| {
        let [rows, cols] = list(node, "two numbers: rows and columns of blocks", faults)? else {
            invalid(node, "two numbers: rows and columns of blocks", faults);
            return None;
        };
        let [rows, cols] = [rows, cols].map(|node| integer(node, 1..=MAX_BLOCKS, faults));
        Some(Located {
            value: [rows?, cols?],
            span: node.span,
        })
    });
    let widths = fields.required("widths", faults).and_then(|node| {
        let value = widths(node, faults)?;
        Some(Located { value, span: node.span })
    });
    let buildings = fields.required("buildings", faults).and_then(|node| {
        let value = buildings(map, node, blocks, faults)?;
        Some(Located { value, span: node.span })
    });
    Some(Blocks {
        blocks: blocks?,
        widths: widths?,
        buildings: buildings?,
    })
}

fn widths(node: &YamlNode, faults: &mut Vec<Diagnostic>) -> Option<Widths> {
    let mut fields = Fields::open(node, "the widths of a map", faults)?;
    let mut width = |key| {
        fields
            .required(key, faults)
            .and_then(|node| integer(node, 0..=MAX_WIDTH, faults))
    };
    let [street, sidewalk, building, inner_sidewalk] =
        ["street", "sidewalk", "building", "inner_sidewalk"].map(&mut width);
    fields.close(faults);
    Some(Widths {
        street: street?,
        sidewalk: sidewalk?,
        building: building?,
        inner_sidewalk: inner_sidewalk?,
    })
}

/// Reports buildings whose rows come from another file than the blocks and have another size.
fn other_blocks(
    map: &YamlNode,
    node: &YamlNode,
    rows: &[YamlNode],
    blocks: Located<[u32; 2]>,
    faults: &mut Vec<Diagnostic>,
) -> bool {
    if node.span.source == blocks.span.source {
        return false;
    }
    let letters = |row: &YamlNode| match &row.value {
        Value::Scalar { text, .. } => text.chars().filter(|letter| !letter.is_whitespace()).count(),
        _ => 0,
    };
    let [wanted_rows, wanted_cols] = blocks.value;
    let widths: Vec<usize> = rows.iter().map(letters).collect();
    let fits = rows.len() == 2 * wanted_rows as usize && widths.iter().all(|width| *width == 2 * wanted_cols as usize);
    if fits {
        return false;
    }
    let found = [rows.len() / 2, widths.first().map_or(0, |width| width / 2)];
    let message = format!(
        "the map has {wanted_rows} x {wanted_cols} blocks, but its rows of buildings are for {} x {} blocks",
        found[0], found[1]
    );
    let fault = Diagnostic::new(yaml::codes::INVALID_VALUE, message);
    // The file of the map overrides its base.
    let fault = match map.span.source == node.span.source {
        true => fault
            .at(node.span, "")
            .also(blocks.span, "the blocks, inherited from the base"),
        false => fault
            .at(blocks.span, "")
            .also(node.span, "the rows, inherited from the base"),
    };
    faults.push(
        fault
            .help(
                "give the buildings of these blocks, two rows of two letters for each block: `buildings: {rows: [HO, SG]}` \
                 for 1 x 1 blocks",
            )
            .help("or draw them: `buildings: {rows: ~, random: {seed: 1, weights: {House: 1, Store: 1}}}`"),
    );
    true
}

fn buildings(
    map: &YamlNode,
    node: &YamlNode,
    blocks: Option<Located<[u32; 2]>>,
    faults: &mut Vec<Diagnostic>,
) -> Option<Buildings> {
    let mut fields = Fields::open(node, "the buildings of a map", faults)?;
    let (rows, random) = (fields.optional("rows"), fields.optional("random"));
    let before = faults.len();
    fields.close(faults);
    // A misspelled key may stand for `rows` or `random`.
    if faults.len() > before {
        return None;
    }
    match (rows, random) {
        (Some(rows), None) => {
            let node = rows;
            let rows = list(node, "rows of buildings", faults)?;
            if let Some(blocks) = blocks
                && other_blocks(map, node, rows, blocks, faults)
            {
                return None;
            }
            let blocks = blocks.map(|blocks| blocks.value);
            let rows: Vec<_> = rows
                .iter()
                .map(|row| building_row(row, blocks.map(|[_, cols]| 2 * cols as usize), faults))
                .collect();
            if let Some([wanted, _]) = blocks
                && rows.len() != 2 * wanted as usize
            {
                let expected = format!(
                    "{} rows of buildings, two for each of {wanted} rows of blocks",
                    2 * wanted
                );
                let message = format!("expected {expected}, found {}", rows.len());
                faults.push(Diagnostic::new(yaml::codes::INVALID_VALUE, message).at(node.span, ""));
                return None;
            }
            rows.into_iter().collect::<Option<_>>().map(Buildings::Fixed)
        }
        (None, Some(node)) => random_buildings(node, faults),
        (Some(rows), Some(random)) => {
            let fault = Diagnostic::new(
                yaml::codes::INVALID_VALUE,
                "the buildings have both `rows` and `random`",
            );
            let inherited = "inherited from the base";
            let (source, whole) = (node.span.source, "buildings: {rows: ~, random: {...}}");
            faults.push(if rows.span.source != source {
                let fault = fault.at(random.span, "").also(rows.span, inherited);
                fault.help(format!("remove the inherited rows: `{whole}`"))
            } else if random.span.source != source {
                let fault = fault.at(rows.span, "").also(random.span, inherited);
                fault.help("remove the inherited `random`: `buildings: {random: ~, rows: [...]}`")
            } else {
                fault
                    .at(random.span, "")
                    .also(rows.span, "given here")
                    .help("remove one of them")
            });
            None
        }
        (None, None) => {
            if !node.partial {
                invalid(node, "either `rows` or `random`", faults);
            }
            None
        }
    }
}

fn building_row(node: &YamlNode, wanted: Option<usize>, faults: &mut Vec<Diagnostic>) -> Option<Vec<Building>> {
    let row = text(node, "a row of building letters", faults)?;
    let mut buildings = Vec::new();
    for (byte, letter) in row.char_indices().filter(|(_, letter)| !letter.is_whitespace()) {
        let Some((_, building)) = BUILDINGS.iter().find(|(known, _)| *known == letter) else {
            let letters = BUILDINGS
                .map(|(letter, building)| format!("{letter} {}", building.name()))
                .join(", ");
            let fault = Diagnostic::new(
                yaml::codes::INVALID_VALUE,
                format!("`{letter}` does not denote a building"),
            );
            let span = inside(node, row, byte..byte + letter.len_utf8());
            faults.push(fault.at(span, "").note(format!("the letters are: {letters}")));
            return None;
        };
        buildings.push(*building);
    }
    match wanted {
        Some(wanted) if wanted != buildings.len() => {
            let message = format!(
                "expected {wanted} buildings, two for each block of the row, found {}",
                buildings.len()
            );
            faults.push(Diagnostic::new(yaml::codes::INVALID_VALUE, message).at(node.span, ""));
            None
        }
        _ => Some(buildings),
    }
}

/// Returns the place of a part of a scalar, or the whole scalar if it is quoted and may contain escapes.
fn inside(node: &YamlNode, text: &str, part: std::ops::Range<usize>) -> Span {
    let start = node.span.range().start;
    match &node.value {
        Value::Scalar { plain: true, .. } if node.span.range().len() == text.len() => {
            Span::new(node.span.source, start + part.start..start + part.end)
        }
        _ => node.span,
    }
}

fn random_buildings(node: &YamlNode, faults: &mut Vec<Diagnostic>) -> Option<Buildings> {
    let mut fields = Fields::open(node, "random buildings", faults)?;
    let seed = fields
        .required("seed", faults)
        .and_then(|node| integer(node, 0..=u64::MAX, faults));
    let weights = fields.required("weights", faults).and_then(|node| {
        let mut fields = Fields::open(node, "the weights of buildings", faults)?;
        let weights: Option<Vec<_>> = Building::ALL
            .map(|building| match fields.optional(building.name()) {
                Some(node) => Some((building, number(node, 0.0..=1e9, "a weight from 0 to 1e9", faults)?)),
                None => Some((building, 0.0)),
            })
            .into_iter()
            .collect();
        fields.close(faults);
        weights
    });
    fields.close(faults);
    Some(Buildings::Random {
        seed: seed?,
        weights: weights?,
    })
}

/// Returns the region of each split, in the order of [`Split::ALL`].
fn regions(node: &YamlNode, faults: &mut Vec<Diagnostic>) -> [Option<Located<Region>>; 3] {
    let region = |node: &YamlNode, faults: &mut Vec<Diagnostic>| {
        let value = match &node.value {
            Value::Scalar { text, .. } if is_name(text) && !node.is_null() => Region::Zone(text.to_string()),
            _ => Region::Side(integer(node, 1..=MAX_REGION, faults)?),
        };
        Some(Located { value, span: node.span })
    };
    if !matches!(node.value, Value::Map(_)) {
        let region = region(node, faults);
        return [(); 3].map(|()| region.clone());
    }
    let Some(mut fields) = Fields::open(node, "the regions", faults) else {
        return [(); 3].map(|()| None);
    };
    let regions = Split::ALL.map(|split| region(fields.optional(split.name())?, faults));
    fields.close(faults);
    regions
}

fn splits(
    node: &YamlNode,
    kinds: &KindTable,
    predicates: Option<&Predicates>,
    regions: &[Option<Located<Region>>; 3],
    faults: &mut Vec<Diagnostic>,
) -> Option<Vec<(Split, AgentSet)>> {
    let before = faults.len();
    let concepts = predicates.map(Concepts::new);
    let mut fields = Fields::open(node, "the agent sets", faults)?;
    fields.hint(|key| {
        let of_split = matches!(key, "cars" | "pedestrians");
        of_split.then(|| format!("agents belong to a split: `test: {{{key}: ...}}`"))
    });
    fields.optional("base");
    let mut splits = Vec::new();
    for (split, region) in Split::ALL.into_iter().zip(regions) {
        if let Some(node) = fields.optional(split.name()) {
            let set = agents(node, kinds, split, region.clone(), concepts.as_ref(), faults);
            splits.extend(set.map(|set| (split, set)));
        }
    }
    fields.close(faults);
    if splits.is_empty() && faults.len() == before && !node.partial {
        let fault = Diagnostic::new(
            yaml::codes::INVALID_VALUE,
            "expected at least one of `train`, `val`, `test`, found none",
        );
        faults.push(fault.at(node.span, ""));
    }
    (faults.len() == before).then_some(splits)
}

fn agents(
    node: &YamlNode,
    kinds: &KindTable,
    split: Split,
    region: Option<Located<Region>>,
    concepts: Option<&Concepts<'_>>,
    faults: &mut Vec<Diagnostic>,
) -> Option<AgentSet> {
    let before = faults.len();
    let mut fields = Fields::open(node, "the agents of a split", faults)?;
    let mut room = MAX_AGENTS;
    let mut entries = |key: &str, kind: AgentKind, own: Option<KindName>, faults: &mut Vec<Diagnostic>| {
        let mut groups = Vec::new();
        let items = fields.optional(key.to_owned()).and_then(|node| list(node, key, faults));
        for item in items.unwrap_or_default() {
            if faults.len() <= MAX_FAULTS {
                groups.extend(group(item, kind, own, &mut room, concepts, faults));
            }
        }
        groups
    };
    let cars = entries("cars", AgentKind::Car, None, faults);
    let pedestrians = entries("pedestrians", AgentKind::Pedestrian, None, faults);
    let own = kinds.own_with_ids().map(|(kind, own)| OwnGroups {
        kind,
        name: own.name.value,
        of: own.of,
        groups: entries(own.name.value.as_str(), own.of, Some(own.name.value), faults),
    });
    let own: Vec<OwnGroups> = own.collect();
    let own: Vec<OwnGroups> = own.into_iter().filter(|own| !own.groups.is_empty()).collect();
    let repeat_node = fields.optional("repeat");
    let repeat = repeat_node.map_or(Some(1), |node| integer(node, 1..=MAX_REPEATED, faults));
    let trip = fields.optional("trip").map(|node| {
        let value = integer(node, 1..=MAX_REGION, faults)?;
        Some(Located { value, span: node.span })
    });
    let before_keys = faults.len();
    fields.close(faults);
    for fault in &mut faults[before_keys..] {
        fault.help.push(kinds_help(kinds));
    }
    if cars.is_empty() && pedestrians.is_empty() && own.is_empty() && faults.len() == before && !node.partial {
        let message = format!("the split `{}` has no agents", split.name());
        let fault = Diagnostic::new(yaml::codes::INVALID_VALUE, message).at(node.span, "");
        faults.push(fault.help("give it `cars` or `pedestrians`"));
    }
    let set = AgentSet {
        cars,
        pedestrians,
        own,
        repeat: repeat?,
        region,
        trip: trip.map_or(Some(None), |trip| trip.map(Some))?,
        span: node.span,
    };
    if let Some(node) = repeat_node
        && set.len() > MAX_REPEATED as usize
    {
        let message = format!("{} agents in a split, the limit is {MAX_REPEATED}", set.len());
        faults.push(Diagnostic::new(diag::codes::LIMIT_EXCEEDED, message).at(node.span, "too many repetitions"));
        return None;
    }
    Some(set)
}

/// Reads one entry of an agent list. `room` is what remains of [`MAX_AGENTS`]; a carried concept counts as much as an
/// agent.
fn group(
    node: &YamlNode,
    kind: AgentKind,
    own: Option<KindName>,
    room: &mut u32,
    known: Option<&Concepts<'_>>,
    faults: &mut Vec<Diagnostic>,
) -> Option<AgentGroup> {
    let what = match (kind, own) {
        (_, Some(_)) => "an agent of this kind",
        (AgentKind::Car, None) => "a car",
        (AgentKind::Pedestrian, None) => "a pedestrian",
    };
    let mut fields = Fields::open(node, what, faults)?;
    let concepts = fields
        .optional("concepts")
        .map_or(Some(Vec::new()), |node| carried(node, kind, known, faults));
    let priority = match kind {
        AgentKind::Car => fields.required("priority", faults),
        AgentKind::Pedestrian => fields.optional("priority"),
    };
    let priority = priority.map_or(Some(0), |node| integer(node, i32::MIN..=i32::MAX, faults));
    let count = fields
        .optional("count")
        .map_or(Some(1), |node| integer(node, 1..=MAX_AGENTS, faults));
    let help = "write `priority: 1`, for example: of two cars, the one with the smaller number goes first";
    fields.close_with((kind == AgentKind::Car).then_some(help), faults);
    let (concepts, priority, count) = (concepts?, priority?, count?);
    let own = own.map(|name| name.as_str().to_owned());
    let concepts: Arc<[String]> = own
        .into_iter()
        .chain(concepts.into_iter().map(|concept| concept.value))
        .collect();
    let needed = u32::try_from(1 + concepts.len())
        .ok()
        .and_then(|each| each.checked_mul(count));
    let Some(left) = needed.and_then(|needed| room.checked_sub(needed)) else {
        let message = format!("a split has more than {MAX_AGENTS} agents and carried concepts");
        faults.push(Diagnostic::new(diag::codes::LIMIT_EXCEEDED, message).at(node.span, "too many here"));
        return None;
    };
    *room = left;
    Some(AgentGroup {
        count,
        concepts,
        priority,
    })
}
