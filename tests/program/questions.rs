//! Language questions in the files that the program writes: answers follow from the text alone, and the sets are
//! balanced.

use logicity::city::Split;
use logicity::render::read_png;
use logicity::rng::Seed;
use logicity::sim::{Settings, Simulation};
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io::Write;
use std::process::{Command, Output, Stdio};
use std::sync::Arc;

const CONFIGS: [&str; 2] = ["vap-easy", "vap-hard"];
const LETTERS: [&str; 4] = ["A", "B", "C", "D"];
const ACTIONS: [&str; 4] = ["Slow", "Normal", "Fast", "Stop"];

fn run(arguments: &[&str], input: &str) -> Output {
    let mut process = Command::new(env!("CARGO_BIN_EXE_logicity"))
        .args(arguments)
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut stdin = process.stdin.take().unwrap();
    let input = input.to_owned();
    let writer = std::thread::spawn(move || drop(stdin.write_all(input.as_bytes())));
    let output = process.wait_with_output().unwrap();
    writer.join().unwrap();
    output
}

fn text(arguments: &[&str]) -> String {
    let output = run(&[&["questions"], arguments].concat(), "");
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success(), "{said}");
    String::from_utf8(output.stdout).unwrap()
}

fn questions(arguments: &[&str]) -> Vec<Value> {
    text(arguments)
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect()
}

fn string(value: &Value) -> &str {
    value.as_str().unwrap()
}

/// Adds an atom such as `, Sees(Entity_1, Entity_2)` to the facts of its predicate.
fn add_atom<'a>(facts: &mut BTreeMap<&'a str, Vec<Vec<&'a str>>>, atom: &'a str) {
    let atom = atom.trim_start_matches(", ").trim_end_matches(')');
    let (name, arguments) = atom.split_once('(').unwrap();
    let rows = facts.get_mut(name).expect("a listed predicate");
    rows.push(arguments.split(", ").collect());
}

/// Parses the text of a question as a scene, as an evaluated model must.
fn read(question: &str) -> Value {
    let line = |prefix: &str| {
        let rest = question.lines().find_map(|line| line.strip_prefix(prefix));
        rest.unwrap_or_else(|| panic!("no line `{prefix}..` in:\n{question}"))
    };
    let entities = line("A scene with ").split_once(": ").unwrap().1;
    let entities: Vec<&str> = entities.trim_end_matches('.').split(", ").collect();
    let predicates = line("Predicates and their arities: ").trim_end_matches('.');
    let mut facts: BTreeMap<&str, Vec<Vec<&str>>> = predicates
        .split(", ")
        .map(|predicate| (predicate.split_once('/').unwrap().0, Vec::new()))
        .collect();
    let (_, listed) = question.split_once("(all others are false):\n").unwrap();
    for atom in listed
        .lines()
        .filter(|line| line.ends_with(')'))
        .flat_map(|line| line.split_inclusive(')'))
    {
        add_atom(&mut facts, atom);
    }
    let ego = line("Which action does ").strip_suffix(" take next?").unwrap();
    json!({"entities": entities, "ego": ego, "facts": facts})
}

/// Parses a question in the words of the paper's figure as a scene. There, `Sees` omits that entities see themselves.
fn read_paper(question: &str) -> Value {
    let between = |before: &str, after: &str| {
        let rest = question
            .split_once(before)
            .unwrap_or_else(|| panic!("no `{before}` in:\n{question}"))
            .1;
        rest.split_once(after)
            .unwrap_or_else(|| panic!("no `{after}` in:\n{question}"))
            .0
    };
    let entities: Vec<&str> = between("they are named as follows: ", ". There exist")
        .split(", ")
        .collect();
    assert_eq!(
        between("In the scene you see a total of ", " entities, "),
        entities.len().to_string()
    );
    let predicates = between("as their attributes and relations: ", ". The truth value");
    let mut facts: BTreeMap<&str, Vec<Vec<&str>>> = predicates
        .split("), ")
        .map(|predicate| (predicate.split_once(" (arity: ").unwrap().0, Vec::new()))
        .collect();
    let listed = between("provided, assume the rest are False): ", ". What is the next action");
    for atom in listed.split_inclusive(')') {
        add_atom(&mut facts, atom);
    }
    let sees = facts.get_mut("Sees").unwrap();
    assert!(sees.iter().all(|row| row[0] != row[1]), "{question}");
    sees.extend(entities.iter().map(|entity| vec![*entity, *entity]));
    let number = |row: &Vec<&str>| -> Vec<usize> { row.iter().map(|name| name[7..].parse().unwrap()).collect() };
    sees.sort_by_key(number);
    let ego = between("What is the next action of entity ", "?");
    json!({"entities": entities, "ego": ego, "facts": facts})
}

/// The words of the predicates of the shipped configurations.
const WORDS: [(&str, &str); 18] = [
    ("IsPedestrian", "is a pedestrian"),
    ("IsCar", "is a car"),
    ("IsAmbulance", "is an ambulance"),
    ("IsBus", "is a bus"),
    ("IsPolice", "is a police car"),
    ("IsTiro", "has a beginner at the wheel"),
    ("IsReckless", "is driven recklessly"),
    ("IsOld", "is old"),
    ("IsYoung", "is young"),
    ("IsAtInter", "is at the edge of an intersection"),
    ("IsInInter", "is inside an intersection"),
    ("IsClose", "is more than 12 and at most 20 cells away from"),
    ("HigherPri", "has priority over"),
    ("CollidingClose", "is about to run into"),
    ("LeftOf", "is to the left of"),
    ("RightOf", "is to the right of"),
    ("NextTo", "is less than 12 cells away from"),
    ("Sees", "sees"),
];

/// Parses the sentences of a question as a scene, as a person would.
fn read_sentences(question: &str) -> Value {
    let lines: Vec<&str> = question.lines().collect();
    let [general, scene, agents @ .., ask] = &lines[..] else {
        panic!("no scene in:\n{question}")
    };
    assert!(
        general.contains("1 cell (Slow), 2 cells (Normal), 3 cells (Fast) or 0 cells (Stop)"),
        "{general}"
    );
    assert!(general.contains("Every agent sees itself."), "{general}");
    let plural = if agents.len() == 1 { "" } else { "s" };
    assert_eq!(
        *scene,
        format!(
            "A scene with {} agent{plural}. What is not stated is false.",
            agents.len()
        )
    );
    let name = |line: &str| line.split(' ').take(2).collect::<Vec<_>>().join(" ");
    let names: Vec<String> = agents.iter().map(|line| name(line)).collect();
    let place = |name: &str| {
        names
            .iter()
            .position(|known| known == name)
            .expect("an agent of the scene")
    };
    let mut facts: BTreeMap<&str, Vec<Vec<usize>>> = WORDS.iter().map(|(name, _)| (*name, Vec::new())).collect();
    let predicate = |words: &str| WORDS.iter().find(|(_, known)| *known == words).map(|(name, _)| *name);
    for (agent, line) in agents.iter().enumerate() {
        facts.get_mut("Sees").unwrap().push(vec![agent, agent]);
        let sentences = line.trim_end_matches('.').split(". ");
        for (number, sentence) in sentences.enumerate() {
            let said = sentence.strip_prefix(&names[agent]).unwrap().trim_start();
            if number == 0 {
                for words in said.split(", ").flat_map(|part| part.split(" and ")) {
                    let predicate = predicate(words).unwrap_or_else(|| panic!("`{words}` in: {line}"));
                    facts.get_mut(predicate).unwrap().push(vec![agent]);
                }
                continue;
            }
            // The longest verb that fits: names begin with a capital letter.
            let verb = said.find(|letter: char| letter.is_uppercase()).unwrap();
            let predicate = predicate(said[..verb].trim_end()).unwrap_or_else(|| panic!("`{said}` in: {line}"));
            for other in said[verb..].split(", ").flat_map(|part| part.split(" and ")) {
                facts.get_mut(predicate).unwrap().push(vec![agent, place(other)]);
            }
        }
    }
    let entity = |place: &usize| format!("Entity_{place}");
    let facts = facts.into_iter().map(|(name, mut rows)| {
        rows.sort();
        let rows: Vec<Vec<String>> = rows.iter().map(|row| row.iter().map(entity).collect()).collect();
        (name.to_owned(), json!(rows))
    });
    let ego = ask
        .strip_prefix("Which action does ")
        .unwrap()
        .strip_suffix(" take next?")
        .unwrap();
    json!({
        "entities": (0..names.len()).map(|place| entity(&place)).collect::<Vec<_>>(),
        "ego": entity(&place(ego)),
        "facts": facts.collect::<serde_json::Map<_, _>>(),
    })
}

/// The decisions of `logicity infer`, as letters.
fn inferred(config: &str, scenes: &[Value]) -> Vec<&'static str> {
    let lines: String = scenes.iter().map(|scene| format!("{scene}\n")).collect();
    let output = run(&["infer", "--config", config], &lines);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let answers = String::from_utf8(output.stdout).unwrap();
    let answers = answers.lines().zip(scenes).map(|(line, scene)| {
        let answer: Value = serde_json::from_str(line).unwrap();
        let action = string(&answer["egos"][string(&scene["ego"])]["action"]);
        LETTERS[ACTIONS.iter().position(|known| *known == action).unwrap()]
    });
    let answers: Vec<&str> = answers.collect();
    assert_eq!(answers.len(), scenes.len());
    answers
}

fn shares(questions: &[Value]) -> [usize; 4] {
    LETTERS.map(|letter| questions.iter().filter(|question| question["answer"] == letter).count())
}

#[test]
fn slow_every_answer_follows_from_the_text() {
    let sets = [
        ("vap-easy", &["--seed", "1"][..]),
        ("vap-hard", &["--seed", "2"]),
        ("vap-hard", &["--seed", "3", "--count", "100", "--entities", "city"]),
        (
            "expert",
            &["--seed", "4", "--count", "200", "--split", "val", "--shots", "10"],
        ),
        ("vap-easy", &["--seed", "5", "--count", "200", "--style", "words"]),
        (
            "vap-hard",
            &[
                "--seed",
                "8",
                "--count",
                "100",
                "--style",
                "paper",
                "--entities",
                "city",
                "--mix",
                "paper",
            ],
        ),
        ("vap-hard", &["--seed", "6", "--style", "words"]),
        (
            "expert",
            &[
                "--seed",
                "7",
                "--count",
                "200",
                "--style",
                "words",
                "--entities",
                "city",
            ],
        ),
    ];
    for (config, arguments) in sets {
        let questions = questions(&[&[config], arguments].concat());
        let first = &questions[0];
        let shown = first["demonstrations"].as_array().unwrap();
        let all = || questions.iter().chain(shown);
        let words = arguments.contains(&"words");
        let parse = match arguments.contains(&"paper") {
            true => read_paper,
            false if words => read_sentences,
            false => read,
        };
        let scenes: Vec<Value> = all().map(|question| parse(string(&question["question"]))).collect();
        let wanted: Vec<&str> = all().map(|question| string(&question["answer"])).collect();
        assert_eq!(inferred(config, &scenes), wanted, "{config}");
        for question in all() {
            let letter = LETTERS.iter().position(|letter| question["answer"] == *letter).unwrap();
            assert_eq!(question["action"], ACTIONS[letter]);
        }
        // The structured scene equals the text.
        let given: Vec<Value> = questions.iter().map(|question| question["scene"].clone()).collect();
        assert_eq!(inferred(config, &given), wanted[..questions.len()]);
        for (given, read) in given.iter().zip(&scenes) {
            assert_eq!([&given["entities"], &given["ego"]], [&read["entities"], &read["ego"]]);
            for (predicate, rows) in read["facts"].as_object().unwrap() {
                let bracketed = |row: &Value| if row.is_array() { row.clone() } else { json!([row]) };
                let given: Vec<Value> = given["facts"][predicate]
                    .as_array()
                    .unwrap()
                    .iter()
                    .map(bracketed)
                    .collect();
                assert_eq!(json!(given), *rows, "{predicate}");
            }
        }
        for question in &questions {
            assert_eq!(string(&question["id"]).contains("-words-"), words);
            assert_eq!(
                [&question["demonstrations"], &question["system"]],
                [&first["demonstrations"], &first["system"]]
            );
            assert_eq!(
                question["options"],
                json!({"A": "Slow", "B": "Normal", "C": "Fast", "D": "Stop"})
            );
        }
    }
}

/// A pseudorandom letter, independent of the answers.
fn guess(number: usize) -> &'static str {
    let mixed = (number as u64 + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    LETTERS[(mixed >> 62) as usize]
}

#[test]
fn slow_sets_are_balanced_and_without_repetition() {
    for config in CONFIGS {
        let questions = questions(&[config, "--seed", "5"]);
        let (count, shares) = (questions.len(), shares(&questions));
        // The rules of easy mode never derive Fast.
        let expected = if config == "vap-easy" {
            [334, 333, 0, 333]
        } else {
            [250; 4]
        };
        assert_eq!((count, shares), (1000, expected), "{config}");
        let guessed = (0..count)
            .filter(|&number| questions[number]["answer"] == guess(number))
            .count();
        // Four standard deviations of a binomial distribution with probability 1/4: 55.
        assert!(guessed.abs_diff(count / 4) < 55, "{guessed} of {count}");

        let shown = questions[0]["demonstrations"].as_array().unwrap();
        assert_eq!(shown.len(), 5);
        let options =
            |list: &[Value]| -> BTreeSet<String> { list.iter().map(|one| one["answer"].to_string()).collect() };
        assert_eq!(options(shown), options(&questions));
        let texts: BTreeSet<&str> = questions
            .iter()
            .chain(shown)
            .map(|question| string(&question["question"]))
            .collect();
        assert_eq!(texts.len(), count + shown.len());
        let ids: BTreeSet<&str> = questions.iter().map(|question| string(&question["id"])).collect();
        assert_eq!(ids.len(), count);

        let shown: Vec<Value> = shown.iter().map(|shown| read(string(&shown["question"]))).collect();
        let asked: Vec<Value> = questions.iter().map(|question| question["scene"].clone()).collect();
        let compositions: BTreeSet<_> = shown.iter().map(composition).collect();
        assert!(asked.iter().all(|scene| !compositions.contains(&composition(scene))));
        // No two questions are equal up to renaming: where the test can try all renamings, none maps one to the other.
        let small = shown
            .iter()
            .chain(&asked)
            .filter(|scene| scene["entities"].as_array().unwrap().len() <= 5);
        let small: Vec<String> = small.map(first_of_all_renamings).collect();
        assert!(small.len() > 200, "{}", small.len());
        assert_eq!(small.iter().collect::<BTreeSet<_>>().len(), small.len());
    }
}

/// The predicates of type and concepts.
const STEADY: [&str; 9] = [
    "IsPedestrian",
    "IsCar",
    "IsAmbulance",
    "IsBus",
    "IsPolice",
    "IsTiro",
    "IsReckless",
    "IsOld",
    "IsYoung",
];

/// The kinds of the entities, independent of their order.
fn composition(scene: &Value) -> Vec<Vec<String>> {
    let is = |entity: &Value, predicate: &str| {
        let rows = scene["facts"][predicate].as_array().unwrap();
        rows.iter().any(|row| row == entity || *row == json!([entity]))
    };
    let entities = scene["entities"].as_array().unwrap().iter();
    let mut all: Vec<Vec<String>> = entities
        .map(|entity| {
            STEADY
                .iter()
                .filter(|name| is(entity, name))
                .map(|name| (*name).to_owned())
                .collect()
        })
        .collect();
    all.sort();
    all
}

/// The smallest text of a scene under all orders of its entities.
fn first_of_all_renamings(scene: &Value) -> String {
    let entities: Vec<&str> = scene["entities"].as_array().unwrap().iter().map(string).collect();
    let facts = scene["facts"].as_object().unwrap();
    let mut orders = vec![Vec::new()];
    for place in 0..entities.len() {
        let longer = |order: Vec<usize>| {
            (0..=place).map(move |at| {
                let mut order = order.clone();
                order.insert(at, place);
                order
            })
        };
        orders = orders.into_iter().flat_map(longer).collect();
    }
    let renamed = |order: Vec<usize>| {
        let place = |name: &Value| order[entities.iter().position(|entity| name == entity).unwrap()];
        let mut atoms: Vec<(&str, Vec<usize>)> = Vec::new();
        for (predicate, rows) in facts {
            for row in rows.as_array().unwrap() {
                let names = row
                    .as_array()
                    .map_or_else(|| vec![place(row)], |names| names.iter().map(place).collect());
                atoms.push((predicate, names));
            }
        }
        atoms.sort();
        format!("{} {atoms:?}", place(&scene["ego"]))
    };
    orders.into_iter().map(renamed).min().unwrap()
}

#[test]
fn the_small_set_asks_about_tiro_and_reckless_cars() {
    let questions = questions(&["--mini"]);
    assert_eq!((questions.len(), shares(&questions)), (117, [30, 29, 29, 29]));
    for question in &questions {
        let ego = &question["scene"]["ego"];
        let carries = |predicate: &str| question["scene"]["facts"][predicate].as_array().unwrap().contains(ego);
        assert!(carries("IsTiro") || carries("IsReckless"));
    }
}

/// The predicates of type and concepts of the car of a question.
fn concepts(question: &Value) -> Vec<String> {
    let scene = &question["scene"];
    let carried = STEADY.iter().filter(|name| {
        let rows = scene["facts"][**name].as_array().unwrap();
        rows.contains(&scene["ego"])
    });
    carried.map(|name| (*name).to_owned()).collect()
}

/// How many questions the best guess gets right that depends only on the concepts of the car.
fn best_guess_by_concepts(questions: &[Value]) -> usize {
    let mut groups: BTreeMap<Vec<String>, Vec<Value>> = BTreeMap::new();
    for question in questions {
        groups.entry(concepts(question)).or_default().push(question.clone());
    }
    groups
        .values()
        .map(|group| shares(group).into_iter().max().unwrap())
        .sum()
}

#[test]
fn the_papers_mix_has_its_proportions() {
    let paper = questions(&["--mini", "--mix", "paper"]);
    assert_eq!(shares(&paper), [20, 42, 25, 30]);
    assert_eq!(shares(&questions(&["--count", "8", "--mix", "paper"])), [1, 3, 2, 2]);
    // The examples are balanced in every mix, and the same.
    assert_eq!(paper[0]["demonstrations"], questions(&["--mini"])[0]["demonstrations"]);
    assert!(
        string(&paper[0]["id"]).starts_with("vap-hard-test-0-paper-mix-"),
        "{}",
        paper[0]["id"]
    );
}

#[test]
fn slow_concepts_do_not_help_to_guess_in_a_mix_by_concept() {
    // Usually, the words for the driver determine more than half of the answers.
    let equal = questions(&["--mini"]);
    assert_eq!(best_guess_by_concepts(&equal), 59);
    for seed in ["0", "1", "2"] {
        let mini = questions(&["--mini", "--mix", "by-concept", "--seed", seed]);
        // Beginners never have to drive fast, and the reckless never slowly.
        assert_eq!(shares(&mini), [19, 40, 19, 39]);
        assert_eq!(best_guess_by_concepts(&mini), 40);
        let all = questions(&["--count", "300", "--mix", "by-concept", "--seed", seed]);
        assert_eq!(best_guess_by_concepts(&all), shares(&all).into_iter().max().unwrap());
        let mut sizes: BTreeMap<Vec<String>, usize> = BTreeMap::new();
        all.iter()
            .for_each(|question| *sizes.entry(concepts(question)).or_default() += 1);
        // Six kinds of cars, equally often.
        assert_eq!(sizes.into_values().collect::<Vec<_>>(), [50; 6]);
    }
}

#[test]
fn the_papers_prompt_has_the_words_of_its_figure() {
    let questions = questions(&["--count", "4", "--style", "paper", "--entities", "city"]);
    let question = &questions[0];
    assert_eq!(
        question["system"],
        "You are an expert in First-Order-Logic (FOL) Rule induction, the following question-answers are FOL reasoning \
         examples. Here are 5 demonstrations:"
    );
    assert_eq!(
        question["closing"],
        "Now try your best to first identify the FOL rules from the examples above and then answer the following \
         question. Your answer should strictly end with the format of single letter: 'Answer: _.'"
    );
    let text = string(&question["question"]);
    assert!(
        text.starts_with(
            "In the scene you see a total of 14 entities, they are named as follows: Entity_0, Entity_1, Entity_2, \
             Entity_3, Entity_4, Entity_5, Entity_6, Entity_7, Entity_8, Entity_9, Entity_10, Entity_11, Entity_12, \
             Entity_13. There exist the following predicates as their attributes and relations: IsPedestrian (arity: \
             1), IsCar (arity: 1), IsAmbulance (arity: 1), IsBus (arity: 1), IsPolice (arity: 1), IsTiro (arity: 1), \
             IsReckless (arity: 1), IsOld (arity: 1), IsYoung (arity: 1), IsAtInter (arity: 1), IsInInter (arity: 1), \
             IsClose (arity: 2), HigherPri (arity: 2), CollidingClose (arity: 2), LeftOf (arity: 2), RightOf (arity: \
             2), NextTo (arity: 2), Sees (arity: 2). The truth value of these predicates grounded to the entities are \
             as follows (Only the ones that are True are provided, assume the rest are False): IsPedestrian("
        ),
        "{text}"
    );
    assert!(
        text.contains("). What is the next action of entity Entity_") && text.ends_with('?'),
        "{text}"
    );
    assert_eq!(question["version"], 3);
}

#[test]
fn slow_pictures_show_the_scene_and_mark_the_car() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("seen.jsonl");
    let arguments = [
        "--count",
        "12",
        "--style",
        "picture",
        "--seed",
        "4",
        "--output",
        file.to_str().unwrap(),
    ];
    let said = text(&arguments);
    assert!(
        said.contains("wrote 17 pictures to ") && said.contains("seen-pictures\n"),
        "{said}"
    );
    let seen: Vec<Value> = (fs::read_to_string(&file).unwrap().lines())
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    let listed = questions(&["--count", "12", "--seed", "4"]);
    let pairs = |set: &[Value]| -> Vec<Value> {
        let shown = set[0]["demonstrations"].as_array().unwrap();
        set.iter().chain(shown).cloned().collect()
    };
    let mut names = BTreeSet::new();
    for (seen, listed) in pairs(&seen).iter().zip(pairs(&listed)) {
        // The same questions, in another form.
        assert_eq!([&seen["scene"], &seen["answer"]], [&listed["scene"], &listed["answer"]]);
        let name = string(&seen["picture"]);
        names.insert(name.to_owned());
        let picture = read_png(&fs::read(folder.path().join(name)).unwrap()).unwrap();
        let marked = picture
            .pixels()
            .as_chunks::<3>()
            .0
            .iter()
            .filter(|rgb| **rgb == [0xc8, 0x1e, 0xb4]);
        // A frame around a car of 48 pixels, two pixels wide.
        assert!((200..1000).contains(&marked.count()), "{name}");
        // The text has only what the picture cannot show, which it would have in sentences, too.
        let text = string(&seen["question"]);
        let words: Vec<&str> = text.lines().skip(3).collect();
        let (ask, told) = words.split_last().unwrap();
        assert!(ask.starts_with("Which action does Car "), "{text}");
        let facts = seen["scene"]["facts"].as_object().unwrap();
        let told: usize = told
            .iter()
            .flat_map(|line| line.split_inclusive('.'))
            .map(|sentence| {
                let said = [" has priority over ", " is about to run into "];
                assert!(said.iter().any(|verb| sentence.contains(verb)), "{sentence}");
                1 + sentence.matches(" and ").count() + sentence.matches(", ").count()
            })
            .sum();
        let rows = |name: &str| facts[name].as_array().unwrap().len();
        assert_eq!(told, rows("HigherPri") + rows("CollidingClose"), "{text}");
    }
    assert_eq!(names.len(), 17);
    // The same seed gives the same pictures, and the command replaces its own files.
    let name = folder.path().join(names.first().unwrap());
    let before = fs::read(&name).unwrap();
    text(&arguments);
    assert_eq!(fs::read(&name).unwrap(), before);
}

#[test]
fn a_question_names_its_source() {
    let questions = questions(&["expert", "--count", "40"]);
    let world = crate::shipped_world::world("expert", None, |_| ());
    for question in questions {
        let source = &question["source"];
        assert_eq!(
            [&source["config"], &source["split"], &source["seed"]],
            [&json!("expert"), &json!("test"), &json!(0)]
        );
        assert_eq!(source["config_hash"], world.scenario.hash);
        let seed = Seed(source["world"].as_u64().unwrap());
        let mut city = Simulation::new(Arc::clone(&world), Split::Test, seed, Settings::default()).unwrap();
        for _ in 0..=source["tick"].as_u64().unwrap() {
            city.tick(&[]).unwrap();
        }
        let agent = city
            .agents()
            .iter()
            .position(|agent| source["agent"] == agent.name().to_string())
            .unwrap();
        assert_eq!(question["action"], city.report().agents[agent].action.name());
    }
}

#[test]
fn the_same_seed_gives_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let [file, table, shown] = ["q.jsonl", "q.csv", "shown.csv"].map(path);
    let arguments = ["vap-hard", "--count", "60", "--seed", "9"];
    let printed = text(&arguments);
    assert_eq!(printed, text(&arguments));
    assert_ne!(printed, text(&["vap-hard", "--count", "60", "--seed", "10"]));
    let files = ["--output", &file, "--csv", &table, "--demonstrations-csv", &shown];
    let summary = text(&[&arguments[..], &files].concat());
    assert_eq!(
        summary,
        format!(
            "wrote {table}\nwrote {shown}\nwrote 60 questions to {file}: Slow 15, Normal 15, Fast 15, Stop 15\nbest guess: 15 \
             of 60 right with one answer for all cars, {} with one for each concept\n",
            best_guess_by_concepts(&questions(&arguments))
        )
    );
    assert_eq!(fs::read_to_string(&file).unwrap(), printed);

    let questions: Vec<Value> = printed
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    let rows = |list: &[Value]| -> String {
        let row = |one: &Value| {
            format!(
                "\"{}\",Slow,Normal,Fast,Stop,{}\n",
                string(&one["question"]),
                string(&one["answer"])
            )
        };
        list.iter().map(row).collect()
    };
    assert_eq!(fs::read_to_string(&table).unwrap(), rows(&questions));
    assert_eq!(
        fs::read_to_string(&shown).unwrap(),
        rows(questions[0]["demonstrations"].as_array().unwrap())
    );
}

#[test]
fn without_demonstrations_no_text_mentions_them() {
    let questions = questions(&["vap-easy", "--count", "30", "--shots", "0", "--demonstrations", "test"]);
    assert_eq!(questions[0]["demonstrations"], json!([]));
    assert!(!string(&questions[0]["system"]).contains("explain"));
}

#[test]
fn slow_impossible_requests_are_errors() {
    let refused = |arguments: &[&str], exit: i32, words: &[&str]| {
        let output = run(&[&["questions"], arguments].concat(), "");
        let said = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(exit), "{said}");
        assert!(output.stdout.is_empty() && !said.contains("panicked"), "{said}");
        for word in words {
            assert!(said.contains(word), "`{word}` is missing in:\n{said}");
        }
    };
    refused(&["nowhere"], 2, &["nowhere"]);
    refused(&["--count", "0"], 2, &["an integer from 1 to 20000"]);
    refused(&["--mini", "--count", "3"], 2, &["--mini"]);
    refused(&["--shots", "3"], 2, &["invalid-value", "Slow, Normal, Fast, Stop"]);
    refused(&["--split", "train"], 2, &["invalid-value", "the same agents"]);
    refused(
        &["vap-easy", "--mix", "paper"],
        2,
        &["never require Fast", "`--mix equal`"],
    );
    refused(
        &["--style", "paper", "--shots", "0"],
        2,
        &["the paper's prompt has solved examples"],
    );
    refused(
        &["--style", "paper", "--prompt", "why"],
        2,
        &["does not state the rules"],
    );
    refused(&["--style", "picture"], 2, &["name a file with `--output`"]);
    refused(&["--style", "picture", "-o", "-"], 2, &["name a file with `--output`"]);
    refused(
        &["--style", "picture", "-o", "q.jsonl", "--csv", "q.csv"],
        2,
        &["a table cannot have pictures"],
    );
    refused(
        &["--about", "tyro,bus"],
        2,
        &["no car concept `tyro`", "did you mean `tiro`?"],
    );
    refused(
        &["metropolis", "--count", "3", "--shots", "0"],
        1,
        &["limit-exceeded", "1000008 agents"],
    );
    refused(&["metropolis", "--count", "3"], 2, &["unknown-split"]);
    // A car that is alone allows few questions.
    let folder = tempfile::tempdir().unwrap();
    let config = folder.path().join("alone.yaml");
    let agents =
        "{train: {cars: [{count: 2, priority: 1}], pedestrians: ~}, test: {cars: [{priority: 1}], pedestrians: ~}}";
    fs::write(&config, format!("base: configs/vap-easy.yaml\nagents: {agents}\n")).unwrap();
    let alone = config.to_str().unwrap();
    refused(
        &[alone, "--count", "50"],
        1,
        &["limit-exceeded", "of 50 different questions in 250 worlds of `test`"],
    );
    refused(&["-o", "no/such/folder/q.jsonl", "--count", "4"], 2, &["cannot write"]);
}

/// Parses the sentences of a system message as rules, by their labels.
fn read_rules(system: &str, words: bool) -> Vec<(String, String)> {
    let (_, listed) = system.split_once("the same entity.\n").unwrap();
    let (listed, _) = listed.split_once("\nIf rules require several actions").unwrap();
    let atom = |text: &str| {
        if !words {
            return text.to_owned();
        }
        let (subject, said) = text.split_once(' ').unwrap();
        if let Some((name, _)) = WORDS.iter().find(|(_, verb)| *verb == said) {
            return format!("{name}({subject})");
        }
        let (verb, object) = said.rsplit_once(' ').unwrap();
        let (name, _) = WORDS.iter().find(|(_, known)| *known == verb).expect(text);
        let object = if object == "itself" { subject } else { object };
        format!("{name}({subject}, {object})")
    };
    let literal = |text: &str| match (
        text.strip_prefix("no rule requires "),
        text.split_once(" is not "),
        text.strip_prefix("not "),
    ) {
        (Some(action), ..) => format!("Not({})", action.replace(" of ", "(") + ")"),
        (_, Some((subject, said)), _) => format!("Not({})", atom(&format!("{subject} is {said}"))),
        (_, _, Some(negated)) => format!("Not({})", atom(negated)),
        _ => atom(text),
    };
    let rules = listed.lines().map(|line| {
        let (head, body) = line.trim_end_matches('.').split_once(": ").unwrap();
        let [label, "requires", action, "of", "X", "if" | "if,", ..] = head.split(' ').collect::<Vec<_>>()[..] else {
            panic!("{line}")
        };
        let body: Vec<String> = body.split("; ").map(literal).collect();
        (label.to_owned(), format!("{action}(X) :- {}.\n", body.join(", ")))
    });
    rules.collect()
}

/// Writes rules without their labels, and returns the decisions of `logicity infer` by them.
fn infer_with(rules: &str, config: &str, scenes: &[Value]) -> Vec<Value> {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("read.dl");
    fs::write(&file, format!(".include \"vocabulary.dl\"\n{rules}")).unwrap();
    let lines: String = scenes.iter().map(|scene| format!("{scene}\n")).collect();
    let output = run(
        &["infer", "--config", config, "--rules", file.to_str().unwrap()],
        &lines,
    );
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let answers = String::from_utf8(output.stdout).unwrap();
    let answers = answers.lines().zip(scenes).map(|(line, scene)| {
        let answer: Value = serde_json::from_str(line).unwrap();
        answer["egos"][string(&scene["ego"])].clone()
    });
    answers.collect()
}

#[test]
fn slow_the_rules_in_words_decide_as_the_rules() {
    for (config, style) in [("vap-hard", "atoms"), ("vap-hard", "words"), ("expert", "words")] {
        let arguments = [
            config, "--count", "100", "--seed", "3", "--style", style, "--prompt", "why",
        ];
        let questions = questions(&arguments);
        let rules = read_rules(string(&questions[0]["system"]), style == "words");
        // The vocabulary has the rule N of the default action.
        let text = |keep: &dyn Fn(&str) -> bool| -> String {
            let kept = rules.iter().filter(|(label, _)| label != "N" && keep(label));
            kept.map(|(_, rule)| rule.as_str()).collect()
        };
        let scenes: Vec<Value> = questions.iter().map(|question| question["scene"].clone()).collect();
        let all = infer_with(&text(&|_| true), config, &scenes);
        let actions: Vec<&Value> = all.iter().map(|answer| &answer["action"]).collect();
        let wanted: Vec<&Value> = questions.iter().map(|question| &question["action"]).collect();
        assert_eq!(actions, wanted, "{config}, {style}");

        let labels: Vec<&str> = questions[0]["labels"].as_array().unwrap().iter().map(string).collect();
        let read: Vec<&str> = rules.iter().map(|(label, _)| label.as_str()).collect();
        assert_eq!(labels, read);
        // Each of the clauses derives the action alone; the other clauses of the action do not.
        let action_of = |label: &str| {
            let (_, rule) = rules.iter().find(|(known, _)| known == label).unwrap();
            rule.split_once('(').unwrap().0.to_owned()
        };
        let mut alone = 0;
        for label in labels.iter().filter(|label| **label != "N") {
            let action = action_of(label);
            let kept = infer_with(
                &text(&|other| other == *label || action_of(other) != action),
                config,
                &scenes,
            );
            for (question, answer) in questions.iter().zip(&kept) {
                if question["action"] == action.as_str() {
                    let clauses = question["clauses"].as_array().unwrap();
                    let derived = answer["derived"].as_array().unwrap().contains(&question["action"]);
                    assert_eq!(
                        clauses.contains(&json!(label)),
                        derived,
                        "{label} in {}",
                        question["id"]
                    );
                    alone += usize::from(derived);
                }
            }
        }
        assert!(alone > 50, "{alone}");
        let defaults = questions.iter().filter(|question| question["action"] == "Normal");
        assert!(defaults.clone().count() > 10 && defaults.clone().all(|question| question["clauses"] == json!(["N"])));
    }
}

#[test]
fn prompts_ask_the_same_questions() {
    let of = |prompt: &str| questions(&["--count", "8", "--shots", "4", "--prompt", prompt]);
    let [examples, rules, why] = ["examples", "rules", "why"].map(of);
    for (others, prompt) in [(&rules, "rules"), (&why, "why")] {
        for (one, other) in examples.iter().zip(others) {
            for key in [
                "question",
                "answer",
                "clauses",
                "demonstrations",
                "scene",
                "source",
                "options",
                "version",
            ] {
                assert_eq!(one[key], other[key], "{key}");
            }
            assert_eq!(
                string(&other["id"]),
                string(&one["id"]).replace("-0-", &format!("-0-{prompt}-"))
            );
            assert_eq!((&one["prompt"], &other["prompt"]), (&json!("examples"), &json!(prompt)));
            assert!(string(&one["system"]).contains("not shown to you"));
            assert!(
                string(&other["system"])
                    .contains("VS7 requires Stop of X if, for some Y that X sees: CollidingClose(X, Y).")
            );
            assert_eq!(string(&other["system"]).contains("`Rule: `"), prompt == "why");
            assert_eq!(other["labels"].is_array(), prompt == "why");
        }
        assert_eq!(others.len(), 8);
    }
}

#[test]
fn any_rules_have_sentences() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("own.dl");
    let rules = r#".include "vocabulary.dl"
.decl crowded(x: agent)
.decl near(x: agent, y: agent)
near(X, Y) :- IsClose(X, Y).
/// C: a crowd
crowded(X) :- IsCar(X), N = count : { near(X, _) }, N > 2.
/// A1: any entity
Stop(X) :- IsCar(X), IsClose(X, _), Not(LeftOf(X, _)).
/// A2: alternatives
Stop(X) :- IsBus(X), (IsAtInter(X); IsInInter(X), Not(IsPolice(X))).
/// A3: constants
Slow(X) :- Not(Stop(X)), IsCar(Y), X != Y, Y != "Car_1", HigherPri(Y, X), Not(HigherPri(Y, Y)).
Fast(X) :- Not(Stop(X)), crowded(X), Not(IsTiro(X)).
"#;
    fs::write(&file, rules).unwrap();
    let first = |style: &str| {
        let arguments = [
            "expert", "--count", "3", "--shots", "0", "--prompt", "rules", "--style", style, "--rules",
        ];
        let system = string(&questions(&[&arguments[..], &[file.to_str().unwrap()]].concat())[0]["system"]).to_owned();
        let (_, listed) = system.split_once("the same entity.\n").unwrap();
        let (listed, _) = listed.split_once(" You may reason").unwrap();
        listed.to_owned()
    };
    let default = "If rules require several actions, the first of Stop, Slow, Fast, Normal counts. If no rule requires an \
                   action, the action is Normal.\nYou are given a scene as facts; use the rules to choose what the car does.";
    let atoms = [
        "N requires Normal of X if: Sees(X, X); no rule requires Stop of X; no rule requires Slow of X; no rule requires \
         Fast of X.",
        "own.dl:4 makes near(X, Y) true if: IsClose(X, Y); Sees(X, Y).",
        "C makes crowded(X) true if, for some N: IsCar(X); N = count : { near(X, _) in view }; N > 2.",
        "A1 requires Stop of X if, for some E1 that X sees: IsCar(X); IsClose(X, E1); it is false that (for some E2 that \
         X sees: LeftOf(X, E2)).",
        "A2 requires Stop of X if: IsBus(X); IsAtInter(X).",
        "A2 requires Stop of X if: IsBus(X); IsInInter(X); not IsPolice(X).",
        "A3 requires Slow of X if, for some Y that X sees: no rule requires Stop of X; IsCar(Y); X is not the same as Y; \
         Y is not the same as \"Car_1\"; HigherPri(Y, X); not HigherPri(Y, Y).",
        "own.dl:13 requires Fast of X if: no rule requires Stop of X; crowded(X); not IsTiro(X).",
        default,
    ];
    assert_eq!(first("atoms"), atoms.join("\n"));
    let words = [
        "N requires Normal of X if: X sees itself; no rule requires Stop of X; no rule requires Slow of X; no rule \
         requires Fast of X.",
        "own.dl:4 makes near(X, Y) true if: X is more than 12 and at most 20 cells away from Y; X sees Y.",
        "C makes crowded(X) true if, for some N: X is a car; N = count : { near(X, _) in view }; N > 2.",
        "A1 requires Stop of X if, for some E1 that X sees: X is a car; X is more than 12 and at most 20 cells away from \
         E1; it is false that (for some E2 that X sees: X is to the left of E2).",
        "A2 requires Stop of X if: X is a bus; X is at the edge of an intersection.",
        "A2 requires Stop of X if: X is a bus; X is inside an intersection; X is not a police car.",
        "A3 requires Slow of X if, for some Y that X sees: no rule requires Stop of X; Y is a car; X is not the same as \
         Y; Y is not the same as \"Car_1\"; Y has priority over X; Y does not have priority over itself.",
        "own.dl:13 requires Fast of X if: no rule requires Stop of X; crowded(X); X does not have a beginner at the \
         wheel.",
        default,
    ];
    assert_eq!(first("words"), words.join("\n"));
}

#[test]
fn clauses_with_one_label_count_once() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("own.dl");
    let rules = "\
.include \"vocabulary.dl\"
/// A: a car
Stop(X) :- IsCar(X).
/// B: a car that sees itself
Stop(X) :- IsCar(X), Sees(X, X).
/// A: a car that does not walk
Stop(X) :- IsCar(X), Not(IsPedestrian(X)).
";
    fs::write(&file, rules).unwrap();
    let arguments = ["expert", "--count", "2", "--shots", "0", "--prompt", "why", "--rules"];
    for question in questions(&[&arguments[..], &[file.to_str().unwrap()]].concat()) {
        assert_eq!(question["clauses"], json!(["A", "B"]));
        assert_eq!(question["labels"], json!(["N", "A", "B"]));
    }
}

/// The Python tests read this file. `cargo run -- questions --count 8 --shots 4 --force --output
/// tests/fixtures/questions.jsonl` writes it.
#[test]
fn the_file_for_the_python_tests_is_up_to_date() {
    let kept = fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/fixtures/questions.jsonl")).unwrap();
    assert_eq!(text(&["--count", "8", "--shots", "4"]), kept);
}
