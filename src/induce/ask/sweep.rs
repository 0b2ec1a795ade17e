//! All scenes up to a size, each once up to the names of entities.

use crate::cancel::Cancel;
use crate::induce::ask::session::{Bound, End, Reason, Session};
use crate::induce::ask::shrink::resolve;
use crate::induce::ask::space::{Space, canonical};
use crate::induce::ask::verify::verify;
use crate::induce::bits::{self, Bits};
use crate::induce::constraints::Constraints;
use crate::induce::examples::State;
use crate::induce::vocabulary::Vocabulary;
use std::ops::ControlFlow;

/// Asks all scenes up to a size. Returns their number.
pub fn sweep(session: &mut Session<'_>, bound: Bound) -> Result<u64, End> {
    let vocabulary = session.examples.vocabulary().clone();
    let most = count_at_most(&vocabulary, session.constraints, bound);
    session.begin_sweep(bound, most);
    let mut count = 0;
    let constraints = session.constraints;
    let flow = each_scene(&vocabulary, constraints, bound, &mut |state| {
        count += 1;
        let visit = |session: &mut Session<'_>| {
            let action = session.ask(&state, Reason::Sweep)?;
            if action != session.hypothesis.action(&state) {
                resolve(session, &state, action)?;
                verify(session)?;
            }
            Ok(())
        };
        match visit(session) {
            Ok(()) => ControlFlow::Continue(()),
            Err(end) => ControlFlow::Break(end),
        }
    });
    match flow {
        ControlFlow::Continue(()) => Ok(count),
        ControlFlow::Break(end) => Err(end),
    }
}

/// Returns the number of scenes of a sweep up to the names of entities. Takes about as long as the sweep without the
/// answers. `None` if cancelled.
pub fn count_scenes(vocabulary: &Vocabulary, constraints: &Constraints, bound: Bound, cancel: &Cancel) -> Option<u64> {
    let mut count = 0_u64;
    let flow = each_scene(vocabulary, constraints, bound, &mut |_| {
        count += 1;
        if count.is_multiple_of(1024) && cancel.requested() {
            return ControlFlow::Break(());
        }
        ControlFlow::Continue(())
    });
    flow.is_continue().then_some(count)
}

/// Returns an upper bound of the number of scenes of a sweep, at once.
pub fn count_at_most(vocabulary: &Vocabulary, constraints: &Constraints, bound: Bound) -> u128 {
    (vocabulary.egos()..=bound.entities)
        .map(|entities| {
            let space = Space::new(vocabulary, constraints, entities);
            let (chosen, free) = roles(&space);
            let mut subsets = 0_u128;
            let mut binomial = 1_u128;
            for size in 0..=bound.facts.min(chosen.len()) {
                subsets = subsets.saturating_add(binomial);
                binomial = binomial.saturating_mul((chosen.len() - size) as u128) / (size as u128 + 1);
            }
            let mut choices = 1_u128;
            for cover in &space.covers {
                let own = bits::elements(cover).filter(|fact| free.contains(fact)).count();
                choices = choices.saturating_mul((1_u128 << own.min(64)) - 1);
            }
            subsets.saturating_mul(choices)
        })
        .fold(0, u128::saturating_add)
}

/// Returns the facts that count in the size of a scene, and the covering facts. Of facts that imply each other, only
/// the first is included.
fn roles(space: &Space) -> (Vec<usize>, Vec<usize>) {
    let is_possible = |&fact: &usize| {
        let is_first = bits::elements(&space.implied[fact])
            .all(|other| other >= fact || !bits::contains(&space.implied[other], fact));
        is_first && !bits::contains(&space.excluded[fact], fact) && !bits::contains(&space.always, fact)
    };
    let is_covering = |fact: &usize| space.covers.iter().any(|cover| bits::contains(cover, *fact));
    (0..space.facts.len())
        .filter(is_possible)
        .partition(|fact| !is_covering(fact))
}

/// Calls `visit` with all scenes up to a size, smaller ones first.
fn each_scene<B>(
    vocabulary: &Vocabulary,
    constraints: &Constraints,
    bound: Bound,
    visit: &mut dyn FnMut(State) -> ControlFlow<B>,
) -> ControlFlow<B> {
    for size in 0..=bound.facts {
        for entities in vocabulary.egos()..=bound.entities {
            let space = Space::new(vocabulary, constraints, entities);
            let (chosen, free) = roles(&space);
            let mut sweep = Sweep {
                vocabulary,
                space: &space,
                chosen,
                free,
                visit,
            };
            sweep.choose(&space.start(), &mut Vec::new(), 0, size)?;
        }
    }
    ControlFlow::Continue(())
}

struct Sweep<'a, B> {
    vocabulary: &'a Vocabulary,
    space: &'a Space,
    chosen: Vec<usize>,
    free: Vec<usize>,
    visit: &'a mut dyn FnMut(State) -> ControlFlow<B>,
}

impl<B> Sweep<'_, B> {
    /// Adds `left` further facts from position `begin` on, none of which follows from the others.
    fn choose(&mut self, scene: &Bits, taken: &mut Vec<usize>, begin: usize, left: usize) -> ControlFlow<B> {
        if left == 0 {
            return self.cover(scene, taken, &mut Vec::new(), 0);
        }
        for at in begin..(self.chosen.len() + 1).saturating_sub(left) {
            let fact = self.chosen[at];
            let implied = &self.space.implied[fact];
            let is_redundant = bits::contains(scene, fact) || taken.iter().any(|&other| bits::contains(implied, other));
            if !is_redundant && self.space.fits(scene, fact) {
                let mut larger = scene.clone();
                self.space.add(&mut larger, fact);
                taken.push(fact);
                self.choose(&larger, taken, at + 1, left - 1)?;
                taken.pop();
            }
        }
        ControlFlow::Continue(())
    }

    /// Decides about the covering facts from position `begin` on. Of those before, `left_out` must not hold.
    fn cover(&mut self, scene: &Bits, taken: &[usize], left_out: &mut Vec<usize>, begin: usize) -> ControlFlow<B> {
        let Some(&fact) = self.free.get(begin) else {
            return self.finish(scene);
        };
        if bits::contains(scene, fact) {
            return self.cover(scene, taken, left_out, begin + 1);
        }
        // A covering fact that implies a chosen one gives a scene with fewer chosen facts.
        let implied = &self.space.implied[fact];
        let is_unwanted = taken
            .iter()
            .chain(&*left_out)
            .any(|&other| bits::contains(implied, other));
        if self.space.fits(scene, fact) && !is_unwanted {
            let mut larger = scene.clone();
            self.space.add(&mut larger, fact);
            self.cover(&larger, taken, left_out, begin + 1)?;
        }
        left_out.push(fact);
        self.cover(scene, taken, left_out, begin + 1)?;
        left_out.pop();
        ControlFlow::Continue(())
    }

    fn finish(&mut self, scene: &Bits) -> ControlFlow<B> {
        if !self.space.is_complete(scene) {
            return ControlFlow::Continue(());
        }
        let state = self.space.state(scene);
        if canonical(self.vocabulary, &state) != state {
            return ControlFlow::Continue(());
        }
        (self.visit)(state)
    }
}
