//! The encoding with several agents: the rules decide for all of them.
//!
//! The state has the place of every agent that can matter to the ego before the horizon. A place of an agent is what
//! determines its later moves ([`LocalState`]); places are found by taking every action at every tick, so that they
//! include new goals, whose draws the seed decides. A step has two actions: the planner chooses for the ego, then all
//! agents move at once, each as its axioms decide on the state before.

use crate::city::{Action, Agent, Cell, Rest};
use crate::diag::Diagnostic;
use crate::diag::codes as common;
use crate::predicate::Definition;
use crate::sim::{Chance, Entity, Simulation, entity, ground};
use crate::task::spf::SpfTask;
use crate::task::spf::lookahead::{LocalState, local_state};
use crate::task::spf::pddl::fragment::Fragment;
use crate::task::spf::pddl::names::Names;
use crate::task::spf::pddl::one::{ARRIVE, parameters, variables};
use crate::task::spf::pddl::{Costs, Course, Encoding, PddlTask, STATES_MAX, domain_heading, increase};
use std::cell::Cell as Slot;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;
use std::sync::Arc;

/// The places of an agent before the horizon.
struct Places {
    /// The agent at each place, and its name. The first place is that at the start.
    agents: Vec<(Agent, String)>,
    /// The places that it may have at each tick since the start.
    layers: Vec<BTreeSet<usize>>,
    /// The place to which an action moves it, by action, place and tick.
    moves: BTreeMap<(Action, usize), BTreeMap<usize, usize>>,
}

impl Places {
    /// Finds the places of an agent; `actions` are those that it may take.
    fn explore(course: &Course, index: usize, actions: &[Action]) -> Places {
        let start = &course.states[0].agents[index];
        let own_trip = local_state(start).0;
        let mut found: BTreeMap<LocalState, usize> = BTreeMap::from([(local_state(start), 0)]);
        let mut names = Names::default();
        // The places on the route at the start are numbered by their cells.
        let mut name = |agent: &Agent| match (local_state(agent).0 == own_trip, agent.rest) {
            (true, Rest::UnderWay) => names.unique(&format!("p{}", agent.position())),
            (true, _) => names.unique(&format!("p{}-rest", agent.position())),
            (false, _) => names.unique(&format!("n{}", agent.position())),
        };
        let mut places = Places {
            agents: vec![(start.clone(), name(start))],
            layers: vec![BTreeSet::from([0])],
            moves: BTreeMap::new(),
        };
        for (tick, state) in course.states[..course.states.len() - 1].iter().enumerate() {
            let mut next = BTreeSet::new();
            for &place in &places.layers[tick] {
                for &action in actions {
                    let moment = (index, u64::from(state.steps));
                    let moved = course.lookahead.moved_from(&places.agents[place].0, moment, action);
                    let to = *found.entry(local_state(&moved)).or_insert_with(|| {
                        places.agents.push((moved.clone(), name(&moved)));
                        places.agents.len() - 1
                    });
                    next.insert(to);
                    places.moves.entry((action, place)).or_default().insert(tick, to);
                }
            }
            places.layers.push(next);
        }
        places
    }

    /// Returns the cells of all places.
    fn cells(&self) -> impl Iterator<Item = Cell> + '_ {
        self.agents.iter().map(|(agent, _)| agent.cell)
    }
}

/// Writes domain and problem.
pub(super) fn encode(course: Course, costs: Costs) -> Result<PddlTask, Diagnostic> {
    let task = Arc::clone(course.lookahead.env().task());
    let mut names = Names::default();
    let fragment = Fragment::new(task.world(), task.oracle().constraints(), &mut names)?;
    let tables = Tables::new(&fragment, &mut names);
    let ego = course.lookahead.ego();
    let table = &task.world().scenario.actions.table;
    let count = course.states[0].agents.len();
    let places = (0..count).map(|index| {
        let kind = course.states[0].agents[index].kind_id;
        let actions: Vec<Action> = match index == ego {
            true => task.possible_actions().to_vec(),
            false => table.all().filter(|&action| table.can_take(kind, action)).collect(),
        };
        Places::explore(&course, index, &actions)
    });
    let places: Vec<Places> = places.collect();
    let is_local = fragment.is_local();
    let matter = relevant(&course, &places, is_local);
    let init = facts(&course, (&fragment, &tables), &places, &matter, is_local)?;
    let agents = course.agent_names();
    let listed: String = matter.iter().map(|index| format!(" {}", agents[*index])).collect();
    let of_all: BTreeSet<&str> = matter
        .iter()
        .flat_map(|&index| &places[index].agents)
        .map(|(_, name)| name.as_str())
        .collect();
    let of_all: String = of_all.into_iter().map(|name| format!(" {name}")).collect();
    let observed = task.oracle().entities();
    let counts: String = (0..observed.saturating_sub(1))
        .map(|count| format!(" k{count}"))
        .collect();
    let counts = if counts.is_empty() {
        String::new()
    } else {
        format!("\n   {counts} - count")
    };
    let problem = format!(
        "{}(define (problem {})\n  (:domain logicity)\n  (:objects\n   {} - tick\n   {of_all} - place\n   {listed} - \
         agent{counts})\n  (:init\n{}{init}    (= (total-cost) 0)\n  )\n  (:goal (arrived))\n  (:metric minimize \
         (total-cost))\n)\n",
        course.heading(&costs),
        Names::default().unique(&course.name),
        course.tick_names(),
        course.ticks(),
    );
    Ok(PddlTask {
        domain: tables.domain(&fragment, &task, &costs),
        problem,
        horizon: course.horizon(),
        costs,
        reaches_goal: course.reaches_goal,
        cheapest: None,
    })
}

/// Returns the agents on which the ego and its rules may depend before the horizon, in list order: those that the ego
/// may see, those that these may see, and so on; all if the rules read more than what an agent sees.
fn relevant(course: &Course, places: &[Places], is_local: bool) -> Vec<usize> {
    if !is_local {
        return (0..places.len()).collect();
    }
    let view = course.lookahead.env().task().world().scenario.view;
    let meet = |x: usize, y: usize| places[x].cells().any(|x| places[y].cells().any(|y| near(x, y, view)));
    let mut found = BTreeSet::new();
    let mut waiting = vec![course.lookahead.ego()];
    while let Some(x) = waiting.pop() {
        if found.insert(x) {
            waiting.extend((0..places.len()).filter(|y| !found.contains(y) && meet(x, *y)));
        }
    }
    found.into_iter().collect()
}

/// Returns whether two cells are at most so many rows and columns apart.
fn near(x: Cell, y: Cell, cells: u32) -> bool {
    x.row.abs_diff(y.row) <= cells && x.col.abs_diff(y.col) <= cells
}

/// The draws of a city for one pair of agents at a tick.
struct PairDraws<'a> {
    city: &'a Simulation,
    tick: u64,
    /// The positions of the agents in the list.
    agents: [usize; 2],
    /// Whether a draw was made.
    drew: Slot<bool>,
}

impl Chance for PairDraws<'_> {
    fn tick(&self) -> u64 {
        self.tick
    }

    fn word(&self) -> u64 {
        0
    }

    fn happens(&self, predicate: usize, first: usize, second: usize, probability: f64) -> bool {
        self.drew.set(true);
        let [first, second] = [first, second].map(|entity| self.agents[entity]);
        self.city.happens(self.tick, predicate, [first, second], probability)
    }
}

/// Returns the facts of the problem.
fn facts(
    course: &Course,
    (fragment, tables): (&Fragment<'_>, &Tables),
    places: &[Places],
    matter: &[usize],
    is_local: bool,
) -> Result<String, Diagnostic> {
    let env = course.lookahead.env();
    let world = env.task().world();
    let (ego, first) = (course.lookahead.ego(), course.states[0].steps as usize);
    let names = course.agent_names();
    let mut text = format!("    (ego {})\n", names[ego]);
    let mut add = |fact: String| writeln!(text, "    {fact}").expect("strings take all text");
    for (at, &index) in matter.iter().enumerate() {
        let (name, of) = (&names[index], &places[index]);
        add(format!("(at {name} {})", of.agents[0].1));
        add(format!(
            "({} {name})",
            tables.kind(course.states[0].agents[index].kind_id.index())
        ));
        match at.checked_sub(1) {
            None => add(format!("(first {name})")),
            Some(before) => add(format!("(follows {name} {})", names[matter[before]])),
        }
        for ((action, place), to) in &of.moves {
            let deed = fragment.deed(*action);
            let place_name = &of.agents[*place].1;
            let goals: BTreeSet<usize> = to.values().copied().collect();
            // A move to the same place changes nothing.
            match goals.iter().collect::<Vec<_>>()[..] {
                [to] if to == place => {}
                [to] => add(format!("(moves {name} {deed} {place_name} {})", of.agents[*to].1)),
                _ => {
                    for (tick, to) in to.iter().filter(|(_, to)| *to != place) {
                        add(format!(
                            "(draws {name} {deed} t{} {place_name} {})",
                            first + tick,
                            of.agents[*to].1
                        ));
                    }
                }
            }
        }
    }
    for (tick, layer) in places[ego].layers.iter().enumerate().skip(1) {
        let places = layer.iter().map(|place| &places[ego].agents[*place]);
        for (_, name) in places.filter(|(agent, _)| course.is_end(tick, agent.position())) {
            add(format!("(end t{} {name})", first + tick));
        }
    }
    let observed = env.task().oracle().entities();
    for count in 0..observed.saturating_sub(1) {
        match count {
            0 => add("(none k0)".to_owned()),
            _ => add(format!("(next-count k{} k{count})", count - 1)),
        }
    }
    let base: Vec<usize> = fragment.base_predicates().collect();
    let unread = |predicate: usize| !base.contains(&predicate);
    // Atoms about one agent, by place.
    let vocabulary = &world.vocabulary;
    let ground_of = |agents: &[&Agent], chance: &PairDraws<'_>| {
        let entities: Vec<Entity<'_>> = agents.iter().map(|agent| entity(agent)).collect();
        ground(vocabulary, world.map(), world.scenario.view, &entities, chance, unread)
    };
    let mut count = 0;
    for &x in matter {
        let draws = PairDraws {
            city: env.city(),
            tick: first as u64,
            agents: [x, x],
            drew: Slot::new(false),
        };
        let mut truths: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
        for (place, (agent, _)) in places[x].agents.iter().enumerate() {
            let facts = ground_of(&[agent], &draws);
            for &predicate in base.iter().filter(|&&predicate| !facts.rows[predicate].is_empty()) {
                truths.entry(predicate).or_default().push(place);
            }
        }
        for (predicate, holds) in truths {
            let of = match vocabulary.predicates[predicate].arity {
                1 => names[x].clone(),
                _ => format!("{} {}", names[x], names[x]),
            };
            let table = tables.of(predicate);
            if holds.len() == places[x].agents.len() {
                add(format!("({} {of})", table.always));
                continue;
            }
            for place in holds {
                let at = &places[x].agents[place].1;
                match vocabulary.predicates[predicate].arity {
                    1 => add(format!("({} {} {at})", table.at, names[x])),
                    _ => add(format!("({} {} {at} {} {at})", table.at, names[x], names[x])),
                }
            }
        }
    }
    let is_pair = |predicate: &&usize| matches!(vocabulary.predicates[**predicate].definition, Definition::Pair(_));
    let pairs: Vec<usize> = base.iter().filter(is_pair).copied().collect();
    let distance = if is_local { 2 * world.scenario.view } else { u32::MAX };
    for (&x, &y) in matter
        .iter()
        .flat_map(|x| matter.iter().map(move |y| (x, y)))
        .filter(|(x, y)| x != y)
    {
        // Where an atom holds: at both places, or at both places and these ticks.
        let mut holds: BTreeMap<usize, Vec<(usize, usize, Option<usize>)>> = BTreeMap::new();
        let mut fails: BTreeSet<usize> = BTreeSet::new();
        for (p, (first_agent, _)) in places[x].agents.iter().enumerate() {
            for (q, (second_agent, _)) in places[y].agents.iter().enumerate() {
                if !near(first_agent.cell, second_agent.cell, distance) {
                    continue;
                }
                let ticks = (0..places[x].layers.len())
                    .filter(|&tick| places[x].layers[tick].contains(&p) && places[y].layers[tick].contains(&q));
                let ticks: Vec<usize> = ticks.collect();
                let mut drawn = false;
                for (number, tick) in ticks.iter().enumerate() {
                    if number > 0 && !drawn {
                        break;
                    }
                    let draws = PairDraws {
                        city: env.city(),
                        tick: (first + tick) as u64,
                        agents: [x, y],
                        drew: Slot::new(false),
                    };
                    let facts = ground_of(&[first_agent, second_agent], &draws);
                    drawn = drawn || draws.drew.get();
                    for &predicate in &pairs {
                        let is_drawn = vocabulary.predicates[predicate].definition.is_drawn();
                        if number > 0 && !is_drawn {
                            continue;
                        }
                        match facts.rows[predicate].contains(&[0, 1]) {
                            true => {
                                let at = is_drawn.then_some(*tick).filter(|_| drawn);
                                holds.entry(predicate).or_default().push((p, q, at));
                            }
                            false => {
                                fails.insert(predicate);
                            }
                        }
                    }
                }
            }
        }
        for (predicate, holds) in holds {
            let (table, x, y) = (tables.of(predicate), (x, &names[x]), (y, &names[y]));
            if !fails.contains(&predicate) {
                add(format!("({} {} {})", table.always, x.1, y.1));
                continue;
            }
            count += holds.len();
            for (p, q, tick) in holds {
                let (p, q) = (&places[x.0].agents[p].1, &places[y.0].agents[q].1);
                match tick {
                    None => add(format!("({} {} {p} {} {q})", table.at, x.1, y.1)),
                    Some(tick) => add(format!("({} t{} {} {p} {} {q})", table.then, first + tick, x.1, y.1)),
                }
            }
        }
        if count > STATES_MAX {
            let message = format!("more than {STATES_MAX} facts about pairs of places");
            return Err(Diagnostic::new(common::LIMIT_EXCEEDED, message).help("set a shorter horizon"));
        }
    }
    Ok(text)
}

/// The names of the tables of a base predicate.
struct Table {
    predicate: usize,
    name: String,
    arity: usize,
    always: String,
    at: String,
    then: String,
}

struct Tables {
    base: Vec<Table>,
    /// The name of the predicate of each kind of agents.
    kinds: Vec<String>,
}

impl Tables {
    fn new(fragment: &Fragment<'_>, names: &mut Names) -> Tables {
        let world = fragment.world();
        let mut table = |predicate: usize| {
            let name = fragment.base_name(predicate);
            Table {
                predicate,
                name: name.to_owned(),
                arity: world.vocabulary.predicates[predicate].arity,
                always: names.unique(&format!("{name}-always")),
                at: names.unique(&format!("{name}-where")),
                then: names.unique(&format!("{name}-then")),
            }
        };
        let base = fragment.base_predicates().map(&mut table).collect();
        let kinds = world
            .scenario
            .kinds
            .all()
            .map(|kind| names.unique(&format!("kind-{}", world.scenario.kinds.name(kind))));
        Tables {
            base,
            kinds: kinds.collect(),
        }
    }

    fn of(&self, predicate: usize) -> &Table {
        let table = self.base.iter().find(|table| table.predicate == predicate);
        table.expect("a rule reads it")
    }

    fn kind(&self, kind: usize) -> &str {
        &self.kinds[kind]
    }

    fn domain(&self, fragment: &Fragment<'_>, task: &SpfTask, costs: &Costs) -> String {
        let world = task.world();
        let mut text = domain_heading(task, Encoding::MultiAgent);
        text += "(define (domain logicity)\n  (:requirements :strips :typing :equality :negative-preconditions \
                 :disjunctive-preconditions\n    :existential-preconditions :conditional-effects :derived-predicates \
                 :action-costs)\n  (:types agent tick place deed count)\n";
        let deeds: Vec<&str> = world
            .vocabulary
            .actions()
            .all()
            .map(|action| fragment.deed(action))
            .collect();
        writeln!(text, "  (:constants {} - deed)", deeds.join(" ")).expect("strings take all text");
        text += "  (:predicates\n    ; the state: the tick, the place of each agent on its route, and what the ego has \
                 chosen\n    (now ?t - tick)\n    (at ?x - agent ?p - place)\n    (moving)\n    (chosen ?a - deed)\n    \
                 (arrived)\n    ; facts of the problem; draws are moves that depend on the tick\n    \
                 (next ?t ?u - tick)\n    (moves ?x - agent ?a - deed ?p ?q - place)\n    \
                 (draws ?x - agent ?a - deed ?t - tick ?p ?q - place)\n    (end ?t - tick ?p - place)\n    (ego ?x - agent)\n    \
                 ; the list of agents, of which the ego observes only the first that it sees\n    (first ?x - agent)\n    \
                 (follows ?y ?x - agent)\n    (none ?k - count)\n    (next-count ?k ?l - count)\n";
        for kind in &self.kinds {
            writeln!(text, "    ({kind} ?x - agent)").expect("strings take all text");
        }
        text += "    ; tables: atoms that hold always, at places, or at a tick and places\n";
        for table in &self.base {
            let (of, at) = (parameters(table.arity), at_places(table.arity));
            writeln!(text, "    ({}{of})\n    ({}{at})", table.always, table.at).expect("strings take all text");
            if table.arity == 2 {
                writeln!(text, "    ({} ?t - tick{at})", table.then).expect("strings take all text");
            }
        }
        text += "    ; derived\n    (before ?y - agent ?k - count)\n    (observed ?y - agent)\n    \
                 (does ?x - agent ?a - deed)\n";
        for table in &self.base {
            writeln!(text, "    ({}{})", table.name, parameters(table.arity)).expect("strings take all text");
        }
        for line in fragment.declarations() {
            writeln!(text, "    {line}").expect("strings take all text");
        }
        text += "    (violated ?taken - deed))\n  (:functions (total-cost) - number)\n\n";
        for table in &self.base {
            text += &table.axiom();
        }
        text += &observed(fragment, task);
        text += "\n  ; What the rules derive of what there is\n";
        text += &fragment.decisions(false);
        text += "\n  ; The action that an agent takes: the first that is derived, by precedence\n";
        text += &self.precedence(fragment);
        text += "\n  ; What the rules demand of the ego, of what it observes, if it takes exactly one action\n";
        text += &fragment.demands();
        for (action, cost) in &costs.of {
            let deed = fragment.deed(*action);
            writeln!(
                text,
                "\n  (:action choose-{deed}\n    :parameters ()\n    :precondition (and (not (moving)) (not (violated \
                 {deed})))\n    :effect (and (moving) (chosen {deed}){}))",
                increase(Some(*cost))
            )
            .expect("strings take all text");
        }
        text += "\n  (:action tick\n    :parameters (?t ?u - tick)\n    :precondition (and (moving) (now ?t) (next ?t \
                 ?u))\n    :effect (and (not (moving)) (not (now ?t)) (now ?u)\n      \
                 (forall (?a - deed) (when (chosen ?a) (not (chosen ?a))))\n      \
                 (forall (?x - agent ?a - deed ?p ?q - place)\n        \
                 (when (and (moves ?x ?a ?p ?q) (at ?x ?p) (does ?x ?a)) (and (not (at ?x ?p)) (at ?x ?q))))\n      \
                 (forall (?x - agent ?a - deed ?p ?q - place)\n        \
                 (when (and (draws ?x ?a ?t ?p ?q) (at ?x ?p) (does ?x ?a)) (and (not (at ?x ?p)) (at ?x ?q))))))\n\n";
        let arrive = ARRIVE.replace("(?t - tick ?p - place)", "(?t - tick ?x - agent ?p - place)");
        text + &arrive.replace("(at ?p)", "(not (moving)) (ego ?x) (at ?x ?p)") + ")\n"
    }

    /// Returns the axioms of the actions that agents take.
    fn precedence(&self, fragment: &Fragment<'_>) -> String {
        let scenario = &fragment.world().scenario;
        let mut text = "  (:derived (does ?x - agent ?a - deed) (and (ego ?x) (chosen ?a)))\n".to_owned();
        for kind in scenario.kinds.all() {
            let (priority, default) = scenario.actions.order(kind);
            let mut earlier = String::new();
            let kind_name = self.kind(kind.index());
            let mut derive = |deed: &str, condition: &str| {
                writeln!(
                    text,
                    "  (:derived (does ?x - agent ?a - deed)\n    (and (not (ego ?x)) ({kind_name} ?x) (= ?a \
                     {deed}){condition}))"
                )
                .expect("strings take all text");
            };
            for &action in priority
                .iter()
                .filter(|&&action| scenario.actions.table.can_take(kind, action))
            {
                let Some(wants) = fragment.wants(action) else { continue };
                derive(fragment.deed(action), &format!(" ({wants} ?x){earlier}"));
                write!(earlier, " (not ({wants} ?x))").expect("strings take all text");
            }
            derive(fragment.deed(default), &earlier);
        }
        text
    }
}

impl Table {
    fn axiom(&self) -> String {
        let (of, names) = (parameters(self.arity), variables(self.arity));
        let Table {
            name, always, at, then, ..
        } = self;
        match self.arity {
            1 => format!(
                "  (:derived ({name}{of})\n    (or ({always}{names})\n      (exists (?p0 - place) (and (at ?x0 ?p0) ({at} \
                 ?x0 ?p0)))))\n"
            ),
            _ => format!(
                "  (:derived ({name}{of})\n    (or ({always}{names})\n      (exists (?p0 ?p1 - place)\n        (and (at ?x0 \
                 ?p0) (at ?x1 ?p1) ({at} ?x0 ?p0 ?x1 ?p1)))\n      (exists (?t - tick ?p0 ?p1 - place)\n        (and (now \
                 ?t) (at ?x0 ?p0) (at ?x1 ?p1) ({then} ?t ?x0 ?p0 ?x1 ?p1)))))\n"
            ),
        }
    }
}

/// Returns the parameters of a table of agents at places.
fn at_places(arity: usize) -> String {
    (0..arity)
        .map(|place| format!(" ?x{place} - agent ?p{place} - place"))
        .collect()
}

/// Returns the axioms of what the ego observes: itself and the first agents of the list that it sees.
fn observed(fragment: &Fragment<'_>, task: &SpfTask) -> String {
    let vocabulary = &fragment.world().vocabulary;
    let mut text = "\n  ; The ego observes itself and the first agents that it sees\n  \
                    (:derived (observed ?y - agent) (ego ?y))\n"
        .to_owned();
    if task.oracle().entities() == 1 {
        return text;
    }
    let sees = fragment.base_name(vocabulary.sees);
    write!(
        text,
        "  (:derived (before ?y - agent ?k - count) (and (first ?y) (none ?k)))\n  \
         (:derived (before ?y - agent ?k - count)\n    (exists (?x ?e - agent)\n      (and (follows ?y ?x) (before ?x ?k) \
         (ego ?e) (or (ego ?x) (not ({sees} ?e ?x))))))\n  \
         (:derived (before ?y - agent ?l - count)\n    (exists (?x ?e - agent ?k - count)\n      (and (follows ?y ?x) \
         (before ?x ?k) (next-count ?k ?l) (ego ?e) (not (ego ?x)) ({sees} ?e ?x))))\n  \
         (:derived (observed ?y - agent)\n    (exists (?e - agent ?k - count) (and (ego ?e) (before ?y ?k) ({sees} ?e \
         ?y))))\n"
    )
    .expect("strings take all text");
    text
}
