//! Predicates as JSON.

use crate::cases::cases;
use logicity_datalog::{Limits, PredicateId, Program, Session, facts};
use proptest::prelude::*;

const ALL: &str = "
    .type P = [n: number, s: symbol]
    .decl all(n: number, u: unsigned, f: float, s: symbol, p: P) .input all
    .decl on() .input on
";

fn all() -> (Program, PredicateId) {
    let program = Program::parse(ALL).expect("the program is valid");
    let all = program.predicate("all").expect("it is declared");
    (program, all)
}

fn written(session: &Session, id: PredicateId, objects: bool) -> String {
    let mut text = Vec::new();
    facts::write_json(session, id, objects, &mut text).expect("writing to memory cannot fail");
    String::from_utf8(text).expect("JSON is text")
}

#[test]
fn rows_are_lists_or_objects() {
    let (program, all) = all();
    let mut session = program.session();
    let text = r#"[[-1, 4294967295, 0.5, "a\"\n", "[3, x]"], {"u": 0, "n": 2, "p": "nil", "f": 3, "s": "é"}]"#;
    assert_eq!(facts::load_json(&mut session, all, text.as_bytes()).unwrap(), Ok(2));
    let on = program.predicate("on").unwrap();
    assert_eq!(
        facts::load_json(&mut session, on, "[[], {}]".as_bytes()).unwrap(),
        Ok(2)
    );
    session.commit().unwrap();
    let lists = "[[-1, 4294967295, 0.5, \"a\\\"\\n\", \"[3, x]\"],\n[2, 0, 3.0, \"é\", \"nil\"]]\n";
    assert_eq!(written(&session, all, false), lists.replace("3.0", "3"));
    let objects = "[{\"n\": -1, \"u\": 4294967295, \"f\": 0.5, \"s\": \"a\\\"\\n\", \"p\": \"[3, x]\"},\n\
                   {\"n\": 2, \"u\": 0, \"f\": 3, \"s\": \"é\", \"p\": \"nil\"}]\n";
    assert_eq!(written(&session, all, true), objects);
    assert_eq!(written(&session, on, false), "[[]]\n");
    let empty = program.session();
    assert_eq!(written(&empty, all, true), "[]\n");
}

#[test]
fn faults_have_their_place_and_insert_nothing() {
    let (program, all) = all();
    let mut session = program.session();
    let good = r#"[1, 2, 3, "a", "nil"]"#;
    for (row, message) in [
        (
            r#"["1", 2, 3, "a", "nil"]"#,
            "column `n` of `all` holds numbers, not \"1\"",
        ),
        (
            r#"[2147483648, 2, 3, "a", "nil"]"#,
            "column `n` of `all` holds numbers, not 2147483648",
        ),
        (
            r#"[1.5, 2, 3, "a", "nil"]"#,
            "column `n` of `all` holds numbers, not 1.5",
        ),
        (
            r#"[1, -1, 3, "a", "nil"]"#,
            "column `u` of `all` holds unsigned numbers, not -1",
        ),
        (
            r#"[1, 2, 1e300, "a", "nil"]"#,
            "column `f` of `all` holds floats, not 1e300",
        ),
        (
            r#"[1, 2, "3", "a", "nil"]"#,
            "column `f` of `all` holds floats, not \"3\"",
        ),
        (r#"[1, 2, 3, 4, "nil"]"#, "column `s` of `all` holds symbols, not 4"),
        (
            r#"[1, 2, 3, "a", "[1]"]"#,
            "column `p` of `all` holds records as strings: expected ",
        ),
        (
            r#"[1, 2, 3, null, "nil"]"#,
            "invalid type: null, expected a value: column `s` of `all` holds symbols",
        ),
        (
            r#"[1, true, 3, "a", "nil"]"#,
            "invalid type: boolean `true`, expected a value: column `u` of `all` holds",
        ),
        (r#"[1, 2, 3, "a"]"#, "a row of `all` has 5 values, not 4"),
        (r#"[1, 2, 3, "a", "nil", 6]"#, "a row of `all` has 5 values, not more"),
        (r#"{"n": 1}"#, "a row of `all` lacks the column `u`"),
        (r#"{"n": 1, "n": 2}"#, "the column `n` occurs twice in a row of `all`"),
        (r#"{"m": 1}"#, "`all` has no column \"m\""),
        (
            "7",
            "invalid type: integer `7`, expected a row of `all`: a list or an object",
        ),
        (r#"[1, 2, 3, "a"#, "EOF while parsing a string"),
    ] {
        let text = format!("[{good},\n {row}]");
        let fault = facts::load_json(&mut session, all, text.as_bytes())
            .unwrap()
            .expect_err(row);
        assert!(fault.message.starts_with(message), "{row}: {}", fault.message);
        assert!(
            fault.notes[0].starts_with("in line 2, column "),
            "{row}: {:?}",
            fault.notes
        );
    }
    for text in ["", "{}", "[", "[[]", "[] 1"] {
        assert!(
            facts::load_json(&mut session, all, text.as_bytes()).unwrap().is_err(),
            "{text}"
        );
    }
    assert!(session.commit().unwrap().is_empty());
}

#[test]
fn rows_beyond_the_memory_limit_are_refused() {
    let program = Program::parse(".decl s(x: symbol) .input s").unwrap();
    let id = program.predicate("s").unwrap();
    let mut session = program.session();
    session.set_limits(Limits {
        bytes: 1 << 20,
        ..Limits::default()
    });
    let rows: Vec<String> = (0..40_000).map(|number| format!("[\"name {number}\"]")).collect();
    let text = format!("[{}]", rows.join(","));
    let fault = facts::load_json(&mut session, id, text.as_bytes())
        .unwrap()
        .unwrap_err();
    assert_eq!(fault.code.name(), "limit-exceeded");
}

proptest! {
    #![proptest_config(cases(300))]

    /// What is written is read again, in both forms.
    #[test]
    fn json_round_trips(
        rows in prop::collection::vec((any::<i32>(), any::<u32>(), any::<u32>(), any::<String>(), any::<i32>()), 0..20),
    ) {
        let (program, all) = all();
        let mut session = program.session();
        for (n, u, f, s, in_record) in &rows {
            let record = format!("[{in_record}, \"{}\"]", s.replace('"', "\"\""));
            session.insert("all", (*n, *u, f32::from_bits(*f), s.as_str(), record.as_str())).unwrap();
        }
        session.commit().unwrap();
        for objects in [false, true] {
            let mut again = program.session();
            let text = written(&session, all, objects);
            prop_assert_eq!(facts::load_json(&mut again, all, text.as_bytes()).unwrap(), Ok(session.len(all)));
            again.commit().unwrap();
            prop_assert_eq!(written(&again, all, objects), text);
            prop_assert_eq!(again.len(all), session.len(all));
        }
    }
}
