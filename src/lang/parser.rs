//! Tokens to a syntax tree.
//!
//! The parser never fails: a fault is reported, the faulty clause or directive is left out (or kept as far as it is
//! understood, so that its name is not reported as unknown) and reading goes on at the next one. Recursion is as deep as
//! parentheses and braces are nested, and that is bounded, as is the height of an expression: no text can exhaust the stack.
//! Each token is looked at a bounded number of times.

use crate::diag::{Code, Diagnostic, Faults, SourceId, Span, did_you_mean};

use super::ast::{
    Aggregate, Atom, Clause, ColumnDecl, Decl, DirectiveOption, File, Include, Item, Literal, Mark, MarkKind, Name,
    Place, Plan, Pragma, Promise, PromiseKind, Scope, Term, TermKind, TypeDecl, TypeDefinition,
};
use super::functor::{AggregateOp, Functor};
use super::lexer::{self, CONJUNCTION, DISJUNCTION, DocLine, IMPLICATION, Kind, Lexed, NEGATION, Token};
use super::rules::{BaseType, Comparison};

/// More negations, parentheses and braces than this around anything are refused.
const MAX_NESTING: usize = 64;

/// Higher expressions are refused: an operator or function is one higher than its highest operand.
const MAX_HEIGHT: usize = 256;

/// The words of all directives.
pub const DIRECTIVES: &[&str] = &[
    "decl",
    "type",
    "symbol_type",
    "number_type",
    "input",
    "output",
    "printsize",
    "pragma",
    "plan",
    "include",
    "once",
    "scope",
    "disjoint",
    "implies",
    "irreflexive",
    "symmetric",
];

/// Souffle's directives that this language does not have.
const FOREIGN_DIRECTIVES: &[(&str, &str)] = &[
    ("comp", "components (`.comp`)"),
    ("init", "components (`.init`)"),
    ("override", "components (`.override`)"),
    ("functor", "user-defined functors (`.functor`)"),
    ("lattice", "lattices (`.lattice`)"),
    ("limitsize", "`.limitsize`"),
];

/// How older versions of Souffle declare a type, and what it is a subtype of.
const OLD_TYPES: &[(&str, BaseType)] = &[("symbol_type", BaseType::Symbol), ("number_type", BaseType::Number)];

/// What Souffle allows after the columns of a declaration and this language reads.
const QUALIFIERS: &[&str] = &[
    "inline",
    "no_inline",
    "magic",
    "no_magic",
    "brie",
    "btree",
    "overridable",
    "input",
    "output",
    "printsize",
];

/// `.decl A(x: number) output` is Souffle's old way to write `.output A`.
fn mark_of(qualifier: &str) -> Option<MarkKind> {
    match qualifier {
        "input" => Some(MarkKind::Input),
        "output" => Some(MarkKind::Output),
        "printsize" => Some(MarkKind::PrintSize),
        _ => None,
    }
}

/// The tree of one text.
pub(super) fn parse(source: SourceId, text: &str, faults: &mut Faults) -> File {
    let lexed = lexer::lex(source, text, faults);
    parse_tokens(source, text, &lexed, faults).0
}

/// The tree of a text that is lexed already, and the number of each item's first token.
pub(super) fn parse_tokens(source: SourceId, text: &str, lexed: &Lexed, faults: &mut Faults) -> (File, Vec<usize>) {
    let mut parser = Parser::new(source, text, lexed, faults);
    let file = parser.file();
    (file, parser.starts)
}

/// The body of a question: `?- A(x), x > 1.`; what is not in doubt, `?-` and the full stop, may be missing.
pub(super) fn parse_question(source: SourceId, text: &str, faults: &mut Faults) -> Option<(Vec<Literal>, Place)> {
    let lexed = lexer::lex(source, text, faults);
    let mut parser = Parser::new(source, text, &lexed, faults);
    parser.question().ok()
}

/// The fault has been reported; the caller leaves what it was reading.
struct Reported;

type Parse<T> = Result<T, Reported>;

struct Parser<'a> {
    source: SourceId,
    text: &'a str,
    tokens: &'a [Token],
    docs: &'a [DocLine],
    next_doc: usize,
    at: usize,
    /// Where items begin.
    starts: Vec<usize>,
    /// Parentheses, braces and negations around what is being read.
    nesting: usize,
    /// What the qualifiers of the declaration just read mark its predicates as.
    marks: Vec<Item>,
    faults: &'a mut Faults,
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
            marks: Vec::new(),
            faults,
        }
    }

    // --- looking at tokens

    fn token(&self) -> Token {
        self.ahead(0)
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

    /// From the first byte of `start` to the last byte read.
    fn place_from(&self, start: Token) -> Place {
        Place(self.span(start).to(self.span(self.previous())))
    }

    fn indent(&self, token: Token) -> usize {
        let before = &self.text[..token.start as usize];
        before.len() - before.rfind('\n').map_or(0, |newline| newline + 1)
    }

    /// The name after a `.` that touches it.
    fn directive_ahead(&self) -> Option<&'a str> {
        let (dot, name) = (self.token(), self.ahead(1));
        (dot.kind == Kind::Dot && name.kind == Kind::Ident && dot.end == name.start).then(|| self.slice(name))
    }

    /// Whether a directive begins here rather than a full stop ends something.
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

    /// Something is missing before the present token.
    fn expected(&mut self, what: &str) -> Reported {
        let help = self.habit();
        self.expected_with(what, help)
    }

    /// As [`Parser::expected`], with what to do.
    fn expected_with(&mut self, what: &str, help: Option<&str>) -> Reported {
        let token = self.token();
        if token.kind == Kind::Faulty {
            return Reported;
        }
        let message = format!("expected {what}, found {}", self.describe(token));
        // When the line is over, the fault is where something should have followed.
        let span = if self.at > 0 && (token.first_on_line || token.kind == Kind::End) {
            let end = self.previous().end as usize;
            Span::new(self.source, end..end)
        } else {
            self.span(token)
        };
        let mut fault = Diagnostic::new(Code::Syntax, message).at(span, format!("expected {what}"));
        if let Some(help) = help {
            fault = fault.help(help);
        }
        self.faults.push(fault);
        Reported
    }

    /// What to write instead of a present token that other languages have at such a place.
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
            _ => None,
        }
    }

    /// Reports one of these words, so many tokens long, where `what` is expected, and goes on behind it.
    fn goes_on_after(&mut self, help: &str, what: &str) -> bool {
        let token = self.token();
        // On a line of its own a name with arguments begins a clause.
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

    /// The present token cannot begin a clause or directive.
    fn expected_item(&mut self, why: &str) -> Reported {
        let token = self.token();
        if token.kind == Kind::Faulty {
            return Reported;
        }
        let message = format!("expected a clause or a directive{why}, found {}", self.describe(token));
        self.faults
            .push(Diagnostic::new(Code::Syntax, message).at(self.span(token), ""));
        Reported
    }

    fn unsupported(&mut self, span: Span, what: &str, help: &str) -> Reported {
        let mut fault = Diagnostic::new(Code::Unsupported, format!("{what} not supported")).at(span, "");
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
            let start = self.at;
            self.starts.push(start);
            self.nesting = 0;
            match self.item() {
                Ok(item) => {
                    file.items.extend(item);
                    file.items.append(&mut self.marks);
                }
                Err(Reported) => self.recover(start),
            }
            debug_assert!(self.at > start || self.kind() == Kind::End, "every item reads a token");
        }
        file
    }

    /// Skips to where the next item seems to begin.
    fn recover(&mut self, start: usize) {
        loop {
            let token = self.token();
            match token.kind {
                Kind::End => return,
                Kind::Dot if self.at > start && token.first_on_line && self.directive_ahead().is_some() => return,
                Kind::Dot => {
                    self.bump();
                    return;
                }
                Kind::Ident
                    if self.at > start
                        && token.first_on_line
                        && self.ahead(1).kind == Kind::LParen
                        && self.indent(token) <= self.indent(self.tokens[start])
                        && !matches!(self.previous().kind, Kind::Comma | Kind::If | Kind::Bang | Kind::LParen) =>
                {
                    return;
                }
                _ => {
                    self.bump();
                }
            }
        }
    }

    /// The doc comment that ends where the present token begins. Those before earlier tokens are dropped.
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
                None => {
                    self.bump();
                    let fault = Diagnostic::new(Code::Syntax, "full stop without a clause")
                        .at(self.span(token), "")
                        .note("only clauses end with a full stop; directives such as `.decl` do not");
                    self.faults.push(fault);
                    Ok(None)
                }
            },
            Kind::Ident => self.clause(doc).map(|clause| Some(Item::Clause(clause))),
            Kind::Bang => Err(self.expected_item(" (a head cannot be negated)")),
            Kind::Hash if self.slice(self.ahead(1)) == "include" && self.ahead(2).kind == Kind::Text => {
                self.bump();
                self.bump();
                let file = self.bump();
                Ok(Some(Item::Include(Include {
                    path: self.unescape(file),
                    place: Place(self.span(file)),
                })))
            }
            Kind::Hash => {
                self.bump();
                while self.kind() != Kind::End && !self.token().first_on_line {
                    self.bump();
                }
                let span = self.place_from(token).0;
                self.unsupported(
                    span,
                    "the C preprocessor is",
                    "include a file with `.include \"name.dl\"`",
                );
                Ok(None)
            }
            _ => {
                let reported = self.expected_item("");
                self.bump();
                Err(reported)
            }
        }
    }

    fn directive(&mut self, name: &str, doc: String) -> Parse<Option<Item>> {
        let dot = self.bump();
        let word = self.bump();
        let span = self.span(dot).to(self.span(word));
        match name {
            "decl" => self.decl(doc).map(|decl| Some(Item::Decl(decl))),
            "type" => self.type_decl(doc, None).map(|decl| Some(Item::Type(decl))),
            "input" => self.mark(MarkKind::Input).map(|mark| Some(Item::Mark(mark))),
            "output" => self.mark(MarkKind::Output).map(|mark| Some(Item::Mark(mark))),
            "printsize" => self.mark(MarkKind::PrintSize).map(|mark| Some(Item::Mark(mark))),
            "disjoint" => self.promise(PromiseKind::Disjoint, dot),
            "implies" => self.promise(PromiseKind::Implies, dot),
            "irreflexive" => self.promise(PromiseKind::Irreflexive, dot),
            "symmetric" => self.promise(PromiseKind::Symmetric, dot),
            "include" => {
                if !matches!(self.kind(), Kind::Text | Kind::OpenText) {
                    return Err(self.expected("the file's name in quotes"));
                }
                let token = self.bump();
                let path = self.unescape(token);
                Ok(Some(Item::Include(Include {
                    path,
                    place: Place(self.span(token)),
                })))
            }
            "once" => {
                let fault = Diagnostic::new(Code::Ignored, "`.once` has no effect")
                    .at(span, "")
                    .note("every file is read once");
                self.faults.push(fault.help("remove it"));
                Ok(None)
            }
            "pragma" => {
                let mut words = Vec::new();
                while matches!(self.kind(), Kind::Text | Kind::OpenText) {
                    let token = self.bump();
                    words.push(self.unescape(token));
                }
                if words.is_empty() {
                    return Err(self.expected("a text in quotes"));
                }
                Ok(Some(Item::Pragma(Pragma {
                    words,
                    place: Place(span),
                })))
            }
            "plan" => {
                let orders = self.join_orders()?;
                let place = self.place_from(dot);
                Ok(Some(Item::Plan(Plan { orders, place })))
            }
            "scope" => {
                let named = self.kind() == Kind::Ident && self.ahead(1).kind != Kind::LParen;
                let predicate = if named { Some(self.name("a predicate")?) } else { None };
                let place = Place(predicate.as_ref().map_or(span, |name| span.to(name.place.0)));
                Ok(Some(Item::Scope(Scope { predicate, place })))
            }
            _ => {
                if let Some(&(_, base)) = OLD_TYPES.iter().find(|(old, _)| *old == name) {
                    return self.type_decl(doc, Some(base)).map(|decl| Some(Item::Type(decl)));
                }
                if let Some((_, what)) = FOREIGN_DIRECTIVES.iter().find(|(foreign, _)| *foreign == name) {
                    let verb = if what.contains('(') { "are" } else { "is" };
                    let help = match name {
                        "limitsize" => "remove it; a query stops by itself when it derives too many rows",
                        _ => "",
                    };
                    let reported = self.unsupported(span, &format!("{what} {verb}"), help);
                    self.skip_braces();
                    return Err(reported);
                }
                let mut fault = Diagnostic::new(Code::Syntax, format!("unknown directive `.{name}`")).at(span, "");
                fault = match did_you_mean(name, DIRECTIVES.iter().copied()) {
                    Some(near) => fault.help(format!("did you mean `.{near}`?")),
                    None => fault.note(format!("the directives are {}", listed(DIRECTIVES))),
                };
                self.faults.push(fault);
                Err(Reported)
            }
        }
    }

    /// `0:(1,2), 1:(2,1)`
    fn join_orders(&mut self) -> Parse<Vec<(i64, Vec<i64>)>> {
        let mut orders = Vec::new();
        loop {
            let version = self.wanted(Kind::Number, "the number of a version")?;
            let version = self.number(version);
            self.wanted(Kind::Colon, "`:`")?;
            self.wanted(Kind::LParen, "`(`")?;
            let mut order = Vec::new();
            while self.kind() == Kind::Number {
                let atom = self.bump();
                order.push(self.number(atom));
                if !self.eat(Kind::Comma) {
                    break;
                }
            }
            self.wanted(Kind::RParen, "`)`")?;
            orders.push((version, order));
            if !self.eat(Kind::Comma) {
                return Ok(orders);
            }
        }
    }

    fn wanted(&mut self, kind: Kind, what: &str) -> Parse<Token> {
        if self.kind() == kind {
            Ok(self.bump())
        } else {
            Err(self.expected(what))
        }
    }

    /// Skips `name ... { ... }`, the block of a component, if one follows on the same line.
    fn skip_braces(&mut self) {
        let mut ahead = 0;
        while !self.ahead(ahead).first_on_line && !matches!(self.ahead(ahead).kind, Kind::LBrace | Kind::End) {
            ahead += 1;
            if ahead > MAX_NESTING {
                return;
            }
        }
        if self.ahead(ahead).kind != Kind::LBrace {
            return;
        }
        let mut depth = 0_usize;
        while self.kind() != Kind::End {
            match self.bump().kind {
                Kind::LBrace => depth += 1,
                Kind::RBrace => {
                    depth = depth.saturating_sub(1);
                    if depth == 0 {
                        return;
                    }
                }
                _ => {}
            }
        }
    }

    fn name(&mut self, what: &str) -> Parse<Name> {
        let token = self.token();
        if token.kind != Kind::Ident {
            return Err(self.expected(what));
        }
        if matches!(self.slice(token), "Not" | "not") {
            let fault = Diagnostic::new(Code::Syntax, format!("`{}` is not a name", self.slice(token)))
                .at(self.span(token), "")
                .note("`Not` and `not` write negation");
            self.faults.push(fault);
            return Err(Reported);
        }
        self.bump();
        let (dot, part) = (self.token(), self.ahead(1));
        let qualified = dot.kind == Kind::Dot
            && part.kind == Kind::Ident
            && token.end == dot.start
            && dot.end == part.start
            && !part.first_on_line
            && !DIRECTIVES.contains(&self.slice(part));
        if qualified && self.ahead(2).kind == Kind::LParen {
            let span = self.span(token).to(self.span(part));
            self.bump();
            self.bump();
            return Err(self.unsupported(span, "names with a dot (components) are", ""));
        }
        Ok(Name {
            text: self.slice(token).to_owned(),
            place: Place(self.span(token)),
        })
    }

    fn names(&mut self, what: &str) -> Parse<Vec<Name>> {
        let mut names = vec![self.name(what)?];
        while self.eat(Kind::Comma) {
            names.push(self.name(what)?);
        }
        Ok(names)
    }

    fn mark(&mut self, kind: MarkKind) -> Parse<Mark> {
        let names = self.names("a predicate")?;
        let mut options = Vec::new();
        if self.eat(Kind::LParen) && !self.eat(Kind::RParen) {
            loop {
                options.push(self.option()?);
                if self.eat(Kind::RParen) {
                    break;
                }
                if !self.eat(Kind::Comma) {
                    return Err(self.expected("`,` or `)`"));
                }
            }
        }
        Ok(Mark { kind, names, options })
    }

    fn option(&mut self) -> Parse<DirectiveOption> {
        let key = self.name("an option: `name=value`")?;
        if !self.eat(Kind::Equal) {
            return Err(self.expected("`=` and the option's value"));
        }
        let token = self.token();
        let value = match token.kind {
            Kind::Text | Kind::OpenText => self.unescape(token),
            Kind::Ident | Kind::Number => self.slice(token).to_owned(),
            _ => return Err(self.expected("the option's value")),
        };
        self.bump();
        Ok(DirectiveOption {
            key,
            value,
            place: Place(self.span(token)),
        })
    }

    /// Names with or without commas between them; a name before a parenthesis begins a clause.
    fn promise(&mut self, kind: PromiseKind, dot: Token) -> Parse<Option<Item>> {
        let mut names = vec![self.name("a predicate")?];
        while self.eat(Kind::Comma) || (self.kind() == Kind::Ident && self.ahead(1).kind != Kind::LParen) {
            names.push(self.name("a predicate")?);
        }
        let place = self.place_from(dot);
        let (good, wanted) = match kind {
            PromiseKind::Disjoint => (names.len() >= 2, "two predicates or more"),
            PromiseKind::Implies => (names.len() == 2, "two predicates: what holds, and what then holds too"),
            PromiseKind::Irreflexive | PromiseKind::Symmetric => (true, ""),
        };
        if !good {
            let message = format!("`.{}` names {wanted}", kind.name());
            self.faults
                .push(Diagnostic::new(Code::Syntax, message).at(place.0, format!("{} here", names.len())));
            return Ok(None);
        }
        Ok(Some(Item::Promise(Promise { kind, names, place })))
    }

    fn decl(&mut self, doc: String) -> Parse<Decl> {
        let names = self.names("the predicate's name")?;
        let start = self.at - 1;
        let columns = match self.columns() {
            Ok(columns) => Some(columns),
            Err(Reported) => {
                self.recover(start);
                None
            }
        };
        if let Some(name) = names
            .iter()
            .find(|name| matches!(name.text.as_str(), "match" | "contains"))
        {
            let fault = Diagnostic::new(Code::Syntax, format!("`{}` is not a predicate's name", name.text))
                .at(name.place.0, "")
                .note("it is a comparison of texts");
            self.faults.push(fault);
        }
        let mut qualifiers = Vec::new();
        if columns.is_some() {
            while self.kind() == Kind::Ident
                && QUALIFIERS.contains(&self.slice(self.token()))
                && self.ahead(1).kind != Kind::LParen
            {
                let word = self.name("a qualifier")?;
                match mark_of(&word.text) {
                    Some(kind) => self.marks.push(Item::Mark(Mark {
                        kind,
                        names: names.clone(),
                        options: Vec::new(),
                    })),
                    None => qualifiers.push(word),
                }
            }
            self.foreign_qualifiers();
        }
        Ok(Decl {
            names,
            columns,
            qualifiers,
            doc,
        })
    }

    fn columns(&mut self) -> Parse<Vec<ColumnDecl>> {
        let mut columns = Vec::new();
        if !self.eat(Kind::LParen) {
            return Err(self.expected("`(` and the columns"));
        }
        if self.eat(Kind::RParen) {
            return Ok(columns);
        }
        loop {
            let name = self.name("a column's name")?;
            if !self.eat(Kind::Colon) {
                return Err(self.expected("`:` and the column's type"));
            }
            let ty = self.name("a type")?;
            if self.kind() == Kind::Less {
                return Err(self.unsupported(self.span(self.token()), "lattices (`<>`) are", ""));
            }
            columns.push(ColumnDecl { name, ty });
            if self.eat(Kind::RParen) {
                return Ok(columns);
            }
            if !self.eat(Kind::Comma) {
                return Err(self.expected("`,` or `)`"));
            }
        }
    }

    /// What Souffle allows after the columns and this language does not: `eqrel`, `choice-domain ...`.
    fn foreign_qualifiers(&mut self) {
        let first = self.token();
        let known = matches!(
            self.slice(first),
            "btree_delete" | "provenance" | "eqrel" | "override" | "choice"
        );
        let clause_follows = self.ahead(1).kind == Kind::LParen;
        if first.kind != Kind::Ident || !known || clause_follows {
            return;
        }
        while !self.token().first_on_line && !matches!(self.kind(), Kind::End | Kind::Dot) {
            self.bump();
        }
        if self.previous().start < first.start {
            self.bump();
        }
        let word = match self.slice(first) {
            "choice" => "choice-domain".to_owned(),
            word => word.to_owned(),
        };
        let span = self.span(first);
        self.unsupported(span, &format!("the qualifier `{word}` is"), "remove it");
    }

    /// What follows `.type`, or one of its old forms that say themselves of what base the type is.
    fn type_decl(&mut self, doc: String, old: Option<BaseType>) -> Parse<TypeDecl> {
        let name = self.name("the type's name")?;
        let start = self.at - 1;
        let ends = self.token().first_on_line || self.kind() == Kind::End;
        let old = old.or(ends.then_some(BaseType::Symbol));
        let definition = match old {
            Some(base) => Ok(self.old_type(&name, base)),
            None => self.type_definition(),
        };
        let definition = match definition {
            Ok(definition) => definition,
            Err(Reported) => {
                self.recover(start);
                TypeDefinition::Faulty
            }
        };
        Ok(TypeDecl { name, definition, doc })
    }

    fn old_type(&mut self, name: &Name, base: BaseType) -> TypeDefinition {
        let fault = Diagnostic::new(Code::OldForm, "an old form of `.type`")
            .at(name.place.0, "")
            .help(format!("write `.type {} <: {}`", name.text, base.name()));
        self.faults.push(fault);
        TypeDefinition::Subtype(Name {
            text: base.name().to_owned(),
            place: name.place,
        })
    }

    fn type_definition(&mut self) -> Parse<TypeDefinition> {
        if self.eat(Kind::Subtype) {
            return Ok(TypeDefinition::Subtype(self.name("a type")?));
        }
        if !self.eat(Kind::Equal) {
            return Err(self.expected("`<:` or `=` and a type"));
        }
        let token = self.token();
        if token.kind == Kind::LBracket {
            return Err(self.unsupported(self.span(token), "record types are", ""));
        }
        let other = self.name("a type")?;
        let next = self.token();
        match next.kind {
            Kind::LBrace => Err(self.unsupported(self.span(next), "algebraic data types are", "")),
            Kind::Pipe => {
                let mut members = vec![other];
                while self.eat(Kind::Pipe) {
                    members.push(self.name("a type")?);
                }
                Ok(TypeDefinition::Union(members))
            }
            _ => Ok(TypeDefinition::Alias(other)),
        }
    }

    // --- clauses

    /// The present tokens are `?-`.
    fn at_question(&self) -> bool {
        self.kind() == Kind::Ident && self.slice(self.token()) == "?" && self.ahead(1).kind == Kind::Minus
    }

    fn question(&mut self) -> Parse<(Vec<Literal>, Place)> {
        if self.at_question() {
            self.bump();
            self.bump();
        }
        let start = self.token();
        let body = self.disjunction()?;
        let place = self.place_from(start);
        self.eat(Kind::Dot);
        match self.kind() {
            Kind::End => Ok((body, place)),
            _ => Err(self.expected("`,` or `.`")),
        }
    }

    fn clause(&mut self, doc: String) -> Parse<Clause> {
        let start = self.token();
        if matches!(self.slice(start), "Not" | "not") {
            return Err(self.expected_item(" (a head cannot be negated)"));
        }
        if self.at_question() {
            let help = "mark a predicate as a result with `.output`, or ask it in `logicity repl`";
            return Err(self.unsupported(self.span(start), "queries (`?-`) are", help));
        }
        let mut heads = vec![self.atom("the arguments of the head: `(`")?];
        while self.eat(Kind::Comma) {
            heads.push(self.atom("the arguments of the head: `(`")?);
        }
        let mut body = Vec::new();
        match self.kind() {
            Kind::LessEqual => {
                let span = self.span(self.token());
                return Err(self.unsupported(span, "subsumption (`<=` between heads) is", IMPLICATION));
            }
            kind if kind == Kind::If || self.goes_on_after(IMPLICATION, "`:-`") => {
                self.eat(Kind::If);
                body = self.disjunction()?;
                if body.is_empty() {
                    // `A(x) :- true.` is no fact.
                    body.push(Literal::Any(vec![Vec::new()]));
                }
                self.full_stop("`,` or `.`", start)?;
            }
            _ => self.full_stop("`:-` or `.`", start)?,
        }
        Ok(Clause {
            heads,
            body,
            doc,
            place: self.place_from(start),
        })
    }

    /// A full stop. If only that seems to be missing, the clause that began at `start` is whole and is kept.
    fn full_stop(&mut self, what: &str, start: Token) -> Parse<()> {
        let token = self.token();
        // A line further in is more likely a literal after a forgotten comma.
        let next_clause = token.kind == Kind::Ident && token.first_on_line && self.indent(token) <= self.indent(start);
        if self.at_known_directive() || token.kind == Kind::End || next_clause {
            self.expected_with(what, Some("a clause ends with a full stop"));
            return Ok(());
        }
        if self.eat(Kind::Dot) {
            return Ok(());
        }
        Err(self.expected(what))
    }

    fn atom(&mut self, open: &str) -> Parse<Atom> {
        let start = self.token();
        let predicate = self.name("a predicate")?;
        if !self.eat(Kind::LParen) {
            return Err(self.expected(open));
        }
        let mut terms = Vec::new();
        if !self.eat(Kind::RParen) {
            loop {
                terms.push(self.term()?);
                if self.eat(Kind::RParen) {
                    break;
                }
                if !self.eat(Kind::Comma) {
                    return Err(self.expected("`,` or `)`"));
                }
            }
        }
        Ok(Atom {
            predicate,
            terms,
            place: self.place_from(start),
        })
    }

    /// One more parenthesis or brace around what follows.
    fn deeper(&mut self) -> Parse<()> {
        self.nesting += 1;
        if self.nesting <= MAX_NESTING {
            return Ok(());
        }
        let fault = Diagnostic::new(Code::LimitExceeded, "nested too deeply")
            .at(self.span(self.token()), "")
            .note(format!(
                "at most {MAX_NESTING} negations, parentheses and braces may stand around anything"
            ));
        self.faults.push(fault);
        Err(Reported)
    }

    /// `A(x), B(x); C(x)`
    fn disjunction(&mut self) -> Parse<Vec<Literal>> {
        let mut alternatives = vec![self.conjunction()?];
        while self.eat(Kind::Semicolon) || self.goes_on_after(DISJUNCTION, "`;`") {
            alternatives.push(self.conjunction()?);
        }
        Ok(match alternatives.pop() {
            Some(only) if alternatives.is_empty() => only,
            last => {
                alternatives.extend(last);
                vec![Literal::Any(alternatives)]
            }
        })
    }

    fn conjunction(&mut self) -> Parse<Vec<Literal>> {
        let mut all = self.literals()?;
        while self.eat(Kind::Comma) || self.goes_on_after(CONJUNCTION, "`,`") {
            all.append(&mut self.literals()?);
        }
        Ok(all)
    }

    /// A literal, or what stands in parentheses, perhaps negated.
    fn literals(&mut self) -> Parse<Vec<Literal>> {
        let outside = self.nesting;
        let mut negated = false;
        loop {
            let token = self.token();
            match token.kind {
                Kind::Bang => negated = !negated,
                Kind::Ident if matches!(self.slice(token), "Not" | "not") => negated = !negated,
                Kind::Ident if self.is_loud_negation() => {
                    self.expected_with("a literal", Some(NEGATION));
                    negated = !negated;
                }
                _ => break,
            }
            self.deeper()?;
            self.bump();
        }
        let all = if self.kind() == Kind::LParen && !self.is_operand_in_parentheses(0) {
            self.deeper()?;
            self.bump();
            let all = self.disjunction()?;
            if !self.eat(Kind::RParen) {
                return Err(self.expected("`)`"));
            }
            all
        } else {
            self.atom_or_comparison()?
        };
        self.nesting = outside;
        Ok(if negated { negate(all) } else { all })
    }

    /// `NOT A(x)` or `NOT(A(x))`
    fn is_loud_negation(&self) -> bool {
        let [next, second, third] = [1, 2, 3].map(|count| self.ahead(count).kind);
        let atom_follows = match next {
            Kind::Ident => second == Kind::LParen,
            Kind::LParen => second == Kind::Ident && third == Kind::LParen,
            _ => false,
        };
        self.slice(self.token()) == "NOT" && atom_follows
    }

    /// The token after the `)` that closes the parenthesis so many tokens ahead, if the clause goes on until there.
    fn after_parenthesis(&self, ahead: usize) -> Option<Token> {
        let mut depth = 0_usize;
        for (at, &token) in self.tokens.iter().enumerate().skip(self.at + ahead) {
            match token.kind {
                Kind::LParen => depth += 1,
                Kind::RParen => depth = depth.checked_sub(1)?,
                // No clause ends and no body begins within parentheses.
                Kind::Dot | Kind::If | Kind::End => return None,
                _ => {}
            }
            if depth == 0 {
                return self.tokens.get(at + 1).copied();
            }
        }
        None
    }

    /// Whether what stands in the parenthesis so many tokens ahead is an operand of something.
    fn is_operand_in_parentheses(&self, ahead: usize) -> bool {
        self.after_parenthesis(ahead)
            .is_some_and(|after| comparison(after.kind).is_some() || self.infix(after).is_some())
    }

    /// The operator that stands between two operands.
    fn infix(&self, token: Token) -> Option<Functor> {
        match token.kind {
            Kind::Operator | Kind::Minus | Kind::Ident => Functor::infix(self.slice(token)),
            _ => None,
        }
    }

    fn atom_or_comparison(&mut self) -> Parse<Vec<Literal>> {
        let start = self.token();
        let next = self.ahead(1);
        if start.kind == Kind::Ident && next.kind == Kind::LParen && !self.is_term_with_parentheses() {
            let op = match self.slice(start) {
                "match" => Some(Comparison::Match),
                "contains" => Some(Comparison::Contains),
                _ => None,
            };
            let mut atom = self.atom("`(`")?;
            let Some(op) = op else {
                let after = self.token();
                if comparison(after.kind).is_some() || self.infix(after).is_some() {
                    return Err(self.unsupported(
                        atom.place.0,
                        &format!("the functor `{}` is", atom.predicate.text),
                        "an atom has no value that could be compared",
                    ));
                }
                return Ok(vec![Literal::Atom { negated: false, atom }]);
            };
            let (Some(right), Some(left), 0) = (atom.terms.pop(), atom.terms.pop(), atom.terms.len()) else {
                let message = format!("`{}` takes 2 arguments", atom.predicate.text);
                self.faults.push(
                    Diagnostic::new(Code::ArityMismatch, message).at(atom.place.0, "a pattern or part, and a text"),
                );
                return Err(Reported);
            };
            let place = atom.place;
            return Ok(vec![Literal::Compare { op, left, right, place }]);
        }
        let is_alone = comparison(next.kind).is_none() && self.infix(next).is_none();
        match self.slice(start) {
            "true" if is_alone => {
                self.bump();
                return Ok(Vec::new());
            }
            "false" if is_alone => {
                self.bump();
                return Ok(vec![Literal::Any(Vec::new())]);
            }
            _ => {}
        }
        let part = self.ahead(2);
        if start.kind == Kind::Ident
            && next.kind == Kind::Dot
            && start.end == next.start
            && next.end == part.start
            && part.kind == Kind::Ident
            && self.ahead(3).kind == Kind::LParen
            && !next.first_on_line
        {
            self.at += 3;
            let span = self.span(start).to(self.span(part));
            return Err(self.unsupported(span, "names with a dot (components) are", ""));
        }
        let left = match start.kind {
            Kind::Ident
            | Kind::Underscore
            | Kind::Number
            | Kind::Faulty
            | Kind::Float
            | Kind::Unsigned
            | Kind::Text
            | Kind::OpenText
            | Kind::Minus
            | Kind::LParen
            | Kind::LBracket
            | Kind::Dollar
            | Kind::At => self.term()?,
            _ => return Err(self.expected("a literal")),
        };
        let op_token = self.token();
        let Some(op) = comparison(op_token.kind) else {
            if let TermKind::Variable(_) = &left.kind {
                let help = match op_token.kind {
                    _ if self.habit().is_some() => self.habit().unwrap_or_default().to_owned(),
                    Kind::Ident | Kind::Underscore => {
                        format!(
                            "arguments stand in parentheses: `{}({})`",
                            self.slice(start),
                            self.slice(op_token)
                        )
                    }
                    _ => format!("a predicate without arguments is written `{}()`", self.slice(start)),
                };
                let fault = Diagnostic::new(Code::Syntax, format!("`{}` is not a literal", self.slice(start)))
                    .at(left.place.0, "expected an atom or a comparison")
                    .help(help);
                self.faults.push(fault);
                return Err(Reported);
            }
            return Err(self.expected("a comparison operator"));
        };
        self.bump();
        let right = self.term()?;
        Ok(vec![Literal::Compare {
            op,
            left,
            right,
            place: self.place_from(start),
        }])
    }

    // --- expressions

    fn term(&mut self) -> Parse<Term> {
        self.expression(0).map(|(term, _)| term)
    }

    /// An expression of operators that bind at least so tightly, and its height.
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
        let fault = Diagnostic::new(Code::LimitExceeded, "expression with too many operators")
            .at(self.span(start), "it begins here")
            .note(format!("an expression is at most {MAX_HEIGHT} operators high"));
        self.faults.push(fault);
        Err(Reported)
    }

    /// Whether a term begins here that has parentheses: a function, or an aggregate of something in parentheses.
    fn is_term_with_parentheses(&self) -> bool {
        let word = self.slice(self.token());
        let is_function = word == "as" || Functor::function(word).is_some();
        self.is_aggregate() || (is_function && self.is_operand_in_parentheses(1)) || self.is_prefix_operator()
    }

    fn is_prefix_operator(&self) -> bool {
        matches!(self.slice(self.token()), "bnot" | "lnot") && self.begins_operand(self.ahead(1))
    }

    fn begins_operand(&self, token: Token) -> bool {
        match token.kind {
            Kind::Number | Kind::Float | Kind::Unsigned | Kind::Text | Kind::LParen | Kind::Minus => true,
            Kind::Ident | Kind::Underscore => self.infix(token).is_none(),
            _ => false,
        }
    }

    fn is_aggregate(&self) -> bool {
        let next = self.ahead(1);
        match self.slice(self.token()) {
            "count" => matches!(next.kind, Kind::Colon | Kind::LBrace),
            "sum" | "mean" => next.kind != Kind::Minus && self.begins_operand(next),
            "min" | "max" if next.kind == Kind::LParen => {
                (self.after_parenthesis(1)).is_some_and(|after| after.kind == Kind::Colon)
            }
            "min" | "max" => next.kind != Kind::Minus && self.begins_operand(next),
            _ => false,
        }
    }

    /// What operators stand between, and its height.
    fn operand(&mut self) -> Parse<(Term, usize)> {
        let start = self.token();
        let outside = self.nesting;
        let prefix = match start.kind {
            Kind::Minus => Some(Functor::Negate),
            Kind::Ident if self.is_prefix_operator() && self.slice(start) == "bnot" => Some(Functor::BitNot),
            Kind::Ident if self.is_prefix_operator() => Some(Functor::Not),
            _ => None,
        };
        if let Some(functor) = prefix {
            self.bump();
            let number = self.token();
            let powered = self.infix(self.ahead(1)) == Some(Functor::Power);
            let kind = match number.kind {
                Kind::Number if functor == Functor::Negate && !powered => {
                    self.bump();
                    Some(TermKind::Number(-self.number(number)))
                }
                Kind::Float if functor == Functor::Negate && !powered => {
                    self.bump();
                    Some(TermKind::Float(format!("-{}", self.slice(number))))
                }
                _ => None,
            };
            if let Some(kind) = kind {
                let place = self.place_from(start);
                return Ok((Term { kind, place }, 0));
            }
            self.deeper()?;
            // An operand may have a sign of its own; only `^` binds more tightly.
            let tighter = Functor::Power.precedence().unwrap_or(0);
            let (operand, height) = self.expression(tighter)?;
            self.nesting = outside;
            let height = self.higher(start, height)?;
            let term = Term {
                kind: TermKind::Functor(functor, vec![operand]),
                place: self.place_from(start),
            };
            return Ok((term, height));
        }
        if start.kind == Kind::LParen {
            self.deeper()?;
            self.bump();
            let inner = self.expression(0)?;
            if !self.eat(Kind::RParen) {
                return Err(self.expected("`)`"));
            }
            self.nesting = outside;
            return Ok(inner);
        }
        let (kind, height) = match start.kind {
            Kind::Ident => {
                let applied = self.ahead(1).kind == Kind::LParen;
                match self.slice(start) {
                    _ if self.is_aggregate() => (self.aggregate()?, 0),
                    "as" if applied => self.cast()?,
                    "autoinc" if applied => {
                        return Err(self.unsupported(self.span(start), "the functor `autoinc` is", ""));
                    }
                    "nil" => return Err(self.unsupported(self.span(start), "records (`nil`) are", "")),
                    _ if self.ahead(1).kind == Kind::LBracket => {
                        return Err(self.unsupported(self.span(start), "records (`[...]`) are", ""));
                    }
                    word if applied => match Functor::function(word) {
                        Some(functor) => self.function(functor)?,
                        None => {
                            let what = format!("the functor `{word}` is");
                            let help = "an argument is a variable, a constant, `_` or an expression of the functors listed \
                                        in the reference";
                            return Err(self.unsupported(self.span(start), &what, help));
                        }
                    },
                    word => {
                        self.bump();
                        (TermKind::Variable(word.to_owned()), 0)
                    }
                }
            }
            Kind::Underscore => {
                self.bump();
                (TermKind::Wildcard, 0)
            }
            Kind::Number => {
                self.bump();
                (TermKind::Number(self.number(start)), 0)
            }
            Kind::Unsigned => {
                self.bump();
                let number = self.number(start);
                (TermKind::Unsigned(u32::try_from(number).unwrap_or(0)), 0)
            }
            Kind::Float => {
                self.bump();
                (TermKind::Float(self.slice(start).to_owned()), 0)
            }
            Kind::Text | Kind::OpenText => {
                self.bump();
                (TermKind::Text(self.unescape(start)), 0)
            }
            // Reported by the lexer.
            Kind::Faulty => return Err(Reported),
            Kind::LBracket => return Err(self.unsupported(self.span(start), "records (`[...]`) are", "")),
            Kind::Dollar => {
                return Err(self.unsupported(self.span(start), "algebraic data types and counters (`$`) are", ""));
            }
            Kind::At => return Err(self.unsupported(self.span(start), "user-defined functors (`@`) are", "")),
            _ => return Err(self.expected("an argument: a variable, a constant, `_` or an expression")),
        };
        let place = self.place_from(start);
        Ok((Term { kind, place }, height))
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
                .push(Diagnostic::new(Code::ArityMismatch, message).at(place, ""));
            return Err(Reported);
        }
        let height = self.higher(start, height)?;
        Ok((TermKind::Functor(functor, arguments), height))
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
        let ty = self.name("a type")?;
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

    /// The value of a number; one that no type has is reported and becomes 0.
    fn number(&mut self, token: Token) -> i64 {
        let text = self.slice(token);
        let text = text.strip_suffix('u').unwrap_or(text);
        let (digits, radix) = match text.get(..2) {
            Some("0x") => (&text[2..], 16),
            Some("0b") => (&text[2..], 2),
            _ => (text, 10),
        };
        let mut value: i64 = 0;
        for digit in digits.chars() {
            match digit.to_digit(radix) {
                Some(digit) => value = (value * i64::from(radix) + i64::from(digit)).min(1 << 40),
                None => return 0, // the lexer has reported it
            }
        }
        if value > i64::from(u32::MAX) {
            let fault = Diagnostic::new(Code::LimitExceeded, "number out of range")
                .at(self.span(token), "")
                .note(format!(
                    "numbers go from {} to {}, unsigned ones to {}",
                    i32::MIN,
                    i32::MAX,
                    u32::MAX
                ));
            self.faults.push(fault);
            return 0;
        }
        value
    }

    /// The text between the quotes with its escapes replaced.
    fn unescape(&mut self, token: Token) -> String {
        let quoted = self.slice(token);
        let inner = &quoted[1..quoted.len() - usize::from(token.kind == Kind::Text)];
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
                Some((_, c @ ('"' | '\'' | '\\'))) => out.push(c),
                Some((_, c)) => bad.push((at, c)),
                None => {}
            }
        }
        for (at, c) in bad {
            let start = token.start as usize + 1 + at;
            let fault = Diagnostic::new(Code::Syntax, "unknown escape in a text")
                .at(Span::new(self.source, start..start + 1 + c.len_utf8()), "")
                .note("the escapes are `\\n`, `\\r`, `\\t`, `\\0`, `\\\"`, `\\'` and `\\\\`");
            self.faults.push(fault);
        }
        out
    }
}

fn comparison(kind: Kind) -> Option<Comparison> {
    Some(match kind {
        Kind::Equal => Comparison::Equal,
        Kind::NotEqual => Comparison::NotEqual,
        Kind::Less => Comparison::Less,
        Kind::LessEqual => Comparison::LessEqual,
        Kind::Greater => Comparison::Greater,
        Kind::GreaterEqual => Comparison::GreaterEqual,
        _ => return None,
    })
}

/// What holds if not all of these do.
pub(super) fn negate(mut all: Vec<Literal>) -> Vec<Literal> {
    match all.pop() {
        Some(only) if all.is_empty() => negate_one(only),
        Some(last) => {
            all.push(last);
            vec![Literal::Any(all.into_iter().map(negate_one).collect())]
        }
        None => vec![Literal::Any(Vec::new())],
    }
}

fn negate_one(literal: Literal) -> Vec<Literal> {
    match literal {
        Literal::Atom { negated, atom } => vec![Literal::Atom {
            negated: !negated,
            atom,
        }],
        Literal::Compare { op, left, right, place } => vec![Literal::Compare {
            op: op.opposite(),
            left,
            right,
            place,
        }],
        Literal::Any(alternatives) => alternatives.into_iter().flat_map(negate).collect(),
    }
}

fn listed(names: &[&str]) -> String {
    let quoted: Vec<String> = names.iter().map(|name| format!("`.{name}`")).collect();
    quoted.join(", ")
}
