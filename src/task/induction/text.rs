//! Learned rules as a rule file and as JSON.

use crate::builtin;
use crate::datalog::{self, ast};
use crate::diag::{SourceId, Sources};
use crate::files::BUILTIN_FOLDER;
use crate::induce::{Atom, ClauseSupport, LearnedClause, LearnedRules, Literal, Support, Violation, Vocabulary};
use crate::task::induction::InductionTask;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::fmt::Write;

/// The maximum number of literals that a comment of a rule file lists.
const LISTED_MAX: usize = 8;
/// The number of examples that a clause alone explains below which a comment warns.
const FEW: u64 = 5;

/// Where examples come from.
#[derive(Clone, Debug, Default)]
pub struct Origin {
    /// The number of the first example of each part, in ascending order, its name, and whether it has steps.
    parts: Vec<(u64, String, bool)>,
    /// Lines about the source, the seed and the settings.
    pub lines: Vec<String>,
}

impl Origin {
    /// Notes that the example `begin` has the name `name`.
    pub fn push(&mut self, begin: u64, name: impl Into<String>) {
        self.parts.push((begin, name.into(), false));
    }

    /// Notes that the examples from `begin` on are the steps of the episode `name`.
    pub fn push_episode(&mut self, begin: u64, name: impl Into<String>) {
        self.parts.push((begin, name.into(), true));
    }

    /// Returns the place of an example as text.
    pub fn describe(&self, example: u64) -> String {
        let after = self.parts.partition_point(|(begin, ..)| *begin <= example);
        match after.checked_sub(1).map(|at| &self.parts[at]) {
            Some((begin, name, true)) => format!("{name}, step {}", example - begin),
            Some((_, name, false)) => name.clone(),
            None => format!("example {example}"),
        }
    }
}

/// Returns learned rules as the source of a rule file.
///
/// The file begins with the declarations of the rules of the world: it includes the built-in files that have neither a
/// clause of a learned action nor an include, and repeats the declarations of all other files. `rule_files` are these
/// files in `sources`.
pub fn rule_file(
    task: &InductionTask,
    learned: &LearnedRules,
    support: &Support,
    origin: &Origin,
    (sources, rule_files): (&Sources, &[SourceId]),
) -> String {
    let mut text = String::new();
    for line in &origin.lines {
        comment(&mut text, "// ", line);
    }
    for line in summary(task, learned, support, origin) {
        comment(&mut text, "// ", &line);
    }
    let names: Vec<&str> = task.actions().iter().map(|action| action.name()).collect();
    let (default, learned_actions) = names.split_last().expect("at least the default");
    text.push('\n');
    text.push_str(&declarations(sources, rule_files, learned_actions));
    let mut clauses = support.clauses.iter();
    for (action, rules) in learned.actions.iter().enumerate() {
        let _ = writeln!(text, "\n// --- {}", names[action]);
        if rules.clauses.is_empty() {
            let count = support.by_action[action];
            let _ = writeln!(text, "\n// No clause: {}.", plural(count, "example", "examples"));
        }
        for (number, (clause, support)) in rules.clauses.iter().zip(clauses.by_ref()).enumerate() {
            text.push('\n');
            let label = label(names[action], number);
            comment(&mut text, "/// ", &format!("{label}: {}", explains(support)));
            if let Some(first) = support.first {
                let place = origin.describe(first);
                comment(
                    &mut text,
                    "/// ",
                    &format!("The first example that it alone explains is {place}."),
                );
            }
            let mut literals: Vec<String> = names[..action].iter().map(|name| format!("Not({name}(X))")).collect();
            literals.extend(clause.body.texts(task.vocabulary()));
            if clause.body.0.is_empty() && task.vocabulary().guard().is_none() {
                literals.push("true".to_owned());
            }
            let _ = writeln!(text, "{}(X) :- {}.", names[action], literals.join(", "));
            for line in doubts(clause, support, learned.rate, task.vocabulary()) {
                comment(&mut text, "// ", &line);
            }
        }
    }
    let _ = writeln!(text, "\n// --- {default}: where no clause above holds");
    formatted(text)
}

/// Returns a rule file as `logicity fmt` prints it.
fn formatted(text: String) -> String {
    let mut sources = Sources::new();
    let source = sources.add("learned.dl", text.clone());
    match datalog::format(&sources, source) {
        Ok(formatted) => formatted,
        // Only its layout would change, so a text that does not parse stays as it is.
        Err(_) => text,
    }
}

/// Adds a comment, wrapped at 100 columns between words and not within parentheses. Names of files and entities may
/// contain line breaks, which would end it.
pub(super) fn comment(text: &mut String, prefix: &str, line: &str) {
    let line = line.replace(char::is_control, "_");
    let mut depth = 0_usize;
    let words = line.split(|character| {
        match character {
            '(' => depth += 1,
            ')' => depth = depth.saturating_sub(1),
            _ => {}
        }
        character == ' ' && depth == 0
    });
    let mut column = 0;
    for (index, word) in words.enumerate() {
        if index > 0 && column + 1 + word.len() <= 100 {
            text.push(' ');
            column += 1;
        } else {
            if index > 0 {
                text.push('\n');
            }
            text.push_str(prefix);
            column = prefix.len();
        }
        text.push_str(word);
        column += word.len();
    }
    text.push('\n');
}

pub(super) fn plural(count: u64, one: &str, many: &str) -> String {
    format!("{count} {}", if count == 1 { one } else { many })
}

/// Returns a sentence about examples that all have the same action.
pub fn only_action(task: &InductionTask, support: &Support) -> Option<String> {
    let name = task.actions()[support.only_action()?].name();
    Some(format!(
        "All examples have the action {name}: they do not show when another action is taken."
    ))
}

/// Returns a sentence about each constraint of the rules that the examples violate.
pub fn broken_constraints(task: &InductionTask, support: &Support, origin: &Origin) -> Vec<String> {
    let sentence = |(violation, first): &(Violation, u64)| {
        format!(
            "Constraint: the examples violate `{}` of the rules, first in {}; nothing is concluded from it.",
            violation.constraint(task.vocabulary()),
            origin.describe(*first)
        )
    };
    support.broken.iter().map(sentence).collect()
}

/// Returns sentences about the whole result.
fn summary(task: &InductionTask, learned: &LearnedRules, support: &Support, origin: &Origin) -> Vec<String> {
    let mut lines = Vec::new();
    let names: Vec<&str> = task.actions().iter().map(|action| action.name()).collect();
    let counts: Vec<String> = names
        .iter()
        .zip(&support.by_action)
        .map(|(name, count)| format!("{name} {count}"))
        .collect();
    let states = plural(support.states as u64, "distinct state", "distinct states");
    lines.push(format!(
        "{} in {states}: {}.",
        plural(support.examples, "example", "examples"),
        counts.join(", ")
    ));
    lines.extend(only_action(task, support));
    lines.extend(broken_constraints(task, support, origin));
    if support.wrong == 0 {
        lines.push("The rules choose the action of every example.".to_owned());
    } else {
        let places: Vec<String> = support
            .wrong_first
            .iter()
            .take(3)
            .map(|&example| origin.describe(example))
            .collect();
        lines.push(format!(
            "The rules choose another action in {}, first in {}.",
            plural(support.wrong, "example", "examples"),
            places.join("; ")
        ));
    }
    if learned.rate > 0.0 && learned.is_complete {
        let percent = 100.0 * learned.rate;
        let share = if percent < 0.01 {
            "less than 0.01".to_owned()
        } else {
            format!("{percent:.2}")
        };
        lines.push(format!(
            "Noise: {share} % of the examples are assumed to have a wrong action. The search is not complete, so \
             there may be better clauses."
        ));
    }
    if !learned.is_complete {
        lines.push("The learner was interrupted: some examples may have no clause yet.".to_owned());
    }
    if support.contradictions > 0 {
        lines.push(format!(
            "Contradictions: {} examples of several actions; the most frequent one counts.",
            plural(support.contradictions as u64, "state has", "states have")
        ));
    }
    for conflict in &support.conflicts {
        let [chosen, other] = conflict.actions.map(|action| names[action]);
        lines.push(format!(
            "Conflict: conditions of {chosen} and {other} both hold in {}, first in {}; {chosen} has precedence.",
            plural(conflict.examples, "example", "examples"),
            origin.describe(conflict.first)
        ));
    }
    let unseen = atom_texts(&support.unseen, task.vocabulary());
    if !unseen.is_empty() {
        lines.push(format!("Never true in any example: {}.", unseen.join(", ")));
    }
    for (name, rules) in names.iter().zip(&learned.actions) {
        if let Some(limit) = rules.variables_limit {
            lines.push(format!(
                "{name}: clauses have at most {limit} variables: more have too many assignments of entities."
            ));
        }
        let uncovered = plural(rules.uncovered as u64, "state", "states");
        match (rules.uncovered, learned.rate > 0.0) {
            (0, _) => (),
            _ if !learned.is_complete => lines.push(format!("{name}: {uncovered} not covered yet.")),
            (_, true) => lines.push(format!(
                "{name}: no clause covers {uncovered}, which noise may explain."
            )),
            (_, false) => lines.push(format!(
                "{name}: within the limits above, no clause separates {uncovered} from those of actions of lower \
                 precedence."
            )),
        }
        // With noise, the learner compares descriptions, not covers.
        if rules.clauses.is_empty() || learned.rate > 0.0 {
            continue;
        }
        let is_best = rules.clauses.iter().all(|clause| clause.is_best);
        lines.push(match (rules.is_cheapest, is_best) {
            (true, true) => format!("{name}: no cheaper set of the clauses found covers the examples."),
            (true, false) => format!(
                "{name}: no cheaper set of the clauses found covers the examples, but the search for some clauses was cut."
            ),
            (false, _) => format!("{name}: the search for a cheaper set of clauses was cut."),
        });
    }
    lines
}

fn atom_texts(atoms: &[Atom], vocabulary: &Vocabulary) -> Vec<String> {
    let positive = |atom: &Atom| Literal {
        is_negated: false,
        atom: atom.clone(),
    };
    atoms.iter().map(|atom| positive(atom).text(vocabulary)).collect()
}

/// Returns the declarations of rule files: everything except clauses of the given actions.
fn declarations(sources: &Sources, rule_files: &[SourceId], actions: &[&str]) -> String {
    let is_learned = |item: &ast::Item| match item {
        ast::Item::Clause(clause) => clause
            .heads
            .iter()
            .any(|head| actions.contains(&head.predicate.text.as_str())),
        _ => false,
    };
    let mut text = String::new();
    // An included file comes before the file that includes it.
    for &file in rule_files.iter().rev() {
        let tree = datalog::parse(sources, file).file;
        let builtin = builtin_name(sources.name(file), sources.text(file));
        match builtin {
            Some(name)
                if !tree
                    .items
                    .iter()
                    .any(|item| is_learned(item) || matches!(item, ast::Item::Include(_))) =>
            {
                let _ = writeln!(text, ".include {}", datalog::quoted(name));
            }
            _ => {
                let is_kept = |item: &ast::Item| !is_learned(item) && !matches!(item, ast::Item::Include(_));
                let items: Vec<ast::Item> = tree.items.into_iter().filter(is_kept).collect();
                if !items.is_empty() {
                    text.push_str(&datalog::print(&ast::File { items }));
                }
            }
        }
    }
    text
}

/// Returns the name by which any rule file can include a file: it is built in, or has the text of a built-in one.
fn builtin_name<'a>(name: &'a str, text: &str) -> Option<&'a str> {
    let inside = name.strip_prefix(BUILTIN_FOLDER).unwrap_or(name);
    let last = inside.rsplit(['/', '\\']).next()?;
    (builtin::text(&format!("rules/{last}")) == Some(text)).then_some(last)
}

/// Returns the name of a clause: its action and its position among the clauses of this action.
fn label(action: &str, position: usize) -> String {
    format!("{action}{}", position + 1)
}

/// Returns how many examples a clause explains.
fn explains(support: &ClauseSupport) -> String {
    let examples = plural(support.examples, "example", "examples");
    match support.alone {
        0 => format!("explains {examples}, none alone"),
        alone => format!("explains {examples}, {alone} alone"),
    }
}

/// Returns a sentence about a clause that few examples need.
pub(super) fn few(support: &ClauseSupport) -> Option<String> {
    match support.alone {
        0 => Some("Few examples: other clauses explain all of them, too.".to_owned()),
        alone if alone < FEW => Some(format!("Few examples: it alone explains {alone}.")),
        _ => None,
    }
}

/// Returns sentences about what the examples do not show of a clause. `rate` is the assumed share of wrong actions.
fn doubts(clause: &LearnedClause, support: &ClauseSupport, rate: f64, vocabulary: &Vocabulary) -> Vec<String> {
    let mut lines = Vec::new();
    // With noise, no search is complete.
    if !clause.is_best && rate <= 0.0 {
        lines.push("Cut: the search for this clause ended early, so another one may explain more.".to_owned());
    }
    if support.outranked > 0 {
        lines.push(format!(
            "Outranked: its conditions also hold in {} of actions with precedence.",
            plural(support.outranked, "example", "examples")
        ));
    }
    lines.extend(few(support));
    if support.against > 0 {
        lines.push(format!(
            "Noise: it also holds in {} of other actions.",
            plural(support.against, "example", "examples")
        ));
    }
    for (own, others) in grouped(support) {
        let others: Vec<String> = others.iter().map(|literal| literal.text(vocabulary)).collect();
        lines.push(format!(
            "{} could also be {}.",
            own.text(vocabulary),
            listed(&others, "or")
        ));
    }
    let undecided: Vec<String> = support
        .undecided
        .iter()
        .map(|literal| literal.text(vocabulary))
        .collect();
    if !undecided.is_empty() {
        lines.push(format!("Never seen without {}.", listed(&undecided, "and")));
    }
    lines
}

fn grouped(support: &ClauseSupport) -> BTreeMap<&Literal, Vec<&Literal>> {
    let mut groups: BTreeMap<&Literal, Vec<&Literal>> = BTreeMap::new();
    for (own, other) in &support.alternatives {
        groups.entry(own).or_default().push(other);
    }
    groups
}

/// Joins texts with commas and a last word; leaves out those after the first few.
pub(super) fn listed(texts: &[String], word: &str) -> String {
    let more = texts.len().saturating_sub(LISTED_MAX);
    let mut shown: Vec<&str> = texts.iter().take(LISTED_MAX).map(String::as_str).collect();
    let rest = format!("{more} more");
    if more > 0 {
        shown.push(&rest);
    }
    match shown.split_last() {
        Some((last, [])) => (*last).to_owned(),
        Some((last, before)) => format!("{} {word} {last}", before.join(", ")),
        None => String::new(),
    }
}

/// Returns learned rules and their support as JSON.
pub fn report_json(task: &InductionTask, learned: &LearnedRules, support: &Support, origin: &Origin) -> Value {
    let vocabulary = task.vocabulary();
    let names: Vec<&str> = task.actions().iter().map(|action| action.name()).collect();
    let texts = |literals: &[Literal]| {
        literals
            .iter()
            .map(|literal| literal.text(vocabulary))
            .collect::<Vec<_>>()
    };
    let clauses = (learned.actions.iter())
        .flat_map(|rules| rules.clauses.iter().enumerate())
        .zip(&support.clauses)
        .map(|((position, clause), support)| {
            let alternatives: Vec<Value> = (support.alternatives.iter())
                .map(|(own, other)| json!([own.text(vocabulary), other.text(vocabulary)]))
                .collect();
            json!({
                "action": names[support.action],
                "label": label(names[support.action], position),
                "body": clause.body.texts(vocabulary),
                "examples": support.examples,
                "states": support.states,
                "alone": support.alone,
                "alone_states": support.alone_states,
                "outranked": support.outranked,
                "against": support.against,
                "first": support.first.map(|first| origin.describe(first)),
                "is_best": clause.is_best,
                "undecided": texts(&support.undecided),
                "alternatives": alternatives,
                "notes": doubts(clause, support, learned.rate, vocabulary),
            })
        });
    let actions = learned.actions.iter().enumerate().map(|(action, rules)| {
        json!({
            "action": names[action],
            "examples": support.by_action[action],
            "clauses": rules.clauses.len(),
            "is_cheapest": rules.is_cheapest,
            "uncovered": rules.uncovered,
            "variables_limit": rules.variables_limit,
        })
    });
    let conflicts = support.conflicts.iter().map(|conflict| {
        json!({
            "actions": conflict.actions.map(|action| names[action]),
            "examples": conflict.examples,
            "first": origin.describe(conflict.first),
        })
    });
    let broken = support.broken.iter().map(|(violation, first)| {
        json!({
            "constraint": violation.constraint(vocabulary),
            "first": origin.describe(*first),
        })
    });
    json!({
        "origin": origin.lines,
        "notes": summary(task, learned, support, origin),
        "examples": support.examples,
        "states": support.states,
        "default": names.last(),
        "noise": learned.rate,
        "complete": learned.is_complete,
        "conflicts": conflicts.collect::<Vec<_>>(),
        "contradictions": support.contradictions,
        "broken_constraints": broken.collect::<Vec<_>>(),
        "unseen": atom_texts(&support.unseen, vocabulary),
        "wrong": support.wrong,
        "wrong_first": support.wrong_first.iter().map(|&example| origin.describe(example)).collect::<Vec<_>>(),
        "actions": actions.collect::<Vec<_>>(),
        "clauses": clauses.collect::<Vec<_>>(),
    })
}
