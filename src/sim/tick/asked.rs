//! Questions about facts of a city: `Stop`, `IsClose(Car_1, Car_2)`, `IsClose("Car_1", _)`.

use crate::city::Action;
use crate::config::Scenario;
use crate::datalog::codes;
use crate::datalog::explain::{ExplainError, Explainer, Explanation, ExplanationPrinter};
use crate::datalog::{BaseType, PredicateId, Rules, Session, Term, Value, is_name, parse_value};
use crate::diag::{Diagnostic, SourceId, Sources, Span, did_you_mean, listed};
use crate::symbol::Symbol;
use serde_json::json;

/// A predicate with a pattern of its rows; `None` matches any value.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AskedFact {
    /// The predicate.
    pub predicate: PredicateId,
    /// One value for each column.
    pub pattern: Vec<Option<Value>>,
}

/// Why a fact holds or does not hold.
#[derive(Clone, Debug)]
pub struct FactAccount {
    asked: AskedFact,
    /// Whether a row matches.
    pub holds: bool,
    explanation: Explanation,
}

impl AskedFact {
    /// Reads a question. The name of a predicate alone asks about the agent `ego`, in the first column. Names of agents
    /// need no quotes.
    ///
    /// `agents` are the names of those in the city. `question` is one of `sources`.
    ///
    /// # Errors
    /// `syntax`; `unknown-predicate`; `arity-mismatch`; `invalid-fact` for a value that is no agent or does not fit its
    /// column, or if the question needs an agent and there is no `ego`.
    pub fn read(
        sources: &Sources,
        question: SourceId,
        (scenario, session): (&Scenario, &Session),
        agents: &[&str],
        ego: Option<&str>,
    ) -> Result<AskedFact, Vec<Diagnostic>> {
        let rules = session.program().rules();
        let written = Written::read(sources, question).map_err(|fault| vec![fault])?;
        let (name, span) = &written.name;
        let found = rules
            .predicate(name)
            .filter(|predicate| !rules.predicates[predicate.index()].hidden);
        let Some(predicate) = found else {
            return Err(vec![unknown_predicate(rules, scenario, name, *span)]);
        };
        let declared = &rules.predicates[predicate.index()];
        let columns = &declared.columns;
        let Some(values) = &written.values else {
            let takes_agent = columns.first().is_some_and(|column| column.base == BaseType::Symbol);
            let first = match ego {
                Some(ego) if takes_agent => Some(Value(session.symbols().intern(ego).0)),
                None if takes_agent => {
                    let message = format!("`{name}` needs an agent");
                    let fault = Diagnostic::new(codes::INVALID_FACT, message).at(*span, "this names no agent");
                    let row: Vec<&str> = std::iter::once("Car_1")
                        .chain(columns[1..].iter().map(|_| "_"))
                        .collect();
                    return Err(vec![
                        fault.help(format!("write `{name}({})`, or name the agent", row.join(", "))),
                    ]);
                }
                _ => None,
            };
            let mut pattern = vec![None; columns.len()];
            pattern.iter_mut().take(1).for_each(|value| *value = first);
            return Ok(AskedFact { predicate, pattern });
        };
        if values.len() != columns.len() {
            let plural = |count: usize, word: &str| format!("{count} {word}{}", if count == 1 { "" } else { "s" });
            let message = format!(
                "`{name}` has {}, but {} given",
                plural(columns.len(), "column"),
                match values.len() {
                    1 => "1 value is".to_owned(),
                    count => format!("{count} values are"),
                }
            );
            let fault = Diagnostic::new(codes::ARITY_MISMATCH, message).at(written.whole, "");
            return Err(vec![fault.also(declared.span, "declared here")]);
        }
        let agent = Action::STANDARD
            .iter()
            .find_map(|action| rules.predicate(action.name()));
        let agent = agent
            .and_then(|action| rules.predicates[action.index()].columns.first())
            .map(|column| column.ty);
        let mut faults = Vec::new();
        let mut pattern = Vec::new();
        for ((text, quoted, span), column) in values.iter().zip(columns) {
            pattern.push(match column.base {
                _ if text == "_" && !quoted => None,
                BaseType::Symbol => {
                    let is_known = agents.contains(&text.as_str())
                        || rules.symbols.get(text).is_some_and(|symbol| names(rules, symbol));
                    if !is_known && agent == Some(column.ty) {
                        faults.push(unknown_agent(agents, text, *span));
                    }
                    Some(Value(session.symbols().intern(text).0))
                }
                base => {
                    let value = parse_value(base, text).filter(|_| !quoted);
                    if value.is_none() {
                        let message = format!("`{text}` is not a value of the type `{}`", base.name());
                        let fault = Diagnostic::new(codes::INVALID_FACT, message).at(*span, "");
                        faults.push(fault.also(declared.span, "declared here"));
                    }
                    value
                }
            });
        }
        match faults.is_empty() {
            true => Ok(AskedFact { predicate, pattern }),
            false => Err(faults),
        }
    }

    /// Explains why the fact holds or does not hold.
    ///
    /// # Errors
    /// If the search exceeds the limit of the explainer.
    pub fn explain(self, explainer: &mut Explainer<'_>) -> Result<FactAccount, ExplainError> {
        let (holds, explanation) = explainer.explain_either(self.predicate, &self.pattern)?;
        Ok(FactAccount {
            asked: self,
            holds,
            explanation: explanation.unwrap_or_default(),
        })
    }
}

impl FactAccount {
    fn printer<'s>(session: &'s Session, sources: &'s Sources) -> ExplanationPrinter<'s> {
        ExplanationPrinter::new(session.program().rules(), session.symbols(), sources).quoting()
    }

    /// Returns the fact as text.
    pub fn fact(&self, session: &Session, sources: &Sources) -> String {
        FactAccount::printer(session, sources).row(self.asked.predicate, &self.asked.pattern)
    }

    /// Returns the explanation as text: whether the fact holds, and a tree.
    pub fn text(&self, session: &Session, sources: &Sources) -> String {
        let holds = if self.holds { "holds" } else { "does not hold" };
        let tree = FactAccount::printer(session, sources).tree(&self.explanation);
        format!("{} {holds}, because:\n{tree}", self.fact(session, sources))
    }

    /// Returns the explanation as JSON: `fact`, `holds` and `nodes`, as `logicity query --explain --json` prints it.
    pub fn json(&self, session: &Session, sources: &Sources) -> serde_json::Value {
        let mut nodes = FactAccount::printer(session, sources).json(&self.explanation);
        json!({ "fact": self.fact(session, sources), "holds": self.holds, "nodes": nodes["nodes"].take() })
    }
}

/// Returns whether a constant of the rules has this text.
fn names(rules: &Rules, symbol: Symbol) -> bool {
    let wanted = Term::Constant(Value(symbol.0));
    let mut clauses = rules.clauses.iter();
    clauses.any(|clause| {
        let mut body = clause.body.iter().flat_map(|literal| literal.terms());
        clause.head.terms.contains(&wanted) || body.any(|term| *term == wanted)
    })
}

fn unknown_predicate(rules: &Rules, scenario: &Scenario, name: &str, span: Span) -> Diagnostic {
    let fault = Diagnostic::new(codes::UNKNOWN_PREDICATE, format!("no predicate `{name}` is declared")).at(span, "");
    if scenario.predicates.iter().any(|known| known.name.value == name) {
        return fault.note(format!(
            "the configuration `{}` defines it, but the rules do not declare it as input",
            scenario.name
        ));
    }
    let visible = rules.predicates.iter().filter(|predicate| !predicate.hidden);
    match did_you_mean(name, visible.map(|predicate| predicate.name.as_str())) {
        Some(near) => fault.did_you_mean(near, &[span]),
        None => fault,
    }
}

fn unknown_agent(agents: &[&str], name: &str, span: Span) -> Diagnostic {
    let fault = Diagnostic::new(codes::INVALID_FACT, format!("there is no agent `{name}`")).at(span, "");
    match did_you_mean(name, agents.iter().copied()) {
        Some(near) => fault.did_you_mean(near, &[span]),
        None => fault.note(format!("the agents are {}", listed(agents))),
    }
}

/// A question as it is written.
struct Written {
    name: (String, Span),
    /// The values, whether they stand in quotes, and their places; `None` for a predicate alone.
    values: Option<Vec<(String, bool, Span)>>,
    whole: Span,
}

impl Written {
    fn read(sources: &Sources, question: SourceId) -> Result<Written, Diagnostic> {
        let text = sources.text(question);
        let trimmed = text.trim();
        let trimmed = trimmed.strip_suffix('.').unwrap_or(trimmed).trim_end();
        let begin = text.find(trimmed).unwrap_or(0);
        let whole = Span::new(question, begin..begin + trimmed.len());
        let wrong = |span: Span, label: &str| {
            let fault = Diagnostic::new(codes::SYNTAX, "expected a predicate, or a predicate with its values");
            fault
                .at(span, label)
                .help("for example `Stop`, `Stop(Car_1)` or `IsClose(Car_1, _)`")
        };
        let open = trimmed.find('(');
        let name = trimmed[..open.unwrap_or(trimmed.len())].trim_end();
        let span = Span::new(question, begin..begin + name.len());
        if !is_name(name) {
            return Err(wrong(span, "this is not the name of a predicate"));
        }
        let name = (name.to_owned(), span);
        let Some(open) = open else {
            return Ok(Written {
                name,
                values: None,
                whole,
            });
        };
        let Some(inner) = trimmed[open + 1..].strip_suffix(')') else {
            return Err(wrong(whole, "a parenthesis is not closed"));
        };
        let mut values = Vec::new();
        let (mut rest, mut at) = (inner, begin + open + 1);
        while !(values.is_empty() && rest.trim().is_empty()) {
            let space = rest.len() - rest.trim_start().len();
            (rest, at) = (&rest[space..], at + space);
            let (value, quoted, length) = match rest.strip_prefix('"') {
                Some(inside) => {
                    let span = Span::new(question, at..at + rest.len());
                    let end = inside.find('"').ok_or_else(|| wrong(span, "a quote is not closed"))?;
                    (&inside[..end], true, end + 2)
                }
                None => {
                    let end = rest.find(',').unwrap_or(rest.len());
                    let value = rest[..end].trim_end();
                    (value, false, value.len())
                }
            };
            let span = Span::new(question, at..at + length);
            let plain = |value: &str| {
                let allowed = |letter: char| letter.is_alphanumeric() || "_-.+".contains(letter);
                !value.is_empty() && value.chars().all(allowed)
            };
            if !quoted && !plain(value) {
                return Err(wrong(span, "this is not a value: write strings in double quotes"));
            }
            values.push((value.to_owned(), quoted, span));
            (rest, at) = (&rest[length..], at + length);
            let space = rest.len() - rest.trim_start().len();
            (rest, at) = (&rest[space..], at + space);
            match rest.strip_prefix(',') {
                Some(more) => (rest, at) = (more, at + 1),
                None if rest.is_empty() => break,
                None => return Err(wrong(Span::new(question, at..at + rest.len()), "expected a comma")),
            }
        }
        Ok(Written {
            name,
            values: Some(values),
            whole,
        })
    }
}
