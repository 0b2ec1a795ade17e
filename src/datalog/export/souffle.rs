//! Checked rules as a plain program for Soufflé.

use super::names::Names;
use super::{argument_base, check, lacking};
use crate::check::{Atom, Clause, Directive, Literal, Predicate, RowEncoding, RowPlace, Rules, Term};
use crate::diag::{Diagnostic, Faults};
use crate::symbol::Symbol;
use crate::syntax::ast::{BaseType, Comparison, MarkKind};
use crate::syntax::functor::Functor;
use crate::syntax::quoted;
use crate::value::Value;
use std::fmt::Write as _;

/// The words that Soufflé reserves.
const KEYWORDS: [&str; 51] = [
    "as",
    "autoinc",
    "band",
    "bnot",
    "bor",
    "brie",
    "bshl",
    "bshr",
    "bshru",
    "btree",
    "btree_delete",
    "bxor",
    "cat",
    "contains",
    "count",
    "eqrel",
    "false",
    "float",
    "fold",
    "inline",
    "input",
    "land",
    "lnot",
    "lor",
    "lxor",
    "magic",
    "match",
    "max",
    "mean",
    "min",
    "nil",
    "no_inline",
    "no_magic",
    "number",
    "ord",
    "output",
    "overridable",
    "override",
    "printsize",
    "range",
    "stateful",
    "strlen",
    "substr",
    "sum",
    "symbol",
    "to_float",
    "to_number",
    "to_string",
    "to_unsigned",
    "true",
    "unsigned",
];

const LANGUAGE: &str = "plain Soufflé";

/// Returns a program for Soufflé with the same results: one file with declarations, facts, rules and directives only.
///
/// Components, macros, includes, inputs of inline predicates, equivalence relations and nested aggregates are written
/// out, so engines with a small part of the language can take it.
///
/// ```
/// use logicity_datalog::{Program, export};
///
/// let program = Program::parse(
///     ".comp Closure { .decl edge(x: symbol, y: symbol) .decl path(x: symbol, y: symbol)
///          path(x, y) :- edge(x, y). path(x, z) :- path(x, y), edge(y, z). }
///      .init roads = Closure
///      roads.edge(\"a\", \"b\").
///      .output roads.path",
/// )?;
/// let plain = export::souffle(program.rules()).unwrap();
/// assert!(plain.contains("roads_path(x, z) :- roads_path(x, y), roads_edge(y, z)."), "{plain}");
/// Program::parse(&plain)?;
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// What plain Soufflé cannot express with the same meaning: records, draws, temporal operators, choices, subsumption,
/// counters, casts, user-defined functors, and tables in Parquet.
pub fn souffle(rules: &Rules) -> Result<String, Vec<Diagnostic>> {
    super::refuse_64_bits(rules)?;
    let mut faults = Faults::default();
    check(rules, LANGUAGE, &mut faults);
    let mut names = Names::avoiding(&KEYWORDS);
    let printer = Printer {
        rules,
        names: rules
            .predicates
            .iter()
            .map(|predicate| names.add(&predicate.name, "made"))
            .collect(),
    };
    let mut out = String::new();
    for (predicate, name) in rules.predicates.iter().zip(&printer.names) {
        let mut columns = Names::avoiding(&KEYWORDS);
        let columns = predicate.columns.iter().map(|column| {
            let name = columns.add(&column.name, "c");
            format!("{name}: {}", column.base.name())
        });
        let _ = writeln!(out, ".decl {name}({})", columns.collect::<Vec<_>>().join(", "));
    }
    for (predicate, name) in rules.predicates.iter().zip(&printer.names) {
        for directive in &predicate.directives {
            match printer.directive(predicate, name, directive) {
                Ok(line) => out += &line,
                Err(fault) => faults.push(fault),
            }
        }
    }
    for clause in &rules.clauses {
        match printer.clause(clause) {
            Ok(line) => out += &line,
            Err(fault) => faults.push(fault),
        }
    }
    let faults = faults.finish();
    if faults.is_empty() { Ok(out) } else { Err(faults) }
}

struct Printer<'a> {
    rules: &'a Rules,
    /// By predicate.
    names: Vec<String>,
}

impl Printer<'_> {
    fn directive(&self, predicate: &Predicate, name: &str, directive: &Directive) -> Result<String, Diagnostic> {
        let mut options: Vec<(&str, String)> = Vec::new();
        let kind = match directive.kind {
            MarkKind::Input => "input",
            MarkKind::Output => "output",
            MarkKind::PrintSize => return Ok(format!(".printsize {name}\n")),
            MarkKind::LimitSize => return Ok(String::new()),
        };
        // The rows that a caller inserts have a predicate of their own if rules derive others.
        let name = match (directive.kind, predicate.edb) {
            (MarkKind::Input, Some(given)) => &self.names[given.index()],
            _ => name,
        };
        let ending = match directive.kind {
            MarkKind::Input => "facts",
            _ => "csv",
        };
        let (io, ending) = match directive.encoding {
            RowEncoding::Text => ("file", ending),
            RowEncoding::Json { objects } => {
                let format = if objects { "object" } else { "list" };
                options.push(("format", format.to_owned()));
                ("jsonfile", "json")
            }
            RowEncoding::Parquet => return Err(lacking(LANGUAGE, "tables in Parquet", directive.span)),
        };
        match (&directive.place, directive.kind) {
            (RowPlace::Terminal, MarkKind::Input) => options.insert(0, ("IO", "stdin".to_owned())),
            (RowPlace::Terminal, _) => options.insert(0, ("IO", "stdout".to_owned())),
            (RowPlace::File(file), _) => options
                .splice(0..0, [("IO", io.to_owned()), ("filename", file.clone())])
                .for_each(drop),
            (RowPlace::Usual, _) => {
                let file = format!("{}.{ending}", predicate.name);
                if file != format!("{name}.{ending}") || io != "file" {
                    options
                        .splice(0..0, [("IO", io.to_owned()), ("filename", file)])
                        .for_each(drop);
                }
            }
        }
        let format = &directive.format;
        if directive.encoding == RowEncoding::Text {
            let usual = if format.quoted { "," } else { "\t" };
            let columns: Vec<String> = format.columns.iter().map(ToString::to_string).collect();
            let texts = [
                ("delimiter", format.delimiter != usual, format.delimiter.as_str()),
                ("headers", format.headers, "true"),
                ("rfc4180", format.quoted, "true"),
            ];
            options.extend(
                texts
                    .iter()
                    .filter(|(_, set, _)| *set)
                    .map(|(key, _, value)| (*key, (*value).to_owned())),
            );
            if !columns.is_empty() {
                options.push(("columns", columns.join(":")));
            }
        }
        if directive.compress {
            options.push(("compress", "true".to_owned()));
        }
        let options: Vec<String> = options
            .iter()
            .map(|(key, value)| format!("{key}={}", quoted(value)))
            .collect();
        Ok(match options.is_empty() {
            true => format!(".{kind} {name}\n"),
            false => format!(".{kind} {name}({})\n", options.join(", ")),
        })
    }

    fn clause(&self, clause: &Clause) -> Result<String, Diagnostic> {
        let mut names = Names::avoiding(&KEYWORDS);
        let variables: Vec<String> = clause.variables.iter().map(|name| names.add(name, "v")).collect();
        let scope = Scope {
            printer: self,
            variables,
            fresh: names.add("value", "v"),
        };
        let head = scope.atom(&clause.head, None)?;
        let body: Vec<String> = clause
            .body
            .iter()
            .map(|literal| scope.literal(literal))
            .collect::<Result<_, _>>()?;
        Ok(match body.is_empty() {
            true => format!("{head}.\n"),
            false => format!("{head} :- {}.\n", body.join(", ")),
        })
    }
}

/// A clause that is being written.
struct Scope<'a> {
    printer: &'a Printer<'a>,
    variables: Vec<String>,
    /// A name that no variable has.
    fresh: String,
}

impl Scope<'_> {
    fn constant(&self, value: Value, base: BaseType) -> Option<String> {
        Some(match base {
            BaseType::Number => value.as_number().to_string(),
            BaseType::Unsigned => format!("{}u", value.0),
            BaseType::Float => {
                let number = value.as_float();
                if !number.is_finite() {
                    return None;
                }
                // `Display` writes no exponent.
                let text = number.to_string();
                if text.contains('.') { text } else { text + ".0" }
            }
            BaseType::Symbol => {
                let text = self.printer.rules.symbols.resolve(Symbol(value.0)).unwrap_or_default();
                // Soufflé has no escape for it.
                if text.contains('\0') {
                    return None;
                }
                quoted(text)
            }
            BaseType::Record => return None,
        })
    }

    fn term(&self, term: &Term, base: BaseType) -> Option<String> {
        Some(match term {
            Term::Variable(id) => self.variables[id.0 as usize].clone(),
            Term::Constant(value) => self.constant(*value, base)?,
            Term::Wildcard => "_".to_owned(),
        })
    }

    /// Writes an atom; `fresh` stands in this column.
    fn atom(&self, atom: &Atom, fresh: Option<usize>) -> Result<String, Diagnostic> {
        let predicate = &self.printer.rules.predicates[atom.predicate.index()];
        let terms = atom
            .terms
            .iter()
            .zip(&predicate.columns)
            .enumerate()
            .map(|(at, (term, column))| {
                if fresh == Some(at) {
                    return Ok(self.fresh.clone());
                }
                let written = self.term(term, column.base);
                written.ok_or_else(|| lacking(LANGUAGE, "this constant", atom.span))
            });
        let terms: Vec<String> = terms.collect::<Result<_, _>>()?;
        Ok(format!(
            "{}({})",
            self.printer.names[atom.predicate.index()],
            terms.join(", ")
        ))
    }

    fn literal(&self, literal: &Literal) -> Result<String, Diagnostic> {
        match literal {
            Literal::Positive(atom) | Literal::Guard(atom) => self.atom(atom, None),
            Literal::Negative(atom) => Ok(format!("!{}", self.atom(atom, None)?)),
            Literal::Compare {
                op,
                left,
                right,
                base,
                span,
            } => {
                let lacking = || lacking(LANGUAGE, "this constant", *span);
                let left = self.term(left, *base).ok_or_else(lacking)?;
                let right = self.term(right, *base).ok_or_else(lacking)?;
                Ok(match op {
                    Comparison::Equal => format!("{left} = {right}"),
                    Comparison::NotEqual => format!("{left} != {right}"),
                    Comparison::Less => format!("{left} < {right}"),
                    Comparison::LessEqual => format!("{left} <= {right}"),
                    Comparison::Greater => format!("{left} > {right}"),
                    Comparison::GreaterEqual => format!("{left} >= {right}"),
                    Comparison::Match => format!("match({left}, {right})"),
                    Comparison::NotMatch => format!("!match({left}, {right})"),
                    Comparison::Contains => format!("contains({left}, {right})"),
                    Comparison::NotContains => format!("!contains({left}, {right})"),
                })
            }
            Literal::Compute {
                to,
                functor,
                base,
                arguments,
                span,
            } => {
                let lacking = || lacking(LANGUAGE, "this constant", *span);
                let to = self.term(to, *base).ok_or_else(lacking)?;
                let written = arguments.iter().enumerate();
                let written = written.map(|(at, argument)| self.term(argument, argument_base(*functor, *base, at)));
                let written: Vec<String> = written.collect::<Option<_>>().ok_or_else(lacking)?;
                let value = applied(*functor, *base, &written);
                Ok(match (functor, written.last()) {
                    // Here nothing follows from a division by zero; Soufflé ends.
                    (Functor::Divide | Functor::Remainder, Some(divisor)) if *base != BaseType::Float => {
                        let zero = if *base == BaseType::Unsigned { "0u" } else { "0" };
                        format!("{divisor} != {zero}, {to} = {value}")
                    }
                    _ => format!("{to} = {value}"),
                })
            }
            Literal::Aggregate {
                to,
                op,
                base,
                atom,
                column,
            } => {
                let to = self
                    .term(to, *base)
                    .ok_or_else(|| lacking(LANGUAGE, "this constant", atom.span))?;
                let atom_text = self.atom(atom, *column)?;
                let Some(column) = *column else {
                    return Ok(format!("{to} = {} : {{ {atom_text} }}", op.name()));
                };
                // A variable of the clause would be another one before the colon.
                let fresh = &self.fresh;
                let fixed = match &atom.terms[column] {
                    Term::Wildcard => String::new(),
                    term => {
                        let term = self
                            .term(term, *base)
                            .ok_or_else(|| lacking(LANGUAGE, "this constant", atom.span))?;
                        format!(", {fresh} = {term}")
                    }
                };
                Ok(format!("{to} = {} {fresh} : {{ {atom_text}{fixed} }}", op.name()))
            }
        }
    }
}

/// Writes the application of a functor.
fn applied(functor: Functor, base: BaseType, arguments: &[String]) -> String {
    let functor = match (functor, base) {
        (Functor::Add, BaseType::Symbol) => Functor::Cat,
        _ => functor,
    };
    let name = functor.name();
    match (functor, arguments) {
        (Functor::Negate, [one]) => format!("-({one})"),
        (Functor::BitNot | Functor::Not, [one]) => format!("{name} ({one})"),
        (functor, [_, _, ..]) if functor.is_infix() => {
            // `-2 ^ 2` would be `-(2 ^ 2)`.
            let whole = |argument: &String| match argument.starts_with('-') {
                true => format!("({argument})"),
                false => argument.clone(),
            };
            let arguments: Vec<String> = arguments.iter().map(whole).collect();
            format!("({})", arguments.join(&format!(" {name} ")))
        }
        _ => format!("{name}({})", arguments.join(", ")),
    }
}
