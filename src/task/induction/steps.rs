//! Reads the steps of episodes from a Parquet table, as `Demonstrations.to_parquet` of the Python package writes it.

use crate::city::Action;
use crate::diag::Diagnostic;
use crate::task::vap::codes;
use bytes::Bytes;
use parquet::column::reader::{ColumnReader, ColumnReaderImpl};
use parquet::data_type::{DataType, FloatType, Int32Type};
use parquet::errors::ParquetError;
use parquet::file::reader::{FileReader, SerializedFileReader};
use std::panic::{AssertUnwindSafe, catch_unwind};

/// The maximum number of steps, and about the most numbers, that are read together.
const BATCH: usize = 4_096;
const NUMBERS: usize = 1 << 22;

/// A table of steps.
pub struct Steps {
    file: SerializedFileReader<Bytes>,
    /// The mode, or the path of the configuration file.
    pub mode: String,
    /// The split of the episodes.
    pub split: String,
    /// SHA-256 of the set of episodes.
    pub episodes_hash: String,
    /// The atom of each number of an observation, such as `IsCar(0)`.
    pub atoms: Vec<String>,
    /// The action of each number in the column `action`.
    actions: Vec<Action>,
}

/// A step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step<'a> {
    /// The number of the episode.
    pub episode: i32,
    /// The number of the step in its episode.
    pub step: i32,
    /// A number for each atom: above 0.5 if it holds.
    pub observation: &'a [f32],
    /// The action.
    pub action: Action,
}

impl Steps {
    /// Opens a table.
    ///
    /// # Errors
    /// `invalid-data-set` if the bytes are no Parquet file or the metadata of a table of steps is missing.
    pub fn open(bytes: Vec<u8>) -> Result<Steps, Diagnostic> {
        let file = guarded(|| SerializedFileReader::new(Bytes::from(bytes)))?;
        let metadata = file.metadata().file_metadata().key_value_metadata();
        let value = |key: &str| {
            let found = metadata.and_then(|pairs| pairs.iter().find(|pair| pair.key == key));
            found
                .and_then(|pair| pair.value.clone())
                .ok_or_else(|| faulty(format!("there is no metadata `{key}`")))
        };
        let (mode, split, episodes_hash) = (value("mode")?, value("split")?, value("episodes_hash")?);
        let known = |name: &str| Action::STANDARD.into_iter().find(|action| action.name() == name);
        let actions: Option<Vec<Action>> = value("actions")?.split(',').map(known).collect();
        let atoms: Vec<String> = value("atoms")?
            .split(';')
            .filter(|atom| !atom.is_empty())
            .map(str::to_owned)
            .collect();
        if atoms.is_empty() {
            return Err(faulty("its observations are not of the kind `groundings`"));
        }
        Ok(Steps {
            file,
            mode,
            split,
            episodes_hash,
            atoms,
            actions: actions.ok_or_else(|| faulty("it has unknown actions"))?,
        })
    }

    /// Returns the number of steps.
    pub fn count(&self) -> usize {
        let groups = self.file.metadata().row_groups().iter();
        let rows = groups.map(|group| usize::try_from(group.num_rows()).unwrap_or(0));
        rows.fold(0, usize::saturating_add)
    }

    /// Returns the memory of all steps, in bytes, if a caller keeps them as numbers. A compressed table may be far
    /// smaller.
    pub fn bytes(&self) -> u64 {
        let numbers = self.atoms.len() * size_of::<f32>() + 2 * size_of::<i32>() + size_of::<i64>();
        (self.count() as u64).saturating_mul(numbers as u64)
    }

    /// Calls a function for each step, in order.
    ///
    /// # Errors
    /// `invalid-data-set` if a column is missing or damaged; the errors of the function.
    pub fn for_each<E: From<Diagnostic>>(&self, mut act: impl FnMut(Step<'_>) -> Result<(), E>) -> Result<(), E> {
        let width = self.atoms.len();
        for group in 0..self.file.num_row_groups() {
            let group = guarded(|| self.file.get_row_group(group))?;
            let schema = group.metadata().schema_descr();
            let column = |name: &str| -> Result<ColumnReader, Diagnostic> {
                let is_named = |column: &parquet::schema::types::ColumnDescPtr| column.path().parts()[0] == name;
                let position = schema.columns().iter().position(is_named);
                let position = position.ok_or_else(|| faulty(format!("there is no column `{name}`")))?;
                guarded(|| group.get_column_reader(position))
            };
            let integers = |name: &str| match column(name)? {
                ColumnReader::Int32ColumnReader(reader) => Ok(reader),
                _ => Err(faulty(format!("the column `{name}` does not hold 32-bit integers"))),
            };
            let (mut episodes, mut numbers, mut taken) = (integers("episode")?, integers("step")?, integers("action")?);
            let ColumnReader::FloatColumnReader(mut seen) = column("observation")? else {
                return Err(faulty("the column `observation` does not hold 32-bit floats").into());
            };
            let rows = usize::try_from(group.metadata().num_rows()).unwrap_or(0);
            // A single list could hold all numbers.
            let values = group
                .metadata()
                .columns()
                .iter()
                .map(|column| column.num_values().unsigned_abs());
            if values.max().unwrap_or(0) > (rows as u64).saturating_mul(width as u64) {
                return Err(faulty("values are missing").into());
            }
            let batch = (NUMBERS / width).clamp(1, BATCH);
            for begin in (0..rows).step_by(batch) {
                let count = batch.min(rows - begin);
                let next = |reader: &mut ColumnReaderImpl<Int32Type>| records(reader, count, 1);
                let (episodes, numbers, taken) = (next(&mut episodes)?, next(&mut numbers)?, next(&mut taken)?);
                let seen = records::<FloatType>(&mut seen, count, width)?;
                for (row, observation) in seen.chunks_exact(width).enumerate() {
                    let action = usize::try_from(taken[row])
                        .ok()
                        .and_then(|action| self.actions.get(action));
                    act(Step {
                        episode: episodes[row],
                        step: numbers[row],
                        observation,
                        action: *action.ok_or_else(|| faulty(format!("{} is not an action", taken[row])))?,
                    })?;
                }
            }
        }
        Ok(())
    }
}

/// Reads the next `count` rows of a column, each with `width` values.
fn records<T: DataType>(reader: &mut ColumnReaderImpl<T>, count: usize, width: usize) -> Result<Vec<T::T>, Diagnostic> {
    let (mut values, mut defined, mut repeated) = (Vec::new(), Vec::new(), Vec::new());
    let (rows, ..) = guarded(|| reader.read_records(count, Some(&mut defined), Some(&mut repeated), &mut values))?;
    // A list begins with the repetition level 0. A column without lists has no levels.
    let has_width = repeated
        .iter()
        .enumerate()
        .all(|(at, level)| (*level == 0) == (at % width == 0));
    if rows != count || values.len() != count * width || !has_width {
        return Err(faulty("values are missing"));
    }
    Ok(values)
}

/// Calls the Parquet crate, which may panic on damaged bytes.
fn guarded<T>(read: impl FnOnce() -> Result<T, ParquetError>) -> Result<T, Diagnostic> {
    let damaged = || Err(ParquetError::General("damaged".to_owned()));
    catch_unwind(AssertUnwindSafe(read))
        .unwrap_or_else(|_| damaged())
        .map_err(|error| faulty(error.to_string()))
}

fn faulty(message: impl std::fmt::Display) -> Diagnostic {
    Diagnostic::new(codes::INVALID_DATA_SET, format!("not a table of steps: {message}"))
        .help("`Demonstrations.to_parquet` of the Python package writes such tables")
}

#[cfg(test)]
mod tests {
    use super::*;
    use parquet::basic::Compression;
    use parquet::file::metadata::KeyValue;
    use parquet::file::properties::WriterProperties;
    use parquet::file::writer::SerializedFileWriter;
    use parquet::schema::parser::parse_message_type;
    use std::sync::Arc;

    const ATOMS: [&str; 3] = ["A(0)", "B(0)", "B(1)"];

    /// The steps of a table.
    type Rows = Vec<(i32, i32, Vec<f32>, i32)>;

    fn rows(count: i32) -> Rows {
        let row = |at: i32| {
            let observation = (0..3).map(|bit| (at >> bit & 1) as f32).collect();
            (at / 7, at % 7, observation, at % 4)
        };
        (0..count).map(row).collect()
    }

    /// Writes a table with groups of 5,000 rows and, as an option, without an observation in its last row.
    fn table(rows: &Rows, keys: &[(&str, &str)], is_cut: bool) -> Vec<u8> {
        let schema = "message schema { optional int32 episode; optional int32 step; optional group observation (LIST) { \
                      repeated group list { optional float element; } } optional int32 action (INT_8); }";
        let pair = |(key, value): &(&str, &str)| KeyValue::new((*key).to_owned(), (*value).to_owned());
        let settings = WriterProperties::builder()
            .set_compression(Compression::SNAPPY)
            .set_key_value_metadata(Some(keys.iter().map(pair).collect()));
        let mut bytes = Vec::new();
        let schema = Arc::new(parse_message_type(schema).unwrap());
        let mut file = SerializedFileWriter::new(&mut bytes, schema, Arc::new(settings.build())).unwrap();
        for rows in rows.chunks(5_000) {
            let mut group = file.next_row_group().unwrap();
            let integers = |group: &mut parquet::file::writer::SerializedRowGroupWriter<'_, _>, values: Vec<i32>| {
                let mut column = group.next_column().unwrap().unwrap();
                let there = vec![1; values.len()];
                column
                    .typed::<Int32Type>()
                    .write_batch(&values, Some(&there), None)
                    .unwrap();
                column.close().unwrap();
            };
            integers(&mut group, rows.iter().map(|row| row.0).collect());
            integers(&mut group, rows.iter().map(|row| row.1).collect());
            let (mut values, mut defined, mut repeated) = (Vec::new(), Vec::new(), Vec::new());
            for (at, row) in rows.iter().enumerate() {
                if is_cut && at + 1 == rows.len() {
                    defined.push(0);
                    repeated.push(0);
                    continue;
                }
                values.extend(&row.2);
                defined.extend([3; 3]);
                repeated.extend([0, 1, 1]);
            }
            let mut column = group.next_column().unwrap().unwrap();
            column
                .typed::<FloatType>()
                .write_batch(&values, Some(&defined), Some(&repeated))
                .unwrap();
            column.close().unwrap();
            integers(&mut group, rows.iter().map(|row| row.3).collect());
            group.close().unwrap();
        }
        file.close().unwrap();
        bytes
    }

    const KEYS: [(&str, &str); 5] = [
        ("mode", "easy"),
        ("split", "train"),
        ("episodes_hash", "0"),
        ("actions", "Slow,Normal,Fast,Stop"),
        ("atoms", "A(0);B(0);B(1)"),
    ];

    fn read(bytes: Vec<u8>) -> Result<Rows, Diagnostic> {
        let steps = Steps::open(bytes)?;
        let mut rows = Vec::new();
        steps.for_each(|step: Step<'_>| {
            rows.push((
                step.episode,
                step.step,
                step.observation.to_vec(),
                step.action.index() as i32,
            ));
            Ok::<_, Diagnostic>(())
        })?;
        assert_eq!(rows.len(), steps.count());
        Ok(rows)
    }

    #[test]
    fn steps_are_read_in_order() {
        let rows = rows(12_345);
        let bytes = table(&rows, &KEYS, false);
        assert_eq!(Steps::open(bytes.clone()).unwrap().atoms, ATOMS);
        assert_eq!(read(bytes).unwrap(), rows);
    }

    #[test]
    fn faulty_tables_are_refused() {
        let rows = rows(50);
        let refused = |bytes: Vec<u8>, words: &str| {
            let fault = read(bytes).unwrap_err();
            assert!(fault.message.contains(words), "{}", fault.message);
        };
        refused(b"PAR1".to_vec(), "not a table of steps");
        refused(table(&rows, &KEYS, true), "values are missing");
        for (left_out, (name, _)) in KEYS.iter().enumerate() {
            let keys: Vec<_> = KEYS
                .iter()
                .enumerate()
                .filter(|(at, _)| *at != left_out)
                .map(|(_, pair)| *pair)
                .collect();
            refused(table(&rows, &keys, false), &format!("no metadata `{name}`"));
        }
        let with =
            |key: &str, value: &'static str| KEYS.map(|(known, old)| (known, if known == key { value } else { old }));
        refused(table(&rows, &with("atoms", ""), false), "`groundings`");
        refused(table(&rows, &with("atoms", "A(0)"), false), "values are missing");
        refused(table(&rows, &with("actions", "Slow,Jump"), false), "unknown actions");
        refused(table(&rows, &with("actions", "Slow,Stop"), false), "2 is not an action");
    }

    #[test]
    fn damaged_tables_are_refused_without_a_panic() {
        let whole = table(&rows(50), &KEYS, false);
        for length in (0..whole.len()).step_by(7) {
            assert!(Steps::open(whole[..length].to_vec()).is_err(), "{length}");
        }
        let everything = |bytes: Vec<u8>| Steps::open(bytes)?.for_each(|_| Ok::<_, Diagnostic>(()));
        for at in 0..whole.len() {
            let mut changed = whole.clone();
            changed[at] ^= 0xff;
            // Some bytes are values, which any number may replace.
            let _ = everything(changed);
        }
    }
}
