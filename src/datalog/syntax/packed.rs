//! Facts of constants in a compact form.
//!
//! A program may hold millions of facts, and the syntax tree of a fact is some thirty times as long as its text. So the
//! facts of plain numbers and strings are kept as words, in place of trees. [`PackedFacts::clause`] restores the tree,
//! with all places, where one is needed.
// Decision: docs/decisions/facts.md#d009

use crate::diag::{SourceId, Span};
use crate::syntax::ast::{Atom, Clause, Item, Name, Place, Term, TermKind};
use std::collections::HashMap;
use std::ops::Range;

/// The packed facts of one source, in source order.
#[derive(Clone, Debug)]
pub(crate) struct PackedFacts {
    source: SourceId,
    /// The names of the predicates.
    names: Vec<String>,
    /// The positions in `names`. Only for lookup, never iterated.
    known: HashMap<String, u32>,
    facts: Vec<PackedFact>,
    terms: Vec<PackedTerm>,
    /// The strings of all facts, one after the other.
    symbols: String,
    /// Facts without other items between them: the number of items before them in their source, and their positions.
    pub(crate) runs: Vec<(usize, Range<usize>)>,
}

/// A fact. Places are distances from its first byte.
#[derive(Clone, Copy, Debug)]
struct PackedFact {
    start: u32,
    name: u32,
    first_term: u32,
    atom_end: u16,
    end: u16,
}

/// A constant with its place.
#[derive(Clone, Copy, Debug)]
struct PackedTerm {
    start: u16,
    end: u16,
    constant: PackedConstant,
}

/// A constant of a packed fact.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum PackedConstant {
    Number(i32),
    /// The end of a string in the symbols; it begins at the end of the string before.
    Symbol(u32),
}

/// A constant as a fact writes it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Constant<'a> {
    Number(i32),
    Symbol(&'a str),
}

impl PackedFacts {
    /// Makes an empty list for facts of this source.
    pub(crate) fn new(source: SourceId) -> Self {
        PackedFacts {
            source,
            names: Vec::new(),
            known: HashMap::new(),
            facts: Vec::new(),
            terms: Vec::new(),
            symbols: String::new(),
            runs: Vec::new(),
        }
    }

    /// Adds a clause that follows `before` other items.
    ///
    /// # Errors
    /// The clause, if it is not a single fact of plain numbers and strings, or too long.
    pub(crate) fn push(&mut self, before: usize, clause: Clause) -> Result<(), Clause> {
        // A fact with a probability is a rule, which draws.
        let certain = clause.probabilities.is_empty();
        match certain.then(|| self.packed(&clause)).flatten() {
            None => return Err(clause),
            Some(fact) => self.facts.push(fact),
        }
        let at = self.facts.len();
        match self.runs.last_mut() {
            Some((last, facts)) if *last == before => facts.end = at,
            _ => self.runs.push((before, at - 1..at)),
        }
        Ok(())
    }

    /// Adds the terms of a fact and returns its record.
    fn packed(&mut self, clause: &Clause) -> Option<PackedFact> {
        let [head] = clause.heads.as_slice() else { return None };
        let start = clause.place.0.start;
        let distance = |byte: u32| u16::try_from(byte - start).ok();
        let fact = PackedFact {
            start,
            name: 0,
            first_term: u32::try_from(self.terms.len()).ok()?,
            atom_end: distance(head.place.0.end)?,
            end: distance(clause.place.0.end)?,
        };
        let is_plain = |term: &Term| match &term.kind {
            TermKind::Number(number) => i32::try_from(*number).is_ok(),
            TermKind::Symbol(_) => true,
            _ => false,
        };
        let fits = u32::try_from(self.symbols.len() + fact.end as usize).is_ok();
        if !fits || !clause.body.is_empty() || !clause.doc.is_empty() || !head.terms.iter().all(is_plain) {
            return None;
        }
        for term in &head.terms {
            let constant = match &term.kind {
                TermKind::Number(number) => PackedConstant::Number(i32::try_from(*number).ok()?),
                TermKind::Symbol(text) => {
                    self.symbols.push_str(text);
                    PackedConstant::Symbol(u32::try_from(self.symbols.len()).ok()?)
                }
                _ => return None,
            };
            self.terms.push(PackedTerm {
                start: distance(term.place.0.start)?,
                end: distance(term.place.0.end)?,
                constant,
            });
        }
        let name = match self.known.get(&head.predicate.text) {
            Some(&name) => name,
            None => {
                let name = u32::try_from(self.names.len()).ok()?;
                self.names.push(head.predicate.text.clone());
                self.known.insert(head.predicate.text.clone(), name);
                name
            }
        };
        Some(PackedFact { name, ..fact })
    }

    /// Returns the names of the predicates; [`PackedFacts::name`] is a position among them.
    pub(crate) fn names(&self) -> &[String] {
        &self.names
    }

    /// Returns the position of a fact's predicate in [`PackedFacts::names`].
    pub(crate) fn name(&self, fact: usize) -> usize {
        self.facts[fact].name as usize
    }

    fn terms(&self, fact: usize) -> Range<usize> {
        let end = self
            .facts
            .get(fact + 1)
            .map_or(self.terms.len(), |next| next.first_term as usize);
        self.facts[fact].first_term as usize..end
    }

    /// Returns the constants of a fact.
    pub(crate) fn constants(&self, fact: usize) -> impl ExactSizeIterator<Item = Constant<'_>> {
        self.terms(fact).map(|at| match self.terms[at].constant {
            PackedConstant::Number(number) => Constant::Number(number),
            PackedConstant::Symbol(end) => Constant::Symbol(&self.symbols[self.symbol_start(at)..end as usize]),
        })
    }

    /// Returns the start of the string of a term: the end of the string before.
    fn symbol_start(&self, term: usize) -> usize {
        let ends = self.terms[..term].iter().rev().map(|term| term.constant);
        let mut ends = ends.filter_map(|constant| match constant {
            PackedConstant::Symbol(end) => Some(end as usize),
            PackedConstant::Number(_) => None,
        });
        ends.next().unwrap_or(0)
    }

    fn span(&self, fact: usize, from: u16, to: u16) -> Span {
        let start = self.facts[fact].start as usize;
        Span::new(self.source, start + from as usize..start + to as usize)
    }

    /// Returns the place of a fact's atom.
    pub(crate) fn atom_span(&self, fact: usize) -> Span {
        self.span(fact, 0, self.facts[fact].atom_end)
    }

    /// Returns the place of a fact.
    pub(crate) fn clause_span(&self, fact: usize) -> Span {
        self.span(fact, 0, self.facts[fact].end)
    }

    /// Returns the syntax tree of a fact.
    pub(crate) fn clause(&self, fact: usize) -> Clause {
        let name = &self.names[self.name(fact)];
        let terms = self.terms(fact).zip(self.constants(fact)).map(|(at, constant)| Term {
            kind: match constant {
                Constant::Number(number) => TermKind::Number(number.into()),
                Constant::Symbol(text) => TermKind::Symbol(text.to_owned()),
            },
            place: Place(self.span(fact, self.terms[at].start, self.terms[at].end)),
        });
        let start = self.facts[fact].start as usize;
        let head = Atom {
            predicate: Name {
                text: name.clone(),
                place: Place(Span::new(self.source, start..start + name.len())),
            },
            terms: terms.collect(),
            place: Place(self.atom_span(fact)),
        };
        Clause {
            heads: vec![head],
            probabilities: Vec::new(),
            body: Vec::new(),
            doc: String::new(),
            place: Place(self.clause_span(fact)),
        }
    }
}

/// The packed facts of a program.
#[derive(Clone, Debug, Default)]
pub(crate) struct FactRuns {
    files: Vec<PackedFacts>,
    runs: Vec<FactRun>,
}

/// Facts without other items between them.
#[derive(Clone, Debug)]
struct FactRun {
    /// The number of items of the program before them.
    before: usize,
    /// The position of their source in [`FactRuns::files`].
    file: usize,
    facts: Range<usize>,
}

impl FactRuns {
    /// Adds the facts of a source without runs; [`FactRuns::add_run`] adds these.
    pub(crate) fn add_file(&mut self, facts: PackedFacts) -> usize {
        self.files.push(facts);
        self.files.len() - 1
    }

    /// Adds facts of a file that follow `before` items of the program.
    pub(crate) fn add_run(&mut self, before: usize, file: usize, facts: Range<usize>) {
        self.runs.push(FactRun { before, file, facts });
    }

    /// Returns the packed facts of each source.
    pub(crate) fn files(&self) -> &[PackedFacts] {
        &self.files
    }

    /// Returns the runs in order: the number of items before each, the position of its source among the
    /// [`files`](FactRuns::files), and its positions there.
    pub(crate) fn runs(&self) -> impl Iterator<Item = (usize, usize, Range<usize>)> {
        self.runs.iter().map(|run| (run.before, run.file, run.facts.clone()))
    }

    /// Returns the syntax trees of all facts.
    pub(crate) fn clauses(&self) -> impl Iterator<Item = Clause> {
        self.runs()
            .flat_map(move |(_, file, facts)| facts.map(move |fact| self.files[file].clause(fact)))
    }

    /// Moves all facts to their places among the items, as syntax trees.
    pub(crate) fn unpack(&mut self, items: &mut Vec<Item>) {
        if self.runs.is_empty() {
            return;
        }
        let mut rest = std::mem::take(items).into_iter();
        let mut taken = 0;
        let packed = std::mem::take(self);
        for (before, file, facts) in packed.runs() {
            items.extend(rest.by_ref().take(before - taken));
            taken = before;
            items.extend(facts.map(|fact| Item::Clause(packed.files[file].clause(fact))));
        }
        items.extend(rest);
    }
}
