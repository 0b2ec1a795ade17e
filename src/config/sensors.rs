//! The sensors through which the ego of a task observes facts, and their reader.

use crate::config::SEES;
use crate::config::predicates::Predicates;
use crate::diag::{Diagnostic, Span, did_you_mean};
use crate::located::Located;
use crate::predicate::Definition;
use crate::yaml::codes;
use crate::yaml::read::{Fields, choice, entries, integer, list, number};
use crate::yaml::{Value, YamlNode};
use serde::Serialize;

/// The maximum range in cells.
const MAX_RANGE: u32 = 1_000_000;
/// The maximum delay in ticks.
const MAX_DELAY: u32 = 100;
/// The maximum correlation of noise in successive ticks.
const MAX_CORRELATION: f64 = 0.999;

/// The sensors of an ego. They read the truth values of the observed facts; quantities and `Sees` are exact.
#[derive(Clone, Debug, Serialize)]
pub struct SensorsConfig {
    /// What the observation has for each fact.
    pub output: SensorOutput,
    /// Whether the ego knows the facts about itself alone without sensors.
    pub exact_ego: bool,
    /// The sensors of all predicates without an entry in `predicates`.
    pub common: Sensor,
    /// The sensors of single predicates.
    pub predicates: Vec<(Located<String>, Sensor)>,
    /// The place of the configuration.
    #[serde(skip)]
    pub span: Span,
}

impl SensorsConfig {
    /// Returns the sensor of a predicate.
    pub fn of(&self, predicate: &str) -> Sensor {
        let own = self.predicates.iter().find(|(name, _)| name.value == predicate);
        own.map_or(self.common, |(_, sensor)| *sensor)
    }
}

/// What an observation through sensors has for each fact.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub enum SensorOutput {
    /// 1 if the sensor reads that the fact holds, else 0, also without a reading.
    #[default]
    Facts,
    /// The probability that the fact holds, given the reading of this tick.
    Probabilities,
    /// The probability that the fact holds, given all readings of the episode.
    Belief,
}

impl SensorOutput {
    /// All outputs.
    pub const ALL: [SensorOutput; 3] = [SensorOutput::Facts, SensorOutput::Probabilities, SensorOutput::Belief];

    /// Returns its name: `facts`, `probabilities` or `belief`.
    pub const fn name(self) -> &'static str {
        match self {
            SensorOutput::Facts => "facts",
            SensorOutput::Probabilities => "probabilities",
            SensorOutput::Belief => "belief",
        }
    }
}

/// How the truth values of a predicate are read. The default reads them exactly.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Sensor {
    /// The probability that a fact that holds is read as holding.
    pub true_positive_rate: f64,
    /// The probability that a fact that does not hold is read as holding.
    pub false_positive_rate: f64,
    /// The maximum Euclidean distance in cells between the ego and each other agent of the fact; `None` for no bound.
    pub range: Option<u32>,
    /// Whether a building on the line from the ego to an agent hides it.
    pub occluded_by_buildings: bool,
    /// Whether a third agent on the line from the ego to an agent hides it.
    pub occluded_by_agents: bool,
    /// The age of a reading in ticks.
    pub delay: u32,
    /// The probability that there is no reading.
    pub dropout: f64,
    /// The probability that the noise of a fact is that of the tick before instead of a new draw. It is the correlation
    /// of the noise in successive ticks.
    pub correlation: f64,
}

impl Default for Sensor {
    fn default() -> Self {
        Sensor {
            true_positive_rate: 1.0,
            false_positive_rate: 0.0,
            range: None,
            occluded_by_buildings: false,
            occluded_by_agents: false,
            delay: 0,
            dropout: 0.0,
            correlation: 0.0,
        }
    }
}

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
    fields.close(faults);
    let common = common?;
    let own = own.map_or(Some(Vec::new()), |node| of_predicates(node, common, predicates, faults));
    Some(SensorsConfig {
        output: output?,
        exact_ego: exact_ego?,
        common,
        predicates: own?,
        span: node.span,
    })
}

/// Reads the sensors of single predicates.
fn of_predicates(
    node: &YamlNode,
    common: Sensor,
    predicates: Option<&Predicates>,
    faults: &mut Vec<Diagnostic>,
) -> Option<Vec<(Located<String>, Sensor)>> {
    let entries = entries(node, "sensors by predicate", faults)?;
    let present = entries.iter().filter(|(_, node)| !node.is_null());
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
            let names = known.into_iter().flatten().map(|known| known.name.value.as_str());
            if let (Some(None), Some(near)) = (found, did_you_mean(&key.text, names)) {
                fault = fault.did_you_mean(near, &[key.span]);
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
    let sensors: Vec<Option<(Located<String>, Sensor)>> = present.map(entry).collect();
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
