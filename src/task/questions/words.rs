//! Formats the facts of a question as English sentences.

use crate::city::{Action, AgentKind, speed_cells};
use crate::predicate::Definition;
use crate::sim::Facts;
use crate::task::questions::Question;

/// Returns a question without its options. Agents have names such as `Car 2`: the noun of a predicate that holds for
/// the agent and its number among these, in the order of the entities.
pub(super) fn text(predicates: &[(String, Definition)], question: &Question) -> String {
    let names = names(predicates, question);
    let mut text = general(predicates);
    let plural = if names.len() == 1 { "" } else { "s" };
    text += &format!(
        "\nA scene with {} agent{plural}. What is not stated is false.\n",
        names.len()
    );
    for (agent, name) in names.iter().enumerate() {
        let unary = predicates.iter().zip(&question.facts.rows);
        let unary = unary.filter(|((_, definition), _)| definition.arity() == 1);
        let properties = unary.flat_map(|((_, definition), rows)| {
            let own = rows.iter().filter(|row| row[0] as usize == agent);
            own.map(|_| definition.phrase().verb)
        });
        let properties: Vec<String> = properties.collect();
        let first = match properties.is_empty() {
            true => format!("{name} is in the scene."),
            false => format!("{name} {}.", joined(&properties, "and")),
        };
        let mut sentences = vec![first];
        sentences.extend(relations(predicates, question, &names, agent));
        text += &(sentences.join(" ") + "\n");
    }
    text + &format!("Which action does {} take next?", names[question.ego])
}

/// Returns a question about a picture, without its options. It states only the facts that do not follow from the
/// picture: those about priorities, and those that hold with a probability.
pub(super) fn beside_picture(predicates: &[(String, Definition)], question: &Question) -> String {
    let names = names(predicates, question);
    let (ego, plural) = (&names[question.ego], if names.len() == 1 { "" } else { "s" });
    let mut text = general(predicates);
    text += &format!(
        "\nThe picture shows a scene with {} agent{plural} from above, each with its name. A frame marks {ego}. A legend \
         explains the icons.\n",
        names.len()
    );
    // Without the other predicates and their rows.
    let hidden = |definition: &Definition| definition.is_ranking() || definition.is_drawn();
    let (predicates, rows): (Vec<_>, Vec<_>) = (predicates.iter().cloned())
        .zip(question.facts.rows.iter().cloned())
        .filter(|((_, definition), _)| hidden(definition))
        .unzip();
    if !predicates.is_empty() {
        let verbs = predicates
            .iter()
            .map(|(_, definition)| format!("{} another one", definition.phrase().verb));
        let verbs = joined(&verbs.collect::<Vec<_>>(), "or");
        text += &format!("It does not show which agent {verbs}; what is not stated about that is false.\n");
    }
    let question = Question {
        facts: Facts::of(rows),
        ..question.clone()
    };
    for agent in 0..names.len() {
        let sentences = relations(&predicates, &question, &names, agent);
        if !sentences.is_empty() {
            text += &(sentences.join(" ") + "\n");
        }
    }
    text + &format!("Which action does {ego} take next?")
}

/// Returns a sentence for each binary predicate that holds for an agent and others.
fn relations(predicates: &[(String, Definition)], question: &Question, names: &[String], agent: usize) -> Vec<String> {
    let binary = predicates.iter().zip(&question.facts.rows);
    let binary = binary.filter(|((_, definition), _)| definition.arity() == 2);
    let sentences = binary.filter_map(|((_, definition), rows)| {
        let own = rows.iter().filter(|row| row[0] as usize == agent);
        // What holds for each agent and itself is part of the meaning.
        let others = own.filter(|row| !(definition.is_reflexive() && row[0] == row[1]));
        let others: Vec<&str> = others.map(|row| names[row[1] as usize].as_str()).collect();
        let (name, verb) = (&names[agent], definition.phrase().verb);
        (!others.is_empty()).then(|| format!("{name} {verb} {}.", joined(&others, "and")))
    });
    sentences.collect()
}

/// Describes what holds in every scene: the grid, the actions of a car, and the words of predicates that need it.
fn general(predicates: &[(String, Definition)]) -> String {
    let mut text = format!("A city is a grid of cells. In one step a car moves {}.", moves());
    let mut meanings: Vec<String> = Vec::new();
    for meaning in predicates
        .iter()
        .filter_map(|(_, definition)| definition.phrase().meaning)
    {
        if !meanings.contains(&meaning) {
            text += &format!(" {meaning}");
            meanings.push(meaning);
        }
    }
    text
}

/// Describes the actions of a car: `1 cell (Slow), .. or 0 cells (Stop)`.
fn moves() -> String {
    let moves = Action::STANDARD.map(|action| {
        let cells = speed_cells(AgentKind::Car, action).expect("cars take every action");
        let plural = if cells == 1 { "" } else { "s" };
        format!("{cells} cell{plural} ({})", action.name())
    });
    joined(&moves, "or")
}

/// Returns the names of the agents.
pub(super) fn names(predicates: &[(String, Definition)], question: &Question) -> Vec<String> {
    let mut nouns = vec!["Agent"; question.entities];
    for ((_, definition), rows) in predicates.iter().zip(&question.facts.rows) {
        if let Some(noun) = definition.phrase().noun {
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
