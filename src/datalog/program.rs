//! Rules with a plan for every clause.

use std::sync::Arc;

use crate::datalog::check::{Edb, RelId, Rules};
#[cfg(feature = "optimizer")]
use crate::datalog::plan::optimize;
use crate::datalog::plan::{Compiled, Plans};
use crate::datalog::workspace;
use crate::diag::{Diagnostic, SourceId, Sources};
use crate::files::ReadFile;

/// Rules with a plan for every clause. Cheap to clone; many sessions can run one program.
#[derive(Clone, Debug)]
pub struct Program(pub(super) Arc<Compiled>);

/// How to prepare a program.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Options {
    /// Simplify clauses before they are planned. Without the feature `optimizer` clauses are planned as they are.
    pub optimize: bool,
    /// Rely on [`Rules::constraints`]. Where facts violate a constraint, answers may then be wrong; see [`constraints::violations`](crate::datalog::constraints::violations).
    pub constraints: bool,
}

impl Default for Options {
    /// Optimised, relying on no constraint.
    fn default() -> Self {
        Options {
            optimize: true,
            constraints: false,
        }
    }
}

impl Program {
    /// Loads the rules of `entry`, a text of `sources`, with [`load`](crate::datalog::load) and plans them. Beside the program stand all errors
    /// and warnings; there is none if one of them is an error.
    pub fn load(sources: &mut Sources, entry: SourceId, read: &dyn ReadFile) -> (Option<Program>, Vec<Diagnostic>) {
        Program::load_with(sources, entry, read, Edb::Fixed)
    }

    /// As [`Program::load`], with a choice of what an `.input` is.
    pub fn load_with(
        sources: &mut Sources,
        entry: SourceId,
        read: &dyn ReadFile,
        inputs: Edb,
    ) -> (Option<Program>, Vec<Diagnostic>) {
        let mut loaded = workspace::load_with(sources, entry, read, inputs);
        let program = loaded
            .rules
            .and_then(|rules| Program::new(rules).map_err(|fault| loaded.diagnostics.push(fault)).ok());
        (program, loaded.diagnostics)
    }

    /// Plans the evaluation of checked rules. Fails only if a predicate has more than 32 columns or a clause more than 128
    /// variables or literals.
    pub fn new(rules: Rules) -> Result<Program, Diagnostic> {
        Program::with(rules, Options::default())
    }

    /// As [`Program::new`], with a choice of what to rely on. The answers are the same.
    pub fn with(rules: Rules, options: Options) -> Result<Program, Diagnostic> {
        #[cfg(feature = "optimizer")]
        let plans = match options.optimize {
            true => Plans::new(&optimize::optimize(&rules, options.constraints))?,
            false => Plans::new(&rules)?,
        };
        #[cfg(not(feature = "optimizer"))]
        let plans = {
            let Options {
                optimize: _,
                constraints: _,
            } = options;
            Plans::new(&rules)?
        };
        let plans = Arc::new(plans);
        Ok(Program(Arc::new(Compiled { rules, plans })))
    }

    /// The rules.
    pub fn rules(&self) -> &Rules {
        &self.0.rules
    }

    /// The predicate of that name.
    pub fn relation(&self, name: &str) -> Option<RelId> {
        self.0.rules.relation(name)
    }
}
