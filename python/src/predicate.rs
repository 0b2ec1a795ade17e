//! Base predicates that Python functions compute.

use crate::locked;
use logicity::city::{AgentKind, Heading};
use logicity::diag::Diagnostic;
use logicity::sim::codes::EXTERNAL_PREDICATE;
use logicity::sim::{CityState, ExternalFacts, ExternalPredicates};
use numpy::ndarray::{Array1, Array2};
use numpy::{IntoPyArray, PyReadonlyArrayDyn};
use pyo3::prelude::*;
use pyo3::types::PyTuple;
use std::collections::BTreeSet;
use std::sync::{Arc, Mutex};

pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("KINDS", AgentKind::ALL.map(AgentKind::name))
}

/// Predicates that Python functions compute: `Functions` of `logicity.predicates`.
#[derive(Debug)]
pub struct Functions {
    functions: Py<PyAny>,
    names: Vec<String>,
    /// The exceptions that calls have raised since the last error, by their text.
    raised: Mutex<Vec<(String, PyErr)>>,
}

impl Functions {
    pub fn new(functions: &Bound<'_, PyAny>) -> PyResult<Arc<Functions>> {
        Ok(Arc::new(Functions {
            names: functions.getattr("names")?.extract()?,
            functions: functions.clone().unbind(),
            raised: Mutex::new(Vec::new()),
        }))
    }

    /// Returns the Python object.
    pub fn object(&self, py: Python<'_>) -> Py<PyAny> {
        self.functions.clone_ref(py)
    }

    /// Returns the exception that a function has raised, if it is the cause of a fault.
    pub fn exception(&self, fault: &Diagnostic) -> Option<PyErr> {
        if fault.code != EXTERNAL_PREDICATE {
            return None;
        }
        let mut raised = std::mem::take(&mut *locked(&self.raised));
        // Environments on other threads may have failed, too.
        let at = raised
            .iter()
            .position(|(text, _)| fault.message.ends_with(text.as_str()));
        at.map(|at| raised.swap_remove(at).1)
    }

    fn call(&self, py: Python<'_>, state: &CityState<'_>, facts: &mut ExternalFacts) -> PyResult<()> {
        let CityState { tick, agents, map, .. } = *state;
        let wanted = state.vocabulary.externals().filter_map(|(known, _)| {
            let at = self.names.iter().position(|name| *name == known.name)?;
            Some((at, known.arity))
        });
        let wanted: Vec<(usize, usize)> = wanted.collect();
        let concepts = state
            .scenario
            .predicates
            .iter()
            .filter_map(|predicate| predicate.definition.concept());
        let concepts: BTreeSet<&str> = concepts.map(|concept| concept.concept.as_str()).collect();
        let concepts: Vec<&str> = concepts.into_iter().collect();
        let count = agents.len();
        let code = |position: Option<usize>| position.and_then(|position| i8::try_from(position).ok()).unwrap_or(-1);
        let heading = |heading: Option<Heading>| {
            code(heading.and_then(|heading| Heading::ALL.iter().position(|known| *known == heading)))
        };
        let kind = |kind: AgentKind| code(AgentKind::ALL.iter().position(|known| *known == kind));
        let number = |number: u32| i32::try_from(number).unwrap_or(i32::MAX);
        let each = |value: &dyn Fn(usize) -> i32| Array1::from_shape_fn(count, value).into_pyarray(py);
        let cells = |cell: &dyn Fn(usize) -> [i32; 2]| {
            Array2::from_shape_fn((count, 2), |(agent, axis)| cell(agent)[axis]).into_pyarray(py)
        };
        let short = |value: &dyn Fn(usize) -> i8| Array1::from_shape_fn(count, value).into_pyarray(py);
        let carries = |(agent, concept): (usize, usize)| {
            let carried: &[String] = &agents[agent].concepts;
            carried.iter().any(|carried| carried == concepts[concept])
        };
        let carried = Array2::from_shape_fn((count, concepts.len()), carries).into_pyarray(py);
        let results = self.functions.bind(py).call1((
            wanted,
            tick,
            (map.rows(), map.cols()),
            short(&|agent| kind(agents[agent].kind)),
            cells(&|agent| [agents[agent].cell.row, agents[agent].cell.col]),
            short(&|agent| heading(agents[agent].heading)),
            cells(&|agent| [agents[agent].goal().row, agents[agent].goal().col]),
            each(&|agent| agents[agent].priority),
            each(&|agent| agents[agent].speed.into()),
            each(&|agent| number(agents[agent].waited)),
            each(&|agent| number(agents[agent].remaining())),
            (PyTuple::new(py, &concepts)?, carried),
        ))?;
        for (position, result) in results.try_iter()?.enumerate() {
            let array: PyReadonlyArrayDyn<'_, bool> = result?.extract()?;
            facts.set(position, array.as_slice()?);
        }
        Ok(())
    }
}

impl ExternalPredicates for Functions {
    fn names(&self) -> Vec<String> {
        self.names.clone()
    }

    fn compute(&self, state: &CityState<'_>, facts: &mut ExternalFacts) -> Result<(), String> {
        let failed = |error: PyErr| {
            let text = error.to_string();
            locked(&self.raised).push((text.clone(), error));
            text
        };
        Python::attach(|py| self.call(py, state, facts).map_err(failed))
    }
}
