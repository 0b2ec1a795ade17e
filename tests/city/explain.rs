//! Explanations of every decision of a run.

use crate::proofs::{check, database};
use crate::shipped_world::world;
use logicity::city::{Action, Split};
use logicity::datalog::explain::{Explainer, Node, Origin};
use logicity::datalog::naive;
use logicity::rng::Seed;
use logicity::sim::{Settings, Simulation};

/// The simulation of a configuration.
fn city(config: &str) -> Simulation {
    Simulation::new(world(config, None, |_| ()), Split::Test, Seed(0), Settings::default()).unwrap()
}

/// For every decision of the paper's expert city: the proof of each derived action replays, and its leaves alone derive
/// the action. Every literal that the explanation of an absent action calls false is false.
#[test]
fn slow_every_decision_of_an_expert_run_is_explained() {
    let mut simulation = city("configs/expert.yaml");
    let (mut proofs, mut absences) = (0, 0);
    for _ in 0..300 {
        let report = simulation.tick(&[]).unwrap().clone();
        let snapshot = simulation.snapshot().unwrap();
        let session = snapshot.session();
        let rules = session.program().rules();
        let model = database(session);
        let mut explainer = Explainer::new(session);
        for (position, agent) in report.agents.iter().enumerate() {
            let mut held = Vec::new();
            for action in Action::STANDARD {
                let predicate = snapshot.world().vocabulary.action(action).unwrap();
                let row = [snapshot.value(position)];
                let explanation = match explainer.explain(predicate, &row).unwrap() {
                    Some(proof) => {
                        held.push(action);
                        proofs += 1;
                        let leaves = proof.nodes().iter().filter_map(|node| match node {
                            Node::Fact(fact) if fact.origin == Origin::Input => {
                                assert!(rules.predicates[fact.predicate.index()].input);
                                Some((fact.predicate, fact.row.clone()))
                            }
                            _ => None,
                        });
                        let derived = naive::evaluate(rules, session.symbols(), leaves);
                        assert!(derived[predicate.index()].contains(&row[..]));
                        proof
                    }
                    None => {
                        absences += 1;
                        let wanted = [Some(row[0])];
                        explainer
                            .explain_absence(predicate, &wanted)
                            .unwrap()
                            .expect("it does not hold")
                    }
                };
                check(session, &model, &explanation);
            }
            assert!(held.contains(&agent.action), "{held:?}");
        }
    }
    assert_eq!(
        (proofs, proofs + absences),
        (5_400, 4 * 5_400),
        "one action for each decision"
    );
}
