//! Compiles rules to a list of operations on sets.

use crate::check::{ClauseId, Literal, PredicateId, Rules};
use crate::dense::analyze::{Unsupported, obstacles};
use crate::dense::body::{DenseBody, Lit, PAIR, Property, Relates, SearchPlan, Seek, decompose};
use crate::dense::program::{
    Any, Argument, Branch, DemandOp, Dense, Fired, Home, Input, List, Op, Place, Range, Rare, Reg, SearchStep, Test,
    TrackFirings,
};
use std::collections::{BTreeMap, BTreeSet};

impl Dense {
    /// Compiles rules. Predicates without clauses are inputs.
    ///
    /// `steady` names inputs that seldom change. Sets that depend on these alone are recomputed only when one of them
    /// changes.
    ///
    /// # Errors
    /// The first of the [`obstacles`](super::obstacles), if there is one.
    pub fn new(
        rules: &Rules,
        counting: TrackFirings,
        steady: impl Fn(PredicateId) -> bool,
    ) -> Result<Dense, Unsupported> {
        if let Some(obstacle) = obstacles(rules).into_iter().next() {
            return Err(obstacle);
        }
        let mut derived = vec![false; rules.predicates.len()];
        for predicate in rules.strata.iter().flat_map(|stratum| &stratum.predicates) {
            derived[predicate.index()] = true;
        }
        let clauses = rules.strata.iter().flat_map(|stratum| &stratum.clauses);
        let bodies: Vec<(ClauseId, DenseBody)> = clauses
            .filter_map(|&clause| Some((clause, DenseBody::new(&rules.clauses[clause.index()])?)))
            .collect();

        let mut compiler = Compiler::new(rules, counting, derived);
        compiler.find_inputs(&bodies, steady);
        compiler.find_shared(&bodies);
        let mut bodies = bodies.iter().peekable();
        for stratum in &rules.strata {
            for &predicate in &stratum.predicates {
                compiler.declare(predicate);
            }
            while let Some((clause, body)) = bodies.next_if(|(clause, _)| stratum.clauses.contains(clause)) {
                compiler.clause(*clause, body);
            }
            compiler.complete();
        }
        Ok(compiler.out)
    }
}

/// A condition: membership in a set, or in its complement.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Asked {
    set: Reg,
    holds: bool,
}

impl Asked {
    fn of(set: Reg) -> Asked {
        Asked { set, holds: true }
    }
}

/// The frequency at which a set changes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Changes {
    /// Only when a steady input changes.
    Seldom,
    /// It changes in every run.
    Often,
    /// Within a run: it holds a predicate whose clauses are being evaluated.
    Within,
}

struct Compiler<'a> {
    rules: &'a Rules,
    counting: TrackFirings,
    /// By [`PredicateId`].
    derived: Vec<bool>,
    /// The predicates of scope guards.
    guards: Vec<PredicateId>,
    out: Dense,
    known_properties: BTreeMap<Property, Reg>,
    /// The number of uses of each condition.
    uses: BTreeMap<(Property, bool), usize>,
    /// Known sets that combine two others.
    known_sets: BTreeMap<(Reg, Asked), Reg>,
    /// By [`Reg`]: how often the set changes.
    changes: Vec<Changes>,
    /// Searches that several clauses share. Each clause adds its conditions on the head's first variable over given
    /// predicates.
    shared: BTreeMap<SearchPlan, Vec<Vec<(Property, bool)>>>,
    known_searches: BTreeMap<SearchPlan, Reg>,
    /// The sets of derived one-column predicates.
    heads: Vec<Reg>,
}

impl<'a> Compiler<'a> {
    fn new(rules: &'a Rules, counting: TrackFirings, derived: Vec<bool>) -> Self {
        let literals = rules.clauses.iter().flat_map(|clause| &clause.body);
        let mut guards: Vec<PredicateId> = literals
            .filter_map(|literal| match literal {
                Literal::Guard(atom) => Some(atom.predicate),
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
                set_count: Reg::INPUTS.index(),
                row_lists: 0,
                steps: Vec::new(),
                tests: Vec::new(),
                branches: Vec::new(),
                numbers: Vec::new(),
                restless: 0,
                settling: Vec::new(),
                rare: Vec::new(),
                ops: Vec::new(),
                cleared: Vec::new(),
                homes: vec![Home::Input; rules.predicates.len()],
                fired: vec![None; rules.clauses.len()],
                local: true,
                guards: Vec::new(),
            },
            known_properties: BTreeMap::new(),
            uses: BTreeMap::new(),
            known_sets: BTreeMap::new(),
            changes: vec![Changes::Seldom; Reg::INPUTS.index()],
            shared: BTreeMap::new(),
            known_searches: BTreeMap::new(),
            heads: Vec::new(),
        }
    }

    fn is_given(&self, property: Property) -> bool {
        let (Property::Holds(predicate)
        | Property::Diagonal(predicate)
        | Property::Related(predicate, _)
        | Property::Count(predicate, ..)) = property;
        !self.derived[predicate.index()]
    }

    /// Numbers the input sets and determines whether the program is local.
    fn find_inputs(&mut self, bodies: &[(ClauseId, DenseBody)], steady: impl Fn(PredicateId) -> bool) {
        let mut given = BTreeSet::new();
        for literal in bodies.iter().flat_map(|(_, body)| &body.literals) {
            if let Lit::Is(property, _, holds) = *literal {
                *self.uses.entry((property, holds)).or_default() += 1;
            }
            let (predicate, of_head) = match *literal {
                Lit::Is(Property::Related(predicate, axis) | Property::Count(predicate, axis, _), var, _) => {
                    (predicate, var == 0 && axis == Argument::First)
                }
                Lit::Is(property @ (Property::Holds(predicate) | Property::Diagonal(predicate)), var, _) => {
                    if self.is_given(property) {
                        given.insert((steady(predicate), property));
                    }
                    (predicate, var == 0)
                }
                Lit::Pair(predicate, left, _, _) => (predicate, left == 0),
                Lit::Same(..) => continue,
            };
            self.out.local &= of_head || !self.derived[predicate.index()];
        }
        let counts_all =
            |literal: &Lit| matches!(literal, Lit::Is(property @ Property::Count(..), ..) if self.is_given(*property));
        let counts_all = bodies.iter().any(|(_, body)| body.literals.iter().any(counts_all));
        let guards_all = |guard: &PredicateId| !counts_all && bodies.iter().all(|(_, body)| body.is_guarded_by(*guard));
        self.out.guards = self.guards.iter().copied().filter(guards_all).collect();
        for (steady, property) in given {
            let set = self.set(if steady { Changes::Seldom } else { Changes::Often });
            self.known_properties.insert(property, set);
            self.out.inputs.push(match property {
                Property::Diagonal(predicate) => Input::Diagonal(predicate),
                Property::Holds(predicate) => Input::Unary(predicate),
                Property::Related(..) | Property::Count(..) => unreachable!("only sets are given"),
            });
            self.out.restless += usize::from(!steady);
        }
    }

    /// Finds the searches to share between clauses.
    fn find_shared(&mut self, bodies: &[(ClauseId, DenseBody)]) {
        for (_, body) in bodies {
            let mut asked = body.properties(0);
            asked.retain(|(property, _)| self.is_given(*property));
            for group in body.conditions() {
                let search = body.search(&group, None, &self.guards);
                self.shared.entry(search).or_default().push(asked.clone());
            }
        }
        // Share a search only if the demand of one clause contains that of another. Otherwise separate demands are
        // smaller: each excludes the entities whose head is already derived.
        let within = |one: &[_], other: &[_]| one.iter().all(|asked| other.contains(asked));
        (self.shared).retain(|_, users| {
            let others = |at: usize| users[..at].iter().chain(&users[at + 1..]);
            (users.iter().enumerate()).any(|(at, one)| others(at).any(|other| within(one, other)))
        });
    }

    fn set(&mut self, changes: Changes) -> Reg {
        self.changes.push(changes);
        self.out.set_count += 1;
        Reg::new(self.out.set_count - 1)
    }

    /// Allocates a set that each run clears first.
    fn cleared(&mut self, changes: Changes) -> Reg {
        let set = self.set(changes);
        self.out.cleared.push(set);
        set
    }

    fn row_list(&mut self) -> usize {
        self.out.row_lists += 1;
        self.out.row_lists - 1
    }

    fn declare(&mut self, predicate: PredicateId) {
        self.out.homes[predicate.index()] = match self.rules.predicates[predicate.index()].arity() {
            1 => {
                let set = self.cleared(Changes::Within);
                self.heads.push(set);
                Home::Set(set)
            }
            _ => Home::Rows(self.row_list()),
        };
    }

    /// Marks the predicates declared so far as complete.
    fn complete(&mut self) {
        for set in &self.heads {
            self.changes[set.index()] = Changes::Often;
        }
    }

    fn clause(&mut self, id: ClauseId, body: &DenseBody) {
        let head = self.rules.clauses[id.index()].head.predicate;
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
        // Short searches first.
        own.sort_by_key(Vec::len);

        if let (Home::Set(dst), TrackFirings::Off) = (self.out.homes[head.index()], self.counting) {
            let last = own.pop();
            let (mut left, mut right) = self.halves(asked);
            for search in own {
                left = self.exists(left, right, &search);
                right = left;
            }
            match last {
                Some(search) => self.add_existing(DemandOp { dst, left, right }, &search),
                None => self.add(dst, left, right),
            }
            return;
        }
        let mut found = self.combine(asked);
        for search in own {
            found = self.exists(found, found, &search);
        }
        match self.out.homes[head.index()] {
            Home::Set(dst) => {
                self.add(dst, found, found);
                if self.counting == TrackFirings::Each {
                    self.out.fired[id.index()] = Some(Fired::Set(found));
                }
            }
            Home::Rows(rows) => {
                let groups = body.groups();
                let search = body.search(&groups[0], Some(1), &self.guards);
                let steps = self.steps(&search);
                let dst = match self.counting {
                    TrackFirings::Off => rows,
                    TrackFirings::Each => self.row_list(),
                };
                let demand = found;
                let op = if search.len() <= PAIR {
                    let steps = Range::extend(&mut self.out.steps, steps);
                    Rare::Rows { dst, demand, steps }
                } else {
                    let branches = self.branches(&search, steps);
                    Rare::RowsTree { dst, demand, branches }
                };
                self.rare(op);
                if self.counting == TrackFirings::Each {
                    self.out.fired[id.index()] = Some(Fired::Rows(dst));
                    self.rare(Rare::OrRows { dst: rows, from: dst });
                }
            }
            Home::Input => unreachable!("a clause of a dense stratum derives its predicate"),
        }
    }

    /// Returns the set of entities for which a shared search succeeds, among those that some clause demands.
    fn shared_search(&mut self, search: SearchPlan) -> Reg {
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
                let demand = self.cleared(Changes::Often);
                for set in sets {
                    self.add(demand, set, set);
                }
                demand
            }
        };
        let dst = self.exists(demand, demand, &search);
        self.known_searches.insert(search, dst);
        dst
    }

    /// Returns the members of both `left` and `right` for which a search succeeds.
    fn exists(&mut self, left: Reg, right: Reg, search: &SearchPlan) -> Reg {
        let dst = self.cleared(Changes::Often);
        self.add_existing(DemandOp { dst, left, right }, search);
        dst
    }

    /// Adds the demanded entities for which a search succeeds.
    fn add_existing(&mut self, demand: DemandOp, search: &SearchPlan) {
        let steps = self.steps(search);
        let op = match self.any(demand, &steps) {
            Some(op) => op,
            None if steps.len() <= PAIR => Op::Exists(demand, Range::extend(&mut self.out.steps, steps)),
            None => {
                let branches = self.branches(search, steps);
                return self.rare(Rare::ExistsTree(demand, branches));
            }
        };
        self.out.ops.push(op);
    }

    /// Appends a rarely used operation.
    fn rare(&mut self, op: Rare) {
        let position = u32::try_from(self.out.rare.len()).expect("fewer than 2^32 operations");
        self.out.rare.push(op);
        self.out.ops.push(Op::Rare(position));
    }

    /// Adds the tree of a search.
    fn branches(&mut self, search: &SearchPlan, steps: Vec<SearchStep>) -> Range {
        let branches = (decompose(search).into_iter().zip(steps)).map(|(branch, step)| {
            let mut others = branch.separator;
            others.pop();
            let tests = self.out.tests(step.tests).iter().copied();
            let (to_head, mut to_others): (Vec<Test>, Vec<Test>) = tests.partition(|test| test.to == 0);
            to_others.sort_by_key(|test| test.to);
            Branch {
                among: step.among,
                to_head: Range::extend(&mut self.out.tests, to_head),
                to_others: Range::extend(&mut self.out.tests, to_others),
                children: Range::extend(&mut self.out.numbers, branch.children),
                others: Range::extend(&mut self.out.numbers, others),
                of_head: branch.of_head,
            }
        });
        let branches = branches.collect();
        Range::extend(&mut self.out.branches, branches)
    }

    /// Adds the members of both `left` and `right` to a set.
    fn add(&mut self, dst: Reg, left: Reg, right: Reg) {
        self.out.ops.push(Op::Add { dst, left, right });
    }

    /// Returns a specialized operation for a search with one step that tests at most three given lists.
    fn any(&self, demand: DemandOp, steps: &[SearchStep]) -> Option<Op> {
        let [SearchStep { among, tests }] = *steps else {
            return None;
        };
        let list = |test: &Test| match test.list {
            Place::Input(list) if test.holds => u16::try_from(list).ok(),
            _ => None,
        };
        let lists: Vec<u16> = self.out.tests(tests).iter().map(list).collect::<Option<_>>()?;
        match *lists {
            [] => Some(Op::Any0(demand, Any::new(among, []))),
            [a] => Some(Op::Any1(demand, Any::new(among, [a]))),
            [a, b] => Some(Op::Any2(demand, Any::new(among, [a, b]))),
            [a, b, c] => Some(Op::Any3(demand, Any::new(among, [a, b, c]))),
            _ => None,
        }
    }

    /// Returns the set of each condition on one variable. The most frequent conditions come first, so that clauses
    /// share their intersections.
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
            Property::Holds(predicate) => match self.out.homes[predicate.index()] {
                Home::Set(set) => set,
                Home::Input | Home::Rows(_) => unreachable!("input sets are numbered before"),
            },
            Property::Diagonal(predicate) => {
                let Home::Rows(rows) = self.out.homes[predicate.index()] else {
                    unreachable!("input sets are numbered before")
                };
                let dst = self.set(Changes::Often);
                self.rare(Rare::Diagonal { dst, rows });
                dst
            }
            Property::Related(predicate, axis) => {
                let search = vec![Seek {
                    properties: Vec::new(),
                    predicates: vec![(Relates::By(predicate, axis.other()), 0, true)],
                }];
                self.exists(Reg::ALL, Reg::ALL, &search)
            }
            Property::Count(predicate, axis, bounds) => {
                let list = self.place(Relates::By(predicate, axis.other()));
                let test = Test {
                    list,
                    to: 0,
                    holds: true,
                };
                let dst = self.set(Changes::Often);
                let demand = match list {
                    Place::Derived(..) => Reg::EGOS,
                    Place::Input(_) | Place::Same => Reg::ALL,
                };
                let test = Range::extend(&mut self.out.tests, vec![test]);
                self.rare(Rare::Count {
                    dst,
                    demand,
                    test,
                    bounds,
                });
                dst
            }
        };
        self.known_properties.insert(property, set);
        set
    }

    /// Returns the set of entities that satisfy all conditions.
    fn combine(&mut self, asked: Vec<Asked>) -> Reg {
        let (left, right) = self.halves(asked);
        self.both(left, Asked::of(right))
    }

    /// Like `combine`, as two sets to intersect. The first depends on steady inputs only, so it is seldom recomputed.
    /// The second tends to be common to several clauses.
    fn halves(&mut self, asked: Vec<Asked>) -> (Reg, Reg) {
        let seldom = |asked: &Asked| self.changes[asked.set.index()] == Changes::Seldom;
        let (mut steady, rest): (Vec<Asked>, Vec<Asked>) = asked.into_iter().partition(seldom);
        steady.sort_unstable_by_key(|asked| (!asked.holds, asked.set));
        let left = self.fold(Reg::ALL, &steady);
        let among = match steady.contains(&Asked::of(Reg::EGOS)) {
            true => Reg::EGOS,
            false => Reg::ALL,
        };
        match *rest {
            [] => (left, left),
            [Asked { set, holds: true }, ref rest @ ..] => (left, self.fold(set, rest)),
            [ref rest @ .., Asked { set, holds: true }] if left == among => (self.fold(among, rest), set),
            ref rest => {
                let right = self.fold(among, rest);
                (if left == among { right } else { left }, right)
            }
        }
    }

    /// Returns the members of a set that satisfy all conditions.
    fn fold(&mut self, among: Reg, asked: &[Asked]) -> Reg {
        asked.iter().fold(among, |made, &asked| self.both(made, asked))
    }

    /// Returns the members of `left` that satisfy the condition.
    fn both(&mut self, left: Reg, right: Asked) -> Reg {
        if right.holds && (right.set == left || right.set == Reg::ALL) {
            return left;
        }
        if right.holds && left == Reg::ALL {
            return right.set;
        }
        if let Some(&set) = self.known_sets.get(&(left, right)) {
            return set;
        }
        let changes = self.changes[left.index()].max(self.changes[right.set.index()]);
        let dst = self.set(changes.min(Changes::Often));
        let op = match right {
            Asked {
                set: right,
                holds: true,
            } => Op::Both { dst, left, right },
            Asked {
                set: right,
                holds: false,
            } => Op::Without { dst, left, right },
        };
        if changes != Changes::Within {
            self.known_sets.insert((left, right), dst);
        }
        match changes {
            Changes::Seldom => self.out.settling.push(op),
            _ => self.out.ops.push(op),
        }
        dst
    }

    fn steps(&mut self, search: &SearchPlan) -> Vec<SearchStep> {
        let step = |seek: &Seek| {
            let asked = self.ask(&seek.properties);
            let tests = seek.predicates.iter().map(|&(relates, to, holds)| Test {
                list: self.place(relates),
                to,
                holds,
            });
            let mut tests: Vec<Test> = tests.collect();
            // A row that is known leaves few values for the facts that are computed.
            tests.sort_by_key(|test| !test.holds || !matches!(test.list, Place::Derived(_, Argument::Second)));
            SearchStep {
                among: self.combine(asked),
                tests: Range::extend(&mut self.out.tests, tests),
            }
        };
        search.iter().map(step).collect()
    }

    fn place(&mut self, relates: Relates) -> Place {
        let Relates::By(predicate, axis) = relates else {
            return Place::Same;
        };
        if let Home::Rows(rows) = self.out.homes[predicate.index()] {
            return Place::Derived(rows, axis);
        }
        let list = List(predicate, axis);
        let known = self.out.lists.iter().position(|&known| known == list);
        Place::Input(known.unwrap_or_else(|| {
            self.out.lists.push(list);
            self.out.lists.len() - 1
        }))
    }
}
