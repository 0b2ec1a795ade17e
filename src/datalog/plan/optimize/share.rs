//! Sub-bodies that several clauses share, computed once.
//!
//! ```text
//! P(x, y) :- R(x, y), S(y, z), S(z, x), !C(y).         +1(x, y) :- R(x, y), S(y, z), S(z, x).
//! Q(v, w) :- S(w, u), R(v, w), S(u, v), !D(v).    =>   P(x, y) :- +1(x, y), !C(y).
//!                                                      Q(v, w) :- +1(v, w), !D(v).
//! ```
//!
//! A hidden relation costs its rows, so few sub-bodies are worth one. A candidate is what the plans of several clauses *begin* with, up
//! to the names of variables and some tests: each of those clauses would go through all of it, restricted by no other atom. One of its
//! atoms has all the variables that are needed outside, so the hidden relation never has more rows than that atom's. Of the candidates, the
//! one is taken that saves most, where what is shared is counted once (its cost in a graph, not in a tree), then again among the rewritten
//! clauses, until nothing saves enough. The cost of a plan is judged by assumed sizes, since there are no rows yet; clauses are planned by
//! sizes later, and many a body that looks expensive is not, as it begins with few rows or ends at its first success.
//!
//! Only clauses of strata without recursion take part: elsewhere new rows lead a plan, and they differ from clause to clause.

use crate::datalog::check::{Atom, Clause, ClauseId, Column, Literal, RelId, Relation, Rules, Stratum, Term, VarId};
use crate::datalog::plan::estimate;
use crate::datalog::plan::estimate::Size;
use crate::datalog::plan::planner::Sketcher;
use crate::datalog::syntax::ast::{BaseType, Comparison};
use std::collections::{BTreeMap, BTreeSet};

/// No more hidden relations than this are made.
const SHARED_MAX: usize = 32;

/// Longer sub-bodies are not looked for.
const LITERALS_MAX: usize = 8;

/// Of the literals that only test what others bind, so many may be left out or not.
const TESTS_MAX: usize = 5;

/// So many orders of literals are tried to find the one that a sub-body is compared in.
const ORDERS_MAX: usize = 24;

/// So many candidates are weighed.
const CANDIDATES_MAX: usize = 512;

/// For that, so many rewritten clauses are planned.
const PLANS_MAX: usize = 20_000;

/// So many literals are written down to be compared.
const WORDS_MAX: usize = 1_000_000;

/// Sharing must make the clauses at least this much cheaper: a hidden relation has to be kept up to date too.
const SAVED_AT_LEAST: f64 = 0.25;

/// How many things there are taken to be.
const THINGS: f64 = 1000.0;

/// How many rows a relation with one column is taken to have, and one with more: where things are few of a kind, and where they are many.
/// Sharing must pay in both cases.
const ROWS: [[f64; 2]; 2] = [[100.0, 8_000.0], [350.0, 20_000.0]];

/// A number for each of the two cases.
type Both = [f64; 2];

/// A literal whose variables are numbered, so that equal ones are equal.
type Word = Vec<u64>;

/// Literals of a clause: the beginning of its plan, or a part that others have too.
pub(super) struct Use {
    pub(super) clause: usize,
    /// Positions in its body.
    pub(super) positions: Vec<usize>,
    /// By number: what stands there in the clause, a variable or a wildcard.
    terms: Vec<Term>,
    /// By number: whether the rest of the clause needs it.
    needed: Vec<bool>,
}

impl Use {
    /// The variables that some of the clauses need outside of the part, as this one names them; the one that its head is about first.
    pub(super) fn outside(&self, uses: &[Use], clause: &Clause) -> Vec<Term> {
        let needed = |number: &usize| uses.iter().any(|one| one.needed[*number]);
        let terms = (0..self.terms.len()).filter(needed).map(|number| self.terms[number]);
        let mut terms: Vec<Term> = terms.filter(|term| *term != Term::Wildcard).collect();
        terms.sort_by_key(|term| Some(term) != clause.head.terms.first());
        terms
    }
}

/// What may still be looked at: the search is bounded by numbers, not by time.
struct Left {
    candidates: usize,
    plans: usize,
    words: usize,
}

/// A sub-body, the clauses that would read it, and what that saves.
struct Candidate {
    hidden: Relation,
    clause: Clause,
    /// The clauses as they would be.
    rewritten: Vec<(usize, Clause)>,
    rows: Both,
    saved: f64,
}

/// Appends hidden relations and their clauses to the rules, each with a stratum of its own before the first that reads it.
pub(super) fn share(rules: &mut Rules) {
    let mut rows: Vec<Both> = rules.relations.iter().map(assumed).collect();
    let mut left = Left {
        candidates: CANDIDATES_MAX,
        plans: PLANS_MAX,
        words: WORDS_MAX,
    };
    let mut known = Known {
        costs: vec![[0.0; 2]; rules.clauses.len()],
        uses: BTreeMap::new(),
    };
    let mut changed: Vec<usize> = (rules.strata.iter())
        .filter(|stratum| !stratum.recursive)
        .flat_map(|stratum| stratum.clauses.iter().map(|clause| clause.index()))
        .collect();
    for number in 1..=SHARED_MAX {
        let mut sketcher = Sketcher::new(rules);
        let mut cases = [0, 1].map(|which| Case::new(rules, &rows, which));
        known.learn(rules, (&changed, number > 1), &cases, &mut sketcher, &mut left);
        let Some(best) = known.best(rules, number, &mut cases, &mut sketcher, &mut left) else {
            return;
        };
        let (relation, clause) = (RelId(rules.relations.len() as u32), rules.clauses.len());
        rules.relations.push(best.hidden);
        rules.clauses.push(best.clause);
        rows.push(best.rows);
        changed = best.rewritten.iter().map(|(index, _)| *index).collect();
        known.forget(&changed, rules.clauses.len());
        changed.push(clause);
        let mut reads = vec![false; rules.clauses.len()];
        for (index, rewritten) in best.rewritten {
            rules.clauses[index] = rewritten;
            reads[index] = true;
        }
        let asks = |stratum: &Stratum| stratum.clauses.iter().any(|clause| reads[clause.index()]);
        let first = rules.strata.iter().position(asks).unwrap_or(rules.strata.len());
        let stratum = Stratum {
            relations: vec![relation],
            clauses: vec![ClauseId(clause as u32)],
            recursive: false,
        };
        rules.strata.insert(first, stratum);
    }
}

fn assumed(relation: &Relation) -> Both {
    ROWS.map(|[one, more]| match relation.arity() {
        0 => 1.0,
        1 => one,
        _ => more,
    })
}

/// One of the two cases.
struct Case {
    rows: Vec<f64>,
    sizes: Vec<Option<Size>>,
}

impl Case {
    fn new(rules: &Rules, rows: &[Both], which: usize) -> Self {
        let mut case = Case {
            rows: Vec::with_capacity(rows.len() + 1),
            sizes: Vec::with_capacity(rows.len() + 1),
        };
        for (relation, rows) in rules.relations.iter().zip(rows) {
            case.add(rows[which], relation.arity());
        }
        case
    }

    fn add(&mut self, rows: f64, arity: usize) {
        self.rows.push(rows);
        self.sizes.push(Some(Size::even(rows, arity, THINGS)));
    }

    /// Keeps so many relations.
    fn forget_after(&mut self, relations: usize) {
        self.rows.truncate(relations);
        self.sizes.truncate(relations);
    }

    /// The plan of a clause, the order in which it comes to the literals, and about how many rows it looks at and derives.
    fn plan(&self, sketcher: &mut Sketcher, clause: &Clause) -> Option<(Vec<usize>, f64, f64)> {
        let (plan, order) = sketcher.plan(clause, &self.sizes)?;
        let found = |source, key: usize| self.rows[sketcher.relation(source).index()] / THINGS.powi(key as i32);
        let (looked_at, derived) = estimate::expected(&plan, &found);
        Some((order, looked_at, derived))
    }
}

/// What is known of the clauses as they are now; after a step only those that it changed are looked at again.
struct Known {
    /// By clause: about how many rows its plan looks at.
    costs: Vec<Both>,
    /// What plans begin with, up to names, and where. Uses by one clause stand together.
    uses: BTreeMap<Vec<Word>, Vec<Use>>,
}

impl Known {
    /// Plans these clauses. Parts that look like none of another of these clauses are left out, unless `all` are wanted: giving
    /// them their form takes longer than finding them.
    fn learn(
        &mut self,
        rules: &Rules,
        (clauses, all): (&[usize], bool),
        cases: &[Case; 2],
        sketcher: &mut Sketcher,
        left: &mut Left,
    ) {
        let mut parts: BTreeSet<(usize, Vec<usize>)> = BTreeSet::new();
        for &index in clauses {
            let clause = &rules.clauses[index];
            if atoms(&clause.body) < 2 {
                continue;
            }
            for (which, case) in cases.iter().enumerate() {
                let Some((order, looked_at, _)) = case.plan(sketcher, clause) else {
                    continue;
                };
                self.costs[index][which] = looked_at;
                parts.extend(
                    beginnings(clause, &order)
                        .into_iter()
                        .map(|positions| (index, positions)),
                );
            }
        }
        let looks = |(index, positions): &(usize, Vec<usize>)| {
            let literals = positions.iter().map(|&position| &rules.clauses[*index].body[position]);
            let mut looks: Vec<(u8, u32)> = literals.map(look).collect();
            looks.sort_unstable();
            looks
        };
        // By look: a clause that has such a part, and whether another has one too.
        let mut seen: BTreeMap<Vec<(u8, u32)>, (usize, bool)> = BTreeMap::new();
        for part in &parts {
            let (first, several) = seen.entry(looks(part)).or_insert((part.0, all));
            *several |= *first != part.0;
        }
        for part in parts {
            if !seen[&looks(&part)].1 {
                continue;
            }
            let (index, positions) = part;
            if let Some((key, found)) = beginning(index, &rules.clauses[index], positions, left) {
                self.uses.entry(key).or_default().push(found);
            }
        }
    }

    /// Makes room for a number of clauses, of which these are to be learnt again.
    fn forget(&mut self, changed: &[usize], clauses: usize) {
        self.costs.resize(clauses, [0.0; 2]);
        let mut is_changed = vec![false; clauses];
        for &index in changed {
            is_changed[index] = true;
            self.costs[index] = [0.0; 2];
        }
        self.uses.retain(|_, uses| {
            uses.retain(|one| !is_changed[one.clause]);
            !uses.is_empty()
        });
    }

    /// The candidate that saves most, if one saves enough.
    fn best(
        &self,
        rules: &Rules,
        number: usize,
        cases: &mut [Case; 2],
        sketcher: &mut Sketcher,
        left: &mut Left,
    ) -> Option<Candidate> {
        let mut best: Option<Candidate> = None;
        for uses in self.uses.values().filter(|uses| uses.len() > 1) {
            if left.candidates == 0 {
                break;
            }
            left.candidates -= 1;
            let Some(plans) = left.plans.checked_sub(uses.len()) else {
                continue;
            };
            left.plans = plans;
            let Some(candidate) = weigh(rules, uses, &self.costs, number, cases, sketcher) else {
                continue;
            };
            if best.as_ref().is_none_or(|best| candidate.saved > best.saved) {
                best = Some(candidate);
            }
        }
        best
    }
}

fn atoms<'a>(literals: impl IntoIterator<Item = &'a Literal>) -> usize {
    let positive = |literal: &&Literal| matches!(literal, Literal::Positive(_) | Literal::Guard(_));
    literals.into_iter().filter(positive).count()
}

/// What the plan begins with, in all lengths and with all choices of tests that may be worth sharing: positions in ascending order.
fn beginnings(clause: &Clause, order: &[usize]) -> Vec<Vec<usize>> {
    let mut found = Vec::new();
    let (mut leading, mut tests): (Vec<usize>, Vec<usize>) = (Vec::new(), Vec::new());
    let mut bound: Vec<Term> = Vec::new();
    for (place, &position) in order.iter().enumerate() {
        let literal = &clause.body[position];
        if matches!(literal, Literal::Compute { .. } | Literal::Aggregate { .. }) || leading.len() == LITERALS_MAX {
            break;
        }
        let variables = || literal.terms().filter(|term| matches!(term, Term::Variable(_)));
        if !leading.is_empty() && variables().all(|term| bound.contains(term)) {
            tests.push(position);
        } else {
            leading.push(position);
            bound.extend(variables());
        }
        let next = order.get(place + 1).map(|&position| &clause.body[position]);
        let binds = |next: &Literal| {
            next.terms()
                .any(|term| matches!(term, Term::Variable(_)) && !bound.contains(term))
        };
        if next.is_none_or(binds) {
            tests.truncate(TESTS_MAX);
            for chosen in 0..1_u32 << tests.len() {
                let chosen = tests.iter().enumerate().filter(|(bit, _)| chosen >> bit & 1 == 1);
                let positions = leading.iter().chain(chosen.map(|(_, position)| position));
                let mut positions: Vec<usize> = positions.copied().collect();
                positions.sort_unstable();
                if atoms(positions.iter().map(|&position| &clause.body[position])) >= 2 {
                    found.push(positions);
                }
            }
        }
    }
    found
}

/// What a literal looks like at first sight; equal ones look the same.
fn look(literal: &Literal) -> (u8, u32) {
    match literal {
        Literal::Positive(atom) | Literal::Guard(atom) => (0, atom.relation.0),
        Literal::Negative(atom) => (1, atom.relation.0),
        Literal::Aggregate { atom, .. } => (2, atom.relation.0),
        Literal::Compare { .. } => (3, 0),
        Literal::Compute { .. } => (4, 0),
    }
}

/// These literals of a clause, if they join two atoms.
fn beginning(index: usize, clause: &Clause, mut positions: Vec<usize>, left: &mut Left) -> Option<(Vec<Word>, Use)> {
    positions.sort_unstable();
    let part: Vec<&Literal> = positions.iter().map(|&position| &clause.body[position]).collect();
    if atoms(part.iter().copied()) < 2 || part.len() > LITERALS_MAX {
        return None;
    }
    let (key, terms) = canonical(&part, clause.variables.len(), left)?;
    let rest = (0..clause.body.len()).filter(|position| !positions.contains(position));
    let needed = needed(&terms, clause, rest);
    let found = Use {
        clause: index,
        positions,
        terms,
        needed,
    };
    Some((key, found))
}

/// By number: whether the head or one of these literals needs it.
fn needed(terms: &[Term], clause: &Clause, rest: impl Iterator<Item = usize>) -> Vec<bool> {
    let rest = rest.flat_map(|position| clause.body[position].terms());
    let outside: Vec<&Term> = clause.head.terms.iter().chain(rest).collect();
    let is_needed = |term: &Term| *term != Term::Wildcard && outside.contains(&term);
    terms.iter().map(is_needed).collect()
}

/// The rules with this sub-body shared, if that is worth it.
fn weigh(
    rules: &Rules,
    uses: &[Use],
    costs: &[Both],
    number: usize,
    cases: &mut [Case; 2],
    sketcher: &mut Sketcher,
) -> Option<Candidate> {
    let needed: Vec<usize> = (0..uses[0].terms.len())
        .filter(|&number| uses.iter().any(|one| one.needed[number]))
        .collect();
    let named = |one: &&Use| needed.iter().all(|&number| one.terms[number] != Term::Wildcard);
    let (hidden, clause) = hidden(rules, uses.iter().find(named)?, &needed, number)?;
    // No more rows than the atom has that knows all columns.
    let covers = |literal: &&Literal| {
        let known = |term: &Term| literal.terms().any(|other| other == term);
        matches!(literal, Literal::Positive(_)) && clause.head.terms.iter().all(known)
    };
    let covering: Vec<RelId> = (clause.body.iter().filter(covers))
        .filter_map(|literal| Some(literal.atom()?.relation))
        .collect();
    let relation = RelId(rules.relations.len() as u32);
    sketcher.declare(relation, hidden.arity());
    let shorter: Vec<Clause> = (uses.iter())
        .map(|one| rewrite(&rules.clauses[one.clause], one, relation, &needed))
        .collect();
    let mut found_in = [0.0; 2];
    let mut own_in = [0.0; 2];
    let mut cheaper_in = vec![[0.0; 2]; uses.len()];
    for (which, case) in cases.iter_mut().enumerate() {
        case.forget_after(rules.relations.len());
        let most = covering
            .iter()
            .map(|relation| case.rows[relation.index()])
            .reduce(f64::min)?;
        let (_, own, found) = case.plan(sketcher, &clause)?;
        (own_in[which], found_in[which]) = (own, found.min(most));
        case.add(found_in[which], hidden.arity());
        for (cheaper, shorter) in cheaper_in.iter_mut().zip(&shorter) {
            cheaper[which] = case.plan(sketcher, shorter)?.1;
        }
    }
    let gains = |position: &usize| {
        [0, 1]
            .iter()
            .all(|&which| cheaper_in[*position][which] < costs[uses[*position].clause][which])
    };
    let rewritten: Vec<usize> = (0..uses.len()).filter(gains).collect();
    // What is saved, as a share of what it took.
    let saved = [0, 1].map(|which| {
        let before: f64 = rewritten
            .iter()
            .map(|&position| costs[uses[position].clause][which])
            .sum();
        let after: f64 = rewritten.iter().map(|&position| cheaper_in[position][which]).sum();
        (before - after - own_in[which] - found_in[which], before)
    });
    let pays = saved.iter().all(|(saved, before)| *saved >= SAVED_AT_LEAST * before);
    (rewritten.len() > 1 && pays).then(|| Candidate {
        hidden,
        clause,
        rewritten: (rewritten.iter())
            .map(|&position| (uses[position].clause, shorter[position].clone()))
            .collect(),
        rows: found_in,
        saved: saved[0].0,
    })
}

/// The hidden relation with the needed variables as columns, and its clause.
fn hidden(rules: &Rules, model: &Use, needed: &[usize], number: usize) -> Option<(Relation, Clause)> {
    let clause = &rules.clauses[model.clause];
    let body: Vec<Literal> = (model.positions.iter())
        .map(|&position| match &clause.body[position] {
            Literal::Guard(atom) => Literal::Positive(atom.clone()),
            other => other.clone(),
        })
        .collect();
    let mut columns = Vec::new();
    for &number in needed {
        columns.push(column(rules, &body, &model.terms[number])?.clone());
    }
    let terms = needed.iter().map(|&number| model.terms[number]).collect();
    let relation = Relation::made(format!("+shared {number}"), columns, String::new(), clause.span);
    let head = Atom {
        relation: RelId(rules.relations.len() as u32),
        terms,
        span: clause.span,
    };
    let clause = Clause {
        head,
        body,
        variables: clause.variables.clone(),
        doc: String::new(),
        span: clause.span,
    };
    Some((relation, clause))
}

/// A column of an atom in which the variable stands.
fn column<'a>(rules: &'a Rules, body: &[Literal], variable: &Term) -> Option<&'a Column> {
    body.iter().find_map(|literal| match literal {
        Literal::Positive(atom) => {
            let position = atom.terms.iter().position(|term| term == variable)?;
            rules.relations[atom.relation.index()].columns.get(position)
        }
        _ => None,
    })
}

/// The clause with the hidden atom in place of what it stands for.
fn rewrite(clause: &Clause, one: &Use, relation: RelId, needed: &[usize]) -> Clause {
    let atom = Atom {
        relation,
        terms: needed
            .iter()
            .map(|&number| match one.needed[number] {
                true => one.terms[number],
                false => Term::Wildcard,
            })
            .collect(),
        span: clause.span,
    };
    let rest = clause.body.iter().enumerate();
    let rest = rest.filter(|(position, _)| !one.positions.contains(position));
    let body = [Literal::Positive(atom)]
        .into_iter()
        .chain(rest.map(|(_, literal)| literal.clone()));
    Clause {
        body: body.collect(),
        ..clause.clone()
    }
}

// --- for the author

/// A part is worth a name if it has so many literals and stands in so many clauses.
const WORTH_A_NAME: usize = 3;

/// Clauses with more written literals are not looked at.
const WRITTEN_MAX: usize = 10;

/// Parts of bodies that stand in several clauses, those first that say most; no clause is in two. All literals of a part were written,
/// and it joins two atoms. Under a scope it speaks of the agent that the clause is about: a predicate of its own then sees the same.
/// Beside them whether all bodies were looked at.
pub(super) fn repeated(rules: &Rules) -> (Vec<Vec<Use>>, bool) {
    let mut left = Left {
        candidates: 0,
        plans: 0,
        words: WORDS_MAX,
    };
    let mut parts: BTreeMap<Vec<Word>, Vec<Use>> = BTreeMap::new();
    for (index, clause) in rules.clauses.iter().enumerate() {
        let hidden = rules.relations[clause.head.relation.index()].hidden;
        let can = |literal: &Literal| match literal {
            Literal::Positive(atom) | Literal::Negative(atom) => !rules.relations[atom.relation.index()].hidden,
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
            if positions.len() < WORTH_A_NAME || !is_joined(clause, &positions) {
                continue;
            }
            let Some((mut key, mut part)) = beginning(index, clause, positions, &mut left) else {
                continue;
            };
            // A predicate of its own has guards of its own.
            let guard = |position: &usize| matches!(clause.body[*position], Literal::Guard(_));
            let rest = (0..clause.body.len()).filter(|position| !part.positions.contains(position) && !guard(position));
            part.needed = needed(&part.terms, clause, rest);
            if scoped {
                let agent = part
                    .terms
                    .iter()
                    .position(|term| Some(term) == clause.head.terms.first());
                let Some(agent) = agent else { continue };
                key.push(vec![agent as u64]);
            }
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
    (found, left.words > 0)
}

/// Whether the literals hang together by variables, all of which its positive atoms bind.
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

// --- equal up to names

/// The literals in an order and with numbers for variables that depend neither on their order nor on their names, and what each number
/// stands for. Literals with many symmetries may be given several forms; then something is not shared that could be. `None` if it would
/// take too long.
fn canonical(literals: &[&Literal], variables: usize, left: &mut Left) -> Option<(Vec<Word>, Vec<Term>)> {
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
    search.best.filter(|_| search.left.words > 0)
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
    left: &'a mut Left,
    best: Option<(Vec<Word>, Vec<Term>)>,
}

impl Naming<'_> {
    /// The least literal comes next; of several that look the same, each in turn.
    fn go(&mut self, names: Names, words: &mut Vec<Word>, placed: &mut [bool]) {
        self.left.words = self.left.words.saturating_sub(self.literals.len() - words.len());
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
            if word == least && self.left.words > 0 && (self.orders < ORDERS_MAX || self.best.is_none()) {
                placed[at] = true;
                words.push(word);
                self.go(names, words, placed);
                words.pop();
                placed[at] = false;
            }
        }
    }
}

/// The literal in numbers; variables that are new get the next ones.
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
            [u64::from(!positive), u64::from(atom.relation.0)]
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
    BaseType::ALL.iter().position(|other| *other == base).unwrap_or(0) as u64
}
