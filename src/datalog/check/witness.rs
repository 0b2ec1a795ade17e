//! Witnesses of `min` and `max`.
//!
//! ```text
//! Youngest(p, n) :- n = min x : { Age(p, x) }.
//! becomes
//! Youngest(p, n) :- n = min x : { Age(q, x) }, Age(p, y), n = y.
//! ```
//!
//! A variable in the body of `min` or `max` that also occurs outside, but is bound nowhere there, is a witness: it
//! takes the values for which the aggregate attains its result.
//!
//! A variable that would not be bound without the result of an aggregate is another one in the body of that aggregate:
//!
//! ```text
//! Last(n) :- n = max x : { Section(_, n), x = n }.
//! becomes
//! Last(n) :- n = max x : { Section(_, m), x = m }.
//! ```
//!
//! The rewriting works on syntax, before name resolution.

use std::collections::{HashMap, HashSet};

use crate::syntax::ast::Comparison;
use crate::syntax::ast::{Aggregate, Atom, Literal, Term, TermKind};
use crate::syntax::ast::{names_in, names_of};
use crate::syntax::functor::AggregateOp;

/// The end of the names from [`Rewriting::shadow`]. Names of the source have no dot.
const LOCAL: &str = ".local";

/// The rewriting would make a body too long.
pub(crate) struct TooLong;

/// Rewrites the aggregates with witnesses, also nested ones, innermost first; `None` if there are none. `literals_max`
/// bounds the literals that it adds.
pub(crate) fn write_out(head: &Atom, body: &[&Literal], literals_max: usize) -> Result<Option<Vec<Literal>>, TooLong> {
    if !body.iter().any(|literal| has_selection(literal)) {
        return Ok(None);
    }
    let body: Vec<Literal> = body.iter().map(|literal| (*literal).clone()).collect();
    let mut outside = HashSet::new();
    head.terms
        .iter()
        .for_each(|term| names_of(term, false, &mut |name| note(name, &mut outside)));
    let mut rewriting = Rewriting {
        left: literals_max,
        fresh: 0,
        any: false,
    };
    let out = rewriting.body(body, outside, &HashSet::new())?;
    Ok(rewriting.any.then_some(out))
}

fn note(name: &str, names: &mut HashSet<String>) {
    if !names.contains(name) {
        names.insert(name.to_owned());
    }
}

struct Rewriting {
    /// The number of literals that the rewriting may still add.
    left: usize,
    /// The number of rewritten aggregates, which makes their variables unique.
    fresh: usize,
    /// Whether any aggregate has witnesses.
    any: bool,
}

impl Rewriting {
    /// Rewrites the body of a clause or of an aggregate.
    ///
    /// `outside` are the variables of the head, or of the aggregate's target and the witnesses of the aggregate.
    /// `taken` are the variables of the enclosing bodies that cannot be witnesses here.
    fn body(
        &mut self,
        body: Vec<Literal>,
        mut outside: HashSet<String>,
        taken: &HashSet<String>,
    ) -> Result<Vec<Literal>, TooLong> {
        for literal in &body {
            names_in(literal, false, &mut |name| note(name, &mut outside));
        }
        let mut bound = taken.clone();
        bound.extend(
            bound_names(&body.iter().collect::<Vec<_>>(), HashSet::new())
                .into_iter()
                .map(str::to_owned),
        );
        let shadowed = shadowed_names(&body, &bound, taken);
        let witnesses: HashSet<String> = outside.difference(&bound).cloned().collect();
        let shared: HashSet<String> = bound.union(&outside).cloned().collect();
        let mut out: Vec<Literal> = Vec::with_capacity(body.len());
        for (mut literal, shadowed) in body.into_iter().zip(shadowed) {
            self.shadow(&mut literal, shadowed);
            // A witness of an aggregate may be one of an aggregate in its body. No other variable of this body is.
            let (outside_inner, taken) = match selection(&literal) {
                Some(_) => (&witnesses, &bound),
                None => (&HashSet::new(), &shared),
            };
            self.aggregates_of_literal(&mut literal, outside_inner, taken)?;
            self.literal(literal, &outside, &bound, &mut out)?;
        }
        Ok(out)
    }

    /// Renames these variables in the body of the aggregate of `x = { ... }`: there they are other ones, which are local.
    fn shadow(&mut self, literal: &mut Literal, shadowed: Vec<String>) {
        let Literal::Compare { left, right, .. } = literal else {
            return;
        };
        if shadowed.is_empty() {
            return;
        }
        let local = |name: &str| TermKind::Variable(format!("+{name}.{}{LOCAL}", self.fresh));
        let names: Names = (shadowed.into_iter())
            .map(|name| (name.clone(), local(&name)))
            .collect();
        for term in [left, right] {
            if let TermKind::Aggregate(aggregate) = &mut term.kind {
                let body = aggregate.body.iter_mut();
                body.for_each(|literal| *literal = renamed(literal, &names));
            }
        }
        self.fresh += 1;
        self.any = true;
    }

    /// Rewrites the bodies of the aggregates in a literal.
    fn aggregates_of_literal(
        &mut self,
        literal: &mut Literal,
        outside: &HashSet<String>,
        taken: &HashSet<String>,
    ) -> Result<(), TooLong> {
        match literal {
            Literal::Atom { atom, .. } => {
                (atom.terms.iter_mut()).try_for_each(|term| self.aggregates_of_term(term, outside, taken))
            }
            Literal::Compare { left, right, .. } => {
                self.aggregates_of_term(left, outside, taken)?;
                self.aggregates_of_term(right, outside, taken)
            }
            // The body of an aggregate has no alternatives; those of a clause are separate bodies.
            Literal::Temporal { .. } | Literal::Any(_) => Ok(()),
        }
    }

    fn aggregates_of_term(
        &mut self,
        term: &mut Term,
        outside: &HashSet<String>,
        taken: &HashSet<String>,
    ) -> Result<(), TooLong> {
        match &mut term.kind {
            TermKind::Functor(_, arguments) => {
                (arguments.iter_mut()).try_for_each(|argument| self.aggregates_of_term(argument, outside, taken))
            }
            TermKind::Cast(inner, _) => self.aggregates_of_term(inner, outside, taken),
            TermKind::Aggregate(aggregate) => {
                let mut outside = outside.clone();
                if let Some(target) = &aggregate.target {
                    names_of(target, false, &mut |name| note(name, &mut outside));
                }
                aggregate.body = self.body(std::mem::take(&mut aggregate.body), outside, taken)?;
                Ok(())
            }
            _ => Ok(()),
        }
    }

    /// Appends a literal to `out`, rewritten if it is an aggregate with witnesses.
    fn literal(
        &mut self,
        literal: Literal,
        outside: &HashSet<String>,
        bound: &HashSet<String>,
        out: &mut Vec<Literal>,
    ) -> Result<(), TooLong> {
        let Some((result, aggregate, target)) = selection(&literal) else {
            out.push(literal);
            return Ok(());
        };
        let (mut inside, mut of_target): (HashSet<&str>, HashSet<&str>) = (HashSet::new(), HashSet::new());
        for literal in &aggregate.body {
            names_in(literal, true, &mut |name| {
                inside.insert(name);
            });
        }
        names_of(target, true, &mut |name| {
            of_target.insert(name);
        });
        let free = |name: &str| !bound.contains(name) || of_target.contains(name);
        let is_witness = |name: &str| outside.contains(name) && !bound.contains(name);
        if !inside.iter().any(|name| is_witness(name)) {
            out.push(literal);
            return Ok(());
        }
        let added = 1 + aggregate.body.iter().map(size).sum::<usize>();
        self.left = self.left.checked_sub(added).ok_or(TooLong)?;
        self.any = true;
        let index = self.fresh;
        self.fresh += 1;
        let place = target.place;
        let result = match &result.kind {
            TermKind::Wildcard => variable(format!("+{index}"), result),
            _ => result.clone(),
        };
        // The aggregate gets fresh names for its witnesses.
        let apart = rename(&inside, |name| is_witness(name).then(|| format!("+{name}.{index}")));
        out.push(Literal::Compare {
            op: Comparison::Equal,
            left: result.clone(),
            right: Term {
                kind: TermKind::Aggregate(Box::new(Aggregate {
                    op: aggregate.op,
                    target: Some(renamed_term(target, &apart)),
                    body: aggregate.body.iter().map(|literal| renamed(literal, &apart)).collect(),
                })),
                place,
            },
            place,
        });
        // A second copy of the body holds for the result of the aggregate.
        let again = rename(&inside, |name| {
            (free(name) && !is_witness(name)).then(|| format!("+{name}.{index}.found"))
        });
        out.extend(aggregate.body.iter().map(|literal| renamed(literal, &again)));
        out.push(Literal::Compare {
            op: Comparison::Equal,
            left: result,
            right: renamed_term(target, &again),
            place,
        });
        Ok(())
    }
}

/// Returns the name that the source has for a variable that the checker renamed: `x` for `+x.0.found`; `_` if none.
pub(crate) fn written(name: &str) -> &str {
    let renamed = name.trim_start_matches('+');
    if renamed.len() == name.len() {
        return name;
    }
    match renamed.split_once('.') {
        Some((written, _)) => written,
        None => "_",
    }
}

/// Returns whether the variable has its name from [`Rewriting::shadow`].
pub(crate) fn is_shadow(name: &str) -> bool {
    name.ends_with(LOCAL)
}

/// Returns the number of literals in a literal, with those of its aggregates.
pub(crate) fn size(literal: &Literal) -> usize {
    fn of_term(term: &Term) -> usize {
        match &term.kind {
            TermKind::Functor(_, arguments) => arguments.iter().map(of_term).sum(),
            TermKind::Cast(inner, _) => of_term(inner),
            TermKind::Aggregate(aggregate) => aggregate.body.iter().map(size).sum(),
            _ => 0,
        }
    }
    1 + match literal {
        Literal::Atom { atom, .. } => atom.terms.iter().map(of_term).sum(),
        Literal::Compare { left, right, .. } => of_term(left) + of_term(right),
        Literal::Temporal { .. } => 0,
        Literal::Any(alternatives) => alternatives.iter().flatten().map(size).sum(),
    }
}

/// Returns whether the literal or an aggregate in it has the form `x = min y : { ... }`, or `x = count : { ... }`.
fn has_selection(literal: &Literal) -> bool {
    fn in_term(term: &Term) -> bool {
        match &term.kind {
            TermKind::Functor(_, arguments) => arguments.iter().any(in_term),
            TermKind::Cast(inner, _) => in_term(inner),
            TermKind::Aggregate(aggregate) => aggregate.body.iter().any(has_selection),
            _ => false,
        }
    }
    selection(literal).is_some()
        || equated(literal).is_some()
        || match literal {
            Literal::Atom { atom, .. } => atom.terms.iter().any(in_term),
            Literal::Compare { left, right, .. } => in_term(left) || in_term(right),
            Literal::Temporal { .. } | Literal::Any(_) => false,
        }
}

/// Returns the result, the aggregate and its target if the literal has the form `x = min y : { ... }`.
fn selection(literal: &Literal) -> Option<(&Term, &Aggregate, &Term)> {
    let (left, right) = equal_sides(literal)?;
    let (result, aggregate) = match (&left.kind, &right.kind) {
        (_, TermKind::Aggregate(aggregate)) => (left, aggregate),
        (TermKind::Aggregate(aggregate), _) => (right, aggregate),
        _ => return None,
    };
    let simple = !matches!(
        result.kind,
        TermKind::Functor(..) | TermKind::Cast(..) | TermKind::Aggregate(_)
    );
    let target = aggregate.target.as_ref()?;
    let selects = matches!(aggregate.op, AggregateOp::Min | AggregateOp::Max);
    (simple && selects).then_some((result, aggregate, target))
}

/// Returns the sides of an equality.
fn equal_sides(literal: &Literal) -> Option<(&Term, &Term)> {
    match literal {
        Literal::Compare {
            op: Comparison::Equal,
            left,
            right,
            ..
        } => Some((left, right)),
        _ => None,
    }
}

/// Returns the aggregate of a literal `x = count : { ... }`.
fn equated(literal: &Literal) -> Option<&Aggregate> {
    let (left, right) = equal_sides(literal)?;
    match (&left.kind, &right.kind) {
        (TermKind::Variable(_), TermKind::Aggregate(aggregate))
        | (TermKind::Aggregate(aggregate), TermKind::Variable(_)) => Some(aggregate),
        _ => None,
    }
}

/// Returns, for each literal `x = count : { ... }`, the variables of the aggregate's body that would not be `bound`
/// without this literal. Variables of the target are local anyway.
fn shadowed_names(body: &[Literal], bound: &HashSet<String>, taken: &HashSet<String>) -> Vec<Vec<String>> {
    let others = |skip: &dyn Fn(usize) -> bool| {
        let literals = body.iter().enumerate().filter(|(index, _)| !skip(*index));
        bound_names(
            &literals.map(|(_, literal)| literal).collect::<Vec<_>>(),
            HashSet::new(),
        )
    };
    let without_results = others(&|index| equated(&body[index]).is_some());
    let shadowed = |(index, literal): (usize, &Literal)| {
        let mut names: Vec<String> = Vec::new();
        let Some(aggregate) = equated(literal) else {
            return names;
        };
        let mut in_target = HashSet::new();
        let target = aggregate.target.iter();
        target.for_each(|target| names_of(target, true, &mut |name| _ = in_target.insert(name)));
        for literal in &aggregate.body {
            names_in(literal, true, &mut |name| {
                let result = bound.contains(name) && !without_results.contains(name);
                if result
                    && !taken.contains(name)
                    && !in_target.contains(name)
                    && names.iter().all(|other| other != name)
                {
                    names.push(name.to_owned());
                }
            });
        }
        if !names.is_empty() {
            let elsewhere = others(&|other| other == index);
            names.retain(|name| !elsewhere.contains(name.as_str()));
        }
        names
    };
    body.iter().enumerate().map(shadowed).collect()
}

/// Returns the names `bound`, and those that the literals bind outside of aggregates and alternatives. Results of
/// aggregates count as bound.
pub(crate) fn bound_names<'c>(body: &[&'c Literal], mut bound: HashSet<&'c str>) -> HashSet<&'c str> {
    // The equations with unbound names: how many occurrences, and the name that the equation then binds.
    let mut waiting: Vec<(usize, &str)> = Vec::new();
    let mut users: HashMap<&str, Vec<usize>> = HashMap::new();
    let mut found: Vec<&str> = Vec::new();
    for literal in body {
        match literal {
            Literal::Atom { negated: false, atom } => found.extend(atom.terms.iter().filter_map(name)),
            Literal::Compare {
                op: Comparison::Equal,
                left,
                right,
                ..
            } => {
                for (to, from) in [(left, right), (right, left)] {
                    let Some(to) = name(to) else { continue };
                    let mut unbound = Vec::new();
                    names_of(from, false, &mut |name| {
                        if !bound.contains(name) {
                            unbound.push(name);
                        }
                    });
                    if unbound.is_empty() {
                        found.push(to);
                        continue;
                    }
                    let count = unbound.len();
                    for name in unbound {
                        users.entry(name).or_default().push(waiting.len());
                    }
                    waiting.push((count, to));
                }
            }
            _ => {}
        }
    }
    while let Some(name) = found.pop() {
        if !bound.insert(name) {
            continue;
        }
        for &equation in users.get(name).into_iter().flatten() {
            let (unbound, to) = &mut waiting[equation];
            *unbound -= 1;
            if *unbound == 0 {
                found.push(to);
            }
        }
    }
    bound
}

fn name(term: &Term) -> Option<&str> {
    match &term.kind {
        TermKind::Variable(name) => Some(name),
        _ => None,
    }
}

fn variable(name: String, at: &Term) -> Term {
    Term {
        kind: TermKind::Variable(name),
        place: at.place,
    }
}

/// A substitution of variables.
pub(crate) type Names = HashMap<String, TermKind>;

fn rename(names: &HashSet<&str>, new: impl Fn(&str) -> Option<String>) -> Names {
    names
        .iter()
        .filter_map(|name| Some(((*name).to_owned(), TermKind::Variable(new(name)?))))
        .collect()
}

pub(crate) fn renamed(literal: &Literal, names: &Names) -> Literal {
    let mut literal = literal.clone();
    match &mut literal {
        Literal::Atom { atom, .. } => atom.terms.iter_mut().for_each(|term| *term = renamed_term(term, names)),
        Literal::Compare { left, right, .. } => {
            *left = renamed_term(left, names);
            *right = renamed_term(right, names);
        }
        Literal::Temporal { temporal, .. } => {
            let terms = temporal.atoms_mut().flat_map(|atom| &mut atom.terms);
            terms.for_each(|term| *term = renamed_term(term, names));
        }
        Literal::Any(alternatives) => {
            for literal in alternatives.iter_mut().flatten() {
                *literal = renamed(literal, names);
            }
        }
    }
    literal
}

pub(crate) fn renamed_term(term: &Term, names: &Names) -> Term {
    let mut term = term.clone();
    match &mut term.kind {
        TermKind::Variable(name) => {
            if let Some(new) = names.get(name.as_str()) {
                term.kind = new.clone();
            }
        }
        TermKind::Functor(_, arguments) => {
            for argument in arguments {
                *argument = renamed_term(argument, names);
            }
        }
        TermKind::Cast(inner, _) => **inner = renamed_term(inner, names),
        TermKind::Aggregate(aggregate) => {
            aggregate.target = aggregate.target.as_ref().map(|target| renamed_term(target, names));
            for literal in &mut aggregate.body {
                *literal = renamed(literal, names);
            }
        }
        TermKind::Wildcard
        | TermKind::Number(_)
        | TermKind::Address(_)
        | TermKind::Unsigned(_)
        | TermKind::Float(_)
        | TermKind::Symbol(_) => {}
    }
    term
}
