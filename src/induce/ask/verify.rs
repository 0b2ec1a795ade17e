//! Questions about one learned clause.
//!
//! The examples that only this clause explains have literals in common. A question falsifies as many of these as
//! possible that do not follow from the clause. If the action stays, the clause needs none of them.

use crate::induce::ask::hypothesis::{Instance, NegationRates, own_instance};
use crate::induce::ask::session::{End, Reason, Session};
use crate::induce::ask::shrink::{resolve, shuffle};
use crate::induce::ask::space::Space;
use crate::induce::ask::support::consequences;
use crate::induce::bits::{self, Bits};
use crate::induce::examples::{State, majority};
use crate::induce::vocabulary::{Literal, assignments};
use crate::rng::{Rng, RngExt};

/// The number of random scenes to compare before the learner asks one.
const TRIES: usize = 24;

/// Asks about all clauses until the rules agree with every answer.
pub fn verify(session: &mut Session<'_>) -> Result<(), End> {
    let mut index = 0;
    while index < session.hypothesis.clauses.len() {
        let Some((state, reason)) = question(session, index) else {
            index += 1;
            continue;
        };
        let action = session.ask(&state, reason)?;
        if action != session.hypothesis.action(&state) {
            resolve(session, &state, action)?;
            index = 0;
        }
    }
    Ok(())
}

/// A clause with an entity for each of its variables.
struct Subject {
    clause: usize,
    action: usize,
    /// The facts that the clause requires, with those that follow from single ones of them.
    positive: Bits,
    /// The facts that are true in every scene of the clause, and those that are false.
    closed: (Bits, Bits),
}

/// Returns the next question about a clause.
fn question(session: &mut Session<'_>, index: usize) -> Option<(State, Reason)> {
    let clause = &session.hypothesis.clauses[index];
    let (action, body) = (clause.action, clause.body.clone());
    let space = session.space(clause.variables);
    let (positive, negative) = own_instance(&session.hypothesis, index, &space);
    let mut closed = (positive.clone(), negative.clone());
    consequences(&space, &mut closed.0, &mut closed.1);
    if bits::intersects(&closed.0, &closed.1) {
        return None;
    }
    let support = &session.supports[index];
    let (all, none) = support.gap(&space, &positive, &negative);
    let is_alone = support.is_alone;
    let subject = Subject {
        clause: index,
        action,
        positive,
        closed,
    };
    let instances = session.hypothesis.instances(space.entities);
    let mut random = session.random(3);
    if !is_alone || bits::count(&all) > 0 {
        for _ in 0..TRIES {
            if let Some(scene) = smallest(&space, &subject, &instances, &all, &mut random) {
                let state = space.state(&scene);
                if !session.is_known(&state) {
                    return Some((state, Reason::Smallest(body)));
                }
            }
        }
    }
    if let Some(state) = collapsed(session, index, &mut random) {
        return Some((state, Reason::Smallest(body)));
    }
    if bits::count(&all) + bits::count(&none) == 0 {
        return None;
    }
    let weights: Vec<f64> = {
        let rates = NegationRates::new(&session.hypothesis);
        (0..space.facts.len())
            .map(|fact| rates.probability(&space, fact))
            .collect()
    };
    let mut best: Option<(u32, State)> = None;
    for _ in 0..TRIES {
        let scene = extended(&space, &subject, &instances, &none, &weights, &mut random);
        let Some(scene) = scene else { continue };
        let lost = bits::intersection_len(&all, &scene);
        let count = bits::count(&all) - lost + bits::intersection_len(&none, &scene);
        let state = space.state(&scene);
        if count > 0 && best.as_ref().is_none_or(|(most, _)| count > *most) && !session.is_known(&state) {
            best = Some((count, state));
        }
    }
    if let Some((_, state)) = best {
        return Some((state, Reason::Extended(body)));
    }
    without(session, &space, &subject, &instances)
}

/// Returns the instances that hold and take the decision from the clause, or make it ambiguous.
fn disturbing<'a>(
    instances: &'a [Instance],
    subject: &Subject,
    scene: &'a [u64],
) -> impl Iterator<Item = &'a Instance> + use<'a> {
    let (clause, action) = (subject.clause, subject.action);
    let is_own = move |instance: &Instance| {
        instance.clause == clause && {
            let mut entities = instance.assignment.clone();
            entities.sort_unstable();
            entities.dedup();
            entities.len() == instance.assignment.len()
        }
    };
    (instances.iter())
        .take_while(move |instance| instance.action <= action)
        .filter(move |instance| !is_own(instance) && instance.fires(scene))
}

/// Adds facts until no other clause decides a scene. `None` if none of those that were tried helps.
fn silence(
    space: &Space,
    subject: &Subject,
    instances: &[Instance],
    scene: &mut Bits,
    random: &mut impl Rng,
) -> Option<()> {
    loop {
        let Some(instance) = disturbing(instances, subject, scene).next() else {
            return Some(());
        };
        let helps =
            |&fact: &usize| space.fits(scene, fact) && !bits::intersects(&space.implied[fact], &subject.closed.1);
        let choices: Vec<usize> = bits::elements(&instance.negative).filter(helps).collect();
        if choices.is_empty() {
            return None;
        }
        space.add(scene, choices[random.random_range(0..choices.len())]);
    }
}

/// Chooses covering facts. Prefers those of a set.
fn cover(space: &Space, subject: &Subject, scene: &mut Bits, preferred: &Bits, random: &mut impl Rng) -> Option<()> {
    while let Some(mut choices) = space.uncovered(scene) {
        choices.retain(|&fact| !bits::intersects(&space.implied[fact], &subject.closed.1));
        if choices.iter().any(|&fact| bits::contains(preferred, fact)) {
            choices.retain(|&fact| bits::contains(preferred, fact));
        }
        if choices.is_empty() {
            return None;
        }
        space.add(scene, choices[random.random_range(0..choices.len())]);
    }
    Some(())
}

/// Returns the smallest scene of a clause that no other clause decides.
fn smallest(
    space: &Space,
    subject: &Subject,
    instances: &[Instance],
    all: &Bits,
    random: &mut impl Rng,
) -> Option<Bits> {
    let mut scene = subject.positive.clone();
    cover(space, subject, &mut scene, all, random)?;
    silence(space, subject, instances, &mut scene, random)?;
    Some(scene)
}

/// Returns the smallest scene in which a clause holds with one entity for several of its variables.
fn collapsed(session: &mut Session<'_>, index: usize, random: &mut impl Rng) -> Option<State> {
    let (variables, action) = {
        let clause = &session.hypothesis.clauses[index];
        (clause.variables, clause.action)
    };
    for entities in session.examples.vocabulary().egos()..variables {
        let space = session.space(entities);
        let instances = session.hypothesis.instances(entities);
        for instance in instances.iter().filter(|instance| instance.clause == index) {
            if !(0..entities as u8).all(|entity| instance.assignment.contains(&entity)) {
                continue;
            }
            let mut scene = space.start();
            let fits = bits::elements(&instance.positive).all(|fact| {
                let fits = bits::contains(&scene, fact) || space.fits(&scene, fact);
                space.add(&mut scene, fact);
                fits
            });
            while let Some(mut choices) = space.uncovered(&scene) {
                choices.retain(|&fact| !bits::intersects(&space.implied[fact], &instance.negative));
                if choices.is_empty() {
                    break;
                }
                space.add(&mut scene, choices[random.random_range(0..choices.len())]);
            }
            let decides = |other: &Instance| other.action > action || other.clause == index || !other.fires(&scene);
            let state = space.state(&scene);
            if fits
                && space.is_complete(&scene)
                && instance.fires(&scene)
                && instances.iter().all(decides)
                && !session.is_known(&state)
            {
                return Some(state);
            }
        }
    }
    None
}

/// Returns a scene of a clause with as many of the facts in `none` as fit and are unlikely to change the answer.
fn extended(
    space: &Space,
    subject: &Subject,
    instances: &[Instance],
    none: &Bits,
    weights: &[f64],
    random: &mut impl Rng,
) -> Option<Bits> {
    let mut facts: Vec<usize> = bits::elements(none).collect();
    shuffle(&mut facts, random);
    let mut scene = subject.positive.clone();
    if random.random_bool(0.5) {
        silence(space, subject, instances, &mut scene, random)?;
    }
    let mut disturbances = disturbing(instances, subject, &scene).count();
    let mut risk = 0.0;
    for fact in facts {
        if bits::contains(&scene, fact)
            || !space.fits(&scene, fact)
            || bits::intersects(&space.implied[fact], &subject.closed.1)
        {
            continue;
        }
        if risk > 0.0 && risk + weights[fact] > RISK_MAX {
            continue;
        }
        let mut larger = scene.clone();
        space.add(&mut larger, fact);
        let more = disturbing(instances, subject, &larger).count();
        if more <= disturbances {
            (scene, disturbances) = (larger, more);
            risk += weights[fact];
        }
    }
    let nothing = bits::empty(space.facts.len());
    cover(space, subject, &mut scene, &nothing, random)?;
    silence(space, subject, instances, &mut scene, random)?;
    Some(scene)
}

/// The largest sum of the probabilities with which the facts of a question change its answer.
const RISK_MAX: f64 = 0.7;

/// Returns a scene in which all literals of the support hold but one of the clause, if no example has shown it.
fn without(
    session: &mut Session<'_>,
    space: &Space,
    subject: &Subject,
    instances: &[Instance],
) -> Option<(State, Reason)> {
    let (all, none) = session.supports[subject.clause].literals()?.clone();
    let body = session.hypothesis.clauses[subject.clause].body.clone();
    for literal in &body.0 {
        let fact_of = |literal: &Literal, session: &Session<'_>| {
            let (vocabulary, atom) = (session.examples.vocabulary(), &literal.atom);
            vocabulary.fact(space.entities, atom.predicate, &atom.own())
        };
        let fact = fact_of(literal, session);
        let mut scene = space.start();
        let mut excluded = none.clone();
        if literal.is_negated {
            bits::subtract(&mut excluded, &space.implied[fact]);
            space.add(&mut scene, fact);
        }
        for other in bits::elements(&all) {
            let implied = &space.implied[other];
            let loses = !literal.is_negated && bits::contains(implied, fact);
            if !loses && space.fits(&scene, other) {
                space.add(&mut scene, other);
            }
        }
        while let Some(choices) = space.uncovered(&scene) {
            let Some(&choice) = choices.iter().find(|&&other| other != fact) else {
                break;
            };
            bits::subtract(&mut excluded, &space.implied[choice]);
            space.add(&mut scene, choice);
        }
        let is_literal = bits::contains(&scene, fact) == literal.is_negated;
        let mut others = body.0.iter().filter(|other| *other != literal);
        let others = others.all(|other| bits::contains(&scene, fact_of(other, session)) != other.is_negated);
        let is_covered = space.uncovered(&scene).is_none();
        if !is_literal || !others || !is_covered || bits::intersects(&excluded, &scene) {
            continue;
        }
        if (instances.iter()).any(|instance| instance.action <= subject.action && instance.fires(&scene)) {
            continue;
        }
        let state = space.state(&scene);
        if !session.is_known(&state) && !is_refuted(session, space, subject, &scene, &excluded) {
            return Some((state, Reason::Without(body.clone(), literal.clone())));
        }
    }
    None
}

/// Returns whether an example of an action of lower precedence has the true facts of a scene and none of the false
/// ones.
fn is_refuted(session: &Session<'_>, space: &Space, subject: &Subject, scene: &Bits, false_: &Bits) -> bool {
    let vocabulary = session.examples.vocabulary();
    session.examples.states().any(|(state, tallies)| {
        majority(tallies) > subject.action
            && assignments(vocabulary.egos(), space.entities, state.entities()).any(|assignment| {
                let holds = |fact: usize| {
                    let fact = &space.facts[fact];
                    let arguments: Vec<usize> = fact
                        .arguments
                        .iter()
                        .map(|&variable| assignment[variable].into())
                        .collect();
                    state.holds(vocabulary, fact.predicate, &arguments)
                };
                bits::elements(scene).all(holds) && !bits::elements(false_).any(holds)
            })
    })
}
