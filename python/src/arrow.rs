//! Conversion of rows from and to Arrow data: data frames of pandas and Polars, tables of pyarrow, relations of DuckDB.
//!
//! Both sides exchange buffers through the Arrow PyCapsule interface, without a Python object for each value. The engine
//! keeps rows, so each column is written once in either direction.
// Decision: docs/decisions/facts.md#d087

use crate::columns::{ROWS_PER_CHECK, Target, Words, expects, float, number};
use arrow_array::cast::AsArray as _;
use arrow_array::types::{
    ArrowPrimitiveType, Decimal128Type, Float16Type, Float32Type, Float64Type, Int8Type, Int16Type, Int32Type,
    Int64Type, UInt8Type, UInt16Type, UInt32Type, UInt64Type,
};
use arrow_array::{
    Array, ArrayRef, Float32Array, Int32Array, LargeStringArray, PrimitiveArray, StringViewArray, StructArray,
    UInt32Array,
};
use arrow_schema::{DataType, Field, FieldRef, Fields};
use logicity::cancel::Cancel;
use logicity::datalog::internal::{record_of_text, whole_record};
use logicity::datalog::{BaseType, Column, Predicate, Rows, Value};
use logicity::symbol::{Symbol, Symbols, WordEncoder, WordSize};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::intern;
use pyo3::prelude::*;
use pyo3::types::PyCapsule;
use pyo3_arrow::ffi::{ArrayIterator, to_schema_pycapsule, to_stream_pycapsule};
use pyo3_arrow::input::AnyArray;
use std::cell::RefCell;
use std::iter;
use std::sync::Arc;

/// The number of rows in a batch of results.
const BATCH: usize = 1 << 18;

/// Returns whether an object exports Arrow data.
pub fn exports(given: &Bound<'_, PyAny>) -> PyResult<bool> {
    let py = given.py();
    Ok(given.hasattr(intern!(py, "__arrow_c_stream__"))? || given.hasattr(intern!(py, "__arrow_c_array__"))?)
}

/// Returns a frame of pandas without its index, which it would export as a column; anything else as it is.
fn without_index<'py>(given: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
    let py = given.py();
    let module = given.get_type().module()?;
    if module.to_str()?.split('.').next() != Some("pandas") || !given.hasattr(intern!(py, "reset_index"))? {
        return Ok(given.clone());
    }
    let options = pyo3::types::PyDict::new(py);
    options.set_item("drop", true)?;
    given.call_method(intern!(py, "reset_index"), (), Some(&options))
}

/// The reason why a value is not one of a column.
enum Fault {
    Null,
    Range(String),
    Record(String),
    Raised(PyErr),
}

/// Converts what exports Arrow data to rows of a predicate.
pub fn rows(predicate: &Predicate, given: &Bound<'_, PyAny>, target: &Target<'_>) -> PyResult<Words> {
    let py = given.py();
    let mut reader = without_index(given)?.extract::<AnyArray>()?.into_reader()?;
    let field = reader.field();
    let fields = match field.data_type() {
        DataType::Struct(fields) => fields.clone(),
        _ => Fields::from(vec![Arc::clone(&field)]),
    };
    let names: Vec<&str> = fields.iter().map(|field| field.name().as_str()).collect();
    let positions = predicate.positions_in(&names).map_err(PyValueError::new_err)?;
    for (column, &at) in predicate.columns.iter().zip(&positions) {
        let found = fields[at].data_type();
        if !fits(column.base, found) {
            let message = format!("{}, not values of the Arrow type {found}", expects(predicate, column));
            return Err(PyTypeError::new_err(message));
        }
    }
    let arity = predicate.arity();
    let mut rows = 0;
    let mut words: Vec<Value> = Vec::new();
    // A query of DuckDB runs while its result is read, on threads that may need the GIL.
    while let Some(batch) = py.detach(|| reader.next()) {
        let batch = batch.map_err(|error| PyValueError::new_err(error.to_string()))?;
        let first = words.len();
        let count = batch.len().saturating_mul(arity);
        (target.room)(words.capacity().max(first.saturating_add(count)))?;
        words.resize(first + count, Value(0));
        no_nulls(&batch)
            .map_err(|(row, _)| PyTypeError::new_err(format!("row {}: expected a row, not null", rows + row)))?;
        for (place, (&at, column)) in positions.iter().zip(&predicate.columns).enumerate() {
            py.check_signals()?;
            let array = match batch.data_type() {
                DataType::Struct(_) => batch.as_struct().column(at),
                _ => &batch,
            };
            let into = words[first..].iter_mut().skip(place).step_by(arity);
            let filled = fill(py, array, column, target, into);
            filled.map_err(|(row, fault)| {
                let expects = format!("row {}: {}", rows + row, expects(predicate, column));
                match fault {
                    Fault::Null => PyTypeError::new_err(format!("{expects}, not null")),
                    Fault::Range(value) => PyValueError::new_err(format!("{expects}; {value} is out of range")),
                    Fault::Record(reason) => PyValueError::new_err(format!("{expects}: {reason}")),
                    Fault::Raised(error) => error,
                }
            })?;
        }
        rows += batch.len();
    }
    Ok(Words { rows, words })
}

/// Returns whether a column takes values of an Arrow type.
fn fits(base: BaseType, found: &DataType) -> bool {
    match found {
        DataType::Dictionary(_, value) => fits(base, value),
        // The type of a column without values.
        DataType::Null => true,
        DataType::Utf8 | DataType::LargeUtf8 | DataType::Utf8View => {
            matches!(base, BaseType::Symbol | BaseType::Record)
        }
        // The type of sums in DuckDB.
        DataType::Decimal128(_, 0) => matches!(base, BaseType::Number | BaseType::Unsigned),
        DataType::Float16 | DataType::Float32 | DataType::Float64 => base == BaseType::Float,
        found if found.is_integer() => matches!(base, BaseType::Number | BaseType::Unsigned | BaseType::Float),
        _ => false,
    }
}

/// Checks that no value of an array is null.
fn no_nulls(array: &dyn Array) -> Result<(), (usize, Fault)> {
    let nulls = array.logical_nulls();
    match nulls.and_then(|nulls| nulls.iter().position(|valid| !valid)) {
        Some(row) => Err((row, Fault::Null)),
        None => Ok(()),
    }
}

/// Converts an array whose type [fits](fits) the column.
fn fill<'a>(
    py: Python<'_>,
    array: &ArrayRef,
    column: &Column,
    target: &Target<'_>,
    into: impl Iterator<Item = &'a mut Value>,
) -> Result<(), (usize, Fault)> {
    no_nulls(array)?;
    if array.is_empty() {
        return Ok(());
    }
    macro_rules! numbers {
        ($ty:ty) => {
            match column.base {
                BaseType::Float => convert::<$ty>(array, into, |value| float(value as f64).ok()),
                base => convert::<$ty>(array, into, |value| number(base, value.into()).ok()),
            }
        };
    }
    macro_rules! floats {
        ($ty:ty) => {
            convert::<$ty>(array, into, |value| float(value.into()).ok())
        };
    }
    match array.data_type() {
        DataType::Int8 => numbers!(Int8Type),
        DataType::Int16 => numbers!(Int16Type),
        DataType::Int32 => numbers!(Int32Type),
        DataType::Int64 => numbers!(Int64Type),
        DataType::UInt8 => numbers!(UInt8Type),
        DataType::UInt16 => numbers!(UInt16Type),
        DataType::UInt32 => numbers!(UInt32Type),
        DataType::UInt64 => numbers!(UInt64Type),
        DataType::Decimal128(..) => numbers!(Decimal128Type),
        DataType::Float16 => floats!(Float16Type),
        DataType::Float32 => floats!(Float32Type),
        DataType::Float64 => floats!(Float64Type),
        DataType::Dictionary(..) => {
            let dictionary = array.as_any_dictionary();
            let values = dictionary.values();
            // Each value is converted at its first use; the dictionary may have others that do not fit.
            let mut known: Vec<Option<Value>> = vec![None; values.len()];
            for (row, (key, into)) in dictionary.normalized_keys().into_iter().zip(into).enumerate() {
                *into = match known[key] {
                    Some(word) => word,
                    None => {
                        let mut word = Value(0);
                        let one = values.slice(key, 1);
                        fill(py, &one, column, target, iter::once(&mut word)).map_err(|(_, fault)| (row, fault))?;
                        *known[key].insert(word)
                    }
                };
            }
            Ok(())
        }
        DataType::Utf8 => strings(py, array.as_string::<i32>().iter(), column, target, into),
        DataType::LargeUtf8 => strings(py, array.as_string::<i64>().iter(), column, target, into),
        _ => {
            let array: &StringViewArray = array.as_string_view();
            strings(py, array.iter(), column, target, into)
        }
    }
}

/// Converts numbers; `word` returns `None` if one is out of range.
fn convert<'a, T: ArrowPrimitiveType>(
    array: &dyn Array,
    into: impl Iterator<Item = &'a mut Value>,
    word: impl Fn(T::Native) -> Option<Value>,
) -> Result<(), (usize, Fault)>
where
    T::Native: std::fmt::Debug,
{
    let array: &PrimitiveArray<T> = array.as_primitive();
    for (row, (&value, into)) in array.values().iter().zip(into).enumerate() {
        *into = word(value).ok_or_else(|| (row, Fault::Range(format!("{value:?}"))))?;
    }
    Ok(())
}

/// Converts symbols, or the text of records.
fn strings<'t, 'a>(
    py: Python<'_>,
    texts: impl Iterator<Item = Option<&'t str>>,
    column: &Column,
    target: &Target<'_>,
    into: impl Iterator<Item = &'a mut Value>,
) -> Result<(), (usize, Fault)> {
    for (row, (text, into)) in texts.zip(into).enumerate() {
        if row.is_multiple_of(ROWS_PER_CHECK) {
            py.check_signals().map_err(|error| (row, Fault::Raised(error)))?;
        }
        let text = text.ok_or((row, Fault::Null))?;
        let word = match column.base {
            BaseType::Record => record(text, column, target),
            _ => (target.maker.symbol)(text).map_err(Fault::Raised),
        };
        *into = word.map_err(|fault| (row, fault))?;
    }
    Ok(())
}

/// Converts the text of a record.
fn record(text: &str, column: &Column, target: &Target<'_>) -> Result<Value, Fault> {
    let failed = RefCell::new(None);
    let symbol = |text: &str| match (target.maker.symbol)(text) {
        Ok(word) => Some(Symbol(word.0)),
        Err(error) => {
            failed.replace(Some(error));
            None
        }
    };
    let read = record_of_text(
        text,
        column.ty,
        target.maker.types,
        &WordEncoder::new(&symbol, WordSize::Bits32),
    );
    match (failed.take(), read) {
        (Some(error), _) => Err(Fault::Raised(error)),
        (None, Ok(word)) => Ok(word),
        (None, Err(expected)) => {
            let expected = expected.unwrap_or_else(|| "a known record".to_owned());
            Err(Fault::Record(format!("expected {expected} in {text:?}")))
        }
    }
}

/// Returns the field of rows with these columns.
fn field_of(columns: &[Column]) -> FieldRef {
    let fields = columns.iter().map(|column| {
        let ty = match column.base {
            BaseType::Number => DataType::Int32,
            BaseType::Unsigned => DataType::UInt32,
            BaseType::Float => DataType::Float32,
            BaseType::Symbol | BaseType::Record => DataType::LargeUtf8,
        };
        Field::new(&column.name, ty, true)
    });
    Arc::new(Field::new_struct("", fields.collect::<Vec<_>>(), false))
}

/// Returns the schema of rows with these columns.
pub fn schema<'py>(py: Python<'py>, columns: &[Column]) -> PyResult<Bound<'py, PyCapsule>> {
    Ok(to_schema_pycapsule(py, field_of(columns).as_ref())?)
}

/// Returns a stream of batches.
pub fn stream<'py>(
    py: Python<'py>,
    columns: &[Column],
    batches: Vec<ArrayRef>,
    requested_schema: Option<Bound<'py, PyCapsule>>,
) -> PyResult<Bound<'py, PyCapsule>> {
    let reader = ArrayIterator::new(batches.into_iter().map(Ok), field_of(columns));
    Ok(to_stream_pycapsule(py, Box::new(reader), requested_schema)?)
}

/// Converts rows to batches of columns. Returns `None` on cancellation.
///
/// # Errors
/// If a record is too long; names its column.
pub fn batches(
    columns: &[Column],
    rows: &Rows,
    symbols: &Symbols,
    cancel: &Cancel,
) -> Result<Option<Vec<ArrayRef>>, String> {
    let field = field_of(columns);
    let DataType::Struct(fields) = field.data_type() else {
        return Ok(Some(Vec::new()));
    };
    let mut batches: Vec<ArrayRef> = Vec::with_capacity(rows.len().div_ceil(BATCH));
    for first in (0..rows.len()).step_by(BATCH) {
        let end = rows.len().min(first + BATCH);
        if columns.is_empty() {
            batches.push(Arc::new(StructArray::new_empty_fields(end - first, None)));
            continue;
        }
        let mut arrays: Vec<ArrayRef> = Vec::with_capacity(columns.len());
        for (at, column) in columns.iter().enumerate() {
            if cancel.requested() {
                return Ok(None);
            }
            let words = rows.range(first..end).map(|row| row[at]);
            arrays.push(match column.base {
                BaseType::Number => Arc::new(Int32Array::from_iter_values(words.map(Value::as_number))),
                BaseType::Unsigned => Arc::new(UInt32Array::from_iter_values(words.map(|word| word.0))),
                BaseType::Float => Arc::new(Float32Array::from_iter_values(words.map(Value::as_float))),
                BaseType::Symbol => {
                    let text = |word: Value| symbols.resolve(Symbol(word.0)).unwrap_or_default();
                    Arc::new(LargeStringArray::from_iter_values(words.map(text)))
                }
                BaseType::Record => {
                    let texts = words.map(|word| whole_record(word, symbols));
                    let texts: Option<Vec<String>> = texts.collect();
                    let texts = texts
                        .ok_or_else(|| format!("a record in column `{}` has more than 16 MiB of text", column.name))?;
                    Arc::new(LargeStringArray::from_iter_values(texts))
                }
            });
        }
        batches.push(Arc::new(StructArray::new(fields.clone(), arrays, None)));
    }
    Ok(Some(batches))
}
