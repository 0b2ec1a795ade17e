//! Policy networks that run in environments, and the trajectories that they collect.

use logicity::task::spf::{Layer, PolicyNetwork, Trajectories};
use numpy::{IntoPyArray, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<PyPolicyNetwork>()
}

/// A network that maps an observation to a logit per action and to the value of the state.
#[pyclass(name = "PolicyNetwork", module = "logicity._logicity", frozen)]
pub struct PyPolicyNetwork {
    pub network: PolicyNetwork,
    inputs: [usize; 2],
}

#[pymethods]
impl PyPolicyNetwork {
    /// `slots` has shape (slots, inputs): positions of entries of the observation, or -1. A layer has its weights, of
    /// shape (inputs, outputs), and its biases.
    #[new]
    fn new(
        width: usize,
        slots: PyReadonlyArray2<'_, i64>,
        layers: Vec<(PyReadonlyArray2<'_, f32>, PyReadonlyArray1<'_, f32>)>,
    ) -> PyResult<Self> {
        let selected = |entry: &i64| match *entry {
            -1 => Ok(None),
            entry => usize::try_from(entry).map(Some),
        };
        let rows: Vec<Vec<Option<usize>>> = (slots.as_array().rows().into_iter())
            .map(|row| row.iter().map(selected).collect::<Result<_, _>>())
            .collect::<Result<_, _>>()?;
        let layers = layers.iter().map(|(weights, bias)| Layer {
            weights: weights.as_array().iter().copied().collect(),
            bias: bias.as_array().iter().copied().collect(),
        });
        Ok(PyPolicyNetwork {
            network: PolicyNetwork::new(width, &rows, layers.collect()).map_err(PyValueError::new_err)?,
            inputs: [slots.shape()[0], slots.shape()[1]],
        })
    }

    /// Returns the logits and the value for each observation, float32 of shape (batch, 5).
    fn evaluate<'py>(
        &self,
        py: Python<'py>,
        observations: PyReadonlyArray2<'py, f32>,
    ) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let [count, width] = [observations.shape()[0], observations.shape()[1]];
        if width != self.network.width() {
            let expected = self.network.width();
            return Err(PyValueError::new_err(format!(
                "expected observations of {expected} numbers, not {width}"
            )));
        }
        // An array may have another memory layout.
        let rows: Vec<f32> = observations.as_array().iter().copied().collect();
        let mut outputs = vec![0.0; count * 5];
        for (row, out) in rows.chunks_exact(width).zip(outputs.chunks_exact_mut(5)) {
            self.network.evaluate(row, out);
        }
        outputs.into_pyarray(py).reshape([count, 5])
    }
}

impl PyPolicyNetwork {
    /// Returns the arrays of trajectories by name.
    pub fn arrays<'py>(&self, py: Python<'py>, envs: usize, done: Trajectories) -> PyResult<Bound<'py, PyDict>> {
        let by_step = [envs, done.states.len() / envs.max(1)];
        let distinct = done.outputs.len() / 5;
        let arrays = PyDict::new(py);
        arrays.set_item("states", done.states.into_pyarray(py).reshape(by_step)?)?;
        arrays.set_item("actions", done.actions.into_pyarray(py).reshape(by_step)?)?;
        arrays.set_item("rewards", done.rewards.into_pyarray(py).reshape(by_step)?)?;
        arrays.set_item("endings", done.endings.into_pyarray(py).reshape(by_step)?)?;
        arrays.set_item("next_values", done.next_values.into_pyarray(py).reshape(by_step)?)?;
        let [slots, inputs] = self.inputs;
        arrays.set_item(
            "inputs",
            done.inputs.into_pyarray(py).reshape([distinct, slots, inputs])?,
        )?;
        arrays.set_item("outputs", done.outputs.into_pyarray(py).reshape([distinct, 5])?)?;
        Ok(arrays)
    }
}
