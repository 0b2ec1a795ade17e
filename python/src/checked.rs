//! Checked rules for Python code that evaluates them in its own way, such as `RuleLayer`.

use crate::engine::PyProgram;
use crate::to_python;
use logicity::datalog::ast::Comparison;
use logicity::datalog::explain::ExplanationPrinter;
use logicity::datalog::{Atom, BaseType, ClauseId, Literal, PastOperator, PredicateId, Term};
use pyo3::prelude::*;
use serde_json::{Value, json};

pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(checked, module)?)
}

/// Returns the checked rules of a program: predicates by position, clauses in the order of evaluation, the strata of
/// recursive predicates, and what temporal operators read. A variable is its number in the clause, `_` is `None`, and a
/// constant is `"constant"`.
#[pyfunction]
fn checked<'py>(py: Python<'py>, program: &PyProgram) -> PyResult<Bound<'py, PyAny>> {
    let loaded = program.loaded();
    let (rules, sources) = (loaded.program.rules(), &loaded.sources);
    let printer = ExplanationPrinter::new(rules, &rules.symbols, sources);
    let predicates = rules.predicates.iter().map(|predicate| {
        let columns = predicate.columns.iter();
        json!({
            "name": predicate.title(),
            "hidden": predicate.hidden,
            "input": predicate.input,
            "derived": predicate.derived,
            "edb": predicate.edb.map(PredicateId::index),
            "symbols": columns.map(|column| column.base == BaseType::Symbol).collect::<Vec<bool>>(),
        })
    });
    let clause = |id: &ClauseId| {
        let clause = &rules.clauses[id.index()];
        let drawn = rules.draw(clause);
        let body = clause.body.iter().enumerate();
        let body = body.filter(|(at, _)| drawn.as_ref().is_none_or(|draw| !draw.literals.contains(at)));
        let position = sources.position(clause.span);
        let probabilities = drawn.as_ref().map(|draw| {
            let constant = |term: &Term| match term {
                Term::Constant(value) => json!(value.as_float()),
                Term::Variable(_) | Term::Wildcard => Value::Null,
            };
            (draw.probabilities.iter()).map(constant).collect::<Vec<Value>>()
        });
        json!({
            "clause": id.index(),
            "head": atom(&clause.head),
            "body": body.map(|(_, each)| literal(each)).collect::<Vec<Value>>(),
            "probabilities": probabilities,
            "alternative": drawn.as_ref().map(|draw| draw.alternative),
            "label": printer.label(*id),
            "text": sources.slice(clause.span),
            "place": format!("{}:{}:{}", sources.file(clause.span), position.line, position.column),
        })
    };
    let strata = rules.strata.iter().map(|stratum| {
        let clauses: Vec<Value> = stratum.clauses.iter().map(clause).collect();
        let positions: Vec<usize> = stratum.predicates.iter().map(|predicate| predicate.index()).collect();
        json!({"predicates": positions, "clauses": clauses, "recursive": stratum.recursive})
    });
    let pasts = rules.pasts.iter().map(|past| {
        let (operator, held) = match &past.operator {
            PastOperator::Once => ("once", None),
            PastOperator::Always => ("always", None),
            PastOperator::Since(held, columns) => ("since", Some(json!([held.index(), columns]))),
        };
        json!({
            "predicate": past.predicate.index(),
            "operand": past.operand.index(),
            "operator": operator,
            "held": held,
            "first": past.first,
            "last": past.last,
        })
    });
    let rules = json!({
        "predicates": predicates.collect::<Vec<Value>>(),
        "strata": strata.collect::<Vec<Value>>(),
        "pasts": pasts.collect::<Vec<Value>>(),
    });
    to_python(py, &rules)
}

fn atom(atom: &Atom) -> Value {
    json!({"predicate": atom.predicate.index(), "terms": atom.terms.iter().map(term).collect::<Vec<Value>>()})
}

fn term(term: &Term) -> Value {
    match term {
        Term::Variable(variable) => json!(variable.index()),
        Term::Constant(_) => json!("constant"),
        Term::Wildcard => Value::Null,
    }
}

/// Returns an atom with its sign, or an equation of two symbols with its sign. Of any other literal, what it does.
fn literal(literal: &Literal) -> Value {
    match literal {
        Literal::Positive(of) | Literal::Guard(of) => json!({"atom": atom(of), "holds": true}),
        Literal::Negative(of) => json!({"atom": atom(of), "holds": false}),
        Literal::Compare {
            op: op @ (Comparison::Equal | Comparison::NotEqual),
            left,
            right,
            base: BaseType::Symbol,
            ..
        } => json!({"same": [term(left), term(right)], "holds": *op == Comparison::Equal}),
        Literal::Compare { .. } | Literal::Compute { .. } => json!({"other": "compares or computes values"}),
        Literal::Aggregate { .. } => json!({"other": "aggregates"}),
    }
}
