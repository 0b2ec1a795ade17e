//! Probabilities of heads: replaces them by literals that draw, before name resolution.
//!
//! ```text
//! 0.3 :: A(x); 0.7 :: B(x) :- C(x, y).    becomes    A(x) :- C(x, y), chance(h, l), choose(h, l, .., 0.3, 0.7, x, y) = 0.
//!                                                    B(x) :- C(x, y), chance(h, l), choose(h, l, .., 0.3, 0.7, x, y) = 1.
//! ```
//!
//! The hidden predicate has one row, the word of the tick. [`crate::chance`] describes the draw. A variable that does
//! not occur in all alternatives of a disjunction, or that begins with `_`, is no part of it.

use std::collections::{HashMap, HashSet};

use crate::chance;
use crate::codes;
use crate::diag::{self, Diagnostic, Faults};

use crate::check::names::Names;
use crate::check::rules::{Column, Function, Predicate, PredicateId, Rules};
use crate::syntax::ast::{
    Atom, BaseType, Clause, ColumnDecl, Comparison, Decl, Item, Literal, Name, Place, Term, TermKind, names_in,
    names_of,
};
use crate::syntax::functor::Functor;
use crate::value::Value;

/// Replaces the probabilities of all items; `None` if there are none.
pub(crate) fn lower(items: &[Item], faults: &mut Faults) -> Option<Vec<Item>> {
    let is_drawn = |item: &Item| matches!(item, Item::Clause(clause) if !clause.probabilities.is_empty());
    let first = items.iter().find(|item| is_drawn(item))?;
    let inline: HashSet<&str> = (items.iter())
        .filter_map(|item| match item {
            Item::Decl(decl) if decl.qualifiers.iter().any(|word| word.text == "inline") => Some(&decl.names),
            _ => None,
        })
        .flatten()
        .map(|name| name.text.as_str())
        .collect();
    let mut numbers: HashMap<&str, usize> = HashMap::new();
    let mut out = Vec::with_capacity(items.len() + 1);
    for item in items {
        match item {
            Item::Clause(clause) if is_drawn(item) => {
                for head in clause
                    .heads
                    .iter()
                    .filter(|head| inline.contains(head.predicate.text.as_str()))
                {
                    let message = format!("the inline predicate `{}` has a probability", head.predicate.text);
                    let fault = Diagnostic::new(codes::INVALID_PROBABILITY, message).at(head.place.0, "");
                    faults.push(fault.help("remove `inline` from its declaration: it has rows, which are drawn"));
                }
                let name = clause.heads.first().map_or("", |head| &head.predicate.text);
                let number = numbers.entry(name).or_default();
                *number += 1;
                let stream = chance::stream(&format!("{name} {number}"));
                check(clause, faults);
                out.extend(alternatives(clause, stream, faults).into_iter().map(Item::Clause));
            }
            _ => out.push(item.clone()),
        }
    }
    if let Item::Clause(clause) = first {
        out.push(Item::Decl(declaration(clause.place)));
    }
    Some(out)
}

/// Returns the predicate with the word of the tick, after marking it as hidden.
pub(crate) fn hide(names: &mut Names) -> Option<PredicateId> {
    let id = names.find(chance::PREDICATE)?;
    names.predicates[id.index()].hidden = true;
    Some(id)
}

fn declaration(place: Place) -> Decl {
    let name = |text: &str| Name {
        text: text.to_owned(),
        place,
    };
    let column = |text: &str| ColumnDecl {
        name: name(text),
        ty: name(BaseType::Unsigned.name()),
    };
    Decl {
        names: vec![name(chance::PREDICATE)],
        columns: Some(vec![column("high"), column("low")]),
        qualifiers: Vec::new(),
        choices: Vec::new(),
        doc: "the word of the tick, from which all draws follow".to_owned(),
    }
}

/// Reports constants that are no probabilities or 0, and aggregates.
fn check(clause: &Clause, faults: &mut Faults) {
    let mut sum = Some(0.0);
    for probability in &clause.probabilities {
        let constant = match &probability.kind {
            TermKind::Number(number) => Some(*number as f64),
            TermKind::Float(text) => text.parse().ok(),
            _ => None,
        };
        sum = sum.zip(constant).map(|(sum, constant)| sum + constant);
        if constant == Some(0.0) {
            let what = match clause.probabilities.len() {
                1 => "clause never fires",
                _ => "alternative is never drawn",
            };
            let fault = Diagnostic::new(codes::DEAD_CLAUSE, format!("this {what}: its probability is 0"));
            faults.push(
                fault
                    .at(probability.place.0, "")
                    .help("remove it, or write a higher probability"),
            );
            continue;
        }
        let fault = match constant {
            Some(constant) if !(0.0..=1.0).contains(&constant) => {
                Diagnostic::new(codes::INVALID_PROBABILITY, "a probability is at least 0 and at most 1").help(
                    match constant {
                        // Of the precision that a program has.
                        2.0..=100.0 => format!("write {constant} percent as `{}`", (constant / 100.0) as f32),
                        _ => "write a number from 0.0 to 1.0 before the `::`".to_owned(),
                    },
                )
            }
            None if has_aggregate(probability) => {
                Diagnostic::new(codes::INVALID_PROBABILITY, "an aggregate in a probability")
                    .help("bind its value to a variable in the body, and write the variable")
            }
            _ => continue,
        };
        faults.push(fault.at(probability.place.0, ""));
        return;
    }
    if let (Some(sum), Some(last)) = (sum, clause.probabilities.last())
        && sum > 1.0 + chance::TOLERANCE
    {
        let message = format!("the probabilities of these alternatives add up to {sum}, which is more than 1");
        let fault = Diagnostic::new(codes::INVALID_PROBABILITY, message).at(last.place.0, "");
        faults.push(fault.help("at most one alternative is drawn; for independent draws, write several clauses"));
    }
}

fn has_aggregate(term: &Term) -> bool {
    match &term.kind {
        TermKind::Aggregate(_) => true,
        TermKind::Functor(_, arguments) => arguments.iter().any(has_aggregate),
        TermKind::Cast(inner, _) => has_aggregate(inner),
        _ => false,
    }
}

/// Returns one clause for each alternative.
fn alternatives(clause: &Clause, stream: u64, faults: &mut Faults) -> Vec<Clause> {
    let place = clause.heads.first().map_or(clause.place, |head| head.place);
    let term = |kind: TermKind| Term { kind, place };
    let unsigned = |number: u64| term(TermKind::Unsigned(number & u64::from(u32::MAX)));
    let [high, low] = ["high of chance", "low of chance"].map(|name| term(TermKind::Variable(name.to_owned())));
    let variables = variables(clause);
    if variables.len() > chance::VALUES_MAX {
        let message = format!("clause with a probability and {} variables", variables.len());
        let fault = Diagnostic::new(diag::codes::LIMIT_EXCEEDED, message).at(place.0, "");
        let note = format!("such a clause has at most {}", chance::VALUES_MAX);
        faults.push(
            fault
                .note(note)
                .help("define a predicate by the body, and draw over that"),
        );
    }
    let fixed = [
        high.clone(),
        low.clone(),
        unsigned(stream >> 32),
        unsigned(stream & u64::from(u32::MAX)),
        unsigned(clause.probabilities.len() as u64),
        // The types of the values are not known yet.
        unsigned(0),
    ];
    let values = variables
        .into_iter()
        .map(|name| term(TermKind::Variable(name.to_owned())));
    let arguments: Vec<Term> = fixed
        .into_iter()
        .chain(clause.probabilities.iter().cloned())
        .chain(values)
        .collect();
    let alternative = |(head, number): (&Atom, i64)| {
        let chance = Atom {
            predicate: Name {
                text: chance::PREDICATE.to_owned(),
                place,
            },
            terms: vec![high.clone(), low.clone()],
            place,
        };
        let choice = Literal::Compare {
            op: Comparison::Equal,
            left: term(TermKind::Functor(Functor::Choose, arguments.clone())),
            right: term(TermKind::Number(number.into())),
            place,
        };
        let drawn = Literal::Atom {
            negated: false,
            atom: chance,
        };
        Clause {
            heads: vec![head.clone()],
            probabilities: Vec::new(),
            body: clause.body.iter().cloned().chain([drawn, choice]).collect(),
            doc: clause.doc.clone(),
            place: clause.place,
        }
    };
    clause.heads.iter().zip(0..).map(alternative).collect()
}

/// Returns the variables whose values a draw is about, in the order of their first occurrence.
fn variables(clause: &Clause) -> Vec<&str> {
    let mut found: Vec<&str> = Vec::new();
    let mut add = |name| {
        if !str::starts_with(name, '_') && !found.contains(&name) {
            found.push(name);
        }
    };
    let terms = clause.heads.iter().flat_map(|head| &head.terms);
    terms.for_each(|term| names_of(term, false, &mut add));
    in_all(&clause.body).into_iter().for_each(&mut add);
    found
}

/// Returns the variables that occur in a body, whichever of its alternatives holds.
fn in_all(body: &[Literal]) -> Vec<&str> {
    let mut found: Vec<&str> = Vec::new();
    for literal in body {
        match literal {
            Literal::Any(alternatives) => {
                let mut each = alternatives.iter().map(|alternative| in_all(alternative));
                let Some(mut common) = each.next() else { continue };
                each.for_each(|other| common.retain(|name| other.contains(name)));
                found.extend(common);
            }
            // A negated atom binds none; a variable that occurs only there is reported.
            _ => names_in(literal, false, &mut |name| found.push(name)),
        }
    }
    found
}

/// A draw among the literals of a checked clause.
#[derive(Clone, Debug, PartialEq)]
pub struct Draw {
    /// The positions of its three literals in the body: the word of the tick, the choice and its comparison.
    pub literals: [usize; 3],
    /// The stream of the clause in the source; its alternatives share it.
    pub stream: u64,
    /// The alternative that must be drawn.
    pub alternative: usize,
    /// The probability of each alternative.
    pub probabilities: Vec<super::Term>,
    /// The variables and constants whose values the draw is about.
    pub values: Vec<super::Term>,
    /// For each of them, whether it is a symbol.
    pub symbols: Vec<bool>,
}

impl Rules {
    /// Returns the draw of a clause that has a probability.
    pub fn draw(&self, clause: &super::Clause) -> Option<Draw> {
        self.chance?;
        let choice = clause.body.iter().position(|literal| {
            matches!(
                literal,
                super::Literal::Compute {
                    functor: Functor::Choose,
                    ..
                }
            )
        })?;
        let super::Literal::Compute { to, arguments, .. } = &clause.body[choice] else {
            return None;
        };
        let word = clause
            .body
            .iter()
            .position(|literal| literal.atom().is_some_and(|atom| Some(atom.predicate) == self.chance))?;
        let (comparison, alternative) = clause.body.iter().enumerate().find_map(|(at, literal)| match literal {
            super::Literal::Compare {
                op: Comparison::Equal,
                left,
                right: super::Term::Constant(alternative),
                ..
            } if left == to => Some((at, alternative.0 as usize)),
            _ => None,
        })?;
        let constant = |at: usize| match arguments[at] {
            super::Term::Constant(value) => value,
            _ => Value(0),
        };
        let (high, low) = (constant(2), constant(3));
        let (probabilities, values) = arguments[chance::FIXED..].split_at(constant(chance::ALTERNATIVES).0 as usize);
        let symbols = constant(chance::SYMBOLS).0;
        Some(Draw {
            literals: [word, choice, comparison],
            stream: u64::from(high.0) << 32 | u64::from(low.0),
            alternative,
            probabilities: probabilities.to_vec(),
            values: values.to_vec(),
            symbols: (0..values.len()).map(|at| symbols >> at & 1 == 1).collect(),
        })
    }

    /// Returns the rules with a hidden input predicate in place of the draws of each clause with probabilities. Each
    /// row has the values of a draw and then the drawn alternative, counted from 0. A number beyond the last
    /// alternative means that none is drawn. Draws with the same stream and probabilities have the same predicate in
    /// all rules.
    pub fn with_draws_as_facts(&self) -> Rules {
        let mut rules = self.clone();
        if let Some(chance) = self.chance {
            for at in 0..rules.clauses.len() {
                if let Some(draw) = self.draw(&rules.clauses[at]) {
                    rules.replace_draw(at, &draw);
                }
            }
            rules.chance = None;
            // Nothing reads it, and its words would exclude a proof.
            rules.predicates[chance.index()].columns.clear();
        }
        rules
    }

    /// Replaces the literals of a draw in the clause at a position.
    fn replace_draw(&mut self, at: usize, draw: &Draw) {
        let clause = &self.clauses[at];
        let span = clause.span;
        let number = |alternative: usize| super::Term::Constant(Value::number(alternative as i32));
        let is = |probability: f32| {
            draw.probabilities.get(draw.alternative) == Some(&super::Term::Constant(Value::float(probability)))
        };
        let drawn = match (is(1.0), is(0.0)) {
            (true, _) => None,
            (_, true) => Some(super::Literal::Compare {
                op: Comparison::Equal,
                left: number(0),
                right: number(1),
                base: BaseType::Number,
                span,
            }),
            _ => {
                // A computed probability counts as a value.
                let computed = draw.probabilities.iter().filter(|term| term.variable().is_some());
                let terms: Vec<super::Term> = computed.chain(&draw.values).copied().collect();
                let predicate = self.draw_predicate(at, draw, &terms);
                Some(super::Literal::Positive(super::Atom {
                    predicate,
                    terms: terms.into_iter().chain([number(draw.alternative)]).collect(),
                    span,
                }))
            }
        };
        let body = std::mem::take(&mut self.clauses[at].body);
        let others = (0..)
            .zip(body)
            .filter(|(position, _)| !draw.literals.contains(position));
        self.clauses[at].body = others.map(|(_, literal)| literal).chain(drawn).collect();
    }

    /// Returns the predicate with the facts of a draw about some terms, and adds it if it is new.
    fn draw_predicate(&mut self, at: usize, draw: &Draw, terms: &[super::Term]) -> PredicateId {
        let clause = &self.clauses[at];
        let bases = self.bases(clause);
        let word = &self.predicates[self.chance.expect("a clause draws").index()];
        let column = |term: &super::Term| {
            let atoms = clause.body.iter().filter_map(super::Literal::atom);
            let known = atoms.chain([&clause.head]).find_map(|atom| {
                let place = atom.terms.iter().position(|known| known == term)?;
                self.predicates[atom.predicate.index()].columns.get(place)
            });
            Column {
                name: String::new(),
                ty: known.map_or(word.columns[0].ty, |column| column.ty),
                base: term
                    .variable()
                    .map_or(BaseType::Unsigned, |variable| bases[variable.index()]),
            }
        };
        let mut columns: Vec<Column> = terms.iter().map(column).collect();
        columns.push(Column {
            base: BaseType::Number,
            ..word.columns[0].clone()
        });
        let probabilities: Vec<String> = (draw.probabilities.iter())
            .map(|term| match term {
                super::Term::Constant(value) => value.as_float().to_string(),
                _ => "a computed probability".to_owned(),
            })
            .collect();
        let kinds: Vec<&str> = columns.iter().map(|column| column.base.name()).collect();
        let (probabilities, kinds) = (probabilities.join(", "), kinds.join(", "));
        let [before, after] = AROUND_PROBABILITIES;
        let name = format!("{before}{probabilities}{after}{:016x} over {kinds}", draw.stream);
        if let Some(known) = self.predicate(&name) {
            return known;
        }
        let predicate = PredicateId(u32::try_from(self.predicates.len()).expect("fewer than 2^32 predicates"));
        self.predicates.push(Predicate {
            name,
            columns,
            input: true,
            ..word.clone()
        });
        let symbols = None;
        self.functions.push(Function { predicate, symbols });
        predicate
    }
}

/// The words before and after the probabilities in the names of predicates of [`Rules::with_draws_as_facts`].
const AROUND_PROBABILITIES: [&str; 2] = ["draw of ", " in the stream "];

/// Returns the probabilities of the alternatives, with `, ` between them, if a name is that of a predicate of
/// [`Rules::with_draws_as_facts`].
pub fn drawn_probabilities(name: &str) -> Option<&str> {
    let [before, after] = AROUND_PROBABILITIES;
    Some(name.strip_prefix(before)?.split_once(after)?.0)
}
