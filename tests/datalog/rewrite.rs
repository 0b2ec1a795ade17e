//! Rewritten rules derive the same rows of the outputs.

use crate::cases::cases;
use crate::random_program::{Genome, computing_genomes, genomes, recursive_genomes};
use crate::written_program::program;
use logicity_datalog::rewrite::{demand, unfold};
use logicity_datalog::{PredicateId, Program, Rules, Session, Value, facts, naive};
use proptest::prelude::*;

/// Bit i of `outputs`, `inline` and `magic` says whether predicate i has that mark.
fn check(genome: &Genome, outputs: u32, inline: u32, magic: u32) -> Result<(), TestCaseError> {
    let mut rules = genome.rules();
    let has = |bits: u32, index: usize| bits >> (index % 32) & 1 == 1;
    for (index, predicate) in rules.predicates.iter_mut().enumerate() {
        predicate.output = predicate.derived && has(outputs, index);
        predicate.inline = has(inline, index);
        predicate.magic = has(magic, index);
    }
    let mut rows: Vec<(PredicateId, Vec<Value>)> = Vec::new();
    for batch in genome.batches(&rules) {
        rows.extend(
            batch
                .into_iter()
                .filter(|(present, ..)| *present)
                .map(|(_, predicate, row)| (predicate, row)),
        );
    }
    let expected = naive::evaluate(&rules, &rules.symbols, rows.iter().cloned());
    let unfolded = unfold(&rules).map(|(rules, _)| rules);
    let demanded = demand(unfolded.as_ref().unwrap_or(&rules));
    for (what, rewritten) in [("unfolded", unfolded), ("demanded", demanded)] {
        let Some(rewritten) = rewritten else { continue };
        let specified = naive::evaluate(&rewritten, &rules.symbols, rows.iter().cloned());
        let mut session = Program::new(rewritten).expect("within the limits").session();
        for (predicate, row) in &rows {
            session.insert(*predicate, row).expect("a base predicate");
        }
        session.commit().expect("within the limits");
        for (index, predicate) in rules
            .predicates
            .iter()
            .enumerate()
            .filter(|(_, predicate)| predicate.output)
        {
            prop_assert_eq!(&specified[index], &expected[index], "{} {}", what, predicate.name);
            let found = session
                .encoded_rows(PredicateId(index as u32))
                .map(<[Value]>::to_vec)
                .collect();
            prop_assert_eq!(&expected[index], &found, "{} {}", what, predicate.name);
        }
    }
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig { max_shrink_iters: 20_000, ..cases(512) })]

    #[test]
    fn outputs_stay_the_same(genome in genomes(1..3), outputs: u32, inline: u32, magic: u32) {
        check(&genome, outputs, inline, magic)?;
    }

    #[test]
    fn outputs_of_recursive_programs_stay_the_same(genome in recursive_genomes(1..3), outputs: u32, inline: u32) {
        check(&genome, outputs, inline, u32::MAX)?;
    }

    #[test]
    fn outputs_of_computing_programs_stay_the_same(genome in computing_genomes(1..3), outputs: u32, inline: u32) {
        check(&genome, outputs, inline, u32::MAX)?;
    }
}

/// The rules as `query` evaluates them.
fn rewritten(text: &str) -> Rules {
    let rules = program(text).rules().clone();
    let rules = unfold(&rules).map_or(rules, |(rules, _)| rules);
    demand(&rules).unwrap_or(rules)
}

fn evaluated(rules: Rules, insert: impl Fn(&mut Session)) -> Session {
    let mut session = Program::new(rules).expect("within the limits").session();
    insert(&mut session);
    session.commit().expect("within the limits");
    session
}

/// All rows of derived predicates.
fn derived(session: &Session) -> usize {
    let rules = session.program().rules();
    let all = rules.strata.iter().flat_map(|stratum| &stratum.predicates);
    all.map(|predicate| session.len(*predicate)).sum()
}

/// Predicates that use each other are not unfolded. The checker refuses them, so the marks come after it.
#[test]
fn a_cycle_of_inline_predicates_is_kept() {
    let text = ".decl E(x: number) .input E .decl A(x: number) .decl B(x: number) .decl C(x: number) .output C
        A(x) :- B(x). B(x) :- A(x). C(x) :- A(x). C(x) :- E(x).";
    let mut rules = program(text).rules().clone();
    for name in ["A", "B"] {
        let predicate = rules.predicate(name).expect("declared");
        rules.predicates[predicate.index()].inline = true;
    }
    let (unfolded, kept) = unfold(&rules).expect("marked predicates");
    assert_eq!((kept.len(), unfolded.clauses.len()), (2, rules.clauses.len()));
}

#[test]
fn an_inline_product_is_not_computed() {
    let text = ".decl A(x: number, y: number)
        .input A
        .decl Pair(x: number, y: number, u: number, v: number) inline
        Pair(x, y, u, v) :- A(x, y), A(u, v).
        .decl Joined, Never(x: number, v: number)
        .output Joined, Never
        Joined(x, v) :- Pair(x, y, y, v).
        Never(x, y) :- A(x, y), !Pair(x, y, y, x).";
    let insert = |session: &mut Session| {
        let a = session.program().predicate("A").unwrap();
        for x in 0..100 {
            session.insert(a, [Value::number(x), Value::number(x + 1)]).unwrap();
        }
    };
    let rewritten = evaluated(rewritten(text), insert);
    let plain = evaluated(program(text).rules().clone(), insert);
    for name in ["Joined", "Never"] {
        let printed = |session: &Session| facts::print(session, session.program().predicate(name).unwrap());
        assert_eq!(printed(&rewritten), printed(&plain));
    }
    assert_eq!((derived(&rewritten), derived(&plain)), (99 + 100, 99 + 100 + 100 * 100));
}

/// An aggregate keeps its predicate: unfolding would count other rows.
/// Heads that repeat a variable or have a constant need equalities in the variables of the clause.
#[test]
fn a_negated_inline_predicate_with_equal_columns_is_unfolded() {
    let text = ".decl B(x: number, y: number)
        B(1, 2). B(3, 3). B(4, 3). B(3, 4).
        .decl Q(x: number, y: number) inline
        Q(w, w) :- B(w, w).
        .decl One(x: number) inline
        One(1) :- B(1, 2).
        .decl O(x: number, y: number)
        .decl P(x: number)
        .output O, P
        O(x, y) :- B(x, y), !Q(y, x).
        P(x) :- B(x, _), !One(x).";
    let session = evaluated(rewritten(text), |_| ());
    let rows = |name| facts::print(&session, session.program().predicate(name).unwrap());
    assert_eq!(
        (rows("O"), rows("P")),
        ("1\t2\n3\t4\n4\t3\n".to_owned(), "3\n4\n".to_owned())
    );
}

#[test]
fn an_inline_predicate_in_an_aggregate_is_counted_once() {
    let text = ".decl A(x: number, y: number)
        A(1, 1). A(1, 2). A(2, 3).
        .decl First(x: number) inline
        First(x) :- A(x, _).
        .decl N(n: number)
        .output N
        N(n) :- n = count : { First(_) }.
        N(n) :- n = 10 + count : { First(x), A(x, y) }.";
    let session = evaluated(rewritten(text), |_| ());
    assert_eq!(
        facts::print(&session, session.program().predicate("N").unwrap()),
        "2\n13\n"
    );
}

#[test]
fn demanded_paths_begin_at_the_constant() {
    let text = ".pragma \"magic-transform\" \"*\"
        .decl Edge(x: number, y: number)
        .input Edge
        .decl Path(x: number, y: number)
        Path(x, y) :- Edge(x, y).
        Path(x, z) :- Path(x, y), Edge(y, z).
        .decl Dead_end(x: number)
        Dead_end(x) :- Edge(_, x), !Edge(x, _).
        .decl From, Stuck(y: number)
        .output From, Stuck
        From(y) :- Path(90, y).
        Stuck(y) :- Path(90, y), Dead_end(y).";
    let insert = |session: &mut Session| {
        let edge = session.program().predicate("Edge").unwrap();
        for x in 0..100 {
            session.insert(edge, [Value::number(x), Value::number(x + 1)]).unwrap();
        }
    };
    let rewritten = evaluated(rewritten(text), insert);
    let plain = evaluated(program(text).rules().clone(), insert);
    for name in ["From", "Stuck"] {
        let printed = |session: &Session| facts::print(session, session.program().predicate(name).unwrap());
        assert_eq!(printed(&rewritten), printed(&plain));
    }
    // One demand, ten paths, and the answers; `Dead_end` is needed for one of them.
    assert!(derived(&rewritten) < 40, "{}", derived(&rewritten));
    assert!(derived(&plain) > 5_000);
}
