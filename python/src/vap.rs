//! Data sets of Visual Action Prediction: tables of a world as arrays, and pictures.

use crate::{input_error, slice_of};
use logicity::city::Action;
use logicity::city::Heading;
use logicity::diag::{Code, Diagnostic, Sources};
use logicity::render::{PixelBox, read_png_into};
use logicity::task::vap::SIDE;
use logicity::task::vap::table::{Table, boxes, sample_rows};
use numpy::ndarray::{Array2, ArrayView1, array};
use numpy::{IntoPyArray, PyArray1, PyArray2, PyReadwriteArray3, PyUntypedArrayMethods};
use pyo3::exceptions::{PyOSError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyString;
use std::collections::HashMap;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("PICTURE_SIDE", SIDE)?;
    module.add_function(wrap_pyfunction!(read_world, module)?)?;
    module.add_function(wrap_pyfunction!(read_picture, module)?)
}

/// The reason why a file of a data set cannot be read.
enum DataSetError {
    File(PathBuf, io::Error),
    Faulty(Diagnostic),
}

impl From<Diagnostic> for DataSetError {
    fn from(fault: Diagnostic) -> Self {
        DataSetError::Faulty(fault)
    }
}

impl DataSetError {
    fn raise(self, py: Python<'_>, path: &Path) -> PyErr {
        match self {
            // The number selects the class, as in Python's own errors.
            DataSetError::File(path, error) => match error.raw_os_error() {
                Some(code) => PyOSError::new_err((code, error.kind().to_string(), path)),
                None => PyOSError::new_err(format!("cannot read `{}`: {error}", path.display())),
            },
            DataSetError::Faulty(fault) => {
                let placed = fault.note(format!("in `{}`", path.display()));
                input_error(py, &[placed], &Sources::new())
            }
        }
    }
}

fn faulty(message: impl Into<String>) -> DataSetError {
    DataSetError::Faulty(Diagnostic::new(Code::INVALID_DATA_SET, message))
}

/// The two tables of a world, row by row.
struct WorldTables {
    ticks: Vec<i32>,
    /// The first row of the entities of each sample, and the end of the last one.
    starts: Vec<i64>,
    names: Vec<String>,
    concepts: Vec<String>,
    /// Priority, heading and label; -1 for an absent heading or label.
    numbers: [Vec<i64>; 3],
    boxes: Array2<f32>,
    unary: Array2<bool>,
    binary: Array2<bool>,
    sees: Vec<bool>,
}

fn read_bytes(path: PathBuf) -> Result<Vec<u8>, DataSetError> {
    fs::read(&path).map_err(|error| DataSetError::File(path, error))
}

/// The codes of a column, -1 for absent values.
fn codes(table: &Table, name: &str, count: usize) -> Result<Vec<i64>, DataSetError> {
    let code = |value: &Option<i32>| match value {
        None => Ok(-1),
        Some(code) if usize::try_from(*code).is_ok_and(|code| code < count) => Ok(i64::from(*code)),
        Some(other) => Err(faulty(format!("{other} is not a {name}"))),
    };
    table.maybe_ints(name)?.iter().map(code).collect()
}

/// Columns of truth values side by side.
fn truths(table: &Table, names: &[String]) -> Result<Array2<bool>, DataSetError> {
    let mut all = Array2::from_elem((table.rows(), names.len()), false);
    for (name, mut column) in names.iter().zip(all.columns_mut()) {
        column.assign(&ArrayView1::from(table.bools(name)?));
    }
    Ok(all)
}

impl WorldTables {
    fn read(folder: &Path, number: u32, unary: &[String], binary: &[String]) -> Result<WorldTables, DataSetError> {
        let entities = Table::read(read_bytes(folder.join("entities.parquet"))?)?;
        let pairs = Table::read(read_bytes(folder.join("pairs.parquet"))?)?;
        let samples = sample_rows(number, &entities, &pairs)?;
        let priorities = entities.maybe_ints("priority")?.iter();
        let priorities =
            priorities.map(|priority| priority.map(i64::from).ok_or_else(|| faulty("a priority is missing")));
        let labels = codes(&entities, "label", Action::ALL.len())?;
        let names = entities.texts("name")?;
        let mut sides = Array2::from_elem((entities.rows(), 4), f32::NAN);
        for (pixels, mut place) in boxes(&entities)?.into_iter().zip(sides.rows_mut()) {
            #[expect(clippy::cast_precision_loss, reason = "the pixels of a picture are few")]
            if let Some(PixelBox { x, y, width, height }) = pixels {
                place.assign(&array![x as f32, y as f32, width as f32, height as f32]);
            }
        }
        let row = |row: usize| i64::try_from(row).expect("fewer than 2^63");
        Ok(WorldTables {
            ticks: samples.iter().map(|sample| sample.tick).collect(),
            starts: (samples.iter().map(|sample| row(sample.entities.start)))
                .chain([row(entities.rows())])
                .collect(),
            names: names.to_vec(),
            concepts: entities.texts("concepts")?.to_vec(),
            numbers: [
                priorities.collect::<Result<_, _>>()?,
                codes(&entities, "heading", Heading::ALL.len())?,
                labels,
            ],
            boxes: sides,
            unary: truths(&entities, unary)?,
            binary: truths(&pairs, binary)?,
            sees: pairs.bools("Sees")?.to_vec(),
        })
    }
}

/// The arrays of a world, see `_logicity.pyi`.
type WorldArrays<'py> = (
    Bound<'py, PyArray1<i32>>,
    Bound<'py, PyArray1<i64>>,
    Vec<Bound<'py, PyString>>,
    Vec<Bound<'py, PyString>>,
    Vec<Bound<'py, PyArray1<i64>>>,
    Bound<'py, PyArray2<f32>>,
    Bound<'py, PyArray2<bool>>,
    Bound<'py, PyArray2<bool>>,
    Bound<'py, PyArray1<bool>>,
);

/// Converts texts; equal texts share one Python object.
fn shared_texts<'py>(py: Python<'py>, texts: &[String]) -> Vec<Bound<'py, PyString>> {
    let mut made: HashMap<&str, Bound<'_, PyString>> = HashMap::new();
    let once = |text| made.entry(text).or_insert_with(|| PyString::new(py, text)).clone();
    texts.iter().map(String::as_str).map(once).collect()
}

/// Reads the tables of a world. Releases the GIL.
#[pyfunction]
fn read_world(
    py: Python<'_>,
    folder: PathBuf,
    number: u32,
    unary: Vec<String>,
    binary: Vec<String>,
) -> PyResult<WorldArrays<'_>> {
    let read = py.detach(|| WorldTables::read(&folder, number, &unary, &binary));
    let world = read.map_err(|unread| unread.raise(py, &folder))?;
    Ok((
        world.ticks.into_pyarray(py),
        world.starts.into_pyarray(py),
        shared_texts(py, &world.names),
        shared_texts(py, &world.concepts),
        world.numbers.map(|numbers| numbers.into_pyarray(py)).into(),
        world.boxes.into_pyarray(py),
        world.unary.into_pyarray(py),
        world.binary.into_pyarray(py),
        world.sees.into_pyarray(py),
    ))
}

/// Decodes a PNG of the given rows and columns.
fn decode(path: &Path, (rows, columns): (u32, u32), pixels: &mut [u8]) -> Result<(), DataSetError> {
    let bytes = read_bytes(path.to_owned())?;
    read_png_into(&bytes, (columns, rows), pixels).map_err(faulty)
}

/// Decodes a picture into an array of shape (rows, columns, 3). Releases the GIL.
#[pyfunction]
fn read_picture(py: Python<'_>, path: PathBuf, mut out: PyReadwriteArray3<'_, u8>) -> PyResult<()> {
    let wrong = || PyValueError::new_err("a picture has the shape (rows, columns, 3)");
    let [rows, columns, 3] = *out.shape() else {
        return Err(wrong());
    };
    let side = |length: usize| u32::try_from(length).map_err(|_| wrong());
    let size = (side(rows)?, side(columns)?);
    let pixels = slice_of(&mut out, 3 * rows * columns)?;
    let decoded = py.detach(|| decode(&path, size, pixels));
    decoded.map_err(|unread| unread.raise(py, &path))
}
