//! The rule language: rule files, fixtures, reference, round trip, hostile texts.

use crate::cases::cases;
use crate::pages::{blocks, pages};
use crate::root::root;
use crate::rule_files::RuleFiles;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use logicity_datalog as datalog;
use logicity_datalog::codes;
use logicity_datalog::diag::{self, Code, Diagnostic, Severity, Sources, Span, render};
use logicity_datalog::files::{BUILTIN_FOLDER, ReadError, ReadFile};
use logicity_datalog::{
    AggregateOp, Atom, Clause, Comparison, Functor, InputPolicy, Literal, Loaded, Rules, Term, ast, load, load_with,
    parse, print,
};
use proptest::prelude::*;

fn load_text(name: &str, text: &str) -> (Sources, Loaded) {
    let mut sources = Sources::new();
    let entry = sources.add(name, text);
    let loaded = load(&mut sources, entry, &RuleFiles);
    (sources, loaded)
}

/// The rules of a text without any diagnostic.
fn load_clean(name: &str, text: &str) -> Rules {
    let (sources, loaded) = load_text(name, text);
    assert!(
        loaded.diagnostics.is_empty(),
        "{}",
        render(&loaded.diagnostics, &sources, false)
    );
    let rules = loaded.rules.expect("no diagnostic, so there are rules");
    check_constraints(&rules);
    rules
}

fn load_rule_file(name: &str) -> Rules {
    let path = root().join("rules").join(name);
    load_clean(
        &path.display().to_string(),
        &std::fs::read_to_string(&path).expect("the file exists"),
    )
}

fn strata(rules: &Rules) -> Vec<Vec<&str>> {
    (rules.strata.iter())
        .map(|stratum| {
            stratum
                .predicates
                .iter()
                .map(|id| rules.predicates[id.index()].name.as_str())
                .collect()
        })
        .collect()
}

/// The help of a text's errors, without that of warnings.
fn helps(text: &str) -> Vec<String> {
    let (_, loaded) = load_text("main.dl", text);
    let errors = loaded.diagnostics.into_iter().filter(Diagnostic::is_error);
    errors.flat_map(|error| error.help).collect()
}

#[test]
fn habits_of_other_languages_are_reported_once_with_help() {
    const HEAD: &str = ".decl A, B(x: number)\n.input A\n.output B\n";
    for (written, help) in [
        ("B(x) :- A(x) and x < 2.", "commas"),
        ("B(x) :- A(x) AND A(x).", "commas"),
        ("B(x) :- A(x) & x < 2.", "commas"),
        ("B(x) :- A(x) && x < 2.", "commas"),
        ("B(x) :- A(x) \u{2227} x < 2.", "commas"),
        ("B(x) :- A(x) or A(x).", "`;`"),
        ("B(x) :- A(x) | A(x).", "`;`"),
        ("B(x) :- A(x) || A(x).", "`;`"),
        ("B(x) :- A(x), NOT A(x).", "`!P(X)`"),
        ("B(x) :- A(x), NOT(A(x)).", "`!P(X)`"),
        ("B(x) :- A(x), \\+ A(x).", "`!P(X)`"),
        ("B(x) :- A(x), ~A(x).", "`!P(X)`"),
        ("B(x) :- A(x), \u{ac}A(x).", "`!P(X)`"),
        ("B(x) :- A(x), x == 1.", "equality is written `=`"),
        ("B(x) :- A(x), x =:= 1.", "equality is written `=`"),
        ("B(x) :- A(x), x is 1.", "equality is written `=`"),
        ("B(x) :- A(x), x <> 1.", "`!=`"),
        ("B(x) :- A(x), x \\= 1.", "`!=`"),
        ("B(x) :- A(x), x =\\= 1.", "`!=`"),
        ("B(x) :- A(x), x \u{2260} 1.", "`!=`"),
        ("B(x) :- A(x), x =< 1.", "`<=`"),
        ("B(x) :- A(x), x \u{2265} 1.", "`>=`"),
        ("B(x) :- A(x), x => 1.", "`>=`"),
        ("B(x) <- A(x).", "`:-`"),
        ("B(x) -> A(x).", "`:-`"),
        ("B(x) := A(x).", "`:-`"),
        ("B(x) \u{2190} A(x).", "`:-`"),
        ("B(x) <= A(x).", "`:-`"),
        ("B(x) if A(x).", "`:-`"),
        ("A(x) => B(x).", "the head of a clause comes first"),
        ("B(x) :- A(x)", "ends with a full stop"),
        ("B(x) :- A(x)\n.decl C(x: number)", "ends with a full stop"),
        ("B(1)\nB(2).", "ends with a full stop"),
        ("B(x) :- A(x), onec[1,10] A(x).", "did you mean `once`?"),
        ("B(x) :- A(x), Once[1,10] A(x).", "did you mean `once`?"),
        ("B(x) :- A(x), prev A(x).", "the temporal operator `previous`"),
        ("B(x) :- A(x) until B(x).", "temporal operators are about the past"),
        ("B(x) :- A(x), once(1, 10) A(x).", "in brackets: `once[1,10] P(x)`"),
        (
            "B(x) :- A(x), since[1,30] A(x).",
            "`P(x) since[1,30] Q(x)`; remove the comma before it",
        ),
        (
            "B(x) :- since[1,30] A(x).",
            "stands between two atoms: `P(x) since[1,30] Q(x)`",
        ),
        ("B(x) :- since A(x).", "stands between two atoms: `P(x) since Q(x)`"),
        (
            "B(x) :- A(x), sinc[1,30] A(x).",
            "did you mean `since`? It stands between two atoms",
        ),
        (
            "B(x) :- since(A(x), A(x)).",
            "stands between two atoms: `P(x) since Q(x)`",
        ),
        ("B(x) :- A(x) since(1, 3) A(x).", "in brackets: `P(x) since[1,10] Q(x)`"),
        (
            "B(x) :- A(x) sinc[1,30] A(x).",
            "did you mean the temporal operator `since`?",
        ),
        (
            "B(x) :- A(x) Since A(x).",
            "did you mean the temporal operator `since`?",
        ),
        (
            "B(x) :- A(x) onec[1,30] A(x).",
            "operator `once`? Write a comma before it",
        ),
        ("B(x) :- A(x) once[1,30] A(x).", "write a comma before it"),
        ("B(x) :- always[1,8] A(x).", "did you mean `historically`?"),
        ("B(x) :- A(x), !globally[1,8] A(x).", "did you mean `historically`?"),
        ("B(x) :- always A(x).", "the temporal operator `historically`"),
        ("B(x) :- eventually[1,8] A(x).", "did you mean `once`?"),
        ("B(x) :- sometime[1,8] A(x).", "did you mean `once`?"),
        ("B(x) :- past A(x).", "the temporal operator `once`"),
        ("B(x) :- last[1,8] A(x).", "`previous`, which has no window"),
        ("B(x) :- before A(x).", "the temporal operator `previous`"),
        ("B(x) :- yesterday A(x).", "the temporal operator `previous`"),
        ("B(x) :- A(x), next A(x).", "temporal operators are about the past"),
        (
            "B(x) :- A(x), xyzzy[1,8] A(x).",
            "the temporal operators are `previous`, `once`",
        ),
        ("B(x) :- A(x), once(A(x)).", "stands before its atom: `once[0,5] P(x)`"),
        (
            "B(x) :- A(x), once[0,n] A(x).",
            "whole numbers of ticks, such as `once[0,6]`",
        ),
        (
            "B(x) :- A(x), once[n,6] A(x).",
            "whole numbers of ticks, such as `once[0,6]`",
        ),
        (
            "B(x) :- A(x), once[0,6.5] A(x).",
            "whole numbers of ticks, such as `once[0,6]`",
        ),
        (
            "B(x) :- A(x), once[0..6] A(x).",
            "whole numbers of ticks, such as `once[0,6]`",
        ),
        (
            "B(x) :- A(x), once[0,] A(x).",
            "whole numbers of ticks, such as `once[0,6]`",
        ),
        ("B(x) :- A(x), for[x] A(x).", "such as `for[10]`"),
        ("B(x) :- A(x) since[0,x] A(x).", "such as `P(x) since[0,6] Q(x)`"),
        ("0,8 :: B(x) :- A(x).", "a decimal point, not a comma: `0.8`"),
        (".8 :: B(x) :- A(x).", "write `0.8`"),
        ("0.2 :: B(x); .8 :: B(x) :- A(x).", "write `0.8`"),
        ("B(x) :- A(x), to_float(x) < .5.", "write `0.5`"),
        (
            "B(x) :- A(x), to_float(x) < 0,5.",
            "a decimal point, not a comma: `0.5`",
        ),
        ("decl C(x: number)", "begins with a dot: `.decl`"),
        ("output A", "begins with a dot: `.output`"),
        (
            "include \"vocabulary.dl\"\nStop(X) :- IsCar(X).",
            "`.include \"vocabulary.dl\"`",
        ),
        (
            "import \"vocabulary.dl\"\nStop(X) :- IsCar(X).",
            "`.include \"vocabulary.dl\"`",
        ),
        ("B(x) :- A(x), x < 30.5.", "such as `30`, or convert `x`: `to_float(x)`"),
        (
            "B(x) :- A(x), x % 48 < \"20\".",
            "write the number without quotes: `20`",
        ),
        ("B(x) :- A(x), x = \"far\".", "convert `x`: `to_string(x)`"),
        (
            ".decl C(s: symbol)\n.input C\nB(1) :- C(s), s < 3.",
            "write `3` in quotes: `\"3\"`, or convert `s`: `to_number(s)`",
        ),
        (
            ".decl C(s: symbol)\n.input C\nB(x) :- A(x), C(s), x = s.",
            "convert `x`: `to_string(x)`, or convert `s`: `to_number(s)`",
        ),
        (
            ".decl C(s: symbol)\n.input C\nB(s) :- C(s).",
            "convert the value: `to_number(s)`",
        ),
        ("B(x) :- A(x), A(\"3\").", "write the number without quotes: `3`"),
        (
            ".decl C(s: symbol)\n.output C\nC(3) :- A(_).",
            "write `3` in quotes: `\"3\"`",
        ),
        ("B(x) :- A(x), x = 2 * \"3\".", "write the number without quotes: `3`"),
        (
            ".decl C(s: symbol)\n.output C\nC(cat(x, \"m\")) :- A(x).",
            "convert it: `to_string(x)`",
        ),
        ("B(x) :- A(x)).", "each `(` is closed before this `)`: remove it"),
        ("0.3 : B(x) :- A(x).", "two colons follow a probability"),
        ("30 :: B(x) :- A(x).", "write 30 percent as `0.3`"),
        ("1.3 :: B(x) :- A(x).", "from 0.0 to 1.0"),
        (
            ".type agent <: symbol\n.decl C(x: car)\n.input C",
            "`agent`; or declare it: `.type car <: symbol`",
        ),
    ] {
        let said = helps(&format!("{HEAD}{written}\n"));
        assert!(said.len() == 1 && said[0].contains(help), "{written}: {said:?}");
    }
    // Each suggestion is a literal that the same clause accepts.
    for (written, help) in [
        ("count(A(y)) > 2", "count : { A(y) }"),
        ("count(A(y))", "count : { A(y) } > 0"),
        ("2 < count(A(y), !A(3))", "count : { A(y), !A(3) }"),
        ("x = count(A(y))", "count : { A(y) }"),
        ("#count{y : A(y)} > 2", "count : { A(y) }"),
        ("x > #count { y : A(y), y > 1 }", "count : { A(y), y > 1 }"),
        ("x = #sum{y, z : A(y)}", "sum y : { A(y) }"),
        ("x < #max{y : A(y)}", "max y : { A(y) }"),
        ("forall(A(y), A(y))", "count : { A(y), Not(A(y)) } = 0"),
        ("Not(exists(A(y), A(3)))", "count : { A(y), A(3) } = 0"),
        ("!exists(A(y))", "count : { A(y) } = 0"),
        ("exists(A(_), A(3))", "A(_), A(3)"),
        ("forall(y, A(y))", "count : { A(y), Not(A(y)) } = 0"),
        ("forall(y: A(y))", "count : { A(y), Not(A(y)) } = 0"),
        ("exists(x, A(x))", "A(x)"),
        ("exists(x : A(x))", "A(x)"),
    ] {
        let said = helps(&format!("{HEAD}B(x) :- A(x), {written}.\n"));
        assert!(
            said.len() == 1 && said[0].contains(&format!("`{help}`")),
            "{written}: {said:?}"
        );
        let literal = match (
            help.starts_with('A'),
            help.contains(['>', '=']) && !help.contains("y >"),
        ) {
            (false, false) => format!("x = {help}"),
            _ => help.to_owned(),
        };
        // The advice keeps the variable of the author, even if it occurs only once.
        let literal = match literal.matches('y').count() {
            1 => literal.replace('y', "_"),
            _ => literal,
        };
        load_clean("main.dl", &format!("{HEAD}B(x) :- A(x), {literal}.\n"));
    }
    for (written, help) in [
        ("B(x) :- A(x), count(x) > 2.", "`n = count : { A(x, y) }`"),
        ("B(x) :- x = sum(A(y)).", "`n = sum y : { A(y) }`"),
        ("B(x) :- A(x), forall y: A(y).", "count the exceptions"),
        ("B(x) :- A(x), exists y (A(y)).", "existential"),
        ("B(x) :- A(x), exists y: A(y).", "existential"),
        ("B(x) :- A(x), \u{2200}Y A(Y).", "\"for all\" counts the exceptions"),
        ("B(x) :- A(x), \u{2200} y: A(y).", "\"for all\" counts the exceptions"),
        ("B(x) :- \u{2203}y (A(y)), A(x).", "existential"),
        ("B(x) :- A(x), \u{2204}y A(y).", "none exists"),
        ("Not(B(x)) :- A(x).", "clauses derive what holds"),
        ("!B(x) :- A(x).", "clauses derive what holds"),
        ("B(x) :- Is(prime)(x), A(x).", "one word"),
        (".decl Near(x, y)", "`.decl Near(x: symbol, y: symbol)`"),
        (".decl Near(x: number, y)", "`.decl Near(x: number, y: symbol)`"),
        (".decl Near(symbol, number)", "`.decl Near(x1: symbol, x2: number)`"),
        (
            ".include \"vocabulary.dl\"\n.decl Near(x, y)",
            "`.decl Near(x: agent, y: agent)`",
        ),
        (".decl C(x: number) provenance", "remove it"),
        ("B(x) :- A(x), match(\"[a\", to_string(x)).", "Rust's `regex`"),
    ] {
        let said = helps(&format!("{HEAD}{written}\n"));
        assert!(said.len() == 1 && said[0].contains(help), "{written}: {said:?}");
    }
    for (comments, note) in [
        ("% one\n% two\n", "is 1 more such line"),
        ("% one\n%\n%\n", "are 2 more such lines"),
    ] {
        let (_, loaded) = load_text("main.dl", &format!("{comments}{HEAD}B(x) :- A(x).\n"));
        assert_eq!(loaded.diagnostics[0].notes, [format!("there {note}")]);
    }
    // A predicate may have the name of a quantifier.
    load_clean(
        "main.dl",
        &format!("{HEAD}.decl exists(x: number)\n.input exists\nB(x) :- A(x), exists(x), !exists(3).\n"),
    );
    // Similar code in our syntax.
    load_clean(
        "main.dl",
        &format!("{HEAD}B(x) :- A(x), x <-1.\n.decl and(x: number)\n.output and\nand(x) :- A(x).\n"),
    );
}

#[test]
fn a_string_without_a_closing_quote_is_one_error() {
    const HEAD: &str = ".decl A, B(x: symbol)\n.input A\n.output B\n";
    for written in [
        "B(\"a).\nB(\"b\").",
        "B(\"a, \"b\").\nB(x) :- A(x).",
        "B(x) :- A(x), x = \"a.\n.decl C(x: symbol)",
        "B(x) :- A(x), match(\"a, x).\nB(x) :- A(x).",
        "B(x) :- A(\"a,\n    \"b\"), A(x).\nB(x) :- A(x).",
        ".include \"vocabulary.dl\nB(x) :- A(x).",
        ".input A(filename=\"a.csv)\nB(x) :- A(x).",
        ".pragma \"a\nB(x) :- A(x).",
    ] {
        let (sources, loaded) = load_text("main.dl", &format!("{HEAD}{written}\n"));
        let errors: Vec<&Diagnostic> = loaded.diagnostics.iter().filter(|one| one.is_error()).collect();
        assert!(
            errors.len() == 1 && errors[0].message.contains("closing quote"),
            "{written}\n{}",
            render(&loaded.diagnostics, &sources, false)
        );
    }
}

/// Variables of aggregates are no exception, unless a scope guards them.
#[test]
fn variables_of_aggregates_that_occur_once_are_reported() {
    const HEAD: &str = ".decl A(x: number, y: number)\n.input A\n.decl R(n: number)\n.output R\n";
    for (clause, lone) in [
        ("R(n) :- n = sum y : { A(x, y) }.", "x"),
        ("R(n) :- n = count : { A(x, y), x < 1 }.", "y"),
        (
            "R(x + 1) :- A(x, x), sum y : { A(_, y), A(z, _) } > count : { A(_, _) }.",
            "z",
        ),
        (
            "R(n) :- n = count : { A(_, k), k > max y : { A(k, y), A(_, w) } }.",
            "w",
        ),
        ("R(n) :- n = min y : { A(x, y) }.", "x"),
        ("R(x) :- n = min y : { A(x, y) }.", "n"),
        ("R(count : { A(x, _) }) :- A(_, _).", "x"),
        ("R(n) :- n = max x : { A(x, m), m = sum n : { A(n, _) } }.", ""),
        ("R(n) :- n = max x : { A(x, m), m = max n : { A(n, _) } }.", ""),
        ("R(n) :- n = max x : { A(x, m), m = max n + m : { A(n, m) } }.", ""),
        ("R(n) :- n = max x : { A(x, _), sum n : { A(n, _) } > 2 }.", ""),
        ("R(n) :- A(n, _) ; n = sum y : { A(x, y) }.", "x"),
        // Another variable than outside, where nothing else binds it.
        ("R(n) :- n = count : { A(n, _) }.", "n"),
        ("R(n) :- A(n, _), n = count : { A(n, _) }.", ""),
        ("R(n) :- n = max x : { A(_, n), x = n }.", ""),
        ("R(x) :- n = min y : { A(x, y) }, n > 0.", ""),
        ("R(n) :- A(x, _), n = sum y : { A(x, y) }.", ""),
        ("R(n) :- n = sum y : { A(_x, y) }.", ""),
    ] {
        let (sources, loaded) = load_text("main.dl", &format!("{HEAD}{clause}\n"));
        let found: Vec<&Diagnostic> = loaded.diagnostics.iter().collect();
        let messages: Vec<&str> = found.iter().map(|one| one.message.as_str()).collect();
        let expected = match lone {
            "" => Vec::new(),
            name => vec![format!("the variable `{name}` occurs only once")],
        };
        assert_eq!(
            messages,
            expected,
            "{clause}\n{}",
            render(&loaded.diagnostics, &sources, false)
        );
        let is_other = clause == "R(n) :- n = count : { A(n, _) }.";
        assert_eq!(found.iter().any(|one| !one.notes.is_empty()), is_other, "{clause}");
    }
    let city = ".include \"vocabulary.dl\"\n.decl Crowded(x: agent)\nCrowded(X) :- IsClose(X, _), count : { IsClose(X, Y) } > 3.\n\
                Stop(X) :- Crowded(X).\n";
    let (sources, loaded) = load_text("main.dl", city);
    assert!(
        loaded.diagnostics.is_empty(),
        "{}",
        render(&loaded.diagnostics, &sources, false)
    );
}

#[test]
fn suggestions_are_edits_that_remove_the_fault() {
    const HEAD: &str = ".decl Road, Way(x: symbol, y: symbol)\n.input Road\n.output Way\n";
    for (written, code, mended) in [
        (
            "Way(x, y) :- Raod(x, y), Raod(y, x).",
            "unknown-predicate",
            "Way(x, y) :- Road(x, y), Road(y, x).",
        ),
        (
            ".decl A(x: string)\nA(x) :- Road(x, _).",
            "unknown-type",
            ".decl A(x: symbol)\nA(x) :- Road(x, _).",
        ),
        (
            "Way(x, y) :- Road(x, z), Road(_, y).",
            "singleton-variable",
            "Way(x, y) :- Road(x, _), Road(_, y).",
        ),
        (
            "Way(x, x) :- Road(x, _), count : { Road(x, z) } > 1.",
            "singleton-variable",
            "Way(x, x) :- Road(x, _), count : { Road(x, _) } > 1.",
        ),
        (
            "Way(x, y) :- Road(x, y), x == y.",
            "syntax",
            "Way(x, y) :- Road(x, y), x = y.",
        ),
        (
            "Way(x, y) :- Road(x, y) and Road(y, x).",
            "syntax",
            "Way(x, y) :- Road(x, y) , Road(y, x).",
        ),
        ("Way(x, y) <- Road(x, y).", "syntax", "Way(x, y) :- Road(x, y)."),
        ("Way(x, y) if Road(x, y).", "syntax", "Way(x, y) :- Road(x, y)."),
        (
            "Way(x, y) :- Road(x, y), NOT Road(y, x).",
            "syntax",
            "Way(x, y) :- Road(x, y), not Road(y, x).",
        ),
        ("Way(x, y) :- Road(x, y)", "syntax", "Way(x, y) :- Road(x, y)."),
        (
            ".outptu Road\nWay(x, y) :- Road(x, y).",
            "syntax",
            ".output Road\nWay(x, y) :- Road(x, y).",
        ),
        ("Way(a, \"b\").", "unbound-variable", "Way(\"a\", \"b\")."),
        (
            ".include \"vocabulry.dl\"",
            "missing-include",
            ".include \"vocabulary.dl\"",
        ),
        (
            ".once\nWay(x, y) :- Road(x, y).",
            "ignored",
            "\nWay(x, y) :- Road(x, y).",
        ),
        (
            "Way(\"a\", \"b\").\nWay(\"a\", \"b\").",
            "duplicate-clause",
            "Way(\"a\", \"b\").\n",
        ),
    ] {
        let text = format!("{HEAD}{written}\n");
        let (sources, loaded) = load_text("main.dl", &text);
        let fault = loaded.diagnostics.iter().find(|fault| fault.code.name() == code);
        let fault = fault.unwrap_or_else(|| panic!("{written}\n{}", render(&loaded.diagnostics, &sources, false)));
        let mut edits = fault.fixes[0].edits.clone();
        edits.sort_by_key(|(span, _)| span.start);
        let mut fixed = text.clone();
        for (span, new) in edits.iter().rev() {
            fixed.replace_range(span.range(), new);
        }
        assert_eq!(fixed, format!("{HEAD}{mended}\n"), "{}", fault.message);
        let (_, loaded) = load_text("main.dl", &fixed);
        assert!(
            !loaded.diagnostics.iter().any(|fault| fault.code.name() == code),
            "{written}"
        );
    }
}

#[test]
fn parts_of_names_are_suggested() {
    let include = ".include \"vocabulary.dl\"\n";
    assert_eq!(
        helps(&format!("{include}Stop(X) :- Car(X).\n")),
        ["did you mean `IsCar`?"]
    );
    assert_eq!(
        helps(&format!("{include}Stop(X) :- Isambulence(X).\n")),
        ["did you mean `IsAmbulance`?"]
    );
    let said = helps(&format!("{include}Stop(X) :- Teleports(X).\n"));
    assert!(said.len() == 1 && !said[0].contains("vocabulary.dl"), "{said:?}");
    // A built-in file offers exactly the names that it declares.
    let include = "add `.include \"vocabulary.dl\"`, which declares it";
    let own = "declare it: `.decl Teleports(...)`, with `.input Teleports` if its facts are given, or include the file \
               that declares it";
    assert_eq!(helps("Stop(X) :- Teleports(X).\n"), [include, own]);
    let text = ".decl Near(x: agent)\n.output Near\nNear(X) :- IsCar(X), IsClose(X, _).\n";
    assert_eq!(helps(text), [include; 3]);
    let said = helps(".decl IsCars(x: symbol)\n.input IsCars\n.decl A(x: symbol)\n.output A\nA(x) :- IsCar(x).\n");
    assert_eq!(said, ["did you mean `IsCars`?", &format!("or {include}")]);
    // Without built-in files, the engine knows none.
    let mut sources = Sources::new();
    let entry = sources.add("main.dl", "Stop(X) :- IsCar(X).\n");
    let loaded = load(&mut sources, entry, &|_: &Path| Err(ReadError::NotFound));
    assert!(!format!("{:?}", loaded.diagnostics).contains("vocabulary"));
}

#[test]
fn a_variable_in_the_other_case_is_suggested() {
    let city = ".include \"vocabulary.dl\"\n.scope Sees\n";
    const HEAD: &str =
        ".decl A(x: symbol)\n.decl C(x: symbol, y: symbol)\n.input A, C\n.decl B(x: symbol)\n.output B\n";
    for (head, clause, expected) in [
        (city, "Slow(X) :- IsBus(X), IsCar(x).", vec![("x", "X")]),
        (city, "Slow(X) :- IsClose(X, Y), IsBus(y).", vec![("y", "Y")]),
        (city, "Slow(X) :- IsBus(X), IsCar(Y).", vec![]),
        (HEAD, "B(X) :- A(X), C(X, x).", vec![("x", "X")]),
        (HEAD, "B(X) :- C(X, Y), A(y).", vec![("Y", ""), ("y", "Y")]),
        (
            HEAD,
            "B(Car) :- A(Car), count : { C(car, _) } > 1.",
            vec![("car", "Car")],
        ),
    ] {
        let (_, loaded) = load_text("main.dl", &format!("{head}{clause}\n"));
        let said = loaded.diagnostics.iter().map(|fault| (&*fault.message, &fault.help));
        let wanted = expected.into_iter().map(|(name, twin)| {
            let plain = format!("write `_` or `_{name}` if its value does not matter");
            let help = match twin {
                "" => vec![plain],
                _ => vec![format!("did you mean `{twin}`?"), format!("or {plain}")],
            };
            (format!("the variable `{name}` occurs only once"), help)
        });
        let said: Vec<(String, Vec<String>)> = said.map(|(message, help)| (message.to_owned(), help.clone())).collect();
        assert_eq!(said, wanted.collect::<Vec<_>>(), "{clause}");
    }
}

/// Constants of an unknown type have no value, so clauses that differ in them are not compared.
#[test]
fn clauses_with_unknown_types_are_not_compared() {
    let text = ".decl A(x: symbol)\n.input A\n.decl B(x: symbol, h: string)\n.output B\n\
                B(x, \"Up\") :- A(x).\nB(x, \"Down\") :- A(x).\nB(\"a\", \"Up\").\nB(\"a\", \"Down\").\n";
    let (_, loaded) = load_text("main.dl", text);
    let said: Vec<&str> = loaded.diagnostics.iter().map(|fault| fault.code.name()).collect();
    assert_eq!(said, ["unknown-type"]);
}

/// Returns why a program does not derive a row of `P`, as text.
fn why_not(text: &str, value: i32) -> String {
    let (sources, loaded) = load_text("main.dl", text);
    let rules = loaded.rules.expect("no error");
    let id = rules.predicate("P").expect("declared");
    let mut session = datalog::Program::new(rules.clone()).expect("no error").session();
    session.commit().expect("few rows");
    let pattern = [Some(datalog::Value::number(value))];
    let found = session.explain_absence(id, &pattern).expect("few steps");
    let printer = datalog::explain::ExplanationPrinter::new(&rules, session.symbols(), &sources);
    printer.tree(&found.expect("no such row"))
}

#[test]
fn a_negative_proof_states_each_equation_once() {
    let text = ".decl A(i: number, n: number)\nA(0, 4). A(1, 5). A(2, 6).\n.decl P(n: number)\n.output P\n\
                P(n) :- A(i, n), i % 2 = 0, A(j, m), i % 2 = 0, j = i + 1, m % 2 = n % 2.\n";
    let tree = why_not(text, 5);
    for part in ["i % 2 = 1", "1 = 0 fails", "0 = 1 fails"] {
        assert_eq!(tree.matches(part).count(), 1, "{part}\n{tree}");
    }
}

/// Values of different types are no equal values, whatever their words are.
#[test]
fn the_nearest_binding_has_different_values_for_different_variables() {
    for other in [0, 2, 3, 4, 5, 6] {
        let text = format!(
            ".decl Near, Hit(x: number, y: number)\n.decl S(s: symbol)\n.decl P(x: number)\n.input Hit\n.output P\n\
             P(x) :- Near(x, y), S(s), Hit(x, y).\nNear(1, 1). Near(1, {other}). S(\"a\").\n"
        );
        let tree = why_not(&text, 1);
        assert!(
            tree.contains(&format!("nearest y = {other}, s = \"a\": Hit(1, {other})")),
            "{tree}"
        );
    }
}

#[test]
fn counted_nouns_agree_with_their_numbers() {
    assert_eq!(
        [0, 1, 2].map(|count| diag::counted(count, "row")),
        ["0 rows", "1 row", "2 rows"]
    );
    let notes = |text: &str| -> Vec<String> {
        let (_, loaded) = load_text("main.dl", text);
        loaded.diagnostics.into_iter().flat_map(|fault| fault.notes).collect()
    };
    let uses = |count: usize| ".decl A(x: symbol)\n.output A\n".to_owned() + &"A(x) :- Unheard(x).\n".repeat(count);
    assert_eq!(notes(&uses(5)), ["it is used in 1 more place"]);
    assert_eq!(notes(&uses(6)), ["it is used in 2 more places"]);
    let dead = |count: usize| {
        let clause = |at: usize| format!("A(x) :- B(x), C(x, {at}).\n");
        let clauses: String = (0..count).map(clause).collect();
        ".decl A, B(x: symbol)\n.output A\n.decl C(x: symbol, n: number)\n.input C\n".to_owned() + &clauses
    };
    assert_eq!(notes(&dead(5)), ["nor does 1 other clause"]);
    assert_eq!(notes(&dead(6)), ["nor do 2 other clauses"]);
}

#[test]
fn an_include_may_have_an_absolute_path() {
    let read = |path: &Path| match path.to_str() {
        Some("/shared/parts.dl") => Ok(".decl A(x: symbol)\n.input A\n".to_owned()),
        _ => Err(ReadError::NotFound),
    };
    let load = |included: &str| {
        let text = format!(".include \"{included}\"\n.output B\n.decl B(x: symbol)\nB(x) :- A(x).\n");
        let mut sources = Sources::new();
        let entry = sources.add("folder/main.dl", text);
        load(&mut sources, entry, &read).diagnostics
    };
    assert_eq!(load("/shared/parts.dl"), []);
    let missing = &load("/shared/other.dl")[0];
    assert_eq!(missing.code, codes::MISSING_INCLUDE);
    assert_eq!(missing.notes, ["looked for `/shared/other.dl`"]);
}

/// In a scope, the suggested atom restricts the rule no further than the scope does.
#[test]
fn unbound_variables_of_a_scope_are_bound_by_it() {
    let clause = |clause: &str| {
        let text = format!(".include \"vocabulary.dl\"\n.decl Near(x: agent, y: agent)\n{clause}\n");
        let (_, loaded) = load_text("main.dl", &text);
        let unbound = loaded
            .diagnostics
            .into_iter()
            .filter(|fault| fault.code == codes::UNBOUND_VARIABLE);
        unbound.flat_map(|fault| fault.help).collect::<Vec<String>>()
    };
    let add = |name: &str, atom: &str| format!("add a positive atom that binds `{name}`, such as `{atom}`");
    assert_eq!(clause("Slow(X) :- IsAmbulance(Y)."), [add("X", "Sees(X, X)")]);
    assert_eq!(clause("Near(X, Y) :- IsCar(X)."), [add("Y", "Sees(X, Y)")]);
    assert_eq!(clause("Slow(X) :- IsCar(X), Not(IsBus(Z))."), [add("Z", "Sees(X, Z)")]);
    // Without a scope, any predicate of the type may do.
    assert_eq!(
        clause(".scope\nSlow(X) :- IsAmbulance(Y)."),
        [add("X", "IsPedestrian(X)")]
    );
    // The same letter in the other case is probably the same variable.
    for (text, near, name) in [
        ("Slow(X) :- IsBus(X), Not(IsCar(x)).", "X", "x"),
        ("Slow(X) :- IsBus(x).", "x", "X"),
    ] {
        let or = format!(
            "or {}",
            add(name, if name == "X" { "Sees(X, X)" } else { "Sees(X, x)" })
        );
        assert_eq!(clause(text), [format!("did you mean `{near}`?"), or]);
    }
}

/// A name such as `Car_2` is probably a constant without its quotes, on either side of an equation.
#[test]
fn a_name_like_a_constant_is_quoted_in_the_help() {
    const HEAD: &str =
        ".decl A(x: symbol)\n.decl B(x: symbol)\n.decl C(x: symbol, y: symbol)\n.input A, C\n.output B\n";
    for (body, help) in [
        ("A(x), x = Car_2", "`x = \"Car_2\"`"),
        ("A(x), Car_2 = x", "`\"Car_2\" = x`"),
        ("A(x), C(x, Car_2), Car_2 = y", "`\"Car_2\" = y`"),
        ("A(x), C(x, Car_2), y = Car_2", "`y = \"Car_2\"`"),
        ("A(x), Car_2 = y", "the symbol `Car_2`, write it in quotes: `\"Car_2\"`"),
        ("A(x), y = Car_2", "the symbol `Car_2`, write it in quotes: `\"Car_2\"`"),
        (
            "A(x), x != Car_2",
            "the symbol `Car_2`, write it in quotes: `\"Car_2\"`",
        ),
        (
            "A(x), !C(x, Car_2)",
            "the symbol `Car_2`, write it in quotes: `\"Car_2\"`",
        ),
    ] {
        let (_, loaded) = load_text("main.dl", &format!("{HEAD}B(x) :- {body}.\n"));
        let said: Vec<String> = loaded.diagnostics.into_iter().flat_map(|fault| fault.help).collect();
        assert!(said[0].contains(help), "{body}: {said:?}");
        // No advice about the other side.
        let other = said.iter().any(|help| help.contains("`y`") || help.contains("\"y\""));
        assert!(!other, "{body}: {said:?}");
        if !body.contains('y') {
            let quoted = body.replace("Car_2", "\"Car_2\"");
            load_clean("main.dl", &format!("{HEAD}B(x) :- {quoted}.\n"));
        }
    }
}

#[test]
fn a_missing_include_suggests_a_similar_file() {
    for (written, meant) in [
        ("vocabulary", "vocabulary.dl"),
        ("vocabulry.dl", "vocabulary.dl"),
        ("vocabulry", "vocabulary.dl"),
        ("Easy.dl", "easy.dl"),
    ] {
        let said = helps(&format!(".include \"{written}\"\n"));
        assert_eq!(said, [format!("did you mean `{meant}`?")], "{written}");
    }
    assert_eq!(helps(".include \"something-else.dl\""), [""; 0]);
    assert_eq!(helps(".include \"/rules/other.dl\""), [""; 0]);
    let wanted = "write the path from the folder of this file, or name a folder with the option `-I`";
    assert_eq!(helps("#include \"rules/other.dl\""), [wanted]);
}

#[test]
fn a_cycle_is_reported_once_with_help() {
    let text = ".decl A, B, C(x: number)\n.input A\n.output B, C\nB(x) :- A(x), !C(x).\nC(x) :- A(x), !B(x).\n";
    let said = helps(text);
    assert!(
        said.len() == 1 && said[0].contains("define `C` without `B`"),
        "{said:?}"
    );
}

#[test]
fn all_rule_files_load_without_a_diagnostic() {
    let mut count = 0;
    for entry in std::fs::read_dir(root().join("rules")).expect("rules/ exists") {
        let name = entry
            .expect("a readable folder")
            .file_name()
            .into_string()
            .expect("UTF-8");
        if name.ends_with(".dl") {
            load_rule_file(&name);
            count += 1;
        }
    }
    assert_eq!(count, 20);
}

#[test]
fn stopping_comes_before_slowing_before_speeding() {
    assert_eq!(
        strata(&load_rule_file("expert.dl")),
        [["Stop"], ["Slow"], ["Fast"], ["Normal"]]
    );
    assert_eq!(strata(&load_rule_file("easy.dl")), [["Stop"], ["Normal"]]);
}

// --- fixtures with expected diagnostics

/// Loads the first of some files; the others are in the same folder. A text that expects `extended-input` loads as for
/// `query`.
fn load_files(files: &[(String, String)]) -> (Sources, Loaded) {
    let read_one = |path: &Path| {
        let clean: PathBuf = path
            .components()
            .filter(|part| *part != std::path::Component::CurDir)
            .collect();
        let name = clean.to_string_lossy();
        let name = name.strip_prefix("x/../").unwrap_or(&name);
        match files.iter().find(|(file, _)| file == name) {
            Some((_, text)) => Ok(text.clone()),
            None => RuleFiles.read(path),
        }
    };
    let mut sources = Sources::new();
    let entry = sources.add(files[0].0.as_str(), files[0].1.as_str());
    let inputs = match files.iter().any(|(_, text)| text.contains("warning[extended-input]")) {
        true => InputPolicy::Extensible,
        false => InputPolicy::Fixed,
    };
    let loaded = load_with(&mut sources, entry, &read_one, inputs);
    (sources, loaded)
}

/// Splits a text at the lines `// file: NAME`.
fn split_files(name: &str, text: &str) -> Vec<(String, String)> {
    let mut files = vec![(name.to_owned(), String::new())];
    for line in text.lines() {
        if let Some(name) = line.strip_prefix("// file: ") {
            files.push((name.to_owned(), String::new()));
        } else {
            let (_, text) = files.last_mut().expect("not empty");
            text.push_str(line);
            text.push('\n');
        }
    }
    files
}

/// An expectation for a line: `error[code]: part of the message`, `warning[code]`, `label[code]: part of the label`.
#[derive(Debug)]
struct Expectation {
    file: String,
    line: usize,
    kind: String,
    code: String,
    part: String,
}

fn expectations(file: &str, text: &str) -> Vec<Expectation> {
    let mut found = Vec::new();
    for (index, line) in text.lines().enumerate() {
        let Some(at) = ["// error[", "// warning[", "// label["]
            .iter()
            .filter_map(|mark| line.find(mark))
            .min()
        else {
            continue;
        };
        let marks = line[at + 3..]
            .replace(", error[", "\0error[")
            .replace(", warning[", "\0warning[");
        for mark in marks.replace(", label[", "\0label[").split('\0') {
            let (kind, rest) = mark.split_once('[').expect("a mark has a bracket");
            let (code, part) = rest.split_once(']').expect("a mark has both brackets");
            found.push(Expectation {
                file: file.to_owned(),
                line: index + 1,
                kind: kind.to_owned(),
                code: code.to_owned(),
                part: part.trim_start_matches(':').trim().to_owned(),
            });
        }
    }
    found
}

/// Checks that the diagnostics are exactly the expected ones of each line. There may be further labels.
fn check_expectations(what: &str, files: &[(String, String)]) -> Result<(), String> {
    let (sources, loaded) = load_files(files);
    let drawn = render(&loaded.diagnostics, &sources, false);
    let expected: Vec<Expectation> = files.iter().flat_map(|(name, text)| expectations(name, text)).collect();
    let matches = |expectation: &Expectation, diagnostic: &Diagnostic| {
        if diagnostic.code.name() != expectation.code {
            return false;
        }
        let on_line = |span| {
            let name = Path::new(sources.name(span))
                .file_name()
                .map(|name| name.to_string_lossy().into_owned());
            name.as_deref() == Path::new(&expectation.file).file_name().and_then(|name| name.to_str())
        };
        if expectation.kind == "label" {
            return diagnostic.secondary.iter().any(|label| {
                on_line(label.span.source)
                    && sources.position(label.span).line == expectation.line
                    && label.message.contains(&expectation.part)
            });
        }
        let severity = if expectation.kind == "error" {
            Severity::Error
        } else {
            Severity::Warning
        };
        diagnostic.severity() == severity
            && diagnostic.message.contains(&expectation.part)
            && diagnostic.primary.as_ref().is_some_and(|label| {
                on_line(label.span.source) && sources.position(label.span).line == expectation.line
            })
    };
    let mut met = vec![false; loaded.diagnostics.len()];
    for expectation in &expected {
        let index = loaded.diagnostics.iter().enumerate().position(|(index, diagnostic)| {
            (expectation.kind == "label" || !met[index]) && matches(expectation, diagnostic)
        });
        let index = index.ok_or_else(|| format!("{what}: not met: {expectation:?}\n{drawn}"))?;
        if expectation.kind != "label" {
            met[index] = true;
        }
    }
    let unexpected: Vec<_> = (loaded.diagnostics.iter().zip(&met))
        .filter(|(_, met)| !**met)
        .map(|(one, _)| one.clone())
        .collect();
    if !unexpected.is_empty() {
        return Err(format!(
            "{what}: not expected:\n{}",
            render(&unexpected, &sources, false)
        ));
    }
    let failed = loaded.diagnostics.iter().any(Diagnostic::is_error);
    assert_eq!(
        loaded.rules.is_none(),
        failed,
        "{what}: there are rules if and only if there is no error"
    );
    Ok(())
}

/// The codes that the checker produces.
fn rule_codes() -> impl Iterator<Item = Code> {
    let others = [
        codes::INVALID_FACT,
        codes::FAILED_FUNCTOR,
        codes::CONSTRAINT_VIOLATION,
        codes::OLD_FORM,
        codes::CONTRADICTORY_BODY,
        codes::REDUNDANT_LITERAL,
        codes::REPEATED_BODY,
        codes::RULE_MISMATCH,
        diag::codes::CANCELLED,
    ];
    (diag::codes::CODES.iter().chain(datalog::codes::CODES).copied()).filter(move |code| !others.contains(code))
}

#[test]
fn each_code_has_a_fixture_that_produces_it() {
    let folder = root().join("tests/fixtures/diagnostics");
    let mut failures = Vec::new();
    for code in rule_codes() {
        let name = code.name();
        let mut files = Vec::new();
        let single = folder.join(format!("{name}.dl"));
        if single.exists() {
            files = split_files(
                &format!("{name}.dl"),
                &std::fs::read_to_string(&single).expect("a fixture can be read"),
            );
        } else {
            let path = folder.join(name).join("main.dl");
            let text = std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("no fixture for {name}: {error}"));
            files.push((path.display().to_string(), text));
        }
        failures.extend(check_expectations(name, &files).err());
        let marked = files.iter().flat_map(|(name, text)| expectations(name, text));
        assert!(
            marked.into_iter().any(|mark| mark.code == name && mark.kind != "label"),
            "{name}.dl expects no {name}"
        );
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}

// --- the paper's notation

/// The paper's table of clauses of the expert mode, as printed.
const PAPER: &str = r#"
.include "vocabulary.dl"
Stop(X):- Not(IsAmbulance(X)), Not(IsOld(X)), IsAtInter(X), IsInInter(Y).
Stop(X):- Not(IsAmbulance(X)), Not(IsOld(X)), IsAtInter(X), IsAtInter(Y), HigherPri(Y, X).
Stop(X):- Not(IsAmbulance(X)), Not(IsOld(X)), IsInInter(X), IsInInter(Y), IsAmbulance(Y).
Stop(X):- Not(IsAmbulance(X)), Not(IsPolice(X)), IsCar(X), Not(IsInInter(X)), Not(IsAtInter(X)), LeftOf(Y, X), IsClose(Y, X), IsPolice(Y).
Stop(X):- IsBus(X), Not(IsInInter(X)), Not(IsAtInter(X)), RightOf(Y, X), NextTo(Y, X), IsPedestrian(Y).
Stop(X):- IsAmbulance(X), RightOf(Y, X), IsOld(Y).
Stop(X):- Not(IsAmbulance(X)), Not(IsOld(X)), CollidingClose(X, Y).
Slow(X):- Not(Stop(X)), IsTiro(X), IsPedestrian(Y), IsClose(X, Y).
Slow(X):- Not(Stop(X)), IsTiro(X), IsInInter(X), IsAtInter(Y).
Slow(X):- Not(Stop(X)), IsPolice(X), IsYoung(Y), IsYoung(Z), NextTo(Y, Z).
Fast(X):- Not(Stop(X)), Not(Slow(X)), IsReckless(X), IsAtInter(Y).
Fast(X):- Not(Stop(X)), Not(Slow(X)), IsBus(X).
Fast(X):- Not(Stop(X)), Not(Slow(X)), IsPolice(X), IsReckless(Y).
"#;

/// The clauses of rules, sorted, without places and doc comments: one line each.
fn clause_lines(rules: &Rules) -> Vec<String> {
    let mut lines: Vec<String> = (rules.clauses.iter())
        .map(|clause| {
            let atom = |atom: &Atom| {
                let terms: Vec<String> = atom.terms.iter().map(|term| format!("{term:?}")).collect();
                format!("{}({})", rules.predicates[atom.predicate.index()].name, terms.join(","))
            };
            let mut body: Vec<String> = (clause.body.iter())
                .map(|literal| match literal {
                    Literal::Positive(one) => atom(one),
                    Literal::Negative(one) => format!("!{}", atom(one)),
                    Literal::Guard(one) => format!("guard {}", atom(one)),
                    Literal::Compare { op, left, right, .. } => format!("{left:?} {op} {right:?}"),
                    other => format!("{other:?}"),
                })
                .collect();
            body.sort();
            format!("{} :- {}", atom(&clause.head), body.join(", "))
        })
        .collect();
    lines.sort();
    lines
}

#[test]
fn the_papers_clauses_load_as_printed_and_equal_those_of_expert() {
    assert_eq!(
        clause_lines(&load_clean("paper.dl", PAPER)),
        clause_lines(&load_rule_file("expert.dl"))
    );
}

#[test]
fn rule_sets_nest_like_the_modes() {
    let clauses = |name| load_rule_file(name).clauses.len();
    // The default clause counts, too.
    assert_eq!(clauses("easy.dl"), 4);
    assert_eq!(clauses("medium.dl"), 7);
    assert_eq!(clauses("hard.dl"), 8);
    assert_eq!(clauses("expert.dl"), 14);
    assert_eq!(clauses("transfer-easy.dl"), 4);
    assert_eq!(clauses("transfer-medium.dl"), 6);
    assert_eq!(clauses("transfer-hard.dl"), 8);
    assert_eq!(clauses("vap-easy.dl"), 6);
    assert_eq!(clauses("vap-hard.dl"), 15);
}

#[test]
fn clauses_keep_their_doc_comments() {
    let rules = load_rule_file("expert.dl");
    let titles: Vec<&str> = rules
        .clauses
        .iter()
        .filter_map(|clause| clause.doc.split(':').next())
        .collect();
    assert_eq!(
        titles,
        [
            "N", "S1", "S2", "S3", "S6", "S7", "S5", "S4", "L1", "L2", "L3", "F1", "F2", "F3"
        ]
    );
}

// --- scope

/// The clauses of a text after `vocabulary.dl`, printed.
fn expanded(text: &str) -> Vec<String> {
    let rules = load_clean("main.dl", &format!(".include \"vocabulary.dl\"\n{text}"));
    let vocabulary = load_rule_file("vocabulary.dl").clauses.len();
    rules.clauses[vocabulary..]
        .iter()
        .map(|clause| written(&rules, clause))
        .collect()
}

fn written(rules: &Rules, clause: &Clause) -> String {
    let term = |term: &Term| match term {
        Term::Variable(id) => format!("{}{}", clause.variables[id.index()], id.0),
        Term::Constant(value) => format!("{}", value.0),
        Term::Wildcard => "_".to_owned(),
    };
    let atom = |atom: &Atom| {
        let terms: Vec<String> = atom.terms.iter().map(term).collect();
        format!(
            "{}({})",
            rules.predicates[atom.predicate.index()].name,
            terms.join(", ")
        )
    };
    let body: Vec<String> = (clause.body.iter())
        .map(|literal| match literal {
            Literal::Positive(one) => atom(one),
            Literal::Negative(one) => format!("!{}", atom(one)),
            Literal::Guard(one) => format!("[{}]", atom(one)),
            Literal::Compare { op, left, right, .. } => format!("{} {op} {}", term(left), term(right)),
            Literal::Compute {
                to, functor, arguments, ..
            } => {
                let arguments: Vec<String> = arguments.iter().map(term).collect();
                format!("{} = {}({})", term(to), functor.name(), arguments.join(", "))
            }
            Literal::Aggregate {
                to,
                op,
                atom: over,
                column,
                ..
            } => {
                format!("{} = {} {column:?} : {}", term(to), op.name(), atom(over))
            }
        })
        .collect();
    format!("{} :- {}", atom(&clause.head), body.join(", "))
}

#[test]
fn a_scope_guards_every_variable_except_the_heads_first() {
    assert_eq!(
        expanded("Stop(X) :- IsPolice(X), IsYoung(Y), IsYoung(Z), NextTo(Y, Z)."),
        ["Stop(X0) :- IsPolice(X0), IsYoung(Y1), IsYoung(Z2), NextTo(Y1, Z2), [Sees(X0, Y1)], [Sees(X0, Z2)]"]
    );
    assert_eq!(
        expanded("Stop(X) :- IsPolice(X), Not(IsBus(X))."),
        ["Stop(X0) :- IsPolice(X0), !IsBus(X0)"]
    );
    // A guard that the author wrote is not added again.
    assert_eq!(
        expanded("Stop(X) :- Sees(X, Y), IsBus(Y)."),
        ["Stop(X0) :- Sees(X0, Y1), IsBus(Y1)"]
    );
    assert_eq!(
        expanded(".scope\nStop(X) :- IsBus(X), IsBus(Y), Y != X."),
        ["Stop(X0) :- IsBus(X0), IsBus(Y1), Y1 != X0"]
    );
}

#[test]
fn under_a_scope_a_wildcard_ranges_over_the_view() {
    assert_eq!(
        expanded("Stop(X) :- IsClose(X, _)."),
        ["Stop(X0) :- IsClose(X0, _1), [Sees(X0, _1)]"]
    );
    assert_eq!(
        expanded("Stop(X) :- IsCar(X), Not(IsClose(_, X)).\nSlow(Y) :- IsBus(Y), !IsClose(_, Y)."),
        [
            "Stop(X0) :- IsCar(X0), !+1(X0)",
            "Slow(Y0) :- IsBus(Y0), !+1(Y0)",
            "+1(X0) :- IsClose(_1, X0), [Sees(X0, _1)]",
        ]
    );
    assert_eq!(
        expanded("Stop(X) :- IsCar(X), IsBus(Y), Not(IsClose(Y, _))."),
        [
            "Stop(X0) :- IsCar(X0), IsBus(Y1), !+1(X0, Y1), [Sees(X0, Y1)]",
            "+1(X0, Y1) :- IsClose(Y1, _2), [Sees(X0, _2)]",
        ]
    );
}

#[test]
fn a_scope_guards_no_other_types() {
    assert_eq!(
        expanded(
            ".decl Action(x: agent, v: number)\n.input Action\nStop(X) :- Action(X, V), Action(Y, W), V < W, Action(_, _)."
        ),
        ["Stop(X0) :- Action(X0, V1), Action(Y2, W3), V1 < W3, Action(_4, _), [Sees(X0, Y2)], [Sees(X0, _4)]"]
    );
}

// --- notation

/// The diagnostic of a long cycle shows some of its steps.
#[test]
fn long_cycles_through_negation_are_shortened() {
    let mut text = ".decl A(x: number) .input A\n".to_owned();
    for number in 0..5000 {
        let next = (number + 1) % 5000;
        text += &format!(".decl P{number}(x: number) P{number}(x) :- A(x), !P{next}(x).\n");
    }
    let found = load_text("cycle.dl", &text).1.diagnostics;
    let first = &found[0];
    assert!(first.message.ends_with(" and 4983 others"), "{}", first.message);
    assert_eq!(first.secondary.len(), 16);
    assert_eq!(first.notes[0], "4983 further steps of the cycle are not shown");
}

#[test]
fn negations_and_parentheses_fold() {
    let plain = expanded("Stop(X) :- IsCar(X), !IsBus(X), X != \"a\".");
    for text in [
        "Stop(X) :- IsCar(X), Not(IsBus(X)), Not(X = \"a\").",
        "Stop(X) :- Not(Not(IsCar(X))), not IsBus(X), !(X = \"a\").",
        "Stop(X) :- !!IsCar(X), not (IsBus(X)), not not X != \"a\".",
    ] {
        assert_eq!(expanded(text), plain, "{text}");
    }
}

#[test]
fn numbers_and_texts() {
    let rules = load_clean(
        "main.dl",
        ".decl N(x: number)\n.decl T(x: symbol)\nN(0x1F). N(0b101). N(-7). N(-2147483648). T(\"a\\n\\t\\\"\\\\'\u{e9}\").\n.output N, T",
    );
    let numbers: Vec<i32> = (rules.clauses.iter().take(4))
        .map(|clause| match clause.head.terms[0] {
            Term::Constant(value) => value.as_number(),
            _ => panic!("a fact has constants"),
        })
        .collect();
    assert_eq!(numbers, [31, 5, -7, i32::MIN]);
    assert!(rules.symbols.get("a\n\t\"\\'\u{e9}").is_some());
}

// --- printing and parsing

fn name() -> impl Strategy<Value = String> {
    "[a-zA-Z?_][a-zA-Z0-9_?]{0,5}".prop_filter("a word of the language", |name| {
        let words = [
            "_", "Not", "not", "as", "nil", "true", "false", "bnot", "lnot", "band", "bor", "bxor", "bshl", "bshr",
            "bshru", "land", "lor", "lxor", "min", "max", "sum", "count", "mean", "cat", "ord", "substr", "strlen",
            "match", "range", "brie", "btree", "magic", "inline",
        ];
        !words.contains(&name.as_str())
    })
}

fn place() -> ast::Place {
    let mut sources = Sources::new();
    ast::Place(Span::new(sources.add("", ""), 0..0))
}

fn node(text: String) -> ast::Name {
    ast::Name { text, place: place() }
}

fn doc() -> impl Strategy<Value = String> {
    prop_oneof![
        Just(String::new()),
        proptest::collection::vec("([a-z/*\"] ?){1,4}[a-z.]", 1..3).prop_map(|lines| lines.join("\n")),
        Just("one\n\n  three".to_owned()),
    ]
}

fn leaf() -> impl Strategy<Value = ast::Term> {
    prop_oneof![
        4 => name().prop_map(ast::TermKind::Variable),
        1 => Just(ast::TermKind::Wildcard),
        1 => (-i128::from(u64::MAX)..=i128::from(u64::MAX)).prop_map(ast::TermKind::Number),
        1 => any::<u64>().prop_map(ast::TermKind::Unsigned),
        1 => "-?[0-9]{1,3}\\.[0-9]{1,3}(e[+-]?[0-9])?".prop_map(ast::TermKind::Float),
        1 => any::<String>().prop_map(ast::TermKind::Symbol),
    ]
    .prop_map(|kind| ast::Term { kind, place: place() })
}

fn term() -> impl Strategy<Value = ast::Term> {
    let unary = proptest::sample::select(vec![Functor::Negate, Functor::BitNot, Functor::Not]);
    let binary = proptest::sample::select(vec![
        Functor::Add,
        Functor::Subtract,
        Functor::Multiply,
        Functor::Divide,
        Functor::Power,
        Functor::BitAnd,
        Functor::ShiftLeft,
        Functor::Or,
        Functor::Min,
        Functor::Cat,
    ]);
    let node = |kind| ast::Term { kind, place: place() };
    leaf().prop_recursive(4, 12, 2, move |inner| {
        let op = proptest::sample::select(vec![AggregateOp::Sum, AggregateOp::Min, AggregateOp::Count]);
        let body = proptest::collection::vec(simple(atom_of(inner.clone()), atom_of(leaf())), 1..3);
        prop_oneof![
            2 => (unary.clone(), inner.clone()).prop_map(move |(op, a)| node(ast::TermKind::Functor(op, vec![a]))),
            4 => (binary.clone(), inner.clone(), inner.clone())
                .prop_map(move |(op, a, b)| node(ast::TermKind::Functor(op, vec![a, b]))),
            1 => (inner.clone(), name()).prop_map(move |(a, ty)| {
                node(ast::TermKind::Cast(Box::new(a), ast::Name { text: ty, place: place() }))
            }),
            1 => (op, leaf(), body).prop_map(move |(op, target, body)| {
                let target = (op != AggregateOp::Count).then_some(target);
                node(ast::TermKind::Aggregate(Box::new(ast::Aggregate { op, target, body })))
            }),
        ]
    })
}

fn atom_of(term: impl Strategy<Value = ast::Term>) -> impl Strategy<Value = ast::Atom> {
    (name(), proptest::collection::vec(term, 0..4)).prop_map(|(predicate, terms)| ast::Atom {
        predicate: node(predicate),
        terms,
        place: place(),
    })
}

fn atom() -> impl Strategy<Value = ast::Atom> {
    atom_of(term())
}

/// An atom or a temporal literal, either negated or not.
fn simple(
    plain: impl Strategy<Value = ast::Atom>,
    held: impl Strategy<Value = ast::Atom>,
) -> impl Strategy<Value = ast::Literal> {
    let window = || (0..4_u32, 0..=1_000_000_u32).prop_map(|(first, last)| (first, first.max(last)));
    let operator = prop_oneof![
        Just((ast::Operator::Previous, Some((1, 1)))),
        proptest::option::of(window()).prop_map(|window| (ast::Operator::Once, window)),
        window().prop_map(|window| (ast::Operator::Historically, Some(window))),
        (0..1_000_000_u32).prop_map(|last| (ast::Operator::For, Some((0, last)))),
        proptest::option::of(window()).prop_map(|window| (ast::Operator::Since, window)),
    ];
    let time = prop_oneof![3 => Just(None), 1 => operator.prop_map(Some)];
    (any::<bool>(), plain, held, time).prop_map(|(negated, atom, held, time)| match time {
        None => ast::Literal::Atom { negated, atom },
        Some((operator, window)) => ast::Literal::Temporal {
            negated,
            temporal: Box::new(ast::Temporal {
                operator,
                window,
                held: (operator == ast::Operator::Since).then_some(held),
                atom,
                place: place(),
            }),
        },
    })
}

fn literal() -> impl Strategy<Value = ast::Literal> {
    let op = prop_oneof![
        Just(Comparison::Equal),
        Just(Comparison::NotEqual),
        Just(Comparison::Less),
        Just(Comparison::LessEqual),
        Just(Comparison::Greater),
        Just(Comparison::GreaterEqual),
        Just(Comparison::Match),
        Just(Comparison::NotContains),
    ];
    let plain = prop_oneof![
        3 => simple(atom(), atom()),
        1 => (op, term(), term()).prop_map(|(op, left, right)| {
            ast::Literal::Compare { op, left, right, place: place() }
        }),
    ];
    plain.prop_recursive(3, 8, 3, |inner| {
        let alternative = proptest::collection::vec(inner, 0..3);
        let alternatives = prop_oneof![
            1 => Just(Vec::new()),
            5 => proptest::collection::vec(alternative, 2..4),
        ];
        alternatives.prop_map(ast::Literal::Any)
    })
}

fn item() -> impl Strategy<Value = ast::Item> {
    let names = || proptest::collection::vec(name().prop_map(node), 1..3);
    let columns = proptest::collection::vec(
        (name(), name()).prop_map(|(name, ty)| ast::ColumnDecl {
            name: node(name),
            ty: node(ty),
        }),
        0..4,
    );
    let kind = prop_oneof![
        Just(ast::MarkKind::Input),
        Just(ast::MarkKind::Output),
        Just(ast::MarkKind::PrintSize)
    ];
    let others = || proptest::collection::vec(name(), 1..4);
    let options = || proptest::collection::vec((name(), any::<String>()), 0..3);
    let heads = || proptest::collection::vec(atom(), 1..3);
    let probabilities = proptest::option::weighted(0.2, proptest::array::uniform2(term()));
    let body = || proptest::collection::vec(literal(), 0..5);
    prop_oneof![
        1 => any::<String>().prop_map(|path| ast::Item::Include(ast::Include { path, place: place() })),
        1 => (name(), others(), any::<bool>(), doc()).prop_map(|(name, others, alias, doc)| {
            let mut others: Vec<ast::Name> = others.into_iter().map(node).collect();
            let definition = match (others.len(), alias) {
                (1, true) => ast::TypeDefinition::Alias(others.remove(0)),
                (1, false) => ast::TypeDefinition::Subtype(others.remove(0)),
                _ => ast::TypeDefinition::Union(others),
            };
            ast::Item::Type(ast::TypeDecl { name: node(name), definition, doc })
        }),
        2 => (names(), columns, any::<bool>(), doc()).prop_map(|(names, columns, inline, doc)| {
            let qualifiers = inline.then(|| node("inline".to_owned())).into_iter().collect();
            let choices = Vec::new();
            ast::Item::Decl(ast::Decl { names, columns: Some(columns), qualifiers, choices, doc })
        }),
        1 => (kind, names(), options()).prop_map(|(kind, names, options)| {
            let option = |(key, value)| ast::DirectiveOption { key: node(key), value, place: place() };
            ast::Item::Mark(ast::Mark { kind, names, options: options.into_iter().map(option).collect() })
        }),
        1 => proptest::collection::vec(any::<String>(), 1..3).prop_map(|words| {
            ast::Item::Pragma(ast::Pragma { words, place: place() })
        }),
        1 => proptest::collection::vec((0..9_i128, proptest::collection::vec(0..9_i128, 0..3)), 1..3).prop_map(|orders| {
            ast::Item::Plan(ast::Plan { orders, place: place() })
        }),
        1 => (0..ast::ConstraintKind::ALL.len(), name(), name()).prop_map(|(kind, one, other)| {
            let kind = ast::ConstraintKind::ALL[kind];
            ast::Item::Constraint(ast::ConstraintDecl { kind, names: vec![node(one), node(other)], place: place() })
        }),
        1 => proptest::option::of(name()).prop_map(|name| {
            ast::Item::Scope(ast::Scope { predicate: name.map(node), place: place() })
        }),
        6 => (heads(), probabilities, body(), doc()).prop_map(|(heads, probabilities, body, doc)| {
            let probabilities = probabilities.map_or_else(Vec::new, |each| each[..heads.len()].to_vec());
            ast::Item::Clause(ast::Clause { heads, probabilities, body, doc, place: place() })
        }),
    ]
}

proptest! {
    #![proptest_config(cases(256))]

    #[test]
    fn printed_rules_parse_to_the_same_rules(items in proptest::collection::vec(item(), 0..8)) {
        let file = ast::File { items };
        let text = print(&file);
        let mut sources = Sources::new();
        let id = sources.add("printed.dl", text.as_str());
        let parsed = parse(&sources, id);
        prop_assert!(parsed.diagnostics.is_empty(), "{}", render(&parsed.diagnostics, &sources, false));
        prop_assert_eq!(&parsed.file, &file);
        prop_assert_eq!(print(&parsed.file), text);
    }
}

#[test]
fn the_rule_files_survive_printing() {
    for entry in std::fs::read_dir(root().join("rules")).expect("rules/ exists") {
        let path = entry.expect("a readable folder").path();
        if path.extension().is_some_and(|extension| extension == "dl") {
            let mut sources = Sources::new();
            let id = sources.add(
                path.display().to_string(),
                std::fs::read_to_string(&path).expect("a rule file can be read"),
            );
            let parsed = parse(&sources, id);
            let again = sources.add("printed.dl", print(&parsed.file));
            assert_eq!(parse(&sources, again).file, parsed.file, "{}", path.display());
        }
    }
}

// --- hostile texts

/// Checks that the text loads without a panic, and that there are rules if and only if there is no error.
fn survives(text: &str) {
    let (sources, loaded) = load_text("hostile.dl", text);
    assert_eq!(
        loaded.rules.is_none(),
        loaded.diagnostics.iter().any(Diagnostic::is_error)
    );
    if text.len() < 10_000 {
        render(&loaded.diagnostics, &sources, false);
        loaded.rules.iter().for_each(check_constraints);
    }
}

/// Pieces of rules, and some that are not valid.
const PIECES: &[&str] = &[
    ".decl A(x: symbol)",
    ".decl B(x: number, y: symbol)",
    ".type t <: symbol",
    ".type u = t",
    ".type",
    ".decl",
    ".input A",
    ".output",
    ".scope B",
    ".scope",
    ".include \"vocabulary.dl\"",
    ".include",
    ".comp {",
    "}",
    "A(x)",
    "B(x, y)",
    "A(_)",
    "A(\"c\")",
    "B(1, \"c\")",
    " :- ",
    ", ",
    ".\n",
    ".",
    "Not(",
    "not ",
    "!",
    "(",
    ")",
    "x = y",
    "x < 3",
    "_",
    "\"",
    "/*",
    "*/",
    "//",
    "/// d\n",
    "\n",
    "-",
    "0x",
    "9999999999",
    "count : {",
    "sum x : { A(x) }",
    "min(x, 1)",
    "cat(x, \"a\")",
    "match(x, ",
    " + ",
    "x * 2 ^ y",
    "1.5e3",
    "7u",
    "-(",
    "bnot ",
    "as(x, t)",
    ".type v = t | u",
    "(IO=file, headers=true)",
    "true",
    "false",
    "[",
    ";",
    "<=",
    "\u{e9}",
    "\0",
    "|",
    "Sees(x, x)",
];

proptest! {
    #![proptest_config(cases(256))]

    #[test]
    fn any_bytes_load_without_a_panic(bytes in proptest::collection::vec(any::<u8>(), 0..300)) {
        survives(&String::from_utf8_lossy(&bytes));
    }

    #[test]
    fn any_order_of_pieces_loads_without_a_panic(
        pieces in proptest::collection::vec(proptest::sample::select(PIECES), 0..60)
    ) {
        survives(&pieces.concat());
    }

    #[test]
    fn mutated_rules_load_without_a_panic(
        changes in proptest::collection::vec(
            (any::<prop::sample::Index>(), proptest::sample::select(PIECES), 0_usize..12),
            1..12
        )
    ) {
        let mut text: Vec<char> = PAPER.chars().collect();
        for (at, piece, cut) in changes {
            let at = at.index(text.len());
            let end = (at + cut).min(text.len());
            text.splice(at..end, piece.chars());
        }
        survives(&text.into_iter().collect::<String>());
    }
}

/// Neither depth nor length exhausts the stack. `benches/engine.rs` measures the speed.
#[test]
fn slow_large_texts_are_loaded() {
    let many = 200_000;
    let decl = ".decl P(x: symbol)\n.decl Q(x: symbol, y: symbol)\n.input Q\n.output P\n";
    let chain: String = (0..20_000)
        .map(|at| format!(".decl C{at}(x: symbol)\nC{at}(x) :- C{}(x).\n", (at + 1) % 20_000))
        .collect();
    let types: String = (0..20_000).map(|at| format!(".type T{at} <: T{}\n", at + 1)).collect();
    let texts = [
        "(".repeat(many),
        "!".repeat(many),
        format!("P(x) :- {}", "Not(".repeat(many)),
        format!("{decl}P(x) :- {}Q(x, x).", "Q(x, x), ".repeat(many)),
        format!("{decl}P({}).", "1".repeat(many)),
        format!("{decl}P(\"{}\").", "\\q".repeat(many)),
        format!("{decl}P({}).", "x".repeat(many)),
        format!("{decl}{}(x) :- {0}(x).", "P".repeat(many)),
        format!("{decl}P(x) :- Q(x, {}).", "x, ".repeat(many)),
        format!(".decl W({})", "c: symbol, ".repeat(many)),
        format!("{decl}{}", "P(x) :- Q(x,. ".repeat(many)),
        format!("{decl}{}", ".pragma ".repeat(many)),
        format!("{decl}{}", "R(x). ".repeat(many)),
        format!("{decl}{}", "P(x) :- Q(x, _).\n".repeat(20_000)),
        format!(
            "{decl}{}",
            (0..many).map(|at| format!("P(\"{at}\").")).collect::<String>()
        ),
        (0..20_000)
            .map(|at| format!(".decl A{at}(x: symbol) A{at}(x) :- B{at}(x)."))
            .collect::<String>(),
        format!("{decl}P(x) :- Q(x, y), y = {}.", "1 + ".repeat(many)),
        format!("{decl}P({}).", "cat(".repeat(many)),
        format!("{decl}P(x) :- {}", "min(".repeat(many)),
        format!("{decl}P(x) :- {}", "count : { Q(x, x), ".repeat(many)),
        format!("{decl}P(x) :- {}.", "2 ^ ".repeat(many)),
        format!("{decl}P(x) :- {}Q(x, x).", "(Q(x, x); Q(x, _)), ".repeat(20)),
        format!("{decl}P(x) :- {}, false.", vec!["(Q(x, x); Q(x, _))"; 1_000].join(", ")),
        format!("{decl}P(x) :- Q(x, x){}.", "; Q(x, x)".repeat(many)),
        format!("{decl}P(cat({})).", vec!["to_string(1 + 1)"; 20_000].join(", ")),
        (0..20_000)
            .map(|at| format!(".type U{} = U{at} | symbol\n", at + 1))
            .collect::<String>(),
        (0..20_000)
            .map(|at| format!(".type U{at} = symbol | U{}\n", at + 1))
            .collect::<String>(),
        "\u{e9}".repeat(many),
        "/*".repeat(many),
        "///\n".repeat(many),
        chain.clone(),
        chain.replace(":- ", ":- !"),
        types,
    ];
    for text in texts {
        survives(&text);
    }
}

const EDGES: &str =
    ".decl E(x: symbol, y: symbol)\n.decl W(x: symbol, n: number)\n.input E, W\n.decl P(x: symbol)\n.output P\n";

/// The search compares a clause only with clauses that have all of its traits.
#[test]
fn comparing_twice_the_clauses_takes_little_more_than_twice_the_steps() {
    type Written = fn(usize) -> String;
    let kinds: [(&str, Written); 4] = [
        ("duplicate-clause", |_| "P(x) :- E(x, y), E(y, x).\n".to_owned()),
        ("none", |at| format!("P(x) :- W(x, n), n < {at}, E(x, _).\n")),
        ("none", |at| {
            format!("P(x) :- E(x, y), W(y, {at}), W(x, {}).\n", at * 7 + 1)
        }),
        ("subsumed-clause", |at| {
            format!("P(x) :- E(x, y), W(y, {}){}.\n", at / 2, ["", ", y != x"][at % 2])
        }),
    ];
    for (code, clause) in kinds {
        let [one, two] = [1_000, 2_000].map(|count| {
            let text = EDGES.to_owned() + &(0..count).map(clause).collect::<String>();
            let (_, loaded) = load_text("many.dl", &text);
            assert_eq!(
                loaded.diagnostics.is_empty(),
                code == "none",
                "{:?}",
                loaded.diagnostics
            );
            assert!(loaded.diagnostics.iter().all(|fault| fault.code.name() == code));
            assert!(loaded.compared.complete);
            loaded.compared.steps
        });
        assert!(two <= one * 5 / 2, "{code}: {one} and {two} steps");
    }
}

/// The search ends at its limit: it looks for a closed walk of nine steps in a graph whose closed walks have even
/// length.
#[test]
fn a_comparison_beyond_its_limit_is_reported() {
    let both = |a: String, b: String| format!("E({a}, {b}), E({b}, {a})");
    let graph: Vec<String> = (0..4)
        .flat_map(|a| (0..4).map(move |b| both(format!("a{a}"), format!("b{b}"))))
        .collect();
    let walk: Vec<String> = (0..9).map(|at| format!("E(c{at}, c{})", (at + 1) % 9)).collect();
    let clauses = [graph, walk].map(|body| format!("P({}) :- {}.\n", &body[0][2..4], body.join(", ")));
    let (_, loaded) = load_text("hard.dl", &(EDGES.to_owned() + &clauses.concat()));
    assert!(loaded.rules.is_some() && loaded.diagnostics.is_empty());
    assert!(!loaded.compared.complete);
}

/// The search finds a redundant clause anywhere among many others.
#[test]
fn redundant_clauses_are_found_anywhere() {
    let general = "P(x) :- E(x, y), W(y, 7).\n";
    let special = "P(a) :- W(c, 7), a != c, W(a, n), n < 9, E(a, c).\n";
    let others: Vec<String> = (0..200)
        .map(|at| format!("P(x) :- E(y, x), W(y, {at}), W(x, {}).\n", at + 1))
        .collect();
    for (first, second) in [(0, 200), (57, 58), (199, 3)] {
        let mut clauses = others.clone();
        clauses.insert(first, general.to_owned());
        clauses.insert(second, special.to_owned());
        let text = EDGES.to_owned() + &clauses.concat();
        let (_, loaded) = load_text("one.dl", &text);
        let [fault] = loaded.diagnostics.as_slice() else {
            panic!("{:?}", loaded.diagnostics)
        };
        let place = fault.primary.as_ref().expect("a clause").span;
        assert_eq!(fault.code, codes::SUBSUMED_CLAUSE);
        assert_eq!(text[place.start as usize..place.end as usize], *special.trim_end());
    }
}

#[test]
fn nested_includes_are_bounded() {
    // Every file includes another one.
    let endless = |path: &Path| match path.starts_with(BUILTIN_FOLDER) {
        true => Err(ReadError::NotFound),
        false => Ok(format!(
            ".include \"{}x\"",
            path.file_name().expect("a name").to_string_lossy()
        )),
    };
    let mut sources = Sources::new();
    let entry = sources.add("x", ".include \"xx\"");
    let loaded = load(&mut sources, entry, &endless);
    assert_eq!(loaded.diagnostics.len(), 1);
    assert_eq!(loaded.diagnostics[0].code, diag::codes::LIMIT_EXCEEDED);
}

// --- the reference

#[test]
fn every_block_of_the_reference_gives_the_diagnostics_it_expects() {
    let mut count = 0;
    let mut failures = Vec::new();
    for (page, text) in pages() {
        for block in blocks(&text).into_iter().filter(|block| block.kind == "dl") {
            let place = format!("{}:{}", page.display(), block.line);
            failures.extend(check_expectations(&place, &split_files("main.dl", &block.text)).err());
            count += 1;
        }
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
    assert!(count >= 15);
    println!("{count} blocks of rules load");
}

/// An aggregate's variable may be bound by a chain of equations in any order.
#[test]
fn an_aggregate_follows_equations_in_any_order() {
    let rules = [
        "R(x, n) :- x = y, x = c, A(c), n = count : { B(v), v < x }.",
        "R(x, n) :- A(c), x = y, x = c + 1, n = count : { B(v), v < x, v < y }.",
        "R(x, n) :- A(c), x = c + 1, x = y, n = count : { B(v), v < x, v < y }.",
    ];
    for rule in rules {
        let text = format!(".decl A, B(x: number) .input A, B .decl R(x: number, n: number) .output R {rule}");
        let (sources, loaded) = load_text("main.dl", &text);
        let said = render(&loaded.diagnostics, &sources, false);
        assert!(loaded.rules.is_some() && !said.contains("error"), "{said}");
    }
}

// --- redundant clauses

/// A small database: the rows of each predicate.
type Database = Vec<BTreeSet<Vec<u32>>>;

/// The rows that a clause derives, by trying every assignment of {0, 1, 2} to its variables.
fn derived(clause: &Clause, database: &Database) -> BTreeSet<Vec<u32>> {
    let count = u32::try_from(clause.variables.len()).expect("few variables");
    let mut heads = BTreeSet::new();
    for number in 0..3_u32.pow(count) {
        let values: Vec<u32> = (0..count).map(|at| number / 3_u32.pow(at) % 3).collect();
        let value = |term: &Term| match term {
            Term::Variable(id) => Some(values[id.index()]),
            Term::Constant(constant) => Some(constant.0),
            Term::Wildcard => None,
        };
        let holds = |atom: &Atom| {
            database[atom.predicate.index()].iter().any(|row| {
                row.iter()
                    .zip(&atom.terms)
                    .all(|(cell, term)| value(term).is_none_or(|value| value == *cell))
            })
        };
        let fires = clause.body.iter().all(|literal| match literal {
            Literal::Positive(atom) | Literal::Guard(atom) => holds(atom),
            Literal::Negative(atom) => !holds(atom),
            Literal::Compare { op, left, right, .. } => {
                let (left, right) = (value(left), value(right));
                match op {
                    Comparison::Equal => left == right,
                    Comparison::NotEqual => left != right,
                    Comparison::Less => left < right,
                    Comparison::LessEqual => left <= right,
                    Comparison::Greater => left > right,
                    Comparison::GreaterEqual => left >= right,
                    _ => false,
                }
            }
            Literal::Compute { .. } | Literal::Aggregate { .. } => false,
        });
        if fires {
            heads.insert(clause.head.terms.iter().filter_map(value).collect());
        }
    }
    heads
}

/// A clause for `P`. Variables in negated atoms and comparisons alone get a positive atom.
fn random_clause() -> impl Strategy<Value = String> {
    let symbol = || proptest::sample::select(vec!["x", "y", "z", "_", "\"a\""]);
    let bound = || proptest::sample::select(vec!["x", "y", "z", "\"a\""]);
    let number = || proptest::sample::select(vec!["n", "m", "0"]);
    let literal = prop_oneof![
        symbol().prop_map(|a| format!("A({a})")),
        (symbol(), symbol()).prop_map(|(a, b)| format!("B({a}, {b})")),
        (symbol(), number()).prop_map(|(a, n)| format!("V({a}, {n})")),
        (symbol(), symbol()).prop_map(|(a, b)| format!("!B({a}, {b})")),
        (bound(), bound()).prop_map(|(a, b)| format!("{a} != {b}")),
        (bound(), bound()).prop_map(|(a, b)| format!("{a} = {b}")),
        (
            number(),
            number(),
            proptest::sample::select(vec!["<", ">", "<=", ">=", "="])
        )
            .prop_map(|(a, b, op)| format!("{a} {op} {b}")),
    ];
    (proptest::collection::vec(literal, 1..4), any::<bool>()).prop_map(|(mut literals, constant)| {
        for name in ["y", "z", "n", "m"] {
            if literals.iter().any(|literal| literal.contains(name)) {
                literals.push(if "yz".contains(name) {
                    format!("A({name})")
                } else {
                    format!("V(_, {name})")
                });
            }
        }
        literals.push("A(x)".to_owned());
        format!(
            "P({}) :- {}.",
            if constant && literals.len() > 4 { "\"a\"" } else { "x" },
            literals.join(", ")
        )
    })
}

proptest! {
    #![proptest_config(cases(2048))]
    #[test]
    fn every_clause_reported_as_redundant_is_redundant(
        clauses in proptest::collection::vec(random_clause(), 2..5),
        scoped: bool,
        databases in proptest::collection::vec(any::<(u8, u16, u16)>(), 8),
    ) {
        let scope = if scoped { ".scope B" } else { "" };
        let text = format!(
            ".decl A(x: symbol)\n.decl B(x: symbol, y: symbol)\n.decl V(x: symbol, n: number)\n.decl P(x: symbol)\n\
             .input A, B, V\n.output P\n{scope}\n{}", clauses.join("\n"));
        let (_, loaded) = load_text("random.dl", &text);
        let Some(rules) = loaded.rules else { return Ok(()) };
        for diagnostic in &loaded.diagnostics {
            let equal = match diagnostic.code {
                codes::DUPLICATE_CLAUSE => true,
                codes::SUBSUMED_CLAUSE => false,
                _ => continue,
            };
            let at = |span: Span| rules.clauses.iter().find(|clause| clause.span == span).expect("the clause exists");
            let redundant = at(diagnostic.primary.as_ref().expect("it has a place").span);
            let other = at(diagnostic.secondary[0].span);
            for (a, b, v) in &databases {
                let pairs = |bits: u16| {
                    let set = (0..9).filter(move |at| bits >> at & 1 == 1);
                    set.map(|at| vec![at / 3, at % 3]).collect()
                };
                let mut database: Database = vec![BTreeSet::new(); rules.predicates.len()];
                database[0] = (0..3).filter(|at| a >> at & 1 == 1).map(|at| vec![at]).collect();
                database[1] = pairs(*b);
                database[2] = pairs(*v);
                let is_hidden = |clause: &&Clause| rules.predicates[clause.head.predicate.index()].hidden;
                for clause in rules.clauses.iter().filter(is_hidden) {
                    database[clause.head.predicate.index()] = derived(clause, &database);
                }
                let (redundant, other) = (derived(redundant, &database), derived(other, &database));
                prop_assert!(redundant.is_subset(&other), "{}\n{:?}", text, diagnostic);
                prop_assert!(!equal || redundant == other, "{}\n{:?}", text, diagnostic);
            }
        }
    }
}

// --- invariants of checked rules

/// The invariants of [`Rules`].
fn check_constraints(rules: &Rules) {
    let mut stratum_of = vec![None; rules.predicates.len()];
    for (number, stratum) in rules.strata.iter().enumerate() {
        assert!(!stratum.predicates.is_empty() && !stratum.clauses.is_empty());
        for id in &stratum.predicates {
            assert_eq!(
                stratum_of[id.index()].replace(number),
                None,
                "a predicate is in one stratum"
            );
        }
    }
    let hidden_from = rules
        .predicates
        .iter()
        .position(|predicate| predicate.hidden)
        .unwrap_or(rules.predicates.len());
    for (index, predicate) in rules.predicates.iter().enumerate() {
        assert_eq!(predicate.hidden, index >= hidden_from, "hidden predicates come last");
        let made = predicate.name.starts_with('+') || predicate.name.contains(' ');
        assert_eq!(predicate.hidden, made);
        assert_eq!(predicate.edb.is_some(), predicate.input && predicate.derived);
        let heads = || {
            rules
                .clauses
                .iter()
                .filter(|clause| clause.head.predicate.index() == index)
        };
        assert_eq!(predicate.derived, heads().any(|clause| !clause.body.is_empty()));
        assert_eq!(
            stratum_of[index].is_some(),
            heads().next().is_some(),
            "a stratum holds predicates with clauses"
        );
        for column in &predicate.columns {
            assert_eq!(column.base, rules.types[column.ty.0 as usize].base);
        }
    }
    for (index, clause) in rules.clauses.iter().enumerate() {
        let home = stratum_of[clause.head.predicate.index()].expect("checked above");
        let stratum = &rules.strata[home];
        assert_eq!(stratum.clauses.iter().filter(|id| id.index() == index).count(), 1);
        let mut bound = vec![false; clause.variables.len()];
        let mut used = bound.clone();
        let mut mark = |term: &Term| {
            if let Term::Variable(id) = term {
                used[id.index()] = true;
            }
        };
        let fits = |atom: &Atom| assert_eq!(atom.terms.len(), rules.predicates[atom.predicate.index()].arity());
        fits(&clause.head);
        assert!(!clause.head.terms.contains(&Term::Wildcard));
        clause.head.terms.iter().for_each(&mut mark);
        for literal in &clause.body {
            match literal {
                Literal::Positive(atom) | Literal::Guard(atom) => {
                    fits(atom);
                    atom.terms.iter().for_each(&mut mark);
                    assert!(stratum_of[atom.predicate.index()].is_none_or(|other| other <= home));
                    assert!(stratum_of[atom.predicate.index()] != Some(home) || stratum.recursive);
                    for term in &atom.terms {
                        if let Term::Variable(id) = term {
                            bound[id.index()] = true;
                        }
                    }
                }
                Literal::Negative(atom) => {
                    fits(atom);
                    atom.terms.iter().for_each(&mut mark);
                    assert!(stratum_of[atom.predicate.index()].is_none_or(|other| other < home));
                }
                Literal::Compare { left, right, .. } => {
                    [left, right].into_iter().for_each(&mut mark);
                    assert!(*left != Term::Wildcard && *right != Term::Wildcard);
                }
                Literal::Compute { arguments, .. } => {
                    literal.terms().for_each(&mut mark);
                    assert!(!arguments.contains(&Term::Wildcard));
                }
                Literal::Aggregate { atom, column, .. } => {
                    fits(atom);
                    literal.terms().for_each(&mut mark);
                    assert!(column.is_none_or(|column| column < atom.terms.len()));
                    assert!(stratum_of[atom.predicate.index()].is_none_or(|other| other < home));
                }
            }
        }
        for _ in 0..clause.body.len() {
            for literal in &clause.body {
                let known = |term: &Term, bound: &[bool]| match term {
                    Term::Variable(id) => bound[id.index()],
                    _ => true,
                };
                let all_known =
                    |mut terms: std::slice::Iter<'_, Term>, bound: &[bool]| terms.all(|term| known(term, bound));
                let learnt: Vec<&Term> = match literal {
                    Literal::Compare {
                        op: Comparison::Equal,
                        left,
                        right,
                        ..
                    } if known(left, &bound) || known(right, &bound) => vec![left, right],
                    Literal::Compute { to, arguments, .. } if all_known(arguments.iter(), &bound) => vec![to],
                    Literal::Aggregate { to, atom, .. } if all_known(atom.terms.iter(), &bound) => vec![to],
                    _ => Vec::new(),
                };
                for term in learnt {
                    if let Term::Variable(id) = term {
                        bound[id.index()] = true;
                    }
                }
            }
        }
        assert!(bound.iter().all(|&bound| bound), "every variable is bound");
        assert!(used.iter().all(|&used| used), "every variable occurs");
    }
}

proptest! {
    #![proptest_config(cases(256))]

    #[test]
    fn rules_keep_their_invariants(
        clauses in proptest::collection::vec((random_clause(), 0_usize..4, 0_usize..4), 1..6),
        scoped: bool,
    ) {
        let mut text = ".decl A(x: symbol)\n.decl B(x: symbol, y: symbol)\n.decl V(x: symbol, n: number)\n\
                        .input A, B, V\n.decl P0, P1, P2, P3(x: symbol)\n".to_owned();
        text.push_str(if scoped { ".scope B\n" } else { "" });
        for (clause, head, other) in clauses {
            let negated = if other < head { "!" } else { "" };
            let clause = clause.replacen("P(", &format!("P{head}("), 1);
            text.push_str(&clause.replace("A(x).", &format!("A(x), {negated}P{other}(x).\n")));
        }
        let (_, loaded) = load_text("random.dl", &text);
        if let Some(rules) = loaded.rules {
            check_constraints(&rules);
        }
    }
}

#[test]
fn strata_follow_dependence_and_then_declaration() {
    let rules = load_clean(
        "main.dl",
        "
        .decl E(x: symbol, y: symbol)
        .decl Last, First(x: symbol)
        .decl Even, Odd(x: symbol)
        .decl Loose(x: symbol)
        .input E
        .output Last, Loose
        Last(x) :- E(x, _), !Even(x), First(x).
        Even(x) :- E(x, x).
        Even(x) :- E(y, x), Odd(y).
        Odd(x) :- E(y, x), Even(y).
        First(x) :- E(_, x).
        Loose(\"a\").
        ",
    );
    let names: Vec<&[&str]> = vec![&["First"], &["Even", "Odd"], &["Last"], &["Loose"]];
    assert_eq!(strata(&rules), names);
    let recursive: Vec<bool> = rules.strata.iter().map(|stratum| stratum.recursive).collect();
    assert_eq!(recursive, [false, true, false, false]);
}

#[test]
fn includes_are_relative_to_the_including_file_and_read_once() {
    let files = [
        (
            "rules/main.dl",
            ".include \"sub/a.dl\"\n.include \"c.dl\"\nR(x) :- C(x).\n.output R",
        ),
        (
            "rules/sub/a.dl",
            ".include \"b.dl\"\n.include \"../c.dl\"\nR(x) :- B(x).",
        ),
        ("rules/sub/b.dl", ".decl B, R(x: symbol)\n.input B"),
        ("rules/c.dl", ".decl C(x: symbol)\n.input C"),
    ]
    .map(|(name, text)| (name.to_owned(), text.to_owned()));
    let asked = std::cell::RefCell::new(Vec::new());
    let read_one = |path: &Path| {
        asked.borrow_mut().push(path.display().to_string());
        let path = path.to_string_lossy().replace("sub/../", "");
        files
            .iter()
            .find(|(name, _)| *name == path)
            .map(|(_, text)| text.clone())
            .ok_or(ReadError::NotFound)
    };
    let mut sources = Sources::new();
    let entry = sources.add(files[0].0.as_str(), files[0].1.as_str());
    let loaded = load(&mut sources, entry, &read_one);
    assert!(
        loaded.diagnostics.is_empty(),
        "{}",
        render(&loaded.diagnostics, &sources, false)
    );
    assert_eq!(
        asked.into_inner(),
        ["rules/sub/a.dl", "rules/sub/b.dl", "rules/sub/../c.dl"]
    );
}

#[test]
fn consecutive_signs_keep_their_depth_when_printed() {
    let text = format!(
        ".decl A, B(x: number)\nB({}x) :- A(bnot -x), x = -(5).\n",
        "- ".repeat(60)
    );
    let mut sources = Sources::new();
    let id = sources.add("signs.dl", text);
    let parsed = logicity_datalog::parse(&sources, id);
    assert!(parsed.diagnostics.is_empty());
    let id = sources.add("again.dl", logicity_datalog::print(&parsed.file));
    let again = logicity_datalog::parse(&sources, id);
    assert!(again.diagnostics.is_empty());
    assert_eq!(
        logicity_datalog::print(&again.file),
        logicity_datalog::print(&parsed.file)
    );
}

/// The first argument of a function may be an aggregate, whose value may be in parentheses.
#[test]
fn an_aggregate_is_an_argument_of_a_function() {
    let text = ".decl A(x: number)\nA(3). A(4).\n.decl P(n: number)\n.output P\n";
    for value in [
        "min(sum (x) : { A(x) }, 9)",
        "min(sum x : { A(x) }, 9)",
        "max(count : { A(_) }, 7)",
    ] {
        let (_, loaded) = load_text("argument.dl", &format!("{text}P(n) :- n = {value}.\n"));
        assert!(loaded.rules.is_some(), "{value}: {:?}", loaded.diagnostics);
    }
    // Function notation stays an error.
    let (_, loaded) = load_text("argument.dl", &format!("{text}P(n) :- n = min(A(x)).\n"));
    assert!(loaded.rules.is_none());
}
