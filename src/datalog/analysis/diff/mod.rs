//! Equivalence of two rule sets.
//!
//! [`diff`] searches for a minimal scene (entities first, then facts) in which only one side derives some output. For
//! scenes of a fixed size this is a question of propositional logic: `ground` translates both programs into one circuit
//! over the possible base facts, and `sat` searches it exhaustively. `bound` computes how large a scene a difference
//! may need. If there is no difference up to that size, this *proves* the two rule sets equivalent. Before `diff`
//! reports a scene, [`crate::naive`] evaluates it on both sides, and `naming` gives its entities names of entities.
//!
//! Rules with expressions, aggregates, floats or unsigned numbers have no such circuit. For them `canonical` compares
//! the clauses. Unless these are the same on both sides, `trial` evaluates one scene after another within a bound, first
//! those that a circuit of the other clauses suggests. It finds differences but proves nothing.
//!
//! The search first assumes every *scope* (a guard predicate, see `.scope`) to be complete: every entity sees every
//! other. Only if that shows no difference may the rows of scopes vary like those of any predicate. Each of the two
//! searches gets half of the budget.
// Decision: docs/decisions/analysis.md#d054

mod bound;
mod canonical;
mod confusion;
mod ground;
mod naming;
mod pair;
mod sat;
pub mod shortcuts;
mod trial;
mod unsat_core;
mod values;

use crate::check::subsumption::within_theory;
use crate::check::{Literal, PredicateId, Rules, Term};
use crate::codes;
use crate::diag::Diagnostic;
use crate::naive;
use crate::symbol::{Symbol, Symbols, WordSize};
use crate::syntax::ast::BaseType;
use crate::value::{Value, record_text};
use ground::{BaseFact, Circuit, TooLarge};
use pair::{Functions, Individual, Output, Pair, ScopeRows, Side};
use sat::{Lit, Outcome, Solver};
use std::collections::{BTreeSet, HashMap, HashSet};

pub use unsat_core::unsat_core;

/// The predicates to compare, and the limits of the search.
#[derive(Clone, Debug)]
pub struct Options {
    /// The predicates to compare; all outputs if empty.
    pub predicates: Vec<String>,
    /// The maximum number of entities in a scene.
    pub entities_max: usize,
    /// The maximum number of conflicts in the SAT search, which bounds the time without a clock.
    pub conflicts_max: u64,
    /// The maximum number of literals instantiated for scenes of all sizes together, which bounds time and memory.
    pub literals_max: usize,
    /// Whether every entity of a scene sees itself in every scope.
    pub self_sight: bool,
    /// Whether to reduce the scene of a difference to the fewest facts.
    pub minimize: bool,
}

impl Default for Options {
    fn default() -> Self {
        Options {
            predicates: Vec::new(),
            entities_max: 12,
            conflicts_max: 500_000,
            literals_max: 12_000_000,
            self_sight: false,
            minimize: true,
        }
    }
}

/// The result of a comparison.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Equivalence {
    /// Both sides derive the same rows in every scene of any size.
    Equivalent {
        /// The size that the search had to cover: a difference would show with at most as many entities. `None` if both
        /// sides have the same clauses.
        entities: Option<usize>,
    },
    /// The search found no difference in scenes of at most `entities` entities; larger scenes may show one.
    NoneFound {
        /// The size up to which the search was exhaustive; `None` if not even for the smallest.
        entities: Option<usize>,
        /// The size up to which an exhaustive search would be a proof, if known.
        proof: Option<usize>,
        /// The limits that ended the search; empty if only [`Options::entities_max`] did.
        cut: Vec<Cut>,
    },
    /// Trying scenes one by one found no difference; other scenes may show one. The values were those that the rules
    /// name, their neighbors, and a few small ones.
    NoneTried {
        /// The number of facts up to which the search tried every scene; `None` if for no number.
        facts: Option<usize>,
        /// The number of entities in these scenes.
        entities: usize,
        /// The number of scenes tried, including larger random ones.
        scenes: u64,
    },
    /// The two sides differ in this scene.
    Different(Difference),
}

/// The reason why a search ended early.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Cut {
    /// The search reached [`Options::conflicts_max`].
    Conflicts,
    /// The next larger scenes have too many possible facts or derivations.
    Size,
    /// The computation of the size for a proof exceeded its limit.
    Proof,
}

/// A scene with the rows that each side derives in it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Difference {
    /// The names of the entities and constants that occur; those of the differing row come first.
    pub entities: Vec<String>,
    /// The facts of the scene, by predicate, without the rows of complete scopes.
    pub facts: Vec<(String, Vec<Vec<String>>)>,
    /// The scopes in which every entity sees every other and itself.
    pub everybody_sees: Vec<String>,
    /// The output rows derived on each side.
    pub derived: [Vec<(String, Vec<String>)>; 2],
    /// Whether the search proved that no scene with as many entities and fewer facts shows a difference.
    pub smallest: bool,
}

/// Maximum number of literals instantiated for scenes of one size.
const LITERALS_MAX: usize = 3_000_000;

/// Maximum number of scenes taken from the circuit of rules with clauses that have none.
const MODELS_MAX: usize = 4;

/// Compares two rule sets.
///
/// # Errors
/// If a rule set exceeds the limits of planning, or has temporal operators. If a base predicate has different columns
/// on the two sides, or is input on one side and derived on the other. If a predicate to compare is not declared on
/// both sides.
pub fn diff(left: &Rules, right: &Rules, options: &Options) -> Result<Equivalence, Vec<Diagnostic>> {
    if [left, right]
        .iter()
        .any(|rules| rules.symbols.word_size() == WordSize::Bits64)
    {
        let message = "programs with numbers of 64 bits cannot be compared";
        return Err(vec![Diagnostic::new(codes::UNSUPPORTED, message)]);
    }
    let looks_back = |rules: &Rules| {
        let past = rules.pasts.first()?;
        let fault = Diagnostic::new(codes::UNSUPPORTED, "rules with temporal operators cannot be compared");
        let fault = fault.at(
            rules.predicates[past.predicate.index()].span,
            "this reads earlier ticks",
        );
        Some(fault.help("a comparison concerns single scenes; remove the clauses that look back from both sides"))
    };
    let faults: Vec<Diagnostic> = [left, right].into_iter().filter_map(looks_back).collect();
    if !faults.is_empty() {
        return Err(faults);
    }
    let calls = |rules: &Rules| {
        let functor = rules.functors.first()?;
        let fault = Diagnostic::new(
            codes::UNSUPPORTED,
            "rules with user-defined functors cannot be compared",
        );
        let fault = fault.at(functor.span, "only the caller knows its values");
        Some(fault.help("replace it by a predicate of input rows on both sides"))
    };
    let faults: Vec<Diagnostic> = [left, right].into_iter().filter_map(calls).collect();
    if !faults.is_empty() {
        return Err(faults);
    }
    let chooses = |rules: &Rules| {
        let predicate = rules
            .predicates
            .iter()
            .find(|predicate| predicate.depends_on_rounds())?;
        let message = "rules whose rows depend on rounds cannot be compared";
        let fault = Diagnostic::new(codes::UNSUPPORTED, message)
            .at(predicate.span, "the rounds of its evaluation decide which rows it has");
        Some(fault.help("remove its keys, limit, subsumption or `autoinc()` on both sides"))
    };
    let faults: Vec<Diagnostic> = [left, right].into_iter().filter_map(chooses).collect();
    if !faults.is_empty() {
        return Err(faults);
    }
    if left.chance.is_some() || right.chance.is_some() {
        return diff(&left.with_draws_as_facts(), &right.with_draws_as_facts(), options);
    }
    let pair = Pair::new(left, right, options)?;
    let mut budget = Remaining::new(options);
    let same = Equivalence::Equivalent { entities: None };
    if ![left, right].into_iter().all(has_circuit) {
        if canonical::same_clauses(&pair) {
            return Ok(same);
        }
        let models = models(&pair, options.entities_max, &mut budget);
        return trial::search(&pair, [left, right], options, &models);
    }
    let (proof, mut cut) = bound::proof(&pair);
    if proof.is_none_or(|proof| proof > options.entities_max) && canonical::same_clauses(&pair) {
        return Ok(same);
    }
    let last = last_size(proof, options);
    let mut seen_all = Some(last);
    for (&view, views) in pair.views.iter().zip((1..=pair.views.len()).rev()) {
        let mut share = budget.take(views);
        for entities in 0..=last {
            match search(&pair, entities, view, options.minimize, &mut share) {
                Ok(Some(model)) => {
                    let scene = describe(&pair, view, &model);
                    let scene = naming::settle(scene, [left, right], &pair.outputs);
                    return Ok(Equivalence::Different(scene));
                }
                Ok(None) => {}
                Err(why) => {
                    cut.insert(why);
                    seen_all = seen_all.min(entities.checked_sub(1));
                    break;
                }
            }
        }
        budget.give_back(&share);
    }
    Ok(match (proof, seen_all) {
        (Some(entities), Some(seen_all)) if entities <= seen_all => Equivalence::Equivalent {
            entities: Some(entities),
        },
        _ if canonical::same_clauses(&pair) => same,
        _ => Equivalence::NoneFound {
            entities: seen_all,
            proof,
            cut: cut.into_iter().collect(),
        },
    })
}

/// Returns the size of the largest scenes to search, given the size for a proof.
fn last_size(proof: Option<usize>, options: &Options) -> usize {
    proof.map_or(options.entities_max, |proof| proof.min(options.entities_max))
}

/// Returns scenes of various sizes that would show a difference if no clause outside the circuit ever fired: one with
/// an expression, an aggregate or a string test. They are starting points for `trial`.
fn models(pair: &Pair<'_>, entities_max: usize, budget: &mut Remaining) -> Vec<Model> {
    let found = (0..=entities_max).map(|entities| search(pair, entities, pair.views[0], true, budget));
    let found = found.map_while(Result::ok).flatten();
    found.take(MODELS_MAX).collect()
}

/// Returns whether a circuit can represent the rules: without expressions, aggregates, and columns of floats, unsigned
/// numbers or records.
fn has_circuit(rules: &Rules) -> bool {
    let mut columns = rules.predicates.iter().flat_map(|predicate| &predicate.columns);
    let wide = |base: BaseType| matches!(base, BaseType::Float | BaseType::Unsigned | BaseType::Record);
    rules.clauses.iter().all(within_theory) && !columns.any(|column| wide(column.base))
}

/// The remaining budget of the search. It counts work instead of time.
struct Remaining {
    /// Conflicts in the SAT search.
    conflicts: u64,
    /// Literals to instantiate.
    literals_left: usize,
}

impl Remaining {
    fn new(options: &Options) -> Remaining {
        Remaining {
            conflicts: options.conflicts_max,
            literals_left: options.literals_max,
        }
    }

    /// Takes one of `parts` equal parts, so that an expensive view leaves enough for the others.
    fn take(&mut self, parts: usize) -> Remaining {
        let part = Remaining {
            conflicts: self.conflicts / parts as u64,
            literals_left: self.literals_left / parts,
        };
        self.conflicts -= part.conflicts;
        self.literals_left -= part.literals_left;
        part
    }

    fn give_back(&mut self, rest: &Remaining) {
        self.conflicts += rest.conflicts;
        self.literals_left += rest.literals_left;
    }
}

/// A scene, as indexes.
struct Model {
    individuals: Vec<Individual>,
    /// The number of individuals that are entities.
    entities: usize,
    /// The output row that differs.
    row: Vec<usize>,
    facts: Vec<BaseFact>,
    /// See [`Difference::smallest`].
    smallest: bool,
}

/// Two rule sets over the individuals of scenes of one size.
struct Scenes<'a> {
    entities: usize,
    individuals: Vec<Individual>,
    sides: [Side<'a>; 2],
    functions: &'a Functions,
}

impl<'a> Scenes<'a> {
    fn new(pair: &'a Pair<'_>, entities: usize) -> Scenes<'a> {
        let individuals = individuals([&pair.sides[0], &pair.sides[1]], entities, &pair.functions);
        let [left, right] = &pair.sides;
        let sides = [left, right].map(|side| Side {
            facts: source_facts(side, &individuals),
            ..side.clone()
        });
        Scenes {
            entities,
            individuals,
            sides,
            functions: &pair.functions,
        }
    }

    /// Returns an empty circuit for these scenes that adds to the formula of a solver.
    fn over(&self, solver: Solver, view: ScopeRows, literals_left: usize) -> Circuit<'_> {
        let sides = [&self.sides[0], &self.sides[1]];
        Circuit::over(solver, sides, (&self.individuals, self.functions), view, literals_left)
    }

    /// Returns a circuit for these scenes with one condition for each output row that may differ.
    ///
    /// With `switches`, a literal switches each constraint on: by side and position of the constraint, its number.
    /// Constraints with the same number share one.
    ///
    /// # Errors
    /// If the circuit would exceed the limits.
    fn circuit(
        &self,
        outputs: &[Output],
        view: ScopeRows,
        switches: Option<&[Vec<usize>; 2]>,
        budget: &mut Remaining,
    ) -> Result<(Circuit<'_>, Vec<Question>), Cut> {
        let most = LITERALS_MAX.min(budget.literals_left);
        let mut circuit = self.over(Solver::new(), view, most);
        if let Some(switches) = switches {
            circuit.add_switches(switches);
        }
        let before = circuit.literals_left;
        let asked = questions(&mut circuit, outputs, self.entities, &self.individuals);
        let kept = circuit.constraints();
        budget.literals_left -= before - circuit.literals_left;
        match (asked, kept) {
            (Ok(questions), Ok(())) => Ok((circuit, questions)),
            _ => Err(Cut::Size),
        }
    }
}

/// Searches for a scene of that size that shows a difference.
///
/// # Errors
/// The limit that the search reached.
fn search(
    pair: &Pair<'_>,
    entities: usize,
    view: ScopeRows,
    minimize: bool,
    budget: &mut Remaining,
) -> Result<Option<Model>, Cut> {
    let scenes = Scenes::new(pair, entities);
    let (mut circuit, questions) = scenes.circuit(&pair.outputs, view, None, budget)?;
    let any = circuit.any(questions.iter().map(|question| question.differs).collect());
    if circuit.is_no(any) {
        return Ok(None);
    }
    circuit.solver.add(&[any]);
    match circuit.solver.solve(&[], &mut budget.conflicts) {
        Outcome::Unsatisfiable => return Ok(None),
        Outcome::Unknown => return Err(Cut::Conflicts),
        Outcome::Satisfiable => {}
    }
    let smallest = minimize && shrink(&mut circuit, &mut budget.conflicts);
    let asked = (questions.into_iter())
        .find(|question| circuit.solver.is_true(question.differs))
        .ok_or(Cut::Conflicts)?;
    let facts: Vec<BaseFact> = (circuit.atoms.iter())
        .filter(|(_, lit)| circuit.solver.is_true(**lit))
        .map(|(fact, _)| fact.clone())
        .collect();
    drop(circuit);
    Ok(Some(Model {
        row: asked.row,
        facts,
        smallest,
        entities,
        individuals: scenes.individuals,
    }))
}

/// Returns the interchangeable entities, then the constants of both sides and the symbols that functions yield. Numbers
/// are included only if a column has them.
fn individuals(sides: [&Side<'_>; 2], entities: usize, functions: &Functions) -> Vec<Individual> {
    let mut constants: BTreeSet<Individual> = functions.symbols().cloned().map(Individual::Symbol).collect();
    let mut numbers = false;
    for side in sides {
        for predicate in &side.rules.predicates {
            numbers |= predicate.columns.iter().any(|column| column.base == BaseType::Number);
        }
        for clause in &side.rules.clauses {
            let mut add = |term: &Term, base| {
                if let Term::Constant(value) = term {
                    constants.insert(side.individual(*value, base));
                }
            };
            let mut atom = |atom: &crate::check::Atom| {
                let columns = &side.rules.predicates[atom.predicate.index()].columns;
                atom.terms
                    .iter()
                    .zip(columns)
                    .for_each(|(term, column)| add(term, column.base));
            };
            atom(&clause.head);
            for literal in &clause.body {
                match literal {
                    Literal::Positive(one) | Literal::Negative(one) | Literal::Guard(one) => atom(one),
                    Literal::Compare { .. } | Literal::Compute { .. } | Literal::Aggregate { .. } => {}
                }
            }
            for literal in &clause.body {
                if let Literal::Compare { left, right, base, .. } = literal {
                    add(left, *base);
                    add(right, *base);
                }
            }
        }
    }
    if numbers {
        let near: Vec<i32> = (constants.iter())
            .filter_map(|constant| match constant {
                Individual::Number(number) => Some([number.saturating_sub(1), number.saturating_add(1)]),
                Individual::Symbol(_) => None,
            })
            .flatten()
            .collect();
        constants.extend(near.into_iter().map(Individual::Number));
        constants.extend((0..entities as i32).map(Individual::Number));
    }
    let prefix = naming::prefix(constants.iter().filter_map(|constant| match constant {
        Individual::Symbol(text) => Some(text.as_str()),
        Individual::Number(_) => None,
    }));
    let entities = (0..entities).map(|number| Individual::Symbol(format!("{prefix}{number}")));
    entities.chain(constants).collect()
}

fn source_facts(side: &Side<'_>, individuals: &[Individual]) -> HashSet<(PredicateId, Vec<usize>)> {
    let mut facts = HashSet::new();
    let positions: HashMap<&Individual, usize> = individuals.iter().zip(0..).collect();
    for clause in side.rules.clauses.iter().filter(|clause| clause.body.is_empty()) {
        let predicate = clause.head.predicate;
        let columns = &side.rules.predicates[predicate.index()].columns;
        let row: Option<Vec<usize>> = (clause.head.terms.iter().zip(columns))
            .map(|(term, column)| match term {
                Term::Constant(value) => positions.get(&side.individual(*value, column.base)).copied(),
                _ => None,
            })
            .collect();
        if let (false, Some(row)) = (side.rules.predicates[predicate.index()].derived, row) {
            facts.insert((predicate, row));
        }
    }
    facts
}

/// A condition under which an output row differs.
struct Question {
    row: Vec<usize>,
    differs: Lit,
}

/// Returns one condition for each output row, up to the renaming of entities.
fn questions(
    circuit: &mut Circuit<'_>,
    outputs: &[Output],
    entities: usize,
    individuals: &[Individual],
) -> Result<Vec<Question>, TooLarge> {
    let mut questions = Vec::new();
    for output in outputs {
        let mut rows: Vec<Vec<usize>> = vec![Vec::new()];
        for &base in &output.columns {
            let mut longer = Vec::new();
            for row in &rows {
                let named = row
                    .iter()
                    .filter(|&&value| value < entities)
                    .max()
                    .map_or(0, |&last| last + 1);
                let first = (0..entities.min(named + 1)).chain(entities..individuals.len());
                for value in first.filter(|&value| individuals[value].base() == base) {
                    let mut row = row.clone();
                    row.push(value);
                    longer.push(row);
                }
            }
            if longer.len() > 100_000 {
                return Err(TooLarge);
            }
            rows = longer;
        }
        for row in rows {
            let left = circuit.fact(0, output.ids[0], &row)?;
            let right = circuit.fact(1, output.ids[1], &row)?;
            let differs = circuit.differ(left, right);
            questions.push(Question { row, differs });
        }
    }
    Ok(questions)
}

/// Minimizes the number of facts of the model. Returns whether the last model is proved minimal.
fn shrink(circuit: &mut Circuit<'_>, conflicts: &mut u64) -> bool {
    let atoms: Vec<Lit> = circuit.atoms.values().copied().collect();
    let count = |circuit: &Circuit<'_>| atoms.iter().filter(|&&lit| circuit.solver.is_true(lit)).count();
    let most = count(circuit);
    if most == 0 {
        return true;
    }
    if atoms.len().saturating_mul(most) > 200_000 {
        return false;
    }
    // `least[k]`: more than k of the atoms so far hold.
    let mut least: Vec<Lit> = Vec::new();
    for &atom in &atoms {
        let mut next = Vec::with_capacity(most);
        for k in 0..most.min(least.len() + 1) {
            let more = circuit.solver.fresh();
            if let Some(&before) = least.get(k) {
                circuit.solver.add(&[!before, more]);
            }
            match k.checked_sub(1) {
                None => circuit.solver.add(&[!atom, more]),
                Some(fewer) => circuit.solver.add(&[!atom, !least[fewer], more]),
            }
            next.push(more);
        }
        least = next;
    }
    let mut held = most;
    loop {
        match circuit.solver.solve(&[!least[held - 1]], conflicts) {
            Outcome::Satisfiable => held = count(circuit),
            Outcome::Unsatisfiable => return true,
            Outcome::Unknown => return false,
        }
        if held == 0 {
            return true;
        }
    }
}

/// Describes the scene, with the rows that naive evaluation derives on each side.
fn describe(pair: &Pair<'_>, view: ScopeRows, model: &Model) -> Difference {
    let base = &pair.base;
    let sides = [&pair.sides[0], &pair.sides[1]];
    let individuals = &model.individuals;
    let mut facts = model.facts.clone();
    // An incomplete scope has exactly the rows of the scene, even if there are none.
    let scopes = sides
        .iter()
        .flat_map(|side| side.scopes.iter().filter_map(|scope| side.base[scope.index()]));
    let open: BTreeSet<usize> = scopes.filter(|_| view != ScopeRows::Full).collect();
    if view == ScopeRows::Selves {
        let symbols = |&index: &usize| individuals[index].base() == BaseType::Symbol;
        for &scope in &open {
            facts.extend(
                (0..individuals.len())
                    .filter(symbols)
                    .map(|index| (scope, vec![index, index])),
            );
        }
        facts.sort();
    }
    let mut everybody_sees: Vec<String> = Vec::new();
    if view == ScopeRows::Full {
        for side in sides {
            for scope in &side.scopes {
                let name = &side.rules.predicates[scope.index()].name;
                if !everybody_sees.contains(name) {
                    everybody_sees.push(name.clone());
                }
            }
        }
    }
    // All entities get names, since the view may range over them; constants only where they occur.
    let mut order: Vec<usize> = model.row.clone();
    order.extend((0..individuals.len()).filter(|&index| {
        let occurs = facts.iter().any(|(_, row)| row.contains(&index));
        occurs || !everybody_sees.is_empty()
    }));
    let mut shown: Vec<usize> = Vec::new();
    for index in order {
        if !shown.contains(&index)
            && individuals[index].base() == BaseType::Symbol
            && !pair.functions.have_value(&individuals[index])
        {
            shown.push(index);
        }
    }
    let mut by_predicate: Vec<(String, Vec<Vec<String>>)> = Vec::new();
    for (predicate, row) in &facts {
        let name = &base[*predicate].name;
        let row = row.iter().map(|&index| individuals[index].shown()).collect();
        match by_predicate.last_mut() {
            Some((last, rows)) if last == name => rows.push(row),
            _ => by_predicate.push((name.clone(), vec![row])),
        }
    }
    let empty = open
        .iter()
        .filter(|scope| !facts.iter().any(|(predicate, _)| predicate == *scope));
    by_predicate.extend(empty.map(|&scope| (base[scope].name.clone(), Vec::new())));
    let derived = [0, 1].map(|number| derived_rows(pair, number, individuals, &facts, (&everybody_sees, &shown)));
    Difference {
        entities: shown.iter().map(|&index| individuals[index].shown()).collect(),
        facts: by_predicate,
        everybody_sees,
        derived,
        smallest: model.smallest,
    }
}

/// Returns the output rows that naive evaluation derives on one side from these facts. In the scopes `everybody_sees`,
/// each of the individuals `shown` sees all of them.
fn derived_rows(
    pair: &Pair<'_>,
    number: usize,
    individuals: &[Individual],
    facts: &[BaseFact],
    (everybody_sees, shown): (&[String], &[usize]),
) -> Vec<(String, Vec<String>)> {
    let side = &pair.sides[number];
    let symbols: Symbols = side.rules.symbols.clone();
    let word = |index: usize| match &individuals[index] {
        Individual::Symbol(text) => Value(symbols.intern(text).0),
        Individual::Number(number) => Value::number(*number),
    };
    let mut rows: Vec<(PredicateId, Vec<Value>)> = Vec::new();
    for (predicate, row) in facts {
        if let Some(declared) = side.rules.predicate(&pair.base[*predicate].name) {
            let declared = side.rules.predicates[declared.index()].edb.unwrap_or(declared);
            rows.push((declared, row.iter().map(|&index| word(index)).collect()));
        }
    }
    for name in everybody_sees {
        if let Some(declared) = side.rules.predicate(name) {
            for &x in shown {
                for &y in shown {
                    rows.push((declared, vec![word(x), word(y)]));
                }
            }
        }
    }
    let database = naive::evaluate(side.rules, &symbols, rows);
    let mut derived = Vec::new();
    for output in &pair.outputs {
        for row in &database[output.ids[number].index()] {
            let shown = (output.columns.iter().zip(row)).map(|(base, value)| match base {
                BaseType::Number | BaseType::Unsigned | BaseType::Float => value.as_number().to_string(),
                BaseType::Record => record_text(*value, &symbols),
                BaseType::Symbol => symbols.resolve(Symbol(value.0)).unwrap_or_default().to_owned(),
            });
            derived.push((output.name.clone(), shown.collect()));
        }
    }
    derived.sort();
    derived
}
