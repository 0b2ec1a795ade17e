//! Which of several plans does least work, judged by the sizes of relations.
//!
//! The estimate takes words for evenly spread: of `n` rows whose column has words between `a` and `b`, a word finds
//! `n / (b - a + 1)`. It is a function of the rows alone, so the choice is the same in every run.

use crate::engine::plan::{IndexSpec, Plan, Source, Step};
use crate::engine::row::Row;
use crate::lang::Comparison;

/// How many rows there are and between which words each column lies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Shape<const W: usize> {
    rows: usize,
    least: [u32; W],
    most: [u32; W],
}

impl<const W: usize> Default for Shape<W> {
    fn default() -> Self {
        Shape {
            rows: 0,
            least: [u32::MAX; W],
            most: [0; W],
        }
    }
}

impl<const W: usize> Shape<W> {
    /// Rows that are looked at; so many say enough.
    const SAMPLE: usize = 64;

    /// Of these rows.
    pub(super) fn of(rows: &[Row<W>]) -> Self {
        let mut shape = Shape {
            rows: rows.len(),
            ..Self::default()
        };
        let step = rows.len().div_ceil(Self::SAMPLE).max(1);
        for row in rows.iter().step_by(step).chain(rows.last()) {
            for column in 0..W {
                shape.least[column] = shape.least[column].min(row.0[column].0);
                shape.most[column] = shape.most[column].max(row.0[column].0);
            }
        }
        shape
    }

    /// Of both.
    pub(super) fn with(mut self, other: Self) -> Self {
        self.rows += other.rows;
        for column in 0..W {
            self.least[column] = self.least[column].min(other.least[column]);
            self.most[column] = self.most[column].max(other.most[column]);
        }
        self
    }

    /// How many rows have given words in these columns.
    fn found(&self, columns: &[u16]) -> f64 {
        let spread =
            |&column: &u16| f64::from(self.most[column as usize].saturating_sub(self.least[column as usize])) + 1.0;
        self.rows as f64 / columns.iter().map(spread).product::<f64>()
    }
}

/// The first plan, unless one of the others does clearly less.
pub(super) fn choose<'a, const W: usize>(
    first: &'a Plan,
    others: &'a [Plan],
    indexes: &[IndexSpec],
    shape: &dyn Fn(Source) -> Shape<W>,
) -> &'a Plan {
    let mut best = (first, f64::INFINITY);
    if !others.is_empty() {
        best.1 = effort(first, indexes, shape) / 2.0;
    }
    for other in others {
        let effort = effort(other, indexes, shape);
        if effort < best.1 {
            best = (other, effort);
        }
    }
    best.0
}

/// About how many rows a plan looks at.
fn effort<const W: usize>(plan: &Plan, indexes: &[IndexSpec], shape: &dyn Fn(Source) -> Shape<W>) -> f64 {
    let found = |source: Source, key: usize| shape(source).found(&indexes[source.index.index()].columns[..key]);
    follow(&plan.steps, &found).1
}

/// About how many rows a plan looks at and derives, if so many rows of a source begin with a key of so many columns.
pub(super) fn expected(plan: &Plan, found: &dyn Fn(Source, usize) -> f64) -> (f64, f64) {
    let (heads, search) = plan.steps.split_at(plan.settled);
    let (heads, effort) = follow(heads, found);
    // For each head one success is enough.
    let (successes, search) = follow(search, found);
    (effort + heads * search / successes.max(1.0), heads * successes.min(1.0))
}

/// How many rows come to the end of the steps for one that comes to their beginning, and how many are looked at for it.
fn follow(steps: &[Step], found: &dyn Fn(Source, usize) -> f64) -> (f64, f64) {
    let (mut flow, mut effort) = (1.0, 0.0);
    for step in steps {
        effort += flow;
        match step {
            Step::Scan { source, key, .. } => {
                flow *= found(*source, key.len());
                effort += flow;
            }
            Step::Exists { source, key } => flow *= found(*source, key.len()).min(1.0),
            Step::Absent { source, key } => flow *= 1.0 - found(*source, key.len()).min(0.9),
            Step::Copy { .. } | Step::Compute { test: false, .. } => {}
            Step::Aggregate { source, key, .. } => effort += flow * found(*source, key.len()),
            Step::Compare {
                op: Comparison::Equal, ..
            }
            | Step::Compute { test: true, .. } => flow *= 0.1,
            Step::Compare { .. } => flow *= 0.5,
        }
    }
    (flow, effort)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lang::Value;

    #[test]
    fn shapes_add_up() {
        let rows: Vec<Row<2>> = (0..1000)
            .map(|word| Row([Value(word / 10), Value(5 + word % 10)]))
            .collect();
        let shape = Shape::of(&rows);
        assert_eq!((shape.rows, shape.least[0], shape.most[0]), (1000, 0, 99));
        assert_eq!(shape.found(&[0]), 10.0);
        let (front, back) = rows.split_at(300);
        let both = Shape::of(front).with(Shape::of(back)).with(Shape::default());
        assert_eq!((both.rows, both.least[0], both.most[0]), (1000, 0, 99));
        assert_eq!(Shape::<2>::of(&[]).found(&[0]), 0.0);
    }
}
