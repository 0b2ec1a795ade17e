//! Reads the shield of a task.

use crate::config::model::{ShieldConfig, ShieldMode, ShieldQuery};
use crate::diag::Diagnostic;
use crate::yaml::YamlNode;
use crate::yaml::codes;
use crate::yaml::read::{Fields, choice, number};

/// Reads `shield`.
pub(super) fn shield(node: &YamlNode, faults: &mut Vec<Diagnostic>) -> Option<ShieldConfig> {
    let mut fields = Fields::open(node, "the shield", faults)?;
    let modes = ShieldMode::ALL.map(|mode| (mode.name(), mode));
    let mode = (fields.required("mode", faults)).and_then(|node| choice(node, &modes, faults));
    let queries = ShieldQuery::ALL.map(|query| (query.name(), query));
    let query_node = fields.optional("query");
    let usual = mode.map_or(ShieldQuery::default(), ShieldMode::default_query);
    let query = query_node.map_or(Some(usual), |node| choice(node, &queries, faults));
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
    let query = query?;
    if let Some(node) = query_node.filter(|_| !mode.supports(query)) {
        let message = format!(
            "the mode `{}` does not support the query `{}`",
            mode.name(),
            query.name()
        );
        let fault = Diagnostic::new(codes::INVALID_VALUE, message).at(node.span, "");
        faults.push(fault.help("set `query: safe`, or `mode: override`"));
        return None;
    }
    Some(ShieldConfig {
        mode,
        query,
        threshold: threshold?,
    })
}
