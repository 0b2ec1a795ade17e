//! Decides which strata the dense executor can evaluate.

use crate::check::{Atom, ClauseId, Literal, PredicateId, Rules, Stratum, Term};
use crate::dense::body::{DenseBody, PAIR, decompose};
use crate::dense::count::{BoundedCount, bounded_counts, is_stored};
use crate::dense::program::Dense;
use crate::diag::Span;
use crate::syntax::ast::{BaseType, Comparison};
use crate::syntax::functor::{AggregateOp, Functor};
use std::collections::HashMap;
use std::fmt;

/// The executor of each stratum.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Choice {
    /// Indexed by position of the stratum: why it needs the relational executor; `None` if it is dense.
    pub relational: Vec<Option<Unsupported>>,
}

impl Choice {
    /// Returns whether the dense executor evaluates the stratum.
    pub fn is_dense(&self, stratum: usize) -> bool {
        self.relational[stratum].is_none()
    }

    /// Returns the clauses of dense strata whose searches may take more than [`Dense::steps_max`] steps over this many
    /// entities, `egos` of them to decide about. A run of the other clauses always ends.
    pub fn costly(&self, rules: &Rules, entities: usize, egos: usize) -> Vec<ClauseId> {
        let strata = rules
            .strata
            .iter()
            .enumerate()
            .filter(|(position, _)| self.is_dense(*position));
        let clauses = strata.flat_map(|(_, stratum)| &stratum.clauses).copied();
        let steps: Vec<(ClauseId, u64)> = clauses
            .map(|clause| (clause, steps(rules, clause, entities as u64, egos as u64)))
            .collect();
        let all = steps.iter().fold(0_u64, |sum, (_, steps)| sum.saturating_add(*steps));
        let max = Dense::steps_max(entities);
        // If the sum alone exceeds it, the most expensive clause counts.
        let largest = steps.iter().map(|(_, steps)| *steps).max().unwrap_or(0);
        let costly = |steps: u64| steps > max || all > max && steps == largest;
        steps
            .into_iter()
            .filter(|(_, steps)| costly(*steps))
            .map(|(clause, _)| clause)
            .collect()
    }

    /// Returns whether the dense executor evaluates all strata.
    pub fn all_dense(&self) -> bool {
        self.relational.iter().all(Option::is_none)
    }
}

/// The reason why the dense executor cannot evaluate a stratum: a clause at the root, in this stratum or in one that
/// depends on it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Unsupported {
    /// What the dense executor does not support.
    pub construct: Construct,
    /// The clause with the construct.
    pub clause: ClauseId,
    /// The place of the construct.
    pub span: Span,
    /// The predicate of the stratum that the clause reads, directly or through others, if the clause is in another
    /// stratum. Relational strata run before dense ones.
    pub reads: Option<PredicateId>,
}

/// A construct that the dense executor does not support.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Construct {
    /// The predicate depends on itself.
    Recursion(PredicateId),
    /// The predicate has no columns, or more than two.
    Columns(PredicateId),
    /// The predicate has a column that does not hold symbols.
    NotSymbols(PredicateId),
    /// A constant.
    Constant,
    /// A draw about more than two entities, or about the value of an expression on several.
    Draw,
    /// An expression.
    Expression,
    /// A comparison other than `=` and `!=` of two variables for symbols.
    Comparison,
    /// An aggregate, except a count of entities that is only compared with constants.
    Aggregate(AggregateOp),
    /// A negated atom without a variable.
    NoVariable,
    /// A clause with too many variables.
    Variables,
}

impl Unsupported {
    /// Returns the reason as a sentence without a full stop, to follow "because".
    pub fn show(&self, rules: &Rules) -> String {
        let named = |predicate: PredicateId| {
            let predicate = &rules.predicates[predicate.index()];
            match predicate.hidden {
                true => predicate.title().to_owned(),
                false => format!("`{}`", predicate.name),
            }
        };
        let head = named(rules.clauses[self.clause.index()].head.predicate);
        match self.construct {
            Construct::Recursion(predicate) => format!("{} depends on itself", named(predicate)),
            Construct::Columns(predicate) => format!(
                "a clause of {head} uses {}, which has {} columns, not one or two",
                named(predicate),
                rules.predicates[predicate.index()].arity()
            ),
            Construct::NotSymbols(predicate) => {
                format!(
                    "a clause of {head} uses {}, which has a column that does not hold symbols",
                    named(predicate)
                )
            }
            Construct::Constant => format!("a clause of {head} names a constant"),
            Construct::Draw => format!("a clause of {head} draws for each combination of more than two agents"),
            Construct::Expression => format!("a clause of {head} computes a value"),
            Construct::Comparison => format!("a clause of {head} compares values"),
            Construct::Aggregate(op) => format!("a clause of {head} aggregates with `{}`", op.name()),
            Construct::NoVariable => format!("a clause of {head} negates an atom without a variable"),
            Construct::Variables => format!("a clause of {head} has more than {} variables", Dense::VARIABLES_MAX),
        }
    }

    /// Returns what to write instead, if something has the same meaning.
    pub fn help(&self) -> Option<&'static str> {
        match self.construct {
            Construct::Recursion(_) => Some("write out the steps if chains have a bounded length"),
            Construct::Columns(_) => Some("use predicates of one or two columns"),
            Construct::Constant => {
                Some("give the agent a concept in the configuration and test that, instead of naming the agent")
            }
            Construct::Aggregate(AggregateOp::Count) => {
                Some("count the agents that a predicate relates to one agent, and compare the count with constants")
            }
            Construct::Draw => Some(
                "derive the body in a predicate over one agent or two, and draw over that; variables that begin with `_` \
                 take no part in a draw",
            ),
            Construct::Variables => Some("derive a part of the body in a predicate of its own"),
            Construct::NotSymbols(_)
            | Construct::Expression
            | Construct::Comparison
            | Construct::Aggregate(_)
            | Construct::NoVariable => None,
        }
    }
}

impl fmt::Display for Choice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let dense = self.relational.iter().filter(|reason| reason.is_none()).count();
        write!(f, "{dense} of {} strata dense", self.relational.len())
    }
}

/// Chooses the executor of every stratum.
///
/// A stratum is dense if the dense executor supports it and no relational stratum depends on it. So the relational
/// executor can run first.
pub fn choose(rules: &Rules) -> Choice {
    let aggregates = aggregates(rules);
    let obstacles = rules.strata.iter().map(|stratum| obstacle(rules, stratum));
    let obstacles = obstacles.map(|found| found.map(|one| visible(rules, &aggregates, one)));
    let mut relational: Vec<Option<Unsupported>> = obstacles.collect();
    let mut home = vec![None; rules.predicates.len()];
    for (position, stratum) in rules.strata.iter().enumerate() {
        for predicate in &stratum.predicates {
            home[predicate.index()] = Some(position);
        }
    }
    // A predicate that does not fit is derived by a clause that does not: that one is the root.
    for position in 0..relational.len() {
        let used = match &relational[position] {
            Some(Unsupported {
                construct: Construct::Columns(used) | Construct::NotSymbols(used),
                ..
            }) => home[used.index()],
            _ => None,
        };
        if let Some(used) = used.filter(|used| *used != position)
            && relational[used].is_some()
        {
            relational[position] = relational[used].clone();
        }
    }
    // Strata are in dependency order.
    for position in (0..rules.strata.len()).rev() {
        let Some(root) = relational[position].clone() else {
            continue;
        };
        for predicate in rules.read_by(rules.strata[position].clauses.iter().copied()).0 {
            if let Some(read) = home[predicate.index()]
                && read != position
            {
                relational[read].get_or_insert(Unsupported {
                    reads: Some(predicate),
                    ..root.clone()
                });
            }
        }
    }
    Choice { relational }
}

/// Returns the maximum number of steps that the searches of a clause take.
fn steps(rules: &Rules, clause: ClauseId, entities: u64, egos: u64) -> u64 {
    let Some(body) = DenseBody::new(&rules.clauses[clause.index()]) else {
        return 0;
    };
    let (groups, first) = (body.groups(), body.second_of_head());
    let mut sum = 0_u64;
    for group in groups.iter().filter(|group| group.len() > PAIR) {
        let first = first.filter(|first| group.contains(first));
        for branch in decompose(&body.search(group, first, &[])) {
            let of_head = if branch.of_head { egos } else { 1 };
            let combinations = branch
                .separator
                .iter()
                .fold(of_head, |product, _| product.saturating_mul(entities));
            // An interrupted search repeats some steps.
            sum = sum.saturating_add(combinations.saturating_mul(2));
        }
    }
    sum
}

/// Returns the reason in the stratum itself why it cannot be dense, if any.
fn obstacle(rules: &Rules, stratum: &Stratum) -> Option<Unsupported> {
    let at = |clause: ClauseId| {
        move |(construct, span): (Construct, Span)| Unsupported {
            construct,
            clause,
            span,
            reads: None,
        }
    };
    if stratum.recursive {
        let within = |atom: &&Atom| stratum.predicates.contains(&atom.predicate);
        let step = |&clause: &ClauseId| {
            let mut atoms = rules.clauses[clause.index()].body.iter().filter_map(Literal::atom);
            let atom = atoms.find(within)?;
            Some(at(clause)((Construct::Recursion(atom.predicate), atom.span)))
        };
        return stratum.clauses.iter().find_map(step);
    }
    stratum.clauses.iter().find_map(|&id| {
        let clause = &rules.clauses[id.index()];
        let wildcards = clause.body.iter().flat_map(Literal::terms);
        let wildcards = wildcards.filter(|term| **term == Term::Wildcard).count();
        let many = clause.variables.len() + wildcards > Dense::VARIABLES_MAX;
        let found = many.then_some((Construct::Variables, clause.span));
        // Expressions and aggregates are the reason for columns of numbers.
        let counts: Vec<BoundedCount> = bounded_counts(clause);
        let counts = || counts.iter().filter(|count| is_stored(rules, count));
        let counted = |position: usize| counts().any(|count| count.literals.contains(&position));
        let literals = || clause.body.iter().enumerate();
        let others = || {
            literals()
                .filter(|(position, _)| !counted(*position))
                .map(|(_, literal)| literal)
        };
        let body = || {
            let aggregated = counts().filter_map(|count| unfit(rules, clause.body[count.literals[0]].atom()?));
            aggregated.chain(others().filter_map(|literal| obstacle_in(rules, literal)))
        };
        let computed = |(construct, _): &(Construct, Span)| {
            matches!(
                construct,
                Construct::Draw | Construct::Expression | Construct::Aggregate(_) | Construct::Comparison
            )
        };
        let found = found.or_else(|| body().find(computed));
        let found = found.or_else(|| unfit(rules, &clause.head)).or_else(|| body().next());
        found.map(at(id))
    })
}

/// Returns the reason in the clause that the author wrote: for one in a hidden predicate, the aggregate that the
/// predicate belongs to.
fn visible(rules: &Rules, aggregates: &Aggregates, found: Unsupported) -> Unsupported {
    let head = rules.clauses[found.clause.index()].head.predicate;
    let aggregate = aggregates.get(&head).filter(|_| rules.predicates[head.index()].hidden);
    match aggregate {
        Some(&(clause, op, span)) => Unsupported {
            construct: Construct::Aggregate(op),
            clause,
            span,
            reads: None,
        },
        None => found,
    }
}

/// The first aggregate over each predicate.
type Aggregates = HashMap<PredicateId, (ClauseId, AggregateOp, Span)>;

fn aggregates(rules: &Rules) -> Aggregates {
    let mut found = Aggregates::new();
    for (clause, id) in rules.clauses.iter().zip((0..).map(ClauseId)) {
        for literal in &clause.body {
            if let Literal::Aggregate { op, atom, .. } = literal {
                found.entry(atom.predicate).or_insert((id, *op, atom.span));
            }
        }
    }
    found
}

fn obstacle_in(rules: &Rules, literal: &Literal) -> Option<(Construct, Span)> {
    match literal {
        Literal::Positive(atom) | Literal::Guard(atom) => unfit(rules, atom),
        Literal::Negative(atom) => unfit(rules, atom).or_else(|| {
            let bound = atom.terms.iter().any(|term| matches!(term, Term::Variable(_)));
            (!bound).then_some((Construct::NoVariable, atom.span))
        }),
        Literal::Compare {
            op: Comparison::Equal | Comparison::NotEqual,
            left: Term::Variable(_),
            right: Term::Variable(_),
            base: BaseType::Symbol,
            ..
        } => None,
        Literal::Compare {
            left,
            right,
            base: BaseType::Symbol,
            span,
            ..
        } if [left, right].iter().any(|term| matches!(term, Term::Constant(_))) => Some((Construct::Constant, *span)),
        Literal::Compare { span, .. } => Some((Construct::Comparison, *span)),
        Literal::Compute {
            functor: Functor::Choose,
            span,
            ..
        } => Some((Construct::Draw, *span)),
        Literal::Compute { span, .. } => Some((Construct::Expression, *span)),
        Literal::Aggregate { op, atom, .. } => Some((Construct::Aggregate(*op), atom.span)),
    }
}

fn unfit(rules: &Rules, atom: &Atom) -> Option<(Construct, Span)> {
    let predicate = &rules.predicates[atom.predicate.index()];
    if !(1..=2).contains(&predicate.arity()) {
        return Some((Construct::Columns(atom.predicate), atom.span));
    }
    if predicate.columns.iter().any(|column| column.base != BaseType::Symbol) {
        return Some((Construct::NotSymbols(atom.predicate), atom.span));
    }
    let constant = atom.terms.iter().any(|term| matches!(term, Term::Constant(_)));
    constant.then_some((Construct::Constant, atom.span))
}
