//! Data sets of Visual Action Prediction: creation, checks, the tables of a world as arrays, and pictures.
// Decision: docs/decisions/pictures.md#d049

use crate::city::{Loaded, one_of};
use crate::output::overwrite_if;
use crate::{LimitArguments, Signals, input_error, read_error, slice_of, threads_of, to_python};
use logicity::cancel::Cancel;
use logicity::city::Heading;
use logicity::city::{Action, Split};
use logicity::diag::{Diagnostic, Sources};
use logicity::files::{FileError, Folder, ReadError, read_file, read_folders};
use logicity::render::{
    Difficulty, DrawingVersion, Icons, Mode as PackMode, PACK_FILE_MAX, PACK_FILES_MAX, Pack, PackFault, PixelBox,
    read_mask_into, read_png_into,
};
use logicity::sim::LoadedCity;
use logicity::task::vap::codes;
use logicity::task::vap::table::{Table, boxes, sample_rows, visible};
use logicity::task::vap::{
    Agents, Dataset, DatasetError, DatasetRequest, DatasetWriter, Mode, SIDE, WORLDS_MAX, published_worlds,
};
use numpy::ndarray::{Array2, ArrayView1, array};
use numpy::{IntoPyArray, PyArray1, PyArray2, PyReadwriteArray2, PyReadwriteArray3, PyUntypedArrayMethods};
use pyo3::exceptions::{PyFileExistsError, PyFileNotFoundError, PyOSError, PyRuntimeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyString;
use serde_json::json;
use std::collections::HashMap;
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};
use std::sync::Arc;

pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("PICTURE_SIDE", SIDE)?;
    module.add("WORLDS_MAX", WORLDS_MAX)?;
    module.add_function(wrap_pyfunction!(read_world, module)?)?;
    module.add_function(wrap_pyfunction!(read_picture, module)?)?;
    module.add_function(wrap_pyfunction!(read_mask, module)?)?;
    module.add_function(wrap_pyfunction!(make_dataset, module)?)?;
    module.add_function(wrap_pyfunction!(check_dataset, module)?)
}

/// Returns the exception for a file error.
fn file_error(failed: &FileError) -> PyErr {
    let FileError { path, error, .. } = failed;
    // Python selects the subclass of `OSError` by the error number.
    if let Some(code) = error.raw_os_error() {
        return PyOSError::new_err((code, error.kind().to_string(), path.clone()));
    }
    let message = failed.to_string();
    match error.kind() {
        ErrorKind::NotFound => PyFileNotFoundError::new_err(message),
        ErrorKind::AlreadyExists | ErrorKind::NotADirectory => PyFileExistsError::new_err(message),
        _ => PyOSError::new_err(message),
    }
}

/// Returns the exception for a data set error. `sources` has the rules of the data set.
fn raise(py: Python<'_>, error: DatasetError, sources: &Sources) -> PyErr {
    match error {
        DatasetError::File(error) => file_error(&error),
        DatasetError::Faulty(faults) => input_error(py, &faults, sources),
        DatasetError::Occupied(occupied) => {
            let help = match occupied.replaceable {
                true => "choose another folder, or replace the file with `overwrite`",
                false => "choose another folder, or move it elsewhere",
            };
            PyFileExistsError::new_err(format!("{occupied}; {help}"))
        }
        error => PyRuntimeError::new_err(error.to_string()),
    }
}

/// Variant of `raise` for errors in one file, which adds its path to the diagnostics.
fn raise_in(py: Python<'_>, error: DatasetError, path: &Path) -> PyErr {
    let place = |fault: Diagnostic| fault.note(format!("in `{}`", path.display()));
    let error = match error {
        DatasetError::Faulty(faults) => DatasetError::Faulty(faults.into_iter().map(place).collect()),
        error => error,
    };
    raise(py, error, &Sources::new())
}

fn faulty(message: impl Into<String>) -> DatasetError {
    Diagnostic::new(codes::INVALID_DATA_SET, message).into()
}

/// The columns of the two tables of a world.
struct WorldTables {
    ticks: Vec<i32>,
    /// The first entity row of each sample, and the end of the last sample.
    starts: Vec<i64>,
    names: Vec<String>,
    concepts: Vec<String>,
    /// The priorities, headings and labels, with -1 for an absent heading or label.
    numbers: [Vec<i64>; 3],
    boxes: Array2<f32>,
    /// The visible fractions, with NaN outside the picture.
    visible: Vec<f32>,
    unary: Array2<bool>,
    binary: Array2<bool>,
    sees: Vec<bool>,
}

fn read_bytes(path: PathBuf) -> Result<Vec<u8>, DatasetError> {
    let action = "read";
    read_file(&path).map_err(|error| {
        let kind = match error {
            ReadError::NotFound => io::ErrorKind::NotFound,
            _ => io::ErrorKind::Other,
        };
        let error = io::Error::new(kind, error);
        FileError { action, path, error }.into()
    })
}

/// Returns the codes of a column, with -1 for absent values.
fn codes(table: &Table, name: &str, count: usize) -> Result<Vec<i64>, DatasetError> {
    let code = |value: &Option<i32>| match value {
        None => Ok(-1),
        Some(code) if usize::try_from(*code).is_ok_and(|code| code < count) => Ok(i64::from(*code)),
        Some(other) => Err(faulty(format!("{other} is not a {name}"))),
    };
    table.maybe_ints(name)?.iter().map(code).collect()
}

/// Returns boolean columns as one array of shape (rows, columns).
fn truths(table: &Table, names: &[String]) -> Result<Array2<bool>, DatasetError> {
    let mut all = Array2::from_elem((table.rows(), names.len()), false);
    for (name, mut column) in names.iter().zip(all.columns_mut()) {
        column.assign(&ArrayView1::from(table.bools(name)?));
    }
    Ok(all)
}

impl WorldTables {
    fn read(folder: &Path, number: u32, unary: &[String], binary: &[String]) -> Result<WorldTables, DatasetError> {
        let entities = Table::read(read_bytes(folder.join("entities.parquet"))?)?;
        let pairs = Table::read(read_bytes(folder.join("pairs.parquet"))?)?;
        let samples = sample_rows(number, &entities, &pairs)?;
        let priorities = entities.maybe_ints("priority")?.iter();
        let priorities =
            priorities.map(|priority| priority.map(i64::from).ok_or_else(|| faulty("a priority is missing")));
        let labels = codes(&entities, "label", Action::STANDARD.len())?;
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
            visible: (visible(&entities)?.into_iter())
                .map(|fraction| fraction.unwrap_or(f32::NAN))
                .collect(),
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
    Bound<'py, PyArray1<f32>>,
    Bound<'py, PyArray2<bool>>,
    Bound<'py, PyArray2<bool>>,
    Bound<'py, PyArray1<bool>>,
);

/// Converts strings. Equal strings share one Python object.
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
    let world = read.map_err(|error| raise_in(py, error, &folder))?;
    Ok((
        world.ticks.into_pyarray(py),
        world.starts.into_pyarray(py),
        shared_texts(py, &world.names),
        shared_texts(py, &world.concepts),
        world.numbers.map(|numbers| numbers.into_pyarray(py)).into(),
        world.boxes.into_pyarray(py),
        world.visible.into_pyarray(py),
        world.unary.into_pyarray(py),
        world.binary.into_pyarray(py),
        world.sees.into_pyarray(py),
    ))
}

/// Decodes a PNG file with these numbers of rows and columns.
fn decode(
    path: &Path,
    read: impl FnOnce(&[u8], (u32, u32), &mut [u8]) -> Result<(), String>,
    (rows, columns): (u32, u32),
    pixels: &mut [u8],
) -> Result<(), DatasetError> {
    let bytes = read_bytes(path.to_owned())?;
    read(&bytes, (columns, rows), pixels).map_err(faulty)
}

/// Decodes a picture into an array of shape (rows, columns, 3). Releases the GIL.
#[pyfunction]
fn read_picture(py: Python<'_>, path: PathBuf, mut out: PyReadwriteArray3<'_, u8>) -> PyResult<()> {
    let wrong = || PyValueError::new_err("expected an array of shape (rows, columns, 3)");
    let [rows, columns, 3] = *out.shape() else {
        return Err(wrong());
    };
    let side = |length: usize| u32::try_from(length).map_err(|_| wrong());
    let size = (side(rows)?, side(columns)?);
    let pixels = slice_of(&mut out, 3 * rows * columns)?;
    let decoded = py.detach(|| decode(&path, read_png_into, size, pixels));
    decoded.map_err(|error| raise_in(py, error, &path))
}

/// Reads a mask into an array of shape (rows, columns). Releases the GIL.
#[pyfunction]
fn read_mask(py: Python<'_>, path: PathBuf, mut out: PyReadwriteArray2<'_, u8>) -> PyResult<()> {
    let wrong = || PyValueError::new_err("expected an array of shape (rows, columns)");
    let [rows, columns] = *out.shape() else {
        return Err(wrong());
    };
    let side = |length: usize| u32::try_from(length).map_err(|_| wrong());
    let size = (side(rows)?, side(columns)?);
    let pixels = slice_of(&mut out, rows * columns)?;
    let decoded = py.detach(|| decode(&path, read_mask_into, size, pixels));
    decoded.map_err(|error| raise_in(py, error, &path))
}

fn load(py: Python<'_>, signals: &Signals, mode: Mode) -> PyResult<Loaded> {
    Loaded::new(
        py,
        signals,
        mode.config().into(),
        None,
        LimitArguments::default(),
        None,
        None,
    )
}

/// The reason why the creation of a data set cannot start.
enum BeginError {
    Unread(PathBuf, ReadError),
    Pack(String),
    Faulty(Vec<Diagnostic>),
}

fn begin(
    request: DatasetRequest,
    city: LoadedCity,
    difficulty: Difficulty,
    version: DrawingVersion,
    pack: Option<(PathBuf, PackMode)>,
) -> Result<DatasetWriter, BeginError> {
    let mut icons = Icons::new(request.icon_seed(), difficulty).with_version(version);
    if let Some((folder, mode)) = pack {
        let files = read_folders(&folder, PACK_FILES_MAX, PACK_FILE_MAX as u64);
        let files = files.map_err(|(path, error)| BeginError::Unread(path, error))?;
        let message =
            |PackFault { file, reason }: &PackFault| format!("icon `{}`: {reason}", folder.join(file).display());
        let pack = Pack::new(mode, files).map_err(|faults| {
            let messages: Vec<String> = faults.iter().map(message).collect();
            BeginError::Pack(messages.join("\n"))
        });
        icons = icons.with_pack(pack?);
    }
    DatasetWriter::new(request, city, icons).map_err(BeginError::Faulty)
}

/// Runs work on a data set with a Python progress callback, which receives the number of finished units and the total.
/// An exception in the callback cancels the work.
fn with_progress<R: Send>(
    py: Python<'_>,
    signals: &Arc<Signals>,
    progress: Option<Py<PyAny>>,
    work: impl FnOnce(&(dyn Fn(u64, u64) + Sync), &Cancel) -> R + Send,
) -> PyResult<R> {
    let report = |done: u64, total: u64| {
        let Some(callback) = &progress else { return };
        if let Err(error) = Python::attach(|py| callback.call1(py, (done, total))) {
            signals.fail(error);
        }
    };
    let cancel = signals.cancel();
    signals.detach(py, || work(&report, &cancel))
}

/// Creates the worlds that a folder lacks.
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "each is an argument in Python")]
fn make_dataset(
    py: Python<'_>,
    folder: PathBuf,
    mode: &str,
    split: &str,
    agents: &str,
    worlds: Option<u32>,
    first_world: u32,
    seed: u64,
    images: bool,
    masks: bool,
    pack: Option<PathBuf>,
    pack_mode: &str,
    difficulty: u8,
    drawing_version: u8,
    threads: usize,
    progress: Option<Py<PyAny>>,
    overwrite: bool,
) -> PyResult<()> {
    let mode = one_of("mode", mode, &Mode::ALL, Mode::name)?;
    let split = one_of("split", split, &Split::ALL, Split::name)?;
    let pack_mode = one_of("pack_mode", pack_mode, &PackMode::ALL, PackMode::name)?;
    let out_of_range = || PyValueError::new_err(format!("difficulty: expected 0 to 100, not {difficulty}"));
    let difficulty = Difficulty::percent(difficulty).ok_or_else(out_of_range)?;
    let unknown = || PyValueError::new_err(format!("drawing_version: expected 1 or 2, not {drawing_version}"));
    let version = DrawingVersion::from_number(drawing_version).ok_or_else(unknown)?;
    let worlds = worlds.unwrap_or(published_worlds(split));
    let request = DatasetRequest {
        mode,
        agents: one_of("agents", agents, &Agents::ALL, Agents::name)?,
        split,
        worlds: first_world..first_world.saturating_add(worlds),
        shard: None,
        seed,
        pictures: images,
        masks,
        threads: threads_of(threads)?,
    };
    let signals = Signals::new();
    let Loaded { city, sources, .. } = load(py, &signals, mode)?;
    let pack = pack.map(|folder| (folder, pack_mode));
    let begun = signals.on_thread(py, move || begin(request, city, difficulty, version, pack))?;
    let writer = begun.map_err(|error| match error {
        BeginError::Unread(path, error) => read_error(py, &path, &error),
        BeginError::Pack(message) => PyValueError::new_err(message),
        BeginError::Faulty(faults) => input_error(py, &faults, &sources),
    })?;
    let folder = Folder::make(&folder).map_err(|error| file_error(&error))?;
    let written = with_progress(py, &signals, progress, |progress, cancel| {
        writer.write(&folder, overwrite_if(overwrite), progress, cancel)
    })?;
    written.map_err(|error| raise(py, error, &sources))?;
    Ok(())
}

/// Checks a data set. Returns its counts.
#[pyfunction]
fn check_dataset(
    py: Python<'_>,
    folder: PathBuf,
    threads: usize,
    progress: Option<Py<PyAny>>,
) -> PyResult<Bound<'_, PyAny>> {
    let threads = threads_of(threads)?;
    let dataset = Dataset::open(Folder::new(folder)).map_err(|error| raise(py, error, &Sources::new()))?;
    let signals = Signals::new();
    let Loaded { city, sources, .. } = load(py, &signals, dataset.mode())?;
    let checked = with_progress(py, &signals, progress, |progress, cancel| {
        dataset.check(city, threads, progress, cancel)
    })?;
    checked.map_err(|error| raise(py, error, &sources))?;
    let manifest = dataset.manifest();
    let by_name = |counts: [u64; 4]| -> serde_json::Map<String, serde_json::Value> {
        let names = Action::STANDARD.iter().map(|action| action.name().to_owned());
        names.zip(counts.map(Into::into)).collect()
    };
    let counts = json!({
        "worlds": manifest.worlds.len(),
        "frames": manifest.frames,
        "pictures": manifest.pictures(),
        "agents": manifest.agents,
        "actions": by_name(manifest.actions),
        "published_actions": by_name(dataset.mode().published_actions()),
        "concepts": manifest.concepts,
        "atoms": manifest.atoms,
    });
    to_python(py, &counts)
}
