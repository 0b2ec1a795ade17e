//! Two rule sets, prepared for the search.

use crate::analysis::diff::Options;
use crate::check::{Clause, Constraint, DeclaredConstraint, Literal, Predicate, PredicateId, Rules, Term, TypeId};
use crate::codes;
use crate::diag::{Diagnostic, did_you_mean};
use crate::symbol::Symbol;
use crate::syntax::ast::BaseType;
use crate::value::{Value, record_text};
use std::collections::{BTreeMap, BTreeSet, HashMap, HashSet};

/// Two rule sets, prepared for the search.
pub(super) struct Pair<'a> {
    pub(super) base: Vec<Base>,
    pub(super) outputs: Vec<Output>,
    pub(super) sides: [Side<'a>; 2],
    /// The rows of scopes for which to search, in this order.
    pub(super) views: Vec<ScopeRows>,
    pub(super) functions: Functions,
}

impl<'a> Pair<'a> {
    pub(super) fn new(left: &'a Rules, right: &'a Rules, options: &Options) -> Result<Pair<'a>, Vec<Diagnostic>> {
        let base = shared_base(left, right)?;
        let outputs = outputs(left, right, options)?;
        let mut sides = [left, right].map(|rules| side(rules, &base));
        // A predicate that guards on one side is complete on both.
        let scopes: BTreeSet<usize> = (sides.iter())
            .flat_map(|side| side.scopes.iter().filter_map(|scope| side.base[scope.index()]))
            .collect();
        for side in &mut sides {
            let shared = (side.base.iter().zip((0..).map(PredicateId)))
                .filter(|(position, _)| position.is_some_and(|position| scopes.contains(&position)));
            side.scopes = shared.map(|(_, predicate)| predicate).collect();
        }
        let open = match options.self_sight {
            true => ScopeRows::Selves,
            false => ScopeRows::Free,
        };
        let functions = Functions::new([left, right], &base);
        let is_scoped = sides.iter().any(|side| !side.scopes.is_empty());
        Ok(Pair {
            base,
            outputs,
            sides,
            views: if is_scoped {
                vec![ScopeRows::Full, open]
            } else {
                vec![open]
            },
            functions,
        })
    }
}

/// The base predicates whose last column is a function of the others.
#[derive(Default)]
pub(super) struct Functions {
    /// By position among the shared base predicates: the symbols in their range, if it has symbols.
    ranges: BTreeMap<usize, Option<Vec<String>>>,
    /// The constants of the rules that stand in no column of entities.
    values: BTreeSet<String>,
    /// The columns in which they may stand, by base predicate.
    value_columns: BTreeSet<(usize, usize)>,
}

impl Functions {
    pub(super) fn new(rules: [&Rules; 2], base: &[Base]) -> Functions {
        let mut ranges = BTreeMap::new();
        for (rules, function) in rules
            .iter()
            .flat_map(|rules| rules.functions.iter().map(move |function| (rules, function)))
        {
            let name = &rules.predicates[function.predicate.index()].name;
            if let Some(position) = base.iter().position(|base| base.name == *name) {
                ranges.insert(position, function.symbols.clone());
            }
        }
        Functions {
            ranges,
            ..Functions::default()
        }
    }

    /// Excludes scenes whose entities have the names of constants that stand only in columns of other types.
    pub(super) fn exclude_values(&mut self, side: &Side<'_>, entity: TypeId) {
        let rules = side.rules;
        let types = |predicate: PredicateId| rules.predicates[predicate.index()].columns.iter();
        for (predicate, base) in (0..).map(PredicateId).zip(&side.base) {
            let columns = types(predicate).zip(0..).filter(|(column, _)| column.ty != entity);
            self.value_columns
                .extend(columns.filter_map(|(_, column)| Some(((*base)?, column))));
        }
        let mut of_entities = BTreeSet::new();
        for clause in &rules.clauses {
            let atoms = clause.body.iter().filter_map(Literal::atom).chain([&clause.head]);
            let terms = atoms.flat_map(|atom| atom.terms.iter().zip(types(atom.predicate)));
            for (term, column) in terms {
                let Term::Constant(value) = term else { continue };
                if let Individual::Symbol(text) = side.individual(*value, column.base) {
                    match column.ty == entity {
                        true => of_entities.insert(text),
                        false => self.values.insert(text),
                    };
                }
            }
            // Comparisons have no columns, so their constants may be entities.
            for literal in &clause.body {
                if let Literal::Compare { base, .. } = literal {
                    let constants = literal.terms().filter_map(|term| match term {
                        Term::Constant(value) => Some(side.individual(*value, *base).shown()),
                        Term::Variable(_) | Term::Wildcard => None,
                    });
                    of_entities.extend(constants);
                }
            }
        }
        self.values.retain(|text| !of_entities.contains(text));
    }

    /// Returns the symbols that are no entities.
    pub(super) fn symbols(&self) -> impl Iterator<Item = &String> {
        self.ranges.values().flatten().flatten().chain(&self.values)
    }

    /// Returns whether a symbol is no entity.
    pub(super) fn have_symbol(&self, symbol: &str) -> bool {
        self.symbols().any(|known| known == symbol)
    }

    /// Returns whether a value is a symbol that is no entity.
    pub(super) fn have_value(&self, value: &Individual) -> bool {
        matches!(value, Individual::Symbol(text) if self.have_symbol(text))
    }

    /// Returns whether a predicate is one of them.
    pub(super) fn include(&self, base: usize) -> bool {
        self.ranges.contains_key(&base)
    }

    /// Returns whether a symbol can stand in a column of a base predicate with this many columns.
    pub(super) fn allow(&self, base: usize, column: usize, columns: usize, symbol: &str) -> bool {
        match self.ranges.get(&base) {
            Some(Some(range)) if column + 1 == columns => range.iter().any(|known| known == symbol),
            _ if self.value_columns.contains(&(base, column)) && self.values.contains(symbol) => true,
            _ => !self.have_symbol(symbol),
        }
    }
}

/// The rows of a scope.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ScopeRows {
    /// Every entity sees every other and itself.
    Full,
    /// Every entity sees itself; the other rows vary.
    Selves,
    /// All rows vary, like those of another predicate.
    Free,
}

/// One of the two programs, prepared for the search.
#[derive(Clone)]
pub(super) struct Side<'a> {
    pub(super) rules: &'a Rules,
    /// The clauses, including facts, by [`PredicateId`].
    pub(super) clauses: Vec<Vec<&'a Clause>>,
    /// The strata, by [`PredicateId`].
    pub(super) stratum: Vec<Option<usize>>,
    /// The positions among the shared base predicates, by [`PredicateId`].
    pub(super) base: Vec<Option<usize>>,
    /// The facts in the source for predicates without rules; the rows contain positions of individuals.
    pub(super) facts: HashSet<(PredicateId, Vec<usize>)>,
    /// The base predicates that serve as guards on either side.
    pub(super) scopes: BTreeSet<PredicateId>,
    /// The positions of the constraints that concern a fact, by [`PredicateId`].
    pub(super) constraints: Vec<Vec<usize>>,
}

/// A value. Strings compare as text, numbers as numbers.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(super) enum Individual {
    Symbol(String),
    Number(i32),
}

impl Individual {
    pub(super) fn base(&self) -> BaseType {
        match self {
            Individual::Symbol(_) => BaseType::Symbol,
            Individual::Number(_) => BaseType::Number,
        }
    }

    pub(super) fn shown(&self) -> String {
        match self {
            Individual::Symbol(text) => text.clone(),
            Individual::Number(number) => number.to_string(),
        }
    }
}

impl Side<'_> {
    pub(super) fn individual(&self, value: Value, base: BaseType) -> Individual {
        match base {
            BaseType::Number | BaseType::Unsigned | BaseType::Float => Individual::Number(value.as_number()),
            BaseType::Record => Individual::Symbol(record_text(value, &self.rules.symbols)),
            BaseType::Symbol => Individual::Symbol(
                self.rules
                    .symbols
                    .resolve(Symbol(value.0))
                    .unwrap_or_default()
                    .to_owned(),
            ),
        }
    }
}

/// A predicate to compare.
pub(super) struct Output {
    pub(super) name: String,
    pub(super) columns: Vec<BaseType>,
    pub(super) ids: [PredicateId; 2],
}

/// A base predicate.
pub(super) struct Base {
    pub(super) name: String,
}

fn shared_base(left: &Rules, right: &Rules) -> Result<Vec<Base>, Vec<Diagnostic>> {
    let mut base: Vec<Base> = Vec::new();
    let mut known: HashSet<&str> = HashSet::new();
    let mut faults = Vec::new();
    let by_name = [left, right].map(Rules::predicates_by_name);
    for (rules, other, twins) in [(left, right, &by_name[1]), (right, left, &by_name[0])] {
        for predicate in rules.predicates.iter().filter(|predicate| predicate.input) {
            let columns: Vec<BaseType> = predicate.columns.iter().map(|column| column.base).collect();
            let twin = twins
                .get(predicate.name.as_str())
                .map(|id| &other.predicates[id.index()]);
            if let Some(twin) = twin {
                let fits = twin
                    .columns
                    .iter()
                    .map(|column| column.base)
                    .eq(columns.iter().copied());
                let message = match (fits, twin.derived && twin.edb.is_none()) {
                    (true, false) => None,
                    (_, true) => Some(format!(
                        "`{}` is input on one side and derived on the other",
                        predicate.name
                    )),
                    (false, _) => Some(format!("`{}` has different columns on the two sides", predicate.name)),
                };
                if let Some(message) = message {
                    faults.push(
                        Diagnostic::new(codes::RULE_MISMATCH, message)
                            .at(predicate.span, "")
                            .also(twin.span, "the other one"),
                    );
                    continue;
                }
            }
            if known.insert(&predicate.name) {
                base.push(Base {
                    name: predicate.name.clone(),
                });
            }
        }
    }
    if faults.is_empty() { Ok(base) } else { Err(faults) }
}

/// Returns the base predicates that affect the outputs: those that their clauses read, and those that constraints
/// imply.
pub(super) fn relevant(rules: [&Rules; 2], base: &[Base], outputs: &[Output]) -> BTreeSet<usize> {
    let positions = positions(base);
    let mut relevant = BTreeSet::new();
    for (side, rules) in rules.into_iter().enumerate() {
        let mut reads = vec![Vec::new(); rules.predicates.len()];
        for clause in &rules.clauses {
            let atoms = clause.body.iter().filter_map(Literal::atom);
            reads[clause.head.predicate.index()].extend(atoms.map(|atom| atom.predicate));
        }
        for DeclaredConstraint { constraint, domain, .. } in &rules.constraints {
            let mut implied = |premise: PredicateId, predicate: PredicateId| reads[premise.index()].push(predicate);
            match *constraint {
                Constraint::Implies(one, other) => implied(one, other),
                Constraint::Reflexive(other) => domain.iter().for_each(|&(one, _)| implied(one, other)),
                Constraint::Covering(ref others) => {
                    for &(one, _) in domain {
                        others.iter().for_each(|&other| implied(one, other));
                    }
                }
                Constraint::Disjoint(..)
                | Constraint::Irreflexive(_)
                | Constraint::Symmetric(_)
                | Constraint::Asymmetric(_) => {}
            }
        }
        let mut open: Vec<PredicateId> = outputs.iter().map(|output| output.ids[side]).collect();
        let mut seen = BTreeSet::new();
        while let Some(predicate) = open.pop() {
            if seen.insert(predicate) {
                open.extend(&reads[predicate.index()]);
                relevant.extend(positions.get(rules.predicates[predicate.index()].name.as_str()));
            }
        }
    }
    relevant
}

/// Returns the positions of the base predicates by name.
fn positions(base: &[Base]) -> HashMap<&str, usize> {
    base.iter().map(|base| base.name.as_str()).zip(0..).collect()
}

fn outputs(left: &Rules, right: &Rules, options: &Options) -> Result<Vec<Output>, Vec<Diagnostic>> {
    let mut names: Vec<&str> = options.predicates.iter().map(String::as_str).collect();
    if names.is_empty() {
        let mut known: HashSet<&str> = HashSet::new();
        for predicate in left
            .predicates
            .iter()
            .chain(&right.predicates)
            .filter(|predicate| predicate.output)
        {
            if known.insert(&predicate.name) {
                names.push(&predicate.name);
            }
        }
    }
    let mut outputs = Vec::new();
    let mut faults = Vec::new();
    let [in_left, in_right] = [left, right].map(Rules::predicates_by_name);
    for name in names {
        let (Some(&a), Some(&b)) = (in_left.get(name), in_right.get(name)) else {
            let side = match (in_left.contains_key(name), in_right.contains_key(name)) {
                (false, false) => "neither side declares",
                (false, true) => "the left side does not declare",
                _ => "the right side does not declare",
            };
            let message = format!("{side} a predicate `{name}`");
            let fault = Diagnostic::new(codes::RULE_MISMATCH, message);
            let shared = in_left.keys().copied().filter(|name| in_right.contains_key(name));
            let shared: BTreeSet<&str> = shared.collect();
            faults.push(match did_you_mean(name, shared) {
                Some(near) => fault.help(format!("did you mean `{near}`?")),
                None => fault.help("compare only predicates that both sides declare: `--predicates NAME,...`"),
            });
            continue;
        };
        let [x, y] = [(left, a), (right, b)].map(|(rules, id)| &rules.predicates[id.index()]);
        let columns: Vec<BaseType> = x.columns.iter().map(|column| column.base).collect();
        if !y.columns.iter().map(|column| column.base).eq(columns.iter().copied()) {
            let message = format!("`{name}` has different columns on the two sides");
            faults.push(
                Diagnostic::new(codes::RULE_MISMATCH, message)
                    .at(x.span, "")
                    .also(y.span, "the other one"),
            );
            continue;
        }
        outputs.push(Output {
            name: name.to_owned(),
            columns,
            ids: [a, b],
        });
    }
    if faults.is_empty() { Ok(outputs) } else { Err(faults) }
}

fn side<'a>(rules: &'a Rules, base: &[Base]) -> Side<'a> {
    let mut clauses = vec![Vec::new(); rules.predicates.len()];
    for clause in &rules.clauses {
        clauses[clause.head.predicate.index()].push(clause);
    }
    let mut stratum = vec![None; rules.predicates.len()];
    for (position, one) in rules.strata.iter().enumerate() {
        for predicate in &one.predicates {
            stratum[predicate.index()] = Some(position);
        }
    }
    let positions = positions(base);
    let position = |predicate: &Predicate| positions.get(predicate.name.as_str()).copied();
    let mut bases: Vec<Option<usize>> = (rules.predicates.iter())
        .map(|predicate| position(predicate).filter(|_| !predicate.derived))
        .collect();
    // Where rules derive further rows of an input predicate, a hidden one has those of the scene.
    for predicate in &rules.predicates {
        if let Some(edb) = predicate.edb {
            bases[edb.index()] = position(predicate);
        }
    }
    let guards = rules
        .clauses
        .iter()
        .flat_map(|clause| &clause.body)
        .filter_map(|literal| match literal {
            Literal::Guard(atom) => Some(atom.predicate),
            _ => None,
        });
    Side {
        rules,
        clauses,
        stratum,
        base: bases,
        facts: HashSet::new(),
        scopes: guards
            .filter(|predicate| !rules.predicates[predicate.index()].derived)
            .collect(),
        constraints: constraints_of(rules),
    }
}

/// Returns the positions of the constraints that name a predicate or have it in their domain, by predicate.
fn constraints_of(rules: &Rules) -> Vec<Vec<usize>> {
    let mut of = vec![Vec::new(); rules.predicates.len()];
    for (at, DeclaredConstraint { constraint, domain, .. }) in rules.constraints.iter().enumerate() {
        let concerned: BTreeSet<PredicateId> = domain
            .iter()
            .map(|&(predicate, _)| predicate)
            .chain(constraint.predicates())
            .collect();
        concerned
            .into_iter()
            .for_each(|predicate| of[predicate.index()].push(at));
    }
    of
}
