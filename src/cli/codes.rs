//! `logicity codes`: explains the codes of messages.

use crate::cli::failure::Failure;
use crate::cli::terminal;
use crate::diag::{self, Catalog, Explanation, Severity, did_you_mean, explanations};
use crate::{city, config, datalog, sim, task, yaml};
use serde_json::{Value, json};
use std::io::Write;

/// The catalogs of all modules, with what their messages concern.
const CATALOGS: [(&str, Catalog); 10] = [
    ("rules and facts", datalog::codes::CATALOG),
    ("configurations", yaml::codes::CATALOG),
    ("configurations", config::codes::CATALOG),
    ("maps and routes", city::codes::CATALOG),
    ("cities, scenes and traces", sim::codes::CATALOG),
    ("recorded episodes", task::spf::codes::CATALOG),
    ("data sets", task::vap::codes::CATALOG),
    ("shards of data sets", task::codes::CATALOG),
    ("examples of learning", task::induction::codes::CATALOG),
    ("any input", diag::codes::CATALOG),
];

#[derive(clap::Args)]
pub struct Arguments {
    /// Codes to explain, for example `unknown-predicate` [default: list all codes]
    codes: Vec<String>,
    /// Print one JSON object per code, with the keys `code`, `severity`, `topic`, `summary`, `meaning`, `reason`,
    /// `command`, `wrong` and `right`
    #[arg(long)]
    json: bool,
}

pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    let of = |(topic, catalog): (&'static str, Catalog)| {
        explanations(&catalog)
            .into_iter()
            .map(move |explanation| (topic, explanation))
    };
    let all: Vec<(&str, Explanation)> = CATALOGS.into_iter().flat_map(of).collect();
    let found: Vec<&(&str, Explanation)> = match arguments.codes.as_slice() {
        [] => all.iter().collect(),
        codes => codes.iter().map(|code| find(&all, code)).collect::<Result<_, _>>()?,
    };
    let mut out = terminal::results(arguments.json);
    let mut last_topic = "";
    for (position, (topic, explanation)) in found.into_iter().enumerate() {
        if arguments.json {
            writeln!(out, "{}", to_json(topic, explanation))?;
        } else if arguments.codes.is_empty() {
            if std::mem::replace(&mut last_topic, topic) != *topic {
                writeln!(out, "{topic}:")?;
            }
            let (code, severity) = (explanation.code.name(), severity(explanation));
            writeln!(out, "  {code:<22} {severity:<8} {}", explanation.summary)?;
        } else {
            if position > 0 {
                writeln!(out)?;
            }
            print(&mut out, explanation)?;
        }
    }
    Ok(())
}

fn find<'a>(all: &'a [(&'a str, Explanation)], code: &str) -> Result<&'a (&'a str, Explanation), Failure> {
    // Accepts the form in messages, too: `error[unknown-predicate]`.
    let name = code.trim_start_matches("error[").trim_start_matches("warning[");
    let name = name.trim_end_matches(']');
    let found = all.iter().find(|(_, explanation)| explanation.code.name() == name);
    found.ok_or_else(|| {
        let names = all.iter().map(|(_, explanation)| explanation.code.name());
        let help = match did_you_mean(name, names) {
            Some(near) => format!("did you mean `{near}`?"),
            None => "`logicity codes` lists all codes".to_owned(),
        };
        Failure::Usage(format!("no code `{code}`\nhelp: {help}"))
    })
}

fn severity(explanation: &Explanation) -> &'static str {
    match explanation.code.severity() {
        Severity::Error => "error",
        Severity::Warning => "warning",
    }
}

fn print(out: &mut impl Write, explanation: &Explanation) -> Result<(), Failure> {
    let Explanation {
        code, summary, meaning, ..
    } = explanation;
    writeln!(out, "{}[{}]: {summary}\n", severity(explanation), code.name())?;
    writeln!(out, "{meaning}\n\nWhy it matters: {}", explanation.reason)?;
    for (title, example) in [("Wrong", explanation.wrong), ("Right", explanation.right)] {
        writeln!(out, "\n{title}:\n")?;
        for line in example.text.lines() {
            writeln!(out, "{}", format!("    {line}").trim_end())?;
        }
    }
    if let Some(command) = explanation.command.filter(|command| command.starts_with("logicity")) {
        writeln!(out, "\nReported by `{command}`.")?;
    }
    Ok(())
}

fn to_json(topic: &str, explanation: &Explanation) -> Value {
    let example = |example: diag::Example| json!({"language": example.language, "text": example.text});
    json!({
        "code": explanation.code.name(),
        "severity": severity(explanation),
        "topic": topic,
        "summary": explanation.summary,
        "meaning": explanation.meaning,
        "reason": explanation.reason,
        "command": explanation.command,
        "wrong": example(explanation.wrong),
        "right": example(explanation.right),
    })
}
