//! The option `--given`: compares only rows for which a condition holds.
//!
//! The condition becomes the body of further clauses in a file that includes the rules:
//!
//! ```text
//! Stop_given(X) :- Stop(X), <condition>.
//! ```

use crate::builtin::BuiltinFiles;
use crate::cli::diff::{CORE_EFFORT, in_city};
use crate::cli::failure::Failure;
use crate::cli::load::{inputs_of, load_workspace_from};
use crate::cli::souffle::SouffleOptions;
use crate::datalog::codes;
use crate::datalog::diff::{Difference, Equivalence, Options, diff, unsat_core};
use crate::datalog::{BaseType, Clause, Comparison, InputPolicy, Literal, Rules, Term, VarId, is_name, quoted};
use crate::diag::{Diagnostic, SourceId, Sources, Span};
use crate::files::{ReadError, ReadFile};
use crate::sim::CityTheory;
use std::collections::{BTreeSet, HashSet};
use std::path::{Path, PathBuf};

/// The option with the condition, which also names the condition in diagnostics.
const OPTION: &str = "--given";

/// The end of the names of predicates with the rows for which the condition of `--given` holds.
const GIVEN: &str = "_given";

/// The further ends of names: predicates of any rows, and of those for which the condition holds.
const ANY: &str = "_any";
const ROW: &str = "_row";

/// The names of the columns in the condition of `--given`.
const COLUMNS: [&str; 6] = ["X", "Y", "Z", "V", "W", "U"];

/// Returns the two programs with further predicates: the rows of the compared ones for which the condition holds. Also
/// returns the names of the predicates to compare.
///
/// # Errors
/// If the condition is faulty or never holds.
pub fn restrict(
    sources: &mut Sources,
    paths: &[PathBuf; 2],
    sides: [Rules; 2],
    predicates: &[String],
    condition: &str,
    theory: Option<&CityTheory>,
) -> Result<([Rules; 2], Vec<String>), Failure> {
    let mut predicates = compared(predicates, &sides);
    // A full stop ends the clause that contains the condition.
    let condition = condition.trim().trim_end_matches('.').trim_end();
    let condition = sources.add(OPTION, condition);
    let mut restrict = |path: &Path, rules: &Rules| -> Result<Rules, Failure> {
        Ok(in_city(
            restricted(sources, path, rules, &predicates, condition)?,
            theory,
        ))
    };
    let sides = [restrict(&paths[0], &sides[0])?, restrict(&paths[1], &sides[1])?];
    refuse_vacuous(&sides, &predicates, condition, sources)?;
    // `diff` reports a predicate that a side lacks, so it gets the name that the user knows.
    for name in &mut predicates {
        let restricted = format!("{name}{GIVEN}");
        if sides.iter().all(|side| side.predicate(&restricted).is_some()) {
            *name = restricted;
        }
    }
    Ok((sides, predicates))
}

/// Gives the rows of a difference the names of the predicates that the user compares.
pub fn restore_names(difference: &mut Difference) {
    for (name, _) in difference.derived.iter_mut().flatten() {
        if let Some(original) = name.strip_suffix(GIVEN) {
            *name = original.to_owned();
        }
    }
}

/// Returns the predicates to compare: the given ones, or the outputs of either side.
fn compared(predicates: &[String], sides: &[Rules; 2]) -> Vec<String> {
    if !predicates.is_empty() {
        return predicates.to_vec();
    }
    let outputs = sides
        .iter()
        .flat_map(|rules| rules.predicates.iter().filter(|predicate| predicate.output));
    let names: BTreeSet<&String> = outputs.map(|predicate| &predicate.name).collect();
    names.into_iter().cloned().collect()
}

/// Refuses a condition that holds for no row of any of the predicates: a comparison would compare nothing.
fn refuse_vacuous(
    sides: &[Rules; 2],
    predicates: &[String],
    condition: SourceId,
    sources: &Sources,
) -> Result<(), Failure> {
    let mut given: Vec<String> = Vec::new();
    for rules in sides {
        for name in predicates {
            let row = format!("{name}{GIVEN}{ROW}");
            let Some(predicate) = rules.predicate(&row) else {
                continue;
            };
            let mut never = rules.clone();
            for clause in never
                .clauses
                .iter_mut()
                .filter(|clause| clause.head.predicate == predicate)
            {
                let (Some(&left), span) = (clause.head.terms.first(), clause.span) else {
                    continue;
                };
                clause.body.push(Literal::Compare {
                    op: Comparison::NotEqual,
                    left,
                    right: left,
                    base: BaseType::Symbol,
                    span,
                });
            }
            let options = Options {
                predicates: vec![row],
                conflicts_max: CORE_EFFORT,
                minimize: false,
                ..Options::default()
            };
            match diff(rules, &never, &options)? {
                Equivalence::Equivalent { .. } => {
                    let core = unsat_core(rules, &never, &options)?;
                    given.extend(core.into_iter().map(|(one, rules)| one.show(rules, sources)));
                }
                _ => return Ok(()),
            }
        }
    }
    let whole = Span::new(condition, 0..sources.text(condition).len());
    let message = "the condition of `--given` never holds, so nothing would be compared";
    let fault = Diagnostic::new(codes::RULE_MISMATCH, message).at(whole, "holds for no row");
    let mut known = HashSet::new();
    let given = given.into_iter().filter(|one| known.insert(one.clone()));
    let fault = given.fold(fault, |fault, one| fault.note(format!("given {one}")));
    Err(Failure::option(vec![fault]))
}

/// Returns the program with, for each of the predicates, one more predicate: its rows for which a condition holds.
fn restricted(
    sources: &mut Sources,
    path: &Path,
    rules: &Rules,
    predicates: &[String],
    condition: SourceId,
) -> Result<Rules, Failure> {
    let file = path
        .file_name()
        .map_or_else(String::new, |name| name.to_string_lossy().into_owned());
    let mut overlay = Overlay {
        path: path.parent().unwrap_or(Path::new("")).join(OPTION),
        text: format!(".include {}\n.scope\n", quoted(&file)),
        conditions: Vec::new(),
    };
    for name in predicates {
        let Some(predicate) = rules.predicate(name).map(|id| &rules.predicates[id.index()]) else {
            continue;
        };
        if predicate.columns.len() > COLUMNS.len() {
            let message = format!("--given: `{name}` has more than {} columns", COLUMNS.len());
            return Err(Failure::Usage(message));
        }
        let types = predicate
            .columns
            .iter()
            .map(|column| &rules.types[column.ty.0 as usize].name);
        let columns: Vec<String> = COLUMNS
            .iter()
            .zip(types)
            .map(|(name, ty)| format!("{name}: {ty}"))
            .collect();
        let row = COLUMNS[..predicate.columns.len()].join(", ");
        let columns = columns.join(", ");
        overlay.text += &format!(
            ".decl {name}{GIVEN}, {name}{GIVEN}{ANY}, {name}{GIVEN}{ROW}({columns})\n.output {name}{GIVEN}\n.input \
             {name}{GIVEN}{ANY}\n"
        );
        let any = format!("{name}{GIVEN}{ANY}");
        for (head, source) in [(String::new(), name), (ROW.to_owned(), &any)] {
            overlay.text += &format!("{name}{GIVEN}{head}({row}) :- {source}({row}), ");
            overlay.conditions.push(overlay.text.len());
            overlay.text += sources.text(condition);
            overlay.text += ".\n";
        }
    }
    let mut workspace = load_workspace_from(
        sources,
        &overlay.path,
        InputPolicy::Fixed,
        &SouffleOptions::default(),
        &overlay,
    )?;
    workspace.set_inputs(inputs_of(&workspace, false));
    let entry = overlay.path.display().to_string();
    let entry = sources.ids().filter(|&id| sources.name(id) == entry).last();
    let place = Typed {
        overlay: &overlay,
        entry: entry.expect("the workspace has read the overlay"),
        condition,
        length: sources.text(condition).len(),
    };
    let loaded = workspace.check();
    let Some(checked) = loaded.rules else {
        // Warnings of the rules say nothing about the condition.
        let errors = loaded.diagnostics.into_iter().filter(Diagnostic::is_error);
        return Err(Failure::option(place.faults(errors.collect())));
    };
    for name in predicates {
        let restricted = checked.predicate(&format!("{name}{GIVEN}"));
        let clauses = (checked.clauses.iter()).filter(|clause| Some(clause.head.predicate) == restricted);
        let loose: Vec<Diagnostic> = clauses.flat_map(|clause| loose_variables(clause, name)).collect();
        if !loose.is_empty() {
            return Err(Failure::option(place.faults(loose)));
        }
    }
    Ok(checked)
}

/// Returns the faults of variables in a condition that are neither columns nor related to one by literals: the
/// condition only says that some value of them exists. A variable that begins with `_` is meant so.
fn loose_variables(clause: &Clause, predicate: &str) -> Vec<Diagnostic> {
    let mut related = vec![false; clause.variables.len()];
    let columns = clause.head.terms.iter().filter_map(Term::variable);
    let columns: Vec<usize> = columns.map(VarId::index).collect();
    columns.iter().for_each(|&column| related[column] = true);
    let literals: Vec<Vec<usize>> = (clause.body.iter())
        .map(|literal| literal.variables().map(VarId::index).collect())
        .collect();
    let mut grows = true;
    while std::mem::take(&mut grows) {
        for literal in &literals {
            if literal.iter().any(|&variable| related[variable]) {
                for &variable in literal {
                    grows |= !std::mem::replace(&mut related[variable], true);
                }
            }
        }
    }
    let columns: Vec<&str> = columns
        .iter()
        .map(|&column| clause.variables[column].as_str())
        .collect();
    let listed = match columns.as_slice() {
        [] => format!("`{predicate}` has no columns"),
        [column] => format!("the column of `{predicate}` is `{column}`"),
        columns => format!("the columns of `{predicate}` are `{}`", columns.join("`, `")),
    };
    let twin = |name: &str| {
        columns
            .iter()
            .find(|column| column.to_lowercase() == name.to_lowercase())
    };
    let named = clause.variables.iter().zip(&clause.variable_spans).enumerate();
    let loose = named.filter(|(index, (name, _))| {
        is_name(name)
            && !name.starts_with('_')
            && !columns.contains(&name.as_str())
            && (!related[*index] || twin(name).is_some())
    });
    loose
        .map(|(_, (name, span))| {
            let message = format!("`{name}` in the condition is not a column of `{predicate}`");
            let fault = Diagnostic::new(codes::RULE_MISMATCH, message)
                .at(*span, "stands for any value")
                .note(listed.clone());
            match twin(name) {
                Some(column) => fault.help(format!("did you mean `{column}`?")),
                None => fault.help("name a column, or write `_` for any value"),
            }
        })
        .collect()
}

/// Faults of the overlay as faults of the condition that the user typed.
struct Typed<'o> {
    overlay: &'o Overlay,
    entry: SourceId,
    condition: SourceId,
    length: usize,
}

impl Typed<'_> {
    /// Returns the faults at their places in the condition. Several predicates have the same condition, so equal faults
    /// and labels occur once.
    fn faults(&self, faults: Vec<Diagnostic>) -> Vec<Diagnostic> {
        let mut placed: Vec<Diagnostic> = Vec::new();
        for mut fault in faults {
            for label in fault.primary.iter_mut().chain(&mut fault.secondary) {
                label.span = self.place(label.span);
            }
            let mut known: Vec<Span> = fault.primary.iter().map(|label| label.span).collect();
            fault.secondary.retain(|label| {
                let is_new = !known.contains(&label.span);
                known.push(label.span);
                is_new
            });
            // The edits concern the overlay.
            fault.fixes.clear();
            if !placed.contains(&fault) {
                placed.push(fault);
            }
        }
        placed
    }

    /// Returns a place in the condition: the whole one for a place in another part of the overlay.
    fn place(&self, span: Span) -> Span {
        if span.source != self.entry {
            return span;
        }
        let (from, to) = (span.start as usize, span.end as usize);
        let within = |start: &&usize| (**start..=**start + self.length).contains(&from);
        match self.overlay.conditions.iter().find(within) {
            Some(start) => Span::new(self.condition, from - start..(to - start).min(self.length)),
            None => Span::new(self.condition, 0..self.length),
        }
    }
}

/// One more file beside those on disk and the built-in ones.
struct Overlay {
    path: PathBuf,
    text: String,
    /// The offsets of the condition in the text, once per predicate.
    conditions: Vec<usize>,
}

impl ReadFile for Overlay {
    fn read(&self, path: &Path) -> Result<String, ReadError> {
        if path == self.path {
            return Ok(self.text.clone());
        }
        match BuiltinFiles.read(path) {
            Err(ReadError::NotFound) => BuiltinFiles.read_or_builtin(path),
            read => read,
        }
    }

    fn builtin_paths(&self) -> Vec<String> {
        BuiltinFiles.builtin_paths()
    }

    fn names_in(&self, folder: &Path) -> Vec<String> {
        BuiltinFiles.names_in(folder)
    }
}
