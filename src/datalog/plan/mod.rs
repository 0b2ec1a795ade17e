//! Query plans: the join order of each clause's literals and the indexes that the joins use.
//!
//! `steps` defines a plan, `planner` orders the literals, and `estimate` compares orders by the sizes of predicates.
//! With the feature `optimizer`, `optimize` simplifies clauses before they are planned.

pub(crate) mod estimate;
mod grouping;
#[cfg(feature = "optimizer")]
pub mod optimize;
mod planner;
pub(crate) mod steps;

use std::collections::BTreeMap;
use std::sync::Arc;

use crate::check::{Clause, ClauseId, Literal, PredicateId, Rules, Stratum};
use crate::diag::Diagnostic;
use crate::diag::codes;
use crate::row::WIDTHS;
use estimate::Size;
use grouping::groupings;
use planner::{
    CLAUSE_MAX, Order, is_maintainable, plan_changes, plan_clause, plan_complete, plan_correlated, too_large,
};
use steps::{Aim, ClausePlans, Grouping, Indexes, Plan, Step, StratumPlan};

/// A program with its plans.
#[derive(Clone, Debug)]
pub(crate) struct Compiled {
    pub(crate) rules: Rules,
    /// The initial plans, made before any predicate has rows.
    pub(crate) plans: Arc<Plans>,
}

/// The plans of all clauses, the indexes they need, and the layout of the strata.
#[derive(Clone, Debug)]
pub(crate) struct Plans {
    /// The clauses as planned. The optimizer may have simplified them. Facts of predicates that no clause with a body
    /// derives are rows from the start, and have no plans.
    sources: Arc<BTreeMap<ClauseId, Clause>>,
    /// By [`ClauseId`]. All facts without plans share one entry, which is never evaluated.
    pub(crate) clauses: Vec<Arc<ClausePlans>>,
    /// The correlated predicates.
    correlated: Arc<BTreeMap<PredicateId, Correlated>>,
    pub(crate) indexes: Indexes,
    /// By [`PredicateId`]: how a hidden predicate is aggregated instead of stored; see [`grouping`].
    pub(crate) groupings: Vec<Option<Grouping>>,
    /// Indexed by position in [`Rules::strata`].
    pub(crate) strata: Vec<StratumPlan>,
    /// By [`PredicateId`]: the position of a derived predicate among the members of its stratum.
    pub(crate) member: Vec<Option<usize>>,
    /// The number of words in a stored row, one of [`WIDTHS`].
    pub(crate) width: usize,
}

/// A correlated predicate: the body of an aggregate that is evaluated in place.
#[derive(Clone, Debug)]
struct Correlated {
    clauses: Vec<ClauseId>,
    /// The number of its parameters.
    parameters: usize,
    /// The number of literals in its clauses and in those of the correlated predicates that they need.
    literals: usize,
}

impl Plans {
    /// Plans all clauses. Fails if a clause or a predicate exceeds a size limit. Fails for an unsafe clause too, but the
    /// checker rejects those first.
    pub(crate) fn new(rules: &Rules) -> Result<Plans, Diagnostic> {
        let width_max = WIDTHS[WIDTHS.len() - 1];
        if let Some(wide) = rules.predicates.iter().find(|predicate| predicate.arity() > width_max) {
            let message = format!(
                "`{}` has {} columns; the maximum is {width_max}",
                wide.name,
                wide.arity()
            );
            return Err(Diagnostic::new(codes::LIMIT_EXCEEDED, message).at(wide.span, "declared here"));
        }
        let groupings = groupings(rules);
        let mut indexes = Indexes::new(rules, &groupings);
        let arity = (0..rules.predicates.len() as u32).map(|predicate| indexes.arity(PredicateId(predicate)));
        let arity = arity.max().unwrap_or(0);
        let width = WIDTHS.into_iter().find(|&width| width >= arity).unwrap_or(width_max);

        let strata: Vec<StratumPlan> = rules
            .strata
            .iter()
            .map(|stratum| plan_stratum(rules, stratum, &groupings))
            .collect();
        let mut member = vec![None; rules.predicates.len()];
        for (position, predicate) in strata.iter().flat_map(|stratum| stratum.members.iter().enumerate()) {
            member[predicate.index()] = Some(position);
        }
        let mut computed_with: Vec<&[PredicateId]> = vec![&[]; rules.clauses.len()];
        for stratum in &strata {
            for &clause in &stratum.clauses {
                computed_with[clause.index()] = &stratum.members;
            }
        }
        let correlated = correlated_relations(rules);
        for (
            &predicate,
            Correlated {
                clauses, parameters, ..
            },
        ) in &correlated
        {
            let grouping = groupings[predicate.index()].as_ref();
            let clauses = clauses.iter().map(|clause| &rules.clauses[clause.index()]);
            let plans = clauses.map(|clause| {
                let order = Order::Clause { large: &[] };
                plan_correlated(clause, *parameters, grouping, &mut indexes, order)
            });
            let plans = plans.collect::<Result<Vec<Plan>, Diagnostic>>()?;
            indexes.set_correlated(predicate, plans);
        }
        let mut clauses = Vec::with_capacity(rules.clauses.len());
        let mut sources = BTreeMap::new();
        let mut fact: Option<Arc<ClausePlans>> = None;
        for ((clause, stratum), id) in rules.clauses.iter().zip(computed_with).zip((0..).map(ClauseId)) {
            let grouping = groupings[clause.head.predicate.index()].as_ref();
            let planned = !rules.is_row(clause);
            if let (false, Some(fact)) = (planned, &fact) {
                clauses.push(Arc::clone(fact));
                continue;
            }
            let literals = literals(clause, &correlated);
            if literals > CLAUSE_MAX {
                return Err(too_large(clause, "literals", literals));
            }
            let plans = Arc::new(match correlated.get(&clause.head.predicate) {
                Some(Correlated { parameters, .. }) => {
                    let order = Order::Clause { large: &[] };
                    ClausePlans::of(plan_correlated(clause, *parameters, grouping, &mut indexes, order)?)
                }
                None => plan_clause(clause, stratum, grouping, &mut indexes)?,
            });
            if planned {
                sources.insert(id, clause.clone());
            } else {
                fact = Some(Arc::clone(&plans));
            }
            clauses.push(plans);
        }
        Ok(Plans {
            sources: sources.into(),
            clauses,
            correlated: correlated.into(),
            strata,
            member,
            indexes,
            groupings,
            width,
        })
    }

    /// The clauses of a correlated predicate, one for each of its plans.
    pub(crate) fn correlated_clauses(&self, predicate: PredicateId) -> &[ClauseId] {
        self.correlated.get(&predicate).map_or(&[], |known| &known.clauses)
    }

    /// Replans clauses for predicates of these sizes.
    ///
    /// [`Aim::Recompute`] replans the non-recursive evaluation from scratch, [`Aim::Maintain`] the maintenance plans.
    /// Replanning may add indexes; existing indexes stay as they are.
    pub(crate) fn adapt(&mut self, stratum: &StratumPlan, aim: Aim, sizes: &[Option<Size>]) {
        self.adapt_correlated(stratum, sizes);
        let indexes = &mut self.indexes;
        for &id in &stratum.clauses {
            let Some(clause) = self.sources.get(&id) else { continue };
            let plans = Arc::make_mut(&mut self.clauses[id.index()]);
            let grouping = &self.groupings[clause.head.predicate.index()];
            // Replanning cannot fail: which variables can be bound does not depend on the order.
            match aim {
                Aim::Recompute if plans.deltas.is_empty() => {
                    if let Some(plan) = plan_complete(clause, indexes, sizes) {
                        plans.complete = match grouping {
                            Some(grouping) => plan.grouped(grouping),
                            None => plan,
                        };
                    }
                }
                Aim::Recompute => {}
                Aim::Maintain => {
                    if let Ok((changes, check)) = plan_changes(clause, indexes, Order::Sizes(sizes)) {
                        (plans.changes, plans.check) = (changes, check);
                    }
                }
            }
        }
    }

    /// Replans the correlated predicates of a stratum, and puts the new plans into those of its clauses.
    fn adapt_correlated(&mut self, stratum: &StratumPlan, sizes: &[Option<Size>]) {
        if stratum.correlated.is_empty() {
            return;
        }
        let indexes = &mut self.indexes;
        for &predicate in &stratum.correlated {
            let Correlated {
                clauses, parameters, ..
            } = &self.correlated[&predicate];
            let grouping = self.groupings[predicate.index()].as_ref();
            let clauses = clauses.iter().filter_map(|clause| self.sources.get(clause));
            let plans = clauses.map(|clause| {
                let order = Order::Sizes(sizes);
                plan_correlated(clause, *parameters, grouping, indexes, order)
            });
            let plans: Result<Vec<Plan>, Diagnostic> = plans.collect();
            // Replanning cannot fail, as in `adapt`.
            if let Ok(plans) = plans {
                indexes.set_correlated(predicate, plans);
            }
        }
        for &clause in &stratum.clauses {
            let ClausePlans {
                complete,
                deltas,
                alternatives,
                ..
            } = Arc::make_mut(&mut self.clauses[clause.index()]);
            let deltas = deltas.iter_mut().map(|(_, plan)| plan);
            let plans = deltas.chain(alternatives.iter_mut().flatten()).chain([complete]);
            for step in plans.flat_map(|plan| &mut plan.steps) {
                if let Step::Correlated { predicate, plans, .. } = step
                    && let Some(new) = indexes.correlated(*predicate)
                {
                    *plans = Arc::clone(new);
                }
            }
        }
    }
}

/// Returns the correlated predicates in an order in which each comes after those that it needs.
fn correlated_relations(rules: &Rules) -> BTreeMap<PredicateId, Correlated> {
    let mut correlated: BTreeMap<PredicateId, Correlated> = BTreeMap::new();
    let mut clauses_of: BTreeMap<PredicateId, Vec<(&Clause, ClauseId)>> = BTreeMap::new();
    for (clause, id) in rules.clauses.iter().zip((0..).map(ClauseId)) {
        if rules.predicates[clause.head.predicate.index()].parameters > 0 {
            clauses_of.entry(clause.head.predicate).or_default().push((clause, id));
        }
    }
    // The checker defines the predicate of an inner aggregate before that of the outer one.
    for (predicate, id) in rules.predicates.iter().zip((0..).map(PredicateId)) {
        if predicate.parameters > 0 {
            let clauses = clauses_of.remove(&id).unwrap_or_default();
            let each = clauses.iter().map(|(clause, _)| literals(clause, &correlated));
            let literals = each.fold(0, usize::saturating_add);
            let known = Correlated {
                clauses: clauses.into_iter().map(|(_, clause)| clause).collect(),
                parameters: predicate.parameters,
                literals,
            };
            correlated.insert(id, known);
        }
    }
    correlated
}

/// Returns the number of literals in a clause and in the correlated predicates that it needs. Evaluation recurses once
/// per literal.
fn literals(clause: &Clause, correlated: &BTreeMap<PredicateId, Correlated>) -> usize {
    let atoms = clause.body.iter().filter_map(Literal::atom);
    let inner = atoms.filter_map(|atom| Some(correlated.get(&atom.predicate)?.literals));
    inner.fold(clause.body.len(), usize::saturating_add)
}

fn plan_stratum(rules: &Rules, stratum: &Stratum, groupings: &[Option<Grouping>]) -> StratumPlan {
    let derived = |predicate: &PredicateId| rules.predicates[predicate.index()].derived;
    let head = |clause: &ClauseId| rules.clauses[clause.index()].head.predicate;
    let members: Vec<PredicateId> = stratum.predicates.iter().copied().filter(derived).collect();
    let clauses: Vec<ClauseId> = stratum
        .clauses
        .iter()
        .copied()
        .filter(|clause| derived(&head(clause)))
        .collect();
    let (mut inputs, correlated) = rules.read_by(clauses.iter().copied());
    inputs.sort_unstable();
    // The predicates of a stratum are in ascending order.
    let is_member = |predicate: &PredicateId| members.binary_search(predicate).is_ok();
    let recursive = inputs.iter().any(is_member);
    inputs.retain(|predicate| !is_member(predicate));
    inputs.dedup();
    let small = |clause: &ClauseId| is_maintainable(&rules.clauses[clause.index()]);
    let grouped = members.iter().any(|member| groupings[member.index()].is_some());
    let by_rounds = (members.iter()).any(|member| rules.predicates[member.index()].depends_on_rounds());
    StratumPlan {
        recursive,
        maintainable: clauses.iter().all(small) && !grouped && !by_rounds,
        by_rounds,
        members,
        inputs,
        clauses,
        correlated,
    }
}
