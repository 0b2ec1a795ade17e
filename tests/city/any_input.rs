//! Properties that hold for any bytes as a configuration, a scene, examples or rules of a city. `hostile` checks them on many
//! inputs in every test run, `tests/fuzz` for as long as it runs. Each function panics if a property does not hold.

use logicity::builtin::BuiltinFiles;
use logicity::cancel::Cancel;
use logicity::city::ActionTable;
use logicity::config::{load_map, load_scenario};
use logicity::datalog::Program;
use logicity::diag::{self, Diagnostic, SourceId, Sources, render, to_json};
use logicity::files::{BUILTIN_FOLDER, ReadError, ReadFile as _};
use logicity::induce::{Settings, learn, support};
use logicity::popper;
use logicity::rng::Seed;
use logicity::sim::codes;
use logicity::sim::{Executor, Finding, Inference, LoadedCity, conflicts as find_conflicts, scene_json};
use logicity::task::induction::{InductionTask, Origin, report_json, rule_file};
use std::cell::RefCell;
use std::path::Path;
use std::sync::{Arc, LazyLock};

/// The search for conflicting actions ends, and each scene it finds can be written as JSON.
pub fn conflicts(bytes: &[u8]) {
    let mut sources = Sources::new();
    let entry = sources.add("any.dl", String::from_utf8_lossy(bytes));
    let builtin = |path: &Path| match path.starts_with(BUILTIN_FOLDER) {
        true => BuiltinFiles.read_or_builtin(path),
        false => Err(ReadError::NotFound),
    };
    let (Some(program), _) = Program::load(&mut sources, entry, &builtin) else {
        return;
    };
    for overlap in find_conflicts(program.rules(), &ActionTable::default()).expect("the two sides differ in one clause")
    {
        if let Finding::Together { scene, .. } = overlap.finding {
            assert!(scene_json(&scene, &[program.rules()]).is_object());
        }
    }
}

/// A text loads as a configuration and as a map, or gives diagnostics.
pub fn config(bytes: &[u8]) {
    let text = String::from_utf8_lossy(bytes);
    let read = |path: &Path| match path == Path::new("any.yaml") {
        true => Ok(text.to_string()),
        false => Err(ReadError::NotFound),
    };
    let mut sources = Sources::new();
    let map = load_map(&mut sources, Path::new("any.yaml"), &read).map(drop);
    draw(&map.err().unwrap_or_default(), &sources);
    let mut sources = Sources::new();
    let scenario = load_scenario(&mut sources, Path::new("any.yaml"), &read).map(drop);
    draw(&scenario.err().unwrap_or_default(), &sources);
}

/// A scene gets the same answer every time, or diagnostics.
pub fn scene(bytes: &[u8]) {
    let text = String::from_utf8_lossy(bytes);
    let mut sources = Sources::new();
    let source = sources.add_from("scene", text, 9);
    INFERENCE.with_borrow_mut(|inference| match inference.answer(&sources, source) {
        Ok(answer) => {
            let again = inference.answer(&sources, source).expect("the same scene");
            assert_eq!(again.to_json(u64::MAX), answer.to_json(u64::MAX));
        }
        Err(faults) => {
            assert!(!faults.is_empty());
            let of_a_scene =
                |fault: &Diagnostic| matches!(fault.code, codes::INVALID_SCENE | diag::codes::LIMIT_EXCEEDED);
            assert!(faults.iter().all(of_a_scene), "{}", render(&faults, &sources, false));
            draw(&faults, &sources);
        }
    });
}

/// The labeled scenes of a text, one per line, teach rules that choose the action of every example, except of those that
/// contradict each other or that no clause separates. The rules can be written and loaded.
pub fn labeled_scenes(bytes: &[u8]) {
    let text = String::from_utf8_lossy(bytes);
    let mut sources = Sources::new();
    let (task, known, rule_files) = &*TASK;
    let (mut examples, mut origin) = (task.examples(), Origin::default());
    INFERENCE.with_borrow_mut(|inference| {
        let vocabulary = inference.vocabulary().clone();
        let translator = task.translator(&vocabulary).expect("expert mode has all predicates");
        for line in text.lines().take(LINES_MAX) {
            let source = sources.add_from("scenes", line, 1);
            let Ok(scene) = inference.ground(&sources, source) else {
                continue;
            };
            for (ego, action) in scene.actions {
                match (translator.state(&scene.facts, ego), task.action(action)) {
                    (Ok(state), Ok(action)) => {
                        examples.push(state, action);
                        origin.push(examples.count() - 1, scene.names[ego].clone());
                    }
                    (Err(fault), _) | (_, Err(fault)) => draw(&[fault], &sources),
                }
            }
        }
    });
    let is_consistent = examples.contradictions().next().is_none();
    assert_eq!(task.check(&examples, &origin).is_ok(), is_consistent);
    let settings = Settings {
        variables: 2,
        nodes: 50,
        ..Settings::default()
    };
    let learned = learn(&examples, &settings, &Cancel::never());
    let support = support(&examples, &learned, &task.constraints());
    let is_separated = learned.actions.iter().all(|rules| rules.uncovered == 0);
    assert!(!is_consistent || !is_separated || support.wrong == 0, "{text}");
    assert!(report_json(task, &learned, &support, &origin).is_object());
    let rules = rule_file(task, &learned, &support, &origin, (known, rule_files));
    let entry = sources.add("learned.dl", rules);
    let (program, diagnostics) = Program::load(&mut sources, entry, &BuiltinFiles);
    assert!(program.is_some(), "{}", render(&diagnostics, &sources, false));
}

/// The maximum number of scenes to learn from.
const LINES_MAX: usize = 20;

/// The task of learning the rules of easy mode, with these rules.
static TASK: LazyLock<(InductionTask, Sources, Vec<SourceId>)> = LazyLock::new(|| {
    let mut sources = Sources::new();
    let city = LoadedCity::load(&mut sources, Path::new("easy"), None, &BuiltinFiles).expect("built in");
    let rule_files = city.rule_files.clone();
    let world = Arc::new(city.world().expect("they fit"));
    (InductionTask::new(world, &[]).unwrap(), sources, rule_files)
});

thread_local! {
    /// Shared, since preparing it takes far longer than answering a scene.
    static INFERENCE: RefCell<Inference> = RefCell::new(inference());
}

/// The texts of a task of Popper give a task or errors. The learner accepts every small task. The
/// bytes 1 and 2 separate background knowledge, examples and bias.
pub fn popper(bytes: &[u8]) {
    let text = String::from_utf8_lossy(bytes);
    let mut parts = text.splitn(3, ['\u{1}', '\u{2}']);
    let mut sources = Sources::new();
    let mut add = |name| sources.add(name, parts.next().unwrap_or_default());
    let files = popper::Files {
        background: add("bk.pl"),
        examples: add("exs.pl"),
        bias: add("bias.pl"),
    };
    for closed_world in [false, true] {
        let options = popper::Options {
            closed_world,
            ..popper::Options::default()
        };
        let (task, diagnostics) = popper::read(&sources, &files, &options);
        assert_eq!(task.is_none(), diagnostics.iter().any(Diagnostic::is_error));
        draw(&diagnostics, &sources);
        let Some(task) = task.filter(|task| task.cases.len() <= SMALL && task.vocabulary().predicates().len() <= SMALL)
        else {
            continue;
        };
        let settings = Settings {
            variables: task.variables.min(task.vocabulary().egos() + 1),
            nodes: 100,
            ..task.settings()
        };
        let solution = task.solve(|_| true, &settings, &|_| (), &Cancel::never());
        let positive = task.cases.iter().filter(|case| case.is_positive).count();
        assert!(solution.rules.uncovered <= positive);
        assert_eq!(task.clauses(&solution.rules).len(), solution.rules.clauses.len());
        let learned = task.program(&solution.rules);
        let program = sources.add("learned.dl", learned.declarations + &learned.clauses.join("\n"));
        let (program, diagnostics) = Program::load(&mut sources, program, &|_: &Path| Err(ReadError::NotFound));
        assert!(program.is_some(), "{}", render(&diagnostics, &sources, false));
    }
}

/// The most examples, and predicates, of a task to learn from.
const SMALL: usize = 30;

fn inference() -> Inference {
    let mut sources = Sources::new();
    let scenario = load_scenario(&mut sources, Path::new("expert"), &BuiltinFiles).expect("built in");
    let entry = sources.add("any.dl", ".include \"expert.dl\"");
    let (program, _) = Program::load(&mut sources, entry, &BuiltinFiles);
    Inference::new(
        scenario,
        program.expect("built in"),
        Seed(0),
        Executor::Auto,
        BuiltinFiles,
    )
    .expect("they fit")
}

/// Prints every diagnostic as text and as JSON.
fn draw(diagnostics: &[Diagnostic], sources: &Sources) {
    if !diagnostics.is_empty() {
        assert!(!render(diagnostics, sources, false).is_empty());
    }
    let json = to_json(diagnostics, sources);
    assert_eq!(json.as_array().map(Vec::len), Some(diagnostics.len()));
}
