//! Tasks in the format of the learner Popper: background knowledge, examples and a bias, as Prolog text.
//!
//! A task has one target predicate, function-free background knowledge and no recursion. The reader evaluates rules of
//! the background knowledge with the Datalog engine, and indexes all facts in a [`Database`]. A clause can refer to the
//! constants that facts link to those of an example. With `direction` declarations, a fact leads from its inputs to its
//! outputs.
//!
//! If all predicates have `type` declarations, equal constants of different types are different constants. The bias can
//! then also require that a clause has one variable of a type, as in
//! `:- clause(C), #count{V : var_type(C,V,state)} != 1.`: that of the head. A rule such as
//! `bad_body(p,Vars) :- vars(_,Vars), Vars = (V0,_), V0 != 0.` requires a variable of the head as an argument.
//!
//! ```
//! use logicity::cancel::Cancel;
//! use logicity::diag::Sources;
//! use logicity::popper::{Files, Options, read};
//!
//! let mut sources = Sources::new();
//! let files = Files {
//!     background: sources.add("bk.pl", "parent(ann,bo). parent(bo,cy). parent(bo,di). parent(eve,ann)."),
//!     examples: sources.add("exs.pl", "pos(old(ann,cy)). pos(old(eve,bo)). neg(old(ann,bo)). neg(old(cy,ann))."),
//!     bias: sources.add("bias.pl", "head_pred(old,2). body_pred(parent,2). max_vars(3)."),
//! };
//! let (task, _) = read(&sources, &files, &Options::default());
//! let task = task.ok_or("the texts are a task")?;
//! let solution = task.solve(|_| true, &task.settings(), &|_| (), &Cancel::never());
//! assert_eq!(task.clauses(&solution.rules), ["old(X, Y) :- parent(X, Z), parent(Z, Y)."]);
//! # Ok::<(), &str>(())
//! ```

mod background;
mod bias;
mod print;
mod prolog;
mod tokens;

use crate::cancel::Cancel;
use crate::datalog::Limits;
use crate::datalog::codes;
use crate::diag::{self, Diagnostic, Faults, SourceId, Sources, Span};
use crate::induce::{
    ActionRules, Body, Database, Literal, Predicate, Progress, Settings, VARIABLES_MAX, Vocabulary, derived,
    learn_relational, undecided,
};
use background::{Background, Key, unknown};
use bias::Bias;
use indexmap::map::Entry;
use indexmap::{IndexMap, IndexSet};
pub use print::TargetProgram;
use prolog::{Directives, Kind, Term, parse};
use std::collections::BTreeSet;

/// The maximum number of examples that [`Options::closed_world`] makes.
const CLOSED_WORLD_MAX: usize = 10_000;

/// The sources of a task.
#[derive(Clone, Copy, Debug)]
pub struct Files {
    /// The facts and rules, `bk.pl`.
    pub background: SourceId,
    /// The examples, `exs.pl`.
    pub examples: SourceId,
    /// The declarations, `bias.pl`.
    pub bias: SourceId,
}

/// How to read a task.
#[derive(Clone, Copy, Debug, Default)]
pub struct Options {
    /// Whether the target is false for all arguments that are not in a positive example. An argument is a constant of
    /// its declared type, or any constant if it has none.
    pub closed_world: bool,
    /// The maximum number of variables of a clause, if fewer than in the bias.
    pub variables: Option<usize>,
    /// The limits of evaluating the rules of the background knowledge.
    pub limits: Limits,
}

/// An example of a task.
#[derive(Clone, Debug)]
pub struct Case {
    /// The arguments of the target.
    pub arguments: Vec<String>,
    /// Whether the target is true.
    pub is_positive: bool,
    /// The constants of the arguments in the database.
    head: Vec<u32>,
}

/// A task.
#[derive(Clone, Debug)]
pub struct Task {
    /// The target predicate.
    pub target: String,
    /// The facts of the predicates of bodies.
    pub database: Database,
    /// The examples in the order of the source.
    pub cases: Vec<Case>,
    /// The maximum number of variables of a clause.
    pub variables: usize,
    /// The constants of the database. Those of several types occur several times.
    constants: Vec<String>,
}

/// Reads a task. Returns it with all errors and warnings; the task is `None` if any of them is an error.
pub fn read(sources: &Sources, files: &Files, options: &Options) -> (Option<Task>, Vec<Diagnostic>) {
    let mut faults = Faults::default();
    let bias = Bias::read(sources, files.bias, &mut faults);
    let mut background = Background::read(sources, files.background, options.limits, &mut faults);
    for (key, span) in &bias.body {
        if !background.rows.contains_key(key) && !faults.failed() {
            faults.push(unknown(&background, key, *span));
        }
    }
    let mut labels = Labels::new();
    if let Some((target, _)) = &bias.head {
        for clause in parse(sources, files.examples, Directives::Goals, &mut faults) {
            let place = clause.span;
            match label(&clause.head, target) {
                Some((is_positive, terms)) if clause.body.is_empty() => match background.row(terms) {
                    Ok(row) => match labels.entry(row) {
                        Entry::Occupied(known) if known.get().0 != is_positive => {
                            let message = "an example is positive and negative".to_owned();
                            let fault = Diagnostic::new(codes::INVALID_FACT, message).at(place, "the second label");
                            faults.push(
                                fault
                                    .also(known.get().1, "the first label")
                                    .help("remove one of the two"),
                            );
                        }
                        Entry::Occupied(_) => {}
                        Entry::Vacant(entry) => {
                            entry.insert((is_positive, place));
                        }
                    },
                    Err(fault) => faults.push(fault),
                },
                _ => {
                    let (name, arity) = target;
                    let fault =
                        Diagnostic::new(codes::INVALID_FACT, format!("expected an example of `{name}/{arity}`"));
                    let arguments = if *arity == 1 { "argument" } else { "arguments" };
                    let help = format!("write `pos({name}(...)).` or `neg({name}(...)).` with {arity} {arguments}");
                    faults.push(fault.at(place, "not an example").help(help));
                }
            }
        }
    }
    let mut task = None;
    if !faults.failed() {
        match assemble(sources, files, options, &bias, &background, labels) {
            Ok(made) => task = Some(made),
            Err(list) => list.into_iter().for_each(|fault| faults.push(fault)),
        }
    }
    (task, faults.finish())
}

/// Splits an example into its label and the arguments of the target.
fn label<'a>(head: &'a Option<Term>, (name, arity): &(String, usize)) -> Option<(bool, &'a [Term])> {
    let Kind::Compound(label, inside) = &head.as_ref()?.kind else {
        return None;
    };
    let [
        Term {
            kind: Kind::Compound(found, terms),
            ..
        },
    ] = inside.as_slice()
    else {
        return None;
    };
    let is_positive = match label.as_str() {
        "pos" => true,
        "neg" => false,
        _ => return None,
    };
    (found == name && terms.len() == *arity).then_some((is_positive, terms))
}

/// The arguments of examples, with their labels and places.
type Labels = IndexMap<Box<[u32]>, (bool, Span)>;

fn assemble(
    sources: &Sources,
    files: &Files,
    options: &Options,
    bias: &Bias,
    background: &Background,
    mut labels: Labels,
) -> Result<Task, Vec<Diagnostic>> {
    let (target, arity) = bias.head.clone().map(|(key, _)| key).unwrap_or_default();
    let end = Span::new(
        files.examples,
        sources.text(files.examples).len()..sources.text(files.examples).len(),
    );
    if options.closed_world {
        close(bias, background, &mut labels, end)?;
    }
    for (wanted, name) in [(true, "positive"), (false, "negative")] {
        if !labels.values().any(|(is_positive, _)| *is_positive == wanted) {
            let fault = Diagnostic::new(codes::INVALID_FACT, format!("there is no {name} example"));
            let help = match wanted {
                true => "add `pos(...)` facts",
                false => "add `neg(...)` facts, or use `--closed-world` if all other arguments are negative examples",
            };
            return Err(vec![fault.at(end, "the end of the examples").help(help)]);
        }
    }
    let predicates = bias.body.keys().map(|(name, arity)| Predicate {
        name: name.clone(),
        arity: *arity,
        is_symmetric: false,
    });
    let vocabulary = Vocabulary::new(predicates.collect(), arity, None).linked(bias.links());
    // The constants of the database: those of the task with their types.
    let mut typed: IndexSet<(u32, Option<&str>)> = IndexSet::new();
    let types = bias.all_types();
    let mut row = |key: &Key, row: &[u32]| -> Vec<u32> {
        let types = types.as_ref().map(|types| &types[key]);
        let entity = |(at, constant): (usize, &u32)| (*constant, types.map(|types| types[at].as_str()));
        row.iter()
            .enumerate()
            .map(|place| typed.insert_full(entity(place)).0 as u32)
            .collect()
    };
    let rows: Vec<Vec<Vec<u32>>> = (bias.body.keys())
        .map(|key| background.rows[key].iter().map(|of_key| row(key, of_key)).collect())
        .collect();
    let key = (target, arity);
    let heads: Vec<Vec<u32>> = labels.keys().map(|head| row(&key, head)).collect();
    let variables = bias
        .variables()
        .min(options.variables.unwrap_or(VARIABLES_MAX))
        .min(VARIABLES_MAX)
        .max(key.1);
    let mut names: IndexSet<Option<&str>> = IndexSet::new();
    let kinds = typed
        .iter()
        .map(|(_, name)| names.insert_full(*name).0 as u32)
        .collect();
    let argument_kinds = (bias.body.keys()).map(|key| {
        let kind = |at: usize| names.insert_full(types.map(|types| types[key][at].as_str())).0 as u32;
        (0..key.1).map(kind).collect()
    });
    let argument_kinds = argument_kinds.collect();
    let constants = typed
        .iter()
        .map(|(constant, _)| background.constants[*constant as usize].clone());
    let cases = heads
        .into_iter()
        .zip(labels)
        .map(|(head, (arguments, (is_positive, _)))| Case {
            arguments: arguments
                .iter()
                .map(|&constant| background.constants[constant as usize].clone())
                .collect(),
            is_positive,
            head,
        });
    Ok(Task {
        target: key.0,
        cases: cases.collect(),
        variables,
        constants: constants.collect(),
        database: Database::new(vocabulary, &rows, kinds, argument_kinds, bias.pinned()),
    })
}

/// Adds a negative example for all arguments that are not in an example.
fn close(bias: &Bias, background: &Background, labels: &mut Labels, end: Span) -> Result<(), Vec<Diagnostic>> {
    let Some((key, _)) = &bias.head else {
        return Ok(());
    };
    let of_type = |wanted: Option<&String>| -> Vec<u32> {
        let mut found = BTreeSet::new();
        for (predicate, rows) in background
            .rows
            .iter()
            .filter(|(predicate, _)| bias.body.contains_key(*predicate))
        {
            for at in 0..predicate.1 {
                let own = bias.types.get(predicate).and_then(|types| types.get(at));
                if wanted.is_none() || own == wanted {
                    found.extend(rows.iter().map(|row| row[at]));
                }
            }
        }
        found.into_iter().collect()
    };
    let types = bias.types.get(key);
    let domains: Vec<Vec<u32>> = (0..key.1)
        .map(|at| of_type(types.and_then(|types| types.get(at))))
        .collect();
    let count = domains
        .iter()
        .try_fold(1_usize, |count, domain| count.checked_mul(domain.len()));
    let Some(count) = count.filter(|count| *count <= CLOSED_WORLD_MAX) else {
        let message = format!("the closed-world assumption gives more than {CLOSED_WORLD_MAX} examples");
        let fault = Diagnostic::new(diag::codes::LIMIT_EXCEEDED, message).at(end, "the end of the examples");
        return Err(vec![fault.help(
            "declare `type` for the target and the body predicates, or add `neg(...)` facts",
        )]);
    };
    for number in 0..count {
        let mut rest = number;
        let row: Box<[u32]> = (domains.iter())
            .map(|domain| {
                let constant = domain[rest % domain.len()];
                rest /= domain.len();
                constant
            })
            .collect();
        labels.entry(row).or_insert((false, end));
    }
    Ok(())
}

impl Task {
    /// Returns the predicates of bodies.
    pub fn vocabulary(&self) -> &Vocabulary {
        self.database.vocabulary()
    }

    /// Returns the settings of a search comparable with Popper's: clauses without negative literals.
    pub fn settings(&self) -> Settings {
        Settings {
            variables: self.variables,
            negation: false,
            ..Settings::default()
        }
    }

    /// Learns clauses from the examples whose positions `keep` selects. `progress` receives the state of the learner.
    ///
    /// # Panics
    /// If the settings have fewer variables than the target has arguments, or more than [`VARIABLES_MAX`].
    pub fn solve(
        &self,
        keep: impl Fn(usize) -> bool,
        settings: &Settings,
        progress: &(dyn Fn(Progress) + Sync),
        cancel: &Cancel,
    ) -> Solution {
        let of = |is_positive: bool| -> Vec<Vec<u32>> {
            let cases = self.cases.iter().enumerate();
            let kept = cases.filter(|(index, case)| case.is_positive == is_positive && keep(*index));
            kept.map(|(_, case)| case.head.clone()).collect()
        };
        Solution {
            rules: learn_relational(&self.database, &of(true), &of(false), settings, progress, cancel),
            is_cut: cancel.requested(),
        }
    }

    /// Returns whether a body holds in each example.
    pub fn holds(&self, body: &Body) -> Vec<bool> {
        let heads: Vec<Vec<u32>> = self.cases.iter().map(|case| case.head.clone()).collect();
        derived(&self.database, body, &heads)
    }

    /// Returns the literals over the variables of a body that hold together with it in all of some examples, given by
    /// their positions. With `negation`, negated ones are part of them.
    pub fn undecided(&self, body: &Body, cases: &[usize], negation: bool) -> Vec<Literal> {
        let heads: Vec<Vec<u32>> = cases.iter().map(|&case| self.cases[case].head.clone()).collect();
        undecided(&self.database, body, &heads, negation)
    }

    /// Returns the facts of a predicate.
    pub fn facts(&self, predicate: usize) -> impl Iterator<Item = Vec<&str>> {
        let text = |constant: &u32| self.constants[*constant as usize].as_str();
        self.database
            .rows(predicate)
            .map(move |row| row.iter().map(text).collect())
    }
}

/// What [`Task::solve`] found.
#[derive(Clone, Debug)]
pub struct Solution {
    /// The clauses of the target.
    pub rules: ActionRules,
    /// Whether the search stopped on cancellation.
    pub is_cut: bool,
}
