//! Searches for the facts that matter in a scene with an unexpected answer.

use crate::induce::ask::hypothesis::{Instance, NegationRates, firing};
use crate::induce::ask::session::{End, Reason, Session};
use crate::induce::ask::space::Space;
use crate::induce::bits::{self, Bits};
use crate::induce::examples::State;
use crate::rng::{Rng, RngExt};

/// Finds examples around a state that the rules got wrong, and learns new rules.
pub fn resolve(session: &mut Session<'_>, state: &State, answer: usize) -> Result<(), End> {
    let predicted = session.hypothesis.action(state);
    if answer < predicted {
        shrink(session, state, answer, None)?;
    } else if answer > predicted {
        let instances = session.hypothesis.instances(state.entities());
        if let Some(instance) = firing(&instances, state.fact_set(), predicted).next() {
            restrict(session, state, instance)?;
        }
    }
    session.learn()
}

/// Removes entities and facts from a state as long as the oracle takes the same action, and no known clause explains it
/// except the ignored one. The answers show which facts the action needs.
pub fn shrink(session: &mut Session<'_>, state: &State, action: usize, ignored: Option<usize>) -> Result<(), End> {
    let vocabulary = session.examples.vocabulary().clone();
    let mut state = state.clone();
    let mut entity = state.entities();
    while entity > vocabulary.egos() {
        entity -= 1;
        let kept: Vec<usize> = (0..state.entities()).filter(|&other| other != entity).collect();
        let space = session.space(state.entities());
        let smaller = space.restrict(state.fact_set(), &kept, &vocabulary);
        if is_kept(session, &smaller, action, ignored)? {
            state = smaller;
        }
    }
    let space = session.space(state.entities());
    let whole = state.fact_set().clone();
    let mut random = session.random(1);
    let mut units = units(&space, &whole, &space.start());
    shuffle(&mut units, &mut random);
    // Facts that others imply come first, so that they are preferred.
    units.sort_by_key(|&fact| bits::count(&space.implied[fact]));
    let mut needed = space.start();
    while !units.is_empty() {
        if is_kept(session, &scene_within(&space, &needed, &[], &whole), action, ignored)? {
            break;
        }
        let (mut without, mut with) = (0, units.len());
        while with - without > 1 {
            let middle = without.midpoint(with);
            let scene = scene_within(&space, &needed, &units[..middle], &whole);
            if is_kept(session, &scene, action, ignored)? {
                with = middle;
            } else {
                without = middle;
            }
        }
        space.add(&mut needed, units[with - 1]);
        units.truncate(with - 1);
    }
    Ok(())
}

fn is_kept(session: &mut Session<'_>, state: &State, action: usize, ignored: Option<usize>) -> Result<bool, End> {
    let instances = session.hypothesis.instances(state.entities());
    let explains = |instance: &Instance| Some(instance.clause) != ignored;
    if firing(&instances, state.fact_set(), action).any(explains) {
        return Ok(false);
    }
    Ok(session.ask(state, Reason::Shrink)? == action)
}

/// Finds the fact that keeps a clause from deciding a state in which it holds: bisects between the smallest scene of
/// the clause and the state. If even the smallest scene has another answer, shrinks an example of the clause.
fn restrict(session: &mut Session<'_>, state: &State, instance: &Instance) -> Result<(), End> {
    let vocabulary = session.examples.vocabulary().clone();
    let mut kept: Vec<usize> = instance.assignment.iter().map(|&entity| entity.into()).collect();
    kept.sort_unstable();
    kept.dedup();
    let large = session.space(state.entities());
    let positive = large.restrict(&instance.positive, &kept, &vocabulary);
    let whole = large.restrict(state.fact_set(), &kept, &vocabulary).fact_set().clone();
    let space = session.space(kept.len());
    let mut low = space.start();
    for fact in positive.facts() {
        space.add(&mut low, fact);
    }
    let smallest = scene_within(&space, &low, &[], &whole);
    let low = smallest.fact_set().clone();
    if session.ask(&smallest, Reason::Bisect)? != instance.action {
        let example = session.supports[instance.clause].smallest.clone();
        return match example {
            Some((example, _)) => shrink(session, &example, instance.action, Some(instance.clause)),
            None => Ok(()),
        };
    }
    let mut units = units(&space, &whole, &low);
    let mut random = session.random(2);
    shuffle(&mut units, &mut random);
    let rates = NegationRates::new(&session.hypothesis);
    let weigh = |fact: &usize| rates.probability(&space, *fact);
    let mut low = low;
    let mut high = space.state(&whole);
    while units.len() > 1 {
        units.sort_by(|one, other| weigh(other).total_cmp(&weigh(one)));
        let total: f64 = units.iter().map(weigh).sum();
        let (mut half, mut sum) = (0, 0.0_f64);
        while half + 1 < units.len() && (half == 0 || sum + weigh(&units[half]) <= total / 2.0) {
            sum += weigh(&units[half]);
            half += 1;
        }
        let middle = scene_within(&space, &low, &units[..half], &whole);
        if session.ask(&middle, Reason::Bisect)? == instance.action {
            low = middle.fact_set().clone();
            units.drain(..half);
            units.retain(|&fact| !bits::contains(&low, fact));
        } else {
            units.truncate(half);
            high = middle;
        }
    }
    session.ask(&high, Reason::Bisect)?;
    Ok(())
}

/// Returns the facts of a scene that can be added to a part of it one by one: no covering facts, and of facts that
/// imply each other only the first.
fn units(space: &Space, whole: &Bits, part: &Bits) -> Vec<usize> {
    let is_unit = |&fact: &usize| {
        let is_covering = space.covers.iter().any(|cover| bits::contains(cover, fact));
        let is_first = bits::elements(&space.implied[fact])
            .all(|other| other >= fact || !bits::contains(&space.implied[other], fact));
        !bits::contains(part, fact) && !is_covering && is_first
    };
    bits::elements(whole).filter(is_unit).collect()
}

/// Returns the scene with a part of the facts of a larger one, further facts of it, and its covering facts where
/// needed.
fn scene_within(space: &Space, part: &Bits, further: &[usize], whole: &Bits) -> State {
    let mut scene = part.clone();
    further.iter().for_each(|&fact| space.add(&mut scene, fact));
    for cover in &space.covers {
        if !bits::intersects(cover, &scene) {
            let common: Bits = cover.iter().zip(whole).map(|(cover, whole)| cover & whole).collect();
            for fact in bits::elements(&common) {
                bits::union(&mut scene, &space.implied[fact]);
            }
        }
    }
    space.state(&scene)
}

/// Puts elements in random order.
pub fn shuffle<T>(elements: &mut [T], random: &mut impl Rng) {
    for at in (1..elements.len()).rev() {
        elements.swap(at, random.random_range(0..=at));
    }
}
