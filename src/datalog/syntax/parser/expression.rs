//! Expressions: operators with precedence, functions, casts, aggregates and constants.

use crate::codes;
use crate::diag::{self, Diagnostic};
use crate::syntax::ast::{Aggregate, Literal, Term, TermKind};
use crate::syntax::functor::{AggregateOp, Functor};
use crate::syntax::lexer::{Kind, Token};
use core::net::Ipv4Addr;

use crate::syntax::parser::clause::comparison;
use crate::syntax::parser::{Parse, Parser, Reported, is_macro_name};

/// Maximum height of an expression: an operator or function is one level above its highest operand.
const MAX_HEIGHT: usize = 256;

/// Functors of Soufflé that this language does not have, with help.
const FOREIGN_FUNCTORS: &[(&str, &str)] = &[
    (
        "recursive_iteration_cnt",
        "rules do not read how often a recursion has run; `.limitsize` ends one",
    ),
    ("ftoi", "write `to_number(x)`"),
    ("ftou", "write `to_unsigned(x)`"),
    ("itof", "write `to_float(x)`"),
    ("itou", "write `to_unsigned(x)`"),
    ("utof", "write `to_float(x)`"),
    ("utoi", "write `to_number(x)`"),
];

impl Parser<'_> {
    /// Returns the binary operator that the token writes.
    pub(super) fn infix(&self, token: Token) -> Option<Functor> {
        match token.kind {
            Kind::Operator | Kind::Minus | Kind::Ident => Functor::infix(self.slice(token)),
            _ => None,
        }
    }

    pub(super) fn term(&mut self) -> Parse<Term> {
        self.expression(0).map(|(term, _)| term)
    }

    /// Parses an expression whose operators have at least the precedence `least`. Returns the term and its height.
    fn expression(&mut self, least: u8) -> Parse<(Term, usize)> {
        let start = self.token();
        let (mut left, mut height) = self.operand()?;
        while let Some(functor) = self.infix(self.token())
            && let Some(own) = functor.precedence()
            && own >= least
        {
            self.bump();
            let outside = self.nesting;
            if functor == Functor::Power {
                self.deeper()?;
            }
            // `^` groups to the right, all others to the left.
            let (right, right_height) = self.expression(own + u8::from(functor != Functor::Power))?;
            self.nesting = outside;
            height = self.higher(start, height.max(right_height))?;
            left = Term {
                kind: TermKind::Functor(functor, vec![left, right]),
                place: self.place_from(start),
            };
        }
        Ok((left, height))
    }

    fn higher(&mut self, start: Token, height: usize) -> Parse<usize> {
        if height < MAX_HEIGHT {
            return Ok(height + 1);
        }
        let fault = Diagnostic::new(diag::codes::LIMIT_EXCEEDED, "expression with too many operators")
            .at(self.span(start), "it begins here")
            .note(format!(
                "an expression is at most {MAX_HEIGHT} levels of operators high"
            ));
        self.faults.push(fault);
        Err(Reported)
    }

    /// Returns whether a term with parentheses begins here: a function, or an aggregate of a parenthesized expression.
    pub(super) fn is_term_with_parentheses(&self) -> bool {
        let word = self.slice(self.token());
        let is_function = word == "as" || Functor::function(word).is_some();
        self.is_aggregate() || (is_function && self.is_operand_in_parentheses(1)) || self.is_prefix_operator()
    }

    fn is_prefix_operator(&self) -> bool {
        matches!(self.slice(self.token()), "bnot" | "lnot") && self.begins_operand(self.ahead(1))
    }

    pub(super) fn begins_operand(&self, token: Token) -> bool {
        match token.kind {
            Kind::Number
            | Kind::Address
            | Kind::Float
            | Kind::Unsigned
            | Kind::String
            | Kind::LParen
            | Kind::Minus
            | Kind::At => true,
            Kind::Ident | Kind::Underscore => self.infix(token).is_none(),
            _ => false,
        }
    }

    /// Returns whether an aggregate begins at the current token. Elsewhere its name is a variable or, as in
    /// `max(x, y)`, a function.
    fn is_aggregate(&self) -> bool {
        let next = self.ahead(1);
        match AggregateOp::named(self.slice(self.token())) {
            Some(AggregateOp::Count) => matches!(next.kind, Kind::Colon | Kind::LBrace),
            Some(_) if next.kind == Kind::Minus => self.has_body_ahead(),
            Some(AggregateOp::Min | AggregateOp::Max) if next.kind == Kind::LParen => self.has_body_ahead(),
            Some(_) => self.begins_operand(next),
            None => false,
        }
    }

    /// Returns whether the body of an aggregate follows the expression after the current token: a colon outside of
    /// parentheses that belongs to no aggregate within the expression.
    fn has_body_ahead(&self) -> bool {
        let (mut depth, mut bodies) = (0_usize, 1_usize);
        let mut in_arguments = self.ahead(1).kind == Kind::LParen;
        let mut at = self.at + 1;
        while let Some(&token) = self.tokens.get(at) {
            let next = self.tokens[(at + 1).min(self.tokens.len() - 1)];
            match token.kind {
                Kind::LParen | Kind::LBrace | Kind::LBracket => depth += 1,
                Kind::RParen | Kind::RBrace | Kind::RBracket => match depth.checked_sub(1) {
                    Some(outer) => {
                        depth = outer;
                        in_arguments &= depth > 0;
                    }
                    None => return false,
                },
                Kind::Dot | Kind::If | Kind::End => return false,
                // `max(x, y)` is a function.
                Kind::Comma if depth == 1 && in_arguments => return false,
                _ if depth > 0 => {}
                Kind::Comma | Kind::Semicolon => return false,
                Kind::Colon => {
                    bodies -= 1;
                    if bodies == 0 {
                        return true;
                    }
                }
                kind if comparison(kind).is_some() => return false,
                Kind::Ident => {
                    bodies += usize::from(match AggregateOp::named(self.slice(token)) {
                        Some(AggregateOp::Count) => next.kind == Kind::Colon,
                        Some(_) if next.kind == Kind::Minus => false,
                        Some(AggregateOp::Min | AggregateOp::Max) if next.kind == Kind::LParen => false,
                        Some(_) => self.begins_operand(next),
                        None => false,
                    });
                }
                _ => {}
            }
            at += 1;
        }
        false
    }

    /// Parses an operand. Returns the term and its height.
    fn operand(&mut self) -> Parse<(Term, usize)> {
        let start = self.token();
        let prefix = match start.kind {
            Kind::Minus => Some(Functor::Negate),
            Kind::Ident if self.is_prefix_operator() && self.slice(start) == "bnot" => Some(Functor::BitNot),
            Kind::Ident if self.is_prefix_operator() => Some(Functor::Not),
            _ => None,
        };
        let (kind, height) = match (prefix, start.kind) {
            (Some(functor), _) => self.prefixed(functor)?,
            (None, Kind::LParen) => return self.parenthesis(),
            (None, Kind::Ident) => self.word()?,
            (None, Kind::LBracket) => self.record()?,
            (None, Kind::Dollar) if self.ahead(1).kind == Kind::Ident => self.branch()?,
            (None, Kind::Dollar) => {
                self.bump();
                (TermKind::Functor(Functor::Counter, Vec::new()), 0)
            }
            (None, Kind::At) if self.ahead(1).kind == Kind::Ident => self.call()?,
            (None, _) => (self.constant()?, 0),
        };
        let place = self.place_from(start);
        Ok((Term { kind, place }, height))
    }

    /// `-x`, `-1`, `bnot x`
    fn prefixed(&mut self, functor: Functor) -> Parse<(TermKind, usize)> {
        let outside = self.nesting;
        let start = self.bump();
        let number = self.token();
        let powered = self.infix(self.ahead(1)) == Some(Functor::Power);
        if functor == Functor::Negate && !powered {
            let negative = match number.kind {
                Kind::Number => Some(TermKind::Number(-self.number(number))),
                Kind::Float => Some(TermKind::Float(format!("-{}", self.slice(number)))),
                _ => None,
            };
            if let Some(kind) = negative {
                self.bump();
                return Ok((kind, 0));
            }
        }
        self.deeper()?;
        // An operand may have a sign itself; only `^` binds more tightly.
        let tighter = Functor::Power.precedence().unwrap_or(0);
        let (operand, height) = self.expression(tighter)?;
        self.nesting = outside;
        let height = self.higher(start, height)?;
        Ok((TermKind::Functor(functor, vec![operand]), height))
    }

    /// `(x + y)`
    fn parenthesis(&mut self) -> Parse<(Term, usize)> {
        let outside = self.nesting;
        self.deeper()?;
        self.bump();
        let inner = self.expression(0)?;
        if !self.eat(Kind::RParen) {
            return Err(self.expected("`)`"));
        }
        self.nesting = outside;
        Ok(inner)
    }

    /// `x`, `cat(x, y)`, `count : { .. }`
    fn word(&mut self) -> Parse<(TermKind, usize)> {
        let start = self.token();
        let word = self.slice(start);
        let applied = self.ahead(1).kind == Kind::LParen;
        if self.is_aggregate() {
            return Ok((self.aggregate()?, 0));
        }
        if word == "nil" {
            self.bump();
            return Ok((TermKind::Functor(Functor::Pack, Vec::new()), 0));
        }
        if self.ahead(1).kind == Kind::LBracket {
            let help = "write `[x, y]`: the column determines the type; elsewhere, write `as([x, y], Pair)`";
            return Err(self.unsupported(self.span(start), "names before records (`Pair[...]`) are", help));
        }
        if !applied {
            self.bump();
            return Ok((TermKind::Variable(word.to_owned()), 0));
        }
        if word == "as" {
            return self.cast();
        }
        match Functor::function(word) {
            Some(functor) => self.function(functor),
            None => Err(self.unknown_function(start)),
        }
    }

    /// Reports a name before `(` that is no functor.
    fn unknown_function(&mut self, name: Token) -> Reported {
        let word = self.slice(name);
        if AggregateOp::named(word).is_some() {
            return self.applied_aggregate(name);
        }
        if let Some((_, help)) = FOREIGN_FUNCTORS.iter().find(|(foreign, _)| *foreign == word) {
            return self.unsupported(self.span(name), &format!("the functor `{word}` is"), help);
        }
        let help = match word {
            _ if is_macro_name(word) => {
                "if it is a macro, include the file that defines it; the reference lists the functors"
            }
            _ if word.starts_with(|first: char| first.is_ascii_uppercase()) => {
                "if it is a predicate, close the atom before it: literals are separated, as in `IsCar(X), IsBus(X)`; \
                 if it is a macro, include the file that defines it"
            }
            _ => "an argument is a variable, a constant, `_` or an expression; the reference lists the functors",
        };
        let fault = Diagnostic::new(codes::UNKNOWN_FUNCTOR, format!("there is no functor `{word}`"));
        self.faults.push(fault.at(self.span(name), "").help(help));
        Reported
    }

    /// Returns whether an aggregate of literals in function notation begins here: `count(A(x))`.
    pub(super) fn is_applied_aggregate(&self) -> bool {
        let is_aggregate = |token| AggregateOp::named(self.slice(token)).is_some();
        // In `min(sum (x) : { A(x) }, y)`, the first argument is an aggregate and no atom.
        let is_atom = self.is_atom_ahead(2) && !is_aggregate(self.ahead(2));
        is_aggregate(self.token()) && self.ahead(1).kind == Kind::LParen && is_atom
    }

    /// Reports an aggregate in function notation: `count(x)`, `sum(x : A(x))`. `name` is its name.
    pub(super) fn applied_aggregate(&mut self, name: Token) -> Reported {
        let word = self.slice(name);
        let body = match name.start == self.token().start && self.is_atom_ahead(2) {
            true => self.arguments_of(name).join(", "),
            false => String::new(),
        };
        let help = match word {
            "count" if !body.is_empty() => {
                // Between commas, a comparison is missing, too.
                let after = self.after_parenthesis(1);
                let alone = after.is_none_or(|after| matches!(after.kind, Kind::Comma | Kind::Semicolon | Kind::Dot));
                let bound = self.at == 0 || !matches!(self.previous().kind, Kind::Equal | Kind::Less | Kind::Greater);
                let compared = if alone && bound { " > 0" } else { "" };
                format!("write `count : {{ {body} }}{compared}`")
            }
            "count" => "write it before a body: `n = count : { A(x, y) }`".to_owned(),
            _ if !body.is_empty() => format!("name the value: `n = {word} y : {{ {body} }}`"),
            _ => format!("write it before a body: `n = {word} y : {{ A(x, y) }}`"),
        };
        let fault = Diagnostic::new(codes::SYNTAX, format!("`{word}` is not a function"));
        self.faults.push(fault.at(self.span(name), "").help(help));
        Reported
    }

    /// Reports an aggregate in the notation of answer set programming: `#count{x : A(x)}`.
    fn asp_aggregate(&mut self) -> Reported {
        let (hash, word) = (self.token(), self.ahead(1));
        let name = self.slice(word);
        let body = |from: usize| {
            let rest = &self.text[from..];
            rest.split_once('}')
                .and_then(|(inside, _)| inside.split_once('{'))
                .map(|(_, inside)| inside)
        };
        let parts = body(word.end as usize).and_then(|inside| inside.split_once(':'));
        let help = match (name, parts) {
            ("count", Some((_, body))) if !body.contains('\n') => format!("write `count : {{ {} }}`", body.trim()),
            ("count", _) => "write `count : { A(x, y) }`".to_owned(),
            (_, Some((value, body))) if !body.contains('\n') => {
                let value = value.split(',').next().unwrap_or_default().trim();
                format!("write `{name} {value} : {{ {} }}`", body.trim())
            }
            _ => format!("write `{name} y : {{ A(x, y) }}`"),
        };
        let fault = Diagnostic::new(codes::SYNTAX, format!("`#{name}` is not an aggregate of this language"));
        let span = self.span(hash).to(self.span(word));
        self.faults.push(fault.at(span, "").help(help));
        Reported
    }

    /// `_`, `1`, `"text"`
    fn constant(&mut self) -> Parse<TermKind> {
        let token = self.token();
        if token.kind == Kind::Hash && self.ahead(1).kind == Kind::Ident && !self.ahead(1).first_on_line {
            return Err(self.asp_aggregate());
        }
        let foreign = match token.kind {
            Kind::At if self.ahead(1).kind == Kind::At => Some((
                "user-defined aggregates (`@@`) are",
                "derive all values, and combine them in the caller",
            )),
            _ => None,
        };
        if let Some((foreign, help)) = foreign {
            return Err(self.unsupported(self.span(token), foreign, help));
        }
        let kind = match token.kind {
            Kind::Underscore => TermKind::Wildcard,
            Kind::Number => TermKind::Number(self.number(token)),
            Kind::Address => TermKind::Address(self.address(token)),
            Kind::Unsigned => TermKind::Unsigned(u64::try_from(self.number(token)).unwrap_or(0)),
            Kind::Float => TermKind::Float(self.slice(token).to_owned()),
            Kind::String => TermKind::Symbol(self.unescape(token)),
            // The lexer has reported it.
            Kind::Faulty | Kind::OpenString => return Err(Reported),
            Kind::Dot if self.is_bare_fraction() => return Err(self.bare_fraction()),
            _ => return Err(self.expected("an argument: a variable, a constant, `_` or an expression")),
        };
        self.bump();
        Ok(kind)
    }

    /// `cat(x, y)`
    fn function(&mut self, functor: Functor) -> Parse<(TermKind, usize)> {
        let start = self.token();
        let outside = self.nesting;
        self.deeper()?;
        self.bump();
        self.bump();
        let mut arguments = Vec::new();
        let mut height = 0;
        if !self.eat(Kind::RParen) {
            loop {
                let (argument, own) = self.expression(0)?;
                arguments.push(argument);
                height = height.max(own);
                if self.eat(Kind::RParen) {
                    break;
                }
                if self.kind() == Kind::Colon && AggregateOp::ALL.into_iter().any(|op| op.name() == functor.name()) {
                    return Err(self.applied_aggregate(start));
                }
                if !self.eat(Kind::Comma) {
                    return Err(self.expected("`,` or `)`"));
                }
            }
        }
        self.nesting = outside;
        let (least, most) = functor.arity();
        if arguments.len() < least || arguments.len() > most {
            let wanted = match (least, most) {
                (1, 1) => "1 argument".to_owned(),
                (least, most) if least == most => format!("{least} arguments"),
                (least, most) => format!("{least} to {most} arguments"),
            };
            let message = format!("`{}` takes {wanted}, not {}", functor.name(), arguments.len());
            let place = self.place_from(start).0;
            self.faults
                .push(Diagnostic::new(codes::ARITY_MISMATCH, message).at(place, ""));
            return Err(Reported);
        }
        let height = self.higher(start, height)?;
        Ok((TermKind::Functor(functor, arguments), height))
    }

    /// `[x, y]`
    fn record(&mut self) -> Parse<(TermKind, usize)> {
        let start = self.token();
        let outside = self.nesting;
        self.deeper()?;
        self.bump();
        let branch = Term {
            kind: TermKind::Symbol(String::new()),
            place: self.place_from(start),
        };
        let (fields, height) = self.fields_of(branch, Kind::RBracket, "`,` or `]`")?;
        self.nesting = outside;
        let height = self.higher(start, height)?;
        Ok((TermKind::Functor(Functor::Pack, fields), height))
    }

    /// `$Circle(r)`, `$Point`
    fn branch(&mut self) -> Parse<(TermKind, usize)> {
        let start = self.bump();
        let outside = self.nesting;
        self.deeper()?;
        let name = self.qualified("a branch")?;
        let branch = Term {
            kind: TermKind::Symbol(name.text),
            place: name.place,
        };
        let (fields, height) = match self.eat(Kind::LParen) {
            true => self.fields_of(branch, Kind::RParen, "`,` or `)`")?,
            false => (vec![branch], 0),
        };
        self.nesting = outside;
        let height = self.higher(start, height)?;
        Ok((TermKind::Functor(Functor::Pack, fields), height))
    }

    /// `@f(x, y)`
    fn call(&mut self) -> Parse<(TermKind, usize)> {
        let start = self.bump();
        let outside = self.nesting;
        self.deeper()?;
        let name = self.name("a functor")?;
        let name = Term {
            kind: TermKind::Symbol(name.text),
            place: name.place,
        };
        self.wanted(Kind::LParen, "`(` and the arguments of the functor")?;
        let (arguments, height) = self.fields_of(name, Kind::RParen, "`,` or `)`")?;
        self.nesting = outside;
        let height = self.higher(start, height)?;
        Ok((TermKind::Functor(Functor::Call, arguments), height))
    }

    /// Parses the fields of a record up to the token that closes them. Returns them behind the branch, and their height.
    fn fields_of(&mut self, branch: Term, close: Kind, ends: &str) -> Parse<(Vec<Term>, usize)> {
        let mut fields = vec![branch];
        let mut height = 0;
        if self.eat(close) {
            return Ok((fields, height));
        }
        loop {
            let (field, own) = self.expression(0)?;
            fields.push(field);
            height = height.max(own);
            if self.eat(close) {
                return Ok((fields, height));
            }
            if !self.eat(Kind::Comma) {
                return Err(self.expected(ends));
            }
        }
    }

    /// `as(x, type)`
    fn cast(&mut self) -> Parse<(TermKind, usize)> {
        let start = self.token();
        let outside = self.nesting;
        self.deeper()?;
        self.bump();
        self.bump();
        let (term, height) = self.expression(0)?;
        if !self.eat(Kind::Comma) {
            return Err(self.expected("`,` and a type"));
        }
        let ty = self.qualified("a type")?;
        if !self.eat(Kind::RParen) {
            return Err(self.expected("`)`"));
        }
        self.nesting = outside;
        let height = self.higher(start, height)?;
        Ok((TermKind::Cast(Box::new(term), ty), height))
    }

    /// `sum x : { A(x) }`, `count : A(_)`
    fn aggregate(&mut self) -> Parse<TermKind> {
        let outside = self.nesting;
        self.deeper()?;
        let word = self.bump();
        let op = AggregateOp::ALL.into_iter().find(|op| op.name() == self.slice(word));
        let op = op.unwrap_or(AggregateOp::Count);
        let is_applied = |after: Token| after.kind != Kind::Colon && self.infix(after).is_none();
        if op != AggregateOp::Count && self.kind() == Kind::LParen && self.after_parenthesis(0).is_some_and(is_applied)
        {
            // Back to the name, where its arguments are found.
            self.at -= 1;
            return Err(self.applied_aggregate(word));
        }
        let target = if op == AggregateOp::Count {
            None
        } else {
            Some(self.term()?)
        };
        if !self.eat(Kind::Colon) {
            return Err(self.expected("`:` and what to aggregate over: `{ ... }`"));
        }
        let body = if self.eat(Kind::LBrace) {
            let body = self.disjunction()?;
            if !self.eat(Kind::RBrace) {
                return Err(self.expected("`,`, `;` or `}`"));
            }
            body
        } else {
            vec![Literal::Atom {
                negated: false,
                atom: self.atom("`(`")?,
            }]
        };
        self.nesting = outside;
        Ok(TermKind::Aggregate(Box::new(Aggregate { op, target, body })))
    }

    /// Returns whether a fraction without its first digit begins at the current token: `.8`.
    pub(super) fn is_bare_fraction(&self) -> bool {
        let (dot, digits) = (self.token(), self.ahead(1));
        dot.kind == Kind::Dot && digits.kind == Kind::Number && dot.end == digits.start
    }

    /// Reports a fraction without its first digit, and skips it.
    pub(super) fn bare_fraction(&mut self) -> Reported {
        let dot = self.bump();
        let digits = self.bump();
        let span = self.span(dot).to(self.span(digits));
        let number = format!("0.{}", self.slice(digits));
        let fault = Diagnostic::new(codes::SYNTAX, "a number begins with a digit").at(span, "");
        let fault = fault.help(format!("write `{number}`"));
        self.faults
            .push(fault.fix(format!("write `{number}`"), [(span, number)]));
        Reported
    }

    /// Reports that `what` is missing at a comma within a number, `0,8`, whose first token is `whole`.
    pub(super) fn decimal_comma(&mut self, what: &str, whole: Token, fraction: Token) -> Reported {
        let number = format!("{}.{}", self.slice(whole), self.slice(fraction));
        let help = format!("a number has a decimal point, not a comma: `{number}`");
        self.expected_with(what, Some(&help))
    }

    /// Returns the value of a number. A value outside the range of every type counts as 0, after a report.
    pub(super) fn number(&mut self, token: Token) -> i128 {
        let text = self.slice(token);
        let text = text.strip_suffix('u').unwrap_or(text);
        let (digits, radix) = match text.get(..2) {
            Some("0x") => (&text[2..], 16),
            Some("0b") => (&text[2..], 2),
            _ => (text, 10),
        };
        let mut value: i128 = 0;
        for digit in digits.chars() {
            match digit.to_digit(radix) {
                Some(digit) => value = (value * i128::from(radix) + i128::from(digit)).min(1 << 80),
                None => return 0, // The lexer has reported it.
            }
        }
        if value > i128::from(u64::MAX) {
            let fault = Diagnostic::new(diag::codes::LIMIT_EXCEEDED, "number out of range")
                .at(self.span(token), "")
                .note(format!("no number is greater than {}", u64::MAX));
            self.faults.push(fault);
            return 0;
        }
        value
    }

    /// Returns an IPv4 address. A faulty one counts as 0.0.0.0, after a report.
    fn address(&mut self, token: Token) -> Ipv4Addr {
        self.slice(token).parse().unwrap_or_else(|_| {
            let fault = Diagnostic::new(codes::SYNTAX, "not an IPv4 address").at(self.span(token), "");
            self.faults
                .push(fault.help("write four numbers from 0 to 255 without leading zeros"));
            Ipv4Addr::UNSPECIFIED
        })
    }
}
