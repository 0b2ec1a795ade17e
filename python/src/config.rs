//! Configuration files that Python interprets.

use crate::{input_error, missing_file_error, to_python};
use logicity::builtin::BuiltinFiles;
use logicity::config::{self, Tree, load_tree, missing_file};
use logicity::diag::{self, Diagnostic, Sources};
use logicity::yaml;
use pyo3::exceptions::{PyBaseException, PyValueError};
use pyo3::prelude::*;
use std::path::PathBuf;

pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<PyConfigFile>()
}

/// A YAML file merged with its `base`, and the locations of its values.
#[pyclass(name = "ConfigFile", module = "logicity._logicity", frozen)]
struct PyConfigFile {
    tree: Tree,
    sources: Sources,
}

#[pymethods]
impl PyConfigFile {
    /// Reads a file. A bare name is a built-in file in `folder`.
    #[new]
    fn new(py: Python<'_>, path: PathBuf, folder: &str) -> PyResult<Self> {
        let mut sources = Sources::new();
        match load_tree(&mut sources, &path, folder, &BuiltinFiles) {
            Ok(tree) => Ok(PyConfigFile { tree, sources }),
            Err(faults) => Err(match missing_file(&faults) {
                Some(fault) => missing_file_error(fault),
                None => input_error(py, &faults, &sources),
            }),
        }
    }

    /// Returns the merged values.
    fn value<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        to_python(py, &self.tree.to_json())
    }

    /// Returns the path of the file that has the value at a path of keys and indices.
    #[expect(clippy::needless_pass_by_value, reason = "converted from Python")]
    fn file_of(&self, path: Vec<String>) -> Option<&str> {
        let path: Vec<&str> = path.iter().map(String::as_str).collect();
        let place = self.tree.fault(&path, yaml::codes::INVALID_VALUE, "").primary?;
        Some(self.sources.name(place.span.source))
    }

    /// Returns the `InputError` for errors in this file.
    ///
    /// Each error has a code, the path of keys and indices to its value, a message, and a help text that may be empty.
    fn error<'py>(
        &self,
        py: Python<'py>,
        faults: Vec<(String, Vec<String>, String, String)>,
    ) -> PyResult<Bound<'py, PyBaseException>> {
        let read = |(code, path, message, help): (String, Vec<String>, String, String)| {
            let mut all = [yaml::codes::CODES, config::codes::CODES, diag::codes::CODES]
                .into_iter()
                .flatten();
            let known = all.find(|known| known.name() == code);
            let code = known.ok_or_else(|| PyValueError::new_err(format!("no diagnostic has the code `{code}`")))?;
            let path: Vec<&str> = path.iter().map(String::as_str).collect();
            let fault = self.tree.fault(&path, *code, message);
            Ok(if help.is_empty() { fault } else { fault.help(help) })
        };
        let faults = faults.into_iter().map(read).collect::<PyResult<Vec<Diagnostic>>>()?;
        Ok(input_error(py, &faults, &self.sources).into_value(py).into_bound(py))
    }
}
