//! Finds pairs of actions that can be derived together, with an example scene.
//!
//! For two actions A and B, [`diff`] compares the rules with `Conflict(X) :- A(X), B(X).` to the rules without that
//! clause. A difference is a minimal scene that satisfies the constraints of the rules and derives both; "equivalent"
//! proves that no such scene exists. If every clause of one action negates the other, the pair is excluded without a
//! search, even for rules that `diff` cannot prove equivalent.
// Decision: docs/decisions/analysis.md#d033

use crate::city::{Action, ActionTable};
use crate::config::SEES;
use crate::datalog::diff::{Difference, Equivalence, Options, diff, unsat_core};
use crate::datalog::{
    Atom, BaseType, Clause, ClauseId, Column, DeclaredConstraint, Literal, Predicate, PredicateId, Rules, Stratum,
    Term, Value, VarId, parse_value,
};
use crate::datalog::{drawn_probabilities, naive};
use crate::diag::Diagnostic;
use serde_json::{Map, json};

/// The budget of the search for one pair of actions; see [`Options::conflicts_max`].
pub const CONFLICT_BUDGET: u64 = 20_000;

/// See [`Options::literals_max`].
const LITERALS_MAX: usize = 1_000_000;

/// The added predicate. No name in a source begins with `+`.
const CONFLICT: &str = "+conflict";

/// The finding for two actions that both have clauses.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Overlap {
    /// The two actions.
    pub actions: [Action; 2],
    /// Whether both can be derived for one agent.
    pub finding: Finding,
}

impl Overlap {
    /// Returns the action that an agent takes if both are derived, given the order of precedence.
    ///
    /// # Panics
    /// If the order lacks an action.
    pub fn winner(&self, precedence: &[Action]) -> Action {
        let first = precedence.iter().find(|action| self.actions.contains(action));
        *first.expect("an order of all actions")
    }

    /// Returns the other action.
    ///
    /// # Panics
    /// If the order lacks an action.
    pub fn loser(&self, precedence: &[Action]) -> Action {
        let [first, second] = self.actions;
        if self.winner(precedence) == first {
            second
        } else {
            first
        }
    }
}

/// Whether one scene can derive two actions for the same agent.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Finding {
    /// Proved impossible.
    Excluded {
        /// The constraints from which this follows; see [`unsat_core`].
        given: Vec<DeclaredConstraint>,
    },
    /// Possible.
    Together {
        /// The first clause of each action that fires in the scene, in the order of the actions.
        clauses: [ClauseId; 2],
        /// A scene that derives both for the first entity.
        scene: Difference,
    },
    /// Not found and not excluded: [`Equivalence::NoneFound`] or [`Equivalence::NoneTried`].
    NotFound(Equivalence),
}

/// Checks every pair of actions that both have clauses, in the order of the table.
///
/// # Errors
/// If [`diff`] rejects the rules.
pub fn conflicts(rules: &Rules, table: &ActionTable) -> Result<Vec<Overlap>, Vec<Diagnostic>> {
    // Every past is possible.
    let rules = &rules.of_one_tick();
    let action = |action: Action| {
        let predicate = rules.predicate(table.name(action))?;
        let columns = &rules.predicates[predicate.index()].columns;
        let symbol = columns.len() == 1 && columns[0].base == BaseType::Symbol;
        (symbol && clauses(rules, predicate).next().is_some()).then_some(predicate)
    };
    let mut found = Vec::new();
    for (at, first) in table.all().enumerate() {
        for second in table.all().skip(at + 1) {
            if let (Some(one), Some(other)) = (action(first), action(second)) {
                found.push(Overlap {
                    actions: [first, second],
                    finding: find(rules, [one, other])?,
                });
            }
        }
    }
    Ok(found)
}

fn clauses(rules: &Rules, action: PredicateId) -> impl Iterator<Item = (ClauseId, &Clause)> {
    let clauses = (0..).map(ClauseId).zip(&rules.clauses);
    clauses.filter(move |(_, clause)| clause.head.predicate == action)
}

fn find(rules: &Rules, actions: [PredicateId; 2]) -> Result<Finding, Vec<Diagnostic>> {
    let [one, other] = actions;
    if all_negate(rules, one, other) || all_negate(rules, other, one) {
        return Ok(Finding::Excluded { given: Vec::new() });
    }
    let options = Options {
        predicates: vec![CONFLICT.to_owned()],
        conflicts_max: CONFLICT_BUDGET,
        literals_max: LITERALS_MAX,
        self_sight: true,
        ..Options::default()
    };
    let (with, without) = (with_conflict(rules, actions), without_conflict(rules, one));
    Ok(match diff(&with, &without, &options)? {
        Equivalence::Equivalent { .. } => {
            let given = unsat_core(&with, &without, &options)?;
            let given = given.into_iter().map(|(constraint, _)| constraint.clone()).collect();
            Finding::Excluded { given }
        }
        Equivalence::Different(scene) => Finding::Together {
            clauses: firing(rules, actions, &scene),
            scene,
        },
        equivalence => Finding::NotFound(equivalence),
    })
}

/// Returns whether each clause of the action negates the other action for the same agent.
fn all_negate(rules: &Rules, action: PredicateId, other: PredicateId) -> bool {
    clauses(rules, action).all(|(_, clause)| {
        let same = |atom: &Atom| atom.predicate == other && atom.terms == clause.head.terms;
        (clause.body.iter()).any(|literal| matches!(literal, Literal::Negative(atom) if same(atom)))
    })
}

/// Returns the rules with `Conflict(X) :- A(X), B(X).`
fn with_conflict(rules: &Rules, actions: [PredicateId; 2]) -> Rules {
    let mut rules = without_conflict(rules, actions[0]);
    let predicate = PredicateId(rules.predicates.len() as u32 - 1);
    let declared = &mut rules.predicates[predicate.index()];
    declared.derived = true;
    let span = declared.span;
    let atom = |predicate| Atom {
        predicate,
        terms: vec![Term::Variable(VarId(0))],
        span,
    };
    rules.strata.push(Stratum {
        predicates: vec![predicate],
        clauses: vec![ClauseId(rules.clauses.len() as u32)],
        recursive: false,
    });
    rules.clauses.push(Clause {
        head: atom(predicate),
        body: actions.map(|action| Literal::Positive(atom(action))).into(),
        variables: vec!["X".to_owned()],
        variable_spans: vec![span],
        doc: String::new(),
        span,
    });
    rules
}

/// Returns the rules with `Conflict` declared like the action.
fn without_conflict(rules: &Rules, action: PredicateId) -> Rules {
    let mut rules = rules.clone();
    rules.predicates.push(Predicate {
        name: CONFLICT.to_owned(),
        derived: false,
        ..rules.predicates[action.index()].clone()
    });
    rules
}

/// Returns the first clause of each action that derives it for the first entity of the scene.
fn firing(rules: &Rules, actions: [PredicateId; 2], scene: &Difference) -> [ClauseId; 2] {
    let symbols = rules.symbols.clone();
    let mut rows: Vec<(PredicateId, Vec<Value>)> = Vec::new();
    for (name, given) in scene.facts.iter().chain(&scopes(scene)) {
        let Some(predicate) = rules.predicate(name) else {
            continue;
        };
        let columns = &rules.predicates[predicate.index()].columns;
        rows.extend(given.iter().map(|row| {
            let value = |(text, base): (&String, BaseType)| match base {
                BaseType::Symbol => Value(symbols.intern(text).0),
                base => parse_value(base, text).unwrap_or_default(),
            };
            let bases = columns.iter().map(|column| column.base);
            (predicate, row.iter().zip(bases).map(value).collect())
        }));
    }
    let database = naive::evaluate(rules, &symbols, rows);
    let agent = scene.entities.iter().map(|name| Value(symbols.intern(name).0)).take(1);
    let row: Vec<Value> = agent.collect();
    actions.map(|action| {
        let fires = |(_, clause): &(_, &Clause)| naive::consequences(rules, clause, &symbols, &database).contains(&row);
        let first = clauses(rules, action).find(fires);
        first.expect("`diff` evaluated the scene").0
    })
}

/// Returns the rows of the scopes in which every entity sees all entities.
fn scopes(scene: &Difference) -> Vec<(String, Vec<Vec<String>>)> {
    let pairs = || {
        let entities = &scene.entities;
        entities
            .iter()
            .flat_map(|x| entities.iter().map(|y| vec![x.clone(), y.clone()]))
    };
    scene
        .everybody_sees
        .iter()
        .map(|scope| (scope.clone(), pairs().collect()))
        .collect()
}

/// Returns the scene in the format of `logicity infer`, which assumes a complete `Sees` unless the scene lists it.
/// `rules` declare its predicates. What follows from earlier ticks or draws is missing.
pub fn scene_json(scene: &Difference, rules: &[&Rules]) -> serde_json::Value {
    let scopes = scopes(scene);
    let is_complete = |rows: &[Vec<String>]| {
        let mut pairs = scene
            .entities
            .iter()
            .flat_map(|x| scene.entities.iter().map(move |y| [x, y]));
        pairs.all(|[x, y]| rows.iter().any(|row| row == &[x.as_str(), y.as_str()]))
    };
    let listed = (scene.facts.iter().chain(&scopes)).filter(|(name, rows)| name != SEES || !is_complete(rows));
    let facts: Map<String, serde_json::Value> = listed
        .filter_map(|(name, rows)| {
            let declared = declared(rules, name)?;
            let value = |(text, column): (&String, &Column)| match column.base {
                BaseType::Symbol => json!(text),
                // A number that JSON cannot write is none of a scene.
                _ => serde_json::from_str(text).unwrap_or_else(|_| json!(text)),
            };
            let rows = rows.iter().map(|row| {
                let mut values: Vec<serde_json::Value> = row.iter().zip(&declared.columns).map(value).collect();
                match values.len() {
                    1 => values.remove(0),
                    _ => values.into(),
                }
            });
            (!declared.hidden).then(|| (name.clone(), rows.collect()))
        })
        .collect();
    json!({ "entities": scene.entities, "ego": scene.entities.first(), "facts": facts })
}

/// Describes the draws that must succeed in the scene.
pub fn needed_draws(scene: &Difference) -> Vec<String> {
    let drawn = scene.facts.iter().filter_map(|(name, rows)| {
        let probabilities = drawn_probabilities(name)?;
        let count = probabilities.split(", ").count();
        Some(rows.iter().filter_map(move |row| {
            let (alternative, values) = row.split_last()?;
            let alternative: usize = alternative.parse().ok().filter(|at| *at < count)?;
            let what = match count {
                1 => probabilities.to_owned(),
                _ => format!("alternative {} of {probabilities}", alternative + 1),
            };
            Some(match values {
                [] => what,
                _ => format!("{what} for {}", values.join(", ")),
            })
        }))
    });
    drawn.flatten().collect()
}

/// Returns what the scene takes from earlier ticks, as atoms.
pub fn earlier_facts(scene: &Difference, rules: &Rules) -> Vec<String> {
    let hidden = |name: &str| declared(&[rules], name).is_some_and(|declared| declared.hidden);
    let facts = (scene.facts.iter()).filter(|(name, _)| hidden(name) && drawn_probabilities(name).is_none());
    let atoms = facts.flat_map(|(name, rows)| rows.iter().map(move |row| format!("{name}({})", row.join(", "))));
    atoms.collect()
}

fn declared<'r>(rules: &[&'r Rules], name: &str) -> Option<&'r Predicate> {
    let mut found = rules
        .iter()
        .filter_map(|rules| Some(&rules.predicates[rules.predicate(name)?.index()]));
    found.next()
}
