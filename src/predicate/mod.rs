//! The base predicates: their meaning, their computation, and their syntax in a configuration.
//!
//! Each kind of predicate has a file in this folder and an entry in `kinds!` below. Other code names only two kinds:
//! [`Sees`] limits what rules can read, and agents carry [`Concept`]s. The file of a kind implements
//!
//! 1. `PredicateKind`: the syntax in a configuration, the parsing of parameters, and the words in English sentences;
//! 2. the *definition*, written for readability; [`sim::ground`](crate::sim::ground) computes rows from it;
//! 3. the *fast form* of the same predicate, for windows of the dense executor and observations of a task.
//!
//! The inputs of a predicate determine its class, and the class determines when it is computed:
//!
//! | | depends on | definition | fast form | computed |
//! |---|---|---|---|---|
//! | [`Static`] | the agent's kind and concepts | `StaticKind::holds` | the same | once per combination |
//! | [`Local`] | the agent's kind and its cell's relation to intersections | `LocalKind::holds` | `CellTable` | when the agent moves |
//! | [`Place`] | the agent's cell | `PlaceKind::holds` | `Area` | when the agent moves |
//! | [`Pair`] | two agents | `PairKind::holds` | `Relation` | when a rule needs it |
//! | [`Quantity`] | the state of the agents | `Quantity::measure` | the same | when a rule needs it |
//! | [`External`] | a function of the caller | that function | the same | before each tick |
//!
//! A `Relation` answers in two steps, like a spatial query: a rectangle of cells is the filter, a test of two agents
//! the refinement. Property tests compare the fast forms with the definitions.
// Decision: docs/decisions/city.md#d004

mod ahead;
mod beside;
mod colliding;
mod concept;
mod distance;
mod external;
mod intersection;
mod kind;
mod lane;
mod near;
mod priority;
mod quantity;
mod same;
mod sees;
mod side;
mod sign;
mod situation;
mod yields;
mod zone;

use crate::city::{AgentKind, Area, Cell, CityMap, FieldOfView, Heading, Junction};
use crate::diag::Diagnostic;
use crate::yaml::codes;
use crate::yaml::read::{Fields, choice};
use crate::yaml::{Value, YamlNode};
use serde::{Serialize, Serializer};
use std::sync::Arc;

pub use ahead::Ahead;
pub use beside::{Beside, LaneBeside};
pub use colliding::Colliding;
pub use concept::Concept;
pub use distance::Distance;
pub use external::External;
pub use intersection::{AtIntersection, InIntersection};
pub use kind::Kind;
pub use lane::OnLane;
pub use near::{NEAR_MAX, Near};
pub use priority::HigherPriority;
pub(crate) use quantity::{Measure, Measured, WORDS};
pub use quantity::{Progress, Quantity, Unit, Words};
pub use same::SameIntersection;
pub use sees::Sees;
pub(crate) use sees::Views;
pub use side::{LeftOf, RightOf};
pub use sign::OnLaneWithSign;
pub use situation::{Situations, Together};
pub use yields::Yields;
pub use zone::Zone;

/// The state of an agent that predicates can see.
#[derive(Clone, Copy, Debug)]
pub struct Entity<'a> {
    /// Car or pedestrian.
    pub kind: AgentKind,
    /// The names of its concepts.
    pub concepts: &'a [String],
    /// The priority; a smaller number goes first.
    pub priority: i32,
    /// The cell.
    pub at: Cell,
    /// The direction of the last move; `None` before the first.
    pub heading: Option<Heading>,
    /// What only quantities read.
    pub progress: Progress,
}

/// The state of an agent that binary predicates can see.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Subject {
    pub kind: AgentKind,
    pub priority: i32,
    pub at: Cell,
    pub heading: Option<Heading>,
}

impl Entity<'_> {
    /// Returns the part that quantities read.
    pub(crate) fn measured(&self) -> Measured {
        Measured {
            subject: self.subject(),
            progress: self.progress,
        }
    }

    /// Returns the part that binary predicates see.
    pub(crate) fn subject(&self) -> Subject {
        Subject {
            kind: self.kind,
            priority: self.priority,
            at: self.at,
            heading: self.heading,
        }
    }
}

/// The limits of every agent's sight.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sight<'a> {
    pub map: &'a CityMap,
    /// The half-width of the field of view in cells.
    pub half_width: u32,
}

/// The syntax of a kind of predicate in a configuration.
pub(crate) enum Syntax {
    /// A single word.
    Word(&'static str, fn() -> Definition),
    /// A mapping with exactly these keys. The first key identifies the kind; the function gets the value of each key.
    Keys(
        &'static [&'static str],
        fn(&[&YamlNode], &mut Vec<Diagnostic>) -> Option<Definition>,
    ),
    /// No syntax: every scenario has the predicate.
    Always,
}

/// How English sentences express a predicate.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Phrase {
    /// The words after the first agent. In a predicate over two agents, the second agent follows.
    pub verb: String,
    /// The noun that names an agent for which the predicate holds, if it determines one.
    pub noun: Option<&'static str>,
    /// A sentence that explains the words, if they need one.
    pub meaning: Option<String>,
}

impl Phrase {
    fn new(verb: impl Into<String>) -> Phrase {
        Phrase {
            verb: verb.into(),
            noun: None,
            meaning: None,
        }
    }

    fn meaning(self, sentence: impl Into<String>) -> Phrase {
        Phrase {
            meaning: Some(sentence.into()),
            ..self
        }
    }
}

/// A kind of predicate.
pub(crate) trait PredicateKind: Into<Definition> {
    const SYNTAX: Syntax;

    /// Returns the words of the predicate in an English sentence.
    fn phrase(&self) -> Phrase;

    /// Returns predicates of this kind, for which the tests compare fast form and definition.
    #[cfg(test)]
    fn samples() -> Vec<Definition>;
}

/// A kind of predicate that depends on an agent's kind and concepts.
pub(crate) trait StaticKind: PredicateKind {
    /// Returns whether the predicate holds for agents of this kind with these concepts.
    fn holds(&self, kind: AgentKind, concepts: &[String]) -> bool;
}

/// A kind of predicate that depends on an agent's kind and cell.
pub(crate) trait LocalKind: PredicateKind {
    /// The definition: returns whether the predicate holds for an agent of this kind on this cell.
    fn holds(&self, map: &CityMap, kind: AgentKind, at: Cell) -> bool;

    /// Variant of [`holds`](LocalKind::holds) for all cells with the same relation to intersections.
    fn holds_on(&self, junction: Junction, kind: AgentKind) -> bool;
}

/// A kind of predicate that depends on an agent's cell.
pub(crate) trait PlaceKind: PredicateKind {
    /// The definition: returns whether the predicate holds for an agent on this cell.
    fn holds(&self, map: &CityMap, at: Cell) -> bool;

    /// Returns the cells of a map on which the predicate holds.
    fn area(&self, map: &CityMap) -> Arc<Area>;
}

/// A kind of predicate over two agents. [`Relation::REFLEXIVE`] states whether it relates agents to themselves.
pub(crate) trait PairKind: PredicateKind {
    /// The fast form.
    type Relation: Relation;

    /// Whether the predicate holds with a probability, so that `holds` calls `draw`.
    const DRAWN: bool = false;

    /// Whether the predicate depends on kind or heading of the first, and of the second agent. Both are true only if it
    /// also depends on the places of the agents on the map, not only on their offset.
    const READS: [bool; 2];

    /// The definition: returns whether the predicate holds for two different agents, in this order.
    ///
    /// `draw` returns whether an event of the given probability happens. Its result depends only on the predicate and
    /// the agents.
    fn holds(&self, sight: Sight<'_>, x: &Subject, y: &Subject, draw: impl FnOnce(f64) -> bool) -> bool;

    /// Prepares the fast form for a map.
    fn relation(&self, map: &Arc<CityMap>) -> Self::Relation;

    /// Returns a distance in cells beyond which only the signs of the offsets in rows and columns matter.
    fn horizon(&self, half_width: u32) -> f64;
}

/// The fast form of a predicate over two agents.
pub(crate) trait Relation {
    /// Whether the predicate relates every agent to itself; otherwise it relates none to itself.
    const REFLEXIVE: bool = false;

    /// Whether the predicate holds for all agents in [`Relation::reach`], so that no test is needed.
    const FILLS_REACH: bool = false;

    /// Returns where the second agent can be, relative to a first agent of this kind and heading; by default as
    /// [`Relation::reach_back`].
    #[inline]
    fn reach(&self, _views: &Views, _kind: AgentKind, _heading: Option<Heading>) -> Reach {
        self.reach_back()
    }

    /// Returns where the first agent can be, relative to any second agent.
    #[inline]
    fn reach_back(&self) -> Reach {
        Reach::Anywhere
    }

    /// Returns whether the predicate holds for two different agents, given that the second is in reach of the first.
    fn test(&self, x: &Subject, y: &Subject, draw: impl FnOnce(f64) -> bool) -> bool;

    /// Returns whether the predicate holds for two different agents.
    #[inline]
    fn holds(&self, views: &Views, x: &Subject, y: &Subject, draw: impl FnOnce(f64) -> bool) -> bool {
        let field = self.reach(views, x.kind, x.heading).around(x.at);
        field.is_some_and(|field| field.contains(y.at)) && (Self::FILLS_REACH || self.test(x, y, draw))
    }

    /// Sets the bit `y` of `rows[x]` for each related `x` and `y`, for up to 64 agents. `draw` takes the positions of
    /// both. A kind may override this with a faster loop.
    #[inline]
    fn relate(
        &self,
        views: &Views,
        subjects: impl Iterator<Item = Subject> + Clone,
        draw: impl Fn(usize, usize, f64) -> bool,
        rows: &mut [u64],
    ) {
        for (first, (x, row)) in subjects.clone().zip(rows).enumerate() {
            let Some(field) = self.reach(views, x.kind, x.heading).around(x.at) else {
                continue;
            };
            for (second, y) in subjects.clone().enumerate() {
                let holds = field.contains(y.at)
                    && match first == second {
                        true => Self::REFLEXIVE,
                        false => Self::FILLS_REACH || self.test(&x, &y, |probability| draw(first, second, probability)),
                    };
                *row |= u64::from(holds) << second;
            }
        }
    }
}

/// The cells around an agent that a relation reaches.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Reach {
    Nowhere,
    /// At most this many cells up, down, left and right.
    Within([i32; 4]),
    Anywhere,
}

impl Reach {
    /// An upper bound of the distance between two cells of a map.
    pub const FARTHEST: i32 = 1 << 24;

    /// Returns the cells in reach of a cell.
    #[inline]
    fn around(self, cell: Cell) -> Option<FieldOfView> {
        match self {
            Reach::Nowhere => None,
            Reach::Within(cells) => Some(FieldOfView::around(cell, cells)),
            Reach::Anywhere => Some(FieldOfView {
                first: Cell::new(i32::MIN, i32::MIN),
                last: Cell::new(i32::MAX, i32::MAX),
            }),
        }
    }

    /// Returns whether the reach lies in a rectangle around the same cell.
    fn is_within(self, rectangle: [i32; 4]) -> bool {
        match self {
            Reach::Nowhere => true,
            Reach::Within(cells) => cells.iter().zip(rectangle).all(|(cells, limit)| *cells <= limit),
            Reach::Anywhere => false,
        }
    }
}

/// A local predicate as a table: one bit per kind of agent and [`Junction`].
#[derive(Clone, Copy, Debug)]
pub(crate) struct CellTable(u16);

impl CellTable {
    fn new(predicate: &impl LocalKind) -> CellTable {
        let entries = AgentKind::ALL.map(|kind| Junction::ALL.map(|junction| (kind, junction)));
        let holds = |&&(kind, junction): &&(AgentKind, Junction)| predicate.holds_on(junction, kind);
        let bits = entries.as_flattened().iter().filter(holds);
        CellTable(bits.fold(0, |table, &(kind, junction)| {
            table | 1 << CellTable::place(junction, kind)
        }))
    }

    #[inline]
    fn place(junction: Junction, kind: AgentKind) -> usize {
        kind as usize * Junction::ALL.len() + junction.index()
    }

    /// Returns whether the predicate holds for agents of this kind on cells with this junction.
    #[inline]
    pub fn holds(self, junction: Junction, kind: AgentKind) -> bool {
        self.0 >> CellTable::place(junction, kind) & 1 != 0
    }
}

/// Defines the types that list all kinds, and their dispatch. The first argument is a `$`, for the macros that this
/// macro defines.
macro_rules! kinds {
    (
        $d:tt
        Static { $($(#[$static_doc:meta])* $static:ident,)* }
        Local { $($(#[$local_doc:meta])* $local:ident,)* }
        Place { $($(#[$place_doc:meta])* $place:ident,)* }
        Pair { $($(#[$pair_doc:meta])* $pair:ident,)* }
    ) => {
        /// A predicate that depends on an agent's kind and concepts.
        #[derive(Clone, Debug, PartialEq)]
        pub enum Static { $($(#[$static_doc])* $static($static),)* }

        /// A predicate that depends on an agent's kind and on the relation of its cell to intersections.
        #[derive(Clone, Debug, PartialEq)]
        pub enum Local { $($(#[$local_doc])* $local($local),)* }

        /// A predicate that depends on an agent's cell.
        #[derive(Clone, Debug, PartialEq)]
        pub enum Place { $($(#[$place_doc])* $place($place),)* }

        /// A predicate over two agents.
        #[derive(Clone, Debug, PartialEq)]
        pub enum Pair { $($(#[$pair_doc])* $pair($pair),)* }

        /// The fast form of a [`Pair`].
        #[derive(Clone, Debug)]
        pub(crate) enum PairRelation { $($pair(<$pair as PairKind>::Relation),)* }

        /// `with_pair!(pair, kind => f(kind))` evaluates an expression with the [`PairKind`] of a [`Pair`].
        macro_rules! with_pair {
            ($d pair:expr, $d kind:ident => $d work:expr) => {
                match $d pair { $($crate::predicate::Pair::$pair($d kind) => $d work,)* }
            };
        }

        /// `with_relation!(any, relation => f(relation))` evaluates an expression with the [`Relation`] of a
        /// [`PairRelation`].
        macro_rules! with_relation {
            ($d relation:expr, $d kind:ident => $d work:expr) => {
                match $d relation { $($crate::predicate::PairRelation::$pair($d kind) => $d work,)* }
            };
        }

        impl Static {
            /// Returns whether the predicate holds for agents of this kind with these concepts.
            pub(crate) fn holds(&self, kind: AgentKind, concepts: &[String]) -> bool {
                match self { $(Static::$static(predicate) => predicate.holds(kind, concepts),)* }
            }
        }

        impl Local {
            /// Returns whether the predicate holds for an agent of this kind on this cell.
            pub(crate) fn holds(&self, map: &CityMap, kind: AgentKind, at: Cell) -> bool {
                match self { $(Local::$local(predicate) => predicate.holds(map, kind, at),)* }
            }

            /// Returns the fast form.
            pub(crate) fn table(&self) -> CellTable {
                match self { $(Local::$local(predicate) => CellTable::new(predicate),)* }
            }
        }

        impl Place {
            /// Returns whether the predicate holds for an agent on this cell.
            pub(crate) fn holds(&self, map: &CityMap, at: Cell) -> bool {
                match self { $(Place::$place(predicate) => predicate.holds(map, at),)* }
            }

            /// Returns the fast form.
            pub(crate) fn area(&self, map: &CityMap) -> Arc<Area> {
                match self { $(Place::$place(predicate) => predicate.area(map),)* }
            }
        }

        impl Pair {
            /// Returns the fast form for a map.
            pub(crate) fn relation(&self, map: &Arc<CityMap>) -> PairRelation {
                match self { $(Pair::$pair(predicate) => PairRelation::$pair(predicate.relation(map)),)* }
            }

            /// Returns whether the predicate relates every agent to itself; otherwise it relates none to itself.
            pub(crate) fn is_reflexive(&self) -> bool {
                match self { $(Pair::$pair(_) => <$pair as PairKind>::Relation::REFLEXIVE,)* }
            }

            fn is_drawn(&self) -> bool {
                match self { $(Pair::$pair(_) => <$pair as PairKind>::DRAWN,)* }
            }

            /// Returns whether the predicate depends on kind or heading of the first, and of the second agent.
            fn reads(&self) -> [bool; 2] {
                match self { $(Pair::$pair(_) => <$pair as PairKind>::READS,)* }
            }

            /// Returns a distance in cells beyond which only the signs of the offsets matter.
            fn horizon(&self, half_width: u32) -> f64 {
                match self { $(Pair::$pair(predicate) => predicate.horizon(half_width),)* }
            }
        }

        impl Serialize for Definition {
            fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
                match self {
                    $(Definition::Static(Static::$static(it)) => tagged(serializer, stringify!($static), it),)*
                    $(Definition::Local(Local::$local(it)) => tagged(serializer, stringify!($local), it),)*
                    $(Definition::Place(Place::$place(it)) => tagged(serializer, stringify!($place), it),)*
                    $(Definition::Pair(Pair::$pair(it)) => tagged(serializer, stringify!($pair), it),)*
                    Definition::Quantity(it) => tagged(serializer, "Quantity", it),
                    Definition::External(it) => tagged(serializer, "External", it),
                }
            }
        }

        $(impl From<$static> for Definition {
            fn from(predicate: $static) -> Definition { Definition::Static(Static::$static(predicate)) }
        })*
        $(impl From<$local> for Definition {
            fn from(predicate: $local) -> Definition { Definition::Local(Local::$local(predicate)) }
        })*
        $(impl From<$place> for Definition {
            fn from(predicate: $place) -> Definition { Definition::Place(Place::$place(predicate)) }
        })*
        $(impl From<$pair> for Definition {
            fn from(predicate: $pair) -> Definition { Definition::Pair(Pair::$pair(predicate)) }
        })*

        impl From<Quantity> for Definition {
            fn from(predicate: Quantity) -> Definition { Definition::Quantity(predicate) }
        }

        impl From<External> for Definition {
            fn from(predicate: External) -> Definition { Definition::External(predicate) }
        }

        impl Definition {
    /// Returns whether the predicate may relate an agent to itself, apart from `Sees`.
    pub(crate) fn may_be_reflexive(&self) -> bool {
        matches!(self, Definition::External(_))
    }

            /// Returns the words of the predicate in an English sentence.
            pub fn phrase(&self) -> Phrase {
                match self {
                    $(Definition::Static(Static::$static(predicate)) => predicate.phrase(),)*
                    $(Definition::Local(Local::$local(predicate)) => predicate.phrase(),)*
                    $(Definition::Place(Place::$place(predicate)) => predicate.phrase(),)*
                    $(Definition::Pair(Pair::$pair(predicate)) => predicate.phrase(),)*
                    Definition::Quantity(predicate) => predicate.phrase(),
                    Definition::External(predicate) => predicate.phrase(),
                }
            }
        }

        /// Returns predicates of all kinds.
        #[cfg(test)]
        fn samples() -> Vec<Vec<Definition>> {
            vec![
                $($static::samples(),)* $($local::samples(),)* $($place::samples(),)* $($pair::samples(),)*
                Quantity::samples(), External::samples(),
            ]
        }

        /// The syntax of all kinds.
        const SYNTAX: &[Syntax] = &[
            $($static::SYNTAX,)* $($local::SYNTAX,)* $($place::SYNTAX,)* $($pair::SYNTAX,)* Quantity::SYNTAX,
            External::SYNTAX,
        ];
    };
}

kinds! { $
    Static {
        /// The agent is of a kind.
        Kind,
        /// The agent is of a kind and carries a concept.
        Concept,
    }
    Local {
        /// A car is on an entrance line or a pedestrian on an outline of an intersection.
        AtIntersection,
        /// The agent is inside an intersection.
        InIntersection,
    }
    Place {
        /// The agent is in a zone of the map.
        Zone,
        /// The agent is near a building of a kind.
        Near,
        /// The agent is on a lane for cars, on a sidewalk or on a crossing.
        OnLane,
        /// The agent is on a lane with a sign at its end.
        OnLaneWithSign,
        /// The agent is on a lane with another beside it.
        LaneBeside,
    }
    Pair {
        /// The Euclidean distance is within bounds.
        Distance,
        /// The first has the smaller priority number.
        HigherPriority,
        /// The first lies left of the second, seen along the second's heading.
        LeftOf,
        /// The first lies right of the second, seen along the second's heading.
        RightOf,
        /// The first is about to run into the second.
        Colliding,
        /// Both are at or in the same intersection.
        SameIntersection,
        /// The second is ahead of the first on its lane.
        Ahead,
        /// The second is on the lane beside that of the first.
        Beside,
        /// The lane of the first must yield to that of the second.
        Yields,
        /// The second is in the field of view of the first.
        Sees,
    }
}
pub(crate) use {with_pair, with_relation};

/// The computation of a base predicate from the state of the city.
///
/// It serializes as the name of the kind, with its parameters if it has any.
#[derive(Clone, Debug, PartialEq)]
pub enum Definition {
    /// Computed from the agent's kind and concepts.
    Static(Static),
    /// Computed from the agent's kind and the relation of its cell to intersections.
    Local(Local),
    /// Computed from the agent's cell.
    Place(Place),
    /// Computed from two agents.
    Pair(Pair),
    /// A value of agents or of the city.
    Quantity(Quantity),
    /// Computed by a function of the caller.
    External(External),
}

impl Definition {
    /// Returns the number of agents that the predicate relates.
    pub fn arity(&self) -> usize {
        match self {
            Definition::Static(_) | Definition::Local(_) | Definition::Place(_) => 1,
            Definition::Pair(_) => 2,
            Definition::Quantity(quantity) => quantity.agents(),
            Definition::External(external) => external.agents(),
        }
    }

    /// Returns the type of the value in the last column, after the agents, if the predicate has one.
    pub fn unit(&self) -> Option<Unit> {
        match self {
            Definition::Quantity(quantity) => Some(quantity.unit()),
            _ => None,
        }
    }

    /// Returns whether only a road network can have rows of the predicate.
    pub(crate) const fn needs_roads(&self) -> bool {
        matches!(
            self,
            Definition::Pair(Pair::Yields(_))
                | Definition::Quantity(Quantity::Limit | Quantity::Light | Quantity::RightOfWay | Quantity::Clearance)
        )
    }

    /// Returns the values from which the predicate is computed, in words.
    pub fn inputs(&self) -> &'static str {
        match self {
            Definition::Static(_) => "the kind and the concepts of the agent",
            Definition::Local(_) => "the kind and the cell of the agent",
            Definition::Place(_) => "the cell of the agent",
            Definition::Pair(Pair::HigherPriority(_)) => "the priorities of both agents",
            Definition::Pair(Pair::Sees(_)) => "the cells of both agents and the field of view",
            Definition::Pair(_) if self.is_drawn() => {
                "the cells and headings of both agents, and a random draw of the tick"
            }
            Definition::Pair(_) => "the cells and headings of both agents",
            Definition::Quantity(quantity) => match quantity.agents() {
                0 => "the state of the city",
                1 => "the state of the agent",
                _ => "the state of both agents",
            },
            Definition::External(_) => "the state of the city by a function of the caller",
        }
    }

    /// Returns whether a trace must record the predicate, since cells, headings and priorities do not determine it.
    pub(crate) fn is_recorded(&self) -> bool {
        match self {
            Definition::Quantity(quantity) => !quantity.is_visible(),
            Definition::External(_) => true,
            _ => self.is_drawn(),
        }
    }

    /// Returns whether a function of the caller computes the predicate.
    pub fn is_external(&self) -> bool {
        matches!(self, Definition::External(_))
    }

    /// Returns whether the predicate relates every agent to itself.
    pub(crate) fn is_reflexive(&self) -> bool {
        matches!(self, Definition::Pair(pair) if pair.is_reflexive())
    }

    /// Returns whether the predicate holds for agents of a kind with these concepts, wherever they are; `None` if that
    /// depends on more.
    pub(crate) fn holds_always(&self, kind: AgentKind, concepts: &[String]) -> Option<bool> {
        match self {
            Definition::Static(predicate) => Some(predicate.holds(kind, concepts)),
            _ => None,
        }
    }

    /// Returns whether the predicate depends only on kind and concepts, not on positions.
    pub fn is_static(&self) -> bool {
        matches!(self, Definition::Static(_))
    }

    /// Returns whether the predicate announces that the first agent runs into the second.
    pub fn is_collision(&self) -> bool {
        matches!(self, Definition::Pair(Pair::Colliding(_)))
    }

    /// Returns whether the predicate orders agents by their priorities.
    pub(crate) fn is_ranking(&self) -> bool {
        matches!(self, Definition::Pair(Pair::HigherPriority(_)))
    }

    /// Returns whether the predicate holds with a probability.
    pub fn is_drawn(&self) -> bool {
        matches!(self, Definition::Pair(pair) if pair.is_drawn())
    }

    /// Parses a definition in a configuration.
    pub(crate) fn read(node: &YamlNode, faults: &mut Vec<Diagnostic>) -> Option<Definition> {
        if matches!(node.value, Value::Scalar { .. }) {
            let words = SYNTAX.iter().filter_map(|syntax| match syntax {
                Syntax::Word(word, definition) => Some((*word, *definition)),
                Syntax::Keys(..) | Syntax::Always => None,
            });
            return choice(node, &words.collect::<Vec<_>>(), faults).map(|definition| definition());
        }
        let mappings = SYNTAX.iter().filter_map(|syntax| match syntax {
            Syntax::Keys(keys, read) => Some((*keys, *read)),
            Syntax::Word(..) | Syntax::Always => None,
        });
        let before = faults.len();
        let mut fields = Fields::open(node, "the definition of a predicate", faults)?;
        let further_keys = mappings.clone().flat_map(|(keys, _)| &keys[1..]);
        let keys = mappings.clone().map(|(keys, _)| &keys[0]).chain(further_keys);
        let given: Vec<(&str, &YamlNode)> = keys.filter_map(|key| Some((*key, fields.optional(*key)?))).collect();
        // The reader of configurations reads the looks of a concept.
        let picture = fields.optional("picture");
        fields.close(faults);
        if let Some(picture) = picture.filter(|_| !given.iter().any(|(key, _)| *key == "concept")) {
            let message = "only a concept has a `picture`";
            let fault = Diagnostic::new(codes::INVALID_VALUE, message).at(picture.span, "");
            faults.push(fault.help("remove it; the picture of a kind stands under `kinds`"));
        }
        let value = |key: &&str| Some(given.iter().find(|(given, _)| given == key)?.1);
        let found = mappings.clone().find_map(|(keys, read)| {
            let nodes: Vec<&YamlNode> = keys.iter().map(value).collect::<Option<_>>()?;
            (nodes.len() == given.len()).then_some((nodes, read))
        });
        if faults.len() > before {
            explain_unknown_keys(node, &mut faults[before..]);
            return None;
        }
        if let Some((nodes, read)) = found {
            return read(&nodes, faults);
        }
        if node.partial {
            return None;
        }
        // The keys of one kind, some of them missing.
        let names: Vec<&str> = given.iter().map(|(key, _)| *key).collect();
        let is_part = |keys: &[&str]| !names.is_empty() && names.iter().all(|name| keys.contains(name));
        if let Some((keys, _)) = mappings.clone().find(|(keys, _)| is_part(keys)) {
            let missing = keys
                .iter()
                .find(|key| !names.contains(key))
                .copied()
                .unwrap_or_default();
            let message = format!("`{}` needs the key `{missing}`, too", names.join("` with `"));
            let fault = Diagnostic::new(codes::MISSING_KEY, message).at(node.span, "");
            faults.push(fault.help(match missing {
                "near" | "within" => {
                    let number = number_of(given[0].1).unwrap_or("8");
                    format!(
                        "write `{{near: Store, within: {number}}}` for the surroundings of buildings, and \
                         `{{distance: {{at_most: {number}}}}}` for those of another agent"
                    )
                }
                _ => "name the concept and who can have it: `{concept: taxi, of: Car}` or `of: Pedestrian`".to_owned(),
            }));
            return None;
        }
        let forms: Vec<String> = mappings
            .map(|(keys, _)| format!("`{}`", keys.join("` with `")))
            .collect();
        let found = match names.as_slice() {
            [] => "none".to_owned(),
            names => format!("`{}`", names.join("`, `")),
        };
        let message = format!("expected exactly one of {}, found {found}", forms.join(", "));
        let fault = Diagnostic::new(codes::INVALID_VALUE, message).at(node.span, "");
        faults.push(fault.note("keys inherited through `base` count; `key: ~` removes one"));
        None
    }
}

/// Returns the text of a number.
fn number_of(node: &YamlNode) -> Option<&str> {
    match &node.value {
        Value::Scalar { text, plain: true } if text.parse::<f64>().is_ok() => Some(text),
        _ => None,
    }
}

/// Words that users write for a bound of the distance from above, and from below.
const NEAR: [&str; 6] = ["close", "radius", "range", "max", "at_most", "below"];
const FAR: [&str; 5] = ["far", "beyond", "min", "at_least", "above"];

/// Adds help to the faults of unknown keys in a definition.
fn explain_unknown_keys(node: &YamlNode, faults: &mut [Diagnostic]) {
    let Value::Map(entries) = &node.value else { return };
    for fault in faults {
        let place = fault.primary.as_ref().map(|label| label.span);
        let Some((key, value)) = entries.iter().find(|(key, _)| Some(key.span) == place) else {
            continue;
        };
        let number = number_of(value).unwrap_or("12");
        let bound = match key.text.to_lowercase().as_str() {
            word if NEAR.contains(&word) => "at_most",
            word if FAR.contains(&word) => "above",
            _ => continue,
        };
        fault.help = vec![format!("a distance is written `{{distance: {{{bound}: {number}}}}}`")];
        fault.fixes.clear();
    }
}

/// Serializes a kind. A kind without parameters is written as its name.
fn tagged<S: Serializer, K: Serialize>(serializer: S, name: &'static str, kind: &K) -> Result<S::Ok, S::Error> {
    match size_of::<K>() {
        0 => serializer.serialize_unit_variant("Definition", 0, name),
        _ => serializer.serialize_newtype_variant("Definition", 0, name, kind),
    }
}

/// Returns all headings of an agent: none, then each.
pub(crate) fn headings() -> [Option<Heading>; 5] {
    let [left, right, up, down] = Heading::ALL.map(Some);
    [None, left, right, up, down]
}

impl PairRelation {
    /// Returns [`Relation::reach`].
    pub fn reach(&self, views: &Views, kind: AgentKind, heading: Option<Heading>) -> Reach {
        with_relation!(self, relation => relation.reach(views, kind, heading))
    }

    /// Returns [`Relation::reach_back`].
    pub fn reach_back(&self) -> Reach {
        with_relation!(self, relation => relation.reach_back())
    }

    /// Returns [`Relation::FILLS_REACH`].
    pub fn fills_reach(&self) -> bool {
        fn of<R: Relation>(_: &R) -> bool {
            R::FILLS_REACH
        }
        with_relation!(self, relation => of(relation))
    }

    /// Returns whether the first agent sees the second wherever the predicate holds.
    pub fn is_in_view(&self, views: &Views) -> bool {
        AgentKind::ALL.into_iter().all(|kind| {
            headings()
                .into_iter()
                .all(|heading| self.reach(views, kind, heading).is_within(views.of(heading)))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::builtin::BuiltinFiles;
    use crate::config::load_map;
    use crate::diag::Sources;
    use crate::files::ReadFile;
    use crate::rng::{Purpose, RngExt, Seed};
    use std::collections::BTreeSet;
    use std::ops::Range;
    use std::path::Path;

    /// The map of the paper with the zones that samples use, and a road network; with the rows and columns of the cells
    /// around an intersection.
    fn maps() -> [(Arc<CityMap>, [Range<i32>; 2]); 3] {
        let files = |path: &Path| match path.to_str() {
            Some("zones.yaml") => Ok(ZONES.to_owned()),
            Some("avenue.yaml") => Ok(AVENUE.to_owned()),
            _ => BuiltinFiles.read(path),
        };
        let map = |path| {
            let config = load_map(&mut Sources::new(), Path::new(path), &files).expect("a valid file");
            Arc::new(CityMap::generate(&config).expect("a valid map"))
        };
        [
            (map("zones.yaml"), [36..48, 36..48]),
            (map("roundabout"), [84..102, 112..130]),
            (map("avenue.yaml"), [0..12, 20..40]),
        ]
    }

    const AVENUE: &str = "
roads:
  cell: 1
  size: [12, 60]
  junctions: [east]
  lanes:
    - right drive to=east left=middle width=3 2,9 57,9
    - middle drive to=east left=left width=3 2,6 57,6
    - left drive to=east width=3 2,3 57,3
  connections: []
";

    const ZONES: &str = "base: square-5x5
zones:
  school: [{near: Office, within: 8, sample: 2}, {rows: [3, 90], cols: [200, 240]}]
  center: [{block: [3, 3], within: 11}, {horizontal_street: 2}]
";

    /// A deterministic draw that succeeds for about half of all pairs.
    fn happens(first: usize, second: usize) -> bool {
        (first * 3 + second * 5 + first * second).is_multiple_of(2)
    }

    /// Compares the fast form with the definition for all pairs of random agents on these rows and columns. Returns the
    /// numbers of pairs for which the predicate does not hold and for which it does.
    fn compare<K: PairKind>(kind: &K, map: &Arc<CityMap>, [rows_near, cols_near]: &[Range<i32>; 2]) -> [u32; 2] {
        let (half_width, relation) = (6, kind.relation(map));
        let (sight, views) = (Sight { map, half_width }, Views::new(half_width));
        let mut random = Seed(1).stream(Purpose::TEST, 0, 0);
        let mut counts = [0; 2];
        for _ in 0..400 {
            let agent = |_| Subject {
                kind: AgentKind::ALL[random.random_range(0..2)],
                priority: random.random_range(0..4),
                at: Cell::new(
                    random.random_range(rows_near.clone()),
                    random.random_range(cols_near.clone()),
                ),
                heading: (Heading::ALL.get(random.random_range(0..5))).copied(),
            };
            let agents: Vec<Subject> = (0..9).map(agent).collect();
            let draw = |first, second, probability| {
                assert!(K::DRAWN, "it draws");
                probability >= 1.0 || probability > 0.0 && happens(first, second)
            };
            let mut rows = vec![0; agents.len()];
            relation.relate(&views, agents.iter().copied(), draw, &mut rows);
            for (first, x) in agents.iter().enumerate() {
                for (second, y) in agents.iter().enumerate() {
                    let draw = |probability| draw(first, second, probability);
                    let holds = match first == second {
                        true => K::Relation::REFLEXIVE,
                        false => kind.holds(sight, x, y, draw),
                    };
                    assert_eq!(rows[first] >> second & 1 != 0, holds, "{x:?} {y:?}");
                    if first != second {
                        assert_eq!(relation.holds(&views, x, y, draw), holds, "{x:?} {y:?}");
                        let back = relation.reach_back().around(y.at);
                        assert!(!holds || back.is_some_and(|field| field.contains(x.at)), "{x:?} {y:?}");
                        counts[usize::from(holds)] += 1;
                    }
                }
            }
        }
        counts
    }

    #[test]
    fn fast_forms_agree_with_the_definitions() {
        let maps = maps();
        for definition in samples().concat() {
            let mut counts = [0; 2];
            for (map, near) in &maps {
                match &definition {
                    // The definition is the only form.
                    Definition::Static(_) | Definition::Quantity(_) | Definition::External(_) => counts = [u32::MAX; 2],
                    Definition::Local(predicate) => {
                        let table = predicate.table();
                        for cell in (0..map.rows()).flat_map(|row| (0..map.cols()).map(move |col| Cell::new(row, col)))
                        {
                            for kind in AgentKind::ALL {
                                let holds = predicate.holds(map, kind, cell);
                                assert_eq!(
                                    table.holds(map.junction(cell), kind),
                                    holds,
                                    "{predicate:?} {kind:?} {cell:?}"
                                );
                                counts[usize::from(holds)] += 1;
                            }
                        }
                    }
                    Definition::Place(predicate) => {
                        let area = predicate.area(map);
                        let cells =
                            (-1..=map.rows()).flat_map(|row| (-1..=map.cols()).map(move |col| Cell::new(row, col)));
                        for cell in cells {
                            let holds = map.contains(cell) && predicate.holds(map, cell);
                            assert_eq!(area.contains(cell), holds, "{predicate:?} {cell:?}");
                            counts[usize::from(holds)] += 1;
                        }
                    }
                    Definition::Pair(pair) => {
                        let found = with_pair!(pair, kind => compare(kind, map, near));
                        (0..2).for_each(|at| counts[at] += found[at]);
                    }
                }
            }
            assert!(counts.iter().all(|count| *count > 50), "{definition:?} {counts:?}");
        }
    }

    #[test]
    fn kinds_are_serialized_by_name_and_written_in_one_way() {
        let samples = samples();
        let name = |definition: &Definition| match serde_json::to_value(definition).expect("no map with other keys") {
            serde_json::Value::String(name) => name,
            tagged => tagged
                .as_object()
                .expect("name and parameters")
                .keys()
                .next()
                .expect("a name")
                .clone(),
        };
        let names: BTreeSet<String> = samples.iter().flatten().map(name).collect();
        assert_eq!((names.len(), SYNTAX.len()), (samples.len(), samples.len()));
        let written: BTreeSet<&str> = (SYNTAX.iter())
            .map(|syntax| match syntax {
                Syntax::Word(word, _) => *word,
                Syntax::Keys(keys, _) => keys[0],
                Syntax::Always => "",
            })
            .collect();
        assert_eq!(written.len(), SYNTAX.len());
    }
}
