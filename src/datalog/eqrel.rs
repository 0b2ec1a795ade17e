//! Equivalence relations: the clauses that the qualifier `eqrel` stands for.

use crate::codes;
use crate::diag::{Diagnostic, Faults};
use crate::syntax::ast::{Atom, Clause, Item, Literal, Name, Term, TermKind};

/// The qualifier.
pub(crate) const EQREL: &str = "eqrel";

/// Returns the clauses of the declarations among `items` after the first `done` with the qualifier, and counts these.
///
/// ```text
/// .decl R(x: t, y: t) eqrel    becomes    R(y, x) :- R(x, y).    R(x, z) :- R(x, y), R(y, z).
/// ```
///
/// With both, `R(x, x)` and `R(y, y)` follow from `R(x, y)`.
pub(crate) fn clauses(items: &[Item], done: &mut usize, faults: &mut Faults) -> Vec<Item> {
    let declared = items.iter().filter_map(|item| match item {
        Item::Decl(decl) => {
            let word = decl.qualifiers.iter().find(|word| word.text == EQREL)?;
            Some((decl, word))
        }
        _ => None,
    });
    let mut found = Vec::new();
    let mut count = 0;
    for (decl, word) in declared {
        count += 1;
        if count <= *done {
            continue;
        }
        if !decl.choices.is_empty() {
            let message = format!("`{}` is an equivalence relation and has keys", decl.names[0].text);
            let fault = Diagnostic::new(codes::UNSUPPORTED, message).at(word.place.0, "");
            let fault = fault.also(decl.names[0].place.0, "declared here");
            faults.push(fault.help("remove `eqrel` or `choice-domain`"));
            continue;
        }
        let columns = match &decl.columns {
            Some(columns) if columns.len() != 2 => columns.len(),
            Some(_) => {
                found.extend(decl.names.iter().flat_map(|name| closure(name, word)).map(Item::Clause));
                continue;
            }
            None => continue,
        };
        let message = format!("an equivalence relation has 2 columns, not {columns}");
        let fault = Diagnostic::new(codes::ARITY_MISMATCH, message).at(word.place.0, "");
        faults.push(fault.also(decl.names[0].place.0, "declared here"));
    }
    *done = count;
    found
}

/// Returns the clauses of one predicate, at the place of its qualifier.
fn closure(of: &Name, word: &Name) -> [Clause; 2] {
    let place = word.place;
    let atom = |names: [&str; 2]| Atom {
        predicate: Name {
            text: of.text.clone(),
            place,
        },
        terms: names
            .map(|name| Term {
                kind: TermKind::Variable(name.to_owned()),
                place,
            })
            .into(),
        place,
    };
    let clause = |head, body: &[[&str; 2]]| Clause {
        heads: vec![atom(head)],
        probabilities: Vec::new(),
        body: (body.iter())
            .map(|names| Literal::Atom {
                negated: false,
                atom: atom(*names),
            })
            .collect(),
        doc: String::new(),
        place,
    };
    [
        clause(["y", "x"], &[["x", "y"]]),
        clause(["x", "z"], &[["x", "y"], ["y", "z"]]),
    ]
}
