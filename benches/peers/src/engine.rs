//! logicity as a library.

#![allow(dead_code, reason = "each binary uses its own part")]

use crate::case::{Changes, Facts};
use logicity::builtin::BuiltinFiles;
use logicity::datalog;
use logicity::datalog::{BaseType, Delta, Limits, Program, Session, Value};
use logicity::diag::{Sources, render};

/// The number of rows of each of the predicates.
pub fn counts(text: &str, facts: &Facts, derived: &[&str]) -> Vec<usize> {
    let mut session = load(text, facts);
    session.commit().expect("within the limit");
    lengths(&session, derived)
}

/// Applies changes, and commits them.
pub fn change(session: &mut Session, changes: &Changes) -> Delta {
    for (name, pairs) in changes {
        let predicate = session
            .program()
            .predicate(name)
            .expect("the program has the predicate");
        for &((x, y), present) in pairs {
            let row = [Value(x), Value(y)];
            let noted = if present {
                session.insert(predicate, row)
            } else {
                session.retract(predicate, row)
            };
            noted.expect("a base predicate of two columns");
        }
    }
    session.commit().expect("within the limit")
}

/// The current number of rows of each of the predicates.
pub fn lengths(session: &Session, predicates: &[&str]) -> Vec<usize> {
    let predicate = |name: &&str| {
        session
            .program()
            .predicate(name)
            .expect("the program has the predicate")
    };
    predicates.iter().map(|name| session.len(predicate(name))).collect()
}

/// A session with the facts inserted and not yet committed.
pub fn load(text: &str, facts: &Facts) -> Session {
    let mut sources = Sources::new();
    let entry = sources.add("program.dl", text);
    let loaded = datalog::load(&mut sources, entry, &BuiltinFiles);
    let rules = loaded
        .rules
        .unwrap_or_else(|| panic!("{}", render(&loaded.diagnostics, &sources, false)));
    let program = Program::new(rules).expect("the program is small");
    let mut session = program.session();
    // The measuring program limits the memory of the process.
    session.set_limits(Limits {
        bytes: u64::MAX >> 1,
        ..session.limits()
    });
    let predicate = |name: &str| program.predicate(name).expect("the program has the predicate");

    // In a column of symbols, number n stands for the symbol that is interned as the n-th.
    let symbolic = |name: &str| program.rules().predicates[predicate(name).index()].columns[0].base == BaseType::Symbol;
    if facts.unary.iter().any(|(name, _)| symbolic(name)) {
        let largest = facts
            .binary
            .iter()
            .flat_map(|(_, rows)| rows)
            .map(|&(x, y)| x.max(y))
            .max();
        for number in session.symbols().len() as u32..=largest.unwrap_or(0) {
            session.intern(&format!("agent {number}"));
        }
    }
    for (name, rows) in &facts.unary {
        let rows = rows.iter().map(|&x| [Value(x)]);
        session.insert_all(predicate(name), rows).expect("a base predicate");
    }
    for (name, rows) in &facts.binary {
        let rows = rows.iter().map(|&(x, y)| [Value(x), Value(y)]);
        session.insert_all(predicate(name), rows).expect("a base predicate");
    }
    for (name, rows) in &facts.ternary {
        let rows = rows.iter().map(|row| row.map(Value));
        session.insert_all(predicate(name), rows).expect("a base predicate");
    }
    for (name, rows) in &facts.quaternary {
        let rows = rows.iter().map(|row| row.map(Value));
        session.insert_all(predicate(name), rows).expect("a base predicate");
    }
    session
}
