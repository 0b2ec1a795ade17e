//! Divides rules between the executors: what the dense executor does not support, the relational one derives first.
//!
//! ```text
//! Slow(X) :- IsCar(X), Not(Stop(X)), n = count : { Near(X, _) }, m = count : { Sees(X, _) }, n * 2 > m.
//!
//! dense:       Slow(X) :- IsCar(X), Not(Stop(X)), +handed(X).
//! relational:  +handed(X) :- IsCar(X), n = count : { Near(X, _) }, m = count : { Sees(X, _) }, n * 2 > m.
//! ```
//!
//! The relational executor derives the unsupported literals of a clause if the rest shares at most two variables with
//! them, otherwise the whole clause. It derives recursive strata, and the dense executor reads all their rows.
//! Predicates that both read are derived twice.

use crate::check::{
    Atom, Clause, ClauseId, Column, Literal, Predicate, PredicateId, Rules, Stratum, Term, VarId, bind_all,
};
use crate::dense::analyze::{Unsupported, obstacle, obstacles, obstacles_in, unfit_shape, unsupported_literals};
use crate::dense::condition::Lifted;
use crate::diag::Span;
use crate::syntax::ast::BaseType;

/// Rules divided between the executors.
#[derive(Clone, Debug)]
pub struct Division {
    /// The rules of the dense executor. Clauses have the positions that they had before; strata that contribute nothing
    /// to the wanted predicates are missing.
    pub dense: Rules,
    /// What the relational executor derives first; `None` if nothing.
    pub handed: Option<Handed>,
}

/// The rules whose rows the dense executor reads as facts.
#[derive(Clone, Debug)]
pub struct Handed {
    /// The rules of the relational executor, with the predicates of the dense ones.
    pub rules: Rules,
    /// The clauses that are handed over as a whole, sorted, each with its position here.
    pub clauses: Vec<(ClauseId, ClauseId)>,
    /// The hidden predicates that the dense executor reads, each with the predicate that has its rows here.
    pub predicates: Vec<(PredicateId, PredicateId)>,
    /// The predicates that the rules read, sorted.
    pub read: Vec<PredicateId>,
    /// Why the dense executor does not evaluate them, in the order of strata.
    pub reasons: Vec<Unsupported>,
}

/// The executor of a stratum.
enum StratumExecutor {
    /// The dense executor, except for these clauses.
    Dense(Vec<ClauseId>),
    /// The relational executor, since the stratum is recursive; the dense one reads its rows.
    Read,
    /// The relational executor. The dense one cannot store the predicates.
    Hidden,
}

/// Divides rules, of which `lifted` are those with conditions. `wanted` selects the predicates that the dense executor
/// must derive, and `counted` further ones that one of the executors must derive.
///
/// Returns `None` if the dense executor cannot store a predicate that is wanted.
pub fn divide(
    rules: &Rules,
    lifted: &Lifted,
    wanted: impl Fn(PredicateId) -> bool,
    counted: impl Fn(PredicateId) -> bool,
) -> Option<Division> {
    let part = |stratum: &Stratum| {
        let mut predicates = stratum.predicates.iter();
        match predicates.any(|predicate| unfit_shape(&lifted.rules, *predicate).is_some()) {
            true => StratumExecutor::Hidden,
            false if stratum.recursive => StratumExecutor::Read,
            false => {
                let reasons = obstacles_in(&lifted.rules, stratum).into_iter();
                StratumExecutor::Dense(reasons.map(|reason| reason.clause).collect())
            }
        }
    };
    let parts: Vec<StratumExecutor> = lifted.rules.strata.iter().map(part).collect();
    let is_whole = |part: &StratumExecutor| matches!(part, StratumExecutor::Dense(handed) if handed.is_empty());
    if parts.iter().all(is_whole) {
        return Some(Division {
            dense: lifted.rules.clone(),
            handed: None,
        });
    }

    let mut divider = Divider::new(rules, lifted);
    let mut is_kept = vec![false; parts.len()];
    let predicates = (0..lifted.rules.predicates.len()).map(|index| PredicateId(number_of(index)));
    let mut is_needed: Vec<bool> = predicates.map(wanted).collect();
    // From the last stratum to the first, so that all readers come before.
    for (position, (stratum, part)) in rules.strata.iter().zip(parts).enumerate().rev() {
        let needed = stratum.predicates.iter().any(|predicate| is_needed[predicate.index()]);
        is_kept[position] = needed || stratum.predicates.iter().any(|predicate| counted(*predicate));
        match part {
            _ if !is_kept[position] => {}
            StratumExecutor::Hidden if needed => return None,
            StratumExecutor::Hidden => divider.need(stratum),
            StratumExecutor::Read => divider.read(stratum),
            StratumExecutor::Dense(handed) => {
                handed.into_iter().for_each(|clause| divider.divide(lifted, clause));
                let (read, _) = divider.dense.read_by(stratum.clauses.iter().copied());
                is_needed.resize(divider.dense.predicates.len(), false);
                read.into_iter()
                    .for_each(|predicate| is_needed[predicate.index()] = true);
            }
        }
    }
    Some(divider.finish(lifted, &is_kept))
}

/// Makes the rules of both executors.
struct Divider<'r> {
    rules: &'r Rules,
    dense: Rules,
    relational: Rules,
    /// By clause that is handed over: the hidden predicate with its rows.
    heads: Vec<Option<PredicateId>>,
    /// By clause that is divided: the clause of its hidden predicate.
    pieces: Vec<Option<Clause>>,
    handed: Vec<(PredicateId, PredicateId)>,
    /// By predicate: whether the relational executor must derive all its rows.
    is_read: Vec<bool>,
}

impl<'r> Divider<'r> {
    fn new(rules: &'r Rules, lifted: &Lifted) -> Self {
        Divider {
            rules,
            dense: lifted.rules.clone(),
            relational: rules.clone(),
            heads: vec![None; rules.clauses.len()],
            pieces: vec![None; rules.clauses.len()],
            handed: Vec::new(),
            is_read: vec![false; rules.predicates.len()],
        }
    }

    /// Adds a hidden predicate with the columns of another.
    fn hidden(&mut self, like: PredicateId, clause: &Clause) -> PredicateId {
        let predicates = &mut self.dense.predicates;
        let made = PredicateId(number_of(predicates.len()));
        let columns = predicates[like.index()].columns.clone();
        predicates.push(Predicate {
            derived: !clause.body.is_empty(),
            ..made_predicate(self.handed.len(), columns, clause.span)
        });
        made
    }

    /// Makes the relational executor derive what the dense one cannot evaluate of a clause.
    fn divide(&mut self, lifted: &Lifted, id: ClauseId) {
        let Some(piece) = Piece::of(&lifted.rules, self.rules.predicates.len(), id) else {
            return self.hand_over(id);
        };
        let clause = &lifted.rules.clauses[id.index()];
        let made = PredicateId(number_of(self.dense.predicates.len()));
        let head = Atom {
            predicate: made,
            terms: piece
                .columns
                .iter()
                .map(|(variable, _)| Term::Variable(*variable))
                .collect(),
            span: clause.span,
        };
        let mut rest: Vec<Literal> = clause.body.clone();
        let mut position = 0..;
        rest.retain(|_| !piece.unsupported.contains(&position.next().expect("no end")));
        rest.push(Literal::Positive(head.clone()));
        let columns = piece.columns.iter().map(|(_, column)| column.clone()).collect();
        (self.dense.predicates).push(made_predicate(self.handed.len(), columns, clause.span));
        let whole = std::mem::replace(&mut self.dense.clauses[id.index()].body, rest);
        if obstacle(&self.dense, id).is_some() {
            self.dense.predicates.pop();
            self.dense.clauses[id.index()].body = whole;
            return self.hand_over(id);
        }
        self.pieces[id.index()] = Some(Clause {
            head,
            body: piece
                .body
                .iter()
                .map(|position| clause.body[*position].clone())
                .collect(),
            ..clause.clone()
        });
        self.handed.push((made, made));
    }

    /// Makes the relational executor derive the rows of a clause.
    fn hand_over(&mut self, id: ClauseId) {
        let clause = &self.rules.clauses[id.index()];
        let head = clause.head.predicate;
        let made = self.hidden(head, clause);
        self.dense.clauses[id.index()] = copy(made, head, clause);
        self.relational.clauses[id.index()].head.predicate = made;
        self.heads[id.index()] = Some(made);
        self.handed.push((made, made));
    }

    /// Makes the relational executor derive a stratum.
    fn need(&mut self, stratum: &Stratum) {
        stratum
            .predicates
            .iter()
            .for_each(|predicate| self.is_read[predicate.index()] = true);
    }

    /// Makes the dense executor read all rows of a stratum.
    fn read(&mut self, stratum: &Stratum) {
        for &predicate in &stratum.predicates {
            let of_predicate = |id: &&ClauseId| self.rules.clauses[id.index()].head.predicate == predicate;
            let clauses: Vec<ClauseId> = stratum.clauses.iter().filter(of_predicate).copied().collect();
            let Some(first) = clauses.first() else { continue };
            let clause = &self.rules.clauses[first.index()];
            let made = self.hidden(predicate, clause);
            for id in clauses {
                self.dense.clauses[id.index()] = copy(made, predicate, clause);
            }
            self.handed.push((made, predicate));
        }
        self.need(stratum);
    }

    fn finish(mut self, lifted: &Lifted, kept: &[bool]) -> Division {
        let is_read = |stratum: &Stratum| stratum.predicates.iter().any(|one| self.is_read[one.index()]);
        let is_stored = |stratum: &Stratum| {
            let mut predicates = stratum.predicates.iter();
            predicates.all(|one| unfit_shape(&lifted.rules, *one).is_none())
        };
        let strata = self.rules.strata.iter().zip(kept);
        let strata = strata.filter(|(stratum, kept)| **kept && is_stored(stratum));
        let dense_strata: Vec<Stratum> = strata
            .map(|(stratum, _)| Stratum {
                recursive: stratum.recursive && !is_read(stratum),
                ..stratum.clone()
            })
            .collect();
        if self.handed.is_empty() && !self.is_read.contains(&true) {
            self.dense.strata = dense_strata;
            return Division {
                dense: self.dense,
                handed: None,
            };
        }
        let of_read = self.rules.strata.iter().filter(|stratum| is_read(stratum));
        let mut clauses: Vec<ClauseId> = of_read.flat_map(|stratum| &stratum.clauses).copied().collect();
        let handed = self.heads.iter().zip((0..).map(ClauseId));
        clauses.extend(handed.filter(|(head, _)| head.is_some()).map(|(_, id)| id));
        clauses.sort_unstable();

        self.dense.strata = dense_strata;
        let made = &self.dense.predicates[self.relational.predicates.len()..];
        self.relational.predicates.extend_from_slice(made);
        let is_divided: Vec<bool> = self.pieces.iter().map(Option::is_some).collect();
        let read = self.restrict();
        let number = self.renumber(&read);
        let obstacles = obstacles(&lifted.rules);
        let concerns = |reason: &&Unsupported| {
            let clause = reason.clause.index();
            number[clause].is_some() || is_divided[clause]
        };
        let reasons: Vec<Unsupported> = obstacles.iter().filter(concerns).cloned().collect();
        let here = |id: &ClauseId| number[id.index()].map(|here| (*id, here));
        Division {
            handed: Some(Handed {
                clauses: clauses.iter().filter_map(here).collect(),
                rules: self.relational,
                predicates: self.handed,
                read,
                // The reason may be in the body of an aggregate that the dense executor evaluates.
                reasons: if reasons.is_empty() { obstacles } else { reasons },
            }),
            dense: self.dense,
        }
    }

    /// Adds a clause of the relational executor.
    fn add(&mut self, clause: Clause) -> ClauseId {
        self.relational.clauses.push(clause);
        ClauseId(number_of(self.relational.clauses.len() - 1))
    }

    /// Restricts the strata of the relational executor to what the dense one reads of it. Returns the predicates that
    /// they read, sorted.
    fn restrict(&mut self) -> Vec<PredicateId> {
        let mut needed = self.is_read.clone();
        needed.resize(self.relational.predicates.len(), false);
        let (mut read, mut strata) = (Vec::new(), Vec::new());
        let mut need = |relational: &Rules, needed: &mut [bool], clauses: &[ClauseId]| {
            let (predicates, correlated) = relational.read_by(clauses.iter().copied());
            for predicate in predicates.into_iter().chain(correlated) {
                needed[predicate.index()] = true;
                read.push(predicate);
            }
        };
        // From the last stratum to the first, so that all readers come before.
        for stratum in self.rules.strata.iter().rev() {
            let (handed, own): (Vec<ClauseId>, Vec<ClauseId>) =
                (stratum.clauses.iter()).partition(|id| self.heads[id.index()].is_some());
            if stratum.predicates.iter().any(|predicate| needed[predicate.index()]) {
                need(&self.relational, &mut needed, &own);
                let mut clauses = own;
                for id in &handed {
                    let clause = &self.rules.clauses[id.index()];
                    let made = self.heads[id.index()].expect("it is handed over");
                    clauses.push(self.add(copy(made, clause.head.predicate, clause)));
                }
                strata.push(Stratum {
                    clauses,
                    ..stratum.clone()
                });
            }
            let pieces: Vec<Clause> = (stratum.clauses.iter())
                .filter_map(|id| self.pieces[id.index()].take())
                .collect();
            let pieces: Vec<ClauseId> = pieces.into_iter().map(|piece| self.add(piece)).collect();
            for id in handed.into_iter().chain(pieces) {
                need(&self.relational, &mut needed, &[id]);
                strata.push(Stratum {
                    predicates: vec![self.relational.clauses[id.index()].head.predicate],
                    clauses: vec![id],
                    recursive: false,
                });
            }
        }
        strata.reverse();
        self.relational.strata = strata;
        read.sort_unstable();
        read.dedup();
        read
    }

    /// Removes the clauses that are in no stratum of the relational executor and do not belong to the aggregates there.
    /// Returns the new number of each clause.
    fn renumber(&mut self, read: &[PredicateId]) -> Vec<Option<ClauseId>> {
        let Rules { clauses, strata, .. } = &mut self.relational;
        let mut is_used = vec![false; clauses.len()];
        for id in strata.iter().flat_map(|stratum| &stratum.clauses) {
            is_used[id.index()] = true;
        }
        for (clause, is_used) in clauses.iter().zip(&mut is_used) {
            let head = clause.head.predicate;
            *is_used |= self.rules.is_correlated(head) && read.binary_search(&head).is_ok();
        }
        let mut next = (0..).map(ClauseId);
        let number = is_used.iter().map(|used| used.then(|| next.next().expect("no end")));
        let number: Vec<Option<ClauseId>> = number.collect();
        let mut used = is_used.iter();
        clauses.retain(|_| *used.next().expect("one for each clause"));
        for id in strata.iter_mut().flat_map(|stratum| &mut stratum.clauses) {
            *id = number[id.index()].expect("it is in a stratum");
        }
        number
    }
}

/// A part of a clause that the dense executor cannot evaluate.
struct Piece {
    /// The positions of the literals that it cannot evaluate.
    unsupported: Vec<usize>,
    /// The positions of the literals of the part: these, and others that bind their variables or leave fewer rows.
    body: Vec<usize>,
    /// The variables that other literals or the head read, with the columns of their values.
    columns: Vec<(VarId, Column)>,
}

impl Piece {
    /// Finds the part; `None` if only the whole clause has fewer than three such variables. The first `given`
    /// predicates are those of the relational executor.
    fn of(rules: &Rules, given: usize, id: ClauseId) -> Option<Piece> {
        let clause = &rules.clauses[id.index()];
        let unsupported = unsupported_literals(rules, clause);
        let is_rest = |position: &usize| !unsupported.contains(position);
        let rest = || (0..clause.body.len()).filter(is_rest);
        let of = |positions: &[usize]| -> Vec<VarId> {
            positions
                .iter()
                .flat_map(|position| clause.body[*position].variables())
                .collect()
        };
        let inner = of(&unsupported);
        let outer: Vec<VarId> = rest().flat_map(|position| clause.body[position].variables()).collect();
        let head = || clause.head.terms.iter().filter_map(Term::variable);
        let is_shared = |variable: &VarId| outer.contains(variable) || head().any(|of_head| of_head == *variable);
        let mut shared: Vec<VarId> = inner.iter().copied().filter(is_shared).collect();
        shared.sort_unstable();
        shared.dedup();
        if shared.is_empty() {
            shared.extend(head().next());
        }
        if unsupported.is_empty() || !(1..=2).contains(&shared.len()) {
            return None;
        }

        // Facts about these variables alone leave fewer rows; others only bind variables.
        let is_given = |atom: &Atom| {
            let known = &rules.predicates[atom.predicate.index()];
            atom.predicate.index() < given && !known.derived && !known.hidden
        };
        let is_near = |position: &usize| {
            let mut variables = clause.body[*position].variables();
            variables.all(|variable| inner.contains(&variable) || shared.contains(&variable))
        };
        let narrows = |position: &usize| match &clause.body[*position] {
            Literal::Guard(_) => true,
            Literal::Positive(atom) => atom.terms.len() == 1 && is_given(atom),
            _ => false,
        };
        let mut body = unsupported.clone();
        body.extend(rest().filter(|position| is_near(position) && narrows(position)));
        let is_atom = |position: &usize| match &clause.body[*position] {
            Literal::Positive(atom) | Literal::Guard(atom) => atom.predicate.index() < given,
            _ => false,
        };
        let mut binders: Vec<usize> = rest().filter(is_atom).collect();
        binders.sort_by_key(|position| {
            let is_given = clause.body[*position].atom().is_some_and(is_given);
            (!is_given, !is_near(position), *position)
        });
        loop {
            let mut wanted = of(&body);
            wanted.extend(&shared);
            let mut bound = vec![false; clause.variables.len()];
            bind_all(body.iter().map(|position| &clause.body[*position]), &mut bound);
            let Some(unbound) = wanted.iter().find(|variable| !bound[variable.index()]) else {
                break;
            };
            let binds = |position: &&usize| clause.body[**position].variables().any(|variable| variable == *unbound);
            body.push(*binders.iter().find(binds)?);
        }
        body.sort_unstable();

        let column = |variable: VarId| {
            let atoms = clause.body.iter().filter_map(Literal::atom).chain([&clause.head]);
            let mut columns =
                atoms.flat_map(|atom| atom.terms.iter().zip(&rules.predicates[atom.predicate.index()].columns));
            let (_, column) = columns.find(|(term, _)| **term == Term::Variable(variable))?;
            (column.base == BaseType::Symbol).then(|| (variable, column.clone()))
        };
        Some(Piece {
            unsupported,
            body,
            columns: shared.into_iter().map(column).collect::<Option<_>>()?,
        })
    }
}

/// Creates the hidden predicate of rows that are handed over.
fn made_predicate(number: usize, columns: Vec<Column>, span: Span) -> Predicate {
    let doc = "rows of the relational executor".to_owned();
    Predicate::made(format!("+handed {number}"), columns, doc, span)
}

/// Returns a number as in the ids of predicates and clauses.
fn number_of(position: usize) -> u32 {
    u32::try_from(position).expect("fewer than 2^32 of them")
}

/// Returns the clause that derives `to` from `from`, at the place of another clause.
fn copy(from: PredicateId, to: PredicateId, clause: &Clause) -> Clause {
    let columns = number_of(clause.head.terms.len());
    let terms: Vec<Term> = (0..columns).map(|column| Term::Variable(VarId(column))).collect();
    let atom = |predicate| Atom {
        predicate,
        terms: terms.clone(),
        span: clause.head.span,
    };
    Clause {
        head: atom(to),
        body: vec![Literal::Positive(atom(from))],
        variables: (0..columns).map(|column| format!("_{column}")).collect(),
        variable_spans: vec![clause.span; columns as usize],
        ..clause.clone()
    }
}
