//! Formats questions as text, JSON lines and CSV.

use crate::city::{Action, Split};
use crate::sim::World;
use crate::task::questions::{Question, QuestionSet, Request, Style, words};
use serde_json::{Map, Value, json};
use std::io::{self, Write};

/// The rules that determine the answers.
#[derive(Clone, Copy, Debug)]
pub struct RulesFile<'a> {
    /// File name.
    pub name: &'a str,
    /// [Hash](crate::sim::hash_sources) of the file and its includes.
    pub hash: &'a str,
}

/// Returns the letter of an option: A to D, in the order of [`Action::ALL`].
pub fn letter(action: Action) -> char {
    ['A', 'B', 'C', 'D'][action as usize]
}

impl QuestionSet {
    /// Writes one JSON object per line; docs/how-to/ask-language-models.md documents the keys.
    ///
    /// # Errors
    /// Errors of `out`.
    pub fn write_json(&self, world: &World, rules: RulesFile<'_>, out: &mut impl Write) -> io::Result<()> {
        let scenario = &world.scenario;
        let style = match self.request.style {
            Style::Atoms => "",
            Style::Words => "-words",
        };
        let Request { split, seed, .. } = &self.request;
        let set = format!("{}-{}-{seed}{style}", scenario.name, split.name());
        let shown = self.demonstrations.iter().map(|shown| {
            json!({
                "question": self.text(shown),
                "answer": letter(shown.answer),
                "action": shown.answer.name(),
                "source": source(shown),
            })
        });
        let (system, shown) = (self.instructions(), shown.collect::<Vec<_>>());
        let options: Map<String, Value> = Action::ALL
            .iter()
            .map(|&action| (letter(action).into(), action.name().into()))
            .collect();
        for (number, question) in self.questions.iter().enumerate() {
            let mut from = source(question);
            for (key, value) in [
                ("seed", (*seed).into()),
                ("config", scenario.name.as_str().into()),
                ("config_hash", scenario.hash.as_str().into()),
                ("rules", rules.name.into()),
                ("rules_hash", Value::from(rules.hash)),
            ] {
                from.insert(key.to_owned(), value);
            }
            let line = json!({
                "id": format!("{set}-{number}"),
                "system": system,
                "demonstrations": shown,
                "question": self.text(question),
                "options": options,
                "answer": letter(question.answer),
                "action": question.answer.name(),
                "scene": self.scene(question),
                "source": from,
            });
            writeln!(out, "{line}")?;
        }
        Ok(())
    }

    /// Writes the questions as CSV without a header, in the format of MMLU: question, four options, letter of the
    /// answer.
    ///
    /// # Errors
    /// Errors of `out`.
    pub fn write_table(&self, out: &mut impl Write) -> io::Result<()> {
        self.rows(&self.questions, out)
    }

    /// Writes the demonstrations in the same format.
    ///
    /// # Errors
    /// Errors of `out`.
    pub fn write_demonstrations(&self, out: &mut impl Write) -> io::Result<()> {
        self.rows(&self.demonstrations, out)
    }

    fn rows(&self, questions: &[Question], out: &mut impl Write) -> io::Result<()> {
        let options = Action::ALL.map(Action::name).join(",");
        for question in questions {
            // The text needs no escaping: neither names of predicates and concepts nor sentences contain quotes.
            writeln!(out, "\"{}\",{options},{}", self.text(question), letter(question.answer))?;
        }
        Ok(())
    }

    /// Returns the system prompt.
    fn instructions(&self) -> String {
        let task = "Cars in a simulated city follow rules of first-order logic that are not shown to you. What a car \
                    does next depends only on facts about itself and about the entities that it sees.";
        let work = match self.demonstrations.len() {
            0 => "You are given a scene as facts; choose what the car does.",
            _ => {
                "Scenes with the car's action are given first. Find rules that explain all of them, then use them to \
                 choose what the car in the last scene does."
            }
        };
        format!(
            "{task} {work} You may reason step by step; the last line of your reply must be `Answer: ` and one letter: \
             A, B, C or D."
        )
    }

    /// Returns a question without its options.
    fn text(&self, question: &Question) -> String {
        match self.request.style {
            Style::Atoms => self.atoms(question),
            Style::Words => words::text(&self.predicates, question),
        }
    }

    fn atoms(&self, question: &Question) -> String {
        let names: Vec<String> = (0..question.entities).map(entity).collect();
        let predicates: Vec<String> = self
            .predicates
            .iter()
            .map(|(name, definition)| format!("{name}/{}", definition.arity()))
            .collect();
        let mut facts = String::new();
        for ((name, definition), rows) in self.predicates.iter().zip(&question.facts.rows) {
            let atoms = rows.iter().map(|row| {
                let arguments: Vec<String> = row[..definition.arity()]
                    .iter()
                    .map(|&place| entity(place as usize))
                    .collect();
                format!("{name}({})", arguments.join(", "))
            });
            let atoms: Vec<String> = atoms.collect();
            if !atoms.is_empty() {
                facts += &(atoms.join(", ") + "\n");
            }
        }
        let (count, plural) = (names.len(), if names.len() == 1 { "entity" } else { "entities" });
        format!(
            "A scene with {count} {plural}: {}.\nPredicates and their arities: {}.\nThe true facts (all others are \
             false):\n{facts}Which action does {} take next?",
            names.join(", "),
            predicates.join(", "),
            names[question.ego]
        )
    }

    /// Returns the facts as a scene for `logicity infer`.
    fn scene(&self, question: &Question) -> Value {
        let predicates = self.predicates.iter().zip(&question.facts.rows);
        let facts = predicates.map(|((name, definition), rows)| {
            let row = |row: &[u32; 2]| match row.map(|place| entity(place as usize)) {
                [only, _] if definition.arity() == 1 => Value::from(only),
                both => json!(both),
            };
            (name.clone(), rows.iter().map(row).collect::<Value>())
        });
        json!({
            "entities": (0..question.entities).map(entity).collect::<Vec<_>>(),
            "ego": entity(question.ego),
            "facts": facts.collect::<Map<_, _>>(),
        })
    }
}

fn entity(place: usize) -> String {
    format!("Entity_{place}")
}

fn source(question: &Question) -> Map<String, Value> {
    let super::Source {
        split,
        world,
        tick,
        agent,
    } = question.source;
    let fields = [
        ("split", Split::name(split).into()),
        ("world", world.into()),
        ("tick", tick.into()),
        ("agent", agent.to_string().into()),
    ];
    fields
        .into_iter()
        .map(|(key, value): (_, Value)| (key.to_owned(), value))
        .collect()
}
