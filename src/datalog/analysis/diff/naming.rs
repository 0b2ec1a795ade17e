//! The names of entities in a scene: those of scene files instead of constants of the rules, unless a constant matters.
//!
//! The search ranges over entities and constants alike, so a scene may call an agent `north` only because a clause asks
//! for the heading `"north"`. [`settle`] leaves such an entity out or renames it, and keeps what still shows the
//! difference. Entities are the values of columns whose type is that of a scope.

use crate::analysis::constraints;
use crate::analysis::diff::Difference;
use crate::analysis::diff::pair::Output;
use crate::analysis::diff::values::{self, LIMITS, named, words};
use crate::check::{Column, Literal, PredicateId, Rules, TypeId};
use crate::program::Program;
use crate::session::Session;
use crate::syntax::ast::BaseType;
use std::collections::BTreeSet;

/// The maximum number of constants that [`settle`] considers.
const CONSTANTS_MAX: usize = 64;

/// A derived row: the name of its predicate, and its values.
type Row = (String, Vec<String>);

/// Returns the beginning of names of entities, which a number follows: no constant is such a name.
pub(super) fn prefix<'c>(constants: impl Iterator<Item = &'c str> + Clone) -> String {
    let mut prefix = "e".to_owned();
    let is_taken = |prefix: &str| {
        constants.clone().any(|constant| {
            let number = constant.strip_prefix(prefix);
            number.is_some_and(|number| number.bytes().all(|byte| byte.is_ascii_digit()))
        })
    };
    while is_taken(&prefix) {
        prefix.push('_');
    }
    prefix
}

/// Returns the scene with names of entities instead of those constants that do not matter.
pub(super) fn settle(difference: Difference, rules: [&Rules; 2], outputs: &[Output]) -> Difference {
    let mut constants = BTreeSet::new();
    rules.iter().for_each(|rules| named(rules, &mut constants));
    let symbols = (constants.iter())
        .filter(|(base, _)| *base == BaseType::Symbol)
        .map(|(_, text)| text.as_str());
    let prefix = prefix(symbols.clone());
    let sides = rules.map(Side::new);
    let known = |text: &&str| difference.entities.iter().any(|entity| entity == text);
    let candidates: Vec<&str> = symbols.filter(known).take(CONSTANTS_MAX).collect();
    if candidates.is_empty() || sides.iter().all(|side| side.entities.is_empty()) {
        return difference;
    }
    let Some(mut row) = differing(&difference) else {
        return difference;
    };
    let mut scene = difference;
    for constant in candidates {
        let is_subject = row.1.iter().any(|value| value == constant);
        let mut names = (0..).map(|number: usize| format!("{prefix}{number}"));
        let fresh = names.find(|name| !scene.entities.contains(name));
        let fresh = fresh.expect("finitely many names are taken");
        for name in [None, Some(fresh.as_str())] {
            if name.is_none() && is_subject {
                continue;
            }
            let renamed = (row.0.clone(), change(&sides, &row, constant, name).unwrap_or_default());
            if let Some(other) = changed(&scene, &sides, outputs, (constant, name))
                && differs(&other, &renamed)
            {
                (scene, row) = (other, renamed);
                break;
            }
        }
    }
    scene
}

/// Returns the derived row that differs: of several, that about the first entities of the scene.
fn differing(difference: &Difference) -> Option<Row> {
    let [left, right] = &difference.derived;
    let rows = || {
        left.iter()
            .chain(right)
            .filter(|row| left.contains(row) != right.contains(row))
    };
    let is_first = |row: &&Row| {
        let entities = row.1.iter().filter(|value| difference.entities.contains(value));
        entities.zip(&difference.entities).all(|(value, first)| value == first)
    };
    rows().find(is_first).or_else(|| rows().next()).cloned()
}

fn differs(scene: &Difference, row: &Row) -> bool {
    let [left, right] = &scene.derived;
    left.contains(row) != right.contains(row)
}

/// One of the two rule sets.
struct Side<'r> {
    rules: &'r Rules,
    /// The types of the columns of scopes.
    entities: BTreeSet<TypeId>,
}

impl<'r> Side<'r> {
    fn new(rules: &'r Rules) -> Side<'r> {
        let literals = rules.clauses.iter().flat_map(|clause| &clause.body);
        let scopes = literals.filter_map(|literal| match literal {
            Literal::Guard(atom) => Some(&rules.predicates[atom.predicate.index()].columns),
            _ => None,
        });
        let columns = scopes.flatten().filter(|column| column.base == BaseType::Symbol);
        Side {
            rules,
            entities: columns.map(|column| column.ty).collect(),
        }
    }

    /// Returns whether the values of a column are entities.
    fn has_entities(&self, column: &Column) -> bool {
        let parent = |ty: &TypeId| self.rules.types[ty.0 as usize].parent;
        let mut types = std::iter::successors(Some(column.ty), parent);
        types.any(|ty| self.entities.contains(&ty))
    }
}

/// Returns a row with another name instead of a constant in the columns of entities; `None` if the row goes with it.
fn change(sides: &[Side<'_>; 2], (predicate, row): &Row, constant: &str, name: Option<&str>) -> Option<Vec<String>> {
    let mut declared = sides.iter().filter_map(|side| {
        let predicate = side.rules.predicate(predicate)?;
        Some((side, &side.rules.predicates[predicate.index()].columns))
    });
    let Some((side, columns)) = declared.next() else {
        return Some(row.clone());
    };
    let value = |(text, column): (&String, &Column)| match text == constant && side.has_entities(column) {
        true => name.map(str::to_owned),
        false => Some(text.clone()),
    };
    row.iter().zip(columns).map(value).collect()
}

/// Returns the scene without an entity, or with another name for it, with what both sides derive. `None` if a side
/// cannot evaluate it or its constraints do not hold.
fn changed(
    scene: &Difference,
    sides: &[Side<'_>; 2],
    outputs: &[Output],
    (constant, name): (&str, Option<&str>),
) -> Option<Difference> {
    let entities = (scene.entities.iter()).filter_map(|entity| match entity == constant {
        true => name.map(str::to_owned),
        false => Some(entity.clone()),
    });
    let facts = scene.facts.iter().filter_map(|(predicate, rows)| {
        let rows_of = |row: &Vec<String>| change(sides, &(predicate.clone(), row.clone()), constant, name);
        let left: Vec<Vec<String>> = rows.iter().filter_map(rows_of).collect();
        (rows.is_empty() || !left.is_empty()).then(|| (predicate.clone(), left))
    });
    let mut scene = Difference {
        entities: entities.collect(),
        facts: facts.collect(),
        ..scene.clone()
    };
    let [left, right] = sides;
    scene.derived = [
        derived(left.rules, outputs, &scene)?,
        derived(right.rules, outputs, &scene)?,
    ];
    Some(scene)
}

/// Returns the output rows that a side derives; `None` if it exceeds the limits or violates a constraint.
fn derived(rules: &Rules, outputs: &[Output], scene: &Difference) -> Option<Vec<Row>> {
    let pairs = || {
        let entities = &scene.entities;
        entities
            .iter()
            .flat_map(|x| entities.iter().map(|y| vec![x.clone(), y.clone()]))
    };
    let scopes = scene
        .everybody_sees
        .iter()
        .map(|scope| (scope, pairs().collect::<Vec<_>>()));
    let given = scene.facts.iter().map(|(name, rows)| (name, rows.clone()));
    let mut session: Session = Program::new(rules.clone()).ok()?.session();
    session.set_limits(LIMITS);
    let mut facts: Vec<(PredicateId, Vec<String>)> = Vec::new();
    for (name, rows) in given.chain(scopes) {
        let Some(predicate) = rules.predicate(name) else {
            continue;
        };
        let bases: Vec<BaseType> = (rules.predicates[predicate.index()].columns.iter())
            .map(|column| column.base)
            .collect();
        for row in rows {
            let inserted = words(&mut session, &bases, &row);
            session.insert(predicate, &inserted).ok()?;
            facts.push((predicate, row));
        }
    }
    session.commit().ok()?;
    let is_possible = constraints::violations(&session).is_empty();
    is_possible.then(|| values::derived(rules, outputs, facts.into_iter()))
}
