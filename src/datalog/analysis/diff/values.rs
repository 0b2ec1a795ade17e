//! The values of scenes as text: those that the rules name, their words, and what the rules derive of them.

use crate::analysis::diff::pair::Output;
use crate::check::{Column, Literal, PredicateId, Rules, Term};
use crate::eval::limits::Limits;
use crate::naive;
use crate::session::Session;
use crate::symbol::Symbol;
use crate::syntax::ast::BaseType;
use crate::syntax::functor::Functor;
use crate::value::{Value, parse as parse_value, record_text, shortest_float};
use std::collections::BTreeSet;

/// The limits of evaluating one scene. A scene that exceeds them is skipped.
pub(super) const LIMITS: Limits = Limits {
    rows: 20_000,
    steps: 10_000_000,
    bytes: 1 << 28,
};

/// Returns the words of a row of values as text.
pub(super) fn words(session: &mut Session, columns: &[BaseType], row: &[String]) -> Vec<Value> {
    let columns = columns.iter().zip(row);
    columns
        .map(|(base, text)| match base {
            BaseType::Symbol => session.intern(text),
            base => parse_value(*base, text).unwrap_or_default(),
        })
        .collect()
}

/// Returns a value as text; a symbol as its number.
fn print(base: BaseType, value: Value) -> String {
    match base {
        BaseType::Unsigned => value.0.to_string(),
        BaseType::Float => shortest_float(value.as_float()),
        BaseType::Number | BaseType::Symbol | BaseType::Record => value.as_number().to_string(),
    }
}

/// Evaluates rules naively on rows of values as text, and returns the rows of outputs, in order: the name of the
/// predicate, and the values as text.
pub(super) fn derived(
    rules: &Rules,
    outputs: &[Output],
    rows: impl Iterator<Item = (PredicateId, Vec<String>)>,
) -> Vec<(String, Vec<String>)> {
    let symbols = rules.symbols.clone();
    let facts = rows.map(|(predicate, row)| {
        let known = &rules.predicates[predicate.index()];
        let word = |(column, text): (&Column, &String)| match column.base {
            BaseType::Symbol => Value(symbols.intern(text).0),
            base => parse_value(base, text).unwrap_or_default(),
        };
        let words = known.columns.iter().zip(&row).map(word).collect();
        (known.edb.unwrap_or(predicate), words)
    });
    let database = naive::evaluate(rules, &symbols, facts.collect::<Vec<_>>());
    let mut derived = Vec::new();
    for output in outputs {
        let Some(predicate) = rules.predicate(&output.name) else {
            continue;
        };
        for row in &database[predicate.index()] {
            let shown = output.columns.iter().zip(row).map(|(base, value)| match base {
                BaseType::Symbol => symbols.resolve(Symbol(value.0)).unwrap_or_default().to_owned(),
                BaseType::Record => record_text(*value, &symbols),
                base => print(*base, *value),
            });
            derived.push((output.name.clone(), shown.collect()));
        }
    }
    derived.sort();
    derived
}

/// Collects the constants of the rules, the neighbors of numbers, and a few small numbers.
pub(super) fn named(rules: &Rules, constants: &mut BTreeSet<(BaseType, String)>) {
    let mut add = |base: BaseType, term: &Term| {
        let Term::Constant(value) = *term else { return };
        match base {
            BaseType::Symbol => {
                let text = rules.symbols.resolve(Symbol(value.0)).unwrap_or_default();
                constants.insert((base, text.to_owned()));
            }
            BaseType::Number => {
                let number = value.as_number();
                let near = [number.wrapping_sub(1), number, number.wrapping_add(1)];
                constants.extend(near.map(|number| (base, number.to_string())));
            }
            BaseType::Unsigned => {
                let near = [value.0.wrapping_sub(1), value.0, value.0.wrapping_add(1)];
                constants.extend(near.map(|number| (base, number.to_string())));
            }
            BaseType::Float => {
                let near = [value.as_float() - 1.0, value.as_float(), value.as_float() + 1.0];
                constants.extend(near.map(|number| (base, shortest_float(number))));
            }
            // No fact of a trial has records.
            BaseType::Record => {}
        }
    };
    let one = Term::Constant(Value::number(1));
    add(BaseType::Number, &one);
    add(BaseType::Unsigned, &one);
    add(BaseType::Float, &Term::Constant(Value::float(0.0)));
    for clause in &rules.clauses {
        let atoms = clause.body.iter().filter_map(Literal::atom).chain([&clause.head]);
        for atom in atoms {
            let columns = &rules.predicates[atom.predicate.index()].columns;
            columns
                .iter()
                .zip(&atom.terms)
                .for_each(|(column, term)| add(column.base, term));
        }
        for literal in &clause.body {
            match literal {
                Literal::Compare { left, right, base, .. } => {
                    add(*base, left);
                    add(*base, right);
                }
                Literal::Compute {
                    functor,
                    base,
                    arguments,
                    ..
                } => {
                    for (argument, position) in arguments.iter().zip(0..) {
                        // Only the first argument of `substr` is a string.
                        let number = *functor == Functor::Substring && position > 0;
                        add(if number { BaseType::Number } else { *base }, argument);
                    }
                }
                _ => {}
            }
        }
    }
}
