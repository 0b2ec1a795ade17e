//! Prolog text as clauses: the notation that Popper's tasks use, without functions of Prolog that they do not need.

use crate::datalog::codes;
use crate::diag::{self, Diagnostic, Faults, SourceId, Sources, Span};
use crate::popper::tokens::{Token, is_word, tokens};
use std::fmt;

/// How deep terms may be nested.
const DEPTH_MAX: usize = 100;

/// A term with its place.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Term {
    pub kind: Kind,
    pub span: Span,
}

/// What a term is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Kind {
    Variable(String),
    /// An atom, a number or a string, as Prolog prints it with quotes where needed.
    Constant(String),
    /// A name, as Prolog prints it, with arguments.
    Compound(String, Vec<Term>),
    /// Terms in parentheses, as in `type(f,(train,))`.
    Tuple(Vec<Term>),
}

/// A literal of a body.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Literal {
    Atom {
        is_negated: bool,
        atom: Term,
    },
    Comparison {
        left: Term,
        operator: &'static str,
        right: Term,
    },
}

/// A fact, a rule or a directive.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Clause {
    /// `None` for a directive.
    pub head: Option<Term>,
    pub body: Vec<Literal>,
    pub span: Span,
}

/// What the text of a directive may contain.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Directives {
    /// Goals of Prolog.
    Goals,
    /// Integrity constraints of answer set programs, which the parser skips: their clauses have neither head nor body.
    Constraints,
}

/// The comparisons that rules can use.
const COMPARISONS: [&str; 10] = ["=", "\\=", "==", "\\==", "<", ">", "=<", ">=", "=:=", "=\\="];

/// The comparisons of answer set programs.
const COMPARISONS_OF_CONSTRAINTS: [&str; 6] = ["=", "!=", "<", ">", "<=", ">="];

/// Operators with a meaning that function-free rules do not have, and its name.
const OPERATORS: [(&str, &str); 19] = [
    ("is", "arithmetic"),
    ("+", "arithmetic"),
    ("-", "arithmetic"),
    ("*", "arithmetic"),
    ("/", "arithmetic"),
    ("//", "arithmetic"),
    ("mod", "arithmetic"),
    (";", "a disjunction"),
    ("->", "an if-then-else"),
    ("!", "a cut"),
    ("-->", "a grammar rule"),
    ("=..", "a term constructor"),
    ("^", "a quantifier"),
    ("#=", "a constraint between integers"),
    ("#\\=", "a constraint between integers"),
    ("#<", "a constraint between integers"),
    ("#>", "a constraint between integers"),
    ("#=<", "a constraint between integers"),
    ("#>=", "a constraint between integers"),
];

/// Reads the clauses of a text. Reports all faults, and continues after each at the next clause.
pub fn parse(sources: &Sources, source: SourceId, directives: Directives, faults: &mut Faults) -> Vec<Clause> {
    let text = sources.text(source);
    let mut parser = Parser {
        tokens: tokens(text, source),
        at: 0,
        end: Span::new(source, text.len()..text.len()),
        comparisons: match directives {
            Directives::Goals => &COMPARISONS,
            Directives::Constraints => &COMPARISONS_OF_CONSTRAINTS,
        },
    };
    let mut clauses = Vec::new();
    while parser.at < parser.tokens.len() && !faults.full() {
        match parser.clause(directives) {
            Ok(clause) => clauses.push(clause),
            Err(fault) => {
                faults.push(fault);
                parser.skip();
            }
        }
    }
    clauses
}

/// Returns an atom as Prolog prints it with quotes where needed.
fn print_atom(name: &str) -> String {
    let is_plain = name.starts_with(|c: char| c.is_alphabetic() && !c.is_uppercase()) && name.chars().all(is_word);
    match is_plain {
        true => name.to_owned(),
        false => format!("'{}'", escape(name).replace('\'', "\\'")),
    }
}

impl Term {
    /// Returns whether the term has no variables.
    pub fn is_ground(&self) -> bool {
        match &self.kind {
            Kind::Variable(_) => false,
            Kind::Constant(_) => true,
            Kind::Compound(_, terms) | Kind::Tuple(terms) => terms.iter().all(Term::is_ground),
        }
    }
}

impl fmt::Display for Term {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let list = |terms: &[Term]| terms.iter().map(Term::to_string).collect::<Vec<_>>().join(",");
        match &self.kind {
            Kind::Variable(name) | Kind::Constant(name) => f.write_str(name),
            Kind::Compound(name, terms) => write!(f, "{name}({})", list(terms)),
            Kind::Tuple(terms) => write!(f, "({},)", list(terms)),
        }
    }
}

fn escape(content: &str) -> String {
    content.replace('\\', "\\\\").replace('\n', "\\n").replace('\t', "\\t")
}

struct Parser {
    tokens: Vec<(Token, Span)>,
    at: usize,
    /// The end of the text.
    end: Span,
    comparisons: &'static [&'static str],
}

impl Parser {
    fn peek(&self) -> Option<&Token> {
        self.tokens.get(self.at).map(|(token, _)| token)
    }

    fn span(&self) -> Span {
        self.tokens.get(self.at).map_or(self.end, |(_, span)| *span)
    }

    fn takes(&mut self, wanted: &Token) -> bool {
        let found = self.peek() == Some(wanted);
        self.at += usize::from(found);
        found
    }

    fn takes_name(&mut self, name: &str) -> bool {
        let found = matches!(self.peek(), Some(Token::Name(found, false)) if found == name);
        self.at += usize::from(found);
        found
    }

    /// Continues after the next full stop.
    fn skip(&mut self) {
        while self.at < self.tokens.len() && !self.takes(&Token::End) {
            self.at += 1;
        }
    }

    /// The fault at the next token.
    fn unexpected(&self, expected: &str) -> Diagnostic {
        let span = self.span();
        match self.peek() {
            Some(Token::Fault(message)) => Diagnostic::new(codes::SYNTAX, *message).at(span, ""),
            Some(Token::Mark('[' | '{')) => unsupported(span, "a list"),
            Some(Token::Name(name, false)) if OPERATORS.iter().any(|(operator, _)| operator == name) => {
                let meaning = OPERATORS.iter().find(|(operator, _)| operator == name);
                unsupported(span, meaning.map_or("this operator", |(_, meaning)| meaning))
            }
            found => {
                let found = if found.is_some() {
                    ""
                } else {
                    ", found the end of the text"
                };
                Diagnostic::new(codes::SYNTAX, format!("expected {expected}{found}"))
                    .at(span, format!("expected {expected}"))
            }
        }
    }

    fn clause(&mut self, directives: Directives) -> Result<Clause, Diagnostic> {
        let start = self.span();
        let mut clause = Clause {
            head: None,
            body: Vec::new(),
            span: start,
        };
        if !self.takes_name(":-") {
            let head = self.term(0)?;
            if !matches!(head.kind, Kind::Compound(..) | Kind::Constant(_)) {
                let fault = Diagnostic::new(codes::SYNTAX, "a clause begins with a predicate");
                return Err(fault.at(head.span, "not a predicate"));
            }
            clause.head = Some(head);
            if self.takes_name(":-") {
                clause.body = self.body()?;
            }
        } else if directives == Directives::Constraints {
            while self.at < self.tokens.len() && self.peek() != Some(&Token::End) {
                self.at += 1;
            }
        } else {
            clause.body = self.directive()?;
        }
        let last = self.span();
        if !self.takes(&Token::End) {
            return Err(self.unexpected("`.`"));
        }
        clause.span = start.to(last);
        Ok(clause)
    }

    /// Reads the goal of a directive. Of its arguments, it keeps the predicates, as in `:- dynamic f/1, g/2.`
    fn directive(&mut self) -> Result<Vec<Literal>, Diagnostic> {
        let span = self.span();
        let Some(Token::Name(name, _)) = self.peek() else {
            return Err(self.unexpected("a goal"));
        };
        let (name, mut predicates) = (name.clone(), Vec::new());
        while self.at < self.tokens.len() && self.peek() != Some(&Token::End) {
            if let Some(Token::Fault(_)) = self.peek() {
                return Err(self.unexpected("a goal"));
            }
            self.at += 1;
            if let [
                (Token::Name(name, _), start),
                (Token::Name(slash, false), _),
                (Token::Number(arity), end),
                ..,
            ] = &self.tokens[self.at..]
                && slash == "/"
            {
                let term = |text: String| Term {
                    kind: Kind::Constant(text),
                    span: start.to(*end),
                };
                predicates.push(Term {
                    kind: Kind::Tuple(vec![term(print_atom(name)), term(arity.clone())]),
                    span: start.to(*end),
                });
            }
        }
        let kind = Kind::Compound(name, predicates);
        let atom = Term { kind, span };
        Ok(vec![Literal::Atom {
            is_negated: false,
            atom,
        }])
    }

    fn body(&mut self) -> Result<Vec<Literal>, Diagnostic> {
        let mut body = vec![self.literal()?];
        while self.takes(&Token::Mark(',')) {
            body.push(self.literal()?);
        }
        Ok(body)
    }

    fn literal(&mut self) -> Result<Literal, Diagnostic> {
        let span = self.span();
        let is_negated = self.takes_name("\\+");
        let left = self.term(0)?;
        if let Some(Token::Name(name, false)) = self.peek()
            && let Some(operator) = self.comparisons.iter().find(|operator| *operator == name)
        {
            self.at += 1;
            let right = self.term(0)?;
            return match is_negated {
                true => Err(unsupported(span.to(right.span), "a negated comparison")),
                false => Ok(Literal::Comparison { left, operator, right }),
            };
        }
        if let Some(Token::Name(..)) = self.peek() {
            return Err(self.unexpected("`,` or `.`"));
        }
        match left.kind {
            Kind::Compound(name, mut terms) if name == "not" && terms.len() == 1 && !is_negated => {
                let atom = terms.remove(0);
                Ok(Literal::Atom { is_negated: true, atom })
            }
            Kind::Compound(..) | Kind::Constant(_) => Ok(Literal::Atom { is_negated, atom: left }),
            Kind::Tuple(_) => Err(unsupported(left.span, "a group of goals")),
            Kind::Variable(_) => Err(unsupported(left.span, "a variable as a goal")),
        }
    }

    fn term(&mut self, depth: usize) -> Result<Term, Diagnostic> {
        let start = self.span();
        if depth > DEPTH_MAX {
            let message = format!("terms are nested more than {DEPTH_MAX} levels deep");
            return Err(Diagnostic::new(diag::codes::LIMIT_EXCEEDED, message).at(start, ""));
        }
        let Some(token) = self.peek().cloned() else {
            return Err(self.unexpected("a term"));
        };
        self.at += 1;
        let kind = match token {
            Token::Variable(name) => Kind::Variable(name),
            Token::Number(text) => Kind::Constant(text),
            Token::Text(content) => Kind::Constant(format!("\"{}\"", escape(&content).replace('"', "\\\""))),
            Token::Mark('(') => Kind::Tuple(self.terms(depth)?),
            Token::Name(name, false) if name == "-" => match self.peek() {
                Some(Token::Number(text)) if start.end == self.span().start => {
                    let kind = Kind::Constant(if text == "0" { text.clone() } else { format!("-{text}") });
                    self.at += 1;
                    kind
                }
                _ => {
                    self.at -= 1;
                    return Err(self.unexpected("a term"));
                }
            },
            Token::Name(name, is_quoted) if is_quoted || name.starts_with(is_word) => {
                let adjacent = start.end == self.span().start;
                if adjacent && self.takes(&Token::Mark('(')) {
                    Kind::Compound(print_atom(&name), self.terms(depth)?)
                } else {
                    Kind::Constant(print_atom(&name))
                }
            }
            _ => {
                self.at -= 1;
                return Err(self.unexpected("a term"));
            }
        };
        let last = self.tokens[self.at - 1].1;
        Ok(Term {
            kind,
            span: start.to(last),
        })
    }

    /// Reads terms up to the closing parenthesis. A comma may follow the last one.
    fn terms(&mut self, depth: usize) -> Result<Vec<Term>, Diagnostic> {
        let mut terms = Vec::new();
        loop {
            if !terms.is_empty() && self.takes(&Token::Mark(')')) {
                return Ok(terms);
            }
            terms.push(self.term(depth + 1)?);
            if self.takes(&Token::Mark(',')) {
                continue;
            }
            if !self.takes(&Token::Mark(')')) {
                return Err(self.unexpected("`,` or `)`"));
            }
            return Ok(terms);
        }
    }
}

/// The fault of Prolog beyond function-free rules.
pub fn unsupported(span: Span, what: &str) -> Diagnostic {
    Diagnostic::new(codes::UNSUPPORTED, format!("{what} is not supported"))
        .at(span, "")
        .note("a task is one target, with facts and rules about constants: no lists, functions or arithmetic")
}
