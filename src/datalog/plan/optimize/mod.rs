//! The optimizer: replaces rules by simpler equivalent ones.
//!
//! `optimize` removes literals that others imply. It puts a false comparison in front of a body that contradicts
//! itself, and it drops clauses that another clause subsumes. Clauses keep their ids, and
//! [`crate::session::Session::fired`] still reports what each derives. [`lints`] reports the findings to the
//! author.
//!
//! `theory` derives consequences of a literal, and `saturate` searches the forms of a body. The optimizer does not
//! expand derived predicates, so its results hold whatever the other clauses are. It uses constraints only if the
//! caller asks. It is bounded and deterministic: it uses no clock and no hash order.
// Decision: docs/decisions/evaluation.md#d035

mod repeated;
mod saturate;
mod theory;

use crate::check::subsumption;
use crate::check::subsumption::{Fact, NoConstraints, Pattern, Theory, facts, within_theory};
use crate::check::temporal;
use crate::check::witness::written;
use crate::check::{
    Atom, Budget, Clause, ClauseId, Comparing, Constraint, DeclaredConstraint, Literal, PredicateId, Rules, Term, VarId,
};
use crate::codes;
use crate::diag::{Diagnostic, Sources, Span, counted};
use crate::symbol::Symbol;
use crate::syntax::ast::{BaseType, Comparison};
use crate::syntax::quoted;
use crate::value::{Value, record_text, shown_number};
use saturate::Knowledge;
use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};
use theory::{Closure, Constraints, implies};

/// The optimizer skips bodies with more literals than this.
const LITERALS_MAX: usize = 64;

/// The maximum number of clauses that a message shows as repeating a part.
const USES_SHOWN: usize = 8;

/// The step limit of the search for subsumed clauses.
const STEPS_MAX: usize = 10_000_000;

/// A part of the rules that can be removed. `given` are the positions of the constraints that this follows from.
#[derive(Clone, Debug)]
enum Finding {
    /// The literal at `literal` holds whenever the one at `because` does, or always if that is `None`.
    Redundant {
        clause: ClauseId,
        literal: usize,
        because: Option<usize>,
        given: Vec<usize>,
    },
    /// The two literals never hold together.
    Contradictory {
        clause: ClauseId,
        one: usize,
        other: usize,
        given: Vec<usize>,
    },
    /// The clause `by` derives everything that this one derives.
    Subsumed { clause: ClauseId, by: ClauseId },
}

/// Returns equivalent rules with the same predicates and clause ids. With `assume`, they are equivalent only for facts
/// that satisfy the declared constraints.
pub(crate) fn optimize(rules: &Rules, assume: bool) -> Cow<'_, Rules> {
    let theory = Constraints::new(rules.symbols.word_size(), rules.constraints.iter().filter(|_| assume));
    let mut gone = vec![false; rules.clauses.len()];
    let mut redundant: BTreeMap<ClauseId, BTreeSet<usize>> = BTreeMap::new();
    let findings = find(rules, &theory, true).findings;
    if findings.is_empty() {
        return Cow::Borrowed(rules);
    }
    let mut better = rules.clone();
    for finding in findings {
        match finding {
            Finding::Redundant { clause, literal, .. } => _ = redundant.entry(clause).or_default().insert(literal),
            Finding::Contradictory { clause, .. } => {
                let clause = &mut better.clauses[clause.index()];
                let zero = Term::Constant(Value::number(0));
                let never = Literal::Compare {
                    op: Comparison::NotEqual,
                    left: zero,
                    right: zero,
                    base: BaseType::Number,
                    span: clause.span,
                };
                clause.body.insert(0, never);
            }
            Finding::Subsumed { clause, .. } => gone[clause.index()] = true,
        }
    }
    for (clause, redundant) in redundant {
        let mut position = 0;
        better.clauses[clause.index()].body.retain(|_| {
            position += 1;
            !redundant.contains(&(position - 1))
        });
    }
    for stratum in &mut better.strata {
        stratum.clauses.retain(|clause| !gone[clause.index()]);
    }
    Cow::Owned(better)
}

/// The result of [`lints`].
#[derive(Clone, Debug)]
pub struct Lints {
    /// The possible simplifications, in source order.
    pub diagnostics: Vec<Diagnostic>,
    /// Steps of the search for clauses that others subsume under the constraints.
    pub steps: usize,
    /// The checks that hit a limit and are incomplete.
    pub unfinished: Vec<&'static str>,
}

/// Returns possible simplifications of the rules as warnings. They concern implied literals, contradictory bodies,
/// clauses that others subsume under the constraints, and repeated parts of bodies. A warning that follows from
/// constraints names them, with their places in `sources`.
pub fn lints(rules: &Rules, sources: &Sources) -> Lints {
    let theory = Constraints::new(rules.symbols.word_size(), &rules.constraints);
    let mut lints = Vec::new();
    // Loading reports clauses that are subsumed without constraints.
    let found = find(rules, &theory, !rules.constraints.is_empty());
    let mut minimized = 0;
    for finding in &found.findings {
        let named = |id: ClauseId| &rules.clauses[id.index()];
        let (Finding::Subsumed { clause, .. }
        | Finding::Contradictory { clause, .. }
        | Finding::Redundant { clause, .. }) = *finding;
        // The reader wrote no such clause: `range(0, 3)` has hidden ones for both directions.
        if rules.predicates[named(clause).head.predicate.index()].hidden {
            continue;
        }
        let (lint, given) = match *finding {
            Finding::Subsumed { clause, by }
                if is_subsumed(named(clause), named(by), &NoConstraints(rules.symbols.word_size())) =>
            {
                continue;
            }
            Finding::Subsumed { clause, by } => {
                minimized += 1;
                let given = unsat_core(rules, &theory, named(clause), named(by), minimized <= MINIMIZED_MAX);
                let fault = Diagnostic::new(
                    codes::SUBSUMED_CLAUSE,
                    "another clause derives everything that this one does",
                )
                .at(named(clause).span, "")
                .also(named(by).span, "this clause derives the same rows");
                (Some(fault.help("remove it")), given)
            }
            Finding::Contradictory {
                clause,
                one,
                other,
                ref given,
            } => {
                let clause = named(clause);
                // A guard has the place of the directive.
                let is_guard = |at: usize| matches!(clause.body[at], Literal::Guard(_));
                let (one, other) = if is_guard(other) { (other, one) } else { (one, other) };
                let (first, second) = (shown_literal(rules, clause, one), shown_literal(rules, clause, other));
                let fault = Diagnostic::new(
                    codes::CONTRADICTORY_BODY,
                    "this clause never fires: its body contradicts itself",
                );
                let span = span(&clause.body[other]);
                let fault = if one == other {
                    fault.at(span, format!("`{second}` never holds"))
                } else {
                    fault
                        .at(span, format!("`{second}` never holds together with `{first}`"))
                        .also(self::span(&clause.body[one]), "the other literal")
                };
                (Some(fault), given.clone())
            }
            Finding::Redundant {
                clause,
                literal,
                because,
                ref given,
            } => (
                redundant(rules, &theory, named(clause), literal, because),
                given.clone(),
            ),
        };
        lints.extend(lint.map(|lint| {
            let given: BTreeSet<usize> = given.into_iter().collect();
            let given = given.into_iter().map(|number| &rules.constraints[number]);
            given.fold(lint, |lint, constraint| {
                lint.note(format!("given {}", constraint.show(rules, sources)))
            })
        }));
    }
    let (parts, all_parts) = repeated::repeated(rules);
    lints.extend(parts.iter().filter_map(|uses| worth_a_name(rules, uses)));
    lints.sort_by_key(|lint| lint.primary.as_ref().map(|label| (label.span.source, label.span.start)));
    let unfinished = [
        (
            found.comparing.complete,
            "clauses that others cover under the constraints",
        ),
        (all_parts, "parts that several bodies share"),
    ];
    Lints {
        diagnostics: lints,
        steps: found.comparing.steps,
        unfinished: unfinished
            .into_iter()
            .filter(|(all, _)| !all)
            .map(|(_, what)| what)
            .collect(),
    }
}

/// The warning about a part that the bodies of several written clauses share. Alternatives and heads of one clause share
/// what is written once.
fn worth_a_name(rules: &Rules, uses: &[repeated::Use]) -> Option<Diagnostic> {
    let first = &uses[0];
    let mut spans: Vec<Span> = uses.iter().map(|one| rules.clauses[one.clause].span).collect();
    // The alternatives of a clause follow each other.
    spans.dedup();
    if spans.len() < 2 {
        return None;
    }
    let clause = &rules.clauses[first.clause];
    let literals = first.positions.iter();
    let body: Vec<String> = literals.map(|&index| shown_literal(rules, clause, index)).collect();
    let body = body.join(", ");
    let variables = first.outside(uses, clause);
    let variables: Vec<&str> = (variables.iter())
        .filter_map(|term| match term {
            Term::Variable(VarId(id)) => Some(clause.variables[*id as usize].as_str()),
            _ => None,
        })
        .collect();
    let lint = Diagnostic::new(codes::REPEATED_BODY, format!("{} clauses repeat `{body}`", spans.len()))
        .at(clause.span, "first used here");
    let others = spans[1..].iter().take(USES_SHOWN);
    let lint = others.fold(lint, |lint, &span| lint.also(span, "repeated here"));
    let lint = match spans.len().saturating_sub(1 + USES_SHOWN) {
        0 => lint,
        more => lint.note(format!("repeated in {}", counted(more, "more clause"))),
    };
    Some(lint.help(format!(
        "define a predicate for it and use that: `Name({}) :- {body}.`",
        variables.join(", ")
    )))
}

fn redundant(
    rules: &Rules,
    theory: &Constraints,
    clause: &Clause,
    literal: usize,
    because: Option<usize>,
) -> Option<Diagnostic> {
    // Loading reports an equation of a variable with itself.
    let reported = match clause.body[literal] {
        Literal::Guard(_) => true,
        Literal::Compare { op, left, right, .. } => op == Comparison::Equal && left == right,
        _ => false,
    };
    if reported || rules.predicates[clause.head.predicate.index()].hidden {
        return None;
    }
    let redundant = shown_literal(rules, clause, literal);
    let mut fault = Diagnostic::new(codes::REDUNDANT_LITERAL, format!("`{redundant}` is redundant"))
        .at(span(&clause.body[literal]), "");
    fault = match because {
        None => fault.note("it always holds"),
        Some(other) if matches!(clause.body[other], Literal::Guard(_)) => fault.note("the scope implies it"),
        Some(other) => {
            let reason = shown_literal(rules, clause, other);
            fault.also(span(&clause.body[other]), format!("`{reason}` implies it"))
        }
    };
    let kept = simplest(clause, theory)??;
    let body: Vec<String> = (kept.iter())
        .filter(|&&index| !matches!(clause.body[index], Literal::Guard(_)))
        .map(|&index| shown_literal(rules, clause, index))
        .collect();
    let head = shown_atom(rules, clause, &clause.head);
    Some(fault.help(format!(
        "an equivalent shorter clause: `{head} :- {}.`",
        body.join(", ")
    )))
}

// --- finding

/// The literals of a body with the consequences of each.
struct Literals<'a> {
    theory: &'a Constraints,
    facts: Vec<Fact>,
    closures: Vec<Closure>,
}

impl<'a> Literals<'a> {
    fn new(theory: &'a Constraints, facts: Vec<Fact>) -> Self {
        let closures = facts.iter().map(|fact| theory.consequences(fact)).collect();
        Literals {
            theory,
            facts,
            closures,
        }
    }

    /// Returns the constraints by which literal `a` implies literal `b`, if it does.
    fn implication(&self, a: usize, b: usize) -> Option<Vec<usize>> {
        let closure = &self.closures[a];
        let known = closure.facts.iter().position(|known| implies(known, &self.facts[b]))?;
        Some(closure.reasons(known).collect())
    }

    /// Returns the constraints by which the two literals contradict each other, if they do.
    fn contradiction(&self, a: usize, b: usize) -> Option<Vec<usize>> {
        self.theory.contradiction(&self.closures[a], &self.closures[b])
    }
}

impl Knowledge for Literals<'_> {
    fn implies(&self, a: usize, b: usize) -> bool {
        self.implication(a, b).is_some()
    }

    fn exclude(&self, a: usize, b: usize) -> bool {
        self.contradiction(a, b).is_some()
    }

    fn always(&self, a: usize) -> bool {
        self.theory.always(&self.facts[a])
    }
}

fn is_known(clause: &Clause) -> bool {
    !clause.body.is_empty() && clause.body.len() <= LITERALS_MAX && within_theory(clause)
}

/// Returns the positions of the literals to keep. The inner `None` means that the body never holds, the outer that the
/// optimizer skips the clause.
#[allow(clippy::option_option)]
fn simplest(clause: &Clause, theory: &Constraints) -> Option<Option<Vec<usize>>> {
    if !is_known(clause) {
        return None;
    }
    let literals = Literals::new(theory, facts(clause, true, theory.word_size()));
    let mut kept = saturate::simplest(literals.facts.len(), &literals);
    if let Some(kept) = &mut kept {
        kept.sort_unstable();
        // A body that always holds stays as it is: clauses with an empty body are facts.
        if kept.is_empty() {
            return None;
        }
    }
    Some(kept)
}

struct Found {
    findings: Vec<Finding>,
    /// The work of the search for subsumed clauses.
    comparing: Comparing,
}

fn find(rules: &Rules, theory: &Constraints, covered: bool) -> Found {
    let mut findings = Vec::new();
    for (index, clause) in rules.clauses.iter().enumerate() {
        let id = ClauseId(index as u32);
        let Some(kept) = simplest(clause, theory) else { continue };
        let literals = Literals::new(theory, facts(clause, true, theory.word_size()));
        let count = literals.facts.len();
        match kept {
            Some(kept) => {
                for literal in (0..count).filter(|literal| !kept.contains(literal)) {
                    let mut reasons = kept.iter().map(|&other| (other, literals.implication(other, literal)));
                    let because = reasons.find_map(|(other, given)| Some((other, given?)));
                    let always = || literals.theory.tautology(&literals.facts[literal]).flatten();
                    findings.push(Finding::Redundant {
                        clause: id,
                        literal,
                        because: because.as_ref().map(|(other, _)| *other),
                        given: because.map_or_else(|| always().into_iter().collect(), |(_, given)| given),
                    });
                }
            }
            None => {
                let pairs = (0..count).flat_map(|other| (0..=other).map(move |one| (one, other)));
                // Prefer a literal that never holds to a pair.
                let single = (0..count).map(|one| (one, one));
                let contradiction = |(one, other)| literals.contradiction(one, other).map(|given| (one, other, given));
                if let Some((one, other, given)) = single.chain(pairs).find_map(contradiction) {
                    findings.push(Finding::Contradictory {
                        clause: id,
                        one,
                        other,
                        given,
                    });
                }
            }
        }
    }
    let comparing = match covered {
        true => subsumed(rules, theory, &mut findings),
        false => Comparing::default(),
    };
    Found { findings, comparing }
}

/// Finds the clauses that others subsume. Clauses that never fire take no part.
fn subsumed(rules: &Rules, theory: &Constraints, findings: &mut Vec<Finding>) -> Comparing {
    let contradictory = |finding: &Finding| match finding {
        Finding::Contradictory { clause, .. } => Some(*clause),
        _ => None,
    };
    let never: BTreeSet<ClauseId> = findings.iter().filter_map(contradictory).collect();
    let mut by_head: BTreeMap<PredicateId, Vec<ClauseId>> = BTreeMap::new();
    for (clause, id) in rules.clauses.iter().zip((0..).map(ClauseId)) {
        if is_known(clause) && !rules.is_row(clause) && !never.contains(&id) {
            by_head.entry(clause.head.predicate).or_default().push(id);
        }
    }
    let mut budget = Budget::new(STEPS_MAX);
    for group in by_head.into_values().filter(|group| group.len() > 1) {
        let pattern = |id: &ClauseId| Pattern::new(&rules.clauses[id.index()], theory);
        let patterns: Vec<Pattern> = group.iter().map(pattern).collect();
        let found = subsumption::redundant(&patterns, theory, &mut budget, &|_, _| true);
        findings.extend(found.iter().map(|found| Finding::Subsumed {
            clause: group[found.clause],
            by: group[found.by],
        }));
    }
    budget.spent()
}

/// Whether `by` subsumes the clause under a theory.
fn is_subsumed(clause: &Clause, by: &Clause, theory: &dyn Theory) -> bool {
    let [general, special] = [by, clause].map(|clause| Pattern::new(clause, theory));
    general.subsumes(&special, theory, &mut Budget::new(STEPS_MAX))
}

/// The maximum number of clauses for which [`lints`] finds a smallest set of constraints.
const MINIMIZED_MAX: usize = 100;

/// The maximum number of constraints among which it searches that set.
const CORE_MAX: usize = 64;

/// Returns constraints from which it follows that `by` subsumes the clause; with `minimal`, none that is not needed.
fn unsat_core(rules: &Rules, theory: &Constraints, clause: &Clause, by: &Clause, minimal: bool) -> Vec<usize> {
    let mut used: BTreeSet<usize> = BTreeSet::new();
    for fact in facts(clause, false, theory.word_size()) {
        let closure = theory.consequences(&fact);
        used.extend((0..closure.facts.len()).flat_map(|at| closure.reasons(at)));
    }
    let always = facts(by, true, theory.word_size());
    let predicates = always.iter().filter_map(|fact| match fact {
        Fact::Atom { predicate, .. } => Some(*predicate),
        _ => None,
    });
    let predicates: BTreeSet<PredicateId> = predicates.collect();
    let forbids_loops = |one: &&DeclaredConstraint| match one.constraint {
        Constraint::Irreflexive(predicate) | Constraint::Asymmetric(predicate) => predicates.contains(&predicate),
        _ => false,
    };
    let all = rules.constraints.iter().enumerate();
    used.extend(all.filter(|(_, one)| forbids_loops(one)).map(|(number, _)| number));
    if !minimal || used.len() > CORE_MAX {
        return used.into_iter().collect();
    }
    for number in used.clone() {
        let fewer = used.iter().filter(|other| **other != number);
        let fewer = Constraints::new(rules.symbols.word_size(), fewer.map(|other| &rules.constraints[*other]));
        if is_subsumed(clause, by, &fewer) {
            used.remove(&number);
        }
    }
    used.into_iter().collect()
}

// --- messages

fn span(literal: &Literal) -> Span {
    match literal {
        Literal::Positive(atom) | Literal::Negative(atom) | Literal::Guard(atom) | Literal::Aggregate { atom, .. } => {
            atom.span
        }
        Literal::Compare { span, .. } | Literal::Compute { span, .. } => *span,
    }
}

fn shown_literal(rules: &Rules, clause: &Clause, index: usize) -> String {
    match &clause.body[index] {
        Literal::Positive(atom) | Literal::Guard(atom) => shown_atom(rules, clause, atom),
        Literal::Negative(atom) => format!("Not({})", shown_atom(rules, clause, atom)),
        Literal::Compare {
            op, left, right, base, ..
        } => {
            let term = |term| shown_term(rules, clause, term, *base);
            format!("{} {op} {}", term(left), term(right))
        }
        // The optimizer skips clauses with these literals, so no message shows them.
        Literal::Compute { .. } | Literal::Aggregate { .. } => String::new(),
    }
}

fn shown_atom(rules: &Rules, clause: &Clause, atom: &Atom) -> String {
    let predicate = &rules.predicates[atom.predicate.index()];
    let columns = predicate.columns.iter().zip(&atom.terms);
    let terms: Vec<String> = columns
        .map(|(column, term)| shown_term(rules, clause, term, column.base))
        .collect();
    match predicate.hidden {
        true => temporal::shown(predicate, &terms).unwrap_or_else(|| predicate.title().to_owned()),
        false => format!("{}({})", predicate.name, terms.join(", ")),
    }
}

fn shown_term(rules: &Rules, clause: &Clause, term: &Term, base: BaseType) -> String {
    match *term {
        Term::Wildcard => "_".to_owned(),
        Term::Variable(VarId(id)) => written(&clause.variables[id as usize]).to_owned(),
        Term::Constant(value) => match base {
            BaseType::Number | BaseType::Unsigned | BaseType::Float => shown_number(base, value, &rules.symbols),
            BaseType::Record => record_text(value, &rules.symbols),
            BaseType::Symbol => quoted(rules.symbols.resolve(Symbol(value.0)).unwrap_or_default()),
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cases::cases;
    use crate::check::random_clauses;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(cases(256))]

        #[test]
        fn traits_suffice_under_constraints(rules in random_clauses::rules()) {
            let theory = Constraints::new(rules.symbols.word_size(), &rules.constraints);
            let known = rules.clauses.iter().filter(|clause| is_known(clause));
            prop_assert!(subsumption::traits_suffice(known, &theory));
        }
    }
}
