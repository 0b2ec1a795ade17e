//! The state of a prompt: sources, the program they form, and a session with its facts.
//!
//! ```text
//! files, typed sources --Workspace--> Rules --> Program --> Session <-- facts: typed, or read from a folder
//! ```
//!
//! A change either succeeds as a whole or has no effect. Changes to facts of predicates without rules commit to the
//! session; other changes build a new program, and the facts move to its session. `.tick` is the exception: the ticks
//! before a failure stay.
// Decision: docs/decisions/tools.md#d030

use crate::builtin::BuiltinFiles;
use crate::cancel::Cancel;
use crate::cli::failure::Failure;
use crate::cli::inputs::read;
use crate::cli::kind::Kind;
use crate::cli::query;
use crate::cli::query::Times;
use crate::cli::souffle::SouffleOptions;
use crate::config::rule_file;
use crate::datalog;
use crate::datalog::codes;
use crate::datalog::{
    BaseType, Functor, InputPolicy, Predicate, PredicateId, Rules, Value, Workspace, ast, internal::record_source,
};
use crate::datalog::{Delta, Limits, Loaded, Program, RowError, Session, facts};
use crate::diag::{Diagnostic, SourceId, Sources, Span};
use crate::symbol::Symbol;
use indexmap::IndexMap;
use std::collections::{BTreeSet, HashSet};
use std::path::{Path, PathBuf};

pub struct Workbench<'s> {
    pub sources: &'s mut Sources,
    pub workspace: Workspace,
    options: SouffleOptions,
    pub session: Session,
    /// Times of the last change.
    pub times: Times,
    limits: Limits,
    files: Vec<PathBuf>,
    made: Made,
}

/// The changes to the sources besides loading files.
#[derive(Clone, Default)]
struct Made {
    /// Texts that the user typed.
    typed: Vec<SourceId>,
    /// Heads of retracted clauses.
    retracted: HashSet<Span>,
}

/// The numbers of rows that a change added to and removed from a predicate.
pub struct Changed {
    pub predicate: String,
    pub added: usize,
    pub removed: usize,
}

/// The result of a change.
#[derive(Default)]
pub struct Outcome {
    pub changes: Vec<Changed>,
    pub warnings: Vec<Diagnostic>,
    /// Effects that the user may not expect.
    pub notes: Vec<String>,
}

/// The answer to a question.
pub struct Answer {
    pub session: Session,
    pub times: Times,
    pub predicate: PredicateId,
    pub warnings: Vec<Diagnostic>,
}

impl<'s> Workbench<'s> {
    /// Returns a workbench without sources.
    pub fn new(sources: &'s mut Sources, limits: Limits, options: SouffleOptions) -> Result<Self, Failure> {
        let workspace = options.workspace(InputPolicy::Extensible);
        let loaded = workspace.check();
        let rules = loaded.rules.ok_or(loaded.diagnostics)?;
        Ok(Workbench {
            sources,
            workspace,
            options,
            session: Program::new(rules)?.session(),
            times: Times::default(),
            limits,
            files: Vec::new(),
            made: Made::default(),
        })
    }

    /// Adds rule files. [`Workbench::reload`] reads them again, even if they are faulty now.
    pub fn load(&mut self, paths: &[PathBuf]) -> Result<Outcome, Failure> {
        let new: Vec<PathBuf> = paths
            .iter()
            .map(|path| rule_file(path, &BuiltinFiles))
            .filter(|path| !self.files.contains(path))
            .collect();
        let first_new = self.sources.ids().count();
        let mut workspace = self.workspace.clone();
        for path in &new {
            let text = read(path)?;
            if let Some(fault) = Kind::Rules.mismatch(path, &text) {
                return Err(fault.into());
            }
            let entry = self.sources.add(path.display().to_string(), text);
            workspace.add(self.sources, entry, &BuiltinFiles);
        }
        self.files.extend(new);
        self.adopt(workspace, self.made.clone(), first_new)
    }

    /// Reloads all files. Typed sources stay; clauses and facts retracted from files return.
    pub fn reload(&mut self) -> Result<Outcome, Failure> {
        let first_new = self.sources.ids().count();
        let mut workspace = self.options.workspace(InputPolicy::Extensible);
        for path in &self.files {
            let text = read(path)?;
            let entry = self.sources.add(path.display().to_string(), text);
            workspace.add(self.sources, entry, &BuiltinFiles);
        }
        for &typed in &self.made.typed {
            workspace.add(self.sources, typed, &BuiltinFiles);
        }
        workspace.remove_heads(&self.made.retracted);
        self.adopt(workspace, self.made.clone(), first_new)
    }

    /// Reads the facts of all input predicates from a folder.
    pub fn load_facts(&mut self, folder: &Path) -> Result<Outcome, Failure> {
        let every = query::every_predicate(self.session.program());
        let loaded = query::load_inputs(folder, &mut self.session, &every, self.sources);
        self.commit(loaded)
    }

    /// Advances by a number of ticks. The outcome sums the changes of all of them.
    pub fn tick(&mut self, ticks: u32) -> Result<Outcome, Failure> {
        let mut outcome = Outcome::default();
        let mut counts: IndexMap<String, (usize, usize)> = IndexMap::new();
        for _ in 0..ticks {
            let (delta, times) = query::timed_advance(&mut self.session)
                .map_err(|fault| fault.note(format!("in tick {}; earlier ticks stay", self.session.tick())))?;
            self.times = times;
            for change in self.changes(&delta) {
                let (added, removed) = counts.entry(change.predicate).or_default();
                *added += change.added;
                *removed += change.removed;
            }
        }
        let of = |(predicate, (added, removed))| Changed {
            predicate,
            added,
            removed,
        };
        outcome.changes = counts.into_iter().map(of).collect();
        outcome.notes.push(format!("tick {}", self.session.tick()));
        Ok(outcome)
    }

    /// Adds a source of facts, clauses, declarations and directives.
    pub fn add(&mut self, id: SourceId) -> Result<Outcome, Failure> {
        let rules = self.session.program().rules();
        let rows = self.workspace.facts(self.sources, id, self.session.symbols())?;
        if rows.as_ref().is_some_and(Vec::is_empty) {
            return Ok(Outcome::default()); // a comment
        }
        if let Some(rows) = rows
            && rows
                .iter()
                .all(|(predicate, _)| !rules.predicates[predicate.index()].derived)
        {
            let inserted = rows
                .iter()
                .try_for_each(|(predicate, row)| self.session.insert(*predicate, row));
            return self.commit(inserted.map_err(not_taken));
        }
        let first_new = self.sources.ids().count() - 1;
        let (mut workspace, mut made) = (self.workspace.clone(), self.made.clone());
        workspace.add(self.sources, id, &BuiltinFiles);
        made.typed.push(id);
        self.adopt(workspace, made, first_new)
    }

    /// Retracts facts or clauses.
    pub fn retract(&mut self, id: SourceId) -> Result<Outcome, Failure> {
        if let Some(rows) = self.workspace.facts(self.sources, id, self.session.symbols())? {
            return self.retract_facts(id, &rows);
        }
        let parsed = datalog::parse(self.sources, id);
        if !parsed.diagnostics.is_empty() {
            return Err(parsed.diagnostics.into());
        }
        let mut places = HashSet::new();
        for item in &parsed.file.items {
            let ast::Item::Clause(clause) = item else {
                let fault = Diagnostic::new(codes::UNSUPPORTED, "only facts and clauses can be retracted");
                let whole = Span::new(id, 0..self.sources.text(id).len());
                let help = "remove it from the file, and `.reload`";
                return Err(fault.at(whole, "").help(help).into());
            };
            let found = self.workspace.find(clause);
            if found.is_empty() {
                let fault = Diagnostic::new(codes::INVALID_FACT, "no such clause");
                let help = "`.show` prints the clauses of a predicate; variable names do not matter";
                return Err(fault.at(clause.place.0, "").help(help).into());
            }
            places.extend(found);
        }
        self.take_out(places)
    }

    fn retract_facts(&mut self, id: SourceId, rows: &[(PredicateId, Vec<Value>)]) -> Result<Outcome, Failure> {
        let rules = self.session.program().rules();
        let whole = Span::new(id, 0..self.sources.text(id).trim_end().len());
        let mut in_text = HashSet::new();
        let mut given: Vec<(PredicateId, &[Value])> = Vec::new();
        for (predicate, row) in rows {
            let stated = rules
                .clauses
                .iter()
                .filter(|clause| clause.head.predicate == *predicate);
            let stated = stated.filter(|clause| constants(clause).as_ref() == Some(row));
            let before = in_text.len();
            in_text.extend(stated.map(|clause| clause.head.span));
            if in_text.len() > before {
                continue;
            }
            let Predicate { name, derived, .. } = &rules.predicates[predicate.index()];
            if *derived {
                let message = format!("rules derive `{name}`, and no source states this fact");
                let fault = Diagnostic::new(codes::INVALID_FACT, message).at(whole, "");
                return Err(fault.help("if it holds, `explain` prints its proof").into());
            }
            if self.session.contains(*predicate, row) {
                given.push((*predicate, row));
            } else {
                let fault = Diagnostic::new(codes::INVALID_FACT, "this fact does not hold");
                return Err(fault.at(whole, "").into());
            }
        }
        let retracted = (given.iter()).try_for_each(|&(predicate, row)| self.session.retract(predicate, row));
        let mut outcome = self.commit(retracted.map_err(not_taken))?;
        if in_text.is_empty() {
            return Ok(outcome);
        }
        match self.take_out(in_text) {
            Ok(further) => {
                outcome.changes.extend(further.changes);
                outcome.notes = further.notes;
                Ok(outcome)
            }
            Err(failure) => {
                let back = (given.iter()).try_for_each(|&(predicate, row)| self.session.insert(predicate, row));
                self.commit(back.map_err(not_taken))?;
                Err(failure)
            }
        }
    }

    fn take_out(&mut self, heads: HashSet<Span>) -> Result<Outcome, Failure> {
        let (mut workspace, mut made) = (self.workspace.clone(), self.made.clone());
        workspace.remove_heads(&heads);
        made.retracted.extend(heads);
        let first_new = self.sources.ids().count();
        self.adopt(workspace, made, first_new)
    }

    /// Commits the pending facts, unless noting them failed.
    fn commit(&mut self, noted: Result<(), Failure>) -> Result<Outcome, Failure> {
        match noted.and_then(|()| Ok(query::timed_commit(&mut self.session)?)) {
            Ok((delta, times)) => {
                self.times = times;
                let nothing = delta.is_empty().then(|| "no fact changed".to_owned());
                Ok(Outcome {
                    changes: self.changes(&delta),
                    notes: nothing.into_iter().collect(),
                    ..Outcome::default()
                })
            }
            Err(failure) => {
                self.session.rollback();
                Err(failure)
            }
        }
    }

    fn changes(&self, delta: &Delta) -> Vec<Changed> {
        let rules = self.session.program().rules();
        let shown = delta
            .changes()
            .iter()
            .filter(|change| !rules.predicates[change.predicate.index()].hidden);
        shown
            .map(|change| Changed {
                predicate: rules.predicates[change.predicate.index()].name.clone(),
                added: change.added.len(),
                removed: change.removed.len(),
            })
            .collect()
    }

    /// Makes the sources of `workspace` the program and moves the facts to it. Reports only warnings about sources from
    /// number `first_new` on.
    fn adopt(&mut self, mut workspace: Workspace, mut made: Made, first_new: usize) -> Result<Outcome, Failure> {
        let new: HashSet<SourceId> = self.sources.ids().skip(first_new).collect();
        let (mut rules, mut warnings) = checked(&workspace, &new, self.sources)?;
        let stated = self.stated_from_now_on(&rules);
        if !stated.is_empty() {
            for (name, text) in stated {
                let id = self.sources.add(format!("<facts of {name}>"), text);
                workspace.add(self.sources, id, &BuiltinFiles);
                made.typed.push(id);
            }
            (rules, warnings) = checked(&workspace, &new, self.sources)?;
        }
        let mut session = Program::new(rules)?.session();
        session.set_limits(self.limits);
        let mut notes = self.move_facts(&mut session);
        if self.session.tick() > 0 {
            notes.push("the rules have changed: tick 0 begins again, and earlier ticks are forgotten".to_owned());
        }
        let (_, times) = query::timed_commit(&mut session)?;

        let outcome = Outcome {
            changes: compare(&self.session, &session),
            warnings,
            notes,
        };
        (self.workspace, self.made, self.session, self.times) = (workspace, made, session, times);
        Ok(outcome)
    }

    /// Returns the facts of predicates that will have rules, as text, because a session takes no facts for those.
    fn stated_from_now_on(&self, rules: &Rules) -> Vec<(String, String)> {
        let derived = |name: &str| {
            rules
                .predicate(name)
                .is_some_and(|id| rules.predicates[id.index()].derived)
        };
        let old = self.session.program().rules();
        let mut stated = Vec::new();
        for (id, declared) in query::predicates(self.session.program()) {
            if old.predicates[id.index()].derived || !derived(&declared.name) {
                continue;
            }
            let items = self.given(id).into_iter().map(|row| {
                let place = ast::Place(declared.span);
                let term = |(column, value): (&datalog::Column, &Value)| ast::Term {
                    kind: self.written(*value, column.base, place),
                    place,
                };
                let head = ast::Atom {
                    predicate: ast::Name {
                        text: declared.name.clone(),
                        place,
                    },
                    terms: declared.columns.iter().zip(&row).map(term).collect(),
                    place,
                };
                ast::Item::Clause(ast::Clause {
                    heads: vec![head],
                    probabilities: Vec::new(),
                    body: Vec::new(),
                    doc: String::new(),
                    place,
                })
            });
            let file = ast::File { items: items.collect() };
            if !file.items.is_empty() {
                stated.push((declared.name.clone(), datalog::print(&file)));
            }
        }
        stated
    }

    fn written(&self, value: Value, base: BaseType, place: ast::Place) -> ast::TermKind {
        match base {
            BaseType::Symbol => ast::TermKind::Symbol(self.text(value).to_owned()),
            BaseType::Number => ast::TermKind::Number(value.to_number(self.session.symbols()).into()),
            BaseType::Unsigned => ast::TermKind::Unsigned(value.to_unsigned(self.session.symbols())),
            // The tree is only printed.
            BaseType::Record => ast::TermKind::Variable(record_source(value, self.session.symbols())),
            BaseType::Float => {
                let text = datalog::internal::shown_number(base, value, self.session.symbols());
                match value.to_float(self.session.symbols()).is_finite() {
                    true => ast::TermKind::Float(text),
                    false => {
                        let text = ast::Term {
                            kind: ast::TermKind::Symbol(text),
                            place,
                        };
                        ast::TermKind::Functor(Functor::ToFloat, vec![text])
                    }
                }
            }
        }
    }

    fn text(&self, value: Value) -> &str {
        self.session.symbols().resolve(Symbol(value.0)).unwrap_or_default()
    }

    /// Returns the rows of a predicate without rules that no source states.
    fn given(&self, id: PredicateId) -> Vec<Vec<Value>> {
        let clauses = &self.session.program().rules().clauses;
        let stated: BTreeSet<Vec<Value>> = (clauses.iter())
            .filter(|clause| clause.head.predicate == id)
            .filter_map(constants)
            .collect();
        let given = self.session.encoded_rows(id).filter(|row| !stated.contains(*row));
        given.map(<[Value]>::to_vec).collect()
    }

    /// Copies the facts to another session. Returns notes about facts that do not fit there.
    fn move_facts(&self, to: &mut Session) -> Vec<String> {
        let mut notes = Vec::new();
        let old = self.session.program().rules();
        // The session itself keeps what rules read of earlier ticks and of draws.
        let is_kept = |id| old.chance == Some(id) || old.pasts.iter().any(|past| past.predicate == id);
        for (id, predicate) in query::predicates(self.session.program()) {
            if predicate.derived || is_kept(id) {
                continue;
            }
            let given = self.given(id);
            if given.is_empty() {
                continue;
            }
            let rules = to.program().rules();
            let bases = |columns: &[datalog::Column]| columns.iter().map(|column| column.base).collect::<Vec<_>>();
            let place = rules.predicate(&predicate.name).filter(|id| {
                let new = &rules.predicates[id.index()];
                bases(&new.columns) == bases(&predicate.columns)
            });
            let Some(place) = place else {
                let name = &predicate.name;
                notes.push(format!(
                    "dropped {} facts of `{name}`: its declaration has changed or is gone",
                    given.len()
                ));
                continue;
            };
            if rules.predicates[place.index()].derived {
                continue; // The source contains them now.
            }
            for mut row in given {
                for (value, column) in row.iter_mut().zip(&predicate.columns) {
                    *value = datalog::internal::moved(*value, column.base, self.session.symbols(), to.symbols());
                }
                to.insert(place, &row).expect("predicate and columns fit");
            }
        }
        notes
    }

    /// Answers a question by evaluating its rules on the rows of the predicates that it names.
    pub fn ask(&self, id: SourceId) -> Result<Answer, Failure> {
        let (program, warnings) = self.compile_question(id)?;
        let mut session =
            (self.session.query(&program, &Cancel::never())).map_err(|error| error.diagnostic(program.rules()))?;
        let (_, times) = query::timed_commit(&mut session)?;
        let predicate = program
            .predicate(Workspace::ANSWER)
            .expect("every question has an answer");
        Ok(Answer {
            session,
            times,
            predicate,
            warnings,
        })
    }

    /// Returns the program that answers a question.
    pub fn compile_question(&self, id: SourceId) -> Result<(Program, Vec<Diagnostic>), Failure> {
        let loaded = self.workspace.ask(self.sources, id, self.session.symbols().clone());
        let Some(rules) = loaded.rules else {
            return Err(loaded.diagnostics.into());
        };
        Ok((Program::new(rules)?, loaded.diagnostics))
    }
}

/// Returns the rules of the sources, and the warnings about the new ones.
///
/// # Errors
/// All errors, and the warnings about the new sources.
fn checked(
    workspace: &Workspace,
    new: &HashSet<SourceId>,
    sources: &Sources,
) -> Result<(Rules, Vec<Diagnostic>), Vec<Diagnostic>> {
    let Loaded {
        rules, mut diagnostics, ..
    } = workspace.check();
    let is_new = |fault: &Diagnostic| {
        // A predicate without rows may get some later.
        fault.code != codes::DEAD_CLAUSE
            && (fault.primary.as_ref()).is_none_or(|label| new.contains(&sources.written(label.span).source))
    };
    diagnostics.retain(|fault| fault.is_error() || is_new(fault));
    match rules {
        Some(rules) => Ok((rules, diagnostics)),
        None => Err(diagnostics),
    }
}

fn not_taken(error: RowError) -> Failure {
    Diagnostic::new(codes::INVALID_FACT, error.to_string()).into()
}

/// Returns the row of a fact in the source.
fn constants(clause: &datalog::Clause) -> Option<Vec<Value>> {
    if !clause.body.is_empty() {
        return None;
    }
    let constant = |term: &datalog::Term| match term {
        datalog::Term::Constant(value) => Some(*value),
        _ => None,
    };
    clause.head.terms.iter().map(constant).collect()
}

/// Compares two sessions: counts for each predicate the rows only in the new and only in the old one. Predicates with
/// different column types share no rows.
fn compare(old: &Session, new: &Session) -> Vec<Changed> {
    let bases = |predicate: &Predicate| predicate.columns.iter().map(|column| column.base).collect::<Vec<_>>();
    let mut changes = Vec::new();
    for (id, predicate) in query::predicates(new.program()).filter(|(_, predicate)| !predicate.hidden) {
        let before = old.program().predicate(&predicate.name);
        let twin = before.filter(|twin| bases(&old.program().rules().predicates[twin.index()]) == bases(predicate));
        let kept = twin.map_or(0, |twin| {
            let texts = |session: &Session, row: &[Value]| -> Vec<String> {
                let columns = row.iter().zip(&predicate.columns);
                columns
                    .map(|(value, column)| facts::print_value(session, *value, column.base))
                    .collect()
            };
            let known: HashSet<Vec<String>> = old.encoded_rows(twin).map(|row| texts(old, row)).collect();
            new.encoded_rows(id)
                .filter(|row| known.contains(&texts(new, row)))
                .count()
        });
        let (added, removed) = (new.len(id) - kept, before.map_or(0, |before| old.len(before)) - kept);
        if added + removed > 0 {
            changes.push(Changed {
                predicate: predicate.name.clone(),
                added,
                removed,
            });
        }
    }
    changes
}
