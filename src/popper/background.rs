//! Background knowledge: facts, and what follows from function-free rules.

use crate::datalog::codes;
use crate::datalog::{Limits, PredicateId, Program, Value, quoted};
use crate::diag::{self, Diagnostic, Faults, SourceId, Sources, Span, did_you_mean};
use crate::files::ReadError;
use crate::popper::prolog::{Clause, Directives, Kind, Literal, Term, parse, unsupported};
use crate::symbol::Symbol;
use indexmap::{IndexMap, IndexSet};
use std::fmt::Write;
use std::path::Path;

/// Directives without effect on facts and rules.
const HARMLESS: [&str; 9] = [
    "dynamic",
    "discontiguous",
    "initialization",
    "module",
    "multifile",
    "set_prolog_flag",
    "style_check",
    "table",
    "use_module",
];

/// The name and the number of arguments of a predicate.
pub type Key = (String, usize);

/// The facts of a task.
#[derive(Default)]
pub struct Background {
    /// The constants, as Prolog prints them.
    pub constants: IndexSet<String>,
    /// For each predicate, its rows of constants.
    pub rows: IndexMap<Key, IndexSet<Box<[u32]>>>,
}

impl Background {
    /// Reads facts and rules, and derives what follows from the rules.
    pub fn read(sources: &Sources, source: SourceId, limits: Limits, faults: &mut Faults) -> Background {
        let mut background = Background::default();
        let mut rules = Vec::new();
        for clause in parse(sources, source, Directives::Goals, faults) {
            if let Err(fault) = background.add(clause, &mut rules) {
                faults.push(fault);
            }
        }
        if !rules.is_empty() && !faults.failed() {
            background.derive(&rules, limits, faults);
        }
        background
    }

    fn add(&mut self, clause: Clause, rules: &mut Vec<Clause>) -> Result<(), Diagnostic> {
        let Some(head) = &clause.head else {
            let [Literal::Atom { atom, .. }] = clause.body.as_slice() else {
                return Ok(());
            };
            let (name, predicates) = predicate(atom)?;
            if !HARMLESS.contains(&name) {
                return Err(unsupported(atom.span, "this directive").help("write the facts that it would add"));
            }
            for term in predicates.iter().filter(|_| name == "dynamic") {
                if let Kind::Tuple(parts) = &term.kind
                    && let [Kind::Constant(name), Kind::Constant(arity)] = [&parts[0].kind, &parts[1].kind]
                    && let Ok(arity) = arity.parse()
                {
                    self.rows.entry((name.clone(), arity)).or_default();
                }
            }
            return Ok(());
        };
        let (name, terms) = predicate(head)?;
        let key = (name.to_owned(), terms.len());
        if !clause.body.is_empty() {
            self.rows.entry(key).or_default();
            rules.push(clause);
            return Ok(());
        }
        let row = self.row(terms)?;
        self.rows.entry(key).or_default().insert(row);
        Ok(())
    }

    /// Returns the constants of a fact as numbers.
    pub fn row(&mut self, terms: &[Term]) -> Result<Box<[u32]>, Diagnostic> {
        let mut number = |term: &Term| match &term.kind {
            Kind::Constant(text) => Ok(self.constants.insert_full(text.clone()).0 as u32),
            Kind::Variable(name) => {
                let message = format!("a fact with the variable `{name}`");
                let fault = Diagnostic::new(codes::UNBOUND_VARIABLE, message).at(term.span, "a variable");
                Err(fault.help("constants begin with a lowercase letter or stand in single quotes"))
            }
            // The learner only compares constants, so a term without variables can be one.
            Kind::Compound(..) if term.is_ground() => Ok(self.constants.insert_full(term.to_string()).0 as u32),
            _ => Err(unsupported(term.span, "a function term with variables")),
        };
        terms.iter().map(&mut number).collect()
    }

    /// Derives what follows from rules, with the Datalog engine.
    fn derive(&mut self, rules: &[Clause], limits: Limits, faults: &mut Faults) {
        let mut translation = Translation::default();
        for rule in rules {
            if let Err(fault) = translation.rule(self, rule) {
                faults.push(fault);
            }
        }
        if faults.failed() {
            return;
        }
        let text = translation.program(self);
        let mut sources = Sources::new();
        let entry = sources.add("rules", text);
        let nothing = |_: &Path| Err(ReadError::NotFound);
        let (program, diagnostics) = Program::load(&mut sources, entry, &nothing);
        let mut report = |fault: Diagnostic| {
            let line = fault.primary.map(|label| sources.position(label.span).line - 1);
            let line = line.filter(|line| *line < rules.len());
            let mut mapped = Diagnostic::new(fault.code, translation.names(self, line, &fault.message));
            mapped.limit = fault.limit;
            faults.push(match line {
                Some(line) => mapped.at(rules[line].span, "in this rule"),
                None => mapped,
            });
        };
        let Some(program) = program else {
            diagnostics.into_iter().filter(Diagnostic::is_error).for_each(report);
            return;
        };
        let mut session = program.session();
        session.set_limits(limits);
        let names: Vec<Value> = self.constants.iter().map(|text| session.intern(text)).collect();
        let predicate = |name: String| program.predicate(&name).expect("the program declares it");
        let inserted = self.rows.values().enumerate().try_for_each(|(index, rows)| {
            let given = predicate(format!("f{index}"));
            let values = |row: &[u32]| -> Vec<Value> { row.iter().map(|&constant| names[constant as usize]).collect() };
            rows.iter().try_for_each(|row| session.insert(given, values(row)))
        });
        let ranks = ranks(&self.constants);
        let inserted = inserted.and_then(|()| {
            let rank = predicate("rank".to_owned());
            let mut rows = ranks.into_iter();
            rows.try_for_each(|(constant, place)| session.insert(rank, [names[constant], Value::number(place)]))
        });
        if let Err(error) = inserted {
            return report(Diagnostic::new(diag::codes::LIMIT_EXCEEDED, error.to_string()));
        }
        if let Err(error) = session.commit() {
            return report(error.diagnostic(program.rules()));
        }
        let derived: Vec<PredicateId> = (0..self.rows.len())
            .map(|index| predicate(format!("p{index}")))
            .collect();
        for (rows, id) in self.rows.values_mut().zip(derived) {
            for row in session.encoded_rows(id) {
                let text = |value: &Value| session.symbols().resolve(Symbol(value.0)).unwrap_or_default();
                let numbers = row
                    .iter()
                    .map(|value| self.constants.get_index_of(text(value)).unwrap_or(0) as u32);
                rows.insert(numbers.collect());
            }
        }
    }
}

/// Splits a head or a fact into its name and its arguments.
pub fn predicate(term: &Term) -> Result<(&str, &[Term]), Diagnostic> {
    match &term.kind {
        Kind::Compound(name, terms) => Ok((name, terms)),
        Kind::Constant(name) => Ok((name, &[])),
        _ => Err(Diagnostic::new(codes::SYNTAX, "expected a predicate").at(term.span, "not a predicate")),
    }
}

/// Returns the constants that are numbers, each with its place in ascending order.
fn ranks(constants: &IndexSet<String>) -> Vec<(usize, i32)> {
    let value = |text: &str| -> Option<(f64, i128)> {
        let is_number = text.starts_with(|c: char| c.is_ascii_digit() || c == '-');
        let float = text.parse::<f64>().ok().filter(|_| is_number)?;
        Some((float, text.parse().unwrap_or(float as i128)))
    };
    let mut numbers: Vec<((f64, i128), usize)> = (constants.iter().enumerate())
        .filter_map(|(index, text)| Some((value(text)?, index)))
        .collect();
    numbers.sort_by(|a, b| a.0.0.total_cmp(&b.0.0).then(a.0.1.cmp(&b.0.1)));
    let mut rank = 0;
    let places = (0..numbers.len()).map(|at| {
        rank += i32::from(at > 0 && numbers[at].0 != numbers[at - 1].0);
        (numbers[at].1, rank)
    });
    places.collect()
}

/// Prolog rules as rules of the Datalog engine, one per line.
#[derive(Default)]
struct Translation {
    lines: Vec<String>,
    /// For each line, the names of its variables.
    variables: Vec<Vec<String>>,
}

impl Translation {
    fn rule(&mut self, background: &mut Background, clause: &Clause) -> Result<(), Diagnostic> {
        let mut variables: IndexMap<&str, usize> = IndexMap::new();
        let mut terms: Vec<&Term> = clause.head.iter().collect();
        for literal in &clause.body {
            match literal {
                Literal::Atom { atom, .. } => terms.push(atom),
                Literal::Comparison { left, right, .. } => terms.extend([left, right]),
            }
        }
        for term in terms {
            let own = std::slice::from_ref(term);
            for term in if let Kind::Compound(_, inside) = &term.kind {
                inside
            } else {
                own
            } {
                if let Kind::Variable(name) = &term.kind {
                    *variables.entry(name).or_default() += 1;
                }
            }
        }
        let print = |background: &mut Background, term: &Term, is_negated: bool| match &term.kind {
            Kind::Variable(name) if name == "_" || is_negated && variables[name.as_str()] == 1 => Ok("_".to_owned()),
            Kind::Variable(name) => Ok(format!("v{}", variables.get_index_of(name.as_str()).unwrap_or(0))),
            Kind::Constant(text) => {
                background.constants.insert(text.clone());
                Ok(quoted(text))
            }
            _ => Err(unsupported(term.span, "a function term")),
        };
        let atom = |background: &mut Background, atom: &Term, is_negated: bool| -> Result<String, Diagnostic> {
            let (name, terms) = predicate(atom)?;
            let terms: Result<Vec<String>, _> =
                (terms.iter()).map(|term| print(background, term, is_negated)).collect();
            let terms = terms?;
            let key = (name.to_owned(), terms.len());
            let Some(index) = background.rows.get_index_of(&key) else {
                return Err(unknown(background, &key, atom.span));
            };
            Ok(format!(
                "{}p{index}({})",
                if is_negated { "!" } else { "" },
                terms.join(", ")
            ))
        };
        let head = clause
            .head
            .as_ref()
            .map_or(Ok(String::new()), |head| atom(background, head, false))?;
        let mut body = Vec::new();
        for literal in &clause.body {
            match literal {
                Literal::Atom {
                    is_negated,
                    atom: inside,
                } => body.push(atom(background, inside, *is_negated)?),
                Literal::Comparison { left, operator, right } => {
                    let sides = [
                        print_side(background, left, &variables)?,
                        print_side(background, right, &variables)?,
                    ];
                    let [one, other] = &sides;
                    match *operator {
                        "=" | "==" => body.push(format!("{one} = {other}")),
                        "\\=" | "\\==" => body.push(format!("{one} != {other}")),
                        operator => {
                            // The engine compares the places of numbers in their order.
                            let (first, second) = (format!("r{}", body.len()), format!("s{}", body.len()));
                            let operator = match operator {
                                "=<" => "<=",
                                "=:=" => "=",
                                "=\\=" => "!=",
                                same => same,
                            };
                            body.push(format!(
                                "rank({one}, {first}), rank({other}, {second}), {first} {operator} {second}"
                            ));
                        }
                    }
                }
            }
        }
        self.lines.push(format!("{head} :- {}.", body.join(", ")));
        self.variables
            .push(variables.keys().map(|&name| name.to_owned()).collect());
        Ok(())
    }

    /// Returns the program: the rules in its first lines, then declarations.
    fn program(&self, background: &Background) -> String {
        let mut text = self.lines.join("\n");
        text += "\n.decl rank(constant: symbol, place: number)\n.input rank\n";
        for (index, (_, arity)) in background.rows.keys().enumerate() {
            let columns: Vec<String> = (0..*arity).map(|at| format!("a{at}: symbol")).collect();
            let names: Vec<String> = (0..*arity).map(|at| format!("a{at}")).collect();
            let (columns, names) = (columns.join(", "), names.join(", "));
            let _ = writeln!(
                text,
                ".decl f{index}({columns})\n.input f{index}\n.decl p{index}({columns})\n\
                 p{index}({names}) :- f{index}({names})."
            );
        }
        text
    }

    /// Replaces the names of the program in a message about a line by those of the task.
    fn names(&self, background: &Background, line: Option<usize>, message: &str) -> String {
        let mut parts: Vec<String> = message.split('`').map(str::to_owned).collect();
        for part in parts.iter_mut().skip(1).step_by(2) {
            let index = |kind| part.strip_prefix(kind)?.parse::<usize>().ok();
            let predicate = index('p').and_then(|index| background.rows.get_index(index));
            let variable = index('v').and_then(|index| self.variables[line?].get(index));
            match (predicate, variable) {
                (Some(((name, arity), _)), _) => *part = format!("{name}/{arity}"),
                (_, Some(name)) => part.clone_from(name),
                _ => {}
            }
        }
        parts.join("`")
    }
}

/// Prints a side of a comparison.
fn print_side(
    background: &mut Background,
    term: &Term,
    variables: &IndexMap<&str, usize>,
) -> Result<String, Diagnostic> {
    match &term.kind {
        Kind::Variable(name) if name == "_" => Err(unsupported(term.span, "an anonymous variable in a comparison")),
        Kind::Variable(name) => Ok(format!("v{}", variables.get_index_of(name.as_str()).unwrap_or(0))),
        Kind::Constant(text) => {
            background.constants.insert(text.clone());
            Ok(quoted(text))
        }
        _ => Err(unsupported(term.span, "arithmetic")),
    }
}

/// The fault of a predicate without facts and rules.
pub fn unknown(background: &Background, (name, arity): &Key, span: Span) -> Diagnostic {
    let fault = Diagnostic::new(
        codes::UNKNOWN_PREDICATE,
        format!("the background knowledge has no facts and no rules of `{name}/{arity}`"),
    );
    let fault = fault.at(span, "unknown predicate");
    let others: Vec<&str> = background.rows.keys().map(|(name, _)| name.as_str()).collect();
    match did_you_mean(name, others) {
        Some(near) if near != name => fault.help(format!("did you mean `{near}`?")),
        Some(_) => fault.help("a predicate of this name has another number of arguments"),
        None => fault,
    }
}
