//! Replaces atoms over `inline` predicates by the bodies of their clauses.
//!
//! ```text
//! .decl Pair(x: number, y: number) inline
//! Pair(x, y) :- A(x), B(y).
//! Sum(x) :- Pair(x, y), C(x, y).              becomes   Sum(x) :- A(x), B(y), C(x, y).
//! Rest(x) :- D(x), !Pair(x, x).               becomes   Rest(x) :- D(x), !A(x).   Rest(x) :- D(x), !B(x).
//! ```
//!
//! The rows of such a predicate are then computed only if some use remains: in an aggregate, or negated where a clause
//! has variables that are not in its head. A predicate with many clauses, or one that a clause uses many times, may
//! make too many clauses or too long ones; then it is computed, too.

use crate::check::strata::components;
use crate::check::{Atom, Clause, Literal, PredicateId, Rules, Term, VarId, restratified};
use crate::rewrite::is_visible;
use crate::syntax::ast::{BaseType, Comparison};
use std::collections::HashMap;

/// The maximum number of clauses that one clause becomes.
const MAX_CLAUSES: usize = 64;

/// The maximum number of literals of an unfolded clause.
const MAX_LITERALS: usize = 64;

/// Returns the rules with `inline` predicates unfolded, and the predicates that could not be unfolded everywhere.
/// Returns `None` if there is nothing to unfold.
pub fn unfold(rules: &Rules) -> Option<(Rules, Vec<PredicateId>)> {
    let predicates = (0..).map(PredicateId).take(rules.predicates.len());
    // Rows can be added to a predicate that only facts define: its clauses are not its meaning.
    let inline: Vec<bool> = predicates
        .map(|predicate| {
            let declared = &rules.predicates[predicate.index()];
            declared.inline && declared.derived && !is_visible(rules, predicate)
        })
        .collect();
    if !inline.contains(&true) {
        return None;
    }
    let mut unfolder = Unfolder {
        by_head: rules.clauses_by_head(),
        rules,
        meanings: vec![None; rules.predicates.len()],
    };
    // The checker refuses inline predicates that depend on themselves through inline ones only. So in the order of
    // strata, the meaning of a predicate contains no atom that is unfolded later, unless a cycle through others makes
    // them one stratum.
    for stratum in &rules.strata {
        let members: Vec<PredicateId> = stratum
            .predicates
            .iter()
            .copied()
            .filter(|id| inline[id.index()])
            .collect();
        let place: HashMap<PredicateId, usize> = members.iter().copied().zip(0..).collect();
        let used = |predicate: &PredicateId| -> Vec<usize> {
            let clauses = unfolder.by_head[predicate.index()].iter();
            let atoms = clauses.flat_map(|clause| &clause.body).filter_map(Literal::atom);
            atoms.filter_map(|atom| place.get(&atom.predicate).copied()).collect()
        };
        let used: Vec<Vec<usize>> = members.iter().map(used).collect();
        // A component comes after those that it uses.
        let (component, _) = components(&used);
        let mut order: Vec<usize> = (0..members.len()).collect();
        order.sort_by_key(|&member| component[member]);
        // The unfolding of predicates that use each other would have no end.
        let mut done = vec![false; members.len()];
        for member in order {
            if used[member].iter().all(|&other| done[other]) {
                done[member] = true;
                unfolder.define(members[member]);
            }
        }
    }
    let mut clauses: Vec<Clause> = Vec::new();
    for clause in &rules.clauses {
        match unfolder.expand(clause) {
            Some(expanded) => clauses.extend(expanded),
            None => clauses.push(clause.clone()),
        }
    }
    let used = used_by_others(rules, &clauses, &inline);
    clauses.retain(|clause| !inline[clause.head.predicate.index()] || used[clause.head.predicate.index()]);
    let mut out = Rules {
        clauses,
        ..rules.clone()
    };
    let mut kept = Vec::new();
    for (predicate, index) in (0..).map(PredicateId).zip(0..inline.len()) {
        if inline[index] {
            out.predicates[index].derived &= used[index];
            kept.extend(used[index].then_some(predicate));
        }
    }
    Some((restratified(out), kept))
}

/// Returns the inline predicates that a clause of another predicate, or of an inline one in use, still needs.
fn used_by_others(rules: &Rules, clauses: &[Clause], inline: &[bool]) -> Vec<bool> {
    let mut used = vec![false; rules.predicates.len()];
    let mut reads: Vec<Vec<PredicateId>> = vec![Vec::new(); rules.predicates.len()];
    let mut open: Vec<PredicateId> = Vec::new();
    for clause in clauses {
        let head = clause.head.predicate.index();
        let atoms = clause.body.iter().filter_map(Literal::atom).map(|atom| atom.predicate);
        let read = if inline[head] { &mut reads[head] } else { &mut open };
        read.extend(atoms.filter(|predicate| inline[predicate.index()]));
    }
    while let Some(predicate) = open.pop() {
        if !std::mem::replace(&mut used[predicate.index()], true) {
            open.append(&mut reads[predicate.index()]);
        }
    }
    used
}

struct Unfolder<'a> {
    rules: &'a Rules,
    /// By [`PredicateId`]: the clauses.
    by_head: Vec<Vec<&'a Clause>>,
    /// By [`PredicateId`]: the unfolded clauses of a predicate to unfold.
    meanings: Vec<Option<Vec<Clause>>>,
}

impl Unfolder<'_> {
    /// Unfolds the clauses of an inline predicate; their bodies replace its atoms from now on.
    fn define(&mut self, predicate: PredicateId) {
        let mut meaning = Vec::new();
        for clause in &self.by_head[predicate.index()] {
            match self.expand(clause) {
                Some(clauses) => meaning.extend(clauses),
                None => return,
            }
        }
        if meaning.len() <= MAX_CLAUSES {
            self.meanings[predicate.index()] = Some(meaning);
        }
    }

    /// Returns the clauses that a clause becomes; `None` if they would be too many or too long.
    fn expand(&self, clause: &Clause) -> Option<Vec<Clause>> {
        let mut open = vec![(clause.clone(), 0)];
        let mut done = Vec::new();
        while let Some((clause, from)) = open.pop() {
            let replaced = (from..clause.body.len()).find_map(|at| Some((at, self.replace(&clause, at)?)));
            match replaced {
                None => done.push(clause),
                Some((at, alternatives)) => open.extend(alternatives.into_iter().rev().map(|clause| (clause, at))),
            }
            let too_long = open.iter().any(|(clause, _)| clause.body.len() > MAX_LITERALS);
            if too_long || open.len() + done.len() > MAX_CLAUSES {
                return None;
            }
        }
        Some(done)
    }

    /// Returns the alternatives of a clause for the meanings of the literal at `at`; `None` if it stays.
    fn replace(&self, clause: &Clause, at: usize) -> Option<Vec<Clause>> {
        match &clause.body[at] {
            Literal::Positive(atom) => {
                let meaning = self.meanings[atom.predicate.index()].as_ref()?;
                Some(
                    meaning
                        .iter()
                        .filter_map(|meant| self.replace_positive(clause, at, atom, meant))
                        .collect(),
                )
            }
            Literal::Negative(atom) => {
                let meaning = self.meanings[atom.predicate.index()].as_ref()?;
                self.replace_negative(clause, at, atom, meaning)
            }
            _ => None,
        }
    }

    /// Returns the clause with the atom replaced by a body; `None` if constants differ.
    fn replace_positive(&self, clause: &Clause, at: usize, atom: &Atom, meant: &Clause) -> Option<Clause> {
        let mut out = clause.clone();
        let (mut terms, mut body) = self.unify(atom, meant)?;
        for (term, name) in terms.iter_mut().zip(&meant.variables) {
            term.get_or_insert_with(|| variable(&mut out, name));
        }
        for literal in &meant.body {
            let mut literal = literal.clone();
            // A literal binds a variable, never a constant.
            if let Literal::Compute { to, .. } | Literal::Aggregate { to, .. } = &mut literal
                && let Term::Variable(of) = *to
                && let Some(constant @ Term::Constant(_)) = terms[of.index()]
            {
                let fresh = variable(&mut out, &meant.variables[of.index()]);
                let base = self.base_of(meant, of);
                body.push(equal(fresh, constant, base, atom));
                *to = fresh;
                let others = match &mut literal {
                    Literal::Compute { arguments, .. } => arguments.iter_mut(),
                    Literal::Aggregate { atom, .. } => atom.terms.iter_mut(),
                    _ => unreachable!("it is one of these"),
                };
                others.for_each(|term| substitute(term, &terms));
            } else {
                literal.terms_mut().for_each(|term| substitute(term, &terms));
            }
            body.push(literal);
        }
        out.body.splice(at..=at, body);
        Some(out)
    }

    /// Returns the alternatives for a negated atom: for each clause of the meaning, some literal does not hold. `None`
    /// if a clause has variables that its head lacks or literals that cannot be negated.
    fn replace_negative(&self, clause: &Clause, at: usize, atom: &Atom, meaning: &[Clause]) -> Option<Vec<Clause>> {
        let mut bodies: Vec<Vec<Literal>> = vec![Vec::new()];
        for meant in meaning {
            let Some((terms, equalities)) = self.unify(atom, meant) else {
                continue;
            };
            let terms_are_known = terms
                .iter()
                .all(|term| matches!(term, Some(Term::Variable(_) | Term::Constant(_))));
            if !terms_are_known || atom.terms.contains(&Term::Wildcard) {
                return None;
            }
            // The equalities have variables of the clause, the body those of its meaning.
            let body = meant.body.iter().map(|literal| {
                let mut literal = literal.clone();
                literal.terms_mut().for_each(|term| substitute(term, &terms));
                literal
            });
            let choices: Vec<Literal> = equalities.into_iter().chain(body).map(negated).collect::<Option<_>>()?;
            if choices.len() * bodies.len() > MAX_CLAUSES {
                return None;
            }
            bodies = (bodies.iter())
                .flat_map(|body| {
                    choices
                        .iter()
                        .map(|choice| [body.as_slice(), std::slice::from_ref(choice)].concat())
                })
                .collect();
        }
        let with = |body: Vec<Literal>| {
            let mut out = clause.clone();
            out.body.splice(at..=at, body);
            out
        };
        Some(bodies.into_iter().map(with).collect())
    }

    /// Matches an atom with the head of a clause: the terms of its variables, as far as the atom gives them, and what
    /// must be equal besides. `None` if constants differ.
    fn unify(&self, atom: &Atom, meant: &Clause) -> Option<(Vec<Option<Term>>, Vec<Literal>)> {
        let mut terms: Vec<Option<Term>> = vec![None; meant.variables.len()];
        let mut equalities = Vec::new();
        let columns = &self.rules.predicates[atom.predicate.index()].columns;
        for ((&formal, &actual), column) in meant.head.terms.iter().zip(&atom.terms).zip(columns) {
            let known = match formal {
                _ if actual == Term::Wildcard => continue,
                Term::Variable(of) => match &mut terms[of.index()] {
                    Some(known) => *known,
                    unknown => {
                        *unknown = Some(actual);
                        continue;
                    }
                },
                other => other,
            };
            match (known, actual) {
                (Term::Constant(one), Term::Constant(other)) if one != other => return None,
                (one, other) if one == other => {}
                (one, other) => equalities.push(equal(one, other, column.base, atom)),
            }
        }
        Some((terms, equalities))
    }

    /// Returns the base type of a variable of the head.
    fn base_of(&self, clause: &Clause, of: VarId) -> BaseType {
        let mut terms = clause.head.terms.iter();
        let column = terms
            .position(|term| *term == Term::Variable(of))
            .expect("the head has it");
        self.rules.predicates[clause.head.predicate.index()].columns[column].base
    }
}

/// Adds a variable to a clause.
fn variable(clause: &mut Clause, name: &str) -> Term {
    let id = VarId(u32::try_from(clause.variables.len()).expect("few variables"));
    let mut name = name.to_owned();
    while clause.variables.contains(&name) {
        name.push('\'');
    }
    clause.variables.push(name);
    clause.variable_spans.push(clause.span);
    Term::Variable(id)
}

fn equal(left: Term, right: Term, base: BaseType, atom: &Atom) -> Literal {
    Literal::Compare {
        op: Comparison::Equal,
        left,
        right,
        base,
        span: atom.span,
    }
}

fn substitute(term: &mut Term, terms: &[Option<Term>]) {
    if let Term::Variable(of) = *term
        && let Some(known) = terms[of.index()]
    {
        *term = known;
    }
}

/// Returns the literal that holds if this one does not; `None` if it may have no value, or is no plain comparison.
fn negated(literal: Literal) -> Option<Literal> {
    match literal {
        Literal::Positive(atom) => Some(Literal::Negative(atom)),
        Literal::Negative(atom) => Some(Literal::Positive(atom)),
        Literal::Compare {
            op,
            left,
            right,
            base,
            span,
        } if base != BaseType::Float && is_order(op) => Some(Literal::Compare {
            op: op.opposite(),
            left,
            right,
            base,
            span,
        }),
        _ => None,
    }
}

fn is_order(op: Comparison) -> bool {
    use Comparison::{Equal, Greater, GreaterEqual, Less, LessEqual, NotEqual};
    matches!(op, Equal | NotEqual | Less | LessEqual | Greater | GreaterEqual)
}
