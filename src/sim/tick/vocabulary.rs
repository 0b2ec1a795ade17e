//! The interface between configuration and rules: base predicates and actions of a scenario, bound to a program.
// Decision: docs/decisions/city.md#d003

use crate::city::Action;
use crate::config::{ActionsConfig, PredicateConfig, Scenario};
use crate::datalog::Program;
use crate::datalog::codes;
use crate::datalog::{BaseType, Literal, RelId, Relation};
use crate::diag::{Diagnostic, did_you_mean};
use crate::predicate::{Definition, Sees};

/// A set of actions.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Actions(u8);

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
        self.0 >> action as u8 & 1 != 0
    }

    /// Adds an action.
    pub fn insert(&mut self, action: Action) {
        self.0 |= 1 << action as u8;
    }

    /// Returns the actions in the order of [`Action::ALL`].
    pub fn iter(self) -> impl Iterator<Item = Action> {
        Action::ALL.into_iter().filter(move |&action| self.contains(action))
    }

    /// Returns one bit per action: bit `i` is `Action::ALL[i]`.
    pub(crate) fn bits(self) -> u8 {
        self.0
    }

    /// The inverse of [`Actions::bits`].
    pub(crate) fn from_bits(bits: u8) -> Actions {
        Actions(bits & 15)
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
pub struct Predicate {
    /// The name in the rules.
    pub name: String,
    /// The computation of its facts.
    pub definition: Definition,
    /// The number of columns, 1 or 2.
    pub arity: usize,
    /// The relation in the program; `None` if the rules do not declare it as input.
    pub relation: Option<RelId>,
}

/// The base predicates and actions of a scenario, bound to a program.
#[derive(Clone, Debug)]
pub struct Vocabulary {
    /// The base predicates in the order of the scenario.
    pub predicates: Vec<Predicate>,
    /// The position of `Sees` in `predicates`.
    pub sees: usize,
    /// The relation of each action, in the order of [`Action::ALL`]; `None` if the rules do not declare it.
    actions: [Option<RelId>; 4],
    /// The action to take, indexed by the bits of the derived actions.
    decisions: [Action; 16],
    default: Action,
}

impl Vocabulary {
    /// Binds the predicates of a scenario to the relations of a program.
    ///
    /// # Errors
    /// `rule-mismatch` if the configuration lacks an input that a rule reads, a predicate has another number of columns
    /// or a column that is not a symbol, a predicate is declared but not as input, or the rules declare no action.
    pub fn bind(scenario: &Scenario, program: &Program) -> Result<Vocabulary, Vec<Diagnostic>> {
        let rules = program.rules();
        let mut faults = Vec::new();
        let mut predicates = Vec::new();
        for PredicateConfig { name, definition } in &scenario.predicates {
            let arity = definition.arity();
            let relation = program.relation(&name.value).filter(|&relation| {
                let relation = &rules.relations[relation.index()];
                relation.input
                    && fits(relation, arity, &mut faults, || {
                        Diagnostic::new(
                            codes::RULE_MISMATCH,
                            format!(
                                "the declaration of `{}` does not match its definition in the configuration",
                                name.value
                            ),
                        )
                        .also(name.span, "defined here")
                    })
            });
            predicates.push(Predicate {
                name: name.value.clone(),
                definition: definition.clone(),
                arity,
                relation,
            });
        }
        let sees = predicates
            .iter()
            .position(|predicate| predicate.definition == Sees.into())
            .expect("every scenario defines the field of view");

        faults.extend(undefined(scenario, &unknown_inputs(program, &predicates), &predicates));
        faults.extend(unfilled(scenario, program));

        let actions = Action::ALL.map(|action| {
            program.relation(action.name()).filter(|&relation| {
                fits(&rules.relations[relation.index()], 1, &mut faults, || {
                    Diagnostic::new(
                        codes::RULE_MISMATCH,
                        format!("the action `{}` must be a predicate over one agent", action.name()),
                    )
                })
            })
        });
        if faults.is_empty() && actions.iter().all(Option::is_none) {
            faults.push(
                Diagnostic::new(
                    codes::RULE_MISMATCH,
                    "the rules have none of the actions Slow, Normal, Fast, Stop",
                )
                .at(scenario.rules.span, "these rules")
                .help("begin the file with `.include \"vocabulary.dl\"`, which declares them"),
            );
        }
        if faults.is_empty() {
            Ok(Vocabulary {
                predicates,
                sees,
                actions,
                decisions: decisions(&scenario.actions),
                default: scenario.actions.default,
            })
        } else {
            Err(faults)
        }
    }

    /// Returns whether the rules declare the predicate at this position as input.
    pub fn is_read(&self, predicate: usize) -> bool {
        self.predicates[predicate].relation.is_some()
    }

    /// Returns whether the facts of a relation are known: the configuration defines it, or it is not an input.
    pub fn defines(&self, program: &Program, relation: RelId) -> bool {
        let mut defined = self.predicates.iter().filter_map(|predicate| predicate.relation);
        !program.rules().relations[relation.index()].input || defined.any(|one| one == relation)
    }

    /// Returns the relation of an action, if the rules declare it.
    pub fn action(&self, action: Action) -> Option<RelId> {
        self.actions[action as usize]
    }

    /// Returns the action that a relation represents.
    pub fn action_of(&self, relation: RelId) -> Option<Action> {
        (Action::ALL.into_iter()).find(|&action| self.action(action) == Some(relation))
    }

    /// Returns the action to take: the derived one of highest priority, otherwise the default of the scenario.
    pub fn decide(&self, derived: Actions) -> Action {
        self.decisions[usize::from(derived.bits())]
    }

    /// Returns the default action, taken if none is derived.
    pub fn default_action(&self) -> Action {
        self.default
    }

    /// Removes the default action if it is the only one: then the default rule derived it.
    pub fn before_default(&self, derived: Actions) -> Actions {
        match derived == [self.default].into_iter().collect() {
            true => Actions::default(),
            false => derived,
        }
    }
}

fn decisions(config: &ActionsConfig) -> [Action; 16] {
    std::array::from_fn(|bits| {
        let derived = Actions(u8::try_from(bits).expect("it is less than 16"));
        let first = config.priority.iter().copied().find(|&action| derived.contains(action));
        first.unwrap_or(config.default)
    })
}

/// Returns whether a relation has `arity` columns of symbols. Otherwise it adds a diagnostic to `faults`.
fn fits(relation: &Relation, arity: usize, faults: &mut Vec<Diagnostic>, fault: impl FnOnce() -> Diagnostic) -> bool {
    let symbols = relation.columns.iter().all(|column| column.base == BaseType::Symbol);
    if relation.arity() == arity && symbols {
        return true;
    }
    let plural = if arity == 1 { "column" } else { "columns" };
    faults.push(
        fault()
            .at(relation.span, format!("declared with {} here", describe(relation)))
            .help(format!("declare it with {arity} {plural} of type agent")),
    );
    false
}

fn describe(relation: &Relation) -> String {
    let columns: Vec<&str> = relation.columns.iter().map(|column| column.base.name()).collect();
    format!("({})", columns.join(", "))
}

/// Returns one diagnostic for all relations in `unknown`.
fn undefined(scenario: &Scenario, unknown: &[&Relation], predicates: &[Predicate]) -> Option<Diagnostic> {
    let (first, rest) = unknown.split_first()?;
    let names: Vec<String> = unknown.iter().map(|relation| format!("`{}`", relation.name)).collect();
    let message = format!(
        "the rules read {}, which the configuration `{}` does not define",
        names.join(", "),
        scenario.name
    );
    let mut fault = Diagnostic::new(codes::RULE_MISMATCH, message).at(first.span, "declared as input here");
    for relation in rest {
        fault = fault.also(relation.span, "and here");
    }
    fault = fault.also(scenario.rules.span, "these rules");
    let known = || predicates.iter().map(|predicate| predicate.name.as_str());
    for relation in unknown {
        if let Some(near) = did_you_mean(&relation.name, known()) {
            fault = fault.help(format!("did you mean `{near}` by `{}`?", relation.name));
        }
    }
    Some(fault.help("define the missing predicates under `predicates` in the configuration, or derive them by rules"))
}

/// Returns a diagnostic for each relation that shares a predicate's name but is neither input nor derived.
fn unfilled(scenario: &Scenario, program: &Program) -> Vec<Diagnostic> {
    let rules = program.rules();
    let mut faults = Vec::new();
    for PredicateConfig { name, .. } in &scenario.predicates {
        let Some(relation) = program.relation(&name.value) else {
            continue;
        };
        let filled = rules.clauses.iter().any(|clause| clause.head.relation == relation);
        let relation = &rules.relations[relation.index()];
        if !relation.input && !filled {
            let message = format!("`{}` is never filled: it is declared, but not as input", name.value);
            faults.push(
                Diagnostic::new(codes::RULE_MISMATCH, message)
                    .at(relation.span, "declared here")
                    .also(name.span, "the configuration computes it")
                    .help(format!("write `.input {}` after the declaration", name.value)),
            );
        }
    }
    faults
}

/// Returns the input relations that a body reads and the configuration does not define, in declaration order.
fn unknown_inputs<'a>(program: &'a Program, predicates: &[Predicate]) -> Vec<&'a Relation> {
    let rules = program.rules();
    let mut read = vec![false; rules.relations.len()];
    for clause in &rules.clauses {
        for atom in clause.body.iter().filter_map(Literal::atom) {
            read[atom.relation.index()] = true;
        }
    }
    rules
        .relations
        .iter()
        .zip(read)
        .filter(|(relation, read)| *read && relation.input)
        .map(|(relation, _)| relation)
        .filter(|relation| predicates.iter().all(|predicate| predicate.name != relation.name))
        .collect()
}
