//! The bias of a task: which predicates clauses consist of, and how they bind variables.

use crate::datalog::codes;
use crate::diag::{Diagnostic, Faults, SourceId, Sources, Span};
use crate::induce::{ARITY_MAX, Link, VARIABLES_MAX};
use crate::popper::background::{Key, predicate};
use crate::popper::prolog::{Clause, Directives, Kind, Term, parse, unsupported};
use crate::popper::tokens::is_word;
use indexmap::{IndexMap, IndexSet};

/// The maximum number of variables of a clause if the bias does not set them, as in Popper.
const VARIABLES: usize = 6;

/// Settings that bound the size of a solution. The learner prefers short clauses and few of them without a bound.
const SIZES: [&str; 4] = ["max_body", "max_clauses", "max_rules", "max_literals"];

/// The predicates of a task and their declarations.
#[derive(Default)]
pub struct Bias {
    /// The predicate to learn.
    pub head: Option<(Key, Span)>,
    /// The predicates of bodies.
    pub body: IndexMap<Key, Span>,
    /// The types of the arguments of predicates.
    pub types: IndexMap<Key, Vec<String>>,
    /// How predicates bind variables.
    directions: IndexMap<Key, u8>,
    variables: Option<usize>,
    /// The types of which a clause has exactly one variable, with the places of these constraints.
    single: IndexMap<String, Span>,
}

impl Bias {
    /// Reads the bias. Declarations that only bound or order the search of Popper have no effect; a warning names them.
    pub fn read(sources: &Sources, source: SourceId, faults: &mut Faults) -> Bias {
        let mut bias = Bias::default();
        for clause in parse(sources, source, Directives::Constraints, faults) {
            let text = &sources.text(source)[clause.span.range()];
            match single_type(text).filter(|_| clause.head.is_none()) {
                Some(name) => {
                    bias.single.insert(name, clause.span);
                }
                None => {
                    if let Err(fault) = bias.add(&clause) {
                        faults.push(fault);
                    }
                }
            }
        }
        // A clause about an argument of such a type has no other variable of it, if the head has one.
        let of_head = bias.head.as_ref().and_then(|(head, _)| bias.types.get(head));
        let is_one = |name: &str| of_head.is_some_and(|types| types.iter().filter(|own| *own == name).count() == 1);
        let typed = bias.all_types().is_some();
        let unused: Vec<String> = (bias.single.keys())
            .filter(|name| !typed || !is_one(name))
            .cloned()
            .collect();
        for name in unused {
            if let Some(span) = bias.single.shift_remove(&name) {
                let fault = ignored(span, "a constraint on clauses");
                faults.push(fault.note("it needs types of all predicates, and one argument of its type in the head"));
            }
        }
        if let Some((head, span)) = &bias.head {
            if bias.body.contains_key(head) {
                faults.push(recursion(bias.body[head]));
            }
            if !(1..=VARIABLES_MAX.min(bias.variables())).contains(&head.1) {
                let message = format!("a target with {} arguments is not supported", head.1);
                let most = VARIABLES_MAX.min(bias.variables());
                let fault = Diagnostic::new(codes::UNSUPPORTED, message).at(*span, "");
                faults.push(fault.help(format!("a target has 1 to {most} arguments")));
            }
        } else if !faults.failed() {
            let fault = Diagnostic::new(codes::SYNTAX, "the bias names no predicate to learn");
            let end = sources.text(source).len();
            let fault = fault.at(Span::new(source, end..end), "the end of the bias");
            faults.push(fault.help("add `head_pred(NAME,ARITY).`"));
        }
        bias
    }

    /// Returns the most variables of a clause.
    pub fn variables(&self) -> usize {
        self.variables.unwrap_or(VARIABLES)
    }

    /// Returns the types if the target and all predicates of bodies have them.
    pub fn all_types(&self) -> Option<&IndexMap<Key, Vec<String>>> {
        let mut all = self.body.keys().chain(self.head.iter().map(|(key, _)| key));
        all.all(|key| self.types.contains_key(key)).then_some(&self.types)
    }

    /// Returns the types of which a clause has only the variable in its head.
    pub fn single_types(&self) -> IndexSet<&str> {
        self.single.keys().map(String::as_str).collect()
    }

    /// Returns how the body predicates bind variables.
    pub fn links(&self) -> Vec<Link> {
        let link = |key| {
            self.directions
                .get(key)
                .map_or(Link::Any, |&inputs| Link::Inputs(inputs))
        };
        self.body.keys().map(link).collect()
    }

    fn add(&mut self, clause: &Clause) -> Result<(), Diagnostic> {
        let Some(head) = &clause.head else {
            return Err(ignored(clause.span, "a constraint on clauses"));
        };
        if !clause.body.is_empty() {
            return Err(ignored(clause.span, "a rule about clauses"));
        }
        let (name, terms) = predicate(head)?;
        match (name, terms) {
            ("head_pred", [name, arity]) => {
                let key = key(name, arity)?;
                if let Some((other, span)) = &self.head
                    && *other != key
                {
                    let fault = unsupported(head.span, "a second target").also(*span, "the first target");
                    return Err(fault.help("learn one predicate at a time"));
                }
                self.head = Some((key, head.span));
            }
            ("body_pred", [name, arity]) => {
                let key = key(name, arity)?;
                if !(1..=ARITY_MAX).contains(&key.1) {
                    let message = format!("`{}/{}` is not supported", key.0, key.1);
                    let fault = Diagnostic::new(codes::UNSUPPORTED, message).at(head.span, "");
                    return Err(fault.help(format!("a predicate of bodies has 1 to {ARITY_MAX} arguments")));
                }
                self.body.entry(key).or_insert(head.span);
            }
            ("max_vars", [count]) => {
                let count = number(count)?;
                self.variables = Some(count);
                if count > VARIABLES_MAX {
                    let fault = ignored(head.span, &format!("`max_vars` above {VARIABLES_MAX}"));
                    return Err(fault.note(format!("a clause has at most {VARIABLES_MAX} variables")));
                }
            }
            ("type", [name, types]) => {
                let types = names(types)?;
                self.types.insert((constant(name)?, types.len()), types);
            }
            ("direction", [name, directions]) => {
                let words = names(directions)?;
                let mut inputs = 0_u8;
                for (at, word) in words.iter().enumerate().take(8) {
                    match word.as_str() {
                        "in" => inputs |= 1 << at,
                        "out" => {}
                        _ => {
                            let fault = Diagnostic::new(codes::SYNTAX, "a direction is `in` or `out`");
                            return Err(fault.at(directions.span, "not a list of directions"));
                        }
                    }
                }
                self.directions.insert((constant(name)?, words.len()), inputs);
            }
            ("enable_recursion", _) => return Err(recursion(head.span)),
            ("head_pred" | "body_pred" | "max_vars" | "type" | "direction", _) => {
                let fault = Diagnostic::new(
                    codes::ARITY_MISMATCH,
                    format!("`{name}` with {} arguments", terms.len()),
                );
                return Err(fault.at(head.span, "wrong number of arguments"));
            }
            ("enable_pi", _) => {
                let fault = ignored(head.span, "`enable_pi`");
                return Err(fault.note("clauses without invented predicates define the same target"));
            }
            (name, _) if SIZES.contains(&name) => {
                let fault = ignored(head.span, &format!("`{name}`"));
                return Err(fault.note("the learner prefers short clauses and few of them without a bound"));
            }
            (name, _) => return Err(ignored(head.span, &format!("`{name}`"))),
        }
        Ok(())
    }
}

/// Returns the type in a constraint that a clause has exactly one variable of this type, for example
/// `:- clause(C), #count{V : var_type(C,V,state)} != 1.`
fn single_type(text: &str) -> Option<String> {
    let compact: String = text.chars().filter(|c| !c.is_whitespace()).collect();
    let (before, rest) = compact.strip_prefix(":-")?.split_once("#count{")?;
    let is_clause = before.is_empty() || before.starts_with("clause(") && before.ends_with("),");
    let condition = rest.strip_suffix("}!=1.")?.split_once(':')?.1;
    let (variables, typed) = condition.split_once("var_type(")?;
    let is_variable = variables.is_empty() || variables.starts_with("clause_var(") && variables.ends_with("),");
    let name = typed.strip_suffix(')')?.rsplit(',').next()?;
    let is_name = name.starts_with(|c: char| c.is_lowercase()) && name.chars().all(is_word);
    (is_clause && is_variable && is_name).then(|| name.to_owned())
}

fn recursion(span: Span) -> Diagnostic {
    let fault = Diagnostic::new(codes::UNSUPPORTED, "recursive clauses are not supported");
    fault
        .at(span, "")
        .help("remove this line to learn clauses without recursion")
}

/// The warning about a declaration without effect.
fn ignored(span: Span, what: &str) -> Diagnostic {
    Diagnostic::new(codes::IGNORED, format!("{what} has no effect")).at(span, "ignored")
}

fn constant(term: &Term) -> Result<String, Diagnostic> {
    match &term.kind {
        Kind::Constant(name) => Ok(name.clone()),
        _ => Err(Diagnostic::new(codes::SYNTAX, "expected a name").at(term.span, "not a name")),
    }
}

fn number(term: &Term) -> Result<usize, Diagnostic> {
    let count = constant(term)?.parse().ok().filter(|count| *count <= 1_000);
    count.ok_or_else(|| Diagnostic::new(codes::SYNTAX, "expected a number").at(term.span, "not a number up to 1000"))
}

fn key(name: &Term, arity: &Term) -> Result<Key, Diagnostic> {
    Ok((constant(name)?, number(arity)?))
}

/// Reads names in parentheses, or one without.
fn names(term: &Term) -> Result<Vec<String>, Diagnostic> {
    match &term.kind {
        Kind::Tuple(terms) => terms.iter().map(constant).collect(),
        _ => Ok(vec![constant(term)?]),
    }
}
