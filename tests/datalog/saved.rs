//! Saved sessions: a loaded session equals the saved one, also in later commits, and damaged files are refused.

use crate::cases::cases;
use crate::random_program::agree::database;
use crate::random_program::{Genome, computing_genomes, genomes, recursive_genomes};
use logicity_datalog as datalog;
use logicity_datalog::{Limits, PredicateId, Program, RowFormat, Session, SnapshotError, StratumStats, facts};
use proptest::prelude::*;
use sha2::{Digest as _, Sha256};

fn saved(session: &Session) -> Vec<u8> {
    let mut file = Vec::new();
    session.save(&mut file).expect("writing to memory cannot fail");
    file
}

fn loaded(program: &Program, file: &[u8]) -> Result<Session, SnapshotError> {
    program.load_session(&mut &*file, Limits::default())
}

/// A session that reads the file of another one, with the same settings.
fn again(session: &Session) -> Session {
    let mut again = loaded(session.program(), &saved(session)).expect("the file is good");
    again.set_limits(session.limits());
    again
}

/// Saves and loads before and after each commit of a script. The loaded sessions have the same rows, and the same
/// changes in later commits.
fn check(genome: &Genome, wide: bool) -> Result<(), TestCaseError> {
    let mut rules = genome.rules();
    let script = genome.batches(&rules);
    if let Some(mut predicate) = rules.predicates.iter().find(|predicate| predicate.arity() > 0).cloned()
        && wide
    {
        // Makes the rows of the others narrow until they change.
        predicate.name = "Wide".to_owned();
        predicate.derived = false;
        predicate.columns = vec![predicate.columns[0].clone(); 12];
        rules.predicates.push(predicate);
    }
    let program = Program::new(rules).expect("the program is safe and small");
    let mut session = program.session();
    let mut copies = vec![again(&session)];
    for batch in &script {
        for session in copies.iter_mut().chain([&mut session]) {
            for (present, id, row) in batch {
                match present {
                    true => session.insert(*id, row).expect("the row fits"),
                    false => session.retract(*id, row).expect("the row fits"),
                }
            }
        }
        copies.push(again(&session));
        let delta = session.commit().expect("the program is small");
        for copy in &mut copies {
            prop_assert_eq!(&copy.commit().expect("the program is small"), &delta);
            prop_assert_eq!(database(copy), database(&session));
            // The costs of earlier commits decide how to update a stratum.
            let how = |session: &Session| {
                session
                    .work()
                    .strata
                    .iter()
                    .map(std::mem::discriminant)
                    .collect::<Vec<_>>()
            };
            prop_assert_eq!(how(copy), how(&session));
        }
        let copy = again(&session);
        prop_assert_eq!(database(&copy), database(&session));
        prop_assert_eq!(saved(&copy), saved(&session));
        copies.push(copy);
    }
    // Nothing is derived again: a commit without changes skips all strata.
    let mut copy = again(&session);
    if !script.is_empty() {
        prop_assert!(copy.commit().expect("nothing changes").is_empty());
        prop_assert!(
            copy.work()
                .strata
                .iter()
                .all(|stratum| *stratum == StratumStats::Skipped)
        );
    }
    Ok(())
}

proptest! {
    #![proptest_config(cases(300))]

    #[test]
    fn loaded_sessions_equal_saved_ones(genome in genomes(0..4)) {
        check(&genome, false)?;
    }

    #[test]
    fn loaded_sessions_with_narrow_rows_equal_saved_ones(genome in genomes(0..4)) {
        check(&genome, true)?;
    }

    #[test]
    fn loaded_recursive_sessions_equal_saved_ones(genome in recursive_genomes(0..3)) {
        check(&genome, false)?;
    }

    #[test]
    fn loaded_sessions_with_functors_equal_saved_ones(genome in computing_genomes(0..3)) {
        check(&genome, false)?;
    }
}

/// Temporal operators, draws, records, strings that rules make, aggregates and choices.
const ALL: &str = "
    .type P = [n: number, s: symbol]
    .decl e(x: symbol, n: number) .input e
    .decl q(x: symbol) .input q
    .decl p(a: P) p([n, x]) :- e(x, n).
    .decl made(x: symbol) made(cat(x, \"!\")) :- e(x, _).
    .decl seen(x: symbol) seen(x) :- once[1,3] e(x, _).
    .decl kept(x: symbol) kept(x) :- historically[1,2] q(x).
    .decl since(x: symbol, n: number) since(x, n) :- q(x) since[1,4] e(x, n).
    .decl drawn(x: symbol)
    0.5 :: drawn(x) :- e(x, _).
    .decl total(n: number) total(n) :- n = sum m : { e(_, m) }.
    .decl most(x: symbol, n: number) most(x, n) :- q(x), n = max m : { e(x, m) }.
    .decl one(x: symbol, n: number) choice-domain x
    one(x, n) :- e(x, n).
";

/// Changes and advances that depend on a number.
fn play(session: &mut Session, step: u64) -> datalog::Delta {
    let names = ["a", "b", "c", "d"];
    let name = |at: u64| names[(at % 4) as usize];
    let number = |at: u64| (at % 5) as i64;
    session.insert("e", (name(step * 7), number(step * 3))).unwrap();
    session.retract("e", (name(step * 5 + 1), number(step * 11))).unwrap();
    match step % 3 {
        0 => session.insert("q", (name(step),)).unwrap(),
        _ => session.retract("q", (name(step * 3),)).unwrap(),
    }
    match step % 4 {
        1 => session.commit().unwrap(),
        _ => session.advance().unwrap(),
    }
}

#[test]
fn ticks_draws_and_records_survive() {
    let program = Program::parse(ALL).expect("the program is valid");
    let mut session = program.session();
    session.set_seed(9);
    let mut copies: Vec<Session> = Vec::new();
    for step in 0..40 {
        if step % 5 == 2 {
            copies.push(again(&session));
        }
        if step == 25 {
            // Pending changes of both kinds.
            session.insert("e", ("z", 1)).unwrap();
            session.retract("e", ("a", 0)).unwrap();
            copies.clear();
            copies.push(again(&session));
        }
        let delta = play(&mut session, step);
        for copy in &mut copies {
            assert_eq!(play(copy, step), delta, "step {step}");
            assert_eq!(database(copy), database(&session), "step {step}");
            assert_eq!(copy.tick(), session.tick());
            assert_eq!(saved(copy), saved(&session));
        }
    }
    assert!(copies.len() > 2 && session.len("since") + session.len("seen") > 0);
}

#[test]
fn programs_are_the_same_by_what_they_mean() {
    let rules = ".decl p(x: number, y: symbol) .input p\n.decl q(x: number)\nq(x) :- p(x, \"a\"), x > 1.";
    let mut session = Program::parse(rules).unwrap().session();
    session.insert("p", (2, "a")).unwrap();
    session.commit().unwrap();
    let file = saved(&session);
    let same = rules
        .replace("x > 1", "/* layout */ x>1")
        .replace("q(x)", "q(z)")
        .replace("p(x,", "p(z,");
    let same = same.replace("x>1", "z>1");
    let copy = loaded(&Program::parse(&same).unwrap(), &file).expect("only names of variables differ");
    assert!(copy.contains("q", (2,)));
    for (from, to) in [
        ("x > 1", "x > 0"),
        ("x > 1", "x >= 1"),
        ("\"a\"", "\"b\""),
        ("x: number, y", "x: unsigned, y"),
        (".input p", ""),
        (", x > 1", ""),
        ("q(x: number)", "r(x: number)"),
    ] {
        let other = match to {
            "r(x: number)" => rules.replace("q(x", "r(x"),
            "x: unsigned, y" => rules.replace("x: number", "x: unsigned"),
            _ => rules.replace(from, to),
        };
        let program = Program::parse(&other).unwrap_or_else(|error| panic!("{other}: {error}"));
        let error = loaded(&program, &file).err();
        assert!(matches!(error, Some(SnapshotError::OtherProgram)), "{other}: {error:?}");
    }
}

/// A session with rows of several widths, and its file.
fn example() -> (Program, Vec<u8>) {
    let program = Program::parse(ALL).expect("the program is valid");
    let mut session = program.session();
    (0..12).for_each(|step| drop(play(&mut session, step)));
    session.insert("e", ("pending", 3)).unwrap();
    let file = saved(&session);
    (program, file)
}

#[test]
fn incomplete_and_damaged_files_are_refused() {
    let (program, file) = example();
    assert!(loaded(&program, &file).is_ok());
    for end in 0..file.len() {
        let error = loaded(&program, &file[..end]).expect_err("a part is missing");
        let expected = match end {
            0..16 => matches!(error, SnapshotError::NotASnapshot),
            _ => matches!(error, SnapshotError::Truncated),
        };
        assert!(expected, "{end}: {error}");
    }
    for at in 0..file.len() {
        let mut damaged = file.clone();
        damaged[at] ^= 1 << (at % 8);
        let error = loaded(&program, &damaged).expect_err("a bit differs");
        match at {
            0..16 => assert!(matches!(error, SnapshotError::NotASnapshot), "{at}: {error}"),
            16..20 => assert!(
                matches!(error, SnapshotError::Version { expected: 1, .. }),
                "{at}: {error}"
            ),
            20..52 => assert!(matches!(error, SnapshotError::OtherProgram), "{at}: {error}"),
            _ => {}
        }
    }
    let error = loaded(&program, &[&file[..], b"x"].concat()).expect_err("a byte too many");
    assert!(matches!(error, SnapshotError::Corrupt), "{error}");
}

/// Replaces the checksum of a file by the right one.
fn sealed(mut file: Vec<u8>) -> Vec<u8> {
    let end = file.len() - 32;
    let hash = Sha256::digest(&file[..end]);
    file[end..].copy_from_slice(&hash);
    file
}

proptest! {
    #![proptest_config(cases(600))]

    /// What is written on purpose has a good checksum. It is refused, or is a session that goes on without a panic.
    #[test]
    fn hostile_files_do_no_harm(changes in proptest::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..4)) {
        let (program, mut file) = example();
        for (at, byte) in changes {
            let at = 52 + at.index(file.len() - 52 - 32);
            file[at] = byte;
        }
        if let Ok(mut session) = loaded(&program, &sealed(file)) {
            for step in 0..6 {
                session.insert("e", ("a", step)).unwrap();
                let _ = session.advance();
            }
            let mut text = Vec::new();
            for (id, _) in (0..).map(PredicateId).zip(&program.rules().predicates) {
                facts::write_rows(&session, id, &RowFormat::default(), &mut text).unwrap();
            }
        }
    }
}

/// A length of a terabyte takes no memory: the file ends before.
#[test]
fn lengths_are_not_believed() {
    let (program, file) = example();
    for at in 52..file.len() - 40 {
        let mut hostile = file.clone();
        hostile[at..at + 8].copy_from_slice(&(1_u64 << 40).to_le_bytes());
        let limits = Limits {
            bytes: 1 << 20,
            ..Limits::default()
        };
        if let Ok(session) = program.load_session(&mut &sealed(hostile)[..], limits) {
            assert!(session.bytes() <= 1 << 20, "at {at}");
        }
    }
    let limits = Limits {
        bytes: 2048,
        ..Limits::default()
    };
    let error = program
        .load_session(&mut &file[..], limits)
        .expect_err("two KiB are too few");
    assert_eq!(error.to_string(), "the saved session takes more than 0 MiB of memory");
}
