//! Inference: the decisions of the rules in one scene.

use crate::cancel::Cancel;
use crate::city::{Action, CityMap};
use crate::config::{Scenario, load_map, load_scenario};
use crate::datalog::Marginals;
use crate::datalog::dense::{BinaryFacts, BitFacts, BitState, Set, TooManySteps, TrackFirings, has};
use crate::datalog::explain::Explainer;
use crate::datalog::{self, EvalError, Limits, PredicateId, Program, Session, constraints};
use crate::diag::{self, Diagnostic, SourceId, Sources, Span, did_you_mean};
use crate::files::ReadFile;
use crate::predicate::Entity;
use crate::rng::Seed;
use crate::sim::codes;
use crate::sim::scene::answer::{Answer, SceneFacts};
use crate::sim::scene::format::{GeometricScene, GivenPredicate, MapName, Scene, SymbolicScene, Terms, parse_scenes};
use crate::sim::tick::asked::AskedFact;
use crate::sim::tick::chance::Draws;
use crate::sim::tick::executor::{Choice, DenseRules, Executor, compile, given_up, of_rules};
use crate::sim::tick::ground::{Facts, MAX_ENTITIES, PastRows, ground_with};
use crate::sim::tick::ground_state::GroundState;
use crate::sim::tick::memory::{Memory, Watched};
use crate::sim::tick::vocabulary::{Actions, Vocabulary};
use crate::sim::tick::width::{Width, in_words};
use crate::sim::tick::world::TICK_LIMITS;
use std::borrow::Cow;
use std::cell::Cell;
use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;

/// Reads the files that scenes name.
type Reader = dyn ReadFile + Send + Sync;

/// Evaluates scenes with one scenario and one program. It caches maps by name.
pub struct Inference {
    pub(super) scenario: Scenario,
    pub(super) program: Program,
    pub(super) vocabulary: Arc<Vocabulary>,
    read: Box<Reader>,
    maps: HashMap<MapName, Arc<CityMap>>,
    seed: Seed,
    executor: Executor,
    check_constraints: bool,
    /// The limits of each evaluation by the relational executor.
    pub(super) limits: Limits,
    /// The sources of the rules, for messages; see [`Inference::name_clauses`].
    rule_sources: Option<Sources>,
    /// The working memory of [`Inference::marginals`].
    pub(super) marginals: Option<Marginals>,
    /// The rules for the dense executor; `None` if a session decides.
    dense: Option<DenseRules>,
}

/// The explanations of a fact, as JSON, or why there are none.
pub type Explained = Result<Vec<serde_json::Value>, Vec<Diagnostic>>;

impl Inference {
    /// Binds a scenario to a program. `read` reads the maps and configurations that scenes name; built-in ones
    /// need no file.
    ///
    /// # Errors
    /// As [`Vocabulary::bind`]; `dense-unsupported` if `executor` demands the dense one and it cannot evaluate the
    /// rules.
    pub fn new(
        scenario: Scenario,
        program: Program,
        seed: Seed,
        executor: Executor,
        read: impl ReadFile + Send + Sync + 'static,
    ) -> Result<Self, Vec<Diagnostic>> {
        let vocabulary = Vocabulary::bind(&scenario, &program)?;
        let chosen = executor.choose(|| compile(program.rules(), &vocabulary, TrackFirings::Off));
        Ok(Inference {
            dense: match chosen.map_err(|fault| vec![of_rules(fault, scenario.rules.span)])? {
                Choice::Dense(dense) => Some(dense),
                Choice::Relational(_) => None,
            },
            vocabulary: Arc::new(vocabulary),
            scenario,
            program,
            read: Box::new(read),
            maps: HashMap::new(),
            seed,
            executor,
            check_constraints: false,
            limits: TICK_LIMITS,
            rule_sources: None,
            marginals: None,
        })
    }

    /// Returns the base predicates and actions.
    pub fn vocabulary(&self) -> &Vocabulary {
        &self.vocabulary
    }

    /// Compiles the rules for the dense executor.
    ///
    /// # Errors
    /// `dense-unsupported` if it cannot evaluate them; the message names the reason.
    pub fn compile(&self) -> Result<DenseRules, Diagnostic> {
        compile(self.program.rules(), &self.vocabulary, TrackFirings::Off)
            .map_err(|fault| of_rules(fault, self.scenario.rules.span))
    }

    /// Returns the rows over entities of predicates in the scene in `source`, as names of entities: of base predicates
    /// that the rules declare, and of derived ones. Rows with other values are left out.
    ///
    /// # Errors
    /// As [`Inference::answer_with`]; `rule-mismatch` for a predicate that the rules do not declare.
    pub fn rows(
        &mut self,
        (sources, source): (&Sources, SourceId),
        predicates: &[String],
        cancel: &Cancel,
    ) -> Result<Vec<Vec<Vec<String>>>, Vec<Diagnostic>> {
        let scene = self.ground_with(sources, source, cancel)?;
        let whole = Span::new(source, 0..sources.text(source).len());
        let state = (self.evaluated(&scene, cancel)).map_err(|fault| vec![fault.at(whole, "in this scene")])?;
        let rows = |name: &String| {
            let declared = self.program.predicate(name).ok_or_else(|| {
                let message = format!("the rules do not declare the predicate `{name}`");
                vec![Diagnostic::new(datalog::codes::RULE_MISMATCH, message)]
            })?;
            let entity = |word: &datalog::Value| Some(scene.names[state.entity(*word)?].clone());
            let rows = state.session().encoded_rows(declared);
            let mut rows: Vec<Vec<String>> = rows.filter_map(|row| row.iter().map(entity).collect()).collect();
            rows.sort_unstable();
            Ok(rows)
        };
        predicates.iter().map(rows).collect()
    }

    /// Returns the predicates of the rules whose columns are agents: the name, the number of columns, and whether clauses
    /// derive rows. `Sees`, actions, inline predicates, and inputs that the configuration does not define are left out.
    pub fn agent_predicates(&self) -> Vec<(String, usize, bool)> {
        let rules = self.program.rules();
        let base = &self.vocabulary.predicates;
        let sees = &base[self.vocabulary.sees];
        let Some(agents) = sees.id.map(|sees| rules.predicates[sees.index()].columns[0].ty) else {
            return Vec::new();
        };
        let actions: Vec<&str> = self.vocabulary.actions().names().collect();
        let is_word = |name: &str| name != sees.name && !actions.contains(&name);
        let has_rows = |known: &datalog::Predicate| known.derived || base.iter().any(|base| base.name == known.name);
        (rules.predicates.iter())
            .filter(|known| !known.hidden && !known.inline && !known.columns.is_empty())
            .filter(|known| is_word(&known.name) && has_rows(known))
            .filter(|known| known.columns.iter().all(|column| column.ty == agents))
            .map(|known| (known.name.clone(), known.columns.len(), known.derived))
            .collect()
    }

    /// Makes later calls reject scenes whose facts violate a constraint. The relational executor then decides, because
    /// the check needs a session. Answers do not depend on constraints either way.
    pub fn check_constraints(&mut self) {
        self.check_constraints = true;
    }

    /// Sets the limits of each later evaluation by the relational executor; without this call, they are
    /// [`TICK_LIMITS`].
    pub fn set_limits(&mut self, limits: Limits) {
        self.limits = limits;
    }

    /// Makes later errors of evaluation quote their clause with its place. `sources` must contain the rules; the
    /// sources that [`Inference::answer`] takes contain only scenes.
    pub fn name_clauses(&mut self, sources: &Sources) {
        self.rule_sources = Some(sources.clone());
    }

    /// Returns the diagnostic of an evaluation that failed.
    pub(super) fn exceeded(&self, error: &EvalError) -> Diagnostic {
        let mut fault = error.diagnostic(self.program.rules());
        // Its places are in the rules, which are not in the caller's sources.
        (fault.primary, fault.secondary) = (None, Vec::new());
        if let (Some(clause), Some(sources)) = (error.clause(), &self.rule_sources) {
            let clause = self.program.show_clause(clause, sources);
            fault.notes.insert(0, format!("in the evaluation of {clause}"));
        }
        fault
    }

    /// Evaluates the scene in `source`.
    ///
    /// Equal scenes have equal answers. Predicates that hold with a probability, unless the scene states them, are
    /// drawn from the seed, the scene's `tick` and the list positions of the two agents.
    ///
    /// # Errors
    /// All errors of the scene: `invalid-scene`; `limit-exceeded` if it is too large or its evaluation exceeds the
    /// [limits](Inference::set_limits); `constraint-violation` after [`Inference::check_constraints`].
    pub fn answer(&mut self, sources: &Sources, source: SourceId) -> Result<Answer<'static>, Vec<Diagnostic>> {
        self.answer_with(sources, source, &Cancel::never())
    }

    /// Cancellable variant of [`Inference::answer`]. On cancellation `self` is unchanged.
    ///
    /// # Errors
    /// As [`Inference::answer`]; `cancelled` on cancellation.
    pub fn answer_with(
        &mut self,
        sources: &Sources,
        source: SourceId,
        cancel: &Cancel,
    ) -> Result<Answer<'static>, Vec<Diagnostic>> {
        let scene = self.ground_with(sources, source, cancel)?;
        // Derived rows have no source position, so the diagnostic points to the whole scene.
        let whole = Span::new(source, 0..sources.text(source).len());
        (self.decide(Cow::Owned(scene), cancel)).map_err(|fault| vec![fault.at(whole, "in this scene")])
    }

    /// Evaluates the scene in `source` as [`Inference::answer`] does, with the relational executor, and explains a fact
    /// of it from the same evaluation. The explanation is a list of JSON objects with the keys `fact`, `holds` and
    /// `nodes`. A predicate alone asks about each ego of the scene; see [`AskedFact::read`].
    ///
    /// `rules` are the sources of the rules, with the question.
    ///
    /// # Errors
    /// As [`Inference::answer`]; the inner ones as [`AskedFact::read`], and `limit-exceeded` if the search for an
    /// explanation takes too many steps.
    pub fn answer_explained(
        &mut self,
        (sources, source): (&Sources, SourceId),
        (rules, question): (&Sources, SourceId),
    ) -> Result<(Answer<'static>, Explained), Vec<Diagnostic>> {
        let cancel = Cancel::never();
        let scene = self.ground_with(sources, source, &cancel)?;
        let whole = Span::new(source, 0..sources.text(source).len());
        let state = self.evaluated(&scene, &cancel);
        let state = state.map_err(|fault| vec![fault.at(whole, "in this scene")])?;
        let explained = self.explain(&scene, state.session(), (rules, question));
        let answer = Answer {
            vocabulary: Arc::clone(&self.vocabulary),
            derived: self.derived(&scene, &state),
            scene: Cow::Owned(scene),
            fallback: None,
        };
        Ok((answer, explained))
    }

    /// Returns the facts of the scene in `source`: the stated ones and those computed from the positions of its agents.
    ///
    /// # Errors
    /// As [`Inference::answer`], except errors of evaluation.
    pub fn ground(&mut self, sources: &Sources, source: SourceId) -> Result<SceneFacts, Vec<Diagnostic>> {
        self.ground_with(sources, source, &Cancel::never())
    }

    pub(super) fn ground_with(
        &mut self,
        sources: &Sources,
        source: SourceId,
        cancel: &Cancel,
    ) -> Result<SceneFacts, Vec<Diagnostic>> {
        let terms = Terms {
            predicates: (self.vocabulary.predicates.iter())
                .map(|predicate| (predicate.name.as_str(), predicate.arity, predicate.definition.unit()))
                .collect(),
            concepts: (self.scenario.predicates.iter())
                .filter_map(|predicate| predicate.definition.concept())
                .filter(|concept| !concept.is_kind)
                .map(|concept| (concept.of, concept.concept.as_str()))
                .collect(),
            kinds: &self.scenario.kinds,
        };
        let mut ticks = Vec::new();
        let scenes = parse_scenes(sources, source, &terms)?;
        let first = first_tick(&scenes);
        for scene in scenes {
            ticks.push(match scene {
                Scene::Geometric(scene) => self.geometric(scene, cancel)?,
                Scene::Symbolic(scene) => self.symbolic(scene),
            });
        }
        let mut present = ticks.pop().expect("there is a scene");
        let whole = Span::new(source, 0..sources.text(source).len());
        let past = self.past(&ticks, &present, cancel);
        present.facts.past = past.map_err(|fault| vec![fault.at(whole, "in an earlier tick of this list")])?;
        for (_, tick) in present.facts.past.iter_mut().flatten() {
            *tick += first;
        }
        Ok(present)
    }

    /// Returns what temporal operators read of earlier scenes in the present one.
    fn past(&self, earlier: &[SceneFacts], present: &SceneFacts, cancel: &Cancel) -> Result<Vec<PastRows>, Diagnostic> {
        let rules = self.program.rules();
        if earlier.iter().any(|scene| !scene.uncertain.is_empty()) {
            let message = "a scene of an earlier tick states rows with a probability";
            let fault = Diagnostic::new(codes::INVALID_SCENE, message);
            return Err(fault.help("only the last scene of a list, which is the present, may be uncertain"));
        }
        if rules.pasts.is_empty() || earlier.is_empty() {
            return Ok(Vec::new());
        }
        // Entities of the same name are the same one.
        let mut known: HashMap<&str, u32> = HashMap::new();
        let scenes = earlier.iter().chain([present]);
        let scenes = scenes.map(|scene| scene.names.iter().map(String::as_str).collect());
        let scenes: Vec<Vec<&str>> = scenes.collect();
        for name in scenes.iter().flatten() {
            let next = u32::try_from(known.len()).expect("fewer than 2^32 entities");
            known.entry(name).or_insert(next);
        }
        let arity = |predicate: PredicateId| rules.predicates[predicate.index()].arity();
        let mut watched = Watched::of(&rules.pasts, known.len(), arity);
        let mut memory = Memory::new(&rules.pasts, &watched, self.limits.bytes)?;
        for (scene, names) in earlier.iter().zip(&scenes) {
            let mut scene = scene.clone();
            scene.facts.past = self.renumbered(&memory, &known, names);
            let state = self.evaluated(&scene, cancel)?;
            state.watch_as(&mut watched, |entity| known[names[entity]] as usize);
            memory.advance(&watched);
            memory.check(self.limits.bytes)?;
        }
        Ok(self.renumbered(&memory, &known, &scenes[earlier.len()]))
    }

    /// Returns the rows of a memory over the entities of a scene with these names.
    fn renumbered(&self, memory: &Memory, known: &HashMap<&str, u32>, names: &[&str]) -> Vec<PastRows> {
        let mut places = vec![None; known.len()];
        for (place, name) in (0_u32..).zip(names) {
            places[known[name] as usize] = Some(place);
        }
        let rules = self.program.rules();
        let mut all = memory.rows();
        for (rows, past) in all.iter_mut().zip(&rules.pasts) {
            let arity = rules.predicates[past.predicate.index()].arity();
            rows.retain_mut(|(row, _)| {
                let mut entities = row[..arity].iter_mut();
                entities.all(|entity| match places[*entity as usize] {
                    Some(place) => {
                        *entity = place;
                        true
                    }
                    None => false,
                })
            });
            rows.sort_unstable();
        }
        all
    }

    fn geometric(&mut self, scene: GeometricScene, cancel: &Cancel) -> Result<SceneFacts, Vec<Diagnostic>> {
        let map = self.map(&scene).map_err(|fault| vec![fault])?;
        scene.check_cells(&map)?;
        let kinds = (scene.agents.iter())
            .map(|agent| self.scenario.kinds.of(agent.kind, &agent.concepts))
            .collect();
        let entities: Vec<Entity<'_>> = scene
            .agents
            .iter()
            .map(|agent| Entity {
                kind: agent.kind,
                concepts: &agent.concepts,
                priority: agent.priority,
                at: agent.at,
                heading: agent.heading,
                progress: agent.progress,
            })
            .collect();
        let given = |index: usize| scene.given.iter().find(|given| given.predicate == index);
        let zones = self.vocabulary.predicates.iter().enumerate();
        let mut zones = zones.filter_map(|(index, known)| Some((index, known, known.definition.zone()?)));
        let unknown = zones.find(|(index, _, zone)| map.zone(&zone.value).is_none() && given(*index).is_none());
        if let Some((_, known, zone)) = unknown {
            return Err(vec![no_zone(&scene, &map, &known.name, &zone.value)]);
        }
        let mut externals = self.vocabulary.predicates.iter().enumerate();
        let unknown = externals.find(|(index, known)| known.definition.is_external() && given(*index).is_none());
        if let Some((_, known)) = unknown {
            let message = format!("the scene does not state the external predicate `{}`", known.name);
            let fault = Diagnostic::new(codes::INVALID_SCENE, message).at(scene.map_span, "in the scene on this map");
            let rows = match known.arity {
                1 => r#"["Car_1"]"#,
                _ => r#"[["Car_1", "Car_2"]]"#,
            };
            let help = format!("state its rows: `\"given\": {{\"{}\": {rows}}}`", known.name);
            return Err(vec![fault.help(help)]);
        }
        let grounded = ground_with(
            &self.vocabulary,
            &map,
            self.scenario.view,
            &entities,
            &Draws {
                seed: self.seed,
                time: scene.tick,
            },
            |index| given(index).is_some(),
            (self.limits.bytes, cancel),
        );
        let mut facts = grounded.map_err(|stopped| vec![Diagnostic::from(stopped)])?;
        for index in 0..facts.rows.len() {
            if let Some(known) = given(index) {
                facts.rows[index].clone_from(&known.rows);
                facts.values[index].clone_from(&known.values);
            }
        }
        Ok(SceneFacts {
            uncertain: uncertain(&scene.given),
            kinds,
            names: scene.agents.into_iter().map(|agent| agent.id).collect(),
            egos: scene.egos,
            facts,
            actions: scene.actions,
        })
    }

    fn map(&mut self, scene: &GeometricScene) -> Result<Arc<CityMap>, Diagnostic> {
        if let Some(map) = self.maps.get(&scene.map) {
            return Ok(Arc::clone(map));
        }
        let mut sources = Sources::new();
        let config = match &scene.map {
            MapName::Map(name) => load_map(&mut sources, Path::new(name), self.read.as_ref()),
            MapName::Config(name) => {
                load_scenario(&mut sources, Path::new(name), self.read.as_ref()).map(|scenario| scenario.map)
            }
        };
        let made = config.and_then(|config| CityMap::generate(&config).map_err(|fault| vec![fault]));
        match made {
            Ok(map) => {
                let map = Arc::new(map);
                self.maps.insert(scene.map.clone(), Arc::clone(&map));
                Ok(map)
            }
            // The map's sources are not the caller's, so notes quote its errors.
            Err(faults) => {
                let fault = Diagnostic::new(codes::INVALID_SCENE, format!("the {} cannot be used", scene.map));
                Err(faults
                    .iter()
                    .fold(fault.at(scene.map_span, "named here"), |mut fault, cause| {
                        let place = cause.primary.as_ref().map(|label| sources.locate(label.span) + ": ");
                        fault.help.extend(cause.help.iter().cloned());
                        fault.note(format!("{}{}", place.unwrap_or_default(), cause.message))
                    }))
            }
        }
    }

    fn symbolic(&self, scene: SymbolicScene) -> SceneFacts {
        let mut facts = Facts::new(self.vocabulary.predicates.len());
        let uncertain = uncertain(&scene.facts);
        let sees = self.vocabulary.sees;
        if scene.facts.iter().all(|known| known.predicate != sees) {
            let all = 0..u32::try_from(scene.entities.len()).expect("fewer than 2^32 entities");
            let rows = &mut facts.rows[sees];
            rows.reserve_exact(all.len() * all.len());
            all.clone().for_each(|x| rows.extend(all.clone().map(|y| [x, y])));
        }
        for known in scene.facts {
            facts.rows[known.predicate] = known.rows;
            facts.values[known.predicate] = known.values;
        }
        SceneFacts {
            uncertain,
            kinds: Vec::new(),
            names: scene.entities,
            egos: vec![scene.ego],
            facts,
            actions: scene.actions,
        }
    }

    /// Evaluates a scene with known facts.
    ///
    /// # Errors
    /// `limit-exceeded` if it has more than [`MAX_ENTITIES`](crate::sim::MAX_ENTITIES) entities, or the rules derive
    /// too many rows from it; `constraint-violation` after [`Inference::check_constraints`].
    pub fn answer_facts<'s>(&self, scene: &'s SceneFacts) -> Result<Answer<'s>, Diagnostic> {
        self.answer_facts_with(scene, &Cancel::never())
    }

    /// Cancellable variant of [`Inference::answer_facts`].
    ///
    /// # Errors
    /// As [`Inference::answer_facts`]; `cancelled` on cancellation.
    pub fn answer_facts_with<'s>(&self, scene: &'s SceneFacts, cancel: &Cancel) -> Result<Answer<'s>, Diagnostic> {
        let count = scene.names.len();
        if count > MAX_ENTITIES {
            let message = format!("{count} entities; the limit is {MAX_ENTITIES}");
            return Err(Diagnostic::new(diag::codes::LIMIT_EXCEEDED, message));
        }
        self.decide(Cow::Borrowed(scene), cancel)
    }

    fn decide<'s>(&self, scene: Cow<'s, SceneFacts>, cancel: &Cancel) -> Result<Answer<'s>, Diagnostic> {
        if let Some((predicate, ..)) = scene.uncertain.first() {
            let name = &self.vocabulary.predicates[*predicate].name;
            let message = format!("the scene states rows of `{name}` with a probability");
            let fault = Diagnostic::new(codes::INVALID_SCENE, message);
            return Err(fault.help("ask for probabilities with `--marginals`, in Python with `marginals`"));
        }
        let (derived, fallback) = self.derive(&scene, cancel)?;
        Ok(Answer {
            vocabulary: Arc::clone(&self.vocabulary),
            scene,
            derived,
            fallback,
        })
    }

    /// Returns the derived actions of each ego and, if the dense executor gave up, the reason.
    fn derive(&self, scene: &SceneFacts, cancel: &Cancel) -> Result<(Vec<Actions>, Option<String>), Diagnostic> {
        let mut fallback = None;
        if let (Some(dense), false) = (&self.dense, self.check_constraints) {
            let width = Width::of(scene.names.len()).expect("a scene has fewer entities than the widest set");
            match in_words!(width, W => self.derive_dense::<W>(dense, scene, cancel))? {
                Ok(derived) => return Ok((derived, None)),
                Err(error) if self.executor == Executor::Dense => return Err(given_up(error)),
                Err(error) => fallback = Some(format!("the dense executor gave up: {error}")),
            }
        }
        let state = self.evaluated(scene, cancel)?;
        Ok((self.derived(scene, &state), fallback))
    }

    /// Returns the session of a scene, after the relational executor has evaluated it.
    fn evaluated(&self, scene: &SceneFacts, cancel: &Cancel) -> Result<GroundState, Diagnostic> {
        let mut state = self.ground_state(scene.names.iter().map(String::as_str));
        self.evaluate(&mut state, &scene.facts, cancel)?;
        if self.check_constraints {
            // The rules are not in the caller's sources, so the diagnostic does not point to the declaration.
            let known = |predicate| self.vocabulary.defines(&self.program, predicate);
            let mut broken = constraints::violations_among(state.session(), known).into_iter();
            if let Some(first) = broken.next() {
                let fault = Diagnostic::new(datalog::codes::CONSTRAINT_VIOLATION, first.message);
                return Err(broken.fold(fault, |fault, other| fault.note(other.message)));
            }
        }
        Ok(state)
    }

    /// Returns the derived actions of each ego.
    fn derived(&self, scene: &SceneFacts, state: &GroundState) -> Vec<Actions> {
        let derived = scene.egos.iter().map(|&ego| state.derived(&self.vocabulary, ego));
        derived.collect()
    }

    /// Returns a session for scenes with entities of these names, without facts.
    pub(crate) fn ground_state<'n>(&self, names: impl Iterator<Item = &'n str>) -> GroundState {
        GroundState::new(&self.program, &self.vocabulary, self.limits, names)
    }

    /// Explains a fact of an evaluated scene.
    fn explain(
        &self,
        scene: &SceneFacts,
        session: &Session,
        (rules, question): (&Sources, SourceId),
    ) -> Result<Vec<serde_json::Value>, Vec<Diagnostic>> {
        let names: Vec<&str> = scene.names.iter().map(String::as_str).collect();
        let mut explainer = Explainer::new(session);
        let mut accounts: Vec<serde_json::Value> = Vec::new();
        for &ego in &scene.egos {
            let known = (&self.scenario, session);
            let asked = AskedFact::read(rules, question, known, &names, Some(names[ego]))?;
            let account = asked.explain(&mut explainer).map_err(|error| vec![error.into()])?;
            let account = account.json(session, rules);
            // A question with values is the same for every ego.
            if !accounts.contains(&account) {
                accounts.push(account);
            }
        }
        Ok(accounts)
    }

    /// Replaces the facts of a session and evaluates the rules with the relational executor.
    ///
    /// # Errors
    /// `limit-exceeded` if the evaluation exceeds the [limits](Inference::set_limits); `cancelled` on cancellation.
    pub(crate) fn evaluate(&self, state: &mut GroundState, facts: &Facts, cancel: &Cancel) -> Result<(), Diagnostic> {
        state.set_with(facts, cancel).map_err(|error| self.exceeded(&error))
    }

    fn derive_dense<const W: usize>(
        &self,
        rules: &DenseRules,
        scene: &SceneFacts,
        cancel: &Cancel,
    ) -> Result<Result<Vec<Actions>, TooManySteps>, Diagnostic> {
        let count = scene.names.len();
        let bits: BitFacts<W> = rules.bits(&scene.facts, &self.vocabulary, count, scene.names.iter());
        let dense = &rules.dense;
        let mut bit_state = BitState::new(dense, count);
        bits.load(dense, &mut bit_state);
        let facts = CancellableFacts {
            facts: &bits,
            cancel,
            polls: Cell::new(0),
            cancelled: Cell::new(false),
        };
        let run = bit_state.run(dense, &facts);
        if facts.cancelled.get() {
            return Err(Diagnostic::cancelled());
        }
        if let Err(error) = run {
            return Ok(Err(error));
        }
        let holds = |action: Action, ego: usize| {
            let predicate = self.vocabulary.action(action);
            predicate.is_some_and(|predicate| bit_state.set(dense, predicate).is_some_and(|set| has(set, ego)))
        };
        let derived = |&ego: &usize| {
            self.vocabulary
                .actions()
                .all()
                .filter(|&action| holds(action, ego))
                .collect()
        };
        Ok(Ok(scene.egos.iter().map(derived).collect()))
    }
}

/// Binary facts with cancellation.
struct CancellableFacts<'a, const W: usize> {
    facts: &'a BitFacts<W>,
    cancel: &'a Cancel,
    polls: Cell<u32>,
    cancelled: Cell<bool>,
}

impl<const W: usize> CancellableFacts<'_, W> {
    /// The number of calls of `cancelled` per poll.
    const POLL_INTERVAL: u32 = 1024;
}

impl<const W: usize> BinaryFacts<W> for CancellableFacts<'_, W> {
    #[inline]
    fn narrow(&self, list: usize, at: usize, among: Set<W>) -> Set<W> {
        self.facts.narrow(list, at, among)
    }

    #[inline]
    fn any<const N: usize>(&self, lists: [usize; N], demand: Set<W>, among: Set<W>) -> Set<W> {
        self.facts.any(lists, demand, among)
    }

    #[inline]
    fn cancelled(&self) -> bool {
        self.polls.set(self.polls.get().wrapping_add(1));
        if self.polls.get().is_multiple_of(Self::POLL_INTERVAL) && self.cancel.requested() {
            self.cancelled.set(true);
        }
        self.cancelled.get()
    }
}

/// Returns the uncertain rows of a list, in the order of the vocabulary.
fn uncertain(list: &[GivenPredicate]) -> Vec<(usize, [u32; 2], f64)> {
    let rows = list
        .iter()
        .flat_map(|given| given.uncertain.iter().map(|(row, p)| (given.predicate, *row, *p)));
    let mut rows: Vec<(usize, [u32; 2], f64)> = rows.collect();
    rows.sort_by_key(|(predicate, ..)| *predicate);
    rows
}

/// Returns the number of the first of successive scenes: its tick if they state successive ticks, otherwise 0.
fn first_tick(scenes: &[Scene]) -> u64 {
    let stated: Option<Vec<u64>> = (scenes.iter())
        .map(|scene| match scene {
            Scene::Geometric(scene) => Some(scene.tick),
            Scene::Symbolic(_) => None,
        })
        .collect();
    let follows = |ticks: &[u64]| ticks[0].checked_add(1) == Some(ticks[1]);
    match stated.as_deref() {
        Some(ticks) if ticks.windows(2).all(follows) => ticks[0],
        _ => 0,
    }
}

/// Returns the fault of a scene on a map without a zone that a predicate tests.
fn no_zone(scene: &GeometricScene, map: &CityMap, predicate: &str, zone: &str) -> Diagnostic {
    let message = format!("the {} has no zone `{zone}`, which `{predicate}` tests", scene.map);
    let fault = Diagnostic::new(codes::INVALID_SCENE, message).at(scene.map_span, "named here");
    let fault = fault.help(format!(
        "name a map with this zone, or state the rows: `\"given\": {{\"{predicate}\": []}}`"
    ));
    match did_you_mean(zone, map.zones()) {
        Some(near) => fault.note(format!("it has a zone `{near}`")),
        None => fault,
    }
}
