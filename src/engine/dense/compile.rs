//! From rules to a list of operations on sets.

use super::analyse::Choice;
use crate::lang::{Atom, Clause, ClauseId, Comparison, Literal, RelId, Rules, Term};
use std::collections::{BTreeMap, BTreeSet};

/// A set of the frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Reg(u32);

impl Reg {
    /// All entities.
    const ALL: Reg = Reg(0);
    /// Those that are decided about.
    const EGOS: Reg = Reg(1);

    #[inline]
    pub const fn index(self) -> usize {
        self.0 as usize
    }
}

/// A piece of one of the program's lists of operands, steps or tests.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Range {
    start: u32,
    end: u32,
}

impl Range {
    /// Begins at the end of the list.
    fn begin<T>(list: &[T]) -> Range {
        let start = u32::try_from(list.len()).expect("fewer than 2^32 operands");
        Range { start, end: start }
    }

    /// The same up to the end of the list, which has grown.
    fn end<T>(self, list: &[T]) -> Range {
        Range {
            end: Range::begin(list).start,
            ..self
        }
    }

    #[inline]
    fn cut<T>(self, list: &[T]) -> &[T] {
        &list[self.start as usize..self.end as usize]
    }
}

/// `(left ^ flips) & (right ^ flips)`, flipped again or not: intersection, difference and union without a branch.
#[derive(Clone, Copy, Debug)]
pub(super) struct Combination {
    pub dst: Reg,
    pub left: Reg,
    pub right: Reg,
    /// All bits set or none.
    pub flips: [u64; 3],
}

/// Up to [`Lists::MAX`] positions in [`Dense::lists`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Lists {
    pub count: u8,
    pub lists: [u16; Lists::MAX],
}

impl Lists {
    pub const MAX: usize = 3;
}

/// One operation. `dst` is written, all else is read.
#[derive(Clone, Copy, Debug)]
pub(super) enum Op {
    /// These combinations, one after the other.
    Combine(Range),
    /// The members of `demand` to which all `lists` relate one and the same member of `among`.
    Any {
        dst: Reg,
        demand: Reg,
        among: Reg,
        lists: Lists,
    },
    /// Adds such members of both `left` and `right`; who is in `dst` is not asked about.
    AddAny {
        dst: Reg,
        left: Reg,
        right: Reg,
        among: Reg,
        lists: Lists,
    },
    /// The members of `demand` for which each step has a value.
    Exists { dst: Reg, demand: Reg, steps: Range },
    /// Adds, to the row of each member of `demand`, the values of the first step for which the others have one.
    Rows { dst: usize, demand: Reg, steps: Range },
    /// Adds all rows of `from`.
    OrRows { dst: usize, from: usize },
    /// The entities that are in their own row.
    Diagonal { dst: Reg, rows: usize },
}

/// Finds the values of one variable, those of the steps before and of the head's first variable being bound.
#[derive(Clone, Copy, Debug)]
pub(super) struct Step {
    /// Of whom all is true that is asked of it alone.
    pub among: Reg,
    /// What relates it to bound variables.
    pub tests: Range,
}

/// How a value must stand to a bound variable.
#[derive(Clone, Copy, Debug)]
pub(super) struct Test {
    pub list: Place,
    /// 0 is the head's first variable, `n` that of step `n - 1`.
    pub to: usize,
    pub holds: bool,
}

/// Where the row of the bound variable stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Place {
    /// A position in [`Dense::lists`].
    Given(usize),
    /// A list of derived rows, and the column of the value.
    Derived(usize, Axis),
    /// The variable itself.
    Same,
}

/// A column of a predicate with two.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Axis {
    /// The first.
    First,
    /// The second.
    Second,
}

/// A set that the caller provides.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Input {
    /// The entities of which a predicate with one column holds.
    Unary(RelId),
    /// The entities that a predicate with two columns relates to themselves.
    Diagonal(RelId),
}

/// Rows that the caller provides: for each value of one column of the predicate, the values of the named other one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct List(pub RelId, pub Axis);

/// What is kept of the work of single clauses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Counting {
    /// Nothing: a clause looks only where its predicate is not derived yet.
    Off,
    /// What each clause derives.
    Each,
}

/// A program for the dense executor.
#[derive(Clone, Debug)]
pub struct Dense {
    inputs: Vec<Input>,
    lists: Vec<List>,
    set_count: usize,
    row_lists: usize,
    combinations: Vec<Combination>,
    steps: Vec<Step>,
    tests: Vec<Test>,
    /// How many of `inputs` change often; the others follow.
    pub(super) restless: usize,
    /// What depends on steady inputs only.
    pub(super) settling: Vec<Combination>,
    pub(super) ops: Vec<Op>,
    /// The sets of derived predicates with one column.
    pub(super) heads: Vec<Reg>,
    /// By [`RelId`]: where it is.
    homes: Vec<Home>,
    fired: BTreeMap<ClauseId, Fired>,
    local: bool,
    guards: Vec<RelId>,
}

/// Where a predicate's facts are.
#[derive(Clone, Copy, Debug)]
enum Home {
    /// The caller has them.
    Given,
    Set(Reg),
    Rows(usize),
}

/// Where a clause's own facts are.
#[derive(Clone, Copy, Debug)]
enum Fired {
    Set(Reg),
    Rows(usize),
}

impl Dense {
    /// All entities.
    pub(super) const ALL: usize = Reg::ALL.index();
    /// Those that are decided about.
    pub(super) const EGOS: usize = Reg::EGOS.index();
    pub(super) const FIRST_INPUT: usize = 2;
    /// Variables that a search binds at a time, the head's included.
    pub(super) const VARIABLES_MAX: usize = 24;

    /// Compiles the dense strata of a choice made by [`super::choose`] for these rules. What other strata derive is input. The
    /// inputs that `steady` names seldom change: what follows from them alone is computed only when they do.
    pub fn new(rules: &Rules, choice: &Choice, counting: Counting, steady: impl Fn(RelId) -> bool) -> Dense {
        let strata = || (rules.strata.iter().enumerate()).filter(|(position, _)| choice.is_dense(*position));
        let mut derived = vec![false; rules.relations.len()];
        for relation in strata().flat_map(|(_, stratum)| &stratum.relations) {
            derived[relation.index()] = true;
        }
        let clauses = strata().flat_map(|(_, stratum)| &stratum.clauses);
        let bodies: Vec<(ClauseId, Body)> = clauses
            .filter_map(|&clause| Some((clause, Body::new(&rules.clauses[clause.index()])?)))
            .collect();

        let mut compiler = Compiler::new(rules, counting, derived);
        compiler.find_inputs(&bodies, steady);
        compiler.find_shared(&bodies);
        let mut bodies = bodies.iter().peekable();
        for (_, stratum) in strata() {
            for &relation in &stratum.relations {
                compiler.declare(relation);
            }
            while let Some((clause, body)) = bodies.next_if(|(clause, _)| stratum.clauses.contains(clause)) {
                compiler.clause(*clause, body);
            }
            compiler.complete();
        }
        compiler.out
    }

    /// The sets the caller provides, in the order of [`super::Frame::set_input`].
    pub fn inputs(&self) -> &[Input] {
        &self.inputs
    }

    /// The rows the caller provides, see [`super::Pairs`].
    pub fn lists(&self) -> &[List] {
        &self.lists
    }

    /// Whether derived predicates are asked only about the head's first variable. Then what is derived of one entity does not depend
    /// on what is derived of others, and some entities can be decided about without the rest.
    pub fn is_local(&self) -> bool {
        self.local
    }

    /// Whether every clause looks only at what the predicate relates its head's first variable to. If the program is also
    /// [local](Dense::is_local), entities that it relates to none of those that are decided about can be left out.
    pub fn is_guarded_by(&self, relation: RelId) -> bool {
        self.guards.contains(&relation)
    }

    pub(super) fn set_count(&self) -> usize {
        self.set_count
    }

    pub(super) fn row_lists(&self) -> usize {
        self.row_lists
    }

    #[inline]
    pub(super) fn combinations(&self, range: Range) -> &[Combination] {
        range.cut(&self.combinations)
    }

    #[inline]
    pub(super) fn steps(&self, range: Range) -> &[Step] {
        range.cut(&self.steps)
    }

    #[inline]
    pub(super) fn tests(&self, range: Range) -> &[Test] {
        range.cut(&self.tests)
    }

    pub(super) fn set_of(&self, relation: RelId) -> Option<Reg> {
        match self.homes.get(relation.index()) {
            Some(Home::Set(set)) => Some(*set),
            _ => None,
        }
    }

    pub(super) fn rows_of(&self, relation: RelId) -> Option<usize> {
        match self.homes.get(relation.index()) {
            Some(Home::Rows(rows)) => Some(*rows),
            _ => None,
        }
    }

    pub(super) fn fired(&self, clause: ClauseId) -> Option<Reg> {
        match self.fired.get(&clause) {
            Some(Fired::Set(set)) => Some(*set),
            _ => None,
        }
    }

    pub(super) fn fired_rows(&self, clause: ClauseId) -> Option<usize> {
        match self.fired.get(&clause) {
            Some(Fired::Rows(rows)) => Some(*rows),
            _ => None,
        }
    }
}

/// A variable of a body: 0 is the head's first.
type Var = usize;

/// What can be said of one variable.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Property {
    Holds(RelId),
    Diagonal(RelId),
    /// The predicate relates something to it; it is in this column.
    Related(RelId, Axis),
}

/// A literal over variables.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Lit {
    Is(Property, Var, bool),
    Pair(RelId, Var, Var, bool),
    Same(Var, Var, bool),
}

/// A body over numbered variables.
struct Body {
    /// Beginning with the head's.
    variables: usize,
    literals: Vec<Lit>,
    /// The head has two columns; the second is variable 1.
    pair: bool,
}

impl Body {
    /// `None` if it never holds.
    fn new(clause: &Clause) -> Option<Body> {
        let mut numbers: BTreeMap<u32, Var> = BTreeMap::new();
        let mut variables = 0;
        let mut fresh = || {
            variables += 1;
            variables - 1
        };
        let mut number = |term: &Term, fresh: &mut dyn FnMut() -> Var| match term {
            Term::Variable(id) => *numbers.entry(id.0).or_insert_with(fresh),
            Term::Wildcard => fresh(),
            Term::Constant(_) => unreachable!("a stratum with constants is not dense"),
        };
        let mut literals = Vec::new();
        let head: Vec<Var> = (clause.head.terms.iter())
            .map(|term| number(term, &mut fresh))
            .collect();
        let pair = head.len() == 2;
        if pair && head[0] == head[1] {
            let second = fresh();
            literals.push(Lit::Same(head[0], second, true));
        }
        for literal in &clause.body {
            match literal {
                Literal::Positive(Atom { relation, terms, .. }) | Literal::Guard(Atom { relation, terms, .. }) => {
                    let terms: Vec<Var> = terms.iter().map(|term| number(term, &mut fresh)).collect();
                    literals.push(about(*relation, &terms, true));
                }
                Literal::Negative(Atom { relation, terms, .. }) => literals.push(match terms.as_slice() {
                    [term, Term::Wildcard] => Lit::Is(
                        Property::Related(*relation, Axis::First),
                        number(term, &mut fresh),
                        false,
                    ),
                    [Term::Wildcard, term] => Lit::Is(
                        Property::Related(*relation, Axis::Second),
                        number(term, &mut fresh),
                        false,
                    ),
                    terms => {
                        let terms: Vec<Var> = terms.iter().map(|term| number(term, &mut fresh)).collect();
                        about(*relation, &terms, false)
                    }
                }),
                Literal::Compare { op, left, right, .. } => {
                    let (left, right) = (number(left, &mut fresh), number(right, &mut fresh));
                    let holds = *op == Comparison::Equal;
                    match (left == right, holds) {
                        (true, true) => {}
                        (true, false) => return None,
                        (false, _) => literals.push(Lit::Same(left, right, holds)),
                    }
                }
                Literal::Compute { .. } | Literal::Aggregate { .. } => {
                    unreachable!("a stratum that computes is not dense")
                }
            }
        }
        literals.sort_unstable();
        literals.dedup();
        Some(Body {
            variables,
            literals,
            pair,
        })
    }

    /// The variables besides the head's first, in groups that no literal connects but through that one. If the head has two
    /// columns, the first group has the second variable, first.
    fn groups(&self) -> Vec<Vec<Var>> {
        let mut group: Vec<Var> = (0..self.variables).collect();
        for literal in &self.literals {
            if let Lit::Pair(_, left, right, _) | Lit::Same(left, right, _) = *literal
                && left != 0
                && right != 0
            {
                let (keep, drop) = (group[left].min(group[right]), group[left].max(group[right]));
                group
                    .iter_mut()
                    .filter(|group| **group == drop)
                    .for_each(|group| *group = keep);
            }
        }
        let heads = (1..self.variables).filter(|&var| group[var] == var);
        heads
            .map(|head| (1..self.variables).filter(|&var| group[var] == head).collect())
            .collect()
    }

    /// Whether the predicate relates the head's first variable to all others, and nothing is asked of all entities.
    fn is_guarded_by(&self, guard: RelId) -> bool {
        let asks_all = |literal: &Lit| matches!(literal, Lit::Is(Property::Related(..), ..));
        let guarded = |var| self.literals.contains(&Lit::Pair(guard, 0, var, true));
        (1..self.variables).all(guarded) && !self.literals.iter().any(asks_all)
    }

    /// The groups that only have to exist.
    fn conditions(&self) -> Vec<Vec<Var>> {
        self.groups().split_off(usize::from(self.pair))
    }
}

fn about(relation: RelId, terms: &[Var], holds: bool) -> Lit {
    match *terms {
        [of] => Lit::Is(Property::Holds(relation), of, holds),
        [left, right] if left == right => Lit::Is(Property::Diagonal(relation), left, holds),
        [left, right] => Lit::Pair(relation, left, right, holds),
        _ => unreachable!("a dense predicate has one or two columns"),
    }
}

/// A search for values of the variables of one group: one step for each variable.
type Search = Vec<Seek>;

/// A step of a search.
#[derive(Clone, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
struct Seek {
    properties: Vec<(Property, bool)>,
    /// Ends in the bound variable and whether it holds.
    relations: Vec<(Relates, usize, bool)>,
}

/// How a value can stand to a bound variable.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Relates {
    /// The value is in this column of the predicate.
    By(RelId, Axis),
    Same,
}

impl Body {
    /// What is said of one variable alone.
    fn properties(&self, var: Var) -> Vec<(Property, bool)> {
        let of = |literal: &Lit| match *literal {
            Lit::Is(property, of, holds) if of == var => Some((property, holds)),
            _ => None,
        };
        self.literals.iter().filter_map(of).collect()
    }

    /// What relates `var` to a variable that is bound; `bound` has them in order.
    fn relations(&self, var: Var, bound: &[Var]) -> Vec<(Relates, usize, bool)> {
        let place = |of: Var| bound.iter().position(|&bound| bound == of);
        let of = |literal: &Lit| match *literal {
            Lit::Pair(relation, left, right, holds) if right == var => {
                Some((Relates::By(relation, Axis::Second), place(left)?, holds))
            }
            Lit::Pair(relation, left, right, holds) if left == var => {
                Some((Relates::By(relation, Axis::First), place(right)?, holds))
            }
            Lit::Same(left, right, holds) if right == var => Some((Relates::Same, place(left)?, holds)),
            Lit::Same(left, right, holds) if left == var => Some((Relates::Same, place(right)?, holds)),
            _ => None,
        };
        self.literals.iter().filter_map(of).collect()
    }

    /// A search for a group. It takes next the variable that most is known of, beginning with `first` if there is one.
    /// Rows of `guards` are asked first: they leave few values.
    fn search(&self, group: &[Var], first: Option<Var>, guards: &[RelId]) -> Search {
        let mut bound: Vec<Var> = vec![0];
        let mut rest = group.to_vec();
        let mut search = Vec::new();
        while !rest.is_empty() {
            let known = |&var: &Var| {
                let relations = self.relations(var, &bound);
                let holding = relations.iter().filter(|(_, _, holds)| *holds).count();
                (
                    Some(var) == first,
                    holding,
                    self.properties(var).len(),
                    std::cmp::Reverse(var),
                )
            };
            let next = *rest.iter().max_by_key(|var| known(var)).expect("there is one");
            let mut relations = self.relations(next, &bound);
            relations.sort_by_key(|&(relates, to, holds)| {
                let guards = matches!(relates, Relates::By(relation, _) if guards.contains(&relation));
                (!holds, !guards, relates, to)
            });
            search.push(Seek {
                properties: self.properties(next),
                relations,
            });
            bound.push(next);
            rest.retain(|&var| var != next);
        }
        search
    }
}

/// That entities are in a set, or that they are not.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Asked {
    set: Reg,
    holds: bool,
}

impl Asked {
    fn of(set: Reg) -> Asked {
        Asked { set, holds: true }
    }
}

/// When a set changes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Changes {
    /// With steady inputs only.
    Seldom,
    /// From run to run.
    Often,
    /// Within a run: it is a predicate whose clauses are being evaluated.
    Within,
}

fn union(dst: Reg, left: Reg, right: Reg) -> Combination {
    Combination {
        dst,
        left,
        right,
        flips: [u64::MAX; 3],
    }
}

struct Compiler<'a> {
    rules: &'a Rules,
    counting: Counting,
    /// By [`RelId`].
    derived: Vec<bool>,
    /// Predicates that scopes ask for.
    guards: Vec<RelId>,
    out: Dense,
    known_properties: BTreeMap<Property, Reg>,
    /// How often something is asked of an entity.
    uses: BTreeMap<(Property, bool), usize>,
    /// Sets made of two others: whether of both, or of the first without the second.
    known_sets: BTreeMap<(Reg, Reg, bool), Reg>,
    /// By [`Reg`]: how seldom the set changes.
    changes: Vec<Changes>,
    /// Searches that several clauses make, with what each clause asks of given predicates about the head's first variable.
    shared: BTreeMap<Search, Vec<Vec<(Property, bool)>>>,
    known_searches: BTreeMap<Search, Reg>,
}

impl<'a> Compiler<'a> {
    fn new(rules: &'a Rules, counting: Counting, derived: Vec<bool>) -> Self {
        let literals = rules.clauses.iter().flat_map(|clause| &clause.body);
        let mut guards: Vec<RelId> = literals
            .filter_map(|literal| match literal {
                Literal::Guard(atom) => Some(atom.relation),
                _ => None,
            })
            .collect();
        guards.sort_unstable();
        guards.dedup();
        Compiler {
            rules,
            counting,
            derived,
            guards,
            out: Dense {
                inputs: Vec::new(),
                lists: Vec::new(),
                set_count: Dense::FIRST_INPUT,
                row_lists: 0,
                combinations: Vec::new(),
                steps: Vec::new(),
                tests: Vec::new(),
                restless: 0,
                settling: Vec::new(),
                ops: Vec::new(),
                heads: Vec::new(),
                homes: vec![Home::Given; rules.relations.len()],
                fired: BTreeMap::new(),
                local: true,
                guards: Vec::new(),
            },
            known_properties: BTreeMap::new(),
            uses: BTreeMap::new(),
            known_sets: BTreeMap::new(),
            changes: vec![Changes::Seldom; Dense::FIRST_INPUT],
            shared: BTreeMap::new(),
            known_searches: BTreeMap::new(),
        }
    }

    fn is_given(&self, property: Property) -> bool {
        let (Property::Holds(relation) | Property::Diagonal(relation) | Property::Related(relation, _)) = property;
        !self.derived[relation.index()]
    }

    /// Numbers the sets that the caller provides, and finds out whether the program is local.
    fn find_inputs(&mut self, bodies: &[(ClauseId, Body)], steady: impl Fn(RelId) -> bool) {
        let mut given = BTreeSet::new();
        for literal in bodies.iter().flat_map(|(_, body)| &body.literals) {
            if let Lit::Is(property, _, holds) = *literal {
                *self.uses.entry((property, holds)).or_default() += 1;
            }
            let (relation, asked_of_head) = match *literal {
                Lit::Is(Property::Related(relation, axis), var, _) => (relation, var == 0 && axis == Axis::First),
                Lit::Is(property @ (Property::Holds(relation) | Property::Diagonal(relation)), var, _) => {
                    if self.is_given(property) {
                        given.insert((steady(relation), property));
                    }
                    (relation, var == 0)
                }
                Lit::Pair(relation, left, _, _) => (relation, left == 0),
                Lit::Same(..) => continue,
            };
            self.out.local &= asked_of_head || !self.derived[relation.index()];
        }
        let guards_all = |guard: &RelId| bodies.iter().all(|(_, body)| body.is_guarded_by(*guard));
        self.out.guards = self.guards.iter().copied().filter(guards_all).collect();
        for (steady, property) in given {
            let set = self.set(if steady { Changes::Seldom } else { Changes::Often });
            self.known_properties.insert(property, set);
            self.out.inputs.push(match property {
                Property::Diagonal(relation) => Input::Diagonal(relation),
                Property::Holds(relation) | Property::Related(relation, _) => Input::Unary(relation),
            });
            self.out.restless += usize::from(!steady);
        }
    }

    /// Finds the searches that several clauses make.
    fn find_shared(&mut self, bodies: &[(ClauseId, Body)]) {
        for (_, body) in bodies {
            let mut asked = body.properties(0);
            asked.retain(|(property, _)| self.is_given(*property));
            for group in body.conditions() {
                let search = body.search(&group, None, &self.guards);
                self.shared.entry(search).or_default().push(asked.clone());
            }
        }
        self.shared.retain(|_, users| users.len() > 1);
    }

    fn set(&mut self, changes: Changes) -> Reg {
        self.changes.push(changes);
        self.out.set_count += 1;
        Reg(u32::try_from(self.out.set_count - 1).expect("fewer than 2^32 sets"))
    }

    fn row_list(&mut self) -> usize {
        self.out.row_lists += 1;
        self.out.row_lists - 1
    }

    fn declare(&mut self, relation: RelId) {
        self.out.homes[relation.index()] = match self.rules.relations[relation.index()].arity() {
            1 => {
                let set = self.set(Changes::Within);
                self.out.heads.push(set);
                Home::Set(set)
            }
            _ => Home::Rows(self.row_list()),
        };
    }

    /// The predicates so far have all their facts before the next clause.
    fn complete(&mut self) {
        for set in &self.out.heads {
            self.changes[set.index()] = Changes::Often;
        }
    }

    fn clause(&mut self, id: ClauseId, body: &Body) {
        let head = self.rules.clauses[id.index()].head.relation;
        let mut asked = self.ask(&body.properties(0));
        asked.push(Asked::of(Reg::EGOS));
        let mut own = Vec::new();
        for group in body.conditions() {
            let search = body.search(&group, None, &self.guards);
            match self.shared.contains_key(&search) {
                true => asked.push(Asked::of(self.shared_search(search))),
                false => own.push(search),
            }
        }
        // One variable is found faster than several.
        own.sort_by_key(Vec::len);

        if let (Home::Set(dst), Counting::Off) = (self.out.homes[head.index()], self.counting)
            && let Some(last) = own.pop()
        {
            let (mut left, mut right) = self.halves(asked);
            for search in own {
                let found = self.both(left, right, true);
                left = self.exists(found, &search);
                right = left;
            }
            self.add_existing(dst, left, right, &last);
            return;
        }
        let mut found = self.combine(asked);
        for search in own {
            found = self.exists(found, &search);
        }
        match self.out.homes[head.index()] {
            Home::Set(dst) => {
                self.add(dst, found);
                if self.counting == Counting::Each {
                    self.out.fired.insert(id, Fired::Set(found));
                }
            }
            Home::Rows(rows) => {
                let groups = body.groups();
                let search = body.search(&groups[0], Some(1), &self.guards);
                let steps = self.search(&search);
                let dst = match self.counting {
                    Counting::Off => rows,
                    Counting::Each => self.row_list(),
                };
                let demand = found;
                self.out.ops.push(Op::Rows { dst, demand, steps });
                if self.counting == Counting::Each {
                    self.out.fired.insert(id, Fired::Rows(dst));
                    self.out.ops.push(Op::OrRows { dst: rows, from: dst });
                }
            }
            Home::Given => unreachable!("a clause of a dense stratum derives its predicate"),
        }
    }

    /// The set of entities for which a search that several clauses make succeeds, as far as one of them asks.
    fn shared_search(&mut self, search: Search) -> Reg {
        if let Some(&set) = self.known_searches.get(&search) {
            return set;
        }
        let users = self.shared[&search].clone();
        let demand = match users.iter().any(Vec::is_empty) {
            true => Reg::EGOS,
            false => {
                let sets: Vec<Reg> = (users.iter())
                    .map(|asked| {
                        let mut asked = self.ask(asked);
                        asked.push(Asked::of(Reg::EGOS));
                        self.combine(asked)
                    })
                    .collect();
                let unite = |left, &right: &Reg| {
                    let dst = self.set(Changes::Often);
                    self.push(union(dst, left, right));
                    dst
                };
                let (&first, rest) = sets.split_first().expect("a shared search has users");
                rest.iter().fold(first, unite)
            }
        };
        let dst = self.exists(demand, &search);
        self.known_searches.insert(search, dst);
        dst
    }

    /// The members of `demand` for which a search succeeds.
    fn exists(&mut self, demand: Reg, search: &Search) -> Reg {
        let steps = self.search(search);
        let dst = self.set(Changes::Often);
        let op = match self.lists(steps) {
            Some((among, lists)) => Op::Any {
                dst,
                demand,
                among,
                lists,
            },
            None => Op::Exists { dst, demand, steps },
        };
        self.out.ops.push(op);
        dst
    }

    /// Adds the members of both `left` and `right` for which a search succeeds to a set.
    fn add_existing(&mut self, dst: Reg, left: Reg, right: Reg, search: &Search) {
        let steps = self.search(search);
        if let Some((among, lists)) = self.lists(steps) {
            self.out.ops.push(Op::AddAny {
                dst,
                left,
                right,
                among,
                lists,
            });
            return;
        }
        let demand = self.both(left, right, true);
        let demand = self.both(demand, dst, false);
        let from = self.set(Changes::Often);
        self.out.ops.push(Op::Exists {
            dst: from,
            demand,
            steps,
        });
        self.add(dst, from);
    }

    /// Adds a combination to those that are made last, if nothing else is.
    fn push(&mut self, combination: Combination) {
        let range = match self.out.ops.pop() {
            Some(Op::Combine(range)) => range,
            other => {
                self.out.ops.extend(other);
                Range::begin(&self.out.combinations)
            }
        };
        self.out.combinations.push(combination);
        self.out.ops.push(Op::Combine(range.end(&self.out.combinations)));
    }

    /// Adds the members of a set to another.
    fn add(&mut self, dst: Reg, from: Reg) {
        self.push(union(dst, dst, from));
    }

    /// Of a search with one step that asks a few given lists only: among whom it looks, and the lists.
    fn lists(&mut self, steps: Range) -> Option<(Reg, Lists)> {
        let [Step { among, tests }] = *self.out.steps(steps) else {
            return None;
        };
        let tests = self.out.tests(tests);
        let mut lists = [0; Lists::MAX];
        for (list, test) in lists.iter_mut().zip(tests) {
            *list = match test.list {
                Place::Given(list) if test.holds => u16::try_from(list).ok()?,
                _ => return None,
            };
        }
        let count = u8::try_from(tests.len())
            .ok()
            .filter(|&count| usize::from(count) <= Lists::MAX)?;
        Some((among, Lists { count, lists }))
    }

    /// The sets of what is asked of one variable. What clauses have in common comes first, so that it is put together once.
    fn ask(&mut self, properties: &[(Property, bool)]) -> Vec<Asked> {
        let mut properties = properties.to_vec();
        properties.sort_by_key(|asked| std::cmp::Reverse(self.uses.get(asked).copied().unwrap_or(0)));
        let asked = properties.into_iter().map(|(property, holds)| Asked {
            set: self.property(property),
            holds,
        });
        asked.collect()
    }

    /// The set of entities that have the property.
    fn property(&mut self, property: Property) -> Reg {
        if let Some(&set) = self.known_properties.get(&property) {
            return set;
        }
        let set = match property {
            Property::Holds(relation) => match self.out.homes[relation.index()] {
                Home::Set(set) => set,
                Home::Given | Home::Rows(_) => unreachable!("given sets are numbered before"),
            },
            Property::Diagonal(relation) => {
                let Home::Rows(rows) = self.out.homes[relation.index()] else {
                    unreachable!("given sets are numbered before")
                };
                let dst = self.set(Changes::Often);
                self.out.ops.push(Op::Diagonal { dst, rows });
                dst
            }
            Property::Related(relation, axis) => {
                let other = match axis {
                    Axis::First => Axis::Second,
                    Axis::Second => Axis::First,
                };
                let search = vec![Seek {
                    properties: Vec::new(),
                    relations: vec![(Relates::By(relation, other), 0, true)],
                }];
                self.exists(Reg::ALL, &search)
            }
        };
        self.known_properties.insert(property, set);
        set
    }

    /// The set of the entities of which all is true that is asked.
    fn combine(&mut self, asked: Vec<Asked>) -> Reg {
        let (left, right) = self.halves(asked);
        self.both(left, right, true)
    }

    /// The same as the intersection of two sets: what seldom changes is put together apart from the rest. It need not be done again,
    /// and the rest is what clauses tend to have in common.
    fn halves(&mut self, asked: Vec<Asked>) -> (Reg, Reg) {
        let seldom = |asked: &Asked| self.changes[asked.set.index()] == Changes::Seldom;
        let (mut steady, rest): (Vec<Asked>, Vec<Asked>) = asked.into_iter().partition(seldom);
        steady.sort_unstable_by_key(|asked| (!asked.holds, asked.set));
        match (steady.is_empty(), rest.is_empty()) {
            (false, false) => (self.fold(&steady), self.fold(&rest)),
            (false, true) => {
                let set = self.fold(&steady);
                (set, set)
            }
            (true, _) => {
                let set = self.fold(&rest);
                (set, set)
            }
        }
    }

    fn fold(&mut self, asked: &[Asked]) -> Reg {
        // It begins with a set that holds, if only with that of all.
        let (first, rest) = match asked {
            [Asked { set, holds: true }, rest @ ..] => (*set, rest),
            rest => (Reg::ALL, rest),
        };
        rest.iter()
            .fold(first, |made, asked| self.both(made, asked.set, asked.holds))
    }

    /// The members of `left` that are in `right`, or those that are not.
    fn both(&mut self, left: Reg, right: Reg, holds: bool) -> Reg {
        if left == right && holds {
            return left;
        }
        if let Some(&set) = self.known_sets.get(&(left, right, holds)) {
            return set;
        }
        let changes = self.changes[left.index()].max(self.changes[right.index()]);
        let dst = self.set(changes.min(Changes::Often));
        let combination = Combination {
            dst,
            left,
            right,
            flips: [0, if holds { 0 } else { u64::MAX }, 0],
        };
        if changes != Changes::Within {
            self.known_sets.insert((left, right, holds), dst);
        }
        match changes {
            Changes::Seldom => self.out.settling.push(combination),
            _ => self.push(combination),
        }
        dst
    }

    fn search(&mut self, search: &Search) -> Range {
        let mut steps = Vec::with_capacity(search.len());
        for seek in search {
            let asked = self.ask(&seek.properties);
            let among = self.combine(asked);
            let tests: Vec<Test> = (seek.relations.iter())
                .map(|&(relates, to, holds)| Test {
                    list: self.place(relates),
                    to,
                    holds,
                })
                .collect();
            let range = Range::begin(&self.out.tests);
            self.out.tests.extend(tests);
            let tests = range.end(&self.out.tests);
            steps.push(Step { among, tests });
        }
        let range = Range::begin(&self.out.steps);
        self.out.steps.extend(steps);
        range.end(&self.out.steps)
    }

    fn place(&mut self, relates: Relates) -> Place {
        let Relates::By(relation, axis) = relates else {
            return Place::Same;
        };
        if let Home::Rows(rows) = self.out.homes[relation.index()] {
            return Place::Derived(rows, axis);
        }
        let list = List(relation, axis);
        let known = self.out.lists.iter().position(|&known| known == list);
        Place::Given(known.unwrap_or_else(|| {
            self.out.lists.push(list);
            self.out.lists.len() - 1
        }))
    }
}
