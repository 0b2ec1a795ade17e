//! Subsumption: a hidden predicate has the pairs of rows of which one makes the other superfluous.
//!
//! ```text
//! A(x, n) <= A(x, m) :- m < n.    becomes    +<=A(x, n, x, m) :- A(x, n), A(x, m), m < n.
//! ```
// Decision: docs/decisions/language.md#d084

use crate::check::clauses::{Clauses, Edge, EdgeKind};
use crate::check::names::Names;
use crate::codes;
use crate::diag::{Diagnostic, Faults};
use crate::eqrel::EQREL;
use crate::syntax::ast::{
    Atom, Clause, ColumnDecl, Decl, Item, Literal, Name, Place, Scope, Subsumption, Term, TermKind,
};
use std::borrow::Cow;

/// The beginning of the names of the hidden predicates.
const PREFIX: &str = "+<=";

/// Replaces subsumptions by clauses of hidden predicates.
pub(crate) fn lower<'i>(items: Cow<'i, [Item]>, faults: &mut Faults) -> Cow<'i, [Item]> {
    let is_subsumption = |item: &Item| matches!(item, Item::Subsumption(_));
    if !items.iter().any(is_subsumption) {
        return items;
    }
    let (mut out, mut found) = (Vec::with_capacity(items.len()), Vec::new());
    let mut after = false;
    for item in items.into_owned() {
        match item {
            Item::Subsumption(subsumption) => found.push(subsumption),
            // Nothing in it says how to evaluate pairs.
            Item::Plan(_) if after => {}
            other => {
                after = false;
                out.push(other);
                continue;
            }
        }
        after = true;
    }
    let mut declared: Vec<String> = Vec::new();
    let mut clauses = Vec::new();
    for subsumption in found {
        let of = &subsumption.weaker.predicate;
        let name = format!("{PREFIX}{}", of.text);
        if !declared.contains(&name) {
            let own = out.iter().find_map(|item| match item {
                Item::Decl(decl) if decl.names.iter().any(|name| name.text == of.text) => Some(decl),
                _ => None,
            });
            // The checker reports an unknown predicate at the atom.
            let columns = own.and_then(|decl| decl.columns.as_deref()).unwrap_or_default();
            if let Some(decl) = own
                && !decl.choices.is_empty()
            {
                let message = format!("`{}` has both keys and a subsumption", of.text);
                let fault = Diagnostic::new(codes::UNSUPPORTED, message).at(subsumption.place.0, "");
                let fault = fault.also(decl.names[0].place.0, "declared here");
                faults.push(fault.help("choose in another predicate"));
            }
            for (decl, word) in own
                .iter()
                .flat_map(|decl| decl.qualifiers.iter().map(move |word| (decl, word)))
            {
                if ["inline", EQREL].contains(&word.text.as_str()) {
                    let message = format!("`{}` is `{}` and has a subsumption", of.text, word.text);
                    let fault = Diagnostic::new(codes::UNSUPPORTED, message).at(subsumption.place.0, "");
                    let fault = fault.also(decl.names[0].place.0, "declared here");
                    faults.push(fault.help(format!("remove `{}` from its declaration", word.text)));
                }
            }
            out.push(Item::Decl(pairs(&name, of, columns)));
            declared.push(name.clone());
        }
        clauses.push(Item::Clause(clause(name, subsumption)));
    }
    if out.iter().any(|item| matches!(item, Item::Scope(_)))
        && let Some(Item::Clause(clause)) = clauses.first()
    {
        // No scope guards them.
        out.push(Item::Scope(Scope {
            predicate: None,
            place: clause.place,
        }));
    }
    out.append(&mut clauses);
    Cow::Owned(out)
}

/// Returns the declaration of the predicate of pairs.
fn pairs(name: &str, of: &Name, columns: &[ColumnDecl]) -> Decl {
    let named = |prefix: &str| {
        let renamed = columns.iter().map(move |column| ColumnDecl {
            name: Name {
                text: format!("{prefix}{}", column.name.text),
                place: column.name.place,
            },
            ty: column.ty.clone(),
        });
        renamed.collect::<Vec<_>>()
    };
    Decl {
        names: vec![Name {
            text: name.to_owned(),
            place: of.place,
        }],
        columns: Some([named("weaker "), named("stronger ")].concat()),
        qualifiers: Vec::new(),
        choices: Vec::new(),
        doc: format!("the rows of `{}` that others make superfluous", of.text),
    }
}

fn clause(name: String, subsumption: Subsumption) -> Clause {
    let Subsumption {
        mut weaker,
        mut stronger,
        mut body,
        doc,
        place,
    } = subsumption;
    let mut wildcards = 0;
    for term in weaker.terms.iter_mut().chain(&mut stronger.terms) {
        if term.kind == TermKind::Wildcard {
            wildcards += 1;
            term.kind = TermKind::Variable(format!("+{wildcards}"));
        }
    }
    let terms: Vec<Term> = weaker.terms.iter().chain(&stronger.terms).cloned().collect();
    let head = Atom {
        predicate: Name {
            text: name,
            place: weaker.predicate.place,
        },
        terms,
        place: weaker.place,
    };
    let positive = |atom| Literal::Atom { negated: false, atom };
    body.splice(0..0, [positive(weaker), positive(stronger)]);
    Clause {
        heads: vec![head],
        probabilities: Vec::new(),
        body,
        doc,
        place: Place(place.0),
    }
}

/// Marks the predicates of pairs as hidden, and notes them at the predicates they are about.
pub(crate) fn hide(names: &mut Names) {
    for at in 0..names.predicates.len() {
        let Some(of) = names.predicates[at].name.strip_prefix(PREFIX) else {
            continue;
        };
        let of = names.find(of);
        names.predicates[at].hidden = true;
        let pairs = names.find(&names.predicates[at].name);
        if let Some(of) = of {
            names.predicates[of.index()].subsumption = pairs;
        }
    }
}

/// Makes predicates depend on their pairs, so that both are in one stratum.
pub(crate) fn edges(names: &Names, out: &mut Clauses) {
    for predicate in &names.predicates {
        if let (Some(to), Some(from)) = (predicate.subsumption, names.find(&predicate.name)) {
            out.edges.push(Edge {
                from,
                to,
                kind: EdgeKind::Needs,
                span: predicate.span,
            });
        }
    }
}
