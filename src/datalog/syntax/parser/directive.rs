//! Directives: declarations, types, marks of predicates, constraints, includes and scopes.

use crate::codes;
use crate::diag::{self, Diagnostic, did_you_mean};
use crate::syntax::ast::BaseType;
use crate::syntax::ast::{
    Branch, ColumnDecl, Component, ComponentType, ConstraintDecl, ConstraintKind, Decl, DirectiveOption, FunctorDecl,
    Include, Init, Item, Mark, MarkKind, Name, Override, Place, Plan, Pragma, Scope, TypeDecl, TypeDefinition,
};
use crate::syntax::lexer::{Kind, Token};

use crate::syntax::parser::{
    DIRECTIVES, FOREIGN_DIRECTIVES, LATTICES, MAX_NESTING, OLD_TYPES, Parse, Parser, Reported,
};

/// The qualifiers of Soufflé that the parser accepts after the columns of a declaration.
const QUALIFIERS: &[&str] = &[
    "inline",
    "no_inline",
    "magic",
    "no_magic",
    "brie",
    "btree",
    "btree_delete",
    "eqrel",
    "overridable",
    "input",
    "output",
    "printsize",
];

/// Returns the directive equivalent to a qualifier: `.decl A(x: number) output` is an old notation for `.output A`.
fn mark_of(qualifier: &str) -> Option<MarkKind> {
    match qualifier {
        "input" => Some(MarkKind::Input),
        "output" => Some(MarkKind::Output),
        "printsize" => Some(MarkKind::PrintSize),
        _ => None,
    }
}

impl Parser<'_> {
    pub(super) fn directive(&mut self, name: &str, doc: String) -> Parse<Option<Item>> {
        let dot = self.bump();
        self.bump();
        self.rest_of_directive(name, dot, doc)
    }

    /// Reports a directive without its dot at the current token: `decl A(x: symbol)`, `import "a.dl"`. Returns its
    /// name.
    pub(super) fn directive_without_dot(&mut self) -> Option<&'static str> {
        let (word, next) = (self.token(), self.ahead(1));
        // A name before another name or a string begins no clause.
        if !matches!(next.kind, Kind::Ident | Kind::String) || next.first_on_line || !word.first_on_line {
            return None;
        }
        let text = self.slice(word).to_lowercase();
        let name = match next.kind {
            Kind::String if matches!(text.as_str(), "include" | "import" | "load" | "use") => "include",
            Kind::Ident if !matches!(text.as_str(), "include" | "once" | "plan" | "pragma") => {
                DIRECTIVES.iter().copied().find(|directive| *directive == text)?
            }
            _ => return None,
        };
        if matches!(self.slice(next), "if" | "If" | "IF") {
            return None;
        }
        let written = match next.kind {
            Kind::String => format!(".{name} {}", self.slice(next)),
            _ => format!(".{name}"),
        };
        let span = self.span(word);
        let fault = Diagnostic::new(codes::SYNTAX, format!("`{}` without a dot", self.slice(word))).at(span, "");
        let fault = fault.help(format!("a directive begins with a dot: `{written}`"));
        self.faults
            .push(fault.fix(format!("write `.{name}`"), [(span, format!(".{name}"))]));
        Some(name)
    }

    /// Parses a directive after its name. `dot` is its first token.
    pub(super) fn rest_of_directive(&mut self, name: &str, dot: Token, doc: String) -> Parse<Option<Item>> {
        let span = self.span(dot).to(self.span(self.previous()));
        match name {
            "decl" => self.decl(doc).map(|decl| Some(Item::Decl(decl))),
            "type" => self.type_decl(doc, None).map(|decl| Some(Item::Type(decl))),
            "input" => self.mark(MarkKind::Input).map(|mark| Some(Item::Mark(mark))),
            "output" => self.mark(MarkKind::Output).map(|mark| Some(Item::Mark(mark))),
            "printsize" => self.mark(MarkKind::PrintSize).map(|mark| Some(Item::Mark(mark))),
            "limitsize" => self.mark(MarkKind::LimitSize).map(|mark| Some(Item::Mark(mark))),
            "include" => {
                if self.kind() != Kind::String {
                    return Err(self.expected("the file's name in quotes"));
                }
                let token = self.bump();
                let path = self.unescape(token);
                Ok(Some(Item::Include(Include {
                    path,
                    place: Place(self.span(token)),
                })))
            }
            "comp" => self.component(dot, doc),
            "init" => self.init(dot),
            "override" => self.overriding(dot),
            "functor" => self.functor_decl(doc).map(|decl| Some(Item::Functor(decl))),
            "once" => {
                let fault = Diagnostic::new(codes::IGNORED, "`.once` has no effect")
                    .at(span, "")
                    .note("every file is read once");
                self.faults.push(fault.remove(span));
                Ok(None)
            }
            "pragma" => {
                let mut words = Vec::new();
                while self.kind() == Kind::String {
                    let next = self.ahead(1);
                    // The probability of a clause may begin with a string, too.
                    let is_clause =
                        next.kind == Kind::DoubleColon || self.infix(next).is_some() || self.slice(next) == "as";
                    if !words.is_empty() && self.token().first_on_line && is_clause {
                        break;
                    }
                    let token = self.bump();
                    words.push(self.unescape(token));
                }
                if words.is_empty() {
                    return Err(self.expected("a quoted string"));
                }
                Ok(Some(Item::Pragma(Pragma {
                    words,
                    place: Place(span),
                })))
            }
            "plan" => {
                let orders = self.join_orders()?;
                let place = self.place_from(dot);
                if self.dropped {
                    return Ok(None);
                }
                Ok(Some(Item::Plan(Plan { orders, place })))
            }
            "scope" => {
                let named = self.names_more();
                let predicate = if named {
                    Some(self.qualified("a predicate")?)
                } else {
                    None
                };
                let place = Place(predicate.as_ref().map_or(span, |name| span.to(name.place.0)));
                Ok(Some(Item::Scope(Scope { predicate, place })))
            }
            _ => {
                if let Some(kind) = ConstraintKind::ALL.into_iter().find(|kind| kind.name() == name) {
                    return self.constraint(kind, dot);
                }
                if let Some(&(_, base)) = OLD_TYPES.iter().find(|(old, _)| *old == name) {
                    return self.type_decl(doc, Some(base)).map(|decl| Some(Item::Type(decl)));
                }
                if let Some((_, what)) = FOREIGN_DIRECTIVES.iter().find(|(foreign, _)| *foreign == name) {
                    let verb = if what.contains('(') { "are" } else { "is" };
                    self.unsupported(span, &format!("{what} {verb}"), LATTICES);
                    let declared = self.token();
                    self.skip_foreign_directive();
                    // Columns may name the type of a lattice.
                    let is_type = name == "lattice" && declared.kind == Kind::Ident;
                    return Ok(is_type.then(|| {
                        Item::Type(TypeDecl {
                            name: Name {
                                text: self.slice(declared).to_owned(),
                                place: Place(self.span(declared)),
                            },
                            definition: TypeDefinition::Faulty,
                            doc,
                        })
                    }));
                }
                let mut fault = Diagnostic::new(codes::SYNTAX, format!("unknown directive `.{name}`")).at(span, "");
                fault = match did_you_mean(name, DIRECTIVES.iter().copied()) {
                    Some(near) => fault.did_you_mean(&format!(".{near}"), &[span]),
                    None => fault.note(format!("the directives are {}", listed(DIRECTIVES))),
                };
                self.faults.push(fault);
                Err(Reported)
            }
        }
    }

    /// `0:(1,2), 1:(2,1)`
    fn join_orders(&mut self) -> Parse<Vec<(i128, Vec<i128>)>> {
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

    /// Skips the rest of a directive of Soufflé after its name: `.lattice L<> { ... }`
    fn skip_foreign_directive(&mut self) {
        while !matches!(self.kind(), Kind::LBrace | Kind::End | Kind::Preprocessor) && !self.at_known_directive() {
            self.bump();
        }
        self.skip_group(Kind::LBrace, Kind::RBrace, true);
    }

    /// `.functor f(x: number, symbol): number stateful`
    fn functor_decl(&mut self, doc: String) -> Parse<FunctorDecl> {
        let name = self.name("the functor's name")?;
        self.wanted(Kind::LParen, "`(` and the types of the arguments")?;
        let mut arguments = Vec::new();
        while self.kind() != Kind::RParen {
            let first = self.qualified("a type")?;
            arguments.push(match self.eat(Kind::Colon) {
                true => (Some(first), self.qualified("the type of the argument")?),
                false => (None, first),
            });
            if !self.eat(Kind::Comma) {
                break;
            }
        }
        self.wanted(Kind::RParen, "`,` or `)`")?;
        self.wanted(Kind::Colon, "`:` and the type of the value")?;
        let result = self.qualified("the type of the value")?;
        let word = self.token();
        let stateful = word.kind == Kind::Ident && self.slice(word) == "stateful" && self.ahead(1).kind != Kind::LParen;
        if stateful {
            self.bump();
        }
        Ok(FunctorDecl {
            name,
            arguments,
            result,
            stateful,
            doc,
        })
    }

    /// `.comp A<T> : B<T>, C { ... }`
    fn component(&mut self, dot: Token, doc: String) -> Parse<Option<Item>> {
        let name = self.name("the component's name")?;
        let parameters = self.arguments_in_angles(Self::name, "a parameter")?;
        let mut bases = Vec::new();
        if self.eat(Kind::Colon) {
            bases.push(self.component_type()?);
            while self.eat(Kind::Comma) {
                bases.push(self.component_type()?);
            }
        }
        let place = self.place_from(dot);
        let open = self.wanted(Kind::LBrace, "`{` and the declarations and clauses of the component")?;
        self.components += 1;
        if self.components > MAX_NESTING {
            let fault = Diagnostic::new(diag::codes::LIMIT_EXCEEDED, "nested too deeply").at(self.span(open), "");
            self.faults
                .push(fault.note(format!("at most {MAX_NESTING} components contain another one")));
            // Nothing within is read.
            self.at = self.tokens.len() - 1;
        }
        let mut items = Vec::new();
        while !matches!(self.kind(), Kind::End | Kind::RBrace) && !self.faults.full() {
            self.next_item(&mut items);
        }
        self.components -= 1;
        if self.kind() == Kind::RBrace {
            if self.packed.is_none() {
                self.starts.push(self.at);
            }
            self.bump();
        } else if !self.faults.full() && self.components < MAX_NESTING {
            let fault = Diagnostic::new(codes::SYNTAX, format!("the component `{}` does not end", name.text));
            self.faults.push(fault.at(self.span(open), "this `{` has no `}`"));
        }
        items.retain(|item| match item {
            Item::Include(include) => {
                let fault = Diagnostic::new(codes::UNSUPPORTED, "`.include` in a component is not supported");
                let help = "write `#include`, which puts the text of the file here";
                self.faults.push(fault.at(include.place.0, "").help(help));
                false
            }
            _ => true,
        });
        Ok(Some(Item::Component(Component {
            name,
            parameters,
            bases,
            items,
            doc,
            place,
        })))
    }

    /// `<A, B>`, or nothing.
    fn arguments_in_angles(&mut self, read: fn(&mut Self, &str) -> Parse<Name>, what: &str) -> Parse<Vec<Name>> {
        let mut names = Vec::new();
        if self.eat(Kind::Less) {
            loop {
                names.push(read(self, what)?);
                if self.eat(Kind::Greater) {
                    break;
                }
                if !self.eat(Kind::Comma) {
                    return Err(self.expected("`,` or `>`"));
                }
            }
        }
        Ok(names)
    }

    /// `B<T>`
    fn component_type(&mut self) -> Parse<ComponentType> {
        Ok(ComponentType {
            name: self.name("a component")?,
            arguments: self.arguments_in_angles(Self::qualified, "a type")?,
        })
    }

    /// `.init a = A<T>`
    fn init(&mut self, dot: Token) -> Parse<Option<Item>> {
        let name = self.name("the instance's name")?;
        self.wanted(Kind::Equal, "`=` and a component")?;
        let component = self.component_type()?;
        let place = self.place_from(dot);
        Ok(Some(Item::Init(Init { name, component, place })))
    }

    /// `.override P`
    fn overriding(&mut self, dot: Token) -> Parse<Option<Item>> {
        let names = self.names("a predicate")?;
        let place = self.place_from(dot);
        if self.components == 0 {
            let fault = Diagnostic::new(codes::SYNTAX, "`.override` outside of a component").at(place.0, "");
            self.faults
                .push(fault.help("it belongs to a component that has a base: `.comp A : B { ... }`"));
            return Ok(None);
        }
        Ok(Some(Item::Override(Override { names, place })))
    }

    /// Skips a group between brackets of one kind, if one begins at the current token. Directives belong to it only
    /// with `directives`.
    pub(super) fn skip_group(&mut self, open: Kind, close: Kind, directives: bool) {
        let mut depth = 0_usize;
        while self.kind() != Kind::End && (directives || !self.at_known_directive()) {
            match self.kind() {
                kind if kind == open => depth += 1,
                kind if kind == close => depth = depth.saturating_sub(1),
                _ => {}
            }
            if self.kind() != open && depth == 0 {
                self.eat(close);
                return;
            }
            self.bump();
        }
    }

    fn mark(&mut self, kind: MarkKind) -> Parse<Mark> {
        let names = self.names("a predicate")?;
        let mut options = Vec::new();
        if !self.drawn_clause_at(0) && self.eat(Kind::LParen) && !self.eat(Kind::RParen) {
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
            Kind::String => self.unescape(token),
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

    /// Returns whether a directive goes on with a name. A name before a parenthesis begins a clause, unless that
    /// parenthesis does.
    fn names_more(&self) -> bool {
        let is_head = self.ahead(1).kind == Kind::LParen && !self.drawn_clause_at(1);
        self.kind() == Kind::Ident && !is_head && !self.drawn_clause_at(0)
    }

    /// Commas between the names are optional.
    fn constraint(&mut self, kind: ConstraintKind, dot: Token) -> Parse<Option<Item>> {
        let mut names = vec![self.qualified("a predicate")?];
        while self.eat(Kind::Comma) || self.names_more() {
            names.push(self.qualified("a predicate")?);
        }
        let place = self.place_from(dot);
        let (good, wanted) = match kind {
            ConstraintKind::Disjoint | ConstraintKind::Covering => (names.len() >= 2, "two predicates or more"),
            ConstraintKind::Implies => (names.len() == 2, "two predicates: the premise, then the conclusion"),
            ConstraintKind::Reflexive
            | ConstraintKind::Irreflexive
            | ConstraintKind::Symmetric
            | ConstraintKind::Asymmetric => (true, ""),
        };
        if !good {
            let message = format!("`.{}` names {wanted}", kind.name());
            self.faults
                .push(Diagnostic::new(codes::SYNTAX, message).at(place.0, format!("{} here", names.len())));
            return Ok(None);
        }
        Ok(Some(Item::Constraint(ConstraintDecl { kind, names, place })))
    }

    fn decl(&mut self, doc: String) -> Parse<Decl> {
        let mut names = vec![self.name("the predicate's name")?];
        while self.eat(Kind::Comma) {
            names.push(self.name("the predicate's name")?);
        }
        let start = self.at - 1;
        let first = names[0].text.clone();
        if self.kind() == Kind::Equal && self.slice(self.ahead(1)) == "debug_delta" {
            // `.decl D = debug_delta(P)`
            self.bump();
            let word = self.bump();
            self.unsupported(self.span(word), "`debug_delta` is", "remove the declaration");
            self.skip_group(Kind::LParen, Kind::RParen, false);
            return Ok(Decl {
                names,
                columns: None,
                qualifiers: Vec::new(),
                choices: Vec::new(),
                doc,
            });
        }
        let read = self.columns(&first);
        let readable = read.is_ok();
        let columns = read.unwrap_or_else(|Reported| {
            self.recover(start);
            None
        });
        if let Some(name) = names
            .iter()
            .find(|name| matches!(name.text.as_str(), "match" | "contains"))
        {
            let fault = Diagnostic::new(codes::SYNTAX, format!("`{}` is not a predicate's name", name.text))
                .at(name.place.0, "")
                .note("it is a comparison of strings");
            self.faults.push(fault);
        }
        let (mut qualifiers, mut choices) = (Vec::new(), Vec::new());
        while readable && self.names_more() {
            if self.at_choice() {
                choices.extend(self.choices()?);
                continue;
            }
            if !QUALIFIERS.contains(&self.slice(self.token())) {
                match self.foreign_qualifier() {
                    true => continue,
                    false => break,
                }
            }
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
        Ok(Decl {
            names,
            columns,
            qualifiers,
            choices,
            doc,
        })
    }

    fn at_choice(&self) -> bool {
        self.slice(self.token()) == "choice"
            && self.ahead(1).kind == Kind::Minus
            && self.slice(self.ahead(2)) == "domain"
    }

    /// `choice-domain x, (y, z)`
    fn choices(&mut self) -> Parse<Vec<Vec<Name>>> {
        (0..3).for_each(|_| _ = self.bump());
        let mut choices = Vec::new();
        loop {
            let mut columns = Vec::new();
            if self.eat(Kind::LParen) {
                loop {
                    columns.push(self.name("a column")?);
                    if !self.eat(Kind::Comma) {
                        break;
                    }
                }
                self.wanted(Kind::RParen, "`,` or `)`")?;
            } else {
                columns.push(self.name("a column, or `(` and columns")?);
            }
            choices.push(columns);
            if !self.eat(Kind::Comma) {
                return Ok(choices);
            }
        }
    }

    /// Parses the columns of the predicate `of`. `None` if one has the type of a lattice.
    fn columns(&mut self, of: &str) -> Parse<Option<Vec<ColumnDecl>>> {
        let mut columns = Vec::new();
        let mut known = true;
        let open = self.at;
        if !self.eat(Kind::LParen) {
            return Err(self.expected("`(` and the columns"));
        }
        if self.eat(Kind::RParen) {
            return Ok(Some(columns));
        }
        loop {
            let name = self.name("a column's name")?;
            if !self.eat(Kind::Colon) {
                let help = self.with_types(of, open);
                return Err(self.expected_with("`:` and the column's type", help.as_deref()));
            }
            let ty = self.qualified("a type")?;
            if self.kind() == Kind::Less && self.ahead(1).kind == Kind::Greater {
                let span = self.span(self.token()).to(self.span(self.ahead(1)));
                self.bump();
                self.bump();
                self.unsupported(span, "lattices (`<>`) are", LATTICES);
                known = false;
            }
            columns.push(ColumnDecl { name, ty });
            if self.eat(Kind::RParen) {
                return Ok(known.then_some(columns));
            }
            if !self.eat(Kind::Comma) {
                return Err(self.expected("`,` or `)`"));
            }
        }
    }

    /// Parses the fields of a record up to the bracket or brace that closes them.
    fn fields(&mut self, close: Kind) -> Parse<Vec<ColumnDecl>> {
        let mut fields = Vec::new();
        if self.eat(close) {
            return Ok(fields);
        }
        loop {
            let name = self.name("a field's name")?;
            if !self.eat(Kind::Colon) {
                return Err(self.expected("`:` and the field's type"));
            }
            let ty = self.qualified("a type")?;
            fields.push(ColumnDecl { name, ty });
            if self.eat(close) {
                return Ok(fields);
            }
            if !self.eat(Kind::Comma) {
                return Err(self.expected(match close {
                    Kind::RBracket => "`,` or `]`",
                    _ => "`,` or `}`",
                }));
            }
        }
    }

    /// Parses the branches of an algebraic data type behind the name of the first one.
    fn branches(&mut self, first: Name) -> Parse<Vec<Branch>> {
        let mut branches = Vec::new();
        let mut name = first;
        loop {
            if !self.eat(Kind::LBrace) {
                return Err(self.expected("`{` and the fields of the branch"));
            }
            let fields = self.fields(Kind::RBrace)?;
            branches.push(Branch { name, fields });
            if !self.eat(Kind::Pipe) {
                return Ok(branches);
            }
            name = self.name("the name of a branch")?;
        }
    }

    /// Returns the help for a declaration whose columns, after the parenthesis at token `open`, lack their types.
    /// `None` if they are more than names.
    fn with_types(&self, of: &str, open: usize) -> Option<String> {
        // The parser does not know which types are declared. The vocabulary of the city declares `agent`.
        let usual = if self.text.contains("vocabulary.dl") {
            "agent"
        } else {
            BaseType::Symbol.name()
        };
        let is_type = |word: &str| word == "agent" || BaseType::ALL.iter().any(|base| base.name() == word);
        let mut columns = Vec::new();
        let mut rest = self.tokens[open + 1..].iter();
        loop {
            let name = rest
                .next()
                .filter(|token| token.kind == Kind::Ident)
                .map(|token| self.slice(*token))?;
            let mut next = rest.next()?.kind;
            columns.push(match next {
                Kind::Colon => {
                    let ty = rest.next()?;
                    next = rest.next()?.kind;
                    format!("{name}: {}", self.slice(*ty))
                }
                _ if is_type(name) => format!("x{}: {name}", columns.len() + 1),
                _ => format!("{name}: {usual}"),
            });
            match next {
                Kind::Comma => {}
                Kind::RParen => break,
                _ => return None,
            }
        }
        Some(format!(
            "give each column a type, for example `.decl {of}({})`",
            columns.join(", ")
        ))
    }

    /// Skips and reports a qualifier of Soufflé that the language does not have: `provenance`. Returns whether there is
    /// one.
    fn foreign_qualifier(&mut self) -> bool {
        let word = self.token();
        if !matches!(self.slice(word), "provenance" | "override") {
            return false;
        }
        self.bump();
        let what = format!("the qualifier `{}` is", self.slice(word));
        // They concern only storage.
        self.unsupported(self.span(word), &what, "remove it");
        true
    }

    /// Parses the rest of a `.type`. `old` is the base type that an old notation, such as `.number_type`, implies.
    fn type_decl(&mut self, doc: String, old: Option<BaseType>) -> Parse<TypeDecl> {
        let name = self.name("the type's name")?;
        let start = self.at - 1;
        let defines = matches!(self.kind(), Kind::Subtype | Kind::Equal);
        let next_item = self.directive_ahead().is_some() || self.ahead(1).kind == Kind::LParen;
        let ends = !defines && (self.token().first_on_line || self.kind() == Kind::End || next_item);
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
        let fault = Diagnostic::new(codes::OLD_FORM, "an old form of `.type`")
            .at(name.place.0, "")
            .help(format!(
                "write `.type {name} <: {base}`, or `.type {name} = {base}` if it takes any {base}",
                name = name.text,
                base = base.name()
            ));
        self.faults.push(fault);
        TypeDefinition::Subtype(Name {
            text: base.name().to_owned(),
            place: name.place,
        })
    }

    fn type_definition(&mut self) -> Parse<TypeDefinition> {
        if self.eat(Kind::Subtype) {
            return Ok(TypeDefinition::Subtype(self.qualified("a type")?));
        }
        if !self.eat(Kind::Equal) {
            return Err(self.expected("`<:` or `=` and a type"));
        }
        if self.eat(Kind::LBracket) {
            return Ok(TypeDefinition::Record(self.fields(Kind::RBracket)?));
        }
        let mut members = Vec::new();
        loop {
            members.push(self.qualified("a type")?);
            // `A {x: number} | B {}`
            if self.kind() == Kind::LBrace && members.len() == 1 {
                return Ok(TypeDefinition::Branches(self.branches(members.remove(0))?));
            }
            if !self.eat(Kind::Pipe) {
                break;
            }
        }
        Ok(match members.len() {
            1 => TypeDefinition::Alias(members.remove(0)),
            _ => TypeDefinition::Union(members),
        })
    }
}

fn listed(names: &[&str]) -> String {
    let quoted: Vec<String> = names.iter().map(|name| format!("`.{name}`")).collect();
    quoted.join(", ")
}
