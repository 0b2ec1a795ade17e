//! Checked rules with evaluation plans.

use std::fmt;
use std::path::Path;
use std::sync::Arc;

use crate::check::{FunctorBatch, FunctorError, InputPolicy, Predicate, PredicateId, Rules, UserFunctor};
use crate::convert::{FromRow, ToValue, word_of};
use crate::diag::{Diagnostic, SourceId, Sources, did_you_mean, render};
use crate::files::{ReadError, ReadFile};
#[cfg(feature = "optimizer")]
use crate::plan::optimize;
use crate::plan::{Compiled, Plans};
use crate::value::Value;
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

    /// Defines a functor that the program declares: `.functor add(x: number, y: number): number`.
    ///
    /// The closure must return the same value for the same arguments. The engine calls it as often as it likes, from any
    /// thread. With `None` it has no value, and the literal that applies it does not hold. `String` takes and gives
    /// symbols, and records as text; see [`FromValue`](crate::FromValue).
    ///
    /// ```
    /// use logicity_datalog::Program;
    ///
    /// let program = Program::parse(
    ///     ".functor repeat(s: symbol, n: number): symbol
    ///      .decl word(s: symbol) word(\"ha\").
    ///      .decl laugh(s: symbol) laugh(@repeat(s, 3)) :- word(s).",
    /// )?;
    /// let program = program.define("repeat", |(s, n): (String, i64)| Some(s.repeat(n.try_into().ok()?)))?;
    /// let mut session = program.session();
    /// session.commit()?;
    /// assert!(session.contains("laugh", ("hahaha",)));
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// If the program declares no such functor, or one with other arguments.
    pub fn define<A, R>(
        self,
        functor: &str,
        value: impl Fn(A) -> Option<R> + Send + Sync + 'static,
    ) -> Result<Program, FunctorError>
    where
        A: for<'s> FromRow<'s>,
        R: ToValue,
    {
        let rules = self.rules();
        let declared = declared(rules, functor)?;
        let columns = declared.arguments.clone();
        let (ty, base, name) = (declared.result, declared.base, declared.name.clone());
        let shape = Predicate::made(name, columns.clone(), String::new(), declared.span);
        A::check(&shape, rules.symbols.word_size()).map_err(|error| FunctorError::Arguments {
            functor: functor.to_owned(),
            reason: error.to_string(),
        })?;
        let types = rules.types.clone();
        self.define_batch(functor, move |batch, values| {
            let symbols = batch.symbols();
            for call in 0..batch.len() {
                let word = match value(A::from_row(batch.row(call), &columns, symbols)) {
                    None => None,
                    Some(value) => {
                        let word = word_of(&value, (ty, base), &types, &symbols.encoder());
                        let misfit = || {
                            format!(
                                "{} is no value of type `{}`",
                                value.describe(),
                                types[ty.0 as usize].name
                            )
                        };
                        Some(word.ok_or_else(misfit)?)
                    }
                };
                values.push(word);
            }
            Ok(())
        })
    }

    /// Defines a functor for many calls at once: `values` receives a value for each call of the batch, in order, or `None`
    /// for no value. An `Err` with its reason ends the commit.
    ///
    /// The value is a word of the declared type. The rules of [`Program::define`] apply.
    ///
    /// # Errors
    /// If the program declares no such functor.
    pub fn define_batch(
        mut self,
        functor: &str,
        apply: impl Fn(&FunctorBatch<'_>, &mut Vec<Option<Value>>) -> Result<(), String> + Send + Sync + 'static,
    ) -> Result<Program, FunctorError> {
        declared(self.rules(), functor)?;
        let compiled = Arc::make_mut(&mut self.0);
        let mut functors = compiled.rules.functors.to_vec();
        if let Some(declared) = functors.iter_mut().find(|declared| declared.name == functor) {
            declared.define(apply);
        }
        compiled.rules.functors = functors.into();
        Ok(self)
    }

    /// Gives the functors the definitions that another program has.
    pub(crate) fn defined_as(mut self, other: &Program) -> Program {
        if self.rules().functors.is_empty() {
            return self;
        }
        let compiled = Arc::make_mut(&mut self.0);
        let functors = compiled.rules.functors.iter().cloned();
        compiled.rules.functors = functors
            .map(|functor| functor.defined_as(&other.rules().functors))
            .collect();
        self
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

fn declared<'r>(rules: &'r Rules, functor: &str) -> Result<&'r UserFunctor, FunctorError> {
    let found = rules.functors.iter().find(|declared| declared.name == functor);
    found.ok_or_else(|| FunctorError::Unknown {
        functor: functor.to_owned(),
        near: did_you_mean(functor, rules.functors.iter().map(|declared| declared.name.as_str())).map(str::to_owned),
    })
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
