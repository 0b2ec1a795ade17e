//! What the rules can read and what they can decide: the base predicates and actions of a scenario, bound to a program.

use crate::city::Action;
use crate::config::{ActionsConfig, PredicateConfig, Scenario};
use crate::datalog::Program;
use crate::datalog::{BaseType, Literal, RelId, Relation};
use crate::diag::{Code, Diagnostic, did_you_mean};
use crate::predicate::{Definition, Sees};

/// A set of actions.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Actions(u8);

impl Actions {
    /// How many there are.
    pub fn len(self) -> usize {
        self.0.count_ones() as usize
    }

    /// Whether there are none.
    pub fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// Whether the action is in it.
    pub fn contains(self, action: Action) -> bool {
        self.0 >> action as u8 & 1 != 0
    }

    /// Adds an action.
    pub fn insert(&mut self, action: Action) {
        self.0 |= 1 << action as u8;
    }

    /// The actions in the order of [`Action::ALL`].
    pub fn iter(self) -> impl Iterator<Item = Action> {
        Action::ALL.into_iter().filter(move |&action| self.contains(action))
    }

    /// One bit for each action, in the order of [`Action::ALL`] from the lowest.
    pub(crate) fn bits(self) -> u8 {
        self.0
    }

    /// The converse of [`Actions::bits`].
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
    /// Its name in the rules.
    pub name: String,
    /// How it is computed.
    pub definition: Definition,
    /// 1 or 2.
    pub arity: usize,
    /// Its relation in the program; `None` if the rules do not take it as input.
    pub relation: Option<RelId>,
}

/// The base predicates and actions of a scenario, bound to a program.
#[derive(Clone, Debug)]
pub struct Vocabulary {
    /// The base predicates in the order of the scenario; `Sees` last.
    pub predicates: Vec<Predicate>,
    /// Position of `Sees` in `predicates`.
    pub sees: usize,
    /// The relation of each action, in the order of [`Action::ALL`]; `None` if the rules do not mention it.
    actions: [Option<RelId>; 4],
    /// The action to take, by the bits of those that are derived.
    decisions: [Action; 16],
    default: Action,
}

impl Vocabulary {
    /// Binds the predicates of a scenario to the relations of a program.
    ///
    /// # Errors
    /// `rule-mismatch` for every relation whose declaration does not fit: an input that a rule reads and the scenario does not
    /// define, another number of columns, a column that is not of base type symbol, or no action at all.
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
                            Code::RULE_MISMATCH,
                            format!(
                                "`{}` is declared otherwise than the configuration defines it",
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
                        Code::RULE_MISMATCH,
                        format!("the action `{}` is not a predicate over one agent", action.name()),
                    )
                })
            })
        });
        if faults.is_empty() && actions.iter().all(Option::is_none) {
            faults.push(
                Diagnostic::new(
                    Code::RULE_MISMATCH,
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

    /// Whether the rules take the predicate at this position as input.
    pub fn is_read(&self, predicate: usize) -> bool {
        self.predicates[predicate].relation.is_some()
    }

    /// The relation of an action, if the rules mention it.
    pub fn action(&self, action: Action) -> Option<RelId> {
        self.actions[action as usize]
    }

    /// The one action to take, given those that are derived: the first by the scenario's priority, else its default.
    pub fn decide(&self, derived: Actions) -> Action {
        self.decisions[usize::from(derived.bits())]
    }

    /// The action taken if none is derived.
    pub fn default_action(&self) -> Action {
        self.default
    }

    /// Without the default action, where it stands alone: then it is the default that made it.
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

/// Whether a relation has `arity` columns, all made of symbols; if not, a fault is pushed.
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

/// The fault of rules that read what the configuration does not define: one that names all.
fn undefined(scenario: &Scenario, unknown: &[&Relation], predicates: &[Predicate]) -> Option<Diagnostic> {
    let (first, rest) = unknown.split_first()?;
    let names: Vec<String> = unknown.iter().map(|relation| format!("`{}`", relation.name)).collect();
    let message = format!(
        "the rules read {}, which the configuration `{}` does not define",
        names.join(", "),
        scenario.name
    );
    let mut fault = Diagnostic::new(Code::RULE_MISMATCH, message).at(first.span, "declared as input here");
    for relation in rest {
        fault = fault.also(relation.span, "and here");
    }
    fault = fault.also(scenario.rules.span, "the configuration uses these rules");
    let known = || predicates.iter().map(|predicate| predicate.name.as_str());
    for relation in unknown {
        if let Some(near) = did_you_mean(&relation.name, known()) {
            fault = fault.help(format!("did you mean `{near}` by `{}`?", relation.name));
        }
    }
    Some(fault.help("define what is missing under `predicates` in the configuration, or derive it by a rule"))
}

/// The faults of relations that have the name of a predicate, are no input and are never derived: the configuration cannot fill them.
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
                Diagnostic::new(Code::RULE_MISMATCH, message)
                    .at(relation.span, "declared here")
                    .also(name.span, "the configuration computes it")
                    .help(format!("write `.input {}` after the declaration", name.value)),
            );
        }
    }
    faults
}

/// Input relations that some body reads and no predicate of the configuration defines, in the order of declaration.
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
