//! Maintains reachability while edges are inserted and retracted, and prints what each commit changed:
//! `cargo run --example reachability`.
//!
//! ```text
//! insert edge(1, 2)
//!   + [(1, 2)]
//! insert edge(2, 3)
//!   + [(1, 3), (2, 3)]
//! insert edge(3, 4)
//!   + [(1, 4), (2, 4), (3, 4)]
//! retract edge(2, 3)
//!   - [(1, 3), (1, 4), (2, 3), (2, 4)]
//! ```

use logicity_datalog::diag::{Sources, render};
use logicity_datalog::files::ReadError;
use logicity_datalog::{Program, RelId, Session, Value};
use std::path::Path;

const RULES: &str = "\
.decl edge(x: number, y: number)
.input edge
.decl path(x: number, y: number)
path(x, y) :- edge(x, y).
path(x, z) :- path(x, y), edge(y, z).
";

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut sources = Sources::new();
    let entry = sources.add("path.dl", RULES);
    let (program, diagnostics) = Program::load(&mut sources, entry, &|_: &Path| Err(ReadError::NotFound));
    let program = program.ok_or_else(|| render(&diagnostics, &sources, false))?;
    let relation = |name| program.relation(name).ok_or("unknown relation");
    let (edge, path) = (relation("edge")?, relation("path")?);

    let mut session = program.session();
    for (from, to) in [(1, 2), (2, 3), (3, 4)] {
        session.insert(edge, &[Value::number(from), Value::number(to)])?;
        println!("insert edge({from}, {to})");
        commit(&mut session, path)?;
    }
    session.retract(edge, &[Value::number(2), Value::number(3)])?;
    println!("retract edge(2, 3)");
    commit(&mut session, path)
}

/// Updates everything that the rules derive, and prints the pairs that `path` gained and lost.
fn commit(session: &mut Session, path: RelId) -> Result<(), Box<dyn std::error::Error>> {
    let delta = session.commit()?;
    let change = delta.of(path).ok_or("`path` did not change")?;
    for (sign, rows) in [("+", &change.added), ("-", &change.removed)] {
        let pair = |row: &[Value]| (row[0].as_number(), row[1].as_number());
        let pairs: Vec<_> = rows.iter().map(pair).collect();
        if !pairs.is_empty() {
            println!("  {sign} {pairs:?}");
        }
    }
    Ok(())
}
