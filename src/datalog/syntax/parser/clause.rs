//! Clauses and queries: heads, atoms, comparisons, conjunction, disjunction and negation.

use crate::codes;
use crate::diag::Diagnostic;
use crate::syntax::ast::Comparison;
use crate::syntax::ast::{Atom, Clause, Item, Literal, Operator, Place, Subsumption, Term, TermKind};
use crate::syntax::functor::{AggregateOp, Functor};
use crate::syntax::lexer::{CONJUNCTION, DISJUNCTION, IMPLICATION, Kind, NEGATION, Token};

use crate::syntax::parser::{DIRECTIVES, FULL_STOP, MAX_NESTING, PAST, Parse, Parser, Reported};

/// What follows the name of a predicate that begins a clause.
const HEAD: &str = "the arguments of the head: `(`";

impl Parser<'_> {
    /// Returns whether the current tokens are `?-`, without a space: `? - a` subtracts.
    fn at_question(&self) -> bool {
        self.kind() == Kind::Ident
            && self.slice(self.token()) == "?"
            && self.ahead(1).kind == Kind::Minus
            && self.token().end == self.ahead(1).start
    }

    pub(super) fn question(&mut self) -> Parse<(Vec<Literal>, Place)> {
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

    pub(super) fn clause(&mut self, doc: String) -> Parse<Item> {
        let start = self.token();
        if self.is_negation(start) {
            return Err(self.expected_item(" (a head cannot be negated)"));
        }
        if self.at_question() {
            let help = "mark a predicate as output with `.output`, or enter the query in `logicity repl`";
            return Err(self.unsupported(self.span(start), "queries (`?-`) are", help));
        }
        let (heads, probabilities) = match self.is_drawn() {
            true => self.alternatives()?,
            false => (self.heads()?, Vec::new()),
        };
        let mut body = Vec::new();
        match self.kind() {
            Kind::LessEqual => {
                let sign = self.bump();
                let mut heads = heads;
                let stronger = self.atom("the arguments of the atom: `(`")?;
                let place = self.span(sign);
                let (Some(weaker), true, true) = (heads.pop(), heads.is_empty(), probabilities.is_empty()) else {
                    let fault = Diagnostic::new(codes::SYNTAX, "`<=` after several heads").at(place, "");
                    self.faults.push(fault.help("write one subsumption for each of them"));
                    return Err(Reported);
                };
                if weaker.predicate.text != stronger.predicate.text || self.kind() != Kind::If {
                    let fault = Diagnostic::new(codes::SYNTAX, "`<=` between heads is no implication").at(place, "");
                    let help = format!(
                        "{IMPLICATION}; a subsumption is about two rows of one predicate, as in \
                         `A(x, n) <= A(x, m) :- m < n.`"
                    );
                    self.faults.push(fault.help(help));
                    return Err(Reported);
                }
                self.bump();
                let body = self.disjunction()?;
                self.full_stop("`,` or `.`", start)?;
                return Ok(Item::Subsumption(Subsumption {
                    weaker,
                    stronger,
                    body,
                    doc,
                    place: self.place_from(start),
                }));
            }
            kind if kind == Kind::If || self.skip_foreign(IMPLICATION, "`:-`") => {
                self.eat(Kind::If);
                body = self.disjunction()?;
                if body.is_empty() {
                    // `A(x) :- true.` is a rule, not a fact.
                    body.push(Literal::Any(vec![Vec::new()]));
                }
                self.full_stop("`,` or `.`", start)?;
            }
            _ => self.full_stop("`:-` or `.`", start)?,
        }
        Ok(Item::Clause(Clause {
            heads,
            probabilities,
            body,
            doc,
            place: self.place_from(start),
        }))
    }

    /// `A(x), B(x)`
    fn heads(&mut self) -> Parse<Vec<Atom>> {
        let mut heads = vec![self.atom(HEAD)?];
        while self.eat(Kind::Comma) {
            heads.push(self.atom(HEAD)?);
        }
        Ok(heads)
    }

    /// Returns whether the heads of the clause that begins here have probabilities: `0.8 :: A(x)`.
    pub(super) fn is_drawn(&self) -> bool {
        self.next_draw(self.at).is_some()
    }

    /// Returns whether a clause with a probability begins at offset `ahead`, on a line of its own.
    pub(super) fn drawn_clause_at(&self, ahead: usize) -> bool {
        let from = self.at + ahead;
        let probability = self.next_draw(from).map(|at| &self.tokens[from..at]);
        probability.is_some_and(|all| {
            all.first().is_some_and(|first| first.first_on_line) && !all[1..].iter().any(|token| token.first_on_line)
        })
    }

    /// Returns the position of the next `::`, if no head ends before it.
    fn next_draw(&self, from: usize) -> Option<usize> {
        let next = self.draws.partition_point(|(at, _)| *at < from);
        let (at, end) = *self.draws.get(next)?;
        end.is_none_or(|end| end < from).then_some(at)
    }

    /// `0.3 :: A(x); 0.7 :: B(x)`
    fn alternatives(&mut self) -> Parse<(Vec<Atom>, Vec<Term>)> {
        let (mut heads, mut probabilities) = (Vec::new(), Vec::new());
        loop {
            if self.is_bare_fraction() {
                return Err(self.bare_fraction());
            }
            if !self.is_drawn() {
                return Err(self.expected_with("a probability and `::`", Some(EACH_HEAD)));
            }
            probabilities.push(self.term()?);
            if !self.eat(Kind::DoubleColon) {
                let [comma, fraction, colons] = [0, 1, 2].map(|count| self.ahead(count));
                if [self.previous().kind, comma.kind, fraction.kind, colons.kind]
                    == [Kind::Number, Kind::Comma, Kind::Number, Kind::DoubleColon]
                {
                    return Err(self.decimal_comma("`::`", self.previous(), fraction));
                }
                return Err(self.expected_with("`::`", Some(EACH_HEAD)));
            }
            heads.push(self.atom(HEAD)?);
            if self.kind() == Kind::Comma {
                return Err(self.expected_with("`;`, `:-` or `.`", Some(ONE_HEAD)));
            }
            if !self.eat(Kind::Semicolon) {
                return Ok((heads, probabilities));
            }
        }
    }

    /// Reads a full stop. If nothing but the full stop is missing, reports it and keeps the clause that began at
    /// `start`.
    fn full_stop(&mut self, what: &str, start: Token) -> Parse<()> {
        let token = self.token();
        // An indented line is more likely a literal after a missing comma.
        let next_clause = token.kind == Kind::Ident && token.first_on_line && self.indent(token) <= self.indent(start);
        if self.at_known_directive() || token.kind == Kind::End || next_clause {
            self.expected_with(what, Some(FULL_STOP));
            return Ok(());
        }
        if self.eat(Kind::Dot) {
            return Ok(());
        }
        let help = match token.kind {
            Kind::RParen => Some(SURPLUS),
            Kind::Ident if self.follows_operator() => Some(WINDOW),
            _ => self.habit(),
        };
        Err(self.expected_with(what, help))
    }

    pub(super) fn atom(&mut self, open: &str) -> Parse<Atom> {
        let start = self.token();
        let predicate = self.qualified("a predicate")?;
        if !self.eat(Kind::LParen) {
            let clause = (open == HEAD).then_some("a clause is `Head(x) :- Body(x, y), !Other(y).`");
            let help = self.habit().or(clause);
            return Err(self.expected_with(open, help));
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

    /// `A(x), B(x); C(x)`
    pub(super) fn disjunction(&mut self) -> Parse<Vec<Literal>> {
        let mut alternatives = vec![self.conjunction()?];
        while self.eat(Kind::Semicolon) || self.skip_foreign(DISJUNCTION, "`;`") {
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
        while self.eat(Kind::Comma) || self.skip_foreign(CONJUNCTION, "`,`") {
            all.append(&mut self.literals()?);
        }
        Ok(all)
    }

    /// A literal or a parenthesized body, optionally negated.
    fn literals(&mut self) -> Parse<Vec<Literal>> {
        let outside = self.nesting;
        let mut negated = false;
        loop {
            let token = self.token();
            if self.is_cut() {
                self.unsupported(self.span(token), "the cut `!` is", CUT);
                self.bump();
                return Ok(Vec::new());
            }
            match token.kind {
                Kind::Bang => negated = !negated,
                Kind::Ident if self.is_negation(token) => negated = !negated,
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

    /// Returns whether the current token is Prolog's cut: a `!` with nothing to negate.
    fn is_cut(&self) -> bool {
        let ends = matches!(
            self.ahead(1).kind,
            Kind::Comma | Kind::Semicolon | Kind::Dot | Kind::End
        );
        self.kind() == Kind::Bang && ends
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

    /// Returns the token after the `)` that matches the `(` at offset `ahead`, if the clause extends that far.
    pub(super) fn after_parenthesis(&self, ahead: usize) -> Option<Token> {
        let mut depth = 0_usize;
        for (at, &token) in self.tokens.iter().enumerate().skip(self.at + ahead) {
            match token.kind {
                Kind::LParen => depth += 1,
                Kind::RParen => depth = depth.checked_sub(1)?,
                // Parentheses contain neither the end of a clause nor the start of a body.
                Kind::Dot | Kind::If | Kind::End => return None,
                _ => {}
            }
            if depth == 0 {
                return self.tokens.get(at + 1).copied();
            }
        }
        None
    }

    /// Returns whether the parenthesis at offset `ahead` is an operand of a comparison or operator.
    pub(super) fn is_operand_in_parentheses(&self, ahead: usize) -> bool {
        self.after_parenthesis(ahead)
            .is_some_and(|after| comparison(after.kind).is_some() || self.infix(after).is_some())
    }

    fn atom_or_comparison(&mut self) -> Parse<Vec<Literal>> {
        let (start, next) = (self.token(), self.ahead(1));
        if self.is_quantifier() {
            return Err(self.quantifier());
        }
        if self.is_applied_aggregate() {
            return Err(self.applied_aggregate(start));
        }
        if let Some(operator) = self.operator_ahead() {
            return Ok(vec![self.temporal(start, operator, None)?]);
        }
        if self.is_misplaced_operator() {
            return Err(self.misplaced_operator());
        }
        if start.kind == Kind::Ident && next.kind == Kind::LParen && !self.is_term_with_parentheses() {
            return match self.atom_or_symbol_test()? {
                Literal::Atom { atom, .. } if self.since_ahead() => {
                    Ok(vec![self.temporal(start, Operator::Since, Some(atom))?])
                }
                literal => Ok(vec![literal]),
            };
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
        if self.is_component_atom(0) {
            let atom = self.atom("`(`")?;
            return Ok(vec![match self.since_ahead() {
                true => self.temporal(start, Operator::Since, Some(atom))?,
                false => Literal::Atom { negated: false, atom },
            }]);
        }
        Ok(vec![self.comparison()?])
    }

    /// `A(x)`, `match(x, y)`
    fn atom_or_symbol_test(&mut self) -> Parse<Literal> {
        let start = self.token();
        let op = match self.slice(self.token()) {
            "match" => Some(Comparison::Match),
            "contains" => Some(Comparison::Contains),
            _ => None,
        };
        let mut atom = self.atom("`(`")?;
        let Some(op) = op else {
            let after = self.token();
            if self.since_ahead() {
                return Ok(Literal::Atom { negated: false, atom });
            }
            if after.kind == Kind::LParen && !after.first_on_line {
                let help = "the name of a predicate is one word, as in `IsCar(X)`; literals are separated by commas";
                return Err(self.expected_with("`,` or `.`", Some(help)));
            }
            if comparison(after.kind).is_some() || self.infix(after).is_some() {
                if AggregateOp::named(self.slice(start)).is_some() {
                    return Err(self.applied_aggregate(start));
                }
                let message = format!("there is no functor `{}`", atom.predicate.text);
                let fault = Diagnostic::new(codes::UNKNOWN_FUNCTOR, message).at(atom.place.0, "");
                self.faults
                    .push(fault.help("an atom has no value to compare; if it is a macro, include its file"));
                return Err(Reported);
            }
            return Ok(Literal::Atom { negated: false, atom });
        };
        let (Some(right), Some(left), 0) = (atom.terms.pop(), atom.terms.pop(), atom.terms.len()) else {
            let message = format!("`{}` takes 2 arguments", atom.predicate.text);
            let fault = Diagnostic::new(codes::ARITY_MISMATCH, message)
                .at(atom.place.0, "expected a pattern or part, then a string");
            self.faults.push(fault);
            return Err(Reported);
        };
        let place = atom.place;
        Ok(Literal::Compare { op, left, right, place })
    }

    /// Returns whether an atom `a.b(...)` of a component begins at offset `ahead`.
    pub(super) fn is_component_atom(&self, from: usize) -> bool {
        let is_part = |ahead: usize| {
            let ahead = from + ahead;
            let (name, dot, part) = (self.ahead(ahead), self.ahead(ahead + 1), self.ahead(ahead + 2));
            [name.kind, dot.kind, part.kind] == [Kind::Ident, Kind::Dot, Kind::Ident]
                && name.end == dot.start
                && dot.end == part.start
                && !DIRECTIVES.contains(&self.slice(part))
        };
        let last = (0..MAX_NESTING).map(|part| 2 * part).find(|&ahead| !is_part(ahead));
        last.is_some_and(|last| last > 0 && self.ahead(from + last + 1).kind == Kind::LParen)
    }

    /// `x < y + 1`
    fn comparison(&mut self) -> Parse<Literal> {
        let start = self.token();
        let begins = matches!(
            start.kind,
            Kind::Dollar | Kind::At | Kind::LBracket | Kind::Faulty | Kind::OpenString | Kind::Hash
        );
        if self.is_bare_fraction() {
            return Err(self.bare_fraction());
        }
        if !begins && !self.begins_operand(start) && start.kind != Kind::Ident {
            return Err(self.expected("a literal"));
        }
        let left = self.term()?;
        let Some(op) = comparison(self.kind()) else {
            let before = |count: usize| self.at.checked_sub(count).map(|at| self.tokens[at]);
            return Err(match (left.kind, before(3), before(2)) {
                // `x < 0,8`
                (TermKind::Number(_), Some(whole), Some(comma))
                    if (whole.kind, comma.kind) == (Kind::Number, Kind::Comma)
                        && whole.end == comma.start
                        && comma.end == start.start =>
                {
                    self.decimal_comma("a comparison operator", whole, start)
                }
                (TermKind::Variable(_), ..) => self.lonely_name(start),
                _ => self.expected("a comparison operator"),
            });
        };
        self.bump();
        let right = self.term()?;
        let place = self.place_from(start);
        Ok(Literal::Compare { op, left, right, place })
    }

    /// Returns whether a quantifier of logic begins here: `forall(A(y), B(x, y))`, `forall(y, A(y))`, `exists y: A(y)`.
    fn is_quantifier(&self) -> bool {
        let next = self.ahead(1);
        let is_word = FOR_ALL.contains(&self.slice(self.token())) || EXISTS.contains(&self.slice(self.token()));
        let names_variable =
            self.ahead(2).kind == Kind::Ident && matches!(self.ahead(3).kind, Kind::Comma | Kind::Colon);
        let is_applied =
            next.kind == Kind::LParen && (self.is_atom_ahead(2) || (names_variable && self.is_atom_ahead(4)));
        is_word && (is_applied || (next.kind == Kind::Ident && self.infix(next).is_none() && !next.first_on_line))
    }

    /// Reports a quantifier.
    fn quantifier(&mut self) -> Reported {
        let word = self.token();
        let without_variable = |text| -> &str {
            let (name, rest) = str::split_once(text, ':').unwrap_or(("", text));
            if name.contains('(') { text } else { rest.trim() }
        };
        let arguments: Vec<&str> = (self.arguments_of(word).into_iter())
            .map(without_variable)
            .filter(|literal| literal.contains('('))
            .collect();
        let negated = matches!(
            (
                self.at.checked_sub(1).map(|at| self.tokens[at].kind),
                self.at.checked_sub(2)
            ),
            (Some(Kind::Bang), _)
        ) || self.at >= 2
            && self.previous().kind == Kind::LParen
            && matches!(self.slice(self.tokens[self.at - 2]), "Not" | "not" | "!");
        let help = match (FOR_ALL.contains(&self.slice(word)), arguments.as_slice()) {
            (true, [condition, conclusion]) => {
                format!("count the exceptions: `count : {{ {condition}, Not({conclusion}) }} = 0`")
            }
            (true, [conclusion]) => {
                format!("count the exceptions among some `A`: `count : {{ A(y), Not({conclusion}) }} = 0`")
            }
            (true, _) => "count the exceptions: `count : { A(y), Not(B(x, y)) } = 0`".to_owned(),
            (false, _) if negated => {
                let body = if arguments.is_empty() {
                    "A(y), B(x, y)".to_owned()
                } else {
                    arguments.join(", ")
                };
                format!("\"none exists\" is `count : {{ {body} }} = 0`")
            }
            (false, []) => "write the literals alone: variables that occur only in the body are existential".to_owned(),
            (false, arguments) => format!(
                "write `{}` alone: variables that occur only in the body are existential",
                arguments.join(", ")
            ),
        };
        let message = format!("the quantifier `{}` is not part of the language", self.slice(word));
        self.faults.push(
            Diagnostic::new(codes::SYNTAX, message)
                .at(self.span(word), "")
                .help(help),
        );
        Reported
    }

    /// Returns whether the token at offset `ahead` begins an atom, negated or not, as opposed to a function.
    pub(super) fn is_atom_ahead(&self, ahead: usize) -> bool {
        let first = self.ahead(ahead);
        let skipped = usize::from(first.kind == Kind::Bang);
        let (name, next) = (self.ahead(ahead + skipped), self.ahead(ahead + skipped + 1));
        let is_function = Functor::words().any(|word| word == self.slice(name)) || self.slice(name) == "as";
        name.kind == Kind::Ident
            && ((next.kind == Kind::LParen && !is_function) || self.is_component_atom(ahead + skipped))
    }

    /// Returns the texts of the arguments of `name(...)`; empty if the parenthesis is not closed in this clause.
    pub(super) fn arguments_of(&self, name: Token) -> Vec<&str> {
        let Some(open) = self.tokens[self.at..].iter().find(|token| token.kind == Kind::LParen) else {
            return Vec::new();
        };
        let (mut depth, mut from, mut found) = (0_usize, open.end as usize, Vec::new());
        if open.start != name.end {
            return found;
        }
        for token in self.tokens[self.at..].iter().skip(1) {
            let ends = |found: &mut Vec<_>| found.push(self.text[from..token.start as usize].trim());
            match token.kind {
                Kind::LParen | Kind::LBrace => depth += 1,
                Kind::RParen | Kind::RBrace => {
                    depth = depth.saturating_sub(1);
                    if depth == 0 {
                        ends(&mut found);
                        return found;
                    }
                }
                Kind::Comma if depth == 1 => {
                    ends(&mut found);
                    from = token.end as usize;
                }
                Kind::Dot | Kind::If | Kind::End => return Vec::new(),
                _ => {}
            }
        }
        Vec::new()
    }

    /// Reports a name that is neither part of an atom nor of a comparison.
    fn lonely_name(&mut self, name: Token) -> Reported {
        let text = self.slice(name);
        let next = self.token();
        let help = match next.kind {
            _ if self.habit().is_some() => self.habit().unwrap_or_default().to_owned(),
            Kind::Number if matches!(text, "once" | "historically" | "for") => {
                let window = if text == "for" { "" } else { "0," };
                format!("the window is in brackets: `{text}[{window}{}] P(X)`", self.slice(next))
            }
            Kind::Ident if self.near_operator(name).is_some() => {
                let near = self.near_operator(name).unwrap_or_default();
                format!("did you mean the temporal operator `{near}`?")
            }
            Kind::Ident if matches!(text, "next" | "future") => PAST.to_owned(),
            Kind::Ident | Kind::Underscore => {
                format!("put arguments in parentheses: `{text}({})`", self.slice(next))
            }
            _ => format!("a predicate without arguments is written `{text}()`"),
        };
        let fault = Diagnostic::new(codes::SYNTAX, format!("`{text}` is not a literal"))
            .at(self.span(name), "expected an atom or a comparison")
            .help(help);
        self.faults.push(fault);
        Reported
    }
}

/// Help for a parenthesis that closes nothing.
const SURPLUS: &str = "each `(` is closed before this `)`: remove it";

/// Help for a window in parentheses.
const WINDOW: &str = "the window of a temporal operator is in brackets: `once[1,10] P(x)`";

/// Help for clauses in which only some heads have a probability.
const EACH_HEAD: &str = "each head of such a clause has a probability: `0.3 :: A(x); 0.7 :: B(x) :- C(x).`";

/// Help for several heads with one probability.
const ONE_HEAD: &str = "`;` separates alternatives, of which at most one is drawn; for several consequences of one draw, \
                        draw a predicate of its own and derive them from it";

/// The words for the quantifiers in logic and other languages.
const FOR_ALL: &[&str] = &["forall", "forAll", "Forall", "ForAll", "FORALL", "foreach"];
const EXISTS: &[&str] = &["exists", "Exists", "EXISTS", "exist", "some"];

/// Help for programs that use a cut.
const CUT: &str = "Datalog derives all answers and ignores the order of clauses; to exclude what another clause covers, \
                   negate it: `Not(A(x))`";

pub(super) fn comparison(kind: Kind) -> Option<Comparison> {
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

/// Negates a conjunction.
pub(crate) fn negate(mut all: Vec<Literal>) -> Vec<Literal> {
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
        Literal::Temporal { negated, temporal } => vec![Literal::Temporal {
            negated: !negated,
            temporal,
        }],
        Literal::Any(alternatives) => alternatives.into_iter().flat_map(negate).collect(),
    }
}
