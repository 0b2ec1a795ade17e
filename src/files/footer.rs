//! The footer of Parquet files, which is checked before the parquet crate reads it: the crate descends into nested columns
//! without a limit.

use std::io::{self, Read, Seek, SeekFrom};

/// The largest footer that is read: 256 MiB.
const FOOTER_MAX: u32 = 1 << 28;

/// The deepest nesting of values that are skipped. The format has less.
const DEPTH_MAX: usize = 16;

/// Types of the compact protocol of Thrift.
const I32: u8 = 5;
const LIST: u8 = 9;
const STRUCT: u8 = 12;

/// Checks that a Parquet file has no nested columns, as tables of rows do. The parquet crate reports files that are no
/// Parquet files.
///
/// # Errors
/// `InvalidData` for nested columns and for damaged footers, and what reading returns.
pub fn check_flat(mut file: impl Read + Seek) -> io::Result<()> {
    let size = file.seek(SeekFrom::End(0))?;
    let mut end = [0; 8];
    if size < 12 {
        return Ok(());
    }
    file.seek(SeekFrom::End(-8))?;
    file.read_exact(&mut end)?;
    let length = u32::from_le_bytes([end[0], end[1], end[2], end[3]]);
    if end[4..] != *b"PAR1" {
        return Ok(());
    }
    let invalid = |what: &str| Err(io::Error::new(io::ErrorKind::InvalidData, what));
    if u64::from(length) > size - 8 || length > FOOTER_MAX {
        return invalid("the file is damaged");
    }
    file.seek(SeekFrom::End(-8 - i64::from(length)))?;
    let mut footer = vec![0; length as usize];
    file.read_exact(&mut footer)?;
    match Footer(&footer).only_root_has_children() {
        Some(true) => Ok(()),
        Some(false) => invalid("the table has nested columns"),
        None => invalid("the file is damaged"),
    }
}

/// The unread bytes of a footer, in the compact protocol of Thrift. Methods return `None` at bytes that are no such value.
struct Footer<'a>(&'a [u8]);

impl Footer<'_> {
    fn byte(&mut self) -> Option<u8> {
        let (first, rest) = self.0.split_first()?;
        self.0 = rest;
        Some(*first)
    }

    fn bytes(&mut self, count: u64) -> Option<()> {
        self.0 = self.0.get(usize::try_from(count).ok()?..)?;
        Some(())
    }

    fn varint(&mut self) -> Option<u64> {
        let mut value = 0;
        for shift in (0..64).step_by(7) {
            let byte = self.byte()?;
            value |= u64::from(byte & 0x7f) << shift;
            if byte < 0x80 {
                return Some(value);
            }
        }
        None
    }

    fn zigzag(&mut self) -> Option<i64> {
        let value = self.varint()?;
        Some((value >> 1).cast_signed() ^ -(value & 1).cast_signed())
    }

    /// Reads the head of the field after field `last` of a structure: its number and type; type 0 is the end.
    fn field(&mut self, last: i64) -> Option<(i64, u8)> {
        let head = self.byte()?;
        let ty = head & 0x0f;
        match (ty, head >> 4) {
            (0, _) => Some((last, 0)),
            (_, 0) => Some((self.zigzag()?, ty)),
            (_, further) => Some((last.checked_add(further.into())?, ty)),
        }
    }

    /// Reads the head of a list: the number of its elements, and their type.
    fn list(&mut self) -> Option<(u64, u8)> {
        let head = self.byte()?;
        let count = match head >> 4 {
            15 => self.varint()?,
            count => count.into(),
        };
        Some((count, head & 0x0f))
    }

    /// Skips a value; elements of lists and maps take a byte if they are truth values.
    fn skip(&mut self, ty: u8, is_element: bool, depth: usize) -> Option<()> {
        let depth = depth.checked_sub(1)?;
        match ty {
            1 | 2 if !is_element => Some(()),
            1..=3 => self.bytes(1),
            4..=6 => self.varint().map(drop),
            7 => self.bytes(8),
            8 => {
                let length = self.varint()?;
                self.bytes(length)
            }
            LIST | 10 => {
                let (count, ty) = self.list()?;
                (0..count).try_for_each(|_| self.skip(ty, true, depth))
            }
            11 => {
                let count = self.varint()?;
                let types = if count == 0 { 0 } else { self.byte()? };
                (0..count).try_for_each(|_| {
                    self.skip(types >> 4, true, depth)?;
                    self.skip(types & 0x0f, true, depth)
                })
            }
            STRUCT => {
                let mut last = 0;
                loop {
                    let (number, ty) = self.field(last)?;
                    if ty == 0 {
                        return Some(());
                    }
                    self.skip(ty, false, depth)?;
                    last = number;
                }
            }
            13 => self.bytes(16),
            _ => None,
        }
    }

    /// Returns whether only the first element of the schema, which is field 2 after the version, has children, which is
    /// field 5 of an element. `None` also for a footer that another reader may take for something else: with fields out
    /// of order, repeated, or of another type.
    fn only_root_has_children(&mut self) -> Option<bool> {
        let (1, I32) = self.field(0)? else { return None };
        self.skip(I32, false, DEPTH_MAX)?;
        let (2, LIST) = self.field(1)? else { return None };
        let (count, STRUCT) = self.list()? else {
            return None;
        };
        for index in 0..count {
            let mut last = 0;
            loop {
                let (number, ty) = self.field(last)?;
                match (number, ty) {
                    (_, 0) => break,
                    _ if number <= last || number > i16::MAX.into() => return None,
                    (5, I32) => {
                        if i32::try_from(self.zigzag()?).ok()? != 0 && index > 0 {
                            return Some(false);
                        }
                    }
                    (5, _) => return None,
                    (_, ty) => self.skip(ty, false, DEPTH_MAX)?,
                }
                last = number;
            }
        }
        Some(true)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use parquet::file::properties::WriterProperties;
    use parquet::file::writer::SerializedFileWriter;
    use parquet::schema::parser::parse_message_type;
    use std::io::Cursor;
    use std::sync::Arc;

    fn file(schema: &str) -> Vec<u8> {
        let schema = Arc::new(parse_message_type(schema).unwrap());
        let mut out = Vec::new();
        let writer = SerializedFileWriter::new(&mut out, schema, Arc::new(WriterProperties::builder().build()));
        writer.unwrap().close().unwrap();
        out
    }

    fn said(bytes: &[u8]) -> Option<String> {
        check_flat(Cursor::new(bytes)).err().map(|error| error.to_string())
    }

    #[test]
    fn nested_columns_are_found() {
        let flat =
            "message rows { required int32 n; required binary s (STRING); optional int32 u (INTEGER(32, false)); }";
        assert_eq!(said(&file(flat)), None);
        let nested = "message rows { required int32 n; required group g { required int32 m; } }";
        assert_eq!(said(&file(nested)).as_deref(), Some("the table has nested columns"));
    }

    #[test]
    fn damaged_footers_are_refused() {
        let good = file("message rows { required int32 n; required binary s (STRING); }");
        let from = good.len() - 8 - u32::from_le_bytes(good[good.len() - 8..][..4].try_into().unwrap()) as usize;
        let mut refused = 0;
        for at in from..good.len() - 8 {
            for value in [0x00, 0x19, 0x7f, 0xff] {
                let mut bad = good.clone();
                bad[at] = value;
                refused += usize::from(said(&bad).is_some());
            }
        }
        assert!(refused > 0, "every damage was overlooked");
        let bodies: [&[u8]; 7] = [
            // A list of 2^63 elements, and lists in lists without end.
            b"\x15\x02\x19\xfc\xff\xff\xff\xff\xff\xff\xff\xff\x7f",
            &[0x19; 100_000],
            // Without a version, with a set for the schema, and with the numbers of children in 64 bits.
            b"\x29\x1c\x55\x02\x00\x00",
            b"\x15\x02\x1a\x1c\x55\x02\x00\x00",
            b"\x15\x02\x19\x1c\x56\x06\x00\x00",
            // Field 65,541, which is 5 in 16 bits, and field 5 twice.
            b"\x15\x02\x19\x1c\x05\x8a\x80\x08\x06\x00\x00",
            b"\x15\x02\x19\x1c\x55\x00\x05\x0a\x06\x00\x00",
        ];
        for body in bodies {
            let mut bad = b"PAR1".to_vec();
            bad.extend_from_slice(body);
            bad.extend_from_slice(&u32::try_from(body.len()).unwrap().to_le_bytes());
            bad.extend_from_slice(b"PAR1");
            assert_eq!(said(&bad).as_deref(), Some("the file is damaged"));
        }
        assert_eq!(said(b"PAR1"), None);
        assert_eq!(said(b"no table at all, but long enough"), None);
    }
}
