//! Compares a session with the specification on any program and any script of changes.

use super::Batch;
use logicity_datalog::{ClauseId, Literal, PredicateId, Rules, Value};
use logicity_datalog::{Options, Program, Session, Strategy, StratumStats, naive};
use proptest::prelude::*;
use std::collections::BTreeSet;

/// All rows of a session.
pub fn database(session: &Session) -> naive::Database {
    let predicates = session.program().rules().predicates.len();
    (0..predicates as u32)
        .map(|id| session.encoded_rows(PredicateId(id)).map(<[Value]>::to_vec).collect())
        .collect()
}

/// The model without the rows that a session aggregates.
fn stored(session: &Session, model: &naive::Database) -> naive::Database {
    let rows = |(id, rows): (u32, &BTreeSet<Vec<Value>>)| match session.program().is_aggregated(PredicateId(id)) {
        true => BTreeSet::new(),
        false => rows.clone(),
    };
    (0..).zip(model).map(rows).collect()
}

/// Runs the script under every strategy, with and without the optimizer. After every batch, each session equals what
/// `naive` derives from scratch, and its delta is exactly the difference.
pub fn agrees(rules: &Rules, script: &[Batch]) -> Result<(), TestCaseError> {
    // Interns the texts that the rules make, so that each has the same word in all sessions.
    let states = states(rules, script);
    for optimize in [false, true] {
        let options = Options {
            optimize,
            ..Options::default()
        };
        agrees_with(rules, script, &states, options)?;
    }
    Ok(())
}

/// The model after every batch.
fn states(rules: &Rules, script: &[Batch]) -> Vec<naive::Database> {
    let mut facts: BTreeSet<(PredicateId, Vec<Value>)> = BTreeSet::new();
    let state = |batch: &Batch| {
        for (present, id, row) in batch {
            if *present {
                facts.insert((*id, row.clone()));
            } else {
                facts.remove(&(*id, row.clone()));
            }
        }
        naive::evaluate(rules, &rules.symbols, facts.iter().cloned())
    };
    script.iter().map(state).collect()
}

fn agrees_with(
    rules: &Rules,
    script: &[Batch],
    states: &[naive::Database],
    options: Options,
) -> Result<(), TestCaseError> {
    let program = Program::with(rules.clone(), options).expect("the program is safe and small");
    let mut sessions = [Strategy::Auto, Strategy::Maintain, Strategy::Recompute].map(|strategy| {
        let mut session = program.session();
        session.set_strategy(strategy);
        (strategy, session)
    });
    let nothing = vec![BTreeSet::new(); rules.predicates.len()];
    let mut before = &nothing;
    for (batch, after) in script.iter().zip(states) {
        for (strategy, session) in &mut sessions {
            for (present, id, row) in batch {
                set(session, *id, row, *present);
            }
            check_commit(session, before, after)?;
            let first = std::ptr::eq(before, &nothing);
            check_work(session, *strategy, options.optimize, first, before, after)?;
        }
        before = after;
    }

    // A batch with a change and its inverse has no effect. Two batches undo each other.
    let Some(batch) = script.last() else {
        return Ok(());
    };
    for (_, session) in &mut sessions {
        let known: Vec<bool> = batch.iter().map(|(_, id, row)| session.contains(*id, row)).collect();
        for (_, id, row) in batch {
            set(session, *id, row, true);
        }
        for ((_, id, row), known) in batch.iter().zip(&known) {
            set(session, *id, row, *known);
        }
        prop_assert!(session.commit().unwrap().is_empty());
        prop_assert_eq!(session.work().evaluated().count(), 0);

        for ((_, id, row), known) in batch.iter().zip(&known) {
            set(session, *id, row, !*known);
        }
        let there = session.commit().unwrap();
        for ((_, id, row), known) in batch.iter().zip(&known) {
            set(session, *id, row, *known);
        }
        let back = session.commit().unwrap();
        prop_assert_eq!(there.changes().len(), back.changes().len());
        for (there, back) in there.changes().iter().zip(back.changes()) {
            prop_assert_eq!(
                (there.predicate, &there.added, &there.removed),
                (back.predicate, &back.removed, &back.added)
            );
        }
        prop_assert_eq!(database(session), stored(session, before));
    }
    Ok(())
}

fn set(session: &mut Session, id: PredicateId, row: &[Value], present: bool) {
    let noted = if present {
        session.insert(id, row)
    } else {
        session.retract(id, row)
    };
    noted.expect("a row that fits");
}

/// Commits and checks that the session holds `after` and that its delta is the difference from `before`.
fn check_commit(session: &mut Session, before: &naive::Database, after: &naive::Database) -> Result<(), TestCaseError> {
    let delta = session.commit().unwrap();
    prop_assert_eq!(database(session), stored(session, after));
    for (id, (before, after)) in before.iter().zip(after).enumerate() {
        if session.program().is_aggregated(PredicateId(id as u32)) {
            prop_assert!(delta.of(PredicateId(id as u32)).is_none());
            continue;
        }
        let rows = session.encoded_rows(PredicateId(id as u32));
        prop_assert!(rows.is_sorted());
        let change = delta.of(PredicateId(id as u32));
        prop_assert_eq!(change.is_some(), before != after);
        if let Some(change) = change {
            prop_assert!(change.added.iter().eq(after.difference(before)));
            prop_assert!(change.removed.iter().eq(before.difference(after)));
        }
    }
    let program = session.program().clone();
    for (clause, position) in program.rules().clauses.iter().zip(0..) {
        if program.is_aggregated(clause.head.predicate) {
            continue;
        }
        let fired = session.fired(ClauseId(position));
        prop_assert!(
            fired
                .iter()
                .eq(&naive::consequences(program.rules(), clause, session.symbols(), after))
        );
    }
    Ok(())
}

/// Checks that the commit evaluated only strata whose inputs changed, with the requested strategy. In maintained
/// strata, only clauses that read a change or that might rederive a lost row ran.
fn check_work(
    session: &Session,
    strategy: Strategy,
    optimize: bool,
    first: bool,
    before: &naive::Database,
    after: &naive::Database,
) -> Result<(), TestCaseError> {
    let rules = session.program().rules();
    prop_assert_eq!(session.work().strata.len(), rules.strata.len());
    for (stratum, work) in rules.strata.iter().zip(&session.work().strata) {
        let changed = |clause: ClauseId| input_changed(rules, clause, &stratum.predicates, before, after);
        let any = stratum.clauses.iter().any(|clause| changed(*clause));
        let (evaluated, due) = (*work != StratumStats::Skipped, first || any);
        // The optimizer may find that a clause does not depend on the change, and an aggregate may stay the same.
        let aggregated = |id: &PredicateId| session.program().is_aggregated(*id);
        let mut bodies = stratum
            .clauses
            .iter()
            .flat_map(|clause| &rules.clauses[clause.index()].body);
        let reads = bodies.any(|literal| literal.atom().is_some_and(|atom| aggregated(&atom.predicate)));
        prop_assert!(evaluated == due || ((optimize || reads) && due));
        match work {
            StratumStats::Skipped => {}
            StratumStats::Maintained(work) => {
                prop_assert!(!first && strategy != Strategy::Recompute && work.given_up == 0);
                for rule in &work.rules {
                    prop_assert!(stratum.clauses.contains(&rule.clause) && rule.delta_rows > 0);
                }
                // If no row can be lost, a clause that reads no change does not run.
                if !stratum.recursive && work.rules.iter().any(|rule| !changed(rule.clause)) {
                    prop_assert!(work.rules.iter().any(|rule| changed(rule.clause) && rule.derived > 0));
                }
            }
            StratumStats::Recomputed(_) => {
                let aggregates = stratum.clauses.iter().any(|clause| {
                    let mut body = rules.clauses[clause.index()].body.iter();
                    body.any(|literal| matches!(literal, Literal::Aggregate { .. }))
                });
                let aggregates = aggregates || stratum.predicates.iter().any(aggregated);
                prop_assert!(first || strategy != Strategy::Maintain || aggregates);
            }
        }
    }
    Ok(())
}

/// Whether the clause reads a changed predicate outside of its stratum.
fn input_changed(
    rules: &Rules,
    clause: ClauseId,
    own: &[PredicateId],
    before: &naive::Database,
    after: &naive::Database,
) -> bool {
    let mut atoms = rules.clauses[clause.index()].body.iter().filter_map(Literal::atom);
    atoms.any(|atom| {
        // An aggregate in place reads what the clauses of its hidden predicate read.
        if rules.predicates[atom.predicate.index()].parameters > 0 {
            let ids = (0..).map(ClauseId).zip(&rules.clauses);
            let mut inner = ids.filter(|(_, clause)| clause.head.predicate == atom.predicate);
            return inner.any(|(inner, _)| input_changed(rules, inner, own, before, after));
        }
        let own = own.contains(&atom.predicate) && rules.predicates[atom.predicate.index()].derived;
        !own && before[atom.predicate.index()] != after[atom.predicate.index()]
    })
}
