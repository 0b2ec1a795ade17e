//! Grounding: two programs over a fixed set of individuals, as one propositional circuit.
//!
//! Every base fact is a variable that both programs share. Every derived fact that the condition needs is a gate. Equal
//! gates are shared, so clauses that differ only in names and order cost nothing, and equal rules are equivalent by
//! construction.

use crate::analysis::diff::confusion::{Confusion, Image};
use crate::analysis::diff::pair::{Functions, Individual, ScopeRows, Side};
use crate::analysis::diff::sat::{Lit, Outcome, Solver};
use crate::check::{Atom, Clause, Constraint, DeclaredConstraint, Literal, PredicateId, Term, VarId};
use crate::syntax::ast::{BaseType, Comparison};
use crate::value::Value;
use std::collections::{BTreeMap, BTreeSet, HashMap};

/// The circuit would exceed its limits.
pub(super) struct TooLarge;

/// A base predicate, by its position among the shared ones, with the individuals of a row.
pub(super) type BaseFact = (usize, Vec<usize>);

pub(super) struct Circuit<'a> {
    sides: [&'a Side<'a>; 2],
    individuals: &'a [Individual],
    functions: &'a Functions,
    view: ScopeRows,
    pub(super) solver: Solver,
    yes: Lit,
    /// The conjunctions by their sorted inputs. Lookup only, never iterated.
    gates: HashMap<Vec<Lit>, Lit>,
    pub(super) atoms: BTreeMap<BaseFact, Lit>,
    /// The same facts in the order of their first use.
    asked: Vec<BaseFact>,
    /// The derived facts by side, predicate, row and, in a recursive stratum, round. Lookup only, never iterated.
    derived: HashMap<(usize, PredicateId, Vec<usize>, usize), Lit>,
    /// The unrolled recursive strata, by side.
    unrolled: BTreeSet<(usize, usize)>,
    /// The positions of constants among the individuals, by side.
    places: [HashMap<(BaseType, Value), Option<usize>>; 2],
    /// The literals that switch constraints on. Without any, all constraints hold.
    switches: Vec<Lit>,
    /// The number of the switch of a constraint, by side and position.
    switch_of: [Vec<usize>; 2],
    /// The number of literals, and rows of literals with `_`, that may still be instantiated.
    pub(super) literals_left: usize,
    /// The number of derived facts being expanded, each for the one before.
    depth: usize,
    /// The maps that the second side may apply to concepts.
    pub(super) confusion: Option<&'a Confusion>,
    /// The facts of the scene, if they do not vary.
    pub(super) fixed: Option<&'a BTreeSet<BaseFact>>,
}

/// Maximum length of a chain of derived facts, and maximum number of variables in a clause. The expansion recurses over
/// both.
const DEPTH_MAX: usize = 64;

impl<'a> Circuit<'a> {
    /// Creates a circuit that adds to the formula of a solver.
    pub(super) fn over(
        mut solver: Solver,
        sides: [&'a Side<'a>; 2],
        (individuals, functions): (&'a [Individual], &'a Functions),
        view: ScopeRows,
        literals_left: usize,
    ) -> Self {
        let yes = solver.fresh();
        solver.add(&[yes]);
        Circuit {
            sides,
            individuals,
            functions,
            view,
            solver,
            yes,
            gates: HashMap::new(),
            atoms: BTreeMap::new(),
            asked: Vec::new(),
            derived: HashMap::new(),
            unrolled: BTreeSet::new(),
            places: [HashMap::new(), HashMap::new()],
            switches: Vec::new(),
            switch_of: [Vec::new(), Vec::new()],
            literals_left,
            depth: 0,
            confusion: None,
            fixed: None,
        }
    }

    /// Returns the solver with the formula.
    pub(super) fn into_solver(self) -> Solver {
        self.solver
    }

    // --- gates

    pub(super) fn all(&mut self, mut inputs: Vec<Lit>) -> Lit {
        inputs.sort_unstable();
        inputs.dedup();
        inputs.retain(|&input| input != self.yes);
        if inputs.contains(&!self.yes) || inputs.windows(2).any(|pair| pair[0] == !pair[1]) {
            return !self.yes;
        }
        match inputs.as_slice() {
            [] => return self.yes,
            &[only] => return only,
            _ => {}
        }
        if let Some(&known) = self.gates.get(&inputs) {
            return known;
        }
        let gate = self.solver.fresh();
        let mut back: Vec<Lit> = inputs.iter().map(|&input| !input).collect();
        for &input in &inputs {
            self.solver.add(&[!gate, input]);
        }
        back.push(gate);
        self.solver.add(&back);
        self.gates.insert(inputs, gate);
        gate
    }

    pub(super) fn any(&mut self, inputs: Vec<Lit>) -> Lit {
        let negated = inputs.into_iter().map(|input| !input).collect();
        !self.all(negated)
    }

    pub(super) fn differ(&mut self, a: Lit, b: Lit) -> Lit {
        let (left, right) = (self.all(vec![a, !b]), self.all(vec![!a, b]));
        self.any(vec![left, right])
    }

    /// Returns the gate that is true.
    pub(super) fn yes(&self) -> Lit {
        self.yes
    }

    /// Returns whether the gate is known to be false.
    pub(super) fn is_no(&self, lit: Lit) -> bool {
        lit == !self.yes
    }

    // --- facts

    /// Returns the gate for a row of a predicate on one side.
    pub(super) fn fact(&mut self, side: usize, predicate: PredicateId, row: &[usize]) -> Result<Lit, TooLarge> {
        self.holds(side, predicate, row, None)
    }

    /// `round`: the recursive stratum that is being unrolled, and the requested round.
    fn holds(
        &mut self,
        side: usize,
        predicate: PredicateId,
        row: &[usize],
        round: Option<(usize, usize)>,
    ) -> Result<Lit, TooLarge> {
        let sides = self.sides;
        let program = sides[side];
        if !program.rules.predicates[predicate.index()].derived {
            return self.base(side, predicate, row);
        }
        let stratum = program.stratum[predicate.index()];
        let recursive = stratum.is_some_and(|stratum| program.rules.strata[stratum].recursive);
        let round_given = matches!((stratum, round), (Some(own), Some((other, _))) if own == other);
        let round = match (stratum, round) {
            (Some(own), Some((stratum, round))) if own == stratum => round,
            (Some(stratum), _) if recursive => self.rounds(side, stratum)?,
            _ => 1,
        };
        if round == 0 {
            return Ok(!self.yes);
        }
        let key = (side, predicate, row.to_vec(), round);
        if let Some(&known) = self.derived.get(&key) {
            return Ok(known);
        }
        let inner = stratum.filter(|_| recursive).map(|stratum| (stratum, round - 1));
        if let (Some((stratum, before)), false) = (inner, round_given)
            && self.unrolled.insert((side, stratum))
        {
            self.unroll(side, stratum, before)?;
        }
        self.depth += 1;
        if self.depth > DEPTH_MAX {
            return Err(TooLarge);
        }
        let mut ways = Vec::new();
        for &clause in &program.clauses[predicate.index()] {
            self.ways(side, clause, row, inner, &mut ways)?;
        }
        self.depth -= 1;
        let gate = self.any(ways);
        self.derived.insert(key, gate);
        Ok(gate)
    }

    /// Expands the first rounds of a recursive stratum in order, so that each depends only on the previous one.
    fn unroll(&mut self, side: usize, stratum: usize, rounds: usize) -> Result<(), TooLarge> {
        let sides = self.sides;
        let rules = sides[side].rules;
        for round in 1..=rounds {
            for &predicate in &rules.strata[stratum].predicates {
                let mut rows: Vec<Vec<usize>> = vec![Vec::new()];
                for column in &rules.predicates[predicate.index()].columns {
                    rows = (rows.iter())
                        .flat_map(|row| {
                            self.of(column.base)
                                .map(move |value| row.iter().copied().chain([value]).collect())
                        })
                        .collect();
                }
                for row in rows {
                    self.holds(side, predicate, &row, Some((stratum, round)))?;
                }
            }
        }
        Ok(())
    }

    /// Returns the number of possible facts of the stratum, which bounds the rounds: each round but the last adds a
    /// fact.
    fn rounds(&self, side: usize, stratum: usize) -> Result<usize, TooLarge> {
        let rules = self.sides[side].rules;
        let mut count = 0_usize;
        for predicate in &rules.strata[stratum].predicates {
            let columns = &rules.predicates[predicate.index()].columns;
            let rows = columns.iter().fold(1_usize, |rows, column| {
                rows.saturating_mul(self.of(column.base).count())
            });
            count = count.saturating_add(rows);
        }
        if count <= 256 { Ok(count) } else { Err(TooLarge) }
    }

    fn of(&self, base: BaseType) -> impl Iterator<Item = usize> + use<'a> {
        let individuals = self.individuals;
        (0..individuals.len()).filter(move |&index| individuals[index].base() == base)
    }

    fn base(&mut self, side: usize, predicate: PredicateId, row: &[usize]) -> Result<Lit, TooLarge> {
        let program = self.sides[side];
        if program.facts.contains(&(predicate, row.to_vec())) {
            return Ok(self.yes);
        }
        let Some(base) = program.base[predicate.index()] else {
            return Ok(!self.yes);
        };
        let fits = |(column, &at): (usize, &usize)| match &self.individuals[at] {
            Individual::Symbol(text) => self.functions.allow(base, column, row.len(), text),
            Individual::Number(_) => true,
        };
        if !row.iter().enumerate().all(fits) {
            return Ok(!self.yes);
        }
        if let Some(confusion) = self.confusion.filter(|_| side == 1)
            && let Some(concept) = confusion.bases.iter().position(|(known, _)| *known == base)
        {
            let choices = &confusion.choices[concept];
            self.literals_left = self.literals_left.checked_sub(choices.len()).ok_or(TooLarge)?;
            let mut ways = Vec::new();
            for &(image, chosen) in choices {
                let value = match image {
                    Image::Constant(true) => self.yes,
                    Image::Constant(false) => !self.yes,
                    Image::Concept { position, negated } => {
                        let value = self.base(0, confusion.bases[position].1, row)?;
                        if negated { !value } else { value }
                    }
                };
                ways.push(self.all(vec![chosen, value]));
            }
            return Ok(self.any(ways));
        }
        let sees = match self.view {
            ScopeRows::Full => true,
            ScopeRows::Selves => row.iter().all(|&entity| entity == row[0]),
            ScopeRows::Free => false,
        };
        if sees && program.scopes.contains(&predicate) {
            return Ok(self.yes);
        }
        let key = (base, row.to_vec());
        if let Some(&known) = self.atoms.get(&key) {
            return Ok(known);
        }
        self.literals_left = self.literals_left.checked_sub(1).ok_or(TooLarge)?;
        if let Some(facts) = self.fixed {
            return Ok(if facts.contains(&key) { self.yes } else { !self.yes });
        }
        let fresh = self.solver.fresh();
        self.asked.push(key.clone());
        self.atoms.insert(key, fresh);
        Ok(fresh)
    }

    // --- clauses

    /// Appends the conjunctions by which a clause derives the row, one for each assignment of its other variables.
    fn ways(
        &mut self,
        side: usize,
        clause: &'a Clause,
        row: &[usize],
        round: Option<(usize, usize)>,
        ways: &mut Vec<Lit>,
    ) -> Result<(), TooLarge> {
        if clause.variables.len() > DEPTH_MAX {
            return Err(TooLarge);
        }
        let mut bound: Vec<Option<usize>> = vec![None; clause.variables.len()];
        let columns = &self.sides[side].rules.predicates[clause.head.predicate.index()].columns;
        for ((term, column), &value) in clause.head.terms.iter().zip(columns).zip(row) {
            match *term {
                Term::Variable(variable) => {
                    if *bound[variable.index()].get_or_insert(value) != value {
                        return Ok(());
                    }
                }
                constant => {
                    if self.value(side, constant, column.base, &bound) != Some(value) {
                        return Ok(());
                    }
                }
            }
        }
        // The variables in the order of the body, with the literals that each one completes.
        let mut order: Vec<usize> = Vec::new();
        let mut ready: Vec<Vec<&'a Literal>> = vec![Vec::new()];
        for literal in &clause.body {
            for variable in literal.variables().map(VarId::index) {
                if bound[variable].is_none() && !order.contains(&variable) {
                    order.push(variable);
                    ready.push(Vec::new());
                }
            }
            let places = literal
                .variables()
                .filter_map(|variable| order.iter().position(|&other| other == variable.index()));
            let at = places.max().map_or(0, |position| position + 1);
            ready[at].push(literal);
        }
        let bases: Vec<BaseType> = order
            .iter()
            .map(|&variable| self.base_of(side, clause, variable))
            .collect();
        let mut expansion = Expansion {
            side,
            round,
            order,
            bases,
            ready,
            bound,
            inputs: Vec::new(),
        };
        self.choose(&mut expansion, 0, ways)
    }

    /// Adds the literals that are ready at this depth, then iterates over the values of the next variable.
    fn choose(&mut self, expansion: &mut Expansion<'a>, depth: usize, ways: &mut Vec<Lit>) -> Result<(), TooLarge> {
        let mark = expansion.inputs.len();
        for index in 0..expansion.ready[depth].len() {
            let literal = expansion.ready[depth][index];
            self.literals_left = self.literals_left.checked_sub(1).ok_or(TooLarge)?;
            let lit = self.literal(expansion, literal)?;
            if self.is_no(lit) {
                expansion.inputs.truncate(mark);
                return Ok(());
            }
            expansion.inputs.push(lit);
        }
        if let Some(&variable) = expansion.order.get(depth) {
            for value in self.of(expansion.bases[depth]) {
                expansion.bound[variable] = Some(value);
                self.choose(expansion, depth + 1, ways)?;
            }
            expansion.bound[variable] = None;
        } else {
            ways.push(self.all(expansion.inputs.clone()));
        }
        expansion.inputs.truncate(mark);
        Ok(())
    }

    fn literal(&mut self, expansion: &Expansion<'a>, literal: &'a Literal) -> Result<Lit, TooLarge> {
        match literal {
            Literal::Positive(atom) | Literal::Guard(atom) => self.some(expansion, atom),
            Literal::Negative(atom) => Ok(!self.some(expansion, atom)?),
            Literal::Compare {
                op, left, right, base, ..
            } => {
                let mut value = |term| self.value(expansion.side, term, *base, &expansion.bound);
                let holds = match (value(*left), value(*right)) {
                    (Some(left), Some(right)) => self.compare(*op, left, right),
                    _ => false,
                };
                Ok(if holds { self.yes } else { !self.yes })
            }
            // `trial` compares rules with such literals.
            Literal::Compute { .. } | Literal::Aggregate { .. } => Ok(!self.yes),
        }
    }

    /// Returns the gate for "some row matches the atom"; `_` matches any value.
    fn some(&mut self, expansion: &Expansion<'a>, atom: &'a Atom) -> Result<Lit, TooLarge> {
        let columns = &self.sides[expansion.side].rules.predicates[atom.predicate.index()].columns;
        let mut rows: Vec<Vec<usize>> = vec![Vec::new()];
        for (column, &term) in columns.iter().zip(&atom.terms) {
            let values: Vec<usize> = match term {
                Term::Wildcard => self.of(column.base).collect(),
                _ => self
                    .value(expansion.side, term, column.base, &expansion.bound)
                    .into_iter()
                    .collect(),
            };
            if values.len() > 1 {
                let many = rows.len().saturating_mul(values.len());
                self.literals_left = self.literals_left.checked_sub(many).ok_or(TooLarge)?;
            }
            rows = (rows.iter())
                .flat_map(|row| {
                    values
                        .iter()
                        .map(move |&value| row.iter().copied().chain([value]).collect())
                })
                .collect();
        }
        let mut lits = Vec::new();
        for row in rows {
            lits.push(self.holds(expansion.side, atom.predicate, &row, expansion.round)?);
        }
        Ok(self.any(lits))
    }

    fn compare(&self, op: Comparison, left: usize, right: usize) -> bool {
        let order = self.individuals[left].cmp(&self.individuals[right]);
        match op {
            Comparison::Equal => order.is_eq(),
            Comparison::NotEqual => order.is_ne(),
            Comparison::Less => order.is_lt(),
            Comparison::LessEqual => order.is_le(),
            Comparison::Greater => order.is_gt(),
            Comparison::GreaterEqual => order.is_ge(),
            // `trial` compares rules with such literals.
            Comparison::Match | Comparison::NotMatch | Comparison::Contains | Comparison::NotContains => false,
        }
    }

    fn value(&mut self, side: usize, term: Term, base: BaseType, bound: &[Option<usize>]) -> Option<usize> {
        match term {
            Term::Variable(variable) => bound[variable.index()],
            Term::Constant(value) => *self.places[side].entry((base, value)).or_insert_with(|| {
                let wanted = self.sides[side].individual(value, base);
                self.individuals.iter().position(|individual| *individual == wanted)
            }),
            Term::Wildcard => None,
        }
    }

    /// Returns the base type of a variable, from its first occurrence.
    fn base_of(&self, side: usize, clause: &Clause, variable: usize) -> BaseType {
        let is = |term: &Term| matches!(term, Term::Variable(other) if other.index() == variable);
        for literal in &clause.body {
            match literal {
                Literal::Positive(atom) | Literal::Negative(atom) | Literal::Guard(atom) => {
                    if let Some(column) = atom.terms.iter().position(is) {
                        return self.sides[side].rules.predicates[atom.predicate.index()].columns[column].base;
                    }
                }
                Literal::Compare { left, right, base, .. } => {
                    if is(left) || is(right) {
                        return *base;
                    }
                }
                Literal::Compute { .. } | Literal::Aggregate { .. } => {}
            }
        }
        BaseType::Symbol
    }

    // --- constraints

    /// Makes constraints hold only if they are switched on; see [`Circuit::solve_with`]. Comes before
    /// [`Circuit::constraints`].
    pub(super) fn add_switches(&mut self, switch_of: &[Vec<usize>; 2]) {
        let count = switch_of.iter().flatten().max().map_or(0, |last| last + 1);
        self.switches = (0..count).map(|_| self.solver.fresh()).collect();
        self.switch_of = switch_of.clone();
    }

    /// Searches for a model with the constraints of these switches.
    pub(super) fn solve_with(&mut self, switches: &BTreeSet<usize>, conflicts: &mut u64) -> Outcome {
        let assumptions: Vec<Lit> = switches.iter().map(|&number| self.switches[number]).collect();
        self.solver.solve(&assumptions, conflicts)
    }

    /// Returns whether the last search found no model because of this switch.
    pub(super) fn has_failed(&self, switch: usize) -> bool {
        self.solver.has_failed(self.switches[switch])
    }

    /// Adds the constraints of both sides to the circuit, for all facts in it and those in the source.
    pub(super) fn constraints(&mut self) -> Result<(), TooLarge> {
        let sides = self.sides;
        // Constraints hold for the scene, not for what perception reports.
        let constrained = if self.confusion.is_some() { 1 } else { 2 };
        for (side, program) in sides.into_iter().enumerate().take(constrained) {
            let mut facts: Vec<&(PredicateId, Vec<usize>)> = program.facts.iter().collect();
            facts.sort_unstable();
            for (predicate, row) in facts {
                self.constrain(side, *predicate, row)?;
            }
            // Every entity sees itself, so all are in the domain of a constraint over the type of a scope.
            if self.view == ScopeRows::Free {
                continue;
            }
            for (at, DeclaredConstraint { domain, .. }) in program.rules.constraints.iter().enumerate() {
                if domain.iter().any(|(predicate, _)| program.scopes.contains(predicate)) {
                    let (individuals, functions) = (self.individuals, self.functions);
                    let is_entity = |at: &usize| !functions.have_value(&individuals[*at]);
                    for value in self.of(BaseType::Symbol).filter(is_entity) {
                        self.within(side, at, value, Vec::new())?;
                    }
                }
            }
        }
        let predicates: [HashMap<usize, PredicateId>; 2] = sides.map(|program| {
            let base = (0..).map(PredicateId).zip(&program.base);
            base.filter_map(|(predicate, base)| Some(((*base)?, predicate)))
                .collect()
        });
        let mut done = 0;
        let mut queue: Vec<BaseFact> = self.atoms.keys().cloned().collect();
        while let Some((base, row)) = queue.get(done).cloned() {
            done += 1;
            for (side, predicates) in predicates.iter().enumerate().take(constrained) {
                if let Some(&predicate) = predicates.get(&base) {
                    self.constrain(side, predicate, &row)?;
                }
            }
            // The facts added in this step; all earlier ones are in the queue.
            let mut more = self.asked.split_off(queue.len());
            more.sort_unstable();
            queue.extend(more.iter().cloned());
            self.asked.extend(more);
        }
        self.require_functions();
        Ok(())
    }

    /// Requires that the rows of functions differ in more than the last column.
    fn require_functions(&mut self) {
        let mut before: Vec<(BaseFact, Lit)> = Vec::new();
        for ((base, row), &lit) in &self.atoms {
            let Some((_, key)) = row.split_last().filter(|_| self.functions.include(*base)) else {
                continue;
            };
            // Atoms are sorted, so equal keys follow each other.
            before.retain(|((other, known), _)| other == base && known[..] == *key);
            for (_, other) in &before {
                self.solver.add(&[!*other, !lit]);
            }
            before.push(((*base, key.to_vec()), lit));
        }
    }

    /// Adds the constraints of one side that concern a fact.
    fn constrain(&mut self, side: usize, predicate: PredicateId, row: &[usize]) -> Result<(), TooLarge> {
        let program = self.sides[side];
        let reversed: Vec<usize> = row.iter().rev().copied().collect();
        for &at in &program.constraints[predicate.index()] {
            let DeclaredConstraint { constraint, domain, .. } = &program.rules.constraints[at];
            let fact = self.base(side, predicate, row)?;
            let conclusion = match *constraint {
                Constraint::Irreflexive(a) | Constraint::Asymmetric(a) if a == predicate && row[0] == row[1] => {
                    !self.yes
                }
                Constraint::Asymmetric(a) if a == predicate => !self.base(side, a, &reversed)?,
                Constraint::Symmetric(a) if a == predicate => self.base(side, a, &reversed)?,
                Constraint::Implies(a, b) if a == predicate => self.base(side, b, row)?,
                Constraint::Disjoint(a, b) if a == predicate => !self.base(side, b, row)?,
                Constraint::Disjoint(a, b) if b == predicate => !self.base(side, a, row)?,
                Constraint::Covering(_) | Constraint::Reflexive(_) => {
                    for &(_, column) in domain.iter().filter(|(other, _)| *other == predicate) {
                        self.within(side, at, row[column], vec![!fact])?;
                    }
                    continue;
                }
                _ => continue,
            };
            self.require(side, at, vec![!fact, conclusion]);
        }
        Ok(())
    }

    /// Adds a clause that follows from a constraint.
    fn require(&mut self, side: usize, constraint: usize, mut clause: Vec<Lit>) {
        if let Some(&number) = self.switch_of[side].get(constraint) {
            clause.push(!self.switches[number]);
        }
        self.solver.add(&clause);
    }

    /// Adds a covering or reflexive constraint for a value of its domain, as one clause with the literals of `unless`.
    fn within(&mut self, side: usize, constraint: usize, value: usize, unless: Vec<Lit>) -> Result<(), TooLarge> {
        let mut clause = unless;
        let rules = self.sides[side].rules;
        match &rules.constraints[constraint].constraint {
            Constraint::Covering(predicates) => {
                for &predicate in predicates {
                    clause.push(self.base(side, predicate, &[value])?);
                }
            }
            Constraint::Reflexive(predicate) => clause.push(self.base(side, *predicate, &[value, value])?),
            _ => return Ok(()),
        }
        self.require(side, constraint, clause);
        Ok(())
    }
}

/// A clause during expansion.
struct Expansion<'a> {
    side: usize,
    round: Option<(usize, usize)>,
    order: Vec<usize>,
    bases: Vec<BaseType>,
    ready: Vec<Vec<&'a Literal>>,
    bound: Vec<Option<usize>>,
    inputs: Vec<Lit>,
}
