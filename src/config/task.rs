//! Reads the task of a run configuration: Safe Path Following.

use crate::city::{ActionTable, AgentKind, Split};
use crate::config::compose::Composer;
use crate::config::model::*;
use crate::config::predicates::{Concepts, Predicates, carried};
use crate::config::sensors::sensors;
use crate::config::shield::shield;
use crate::diag::Diagnostic;
use crate::located::Located;
use crate::yaml::read::{Fields, choice, integer, invalid, list, number, present};
use crate::yaml::{Value, YamlNode};
use std::sync::Arc;

/// The maximum number of observed entities.
const MAX_ENTITIES: u32 = 64;
/// The maximum number of egos.
const MAX_EGOS: u32 = 1024;
/// The maximum number of rows of the `state` observation.
const MAX_STATE_AGENTS: u32 = 1024;
/// The maximum length of an episode, in steps.
const MAX_HORIZON: u32 = 1_000_000;
/// The maximum multiple of the oracle's steps.
const MAX_PATIENCE: u32 = 1000;
/// The maximum number of episodes of a stage of the curriculum.
const MAX_EPISODES: u64 = 1_000_000_000;
/// The maximum number of agents of a stage of the curriculum.
const MAX_STAGE_AGENTS: u32 = 1_000_000;
/// The maximum absolute value of a reward.
const MAX_REWARD: f64 = 1e6;

/// Reads the configuration of Safe Path Following.
pub(super) fn spf(
    composer: &mut Composer<'_>,
    node: &YamlNode,
    predicates: Option<&Predicates>,
    table: &ActionTable,
) -> Option<SpfConfig> {
    let mut fields = Fields::open(node, "a task", &mut composer.faults)?;
    fields.optional("base");
    let episodes = fields.optional("episodes").map(|node| episodes(composer, node));
    let faults = &mut composer.faults;
    let mut count = |key, most| {
        let node = fields.required(key, faults)?;
        integer(node, 1..=most, faults)
    };
    let (entities, state_agents) = (count("entities", MAX_ENTITIES), count("state_agents", MAX_STATE_AGENTS));
    let (horizon, patience) = (count("horizon", MAX_HORIZON), count("patience", MAX_PATIENCE));
    let orders = EntityOrder::ALL.map(|order| (order.name(), order));
    let order = (fields.optional("order")).map_or(Some(EntityOrder::default()), |node| choice(node, &orders, faults));
    let constrained_steps =
        (fields.optional("constrained_steps")).map_or(Some(1), |node| integer(node, 1..=MAX_HORIZON, faults));
    let curriculum = (fields.optional("curriculum")).map_or(Some(Vec::new()), |node| curriculum(node, faults));
    let route_length = (fields.required("route_length", faults)).and_then(|node| yes_or_no(node, faults));
    let reward_of = fields
        .required("reward", faults)
        .and_then(|node| reward(node, table, faults));
    let egos_of = fields.optional("egos").map(|node| {
        let value = integer(node, 1..=MAX_EGOS, faults)?;
        Some(Located { value, span: node.span })
    });
    let ego_of = fields.optional("ego").map(|node| ego(node, predicates, faults));
    let sensors_of = fields.optional("sensors").map(|node| sensors(node, predicates, faults));
    let shield_of = fields.optional("shield").map(|node| {
        let value = shield(node, faults)?;
        Some(Located { value, span: node.span })
    });
    let usual = "`base: configs/tasks/common.yaml` has defaults";
    fields.close_with(Some(usual), faults);
    Some(SpfConfig {
        entities: entities?,
        state_agents: state_agents?,
        order: order?,
        route_length: route_length?,
        horizon: horizon?,
        patience: patience?,
        reward: reward_of?,
        ego: ego_of.map_or(Some(None), |ego| ego.map(Some))?,
        egos: egos_of.map_or(Some(None), |egos| egos.map(Some))?,
        constrained_steps: constrained_steps?,
        curriculum: curriculum?,
        sensors: sensors_of.map_or(Some(None), |sensors| sensors.map(Some))?,
        shield: shield_of.map_or(Some(None), |shield| shield.map(Some))?,
        episodes: episodes.map_or(Some(Default::default()), |episodes| episodes)?,
        span: node.span,
    })
}

fn yes_or_no(node: &YamlNode, faults: &mut Vec<Diagnostic>) -> Option<bool> {
    choice(node, &[("true", true), ("false", false)], faults)
}

fn reward_value(node: &YamlNode, faults: &mut Vec<Diagnostic>) -> Option<f64> {
    let range = -MAX_REWARD..=MAX_REWARD;
    number(node, range, "a reward from -1e6 to 1e6; costs are negative", faults)
}

fn reward(node: &YamlNode, table: &ActionTable, faults: &mut Vec<Diagnostic>) -> Option<RewardConfig> {
    let mut fields = Fields::open(node, "the reward", faults)?;
    let actions = fields.required("actions", faults).and_then(|node| {
        let mut fields = Fields::open(node, "the rewards of actions", faults)?;
        let mut rewards = Vec::new();
        for action in table.all() {
            let node = match action.is_standard() {
                true => fields.required(action.name(), faults),
                false => fields.optional(table.name(action).to_owned()),
            };
            rewards.push(match node {
                Some(node) => reward_value(node, faults),
                None => (!action.is_standard()).then_some(0.0),
            });
        }
        fields.close(faults);
        rewards.into_iter().collect::<Option<Vec<f64>>>()
    });
    let mut value = |key| {
        let node = fields.required(key, faults)?;
        reward_value(node, faults)
    };
    let (violation, overtime) = (value("violation"), value("overtime"));
    let per = ViolationsPer::ALL.map(|per| (per.name(), per));
    let violations_per = (fields.required("violations_per", faults)).and_then(|node| choice(node, &per, faults));
    let clauses = fields.optional("clauses").map(|node| {
        let present = present(
            node,
            "rewards by labels of clauses",
            "reward of the clause",
            &[],
            faults,
        )?;
        let clause = |(key, node): &(crate::yaml::Key, YamlNode)| {
            let value = reward_value(node, faults)?;
            let label = Located {
                value: key.text.clone(),
                span: key.span,
            };
            Some((label, value))
        };
        present.into_iter().map(clause).collect::<Option<Vec<_>>>()
    });
    let term = |fields: &mut Fields<'_>, key, faults: &mut Vec<Diagnostic>| {
        (fields.optional(key)).map_or(Some(0.0), |node| reward_value(node, faults))
    };
    let (progress, goal) = (term(&mut fields, "progress", faults), term(&mut fields, "goal", faults));
    let potential = (fields.optional("potential")).map_or(Some(Potential::default()), |node| potential(node, faults));
    fields.close(faults);
    Some(RewardConfig {
        actions: actions?,
        violation: violation?,
        violations_per: violations_per?,
        clauses: clauses.map_or(Some(Vec::new()), |clauses| clauses)?,
        overtime: overtime?,
        shaping: Shaping {
            progress: progress?,
            goal: goal?,
            potential: potential?,
        },
    })
}

fn potential(node: &YamlNode, faults: &mut Vec<Diagnostic>) -> Option<Potential> {
    let mut fields = Fields::open(node, "the potential", faults)?;
    let default = Potential::default();
    let weight = (fields.optional("weight")).map_or(Some(default.weight), |node| {
        number(node, 0.0..=MAX_REWARD, "a weight from 0 to 1e6", faults)
    });
    let kinds = PotentialOf::ALL.map(|of| (of.name(), of));
    let of = (fields.optional("of")).map_or(Some(default.of), |node| choice(node, &kinds, faults));
    let gamma = (fields.optional("gamma")).map_or(Some(default.gamma), |node| {
        number(node, 0.0..=1.0, "a discount factor from 0 to 1", faults)
    });
    fields.close(faults);
    Some(Potential {
        weight: weight?,
        of: of?,
        gamma: gamma?,
    })
}

fn curriculum(node: &YamlNode, faults: &mut Vec<Diagnostic>) -> Option<Vec<CurriculumStage>> {
    let stages = list(node, "stages with `until` and `agents`", faults)?;
    let mut reached = 0;
    let stage = |item: &YamlNode| {
        let mut fields = Fields::open(item, "a stage of the curriculum", faults)?;
        let until_node = fields.required("until", faults);
        let until = until_node.and_then(|node| integer(node, 1..=MAX_EPISODES, faults));
        let agents = (fields.required("agents", faults)).and_then(|node| {
            let value = integer(node, 1..=MAX_STAGE_AGENTS, faults)?;
            Some(Located { value, span: node.span })
        });
        fields.close(faults);
        let until = until?;
        if until <= reached {
            let after = format_args!("more episodes than the {reached} at which the stage before ends");
            invalid(until_node?, after, faults);
            return None;
        }
        reached = until;
        Some(CurriculumStage { until, agents: agents? })
    };
    // Reads every stage, so that one run reports all faults.
    let stages: Vec<Option<CurriculumStage>> = stages.iter().map(stage).collect();
    stages.into_iter().collect()
}

fn ego(node: &YamlNode, predicates: Option<&Predicates>, faults: &mut Vec<Diagnostic>) -> Option<EgoConfig> {
    let mut fields = Fields::open(node, "the ego", faults)?;
    let priority = (fields.required("priority", faults)).and_then(|node| by_split(node, faults));
    let known = predicates.map(Concepts::new);
    let concepts = fields.required("concepts", faults).and_then(|node| {
        let items = list(node, "variants of the ego", faults)?;
        let weighted = |item: &YamlNode| {
            let mut fields = Fields::open(item, "a variant of the ego", faults)?;
            let weight = (fields.required("weight", faults))
                .and_then(|node| number(node, 0.0..=1e9, "a weight from 0 to 1e9", faults));
            let concepts = (fields.optional("concepts")).map_or(Some(Vec::new()), |node| {
                carried(node, AgentKind::Car, known.as_ref(), faults)
            });
            fields.close(faults);
            let concepts: Arc<[String]> = concepts?.into_iter().map(|concept| concept.value).collect();
            Some((weight?, concepts))
        };
        let weighted: Vec<_> = items.iter().map(weighted).collect::<Option<_>>()?;
        if weighted.iter().all(|(weight, _)| *weight == 0.0) {
            invalid(node, "at least one entry whose weight is not 0", faults);
            return None;
        }
        Some(weighted)
    });
    fields.close(faults);
    Some(EgoConfig {
        priority: priority?,
        concepts: concepts?,
    })
}

/// Reads one number, or one for each split; all splits are required.
fn by_split(node: &YamlNode, faults: &mut Vec<Diagnostic>) -> Option<[u32; 3]> {
    let most = i32::MAX.cast_unsigned();
    if !matches!(node.value, Value::Map(_)) {
        return integer(node, 1..=most, faults).map(|value| [value; 3]);
    }
    let mut fields = Fields::open(node, "the greatest priorities", faults)?;
    let values = Split::ALL.map(|split| {
        let node = fields.required(split.name(), faults)?;
        integer(node, 1..=most, faults)
    });
    fields.close(faults);
    let [train, val, test] = values;
    Some([train?, val?, test?])
}

fn episodes(composer: &mut Composer<'_>, node: &YamlNode) -> Option<[Option<Located<std::path::PathBuf>>; 3]> {
    let mut fields = Fields::open(node, "the files of episodes", &mut composer.faults)?;
    let nodes = Split::ALL.map(|split| fields.optional(split.name()));
    fields.close(&mut composer.faults);
    let mut found = [None, None, None];
    for (found, node) in found.iter_mut().zip(nodes) {
        if let Some(node) = node {
            *found = Some(Located {
                value: composer.name_file(node)?,
                span: node.span,
            });
        }
    }
    Some(found)
}
