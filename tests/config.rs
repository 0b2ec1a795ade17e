//! Configurations: the files we ship, every message, the blocks of the reference, and hostile input.

use logicity::config::{AgentKind, Scenario, Split, load_scenario};
use logicity::diag::{Diagnostic, Sources, render};
use logicity::files::{ReadError, read_text};
use std::path::Path;

const ROOT: &str = env!("CARGO_MANIFEST_DIR");

/// Rule files need only be there; what they say is not a matter of configurations.
fn read(path: &Path) -> Result<String, ReadError> {
    match path.extension() {
        Some(extension) if extension == "dl" => Ok(String::new()),
        _ => read_text(path),
    }
}

fn told(sources: &Sources, faults: &[Diagnostic]) -> String {
    render(faults, sources, false)
}

fn load(path: &Path) -> Scenario {
    let mut sources = Sources::new();
    load_scenario(&mut sources, path, &read).unwrap_or_else(|faults| panic!("{}", told(&sources, &faults)))
}

#[test]
fn every_mode_loads_with_the_agents_of_the_reference() {
    // Cars and pedestrians in train, val and test; predicates besides `Sees`.
    let table = [
        ("easy", [(6, 2), (7, 3), (9, 6)], 9),
        ("medium", [(6, 3), (7, 5), (10, 8)], 12),
        ("hard", [(7, 3), (8, 6), (10, 8)], 17),
        ("expert", [(7, 4), (8, 6), (10, 8)], 17),
        ("transfer-easy", [(7, 3), (8, 6), (10, 8)], 17),
        ("transfer-medium", [(7, 3), (8, 6), (10, 8)], 17),
        ("transfer-hard", [(7, 3), (8, 6), (10, 8)], 17),
        ("vap-easy", [(7, 5), (8, 6), (8, 6)], 17),
        ("vap-hard", [(7, 5), (8, 6), (8, 6)], 17),
    ];
    for (mode, counts, predicates) in table {
        let scenario = load(&Path::new(ROOT).join("configs").join(mode).with_extension("yaml"));
        assert_eq!(scenario.name, mode);
        assert_eq!(scenario.map.name, "square-5x5");
        assert_eq!(
            scenario.rules.value,
            Path::new(ROOT).join("rules").join(mode).with_extension("dl")
        );
        assert_eq!(scenario.predicates.len(), predicates + 1, "{mode}");
        for (split, (cars, pedestrians)) in Split::ALL.into_iter().zip(counts) {
            let agents = &scenario.agent_set(split).expect("all splits").agents;
            let count = |kind| agents.iter().filter(|agent| agent.kind == kind).count();
            assert_eq!(
                (count(AgentKind::Car), count(AgentKind::Pedestrian)),
                (cars, pedestrians),
                "{mode} {split:?}"
            );
            assert_eq!(agents[0].name, "Car_1");
            assert!(
                agents[1..=pedestrians]
                    .iter()
                    .all(|agent| agent.kind == AgentKind::Pedestrian)
            );
        }
    }
}
