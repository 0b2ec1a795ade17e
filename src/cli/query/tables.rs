//! Predicates as Parquet tables.

use crate::datalog::codes;
use crate::datalog::internal::{record_of_text, shortened, whole_record};
use crate::datalog::{BaseType, Column, EvalError, PredicateId, Session, Value, facts};
use crate::diag::Diagnostic;
use crate::files::{Output, check_flat};
use crate::symbol::{Symbol, WordSize};
use parquet::basic::{Compression, LogicalType, Repetition, Type as Physical};
use parquet::data_type::{ByteArray, ByteArrayType, DoubleType, FloatType, Int32Type, Int64Type};
use parquet::errors::ParquetError;
use parquet::file::properties::WriterProperties;
use parquet::file::reader::{FileReader, SerializedFileReader};
use parquet::file::writer::SerializedFileWriter;
use parquet::record::Field;
use parquet::schema::types::Type;
use std::fs::File;
use std::io;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::sync::Arc;

/// The rows of a group in a file.
const GROUP: usize = 1 << 17;

/// The words between two insertions.
const PART: usize = 1 << 14;

/// Inserts the rows of a table into a predicate. Columns match by name if the table has exactly the names of the
/// predicate's columns, and otherwise by position.
pub fn load(session: &mut Session, id: PredicateId, file: File, path: &Path) -> Result<(), Diagnostic> {
    // The parquet crate may panic on damaged bytes.
    let loaded = catch_unwind(AssertUnwindSafe(|| load_rows(session, id, file)));
    let damaged = || Err(fault("the file is damaged"));
    loaded
        .unwrap_or_else(|_| damaged())
        .map_err(|fault| fault.note(format!("while reading `{}`", path.display())))
}

fn fault(message: impl Into<String>) -> Diagnostic {
    Diagnostic::new(codes::INVALID_FACT, message)
}

fn unreadable(error: &ParquetError) -> Diagnostic {
    let found = fault(format!("not a readable Parquet table: {error}"));
    match error.to_string().contains("feature") {
        true => found.help("write the table with the compression Snappy, or without any"),
        false => found,
    }
}

fn load_rows(session: &mut Session, id: PredicateId, file: File) -> Result<(), Diagnostic> {
    let program = session.program().clone();
    let predicate = &program.rules().predicates[id.index()];
    let (name, arity) = (&predicate.name, predicate.arity());
    check_flat(&file).map_err(|error| fault(format!("not a readable Parquet table: {error}")))?;
    let reader = SerializedFileReader::new(file).map_err(|error| unreadable(&error))?;
    let schema = reader.metadata().file_metadata().schema_descr();
    let found: Vec<&str> = schema
        .root_schema()
        .get_fields()
        .iter()
        .map(|field| field.name())
        .collect();
    let positions = predicate.positions_in(&found);
    let positions = positions.map_err(|message| fault(message).at(predicate.span, "declared here"))?;
    if arity == 0 {
        if reader.metadata().file_metadata().num_rows() > 0 {
            session.insert(id, ()).map_err(|error| fault(error.to_string()))?;
        }
        return Ok(());
    }
    let mut words: Vec<Value> = Vec::new();
    let rows = reader.get_row_iter(None).map_err(|error| unreadable(&error))?;
    let flush = |session: &mut Session, words: &mut Vec<Value>| {
        let inserted = session.insert_all(id, words.chunks_exact(arity));
        inserted.map_err(|error| fault(error.to_string()))?;
        words.clear();
        let limit = session.limits().bytes;
        match session.bytes() <= limit {
            true => Ok(()),
            false => Err(EvalError::TooManyInputs { limit }.diagnostic(program.rules())),
        }
    };
    for (number, row) in rows.enumerate() {
        let row = row.map_err(|error| unreadable(&error))?;
        let cells: Vec<&Field> = row.get_column_iter().map(|(_, field)| field).collect();
        for (column, &at) in predicate.columns.iter().zip(&positions) {
            let word = word(session, column, cells[at]).map_err(|found| {
                let holds = match column.base {
                    BaseType::Number => "numbers",
                    BaseType::Unsigned => "unsigned numbers",
                    BaseType::Float => "floats",
                    BaseType::Symbol => "symbols",
                    BaseType::Record => "records as strings",
                };
                let message = format!(
                    "row {number}: column `{}` of `{name}` holds {holds}, not {found}",
                    column.name
                );
                fault(message).at(predicate.span, "declared here")
            })?;
            words.push(word);
        }
        if words.len() >= PART {
            flush(session, &mut words)?;
        }
    }
    flush(session, &mut words)
}

/// Returns the word of a value, or a description of the value if it is not one of the column.
fn word(session: &mut Session, column: &Column, field: &Field) -> Result<Value, String> {
    let words = session.symbols().encoder();
    let float = |number: f64| {
        let near = words.float(number)?;
        let is_near = near.to_float(session.symbols()).is_finite() || !number.is_finite();
        is_near.then_some(near)
    };
    let number = |number: i128| match column.base {
        BaseType::Float => float(number as f64),
        base => words.whole(base, number),
    };
    let word = match field {
        Field::Byte(value) => number((*value).into()),
        Field::Short(value) => number((*value).into()),
        Field::Int(value) => number((*value).into()),
        Field::Long(value) => number((*value).into()),
        Field::UByte(value) => number((*value).into()),
        Field::UShort(value) => number((*value).into()),
        Field::UInt(value) => number((*value).into()),
        Field::ULong(value) => number((*value).into()),
        Field::Float16(value) if column.base == BaseType::Float => float((*value).into()),
        Field::Float(value) if column.base == BaseType::Float => float((*value).into()),
        Field::Double(value) if column.base == BaseType::Float => float(*value),
        Field::Str(text) if column.base == BaseType::Symbol => words.symbol(text).map(|Symbol(id)| Value(id)),
        Field::Str(text) if column.base == BaseType::Record => {
            let types = &session.program().rules().types;
            record_of_text(text, column.ty, types, &words).ok()
        }
        _ => None,
    };
    word.ok_or_else(|| match field {
        Field::Null => "null".to_owned(),
        Field::Str(text) => format!("{:?}", shortened(text)),
        field => shortened(&field.to_string()).into_owned(),
    })
}

/// Writes the rows of a predicate as a table, in the order of text.
pub fn write(session: &Session, id: PredicateId, output: &mut Output) -> io::Result<()> {
    let predicate = &session.program().rules().predicates[id.index()];
    if predicate.columns.is_empty() {
        let message = format!("`{}` has no columns, and a Parquet table needs one", predicate.name);
        return Err(io::Error::other(message));
    }
    let symbols = session.symbols();
    let long = symbols.word_size() == WordSize::Bits64;
    let columns = predicate.columns.iter().map(|column| {
        let (physical, logical) = match (column.base, long) {
            (BaseType::Number, false) => (Physical::INT32, None),
            (BaseType::Number, true) => (Physical::INT64, None),
            (BaseType::Unsigned, false) => (Physical::INT32, Some(LogicalType::integer(32, false))),
            (BaseType::Unsigned, true) => (Physical::INT64, Some(LogicalType::integer(64, false))),
            (BaseType::Float, false) => (Physical::FLOAT, None),
            (BaseType::Float, true) => (Physical::DOUBLE, None),
            (BaseType::Symbol | BaseType::Record, _) => (Physical::BYTE_ARRAY, Some(LogicalType::String)),
        };
        let column = Type::primitive_type_builder(&column.name, physical)
            .with_repetition(Repetition::REQUIRED)
            .with_logical_type(logical);
        column.build().map(Arc::new)
    });
    let columns = columns.collect::<Result<Vec<_>, _>>()?;
    let schema = Type::group_type_builder("rows").with_fields(columns).build()?;
    let settings = WriterProperties::builder()
        .set_compression(Compression::SNAPPY)
        .set_created_by(concat!("logicity ", env!("CARGO_PKG_VERSION")).to_owned());
    let mut file = SerializedFileWriter::new(output, Arc::new(schema), Arc::new(settings.build()))?;
    for rows in facts::sorted(session, id).chunks(GROUP) {
        let mut group = file.next_row_group()?;
        for (at, column) in predicate.columns.iter().enumerate() {
            let mut writer = group.next_column()?.expect("as many as in the schema");
            let words = rows.iter().map(|row| row[at]);
            match column.base {
                BaseType::Number | BaseType::Unsigned if long => {
                    let values: Vec<i64> = words.map(|word| word.to_number(symbols)).collect();
                    writer.typed::<Int64Type>().write_batch(&values, None, None)?
                }
                BaseType::Float if long => {
                    let values: Vec<f64> = words.map(|word| word.to_float(symbols)).collect();
                    writer.typed::<DoubleType>().write_batch(&values, None, None)?
                }
                BaseType::Number | BaseType::Unsigned => {
                    let values: Vec<i32> = words.map(Value::as_number).collect();
                    writer.typed::<Int32Type>().write_batch(&values, None, None)?
                }
                BaseType::Float => {
                    let values: Vec<f32> = words.map(Value::as_float).collect();
                    writer.typed::<FloatType>().write_batch(&values, None, None)?
                }
                BaseType::Symbol => {
                    let text = |word: Value| session.symbols().resolve(Symbol(word.0)).unwrap_or_default();
                    let values: Vec<ByteArray> = words.map(|word| text(word).into()).collect();
                    writer.typed::<ByteArrayType>().write_batch(&values, None, None)?
                }
                BaseType::Record => {
                    let texts = words.map(|word| whole_record(word, session.symbols()));
                    let values: Option<Vec<ByteArray>> = texts.map(|text| Some(text?.as_str().into())).collect();
                    let message = || format!("a record in `{}` has more than 16 MiB of text", predicate.name);
                    let values = values.ok_or_else(|| io::Error::other(message()))?;
                    writer.typed::<ByteArrayType>().write_batch(&values, None, None)?
                }
            };
            writer.close()?;
        }
        group.close()?;
    }
    file.close()?;
    Ok(())
}
