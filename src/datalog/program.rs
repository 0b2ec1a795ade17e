//! Checked rules with evaluation plans.

use std::fmt;
use std::path::Path;
use std::sync::Arc;

use crate::check::{InputPolicy, PredicateId, Rules};
use crate::diag::{Diagnostic, SourceId, Sources, render};
use crate::files::{ReadError, ReadFile};
#[cfg(feature = "optimizer")]
use crate::plan::optimize;
use crate::plan::{Compiled, Plans};
use crate::workspace;

/// Checked rules with a plan for every clause; immutable and cheap to clone.
///
/// Many sessions can share one program. See the [module](crate) for the life of a program.
#[derive(Clone, Debug)]
pub struct Program(pub(super) Arc<Compiled>);

/// Options for preparing a program.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Options {
    /// Simplify clauses before planning. Has no effect without the feature `optimizer`.
    pub optimize: bool,
    /// Rely on [`Rules::constraints`] when simplifying. If facts violate a constraint, answers may then be wrong;
    /// [`constraints::violations`](crate::constraints::violations) finds such facts.
    pub constraints: bool,
}

impl Default for Options {
    /// Simplifies clauses and relies on no constraint.
    fn default() -> Self {
        Options {
            optimize: true,
            constraints: false,
        }
    }
}

impl Program {
    /// Checks and plans rules that include no file.
    ///
    /// ```
    /// use logicity_datalog::Program;
    ///
    /// let error = Program::parse(".decl road(x: symbol)\nroad(y).").unwrap_err();
    /// assert_eq!(error.diagnostics()[0].code.name(), "unbound-variable");
    /// assert!(error.to_string().contains(" --> program.dl:2:6"), "{error}");
    /// ```
    ///
    /// # Errors
    /// All errors and warnings, which print with the lines that they are about. Without an error, warnings are dropped;
    /// [`Program::load`] returns them, and reads included files.
    pub fn parse(source: &str) -> Result<Program, ProgramError> {
        let mut sources = Sources::new();
        let entry = sources.add("program.dl", source);
        let read = |_: &Path| Err(ReadError::Io("`Program::parse` includes no files".to_owned()));
        let (program, diagnostics) = Program::load(&mut sources, entry, &read);
        program.ok_or(ProgramError { diagnostics, sources })
    }

    /// Loads the rules of the source `entry` as [`load`](crate::load) does, and plans them.
    ///
    /// Returns the program with all errors and warnings; the program is `None` if any of them is an error.
    pub fn load(sources: &mut Sources, entry: SourceId, read: &dyn ReadFile) -> (Option<Program>, Vec<Diagnostic>) {
        Program::load_with(sources, entry, read, InputPolicy::Fixed)
    }

    /// Loads as [`Program::load`] does; `inputs` determines whether rules may derive `.input` predicates.
    pub fn load_with(
        sources: &mut Sources,
        entry: SourceId,
        read: &dyn ReadFile,
        inputs: InputPolicy,
    ) -> (Option<Program>, Vec<Diagnostic>) {
        let mut loaded = workspace::load_with(sources, entry, read, inputs);
        let program = loaded
            .rules
            .and_then(|rules| Program::new(rules).map_err(|fault| loaded.diagnostics.push(fault)).ok());
        (program, loaded.diagnostics)
    }

    /// Plans the evaluation of checked rules, with the default [`Options`].
    ///
    /// # Errors
    /// If a predicate has more than 32 columns, or a clause more than 128 variables or literals.
    pub fn new(rules: Rules) -> Result<Program, Diagnostic> {
        Program::with(rules, Options::default())
    }

    /// Plans as [`Program::new`] does, with the given options.
    ///
    /// The options do not change the answers, as long as the facts satisfy the constraints that
    /// [`Options::constraints`] relies on.
    ///
    /// # Errors
    /// As [`Program::new`].
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

    /// Returns the checked rules.
    pub fn rules(&self) -> &Rules {
        &self.0.rules
    }

    /// Returns whether sessions aggregate the rows of the predicate and do not store them.
    ///
    /// Such a predicate is the hidden one for the body of an aggregate. A session returns no rows of it and no changes.
    pub fn is_aggregated(&self, id: PredicateId) -> bool {
        let plans = &self.0.plans;
        plans.indexes.correlated(id).is_some() || plans.groupings.get(id.index()).is_some_and(Option::is_some)
    }

    /// Returns the predicate with that name, if the program declares it.
    pub fn predicate(&self, name: &str) -> Option<PredicateId> {
        self.0.rules.predicate(name)
    }
}

/// The reasons why rules are no program. Displays them with the lines that they are about.
#[derive(Clone)]
pub struct ProgramError {
    diagnostics: Vec<Diagnostic>,
    sources: Sources,
}

impl ProgramError {
    /// Returns the errors and warnings.
    pub fn diagnostics(&self) -> &[Diagnostic] {
        &self.diagnostics
    }

    /// Returns the sources that the diagnostics refer to.
    pub fn sources(&self) -> &Sources {
        &self.sources
    }
}

impl fmt::Display for ProgramError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(render(&self.diagnostics, &self.sources, false).trim_end())
    }
}

/// As [`Display`](fmt::Display), for errors that leave `main`.
impl fmt::Debug for ProgramError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "\n{self}")
    }
}

impl std::error::Error for ProgramError {}
