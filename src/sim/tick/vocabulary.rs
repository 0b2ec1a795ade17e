//! The interface between configuration and rules: base predicates and actions of a scenario, bound to a program.
// Decision: docs/decisions/city.md#d003

use crate::city::{Action, ActionTable, KindId};
use crate::config::{ActionsConfig, PredicateConfig, SEES, Scenario};
use crate::datalog::codes;
use crate::datalog::{BaseType, Clause, Literal, Predicate, PredicateId, Rules};
use crate::datalog::{Declaration, Program};
use crate::diag::{Diagnostic, did_you_mean};
use crate::predicate::{Definition, Quantity, Sees, Unit};
use std::ops::{BitOr, Sub};

/// A set of actions.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Actions(u16);

impl Actions {
    /// Returns the number of actions.
    pub fn len(self) -> usize {
        self.0.count_ones() as usize
    }

    /// Returns whether the set is empty.
    pub fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// Returns whether the set contains the action.
    pub fn contains(self, action: Action) -> bool {
        self.0 >> action.index() & 1 != 0
    }

    /// Adds an action.
    pub fn insert(&mut self, action: Action) {
        self.0 |= 1 << action.index();
    }

    /// Returns the actions in the order of the table, the standard ones first.
    pub fn iter(self) -> impl Iterator<Item = Action> {
        (0..Action::MAX)
            .map(Action::at)
            .filter(move |&action| self.contains(action))
    }

    /// Returns one bit per action: bit `i` is the action with index `i`.
    pub(crate) fn bits(self) -> u16 {
        self.0
    }

    /// The inverse of [`Actions::bits`].
    pub(crate) fn from_bits(bits: u16) -> Actions {
        Actions(bits)
    }
}

impl BitOr for Actions {
    type Output = Actions;

    fn bitor(self, other: Actions) -> Actions {
        Actions(self.0 | other.0)
    }
}

impl Sub for Actions {
    type Output = Actions;

    fn sub(self, other: Actions) -> Actions {
        Actions(self.0 & !other.0)
    }
}

impl FromIterator<Action> for Actions {
    fn from_iter<I: IntoIterator<Item = Action>>(actions: I) -> Self {
        let mut set = Actions::default();
        actions.into_iter().for_each(|action| set.insert(action));
        set
    }
}

/// A base predicate.
#[derive(Clone, Debug)]
pub struct BasePredicate {
    /// The name in the rules.
    pub name: String,
    /// The computation of its facts.
    pub definition: Definition,
    /// The number of columns for agents, at most 2. They come first.
    pub arity: usize,
    /// The base type of the last column, if it holds a value.
    pub value: Option<BaseType>,
    /// The id in the program; `None` if the rules do not declare it as input.
    pub id: Option<PredicateId>,
}

impl BasePredicate {
    /// Returns the quantity that the predicate holds, if it holds one.
    pub fn quantity(&self) -> Option<Quantity> {
        match self.definition {
            Definition::Quantity(quantity) => Some(quantity),
            _ => None,
        }
    }

    /// Returns the number of columns.
    pub fn columns(&self) -> usize {
        self.arity + usize::from(self.value.is_some())
    }
}

/// Returns the base type of a column of values.
pub fn base_of(unit: Unit) -> BaseType {
    match unit {
        Unit::Number => BaseType::Number,
        Unit::Float => BaseType::Float,
        Unit::Word(_) => BaseType::Symbol,
    }
}

/// The base predicates and actions of a scenario, bound to a program.
#[derive(Clone, Debug)]
pub struct Vocabulary {
    /// The base predicates in the order of the scenario.
    pub predicates: Vec<BasePredicate>,
    /// The position of `Sees` in `predicates`.
    pub sees: usize,
    /// Whether clauses of the rules have probabilities.
    pub draws: bool,
    /// Whether a predicate says where routes leave intersections.
    pub has_exits: bool,
    /// The actions of the scenario.
    table: ActionTable,
    /// The predicate of each action, in the order of the table; `None` if the rules do not declare it.
    actions: Vec<Option<PredicateId>>,
    /// For each kind of agents, the action to take, indexed by the bits of the derived actions.
    decisions: Vec<Box<[Action]>>,
    /// Those of an entity whose kind is unknown.
    unknown: Box<[Action]>,
    default: Action,
    /// For each default clause, the actions that it negates.
    default_clauses: Box<[Actions]>,
}

impl Vocabulary {
    /// Binds the predicates of a scenario to the predicates of a program.
    ///
    /// # Errors
    /// `rule-mismatch` if the configuration lacks an input that a rule reads, a predicate has another number of columns
    /// or a column of another type, a predicate is declared but not as input, or the rules declare no action.
    pub fn bind(scenario: &Scenario, program: &Program) -> Result<Vocabulary, Vec<Diagnostic>> {
        let rules = program.rules();
        let mut faults = Vec::new();
        let mut predicates = Vec::new();
        for PredicateConfig { name, definition } in &scenario.predicates {
            let (arity, value) = (definition.arity(), definition.unit().map(base_of));
            let id = program.predicate(&name.value).filter(|&id| {
                let declared = &rules.predicates[id.index()];
                declared.input
                    && fits(declared, arity, value, &mut faults, || {
                        Diagnostic::new(codes::RULE_MISMATCH, mismatch(&name.value, true))
                            .also(name.span, "defined here")
                    })
            });
            predicates.push(BasePredicate {
                name: name.value.clone(),
                definition: definition.clone(),
                arity,
                value,
                id,
            });
        }
        let sees = predicates
            .iter()
            .position(|predicate| predicate.definition == Sees.into())
            .expect("every scenario defines the field of view");

        faults.extend(undefined(scenario, &unknown_inputs(program, &predicates), &predicates));
        faults.extend(unfilled(scenario, program));
        faults.extend(unremembered(program));

        let table = &scenario.actions.table;
        let bound = |name| {
            program.predicate(name).filter(|&id| {
                fits(&rules.predicates[id.index()], 1, None, &mut faults, || {
                    Diagnostic::new(codes::RULE_MISMATCH, mismatch(name, false))
                })
            })
        };
        let actions: Vec<Option<PredicateId>> = table.names().map(bound).collect();
        if faults.is_empty() && actions.iter().all(Option::is_none) {
            let names: Vec<&str> = table.names().collect();
            let message = format!("the rules have none of the actions {}", names.join(", "));
            faults.push(
                Diagnostic::new(codes::RULE_MISMATCH, message)
                    .at(scenario.rules.span, "these rules")
                    .help("begin the file with `.include \"vocabulary.dl\"`, which declares them"),
            );
        }
        if faults.is_empty() {
            let mut vocabulary = Vocabulary {
                predicates,
                sees,
                draws: rules.chance.is_some(),
                has_exits: (scenario.predicates.iter()).any(|predicate| match predicate.definition {
                    Definition::Quantity(quantity) => quantity.reads_exit(),
                    _ => false,
                }),
                table: table.clone(),
                actions,
                decisions: (scenario
                    .kinds
                    .all()
                    .map(|kind| decisions(&scenario.actions, Some(kind))))
                .collect(),
                unknown: decisions(&scenario.actions, None),
                default: scenario.actions.default,
                default_clauses: Box::default(),
            };
            vocabulary.default_clauses = vocabulary.negated_by_default(rules);
            Ok(vocabulary)
        } else {
            Err(faults)
        }
    }

    /// Returns whether the rules declare the predicate at this position as input.
    pub fn is_read(&self, predicate: usize) -> bool {
        self.predicates[predicate].id.is_some()
    }

    /// Checks that the rules read no quantities. `what` holds facts without values, in the plural.
    ///
    /// # Errors
    /// `rule-mismatch` if they do.
    pub fn without_quantities(&self, what: &str) -> Result<(), Diagnostic> {
        let read = self
            .predicates
            .iter()
            .find(|known| known.id.is_some() && known.value.is_some());
        read.map_or(Ok(()), |known| {
            let message = format!(
                "{what} contain no quantities, but the rules declare `{}` as input",
                known.name
            );
            Err(Diagnostic::new(codes::RULE_MISMATCH, message).help("use rules without quantities here"))
        })
    }

    /// Checks that the configuration defines no actions. `what` knows the standard actions only, in the plural.
    ///
    /// # Errors
    /// `rule-mismatch` if it defines one.
    pub fn only_standard_actions(&self, what: &str) -> Result<(), Diagnostic> {
        self.table.own().first().map_or(Ok(()), |own| {
            let message = format!("{what} have the four standard actions only, not `{}`", own.name.value);
            let fault = Diagnostic::new(codes::RULE_MISMATCH, message).at(own.name.span, "defined here");
            Err(fault.help("use a configuration without `actions.define`"))
        })
    }

    /// Returns whether the facts of a predicate are known: the configuration defines it, or it is not an input.
    pub fn defines(&self, program: &Program, predicate: PredicateId) -> bool {
        let mut defined = self.predicates.iter().filter_map(|base| base.id);
        !program.rules().predicates[predicate.index()].input || defined.any(|one| one == predicate)
    }

    /// Returns the actions of the scenario.
    pub fn actions(&self) -> &ActionTable {
        &self.table
    }

    /// Returns the predicate of an action, if the rules declare it.
    pub fn action(&self, action: Action) -> Option<PredicateId> {
        self.actions[action.index()]
    }

    /// Returns the action that a predicate represents.
    pub fn action_of(&self, predicate: PredicateId) -> Option<Action> {
        self.table.all().find(|&action| self.action(action) == Some(predicate))
    }

    /// Returns the action that an agent of a kind takes: of the derived ones that it can take, that of highest
    /// priority, otherwise the default of the scenario. An entity of unknown kind can take all actions.
    pub fn decide(&self, kind: Option<KindId>, derived: Actions) -> Action {
        let decisions = kind.map_or(&self.unknown, |kind| &self.decisions[kind.index()]);
        decisions[usize::from(derived.bits())]
    }

    /// Returns the default action, taken if none is derived.
    pub fn default_action(&self) -> Action {
        self.default
    }

    /// Returns the derived actions of an agent without the default, if a default clause derived that: it is the only
    /// action, or all others are unknown to the clause. It stays if it precedes them, because the agent then takes it.
    #[inline]
    pub fn before_default(&self, kind: Option<KindId>, derived: Actions) -> Actions {
        let default: Actions = [self.default].into_iter().collect();
        if derived == default {
            return Actions::default();
        }
        if self.table.own().is_empty() || !derived.contains(self.default) {
            return derived;
        }
        let others = derived - default;
        let fires = |negated: &Actions| *negated - others == *negated;
        let by_default = self.default_clauses.iter().any(fires);
        match by_default && self.decide(kind, others) == self.decide(kind, derived) {
            true => others,
            false => derived,
        }
    }

    /// Returns whether a clause derives the default action as the default: it has a body, which reads only other
    /// actions, negated, and the agent itself.
    pub fn is_default_clause(&self, clause: &Clause) -> bool {
        let sees = self.predicates[self.sees].id;
        self.action_of(clause.head.predicate) == Some(self.default)
            && !clause.body.is_empty()
            && clause.body.iter().all(|literal| match literal {
                Literal::Negative(atom) => self.action_of(atom.predicate).is_some() && atom.terms == clause.head.terms,
                Literal::Positive(atom) | Literal::Guard(atom) => {
                    Some(atom.predicate) == sees
                        && atom.terms.iter().all(|term| Some(term) == clause.head.terms.first())
                }
                _ => false,
            })
    }

    /// Returns the actions that each default clause negates.
    fn negated_by_default(&self, rules: &Rules) -> Box<[Actions]> {
        let clauses = rules.clauses.iter().filter(|clause| self.is_default_clause(clause));
        let negated = clauses.map(|clause| {
            let negated = clause.body.iter().filter_map(|literal| match literal {
                Literal::Negative(atom) => self.action_of(atom.predicate),
                _ => None,
            });
            negated.collect()
        });
        negated.collect()
    }
}

fn decisions(config: &ActionsConfig, kind: Option<KindId>) -> Box<[Action]> {
    let usual = (config.priority.as_slice(), config.default);
    let (priority, default) = kind.map_or(usual, |kind| config.order(kind));
    let decide = |bits| {
        let derived = Actions(bits);
        let can_take =
            |action: &Action| derived.contains(*action) && kind.is_none_or(|kind| config.table.can_take(kind, *action));
        priority.iter().copied().find(can_take).unwrap_or(default)
    };
    let all: Actions = config.table.all().collect();
    (0..=all.bits()).map(decide).collect()
}

/// Returns whether a predicate has `arity` columns of symbols, and then one of the type `value`, if there is one.
/// Otherwise it adds a diagnostic to `faults`.
fn fits(
    predicate: &Predicate,
    arity: usize,
    value: Option<BaseType>,
    faults: &mut Vec<Diagnostic>,
    fault: impl FnOnce() -> Diagnostic,
) -> bool {
    let expected = || std::iter::repeat_n(BaseType::Symbol, arity).chain(value);
    if predicate.columns.iter().map(|column| column.base).eq(expected()) {
        return true;
    }
    faults.push(
        fault()
            .at(predicate.span, format!("declared with {} here", describe(predicate)))
            .help(format!(
                "declare it with `{}`",
                declaration(&predicate.name, arity, value)
            )),
    );
    false
}

/// Returns the declaration of a predicate with `arity` columns for agents, and then one of the type `value`, if there
/// is one.
pub fn declaration(name: &str, arity: usize, value: Option<BaseType>) -> String {
    let agents = ["x: agent", "y: agent"].into_iter().take(arity).map(str::to_owned);
    let value = value.map(|value| match value {
        BaseType::Symbol => "h: symbol".to_owned(),
        value => format!("n: {}", value.name()),
    });
    let columns: Vec<String> = agents.chain(value).collect();
    format!(".decl {name}({})", columns.join(", "))
}

/// Returns a fault for each predicate that rules declare with other columns than the configuration or its actions give
/// it. For rules that do not check: [`Vocabulary::bind`] reports those of checked ones.
pub fn other_declarations(declared: &[Declaration], scenario: &Scenario) -> Vec<Diagnostic> {
    let defined = scenario.predicates.iter().map(|known| {
        let definition = &known.definition;
        let value = definition.unit().map(base_of);
        (
            known.name.value.as_str(),
            definition.arity(),
            value,
            Some(known.name.span),
        )
    });
    let actions = scenario.actions.table.names().map(|name| (name, 1, None, None));
    let known: Vec<_> = defined.chain(actions).collect();
    let fault = |one: &Declaration| {
        let found = known.iter().find(|(name, ..)| *name == one.name);
        // Rules may derive a predicate of their own with the name of one of the configuration.
        let &(name, arity, value, defined) = found.filter(|(.., defined)| one.input || defined.is_none())?;
        let expected = std::iter::repeat_n(BaseType::Symbol, arity).chain(value);
        // A type without a definition has a message of its own.
        let columns: Vec<BaseType> = one.columns.iter().copied().collect::<Option<_>>()?;
        if columns.iter().copied().eq(expected) {
            return None;
        }
        let names: Vec<&str> = columns.iter().map(|column| column.name()).collect();
        let fault = Diagnostic::new(codes::RULE_MISMATCH, mismatch(name, defined.is_some()))
            .at(one.span, format!("declared with ({}) here", names.join(", ")));
        let fault = match defined {
            Some(span) => fault.also(span, "defined here"),
            None => fault,
        };
        Some(fault.help(format!("declare it with `{}`", declaration(name, arity, value))))
    };
    declared.iter().filter_map(fault).collect()
}

/// Returns the message about a declaration that does not fit.
fn mismatch(name: &str, is_defined: bool) -> String {
    match is_defined {
        true => format!("the declaration of `{name}` does not match its definition in the configuration"),
        false => format!("the action `{name}` must be a predicate over one agent"),
    }
}

fn describe(predicate: &Predicate) -> String {
    let columns: Vec<&str> = predicate.columns.iter().map(|column| column.base.name()).collect();
    format!("({})", columns.join(", "))
}

/// Reports the predicates in `unknown`, which rules read: those that the configuration does not define, and those that
/// it defines and does not list under `use`.
fn undefined(scenario: &Scenario, unknown: &[&Predicate], predicates: &[BasePredicate]) -> Vec<Diagnostic> {
    let defined = scenario.composed["predicates"]["define"].as_object();
    let is_defined = |name: &str| defined.is_some_and(|defined| defined.contains_key(name));
    let (unused, unknown): (Vec<&Predicate>, Vec<&Predicate>) =
        unknown.iter().partition(|declared| is_defined(&declared.name));
    let report = |those: &[&Predicate], what: &str| {
        let (first, rest) = those.split_first()?;
        let message = format!(
            "the rules read {}, which the configuration `{}` {what}",
            quoted(those),
            scenario.name
        );
        let fault = Diagnostic::new(codes::RULE_MISMATCH, message).at(first.span, "declared as input here");
        let fault = rest
            .iter()
            .fold(fault, |fault, declared| fault.also(declared.span, "and here"));
        Some(fault.also(scenario.rules.span, "these rules"))
    };
    let mut faults = Vec::new();
    if let Some(mut fault) = report(&unknown, "does not define") {
        for declared in &unknown {
            let alike = predicates.iter().filter(|known| known.columns() == declared.arity());
            if let Some(near) = did_you_mean(&declared.name, alike.map(|known| known.name.as_str())) {
                fault = fault.help(format!("did you mean `{near}` by `{}`?", declared.name));
            }
        }
        faults.push(fault.help(
            "define it in the configuration, for example `predicates: {define: {IsTruck: {concept: truck, of: Car}}}`, or \
             derive it by rules",
        ));
    }
    if let Some(fault) = report(&unused, "defines but does not use") {
        let used = scenario.predicates.iter().map(|known| known.name.value.as_str());
        let all = used
            .filter(|name| *name != SEES)
            .chain(unused.iter().map(|declared| declared.name.as_str()));
        faults.push(fault.help(format!(
            "add {} to `use`: `predicates: {{use: [{}]}}`",
            quoted(&unused),
            all.collect::<Vec<_>>().join(", ")
        )));
    }
    faults
}

/// Returns the names of predicates for a message.
fn quoted(those: &[&Predicate]) -> String {
    let names: Vec<String> = those.iter().map(|declared| format!("`{}`", declared.name)).collect();
    names.join(", ")
}

/// Returns a diagnostic for each predicate that shares a predicate's name but is neither input nor derived.
fn unfilled(scenario: &Scenario, program: &Program) -> Vec<Diagnostic> {
    let rules = program.rules();
    let mut faults = Vec::new();
    for PredicateConfig { name, .. } in &scenario.predicates {
        let Some(predicate) = program.predicate(&name.value) else {
            continue;
        };
        let filled = rules.clauses.iter().any(|clause| clause.head.predicate == predicate);
        let predicate = &rules.predicates[predicate.index()];
        if !predicate.input && !filled {
            let message = format!("`{}` is never filled: it is declared, but not as input", name.value);
            faults.push(
                Diagnostic::new(codes::RULE_MISMATCH, message)
                    .at(predicate.span, "declared here")
                    .also(name.span, "the configuration computes it")
                    .help(format!("write `.input {}` after the declaration", name.value)),
            );
        }
    }
    faults
}

/// Returns a diagnostic for each temporal operator over more than two agents, or over values.
fn unremembered(program: &Program) -> Vec<Diagnostic> {
    let rules = program.rules();
    let hidden = rules.pasts.iter().map(|past| &rules.predicates[past.predicate.index()]);
    let unfit = hidden
        .filter(|hidden| hidden.arity() > 2 || (hidden.columns.iter()).any(|column| column.base != BaseType::Symbol));
    let fault = |hidden: &Predicate| {
        let has_values = hidden.columns.iter().any(|column| column.base != BaseType::Symbol);
        let (message, help) = match has_values {
            true => (
                "in a city, a temporal operator looks back at atoms about at most two agents, not at values",
                "derive a predicate without the value first, for example `Long(X) :- Waited(X, n), n > 5.`, and apply \
                 the operator to that",
            ),
            false => (
                "in a city, a temporal operator relates at most two agents",
                "define a predicate over one or two agents with this body, and apply the operator to that",
            ),
        };
        let types = hidden
            .columns
            .iter()
            .map(|column| rules.types[column.ty.0 as usize].name.as_str());
        let types: Vec<&str> = types.collect();
        let fault = Diagnostic::new(codes::RULE_MISMATCH, message);
        fault
            .at(hidden.span, format!("it relates ({})", types.join(", ")))
            .help(help)
    };
    unfit.map(fault).collect()
}

/// Returns the input predicates that a body reads and the configuration does not define, in declaration order.
fn unknown_inputs<'a>(program: &'a Program, predicates: &[BasePredicate]) -> Vec<&'a Predicate> {
    let rules = program.rules();
    let mut read = vec![false; rules.predicates.len()];
    for clause in &rules.clauses {
        for atom in clause.body.iter().filter_map(Literal::atom) {
            read[atom.predicate.index()] = true;
        }
    }
    rules
        .predicates
        .iter()
        .zip(read)
        .filter(|(declared, read)| *read && declared.input)
        .map(|(declared, _)| declared)
        .filter(|declared| predicates.iter().all(|predicate| predicate.name != declared.name))
        .collect()
}
