//! What a commit did: how each stratum was brought up to date, and the work of each clause.

use crate::datalog::check::ClauseId;

/// An event of [`Session::commit_watched`](crate::datalog::Session::commit_watched).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EvalEvent {
    /// A clause begins to be evaluated.
    Begin(ClauseId),
    /// It has been evaluated. There is always just one that has begun.
    End(ClauseId),
}

/// How a commit brings a stratum up to date whose inputs changed. The result is the same.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Strategy {
    /// Maintain or recompute, whatever looks cheaper. This is decided by numbers of rows: how many changed, and how many the last
    /// computation from scratch looked at. If maintaining looks at more rows than that, it is given up and the stratum is
    /// recomputed.
    #[default]
    Auto,
    /// Always maintain, whatever it costs. Some strata cannot be maintained (those with a clause of more than 24 literals); they
    /// are recomputed.
    Maintain,
    /// Always recompute.
    Recompute,
}

/// What a commit did with a stratum.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum StratumStats {
    /// Nothing: none of its inputs changed.
    Skipped,
    /// Followed the change of its inputs.
    Maintained(WorkCounts),
    /// Computed it from scratch: at the first commit, if the change is large, or if the stratum cannot be maintained.
    Recomputed(WorkCounts),
}

impl StratumStats {
    /// What was done, unless the stratum was skipped.
    pub fn work(&self) -> Option<&WorkCounts> {
        match self {
            StratumStats::Skipped => None,
            StratumStats::Maintained(work) | StratumStats::Recomputed(work) => Some(work),
        }
    }
}

/// What it took to bring a stratum up to date.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct WorkCounts {
    /// Rounds to a fixpoint; 1 if the stratum is not recursive.
    pub rounds: usize,
    /// What its clauses did, those that ran, in order.
    pub rules: Vec<RuleStats>,
    /// If maintaining the stratum was given up: after so many rows were looked at, as many as recomputing it would take; else 0.
    /// They are not in `rules`.
    pub given_up: u64,
}

impl WorkCounts {
    /// Rows that scans and tests of its clauses looked at.
    pub fn rows_scanned(&self) -> u64 {
        self.rules.iter().map(|rule| rule.rows_scanned).sum()
    }

    /// Rows that its clauses derived, repetitions included.
    pub fn derived(&self) -> u64 {
        self.rules.iter().map(|rule| rule.derived).sum()
    }
}

/// What one clause did in a commit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RuleStats {
    /// The clause.
    pub clause: ClauseId,
    /// Changed rows, and rows of its head in doubt, from which it was evaluated. 0 if it ran once over all rows.
    pub delta_rows: u64,
    /// Rows that its scans and tests looked at.
    pub rows_scanned: u64,
    /// Rows it derived, repetitions included: of those that may go, that stay nevertheless, and that come.
    pub derived: u64,
}

/// What a commit did.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct EvalStats {
    /// By position in [`Rules::strata`](crate::datalog::Rules::strata); empty before the first commit.
    pub strata: Vec<StratumStats>,
}

impl EvalStats {
    /// Positions in [`Rules::strata`](crate::datalog::Rules::strata) of the strata that were maintained or recomputed.
    pub fn evaluated(&self) -> impl Iterator<Item = usize> {
        let strata = self.strata.iter().enumerate();
        strata
            .filter(|(_, work)| **work != StratumStats::Skipped)
            .map(|(position, _)| position)
    }

    /// What each clause did that ran, in the order of the strata.
    pub fn rules(&self) -> impl Iterator<Item = &RuleStats> {
        self.strata
            .iter()
            .filter_map(StratumStats::work)
            .flat_map(|work| &work.rules)
    }
}
