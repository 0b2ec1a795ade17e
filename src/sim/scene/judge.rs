//! What a configuration says about an integrity constraint.

use crate::city::AgentKind;
use crate::datalog::{Constraint, PredicateId};
use crate::diag::Span;
use crate::predicate::Definition;
use crate::sim::scene::theory::{CityTheory, Known, KnownInputs, Profile};

/// What a configuration says about a constraint.
pub(super) enum Verdict {
    /// The definitions imply it.
    ByDefinition,
    /// It holds for the agents of the city.
    OfAgents,
    /// It does not hold: the reason, and the place of the agents for which it does not.
    Contradicted(String, Option<Span>),
    Unknown,
}

impl Verdict {
    fn contradicted(reason: impl Into<String>) -> Verdict {
        Verdict::Contradicted(reason.into(), None)
    }
}

impl CityTheory {
    /// Judges a constraint over these inputs. `domain` is that of the constraint.
    pub(super) fn judge(
        &self,
        constraint: &Constraint,
        domain: &[(PredicateId, usize)],
        inputs: &KnownInputs<'_>,
    ) -> Verdict {
        let find = |predicate: PredicateId| inputs.find(predicate);
        let of = |predicate: PredicateId| find(predicate).map(|known| &known.config.definition);
        match *constraint {
            Constraint::Disjoint(a, b) | Constraint::Implies(a, b) => {
                let implies = matches!(constraint, Constraint::Implies(..));
                match (find(a), find(b)) {
                    (Some(a), Some(b)) if a.config.definition.arity() != b.config.definition.arity() => {
                        Verdict::Unknown
                    }
                    (Some(a), Some(b)) if a.config.definition.arity() == 1 => self.judge_unary(a, b, implies),
                    (Some(a), Some(b)) => self.judge_pair(a, b, implies),
                    _ => Verdict::Unknown,
                }
            }
            Constraint::Covering(ref predicates) => {
                let definitions: Option<Vec<&Definition>> = predicates.iter().map(|&predicate| of(predicate)).collect();
                let is_agent =
                    |(predicate, _): &(PredicateId, usize)| of(*predicate).is_some_and(Definition::is_reflexive);
                match definitions {
                    Some(definitions) => self.judge_cover(&definitions, domain.iter().any(is_agent)),
                    None => Verdict::Unknown,
                }
            }
            Constraint::Reflexive(a) => match of(a) {
                Some(definition) if definition.is_reflexive() => Verdict::ByDefinition,
                Some(_) => Verdict::contradicted("it relates no agent to itself"),
                None => Verdict::Unknown,
            },
            Constraint::Irreflexive(a) => match of(a) {
                Some(definition) if definition.is_reflexive() => {
                    Verdict::contradicted("it relates every agent to itself")
                }
                Some(_) => Verdict::ByDefinition,
                None => Verdict::Unknown,
            },
            Constraint::Symmetric(a) | Constraint::Asymmetric(a) => {
                let symmetric = matches!(constraint, Constraint::Symmetric(_));
                match find(a) {
                    Some(a) => self.judge_reversed(a, symmetric),
                    None => Verdict::Unknown,
                }
            }
        }
    }

    fn judge_unary(&self, a: Known<'_>, b: Known<'_>, implies: bool) -> Verdict {
        let (one, other) = (&a.config.definition, &b.config.definition);
        if !self.distinguishes(one) || !self.distinguishes(other) {
            return Verdict::Unknown;
        }
        let [first, second] = [a, b].map(|known| &known.config.name.value);
        let defined = self.defined(one, other);
        let (fails, only_vacuous) = match implies {
            true => (defined.first_only, !defined.both),
            false => (defined.both, !defined.first_only),
        };
        if !fails {
            return Verdict::ByDefinition;
        }
        if only_vacuous {
            return Verdict::contradicted(match implies {
                true => format!("no agent is both `{first}` and `{second}`"),
                false => format!("every `{first}` is `{second}`"),
            });
        }
        let (_, found) = self.carried(one, other, |a, b| a && b != implies);
        match found {
            Some(Profile { name, span, .. }) if implies => {
                Verdict::Contradicted(format!("{name} can be `{first}` without `{second}`"), Some(*span))
            }
            Some(Profile { name, span, .. }) => {
                Verdict::Contradicted(format!("{name} can be both `{first}` and `{second}`"), Some(*span))
            }
            None => Verdict::OfAgents,
        }
    }

    fn judge_pair(&self, a: Known<'_>, b: Known<'_>, implies: bool) -> Verdict {
        let situations = &self.situations;
        if !situations.covers(a.position) || !situations.covers(b.position) {
            return Verdict::Unknown;
        }
        if self.is_empty(a) || !implies && self.is_empty(b) {
            return Verdict::OfAgents;
        }
        let together = situations.pair(a.position, b.position);
        let fails = if implies { together.first_only } else { together.both };
        let [first, second] = [a, b].map(|known| &known.config.name.value);
        match fails {
            false if situations.complete => Verdict::ByDefinition,
            false => Verdict::Unknown,
            true => {
                let place = match situations.example(a.position, Some(b.position), !implies) {
                    Some([rows, cols]) => format!("for two agents {rows} rows and {cols} columns apart"),
                    None => "for an agent and itself".to_owned(),
                };
                Verdict::contradicted(match implies {
                    true => format!("`{first}` can hold without `{second}` {place}"),
                    false => format!("`{first}` and `{second}` can both hold {place}"),
                })
            }
        }
    }

    fn judge_reversed(&self, a: Known<'_>, symmetric: bool) -> Verdict {
        let (situations, name) = (&self.situations, &a.config.name.value);
        if !situations.covers(a.position) {
            return Verdict::Unknown;
        }
        if !symmetric && a.config.definition.is_reflexive() {
            return Verdict::contradicted("it relates every agent to itself");
        }
        if self.is_empty(a) {
            return Verdict::OfAgents;
        }
        let together = situations.reversed(a.position);
        let fails = if symmetric { together.first_only } else { together.both };
        match fails {
            false if situations.complete => Verdict::ByDefinition,
            false => Verdict::Unknown,
            true => {
                let [rows, cols] = situations.example(a.position, None, !symmetric).unwrap_or_default();
                let order = if symmetric {
                    "in one order only"
                } else {
                    "in both orders"
                };
                Verdict::contradicted(format!(
                    "`{name}` can hold {order} for two agents {rows} rows and {cols} columns apart"
                ))
            }
        }
    }

    /// Judges whether each agent has one of the predicates. `all` says whether the domain of the constraint has every
    /// agent.
    fn judge_cover(&self, definitions: &[&Definition], all: bool) -> Verdict {
        let is_judged = |definition: &&Definition| definition.arity() == 1 && self.distinguishes(definition);
        if !definitions.iter().all(is_judged) {
            return Verdict::Unknown;
        }
        let covers = |kind, concepts: &[String]| {
            let mut cells = self.situations.cells[kind as usize].iter();
            cells.all(|cell| {
                let mut definitions = definitions.iter();
                definitions.any(|definition| self.holds(definition, kind, concepts, *cell))
            })
        };
        if AgentKind::ALL.into_iter().all(|kind| covers(kind, &[])) {
            return Verdict::ByDefinition;
        }
        match self
            .profiles
            .iter()
            .find(|profile| !covers(profile.kind, &profile.concepts))
        {
            None => Verdict::OfAgents,
            Some(Profile { name, span, .. }) if all => {
                Verdict::Contradicted(format!("{name} can be none of these"), Some(*span))
            }
            Some(_) => Verdict::Unknown,
        }
    }
}
