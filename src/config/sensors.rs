//! Reads the sensors of a task.

use crate::config::model::{Sender, Sensor, SensorOutput, SensorsConfig, ShareConfig, ShareOrder};
use crate::config::predicates::{Predicates, SEES};
use crate::diag::{Diagnostic, did_you_mean, listed};
use crate::located::Located;
use crate::predicate::Definition;
use crate::yaml::codes;
use crate::yaml::read::{Fields, choice, integer, list, number, present};
use crate::yaml::{Value, YamlNode};

/// The maximum range in cells.
const MAX_RANGE: u32 = 1_000_000;
/// The maximum number of facts that are told in a tick.
const MAX_FACTS: u32 = 10_000;
/// The maximum delay in ticks.
const MAX_DELAY: u32 = 100;
/// The maximum correlation of noise in successive ticks.
const MAX_CORRELATION: f64 = 0.999;

/// What can hide an agent.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Occluder {
    Buildings,
    Agents,
}

/// Reads `sensors`.
pub(super) fn sensors(
    node: &YamlNode,
    predicates: Option<&Predicates>,
    faults: &mut Vec<Diagnostic>,
) -> Option<SensorsConfig> {
    let mut fields = Fields::open(node, "sensors", faults)?;
    let outputs = SensorOutput::ALL.map(|output| (output.name(), output));
    let output =
        (fields.optional("output")).map_or(Some(SensorOutput::default()), |node| choice(node, &outputs, faults));
    let exact_ego = (fields.optional("ego")).map_or(Some(false), |node| {
        choice(node, &[("exact", true), ("sensed", false)], faults)
    });
    let common = sensor(&mut fields, Sensor::default(), faults);
    let own = fields.optional("predicates");
    let share_of = fields.optional("share").map(|node| share(node, faults));
    fields.close(faults);
    let common = common?;
    let own = own.map_or(Some(Vec::new()), |node| of_predicates(node, common, predicates, faults));
    Some(SensorsConfig {
        output: output?,
        exact_ego: exact_ego?,
        common,
        predicates: own?,
        share: share_of.map_or(Some(None), |share| share.map(Some))?,
        span: node.span,
    })
}

/// Reads `share`.
fn share(node: &YamlNode, faults: &mut Vec<Diagnostic>) -> Option<ShareConfig> {
    let mut fields = Fields::open(node, "what others tell", faults)?;
    let facts = (fields.required("facts", faults)).and_then(|node| integer(node, 0..=MAX_FACTS, faults));
    let orders = ShareOrder::ALL.map(|order| (order.name(), order));
    let by = (fields.optional("by")).map_or(Some(ShareOrder::default()), |node| choice(node, &orders, faults));
    let from = (fields.optional("from")).map_or(Some(true), |node| {
        choice(node, &[("assistant", true), ("cars", false)], faults)
    });
    let entities = (fields.optional("entities")).map(|node| integer(node, 0..=MAX_FACTS, faults));
    let radius_node = fields.optional("radius");
    let radius = radius_node.map(|node| integer(node, 1..=MAX_RANGE, faults));
    fields.close(faults);
    let is_assistant = from?;
    if let Some(node) = radius_node.filter(|_| is_assistant) {
        let fault = Diagnostic::new(codes::INVALID_VALUE, "the assistant has no radius").at(node.span, "");
        faults.push(fault.help("set `from: cars`, or remove the radius"));
        return None;
    }
    let radius = radius.map_or(Some(None), |radius| radius.map(Some))?;
    Some(ShareConfig {
        facts: facts?,
        by: by?,
        from: if is_assistant {
            Sender::Assistant
        } else {
            Sender::Cars { radius }
        },
        entities: entities.map_or(Some(None), |entities| entities.map(Some))?,
    })
}

/// Reads the sensors of single predicates.
fn of_predicates(
    node: &YamlNode,
    common: Sensor,
    predicates: Option<&Predicates>,
    faults: &mut Vec<Diagnostic>,
) -> Option<Vec<(Located<String>, Sensor)>> {
    let present = present(node, "sensors by predicate", "sensor of the predicate", &[], faults)?;
    let entry = |(key, node): &(crate::yaml::Key, YamlNode)| {
        let known = predicates.map(|predicates| &predicates.used);
        let found = known.map(|used| used.iter().find(|known| known.name.value == key.text));
        let message = match found {
            Some(None) => Some(format!("the configuration has no predicate `{}`", key.text)),
            Some(Some(_)) if key.text == SEES => {
                Some(format!("no sensor reads `{SEES}`: the ego observes what it sees"))
            }
            Some(Some(known)) if matches!(known.definition, Definition::Quantity(_)) => Some(format!(
                "`{}` has values; sensors read truth values, and quantities are exact",
                key.text
            )),
            _ => None,
        };
        if let Some(message) = message {
            let mut fault = Diagnostic::new(codes::INVALID_VALUE, message);
            if matches!(found, Some(None)) {
                let used = known.into_iter().flatten().filter(|known| known.name.value != SEES);
                let names: Vec<&str> = used.map(|known| known.name.value.as_str()).collect();
                fault = match did_you_mean(&key.text, names.iter().copied()) {
                    Some(near) => fault.did_you_mean(near, &[key.span]),
                    None => fault.help(format!("the predicates are: {}", listed(&names))),
                };
            }
            faults.push(fault.at(key.span, ""));
        }
        let mut fields = Fields::open(node, "a sensor", faults)?;
        let sensor = sensor(&mut fields, common, faults);
        fields.close(faults);
        let name = Located {
            value: key.text.clone(),
            span: key.span,
        };
        Some((name, sensor?))
    };
    // Reads every entry, so that one run reports all faults.
    let sensors: Vec<Option<(Located<String>, Sensor)>> = present.into_iter().map(entry).collect();
    sensors.into_iter().collect()
}

/// Reads the keys of a sensor; `base` has the values of those that are missing.
fn sensor(fields: &mut Fields<'_>, base: Sensor, faults: &mut Vec<Diagnostic>) -> Option<Sensor> {
    let mut rate = |key: &'static str, base, most, expected, faults: &mut Vec<Diagnostic>| {
        (fields.optional(key)).map_or(Some(base), |node| number(node, 0.0..=most, expected, faults))
    };
    let probability = "a probability from 0 to 1";
    let true_positive_rate = rate("true_positive_rate", base.true_positive_rate, 1.0, probability, faults);
    let false_positive_rate = rate(
        "false_positive_rate",
        base.false_positive_rate,
        1.0,
        probability,
        faults,
    );
    let dropout = rate("dropout", base.dropout, 1.0, probability, faults);
    let correlation = rate(
        "correlation",
        base.correlation,
        MAX_CORRELATION,
        "a correlation from 0 to 0.999",
        faults,
    );
    let range =
        (fields.optional("range")).map_or(Some(base.range), |node| integer(node, 1..=MAX_RANGE, faults).map(Some));
    let delay = (fields.optional("delay")).map_or(Some(base.delay), |node| integer(node, 0..=MAX_DELAY, faults));
    let inherited = [
        (base.occluded_by_buildings, Occluder::Buildings),
        (base.occluded_by_agents, Occluder::Agents),
    ];
    let inherited = inherited.iter().filter(|(occludes, _)| *occludes);
    let occluders = match fields.optional("occluded_by") {
        None => Some(inherited.map(|(_, occluder)| *occluder).collect()),
        Some(node) => occluders(node, faults),
    }?;
    Some(Sensor {
        true_positive_rate: true_positive_rate?,
        false_positive_rate: false_positive_rate?,
        range: range?,
        occluded_by_buildings: occluders.contains(&Occluder::Buildings),
        occluded_by_agents: occluders.contains(&Occluder::Agents),
        delay: delay?,
        dropout: dropout?,
        correlation: correlation?,
    })
}

/// Reads one occluder or a list of them.
fn occluders(node: &YamlNode, faults: &mut Vec<Diagnostic>) -> Option<Vec<Occluder>> {
    let words = [("buildings", Occluder::Buildings), ("agents", Occluder::Agents)];
    if matches!(node.value, Value::Scalar { .. }) {
        return choice(node, &words, faults).map(|occluder| vec![occluder]);
    }
    let items = list(node, "`buildings` and `agents`", faults)?;
    items.iter().map(|item| choice(item, &words, faults)).collect()
}
