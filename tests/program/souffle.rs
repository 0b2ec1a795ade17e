//! Programs for Soufflé on the command line and in editors: macros, folders of includes, instances of components.

use crate::cli::{code, err, fails, out, run};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::{env, fs};

fn write(folder: &Path, files: &[(&str, &str)]) {
    for (name, text) in files {
        let path = folder.join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, text).unwrap();
    }
}

#[test]
fn macros_and_folders_are_options_of_souffle() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).display().to_string();
    write(
        folder.path(),
        &[
            (
                "src/main.dl",
                "#include <graph.h>\n#if LEVEL > 1\n.init g = Graph<number>\n#endif\n#ifdef OTHER\n.init h = Graph<symbol>\n#endif\n",
            ),
            (
                "lib/graph.h",
                ".comp Graph<T> {\n  .decl edge(x: T, y: T)\n  .decl path(x: T, y: T)\n  .input edge\n  .output path\n  \
                 path(x, y) :- edge(x, y).\n  path(x, z) :- path(x, y), edge(y, z).\n}\n",
            ),
            ("facts/g.edge.facts", "1\t2\n2\t3\n"),
            ("facts/h.edge.facts", "a\tb\n"),
        ],
    );
    let (main, lib, facts, results) = (at("src/main.dl"), at("lib"), at("facts"), at("results"));
    for options in [["-M", "LEVEL=2 OTHER"], ["--macro", "LEVEL=2 OTHER=1"]] {
        let checked = run(&["check", &main, "-I", &lib, options[0], options[1]], b"");
        assert_eq!(code(&checked), 0, "{}", err(&checked));
        let ran = run(
            &[
                "query", &main, "-I", &lib, options[0], options[1], "-F", &facts, "-D", &results,
            ],
            b"",
        );
        assert_eq!(code(&ran), 0, "{}", err(&ran));
        let read = |name: &str| fs::read_to_string(folder.path().join("results").join(name)).unwrap();
        assert_eq!(
            (read("g.path.csv"), read("h.path.csv")),
            ("1\t2\n1\t3\n2\t3\n".into(), "a\tb\n".into())
        );
    }
    let asked = run(
        &["repl", &main, "--include-dir", &lib, "-M", "LEVEL=2", "-F", &facts],
        b"?- g.path(1, x).\n.init i = Graph<number>\ni.edge(7, 8).\n?- i.path(x, 8).\n",
    );
    let shown = out(&asked);
    assert!(
        code(&asked) == 0 && shown.contains('3') && shown.contains('7'),
        "{shown}{}",
        err(&asked)
    );
    fails(
        &run(&["check", &main, "-I", &lib, "-M", "a-b"], b""),
        2,
        &["`a-b` defines no macro"],
    );
    fails(&run(&["check", &main], b""), 1, &["missing-include", "graph.h", "`-I`"]);
    fails(
        &run(&["check", &main, "--no-preprocessor"], b""),
        1,
        &["unsupported", "directives of the preprocessor"],
    );
    fails(
        &run(&["fmt", "--check", &main], b""),
        1,
        &["unsupported", "`fmt` formats no file"],
    );
}

#[test]
fn programs_for_older_versions_run_with_an_option() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).display().to_string();
    let text =
        ".type Type\n.decl raw(x: symbol)\n.input raw\n.decl isType(t: Type)\n.output isType\nisType(x) :- raw(x).\n";
    write(folder.path(), &[("old.dl", text), ("facts/raw.facts", "a\nb\n")]);
    let (old, facts) = (at("old.dl"), at("facts"));
    fails(&run(&["check", &old], b""), 1, &["type-mismatch", "`--legacy`"]);
    let checked = run(&["check", "--legacy", &old], b"");
    assert_eq!((code(&checked), err(&checked).as_str()), (0, ""));
    let ran = run(&["query", "--legacy", &old, "-F", &facts, "-D", "-"], b"");
    assert!(code(&ran) == 0 && out(&ran).contains("a\nb\n"), "{}", err(&ran));
    let asked = run(
        &["repl", "--legacy", &old, "-F", &facts],
        b"?- isType(x).\n.reload\n?- isType(\"b\").\n",
    );
    assert!(code(&asked) == 0 && out(&asked).contains('a'), "{}", err(&asked));
}

#[test]
fn warnings_can_be_those_of_souffle() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.dl").display().to_string();
    let text = ".type T\n.decl a(x: T) brie\n.input a\n.decl b(x: T)\n.output b\nb(x) :- a(x). b(x) :- a(x), x = x.\nb(\"c\") :- a(x).\n";
    write(folder.path(), &[("a.dl", text)]);
    let said = |options: &[&str]| {
        let checked = run(&[&["check", &path], options].concat(), b"");
        assert_eq!(code(&checked), 0, "{}", err(&checked));
        let said = err(&checked);
        let mut codes: Vec<String> = said
            .lines()
            .filter_map(|line| Some(line.strip_prefix("warning[")?.split_once(']')?.0.to_owned()))
            .collect();
        codes.sort();
        codes.dedup();
        codes
    };
    let all = said(&[]);
    assert!(all.len() > 3 && all.contains(&"ignored".to_owned()), "{all:?}");
    assert_eq!(said(&["--souffle"]), ["old-form", "singleton-variable"]);
    assert_eq!(said(&["--souffle", "--legacy"]), ["singleton-variable"]);
    fails(&run(&["check", "--souffle", "--lints", &path], b""), 2, &["--lints"]);
}

/// A clause of a component has one message for all of its instances, if they say the same.
#[test]
fn a_component_is_reported_once_for_all_instances() {
    let folder = tempfile::tempdir().unwrap();
    let text = ".comp A { .decl p(x: number) .decl q(x: number, y: number)\n  p(x) :- q(x, lonely).\n  .output p .input q }\n\
                .init a = A\n.init b = A\n.init c = A\n";
    write(folder.path(), &[("a.dl", text)]);
    let path = folder.path().join("a.dl").display().to_string();
    let checked = run(&["check", &path], b"");
    let said = err(&checked);
    assert_eq!(
        (code(&checked), said.matches("lonely` occurs only once").count()),
        (0, 1),
        "{said}"
    );
    assert!(said.contains("in the instance `a` of `A`, made here"), "{said}");
}

/// The programs of Soufflé's tests that have other results here, each with the reason.
const DIFFERENT: &[(&str, &str)] = &[
    ("aggregate_witnesses", "an aggregate in a comparison has no witness"),
    ("bad_regex", "an invalid regular expression is an error"),
    ("choice_highest_mark", "`choice-domain` keeps another row"),
    ("issue2508", "the program calls functors in C++"),
    ("match5", "an invalid regular expression is an error"),
    ("math", "neither has `sin`; Soufflé's tests omit the program"),
    ("rangeop", "a `range` of unsigned numbers does not count down"),
];

/// Runs the programs of Soufflé's source whose folder `tests` is the environment variable `SOUFFLE_TESTS`.
#[test]
#[ignore = "needs the source of Soufflé; `make souffle-tests` runs it"]
fn programs_of_souffles_tests_have_its_results() {
    let tests = env::var_os("SOUFFLE_TESTS").expect("SOUFFLE_TESTS is the folder of Soufflé's tests");
    let mut different = BTreeSet::new();
    let mut total = 0;
    for kind in ["evaluation", "example"] {
        for folder in fs::read_dir(Path::new(&tests).join(kind)).expect("a folder") {
            let folder = folder.expect("an entry").path();
            let name = folder.file_name().expect("a name").to_string_lossy().into_owned();
            let rules = folder.join(format!("{name}.dl"));
            if !rules.exists() {
                continue;
            }
            total += 1;
            // Some programs have several folders, each with facts and results.
            let inner = fs::read_dir(&folder)
                .expect("a folder")
                .map(|entry| entry.expect("an entry").path());
            let mut cases: Vec<PathBuf> = inner.filter(|path| path.join(format!("{name}.out")).exists()).collect();
            let facts = folder.join("facts");
            let facts = if facts.exists() { facts } else { folder.clone() };
            let alone = cases.is_empty().then_some((folder.clone(), facts));
            let wrong: Vec<String> = (cases.drain(..).map(|case| (case.clone(), case)).chain(alone))
                .flat_map(|(results, facts)| differences(&rules, &name, &facts, &results))
                .collect();
            if !wrong.is_empty() {
                eprintln!("{kind}/{name}: {}", wrong.join("; "));
                different.insert(name);
            }
        }
    }
    eprintln!("{} of {total} programs have the same results", total - different.len());
    let known: BTreeSet<String> = DIFFERENT.iter().map(|(name, _)| (*name).to_owned()).collect();
    assert_eq!(different, known);
}

/// Returns how the results of a program differ from the files in the folder `results`.
fn differences(rules: &Path, name: &str, facts: &Path, results: &Path) -> Vec<String> {
    let made = tempfile::tempdir().unwrap();
    let arguments = [rules, Path::new("-F"), facts, Path::new("-D"), made.path()];
    let mut arguments = arguments.map(|argument| argument.to_str().expect("UTF-8")).to_vec();
    arguments.splice(0..0, ["query", "--output-anywhere"]);
    let ran = run(&arguments, b"");
    if code(&ran) != 0 {
        return vec![err(&ran).lines().next().unwrap_or_default().to_owned()];
    }
    let lines = |text: &[u8]| -> BTreeSet<String> {
        let text = String::from_utf8_lossy(text);
        text.lines()
            .filter(|line| !line.is_empty())
            .map(str::to_owned)
            .collect()
    };
    let mut wrong = Vec::new();
    let printed = fs::read(results.join(format!("{name}.out"))).unwrap_or_default();
    if lines(&printed) != lines(out(&ran).as_bytes()) {
        wrong.push("standard output".to_owned());
    }
    for file in fs::read_dir(results).unwrap().map(|entry| entry.unwrap().path()) {
        if file.extension().is_some_and(|extension| extension == "csv") {
            let found = made.path().join(file.file_name().unwrap());
            let same = fs::read(&found).is_ok_and(|found| lines(&found) == lines(&fs::read(&file).unwrap()));
            if !same {
                wrong.push(file.file_name().unwrap().to_string_lossy().into_owned());
            }
        }
    }
    wrong
}
