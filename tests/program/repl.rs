//! The prompt, through a pipe and at a terminal.

use std::fs;
use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Command, Output, Stdio};

fn logicity(arguments: &[&str], folder: &Path, input: &str) -> Output {
    let mut process = Command::new(env!("CARGO_BIN_EXE_logicity"))
        .args(arguments)
        .current_dir(folder)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    process.stdin.take().unwrap().write_all(input.as_bytes()).unwrap();
    process.wait_with_output().unwrap()
}

/// The standard output, standard error and exit code of the prompt.
fn typed(input: &str) -> (String, String, i32) {
    let folder = tempfile::tempdir().unwrap();
    typed_in(folder.path(), &[], input)
}

fn typed_in(folder: &Path, arguments: &[&str], input: &str) -> (String, String, i32) {
    let output = logicity(&[&["repl"], arguments].concat(), folder, input);
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    let code = output.status.code().expect("no signal ended it");
    (text(output.stdout), text(output.stderr), code)
}

/// The output for input without errors.
fn good(input: &str) -> String {
    let (out, err, code) = typed(input);
    assert_eq!((err.as_str(), code), ("", 0), "{out}");
    out
}

const GRAPH: &str = "
.decl Edge(x: number, y: number)
/// There is a path from x to y.
.decl Path(x: number, y: number)
Path(x, y) :- Edge(x, y).
Path(x, z) :- Path(x, y),
    Edge(y, z).
";

#[test]
fn facts_are_maintained_and_questions_answered() {
    let out = good(&format!(
        "{GRAPH}Edge(1, 2). Edge(2, 3).\nEdge(3, 10).\n?- Path(x, 10), x != 3.\n"
    ));
    assert_eq!(out, "Edge +2, Path +3\nEdge +1, Path +3\nx\n-\n1\n2\n2 rows\n");
}

/// Facts keep their values when a clause is added, and are found again.
#[test]
fn numbers_of_64_bits_and_records_outlive_new_clauses() {
    let folder = tempfile::tempdir().unwrap();
    let input = ".type L = [head: number, tail: L]\n.decl p(x: number)\n.decl r(x: L)\n\
                 p(-5). p(5000000000). p(7). r([-6, [6000000000, nil]]).\n\
                 .decl q(x: number)\nq(x * 2) :- p(x).\nretract p(7).\np(-5).\n\
                 .explain p(-5)\n.explain r([-6, [6000000000, nil]])\n.why-not p(8)\n?- q(x).\n?- r(x).\n";
    let (out, err, code) = typed_in(folder.path(), &["--word-size", "64"], input);
    assert_eq!((err.as_str(), code), ("", 0), "{out}");
    for shown in ["        -10\n10000000000\n2 rows", "[-6, [6000000000, nil]]", "p(-5)"] {
        assert!(out.contains(shown), "`{shown}` is missing in:\n{out}");
    }
}

/// The variables of a question may be fields of records that are records themselves.
#[test]
fn questions_take_records_apart() {
    let declared = ".type L = [head: number, tail: L]\n.type E = Num {n: number} | Add {l: E, r: E}\n\
                    .decl p(x: L)\n.decl e(x: E)\np([1, [2, nil]]). e($Add($Num(1), $Num(2))).\n";
    let out = good(&format!(
        "{declared}?- p([x, t]).\n?- p(l), l = [_, [_, t]].\n?- e($Add(a, _)).\n?- p([_, t]), t = [y, u].\n"
    ));
    for shown in [
        "1  [2, nil]\n1 row",
        "[1, [2, nil]]  nil\n1 row",
        "$Num(1)\n1 row",
        "[2, nil]  2  nil\n1 row",
    ] {
        assert!(out.contains(shown), "`{shown}` is missing in:\n{out}");
    }
    let (_, err, code) = typed(&format!("{declared}?- l = [1, nil].\n"));
    assert!(err.contains("nothing determines the type of the record `l`"), "{err}");
    assert_eq!(code, 1);
}

/// Errors in a later input do not repeat the warnings of earlier texts.
#[test]
fn warnings_are_printed_once() {
    let (_, err, code) = typed(&format!(
        "{GRAPH}Path(x, y) :- Edge(x, y), Edge(z, y).\nPath(x, y) :- Missing(x, y).\nMissing(1).\n"
    ));
    assert_eq!(err.matches("singleton-variable").count(), 1, "{err}");
    assert_eq!((err.matches("error[unknown-predicate]").count(), code), (2, 1), "{err}");
}

#[test]
fn a_question_may_be_any_body() {
    let ask = |question: &str| good(&format!("{GRAPH}Edge(1, 2). Edge(2, 3).\n?- {question}\n"));
    let answer = |question: &str| ask(question).split_once('\n').unwrap().1.to_owned();
    assert_eq!(answer("Path(1, _)."), "true\n");
    assert_eq!(answer("Path(3, _)."), "false\n");
    assert_eq!(answer("Path(x, _), !Path(_, x)."), "x\n-\n1\n1 row\n");
    assert_eq!(
        answer("Edge(_x, y), z = y * 100."),
        "y    z\n-  ---\n2  200\n3  300\n2 rows\n"
    );
    assert_eq!(answer("n = count : { Path(_, _) }."), "n\n-\n3\n1 row\n");
    assert_eq!(answer("Edge(x, 2); Edge(2, x)."), "x\n-\n1\n3\n2 rows\n");
    assert_eq!(
        answer("Edge(x, y),\n  s = cat(\"to \", to_string(y)),\n  x > 1."),
        "x  y  s\n-  -  ----\n2  3  to 3\n1 row\n"
    );
    assert_eq!(answer("Path(x, y), x > y."), "0 rows\n");
}

#[test]
fn every_question_agrees_with_the_same_clause_in_a_file() {
    let folder = tempfile::tempdir().unwrap();
    let facts = "Edge(1, 2). Edge(2, 3). Edge(3, 1). Edge(3, 4). Edge(5, 5).";
    let bodies = [
        ("x, y", "Path(x, y), !Edge(x, y)"),
        ("x, n", "Edge(x, _), n = sum y : { Path(x, y), y > 1 }"),
        ("x", "Path(x, x); Edge(x, 4), x = 3"),
        ("x, y", "Edge(x, y), m = max z : { Edge(z, _) }, y = m"),
        ("y", "Path(1, y), y % 2 = 0"),
    ];
    for (variables, body) in bodies {
        let columns: Vec<String> = variables.split(", ").map(|name| format!("{name}: number")).collect();
        let file = format!(
            "{GRAPH}{facts}\n.decl Answer({})\n.output Answer\nAnswer({variables}) :- {body}.",
            columns.join(", ")
        );
        fs::write(folder.path().join("all.dl"), file).unwrap();
        let expected = logicity(&["query", "all.dl", "-D", "-"], folder.path(), "");
        let expected = String::from_utf8(expected.stdout).unwrap();
        let expected: Vec<Vec<&str>> = (expected.lines().skip(4))
            .take_while(|line| !line.starts_with('='))
            .map(|line| line.split('\t').collect())
            .collect();
        assert!(!expected.is_empty(), "{body}");
        let out = good(&format!("{GRAPH}{facts}\n?- {body}.\n"));
        let lines: Vec<&str> = out.lines().skip_while(|line| !line.starts_with('-')).skip(1).collect();
        let positions: Vec<usize> = {
            let titles = out
                .lines()
                .find(|line| line.split_whitespace().all(|word| body.contains(word)));
            let titles: Vec<&str> = titles.unwrap().split_whitespace().collect();
            let wanted = variables.split(", ");
            wanted
                .map(|name| titles.iter().position(|title| *title == name).unwrap())
                .collect()
        };
        let mut found: Vec<Vec<&str>> = (lines[..lines.len() - 1].iter())
            .map(|line| {
                let cells: Vec<&str> = line.split_whitespace().collect();
                positions.iter().map(|&position| cells[position]).collect()
            })
            .collect();
        found.sort();
        found.dedup();
        let mut expected = expected;
        expected.sort();
        assert_eq!(found, expected, "{body}\n{out}");
    }
}

#[test]
fn facts_and_clauses_are_retracted() {
    let out = good(&format!(
        "{GRAPH}Edge(1, 2). Edge(2, 3).\nretract Edge(2, 3).\nEdge(2, 3).\nretract Path(a, c) :- Path(a, b), Edge(b, c).\n\
         retract Edge(1, 2)\n"
    ));
    let lines: Vec<&str> = out.lines().collect();
    let expected = [
        "Edge +2, Path +3",
        "Edge -1, Path -2",
        "Edge +1, Path +2",
        "Path -1",
        "Edge -1, Path -1",
    ];
    assert_eq!(lines, expected);
}

#[test]
fn a_fact_of_a_file_is_retracted_until_the_file_is_read_again() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("g.dl"), format!("{GRAPH}Edge(1, 2). Edge(2, 0x3).")).unwrap();
    let (out, err, code) = typed_in(
        folder.path(),
        &["g.dl"],
        "retract Edge(2, 3).\nEdge(7, 8).\nPath(9, 9).\n.reload\n?- Path(x, y), x >= 7.\n?- Edge(2, x).\n",
    );
    assert_eq!((err.as_str(), code), ("", 0));
    let expected = "Edge -1, Path -2\nEdge +1, Path +1\nPath +1\nEdge +1, Path +2\nx  y\n-  -\n7  8\n9  9\n2 rows\nx\n-\n3\n1 row\n";
    assert_eq!(out, expected);
}

#[test]
fn facts_stay_when_their_predicate_gains_or_loses_rules() {
    let out = good(
        ".decl A(x: symbol, y: float, z: unsigned, n: number)\n.decl B(x: symbol)\n\
         A(\"say \\\"hi\\\"\\n\", -2.5, 7, -3). A(\"b\", to_float(\"inf\"), 0, 1).\n\
         A(x, 1, 1, 1) :- B(x).\nB(\"new\").\n?- A(x, y, z, n).\nretract A(x, 1, 1, 1) :- B(x).\n?- A(x, _, _, _).\n",
    );
    assert!(
        out.contains("say \"hi\"\\n") && out.contains("inf") && out.contains("-2.5"),
        "{out}"
    );
    assert!(out.starts_with("A +2\n") && out.ends_with("2 rows\n"), "{out}");
    assert!(
        out.contains("A +1") && out.contains("A -1") && out.contains("3 rows"),
        "{out}"
    );
}

#[test]
fn why_and_why_not_are_explained() {
    let asked =
        format!("{GRAPH}Edge(1, 2). Edge(2, 3).\nexplain Path(1, 3)\nwhy-not Path(3, _).\n.explain Edge(1, 2)\n");
    let out = good(&asked);
    for words in [
        "Path(1, 3)  by",
        "├─ Path(1, 2)",
        "Not(Path(3, _)): no clause of Path holds",
        "Edge(1, 2)",
    ] {
        assert!(out.contains(words), "`{words}` is missing in\n{out}");
    }
}

#[test]
fn faults_point_into_the_input_and_change_nothing() {
    let faults = [
        ("Pth(1, 2).", "error[unknown-predicate]", "<input 6>:1:1"),
        ("?- Path(x, y), z > 1.", "error[unbound-variable]", "<input 6>:1:16"),
        ("?- Path(x, y),\n   Path(y).", "error[arity-mismatch]", "<input 6>:2:4"),
        ("Edge(1, \"a\").", "error[type-mismatch]", "<input 6>:1:9"),
        (
            "explain Path(a, 1)",
            "error[invalid-fact]: `a` is a variable",
            "<input 6>:1:14",
        ),
        ("why-not Pth(2, 1).", "error[unknown-predicate]", "<input 6>:1:9"),
        (
            "retract Edge(8, 9).",
            "error[invalid-fact]: this fact does not hold",
            "<input 6>:1:1",
        ),
        (
            "retract Path(1, 2).",
            "error[invalid-fact]: rules derive `Path`",
            "<input 6>:1:1",
        ),
        (
            "retract Path(x, y) :- Edge(y, x).",
            "error[invalid-fact]: no such clause",
            "<input 6>:1:9",
        ),
        (".show Absent", "error[unknown-predicate]", "<input 6>:1:7"),
        (".hlep", "error[syntax]: no command `.hlep`", "<input 6>:1:1"),
        (".foo", "the commands are `.load`, `.reload`, `.facts`", "<input 6>:1:1"),
        (".dcl A(x: number)", "error[syntax]: unknown directive", "<input 6>:1:1"),
        (
            "Path(x, y) :- Edge(x, y), !Path(y, x).",
            "error[cyclic-negation]",
            "<input 6>:1:28",
        ),
        (".include \"nowhere.dl\"", "error[missing-include]", "<input 6>:1:10"),
        ("Edge(1, 2", "error[syntax]", "<input 6>:1:"),
    ];
    for (input, message, place) in faults {
        // Only the last input can be incomplete.
        let (before, after) = match input {
            "Edge(1, 2" => ("?- Path(x, y).\n", ""),
            _ => ("", "?- Path(x, y).\n"),
        };
        let place = if before.is_empty() {
            place.to_owned()
        } else {
            place.replace('6', "7")
        };
        let (out, err, code) = typed(&format!("{GRAPH}Edge(4, 5).\n{before}{input}\n{after}"));
        assert_eq!(code, 1, "{input}\n{out}{err}");
        assert!(err.contains(message) && err.contains(&place), "{input}\n{err}");
        let first_line = input.lines().next().unwrap();
        assert!(
            err.contains(first_line) || input.contains('\n'),
            "the message shows the typed line: {err}"
        );
        assert_eq!(out, "Edge +1, Path +1\nx  y\n-  -\n4  5\n1 row\n", "{input}");
    }
}

#[test]
fn a_faulty_file_can_be_corrected() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("g.dl"), ".decl A(x: number)\nA(x) :- B(x).").unwrap();
    let (out, err, code) = typed_in(folder.path(), &["g.dl"], ".predicates\n");
    assert!(
        err.contains("error[unknown-predicate]") && err.contains("g.dl:2:9"),
        "{err}"
    );
    assert_eq!((out.lines().count(), code), (2, 1), "{out}");
    let (_, err, code) = typed_in(folder.path(), &["missing.dl"], "");
    assert!(err.contains("missing.dl") && code == 2, "{err}");
}

#[test]
fn facts_come_from_a_folder() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("g.dl"), format!("{GRAPH}.input Edge")).unwrap();
    fs::write(folder.path().join("Edge.facts"), "1\t2\n2\t3\n").unwrap();
    let (out, err, code) = typed_in(folder.path(), &["g.dl", "-F", "."], ".facts .\n?- Path(x, 3).\n");
    assert_eq!((err.as_str(), code), ("", 0));
    assert_eq!(out, "Edge +2, Path +3\nno fact changed\nx\n-\n1\n2\n2 rows\n");
}

#[test]
fn questions_may_span_lines_and_end_as_soon_as_they_are_complete() {
    let facts = format!("{GRAPH}Edge(1, 2). Edge(2, 3).\n");
    let stopped = good(&format!("{facts}?- Path(x, y), y = 3.\n"));
    for question in [
        "?- Path(x, y), y = 3",
        "?- Path(x, y),\n  y = 3",
        "?- Path(x, y), y =\n 3",
    ] {
        assert_eq!(
            good(&format!("{facts}{question}\n?- Path(1, 3)\n")),
            format!("{stopped}true\n"),
            "{question}"
        );
    }
}

#[test]
fn a_command_ends_an_incomplete_input() {
    let facts = format!("{GRAPH}Edge(1, 2).\n");
    for (command, shown) in [(".help\n", ".predicates"), ("  .show Edge\n", "1 row"), (".quit\n", "")] {
        for open in ["Path(x, y) :- Edge(\n", "Edge(1,\n2\n", "?- Edge(x, y),\n"] {
            let (out, err, code) = typed(&format!("{facts}{open}{command}"));
            assert!(
                err.contains("error[syntax]") && out.contains(shown),
                "{open}{command}: {out}{err}"
            );
            assert!(!err.contains("unknown directive"), "{open}{command}: {err}");
            assert_eq!(code, 1);
        }
    }
    // Nothing follows `.quit`.
    let (out, ..) = typed(&format!("{facts}Edge(\n.quit\n?- Edge(1, 2)\n"));
    assert!(!out.contains("true"), "{out}");
    // A comment may contain any line.
    assert!(good(&format!("{facts}/* not a\n.quit\n*/\n?- Edge(1, 2)\n")).ends_with("true\n"));
    let (_, err, _) = typed(&format!("{facts}Edge(\n.exit\n"));
    assert!(err.contains("type `.quit`"), "{err}");
}

/// A question begins a line, so a clause before it lacks its full stop.
#[test]
fn a_question_ends_an_incomplete_input() {
    for line in ["?- Path(x, y)\n", "  ?- Path(x, y).\n"] {
        let (out, err, code) = typed(&format!("{GRAPH}Edge(1, 2)\n{line}?- Edge(x, y)\n"));
        assert!(err.contains("the clause before lacks a full stop"), "{err}");
        assert!(!err.contains("logicity repl") && !err.contains("unsupported"), "{err}");
        assert!(out.ends_with("0 rows\n0 rows\n"), "both questions are answered: {out}");
        assert_eq!(code, 1);
    }
    // Another fault keeps its message.
    let (_, err, _) = typed(&format!("{GRAPH}Edge(1\n?- Edge(x, y)\n"));
    assert!(err.contains("expected `,` or `)`") && !err.contains("lacks"), "{err}");
    let (_, err, _) = typed(&format!("{GRAPH}Edge(1, 2)\n.help\n"));
    assert!(err.contains("the clause before lacks a full stop"), "{err}");
    // A comment may contain any line, and an aggregate may continue with a word.
    assert!(good(&format!("{GRAPH}Edge(1, 2). /* so:\n?- Edge\n*/\n?- Edge(1, 2)\n")).ends_with("true\n"));
    let out = good(".decl N(x: number)\nN(3).\n?- N(\nquit\n), quit < 4.\n");
    assert!(out.ends_with("1 row\n"), "{out}");
}

#[test]
fn words_without_their_full_stop_are_hinted_at() {
    for (word, meant) in [
        ("quit", ".quit"),
        ("help", ".help"),
        ("exit", ".quit"),
        ("quit.", ".quit"),
    ] {
        let (out, err, code) = typed(&format!("{GRAPH}{word}\nEdge(1, 2)\n{word}\n?- Edge(x, y)\n"));
        assert_eq!(err.matches(&format!("type `{meant}`")).count(), 2, "{word}: {err}");
        assert!(err.contains("the clause before lacks a full stop"), "{word}: {err}");
        assert!(out.ends_with("0 rows\n") && code == 1, "{word}: {out}");
    }
    // A predicate may have such a name.
    assert!(good(".decl help(x: number)\nhelp(1).\n?- help(x)\n").ends_with("1 row\n"));
}

#[test]
fn words_of_other_prompts_are_reported() {
    for (input, meant) in [
        (".why Path(1, 2)", "explain FACT"),
        ("why Path(1, 2)", "explain FACT"),
        (".whynot Path(1, 2).", "why-not FACT"),
        ("exit", ".quit"),
        (".tables", ".predicates"),
    ] {
        let (_, err, code) = typed(&format!("{GRAPH}{input}\n?- Edge(1, 2)\n"));
        assert!(
            err.contains("no command `") && err.contains(&format!("type `{meant}`")),
            "{input}: {err}"
        );
        assert_eq!(code, 1);
    }
    assert_eq!(
        good(".decl why(x: number)\nwhy(1).\n?- why(x).\n"),
        "why +1\nx\n-\n1\n1 row\n"
    );
}

#[test]
fn reloading_reports_replaced_rows() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("p.dl");
    let text = |fact: &str| format!(".decl E(x: symbol)\n.decl P(x: symbol)\n{fact}\nP(x) :- E(x).\n");
    fs::write(&path, text("E(\"a\"). E(\"b\").")).unwrap();
    fs::write(folder.path().join("new.dl"), text("E(\"c\"). E(\"b\").")).unwrap();
    let mut process = Command::new(env!("CARGO_BIN_EXE_logicity"))
        .args(["repl", "p.dl"])
        .current_dir(folder.path())
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut input = process.stdin.take().unwrap();
    let mut output = BufReader::new(process.stdout.take().unwrap());
    let mut line = String::new();
    input.write_all(b"?- E(\"a\")\n").unwrap();
    output.read_line(&mut line).unwrap();
    fs::rename(folder.path().join("new.dl"), &path).unwrap();
    input.write_all(b".reload\n").unwrap();
    output.read_line(&mut line).unwrap();
    drop(input);
    assert!(process.wait().unwrap().success());
    assert_eq!(line, "true\nE +1 -1, P +1 -1\n");
}

#[test]
fn endless_recursion_reaches_a_limit_and_changes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let input = ".decl N(x: number)\nN(1).\nN(x * 3 + 1) :- N(x).\n?- N(x).\n";
    let (out, err, code) = typed_in(folder.path(), &["--max-rows", "1000"], input);
    assert!(err.contains("error[limit-exceeded]"), "{err}");
    assert_eq!((out.as_str(), code), ("N +1\nx\n-\n1\n1 row\n", 1));
}

#[test]
fn typed_facts_and_facts_of_a_file_are_retracted_together_or_not_at_all() {
    let folder = tempfile::tempdir().unwrap();
    let rules = ".decl N(x: number)\n.decl Off(x: number)\n.decl Pair(x: number, y: number)\n\
                 Off(1).\nPair(x, y) :- N(x), N(y), !Off(1).\n";
    fs::write(folder.path().join("pairs.dl"), rules).unwrap();
    let facts: String = (1..=40).map(|n| format!("N({n}). ")).collect();
    let input = format!("{facts}\nretract N(1). Off(1).\n?- N(1), Off(1).\n");
    let (out, err, code) = typed_in(folder.path(), &["--max-rows", "1000", "pairs.dl"], &input);
    assert!(err.contains("limit-exceeded"), "{err}");
    assert_eq!((out.lines().last(), code), (Some("true"), 1), "{out}");
}

#[test]
fn the_prompt_lists_rules_facts_and_plans() {
    let out = good(&format!(
        "{GRAPH}Edge(1, 2).\n.predicates\n.show Path\n.plan\n.plan ?- Path(1, x).\n.profile\n.help\n"
    ));
    for words in [
        "   1  Path(x: number, y: number)  derived",
        "/// There is a path from x to y.",
        "Path(x, z) :- Path(x, y), Edge(y, z).    <input 4>:1:1",
        "for the new rows of Path",
        "scan   Path(1, x) by x",
        "rows scanned",
        "why-not FACT",
    ] {
        assert!(out.contains(words), "`{words}` is missing in\n{out}");
    }
}

#[test]
fn query_explains_a_fact() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(
        folder.path().join("g.dl"),
        format!("{GRAPH}Edge(1, 2). Edge(2, 3).\n.output Path"),
    )
    .unwrap();
    let query = |arguments: &[&str]| {
        let output = logicity(&[&["query", "g.dl"], arguments].concat(), folder.path(), "");
        let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
        (text(output.stdout), text(output.stderr), output.status.code().unwrap())
    };
    let (out, _, code) = query(&["--explain", "Path(1, 3)"]);
    assert!(
        code == 0 && out.starts_with("Path(1, 3)  by") && out.contains("Edge(2, 3)"),
        "{out}"
    );
    let (out, _, code) = query(&["--explain", "Path(3, _)"]);
    assert!(
        code == 0 && out.starts_with("Path(3, _) does not hold, because:\n"),
        "{out}"
    );
    let (out, _, code) = query(&["--why-not", "Path(3, 1)."]);
    assert!(
        code == 0 && out.starts_with("Not(Path(3, 1)): no clause of Path holds"),
        "{out}"
    );
    let (out, _, code) = query(&["--why-not", "Path(1, 2)", "--json"]);
    let printed: serde_json::Value = serde_json::from_str(&out).unwrap();
    assert_eq!((code, printed["holds"].as_bool()), (0, Some(true)));
    assert_eq!(printed["nodes"][0]["holds"], "Path(1, 2)");
    let (_, err, code) = query(&["--explain", "Path(1, two)"]);
    assert!(
        code == 2 && err.contains("<--explain>:1:9") && err.contains("error[invalid-fact]"),
        "{err}"
    );
    let (_, err, code) = query(&["--json"]);
    assert!(code == 2 && err.contains("--explain"), "{err}");
    assert_eq!(
        fs::read_dir(folder.path()).unwrap().count(),
        1,
        "no results are written"
    );
}

/// A pseudoterminal with the prompt, and its output.
#[cfg(unix)]
mod terminal {
    use super::*;
    use std::fs::File;
    use std::io::Read;
    use std::sync::mpsc::{Receiver, channel};
    use std::time::Duration;

    struct Terminal {
        keys: File,
        shown: Receiver<Vec<u8>>,
        process: std::process::Child,
        seen: String,
    }

    impl Terminal {
        fn open(state: &Path) -> Terminal {
            let pair = nix::pty::openpty(None, None).unwrap();
            let side = || Stdio::from(pair.slave.try_clone().unwrap());
            let process = Command::new(env!("CARGO_BIN_EXE_logicity"))
                .arg("repl")
                .env("XDG_STATE_HOME", state)
                .env("TERM", "xterm")
                .stdin(side())
                .stdout(side())
                .stderr(side())
                .spawn()
                .unwrap();
            let keys = File::from(pair.master);
            let mut screen = keys.try_clone().unwrap();
            let (sender, shown) = channel();
            std::thread::spawn(move || {
                let mut bytes = [0; 4096];
                while let Ok(count) = screen.read(&mut bytes) {
                    if count == 0 || sender.send(bytes[..count].to_vec()).is_err() {
                        break;
                    }
                }
            });
            Terminal {
                keys,
                shown,
                process,
                seen: String::new(),
            }
        }

        fn press(&mut self, keys: &str) {
            self.keys.write_all(keys.as_bytes()).unwrap();
        }

        /// Waits until the terminal has shown these words, and forgets the output before them.
        fn sees(&mut self, words: &str) -> String {
            loop {
                if let Some(at) = self.seen.find(words) {
                    return self.seen.drain(..at + words.len()).collect();
                }
                match self.shown.recv_timeout(Duration::from_secs(60)) {
                    Ok(bytes) => self.seen += &String::from_utf8_lossy(&bytes),
                    Err(error) => panic!("the terminal does not show `{words}` ({error}): {:?}", self.seen),
                }
            }
        }
    }

    #[test]
    fn a_terminal_has_completion_history_colors_and_an_exit() {
        let folder = tempfile::tempdir().unwrap();
        let mut terminal = Terminal::open(folder.path());
        terminal.sees("> ");
        terminal.press(".decl Reachable(x: number)\r");
        terminal.sees("> ");
        terminal.press("Reach\t(7).\r");
        terminal.sees("Reachable +1");
        terminal.sees("> ");
        // Incomplete input continues in the next line, and Ctrl-C discards it.
        terminal.press("Reachable(8\r");
        terminal.sees("| ");
        terminal.press("\u{3}");
        terminal.sees("> ");
        // So does a lone word, which gets a hint.
        terminal.press("Reachable(8)\r");
        terminal.sees("| ");
        terminal.press("quit\r");
        terminal.sees("lacks a full stop");
        terminal.sees("type `.quit`");
        terminal.sees("> ");
        // So does a command.
        terminal.press("Reachable(9\r");
        terminal.sees("| ");
        terminal.press(".help\r");
        terminal.sees("error[syntax]");
        terminal.sees("The prompt `| ` continues an incomplete input");
        terminal.sees("> ");
        terminal.press("Reachable(\r");
        terminal.sees("| ");
        terminal.press("\"a\").\r");
        let shown = terminal.sees("type-mismatch");
        assert!(shown.contains("\u{1b}["), "without color: {shown:?}");
        terminal.sees("<input 7>");
        terminal.sees("> ");
        terminal.press("?- Reachable(x).\r");
        terminal.sees("1 row");
        terminal.sees("> ");
        terminal.press("\u{4}");
        assert!(
            terminal.process.wait().unwrap().success(),
            "a fault at a terminal does not change the exit code"
        );
        let history = fs::read_to_string(folder.path().join("logicity/history")).unwrap();
        assert!(
            history.contains("Reachable(7).") && !history.contains("Reachable(8\n"),
            "{history}"
        );
        assert!(
            history.contains("Reachable(\\n\"a\")."),
            "one entry for both lines: {history}"
        );

        let mut terminal = Terminal::open(folder.path());
        terminal.sees("> ");
        // The key for the previous input.
        terminal.press("\u{1b}[A\r");
        terminal.sees("unknown-predicate");
        terminal.sees("> ");
        terminal.press(".quit\r");
        assert!(terminal.process.wait().unwrap().success());
    }

    #[test]
    fn a_long_evaluation_is_announced() {
        let folder = tempfile::tempdir().unwrap();
        let mut terminal = Terminal::open(folder.path());
        terminal.sees("> ");
        terminal.press(".decl N(x: number)\r");
        terminal.sees("> ");
        terminal.press("N(x) :- x = range(1, 5000).\r");
        terminal.sees("N +4999");
        terminal.sees("> ");
        terminal.press("?- N(x), N(y), N(z), N(v), x * y + z * v = 0.\r");
        terminal.sees("still evaluating");
        terminal.process.kill().unwrap();
        terminal.process.wait().unwrap();
    }
}

const LIGHT: &str = "
.decl Button(x: symbol)
.decl Light(x: symbol)
Light(x) :- once[1,2] Button(x).
";

#[test]
fn ticks_pass() {
    let out = good(&format!(
        "{LIGHT}Button(\"hall\").\nretract Button(\"hall\")\n?- Light(x).\n.tick\n"
    ));
    // What counts is the end of a tick.
    assert_eq!(out, "Button +1\nButton -1\n0 rows\ntick 1\n");
    let out = good(&format!(
        "{LIGHT}Button(\"hall\").\n.tick\nretract Button(\"hall\")\n?- Light(x).\n.tick 2\n?- Light(x).\n"
    ));
    let row = "x\n----\nhall\n1 row\n";
    assert_eq!(
        out,
        format!("Button +1\ntick 1\nLight +1\nButton -1\n{row}tick 3\nLight -1\n0 rows\n")
    );
    let out = good(&format!(
        "{LIGHT}Button(\"hall\").\n.tick\n.tick\nLight(\"cellar\").\n?- Light(x).\n"
    ));
    assert!(out.contains("the rules have changed: tick 0 begins again"), "{out}");
    assert!(out.ends_with("x\n------\ncellar\n1 row\n"), "{out}");
    // The ticks before a failure stay.
    let folder = tempfile::tempdir().unwrap();
    let growing = ".decl N(n: number)\n.decl Pair(m: number, n: number)\nN(0).\nN(n) :- previous N(m), n = m + 1.\n\
                   Pair(m, n) :- N(m), N(n).\n.tick 100\n.tick 1\n";
    let (out, err, code) = typed_in(folder.path(), &["--max-rows", "50"], growing);
    let place = err.find("in tick ").expect("the error names the tick") + "in tick ".len();
    let failed: u32 = err[place..].split(';').next().unwrap().parse().unwrap();
    assert!((2..100).contains(&failed) && code == 1, "{out}{err}");
    assert!(
        err[place..].starts_with(&format!("{failed}; earlier ticks stay")),
        "{err}"
    );
    for (input, says) in [
        (".tick 0", "`0` is not a number of ticks"),
        (".tick x", "`x` is not"),
        ("next", "type `.tick`"),
    ] {
        let (_, err, code) = typed(&format!("{LIGHT}{input}\n"));
        assert!(err.contains(says) && code == 1, "{err}");
    }
}
