//! A syntax tree as text that parses to the same tree.

use std::fmt::{self, Display, Write};

use super::ast::{Atom, Clause, File, Item, Literal, MarkKind, Term, TermKind, TypeDefinition};
use super::rules::Comparison;

/// The text of a tree. Ordinary comments and spacing are not in the tree and so not in the text. A declaration that was
/// reported as faulty is left out.
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
            Item::Type(decl) => {
                let (sign, other) = match &decl.definition {
                    TypeDefinition::Subtype(parent) => ("<:", parent),
                    TypeDefinition::Alias(other) => ("=", other),
                    TypeDefinition::Faulty => return Ok(()),
                };
                writeln!(f, "{}.type {} {sign} {}", Doc(&decl.doc), decl.name.text, other.text)
            }
            Item::Decl(decl) => {
                let Some(columns) = &decl.columns else { return Ok(()) };
                write!(f, "{}.decl ", Doc(&decl.doc))?;
                separated(f, &decl.names, |f, name| f.write_str(&name.text))?;
                f.write_char('(')?;
                separated(f, columns, |f, column| {
                    write!(f, "{}: {}", column.name.text, column.ty.text)
                })?;
                writeln!(f, ")")
            }
            Item::Mark(mark) => {
                f.write_str(match mark.kind {
                    MarkKind::Input => ".input ",
                    MarkKind::Output => ".output ",
                    MarkKind::PrintSize => ".printsize ",
                })?;
                separated(f, &mark.names, |f, name| f.write_str(&name.text))?;
                writeln!(f)
            }
            Item::Promise(promise) => {
                write!(f, ".{} ", promise.kind.name())?;
                separated(f, &promise.names, |f, name| f.write_str(&name.text))?;
                writeln!(f)
            }
            Item::Scope(scope) => match &scope.predicate {
                Some(predicate) => writeln!(f, ".scope {}", predicate.text),
                None => writeln!(f, ".scope"),
            },
            Item::Clause(clause) => writeln!(f, "{clause}"),
        }
    }
}

impl Display for Clause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}{}", Doc(&self.doc), self.head)?;
        if !self.body.is_empty() {
            f.write_str(" :- ")?;
            separated(f, &self.body, |f, literal| write!(f, "{literal}"))?;
        }
        f.write_char('.')
    }
}

impl Display for Literal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Literal::Atom { negated, atom } => write!(f, "{}{atom}", if *negated { "!" } else { "" }),
            Literal::Compare { op, left, right, .. } => write!(f, "{left} {op} {right}"),
        }
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
            TermKind::Text(text) => write!(f, "{}", Quoted(text)),
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

/// A text constant, quoted and escaped.
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
                '"' | '\\' => write!(f, "\\{c}")?,
                _ => f.write_char(c)?,
            }
        }
        f.write_char('"')
    }
}

/// A doc comment, a line for each line of its text.
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
