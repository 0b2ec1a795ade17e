//! Records from text: `[1, abc]`, `nil`, `[1, [2, nil]]`, `$Circle(3)`.
//!
//! A symbol within a record stands as it is up to the comma or bracket after it, or in double quotes, where a quote is
//! doubled.

use crate::check::{RecordShape, Type, TypeId, shapes};
use crate::record;
use crate::symbol::WordEncoder;
use crate::syntax::functor::BaseType;
use crate::value::Value;
use std::borrow::Cow;

/// Why a text is no record of a type.
pub(crate) struct Fault {
    /// The byte where it is found.
    pub at: usize,
    /// What is expected there; `None` if the text is a record that the table of symbols does not have.
    pub expected: Option<String>,
}

/// Returns the word of the record with this shape and these fields.
pub fn record_word<E>(
    shape: &RecordShape,
    types: &[Type],
    fields: &[u32],
    symbol: impl Fn(&str) -> Result<Value, E>,
) -> Result<Value, E> {
    let kinds: Vec<u8> = (shape.fields.iter())
        .map(|(_, ty)| types[ty.0 as usize].base.kind())
        .collect();
    let word = symbol(&record::shape(shape.branch.as_deref(), &kinds))?;
    symbol(&record::encoded(word.0, fields.iter().copied()))
}

/// Returns the word of the record of a type with this text; `Err` with what is expected there.
pub fn record_of_text(
    text: &str,
    ty: TypeId,
    types: &[Type],
    words: &WordEncoder<'_>,
) -> Result<Value, Option<String>> {
    read(text, ty, types, words).map_err(|fault| fault.expected)
}

/// A record whose fields are being read.
struct Open<'t> {
    shape: &'t RecordShape,
    words: Vec<u32>,
    close: char,
}

/// Returns the word of the record that the text is. `symbol` maps a string to its symbol.
pub(crate) fn read(text: &str, ty: TypeId, types: &[Type], words: &WordEncoder<'_>) -> Result<Value, Fault> {
    let mut reader = Reader { text, at: 0 };
    let word = |at: usize, text: &str| match words.symbol(text) {
        Some(symbol) => Ok(symbol.0),
        None => Err(Fault { at, expected: None }),
    };
    let mut open: Vec<Open<'_>> = Vec::new();
    let mut ty = ty;
    loop {
        // A value, or the start of a record.
        let start = reader.skip();
        let mut done = match types.get(ty.0 as usize).map(|ty| ty.base) {
            Some(BaseType::Record) => {
                if reader.eat("nil") && shapes(types, ty).iter().all(|shape| shape.branch.is_none()) {
                    Some(word(start, record::NIL)?)
                } else {
                    let (shape, close) = reader.open(start, shapes(types, ty))?;
                    let words = Vec::with_capacity(shape.fields.len());
                    open.push(Open { shape, words, close });
                    None
                }
            }
            Some(BaseType::Symbol) => {
                let text = reader.string()?;
                Some(word(start, &text)?)
            }
            base => {
                let base = base.unwrap_or(BaseType::Number);
                let value = words.parse(base, reader.token());
                let expected = Some(format!("a value of type `{}`", base.name()));
                Some(value.ok_or(Fault { at: start, expected })?.0)
            }
        };
        // What follows a value closes records, as many as end here.
        loop {
            let Some(record) = open.last_mut() else {
                reader.skip();
                let Some(word) = done.filter(|_| reader.at == text.len()) else {
                    return Err(reader.fault("the end of the value"));
                };
                return Ok(Value(word));
            };
            let first = done.is_none();
            record.words.extend(done.take());
            reader.skip();
            let next = record.shape.fields.get(record.words.len());
            match next {
                Some((_, next)) => {
                    if !first && !reader.eat(",") {
                        return Err(reader.fault("`,` and a further field"));
                    }
                    ty = *next;
                    break;
                }
                None => {
                    if record.close != '\0' && !reader.eat(record.close.encode_utf8(&mut [0; 4])) {
                        return Err(reader.fault(&format!("`{}`", record.close)));
                    }
                    let word = |text: &str| word(reader.at, text).map(Value);
                    done = Some(record_word(record.shape, types, &record.words, word)?.0);
                    open.pop();
                }
            }
        }
    }
}

struct Reader<'t> {
    text: &'t str,
    at: usize,
}

impl<'t> Reader<'t> {
    fn rest(&self) -> &'t str {
        &self.text[self.at..]
    }

    fn fault(&self, expected: &str) -> Fault {
        Fault {
            at: self.at,
            expected: Some(expected.to_owned()),
        }
    }

    /// Skips white space and returns the position after it.
    fn skip(&mut self) -> usize {
        self.at = self.text.len() - self.rest().trim_start().len();
        self.at
    }

    fn eat(&mut self, token: &str) -> bool {
        let found = self.rest().starts_with(token);
        self.at += if found { token.len() } else { 0 };
        found
    }

    /// Reads the start of a record that has one of the shapes. Returns its shape and what closes it.
    fn open<'s>(&mut self, start: usize, shapes: &'s [RecordShape]) -> Result<(&'s RecordShape, char), Fault> {
        self.at = start;
        if self.eat("$") {
            let name = self.token_of(|c| c.is_alphanumeric() || "_?.".contains(c));
            let Some(shape) = shapes.iter().find(|shape| shape.branch.as_deref() == Some(name)) else {
                self.at = start;
                return Err(self.fault(&branches(shapes)));
            };
            self.skip();
            let close = if self.eat("(") { ')' } else { '\0' };
            if close == '\0' && !shape.fields.is_empty() {
                return Err(self.fault("`(` and the fields"));
            }
            return Ok((shape, close));
        }
        let plain = shapes.iter().find(|shape| shape.branch.is_none());
        self.at = start;
        match plain {
            Some(shape) if self.eat("[") => Ok((shape, ']')),
            Some(_) => Err(self.fault("`[` or `nil`")),
            None => Err(self.fault(&branches(shapes))),
        }
    }

    /// Reads the characters that are part of a token.
    fn token_of(&mut self, is_part: impl Fn(char) -> bool) -> &'t str {
        let rest = self.rest();
        let end = rest.find(|c| !is_part(c)).unwrap_or(rest.len());
        self.at += end;
        &rest[..end]
    }

    /// Reads up to the next comma or bracket.
    fn token(&mut self) -> &'t str {
        let rest = self.rest();
        let end = rest.find([',', ']', ')']).unwrap_or(rest.len());
        self.at += end;
        rest[..end].trim_end()
    }

    fn string(&mut self) -> Result<Cow<'t, str>, Fault> {
        if !self.eat("\"") {
            return Ok(Cow::Borrowed(self.token()));
        }
        let mut text = String::new();
        loop {
            let rest = self.rest();
            let Some(end) = rest.find('"') else {
                return Err(self.fault("a text that ends with a double quote"));
            };
            text.push_str(&rest[..end]);
            self.at += end + 1;
            if !self.eat("\"") {
                return Ok(Cow::Owned(text));
            }
            text.push('"');
        }
    }
}

/// Lists the branches of a type.
fn branches(shapes: &[RecordShape]) -> String {
    let names: Vec<String> = (shapes.iter())
        .filter_map(|shape| Some(format!("`${}`", shape.branch.as_ref()?)))
        .collect();
    match names.is_empty() {
        true => "a record".to_owned(),
        false => names.join(" or "),
    }
}
