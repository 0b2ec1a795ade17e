//! `logicity diff`: compares two rule sets.

use crate::builtin::BuiltinFiles;
use crate::city::Action;
use crate::cli::configuration::{Checked, open_run};
use crate::cli::{Failure, compile, inputs_of, integer, load_workspace, load_workspace_from, report, terminal};
use crate::config::rule_file;
use crate::datalog::diff::{Cut, Difference, Equivalence, Options, diff, premises};
use crate::datalog::{BaseType, Clause, Comparison, Edb, Literal, Rules, Term, is_name, quoted};
use crate::diag::{Code, Diagnostic, SourceId, Sources, Span, to_json};
use crate::files::{ReadError, ReadFile};
use crate::sim::{CityTheory, examine, scene_json};
use serde_json::{Value, json};
use std::collections::{BTreeSet, HashSet};
use std::io::Write;
use std::path::{Path, PathBuf};

#[derive(clap::Args)]
pub struct Arguments {
    /// First rule file
    left: PathBuf,
    /// Second rule file
    right: PathBuf,
    /// Predicates to compare, separated by commas [default: all outputs]
    #[arg(long, value_delimiter = ',', value_name = "NAMES")]
    predicates: Vec<String>,
    /// Compare only rows for which a condition holds, for example 'IsCar(X)'. X, Y, Z, ... are the columns of the
    /// compared predicates; other variables must occur with one of them
    #[arg(long, value_name = "BODY")]
    given: Option<String>,
    /// Compare the rules in the city of this configuration: only scenes of its agents, with the constraints that hold
    /// there instead of the declared ones
    #[arg(long, value_name = "CONFIG")]
    config: Option<PathBuf>,
    /// Compare scenes of at most this many entities
    #[arg(
        long,
        value_name = "COUNT",
        value_parser = integer(1..=usize::MAX),
        default_value_t = Options::default().entities_max,
    )]
    entities: usize,
    /// Stop the search after this many conflicts, or a tenth as many scenes where `diff` evaluates scenes one by one
    #[arg(long, value_name = "COUNT", value_parser = integer(0..=u64::MAX),
        default_value_t = Options::default().conflicts_max)]
    effort: u64,
    /// Print only a scene that shows a difference, as input for `logicity infer`
    #[arg(long, conflicts_with = "json")]
    scene: bool,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

/// Returns exit code 0 if it finds no difference, 1 if it finds one.
pub fn run(arguments: &Arguments, sources: &mut Sources) -> Result<u8, Failure> {
    let paths = [&arguments.left, &arguments.right].map(|path| rule_file(path, &BuiltinFiles));
    let city = match &arguments.config {
        None => None,
        Some(config) => Some(open_run(config, sources)?),
    };
    let mut load = |path| {
        let mut texts = load_workspace(sources, path, Edb::Fixed)?;
        texts.set_inputs(inputs_of(&texts, city.is_some()));
        compile(&texts)
    };
    let (left, mut warnings) = load(&paths[0])?;
    let (right, more) = load(&paths[1])?;
    warnings.extend(more);
    if let Some(city) = &city {
        for (program, path) in [(&left, &paths[0]), (&right, &paths[1])] {
            warnings.extend(examine(program.rules(), city.theory(), sources).diagnostics);
            warnings.extend(city.bind(program, Some(path), sources));
        }
        // Both sides may include the file with the fault.
        let mut known = HashSet::new();
        warnings.retain(|fault| known.insert(to_json(std::slice::from_ref(fault), sources).to_string()));
        if warnings.iter().any(Diagnostic::is_error) {
            return Err(Failure::Input(warnings));
        }
    }
    report(&warnings, sources);
    let theory = city.as_ref().and_then(Checked::theory);
    let in_city = |rules: &Rules| match theory {
        None => rules.clone(),
        Some(theory) => Rules {
            constraints: theory.constraints(rules).of_agents,
            ..rules.clone()
        },
    };
    let [mut left, mut right] = [left, right].map(|program| in_city(program.rules()));
    let mut predicates = arguments.predicates.clone();
    let agents = theory.map_or(usize::MAX, CityTheory::agents_max);
    if let Some(condition) = &arguments.given {
        let compared = compared(&predicates, [&left, &right]);
        // A full stop ends the clause that contains the condition.
        let condition = condition.trim().trim_end_matches('.').trim_end();
        let condition = sources.add(OPTION, condition);
        left = in_city(&restricted(sources, &paths[0], &left, &compared, condition)?);
        right = in_city(&restricted(sources, &paths[1], &right, &compared, condition)?);
        refuse_vacuous([&left, &right], &compared, condition, sources)?;
        // `diff` reports a predicate that a side lacks, so it gets the name that the user knows.
        predicates = compared;
        for name in &mut predicates {
            let restricted = format!("{name}{GIVEN}");
            if [&left, &right].iter().all(|side| side.relation(&restricted).is_some()) {
                *name = restricted;
            }
        }
    }
    let options = Options {
        predicates,
        entities_max: arguments.entities.min(agents),
        conflicts_max: arguments.effort,
        ..Options::default()
    };
    let mut equivalence = diff(&left, &right, &options).map_err(|faults| {
        let is_option = |fault: &Diagnostic| fault.code == Code::RULE_MISMATCH && !arguments.predicates.is_empty();
        match faults.iter().all(is_option) {
            true => Failure::option(faults),
            false => Failure::Input(faults),
        }
    })?;

    if let Equivalence::NoneFound {
        entities: Some(entities),
        cut,
        ..
    } = &equivalence
        && cut.is_empty()
        && *entities >= agents
    {
        // No scene of the city has more agents.
        equivalence = Equivalence::Equivalent { entities: *entities };
    }
    let given: Vec<String> = match &equivalence {
        Equivalence::Equivalent { .. } => {
            let options = Options {
                conflicts_max: options.conflicts_max.min(PREMISES_EFFORT),
                ..options
            };
            let given = premises(&left, &right, &options)?;
            given.into_iter().map(|(one, rules)| one.show(rules, sources)).collect()
        }
        _ => Vec::new(),
    };
    if let Equivalence::Different(difference) = &mut equivalence {
        for (name, _) in difference.derived.iter_mut().flatten() {
            if let Some(original) = name.strip_suffix(GIVEN) {
                *name = original.to_owned();
            }
        }
    }

    let mut out = terminal::results(arguments.json || arguments.scene);
    let names = [&arguments.left, &arguments.right].map(|path| path.display().to_string());
    let place = theory.map_or_else(String::new, |theory| {
        format!("in the city `{}`: ", theory.scenario.name)
    });
    if arguments.json {
        let mut line = verdict_json(&equivalence);
        if let Equivalence::Equivalent { .. } = &equivalence {
            line["given"] = json!(given);
        }
        if let Some(theory) = theory {
            line["config"] = json!(theory.scenario.name);
        }
        writeln!(out, "{line}")?;
    } else if let Equivalence::Different(difference) = &equivalence {
        writeln!(
            out,
            "{}",
            if arguments.scene {
                scene_json(difference).to_string()
            } else {
                format!("{place}{}", show_difference(difference, &names, [&left, &right]))
            }
        )?;
    } else if !arguments.scene {
        writeln!(out, "{place}{}", equal(&equivalence))?;
        for one in &given {
            writeln!(out, "given {one}")?;
        }
    }
    Ok(match equivalence {
        Equivalence::Different(_) => 1,
        _ => 0,
    })
}

/// The budget of each search for the constraints that a proof needs; see [`Options::conflicts_max`].
const PREMISES_EFFORT: u64 = 20_000;

/// Refuses a condition that holds for no row of any of the predicates: a comparison would compare nothing.
fn refuse_vacuous(
    sides: [&Rules; 2],
    predicates: &[String],
    condition: SourceId,
    sources: &Sources,
) -> Result<(), Failure> {
    let mut given: Vec<String> = Vec::new();
    for rules in sides {
        for name in predicates {
            let row = format!("{name}{GIVEN}{ROW}");
            let Some(relation) = rules.relation(&row) else { continue };
            let mut never = rules.clone();
            for clause in never
                .clauses
                .iter_mut()
                .filter(|clause| clause.head.relation == relation)
            {
                let (Some(&left), span) = (clause.head.terms.first(), clause.span) else {
                    continue;
                };
                clause.body.push(Literal::Compare {
                    op: Comparison::NotEqual,
                    left,
                    right: left,
                    base: BaseType::Symbol,
                    span,
                });
            }
            let options = Options {
                predicates: vec![row],
                conflicts_max: PREMISES_EFFORT,
                minimize: false,
                ..Options::default()
            };
            match diff(rules, &never, &options)? {
                Equivalence::Equivalent { .. } => {
                    let found = premises(rules, &never, &options)?;
                    given.extend(found.into_iter().map(|(one, rules)| one.show(rules, sources)));
                }
                _ => return Ok(()),
            }
        }
    }
    let whole = Span::new(condition, 0..sources.text(condition).len());
    let message = "the condition of `--given` never holds, so nothing would be compared";
    let fault = Diagnostic::new(Code::RULE_MISMATCH, message).at(whole, "holds for no row");
    let mut known = HashSet::new();
    let given = given.into_iter().filter(|one| known.insert(one.clone()));
    let fault = given.fold(fault, |fault, one| fault.note(format!("given {one}")));
    Err(Failure::option(vec![fault]))
}

/// The option with the condition, which also names the condition in diagnostics.
const OPTION: &str = "--given";

/// The end of the names of predicates with the rows for which the condition of `--given` holds.
const GIVEN: &str = "_given";

/// The further ends of names: predicates of any rows, and of those for which the condition holds.
const ANY: &str = "_any";
const ROW: &str = "_row";

/// The names of the columns in the condition of `--given`.
const COLUMNS: [&str; 6] = ["X", "Y", "Z", "V", "W", "U"];

/// Returns the predicates to compare: the given ones, or the outputs of either side.
fn compared(predicates: &[String], sides: [&Rules; 2]) -> Vec<String> {
    if !predicates.is_empty() {
        return predicates.to_vec();
    }
    let outputs = sides
        .into_iter()
        .flat_map(|rules| rules.relations.iter().filter(|relation| relation.output));
    let names: BTreeSet<&String> = outputs.map(|relation| &relation.name).collect();
    names.into_iter().cloned().collect()
}

/// Returns the program with, for each of the predicates, one more predicate: its rows for which a condition holds.
fn restricted(
    sources: &mut Sources,
    path: &Path,
    rules: &Rules,
    predicates: &[String],
    condition: SourceId,
) -> Result<Rules, Failure> {
    let file = path
        .file_name()
        .map_or_else(String::new, |name| name.to_string_lossy().into_owned());
    let mut overlay = Overlay {
        path: path.parent().unwrap_or(Path::new("")).join(OPTION),
        text: format!(".include {}\n.scope\n", quoted(&file)),
        conditions: Vec::new(),
    };
    for name in predicates {
        let Some(relation) = rules.relation(name).map(|id| &rules.relations[id.index()]) else {
            continue;
        };
        if relation.columns.len() > COLUMNS.len() {
            let message = format!("--given: `{name}` has more than {} columns", COLUMNS.len());
            return Err(Failure::Usage(message));
        }
        let types = relation
            .columns
            .iter()
            .map(|column| &rules.types[column.ty.0 as usize].name);
        let columns: Vec<String> = COLUMNS
            .iter()
            .zip(types)
            .map(|(name, ty)| format!("{name}: {ty}"))
            .collect();
        let row = COLUMNS[..relation.columns.len()].join(", ");
        let columns = columns.join(", ");
        overlay.text += &format!(
            ".decl {name}{GIVEN}, {name}{GIVEN}{ANY}, {name}{GIVEN}{ROW}({columns})\n.output {name}{GIVEN}\n.input \
             {name}{GIVEN}{ANY}\n"
        );
        let any = format!("{name}{GIVEN}{ANY}");
        for (head, source) in [(String::new(), name), (ROW.to_owned(), &any)] {
            overlay.text += &format!("{name}{GIVEN}{head}({row}) :- {source}({row}), ");
            overlay.conditions.push(overlay.text.len());
            overlay.text += sources.text(condition);
            overlay.text += ".\n";
        }
    }
    let mut workspace = load_workspace_from(sources, &overlay.path, Edb::Fixed, &overlay)?;
    workspace.set_inputs(inputs_of(&workspace, false));
    let entry = overlay.path.display().to_string();
    let entry = sources.ids().filter(|&id| sources.name(id) == entry).last();
    let place = Typed {
        overlay: &overlay,
        entry: entry.expect("the workspace has read the overlay"),
        condition,
        length: sources.text(condition).len(),
    };
    let loaded = workspace.check();
    let Some(checked) = loaded.rules else {
        return Err(place.faults(loaded.diagnostics).into());
    };
    for name in predicates {
        let restricted = checked.relation(&format!("{name}{GIVEN}"));
        let clauses = (checked.clauses.iter()).filter(|clause| Some(clause.head.relation) == restricted);
        let loose: Vec<Diagnostic> = clauses.flat_map(|clause| loose_variables(clause, name)).collect();
        if !loose.is_empty() {
            return Err(Failure::option(place.faults(loose)));
        }
    }
    Ok(checked)
}

/// Returns the faults of variables in a condition that are neither columns nor related to one by literals: the
/// condition only says that some value of them exists. A variable that begins with `_` is meant so.
fn loose_variables(clause: &Clause, predicate: &str) -> Vec<Diagnostic> {
    let variables = |terms: &mut dyn Iterator<Item = &Term>| -> Vec<usize> {
        let variable = |term: &Term| match term {
            Term::Variable(id) => Some(id.index()),
            _ => None,
        };
        terms.filter_map(variable).collect()
    };
    let mut related = vec![false; clause.variables.len()];
    let columns = variables(&mut clause.head.terms.iter());
    columns.iter().for_each(|&column| related[column] = true);
    let literals: Vec<Vec<usize>> = (clause.body.iter())
        .map(|literal| variables(&mut literal.terms()))
        .collect();
    let mut grows = true;
    while std::mem::take(&mut grows) {
        for literal in &literals {
            if literal.iter().any(|&variable| related[variable]) {
                for &variable in literal {
                    grows |= !std::mem::replace(&mut related[variable], true);
                }
            }
        }
    }
    let columns: Vec<&str> = columns
        .iter()
        .map(|&column| clause.variables[column].as_str())
        .collect();
    let listed = match columns.as_slice() {
        [] => format!("`{predicate}` has no columns"),
        [column] => format!("the column of `{predicate}` is `{column}`"),
        columns => format!("the columns of `{predicate}` are `{}`", columns.join("`, `")),
    };
    let twin = |name: &str| {
        columns
            .iter()
            .find(|column| column.to_lowercase() == name.to_lowercase())
    };
    let named = clause.variables.iter().zip(&clause.variable_spans).enumerate();
    let loose = named.filter(|(index, (name, _))| {
        is_name(name)
            && !name.starts_with('_')
            && !columns.contains(&name.as_str())
            && (!related[*index] || twin(name).is_some())
    });
    loose
        .map(|(_, (name, span))| {
            let message = format!("`{name}` in the condition is no column of `{predicate}`");
            let fault = Diagnostic::new(Code::RULE_MISMATCH, message)
                .at(*span, "stands for any value")
                .note(listed.clone());
            match twin(name) {
                Some(column) => fault.help(format!("did you mean `{column}`?")),
                None => fault.help("name a column, or write `_` for any value"),
            }
        })
        .collect()
}

/// Faults of the overlay as faults of the condition that the user typed.
struct Typed<'o> {
    overlay: &'o Overlay,
    entry: SourceId,
    condition: SourceId,
    length: usize,
}

impl Typed<'_> {
    /// Returns the faults at their places in the condition. Several predicates have the same condition, so equal faults
    /// and labels occur once.
    fn faults(&self, faults: Vec<Diagnostic>) -> Vec<Diagnostic> {
        let mut placed: Vec<Diagnostic> = Vec::new();
        for mut fault in faults {
            for label in fault.primary.iter_mut().chain(&mut fault.secondary) {
                label.span = self.place(label.span);
            }
            let mut known: Vec<Span> = fault.primary.iter().map(|label| label.span).collect();
            fault.secondary.retain(|label| {
                let is_new = !known.contains(&label.span);
                known.push(label.span);
                is_new
            });
            // The edits concern the overlay.
            fault.fixes.clear();
            if !placed.contains(&fault) {
                placed.push(fault);
            }
        }
        placed
    }

    /// Returns a place in the condition: the whole one for a place in another part of the overlay.
    fn place(&self, span: Span) -> Span {
        if span.source != self.entry {
            return span;
        }
        let (from, to) = (span.start as usize, span.end as usize);
        let within = |start: &&usize| (**start..=**start + self.length).contains(&from);
        match self.overlay.conditions.iter().find(within) {
            Some(start) => Span::new(self.condition, from - start..(to - start).min(self.length)),
            None => Span::new(self.condition, 0..self.length),
        }
    }
}

/// One more file beside those on disk and the built-in ones.
struct Overlay {
    path: PathBuf,
    text: String,
    /// The offsets of the condition in the text, once per predicate.
    conditions: Vec<usize>,
}

impl ReadFile for Overlay {
    fn read(&self, path: &Path) -> Result<String, ReadError> {
        if path == self.path {
            return Ok(self.text.clone());
        }
        match BuiltinFiles.read(path) {
            Err(ReadError::NotFound) => BuiltinFiles.read_or_builtin(path),
            read => read,
        }
    }

    fn builtin_paths(&self) -> Vec<String> {
        BuiltinFiles.builtin_paths()
    }
}

fn entities_of(count: usize) -> String {
    format!("{count} {}", if count == 1 { "entity" } else { "entities" })
}

fn equal(equivalence: &Equivalence) -> String {
    match equivalence {
        Equivalence::Equivalent { entities } => format!(
            "equivalent: proved by searching all scenes of up to {}",
            entities_of(*entities)
        ),
        Equivalence::NoneFound { entities, proof, cut } => {
            let mut text = match entities {
                Some(entities) => format!("no difference in any scene of at most {}; ", entities_of(*entities)),
                None => "no scene searched: even the smallest exceeds a limit; ".to_owned(),
            };
            text += &match proof {
                Some(proof) => format!("a proof requires scenes of up to {}", entities_of(*proof)),
                None => "the number of entities that a proof needs is unknown".to_owned(),
            };
            for cut in cut {
                text += &format!("\nincomplete: {}", reason(*cut));
            }
            text
        }
        Equivalence::NoneTried {
            facts,
            entities,
            scenes,
        } => {
            let every = match facts {
                Some(facts) => format!(
                    "all scenes of at most {facts} facts about {}, with the values in the rules and their neighbors, \
                     and larger ones at random",
                    entities_of(*entities)
                ),
                None => "random scenes; the budget did not suffice for all scenes of any size".to_owned(),
            };
            let tried = if *scenes == 1 { "scene" } else { "scenes" };
            format!("no difference found in {scenes} {tried}: {every}; not a proof")
        }
        Equivalence::Different(_) => String::new(),
    }
}

fn reason(cut: Cut) -> &'static str {
    match cut {
        Cut::Conflicts => "the search reached the limit of `--effort`",
        Cut::Size => "larger scenes have too many possible facts or derivations",
        Cut::Proof => "computing the number of entities that a proof needs takes too long for these rules",
    }
}

fn show_difference(difference: &Difference, names: &[String; 2], rules: [&Rules; 2]) -> String {
    let size = if difference.smallest {
        "smallest scene"
    } else {
        "a scene"
    };
    let mut text = format!(
        "different; {size} that shows it, ready for `logicity infer`:\n{}\n",
        scene_json(difference)
    );
    for scope in &difference.everybody_sees {
        text += &format!("`{scope}` holds for all pairs of entities\n");
    }
    for ((name, derived), rules) in names.iter().zip(&difference.derived).zip(rules) {
        let rows: Vec<String> = derived.iter().map(|(name, row)| atom(rules, name, row)).collect();
        let rows = if rows.is_empty() {
            "nothing".to_owned()
        } else {
            rows.join(", ")
        };
        text += &format!("{name} derives {rows}\n");
        for entity in &difference.entities {
            let holds = |action: &&Action| {
                derived
                    .iter()
                    .any(|(name, row)| name == action.name() && row == &[&**entity])
            };
            let actions: Vec<&Action> = Action::SAFEST_FIRST.iter().filter(holds).collect();
            if let [first, _, ..] = actions.as_slice() {
                text += &format!(
                    "  {} takes {}, by the default order of actions\n",
                    quoted(entity),
                    first.name()
                );
            }
        }
    }
    text.truncate(text.trim_end().len());
    text
}

/// Returns a row as an atom in the notation of rules.
fn atom(rules: &Rules, name: &str, row: &[String]) -> String {
    let columns = rules.relation(name).map(|id| &rules.relations[id.index()].columns);
    let values = row.iter().enumerate().map(|(at, text)| {
        match columns.and_then(|columns| columns.get(at)).map(|column| column.base) {
            Some(BaseType::Symbol) => quoted(text),
            _ => text.clone(),
        }
    });
    format!("{name}({})", values.collect::<Vec<_>>().join(", "))
}

fn verdict_json(equivalence: &Equivalence) -> Value {
    match equivalence {
        Equivalence::Equivalent { entities } => {
            json!({ "verdict": "equivalent", "proved": true, "entities": entities })
        }
        Equivalence::NoneFound { entities, proof, cut } => json!({
            "verdict": "none-found", "proved": false, "entities": entities, "needed": proof,
            "cut": cut.iter().map(|cut| reason(*cut)).collect::<Vec<_>>(),
        }),
        Equivalence::NoneTried {
            facts,
            entities,
            scenes,
        } => json!({
            "verdict": "none-found", "proved": false, "entities": entities, "facts": facts, "scenes": scenes,
            "needed": null
        }),
        Equivalence::Different(difference) => {
            let derived = |rows: &[(String, Vec<String>)]| -> Value {
                rows.iter().map(|(name, row)| json!([name, row])).collect()
            };
            json!({
                "verdict": "different",
                "smallest": difference.smallest,
                "scene": scene_json(difference),
                "everybody_sees": difference.everybody_sees,
                "left": derived(&difference.derived[0]),
                "right": derived(&difference.derived[1]),
            })
        }
    }
}
