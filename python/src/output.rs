//! Output files that Python writes.

use logicity::files::{Output, Overwrite};
use pyo3::exceptions::{PyFileExistsError, PyFileNotFoundError, PyOSError, PyPermissionError, PyValueError};
use pyo3::prelude::*;
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};
use std::sync::Mutex;

pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<PyOutput>()
}

/// Returns which files an output may replace.
pub fn overwrite_if(any: bool) -> Overwrite {
    if any { Overwrite::Any } else { Overwrite::Own }
}

/// Returns the exception for an output file that cannot be written.
pub fn unwritable(path: &Path, error: &io::Error) -> PyErr {
    let message = format!("cannot write `{}`: {error}", path.display());
    match error.kind() {
        ErrorKind::AlreadyExists => {
            PyFileExistsError::new_err(message + "; choose another path, or replace it with `overwrite` (`--force`)")
        }
        ErrorKind::NotFound => PyFileNotFoundError::new_err(message),
        ErrorKind::PermissionDenied => PyPermissionError::new_err(message),
        _ => PyOSError::new_err(message),
    }
}

/// A file under a temporary name, which `finish` renames and `discard` removes.
#[pyclass(name = "OutputFile", module = "logicity._logicity", frozen)]
struct PyOutput {
    path: PathBuf,
    temporary: PathBuf,
    output: Mutex<Option<Output>>,
}

#[pymethods]
impl PyOutput {
    /// Begins a file of the command `by`. With `overwrite`, it replaces any file. Without `by`, it does not count as
    /// written by this package; then the caller decides which files to replace.
    #[new]
    fn new(path: PathBuf, overwrite: bool, by: Option<&str>) -> PyResult<Self> {
        let output = match by {
            Some(by) => Output::create(&path, by, overwrite_if(overwrite)),
            None => Output::edit(&path),
        };
        let output = output.map_err(|error| unwritable(&path, &error))?;
        Ok(PyOutput {
            temporary: output.temporary().to_owned(),
            output: Mutex::new(Some(output)),
            path,
        })
    }

    /// The path to write to.
    #[getter]
    fn temporary(&self) -> &Path {
        &self.temporary
    }

    /// Gives the complete file its name.
    fn finish(&self) -> PyResult<()> {
        let output = crate::locked(&self.output).take();
        let output = output.ok_or_else(|| PyValueError::new_err("the file is complete or discarded"))?;
        output.finish().map_err(|error| unwritable(&self.path, &error))
    }

    /// Removes the file unless it is complete.
    fn discard(&self) {
        drop(crate::locked(&self.output).take());
    }
}
