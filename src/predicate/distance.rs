//! `{distance: {above: 12, at_most: 20}}`: the Euclidean distance in cells is within the bounds.
//!
//! The fast form compares squared distances as integers. Bisection finds their bounds, so that it agrees exactly with
//! the definition.

use crate::city::{Cell, CityMap};
use crate::diag::Diagnostic;
#[cfg(test)]
use crate::predicate::Definition;
use crate::predicate::{PairKind, Phrase, PredicateKind, Reach, Relation, Sight, Subject, Syntax, Views};
use crate::yaml::codes;
use crate::yaml::read::{Fields, invalid, number};
use crate::yaml::{Value, YamlNode};
use serde::Serialize;
use std::sync::Arc;

/// The Euclidean distance d in cells is within the present bounds.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Distance {
    /// d > above.
    pub above: Option<f64>,
    /// d >= at_least.
    pub at_least: Option<f64>,
    /// d < below.
    pub below: Option<f64>,
    /// d <= at_most.
    pub at_most: Option<f64>,
}

/// An upper bound of the squared distance between two cells of a map.
const SQUARE_MAX: i64 = 1 << 50;

impl PredicateKind for Distance {
    const SYNTAX: Syntax = Syntax::Keys(&["distance"], |nodes, faults| Some(read(nodes[0], faults)?.into()));

    fn phrase(&self) -> Phrase {
        let bounds = [
            ("more than", self.above),
            ("at least", self.at_least),
            ("less than", self.below),
            ("at most", self.at_most),
        ];
        let bounds = bounds
            .iter()
            .filter_map(|(words, bound)| Some(format!("{words} {}", (*bound)?)));
        let bounds: Vec<String> = bounds.collect();
        match bounds.is_empty() {
            true => Phrase::new("is at some distance from"),
            false => Phrase::new(format!("is {} cells away from", bounds.join(" and "))),
        }
    }

    #[cfg(test)]
    fn samples() -> Vec<Definition> {
        let distance = |above, at_least, below, at_most| Distance {
            above,
            at_least,
            below,
            at_most,
        };
        vec![
            distance(Some(3.0), None, None, Some(8.0)).into(),
            distance(None, Some(2.5), Some(6.0), None).into(),
            distance(None, None, None, Some(5.0)).into(),
            distance(Some(4.0), None, None, None).into(),
        ]
    }
}

fn read(node: &YamlNode, faults: &mut Vec<Diagnostic>) -> Option<Distance> {
    let before = faults.len();
    let Some(mut fields) = Fields::open(node, "a distance", faults) else {
        let number = match &node.value {
            Value::Scalar { text, plain: true } if text.parse::<f64>().is_ok() => text.as_str(),
            _ => "12",
        };
        for fault in &mut faults[before..] {
            let help = format!("a distance is written `{{at_most: {number}}}`, or with `above`, `at_least` or `below`");
            fault.help.push(help);
        }
        return None;
    };
    let mut bound = |key| match fields.optional(key) {
        Some(node) => number(node, 0.0..=1e9, "a distance from 0 to 1e9 cells", faults).map(Some),
        None => Some(None),
    };
    let [above, at_least, below, at_most] = ["above", "at_least", "below", "at_most"].map(&mut bound);
    fields.close(faults);
    let (above, at_least, below, at_most) = (above?, at_least?, below?, at_most?);
    if above.is_some() && at_least.is_some() || below.is_some() && at_most.is_some() {
        invalid(
            node,
            "at most one lower bound (`above`, `at_least`) and one upper bound (`below`, `at_most`)",
            faults,
        );
        return None;
    }
    let empty = match (above.or(at_least), below.or(at_most)) {
        (None, None) if node.partial => return None,
        (None, None) => {
            let message = "expected at least one of `above`, `at_least`, `below`, `at_most`, found none";
            faults.push(Diagnostic::new(codes::INVALID_VALUE, message).at(node.span, ""));
            return None;
        }
        (low, high) => {
            let closed = above.is_none() && below.is_none();
            let (low, high) = (low.unwrap_or(0.0), high.unwrap_or(f64::INFINITY));
            low > high || low == high && !closed
        }
    };
    if empty {
        let fault = Diagnostic::new(codes::INVALID_VALUE, "no distance lies within these bounds");
        faults.push(fault.at(node.span, ""));
        return None;
    }
    Some(Distance {
        above,
        at_least,
        below,
        at_most,
    })
}

impl Distance {
    fn is_far_enough(&self, d: f64) -> bool {
        self.above.is_none_or(|bound| d > bound) && self.at_least.is_none_or(|bound| d >= bound)
    }

    fn is_near_enough(&self, d: f64) -> bool {
        self.below.is_none_or(|bound| d < bound) && self.at_most.is_none_or(|bound| d <= bound)
    }
}

impl PairKind for Distance {
    type Relation = Squares;

    const READS: [bool; 2] = [false, false];

    fn holds(&self, _: Sight<'_>, x: &Subject, y: &Subject, _: impl FnOnce(f64) -> bool) -> bool {
        let d = x.at.distance(y.at);
        self.is_far_enough(d) && self.is_near_enough(d)
    }

    fn relation(&self, _: &Arc<CityMap>) -> Squares {
        // Both bounds are monotone in the distance, and the distance in its square.
        let least = first_square(|d| self.is_far_enough(d));
        let most = first_square(|d| !self.is_near_enough(d)) - 1;
        let reach = most.max(0).isqrt().min(i64::from(Reach::FARTHEST));
        Squares {
            least,
            most,
            reach: i32::try_from(reach).expect("it is at most the farthest"),
        }
    }

    fn horizon(&self, _: u32) -> f64 {
        let bounds = [self.above, self.at_least, self.below, self.at_most];
        bounds.into_iter().flatten().fold(0.0, f64::max)
    }
}

/// Squared distances from `least` to `most`, at most `reach` cells apart in rows and columns.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Squares {
    least: i64,
    most: i64,
    reach: i32,
}

impl Relation for Squares {
    #[inline]
    fn reach_back(&self) -> Reach {
        Reach::Within([self.reach; 4])
    }

    #[inline]
    fn test(&self, x: &Subject, y: &Subject, _: impl FnOnce(f64) -> bool) -> bool {
        (self.least..=self.most).contains(&square(x.at, y.at))
    }

    /// Tests each unordered pair once, because the relation is symmetric.
    #[inline]
    fn relate(
        &self,
        _: &Views,
        subjects: impl Iterator<Item = Subject> + Clone,
        draw: impl Fn(usize, usize, f64) -> bool,
        rows: &mut [u64],
    ) {
        for (first, x) in subjects.clone().enumerate() {
            for (second, y) in subjects.clone().take(first).enumerate() {
                let holds = u64::from(self.test(&x, &y, |probability| draw(first, second, probability)));
                rows[first] |= holds << second;
                rows[second] |= holds << first;
            }
        }
    }
}

/// Returns the squared distance of two cells.
#[inline]
fn square(from: Cell, to: Cell) -> i64 {
    let (rows, cols) = to.offset_from(from);
    rows * rows + cols * cols
}

/// Returns the least squared distance for which a monotone condition holds; [`SQUARE_MAX`] if there is none.
#[allow(clippy::cast_precision_loss)] // exact: squares are below 2^53
fn first_square(holds: impl Fn(f64) -> bool) -> i64 {
    let (mut low, mut high) = (0, SQUARE_MAX);
    while low < high {
        let middle = low + (high - low) / 2;
        match holds((middle as f64).sqrt()) {
            true => high = middle,
            false => low = middle + 1,
        }
    }
    low
}
