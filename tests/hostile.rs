//! Scenes and facts are never a panic, whatever bytes they are. (`tests/lang.rs` and `tests/config.rs` do the same for rules, maps and
//! other configuration.)

use logicity::config::load_scenario;
use logicity::diag::{Code, Sources, render, to_json};
use logicity::engine::{Program, facts};
use logicity::files::{read_or_builtin, read_text};
use logicity::lang;
use logicity::rng::Seed;
use logicity::sim::Inference;
use proptest::prelude::*;
use std::path::Path;

fn program(text: &str) -> Program {
    let mut sources = Sources::new();
    let entry = sources.add("test.dl", text);
    Program::new(lang::load(&mut sources, entry, &read_or_builtin).rules.unwrap()).unwrap()
}

fn inference() -> Inference {
    let mut sources = Sources::new();
    let scenario = load_scenario(&mut sources, Path::new("expert"), &read_text).unwrap();
    let rules = program(".include \"expert.dl\"");
    Inference::new(scenario, rules, Seed(0), read_text).unwrap()
}

const SCENES: [&str; 2] = [
    r#"{"map":"square-5x5","agents":[{"id":"Car_1","type":"Car","at":[102,20],"heading":null,"concepts":["ambulance"],"priority":1},{"id":"Pedestrian_1","type":"Pedestrian","at":[98,20],"heading":"Up"}],"egos":["Car_1"],"given":{"CollidingClose":[["Car_1","Pedestrian_1"]]}}"#,
    r#"{"entities":["e0","e1"],"ego":"e0","facts":{"IsCar":["e0"],"HigherPri":[["e1","e0"]]}}"#,
];

/// A text with some bytes replaced, removed or doubled.
fn mutated(texts: &'static [&'static str]) -> impl Strategy<Value = String> {
    let edit = (any::<prop::sample::Index>(), 0..4u8, any::<char>());
    (prop::sample::select(texts), prop::collection::vec(edit, 1..8)).prop_map(|(text, edits)| {
        let mut chars: Vec<char> = text.chars().collect();
        for (at, kind, c) in edits {
            let at = at.index(chars.len());
            match kind {
                0 => chars[at] = c,
                1 if chars.len() > 1 => drop(chars.remove(at)),
                2 => chars.insert(at, chars[at]),
                _ => chars.insert(at, c),
            }
        }
        chars.into_iter().collect()
    })
}

proptest! {
    #[test]
    fn any_scene_is_answered_or_refused(text in prop_oneof![mutated(&SCENES), any::<String>()]) {
        let mut inference = inference();
        let mut sources = Sources::new();
        let source = sources.add_from("scene", text, 9);
        match inference.answer(&sources, source) {
            Ok(answer) => prop_assert!(!answer.to_json().to_string().is_empty()),
            Err(faults) => {
                prop_assert!(!faults.is_empty());
                prop_assert!(faults.iter().all(|fault| fault.code == Code::InvalidScene));
                prop_assert!(!render(&faults, &sources, false).is_empty());
                prop_assert!(!to_json(&faults, &sources).to_string().is_empty());
            }
        }
    }

    #[test]
    fn any_facts_are_read_or_refused(text in prop_oneof![mutated(&["a\t1\nb\t-2\n"]), any::<String>()]) {
        let program = program(".decl p(x: symbol, n: number)\n.input p\n");
        let p = program.relation("p").unwrap();
        let mut session = program.session();
        let mut sources = Sources::new();
        let source = sources.add("p.facts", text);
        match facts::load(&mut session, p, &sources, source) {
            Ok(lines) => {
                session.commit().unwrap();
                prop_assert!(session.len(p) <= lines);
                // What was read is written so that it is read again as the same.
                let mut again = program.session();
                let source = sources.add("again", facts::print(&session, p));
                facts::load(&mut again, p, &sources, source).unwrap();
                again.commit().unwrap();
                prop_assert_eq!(facts::print(&again, p), facts::print(&session, p));
            }
            Err(faults) => {
                prop_assert!(faults.iter().all(|fault| fault.code == Code::InvalidFact));
                prop_assert!(!render(&faults, &sources, false).is_empty());
            }
        }
    }
}
