//! Formats questions as text, JSON lines and CSV.

use crate::city::{Action, Split};
use crate::diag::Sources;
use crate::predicate::Definition;
use crate::sim::World;
use crate::task::questions::{Mix, Prompt, Question, QuestionSet, Request, Style, statement, words};
use serde_json::{Map, Value, json};
use std::io::{self, Write};

/// The versions of the format. Version 1 had no `version`, `prompt` and `clauses`, and no `scene` of demonstrations.
/// Version 3 is that of questions with `closing` or `picture`, which readers of version 2 would ignore.
const VERSION: u32 = 2;
const VERSION_WITH_LAYOUT: u32 = 3;

/// What the paper's prompt says between the demonstrations and the question.
const CLOSING: &str = "Now try your best to first identify the FOL rules from the examples above and then answer the \
    following question. Your answer should strictly end with the format of single letter: 'Answer: _.'";

/// The rules that determine the answers.
#[derive(Clone, Copy, Debug)]
pub struct RulesFile<'a> {
    /// File name.
    pub name: &'a str,
    /// [Hash](crate::sim::hash_sources) of the file and its includes.
    pub hash: &'a str,
    /// The sources of the rules, for the labels of clauses.
    pub sources: &'a Sources,
}

/// Returns the letter of an option: A to D, in the order of [`Action::STANDARD`].
pub fn letter(action: Action) -> char {
    ['A', 'B', 'C', 'D'][action.index()]
}

impl QuestionSet {
    /// Writes one JSON object per line; docs/how-to/ask-language-models.md documents the keys. `pictures` is the folder
    /// of the pictures as seen from the file, if the style has any.
    ///
    /// # Errors
    /// Errors of `out`.
    pub fn write_json(
        &self,
        world: &World,
        rules: RulesFile<'_>,
        pictures: &str,
        out: &mut impl Write,
    ) -> io::Result<()> {
        let scenario = &world.scenario;
        let Request {
            seed, prompt, style, ..
        } = &self.request;
        let set = self.id(&scenario.name);
        let clauses = |question: &Question| -> Value {
            let clauses = question.clauses.iter().copied();
            statement::labels(world, rules.sources, clauses).into()
        };
        let shown = self.demonstrations.iter().enumerate().map(|(number, shown)| {
            let mut line = json!({
                "question": self.text(shown),
                "answer": letter(shown.answer),
                "action": shown.answer.name(),
                "clauses": clauses(shown),
                "scene": self.scene(shown),
                "source": source(shown),
            });
            if *style == Style::Picture {
                line["picture"] = format!("{pictures}/{}", picture_of_demonstration(&set, number)).into();
            }
            line
        });
        let (system, shown) = (self.instructions(world, rules.sources), shown.collect::<Vec<_>>());
        let labels = match prompt {
            Prompt::Why => statement::labels(world, rules.sources, statement::of_actions(world)),
            Prompt::Examples | Prompt::Rules => Vec::new(),
        };
        let options: Map<String, Value> = Action::STANDARD
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
            let mut line = json!({
                "version": if matches!(style, Style::Paper | Style::Picture) { VERSION_WITH_LAYOUT } else { VERSION },
                "id": format!("{set}-{number}"),
                "prompt": prompt.name(),
                "system": system,
                "demonstrations": shown,
                "question": self.text(question),
                "options": options,
                "answer": letter(question.answer),
                "action": question.answer.name(),
                "clauses": clauses(question),
                "scene": self.scene(question),
                "source": from,
            });
            if *prompt == Prompt::Why {
                line["labels"] = labels.clone().into();
            }
            match style {
                Style::Paper => line["closing"] = CLOSING.into(),
                Style::Picture => line["picture"] = format!("{pictures}/{}", picture_of_question(&set, number)).into(),
                Style::Atoms | Style::Words => {}
            }
            writeln!(out, "{line}")?;
        }
        Ok(())
    }

    /// Returns the identifier of the set: the beginning of those of its questions.
    pub(super) fn id(&self, config: &str) -> String {
        let Request {
            split,
            seed,
            style,
            prompt,
            mix,
            ..
        } = &self.request;
        let mut set = format!("{config}-{}-{seed}", split.name());
        if *style != Style::Atoms {
            set += &format!("-{}", style.name());
        }
        if *mix != Mix::Equal {
            set += &format!("-{}-mix", mix.name());
        }
        if *prompt != Prompt::Examples {
            set += &format!("-{}", prompt.name());
        }
        set
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
        let options = Action::STANDARD.map(Action::name).join(",");
        for question in questions {
            // The text needs no escaping: neither names of predicates and concepts nor sentences contain quotes.
            writeln!(out, "\"{}\",{options},{}", self.text(question), letter(question.answer))?;
        }
        Ok(())
    }

    /// Returns the system prompt.
    fn instructions(&self, world: &World, sources: &Sources) -> String {
        let prompt = self.request.prompt;
        if self.request.style == Style::Paper {
            return format!(
                "You are an expert in First-Order-Logic (FOL) Rule induction, the following question-answers are FOL \
                 reasoning examples. Here are {} demonstrations:",
                self.demonstrations.len()
            );
        }
        let hidden = match prompt {
            Prompt::Examples => " that are not shown to you",
            Prompt::Rules | Prompt::Why => "",
        };
        let mut text = format!(
            "Cars in a simulated city follow rules of first-order logic{hidden}. What a car does next depends only on \
             facts about itself and about the entities that it sees. "
        );
        if prompt != Prompt::Examples {
            let statement = statement::statement(world, sources, self.request.style);
            text += &format!("These are the rules; different letters may stand for the same entity.\n{statement}\n");
        }
        text += match (self.demonstrations.is_empty(), prompt) {
            (true, Prompt::Examples) => "You are given a scene as facts; choose what the car does.",
            (true, _) => "You are given a scene as facts; use the rules to choose what the car does.",
            (false, Prompt::Examples) => {
                "Scenes with the car's action are given first. Find rules that explain all of them, then use them to \
                 choose what the car in the last scene does."
            }
            (false, _) => {
                "Scenes with the car's action are given first. Use the rules to choose what the car in the last scene \
                 does."
            }
        };
        text += " You may reason step by step; ";
        text += match prompt {
            Prompt::Examples | Prompt::Rules => {
                "the last line of your reply must be `Answer: ` and one letter: A, B, C or D."
            }
            Prompt::Why => {
                "the last two lines of your reply must be `Rule: ` and the name of a rule that requires the action, or \
                 `none` if no rule requires it, and `Answer: ` and one letter: A, B, C or D."
            }
        };
        text
    }

    /// Returns a question without its options.
    fn text(&self, question: &Question) -> String {
        match self.request.style {
            Style::Atoms => self.atoms(question),
            Style::Words => words::text(&self.predicates, question),
            Style::Paper => self.paper(question),
            Style::Picture => words::beside_picture(&self.predicates, question),
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
            let atoms: Vec<String> = rows.iter().map(|row| atom(name, definition, row)).collect();
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

    /// Returns a question in the words of the paper's figure. As there, the facts omit that each entity sees itself.
    fn paper(&self, question: &Question) -> String {
        let names: Vec<String> = (0..question.entities).map(entity).collect();
        let predicates = self.predicates.iter();
        let predicates = predicates.map(|(name, definition)| format!("{name} (arity: {})", definition.arity()));
        let facts = self.predicates.iter().zip(&question.facts.rows);
        let facts = facts.flat_map(|((name, definition), rows)| {
            let others = rows
                .iter()
                .filter(|row| !(definition.is_reflexive() && row[0] == row[1]));
            others.map(move |row| atom(name, definition, row))
        });
        format!(
            "In the scene you see a total of {} entities, they are named as follows: {}. There exist the following \
             predicates as their attributes and relations: {}. The truth value of these predicates grounded to the \
             entities are as follows (Only the ones that are True are provided, assume the rest are False): {}. What \
             is the next action of entity {}?",
            names.len(),
            names.join(", "),
            predicates.collect::<Vec<_>>().join(", "),
            facts.collect::<Vec<_>>().join(", "),
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

/// Returns a fact as an atom.
fn atom(name: &str, definition: &Definition, row: &[u32; 2]) -> String {
    let arguments = row[..definition.arity()].iter().map(|&place| entity(place as usize));
    format!("{name}({})", arguments.collect::<Vec<_>>().join(", "))
}

/// Returns the file name of the picture of a question.
pub(super) fn picture_of_question(set: &str, number: usize) -> String {
    format!("{set}-{number}.png")
}

/// Returns the file name of the picture of a demonstration.
pub(super) fn picture_of_demonstration(set: &str, number: usize) -> String {
    format!("{set}-example-{}.png", number + 1)
}

/// Returns the name of an entity.
pub(super) fn entity(place: usize) -> String {
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
