//! Conditions on values: replaces the literals of a clause that read values of entities by one atom over the entities.
//!
//! ```text
//! Slow(X) :- IsCar(X), Waited(X, n), n > 40.      becomes    Slow(X) :- IsCar(X), +condition(X).
//! ```
//!
//! A draw is a condition, too: it reads the symbols of its entities.
//!
//! The executor stores no values. The caller decides with [`Condition::holds`] for which entities a condition holds, and
//! provides these as facts of its hidden predicate. A condition concerns one entity or two.

use crate::chance;
use crate::check::{Atom, Clause, Draw, Literal, Predicate, PredicateId, Rules, Term, VarId};
use crate::dense::values::value_columns;
use crate::symbol::Symbols;
use crate::syntax::ast::{BaseType, Comparison};
use crate::syntax::functor::Functor;
use crate::value::{Patterns, Value, symbol_hash};
use std::collections::BTreeMap;

/// A condition on the values of one entity or two.
#[derive(Clone, Debug)]
pub struct Condition {
    /// The hidden predicate, over one entity or two.
    pub predicate: PredicateId,
    /// The number of entities, 1 or 2.
    pub entities: usize,
    steps: Vec<Step>,
    /// See [`Condition::entity_draw`].
    draw: Option<EntityDraw>,
}

/// A draw with constant probabilities about at most two entities.
#[derive(Clone, Copy, Debug)]
pub struct EntityDraw {
    stream: u64,
    places: [usize; 2],
    count: usize,
    /// It succeeds for the drawn numbers from `low` to below `high`, in units of the smallest difference.
    low: u64,
    high: u64,
}

/// A draw in a tick.
#[derive(Clone, Copy, Debug)]
pub struct TickDraw {
    draw: EntityDraw,
    begun: chance::Draw,
}

impl EntityDraw {
    /// Returns the draw that the steps of a condition are.
    fn of(steps: &[Step]) -> Option<EntityDraw> {
        let [
            Step::Draw {
                stream,
                probabilities,
                alternative,
                values,
            },
        ] = steps
        else {
            return None;
        };
        let places: Option<Vec<usize>> = (values.iter())
            .map(|value| match value {
                DrawValue::Entity(place) => Some(*place),
                DrawValue::Value(_) | DrawValue::Symbol(_) => None,
            })
            .collect();
        let (places, count) = match places?[..] {
            [] => ([0; 2], 0),
            [x] => ([x; 2], 1),
            [x, y] => ([x, y], 2),
            _ => return None,
        };
        let constant = |operand: &Operand| match operand {
            Operand::Constant(value) => Some(value.as_float()),
            Operand::Variable(_) => None,
        };
        let probabilities: Vec<f32> = probabilities.iter().map(constant).collect::<Option<_>>()?;
        chance::alternative(0.0, probabilities.iter().copied())?;
        // The sums are those that the draw adds up.
        let sum = |count: usize| (probabilities[..count].iter()).fold(0.0, |sum, one| sum + f64::from(*one));
        let (low, high) = match *alternative < probabilities.len() {
            true => (sum(*alternative), sum(*alternative + 1)),
            false => (sum(probabilities.len()), f64::INFINITY),
        };
        Some(EntityDraw {
            stream: *stream,
            places,
            count,
            low: chance::Draw::bits_from(low),
            high: chance::Draw::bits_from(high),
        })
    }

    /// Begins the draw in the tick with this word.
    #[inline]
    pub fn in_tick(self, word: u64) -> TickDraw {
        let begun = chance::Draw::new(word, self.stream);
        TickDraw { draw: self, begun }
    }
}

impl TickDraw {
    /// Returns whether the draw succeeds for the entities at the places 0 and 1, given the
    /// [hashes](crate::internal::symbol_hash) of their symbols.
    #[inline(always)]
    pub fn succeeds(&self, [first, second]: [u64; 2]) -> bool {
        let of = |draw: chance::Draw, place: usize| draw.symbol(if place == 0 { first } else { second });
        let EntityDraw { places, count, .. } = self.draw;
        let all = match count {
            0 => self.begun,
            1 => of(self.begun, places[0]),
            _ => of(of(self.begun, places[0]), places[1]),
        };
        (self.draw.low..self.draw.high).contains(&all.bits())
    }
}

/// A value in a condition: that of a variable or a constant.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Operand {
    Variable(usize),
    Constant(Value),
}

/// A step of a condition. Variables that it reads have a value.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Step {
    /// Reads the value of a predicate for entities, by their places.
    Load {
        predicate: PredicateId,
        entities: Vec<usize>,
        to: usize,
    },
    /// The predicate has a value for the entities: this one, if it names one. Or, unless `holds`, it has not.
    Has {
        predicate: PredicateId,
        entities: Vec<usize>,
        value: Option<Operand>,
        holds: bool,
    },
    Copy {
        from: Operand,
        to: usize,
    },
    Compare {
        op: Comparison,
        base: BaseType,
        left: Operand,
        right: Operand,
    },
    Compute {
        functor: Functor,
        base: BaseType,
        arguments: Vec<Operand>,
        to: usize,
    },
    /// The draw of this stream chooses this alternative.
    Draw {
        stream: u64,
        probabilities: Vec<Operand>,
        alternative: usize,
        values: Vec<DrawValue>,
    },
}

/// A value that a draw is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum DrawValue {
    /// The symbol of the entity at this place.
    Entity(usize),
    Value(Operand),
    Symbol(Operand),
}

/// What conditions read of a tick and its entities, by their places in the condition.
pub trait ConditionValues {
    /// Returns the value of a predicate for the entities at these places.
    fn value(&self, predicate: PredicateId, places: &[usize]) -> Option<Value>;

    /// Returns the word from which the draws of the tick follow.
    fn word(&self) -> u64;

    /// Returns the [hash](crate::internal::symbol_hash) of the symbol of the entity at this place.
    fn symbol_hash(&self, place: usize) -> u64;
}

/// Rules that read values in conditions only, as far as possible.
#[derive(Clone, Debug)]
pub struct Lifted {
    /// The rules. Clauses have the positions that they had before. Columns for symbols that may be no entities have the
    /// base type of whole numbers.
    pub rules: Rules,
    /// The conditions, each once.
    pub conditions: Vec<Condition>,
}

impl Condition {
    /// Returns whether the condition holds for the entities at the places 0 and 1.
    #[inline]
    pub fn holds(&self, symbols: &Symbols, given: &impl ConditionValues) -> bool {
        match &self.draw {
            Some(draw) => draw
                .in_tick(given.word())
                .succeeds([given.symbol_hash(0), given.symbol_hash(1)]),
            None => self.steps_hold(symbols, given),
        }
    }

    fn steps_hold(&self, symbols: &Symbols, given: &impl ConditionValues) -> bool {
        let mut values = [Value::default(); Condition::VARIABLES_MAX];
        let get = |values: &[Value], operand: Operand| match operand {
            Operand::Variable(variable) => values[variable],
            Operand::Constant(value) => value,
        };
        self.steps.iter().all(|step| match step {
            Step::Load {
                predicate,
                entities,
                to,
            } => {
                let found = given.value(*predicate, entities);
                values[*to] = found.unwrap_or_default();
                found.is_some()
            }
            Step::Has {
                predicate,
                entities,
                value: wanted,
                holds,
            } => {
                let found = given.value(*predicate, entities);
                let has = found.is_some_and(|found| wanted.is_none_or(|wanted| get(&values, wanted) == found));
                has == *holds
            }
            Step::Copy { from, to } => {
                values[*to] = get(&values, *from);
                true
            }
            Step::Compare { op, base, left, right } => {
                let (left, right) = (get(&values, *left), get(&values, *right));
                op.holds(*base, left, right, symbols, || {
                    Patterns::match_once(left, right, symbols)
                })
            }
            Step::Compute {
                functor,
                base,
                arguments,
                to,
            } => {
                let found = match arguments[..] {
                    // Without an allocation, as most functors.
                    [one, two] => functor.apply(*base, &[get(&values, one), get(&values, two)], symbols),
                    _ => {
                        let arguments = arguments.iter().map(|operand| get(&values, *operand));
                        functor.apply(*base, &arguments.collect::<Vec<Value>>(), symbols)
                    }
                };
                values[*to] = found.unwrap_or_default();
                found.is_some()
            }
            Step::Draw {
                stream,
                probabilities,
                alternative,
                values: about,
            } => drawn(*stream, probabilities, *alternative, about, &values, symbols, given),
        })
    }

    /// Returns the condition as comparisons of numbers of one entity with constants: each value, by its predicate, has
    /// this relation to this number. `None` if it is more than that.
    pub fn thresholds(&self) -> Option<Vec<(PredicateId, Comparison, i32)>> {
        if self.entities != 1 {
            return None;
        }
        let mut loaded = BTreeMap::new();
        let mut compared: Vec<(PredicateId, Comparison, i32)> = Vec::new();
        for step in &self.steps {
            match step {
                Step::Load { predicate, to, .. } => _ = loaded.insert(*to, *predicate),
                Step::Compare {
                    op,
                    base: BaseType::Number,
                    left,
                    right,
                } => {
                    let (op, variable, constant) = match (left, right) {
                        (Operand::Variable(variable), Operand::Constant(constant)) => (*op, variable, constant),
                        (Operand::Constant(constant), Operand::Variable(variable)) => {
                            (op.mirrored(), variable, constant)
                        }
                        _ => return None,
                    };
                    compared.push((*loaded.get(variable)?, op, constant.as_number()));
                }
                _ => return None,
            }
        }
        // A value that is loaded only must exist.
        let is_compared = |loaded: &PredicateId| compared.iter().any(|(compared, ..)| compared == loaded);
        loaded.values().all(is_compared).then_some(compared)
    }

    /// Returns the condition as a comparison of a number of the first entity with one of the second, by the predicates of
    /// the numbers. `None` if it is anything else.
    pub fn comparison(&self) -> Option<(PredicateId, Comparison, PredicateId)> {
        let number = |step: &Step| match step {
            Step::Load {
                predicate,
                entities,
                to,
            } => match entities[..] {
                [place] => Some((place, *predicate, *to)),
                _ => None,
            },
            _ => None,
        };
        // The second number is compared with the first, or the second entity has the first number.
        let ((left_place, left), op, (right_place, right)) = match &self.steps[..] {
            [
                one,
                two,
                Step::Compare {
                    op,
                    base: BaseType::Number,
                    left,
                    right,
                },
            ] => {
                let loaded = [number(one)?, number(two)?];
                let of = |operand: &Operand| {
                    let mut loaded = loaded.iter();
                    let found = loaded.find(|(.., to)| *operand == Operand::Variable(*to));
                    found.map(|(place, predicate, _)| (*place, *predicate))
                };
                (of(left)?, *op, of(right)?)
            }
            [
                one,
                Step::Has {
                    predicate,
                    entities,
                    value: Some(value),
                    holds: true,
                },
            ] => {
                let (place, first, to) = number(one)?;
                match entities[..] {
                    [other] if *value == Operand::Variable(to) => {
                        ((place, first), Comparison::Equal, (other, *predicate))
                    }
                    _ => return None,
                }
            }
            _ => return None,
        };
        match (left_place, right_place) {
            (0, 1) => Some((left, op, right)),
            (1, 0) => Some((right, op.mirrored(), left)),
            _ => None,
        }
    }

    /// Returns the condition, if it is nothing but a draw with constant probabilities about entities.
    pub fn entity_draw(&self) -> Option<EntityDraw> {
        self.draw
    }

    /// Returns the predicates that the condition reads. `None` if it draws.
    pub fn reads(&self) -> Option<Vec<PredicateId>> {
        let mut reads = Vec::new();
        for step in &self.steps {
            match step {
                Step::Load { predicate, .. } | Step::Has { predicate, .. } => reads.push(*predicate),
                Step::Draw { .. } => return None,
                Step::Copy { .. } | Step::Compare { .. } | Step::Compute { .. } => {}
            }
        }
        Some(reads)
    }

    /// The maximum number of variables for values.
    const VARIABLES_MAX: usize = 16;
}

/// Returns whether a draw chooses the alternative.
fn drawn(
    stream: u64,
    probabilities: &[Operand],
    alternative: usize,
    about: &[DrawValue],
    values: &[Value],
    symbols: &Symbols,
    given: &impl ConditionValues,
) -> bool {
    let get = |operand: Operand| match operand {
        Operand::Variable(variable) => values[variable],
        Operand::Constant(value) => value,
    };
    let begun = chance::Draw::new(given.word(), stream);
    let draw = about.iter().fold(begun, |draw, value| match *value {
        DrawValue::Entity(place) => draw.symbol(given.symbol_hash(place)),
        DrawValue::Value(operand) => draw.value(get(operand).0),
        DrawValue::Symbol(operand) => draw.symbol(symbol_hash(get(operand), symbols)),
    });
    let probabilities = probabilities.iter().map(|operand| get(*operand).as_float());
    chance::alternative(draw.number(), probabilities) == Some(alternative)
}

/// Replaces literals on values by conditions. `entities` returns for a predicate whose last column is a value the number
/// of columns before it, which hold entities, at most two; each row of entities has at most one value.
///
/// Literals remain if they relate values of more than two entities, if other literals read these values, or if they
/// name an entity by a constant.
pub fn lift(rules: &Rules, entities: impl Fn(PredicateId) -> Option<usize>) -> Lifted {
    let mut predicates = rules.predicates.clone();
    let mut conditions = Vec::new();
    let mut known: BTreeMap<(usize, Vec<Step>), PredicateId> = BTreeMap::new();
    let mut condition = |clause: &Clause, group: &[usize]| {
        let made = Body::of(rules, clause, group, &entities)?;
        let head = &rules.predicates[clause.head.predicate.index()];
        let literals = || group.iter().filter_map(|&literal| clause.body[literal].atom());
        let read = literals().map(|atom| &rules.predicates[atom.predicate.index()]);
        let mut first_columns = read.chain([head]).filter_map(|predicate| predicate.columns.first());
        let entity = first_columns.find(|column| column.base == BaseType::Symbol)?;
        let next = PredicateId(u32::try_from(predicates.len()).expect("fewer than 2^32 predicates"));
        let predicate = *known.entry((made.terms.len(), made.steps.clone())).or_insert(next);
        if predicate == next {
            predicates.push(Predicate {
                input: true,
                derived: false,
                ..Predicate::made(
                    format!("+condition {}", conditions.len()),
                    vec![entity.clone(); made.terms.len()],
                    "a condition on values".to_owned(),
                    clause.span,
                )
            });
            conditions.push(Condition {
                predicate,
                entities: made.terms.len(),
                draw: EntityDraw::of(&made.steps),
                steps: made.steps,
            });
        }
        Some(Literal::Positive(Atom {
            predicate,
            terms: made.terms,
            span: literals().next().map_or(clause.span, |atom| atom.span),
        }))
    };
    let clauses = rules.clauses.iter().map(|clause| {
        let mut body: Vec<Option<Literal>> = clause.body.iter().cloned().map(Some).collect();
        for group in groups(rules, clause, &entities) {
            if let Some(literal) = condition(clause, &group) {
                group.iter().for_each(|&member| body[member] = None);
                body[group[0]] = Some(literal);
            }
        }
        Clause {
            body: body.into_iter().flatten().collect(),
            ..clause.clone()
        }
    });
    let clauses = clauses.collect();
    for (predicate, values) in predicates.iter_mut().zip(value_columns(rules, &entities)) {
        for (column, _) in predicate.columns.iter_mut().zip(values).filter(|(_, value)| *value) {
            column.base = BaseType::Unsigned;
        }
    }
    Lifted {
        rules: Rules {
            clauses,
            predicates,
            ..rules.clone()
        },
        conditions,
    }
}

/// Returns the groups of literals of a clause that share variables for values, by their positions. Each group reads a
/// value, and no other literal reads a variable of it.
fn groups(rules: &Rules, clause: &Clause, entities: &impl Fn(PredicateId) -> Option<usize>) -> Vec<Vec<usize>> {
    let draw = rules.draw(clause);
    let of_draw = |position: usize| draw.as_ref().is_some_and(|draw| draw.literals.contains(&position));
    // The variables that occur elsewhere than as values.
    let mut others = vec![false; clause.variables.len()];
    let mut mark = |term: &Term| {
        if let Term::Variable(variable) = term {
            others[variable.index()] = true;
        }
    };
    clause.head.terms.iter().for_each(&mut mark);
    for (position, literal) in clause.body.iter().enumerate() {
        match literal {
            _ if of_draw(position) => {}
            Literal::Positive(atom) | Literal::Negative(atom) if let Some(count) = entities(atom.predicate) => {
                atom.terms[..count].iter().for_each(&mut mark);
            }
            Literal::Compare { .. } | Literal::Compute { .. } => {}
            _ => literal.terms().for_each(&mut mark),
        }
    }
    let values = |position: usize, literal: &Literal| -> Vec<VarId> {
        match literal {
            _ if of_draw(position) => {
                // Entities are no values.
                literal
                    .variables()
                    .filter(|variable| !others[variable.index()])
                    .collect()
            }
            Literal::Positive(atom) | Literal::Negative(atom) => match entities(atom.predicate) {
                Some(count) => atom.terms[count..].iter().filter_map(Term::variable).collect(),
                None => Vec::new(),
            },
            Literal::Compare { .. } | Literal::Compute { .. } => literal.variables().collect(),
            Literal::Aggregate { .. } | Literal::Guard(_) => Vec::new(),
        }
    };
    let reads = |literal: &Literal| match literal {
        Literal::Positive(atom) | Literal::Negative(atom) => entities(atom.predicate).is_some(),
        _ => false,
    };
    let mut groups: Vec<(Vec<usize>, Vec<VarId>)> = Vec::new();
    for (position, literal) in clause.body.iter().enumerate() {
        let variables = values(position, literal);
        if !reads(literal) && !of_draw(position) && variables.iter().all(|variable| others[variable.index()]) {
            continue;
        }
        let mut joined = (vec![position], variables);
        groups.retain(|(members, known)| {
            let apart = known.iter().all(|variable| !joined.1.contains(variable));
            if !apart {
                joined.0.extend(members);
                joined.1.extend(known);
            }
            apart
        });
        groups.push(joined);
    }
    let whole = |(members, variables): &(Vec<usize>, Vec<VarId>)| {
        variables.iter().all(|variable| !others[variable.index()])
            && members
                .iter()
                .any(|&member| reads(&clause.body[member]) || of_draw(member))
    };
    let whole = groups.into_iter().filter(whole);
    let sorted = whole.map(|(mut members, _)| {
        members.sort_unstable();
        members
    });
    sorted.collect()
}

/// The entities and steps of a condition.
#[derive(Default)]
struct Body {
    terms: Vec<Term>,
    steps: Vec<Step>,
    /// The variables with a value, in the order of the steps that find it; `None` for the result of a functor that is
    /// only compared.
    bound: Vec<Option<VarId>>,
}

impl Body {
    /// Translates a group of literals; `None` if it is no condition on one or two entities.
    fn of(
        rules: &Rules,
        clause: &Clause,
        group: &[usize],
        entities: &impl Fn(PredicateId) -> Option<usize>,
    ) -> Option<Body> {
        let mut body = Body::default();
        let draw = rules.draw(clause).filter(|draw| group.contains(&draw.literals[0]));
        let drawn = draw.as_ref().map_or([usize::MAX; 3], |draw| draw.literals);
        let rest = group.iter().filter(|literal| !drawn.contains(literal));
        let mut rest: Vec<&Literal> = rest.map(|&literal| &clause.body[literal]).collect();
        // Atoms first: they bind variables.
        rest.sort_by_key(|literal| !matches!(literal, Literal::Positive(_)));
        while !rest.is_empty() {
            let mut left = Vec::new();
            let before = rest.len();
            for literal in rest {
                if !body.add(literal, entities)? {
                    left.push(literal);
                }
            }
            if left.len() == before {
                return None;
            }
            rest = left;
        }
        if let Some(draw) = &draw {
            body.add_draw(draw)?;
        }
        if body.terms.is_empty() {
            // A condition on the city alone holds for each entity.
            let ego = clause
                .head
                .terms
                .first()
                .filter(|term| matches!(term, Term::Variable(_)));
            body.terms.push(*ego?);
        }
        (body.bound.len() <= Condition::VARIABLES_MAX).then_some(body)
    }

    /// Adds a literal if the variables that it reads have a value. Returns whether they have one; `None` if no condition
    /// can contain the literal.
    fn add(&mut self, literal: &Literal, entities: &impl Fn(PredicateId) -> Option<usize>) -> Option<bool> {
        match literal {
            Literal::Positive(atom) | Literal::Negative(atom) => {
                let holds = matches!(literal, Literal::Positive(_));
                let predicate = atom.predicate;
                let last = atom.terms[entities(predicate)?];
                let value = match last {
                    Term::Wildcard => None,
                    last => match self.operand(last) {
                        None if !holds => return Some(false),
                        known => known,
                    },
                };
                let entities = self.entities(&atom.terms[..entities(predicate)?])?;
                let step = match (last, value) {
                    (Term::Variable(variable), None) => Step::Load {
                        predicate,
                        entities,
                        to: self.bind(Some(variable)),
                    },
                    _ => Step::Has {
                        predicate,
                        entities,
                        value,
                        holds,
                    },
                };
                self.steps.push(step);
            }
            &Literal::Compare {
                op, left, right, base, ..
            } => {
                let step = match (self.operand(left), self.operand(right)) {
                    (Some(left), Some(right)) => Step::Compare { op, base, left, right },
                    (Some(from), None) if op == Comparison::Equal => Step::Copy {
                        from,
                        to: self.bind(right.variable()),
                    },
                    (None, Some(from)) if op == Comparison::Equal => Step::Copy {
                        from,
                        to: self.bind(left.variable()),
                    },
                    _ => return Some(false),
                };
                self.steps.push(step);
            }
            Literal::Compute {
                functor: Functor::Call | Functor::Counter,
                ..
            } => return None,
            &Literal::Compute {
                to,
                functor,
                base,
                ref arguments,
                ..
            } => {
                let operands: Option<Vec<Operand>> = arguments.iter().map(|term| self.operand(*term)).collect();
                let Some(arguments) = operands else {
                    return Some(false);
                };
                let expected = self.operand(to);
                let place = self.bind(to.variable().filter(|_| expected.is_none()));
                self.steps.push(Step::Compute {
                    functor,
                    base,
                    arguments,
                    to: place,
                });
                // Equal values have equal words, so the base type does not matter.
                self.steps.extend(expected.map(|right| Step::Compare {
                    op: Comparison::Equal,
                    base: BaseType::Unsigned,
                    left: Operand::Variable(place),
                    right,
                }));
            }
            Literal::Aggregate { .. } | Literal::Guard(_) => return None,
        }
        Some(true)
    }

    /// Adds a draw; `None` if it is about more than two entities.
    fn add_draw(&mut self, draw: &Draw) -> Option<()> {
        let probabilities = draw.probabilities.iter().map(|term| self.operand(*term));
        let probabilities = probabilities.collect::<Option<_>>()?;
        let mut values = Vec::new();
        for (term, is_symbol) in draw.values.iter().zip(&draw.symbols) {
            values.push(match (self.operand(*term), is_symbol) {
                (Some(operand), true) => DrawValue::Symbol(operand),
                (Some(operand), false) => DrawValue::Value(operand),
                (None, true) => DrawValue::Entity(self.entities(&[*term])?[0]),
                (None, false) => return None,
            });
        }
        self.steps.push(Step::Draw {
            stream: draw.stream,
            probabilities,
            alternative: draw.alternative,
            values,
        });
        Some(())
    }

    /// Returns the places of entities; `None` for more than two, and for constants.
    fn entities(&mut self, terms: &[Term]) -> Option<Vec<usize>> {
        let place = |term: &Term| {
            let known = self
                .terms
                .iter()
                .position(|known| known == term && *term != Term::Wildcard);
            if known.is_none() {
                self.terms.push(*term);
            }
            let is_entity = !matches!(term, Term::Constant(_)) && self.terms.len() <= 2;
            is_entity.then(|| known.unwrap_or(self.terms.len() - 1))
        };
        terms.iter().map(place).collect()
    }

    /// Returns the value of a term, if it has one.
    fn operand(&self, term: Term) -> Option<Operand> {
        match term {
            Term::Constant(value) => Some(Operand::Constant(value)),
            Term::Variable(variable) => {
                let place = self.bound.iter().position(|bound| *bound == Some(variable));
                place.map(Operand::Variable)
            }
            Term::Wildcard => None,
        }
    }

    /// Gives a variable the next place.
    fn bind(&mut self, variable: Option<VarId>) -> usize {
        self.bound.push(variable);
        self.bound.len() - 1
    }
}
