//! Checks explanations against the specification: proofs replay, and literals that an explanation calls false are
//! false.

use logicity_datalog::explain::{AbsenceReason, Explainer, Explanation, FailureKind, Node, Obstacle, Origin, Premise};
use logicity_datalog::{Atom, ClauseId, Literal, PredicateId, Rules, Term, Value};
use logicity_datalog::{Session, naive};
use std::collections::{BTreeMap, BTreeSet};

/// All rows that hold in a session, also those that it aggregates.
pub fn database(session: &Session) -> naive::Database {
    let rules = session.program().rules();
    let mut model: naive::Database = (0..rules.predicates.len() as u32)
        .map(|id| session.encoded_rows(PredicateId(id)).map(<[Value]>::to_vec).collect())
        .collect();
    for clause in rules.strata.iter().flat_map(|stratum| &stratum.clauses) {
        let clause = &rules.clauses[clause.index()];
        if session.program().is_aggregated(clause.head.predicate) {
            model[clause.head.predicate.index()] =
                naive::consequences(session.program().rules(), clause, session.symbols(), &model);
        }
    }
    model
}

/// Copies the rows of an aggregated predicate, and of those that a correlated one reads.
fn copy_complete(rules: &Rules, predicate: PredicateId, from: &naive::Database, to: &mut naive::Database) {
    to[predicate.index()] = from[predicate.index()].clone();
    if rules.predicates[predicate.index()].parameters > 0 {
        let clauses = rules.clauses.iter().filter(|clause| clause.head.predicate == predicate);
        let atoms = clauses.flat_map(|clause| &clause.body).filter_map(Literal::atom);
        atoms.for_each(|atom| copy_complete(rules, atom.predicate, from, to));
    }
}

/// The atom's row under the binding.
fn pattern(atom: &Atom, binding: &[Option<Value>]) -> Vec<Option<Value>> {
    atom.terms.iter().map(|term| value_of(term, binding)).collect()
}

/// The value of a term under the binding.
fn value_of(term: &Term, binding: &[Option<Value>]) -> Option<Value> {
    match *term {
        Term::Constant(value) => Some(value),
        Term::Variable(variable) => binding[variable.index()],
        Term::Wildcard => None,
    }
}

/// Whether a row has the wanted values.
fn matches(row: &[Value], pattern: &[Option<Value>]) -> bool {
    row.iter()
        .zip(pattern)
        .all(|(value, wanted)| wanted.is_none_or(|wanted| wanted == *value))
}

/// Checks every node of an explanation against the complete model.
pub fn check(session: &Session, model: &naive::Database, explanation: &Explanation) {
    let rules = session.program().rules();
    for node in explanation.nodes() {
        match node {
            Node::Fact(fact) => {
                assert!(model[fact.predicate.index()].contains(&fact.row));
                match &fact.origin {
                    Origin::Past(_) => unreachable!("these rules look back on no tick"),
                    Origin::Removed => unreachable!("these rules have no subsumption"),
                    Origin::Input => assert!(!rules.predicates[fact.predicate.index()].derived),
                    Origin::Source(clause) => assert!(rules.clauses[clause.index()].body.is_empty()),
                    Origin::Derived(derivation) => {
                        let clause = &rules.clauses[derivation.clause.index()];
                        assert_eq!(clause.head.predicate, fact.predicate);
                        assert_eq!(clause.body.len(), derivation.premises.len());
                        // Positive atoms read the facts of the proof alone; negated atoms read the complete model.
                        let mut little: naive::Database = vec![BTreeSet::new(); rules.predicates.len()];
                        let mut highest = 0;
                        for (literal, premise) in clause.body.iter().zip(&derivation.premises) {
                            match (literal, premise) {
                                (Literal::Positive(atom) | Literal::Guard(atom), Premise::Fact(node)) => {
                                    let Node::Fact(premise) = explanation.node(*node) else {
                                        panic!()
                                    };
                                    assert_eq!(premise.predicate, atom.predicate);
                                    assert!(matches(&premise.row, &pattern(atom, &derivation.binding)));
                                    little[atom.predicate.index()].insert(premise.row.clone());
                                    highest = highest.max(premise.height);
                                }
                                (Literal::Negative(atom), Premise::Absence(node)) => {
                                    let Node::Absence(absence) = explanation.node(*node) else {
                                        panic!()
                                    };
                                    assert_eq!(absence.predicate, atom.predicate);
                                    assert_eq!(absence.pattern, pattern(atom, &derivation.binding));
                                    little[atom.predicate.index()] = model[atom.predicate.index()].clone();
                                }
                                (Literal::Compare { .. }, Premise::Comparison { .. }) => {}
                                (Literal::Compute { to, .. }, Premise::Computed { value }) => {
                                    assert_eq!(value_of(to, &derivation.binding), Some(*value));
                                }
                                (Literal::Aggregate { to, atom, .. }, Premise::Computed { value }) => {
                                    assert_eq!(value_of(to, &derivation.binding), Some(*value));
                                    copy_complete(session.program().rules(), atom.predicate, model, &mut little);
                                }
                                other => panic!("{other:?}"),
                            }
                        }
                        assert_eq!(fact.height, highest + 1);
                        assert!(
                            naive::consequences(session.program().rules(), clause, session.symbols(), &little)
                                .contains(&fact.row)
                        );
                    }
                }
            }
            Node::Absence(absence) => {
                let mut rows = model[absence.predicate.index()].iter();
                assert!(!rows.any(|row| matches(row, &absence.pattern)));
                match &absence.reason {
                    AbsenceReason::NotAFact => assert!(!rules.predicates[absence.predicate.index()].derived),
                    AbsenceReason::NotLookedInto => assert!(explanation.nodes().len() >= Explainer::ABSENCES_MAX),
                    AbsenceReason::NoClause(misses) => {
                        let clauses = (0..rules.clauses.len() as u32).map(ClauseId).filter(|clause| {
                            let clause = &rules.clauses[clause.index()];
                            clause.head.predicate == absence.predicate && !clause.body.is_empty()
                        });
                        assert!(misses.iter().map(|miss| miss.clause).eq(clauses));
                        for miss in misses {
                            check_miss(
                                rules,
                                model,
                                explanation,
                                absence.pattern.as_slice(),
                                miss.clause,
                                &miss.obstacle,
                            );
                        }
                    }
                }
            }
        }
    }
}

fn check_miss(
    rules: &Rules,
    model: &naive::Database,
    explanation: &Explanation,
    wanted: &[Option<Value>],
    clause: ClauseId,
    obstacle: &Obstacle,
) {
    let clause = &rules.clauses[clause.index()];
    let Obstacle::Body { binding, failures } = obstacle else {
        // Either constants differ, or a variable would need two values.
        let mut known: BTreeMap<u32, Value> = BTreeMap::new();
        let clash = clause
            .head
            .terms
            .iter()
            .zip(wanted)
            .any(|(term, value)| match (term, value) {
                (_, None) => false,
                (Term::Constant(constant), Some(value)) => constant != value,
                (Term::Variable(variable), Some(value)) => *known.entry(variable.0).or_insert(*value) != *value,
                (Term::Wildcard, _) => false,
            });
        assert!(clash);
        return;
    };
    assert!(!failures.is_empty());
    for failure in failures {
        match (&clause.body[failure.literal], &failure.kind) {
            (Literal::Positive(atom) | Literal::Guard(atom), FailureKind::Absent(node)) => {
                let Node::Absence(absence) = explanation.node(*node) else {
                    panic!()
                };
                assert_eq!(absence.pattern, pattern(atom, binding));
                let mut rows = model[atom.predicate.index()].iter();
                assert!(!rows.any(|row| matches(row, &absence.pattern)));
            }
            (Literal::Positive(atom) | Literal::Guard(atom), FailureKind::AbsentTwice) => {
                let mut clause = clause.clone();
                clause.head.terms.clear();
                clause.body = vec![Literal::Positive(atom.clone())];
                for literal in clause.body.iter_mut() {
                    if let Literal::Positive(atom) = literal {
                        for term in &mut atom.terms {
                            if let Term::Variable(variable) = *term {
                                *term = binding[variable.index()].map_or(*term, Term::Constant);
                            }
                        }
                    }
                }
                assert!(naive::consequences(rules, &clause, &rules.symbols, model).is_empty());
            }
            (Literal::Negative(atom), FailureKind::Holds(node)) => {
                let Node::Fact(fact) = explanation.node(*node) else {
                    panic!()
                };
                assert!(matches(&fact.row, &pattern(atom, binding)));
            }
            (Literal::Compare { .. }, FailureKind::Comparison { .. }) => {}
            (Literal::Compute { to, .. } | Literal::Aggregate { to, .. }, FailureKind::Computed { value }) => {
                assert!(value.is_none() || value_of(to, binding) != *value);
            }
            other => panic!("{other:?}"),
        }
    }
}
