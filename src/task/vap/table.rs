//! Stores frames as columns in Parquet: a table of entities with unary predicates, and a table of ordered pairs with
//! binary predicates.

use crate::city::Heading;
use crate::city::{Action, AgentKind};
use crate::diag::Diagnostic;
use crate::files::check_flat;
use crate::render::PixelBox;
use crate::sim::{Facts, Vocabulary};
use crate::task::vap::{Frame, FrameAgent, SIDE, Worlds, faulty};
use bytes::Bytes;
use parquet::basic::{Compression, Repetition};
use parquet::column::reader::ColumnReader;
use parquet::data_type::{BoolType, ByteArray, ByteArrayType, FloatType, Int32Type};
use parquet::errors::ParquetError;
use parquet::file::properties::WriterProperties;
use parquet::file::reader::{FileReader, SerializedFileReader};
use parquet::file::writer::SerializedFileWriter;
use parquet::schema::parser::parse_message_type;
use std::collections::BTreeMap;
use std::io::{Cursor, Write};
use std::ops::Range;
use std::panic::catch_unwind;
use std::sync::Arc;

/// A table of columns of equal length.
#[derive(Clone, Debug, PartialEq)]
pub struct Table {
    /// The columns with their names.
    pub columns: Vec<(String, Values)>,
}

/// The values of a column.
#[derive(Clone, Debug, PartialEq)]
pub enum Values {
    /// Required integers.
    Int(Vec<i32>),
    /// Optional integers.
    MaybeInt(Vec<Option<i32>>),
    /// Optional 32-bit floats.
    MaybeFloat(Vec<Option<f32>>),
    /// Strings.
    Text(Vec<String>),
    /// Booleans.
    Bool(Vec<bool>),
}

impl Values {
    fn len(&self) -> usize {
        match self {
            Values::Int(values) => values.len(),
            Values::MaybeInt(values) => values.len(),
            Values::MaybeFloat(values) => values.len(),
            Values::Text(values) => values.len(),
            Values::Bool(values) => values.len(),
        }
    }

    /// Returns the Parquet schema of a column with these values.
    fn schema(&self, name: &str) -> String {
        match self {
            Values::Int(_) => format!("required int32 {name};"),
            Values::MaybeInt(_) => format!("optional int32 {name};"),
            Values::MaybeFloat(_) => format!("optional float {name};"),
            Values::Text(_) => format!("required binary {name} (UTF8);"),
            Values::Bool(_) => format!("required boolean {name};"),
        }
    }
}

/// An integer column of the table of entities: its name, its description, and its value for an agent.
type EntityColumn = (
    &'static str,
    &'static str,
    fn(&FrameAgent, Option<PixelBox>) -> Option<i32>,
);

/// The columns that identify a row of the table of entities, with their descriptions.
pub const ENTITY_NAMES: [(&str, &str); 6] = [
    ("world", "number of the world"),
    ("tick", "11 to 99; world and tick identify the sample"),
    ("agent", "position in the list of agents, from 0"),
    ("name", "for example `Car_1`"),
    ("type", "`Car` or `Pedestrian`"),
    ("concepts", "joined by `+`; empty if there are none"),
];

/// The next columns.
pub const ENTITY_NUMBERS: [EntityColumn; 11] = [
    ("priority", "priority; a smaller number goes first", |agent, _| {
        Some(agent.priority)
    }),
    ("row", "row of its cell, from 0 at the top", |agent, _| {
        Some(agent.at.row)
    }),
    ("col", "column of its cell, from 0 at the left", |agent, _| {
        Some(agent.at.col)
    }),
    (
        "heading",
        "direction of its last move: 0 left, 1 right, 2 up, 3 down; null before the first",
        |agent, _| {
            let heading = agent.heading?;
            Some(match heading {
                Heading::Left => 0,
                Heading::Right => 1,
                Heading::Up => 2,
                Heading::Down => 3,
            })
        },
    ),
    (
        "facing",
        "direction of its icon, in eighths of a turn clockwise from up",
        |agent, _| Some(agent.facing as i32),
    ),
    (
        "instance",
        "instance of its class in the picture, from 0; within a split, the same number shows the same icon",
        |agent, _| Some(agent.instance.cast_signed()),
    ),
    (
        "x",
        "left edge of its box in the picture, in pixels; the box contains its icon and may be larger; the whole box is \
         null outside the picture",
        |_, pixels| pixels.map(|pixels| pixels.x),
    ),
    ("y", "upper edge of the box, in pixels", |_, pixels| {
        pixels.map(|pixels| pixels.y)
    }),
    ("width", "width of the box, in pixels", |_, pixels| {
        pixels.map(|pixels| pixels.width.cast_signed())
    }),
    ("height", "height of the box, in pixels", |_, pixels| {
        pixels.map(|pixels| pixels.height.cast_signed())
    }),
    (
        "label",
        "action that the rules choose for a car: 0 slow, 1 normal, 2 fast, 3 stop; null for pedestrians",
        |agent, _| (agent.name.kind == AgentKind::Car).then_some(agent.action.index() as i32),
    ),
];

/// The last column before the unary predicates.
pub const VISIBLE: (&str, &str) = (
    "visible",
    "fraction of its icon inside the picture that nothing drawn later covers, 0 to 1, without shadows; cars are drawn \
     before pedestrians, both in order of `agent`, and then the things that hide agents; null outside the picture",
);

/// The columns that identify a row of the table of pairs, with their descriptions. The binary predicates follow them.
pub const PAIR_NAMES: [(&str, &str); 4] = [
    ("world", "number of the world"),
    ("tick", "11 to 99"),
    (
        "first",
        "position of the first agent; each agent also forms a pair with itself",
    ),
    ("second", "position of the second agent"),
];

fn int(value: impl TryInto<i32>) -> i32 {
    value.try_into().ok().expect("fewer than 2^31")
}

impl Table {
    /// Creates the table of entities of a world.
    pub fn entities(worlds: &Worlds, world: u32, frames: &[Frame]) -> Table {
        let rows = frames.iter().flat_map(|frame| {
            let agents = frame.agents.iter().zip(worlds.boxes(frame)).enumerate();
            agents.map(|(place, (agent, pixels))| (frame.tick, place, agent, pixels))
        });
        let all: Vec<(u64, usize, &FrameAgent, Option<PixelBox>)> = rows.collect();
        let agents = || all.iter().map(|(_, _, agent, _)| *agent);
        let names = [
            Values::Int(all.iter().map(|_| int(world)).collect()),
            Values::Int(all.iter().map(|(tick, ..)| int(*tick)).collect()),
            Values::Int(all.iter().map(|(_, place, ..)| int(*place)).collect()),
            Values::Text(agents().map(|agent| agent.name.to_string()).collect()),
            Values::Text(agents().map(|agent| agent.name.kind.name().to_owned()).collect()),
            Values::Text(agents().map(|agent| agent.concepts.join("+")).collect()),
        ];
        let names = ENTITY_NAMES
            .iter()
            .zip(names)
            .map(|((name, _), values)| ((*name).to_owned(), values));
        let numbers = ENTITY_NUMBERS.iter().map(|(name, _, value)| {
            let values = all.iter().map(|(_, _, agent, pixels)| value(agent, *pixels));
            ((*name).to_owned(), Values::MaybeInt(values.collect()))
        });
        let visible = frames.iter().flat_map(|frame| worlds.visible(frame)).collect();
        let mut columns: Vec<(String, Values)> = names.chain(numbers).collect();
        columns.push((VISIBLE.0.to_owned(), Values::MaybeFloat(visible)));
        columns.extend(truths(&worlds.world().vocabulary, frames, 1));
        Table { columns }
    }

    /// Creates the table of all ordered pairs of entities in each frame of a world.
    pub fn pairs(worlds: &Worlds, world: u32, frames: &[Frame]) -> Table {
        let mut names: [Vec<i32>; 4] = Default::default();
        for frame in frames {
            let count = frame.agents.len();
            for (first, second) in (0..count).flat_map(|first| (0..count).map(move |second| (first, second))) {
                let row = [int(world), int(frame.tick), int(first), int(second)];
                names.iter_mut().zip(row).for_each(|(column, value)| column.push(value));
            }
        }
        let names = PAIR_NAMES
            .iter()
            .zip(names)
            .map(|((name, _), values)| ((*name).to_owned(), Values::Int(values)));
        Table {
            columns: names.chain(truths(&worlds.world().vocabulary, frames, 2)).collect(),
        }
    }

    /// Returns the number of rows.
    pub fn rows(&self) -> usize {
        self.columns.first().map_or(0, |(_, values)| values.len())
    }

    /// Writes the table as a Parquet file with one row group and Snappy compression. Equal tables give equal bytes.
    ///
    /// # Errors
    /// The errors of `out`.
    pub fn write(&self, out: impl Write + Send) -> parquet::errors::Result<()> {
        let columns: Vec<String> = self.columns.iter().map(|(name, values)| values.schema(name)).collect();
        let schema = parse_message_type(&format!("message table {{ {} }}", columns.join(" ")))?;
        let settings = WriterProperties::builder()
            .set_compression(Compression::SNAPPY)
            .set_created_by(concat!("logicity ", env!("CARGO_PKG_VERSION")).to_owned());
        let mut file = SerializedFileWriter::new(out, Arc::new(schema), Arc::new(settings.build()))?;
        let mut group = file.next_row_group()?;
        for (_, values) in &self.columns {
            let mut column = group.next_column()?.expect("as many as in the schema");
            match values {
                Values::Int(values) => column.typed::<Int32Type>().write_batch(values, None, None)?,
                Values::MaybeInt(values) => {
                    let there: Vec<i16> = values.iter().map(|value| value.is_some().into()).collect();
                    let values: Vec<i32> = values.iter().flatten().copied().collect();
                    column.typed::<Int32Type>().write_batch(&values, Some(&there), None)?
                }
                Values::MaybeFloat(values) => {
                    let there: Vec<i16> = values.iter().map(|value| value.is_some().into()).collect();
                    let values: Vec<f32> = values.iter().flatten().copied().collect();
                    column.typed::<FloatType>().write_batch(&values, Some(&there), None)?
                }
                Values::Text(values) => {
                    let values: Vec<ByteArray> = values.iter().map(|text| text.as_str().into()).collect();
                    column.typed::<ByteArrayType>().write_batch(&values, None, None)?
                }
                Values::Bool(values) => column.typed::<BoolType>().write_batch(values, None, None)?,
            };
            column.close()?;
        }
        group.close()?;
        file.close()?;
        Ok(())
    }

    /// Reads a file that [`Table::write`] wrote.
    ///
    /// # Errors
    /// `invalid-data-set` for other bytes.
    pub fn read(bytes: Vec<u8>) -> Result<Table, Diagnostic> {
        check_flat(Cursor::new(&bytes)).map_err(|error| faulty(format!("not a table of frames: {error}")))?;
        // The parquet crate may panic on damaged bytes.
        let read = catch_unwind(|| read(bytes.into())).unwrap_or_else(|_| Err(fault("damaged")));
        read.map_err(|error| faulty(format!("not a table of frames: {error}")))
    }

    fn column(&self, name: &str) -> Result<&Values, Diagnostic> {
        let found = self.columns.iter().find(|(known, _)| known == name);
        Ok(&found.ok_or_else(|| faulty(format!("there is no column `{name}`")))?.1)
    }

    /// Returns a column of required integers.
    ///
    /// # Errors
    /// `invalid-data-set` if there is no such column.
    pub fn ints(&self, name: &str) -> Result<&[i32], Diagnostic> {
        match self.column(name)? {
            Values::Int(values) => Ok(values),
            _ => Err(faulty(format!("the column `{name}` does not hold integers"))),
        }
    }

    /// Returns a column of optional integers.
    ///
    /// # Errors
    /// `invalid-data-set` if there is no such column.
    pub fn maybe_ints(&self, name: &str) -> Result<&[Option<i32>], Diagnostic> {
        match self.column(name)? {
            Values::MaybeInt(values) => Ok(values),
            _ => Err(faulty(format!("the column `{name}` does not hold optional integers"))),
        }
    }

    /// Returns a column of optional 32-bit floats.
    ///
    /// # Errors
    /// `invalid-data-set` if there is no such column.
    pub fn maybe_floats(&self, name: &str) -> Result<&[Option<f32>], Diagnostic> {
        match self.column(name)? {
            Values::MaybeFloat(values) => Ok(values),
            _ => Err(faulty(format!("the column `{name}` does not hold optional floats"))),
        }
    }

    /// Returns a column of strings.
    ///
    /// # Errors
    /// `invalid-data-set` if there is no such column.
    pub fn texts(&self, name: &str) -> Result<&[String], Diagnostic> {
        match self.column(name)? {
            Values::Text(values) => Ok(values),
            _ => Err(faulty(format!("the column `{name}` does not hold strings"))),
        }
    }

    /// Returns a column of booleans.
    ///
    /// # Errors
    /// `invalid-data-set` if there is no such column.
    pub fn bools(&self, name: &str) -> Result<&[bool], Diagnostic> {
        match self.column(name)? {
            Values::Bool(values) => Ok(values),
            _ => Err(faulty(format!("the column `{name}` does not hold booleans"))),
        }
    }
}

/// Counts the rows of the table of entities by concept. Entities without a concept count by type.
///
/// # Errors
/// `invalid-data-set` if a column is missing.
pub fn count_concepts(entities: &Table) -> Result<BTreeMap<String, u64>, Diagnostic> {
    let mut counts = BTreeMap::new();
    for (concepts, kind) in entities.texts("concepts")?.iter().zip(entities.texts("type")?) {
        let carried = if concepts.is_empty() { kind } else { concepts };
        for concept in carried.split('+') {
            *counts.entry(concept.to_owned()).or_default() += 1;
        }
    }
    Ok(counts)
}

/// Returns the box of each row of the table of entities.
///
/// # Errors
/// `invalid-data-set` if a column is missing, or a box does not lie in the picture.
pub fn boxes(entities: &Table) -> Result<Vec<Option<PixelBox>>, Diagnostic> {
    let [xs, ys] = [entities.maybe_ints("x")?, entities.maybe_ints("y")?];
    let [widths, heights] = [entities.maybe_ints("width")?, entities.maybe_ints("height")?];
    let pixels = |row: usize| match (xs[row], ys[row], widths[row], heights[row]) {
        (None, None, None, None) => Some(None),
        (Some(x), Some(y), Some(width), Some(height)) => {
            let (width, height) = (u32::try_from(width).ok()?, u32::try_from(height).ok()?);
            let pixels = PixelBox { x, y, width, height };
            (pixels.clipped(SIDE, SIDE) == Some(pixels)).then_some(Some(pixels))
        }
        _ => None,
    };
    let all = (0..entities.rows()).map(|row| {
        pixels(row).ok_or_else(|| {
            faulty(format!(
                "the box of row {row} of the entities does not lie in the picture"
            ))
        })
    });
    all.collect()
}

/// Returns the visible fraction of each row of the table of entities.
///
/// # Errors
/// As [`boxes`]; `invalid-data-set` unless exactly the agents with a box have a fraction, from 0 to 1.
pub fn visible(entities: &Table) -> Result<Vec<Option<f32>>, Diagnostic> {
    let fractions = entities.maybe_floats(VISIBLE.0)?;
    for (row, (pixels, fraction)) in boxes(entities)?.iter().zip(fractions).enumerate() {
        let in_range = fraction.is_none_or(|fraction| (0.0..=1.0).contains(&fraction));
        if !in_range || pixels.is_some() != fraction.is_some() {
            return Err(faulty(format!(
                "row {row} of the entities has a wrong visible fraction"
            )));
        }
    }
    Ok(fractions.to_vec())
}

/// Returns, for each predicate of this arity, whether it holds in each row.
fn truths(vocabulary: &Vocabulary, frames: &[Frame], arity: usize) -> Vec<(String, Values)> {
    let predicates = vocabulary
        .predicates
        .iter()
        .enumerate()
        .filter(|(_, predicate)| predicate.arity == arity);
    let column = |(index, predicate): (usize, &crate::sim::BasePredicate)| {
        let mut holds = Vec::new();
        for frame in frames {
            let (begin, count) = (holds.len(), frame.agents.len());
            holds.resize(begin + if arity == 1 { count } else { count * count }, false);
            for [x, y] in frame.facts.rows[index]
                .iter()
                .map(|row| row.map(|agent| agent as usize))
            {
                holds[begin + if arity == 1 { x } else { x * count + y }] = true;
            }
        }
        (predicate.name.clone(), Values::Bool(holds))
    };
    predicates.map(column).collect()
}

fn fault(message: &str) -> ParquetError {
    ParquetError::General(message.to_owned())
}

/// Returns a value or `None` for each flag.
fn with_gaps<T>(there: Vec<i16>, values: Vec<T>) -> Vec<Option<T>> {
    let mut values = values.into_iter();
    let next = |there: i16| if there == 0 { None } else { values.next() };
    there.into_iter().map(next).collect()
}

fn read(bytes: Bytes) -> Result<Table, ParquetError> {
    let file = SerializedFileReader::new(bytes)?;
    if file.num_row_groups() != 1 {
        return Err(fault("not one group of rows"));
    }
    let group = file.get_row_group(0)?;
    let rows = usize::try_from(group.metadata().num_rows()).map_err(|_| fault("fewer than no rows"))?;
    let mut columns = Vec::new();
    for (index, column) in group.metadata().schema_descr().columns().iter().enumerate() {
        let optional = column.self_type().get_basic_info().repetition() == Repetition::OPTIONAL;
        let values = match (group.get_column_reader(index)?, optional) {
            (ColumnReader::Int32ColumnReader(mut reader), true) => {
                let (mut values, mut there) = (Vec::new(), Vec::new());
                reader.read_records(rows, Some(&mut there), None, &mut values)?;
                Values::MaybeInt(with_gaps(there, values))
            }
            (ColumnReader::FloatColumnReader(mut reader), true) => {
                let (mut values, mut there) = (Vec::new(), Vec::new());
                reader.read_records(rows, Some(&mut there), None, &mut values)?;
                Values::MaybeFloat(with_gaps(there, values))
            }
            (ColumnReader::Int32ColumnReader(mut reader), false) => {
                let mut values = Vec::new();
                reader.read_records(rows, None, None, &mut values)?;
                Values::Int(values)
            }
            (ColumnReader::ByteArrayColumnReader(mut reader), false) => {
                let mut values = Vec::new();
                reader.read_records(rows, None, None, &mut values)?;
                let text = |value: &ByteArray| value.as_utf8().map(str::to_owned);
                Values::Text(values.iter().map(text).collect::<Result<_, _>>()?)
            }
            (ColumnReader::BoolColumnReader(mut reader), false) => {
                let mut values = Vec::new();
                reader.read_records(rows, None, None, &mut values)?;
                Values::Bool(values)
            }
            _ => return Err(fault("a column of another type")),
        };
        if values.len() != rows {
            return Err(fault("columns of different lengths"));
        }
        columns.push((column.name().to_owned(), values));
    }
    Ok(Table { columns })
}

/// The content of the tables for one frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Sample {
    /// The tick.
    pub tick: i32,
    /// The names of the agents.
    pub names: Vec<String>,
    /// The label of each agent: the action that the rules choose; `None` for pedestrians.
    pub labels: Vec<Option<Action>>,
    /// The facts.
    pub facts: Facts,
}

/// The rows of a sample in the two tables of its world.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SampleRows {
    /// The tick.
    pub tick: i32,
    /// The rows of its entities.
    pub entities: Range<usize>,
    /// The rows of its pairs.
    pub pairs: Range<usize>,
}

/// Returns the rows of each sample of a world in its two tables.
///
/// # Errors
/// `invalid-data-set` if a column is missing, the rows of a sample are incomplete or out of order, a car has no label,
/// or another agent has one.
pub fn sample_rows(world: u32, entities: &Table, pairs: &Table) -> Result<Vec<SampleRows>, Diagnostic> {
    let (worlds, ticks, places) = (entities.ints("world")?, entities.ints("tick")?, entities.ints("agent")?);
    let [of_worlds, of_ticks] = [pairs.ints("world")?, pairs.ints("tick")?];
    let [firsts, seconds] = [pairs.ints("first")?, pairs.ints("second")?];
    let (kinds, labels) = (entities.texts("type")?, entities.maybe_ints("label")?);
    for ((kind, label), name) in kinds.iter().zip(labels).zip(entities.texts("name")?) {
        if (kind == AgentKind::Car.name()) != label.is_some() {
            return Err(faulty(format!("cars, and only cars, have labels: {name} is a {kind}")));
        }
    }
    let world = int(world);
    let mut samples = Vec::new();
    let (mut row, mut pair) = (0, 0);
    while row < entities.rows() {
        let tick = ticks[row];
        let count = ticks[row..].iter().take_while(|other| **other == tick).count();
        let (own, of_two) = (row..row + count, pair..pair + count * count);
        let listed = own.clone().all(|at| worlds[at] == world && places[at] == int(at - row));
        let paired = of_two.end <= pairs.rows()
            && of_two.clone().all(|at| {
                let (first, second) = ((at - pair) / count, (at - pair) % count);
                [of_worlds[at], of_ticks[at], firsts[at], seconds[at]] == [world, tick, int(first), int(second)]
            });
        if !listed || !paired {
            return Err(faulty(format!(
                "the rows of tick {tick} do not form one sample in order"
            )));
        }
        (row, pair) = (own.end, of_two.end);
        samples.push(SampleRows {
            tick,
            entities: own,
            pairs: of_two,
        });
    }
    match pair == pairs.rows() {
        true => Ok(samples),
        false => Err(faulty("the table of pairs has more rows than the entities allow")),
    }
}

/// Reads the samples of a world from its two tables.
///
/// # Errors
/// As [`sample_rows`]; `invalid-data-set` for a number that is not a label.
pub fn samples(
    vocabulary: &Vocabulary,
    world: u32,
    entities: &Table,
    pairs: &Table,
) -> Result<Vec<Sample>, Diagnostic> {
    let (names, labels) = (entities.texts("name")?, entities.maybe_ints("label")?);
    let label = |label: &Option<i32>| match label {
        None => Ok(None),
        Some(label) => {
            let action = usize::try_from(*label)
                .ok()
                .and_then(|label| Action::STANDARD.get(label).copied());
            action
                .map(Some)
                .ok_or_else(|| faulty(format!("{label} is not a label")))
        }
    };
    let sample = |rows: SampleRows| {
        let count = rows.entities.len();
        let facts = vocabulary.predicates.iter().map(|predicate| {
            let agent = |at: usize| u32::try_from(at).expect("fewer than 2^32 rows");
            Ok(match predicate.arity {
                1 => {
                    let holds = &entities.bools(&predicate.name)?[rows.entities.clone()];
                    (0..count).filter(|&at| holds[at]).map(|at| [agent(at), 0]).collect()
                }
                _ => {
                    let holds = &pairs.bools(&predicate.name)?[rows.pairs.clone()];
                    let true_ones = (0..count * count).filter(|&at| holds[at]);
                    true_ones.map(|at| [agent(at / count), agent(at % count)]).collect()
                }
            })
        });
        Ok(Sample {
            tick: rows.tick,
            facts: Facts::of(facts.collect::<Result<_, Diagnostic>>()?),
            names: names[rows.entities.clone()].to_vec(),
            labels: labels[rows.entities].iter().map(label).collect::<Result<_, _>>()?,
        })
    };
    sample_rows(world, entities, pairs)?.into_iter().map(sample).collect()
}
