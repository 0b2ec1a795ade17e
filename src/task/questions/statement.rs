//! States rules as English sentences.
//!
//! Each clause becomes one sentence. It names the entities that the clause quantifies, and lists the literals of the
//! body in their order, separated by semicolons:
//!
//! ```text
//! VS1 requires Stop of X if, for some Y that X sees: X is at the edge of an intersection; Y is inside an intersection.
//! ```
//!
//! Facts of the city take the form of the question: atoms, or the phrases of the configuration. Other predicates,
//! comparisons other than equality, expressions and aggregates stay in the notation of rules. A sentence unfolds the
//! predicates that the checker generates (hidden predicates), up to [`DEPTH_MAX`] levels deep.

use crate::datalog::explain::ExplanationPrinter;
use crate::datalog::{Atom, BaseType, Clause, ClauseId, Comparison, Literal, PredicateId, Rules, Term, VarId};
use crate::diag::Sources;
use crate::predicate::Definition;
use crate::sim::World;
use crate::task::questions::Style;
use std::collections::BTreeSet;

/// The maximum number of levels of hidden predicates that a sentence unfolds.
const DEPTH_MAX: usize = 4;

/// Returns a sentence for each clause on which an action depends, and how the city chooses among the actions.
pub(super) fn statement(world: &World, sources: &Sources, style: Style) -> String {
    let writer = Writer::new(world, sources, style);
    let mut text = String::new();
    for clause in writer.used() {
        text += &format!("{}\n", writer.sentence(clause));
    }
    let actions = &world.scenario.actions;
    let order: Vec<&str> = actions.priority.iter().map(|action| action.name()).collect();
    text + &format!(
        "If rules require several actions, the first of {} counts. If no rule requires an action, the action is {}.",
        order.join(", "),
        actions.default.name()
    )
}

/// Returns the clauses that derive actions, in source order.
pub(super) fn of_actions(world: &World) -> impl Iterator<Item = ClauseId> + '_ {
    let clauses = world.clause_actions();
    clauses.filter_map(|(clause, action)| action.and(Some(clause)))
}

/// Returns the labels of clauses, in their order without repetition.
pub(super) fn labels(world: &World, sources: &Sources, clauses: impl Iterator<Item = ClauseId>) -> Vec<String> {
    let printer = printer(world.program.rules(), sources);
    let mut labels = Vec::new();
    for label in clauses.map(|clause| printer.label(clause)) {
        if !labels.contains(&label) {
            labels.push(label);
        }
    }
    labels
}

fn printer<'a>(rules: &'a Rules, sources: &'a Sources) -> ExplanationPrinter<'a> {
    ExplanationPrinter::new(rules, &rules.symbols, sources)
}

/// Writes clauses as sentences.
struct Writer<'a> {
    world: &'a World,
    rules: &'a Rules,
    printer: ExplanationPrinter<'a>,
    style: Style,
}

/// A clause whose variables have names in the sentence.
struct Scope<'c> {
    clause: &'c Clause,
    names: Vec<String>,
}

impl<'a> Writer<'a> {
    fn new(world: &'a World, sources: &'a Sources, style: Style) -> Writer<'a> {
        let rules = world.program.rules();
        Writer {
            world,
            rules,
            printer: printer(rules, sources).quoting(),
            style,
        }
    }

    /// Returns the visible clauses on which an action depends, in source order.
    fn used(&self) -> Vec<ClauseId> {
        let head = |clause: ClauseId| self.rules.clauses[clause.index()].head.predicate;
        let mut open: Vec<PredicateId> = of_actions(self.world).map(head).collect();
        let mut known: BTreeSet<PredicateId> = open.iter().copied().collect();
        while let Some(predicate) = open.pop() {
            let clauses = self
                .rules
                .clauses
                .iter()
                .filter(|clause| clause.head.predicate == predicate);
            for atom in clauses.flat_map(|clause| &clause.body).filter_map(Literal::atom) {
                if known.insert(atom.predicate) {
                    open.push(atom.predicate);
                }
            }
        }
        self.world
            .clauses()
            .filter(|&clause| known.contains(&head(clause)))
            .collect()
    }

    fn sentence(&self, id: ClauseId) -> String {
        let clause = &self.rules.clauses[id.index()];
        let scope = self.scope(clause, Vec::new(), &[]);
        let label = self.printer.label(id);
        let head = match self.action(&clause.head) {
            Some(action) => format!("{label} requires {action} of {}", self.term(&scope, &clause.head, 0)),
            None => format!("{label} makes {} true", self.atom(&scope, &clause.head)),
        };
        let StatementBody { some, conditions } = self.body(&scope, 0);
        match (some.is_empty(), conditions.is_empty()) {
            (_, true) => format!("{head} in every scene."),
            (true, false) => format!("{head} if: {}.", conditions.join("; ")),
            (false, false) => format!("{head} if, {some}: {}.", conditions.join("; ")),
        }
    }

    /// Names the variables of a clause. `bound` are the names of the variables in the head of a hidden predicate, and
    /// `taken` the names around it.
    fn scope<'c>(&self, clause: &'c Clause, bound: Vec<Option<String>>, taken: &[String]) -> Scope<'c> {
        let mut names: Vec<String> = Vec::new();
        for (index, own) in clause.variables.iter().enumerate() {
            let is_taken = |name: &String| names.contains(name) || taken.contains(name);
            let name = match bound.get(index).cloned().flatten() {
                Some(name) => name,
                None if own.starts_with(char::is_alphabetic) && !is_taken(own) => own.clone(),
                None => (1..)
                    .map(|number| format!("E{number}"))
                    .find(|name| !is_taken(name) && !clause.variables.contains(name))
                    .expect("there is a free number"),
            };
            names.push(name);
        }
        Scope { clause, names }
    }

    /// Returns the quantifiers and the conditions of a body. The variables of the head need no quantifier.
    fn body(&self, scope: &Scope<'_>, depth: usize) -> StatementBody {
        let clause = scope.clause;
        let mut known: BTreeSet<VarId> = clause.head.terms.iter().filter_map(Term::variable).collect();
        // Entities that the same guard introduces share a quantifier.
        let mut groups: Vec<(String, Vec<String>)> = Vec::new();
        let mut add = |seen: String, name: String| match groups.iter_mut().find(|(known, _)| *known == seen) {
            Some((_, names)) => names.push(name),
            None => groups.push((seen, vec![name])),
        };
        let mut conditions = Vec::new();
        let mut guards = BTreeSet::new();
        for (index, literal) in clause.body.iter().enumerate() {
            let Literal::Guard(atom) = literal else { continue };
            if let [Some(ego), Some(seen)] = atom.terms.iter().map(Term::variable).collect::<Vec<_>>()[..]
                && known.contains(&ego)
                && known.insert(seen)
            {
                guards.insert(index);
                add(
                    self.guard(atom, &scope.names[ego.index()]),
                    scope.names[seen.index()].clone(),
                );
            }
        }
        for (index, literal) in clause.body.iter().enumerate() {
            if guards.contains(&index) {
                continue;
            }
            // A negated literal and an aggregate bind no variable, except the result of the aggregate.
            let introduced: Vec<VarId> = match literal {
                Literal::Negative(_) => Vec::new(),
                Literal::Aggregate { to, .. } => to.variable().into_iter().collect(),
                _ => literal.variables().collect(),
            };
            for variable in introduced {
                if known.insert(variable) {
                    add(String::new(), scope.names[variable.index()].clone());
                }
            }
            conditions.push(self.literal(scope, literal, depth));
        }
        let some = groups
            .iter()
            .map(|(seen, names)| format!("for some {}{seen}", names.join(" and ")));
        StatementBody {
            some: some.collect::<Vec<_>>().join(" and "),
            conditions,
        }
    }

    /// Returns the relative clause of a guard: ` that X sees`.
    fn guard(&self, atom: &Atom, ego: &str) -> String {
        match self.definition(atom) {
            Some(definition) => format!(" that {ego} {}", definition.phrase().verb),
            None => format!(" with {}({ego}, _)", self.rules.predicates[atom.predicate.index()].name),
        }
    }

    fn literal(&self, scope: &Scope<'_>, literal: &Literal, depth: usize) -> String {
        match literal {
            Literal::Positive(atom) | Literal::Guard(atom) => self.fact(scope, literal, atom, false, depth),
            Literal::Negative(atom) => self.fact(scope, literal, atom, true, depth),
            Literal::Compare {
                op, left, right, base, ..
            } => {
                let [left, right] = [left, right].map(|term| self.value(scope, term, *base));
                match op {
                    Comparison::Equal => format!("{left} is the same as {right}"),
                    Comparison::NotEqual => format!("{left} is not the same as {right}"),
                    _ => self.notation(scope, literal),
                }
            }
            Literal::Compute { .. } | Literal::Aggregate { .. } => self.notation(scope, literal),
        }
    }

    fn fact(&self, scope: &Scope<'_>, literal: &Literal, atom: &Atom, negative: bool, depth: usize) -> String {
        let predicate = &self.rules.predicates[atom.predicate.index()];
        if predicate.hidden {
            return match depth < DEPTH_MAX && predicate.derived {
                true => self.hidden(scope, literal, atom, negative, depth),
                false => self.notation(scope, literal),
            };
        }
        if let Some(action) = self.action(atom) {
            let ego = self.term(scope, atom, 0);
            return match negative {
                true => format!("no rule requires {action} of {ego}"),
                false => format!("a rule requires {action} of {ego}"),
            };
        }
        match self.definition(atom) {
            Some(definition) if matches!(self.style, Style::Words | Style::Picture) => {
                self.phrase(scope, atom, definition, negative)
            }
            _ if negative => format!("not {}", self.atom(scope, atom)),
            _ => self.atom(scope, atom),
        }
    }

    /// Unfolds a hidden predicate: the alternatives of its clauses in parentheses.
    fn hidden(&self, scope: &Scope<'_>, literal: &Literal, atom: &Atom, negative: bool, depth: usize) -> String {
        let clauses = || {
            self.rules
                .clauses
                .iter()
                .filter(|clause| clause.head.predicate == atom.predicate)
        };
        let is_recursive = clauses()
            .flat_map(|clause| &clause.body)
            .any(|literal| literal.atom().is_some_and(|inner| inner.predicate == atom.predicate));
        let is_plain = |clause: &Clause| clause.head.terms.iter().all(|term| term.variable().is_some());
        if is_recursive || clauses().next().is_none() || !clauses().all(is_plain) {
            return self.notation(scope, literal);
        }
        let alternatives: Vec<String> = clauses()
            .map(|clause| {
                let mut bound = vec![None; clause.variables.len()];
                for (at, variable) in clause.head.terms.iter().filter_map(Term::variable).enumerate() {
                    bound[variable.index()] = Some(self.term(scope, atom, at));
                }
                let inner = self.scope(clause, bound, &scope.names);
                let StatementBody { some, conditions } = self.body(&inner, depth + 1);
                match some.is_empty() {
                    true => format!("({})", conditions.join(" and ")),
                    false => format!("({some}: {})", conditions.join(" and ")),
                }
            })
            .collect();
        let text = alternatives.join(" or ");
        match negative {
            true => format!("it is false that {text}"),
            false => text,
        }
    }

    /// Returns a fact in the words of the configuration.
    fn phrase(&self, scope: &Scope<'_>, atom: &Atom, definition: &Definition, negative: bool) -> String {
        let verb = definition.phrase().verb;
        // "any entity is not" would mean that none is.
        let negated = match verb.split_once(' ') {
            Some(("is", rest)) if atom.terms[0] != Term::Wildcard => Some(format!("is not {rest}")),
            Some(("has", rest)) if atom.terms[0] != Term::Wildcard => Some(format!("does not have {rest}")),
            _ => None,
        };
        let subject = match atom.terms[0] {
            Term::Wildcard => "some entity".to_owned(),
            _ => self.term(scope, atom, 0),
        };
        let object = match atom.terms.get(1) {
            None => String::new(),
            Some(Term::Wildcard) if negative && negated.is_some() => " any entity".to_owned(),
            Some(Term::Wildcard) => " some entity".to_owned(),
            Some(term) if *term == atom.terms[0] => " itself".to_owned(),
            Some(_) => format!(" {}", self.term(scope, atom, 1)),
        };
        match (negative, negated) {
            (false, _) => format!("{subject} {verb}{object}"),
            (true, Some(verb)) => format!("{subject} {verb}{object}"),
            (true, None) => format!("it is false that {subject} {verb}{object}"),
        }
    }

    /// Returns an atom as rules have it.
    fn atom(&self, scope: &Scope<'_>, atom: &Atom) -> String {
        let terms: Vec<String> = (0..atom.terms.len()).map(|at| self.term(scope, atom, at)).collect();
        let name = &self.rules.predicates[atom.predicate.index()].name;
        format!("{name}({})", terms.join(", "))
    }

    fn term(&self, scope: &Scope<'_>, atom: &Atom, at: usize) -> String {
        let base = self.rules.predicates[atom.predicate.index()].columns[at].base;
        self.value(scope, &atom.terms[at], base)
    }

    fn value(&self, scope: &Scope<'_>, term: &Term, base: BaseType) -> String {
        match term {
            Term::Variable(variable) => scope.names[variable.index()].clone(),
            Term::Constant(value) => self.printer.value(*value, base),
            Term::Wildcard => "_".to_owned(),
        }
    }

    /// Returns a literal in the notation of rules, with the names of the sentence.
    fn notation(&self, scope: &Scope<'_>, literal: &Literal) -> String {
        let named = Clause {
            variables: scope.names.clone(),
            ..scope.clause.clone()
        };
        let open = vec![None; named.variables.len()];
        self.printer.literal(&named, literal, &open)
    }

    /// Returns the action that an atom requires.
    fn action(&self, atom: &Atom) -> Option<&'static str> {
        let action = self.world.vocabulary.action_of(atom.predicate)?;
        Some(action.name())
    }

    /// Returns the definition of a base predicate.
    fn definition(&self, atom: &Atom) -> Option<&'a Definition> {
        let predicates = &self.world.vocabulary.predicates;
        let found = predicates
            .iter()
            .find(|predicate| predicate.id == Some(atom.predicate))?;
        Some(&found.definition)
    }
}

/// The parts of a sentence after the head.
struct StatementBody {
    /// The quantified entities: `for some Y that X sees`; empty if there are none.
    some: String,
    /// The literals.
    conditions: Vec<String>,
}
