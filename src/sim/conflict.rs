//! Which actions can be derived together, with a scene that shows it.
//!
//! For every pair of clauses of two actions the literals of both are put into one scene: every way to let their variables stand for
//! the same or for different entities, smallest first, with nothing but the facts that the two clauses ask for. The engine decides whether
//! both actions follow. Positive literals over derived predicates are unfolded to what they rest on.

use crate::config::Speed;
use crate::engine::{Program, Session};
use crate::lang::{Atom, BaseType, Clause, ClauseId, Comparison, Literal, RelId, Rules, Term, Value};
use crate::symbol::Symbol;
use serde_json::{Map, json};
use std::collections::{BTreeMap, BTreeSet};

/// The most entities of a scene.
pub const ENTITIES_MAX: usize = 4;
/// The most scenes that are tried for a pair of actions.
pub const SCENES_MAX: usize = 5_000;
/// The most scenes that are put up for a pair of actions, and the most ways to unfold one pair of clauses.
const CANDIDATES_MAX: usize = 50_000;
const UNFOLDINGS_MAX: usize = 100;
/// How many times derived predicates are unfolded in one scene.
const UNFOLD_MAX: usize = 12;
/// How many rows a scene may derive.
const ROWS_MAX: usize = 100_000;

/// What is known of two actions that both have clauses.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Overlap {
    /// The actions.
    pub actions: [Speed; 2],
    /// Whether both can be derived for one agent.
    pub finding: Finding,
}

/// Whether two actions can be derived together.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Finding {
    /// No: every clause of the one asks that the other does not hold.
    Excluded,
    /// Yes.
    Together {
        /// A clause of each, in the order of the actions.
        clauses: [ClauseId; 2],
        /// A scene in which both hold.
        scene: Example,
    },
    /// No scene was found.
    NotFound {
        /// How many were tried.
        scenes: usize,
        /// Whether these are all of up to [`ENTITIES_MAX`] entities that this search knows of.
        all: bool,
    },
}

/// A scene of entities and facts.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Example {
    /// The entities; the first is the one to decide for.
    pub entities: Vec<String>,
    /// Facts by predicate, of entities by their positions. Without rows of `Sees` everybody sees everybody.
    pub facts: BTreeMap<String, Vec<Vec<usize>>>,
}

impl Example {
    /// The scene in the format of `logicity infer`.
    pub fn to_json(&self) -> serde_json::Value {
        let facts: Map<String, serde_json::Value> = (self.facts.iter())
            .map(|(name, rows)| {
                let rows = rows.iter().map(|row| {
                    let names: Vec<&String> = row.iter().map(|&entity| &self.entities[entity]).collect();
                    match names.as_slice() {
                        [only] => json!(only),
                        names => json!(names),
                    }
                });
                (name.clone(), rows.collect())
            })
            .collect();
        json!({ "entities": self.entities, "ego": self.entities[0], "facts": facts })
    }
}

/// What is known of every pair of actions of which both have clauses, in the order of [`Speed::ALL`].
pub fn conflicts(program: &Program) -> Vec<Overlap> {
    let rules = program.rules();
    let action = |speed: Speed| {
        let relation = program.relation(speed.name())?;
        let declared = &rules.relations[relation.index()];
        let symbols = declared.columns.iter().all(|column| column.base == BaseType::Symbol);
        let clauses: Vec<ClauseId> = (rules.clauses.iter().zip(0..))
            .filter(|(clause, _)| clause.head.relation == relation && !clause.body.is_empty())
            .map(|(_, id)| ClauseId(id))
            .collect();
        (declared.arity() == 1 && symbols && !clauses.is_empty()).then_some((relation, clauses))
    };
    let mut search = Search::new(program);
    let mut found = Vec::new();
    for (at, first) in Speed::ALL.into_iter().enumerate() {
        for second in Speed::ALL.into_iter().skip(at + 1) {
            if let (Some(one), Some(other)) = (action(first), action(second)) {
                found.push(Overlap {
                    actions: [first, second],
                    finding: search.pair(&one, &other),
                });
            }
        }
    }
    found
}

/// A scene to be tried. Ordered by how natural and how small it is.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Candidate {
    /// Facts that relate an entity to itself; guards are not counted. The predicates of the city never do.
    reflexive: usize,
    entities: usize,
    count: usize,
    facts: BTreeSet<(RelId, Vec<usize>)>,
    clauses: [ClauseId; 2],
    /// Names of the entities that are constants of the rules.
    constants: Vec<Option<Symbol>>,
}

/// An argument in a body that is being put together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Place {
    Variable(usize),
    Constant(Value),
}

/// Literals of both clauses with common variables; 0 is the agent.
#[derive(Clone, Debug, Default)]
struct Body {
    variables: usize,
    positive: Vec<(RelId, Vec<Place>)>,
    /// Negated base atoms without `_`: a scene with such a fact need not be tried.
    negative: Vec<(RelId, Vec<Place>)>,
    equal: Vec<(Place, Place)>,
    unfolded: usize,
}

struct Search<'p> {
    rules: &'p Rules,
    session: Session,
    /// Predicates that guard a scope.
    guards: BTreeSet<RelId>,
}

impl<'p> Search<'p> {
    fn new(program: &'p Program) -> Self {
        let rules = program.rules();
        let guards = (rules.clauses.iter().flat_map(|clause| &clause.body))
            .filter_map(|literal| match literal {
                Literal::Guard(atom) => Some(atom.relation),
                _ => None,
            })
            .collect();
        let mut session = program.session();
        session.set_limit(ROWS_MAX);
        Search { rules, session, guards }
    }

    fn pair(&mut self, one: &(RelId, Vec<ClauseId>), other: &(RelId, Vec<ClauseId>)) -> Finding {
        let mut candidates = BTreeSet::new();
        let mut excluded = true;
        let mut all = true;
        for &a in &one.1 {
            for &b in &other.1 {
                if self.excludes(a, other.0) || self.excludes(b, one.0) {
                    continue;
                }
                excluded = false;
                all &= self.candidates([a, b], &mut candidates);
            }
        }
        if excluded {
            return Finding::Excluded;
        }
        let mut scenes = 0;
        for candidate in &candidates {
            if scenes == SCENES_MAX {
                all = false;
                break;
            }
            scenes += 1;
            if let Some(scene) = self.shows(candidate, [one.0, other.0]) {
                return Finding::Together {
                    clauses: candidate.clauses,
                    scene,
                };
            }
        }
        Finding::NotFound { scenes, all }
    }

    /// Whether the clause asks that the action does not hold for its own agent.
    fn excludes(&self, clause: ClauseId, action: RelId) -> bool {
        let clause = &self.rules.clauses[clause.index()];
        let same = |atom: &Atom| atom.relation == action && atom.terms == clause.head.terms;
        (clause.body.iter()).any(|literal| matches!(literal, Literal::Negative(atom) if same(atom)))
    }

    /// Puts up the scenes of a pair of clauses; whether these are all.
    fn candidates(&self, clauses: [ClauseId; 2], candidates: &mut BTreeSet<Candidate>) -> bool {
        let mut body = Body {
            variables: 1,
            ..Body::default()
        };
        for clause in clauses {
            let clause = &self.rules.clauses[clause.index()];
            body.add(clause, &[Place::Variable(0)], self.rules);
        }
        let mut all = true;
        let mut open = vec![body];
        let mut closed = Vec::new();
        while let Some(body) = open.pop() {
            let derived = |(rel, _): &(RelId, Vec<Place>)| self.rules.relations[rel.index()].derived;
            let Some(at) = body.positive.iter().position(derived) else {
                closed.push(body);
                continue;
            };
            if body.unfolded == UNFOLD_MAX || open.len() + closed.len() > UNFOLDINGS_MAX {
                all = false;
                continue;
            }
            let mut rest = body;
            let (rel, places) = rest.positive.remove(at);
            rest.unfolded += 1;
            for clause in self.rules.clauses.iter().filter(|clause| clause.head.relation == rel) {
                let mut unfolded = rest.clone();
                unfolded.add(clause, &places, self.rules);
                open.push(unfolded);
            }
        }
        for body in &closed {
            all &= self.identify(body, clauses, candidates);
        }
        all
    }

    /// Lets the variables of a body stand for entities, in every way. Whether all ways were put up.
    fn identify(&self, body: &Body, clauses: [ClauseId; 2], candidates: &mut BTreeSet<Candidate>) -> bool {
        let Some(classes) = body.classes() else { return true };
        if body.speaks_of_numbers(self.rules) {
            return false;
        }
        // Constants are entities of their own; the agent is entity 0.
        let mut constants: Vec<Option<Symbol>> = Vec::new();
        let mut fixed: BTreeMap<usize, usize> = BTreeMap::new();
        let agent = classes.of[0];
        fixed.insert(agent, 0);
        constants.push(classes.constant.get(&agent).map(|value| Symbol(value.0)));
        for (class, value) in &classes.constant {
            if !fixed.contains_key(class) {
                fixed.insert(*class, constants.len());
                constants.push(Some(Symbol(value.0)));
            }
        }
        let free: BTreeSet<usize> = classes
            .of
            .iter()
            .copied()
            .filter(|class| !fixed.contains_key(class))
            .collect();
        let free: Vec<usize> = free.into_iter().collect();
        if constants.len() > ENTITIES_MAX {
            return false;
        }
        // Each free class stands for an entity that is there already, or for the next new one.
        let mut choice = vec![0; free.len()];
        loop {
            if candidates.len() >= CANDIDATES_MAX {
                return false;
            }
            let entity = |place: &Place| match place {
                Place::Variable(variable) => {
                    let class = classes.of[*variable];
                    fixed.get(&class).copied().or_else(|| {
                        let at = free.iter().position(|other| *other == class)?;
                        Some(choice[at])
                    })
                }
                Place::Constant(value) => constants.iter().position(|name| *name == Some(Symbol(value.0))),
            };
            if let Some(candidate) = self.candidate(body, clauses, &constants, &choice, entity) {
                candidates.insert(candidate);
            }
            // The next choice in which no number is skipped.
            let mut at = choice.len();
            loop {
                if at == 0 {
                    return true;
                }
                at -= 1;
                let known = choice[..at]
                    .iter()
                    .map(|entity| entity + 1)
                    .max()
                    .unwrap_or(0)
                    .max(constants.len());
                if choice[at] < known && choice[at] + 1 < ENTITIES_MAX {
                    choice[at] += 1;
                    choice[at + 1..].fill(0);
                    break;
                }
            }
        }
    }

    fn candidate(
        &self,
        body: &Body,
        clauses: [ClauseId; 2],
        constants: &[Option<Symbol>],
        choice: &[usize],
        entity: impl Fn(&Place) -> Option<usize>,
    ) -> Option<Candidate> {
        let instance = |(rel, places): &(RelId, Vec<Place>)| -> Option<(RelId, Vec<usize>)> {
            Some((*rel, places.iter().map(&entity).collect::<Option<_>>()?))
        };
        let facts: BTreeSet<(RelId, Vec<usize>)> = body.positive.iter().map(instance).collect::<Option<_>>()?;
        let refused = |atom| instance(atom).is_some_and(|fact| facts.contains(&fact));
        if body.negative.iter().any(refused) {
            return None;
        }
        let reflexive =
            |(rel, row): &&(RelId, Vec<usize>)| !self.guards.contains(rel) && row.len() == 2 && row[0] == row[1];
        let entities = choice
            .iter()
            .map(|entity| entity + 1)
            .max()
            .unwrap_or(0)
            .max(constants.len());
        let mut constants = constants.to_vec();
        constants.resize(entities, None);
        Some(Candidate {
            reflexive: facts.iter().filter(reflexive).count(),
            entities,
            count: facts.iter().filter(|(rel, _)| !self.guards.contains(rel)).count(),
            facts,
            clauses,
            constants,
        })
    }

    /// The candidate as a scene, if both actions follow in it for the first entity.
    fn shows(&mut self, candidate: &Candidate, actions: [RelId; 2]) -> Option<Example> {
        let texts: Vec<Option<&str>> = (candidate.constants.iter())
            .map(|symbol| symbol.and_then(|symbol| self.rules.symbols.text(symbol)))
            .collect();
        let mut names: Vec<String> = Vec::new();
        let mut fresh = (0..).map(|number| format!("e{number}"));
        for text in &texts {
            let name = match text {
                Some(text) => (*text).to_owned(),
                None => fresh.find(|name| !texts.contains(&Some(name.as_str())))?,
            };
            names.push(name);
        }
        // First everybody sees everybody, which scenes take for granted; else only what the clauses ask for, and oneself.
        for full in [true, false] {
            let mut facts = candidate.facts.clone();
            for &guard in &self.guards {
                for x in 0..candidate.entities {
                    let seen = (0..candidate.entities).filter(|y| full || x == *y);
                    facts.extend(seen.map(|y| (guard, vec![x, y])));
                }
            }
            if self.follow(&names, &facts, actions) {
                let taken_for_granted = |rel: &RelId| full && self.rules.relations[rel.index()].name == "Sees";
                let mut rows: BTreeMap<String, Vec<Vec<usize>>> = BTreeMap::new();
                for (rel, row) in facts.into_iter().filter(|(rel, _)| !taken_for_granted(rel)) {
                    let name = self.rules.relations[rel.index()].name.clone();
                    rows.entry(name).or_default().push(row);
                }
                return Some(Example {
                    entities: names,
                    facts: rows,
                });
            }
        }
        None
    }

    /// Whether both actions follow from the facts for the first entity.
    fn follow(&mut self, names: &[String], facts: &BTreeSet<(RelId, Vec<usize>)>, actions: [RelId; 2]) -> bool {
        let values: Vec<Value> = names.iter().map(|name| self.session.intern(name)).collect();
        let rows: Vec<(RelId, Vec<Value>)> = (facts.iter())
            .map(|(rel, row)| (*rel, row.iter().map(|&entity| values[entity]).collect()))
            .collect();
        let inserted = rows.iter().all(|(rel, row)| self.session.insert(*rel, row).is_ok());
        let mut both = false;
        if inserted && self.session.commit().is_ok() {
            both = actions
                .iter()
                .all(|action| self.session.contains(*action, &values[..1]));
            for (rel, row) in &rows {
                // What could be inserted can be taken back.
                let _ = self.session.retract(*rel, row);
            }
            let _ = self.session.commit();
        } else {
            self.session.rollback();
        }
        both
    }
}

/// Which variables stand for the same.
struct Classes {
    /// By variable.
    of: Vec<usize>,
    /// Classes that are a constant.
    constant: BTreeMap<usize, Value>,
}

impl Body {
    /// Adds the body of a clause whose head stands for `places`. Its variables are numbered anew.
    fn add(&mut self, clause: &Clause, places: &[Place], rules: &Rules) {
        let first = self.variables;
        self.variables += clause.variables.len();
        let known = |term: &Term| match *term {
            Term::Variable(variable) => Some(Place::Variable(first + variable.index())),
            Term::Constant(value) => Some(Place::Constant(value)),
            Term::Wildcard => None,
        };
        for (term, place) in clause.head.terms.iter().zip(places) {
            self.equal.extend(known(term).map(|head| (head, *place)));
        }
        for literal in &clause.body {
            match literal {
                Literal::Positive(atom) | Literal::Guard(atom) => {
                    let mut places = Vec::with_capacity(atom.terms.len());
                    for term in &atom.terms {
                        places.push(known(term).unwrap_or_else(|| {
                            self.variables += 1;
                            Place::Variable(self.variables - 1)
                        }));
                    }
                    self.positive.push((atom.relation, places));
                }
                Literal::Negative(atom) if !rules.relations[atom.relation.index()].derived => {
                    let places: Option<Vec<Place>> = atom.terms.iter().map(known).collect();
                    self.negative.extend(places.map(|places| (atom.relation, places)));
                }
                Literal::Compare {
                    op: Comparison::Equal,
                    left,
                    right,
                    ..
                } => self.equal.extend(known(left).zip(known(right))),
                Literal::Negative(_) | Literal::Compare { .. } => {}
            }
        }
    }

    /// The classes of equal variables that positive literals speak of; `None` if one would have to be two constants.
    fn classes(&self) -> Option<Classes> {
        let mut of: Vec<usize> = (0..self.variables).collect();
        let mut constant: BTreeMap<usize, Value> = BTreeMap::new();
        let mut set =
            |of: &[usize], variable: usize, value: Value| *constant.entry(of[variable]).or_insert(value) == value;
        for pair in &self.equal {
            if let (Place::Variable(a), Place::Variable(b)) = *pair {
                let (kept, gone) = (of[a].min(of[b]), of[a].max(of[b]));
                of.iter_mut()
                    .filter(|class| **class == gone)
                    .for_each(|class| *class = kept);
            }
        }
        for pair in &self.equal {
            let fits = match *pair {
                (Place::Variable(variable), Place::Constant(value))
                | (Place::Constant(value), Place::Variable(variable)) => set(&of, variable, value),
                (Place::Constant(a), Place::Constant(b)) => a == b,
                (Place::Variable(_), Place::Variable(_)) => true,
            };
            if !fits {
                return None;
            }
        }
        // A constant argument is an entity too.
        let arguments: Vec<Place> = self
            .positive
            .iter()
            .flat_map(|(_, places)| places.iter().copied())
            .collect();
        let mut used: BTreeSet<usize> = BTreeSet::from([of[0]]);
        let mut next = self.variables;
        for argument in arguments {
            match argument {
                Place::Variable(variable) => _ = used.insert(of[variable]),
                Place::Constant(value) => {
                    if !constant.values().any(|known| *known == value) {
                        constant.insert(next, value);
                        used.insert(next);
                        next += 1;
                    }
                }
            }
        }
        // What no positive literal speaks of is no entity of the scene.
        constant.retain(|class, _| used.contains(class));
        of.iter_mut()
            .filter(|class| !used.contains(class))
            .for_each(|class| *class = 0);
        if !used.contains(&0) {
            let agent = of[0];
            of.iter_mut()
                .filter(|class| **class == 0)
                .for_each(|class| *class = agent);
        }
        Some(Classes { of, constant })
    }

    /// Whether a positive literal has a column of numbers: scenes have entities only.
    fn speaks_of_numbers(&self, rules: &Rules) -> bool {
        let mut columns = (self.positive.iter()).flat_map(|(rel, _)| &rules.relations[rel.index()].columns);
        columns.any(|column| column.base == BaseType::Number)
    }
}
