//! Decides which strata the dense executor can evaluate.

use crate::datalog::check::{Atom, ClauseId, Literal, RelId, Rules, Stratum, Term};
use crate::datalog::dense::body::{Body, PAIR, decompose};
use crate::datalog::dense::program::Dense;
use crate::datalog::syntax::ast::{BaseType, Comparison};
use crate::diag::Span;
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

/// The reason why the dense executor cannot evaluate a stratum.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Unsupported {
    /// The stratum is recursive.
    Recursive,
    /// The predicate has no columns, or more than two.
    Columns(RelId),
    /// The predicate has a column that does not hold symbols.
    NotSymbols(RelId),
    /// A clause contains a constant at this place.
    Constant(Span),
    /// A clause computes, aggregates or compares values at this place.
    Computes(Span),
    /// The negated atom at this place has no variable.
    NoVariable(Span),
    /// The clause at this place has too many variables.
    Variables(Span),
    /// A relational stratum reads this predicate of it. Relational strata run before dense ones.
    ReadBy(RelId),
}

impl Unsupported {
    /// Returns the reason as a clause to follow "because".
    pub fn show(&self, rules: &Rules) -> String {
        let name = |relation: &RelId| {
            let relation = &rules.relations[relation.index()];
            match relation.hidden {
                true => relation.doc.clone(),
                false => format!("`{}`", relation.name),
            }
        };
        match self {
            Unsupported::Recursive => "a predicate depends on itself".to_owned(),
            Unsupported::Columns(relation) => format!(
                "{} has {} columns, not one or two",
                name(relation),
                rules.relations[relation.index()].arity()
            ),
            Unsupported::NotSymbols(relation) => format!("{} has a column that does not hold symbols", name(relation)),
            Unsupported::Constant(_) => "a clause names a constant".to_owned(),
            Unsupported::Computes(_) => "a clause computes or compares values".to_owned(),
            Unsupported::NoVariable(_) => "a negated atom has no variable".to_owned(),
            Unsupported::Variables(_) => format!("a clause has more than {} variables", Dense::VARIABLES_MAX),
            Unsupported::ReadBy(relation) => format!("the relational executor needs {}", name(relation)),
        }
    }

    /// Returns the place of the reason, or `None` if it concerns a whole predicate or stratum.
    pub fn span(&self) -> Option<Span> {
        match self {
            Unsupported::Constant(span)
            | Unsupported::Computes(span)
            | Unsupported::NoVariable(span)
            | Unsupported::Variables(span) => Some(*span),
            _ => None,
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
    let mut relational: Vec<Option<Unsupported>> =
        (rules.strata.iter()).map(|stratum| obstacle(rules, stratum)).collect();
    let mut home = vec![None; rules.relations.len()];
    for (position, stratum) in rules.strata.iter().enumerate() {
        for relation in &stratum.relations {
            home[relation.index()] = Some(position);
        }
    }
    // Strata are in dependency order.
    for position in (0..rules.strata.len()).rev() {
        if relational[position].is_none() {
            continue;
        }
        for relation in rules.read_by(rules.strata[position].clauses.iter().copied()).0 {
            if let Some(read) = home[relation.index()]
                && read != position
            {
                relational[read].get_or_insert(Unsupported::ReadBy(relation));
            }
        }
    }
    Choice { relational }
}

/// Returns the maximum number of steps that the searches of a clause take.
fn steps(rules: &Rules, clause: ClauseId, entities: u64, egos: u64) -> u64 {
    let Some(body) = Body::new(&rules.clauses[clause.index()]) else {
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
    if stratum.recursive {
        return Some(Unsupported::Recursive);
    }
    stratum.clauses.iter().find_map(|clause| {
        let clause = &rules.clauses[clause.index()];
        let wildcards = clause.body.iter().flat_map(Literal::terms);
        let wildcards = wildcards.filter(|term| **term == Term::Wildcard).count();
        if clause.variables.len() + wildcards > Dense::VARIABLES_MAX {
            return Some(Unsupported::Variables(clause.span));
        }
        unfit(rules, &clause.head).or_else(|| clause.body.iter().find_map(|literal| obstacle_in(rules, literal)))
    })
}

fn obstacle_in(rules: &Rules, literal: &Literal) -> Option<Unsupported> {
    match literal {
        Literal::Positive(atom) | Literal::Guard(atom) => unfit(rules, atom),
        Literal::Negative(atom) => unfit(rules, atom).or_else(|| {
            let bound = atom.terms.iter().any(|term| matches!(term, Term::Variable(_)));
            (!bound).then_some(Unsupported::NoVariable(atom.span))
        }),
        Literal::Compare {
            op: Comparison::Equal | Comparison::NotEqual,
            left: Term::Variable(_),
            right: Term::Variable(_),
            base: BaseType::Symbol,
            ..
        } => None,
        Literal::Compare { span, .. } | Literal::Compute { span, .. } => Some(Unsupported::Computes(*span)),
        Literal::Aggregate { atom, .. } => Some(Unsupported::Computes(atom.span)),
    }
}

fn unfit(rules: &Rules, atom: &Atom) -> Option<Unsupported> {
    let relation = &rules.relations[atom.relation.index()];
    if !(1..=2).contains(&relation.arity()) {
        return Some(Unsupported::Columns(atom.relation));
    }
    if relation.columns.iter().any(|column| column.base != BaseType::Symbol) {
        return Some(Unsupported::NotSymbols(atom.relation));
    }
    let constant = atom.terms.iter().any(|term| matches!(term, Term::Constant(_)));
    constant.then_some(Unsupported::Constant(atom.span))
}
