//! Finds parts of bodies that several clauses share and that could become a predicate.
//!
//! ```text
//! P(x) :- Car(x), Near(x, y), Walker(y), Slow(x).        Name(x, y) :- Car(x), Near(x, y), Walker(y).
//! Q(v) :- Near(v, w), Car(v), Walker(w), Wet(v).    =>   P(x) :- Name(x, y), Slow(x).
//! R(x) :- Walker(z), Car(x), Near(x, z), Old(z).         Q(v) :- Name(v, w), Wet(v).  R(x) :- Name(x, z), Old(z).
//! ```

use crate::check::{Clause, Literal, Rules, Term, VarId};
use crate::syntax::ast::{BaseType, Comparison};
use std::collections::BTreeMap;

/// The maximum number of literals of a part.
const LITERALS_MAX: usize = 8;

/// The maximum number of literal orders tried to find the canonical form of a part.
const ORDERS_MAX: usize = 24;

/// The maximum number of literals that all comparisons together encode.
const WORDS_MAX: usize = 1_000_000;

/// A literal with numbered variables, so that equal literals have equal encodings.
type Word = Vec<u64>;

/// One occurrence of a shared part in a clause.
pub(super) struct Use {
    pub(super) clause: usize,
    /// Positions in the clause's body.
    pub(super) positions: Vec<usize>,
    /// Indexed by number: the clause's variable or wildcard.
    terms: Vec<Term>,
    /// Indexed by number: whether the rest of the clause uses it.
    needed: Vec<bool>,
}

impl Use {
    /// The variables of the part that some clause uses outside of it, by their names in this clause. The first variable
    /// of the head comes first.
    pub(super) fn outside(&self, uses: &[Use], clause: &Clause) -> Vec<Term> {
        let needed = |number: &usize| uses.iter().any(|one| one.needed[*number]);
        let terms = (0..self.terms.len()).filter(needed).map(|number| self.terms[number]);
        let mut terms: Vec<Term> = terms.filter(|term| *term != Term::Wildcard).collect();
        terms.sort_by_key(|term| Some(term) != clause.head.terms.first());
        terms
    }
}

/// The minimum number of literals in a part and of clauses that share it.
const WORTH_A_NAME: usize = 3;

/// The search skips clauses with more written literals.
const WRITTEN_MAX: usize = 10;

/// Returns the parts that several bodies share, largest saving first, and whether the search covered all bodies.
///
/// A part consists of written literals and joins at least two atoms. No clause is in two parts. In a scoped clause, the
/// part must contain the first variable of the head, so that a separate predicate has the same scope.
pub(super) fn repeated(rules: &Rules) -> (Vec<Vec<Use>>, bool) {
    let mut left = WORDS_MAX;
    let mut parts: BTreeMap<Vec<Word>, Vec<Use>> = BTreeMap::new();
    for (index, clause) in rules.clauses.iter().enumerate() {
        let hidden = rules.predicates[clause.head.predicate.index()].hidden;
        let can = |literal: &Literal| match literal {
            Literal::Positive(atom) | Literal::Negative(atom) => !rules.predicates[atom.predicate.index()].hidden,
            Literal::Compare { .. } => true,
            _ => false,
        };
        let written: Vec<usize> = (0..clause.body.len()).filter(|&at| can(&clause.body[at])).collect();
        if hidden || written.len() > WRITTEN_MAX {
            continue;
        }
        let scoped = clause.body.iter().any(|literal| matches!(literal, Literal::Guard(_)));
        for chosen in 0..1_u32 << written.len() {
            let positions = written.iter().zip(0..).filter(|(_, bit)| chosen >> bit & 1 == 1);
            let positions: Vec<usize> = positions.map(|(&position, _)| position).collect();
            if !worth_a_name(clause, &positions) {
                continue;
            }
            let literals: Vec<&Literal> = positions.iter().map(|&position| &clause.body[position]).collect();
            let Some((mut key, terms)) = canonical(&literals, clause.variables.len(), &mut left) else {
                continue;
            };
            if scoped {
                let agent = terms.iter().position(|term| Some(term) == clause.head.terms.first());
                let Some(agent) = agent else { continue };
                key.push(vec![agent as u64]);
            }
            // A separate predicate has its own guards.
            let guard = |position: &usize| matches!(clause.body[*position], Literal::Guard(_));
            let rest = (0..clause.body.len()).filter(|position| !positions.contains(position) && !guard(position));
            let part = Use {
                clause: index,
                needed: needed(&terms, clause, rest),
                positions,
                terms,
            };
            parts.entry(key).or_default().push(part);
        }
    }
    let mut parts: Vec<Vec<Use>> = parts.into_values().filter(|uses| uses.len() >= WORTH_A_NAME).collect();
    parts.sort_by_key(|uses| std::cmp::Reverse(uses[0].positions.len() * uses.len()));
    let mut taken = vec![false; rules.clauses.len()];
    let mut found = Vec::new();
    for mut uses in parts {
        uses.retain(|one| !taken[one.clause]);
        uses.dedup_by_key(|one| one.clause);
        if uses.len() >= WORTH_A_NAME {
            uses.iter().for_each(|one| taken[one.clause] = true);
            found.push(uses);
        }
    }
    (found, left > 0)
}

fn worth_a_name(clause: &Clause, positions: &[usize]) -> bool {
    let atom = |position: &&usize| matches!(clause.body[**position], Literal::Positive(_));
    (WORTH_A_NAME..=LITERALS_MAX).contains(&positions.len())
        && positions.iter().filter(atom).count() >= 2
        && is_joined(clause, positions)
}

/// Indexed by number: whether the head or one of the literals `rest` uses it.
fn needed(terms: &[Term], clause: &Clause, rest: impl Iterator<Item = usize>) -> Vec<bool> {
    let rest = rest.flat_map(|position| clause.body[position].terms());
    let outside: Vec<&Term> = clause.head.terms.iter().chain(rest).collect();
    let is_needed = |term: &Term| *term != Term::Wildcard && outside.contains(&term);
    terms.iter().map(is_needed).collect()
}

/// Whether shared variables connect all literals, and the positive atoms bind every variable.
fn is_joined(clause: &Clause, positions: &[usize]) -> bool {
    let variables = |position: usize| {
        let terms = clause.body[position].terms();
        terms
            .filter(|term| matches!(term, Term::Variable(_)))
            .collect::<Vec<_>>()
    };
    let positive = |&&position: &&usize| matches!(clause.body[position], Literal::Positive(_));
    let bound: Vec<&Term> = positions
        .iter()
        .filter(positive)
        .flat_map(|&position| variables(position))
        .collect();
    let mut rest: Vec<usize> = positions[1..].to_vec();
    let mut reached = variables(positions[0]);
    while let Some(at) = (rest.iter()).position(|&one| variables(one).iter().any(|term| reached.contains(term))) {
        reached.extend(variables(rest.remove(at)));
    }
    rest.is_empty() && reached.iter().all(|term| bound.contains(term))
}

// --- equality up to renaming

/// Returns a canonical form of the literals and the term of each number. The form does not depend on the order of the
/// literals or on the names of variables. Highly symmetric literals may get several forms, so that the search can miss
/// a shared part. `None` if the search exceeds its limit.
fn canonical(literals: &[&Literal], variables: usize, left: &mut usize) -> Option<(Vec<Word>, Vec<Term>)> {
    let mut search = Naming {
        literals,
        orders: 0,
        left,
        best: None,
    };
    let start = Names {
        numbers: vec![None; variables],
        terms: Vec::new(),
    };
    search.go(start, &mut Vec::new(), &mut vec![false; literals.len()]);
    search.best.filter(|_| *search.left > 0)
}

/// Variables numbered so far.
#[derive(Clone)]
struct Names {
    numbers: Vec<Option<u64>>,
    terms: Vec<Term>,
}

struct Naming<'a> {
    literals: &'a [&'a Literal],
    orders: usize,
    left: &'a mut usize,
    best: Option<(Vec<Word>, Vec<Term>)>,
}

impl Naming<'_> {
    /// Places the least literal next; if several have the same encoding, tries each in turn.
    fn go(&mut self, names: Names, words: &mut Vec<Word>, placed: &mut [bool]) {
        *self.left = self.left.saturating_sub(self.literals.len() - words.len());
        let next: Vec<(Word, Names, usize)> = (0..self.literals.len())
            .filter(|&at| !placed[at])
            .map(|at| {
                let mut names = names.clone();
                (word(self.literals[at], &mut names), names, at)
            })
            .collect();
        let Some(least) = next.iter().map(|(word, ..)| word.clone()).min() else {
            self.orders += 1;
            if self.best.as_ref().is_none_or(|(best, _)| *words < *best) {
                self.best = Some((words.clone(), names.terms));
            }
            return;
        };
        for (word, names, at) in next {
            if word == least && *self.left > 0 && (self.orders < ORDERS_MAX || self.best.is_none()) {
                placed[at] = true;
                words.push(word);
                self.go(names, words, placed);
                words.pop();
                placed[at] = false;
            }
        }
    }
}

/// Encodes a literal; new variables get the next numbers.
fn word(literal: &Literal, names: &mut Names) -> Word {
    let mut term = |term: &Term, positive: bool| -> [u64; 2] {
        match *term {
            Term::Constant(value) => [0, u64::from(value.0)],
            Term::Wildcard if !positive => [1, 0],
            Term::Wildcard => {
                names.terms.push(Term::Wildcard);
                [2, names.terms.len() as u64 - 1]
            }
            Term::Variable(VarId(id)) => {
                let new = names.terms.len() as u64;
                let number = *names.numbers[id as usize].get_or_insert(new);
                if number == new {
                    names.terms.push(Term::Variable(VarId(id)));
                }
                [2, number]
            }
        }
    };
    match literal {
        Literal::Positive(atom) | Literal::Guard(atom) | Literal::Negative(atom) | Literal::Aggregate { atom, .. } => {
            let positive = !matches!(literal, Literal::Negative(_));
            let terms = atom.terms.iter().flat_map(|one| term(one, positive));
            [u64::from(!positive), u64::from(atom.predicate.0)]
                .into_iter()
                .chain(terms)
                .collect()
        }
        Literal::Compare {
            op, left, right, base, ..
        } => {
            let (op, left, right) = match op {
                Comparison::Greater => (Comparison::Less, right, left),
                Comparison::GreaterEqual => (Comparison::LessEqual, right, left),
                other => (*other, left, right),
            };
            let sides = [term(left, false), term(right, false)].concat();
            [2, op as u64, base_number(*base)].into_iter().chain(sides).collect()
        }
        Literal::Compute { .. } => Vec::new(),
    }
}

fn base_number(base: BaseType) -> u64 {
    BaseType::ALL
        .iter()
        .position(|other| *other == base)
        .unwrap_or(BaseType::ALL.len()) as u64
}
