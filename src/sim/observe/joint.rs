//! Joint shields: the safe joint action of several egos that is nearest to the proposed one.
//!
//! The safety of an ego's action depends only on its own action and on those of the egos in its *scope*, which its
//! rules read. Egos whose scopes are connected form a group. A search by branch and bound changes the fewest actions of
//! each group in which an action is not safe, so that independent egos cost no more together than alone.

use crate::city::Action;
use crate::diag::Diagnostic;
use crate::diag::codes;

/// The maximum number of joint actions of a group, partial ones included, that the search tries.
const TRIES_MAX: usize = 1_000_000;

/// The actions that egos propose, and what else the search needs of each ego.
pub(super) struct Proposal {
    /// The proposed actions.
    pub actions: Vec<Action>,
    /// For each ego, the alternatives to the proposed action, in the order in which it prefers them.
    pub alternatives: Vec<Vec<Action>>,
    /// For each ego, the other egos whose actions matter for it.
    pub scopes: Vec<Vec<usize>>,
}

impl Proposal {
    /// Returns the groups of egos: those connected by scopes, each in ascending order.
    fn groups(&self) -> Vec<Vec<usize>> {
        let mut group: Vec<usize> = (0..self.actions.len()).collect();
        for (ego, scope) in self.scopes.iter().enumerate() {
            for &other in scope {
                let [keep, join] = [group[ego].min(group[other]), group[ego].max(group[other])];
                group.iter_mut().filter(|of| **of == join).for_each(|of| *of = keep);
            }
        }
        let all = 0..group.len();
        let members = all
            .clone()
            .map(|of| all.clone().filter(|ego| group[*ego] == of).collect());
        members.filter(|members: &Vec<usize>| !members.is_empty()).collect()
    }

    /// Returns the safe joint action that changes the fewest proposed actions. Among several, the first ego decides
    /// first: it keeps its action if it can, and otherwise takes the alternative that it prefers; then the second ego
    /// decides, and so on. A group without a safe joint action takes the actions of `fallback`. `is_safe` says whether
    /// the action of an ego is safe in a joint action; it reads only those of its scope.
    ///
    /// # Errors
    /// Those of `is_safe`; `limit-exceeded` if the search tries too many joint actions.
    pub fn nearest_safe(
        &self,
        fallback: &[Action],
        mut is_safe: impl FnMut(usize, &[Action]) -> Result<bool, Diagnostic>,
    ) -> Result<Vec<Action>, Diagnostic> {
        let mut result = self.actions.clone();
        for group in self.groups() {
            let mut safe = true;
            for &ego in &group {
                safe = safe && is_safe(ego, &result)?;
            }
            if safe {
                continue;
            }
            let mut search = Search {
                proposal: self,
                group: &group,
                joint: self.actions.clone(),
                best: None,
                tries: 0,
                is_safe: &mut is_safe,
            };
            search.extend(0, 0)?;
            let best = search.best.map(|(_, joint)| joint);
            for &ego in &group {
                result[ego] = best.as_ref().map_or(fallback[ego], |joint| joint[ego]);
            }
        }
        Ok(result)
    }
}

struct Search<'a, F> {
    proposal: &'a Proposal,
    group: &'a [usize],
    joint: Vec<Action>,
    /// The number of changed actions, and the joint action.
    best: Option<(usize, Vec<Action>)>,
    tries: usize,
    is_safe: &'a mut F,
}

impl<F: FnMut(usize, &[Action]) -> Result<bool, Diagnostic>> Search<'_, F> {
    /// Tries all actions of the ego at a place of the group, given those before it. `changed` of these differ from the
    /// proposed ones.
    fn extend(&mut self, place: usize, changed: usize) -> Result<(), Diagnostic> {
        if self.best.as_ref().is_some_and(|(best, _)| changed >= *best) {
            return Ok(());
        }
        let Some(&ego) = self.group.get(place) else {
            self.best = Some((changed, self.joint.clone()));
            return Ok(());
        };
        let proposed = self.proposal.actions[ego];
        let options =
            std::iter::once((0, proposed)).chain(self.proposal.alternatives[ego].iter().map(|action| (1, *action)));
        for (cost, action) in options {
            self.tries += 1;
            if self.tries > TRIES_MAX {
                let egos = self.group.len();
                let message = format!("the joint shield tried {TRIES_MAX} joint actions of {egos} egos");
                let fault = Diagnostic::new(codes::LIMIT_EXCEEDED, message);
                return Err(fault.help("control fewer egos, or use the mode `override`"));
            }
            self.joint[ego] = action;
            if self.holds(place)? {
                self.extend(place + 1, changed + cost)?;
            }
        }
        self.joint[ego] = proposed;
        Ok(())
    }

    /// Returns whether every ego whose scope is complete at a place of the group is safe.
    fn holds(&mut self, place: usize) -> Result<bool, Diagnostic> {
        let last = self.group[place];
        for &ego in &self.group[..=place] {
            let scope = &self.proposal.scopes[ego];
            let end = scope.iter().copied().max().unwrap_or(0).max(ego);
            if end == last && !(self.is_safe)(ego, &self.joint)? {
                return Ok(false);
            }
        }
        Ok(true)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::{Purpose, RngExt, Seed};

    /// Compares the search with all joint actions, on random constraints.
    #[test]
    fn the_search_equals_trying_all_joint_actions() {
        let mut random = Seed(7).stream(Purpose::TEST, 0, 0);
        let (mut changes, mut none) = ([0; 5], 0);
        for _ in 0..400 {
            let egos = random.random_range(1..=4);
            let action = |random: &mut _| Action::STANDARD[RngExt::random_range(random, 0..4)];
            let actions: Vec<Action> = (0..egos).map(|_| action(&mut random)).collect();
            let scopes: Vec<Vec<usize>> = (0..egos)
                .map(|ego| {
                    (0..egos)
                        .filter(|other| *other != ego && random.random_bool(0.35))
                        .collect()
                })
                .collect();
            let proposal = Proposal {
                alternatives: (actions.iter())
                    .map(|proposed| {
                        Action::STANDARD
                            .into_iter()
                            .filter(|action| action != proposed)
                            .collect()
                    })
                    .collect(),
                actions,
                scopes,
            };
            // A random table of the scope of each ego.
            let share = random.random_range(0.1..0.9);
            let code = |ego: usize, joint: &[Action]| {
                let of = |other: &usize| joint[*other].index();
                proposal.scopes[ego]
                    .iter()
                    .map(of)
                    .fold(joint[ego].index(), |code, action| 4 * code + action)
            };
            let tables: Vec<Vec<bool>> = (0..egos)
                .map(|ego| {
                    (0..4usize.pow(1 + proposal.scopes[ego].len() as u32))
                        .map(|_| random.random_bool(share))
                        .collect()
                })
                .collect();
            let fallback = vec![Action::STANDARD[0]; egos];
            let found = proposal
                .nearest_safe(&fallback, |ego, joint| Ok(tables[ego][code(ego, joint)]))
                .unwrap();
            for group in proposal.groups() {
                // All joint actions of the group, in the order of preference.
                let mut best: Option<(usize, Vec<Action>)> = None;
                for number in 0..4usize.pow(group.len() as u32) {
                    let mut joint = proposal.actions.clone();
                    let mut changed = 0;
                    for (place, &ego) in group.iter().enumerate() {
                        let choice = number / 4usize.pow((group.len() - 1 - place) as u32) % 4;
                        if choice > 0 {
                            joint[ego] = proposal.alternatives[ego][choice - 1];
                            changed += 1;
                        }
                    }
                    let safe = group.iter().all(|&ego| tables[ego][code(ego, &joint)]);
                    if safe && best.as_ref().is_none_or(|(fewest, _)| changed < *fewest) {
                        best = Some((changed, joint));
                    }
                }
                match best {
                    Some((changed, joint)) => {
                        changes[changed] += 1;
                        assert!(group.iter().all(|&ego| found[ego] == joint[ego]), "{found:?} {joint:?}");
                    }
                    None => {
                        none += 1;
                        assert!(group.iter().all(|&ego| found[ego] == fallback[ego]));
                    }
                }
            }
        }
        assert!(
            changes[..4].iter().all(|count| *count > 5) && none > 20,
            "{changes:?} {none}"
        );
    }

    #[test]
    fn the_search_ends() {
        let egos = 40;
        let proposal = Proposal {
            actions: vec![Action::STANDARD[0]; egos],
            alternatives: vec![Action::STANDARD[1..].to_vec(); egos],
            scopes: (0..egos).map(|ego| vec![(ego + 1) % egos]).collect(),
        };
        // Only the last ego is never safe, which the search learns late.
        let result = proposal.nearest_safe(&proposal.actions, |ego, _| Ok(ego != egos - 1));
        assert_eq!(result.unwrap_err().code, codes::LIMIT_EXCEEDED);
    }
}
