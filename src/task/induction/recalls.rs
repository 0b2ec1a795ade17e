//! The accuracy of learned rules on examples.

use crate::induce::{Examples, LearnedRules};
use serde_json::{Value, json};

/// The examples in which learned rules choose the right action.
#[derive(Clone, Debug)]
pub struct Recalls {
    /// By action, the number of examples and of right choices.
    actions: Vec<[u64; 2]>,
}

impl Recalls {
    /// Counts the examples.
    pub fn new(examples: &Examples, learned: &LearnedRules) -> Recalls {
        let states: Vec<_> = examples.states().map(|(state, _)| state).collect();
        let chosen = learned.decide(examples.vocabulary(), &states);
        let mut actions = vec![[0; 2]; examples.actions().len()];
        for ((_, tallies), chosen) in examples.states().zip(chosen) {
            for (action, (tally, counts)) in tallies.iter().zip(&mut actions).enumerate() {
                counts[0] += u64::from(tally.count);
                counts[1] += if action == chosen { u64::from(tally.count) } else { 0 };
            }
        }
        Recalls { actions }
    }

    /// Returns the recalls of the actions that occur, with their positions.
    fn recalls(&self) -> impl Iterator<Item = (usize, f64)> {
        let occur = self.actions.iter().enumerate().filter(|(_, [count, _])| *count > 0);
        #[allow(clippy::cast_precision_loss)] // rates
        occur.map(|(action, [count, right])| (action, *right as f64 / *count as f64))
    }

    /// Returns the accuracy and the weighted accuracy of the paper (wAcc), in which the recall of an action with n
    /// examples has the weight 1/n.
    #[allow(clippy::cast_precision_loss)] // rates
    fn accuracies(&self) -> [f64; 2] {
        let sum = |at: usize| self.actions.iter().map(|counts| counts[at]).sum::<u64>() as f64;
        let weight = |action: usize| 1.0 / self.actions[action][0] as f64;
        let weights: f64 = self.recalls().map(|(action, _)| weight(action)).sum();
        let weighted: f64 = self.recalls().map(|(action, recall)| recall * weight(action)).sum();
        [sum(1) / sum(0), weighted / weights]
    }

    /// Returns one line of text. `names` are the actions.
    pub fn text(&self, names: &[&str]) -> String {
        let [accuracy, weighted] = self.accuracies();
        let count: u64 = self.actions.iter().map(|[count, _]| count).sum();
        let mut text = format!("test: {count} examples, accuracy {accuracy:.4}, wAcc {weighted:.4}; recall");
        for (index, (action, recall)) in self.recalls().enumerate() {
            let comma = if index > 0 { "," } else { "" };
            text += &format!("{comma} {} {recall:.4}", names[action]);
        }
        text + "\n"
    }

    /// Returns the accuracies and the recalls by action as JSON.
    pub fn json(&self, names: &[&str]) -> Value {
        let [accuracy, weighted] = self.accuracies();
        let recalls: serde_json::Map<String, Value> = self
            .recalls()
            .map(|(action, recall)| (names[action].to_owned(), recall.into()))
            .collect();
        json!({ "accuracy": accuracy, "weighted_accuracy": weighted, "recall": recalls })
    }
}
