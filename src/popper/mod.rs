//! Tasks in the format of the learner Popper: background knowledge, examples and a bias, as Prolog text.
//!
//! A task has one target predicate, function-free background knowledge and no recursion. The reader evaluates rules of
//! the background knowledge with the Datalog engine. Each example becomes a [`State`]: its entities are the constants
//! that a clause about the example can refer to, first those of the example itself, then those that facts link to them.
//! The number of steps is at most `max_vars` minus the number of arguments. With `direction` declarations, a fact leads
//! from its inputs to its outputs. Positive examples have the target as their action, negative ones the default.
//!
//! If all predicates have `type` declarations, equal constants of different types are different entities. The bias can
//! then also require that a clause has one variable of a type, as in
//! `:- clause(C), #count{V : var_type(C,V,state)} != 1.`: that of the head.
//!
//! ```
//! use logicity::cancel::Cancel;
//! use logicity::diag::Sources;
//! use logicity::popper::{Files, Options, read, solve};
//!
//! let mut sources = Sources::new();
//! let files = Files {
//!     background: sources.add("bk.pl", "parent(ann,bo). parent(bo,cy). parent(bo,di). parent(eve,ann)."),
//!     examples: sources.add("exs.pl", "pos(old(ann,cy)). pos(old(eve,bo)). neg(old(ann,bo)). neg(old(cy,ann))."),
//!     bias: sources.add("bias.pl", "head_pred(old,2). body_pred(parent,2). max_vars(3)."),
//! };
//! let (task, _) = read(&sources, &files, &Options::default());
//! let task = task.ok_or("the texts are a task")?;
//! let (examples, _) = task.examples(|_| true);
//! let solution = solve(&task.vocabulary, &examples, &task.settings(), &Cancel::never());
//! assert_eq!(task.clauses(&solution.rules), ["old(X, Y) :- parent(X, Z), parent(Z, Y)."]);
//! # Ok::<(), &str>(())
//! ```

mod background;
mod bias;
mod print;
mod prolog;
mod states;
mod tokens;

use crate::cancel::Cancel;
use crate::datalog::Limits;
use crate::datalog::codes;
use crate::diag::{self, Diagnostic, Faults, SourceId, Sources, Span};
use crate::induce::{
    ActionRules, Examples, LITERAL_COST, Predicate, Settings, State, VARIABLES_MAX, Vocabulary, learn,
};
use background::{Background, Key, unknown};
use bias::Bias;
use indexmap::map::Entry;
use indexmap::{IndexMap, IndexSet};
pub use print::TargetProgram;
use prolog::{Directives, Kind, Term, parse};
use states::Network;
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
    /// The limits of evaluating the rules of the background knowledge. The memory of all examples has the same limit.
    pub limits: Limits,
}

/// An example of a task.
#[derive(Clone, Debug)]
pub struct Case {
    /// The arguments of the target.
    pub arguments: Vec<String>,
    /// Whether the target is true.
    pub is_positive: bool,
    /// What a clause can refer to.
    pub state: State,
    /// The constants of the entities of the state. A constant of several arguments occurs several times.
    pub entities: Vec<String>,
}

/// A task.
#[derive(Clone, Debug)]
pub struct Task {
    /// The target predicate.
    pub target: String,
    /// The predicates of bodies.
    pub vocabulary: Vocabulary,
    /// The examples in the order of the source.
    pub cases: Vec<Case>,
    /// The maximum number of variables of a clause.
    pub variables: usize,
    /// For each predicate of the vocabulary, its facts.
    pub facts: Vec<Vec<Vec<String>>>,
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
    let links = bias.links();
    let vocabulary = Vocabulary::new(predicates.collect(), arity, None).linked(links.clone());
    let text = |constant: u32| background.constants[constant as usize].clone();
    let texts = |row: &[u32]| -> Vec<String> { row.iter().map(|&constant| text(constant)).collect() };
    let of = |key: &Key| -> Vec<&[u32]> { background.rows[key].iter().map(|row| &**row).collect() };
    // The entities: constants with their types.
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
    let rows = (bias.body.keys()).map(|key| of(key).into_iter().map(|of_key| row(key, of_key)).collect());
    let rows: Vec<Vec<Vec<u32>>> = rows.collect();
    let key = (target, arity);
    let heads: Vec<Vec<u32>> = labels.keys().map(|head| row(&key, head)).collect();
    let variables = bias
        .variables()
        .min(options.variables.unwrap_or(VARIABLES_MAX))
        .min(VARIABLES_MAX)
        .max(key.1);
    let single = bias.single_types();
    let is_fixed = (typed.iter()).map(|(_, name)| name.is_some_and(|name| single.contains(name)));
    let network = Network::new(&vocabulary, &links, &rows, is_fixed.collect());
    let mut cases = Vec::new();
    let mut bytes = 0;
    for (head, (arguments, (is_positive, place))) in heads.iter().zip(labels) {
        // The other examples have the same fault.
        let (state, entities) = network.state(head, variables, place).map_err(|fault| vec![fault])?;
        bytes += 8 * vocabulary.facts(state.entities()).div_ceil(64) as u64;
        if bytes > options.limits.bytes {
            let message = format!("the examples need more than {} MiB", options.limits.bytes >> 20);
            let fault =
                Diagnostic::new(diag::codes::LIMIT_EXCEEDED, message).at(place, "the first example beyond the limit");
            let help = "declare `direction` for the body predicates, reduce `max_vars`, or raise `--max-memory`";
            return Err(vec![fault.help(help)]);
        }
        cases.push(Case {
            arguments: texts(&arguments),
            is_positive,
            state,
            entities: entities
                .into_iter()
                .map(|entity| text(typed[entity as usize].0))
                .collect(),
        });
    }
    let facts = bias
        .body
        .keys()
        .map(|key| of(key).into_iter().map(texts).collect())
        .collect();
    let target = key.0;
    Ok(Task {
        target,
        vocabulary,
        cases,
        variables,
        facts,
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
    /// Returns the examples whose positions `keep` selects. No clause can separate positive examples from negative ones
    /// with the same state, so these count as negative; also returns their number.
    pub fn examples(&self, keep: impl Fn(usize) -> bool) -> (Examples, usize) {
        let kept = self.cases.iter().enumerate().filter(|(index, _)| keep(*index));
        let cases: Vec<(State, bool)> = kept
            .map(|(_, case)| (case.state.clone().sorted(&self.vocabulary), case.is_positive))
            .collect();
        let negative = cases.iter().filter(|(_, is_positive)| !is_positive);
        let negative: BTreeSet<State> = negative.map(|(state, _)| state.clone()).collect();
        let actions = vec![self.target.clone(), format!("not {}", self.target)];
        let mut examples = Examples::new(self.vocabulary.clone(), actions);
        let mut inseparable = 0;
        for (state, is_positive) in cases {
            let is_separable = !negative.contains(&state);
            inseparable += usize::from(is_positive && !is_separable);
            examples.push(state, usize::from(!(is_positive && is_separable)));
        }
        (examples, inseparable)
    }

    /// Returns the settings of a search comparable with Popper's: clauses without negative literals.
    pub fn settings(&self) -> Settings {
        Settings {
            variables: self.variables,
            negation: false,
            ..Settings::default()
        }
    }
}

/// What [`solve`] found.
#[derive(Clone, Debug)]
pub struct Solution {
    /// The clauses of the first action.
    pub rules: ActionRules,
    /// The number of variables that clauses could have.
    pub variables: usize,
    /// Whether the search stopped on cancellation before it tried all numbers of variables.
    pub is_cut: bool,
}

/// Learns clauses for the first action, with one more variable in each round. Returns those of least cost among the
/// rounds that leave the fewest examples uncovered. A single clause ends the search.
pub fn solve(vocabulary: &Vocabulary, examples: &Examples, settings: &Settings, cancel: &Cancel) -> Solution {
    let rank = |rules: &ActionRules| {
        let costs = rules
            .clauses
            .iter()
            .map(|clause| clause.body.cost(vocabulary) + LITERAL_COST);
        (rules.uncovered, costs.sum::<u32>())
    };
    let mut best: Option<Solution> = None;
    for variables in vocabulary.egos()..=settings.variables.max(vocabulary.egos()) {
        let settings = Settings {
            variables,
            ..settings.clone()
        };
        let rules = learn(examples, &settings, cancel).actions.swap_remove(0);
        if cancel.requested() && best.is_some() {
            break;
        }
        let is_single = rules.uncovered == 0 && rules.clauses.len() == 1;
        if best.as_ref().is_none_or(|best| rank(&rules) < rank(&best.rules)) {
            best = Some(Solution {
                rules,
                variables,
                is_cut: false,
            });
        }
        if is_single {
            break;
        }
    }
    let mut best = best.expect("there is at least one round");
    best.is_cut = cancel.requested();
    best
}
