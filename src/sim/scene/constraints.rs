//! The integrity constraints that hold in a city: declared ones that its configuration confirms, and further ones that
//! follow from the definitions of predicates and from the agents.

use crate::datalog::{Constraint, DeclaredConstraint, Function, Literal, PredicateId, Rules};
use crate::diag::{Diagnostic, Span};
use crate::predicate::{Definition, Static, Unit};
use crate::sim::codes;
use crate::sim::scene::judge::Verdict;
use crate::sim::scene::theory::{CityTheory, Known, KnownInputs};
use std::collections::HashSet;

/// The integrity constraints of rules in a city.
#[derive(Clone, Debug, Default)]
pub struct CityConstraints {
    /// The constraints that the definitions of predicates imply, and declared ones about which the configuration says
    /// nothing.
    pub by_definition: Vec<DeclaredConstraint>,
    /// These, and those that hold because the city has no other agents.
    pub of_agents: Vec<DeclaredConstraint>,
    /// The predicates without rows in the city.
    pub empty: Vec<PredicateId>,
    /// The faults of declared constraints that the configuration contradicts.
    pub faults: Vec<Diagnostic>,
}

/// The maximum number of predicates of one arity among which constraints are derived.
const DERIVED_MAX: usize = 64;

impl CityTheory {
    /// Returns the constraints that hold for the predicates of rules in this city.
    pub fn constraints(&self, rules: &Rules) -> CityConstraints {
        let inputs = KnownInputs::new(&self.scenario, rules);
        let mut found = Collector::default();
        for declared in &rules.constraints {
            match self.judge(&declared.constraint, &declared.domain, &inputs) {
                Verdict::ByDefinition | Verdict::Unknown => found.keep(declared, false),
                Verdict::OfAgents => found.keep(declared, true),
                Verdict::Contradicted(reason, span) => {
                    let fault = self.contradiction(rules, declared, &inputs, reason, span);
                    found.constraints.faults.push(fault);
                }
            }
        }
        self.derive(rules, &inputs, &mut found);
        found.constraints
    }

    /// Returns the predicates of the rules that the configuration defines as quantities.
    pub fn functions(&self, rules: &Rules) -> Vec<Function> {
        let quantities = self.scenario.predicates.iter().filter_map(|predicate| {
            let unit = predicate.definition.unit()?;
            Some(Function {
                predicate: rules.predicate(&predicate.name.value)?,
                symbols: match unit {
                    Unit::Word(words) => Some(words.names().iter().map(|&name| name.to_owned()).collect()),
                    Unit::Number | Unit::Float => None,
                },
            })
        });
        quantities.collect()
    }

    fn contradiction(
        &self,
        rules: &Rules,
        declared: &DeclaredConstraint,
        inputs: &KnownInputs<'_>,
        reason: String,
        agents: Option<Span>,
    ) -> Diagnostic {
        let message = format!(
            "{} contradicts the configuration `{}`: {reason}",
            declared.constraint.show(rules),
            self.scenario.name
        );
        let mut fault = Diagnostic::new(codes::CONSTRAINT_MISMATCH, message).at(declared.span, "declared here");
        for predicate in declared.constraint.predicates() {
            if let Some(known) = inputs.find(predicate) {
                let name = &known.config.name;
                fault = fault.also(name.span, format!("`{}` is defined here", name.value));
            }
        }
        if let Some(agents) = agents {
            fault = fault.also(agents, "these agents");
        }
        let kind = match (&declared.constraint, agents) {
            (Constraint::Implies(one, _), None) => inputs.find(*one),
            _ => None,
        };
        let kind = kind.and_then(|one| {
            let mut kinds = inputs.list.iter().filter(|known| is_kind(known));
            let implied = kinds.find(|other| {
                !self
                    .defined(&one.config.definition, &other.config.definition)
                    .first_only
            })?;
            Some((one, implied))
        });
        fault.help(match kind {
            Some((one, kind)) => format!(
                "write `.implies {}, {}`, or change the definition",
                one.config.name.value, kind.config.name.value
            ),
            None => "remove the constraint, or change the configuration".to_owned(),
        })
    }

    /// Adds the constraints that hold for inputs which the rules read.
    fn derive(&self, rules: &Rules, inputs: &KnownInputs<'_>, found: &mut Collector) {
        let read = read_inputs(rules, inputs);
        for one in &read {
            self.derive_for_one(rules, *one, inputs, found);
        }
        found.constraints.empty.extend(self.without_roads(rules));
        self.derive_cover(rules, &read, inputs, found);
        for arity in [1, 2] {
            let same = read.iter().filter(|one| one.config.definition.arity() == arity);
            let same = same.filter(|one| !self.is_empty(**one)).take(DERIVED_MAX);
            self.derive_for_pairs(&same.copied().collect::<Vec<_>>(), inputs, found);
        }
    }

    /// Adds the constraints on one predicate.
    fn derive_for_one(&self, rules: &Rules, one: Known<'_>, inputs: &KnownInputs<'_>, found: &mut Collector) {
        let (definition, span) = (&one.config.definition, one.config.name.span);
        if self.is_empty(one) {
            found.constraints.empty.push(one.predicate);
            let no_rows = Constraint::Disjoint(one.predicate, one.predicate);
            found.add(no_rows, Vec::new(), self.agents_or(span), true);
        } else if definition.arity() == 2 {
            for constraint in [Constraint::Irreflexive, Constraint::Symmetric, Constraint::Asymmetric] {
                let constraint = constraint(one.predicate);
                if matches!(self.judge(&constraint, &[], inputs), Verdict::ByDefinition) {
                    found.add(constraint, Vec::new(), span, false);
                }
            }
        }
        if definition.is_reflexive() {
            let ty = rules.predicates[one.predicate.index()].columns[0].ty;
            found.add(Constraint::Reflexive(one.predicate), rules.columns_of(ty), span, false);
        }
    }

    /// Adds the constraint that each agent has one of the kinds.
    fn derive_cover(&self, rules: &Rules, read: &[Known<'_>], inputs: &KnownInputs<'_>, found: &mut Collector) {
        let kinds: Vec<&Known<'_>> = read.iter().filter(|one| is_kind(one)).collect();
        let Some(first) = kinds.first() else { return };
        let cover = Constraint::Covering(kinds.iter().map(|kind| kind.predicate).collect());
        let domain = rules.columns_of(rules.predicates[first.predicate.index()].columns[0].ty);
        if matches!(self.judge(&cover, &domain, inputs), Verdict::ByDefinition) {
            found.add(cover, domain, first.config.name.span, false);
        }
    }

    /// Adds the constraints on two of these predicates.
    fn derive_for_pairs(&self, same: &[Known<'_>], inputs: &KnownInputs<'_>, found: &mut Collector) {
        for (at, one) in same.iter().enumerate() {
            for other in &same[at + 1..] {
                let (a, b) = (one.predicate, other.predicate);
                for (constraint, span) in [
                    (Constraint::Disjoint(a, b), one.config.name.span),
                    (Constraint::Implies(a, b), one.config.name.span),
                    (Constraint::Implies(b, a), other.config.name.span),
                ] {
                    match self.judge(&constraint, &[], inputs) {
                        Verdict::ByDefinition => found.add(constraint, Vec::new(), span, false),
                        Verdict::OfAgents => found.add(constraint, Vec::new(), self.agents_or(span), true),
                        Verdict::Contradicted(..) | Verdict::Unknown => {}
                    }
                }
            }
        }
    }

    /// Returns the place of the first agents, or else `span`.
    fn agents_or(&self, span: Span) -> Span {
        self.scenario.splits.first().map_or(span, |(_, set)| set.span)
    }
}

/// The constraints found so far.
#[derive(Default)]
struct Collector {
    constraints: CityConstraints,
    known: HashSet<Constraint>,
}

impl Collector {
    /// Adds a declared constraint.
    fn keep(&mut self, declared: &DeclaredConstraint, of_agents: bool) {
        self.known.insert(declared.constraint.clone());
        if !of_agents {
            self.constraints.by_definition.push(declared.clone());
        }
        self.constraints.of_agents.push(declared.clone());
    }

    /// Adds a derived constraint, unless it is known.
    fn add(&mut self, constraint: Constraint, domain: Vec<(PredicateId, usize)>, span: Span, of_agents: bool) {
        let is_known = match constraint {
            Constraint::Disjoint(a, b) => self.known.contains(&Constraint::Disjoint(b, a)),
            _ => false,
        };
        if !is_known && !self.known.contains(&constraint) {
            let derived = DeclaredConstraint {
                constraint,
                domain,
                span,
                inferred: true,
            };
            self.keep(&derived, of_agents);
        }
    }
}

/// Returns the inputs that clauses or declared constraints read.
fn read_inputs<'s>(rules: &Rules, inputs: &KnownInputs<'s>) -> Vec<Known<'s>> {
    let mut read = vec![false; rules.predicates.len()];
    let literals = rules.clauses.iter().flat_map(|clause| &clause.body);
    let atoms = literals.filter_map(Literal::atom).map(|atom| atom.predicate);
    let constraints = rules.constraints.iter().map(|declared| &declared.constraint);
    for predicate in atoms.chain(constraints.flat_map(Constraint::predicates)) {
        read[predicate.index()] = true;
    }
    let is_read = |known: &&Known<'_>| read[known.predicate.index()];
    inputs.list.iter().filter(is_read).copied().collect()
}

fn is_kind(known: &Known<'_>) -> bool {
    matches!(known.config.definition, Definition::Static(Static::Kind(_)))
}
