//! A bounded search for a difference that evaluates both programs on one scene after another.
//!
//! The search serves rules that `ground` cannot translate: with expressions, aggregates, floats or unsigned numbers.
//! Finitely many values prove nothing about these. So the search uses the values that the rules name, their neighbors,
//! and a few small ones. It first tries every scene with no fact, one fact, two facts and so on. Then it draws larger
//! scenes at random and shrinks one that shows a difference. All limits are counts, so the result is reproducible.

use crate::analysis::constraints;
use crate::analysis::diff::naming;
use crate::analysis::diff::pair::{Base, Functions, Output, Pair, relevant};
use crate::analysis::diff::values::{self, LIMITS, named, words};
use crate::analysis::diff::{Difference, Equivalence, Model, Options};
use crate::check::{Constraint, DeclaredConstraint, Literal, PredicateId, Rules};
use crate::diag::Diagnostic;
use crate::facts;
use crate::program::Program;
use crate::session::Session;
use crate::syntax::ast::{BaseType, Comparison};
use crate::value::print_float;
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeSet;

/// The cost of one scene, in conflicts of the SAT search.
const SCENE_COST: u64 = 10;

/// The number of scenes for which one counts that exceeds [`LIMITS`], which takes far longer.
const EXCEEDED_COST: u64 = 1000;

/// The share of random scenes: one in this many.
const RANDOM_SHARE: u64 = 5;

/// Maximum number of steps to choose facts, per permitted scene.
const STEPS: u64 = 20;

/// Maximum number of possible facts for an exhaustive search.
const FACTS_MAX: usize = 20_000;

/// Maximum numbers of entities and facts in a random scene.
const RANDOM_MAX: (usize, usize) = (4, 12);

/// A base fact: the position of its predicate, and its values as text.
type Fact = (usize, Vec<String>);

/// A fact that a constraint requires together with another one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Requirement {
    /// The same row of this predicate.
    Same(usize),
    /// The reversed row.
    Reversed,
    /// The value of this column related to itself by this predicate.
    Loop { column: usize, of: usize },
}

/// A covering constraint.
struct Cover {
    /// The predicates and columns whose values are the domain.
    domain: Vec<(usize, usize)>,
    /// The predicates that cover it.
    by: Vec<usize>,
}

/// Both programs with the building blocks of scenes.
struct Trial<'a> {
    sessions: [Session; 2],
    base: &'a [Base],
    outputs: &'a [Output],
    functions: &'a Functions,
    /// The columns of each base predicate.
    columns: Vec<Vec<BaseType>>,
    /// The base predicates whose facts vary between scenes.
    relevant: BTreeSet<usize>,
    /// The base predicates that relate every entity to every other.
    scopes: Vec<usize>,
    constants: BTreeSet<(BaseType, String)>,
    /// By base predicate: the facts that the constraints require with each of its facts.
    required: Vec<Vec<Requirement>>,
    covers: Vec<Cover>,
    /// Whether entities are interchangeable, because no rule inspects the characters or the order of strings.
    nameless: bool,
    held: BTreeSet<Fact>,
    tried: u64,
    /// The scenes tried, with [`EXCEEDED_COST`].
    spent: u64,
    steps: u64,
}

/// The result of trying the scenes of one size.
enum Level {
    Found(Vec<Fact>),
    Nothing,
    TooMany,
}

/// Searches for a difference within the limits of the options, first in the scenes of the models.
pub(super) fn search(
    pair: &Pair<'_>,
    rules: [&Rules; 2],
    options: &Options,
    models: &[Model],
) -> Result<Equivalence, Vec<Diagnostic>> {
    let mut trial = Trial::new(rules, pair)?;
    for model in models {
        let names = trial.names(model.entities);
        let text = |&index: &usize| {
            names
                .get(index)
                .cloned()
                .unwrap_or_else(|| model.individuals[index].shown())
        };
        let facts = model
            .facts
            .iter()
            .map(|(predicate, row)| (*predicate, row.iter().map(text).collect()));
        let facts: Vec<Fact> = facts.collect();
        if trial.differs(&facts, model.entities) {
            let facts = trial.shrink(facts, model.entities);
            return Ok(trial.found(rules, model.entities, &facts));
        }
    }
    let scenes = options.conflicts_max / SCENE_COST;
    let every = scenes - scenes / RANDOM_SHARE;
    // The search has tried all scenes with fewer facts than this.
    let (mut size, mut seen_entities) = (0, 0);
    'sizes: loop {
        let entities_max = options.entities_max.min(trial.entities(size));
        for entities in 0..=entities_max {
            match trial.level(size, entities, every) {
                Level::Found(facts) => return Ok(trial.found(rules, entities, &facts)),
                Level::Nothing => {}
                Level::TooMany => break 'sizes,
            }
        }
        seen_entities = entities_max;
        size += 1;
        // Without facts that vary, there is no other scene.
        if trial.open().next().is_none() {
            break;
        }
        let entities = trial.entities(size);
        // More facts would have more entities.
        if entities < options.entities_max && entities < trial.entities(size + 1) {
            continue;
        }
        let possible = trial.possible(&trial.names(entities.min(options.entities_max)));
        if possible.is_some_and(|facts| facts.len() < size) {
            break;
        }
    }
    let mut number = 0;
    while trial.spent < scenes && trial.open().next().is_some() {
        let mut random = random_scene(number);
        let entities = random.random_range(0..=RANDOM_MAX.0.min(options.entities_max));
        let facts = trial.draw(entities, &mut random);
        number += 1;
        if trial.differs(&facts, entities) {
            let facts = trial.shrink(facts, entities);
            return Ok(trial.found(rules, entities, &facts));
        }
    }
    Ok(Equivalence::NoneTried {
        facts: size.checked_sub(1),
        entities: seen_entities,
        scenes: trial.tried,
    })
}

impl<'a> Trial<'a> {
    fn new(rules: [&Rules; 2], pair: &'a Pair<'_>) -> Result<Self, Vec<Diagnostic>> {
        let (base, outputs) = (&pair.base[..], &pair.outputs[..]);
        let session = |rules: &Rules| -> Result<Session, Vec<Diagnostic>> {
            let program = Program::new(rules.clone()).map_err(|fault| vec![fault])?;
            let mut session = program.session();
            session.set_limits(LIMITS);
            Ok(session)
        };
        let sessions = [session(rules[0])?, session(rules[1])?];
        let declared = |name: &str| {
            let sides = rules.iter();
            sides
                .filter_map(|rules| rules.predicate(name).map(|id| &rules.predicates[id.index()]))
                .next()
        };
        let columns = base.iter().map(|base| match declared(&base.name) {
            Some(predicate) => predicate.columns.iter().map(|column| column.base).collect(),
            None => Vec::new(),
        });
        let guards = |base: &Base| {
            rules.iter().any(|rules| {
                let mut literals = rules.clauses.iter().flat_map(|clause| &clause.body);
                let scope = rules.predicate(&base.name);
                literals.any(|literal| matches!(literal, Literal::Guard(atom) if Some(atom.predicate) == scope))
            })
        };
        let mut constants = BTreeSet::new();
        rules.iter().for_each(|rules| named(rules, &mut constants));
        let (mut required, mut covers) = (vec![Vec::new(); base.len()], Vec::new());
        rules
            .iter()
            .for_each(|rules| requirements(rules, base, &mut required, &mut covers));
        Ok(Trial {
            sessions,
            base,
            outputs,
            functions: &pair.functions,
            columns: columns.collect(),
            relevant: relevant(rules, base, outputs),
            scopes: (0..base.len()).filter(|&one| guards(&base[one])).collect(),
            constants,
            required,
            covers,
            nameless: rules.iter().all(|rules| is_nameless(rules)),
            held: BTreeSet::new(),
            tried: 0,
            spent: 0,
            steps: 0,
        })
    }

    /// Returns the maximum number of entities that this many facts contain. With a scope, one more entity without facts
    /// may matter.
    fn entities(&self, facts: usize) -> usize {
        let symbols = |columns: &Vec<BaseType>| columns.iter().filter(|&&base| base == BaseType::Symbol).count();
        let most = self
            .relevant
            .iter()
            .map(|&one| symbols(&self.columns[one]))
            .max()
            .unwrap_or(0);
        facts * most + usize::from(!self.scopes.is_empty())
    }

    /// Returns the names of the entities, which no constant has.
    fn names(&self, entities: usize) -> Vec<String> {
        let prefix = naming::prefix(self.constants.iter().map(|(_, text)| text.as_str()));
        (0..entities).map(|number| format!("{prefix}{number}")).collect()
    }

    /// Returns the values of a column of a base predicate.
    fn values(&self, (predicate, column): (usize, usize), names: &[String]) -> Vec<String> {
        let columns = &self.columns[predicate];
        let constants = self.constants.iter().filter(|(of, _)| *of == columns[column]);
        let constants = constants.map(|(_, text)| text.clone());
        match columns[column] {
            BaseType::Symbol => {
                let symbols = names.iter().chain(self.functions.symbols()).cloned().chain(constants);
                let allowed = |text: &String| self.functions.allow(predicate, column, columns.len(), text);
                let mut known = BTreeSet::new();
                symbols
                    .filter(allowed)
                    .filter(|text| known.insert(text.clone()))
                    .collect()
            }
            _ => constants.collect(),
        }
    }

    /// Returns whether no two rows of a function differ in the last column only.
    fn are_functions(&self, facts: &[Fact]) -> bool {
        let mut keys = BTreeSet::new();
        facts.iter().all(|(predicate, row)| {
            !self.functions.include(*predicate) || keys.insert((predicate, &row[..row.len().saturating_sub(1)]))
        })
    }

    /// Returns the predicates whose facts vary.
    fn open(&self) -> impl Iterator<Item = usize> {
        (self.relevant.iter().copied()).filter(|predicate| !self.scopes.contains(predicate))
    }

    /// Returns all possible facts about these entities; `None` if there are too many.
    fn possible(&self, names: &[String]) -> Option<Vec<Fact>> {
        let mut possible = Vec::new();
        for predicate in self.open() {
            let mut rows: Vec<Vec<String>> = vec![Vec::new()];
            for column in 0..self.columns[predicate].len() {
                let values = self.values((predicate, column), names);
                if rows.len().saturating_mul(values.len()) > FACTS_MAX {
                    return None;
                }
                let longer = |row: &Vec<String>| {
                    let row = row.clone();
                    values
                        .iter()
                        .map(move |value| [&row[..], std::slice::from_ref(value)].concat())
                        .collect()
                };
                rows = rows
                    .iter()
                    .flat_map(|row| -> Vec<Vec<String>> { longer(row) })
                    .collect();
            }
            possible.extend(rows.into_iter().map(|row| (predicate, row)));
        }
        (possible.len() <= FACTS_MAX).then_some(possible)
    }

    /// Tries all scenes with this many facts and entities, unless the number of scenes tried would exceed `most`.
    fn level(&mut self, size: usize, entities: usize, most: u64) -> Level {
        let names = self.names(entities);
        let Some(possible) = self.possible(&names) else {
            return Level::TooMany;
        };
        // The positions of the chosen facts, ascending. `next` is the next candidate in lexicographic order.
        let mut chosen: Vec<usize> = Vec::new();
        let mut next = 0;
        loop {
            self.steps += 1;
            if self.steps > STEPS * most {
                return Level::TooMany;
            }
            if chosen.len() == size {
                let facts: Vec<Fact> = chosen.iter().map(|&position| possible[position].clone()).collect();
                if self.is_new(&facts, &names) {
                    if self.spent >= most {
                        return Level::TooMany;
                    }
                    if self.differs(&facts, entities) {
                        return Level::Found(facts);
                    }
                }
            } else if next < possible.len() {
                chosen.push(next);
                if !self.nameless || in_order(chosen.iter().map(|&position| &possible[position]), &names) {
                    next += 1;
                    continue;
                }
            }
            match chosen.pop() {
                Some(last) => next = last + 1,
                None => return Level::Nothing,
            }
        }
    }

    /// Returns whether the scene was not tried with fewer entities.
    fn is_new(&self, facts: &[Fact], names: &[String]) -> bool {
        let used = |name: &String| facts.iter().any(|(_, row)| row.contains(name));
        !self.scopes.is_empty() || names.iter().all(used)
    }

    /// Draws a scene: mostly values that the rules name, and some others of moderate size.
    fn draw(&self, entities: usize, random: &mut impl Rng) -> Vec<Fact> {
        let names = self.names(entities);
        let open: Vec<usize> = self.open().collect();
        let mut facts = BTreeSet::new();
        for _ in 0..random.random_range(0..=RANDOM_MAX.1) {
            let Some(&predicate) = open.get(random.random_range(0..open.len().max(1))) else {
                break;
            };
            let row: Option<Vec<String>> = (self.columns[predicate].iter().enumerate())
                .map(|(column, &base)| {
                    let values = self.values((predicate, column), &names);
                    let number: i32 = random.random_range(-100..=100);
                    match base {
                        BaseType::Number if random.random_ratio(1, 4) => Some(number.to_string()),
                        BaseType::Unsigned if random.random_ratio(1, 4) => Some(number.unsigned_abs().to_string()),
                        BaseType::Float if random.random_ratio(1, 4) => Some(print_float(number as f32 / 4.0)),
                        _ => values.get(random.random_range(0..values.len().max(1))).cloned(),
                    }
                })
                .collect();
            facts.extend(row.map(|row| (predicate, row)));
        }
        facts.into_iter().collect()
    }

    /// Removes facts one by one while a difference remains.
    fn shrink(&mut self, mut facts: Vec<Fact>, entities: usize) -> Vec<Fact> {
        let mut at = 0;
        while at < facts.len() {
            let mut fewer = facts.clone();
            fewer.remove(at);
            if self.differs(&fewer, entities) {
                facts = fewer;
                at = 0;
            } else {
                at += 1;
            }
        }
        facts
    }

    /// Returns the facts with the rows of the scopes and the facts that the constraints require. If a covering
    /// constraint offers a choice, its first predicate is chosen.
    fn complete(&self, facts: &[Fact], entities: usize) -> BTreeSet<Fact> {
        let names = self.names(entities);
        let mut all: BTreeSet<Fact> = facts.iter().cloned().collect();
        for &scope in &self.scopes {
            let pairs = names
                .iter()
                .flat_map(|x| names.iter().map(move |y| vec![x.clone(), y.clone()]));
            all.extend(pairs.map(|row| (scope, row)));
        }
        let mut queue: Vec<Fact> = all.iter().cloned().collect();
        loop {
            while let Some((predicate, row)) = queue.pop() {
                for requirement in &self.required[predicate] {
                    let fact = match *requirement {
                        Requirement::Same(other) => (other, row.clone()),
                        Requirement::Reversed => (predicate, row.iter().rev().cloned().collect()),
                        Requirement::Loop { column, of } => (of, vec![row[column].clone(); 2]),
                    };
                    if all.insert(fact.clone()) {
                        queue.push(fact);
                    }
                }
            }
            let covered =
                |cover: &[usize], value: &String| cover.iter().any(|&one| all.contains(&(one, vec![value.clone()])));
            let missing = self.covers.iter().find_map(|Cover { domain, by }| {
                all.iter().find_map(|(predicate, row)| {
                    let values = domain
                        .iter()
                        .filter(|(one, _)| one == predicate)
                        .map(|&(_, column)| &row[column]);
                    let value = values.into_iter().find(|value| !covered(by, value))?;
                    Some((by[0], vec![value.clone()]))
                })
            });
            let Some(fact) = missing else { return all };
            all.insert(fact.clone());
            queue.push(fact);
        }
    }

    /// Returns whether the scene satisfies the constraints of both sides and they derive different outputs. A side that
    /// exceeds the limits shows no difference.
    fn differs(&mut self, facts: &[Fact], entities: usize) -> bool {
        self.tried += 1;
        self.spent += 1;
        if !self.are_functions(facts) {
            return false;
        }
        let wanted = self.complete(facts, entities);
        let changes: Vec<(Fact, bool)> = (self.held.difference(&wanted).map(|fact| (fact.clone(), false)))
            .chain(wanted.difference(&self.held).map(|fact| (fact.clone(), true)))
            .collect();
        self.held = wanted;
        let mut answers = Vec::new();
        for session in &mut self.sessions {
            for ((predicate, row), present) in &changes {
                let Some(declared) = session.program().predicate(&self.base[*predicate].name) else {
                    continue;
                };
                let row = words(session, &self.columns[*predicate], row);
                let outcome = match present {
                    true => session.insert(declared, &row),
                    false => session.retract(declared, &row),
                };
                debug_assert!(outcome.is_ok(), "a row of a base predicate");
            }
            let committed = session.commit().is_ok();
            self.spent += if committed { 0 } else { EXCEEDED_COST };
            let kept = committed && constraints::violations(session).is_empty();
            answers.push(kept.then(|| answer(session, self.outputs)));
        }
        matches!(answers.as_slice(), [Some(left), Some(right)] if left != right)
    }

    /// Returns the scene as the result of a search.
    fn found(&self, rules: [&Rules; 2], entities: usize, facts: &[Fact]) -> Equivalence {
        let scene = self.describe(rules, entities, facts);
        Equivalence::Different(naming::settle(scene, rules, self.outputs))
    }

    /// Describes the scene, with the rows that naive evaluation derives on each side.
    fn describe(&self, rules: [&Rules; 2], entities: usize, facts: &[Fact]) -> Difference {
        let all = self.complete(facts, entities);
        let derived = rules.map(|rules| {
            let rows = all.iter().filter_map(|(predicate, row)| {
                let declared = rules.predicate(&self.base[*predicate].name)?;
                Some((declared, row.clone()))
            });
            values::derived(rules, self.outputs, rows)
        });
        let mut by_predicate: Vec<(String, Vec<Vec<String>>)> = Vec::new();
        let ordered = all
            .into_iter()
            .filter(|(predicate, _)| !self.scopes.contains(predicate));
        // The differing row comes first.
        let differs = |row: &&(String, Vec<String>)| derived.iter().any(|rows: &Vec<_>| !rows.contains(*row));
        let mut names = Vec::new();
        if let Some((name, row)) = derived.iter().flatten().find(differs) {
            let columns = self.outputs.iter().find(|output| output.name == *name);
            let columns = columns.map_or(&[][..], |output| &output.columns);
            let symbols = row.iter().zip(columns).filter(|(_, base)| **base == BaseType::Symbol);
            names.extend(symbols.map(|(text, _)| text.clone()));
        }
        names.extend(self.names(entities));
        let mut seen = BTreeSet::new();
        names.retain(|name| seen.insert(name.clone()));
        for (predicate, row) in ordered {
            let symbols = self.columns[predicate].iter().zip(&row);
            for (_, text) in symbols.filter(|(base, _)| **base == BaseType::Symbol) {
                if !names.contains(text) && !self.functions.have_symbol(text) {
                    names.push(text.clone());
                }
            }
            let name = &self.base[predicate].name;
            match by_predicate.last_mut() {
                Some((last, rows)) if last == name => rows.push(row),
                _ => by_predicate.push((name.clone(), vec![row])),
            }
        }
        Difference {
            entities: names,
            facts: by_predicate,
            everybody_sees: self.scopes.iter().map(|&scope| self.base[scope].name.clone()).collect(),
            derived,
            smallest: false,
        }
    }
}

/// Returns whether the first occurrences of entities follow the order of their names. Among scenes that differ only in
/// names, exactly one is in that order.
fn in_order<'a>(facts: impl Iterator<Item = &'a Fact>, names: &[String]) -> bool {
    let mut used = 0;
    for text in facts.flat_map(|(_, row)| row) {
        match names.iter().position(|name| name == text) {
            Some(position) if position > used => return false,
            Some(position) if position == used => used += 1,
            _ => {}
        }
    }
    true
}

/// Returns the rows of the outputs as text, because the two sides number their symbols differently.
fn answer(session: &Session, outputs: &[Output]) -> Vec<BTreeSet<String>> {
    let rows = |output: &Output| {
        let predicate = session.program().predicate(&output.name)?;
        Some(facts::print(session, predicate).lines().map(str::to_owned).collect())
    };
    outputs.iter().map(|output| rows(output).unwrap_or_default()).collect()
}

/// Adds what the constraints of one side require of facts; see [`Trial`].
fn requirements(rules: &Rules, base: &[Base], required: &mut [Vec<Requirement>], covers: &mut Vec<Cover>) {
    let place = |predicate: PredicateId| {
        let name = &rules.predicates[predicate.index()].name;
        base.iter().position(|base| base.name == *name)
    };
    for DeclaredConstraint { constraint, domain, .. } in &rules.constraints {
        let domain = domain
            .iter()
            .filter_map(|&(predicate, column)| Some((place(predicate)?, column)));
        match *constraint {
            Constraint::Implies(one, other) => {
                if let (Some(one), Some(other)) = (place(one), place(other)) {
                    required[one].push(Requirement::Same(other));
                }
            }
            Constraint::Symmetric(one) => {
                if let Some(one) = place(one) {
                    required[one].push(Requirement::Reversed);
                }
            }
            Constraint::Reflexive(of) => {
                if let Some(of) = place(of) {
                    domain.for_each(|(one, column)| required[one].push(Requirement::Loop { column, of }));
                }
            }
            Constraint::Covering(ref cover) => {
                let by: Vec<usize> = cover.iter().filter_map(|&one| place(one)).collect();
                if !by.is_empty() {
                    let domain = domain.collect();
                    covers.push(Cover { domain, by });
                }
            }
            Constraint::Disjoint(..) | Constraint::Irreflexive(_) | Constraint::Asymmetric(_) => {}
        }
    }
}

/// Returns whether no rule inspects the characters or the order of strings.
fn is_nameless(rules: &Rules) -> bool {
    let looks = |literal: &Literal| match literal {
        Literal::Compare { op, base, .. } => {
            *base == BaseType::Symbol && !matches!(op, Comparison::Equal | Comparison::NotEqual)
        }
        Literal::Compute { base, .. } | Literal::Aggregate { base, .. } => *base == BaseType::Symbol,
        _ => false,
    };
    !rules.clauses.iter().flat_map(|clause| &clause.body).any(looks)
}

/// Returns the generator of the random scene with this number. It is ChaCha with 8 rounds, since `rand_chacha` keeps its
/// output stable across versions.
fn random_scene(number: u64) -> ChaCha8Rng {
    let mut key = [0; 32];
    // Keeps these draws apart from others that also have numbers.
    key[8] = 6;
    key[16..24].copy_from_slice(&number.to_le_bytes());
    ChaCha8Rng::from_seed(key)
}
