//! Policies made of rules.

use crate::Signals;
use crate::task::PyTask;
use logicity::diag::Diagnostic;
use logicity::sim::Decider;
use numpy::{IntoPyArray, PyArray1, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use std::sync::Arc;

pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(decide, module)?)
}

/// Returns the action that the rules of a task take for each observation of a batch, from C-contiguous rows.
#[pyfunction]
fn decide<'py>(
    py: Python<'py>,
    task: &PyTask,
    observations: PyReadonlyArray2<'py, f32>,
) -> PyResult<Bound<'py, PyArray1<i64>>> {
    let (array, width) = (observations.as_array(), task.task.observation_width());
    if array.ncols() != width {
        let message = format!("expected observations of {width} numbers, not {}", array.ncols());
        return Err(PyValueError::new_err(message));
    }
    let rows = observations
        .as_slice()
        .map_err(|error| PyValueError::new_err(error.to_string()))?;
    let signals = Signals::new();
    let cancel = signals.cancel();
    let decided = signals.detach(py, || {
        let mut decider = Decider::new(Arc::clone(task.task.oracle()))?;
        let mut action = |row| match cancel.requested() {
            true => Err(Diagnostic::cancelled()),
            false => decider.action(row, &cancel),
        };
        (rows.chunks_exact(width))
            .map(|row| Ok(action(row)?.index() as i64))
            .collect::<Result<Vec<i64>, Diagnostic>>()
    })?;
    Ok(decided.map_err(|fault| task.error(py, fault))?.into_pyarray(py))
}
