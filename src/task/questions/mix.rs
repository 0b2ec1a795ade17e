//! How many questions have each answer.

use crate::city::Action;
use std::cmp::Reverse;
use std::collections::BTreeMap;

/// The answers of the paper's small set, in the order of [`Action::STANDARD`]. The paper prints accuracies only; these are
/// the only numbers with a sum of 117 that fit them.
const PAPER_MIX: [usize; 4] = [20, 42, 25, 30];

/// How often each answer is correct in a set. Demonstrations are always [`Mix::Equal`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mix {
    /// All answers equally often, as far as they occur.
    Equal,
    /// In the proportions of the paper's small set: Slow 20, Normal 42, Fast 25, Stop 30.
    Paper,
    /// All answers equally often among the cars with the same concepts, as far as the rules permit. If they permit some
    /// answer for all cars, a guess from the concepts of the car is no better than the same answer to every question.
    ByConcept,
}

impl Mix {
    /// All values.
    pub const ALL: [Mix; 3] = [Mix::Equal, Mix::Paper, Mix::ByConcept];

    /// Returns the name: `equal`, `paper` or `by-concept`.
    pub const fn name(self) -> &'static str {
        match self {
            Mix::Equal => "equal",
            Mix::Paper => "paper",
            Mix::ByConcept => "by-concept",
        }
    }
}

/// What a mix tells apart: the concepts of the car, which are empty unless the mix is [`Mix::ByConcept`], and the
/// answer.
pub type Category = (Vec<String>, Action);

/// Splits `count` into shares of categories that are as equal as the available numbers allow: first those of groups of
/// cars with the same concepts, then those of the answers in each group. The remainder goes to the answers that most
/// groups have, then to the first ones. So as long as enough questions are available, an answer that all groups have is
/// a most frequent one in each of them.
pub fn shares(count: usize, available: &BTreeMap<Category, usize>) -> BTreeMap<Category, usize> {
    let mut groups_with = [0; 4];
    available
        .keys()
        .for_each(|(_, action)| groups_with[action.index()] += 1);
    let mut taken: BTreeMap<&[String], usize> = available.keys().map(|(group, _)| (&group[..], 0)).collect();
    let mut shares: BTreeMap<Category, usize> = available.keys().map(|category| (category.clone(), 0)).collect();
    for _ in 0..count {
        let free = available.iter().filter(|&(category, &most)| shares[category] < most);
        let next = free.map(|(category, _)| category).min_by_key(|category| {
            let (group, action) = *category;
            let preference = (Reverse(groups_with[action.index()]), *action);
            (taken[&group[..]], group, shares[*category], preference)
        });
        let Some(next) = next else { break };
        *shares.get_mut(next).expect("each category has a share") += 1;
        *taken.get_mut(&next.0[..]).expect("each group has a share") += 1;
    }
    shares
}

/// Splits `count` in the proportions of the paper's small set, in the order of [`Action::STANDARD`].
pub fn paper_shares(count: usize) -> [usize; 4] {
    proportional(count, PAPER_MIX)
}

/// Splits `count` in proportion to weights, by the method of largest remainders; of equal ones, the first.
fn proportional(count: usize, weights: [usize; 4]) -> [usize; 4] {
    let total: usize = weights.iter().sum();
    let mut shares = weights.map(|weight| count * weight / total);
    let mut order = [0, 1, 2, 3];
    order.sort_by_key(|&place| Reverse(count * weights[place] % total));
    let rest = count - shares.iter().sum::<usize>();
    order[..rest].iter().for_each(|&place| shares[place] += 1);
    shares
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::{Purpose, RngExt, Seed};

    /// How many questions the same answer to all gets right, and the best answer in each group.
    fn best_guesses(shares: &BTreeMap<Category, usize>) -> [usize; 2] {
        let mut groups: BTreeMap<&Vec<String>, usize> = BTreeMap::new();
        let mut answers = [0; 4];
        for ((group, action), &share) in shares {
            let best = groups.entry(group).or_default();
            *best = share.max(*best);
            answers[action.index()] += share;
        }
        [answers.into_iter().max().unwrap_or(0), groups.into_values().sum()]
    }

    #[test]
    fn shares_are_equal_within_and_among_groups() {
        let mut random = Seed(1).stream(Purpose::TEST, 0, 0);
        for _ in 0..500 {
            let groups: u32 = random.random_range(1..5);
            let mut available: BTreeMap<Category, usize> = BTreeMap::new();
            for group in 0..groups {
                for action in Action::STANDARD {
                    // Every group has Stop.
                    if action == Action::Stop || random.random_range(0..2) == 0 {
                        available.insert((vec![group.to_string()], action), usize::MAX);
                    }
                }
            }
            let count: usize = random.random_range(1..200);
            let found = shares(count, &available);
            assert_eq!(found.values().sum::<usize>(), count);
            let [same, by_group] = best_guesses(&found);
            assert_eq!(same, by_group, "{found:?}");
            let of = |group: u32| {
                let own = found.iter().filter(move |((name, _), _)| *name == [group.to_string()]);
                own.map(|(_, &share)| share)
            };
            let sizes = || (0..groups).map(|group| of(group).sum::<usize>());
            assert!(sizes().max().unwrap() - sizes().min().unwrap() <= 1, "{found:?}");
            for group in 0..groups {
                assert!(of(group).max().unwrap() - of(group).min().unwrap() <= 1, "{found:?}");
            }
            // With few questions, nothing is left while shares are short.
            let few: BTreeMap<Category, usize> = (available.keys())
                .map(|category| (category.clone(), random.random_range(0..30)))
                .collect();
            let found = shares(count, &few);
            assert!(found.iter().all(|(category, &share)| share <= few[category]));
            let all: usize = few.values().sum();
            assert_eq!(found.values().sum::<usize>(), count.min(all));
        }
    }

    #[test]
    fn proportional_shares_are_the_nearest_ones() {
        let mut random = Seed(2).stream(Purpose::TEST, 0, 0);
        for _ in 0..500 {
            let weights: [usize; 4] = std::array::from_fn(|_| random.random_range(1..60));
            let count: usize = random.random_range(1..300);
            let (found, total) = (proportional(count, weights), weights.iter().sum::<usize>());
            assert_eq!(found.iter().sum::<usize>(), count);
            for (share, weight) in found.into_iter().zip(weights) {
                let exact = count * weight;
                assert!((share * total).abs_diff(exact) < total, "{count} {weights:?} {found:?}");
            }
            assert_eq!(proportional(total, weights), weights);
        }
    }
}
