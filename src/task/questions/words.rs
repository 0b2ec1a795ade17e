//! Formats the facts of a question as English sentences.

use crate::city::{Action, AgentKind, speed_cells};
use crate::predicate::{Definition, Phrase};
use crate::task::questions::Question;

/// Returns a question without its options. Agents have names such as `Car 2`: the noun of a predicate that holds for
/// the agent and its number among these, in the order of the entities.
pub(super) fn text(predicates: &[(String, Definition)], question: &Question) -> String {
    let phrases: Vec<Phrase> = predicates.iter().map(|(_, definition)| definition.phrase()).collect();
    let names = names(&phrases, question);
    let mut text = format!("A city is a grid of cells. In one step a car moves {}.", moves());
    let mut meanings: Vec<&String> = Vec::new();
    for meaning in phrases.iter().filter_map(|phrase| phrase.meaning.as_ref()) {
        if !meanings.contains(&meaning) {
            meanings.push(meaning);
            text += &format!(" {meaning}");
        }
    }
    let plural = if names.len() == 1 { "" } else { "s" };
    text += &format!(
        "\nA scene with {} agent{plural}. What is not stated is false.\n",
        names.len()
    );
    for (agent, name) in names.iter().enumerate() {
        let mut sentences: Vec<String> = Vec::new();
        let mut properties: Vec<&str> = Vec::new();
        for (((_, definition), phrase), rows) in predicates.iter().zip(&phrases).zip(&question.facts.rows) {
            let own = rows.iter().filter(|row| row[0] as usize == agent);
            if definition.arity() == 1 {
                properties.extend(own.map(|_| phrase.verb.as_str()));
                continue;
            }
            // What holds for each agent and itself is part of the meaning.
            let others = own.filter(|row| !(definition.is_reflexive() && row[0] == row[1]));
            let others: Vec<&str> = others.map(|row| names[row[1] as usize].as_str()).collect();
            if !others.is_empty() {
                sentences.push(format!("{name} {} {}.", phrase.verb, joined(&others, "and")));
            }
        }
        let first = match properties.is_empty() {
            true => format!("{name} is in the scene."),
            false => format!("{name} {}.", joined(&properties, "and")),
        };
        sentences.insert(0, first);
        text += &(sentences.join(" ") + "\n");
    }
    text + &format!("Which action does {} take next?", names[question.ego])
}

/// Describes the actions of a car: `1 cell (Slow), .. or 0 cells (Stop)`.
fn moves() -> String {
    let moves = Action::ALL.map(|action| {
        let cells = speed_cells(AgentKind::Car, action).expect("cars take every action");
        let plural = if cells == 1 { "" } else { "s" };
        format!("{cells} cell{plural} ({})", action.name())
    });
    joined(&moves, "or")
}

/// Returns the names of the agents.
fn names(phrases: &[Phrase], question: &Question) -> Vec<String> {
    let mut nouns = vec!["Agent"; question.entities];
    for (phrase, rows) in phrases.iter().zip(&question.facts.rows) {
        if let Some(noun) = phrase.noun {
            rows.iter().for_each(|row| nouns[row[0] as usize] = noun);
        }
    }
    let number = |agent: usize| nouns[..=agent].iter().filter(|noun| **noun == nouns[agent]).count();
    (0..nouns.len())
        .map(|agent| format!("{} {}", nouns[agent], number(agent)))
        .collect()
}

/// Joins parts with commas, and the last two with a conjunction.
fn joined<T: AsRef<str>>(parts: &[T], conjunction: &str) -> String {
    let parts: Vec<&str> = parts.iter().map(AsRef::as_ref).collect();
    match parts.split_last() {
        Some((last, before)) if !before.is_empty() => format!("{} {conjunction} {last}", before.join(", ")),
        _ => parts.concat(),
    }
}
