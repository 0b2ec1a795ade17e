//! Names that other engines accept.

use std::collections::HashSet;

/// Names of one kind, each once whatever its case.
#[derive(Default)]
pub(super) struct Names {
    taken: HashSet<String>,
}

impl Names {
    /// Names that differ from these words.
    pub(super) fn avoiding(words: &[&str]) -> Names {
        Names {
            taken: words.iter().map(|word| (*word).to_owned()).collect(),
        }
    }

    /// Returns a name like this one, of letters, digits and `_`, that no earlier call returned.
    pub(super) fn add(&mut self, name: &str, fallback: &str) -> String {
        let letters = name.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '_' });
        let mut clean: String = letters.collect();
        let starts = |first: char| first.is_ascii_alphabetic() || first == '_';
        if !clean.starts_with(starts) || clean == "_" {
            clean = fallback.to_owned();
        }
        let mut found = clean.clone();
        let mut number = 2;
        while !self.taken.insert(found.to_ascii_lowercase()) {
            found = format!("{clean}_{number}");
            number += 1;
        }
        found
    }
}
