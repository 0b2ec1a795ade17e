//! The bias of a task: which predicates clauses consist of, and how they bind variables.
//!
//! A bias is an answer set program. Its facts are declarations. Rules over its other facts can make declarations, too:
//! `body_pred(P,1) :- constant(P,_).` makes one for each fact of `constant/2`.

use crate::datalog::codes;
use crate::diag::{Diagnostic, Faults, SourceId, Sources, Span};
use crate::induce::{ARITY_MAX, Link, VARIABLES_MAX};
use crate::popper::background::{Key, predicate};
use crate::popper::prolog::{Clause, Directives, Kind, Literal, Term, parse, unsupported};
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
    /// Arguments of body predicates that must be a variable of the head: the predicate, the position of the argument,
    /// that of the variable.
    pinned: Vec<(Key, usize, usize)>,
    /// The facts that are no declarations.
    facts: IndexMap<Key, Rows>,
}

/// The facts of a predicate that is no declaration.
#[derive(Default)]
struct Rows {
    /// The arguments, with the places of the facts.
    rows: Vec<(Vec<Term>, Span)>,
    /// Whether a rule uses them.
    is_used: bool,
}

impl Bias {
    /// Reads the bias. Declarations that only bound or order the search of Popper have no effect; a warning names them.
    pub fn read(sources: &Sources, source: SourceId, faults: &mut Faults) -> Bias {
        let mut bias = Bias::default();
        let mut rules = Vec::new();
        for clause in parse(sources, source, Directives::Constraints, faults) {
            let text = &sources.text(source)[clause.span.range()];
            match single_type(text).filter(|_| clause.head.is_none()) {
                Some(name) => {
                    bias.single.insert(name, clause.span);
                }
                None if clause.head.is_some() && !clause.body.is_empty() => rules.push(clause),
                None => {
                    if let Err(fault) = bias.add(&clause) {
                        faults.push(fault);
                    }
                }
            }
        }
        for rule in &rules {
            if let Err(fault) = bias.apply(rule, faults) {
                faults.push(fault);
            }
        }
        for ((name, _), Rows { rows, .. }) in bias.facts.iter().filter(|(_, rows)| !rows.is_used) {
            rows.iter()
                .for_each(|(_, span)| faults.push(ignored(*span, &format!("`{name}`"))));
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

    /// Returns how the body predicates bind variables.
    pub fn links(&self) -> Vec<Link> {
        let link = |key| {
            self.directions
                .get(key)
                .map_or(Link::Any, |&inputs| Link::Inputs(inputs))
        };
        self.body.keys().map(link).collect()
    }

    /// Returns the only variable of the head that each argument of a body predicate can be, if there is one.
    pub fn pinned(&self) -> Vec<Vec<Option<u8>>> {
        let head_types = self.head.as_ref().and_then(|(head, _)| self.types.get(head));
        let single = |name: &String| {
            let of_head = head_types.into_iter().flatten();
            let place = of_head.clone().position(|own| own == name)?;
            self.single.contains_key(name).then_some(place as u8)
        };
        let of = |key: &Key| -> Vec<Option<u8>> {
            let types = self.types.get(key);
            let mut pins: Vec<Option<u8>> = (0..key.1)
                .map(|at| types.and_then(|types| single(types.get(at)?)))
                .collect();
            for (_, at, variable) in self.pinned.iter().filter(|(pinned, ..)| pinned == key) {
                pins[*at] = Some(*variable as u8);
            }
            pins
        };
        self.body.keys().map(of).collect()
    }

    /// Applies a rule: it makes declarations, or restricts the arguments of a predicate.
    fn apply(&mut self, rule: &Clause, faults: &mut Faults) -> Result<(), Diagnostic> {
        let head = rule.head.as_ref().expect("a rule has a head");
        let (name, _) = predicate(head)?;
        if name == "bad_body" {
            let pin = pin(head, &rule.body).filter(|(key, at, variable)| {
                let arity = self.head.as_ref().map_or(0, |(head, _)| head.1);
                self.body.contains_key(key) && *at < key.1 && *variable < arity
            });
            let (key, at, variable) = pin.ok_or_else(|| ignored(rule.span, "a rule about clauses"))?;
            self.pinned.push((key, at, variable));
            return Ok(());
        }
        if !DECLARATIONS.contains(&name) {
            return Err(ignored(rule.span, "a rule about clauses"));
        }
        let mut bindings: Vec<Bindings> = vec![Bindings::default()];
        for literal in &rule.body {
            let Literal::Atom {
                is_negated: false,
                atom,
            } = literal
            else {
                return Err(ignored(rule.span, "a rule with negation or comparisons"));
            };
            let (name, terms) = predicate(atom)?;
            let Some(Rows { rows, is_used }) = self.facts.get_mut(&(name.to_owned(), terms.len())) else {
                let message = format!("no fact of the bias has the predicate `{name}/{}`", terms.len());
                let fault = Diagnostic::new(codes::UNKNOWN_PREDICATE, message).at(atom.span, "unknown predicate");
                return Err(fault.help("rules of the bias can use its facts only"));
            };
            *is_used = true;
            bindings = (bindings.iter())
                .flat_map(|binding| rows.iter().filter_map(|(row, _)| binding.matched(terms, row)))
                .collect();
        }
        let mut made = IndexSet::new();
        for binding in bindings {
            let declaration = binding.applied(head)?;
            // Rows that differ in other arguments make the same declaration.
            if made.insert(declaration.to_string()) {
                let clause = Clause {
                    head: Some(declaration),
                    body: Vec::new(),
                    span: rule.span,
                };
                if let Err(fault) = self.add(&clause) {
                    faults.push(fault);
                    break;
                }
            }
        }
        Ok(())
    }

    fn add(&mut self, clause: &Clause) -> Result<(), Diagnostic> {
        let Some(head) = &clause.head else {
            return Err(ignored(clause.span, "a constraint on clauses"));
        };
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
            (name, _) => {
                let known = self.facts.entry((name.to_owned(), terms.len())).or_default();
                known.rows.push((terms.to_vec(), head.span));
            }
        }
        Ok(())
    }
}

/// The declarations that rules can make.
const DECLARATIONS: [&str; 4] = ["head_pred", "body_pred", "type", "direction"];

/// The values of variables of a rule.
#[derive(Clone, Default)]
struct Bindings<'a>(IndexMap<&'a str, Term>);

impl<'a> Bindings<'a> {
    /// Returns the bindings with those under which terms equal a row, if there are any.
    fn matched(&self, terms: &'a [Term], row: &[Term]) -> Option<Bindings<'a>> {
        let mut bindings = self.clone();
        for (term, value) in terms.iter().zip(row) {
            match &term.kind {
                Kind::Variable(name) if name == "_" => {}
                Kind::Variable(name) => {
                    let known = bindings.0.entry(name).or_insert_with(|| value.clone());
                    if known.kind != value.kind {
                        return None;
                    }
                }
                kind if *kind == value.kind => {}
                _ => return None,
            }
        }
        Some(bindings)
    }

    /// Returns a term with the values of its variables.
    fn applied(&self, term: &Term) -> Result<Term, Diagnostic> {
        let all = |terms: &[Term]| {
            terms
                .iter()
                .map(|term| self.applied(term))
                .collect::<Result<Vec<_>, _>>()
        };
        let kind = match &term.kind {
            Kind::Variable(name) => match self.0.get(name.as_str()) {
                Some(value) => value.kind.clone(),
                None => {
                    let message = format!("nothing in this rule binds `{name}`");
                    return Err(Diagnostic::new(codes::UNBOUND_VARIABLE, message).at(term.span, "a variable"));
                }
            },
            Kind::Compound(name, terms) => Kind::Compound(name.clone(), all(terms)?),
            Kind::Tuple(terms) => Kind::Tuple(all(terms)?),
            constant @ Kind::Constant(_) => constant.clone(),
        };
        Ok(Term { kind, span: term.span })
    }
}

/// Returns the predicate, the position of an argument, and the variable of the head that it must be, in a rule such as
/// `bad_body(p,Vars) :- vars(_,Vars), Vars = (V0,_), V0 != 0.`
fn pin(head: &Term, body: &[Literal]) -> Option<(Key, usize, usize)> {
    let Kind::Compound(_, terms) = &head.kind else {
        return None;
    };
    let [
        Term {
            kind: Kind::Constant(name),
            ..
        },
        Term {
            kind: Kind::Variable(variables),
            ..
        },
    ] = terms.as_slice()
    else {
        return None;
    };
    let [
        Literal::Atom {
            is_negated: false,
            atom,
        },
        Literal::Comparison {
            left: whole,
            operator: "=",
            right: Term {
                kind: Kind::Tuple(parts),
                ..
            },
        },
        Literal::Comparison {
            left: part,
            operator: "!=",
            right: Term {
                kind: Kind::Constant(number),
                ..
            },
        },
    ] = body
    else {
        return None;
    };
    let is_all = |term: &Term| term.kind == Kind::Variable(variables.clone());
    let is_of_clauses =
        matches!(&atom.kind, Kind::Compound(name, terms) if name == "vars" && terms.len() == 2 && is_all(&terms[1]));
    let at = parts
        .iter()
        .position(|other| other.kind == part.kind && matches!(&other.kind, Kind::Variable(name) if name != "_"))?;
    let variable = number.parse().ok()?;
    (is_of_clauses && is_all(whole)).then(|| ((name.clone(), parts.len()), at, variable))
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
