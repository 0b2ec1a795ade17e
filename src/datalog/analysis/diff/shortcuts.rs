//! Reasoning shortcuts: confusions of concepts that rules cannot tell apart.
//!
//! Perception that learns through rules is corrected only where a decision is wrong. So it may confuse concepts in any
//! way that changes no decision: Marconato et al., Not all neuro-symbolic concepts are created equal, 2023.
//! A *map* says what perception reports in place of each concept. A *shortcut* is a map that changes no decision and
//! confuses concepts.
//!
//! Two searches in one propositional formula count the maps. Variables choose the image of each concept, and others the
//! facts of a scene. While some map changes a decision in some scene, that scene becomes a condition on the maps. When
//! no pair is left, every map that meets the conditions changes no decision, and the maps are enumerated.

mod remedy;

use crate::analysis::diff::confusion::Confusion;
use crate::analysis::diff::ground::{Circuit, TooLarge};
use crate::analysis::diff::pair::{Individual, Pair, ScopeRows};
use crate::analysis::diff::sat::{Lit, Outcome, Solver};
use crate::analysis::diff::{
    BaseFact, Difference, Model, Options, Scenes, derived_rows, describe, has_circuit, shrink,
};
use crate::check::subsumption::within_theory;
use crate::check::{Clause, PredicateId, Rules};
use crate::codes;
use crate::diag::{Diagnostic, did_you_mean, listed};
use crate::syntax::ast::BaseType;
use std::collections::BTreeSet;

pub use crate::analysis::diff::confusion::Image;
pub use remedy::remedy;

/// The maps to search. Concepts have images over as many entities.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ConceptMaps {
    /// Each concept stands for exactly one.
    Permutations,
    /// Or for the negation of one.
    Signed,
    /// Concepts may also merge, or be reported always or never.
    All,
}

impl ConceptMaps {
    /// All kinds of maps, each with those before.
    pub const ALL: [ConceptMaps; 3] = [ConceptMaps::Permutations, ConceptMaps::Signed, ConceptMaps::All];

    /// Returns the name of the kind.
    pub fn name(self) -> &'static str {
        match self {
            ConceptMaps::Permutations => "permutations",
            ConceptMaps::Signed => "signed",
            ConceptMaps::All => "all",
        }
    }
}

/// The maximum number of literals instantiated for scenes of all sizes together.
const LITERALS_MAX: usize = 4_000_000;

/// The maps to count, and the limits.
#[derive(Clone, Debug)]
pub struct ShortcutOptions {
    /// The maps.
    pub maps: ConceptMaps,
    /// The concepts that perception may confuse, by name; all that the rules read if empty.
    pub concepts: Vec<String>,
    /// The inputs that say who sees whom: every entity sees all others. Scopes of clauses need not be among them.
    pub views: Vec<PredicateId>,
    /// The action that is taken if none is derived.
    pub default_action: Option<PredicateId>,
    /// The maximum number of entities in a scene, at least 1.
    pub entities_max: usize,
    /// The maximum number of conflicts in all searches, which bounds the time without a clock.
    pub conflicts_max: u64,
    /// The maximum number of maps to list.
    pub maps_max: usize,
}

impl Default for ShortcutOptions {
    /// All maps, three entities, a million conflicts and 10,000 maps.
    fn default() -> Self {
        ShortcutOptions {
            maps: ConceptMaps::All,
            concepts: Vec::new(),
            views: Vec::new(),
            default_action: None,
            entities_max: 3,
            conflicts_max: 1_000_000,
            maps_max: 10_000,
        }
    }
}

/// A map of concepts that changes no decision.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ConceptMap {
    /// The image of each concept.
    pub images: Vec<Image>,
    /// For each concept, whether its image differs from it in some scene. The constraints may exclude that.
    pub confused: Vec<bool>,
}

impl ConceptMap {
    /// Returns whether the images are the concepts, in all scenes.
    pub fn is_same(&self) -> bool {
        !self.confused.contains(&true)
    }
}

/// The maps that change no decision.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Shortcuts {
    /// The concepts that perception may confuse.
    pub concepts: Vec<PredicateId>,
    /// The inputs that no decision depends on; perception may report them in any way.
    pub unread: Vec<PredicateId>,
    /// What decisions depend on and perception does not report: inputs with values or more columns, and what rules read
    /// of earlier ticks.
    pub given: Vec<PredicateId>,
    /// The maps found, by the number of concepts that they change. The identity is among them if these are all.
    pub maps: Vec<ConceptMap>,
    /// The limit that ended the search; `None` if these are all maps.
    pub stopped: Option<Stopped>,
}

/// A limit that ended a search.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stopped {
    /// [`ShortcutOptions::conflicts_max`].
    Conflicts,
    /// [`ShortcutOptions::maps_max`].
    Maps,
    /// The formula would be too large.
    Size,
}

impl From<TooLarge> for Stopped {
    fn from(_: TooLarge) -> Stopped {
        Stopped::Size
    }
}

/// A scene in which a map changes the decision of the first entity.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Witness {
    /// The scene; `derived` has what follows from the concepts and from their images.
    pub scene: Difference,
    /// The decisions by the concepts and by their images; `None` without one.
    pub decisions: [Option<PredicateId>; 2],
}

/// Counts the maps of concepts that change no decision in scenes of at most some entities, each of which sees all.
/// `order` has the actions in order of precedence: the first that is derived is the decision, and without any
/// [`ShortcutOptions::default_action`].
///
/// # Errors
/// If a concept is not one that the rules read, or if they have expressions, aggregates, floats or unsigned numbers.
pub fn shortcuts(
    rules: &Rules,
    order: &[PredicateId],
    options: &ShortcutOptions,
) -> Result<Shortcuts, Vec<Diagnostic>> {
    let task = Task::new(rules, order, options)?;
    Ok(task.count(options))
}

/// Returns a smallest scene in which a map changes the decision of the first entity; `None` if there is none of at most
/// `entities_max` entities.
///
/// # Errors
/// As [`shortcuts`]; the inner one if the search reaches a limit.
pub fn witness(
    rules: &Rules,
    order: &[PredicateId],
    options: &ShortcutOptions,
    images: &[Image],
) -> Result<Result<Option<Witness>, Stopped>, Vec<Diagnostic>> {
    let task = Task::new(rules, order, options)?;
    Ok(task.witness(options, images))
}

/// Rules prepared for the search.
struct Task<'a> {
    pair: Pair<'a>,
    rules: &'a Rules,
    order: Vec<PredicateId>,
    default: Option<PredicateId>,
    /// The concepts: the predicates, their positions among base predicates, and their arities.
    concepts: Vec<(PredicateId, usize, usize)>,
    unread: Vec<PredicateId>,
    given: Vec<PredicateId>,
    view: ScopeRows,
}

impl<'a> Task<'a> {
    fn new(rules: &'a Rules, order: &[PredicateId], given: &ShortcutOptions) -> Result<Task<'a>, Vec<Diagnostic>> {
        let named = &given.concepts;
        if !has_circuit(rules) {
            let message =
                "shortcuts are not counted for expressions, aggregates, probabilities, floats and unsigned numbers";
            let mut fault = Diagnostic::new(codes::UNSUPPORTED, message);
            let is_beyond = |clause: &&Clause| !within_theory(clause) || rules.draw(clause).is_some();
            if let Some(clause) = rules.clauses.iter().find(is_beyond) {
                fault = fault.at(clause.span, "this clause has one");
            }
            return Err(vec![
                fault.help("remove these clauses, or define their heads as inputs"),
            ]);
        }
        let options = Options {
            predicates: (order.iter())
                .map(|action| rules.predicates[action.index()].name.clone())
                .collect(),
            self_sight: true,
            ..Options::default()
        };
        let mut pair = Pair::new(rules, rules, &options)?;
        for side in &mut pair.sides {
            side.scopes.extend(&given.views);
        }
        // Concepts are about the entities that decide.
        let entity = order
            .first()
            .map(|action| rules.predicates[action.index()].columns[0].ty);
        if let Some(entity) = entity {
            pair.functions.exclude_values(&pair.sides[0], entity);
        }
        let side = &pair.sides[0];
        let (mut concepts, mut unread, mut taken) = (Vec::new(), Vec::new(), Vec::new());
        for (id, predicate) in (0..).map(PredicateId).zip(&rules.predicates) {
            let Some(base) = side.base[id.index()].filter(|_| !side.scopes.contains(&id)) else {
                continue;
            };
            let is_read = order.iter().any(|action| rules.depends_on(*action, id));
            let columns = &predicate.columns;
            let is_concept = (1..=2).contains(&columns.len())
                && columns.iter().all(|column| Some(column.ty) == entity)
                && !predicate.hidden
                && !pair.functions.include(base);
            match (is_read, is_concept) {
                (true, true) => concepts.push((id, base, columns.len())),
                (true, false) => taken.push(id),
                (false, _) if !predicate.hidden => unread.push(id),
                (false, _) => {}
            }
        }
        if !named.is_empty() {
            let name = |id: PredicateId| rules.predicates[id.index()].name.as_str();
            let known: Vec<&str> = concepts.iter().map(|(id, ..)| name(*id)).collect();
            if let Some(unknown) = named.iter().find(|wanted| !known.contains(&wanted.as_str())) {
                let message = format!("no decision depends on a concept `{unknown}`");
                let mut fault = Diagnostic::new(codes::UNKNOWN_PREDICATE, message);
                if let Some(near) = did_you_mean(unknown, known.iter().copied()) {
                    fault = fault.help(format!("did you mean `{near}`?"));
                }
                let known: Vec<String> = known.iter().map(|name| format!("`{name}`")).collect();
                return Err(vec![fault.note(format!("the concepts are {}", listed(&known)))]);
            }
            concepts.retain(|(id, ..)| named.iter().any(|wanted| wanted == name(*id)));
        }
        Ok(Task {
            view: match side.scopes.is_empty() {
                true => ScopeRows::Selves,
                false => ScopeRows::Full,
            },
            order: order.to_vec(),
            default: given.default_action,
            given: taken,
            rules,
            pair,
            concepts,
            unread,
        })
    }

    /// Returns the images that a concept may have.
    fn images(&self, concept: usize, maps: ConceptMaps) -> Vec<Image> {
        let arity = self.concepts[concept].2;
        let mut images = Vec::new();
        for (position, (.., other)) in self.concepts.iter().enumerate() {
            if *other != arity {
                continue;
            }
            images.push(Image::Concept {
                position,
                negated: false,
            });
            if maps != ConceptMaps::Permutations {
                images.push(Image::Concept {
                    position,
                    negated: true,
                });
            }
        }
        if maps == ConceptMaps::All {
            images.extend([false, true].map(Image::Constant));
        }
        images
    }

    /// Returns the entities and constants, by position.
    fn symbols(&self, individuals: &[Individual]) -> Vec<usize> {
        let is_entity = |one: &Individual| one.base() == BaseType::Symbol && !self.pair.functions.have_value(one);
        (0..individuals.len())
            .filter(|at| is_entity(&individuals[*at]))
            .collect()
    }

    fn confusion(&self, choices: Vec<Vec<(Image, Lit)>>) -> Confusion {
        let bases = self.concepts.iter().map(|(id, base, _)| (*base, *id)).collect();
        Confusion { bases, choices }
    }

    /// Returns whether a map changes the decision of the first entity, as a gate.
    fn changes(&self, circuit: &mut Circuit<'_>) -> Result<Lit, TooLarge> {
        let mut decisions: [Vec<Lit>; 2] = [Vec::new(), Vec::new()];
        for (side, decisions) in decisions.iter_mut().enumerate() {
            let mut before = Vec::new();
            for action in &self.order {
                let derived = circuit.fact(side, *action, &[0])?;
                let mut all = before.clone();
                all.push(derived);
                decisions.push(circuit.all(all));
                before.push(!derived);
            }
        }
        let [of_concepts, of_images] = decisions;
        // If all other decisions agree, both sides take the default.
        let others = self.order.iter().zip(of_concepts.into_iter().zip(of_images));
        let others = others.filter(|(action, _)| Some(**action) != self.default);
        let differing: Vec<Lit> = others.map(|(_, (one, other))| circuit.differ(one, other)).collect();
        Ok(circuit.any(differing))
    }

    /// Returns for each concept whether its image differs from it in some row, as a gate.
    fn confuses(&self, circuit: &mut Circuit<'_>, individuals: &[Individual]) -> Result<Vec<Lit>, TooLarge> {
        let symbols = self.symbols(individuals);
        let mut confuses = Vec::with_capacity(self.concepts.len());
        for (id, _, arity) in &self.concepts {
            let mut differing = Vec::new();
            for row in rows(&symbols, *arity) {
                let [one, other] = [circuit.fact(0, *id, &row)?, circuit.fact(1, *id, &row)?];
                differing.push(circuit.differ(one, other));
            }
            confuses.push(circuit.any(differing));
        }
        Ok(confuses)
    }

    fn count(&self, options: &ShortcutOptions) -> Shortcuts {
        let mut maps = Vec::new();
        let stopped = self.find(options, &mut maps).err();
        let distance = |map: &ConceptMap| {
            let moved = map.images.iter().enumerate();
            moved.filter(|(at, image)| **image != identity(*at)).count()
        };
        maps.sort_by(|one, other| (distance(one), &one.images).cmp(&(distance(other), &other.images)));
        Shortcuts {
            concepts: self.concepts.iter().map(|(id, ..)| *id).collect(),
            unread: self.unread.clone(),
            given: self.given.clone(),
            maps,
            stopped,
        }
    }

    /// Finds all maps that change no decision.
    fn find(&self, options: &ShortcutOptions, maps: &mut Vec<ConceptMap>) -> Result<(), Stopped> {
        let mut solver = Solver::new();
        let choices: Vec<Vec<(Image, Lit)>> = (0..self.concepts.len())
            .map(|concept| {
                let images = self.images(concept, options.maps).into_iter();
                images.map(|image| (image, solver.fresh())).collect()
            })
            .collect();
        for images in &choices {
            let all: Vec<Lit> = images.iter().map(|(_, lit)| *lit).collect();
            solver.add(&all);
            at_most_one(&mut solver, &all);
        }
        if options.maps != ConceptMaps::All {
            for position in 0..self.concepts.len() {
                let of = |(image, lit): &(Image, Lit)| {
                    matches!(image, Image::Concept { position: of, .. } if *of == position).then_some(*lit)
                };
                let all: Vec<Lit> = choices.iter().flatten().filter_map(of).collect();
                at_most_one(&mut solver, &all);
            }
        }
        let confusion = self.confusion(choices);
        let all_scenes: Vec<Scenes<'_>> = (1..=options.entities_max.max(1))
            .map(|entities| Scenes::new(&self.pair, entities))
            .collect();
        let mut literals_left = LITERALS_MAX;
        // For each size: whether a decision changes, whether a concept is confused, and the facts.
        let mut sizes = Vec::new();
        for scenes in &all_scenes {
            let mut circuit = scenes.over(solver, self.view, literals_left);
            circuit.confusion = Some(&confusion);
            let changes = self.changes(&mut circuit)?;
            let confuses = self.confuses(&mut circuit, &scenes.individuals)?;
            circuit.constraints()?;
            literals_left = circuit.literals_left;
            let atoms: Vec<(BaseFact, Lit)> = circuit.atoms.iter().map(|(fact, lit)| (fact.clone(), *lit)).collect();
            sizes.push((changes, confuses, atoms));
            solver = circuit.into_solver();
        }
        let mut conflicts = options.conflicts_max;
        // For each concept, the images that differ from it in some scene.
        let mut confused: Vec<Vec<Image>> = vec![Vec::new(); self.concepts.len()];
        for (concept, images) in confusion.choices.iter().enumerate() {
            for (image, chosen) in images.iter().filter(|(image, _)| *image != identity(concept)) {
                for (_, confuses, _) in &sizes {
                    match solver.solve(&[*chosen, confuses[concept]], &mut conflicts) {
                        Outcome::Unsatisfiable => {}
                        Outcome::Unknown => return Err(Stopped::Conflicts),
                        Outcome::Satisfiable => {
                            confused[concept].push(*image);
                            break;
                        }
                    }
                }
            }
        }
        for (scenes, (changes, _, atoms)) in all_scenes.iter().zip(&sizes) {
            loop {
                match solver.solve(&[*changes], &mut conflicts) {
                    Outcome::Unsatisfiable => break,
                    Outcome::Unknown => return Err(Stopped::Conflicts),
                    Outcome::Satisfiable => {}
                }
                let held = atoms.iter().filter(|(_, lit)| solver.is_true(*lit));
                let facts: BTreeSet<BaseFact> = held.map(|(fact, _)| fact.clone()).collect();
                let mut circuit = scenes.over(solver, self.view, literals_left);
                circuit.confusion = Some(&confusion);
                circuit.fixed = Some(&facts);
                let changed = self.changes(&mut circuit)?;
                literals_left = circuit.literals_left;
                solver = circuit.into_solver();
                solver.add(&[!changed]);
            }
        }
        loop {
            match solver.solve(&[], &mut conflicts) {
                Outcome::Unsatisfiable => break,
                Outcome::Unknown => return Err(Stopped::Conflicts),
                Outcome::Satisfiable if maps.len() >= options.maps_max => return Err(Stopped::Maps),
                Outcome::Satisfiable => {}
            }
            let chosen: Vec<(Image, Lit)> = (confusion.choices.iter())
                .filter_map(|images| images.iter().find(|(_, lit)| solver.is_true(*lit)).copied())
                .collect();
            let confused = (confused.iter().zip(&chosen))
                .map(|(images, (image, _))| images.contains(image))
                .collect();
            let images = chosen.iter().map(|(image, _)| *image).collect();
            maps.push(ConceptMap { images, confused });
            solver.add(&chosen.iter().map(|(_, lit)| !*lit).collect::<Vec<_>>());
        }
        Ok(())
    }

    fn witness(&self, options: &ShortcutOptions, images: &[Image]) -> Result<Option<Witness>, Stopped> {
        let mut conflicts = options.conflicts_max;
        for entities in 1..=options.entities_max.max(1) {
            let scenes = Scenes::new(&self.pair, entities);
            let mut circuit = scenes.over(Solver::new(), self.view, LITERALS_MAX);
            let yes = circuit.yes();
            let confusion = self.confusion(images.iter().map(|image| vec![(*image, yes)]).collect());
            circuit.confusion = Some(&confusion);
            let changes = self.changes(&mut circuit)?;
            circuit.constraints()?;
            if circuit.is_no(changes) {
                continue;
            }
            circuit.solver.add(&[changes]);
            match circuit.solver.solve(&[], &mut conflicts) {
                Outcome::Unsatisfiable => continue,
                Outcome::Unknown => return Err(Stopped::Conflicts),
                Outcome::Satisfiable => {}
            }
            let smallest = shrink(&mut circuit, &mut conflicts);
            let facts: Vec<BaseFact> = (circuit.atoms.iter())
                .filter(|(_, lit)| circuit.solver.is_true(**lit))
                .map(|(fact, _)| fact.clone())
                .collect();
            drop(circuit);
            let model = Model {
                individuals: scenes.individuals,
                entities,
                row: vec![0],
                facts,
                smallest,
            };
            return Ok(Some(self.described(&model, images)));
        }
        Ok(None)
    }

    /// Describes a scene, with what follows from the concepts and from their images.
    fn described(&self, model: &Model, images: &[Image]) -> Witness {
        let mut scene = describe(&self.pair, self.view, model);
        // Perception may report facts about entities that have none.
        for entity in model.individuals[..model.entities].iter().map(Individual::shown) {
            if !scene.entities.contains(&entity) {
                scene.entities.push(entity);
            }
        }
        let holds: BTreeSet<&BaseFact> = model.facts.iter().collect();
        let symbols = self.symbols(&model.individuals);
        let is_concept = |base: usize| self.concepts.iter().any(|(_, known, _)| *known == base);
        let mut reported: Vec<BaseFact> = (model.facts.iter())
            .filter(|(base, _)| !is_concept(*base))
            .cloned()
            .collect();
        for ((_, base, arity), image) in self.concepts.iter().zip(images) {
            for row in rows(&symbols, *arity) {
                let value = match *image {
                    Image::Constant(value) => value,
                    Image::Concept { position, negated } => {
                        holds.contains(&(self.concepts[position].1, row.clone())) != negated
                    }
                };
                if value {
                    reported.push((*base, row));
                }
            }
        }
        let individuals = &model.individuals;
        scene.derived[1] = derived_rows(&self.pair, 1, individuals, &reported, (&scene.everybody_sees, &symbols));
        let name = individuals[0].shown();
        let decision = |rows: &[(String, Vec<String>)]| {
            let derived = self.order.iter().copied().find(|action| {
                let action = &self.rules.predicates[action.index()].name;
                rows.iter().any(|(of, row)| of == action && row[..] == [name.clone()])
            });
            derived.or(self.default)
        };
        Witness {
            decisions: [0, 1].map(|side: usize| decision(&scene.derived[side])),
            scene,
        }
    }
}

/// Returns the image of a concept that is not confused.
pub fn identity(position: usize) -> Image {
    Image::Concept {
        position,
        negated: false,
    }
}

/// Returns all rows over these individuals.
fn rows(individuals: &[usize], arity: usize) -> impl Iterator<Item = Vec<usize>> {
    let count = individuals.len();
    let digit = move |row: usize, at: usize| individuals[row / count.pow(at as u32) % count];
    (0..count.pow(arity as u32)).map(move |row| (0..arity).map(|at| digit(row, at)).collect())
}

fn at_most_one(solver: &mut Solver, all: &[Lit]) {
    for (at, one) in all.iter().enumerate() {
        for other in &all[at + 1..] {
            solver.add(&[!*one, !*other]);
        }
    }
}
