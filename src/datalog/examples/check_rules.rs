//! Checks a rule file and prints its diagnostics: `cargo run --example check_rules [FILE]`.
//!
//! Without a file, checks two faulty rules. With the rules of cities, pass `logicity::builtin::BuiltinFiles` as the
//! reader, so that files can include `vocabulary.dl`.
//!
//! ```text
//! error[unknown-predicate]: no predicate `egde` is declared
//!  --> faulty.dl:6:29
//!   |
//! 1 | .decl edge(x: number, y: number)
//!   |       ---- `edge` is declared here
//! ...
//! 6 | reach(x, z) :- reach(x, y), egde(y, z).
//!   |                             ^^^^
//!   |
//!   = help: did you mean `edge`?
//!
//! error[unbound-variable]: no positive atom binds `w`
//!  --> faulty.dl:7:10
//!   |
//! 7 | reach(x, w) :- reach(x, y).
//!   |          ^
//!   |
//!   = help: add a positive atom that binds `w`, such as `edge(w, _)`
//! the rules have errors
//! ```

use logicity_datalog::Program;
use logicity_datalog::diag::{Sources, render};
use logicity_datalog::files::to_text;
use std::path::Path;

const FAULTY: &str = "\
.decl edge(x: number, y: number)
.input edge
.decl reach(x: number, y: number)
.output reach
reach(x, y) :- edge(x, y).
reach(x, z) :- reach(x, y), egde(y, z).
reach(x, w) :- reach(x, y).
";

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut sources = Sources::new();
    let entry = match std::env::args().nth(1) {
        Some(path) => {
            let text = to_text(std::fs::read(&path)?)?;
            sources.add(path, text)
        }
        None => sources.add("faulty.dl", FAULTY),
    };
    let (program, diagnostics) = Program::load(&mut sources, entry, &|path: &Path| to_text(std::fs::read(path)?));
    print!("{}", render(&diagnostics, &sources, false));
    match program {
        Some(program) => println!("{} clauses", program.rules().clauses.len()),
        None => println!("the rules have errors"),
    }
    Ok(())
}
