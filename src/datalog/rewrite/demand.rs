//! Restricts predicates to the rows that the outputs need: the magic-set transformation.
//!
//! ```text
//! .output From_a                                +demand Path(x) says which first columns are needed:
//! Path(x, y) :- Edge(x, y).                     +Path(x, y) :- +demand Path(x), Edge(x, y).
//! Path(x, z) :- Edge(x, y), Path(y, z).         +Path(x, z) :- +demand Path(x), Edge(x, y), +Path(y, z).
//! From_a(y) :- Path("a", y).                    From_a(y) :- +Path("a", y).
//!                                               +demand Path("a").
//!                                               +demand Path(y) :- +demand Path(x), Edge(x, y).
//! ```
//!
//! Each atom of a clause is visited in an order in which bound variables come early. The positions that are bound there
//! are the atom's *adornment*. Each adornment of a predicate has a copy of its clauses, and a demand predicate.
//!
//! What a clause negates or aggregates must be complete. So these predicates and all that they depend on stay as they
//! are, and nothing that is complete depends on a demand: the program stays stratified.

use crate::check::{Atom, Clause, Literal, Predicate, PredicateId, Rules, Term, restratified};
use crate::rewrite::is_visible;
use crate::syntax::ast::Comparison;
use std::collections::{BTreeMap, BTreeSet};

/// The maximum number of copies of one predicate. A predicate with more is computed in full.
const MAX_COPIES: usize = 8;

/// For each column, whether it is bound.
type Adornment = Vec<bool>;

/// Returns the rules with the predicates that are marked `magic` restricted to the rows that the visible ones need.
/// `None` if none can be restricted.
pub fn demand(rules: &Rules) -> Option<Rules> {
    if !rules.predicates.iter().any(|predicate| predicate.magic) {
        return None;
    }
    restrict(rules, |predicate| rules.predicates[predicate.index()].magic)
}

/// Returns whether marking predicates `magic` would restrict one of them. Returns false for programs with many clauses.
pub fn would_restrict(rules: &Rules) -> bool {
    const MAX_CLAUSES: usize = 10_000;
    rules.clauses.len() <= MAX_CLAUSES
        && restrict(rules, |predicate| !rules.predicates[predicate.index()].hidden).is_some()
}

fn restrict(rules: &Rules, wanted: impl Fn(PredicateId) -> bool) -> Option<Rules> {
    let mut full = complete(rules);
    for predicate in (0..).map(PredicateId).take(rules.predicates.len()) {
        // Rows can be added to a predicate that only facts define: a copy would lack them.
        let derived = rules.predicates[predicate.index()].derived;
        full[predicate.index()] |= !derived || !wanted(predicate) || is_visible(rules, predicate);
    }
    // Finds out which predicates are needed in full before it makes any clause.
    loop {
        let mut transformer = Transformer::new(rules, &full);
        transformer.all();
        if transformer.in_full.is_empty() {
            return (!transformer.copies.is_empty()).then(|| restratified(transformer.out));
        }
        for predicate in transformer.in_full {
            full[predicate.index()] = true;
        }
    }
}

/// Returns the predicates that must be complete: what clauses negate or aggregate or a guard reads, whose rows depend
/// on rounds, and all that these depend on.
fn complete(rules: &Rules) -> Vec<bool> {
    let mut complete = vec![false; rules.predicates.len()];
    for literal in rules.clauses.iter().flat_map(|clause| &clause.body) {
        if let Literal::Negative(atom) | Literal::Aggregate { atom, .. } | Literal::Guard(atom) = literal {
            complete[atom.predicate.index()] = true;
        }
    }
    for (predicate, complete) in rules.predicates.iter().zip(&mut complete) {
        *complete |= predicate.depends_on_rounds();
    }
    let by_head = rules.clauses_by_head();
    let mut open: Vec<usize> = (0..complete.len()).filter(|&predicate| complete[predicate]).collect();
    while let Some(predicate) = open.pop() {
        let literals = by_head[predicate].iter().flat_map(|clause| &clause.body);
        for read in literals.filter_map(Literal::atom).map(|atom| atom.predicate.index()) {
            if !std::mem::replace(&mut complete[read], true) {
                open.push(read);
            }
        }
    }
    complete
}

struct Transformer<'a> {
    rules: &'a Rules,
    /// By [`PredicateId`]: whether the predicate is computed in full.
    full: &'a [bool],
    /// The predicates that must be computed in full as well.
    in_full: BTreeSet<PredicateId>,
    /// The copy of each predicate for each adornment, and its demand.
    copies: BTreeMap<(PredicateId, Adornment), (PredicateId, PredicateId)>,
    /// The copies whose clauses are to be made.
    waiting: Vec<(PredicateId, Adornment)>,
    out: Rules,
}

impl<'a> Transformer<'a> {
    fn new(rules: &'a Rules, full: &'a [bool]) -> Self {
        Transformer {
            rules,
            full,
            in_full: BTreeSet::new(),
            copies: BTreeMap::new(),
            waiting: Vec::new(),
            out: Rules {
                clauses: Vec::new(),
                ..rules.clone()
            },
        }
    }

    fn all(&mut self) {
        let needs_complete = complete(self.rules);
        for clause in &self.rules.clauses {
            let head = clause.head.predicate.index();
            if needs_complete[head] {
                self.out.clauses.push(clause.clone());
            } else if self.full[head] {
                self.clause(clause, None);
            }
        }
        let by_head = self.rules.clauses_by_head();
        while let Some((predicate, adornment)) = self.waiting.pop() {
            for clause in &by_head[predicate.index()] {
                self.clause(clause, Some(&adornment));
            }
        }
        // A copy takes the place of the predicate itself, and a demand may consist of facts.
        let mut derived = vec![false; self.out.predicates.len()];
        for clause in self.out.clauses.iter().filter(|clause| !clause.body.is_empty()) {
            derived[clause.head.predicate.index()] = true;
        }
        for (predicate, derived) in self.out.predicates.iter_mut().zip(derived) {
            predicate.derived = derived || predicate.derived && predicate.depends_on_rounds();
        }
    }

    /// Adds the clause for an adornment of its head, and the clauses of the demands of its body.
    fn clause(&mut self, clause: &Clause, adornment: Option<&Adornment>) {
        let mut out = clause.clone();
        let mut bound = vec![false; clause.variables.len()];
        // The literals that hold where a demand arises.
        let mut before: Vec<Literal> = Vec::new();
        if let Some(adornment) = adornment {
            let (copy, demand) = self.copies[&(clause.head.predicate, adornment.clone())];
            out.head.predicate = copy;
            let guard = Atom {
                predicate: demand,
                terms: selected(&clause.head.terms, adornment),
                span: clause.head.span,
            };
            bind(&mut bound, &guard.terms);
            before.push(Literal::Positive(guard.clone()));
            out.body.insert(0, Literal::Positive(guard));
        }
        let offset = out.body.len() - clause.body.len();
        let mut rest: Vec<usize> = (0..clause.body.len()).collect();
        loop {
            settle(clause, &mut rest, &mut bound, &mut before);
            let bound_in = |atom: &Atom| atom.terms.iter().filter(|term| is_bound(term, &bound)).count();
            let next = (rest.iter().copied())
                .filter_map(|at| match &clause.body[at] {
                    Literal::Positive(atom) => Some((at, atom)),
                    _ => None,
                })
                .max_by_key(|&(at, atom)| {
                    let many = bound_in(atom);
                    (many > 0, self.full[atom.predicate.index()], many, std::cmp::Reverse(at))
                });
            let Some((at, atom)) = next else { break };
            rest.retain(|&other| other != at);
            let mut atom = atom.clone();
            if !self.full[atom.predicate.index()] {
                let adornment: Adornment = atom.terms.iter().map(|term| is_bound(term, &bound)).collect();
                if let Some((copy, demand)) = self.copy(atom.predicate, &adornment) {
                    let head = Atom {
                        predicate: demand,
                        terms: selected(&atom.terms, &adornment),
                        span: atom.span,
                    };
                    let is_head = |literal: &Literal| match literal {
                        Literal::Positive(atom) => (atom.predicate, &atom.terms) == (head.predicate, &head.terms),
                        _ => false,
                    };
                    if !before.iter().any(is_head) {
                        self.out.clauses.push(Clause {
                            head,
                            body: before.clone(),
                            variables: clause.variables.clone(),
                            variable_spans: clause.variable_spans.clone(),
                            doc: String::new(),
                            span: clause.span,
                        });
                    }
                    atom.predicate = copy;
                }
            }
            bind(&mut bound, &atom.terms);
            out.body[at + offset] = Literal::Positive(atom.clone());
            before.push(Literal::Positive(atom));
        }
        self.out.clauses.push(out);
    }

    /// Returns the copy of a predicate and its demand; `None` if the predicate is needed in full.
    fn copy(&mut self, predicate: PredicateId, adornment: &Adornment) -> Option<(PredicateId, PredicateId)> {
        let key = (predicate, adornment.clone());
        if let Some(&known) = self.copies.get(&key) {
            return Some(known);
        }
        let others = self.copies.keys().filter(|(of, _)| *of == predicate).count();
        if !adornment.contains(&true) || others >= MAX_COPIES {
            self.in_full.insert(predicate);
            return None;
        }
        let Predicate {
            name, columns, span, ..
        } = self.rules.predicates[predicate.index()].clone();
        let letters: String = adornment.iter().map(|&bound| if bound { 'b' } else { 'f' }).collect();
        let wanted = columns
            .iter()
            .zip(adornment)
            .filter(|(_, bound)| **bound)
            .map(|(column, _)| column.clone());
        let demand = Predicate::made(
            format!("+demand {name}.{letters}"),
            wanted.collect(),
            format!("the arguments for which `{name}` is needed"),
            span,
        );
        let copy = Predicate::made(
            format!("+{name}.{letters}"),
            columns,
            format!("`{name}` as far as it is needed"),
            span,
        );
        let mut add = |predicate: Predicate| {
            self.out.predicates.push(predicate);
            PredicateId(u32::try_from(self.out.predicates.len() - 1).expect("fewer than 2^32 predicates"))
        };
        let made = (add(copy), add(demand));
        self.copies.insert(key.clone(), made);
        self.waiting.push(key);
        Some(made)
    }
}

/// Moves to `before` the comparisons and computations whose variables are bound, and binds what equals a bound
/// variable. A computed value is not bound: demands are values of rows and constants, so they are finitely many.
fn settle(clause: &Clause, rest: &mut Vec<usize>, bound: &mut [bool], before: &mut Vec<Literal>) {
    loop {
        let ready = rest.iter().position(|&at| match &clause.body[at] {
            Literal::Compare { op, left, right, .. } => {
                let known = [left, right].map(|term| is_bound(term, bound));
                known == [true; 2] || *op == Comparison::Equal && known != [false; 2]
            }
            Literal::Compute { .. } => clause.body[at].terms().all(|term| is_bound(term, bound)),
            _ => false,
        });
        let Some(ready) = ready else { return };
        let literal = clause.body[rest.remove(ready)].clone();
        literal.terms().for_each(|term| bind(bound, std::slice::from_ref(term)));
        before.push(literal);
    }
}

fn is_bound(term: &Term, bound: &[bool]) -> bool {
    match term {
        Term::Variable(of) => bound[of.index()],
        Term::Constant(_) => true,
        Term::Wildcard => false,
    }
}

fn bind(bound: &mut [bool], terms: &[Term]) {
    for term in terms {
        if let Term::Variable(of) = term {
            bound[of.index()] = true;
        }
    }
}

/// Returns the terms at the bound positions.
fn selected(terms: &[Term], adornment: &Adornment) -> Vec<Term> {
    terms
        .iter()
        .zip(adornment)
        .filter(|(_, bound)| **bound)
        .map(|(term, _)| *term)
        .collect()
}
