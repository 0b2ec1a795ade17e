//! The preprocessor: what files mean with its directives, and where messages point.

use logicity_datalog::diag::{Diagnostic, Sources, render};
use logicity_datalog::files::ReadError;
use logicity_datalog::{InputPolicy, Loaded, Preprocessing, Program, Value, Workspace, format};
use std::path::Path;

/// Loads the first of these files, which may include the others.
pub fn load(files: &[(&str, &str)], preprocessing: &Preprocessing) -> (Sources, Loaded) {
    let read = |path: &Path| {
        let found = files.iter().find(|(name, _)| path == Path::new(name));
        found.map(|(_, text)| (*text).to_owned()).ok_or(ReadError::NotFound)
    };
    let mut sources = Sources::new();
    let entry = sources.add(files[0].0, files[0].1);
    let mut workspace = Workspace::new(InputPolicy::Extensible);
    workspace.set_preprocessing(preprocessing.clone());
    workspace.add(&mut sources, entry, &read);
    (sources, workspace.into_checked())
}

fn macros(definitions: &str) -> Preprocessing {
    let mut preprocessing = Preprocessing::default();
    preprocessing.define(definitions).expect("definitions");
    preprocessing
}

/// Returns the values of `out`, which has one column of symbols.
fn rows(files: &[(&str, &str)], preprocessing: &Preprocessing) -> Vec<String> {
    let (sources, loaded) = load(files, preprocessing);
    let shown = || format!("{}\n{}", files[0].1, render(&loaded.diagnostics, &sources, false));
    let rules = loaded.rules.clone().unwrap_or_else(|| panic!("{}", shown()));
    let symbols = rules.symbols.clone();
    let out = rules.predicate("out").expect("out");
    let mut session = Program::new(rules).expect("small").session();
    session.commit().expect("small");
    let value = |row: &[Value]| {
        let symbol = logicity_datalog::symbol::Symbol(row[0].0);
        symbols.resolve(symbol).unwrap_or_default().to_owned()
    };
    let mut rows: Vec<String> = session.encoded_rows(out).map(value).collect();
    rows.sort();
    rows
}

/// Returns the rows of a single file that uses `out` without declaring it.
fn outputs(text: &str, definitions: &str) -> Vec<String> {
    let text = format!("{text}\n.decl out(x: symbol)\n.output out\n");
    rows(&[("a.dl", &text)], &macros(definitions))
}

fn messages(files: &[(&str, &str)], preprocessing: &Preprocessing) -> Vec<(&'static str, String, String)> {
    let (sources, loaded) = load(files, preprocessing);
    let faults = loaded.diagnostics.iter().map(|fault| sources.traced(fault));
    faults
        .map(|fault: Diagnostic| {
            let place = fault.primary.as_ref().map(|label| sources.locate(label.span));
            (fault.code.name(), place.unwrap_or_default(), fault.message)
        })
        .collect()
}

#[test]
fn macros_expand_as_in_c() {
    // The definitions, a text, and the strings that it stands for.
    let cases = [
        ("#define A \"a\"", "out(A).", &["a"][..]),
        ("#define F(x) out(x).", "F(\"a\") F(\"b\")", &["a", "b"]),
        ("#define F(x, y) out(y).", "F((\"a\", \"b\"), \"c\")", &["c"]),
        ("#define F() out(\"a\").", "F() F ( )", &["a"]),
        ("#define F(x) out(#x).", "F(a  +\n b)", &["a + b"]),
        ("#define F(x) out(#x).", "F(\"a\\n\")", &["\"a\\n\""]),
        ("#define F(x) out(#x).", "F(F)", &["F"]),
        ("#define CAT(x, y) x ## y", "CAT(o, ut)(\"a\").", &["a"]),
        ("#define CAT(x, y) x##y\n#define A o", "CAT(, out)(\"a\").", &["a"]),
        // `##` joins what was written; another macro joins the expansions.
        (
            "#define CAT(x, y) x ## y\n#define XCAT(x, y) CAT(x, y)\n#define A o\n#define B ut",
            "XCAT(A, B)(\"a\").",
            &["a"],
        ),
        (
            "#define STR(x) #x\n#define XSTR(x) STR(x)\n#define A b",
            "out(STR(A)). out(XSTR(A)).",
            &["A", "b"],
        ),
        // No macro expands within itself.
        ("#define out out", "out(\"a\").", &["a"]),
        (
            "#define A B\n#define B A\n#define STR(x) #x\n#define XSTR(x) STR(x)",
            "out(XSTR(A B)).",
            &["A B"],
        ),
        // The arguments may follow the expansion of a name.
        ("#define F(x) out(x).\n#define G F", "G(\"a\")", &["a"]),
        ("#define F(x) out(x).\n#define G F (\"a\")", "G G", &["a"]),
        ("#define F(x) out(#x).", "F(,).", &[][..]),
        ("#define ALL(...) out(#__VA_ARGS__).", "ALL(a, b) ALL()", &["", "a, b"]),
        (
            "#define ALL(f, rest...) f(\"x\", ## rest).\n.decl p(x: symbol, y: symbol)\nout(x) :- p(_, x).",
            "ALL(out) ALL(p, \"y\")",
            &["x", "y"],
        ),
        ("#define LONG(x) \\\n  out(x) \\\n  .", "LONG(\"a\")", &["a"]),
        (
            "#define A \"a\" // \"b\"\n#define B /* \"a\n */ \"c\"",
            "out(A). out(B).",
            &["a", "c"],
        ),
        ("#define A \"a\"\n#undef A\n#define A \"b\"", "out(A).", &["b"]),
        ("#define A \"a\"", "out(\"A\"). // A(\n/* A */", &["A"]),
        ("#define n 3\n#define MINUS -", "out(to_string(1 -MINUS n)).", &["4"]),
        ("#define A a\n.decl a(x: symbol)\na(\"b\").", "out(x) :- A(x).", &["b"]),
        ("#define EMPTY", "out EMPTY(\"a\") EMPTY.", &["a"]),
        ("  #  define A \"a\"", "out(A).", &["a"]),
        (
            "#define HERE __LINE__",
            "out(to_string(HERE)).\nout(to_string(\n__LINE__)). out(__FILE__).",
            &["2", "4", "a.dl"],
        ),
        (
            "#define N __COUNTER__",
            "out(to_string(N)). out(to_string(N)).",
            &["0", "1"],
        ),
        ("", "out(\"a\\\nb\").", &[][..]),
        ("", "ou\\\n  t(\"a\").", &[][..]),
        ("", "out(cat(\"a\", \\\n\"b\")).", &["ab"]),
    ];
    for (definitions, text, wanted) in cases {
        if wanted.is_empty() {
            let text = format!("{definitions}\n{text}\n.decl out(x: symbol)\n.output out\n");
            assert!(
                load(&[("a.dl", &text)], &Preprocessing::default()).1.rules.is_none(),
                "{text}"
            );
            continue;
        }
        assert_eq!(
            outputs(&format!("{definitions}\n{text}"), ""),
            wanted,
            "{definitions}\n{text}"
        );
    }
}

#[test]
fn conditions_choose_a_branch() {
    let yes = [
        "#if 1",
        "#if 0x10 == 16 && 0b11 == 3 && 010 == 8",
        "#if -1 < 0",
        "#if !0",
        "#if ~0 == -1",
        "#if 2 + 3 * 4 == 14",
        "#if (2 + 3) * 4 == 20",
        "#if 7 / 2 == 3 && 7 % 2 == 1",
        "#if 1 << 4 == 16",
        "#if 16 >> 2 == 4",
        "#if (6 & 3) == 2 && (6 | 3) == 7 && (6 ^ 3) == 5",
        "#if 0 ? 0 : 1",
        "#if 1 ? 1 : 1 / 0",
        "#if 1 || 1 / 0",
        "#if !(0 && 1 / 0)",
        "#if SET",
        "#if SET == 2",
        "#if defined(SET)",
        "#if defined SET",
        "#if !defined(UNSET)",
        "#if UNSET == 0",
        "#if 3 >= 3 && 3 <= 3 && 3 != 4",
        "#ifdef SET",
        "#ifndef UNSET",
        "#if 0\n#elif 1",
        "#if 0\nfaulty '\n#elif 0\n#else",
        "#if TWICE(3) == 6",
        "#if 0\n#elifdef SET",
        "#if 0\n#elifndef UNSET",
        "#if /* a */ 1 // b",
        "#if \\\n 1",
        "#if 10UL > 9",
        "#if 0\n/*\n#else\n*/ \"\n#elif 1",
        "#if defined(SET) && TWICE(SET) > 3",
    ];
    for condition in yes {
        let text = |condition: &str| {
            format!(
                "#define SET 2\n#define TWICE(x) (2 * (x))\n{condition}\nout(\"yes\").\n#else\nout(\"no\").\n#endif"
            )
        };
        let text = match condition.ends_with("#else") {
            true => text(condition).replace("#else\nout(\"no\").\n", ""),
            false => text(condition),
        };
        assert_eq!(outputs(&text, ""), ["yes"], "{condition}");
    }
    let no = [
        "#if 0",
        "#if UNSET",
        "#if SET - 2",
        "#ifdef UNSET",
        "#if 1 == 2",
        "#if defined(UNSET) || 0",
    ];
    for condition in no {
        let text =
            format!("#define SET 2\n{condition}\nout(\"yes\").\n#if 1\n#else\n#endif\n#else\nout(\"no\").\n#endif");
        assert_eq!(outputs(&text, ""), ["no"], "{condition}");
    }
}

#[test]
fn the_caller_defines_macros_and_names_folders() {
    let text = "#if defined(A) && B == 2\nout(\"yes\").\n#else\nout(\"no\").\n#endif";
    assert_eq!(outputs(text, "A B=2"), ["yes"]);
    assert_eq!(outputs(text, "A"), ["no"]);
    assert_eq!(outputs("out(NAME).", "NAME=\"a\""), ["a"], "without any directive");
    for wrong in ["1=2", "=", "a-b", "defined", "__LINE__=1"] {
        assert_eq!(Preprocessing::default().define(wrong), Err(wrong.to_owned()));
    }
    let files = [
        (
            "src/a.dl",
            "#include <x.h>\n#include \"y.h\"\n.include \"z.dl\"\n.output out\n",
        ),
        ("lib/x.h", ".decl out(x: symbol)\nout(\"x\").\n#include \"near.h\"\n"),
        ("lib/near.h", "out(\"near\").\n"),
        ("src/y.h", "out(\"y of src\")."),
        ("lib/y.h", "out(\"y of lib\").\n"),
        ("more/z.dl", "out(\"z\").\n"),
    ];
    let mut preprocessing = Preprocessing::default();
    preprocessing.folders = vec!["lib".into(), "more".into()];
    assert_eq!(rows(&files, &preprocessing), ["near", "x", "y of src", "z"]);
}

#[test]
fn included_text_may_be_any_part_of_a_program() {
    let files = [
        (
            "a.dl",
            "#define ROW \"a\"\n#include \"part.h\"\n#undef ROW\n#define ROW \"b\"\n#include \"part.h\"\n#include \"decl.h\"\n\
             #include \"decl.h\"\n#define FILE \"body.h\"\nout(x) :-\n#include FILE\n, x != \"?\".\n.output out\n",
        ),
        ("part.h", "out(ROW).\n"),
        (
            "decl.h",
            "#ifndef DECL\n#define DECL\n.decl out(x: symbol)\n.decl p(x: symbol)\np(\"p\").\n#endif\n",
        ),
        ("body.h", "p(x)"),
    ];
    assert_eq!(rows(&files, &Preprocessing::default()), ["a", "b", "p"]);
    let once = [
        (
            "a.dl",
            "#include \"b.dl\"\n#include \"./b.dl\"\n.include \"b.dl\"\n.output out\n",
        ),
        (
            "b.dl",
            "#pragma once\n.decl out(x: symbol)\nout(\"a\").\n#include \"b.dl\"\n",
        ),
    ];
    assert_eq!(rows(&once, &Preprocessing::default()), ["a"]);
}

#[test]
fn messages_point_before_the_expansion_and_show_it() {
    let files = [
        (
            "a.dl",
            "#include \"m.h\"\n.decl e(x: number, y: number)\n.decl out(x: number)\n.output out\n.input e\n\
             out(x) :- OUTER(x).\nout(x) :- e(x, _), PAIR(x, z, \"text\").\n// after\nout(y) :- e(_, x).\n",
        ),
        (
            "m.h",
            "#define INNER(x) e(x)\n#define OUTER(x) \\\n  INNER(x)\n#define PAIR(x, y, z) e(x, y), e(y, z)\n",
        ),
    ];
    let (sources, loaded) = load(&files, &Preprocessing::default());
    let found = render(&loaded.diagnostics, &sources, false);
    for part in [
        "error[arity-mismatch]: `e` takes 2 arguments, not 1",
        "--> a.dl:6:11",
        "::: m.h:1:9",
        "in the expansion of the macro `INNER`, defined here",
        "in the expansion of the macro `OUTER`, defined here",
        "= note: `OUTER` expands to `e(x)`",
        "--> a.dl:7:31",
        "in the expansion of the macro `PAIR`, defined here",
        "`PAIR` expands to `e(x, z), e(z, \"text\")`",
        "--> a.dl:9:5",
    ] {
        assert!(found.contains(part), "{part} is missing in\n{found}");
    }
    // A literal of the user has no macro in its message.
    let last = found.split("--> a.dl:9:5").nth(1).unwrap();
    assert!(!last.contains("macro"), "{last}");
    let edits: Vec<String> = (loaded.diagnostics.iter())
        .map(|fault| sources.traced(fault))
        .flat_map(|fault| fault.fixes)
        .flat_map(|fix| fix.edits)
        .map(|(span, _)| sources.locate(span))
        .collect();
    assert!(edits.iter().all(|place| !place.starts_with("m.h")), "{edits:?}");
}

#[test]
fn faulty_directives_have_messages() {
    let cases = [
        ("#if\n#endif", "1:1", "the condition is missing"),
        ("#if 1 +\n#endif", "1:1", "an operand is missing at the end"),
        ("#if 1 2\n#endif", "1:7", "an operator is missing here"),
        ("#if (1\n#endif", "1:1", "`)` is missing"),
        ("#if 1 / 0\n#endif", "1:7", "division by zero"),
        ("#if F(1)\n#endif", "1:5", "no macro with parameters has this name"),
        (
            "#if \"a\"\n#endif",
            "1:5",
            "a condition consists of whole numbers, names and operators",
        ),
        ("#if defined(1)\n#endif", "1:13", "`defined` takes the name of a macro"),
        (
            "#if 99999999999999999999\n#endif",
            "1:5",
            "this is not a whole number of 64 bits",
        ),
        ("#ifdef\n#endif", "1:1", "`#ifdef` without a name"),
        ("#if 1", "1:1", "a condition without `#endif`"),
        ("#else", "1:1", "`#else` without `#if`"),
        ("#endif", "1:1", "`#endif` without `#if`"),
        ("#if 0\n#else\n#else\n#endif", "3:1", "`#else` after `#else`"),
        ("#if 1\n#else\n#elif 1\n#endif", "3:1", "`#elif` after `#else`"),
        ("#define", "1:1", "`#define` without a name"),
        ("#define 1 2", "1:9", "the name of a macro is a word"),
        ("#define defined 2", "1:9", "this name cannot be defined"),
        ("#define F(x", "1:10", "the parameters of a macro end with `)`"),
        ("#define F(x y) x", "1:13", "a comma separates parameters"),
        ("#define F(1) x", "1:10", "parameters are names between commas"),
        ("#define F(x, x) x", "1:14", "this parameter has two places"),
        ("#define F(..., x) x", "1:10", "`...` is the last parameter"),
        (
            "#define F(x) ## x",
            "1:9",
            "`##` stands between two parts of a definition",
        ),
        (
            &format!("#define F({}z) 1", "a, ".repeat(1000)),
            "1:10",
            "a macro has at most 255 parameters",
        ),
        ("#undef 1", "1:1", "`#undef` without a name"),
        ("#error not so", "1:1", "`#error`: not so"),
        ("#include", "1:1", "`#include` without a file"),
        ("#include nothing", "1:10", "`#include` without a file"),
        (
            "#define F(x) x\nF(1, 2)",
            "2:1",
            "the macro `F` takes 1 argument, not 2",
        ),
        ("#define F(x) x\nF(1", "2:1", "the use of the macro `F` does not end"),
        (
            "#define F(x) x\nF(out(\"a\").\n#if 0\n)\n",
            "3:1",
            "a directive among the arguments of the macro `F`",
        ),
    ];
    for (text, place, message) in cases {
        let found = messages(&[("a.dl", text)], &Preprocessing::default());
        let wanted = ("preprocessor", format!("a.dl:{place}"), message.to_owned());
        assert!(found.contains(&wanted), "{text}\n{found:?}");
    }
    let missing = messages(
        &[("a.dl", "#include <b.h>\nout(x) :- p(x).\n")],
        &Preprocessing::default(),
    );
    assert_eq!(missing.len(), 1, "an included file may declare names: {missing:?}");
    assert_eq!((missing[0].0, missing[0].1.as_str()), ("missing-include", "a.dl:1:10"));
}

#[test]
fn no_file_expands_without_bound() {
    let mut chain = "#define X0 x x\n#define E0\n".to_owned();
    for level in 1..40 {
        chain += &format!("#define X{level} X{0} X{0} X{0} X{0}\n", level - 1);
        chain += &format!("#define E{level} E{0} E{0} E{0} E{0}\n", level - 1);
    }
    let mut joined = "#define S(x) #x\n#define X(x) S(x)\n#define J(x, y) x ## y\n#define A0 aaaaaaaa\n".to_owned();
    for level in 1..40 {
        joined += &format!(
            "#define A{level} K{level}(A{0}, A{0})\n#define K{level}(x, y) J(x, y)\n",
            level - 1
        );
    }
    let nested = format!("#define F(x) x x\n{}out{}", "F(".repeat(500), ")".repeat(500));
    let deep: String = "#define F(x) x\n".to_owned() + &"F(".repeat(100_000);
    for text in [
        format!("{chain}X39"),
        format!("{joined}X(A39)"),
        format!("{chain}E39"),
        format!("{chain}#define S(x) #x\nout(S(X39))."),
        format!("{chain}#define I(x) x\nI(X39)"),
        format!("{chain}#if X39\n#endif"),
        nested,
        deep,
        "#include \"a.dl\"\n#include \"a.dl\"\n".to_owned(),
        "#if 1\n".repeat(100_000),
        format!("#if {}1", "(".repeat(100_000)),
        format!("#if {}1", "!".repeat(100_000)),
    ] {
        let found = messages(&[("a.dl", &text)], &Preprocessing::default());
        assert!(!found.is_empty(), "{}", &text[text.len() - 40..]);
    }
}

#[test]
fn without_the_preprocessor_its_directives_are_errors() {
    let mut preprocessing = Preprocessing::default();
    preprocessing.enabled = false;
    let text = "#define A \"a\"\n#ifdef B\n#endif\n# 1 \"b.dl\"\n.decl out(x: symbol)\n.output out\nout(\"a\").\n";
    let found = messages(&[("a.dl", text)], &preprocessing);
    let places: Vec<(&str, &str)> = found.iter().map(|(code, place, _)| (*code, place.as_str())).collect();
    let wanted = ["1", "2", "3", "4"].map(|line| ("unsupported", format!("a.dl:{line}:1")));
    assert_eq!(
        places,
        wanted.each_ref().map(|(code, place)| (*code, place.as_str())),
        "{found:?}"
    );
}

#[test]
fn files_with_directives_are_not_formatted() {
    for (text, good) in [
        ("#define A 1\nout( A ).\n", false),
        ("#if 0\n#endif\n", false),
        ("#include \"b.dl\"\nout( 1 ).\n", true),
    ] {
        let mut sources = Sources::new();
        let id = sources.add("a.dl", text);
        let found = format(&sources, id);
        match found {
            Ok(formatted) => assert!(good && formatted.contains("out(1).")),
            Err(faults) => {
                assert!(
                    !good && faults.iter().all(|fault| fault.code.name() == "unsupported"),
                    "{text}"
                );
            }
        }
    }
}
