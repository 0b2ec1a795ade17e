//! Learned clauses as Prolog, and as a program of the Datalog engine.

use crate::datalog::{parse, quoted};
use crate::diag::Sources;
use crate::induce::{ActionRules, Body, Literal, VARIABLE_NAMES};
use crate::popper::Task;
use std::collections::BTreeSet;
use std::fmt::Write;

/// The maximum number of characters of a name that is changed.
const NAME_MAX: usize = 100;

/// Learned clauses as a program of the Datalog engine that derives the target.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TargetProgram {
    /// The declarations, and the facts of the predicates in the clauses. Rules of the background knowledge are not part
    /// of it, but what follows from them is.
    pub declarations: String,
    /// The clauses.
    pub clauses: Vec<String>,
}

impl Task {
    /// Returns an example as Prolog, for example `east(t1)`.
    pub fn example(&self, case: usize) -> String {
        format!("{}({})", self.target, self.cases[case].arguments.join(", "))
    }

    /// Returns clauses as Prolog. Literals follow those that bind their variables, and negated literals come last.
    pub fn clauses(&self, rules: &ActionRules) -> Vec<String> {
        let head = format!("{}({})", self.target, self.head());
        let clause = |body: &Body| {
            let literals: Vec<String> = (self.ordered(body).into_iter())
                .map(|literal| self.literal(literal))
                .collect();
            format!("{head} :- {}.", literals.join(", "))
        };
        rules.clauses.iter().map(|learned| clause(&learned.body)).collect()
    }

    /// Returns a literal as Prolog.
    pub fn literal(&self, literal: &Literal) -> String {
        let name = &self.vocabulary().predicates()[literal.atom.predicate].name;
        let sign = if literal.is_negated { "\\+ " } else { "" };
        format!("{sign}{name}({})", variables(literal))
    }

    /// Returns clauses as a program of the Datalog engine. It has the facts of the task, so that it derives the target
    /// without further input. Names that the engine does not accept are changed.
    pub fn program(&self, rules: &ActionRules) -> TargetProgram {
        let predicates = self.vocabulary().predicates();
        let mut taken = BTreeSet::new();
        let target = free_name(&self.target, self.vocabulary().egos(), &mut taken);
        let names: Vec<String> = (predicates.iter())
            .map(|predicate| free_name(&predicate.name, predicate.arity, &mut taken))
            .collect();
        let used: BTreeSet<usize> = (rules.clauses.iter())
            .flat_map(|clause| clause.body.0.iter().map(|literal| literal.atom.predicate))
            .collect();
        let mut declarations = String::new();
        for predicate in used {
            declare(&mut declarations, &names[predicate], predicates[predicate].arity);
            for row in self.facts(predicate) {
                fact(&mut declarations, &names[predicate], &row);
            }
        }
        declare(&mut declarations, &target, self.vocabulary().egos());
        let _ = writeln!(declarations, ".output {target}");
        // Positive literals bind all variables, also those of the head.
        let clause = |body: &Body| {
            let literals = self.ordered(body).into_iter().map(|literal| {
                let sign = if literal.is_negated { "!" } else { "" };
                format!("{sign}{}({})", names[literal.atom.predicate], variables(literal))
            });
            let literals: Vec<String> = literals.collect();
            format!("{target}({}) :- {}.", self.head(), literals.join(", "))
        };
        TargetProgram {
            declarations,
            clauses: rules.clauses.iter().map(|learned| clause(&learned.body)).collect(),
        }
    }

    /// Returns the variables of the head.
    fn head(&self) -> String {
        VARIABLE_NAMES[..self.vocabulary().egos()].join(", ")
    }

    /// Returns the literals of a body in an order in which a literal follows those that bind its inputs.
    fn ordered<'a>(&self, body: &'a Body) -> Vec<&'a Literal> {
        let (mut left, negated): (Vec<&Literal>, Vec<&Literal>) =
            body.0.iter().partition(|literal| !literal.is_negated);
        let mut bound = (1_u64 << self.vocabulary().egos()) - 1;
        let mut ordered = Vec::new();
        while !left.is_empty() {
            let next = left
                .iter()
                .position(|literal| self.vocabulary().binds(&literal.atom, bound));
            let literal = left.remove(next.unwrap_or(0));
            literal
                .atom
                .arguments
                .iter()
                .for_each(|variable| bound |= 1 << variable);
            ordered.push(literal);
        }
        ordered.extend(negated);
        ordered
    }
}

fn variables(literal: &Literal) -> String {
    let names: Vec<&str> = (literal.atom.arguments.iter())
        .map(|&variable| VARIABLE_NAMES[usize::from(variable)])
        .collect();
    names.join(", ")
}

/// Adds the declaration of a predicate.
fn declare(text: &mut String, name: &str, arity: usize) {
    let columns: Vec<String> = (0..arity).map(|at| format!("a{at}: symbol")).collect();
    let _ = writeln!(text, ".decl {name}({})", columns.join(", "));
}

/// Adds a fact.
fn fact(text: &mut String, name: &str, row: &[&str]) {
    let constants: Vec<String> = row.iter().map(|constant| quoted(constant)).collect();
    let _ = writeln!(text, "{name}({}).", constants.join(", "));
}

/// Returns a name of a predicate that the engine accepts and that is not taken, and takes it.
fn free_name(name: &str, arity: usize, taken: &mut BTreeSet<String>) -> String {
    let mut free: String = (name.trim_matches('\'').chars())
        .take(NAME_MAX)
        .map(|c| if c.is_ascii_alphanumeric() { c } else { '_' })
        .collect();
    if !is_accepted(&free) {
        free = format!("p_{free}");
    }
    if taken.contains(&free) {
        free = format!("{free}_{arity}");
    }
    while !taken.insert(free.clone()) {
        free.push('_');
    }
    free
}

/// Returns whether the engine accepts the name of a predicate: it could be the name of a functor, too.
fn is_accepted(name: &str) -> bool {
    let mut sources = Sources::new();
    let text = format!(".decl {name}(a: symbol)\n{name}(\"a\") :- {name}(\"a\"), !{name}(\"b\").\n");
    let entry = sources.add("name", text);
    parse(&sources, entry).diagnostics.is_empty()
}
