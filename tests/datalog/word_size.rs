//! Programs with numbers of 64 bits.

use crate::cases::cases;
use crate::random_program::agree::agrees;
use crate::random_program::{Batch, Genome, computing_genomes, genomes, recursive_genomes};
use crate::rule_files::RuleFiles;
use logicity_datalog::diag::{Sources, render};
use logicity_datalog::explain::{Explainer, ExplanationPrinter};
use logicity_datalog::symbol::{Symbol, Symbols, WordSize};
use logicity_datalog::{BaseType, InputPolicy, Loaded, Program, Rules, Session, Value, Workspace, export, facts};
use proptest::prelude::*;

/// Loads a program with numbers of 64 bits.
fn load(text: &str) -> (Sources, Loaded) {
    let mut sources = Sources::new();
    let entry = sources.add("main.dl", text);
    let mut workspace = Workspace::new(InputPolicy::Extensible);
    workspace.set_word_size(WordSize::Bits64);
    workspace.add(&mut sources, entry, &RuleFiles);
    (sources, workspace.check())
}

fn rules(text: &str) -> Rules {
    let (sources, loaded) = load(text);
    let shown = render(&loaded.diagnostics, &sources, false);
    loaded.rules.unwrap_or_else(|| panic!("{text}\n{shown}"))
}

fn session(text: &str) -> Session {
    let mut session = Program::new(rules(text)).expect("small").session();
    session.commit().expect("small");
    session
}

/// Returns the rows of a predicate as files have them.
fn shown(session: &Session, name: &str) -> String {
    let id = session.program().predicate(name).expect("declared");
    facts::print(session, id).trim_end().replace('\n', "; ")
}

/// Returns what an expression is, as text.
fn value(ty: &str, expression: &str) -> String {
    let session = session(&format!(".decl p(x: {ty})\np({expression}).\n"));
    shown(&session, "p")
}

#[test]
fn numbers_have_64_bits() {
    assert_eq!(value("number", "2147483647 + 1"), "2147483648");
    assert_eq!(value("number", "-9223372036854775808 - 1"), "9223372036854775807");
    assert_eq!(value("unsigned", "0xffffffffffffffff"), "18446744073709551615");
    assert_eq!(value("unsigned", "0u - 1u"), "18446744073709551615");
    assert_eq!(value("number", "0x0000FFFFFFFFFFFF band -256"), "281474976710400");
    assert_eq!(value("number", "1 bshl 40"), "1099511627776");
    assert_eq!(value("number", "-1 bshru 60"), "15");
    assert_eq!(value("float", "0.1 + 0.2"), "0.30000000000000004");
    assert_eq!(value("float", "0.45"), "0.45000000000000001");
    assert_eq!(
        value("number", "to_number(\"4611686018427387904\")"),
        "4611686018427387904"
    );
    assert_eq!(value("symbol", "to_string(-5000000000)"), "-5000000000");
    assert_eq!(
        value("unsigned", "as(to_number(\"-1\"), unsigned)"),
        "18446744073709551615"
    );
    assert_eq!(value("number", "strlen(\"four\") - 5"), "-1");
    assert_eq!(value("number", "127.0.0.1"), "2130706433");
    assert_eq!(value("number", "255.0.0.1"), "4278190081");
    assert_eq!(value("number", "RAM_DOMAIN_SIZE"), "64");
}

#[test]
fn aggregates_and_ranges_have_64_bits() {
    let text = ".decl n(x: number)\nn(4000000000). n(-4000000000). n(9000000000). n(-1).\n\
                .decl f(x: float)\nf(1e300). f(1.0). f(-1e300).\n\
                .decl all(least: number, greatest: number, count: number, sum: number, mean: float)\n\
                all(a, b, c, d, e) :- a = min x : { n(x) }, b = max x : { n(x) }, c = count : { n(_) },\n\
                    d = sum x : { n(x) }, e = mean x : { n(x) }.\n\
                .decl floats(x: float)\nfloats(x) :- x = sum y : { f(y) }.\n\
                .decl big(x: number)\nbig(x) :- n(x), x > 3999999999.\n\
                .decl steps(x: number)\nsteps(x) :- x = range(5000000000, 5000000003).\n\
                steps(x) :- x = range(2, -2, -1).\n";
    let session = session(text);
    assert_eq!(
        shown(&session, "all"),
        "-4000000000\t9000000000\t4\t8999999999\t2249999999.75"
    );
    assert_eq!(shown(&session, "floats"), "0");
    assert_eq!(shown(&session, "big"), "4000000000; 9000000000");
    assert_eq!(
        shown(&session, "steps"),
        "-1; 0; 1; 2; 5000000000; 5000000001; 5000000002"
    );
}

#[test]
fn rows_are_typed() {
    let rules = rules(
        ".decl p(a: number, b: unsigned, c: float, d: symbol)\n.input p\n\
         .type R = [x: number, y: R]\n.decl r(x: R)\n.input r\n.decl q(a: number)\nq(a + 1) :- p(a, _, _, _).\n",
    );
    let program = Program::new(rules).expect("small");
    let mut session = program.session();
    let row = (i64::MIN, u64::MAX, 0.1_f64, "text");
    session.insert("p", row).unwrap();
    session.insert("r", ("[-5000000000, [7, nil]]",)).unwrap();
    session.commit().unwrap();
    let rows: Vec<(i64, u64, f64, &str)> = session.rows("p").unwrap().collect();
    assert_eq!(rows, [row]);
    assert!(session.contains("p", row) && session.contains("q", (i64::MIN + 1,)));
    assert!(!session.contains("q", (i64::MAX,)));
    assert_eq!(shown(&session, "r"), "[-5000000000, [7, nil]]");
    let error = session.rows::<(i32,)>("q").err().unwrap().to_string();
    assert!(error.contains("`i64`, since numbers have 64 bits"), "{error}");
    session.retract("p", row).unwrap();
    session.commit().unwrap();
    assert_eq!(
        (session.len(program.predicate("q").unwrap()), shown(&session, "q")),
        (0, String::new())
    );
}

#[test]
fn proofs_and_files_show_64_bits() {
    let text = ".decl p, q(x: number)\n.input p\nq(x * 2) :- p(x), x > 3000000000.\n.decl f(x: float)\n.input f\n";
    let (sources, loaded) = load(text);
    let program = Program::new(loaded.rules.unwrap()).unwrap();
    let mut session = program.session();
    let [p, f] = ["p", "f"].map(|name| program.predicate(name).unwrap());
    facts::load_json(&mut session, p, "[[3000000001], [-9223372036854775808]]".as_bytes())
        .unwrap()
        .unwrap();
    facts::load_json(&mut session, f, "[[1e300]]".as_bytes())
        .unwrap()
        .unwrap();
    session.commit().unwrap();
    assert_eq!(shown(&session, "q"), "6000000002");
    let mut out = Vec::new();
    facts::write_json(&session, p, false, &mut out).unwrap();
    assert_eq!(
        String::from_utf8(out).unwrap(),
        "[[-9223372036854775808],\n[3000000001]]\n"
    );
    let row = [Value::of_number(6_000_000_002, session.symbols()).unwrap()];
    let why = Explainer::new(&session)
        .explain(program.predicate("q").unwrap(), &row)
        .unwrap();
    let printer = ExplanationPrinter::new(program.rules(), session.symbols(), &sources);
    let tree = printer.tree(&why.unwrap());
    assert!(
        tree.contains("q(6000000002)") && tree.contains("p(3000000001)"),
        "{tree}"
    );
    // A session is read back, but not by the same text with 32 bits.
    let mut saved = Vec::new();
    session.save(&mut saved).unwrap();
    let loaded = program.load_session(&mut saved.as_slice(), session.limits()).unwrap();
    assert_eq!(shown(&loaded, "q"), "6000000002");
    let narrow = Program::parse(&text.replace("3000000000", "3")).unwrap();
    assert!(narrow.load_session(&mut saved.as_slice(), session.limits()).is_err());
}

#[test]
fn facts_are_translated_between_tables() {
    let text = ".type R = [x: number, y: R]\n.decl p(x: number, y: float, z: R)\n.input p\n";
    let mut sources = Sources::new();
    let entry = sources.add("main.dl", text);
    let mut workspace = Workspace::new(InputPolicy::Extensible);
    workspace.set_word_size(WordSize::Bits64);
    workspace.add(&mut sources, entry, &RuleFiles);
    let rules = workspace.check().rules.expect("no faults");
    let session = Program::new(rules).expect("small").session();
    let symbols = session.symbols();
    // Symbols with the ids that the numbers have in the table of the fact.
    (0..10).for_each(|number| _ = symbols.intern(&number.to_string()));
    let question = sources.add("question", "p(-5, 0.5, [-6, [7, nil]])");
    let asked = workspace.fact(&sources, question, symbols).expect("a fact");
    let shown = |value: Option<Value>, base| facts::print_value(&session, value.expect("no wildcard"), base);
    let bases = [BaseType::Number, BaseType::Float, BaseType::Record];
    assert_eq!(shown(asked.values[0], bases[0]), "-5");
    assert_eq!(shown(asked.values[1], bases[1]), "0.5");
    assert_eq!(shown(asked.values[2], bases[2]), "[-6, [7, nil]]");
    for text in [
        "p(-5, 0.5, [_, nil])",
        "p(_, 0.5, [1, nil])",
        "p(1 + x, 0.5, nil)",
        "p(1 / 0, 0.5, nil)",
        "p(2 - 7, _, nil)",
    ] {
        let question = sources.add("question", text);
        assert!(workspace.fact(&sources, question, symbols).is_err(), "{text}");
    }
    let question = sources.add("question", "p(2 - 7, 0.5, nil)");
    assert_eq!(
        workspace.fact(&sources, question, symbols).expect("a fact").values[0],
        asked.values[0]
    );
    let question = sources.add("question", "p(-5, _, _)");
    let asked = workspace.fact(&sources, question, symbols).expect("a fact");
    assert_eq!((asked.values[1], asked.values[2]), (None, None));
    let given = sources.add("given", "p(-7, -0.5, [-8, nil]).");
    let found = workspace
        .facts(&sources, given, symbols)
        .expect("facts")
        .expect("only facts");
    let values: Vec<String> = (found[0].1.iter().zip(bases))
        .map(|(value, base)| shown(Some(*value), base))
        .collect();
    assert_eq!(values, ["-7", "-0.5", "[-8, nil]"]);
    // Words that stand for no number are refused.
    let mut session = session;
    let row = [Value::number(-1), Value::float(0.5), found[0].1[2]];
    assert!(session.insert("p", row).is_err());
}

#[test]
fn computed_numbers_count_toward_the_memory() {
    let text = ".decl n, a, b(x: number)\n.input a, b\nn(x) :- a(x), b(y), x * y - 1 < -9000000000000000000.\n";
    let program = Program::new(rules(text)).expect("small");
    let mut session = program.session();
    session.set_limits(logicity_datalog::Limits {
        bytes: 8 << 20,
        ..session.limits()
    });
    for name in ["a", "b"] {
        let rows = (0..1_000_i64).map(|number| (number * 1_000_003,));
        session.insert_all(name, rows).unwrap();
    }
    let error = session.commit().err().map(|error| error.to_string());
    assert!(error.as_ref().is_some_and(|error| error.contains("MiB")), "{error:?}");
}

#[test]
fn what_needs_32_bits_is_refused() {
    for (text, said) in [
        ("0.5 :: p(1).\n", "have no draws"),
        ("p(x) :- q(x), once[1,2] q(x).\n", "have no temporal operators"),
        ("p(18446744073709551616).\n", "number out of range"),
        ("p(\"5000000000\").\n", "write the number without quotes: `5000000000`"),
        ("p(2.5).\n", "such as `2`"),
        ("p(9223372036854775808).\n", "numbers range from -9223372036854775808"),
    ] {
        let (sources, loaded) = load(&format!(".decl p, q(x: number)\n.input q\n{text}"));
        let shown = render(&loaded.diagnostics, &sources, false);
        assert!(loaded.rules.is_none() && shown.contains(said), "{shown}");
    }
    let faults = export::souffle(&rules(".decl p(x: number)\np(1).\n")).unwrap_err();
    assert!(faults[0].message.contains("64 bits"), "{}", faults[0].message);
    for text in [
        ".decl p(x: number)\np(5000000000).\n",
        ".decl p(x: unsigned)\np(5000000000u).\n",
    ] {
        let said = Program::parse(text).unwrap_err().to_string();
        assert!(
            said.contains("out of range") && said.contains("--word-size 64"),
            "{said}"
        );
    }
}

/// The word of a value in another table, for numbers of 64 bits.
fn long(word: Value, base: BaseType, from: &Symbols, to: &Symbols) -> Value {
    match base {
        BaseType::Number => Value::of_number(word.as_number().into(), to).expect("it fits"),
        BaseType::Unsigned => Value::of_unsigned(word.0.into(), to).expect("it fits"),
        BaseType::Float => Value::of_float(word.as_float().into(), to),
        BaseType::Symbol | BaseType::Record => {
            Value(to.intern(from.resolve(Symbol(word.0)).expect("an interned symbol")).0)
        }
    }
}

/// A random program in both sizes, with its changes.
fn both(genome: &Genome) -> Option<(Rules, Vec<Batch>, Rules, Vec<Batch>)> {
    let narrow = genome.rules();
    // Infinite constants cannot be written.
    let wide = rules(&export::souffle(&narrow).ok()?);
    let script = genome.batches(&narrow);
    let batches = script.iter().map(|batch| {
        let changes = batch.iter().map(|(present, id, row)| {
            let predicate = &narrow.predicates[id.index()];
            let values = row.iter().zip(&predicate.columns);
            let row = values.map(|(word, column)| long(*word, column.base, &narrow.symbols, &wide.symbols));
            (
                *present,
                wide.predicate(&predicate.name).expect("the same"),
                row.collect(),
            )
        });
        changes.collect()
    });
    let batches: Vec<Batch> = batches.collect();
    Some((narrow, script, wide, batches))
}

/// Whether both sizes derive the same rows: programs without arithmetic do.
fn same_rows(genome: &Genome) -> Result<(), TestCaseError> {
    let Some((narrow, script, wide, batches)) = both(genome) else {
        return Ok(());
    };
    let mut sessions = [narrow, wide].map(|rules| Program::new(rules).expect("small").session());
    for batches in script.iter().zip(&batches) {
        for (session, batch) in sessions.iter_mut().zip([batches.0, batches.1]) {
            for (present, id, row) in batch {
                match present {
                    true => session.insert(*id, row).expect("it fits"),
                    false => session.retract(*id, row).expect("it fits"),
                }
            }
            session.commit().expect("small");
        }
        let rows = |session: &Session, name: &str| shown(session, name);
        for predicate in &sessions[0].program().rules().predicates {
            let has_floats = predicate.columns.iter().any(|column| column.base == BaseType::Float);
            if !predicate.hidden && !has_floats {
                let [one, other] = [&sessions[0], &sessions[1]].map(|session| rows(session, &predicate.name));
                prop_assert_eq!(one, other, "{}", predicate.name);
            }
        }
    }
    Ok(())
}

/// An operator, and what Rust computes.
type Operation<T> = (&'static str, fn(T, T) -> Option<T>);

proptest! {
    #![proptest_config(cases(200))]

    #[test]
    fn both_sizes_derive_the_same_rows(genome in genomes(1..3)) {
        same_rows(&genome)?;
    }

    #[test]
    fn recursive_programs_derive_the_same_rows(genome in recursive_genomes(1..2)) {
        same_rows(&genome)?;
    }

    #[test]
    fn sessions_equal_the_specification(genome in computing_genomes(1..3)) {
        if let Some((_, _, wide, batches)) = both(&genome) {
            agrees(&wide, &batches)?;
        }
    }

    #[test]
    fn numbers_compute_as_rust_does(a in any::<i64>(), b in prop_oneof![any::<i64>(), -70..70_i64]) {
        let operations: [Operation<i64>; 9] = [
            ("+", |a, b| Some(a.wrapping_add(b))),
            ("-", |a, b| Some(a.wrapping_sub(b))),
            ("*", |a, b| Some(a.wrapping_mul(b))),
            ("/", |a, b| (b != 0).then(|| a.wrapping_div(b))),
            ("%", |a, b| (b != 0).then(|| a.wrapping_rem(b))),
            ("band", |a, b| Some(a & b)),
            ("bxor", |a, b| Some(a ^ b)),
            ("bshl", |a, b| Some(a.wrapping_shl(b as u32))),
            ("bshr", |a, b| Some(a.wrapping_shr(b as u32))),
        ];
        let mut text = ".decl in(a: number, b: number)\n.input in\n.decl less(a: number)\nless(a) :- in(a, b), a < b.\n"
            .to_owned();
        for (number, (operator, _)) in operations.iter().enumerate() {
            text += &format!(".decl o{number}(x: number)\no{number}(a {operator} b) :- in(a, b).\n");
        }
        let mut session = Program::new(rules(&text)).expect("small").session();
        session.insert("in", (a, b)).unwrap();
        session.commit().unwrap();
        for (number, (operator, compute)) in operations.iter().enumerate() {
            let rows: Vec<(i64,)> = session.rows(format!("o{number}").as_str()).unwrap().collect();
            prop_assert_eq!(rows, compute(a, b).map(|x| (x,)).into_iter().collect::<Vec<_>>(), "{}", operator);
        }
        prop_assert_eq!(session.contains("less", (a,)), a < b);
    }

    #[test]
    fn floats_compute_as_rust_does(a in any::<f64>(), b in any::<f64>()) {
        let text = ".decl in(a: float, b: float)\n.input in\n.decl sum, product(x: float)\n\
                    sum(a + b) :- in(a, b).\nproduct(a * b) :- in(a, b).\n.decl less(a: float)\n\
                    less(a) :- in(a, b), a < b.\n";
        let mut session = Program::new(rules(text)).expect("small").session();
        session.insert("in", (a, b)).unwrap();
        session.commit().unwrap();
        for (name, expected) in [("sum", a + b), ("product", a * b)] {
            let rows: Vec<(f64,)> = session.rows(name).unwrap().collect();
            let equal = |x: f64| x == expected || x.is_nan() && expected.is_nan();
            prop_assert!(matches!(rows[..], [(x,)] if equal(x)), "{name} {rows:?} {expected}");
            let shown = shown(&session, name);
            let back: f64 = shown.parse().unwrap();
            prop_assert!(equal(back), "{}", shown);
        }
        prop_assert_eq!(session.len(session.program().predicate("less").unwrap()) == 1, a < b);
    }
}
