//! Trajectories of a vectorized environment under a small policy network, without a call per step.
//!
//! ```text
//! PolicyNetworks (weights) + VectorEnv + uniform random numbers -> VectorEnv::collect -> Trajectories
//! ```
//!
//! Each environment runs all its steps before the next one starts, so its memory stays in the cache. The network
//! evaluates each distinct observation once, and [`Trajectories`] stores it once.

use super::{Autoreset, ObservationKind, SubEnv, VectorEnv};
use crate::city::Action;
use crate::diag::Diagnostic;
use crate::sim::{run_polled, threads_of};
use indexmap::IndexMap;
use indexmap::map::Entry;
use rayon::prelude::*;
use smallvec::SmallVec;

/// The number of actions.
const ACTIONS: usize = Action::STANDARD.len();

/// The outputs of a network: a logit per action, and the value of the state.
const OUTPUTS: usize = ACTIONS + 1;

/// The bits of 1.0.
const ONE: u32 = 0x3F80_0000;

/// A fully connected layer.
#[derive(Clone, Debug)]
pub struct Layer {
    /// One row per input, with one weight per output.
    pub weights: Vec<f32>,
    /// One number per output.
    pub bias: Vec<f32>,
}

impl Layer {
    fn inputs(&self) -> usize {
        self.weights.len() / self.bias.len().max(1)
    }

    fn row(&self, input: usize) -> &[f32] {
        &self.weights[input * self.bias.len()..][..self.bias.len()]
    }
}

/// A network that maps an observation to a logit per action and to the value of the state.
///
/// The first layer sees the observation through *slots*. All slots share its weights. A slot selects an entry of the
/// observation for each input of the layer, or none. The next layer receives the maximum over the slots of each unit.
/// Rectified linear units follow every layer except the last one. With one slot that selects everything, this is a
/// multilayer perceptron.
///
/// The first layer adds the rows of the entries that are not 0, since most entries are 0.
#[derive(Clone, Debug)]
pub struct PolicyNetwork {
    slots: usize,
    /// The uses of each entry of the observation.
    uses: Vec<Use>,
    /// Pairs of a slot and an input of the first layer.
    places: Vec<(usize, usize)>,
    first: Layer,
    others: Vec<Layer>,
}

/// The inputs that an entry of the observation feeds.
#[derive(Clone, Debug)]
enum Use {
    /// The same input in every slot.
    Everywhere(usize),
    /// A range of [`PolicyNetwork::places`].
    Places(std::ops::Range<usize>),
}

impl PolicyNetwork {
    /// Returns a network for observations of `width` numbers. `slots` has a row per slot with the position of an entry
    /// of the observation for each input of the first layer, or `None`.
    ///
    /// # Errors
    /// A message if there is no slot, a position is out of range, or the sizes of layers do not match.
    pub fn new(width: usize, slots: &[Vec<Option<usize>>], layers: Vec<Layer>) -> Result<PolicyNetwork, String> {
        let mut layers = layers.into_iter();
        let (Some(first), Some(inputs)) = (layers.next(), slots.first().map(Vec::len)) else {
            return Err("a network has at least one layer and one slot".to_owned());
        };
        let others: Vec<Layer> = layers.collect();
        let mut expected = inputs;
        for (number, layer) in std::iter::once(&first).chain(&others).enumerate() {
            if layer.bias.is_empty() || layer.weights.len() != expected * layer.bias.len() {
                let (weights, bias) = (layer.weights.len(), layer.bias.len());
                return Err(format!(
                    "layer {number} has {expected} inputs, so it cannot have {weights} weights and {bias} biases"
                ));
            }
            expected = layer.bias.len();
        }
        if expected != OUTPUTS {
            return Err(format!("the last layer must have {OUTPUTS} outputs, not {expected}"));
        }
        let mut fed: Vec<Vec<(usize, usize)>> = vec![Vec::new(); width];
        for (slot, entries) in slots.iter().enumerate() {
            if entries.len() != inputs {
                return Err(format!("slot {slot} has {} inputs, not {inputs}", entries.len()));
            }
            for (input, entry) in entries.iter().enumerate() {
                let Some(entry) = *entry else { continue };
                let Some(fed) = fed.get_mut(entry) else {
                    return Err(format!(
                        "slot {slot} selects entry {entry} of an observation of {width}"
                    ));
                };
                fed.push((slot, input));
            }
        }
        let mut places = Vec::new();
        let uses = fed.into_iter().map(|fed| {
            let same =
                |input| fed.iter().map(|(slot, _)| *slot).eq(0..slots.len()) && fed.iter().all(|of| of.1 == input);
            match fed.first() {
                Some(&(_, input)) if same(input) => Use::Everywhere(input),
                _ => {
                    let start = places.len();
                    places.extend(fed);
                    Use::Places(start..places.len())
                }
            }
        });
        Ok(PolicyNetwork {
            slots: slots.len(),
            uses: uses.collect(),
            places,
            first,
            others,
        })
    }

    /// Returns the numbers per observation.
    pub fn width(&self) -> usize {
        self.uses.len()
    }

    /// Writes the logit of each action and the value of the state.
    ///
    /// # Panics
    /// If the observation does not have [`PolicyNetwork::width`] numbers, or `out` does not have 5.
    pub fn evaluate(&self, observation: &[f32], out: &mut [f32]) {
        assert!(
            observation.len() == self.width(),
            "an observation of {} numbers",
            self.width()
        );
        out.copy_from_slice(&self.outputs(&Key::of(observation), &mut Scratch::default()));
    }

    fn outputs(&self, key: &Key, scratch: &mut Scratch) -> [f32; OUTPUTS] {
        let units = self.first.bias.len();
        let Scratch { slots, values, next } = scratch;
        values.clear();
        values.extend_from_slice(&self.first.bias);
        key.each(|entry, number| {
            if let Use::Everywhere(input) = self.uses[entry] {
                add(values, self.first.row(input), number);
            }
        });
        if self.slots > 1 {
            slots.clear();
            slots.extend((0..self.slots).flat_map(|_| &*values));
            key.each(|entry, number| {
                if let Use::Places(places) = &self.uses[entry] {
                    for &(slot, input) in &self.places[places.clone()] {
                        add(&mut slots[slot * units..][..units], self.first.row(input), number);
                    }
                }
            });
            values.copy_from_slice(&slots[..units]);
            for slot in slots[units..].chunks_exact(units) {
                for (most, &value) in values.iter_mut().zip(slot) {
                    *most = if value > *most { value } else { *most };
                }
            }
        }
        for layer in &self.others {
            next.clear();
            next.extend_from_slice(&layer.bias);
            for (input, &value) in values.iter().enumerate() {
                if value > 0.0 {
                    add(next, layer.row(input), value);
                }
            }
            std::mem::swap(values, next);
        }
        values.as_slice().try_into().expect("the last layer has 5 outputs")
    }

    /// Writes the inputs of the first layer for an observation, slot by slot.
    fn write_inputs(&self, key: &Key, out: &mut [f32]) {
        let inputs = self.first.inputs();
        key.each(|entry, number| match &self.uses[entry] {
            Use::Everywhere(input) => (0..self.slots).for_each(|slot| out[slot * inputs + input] = number),
            Use::Places(places) => {
                for (slot, input) in &self.places[places.clone()] {
                    out[slot * inputs + input] = number;
                }
            }
        });
    }
}

/// Adds a multiple of a row.
fn add(sums: &mut [f32], row: &[f32], factor: f32) {
    for (sum, weight) in sums.iter_mut().zip(row) {
        *sum += factor * weight;
    }
}

#[derive(Debug, Default)]
struct Scratch {
    slots: Vec<f32>,
    values: Vec<f32>,
    next: Vec<f32>,
}

/// An observation in a compact form: a bit per entry, then the other entries that are neither 0 nor 1.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct Key {
    words: SmallVec<[u64; 4]>,
    numbers: Vec<(u32, u32)>,
}

impl Key {
    fn of(observation: &[f32]) -> Key {
        let mut others = false;
        let words = observation.chunks(64).map(|chunk| {
            let mut word = 0;
            for (position, number) in chunk.iter().enumerate() {
                let bits = number.to_bits();
                others |= bits != 0 && bits != ONE;
                word |= u64::from(bits == ONE) << position;
            }
            word
        });
        let words = words.collect();
        let mut numbers = Vec::new();
        if others {
            let others = (0..)
                .zip(observation)
                .filter(|(_, number)| **number != 0.0 && **number != 1.0);
            numbers.extend(others.map(|(entry, number)| (entry, number.to_bits())));
        }
        Key { words, numbers }
    }

    /// Calls `act` with each entry that is not 0, and its number.
    fn each(&self, mut act: impl FnMut(usize, f32)) {
        for (position, &word) in self.words.iter().enumerate() {
            let mut rest = word;
            while rest != 0 {
                act(position * 64 + rest.trailing_zeros() as usize, 1.0);
                rest &= rest - 1;
            }
        }
        for &(entry, bits) in &self.numbers {
            act(entry as usize, f32::from_bits(bits));
        }
    }
}

/// The end of an episode in a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ending {
    /// The episode continues.
    None = 0,
    /// The car violated a rule.
    Violation = 1,
    /// The car reached its goal without a violation.
    Success = 2,
    /// The episode reached its horizon.
    Horizon = 3,
    /// The episode of the car had ended before: its action had no effect, and its reward is 0.
    Inactive = 4,
}

/// The steps of all egos that a network drives: one ego after the other, in the order of environments.
#[derive(Clone, Debug, Default)]
pub struct Trajectories {
    /// The position of the observation among the distinct ones, for each step.
    pub states: Vec<u32>,
    /// The action of each step.
    pub actions: Vec<u8>,
    /// The reward of each step.
    pub rewards: Vec<f32>,
    /// The [`Ending`] of each step.
    pub endings: Vec<u8>,
    /// The value of the state after each step; that of the last state of an episode at its horizon, and 0 after a
    /// violation and at the goal.
    pub next_values: Vec<f32>,
    /// The inputs of the network's first layer for each distinct observation, slot by slot, in order of appearance.
    pub inputs: Vec<f32>,
    /// The outputs of the network for each distinct observation: a logit per action, and the value.
    pub outputs: Vec<f32>,
}

impl Trajectories {
    /// Adds steps of inactive egos.
    fn push_inactive(&mut self, steps: usize) {
        let all = self.states.len() + steps;
        self.states.resize(all, 0);
        self.actions.resize(all, 0);
        self.rewards.resize(all, 0.0);
        self.endings.resize(all, Ending::Inactive as u8);
        self.next_values.resize(all, 0.0);
    }
}

/// The outputs for a state.
#[derive(Clone, Copy, Debug)]
struct Evaluation {
    outputs: [f32; OUTPUTS],
    /// The sums of the first probabilities, times a constant. The last one is that constant.
    cumulative: [f32; ACTIONS],
}

impl Evaluation {
    fn of(outputs: [f32; OUTPUTS]) -> Evaluation {
        let most = outputs[..ACTIONS].iter().copied().fold(f32::NEG_INFINITY, f32::max);
        let mut sum = 0.0;
        let mut cumulative = [0.0; ACTIONS];
        for (cumulative, logit) in cumulative.iter_mut().zip(outputs) {
            sum += (logit - most).exp();
            *cumulative = sum;
        }
        Evaluation { outputs, cumulative }
    }

    /// Returns the action of a uniform random number from 0 to 1.
    fn action(&self, random: f32) -> usize {
        let [first @ .., all] = self.cumulative;
        first.iter().filter(|cumulative| **cumulative <= random * all).count()
    }

    fn value(&self) -> f32 {
        self.outputs[ACTIONS]
    }
}

/// The steps of some egos that one network drives.
#[derive(Default)]
struct NetworkChunk {
    seen: IndexMap<Key, Evaluation>,
    scratch: Scratch,
    done: Trajectories,
}

impl NetworkChunk {
    /// Returns the position of an observation among the distinct ones, and the outputs for it.
    fn evaluate(&mut self, network: &PolicyNetwork, observation: &[f32]) -> (usize, Evaluation) {
        match self.seen.entry(Key::of(observation)) {
            Entry::Occupied(known) => (known.index(), *known.get()),
            Entry::Vacant(place) => {
                let evaluation = Evaluation::of(network.outputs(place.key(), &mut self.scratch));
                (place.index(), *place.insert(evaluation))
            }
        }
    }

    /// Returns the value of an observation in which no action follows.
    fn value(&mut self, network: &PolicyNetwork, observation: &[f32]) -> f32 {
        let key = Key::of(observation);
        match self.seen.get(&key) {
            Some(known) => known.value(),
            None => network.outputs(&key, &mut self.scratch)[ACTIONS],
        }
    }
}

/// An ego in the run of an environment.
#[derive(Clone, Copy)]
struct EgoRun {
    /// The position of its network.
    network: usize,
    /// The position of its first step among the steps of the network.
    start: usize,
    ending: Ending,
}

/// The steps of some environments, by network.
struct EnvChunk {
    networks: Vec<NetworkChunk>,
    egos: Vec<EgoRun>,
    actions: Vec<Action>,
}

impl EnvChunk {
    fn new(networks: usize) -> EnvChunk {
        EnvChunk {
            networks: std::iter::repeat_with(NetworkChunk::default).take(networks).collect(),
            egos: Vec::new(),
            actions: Vec::new(),
        }
    }

    /// Runs an environment. `random` has the numbers of each ego, one per step.
    fn run(
        &mut self,
        networks: &[&PolicyNetwork],
        view: ObservationKind,
        sub_env: &mut SubEnv,
        observations: &mut [f32],
        random: &[f32],
    ) -> Result<(), Diagnostic> {
        let EnvChunk {
            networks: chunks,
            egos,
            actions,
        } = self;
        let count = sub_env.egos.len();
        let (width, steps) = (observations.len() / count, random.len() / count);
        egos.clear();
        for ego in 0..count {
            let network = ego.min(networks.len() - 1);
            let done = &mut chunks[network].done;
            let start = done.states.len();
            done.push_inactive(steps);
            egos.push(EgoRun {
                network,
                start,
                ending: Ending::Inactive,
            });
        }
        for step in 0..steps {
            actions.clear();
            for (ego, run) in egos.iter().enumerate() {
                if !sub_env.is_active(ego) {
                    actions.push(Action::STANDARD[0]);
                    continue;
                }
                let chunk = &mut chunks[run.network];
                let observation = &observations[ego * width..][..width];
                let (state, known) = chunk.evaluate(networks[run.network], observation);
                let (done, at) = (&mut chunk.done, run.start + step);
                if run.ending == Ending::None {
                    done.next_values[at - 1] = known.value();
                }
                let action = known.action(random[ego * steps + step]);
                done.states[at] = u32::try_from(state).expect("fewer states than 2^32");
                done.actions[at] = action as u8;
                // The outcome of the step follows below.
                done.endings[at] = Ending::None as u8;
                actions.push(Action::STANDARD[action]);
            }
            sub_env.step(actions, Autoreset::SameStep, view)?;
            view.write_all(sub_env.env(), observations);
            for (ego, run) in egos.iter_mut().enumerate() {
                let chunk = &mut chunks[run.network];
                let at = run.start + step;
                if chunk.done.endings[at] == Ending::Inactive as u8 {
                    run.ending = Ending::Inactive;
                    continue;
                }
                let outcome = sub_env.outcome(ego);
                let success = match sub_env.ended() {
                    Some((_, infos)) => infos[ego].success,
                    None => sub_env.info(ego).success,
                };
                run.ending = match (outcome.terminated, outcome.truncated) {
                    (_, true) => Ending::Horizon,
                    (true, false) if success => Ending::Success,
                    (true, false) => Ending::Violation,
                    (false, false) => Ending::None,
                };
                if run.ending == Ending::Horizon {
                    // All episodes reach the horizon in the same step, which begins the next ones.
                    let (last, _) = sub_env.ended().expect("the next episode has begun");
                    let last = &last[ego * width..][..width];
                    chunk.done.next_values[at] = chunk.value(networks[run.network], last);
                }
                #[allow(clippy::cast_possible_truncation)] // training needs no more digits
                let reward = outcome.reward as f32;
                chunk.done.rewards[at] = reward;
                chunk.done.endings[at] = run.ending as u8;
            }
        }
        for (ego, run) in egos.iter().enumerate().filter(|(_, run)| run.ending == Ending::None) {
            let chunk = &mut chunks[run.network];
            let value = chunk.value(networks[run.network], &observations[ego * width..][..width]);
            chunk.done.next_values[run.start + steps - 1] = value;
        }
        Ok(())
    }
}

impl VectorEnv {
    /// Runs every environment under the stochastic policies of networks: one for all egos, or one for each ego. Returns
    /// the steps of each network. `random` has one number from 0 to 1 per environment, ego and step, which selects the
    /// action. `observations` has the current observations, and receives those after the last step. An ended episode is
    /// followed by the next one in the same step, whatever the autoreset mode.
    ///
    /// # Errors
    /// As [`VectorEnv::step`], for the first environment that fails.
    ///
    /// # Panics
    /// If the length of an argument does not match, or an environment is not running.
    pub fn collect(
        &mut self,
        networks: &[&PolicyNetwork],
        random: &[f32],
        observations: &mut [f32],
    ) -> Result<Vec<Trajectories>, Diagnostic> {
        let (count, egos, width, view) = (self.sub_envs.len(), self.egos, self.width, self.view);
        let task = self.sub_envs[0].env().task();
        (task.world().vocabulary).only_standard_actions("networks that run without a call per step")?;
        assert!(
            networks.len() == 1 || networks.len() == egos,
            "a network for all egos or for each"
        );
        assert!(
            networks.iter().all(|network| network.width() == width),
            "networks for observations of {width} numbers"
        );
        assert!(observations.len() == count * egos * width, "a row for each ego");
        assert!(
            random.len().is_multiple_of(count * egos),
            "as many numbers for each ego"
        );
        let ready = |sub_env: &SubEnv| sub_env.is_ready(Autoreset::SameStep);
        assert!(self.sub_envs.iter().all(ready), "an episode must begin first");
        // The numbers of an environment.
        let (row, numbers) = (egos * width, random.len() / count);
        let threads = threads_of(self.threads.as_ref())?;
        let share = count.div_ceil(threads.as_ref().map_or(1, |pool| pool.current_num_threads()));
        let cancel = &self.cancel;
        let run = |(sub_envs, rows): (&mut [SubEnv], &mut [f32]), random: &[f32]| {
            let mut part = EnvChunk::new(networks.len());
            for (at, (sub_env, row)) in sub_envs.iter_mut().zip(rows.chunks_exact_mut(row)).enumerate() {
                if cancel.requested() {
                    sub_env.cancel()?;
                }
                part.run(networks, view, sub_env, row, &random[at * numbers..][..numbers])?;
            }
            Ok(part.networks)
        };
        let parts: Vec<Result<Vec<NetworkChunk>, Diagnostic>> = match &threads {
            Some(pool) => run_polled(pool, &|| _ = cancel.requested(), || {
                (self.sub_envs.par_chunks_mut(share))
                    .zip(observations.par_chunks_mut(share * row))
                    .enumerate()
                    .map(|(at, part)| run(part, &random[at * share * numbers..]))
                    .collect()
            }),
            None => vec![run((&mut self.sub_envs, observations), random)],
        };
        let mut by_network: Vec<Vec<NetworkChunk>> = networks.iter().map(|_| Vec::new()).collect();
        for part in parts {
            for (of, chunk) in by_network.iter_mut().zip(part?) {
                of.push(chunk);
            }
        }
        let joined = networks.iter().zip(by_network);
        Ok(joined.map(|(network, parts)| join(network, parts)).collect())
    }
}

/// Joins the steps of all environments. The order of states does not depend on the parts.
fn join(network: &PolicyNetwork, parts: Vec<NetworkChunk>) -> Trajectories {
    let mut parts = parts.into_iter();
    let Some(NetworkChunk { mut seen, mut done, .. }) = parts.next() else {
        return Trajectories::default();
    };
    for part in parts {
        let states: Vec<u32> = (part.seen.into_iter())
            .map(|(key, evaluation)| {
                let entry = seen.entry(key);
                let state = u32::try_from(entry.index()).expect("fewer states than 2^32");
                entry.or_insert(evaluation);
                state
            })
            .collect();
        let steps = part.done.states.iter().zip(&part.done.endings);
        done.states.extend(steps.map(|(&state, &ending)| match ending {
            // It has no state.
            ending if ending == Ending::Inactive as u8 => 0,
            _ => states[state as usize],
        }));
        done.actions.extend(part.done.actions);
        done.rewards.extend(part.done.rewards);
        done.endings.extend(part.done.endings);
        done.next_values.extend(part.done.next_values);
    }
    let inputs = network.slots * network.first.inputs();
    done.inputs = vec![0.0; seen.len() * inputs];
    for (row, key) in done.inputs.chunks_exact_mut(inputs).zip(seen.keys()) {
        network.write_inputs(key, row);
    }
    done.outputs = seen.values().flat_map(|evaluation| evaluation.outputs).collect();
    done
}
