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

use logicity_datalog::{Program, Session};

const RULES: &str = "\
.decl edge(x: number, y: number)
.input edge
.decl path(x: number, y: number)
path(x, y) :- edge(x, y).
path(x, z) :- path(x, y), edge(y, z).
";

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let program = Program::parse(RULES)?;
    let mut session = program.session();
    for (from, to) in [(1, 2), (2, 3), (3, 4)] {
        session.insert("edge", (from, to))?;
        println!("insert edge({from}, {to})");
        commit(&mut session)?;
    }
    session.retract("edge", (2, 3))?;
    println!("retract edge(2, 3)");
    commit(&mut session)
}

/// Updates everything that the rules derive, and prints the pairs that `path` gained and lost.
fn commit(session: &mut Session) -> Result<(), Box<dyn std::error::Error>> {
    let delta = session.commit()?;
    let path = session.program().predicate("path").ok_or("no predicate `path`")?;
    let change = delta.of(path).ok_or("`path` did not change")?;
    for (sign, rows) in [("+", &change.added), ("-", &change.removed)] {
        let pairs: Vec<(i64, i64)> = session.decode(path, rows)?.collect();
        if !pairs.is_empty() {
            println!("  {sign} {pairs:?}");
        }
    }
    Ok(())
}
