//! Programs for Soufflé on the command line and in editors: macros, folders of includes, instances of components.

use crate::cli::{code, err, fails, out, run};
use std::fs;
use std::path::Path;

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
