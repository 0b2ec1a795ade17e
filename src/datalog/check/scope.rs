//! `.scope P`: makes the guards of a local view explicit, as ordinary literals.
//!
//! ```text
//! .scope Sees
//! Stop(X) :- IsAtInter(X), IsInInter(Y).         becomes   ..., Sees(X, Y).
//! Stop(X) :- IsCar(X), IsClose(X, _).            becomes   IsCar(X), IsClose(X, w), Sees(X, w).
//! Go(X)   :- IsCar(X), Not(IsClose(X, _)).       becomes   IsCar(X), Not(+1(X)).
//!                                                with      +1(X) :- IsClose(X, w), Sees(X, w).
//! ```

use indexmap::IndexMap;

use crate::codes;
use crate::diag::{Diagnostic, Faults, Span};

use crate::check::clauses::{Clauses, Edge, EdgeKind, Guard, VariableType};
use crate::check::names::Names;
use crate::check::rules::{Atom, Clause, Literal, PredicateId, Term, TypeId, VarId};
use crate::syntax::ast;

/// A clause to which the scope may add literals.
pub(crate) struct Scope<'a> {
    pub head: &'a Atom,
    pub body: &'a mut Vec<Literal>,
    /// The names of its variables; the scope adds new ones.
    pub names: Vec<String>,
    /// The types of the variables in the source.
    pub types: Vec<VariableType>,
    /// Whether each variable in the source has a guard.
    pub guarded: Vec<bool>,
}

/// The scopes of a program, in source order.
#[derive(Default)]
pub(crate) struct Scopes {
    current: Option<Guard>,
    /// The hidden predicates by definition, so that equal ones are shared.
    hidden: IndexMap<Hidden, PredicateId>,
}

/// The definition of a hidden predicate: a negated atom with `_` under a scope, without variable names.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct Hidden {
    guard: PredicateId,
    predicate: PredicateId,
    terms: Vec<Term>,
    /// Whether each term is a `_` in view.
    in_view: Vec<bool>,
}

impl Scopes {
    /// Returns the scope in force.
    pub fn current(&self) -> Option<Guard> {
        self.current
    }

    /// Processes a `.scope` directive.
    pub fn enter(&mut self, scope: &ast::Scope, names: &mut Names, faults: &mut Faults) {
        self.current = None;
        let Some(name) = &scope.predicate else { return };
        let Some(predicate) = names.resolve(name) else { return };
        let Some(columns) = &names.signatures[predicate.index()].columns else {
            return;
        };
        match columns.as_slice() {
            &[Some(ego), Some(seen)] => {
                self.current = Some(Guard {
                    predicate,
                    ego,
                    seen,
                    span: name.place.0,
                });
            }
            [_, _] => {}
            _ => {
                let fault = Diagnostic::new(codes::INVALID_SCOPE, format!("`{}` cannot be a scope", name.text))
                    .at(name.place.0, "a scope has two columns: who sees, and who is seen")
                    .also(names.predicate(predicate).span, "declared here")
                    .note(format!("the declaration is `{}`", names.signature_text(predicate)));
                faults.push(fault);
            }
        }
    }

    /// Adds the guards of the scope in force to a clause.
    ///
    /// Returns `false` after reporting a clause that it cannot guard.
    pub fn guard(
        &mut self,
        clause: &mut Scope<'_>,
        sound: bool,
        names: &mut Names,
        out: &mut Clauses,
        faults: &mut Faults,
    ) -> bool {
        let Some(guard) = self.current else { return true };
        if clause.head.predicate == guard.predicate || clause.body.is_empty() {
            return true;
        }
        let ego = match clause.head.terms.first() {
            Some(&Term::Variable(id)) if is_seen(clause.types[id.index()], guard.ego, names) => Some(id),
            _ => None,
        };
        for (index, ty) in clause.types.iter().enumerate() {
            clause.guarded[index] = ego != Some(variable(index)) && is_seen(*ty, guard.seen, names);
        }
        let in_view = |atom: &Atom, column: usize| {
            let types = names.signatures[atom.predicate.index()]
                .columns
                .as_deref()
                .unwrap_or_default();
            atom.terms[column] == Term::Wildcard
                && types[column].is_some_and(|ty| is_seen(VariableType::Type(ty), guard.seen, names))
        };
        // For each literal: whether each of its columns is a `_` in view.
        let wildcards: Vec<Vec<bool>> = (clause.body.iter())
            .map(|literal| match literal {
                Literal::Positive(atom) | Literal::Negative(atom) => {
                    (0..atom.terms.len()).map(|column| in_view(atom, column)).collect()
                }
                _ => Vec::new(),
            })
            .collect();
        if !clause.guarded.contains(&true) && !wildcards.iter().flatten().any(|&wildcard| wildcard) {
            return true;
        }
        let Some(ego) = ego else {
            // In a faulty clause the type of the head may be unknown.
            if sound {
                self.refuse(clause, guard, names, faults);
            }
            return false;
        };
        if !sound {
            return true;
        }
        self.expand(clause, guard, ego, &wildcards, names, out);
        true
    }

    fn refuse(&self, clause: &Scope<'_>, guard: Guard, names: &Names, faults: &mut Faults) {
        let scope = &names.predicate(guard.predicate).name;
        let ego = names.type_name(guard.ego);
        let fault = Diagnostic::new(
            codes::INVALID_SCOPE,
            format!("the scope `{scope}` cannot guard this clause"),
        )
        .at(
            clause.head.span,
            format!("its first argument is not a variable of type `{ego}`"),
        )
        .also(guard.span, "the scope")
        .note(format!(
            "in a scope, `{scope}` must relate the head's first argument to every other variable of the clause"
        ))
        .help("end the scope before this clause with `.scope` alone");
        faults.push(fault);
    }

    fn expand(
        &mut self,
        clause: &mut Scope<'_>,
        guard: Guard,
        ego: VarId,
        wildcards: &[Vec<bool>],
        names: &mut Names,
        out: &mut Clauses,
    ) {
        let head = clause.head.predicate;
        let mut targets: Vec<VarId> = (0..clause.guarded.len())
            .filter(|&at| clause.guarded[at])
            .map(variable)
            .collect();
        for (literal, wildcards) in clause.body.iter_mut().zip(wildcards) {
            if !wildcards.contains(&true) {
                continue;
            }
            match literal {
                Literal::Positive(atom) => {
                    for (term, _) in atom.terms.iter_mut().zip(wildcards).filter(|(_, in_view)| **in_view) {
                        let fresh = variable(clause.names.len());
                        clause.names.push("_".to_owned());
                        *term = Term::Variable(fresh);
                        targets.push(fresh);
                    }
                }
                Literal::Negative(atom) => {
                    out.edges.push(Edge {
                        from: head,
                        to: guard.predicate,
                        kind: EdgeKind::Negates,
                        span: guard.span,
                    });
                    *atom = self.hide(atom, ego, wildcards, &clause.names, guard, names, out);
                }
                Literal::Compare { .. } | Literal::Compute { .. } | Literal::Aggregate { .. } | Literal::Guard(_) => {}
            }
        }
        let atom = |target: VarId| Atom {
            predicate: guard.predicate,
            terms: vec![Term::Variable(ego), Term::Variable(target)],
            span: guard.span,
        };
        for target in targets {
            let guard_atom = atom(target);
            let written = clause.body.iter().any(|literal| match literal {
                Literal::Positive(atom) => atom.predicate == guard.predicate && atom.terms == guard_atom.terms,
                _ => false,
            });
            if !written {
                clause.body.push(Literal::Guard(guard_atom));
            }
        }
        out.edges.push(Edge {
            from: head,
            to: guard.predicate,
            kind: EdgeKind::Needs,
            span: guard.span,
        });
    }

    /// Returns the atom `+n(ego, others)`, which holds if a row in view matches `atom`.
    #[allow(clippy::too_many_arguments)]
    fn hide(
        &mut self,
        atom: &Atom,
        ego: VarId,
        in_view: &[bool],
        variable_names: &[String],
        guard: Guard,
        names: &mut Names,
        out: &mut Clauses,
    ) -> Atom {
        // New numbering: 0 is the ego, then the other variables of the atom, then the `_`s in view.
        let mut others = vec![ego];
        let mut columns = vec![(guard.ego, variable_names[ego.index()].clone())];
        let types = names.signatures[atom.predicate.index()]
            .columns
            .clone()
            .unwrap_or_default();
        let mut terms = atom.terms.clone();
        for (column, term) in terms.iter_mut().enumerate() {
            let Term::Variable(id) = *term else { continue };
            let position = others.iter().position(|&other| other == id).unwrap_or_else(|| {
                others.push(id);
                columns.push((types[column].unwrap_or(TypeId(0)), variable_names[id.index()].clone()));
                others.len() - 1
            });
            *term = Term::Variable(variable(position));
        }
        let definition = Hidden {
            guard: guard.predicate,
            predicate: atom.predicate,
            terms,
            in_view: in_view.to_vec(),
        };
        let predicate = match self.hidden.get(&definition) {
            Some(&predicate) => predicate,
            None => {
                let predicate = self.define(&definition, &columns, atom.span, guard, names, out);
                self.hidden.insert(definition, predicate);
                predicate
            }
        };
        Atom {
            predicate,
            terms: others.into_iter().map(Term::Variable).collect(),
            span: atom.span,
        }
    }

    fn define(
        &self,
        definition: &Hidden,
        columns: &[(TypeId, String)],
        span: Span,
        guard: Guard,
        names: &mut Names,
        out: &mut Clauses,
    ) -> PredicateId {
        let doc = format!(
            "some `{}` in `{}`",
            names.predicate(definition.predicate).name,
            names.predicate(guard.predicate).name
        );
        let hidden = columns.iter().map(|(ty, name)| (name.clone(), *ty)).collect();
        let predicate = names.hide(hidden, doc, span);
        let mut variables: Vec<String> = columns.iter().map(|(_, name)| name.clone()).collect();
        let mut terms = definition.terms.clone();
        let mut body = Vec::new();
        for (term, in_view) in terms.iter_mut().zip(&definition.in_view) {
            if *in_view {
                let fresh = Term::Variable(variable(variables.len()));
                variables.push("_".to_owned());
                *term = fresh;
                body.push(Literal::Guard(Atom {
                    predicate: guard.predicate,
                    terms: vec![Term::Variable(VarId(0)), fresh],
                    span: guard.span,
                }));
            }
        }
        body.insert(
            0,
            Literal::Positive(Atom {
                predicate: definition.predicate,
                terms,
                span,
            }),
        );
        out.hidden.push(Clause {
            head: Atom {
                predicate,
                terms: (0..columns.len()).map(|at| Term::Variable(variable(at))).collect(),
                span,
            },
            body,
            variable_spans: vec![span; variables.len()],
            variables,
            doc: String::new(),
            span,
        });
        predicate
    }
}

fn variable(index: usize) -> VarId {
    VarId(u32::try_from(index).expect("fewer than 2^32 variables"))
}

/// Returns whether a variable of that type may be in a column of the scope. A value of a base type, such as the symbol of
/// a heading, neither sees nor is seen, unless the column has this type itself.
pub(crate) fn is_seen(ty: VariableType, column: TypeId, names: &Names) -> bool {
    let is_base = match ty {
        VariableType::Unknown => return false,
        VariableType::Base(_) => true,
        VariableType::Type(ty) => ty == Names::base_type(names.base(ty)),
    };
    fits(ty, column, names) && (!is_base || column == Names::base_type(names.base(column)))
}

/// Returns whether the type of a variable is related to that of a column.
fn fits(ty: VariableType, column: TypeId, names: &Names) -> bool {
    match ty {
        VariableType::Unknown => false,
        VariableType::Base(base) => base == names.base(column),
        VariableType::Type(ty) => names.meet(ty, column).is_some(),
    }
}
