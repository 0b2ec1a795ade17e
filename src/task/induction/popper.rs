//! Rules learned from a task in the format of Popper: as Prolog, as a rule file and as JSON.

use crate::diag::Diagnostic;
use crate::induce::{ClauseSupport, Constraints, Examples, LearnedRules, Literal, Settings, Support, support};
use crate::popper::{Solution, Task};
use crate::task::induction::codes;
use crate::task::induction::text::{comment, few, listed, plural};
use serde_json::{Value, json};

/// The clauses of a target, with what the examples say about them.
#[derive(Clone, Debug)]
pub struct TargetRules<'a> {
    task: &'a Task,
    solution: &'a Solution,
    support: Support,
    /// For positive and negative examples, those for which the clauses derive the target, and all.
    counts: [[usize; 2]; 2],
    /// The number of positive examples that equal a negative one.
    inseparable: usize,
    /// The first positive example that the clauses do not derive.
    first_uncovered: Option<usize>,
    settings: &'a Settings,
}

impl TargetRules<'_> {
    /// Evaluates the solution of a task on its examples: those of [`Task::examples`], with the number of inseparable
    /// ones.
    pub fn new<'a>(
        task: &'a Task,
        (examples, inseparable): (&Examples, usize),
        solution: &'a Solution,
        settings: &'a Settings,
    ) -> TargetRules<'a> {
        let learned = LearnedRules {
            actions: vec![solution.rules.clone()],
            is_complete: !solution.is_cut,
            ..LearnedRules::default()
        };
        let states: Vec<_> = task.cases.iter().map(|case| &case.state).collect();
        let (mut counts, mut first_uncovered) = ([[0; 2]; 2], None);
        for (number, (case, action)) in task
            .cases
            .iter()
            .zip(learned.decide(&task.vocabulary, &states))
            .enumerate()
        {
            let [derived, all] = &mut counts[usize::from(!case.is_positive)];
            *derived += usize::from(action == 0);
            *all += 1;
            if case.is_positive && action != 0 {
                first_uncovered = first_uncovered.or(Some(number));
            }
        }
        TargetRules {
            task,
            solution,
            support: support(examples, &learned, &Constraints::default()),
            counts,
            inseparable,
            first_uncovered,
            settings,
        }
    }

    /// Returns a sentence about the examples for which the clauses derive the target.
    pub fn outcome(&self) -> String {
        let [[positive, positives], [negative, negatives]] = self.counts;
        format!(
            "The clauses derive {positive} of {positives} positive and {negative} of {negatives} negative examples."
        )
    }

    /// Returns an error if the clauses do not derive all positive examples.
    pub fn shortfall(&self) -> Option<Diagnostic> {
        let [[derived, all], _] = self.counts;
        let message = format!("the clauses do not derive {} of {all} positive examples", all - derived);
        let first = self.task.example(self.first_uncovered?);
        let negation = if self.settings.negation { "" } else { "`--negation`, " };
        let help = format!(
            "try {negation}a larger `max_vars` in `bias.pl`, more steps (`--effort`), or more background knowledge"
        );
        let fault = Diagnostic::new(codes::UNCOVERED_EXAMPLES, message);
        Some(fault.note(format!("the first is {first}")).help(help))
    }

    /// Returns the number of clauses.
    pub fn clauses(&self) -> usize {
        self.solution.rules.clauses.len()
    }

    /// Returns the clauses as Prolog, with comments. The text begins with `lines`.
    pub fn prolog(&self, lines: &[String]) -> String {
        self.text("% ", lines, "", &self.task.clauses(&self.solution.rules))
    }

    /// Returns the clauses as a rule file that derives the target from the facts of the task, with comments. The text
    /// begins with `lines`.
    pub fn rule_file(&self, lines: &[String]) -> String {
        let program = self.task.program(&self.solution.rules);
        self.text("// ", lines, &program.declarations, &program.clauses)
    }

    fn text(&self, mark: &str, lines: &[String], declarations: &str, clauses: &[String]) -> String {
        let mut text = String::new();
        for line in lines.iter().chain(&self.summary()) {
            comment(&mut text, mark, line);
        }
        if !declarations.is_empty() {
            text.push('\n');
            text.push_str(declarations);
        }
        for (clause, support) in clauses.iter().zip(&self.support.clauses) {
            text.push('\n');
            for line in self.remarks(support) {
                comment(&mut text, mark, &line);
            }
            text.push_str(clause);
            text.push('\n');
        }
        text
    }

    /// Returns sentences about the whole result.
    fn summary(&self) -> Vec<String> {
        let Solution { rules, is_cut, .. } = self.solution;
        let states = plural(self.support.states as u64, "distinct state", "distinct states");
        let mut lines = vec![
            format!("{} in {states}.", plural(self.support.examples, "example", "examples")),
            self.outcome(),
        ];
        if self.inseparable > 0 {
            lines.push(format!(
                "{} the same facts as a negative one, so that no clause can separate them.",
                plural(
                    self.inseparable as u64,
                    "positive example has",
                    "positive examples have"
                )
            ));
        }
        if rules.uncovered > 0 {
            lines.push(format!(
                "No clause with at most {} variables separates {} from the negative examples.",
                self.settings.variables,
                plural(rules.uncovered as u64, "positive state", "positive states")
            ));
        }
        if *is_cut {
            lines.push("The learner was interrupted: there may be better clauses.".to_owned());
        }
        if !rules.clauses.is_empty() {
            let is_best = rules.clauses.iter().all(|clause| clause.is_best);
            lines.push(match (rules.is_cheapest, is_best) {
                (true, true) => "No cheaper set of the clauses found covers the examples.".to_owned(),
                (true, false) => {
                    "No cheaper set of the clauses found covers the examples, but the search for some clauses was cut."
                        .to_owned()
                }
                (false, _) => "The search for a cheaper set of clauses was cut.".to_owned(),
            });
        }
        lines
    }

    /// Returns sentences about a clause.
    fn remarks(&self, support: &ClauseSupport) -> Vec<String> {
        let mut first = format!("Explains {}", plural(support.examples, "example", "examples"));
        first += &match support.first {
            Some(first) => format!(", {} alone; the first is {}.", support.alone, self.example(first)),
            None => ", none alone.".to_owned(),
        };
        let mut lines = vec![first];
        lines.extend(few(support));
        let undecided: Vec<String> = self
            .undecided(support)
            .map(|literal| self.task.literal(literal))
            .collect();
        if !undecided.is_empty() {
            lines.push(format!("Never seen without {}.", listed(&undecided, "and")));
        }
        lines
    }

    /// Returns the name of an example.
    fn example(&self, number: u64) -> String {
        self.task.example(usize::try_from(number).unwrap_or(usize::MAX))
    }

    /// Returns the literals that clauses of this search could have, and that hold in each state that a clause alone
    /// explains.
    fn undecided<'b>(&self, support: &'b ClauseSupport) -> impl Iterator<Item = &'b Literal> {
        let negation = self.settings.negation;
        (support.undecided.iter()).filter(move |literal| negation || !literal.is_negated)
    }

    /// Returns the clauses and their support as JSON.
    pub fn report(&self) -> Value {
        let Solution {
            rules,
            variables,
            is_cut,
        } = self.solution;
        let [[positive, positives], [negative, negatives]] = self.counts;
        let clauses = self
            .task
            .clauses(rules)
            .into_iter()
            .zip(&rules.clauses)
            .zip(&self.support.clauses);
        let clauses = clauses.map(|((text, clause), support)| {
            json!({
                "clause": text,
                "examples": support.examples,
                "states": support.states,
                "alone": support.alone,
                "alone_states": support.alone_states,
                "first": support.first.map(|first| self.example(first)),
                "is_best": clause.is_best,
                "undecided": self.undecided(support).map(|literal| self.task.literal(literal)).collect::<Vec<_>>(),
            })
        });
        json!({
            "target": format!("{}/{}", self.task.target, self.task.vocabulary.egos()),
            "positive": positives,
            "negative": negatives,
            "true_positives": positive,
            "false_positives": negative,
            "states": self.support.states,
            "variables": variables,
            "negation": self.settings.negation,
            "inseparable": self.inseparable,
            "complete": !is_cut,
            "is_cheapest": rules.is_cheapest,
            "uncovered": rules.uncovered,
            "clauses": clauses.collect::<Vec<_>>(),
        })
    }
}
