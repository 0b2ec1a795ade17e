//! The encoding with one agent: the others follow a course that is known.
//!
//! A state of the ego is a tick and a place on its route. The problem has those states that the ego can reach without a
//! violation, from which a plan can end, and in which every other agent acts as in the course that the rules
//! drive. So a plan has the same outcome in the city, although the others could react to the ego.

use crate::city::{Action, Agent};
use crate::diag::Diagnostic;
use crate::diag::codes as common;
use crate::task::spf::SpfTask;
use crate::task::spf::lookahead::{CityState, local_state};
use crate::task::spf::pddl::fragment::Fragment;
use crate::task::spf::pddl::names::Names;
use crate::task::spf::pddl::{Costs, Course, Encoding, PddlTask, STATES_MAX, domain_heading, increase};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;
use std::sync::Arc;

/// A state of the ego: the number of ticks since the start, and its place.
type State = (usize, usize);

/// What is known of a state.
struct Node {
    /// The place to which each action moves the ego.
    moves: Vec<(Action, usize)>,
    /// The actions that violate no clause.
    permitted: Vec<Action>,
    /// The agents that the ego observes.
    observed: Vec<usize>,
    /// The atoms that are true of them.
    atoms: BTreeSet<(usize, Vec<usize>)>,
}

/// Writes domain and problem; `axioms` says whether the rules are axioms of the domain.
pub(super) fn encode(mut course: Course, costs: Costs, axioms: bool) -> Result<PddlTask, Diagnostic> {
    let nodes = explore(&mut course, axioms)?;
    let (kept, cheapest) = useful(&course, &nodes, &costs);
    let task = Arc::clone(course.lookahead.env().task());
    let (domain, facts, agents) = match axioms {
        true => {
            let mut names = Names::default();
            let fragment = Fragment::new(task.world(), task.oracle().constraints(), &mut names)?;
            let tables = Tables::new(&fragment, &mut names);
            let (facts, agents) = tables.facts(&course, &nodes, &kept);
            (tables.domain(&fragment, &task, &costs), facts, agents)
        }
        false => (
            strips_domain(&task),
            permissions(&task, &course, &nodes, &kept),
            String::new(),
        ),
    };
    let places: BTreeSet<usize> = kept.iter().map(|(_, place)| *place).collect();
    let first = course.states[0].steps;
    let start = course.states[0].agents[course.lookahead.ego()].position();
    let mut init = course.ticks();
    writeln!(init, "    (at p{start})").expect("strings take all text");
    for (tick, place) in kept.iter().filter(|(tick, place)| course.is_end(*tick, *place)) {
        writeln!(init, "    (end t{} p{place})", first as usize + tick).expect("strings take all text");
    }
    let deeds = deeds(&task);
    for state in &kept {
        for (action, to) in nodes.get(state).into_iter().flat_map(|node| &node.moves) {
            if kept.contains(&(state.0 + 1, *to)) {
                let (deed, tick) = (&deeds[action.index()], first as usize + state.0);
                writeln!(init, "    (moves {deed} t{tick} p{} p{to})", state.1).expect("strings take all text");
            }
        }
    }
    init += &facts;
    let (metric, zero) = match axioms {
        true => ("\n  (:metric minimize (total-cost))", "    (= (total-cost) 0)\n"),
        false => ("", ""),
    };
    let places: String = places
        .iter()
        .chain([&start].into_iter().filter(|_| kept.is_empty()))
        .map(|place| format!(" p{place}"))
        .collect();
    let problem = format!(
        "{}(define (problem {})\n  (:domain logicity)\n  (:objects\n   {} - tick\n   {places} - place{agents})\n  \
         (:init\n{init}{zero}  )\n  (:goal (arrived)){metric}\n)\n",
        course.heading(&costs),
        Names::default().unique(&course.name),
        course.tick_names(),
    );
    Ok(PddlTask {
        domain,
        problem,
        horizon: course.horizon(),
        costs,
        reaches_goal: course.reaches_goal,
        cheapest,
    })
}

/// Returns the names of the actions as constants. They are those of a [`Fragment`] with new names.
fn deeds(task: &SpfTask) -> Vec<String> {
    let mut names = Names::default();
    task.world()
        .vocabulary
        .actions()
        .names()
        .map(|name| names.unique(name))
        .collect()
}

/// Explores the states that the ego can reach without a violation while the others follow the course.
fn explore(course: &mut Course, axioms: bool) -> Result<BTreeMap<State, Node>, Diagnostic> {
    let goal = course.goal;
    let Course { lookahead, states, .. } = course;
    let ego = lookahead.ego();
    let possible = lookahead.env().task().possible_actions().to_vec();
    let mut nodes = BTreeMap::new();
    let start = &states[0].agents[ego];
    let mut layer = BTreeMap::from([(start.position(), start.clone())]);
    for (tick, pair) in states.windows(2).enumerate() {
        let mut next: BTreeMap<usize, Agent> = BTreeMap::new();
        for (place, agent) in std::mem::take(&mut layer) {
            if place == goal {
                continue;
            }
            if lookahead.env().city().cancel().requested() {
                return Err(Diagnostic::cancelled());
            }
            let mut state = CityState::clone(&pair[0]);
            state.agents[ego] = agent;
            lookahead.place(&state)?;
            let permitted: Vec<Action> = lookahead
                .allowed()
                .iter()
                .filter(|action| possible.contains(action))
                .collect();
            let after: Vec<(Action, Agent)> = possible
                .iter()
                .map(|&action| (action, lookahead.moved(ego, action)))
                .collect();
            let observer = lookahead.observer();
            let (observed, atoms) = match axioms {
                true => (observer.entities().collect(), observer.all_atoms().collect()),
                false => (Vec::new(), BTreeSet::new()),
            };
            let others = lookahead.others_moved()?;
            let is_as_known = others
                .iter()
                .zip(&pair[1].agents)
                .enumerate()
                .all(|(at, (agent, known))| at == ego || local_state(agent) == local_state(known));
            if !is_as_known {
                continue;
            }
            if nodes.len() == STATES_MAX {
                let message = format!("the ego has more than {STATES_MAX} states before the horizon");
                return Err(Diagnostic::new(common::LIMIT_EXCEEDED, message).help("set a shorter horizon"));
            }
            let moves = after
                .iter()
                .map(|(action, agent)| (*action, agent.position()))
                .collect();
            for (action, agent) in after {
                if permitted.contains(&action) {
                    next.insert(agent.position(), agent);
                }
            }
            let node = Node {
                moves,
                permitted,
                observed,
                atoms,
            };
            nodes.insert((tick, place), node);
        }
        layer = next;
    }
    Ok(nodes)
}

/// Returns the states on a way to an end, ends included, and the cost of the cheapest way.
fn useful(course: &Course, nodes: &BTreeMap<State, Node>, costs: &Costs) -> (BTreeSet<State>, Option<u64>) {
    let mut cheapest: BTreeMap<State, u64> = BTreeMap::new();
    // Later ticks come first.
    for (&(tick, place), node) in nodes.iter().rev() {
        for (action, to) in node.moves.iter().filter(|(action, _)| node.permitted.contains(action)) {
            let then = (tick + 1, *to);
            if course.is_end(tick + 1, *to) {
                cheapest.insert(then, 0);
            }
            if let Some(rest) = cheapest.get(&then) {
                let cost = rest + costs.of(*action).expect("an ego can take it");
                let known = cheapest.entry((tick, place)).or_insert(cost);
                *known = cost.min(*known);
            }
        }
    }
    let start = (0, course.states[0].agents[course.lookahead.ego()].position());
    let best = cheapest.get(&start).copied();
    // Forwards again, to keep only the states that the best ways visit.
    let mut kept = BTreeSet::new();
    let mut waiting: Vec<State> = best.map(|_| start).into_iter().collect();
    while let Some(state) = waiting.pop() {
        if !kept.insert(state) {
            continue;
        }
        for (action, to) in nodes.get(&state).into_iter().flat_map(|node| &node.moves) {
            let then = (state.0 + 1, *to);
            if nodes[&state].permitted.contains(action) && cheapest.contains_key(&then) {
                waiting.push(then);
            }
        }
    }
    (kept, best)
}

/// When an atom is true: in all states in which the ego observes its agents, at some ticks, at some places, or in some
/// states.
enum Truth {
    Always,
    When(BTreeSet<usize>),
    Where(BTreeSet<usize>),
    Then(Vec<State>),
}

/// Returns when an atom is true, given the states in which it is true and those in which it is false. It may be either
/// in others.
fn truth(holds: &[State], fails: &[State]) -> Truth {
    let ticks = |states: &[State]| states.iter().map(|(tick, _)| *tick).collect::<BTreeSet<usize>>();
    let places = |states: &[State]| states.iter().map(|(_, place)| *place).collect::<BTreeSet<usize>>();
    if fails.is_empty() {
        Truth::Always
    } else if ticks(holds).is_disjoint(&ticks(fails)) {
        Truth::When(ticks(holds))
    } else if places(holds).is_disjoint(&places(fails)) {
        Truth::Where(places(holds))
    } else {
        Truth::Then(holds.to_vec())
    }
}

/// The names of the tables of a base predicate.
struct Table {
    /// The position in the vocabulary; `None` for what the ego observes.
    predicate: Option<usize>,
    name: String,
    arity: usize,
    always: String,
    when: String,
    at: String,
    then: String,
}

struct Tables(Vec<Table>);

impl Tables {
    fn new(fragment: &Fragment<'_>, names: &mut Names) -> Tables {
        let mut table = |predicate: Option<usize>, name: &str, arity| Table {
            predicate,
            name: name.to_owned(),
            arity,
            always: names.unique(&format!("{name}-always")),
            when: names.unique(&format!("{name}-when")),
            at: names.unique(&format!("{name}-where")),
            then: names.unique(&format!("{name}-then")),
        };
        let observed = table(None, "observed", 1);
        let vocabulary = &fragment.world().vocabulary;
        let base = fragment.base_predicates().map(|predicate| {
            let (name, arity) = (fragment.base_name(predicate), vocabulary.predicates[predicate].arity);
            table(Some(predicate), name, arity)
        });
        let base: Vec<Table> = base.collect();
        Tables([observed].into_iter().chain(base).collect())
    }

    /// Returns the facts about the kept states, and the names of the observed agents as objects.
    fn facts(&self, course: &Course, nodes: &BTreeMap<State, Node>, kept: &BTreeSet<State>) -> (String, String) {
        let names = course.agent_names();
        let ego = course.lookahead.ego();
        let first = course.states[0].steps as usize;
        // Nothing is decided at an end, so it has no node.
        let known: Vec<(&State, &Node)> = kept
            .iter()
            .filter_map(|state| Some((state, nodes.get(state)?)))
            .collect();
        let mut agents = BTreeSet::from([ego]);
        agents.extend(known.iter().flat_map(|(_, node)| node.observed.iter().copied()));
        let mut facts = format!("    (ego {})\n", names[ego]);
        for table in &self.0 {
            let mut atoms: BTreeMap<Vec<usize>, [Vec<State>; 2]> = BTreeMap::new();
            for (state, node) in &known {
                let mut note = |of: Vec<usize>, holds: bool| {
                    atoms.entry(of).or_default()[usize::from(!holds)].push(**state);
                };
                match (table.predicate, table.arity) {
                    (None, _) => agents
                        .iter()
                        .for_each(|agent| note(vec![*agent], node.observed.contains(agent))),
                    (Some(predicate), arity) => {
                        for of in tuples(&node.observed, arity) {
                            let holds = node.atoms.contains(&(predicate, of.clone()));
                            note(of, holds);
                        }
                    }
                }
            }
            for (of, [holds, fails]) in &atoms {
                if holds.is_empty() {
                    continue;
                }
                let of: String = of.iter().map(|agent| format!(" {}", names[*agent])).collect();
                let rows: Vec<String> = match truth(holds, fails) {
                    Truth::Always => vec![format!("({}{of})", table.always)],
                    Truth::When(ticks) => ticks
                        .iter()
                        .map(|tick| format!("({} t{}{of})", table.when, first + tick))
                        .collect(),
                    Truth::Where(places) => places
                        .iter()
                        .map(|place| format!("({} p{place}{of})", table.at))
                        .collect(),
                    Truth::Then(states) => {
                        let states = states.iter();
                        states
                            .map(|(tick, place)| format!("({} t{} p{place}{of})", table.then, first + tick))
                            .collect()
                    }
                };
                rows.iter()
                    .for_each(|row| writeln!(facts, "    {row}").expect("strings take all text"));
            }
        }
        let agents: String = agents.iter().map(|agent| format!(" {}", names[*agent])).collect();
        (facts, format!("\n   {agents} - agent"))
    }

    fn domain(&self, fragment: &Fragment<'_>, task: &SpfTask, costs: &Costs) -> String {
        let mut text = domain_heading(task, Encoding::OneAgent);
        text += "(define (domain logicity)\n  (:requirements :strips :typing :equality :negative-preconditions \
                 :disjunctive-preconditions\n    :existential-preconditions :derived-predicates :action-costs)\n  \
                 (:types agent tick place deed)\n";
        let deeds: Vec<&str> = task
            .world()
            .vocabulary
            .actions()
            .all()
            .map(|action| fragment.deed(action))
            .collect();
        writeln!(text, "  (:constants {} - deed)", deeds.join(" ")).expect("strings take all text");
        text += "  (:predicates\n    ; the state: the tick, and the place of the ego on its route\n    (now ?t - tick)\n    \
                 (at ?p - place)\n    (arrived)\n    ; facts of the problem\n    (next ?t ?u - tick)\n    \
                 (moves ?a - deed ?t - tick ?p ?q - place)\n    (end ?t - tick ?p - place)\n    (ego ?x - agent)\n    \
                 ; tables: atoms that hold always, at a tick, at a place of the ego, or at both\n";
        for table in &self.0 {
            let of = parameters(table.arity);
            for (name, first) in [
                (&table.always, ""),
                (&table.when, " ?t - tick"),
                (&table.at, " ?p - place"),
                (&table.then, " ?t - tick ?p - place"),
            ] {
                writeln!(text, "    ({name}{first}{of})").expect("strings take all text");
            }
        }
        text += "    ; derived: what the ego observes, and what the rules derive and demand there\n";
        for table in &self.0 {
            writeln!(text, "    ({}{})", table.name, parameters(table.arity)).expect("strings take all text");
        }
        for line in fragment.declarations() {
            writeln!(text, "    {line}").expect("strings take all text");
        }
        text += "    (violated ?taken - deed))\n  (:functions (total-cost) - number)\n\n";
        for table in &self.0 {
            let (of, names) = (parameters(table.arity), variables(table.arity));
            let Table {
                name,
                always,
                when,
                at,
                then,
                ..
            } = table;
            writeln!(
                text,
                "  (:derived ({name}{of})\n    (or ({always}{names})\n      \
                 (exists (?t - tick) (and (now ?t) ({when} ?t{names})))\n      \
                 (exists (?p - place) (and (at ?p) ({at} ?p{names})))\n      \
                 (exists (?t - tick ?p - place) (and (now ?t) (at ?p) ({then} ?t ?p{names})))))"
            )
            .expect("strings take all text");
        }
        text += "\n  ; What the rules derive of what the ego observes\n";
        text += &fragment.decisions(true);
        text += "\n  ; What they demand of the ego if it takes exactly one action\n";
        text += &fragment.demands();
        for (action, cost) in &costs.of {
            let deed = fragment.deed(*action);
            writeln!(
                text,
                "\n  (:action go-{deed}\n    :parameters (?t ?u - tick ?p ?q - place)\n    :precondition (and (now ?t) \
                 (next ?t ?u) (at ?p) (moves {deed} ?t ?p ?q) (not (violated {deed})))\n    :effect (and (not (now ?t)) \
                 (now ?u) (not (at ?p)) (at ?q){}))",
                increase(Some(*cost))
            )
            .expect("strings take all text");
        }
        text + "\n" + ARRIVE + ")\n"
    }
}

/// The action that ends a plan.
pub(super) const ARRIVE: &str = "  (:action arrive
    :parameters (?t - tick ?p - place)
    :precondition (and (now ?t) (at ?p) (end ?t ?p))
    :effect (arrived))
";

/// Returns the parameters of a predicate over agents.
pub(super) fn parameters(arity: usize) -> String {
    (0..arity).map(|place| format!(" ?x{place} - agent")).collect()
}

/// Returns the variables of [`parameters`].
pub(super) fn variables(arity: usize) -> String {
    (0..arity).map(|place| format!(" ?x{place}")).collect()
}

/// Returns all lists of so many agents.
fn tuples(agents: &[usize], arity: usize) -> Vec<Vec<usize>> {
    (0..arity).fold(vec![Vec::new()], |lists, _| {
        let longer = |list: &Vec<usize>| {
            agents
                .iter()
                .map(|agent| [&list[..], &[*agent]].concat())
                .collect::<Vec<_>>()
        };
        lists.iter().flat_map(longer).collect()
    })
}

/// Returns the domain without axioms and costs, the same for all rules with the same actions.
fn strips_domain(task: &SpfTask) -> String {
    let mut text = domain_heading(task, Encoding::Strips);
    let deeds = deeds(task);
    writeln!(
        text,
        "(define (domain logicity)\n  (:requirements :strips :typing)\n  (:types tick place deed)\n  (:constants {} - \
         deed)\n  (:predicates\n    (now ?t - tick)\n    (at ?p - place)\n    (arrived)\n    (next ?t ?u - tick)\n    \
         (moves ?a - deed ?t - tick ?p ?q - place)\n    (permitted ?a - deed ?t - tick ?p - place)\n    (end ?t - tick \
         ?p - place))",
        deeds.join(" ")
    )
    .expect("strings take all text");
    for action in task.possible_actions() {
        let deed = &deeds[action.index()];
        writeln!(
            text,
            "\n  (:action go-{deed}\n    :parameters (?t ?u - tick ?p ?q - place)\n    :precondition (and (now ?t) (next \
             ?t ?u) (at ?p) (moves {deed} ?t ?p ?q) (permitted {deed} ?t ?p))\n    :effect (and (not (now ?t)) (now ?u) \
             (not (at ?p)) (at ?q)))"
        )
        .expect("strings take all text");
    }
    text + "\n" + ARRIVE + ")\n"
}

/// Returns the facts of the permitted actions.
fn permissions(task: &SpfTask, course: &Course, nodes: &BTreeMap<State, Node>, kept: &BTreeSet<State>) -> String {
    let (deeds, first) = (deeds(task), course.states[0].steps as usize);
    let mut facts = String::new();
    for state in kept {
        for action in nodes.get(state).into_iter().flat_map(|node| &node.permitted) {
            let (deed, tick) = (&deeds[action.index()], first + state.0);
            writeln!(facts, "    (permitted {deed} t{tick} p{})", state.1).expect("strings take all text");
        }
    }
    facts
}
