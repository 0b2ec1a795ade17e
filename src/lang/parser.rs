//! Tokens to a syntax tree.
//!
//! The parser never fails: a fault is reported, the faulty clause or directive is left out (or kept as far as it is
//! understood, so that its name is not reported as unknown) and reading goes on at the next one. Nothing here recurses, so no
//! text can exhaust the stack, and each token is looked at a bounded number of times.

use crate::diag::{Code, Diagnostic, SourceId, Span, did_you_mean};

use super::ast::{
    Atom, Clause, ColumnDecl, Decl, File, Include, Item, Literal, Mark, MarkKind, Name, Place, Promise, PromiseKind,
    Scope, Term, TermKind, TypeDecl, TypeDefinition,
};
use super::faults::Faults;
use super::lexer::{self, DocLine, Kind, Lexed, Token};
use super::rules::Comparison;

/// More negations and parentheses than this around one literal are refused.
const MAX_NESTING: usize = 64;

/// Every directive, for suggestions.
const DIRECTIVES: &[&str] = &[
    "decl",
    "type",
    "input",
    "output",
    "printsize",
    "include",
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
    ("pragma", "`.pragma`"),
    ("plan", "`.plan`"),
    ("limitsize", "`.limitsize`"),
    ("symbol_type", "the old form `.symbol_type`"),
    ("number_type", "the old form `.number_type`"),
];

const AGGREGATES: &[&str] = &["count", "sum", "min", "max", "mean", "range"];

/// The tree of one text.
pub(super) fn parse(source: SourceId, text: &str, faults: &mut Faults) -> File {
    let lexed = lexer::lex(source, text, faults);
    parse_tokens(source, text, &lexed, faults).0
}

/// The tree of a text that is lexed already, and the number of each item's first token.
pub(super) fn parse_tokens(source: SourceId, text: &str, lexed: &Lexed, faults: &mut Faults) -> (File, Vec<usize>) {
    let mut parser = Parser {
        source,
        text,
        tokens: &lexed.tokens,
        docs: &lexed.docs,
        next_doc: 0,
        at: 0,
        starts: Vec::new(),
        faults,
    };
    let file = parser.file();
    (file, parser.starts)
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
    faults: &'a mut Faults,
}

impl<'a> Parser<'a> {
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

    fn is_arithmetic(&self, token: Token) -> bool {
        token.kind == Kind::Operator && self.slice(token) != "&"
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
                DIRECTIVES.contains(&name) || FOREIGN_DIRECTIVES.iter().any(|(foreign, _)| *foreign == name)
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
        if let Some(help) = self.habit() {
            fault = fault.help(help);
        }
        self.faults.push(fault);
        Reported
    }

    /// What to write instead of a present token that other languages have at such a place.
    fn habit(&self) -> Option<&'static str> {
        let (token, next) = (self.token(), self.ahead(1));
        match self.slice(token) {
            "and" | "&" => Some("literals are separated by commas, which mean \"and\""),
            "or" | "|" => Some("write a clause for each alternative"),
            "if" => Some("head and body are separated by `:-`"),
            "<" | ":" if next.kind == Kind::Minus => Some("head and body are separated by `:-`"),
            "=" if self.at > 0 && self.previous().kind == Kind::Equal => Some("equality is written `=`"),
            _ => None,
        }
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
            match self.item() {
                Ok(item) => file.items.extend(item),
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
            "type" => self.type_decl(doc).map(|decl| Some(Item::Type(decl))),
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
            "scope" => {
                let named = self.kind() == Kind::Ident && self.ahead(1).kind != Kind::LParen;
                let predicate = if named { Some(self.name("a predicate")?) } else { None };
                let place = Place(predicate.as_ref().map_or(span, |name| span.to(name.place.0)));
                Ok(Some(Item::Scope(Scope { predicate, place })))
            }
            _ => {
                if let Some((_, what)) = FOREIGN_DIRECTIVES.iter().find(|(foreign, _)| *foreign == name) {
                    let verb = if what.contains('(') { "are" } else { "is" };
                    let reported = self.unsupported(span, &format!("{what} {verb}"), "");
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
        let mut names = Vec::new();
        loop {
            names.push(self.name("a predicate")?);
            if self.kind() == Kind::LParen {
                let open = self.bump();
                while !matches!(self.kind(), Kind::RParen | Kind::End) && !self.token().first_on_line {
                    self.bump();
                }
                self.eat(Kind::RParen);
                let span = self.place_from(open).0;
                self.unsupported(
                    span,
                    "options of `.input`, `.output` and `.printsize` are",
                    "write the name alone; facts are read from `<name>.facts` and results written to `<name>.csv`",
                );
            }
            if !self.eat(Kind::Comma) {
                return Ok(Mark { kind, names });
            }
        }
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
        if columns.is_some() {
            self.qualifiers();
        }
        Ok(Decl { names, columns, doc })
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
            columns.push(ColumnDecl { name, ty });
            if self.eat(Kind::RParen) {
                return Ok(columns);
            }
            if !self.eat(Kind::Comma) {
                return Err(self.expected("`,` or `)`"));
            }
        }
    }

    /// What Souffle allows after the columns: `inline`, `eqrel`, `choice-domain ...`.
    fn qualifiers(&mut self) {
        let first = self.token();
        let known = matches!(
            self.slice(first),
            "inline"
                | "no_inline"
                | "magic"
                | "no_magic"
                | "brie"
                | "btree"
                | "btree_delete"
                | "eqrel"
                | "override"
                | "overridable"
                | "input"
                | "output"
                | "printsize"
                | "choice"
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
        let help = match word.as_str() {
            "input" | "output" | "printsize" => {
                format!("write `.{word}` and the predicate's name on a line of its own")
            }
            _ => "remove it".to_owned(),
        };
        let span = self.span(first);
        self.unsupported(span, &format!("the qualifier `{word}` is"), &help);
    }

    fn type_decl(&mut self, doc: String) -> Parse<TypeDecl> {
        let name = self.name("the type's name")?;
        let start = self.at - 1;
        let definition = match self.type_definition() {
            Ok(definition) => definition,
            Err(Reported) => {
                self.recover(start);
                TypeDefinition::Faulty
            }
        };
        Ok(TypeDecl { name, definition, doc })
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
            Kind::Pipe => Err(self.unsupported(
                self.span(next),
                "union types are",
                "declare a common parent and make each a subtype of it: `.type car <: agent`",
            )),
            _ => Ok(TypeDefinition::Alias(other)),
        }
    }

    // --- clauses

    fn clause(&mut self, doc: String) -> Parse<Clause> {
        let start = self.token();
        if matches!(self.slice(start), "Not" | "not") {
            return Err(self.expected_item(" (a head cannot be negated)"));
        }
        if self.slice(start) == "?" && self.ahead(1).kind == Kind::Minus {
            let help = "mark a predicate as a result with `.output`";
            return Err(self.unsupported(self.span(start), "queries (`?-`) are", help));
        }
        let head = self.atom("the arguments of the head: `(`")?;
        let mut body = Vec::new();
        match self.kind() {
            Kind::If => {
                self.bump();
                loop {
                    body.push(self.literal()?);
                    if !self.eat(Kind::Comma) {
                        break;
                    }
                }
                self.full_stop("`,` or `.`", start)?;
            }
            Kind::Comma => {
                let span = self.span(self.token());
                return Err(self.unsupported(span, "several heads in one clause are", "write a clause for each head"));
            }
            Kind::LessEqual => {
                let span = self.span(self.token());
                return Err(self.unsupported(span, "subsumption (`<=` between heads) is", ""));
            }
            _ => self.full_stop("`:-` or `.`", start)?,
        }
        Ok(Clause {
            head,
            body,
            doc,
            place: self.place_from(start),
        })
    }

    /// A full stop. If only that seems to be missing, the clause that began at `start` is whole and is kept.
    fn full_stop(&mut self, what: &str, start: Token) -> Parse<()> {
        let token = self.token();
        if self.at_known_directive() {
            self.expected(what);
            return Ok(());
        }
        match token.kind {
            Kind::Dot => {
                self.bump();
                Ok(())
            }
            Kind::Semicolon => Err(self.unsupported(
                self.span(token),
                "disjunction (`;`) is",
                "write a clause for each alternative",
            )),
            Kind::End => {
                self.expected(what);
                Ok(())
            }
            // A line further in is more likely a literal after a forgotten comma.
            Kind::Ident if token.first_on_line && self.indent(token) <= self.indent(start) => {
                self.expected(what);
                Ok(())
            }
            _ => Err(self.expected(what)),
        }
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

    fn literal(&mut self) -> Parse<Literal> {
        let start = self.token();
        let mut negated = false;
        let mut open = 0_usize;
        let mut nesting = 0_usize;
        loop {
            let token = self.token();
            match token.kind {
                Kind::Bang => negated = !negated,
                Kind::LParen => open += 1,
                Kind::Ident if matches!(self.slice(token), "Not" | "not") => negated = !negated,
                _ => break,
            }
            nesting += 1;
            if nesting > MAX_NESTING {
                let fault = Diagnostic::new(Code::LimitExceeded, "literal nested too deeply")
                    .at(self.span(start), "it begins here")
                    .note(format!(
                        "at most {MAX_NESTING} negations and parentheses may stand around a literal"
                    ));
                self.faults.push(fault);
                return Err(Reported);
            }
            self.bump();
        }
        let literal = self.atom_or_comparison(negated)?;
        for _ in 0..open {
            let token = self.token();
            match token.kind {
                Kind::RParen => {
                    self.bump();
                }
                Kind::Comma => {
                    return Err(self.unsupported(
                        self.span(token),
                        "a conjunction in parentheses is",
                        "define a predicate for it by a clause of its own",
                    ));
                }
                Kind::Semicolon => {
                    return Err(self.unsupported(
                        self.span(token),
                        "disjunction (`;`) is",
                        "write a clause for each alternative",
                    ));
                }
                _ => return Err(self.expected("`)`")),
            }
        }
        Ok(literal)
    }

    fn atom_or_comparison(&mut self, negated: bool) -> Parse<Literal> {
        let start = self.token();
        let next = self.ahead(1);
        if start.kind == Kind::Ident && next.kind == Kind::LParen && self.slice(start) != "as" {
            let atom = self.atom("`(`")?;
            let after = self.token();
            if comparison(after.kind).is_some() || after.kind == Kind::Minus || self.is_arithmetic(after) {
                return Err(self.unsupported(
                    atom.place.0,
                    "functors are",
                    "an atom has no value that could be compared",
                ));
            }
            return Ok(Literal::Atom { negated, atom });
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
            | Kind::LBracket
            | Kind::Dollar
            | Kind::At => self.term()?,
            _ => return Err(self.expected("a literal")),
        };
        let op_token = self.token();
        let Some(op) = comparison(op_token.kind) else {
            if let TermKind::Variable(name) = &left.kind {
                if matches!(name.as_str(), "true" | "false") {
                    return Err(self.unsupported(left.place.0, &format!("the literal `{name}` is"), ""));
                }
                let help = match op_token.kind {
                    Kind::Ident | Kind::Underscore => {
                        format!("arguments stand in parentheses: `{name}({})`", self.slice(op_token))
                    }
                    _ => format!("a predicate without arguments is written `{name}()`"),
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
        Ok(Literal::Compare {
            op: if negated { opposite(op) } else { op },
            left,
            right,
            place: self.place_from(start),
        })
    }

    fn term(&mut self) -> Parse<Term> {
        let start = self.token();
        let kind = match start.kind {
            Kind::Ident => {
                let next = self.ahead(1);
                let word = self.slice(start);
                if AGGREGATES.contains(&word)
                    && matches!(
                        next.kind,
                        Kind::Colon | Kind::LBrace | Kind::Ident | Kind::Number | Kind::LParen
                    )
                {
                    let what = format!("the aggregate `{word}` is");
                    return Err(self.unsupported(self.span(start), &what, ""));
                }
                if next.kind == Kind::LParen {
                    let what = match word {
                        "as" => "type casts (`as`) are".to_owned(),
                        _ => format!("the functor `{word}` is"),
                    };
                    return Err(self.unsupported(
                        self.span(start),
                        &what,
                        "an argument is a variable, a constant or `_`",
                    ));
                }
                if word == "nil" {
                    return Err(self.unsupported(self.span(start), "records (`nil`) are", ""));
                }
                let name = word.to_owned();
                self.bump();
                TermKind::Variable(name)
            }
            Kind::Underscore => {
                self.bump();
                TermKind::Wildcard
            }
            Kind::Number => {
                self.bump();
                TermKind::Number(self.number(start, false))
            }
            Kind::Minus => {
                self.bump();
                let number = self.token();
                match number.kind {
                    Kind::Number => {
                        self.bump();
                        TermKind::Number(self.number(number, true))
                    }
                    Kind::Float => {
                        return Err(self.unsupported(self.span(number), "floating-point numbers are", ""));
                    }
                    _ => return Err(self.unsupported(self.span(start), "arithmetic is", "")),
                }
            }
            Kind::Text | Kind::OpenText => {
                self.bump();
                TermKind::Text(self.unescape(start))
            }
            // Reported by the lexer.
            Kind::Faulty => return Err(Reported),
            Kind::Float => return Err(self.unsupported(self.span(start), "floating-point numbers are", "")),
            Kind::Unsigned => {
                return Err(self.unsupported(self.span(start), "unsigned numbers are", "write it without the `u`"));
            }
            Kind::LBracket => return Err(self.unsupported(self.span(start), "records (`[...]`) are", "")),
            Kind::Dollar => {
                return Err(self.unsupported(self.span(start), "algebraic data types and counters (`$`) are", ""));
            }
            Kind::At => return Err(self.unsupported(self.span(start), "user-defined functors (`@`) are", "")),
            _ => return Err(self.expected("an argument: a variable, a constant or `_`")),
        };
        let place = self.place_from(start);
        let after = self.token();
        let word_operator = after.kind == Kind::Ident
            && matches!(
                self.slice(after),
                "band" | "bor" | "bxor" | "bshl" | "bshr" | "bshru" | "land" | "lor" | "lxor"
            );
        if after.kind == Kind::Minus || self.is_arithmetic(after) || word_operator {
            return Err(self.unsupported(self.span(after), "arithmetic is", ""));
        }
        Ok(Term { kind, place })
    }

    /// The value of a number; one that does not fit is reported and becomes 0.
    fn number(&mut self, token: Token, negative: bool) -> i32 {
        let text = self.slice(token);
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
        let value = if negative { -value } else { value };
        i32::try_from(value).unwrap_or_else(|_| {
            let fault = Diagnostic::new(Code::LimitExceeded, "number out of range")
                .at(self.span(token), "")
                .note(format!("numbers go from {} to {}", i32::MIN, i32::MAX));
            self.faults.push(fault);
            0
        })
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

fn opposite(op: Comparison) -> Comparison {
    match op {
        Comparison::Equal => Comparison::NotEqual,
        Comparison::NotEqual => Comparison::Equal,
        Comparison::Less => Comparison::GreaterEqual,
        Comparison::LessEqual => Comparison::Greater,
        Comparison::Greater => Comparison::LessEqual,
        Comparison::GreaterEqual => Comparison::Less,
    }
}

fn listed(names: &[&str]) -> String {
    let quoted: Vec<String> = names.iter().map(|name| format!("`.{name}`")).collect();
    quoted.join(", ")
}
