//! Names in PDDL: letters, digits and hyphens, in lower case, since PDDL ignores case.

use std::collections::BTreeSet;

/// Words that mean something in PDDL, or are predicates of every encoding.
const TAKEN: [&str; 26] = [
    "and",
    "or",
    "not",
    "exists",
    "forall",
    "when",
    "imply",
    "object",
    "either",
    "number",
    "increase",
    "total-cost",
    "at",
    "now",
    "next",
    "ego",
    "observed",
    "violated",
    "moves",
    "draws",
    "end",
    "arrived",
    "chosen",
    "does",
    "moving",
    "permitted",
];

/// The names in use.
#[derive(Default)]
pub(super) struct Names(BTreeSet<String>);

impl Names {
    /// Returns a name like this one that is not in use, and notes it.
    pub fn unique(&mut self, like: &str) -> String {
        let kept = like.chars().map(|c| match c.is_ascii_alphanumeric() {
            true => c.to_ascii_lowercase(),
            false => '-',
        });
        let kept: String = kept.collect();
        let kept = kept.trim_matches('-');
        let base = match kept.starts_with(|c: char| c.is_ascii_alphabetic()) {
            true => kept.to_owned(),
            false => format!("x{kept}"),
        };
        let mut name = base.clone();
        for number in 2.. {
            if !TAKEN.contains(&name.as_str()) && self.0.insert(name.clone()) {
                break;
            }
            name = format!("{base}-{number}");
        }
        name
    }
}

#[cfg(test)]
mod tests {
    use super::Names;

    #[test]
    fn names_are_distinct_without_case_and_not_words_of_pddl() {
        let mut names = Names::default();
        let given = ["Sees", "sees", "At", "Car_1", "Überholt", "7", "_"];
        let unique: Vec<String> = given.iter().map(|name| names.unique(name)).collect();
        assert_eq!(unique, ["sees", "sees-2", "at-2", "car-1", "berholt", "x7", "x"]);
    }
}
