//! Temporal literals: `previous P(X)`, `once[0,5] P(X)`, `P(X) since Q(X)`.
//!
//! The words of the operators stay names elsewhere: `once(X)` is an atom.

use crate::codes;
use crate::diag::{Diagnostic, did_you_mean};
use crate::syntax::ast::{Atom, Literal, Operator, Temporal};
use crate::syntax::lexer::{Kind, Token};

use crate::syntax::parser::{Parse, Parser, Reported};

/// The greatest number of ticks that a window can look back.
const WINDOW_MAX: u32 = 1_000_000;

impl Parser<'_> {
    /// Returns the operator that begins a literal at the current token.
    pub(super) fn operator_ahead(&self) -> Option<Operator> {
        let (word, next) = (self.token(), self.ahead(1));
        let operator = self.operator(word)?;
        let applies = match (next.kind, self.ahead(2).kind) {
            (Kind::LBracket, second) => next.start == word.end || second == Kind::Number,
            (Kind::Ident, _) if self.infix(next).is_some() => false,
            (Kind::Ident, Kind::LParen | Kind::LBracket) | (Kind::Bang, _) => true,
            // A negation or a second operator, which is a fault.
            (Kind::Ident, Kind::Ident) => self.is_negation(next) || self.operator(next).is_some(),
            _ => false,
        };
        (word.kind == Kind::Ident && applies).then_some(operator)
    }

    /// Returns the operator before its atom that a token writes.
    fn operator(&self, token: Token) -> Option<Operator> {
        let mut operators = Operator::ALL.into_iter();
        operators.find(|operator| *operator != Operator::Since && operator.word() == self.slice(token))
    }

    /// Returns the operator that a misspelled word probably means.
    pub(super) fn near_operator(&self, word: Token) -> Option<&'static str> {
        let text = self.slice(word).to_lowercase();
        let words = || Operator::ALL.into_iter().map(Operator::word);
        let beginning = words().find(|word| text.len() >= 3 && word.starts_with(&text));
        beginning.or_else(|| did_you_mean(&text, words()))
    }

    /// Returns whether `since` follows an atom.
    pub(super) fn since_ahead(&self) -> bool {
        let (word, next) = (self.token(), self.ahead(1));
        let is_word = word.kind == Kind::Ident && self.slice(word) == Operator::Since.word();
        is_word && matches!(next.kind, Kind::LBracket | Kind::Ident | Kind::Bang)
    }

    /// Reads an operator with its window and the atom after it. `held` is the atom before `since`.
    pub(super) fn temporal(&mut self, start: Token, operator: Operator, held: Option<Atom>) -> Parse<Literal> {
        let word = self.bump();
        let window = match self.kind() {
            Kind::LBracket => Some(self.window(word, operator)?),
            _ => None,
        };
        let window = match (operator, window) {
            (Operator::Previous, None) => Some((1, 1)),
            (Operator::Historically | Operator::For, None) => {
                let (message, help) = match operator {
                    Operator::For => (
                        "`for` without a number of ticks",
                        "write `for[10] P(X)`: P held in the last 10 ticks",
                    ),
                    _ => (
                        "`historically` without a window",
                        "write `historically[0,9] P(X)`: before the first tick nothing held, so P never held in all ticks",
                    ),
                };
                return Err(self.invalid_temporal(word, message, help));
            }
            (_, window) => window,
        };
        let negated = self.kind() == Kind::Bang || (self.kind() == Kind::Ident && self.is_negation(self.token()));
        if negated || self.operator_ahead().is_some() || self.kind() == Kind::LParen {
            let help = "define a predicate with this body, and apply the operator to that";
            let token = self.token();
            return Err(self.invalid_temporal(token, "a temporal operator applies to an atom", help));
        }
        let atom = self.atom("the arguments of the atom: `(`")?;
        if self.since_ahead() {
            let help = "define a predicate for one of them";
            let token = self.token();
            return Err(self.invalid_temporal(token, "one literal has one temporal operator", help));
        }
        Ok(Literal::Temporal {
            negated: false,
            temporal: Box::new(Temporal {
                operator,
                window,
                held,
                atom,
                place: self.place_from(start),
            }),
        })
    }

    /// Reads `[0,5]`, or `[5]` after `for`.
    fn window(&mut self, word: Token, operator: Operator) -> Parse<(u32, u32)> {
        let open = self.bump();
        let first = self.ticks()?;
        let last = match self.eat(Kind::Comma) {
            true => Some(self.ticks()?),
            false => None,
        };
        let close = self.wanted(Kind::RBracket, if last.is_some() { "`]`" } else { "`,` or `]`" })?;
        let place = Token { end: close.end, ..open };
        match (operator, first, last) {
            (Operator::Previous, ..) => {
                let help = "write `previous P(X)` for the tick before, and `once[1,5] P(X)` for one of five";
                Err(self.invalid_temporal(place, "`previous` has no window", help))
            }
            (Operator::For, 0, None) => Err(self.invalid_temporal(
                place,
                "the window is empty",
                "write at least `for[1]`: the present tick",
            )),
            (Operator::For, ticks, None) => Ok((0, ticks - 1)),
            (Operator::For, first, Some(last)) => {
                let help = match first {
                    0 => format!("write `for[{}] P(X)`", u64::from(last) + 1),
                    _ => format!("write `historically[{first},{last}] P(X)`"),
                };
                Err(self.invalid_temporal(place, "`for` takes the number of ticks alone", &help))
            }
            (_, _, None) => {
                let help = format!(
                    "write `{}[0,{first}]` for the ticks from now to {first} ticks ago",
                    self.slice(word)
                );
                Err(self.invalid_temporal(place, "a window has two ends", &help))
            }
            (_, _, Some(last)) if first > last => {
                let help = format!("the nearer tick comes first: `[{last},{first}]`");
                Err(self.invalid_temporal(place, "the window is empty", &help))
            }
            (_, _, Some(last)) => Ok((first, last)),
        }
    }

    /// Reads a number of ticks.
    fn ticks(&mut self) -> Parse<u32> {
        if self.token().kind == Kind::Minus {
            let help =
                "a window counts ticks backward from the present one, which is 0: `[1,5]` are the five before it";
            return Err(self.expected_with("a number of ticks", Some(help)));
        }
        let token = self.wanted(Kind::Number, "a number of ticks")?;
        match u32::try_from(self.number(token)) {
            Ok(ticks) if ticks <= WINDOW_MAX => Ok(ticks),
            _ => {
                let message = format!("a window looks back at most {WINDOW_MAX} ticks");
                let help = "without a window, `once` and `since` look back to the first tick";
                Err(self.invalid_temporal(token, &message, help))
            }
        }
    }

    fn invalid_temporal(&mut self, at: Token, message: &str, help: &str) -> Reported {
        let fault = Diagnostic::new(codes::INVALID_TEMPORAL, message).at(self.span(at), "");
        self.faults.push(fault.help(help));
        Reported
    }
}
