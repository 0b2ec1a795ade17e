//! Predicates as JSON, in Soufflé's conventions: a list of rows, each a list of values or an object with the names of
//! the columns. A record is a string with its text, as in files of rows.

use crate::check::{Column, Predicate, PredicateId, Type};
use crate::codes;
use crate::convert::read;
use crate::diag::{Diagnostic, counted};
use crate::eval::limits::EvalError;
use crate::facts::ordered;
use crate::session::Session;
use crate::symbol::{Symbol, Symbols};
use crate::syntax::ast::BaseType;
use crate::value::{self, Value, parse_in, shortened};
use serde::de::{DeserializeSeed, Deserializer, Error as _, IgnoredAny, MapAccess, SeqAccess, Visitor};
use std::fmt;
use std::io::{self, BufReader, Read, Write};

/// Inserts the rows of a JSON text into a predicate and returns the number of rows read.
///
/// The text is a list of rows. A row is a list of values, or an object with the names of all columns:
///
/// ```
/// # use logicity_datalog::{Program, facts};
/// let program = Program::parse(".decl age(person: symbol, years: number) .input age")?;
/// let mut session = program.session();
/// let age = program.predicate("age").unwrap();
/// let text = r#"[["Ada", 36], {"years": 41, "person": "Alan"}]"#;
/// assert_eq!(facts::load_json(&mut session, age, text.as_bytes())?, Ok(2));
/// session.commit()?;
/// assert!(session.contains("age", ("Alan", 41)));
///
/// let fault = facts::load_json(&mut session, age, "[[\"Ada\", \"36\"]]".as_bytes())?.unwrap_err();
/// assert_eq!(fault.message, "column `years` of `age` holds numbers, not \"36\"");
/// assert_eq!(fault.notes, ["in line 1, column 13"]);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// The outer result has the errors of `input`, the inner one the first fault of the text, or that the rows take more
/// memory than the session may. In each case the function inserts nothing.
pub fn load_json(session: &mut Session, id: PredicateId, input: impl Read) -> io::Result<Result<usize, Diagnostic>> {
    let program = session.program().clone();
    let (predicate, to) = match program.base(id) {
        Ok(found) => found,
        Err(error) => return Ok(Err(Diagnostic::new(codes::INVALID_FACT, error.to_string()))),
    };
    let before = session.store.pending(to);
    let mut loader = Loader {
        session,
        predicate,
        types: &program.rules().types,
        id,
        words: Vec::new(),
        rows: 0,
        over: false,
    };
    // Buffered, since the parser reads byte by byte.
    let mut parser = serde_json::Deserializer::from_reader(BufReader::new(input));
    let read = loader.deserialize(&mut parser).and_then(|()| parser.end());
    let (rows, over) = (loader.rows, loader.over);
    let error = match read {
        Ok(()) => return Ok(Ok(rows)),
        Err(error) => error,
    };
    session.store.forget(to, before);
    if over {
        let limit = session.limits().bytes;
        return Ok(Err(EvalError::TooManyInputs { limit }.diagnostic(program.rules())));
    }
    if error.is_io() {
        return Err(error.into());
    }
    let (line, column) = (error.line(), error.column());
    let message = error.to_string();
    let place = format!(" at line {line} column {column}");
    let message = message.strip_suffix(&place).unwrap_or(&message);
    let fault = Diagnostic::new(codes::INVALID_FACT, message);
    Ok(Err(fault.note(format!("in line {line}, column {column}"))))
}

/// Writes the rows of a predicate as JSON, one in a line, in the order of [`sorted`](super::sorted).
///
/// # Errors
/// If writing to `out` fails, or a record has more than 16 MiB of text.
pub fn write_json(session: &Session, id: PredicateId, objects: bool, out: &mut dyn Write) -> io::Result<()> {
    let Some(predicate) = session.program().rules().predicates.get(id.index()) else {
        return Ok(());
    };
    out.write_all(b"[")?;
    let (begin, end) = if objects { ("{", "}") } else { ("[", "]") };
    let mut between = "";
    for row in ordered(session, predicate, id) {
        write!(out, "{between}{begin}")?;
        between = ",\n";
        for (position, (column, &value)) in predicate.columns.iter().zip(row).enumerate() {
            if position > 0 {
                out.write_all(b", ")?;
            }
            if objects {
                serde_json::to_writer(&mut *out, &column.name)?;
                out.write_all(b": ")?;
            }
            match column.base {
                BaseType::Number => write!(out, "{}", value.to_number(session.symbols()))?,
                BaseType::Unsigned => write!(out, "{}", value.to_unsigned(session.symbols()))?,
                BaseType::Float => {
                    let text = value::number_text(column.base, value, session.symbols());
                    // JSON has no infinities.
                    match value.to_float(session.symbols()).is_finite() {
                        true => out.write_all(text.as_bytes())?,
                        false => write!(out, "\"{text}\"")?,
                    }
                }
                BaseType::Symbol => {
                    let text = session.symbols().resolve(Symbol(value.0)).unwrap_or_default();
                    serde_json::to_writer(&mut *out, text)?;
                }
                BaseType::Record => serde_json::to_writer(&mut *out, &super::record_text(session, predicate, value)?)?,
            }
        }
        out.write_all(end.as_bytes())?;
    }
    out.write_all(b"]\n")
}

/// Reads the list of rows.
struct Loader<'a> {
    session: &'a mut Session,
    id: PredicateId,
    predicate: &'a Predicate,
    types: &'a [Type],
    words: Vec<Value>,
    rows: usize,
    /// Whether the rows take too much memory.
    over: bool,
}

impl Loader<'_> {
    /// Inserts the rows read so far.
    fn flush<E: serde::de::Error>(&mut self) -> Result<(), E> {
        let inserted = match self.predicate.arity() {
            0 => (0..self.rows.min(1)).try_for_each(|_| self.session.insert(self.id, ())),
            arity => self.session.insert_all(self.id, self.words.chunks_exact(arity)),
        };
        self.words.clear();
        self.over = self.session.bytes() > self.session.limits().bytes;
        match (inserted, self.over) {
            (Ok(()), false) => Ok(()),
            (Ok(()), true) => Err(E::custom("too many rows")),
            (Err(error), _) => Err(E::custom(error)),
        }
    }
}

impl<'de> DeserializeSeed<'de> for &mut Loader<'_> {
    type Value = ();

    fn deserialize<D: Deserializer<'de>>(self, input: D) -> Result<(), D::Error> {
        input.deserialize_seq(self)
    }
}

impl<'de> Visitor<'de> for &mut Loader<'_> {
    type Value = ();

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a list of rows")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut rows: A) -> Result<(), A::Error> {
        /// Words between two insertions.
        const PART: usize = 1 << 14;
        loop {
            let row = RowReader {
                symbols: self.session.symbols(),
                predicate: self.predicate,
                types: self.types,
                words: &mut self.words,
            };
            if rows.next_element_seed(row)?.is_none() {
                return self.flush();
            }
            self.rows += 1;
            if self.words.len() >= PART {
                self.flush()?;
            }
        }
    }
}

/// Reads a row.
struct RowReader<'a> {
    symbols: &'a Symbols,
    predicate: &'a Predicate,
    types: &'a [Type],
    words: &'a mut Vec<Value>,
}

impl RowReader<'_> {
    fn cell<'c>(&'c self, column: &'c Column) -> CellReader<'c> {
        CellReader {
            symbols: self.symbols,
            predicate: self.predicate,
            types: self.types,
            column,
        }
    }
}

impl<'de> DeserializeSeed<'de> for RowReader<'_> {
    type Value = ();

    fn deserialize<D: Deserializer<'de>>(self, input: D) -> Result<(), D::Error> {
        input.deserialize_any(self)
    }
}

impl<'de> Visitor<'de> for RowReader<'_> {
    type Value = ();

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "a row of `{}`: a list or an object", self.predicate.name)
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut row: A) -> Result<(), A::Error> {
        let (name, arity) = (&self.predicate.name, self.predicate.arity());
        let misshapen = |found| {
            A::Error::custom(format!(
                "a row of `{name}` has {}, not {found}",
                counted(arity, "value")
            ))
        };
        for (found, column) in self.predicate.columns.iter().enumerate() {
            let word = row.next_element_seed(self.cell(column))?;
            self.words.push(word.ok_or_else(|| misshapen(found.to_string()))?);
        }
        match row.next_element::<IgnoredAny>()? {
            None => Ok(()),
            Some(_) => Err(misshapen("more".to_owned())),
        }
    }

    fn visit_map<A: MapAccess<'de>>(self, mut row: A) -> Result<(), A::Error> {
        let (name, columns) = (&self.predicate.name, &self.predicate.columns);
        let mut found: Vec<Option<Value>> = vec![None; columns.len()];
        while let Some(key) = row.next_key::<String>()? {
            let Some(at) = columns.iter().position(|column| column.name == key) else {
                return Err(A::Error::custom(format!(
                    "`{name}` has no column {:?}",
                    shortened(&key)
                )));
            };
            if found[at].is_some() {
                return Err(A::Error::custom(format!(
                    "the column `{key}` occurs twice in a row of `{name}`"
                )));
            }
            found[at] = Some(row.next_value_seed(self.cell(&columns[at]))?);
        }
        for (word, column) in found.into_iter().zip(columns) {
            let missing = || A::Error::custom(format!("a row of `{name}` lacks the column `{}`", column.name));
            self.words.push(word.ok_or_else(missing)?);
        }
        Ok(())
    }
}

/// Reads a value.
struct CellReader<'a> {
    symbols: &'a Symbols,
    predicate: &'a Predicate,
    types: &'a [Type],
    column: &'a Column,
}

impl CellReader<'_> {
    fn number<E: serde::de::Error>(self, number: i128) -> Result<Value, E> {
        let word = match self.column.base {
            BaseType::Number => (i64::try_from(number).ok()).and_then(|number| Value::of_number(number, self.symbols)),
            BaseType::Unsigned => {
                (u64::try_from(number).ok()).and_then(|number| Value::of_unsigned(number, self.symbols))
            }
            BaseType::Float => return self.float(number as f64),
            BaseType::Symbol | BaseType::Record => None,
        };
        word.ok_or_else(|| E::custom(format!("{self}, not {number}")))
    }

    fn float<E: serde::de::Error>(self, number: f64) -> Result<Value, E> {
        let near = Value::of_float(number, self.symbols);
        let is_near = near.to_float(self.symbols).is_finite() || !number.is_finite();
        match self.column.base == BaseType::Float && is_near {
            true => Ok(near),
            false => Err(E::custom(format!("{self}, not {number:?}"))),
        }
    }
}

/// What the column holds.
impl fmt::Display for CellReader<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let holds = match self.column.base {
            BaseType::Number => "numbers",
            BaseType::Unsigned => "unsigned numbers",
            BaseType::Float => "floats",
            BaseType::Symbol => "symbols",
            BaseType::Record => "records as strings",
        };
        write!(
            f,
            "column `{}` of `{}` holds {holds}",
            self.column.name, self.predicate.name
        )
    }
}

impl<'de> DeserializeSeed<'de> for CellReader<'_> {
    type Value = Value;

    fn deserialize<D: Deserializer<'de>>(self, input: D) -> Result<Value, D::Error> {
        input.deserialize_any(self)
    }
}

impl<'de> Visitor<'de> for CellReader<'_> {
    type Value = Value;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "a value: {self}")
    }

    fn visit_i64<E: serde::de::Error>(self, number: i64) -> Result<Value, E> {
        self.number(number.into())
    }

    fn visit_u64<E: serde::de::Error>(self, number: u64) -> Result<Value, E> {
        self.number(number.into())
    }

    fn visit_f64<E: serde::de::Error>(self, number: f64) -> Result<Value, E> {
        self.float(number)
    }

    fn visit_str<E: serde::de::Error>(self, text: &str) -> Result<Value, E> {
        match self.column.base {
            BaseType::Symbol => Ok(Value(self.symbols.intern(text).0)),
            BaseType::Record => read(text, self.column.ty, self.types, &self.symbols.encoder()).map_err(|fault| {
                E::custom(format!(
                    "{self}: expected {} in {:?}",
                    fault.expected.unwrap_or_default(),
                    shortened(text)
                ))
            }),
            // What `write_json` writes for infinities and "not a number".
            BaseType::Float => parse_in(BaseType::Float, text, self.symbols)
                .filter(|word| !word.to_float(self.symbols).is_finite())
                .ok_or_else(|| E::custom(format!("{self}, not {:?}", shortened(text)))),
            BaseType::Number | BaseType::Unsigned => Err(E::custom(format!("{self}, not {:?}", shortened(text)))),
        }
    }
}
