//! Exact probabilities of decisions in batches of scenes, with gradients: `logicity.torch.RuleLayer`.

use crate::engine::PyProgram;
use crate::{Shared, input_error};
use logicity::cancel::Cancel;
use logicity::datalog::{
    CircuitCompiler, CircuitOptions, ClauseId, EvalError, FactProof, Inexact, MarginalOptions, PredicateId,
    ProbabilityCircuit, RandomVariable, Value,
};
use numpy::ndarray::{Array1, Array4, Array5};
use numpy::ndarray::{Array3, ArrayView2, ArrayView3, ArrayView4, ArrayView5, ArrayViewMut4, ArrayViewMut5, Axis};
use numpy::{IntoPyArray, PyArray1, PyArray3, PyArray4, PyArray5, PyReadonlyArray1, PyReadonlyArray3};
use numpy::{PyReadonlyArray4, PyReadonlyArray5};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use std::collections::HashMap;
use std::ops::Range;
use std::sync::Arc;

pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<PyCircuits>()?;
    module.add_class::<PyTrace>()
}

/// The maximum size of all kept circuits and their keys: nodes and words.
const KEPT_NODES: usize = 1 << 22;

/// The source of the probability of a variable.
#[derive(Clone, Copy, Debug)]
enum Place {
    /// An element of `unary`: tick, entity, column.
    Unary([usize; 3]),
    /// An element of `binary`: tick, both entities, column.
    Binary([usize; 4]),
    /// The probability of a draw.
    Draw(f64),
    Weight(usize),
}

/// The circuits of scenes with the same certain facts: one for each ego, or a single one if there are queries or the rules
/// read earlier ticks. A circuit for one ego orders variables by that ego, which keeps its diagram small.
struct Compiled {
    parts: Vec<EgoCircuit>,
    /// The number of outputs of a part in a tick.
    block: usize,
}

/// A circuit with the facts of its variables.
struct EgoCircuit {
    circuit: ProbabilityCircuit,
    places: Vec<Place>,
}

/// Compiles scenes.
struct Batch {
    compiler: CircuitCompiler,
    /// The predicates of `unary` and `binary`.
    inputs: [Vec<PredicateId>; 2],
    queries: Vec<(PredicateId, usize)>,
    /// The words of the entities, and their positions.
    words: Vec<Value>,
    positions: HashMap<Value, usize>,
    /// The number of entities over which the rules have been grounded.
    grounded: usize,
    /// The columns of the predicates in the inputs.
    columns: HashMap<PredicateId, usize>,
    /// Circuits by what is certain. Lookup only, never iterated. `None` if circuits depend on probabilities, too.
    known: Option<HashMap<Box<[u64]>, Arc<Compiled>>>,
    kept_nodes: usize,
    order: usize,
    /// Whether the rules look back.
    has_past: bool,
}

/// Why a batch has no circuits.
enum Stop {
    Limit(EvalError),
    Inexact(Inexact),
}

/// The scenes of a batch: the facts of each tick.
struct Scenes<'s> {
    unary: ArrayView4<'s, f64>,
    binary: ArrayView5<'s, f64>,
    mask: Option<ArrayView3<'s, bool>>,
    egos: Vec<usize>,
    weights: Vec<f64>,
}

/// The facts of one scene: `unary`, `binary` and the mask.
type Scene<'s> = (ArrayView3<'s, f64>, ArrayView4<'s, f64>, Option<ArrayView2<'s, bool>>);

impl Scenes<'_> {
    /// Returns the facts of a scene.
    fn scene(&self, scene: usize) -> Scene<'_> {
        (
            self.unary.index_axis(Axis(0), scene),
            self.binary.index_axis(Axis(0), scene),
            self.mask.as_ref().map(|mask| mask.index_axis(Axis(0), scene)),
        )
    }
}

impl Batch {
    /// Interns the names `e0`, `e1`, ... of this many entities, and grounds the rules over them.
    fn set_entities(&mut self, count: usize, cancel: &Cancel) -> Result<(), Stop> {
        if self.grounded >= count {
            return Ok(());
        }
        while self.words.len() < count {
            let word = self.compiler.intern(&format!("e{}", self.words.len()));
            self.positions.insert(word, self.words.len());
            self.words.push(word);
        }
        let inputs = self.inputs.concat();
        self.compiler
            .preground(&inputs, &self.words, cancel)
            .map_err(Stop::Limit)?;
        self.grounded = count;
        Ok(())
    }

    /// Returns which facts of a scene are certain, as bits: two for each fact. Facts about absent entities do not hold.
    fn pattern((unary, binary, mask): Scene<'_>, egos: &[usize]) -> Box<[u64]> {
        let mut words = Vec::with_capacity(4 + egos.len() + (unary.len() + binary.len()).div_ceil(32));
        words.extend(binary.shape().iter().map(|length| *length as u64));
        words.extend(egos.iter().map(|ego| *ego as u64));
        let is_present = |tick: usize, entity: usize| mask.is_none_or(|mask| mask[[tick, entity]]);
        let code = |probability: f64, is_present: bool| match probability {
            _ if !is_present => 0,
            ..=0.0 => 0,
            1.0.. => 1,
            _ => 2,
        };
        let alone = unary.indexed_iter();
        let alone = alone.map(|((tick, entity, _), probability)| code(*probability, is_present(tick, entity)));
        let pairs = binary.indexed_iter();
        let pairs =
            pairs.map(|((tick, x, y, _), probability)| code(*probability, is_present(tick, x) && is_present(tick, y)));
        let (mut word, mut bits) = (0_u64, 0);
        for code in alone.chain(pairs) {
            word |= code << bits;
            bits += 2;
            if bits == 64 {
                words.push(word);
                (word, bits) = (0, 0);
            }
        }
        words.push(word);
        words.into()
    }

    /// Returns the circuit of a scene.
    fn compiled(&mut self, scenes: &Scenes<'_>, scene: usize, cancel: &Cancel) -> Result<Arc<Compiled>, Stop> {
        let facts = scenes.scene(scene);
        let pattern = (self.known.is_some()).then(|| Batch::pattern(facts, &scenes.egos));
        if let (Some(known), Some(pattern)) = (&self.known, &pattern)
            && let Some(circuit) = known.get(pattern)
        {
            return Ok(Arc::clone(circuit));
        }
        let apart = self.queries.is_empty() && !self.has_past;
        let chunks: Vec<&[usize]> = match apart && !scenes.egos.is_empty() {
            true => scenes.egos.chunks(1).collect(),
            false => vec![&scenes.egos],
        };
        let parts = chunks
            .iter()
            .map(|egos| self.part(facts, egos, &scenes.weights, cancel));
        let parts = parts.collect::<Result<Vec<EgoCircuit>, Stop>>()?;
        let made = Arc::new(Compiled {
            block: self.outputs(chunks[0].len(), facts.0.shape()[1]),
            parts,
        });
        if let (Some(known), Some(pattern)) = (&mut self.known, pattern) {
            let nodes: usize = made.parts.iter().map(|part| part.circuit.node_count()).sum();
            self.kept_nodes += nodes + pattern.len();
            if self.kept_nodes > KEPT_NODES {
                known.clear();
                self.kept_nodes = nodes + pattern.len();
            }
            known.insert(pattern, Arc::clone(&made));
        }
        Ok(made)
    }

    /// Compiles the circuit of these egos of a scene.
    fn part(&mut self, facts: Scene<'_>, egos: &[usize], weights: &[f64], cancel: &Cancel) -> Result<EgoCircuit, Stop> {
        self.compile(facts, egos, weights, cancel)?;
        let circuit = self.compiler.circuit();
        let place = |variable: &RandomVariable| match variable {
            RandomVariable::Draw(bits) => Place::Draw(f64::from_bits(*bits)),
            RandomVariable::Weight(number) => Place::Weight(*number),
            RandomVariable::Fact { tick, predicate, row } => match **row {
                [x] => Place::Unary([*tick, self.positions[&x], self.columns[predicate]]),
                [x, y] => Place::Binary([*tick, self.positions[&x], self.positions[&y], self.columns[predicate]]),
                _ => unreachable!("inputs have one column or two"),
            },
        };
        Ok(EgoCircuit {
            places: circuit.variables.iter().map(place).collect(),
            circuit,
        })
    }

    /// Compiles all ticks of a scene.
    fn compile(
        &mut self,
        (unary, binary, mask): Scene<'_>,
        egos: &[usize],
        weights: &[f64],
        cancel: &Cancel,
    ) -> Result<(), Stop> {
        let entities = unary.shape()[1];
        let egos: Vec<Value> = egos.iter().map(|ego| self.words[*ego]).collect();
        let mut rows: Vec<(PredicateId, Box<[Value]>)> = Vec::new();
        for &(predicate, arity) in &self.queries {
            for place in 0..entities.pow(arity as u32) {
                let digits = (0..arity)
                    .rev()
                    .map(|digit| place / entities.pow(digit as u32) % entities);
                rows.push((predicate, digits.map(|entity| self.words[entity]).collect()));
            }
        }
        self.compiler.begin();
        for tick in 0..unary.shape()[0] {
            let is_present = |entity: usize| mask.is_none_or(|mask| mask[[tick, entity]]);
            for ((entity, column), &probability) in unary.index_axis(Axis(0), tick).indexed_iter() {
                if probability > 0.0 && is_present(entity) {
                    let row = [self.words[entity]];
                    self.compiler.insert(self.inputs[0][column], &row, probability.min(1.0));
                }
            }
            for ((x, y, column), &probability) in binary.index_axis(Axis(0), tick).indexed_iter() {
                if probability > 0.0 && is_present(x) && is_present(y) {
                    let row = [self.words[x], self.words[y]];
                    self.compiler.insert(self.inputs[1][column], &row, probability.min(1.0));
                }
            }
            let done = self.compiler.tick(&egos, &rows, weights, cancel).map_err(Stop::Limit)?;
            done.map_err(Stop::Inexact)?;
        }
        Ok(())
    }

    /// Returns the number of outputs of a tick.
    fn outputs(&self, egos: usize, entities: usize) -> usize {
        let rows = self.queries.iter().map(|(_, arity)| entities.pow(*arity as u32));
        egos * (2 * self.order + 1) + rows.sum::<usize>()
    }
}

impl Compiled {
    /// Calls `take` with each part, the range of its outputs of a tick in the scene, and that range in the part.
    fn blocks(&self, ticks: usize, mut take: impl FnMut(usize, Range<usize>, Range<usize>)) {
        for tick in 0..ticks {
            for part in 0..self.parts.len() {
                let start = (tick * self.parts.len() + part) * self.block;
                take(
                    part,
                    start..start + self.block,
                    tick * self.block..(tick + 1) * self.block,
                );
            }
        }
    }
}

impl EgoCircuit {
    /// Returns the present probabilities of the variables.
    fn probabilities(&self, scenes: &Scenes<'_>, scene: usize) -> Vec<f64> {
        let of = |place: &Place| match *place {
            Place::Unary([tick, entity, column]) => scenes.unary[[scene, tick, entity, column]],
            Place::Binary([tick, x, y, column]) => scenes.binary[[scene, tick, x, y, column]],
            Place::Draw(probability) => probability,
            Place::Weight(number) => scenes.weights[number],
        };
        self.places.iter().map(of).collect()
    }

    /// Adds the derivatives of a scene.
    fn add_gradient(
        &self,
        gradient: &[f64],
        scene: usize,
        (unary, binary, weights): (&mut ArrayViewMut4<'_, f64>, &mut ArrayViewMut5<'_, f64>, &mut [f64]),
    ) {
        for (place, derivative) in self.places.iter().zip(gradient) {
            match *place {
                Place::Unary([tick, entity, column]) => unary[[scene, tick, entity, column]] += derivative,
                Place::Binary([tick, x, y, column]) => binary[[scene, tick, x, y, column]] += derivative,
                Place::Weight(number) => weights[number] += derivative,
                Place::Draw(_) => {}
            }
        }
    }
}

/// Circuits of the decisions by the rules of a program.
#[pyclass(name = "Circuits", module = "logicity._logicity")]
pub struct PyCircuits {
    program: Py<PyProgram>,
    batch: Shared<Batch>,
    /// Whether only the most probable proofs count.
    by_proofs: bool,
}

/// The circuits of the scenes of a batch, for their gradient.
#[pyclass(name = "CircuitTrace", module = "logicity._logicity", frozen)]
pub struct PyTrace {
    scenes: Vec<(Arc<Compiled>, Vec<Vec<f64>>)>,
    unary: [usize; 4],
    binary: [usize; 5],
    weights: usize,
}

#[pymethods]
impl PyCircuits {
    /// `inputs` are the positions of the predicates of the columns of `unary` and of `binary`, `order` those of the
    /// actions, `queries` those of other predicates. `clauses` are the positions of the clauses with a weight.
    /// `limits` are the number of proofs to keep, if not all, and that of decisions of a circuit.
    #[new]
    fn new(
        py: Python<'_>,
        program: Py<PyProgram>,
        inputs: [Vec<usize>; 2],
        order: Vec<usize>,
        queries: Vec<usize>,
        clauses: Vec<usize>,
        limits: (Option<usize>, usize),
    ) -> PyCircuits {
        let (proofs, nodes_max) = limits;
        let predicate = |place: &usize| PredicateId(u32::try_from(*place).expect("a position of a predicate"));
        let all = |places: &[usize]| places.iter().map(predicate).collect::<Vec<_>>();
        let (order, queries, inputs) = (all(&order), all(&queries), inputs.map(|places| all(&places)));
        let options = CircuitOptions {
            proofs,
            weights: (clauses.into_iter().zip(0..))
                .map(|(clause, number)| (ClauseId(u32::try_from(clause).expect("a position of a clause")), number))
                .collect(),
            marginals: MarginalOptions {
                nodes_max,
                ..MarginalOptions::default()
            },
        };
        let loaded = program.borrow(py);
        let rules = loaded.loaded().program.rules();
        let arity = |predicate: &PredicateId| (*predicate, rules.predicates[predicate.index()].arity());
        let edb = |predicate: PredicateId| rules.predicates[predicate.index()].edb.unwrap_or(predicate);
        let columns = inputs.iter().flat_map(|each| each.iter().copied().zip(0..));
        let batch = Batch {
            compiler: CircuitCompiler::new(&loaded.loaded().program, &order, &queries, &options),
            queries: queries.iter().map(arity).collect(),
            columns: columns.map(|(predicate, column)| (edb(predicate), column)).collect(),
            inputs,
            words: Vec::new(),
            positions: HashMap::new(),
            grounded: 0,
            known: proofs.is_none().then(HashMap::new),
            kept_nodes: 0,
            order: order.len(),
            has_past: !rules.pasts.is_empty(),
        };
        drop(loaded);
        PyCircuits {
            program,
            batch: Shared::new("RuleLayer", batch),
            by_proofs: proofs.is_some(),
        }
    }

    /// Returns the outputs of scenes, (B, T, outputs), and what their gradient needs. The outputs of a tick are, for
    /// each ego, the probability that it decides by each action of the order, that it decides by none, and that of each
    /// action; then the rows of each query.
    #[pyo3(signature = (unary, binary, mask, egos, weights))]
    fn forward<'py>(
        &self,
        py: Python<'py>,
        unary: PyReadonlyArray4<'py, f64>,
        binary: PyReadonlyArray5<'py, f64>,
        mask: Option<PyReadonlyArray3<'py, bool>>,
        egos: Vec<usize>,
        weights: PyReadonlyArray1<'py, f64>,
    ) -> PyResult<(Bound<'py, PyArray3<f64>>, PyTrace)> {
        let scenes = Scenes {
            unary: unary.as_array(),
            binary: binary.as_array(),
            mask: mask.as_ref().map(|mask| mask.as_array()),
            egos,
            weights: weights.as_array().to_vec(),
        };
        let (count, ticks, entities) = (
            scenes.unary.shape()[0],
            scenes.unary.shape()[1],
            scenes.unary.shape()[2],
        );
        let done = self.batch.detached(py, |batch, cancel| {
            batch.set_entities(entities, cancel)?;
            let width = batch.outputs(scenes.egos.len(), entities);
            let mut outputs = Array3::zeros((count, ticks, width));
            let mut traced = Vec::with_capacity(count);
            for (scene, mut row) in outputs.outer_iter_mut().enumerate() {
                let compiled = batch.compiled(&scenes, scene, cancel)?;
                let parts = compiled.parts.iter();
                let probabilities: Vec<Vec<f64>> = parts.map(|part| part.probabilities(&scenes, scene)).collect();
                let found = compiled.parts.iter().zip(&probabilities);
                let found: Vec<Vec<f64>> = found.map(|(part, given)| part.circuit.outputs(given)).collect();
                let row = row.as_slice_mut().expect("it is contiguous");
                compiled.blocks(ticks, |part, to, from| row[to].copy_from_slice(&found[part][from]));
                traced.push((compiled, probabilities));
            }
            Ok((outputs, traced))
        })?;
        let (outputs, traced) = done.map_err(|stop| self.error(py, &stop))?;
        let shape = scenes.binary.shape();
        let trace = PyTrace {
            scenes: traced,
            unary: [count, ticks, entities, scenes.unary.shape()[3]],
            binary: [shape[0], shape[1], shape[2], shape[3], shape[4]],
            weights: scenes.weights.len(),
        };
        Ok((outputs.into_pyarray(py), trace))
    }

    /// Returns the most probable proofs that an ego of one scene decides by the action at a place of the order, or by
    /// none if the place is its length: the probability, and the literals as `(holds, kind, positions)`. `kind` is
    /// `unary`, `binary`, `draw` or `weight`.
    #[allow(clippy::type_complexity)]
    fn proofs<'py>(
        &self,
        py: Python<'py>,
        unary: PyReadonlyArray4<'py, f64>,
        binary: PyReadonlyArray5<'py, f64>,
        mask: Option<PyReadonlyArray3<'py, bool>>,
        decision: (usize, usize),
        weights: PyReadonlyArray1<'py, f64>,
    ) -> PyResult<Vec<(f64, Vec<(bool, &'static str, Vec<usize>)>)>> {
        let (ego, place) = decision;
        let scenes = Scenes {
            unary: unary.as_array(),
            binary: binary.as_array(),
            mask: mask.as_ref().map(|mask| mask.as_array()),
            egos: vec![ego],
            weights: weights.as_array().to_vec(),
        };
        let done = self.batch.detached(py, |batch, cancel| {
            batch.set_entities(scenes.unary.shape()[2], cancel)?;
            batch.compile(scenes.scene(0), &scenes.egos, &scenes.weights, cancel)?;
            let found = batch.compiler.proofs(batch.words[ego], place).map_err(Stop::Inexact)?;
            let literal = |(variable, holds): &(RandomVariable, bool)| {
                let (kind, positions) = match variable {
                    RandomVariable::Draw(_) => ("draw", Vec::new()),
                    RandomVariable::Weight(number) => ("weight", vec![*number]),
                    RandomVariable::Fact { tick, predicate, row } => {
                        let entities = row.iter().map(|word| batch.positions[word]);
                        let positions = [*tick].into_iter().chain(entities).chain([batch.columns[predicate]]);
                        (if row.len() == 1 { "unary" } else { "binary" }, positions.collect())
                    }
                };
                (*holds, kind, positions)
            };
            let proof = |proof: &FactProof| (proof.probability, proof.literals.iter().map(literal).collect());
            Ok(found.iter().map(proof).collect())
        })?;
        done.map_err(|stop| self.error(py, &stop))
    }
}

impl PyCircuits {
    fn error(&self, py: Python<'_>, stop: &Stop) -> PyErr {
        let program = self.program.borrow(py);
        let loaded = program.loaded();
        match stop {
            Stop::Limit(error) => input_error(py, &[error.diagnostic(loaded.program.rules())], &loaded.sources),
            Stop::Inexact(Inexact::TooLarge) if self.by_proofs => PyValueError::new_err(
                "the proofs of a scene need too many steps: lower `k`, raise `nodes_max`, or make less uncertain",
            ),
            Stop::Inexact(Inexact::TooLarge) => PyValueError::new_err(
                "the diagrams of a scene are too large: raise `nodes_max`, make fewer facts uncertain, or use `top-k`",
            ),
            Stop::Inexact(reason) => {
                let reason = reason.show(loaded.program.rules());
                PyValueError::new_err(format!("{reason}; remove the aggregate from the clauses that decide"))
            }
        }
    }
}

#[pymethods]
impl PyTrace {
    /// Returns the derivatives by `unary`, `binary` and the weights of the sum of all outputs, each times its weight in
    /// `outputs`.
    #[allow(clippy::type_complexity)]
    fn backward<'py>(
        &self,
        py: Python<'py>,
        outputs: PyReadonlyArray3<'py, f64>,
    ) -> (
        Bound<'py, PyArray4<f64>>,
        Bound<'py, PyArray5<f64>>,
        Bound<'py, PyArray1<f64>>,
    ) {
        let outputs = outputs.as_array();
        let (unary, binary, weights) = py.detach(|| {
            let mut unary = Array4::zeros(self.unary);
            let mut binary = Array5::zeros(self.binary);
            let mut weights = Array1::zeros(self.weights);
            for (scene, (compiled, probabilities)) in self.scenes.iter().enumerate() {
                let wanted: Vec<f64> = outputs.index_axis(Axis(0), scene).iter().copied().collect();
                let ticks = self.unary[1];
                let mut of_parts = vec![vec![0.0; ticks * compiled.block]; compiled.parts.len()];
                compiled.blocks(ticks, |part, from, to| {
                    of_parts[part][to].copy_from_slice(&wanted[from])
                });
                let weights = weights.as_slice_mut().expect("it is contiguous");
                for ((part, given), wanted) in compiled.parts.iter().zip(probabilities).zip(&of_parts) {
                    let gradient = part.circuit.gradient(given, wanted);
                    part.add_gradient(
                        &gradient,
                        scene,
                        (&mut unary.view_mut(), &mut binary.view_mut(), weights),
                    );
                }
            }
            (unary, binary, weights)
        });
        (
            unary.into_pyarray(py),
            binary.into_pyarray(py),
            weights.into_pyarray(py),
        )
    }
}
