//! Proves two rule sets equivalent, or prints a smallest scene in which they differ: `cargo run --example compare_rules`.
//!
//! ```text
//! shorter.dl: equivalent in scenes of any size
//! wrong.dl: differs in the scene [("Bus", [["e0"]]), ("Near", [["e0", "e0"]])]
//!   original.dl derives [("Stop", ["e0"])]
//!   wrong.dl derives []
//! ```

use logicity_datalog::diff::{Equivalence, Options, diff};
use logicity_datalog::{Program, ProgramError};

const INPUTS: &str = "\
.decl Car(x: symbol)
.decl Bus(x: symbol)
.decl Near(x: symbol, y: symbol)
.input Car, Bus, Near
.decl Stop(x: symbol)
.output Stop
";
const ORIGINAL: &str = "Stop(x) :- Near(x, y), Car(y). Stop(x) :- Near(x, y), Bus(y).";
const SHORTER: &str = "Stop(x) :- Near(x, y), (Bus(y); Car(y)).";
const WRONG: &str = "Stop(x) :- Near(x, y), Bus(y), Car(y).";

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let original = load(ORIGINAL)?;
    for (name, text) in [("shorter.dl", SHORTER), ("wrong.dl", WRONG)] {
        let found = diff(original.rules(), load(text)?.rules(), &Options::default());
        match found.map_err(|faults| faults[0].message.clone())? {
            Equivalence::Equivalent { .. } => println!("{name}: equivalent in scenes of any size"),
            Equivalence::Different(difference) => {
                println!("{name}: differs in the scene {:?}", difference.facts);
                println!("  original.dl derives {:?}", difference.derived[0]);
                println!("  {name} derives {:?}", difference.derived[1]);
            }
            other => println!("{name}: no difference found, and no proof: {other:?}"),
        }
    }
    Ok(())
}

fn load(clauses: &str) -> Result<Program, ProgramError> {
    Program::parse(&format!("{INPUTS}{clauses}"))
}
