//! What others tell the ego: facts of which its sensors have no reading.
//!
//! The senders are the other cars nearby, or an assistant that knows all. Together they tell at most `facts` facts in a
//! tick. *Relevant* facts are some with which the rules derive the same actions as with all facts that could be told.

use crate::config::{ShareConfig, ShareOrder};
use crate::diag::Diagnostic;
use crate::rng::{Purpose, Words};
use crate::sim::tick::agent_state::AgentState;
use crate::sim::tick::vocabulary::Actions;

impl Purpose {
    /// The order of the facts that others tell an ego; index: the agent.
    pub const SHARE: Purpose = Purpose::new(54);
}

/// A fact that holds and of which the ego has no reading.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Fact {
    /// The place of its set in [`Atoms::words`](super::observed::Atoms::words).
    pub set: usize,
    /// The first entity of a binary fact.
    pub row: Option<usize>,
    /// The entity; the second one of a binary fact.
    pub entity: usize,
    /// The position of its number in the observation.
    pub place: usize,
    /// The position of its predicate's sensor among the different ones.
    pub group: usize,
}

impl Fact {
    /// Returns the agents that it is about besides the ego, as a set of entities.
    fn others(self) -> u64 {
        (self.row.map_or(0, |row| 1 << row) | 1 << self.entity) & !1
    }

    /// Returns the square of the distance from the ego to its farthest agent, in cells.
    fn squared_distance(self, bodies: &[AgentState]) -> i64 {
        let of = |entity: usize| {
            let [to, from] = [bodies[entity].at, bodies[0].at];
            let [rows, cols] = [to.row - from.row, to.col - from.col].map(i64::from);
            rows * rows + cols * cols
        };
        self.row.map_or(0, of).max(of(self.entity))
    }
}

/// Chooses the facts to tell the ego among those that can be told. `derive` returns the actions that the rules derive
/// once the given facts are told.
///
/// # Errors
/// Those of `derive`.
pub(super) fn choose(
    config: &ShareConfig,
    mut facts: Vec<Fact>,
    bodies: &[AgentState],
    derive: impl FnMut(&[Fact]) -> Result<Actions, Diagnostic>,
    mut random: Words,
) -> Result<Vec<Fact>, Diagnostic> {
    let near = |fact: &Fact| (fact.squared_distance(bodies), fact.place);
    facts.sort_by_key(near);
    match config.by {
        ShareOrder::Distance => {}
        ShareOrder::Random => {
            let keys: Vec<u64> = facts.iter().map(|_| random.next_word()).collect();
            let mut drawn: Vec<(u64, Fact)> = keys.into_iter().zip(facts).collect();
            drawn.sort_by_key(|(key, fact)| (*key, fact.place));
            facts = drawn.into_iter().map(|(_, fact)| fact).collect();
        }
        // If all can be told, the order does not matter.
        ShareOrder::Relevance if facts.len() <= config.facts as usize && config.entities.is_none() => {}
        ShareOrder::Relevance => {
            let relevant = relevant(&facts, derive)?;
            let (mut first, rest): (Vec<Fact>, Vec<Fact>) = facts.into_iter().partition(|fact| relevant.contains(fact));
            first.extend(rest);
            facts = first;
        }
    }
    let (most, mut about, mut told) = (config.entities.unwrap_or(u32::MAX), 0u64, Vec::new());
    for fact in facts {
        if told.len() == config.facts as usize {
            break;
        }
        if (about | fact.others()).count_ones() <= most {
            about |= fact.others();
            told.push(fact);
        }
    }
    Ok(told)
}

/// Returns relevant facts: drops facts from the last one on, as long as the derived actions stay the same.
fn relevant(
    facts: &[Fact],
    mut derive: impl FnMut(&[Fact]) -> Result<Actions, Diagnostic>,
) -> Result<Vec<Fact>, Diagnostic> {
    let all = derive(facts)?;
    if derive(&[])? == all {
        return Ok(Vec::new());
    }
    let mut kept = facts.to_vec();
    for at in (0..facts.len()).rev() {
        let fact = kept.remove(at);
        if derive(&kept)? != all {
            kept.insert(at, fact);
        }
    }
    Ok(kept)
}
