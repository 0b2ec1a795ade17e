//! Equality of clauses up to the names of variables and the order of clauses and literals. The order inside aggregates
//! and around ranges counts.
//!
//! Two rule sets with the same clauses are equivalent whatever they compute, so this proves what neither a circuit nor
//! single scenes can: that a program with expressions or aggregates equals a renamed, reordered or formatted copy. Each
//! clause gets a canonical text. Where color refinement does not distinguish variables, equal clauses may get different
//! texts; then there is no proof, but no wrong one either.

use crate::analysis::diff::pair::{Pair, Side};
use crate::check::{Atom, Clause, Literal, PredicateId, Term, VarId};
use crate::symbol::Symbol;
use crate::syntax::ast::BaseType;
use crate::value::{Value, record_text};
use std::collections::hash_map::DefaultHasher;
use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::hash::{Hash, Hasher};

/// Returns whether the outputs have the same clauses on both sides, and so has everything that these read.
pub(super) fn same_clauses(pair: &Pair<'_>) -> bool {
    // Both sides share the numbers of definitions.
    let mut numbers = HashMap::new();
    let mut open: Vec<[PredicateId; 2]> = pair.outputs.iter().map(|output| output.ids).collect();
    let mut forms = [Forms::new(&pair.sides[0]), Forms::new(&pair.sides[1])];
    let mut seen = BTreeSet::new();
    while let Some([left, right]) = open.pop() {
        if !seen.insert([left, right]) {
            continue;
        }
        let [of_left, of_right] = &mut forms;
        if of_left.definition(left, &mut numbers) != of_right.definition(right, &mut numbers) {
            return false;
        }
        // The definitions name the same predicates.
        let read = std::mem::take(&mut of_left.read).into_iter();
        let mut other = std::mem::take(&mut of_right.read);
        open.extend(read.filter_map(|(name, left)| Some([left, other.remove(name)?])));
    }
    true
}

/// The canonical forms of the predicates of one side.
struct Forms<'a> {
    side: &'a Side<'a>,
    /// The numbers of the definitions of hidden predicates.
    hidden: HashMap<PredicateId, usize>,
    /// The hidden predicates whose definitions are being computed, each for the one before.
    stack: Vec<PredicateId>,
    /// The lowest position in the stack to which the definition being computed refers.
    lowest: usize,
    /// The predicates whose rows inserted facts make up, by the hidden predicate for these.
    edb: HashMap<PredicateId, PredicateId>,
    /// The predicates that the definitions computed last name.
    read: BTreeMap<&'a str, PredicateId>,
}

impl<'a> Forms<'a> {
    fn new(side: &'a Side<'a>) -> Forms<'a> {
        let predicates = side.rules.predicates.iter().zip((0..).map(PredicateId));
        Forms {
            side,
            hidden: HashMap::new(),
            stack: Vec::new(),
            lowest: usize::MAX,
            edb: predicates
                .filter_map(|(predicate, id)| Some((predicate.edb?, id)))
                .collect(),
            read: BTreeMap::new(),
        }
    }

    /// Returns the columns and clauses of a predicate as text.
    fn definition(&mut self, predicate: PredicateId, numbers: &mut HashMap<String, usize>) -> String {
        let side = self.side;
        let declared = &side.rules.predicates[predicate.index()];
        let columns: Vec<&str> = declared.columns.iter().map(|column| column.base.name()).collect();
        let clauses = side.clauses[predicate.index()].iter();
        let mut clauses: Vec<String> = clauses.map(|clause| self.clause(clause, numbers)).collect();
        clauses.sort_unstable();
        clauses.dedup();
        format!(
            "({}) input {:?} parameters {}\n{}",
            columns.join(", "),
            side.base[predicate.index()],
            declared.parameters,
            clauses.join("\n")
        )
    }

    /// Returns the name of a predicate. For a hidden one this is the number of its definition, or how far it is up the
    /// stack.
    fn name(&mut self, predicate: PredicateId, numbers: &mut HashMap<String, usize>) -> String {
        let declared = &self.side.rules.predicates[predicate.index()];
        if let Some(of) = self.edb.get(&predicate) {
            return format!("input {}", self.side.rules.predicates[of.index()].name);
        }
        if !declared.hidden {
            self.read.insert(&declared.name, predicate);
            return declared.name.clone();
        }
        if let Some(known) = self.hidden.get(&predicate) {
            return format!("#{known}");
        }
        let depth = self.stack.len();
        if let Some(position) = self.stack.iter().position(|one| *one == predicate) {
            self.lowest = self.lowest.min(position);
            return format!("^{}", depth - position);
        }
        let lowest = std::mem::replace(&mut self.lowest, usize::MAX);
        self.stack.push(predicate);
        let definition = self.definition(predicate, numbers);
        self.stack.pop();
        let next = numbers.len();
        let number = *numbers.entry(definition).or_insert(next);
        // A definition that refers to a predicate around it has a meaning only there.
        match self.lowest < depth {
            true => self.lowest = self.lowest.min(lowest),
            false => {
                self.hidden.insert(predicate, number);
                self.lowest = lowest;
            }
        }
        format!("#{number}")
    }

    /// Returns the canonical text of a clause.
    fn clause(&mut self, clause: &Clause, numbers: &mut HashMap<String, usize>) -> String {
        let head = CanonicalLiteral {
            text: String::new(),
            terms: self.atom_terms(&clause.head),
        };
        let body = clause.body.iter().map(|literal| self.part(literal, numbers));
        let mut body: Vec<CanonicalLiteral> = body.collect();
        let colors = colors(&head, &body, clause.variables.len());
        body.sort_by_cached_key(|part| (part.text.clone(), part.hash(&colors)));
        let mut names: HashMap<VarId, usize> = HashMap::new();
        let mut text = String::new();
        for part in std::iter::once(&head).chain(&body) {
            text += &part.text;
            for term in &part.terms {
                text += &match term {
                    Argument::Variable(id) => {
                        let next = names.len();
                        format!(" v{}", names.entry(*id).or_insert(next))
                    }
                    Argument::Text(text) => format!(" {text}"),
                };
            }
            text.push(';');
        }
        text
    }

    fn part(&mut self, literal: &Literal, numbers: &mut HashMap<String, usize>) -> CanonicalLiteral {
        let (text, terms) = match literal {
            Literal::Positive(atom) => (self.name(atom.predicate, numbers), self.atom_terms(atom)),
            Literal::Guard(atom) => (
                format!("guard {}", self.name(atom.predicate, numbers)),
                self.atom_terms(atom),
            ),
            Literal::Negative(atom) => (
                format!("not {}", self.name(atom.predicate, numbers)),
                self.atom_terms(atom),
            ),
            Literal::Compare {
                op, left, right, base, ..
            } => {
                let terms = [left, right].map(|term| self.argument(*term, |value| self.constant(value, *base)));
                (format!("{op:?} {base:?}"), terms.to_vec())
            }
            Literal::Compute {
                to,
                functor,
                base,
                arguments,
                ..
            } => {
                // The base type is that of the first argument.
                let exact = |value: Value| format!("{}:{}", value.0, self.constant(value, BaseType::Symbol));
                let first = |value| match base {
                    BaseType::Symbol => self.constant(value, *base),
                    _ => exact(value),
                };
                let mut terms = vec![self.argument(*to, exact)];
                terms.extend(arguments.iter().enumerate().map(|(at, term)| match at {
                    0 => self.argument(*term, first),
                    _ => self.argument(*term, exact),
                }));
                (format!("{functor:?} {base:?}"), terms)
            }
            Literal::Aggregate { to, op, base, atom, .. } => {
                let mut terms = vec![self.argument(*to, |value| self.constant(value, *base))];
                terms.extend(self.atom_terms(atom));
                (format!("{op:?} {base:?} {}", self.name(atom.predicate, numbers)), terms)
            }
        };
        CanonicalLiteral { text, terms }
    }

    fn atom_terms(&self, atom: &Atom) -> Vec<Argument> {
        let columns = &self.side.rules.predicates[atom.predicate.index()].columns;
        let terms = atom.terms.iter().zip(columns);
        terms
            .map(|(term, column)| self.argument(*term, |value| self.constant(value, column.base)))
            .collect()
    }

    fn argument(&self, term: Term, constant: impl Fn(Value) -> String) -> Argument {
        match term {
            Term::Variable(id) => Argument::Variable(id),
            Term::Constant(value) => Argument::Text(constant(value)),
            Term::Wildcard => Argument::Text("_".to_owned()),
        }
    }

    /// Returns a constant as text. The two sides number their symbols differently.
    fn constant(&self, value: Value, base: BaseType) -> String {
        match base {
            BaseType::Record => record_text(value, &self.side.rules.symbols),
            BaseType::Symbol => format!("{:?}", self.side.rules.symbols.resolve(Symbol(value.0))),
            BaseType::Number | BaseType::Unsigned | BaseType::Float => value.0.to_string(),
        }
    }
}

/// A head or a literal.
struct CanonicalLiteral {
    /// All of it but its terms.
    text: String,
    terms: Vec<Argument>,
}

#[derive(Clone)]
enum Argument {
    Variable(VarId),
    /// A constant or `_`.
    Text(String),
}

impl CanonicalLiteral {
    /// Returns a hash that does not depend on the names of variables.
    fn hash(&self, colors: &[u64]) -> u64 {
        let mut hasher = DefaultHasher::new();
        self.text.hash(&mut hasher);
        for term in &self.terms {
            match term {
                Argument::Variable(id) => colors[id.index()].hash(&mut hasher),
                Argument::Text(text) => text.hash(&mut hasher),
            }
        }
        hasher.finish()
    }
}

/// The maximum number of rounds of [`colors`].
const ROUNDS_MAX: usize = 16;

/// Returns a hash of each variable that depends on where it occurs and not on its name: color refinement.
fn colors(head: &CanonicalLiteral, body: &[CanonicalLiteral], variables: usize) -> Vec<u64> {
    let mut colors = vec![0_u64; variables];
    for _ in 0..variables.min(ROUNDS_MAX) {
        let mut places: Vec<Vec<(u64, usize)>> = vec![Vec::new(); variables];
        for (part, is_head) in std::iter::once((head, true)).chain(body.iter().map(|part| (part, false))) {
            let hash = if is_head { 0 } else { part.hash(&colors) };
            for (position, term) in part.terms.iter().enumerate() {
                if let Argument::Variable(id) = term {
                    places[id.index()].push((hash, position));
                }
            }
        }
        for (color, places) in colors.iter_mut().zip(&mut places) {
            places.sort_unstable();
            let mut hasher = DefaultHasher::new();
            (*color, places).hash(&mut hasher);
            *color = hasher.finish();
        }
    }
    colors
}
