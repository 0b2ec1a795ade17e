//! Learned rules that decide states.

use crate::induce::ask::space::{Fact, Space};
use crate::induce::bits::{self, Bits};
use crate::induce::examples::{State, witnesses};
use crate::induce::rules::ActionRules;
use crate::induce::vocabulary::{ARITY_MAX, Assignment, Body, Literal, Vocabulary, assignments};
use smallvec::SmallVec;
use std::collections::HashMap;
use std::rc::Rc;

/// A clause of a rule set.
pub struct Clause {
    /// The position of the action.
    pub action: usize,
    pub body: Body,
    /// Number of variables.
    pub variables: usize,
}

/// A clause under an assignment.
pub struct Instance {
    pub clause: usize,
    pub action: usize,
    pub assignment: Assignment,
    /// The facts that must hold.
    pub positive: Bits,
    /// The facts that must not hold.
    pub negative: Bits,
}

impl Instance {
    pub fn fires(&self, scene: &[u64]) -> bool {
        let holds = self.positive.iter().zip(scene).all(|(fact, scene)| fact & !scene == 0);
        holds && !bits::intersects(&self.negative, scene)
    }
}

/// The maximum number of entities for which the instances of clauses are kept.
const GROUNDED_MAX: usize = 6;

/// A rule set: the first action with a clause that holds is taken.
pub struct Hypothesis {
    vocabulary: Vocabulary,
    pub clauses: Vec<Clause>,
    /// The action that is taken if no clause holds.
    pub default: usize,
    /// By number of entities, the instances in the order of the actions.
    grounded: Vec<Option<Rc<Vec<Instance>>>>,
}

impl Hypothesis {
    pub fn new(vocabulary: &Vocabulary, rules: &[ActionRules], default: usize) -> Hypothesis {
        let clauses = rules.iter().enumerate().flat_map(|(action, of)| {
            of.clauses.iter().map(move |clause| Clause {
                action,
                variables: clause.body.variables(vocabulary),
                body: clause.body.clone(),
            })
        });
        let mut clauses: Vec<Clause> = clauses.collect();
        clauses.sort_by_key(|clause| clause.action);
        Hypothesis {
            vocabulary: vocabulary.clone(),
            clauses,
            default,
            grounded: vec![None; GROUNDED_MAX + 1],
        }
    }

    /// Returns the instances of all clauses for a number of entities, those of the first action first.
    pub fn instances(&mut self, entities: usize) -> Rc<Vec<Instance>> {
        if let Some(Some(instances)) = self.grounded.get(entities) {
            return Rc::clone(instances);
        }
        let mut instances = Vec::new();
        for (index, clause) in self.clauses.iter().enumerate() {
            for assignment in assignments(self.vocabulary.egos(), clause.variables, entities) {
                instances.push(self.instance(index, &assignment, entities));
            }
        }
        let instances = Rc::new(instances);
        if let Some(place) = self.grounded.get_mut(entities) {
            *place = Some(Rc::clone(&instances));
        }
        instances
    }

    fn instance(&self, index: usize, assignment: &[u8], entities: usize) -> Instance {
        let clause = &self.clauses[index];
        let (positive, negative) = ground(&self.vocabulary, &clause.body.0, assignment, entities);
        Instance {
            clause: index,
            action: clause.action,
            assignment: assignment.into(),
            positive,
            negative,
        }
    }

    /// Returns the action that the rules take.
    pub fn action(&mut self, state: &State) -> usize {
        if state.entities() <= GROUNDED_MAX {
            let instances = self.instances(state.entities());
            let fires = |instance: &&Instance| instance.fires(state.fact_set());
            return instances
                .iter()
                .find(fires)
                .map_or(self.default, |instance| instance.action);
        }
        let holds = |clause: &&Clause| !self.witnesses(clause, state, 1).is_empty();
        self.clauses
            .iter()
            .find(holds)
            .map_or(self.default, |clause| clause.action)
    }

    /// Returns up to `most` assignments under which a clause holds.
    pub fn witnesses(&self, clause: &Clause, state: &State, most: usize) -> Vec<Assignment> {
        witnesses(&self.vocabulary, &clause.body.0, clause.variables, state, most)
    }
}

/// Returns the facts of a conjunction under an assignment: those that must hold, and those that must not.
pub fn ground(vocabulary: &Vocabulary, literals: &[Literal], assignment: &[u8], entities: usize) -> (Bits, Bits) {
    let empty = bits::empty(vocabulary.facts(entities));
    let (mut positive, mut negative) = (empty.clone(), empty);
    for literal in literals {
        let fact = vocabulary.fact(entities, literal.atom.predicate, &literal.atom.under(assignment));
        bits::insert(
            if literal.is_negated {
                &mut negative
            } else {
                &mut positive
            },
            fact,
        );
    }
    (positive, negative)
}

/// Returns the instances that hold in a scene and whose action is at most `level`.
pub fn firing<'a>(instances: &'a [Instance], scene: &'a [u64], level: usize) -> impl Iterator<Item = &'a Instance> {
    (instances.iter())
        .take_while(move |instance| instance.action <= level)
        .filter(move |instance| instance.fires(scene))
}

/// Returns the facts of a clause in a space with an entity for each variable: those that must hold with what follows
/// from them, and those that must not.
pub fn own_instance(hypothesis: &Hypothesis, clause: usize, space: &Space) -> (Bits, Bits) {
    let names: Assignment = (0..hypothesis.clauses[clause].variables as u8).collect();
    let instance = hypothesis.instance(clause, &names, space.entities);
    let mut positive = space.start();
    for fact in bits::elements(&instance.positive) {
        space.add(&mut positive, fact);
    }
    (positive, instance.negative)
}

/// Estimates the probability that a clause negates a fact: the rate in the learned clauses, smoothed with the general
/// rate of negated literals.
pub struct NegationRates {
    egos: usize,
    clauses: usize,
    negated: usize,
    /// The predicates of negated literals, with whether each argument is a variable of the head.
    roles: HashMap<(usize, SmallVec<[bool; ARITY_MAX]>), usize>,
}

impl NegationRates {
    pub fn new(hypothesis: &Hypothesis) -> NegationRates {
        let egos = hypothesis.vocabulary.egos();
        let mut roles = HashMap::new();
        let mut negated = 0;
        for literal in hypothesis.clauses.iter().flat_map(|clause| &clause.body.0) {
            if literal.is_negated {
                negated += 1;
                let role = literal
                    .atom
                    .arguments
                    .iter()
                    .map(|&variable| (variable as usize) < egos)
                    .collect();
                *roles.entry((literal.atom.predicate, role)).or_insert(0) += 1;
            }
        }
        NegationRates {
            egos,
            clauses: hypothesis.clauses.len(),
            negated,
            roles,
        }
    }

    /// Returns the estimated probability that a clause has the negation of a fact about its variables.
    pub fn probability(&self, space: &Space, fact: usize) -> f64 {
        let Fact { predicate, arguments } = &space.facts[fact];
        let role = arguments.iter().map(|&entity| entity < self.egos).collect();
        let count = self.roles.get(&(*predicate, role)).copied().unwrap_or(0) as f64;
        let clauses = self.clauses as f64;
        let base = (self.negated as f64 + 1.0) / ((clauses + 1.0) * space.facts.len() as f64);
        (count + PSEUDOCOUNT * base) / (clauses + PSEUDOCOUNT)
    }
}

/// The number of clauses that the general rate of negated literals counts as.
const PSEUDOCOUNT: f64 = 3.0;
