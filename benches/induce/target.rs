//! Rule sets to learn: those of the city and random ones, with an exact comparison.

use logicity::induce::{ActionRules, Atom, Body, Constraints, Literal, Predicate, State, Vocabulary};
use logicity::rng::{Rng, RngExt};
use std::fs;
use std::ops::RangeInclusive;
use std::path::Path;

/// The actions, the one with the highest precedence first.
pub const ACTIONS: [&str; 4] = ["Stop", "Slow", "Fast", "Normal"];

/// The predicates that cars of the hard and expert modes observe. Those of easy are the first 9, those of medium the
/// first 12.
const PREDICATES: [&str; 17] = [
    "IsPedestrian",
    "IsCar",
    "IsAmbulance",
    "IsOld",
    "IsTiro",
    "IsAtInter",
    "IsInInter",
    "HigherPri",
    "CollidingClose",
    "IsBus",
    "NextTo",
    "RightOf",
    "IsPolice",
    "IsReckless",
    "IsYoung",
    "IsClose",
    "LeftOf",
];

/// A clause: the position of its action, and its body.
pub type Clause = (usize, Body);

/// The predicates and constraints of a task.
#[derive(Clone)]
pub struct Task {
    pub vocabulary: Vocabulary,
    pub constraints: Constraints,
}

/// Reads a rule file and those that it includes, without comments.
fn read(path: &Path) -> String {
    let text = fs::read_to_string(path).expect("the file can be read");
    let mut whole = String::new();
    for line in text.lines() {
        let line = line.split("//").next().unwrap_or_default().trim();
        match line.strip_prefix(".include ") {
            Some(name) => whole += &read(&path.with_file_name(name.trim_matches('"'))),
            None => whole += &format!("{line}\n"),
        }
    }
    whole
}

/// Returns the task and the clauses of a mode of the city. `root` is the folder of the repository.
pub fn city(root: &Path, mode: &str) -> (Task, Vec<Clause>) {
    let names = match mode {
        "easy" => &PREDICATES[..9],
        "medium" => &PREDICATES[..12],
        _ => &PREDICATES[..],
    };
    city_over(root, mode, names)
}

/// Variant of [`city`] with the predicates in another order. Those of the clauses must be among them.
pub fn city_over(root: &Path, mode: &str, names: &[&str]) -> (Task, Vec<Clause>) {
    let text = read(&root.join(format!("rules/{mode}.dl")));
    let lines_of = |kind: &str| -> Vec<Vec<usize>> {
        let lines = text
            .lines()
            .filter_map(|line| line.strip_prefix(kind)?.strip_prefix(' '));
        let known = |name: &str| names.iter().position(|known| *known == name.trim());
        lines.map(|line| line.split(',').filter_map(known).collect()).collect()
    };
    let symmetric = lines_of(".symmetric").concat();
    let arity = |name: &str| {
        let line = text.lines().find(|line| line.starts_with(&format!(".decl {name}(")));
        line.expect("the predicate is declared").matches(':').count()
    };
    let predicates = names.iter().enumerate().map(|(index, name)| Predicate {
        name: (*name).to_owned(),
        arity: arity(name),
        is_symmetric: symmetric.contains(&index),
    });
    let vocabulary = Vocabulary::new(predicates.collect(), 1, Some("Sees".to_owned()));
    let constraints = Constraints {
        implies: (lines_of(".implies").iter())
            .filter(|pair| pair.len() == 2)
            .map(|pair| (pair[0], pair[1]))
            .collect(),
        disjoint: lines_of(".disjoint"),
        covering: lines_of(".covering"),
        symmetric,
        asymmetric: lines_of(".asymmetric").concat(),
        irreflexive: lines_of(".irreflexive").concat(),
        reflexive: lines_of(".reflexive").concat(),
    };
    let one_line = text
        .lines()
        .filter(|line| !line.starts_with('.'))
        .collect::<Vec<_>>()
        .join(" ");
    let clauses = one_line.split_terminator('.').filter_map(|clause| {
        let (head, body) = clause.split_once(":-")?;
        let action = ACTIONS.iter().position(|action| head.trim().starts_with(action))?;
        let literals = body
            .split_inclusive(')')
            .map(|literal| literal.trim_start_matches([',', ' ', ')']));
        let literals = literals.filter(|literal| literal.contains('(')).filter_map(|literal| {
            let (is_negated, atom) = match literal.strip_prefix("Not(") {
                Some(atom) => (true, atom),
                None => (false, literal),
            };
            let (name, arguments) = atom.trim_end_matches(')').split_once('(')?;
            let predicate = names.iter().position(|known| *known == name)?;
            let variables = arguments.split(',').map(|variable| match variable.trim() {
                "X" => 0,
                "Y" => 1,
                _ => 2,
            });
            Some(Literal {
                is_negated,
                atom: Atom {
                    predicate,
                    arguments: variables.collect(),
                },
            })
        });
        (action + 1 < ACTIONS.len()).then(|| (action, Body::normalized(literals.collect(), &vocabulary)))
    });
    let clauses = clauses.collect();
    (
        Task {
            vocabulary,
            constraints,
        },
        clauses,
    )
}

/// Returns the clauses of learned rules.
pub fn clauses_of(rules: &[ActionRules]) -> Vec<Clause> {
    (rules.iter())
        .enumerate()
        .flat_map(|(action, of)| of.clauses.iter().map(move |clause| (action, clause.body.clone())))
        .collect()
}

/// Returns the action that clauses take in a state: the slow, obvious evaluation.
pub fn action(vocabulary: &Vocabulary, clauses: &[Clause], state: &State) -> usize {
    let holds = |body: &Body| {
        let is_true = |literal: &Literal, assignment: &[usize]| {
            state.holds(vocabulary, literal.atom.predicate, &entities_of(literal, assignment)) != literal.is_negated
        };
        assignments(body.variables(vocabulary), state.entities())
            .iter()
            .any(|assignment| body.0.iter().all(|literal| is_true(literal, assignment)))
    };
    let taken = clauses
        .iter()
        .filter(|(_, body)| holds(body))
        .map(|(action, _)| *action);
    taken.min().unwrap_or(ACTIONS.len() - 1)
}

/// Returns the entities of the arguments of a literal.
fn entities_of(literal: &Literal, assignment: &[usize]) -> Vec<usize> {
    let arguments = literal.atom.arguments.iter();
    arguments.map(|&variable| assignment[variable as usize]).collect()
}

/// Returns all assignments of entities to variables. The first variable has the first entity.
fn assignments(variables: usize, entities: usize) -> Vec<Vec<usize>> {
    let mut all = vec![vec![0]];
    for _ in 1..variables {
        all = (all.iter())
            .flat_map(|some| (0..entities).map(move |entity| [some.as_slice(), &[entity]].concat()))
            .collect();
    }
    all
}

/// Draws a state that satisfies the constraints.
pub fn random_state(task: &Task, entities: usize, random: &mut impl Rng) -> State {
    let Task {
        vocabulary,
        constraints,
    } = task;
    let mut state = State::new(vocabulary, entities);
    constraints.close(vocabulary, &mut state);
    let without_covering = Constraints {
        covering: Vec::new(),
        ..constraints.clone()
    };
    let add = |state: &mut State, predicate: usize, arguments: &[usize]| {
        let mut larger = state.clone();
        larger.insert(vocabulary, predicate, arguments);
        constraints.close(vocabulary, &mut larger);
        if without_covering.violated(vocabulary, &larger).is_none() {
            *state = larger;
        }
    };
    for entity in 0..entities {
        for covering in &constraints.covering {
            add(&mut state, covering[random.random_range(0..covering.len())], &[entity]);
        }
    }
    let density = 0.05 + 0.4 * random.random::<f64>();
    let mut facts: Vec<(usize, Vec<usize>)> = Vec::new();
    for (index, predicate) in vocabulary.predicates().iter().enumerate() {
        for first in 0..entities {
            match predicate.arity {
                1 => facts.push((index, vec![first])),
                _ => facts.extend((0..entities).map(|second| (index, vec![first, second]))),
            }
        }
    }
    for at in (1..facts.len()).rev() {
        facts.swap(at, random.random_range(0..=at));
    }
    for (predicate, arguments) in facts {
        if random.random_bool(density) {
            add(&mut state, predicate, &arguments);
        }
    }
    state
}

/// Clauses that are drawn for a rule set before fewer are enough.
const ATTEMPTS: usize = 1000;

/// Draws a rule set with numbers of clauses, and of literals of each, over up to 3 variables. Each clause decides some
/// state.
pub fn random_rules(
    task: &Task,
    clauses: RangeInclusive<usize>,
    literals: RangeInclusive<usize>,
    random: &mut impl Rng,
) -> Vec<Clause> {
    let sizes = literals;
    let atoms: Vec<Vec<Atom>> = (1..=3).map(|variables| task.vocabulary.atoms(variables)).collect();
    let count = random.random_range(clauses);
    let mut clauses: Vec<Clause> = Vec::new();
    for _ in 0..ATTEMPTS {
        if clauses.len() == count {
            break;
        }
        let variables = random.random_range(1..=3);
        let atoms = &atoms[variables - 1];
        let mut literals: Vec<Literal> = Vec::new();
        for _ in 0..random.random_range(sizes.clone()) {
            let atom = atoms[random.random_range(0..atoms.len())].clone();
            if literals.iter().all(|literal| literal.atom != atom) {
                literals.push(Literal {
                    is_negated: random.random_bool(0.3),
                    atom,
                });
            }
        }
        let clause = (
            random.random_range(0..ACTIONS.len() - 1),
            Body::normalized(literals, &task.vocabulary),
        );
        // A clause that never decides anything cannot be learned.
        if decides(task, &clause, &clauses).is_some() {
            clauses.push(clause);
        }
    }
    clauses
}

/// Returns a state in which two rule sets take different actions. Exact: the smallest such state has no entities but
/// those of one clause, since a clause that holds in a state holds in each larger one.
pub fn difference(task: &Task, one: &[Clause], other: &[Clause]) -> Option<State> {
    let decided = |from: &[Clause], by: &[Clause]| from.iter().find_map(|clause| decides(task, clause, by));
    decided(one, other).or_else(|| decided(other, one))
}

/// Returns a state in which a clause holds, and none of the others with its action or one of higher precedence.
fn decides(task: &Task, (action, body): &Clause, others: &[Clause]) -> Option<State> {
    let vocabulary = &task.vocabulary;
    let variables = body.variables(vocabulary);
    (1..=variables).find_map(|entities| {
        let mut formula = Formula::new(task, entities);
        for (other, body) in others.iter().filter(|(other, _)| other <= action) {
            debug_assert!(other <= action);
            for assignment in assignments(body.variables(vocabulary), entities) {
                let literals = formula.literals(vocabulary, body, &assignment);
                formula.clauses.push(literals.iter().map(|literal| -literal).collect());
            }
        }
        assignments(variables, entities).into_iter().find_map(|assignment| {
            let is_onto = (0..entities).all(|entity| assignment.contains(&entity));
            let mut values = vec![0; vocabulary.facts(entities) + 1];
            let mut open = formula.literals(vocabulary, body, &assignment);
            let is_found =
                is_onto && open.drain(..).all(|literal| set(&mut values, literal)) && formula.solve(&mut values);
            is_found.then(|| formula.state(vocabulary, &values))
        })
    })
}

/// Makes a literal true. Returns false if it is already false.
fn set(values: &mut [i8], literal: i32) -> bool {
    let sign = literal.signum() as i8;
    let value = &mut values[literal.unsigned_abs() as usize];
    let agrees = *value != -sign;
    *value = sign;
    agrees
}

/// A conjunction of clauses over the facts about some entities. Fact `n` is variable `n + 1`.
struct Formula {
    entities: usize,
    clauses: Vec<Vec<i32>>,
}

impl Formula {
    fn new(task: &Task, entities: usize) -> Formula {
        let Task {
            vocabulary,
            constraints,
        } = task;
        let mut clauses: Vec<Vec<i32>> = Vec::new();
        let variable =
            |predicate: usize, arguments: &[usize]| vocabulary.fact(entities, predicate, arguments) as i32 + 1;
        let tuples = |predicate: usize| -> Vec<Vec<usize>> {
            match vocabulary.predicates()[predicate].arity {
                1 => (0..entities).map(|entity| vec![entity]).collect(),
                _ => (0..entities)
                    .flat_map(|one| (0..entities).map(move |other| vec![one, other]))
                    .collect(),
            }
        };
        for &(premise, conclusion) in &constraints.implies {
            for tuple in tuples(premise) {
                clauses.push(vec![-variable(premise, &tuple), variable(conclusion, &tuple)]);
            }
        }
        for predicates in &constraints.disjoint {
            for (at, &one) in predicates.iter().enumerate() {
                for &other in &predicates[..at] {
                    for tuple in tuples(one) {
                        clauses.push(vec![-variable(one, &tuple), -variable(other, &tuple)]);
                    }
                }
            }
        }
        for predicates in &constraints.covering {
            for entity in 0..entities {
                clauses.push(
                    predicates
                        .iter()
                        .map(|&predicate| variable(predicate, &[entity]))
                        .collect(),
                );
            }
        }
        for (predicates, is_symmetric) in [(&constraints.symmetric, true), (&constraints.asymmetric, false)] {
            for &predicate in predicates {
                for tuple in tuples(predicate) {
                    let mirrored = variable(predicate, &[tuple[1], tuple[0]]);
                    clauses.push(vec![
                        -variable(predicate, &tuple),
                        if is_symmetric { mirrored } else { -mirrored },
                    ]);
                }
            }
        }
        for entity in 0..entities {
            clauses.extend(
                constraints
                    .irreflexive
                    .iter()
                    .map(|&predicate| vec![-variable(predicate, &[entity, entity])]),
            );
            clauses.extend(
                constraints
                    .reflexive
                    .iter()
                    .map(|&predicate| vec![variable(predicate, &[entity, entity])]),
            );
        }
        Formula { entities, clauses }
    }

    fn literals(&self, vocabulary: &Vocabulary, body: &Body, assignment: &[usize]) -> Vec<i32> {
        (body.0.iter())
            .map(|literal| {
                let arguments = entities_of(literal, assignment);
                let variable = vocabulary.fact(self.entities, literal.atom.predicate, &arguments) as i32 + 1;
                if literal.is_negated { -variable } else { variable }
            })
            .collect()
    }

    /// Completes values so that all clauses are true: unit propagation and branching.
    fn solve(&self, values: &mut Vec<i8>) -> bool {
        loop {
            let (mut branch, mut changed): (Option<i32>, bool) = (None, false);
            for clause in &self.clauses {
                let value = |literal: &i32| values[literal.unsigned_abs() as usize] * literal.signum() as i8;
                if clause.iter().any(|literal| value(literal) == 1) {
                    continue;
                }
                let mut open = clause.iter().filter(|literal| value(literal) == 0);
                match (open.next(), open.next()) {
                    (None, _) => return false,
                    (Some(&only), None) => {
                        set(values, only);
                        changed = true;
                    }
                    (Some(&first), Some(_)) => branch = branch.or(Some(first)),
                }
            }
            if changed {
                continue;
            }
            let Some(literal) = branch else { return true };
            let mut copy = values.clone();
            set(&mut copy, literal);
            if self.solve(&mut copy) {
                *values = copy;
                return true;
            }
            set(values, -literal);
        }
    }

    fn state(&self, vocabulary: &Vocabulary, values: &[i8]) -> State {
        let mut state = State::new(vocabulary, self.entities);
        for (index, predicate) in vocabulary.predicates().iter().enumerate() {
            for one in 0..self.entities {
                for other in 0..self.entities {
                    let arguments = &[one, other][..predicate.arity];
                    if values[vocabulary.fact(self.entities, index, arguments) + 1] == 1 {
                        state.insert(vocabulary, index, arguments);
                    }
                }
            }
        }
        state
    }
}
