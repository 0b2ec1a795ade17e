//! The engine against its specification, and fixed examples of what it must know.

mod random_program;

use logicity::engine::{Program, Session, StratumWork, naive};
use logicity::lang::{ClauseId, Literal, RelId, Rules, Value};
use proptest::prelude::*;
use random_program::{Genome, genomes};
use std::collections::BTreeSet;

/// Everything a session holds.
fn database(session: &Session) -> naive::Database {
    let relations = session.program().rules().relations.len();
    (0..relations as u32)
        .map(|rel| session.rows(RelId(rel)).map(<[Value]>::to_vec).collect())
        .collect()
}

/// Runs the genome's script; after every batch the session is what `naive` derives from scratch.
fn check_script(genome: &Genome) -> Result<(), TestCaseError> {
    let rules = genome.rules();
    let program = Program::new(rules.clone()).expect("a generated program is safe and small");
    let mut session = program.session();
    let mut facts: BTreeSet<(RelId, Vec<Value>)> = BTreeSet::new();
    let mut before: naive::Database = vec![BTreeSet::new(); rules.relations.len()];
    for batch in 0..genome.script.len() {
        for (present, rel, row) in genome.batch(&rules, batch) {
            if present {
                session.insert(rel, &row).unwrap();
                facts.insert((rel, row));
            } else {
                session.retract(rel, &row).unwrap();
                facts.remove(&(rel, row));
            }
        }
        let delta = session.commit().unwrap();
        let after = naive::evaluate(&rules, session.symbols(), facts.iter().cloned());
        prop_assert_eq!(&database(&session), &after);

        for (rel, (before, after)) in before.iter().zip(&after).enumerate() {
            let rows = session.rows(RelId(rel as u32));
            prop_assert!(rows.is_sorted());
            let change = delta.of(RelId(rel as u32));
            prop_assert_eq!(change.is_some(), before != after);
            if let Some(change) = change {
                prop_assert!(change.added.iter().eq(after.difference(before)));
                prop_assert!(change.removed.iter().eq(before.difference(after)));
            }
        }
        for (clause, position) in rules.clauses.iter().zip(0..) {
            let fired = session.fired(ClauseId(position));
            prop_assert!(fired.iter().eq(&naive::consequences(clause, session.symbols(), &after)));
        }
        for (stratum, work) in rules.strata.iter().zip(&session.work().strata) {
            let mut clauses = stratum.clauses.iter();
            let changed = clauses.any(|clause| input_changed(&rules, *clause, &stratum.relations, &before, &after));
            prop_assert_eq!(*work != StratumWork::Skipped, batch == 0 || changed);
        }
        before = after;
    }
    Ok(())
}

/// Whether the clause reads a relation outside of its stratum that is not what it was.
fn input_changed(
    rules: &Rules,
    clause: ClauseId,
    own: &[RelId],
    before: &naive::Database,
    after: &naive::Database,
) -> bool {
    rules.clauses[clause.index()].body.iter().any(|literal| match literal {
        Literal::Positive(atom) | Literal::Negative(atom) | Literal::Guard(atom) => {
            let own = own.contains(&atom.relation) && rules.relations[atom.relation.index()].derived;
            !own && before[atom.relation.index()] != after[atom.relation.index()]
        }
        Literal::Compare { .. } => false,
    })
}

proptest! {
    #![proptest_config(ProptestConfig { max_shrink_iters: 20_000, ..ProptestConfig::default() })]

    #[test]
    fn commits_agree_with_naive(genome in genomes(1..5)) {
        check_script(&genome)?;
    }
}
