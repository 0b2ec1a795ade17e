//! Checked rules as SQL for DuckDB.

use super::names::Names;
use super::{argument_base, check, lacking, reads};
use crate::check::{Atom, Clause, ClauseId, Literal, Predicate, PredicateId, Rules, Stratum, Term};
use crate::diag::{Diagnostic, Faults, Span};
use crate::symbol::Symbol;
use crate::syntax::ast::{BaseType, Comparison};
use crate::syntax::functor::{AggregateOp, Functor};
use crate::value::Value;
use std::fmt::Write as _;

const LANGUAGE: &str = "SQL";

/// The longest expression, in bytes. A variable stands for its expression at every use, so expressions can double.
const EXPRESSION_MAX: usize = 1 << 16;

/// The column of a predicate without columns; SQL has no tables without any.
const UNIT: &str = "holds";

/// Returns statements for DuckDB that make a table with the rows of each predicate.
///
/// The tables of `.input` predicates may exist before, with columns of these types; otherwise the statements make empty
/// ones. A table of a derived predicate replaces another one of its name. Numbers are `integer`, unsigned numbers
/// `uinteger`, floats `float` and symbols `varchar`. A recursive predicate becomes `with recursive`.
///
/// ```
/// use logicity_datalog::{Program, export};
///
/// let program = Program::parse(
///     ".decl edge(x: number, y: number) .input edge
///      .decl path(x: number, y: number)
///      path(x, y) :- edge(x, y).
///      path(x, z) :- path(x, y), edge(y, z).",
/// )?;
/// let statements = export::sql(program.rules()).unwrap();
/// assert!(statements.contains("with recursive"), "{statements}");
///
/// let program = Program::parse(
///     ".decl edge(x: number, y: number) .input edge
///      .decl path(x: number, y: number)
///      path(x, y) :- edge(x, y).
///      path(x, z) :- path(x, y), path(y, z).",
/// )?;
/// let faults = export::sql(program.rules()).unwrap_err();
/// assert_eq!(faults[0].message, "SQL cannot express a clause that reads `path` twice, which is recursive");
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// What SQL cannot express: recursion of several predicates through each other, recursion that is not linear, functors
/// without a counterpart of the same meaning, and what [`souffle`](super::souffle) refuses.
pub fn sql(rules: &Rules) -> Result<String, Vec<Diagnostic>> {
    super::refuse_64_bits(rules)?;
    let mut faults = Faults::default();
    check(rules, LANGUAGE, &mut faults);
    let mut names = Names::default();
    let tables = rules.predicates.iter().map(|predicate| Table {
        name: names.add(&predicate.name, "made"),
        columns: match predicate.columns.is_empty() {
            true => vec![UNIT.to_owned()],
            false => {
                let mut names = Names::default();
                predicate
                    .columns
                    .iter()
                    .map(|column| names.add(&column.name, "c"))
                    .collect()
            }
        },
    });
    let writer = Writer {
        rules,
        tables: tables.collect(),
    };
    let mut out = String::new();
    for (predicate, id) in rules.predicates.iter().zip((0..).map(PredicateId)) {
        if !rules
            .strata
            .iter()
            .any(|stratum| stratum.predicates.contains(&id) && predicate.derived)
        {
            match writer.base(predicate, id) {
                Ok(statements) => out += &statements,
                Err(fault) => faults.push(fault),
            }
        }
    }
    for stratum in &rules.strata {
        if stratum.predicates.iter().any(|id| rules.predicates[id.index()].derived) {
            match writer.stratum(stratum) {
                Ok(statement) => out += &statement,
                Err(fault) => faults.push(fault),
            }
        }
    }
    let faults = faults.finish();
    if faults.is_empty() { Ok(out) } else { Err(faults) }
}

struct Table {
    name: String,
    columns: Vec<String>,
}

struct Writer<'a> {
    rules: &'a Rules,
    /// By predicate.
    tables: Vec<Table>,
}

fn type_of(base: BaseType) -> &'static str {
    match base {
        BaseType::Number => "integer",
        BaseType::Unsigned => "uinteger",
        BaseType::Float => "float",
        BaseType::Symbol | BaseType::Record => "varchar",
    }
}

fn quoted(name: &str) -> String {
    format!("\"{name}\"")
}

impl Writer<'_> {
    fn table(&self, id: PredicateId) -> &Table {
        &self.tables[id.index()]
    }

    /// Writes what atoms of a predicate read. The table of an input may hold rows twice and rows with `null`.
    fn source(&self, id: PredicateId) -> String {
        let table = self.table(id);
        let name = quoted(&table.name);
        if !self.rules.predicates[id.index()].input {
            return name;
        }
        let present: Vec<String> = table
            .columns
            .iter()
            .map(|column| format!("{} is not null", quoted(column)))
            .collect();
        format!(
            "(select distinct {} from {name} where {})",
            self.columns(id),
            present.join(" and ")
        )
    }

    fn columns(&self, id: PredicateId) -> String {
        let columns: Vec<String> = self.table(id).columns.iter().map(|name| quoted(name)).collect();
        columns.join(", ")
    }

    /// Writes the names and types of the columns.
    fn definition(&self, id: PredicateId) -> String {
        let types = self.rules.predicates[id.index()].columns.iter();
        let types = types.map(|column| type_of(column.base)).chain(["boolean"]);
        let columns = self.table(id).columns.iter().zip(types);
        let columns: Vec<String> = columns.map(|(name, ty)| format!("{} {ty}", quoted(name))).collect();
        columns.join(", ")
    }

    /// Writes the table of a predicate without rules, with the facts of the source.
    fn base(&self, predicate: &Predicate, id: PredicateId) -> Result<String, Diagnostic> {
        let table = self.table(id);
        let name = quoted(&table.name);
        // A hidden one holds what the caller inserts beside what rules derive.
        let given = predicate.input || predicate.hidden;
        let create = if given {
            "create table if not exists"
        } else {
            "create or replace table"
        };
        let mut out = format!("{create} {name}({});\n", self.definition(id));
        for clause in self.rules.clauses.iter().filter(|clause| clause.head.predicate == id) {
            let row = self.select(clause)?;
            let _ = writeln!(out, "insert into {name} ({row}) except select * from {name};");
        }
        Ok(out)
    }

    /// Writes the table of a derived predicate.
    fn stratum(&self, stratum: &Stratum) -> Result<String, Diagnostic> {
        let clause = |id: &ClauseId| &self.rules.clauses[id.index()];
        let [id] = stratum.predicates[..] else {
            let names: Vec<String> = stratum
                .predicates
                .iter()
                .map(|id| format!("`{}`", self.rules.predicates[id.index()].title()))
                .collect();
            let what = format!("recursion of {} through each other", names.join(" and "));
            return Err(lacking(
                LANGUAGE,
                &what,
                self.rules.predicates[stratum.predicates[0].index()].span,
            ));
        };
        let recursive = |clause: &&Clause| reads(clause).any(|(read, _)| read == id);
        let (steps, starts): (Vec<&Clause>, Vec<&Clause>) = stratum.clauses.iter().map(clause).partition(recursive);
        for clause in &steps {
            let again: Vec<Span> = reads(clause)
                .filter(|(read, _)| *read == id)
                .map(|(_, span)| span)
                .collect();
            if let [first, second, ..] = again[..] {
                let what = format!(
                    "a clause that reads `{}` twice, which is recursive",
                    self.rules.predicates[id.index()].title()
                );
                let fault = lacking(LANGUAGE, &what, second).also(first, "the first time");
                return Err(fault.help("write the recursion so that each clause reads the predicate once"));
            }
        }
        let selects = |clauses: &[&Clause]| -> Result<Vec<String>, Diagnostic> {
            clauses
                .iter()
                .map(|clause| Ok(format!("({})", self.select(clause)?)))
                .collect()
        };
        let (starts, steps) = (selects(&starts)?, selects(&steps)?);
        let (name, columns) = (quoted(&self.table(id).name), self.columns(id));
        if starts.is_empty() {
            // Without a first row, recursion derives none.
            return Ok(format!("create or replace table {name}({});\n", self.definition(id)));
        }
        let start = starts.join("\n  union ");
        Ok(match steps.is_empty() {
            true => format!("create or replace table {name} as\n  {start};\n"),
            false => {
                let steps = steps.join("\n  union all ");
                format!(
                    "create or replace table {name} as with recursive {name}({columns}) as (\n  (select * from ({start}))\
                     \n  union\n  (select * from ({steps}))\n) select * from {name};\n"
                )
            }
        })
    }

    /// Writes the query of a clause.
    fn select(&self, clause: &Clause) -> Result<String, Diagnostic> {
        let mut query = Query {
            writer: self,
            clause,
            from: Vec::new(),
            conditions: Vec::new(),
            variables: vec![None; clause.variables.len()],
        };
        query.fill()?;
        let predicate = &self.rules.predicates[clause.head.predicate.index()];
        let columns = &self.table(clause.head.predicate).columns;
        let mut values = Vec::new();
        for ((term, column), name) in clause.head.terms.iter().zip(&predicate.columns).zip(columns) {
            let value = query.term(term, column.base, clause.head.span)?;
            values.push(format!("cast({value} as {}) as {}", type_of(column.base), quoted(name)));
        }
        if values.is_empty() {
            values.push(format!("true as {}", quoted(UNIT)));
        }
        let mut out = format!("select distinct {}", values.join(", "));
        if !query.from.is_empty() {
            let _ = write!(out, " from {}", query.from.join(", "));
        }
        if !query.conditions.is_empty() {
            let _ = write!(out, " where {}", query.conditions.join(" and "));
        }
        Ok(out)
    }
}

/// The query of a clause that is being written.
struct Query<'a> {
    writer: &'a Writer<'a>,
    clause: &'a Clause,
    from: Vec<String>,
    conditions: Vec<String>,
    /// The expression of each bound variable.
    variables: Vec<Option<String>>,
}

impl Query<'_> {
    /// Writes the body: atoms bind variables first, then whatever has its variables bound.
    fn fill(&mut self) -> Result<(), Diagnostic> {
        let mut rest: Vec<&Literal> = Vec::new();
        for literal in &self.clause.body {
            match literal {
                Literal::Positive(atom) | Literal::Guard(atom) => self.join(atom)?,
                literal => rest.push(literal),
            }
        }
        while !rest.is_empty() {
            let before = rest.len();
            let mut waiting = Vec::new();
            for literal in rest {
                if !self.try_literal(literal)? {
                    waiting.push(literal);
                }
            }
            if waiting.len() == before {
                return Err(lacking(LANGUAGE, "the order of this clause", self.clause.span));
            }
            rest = waiting;
        }
        Ok(())
    }

    fn is_bound(&self, term: &Term) -> bool {
        term.variable().is_none_or(|id| self.variables[id.0 as usize].is_some())
    }

    /// Adds a literal unless it needs variables that are not bound yet.
    fn try_literal(&mut self, literal: &Literal) -> Result<bool, Diagnostic> {
        match literal {
            Literal::Positive(_) | Literal::Guard(_) => {}
            Literal::Negative(atom) => {
                if !atom.terms.iter().all(|term| self.is_bound(term)) {
                    return Ok(false);
                }
                let condition = format!("not exists (select 1 {})", self.matching(atom)?);
                self.conditions.push(condition);
            }
            Literal::Compare {
                op,
                left,
                right,
                base,
                span,
            } => match (self.is_bound(left), self.is_bound(right), op) {
                (true, true, _) => {
                    let condition = self.comparison(*op, (left, right), *base, *span)?;
                    self.conditions.push(condition);
                }
                (true, false, Comparison::Equal) => {
                    let value = self.term(left, *base, *span)?;
                    self.bind(right, value);
                }
                (false, true, Comparison::Equal) => {
                    let value = self.term(right, *base, *span)?;
                    self.bind(left, value);
                }
                _ => return Ok(false),
            },
            Literal::Compute {
                to,
                functor,
                base,
                arguments,
                span,
            } => {
                if !arguments.iter().all(|argument| self.is_bound(argument)) {
                    return Ok(false);
                }
                let values = arguments.iter().enumerate();
                let values = values.map(|(at, value)| self.term(value, argument_base(*functor, *base, at), *span));
                let values: Vec<String> = values.collect::<Result<_, _>>()?;
                let value = applied(*functor, *base, &values);
                let value = value.ok_or_else(|| lacking(LANGUAGE, &format!("`{}` here", functor.name()), *span))?;
                self.set(to, value, *base, *span)?;
            }
            Literal::Aggregate {
                to,
                op,
                base,
                atom,
                column,
            } => {
                if !atom.terms.iter().all(|term| self.is_bound(term)) {
                    return Ok(false);
                }
                let matching = self.matching(atom)?;
                let value =
                    column.map(|column| format!("a.{}", quoted(&self.writer.table(atom.predicate).columns[column])));
                let value = value.unwrap_or_default();
                let aggregate = match (op, base) {
                    (AggregateOp::Count, _) => "cast(count(*) as integer)".to_owned(),
                    (AggregateOp::Sum, BaseType::Float) => {
                        return Err(lacking(LANGUAGE, "the order in which floats are added", atom.span));
                    }
                    (AggregateOp::Sum, base) => wrapped(&format!("coalesce(sum({value}), 0)"), *base)
                        .ok_or_else(|| lacking(LANGUAGE, "this sum", atom.span))?,
                    (AggregateOp::Min, _) => format!("min({value})"),
                    (AggregateOp::Max, _) => format!("max({value})"),
                    (AggregateOp::Mean, _) => {
                        return Err(lacking(LANGUAGE, "the order in which floats are added", atom.span));
                    }
                };
                let aggregate = format!("(select {aggregate} {matching})");
                if matches!(op, AggregateOp::Min | AggregateOp::Max) {
                    self.conditions.push(format!("{aggregate} is not null"));
                }
                self.set(to, aggregate, *base, atom.span)?;
            }
        }
        Ok(true)
    }

    fn bind(&mut self, term: &Term, value: String) {
        if let Some(id) = term.variable() {
            self.variables[id.0 as usize] = Some(value);
        }
    }

    /// Binds a result, or compares it if it is bound.
    fn set(&mut self, to: &Term, value: String, base: BaseType, span: Span) -> Result<(), Diagnostic> {
        if value.len() > EXPRESSION_MAX {
            return Err(lacking(LANGUAGE, "an expression of this length", span));
        }
        if self.is_bound(to) {
            let to = self.term(to, base, span)?;
            self.conditions.push(format!("{to} = {value}"));
        } else {
            self.bind(to, value);
        }
        Ok(())
    }

    fn comparison(
        &self,
        op: Comparison,
        (left, right): (&Term, &Term),
        base: BaseType,
        span: Span,
    ) -> Result<String, Diagnostic> {
        let (left, right) = (self.term(left, base, span)?, self.term(right, base, span)?);
        let ordered = matches!(
            op,
            Comparison::Less | Comparison::LessEqual | Comparison::Greater | Comparison::GreaterEqual
        );
        // DuckDB has a place for "not a number" in the order.
        let guard = match base == BaseType::Float && ordered {
            true => format!("not isnan({left}) and not isnan({right}) and "),
            false => String::new(),
        };
        let compared = match op {
            Comparison::Equal => format!("{left} = {right}"),
            Comparison::NotEqual => format!("{left} <> {right}"),
            Comparison::Less => format!("{left} < {right}"),
            Comparison::LessEqual => format!("{left} <= {right}"),
            Comparison::Greater => format!("{left} > {right}"),
            Comparison::GreaterEqual => format!("{left} >= {right}"),
            Comparison::Contains => format!("contains({right}, {left})"),
            Comparison::NotContains => format!("not contains({right}, {left})"),
            Comparison::Match | Comparison::NotMatch => return Err(lacking(LANGUAGE, "`match`", span)),
        };
        Ok(guard + &compared)
    }

    /// Joins the table of an atom.
    fn join(&mut self, atom: &Atom) -> Result<(), Diagnostic> {
        let (table, alias) = (self.writer.table(atom.predicate), format!("t{}", self.from.len()));
        self.from
            .push(format!("{} {alias}", self.writer.source(atom.predicate)));
        let predicate = &self.writer.rules.predicates[atom.predicate.index()];
        for ((term, column), name) in atom.terms.iter().zip(&predicate.columns).zip(&table.columns) {
            let value = format!("{alias}.{}", quoted(name));
            match term {
                Term::Wildcard => {}
                term if self.is_bound(term) => {
                    let term = self.term(term, column.base, atom.span)?;
                    self.conditions.push(format!("{value} = {term}"));
                }
                term => self.bind(term, value),
            }
        }
        Ok(())
    }

    /// Writes the rows that an atom matches, as `a`; all its variables are bound.
    fn matching(&self, atom: &Atom) -> Result<String, Diagnostic> {
        let table = self.writer.table(atom.predicate);
        let predicate = &self.writer.rules.predicates[atom.predicate.index()];
        let mut conditions = Vec::new();
        for ((term, column), name) in atom.terms.iter().zip(&predicate.columns).zip(&table.columns) {
            if *term != Term::Wildcard {
                conditions.push(format!(
                    "a.{} = {}",
                    quoted(name),
                    self.term(term, column.base, atom.span)?
                ));
            }
        }
        let from = format!("from {} a", self.writer.source(atom.predicate));
        Ok(match conditions.is_empty() {
            true => from,
            false => format!("{from} where {}", conditions.join(" and ")),
        })
    }

    fn term(&self, term: &Term, base: BaseType, span: Span) -> Result<String, Diagnostic> {
        match term {
            Term::Variable(id) => {
                let bound = self.variables[id.0 as usize].clone();
                bound.ok_or_else(|| lacking(LANGUAGE, "the order of this clause", span))
            }
            Term::Constant(value) => self.constant(*value, base, span),
            Term::Wildcard => Err(lacking(LANGUAGE, "`_` here", span)),
        }
    }

    fn constant(&self, value: Value, base: BaseType, span: Span) -> Result<String, Diagnostic> {
        Ok(match base {
            BaseType::Number => format!("cast({} as integer)", value.as_number()),
            BaseType::Unsigned => format!("cast({} as uinteger)", value.0),
            BaseType::Float if value.as_float().is_finite() => format!("cast('{:e}' as float)", value.as_float()),
            BaseType::Float => return Err(lacking(LANGUAGE, "this constant", span)),
            BaseType::Symbol | BaseType::Record => {
                let text = self.writer.rules.symbols.resolve(Symbol(value.0)).unwrap_or_default();
                if text.contains('\0') {
                    return Err(lacking(LANGUAGE, "this constant", span));
                }
                format!("'{}'", text.replace('\'', "''"))
            }
        })
    }
}

/// Wraps a whole number around, as 32 bits do.
fn wrapped(number: &str, base: BaseType) -> Option<String> {
    // The range of `hugeint` holds every intermediate result; `%` keeps the sign of the dividend.
    let modulus = "4294967296";
    let unsigned = format!("((cast({number} as hugeint) % {modulus} + {modulus}) % {modulus})");
    match base {
        BaseType::Number => {
            let shifted = format!("((cast({number} as hugeint) + 2147483648) % {modulus} + {modulus})");
            Some(format!("cast({shifted} % {modulus} - 2147483648 as integer)"))
        }
        BaseType::Unsigned => Some(format!("cast({unsigned} as uinteger)")),
        BaseType::Float | BaseType::Symbol | BaseType::Record => None,
    }
}

/// Writes the application of a functor; `None` if SQL has none of the same meaning.
fn applied(functor: Functor, base: BaseType, values: &[String]) -> Option<String> {
    let joined = |operator: &str| {
        let wide: Vec<String> = values.iter().map(|value| format!("cast({value} as hugeint)")).collect();
        wrapped(&wide.join(operator), base)
    };
    match (functor, base, values) {
        (Functor::Add | Functor::Cat, BaseType::Symbol, _) => Some(format!("concat({})", values.join(", "))),
        (Functor::Add, _, [_, _]) => joined(" + "),
        (Functor::Subtract, _, [_, _]) => joined(" - "),
        (Functor::Multiply, _, [_, _]) => joined(" * "),
        (Functor::Negate, BaseType::Number, [one]) => wrapped(&format!("-cast({one} as hugeint)"), base),
        (Functor::Min, BaseType::Number | BaseType::Unsigned, _) => Some(format!("least({})", values.join(", "))),
        (Functor::Max, BaseType::Number | BaseType::Unsigned, _) => Some(format!("greatest({})", values.join(", "))),
        (Functor::BitAnd, BaseType::Number | BaseType::Unsigned, [one, other]) => Some(format!("({one} & {other})")),
        (Functor::BitOr, BaseType::Number | BaseType::Unsigned, [one, other]) => Some(format!("({one} | {other})")),
        (Functor::BitXor, BaseType::Number | BaseType::Unsigned, [one, other]) => Some(format!("xor({one}, {other})")),
        (Functor::ToSymbol, BaseType::Number | BaseType::Unsigned, [one]) => Some(format!("cast({one} as varchar)")),
        _ => None,
    }
}
