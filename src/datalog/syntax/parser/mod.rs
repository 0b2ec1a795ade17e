//! The parser: from tokens to a syntax tree.
//!
//! The parser never fails. It reports a fault, drops the faulty clause or directive, and resumes at the next one. Where
//! it understood the declared name it keeps the item, so that no use of the name counts as unknown. The nesting of
//! parentheses and braces and the height of expressions are bounded, so no input exhausts the stack. The parser visits
//! each token a bounded number of times.

use crate::codes;
use crate::diag::{self, Diagnostic, Faults, SourceId, Span};

use crate::syntax::ast::BaseType;
use crate::syntax::ast::{File, Include, Item, Literal, Name, Place};
use crate::syntax::lexer;
use crate::syntax::lexer::{COMMENT, CONJUNCTION, DISJUNCTION, DocLine, IMPLICATION, Kind, Lexed, NEGATION, Token};
use crate::syntax::packed::PackedFacts;
use std::collections::HashSet;
use std::ops::RangeInclusive;

mod clause;
mod directive;
mod expression;
mod temporal;

pub(crate) use clause::negate;

/// Maximum number of enclosing negations, parentheses and braces.
const MAX_NESTING: usize = 64;

/// Maximum number of tokens between the parentheses of a macro without a definition.
const MAX_MACRO: usize = 4096;

/// The names of all directives, without the dot.
pub const DIRECTIVES: &[&str] = &[
    "decl",
    "type",
    "symbol_type",
    "number_type",
    "input",
    "output",
    "printsize",
    "limitsize",
    "pragma",
    "plan",
    "include",
    "once",
    "scope",
    "comp",
    "init",
    "override",
    "functor",
    "disjoint",
    "implies",
    "covering",
    "reflexive",
    "irreflexive",
    "symmetric",
    "asymmetric",
];

/// Help for what only the C preprocessor understands.
const EXPAND: &str = "`check`, `query` and `repl` follow them without the option `--no-preprocessor`; `fmt` formats no file that has them";

/// Help for lattices.
const LATTICES: &str = "derive all values, and choose among them with `min` or `max` in another predicate";

/// Returns whether a token of this kind can be the last one of a literal.
fn ends_literal(kind: Kind) -> bool {
    use Kind::{
        Address, Dot, Faulty, Float, Ident, Number, OpenString, RBrace, RBracket, RParen, String, Underscore, Unsigned,
    };
    matches!(
        kind,
        RParen
            | RBrace
            | RBracket
            | Ident
            | Underscore
            | Number
            | Unsigned
            | Float
            | Address
            | String
            | OpenString
            | Faulty
            | Dot
    )
}

/// Help for temporal operators that look ahead.
const PAST: &str = "temporal operators are about the past: `P(x) since[0,9] Q(x)`, `once[0,9] P(x)`";

/// Help where only the full stop of a clause is missing.
pub const FULL_STOP: &str = "a clause ends with a full stop";

/// Directives of Soufflé that this language does not have, with their descriptions.
const FOREIGN_DIRECTIVES: &[(&str, &str)] = &[("lattice", "lattices (`.lattice`)")];

/// Type directives of older Soufflé versions, with the supertype they imply.
const OLD_TYPES: &[(&str, BaseType)] = &[("symbol_type", BaseType::Symbol), ("number_type", BaseType::Number)];

/// Parses one source.
pub(crate) fn parse(source: SourceId, text: &str, faults: &mut Faults) -> File {
    let lexed = lexer::lex(source, text, faults);
    parse_tokens(source, text, &lexed, faults).0
}

/// Parses one source. Facts of plain constants are apart from the other items.
pub(crate) fn parse_packed(source: SourceId, text: &str, faults: &mut Faults) -> (File, PackedFacts) {
    let lexed = lexer::lex(source, text, faults);
    let mut parser = Parser::new(source, text, &lexed, faults);
    parser.packed = Some(PackedFacts::new(source));
    let file = parser.file();
    (file, parser.packed.unwrap_or_else(|| PackedFacts::new(source)))
}

/// Parses a lexed source. Returns the tree and, for each item, the index of its first token.
pub(crate) fn parse_tokens(source: SourceId, text: &str, lexed: &Lexed, faults: &mut Faults) -> (File, Vec<usize>) {
    let mut parser = Parser::new(source, text, lexed, faults);
    let file = parser.file();
    (file, parser.starts)
}

/// Parses the body of a query: `?- A(x), x > 1.` The leading `?-` and the full stop are optional.
pub(crate) fn parse_question(source: SourceId, text: &str, faults: &mut Faults) -> Option<(Vec<Literal>, Place)> {
    let lexed = lexer::lex(source, text, faults);
    let mut parser = Parser::new(source, text, &lexed, faults);
    parser.question().ok()
}

/// Marks a fault that the parser has reported; the caller abandons the current construct.
struct Reported;

type Parse<T> = Result<T, Reported>;

struct Parser<'a> {
    source: SourceId,
    text: &'a str,
    tokens: &'a [Token],
    docs: &'a [DocLine],
    next_doc: usize,
    at: usize,
    /// The index of the first token of each item; empty while facts are packed.
    starts: Vec<usize>,
    /// The number of parentheses, braces and negations around the current token.
    nesting: usize,
    /// The words of negation, `Not` and `not`, without those that the source declares as predicates.
    negations: Vec<&'static str>,
    /// The strings without a closing quote, in order. Each runs from the first token of its line to its own.
    open_strings: Vec<RangeInclusive<usize>>,
    /// The tokens `::`, in order, each with the `.` or `:-` before it.
    draws: Vec<(usize, Option<usize>)>,
    /// The marks that the qualifiers of the last declaration imply.
    marks: Vec<Item>,
    /// Whether the last clause was faulty.
    dropped: bool,
    /// The number of components around the current token.
    components: usize,
    /// The predicates that the source declares; `None` until a use of a macro may stand in place of a clause.
    declared: Option<HashSet<&'a str>>,
    /// Takes the facts of plain constants, if present.
    packed: Option<PackedFacts>,
    faults: &'a mut Faults,
}

/// Returns whether a name is written as those of macros usually are.
fn is_macro_name(name: &str) -> bool {
    name.len() > 1
        && name.contains(|c: char| c.is_ascii_uppercase())
        && !name.contains(|c: char| c.is_ascii_lowercase())
}

/// Returns the words that write negation in a source: `Not` and `not`, unless a `.decl` there declares them.
fn negations(text: &str, tokens: &[Token]) -> Vec<&'static str> {
    let word = |token: &Token| &text[token.start as usize..token.end as usize];
    let declares = |name: &str| {
        tokens.windows(2).enumerate().any(|(at, pair)| {
            let declared = tokens[at + 2..]
                .iter()
                .take_while(|token| matches!(token.kind, Kind::Ident | Kind::Comma));
            pair[0].kind == Kind::Dot
                && word(&pair[1]) == "decl"
                && declared.into_iter().any(|token| word(token) == name)
        })
    };
    ["Not", "not"].into_iter().filter(|name| !declares(name)).collect()
}

/// Finds the strings without a closing quote, each with the tokens before it on its line.
fn open_strings(tokens: &[Token]) -> Vec<RangeInclusive<usize>> {
    let mut found = Vec::new();
    let mut line = 0;
    for (at, token) in tokens.iter().enumerate() {
        if token.first_on_line {
            line = at;
        }
        if token.kind == Kind::OpenString {
            found.push(line..=at);
        }
    }
    found
}

/// Finds the tokens `::`, each with the last token before it that ends a head.
fn draws(tokens: &[Token]) -> Vec<(usize, Option<usize>)> {
    let mut end = None;
    let mut found = Vec::new();
    for (at, token) in tokens.iter().enumerate() {
        match token.kind {
            Kind::DoubleColon => found.push((at, end)),
            Kind::If | Kind::Dot => end = Some(at),
            _ => {}
        }
    }
    found
}

impl<'a> Parser<'a> {
    fn new(source: SourceId, text: &'a str, lexed: &'a Lexed, faults: &'a mut Faults) -> Self {
        Parser {
            source,
            text,
            tokens: &lexed.tokens,
            docs: &lexed.docs,
            next_doc: 0,
            at: 0,
            starts: Vec::new(),
            nesting: 0,
            negations: negations(text, &lexed.tokens),
            open_strings: open_strings(&lexed.tokens),
            draws: draws(&lexed.tokens),
            marks: Vec::new(),
            dropped: false,
            components: 0,
            declared: None,
            packed: None,
            faults,
        }
    }

    // --- looking at tokens

    fn token(&self) -> Token {
        self.ahead(0)
    }

    fn is_negation(&self, token: Token) -> bool {
        self.negations.contains(&self.slice(token))
    }

    fn kind(&self) -> Kind {
        self.token().kind
    }

    fn ahead(&self, count: usize) -> Token {
        self.tokens[(self.at + count).min(self.tokens.len() - 1)]
    }

    fn bump(&mut self) -> Token {
        let token = self.token();
        self.at = (self.at + 1).min(self.tokens.len() - 1);
        token
    }

    fn eat(&mut self, kind: Kind) -> bool {
        let found = self.kind() == kind;
        if found {
            self.bump();
        }
        found
    }

    fn slice(&self, token: Token) -> &'a str {
        &self.text[token.start as usize..token.end as usize]
    }

    fn span(&self, token: Token) -> Span {
        Span::new(self.source, token.start as usize..token.end as usize)
    }

    fn previous(&self) -> Token {
        self.tokens[self.at.saturating_sub(1)]
    }

    /// Returns the place from the first byte of `start` to the last byte read.
    fn place_from(&self, start: Token) -> Place {
        Place(self.span(start).to(self.span(self.previous())))
    }

    fn indent(&self, token: Token) -> usize {
        let before = &self.text[..token.start as usize];
        before.len() - before.rfind('\n').map_or(0, |newline| newline + 1)
    }

    /// Returns the name of the directive that begins at the current token: a `.` directly followed by a name.
    fn directive_ahead(&self) -> Option<&'a str> {
        let (dot, name) = (self.token(), self.ahead(1));
        (dot.kind == Kind::Dot && name.kind == Kind::Ident && dot.end == name.start).then(|| self.slice(name))
    }

    /// Returns whether a known directive begins at the current token, as opposed to a full stop.
    fn at_known_directive(&self) -> bool {
        self.token().first_on_line
            && self.directive_ahead().is_some_and(|name| {
                DIRECTIVES.contains(&name)
                    || FOREIGN_DIRECTIVES.iter().any(|(foreign, _)| *foreign == name)
                    || OLD_TYPES.iter().any(|(old, _)| *old == name)
            })
    }

    // --- reporting

    fn describe(&self, token: Token) -> String {
        if token.kind == Kind::End {
            return "the end of the file".into();
        }
        let mut text = self.slice(token);
        if token.start == self.token().start && self.at_known_directive() {
            text = self.slice(Token {
                end: self.ahead(1).end,
                ..token
            });
        }
        match text.char_indices().nth(40) {
            Some((cut, _)) => format!("`{}...`", &text[..cut]),
            None => format!("`{text}`"),
        }
    }

    /// Reports that `what` is missing before the current token.
    fn expected(&mut self, what: &str) -> Reported {
        let help = self.habit();
        self.expected_with(what, help)
    }

    /// Reports as [`Parser::expected`] does, with the given help.
    fn expected_with(&mut self, what: &str, help: Option<&str>) -> Reported {
        let token = self.token();
        if token.kind == Kind::Faulty || self.is_before_open_string() {
            return Reported;
        }
        let message = format!("expected {what}, found {}", self.describe(token));
        // At the end of a line the fault belongs behind the previous token.
        let span = if self.at > 0 && (token.first_on_line || token.kind == Kind::End) {
            let end = self.previous().end as usize;
            Span::new(self.source, end..end)
        } else {
            self.span(token)
        };
        let mut fault = Diagnostic::new(codes::SYNTAX, message).at(span, format!("expected {what}"));
        if let Some(help) = help {
            fault = fault.help(help);
        }
        if let Some((title, place, text)) = self.fix_for(help) {
            fault = fault.fix(title, [(place, text.to_owned())]);
        }
        self.faults.push(fault);
        Reported
    }

    /// Returns the change that the help suggests at the current token, with its title.
    fn fix_for(&self, help: Option<&str>) -> Option<(String, Span, &'static str)> {
        let token = self.token();
        let text = match help? {
            FULL_STOP => {
                let end = self.previous().end as usize;
                return Some(("end the clause".to_owned(), Span::new(self.source, end..end), "."));
            }
            CONJUNCTION => ",",
            DISJUNCTION => ";",
            IMPLICATION => ":-",
            NEGATION => "not",
            _ => return None,
        };
        let written = match token.kind {
            Kind::Ident | Kind::Pipe => self.span(token),
            _ => self.span(token).to(self.span(self.ahead(1))),
        };
        Some((format!("replace it with `{text}`"), written, text))
    }

    /// Returns the help for a spelling of another language at the current token.
    fn habit(&self) -> Option<&'static str> {
        let (token, next) = (self.token(), self.ahead(1));
        match (self.slice(token), next.kind) {
            ("and" | "And" | "AND", _) => Some(CONJUNCTION),
            ("or" | "Or" | "OR" | "|", _) => Some(DISJUNCTION),
            ("if" | "If" | "IF", _) | ("<" | ":", Kind::Minus) | (":", Kind::Equal) | ("-", Kind::Greater) => {
                Some(IMPLICATION)
            }
            ("=", Kind::Greater) => Some("the head of a clause comes first: `A(x) :- B(x).`"),
            (">", _) if self.at > 0 && self.previous().kind == Kind::Equal => Some("\"at least\" is written `>=`"),
            ("is", _) => Some("equality is written `=`"),
            ("::", _) if self.at > 0 && self.slice(self.previous()) == "%" => {
                Some("a probability is a number from 0 to 1: `0.3 ::` for 30 percent")
            }
            ("::", _) => Some("a probability stands before the head of its clause: `0.3 :: A(x) :- B(x).`"),
            ("since", after) if after != Kind::LParen && self.at > 0 && self.previous().kind == Kind::RParen => {
                Some("an atom stands before `since`: define a predicate with this condition, `P(x) since Q(x)`")
            }
            ("[", _) if self.at > 0 && matches!(self.slice(self.previous()), "once" | "historically" | "for") => {
                Some("temporal operators stand in bodies")
            }
            (")" | "." | "]" | "}" | ":-", _) if self.at > 0 && self.previous().kind == Kind::Comma => {
                Some("remove the comma, or write what should follow it")
            }
            ("until" | "Until", Kind::Ident | Kind::LBracket) if !token.first_on_line => Some(PAST),
            ("mod" | "MOD", _) => Some("the remainder is written `%`, as in `n % 4 = 3`"),
            _ => self.operator_between_atoms(),
        }
    }

    /// Reports a foreign spelling whose help is `help` where `what` is expected, and skips it.
    fn skip_foreign(&mut self, help: &str, what: &str) -> bool {
        let token = self.token();
        // A name with arguments at the start of a line begins a clause.
        let is_atom = token.first_on_line && self.ahead(1).kind == Kind::LParen;
        if self.habit() != Some(help) || is_atom {
            return false;
        }
        self.expected(what);
        self.bump();
        if token.kind != Kind::Ident && token.kind != Kind::Pipe {
            self.bump();
        }
        true
    }

    /// Returns whether this line has a string without its closing quote at or after the current token. The lexer has
    /// reported it, and it may be the cause of any fault before it.
    fn is_before_open_string(&self) -> bool {
        let next = self.open_strings.partition_point(|line| *line.end() < self.at);
        self.open_strings.get(next).is_some_and(|line| line.contains(&self.at))
    }

    /// Reports that no clause or directive can begin at the current token.
    fn expected_item(&mut self, why: &str) -> Reported {
        let token = self.token();
        if token.kind == Kind::Faulty {
            return Reported;
        }
        let message = format!("expected a clause or a directive{why}, found {}", self.describe(token));
        let mut fault = Diagnostic::new(codes::SYNTAX, message).at(self.span(token), "");
        if matches!((self.slice(token), self.ahead(1).kind), ("%", _) | ("-", Kind::Minus)) {
            fault = fault.help(COMMENT);
        }
        if token.kind == Kind::Bang || matches!(self.slice(token), "Not" | "not") {
            fault = fault.help(
                "clauses derive what holds; negate the atom in the bodies of other clauses, or add the exception to the \
                 bodies of the clauses that derive it",
            );
        }
        if matches!(token.kind, Kind::Number | Kind::Float) && self.slice(self.ahead(1)) == ":" {
            fault = fault.help("two colons follow a probability: `0.3 :: A(x) :- B(x).`");
        }
        self.faults.push(fault);
        Reported
    }

    fn unsupported(&mut self, span: Span, what: &str, help: &str) -> Reported {
        let mut fault = Diagnostic::new(codes::UNSUPPORTED, format!("{what} not supported")).at(span, "");
        if !help.is_empty() {
            fault = fault.help(help);
        }
        self.faults.push(fault);
        Reported
    }

    // --- items

    fn file(&mut self) -> File {
        let mut file = File::default();
        while self.kind() != Kind::End && !self.faults.full() {
            self.next_item(&mut file.items);
        }
        file
    }

    /// Reads an item of the file or of a component, with what belongs to it.
    fn next_item(&mut self, items: &mut Vec<Item>) {
        let start = self.at;
        if self.packed.is_none() {
            self.starts.push(start);
        }
        self.nesting = 0;
        let item = self.item();
        if item.is_err() {
            self.recover(start);
        }
        if !matches!(item, Ok(Some(Item::Plan(_)))) {
            self.dropped = item.is_err();
        }
        if let Ok(item) = item {
            let before = items.len();
            items.extend(item.and_then(|item| match self.components {
                0 => self.unpacked(before, item),
                _ => Some(item),
            }));
            items.append(&mut self.marks);
        }
        debug_assert!(self.at > start || self.kind() == Kind::End, "every item reads a token");
    }

    /// Packs a fact of plain constants, if the caller wants that. Returns any other item.
    fn unpacked(&mut self, before: usize, item: Item) -> Option<Item> {
        match (&mut self.packed, item) {
            (Some(packed), Item::Clause(clause)) => packed.push(before, clause).err().map(Item::Clause),
            (_, item) => Some(item),
        }
    }

    /// Skips to the probable start of the next item.
    fn recover(&mut self, start: usize) {
        loop {
            let token = self.token();
            match token.kind {
                Kind::End => return,
                Kind::Preprocessor if self.at > start => return,
                // The end of the component; a brace within a line ends an aggregate.
                Kind::RBrace if self.components > 0 && token.first_on_line => return,
                Kind::Dot if self.at > start && token.first_on_line && self.directive_ahead().is_some() => return,
                Kind::Dot if self.at > start && self.is_qualifying() => _ = self.bump(),
                Kind::Dot => {
                    self.bump();
                    return;
                }
                Kind::Ident
                    if self.at > start
                        && token.first_on_line
                        && self.ahead(1).kind == Kind::LParen
                        && self.indent(token) <= self.indent(self.tokens[start])
                        && ends_literal(self.previous().kind) =>
                {
                    return;
                }
                _ => {
                    self.bump();
                }
            }
        }
    }

    /// Returns the doc comment directly before the current token and drops earlier ones.
    fn doc(&mut self) -> String {
        let mut text = String::new();
        while let Some(line) = self.docs.get(self.next_doc)
            && line.before as usize <= self.at
        {
            self.next_doc += 1;
            if line.before as usize == self.at {
                let line = self.text[line.start as usize..line.end as usize].trim_end();
                if !text.is_empty() {
                    text.push('\n');
                }
                text.push_str(line.strip_prefix(' ').unwrap_or(line));
            }
        }
        text.truncate(text.trim_end().len());
        text
    }

    fn item(&mut self) -> Parse<Option<Item>> {
        let doc = self.doc();
        let token = self.token();
        match token.kind {
            Kind::Dot => match self.directive_ahead() {
                Some(name) => self.directive(name, doc),
                None if self.is_bare_fraction() && self.ahead(2).kind == Kind::DoubleColon => Err(self.bare_fraction()),
                None => {
                    self.bump();
                    let fault = Diagnostic::new(codes::SYNTAX, "full stop without a clause")
                        .at(self.span(token), "")
                        .note("only clauses end with a full stop; directives such as `.decl` do not");
                    self.faults.push(fault);
                    Ok(None)
                }
            },
            Kind::Ident => match self.directive_without_dot() {
                Some(name) => {
                    let word = self.bump();
                    self.rest_of_directive(name, word, doc)
                }
                None => match self.end_of_macro() {
                    Some(end) => {
                        self.unknown_macro(end);
                        Ok(None)
                    }
                    None => self.clause(doc).map(Some),
                },
            },
            Kind::Bang => Err(self.expected_item(" (a head cannot be negated)")),
            Kind::Hash if self.slice(self.ahead(1)) == "include" && self.ahead(2).kind == Kind::String => {
                self.bump();
                self.bump();
                let file = self.bump();
                Ok(Some(Item::Include(Include {
                    path: self.unescape(file),
                    place: Place(self.span(file)),
                })))
            }
            Kind::Preprocessor => {
                self.bump();
                self.preprocessor(token);
                Ok(None)
            }
            _ if self.is_drawn() => self.clause(doc).map(Some),
            _ => {
                let reported = self.expected_item("");
                self.bump();
                Err(reported)
            }
        }
    }

    /// Returns the position behind the use of a macro that stands in place of a clause and that no `#define` replaced:
    /// `DEBUG(edge)`, where the next clause or directive follows on the next line.
    fn end_of_macro(&mut self) -> Option<usize> {
        let name = self.slice(self.token());
        if !is_macro_name(name) {
            return None;
        }
        let mut end = self.at + 1;
        if self.tokens[end].kind == Kind::LParen {
            let mut depth = 0_usize;
            let rest = self.tokens[end..].iter().take(MAX_MACRO);
            let close = rest.enumerate().find_map(|(ahead, token)| {
                match token.kind {
                    Kind::LParen => depth += 1,
                    Kind::RParen => depth -= 1,
                    _ => {}
                }
                (depth == 0).then_some(ahead)
            })?;
            end += close + 1;
        }
        let next = self.tokens[end];
        let (dot, word) = (next, self.tokens[(end + 1).min(self.tokens.len() - 1)]);
        let is_item = match next.kind {
            Kind::End | Kind::Preprocessor | Kind::RBrace => true,
            Kind::Ident | Kind::Hash => next.first_on_line,
            Kind::Dot => next.first_on_line && word.kind == Kind::Ident && dot.end == word.start,
            _ => false,
        };
        (is_item && !self.declares(name)).then_some(end)
    }

    /// Reports a macro without a definition, and skips its use, which ends at a position.
    fn unknown_macro(&mut self, end: usize) {
        let token = self.token();
        let name = self.slice(token);
        let fault = Diagnostic::new(codes::UNKNOWN_MACRO, format!("no macro `{name}` is defined"));
        let fault = fault.at(self.span(token), "").help(format!(
            "include the file that defines it, or define it: `#define {name}`; if it is a predicate, a full stop is \
             missing"
        ));
        self.faults.push(fault);
        self.at = end;
    }

    /// Returns whether the source declares a predicate of that name.
    fn declares(&mut self, name: &str) -> bool {
        let (text, tokens) = (self.text, self.tokens);
        let word = |token: &Token| &text[token.start as usize..token.end as usize];
        let declared = self.declared.get_or_insert_with(|| {
            let starts =
                (tokens.iter().enumerate()).filter(|(_, token)| token.kind == Kind::Ident && word(token) == "decl");
            let names = starts.flat_map(|(at, _)| {
                let names = tokens[at + 1..].iter();
                names.take_while(|token| matches!(token.kind, Kind::Ident | Kind::Comma))
            });
            names.map(word).collect()
        });
        declared.contains(name)
    }

    /// Reports a directive of the C preprocessor.
    fn preprocessor(&mut self, token: Token) {
        let text = self.slice(token);
        let first_line = text.lines().next().unwrap_or_default().trim_end().len();
        let span = Span::new(self.source, token.start as usize..token.start as usize + first_line);
        self.unsupported(span, "here, directives of the preprocessor are", EXPAND);
    }

    fn wanted(&mut self, kind: Kind, what: &str) -> Parse<Token> {
        if self.kind() == kind {
            Ok(self.bump())
        } else {
            Err(self.expected(what))
        }
    }

    fn name(&mut self, what: &str) -> Parse<Name> {
        let token = self.token();
        if token.kind != Kind::Ident {
            return Err(self.expected(what));
        }
        if self.is_negation(token) {
            let fault = Diagnostic::new(codes::SYNTAX, format!("`{}` is not a name", self.slice(token)))
                .at(self.span(token), "")
                .note("`Not` and `not` write negation, unless the file declares such a predicate");
            self.faults.push(fault);
            return Err(Reported);
        }
        self.bump();
        if self.is_qualifying() {
            self.skip_parts();
            let fault = Diagnostic::new(codes::SYNTAX, "a name with a dot where a name is declared");
            let fault = fault.at(self.place_from(token).0, "");
            self.faults
                .push(fault.help("an instance of a component declares the names in it: `.init a = Component`"));
            return Err(Reported);
        }
        Ok(Name {
            text: self.slice(token).to_owned(),
            place: Place(self.span(token)),
        })
    }

    /// Reads a name that may be one of an instance of a component: `instance.name`.
    fn qualified(&mut self, what: &str) -> Parse<Name> {
        let token = self.token();
        let is_part = self.ahead(1).kind == Kind::Dot;
        if token.kind != Kind::Ident || !is_part {
            return self.name(what);
        }
        self.bump();
        self.skip_parts();
        let place = self.place_from(token);
        Ok(Name {
            text: self.text[place.0.range()].to_owned(),
            place,
        })
    }

    /// Skips the further parts of a name with dots.
    fn skip_parts(&mut self) {
        while self.is_qualifying() {
            self.bump();
            self.bump();
        }
    }

    /// Returns whether the current token is a dot within a name, as in `component.predicate`.
    fn is_qualifying(&self) -> bool {
        let (before, dot, part) = (self.previous(), self.token(), self.ahead(1));
        let is_part =
            |word: &str| !DIRECTIVES.contains(&word) && !FOREIGN_DIRECTIVES.iter().any(|(name, _)| *name == word);
        self.at > 0
            && before.kind == Kind::Ident
            && dot.kind == Kind::Dot
            && part.kind == Kind::Ident
            && before.end == dot.start
            && dot.end == part.start
            && is_part(self.slice(part))
    }

    fn names(&mut self, what: &str) -> Parse<Vec<Name>> {
        let mut names = vec![self.qualified(what)?];
        while self.eat(Kind::Comma) {
            names.push(self.qualified(what)?);
        }
        Ok(names)
    }

    /// Enters one more level of nesting.
    fn deeper(&mut self) -> Parse<()> {
        self.nesting += 1;
        if self.nesting <= MAX_NESTING {
            return Ok(());
        }
        let fault = Diagnostic::new(diag::codes::LIMIT_EXCEEDED, "nested too deeply")
            .at(self.span(self.token()), "")
            .note(format!(
                "at most {MAX_NESTING} enclosing negations, parentheses and braces are allowed"
            ));
        self.faults.push(fault);
        Err(Reported)
    }

    /// Returns the contents of a quoted string with its escapes replaced.
    fn unescape(&mut self, token: Token) -> String {
        let quoted = self.slice(token);
        let inner = &quoted[1..quoted.len() - usize::from(token.kind == Kind::String)];
        if !inner.contains('\\') {
            return inner.to_owned();
        }
        let mut out = String::with_capacity(inner.len());
        let mut bad = Vec::new();
        let mut chars = inner.char_indices();
        while let Some((at, c)) = chars.next() {
            if c != '\\' {
                out.push(c);
                continue;
            }
            match chars.next() {
                Some((_, 'n')) => out.push('\n'),
                Some((_, 'r')) => out.push('\r'),
                Some((_, 't')) => out.push('\t'),
                Some((_, '0')) => out.push('\0'),
                Some((_, 'a')) => out.push('\u{7}'),
                Some((_, 'b')) => out.push('\u{8}'),
                Some((_, 'v')) => out.push('\u{b}'),
                Some((_, 'f')) => out.push('\u{c}'),
                Some((_, c @ ('"' | '\'' | '\\'))) => out.push(c),
                Some((_, c)) => {
                    out.extend(['\\', c]);
                    bad.push((at, c));
                }
                None => {}
            }
        }
        for (at, c) in bad {
            let start = token.start as usize + 1 + at;
            let span = Span::new(self.source, start..start + 1 + c.len_utf8());
            let fault = Diagnostic::new(
                codes::OLD_FORM,
                "unknown escape in a string: the backslash stands for itself",
            )
            .at(span, "")
            .help(format!(
                "write `\\\\{c}` for a backslash before `{c}`, as in a regular expression"
            ))
            .fix("write two backslashes", [(span, format!("\\\\{c}"))])
            .note("the escapes are `\\n`, `\\r`, `\\t`, `\\0`, `\\a`, `\\b`, `\\v`, `\\f`, `\\\"`, `\\'` and `\\\\`");
            self.faults.push(fault);
        }
        out
    }
}
