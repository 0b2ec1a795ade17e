//! Configurations: the shipped files, every message, the blocks of the reference, and hostile input.

use crate::cases::cases;
use crate::pages::{blocks, pages};
use logicity::builtin::{self, BuiltinFiles, ReadWith};
use logicity::city::{Action, AgentConfig, AgentKind, Buildings, MapConfig, Region, Routing, Split, TripEnds};
use logicity::config::{Scenario, load_map, load_scenario};
use logicity::diag::{Diagnostic, MAX_FAULTS, Sources, render, to_json};
use logicity::files::{BUILTIN_FOLDER, ReadError, ReadFile, read_text};
use logicity::predicate::{Colliding, Distance};
use logicity::{city, config, diag, sim, yaml};
use proptest::prelude::*;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

const ROOT: &str = env!("CARGO_MANIFEST_DIR");

/// The codes of faults in configurations. Each has a fixture `<code>.yaml` or `<code>/main.yaml`.
const FIXTURES: [&str; 8] = [
    "not-text",
    "limit-exceeded",
    "yaml-syntax",
    "unknown-key",
    "duplicate-key",
    "missing-key",
    "invalid-value",
    "missing-file",
];

fn rendered(sources: &Sources, faults: &[Diagnostic]) -> String {
    render(faults, sources, false)
}

fn load(path: &Path) -> Scenario {
    let mut sources = Sources::new();
    load_scenario(&mut sources, path, &BuiltinFiles).unwrap_or_else(|faults| panic!("{}", rendered(&sources, &faults)))
}

/// Returns the message about a faulty configuration with this text.
pub fn refused(text: &str) -> String {
    let (sources, loaded) = load_memory(&[("main.yaml", text)]);
    let message = render(&loaded.expect_err(text), &sources, false);
    assert!(message.contains(".yaml:"), "{message}");
    message
}

/// Loads `main.yaml` of a few files in memory, which may refer to built-in files.
pub fn load_memory(files: &[(&str, &str)]) -> (Sources, Result<Scenario, Vec<Diagnostic>>) {
    let read = |path: &Path| {
        let found = files.iter().find(|(name, _)| Path::new(name) == path);
        match found {
            Some((_, text)) => Ok((*text).to_owned()),
            None => builtin_only(path),
        }
    };
    let mut sources = Sources::new();
    // With the built-in paths, for suggestions.
    let result = load_scenario(&mut sources, Path::new("main.yaml"), &ReadWith(read));
    (sources, result)
}

/// Loads a map from memory.
pub fn load_memory_map(text: &str) -> Result<MapConfig, Vec<Diagnostic>> {
    let read = |path: &Path| match path == Path::new("town.yaml") {
        true => Ok(text.to_owned()),
        false => builtin_only(path),
    };
    load_map(&mut Sources::new(), Path::new("town.yaml"), &ReadWith(read))
}

fn good(files: &[(&str, &str)]) -> Scenario {
    let (sources, result) = load_memory(files);
    result.unwrap_or_else(|faults| panic!("{}", rendered(&sources, &faults)))
}

fn bad(files: &[(&str, &str)]) -> String {
    let (sources, result) = load_memory(files);
    rendered(&sources, &result.expect_err("a fault"))
}

#[test]
fn every_mode_loads_with_the_agents_of_the_reference() {
    // Cars and pedestrians in train, val and test; predicates except `Sees`.
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
            let set = scenario.agent_set(split).expect("all splits");
            let agents: Vec<AgentConfig> = set.agents().collect();
            let count = |kind| agents.iter().filter(|agent| agent.name.kind == kind).count();
            assert_eq!(
                [count(AgentKind::Car), count(AgentKind::Pedestrian)],
                AgentKind::ALL.map(|kind| set.count(kind))
            );
            assert_eq!(
                (count(AgentKind::Car), count(AgentKind::Pedestrian)),
                (cars, pedestrians),
                "{mode} {split:?}"
            );
            assert_eq!(agents[0].name.to_string(), "Car_1");
            assert!(
                agents[1..=pedestrians]
                    .iter()
                    .all(|agent| agent.name.kind == AgentKind::Pedestrian)
            );
        }
    }
}

/// Returns the faults that the comments of a text expect: (line, code).
fn expected(text: &str) -> Vec<(usize, String)> {
    let mut out = Vec::new();
    for (line, text) in text.lines().enumerate() {
        for comment in text.split("# error[").skip(1) {
            let code = comment.split(']').next().expect("split gives at least one part");
            out.push((line + 1, code.to_owned()));
        }
    }
    out
}

/// Returns the line and the code of each fault.
fn found(sources: &Sources, faults: &[Diagnostic]) -> Vec<(usize, String)> {
    let mut out: Vec<_> = faults
        .iter()
        .map(|fault| {
            let line = fault
                .primary
                .as_ref()
                .map_or(0, |label| sources.position(label.span).line);
            (line, fault.code.name().to_owned())
        })
        .collect();
    out.sort();
    out
}

#[test]
fn fixtures_give_the_faults_they_expect() {
    let folder = Path::new(ROOT).join("tests/fixtures/diagnostics");
    for code in FIXTURES {
        let file = folder.join(code).with_extension("yaml");
        let path = if file.exists() {
            file
        } else {
            folder.join(code).join("main.yaml")
        };
        let mut sources = Sources::new();
        let faults = load_scenario(&mut sources, &path, &BuiltinFiles)
            .err()
            .unwrap_or_default();
        let text = read_text(&path).expect("fixture");
        let wanted = expected(&text);
        assert!(wanted.iter().all(|(_, wanted)| wanted == code) && !wanted.is_empty());
        assert_eq!(
            found(&sources, &faults),
            wanted,
            "{code}\n{}",
            rendered(&sources, &faults)
        );
    }
}

/// Each text has one fault, at this place, with these words in message, notes or help.
#[test]
fn common_mistakes_are_explained_once() {
    let expert = "base: configs/expert.yaml\n";
    for (text, place, words) in [
        (
            "map: {buildings: {random: {seed: 1, weights: {House: 1}}}}",
            (2, 27),
            vec![
                "both `rows` and `random`",
                "inherited from the base",
                "`buildings: {rows: ~, random: {...}}`",
            ],
        ),
        (
            "map: {buildings: {rows: [], random: {seed: 1, weights: {House: 1}}}}",
            (2, 37),
            vec!["both `rows` and `random`", "remove one of them"],
        ),
        (
            "map: {blocks: [1, 1]}",
            (2, 15),
            vec![
                "has 1 x 1 blocks",
                "for 5 x 5 blocks",
                "{rows: [HO, SG]}",
                "{rows: ~, random: ",
            ],
        ),
        (
            "map: {buildings: {rows: [HO, SG]}}",
            (2, 25),
            vec![
                "has 5 x 5 blocks",
                "for 1 x 1 blocks",
                "the blocks, inherited from the base",
            ],
        ),
        (
            "predicates: {define: {IsTaxi: {concept: taxi}}}",
            (2, 31),
            vec!["`concept` needs the key `of`, too", "`{concept: taxi, of: Car}`"],
        ),
        (
            "predicates: {define: {IsNear: {near: 3}}}",
            (2, 31),
            vec!["`near` needs the key `within`, too", "`{distance: {at_most: 3}}`"],
        ),
        (
            "predicates: {define: {IsFar: {above: 30}}}",
            (2, 31),
            vec!["unknown key `above`", "`{distance: {above: 30}}`"],
        ),
        (
            "predicates: {define: {IsFar: {kind: Car, distance: {above: 30}}}}",
            (2, 30),
            vec!["expected exactly one of", "found `kind`, `distance`"],
        ),
        (
            "predicates: {define: {IsCar: {knd: Car}}}",
            (2, 31),
            vec!["unknown key `knd`", "did you mean `kind`?"],
        ),
        (
            "kinds: {Cyclist: {kind: Car: 4}}",
            (2, 25),
            vec!["in the value of `kind`", "`kind: {Car: 4}`", "`kind: \"Car: 4\"`"],
        ),
        (
            "kinds:\n  Cyclist:\n    kind: Car: 4",
            (4, 11),
            vec!["a value in the line of its key cannot have a key itself"],
        ),
        (
            "regoin: ~",
            (2, 1),
            vec!["unknown key `regoin`", "did you mean `region`?"],
        ),
        ("taskk: ~", (2, 1), vec!["unknown key `taskk`", "did you mean `task`?"]),
        (
            "predicates: {define: {IsTirro: ~}}",
            (2, 23),
            vec!["the base has no predicate `IsTirro`", "did you mean `IsTiro`?"],
        ),
        (
            "map: {zones: {school: ~}}",
            (2, 15),
            vec!["the base has no zone `school`", "so `~` removes nothing", "remove it"],
        ),
        (
            "kinds: {Cyclist: ~}",
            (2, 9),
            vec!["the base has no kind of agents `Cyclist`"],
        ),
        (
            "actions: {define: {Unload: ~}}",
            (2, 20),
            vec!["the base has no action `Unload`"],
        ),
        (
            "task: {reward: {clauses: {S1: ~}}}",
            (2, 27),
            vec!["the base has no reward of the clause `S1`"],
        ),
        (
            "map: {buildings: {rndom: ~}}",
            (2, 19),
            vec!["unknown key `rndom`", "did you mean `random`?"],
        ),
        (
            "map: {buildings: {row: ~, random: {seed: 1, weights: {House: 1}}}}",
            (2, 19),
            vec!["unknown key `row`", "did you mean `rows`?"],
        ),
        (
            "actions: {define: {Unload: {park: 20, cells: {Car: 0}}}}",
            (2, 20),
            vec![
                "exactly once",
                "the inherited `priority` lacks it",
                "write beside `define`: `priority: [Stop, Unload, Slow, Fast, Normal]`",
            ],
        ),
        (
            "map:\n  blocks: [1, 1]\n zones: {}",
            (4, 2),
            vec![
                "no line above has the indentation of this line",
                "indent it like `blocks` in line 3 (2 spaces), or like `map` in line 2 (0 spaces)",
            ],
        ),
        (
            "view: 3\n  ticks: 4",
            (3, 3),
            vec!["indent it like `view` in line 2 (0 spaces)"],
        ),
        (
            "agents:\n  test:\n    cars:\n      - priority: 1\n       count: 3",
            (6, 8),
            vec!["indent it like `priority` in line 5 (8 spaces)"],
        ),
        (
            "view: 3\n- ticks: 4",
            (3, 1),
            vec!["expected a key, found a list entry", "remove the dash"],
        ),
        (
            "agents: {test: {cars: [{priority: 1}]}\nview: 3",
            (3, 1),
            vec![
                "expected `,` or `}` before this line",
                "opened here",
                "close the `{` with `}`",
            ],
        ),
        (
            "agents: {test: {cars: [{priority: 1}]}",
            (2, 9),
            vec!["the `{` is not closed", "write `}` after its last entry"],
        ),
        (
            "agents: {test: {cars: [{priority: 1}}}",
            (2, 23),
            vec!["a `]` is missing before a `}`", "write `]` before this"],
        ),
        (
            "map: {blocks: [1, 1] zones: {}}",
            (2, 22),
            vec!["expected `,` or `}`", "put a comma between its entries"],
        ),
        (
            "agents:\n  test:\n    cars:\n      -{priority: 1}",
            (5, 7),
            vec!["put a space after the dash: `- {priority: 1}`"],
        ),
        (
            "agents:\n  test:\n    cars:\n      - {priority: 1}\n      -priority: 2",
            (6, 7),
            vec!["put a space after the dash: `- priority: 2`"],
        ),
        (
            "rules: \"hard.dl\nview: 3",
            (2, 8),
            vec!["the quote is not closed", "in the same line"],
        ),
        (
            "view 40\nticks: 3",
            (2, 1),
            vec!["expected `:` after `view`", "write `view: 40`"],
        ),
        ("view: 40}", (2, 7), vec!["remove the `}`: nothing opens it"]),
        (
            "map: @mine",
            (2, 6),
            vec!["a text without quotes cannot begin with `@`", "`\"@mine\"`"],
        ),
        (
            "agents: {test: [{cars: []}]}",
            (2, 16),
            vec!["(a mapping), found a list", "without a dash or brackets: `cars: ...`"],
        ),
        (
            "agents: {test: {cars: {priority: 3}}}",
            (2, 23),
            vec!["expected a list of cars, found a mapping", "`[{priority: ...}]`"],
        ),
        ("predicates: {use: IsCar}", (2, 19), vec!["write a list: `[IsCar]`"]),
        (
            "predicates: {define: {Tick: {quantity:tick}}}",
            (2, 30),
            vec!["expected a space after `quantity:`", "`quantity: tick`"],
        ),
        (
            "predicates: {define: {IsFar: {distance: {atmost: 25}}}}",
            (2, 42),
            vec!["unknown key `atmost`", "did you mean `at_most`?"],
        ),
        (
            "agents: {test: {cars: [{prioriti: 1}]}}",
            (2, 25),
            vec!["unknown key `prioriti`", "did you mean `priority`?"],
        ),
        ("view:40", (2, 1), vec!["expected a space after `view:`", "`view: 40`"]),
        ("view:40\nticks: 3", (2, 1), vec!["expected a space after `view:`"]),
        (
            "ticks: 3\nagents:\n  test:\n    cars:\n      - priority:1\n        count: 3",
            (6, 9),
            vec!["`priority: 1`"],
        ),
        (
            "map:\n  blocks:[1, 1]",
            (3, 3),
            vec!["put a space after the colon: `blocks: [1, 1]`"],
        ),
        (
            "map: {blocks:3}",
            (2, 7),
            vec![
                "expected a space after `blocks:`",
                "put a space after the colon: `blocks: 3`",
            ],
        ),
        (
            "map:\n\tblocks: [1, 1]",
            (3, 1),
            vec!["a tab indents this line", "indent with spaces"],
        ),
        (
            "map:\n  buildings:\n  \trows: ~",
            (4, 3),
            vec!["a tab indents this line"],
        ),
        (
            "ticks: 5\n\tview: 40",
            (3, 1),
            vec!["a tab indents this line", "indent with spaces"],
        ),
        (
            "predicates: {define: {IsNear: {distance: 5}}}",
            (2, 42),
            vec![
                "expected a distance (a mapping)",
                "a distance is written `{at_most: 5}`",
            ],
        ),
        (
            "map: square5x5",
            (2, 6),
            vec!["no such file", "did you mean `square-5x5`?"],
        ),
        (
            "map: atlantis",
            (2, 6),
            vec!["built in as a map: metropolis, random-8x8, roundabout, square-5x5"],
        ),
        ("map: expert", (2, 6), vec!["`expert` is a run configuration"]),
        ("agents: exprt", (2, 9), vec!["did you mean `expert`?"]),
        ("rules: rules/exprt.dl", (2, 8), vec!["did you mean `rules/expert.dl`?"]),
        ("rules: exprt", (2, 8), vec!["did you mean `expert`?"]),
        (
            "agents: {test: {cars: [{priority: 1, concept: [bus]}]}}",
            (2, 38),
            vec!["did you mean `concepts`?"],
        ),
    ] {
        let whole = format!("{expert}{text}\n");
        let (sources, result) = load_memory(&[("main.yaml", whole.as_str())]);
        let faults = result.err().unwrap_or_default();
        let shown = rendered(&sources, &faults);
        assert_eq!(faults.len(), 1, "{text}\n{shown}");
        let span = faults[0].primary.as_ref().expect("a place").span;
        let at = sources.position(span);
        assert_eq!(
            (sources.name(span.source), at.line, at.column),
            ("main.yaml", place.0, place.1),
            "{shown}"
        );
        for word in words {
            assert!(shown.contains(word), "`{word}` is missing in:\n{shown}");
        }
    }
    for (text, near) in [("base: comon.yaml\n", "common"), ("base: exprt.yaml\n", "expert")] {
        assert!(bad(&[("main.yaml", text)]).contains(&format!("did you mean `{near}`?")));
    }
    // Without any other key, the text is a scalar.
    assert!(bad(&[("main.yaml", "view:40\n")]).contains("put a space after the colon: `view: 40`"));
}

#[test]
fn a_bad_base_hides_no_other_fault() {
    let text = "base: exprt\nview: no\nfoo: 3\nmap: {blocks: 3}\npredicates: {use: [IsCar], define: {IsNear: {close: 3}}}\n\
                agents: {test: {cars: [{priority: x, concepts: [taxi]}]}}\nticks: 3\n";
    let (sources, result) = load_memory(&[("main.yaml", text)]);
    let faults = result.expect_err("faults");
    let lines: Vec<(usize, &str)> = (faults.iter())
        .map(|fault| {
            (
                sources.position(fault.primary.as_ref().expect("a place").span).line,
                fault.code.name(),
            )
        })
        .collect();
    let expected = [
        (1, "missing-file"),
        (2, "invalid-value"),
        (3, "unknown-key"),
        (4, "invalid-value"),
        (5, "unknown-key"),
        (6, "invalid-value"),
    ];
    assert_eq!(lines, expected, "{}", rendered(&sources, &faults));
    assert!(rendered(&sources, &faults).contains("did you mean `expert`?"));
    // A base with a syntax error counts as missing, too.
    let (sources, result) = load_memory(&[("main.yaml", "base: other.yaml\nview: no\n"), ("other.yaml", "[")]);
    let faults = result.expect_err("faults");
    assert_eq!(faults.len(), 2, "{}", rendered(&sources, &faults));
}

/// Configurations are the same on every system: `/` works everywhere. Only Windows also knows other separators.
#[test]
fn paths_have_slashes_on_every_system() {
    let files = |agents: &'static str| {
        let main = ["base: expert\nagents: ", agents, "\n"].concat();
        load_memory(&[
            ("main.yaml", &main),
            ("parts/few.yaml", "test: {cars: [{priority: 1}]}\n"),
        ])
        .1
    };
    files("parts/few.yaml").expect("the file is there");
    let found = files("parts\\few.yaml");
    assert_eq!(found.is_ok(), cfg!(windows));
    if let Err(faults) = found {
        let help = faults[0].help.first().expect("the path has a portable form");
        assert!(help.contains("`parts/few.yaml`"), "{help}");
    }
}

#[test]
fn bare_names_are_built_in_files() {
    let long = "base: configs/easy.yaml\nmap: configs/maps/random-8x8.yaml\nagents: configs/agents/expert.yaml\n\
                predicates: configs/predicates/standard.yaml\ntask: configs/tasks/expert.yaml\nrules: rules/expert.dl\n";
    let short = "base: easy\nmap: random-8x8\nagents: expert\npredicates: standard\ntask: expert\nrules: expert\n";
    let (long, short) = (good(&[("main.yaml", long)]), good(&[("main.yaml", short)]));
    assert_eq!((long.hash, long.rules.value), (short.hash, short.rules.value));
    let part = good(&[("main.yaml", "base: expert\nmap: {base: random-8x8, blocks: [9, 9]}\n")]);
    assert_eq!(part.map.blocks().unwrap().blocks.value, [9, 9]);
    // A file beside the configuration comes first.
    let own = "base: configs/expert.yaml\nview: 7\n";
    let text = "base: expert\nmap: square-5x5\n";
    assert_eq!(good(&[("main.yaml", text), ("configs/expert.yaml", own)]).view, 7);
}

#[test]
fn agent_sets_equal_the_recorded_ones() {
    let sets = |mode: &str| {
        let scenario = load(&Path::new(ROOT).join("configs").join(mode).with_extension("yaml"));
        let set = scenario.agent_set(Split::Test).expect("test").clone();
        let agent = |agent: AgentConfig| format!("{} {} {}", agent.name, agent.priority, agent.concepts.join("+"));
        set.agents().map(agent).collect::<Vec<_>>().join("; ")
    };
    assert_eq!(
        sets("easy"),
        "Car_1 1 ; Pedestrian_1 0 old; Pedestrian_2 0 ; Pedestrian_3 0 old; Pedestrian_4 0 ; Pedestrian_5 0 ; \
         Pedestrian_6 0 ; Car_2 2 ambulance; Car_3 3 ambulance; Car_4 5 ; Car_5 4 tiro; Car_6 6 ambulance; \
         Car_7 6 ambulance; Car_8 5 ; Car_9 4 tiro"
    );
    assert_eq!(
        sets("hard"),
        "Car_1 1 ; Pedestrian_1 0 ; Pedestrian_2 0 old; Pedestrian_3 0 old; Pedestrian_4 0 old; Pedestrian_5 0 old; \
         Pedestrian_6 0 old; Pedestrian_7 0 old; Pedestrian_8 0 ; Car_2 2 bus; Car_3 3 bus; Car_4 4 ; Car_5 5 police; \
         Car_6 6 police; Car_7 7 ambulance; Car_8 8 ambulance; Car_9 8 police; Car_10 8 "
    );
}

#[test]
fn observations_have_the_order_of_the_reference() {
    let order = |mode: &str| {
        let scenario = load(Path::new(mode));
        scenario
            .predicates
            .iter()
            .map(|predicate| predicate.name.value.clone())
            .collect::<Vec<_>>()
            .join(" ")
    };
    assert_eq!(
        order("easy"),
        "IsPedestrian IsCar IsAmbulance IsOld IsTiro IsAtInter IsInInter HigherPri CollidingClose Sees"
    );
    assert_eq!(
        order("medium"),
        "IsPedestrian IsCar IsAmbulance IsOld IsTiro IsBus IsAtInter IsInInter HigherPri CollidingClose NextTo RightOf Sees"
    );
    let full = "IsPedestrian IsCar IsAmbulance IsBus IsPolice IsTiro IsReckless IsOld IsYoung IsAtInter IsInInter IsClose \
                HigherPri CollidingClose LeftOf RightOf NextTo Sees";
    for mode in [
        "hard",
        "expert",
        "transfer-easy",
        "transfer-medium",
        "transfer-hard",
        "vap-easy",
        "vap-hard",
    ] {
        assert_eq!(order(mode), full);
    }
}

#[test]
fn values_are_those_of_the_reference() {
    let expert = load(Path::new("expert"));
    let definition = |scenario: &Scenario, name: &str| {
        let found = scenario
            .predicates
            .iter()
            .find(|predicate| predicate.name.value == name);
        found.expect("predicate").definition.clone()
    };
    let close = Distance {
        above: Some(12.0),
        at_least: None,
        below: None,
        at_most: Some(20.0),
    };
    let next = Distance {
        above: None,
        at_least: None,
        below: Some(12.0),
        at_most: None,
    };
    assert_eq!(definition(&expert, "IsClose"), close.into());
    assert_eq!(definition(&expert, "NextTo"), next.into());
    let colliding = |car_range, pedestrian_range| Colliding {
        car_range,
        pedestrian_range,
        angle: 0.1,
        pedestrian_chance: 0.5,
        same_cell_chance: 0.5,
    };
    assert_eq!(definition(&expert, "CollidingClose"), colliding(8.0, 3.0).into());
    assert_eq!(
        definition(&load(Path::new("vap-hard")), "CollidingClose"),
        colliding(11.0, 4.0).into()
    );
    let region = |scenario: &Scenario| {
        Split::ALL.map(|split| {
            scenario
                .agent_set(split)
                .and_then(|set| set.region.clone())
                .map(|region| region.value)
        })
    };
    let side = |side| Some(Region::Side(side));
    assert_eq!(region(&expert), [side(100), side(120), side(120)]);
    assert_eq!(region(&load(Path::new("vap-easy"))), [(); 3].map(|()| side(100)));
    assert_eq!((expert.trip_ends, expert.routing), (TripEnds::Curb, Routing::Weighted));
    for mode in ["vap-easy", "vap-hard"] {
        let scenario = load(Path::new(mode));
        assert_eq!((scenario.trip_ends, scenario.routing), (TripEnds::Lane, Routing::Hops));
    }
    assert_eq!(
        (expert.view, expert.ticks, expert.actions.default),
        (25, 300, Action::Normal)
    );
    assert_eq!(expert.actions.priority, Action::SAFEST_FIRST);
    assert_eq!(load(Path::new("vap-hard")).actions.priority, Action::STANDARD);
    let Buildings::Fixed(rows) = &expert.map.blocks().unwrap().buildings.value else {
        panic!("the paper's map has fixed buildings")
    };
    assert_eq!((rows.len(), rows[0].len()), (10, 10));
}

#[test]
fn a_user_changes_a_range_and_defines_a_concept_in_a_small_file() {
    let scenario = good(&[(
        "main.yaml",
        "base: configs/expert.yaml
predicates:
  define:
    IsClose: {distance: {at_most: 15}}
    IsTaxi: {concept: taxi, of: car}
agents:
  test:
    cars:
      - {priority: 1, concepts: [taxi]}
",
    )]);
    let names: Vec<_> = scenario
        .predicates
        .iter()
        .map(|predicate| predicate.name.value.as_str())
        .collect();
    assert_eq!(names[11], "IsClose");
    assert_eq!(names[17..], ["IsTaxi", "Sees"]);
    let close = Distance {
        above: Some(12.0),
        at_least: None,
        below: None,
        at_most: Some(15.0),
    };
    assert_eq!(scenario.predicates[11].definition, close.into());
    // A list replaces the list of the base; other keys stay.
    let set = scenario.agent_set(Split::Test).expect("test");
    assert_eq!(set.len(), 1 + 8);
    assert_eq!(set.agents().next().expect("a car").concepts[..], ["taxi"]);
    assert_eq!(scenario.rules.value, Path::new("<builtin>/rules/expert.dl"));
}

#[test]
fn null_removes_a_key_of_the_base() {
    let scenario = good(&[(
        "main.yaml",
        "base: configs/expert.yaml\nregion: ~\nagents: {train: ~}\n",
    )]);
    assert!(scenario.agent_set(Split::Train).is_none());
    assert!(scenario.agent_set(Split::Val).is_some_and(|set| set.region.is_none()));
}

#[test]
fn a_part_with_its_own_path_or_base_replaces_the_part_of_the_base() {
    let part = "train: {cars: [{priority: 1}]}\n";
    let by_path = good(&[
        ("main.yaml", "base: configs/expert.yaml\nagents: mine.yaml\n"),
        ("mine.yaml", part),
    ]);
    assert_eq!(by_path.splits.len(), 1);
    let by_base = "base: configs/expert.yaml\nagents: {base: mine.yaml}\n";
    assert_eq!(good(&[("main.yaml", by_base), ("mine.yaml", part)]).splits.len(), 1);
    let merged = "base: configs/expert.yaml\nagents: {train: {cars: [{priority: 1}]}}\n";
    assert_eq!(good(&[("main.yaml", merged)]).splits.len(), 3);
}

#[test]
fn the_hash_depends_on_content_and_not_on_files_places_or_names() {
    let one = good(&[("main.yaml", "base: configs/expert.yaml\nview: 30\n")]);
    let same = good(&[
        (
            "main.yaml",
            "# a comment\nview: 30\nbase: b.yaml\nagents: {base: configs/agents/expert.yaml}",
        ),
        ("b.yaml", "base: configs/expert.yaml\nview: 7\n"),
    ]);
    assert_eq!(one.hash.len(), 64);
    assert_eq!(one.hash, same.hash);
    let curb = good(&[("main.yaml", "base: configs/expert.yaml\nview: 30\ntrip_ends: curb\n")]);
    assert_eq!(one.hash, curb.hash);
    for change in ["view: 31", "view: 30\ntrip_ends: lane"] {
        let other = good(&[("main.yaml", &format!("base: configs/expert.yaml\n{change}\n"))]);
        assert_ne!(one.hash, other.hash, "{change}");
    }
    let modes = ["easy", "medium", "hard", "expert", "vap-easy"].map(|mode| load(Path::new(mode)).hash);
    assert!(
        modes
            .iter()
            .all(|hash| modes.iter().filter(|other| *other == hash).count() == 1)
    );
    // The rules have a separate hash.
    let ruled = good(&[("main.yaml", "base: configs/hard.yaml\nrules: rules/transfer-hard.dl\n")]);
    assert_eq!(load(Path::new("hard")).hash, ruled.hash);
}

/// Episodes, data sets and results name these hashes.
#[test]
fn modes_and_data_sets_keep_their_hashes() {
    for (name, hash) in [
        (
            "easy",
            "495361db6fd0ab9c4465d40e1a866570dbab3a09d63fcfe0c684539d16c00e6b",
        ),
        (
            "medium",
            "543a54d00de7e88ffa370fe72bbab814aaa61f953cce5dc4594267a0e1249c34",
        ),
        (
            "hard",
            "87ecf6800ee57a42547aef7d74f2169d2734f362c464f6db60d64a9996fb5e5f",
        ),
        (
            "expert",
            "c2231806ffc50353beca2b3efeff9d39765f4db5beb33eaacf6b82fb7834f0e8",
        ),
        (
            "transfer-easy",
            "82f274a57acc266ac4f0e3fcfd20f9a4af9786e1ba8f4d338b8214c31c8f6983",
        ),
        (
            "vap-easy",
            "7c4226cc733ae4bcde4f2c032c67554425967070aec97120656486445f5eae87",
        ),
        (
            "vap-hard",
            "7c4226cc733ae4bcde4f2c032c67554425967070aec97120656486445f5eae87",
        ),
    ] {
        assert_eq!(load(Path::new(name)).hash, hash, "{name}");
    }
}

#[test]
fn repeat_multiplies_an_agent_set() {
    let set = "test: {cars: [{priority: 1, concepts: [bus]}, {count: 2, priority: 2}], pedestrians: [{priority: 7}]";
    let scenario = |more: &str| {
        let text = format!("base: configs/expert.yaml\nagents: {{train: ~, val: ~, {set}{more}}}}}\n");
        good(&[("main.yaml", &text)])
    };
    let once = scenario("");
    let twice = scenario(", repeat: 2, trip: 30");
    let set = twice.agent_set(Split::Test).expect("test");
    assert_eq!(
        (set.repeat, set.trip.map(|trip| trip.value), set.len()),
        (2, Some(30), 8)
    );
    let agents: Vec<AgentConfig> = set.agents().collect();
    let listed: Vec<String> = agents
        .iter()
        .map(|agent| format!("{} {}", agent.name, agent.priority))
        .collect();
    let expected = "Car_1 1, Pedestrian_1 7, Pedestrian_2 7, Car_2 2, Car_3 2, Car_4 1, Car_5 2, Car_6 2";
    assert_eq!(listed.join(", "), expected);
    assert!(Arc::ptr_eq(&agents[0].concepts, &agents[5].concepts) && agents[5].concepts[..] == ["bus"]);
    let set = once.agent_set(Split::Test).expect("test");
    assert_eq!((set.repeat, set.trip.is_none(), set.len()), (1, true, 4));
    let hashes = [", repeat: 2", ", trip: 30", ", repeat: 1, trip: ~"].map(|more| scenario(more).hash);
    assert!(hashes[0] != once.hash && hashes[1] != once.hash && hashes[0] != hashes[1]);
    assert_eq!(hashes[2], once.hash);
}

#[test]
fn a_few_lines_configure_a_million_agents() {
    let scenario = load(Path::new("metropolis"));
    let set = scenario.agent_set(Split::Test).expect("test");
    assert_eq!(AgentKind::ALL.map(|kind| set.count(kind)), [555_560, 444_448]);
    let last = set.agents().last().expect("a million");
    assert_eq!((last.name.to_string().as_str(), last.priority), ("Car_555560", 10));
}

/// Reads built-in files only.
fn builtin_only(path: &Path) -> Result<String, ReadError> {
    match path.starts_with(BUILTIN_FOLDER) {
        true => BuiltinFiles.read(path),
        false => Err(ReadError::NotFound),
    }
}

#[test]
fn maps_are_found_by_path_and_by_name() {
    for name in ["square-5x5", "configs/maps/square-5x5.yaml"] {
        let mut sources = Sources::new();
        let map = load_map(&mut sources, Path::new(name), &builtin_only).expect("built in");
        assert_eq!(
            (map.name.as_str(), map.blocks().unwrap().blocks.value),
            ("square-5x5", [5, 5])
        );
    }
    let mut sources = Sources::new();
    let faults = load_map(&mut sources, Path::new("sqare-5x5"), &BuiltinFiles).expect_err("no such map");
    let rendered = rendered(&sources, &faults);
    assert!(
        rendered.contains("missing-file") && rendered.contains("did you mean `square-5x5`?"),
        "{rendered}"
    );
}

#[test]
fn cycles_of_bases_are_reported() {
    let rendered = bad(&[("main.yaml", "base: b.yaml\n"), ("b.yaml", "base: ./x/../main.yaml\n")]);
    assert!(
        rendered.contains("include-cycle") && rendered.contains("b.yaml:1:7"),
        "{rendered}"
    );
    let names: Vec<String> = (0..30).map(|n| format!("f{n}.yaml")).collect();
    let texts: Vec<String> = (0..30).map(|n| format!("base: f{}.yaml\n", n + 1)).collect();
    let mut files: Vec<_> = names
        .iter()
        .zip(&texts)
        .map(|(name, text)| (name.as_str(), text.as_str()))
        .collect();
    files.push(("main.yaml", "base: f0.yaml\n"));
    assert!(bad(&files).contains("limit-exceeded"));
}

#[test]
fn a_missing_base_is_the_only_fault() {
    let rendered = bad(&[("main.yaml", "base: b.yaml\nview: 3\n"), ("b.yaml", "base: c.yaml\n")]);
    assert!(
        rendered.contains("b.yaml:1:7") && rendered.matches("error[").count() == 1,
        "{rendered}"
    );
    let rendered = bad(&[(
        "main.yaml",
        "base: configs/expert.yaml\nagents: {base: nowhere.yaml}\nveiw: 3\n",
    )]);
    assert!(
        rendered.contains("missing-file") && rendered.contains("unknown-key"),
        "{rendered}"
    );
    assert_eq!(rendered.matches("error[").count(), 2, "{rendered}");
}

#[test]
fn a_wrong_letter_of_a_map_is_reported_at_its_place() {
    let map = "blocks: [1, 1]\nwidths: {street: 11, sidewalk: 5, building: 10, inner_sidewalk: 5}\nbuildings:\n  rows:\n    - OX\n    - H\n";
    let rendered = bad(&[
        ("main.yaml", "base: configs/expert.yaml\nmap: m.yaml\n"),
        ("m.yaml", map),
    ]);
    assert!(
        rendered.contains("m.yaml:5:8") && rendered.contains("`X` does not denote a building"),
        "{rendered}"
    );
    assert!(
        rendered.contains("m.yaml:6:7") && rendered.contains("expected 2 buildings"),
        "{rendered}"
    );
}

#[test]
fn built_in_files_are_the_files_of_the_folders() {
    fn walk(folder: &Path, files: &mut Vec<String>) {
        for entry in std::fs::read_dir(folder).into_iter().flatten() {
            let path = entry.expect("entry").path();
            if path.is_dir() {
                walk(&path, files);
            } else if path
                .extension()
                .is_some_and(|extension| extension == "dl" || extension == "yaml" || extension == "jsonl")
            {
                let path = path.strip_prefix(ROOT).expect("under the root");
                files.push(path.to_str().expect("UTF-8").replace('\\', "/"));
            }
        }
    }
    let mut files = Vec::new();
    for folder in ["configs", "rules"] {
        walk(&Path::new(ROOT).join(folder), &mut files);
    }
    files.sort();
    assert_eq!(builtin::paths(), files);
    assert_eq!(
        builtin::text("configs/expert.yaml"),
        read_text(&Path::new(ROOT).join("configs/expert.yaml")).ok().as_deref()
    );
}

#[test]
fn built_in_files_are_read_without_a_repository() {
    let same = |path: &str, builtin_path: &str| {
        assert_eq!(
            BuiltinFiles.read_or_builtin(Path::new(path)).ok().as_deref(),
            builtin::text(builtin_path),
            "{path}"
        );
    };
    same("<builtin>/rules/vocabulary.dl", "rules/vocabulary.dl");
    same("<builtin>/vocabulary.dl", "rules/vocabulary.dl");
    same("<builtin>/configs/expert.yaml", "configs/expert.yaml");
    assert_eq!(
        BuiltinFiles.read_or_builtin(Path::new("<builtin>/nothing.dl")),
        Err(ReadError::NotFound)
    );
    assert_eq!(
        BuiltinFiles.read_or_builtin(Path::new("vocabulary.dl")),
        Err(ReadError::NotFound)
    );
    // A built-in configuration refers to built-in files.
    let expert = load_scenario(&mut Sources::new(), Path::new("expert"), &builtin_only).expect("built in");
    same(expert.rules.value.to_str().expect("UTF-8"), "rules/expert.dl");
}

/// Loads a text as a run configuration and as a map, and renders the faults. Fails if that takes more than 20 s.
fn survive(text: &str) -> String {
    let start = Instant::now();
    let mut out = String::new();
    let mut sources = Sources::new();
    let read = |_: &Path| Ok(text.to_owned());
    let map = load_map(&mut sources, Path::new("map.yaml"), &read)
        .err()
        .unwrap_or_default();
    let (scenario_sources, scenario) = load_memory(&[("main.yaml", text)]);
    let scenario = scenario.err().unwrap_or_default();
    for (sources, faults) in [(&sources, &map), (&scenario_sources, &scenario)] {
        let differs = |(at, fault): &(usize, &Diagnostic)| !faults[..*at].iter().any(|known| known.repeats(fault));
        assert!(faults.iter().enumerate().filter(differs).count() <= MAX_FAULTS + 1);
        to_json(faults, sources);
        out.push_str(&rendered(sources, faults));
    }
    assert!(start.elapsed() < Duration::from_secs(20), "took {:?}", start.elapsed());
    out
}

#[test]
fn the_nesting_limit_counts_the_content_of_aliases() {
    let (open, close) = ("[".repeat(40), "]".repeat(40));
    let twice = format!("base: configs/expert.yaml\na: &a {open}x{close}\nb: {open}*a{close}\n");
    let rendered = bad(&[("main.yaml", &twice)]);
    assert!(
        rendered.contains("nested more than 64 deep") && rendered.contains("main.yaml:3:"),
        "{rendered}"
    );
}

#[test]
fn slow_hostile_files_fail_fast() {
    let mut laughs = String::from("a0: &a0 [x, x, x, x, x, x, x, x, x]\n");
    for level in 1..30 {
        let aliases = vec![format!("*a{}", level - 1); 9].join(", ");
        laughs.push_str(&format!("a{level}: &a{level} [{aliases}]\n"));
    }
    let chain: String = (1..10_000).map(|n| format!("a{n}: &a{n} [*a{}]\n", n - 1)).collect();
    let indented: String = (0..2000).map(|depth| format!("{}a:\n", " ".repeat(depth))).collect();
    let keys: String = (0..20_000).map(|n| format!("k{n}: 1\n")).collect();
    let cars = format!(
        "base: configs/expert.yaml\nagents: {{test: {{cars: [{}]}}}}",
        "{concepts: [tax]},".repeat(40_000)
    );
    let crowd = "base: configs/expert.yaml\nagents: {test: {cars: [{priority: 1, count: 1000000}, {priority: 1, count: 1000000}]}}";
    let random: String = {
        let mut state = 12345u64;
        let mut next = || {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            char::from(32 + (state % 95) as u8)
        };
        (0..2_000_000).map(|_| next()).collect()
    };
    let cases: [(&str, String, &str); 22] = [
        ("open brackets", "[".repeat(100_000), "limit-exceeded"),
        (
            "closed brackets",
            "[".repeat(100_000) + &"]".repeat(100_000),
            "limit-exceeded",
        ),
        ("braces", "{a: ".repeat(100_000), "limit-exceeded"),
        ("dashes", "- ".repeat(100_000), "limit-exceeded"),
        ("questions", "? ".repeat(100_000), "limit-exceeded"),
        ("indentation", indented, "limit-exceeded"),
        ("billion laughs", laughs, "limit-exceeded"),
        ("alias chain", String::from("a0: &a0 x\n") + &chain, "limit-exceeded"),
        ("alias of itself", "a: &a [*a]".into(), "yaml-syntax"),
        (
            "huge number",
            format!("base: configs/expert.yaml\nview: {}", "9".repeat(100_000)),
            "invalid-value",
        ),
        (
            "endless number",
            "base: configs/expert.yaml\nview: .inf".into(),
            "invalid-value",
        ),
        ("NUL", "view: 25\n\0ticks: 3\n".into(), "yaml-syntax"),
        ("NUL in a comment", "view: 25 # \0\nticks: 3\n".into(), "yaml-syntax"),
        ("tab", "map:\n\tblocks: 3\n".into(), "yaml-syntax"),
        ("two documents", "view: 25\n---\nticks: 3\n".into(), "yaml-syntax"),
        (
            "tag",
            "base: configs/expert.yaml\nview: !!python/object 25\n".into(),
            "invalid-value",
        ),
        ("empty", String::new(), "invalid-value"),
        ("list as key", "[a, b]: 3".into(), "invalid-value"),
        ("many unknown keys", keys, "the others are not shown"),
        ("many unknown concepts", cars, "unknown concept"),
        ("crowd", crowd.into(), "limit-exceeded"),
        ("long line of garbage", random, "yaml-syntax"),
    ];
    for (name, text, expected) in cases {
        let start = Instant::now();
        let rendered = survive(&text);
        println!("{name}: {:?}", start.elapsed());
        assert!(
            rendered.contains(expected),
            "{name}: {}",
            rendered.chars().take(2000).collect::<String>()
        );
    }
    assert!(survive(&"- 1\n".repeat(1_000_000)).contains("more than 200000 values"));
    assert!(survive(&"\n".repeat(10_000_000)).contains("has 10000000 bytes"));
}

/// Text close to a configuration: pieces of real ones in any order.
fn near_yaml() -> impl Strategy<Value = String> {
    let piece = prop_oneof![
        Just("base: configs/expert.yaml\n".to_owned()),
        "(map|agents|predicates|define|use|region|train|cars|concepts|count|rows|random)",
        "(: |:\n  |:\n|\n|\n  |\n    - |- |, |\\[|\\]|\\{|\\}|~|&a |\\*a|\"|'|#|\\||>|\\?|!t |\t|---|%)",
        "(-?[0-9]{1,20}|0\\.5|[a-zA-Zé]{1,4})",
    ];
    proptest::collection::vec(piece, 0..60).prop_map(|pieces| pieces.concat())
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..cases(300) })]

    #[test]
    fn any_bytes_load_without_a_panic(bytes in proptest::collection::vec(any::<u8>(), 0..400)) {
        survive(&String::from_utf8_lossy(&bytes));
    }

    #[test]
    fn text_close_to_yaml_loads_without_a_panic(text in near_yaml()) {
        survive(&text);
    }

    #[test]
    fn mutated_built_in_files_load_without_a_panic(
        file in any::<prop::sample::Index>(),
        edits in proptest::collection::vec((any::<prop::sample::Index>(), 0..4usize, "[ -~\n\téß]{0,6}"), 1..6),
    ) {
        let paths = builtin::paths();
        let path = file.get(&paths);
        let text = builtin::text(path).expect("listed");
        let mut text: Vec<char> = text.chars().collect();
        for (at, removed, added) in edits {
            let at = at.index(text.len() + 1);
            let end = (at + removed).min(text.len());
            text.splice(at..end, added.chars());
        }
        let text: String = text.into_iter().collect();
        survive(&text);
        // Also as part of another configuration.
        let main = format!("base: {path}\n");
        let kind = path.split('/').nth(1).unwrap_or_default();
        let main = match kind {
            "agents" | "predicates" => format!("base: configs/expert.yaml\n{kind}: {path}\n"),
            "maps" => format!("base: configs/expert.yaml\nmap: {path}\n"),
            _ => main,
        };
        let (sources, result) = load_memory(&[("main.yaml", &main), (path, &text)]);
        rendered(&sources, &result.err().unwrap_or_default());
    }
}

#[test]
fn blocks_of_the_reference_load_or_give_the_faults_they_expect() {
    let mut count = 0;
    let pages = pages();
    let blocks = pages
        .iter()
        .flat_map(|(page, text)| blocks(text).into_iter().map(move |block| (page, block)));
    for (page, block) in blocks.filter(|(_, block)| block.kind == "yaml") {
        let place = format!("{}:{}", page.display(), block.line);
        let block = block.text.as_str();
        let kind = block
            .lines()
            .next()
            .and_then(|line| line.split_once(": "))
            .map(|(_, kind)| kind);
        let (name, main) = match kind {
            Some("a run configuration") => ("main.yaml", None),
            Some("a map") => ("map.yaml", Some("base: configs/expert.yaml\nmap: map.yaml\n")),
            Some("agent sets") => ("agents.yaml", Some("base: configs/expert.yaml\nagents: agents.yaml\n")),
            Some("predicates") => (
                "predicates.yaml",
                Some("base: configs/expert.yaml\npredicates: predicates.yaml\n"),
            ),
            _ => panic!("{place}: the first line must name the kind of the block:\n{block}"),
        };
        let mut files = vec![(name, block)];
        files.extend(main.map(|main| ("main.yaml", main)));
        let (sources, result) = load_memory(&files);
        let faults = result.err().unwrap_or_default();
        assert_eq!(
            found(&sources, &faults),
            expected(block),
            "{place}:\n{block}\n{}",
            rendered(&sources, &faults)
        );
        count += 1;
    }
    assert!(count >= 7, "{count}");
    println!("{count} blocks of configurations load");
}

#[test]
fn every_configuration_fixture_has_a_code() {
    let codes = || {
        [
            diag::codes::CODES,
            yaml::codes::CODES,
            config::codes::CODES,
            city::codes::CODES,
            sim::codes::CODES,
        ]
        .into_iter()
        .flatten()
    };
    for name in FIXTURES {
        assert!(codes().any(|code| code.name() == name));
    }
}
