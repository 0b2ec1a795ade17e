//! Maintains reachability while edges are added and removed. Needs the engine alone:
//! `cargo run --no-default-features --example reachability`.

use logicity::datalog::{Program, Value};
use logicity::diag::Sources;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut sources = Sources::new();
    let text = ".decl edge(x: number, y: number)\n.input edge\n.decl path(x: number, y: number)\n\
                path(x, y) :- edge(x, y).\npath(x, z) :- path(x, y), edge(y, z).";
    let entry = sources.add("path.dl", text);
    let (program, faults) = Program::load(&mut sources, entry, &logicity::files::read_text);
    let program = program.ok_or_else(|| logicity::diag::render(&faults, &sources, false))?;
    let (edge, path) = (
        program.relation("edge").ok_or("edge")?,
        program.relation("path").ok_or("path")?,
    );
    let mut session = program.session();
    for (from, to) in [(1, 2), (2, 3), (3, 4)] {
        session.insert(edge, &[Value::number(from), Value::number(to)])?;
        let delta = session.commit()?;
        println!(
            "edge({from}, {to}) adds {} paths",
            delta.of(path).map_or(0, |change| change.added.len())
        );
    }
    Ok(())
}
