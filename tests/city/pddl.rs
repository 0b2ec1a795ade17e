//! Planning problems: a small interpreter of PDDL evaluates them, and the city says whether it is right.

use crate::shipped_world::{configured, task};
use logicity::builtin::BuiltinFiles;
use logicity::city::{Action, Agent, Split};
use logicity::diag::{Diagnostic, Sources};
use logicity::rng::{Purpose, RngExt, Seed};
use logicity::task::spf::pddl::{Encoding, PddlOptions, PddlTask, encode, read_plan, replay};
use logicity::task::spf::{ControlMode, Env, EpisodeSet, Planner, Policy, SearchBounds, SpfTask, codes, rollout};
use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::sync::Arc;

/// A term of Lisp.
#[derive(Clone, Debug, PartialEq)]
enum Term {
    Word(String),
    List(Vec<Term>),
}

impl Term {
    fn list(&self) -> &[Term] {
        match self {
            Term::List(list) => list,
            Term::Word(word) => panic!("`{word}` is no list"),
        }
    }

    fn word(&self) -> &str {
        match self {
            Term::Word(word) => word,
            Term::List(list) => panic!("{list:?} is no word"),
        }
    }

    /// Returns the first word of a list, and the rest.
    fn parts(&self) -> (&str, &[Term]) {
        let (first, rest) = self.list().split_first().expect("a list begins with a word");
        (first.word(), rest)
    }
}

fn read(text: &str) -> Term {
    let lines: Vec<&str> = text.lines().map(|line| line.split(';').next().unwrap()).collect();
    let spaced = lines.join(" ").replace('(', " ( ").replace(')', " ) ");
    let mut open: Vec<Vec<Term>> = vec![Vec::new()];
    for word in spaced.split_whitespace() {
        match word {
            "(" => open.push(Vec::new()),
            ")" => {
                let list = open.pop().unwrap();
                open.last_mut().unwrap().push(Term::List(list));
            }
            _ => open.last_mut().unwrap().push(Term::Word(word.to_lowercase())),
        }
    }
    assert_eq!((open.len(), open[0].len()), (1, 1), "parentheses match");
    open.pop().unwrap().pop().unwrap()
}

/// Returns the names of a typed list with their types.
fn typed(terms: &[Term]) -> Vec<(String, String)> {
    let (mut found, mut waiting) = (Vec::new(), Vec::new());
    let mut words = terms.iter().map(Term::word);
    while let Some(word) = words.next() {
        if word == "-" {
            let of = words.next().unwrap();
            found.extend(waiting.drain(..).map(|name: String| (name, of.to_owned())));
        } else {
            waiting.push(word.to_owned());
        }
    }
    assert!(waiting.is_empty(), "{waiting:?} have no type");
    found
}

type Row = Vec<String>;
type Binding = HashMap<String, String>;

/// Names, each with its type.
type Typed = Vec<(String, String)>;

/// A problem with its domain.
struct Problem {
    objects: BTreeMap<String, Vec<String>>,
    derived: HashMap<String, Vec<(Typed, Term)>>,
    actions: HashMap<String, (Typed, Term, Term)>,
    init: BTreeMap<String, BTreeSet<Row>>,
}

impl Problem {
    fn new(task: &PddlTask) -> Problem {
        let (domain, problem) = (read(&task.domain), read(&task.problem));
        let mut made = Problem {
            objects: BTreeMap::new(),
            derived: HashMap::new(),
            actions: HashMap::new(),
            init: BTreeMap::new(),
        };
        for part in domain.list()[1..].iter().chain(&problem.list()[1..]) {
            let (name, rest) = part.parts();
            match name {
                ":constants" | ":objects" => {
                    for (name, of) in typed(rest) {
                        made.objects.entry(of).or_default().push(name);
                    }
                }
                ":derived" => {
                    let (head, parameters) = rest[0].parts();
                    let axiom = (typed(parameters), rest[1].clone());
                    made.derived.entry(head.to_owned()).or_default().push(axiom);
                }
                ":action" => {
                    let of = |key: &str| {
                        let at = rest
                            .iter()
                            .position(|term| *term == Term::Word(key.to_owned()))
                            .unwrap();
                        rest[at + 1].clone()
                    };
                    let parameters = typed(of(":parameters").list());
                    let action = (parameters, of(":precondition"), of(":effect"));
                    made.actions.insert(rest[0].word().to_owned(), action);
                }
                ":init" => {
                    for fact in rest.iter().filter(|fact| fact.parts().0 != "=") {
                        let (name, row) = fact.parts();
                        let row = row.iter().map(|term| term.word().to_owned()).collect();
                        assert!(
                            made.init.entry(name.to_owned()).or_default().insert(row),
                            "{fact:?} twice"
                        );
                    }
                }
                _ => {}
            }
        }
        made
    }

    fn start(&self) -> State<'_> {
        State {
            of: self,
            facts: self.init.clone(),
            known: RefCell::default(),
        }
    }
}

/// A state of a problem.
struct State<'a> {
    of: &'a Problem,
    facts: BTreeMap<String, BTreeSet<Row>>,
    /// The derived atoms that were asked.
    known: RefCell<HashMap<(String, Row), bool>>,
}

fn value(term: &Term, binding: &Binding) -> Option<String> {
    match term.word().starts_with('?') {
        true => binding.get(term.word()).cloned(),
        false => Some(term.word().to_owned()),
    }
}

/// Returns whether all free variables of a formula are bound.
fn is_bound(formula: &Term, binding: &Binding) -> bool {
    match formula {
        Term::Word(word) => !word.starts_with('?') || binding.contains_key(word),
        Term::List(list) if matches!(list.first(), Some(Term::Word(word)) if word == "exists") => {
            let mut inner = binding.clone();
            inner.extend(typed(list[1].list()).into_iter().map(|(name, _)| (name, String::new())));
            is_bound(&list[2], &inner)
        }
        Term::List(list) => list.iter().all(|term| is_bound(term, binding)),
    }
}

impl<'a> State<'a> {
    fn atom(&self, name: &str, row: &[&str]) -> bool {
        let row: Row = row.iter().map(|word| (*word).to_owned()).collect();
        self.is_true(name, row)
    }

    fn is_true(&self, name: &str, row: Row) -> bool {
        let Some(axioms) = self.of.derived.get(name) else {
            return self.facts.get(name).is_some_and(|rows| rows.contains(&row));
        };
        let asked = (name.to_owned(), row);
        if let Some(known) = self.known.borrow().get(&asked) {
            return *known;
        }
        let holds = axioms.iter().any(|(parameters, body)| {
            let names = parameters.iter().map(|(name, _)| name.clone());
            self.holds(body, &names.zip(asked.1.iter().cloned()).collect())
        });
        self.known.borrow_mut().insert(asked, holds);
        holds
    }

    fn holds(&self, formula: &Term, binding: &Binding) -> bool {
        let (name, rest) = formula.parts();
        match name {
            "and" => rest.iter().all(|part| self.holds(part, binding)),
            "or" => rest.iter().any(|part| self.holds(part, binding)),
            "not" => !self.holds(&rest[0], binding),
            "=" => value(&rest[0], binding).unwrap() == value(&rest[1], binding).unwrap(),
            "exists" => {
                let mut inner = binding.clone();
                let variables = typed(rest[0].list());
                variables.iter().for_each(|(name, _)| {
                    inner.remove(name);
                });
                self.solutions(&variables, &[&rest[1]], &inner, &mut |_| true)
            }
            _ => {
                let row = rest
                    .iter()
                    .map(|term| value(term, binding).unwrap_or_else(|| panic!("{formula:?}")));
                self.is_true(name, row.collect())
            }
        }
    }

    /// Calls `found` for each binding of the variables that satisfies all formulas, until it returns true.
    fn solutions(
        &self,
        variables: &[(String, String)],
        formulas: &[&Term],
        binding: &Binding,
        found: &mut dyn FnMut(&Binding) -> bool,
    ) -> bool {
        let mut left: Vec<&Term> = Vec::new();
        for formula in formulas {
            match formula.parts() {
                ("and", rest) => left.extend(rest),
                _ => left.push(formula),
            }
        }
        let (bound, free): (Vec<&Term>, Vec<&Term>) = left.into_iter().partition(|part| is_bound(part, binding));
        if !bound.iter().all(|part| self.holds(part, binding)) {
            return false;
        }
        let Some((variable, of)) = variables.iter().find(|(name, _)| !binding.contains_key(name)) else {
            return found(binding);
        };
        let is_table = |part: &&&Term| {
            let name = part.parts().0;
            !["and", "or", "not", "=", "exists"].contains(&name) && !self.of.derived.contains_key(name)
        };
        if let Some(part) = free.iter().find(is_table) {
            let (name, terms) = part.parts();
            let rows = self.facts.get(name).into_iter().flatten();
            return rows.into_iter().any(|row| {
                let mut inner = binding.clone();
                let fits = terms.iter().zip(row).all(|(term, word)| match value(term, &inner) {
                    Some(known) => known == *word,
                    None => inner.insert(term.word().to_owned(), word.clone()).is_none(),
                });
                fits && self.solutions(variables, &free, &inner, found)
            });
        }
        let objects = self.of.objects.get(of).into_iter().flatten();
        objects.into_iter().any(|object| {
            let mut inner = binding.clone();
            inner.insert(variable.clone(), object.clone());
            self.solutions(variables, &free, &inner, found)
        })
    }

    /// Returns the state after an action with these arguments; `None` if its precondition fails.
    fn after(&self, name: &str, arguments: &[&str]) -> Option<State<'a>> {
        let (parameters, condition, effect) = &self.of.actions[name];
        let names = parameters.iter().map(|(name, _)| name.clone());
        let binding: Binding = names.zip(arguments.iter().map(|word| (*word).to_owned())).collect();
        if !self.holds(condition, &binding) {
            return None;
        }
        let (mut added, mut removed) = (Vec::new(), Vec::new());
        self.effects(effect, &binding, &mut added, &mut removed);
        let mut facts = self.facts.clone();
        for (name, row) in removed {
            facts.get_mut(&name).map(|rows| rows.remove(&row));
        }
        for (name, row) in added {
            facts.entry(name).or_default().insert(row);
        }
        Some(State {
            of: self.of,
            facts,
            known: RefCell::default(),
        })
    }

    fn effects(
        &self,
        effect: &Term,
        binding: &Binding,
        added: &mut Vec<(String, Row)>,
        removed: &mut Vec<(String, Row)>,
    ) {
        let fact = |term: &Term| {
            let (name, row) = term.parts();
            let row = row.iter().map(|term| value(term, binding).unwrap());
            (name.to_owned(), row.collect::<Row>())
        };
        let (name, rest) = effect.parts();
        match name {
            "and" => rest.iter().for_each(|part| self.effects(part, binding, added, removed)),
            "not" => removed.push(fact(&rest[0])),
            "increase" => {}
            "forall" => {
                let (condition, then) = match rest[1].parts() {
                    ("when", parts) => (&parts[0], &parts[1]),
                    other => panic!("{other:?}"),
                };
                self.solutions(&typed(rest[0].list()), &[condition], binding, &mut |inner| {
                    self.effects(then, inner, added, removed);
                    false
                });
            }
            _ => added.push(fact(effect)),
        }
    }

    /// Returns the only row of a predicate.
    fn only(&self, name: &str) -> &Row {
        let rows = &self.facts[name];
        assert_eq!(rows.len(), 1, "{name}");
        rows.first().unwrap()
    }
}

fn episodes(task: &Arc<SpfTask>, split: Split) -> EpisodeSet {
    EpisodeSet::load(task, split, &mut Sources::new(), &BuiltinFiles).unwrap()
}

/// Returns an environment after some steps that the rules drive, which judges actions.
fn begun(task: &Arc<SpfTask>, set: &EpisodeSet, episode: usize, steps: u32) -> Env {
    let mut env = Env::new(Arc::clone(task), set.split, ControlMode::First).unwrap();
    env.judge_actions();
    env.reset_to(&set.episodes[episode]).unwrap();
    for _ in 0..steps {
        let wanted = env.oracle_action(0);
        env.step(&[wanted]).unwrap();
    }
    env
}

fn encoded(task: &Arc<SpfTask>, set: &EpisodeSet, episode: usize, options: PddlOptions) -> PddlTask {
    encode(&mut begun(task, set, episode, 0), &options).unwrap_or_else(|fault| panic!("{fault:?}"))
}

/// The name of an action in PDDL.
fn deed(task: &SpfTask, action: Action) -> String {
    task.world().vocabulary.actions().name(action).to_lowercase()
}

/// Checks what the axioms say of the ego: the actions that violate a clause, and the one that the rules want.
fn check_ego(state: &State<'_>, env: &Env, wants: bool, context: &str) {
    let task = env.task();
    let car = &env.controlled_cars()[0];
    let ego = state.only("ego")[0].clone();
    for &action in task.possible_actions() {
        let violated = state.atom("violated", &[&deed(task, action)]);
        assert_eq!(
            violated,
            !car.allowed().unwrap().contains(action),
            "{context}: {action:?}"
        );
    }
    if wants {
        let wanted = |action: &&Action| state.atom(&format!("wants-{}", deed(task, **action)), &[&ego]);
        let order = task.world().scenario.actions.priority.iter();
        let first = order.into_iter().find(wanted).copied();
        assert_eq!(first.unwrap_or(Action::Normal), env.oracle_action(0), "{context}");
    }
}

/// The steps after which problems begin: the whole trip and where the rules constrain the ego.
fn starts(task: &Arc<SpfTask>, set: &EpisodeSet, episode: usize) -> Vec<u32> {
    let mut env = begun(task, set, episode, 0);
    let mut found = vec![0];
    while env.is_running() && found.len() < 3 {
        if !env.controlled_cars()[0].derived().is_empty() && found.last().is_none_or(|last| env.steps() > last + 8) {
            found.push(env.steps().saturating_sub(2));
        }
        let wanted = env.oracle_action(0);
        env.step(&[wanted]).unwrap();
    }
    found
}

/// The axioms and tables of one agent say at every tick of many ways what the environment says, and a plan that follows
/// such a way violates no clause and costs its return.
#[test]
fn one_agent_problems_state_what_the_city_does() {
    let mut constrained = 0;
    for mode in ["easy", "medium", "hard", "expert", "transfer-easy"] {
        let task = task(mode, None);
        let set = episodes(&task, Split::Test);
        for episode in [0, 3, 7] {
            for start in starts(&task, &set, episode) {
                let options = PddlOptions {
                    encoding: Encoding::OneAgent,
                    start,
                    horizon: Some(8),
                };
                let pddl = encoded(&task, &set, episode, options);
                let problem = Problem::new(&pddl);
                for seed in 0..4 {
                    let mut stream = Seed(seed).stream(Purpose::POLICY, u64::from(start), episode as u64);
                    let mut env = begun(&task, &set, episode, start);
                    let mut state = problem.start();
                    let mut plan = String::new();
                    loop {
                        let (tick, place) = (state.only("now")[0].clone(), state.only("at")[0].clone());
                        let context = format!("{mode} {episode} {start} {seed} {tick}");
                        let position = env.city().agents()[env.controlled_cars()[0].agent()].position();
                        assert_eq!(place, format!("p{position}"), "{context}");
                        let moves: Vec<Row> = (problem.init.get("moves").into_iter().flatten())
                            .filter(|row| row[1..3] == [tick.clone(), place.clone()])
                            .cloned()
                            .collect();
                        if moves.is_empty() {
                            break;
                        }
                        check_ego(&state, &env, true, &context);
                        constrained += usize::from(!env.controlled_cars()[0].derived().is_empty());
                        let next = format!("t{}", env.steps() + 1);
                        let apply = |row: &Row| {
                            let arguments = [tick.as_str(), &next, &place, &row[3]];
                            let name = format!("go-{}", row[0]);
                            state.after(&name, &arguments)?;
                            Some((name, arguments.map(str::to_owned)))
                        };
                        let possible: Vec<_> = moves.iter().filter_map(apply).collect();
                        // Every kept state has a way to the target.
                        let (name, arguments) = &possible[stream.random_range(0..possible.len())];
                        plan += &format!("({name} {})\n", arguments.join(" "));
                        let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
                        state = state.after(name, &arguments).unwrap();
                        let taken = task
                            .possible_actions()
                            .iter()
                            .find(|&&action| *name == format!("go-{}", deed(&task, action)));
                        env.step(&[*taken.unwrap()]).unwrap();
                    }
                    assert!(
                        state
                            .after("arrive", &[&state.only("now")[0], &state.only("at")[0]])
                            .is_some(),
                        "{plan}"
                    );
                    let mut sources = Sources::new();
                    let source = sources.add("plan", plan);
                    let mut env = begun(&task, &set, episode, 0);
                    let read = read_plan(&env, source, &sources).unwrap();
                    let done = replay(&mut env, start, &read).unwrap();
                    assert!(done.steps.iter().all(|(_, _, broken)| broken.is_empty()));
                    #[allow(clippy::cast_precision_loss)] // small numbers
                    let expected = -(done.cost as f64) / pddl.costs.per_return as f64;
                    assert!((done.total - expected).abs() < 1e-12, "{} {expected}", done.total);
                    assert!(done.cost >= pddl.cheapest.unwrap());
                }
            }
        }
    }
    assert!(constrained > 50, "{constrained} constrained steps");
}

/// In problems of several agents, the axioms decide for the others as the city does, whatever the ego does.
#[test]
fn multi_agent_problems_state_what_the_city_does() {
    let (mut decided, mut not_normal) = (0, 0);
    for mode in ["easy", "medium", "hard", "expert"] {
        let task = task(mode, None);
        let set = episodes(&task, Split::Test);
        for episode in [1, 4] {
            for start in starts(&task, &set, episode) {
                let options = PddlOptions {
                    encoding: Encoding::MultiAgent,
                    start,
                    horizon: Some(4),
                };
                let pddl = encoded(&task, &set, episode, options);
                let problem = Problem::new(&pddl);
                for seed in 0..2 {
                    let mut stream = Seed(seed).stream(Purpose::POLICY, u64::from(start), episode as u64);
                    let mut env = begun(&task, &set, episode, start);
                    let mut state = problem.start();
                    let goal = |agent: &Agent| [agent.goal().row, agent.goal().col];
                    let goals: Vec<[i32; 2]> = env.city().agents().iter().map(goal).collect();
                    while env.steps() < start + pddl.horizon && env.is_running() {
                        let context = format!("{mode} {episode} {start} {seed} {}", env.steps());
                        check_ego(&state, &env, false, &context);
                        let allowed = env.controlled_cars()[0].allowed().unwrap();
                        let allowed: Vec<Action> = allowed
                            .iter()
                            .filter(|action| task.possible_actions().contains(action))
                            .collect();
                        if allowed.is_empty() {
                            break;
                        }
                        let action = allowed[stream.random_range(0..allowed.len())];
                        let chosen = state.after(&format!("choose-{}", deed(&task, action)), &[]).unwrap();
                        let (now, next) = (format!("t{}", env.steps()), format!("t{}", env.steps() + 1));
                        env.step(&[action]).unwrap();
                        let moved = chosen.after("tick", &[&now, &next]).unwrap();
                        for (index, agent) in env.city().agents().iter().enumerate() {
                            let name = agent.name().to_string().to_lowercase().replace('_', "-");
                            let row = |facts: &BTreeMap<String, BTreeSet<Row>>| {
                                let rows: Vec<Row> = facts["at"].iter().filter(|row| row[0] == name).cloned().collect();
                                rows
                            };
                            let [place] = &row(&moved.facts)[..] else {
                                assert!(
                                    !problem.objects["agent"].contains(&name),
                                    "{context}: {name} is nowhere"
                                );
                                continue;
                            };
                            let done = env.city().report().agents[index];
                            let does: Vec<Action> = (task.world().vocabulary.actions().all())
                                .filter(|&action| chosen.atom("does", &[&name, &deed(&task, action)]))
                                .collect();
                            assert_eq!(does, [done.action], "{context}: {name}");
                            decided += 1;
                            not_normal += usize::from(done.action != Action::Normal);
                            let position = agent.position();
                            if goals[index] == goal(agent) {
                                let expected = [format!("p{position}"), format!("p{position}-rest")];
                                let known = expected.iter().any(|expected| place[1].starts_with(expected.as_str()));
                                assert!(known, "{context}: {name} at {} and {position}", place[1]);
                            } else {
                                assert!(place[1].starts_with(&format!("n{position}")), "{context}: {name}");
                            }
                        }
                        state = moved;
                    }
                }
            }
        }
    }
    assert!(
        decided > 500 && not_normal > 50,
        "{not_normal} of {decided} decisions are not Normal"
    );
}

/// Without axioms, the same actions are possible.
#[test]
fn strips_problems_permit_the_same_actions() {
    let task = task("expert", None);
    let set = episodes(&task, Split::Test);
    let options = |encoding| PddlOptions {
        encoding,
        start: 10,
        horizon: Some(10),
    };
    let with_axioms = encoded(&task, &set, 2, options(Encoding::OneAgent));
    let compiled = encoded(&task, &set, 2, options(Encoding::Strips));
    assert_eq!(with_axioms.cheapest, compiled.cheapest);
    for word in ["derived", "total-cost", "not (violated"] {
        assert!(
            with_axioms.domain.contains(word) && !compiled.domain.contains(word),
            "{word}"
        );
    }
    let (with_axioms, compiled) = (Problem::new(&with_axioms), Problem::new(&compiled));
    assert_eq!(with_axioms.init["moves"], compiled.init["moves"]);
    let (first, second) = (with_axioms.start(), compiled.start());
    let moves = with_axioms.init["moves"].iter().filter(|row| row[1] == "t10");
    for row in moves {
        let arguments = ["t10", "t11", row[2].as_str(), row[3].as_str()];
        let name = format!("go-{}", row[0]);
        assert_eq!(
            first.after(&name, &arguments).is_some(),
            second.after(&name, &arguments).is_some()
        );
    }
}

fn fault_of(rules: &str) -> Diagnostic {
    let (world, sources) = configured(
        "base: easy\n",
        &format!(".include \"vocabulary.dl\"\n{rules}\n"),
        |_| (),
    );
    let task = Arc::new(SpfTask::new(world, &sources).unwrap_or_else(|faults| panic!("{faults:?}")));
    let mut env = Env::new(task, Split::Test, ControlMode::First).unwrap();
    env.reset(1).unwrap();
    let options = PddlOptions {
        encoding: Encoding::OneAgent,
        start: 0,
        horizon: Some(2),
    };
    encode(&mut env, &options).unwrap_err()
}

/// What PDDL cannot say has one message, at the place of the clause.
#[test]
fn what_pddl_cannot_state_is_named() {
    for (rules, message) in [
        ("Stop(X) :- IsCar(X), 2 <= count : { IsOld(_) }.", "aggregates"),
        ("Stop(X) :- once[1,5] IsAtInter(X).", "temporal operators"),
        ("Stop(\"Car_1\") :- IsCar(\"Car_1\").", "constants"),
        (
            ".decl n(x: number)\nn(1).\nStop(X) :- IsCar(X), n(_).",
            "columns of numbers",
        ),
        ("Stop(X) :- IsCar(X), IsOld(Y), X < Y.", "comparisons of values"),
        ("0.5 :: Stop(X) :- IsCar(X).", "chance"),
    ] {
        let fault = fault_of(rules);
        assert_eq!(fault.code, codes::PDDL_UNSUPPORTED, "{rules}: {fault:?}");
        assert!(fault.message.contains(message), "{rules}: {}", fault.message);
        assert!(fault.primary.is_some() && !fault.help.is_empty(), "{rules}");
    }
}

/// Helper predicates, wildcards, repeated variables and actions of others have axioms, too.
#[test]
fn axioms_cover_helpers_and_actions_in_bodies() {
    let rules = "
        .include \"vocabulary.dl\"
        .decl Alone(x: agent)
        Alone(X) :- Sees(X, X), Not(NextTo(X, _)).
        .decl Rival(x: agent, y: agent)
        Rival(X, Y) :- NextTo(X, Y), IsCar(X), IsCar(Y), X != Y.
        .decl Yields(x: agent)
        Yields(X) :- Rival(X, Y), Stop(Y).
        Stop(X) :- IsAtInter(X), Rival(Y, X).
        Slow(X) :- Alone(X), Not(Stop(X)), Not(Yields(X)).
        Fast(X) :- Yields(X), Not(Stop(X)), CollidingClose(_, X).
    ";
    let task = task("expert", Some(rules));
    let set = episodes(&task, Split::Test);
    let mut kinds = BTreeSet::new();
    for episode in 0..4 {
        let options = PddlOptions {
            encoding: Encoding::MultiAgent,
            start: 4,
            horizon: Some(3),
        };
        let pddl = encoded(&task, &set, episode, options);
        let problem = Problem::new(&pddl);
        let mut env = begun(&task, &set, episode, 4);
        let mut state = problem.start();
        for tick in 4..7 {
            check_ego(&state, &env, false, &format!("{episode} {tick}"));
            let action = env.oracle_action(0);
            let Some(chosen) = state.after(&format!("choose-{}", deed(&task, action)), &[]) else {
                break;
            };
            env.step(&[action]).unwrap();
            for (agent, done) in env.city().agents().iter().zip(&env.city().report().agents) {
                let name = agent.name().to_string().to_lowercase().replace('_', "-");
                if problem.objects["agent"].contains(&name) {
                    assert!(
                        chosen.atom("does", &[&name, &deed(&task, done.action)]),
                        "{episode} {tick} {name} {done:?}"
                    );
                    kinds.insert(done.action);
                }
            }
            let moved = chosen.after("tick", &[&format!("t{tick}"), &format!("t{}", tick + 1)]);
            state = moved.unwrap();
        }
    }
    assert!(kinds.len() >= 3, "{kinds:?}");
}

/// A plan that does not fit is a fault at its line.
#[test]
fn plans_that_do_not_fit_are_faults() {
    let task = task("easy", None);
    let set = episodes(&task, Split::Test);
    let fault = |plan: &str| {
        let mut sources = Sources::new();
        let source = sources.add("plan", plan);
        let mut env = begun(&task, &set, 0, 0);
        let read = read_plan(&env, source, &sources);
        let fault = read.and_then(|plan| replay(&mut env, 0, &plan)).unwrap_err();
        assert_eq!(fault.code, codes::INVALID_PLAN);
        let line = fault
            .primary
            .as_ref()
            .map_or(0, |label| sources.position(label.span).line);
        (line, fault.message)
    };
    for (plan, line, message) in [
        ("; nothing\n", 0, "no action of the ego"),
        ("(fly)\n", 1, "`(fly)` is no action of the domain"),
        ("(go-slow t0 t1 a b)\n", 1, "names no ticks and places"),
        (
            "; first\n(go-stop t0 t1 p0 p0)\n(go-stop t1 t2 p4 p4)\n",
            3,
            "but the city moves it from p0 to p0 at t1",
        ),
        ("(go-stop t1 t2 p0 p0)\n", 1, "at t1, but the city"),
    ] {
        let (found, said) = fault(plan);
        assert!(found == line && said.contains(message), "{plan}: {found} {said}");
    }
    let long = "(choose-stop)\n".repeat(2000);
    assert!(fault(&long).1.contains("before the plan"));
}

/// The planner breaks no rule where the oracle breaks none, and its returns are at least the oracle's on average.
#[test]
fn the_planner_is_at_least_as_good_as_the_oracle() {
    for mode in ["easy", "expert"] {
        let task = task(mode, None);
        let set = episodes(&task, Split::Val);
        let (mut planned, mut oracle) = (0.0, 0.0);
        for episode in &set.episodes[..4] {
            let mut env = Env::new(Arc::clone(&task), Split::Val, ControlMode::First).unwrap();
            env.reset_to(episode).unwrap();
            let mut planner = Planner::new(SearchBounds {
                horizon: 6,
                expansions: 200,
            });
            while env.is_running() {
                let found = planner.plan(&env).unwrap();
                assert!(found.expanded <= 200 && found.depth <= 6);
                // A search again gives the same.
                assert_eq!(Planner::new(planner.bounds()).plan(&env).unwrap().action, found.action);
                env.step(&[found.action]).unwrap();
                planned += env.controlled_cars()[0].last().reward;
            }
            assert!(env.controlled_cars()[0].last().success, "{mode}");
            env.reset_to(episode).unwrap();
            oracle += rollout(&mut env, Policy::Oracle).unwrap().total;
        }
        assert!(planned >= oracle - 1e-9, "{mode}: {planned} {oracle}");
    }
}
