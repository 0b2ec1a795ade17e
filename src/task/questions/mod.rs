//! Language questions: given entities and the facts about them, what does this car do next?
//!
//! [`QuestionSet::draw`] simulates cities and samples decisions of cars; `wording` formats them as text. A question
//! does not state the rules, unless its [`Prompt`] does. Its reader must infer them from demonstrations, which come from
//! another agent set than the questions.
// Decision: docs/decisions/tasks.md#d050

mod mix;
#[cfg(feature = "render")]
mod pictures;
mod shard;
mod statement;
mod wording;
mod words;

pub use mix::Mix;
pub use shard::{QUESTION_SHARDS, QuestionShard, RequestRecord};
pub use wording::{RulesFile, letter};

use crate::city::{Action, AgentKind, AgentName, AgentSet, Split};
use crate::datalog::ClauseId;
use crate::datalog::explain::Explainer;
use crate::diag::{self, Diagnostic, did_you_mean, listed};
use crate::predicate::Definition;
use crate::rng::{Purpose, RngExt, Seed};
use crate::sim::{Facts, GroundState, MAX_ENTITIES, Settings, Simulation, World};
use crate::task::questions::mix::{Category, paper_shares, shares};
use crate::yaml::codes;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

impl Purpose {
    /// Language questions: worlds, sampled decisions, and the order of entities.
    pub const QUESTION: Purpose = Purpose::new(12);
}

/// Ticks per world.
const TICKS: u64 = 100;

/// Ticks without questions at the start of a world, because agents have no heading at first.
const WARM_UP: u64 = 11;

/// The maximum number of questions with one answer per world, because nearby ticks are similar.
const PER_WORLD: usize = 4;

/// A search ends after this many worlds plus one per question.
const WORLDS: usize = 200;

/// A set with [`Mix::ByConcept`] has no question about cars with some concepts and an answer that these cars do not
/// give in this many worlds, because the rules seem to exclude it.
const CATEGORY_WORLDS: usize = 50;

/// The maximum number of questions of a set.
pub const QUESTIONS_MAX: u32 = 20_000;

/// The maximum number of demonstrations of a set.
pub const SHOTS_MAX: u32 = 100;

/// The parameters of a set of questions.
#[derive(Clone, Debug)]
pub struct Request {
    /// Number of questions.
    pub count: usize,
    /// Number of demonstrations: 0, or at least one per action that the rules can derive.
    pub shots: usize,
    /// Agent set of the questions.
    pub split: Split,
    /// Agent set of the demonstrations.
    pub demonstrations: Split,
    /// The entities that a question names.
    pub entities: Extent,
    /// The form of the facts in the source.
    pub style: Style,
    /// What the instructions state and request.
    pub prompt: Prompt,
    /// How often each answer is correct.
    pub mix: Mix,
    /// Restricts questions to cars with one of these concepts, unless empty.
    pub about: Vec<String>,
    /// Seed of the set.
    pub seed: u64,
}

/// The entities that a question names.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Extent {
    /// The car and the entities that it sees.
    View,
    /// All entities of the city, as in the paper.
    City,
}

impl Extent {
    /// Both values.
    pub const ALL: [Extent; 2] = [Extent::View, Extent::City];

    /// Returns the name: `view` or `city`.
    pub const fn name(self) -> &'static str {
        match self {
            Extent::View => "view",
            Extent::City => "city",
        }
    }
}

/// The form of the facts in the source of a question.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Style {
    /// A list of atoms.
    Atoms,
    /// English sentences about each agent.
    Words,
    /// The wording and the layout of the paper's prompt.
    Paper,
    /// A picture of the scene, and a list of the atoms that it does not determine.
    Picture,
}

impl Style {
    /// All values.
    pub const ALL: [Style; 4] = [Style::Atoms, Style::Words, Style::Paper, Style::Picture];

    /// Returns the name: `atoms`, `words`, `paper` or `picture`.
    pub const fn name(self) -> &'static str {
        match self {
            Style::Atoms => "atoms",
            Style::Words => "words",
            Style::Paper => "paper",
            Style::Picture => "picture",
        }
    }
}

/// What the instructions of a question state and request. It does not affect which questions a set has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Prompt {
    /// Only the demonstrations show what the rules are, as in the paper.
    Examples,
    /// The instructions state the rules.
    Rules,
    /// The instructions state the rules, and request the rule that requires the action.
    Why,
}

impl Prompt {
    /// All values.
    pub const ALL: [Prompt; 3] = [Prompt::Examples, Prompt::Rules, Prompt::Why];

    /// Returns the name: `examples`, `rules` or `why`.
    pub const fn name(self) -> &'static str {
        match self {
            Prompt::Examples => "examples",
            Prompt::Rules => "rules",
            Prompt::Why => "why",
        }
    }
}

/// Questions, and the demonstrations that precede each of them.
#[derive(Clone, Debug)]
pub struct QuestionSet {
    /// The parameters of the set.
    pub request: Request,
    /// Demonstrations: solved examples.
    pub demonstrations: Vec<Question>,
    /// The questions.
    pub questions: Vec<Question>,
    /// Names and definitions of the predicates, `Sees` last.
    predicates: Vec<(String, Definition)>,
    /// Number of worlds that the search simulated for the questions.
    pub worlds: usize,
}

/// A decision of a car. Entities are numbers in random order.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Question {
    /// Number of entities.
    pub entities: usize,
    /// The entity that decides.
    pub ego: usize,
    /// The position of each entity among the agents of the city.
    pub agents: Vec<usize>,
    /// All true facts about the entities.
    pub facts: Facts,
    /// The action that the rules want.
    pub answer: Action,
    /// The clauses that derive the action for the ego, in source order; none if it is the default without a clause.
    pub clauses: Vec<ClauseId>,
    /// The origin of the question.
    pub source: Source,
}

/// The origin of a question.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Source {
    /// The agent set of the city.
    pub split: Split,
    /// The seed of the city.
    pub world: u64,
    /// The tick in which the car decided.
    pub tick: u64,
    /// The car.
    pub agent: AgentName,
}

impl QuestionSet {
    /// Draws a set in which all questions differ. No question has the same entities by type and concepts as a
    /// demonstration. Calls `watch` with the number of questions so far.
    ///
    /// # Errors
    /// `invalid-value` for an unknown concept, too few demonstrations for the actions, equal agents in questions and
    /// demonstrations, the paper's mix for rules that never derive one of its answers, or the paper's style without
    /// demonstrations or with another prompt. `limit-exceeded` if the search finds too few questions, or no
    /// demonstration of an answer. Those of [`Simulation::new`].
    pub fn draw(
        world: &Arc<World>,
        request: Request,
        mut watch: impl FnMut(usize),
    ) -> Result<QuestionSet, Vec<Diagnostic>> {
        QuestionSet::join(world, request, &[], &mut watch).map(|(set, _)| set)
    }

    /// Joins all shards, in order, to the set of [`draw`](QuestionSet::draw). Searches the worlds that no shard has.
    /// Also returns their number.
    ///
    /// # Errors
    /// As for [`draw`](QuestionSet::draw).
    pub fn join(
        world: &Arc<World>,
        request: Request,
        shards: &[QuestionShard],
        mut watch: impl FnMut(usize),
    ) -> Result<(QuestionSet, u64), Vec<Diagnostic>> {
        check(world, &request)?;
        let mut known = Known::default();
        let mut demonstrations = demonstrations(world, &request, &mut known).map_err(|fault| vec![fault])?;
        let mut search = QuestionSearch::new(world, &request, request.split, (request.count, request.mix));
        let mut questions = search
            .run(&request.about, &mut known, shards, &mut watch)
            .map_err(|fault| vec![fault])?;
        let lacking = |action: &Action| {
            let answers = |questions: &[Question]| questions.iter().any(|question| question.answer == *action);
            answers(&questions) && !answers(&demonstrations)
        };
        if let (true, Some(action)) = (request.shots > 0, Action::STANDARD.into_iter().find(lacking)) {
            let (name, split) = (action.name(), request.demonstrations.name());
            let message = format!("no demonstration of {name} found among the cars of `{split}`");
            return Err(vec![
                Diagnostic::new(diag::codes::LIMIT_EXCEEDED, message)
                    .help("use another split for the demonstrations, or none"),
            ]);
        }
        for question in demonstrations.iter_mut().chain(&mut questions) {
            question.clauses = deriving(world, question).map_err(|fault| vec![fault])?;
        }
        let predicates = &world.vocabulary.predicates;
        let set = QuestionSet {
            demonstrations,
            questions,
            predicates: (predicates.iter())
                .map(|predicate| (predicate.name.clone(), predicate.definition.clone()))
                .collect(),
            worlds: search.worlds,
            request,
        };
        Ok((set, search.added))
    }

    /// Returns the number of questions with each answer, in the order of [`Action::STANDARD`].
    pub fn answers(&self) -> [usize; 4] {
        Action::STANDARD.map(|action| {
            let answers = self.questions.iter().filter(|question| question.answer == action);
            answers.count()
        })
    }

    /// Returns how many questions the best guesses get right: the same answer to every question, and an answer that
    /// depends only on type and concepts of the car.
    pub fn best_guesses(&self) -> [usize; 2] {
        let mut by_concepts: BTreeMap<Vec<usize>, [usize; 4]> = BTreeMap::new();
        for question in &self.questions {
            let rows = self.predicates.iter().zip(&question.facts.rows).enumerate();
            let carried = rows.filter(|(_, ((_, definition), rows))| {
                definition.is_static() && rows.iter().any(|row| row[0] as usize == question.ego)
            });
            let answers = by_concepts
                .entry(carried.map(|(index, _)| index).collect())
                .or_default();
            answers[question.answer.index()] += 1;
        }
        let most = |answers: [usize; 4]| answers.into_iter().max().unwrap_or(0);
        [most(self.answers()), by_concepts.into_values().map(most).sum()]
    }
}

/// Returns the actions that the rules can derive, in the order of [`Action::STANDARD`].
pub fn askable(world: &World) -> Vec<Action> {
    let clauses = &world.program.rules().clauses;
    let asked = |action: &Action| {
        let predicate = world.vocabulary.action(*action);
        let derived =
            predicate.is_some_and(|predicate| clauses.iter().any(|clause| clause.head.predicate == predicate));
        derived || *action == world.vocabulary.default_action()
    };
    Action::STANDARD.into_iter().filter(asked).collect()
}

/// Returns the clauses that derive the answer from the facts of a question, in source order.
fn deriving(world: &World, question: &Question) -> Result<Vec<ClauseId>, Diagnostic> {
    let Some(predicate) = world.vocabulary.action(question.answer) else {
        return Ok(Vec::new());
    };
    let names: Vec<String> = (0..question.entities).map(wording::entity).collect();
    let mut state = GroundState::new(
        &world.program,
        &world.vocabulary,
        world.limits,
        names.iter().map(String::as_str),
    );
    (state.set(&question.facts)).map_err(|error| error.diagnostic(world.program.rules()))?;
    let found = Explainer::new(state.session()).derivations(predicate, &[state.value(question.ego)]);
    let found = found.map_err(Diagnostic::from)?;
    let mut clauses: Vec<ClauseId> = found.into_iter().map(|(clause, _)| clause).collect();
    clauses.dedup();
    Ok(clauses)
}

/// Checks a request for contradictions.
fn check(world: &World, request: &Request) -> Result<(), Vec<Diagnostic>> {
    (world.only_standard("questions")).map_err(|fault| vec![fault])?;
    let scenario = &world.scenario;
    let concepts: Vec<&str> = (scenario.predicates.iter())
        .filter_map(|predicate| predicate.definition.concept())
        .filter(|concept| concept.of == AgentKind::Car)
        .map(|concept| concept.concept.as_str())
        .collect();
    let unknown = request
        .about
        .iter()
        .filter(|concept| !concepts.contains(&concept.as_str()));
    let mut faults: Vec<Diagnostic> = unknown
        .map(|concept| {
            let message = format!("`{}` has no car concept `{concept}`", scenario.name);
            let fault = Diagnostic::new(codes::INVALID_VALUE, message);
            match did_you_mean(concept, concepts.iter().copied()) {
                Some(name) => fault.help(format!("did you mean `{name}`?")),
                None => fault.help(format!("its car concepts are: {}", listed(&concepts))),
            }
        })
        .collect();
    let actions: Vec<&str> = askable(world).into_iter().map(Action::name).collect();
    if request.shots > 0 && request.shots < actions.len() {
        let message = format!(
            "{} solved examples cannot cover all actions of the rules: {}",
            request.shots,
            actions.join(", ")
        );
        faults.push(
            Diagnostic::new(codes::INVALID_VALUE, message).help("use 0 (`--shots 0`), or at least one per action"),
        );
    }
    let lacking: Vec<&str> = (Action::STANDARD.into_iter().map(Action::name))
        .filter(|action| !actions.contains(action))
        .collect();
    if request.mix == Mix::Paper && !lacking.is_empty() {
        let (name, lacking) = (&scenario.name, lacking.join(" or "));
        let message =
            format!("the rules of `{name}` never require {lacking}, but the paper's mix has all four answers");
        faults.push(Diagnostic::new(codes::INVALID_VALUE, message).help("use another mix: `--mix equal`"));
    }
    if request.style == Style::Paper && (request.shots == 0 || request.prompt != Prompt::Examples) {
        let message = "the paper's prompt has solved examples and does not state the rules";
        let help = "use another style, or `--prompt examples` with at least one example per action";
        faults.push(Diagnostic::new(codes::INVALID_VALUE, message).help(help));
    }
    let agents = |split: Split| {
        let set = scenario.agent_set(split)?;
        let mut agents: Vec<_> = set.agents().map(|agent| (agent.name.kind, agent.concepts)).collect();
        agents.sort_unstable();
        Some(agents)
    };
    let [asked, shown] = [request.split, request.demonstrations].map(agents);
    if request.shots > 0 && asked.is_some() && asked == shown {
        let [asked, shown] = [request.split, request.demonstrations].map(Split::name);
        let message = format!("questions about `{asked}` and demonstrations about `{shown}` have the same agents");
        faults.push(Diagnostic::new(codes::INVALID_VALUE, message).help("use another split for the demonstrations"));
    }
    match faults.is_empty() {
        true => Ok(()),
        false => Err(faults),
    }
}

/// Draws the demonstrations of a set, and notes them.
fn demonstrations(world: &Arc<World>, request: &Request, known: &mut Known) -> Result<Vec<Question>, Diagnostic> {
    let mut search = QuestionSearch::new(world, request, request.demonstrations, (request.shots, Mix::Equal));
    let demonstrations = match request.shots {
        0 => Vec::new(),
        _ => search.run(&[], known, &[], |_| ())?,
    };
    known.compositions = (demonstrations.iter())
        .map(|question| composition(world, question))
        .collect();
    Ok(demonstrations)
}

/// Excludes duplicates.
#[derive(Default)]
struct Known {
    /// Questions, up to the order of their entities.
    questions: BTreeSet<Vec<Vec<[u32; 2]>>>,
    /// The types and concepts of all entities of each demonstration.
    compositions: BTreeSet<Vec<Vec<usize>>>,
}

/// A search for questions about the cars of a split.
struct QuestionSearch<'w> {
    world: &'w Arc<World>,
    split: Split,
    extent: Extent,
    seed: Seed,
    count: usize,
    mix: Mix,
    /// The number of worlds from which a mix by concept counts its categories.
    category_worlds: usize,
    found: BTreeMap<Category, Vec<Question>>,
    worlds: usize,
    /// The number of worlds that no shard has.
    added: u64,
}

impl Known {
    /// Returns the questions that are new, and notes them.
    fn fresh(&mut self, world: &World, mut found: Vec<(Category, Question)>) -> Vec<(Category, Question)> {
        found.retain(|(_, question)| {
            !self.compositions.contains(&composition(world, question))
                && self.questions.insert(unordered(world, question))
        });
        found
    }
}

impl<'w> QuestionSearch<'w> {
    fn new(world: &'w Arc<World>, request: &Request, split: Split, (count, mix): (usize, Mix)) -> QuestionSearch<'w> {
        QuestionSearch {
            world,
            split,
            extent: request.entities,
            seed: Seed(request.seed),
            count,
            mix,
            category_worlds: CATEGORY_WORLDS,
            found: BTreeMap::new(),
            worlds: 0,
            added: 0,
        }
    }

    /// Creates the city whose worlds the search looks at.
    fn city(&self) -> Result<Simulation, Diagnostic> {
        let agents = self.world.scenario.agent_set(self.split).map_or(0, AgentSet::len);
        if agents > MAX_ENTITIES {
            let message = format!("{agents} agents are too many; the limit is {MAX_ENTITIES}");
            return Err(Diagnostic::new(diag::codes::LIMIT_EXCEEDED, message));
        }
        Simulation::new(Arc::clone(self.world), self.split, self.seed, Settings::default())
    }

    /// Adds questions that are new.
    fn add(&mut self, found: Vec<(Category, Question)>) {
        for (category, question) in found {
            self.found.entry(category).or_default().push(question);
        }
        self.worlds += 1;
    }

    /// Finds the questions and returns them in an order independent of their answers. Takes those of worlds that a
    /// shard has from there.
    fn run(
        &mut self,
        about: &[String],
        known: &mut Known,
        shards: &[QuestionShard],
        mut watch: impl FnMut(usize),
    ) -> Result<Vec<Question>, Diagnostic> {
        let mut city = self.city()?;
        let mut wanted = BTreeMap::new();
        while self.worlds < WORLDS + self.count {
            // Later worlds can only add categories to a mix by concept.
            if self.worlds == 0 || self.mix == Mix::ByConcept && wanted.len() < self.found.len() {
                wanted = self.wanted();
            }
            let sure = (wanted.iter())
                .map(|(category, &share)| self.available(category).min(share))
                .sum();
            watch(sure);
            if sure == self.count {
                break;
            }
            let number = self.worlds as u64;
            let found = match QuestionShard::found(shards, number) {
                Some(found) => found,
                None => {
                    self.added += 1;
                    self.look(&mut city, about, number)?
                }
            };
            self.add(known.fresh(self.world, found));
        }
        self.choose()
    }

    /// Returns the number of questions that were found in a category.
    fn available(&self, category: &Category) -> usize {
        self.found.get(category).map_or(0, Vec::len)
    }

    /// Returns the number of questions of each category in the set, if enough can be found. Empty as long as the
    /// categories are unknown.
    fn wanted(&self) -> BTreeMap<Category, usize> {
        let unlimited = |action: Action| ((Vec::new(), action), usize::MAX);
        match self.mix {
            Mix::Equal => shares(self.count, &askable(self.world).into_iter().map(unlimited).collect()),
            Mix::Paper => {
                let shares = Action::STANDARD.into_iter().zip(paper_shares(self.count));
                shares.map(|(action, share)| ((Vec::new(), action), share)).collect()
            }
            Mix::ByConcept if self.worlds < self.category_worlds => BTreeMap::new(),
            Mix::ByConcept => {
                let found = self.found.keys().map(|category| (category.clone(), usize::MAX));
                shares(self.count, &found.collect())
            }
        }
    }

    /// Samples questions from the world with a number.
    fn look(
        &self,
        city: &mut Simulation,
        about: &[String],
        number: u64,
    ) -> Result<Vec<(Category, Question)>, Diagnostic> {
        let mut stream = self.seed.stream(Purpose::QUESTION, number, self.split as u64);
        let seed: u64 = stream.random();
        city.restart_drawn(Seed(seed), |_| ())?;
        let carries = |concepts: &[String]| about.is_empty() || concepts.iter().any(|concept| about.contains(concept));
        // For each category, the decisions with the lowest random keys.
        let mut drawn: BTreeMap<Category, Vec<(u64, Question)>> = BTreeMap::new();
        for tick in 0..TICKS {
            city.tick(&[])?;
            if tick < WARM_UP {
                continue;
            }
            let mut facts = None;
            for (ego, agent) in city.agents().iter().enumerate() {
                if agent.kind != AgentKind::Car || !carries(&agent.concepts) {
                    continue;
                }
                let (lot, order): (u64, u64) = (stream.random(), stream.random());
                let answer = city.report().agents[ego].action;
                let mut concepts = Vec::new();
                if self.mix == Mix::ByConcept {
                    concepts.extend_from_slice(&agent.concepts);
                    concepts.sort_unstable();
                }
                let best = drawn.entry((concepts, answer)).or_default();
                let place = best.partition_point(|(other, _)| *other < lot);
                if place < PER_WORLD {
                    let facts = match &mut facts {
                        Some(facts) => facts,
                        none => none.insert(city.facts(|_| true)?),
                    };
                    let source = Source {
                        split: self.split,
                        world: seed,
                        tick,
                        agent: agent.name(),
                    };
                    best.insert(place, (lot, self.question(facts, ego, Seed(order), answer, source)));
                    best.truncate(PER_WORLD);
                }
            }
        }
        let listed = |(category, drawn): (Category, Vec<(u64, Question)>)| {
            drawn.into_iter().map(move |(_, question)| (category.clone(), question))
        };
        Ok(drawn.into_iter().flat_map(listed).collect())
    }

    /// Returns a decision as a question with its entities in random order.
    fn question(&self, facts: &Facts, ego: usize, order: Seed, answer: Action, source: Source) -> Question {
        let vocabulary = &self.world.vocabulary;
        let sees = &facts.rows[vocabulary.sees];
        let mut named: Vec<u32> = match self.extent {
            Extent::View => sees
                .iter()
                .filter(|[x, _]| *x as usize == ego)
                .map(|[_, y]| *y)
                .collect(),
            // Every agent sees itself.
            Extent::City => sees.iter().filter(|[x, y]| x == y).map(|[x, _]| *x).collect(),
        };
        named.sort_by_cached_key(|&agent| -> u64 { order.stream(Purpose::QUESTION, agent.into(), 0).random() });
        let place = |agent: u32| {
            let place = named.iter().position(|&named| named == agent)?;
            Some(u32::try_from(place).expect("fewer than 2^32 entities"))
        };
        let rows = facts.rows.iter().zip(&vocabulary.predicates).map(|(rows, predicate)| {
            let renamed = |&[x, y]: &[u32; 2]| match predicate.arity {
                1 => Some([place(x)?, 0]),
                _ => Some([place(x)?, place(y)?]),
            };
            let mut rows: Vec<[u32; 2]> = rows.iter().filter_map(renamed).collect();
            rows.sort_unstable();
            rows
        });
        let facts = Facts::of(rows.collect());
        let agent = u32::try_from(ego).expect("fewer than 2^32 agents");
        Question {
            ego: place(agent).expect("every agent sees itself") as usize,
            entities: named.len(),
            agents: named.iter().map(|&agent| agent as usize).collect(),
            facts,
            answer,
            clauses: Vec::new(),
            source,
        }
    }

    /// Returns the requested number of questions, in the requested mix as far as possible.
    fn choose(&mut self) -> Result<Vec<Question>, Diagnostic> {
        let shares = match self.mix {
            Mix::Equal | Mix::ByConcept => {
                let found = (self.found.iter()).map(|(category, found)| (category.clone(), found.len()));
                shares(self.count, &found.collect())
            }
            Mix::Paper => self.wanted(),
        };
        let found: usize = (shares.iter())
            .map(|(category, &share)| self.available(category).min(share))
            .sum();
        if found < self.count {
            let (count, worlds, split) = (self.count, self.worlds, self.split.name());
            let message = format!("found only {found} of {count} different questions in {worlds} worlds of `{split}`");
            return Err(Diagnostic::new(diag::codes::LIMIT_EXCEEDED, message)
                .help("request fewer questions, use another agent set, or name all entities of the city"));
        }
        let taken = self.found.iter_mut().flat_map(|(category, found)| {
            let share = shares.get(category).copied().unwrap_or(0);
            found.drain(..share)
        });
        let mut questions: Vec<Question> = taken.collect();
        questions.sort_by_cached_key(|question| {
            let Source { world, tick, agent, .. } = question.source;
            let lot: u64 = Seed(world)
                .stream(Purpose::QUESTION, agent.number.into(), 1 + tick)
                .random();
            lot
        });
        Ok(questions)
    }
}

/// Returns for every entity the predicates of its type and concepts, in a canonical order.
fn composition(world: &World, question: &Question) -> Vec<Vec<usize>> {
    let mut entities = vec![Vec::new(); question.entities];
    let predicates = world.vocabulary.predicates.iter().zip(&question.facts.rows);
    for (index, (predicate, rows)) in predicates.enumerate() {
        if predicate.definition.is_static() {
            rows.iter().for_each(|[x, _]| entities[*x as usize].push(index));
        }
    }
    entities.sort_unstable();
    entities
}

/// Returns the facts with entities in a canonical order, the ego first. Questions that differ only in the order of
/// entities have equal results, except for a few highly symmetric ones. Method: color refinement (1-dimensional
/// Weisfeiler-Leman).
fn unordered(world: &World, question: &Question) -> Vec<Vec<[u32; 2]>> {
    let predicates = || question.facts.rows.iter().zip(&world.vocabulary.predicates).enumerate();
    let mut classes: Vec<usize> = (0..question.entities)
        .map(|entity| usize::from(entity != question.ego))
        .collect();
    let mut count = 0;
    loop {
        // Each entity's facts by the classes of the other entities. The old class comes first, so that a step only
        // splits classes.
        let mut signatures: Vec<Vec<[usize; 2]>> = classes.iter().map(|&class| vec![[class, 0]]).collect();
        for (index, (rows, predicate)) in predicates() {
            for [x, y] in rows.iter().map(|row| row.map(|entity| entity as usize)) {
                match predicate.arity {
                    1 => signatures[x].push([2 * index, 0]),
                    _ => {
                        signatures[x].push([2 * index, classes[y]]);
                        signatures[y].push([2 * index + 1, classes[x]]);
                    }
                }
            }
        }
        signatures
            .iter_mut()
            .for_each(|signature| signature[1..].sort_unstable());
        let kinds: BTreeSet<&Vec<[usize; 2]>> = signatures.iter().collect();
        if kinds.len() == count {
            break;
        }
        count = kinds.len();
        let kinds: Vec<_> = kinds.into_iter().collect();
        let class = |signature| kinds.binary_search(&signature).expect("it is one of them");
        classes = signatures.iter().map(class).collect();
    }
    let mut order: Vec<usize> = (0..question.entities).collect();
    order.sort_by_key(|&entity| classes[entity]);
    let mut place = vec![0; question.entities];
    for (number, &entity) in order.iter().enumerate() {
        place[entity] = u32::try_from(number).expect("fewer than 2^32 entities");
    }
    let renamed = predicates().map(|(_, (rows, predicate))| {
        let rename = |&[x, y]: &[u32; 2]| match predicate.arity {
            1 => [place[x as usize], 0],
            _ => [place[x as usize], place[y as usize]],
        };
        let mut rows: Vec<[u32; 2]> = rows.iter().map(rename).collect();
        rows.sort_unstable();
        rows
    });
    renamed.collect()
}
