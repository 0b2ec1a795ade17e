//! `logicity query`

use super::why::{self, Question};
use super::{Failure, compile, load_texts, make_folder, report};
use crate::diag::{Code, Diagnostic, Sources};
use crate::engine::{Options, Program, RuleWork, Session, StratumWork, facts, promise};
use crate::files::{self, Output, ReadError};
use crate::lang::{MarkKind, RelId, RowPlace};
use std::io::Write;
use std::path::{Path, PathBuf};

#[derive(clap::Args)]
pub struct Arguments {
    /// Rule file
    rules: PathBuf,
    /// Folder with one NAME.facts for each input relation: one row a line, values separated by tabs. The options of `.input`
    /// may say otherwise
    #[arg(short = 'F', long, value_name = "DIR", default_value = ".")]
    facts: PathBuf,
    /// Folder for one NAME.csv for each output relation; `-` is standard output
    #[arg(short = 'D', long, value_name = "DIR", default_value = ".")]
    output: PathBuf,
    /// Print how every clause is evaluated, and do nothing else
    #[arg(long, conflicts_with = "profile")]
    plan: bool,
    /// Tell on standard error what every clause did
    #[arg(long)]
    profile: bool,
    /// Tell why this fact holds instead, for example 'Path(1, 2)': a shortest proof. `_` is any value
    #[arg(long, value_name = "FACT", conflicts_with = "plan")]
    explain: Option<String>,
    /// Tell why this fact does not hold instead: what fails in each clause
    #[arg(long, value_name = "FACT", conflicts_with_all = ["plan", "explain"])]
    why_not: Option<String>,
    /// Print the explanation as one line of JSON: `fact`, `holds`, `nodes`
    #[arg(long)]
    json: bool,
}

impl Arguments {
    /// The fact that is asked about, the name of the argument it stands in, and what is asked.
    fn question(&self) -> Option<(&str, &'static str, Question)> {
        let holds = self.explain.as_deref().map(|fact| (fact, "--explain", Question::Holds));
        holds.or_else(|| Some((self.why_not.as_deref()?, "--why-not", Question::Fails)))
    }
}

pub fn run(arguments: &Arguments, sources: &mut Sources) -> Result<(), Failure> {
    let question = arguments.question();
    if arguments.json && question.is_none() {
        return Err(Failure::Usage("--json goes with --explain or --why-not".to_owned()));
    }
    let texts = load_texts(sources, &arguments.rules)?;
    let (program, warnings) = compile(&texts)?;
    report(&warnings, sources);
    // Not needed any more, and perhaps large.
    let texts = question.map(|_| texts);
    // The facts are checked below, before anybody sees an answer.
    let options = Options {
        promises: true,
        ..Options::default()
    };
    let program = match program.rules().promises.is_empty() {
        true => program,
        false => Program::with(program.rules().clone(), options)?,
    };
    if arguments.plan {
        write!(anstream::stdout(), "{}", program.show_plans(sources))?;
        return Ok(());
    }
    let mut session = program.session();
    load_inputs(&arguments.facts, &mut session, sources)?;
    session.commit().map_err(Diagnostic::from)?;

    let broken = promise::broken(&session);
    if !broken.is_empty() {
        return Err(broken.into());
    }

    if arguments.profile {
        // Nobody may be there to read it; the results are worth more.
        let _ = write!(anstream::stderr(), "{}", profile(&session, sources));
    }
    let mut out = anstream::stdout();
    if let (Some((fact, name, question)), Some(texts)) = (question, texts) {
        let asked = (question, sources.add(format!("<{name}>"), fact));
        return why::tell(&mut out, asked, &texts, &session, sources, arguments.json);
    }
    for (id, relation) in relations(&program) {
        for directive in &relation.directives {
            match directive.kind {
                MarkKind::Input => {}
                MarkKind::Output => {
                    let text = facts::print_as(&session, id, &directive.format);
                    let path = match &directive.place {
                        _ if arguments.output == Path::new("-") => None,
                        RowPlace::Terminal => None,
                        RowPlace::Usual => Some(arguments.output.join(format!("{}.csv", relation.name))),
                        RowPlace::File(name) => Some(arguments.output.join(name)),
                    };
                    match path {
                        Some(path) => write_relation(&path, &text)?,
                        None => print_relation(&mut out, &relation.name, &text, directive.format.headers)?,
                    }
                }
                MarkKind::PrintSize => writeln!(out, "{}\t{}", relation.name, session.len(id))?,
            }
        }
    }
    Ok(())
}

/// What every clause did, those that looked at most rows first.
pub(super) fn profile(session: &Session, sources: &Sources) -> String {
    let rounds = session.work().strata.iter().filter_map(StratumWork::work);
    let mut rules: Vec<(usize, &RuleWork)> = rounds
        .flat_map(|work| work.rules.iter().map(|rule| (work.rounds, rule)))
        .collect();
    rules.sort_by_key(|(_, rule)| std::cmp::Reverse(rule.looked_at));
    let mut text = format!(
        "{:>13} {:>13} {:>13} {:>7}  clause\n",
        "new rows in", "looked at", "derived", "rounds"
    );
    for (rounds, rule) in rules {
        let clause = session.program().show_clause(rule.clause, sources);
        let RuleWork {
            given,
            looked_at,
            derived,
            ..
        } = rule;
        text += &format!("{given:>13} {looked_at:>13} {derived:>13} {rounds:>7}  {clause}\n");
    }
    text
}

/// Prints a relation between rules, its header above them.
fn print_relation(out: &mut impl Write, name: &str, text: &str, headers: bool) -> std::io::Result<()> {
    let (header, rows) = match text.split_once('\n') {
        Some((header, rows)) if headers => (format!("{header}\n"), rows),
        _ => (String::new(), text),
    };
    let rule = "-".repeat(15);
    write!(out, "{rule}\n{name}\n{header}===============\n{rows}===============\n")
}

/// The declared relations in the order of the text.
pub(super) fn relations(program: &Program) -> impl Iterator<Item = (RelId, &crate::lang::Relation)> {
    let relations = program.rules().relations.iter().enumerate();
    relations.map(|(index, relation)| {
        let id = RelId(u32::try_from(index).expect("fewer than 2^32 relations"));
        (id, relation)
    })
}

/// Reads the facts of every input relation. All faulty files are told in one run.
pub(super) fn load_inputs(folder: &Path, session: &mut Session, sources: &mut Sources) -> Result<(), Failure> {
    let program = session.program().clone();
    let mut faults = Vec::new();
    for (id, relation) in relations(&program) {
        for directive in relation
            .directives
            .iter()
            .filter(|directive| directive.kind == MarkKind::Input)
        {
            let path = match &directive.place {
                RowPlace::Usual => folder.join(format!("{}.facts", relation.name)),
                RowPlace::File(name) => folder.join(name),
                RowPlace::Terminal => PathBuf::from("standard input"),
            };
            let text = match directive.place {
                RowPlace::Terminal => files::read_from(std::io::stdin()),
                _ => files::read_text(&path),
            };
            match text {
                Ok(text) => {
                    let source = sources.add(path.display().to_string(), text);
                    if let Err(found) = facts::load_as(session, id, sources, source, &directive.format) {
                        faults.extend(found);
                    }
                }
                Err(error @ ReadError::NotText { .. }) => {
                    faults.push(Diagnostic::new(
                        Code::NotText,
                        format!("`{}` is {error}", path.display()),
                    ));
                }
                Err(error) => {
                    return Err(Failure::Usage(format!(
                        "cannot read the facts of `{}` from `{}`: {error}",
                        relation.name,
                        path.display()
                    )));
                }
            }
        }
    }
    if faults.is_empty() { Ok(()) } else { Err(faults.into()) }
}

fn write_relation(path: &Path, text: &str) -> Result<(), Failure> {
    make_folder(path.parent().unwrap_or(Path::new(".")))?;
    let fail = |error: std::io::Error| Failure::file("write", path, error);
    let mut file = Output::create(path).map_err(fail)?;
    file.write_all(text.as_bytes()).map_err(fail)?;
    file.finish().map_err(fail)
}
