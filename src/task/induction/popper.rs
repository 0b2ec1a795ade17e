//! Rules learned from a task in the format of Popper: as Prolog, as a rule file and as JSON.

use crate::diag::Diagnostic;
use crate::induce::{ClauseSupport, Noise, Settings};
use crate::popper::{Solution, Task};
use crate::task::induction::codes;
use crate::task::induction::text::{comment, few, listed, plural};
use serde_json::{Value, json};

/// The clauses of a target, with what the examples say about them.
#[derive(Clone, Debug)]
pub struct TargetRules<'a> {
    task: &'a Task,
    solution: &'a Solution,
    support: Vec<ClauseSupport>,
    /// For positive and negative examples, those for which the clauses derive the target, and all.
    counts: [[usize; 2]; 2],
    /// The first positive example that the clauses do not derive.
    first_uncovered: Option<usize>,
    settings: &'a Settings,
}

impl TargetRules<'_> {
    /// Evaluates the solution of a task on its examples.
    pub fn new<'a>(task: &'a Task, solution: &'a Solution, settings: &'a Settings) -> TargetRules<'a> {
        let clauses = &solution.rules.clauses;
        let holds: Vec<Vec<bool>> = clauses.iter().map(|clause| task.holds(&clause.body)).collect();
        let (mut counts, mut first_uncovered) = ([[0; 2]; 2], None);
        // For each clause, the positive examples that it alone derives.
        let mut alone: Vec<Vec<usize>> = vec![Vec::new(); clauses.len()];
        for (number, case) in task.cases.iter().enumerate() {
            let deriving: Vec<usize> = (0..clauses.len()).filter(|&clause| holds[clause][number]).collect();
            let [derived, all] = &mut counts[usize::from(!case.is_positive)];
            *derived += usize::from(!deriving.is_empty());
            *all += 1;
            if case.is_positive && deriving.is_empty() {
                first_uncovered = first_uncovered.or(Some(number));
            }
            if let ([only], true) = (deriving.as_slice(), case.is_positive) {
                alone[*only].push(number);
            }
        }
        let explained = |holds: &Vec<bool>| {
            (holds.iter().zip(&task.cases))
                .filter(|(holds, case)| **holds && case.is_positive)
                .count()
        };
        let support = (clauses.iter().zip(&holds).zip(&alone)).map(|((clause, holds), alone)| ClauseSupport {
            examples: explained(holds) as u64,
            alone: alone.len() as u64,
            first: alone.first().map(|&number| number as u64),
            undecided: task.undecided(&clause.body, alone, settings.negation),
            ..ClauseSupport::default()
        });
        TargetRules {
            support: support.collect(),
            task,
            solution,
            counts,
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

    /// Returns an error if the clauses do not derive all positive examples, although none of them may be wrong.
    pub fn shortfall(&self) -> Option<Diagnostic> {
        if self.settings.noise != Noise::None {
            return None;
        }
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
        for (clause, support) in clauses.iter().zip(&self.support) {
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
        let Solution { rules, is_cut } = self.solution;
        let mut lines = vec![self.outcome()];
        if rules.uncovered > 0 && self.settings.noise == Noise::None {
            lines.push(format!(
                "No clause with at most {} variables separates {} from the negative examples.",
                self.settings.variables,
                plural(rules.uncovered as u64, "positive example", "positive examples")
            ));
        }
        if *is_cut {
            lines.push("The learner was interrupted: there may be better clauses.".to_owned());
        }
        if !rules.clauses.is_empty() && self.settings.noise == Noise::None {
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
        let undecided: Vec<String> = support
            .undecided
            .iter()
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

    /// Returns the clauses and their support as JSON.
    pub fn report(&self) -> Value {
        let Solution { rules, is_cut } = self.solution;
        let [[positive, positives], [negative, negatives]] = self.counts;
        let clauses = self
            .task
            .clauses(rules)
            .into_iter()
            .zip(&rules.clauses)
            .zip(&self.support);
        let clauses = clauses.map(|((text, clause), support)| {
            json!({
                "clause": text,
                "examples": support.examples,
                "alone": support.alone,
                "first": support.first.map(|first| self.example(first)),
                "is_best": clause.is_best,
                "undecided": support.undecided.iter().map(|literal| self.task.literal(literal)).collect::<Vec<_>>(),
            })
        });
        json!({
            "target": format!("{}/{}", self.task.target, self.task.vocabulary().egos()),
            "positive": positives,
            "negative": negatives,
            "true_positives": positive,
            "false_positives": negative,
            "variables": self.settings.variables,
            "negation": self.settings.negation,
            "noise": self.settings.noise != Noise::None,
            "complete": !is_cut,
            "is_cheapest": rules.is_cheapest,
            "uncovered": rules.uncovered,
            "clauses": clauses.collect::<Vec<_>>(),
        })
    }
}
