//! A program in the making: texts that are added to and taken from, and questions about what they declare.
//!
//! ```text
//! ?- Path(x, y), y > 3.    becomes    .decl ?-(x: number, y: number)    ?-(x, y) :- Path(x, y), y > 3.
//! ```
//!
//! A question is checked as a program of its own, in which every declared predicate is input. So asking needs no clause of the
//! program to be looked at again, and everything that is allowed in a body is allowed in a question.

use std::collections::HashSet;

use crate::diag::{Code, Diagnostic, Faults, SourceId, Sources, Span};
use crate::files::ReadFile;
use crate::symbol::{Symbol, Symbols};

use crate::datalog::check::clause;
use crate::datalog::check::clause::{names_in, names_of};
use crate::datalog::check::witness::{renamed, renamed_term};
use crate::datalog::check::{self as rules, Comparing, RelId, Rules};
use crate::datalog::check::{Edb, check, inline, names};
use crate::datalog::syntax::ast::BaseType;
use crate::datalog::syntax::ast::{
    Atom, Clause, ColumnDecl, Decl, Item, Literal, Mark, MarkKind, Name, Place, Term, TermKind,
};
use crate::datalog::syntax::include;
use crate::datalog::syntax::include::Gathered;
use crate::datalog::syntax::lexer;
use crate::datalog::syntax::lexer::Kind;
use crate::datalog::syntax::parser;
use crate::datalog::value::Value;

/// The predicate of the rows that answer a question.
const ANSWER: &str = "?-";

/// What [`load`] gives.
#[derive(Clone, Debug)]
pub struct Loaded {
    /// The rules; `None` if a diagnostic is an error.
    pub rules: Option<Rules>,
    /// Errors and warnings of all files, in the order of the text.
    pub diagnostics: Vec<Diagnostic>,
    /// What looking for clauses that derive nothing new took.
    pub compared: Comparing,
}

impl Loaded {
    /// No rules, because of these faults.
    fn failed(diagnostics: Vec<Diagnostic>) -> Self {
        Loaded {
            rules: None,
            diagnostics,
            compared: Comparing::default(),
        }
    }
}

/// Reads and checks the rules of `entry`, a text of `sources`, and of all it includes.
///
/// `.include "x"` asks `read` for `x` in the folder of the including text (whose path is its name in `sources`); if that is
/// not found, for the path [`BUILTIN_FOLDER`](crate::files::BUILTIN_FOLDER)`/x`, at which the caller may serve rule files of its own.
/// Included texts are added to `sources`.
pub fn load(sources: &mut Sources, entry: SourceId, read: &dyn ReadFile) -> Loaded {
    load_with(sources, entry, read, Edb::Fixed)
}

/// As [`load`], with a choice of what an `.input` is.
pub fn load_with(sources: &mut Sources, entry: SourceId, read: &dyn ReadFile, inputs: Edb) -> Loaded {
    let mut workspace = Workspace::new(inputs);
    workspace.add(sources, entry, read);
    workspace.check()
}

/// The texts of a program, read and not yet checked.
#[derive(Clone, Debug, Default)]
pub struct Workspace {
    gathered: Gathered,
    inputs: Edb,
    faults: Faults,
}

/// A fact as it is asked about: a value for each column, or any.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FactPattern {
    /// The predicate.
    pub relation: RelId,
    /// By column; `None` for `_`.
    pub values: Vec<Option<Value>>,
}

/// A predicate and one of its rows.
pub type FactRow = (RelId, Vec<Value>);

impl Workspace {
    /// The name of the predicate, in the rules that [`Workspace::ask`] gives, whose rows are the answer.
    pub const ANSWER: &str = ANSWER;

    /// None yet.
    pub fn new(inputs: Edb) -> Self {
        Workspace {
            inputs,
            ..Workspace::default()
        }
    }

    /// Adds a text of `sources` and all it includes, as [`load`](crate::datalog::workspace::load) does. A file that is there already is not read again.
    pub fn add(&mut self, sources: &mut Sources, entry: SourceId, read: &dyn ReadFile) {
        include::gather(&mut self.gathered, sources, entry, read, &mut self.faults);
    }

    /// The rules that the texts make, or all their faults.
    pub fn check(&self) -> Loaded {
        let mut faults = self.faults.clone();
        let (rules, compared) = check(
            &self.gathered.items,
            !self.gathered.incomplete,
            self.inputs,
            Symbols::new(),
            &mut faults,
        );
        Loaded {
            rules,
            diagnostics: faults.finish(),
            compared,
        }
    }

    /// Where the heads of a clause stand, whatever the names of its variables and its comments.
    pub fn find(&self, clause: &Clause) -> Vec<Span> {
        let wanted = canonical(clause);
        let found = self.gathered.items.iter().filter_map(|item| match item {
            Item::Clause(clause) if canonical(clause) == wanted => Some(clause),
            _ => None,
        });
        found
            .flat_map(|clause| &clause.heads)
            .map(|head| head.place.0)
            .collect()
    }

    /// Takes out the heads that stand in these places, and clauses that have no others.
    pub fn remove_heads(&mut self, places: &HashSet<Span>) {
        for item in &mut self.gathered.items {
            if let Item::Clause(clause) = item {
                clause.heads.retain(|head| !places.contains(&head.place.0));
            }
        }
        (self.gathered.items).retain(|item| !matches!(item, Item::Clause(clause) if clause.heads.is_empty()));
    }

    /// The rules that answer a question: the body of a clause, which may be preceded by `?-`. They speak of the declared predicates,
    /// which are all input and have the ids that [`Workspace::check`] gives them; the answer is the predicate [`Workspace::ANSWER`], with
    /// a column for each variable that stands outside of aggregates and does not begin with `_`. `symbols` are those of the rows
    /// that will be given. No `.scope` holds.
    ///
    /// The texts themselves must be without errors.
    pub fn ask(&self, sources: &Sources, question: SourceId, symbols: Symbols) -> Loaded {
        let mut faults = Faults::default();
        let parsed = parser::parse_question(question, sources.text(question), &mut faults);
        match parsed.filter(|_| !faults.failed()) {
            Some((body, place)) => self.answer(&body, place, symbols),
            None => Loaded::failed(faults.finish()),
        }
    }

    /// Reads a fact that is asked about, such as `Path(1, _)`, whose texts are added to `symbols`. The full stop may be missing.
    ///
    /// # Errors
    /// All that is wrong with it.
    pub fn fact(
        &self,
        sources: &Sources,
        question: SourceId,
        symbols: &Symbols,
    ) -> Result<FactPattern, Vec<Diagnostic>> {
        let mut faults = Faults::default();
        let parsed = parser::parse_question(question, sources.text(question), &mut faults);
        let Some((body, place)) = parsed.filter(|_| !faults.failed()) else {
            return Err(faults.finish());
        };
        let [Literal::Atom { negated: false, atom }] = body.as_slice() else {
            let fault = Diagnostic::new(Code::INVALID_FACT, "this is not one fact");
            return Err(vec![fault.at(place.0, "expected a predicate and its values")]);
        };
        for term in &atom.terms {
            let mut variable = None;
            names_of(term, true, &mut |name| {
                variable.get_or_insert(name);
            });
            if let Some(name) = variable {
                let fault = Diagnostic::new(Code::INVALID_FACT, format!("`{name}` is a variable, not a value"));
                let help = format!("texts stand in double quotes: `\"{name}\"`; `_` is any value");
                faults.push(fault.at(term.place.0, "").help(help));
            }
        }
        if faults.failed() {
            return Err(faults.finish());
        }
        let loaded = self.answer(&body, place, Symbols::new());
        let Some(rules) = loaded.rules else {
            return Err(loaded.diagnostics);
        };
        let answer = rules.relation(ANSWER);
        let clause = rules.clauses.iter().find(|clause| Some(clause.head.relation) == answer);
        match clause.map(|clause| clause.body.as_slice()) {
            Some([rules::Literal::Positive(atom)]) => Ok(FactPattern {
                relation: atom.relation,
                values: constants(atom, &rules, symbols).collect(),
            }),
            _ => {
                let fault = Diagnostic::new(Code::INVALID_FACT, "a fact has constants only");
                Err(vec![fault.at(place.0, "").help("write the value of the expression")])
            }
        }
    }

    /// The rows of a text that consists of facts, whose texts are added to `symbols`. `None` if the text says anything else, also
    /// a fact with an expression that has no value.
    ///
    /// # Errors
    /// All that is wrong with them.
    pub fn facts(
        &self,
        sources: &Sources,
        id: SourceId,
        symbols: &Symbols,
    ) -> Result<Option<Vec<FactRow>>, Vec<Diagnostic>> {
        let mut faults = Faults::default();
        let file = include::parse_one(sources, id, &mut faults);
        if faults.failed() {
            return Err(faults.finish());
        }
        let is_fact = |item: &Item| matches!(item, Item::Clause(clause) if clause.body.is_empty());
        if !file.items.iter().all(is_fact) {
            return Ok(None);
        }
        let mut items = self.declarations(false);
        items.extend(file.items);
        let (rules, _) = check(&items, true, self.inputs, Symbols::new(), &mut faults);
        let Some(rules) = rules else {
            return Err(of(id, faults));
        };
        let row = |clause: &rules::Clause| {
            let row: Option<Vec<Value>> = constants(&clause.head, &rules, symbols).collect();
            Some((clause.head.relation, row?))
        };
        Ok(rules.clauses.iter().map(row).collect())
    }

    /// Types and predicates alone; if `given`, marked as input.
    fn declarations(&self, given: bool) -> Vec<Item> {
        let declared = |item: &&Item| matches!(item, Item::Type(_) | Item::Decl(_));
        let mut items: Vec<Item> = self.gathered.items.iter().filter(declared).cloned().collect();
        let mut names = Vec::new();
        for item in &mut items {
            if let Item::Decl(decl) = item {
                // They would be warned of once more.
                decl.qualifiers.clear();
                names.extend(decl.names.iter().cloned());
            }
        }
        if given && !names.is_empty() {
            items.push(Item::Mark(Mark {
                kind: MarkKind::Input,
                names,
                options: Vec::new(),
            }));
        }
        items
    }

    /// The body with predicates replaced that stand for their bodies.
    fn inlined(&self, clause: Clause, faults: &mut Faults) -> Clause {
        let mut items: Vec<Item> = (self.gathered.items.iter())
            .filter(|item| matches!(item, Item::Decl(_) | Item::Clause(_)))
            .cloned()
            .collect();
        items.push(Item::Clause(clause.clone()));
        match inline::replace(&items, faults).and_then(|mut items| items.pop()) {
            Some(Item::Clause(replaced)) => replaced,
            _ => clause,
        }
    }

    fn uses_inline(&self) -> bool {
        let is_inline = |item: &Item| match item {
            Item::Decl(decl) => decl.qualifiers.iter().any(|word| word.text == "inline"),
            _ => false,
        };
        self.gathered.items.iter().any(is_inline)
    }

    fn answer(&self, body: &[Literal], place: Place, symbols: Symbols) -> Loaded {
        let mut clause = Clause {
            heads: vec![Atom {
                predicate: answer_name(place),
                terms: Vec::new(),
                place,
            }],
            body: body.to_vec(),
            doc: String::new(),
            place,
        };
        let mut faults = Faults::default();
        if self.uses_inline() {
            clause = self.inlined(clause, &mut faults);
        }
        let variables = variables(body);
        let names: Vec<&str> = variables.iter().map(|(name, _)| *name).collect();
        let bases = self.bases(&clause, &names, &mut faults);
        if faults.failed() {
            let mut found = of(place.0.source, faults);
            found.retain(Diagnostic::is_error);
            return Loaded::failed(found);
        }
        let columns = (variables.iter().zip(bases))
            .map(|(&(name, place), base)| ColumnDecl {
                name: Name {
                    text: name.to_owned(),
                    place,
                },
                ty: Name {
                    text: base.name().to_owned(),
                    place,
                },
            })
            .collect();
        clause.heads[0].terms = (variables.iter())
            .map(|&(name, place)| Term {
                kind: TermKind::Variable(name.to_owned()),
                place,
            })
            .collect();
        let items = self.asked(columns, clause);
        let mut faults = Faults::default();
        let (rules, compared) = check(&items, true, self.inputs, symbols, &mut faults);
        Loaded {
            rules,
            diagnostics: of(place.0.source, faults),
            compared,
        }
    }

    /// What variables of the body of a clause without columns are made of.
    fn bases(&self, clause: &Clause, variables: &[&str], faults: &mut Faults) -> Vec<BaseType> {
        let items = self.asked(Vec::new(), clause.clone());
        let mut known = names::declare(&items, true, self.inputs, faults);
        let checked = clause::check(&items, &mut known, Symbols::new(), faults);
        known.report_unknown(faults);
        let base_of = |name: &&str| {
            checked.clauses.iter().find_map(|checked| {
                let position = checked.clause.variables.iter().position(|known| known == name)?;
                checked.bases[position]
            })
        };
        (variables.iter())
            .map(|name| base_of(name).unwrap_or(BaseType::Symbol))
            .collect()
    }

    /// The program of a question: all predicates as input, and the clause for the answer.
    fn asked(&self, columns: Vec<ColumnDecl>, clause: Clause) -> Vec<Item> {
        let mut items = self.declarations(true);
        items.push(Item::Decl(Decl {
            names: vec![answer_name(clause.place)],
            columns: Some(columns),
            qualifiers: Vec::new(),
            doc: String::new(),
        }));
        items.push(Item::Clause(clause));
        items
    }
}

fn answer_name(place: Place) -> Name {
    Name {
        text: ANSWER.to_owned(),
        place,
    }
}

/// The constants of an atom, their texts added to `symbols`; `None` for a column that holds anything else.
fn constants<'r>(
    atom: &'r rules::Atom,
    rules: &'r rules::Rules,
    symbols: &'r Symbols,
) -> impl Iterator<Item = Option<Value>> + 'r {
    let columns = &rules.relations[atom.relation.index()].columns;
    atom.terms.iter().zip(columns).map(|(term, column)| match *term {
        rules::Term::Constant(value) => Some(moved(value, column.base, &rules.symbols, symbols)),
        rules::Term::Variable(_) | rules::Term::Wildcard => None,
    })
}

/// The faults that have their place in one text.
fn of(source: SourceId, faults: Faults) -> Vec<Diagnostic> {
    let here = |fault: &Diagnostic| (fault.primary.as_ref()).is_none_or(|label| label.span.source == source);
    faults.finish().into_iter().filter(here).collect()
}

/// The variables that a question asks for, and where each stands first.
fn variables(body: &[Literal]) -> Vec<(&str, Place)> {
    fn of_term<'t>(term: &'t Term, each: &mut impl FnMut(&'t str, Place)) {
        match &term.kind {
            TermKind::Variable(name) => each(name, term.place),
            TermKind::Functor(_, arguments) => arguments.iter().for_each(|argument| of_term(argument, each)),
            TermKind::Cast(inner, _) => of_term(inner, each),
            _ => {}
        }
    }
    fn of_literal<'t>(literal: &'t Literal, each: &mut impl FnMut(&'t str, Place)) {
        match literal {
            Literal::Atom { atom, .. } => atom.terms.iter().for_each(|term| of_term(term, each)),
            Literal::Compare { left, right, .. } => [left, right].into_iter().for_each(|term| of_term(term, each)),
            Literal::Any(alternatives) => alternatives.iter().flatten().for_each(|one| of_literal(one, each)),
        }
    }
    let mut seen = HashSet::new();
    let mut found = Vec::new();
    for one in body {
        of_literal(one, &mut |name, place| {
            if !name.starts_with('_') && seen.insert(name) {
                found.push((name, place));
            }
        });
    }
    found
}

/// The clause with its variables named by the order in which they occur, and without its comment.
fn canonical(clause: &Clause) -> Clause {
    let mut order: Vec<&str> = Vec::new();
    let mut seen = HashSet::new();
    let mut note = |name| {
        if seen.insert(name) {
            order.push(name);
        }
    };
    (clause.heads.iter().flat_map(|head| &head.terms)).for_each(|term| names_of(term, true, &mut note));
    clause
        .body
        .iter()
        .for_each(|literal| names_in(literal, true, &mut note));
    let names = (order.iter().enumerate())
        .map(|(at, name)| ((*name).to_owned(), TermKind::Variable(format!("+{at}"))))
        .collect();
    let head = |head: &Atom| Atom {
        terms: head.terms.iter().map(|term| renamed_term(term, &names)).collect(),
        ..head.clone()
    };
    Clause {
        heads: clause.heads.iter().map(head).collect(),
        body: clause.body.iter().map(|literal| renamed(literal, &names)).collect(),
        doc: String::new(),
        place: clause.place,
    }
}

/// A value of one table of symbols as one of another.
fn moved(value: Value, base: BaseType, from: &Symbols, to: &Symbols) -> Value {
    match base {
        BaseType::Symbol => Value(to.intern(from.text(Symbol(value.0)).unwrap_or_default()).0),
        _ => value,
    }
}

/// Whether a text that somebody is typing may end here: every parenthesis is closed, and the last clause has its full stop. A
/// directive ends with its line, and a question where it can be answered.
pub fn is_complete(text: &str) -> bool {
    let mut sources = Sources::new();
    let id = sources.add("", text);
    let mut faults = Faults::default();
    let lexed = lexer::lex(id, text, &mut faults);
    let mut depth = 0_usize;
    for token in &lexed.tokens {
        match token.kind {
            Kind::LParen | Kind::LBrace | Kind::LBracket => depth += 1,
            Kind::RParen | Kind::RBrace | Kind::RBracket => depth = depth.saturating_sub(1),
            _ => {}
        }
    }
    // The last token is the end.
    let Some(last) = lexed.tokens.iter().rev().nth(1) else {
        // A doc comment waits for what it belongs to.
        return lexed.docs.is_empty() && !has_open_comment(text, &lexed);
    };
    if depth > 0 || has_open_comment(text, &lexed) {
        return false;
    }
    match last.kind {
        Kind::Dot => true,
        Kind::Comma | Kind::Colon | Kind::Pipe | Kind::Subtype | Kind::Equal | Kind::If | Kind::Semicolon => false,
        _ if text.trim_start().starts_with("?-") => {
            parser::parse_question(id, text, &mut faults).is_some() && !faults.failed()
        }
        _ => {
            let (_, starts) = parser::parse_tokens(id, text, &lexed, &mut faults);
            starts
                .last()
                .is_some_and(|&start| lexed.tokens[start].kind == Kind::Dot)
        }
    }
}

/// The lexer stops at a `/*` without its `*/`, and keeps no comment there.
fn has_open_comment(text: &str, lexed: &lexer::Lexed) -> bool {
    let read = (lexed.comments.iter().map(|comment| comment.end))
        .chain(lexed.tokens.iter().rev().nth(1).map(|token| token.end))
        .max()
        .unwrap_or(0);
    text[read as usize..].contains("/*")
}

#[cfg(test)]
mod tests {
    use crate::datalog::workspace::is_complete;

    #[test]
    fn a_text_is_complete_at_the_full_stop_and_at_the_end_of_a_directive() {
        let whole = [
            "",
            "A(1).",
            "A(x) :-\n B(x).",
            ".decl A(x: number)",
            ".input A",
            ".decl A(x: number)\nA(1).",
            "?- A(x), x > 1.",
            "?- A(x), x > 1.5",
            "?- A(x)",
            "// said\n",
            "/// said\nA(1).",
            "A(\"a.\").",
            "/* a */",
        ];
        let open = [
            "A(1)",
            "A(x) :-",
            "A(x) :- B(x),\n",
            ".decl A(x: number,",
            ".decl A(",
            ".input A,",
            ".type t =",
            "A(1). B(",
            "?-",
            "?- A(x), x >",
            "?- A(x), x > 1.5 +",
            "?- A(x,",
            "/// said\n",
            "/* a",
            "A(1). /* b",
            "A(1). // a /* b */\nB",
        ];
        for text in whole {
            assert!(is_complete(text), "{text}");
        }
        for text in open {
            assert!(!is_complete(text), "{text}");
        }
    }
}
