//! Temporal literals: `previous P(X)`, `once[0,5] P(X)`, `P(X) since Q(X)`.
//!
//! The words of the operators stay names elsewhere: `once(X)` is an atom.

use crate::codes;
use crate::diag::{Diagnostic, counted, did_you_mean};
use crate::syntax::ast::{Atom, Literal, Operator, Temporal};
use crate::syntax::lexer::{Kind, Token};

use crate::syntax::parser::{Parse, Parser, Reported};

/// The greatest number of ticks that a window can look back.
const WINDOW_MAX: u32 = 1_000_000;

/// Help for a window of `since` in parentheses.
const SINCE_WINDOW: &str = "the window of a temporal operator is in brackets: `P(x) since[1,10] Q(x)`";

/// The words of temporal logic and of other languages for the operators, in lower case.
const FOREIGN_OPERATORS: &[(&[&str], Operator)] = &[
    (&["always", "globally", "throughout"], Operator::Historically),
    (
        &["eventually", "ever", "past", "sometime", "sometimes", "within"],
        Operator::Once,
    ),
    (&["before", "last", "prev", "prior", "yesterday"], Operator::Previous),
];

impl Parser<'_> {
    /// Returns the operator that begins a literal at the current token.
    pub(super) fn operator_ahead(&self) -> Option<Operator> {
        let (word, next) = (self.token(), self.ahead(1));
        let operator = self.operator(word)?;
        let applies = match (next.kind, self.ahead(2).kind) {
            (Kind::LBracket, second) => next.start == word.end || second == Kind::Number,
            (Kind::Ident, _) if self.infix(next).is_some() => false,
            (Kind::Ident, Kind::LParen | Kind::LBracket) | (Kind::Bang, _) => true,
            (Kind::Ident, Kind::Dot) => self.is_component_atom(1),
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

    /// Returns the operator that a misspelled word, or a word of another language, probably means.
    pub(super) fn near_operator(&self, word: Token) -> Option<&'static str> {
        let text = self.slice(word).to_lowercase();
        let mut others = FOREIGN_OPERATORS.iter();
        if let Some((_, operator)) = others.find(|(words, _)| words.contains(&text.as_str())) {
            return Some(operator.word());
        }
        let words = || Operator::ALL.into_iter().map(Operator::word);
        let beginning = words().find(|word| text.len() >= 3 && word.starts_with(&text));
        beginning.or_else(|| did_you_mean(&text, words()))
    }

    /// Returns the help for a word between two atoms that probably means a temporal operator.
    pub(super) fn operator_between_atoms(&self) -> Option<&'static str> {
        let (word, next) = (self.token(), self.ahead(1));
        if word.kind != Kind::Ident || self.at == 0 || self.previous().kind != Kind::RParen {
            return None;
        }
        let is_exact = Operator::ALL
            .into_iter()
            .any(|operator| operator.word() == self.slice(word));
        let has_window = next.kind == Kind::LBracket;
        let near = self.near_operator(word)?;
        match (near, next.kind) {
            ("since", Kind::LParen) if is_exact => Some(SINCE_WINDOW),
            ("since", Kind::LBracket | Kind::Ident) if !is_exact => Some("did you mean the temporal operator `since`?"),
            // Words such as `one` are common, so only a window shows what is meant.
            (_, _) if near != "since" && (has_window || (is_exact && next.kind == Kind::Ident)) => match is_exact {
                true => Some("a temporal operator begins a literal of its own: write a comma before it"),
                false => Some(match near {
                    "previous" => "did you mean the temporal operator `previous`? Write a comma before it",
                    "once" => "did you mean the temporal operator `once`? Write a comma before it",
                    "historically" => "did you mean the temporal operator `historically`? Write a comma before it",
                    _ => "did you mean the temporal operator `for`? Write a comma before it",
                }),
            },
            _ => None,
        }
    }

    /// Returns whether a word that stands for a temporal operator, but is not used as one, begins a literal here:
    /// `since[1,30] P(x)`, `always[1,8] P(x)`, `once(P(x))`.
    pub(super) fn is_misplaced_operator(&self) -> bool {
        let (word, next) = (self.token(), self.ahead(1));
        if word.kind != Kind::Ident {
            return false;
        }
        let is_foreign = || {
            let text = self.slice(word).to_lowercase();
            FOREIGN_OPERATORS
                .iter()
                .any(|(words, _)| words.contains(&text.as_str()))
        };
        let is_since = self.slice(word) == Operator::Since.word();
        match next.kind {
            Kind::LBracket => {
                let is_near = self.ahead(2).kind == Kind::Number && self.near_operator(word).is_some();
                next.start == word.end && self.infix(word).is_none() && (is_near || self.atom_follows_bracket())
            }
            Kind::Ident => is_since && self.ahead(2).kind == Kind::LParen && self.infix(next).is_none(),
            Kind::LParen => self.is_atom_ahead(2) && (is_since || self.operator(word).is_some() || is_foreign()),
            _ => false,
        }
    }

    /// Returns whether an atom, perhaps negated, follows the bracket after the current token on this line.
    fn atom_follows_bracket(&self) -> bool {
        let rest = &self.tokens[self.at + 1..];
        let line = rest.iter().position(|token| token.first_on_line).unwrap_or(rest.len());
        let close = rest[..line].iter().position(|token| token.kind == Kind::RBracket);
        close.is_some_and(|close| self.is_atom_ahead(close + 2))
    }

    /// Reports what [`Parser::is_misplaced_operator`] finds.
    pub(super) fn misplaced_operator(&mut self) -> Reported {
        let (word, next) = (self.token(), self.ahead(1));
        let text = self.slice(word);
        let span = self.span(word);
        let fault = |message: String| Diagnostic::new(codes::SYNTAX, message).at(span, "");
        let window = self.window_text();
        let near = self.near_operator(word);
        let fault = match near {
            Some("since") if text == "since" => {
                let fault = fault("`since` without an atom before it".to_owned());
                let between = format!("`since` stands between two atoms: `P(x) since{window} Q(x)`");
                let comma = self.at.checked_sub(1).map(|at| self.tokens[at]);
                match comma.filter(|token| token.kind == Kind::Comma && next.kind != Kind::LParen) {
                    Some(comma) => fault
                        .help(format!("{between}; remove the comma before it"))
                        .fix("remove the comma", [(self.span(comma), String::new())]),
                    None => fault.help(between),
                }
            }
            Some(near) if next.kind == Kind::LParen => {
                let example = match near {
                    "previous" => "previous P(x)",
                    "historically" => "historically[0,5] P(x)",
                    "for" => "for[5] P(x)",
                    _ => "once[0,5] P(x)",
                };
                fault(format!("`{text}` is not a function")).help(format!(
                    "the temporal operator `{near}` stands before its atom: `{example}`"
                ))
            }
            Some("since") => fault(format!("no temporal operator is called `{text}`")).help(format!(
                "did you mean `since`? It stands between two atoms: `P(x) since{window} Q(x)`"
            )),
            // A window does not suit it.
            Some("previous") if text != "previous" => fault(format!("no temporal operator is called `{text}`"))
                .help("did you mean `previous`, which has no window: `previous P(x)`?"),
            Some(near) => fault(format!("no temporal operator is called `{text}`")).did_you_mean(near, &[span]),
            None => fault(format!("no temporal operator is called `{text}`"))
                .help("the temporal operators are `previous`, `once`, `historically`, `for` and `since`"),
        };
        self.faults.push(fault);
        Reported
    }

    /// Returns the window after the current word as it is written; empty if there is none on this line.
    fn window_text(&self) -> &str {
        let rest = &self.text[self.ahead(1).start as usize..];
        let line = rest.lines().next().unwrap_or_default();
        match line.find(']') {
            Some(end) if line.starts_with('[') => &line[..=end],
            _ => "",
        }
    }

    /// Returns whether the previous tokens are a temporal operator and its window in parentheses: `once(1, 10)`.
    pub(super) fn follows_operator(&self) -> bool {
        let before = &self.tokens[..self.at];
        let open = before.iter().rposition(|token| token.kind == Kind::LParen);
        let (words, window) = before.split_at(open.unwrap_or(0));
        let is_window = match window {
            [_, numbers @ .., end] => {
                end.kind == Kind::RParen
                    && numbers
                        .iter()
                        .all(|token| matches!(token.kind, Kind::Number | Kind::Comma))
            }
            _ => false,
        };
        is_window && words.last().is_some_and(|word| self.operator(*word).is_some())
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
        let first = self.ticks(operator)?;
        let last = match self.eat(Kind::Comma) {
            true => Some(self.ticks(operator)?),
            false => None,
        };
        if self.kind() != Kind::RBracket {
            let what = if last.is_some() { "`]`" } else { "`,` or `]`" };
            return Err(self.faulty_window(what, operator));
        }
        let close = self.bump();
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
                    "write `{}[0,{first}]` for the ticks from now to {} ago",
                    self.slice(word),
                    counted(first, "tick")
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

    /// Reports that `what` is missing in a window, and skips the window.
    fn faulty_window(&mut self, what: &str, operator: Operator) -> Reported {
        let help = match operator {
            Operator::For => "the window is a whole number of ticks, such as `for[10]`",
            Operator::Since => "the bounds of a window are whole numbers of ticks, such as `P(x) since[0,6] Q(x)`",
            Operator::Historically => "the bounds of a window are whole numbers of ticks, such as `historically[0,6]`",
            _ => "the bounds of a window are whole numbers of ticks, such as `once[0,6]`",
        };
        let reported = self.expected_with(what, Some(help));
        // A full stop within the window ends no clause.
        let rest = &self.tokens[self.at..];
        let line = rest
            .iter()
            .position(|token| token.first_on_line || token.kind == Kind::End);
        let close = rest[..line.unwrap_or(rest.len())]
            .iter()
            .position(|token| token.kind == Kind::RBracket);
        self.at += close.unwrap_or(0);
        reported
    }

    /// Reads a number of ticks.
    fn ticks(&mut self, operator: Operator) -> Parse<u32> {
        if self.token().kind == Kind::Minus {
            let help =
                "a window counts ticks backward from the present one, which is 0: `[1,5]` are the five before it";
            return Err(self.expected_with("a number of ticks", Some(help)));
        }
        if self.kind() != Kind::Number {
            return Err(self.faulty_window("a number of ticks", operator));
        }
        let token = self.bump();
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
