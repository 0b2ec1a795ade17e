//! The cost model: estimates the work of plans from the sizes of predicates. Estimates depend on the rows alone, so
//! every run makes the same choices.
//!
//! [`Size`] measures the predicates that a clause is planned for, and [`Flow`] follows a plan while the planner builds
//! it. The choice between alternative plans in each round of a recursion uses a [`Shape`], which is cheaper to take. It
//! assumes evenly distributed words: if the words of a column lie between `a` and `b`, a word matches `n / (b - a + 1)`
//! of `n` rows.

use crate::check::VarId;
use crate::plan::steps::{Indexes, Plan, Source, Step};
use crate::row::{Row, gallop};
use crate::syntax::ast::Comparison;

/// The number of rows and the range of words in each column.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Shape<const W: usize> {
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
    /// The maximum number of rows sampled.
    const SAMPLE: usize = 64;

    /// The shape of these rows, which may be narrower.
    pub(crate) fn of<const V: usize>(rows: &[Row<V>]) -> Self {
        let mut shape = Shape {
            rows: rows.len(),
            ..Self::default()
        };
        let step = rows.len().div_ceil(Self::SAMPLE).max(1);
        for row in rows.iter().step_by(step).chain(rows.last()) {
            for column in 0..V.min(W) {
                shape.least[column] = shape.least[column].min(row.0[column].0);
                shape.most[column] = shape.most[column].max(row.0[column].0);
            }
        }
        shape
    }

    /// The shape of both sets of rows together.
    pub(crate) fn with(mut self, other: Self) -> Self {
        self.rows += other.rows;
        for column in 0..W {
            self.least[column] = self.least[column].min(other.least[column]);
            self.most[column] = self.most[column].max(other.most[column]);
        }
        self
    }

    /// The estimated number of rows that match one word in each of these columns.
    pub(crate) fn found(&self, columns: &[u16]) -> f64 {
        let spread =
            |&column: &u16| f64::from(self.most[column as usize].saturating_sub(self.least[column as usize])) + 1.0;
        self.rows as f64 / columns.iter().map(spread).product::<f64>()
    }
}

/// Returns the first plan, unless an alternative costs less than half as much.
pub(crate) fn choose<'a, const W: usize>(
    first: &'a Plan,
    others: &'a [Plan],
    indexes: &Indexes,
    shape: &dyn Fn(Source) -> Shape<W>,
) -> &'a Plan {
    let mut best = (first, f64::INFINITY);
    if !others.is_empty() {
        best.1 = cost(first, indexes, shape) / 2.0;
    }
    for other in others {
        let cost = cost(other, indexes, shape);
        if cost < best.1 {
            best = (other, cost);
        }
    }
    best.0
}

/// The estimated number of rows that a plan scans.
fn cost<const W: usize>(plan: &Plan, indexes: &Indexes, shape: &dyn Fn(Source) -> Shape<W>) -> f64 {
    let found = |source: Source, key: usize| shape(source).found(&indexes[source.index].columns[..key]);
    follow(&plan.steps, &found).1
}

/// Returns two estimates for one row that enters the steps: the rows that leave them, and the rows scanned.
fn follow(steps: &[Step], found: &dyn Fn(Source, usize) -> f64) -> (f64, f64) {
    let (mut flow, mut cost) = (1.0, 0.0);
    for step in steps {
        cost += flow;
        match step {
            Step::Scan { source, key, .. } => {
                flow *= found(*source, key.len());
                cost += flow;
            }
            Step::LeapfrogJoin { lists, .. } => {
                let found = lists.iter().map(|list| found(list.source, list.key.len()));
                let least = found.fold(f64::INFINITY, f64::min);
                cost += flow * least * lists.len() as f64;
                flow *= least;
            }
            Step::Group { .. } => cost += flow,
            Step::Exists { source, key } => flow *= found(*source, key.len()).min(1.0),
            Step::AntiJoin { source, key } => flow *= 1.0 - found(*source, key.len()).min(0.9),
            Step::Correlated { plans, .. } => {
                let inner = plans.iter().map(|plan| follow(&plan.steps[1..], found).1);
                cost += flow * inner.sum::<f64>();
            }
            Step::Copy { .. } | Step::Compute { test: false, .. } => {}
            Step::Aggregate { source, key, .. } => cost += flow * found(*source, key.len()),
            Step::Compare {
                op: Comparison::Equal, ..
            }
            | Step::Compute { test: true, .. } => flow *= Flow::EQUAL,
            Step::Compare { .. } => flow *= Flow::COMPARED,
        }
    }
    (flow, cost)
}

/// The number of rows of a predicate and the distribution of words in its columns, measured on a sample.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Size {
    pub(crate) rows: usize,
    /// Indexed by column.
    columns: Vec<Spread>,
}

/// The distribution of the words in a column.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Spread {
    /// The estimated number of distinct words.
    distinct: f64,
    /// The estimated number of rows that share a word with a row, averaged over rows. It exceeds `rows / distinct` if
    /// the distribution is skewed.
    often: f64,
}

impl Size {
    /// The maximum number of rows sampled.
    const SAMPLE: usize = 128;

    /// Measures sorted rows with `arity` columns.
    pub(crate) fn of<const W: usize>(rows: &[Row<W>], arity: usize) -> Self {
        let count = rows.len().min(Self::SAMPLE);
        // Take one row from each of `count` equal parts at a scattered offset: words may be periodic.
        let at = |number: usize| {
            let (from, to) = (number * rows.len() / count, (number + 1) * rows.len() / count);
            from + (number.wrapping_mul(0x9E37_79B9) >> 7) % (to - from)
        };
        let spread = |column: usize| match column {
            _ if rows.is_empty() => Spread {
                distinct: 0.0,
                often: 0.0,
            },
            0 => {
                let group = |number: usize| same_first(rows, at(number)) as f64;
                let inverse: f64 = (0..count).map(|number| 1.0 / group(number)).sum();
                Spread {
                    distinct: (inverse / count as f64 * rows.len() as f64).max(1.0),
                    often: (0..count).map(group).sum::<f64>() / count as f64,
                }
            }
            _ => {
                let mut words: Vec<u32> = (0..count).map(|number| rows[at(number)].0[column].0).collect();
                Self::spread(&mut words, rows.len() as f64)
            }
        };
        Size {
            rows: rows.len(),
            columns: (0..arity).map(spread).collect(),
        }
    }

    /// Estimates the distribution of words in `rows` rows from a sample.
    fn spread(words: &mut [u32], rows: f64) -> Spread {
        words.sort_unstable();
        let count = words.len() as f64;
        let (mut different, mut single, mut pairs) = (0.0, 0.0, 0.0);
        for group in words.chunk_by(|a, b| a == b) {
            let length = group.len() as f64;
            different += 1.0;
            single += f64::from(u8::from(group.len() == 1));
            pairs += length * (length - 1.0);
        }
        if count == rows {
            let often = pairs / count + 1.0;
            return Spread {
                distinct: different,
                often,
            };
        }
        // Words seen once represent unseen ones: the guaranteed-error estimator of Charikar et al. (2000). For evenly
        // distributed words, the frequency of equal pairs in the sample gives the number of distinct words.
        let agree = pairs / (count * (count - 1.0));
        let by_single = (rows / count).sqrt() * single + (different - single);
        let by_pairs = if agree > 0.0 { 1.0 / agree } else { rows };
        let distinct = by_single.max(by_pairs).min(rows);
        Spread {
            distinct,
            often: (rows * agree).max(rows / distinct),
        }
    }
}

/// The number of rows that begin with the same word as the row at a position.
fn same_first<const W: usize>(rows: &[Row<W>], at: usize) -> usize {
    let word = rows[at].0[0];
    let before = rows[..at].partition_point(|row| row.0[0] < word);
    at - before + gallop(&rows[at..], |row| row.0[0] == word)
}

/// A bound column and its variable, or `None` for a constant.
pub(crate) type Known = (u16, Option<VarId>);
type Key = [Known];

/// The estimate after a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Reckoning {
    /// Rows that reach the next step.
    rows: f64,
    /// Rows scanned by the steps so far.
    cost: f64,
}

/// The estimated number of rows that a plan scans if each existential group stops at its first success; see
/// [`Plan::enough`].
pub(crate) fn cost_of_parts(trail: &[Reckoning], enough: &[u16]) -> f64 {
    let (mut rows, mut cost, mut at) = (1.0, 0.0, 0);
    let mut before = Reckoning { rows: 1.0, cost: 0.0 };
    while at < trail.len() && before.rows > 0.0 {
        let end = (enough[at] as usize).max(at + 1);
        let after = trail[end - 1];
        let successes = after.rows / before.rows;
        let tries = if enough[at] > 0 { successes.max(1.0) } else { 1.0 };
        cost += rows * (after.cost - before.cost) / before.rows / tries;
        rows *= successes / tries;
        (before, at) = (after, end);
    }
    cost
}

/// The running estimate of a plan while the planner builds it.
#[derive(Clone, Debug)]
pub(crate) struct Flow {
    /// Rows that reach the next step.
    rows: f64,
    /// Rows scanned by the steps so far.
    cost: f64,
    /// Indexed by variable: the estimated number of distinct words; 0 if unknown.
    words: Vec<f64>,
}

impl Flow {
    /// Guessed selectivities: the fraction of rows that pass an equality, and another comparison.
    pub(crate) const EQUAL: f64 = 0.1;
    pub(crate) const COMPARED: f64 = 0.5;

    /// The estimate of an empty plan.
    pub(crate) fn new(variables: usize) -> Self {
        Flow {
            rows: 1.0,
            cost: 0.0,
            words: vec![0.0; variables],
        }
    }

    /// The estimate for the steps so far.
    pub(crate) fn reckoning(&self) -> Reckoning {
        Reckoning {
            rows: self.rows,
            cost: self.cost,
        }
    }

    /// The estimated number of rows that match the key. A variable with more distinct words than the column has misses
    /// for some of them.
    pub(crate) fn found(&self, size: &Size, key: &Key) -> f64 {
        let (mut combinations, mut misses) = (1.0, 1.0);
        for &(column, variable) in key {
            let distinct = size.columns[column as usize].distinct.max(1.0);
            let words = variable.map_or(0.0, |variable| self.words[variable.index()]);
            combinations *= distinct;
            misses *= (words / distinct).max(1.0);
        }
        let rows = size.rows as f64;
        rows / combinations.clamp(1.0, rows.max(1.0)) / misses
    }

    /// Like `found`, but assumes that the keys follow the same skewed distribution as the rows.
    pub(crate) fn found_often(&self, size: &Size, key: &Key) -> f64 {
        let rows = size.rows.max(1) as f64;
        let share = |&(column, _): &(u16, _)| size.columns[column as usize].often / rows;
        (rows * key.iter().map(share).product::<f64>()).max(self.found(size, key))
    }

    /// Accounts for a scan of the rows that match the key and bind variables.
    pub(crate) fn scan(&mut self, size: &Size, key: &Key, bind: &[(u16, u16)]) {
        self.cost += self.rows;
        self.rows *= self.found(size, key);
        self.cost += self.rows;
        self.narrow(size, key);
        for &(column, slot) in bind {
            self.words[slot as usize] = size.columns[column as usize].distinct.min(self.rows.max(1.0));
        }
    }

    /// Accounts for a scan that runs once: without an index for its key it visits all rows.
    pub(crate) fn passes(&mut self, size: &Size) {
        self.cost += size.rows as f64;
    }

    /// Accounts for a test that some row matches the key.
    pub(crate) fn exists(&mut self, size: &Size, key: &Key) {
        self.cost += self.rows;
        self.rows *= self.found(size, key).min(1.0);
        self.narrow(size, key);
    }

    /// Accounts for a test that no row matches the key.
    pub(crate) fn absent(&mut self, size: &Size, key: &Key) {
        self.cost += self.rows;
        self.rows *= 1.0 - self.found(size, key).min(0.9);
    }

    /// Accounts for a leapfrog join of these lists that binds the variable.
    pub(crate) fn leapfrog_join(&mut self, lists: &[(&Size, Vec<Known>)], variable: VarId) {
        let found = lists.iter().map(|(size, key)| self.found(size, key));
        let least = found.fold(f64::INFINITY, f64::min);
        self.cost += self.rows * lists.len() as f64 * (1.0 + least);
        self.rows *= least;
        lists.iter().for_each(|(size, key)| self.narrow(size, key));
        self.words[variable.index()] = self.rows.max(1.0);
    }

    /// Accounts for a comparison that passes a fraction of the rows.
    pub(crate) fn filter(&mut self, share: f64) {
        self.cost += self.rows;
        self.rows *= share;
    }

    /// Limits the distinct words of the key's variables to those of its columns.
    fn narrow(&mut self, size: &Size, key: &Key) {
        for &(column, variable) in key {
            if let Some(variable) = variable {
                let words = &mut self.words[variable.index()];
                let distinct = size.columns[column as usize].distinct;
                *words = if *words > 0.0 { words.min(distinct) } else { distinct };
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::value::Value;

    #[test]
    fn sizes_measure_unique_repeated_and_skewed_columns() {
        let near = |value: f64, expected: f64, factor: f64| {
            assert!(
                (expected / factor..=expected * factor).contains(&value),
                "{value}, not {expected}"
            );
        };
        let size = |words: &dyn Fn(u32) -> [u32; 3]| {
            let mut rows: Vec<Row<3>> = (0..10_000).map(|row| Row(words(row).map(Value))).collect();
            rows.sort_unstable();
            Size::of(&rows, 3)
        };
        // A key, eight scattered words, and the constant 7.
        let scattered = size(&|row| [row, row.wrapping_mul(2_654_435_761) >> 16 & 7, 7]);
        for (spread, (distinct, often)) in scattered.columns.iter().zip([(1e4, 1.0), (8.0, 1_250.0), (1.0, 1e4)]) {
            near(spread.distinct, distinct, 1.3);
            near(spread.often, often, 1.3);
        }
        // Half of the rows share a word; the others have distinct words.
        let skewed = size(&|row| [row / 2 * (row % 2), 3 * (row.wrapping_mul(2_654_435_761) >> 16), row]);
        near(skewed.columns[0].distinct, 5_000.0, 1.3);
        near(skewed.columns[0].often, 2_500.0, 1.3);
        near(skewed.columns[1].distinct, 1e4, 2.5);
        // Few rows are counted exactly.
        let few: Vec<Row<2>> = (0..60).map(|row| Row([Value(row / 20), Value(row % 20)])).collect();
        let few = Size::of(&few, 2);
        let spreads = few.columns.iter().map(|spread| (spread.distinct.round(), spread.often));
        assert!(spreads.eq([(3.0, 20.0), (20.0, 3.0)]));
        assert_eq!(Size::of::<2>(&[], 2).columns[1].distinct, 0.0);
    }

    #[test]
    fn a_flow_follows_the_words_of_variables() {
        let rows: Vec<Row<2>> = (0..100).map(|row| Row([Value(row), Value(row % 20)])).collect();
        let size = Size::of(&rows, 2);
        let (x, y) = (VarId(0), VarId(1));
        let mut flow = Flow::new(2);
        flow.scan(&size, &[], &[(0, 0), (1, 1)]);
        assert_eq!((flow.rows, flow.cost), (100.0, 101.0));
        // Of the 100 words of `x`, 20 occur in the second column, five times each.
        assert_eq!(flow.found(&size, &[(1, Some(x))]).round(), 1.0);
        assert_eq!(flow.found(&size, &[(1, Some(y))]).round(), 5.0);
        assert_eq!(flow.found(&size, &[(1, None)]).round(), 5.0);
        flow.exists(&size, &[(1, Some(x))]);
        assert_eq!((flow.rows.round(), flow.words[0].round()), (100.0, 20.0));
        flow.filter(Flow::EQUAL);
        assert_eq!(flow.rows.round(), 10.0);
    }

    #[test]
    fn parts_end_at_their_first_success() {
        let trail = [(100.0, 100.0), (1_000.0, 1_100.0), (500.0, 2_100.0), (500.0, 2_600.0)];
        let trail = trail.map(|(rows, cost)| Reckoning { rows, cost });
        assert_eq!(cost_of_parts(&trail, &[0, 0, 0, 0]), 2_600.0);
        // The second and third step together find five rows for each row.
        assert_eq!(cost_of_parts(&trail, &[0, 3, 0, 0]), 100.0 + 2_000.0 / 5.0 + 100.0);
        assert_eq!(cost_of_parts(&trail, &[0, 0, 4, 0]), 2_600.0);
    }

    #[test]
    fn shapes_add_up() {
        let rows: Vec<Row<2>> = (0..1000)
            .map(|word| Row([Value(word / 10), Value(5 + word % 10)]))
            .collect();
        let shape = Shape::<2>::of(&rows);
        assert_eq!((shape.rows, shape.least[0], shape.most[0]), (1000, 0, 99));
        assert_eq!(shape.found(&[0]), 10.0);
        let (front, back) = rows.split_at(300);
        let both = Shape::<2>::of(front).with(Shape::of(back)).with(Shape::default());
        assert_eq!((both.rows, both.least[0], both.most[0]), (1000, 0, 99));
        assert_eq!(Shape::<2>::of::<2>(&[]).found(&[0]), 0.0);
    }
}
