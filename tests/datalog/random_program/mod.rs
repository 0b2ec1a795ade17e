//! Random safe, stratified programs, facts and scripts of changes, made to shrink well.
//!
//! proptest draws lists of small numbers (a [`Genome`]). [`Genome::rules`] reads any such list as a program and repairs
//! unsafe clauses. So every shrunk list is a valid program, too.

#![allow(dead_code, reason = "each test target uses its own part")]

pub mod agree;

use logicity_datalog::diag::{Sources, Span};
use logicity_datalog::symbol::Symbols;
use logicity_datalog::{
    AggregateOp, Atom, BaseType, Clause, ClauseId, Column, Comparison, Functor, Literal, Predicate, PredicateId, Rules,
    Stratum, Term, Type, TypeId, Value, VarId,
};
use proptest::collection::vec;
use proptest::prelude::*;

/// The symbols of the domain. Their order of interning differs from that of their texts.
pub const TEXTS: [&str; 5] = ["m", "b", "", "é", "a"];
/// The numbers of the domain.
pub const NUMBERS: [i32; 8] = [0, 1, -1, i32::MIN, 7, 2, 3, i32::MAX];

/// The variables in the atoms of a clause: even ones hold symbols, odd ones numbers.
const VARIABLES: usize = 8;

/// The variables after them hold floats, which clauses compute and compare but no atom contains.
const FLOATS: [usize; 2] = [8, 9];

/// The floats of the domain, with "not a number".
const FLOAT_CONSTANTS: [f32; 6] = [0.0, -0.0, 0.5, -2.5, f32::INFINITY, f32::NAN];

/// Raw material of an atom or comparison.
#[derive(Clone, Debug)]
pub struct LiteralGene {
    kind: u8,
    predicate: u8,
    terms: [u8; 5],
}

/// Raw material of a clause.
#[derive(Clone, Debug)]
pub struct ClauseGene {
    predicate: u8,
    head: [u8; 5],
    body: Vec<LiteralGene>,
}

/// A change of a base fact: whether it is inserted, predicate, values.
pub type ChangeGene = (bool, u8, [u8; 5]);

/// Changes of one commit: true inserts the row, false retracts it.
pub type Batch = Vec<(bool, PredicateId, Vec<Value>)>;

/// Raw material of a program and its script of changes.
#[derive(Clone, Debug)]
pub struct Genome {
    /// Column bases of the base predicates.
    base: Vec<Vec<bool>>,
    /// For each stratum, the column bases of its predicates, and its clauses.
    strata: Vec<(Vec<Vec<bool>>, Vec<ClauseGene>)>,
    /// Batches of changes.
    pub script: Vec<Vec<ChangeGene>>,
}

/// Programs with `batches` batches of changes.
pub fn genomes(batches: std::ops::Range<usize>) -> impl Strategy<Value = Genome> {
    let columns = || prop_oneof![8 => vec(prop::bool::weighted(0.3), 0..=3), 1 => vec(any::<bool>(), 4..=5)];
    let literal = || {
        (any::<u8>(), any::<u8>(), any::<[u8; 5]>()).prop_map(|(kind, predicate, terms)| LiteralGene {
            kind,
            predicate,
            terms,
        })
    };
    let clause = || {
        (any::<u8>(), any::<[u8; 5]>(), vec(literal(), 0..6)).prop_map(|(predicate, head, body)| ClauseGene {
            predicate,
            head,
            body,
        })
    };
    let stratum = (vec(columns(), 1..=3), vec(clause(), 1..6));
    let script = vec(
        vec((prop::bool::weighted(0.7), any::<u8>(), any::<[u8; 5]>()), 0..25),
        batches,
    );
    (vec(columns(), 1..=4), vec(stratum, 1..=4), script).prop_map(|(base, strata, script)| Genome {
        base,
        strata,
        script,
    })
}

/// Programs of mostly recursion over pairs, with many joins and a late fixpoint.
pub fn recursive_genomes(batches: std::ops::Range<usize>) -> impl Strategy<Value = Genome> {
    let pairs = |count| vec(Just(vec![true; 2]), count);
    // Variables only.
    let terms = || prop::array::uniform5(0..192u8);
    let literal = || {
        (prop_oneof![20 => 0..150u8, 1 => 150..=255u8], any::<u8>(), terms())
            .prop_map(|(kind, predicate, terms)| LiteralGene { kind, predicate, terms })
    };
    let clause = || {
        (any::<u8>(), terms(), vec(literal(), 1..4)).prop_map(|(predicate, head, body)| ClauseGene {
            predicate,
            head,
            body,
        })
    };
    let stratum = (pairs(1..=2), vec(clause(), 2..6));
    let script = vec(
        vec((prop::bool::weighted(0.8), any::<u8>(), any::<[u8; 5]>()), 3..12),
        batches,
    );
    (pairs(1..=2), vec(stratum, 1..=2), script).prop_map(|(base, strata, script)| Genome { base, strata, script })
}

/// Programs whose literals mostly compute, aggregate or compare, with floats, too, over predicates of numbers.
pub fn computing_genomes(batches: std::ops::Range<usize>) -> impl Strategy<Value = Genome> {
    let columns = || vec(prop::bool::weighted(0.8), 1..=2);
    let kind = prop_oneof![2 => 0..130u8, 1 => 150..190u8, 5 => 225..233u8, 1 => 233..241u8, 3 => 241..=255u8];
    let literal = (kind, any::<u8>(), any::<[u8; 5]>()).prop_map(|(kind, predicate, terms)| LiteralGene {
        kind,
        predicate,
        terms,
    });
    let clause = (any::<u8>(), any::<[u8; 5]>(), vec(literal, 2..7)).prop_map(|(predicate, head, body)| ClauseGene {
        predicate,
        head,
        body,
    });
    let stratum = (vec(columns(), 1..=2), vec(clause, 1..4));
    let script = vec(
        vec((prop::bool::weighted(0.8), any::<u8>(), any::<[u8; 5]>()), 5..20),
        batches,
    );
    (vec(columns(), 1..=3), vec(stratum, 1..=3), script).prop_map(|(base, strata, script)| Genome {
        base,
        strata,
        script,
    })
}

/// Bytes as numbers of a genome; zeros after the last.
struct Numbers<'b>(std::slice::Iter<'b, u8>);

impl Numbers<'_> {
    fn next(&mut self) -> u8 {
        self.0.next().copied().unwrap_or(0)
    }

    fn list<T>(&mut self, length: std::ops::RangeInclusive<u8>, mut read: impl FnMut(&mut Self) -> T) -> Vec<T> {
        let length = length.start() + self.next() % (length.end() - length.start() + 1);
        (0..length).map(|_| read(self)).collect()
    }

    fn array<T>(&mut self, mut read: impl FnMut(&mut Self) -> T) -> [T; 5] {
        std::array::from_fn(|_| read(self))
    }
}

impl Genome {
    /// Reads any bytes as a genome: one of [`genomes`], or, if the first byte is odd, of [`recursive_genomes`].
    pub fn read(bytes: &[u8]) -> Genome {
        let mut numbers = Numbers(bytes.iter());
        let pairs = numbers.next() % 2 == 1;
        let predicates = |numbers: &mut Numbers<'_>| {
            let columns = |numbers: &mut Numbers<'_>| match pairs {
                true => vec![true; 2],
                false => numbers.list(0..=5, |numbers| numbers.next() % 3 == 0),
            };
            numbers.list(1..=3, columns)
        };
        let term = |numbers: &mut Numbers<'_>| if pairs { numbers.next() % 192 } else { numbers.next() };
        let literal = |numbers: &mut Numbers<'_>| LiteralGene {
            kind: numbers.next(),
            predicate: numbers.next(),
            terms: numbers.array(term),
        };
        let clause = |numbers: &mut Numbers<'_>| ClauseGene {
            predicate: numbers.next(),
            head: numbers.array(term),
            body: numbers.list(0..=5, literal),
        };
        let change = |numbers: &mut Numbers<'_>| {
            let kind = numbers.next();
            (kind % 4 != 3, kind / 4, numbers.array(Numbers::next))
        };
        Genome {
            base: predicates(&mut numbers),
            strata: numbers.list(1..=3, |numbers| (predicates(numbers), numbers.list(1..=5, clause))),
            script: numbers.list(1..=4, |numbers| numbers.list(0..=24, change)),
        }
    }

    /// The program.
    pub fn rules(&self) -> Rules {
        let span = Span::new(Sources::new().add("random.dl", ""), 0..0);
        let symbols = Symbols::new();
        TEXTS.iter().for_each(|text| _ = symbols.intern(text));
        let mut rules = Rules {
            types: [("symbol", BaseType::Symbol), ("number", BaseType::Number)]
                .map(|(name, base)| Type {
                    name: name.into(),
                    base,
                    parent: None,
                    members: Vec::new(),
                    shapes: Vec::new(),
                    doc: String::new(),
                })
                .into(),
            predicates: Vec::new(),
            clauses: Vec::new(),
            strata: Vec::new(),
            constraints: Vec::new(),
            functions: Vec::new(),
            functors: [].into(),
            pasts: Vec::new(),
            chance: None,
            symbols,
        };
        for columns in &self.base {
            declare(&mut rules, columns, span);
        }
        for (predicates, clauses) in &self.strata {
            let first = rules.predicates.len();
            for columns in predicates {
                declare(&mut rules, columns, span);
            }
            let mut stratum = Stratum {
                predicates: (first..rules.predicates.len()).map(id).collect(),
                clauses: Vec::new(),
                recursive: false,
            };
            for gene in clauses {
                let clause = clause(gene, &rules, first, span);
                stratum.recursive |= clause.body.iter().any(|literal| match literal {
                    Literal::Positive(atom) | Literal::Guard(atom) => stratum.predicates.contains(&atom.predicate),
                    _ => false,
                });
                rules.predicates[clause.head.predicate.index()].derived |= !clause.body.is_empty();
                stratum.clauses.push(ClauseId(rules.clauses.len() as u32));
                rules.clauses.push(clause);
            }
            stratum.predicates.retain(|predicate| {
                let mut heads = stratum
                    .clauses
                    .iter()
                    .map(|clause| rules.clauses[clause.index()].head.predicate);
                heads.any(|head| head == *predicate)
            });
            rules.strata.push(stratum);
        }
        rules
    }

    /// All batches.
    pub fn batches(&self, rules: &Rules) -> Vec<Batch> {
        (0..self.script.len()).map(|batch| self.batch(rules, batch)).collect()
    }

    /// A batch as rows of base predicates.
    pub fn batch(&self, rules: &Rules, batch: usize) -> Batch {
        let base: Vec<PredicateId> = (0..rules.predicates.len()).map(id).collect();
        let base: Vec<PredicateId> = base
            .into_iter()
            .filter(|base| !rules.predicates[base.index()].derived)
            .collect();
        let change = |(present, predicate, values): &ChangeGene| {
            let predicate = base[*predicate as usize % base.len()];
            let columns = rules.predicates[predicate.index()].columns.iter();
            (
                *present,
                predicate,
                columns
                    .zip(values)
                    .map(|(column, &gene)| constant(column.base, gene))
                    .collect(),
            )
        };
        self.script[batch].iter().map(change).collect()
    }
}

fn id(position: usize) -> PredicateId {
    PredicateId(position as u32)
}

fn declare(rules: &mut Rules, columns: &[bool], span: Span) {
    let column = |(position, &number): (usize, &bool)| Column {
        name: format!("c{position}"),
        ty: TypeId(u32::from(number)),
        base: if number { BaseType::Number } else { BaseType::Symbol },
    };
    rules.predicates.push(Predicate {
        name: format!("r{}", rules.predicates.len()),
        columns: columns.iter().enumerate().map(column).collect(),
        doc: String::new(),
        span,
        input: false,
        edb: None,
        output: true,
        printsize: false,
        inline: false,
        magic: false,
        parameters: 0,
        choices: Vec::new(),
        subsumption: None,
        numbering: None,
        size_limit: None,
        derived: false,
        hidden: false,
        directives: Vec::new(),
    });
}

fn constant(base: BaseType, gene: u8) -> Value {
    match base {
        BaseType::Symbol => Value(u32::from(gene) % TEXTS.len() as u32),
        _ => Value::number(NUMBERS[gene as usize % NUMBERS.len()]),
    }
}

fn variable(base: BaseType, gene: u8) -> usize {
    2 * (gene as usize % (VARIABLES / 2)) + usize::from(base == BaseType::Number)
}

/// Mostly a variable, sometimes a constant or a wildcard.
fn term(base: BaseType, gene: u8) -> Term {
    match gene / 8 {
        0..24 => Term::Variable(VarId(variable(base, gene) as u32)),
        24..28 => Term::Constant(constant(base, gene)),
        _ => Term::Wildcard,
    }
}

/// The term if it is bound, else a bound variable of that base, else a constant.
fn bound_term(base: BaseType, gene: u8, bound: &[bool; VARIABLES + FLOATS.len()]) -> Term {
    match term(base, gene) {
        Term::Variable(variable) if bound[variable.index()] => Term::Variable(variable),
        Term::Variable(_) => (0..=u8::MAX)
            .map(|other| variable(base, other.wrapping_add(gene)))
            .take(VARIABLES)
            .find(|&variable| bound[variable])
            .map_or(Term::Constant(constant(base, gene)), |variable| {
                Term::Variable(VarId(variable as u32))
            }),
        Term::Constant(value) => Term::Constant(value),
        Term::Wildcard => Term::Constant(constant(base, gene)),
    }
}

/// Mostly a bound variable if there is one, else a constant.
fn float_term(gene: u8, bound: &[bool; VARIABLES + FLOATS.len()]) -> Term {
    let variable = FLOATS[gene as usize % 2];
    match bound[variable] && gene % 8 != 7 {
        true => Term::Variable(VarId(variable as u32)),
        false => Term::Constant(Value::float(FLOAT_CONSTANTS[gene as usize % FLOAT_CONSTANTS.len()])),
    }
}

/// A clause whose head is a predicate from `first` on. Earlier predicates may be negated.
fn clause(gene: &ClauseGene, rules: &Rules, first: usize, span: Span) -> Clause {
    let mut bound = [false; VARIABLES + FLOATS.len()];
    let atom = |predicate: usize, terms: Vec<Term>| Atom {
        predicate: id(predicate),
        terms,
        span,
    };
    let columns = |predicate: usize| rules.predicates[predicate].columns.iter();
    let positive = |gene: &LiteralGene| {
        let predicate = gene.predicate as usize % rules.predicates.len();
        atom(
            predicate,
            columns(predicate)
                .zip(gene.terms)
                .map(|(column, gene)| term(column.base, gene))
                .collect(),
        )
    };
    // Positive atoms bind first, wherever they occur.
    for literal in gene.body.iter().filter(|literal| literal.kind < 150) {
        for term in positive(literal).terms {
            if let Term::Variable(variable) = term {
                bound[variable.index()] = true;
            }
        }
    }
    let mut body = Vec::new();
    for literal in &gene.body {
        let base = if literal.terms[2] % 2 == 0 {
            BaseType::Symbol
        } else {
            BaseType::Number
        };
        body.push(match literal.kind {
            0..130 => Literal::Positive(positive(literal)),
            130..150 => Literal::Guard(positive(literal)),
            150..190 => {
                let predicate = literal.predicate as usize % first;
                let term = |(column, gene): (&Column, u8)| match term(column.base, gene) {
                    Term::Wildcard => Term::Wildcard,
                    _ => bound_term(column.base, gene, &bound),
                };
                Literal::Negative(atom(
                    predicate,
                    columns(predicate).zip(literal.terms).map(term).collect(),
                ))
            }
            190..225 => {
                // An equality that may bind its left-hand side.
                let right = bound_term(base, literal.terms[1], &bound);
                let left = variable(base, literal.terms[0]);
                bound[left] = true;
                let left = Term::Variable(VarId(left as u32));
                let swap = literal.terms[3] % 2 == 0;
                let (left, right) = if swap { (right, left) } else { (left, right) };
                let op = Comparison::Equal;
                Literal::Compare {
                    op,
                    left,
                    right,
                    base,
                    span,
                }
            }
            225..233 if literal.predicate % 2 == 1 => {
                // A float from a number or from floats, or a test of one.
                let float = |gene: u8| float_term(gene, &bound);
                let to = Term::Variable(VarId(FLOATS[literal.terms[3] as usize % 2] as u32));
                use Functor::*;
                let (functor, base, arguments) = match literal.terms[4] % 6 {
                    0 | 1 => (
                        ToFloat,
                        BaseType::Number,
                        vec![bound_term(BaseType::Number, literal.terms[0], &bound)],
                    ),
                    2 => (Negate, BaseType::Float, vec![float(literal.terms[0])]),
                    kind => (
                        [Divide, Multiply, Power][kind as usize % 3],
                        BaseType::Float,
                        vec![float(literal.terms[0]), float(literal.terms[1])],
                    ),
                };
                bound[FLOATS[literal.terms[3] as usize % 2]] = true;
                Literal::Compute {
                    to,
                    functor,
                    base,
                    arguments,
                    span,
                }
            }
            225..233 => {
                // An expression that may bind its result. It has few values, so that recursion ends.
                let (functor, argument) = [
                    (Functor::Min, BaseType::Number),
                    (Functor::Max, BaseType::Symbol),
                    (Functor::And, BaseType::Number),
                    (Functor::Not, BaseType::Number),
                    (Functor::Length, BaseType::Symbol),
                    (Functor::ToNumber, BaseType::Symbol),
                ][literal.predicate as usize / 2 % 6];
                let count = if matches!(functor, Functor::Min | Functor::Max | Functor::And) {
                    2
                } else {
                    1
                };
                let arguments = (0..count)
                    .map(|at| bound_term(argument, literal.terms[at], &bound))
                    .collect();
                let result = if functor == Functor::Max {
                    BaseType::Symbol
                } else {
                    BaseType::Number
                };
                let to = variable(result, literal.terms[3]);
                bound[to] = true;
                Literal::Compute {
                    to: Term::Variable(VarId(to as u32)),
                    functor,
                    base: argument,
                    arguments,
                    span,
                }
            }
            233..241 => {
                use AggregateOp::*;
                let predicate = literal.predicate as usize % first;
                let term = |(column, gene): (&Column, u8)| match gene % 2 {
                    0 => Term::Wildcard,
                    _ => bound_term(column.base, gene, &bound),
                };
                let terms = columns(predicate).zip(literal.terms).map(term).collect();
                let op = [Count, Min, Max, Sum][literal.terms[4] as usize % 4];
                let fits = |column: &Column| column.base == BaseType::Number;
                let column = columns(predicate).position(fits);
                let op = if column.is_none() { Count } else { op };
                // A sum within a recursion would derive new values without end.
                let op = if op == Sum { Min } else { op };
                let to = variable(BaseType::Number, literal.terms[3]);
                bound[to] = true;
                Literal::Aggregate {
                    to: Term::Variable(VarId(to as u32)),
                    op,
                    base: BaseType::Number,
                    atom: atom(predicate, terms),
                    column: column.filter(|_| op != Count),
                }
            }
            241.. => {
                use Comparison::*;
                let op = [NotEqual, Less, LessEqual, Greater, GreaterEqual, Equal][literal.terms[3] as usize % 6];
                if literal.terms[4] % 2 == 1 && FLOATS.iter().any(|&float| bound[float]) {
                    body.push(Literal::Compare {
                        op,
                        left: float_term(literal.terms[0], &bound),
                        right: float_term(literal.terms[1], &bound),
                        base: BaseType::Float,
                        span,
                    });
                    continue;
                }
                Literal::Compare {
                    op,
                    left: bound_term(base, literal.terms[0], &bound),
                    right: bound_term(base, literal.terms[1], &bound),
                    base,
                    span,
                }
            }
        });
    }
    let predicate = first + gene.predicate as usize % (rules.predicates.len() - first);
    let terms = columns(predicate)
        .zip(gene.head)
        .map(|(column, gene)| bound_term(column.base, gene, &bound))
        .collect();
    // Variables without an occurrence would be unbound.
    Clause {
        head: atom(predicate, terms),
        body,
        variables: (0..VARIABLES + FLOATS.len())
            .map(|variable| format!("v{variable}"))
            .collect(),
        variable_spans: vec![span; VARIABLES + FLOATS.len()],
        doc: String::new(),
        span,
    }
}
