//! Plans as text: the order of scans and tests, with their key columns and indexes.

use crate::check::{Clause, ClauseId, PredicateId, UserFunctor};
use crate::diag::Sources;
use crate::plan::Compiled;
use crate::plan::Plans;
use crate::plan::steps::{IndexId, List, Plan, Slot, Source, Step, Version};
use crate::program::Program;
use crate::session::Session;
use crate::symbol::Symbol;
use crate::syntax::ast::BaseType;
use crate::syntax::functor::Functor;
use crate::syntax::{is_name, quoted};
use crate::value::{Value, record_text, shown_number};

impl Program {
    /// Returns the evaluation plan of every clause as text for readers. `sources` must be those of the rules.
    ///
    /// ```text
    /// stratum 1: Path (recursive)
    ///
    ///   Path(x, z) :- Path(x, y), Edge(y, z).    path.dl:4:1
    ///     for the new rows of Path
    ///       scan   Path(x, y), new
    ///       scan   Edge(y, z) by x
    ///       derive Path(x, z)
    /// ```
    pub fn show_plans(&self, sources: &Sources) -> String {
        let shown = Shown {
            compiled: &self.0,
            plans: &self.0.plans,
            rows: None,
        };
        shown.all(sources)
    }

    /// Returns a clause on one line, with its place.
    pub fn show_clause(&self, id: ClauseId, sources: &Sources) -> String {
        on_one_line(&self.0.rules.clauses[id.index()], sources)
    }
}

/// Returns readable names of the variables. A variable that holds the value of an expression gets an unused letter.
fn readable(variables: &[String]) -> Vec<String> {
    let mut letters = (0_u32..).flat_map(|round| {
        ('a'..='z').map(move |letter| match round {
            0 => letter.to_string(),
            _ => format!("{letter}{round}"),
        })
    });
    let mut free = || letters.find(|letter| !variables.contains(letter)).unwrap_or_default();
    (variables.iter())
        .map(|name| {
            if is_name(name) || name == "_" {
                name.clone()
            } else {
                free()
            }
        })
        .collect()
}

fn on_one_line(clause: &Clause, sources: &Sources) -> String {
    let words: Vec<&str> = sources.slice(clause.span).split_whitespace().collect();
    format!("{}    {}", words.join(" "), sources.locate(clause.span))
}

impl Session {
    /// Returns the plans of all clauses that the last commit recomputed; see [`Program::show_plans`].
    ///
    /// The text includes the row counts of the predicates that the plans read.
    pub fn show_plans(&self, sources: &Sources) -> String {
        let shown = Shown {
            compiled: &self.program.0,
            plans: self.store.plans(),
            rows: Some(&|predicate| self.store.len(predicate)),
        };
        shown.all(sources)
    }
}

/// The plans to print.
struct Shown<'a> {
    compiled: &'a Compiled,
    plans: &'a Plans,
    /// The row count of each predicate, once there are rows.
    rows: Option<&'a dyn Fn(PredicateId) -> usize>,
}

/// Returns slots with their positions as columns.
fn in_order<'s>(slots: impl IntoIterator<Item = &'s Slot>) -> impl Iterator<Item = (u16, Slot)> {
    slots.into_iter().zip(0_u16..).map(|(&slot, column)| (column, slot))
}

/// Returns how a step names its result: a test of a known value, or a new one.
fn verb(test: bool) -> &'static str {
    if test { "test" } else { "let " }
}

/// Returns the note that one match of the steps from `position` to `end` is enough.
fn one_match_note(position: usize, end: usize, steps: usize) -> String {
    match (position, end) {
        (0, end) if end == steps => String::new(),
        (_, end) if end == steps => "      the head is known: one match of the rest is enough\n".to_owned(),
        (position, end) => {
            let steps = match end - position {
                1 => "step".to_owned(),
                count => format!("{count} steps"),
            };
            format!("      one match of the next {steps} is enough\n")
        }
    }
}

/// Returns a functor with its arguments.
fn show_expression(
    functor: Functor,
    base: BaseType,
    arguments: &[Slot],
    functors: &[UserFunctor],
    value: &dyn Fn(Slot, BaseType) -> String,
) -> String {
    // Only the first argument of `substr` is a string.
    let base_of = |position: usize| match (functor, position) {
        (Functor::Call, 0) => BaseType::Unsigned,
        (Functor::Substring, 1..) => BaseType::Number,
        _ => base,
    };
    let arguments: Vec<String> = (arguments.iter().enumerate())
        .map(|(position, &slot)| value(slot, base_of(position)))
        .collect();
    // The first argument is the position of the functor.
    if let (Functor::Call, Some((at, arguments))) = (functor, arguments.split_first()) {
        let called = at.parse().ok().and_then(|at: usize| functors.get(at));
        let name = called.map_or("", |called| &called.name);
        return format!("@{name}({})", arguments.join(", "));
    }
    if functor == Functor::Counter {
        return "autoinc()".to_owned();
    }
    let name = functor.name();
    match arguments.as_slice() {
        [left, right] if !matches!(functor, Functor::Min | Functor::Max | Functor::Cat) => {
            format!("{left} {name} {right}")
        }
        many => format!("{name}({})", many.join(", ")),
    }
}

impl Shown<'_> {
    fn all(&self, sources: &Sources) -> String {
        let (rules, plans) = (&self.compiled.rules, self.plans);
        let mut out = String::new();
        for (stratum, number) in plans.strata.iter().zip(1..) {
            if stratum.clauses.is_empty() {
                continue;
            }
            let names: Vec<&str> = stratum.members.iter().map(|&member| self.name(member)).collect();
            let recursive = if stratum.recursive { " (recursive)" } else { "" };
            out += &format!("stratum {number}: {}{recursive}\n", names.join(", "));
            if let Some(rows) = self.rows {
                let size = |&input: &PredicateId| format!("{} {}", self.name(input), rows(input));
                let sizes: Vec<String> = stratum.inputs.iter().map(size).collect();
                out += &format!("  over {}\n", sizes.join(", "));
            }
            for &id in &stratum.clauses {
                let clause = &rules.clauses[id.index()];
                let plans = &plans.clauses[id.index()];
                out += &format!("\n  {}\n", on_one_line(clause, sources));
                if plans.deltas.is_empty() {
                    out += "    once\n";
                    self.show_steps(&mut out, clause, &plans.complete);
                }
                for ((over, plan), alternatives) in plans.deltas.iter().zip(&plans.alternatives) {
                    out += &format!("    for the new rows of {}\n", self.name(*over));
                    self.show_steps(&mut out, clause, plan);
                    for alternative in alternatives {
                        out += "    or, in a round where this scans fewer rows\n";
                        self.show_steps(&mut out, clause, alternative);
                    }
                }
            }
            out.push('\n');
        }
        out
    }

    fn name(&self, predicate: PredicateId) -> &str {
        &self.compiled.rules.predicates[predicate.index()].name
    }

    fn show_steps(&self, out: &mut String, clause: &Clause, plan: &Plan) {
        let names = readable(&clause.variables);
        let value = |slot: Slot, base: BaseType| {
            let name = names.get(slot as usize).cloned();
            name.unwrap_or_else(|| self.show_value(plan.slots[slot as usize], base))
        };
        // The end of the part that the last note about one match covers.
        let mut covered = 0;
        for (position, step) in plan.steps.iter().enumerate() {
            let enough = plan.enough[position] as usize;
            if enough > 0 && position >= covered {
                covered = enough;
                *out += &one_match_note(position, enough, plan.steps.len());
            }
            *out += &format!("      {}\n", self.show_step(step, &value));
            if let Step::Correlated { predicate, plans, .. } = step {
                let mut inner = String::new();
                for (plan, clause) in plans.iter().zip(self.plans.correlated_clauses(*predicate)) {
                    self.show_steps(&mut inner, &self.compiled.rules.clauses[clause.index()], plan);
                }
                inner.lines().for_each(|line| *out += &format!("  {line}\n"));
            }
        }
        *out += &format!("      {}\n", self.show_head(plan, &value));
    }

    /// Returns a step without the steps inside of it.
    fn show_step(&self, step: &Step, value: &dyn Fn(Slot, BaseType) -> String) -> String {
        match step {
            Step::Scan {
                source,
                key,
                bind,
                check,
                ..
            } => {
                let terms: Vec<(u16, Slot)> = in_order(key).chain(bind.iter().chain(check).copied()).collect();
                let lookup = self.show_lookup(*source, &terms, key.len(), value);
                match self
                    .plans
                    .indexes
                    .correlated(self.plans.indexes[source.index].predicate)
                {
                    Some(_) => format!("given  {}", lookup.trim_end_matches(", new")),
                    None => format!("scan   {lookup}"),
                }
            }
            Step::Exists { source, key } => format!("exists {}", self.show_keyed(*source, key, value)),
            Step::AntiJoin { source, key } => format!("absent {}", self.show_keyed(*source, key, value)),
            Step::LeapfrogJoin { lists, to } => {
                let list = |list: &List| {
                    let terms: Vec<(u16, Slot)> = in_order(list.key.iter().chain([to])).collect();
                    self.show_lookup(list.source, &terms, list.key.len(), value)
                };
                let lists: Vec<String> = lists.iter().map(list).collect();
                format!("join   {}", lists.join("\n         and "))
            }
            Step::Copy { to, from } => {
                let name = |slot: Slot| value(slot, BaseType::Number);
                format!("let    {} = {}", name(*to), name(*from))
            }
            Step::Compare { op, left, right, base } => {
                format!("test   {} {op} {}", value(*left, *base), value(*right, *base))
            }
            Step::Compute {
                functor,
                base,
                arguments,
                to,
                test,
            } => {
                let expression = show_expression(*functor, *base, arguments, &self.compiled.rules.functors, value);
                format!("{}   {} = {expression}", verb(*test), value(*to, *base))
            }
            Step::Aggregate {
                source,
                key,
                op,
                base,
                to,
                test,
                ..
            } => {
                let rows = self.show_keyed(*source, key, value);
                format!("{}   {} = {} : {{ {rows} }}", verb(*test), value(*to, *base), op.name())
            }
            Step::Group {
                source,
                key,
                op,
                base,
                to,
                test,
            } => {
                let rows = self.show_rows(self.plans.indexes[source.index].predicate, key, value);
                let (verb, to) = (verb(*test), value(*to, *base));
                format!("{verb}   {to} = {} : {{ {rows} }}, by group", op.name())
            }
            Step::Correlated {
                predicate,
                key,
                op,
                base,
                to,
                test,
                ..
            } => {
                let rows = self.show_rows(*predicate, key, value);
                let (verb, to) = (verb(*test), value(*to, *base));
                format!("{verb}   {to} = {} : {{ {rows} }}, in place", op.name())
            }
        }
    }

    /// Returns what a plan does with each match of its steps.
    fn show_head(&self, plan: &Plan, value: &dyn Fn(Slot, BaseType) -> String) -> String {
        let predicate = &self.compiled.rules.predicates[plan.head.index()];
        let terms = predicate.columns.iter().zip(&plan.output);
        let terms: Vec<String> = terms.map(|(column, &slot)| value(slot, column.base)).collect();
        let atom = format!("{}({})", predicate.name, terms.join(", "));
        let Some(fold) = plan.fold else {
            return format!("derive {atom}");
        };
        let folded = fold.value.map(|slot| format!(" {}", value(slot, fold.base)));
        format!("group  {atom} by {}{}", fold.op.name(), folded.unwrap_or_default())
    }

    /// Returns a lookup that binds nothing.
    fn show_keyed(&self, source: Source, key: &[Slot], value: &dyn Fn(Slot, BaseType) -> String) -> String {
        self.show_lookup(source, &in_order(key).collect::<Vec<_>>(), key.len(), value)
    }

    /// Returns the atom whose leading columns have these slots.
    fn show_rows(&self, predicate: PredicateId, key: &[Slot], value: &dyn Fn(Slot, BaseType) -> String) -> String {
        let predicate = &self.compiled.rules.predicates[predicate.index()];
        let known = predicate.columns.iter().zip(key);
        let known = known.map(|(column, &slot)| value(slot, column.base));
        let rest = std::iter::repeat_n("_".to_owned(), predicate.arity() - key.len());
        format!(
            "{}({})",
            predicate.name,
            known.chain(rest).collect::<Vec<_>>().join(", ")
        )
    }

    /// Returns the atom with its key columns, its index unless that is the predicate's own order, and the version of the
    /// rows.
    fn show_lookup(
        &self,
        source: Source,
        terms: &[(u16, Slot)],
        key: usize,
        value: &dyn Fn(Slot, BaseType) -> String,
    ) -> String {
        let order = &self.plans.indexes[source.index];
        let predicate = &self.compiled.rules.predicates[order.predicate.index()];
        let mut atom = vec!["_".to_owned(); predicate.arity()];
        for &(column, slot) in terms {
            let column = order.columns[column as usize] as usize;
            atom[column] = value(slot, predicate.columns[column].base);
        }
        let columns = |range: &[u16]| {
            let names = range
                .iter()
                .map(|&column| predicate.columns[column as usize].name.as_str());
            names.collect::<Vec<_>>().join(", ")
        };
        let mut text = format!("{}({})", predicate.name, atom.join(", "));
        if key > 0 {
            text += &format!(" by {}", columns(&order.columns[..key]));
        }
        if source.index != IndexId(order.predicate.0) {
            text += &format!(", index ({})", columns(&order.columns));
        }
        text += match source.version {
            Version::Complete => "",
            Version::All => ", old and new",
            Version::Old => ", old",
            Version::New => ", new",
        };
        text
    }

    fn show_value(&self, value: Value, base: BaseType) -> String {
        match base {
            BaseType::Symbol => quoted(self.compiled.rules.symbols.resolve(Symbol(value.0)).unwrap_or_default()),
            BaseType::Number | BaseType::Unsigned | BaseType::Float => {
                shown_number(base, value, &self.compiled.rules.symbols)
            }
            BaseType::Record => record_text(value, &self.compiled.rules.symbols),
        }
    }
}
