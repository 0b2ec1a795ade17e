//! The shield of a task, and its reader.

use crate::diag::Diagnostic;
use crate::yaml::YamlNode;
use crate::yaml::codes;
use crate::yaml::read::{Fields, choice, number};
use serde::Serialize;

/// A shield: rules judge every action of the learner before the ego takes it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ShieldConfig {
    /// What happens to an action that the shield does not permit.
    pub mode: ShieldMode,
    /// Which actions the shield permits.
    pub query: ShieldQuery,
    /// In the mode `probabilistic`: the least probability of a permitted action.
    pub threshold: f64,
}

/// What a shield does with an action that it does not permit.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub enum ShieldMode {
    /// It is an error: the learner reads the mask of permitted actions.
    Mask,
    /// The ego takes the action that the rules want.
    Override,
    /// The ego takes the most probable action. Facts have the probabilities of the ego's sensors.
    Probabilistic,
}

impl ShieldMode {
    /// All modes.
    pub const ALL: [ShieldMode; 3] = [ShieldMode::Mask, ShieldMode::Override, ShieldMode::Probabilistic];

    /// Returns its name: `mask`, `override` or `probabilistic`.
    pub const fn name(self) -> &'static str {
        match self {
            ShieldMode::Mask => "mask",
            ShieldMode::Override => "override",
            ShieldMode::Probabilistic => "probabilistic",
        }
    }
}

/// What a shield asks about an action.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub enum ShieldQuery {
    /// Whether it is the action that the rules choose.
    #[default]
    Appropriate,
    /// Whether it violates no clause.
    Safe,
}

impl ShieldQuery {
    /// Both.
    pub const ALL: [ShieldQuery; 2] = [ShieldQuery::Appropriate, ShieldQuery::Safe];

    /// Returns its name: `appropriate` or `safe`.
    pub const fn name(self) -> &'static str {
        match self {
            ShieldQuery::Appropriate => "appropriate",
            ShieldQuery::Safe => "safe",
        }
    }
}

impl ShieldConfig {
    /// The threshold unless another one is given.
    pub const THRESHOLD: f64 = 0.5;
}

/// Reads `shield`.
pub(super) fn shield(node: &YamlNode, faults: &mut Vec<Diagnostic>) -> Option<ShieldConfig> {
    let mut fields = Fields::open(node, "the shield", faults)?;
    let modes = ShieldMode::ALL.map(|mode| (mode.name(), mode));
    let mode = (fields.required("mode", faults)).and_then(|node| choice(node, &modes, faults));
    let queries = ShieldQuery::ALL.map(|query| (query.name(), query));
    let query = (fields.optional("query")).map_or(Some(ShieldQuery::default()), |node| choice(node, &queries, faults));
    let threshold_node = fields.optional("threshold");
    let threshold = threshold_node.map_or(Some(ShieldConfig::THRESHOLD), |node| {
        number(node, 0.0..=1.0, "a probability from 0 to 1", faults)
    });
    fields.close(faults);
    let mode = mode?;
    if let Some(node) = threshold_node.filter(|_| mode != ShieldMode::Probabilistic) {
        let message = format!("the mode `{}` has no threshold", mode.name());
        let fault = Diagnostic::new(codes::INVALID_VALUE, message).at(node.span, "");
        faults.push(fault.help("set `mode: probabilistic`, or remove the threshold"));
        return None;
    }
    Some(ShieldConfig {
        mode,
        query: query?,
        threshold: threshold?,
    })
}
