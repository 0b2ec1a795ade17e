//! Statistics of a commit: the strategy for each stratum and the work of each clause.
// Decision: docs/decisions/evaluation.md#d023

use crate::check::ClauseId;

/// An event of [`Session::commit_watched`](crate::Session::commit_watched).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EvalEvent {
    /// The evaluation of a clause begins.
    Begin(ClauseId),
    /// The evaluation of the clause ends. Evaluations do not nest.
    End(ClauseId),
}

/// The way in which a commit updates a stratum whose inputs changed. The result is the same for all.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Strategy {
    /// Chooses the strategy with the lower estimated cost. The estimates depend on the number of changed rows and on
    /// the rows that the last computation from scratch scanned. If maintenance scans more rows than the estimate for
    /// recomputation, the session abandons it and recomputes the stratum.
    #[default]
    Auto,
    /// Always maintains. Strata with an aggregate or with a clause of more than 24 literals cannot be maintained; they
    /// are recomputed.
    Maintain,
    /// Always recomputes.
    Recompute,
}

/// The strategy that a commit used for a stratum, with its work.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum StratumStats {
    /// Skipped, since none of its inputs changed.
    Skipped,
    /// Updated incrementally from the changes of its inputs.
    Maintained(WorkCounts),
    /// Computed from scratch: at the first commit, if the change is large, or if the stratum cannot be maintained.
    Recomputed(WorkCounts),
}

impl StratumStats {
    /// Returns the work, or `None` if the stratum was skipped.
    pub fn work(&self) -> Option<&WorkCounts> {
        match self {
            StratumStats::Skipped => None,
            StratumStats::Maintained(work) | StratumStats::Recomputed(work) => Some(work),
        }
    }
}

/// The work of updating a stratum.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct WorkCounts {
    /// Rounds to the fixpoint; 1 if the stratum is not recursive.
    pub rounds: usize,
    /// The work of the clauses that ran, by id.
    pub rules: Vec<RuleStats>,
    /// The scan budget of abandoned maintenance, in rows, or 0. The budget is the estimated cost of recomputing the
    /// stratum. `rules` does not include this work.
    pub given_up: u64,
}

impl WorkCounts {
    /// Returns the rows that scans and tests of its clauses visited.
    pub fn rows_scanned(&self) -> u64 {
        self.rules.iter().map(|rule| rule.rows_scanned).sum()
    }

    /// Returns the rows that its clauses derived, repetitions included.
    pub fn derived(&self) -> u64 {
        self.rules.iter().map(|rule| rule.derived).sum()
    }
}

/// The work of one clause in a commit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct RuleStats {
    /// The clause.
    pub clause: ClauseId,
    /// The number of changed rows and doubtful heads that its evaluation began with. 0 if it ran once over all rows.
    pub delta_rows: u64,
    /// Rows that its scans and tests visited.
    pub rows_scanned: u64,
    /// Rows it derived, repetitions included. Under maintenance these include heads that may be lost, heads kept, and
    /// heads gained.
    pub derived: u64,
}

/// The statistics of a commit.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct EvalStats {
    /// Indexed by position in [`Rules::strata`](crate::Rules::strata); empty before the first commit.
    pub strata: Vec<StratumStats>,
}

impl EvalStats {
    /// Returns the positions in [`Rules::strata`](crate::Rules::strata) of the strata that were maintained or
    /// recomputed.
    pub fn evaluated(&self) -> impl Iterator<Item = usize> {
        let strata = self.strata.iter().enumerate();
        strata
            .filter(|(_, work)| **work != StratumStats::Skipped)
            .map(|(position, _)| position)
    }

    /// Returns the work of each clause that ran, in the order of the strata.
    pub fn rules(&self) -> impl Iterator<Item = &RuleStats> {
        self.strata
            .iter()
            .filter_map(StratumStats::work)
            .flat_map(|work| &work.rules)
    }
}
