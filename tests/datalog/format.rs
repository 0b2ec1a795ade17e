//! `fmt` gives one layout and preserves tokens, comments and meaning.

use crate::cases::cases;
use crate::root::root;
use logicity_datalog::diag::{Sources, render};
use logicity_datalog::{ast, format, parse};
use proptest::prelude::*;

fn formatted(text: &str) -> String {
    let mut sources = Sources::new();
    let id = sources.add("test.dl", text);
    format(&sources, id).unwrap_or_else(|faults| panic!("{}\n{text}", render(&faults, &sources, false)))
}

fn tree(text: &str) -> ast::File {
    let mut sources = Sources::new();
    let id = sources.add("test.dl", text);
    let parsed = parse(&sources, id);
    assert!(
        parsed.diagnostics.is_empty(),
        "{}\n{text}",
        render(&parsed.diagnostics, &sources, false)
    );
    parsed.file
}

/// The comments of a text in order, found independently of the lexer.
fn comments(text: &str) -> Vec<String> {
    let mut found = Vec::new();
    let mut rest = text;
    while let Some(c) = rest.chars().next() {
        let length = if rest.starts_with("//") {
            rest.find('\n').unwrap_or(rest.len())
        } else if rest.starts_with("/*") {
            rest.find("*/").unwrap() + 2
        } else if c == '"' {
            rest = &rest[1..];
            while !rest.starts_with('"') {
                rest = &rest[if rest.starts_with('\\') {
                    2
                } else {
                    rest.chars().next().unwrap().len_utf8()
                }..];
            }
            rest = &rest[1..];
            continue;
        } else {
            rest = &rest[c.len_utf8()..];
            continue;
        };
        found.push(rest[..length].lines().map(str::trim_end).collect::<Vec<_>>().join("\n"));
        rest = &rest[length..];
    }
    found
}

fn check(text: &str) -> String {
    let once = formatted(text);
    assert_eq!(formatted(&once), once, "not stable; the text was\n{text}");
    assert_eq!(tree(&once), tree(text), "the rules changed");
    assert_eq!(comments(&once), comments(text), "the comments changed");
    assert!(once.lines().all(|line| line == line.trim_end()), "{once}");
    assert!(once.is_empty() || once.ends_with('\n') && !once.ends_with("\n\n"));
    once
}

#[test]
fn the_shipped_rules_are_formatted() {
    for entry in std::fs::read_dir(root().join("rules")).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_some_and(|extension| extension == "dl") {
            let text = std::fs::read_to_string(&path).unwrap();
            assert_eq!(check(&text), text, "{}", path.display());
        }
    }
}

#[test]
fn all_items_are_laid_out() {
    let text = "// top\n\n\n\n.decl   A( x :number,y: symbol )   // trailing\n.decl B(x:number).input A\n\
        /// doc\nB(x):-A(x,_),!B( x ),Not  (B(x)) , not B(x),x<-7,x!=  3 . // end\n\
        A(1,\"a,  b\").A(2,\"/* no */\"). /* both */ A(3 , \"c\").\n\n\n// last\n";
    let expected = "// top\n\n.decl A(x: number, y: symbol)      // trailing\n.decl B(x: number)\n.input A\n\
        /// doc\nB(x) :- A(x, _), !B(x), Not(B(x)), not B(x), x < -7, x != 3. // end\n\
        A(1, \"a,  b\"). A(2, \"/* no */\"). /* both */\nA(3, \"c\").\n\n// last\n";
    assert_eq!(check(text), expected);
}

#[test]
fn a_full_stop_touches_the_token_before_it() {
    // A stop at the beginning of a line, before a name.
    assert_eq!(check("A(x) :- x = y\n.b(2).\n"), "A(x) :- x = y.\nb(2).\n");
}

#[test]
fn long_clauses_are_broken() {
    let literals: Vec<String> = (0..12).map(|number| format!("Literal{number}(x, y)")).collect();
    let text = format!("Head(x) :- {}.", literals.join(","));
    let once = check(&text);
    assert!(once.starts_with("Head(x) :-\n    Literal0(x, y), "), "{once}");
    assert!(once.lines().all(|line| line.len() <= 120), "{once}");
    // The formatter keeps the author's breaks and the comments between literals.
    let text = format!(
        "Head(x) :-\n A(x), // why\n  /* what */ B(x),\n  // alone\n  {}.",
        literals[..7].join(", ")
    );
    let once = check(&text);
    assert!(
        once.starts_with("Head(x) :-\n    A(x), // why\n    /* what */\n    B(x),\n    // alone\n    Literal0"),
        "{once}"
    );
}

#[test]
fn faults_are_reported_and_nothing_is_written() {
    let mut sources = Sources::new();
    let id = sources.add("test.dl", ".decl A(x: number\nA(1)");
    assert!(!format(&sources, id).unwrap_err().is_empty());
    assert_eq!(formatted(""), "");
    assert_eq!(formatted("\n\n  \n"), "");
}

/// Tokens of valid items, with any valid gaps between them.
fn texts() -> impl Strategy<Value = String> {
    let items = prop::sample::select(vec![
        ".decl Car ( x : symbol , y : number )",
        ".decl Car , Bus ( )",
        ".type a <: symbol",
        ".type a = b",
        ".input Car , Bus , Tram",
        ".include \"x.dl\"",
        ".scope Sees",
        ".disjoint Car Bus",
        ".implies Car , Bus",
        "Car ( \"a//b\" , -7 ) .",
        "Bus ( \"/*\" ) .",
        "Stop ( x ) :- Car ( x , _ ) , Not ( Bus ( x ) ) , ! Tram ( ) .",
        "Stop ( x ) :- Car ( x , y ) , y <= 0x2A , not ( x = \"é\\\"\" ) .",
        "Stop ( x ) :- once [ 0 , 5 ] Car ( x , _ ) , ! previous Bus ( x ) , for [ 3 ] Bus ( x ) .",
        "Stop ( x ) :- historically [ 0 , 1 ] Bus ( x ) , Not ( Bus ( x ) since [ 1 , 2 ] Tram ( x ) ) , Bus ( x ) since Bus ( 1 ) .",
        "Stop ( averylongvariablename ) :- Car ( averylongvariablename , anotherverylongvariablename ) , \
         Bus ( anotherverylongvariablename ) , Tram ( averylongvariablename , anotherverylongvariablename ) .",
    ]);
    let gaps = prop::sample::select(vec![
        "",
        "",
        "",
        "",
        " ",
        " ",
        "\n",
        "\n",
        "\n\n\n",
        "\t",
        "  ",
        " // a comment \n",
        "\n// own\n",
        "/* b */",
        "\n/* c\n   d */\n",
        "\n/// doc\n",
        " /* e */ \n",
        "\r\n",
        "//\n",
        "\n    // deep\n    // deeper\n",
    ]);
    proptest::collection::vec((items, proptest::collection::vec(gaps, 60)), 0..8).prop_map(|items| {
        let mut text = String::new();
        for (item, gaps) in items {
            // A directive's dot and name touch. Words need a gap.
            let words: Vec<&str> = item.split(' ').collect();
            for (word, gap) in words.iter().zip(gaps.iter().cycle()) {
                text += word;
                text += if gap.is_empty() { " " } else { gap };
            }
            text += "\n";
        }
        text
    })
}

proptest! {
    #![proptest_config(cases(600))]

    #[test]
    fn formatting_is_idempotent_and_preserves_the_meaning(text in texts()) {
        // Some gaps break tokens that must be on one line; such texts do not parse.
        let mut sources = Sources::new();
        let id = sources.add("test.dl", text.as_str());
        prop_assume!(parse(&sources, id).diagnostics.is_empty());
        check(&text);
    }
}

#[test]
fn expressions_alternatives_and_aggregates_are_laid_out() {
    let text = "B(x) :- A(x,y),(x<3;x>5),y>2.5, x = 1+2*3 . // c\nC(n,1u),C(n+1,2u) :- n = sum y:{B(y),y<3}.\n";
    let wanted = "B(x) :- A(x, y), (x < 3; x > 5), y > 2.5, x = 1 + 2 * 3. // c\n\
                  C(n, 1u), C(n + 1, 2u) :- n = sum y : { B(y), y < 3 }.\n";
    assert_eq!(formatted(text), wanted);
    assert_eq!(formatted(wanted), wanted);
}

#[test]
fn windows_are_laid_out_as_the_printer_writes_them() {
    let text = "A(x) :- once [ 0 , 5 ] B( x ),for[3]C(x,2) , Not( B(x)since[1 ,2]  C(x , 1) ),previous\nB(x).\n";
    let wanted = "A(x) :- once[0,5] B(x), for[3] C(x, 2), Not(B(x) since[1,2] C(x, 1)), previous B(x).\n";
    assert_eq!(formatted(text), wanted);
    assert_eq!(formatted(wanted), wanted);
}

/// The formatter writes aggregates as the printer and the documents do, and declarations without a space.
#[test]
fn colons_are_laid_out_by_their_meaning() {
    let text =
        ".decl N(x :number , y: symbol)\nN(n, \"a\") :- n = count:{ M(_) }.\nN(n, z) :- M(n), z = max y: M(y).\n";
    let wanted = ".decl N(x: number, y: symbol)\nN(n, \"a\") :- n = count : { M(_) }.\n\
                  N(n, z) :- M(n), z = max y : M(y).\n";
    assert_eq!(formatted(text), wanted);
    assert_eq!(formatted(wanted), wanted);
}
