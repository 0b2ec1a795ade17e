//! Conversion of rows from and to Python: tuples, or one numpy array per column. `arrow` converts data frames.

use crate::arrow;
use logicity::datalog::internal::{NIL, record_fields, record_of_text, record_word, shapes};
use logicity::datalog::{BaseType, Column, FunctorBatch, Predicate, RecordShape, Type, TypeId, UserFunctor, Value};
use logicity::symbol::{Symbol, Symbols, WordEncoder, WordSize};
use numpy::{Element, PyArray1, PyArrayDescrMethods, PyReadonlyArray1, PyUntypedArray, PyUntypedArrayMethods};
use pyo3::PyTypeInfo as _;
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::intern;
use pyo3::prelude::*;
use pyo3::types::{PyBool, PyDict, PyFrozenSet, PyList, PyMapping, PySet, PySlice, PyString, PyTuple};
use std::cell::RefCell;
use std::collections::HashMap;

/// The number of rows to convert between checks of signals and memory.
pub const ROWS_PER_CHECK: usize = 1 << 16;

/// Maximum depth of records in records. Python hashes and compares nested tuples on its stack.
const MAX_DEPTH: usize = 10_000;

/// What makes the words of symbols and records.
#[derive(Clone, Copy)]
pub struct Maker<'a> {
    /// Returns the word of a string.
    pub symbol: &'a dyn Fn(&str) -> PyResult<Value>,
    pub types: &'a [Type],
}

/// What a conversion of many rows needs from their session.
pub struct Target<'a> {
    pub maker: Maker<'a>,
    /// Checks that the session has memory for this number of words.
    pub room: &'a dyn Fn(usize) -> PyResult<()>,
}

/// Rows in row-major order.
pub struct Words {
    pub rows: usize,
    pub words: Vec<Value>,
}

/// Describes the type of a column for messages.
fn type_text(base: BaseType) -> &'static str {
    match base {
        BaseType::Symbol => "symbols (str)",
        BaseType::Number => "numbers (int from -2147483648 to 2147483647)",
        BaseType::Unsigned => "unsigned numbers (int from 0 to 4294967295)",
        BaseType::Float => "floats (float of 32 bits)",
        BaseType::Record => "records (tuple of their fields, or None for nil)",
    }
}

/// Describes a value of a type with branches for messages.
fn branch_text(shape: &RecordShape) -> String {
    let name = shape.branch.iter().map(|name| format!("\"{name}\""));
    let fields = shape.fields.iter().map(|(field, _)| field.clone());
    let parts: Vec<String> = name.chain(fields).collect();
    match parts.len() {
        1 => format!("({},)", parts[0]),
        _ => format!("({})", parts.join(", ")),
    }
}

/// Describes a column and its type for messages.
pub fn expects(predicate: &Predicate, column: &Column) -> String {
    format!(
        "column `{}` of `{}` holds {}",
        column.name,
        predicate.name,
        type_text(column.base)
    )
}

/// The reason why a value does not fit a column.
pub enum Misfit {
    Type,
    Range,
    /// A value that is no record of the type, for this reason.
    Record(String),
}

impl Misfit {
    /// Returns the error for a value, given what the column expects.
    fn error(self, expects: &str, value: &Bound<'_, PyAny>) -> PyResult<PyErr> {
        Ok(match self {
            Misfit::Type => PyTypeError::new_err(format!("{expects}, not {}", value.repr()?)),
            Misfit::Range => PyValueError::new_err(format!("{expects}; {} is out of range", value.repr()?)),
            // A record may be too deep to print.
            Misfit::Record(reason) => PyValueError::new_err(format!("{expects}: {reason}")),
        })
    }
}

pub fn number(base: BaseType, value: i128) -> Result<Value, Misfit> {
    match base {
        BaseType::Unsigned => u32::try_from(value).map(Value),
        _ => i32::try_from(value).map(Value::number),
    }
    .map_err(|_| Misfit::Range)
}

/// Rounds to the nearest 32-bit float. Keeps infinities and NaN. A finite number out of range is an error.
#[expect(clippy::cast_possible_truncation, reason = "rounding is what is meant")]
pub fn float(value: f64) -> Result<Value, Misfit> {
    let near = value as f32;
    match value.is_finite() && near.is_infinite() {
        true => Err(Misfit::Range),
        false => Ok(Value::float(near)),
    }
}

/// Converts a value of a column.
fn word(value: &Bound<'_, PyAny>, column: &Column, maker: Maker<'_>) -> PyResult<Result<Value, Misfit>> {
    match column.base {
        BaseType::Record => record(value, column.ty, maker),
        base => leaf(value, base, maker),
    }
}

/// Converts a value of a type other than a record.
fn leaf(value: &Bound<'_, PyAny>, base: BaseType, maker: Maker<'_>) -> PyResult<Result<Value, Misfit>> {
    if base == BaseType::Symbol {
        return match value.cast::<PyString>() {
            Ok(text) => Ok(Ok((maker.symbol)(text.to_str()?)?)),
            Err(_) => Ok(Err(Misfit::Type)),
        };
    }
    // In Python, bool is a subclass of int. Here it is an error.
    if value.is_instance_of::<PyBool>() {
        return Ok(Err(Misfit::Type));
    }
    if base == BaseType::Float {
        return Ok(match value.extract::<f64>() {
            Ok(value) => float(value),
            Err(error) if error.is_instance_of::<pyo3::exceptions::PyOverflowError>(value.py()) => Err(Misfit::Range),
            Err(_) => Err(Misfit::Type),
        });
    }
    Ok(match value.extract::<i128>() {
        Ok(value) => number(base, value),
        Err(error) if error.is_instance_of::<pyo3::exceptions::PyOverflowError>(value.py()) => Err(Misfit::Range),
        Err(_) => Err(Misfit::Type),
    })
}

/// A record whose fields are being converted.
struct Open<'a, 'py> {
    shape: &'a RecordShape,
    fields: Vec<Bound<'py, PyAny>>,
    words: Vec<u32>,
    /// The tuple and its type.
    of: (usize, TypeId),
}

/// Converts a record: a tuple or list of its fields, behind the name of its branch if its type has branches; `None` for
/// `nil`; or its text as in files of rows.
fn record(value: &Bound<'_, PyAny>, ty: TypeId, maker: Maker<'_>) -> PyResult<Result<Value, Misfit>> {
    let mut open: Vec<Open<'_, '_>> = Vec::new();
    // A tuple may occur many times, so its word is computed once.
    let mut known: HashMap<(usize, TypeId), Value> = HashMap::new();
    let (mut next, mut ty) = (value.clone(), ty);
    loop {
        let base = maker.types[ty.0 as usize].base;
        let of = (next.as_ptr() as usize, ty);
        let mut done = match (base, known.get(&of)) {
            (_, Some(word)) => Some(*word),
            (BaseType::Record, None) => match opened(&next, ty, maker)? {
                Ok(Begun::Done(word)) => Some(word),
                Ok(Begun::Open(shape, fields)) if open.len() < MAX_DEPTH => {
                    let words = Vec::with_capacity(fields.len());
                    open.push(Open {
                        shape,
                        fields,
                        words,
                        of,
                    });
                    None
                }
                Ok(Begun::Open(..)) => {
                    let reason = format!("records are nested more than {MAX_DEPTH} deep");
                    return Ok(Err(Misfit::Record(reason)));
                }
                Err(misfit) => return Ok(Err(misfit)),
            },
            (base, None) => match leaf(&next, base, maker)? {
                Ok(word) => Some(word),
                Err(misfit) => {
                    let problem = if matches!(misfit, Misfit::Range) {
                        ", which is out of range"
                    } else {
                        ""
                    };
                    let reason = format!("a field holds {}, not {}{problem}", type_text(base), next.repr()?);
                    return Ok(Err(Misfit::Record(reason)));
                }
            },
        };
        // A value may complete the records around it.
        loop {
            let Some(record) = open.last_mut() else {
                return Ok(Ok(done.unwrap_or_default()));
            };
            record.words.extend(done.take().map(|word| word.0));
            let at = record.words.len();
            if let (Some(field), Some((_, field_type))) = (record.fields.get(at), record.shape.fields.get(at)) {
                (next, ty) = (field.clone(), *field_type);
                break;
            }
            let word = record_word(record.shape, maker.types, &record.words, maker.symbol)?;
            known.insert(record.of, word);
            done = Some(word);
            open.pop();
        }
    }
}

/// The start of a record: its word, or its shape and its fields.
enum Begun<'a, 'py> {
    Done(Value),
    Open(&'a RecordShape, Vec<Bound<'py, PyAny>>),
}

fn opened<'a, 'py>(
    value: &Bound<'py, PyAny>,
    ty: TypeId,
    maker: Maker<'a>,
) -> PyResult<Result<Begun<'a, 'py>, Misfit>> {
    let shapes = shapes(maker.types, ty);
    let name = &maker.types[ty.0 as usize].name;
    let plain = shapes.iter().find(|shape| shape.branch.is_none());
    if let Ok(text) = value.cast::<PyString>() {
        // The function that interns may fail in Python.
        let failed = RefCell::new(None);
        let symbol = |text: &str| match (maker.symbol)(text) {
            Ok(word) => Some(Symbol(word.0)),
            Err(error) => {
                failed.replace(Some(error));
                None
            }
        };
        let read = record_of_text(
            text.to_str()?,
            ty,
            maker.types,
            &WordEncoder::new(&symbol, WordSize::Bits32),
        );
        if let Some(error) = failed.take() {
            return Err(error);
        }
        return Ok(match read {
            Ok(word) => Ok(Begun::Done(word)),
            Err(expected) => {
                let expected = expected.unwrap_or_else(|| "a known record".to_owned());
                Err(Misfit::Record(format!("expected {expected} in {}", value.repr()?)))
            }
        });
    }
    if value.is_none() && plain.is_some() {
        return Ok(Ok(Begun::Done((maker.symbol)(NIL)?)));
    }
    let is_row = value.is_instance_of::<PyTuple>() || value.is_instance_of::<PyList>();
    let mut fields: Vec<Bound<'py, PyAny>> = match is_row {
        true => value.try_iter()?.collect::<PyResult<_>>()?,
        false => Vec::new(),
    };
    let shape = match (plain, is_row) {
        (Some(shape), true) => Some(shape),
        (Some(_), false) => None,
        (None, _) => {
            let branch = fields.first().and_then(|first| first.cast::<PyString>().ok()).cloned();
            let branch = branch.as_ref().map(|branch| branch.to_str()).transpose()?;
            let found = shapes
                .iter()
                .find(|shape| branch.is_some() && shape.branch.as_deref() == branch);
            if found.is_some() {
                fields.remove(0);
            }
            found
        }
    };
    let Some(shape) = shape else {
        let wanted = match plain {
            Some(_) => "a tuple of its fields or None".to_owned(),
            None => {
                let all: Vec<String> = shapes.iter().map(branch_text).collect();
                all.join(" or ")
            }
        };
        let found = if is_row {
            "this tuple".to_owned()
        } else {
            value.repr()?.to_string()
        };
        return Ok(Err(Misfit::Record(format!("a `{name}` is {wanted}, not {found}"))));
    };
    if fields.len() != shape.fields.len() {
        let whole = match shape.branch {
            Some(_) => branch_text(shape),
            None => {
                let names: Vec<&str> = shape.fields.iter().map(|(name, _)| name.as_str()).collect();
                format!("({})", names.join(", "))
            }
        };
        let (wanted, found) = (shape.fields.len(), fields.len());
        let reason = format!("a `{name}` is {whole} with {wanted} fields, not {found}");
        return Ok(Err(Misfit::Record(reason)));
    }
    Ok(Ok(Begun::Open(shape, fields)))
}

/// Whether Python iterates over this in any order.
fn has_no_order(values: &Bound<'_, PyAny>) -> bool {
    values.is_instance_of::<PySet>() || values.is_instance_of::<PyFrozenSet>()
}

/// Converts a row. With `open`, `None` matches any value.
pub fn row(
    predicate: &Predicate,
    values: &Bound<'_, PyAny>,
    open: bool,
    maker: Maker<'_>,
) -> PyResult<Vec<Option<Value>>> {
    // Iterating these gives characters, keys, or values in any order.
    let is_row = values.is_instance_of::<PyTuple>() || values.is_instance_of::<PyList>();
    if !is_row && (values.is_instance_of::<PyString>() || has_no_order(values) || values.cast::<PyMapping>().is_ok()) {
        let kind = values.get_type().name()?;
        let message = format!(
            "a row of `{}` must be a tuple of its values, not a {kind}",
            predicate.name
        );
        return Err(PyTypeError::new_err(message));
    }
    let mut words = Vec::with_capacity(predicate.arity());
    let mut columns = predicate.columns.iter();
    let mut count = 0;
    let misshapen = |count: &str| {
        let (name, arity) = (&predicate.name, predicate.arity());
        PyValueError::new_err(format!("a row of `{name}` must have {arity} values, not {count}"))
    };
    for value in values.try_iter()? {
        let value = value?;
        count += 1;
        let Some(column) = columns.next() else {
            // An iterator without a length may have no end.
            return Err(misshapen(
                &values.len().map_or("more".to_owned(), |count| count.to_string()),
            ));
        };
        if open && value.is_none() {
            words.push(None);
            continue;
        }
        match word(&value, column, maker)? {
            Ok(word) => words.push(Some(word)),
            Err(misfit) => return Err(misfit.error(&expects(predicate, column), &value)?),
        }
    }
    match count == predicate.arity() {
        true => Ok(words),
        false => Err(misshapen(&count.to_string())),
    }
}

/// Converts rows in any form that `Session.insert` documents.
pub fn rows(predicate: &Predicate, given: &Bound<'_, PyAny>, target: &Target<'_>) -> PyResult<Words> {
    if let Ok(array) = given.cast::<PyUntypedArray>() {
        return of_array(predicate, array, target);
    }
    if let Ok(columns) = given.cast::<PyMapping>() {
        return of_named(
            predicate,
            &columns.keys()?.try_iter()?.collect::<PyResult<Vec<_>>>()?,
            given,
            target,
        );
    }
    if arrow::exports(given)? {
        return arrow::rows(predicate, given, target);
    }
    if given.is_instance_of::<PyString>() {
        let message = format!(
            "rows of `{}` must be a list of tuples or a numpy array, not a str",
            predicate.name
        );
        return Err(PyTypeError::new_err(message));
    }
    let mut found = Words {
        rows: 0,
        words: Vec::new(),
    };
    for values in given.try_iter()? {
        let words = row(predicate, &values?, false, target.maker);
        let words = words.map_err(|error| in_row(given.py(), found.rows, &error))?;
        found.words.extend(words.into_iter().flatten());
        found.rows += 1;
        if found.rows.is_multiple_of(ROWS_PER_CHECK) {
            given.py().check_signals()?;
            (target.room)(found.words.capacity())?;
        }
    }
    Ok(found)
}

/// Adds the number of the row to the message of an error.
fn in_row(py: Python<'_>, row: usize, error: &PyErr) -> PyErr {
    let message = format!("row {row}: {}", error.value(py));
    match error.is_instance_of::<PyTypeError>(py) {
        true => PyTypeError::new_err(message),
        // Not a subclass, such as the exception for a limit.
        false if error.get_type(py).is(PyValueError::type_object(py)) => PyValueError::new_err(message),
        false => error.clone_ref(py),
    }
}

fn of_array(predicate: &Predicate, array: &Bound<'_, PyUntypedArray>, target: &Target<'_>) -> PyResult<Words> {
    let (py, name, arity) = (array.py(), &predicate.name, predicate.arity());
    let fields = array.dtype().names();
    if let (Some(fields), 1) = (&fields, array.ndim()) {
        let fields: Vec<Bound<'_, PyAny>> = fields.iter().map(|field| PyString::new(py, field).into_any()).collect();
        return of_named(predicate, &fields, array, target);
    }
    if fields.is_some() || array.ndim() != 2 || array.shape()[1] != arity {
        let shape = array.getattr(intern!(py, "shape"))?;
        return Err(PyValueError::new_err(format!(
            "an array of rows of `{name}` must have shape (n, {arity}), or (n,) with the columns as fields, not {shape}"
        )));
    }
    let columns = array.getattr(intern!(py, "T"))?;
    let columns: PyResult<Vec<_>> = (0..arity).map(|at| columns.get_item(at)).collect();
    of_columns(predicate, &columns?, array.shape()[0], target)
}

/// Converts a mapping from column names to arrays.
fn of_named(
    predicate: &Predicate,
    keys: &[Bound<'_, PyAny>],
    given: &Bound<'_, PyAny>,
    target: &Target<'_>,
) -> PyResult<Words> {
    let mut names: Vec<String> = keys.iter().map(|key| key.extract()).collect::<PyResult<_>>()?;
    let mut wanted: Vec<&str> = predicate.columns.iter().map(|column| column.name.as_str()).collect();
    let shown = format!("[{}]", wanted.join(", "));
    names.sort_unstable();
    wanted.sort_unstable();
    if names != wanted {
        let (name, found) = (&predicate.name, names.join(", "));
        return Err(PyValueError::new_err(format!(
            "expected the columns {shown} of `{name}`, not [{found}]"
        )));
    }
    let asarray = given
        .py()
        .import(intern!(given.py(), "numpy"))?
        .getattr(intern!(given.py(), "asarray"))?;
    let columns = predicate
        .columns
        .iter()
        .map(|column| asarray.call1((given.get_item(&column.name)?,)));
    let columns: Vec<Bound<'_, PyAny>> = columns.collect::<PyResult<_>>()?;
    let rows = match columns.first() {
        Some(column) => column.len()?,
        None => 0,
    };
    of_columns(predicate, &columns, rows, target)
}

fn of_columns(
    predicate: &Predicate,
    columns: &[Bound<'_, PyAny>],
    rows: usize,
    target: &Target<'_>,
) -> PyResult<Words> {
    let arity = predicate.arity();
    let arrays = predicate.columns.iter().zip(columns).map(|(column, array)| {
        let array = array.cast::<PyUntypedArray>()?;
        if array.shape() != [rows] {
            let (expects, shape) = (expects(predicate, column), array.getattr(intern!(array.py(), "shape"))?);
            return Err(PyValueError::new_err(format!(
                "{expects}: expected an array of shape ({rows},), not {shape}"
            )));
        }
        Ok((column, array))
    });
    let arrays: Vec<_> = arrays.collect::<PyResult<_>>()?;
    // An array can have any number of rows and take no memory, if its strides are 0.
    let count = rows.saturating_mul(arity);
    (target.room)(count)?;
    let mut words = vec![Value(0); count];
    // In parts, since the conversion makes a Python object for each symbol, and a copy of numbers.
    for first in (0..rows).step_by(ROWS_PER_CHECK) {
        let end = rows.min(first + ROWS_PER_CHECK);
        for (at, (column, array)) in arrays.iter().enumerate() {
            let part = array.get_item(PySlice::new(array.py(), first.cast_signed(), end.cast_signed(), 1))?;
            let into = words[first * arity..end * arity].iter_mut().skip(at).step_by(arity);
            fill(
                predicate,
                column,
                part.cast::<PyUntypedArray>()?,
                target.maker,
                (first..).zip(into),
            )?;
            array.py().check_signals()?;
        }
    }
    Ok(Words { rows, words })
}

/// Converts an array to the words of a column. `into` has them by row.
fn fill<'a>(
    predicate: &Predicate,
    column: &Column,
    array: &Bound<'_, PyUntypedArray>,
    maker: Maker<'_>,
    into: impl Iterator<Item = (usize, &'a mut Value)>,
) -> PyResult<()> {
    match (column.base, array.dtype().kind()) {
        (BaseType::Symbol | BaseType::Record, b'U' | b'O' | b'T') => {
            for (value, (row, into)) in array.call_method0("tolist")?.try_iter()?.zip(into) {
                let value = value?;
                *into = match word(&value, column, maker)? {
                    Ok(word) => word,
                    Err(misfit) => {
                        let expects = format!("row {row}: {}", expects(predicate, column));
                        return Err(misfit.error(&expects, &value)?);
                    }
                };
            }
            Ok(())
        }
        (base @ (BaseType::Number | BaseType::Unsigned), b'i') => convert::<i64>(
            predicate,
            column,
            (array, "int64"),
            |value| number(base, value.into()),
            into,
        ),
        (base @ (BaseType::Number | BaseType::Unsigned), b'u') => convert::<u64>(
            predicate,
            column,
            (array, "uint64"),
            |value| number(base, value.into()),
            into,
        ),
        (BaseType::Float, b'f' | b'i' | b'u') => convert::<f64>(predicate, column, (array, "float64"), float, into),
        _ => {
            let message = format!("{}, not values of dtype {}", expects(predicate, column), array.dtype());
            Err(PyTypeError::new_err(message))
        }
    }
}

/// Converts an array of numbers to the words of a column, through the widest type of their kind.
fn convert<'a, T: Element + Copy + std::fmt::Display>(
    predicate: &Predicate,
    column: &Column,
    (array, dtype): (&Bound<'_, PyUntypedArray>, &str),
    word: impl Fn(T) -> Result<Value, Misfit>,
    into: impl Iterator<Item = (usize, &'a mut Value)>,
) -> PyResult<()> {
    let numpy = array.py().import(intern!(array.py(), "numpy"))?;
    // `require` accepts any byte order, strides and alignment.
    let array = numpy.call_method1(intern!(array.py(), "require"), (array, dtype, ("C", "A")))?;
    let array: PyReadonlyArray1<'_, T> = array.extract()?;
    for (&value, (row, into)) in array.as_slice()?.iter().zip(into) {
        *into = word(value).map_err(|_| {
            PyValueError::new_err(format!(
                "row {row}: {}; {value} is out of range",
                expects(predicate, column)
            ))
        })?;
    }
    Ok(())
}

/// Calls a function for a batch of calls of a functor: with an array for each argument. Returns the values.
pub fn call(
    function: &Bound<'_, PyAny>,
    functor: &UserFunctor,
    types: &[Type],
    batch: &FunctorBatch<'_>,
) -> PyResult<Vec<Option<Value>>> {
    let (py, symbols) = (function.py(), batch.symbols());
    let arguments = functor.arguments.iter().enumerate().map(|(at, argument)| {
        let words = (0..batch.len()).map(|call| batch.row(call)[at]);
        array(py, argument.base, words, symbols)
    });
    let arguments = PyTuple::new(py, arguments.collect::<PyResult<Vec<_>>>()?)?;
    let found = function.call1(arguments)?;
    let found = match found.cast::<PyUntypedArray>() {
        Ok(array) => array.call_method0(intern!(py, "tolist"))?,
        Err(_) => found,
    };
    let column = Column {
        name: String::new(),
        ty: functor.result,
        base: functor.base,
    };
    let maker = Maker {
        symbol: &|text| Ok(Value(symbols.intern(text).0)),
        types,
    };
    // `None` is `nil` where there is one.
    let has_nil = shapes(types, functor.result).iter().any(|shape| shape.branch.is_none());
    let returns = || format!("the functor `{}` returns {}", functor.name, type_text(functor.base));
    if found.is_instance_of::<PyString>()
        || has_no_order(&found)
        || found.cast::<PyMapping>().is_ok()
        || found.try_iter().is_err()
    {
        let message = format!("{}: expected a sequence of them, not {}", returns(), found.repr()?);
        return Err(PyTypeError::new_err(message));
    }
    let mut values = Vec::with_capacity(batch.len());
    for value in found.try_iter()? {
        let value = value?;
        values.push(match value.is_none() && !has_nil {
            true => None,
            false => match word(&value, &column, maker)? {
                Ok(word) => Some(word),
                Err(misfit) => return Err(misfit.error(&returns(), &value)?),
            },
        });
        if values.len() > batch.len() {
            break;
        }
    }
    // Without arguments, all calls are the same.
    if functor.arguments.is_empty() && values.len() == 1 {
        values = vec![values[0]; batch.len()];
    }
    if values.len() != batch.len() {
        let (name, wanted, found) = (&functor.name, batch.len(), values.len());
        let more = if found > wanted {
            "more".to_owned()
        } else {
            found.to_string()
        };
        let message = format!("the functor `{name}` must return {wanted} values, one for each call, not {more}");
        return Err(PyValueError::new_err(message));
    }
    Ok(values)
}

/// Converts values to Python, with one Python object per symbol and record.
struct Converter<'a, 'py> {
    py: Python<'py>,
    symbols: &'a Symbols,
    strings: HashMap<u32, Bound<'py, PyAny>>,
    /// The depths of the records among them.
    depths: HashMap<u32, usize>,
}

impl<'a, 'py> Converter<'a, 'py> {
    fn new(py: Python<'py>, symbols: &'a Symbols) -> Self {
        Converter {
            py,
            symbols,
            strings: HashMap::new(),
            depths: HashMap::new(),
        }
    }
}

impl<'py> Converter<'_, 'py> {
    fn value(&mut self, value: Value, base: BaseType) -> PyResult<Bound<'py, PyAny>> {
        Ok(match base {
            BaseType::Number => value.as_number().into_pyobject(self.py)?.into_any(),
            BaseType::Unsigned => value.0.into_pyobject(self.py)?.into_any(),
            BaseType::Float => value.as_float().into_pyobject(self.py)?.into_any(),
            BaseType::Record => self.record(value)?,
            BaseType::Symbol => {
                let text =
                    || PyString::new(self.py, self.symbols.resolve(Symbol(value.0)).unwrap_or_default()).into_any();
                self.strings.entry(value.0).or_insert_with(text).clone()
            }
        })
    }
}

impl<'py> Converter<'_, 'py> {
    /// Converts a record to a tuple of its fields, behind the name of its branch if it has one; `nil` to `None`. Equal
    /// records are one object.
    fn record(&mut self, value: Value) -> PyResult<Bound<'py, PyAny>> {
        let mut open = vec![value];
        while let Some(&value) = open.last() {
            if self.strings.contains_key(&value.0) {
                open.pop();
                continue;
            }
            let Some((branch, fields)) = record_fields(value, self.symbols) else {
                self.strings.insert(value.0, self.py.None().into_bound(self.py));
                continue;
            };
            let before = open.len();
            let inner = |(base, word): &(BaseType, Value)| {
                (*base == BaseType::Record && !self.strings.contains_key(&word.0)).then_some(*word)
            };
            open.extend(fields.iter().filter_map(inner));
            if open.len() > before {
                continue;
            }
            let depths = fields.iter().filter(|(base, _)| *base == BaseType::Record);
            let depth = 1 + depths
                .map(|(_, word)| self.depths.get(&word.0).copied().unwrap_or(0))
                .max()
                .unwrap_or(0);
            if depth > MAX_DEPTH {
                let message = format!("a record nested more than {MAX_DEPTH} deep; derive a predicate of its parts");
                return Err(PyValueError::new_err(message));
            }
            self.depths.insert(value.0, depth);
            let mut parts = Vec::with_capacity(fields.len() + 1);
            if let Some(branch) = branch {
                parts.push(PyString::intern(self.py, branch).into_any());
            }
            for (base, word) in fields {
                parts.push(self.value(word, base)?);
            }
            self.strings.insert(value.0, PyTuple::new(self.py, parts)?.into_any());
            open.pop();
        }
        Ok(self.strings[&value.0].clone())
    }
}

/// Converts rows to a list of tuples.
pub fn tuples<'py, 'r>(
    py: Python<'py>,
    columns: &[Column],
    rows: impl Iterator<Item = &'r [Value]>,
    symbols: &Symbols,
) -> PyResult<Bound<'py, PyList>> {
    let mut converter = Converter::new(py, symbols);
    let list = PyList::empty(py);
    for (position, row) in rows.enumerate() {
        let values = columns
            .iter()
            .zip(row)
            .map(|(column, &value)| converter.value(value, column.base));
        list.append(PyTuple::new(py, values.collect::<PyResult<Vec<_>>>()?)?)?;
        if position.is_multiple_of(ROWS_PER_CHECK) {
            py.check_signals()?;
        }
    }
    Ok(list)
}

/// Converts rows to a dict from column names to arrays.
pub fn arrays<'py, 'r, R: Iterator<Item = &'r [Value]>>(
    py: Python<'py>,
    columns: &[Column],
    rows: impl Fn() -> R,
    symbols: &Symbols,
) -> PyResult<Bound<'py, PyDict>> {
    let dict = PyDict::new(py);
    for (at, column) in columns.iter().enumerate() {
        let words = rows().map(|row| row[at]);
        dict.set_item(&column.name, array(py, column.base, words, symbols)?)?;
    }
    Ok(dict)
}

/// Converts the words of a column to an array.
fn array<'py>(
    py: Python<'py>,
    base: BaseType,
    words: impl Iterator<Item = Value>,
    symbols: &Symbols,
) -> PyResult<Bound<'py, PyAny>> {
    Ok(match base {
        BaseType::Number => PyArray1::from_vec(py, words.map(Value::as_number).collect()).into_any(),
        BaseType::Unsigned => PyArray1::from_vec(py, words.map(|word| word.0).collect()).into_any(),
        BaseType::Float => PyArray1::from_vec(py, words.map(Value::as_float).collect()).into_any(),
        BaseType::Symbol | BaseType::Record => {
            let mut converter = Converter::new(py, symbols);
            let values = words.map(|word| Ok(converter.value(word, base)?.unbind()));
            PyArray1::from_vec(py, values.collect::<PyResult<Vec<_>>>()?).into_any()
        }
    })
}
