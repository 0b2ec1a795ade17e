//! Questions about facts of a city: `Stop`, `IsClose(Car_1, Car_2)`, `IsClose("Car_1", _)`.

use crate::city::Action;
use crate::config::Scenario;
use crate::datalog::codes;
use crate::datalog::explain::{AbsenceReason, ExplainError, Explainer, Explanation, ExplanationPrinter, Node, Origin};
use crate::datalog::{BaseType, PredicateId, Rules, Session, Term, Value, is_name, parse_value};
use crate::diag::{Diagnostic, SourceId, Sources, Span, did_you_mean, listed};
use crate::predicate::Definition;
use crate::symbol::Symbol;
use serde_json::json;
use std::ops::Range;

/// A predicate with a pattern of its rows; `None` matches any value.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AskedFact {
    /// The predicate.
    pub predicate: PredicateId,
    /// One value for each column.
    pub pattern: Vec<Option<Value>>,
    /// How the city computes the rows of a base predicate, in words.
    computed: Option<String>,
    /// Whether the last column is the value of a quantity.
    is_quantity: bool,
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
        known: (&Scenario, &Session),
        agents: &[&str],
        ego: Option<&str>,
    ) -> Result<AskedFact, Vec<Diagnostic>> {
        if let Some(written) = WrittenTemporal::read(sources, question).map_err(|fault| vec![fault])? {
            let message = "only the trace of a run knows earlier ticks";
            let fault = Diagnostic::new(codes::INVALID_FACT, message).at(written.whole, "asks about earlier ticks");
            let help = "ask `logicity explain TRACE --why ...`, or about a predicate whose clause has this literal";
            return Err(vec![fault.help(help)]);
        }
        let whole = 0..sources.text(question).len();
        AskedFact::read_within((sources, question, whole), known, agents, ego)
    }

    /// Reads a question that is a part of a text.
    fn read_within(
        (sources, question, range): (&Sources, SourceId, Range<usize>),
        (scenario, session): (&Scenario, &Session),
        agents: &[&str],
        ego: Option<&str>,
    ) -> Result<AskedFact, Vec<Diagnostic>> {
        let rules = session.program().rules();
        let written = Written::read(sources, question, range).map_err(|fault| vec![fault])?;
        let (name, span) = &written.name;
        let found = rules
            .predicate(name)
            .filter(|predicate| !rules.predicates[predicate.index()].hidden);
        let Some(predicate) = found else {
            return Err(vec![unknown_predicate(rules, scenario, name, *span)]);
        };
        let declared = &rules.predicates[predicate.index()];
        let computed = declared.input.then(|| computed(scenario, name)).flatten();
        let is_quantity = (scenario.predicates.iter())
            .any(|known| known.name.value == *name && matches!(known.definition, Definition::Quantity(_)));
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
            return Ok(AskedFact {
                predicate,
                pattern,
                computed,
                is_quantity,
            });
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
            true => Ok(AskedFact {
                predicate,
                pattern,
                computed,
                is_quantity,
            }),
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

impl AskedFact {
    /// Returns whether a row matches.
    fn matches(&self, session: &Session) -> bool {
        if let Some(row) = self.pattern.iter().copied().collect::<Option<Vec<Value>>>() {
            return session.contains(self.predicate, &row[..]);
        }
        let fits = |row: Vec<Value>| {
            let mut columns = self.pattern.iter().zip(row);
            columns.all(|(wanted, value)| wanted.is_none_or(|wanted| wanted == value))
        };
        session.rows(self.predicate).is_ok_and(|mut rows| rows.any(fits))
    }

    /// Returns the words for the value that the agents have instead, if the predicate is a quantity.
    fn other_value(&self, session: &Session, sources: &Sources) -> Option<String> {
        let (_, agents) = self.pattern.split_last().filter(|_| self.is_quantity)?;
        let other = AskedFact {
            predicate: self.predicate,
            pattern: agents.iter().copied().chain([None]).collect(),
            computed: None,
            is_quantity: false,
        };
        let fits = |row: &Vec<Value>| {
            other
                .pattern
                .iter()
                .zip(row)
                .all(|(wanted, value)| wanted.is_none_or(|wanted| wanted == *value))
        };
        let row = session.rows(self.predicate).ok()?.find(fits)?;
        let row: Vec<Option<Value>> = row.into_iter().map(Some).collect();
        Some(format!(
            "; {} holds",
            FactAccount::printer(session, sources).row(self.predicate, &row)
        ))
    }

    /// Returns the fact as text.
    fn shown(&self, session: &Session, sources: &Sources) -> String {
        FactAccount::printer(session, sources).row(self.predicate, &self.pattern)
    }
}

impl FactAccount {
    fn printer<'s>(session: &'s Session, sources: &'s Sources) -> ExplanationPrinter<'s> {
        ExplanationPrinter::new(session.program().rules(), session.symbols(), sources).quoting()
    }

    /// Returns the fact as text.
    pub fn fact(&self, session: &Session, sources: &Sources) -> String {
        self.asked.shown(session, sources)
    }

    /// Returns how the city computes the fact, or facts like an absent one; `None` unless it is a base fact.
    pub fn computed(&self) -> Option<&str> {
        let is_base = match self.explanation.nodes().first() {
            Some(Node::Fact(fact)) => fact.origin == Origin::Input,
            Some(Node::Absence(absence)) => absence.reason == AbsenceReason::NotAFact,
            None => false,
        };
        self.asked.computed.as_deref().filter(|_| is_base)
    }

    /// Returns the explanation as text: whether the fact holds, and a tree, or how the city computes a base fact.
    pub fn text(&self, session: &Session, sources: &Sources) -> String {
        let holds = if self.holds { "holds" } else { "does not hold" };
        if let Some(computed) = self.computed() {
            let fact = self.fact(session, sources);
            // With `_`, the row that was found.
            let found = match self.explanation.nodes().first() {
                Some(Node::Fact(_)) if self.asked.pattern.contains(&None) => {
                    let row = self.found().unwrap_or_default();
                    format!(
                        ", as {}",
                        FactAccount::printer(session, sources).row(self.asked.predicate, &row)
                    )
                }
                _ => String::new(),
            };
            let other = match self.holds {
                true => String::new(),
                false => self.asked.other_value(session, sources).unwrap_or_default(),
            };
            return format!("{fact} {holds}{found}: it is a base fact, {computed}{other}\n");
        }
        let tree = FactAccount::printer(session, sources).tree(&self.explanation);
        format!("{} {holds}, because:\n{tree}", self.fact(session, sources))
    }

    /// Returns the row that was found.
    fn found(&self) -> Option<Vec<Option<Value>>> {
        match self.explanation.nodes().first()? {
            Node::Fact(fact) => Some(fact.row.iter().copied().map(Some).collect()),
            Node::Absence(_) => None,
        }
    }

    /// Returns the explanation as JSON: `fact`, `holds` and `nodes`, as `logicity query --explain --json` prints it.
    pub fn json(&self, session: &Session, sources: &Sources) -> serde_json::Value {
        let mut nodes = FactAccount::printer(session, sources).json(&self.explanation);
        json!({ "fact": self.fact(session, sources), "holds": self.holds, "nodes": nodes["nodes"].take() })
    }
}

/// Returns how a configuration computes a base predicate, in words.
fn computed(scenario: &Scenario, name: &str) -> Option<String> {
    let known = scenario.predicates.iter().find(|known| known.name.value == name)?;
    let inputs = known.definition.inputs();
    let written = &scenario.composed["predicates"]["define"][name];
    Some(match written.is_null() {
        true => format!("computed from {inputs}"),
        false => format!("computed as `{}` from {inputs}", flow(written)),
    })
}

/// Returns a value in the notation of configurations, on one line.
fn flow(value: &serde_json::Value) -> String {
    match value {
        serde_json::Value::Object(keys) => {
            let keys: Vec<String> = keys
                .iter()
                .map(|(key, value)| format!("{key}: {}", flow(value)))
                .collect();
            format!("{{{}}}", keys.join(", "))
        }
        serde_json::Value::Array(items) => format!("[{}]", items.iter().map(flow).collect::<Vec<_>>().join(", ")),
        serde_json::Value::String(text) => text.clone(),
        other => other.to_string(),
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
    fn read(sources: &Sources, question: SourceId, range: Range<usize>) -> Result<Written, Diagnostic> {
        let text = &sources.text(question)[range.clone()];
        let trimmed = text.trim();
        let trimmed = trimmed.strip_suffix('.').unwrap_or(trimmed).trim_end();
        let begin = range.start + text.find(trimmed).unwrap_or(0);
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

/// A question with a temporal operator as it is written.
struct WrittenTemporal {
    operator: TemporalOperator,
    /// The first and the last tick of the window, counted back from the present; `None` for all ticks so far.
    window: (u32, Option<u32>),
    /// The places of the atoms in the text: before `since`, and after the operator.
    held: Option<Range<usize>>,
    operand: Range<usize>,
    whole: Span,
}

/// What a temporal operator needs in the ticks of its window.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum TemporalOperator {
    /// `previous`, `once`
    Once,
    /// `historically`, `for`
    Always,
    Since,
}

impl WrittenTemporal {
    /// Returns `None` for a question without a temporal operator.
    fn read(sources: &Sources, question: SourceId) -> Result<Option<WrittenTemporal>, Diagnostic> {
        let text = sources.text(question);
        let end = text.trim_end().strip_suffix('.').map_or(text.len(), str::len);
        let begin = text.len() - text.trim_start().len();
        if begin >= end {
            return Ok(None);
        }
        let whole = Span::new(question, begin..text[..end].trim_end().len());
        let (word, at, held) = match (prefix_operator(&text[begin..end]), since_at(&text[..end])) {
            (Some(word), _) => (word, begin, None),
            (None, Some(at)) => ("since", at, Some(begin..at)),
            (None, None) => return Ok(None),
        };
        let mut after = at + word.len();
        let mut bounds: Vec<u32> = Vec::new();
        if text[after..end].starts_with('[') {
            let close = text[after..end].find(']').map(|close| after + close);
            let numbers = close.map(|close| text[after + 1..close].split(',').map(|number| number.trim().parse()));
            let numbers: Option<Vec<u32>> = numbers.and_then(|numbers| numbers.collect::<Result<_, _>>().ok());
            let (Some(close), Some(numbers)) = (close, numbers) else {
                return Err(wrong_window(Span::new(question, after..end)));
            };
            (after, bounds) = (close + 1, numbers);
        }
        let place = Span::new(question, at..after);
        let (operator, window) = match (word, bounds.as_slice()) {
            ("previous", []) => (TemporalOperator::Once, (1, Some(1))),
            ("once", []) => (TemporalOperator::Once, (0, None)),
            ("once", [first, last]) if first <= last => (TemporalOperator::Once, (*first, Some(*last))),
            ("historically", [first, last]) if first <= last => (TemporalOperator::Always, (*first, Some(*last))),
            ("for", [ticks]) if *ticks > 0 => (TemporalOperator::Always, (0, Some(ticks - 1))),
            ("since", []) => (TemporalOperator::Since, (0, None)),
            ("since", [first, last]) if first <= last => (TemporalOperator::Since, (*first, Some(*last))),
            _ => return Err(wrong_window(place)),
        };
        Ok(Some(WrittenTemporal {
            operator,
            window,
            held,
            operand: after..end,
            whole,
        }))
    }
}

fn wrong_window(place: Span) -> Diagnostic {
    let message = "this is not a temporal operator with its window";
    let forms = "write `previous P(X)`, `once P(X)`, `once[0,5] P(X)`, `historically[0,5] P(X)`, `for[5] P(X)`, \
                 `P(X) since Q(X)` or `P(X) since[0,5] Q(X)`; the nearer tick comes first";
    Diagnostic::new(codes::SYNTAX, message).at(place, "").help(forms)
}

/// Returns the operator that begins a question. Without an atom after it, it is the name of a predicate.
fn prefix_operator(text: &str) -> Option<&'static str> {
    let mut operators = ["previous", "once", "historically", "for"].into_iter();
    operators.find(|word| {
        let rest = text.strip_prefix(word);
        let begins = |rest: &str| {
            rest.trim_start()
                .starts_with(|letter: char| letter.is_alphabetic() || letter == '_')
        };
        rest.is_some_and(|rest| rest.starts_with('[') || rest.starts_with(char::is_whitespace) && begins(rest))
    })
}

/// Returns the place of the word `since` between two atoms.
fn since_at(text: &str) -> Option<usize> {
    let (mut quoted, mut depth) = (false, 0_u32);
    let mut before = ' ';
    for (at, letter) in text.char_indices() {
        match letter {
            '"' => quoted = !quoted,
            '(' if !quoted => depth += 1,
            ')' if !quoted => depth = depth.saturating_sub(1),
            's' if !quoted && depth == 0 && (before == ')' || before.is_whitespace()) => {
                let rest = text[at..].strip_prefix("since");
                let ends = |rest: &str| rest.starts_with('[') || rest.starts_with(char::is_whitespace);
                if !text[..at].trim().is_empty() && rest.is_some_and(ends) {
                    return Some(at);
                }
            }
            _ => {}
        }
        before = letter;
    }
    None
}

/// A question whether a temporal literal holds, such as `once[0,5] IsAtInter(Car_1)`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AskedTemporal {
    operator: TemporalOperator,
    window: (u32, Option<u32>),
    /// The fact before `since`.
    held: Option<AskedFact>,
    operand: AskedFact,
    /// The operator with its window, as it is written.
    word: String,
}

/// Whether a temporal literal holds, and why.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TemporalVerdict {
    /// Whether it holds.
    pub holds: bool,
    /// The reason, in words.
    pub because: String,
    /// The tick and the fact whose proof, or absence, is the reason; `None` if the window has no ticks.
    pub witness: Option<(u64, AskedFact)>,
}

impl AskedTemporal {
    /// Reads a question; `None` if it has no temporal operator. The arguments are those of [`AskedFact::read`].
    ///
    /// # Errors
    /// `syntax` for a faulty operator or window; as [`AskedFact::read`] for its atoms.
    pub fn read(
        sources: &Sources,
        question: SourceId,
        known: (&Scenario, &Session),
        agents: &[&str],
        ego: Option<&str>,
    ) -> Result<Option<AskedTemporal>, Vec<Diagnostic>> {
        let Some(written) = WrittenTemporal::read(sources, question).map_err(|fault| vec![fault])? else {
            return Ok(None);
        };
        let fact =
            |range: &Range<usize>| AskedFact::read_within((sources, question, range.clone()), known, agents, ego);
        let begin = written
            .held
            .as_ref()
            .map_or(written.whole.start as usize, |held| held.end);
        let word = sources.text(question)[begin..written.operand.start].trim();
        Ok(Some(AskedTemporal {
            operator: written.operator,
            window: written.window,
            held: written.held.as_ref().map(fact).transpose()?,
            operand: fact(&written.operand)?,
            word: word.to_owned(),
        }))
    }

    /// Returns the first tick to look at for the question in tick `now`.
    pub fn first_tick(&self, now: u64) -> u64 {
        (self.window.1).map_or(0, |last| now.saturating_sub(last.into()))
    }

    /// Returns whether the facts of the question hold in a session: that after the operator, and that before `since`.
    pub fn facts(&self, session: &Session) -> [bool; 2] {
        [Some(&self.operand), self.held.as_ref()].map(|fact| fact.is_some_and(|fact| fact.matches(session)))
    }

    /// Returns the literal as text.
    pub fn literal(&self, session: &Session, sources: &Sources) -> String {
        let operand = self.operand.shown(session, sources);
        match &self.held {
            None => format!("{} {operand}", self.word),
            Some(held) => format!("{} {} {operand}", held.shown(session, sources), self.word),
        }
    }

    /// Judges the literal in tick `now`, given [`AskedTemporal::facts`] of the ticks from `first` to `now`. Before the
    /// tick `first`, nothing held. The nearest tick that decides is the witness.
    pub fn judge(&self, (first, now): (u64, u64), facts: &[[bool; 2]], shown: [&str; 2]) -> TemporalVerdict {
        let [operand, held] = shown;
        let at = |tick: u64| facts[usize::try_from(tick - first).expect("a tick of the slice")];
        let (nearest, farthest) = self.window;
        let begin = farthest.map_or(Some(first), |last| {
            now.checked_sub(last.into()).filter(|begin| *begin >= first)
        });
        let Some(end) = now.checked_sub(nearest.into()).filter(|end| *end >= first) else {
            return TemporalVerdict {
                holds: false,
                because: format!("the window ends before the first tick, {first}, and nothing held then"),
                witness: None,
            };
        };
        let from = begin.unwrap_or(first);
        let ticks = match from == end {
            true => format!("tick {end}"),
            false => format!("the ticks {from} to {end}"),
        };
        let mut held_at = (from..=end).rev().filter(|tick| at(*tick)[0]);
        let verdict = |holds, because: String, tick, fact: &AskedFact| TemporalVerdict {
            holds,
            because,
            witness: Some((tick, fact.clone())),
        };
        let never = || match from == end {
            true => verdict(false, format!("{operand} did not hold in {ticks}"), end, &self.operand),
            false => verdict(false, format!("{operand} held in none of {ticks}"), end, &self.operand),
        };
        match (self.operator, &self.held) {
            (TemporalOperator::Always, _) => match (from..=end).rev().find(|tick| !at(*tick)[0]) {
                Some(tick) => verdict(
                    false,
                    format!("{operand} did not hold in tick {tick}"),
                    tick,
                    &self.operand,
                ),
                None if begin.is_none() => {
                    let because = format!("the window begins before the first tick, {first}, and nothing held then");
                    verdict(false, because, end, &self.operand)
                }
                None if from == end => verdict(true, format!("{operand} held in {ticks}"), end, &self.operand),
                None => verdict(true, format!("{operand} held in all of {ticks}"), end, &self.operand),
            },
            (TemporalOperator::Since, Some(before)) => {
                let mut nearest = None;
                for tick in held_at {
                    match (tick + 1..=now).rev().find(|later| !at(*later)[1]) {
                        None if tick == now => {
                            return verdict(true, format!("{operand} held in tick {tick}"), tick, &self.operand);
                        }
                        None => {
                            let because = format!("{operand} held in tick {tick}, and {held} in every later one");
                            return verdict(true, because, tick, &self.operand);
                        }
                        Some(later) => nearest = nearest.or(Some((tick, later))),
                    }
                }
                match nearest {
                    None => never(),
                    Some((tick, later)) => {
                        let because = format!("{operand} held in tick {tick}, but {held} did not in tick {later}");
                        verdict(false, because, later, before)
                    }
                }
            }
            _ => match held_at.next() {
                Some(tick) => verdict(true, format!("{operand} held in tick {tick}"), tick, &self.operand),
                None => never(),
            },
        }
    }

    /// Returns the facts of the question as text: that after the operator, and that before `since`, if there is one.
    pub fn shown(&self, session: &Session, sources: &Sources) -> [String; 2] {
        [Some(&self.operand), self.held.as_ref()]
            .map(|fact| fact.map_or_else(String::new, |fact| fact.shown(session, sources)))
    }
}
