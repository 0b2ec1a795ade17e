//! Inference: the decisions of the rules in one scene.

use crate::cancel::Cancel;
use crate::city::{Action, ActionTable, CityMap, Heading, KindId};
use crate::config::{Scenario, load_map, load_scenario};
use crate::datalog::dense::{BinaryFacts, BitFacts, BitState, Set, TooManySteps, TrackFirings, has};
use crate::datalog::explain::Explainer;
use crate::datalog::{self, EvalError, Limits, PredicateId, Program, Session, Value, constraints, internal::size};
use crate::datalog::{BaseType, MarginalOptions, Marginals, Probability};
use crate::diag::{self, Diagnostic, Limit, SourceId, Sources, Span, did_you_mean};
use crate::files::ReadFile;
use crate::predicate::{Entity, Unit};
use crate::rng::Seed;
use crate::sim::codes;
use crate::sim::scene::format::{GeometricScene, GivenPredicate, MapName, Scene, SymbolicScene, Terms, parse_scenes};
use crate::sim::tick::asked::AskedFact;
use crate::sim::tick::chance::Draws;
use crate::sim::tick::executor::{Choice, DenseRules, Executor, compile, given_up, of_rules};
use crate::sim::tick::ground::{Facts, MAX_ENTITIES, PastRows, ground_with, json_value};
use crate::sim::tick::ground_state::GroundPredicate;
use crate::sim::tick::ground_state::GroundState;
use crate::sim::tick::memory::{Memory, Watched};
use crate::sim::tick::vocabulary::{Actions, BasePredicate, Vocabulary};
use crate::sim::tick::width::{Width, in_words};
use crate::sim::tick::world::TICK_LIMITS;
use serde_json::json;
use std::borrow::Cow;
use std::cell::Cell;
use std::collections::HashMap;
use std::io::{self, Write};
use std::path::Path;
use std::sync::Arc;

/// Reads the files that scenes name.
type Reader = dyn ReadFile + Send + Sync;

/// Evaluates scenes with one scenario and one program. It caches maps by name.
pub struct Inference {
    scenario: Scenario,
    program: Program,
    vocabulary: Arc<Vocabulary>,
    read: Box<Reader>,
    maps: HashMap<MapName, Arc<CityMap>>,
    seed: Seed,
    executor: Executor,
    check_constraints: bool,
    /// The limits of each evaluation by the relational executor.
    limits: Limits,
    /// The sources of the rules, for messages; see [`Inference::name_clauses`].
    rule_sources: Option<Sources>,
    /// The working memory of [`Inference::marginals`].
    marginals: Option<Marginals>,
    /// The rules for the dense executor; `None` if a session decides.
    dense: Option<DenseRules>,
}

/// The explanations of a fact, as JSON, or why there are none.
pub type Explained = Result<Vec<serde_json::Value>, Vec<Diagnostic>>;

/// The entities and base facts of a scene.
#[derive(Clone, Debug)]
pub struct SceneFacts {
    /// The names of the entities.
    pub names: Vec<String>,
    /// Their kinds; empty if the scene does not say.
    pub kinds: Vec<KindId>,
    /// The positions of the egos.
    pub egos: Vec<usize>,
    /// The base facts.
    pub facts: Facts,
    /// The actions that entities took, by position, if the scene states them. Inference ignores them.
    pub actions: Vec<(usize, Action)>,
    /// The base facts that hold only with a probability: the predicate by its position in the vocabulary, the row, and
    /// the probability. They are among the facts, too.
    pub uncertain: Vec<(usize, [u32; 2], f64)>,
}

/// The decisions of the rules for the egos of a scene.
///
/// What an ego sees is computed on demand: together, the egos of a crowd see far more than the scene says.
#[derive(Clone, Debug)]
pub struct Answer<'s> {
    vocabulary: Arc<Vocabulary>,
    scene: Cow<'s, SceneFacts>,
    /// The derived actions of each ego.
    derived: Vec<Actions>,
    /// Why the relational executor decided although the dense one can evaluate the rules: a sentence without a full
    /// stop.
    pub fallback: Option<String>,
}

/// The probabilities of the actions of the egos of a scene.
#[derive(Clone, Debug)]
pub struct MarginalAnswer {
    /// The egos, in the order of the scene.
    pub egos: Vec<MarginalEgo>,
    /// Why the probabilities are estimates, as a sentence without a full stop; `None` if they are exact.
    pub inexact: Option<String>,
}

/// The probabilities of the actions of an ego. Those of impossible actions are left out.
#[derive(Clone, Debug)]
pub struct MarginalEgo {
    /// The name of the ego.
    pub id: String,
    /// The probability that the rules derive each action.
    pub derived: Vec<(String, Probability)>,
    /// The probability that the ego takes each action; they add up to 1.
    pub decided: Vec<(String, Probability)>,
}

/// The actions that an agent can take, in order of precedence, and its default.
#[derive(PartialEq)]
struct Order {
    actions: Vec<(Action, PredicateId)>,
    default: Action,
}

impl MarginalAnswer {
    /// Returns the answer as JSON: `{"egos": {ID: {"derived": {ACTION: 0.4}, "action": {ACTION: 0.4}}}, "exact": true}`.
    /// An estimate is `{"value", "low", "high"}`, and has the key `because` in place of `exact`.
    pub fn to_json(&self) -> serde_json::Value {
        let probability = |probability: &Probability| match probability.interval {
            None => json!(probability.value),
            Some((low, high)) => json!({ "value": probability.value, "low": low, "high": high }),
        };
        let all = |list: &[(String, Probability)]| {
            let entries = list.iter().map(|(action, value)| (action.clone(), probability(value)));
            serde_json::Value::Object(entries.collect())
        };
        let egos = self.egos.iter().map(|ego| {
            let entry = json!({ "derived": all(&ego.derived), "action": all(&ego.decided) });
            (ego.id.clone(), entry)
        });
        let egos = serde_json::Value::Object(egos.collect());
        match &self.inexact {
            None => json!({ "egos": egos, "exact": true }),
            Some(reason) => json!({ "egos": egos, "exact": false, "because": reason }),
        }
    }
}

/// The decision of the rules for one ego.
#[derive(Clone, Debug)]
pub struct EgoAnswer {
    /// The name of the ego.
    pub id: String,
    /// The names of all entities in its field of view: itself first, the others in list order.
    pub sees: Vec<String>,
    /// The true atoms over these entities, by base predicate, without `Sees`. The row of a quantity ends with its value.
    pub atoms: Vec<(String, Vec<Vec<String>>)>,
    /// The derived actions, without the default.
    pub derived: Actions,
    /// The action to take.
    pub action: Action,
}

impl Answer<'_> {
    /// Returns the names of the egos with their actions, in the order of the scene.
    pub fn actions(&self) -> impl Iterator<Item = (&str, Action)> {
        let decided = self.scene.egos.iter().zip(&self.derived);
        decided.map(|(&ego, &derived)| (self.scene.names[ego].as_str(), self.decide(ego, derived)))
    }

    fn decide(&self, ego: usize, derived: Actions) -> Action {
        self.vocabulary.decide(self.scene.kinds.get(ego).copied(), derived)
    }

    /// Returns the actions of the configuration.
    pub fn table(&self) -> &ActionTable {
        self.vocabulary.actions()
    }

    /// Returns one answer per ego, in the order of the scene.
    pub fn egos(&self) -> impl Iterator<Item = EgoAnswer> {
        let names = &self.scene.names;
        self.scene.egos.iter().zip(&self.derived).map(move |(&ego, &derived)| {
            let view = View::of(&self.vocabulary, &self.scene, ego);
            let name = |entity: &usize| names[*entity].clone();
            let atoms = view.atoms().map(|(predicate, rows)| {
                let rows = rows.iter().map(|row| {
                    let value = row
                        .value()
                        .map(|value| value.as_str().map_or(value.to_string(), str::to_owned));
                    row.entities.iter().map(name).chain(value).collect()
                });
                (predicate.name.clone(), rows.collect())
            });
            EgoAnswer {
                id: name(&ego),
                atoms: atoms.collect(),
                sees: view.entities.iter().map(name).collect(),
                action: self.decide(ego, derived),
                derived: self.vocabulary.before_default(derived),
            }
        })
    }

    /// Writes the answer as JSON: `{"egos": {ID: {"sees": [..], "true": {..}, "derived": [..], "action": ".."}}}`. A row
    /// with one name is a plain string. `more` are further keys with their values.
    ///
    /// # Errors
    /// The errors of `out`.
    pub fn write_json<'m>(
        &self,
        out: &mut dyn Write,
        more: impl IntoIterator<Item = (&'m str, &'m serde_json::Value)>,
    ) -> io::Result<()> {
        let quoted = |text: &str| json!(text).to_string();
        let names: Vec<String> = self.scene.names.iter().map(|name| quoted(name)).collect();
        out.write_all(b"{\"egos\":{")?;
        for (position, (&ego, &derived)) in self.scene.egos.iter().zip(&self.derived).enumerate() {
            let view = View::of(&self.vocabulary, &self.scene, ego);
            write!(out, "{}{}:{{\"sees\":", comma(position), names[ego])?;
            write_list(out, &view.entities, |out, &entity| {
                out.write_all(names[entity].as_bytes())
            })?;
            out.write_all(b",\"true\":{")?;
            for (position, (predicate, rows)) in view.atoms().enumerate() {
                write!(out, "{}{}:", comma(position), quoted(&predicate.name))?;
                write_list(out, &rows, |out, row| row.write(out, &names))?;
            }
            let actions = self.vocabulary.before_default(derived);
            let table = self.table();
            let actions: Vec<&str> = actions.iter().map(|action| table.name(action)).collect();
            let action = table.name(self.decide(ego, derived));
            write!(out, "}},\"derived\":{},\"action\":{}}}", json!(actions), json!(action))?;
        }
        out.write_all(b"}")?;
        for (key, value) in more {
            write!(out, ",{}:{value}", quoted(key))?;
        }
        out.write_all(b"}")
    }

    /// Returns the answer as JSON; see [`Answer::write_json`].
    ///
    /// # Errors
    /// `limit-exceeded` if it takes more than about `limit` bytes.
    pub fn to_json(&self, limit: u64) -> Result<serde_json::Value, Diagnostic> {
        /// The memory of a row of two names: as text, as JSON, and once more in the language of a caller.
        const ROW_BYTES: u64 = 512;
        let mut rows = 0;
        for &ego in &self.scene.egos {
            let view = View::of(&self.vocabulary, &self.scene, ego);
            rows += view.entities.len() + view.atoms().map(|(_, rows)| rows.len()).sum::<usize>();
            if rows as u64 > limit / ROW_BYTES {
                let message = format!("the answer takes more than {}", size(limit));
                let fault = Diagnostic::new(diag::codes::LIMIT_EXCEEDED, message).exceeds(Limit::Memory(limit));
                return Err(fault.help("name fewer `egos` in the scene"));
            }
        }
        let mut text = Vec::new();
        self.write_json(&mut text, []).expect("writing to memory cannot fail");
        Ok(serde_json::from_slice(&text).expect("it has been written as JSON"))
    }
}

/// Returns what separates the element at a position from the one before it.
fn comma(position: usize) -> &'static str {
    if position > 0 { "," } else { "" }
}

fn write_list<T>(
    out: &mut dyn Write,
    list: &[T],
    write: impl Fn(&mut dyn Write, &T) -> io::Result<()>,
) -> io::Result<()> {
    out.write_all(b"[")?;
    for (position, element) in list.iter().enumerate() {
        out.write_all(comma(position).as_bytes())?;
        write(out, element)?;
    }
    out.write_all(b"]")
}

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
    fn exceeded(&self, error: &EvalError) -> Diagnostic {
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

    fn ground_with(
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
        for scene in parse_scenes(sources, source, &terms)? {
            ticks.push(match scene {
                Scene::Geometric(scene) => self.geometric(scene, cancel)?,
                Scene::Symbolic(scene) => self.symbolic(scene),
            });
        }
        let mut present = ticks.pop().expect("there is a scene");
        let whole = Span::new(source, 0..sources.text(source).len());
        let past = self.past(&ticks, &present, cancel);
        present.facts.past = past.map_err(|fault| vec![fault.at(whole, "in an earlier tick of this list")])?;
        Ok(present)
    }

    /// Returns what temporal operators read of earlier scenes in the present one.
    fn past(&self, earlier: &[SceneFacts], present: &SceneFacts, cancel: &Cancel) -> Result<Vec<PastRows>, Diagnostic> {
        let rules = self.program.rules();
        if rules.pasts.is_empty() || earlier.is_empty() {
            return Ok(Vec::new());
        }
        if earlier.iter().any(|scene| !scene.uncertain.is_empty()) {
            let message = "a scene of an earlier tick states rows with a probability";
            let fault = Diagnostic::new(codes::INVALID_SCENE, message);
            return Err(fault.help("only the last scene of a list, which is the present, may be uncertain"));
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
        let given = |index: usize| given(&self.vocabulary, &scene.given, index);
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
            uncertain: uncertain(&self.vocabulary, &scene.given),
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
        for (index, (rows, values)) in facts.rows.iter_mut().zip(&mut facts.values).enumerate() {
            if let Some(known) = given(&self.vocabulary, &scene.facts, index) {
                rows.clone_from(&known.rows);
                values.clone_from(&known.values);
            }
        }
        if !scene
            .facts
            .iter()
            .any(|fact| fact.name == self.vocabulary.predicates[self.vocabulary.sees].name)
        {
            let all = 0..u32::try_from(scene.entities.len()).expect("fewer than 2^32 entities");
            facts.rows[self.vocabulary.sees] = all.clone().flat_map(|x| all.clone().map(move |y| [x, y])).collect();
        }
        SceneFacts {
            uncertain: uncertain(&self.vocabulary, &scene.facts),
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

    /// Returns the probabilities of the actions of each ego of the scene in `source`, which may state rows with a
    /// probability. Clauses with probabilities draw nothing, but count with all their alternatives.
    ///
    /// # Errors
    /// As [`Inference::answer`]; `invalid-scene` for a list of scenes if facts or actions of the earlier ones are
    /// uncertain.
    pub fn marginals(
        &mut self,
        sources: &Sources,
        source: SourceId,
        options: MarginalOptions,
        cancel: &Cancel,
    ) -> Result<MarginalAnswer, Vec<Diagnostic>> {
        let scene = self.ground_with(sources, source, cancel)?;
        let whole = Span::new(source, 0..sources.text(source).len());
        if !scene.facts.past.is_empty() && self.program.rules().chance.is_some() {
            let message = "the actions of the earlier ticks of this list are uncertain, since the rules draw them";
            let fault = Diagnostic::new(codes::INVALID_SCENE, message).at(whole, "");
            return Err(vec![
                fault.help("use rules without probabilities, or a scene of one tick"),
            ]);
        }
        let found = self.probabilities(&scene, options, cancel);
        found.map_err(|fault| vec![fault.at(whole, "in this scene")])
    }

    fn probabilities(
        &mut self,
        scene: &SceneFacts,
        options: MarginalOptions,
        cancel: &Cancel,
    ) -> Result<MarginalAnswer, Diagnostic> {
        let vocabulary = Arc::clone(&self.vocabulary);
        let order = self.scenario.actions.priority.iter();
        let order: Vec<(Action, PredicateId)> = order
            .filter_map(|action| Some((*action, vocabulary.action(*action)?)))
            .collect();
        let options = MarginalOptions {
            limits: self.limits,
            ..options
        };
        let ids = || order.iter().map(|(_, predicate)| *predicate);
        let known = self.marginals.take().filter(|known| *known.options() == options);
        let mut marginals = match known {
            Some(mut known) => {
                known.clear();
                known
            }
            None => Marginals::new(&self.program, ids(), options).expect("actions are predicates"),
        };
        let names: Vec<Value> = scene.names.iter().map(|name| marginals.intern(name)).collect();
        let headings = Heading::ALL.map(|heading| marginals.intern(heading.name()));
        let mut insert = |predicate: GroundPredicate, row: [u32; 2], value: Option<Value>, probability: f64| {
            let words = row[..predicate.arity].iter().map(|entity| names[*entity as usize]);
            let value = value.map(|value| match predicate.value {
                Some(BaseType::Symbol) => headings[value.0 as usize],
                _ => value,
            });
            let words: Vec<Value> = words.chain(value).collect();
            let inserted = marginals.insert(predicate.id, &words[..], probability);
            inserted.expect("facts of the vocabulary fit");
        };
        for (index, predicate) in GroundPredicate::of(&vocabulary).enumerate() {
            let Some(predicate) = predicate else { continue };
            let rows = scene.facts.rows[index].iter().enumerate();
            rows.for_each(|(at, row)| insert(predicate, *row, scene.facts.values[index].get(at).copied(), 1.0));
            let uncertain = scene.uncertain.iter().filter(|(of, ..)| *of == index);
            uncertain.for_each(|(_, row, probability)| insert(predicate, *row, None, *probability));
        }
        let rules = self.program.rules();
        for (past, rows) in rules.pasts.iter().zip(&scene.facts.past) {
            let predicate = GroundPredicate {
                id: past.predicate,
                arity: rules.predicates[past.predicate.index()].arity(),
                value: None,
            };
            rows.iter().for_each(|(row, _)| insert(predicate, *row, None, 1.0));
        }
        let mut egos: Vec<Option<MarginalEgo>> = scene.egos.iter().map(|_| None).collect();
        while let Some(next) = egos.iter().position(Option::is_none) {
            let order = self.order_of(scene, scene.egos[next]);
            let ordered = marginals.set_order(order.actions.iter().map(|(_, predicate)| *predicate));
            ordered.expect("actions are predicates");
            marginals.compute(cancel).map_err(|error| self.exceeded(&error))?;
            let open = scene.egos.iter().zip(&mut egos);
            for (&ego, answer) in open.filter(|(ego, _)| self.order_of(scene, **ego) == order) {
                let row = [names[ego]];
                *answer = Some(self.marginal_ego(&scene.names[ego], &row, &order, &marginals));
            }
        }
        let answer = MarginalAnswer {
            egos: egos.into_iter().flatten().collect(),
            inexact: marginals.inexact().map(|inexact| inexact.show(self.program.rules())),
        };
        self.marginals = Some(marginals);
        Ok(answer)
    }

    /// Returns the actions that an ego can take, in order of precedence, and its default.
    fn order_of(&self, scene: &SceneFacts, ego: usize) -> Order {
        let config = &self.scenario.actions;
        let kind = scene.kinds.get(ego).copied();
        let usual = (config.priority.as_slice(), config.default);
        let (priority, default) = kind.map_or(usual, |kind| config.order(kind));
        let can_take = |action: &&Action| kind.is_none_or(|kind| config.table.can_take(kind, **action));
        let actions = priority.iter().filter(can_take);
        Order {
            actions: (actions.filter_map(|action| Some((*action, self.vocabulary.action(*action)?)))).collect(),
            default,
        }
    }

    /// Returns the probabilities of an ego, whose row this is, for actions in order of precedence.
    fn marginal_ego(&self, id: &str, row: &[Value], order: &Order, marginals: &Marginals) -> MarginalEgo {
        let table = self.vocabulary.actions();
        let name = |action: Action| table.name(action).to_owned();
        let derived = order.actions.iter().filter_map(|(action, predicate)| {
            let probability = marginals.probability(*predicate, row)?;
            Some((name(*action), probability))
        });
        let mut decided: Vec<(Action, Probability)> = Vec::new();
        let actions = order.actions.iter().map(|(action, _)| *action);
        let actions = actions.chain([order.default]);
        for (action, probability) in actions.zip(marginals.first(row)) {
            match decided.iter_mut().find(|(known, _)| *known == action) {
                Some((_, known)) => *known = known.or(probability),
                None if probability.value > 0.0 => decided.push((action, probability)),
                None => {}
            }
        }
        MarginalEgo {
            id: id.to_owned(),
            derived: derived.collect(),
            decided: decided
                .into_iter()
                .map(|(action, value)| (name(action), value))
                .collect(),
        }
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

/// Returns the stated rows of a predicate, if the scene has any.
fn given<'g>(vocabulary: &Vocabulary, list: &'g [GivenPredicate], index: usize) -> Option<&'g GivenPredicate> {
    let name = &vocabulary.predicates[index].name;
    list.iter().find(|given| given.name == *name)
}

/// Returns the uncertain rows of a list.
fn uncertain(vocabulary: &Vocabulary, list: &[GivenPredicate]) -> Vec<(usize, [u32; 2], f64)> {
    let predicates = 0..vocabulary.predicates.len();
    let given = predicates.filter_map(|index| Some((index, given(vocabulary, list, index)?)));
    let rows = given.flat_map(|(index, given)| given.uncertain.iter().map(move |(row, p)| (index, *row, *p)));
    rows.collect()
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

/// What an ego sees.
struct View<'a> {
    vocabulary: &'a Vocabulary,
    facts: &'a Facts,
    /// The entities in view: the ego first, the others in list order.
    entities: Vec<usize>,
    /// The position in `entities` of each entity of the scene.
    places: Vec<Option<usize>>,
}

impl<'a> View<'a> {
    fn of(vocabulary: &'a Vocabulary, scene: &'a SceneFacts, ego: usize) -> Self {
        let others = scene.facts.rows[vocabulary.sees]
            .iter()
            .filter(|[x, _]| *x as usize == ego)
            .map(|[_, y]| *y as usize)
            .filter(|&y| y != ego);
        let entities: Vec<usize> = std::iter::once(ego).chain(others).collect();
        let mut places = vec![None; scene.names.len()];
        for (place, &entity) in entities.iter().enumerate() {
            places[entity] = Some(place);
        }
        View {
            vocabulary,
            facts: &scene.facts,
            entities,
            places,
        }
    }

    /// Returns the true atoms over the entities in view without `Sees`: each predicate that has some, by its position in
    /// the vocabulary, and its rows of entities in the order of the view, with the value of a quantity.
    fn atoms(&self) -> impl Iterator<Item = (&'a BasePredicate, Vec<ViewRow>)> {
        let predicates = self.vocabulary.predicates.iter().enumerate();
        let others = predicates.filter(|(index, _)| *index != self.vocabulary.sees);
        others.filter_map(|(index, predicate)| {
            // Columns that the predicate does not have contain 0, which need not be in view.
            let place = |(at, row): (usize, &[u32; 2])| -> Option<([usize; 2], Option<Value>)> {
                let mut places = [0; 2];
                for (place, entity) in places.iter_mut().zip(&row[..predicate.arity]) {
                    *place = self.places[*entity as usize]?;
                }
                Some((places, self.facts.values[index].get(at).copied()))
            };
            let mut rows: Vec<_> = self.facts.rows[index].iter().enumerate().filter_map(place).collect();
            rows.sort_unstable();
            let rows = rows.into_iter().map(|(places, value)| ViewRow {
                entities: places[..predicate.arity]
                    .iter()
                    .map(|place| self.entities[*place])
                    .collect(),
                value: value.zip(predicate.definition.unit()),
            });
            let rows: Vec<ViewRow> = rows.collect();
            (!rows.is_empty()).then_some((predicate, rows))
        })
    }
}

/// A row of a predicate in a view.
struct ViewRow {
    entities: Vec<usize>,
    value: Option<(Value, Unit)>,
}

impl ViewRow {
    /// Returns the value of a quantity as JSON.
    fn value(&self) -> Option<serde_json::Value> {
        self.value.map(|(value, unit)| json_value(value, unit))
    }

    /// Writes the row as JSON: a list, or its only element. `names` are those of the entities, as JSON.
    fn write(&self, out: &mut dyn Write, names: &[String]) -> io::Result<()> {
        let is_list = self.entities.len() + usize::from(self.value.is_some()) != 1;
        out.write_all(if is_list { b"[" } else { b"" })?;
        for (position, &entity) in self.entities.iter().enumerate() {
            out.write_all(comma(position).as_bytes())?;
            out.write_all(names[entity].as_bytes())?;
        }
        if let Some(value) = self.value() {
            write!(out, "{}{value}", comma(self.entities.len()))?;
        }
        out.write_all(if is_list { b"]" } else { b"" })
    }
}
