//! Random scenes in which unknown clauses may hold.

use crate::induce::ask::hypothesis::{Instance, firing};
use crate::induce::ask::session::{End, Reason, Session};
use crate::induce::ask::shrink::{resolve, shuffle};
use crate::induce::ask::space::Space;
use crate::induce::ask::verify::verify;
use crate::induce::bits::{self, Bits};
use crate::induce::examples::State;
use crate::rng::{Rng, RngExt};

/// Scenes that are drawn before one counts as known.
const TRIES: usize = 64;

/// Asks random scenes until the rules agree in a number of consecutive ones. Asks about the clauses whenever they change.
pub fn explore(session: &mut Session<'_>) -> Result<(), End> {
    let mut agreements = 0;
    while agreements < session.asking.agreements {
        let Some(state) = scene(session) else {
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

/// Draws an unknown scene.
fn scene(session: &mut Session<'_>) -> Option<State> {
    let mut random = session.random(4);
    let egos = session.examples.vocabulary().egos();
    let most = session.asking.entities.max(egos);
    let default = session.hypothesis.default;
    for _ in 0..TRIES {
        let least = if random.random_bool(0.1) { egos } else { (egos + 1).min(most) };
        let entities = random.random_range(least..=most);
        let level = if random.random_bool(0.75) { default } else { random.random_range(0..=default) };
        let space = session.space(entities);
        let instances = session.hypothesis.instances(entities);
        if let Some(scene) = quiet(&space, &instances, level, &mut random) {
            let state = space.state(&scene);
            if !session.is_known(&state) {
                return Some(state);
            }
        }
    }
    None
}

/// Draws a scene with many facts in which no clause of an action before `level` holds.
fn quiet(space: &Space, instances: &[Instance], level: usize, random: &mut impl Rng) -> Option<Bits> {
    let loud = |scene: &Bits| level.checked_sub(1).map_or(0, |level| firing(instances, scene, level).count());
    let mut scene = space.start();
    while let Some(choices) = space.uncovered(&scene) {
        if choices.is_empty() {
            return None;
        }
        space.add(&mut scene, choices[random.random_range(0..choices.len())]);
    }
    let density = 0.2 + 0.8 * random.random::<f64>();
    let mut facts: Vec<usize> = (0..space.facts.len()).collect();
    shuffle(&mut facts, random);
    let mut before = loud(&scene);
    for fact in facts {
        if random.random_bool(density) && !bits::has(&scene, fact) && space.fits(&scene, fact) {
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
