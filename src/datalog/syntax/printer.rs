//! The printer: from a syntax tree to text that parses to the same tree.

use std::fmt::{self, Display, Write};

use crate::syntax::ast::{
    Atom, Clause, File, Item, Literal, Operator, Subsumption, Temporal, Term, TermKind, TypeDefinition,
};
use crate::syntax::ast::{Comparison, ComponentType, Name};
use crate::syntax::functor::Functor;

/// Returns the text of a syntax tree.
///
/// The tree contains neither ordinary comments nor spacing, so the text has none of them. The printer omits
/// declarations that the parser reported as faulty.
pub fn print(file: &File) -> String {
    file.to_string()
}

impl Display for File {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.items.iter().try_for_each(|item| write!(f, "{item}"))
    }
}

impl Display for Item {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Item::Include(include) => writeln!(f, ".include {}", Quoted(&include.path)),
            Item::Subsumption(subsumption) => {
                let Subsumption {
                    weaker,
                    stronger,
                    body,
                    doc,
                    ..
                } = subsumption;
                write!(f, "{}{weaker} <= {stronger} :- ", Doc(doc))?;
                match body.as_slice() {
                    [] => f.write_str("true")?,
                    body => write_all(f, body)?,
                }
                f.write_str(".\n")
            }
            Item::Functor(decl) => {
                write!(f, "{}.functor {}(", Doc(&decl.doc), decl.name.text)?;
                separated(f, &decl.arguments, |f, (name, ty)| match name {
                    Some(name) => write!(f, "{}: {}", name.text, ty.text),
                    None => f.write_str(&ty.text),
                })?;
                let stateful = if decl.stateful { " stateful" } else { "" };
                writeln!(f, "): {}{stateful}", decl.result.text)
            }
            Item::Type(decl) => {
                let doc = Doc(&decl.doc);
                match &decl.definition {
                    TypeDefinition::Subtype(parent) => writeln!(f, "{doc}.type {} <: {}", decl.name.text, parent.text),
                    TypeDefinition::Alias(other) => writeln!(f, "{doc}.type {} = {}", decl.name.text, other.text),
                    TypeDefinition::Union(members) => {
                        let members: Vec<&str> = members.iter().map(|member| member.text.as_str()).collect();
                        writeln!(f, "{doc}.type {} = {}", decl.name.text, members.join(" | "))
                    }
                    TypeDefinition::Record(fields) => {
                        write!(f, "{doc}.type {} = [", decl.name.text)?;
                        separated(f, fields, |f, field| {
                            write!(f, "{}: {}", field.name.text, field.ty.text)
                        })?;
                        f.write_str("]\n")
                    }
                    TypeDefinition::Branches(branches) => {
                        write!(f, "{doc}.type {} =", decl.name.text)?;
                        for (at, branch) in branches.iter().enumerate() {
                            let bar = if at > 0 { " |" } else { "" };
                            write!(f, "{bar} {} {{", branch.name.text)?;
                            separated(f, &branch.fields, |f, field| {
                                write!(f, "{}: {}", field.name.text, field.ty.text)
                            })?;
                            f.write_char('}')?;
                        }
                        f.write_char('\n')
                    }
                    TypeDefinition::Faulty => Ok(()),
                }
            }
            Item::Decl(decl) => {
                let Some(columns) = &decl.columns else { return Ok(()) };
                write!(f, "{}.decl ", Doc(&decl.doc))?;
                separated(f, &decl.names, |f, name| f.write_str(&name.text))?;
                f.write_char('(')?;
                separated(f, columns, |f, column| {
                    write!(f, "{}: {}", column.name.text, column.ty.text)
                })?;
                f.write_char(')')?;
                decl.qualifiers
                    .iter()
                    .try_for_each(|word| write!(f, " {}", word.text))?;
                if !decl.choices.is_empty() {
                    f.write_str(" choice-domain ")?;
                    separated(f, &decl.choices, |f, columns| match columns.as_slice() {
                        [column] => f.write_str(&column.text),
                        many => {
                            f.write_char('(')?;
                            separated(f, many, |f, column| f.write_str(&column.text))?;
                            f.write_char(')')
                        }
                    })?;
                }
                writeln!(f)
            }
            Item::Mark(mark) => {
                write!(f, ".{} ", mark.kind.name())?;
                separated(f, &mark.names, |f, name| f.write_str(&name.text))?;
                if !mark.options.is_empty() {
                    f.write_char('(')?;
                    separated(f, &mark.options, |f, option| {
                        write!(f, "{}={}", option.key.text, Quoted(&option.value))
                    })?;
                    f.write_char(')')?;
                }
                writeln!(f)
            }
            Item::Pragma(pragma) => {
                f.write_str(".pragma")?;
                pragma
                    .words
                    .iter()
                    .try_for_each(|word| write!(f, " {}", Quoted(word)))?;
                writeln!(f)
            }
            Item::Plan(plan) => {
                f.write_str(".plan ")?;
                separated(f, &plan.orders, |f, (version, order)| {
                    write!(f, "{version}:(")?;
                    separated(f, order, |f, atom| write!(f, "{atom}"))?;
                    f.write_char(')')
                })?;
                writeln!(f)
            }
            Item::Constraint(constraint) => {
                write!(f, ".{} ", constraint.kind.name())?;
                separated(f, &constraint.names, |f, name| f.write_str(&name.text))?;
                writeln!(f)
            }
            Item::Scope(scope) => match &scope.predicate {
                Some(predicate) => writeln!(f, ".scope {}", predicate.text),
                None => writeln!(f, ".scope"),
            },
            Item::Component(component) => {
                write!(f, "{}.comp {}", Doc(&component.doc), component.name.text)?;
                in_angles(f, &component.parameters)?;
                for (at, base) in component.bases.iter().enumerate() {
                    f.write_str(if at == 0 { " : " } else { ", " })?;
                    write!(f, "{base}")?;
                }
                writeln!(f, " {{")?;
                for item in &component.items {
                    for line in item.to_string().lines() {
                        writeln!(f, "    {line}")?;
                    }
                }
                writeln!(f, "}}")
            }
            Item::Init(init) => writeln!(f, ".init {} = {}", init.name.text, init.component),
            Item::Override(overriding) => {
                f.write_str(".override ")?;
                separated(f, &overriding.names, |f, name| f.write_str(&name.text))?;
                writeln!(f)
            }
            Item::Clause(clause) => writeln!(f, "{clause}"),
        }
    }
}

/// Writes the parameters or arguments of a component.
fn in_angles(f: &mut fmt::Formatter<'_>, names: &[Name]) -> fmt::Result {
    if names.is_empty() {
        return Ok(());
    }
    f.write_char('<')?;
    separated(f, names, |f, name| f.write_str(&name.text))?;
    f.write_char('>')
}

impl Display for ComponentType {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.name.text)?;
        in_angles(f, &self.arguments)
    }
}

impl Display for Clause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", Doc(&self.doc))?;
        for (index, probability) in self.probabilities.iter().enumerate() {
            let before = if index > 0 { "; " } else { "" };
            write!(f, "{before}{} :: {}", Operand(probability, 0), self.heads[index])?;
        }
        if self.probabilities.is_empty() {
            separated(f, &self.heads, |f, head| write!(f, "{head}"))?;
        }
        match self.body.as_slice() {
            [] => {}
            [Literal::Any(alternatives)] if !alternatives.is_empty() => {
                f.write_str(" :- ")?;
                write_alternatives(f, alternatives)?;
            }
            body => {
                f.write_str(" :- ")?;
                write_all(f, body)?;
            }
        }
        f.write_char('.')
    }
}

/// Writes a conjunction.
fn write_all(f: &mut fmt::Formatter<'_>, literals: &[Literal]) -> fmt::Result {
    if literals.is_empty() {
        return f.write_str("true");
    }
    separated(f, literals, |f, literal| write!(f, "{literal}"))
}

fn write_alternatives(f: &mut fmt::Formatter<'_>, alternatives: &[Vec<Literal>]) -> fmt::Result {
    for (index, alternative) in alternatives.iter().enumerate() {
        if index > 0 {
            f.write_str("; ")?;
        }
        write_all(f, alternative)?;
    }
    Ok(())
}

impl Display for Literal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Literal::Atom { negated, atom } => write!(f, "{}{atom}", if *negated { "!" } else { "" }),
            Literal::Compare { op, left, right, .. } => match op {
                Comparison::Match | Comparison::Contains => write!(f, "{op}({left}, {right})"),
                Comparison::NotMatch | Comparison::NotContains => write!(f, "!{}({left}, {right})", op.opposite()),
                _ => write!(f, "{left} {op} {right}"),
            },
            Literal::Temporal { negated, temporal } => match (negated, &temporal.held) {
                (true, Some(_)) => write!(f, "!({temporal})"),
                (true, None) => write!(f, "!{temporal}"),
                (false, _) => write!(f, "{temporal}"),
            },
            Literal::Any(alternatives) if alternatives.is_empty() => f.write_str("false"),
            Literal::Any(alternatives) => {
                f.write_char('(')?;
                write_alternatives(f, alternatives)?;
                f.write_char(')')
            }
        }
    }
}

impl Display for Temporal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(held) = &self.held {
            write!(f, "{held} ")?;
        }
        write_operator(f, self.operator, self.window)?;
        write!(f, " {}", self.atom)
    }
}

/// Writes a temporal operator with its window, as in `once[0,5]`.
pub(crate) fn write_operator(f: &mut impl Write, operator: Operator, window: Option<(u32, u32)>) -> fmt::Result {
    f.write_str(operator.word())?;
    match (operator, window) {
        (Operator::Previous, _) | (_, None) => Ok(()),
        (Operator::For, Some((_, last))) => write!(f, "[{}]", u64::from(last) + 1),
        (_, Some((first, last))) => write!(f, "[{first},{last}]"),
    }
}

impl Display for Atom {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}(", self.predicate.text)?;
        separated(f, &self.terms, |f, term| write!(f, "{term}"))?;
        f.write_char(')')
    }
}

impl Display for Term {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.kind {
            TermKind::Variable(name) => f.write_str(name),
            TermKind::Wildcard => f.write_char('_'),
            TermKind::Number(number) => write!(f, "{number}"),
            TermKind::Address(address) => write!(f, "{address}"),
            TermKind::Unsigned(number) => write!(f, "{number}u"),
            TermKind::Float(number) => f.write_str(number),
            TermKind::Symbol(text) => write!(f, "{}", Quoted(text)),
            TermKind::Functor(functor, arguments) => write_functor(f, *functor, arguments),
            TermKind::Cast(term, ty) => write!(f, "as({term}, {})", ty.text),
            TermKind::Aggregate(aggregate) => {
                f.write_str(aggregate.op.name())?;
                if let Some(target) = &aggregate.target {
                    write!(f, " {}", Operand(target, u8::MAX))?;
                }
                f.write_str(" : { ")?;
                match aggregate.body.as_slice() {
                    [Literal::Any(alternatives)] if !alternatives.is_empty() => write_alternatives(f, alternatives)?,
                    body => write_all(f, body)?,
                }
                f.write_str(" }")
            }
        }
    }
}

fn write_functor(f: &mut fmt::Formatter<'_>, functor: Functor, arguments: &[Term]) -> fmt::Result {
    if let (Functor::Pack, Some((branch, fields))) = (functor, arguments.split_first()) {
        let (open, close) = match &branch.kind {
            TermKind::Symbol(branch) if !branch.is_empty() => {
                write!(f, "${branch}")?;
                if fields.is_empty() { ("", "") } else { ("(", ")") }
            }
            _ => ("[", "]"),
        };
        f.write_str(open)?;
        separated(f, fields, |f, field| write!(f, "{field}"))?;
        return f.write_str(close);
    }
    if let (
        Functor::Call,
        Some((
            Term {
                kind: TermKind::Symbol(name),
                ..
            },
            arguments,
        )),
    ) = (functor, arguments.split_first())
    {
        write!(f, "@{name}(")?;
        separated(f, arguments, |f, argument| write!(f, "{argument}"))?;
        return f.write_char(')');
    }
    match (functor.precedence(), arguments) {
        (_, []) if functor == Functor::Pack => f.write_str("nil"),
        // Without parentheses it would parse as a negative number.
        (_, [number])
            if functor == Functor::Negate && matches!(number.kind, TermKind::Number(_) | TermKind::Float(_)) =>
        {
            write!(f, "-({number})")
        }
        // A sign before a sign needs no parentheses, which would deepen the nesting.
        (Some(_), [operand]) if is_prefixed(operand) => write!(f, "{} {operand}", functor.name()),
        (Some(own), [operand]) => {
            let space = if functor == Functor::Negate { "" } else { " " };
            write!(
                f,
                "{}{space}{}",
                functor.name(),
                Operand(operand, own.saturating_add(1))
            )
        }
        (Some(own), [left, right]) => {
            // `^` groups to the right, all others to the left.
            let (for_left, for_right) = if functor == Functor::Power {
                (own + 1, own)
            } else {
                (own, own + 1)
            };
            write!(
                f,
                "{} {} {}",
                Operand(left, for_left),
                functor.name(),
                Operand(right, for_right)
            )
        }
        _ => {
            write!(f, "{}(", functor.name())?;
            separated(f, arguments, |f, argument| write!(f, "{argument}"))?;
            f.write_char(')')
        }
    }
}

/// Returns whether the term begins with a prefix operator.
fn is_prefixed(term: &Term) -> bool {
    match &term.kind {
        TermKind::Functor(functor, arguments) => arguments.len() == 1 && functor.precedence().is_some(),
        _ => false,
    }
}

/// An operand of an operator with the given precedence; parenthesized if it binds less tightly.
struct Operand<'a>(&'a Term, u8);

impl Display for Operand<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Operand(term, tightness) = self;
        let own = match &term.kind {
            TermKind::Functor(functor, _) => functor.precedence().unwrap_or(u8::MAX),
            // A negative number binds like its minus sign.
            TermKind::Number(..0) => 10,
            TermKind::Float(text) if text.starts_with('-') => 10,
            TermKind::Aggregate(_) => 0,
            _ => u8::MAX,
        };
        if own < *tightness {
            write!(f, "({term})")
        } else {
            write!(f, "{term}")
        }
    }
}

impl Display for Comparison {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Comparison::Equal => "=",
            Comparison::NotEqual => "!=",
            Comparison::Less => "<",
            Comparison::LessEqual => "<=",
            Comparison::Greater => ">",
            Comparison::GreaterEqual => ">=",
            Comparison::Match => "match",
            Comparison::NotMatch => "!match",
            Comparison::Contains => "contains",
            Comparison::NotContains => "!contains",
        })
    }
}

fn separated<T>(
    f: &mut fmt::Formatter<'_>,
    list: &[T],
    mut each: impl FnMut(&mut fmt::Formatter<'_>, &T) -> fmt::Result,
) -> fmt::Result {
    for (index, one) in list.iter().enumerate() {
        if index > 0 {
            f.write_str(", ")?;
        }
        each(f, one)?;
    }
    Ok(())
}

/// Returns a string as rule files write it: in double quotes, with escapes.
pub fn quoted(text: &str) -> String {
    Quoted(text).to_string()
}

/// A string constant, quoted and escaped.
struct Quoted<'a>(&'a str);

impl Display for Quoted<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_char('"')?;
        for c in self.0.chars() {
            match c {
                '\n' => f.write_str("\\n")?,
                '\r' => f.write_str("\\r")?,
                '\t' => f.write_str("\\t")?,
                '\0' => f.write_str("\\0")?,
                '\u{7}' => f.write_str("\\a")?,
                '\u{8}' => f.write_str("\\b")?,
                '\u{b}' => f.write_str("\\v")?,
                '\u{c}' => f.write_str("\\f")?,
                '"' | '\\' => write!(f, "\\{c}")?,
                _ => f.write_char(c)?,
            }
        }
        f.write_char('"')
    }
}

/// A doc comment, one line for each line of its text.
struct Doc<'a>(&'a str);

impl Display for Doc<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.lines().try_for_each(|line| {
            if line.is_empty() {
                writeln!(f, "///")
            } else {
                writeln!(f, "/// {line}")
            }
        })
    }
}
