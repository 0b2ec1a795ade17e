//! What an example can refer to: the constants that the background knowledge links to its arguments.

use crate::diag::codes;
use crate::diag::{Diagnostic, Span};
use crate::induce::{ENTITIES_MAX, Link, State, Vocabulary};
use std::collections::{BTreeMap, BTreeSet};

/// The facts of the body predicates, indexed by their constants.
pub struct Network<'a> {
    vocabulary: &'a Vocabulary,
    links: &'a [Link],
    /// For each body predicate, its rows.
    rows: &'a [Vec<Vec<u32>>],
    /// For each constant, the predicate and the row of each fact about it.
    about: Vec<Vec<(u32, u32)>>,
    /// The facts that bind their variables from nothing.
    sources: Vec<(u32, u32)>,
    /// For each constant, whether only the head can refer to it.
    is_fixed: Vec<bool>,
}

impl<'a> Network<'a> {
    /// Indexes facts. `rows` are those of the predicates of the vocabulary, in its order. `is_fixed` says for each
    /// constant whether only the head of a clause can refer to it.
    pub fn new(
        vocabulary: &'a Vocabulary,
        links: &'a [Link],
        rows: &'a [Vec<Vec<u32>>],
        is_fixed: Vec<bool>,
    ) -> Network<'a> {
        let mut about = vec![Vec::new(); is_fixed.len()];
        let mut sources = Vec::new();
        for (predicate, (rows, link)) in rows.iter().zip(links).enumerate() {
            for (index, row) in rows.iter().enumerate() {
                let fact = (predicate as u32, index as u32);
                let distinct: BTreeSet<u32> = row.iter().copied().collect();
                distinct
                    .iter()
                    .for_each(|&constant| about[constant as usize].push(fact));
                if *link == Link::Inputs(0) {
                    sources.push(fact);
                }
            }
        }
        Network {
            vocabulary,
            links,
            rows,
            about,
            sources,
            is_fixed,
        }
    }

    /// Returns the state of an example and its constants, those of the head first. A constant belongs to it if a clause
    /// with `variables` variables can refer to it.
    ///
    /// # Errors
    /// If there are more than [`ENTITIES_MAX`] constants.
    pub fn state(&self, head: &[u32], variables: usize, span: Span) -> Result<(State, Vec<u32>), Diagnostic> {
        let mut entities = head.to_vec();
        let mut reached: BTreeSet<u32> = head.iter().copied().collect();
        // A predicate without inputs binds new variables at any step.
        let mut newest: Vec<u32> = head.to_vec();
        for step in 0..variables.saturating_sub(head.len()) {
            let generated = self.sources.iter().filter(|_| step == 0).copied();
            let facts: BTreeSet<(u32, u32)> = (newest.iter())
                .flat_map(|&constant| self.about[constant as usize].iter().copied())
                .chain(generated)
                .collect();
            let mut found = BTreeSet::new();
            for (predicate, index) in facts {
                let row = &self.rows[predicate as usize][index as usize];
                if (row.iter()).any(|constant| self.is_fixed[*constant as usize] && !reached.contains(constant)) {
                    continue;
                }
                let is_bound = match self.links[predicate as usize] {
                    Link::Any => row.iter().any(|constant| reached.contains(constant)),
                    Link::Inputs(inputs) => (row.iter().enumerate())
                        .all(|(at, constant)| inputs >> at & 1 == 0 || reached.contains(constant)),
                };
                if is_bound {
                    found.extend(row.iter().copied().filter(|constant| !reached.contains(constant)));
                }
            }
            reached.extend(&found);
            entities.extend(&found);
            newest = found.into_iter().collect();
        }
        if entities.len() > ENTITIES_MAX {
            let message = format!(
                "the background knowledge links {} constants to this example, more than {ENTITIES_MAX}",
                entities.len()
            );
            let fault = Diagnostic::new(codes::LIMIT_EXCEEDED, message).at(span, "");
            return Err(fault.help("declare `direction` for the body predicates, or reduce `max_vars`"));
        }
        Ok((self.facts(&entities), entities))
    }

    /// Returns the state with all facts among some constants. A constant may occur several times.
    fn facts(&self, entities: &[u32]) -> State {
        let mut places: BTreeMap<u32, Vec<usize>> = BTreeMap::new();
        for (place, &constant) in entities.iter().enumerate() {
            places.entry(constant).or_default().push(place);
        }
        let mut state = State::new(self.vocabulary, entities.len());
        let facts: BTreeSet<(u32, u32)> = (places.keys())
            .flat_map(|&constant| self.about[constant as usize].iter().copied())
            .collect();
        for (predicate, index) in facts {
            let row = &self.rows[predicate as usize][index as usize];
            let Some(choices) = row
                .iter()
                .map(|constant| places.get(constant))
                .collect::<Option<Vec<_>>>()
            else {
                continue;
            };
            let total: usize = choices.iter().map(|choice| choice.len()).product();
            for number in 0..total {
                let mut rest = number;
                let arguments: Vec<usize> = (choices.iter())
                    .map(|choice| {
                        let place = choice[rest % choice.len()];
                        rest /= choice.len();
                        place
                    })
                    .collect();
                state.insert(self.vocabulary, predicate as usize, &arguments);
            }
        }
        state
    }
}
