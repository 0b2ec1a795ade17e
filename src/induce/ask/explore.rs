//! Random scenes in which unknown clauses may hold.

use crate::induce::ask::hypothesis::{Instance, firing};
use crate::induce::ask::probe::Probes;
use crate::induce::ask::session::{End, Reason, Session};
use crate::induce::ask::shrink::{resolve, shuffle};
use crate::induce::ask::space::{Fact, Space};
use crate::induce::ask::verify::verify;
use crate::induce::bits::{self, Bits};
use crate::induce::examples::State;
use crate::rng::{Rng, RngExt};
use std::collections::BTreeMap;

/// Scenes that are drawn for one question.
const DRAWN: usize = 48;

/// Changes of a scene that are tried.
const CHANGES: usize = 100;

/// Asks random scenes until the rules agree in a number of consecutive ones. Asks about the clauses whenever they
/// change.
pub fn explore(session: &mut Session<'_>) -> Result<(), End> {
    let mut agreements = 0;
    let mut probes = Probes::new(session);
    while agreements < session.asking.agreements {
        let Some(state) = best_scene(session, &mut probes) else {
            // All scenes that could be drawn are known.
            return Ok(());
        };
        let action = session.ask(&state, Reason::Explore)?;
        if action == session.hypothesis.action(&state) {
            agreements += 1;
        } else {
            agreements = 0;
            resolve(session, &state, action)?;
            verify(session)?;
        }
    }
    Ok(())
}

/// Returns the next random scene to ask.
fn best_scene(session: &mut Session<'_>, probes: &mut Probes) -> Option<State> {
    let mut random = session.random(4);
    let default = session.hypothesis.default;
    // The actions that the rules may take: a clause of higher precedence can be unknown only where they do.
    let mut levels: Vec<usize> = session.hypothesis.clauses.iter().map(|clause| clause.action).collect();
    levels.dedup();
    levels.retain(|level| *level > 0);
    shuffle(&mut levels, &mut random);
    let at = if random.random_bool(DEFAULT) { 0 } else { levels.len() };
    levels.insert(at, default);
    levels
        .into_iter()
        .find_map(|level| best_scene_of(session, probes, level))
}

/// Draws unknown scenes in which the rules take the action `level` and returns the one in which the most unrefuted
/// clauses hold.
fn best_scene_of(session: &mut Session<'_>, probes: &mut Probes, level: usize) -> Option<State> {
    let mut random = session.random(5);
    let mut others = session.random(6);
    probes.update(session, level, &mut random, &mut |session| {
        draw(session, level, &mut others)
    });
    let mut best: Option<(usize, State)> = None;
    for _ in 0..DRAWN {
        let Some(state) = draw(session, level, &mut random) else {
            continue;
        };
        let count = probes.count(&state, level);
        if best.as_ref().is_none_or(|(most, _)| count > *most) && !session.is_known(&state) {
            best = Some((count, state));
        }
    }
    let (count, state) = best?;
    Some(climb(session, probes, count, state, &mut random))
}

/// Adds and removes facts at random as long as the prediction stays the same and no fewer unrefuted clauses hold.
fn climb(
    session: &mut Session<'_>,
    probes: &Probes,
    mut count: usize,
    mut state: State,
    random: &mut impl Rng,
) -> State {
    let space = session.space(state.entities());
    let predicted = session.hypothesis.action(&state);
    for _ in 0..CHANGES {
        let fact = random.random_range(0..space.facts.len());
        let mut scene = state.fact_set().clone();
        if bits::contains(&scene, fact) {
            bits::subtract(&mut scene, &space.implying[fact]);
        } else if !bits::contains(&space.excluded[fact], fact) {
            for other in bits::elements(&space.excluded[fact]) {
                if bits::contains(&scene, other) {
                    bits::subtract(&mut scene, &space.implying[other]);
                }
            }
            space.add(&mut scene, fact);
        }
        if !space.is_complete(&scene) {
            continue;
        }
        let changed = space.state(&scene);
        let more = probes.count(&changed, predicted);
        if more >= count && session.hypothesis.action(&changed) == predicted && !session.is_known(&changed) {
            (count, state) = (more, changed);
        }
    }
    state
}

/// Draws a scene in which the rules take an action.
fn draw(session: &mut Session<'_>, action: usize, random: &mut impl Rng) -> Option<State> {
    let egos = session.examples.vocabulary().egos();
    let most = session.asking.entities.max(egos);
    let least = if random.random_bool(0.1) {
        egos
    } else {
        (egos + 1).min(most)
    };
    let entities = random.random_range(least..=most);
    let space = session.space(entities);
    let instances = session.hypothesis.instances(entities);
    let of_action: Vec<&Instance> = instances.iter().filter(|instance| instance.action == action).collect();
    let planted = match of_action.len() {
        0 => None,
        count => Some(of_action[random.random_range(0..count)]),
    };
    let scene = quiet(&space, &instances, action, planted, random)?;
    let decision = firing(&instances, &scene, action).next();
    let is_taken = decision.map_or(session.hypothesis.default, |instance| instance.action) == action;
    is_taken.then(|| space.state(&scene))
}

/// The share of random questions about scenes in which the rules take the default action.
const DEFAULT: f64 = 0.6;

/// The shares of the possible facts that hold in a random scene.
const DENSITIES: [f64; 5] = [0.0, 0.25, 0.5, 1.0, 1.0];

/// The share of random scenes in which few unary facts about the egos hold.
const SPARSE: f64 = 0.5;

/// Draws a scene with many facts in which no clause of an action before `level` holds, and the planted one does.
fn quiet(
    space: &Space,
    instances: &[Instance],
    level: usize,
    planted: Option<&Instance>,
    random: &mut impl Rng,
) -> Option<Bits> {
    let loud = |scene: &Bits| {
        level
            .checked_sub(1)
            .map_or(0, |level| firing(instances, scene, level).count())
    };
    let mut scene = space.start();
    let mut unwanted = bits::empty(space.facts.len());
    if let Some(planted) = planted {
        for fact in bits::elements(&planted.positive) {
            if !bits::contains(&scene, fact) && !space.fits(&scene, fact) {
                return None;
            }
            space.add(&mut scene, fact);
        }
        for fact in bits::elements(&planted.negative) {
            bits::union(&mut unwanted, &space.implying[fact]);
        }
    }
    while let Some(mut choices) = space.uncovered(&scene) {
        choices.retain(|&fact| !bits::contains(&unwanted, fact));
        if choices.is_empty() {
            return None;
        }
        space.add(&mut scene, choices[random.random_range(0..choices.len())]);
    }
    // A density for each predicate, of the egos and of others: so scenes differ in what they lack. Egos of which little
    // is true show clauses with negated literals.
    let is_sparse = random.random_bool(SPARSE);
    let mut densities: BTreeMap<(usize, bool), f64> = BTreeMap::new();
    let mut facts: Vec<usize> = (0..space.facts.len()).collect();
    shuffle(&mut facts, random);
    let mut before = loud(&scene);
    for fact in facts {
        let Fact { predicate, arguments } = &space.facts[fact];
        let is_about_ego = arguments.iter().any(|&entity| entity < space.egos);
        let density = *densities.entry((*predicate, is_about_ego)).or_insert_with(|| {
            let is_sparse = is_sparse && is_about_ego && arguments.len() == 1;
            let densities: &[f64] = if is_sparse { &[0.0, 0.2] } else { &DENSITIES };
            densities[random.random_range(0..densities.len())]
        });
        let is_wanted = random.random_bool(density) && !bits::contains(&unwanted, fact);
        if is_wanted && !bits::contains(&scene, fact) && space.fits(&scene, fact) {
            let mut larger = scene.clone();
            space.add(&mut larger, fact);
            let after = loud(&larger);
            if after <= before {
                (scene, before) = (larger, after);
            }
        }
    }
    (before == 0).then_some(scene)
}
