//! Which actions can be derived together, with a scene that shows it.
//!
//! For every pair of clauses of two actions the literals of both are put into one scene: every way to let their variables stand for
//! the same or for different entities, smallest first, with nothing but the facts that the two clauses ask for. The engine decides whether
//! both actions follow. Positive literals over derived predicates are unfolded to what they rest on, and where a clause negates a
//! derived predicate, what keeps that from holding may be added once. Clauses with expressions,
//! aggregates, `match` or `contains`, and with values other than symbols, are left out. What is found is true; what is not found may exist
//! all the same.

use crate::city::Action;
use crate::datalog::{Atom, BaseType, Clause, ClauseId, Comparison, Literal, RelId, Relation, Rules, Term, Value};
use crate::datalog::{Limits, Program, Session};
use crate::symbol::Symbol;
use serde_json::{Map, json};
use std::collections::{BTreeMap, BTreeSet, VecDeque};

/// The most entities of a scene.
pub const ENTITIES_MAX: usize = 4;
/// The most scenes that are tried for a pair of actions.
pub const SCENES_MAX: usize = 2_000;
/// The most literals that are looked at to put up the scenes of a pair of actions, and the most ways to unfold one pair of clauses.
const STEPS_MAX: usize = 300_000;
/// The most pairs of clauses that are looked at for a pair of actions.
const PAIRS_MAX: usize = 2_000;
const UNFOLDINGS_MAX: usize = 100;
/// How many times derived predicates are unfolded in one scene.
const UNFOLD_MAX: usize = 12;
/// How many rows a scene may derive.
const ROWS_MAX: usize = 100_000;

/// What is known of two actions that both have clauses.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Overlap {
    /// The actions.
    pub actions: [Action; 2],
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
        /// The first clause of each that derives it there, in the order of the actions.
        clauses: [ClauseId; 2],
        /// A scene in which both hold.
        scene: Example,
    },
    /// No scene was found.
    NotFound {
        /// How many were tried.
        scenes: usize,
        /// Why these are not all of up to [`ENTITIES_MAX`] entities; empty if they are.
        cut: BTreeSet<Cut>,
    },
}

/// What keeps the search from trying all scenes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Cut {
    /// There are more pairs of clauses, ways to put scenes up, or scenes than are looked at.
    Many,
    /// Derived predicates rest on each other more deeply, or in more ways, than they are unfolded.
    Deep,
    /// A clause asks for more than facts about entities: expressions, aggregates, numbers, comparisons of texts.
    Beyond,
    /// A clause asks for facts with numbers, or of a predicate that is neither input nor derived.
    NotEntities,
    /// Clauses name more constants than there are entities besides the agent.
    Constants,
}

impl Cut {
    /// The reason, to go after "since".
    pub fn reason(self) -> String {
        match self {
            Cut::Many => format!("there are more than {SCENES_MAX} scenes, or too many ways to put them up"),
            Cut::Deep => "derived predicates rest on each other in too many ways".to_owned(),
            Cut::Beyond => {
                "clauses have expressions, aggregates, numbers or comparisons of texts, and scenes are put up for their other literals"
                    .to_owned()
            }
            Cut::NotEntities => "clauses ask for facts with numbers, or of predicates that are no `.input`".to_owned(),
            Cut::Constants => "clauses name more constants than there is room for beside the agent".to_owned(),
        }
    }
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

/// What is known of every pair of actions of which both have clauses, in the order of [`Action::ALL`].
pub fn conflicts(program: &Program) -> Vec<Overlap> {
    let rules = program.rules();
    let action = |speed: Action| {
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
    for (at, first) in Action::ALL.into_iter().enumerate() {
        for second in Action::ALL.into_iter().skip(at + 1) {
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
    /// Negated derived atoms.
    blocked: Vec<(RelId, Vec<Place>)>,
    equal: Vec<(Place, Place)>,
    /// Asks for more than facts of entities can be put up for: expressions, aggregates, parts of names. Scenes of the rest are tried.
    beyond: bool,
    /// What aggregates look at: scenes are tried with such rows and without.
    counted: Vec<(RelId, Vec<Place>)>,
    unfolded: usize,
}

struct Search<'p> {
    rules: &'p Rules,
    session: Session,
    /// Predicates that guard a scope.
    guards: BTreeSet<RelId>,
    /// Literals that may still be looked at.
    left: usize,
    /// What kept scenes of the pair of actions from being put up.
    cut: BTreeSet<Cut>,
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
        session.set_limits(Limits {
            rows: ROWS_MAX,
            ..Limits::default()
        });
        Search {
            rules,
            session,
            guards,
            left: 0,
            cut: BTreeSet::new(),
        }
    }

    /// Counts work; whether there may be more.
    fn step(&mut self, literals: usize) -> bool {
        self.left = self.left.saturating_sub(1 + literals);
        self.left > 0
    }

    fn pair(&mut self, one: &(RelId, Vec<ClauseId>), other: &(RelId, Vec<ClauseId>)) -> Finding {
        let mut candidates = BTreeSet::new();
        let mut excluded = true;
        self.cut.clear();
        let mut pairs: Vec<[ClauseId; 2]> = Vec::new();
        'pairs: for &a in &one.1 {
            for &b in &other.1 {
                if self.excludes(a, other.0) || self.excludes(b, one.0) {
                    continue;
                }
                excluded = false;
                if pairs.len() == PAIRS_MAX {
                    self.cut.insert(Cut::Many);
                    break 'pairs;
                }
                pairs.push([a, b]);
            }
        }
        for &pair in &pairs {
            self.left = STEPS_MAX / pairs.len();
            self.candidates(pair, &mut candidates);
        }
        if excluded {
            return Finding::Excluded;
        }
        let mut scenes = 0;
        for candidate in &candidates {
            if scenes == SCENES_MAX {
                self.cut.insert(Cut::Many);
                break;
            }
            scenes += 1;
            if let Some((clauses, scene)) = self.shows(candidate, [one.0, other.0]) {
                return Finding::Together { clauses, scene };
            }
        }
        Finding::NotFound {
            scenes,
            cut: std::mem::take(&mut self.cut),
        }
    }

    /// Whether the clause asks that the action does not hold for its own agent.
    fn excludes(&self, clause: ClauseId, action: RelId) -> bool {
        let clause = &self.rules.clauses[clause.index()];
        let same = |atom: &Atom| atom.relation == action && atom.terms == clause.head.terms;
        (clause.body.iter()).any(|literal| matches!(literal, Literal::Negative(atom) if same(atom)))
    }

    /// Puts up the scenes of a pair of clauses.
    fn candidates(&mut self, clauses: [ClauseId; 2], candidates: &mut BTreeSet<Candidate>) {
        let mut body = Body {
            variables: 1,
            ..Body::default()
        };
        for clause in clauses {
            let clause = &self.rules.clauses[clause.index()];
            body.add(clause, &[Place::Variable(0)], self.rules);
        }
        // Those with the fewest literals come first, since recursion has no end.
        let mut open = VecDeque::from(self.helped(&body));
        open.push_front(body);
        let mut closed = 0;
        while let Some(mut body) = open.pop_front() {
            if !self.step(body.positive.len()) {
                self.cut.insert(Cut::Many);
                return;
            }
            if body.beyond {
                self.cut.insert(Cut::Beyond);
            }
            if !body.counted.is_empty() {
                let counted = std::mem::take(&mut body.counted);
                let mut more = body.clone();
                more.positive.extend(counted);
                open.push_front(body);
                open.push_front(more);
                continue;
            }
            let derived = |(rel, _): &(RelId, Vec<Place>)| self.rules.relations[rel.index()].derived;
            let Some(at) = body.positive.iter().position(derived) else {
                closed += 1;
                if let Err(cut) = self.identify(&body, candidates) {
                    self.cut.insert(cut);
                }
                continue;
            };
            if body.unfolded == UNFOLD_MAX {
                self.cut.insert(Cut::Deep);
                continue;
            }
            let (rel, places) = body.positive.remove(at);
            body.unfolded += 1;
            for clause in (self.rules.clauses.iter()).filter(|clause| clause.head.relation == rel) {
                if open.len() + closed >= UNFOLDINGS_MAX {
                    self.cut.insert(Cut::Deep);
                    break;
                }
                let mut unfolded = body.clone();
                unfolded.add(clause, &places, self.rules);
                open.push_back(unfolded);
            }
        }
    }

    /// The body with one atom more, which keeps a clause of what it negates from holding: of `A :- Not(B)` and `B :- Not(C)`, with `C`.
    fn helped(&self, body: &Body) -> Vec<Body> {
        let mut helped = Vec::new();
        for (rel, places) in &body.blocked {
            for clause in self.rules.clauses.iter().filter(|clause| clause.head.relation == *rel) {
                let mut probe = Body {
                    variables: body.variables,
                    ..Body::default()
                };
                probe.add(clause, places, self.rules);
                for atom in probe.blocked {
                    if helped.len() == UNFOLDINGS_MAX / 2 {
                        return helped;
                    }
                    let mut more = body.clone();
                    more.variables = probe.variables;
                    more.equal.extend(&probe.equal);
                    more.positive.push(atom);
                    helped.push(more);
                }
            }
        }
        helped
    }

    /// Lets the variables of a body stand for entities, in every way, unless something keeps it from that.
    fn identify(&mut self, body: &Body, candidates: &mut BTreeSet<Candidate>) -> Result<(), Cut> {
        let Some(classes) = body.classes() else { return Ok(()) };
        let relations = || body.positive.iter().map(|(rel, _)| &self.rules.relations[rel.index()]);
        let numbers = |relation: &Relation| relation.columns.iter().any(|column| column.base != BaseType::Symbol);
        // Scenes have entities only, and facts of what is input only.
        if relations().any(|relation| numbers(relation) || !relation.input) {
            return Err(Cut::NotEntities);
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
            return Err(Cut::Constants);
        }
        // Each free class stands for an entity that is there already, or for the next new one.
        let mut choice = vec![0; free.len()];
        loop {
            if !self.step(body.positive.len() + body.negative.len()) {
                return Err(Cut::Many);
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
            if let Some(candidate) = self.candidate(body, &constants, &choice, entity) {
                candidates.insert(candidate);
            }
            // The next choice in which no number is skipped.
            let mut at = choice.len();
            loop {
                if at == 0 {
                    return Ok(());
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
            constants,
        })
    }

    /// The candidate as a scene, if both actions follow in it for the first entity.
    fn shows(&mut self, candidate: &Candidate, actions: [RelId; 2]) -> Option<([ClauseId; 2], Example)> {
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
            if !self.follow(&names, &facts, actions) {
                continue;
            }
            // Other clauses may hold than those it was put up for, with fewer facts.
            let own: Vec<_> = facts
                .iter()
                .filter(|(rel, _)| !self.guards.contains(rel))
                .cloned()
                .collect();
            for fact in own {
                facts.remove(&fact);
                if !self.follow(&names, &facts, actions) {
                    facts.insert(fact);
                }
            }
            let clauses = self.firing(&names, &facts, actions)?;
            let taken_for_granted = |rel: &RelId| full && self.rules.relations[rel.index()].name == "Sees";
            let mut rows: BTreeMap<String, Vec<Vec<usize>>> = BTreeMap::new();
            for (rel, row) in facts.into_iter().filter(|(rel, _)| !taken_for_granted(rel)) {
                let name = self.rules.relations[rel.index()].name.clone();
                rows.entry(name).or_default().push(row);
            }
            let scene = Example {
                entities: names,
                facts: rows,
            };
            return Some((clauses, scene));
        }
        None
    }

    /// The first clause of each action that derives it for the first entity.
    fn firing(
        &mut self,
        names: &[String],
        facts: &BTreeSet<(RelId, Vec<usize>)>,
        actions: [RelId; 2],
    ) -> Option<[ClauseId; 2]> {
        let rules = self.rules;
        let ego = self.session.intern(names.first()?);
        self.with(names, facts, |session| {
            let first = |action: RelId| {
                let mut clauses = rules
                    .clauses
                    .iter()
                    .zip(0..)
                    .filter(|(clause, _)| clause.head.relation == action);
                let fires = |id| session.fired(ClauseId(id)).iter().any(|row| row[..] == [ego]);
                clauses.find_map(|(_, id)| fires(id).then_some(ClauseId(id)))
            };
            Some([first(actions[0])?, first(actions[1])?])
        })?
    }

    /// Whether both actions follow from the facts for the first entity.
    fn follow(&mut self, names: &[String], facts: &BTreeSet<(RelId, Vec<usize>)>, actions: [RelId; 2]) -> bool {
        let Some(ego) = names.first().map(|name| self.session.intern(name)) else {
            return false;
        };
        let both = self.with(names, facts, |session| {
            actions.iter().all(|action| session.contains(*action, &[ego]))
        });
        both.unwrap_or(false)
    }

    /// Asks a session that holds the facts; `None` if it cannot hold them.
    fn with<T>(
        &mut self,
        names: &[String],
        facts: &BTreeSet<(RelId, Vec<usize>)>,
        ask: impl FnOnce(&Session) -> T,
    ) -> Option<T> {
        let values: Vec<Value> = names.iter().map(|name| self.session.intern(name)).collect();
        let rows: Vec<(RelId, Vec<Value>)> = (facts.iter())
            .map(|(rel, row)| (*rel, row.iter().map(|&entity| values[entity]).collect()))
            .collect();
        let inserted = rows.iter().all(|(rel, row)| self.session.insert(*rel, row).is_ok());
        if !inserted || self.session.commit().is_err() {
            self.session.rollback();
            return None;
        }
        let answer = ask(&self.session);
        for (rel, row) in &rows {
            // What could be inserted can be taken back.
            let _ = self.session.retract(*rel, row);
        }
        let _ = self.session.commit();
        Some(answer)
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
                Literal::Positive(atom) | Literal::Guard(atom) | Literal::Aggregate { atom, .. } => {
                    let mut places = Vec::with_capacity(atom.terms.len());
                    for term in &atom.terms {
                        places.push(known(term).unwrap_or_else(|| {
                            self.variables += 1;
                            Place::Variable(self.variables - 1)
                        }));
                    }
                    match literal {
                        Literal::Aggregate { .. } => {
                            self.beyond = true;
                            self.counted.push((atom.relation, places));
                        }
                        _ => self.positive.push((atom.relation, places)),
                    }
                }
                Literal::Negative(atom) if !rules.relations[atom.relation.index()].derived => {
                    let places: Option<Vec<Place>> = atom.terms.iter().map(known).collect();
                    self.negative.extend(places.map(|places| (atom.relation, places)));
                }
                Literal::Compare {
                    op: Comparison::Equal,
                    left,
                    right,
                    base: BaseType::Symbol,
                    ..
                } => self.equal.extend(known(left).zip(known(right))),
                Literal::Negative(atom) => {
                    let places: Option<Vec<Place>> = atom.terms.iter().map(known).collect();
                    self.blocked.extend(places.map(|places| (atom.relation, places)));
                }
                Literal::Compare {
                    op: Comparison::Match | Comparison::NotMatch | Comparison::Contains | Comparison::NotContains,
                    ..
                }
                | Literal::Compute { .. } => self.beyond = true,
                Literal::Compare { base, .. } => self.beyond |= *base != BaseType::Symbol,
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
}
