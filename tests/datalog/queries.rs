//! Ad hoc queries of a session, against all of its rows.

use crate::cases::cases;
use crate::random_program::{Genome, genomes, recursive_genomes};
use logicity_datalog::cancel::Cancel;
use logicity_datalog::diag::Sources;
use logicity_datalog::symbol::Symbol;
use logicity_datalog::{BaseType, InputPolicy, Predicate, Program, Session, Value, Workspace, export, quoted};
use proptest::prelude::*;
use std::collections::BTreeSet;
use std::path::Path;

/// A program with its workspace, from the text of random rules.
struct Asked {
    sources: Sources,
    workspace: Workspace,
    session: Session,
}

impl Asked {
    fn answer(&mut self, body: &str) -> BTreeSet<Vec<Value>> {
        let question = self.sources.add("<query>", body);
        let asked = self
            .workspace
            .ask(&self.sources, question, self.session.symbols().clone());
        let query = Program::new(asked.rules.unwrap_or_else(|| panic!("{body}: {:?}", asked.diagnostics)));
        let query = query.expect("the query is small");
        let mut answer = self.session.query(&query, &Cancel::never()).expect("the rows are few");
        answer.commit().expect("the rows are few");
        let id = query.predicate(Workspace::ANSWER).expect("every query has an answer");
        answer.encoded_rows(id).map(<[Value]>::to_vec).collect()
    }

    fn constant(&self, value: Value, base: BaseType) -> String {
        match base {
            BaseType::Symbol => quoted(self.session.symbols().resolve(Symbol(value.0)).unwrap()),
            _ => value.as_number().to_string(),
        }
    }
}

/// Asks for the rows of each predicate with the first value of one of its rows, and for those that another predicate of
/// the same columns lacks.
fn check(genome: &Genome) -> Result<(), TestCaseError> {
    let rules = genome.rules();
    let Ok(text) = export::souffle(&rules) else {
        return Err(TestCaseError::reject(
            "the rules have constants that plain Soufflé lacks",
        ));
    };
    let mut sources = Sources::new();
    let mut workspace = Workspace::new(InputPolicy::Extensible);
    let entry = sources.add("random.dl", text);
    workspace.add(&mut sources, entry, &|_: &Path| unreachable!());
    let program = Program::new(workspace.check().rules.expect("the program is valid")).expect("it is small");
    let mut session = program.session();
    for batch in genome.batches(&rules) {
        for (present, id, row) in batch {
            let predicate = &rules.predicates[id.index()];
            let word = |(word, base): (&Value, BaseType)| match base {
                BaseType::Symbol => {
                    session
                        .symbols()
                        .intern(rules.symbols.resolve(Symbol(word.0)).unwrap())
                        .0
                }
                _ => word.0,
            };
            let bases = predicate.columns.iter().map(|column| column.base);
            let row: Vec<Value> = row.iter().zip(bases).map(|cell| Value(word(cell))).collect();
            match present {
                true => session.insert(&predicate.name, &row).expect("the row fits"),
                false => session.retract(&predicate.name, &row).expect("the row fits"),
            }
        }
    }
    session.commit().expect("the program is small");
    let mut asked = Asked {
        sources,
        workspace,
        session,
    };
    let visible: Vec<Predicate> = program
        .rules()
        .predicates
        .iter()
        .filter(|one| !one.hidden)
        .cloned()
        .collect();
    for predicate in visible.iter().filter(|predicate| predicate.arity() > 0) {
        let id = program.predicate(&predicate.name).unwrap();
        let rows: BTreeSet<Vec<Value>> = asked.session.encoded_rows(id).map(<[Value]>::to_vec).collect();
        let names: Vec<String> = (0..predicate.arity()).map(|at| format!("v{at}")).collect();
        let name = &predicate.name;
        prop_assert_eq!(&asked.answer(&format!("{name}({})", names.join(", "))), &rows);
        let Some(first) = rows.iter().nth(rows.len() / 2).map(|row| row[0]) else {
            continue;
        };
        let constant = asked.constant(first, predicate.columns[0].base);
        let rest = names[1..].join(", ");
        let body = match rest.is_empty() {
            true => format!("{name}({constant})"),
            false => format!("{name}({constant}, {rest})"),
        };
        let expected = rows.iter().filter(|row| row[0] == first).map(|row| row[1..].to_vec());
        prop_assert_eq!(asked.answer(&body), expected.collect::<BTreeSet<_>>(), "{}", body);
        let bases = |of: &Predicate| of.columns.iter().map(|column| column.base).collect::<Vec<_>>();
        for other in visible.iter().filter(|other| bases(other) == bases(predicate)) {
            let names = names.join(", ");
            let id = program.predicate(&other.name).unwrap();
            let expected = rows.iter().filter(|row| !asked.session.contains(id, *row)).cloned();
            let expected: BTreeSet<Vec<Value>> = expected.collect();
            let body = format!("{name}({names}), !{}({names})", other.name);
            prop_assert_eq!(asked.answer(&body), expected, "{}", body);
        }
    }
    Ok(())
}

proptest! {
    #![proptest_config(cases(200))]

    #[test]
    fn queries_equal_filtered_rows(genome in genomes(1..3)) {
        check(&genome)?;
    }

    #[test]
    fn queries_of_recursive_programs_equal_filtered_rows(genome in recursive_genomes(1..2)) {
        check(&genome)?;
    }
}
