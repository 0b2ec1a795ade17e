//! Some entities of a city and what relates them, as bits for the dense executor. Facts about pairs are computed where a rule asks
//! for them, from whole numbers; [`super::ground`] has the definitions, and tests compare the two.

use crate::city::AgentKind;
use crate::city::{Agent, Cell, CityMap, FieldOfView, Heading, Junction, view_reach};
use crate::config::Definition;
use crate::datalog::dense::{
    Argument, BinaryFacts, BitState, Dense, Input, List, Set, and, first, is_empty, members, without,
};
use crate::sim::ground::{Chance, Entity, binary, is_far_enough, is_near_enough, side, side_of};
use crate::sim::infer::Draws;
use crate::sim::vocabulary::Vocabulary;
use std::collections::BTreeMap;
use std::ops::Deref;
use std::sync::Arc;

/// What the predicates can see of an agent.
#[derive(Clone, Copy, Debug)]
pub(super) struct Body {
    pub at: Cell,
    pub priority: i32,
    /// Position in the list of agents.
    pub agent: u32,
    /// Position in [`Grounder::classes`].
    pub class: u32,
    pub kind: AgentKind,
    pub heading: Option<Heading>,
    /// Of the cell where it is.
    pub junction: Junction,
}

/// What moves change of an agent.
#[derive(Clone, Copy, Debug)]
pub(super) struct Position {
    pub cell: Cell,
    pub heading: Option<Heading>,
}

impl Position {
    pub fn of(agent: &Agent) -> Position {
        Position {
            cell: agent.cell,
            heading: agent.heading,
        }
    }
}

impl Body {
    /// Of an agent of the list. Its class is 0.
    pub fn new(map: &CityMap, position: usize, agent: &Agent) -> Self {
        Body {
            at: agent.cell,
            priority: agent.priority,
            agent: u32::try_from(position).expect("fewer than 2^32 agents"),
            class: 0,
            kind: agent.kind,
            heading: agent.heading,
            junction: map.junction(agent.cell),
        }
    }

    /// Takes note of a move.
    pub fn shift(&mut self, map: &CityMap, to: Position) {
        self.heading = to.heading;
        if self.at != to.cell {
            self.at = to.cell;
            self.junction = map.junction(to.cell);
        }
    }
}

/// How many cells something reaches: up, down, left, right.
pub(super) type Reach = [i32; 4];

/// Farther apart are no two cells of a map.
const FARTHEST: i32 = 1 << 24;

/// The greatest squared distance that is looked at: no two cells of a map are so far apart.
const SQUARE_MAX: i64 = 1 << 50;

/// How a predicate with one column, or its diagonal, is computed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Unary {
    /// By what the agent is: its class knows.
    Class,
    AtIntersection,
    InIntersection,
    /// The diagonal of the field of view: everybody sees himself.
    Always,
    /// The diagonal of another predicate.
    Never,
}

/// How facts about pairs are computed.
#[derive(Clone, Debug)]
pub(super) enum Relation {
    Sees,
    /// Squared distances from `least` to `most`; no farther than `reach` in rows or columns.
    Distance {
        least: i64,
        most: i64,
        reach: i32,
    },
    HigherPriority,
    /// Of the first, seen along the second's heading: left if 1, right if -1.
    Side(i64),
    Colliding(Box<Colliding>),
    /// Of nobody.
    Never,
}

#[derive(Clone, Debug)]
pub(super) struct Colliding {
    /// By kind and heading of the first: where the second can be.
    cones: [[Reach; 4]; 2],
    /// Position in the vocabulary.
    predicate: usize,
    definition: Definition,
}

/// A list that a dense program asks for.
#[derive(Clone, Debug)]
struct Asked {
    relation: Relation,
    axis: Argument,
    /// Whether whom it relates to an entity is in that one's field of view.
    in_view: bool,
}

/// How everything that a dense program asks for is computed. Cities of one world share it, which keeps it in the cache when many of them
/// take turns.
#[derive(Debug)]
pub(super) struct Plan {
    pub dense: Dense,
    inputs: Vec<Unary>,
    /// The inputs that depend on the cell where an agent is: whether it is inside an intersection, or at one.
    placed: Vec<(usize, bool)>,
    lists: Vec<Asked>,
    /// The inputs of which what an agent is decides.
    steady: Vec<(usize, Definition)>,
    /// How far an agent without a heading sees, and one with each.
    views: [Reach; 5],
}

/// A plan, and what the agents of a city are.
#[derive(Clone, Debug)]
pub(super) struct Grounder {
    plan: Arc<Plan>,
    /// The classes of agents that are known.
    known: BTreeMap<(AgentKind, Arc<[String]>), u32>,
    /// The first of them, up to [`Grounder::LIKELY`]. Agents of one entry of a set share their concepts, so it is enough to look whether
    /// they are the very same.
    likely: Vec<(AgentKind, Arc<[String]>)>,
    /// By class: the inputs that hold of its members.
    classes: Vec<Vec<usize>>,
}

impl Deref for Grounder {
    type Target = Plan;

    fn deref(&self) -> &Plan {
        &self.plan
    }
}

impl Plan {
    /// `dense` must ask only for predicates of the vocabulary.
    pub fn new(dense: Dense, vocabulary: &Vocabulary, view: u32) -> Self {
        // What is not a predicate of the vocabulary is one that no clause derives: binding has refused all others.
        let find = |relation| {
            let mut predicates = vocabulary.predicates.iter();
            let position = predicates.position(|predicate| predicate.relation == Some(relation))?;
            Some((position, &vocabulary.predicates[position].definition))
        };
        let inputs: Vec<Unary> = (dense.inputs().iter())
            .map(|&input| match input {
                Input::Unary(relation) => match find(relation) {
                    Some((_, Definition::AtIntersection)) => Unary::AtIntersection,
                    Some((_, Definition::InIntersection)) => Unary::InIntersection,
                    Some(_) => Unary::Class,
                    None => Unary::Never,
                },
                Input::Diagonal(relation) => match find(relation) {
                    Some((_, Definition::Sees)) => Unary::Always,
                    _ => Unary::Never,
                },
            })
            .collect();
        let views = views(view);
        let lists = (dense.lists().iter())
            .map(|&List(relation, axis)| {
                let relation = find(relation).map_or(Relation::Never, |(predicate, definition)| {
                    Relation::new(predicate, definition)
                });
                Asked {
                    in_view: axis == Argument::Second && relation.is_in_view(&views),
                    relation,
                    axis,
                }
            })
            .collect();
        let steady = (dense.inputs().iter().enumerate())
            .filter_map(|(position, input)| match input {
                Input::Unary(relation) => Some((position, find(*relation)?.1.clone())),
                Input::Diagonal(_) => None,
            })
            .filter(|(_, definition)| definition.is_steady())
            .collect();
        let placed = |(input, how): (usize, &Unary)| match how {
            Unary::InIntersection => Some((input, true)),
            Unary::AtIntersection => Some((input, false)),
            Unary::Class | Unary::Always | Unary::Never => None,
        };
        Plan {
            placed: inputs.iter().enumerate().filter_map(placed).collect(),
            inputs,
            lists,
            steady,
            views,
            dense,
        }
    }

    /// How far anybody sees.
    pub fn farthest_view(&self) -> i32 {
        self.views.iter().flatten().copied().max().unwrap_or(0)
    }
}

impl Grounder {
    /// No agents are known.
    pub fn new(plan: Arc<Plan>) -> Self {
        Grounder {
            plan,
            known: BTreeMap::new(),
            likely: Vec::new(),
            classes: Vec::new(),
        }
    }

    const LIKELY: usize = 16;

    /// The class of agents of this kind that carry these concepts.
    pub fn class_of(&mut self, kind: AgentKind, concepts: &Arc<[String]>) -> u32 {
        let Grounder {
            plan,
            known,
            likely,
            classes,
        } = self;
        let same = |(of, carried): &(AgentKind, Arc<[String]>)| *of == kind && Arc::ptr_eq(carried, concepts);
        if let Some(class) = likely.iter().position(same) {
            return u32::try_from(class).expect("it is less than 16");
        }
        let next = u32::try_from(known.len()).expect("fewer classes than agents");
        *(known.entry((kind, Arc::clone(concepts)))).or_insert_with(|| {
            if likely.len() < Self::LIKELY {
                likely.push((kind, Arc::clone(concepts)));
            }
            let holds = (plan.steady.iter()).filter(|(_, definition)| holds_of(definition, kind, concepts));
            classes.push(holds.map(|(input, _)| *input).collect());
            next
        })
    }
}

/// Whether a [steady](Definition::is_steady) definition holds of agents of this kind that carry these concepts.
pub(super) fn holds_of(definition: &Definition, kind: AgentKind, concepts: &[String]) -> bool {
    match definition {
        Definition::Kind(of) => *of == kind,
        Definition::Concept { of, concept } => *of == kind && concepts.contains(concept),
        _ => unreachable!("it depends on where agents are"),
    }
}

/// How far an agent without a heading sees, and one with each, if the half-width of the field of view is so many cells.
pub(super) fn views(half_width: u32) -> [Reach; 5] {
    let reach = |heading| view_reach(heading, half_width).map(|cells| cells.min(FARTHEST));
    let [left, right, up, down] = Heading::ALL.map(|heading| reach(Some(heading)));
    [reach(None), left, right, up, down]
}

impl Relation {
    /// Of the predicate at this position of the vocabulary.
    pub fn new(predicate: usize, definition: &Definition) -> Relation {
        match *definition {
            Definition::Sees => Relation::Sees,
            Definition::Distance { .. } => {
                // Both bounds are monotone in the distance, and the distance in its square.
                let least = first_square(|d| is_far_enough(definition, d));
                let most = first_square(|d| !is_near_enough(definition, d)) - 1;
                let reach = most.max(0).isqrt().min(i64::from(FARTHEST));
                Relation::Distance {
                    least,
                    most,
                    reach: i32::try_from(reach).expect("it is at most the farthest"),
                }
            }
            Definition::HigherPriority => Relation::HigherPriority,
            Definition::LeftOf => Relation::Side(1),
            Definition::RightOf => Relation::Side(-1),
            Definition::Colliding { .. } => {
                let cone = |kind| Heading::ALL.map(|heading| cone(definition, kind, heading));
                Relation::Colliding(Box::new(Colliding {
                    cones: AgentKind::ALL.map(cone),
                    predicate,
                    definition: definition.clone(),
                }))
            }
            Definition::Kind(_)
            | Definition::Concept { .. }
            | Definition::AtIntersection
            | Definition::InIntersection => unreachable!("a unary definition"),
        }
    }
}

impl Relation {
    /// Whether the first sees the second wherever it holds.
    fn is_in_view(&self, views: &[Reach; 5]) -> bool {
        match self {
            Relation::Colliding(colliding) => {
                let within = |cone: &Reach, view: &Reach| cone.iter().zip(view).all(|(cone, view)| cone <= view);
                let all_within =
                    |cones: &[Reach; 4]| cones.iter().zip(&views[1..]).all(|(cone, view)| within(cone, view));
                colliding.cones.iter().all(all_within)
            }
            Relation::Never => true,
            _ => false,
        }
    }
}

/// The least square of a distance for which something holds that holds from there on; [`SQUARE_MAX`] if it never does.
#[allow(clippy::cast_precision_loss)] // exact: squares are below 2^53
fn first_square(holds: impl Fn(f64) -> bool) -> i64 {
    let (mut low, mut high) = (0, SQUARE_MAX);
    while low < high {
        let middle = low + (high - low) / 2;
        match holds((middle as f64).sqrt()) {
            true => high = middle,
            false => low = middle + 1,
        }
    }
    low
}

/// Where what an agent of this kind and heading may collide with can be.
fn cone(definition: &Definition, kind: AgentKind, heading: Heading) -> Reach {
    /// Farther than this it is not looked for single cells.
    const LOOK: i32 = 32;
    let Definition::Colliding {
        car_range,
        pedestrian_range,
        ..
    } = *definition
    else {
        unreachable!("the definition of another predicate")
    };
    let range = match kind {
        AgentKind::Car => car_range,
        AgentKind::Pedestrian => pedestrian_range,
    };
    #[allow(clippy::cast_possible_truncation)] // a number beyond the limits becomes the limit
    let range = (range.max(0.0).floor() as i32).min(FARTHEST);
    if range > LOOK {
        return [range; 4];
    }
    let agent = |at| Entity {
        kind,
        concepts: &[],
        priority: 0,
        at,
        heading: Some(heading),
    };
    let here = agent(Cell::new(0, 0));
    let mut reach = [0; 4];
    for row in -range..=range {
        for col in -range..=range {
            if binary(definition, &here, &agent(Cell::new(row, col))) > 0.0 {
                for (reach, cells) in reach.iter_mut().zip([-row, row, -col, col]) {
                    *reach = cells.max(*reach);
                }
            }
        }
    }
    reach
}

/// Up to `64 * W` entities and where they are.
#[derive(Clone, Debug)]
pub(super) struct Window<const W: usize> {
    pub bodies: Vec<Body>,
    pub bit_state: BitState<W>,
    /// By input of the program.
    inputs: Vec<Set<W>>,
    place: Place<W>,
}

/// Who is where, by rows and columns.
#[derive(Clone, Debug)]
struct Place<const W: usize> {
    /// The first cell of the area.
    first: Cell,
    /// Item i: the entities in the first i rows.
    rows: Vec<Set<W>>,
    cols: Vec<Set<W>>,
}

impl<const W: usize> Place<W> {
    /// Those at most so far from a cell.
    #[inline]
    fn around(&self, at: Cell, [up, down, left, right]: Reach) -> Set<W> {
        let (row, col) = (at.row - self.first.row, at.col - self.first.col);
        let rows = between(&self.rows, row - up, row + down);
        and(rows, &between(&self.cols, col - left, col + right))
    }

    fn mark(&mut self, entity: usize, at: Cell) {
        let flip = |lists: &mut [Set<W>], line: i32| lists[line as usize + 1][entity / 64] ^= 1 << (entity % 64);
        flip(&mut self.rows, at.row - self.first.row);
        flip(&mut self.cols, at.col - self.first.col);
    }

    /// Turns the entities of single lines into those of all lines so far.
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
        flip(&mut self.rows, from.row - first.row, to.row - first.row);
        flip(&mut self.cols, from.col - first.col, to.col - first.col);
    }
}

/// The entities in the lines from `low` to `high`, as far as there are such lines. One of them is in between.
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
            bit_state: BitState::new(&grounder.dense, 0),
            inputs: Vec::new(),
            place: Place {
                first: Cell::new(0, 0),
                rows: Vec::new(),
                cols: Vec::new(),
            },
        }
    }

    /// Takes note of `bodies` afresh, all of them in the area of so many rows and columns from the cell `first` on.
    ///
    /// # Panics
    /// If they are more than the window holds, or one is outside of the area.
    pub fn fill(&mut self, grounder: &Grounder, first_cell: Cell, [rows, cols]: [i32; 2]) {
        let count = self.bodies.len();
        self.bit_state.reset(&grounder.dense, count);
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

        self.inputs.clear();
        self.inputs.resize(grounder.inputs.len(), [0; W]);
        for (entity, body) in self.bodies.iter().enumerate() {
            for &input in &grounder.classes[body.class as usize] {
                self.inputs[input][entity / 64] |= 1 << (entity % 64);
            }
        }
        for (input, how) in grounder.inputs.iter().enumerate() {
            if *how == Unary::Always {
                self.inputs[input] = first(count);
            }
        }
        for entity in 0..count {
            self.look(grounder, entity);
        }
    }

    /// Sets what depends on the cell where an entity is.
    fn look(&mut self, grounder: &Grounder, entity: usize) {
        let body = &self.bodies[entity];
        let (is_inside, is_at) = (body.junction.is_inside(), body.junction.is_at(body.kind));
        for &(input, inside) in &grounder.placed {
            let holds = (inside & is_inside) | (!inside & is_at);
            let word = &mut self.inputs[input][entity / 64];
            *word = *word & !(1 << (entity % 64)) | u64::from(holds) << (entity % 64);
        }
    }

    /// Takes note of a move.
    pub fn shift(&mut self, grounder: &Grounder, map: &CityMap, entity: usize, to: Position) {
        let body = &mut self.bodies[entity];
        let from = body.at;
        body.shift(map, to);
        if from != to.cell {
            self.place.shift(entity, from, to.cell);
            self.look(grounder, entity);
        }
    }

    /// Takes note of the bodies afresh and computes all facts that the rules can ask for. How many there are.
    pub fn count_facts(&mut self, grounder: &Grounder, draws: Draws) -> u64 {
        let lines = |lists: &[Set<W>]| i32::try_from(lists.len() - 1).expect("an area has fewer than 2^31 lines");
        let size = [lines(&self.place.rows), lines(&self.place.cols)];
        self.fill(grounder, self.place.first, size);
        let scene = Scene {
            grounder,
            bodies: &self.bodies,
            place: &self.place,
            draws,
        };
        let all = first(self.bodies.len());
        let lists = (0..grounder.lists.len())
            .flat_map(|list| (0..self.bodies.len()).map(move |at| (list, at)))
            .map(|(list, at)| scene.narrow(list, at, all));
        let ones = |set: Set<W>| set.iter().map(|word| u64::from(word.count_ones())).sum::<u64>();
        self.inputs.iter().copied().chain(lists).map(ones).sum()
    }

    /// Evaluates the rules.
    pub fn run(&mut self, grounder: &Grounder, draws: Draws) {
        for (input, set) in self.inputs.iter().enumerate() {
            self.bit_state.set_input(&grounder.dense, input, *set);
        }
        let scene = Scene {
            grounder,
            bodies: &self.bodies,
            place: &self.place,
            draws,
        };
        self.bit_state.run(&grounder.dense, &scene);
    }
}

/// Answers what the executor asks about pairs.
struct Scene<'a, const W: usize> {
    grounder: &'a Grounder,
    bodies: &'a [Body],
    place: &'a Place<W>,
    draws: Draws,
}

impl<const W: usize> BinaryFacts<W> for Scene<'_, W> {
    #[inline]
    fn narrow(&self, list: usize, at: usize, among: Set<W>) -> Set<W> {
        let asked = &self.grounder.lists[list];
        let body = &self.bodies[at];
        let near = |reach| and(among, &self.place.around(body.at, reach));
        match (&asked.relation, asked.axis) {
            (Relation::Sees, Argument::Second) => near(self.view(body)),
            (Relation::Distance { least, most, reach }, _) => keep(near([*reach; 4]), |other| {
                other != at && (*least..=*most).contains(&square(body.at, self.bodies[other].at))
            }),
            (Relation::Never, _) => [0; W],
            (Relation::Colliding(colliding), Argument::Second) => {
                let Some(heading) = body.heading else { return [0; W] };
                keep(near(colliding.cones[body.kind as usize][heading as usize]), |other| {
                    self.holds(&asked.relation, at, other)
                })
            }
            (_, Argument::Second) => keep(among, |other| self.holds(&asked.relation, at, other)),
            (_, Argument::First) => keep(among, |other| self.holds(&asked.relation, other, at)),
        }
    }

    #[inline]
    fn any<const N: usize>(&self, lists: [usize; N], demand: Set<W>, among: Set<W>) -> Set<W> {
        let asked = |list: usize| &self.grounder.lists[list];
        let is_view = |list: usize| {
            matches!(
                (&asked(list).relation, asked(list).axis),
                (Relation::Sees, Argument::Second)
            )
        };
        // Who is in view need not be found out where another list has none but those.
        let skips = lists.iter().any(|&list| asked(list).in_view);
        let mut found = [0; W];
        for at in members(&demand) {
            let mut set = among;
            for list in lists {
                if skips && is_view(list) {
                    continue;
                }
                set = self.narrow(list, at, set);
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

impl<const W: usize> Scene<'_, W> {
    fn view(&self, body: &Body) -> Reach {
        self.grounder.views[body.heading.map_or(0, |heading| heading as usize + 1)]
    }

    fn holds(&self, relation: &Relation, first: usize, second: usize) -> bool {
        let (x, y) = (&self.bodies[first], &self.bodies[second]);
        relation.holds(&self.grounder.views, &self.draws, x, y)
    }
}

impl Relation {
    /// Whether it holds of two agents.
    #[inline]
    pub fn holds(&self, views: &[Reach; 5], chance: &impl Chance, x: &Body, y: &Body) -> bool {
        let same = x.agent == y.agent;
        match *self {
            Relation::Sees => {
                let reach = views[x.heading.map_or(0, |heading| heading as usize + 1)];
                same || FieldOfView::around(x.at, reach).contains(y.at)
            }
            _ if same => false,
            Relation::Distance { least, most, .. } => (least..=most).contains(&square(x.at, y.at)),
            Relation::HigherPriority => x.priority < y.priority,
            Relation::Side(wanted) => side(&x.entity(), &y.entity()) * wanted > 0,
            Relation::Never => false,
            Relation::Colliding(ref colliding) => {
                let probability = binary(&colliding.definition, &x.entity(), &y.entity());
                probability >= 1.0
                    || probability > 0.0
                        && chance.happens(colliding.predicate, x.agent as usize, y.agent as usize, probability)
            }
        }
    }
}

impl Relation {
    /// Adds to the row of each body those to which it relates it. Agrees with [`Relation::holds`].
    pub fn relate(&self, views: &[Reach; 5], chance: &impl Chance, bodies: &[Body], rows: &mut [u64]) {
        let set = |rows: &mut [u64], first: usize, second: usize, holds: bool| {
            rows[first] |= u64::from(holds) << second;
        };
        match *self {
            Relation::Sees => {
                for (first, x) in bodies.iter().enumerate() {
                    let view = FieldOfView::around(x.at, views[x.heading.map_or(0, |heading| heading as usize + 1)]);
                    for (second, y) in bodies.iter().enumerate() {
                        set(rows, first, second, first == second || view.contains(y.at));
                    }
                }
            }
            Relation::Distance { least, most, .. } => {
                for (first, x) in bodies.iter().enumerate() {
                    for (second, y) in bodies[..first].iter().enumerate() {
                        let holds = (least..=most).contains(&square(x.at, y.at));
                        set(rows, first, second, holds);
                        set(rows, second, first, holds);
                    }
                }
            }
            Relation::HigherPriority => {
                for (first, x) in bodies.iter().enumerate() {
                    for (second, y) in bodies.iter().enumerate() {
                        set(rows, first, second, x.priority < y.priority);
                    }
                }
            }
            Relation::Side(wanted) => {
                for (second, y) in bodies.iter().enumerate() {
                    let Some(heading) = y.heading else { continue };
                    for (first, x) in bodies.iter().enumerate() {
                        set(rows, first, second, side_of(heading, x.at, y.at) * wanted > 0);
                    }
                }
            }
            Relation::Never => {}
            Relation::Colliding(ref colliding) => {
                for (first, x) in bodies.iter().enumerate() {
                    let Some(heading) = x.heading else { continue };
                    let cone = FieldOfView::around(x.at, colliding.cones[x.kind as usize][heading as usize]);
                    for (second, y) in bodies.iter().enumerate() {
                        if cone.contains(y.at) {
                            set(rows, first, second, self.holds(views, chance, x, y));
                        }
                    }
                }
            }
        }
    }
}

impl Body {
    fn entity(&self) -> Entity<'static> {
        Entity {
            kind: self.kind,
            concepts: &[],
            priority: self.priority,
            at: self.at,
            heading: self.heading,
        }
    }
}

/// The square of the distance of two cells on a map.
fn square(from: Cell, to: Cell) -> i64 {
    let (rows, cols) = to.offset_from(from);
    rows * rows + cols * cols
}

/// Those of a set for which it holds.
#[inline]
fn keep<const W: usize>(set: Set<W>, holds: impl Fn(usize) -> bool) -> Set<W> {
    let mut kept = set;
    if !is_empty(&set) {
        for member in members(&set) {
            if !holds(member) {
                kept[member / 64] &= !(1 << (member % 64));
            }
        }
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::{Purpose, RngExt, Seed};

    /// Holds of about half of all pairs.
    struct Parity;

    impl Chance for Parity {
        fn happens(&self, predicate: usize, first: usize, second: usize, _: f64) -> bool {
            (predicate + first * 3 + second * 5 + first * second).is_multiple_of(2)
        }
    }

    fn distance(above: Option<f64>, at_least: Option<f64>, below: Option<f64>, at_most: Option<f64>) -> Definition {
        Definition::Distance {
            above,
            at_least,
            below,
            at_most,
        }
    }

    #[test]
    fn all_pairs_at_once_are_as_one_by_one() {
        let definitions = [
            Definition::Sees,
            distance(Some(3.0), None, None, Some(8.0)),
            distance(None, Some(2.5), Some(6.0), None),
            Definition::HigherPriority,
            Definition::LeftOf,
            Definition::RightOf,
            Definition::Colliding {
                car_range: 8.0,
                pedestrian_range: 3.0,
                angle: 0.6,
                pedestrian_chance: 0.5,
                same_cell_chance: 0.5,
            },
        ];
        let definitions = definitions.iter().enumerate();
        let relations: Vec<Relation> = definitions
            .map(|(place, definition)| Relation::new(place, definition))
            .collect();
        let views = views(6);
        let mut random = Seed(1).stream(Purpose::SCENE, 0, 0);
        let mut found = vec![0; relations.len()];
        for _ in 0..400 {
            let count = random.random_range(1..=9);
            let body = |agent| Body {
                at: Cell::new(random.random_range(0..12), random.random_range(0..12)),
                priority: random.random_range(0..4),
                agent,
                class: 0,
                kind: AgentKind::ALL[random.random_range(0..2)],
                heading: (Heading::ALL.get(random.random_range(0..5))).copied(),
                junction: Junction::default(),
            };
            let bodies: Vec<Body> = (0..count).map(body).collect();
            for (relation, found) in relations.iter().zip(&mut found) {
                let mut rows = vec![0; bodies.len()];
                relation.relate(&views, &Parity, &bodies, &mut rows);
                let row = |x: &Body| {
                    let holds = |y: &Body| relation.holds(&views, &Parity, x, y);
                    (bodies.iter().enumerate()).fold(0, |row, (at, y)| row | u64::from(holds(y)) << at)
                };
                let expected: Vec<u64> = bodies.iter().map(row).collect();
                assert_eq!(rows, expected, "{relation:?} {bodies:?}");
                *found += expected.iter().map(|row| row.count_ones()).sum::<u32>();
            }
        }
        assert!(found.iter().all(|found| *found > 100), "{found:?}");
    }
}
