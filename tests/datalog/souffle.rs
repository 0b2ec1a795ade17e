//! Texts written for Soufflé: white space between any two tokens, and constructs that the language does not have.

use crate::rule_files::RuleFiles;
use logicity_datalog::diag::{Diagnostic, Sources};
use logicity_datalog::{InputPolicy, PredicateId, Program, Value, Workspace, ast, facts, load, naive, parse, print};

fn diagnostics(text: &str) -> Vec<(&'static str, usize, String)> {
    let mut sources = Sources::new();
    let entry = sources.add("a.dl", text);
    let loaded = load(&mut sources, entry, &RuleFiles);
    let line = |fault: &Diagnostic| {
        let start = fault.primary.as_ref().map_or(0, |label| label.span.start as usize);
        text[..start].matches('\n').count() + 1
    };
    let found = loaded.diagnostics.iter();
    found
        .map(|fault| (fault.code.name(), line(fault), fault.message.clone()))
        .collect()
}

fn tree(text: &str) -> (ast::File, Vec<String>) {
    let mut sources = Sources::new();
    let id = sources.add("a.dl", text);
    let parsed = parse(&sources, id);
    let messages = parsed.diagnostics.into_iter().map(|fault| fault.message);
    (parsed.file, messages.collect())
}

/// Items as tokens between spaces.
const ITEMS: &[&str] = &[
    ".decl P , Q ( x : number , y : symbol ) inline",
    ".decl R ( ) no_inline magic btree overridable",
    ".decl O ( x : number ) input output printsize",
    ".type T <: symbol",
    ".type T = A",
    ".type T = A | B | C",
    ".type T = [ x : number , y : T ]",
    ".type T = A { x : number } | B { } | C { y : T , z : T }",
    "P ( $ A ( x , $ B ) ) :- Q ( $ A . B ( x ) ) , $ B ( ) != x , $ C = x .",
    "P ( [ x , [ _ , nil ] ] ) :- Q ( [ x ] ) , nil != [ x ] , [ ] = x .",
    ".decl P ( x : T , y : T ) magic choice-domain x , ( x , y )",
    ".limitsize P , Q ( n = 3 )",
    "P ( autoinc ( ) , $ ) :- Q ( x , $ ) , x = autoinc ( ) .",
    "P ( x , _ ) <= P ( x , 1 ) :- Q ( x ) , x < 3 ; ! Q ( x ) .",
    ".functor f ( x : number , y : symbol ) : number stateful",
    ".functor f ( number , symbol ) : number",
    ".functor f ( ) : T",
    "P ( @ f ( x , @ g ( ) ) ) :- Q ( x ) , @ f ( x , 1 ) > x , x = @ g ( ) .",
    ".number_type N",
    ".symbol_type S",
    ".input P , Q ( IO = file , filename = \"p.csv\" , delimiter = \",\" )",
    ".output P",
    ".output P ( )",
    ".printsize P , Q",
    ".pragma \"magic-transform\" \"*\"",
    "P ( 1 , \"a\" ) :- Q ( x , _ ) , R ( ) . .plan 0 : ( 2 , 1 ) , 1 : ( 1 , 2 )",
    ".include \"vocabulary.dl\"",
    ".comp A < T , U > : B < T > , C { .decl P ( x : T ) overridable P ( x ) :- a . q ( x ) . .init b = D < U > .override P }",
    ".init a = A < number , T >",
    ".once",
    ".scope Sees",
    ".disjoint A , B",
    ".implies A , B",
    ".covering A , B",
    ".reflexive A",
    ".irreflexive A",
    ".symmetric A",
    ".asymmetric A",
    "P ( x , cat ( \"a\" , y ) ) , Q ( - x , y ) :- ( A ( x ) ; ! ( B ( x ) , C ( x ) ) ) , match ( \"a.*\" , y ) .",
    "P ( x ) :- x = max - y ^ 2 : { A ( y ) , y >= 0x1F } , ! B ( as ( x , unsigned ) ) , count : A ( _ ) != 2u .",
    "P ( x ) :- x = min ( y , - 1 ) + 2 * ( 3 - y ) , A ( y ) , true , y = sum z : C ( z ) .",
];

/// Returns the tokens of an item; a text constant with spaces counts as one.
fn joined(tokens: &[&str], between: impl Fn(usize) -> &'static str) -> String {
    let mut text = String::from("\n");
    for (at, token) in tokens.iter().enumerate() {
        text.push_str(token);
        text.push_str(between(at));
    }
    text.push('\n');
    text
}

#[test]
fn white_space_and_comments_between_tokens_have_no_meaning() {
    const SPACES: &[&str] = &["\n", "\r\n\t", " /* c */ ", " // c\n", "\n\n    ", "\n/* c\n */"];
    for item in ITEMS {
        let tokens: Vec<&str> = item.split(' ').collect();
        let (wanted, faults) = tree(&joined(&tokens, |_| " "));
        let wanted = print(&wanted);
        for (shift, space) in SPACES.iter().enumerate() {
            // Everywhere, and between each two tokens alone.
            for alone in std::iter::once(None).chain((0..tokens.len()).map(Some)) {
                let text = joined(&tokens, |at| match alone {
                    None => SPACES[(at + shift) % SPACES.len()],
                    Some(only) if only == at => space,
                    Some(_) => " ",
                });
                let (found, others) = tree(&text);
                assert_eq!(print(&found), wanted, "{text}");
                assert_eq!(others, faults, "{text}");
            }
        }
    }
}

#[test]
fn a_type_continues_on_the_next_line() {
    let text = ".type A <: symbol\n.type B <: symbol\n.type T\n  = A\n  | B\n.type U // old\n  <: symbol\n.decl P(x: T, y: U)\n\
                .output P\nP(\"a\", \"b\").\n";
    assert_eq!(diagnostics(text), []);
    let old = |text| diagnostics(text).into_iter().map(|(code, ..)| code).collect::<Vec<_>>();
    assert_eq!(old(".type T\n.decl P(x: T)\n.output P\nP(\"a\").\n"), ["old-form"]);
    assert_eq!(old(".type T .decl P(x: T) .output P P(\"a\").\n"), ["old-form"]);
    assert_eq!(old(".decl P(x: T)\n.output P\n.type T\nP(\"a\").\n"), ["old-form"]);
}

/// Constructs of Soufflé that the language does not have. A `«` stands where a diagnostic is expected.
const UNSUPPORTED: &[&str] = &[
    "«.lattice L<> {\n  Bottom -> 1,\n  Lub -> @lub(_, _),\n  Glb -> @glb(_, _)\n}",
    ".decl o(x: number, y: number) «provenance",
    ".decl o(x: number, y: number) magic «provenance\n no_inline",
    ".decl o(x: number, y: number)\n  «provenance",
    ".decl o(x: number, y: L«<>)\n.input o",
    "«.lattice L<> { Bottom -> 1 }\n.decl o(x: number, y: L«<>)\n.decl m(x: L)\n.input o, m",
    ".decl o = «debug_delta(p)",
    "«@[deprecated(\"]\")]\np(3, 4).",
    "p(3, x) :- «@![a[b]] p(x, _).",
    "p(x, y) :- p(y, x), y = «@@f x : 3, { p(x, [x, y]) }.",
    "p(x, y) :- p(x, y), x = «R[1, nil].",
    "p(x, y) :- x = «recursive_iteration_cnt(), p(y, _).",
    "p(x, 1) :- p(x, «itou(3)).",
];

#[test]
fn each_unsupported_construct_has_one_diagnostic_and_ends() {
    const BEFORE: &str = ".decl p(x: number, y: number)\n.output p\np(1, 2).\n";
    // The last clause shows that the parser reads what follows.
    const AFTER: &str = "\n.decl after(x: number)\n.output after\nafter(x) :- p(x, 1).\nafter(\"text\").\n";
    let mut wrong = Vec::new();
    for construct in UNSUPPORTED {
        let marks = construct.match_indices('«').enumerate();
        let places = marks.map(|(earlier, (at, mark))| at - earlier * mark.len());
        let text = format!("{BEFORE}{}{AFTER}", construct.replace('«', ""));
        let line = |at: usize| text[..at].matches('\n').count() + 1;
        let found = diagnostics(&text);
        let last = line(text.len()) - 1;
        let wanted = places.map(|at| ("unsupported", line(BEFORE.len() + at)));
        let wanted: Vec<(&str, usize)> = wanted.chain([("type-mismatch", last)]).collect();
        if !found.iter().map(|(code, line, _)| (*code, *line)).eq(wanted) {
            wrong.push((text, found));
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
fn each_unsupported_construct_has_an_alternative() {
    let lacks_help = |construct: &&&str| {
        let mut sources = Sources::new();
        let text = format!(".decl p(x: number, y: number)\n.output p\np(1, 2).\n{construct}").replace('«', "");
        let entry = sources.add("a.dl", text);
        let found = load(&mut sources, entry, &RuleFiles).diagnostics;
        found.iter().any(|fault| fault.help.is_empty())
    };
    let wrong: Vec<&&str> = UNSUPPORTED.iter().filter(lacks_help).collect();
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
fn numbers_strings_and_keywords_are_those_of_souffle() {
    let text = r#"
        .decl n(x: number)
        .decl u(x: unsigned)
        .decl f(x: float)
        .decl s(x: symbol)
        .output n, u, f, s
        n(-0x1F). n(0b101). n(007). n(-2147483648). n(0x7fffffff). n(- 6). n(1.2.3.4).
        u(4294967295). u(0xFFFFFFFE). u(1u). u(0b11u). u(0x1fu).
        f(1). f(-1.5). f(1.0e-3). f(0x10).
        s("\a\b\f\n\r\t\v\"\'\\ // no comment /* either").
        .decl count(max: number, sum: symbol)
        .decl input(decl: number)
        .output input, count
        .decl type(choice: number)
        .output type
        count(min, mean) :- type(min), s(mean), input(min), band = min, n(band).
        type(sum) :- n(sum), sum > 0, max = sum - 1, max - sum < 5.
        input(exists) :- n(exists), exists band 1 = 1.
        input(count) :- n(count), some = count, some > 3.
    "#;
    assert_eq!(diagnostics(text), []);
    let (file, _) = tree(text);
    let printed = print(&file);
    assert_eq!(print(&tree(&printed).0), printed);
}

#[test]
fn an_aggregate_takes_any_expression() {
    let text = |target: &str| {
        format!(".decl A(x: number)\n.decl M(y: number)\n.input A\n.output M\nM(y) :- y = {target} : {{ A(x) }}.\n")
    };
    let targets = [
        "max -x",
        "min - x",
        "sum -x",
        "mean -(to_float(x))",
        "max (x) + 1",
        "sum (x + 1) * (x - 1)",
        "max min(x, 2)",
        "max (min(x, 2))",
        "min max(x, -x) - 1",
        "sum as(x, number)",
        "max bnot x",
        "min lnot x",
        "max - - x",
        "sum -x ^ 2",
        "max -count : { A(_) } + x",
        "min -max -z : { A(z) } + x",
        "max (x)",
    ];
    for target in targets {
        let text = text(target);
        let text = if target.starts_with("mean") {
            text.replace("M(y: number)", "M(y: float)")
        } else {
            text
        };
        assert_eq!(diagnostics(&text), [], "{text}");
        let printed = print(&tree(&text).0);
        assert_eq!(print(&tree(&printed).0), printed, "{text}");
    }
    assert_eq!(diagnostics(&text("sum 1").replace("A(x) }", "A(_) }")), []);
    // Without a body these are variables and functions.
    let other = ".decl A(x: number)\n.decl M(y: number)\n.input A\n.output M\nM(y) :- A(max), A(min), y = max - min.\n\
                 M(y) :- A(max), A(x), y = max(x, max) - min(x, 1), y > max - count : { A(_) }.\n";
    assert_eq!(diagnostics(other), []);
}

#[test]
fn witnesses_are_those_of_literals_that_name_the_value() {
    let found = |body: &str| {
        let before = ".decl a(x: number)\n.decl b, c(n: number, w: number)\n.input a, b\n.output c\n";
        diagnostics(&format!("{before}c(n, w) :- {body}.\n"))
    };
    for body in [
        "n = min y : { b(y, w) }",
        "n = max x : { a(x), m = min y : { b(y, w) }, x > m }",
    ] {
        assert_eq!(found(body), [], "{body}");
    }
    for body in [
        "n = count : { a(x), x > min y : { b(y, w) } }",
        "n = count : { a(x), m = min y : { b(y, w) }, x > m }",
        "n = sum x : { a(x), m = min y : { b(y, w) }, x > m }",
        "n = max x : { a(x), x > min y : { b(y, w) } }",
        "a(n), n > min y : { b(y, w) }",
    ] {
        let codes: Vec<&str> = found(body).into_iter().map(|(code, ..)| code).collect();
        assert_eq!(codes, ["unbound-variable"], "{body}");
    }
}

#[test]
fn a_value_of_a_supertype_has_a_conversion() {
    let mut sources = Sources::new();
    let text = |value: &str| {
        format!(".type T <: symbol\n.decl a(x: symbol)\n.decl b(x: T)\n.input a\n.output b\nb({value}) :- a(x).\n")
    };
    let entry = sources.add("a.dl", text("x"));
    let found = load(&mut sources, entry, &RuleFiles).diagnostics;
    let help = found.iter().flat_map(|fault| &fault.help).next().map(String::as_str);
    let wanted = "declare both columns with one type, or convert the value: `as(x, T)`";
    assert_eq!(help, Some(wanted), "{found:?}");
    assert_eq!(diagnostics(&text("as(x, T)")), []);
}

#[test]
fn alternatives_in_an_aggregate_are_one_fault() {
    for target in ["y", "y + z", "-y"] {
        let text = format!(
            ".decl a(x: number, z: number)\n.decl m(x: number)\n.input a\n.output m\n\
             m(n) :- n = max {target} : {{ a(x, z), (y = x; y = z) }}.\n"
        );
        let codes: Vec<_> = diagnostics(&text).into_iter().map(|(code, ..)| code).collect();
        assert_eq!(codes, ["unsupported"], "{text}");
    }
}

#[test]
fn the_target_of_an_aggregate_may_be_defined_in_its_body() {
    for target in ["y", "-y", "y * 2"] {
        for body in [
            "a(x), y = x",
            "y = x + 1, a(x)",
            "a(x), x + 1 = y",
            "a(x), y = z, z = x * x",
            "a(x), y = count : { a(z), z < x }",
        ] {
            let text = format!(
                ".decl a(x: number)\n.decl m(x: number)\n.input a\n.output m\nm(n) :- n = max {target} : {{ {body} }}.\n\
                 m(n) :- a(y), n = max {target} : {{ {body} }}, y > n.\n"
            );
            assert_eq!(diagnostics(&text), [], "{text}");
        }
    }
}

#[test]
fn a_dead_clause_with_several_heads_is_marked_once() {
    let mut sources = Sources::new();
    let text = ".decl e, a, b(x: number)\n.output a, b\na(x), b(x) :- e(x).\nb(x) :- (a(x); b(x)), e(x).\n";
    let entry = sources.add("a.dl", text);
    let found = load(&mut sources, entry, &RuleFiles).diagnostics;
    let dead = found
        .iter()
        .find(|fault| fault.code.name() == "dead-clause")
        .expect("a warning");
    // The other clause, and the declaration.
    assert_eq!(dead.secondary.len(), 2, "{dead:#?}");
}

/// Asserts that a program without faults derives these rows of `o`, also for the naive evaluator.
fn assert_rows_of_o(text: &str, expected: &str) {
    assert_eq!(diagnostics(text), []);
    let mut sources = Sources::new();
    let entry = sources.add("a.dl", text);
    let rules = load(&mut sources, entry, &RuleFiles).rules.expect("checked");
    let naive = naive::evaluate(&rules, &rules.symbols, []);
    let mut session = Program::new(rules).expect("small").session();
    session.commit().expect("small");
    let o = session.program().predicate("o").expect("declared");
    assert_eq!(
        naive[o.0 as usize],
        session.encoded_rows(o).map(<[Value]>::to_vec).collect()
    );
    assert_eq!(facts::print(&session, o), expected);
}

/// An inline predicate whose clauses bind its columns only by ones that do not.
#[test]
fn inline_predicates_may_bind_nothing_by_others() {
    let text = ".decl a(x: number)\n.decl o(x: number, y: number)\n.output o\na(-3). a(2). a(5).\n\
                .decl less(x: number, y: number) inline\nless(x, y) :- x < y.\n\
                .decl near(x: number, y: number) inline\nnear(x, y) :- less(y, x + 4), (less(x, y); same(x, y)).\n\
                .decl same(x: number, y: number) inline\nsame(x, x) :- true.\n\
                .decl abs(x: number, y: number) inline\nabs(x, x) :- x >= 0. abs(x, y) :- less(x, 0), y = 0 - x.\n\
                .decl twice(x: number, y: number) inline\ntwice(x, y) :- abs(x, z), y = 2 * z.\n\
                o(x, y) :- a(x), a(y), near(x, y). o(x, y) :- a(x), twice(x, y), !near(x, 2).\n";
    assert_rows_of_o(text, "-3\t-3\n-3\t6\n2\t2\n2\t5\n5\t5\n5\t10\n");
}

#[test]
fn an_equation_with_any_value_holds_of_values() {
    let text = ".decl a(x: number)\n.decl o(x: number)\n.output o\na(0). a(1).\n\
                o(x) :- a(x), _ = 1 / x. o(2) :- _ = [1]. o(3) :- a(x), [x, _] = [1, 2], as(x, float) = _. o(4) :- a(y), _ = y + 1, !a(4).\n\
                #if RAM_DOMAIN_SIZE == 32\no(32).\n#endif\n";
    assert_rows_of_o(text, "1\n2\n3\n4\n32\n");
}

#[test]
fn what_an_unknown_predicate_may_bind_is_no_fault() {
    let text = ".decl abs(x: number, y: number) inline\nabs(x, x) :- x >= 0. abs(x, y) :- x < 0, y = 0 - x.\n\
                .decl o(x: number)\n.output o\no(y) :- e(z), x = as(z, number) - 1, abs(x, y), y > 64.\n";
    let codes: Vec<_> = diagnostics(text).into_iter().map(|(code, ..)| code).collect();
    assert_eq!(codes, ["unknown-predicate"]);
}

/// Messages call what the checker makes by what it stands for.
#[test]
fn messages_name_no_hidden_predicate() {
    let before = ".decl a(x: symbol, n: number)\n.input a\n.decl d(x: symbol, n: number)\n.output d\nd(x, n) :- a(x, n).\n\
                  .decl less(x: number, y: number) inline\nless(x, y) :- x < y, z > y.\n";
    for (clause, wanted) in [
        ("d(x, n) <= d(x, m, k) :- n < m.", "`d` takes 2 arguments, not 3"),
        (
            "d(x, n) <= d(x, m) :- !d(x, m), n < m.",
            "`d` depends on its own negation",
        ),
        (
            "d(x, n) <= d(x, m) :- c = count : { d(_, n) }, n < m, c > 2.",
            "`d` depends on an aggregate over itself",
        ),
        ("d(x, autoinc()) :- d(x, _).", "`d` depends on an aggregate over itself"),
        ("d(x, m) :- a(x, m), less(m, m).", "no positive atom binds `z`"),
        (
            "d(x, m) :- a(x, m), m = max y : { a(x, y), d(x, z), z < y }.",
            "`d` depends on an aggregate over itself",
        ),
    ] {
        let text = format!("{before}{clause}\n");
        let mut sources = Sources::new();
        let entry = sources.add("a.dl", &text);
        let found = load(&mut sources, entry, &RuleFiles).diagnostics;
        let fault = found.iter().find(|fault| fault.message == wanted);
        let fault = fault.unwrap_or_else(|| panic!("{clause}\n{found:#?}"));
        let labels = fault.primary.iter().chain(&fault.secondary).map(|label| &label.message);
        let said: Vec<&String> = labels.chain(&fault.help).chain(&fault.notes).collect();
        assert!(said.iter().all(|said| !said.contains('+')), "{clause}\n{said:?}");
        let of_aggregate = said.iter().any(|said| said.contains("its result is another variable"));
        assert!(!of_aggregate, "{clause}\n{said:?}");
    }
}

/// With `--legacy`, a head takes values of every type with the base type of its column.
#[test]
fn programs_for_older_versions_have_other_types() {
    let text = ".symbol_type A\n.type B\n.number_type N\n.decl a(x: symbol, y: A, n: number)\n.input a\n\
                .decl b(x: B, y: symbol, n: N)\n.output b\nb(x, x, n), b(y, y, n) :- a(x, y, n).\n";
    let found = |text: &str, legacy| {
        let mut sources = Sources::new();
        let entry = sources.add("a.dl", text);
        let mut workspace = Workspace::new(InputPolicy::Extensible);
        workspace.set_legacy(legacy);
        workspace.add(&mut sources, entry, &RuleFiles);
        let loaded = workspace.check().diagnostics.into_iter();
        loaded.map(|fault| fault.code.name()).collect::<Vec<_>>()
    };
    assert!(found(text, false).contains(&"type-mismatch"));
    assert_eq!(found(text, true), [""; 0]);
    // Base types still differ.
    let other = text.replace("b(x, x, n)", "b(n, x, n)");
    assert_eq!(found(&other, true), ["type-mismatch"]);
}

#[test]
fn equivalence_relations_are_their_closure() {
    let rows = |text: &str| {
        let mut sources = Sources::new();
        let entry = sources.add("a.dl", text);
        let loaded = load(&mut sources, entry, &RuleFiles);
        let rules = loaded
            .rules
            .unwrap_or_else(|| panic!("{text}\n{:?}", loaded.diagnostics));
        let outputs = rules.predicates.iter().enumerate().filter(|(_, one)| one.output);
        let outputs: Vec<PredicateId> = outputs.map(|(at, _)| PredicateId(at as u32)).collect();
        let naive = naive::evaluate(&rules, &rules.symbols, []);
        let mut session = Program::new(rules).expect("small").session();
        session.commit().expect("small");
        for id in &outputs {
            let found = session.encoded_rows(*id).map(<[Value]>::to_vec).collect();
            assert_eq!(naive[id.0 as usize], found, "{text}");
        }
        let mut shown: Vec<String> = outputs.iter().map(|id| facts::print(&session, *id)).collect();
        shown.sort();
        shown
    };
    let bodies = [
        "e(1, 2). e(3, 4).",
        "e(1, 2). e(2, 3). e(5, 5).",
        "e(x, x + 1) :- x = range(0, 7), x != 4.",
        "e(1, 2). e(x, x + 2) :- e(x, _), x < 9.",
    ];
    for body in bodies {
        let head = ".decl e(x: number, y: number)";
        let rest = "\n.output e, only\n.decl only(x: number)\nonly(x) :- e(x, _), !e(x, 1).\n";
        let closed = "e(x, x) :- e(x, _). e(x, x) :- e(_, x). e(y, x) :- e(x, y). e(x, z) :- e(x, y), e(y, z).";
        assert_eq!(
            rows(&format!("{head} eqrel{rest}{body}")),
            rows(&format!("{head}{rest}{body}\n{closed}"))
        );
    }
    let in_component =
        ".comp A<T> { .decl e(x: T, y: T) eqrel\n.output e\n }\n.init a = A<symbol>\na.e(\"b\", \"c\").\n";
    assert_eq!(rows(in_component), ["b\tb\nb\tc\nc\tb\nc\tc\n"]);
    let faults = diagnostics(".decl e(x: number) eqrel\n.output e\n");
    assert_eq!(
        faults[0],
        (
            "arity-mismatch",
            1,
            "an equivalence relation has 2 columns, not 1".to_owned()
        )
    );
}
