//! The result of a comparison, for people and as JSON.

use crate::city::Action;
use crate::datalog::diff::{Cut, Difference, Equivalence};
use crate::datalog::{BaseType, Rules, drawn_probabilities, quoted};
use crate::sim::{needed_draws, scene_json};
use serde_json::{Value, json};
use std::io::{self, Write};

/// The result of a comparison.
pub struct Verdict<'a> {
    pub equivalence: &'a Equivalence,
    /// The constraints that the proof needs.
    pub given: &'a [String],
    /// The name of the configuration.
    pub city: Option<&'a str>,
}

impl Verdict<'_> {
    pub fn json(&self, rules: &[Rules; 2]) -> Value {
        let mut line = json(self.equivalence, rules);
        if let Equivalence::Equivalent { .. } = self.equivalence {
            line["given"] = json!(self.given);
        }
        if let Some(city) = self.city {
            line["config"] = json!(city);
        }
        line
    }

    /// Prints the result for two files with these names and rules.
    pub fn print(&self, out: &mut impl Write, names: &[String; 2], rules: &[Rules; 2]) -> io::Result<()> {
        let place = self
            .city
            .map_or_else(String::new, |city| format!("in the city `{city}`: "));
        let text = match self.equivalence {
            Equivalence::Different(difference) => show_difference(difference, names, rules),
            equal => show_equal(equal),
        };
        writeln!(out, "{place}{text}")?;
        self.given.iter().try_for_each(|one| writeln!(out, "given {one}"))
    }
}

fn entities_of(count: usize) -> String {
    format!("{count} {}", if count == 1 { "entity" } else { "entities" })
}

fn show_equal(equivalence: &Equivalence) -> String {
    match equivalence {
        Equivalence::Equivalent { entities: None } => "equivalent: both sides have the same clauses".to_owned(),
        Equivalence::Equivalent {
            entities: Some(entities),
        } => format!(
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

fn show_difference(difference: &Difference, names: &[String; 2], rules: &[Rules; 2]) -> String {
    let size = if difference.smallest {
        "smallest scene"
    } else {
        "a scene"
    };
    let mut text = format!(
        "different; {size} that shows it, ready for `logicity infer`:\n{}\n",
        scene_json(difference, &rules.each_ref())
    );
    let has_draws = |rules: &Rules| (rules.predicates.iter()).any(|known| drawn_probabilities(&known.name).is_some());
    match needed_draws(difference) {
        needed if !needed.is_empty() => text += &format!("if only these draws succeed: {}\n", needed.join("; ")),
        _ if rules.iter().any(has_draws) => text += "if every draw fails\n",
        _ => {}
    }
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
    let columns = rules.predicate(name).map(|id| &rules.predicates[id.index()].columns);
    let values = row.iter().enumerate().map(|(at, text)| {
        match columns.and_then(|columns| columns.get(at)).map(|column| column.base) {
            Some(BaseType::Symbol) => quoted(text),
            _ => text.clone(),
        }
    });
    format!("{name}({})", values.collect::<Vec<_>>().join(", "))
}

fn json(equivalence: &Equivalence, rules: &[Rules; 2]) -> Value {
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
                "scene": scene_json(difference, &rules.each_ref()),
                "everybody_sees": difference.everybody_sees,
                "left": derived(&difference.derived[0]),
                "right": derived(&difference.derived[1]),
            })
        }
    }
}
