//! The choice of executor, and the compilation of rules for the dense one.

use crate::datalog::dense::{
    self, BitFacts, Condition, ConditionValues, Dense, Division, EntityDraw, Handed, Lifted, TooManySteps,
    TrackFirings, Unsupported, divide, lift,
};
use crate::datalog::internal::symbol_hash;
use crate::datalog::{ClauseId, Comparison, Past, PredicateId, Program, Rules, Value};
use crate::diag::{self, Diagnostic, Span};
use crate::predicate::{Quantity, Unit, WORDS};
use crate::sim::codes;
use crate::sim::tick::ground::Facts;
use crate::sim::tick::vocabulary::Vocabulary;

/// The executor that evaluates the rules.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Executor {
    /// Dense if it supports the rules for this number of agents. In a city, the relational executor evaluates clauses
    /// that it does not support. Otherwise relational.
    #[default]
    Auto,
    /// Evaluates predicates as bit words.
    Dense,
    /// Evaluates predicates as sorted lists of rows, updated incrementally.
    Relational,
}

impl Executor {
    /// All executors.
    pub const ALL: [Executor; 3] = [Executor::Auto, Executor::Dense, Executor::Relational];

    /// Returns the name on the command line.
    pub const fn name(self) -> &'static str {
        match self {
            Executor::Auto => "auto",
            Executor::Dense => "dense",
            Executor::Relational => "relational",
        }
    }

    /// Calls `make` unless the relational executor is selected, and returns its value or the reason to use the
    /// relational executor.
    ///
    /// # Errors
    /// The error of `make`, if the dense executor is selected.
    pub(crate) fn choose<T>(self, make: impl FnOnce() -> Result<T, Diagnostic>) -> Result<Choice<T>, Diagnostic> {
        if self == Executor::Relational {
            return Ok(Choice::Relational(None));
        }
        match make() {
            Ok(made) => Ok(Choice::Dense(made)),
            Err(fault) if self == Executor::Auto => Ok(Choice::Relational(Some(fault))),
            Err(fault) => Err(fault.help(
                "`--executor auto` uses the relational executor for what the dense one does not support, for fewer \
                 agents",
            )),
        }
    }
}

/// The executor that [`Executor::choose`] selects.
pub(crate) enum Choice<T> {
    /// The dense executor with the value of `make`.
    Dense(T),
    /// The relational executor; with the reason, if the dense one failed.
    Relational(Option<Diagnostic>),
}

/// Returns the diagnostic for rules that the dense executor cannot evaluate. `reason` follows "because".
pub(super) fn not_dense(reason: &str) -> Diagnostic {
    let message = format!("the dense executor cannot evaluate these rules, because {reason}");
    Diagnostic::new(codes::DENSE_UNSUPPORTED, message)
}

/// Returns the diagnostic for a run that the dense executor gives up.
pub(crate) fn given_up(error: TooManySteps) -> Diagnostic {
    Diagnostic::new(
        diag::codes::LIMIT_EXCEEDED,
        format!("the dense executor gave up: {error}"),
    )
    .help("`--executor auto` falls back to the relational executor")
}

/// Returns the fault of rules, with the place where the configuration names them if it has none of its own.
pub(crate) fn of_rules(fault: Diagnostic, rules: Span) -> Diagnostic {
    match fault.primary {
        Some(_) => fault,
        None => fault.at(rules, "these rules"),
    }
}

/// Rules compiled for the dense executor, with the conditions on quantities that they read.
#[derive(Debug)]
pub struct DenseRules {
    /// The program of the dense executor.
    pub dense: Dense,
    /// The conditions, which are inputs of the program.
    pub(crate) conditions: Conditions,
    /// The rules whose rows are inputs of the program; `None` if it evaluates all rules.
    pub(super) handed: Option<HandedRules>,
}

/// The rules that the dense executor hands over to a session.
#[derive(Debug)]
pub(super) struct HandedRules {
    pub program: Program,
    /// The predicates that the dense executor reads, each with the predicate of the program that has its rows, and its
    /// number of columns.
    pub predicates: Vec<(PredicateId, PredicateId, usize)>,
    /// By position in the vocabulary: whether the program reads the predicate.
    pub is_read: Vec<bool>,
    /// By position in [`Rules::pasts`]: whether the program reads the memory.
    pub reads_past: Vec<bool>,
    /// The clauses that are handed over, sorted, each with its position in the program.
    pub clauses: Vec<(ClauseId, ClauseId)>,
    /// Why the first of them is handed over.
    pub reason: Diagnostic,
}

impl HandedRules {
    /// Prepares the rules that are handed over, a part of `all`.
    fn new(handed: Handed, all: &Rules, vocabulary: &Vocabulary) -> Result<HandedRules, Diagnostic> {
        let reads = |predicate: PredicateId| handed.read.binary_search(&predicate).is_ok();
        let first = handed.reasons.first().expect("a division has a reason");
        let message = format!(
            "the relational executor evaluates some clauses, the first because {}",
            first.show(all)
        );
        Ok(HandedRules {
            is_read: vocabulary
                .predicates
                .iter()
                .map(|known| known.id.is_some_and(reads))
                .collect(),
            reads_past: all.pasts.iter().map(|past| reads(past.predicate)).collect(),
            predicates: handed
                .predicates
                .iter()
                .map(|&(dense, here)| (dense, here, handed.rules.predicates[here.index()].arity()))
                .collect(),
            clauses: handed.clauses,
            reason: located(Diagnostic::new(codes::DENSE_UNSUPPORTED, message), all, first),
            program: Program::new(handed.rules)?,
        })
    }
}

impl DenseRules {
    fn new(
        rules: Rules,
        conditions: Vec<Condition>,
        quantities: Vec<ReadQuantity>,
        vocabulary: &Vocabulary,
        counting: TrackFirings,
    ) -> Result<DenseRules, Diagnostic> {
        let steady = |declared| {
            let mut predicates = vocabulary.predicates.iter();
            predicates.any(|predicate| predicate.id == Some(declared) && predicate.definition.is_static())
        };
        let dense = Dense::new(&rules, counting, steady);
        Ok(DenseRules {
            dense: dense.map_err(|reason| located(not_dense(&reason.show(&rules)), &rules, &reason))?,
            handed: None,
            conditions: Conditions {
                list: conditions,
                words: WORDS.map(|word| Value(rules.symbols.intern(word).0)),
                rules,
                quantities,
            },
        })
    }

    /// Returns [`dense::costly`].
    pub(crate) fn costly(&self, entities: usize, egos: usize) -> Vec<ClauseId> {
        dense::costly(&self.conditions.rules, entities, egos)
    }

    /// Returns whether the rules draw.
    pub(crate) fn draws(&self) -> bool {
        self.conditions.rules.chance.is_some()
    }

    /// Returns, as bits, the facts about `count` entities that the rules read. `names` are those of the entities.
    pub fn bits<N: AsRef<str>, const W: usize>(
        &self,
        facts: &Facts,
        vocabulary: &Vocabulary,
        count: usize,
        names: impl Iterator<Item = N>,
    ) -> BitFacts<W> {
        let mut bits = BitFacts::new(&self.dense, count);
        for (predicate, rows) in vocabulary.predicates.iter().zip(&facts.rows) {
            if let (Some(declared), None) = (predicate.id, predicate.value) {
                for row in rows {
                    bits.insert(
                        &self.dense,
                        declared,
                        &row.map(|entity| entity as usize)[..predicate.arity],
                    );
                }
            }
        }
        let pasts = &self.conditions.rules.pasts;
        for (past, rows) in pasts.iter().zip(&facts.past) {
            let arity = self.conditions.rules.predicates[past.predicate.index()].arity();
            for (row, _) in rows {
                let row = row.map(|entity| entity as usize);
                bits.insert(&self.dense, past.predicate, &row[..arity]);
            }
        }
        let mut hashes = vec![0; count];
        if self.draws() {
            let of_names = names.map(|name| symbol_hash(name.as_ref()));
            hashes
                .iter_mut()
                .zip(of_names)
                .for_each(|(hash, of_name)| *hash = of_name);
        }
        self.conditions.add_to(&mut bits, &self.dense, facts, &hashes);
        bits
    }

    /// Returns the position in [`Rules::pasts`] of the memory with this hidden predicate.
    pub(crate) fn past(&self, predicate: PredicateId) -> Option<usize> {
        let mut pasts = self.conditions.rules.pasts.iter();
        pasts.position(|past| past.predicate == predicate)
    }
}

/// The condition that a quantity lies in a range, or outside of it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Threshold {
    pub quantity: Quantity,
    low: i32,
    high: i32,
    inside: bool,
}

impl Threshold {
    #[inline]
    pub fn holds(&self, number: i32) -> bool {
        // Without branches, since either may hold as often.
        (self.low <= number) & (number <= self.high) == self.inside
    }
}

/// The conditions on quantities that rules read.
#[derive(Debug)]
pub(crate) struct Conditions {
    list: Vec<Condition>,
    /// The rules that read the hidden predicates of the conditions.
    rules: Rules,
    /// The symbols of [`WORDS`].
    words: [Value; WORDS.len()],
    /// The positions in the vocabulary of the quantities.
    quantities: Vec<ReadQuantity>,
}

impl Conditions {
    /// Returns the position of the condition with this hidden predicate.
    pub fn find(&self, predicate: PredicateId) -> Option<usize> {
        self.list.iter().position(|condition| condition.predicate == predicate)
    }

    /// Returns a condition as ranges of whole numbers of one agent; `None` if it is more than that.
    pub fn thresholds(&self, condition: usize) -> Option<Vec<Threshold>> {
        let compared = self.list[condition].thresholds()?;
        let threshold = |(predicate, op, number): (PredicateId, Comparison, i32)| {
            let quantity = self.quantity(predicate)?;
            // Below the lowest number there is none.
            let (low, high, inside) = match op {
                Comparison::Equal => (number, number, true),
                Comparison::NotEqual => (number, number, false),
                Comparison::Less => (number, i32::MAX, false),
                Comparison::LessEqual => (i32::MIN, number, true),
                Comparison::Greater => (i32::MIN, number, false),
                Comparison::GreaterEqual => (number, i32::MAX, true),
                _ => return None,
            };
            (quantity.unit() == Unit::Number).then_some(Threshold {
                quantity,
                low,
                high,
                inside,
            })
        };
        compared.into_iter().map(threshold).collect()
    }

    /// Returns a condition as a comparison of a whole number of an agent with one of another agent; `None` if it is
    /// anything else.
    pub fn comparison(&self, condition: usize) -> Option<(Quantity, Comparison, Quantity)> {
        let (first, op, second) = self.list[condition].comparison()?;
        let number = |predicate| {
            self.quantity(predicate)
                .filter(|quantity| quantity.unit() == Unit::Number)
        };
        Some((number(first)?, op, number(second)?))
    }

    /// Returns [`Condition::entity_draw`].
    pub fn entity_draw(&self, condition: usize) -> Option<EntityDraw> {
        self.list[condition].entity_draw()
    }

    /// Returns the quantities that a condition on one agent reads. `None` if it draws, or is about two agents.
    pub fn reads(&self, condition: usize) -> Option<Vec<Quantity>> {
        let condition = &self.list[condition];
        let reads = condition.reads().filter(|_| condition.entities == 1)?;
        reads.into_iter().map(|predicate| self.quantity(predicate)).collect()
    }

    fn quantity(&self, predicate: PredicateId) -> Option<Quantity> {
        let mut known = self.quantities.iter();
        known.find(|(id, ..)| *id == predicate).map(|(.., quantity)| *quantity)
    }

    /// Returns whether a condition holds. `value` returns the value, as in [`Facts::values`], of the quantity at this
    /// position in the vocabulary for the entities at these places: 0 for the first of the condition, 1 for the second.
    /// `hashes` has the hashes of their names.
    #[inline]
    pub fn holds(
        &self,
        condition: usize,
        value: impl Fn(usize, Quantity, &[usize]) -> Option<Value>,
        word: u64,
        hashes: [u64; 2],
    ) -> bool {
        let given = Given {
            conditions: self,
            value,
            word,
            hashes,
        };
        self.list[condition].holds(&self.rules.symbols, &given)
    }

    /// Adds the facts of all conditions that a program reads to `bits`. `hashes` are those of the names of the entities.
    pub fn add_to<const W: usize>(&self, bits: &mut BitFacts<W>, dense: &Dense, facts: &Facts, hashes: &[u64]) {
        let count = hashes.len();
        let entity = |entity: usize| u32::try_from(entity).expect("fewer than 2^32 entities");
        for (position, condition) in self.list.iter().enumerate() {
            let holds = |places: [usize; 2]| {
                let value = |quantity, _, entities: &[usize]| {
                    let mut agents = [0; 2];
                    for (agent, place) in agents.iter_mut().zip(entities) {
                        *agent = entity(places[*place]);
                    }
                    facts.value(quantity, agents)
                };
                self.holds(position, value, facts.chance, places.map(|place| hashes[place]))
            };
            for x in 0..count {
                match condition.entities {
                    1 if holds([x, x]) => bits.insert(dense, condition.predicate, &[x]),
                    1 => {}
                    _ => (0..count)
                        .filter(|&y| holds([x, y]))
                        .for_each(|y| bits.insert(dense, condition.predicate, &[x, y])),
                }
            }
        }
    }
}

/// What a condition reads.
struct Given<'c, V> {
    conditions: &'c Conditions,
    value: V,
    word: u64,
    hashes: [u64; 2],
}

impl<V: Fn(usize, Quantity, &[usize]) -> Option<Value>> ConditionValues for Given<'_, V> {
    #[inline]
    fn value(&self, predicate: PredicateId, places: &[usize]) -> Option<Value> {
        let mut quantities = self.conditions.quantities.iter();
        let &(_, position, quantity) = quantities.find(|(id, ..)| *id == predicate)?;
        let value = (self.value)(position, quantity, places)?;
        Some(match quantity.unit() {
            Unit::Word(_) => self.conditions.words[value.0 as usize],
            Unit::Number | Unit::Float => value,
        })
    }

    #[inline]
    fn word(&self) -> u64 {
        self.word
    }

    #[inline]
    fn symbol_hash(&self, place: usize) -> u64 {
        self.hashes[place]
    }
}

/// Compiles the rules for the dense executor.
///
/// # Errors
/// `dense-unsupported` if it cannot evaluate them; the message names the reason, at its place in the rules.
pub(crate) fn compile(
    rules: &Rules,
    vocabulary: &Vocabulary,
    counting: TrackFirings,
) -> Result<DenseRules, Diagnostic> {
    let (lifted, quantities) = lift_quantities(rules, vocabulary);
    DenseRules::new(lifted.rules, lifted.conditions, quantities, vocabulary, counting)
}

/// Variant of [`compile`] that hands over clauses which the dense executor does not support: a session derives their
/// rows first.
///
/// # Errors
/// As [`compile`], if it must store a predicate that it cannot.
pub(super) fn compile_divided(
    rules: &Rules,
    vocabulary: &Vocabulary,
    counting: TrackFirings,
) -> Result<DenseRules, Diagnostic> {
    let (lifted, quantities) = lift_quantities(rules, vocabulary);
    let pasts = rules.pasts.iter();
    let watched: Vec<PredicateId> = pasts.flat_map(Past::operands).collect();
    let is_wanted = |predicate| vocabulary.action_of(predicate).is_some() || watched.contains(&predicate);
    let is_counted = |predicate: PredicateId| {
        let known = rules.predicates.get(predicate.index());
        counting != TrackFirings::Off && known.is_some_and(|known| !known.hidden)
    };
    let Some(Division { dense, handed }) = divide(rules, &lifted, is_wanted, is_counted) else {
        return compile(rules, vocabulary, counting);
    };
    let mut compiled = DenseRules::new(dense, lifted.conditions, quantities, vocabulary, counting)?;
    if let Some(handed) = handed {
        compiled.handed = Some(HandedRules::new(handed, rules, vocabulary)?);
    }
    Ok(compiled)
}

/// A quantity that the rules read, with its position in the vocabulary.
type ReadQuantity = (PredicateId, usize, Quantity);

fn lift_quantities(rules: &Rules, vocabulary: &Vocabulary) -> (Lifted, Vec<ReadQuantity>) {
    let quantities = vocabulary.predicates.iter().enumerate();
    let quantities = quantities.filter_map(|(position, known)| Some((known.id?, position, known.quantity()?)));
    let quantities: Vec<ReadQuantity> = quantities.collect();
    let lifted = lift(rules, |predicate| {
        let known = quantities.iter().find(|(id, ..)| *id == predicate);
        known.map(|(.., quantity)| quantity.agents())
    });
    (lifted, quantities)
}

/// Adds the places of a reason to the fault that names it.
fn located(fault: Diagnostic, rules: &Rules, reason: &Unsupported) -> Diagnostic {
    let clause = rules.clauses[reason.clause.index()].span;
    let mut fault = fault.at(reason.span, "this is not supported");
    if clause.start != reason.span.start {
        fault = fault.also(clause, "in this clause");
    }
    reason.help().into_iter().fold(fault, Diagnostic::help)
}
