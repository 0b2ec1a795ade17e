//! The formulas of rows, from the instances of clauses.

use crate::cancel::Cancel;
use crate::chance;
use crate::check::{ClauseId, Draw, PredicateId, Term};
use crate::diagram::{Diagrams, Formula, TooLarge};
use crate::eval::limits::EvalError;
use crate::marginals::facts::{AskedRows, FactRow, asked_rows};
use crate::marginals::grounding::{Formulas, GroundClause, Grounding, NOWHERE, value};
use crate::session::Session;
use crate::value::Value;
use std::collections::{BTreeMap, BTreeSet, HashMap};

impl Grounding {
    /// Returns the probabilities of [`Marginals::first`](super::Marginals::first) for the rows of these predicates that
    /// are asked for.
    pub fn firsts(
        &self,
        (order, asked): (&[PredicateId], Option<&AskedRows>),
        known: &Formulas,
        diagrams: &mut Diagrams,
    ) -> Result<BTreeMap<Box<[Value]>, Vec<f64>>, TooLarge> {
        let mut rows: BTreeMap<&[Value], Vec<Formula>> = BTreeMap::new();
        for (place, predicate) in order.iter().enumerate() {
            for (at, row) in asked_rows(&self.session, *predicate, asked) {
                let formulas = rows.entry(row).or_insert_with(|| vec![Formula::FALSE; order.len()]);
                formulas[place] = known.at(*predicate, at);
            }
        }
        let mut firsts = BTreeMap::new();
        for (row, formulas) in rows {
            let each = diagrams.firsts(&formulas)?.into_iter();
            let each = each.map(|formula| diagrams.probability(formula));
            firsts.insert(row.into(), each.collect());
        }
        Ok(firsts)
    }

    /// Returns the formulas of the needed rows. Variables follow those that the algebra has.
    pub fn formulas<A: Algebra>(
        &self,
        given: Given<'_>,
        algebra: &mut A,
        sources: &mut Vec<Source>,
        cancel: &Cancel,
    ) -> Result<Result<Formulas, TooLarge>, EvalError> {
        let needed = self.needed.as_ref().expect("it is known which rows are needed");
        let mut work = Work {
            session: &self.session,
            algebra,
            formulas: needed.formulas.clone(),
            draws: HashMap::new(),
            given,
            sources,
            cancel,
        };
        match work.run(self, &needed.ranks) {
            Ok(()) => Ok(Ok(work.formulas)),
            Err(Stop::TooLarge) => Ok(Err(TooLarge)),
            Err(Stop::Cancelled) => Err(EvalError::Cancelled { clause: ClauseId(0) }),
        }
    }
}

/// Formulas over variables with probabilities, which are numbered in the order of their creation.
pub(super) trait Algebra {
    /// Adds a variable, and returns the formula that it holds.
    fn variable(&mut self, probability: f64) -> Result<Formula, TooLarge>;

    /// Returns the conjunction.
    fn and(&mut self, left: Formula, right: Formula) -> Result<Formula, TooLarge>;

    /// Returns the disjunction.
    fn or(&mut self, left: Formula, right: Formula) -> Result<Formula, TooLarge>;
}

impl Algebra for Diagrams {
    fn variable(&mut self, probability: f64) -> Result<Formula, TooLarge> {
        Diagrams::variable(self, probability)
    }

    fn and(&mut self, left: Formula, right: Formula) -> Result<Formula, TooLarge> {
        Diagrams::and(self, left, right)
    }

    fn or(&mut self, left: Formula, right: Formula) -> Result<Formula, TooLarge> {
        Diagrams::or(self, left, right)
    }
}

/// What a variable stands for.
#[derive(Clone, Copy, Debug)]
pub(super) enum Source {
    /// A row of an input, by its position in the session.
    Fact(PredicateId, u32),
    /// A draw with this probability.
    Draw(f64),
    /// That an instance of a clause with this weight counts.
    Weight(usize),
}

/// What is given of a tick.
#[derive(Clone, Copy)]
pub(super) struct Given<'g> {
    /// The formulas of facts, in place of their probabilities.
    pub formulas: &'g HashMap<(PredicateId, FactRow), Formula>,
    /// The weights of clauses.
    pub weights: &'g [f64],
}

/// Why formulas are not complete.
enum Stop {
    TooLarge,
    Cancelled,
}

impl From<TooLarge> for Stop {
    fn from(_: TooLarge) -> Stop {
        Stop::TooLarge
    }
}

/// The formulas so far.
struct Work<'w, A> {
    session: &'w Session,
    algebra: &'w mut A,
    formulas: Formulas,
    /// The alternatives of each draw. Lookup only, never iterated.
    draws: HashMap<(u64, Box<[Value]>), Vec<Formula>>,
    given: Given<'w>,
    /// What the variables stand for, by number.
    sources: &'w mut Vec<Source>,
    cancel: &'w Cancel,
}

/// An instance of a recursive clause: the position of its head, what holds of it apart from the recursion, and the
/// positions of the recursive atoms.
struct Instance {
    head: (PredicateId, u32),
    fixed: Formula,
    recursive: Vec<(PredicateId, u32)>,
}

impl<A: Algebra> Work<'_, A> {
    fn run(&mut self, grounding: &Grounding, ranks: &[Vec<u32>]) -> Result<(), Stop> {
        let mut random = Vec::new();
        // Facts of the source are no such facts; clauses add them below.
        for (input, ranks) in grounding.inputs.iter().zip(ranks) {
            for &(at, probability) in &input.given {
                let rank = ranks[at as usize];
                if rank == NOWHERE {
                    continue;
                }
                let known = match self.given.formulas.is_empty() {
                    true => None,
                    false => {
                        let row = input.rows[at as usize].clone();
                        self.given.formulas.get(&(input.predicate, row)).copied()
                    }
                };
                match known {
                    Some(formula) => self.formulas.set(input.predicate, at as usize, formula),
                    // These need no variable, and so no order.
                    None if probability >= 1.0 => self.formulas.set(input.predicate, at as usize, Formula::TRUE),
                    None => random.push((rank, input.predicate, at, probability)),
                }
            }
        }
        random.sort_unstable_by_key(|(rank, ..)| *rank);
        for (_, input, at, probability) in random {
            let formula = self.random(probability, Source::Fact(input, at))?;
            self.formulas.set(input, at as usize, formula);
        }
        for stratum in &grounding.strata {
            let mut instances = Vec::new();
            for clause in &stratum.clauses {
                self.instances(clause, &mut instances)?;
            }
            self.fixpoint(&instances)?;
        }
        Ok(())
    }

    /// Returns a formula that holds with this probability, independently of all others.
    fn random(&mut self, probability: f64, source: Source) -> Result<Formula, TooLarge> {
        match probability {
            ..=0.0 => Ok(Formula::FALSE),
            1.0.. => Ok(Formula::TRUE),
            _ => self.variable(probability, source),
        }
    }

    fn variable(&mut self, probability: f64, source: Source) -> Result<Formula, TooLarge> {
        self.sources.push(source);
        self.algebra.variable(probability)
    }

    /// Evaluates the instances of a clause, and collects those that are recursive.
    fn instances(&mut self, clause: &GroundClause, recursive: &mut Vec<Instance>) -> Result<(), Stop> {
        for (count, &number) in clause.found.needed.iter().enumerate() {
            if count % 1024 == 1023 && self.cancel.requested() {
                return Err(Stop::Cancelled);
            }
            let number = number as usize;
            let positions = &clause.found.positions[number * clause.width()..][..clause.width()];
            let (lower, own) = positions[1..].split_at(clause.lower.len());
            let mut fixed = Formula::TRUE;
            for ((atom, negated), &at) in clause.lower.iter().zip(lower) {
                let formula = match negated {
                    false => self.at((atom.predicate, at)),
                    true if at == NOWHERE => continue,
                    true if atom.terms.contains(&Term::Wildcard) => {
                        let mut all = Formula::FALSE;
                        for &at in &clause.found.groups[at as usize] {
                            all = self.algebra.or(all, self.at((atom.predicate, at)))?;
                        }
                        all.not()
                    }
                    true => self.at((atom.predicate, at)).not(),
                };
                fixed = self.algebra.and(fixed, formula)?;
                if fixed == Formula::FALSE {
                    break;
                }
            }
            if fixed == Formula::FALSE {
                continue;
            }
            if let (Some(draw), Some(instances)) = (&clause.draw, clause.instances) {
                let drawn = self.drawn(draw, self.session.row(instances, number))?;
                fixed = self.algebra.and(fixed, drawn)?;
            }
            if let Some(weight) = clause.weight {
                let counts = self.variable(self.given.weights[weight], Source::Weight(weight))?;
                fixed = self.algebra.and(fixed, counts)?;
            }
            let head = (clause.head.predicate, positions[0]);
            if own.is_empty() {
                self.add(head, fixed)?;
            } else {
                let own = clause.recursive.iter().zip(own);
                recursive.push(Instance {
                    head,
                    fixed,
                    recursive: own.map(|(atom, at)| (atom.predicate, *at)).collect(),
                });
            }
        }
        Ok(())
    }

    /// Evaluates recursive instances until no formula changes. Formulas only grow, so this ends.
    fn fixpoint(&mut self, instances: &[Instance]) -> Result<(), Stop> {
        let mut changed: BTreeSet<(PredicateId, u32)> = BTreeSet::new();
        let mut first = true;
        while first || !changed.is_empty() {
            let mut next = BTreeSet::new();
            for instance in instances {
                if !first && !instance.recursive.iter().any(|atom| changed.contains(atom)) {
                    continue;
                }
                if self.cancel.requested() {
                    return Err(Stop::Cancelled);
                }
                let mut formula = instance.fixed;
                for atom in &instance.recursive {
                    formula = self.algebra.and(formula, self.at(*atom))?;
                }
                if self.add(instance.head, formula)? {
                    next.insert(instance.head);
                }
            }
            (first, changed) = (false, next);
        }
        Ok(())
    }

    /// Adds a reason for a row. Returns whether its formula changes.
    fn add(&mut self, (predicate, at): (PredicateId, u32), reason: Formula) -> Result<bool, TooLarge> {
        let before = self.at((predicate, at));
        let after = self.algebra.or(before, reason)?;
        self.formulas.set(predicate, at as usize, after);
        Ok(before != after)
    }

    #[inline]
    fn at(&self, (predicate, at): (PredicateId, u32)) -> Formula {
        self.formulas.at(predicate, at as usize)
    }

    /// Returns the formula that the alternative of a draw is chosen.
    fn drawn(&mut self, draw: &Draw, instance: &[Value]) -> Result<Formula, TooLarge> {
        let values = draw.values.iter().map(|term| value(term, instance).unwrap_or_default());
        let key = (draw.stream, values.collect::<Box<[Value]>>());
        if let Some(alternatives) = self.draws.get(&key) {
            return Ok(alternatives.get(draw.alternative).copied().unwrap_or(Formula::FALSE));
        }
        let probabilities = draw.probabilities.iter();
        let probabilities = probabilities.map(|term| value(term, instance).unwrap_or_default().as_float());
        let probabilities: Vec<f32> = probabilities.collect();
        let mut alternatives = Vec::new();
        if chance::alternative(0.0, probabilities.iter().copied()).is_some() {
            // The first alternatives are not chosen, and this one is, of what is left.
            let (mut before, mut left) = (Formula::TRUE, 1.0);
            for probability in probabilities.into_iter().map(exact) {
                let chosen = {
                    let probability = if left > 0.0 { probability / left } else { 0.0 };
                    self.random(probability, Source::Draw(probability))?
                };
                alternatives.push(self.algebra.and(before, chosen)?);
                before = self.algebra.and(before, chosen.not())?;
                left -= probability;
            }
        }
        let found = alternatives.get(draw.alternative).copied().unwrap_or(Formula::FALSE);
        self.draws.insert(key, alternatives);
        Ok(found)
    }
}

/// Returns the number that a float of single precision was probably written as: 0.3, not 0.30000001192.
fn exact(probability: f32) -> f64 {
    probability
        .to_string()
        .parse()
        .unwrap_or_else(|_| f64::from(probability))
}
