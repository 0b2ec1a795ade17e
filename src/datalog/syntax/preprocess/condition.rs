//! The values of `#if` and `#elif`.

use crate::diag::{Sources, Span};
use crate::syntax::preprocess::expand::Macros;
use crate::syntax::preprocess::piece::{Piece, PieceKind, Space};

/// Maximum nesting of an expression.
const MAX_NESTING: usize = 64;

/// What is wrong with an expression, and where; `None` at its end.
pub(super) type Faulty = (Option<Span>, &'static str);

/// The operators with two operands by precedence, from the weakest. Longer ones come first.
const OPERATORS: [&[&str]; 10] = [
    &["||"],
    &["&&"],
    &["|"],
    &["^"],
    &["&"],
    &["==", "!="],
    &["<=", ">=", "<", ">"],
    &["<<", ">>"],
    &["+", "-"],
    &["*", "/", "%"],
];

/// Returns the value of an expression whose macros are expanded.
///
/// # Errors
/// What is wrong with it.
pub(super) fn value(pieces: &[Piece], macros: &Macros, sources: &Sources) -> Result<i64, Faulty> {
    let mut reader = Reader {
        pieces,
        macros,
        sources,
        at: 0,
        nesting: 0,
    };
    if pieces.is_empty() {
        return Err((None, "the condition is missing"));
    }
    let value = reader.conditional(true)?;
    match reader.pieces.get(reader.at) {
        None => Ok(value),
        Some(_) => Err(reader.fault("an operator is missing here")),
    }
}

struct Reader<'a> {
    pieces: &'a [Piece],
    macros: &'a Macros,
    sources: &'a Sources,
    at: usize,
    nesting: usize,
}

impl Reader<'_> {
    fn fault(&self, message: &'static str) -> Faulty {
        let piece = self.pieces.get(self.at);
        (piece.and_then(|piece| piece.place), message)
    }

    fn text(&self, ahead: usize) -> &str {
        let piece = self.pieces.get(self.at + ahead);
        piece.map_or("", |piece| self.macros.text(piece, self.sources))
    }

    /// Reads a sign of one or more characters.
    fn eat(&mut self, sign: &str) -> bool {
        let is_ours = sign.char_indices().all(|(ahead, c)| {
            let adjacent = ahead == 0
                || self
                    .pieces
                    .get(self.at + ahead)
                    .is_some_and(|piece| piece.space == Space::None);
            adjacent && self.text(ahead).chars().eq([c])
        });
        if is_ours {
            self.at += sign.len();
        }
        is_ours
    }

    fn deeper(&mut self) -> Result<(), Faulty> {
        self.nesting += 1;
        match self.nesting <= MAX_NESTING {
            true => Ok(()),
            false => Err(self.fault("the condition is nested too deeply")),
        }
    }

    /// `a ? b : c`. Without `live`, the value does not matter.
    fn conditional(&mut self, live: bool) -> Result<i64, Faulty> {
        let outside = self.nesting;
        self.deeper()?;
        let condition = self.operation(0, live)?;
        let mut value = condition;
        if self.eat("?") {
            let yes = self.conditional(live && condition != 0)?;
            if !self.eat(":") {
                return Err(self.fault("`:` is missing after `?`"));
            }
            let no = self.conditional(live && condition == 0)?;
            value = if condition != 0 { yes } else { no };
        }
        self.nesting = outside;
        Ok(value)
    }

    fn operation(&mut self, level: usize, live: bool) -> Result<i64, Faulty> {
        let Some(&operators) = OPERATORS.get(level) else {
            return self.operand(live);
        };
        let mut left = self.operation(level + 1, live)?;
        loop {
            // `&` is not the start of `&&`, and `<` not of `<<`.
            let doubled =
                |sign: &str| sign.len() == 1 && "|&<>".contains(sign) && self.text(0) == sign && self.text(1) == sign;
            let Some(&operator) = operators
                .iter()
                .find(|sign| !doubled(sign) && self.clone_at().eat(sign))
            else {
                return Ok(left);
            };
            let place = self.fault("division by zero");
            self.eat(operator);
            let live = match operator {
                "&&" => live && left != 0,
                "||" => live && left == 0,
                _ => live,
            };
            let right = self.operation(level + 1, live)?;
            let shift = |by: i64| u32::try_from(by.clamp(0, 63)).unwrap_or(0);
            left = match operator {
                "||" => i64::from(left != 0 || right != 0),
                "&&" => i64::from(left != 0 && right != 0),
                "|" => left | right,
                "^" => left ^ right,
                "&" => left & right,
                "==" => i64::from(left == right),
                "!=" => i64::from(left != right),
                "<=" => i64::from(left <= right),
                ">=" => i64::from(left >= right),
                "<" => i64::from(left < right),
                ">" => i64::from(left > right),
                "<<" => left.wrapping_shl(shift(right)),
                ">>" => left.wrapping_shr(shift(right)),
                "+" => left.wrapping_add(right),
                "-" => left.wrapping_sub(right),
                "*" => left.wrapping_mul(right),
                _ if right == 0 && live => return Err(place),
                _ if right == 0 => 0,
                "/" => left.wrapping_div(right),
                _ => left.wrapping_rem(right),
            };
        }
    }

    /// Returns a reader at the same place, to look ahead.
    fn clone_at(&self) -> Reader<'_> {
        Reader {
            pieces: self.pieces,
            macros: self.macros,
            sources: self.sources,
            ..*self
        }
    }

    fn operand(&mut self, live: bool) -> Result<i64, Faulty> {
        let outside = self.nesting;
        self.deeper()?;
        let Some(&piece) = self.pieces.get(self.at) else {
            return Err((None, "an operand is missing at the end"));
        };
        let value = match (piece.kind, self.text(0)) {
            (PieceKind::Number, _) => self.number()?,
            (PieceKind::Name, "defined") => {
                self.at += 1;
                let open = self.eat("(");
                if self
                    .pieces
                    .get(self.at)
                    .is_none_or(|piece| piece.kind != PieceKind::Name)
                {
                    return Err(self.fault("`defined` takes the name of a macro"));
                }
                let known = self.macros.is_defined(self.text(0));
                self.at += 1;
                if open && !self.eat(")") {
                    return Err(self.fault("`)` is missing after `defined(NAME`"));
                }
                i64::from(known)
            }
            (PieceKind::Name, _) => {
                self.at += 1;
                if self.text(0) == "(" {
                    self.at -= 1;
                    return Err(self.fault("no macro with parameters has this name"));
                }
                0
            }
            (_, "(") => {
                self.at += 1;
                let value = self.conditional(live)?;
                if !self.eat(")") {
                    return Err(self.fault("`)` is missing"));
                }
                value
            }
            (_, sign @ ("!" | "-" | "+" | "~")) => {
                let sign = sign.to_owned();
                self.at += 1;
                let value = self.operand(live)?;
                match sign.as_str() {
                    "!" => i64::from(value == 0),
                    "-" => value.wrapping_neg(),
                    "~" => !value,
                    _ => value,
                }
            }
            _ => return Err(self.fault("a condition consists of whole numbers, names and operators")),
        };
        self.nesting = outside;
        Ok(value)
    }

    fn number(&mut self) -> Result<i64, Faulty> {
        let written = self.text(0).to_lowercase();
        let digits = written.trim_end_matches(['u', 'l']);
        let read = match digits.strip_prefix("0x") {
            Some(digits) => i64::from_str_radix(digits, 16),
            None => match digits.strip_prefix("0b") {
                Some(digits) => i64::from_str_radix(digits, 2),
                None if digits.len() > 1 && digits.starts_with('0') => i64::from_str_radix(digits, 8),
                None => digits.parse(),
            },
        };
        let value = read.map_err(|_| self.fault("this is not a whole number of 64 bits"))?;
        self.at += 1;
        Ok(value)
    }
}
