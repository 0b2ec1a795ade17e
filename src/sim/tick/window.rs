//! Part of a city as bits for the dense executor.
//!
//! Binary facts are computed lazily with the fast form of their predicate ([`Relation`]): row and column indexes select
//! the entities in the rectangle that it reaches, and each is tested. Of a few entities, pairwise distances select them
//! ([`Near`]), which need no index to keep.
// Decision: docs/decisions/executors.md#d041

use crate::city::{Agent, AgentKind, Area, Cell, CityMap};
use crate::datalog::dense::{
    Argument, BinaryFacts, BitState, Input, List, Set, TooManySteps, and, first, holding, is_empty, members, without,
};
use crate::predicate::{
    CellTable, Definition, Pair, PairRelation, Reach, Relation, Static, Views, headings, with_relation,
};
use crate::sim::tick::agent_state::{AgentState, Position};
use crate::sim::tick::chance::Chance;
use crate::sim::tick::executor::DenseRules;
use crate::sim::tick::hidden::{Hidden, Now, set_of_words};
use crate::sim::tick::vocabulary::Vocabulary;
use std::collections::BTreeMap;
use std::ops::Deref;
use std::sync::Arc;

/// A list that a dense program reads.
#[derive(Clone, Debug)]
struct Requested {
    /// The position in the vocabulary and the fast form; `None` if the vocabulary lacks the predicate, which then never
    /// holds.
    predicate: Option<(usize, PairRelation)>,
    /// For a list of a predicate without a fast form.
    hidden: Option<Hidden>,
    axis: Argument,
    /// The places of possible members, relative to an entity of each kind: without a heading, and with each heading.
    reaches: [[Reach; 5]; 2],
    /// Whether all entities in reach are members.
    fills_reach: bool,
    /// Whether the list is the field of view of its first argument.
    is_view: bool,
    /// Whether the list contains only entities in the field of view of its first argument.
    in_view: bool,
}

/// The computation of the inputs and lists of a dense program. The cities of a world share one plan, which stays in the
/// cache when many cities take turns.
#[derive(Debug)]
pub(super) struct Plan {
    pub rules: DenseRules,
    map: Arc<CityMap>,
    /// The inputs of predicates without a fast form, by their positions in the inputs, and whether they are diagonals.
    hidden: Vec<(usize, Hidden, bool)>,
    /// The inputs that depend on an agent's kind and concepts.
    fixed: Vec<(usize, Static)>,
    /// The inputs that depend on an agent's kind and the junction at its cell.
    local: Vec<(usize, CellTable)>,
    /// The inputs that depend on an agent's cell.
    places: Vec<(usize, Arc<Area>)>,
    /// The inputs that hold for all agents: diagonals of reflexive predicates.
    always: Vec<usize>,
    lists: Vec<Requested>,
    views: Views,
    /// The maximum number of cells that a bounded list reaches in any direction.
    farthest_reach: i32,
    /// The classes of the scenario's agents. Agents of one entry of an agent set share their concepts, so comparing
    /// pointers is enough.
    likely: Vec<(AgentKind, Arc<[String]>)>,
    /// The inputs that hold for each of these classes.
    likely_inputs: Vec<Vec<usize>>,
}

/// A plan and the further classes of a city's agents.
#[derive(Clone, Debug)]
pub(super) struct Grounder {
    plan: Arc<Plan>,
    /// The numbers of the classes that are not [likely](Plan::likely).
    known: BTreeMap<(AgentKind, Arc<[String]>), u32>,
    /// The inputs that hold for each of them.
    inputs: Vec<Vec<usize>>,
}

impl Deref for Grounder {
    type Target = Plan;

    fn deref(&self) -> &Plan {
        &self.plan
    }
}

impl Plan {
    /// The maximum number of likely classes.
    const LIKELY: usize = 64;

    /// Plans the computation of the inputs of `rules`. Those that have facts must be predicates of the vocabulary or
    /// conditions.
    /// `agents` are the kinds and concepts of the agents to expect.
    pub fn new<'a>(
        rules: DenseRules,
        vocabulary: &Vocabulary,
        map: &Arc<CityMap>,
        view: u32,
        agents: impl Iterator<Item = (AgentKind, &'a Arc<[String]>)>,
    ) -> Self {
        // A predicate outside the vocabulary has no facts: binding rejects all others.
        let find = |wanted| {
            let mut predicates = vocabulary.predicates.iter();
            let position = predicates.position(|predicate| predicate.id == Some(wanted))?;
            Some((position, &vocabulary.predicates[position].definition))
        };
        let views = Views::new(view);
        let (mut fixed, mut local, mut places) = (Vec::new(), Vec::new(), Vec::new());
        let (mut always, mut hidden) = (Vec::new(), Vec::new());
        let dense = &rules.dense;
        for (input, requested) in dense.inputs().iter().enumerate() {
            let (Input::Unary(wanted) | Input::Diagonal(wanted)) = *requested;
            let diagonal = matches!(requested, Input::Diagonal(_));
            hidden.extend(Hidden::of(&rules, vocabulary, wanted).map(|hidden| (input, hidden, diagonal)));
            match find(wanted) {
                Some((_, Definition::Static(predicate))) => fixed.push((input, predicate.clone())),
                Some((_, Definition::Local(predicate))) => local.push((input, predicate.table())),
                Some((_, Definition::Place(predicate))) => places.push((input, predicate.area(map))),
                Some((_, Definition::Pair(pair))) if pair.is_reflexive() => always.push(input),
                Some((_, Definition::Pair(_) | Definition::Quantity(_) | Definition::External(_))) | None => {}
            }
        }
        let lists: Vec<Requested> = (dense.lists().iter())
            .map(|&List(wanted, axis)| {
                let predicate = find(wanted).and_then(|(position, definition)| match definition {
                    Definition::Pair(pair) => Some((position, pair)),
                    _ => None,
                });
                let hidden = Hidden::of(&rules, vocabulary, wanted);
                let forward = axis == Argument::Second;
                let is_view = forward && matches!(predicate, Some((_, Pair::Sees(_))));
                let predicate = predicate.map(|(position, pair)| (position, pair.relation(map)));
                let relation = predicate.as_ref().map(|(_, relation)| relation);
                let in_view = |(_, relation): &(_, PairRelation)| relation.is_in_view(&views);
                Requested {
                    reaches: AgentKind::ALL.map(|kind| {
                        headings().map(|heading| match (relation, axis) {
                            (None, _) if hidden.is_some() => Reach::Anywhere,
                            (None, _) => Reach::Nowhere,
                            (Some(relation), Argument::Second) => relation.reach(&views, kind, heading),
                            (Some(relation), Argument::First) => relation.reach_back(),
                        })
                    }),
                    fills_reach: forward && relation.is_some_and(PairRelation::fills_reach),
                    in_view: forward && !is_view && hidden.is_none() && predicate.as_ref().is_none_or(in_view),
                    is_view,
                    predicate,
                    hidden,
                    axis,
                }
            })
            .collect();
        let reaches = lists.iter().flat_map(|list| list.reaches.as_flattened());
        let bounded = reaches.filter_map(|reach| match reach {
            Reach::Within(cells) => cells.iter().copied().max(),
            Reach::Nowhere | Reach::Anywhere => None,
        });
        let mut likely: Vec<(AgentKind, Arc<[String]>)> = Vec::new();
        for (kind, concepts) in agents {
            let is_new = likely.iter().all(|class| !is_class(class, kind, concepts));
            if is_new && likely.len() < Plan::LIKELY {
                likely.push((kind, Arc::clone(concepts)));
            }
        }
        let mut plan = Plan {
            farthest_reach: bounded.max().unwrap_or(0),
            fixed,
            local,
            places,
            always,
            lists,
            views,
            rules,
            map: Arc::clone(map),
            hidden,
            likely,
            likely_inputs: Vec::new(),
        };
        let inputs = |(kind, concepts): &(AgentKind, Arc<[String]>)| plan.inputs_of(*kind, concepts);
        plan.likely_inputs = plan.likely.iter().map(inputs).collect();
        plan
    }

    /// Returns the inputs that hold for agents of this kind with these concepts.
    fn inputs_of(&self, kind: AgentKind, concepts: &[String]) -> Vec<usize> {
        let holds = self
            .fixed
            .iter()
            .filter(|(_, predicate)| predicate.holds(kind, concepts));
        holds.map(|(input, _)| *input).collect()
    }

    /// Returns the maximum number of cells that agents see in any direction.
    pub fn farthest_view(&self) -> i32 {
        self.views.farthest()
    }
}

impl Grounder {
    /// Creates a grounder without known classes.
    pub fn new(plan: Arc<Plan>) -> Self {
        Grounder {
            plan,
            known: BTreeMap::new(),
            inputs: Vec::new(),
        }
    }

    /// Returns the plan.
    pub fn plan(&self) -> &Arc<Plan> {
        &self.plan
    }

    /// Returns whether both have the same plan.
    pub fn has_plan_of(&self, other: &Grounder) -> bool {
        Arc::ptr_eq(&self.plan, &other.plan)
    }

    /// Returns the class of agents with this kind and these concepts.
    pub fn class_of(&mut self, kind: AgentKind, concepts: &Arc<[String]>) -> u32 {
        let Grounder { plan, known, inputs } = self;
        let likely = plan.likely.iter().position(|class| is_class(class, kind, concepts));
        let number = |class: usize| u32::try_from(class).expect("fewer classes than agents");
        if let Some(class) = likely {
            return number(class);
        }
        let next = number(plan.likely.len() + known.len());
        *(known.entry((kind, Arc::clone(concepts)))).or_insert_with(|| {
            inputs.push(plan.inputs_of(kind, concepts));
            next
        })
    }

    /// Writes the inputs that do not depend on cells, as sets of agents, of which there are at most 64.
    pub fn steady_inputs(&mut self, agents: &[Agent], inputs: &mut Vec<Set<1>>) {
        let classes = agents.iter().map(|agent| self.class_of(agent.kind, &agent.concepts));
        let classes: Vec<u32> = classes.collect();
        self.fill_steady(classes.into_iter(), inputs);
    }

    /// Writes the inputs that do not depend on cells, as sets of entities with these classes, and clears the others.
    fn fill_steady<const W: usize>(&self, classes: impl ExactSizeIterator<Item = u32>, inputs: &mut Vec<Set<W>>) {
        inputs.clear();
        inputs.resize(self.rules.dense.inputs().len(), [0; W]);
        for &input in &self.always {
            inputs[input] = first(classes.len());
        }
        for (entity, class) in classes.enumerate() {
            for &input in self.inputs_of_class(class) {
                inputs[input][entity / 64] |= 1 << (entity % 64);
            }
        }
    }

    /// Returns the inputs that hold for a class.
    #[inline]
    fn inputs_of_class(&self, class: u32) -> &[usize] {
        let class = class as usize;
        match class.checked_sub(self.plan.likely.len()) {
            None => &self.plan.likely_inputs[class],
            Some(further) => &self.inputs[further],
        }
    }
}

/// Returns whether a class is that of agents with this kind and this list of concepts.
fn is_class((of, carried): &(AgentKind, Arc<[String]>), kind: AgentKind, concepts: &Arc<[String]>) -> bool {
    *of == kind && Arc::ptr_eq(carried, concepts)
}

/// Up to `64 * W` entities and their places.
#[derive(Clone, Debug)]
pub(super) struct Window<const W: usize> {
    pub bodies: Vec<AgentState>,
    pub bit_state: BitState<W>,
    /// The set of each input of the program.
    inputs: Vec<Set<W>>,
    place: Place<W>,
}

/// The entities by rows and columns, as prefix unions.
#[derive(Clone, Debug)]
struct Place<const W: usize> {
    /// The first cell of the area.
    first: Cell,
    /// Item `i` holds the entities in the first `i` rows.
    rows: Vec<Set<W>>,
    cols: Vec<Set<W>>,
}

impl<const W: usize> Place<W> {
    /// Returns the entities at most this many cells up, down, left and right of a cell.
    #[inline]
    fn around(&self, at: Cell, [up, down, left, right]: [i32; 4]) -> Set<W> {
        let (row, col) = (at.row - self.first.row, at.col - self.first.col);
        let rows = between(&self.rows, row - up, row + down);
        and(rows, &between(&self.cols, col - left, col + right))
    }

    fn mark(&mut self, entity: usize, at: Cell) {
        let flip = |lists: &mut [Set<W>], line: i32| lists[line as usize + 1][entity / 64] ^= 1 << (entity % 64);
        flip(&mut self.rows, at.row - self.first.row);
        flip(&mut self.cols, at.col - self.first.col);
    }

    /// Turns the entities of single lines into prefix unions.
    fn sum(&mut self) {
        for lists in [&mut self.rows, &mut self.cols] {
            let mut sum = [0; W];
            for set in lists {
                for (sum, word) in sum.iter_mut().zip(set) {
                    *sum |= *word;
                    *word = *sum;
                }
            }
        }
    }

    fn shift(&mut self, entity: usize, from: Cell, to: Cell) {
        let first = self.first;
        let flip = |lists: &mut [Set<W>], from: i32, to: i32| {
            for set in &mut lists[from.min(to) as usize + 1..=from.max(to) as usize] {
                set[entity / 64] ^= 1 << (entity % 64);
            }
        };
        // Moves are straight.
        if from.row != to.row {
            flip(&mut self.rows, from.row - first.row, to.row - first.row);
        }
        if from.col != to.col {
            flip(&mut self.cols, from.col - first.col, to.col - first.col);
        }
    }
}

/// Returns the entities in the lines from `low` to `high`, clamped to the area. The range overlaps the area.
#[inline]
fn between<const W: usize>(lists: &[Set<W>], low: i32, high: i32) -> Set<W> {
    let last = lists.len() - 1;
    let high = ((high + 1) as usize).min(last);
    without(lists[high], &lists[(low.max(0) as usize).min(last)])
}

impl<const W: usize> Window<W> {
    pub fn new(grounder: &Grounder) -> Self {
        Window {
            bodies: Vec::new(),
            bit_state: BitState::new(&grounder.rules.dense, 0),
            inputs: Vec::new(),
            place: Place {
                first: Cell::new(0, 0),
                rows: Vec::new(),
                cols: Vec::new(),
            },
        }
    }

    /// Rebuilds all sets from `bodies`, for an area of `rows` by `cols` cells that starts at `first_cell`.
    ///
    /// # Panics
    /// If the window cannot hold all bodies, or one is outside the area.
    pub fn fill(&mut self, grounder: &Grounder, first_cell: Cell, [rows, cols]: [i32; 2]) {
        let Place {
            first: area_first,
            rows: row_lists,
            cols: col_lists,
        } = &mut self.place;
        *area_first = first_cell;
        for (lists, lines) in [(row_lists, rows), (col_lists, cols)] {
            lists.clear();
            lists.resize(lines as usize + 1, [0; W]);
        }
        for (entity, body) in self.bodies.iter().enumerate() {
            self.place.mark(entity, body.at);
        }
        self.place.sum();
        self.fill_inputs(grounder);
    }

    /// Rebuilds the inputs from `bodies`.
    ///
    /// # Panics
    /// If the window cannot hold all bodies.
    fn fill_inputs(&mut self, grounder: &Grounder) {
        let count = self.bodies.len();
        self.bit_state.reset(&grounder.rules.dense, count);
        grounder.fill_steady(self.bodies.iter().map(|body| body.class), &mut self.inputs);
        for entity in 0..count {
            self.look(grounder, entity);
        }
    }

    /// Sets the inputs that depend on the cell of an entity.
    fn look(&mut self, grounder: &Grounder, entity: usize) {
        let body = &self.bodies[entity];
        let inputs = &mut self.inputs;
        let mut set = |input: usize, holds: bool| {
            let word = &mut inputs[input][entity / 64];
            *word = *word & !(1 << (entity % 64)) | u64::from(holds) << (entity % 64);
        };
        for &(input, table) in &grounder.local {
            set(input, table.holds(body.junction, body.kind));
        }
        for (input, area) in &grounder.places {
            set(*input, area.contains(body.at));
        }
    }

    /// Applies a move.
    pub fn shift(&mut self, grounder: &Grounder, map: &CityMap, entity: usize, to: Position) {
        let body = &mut self.bodies[entity];
        let (from, junction) = (body.at, body.junction);
        body.shift(map, to);
        let has_moved = from != to.cell;
        // Most moves enter or leave no intersection.
        if body.junction != junction || has_moved && !grounder.places.is_empty() {
            self.look(grounder, entity);
        }
        if has_moved {
            self.place.shift(entity, from, to.cell);
        }
    }

    /// Rebuilds all sets from `bodies`, computes all facts that the rules may read, and returns their number.
    pub fn count_facts(&mut self, grounder: &Grounder, now: Now<'_>) -> u64 {
        let lines = |lists: &[Set<W>]| i32::try_from(lists.len() - 1).expect("an area has fewer than 2^31 lines");
        let size = [lines(&self.place.rows), lines(&self.place.cols)];
        self.fill(grounder, self.place.first, size);
        self.count_in(grounder, now, &self.place)
    }

    /// Returns the number of all facts that the rules may read.
    fn count_in(&self, grounder: &Grounder, now: Now<'_>, place: &impl Surrounding<W>) -> u64 {
        let scene = Scene {
            plan: grounder,
            bodies: &self.bodies,
            place,
            now,
            whole: false,
        };
        let all = first(self.bodies.len());
        let lists = (0..grounder.lists.len())
            .flat_map(|list| (0..self.bodies.len()).map(move |at| (list, at)))
            .map(|(list, at)| scene.narrow(list, at, all));
        let ones = |set: Set<W>| set.iter().map(|word| u64::from(word.count_ones())).sum::<u64>();
        self.inputs.iter().copied().chain(lists).map(ones).sum()
    }

    /// Evaluates the rules. `whole`: the bodies are all agents, in list order.
    ///
    /// # Errors
    /// As [`BitState::run`].
    pub fn run(&mut self, grounder: &Grounder, now: Now<'_>, whole: bool) -> Result<(), TooManySteps> {
        let Window {
            bodies,
            bit_state,
            inputs,
            place,
        } = self;
        run_in(grounder, now, (bodies, inputs), &*place, bit_state, whole)
    }
}

/// Evaluates the rules over entities with these inputs. `whole`: the entities are all agents, in list order.
#[inline(always)]
fn run_in<const W: usize>(
    grounder: &Grounder,
    now: Now<'_>,
    (bodies, inputs): (&[AgentState], &[Set<W>]),
    place: &impl Surrounding<W>,
    bit_state: &mut BitState<W>,
    whole: bool,
) -> Result<(), TooManySteps> {
    for (input, set) in inputs.iter().enumerate() {
        bit_state.set_input(&grounder.rules.dense, input, *set);
    }
    for (input, hidden, diagonal) in &grounder.hidden {
        let set = hidden.members(
            &grounder.rules.conditions,
            &grounder.map,
            now,
            bodies,
            (*diagonal, whole),
        );
        bit_state.set_input(&grounder.rules.dense, *input, set);
    }
    let scene = Scene {
        plan: grounder,
        bodies,
        place,
        now,
        whole,
    };
    bit_state.run(&grounder.rules.dense, &scene)
}

/// Windows of at most [`Near::MAX`] entities that keep no index of places. Each run loads all agents first, so that the
/// cities of a plan can share a window.
impl Window<1> {
    /// Loads agents. `steady` has their [steady inputs](Grounder::steady_inputs).
    ///
    /// # Panics
    /// If there are more than [`Near::MAX`] agents.
    pub fn load_few(&mut self, grounder: &Grounder, map: &CityMap, agents: &[Agent], steady: &[Set<1>]) {
        assert!(agents.len() <= Near::MAX, "{} agents", agents.len());
        let Window { bodies, inputs, .. } = self;
        bodies.clear();
        bodies.extend((agents.iter().enumerate()).map(|(position, agent)| AgentState::new(map, position, agent)));
        inputs.clear();
        inputs.extend_from_slice(steady);
        for &(input, table) in &grounder.local {
            let holds = bodies.iter().map(|body| table.holds(body.junction, body.kind));
            inputs[input] = [holding(holds)];
        }
        for (input, area) in &grounder.places {
            inputs[*input] = [holding(bodies.iter().map(|body| area.contains(body.at)))];
        }
        if self.bit_state.count() != agents.len() {
            self.bit_state.reset(&grounder.rules.dense, agents.len());
        }
    }

    /// Evaluates the rules.
    ///
    /// # Errors
    /// As [`BitState::run`].
    pub fn run_few(&mut self, grounder: &Grounder, now: Now<'_>) -> Result<(), TooManySteps> {
        let near = Near::new(&self.bodies, grounder.farthest_reach);
        let Window {
            bodies,
            bit_state,
            inputs,
            ..
        } = self;
        run_in(grounder, now, (bodies, inputs), &near, bit_state, true)
    }

    /// Computes all facts that the rules may read, and returns their number.
    pub fn count_few(&self, grounder: &Grounder, now: Now<'_>) -> u64 {
        self.count_in(grounder, now, &Near::new(&self.bodies, grounder.farthest_reach))
    }
}

/// Finds the entities around a cell.
trait Surrounding<const W: usize> {
    /// Returns the members of `among` at most this many cells up, down, left and right of entity `at`.
    fn select(&self, bodies: &[AgentState], at: usize, cells: [i32; 4], among: Set<W>) -> Set<W>;
}

impl<const W: usize> Surrounding<W> for Place<W> {
    #[inline(always)]
    fn select(&self, bodies: &[AgentState], at: usize, cells: [i32; 4], among: Set<W>) -> Set<W> {
        and(among, &self.around(bodies[at].at, cells))
    }
}

/// The entities near each of a few entities: those within the farthest reach.
pub(super) struct Near([u64; Near::MAX]);

impl Near {
    /// The maximum number of entities. The time for all pairs of them is that of an index.
    pub const MAX: usize = 32;

    /// Finds the entities at most this many cells away in rows and columns.
    ///
    /// A difference takes half a word. Its bit 30 is set if it is at least 0: coordinates and `cells` are from 0 to
    /// 2^28.
    fn new(bodies: &[AgentState], cells: i32) -> Near {
        let both = |row: i32, col: i32| u64::from(row.cast_unsigned()) << 32 | u64::from(col.cast_unsigned());
        let sign = both(1 << 30, 1 << 30);
        let reach = both(cells, cells);
        let mut near = [0; Near::MAX];
        let mut places = [0; Near::MAX];
        for (at, body) in bodies.iter().enumerate() {
            let here = both(body.at.row, body.at.col);
            let mut set = 1 << at;
            for (other, there) in places[..at].iter().enumerate() {
                let low = here + sign + reach - there;
                let high = 2 * (sign + reach) - low;
                let is_near = u64::from(low & high & sign == sign);
                set |= is_near << other;
                near[other] |= is_near << at;
            }
            places[at] = here;
            near[at] = set;
        }
        Near(near)
    }
}

impl Surrounding<1> for Near {
    #[inline(always)]
    fn select(&self, bodies: &[AgentState], at: usize, [up, down, left, right]: [i32; 4], [among]: Set<1>) -> Set<1> {
        let near = [self.0[at % Near::MAX] & among];
        let here = bodies[at].at;
        let inside = members(&near).fold(0, |set, other| {
            let there = bodies[other].at;
            let (row, col) = (there.row - here.row, there.col - here.col);
            // Without branches, since about as many are inside as outside.
            let is_inside = (-up <= row) & (row <= down) & (-left <= col) & (col <= right);
            set | u64::from(is_inside) << other
        });
        [inside]
    }
}

/// Computes binary facts for the executor.
struct Scene<'a, S> {
    plan: &'a Plan,
    bodies: &'a [AgentState],
    place: &'a S,
    now: Now<'a>,
    /// Whether the entities are all agents, in list order.
    whole: bool,
}

impl<const W: usize, S: Surrounding<W>> BinaryFacts<W> for Scene<'_, S> {
    #[inline]
    fn narrow(&self, list: usize, at: usize, among: Set<W>) -> Set<W> {
        self.related(&self.plan.lists[list], at, among)
    }

    #[inline]
    fn any<const N: usize>(&self, lists: [usize; N], demand: Set<W>, among: Set<W>) -> Set<W> {
        let lists = lists.map(|list| &self.plan.lists[list]);
        // The field of view is redundant if another list contains only entities in it.
        let skips = lists.iter().any(|list| list.in_view);
        let mut found = [0; W];
        for at in members(&demand) {
            let mut set = among;
            for list in lists {
                if skips && list.is_view {
                    continue;
                }
                set = self.related(list, at, set);
                if is_empty(&set) {
                    break;
                }
            }
            if !is_empty(&set) {
                found[at / 64] |= 1 << (at % 64);
            }
        }
        found
    }
}

impl<S> Scene<'_, S> {
    /// Returns the members of `among` that a list relates to entity `at`.
    #[inline(always)]
    fn related<const W: usize>(&self, list: &Requested, at: usize, among: Set<W>) -> Set<W>
    where
        S: Surrounding<W>,
    {
        let body = &self.bodies[at];
        let near = match list.reaches[body.kind as usize][body.heading.map_or(0, |heading| heading as usize + 1)] {
            Reach::Nowhere => [0; W],
            Reach::Within(cells) => self.place.select(self.bodies, at, cells, among),
            Reach::Anywhere => among,
        };
        match list.fills_reach || is_empty(&near) {
            true => near,
            false => self.refine(list, at, near),
        }
    }

    /// Returns the members of `near` that a list relates to entity `at`, given that they are in reach.
    // Not inlined, because in most cases no entity is in reach.
    #[inline(never)]
    fn refine<const W: usize>(&self, list: &Requested, at: usize, near: Set<W>) -> Set<W> {
        let Some((predicate, relation)) = &list.predicate else {
            let Some(hidden) = &list.hidden else {
                return [0; W];
            };
            if let (Hidden::Past(past), Argument::Second, true) = (hidden, list.axis, self.whole)
                && let Some(row) = self.now.memory.holding_row(*past, at)
            {
                return and(near, &set_of_words(row));
            }
            if let (Hidden::Given(source, predicate), Argument::Second, true) = (hidden, list.axis, self.whole) {
                return and(near, &set_of_words(self.now.given(*source).row(*predicate, at)));
            }
            let (here, bodies) = (&self.bodies[at], self.bodies);
            let pair = |other: usize| match list.axis {
                Argument::Second => [here, &bodies[other]],
                Argument::First => [&bodies[other], here],
            };
            if let Hidden::Draw(draw) = hidden {
                let draw = draw.in_tick(self.now.drawing.word);
                return keep(near, |other| self.now.succeeds(&draw, pair(other)));
            }
            return keep(near, |other| {
                hidden.holds(&self.plan.rules.conditions, &self.plan.map, self.now, pair(other))
            });
        };
        with_relation!(relation, relation => match list.axis {
            Argument::Second => self.seconds(*predicate, relation, at, near),
            Argument::First => self.firsts(*predicate, relation, at, near),
        })
    }

    /// Returns the `y` in `near` for which the relation holds of (`at`, `y`).
    #[inline(always)]
    fn seconds<const W: usize, R: Relation>(&self, predicate: usize, relation: &R, at: usize, near: Set<W>) -> Set<W> {
        let x = &self.bodies[at];
        keep(near, |other| {
            let y = &self.bodies[other];
            let draw = |probability| self.decides(predicate, x, y, probability);
            match other == at {
                true => R::REFLEXIVE,
                false => relation.test(&x.subject(), &y.subject(), draw),
            }
        })
    }

    /// Returns the `x` in `near` for which the relation holds of (`x`, `at`).
    #[inline(always)]
    fn firsts<const W: usize, R: Relation>(&self, predicate: usize, relation: &R, at: usize, near: Set<W>) -> Set<W> {
        let y = &self.bodies[at];
        keep(near, |other| {
            let x = &self.bodies[other];
            let draw = |probability| self.decides(predicate, x, y, probability);
            match other == at {
                true => R::REFLEXIVE,
                false => relation.holds(&self.plan.views, &x.subject(), &y.subject(), draw),
            }
        })
    }

    fn decides(&self, predicate: usize, x: &AgentState, y: &AgentState, probability: f64) -> bool {
        (self.now.draws).decides(predicate, x.agent as usize, y.agent as usize, probability)
    }
}

/// Returns the members for which `holds` returns true.
#[inline]
fn keep<const W: usize>(set: Set<W>, holds: impl Fn(usize) -> bool) -> Set<W> {
    let mut kept = set;
    for member in members(&set) {
        if !holds(member) {
            kept[member / 64] &= !(1 << (member % 64));
        }
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::city::Junction;
    use crate::rng::{Purpose, RngExt, Seed};

    #[test]
    fn pairwise_distances_select_the_entities_of_the_index() {
        const SIDE: i32 = 60;
        let mut random = Seed(1).stream(Purpose::TEST, 0, 0);
        let mut counts = [0; 2];
        for round in 0..400 {
            let count = round % (Near::MAX + 1);
            let body = |agent| AgentState {
                at: Cell::new(random.random_range(0..SIDE), random.random_range(0..SIDE)),
                priority: 0,
                agent,
                class: 0,
                kind: AgentKind::Car,
                heading: None,
                junction: Junction::default(),
            };
            let bodies: Vec<AgentState> = (0..u32::try_from(count).expect("small")).map(body).collect();
            let farthest = random.random_range(0..30);
            let near = Near::new(&bodies, farthest);
            let lines = vec![[0]; SIDE as usize + 1];
            let mut place: Place<1> = Place {
                first: Cell::new(0, 0),
                rows: lines.clone(),
                cols: lines,
            };
            for (entity, body) in bodies.iter().enumerate() {
                place.mark(entity, body.at);
            }
            place.sum();
            for at in 0..count {
                let cells = [(); 4].map(|()| random.random_range(0..=farthest));
                let among = [random.random()];
                let found = near.select(&bodies, at, cells, among);
                assert_eq!(found, place.select(&bodies, at, cells, among));
                counts[0] += found[0].count_ones();
                counts[1] += 1;
            }
        }
        assert!(counts[0] > counts[1] / 4, "{counts:?}");
    }
}
