//! Rules as derived predicates of PDDL.
//!
//! A clause becomes a `:derived` axiom: the head is the axiom's head, variables that only the body has are bound by
//! `exists`, and `Not` is `not`. The strata of the rules are those of the axioms, so a planner that supports stratified
//! axioms evaluates them as the engine does.
//!
//! The rules occur in two forms. *Decided*: what they derive for an agent. *Judged*: which clauses demand an action of
//! an agent under the assumption that the ego takes exactly one given action, as the rule monitor judges; there, the
//! action predicates of all bodies are replaced by this assumption, which is a parameter.

use crate::city::Action;
use crate::datalog::{Atom, BaseType, Clause, ClauseId, Comparison, Literal, PredicateId, Rules, Term, VarId};
use crate::diag::{Diagnostic, Span};
use crate::predicate::Definition;
use crate::sim::{ActionConstraint, World};
use crate::task::spf::codes;
use crate::task::spf::pddl::names::Names;
use std::collections::BTreeSet;
use std::fmt::Write;

/// The rules of a world, checked to be in the fragment that PDDL can state.
pub(super) struct Fragment<'a> {
    world: &'a World,
    constraints: &'a [ActionConstraint],
    /// The predicates on which actions depend, actions included.
    relevant: Vec<bool>,
    /// The relevant derived predicates that read actions, without the actions themselves.
    reads_actions: Vec<bool>,
    /// The name of each predicate in PDDL, in the decided and in the judged form.
    names: Vec<[String; 2]>,
    /// The name of `Sees`, which tells what the ego observes, also if the rules do not read it.
    sees: String,
    /// The name of each action as a constant, in the order of the action table.
    deeds: Vec<String>,
}

/// The form in which a clause is written.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Form {
    /// What the rules derive; with `observed`, of what the ego observes, else of all agents.
    Decided { observed: bool },
    /// What they demand of what the ego observes, if it takes the action `?taken`.
    Judged,
}

impl Form {
    fn is_observed(self) -> bool {
        self != Form::Decided { observed: false }
    }
}

/// Reports what PDDL cannot say.
fn unsupported(what: &str, span: Span, place: &str) -> Diagnostic {
    Diagnostic::new(codes::PDDL_UNSUPPORTED, format!("PDDL cannot state {what}")).at(span, place)
}

/// Returns the help for rules that the encoding `strips` supports.
fn compiled_away(fault: Diagnostic) -> Diagnostic {
    fault.help("write it without, or use `--encoding strips`, in which the engine has evaluated the rules")
}

/// Checks what every encoding needs: a state is the tick and the places of agents.
///
/// # Errors
/// `pddl-unsupported` for rules that read quantities, external predicates or earlier ticks, and for actions that
/// change the route.
pub(super) fn check_state(world: &World) -> Result<(), Diagnostic> {
    let (rules, vocabulary) = (world.program.rules(), &world.vocabulary);
    if let Some(past) = rules.pasts.first() {
        let span = rules.predicates[past.predicate.index()].span;
        let fault = unsupported("temporal operators", span, "this looks back");
        return Err(fault.help("use rules without temporal operators"));
    }
    for predicate in &vocabulary.predicates {
        let Some(id) = predicate.id else { continue };
        let declared = &rules.predicates[id.index()];
        let what = match predicate.definition {
            Definition::Quantity(_) => "quantities, which are numbers of the state",
            Definition::External(_) => "external predicates, which a function computes",
            _ => continue,
        };
        let reads = |clause: &&Clause| (clause.body.iter().filter_map(Literal::atom)).any(|atom| atom.predicate == id);
        if let Some(clause) = rules.clauses.iter().find(reads) {
            let fault = unsupported(what, clause.span, &format!("this reads `{}`", declared.name));
            return Err(fault.help("use rules that read only predicates of the city, without values"));
        }
    }
    let table = &world.scenario.actions.table;
    if let Some(own) = table.own().iter().find(|own| own.effect.is_some()) {
        let fault = unsupported("actions that change a route or park", own.name.span, "defined here");
        return Err(fault.help("use a configuration without `effect` in `actions.define`"));
    }
    Ok(())
}

impl<'a> Fragment<'a> {
    /// Checks the rules. `constraints` are the clauses that demand actions.
    ///
    /// # Errors
    /// `pddl-unsupported` for what PDDL cannot state, at the place of the clause.
    pub fn new(
        world: &'a World,
        constraints: &'a [ActionConstraint],
        names: &mut Names,
    ) -> Result<Fragment<'a>, Diagnostic> {
        let (rules, vocabulary) = (world.program.rules(), &world.vocabulary);
        let table = vocabulary.actions();
        let mut relevant = vec![false; rules.predicates.len()];
        let mut waiting: Vec<PredicateId> = table.all().filter_map(|action| vocabulary.action(action)).collect();
        while let Some(predicate) = waiting.pop() {
            if std::mem::replace(&mut relevant[predicate.index()], true) {
                continue;
            }
            for clause in rules.clauses.iter().filter(|clause| clause.head.predicate == predicate) {
                check(rules, clause)?;
                waiting.extend(clause.body.iter().filter_map(Literal::atom).map(|atom| atom.predicate));
            }
        }
        let mut reads_actions = vec![false; rules.predicates.len()];
        // Each round finds the next predicates of a chain.
        loop {
            let before = reads_actions.iter().filter(|reads| **reads).count();
            for clause in &rules.clauses {
                let reads = clause.body.iter().filter_map(Literal::atom).any(|atom| {
                    vocabulary.action_of(atom.predicate).is_some() || reads_actions[atom.predicate.index()]
                });
                if reads && vocabulary.action_of(clause.head.predicate).is_none() {
                    reads_actions[clause.head.predicate.index()] = true;
                }
            }
            if reads_actions.iter().filter(|reads| **reads).count() == before {
                break;
            }
        }
        let deeds: Vec<String> = table.names().map(|name| names.unique(name)).collect();
        // Actions come first, so that their names have no number.
        let of_action = |action: Action| ["wants", "demands"].map(|form| format!("{form}-{}", deeds[action.index()]));
        let of_actions: Vec<[String; 2]> = table
            .all()
            .map(|action| of_action(action).map(|name| names.unique(&name)))
            .collect();
        let predicates = rules.predicates.iter().enumerate();
        let named = predicates.map(|(at, predicate)| {
            let id = PredicateId(u32::try_from(at).expect("fewer than 2^32 predicates"));
            if !relevant[at] {
                return [const { String::new() }; 2];
            }
            if let Some(action) = vocabulary.action_of(id) {
                return of_actions[action.index()].clone();
            }
            let decided = names.unique(if predicate.hidden { "part" } else { &predicate.name });
            let judged = match predicate.input {
                true => decided.clone(),
                false => names.unique(&format!("observed-{decided}")),
            };
            [decided, judged]
        });
        let named: Vec<[String; 2]> = named.collect();
        let sees = vocabulary.predicates[vocabulary.sees]
            .id
            .map(|id| named[id.index()][0].clone());
        let sees = sees.filter(|name| !name.is_empty());
        Ok(Fragment {
            sees: sees.unwrap_or_else(|| names.unique("Sees")),
            names: named,
            deeds,
            world,
            constraints,
            relevant,
            reads_actions,
        })
    }

    /// Returns the world of the rules.
    pub fn world(&self) -> &'a World {
        self.world
    }

    /// Returns the predicate that the rules derive for an action, if they declare it, as a name in PDDL.
    pub fn wants(&self, action: Action) -> Option<&str> {
        self.world
            .vocabulary
            .action(action)
            .map(|predicate| self.decided(predicate))
    }

    /// Returns the name of an action as a constant.
    pub fn deed(&self, action: Action) -> &str {
        &self.deeds[action.index()]
    }

    /// Returns the base predicates that the rules read, and `Sees`, by their positions in the vocabulary.
    pub fn base_predicates(&self) -> impl Iterator<Item = usize> + '_ {
        let vocabulary = &self.world.vocabulary;
        let is_read = |id: Option<PredicateId>| id.is_some_and(|id| self.relevant[id.index()]);
        let predicates = vocabulary.predicates.iter().enumerate();
        let read = predicates.filter(move |(at, predicate)| *at == vocabulary.sees || is_read(predicate.id));
        read.map(|(at, _)| at)
    }

    /// Returns the name of a base predicate in PDDL, by its position in the vocabulary.
    pub fn base_name(&self, predicate: usize) -> &str {
        if predicate == self.world.vocabulary.sees {
            return &self.sees;
        }
        let id = self.world.vocabulary.predicates[predicate].id.expect("a rule reads it");
        self.decided(id)
    }

    /// Returns whether the rules about an agent read only what it sees: every clause is about one agent and binds
    /// each further variable by `Sees` of this agent.
    pub fn is_local(&self) -> bool {
        let sees = self.world.vocabulary.predicates[self.world.vocabulary.sees].id;
        let rules = self.world.program.rules();
        let mut clauses = rules
            .clauses
            .iter()
            .filter(|clause| self.relevant[clause.head.predicate.index()]);
        clauses.all(|clause| {
            let [Term::Variable(about)] = clause.head.terms[..] else {
                return false;
            };
            let mut bound = BTreeSet::from([about.index()]);
            for literal in &clause.body {
                if let Literal::Positive(atom) | Literal::Guard(atom) = literal
                    && Some(atom.predicate) == sees
                    && let [Term::Variable(first), Term::Variable(second)] = atom.terms[..]
                    && first == about
                {
                    bound.insert(second.index());
                }
            }
            let wildcards = clause
                .body
                .iter()
                .flat_map(Literal::terms)
                .any(|term| *term == Term::Wildcard);
            !wildcards
                && clause
                    .body
                    .iter()
                    .flat_map(Literal::variables)
                    .all(|variable| bound.contains(&variable.index()))
        })
    }

    /// Returns the declarations of the derived predicates. `decided` is the form for agents without control.
    pub fn declarations(&self) -> Vec<String> {
        let rules = self.world.program.rules();
        let mut lines = Vec::new();
        for (at, predicate) in rules.predicates.iter().enumerate() {
            let id = PredicateId(u32::try_from(at).expect("fewer than 2^32 predicates"));
            if !self.relevant[at] || predicate.input {
                continue;
            }
            let parameters: String = (0..predicate.arity())
                .map(|place| format!(" ?x{place} - agent"))
                .collect();
            let (decided, judged) = (self.decided(id), self.judged(id));
            lines.push(format!("({decided}{parameters})"));
            if judged != decided {
                let taken = if self.takes(id) { " ?taken - deed" } else { "" };
                lines.push(format!("({judged}{parameters}{taken})"));
            }
        }
        lines
    }

    /// Returns the name of a predicate in the decided form.
    fn decided(&self, predicate: PredicateId) -> &str {
        &self.names[predicate.index()][0]
    }

    /// Returns the name of a predicate in the judged form.
    fn judged(&self, predicate: PredicateId) -> &str {
        &self.names[predicate.index()][1]
    }

    /// Returns whether the judged form of a predicate depends on the action of the ego.
    fn takes(&self, predicate: PredicateId) -> bool {
        self.reads_actions[predicate.index()] || self.world.vocabulary.action_of(predicate).is_some()
    }

    /// Returns the axioms of what the rules derive: of what the ego observes, or of all agents.
    pub fn decisions(&self, observed: bool) -> String {
        self.axioms(Form::Decided { observed })
    }

    /// Returns the axioms of what the rules demand, and that of `violated`.
    pub fn demands(&self) -> String {
        let mut text = self.axioms(Form::Judged);
        let mut demanded: Vec<Action> = self.constraints.iter().map(|constraint| constraint.action).collect();
        demanded.sort_unstable();
        demanded.dedup();
        if demanded.is_empty() {
            return text;
        }
        text += "  ; An action violates a clause that demands another one.\n";
        text += "  (:derived (violated ?taken - deed)\n    (exists (?x - agent) (and (ego ?x) (or";
        for action in demanded {
            let id = self.world.vocabulary.action(action).expect("a clause derives it");
            let (name, deed) = (self.judged(id), self.deed(action));
            write!(text, "\n      (and (not (= ?taken {deed})) ({name} ?x ?taken))").expect("strings take all text");
        }
        text + "))))\n"
    }

    fn axioms(&self, form: Form) -> String {
        let rules = self.world.program.rules();
        let mut text = String::new();
        for id in rules.strata.iter().flat_map(|stratum| &stratum.clauses) {
            let clause = &rules.clauses[id.index()];
            if !self.relevant[clause.head.predicate.index()] || !self.is_written(*id, form) {
                continue;
            }
            if let Some(line) = clause.doc.lines().map(str::trim).find(|line| !line.is_empty()) {
                writeln!(text, "  ; {line}").expect("strings take all text");
            }
            text += &self.axiom(clause, form);
        }
        text
    }

    /// Returns whether a clause has an axiom in this form.
    fn is_written(&self, clause: ClauseId, form: Form) -> bool {
        let head = self.world.program.rules().clauses[clause.index()].head.predicate;
        let is_action = self.world.vocabulary.action_of(head).is_some();
        // The default demands nothing, so its clause is no constraint.
        form != Form::Judged || !is_action || self.constraints.iter().any(|constraint| constraint.clause == clause)
    }

    /// Returns the axiom of a clause.
    fn axiom(&self, clause: &Clause, form: Form) -> String {
        let variables = Variables::of(clause);
        let mut heads: Vec<VarId> = Vec::new();
        let (mut parameters, mut conditions) = (String::new(), Vec::new());
        for (place, term) in clause.head.terms.iter().enumerate() {
            let variable = term.variable().expect("checked: heads have no constants");
            if heads.contains(&variable) {
                write!(parameters, " ?again{place} - agent").expect("strings take all text");
                conditions.push(format!("(= ?again{place} {})", variables.name(variable)));
            } else {
                write!(parameters, " {} - agent", variables.name(variable)).expect("strings take all text");
                heads.push(variable);
            }
        }
        let mut used: BTreeSet<usize> = heads.iter().map(|variable| variable.index()).collect();
        used.extend(clause.body.iter().flat_map(Literal::variables).map(VarId::index));
        if form.is_observed() {
            conditions.extend(
                used.iter()
                    .map(|&variable| format!("(observed {})", variables.names[variable])),
            );
        }
        let mut wildcards = Wildcards::default();
        conditions.extend(
            clause
                .body
                .iter()
                .map(|literal| self.literal(literal, form, &variables, &mut wildcards)),
        );
        let head = match form {
            Form::Judged => self.judged(clause.head.predicate),
            Form::Decided { .. } => self.decided(clause.head.predicate),
        };
        let taken = match form == Form::Judged && self.takes(clause.head.predicate) {
            true => " ?taken - deed",
            false => "",
        };
        let further = used
            .iter()
            .filter(|&&variable| heads.iter().all(|head| head.index() != variable));
        let further = further.map(|&variable| variables.names[variable].clone());
        let bound: Vec<String> = further
            .chain(wildcards.bound)
            .map(|name| format!("{name} - agent"))
            .collect();
        let body = format!("(and {})", conditions.join(" "));
        let body = match bound.is_empty() {
            true => body,
            false => format!("(exists ({}) {body})", bound.join(" ")),
        };
        format!("  (:derived ({head}{parameters}{taken})\n    {body})\n")
    }

    fn literal(&self, literal: &Literal, form: Form, variables: &Variables, wildcards: &mut Wildcards) -> String {
        match literal {
            Literal::Positive(atom) | Literal::Guard(atom) => {
                let terms = atom.terms.iter().map(|term| match term {
                    Term::Variable(variable) => variables.name(*variable).to_owned(),
                    _ => wildcards.bind(),
                });
                let terms: Vec<String> = terms.collect();
                let fresh = (atom.terms.iter().zip(&terms)).filter(|(term, _)| **term == Term::Wildcard);
                let guards: Vec<String> = match form.is_observed() {
                    true => fresh.map(|(_, name)| format!("(observed {name})")).collect(),
                    false => Vec::new(),
                };
                let atom = self.atom(atom, &terms, form);
                match guards.is_empty() {
                    true => atom,
                    false => format!("(and {} {atom})", guards.join(" ")),
                }
            }
            Literal::Negative(atom) => {
                let mut fresh = Vec::new();
                let terms = atom.terms.iter().map(|term| match term {
                    Term::Variable(variable) => variables.name(*variable).to_owned(),
                    _ => {
                        fresh.push(wildcards.name());
                        fresh.last().expect("just added").clone()
                    }
                });
                let terms: Vec<String> = terms.collect();
                let atom = self.atom(atom, &terms, form);
                if fresh.is_empty() {
                    return format!("(not {atom})");
                }
                let guards = fresh
                    .iter()
                    .filter(|_| form.is_observed())
                    .map(|name| format!("(observed {name}) "));
                let guards: String = guards.collect();
                let bound: Vec<String> = fresh.iter().map(|name| format!("{name} - agent")).collect();
                format!("(not (exists ({}) (and {guards}{atom})))", bound.join(" "))
            }
            Literal::Compare { op, left, right, .. } => {
                let name = |term: &Term| variables.name(term.variable().expect("checked: no constants"));
                let equal = format!("(= {} {})", name(left), name(right));
                match op {
                    Comparison::Equal => equal,
                    _ => format!("(not {equal})"),
                }
            }
            Literal::Compute { .. } | Literal::Aggregate { .. } => unreachable!("checked: not in the fragment"),
        }
    }

    fn atom(&self, atom: &Atom, terms: &[String], form: Form) -> String {
        let terms = terms.iter().map(|term| format!(" {term}")).collect::<String>();
        match (form, self.world.vocabulary.action_of(atom.predicate)) {
            (Form::Decided { .. }, _) => format!("({}{terms})", self.decided(atom.predicate)),
            (Form::Judged, Some(action)) => format!("(and (ego{terms}) (= ?taken {}))", self.deed(action)),
            (Form::Judged, None) => {
                let taken = if self.takes(atom.predicate) { " ?taken" } else { "" };
                format!("({}{terms}{taken})", self.judged(atom.predicate))
            }
        }
    }
}

/// Checks that PDDL can state a clause.
fn check(rules: &Rules, clause: &Clause) -> Result<(), Diagnostic> {
    let fault = |what: &str| Err(compiled_away(unsupported(what, clause.span, "in this clause")));
    let declared = |atom: &Atom| &rules.predicates[atom.predicate.index()];
    let is_of_agents = |atom: &Atom| {
        declared(atom)
            .columns
            .iter()
            .all(|column| column.base == BaseType::Symbol)
    };
    let has_aggregate = |literal: &Literal| matches!(literal, Literal::Aggregate { .. });
    if clause.body.iter().any(has_aggregate) {
        return fault("aggregates");
    }
    for literal in &clause.body {
        match literal {
            Literal::Aggregate { .. } => return fault("aggregates"),
            Literal::Compute { .. } => return fault("arithmetic and functors"),
            Literal::Compare { op, base, .. } => {
                if *base != BaseType::Symbol || !matches!(op, Comparison::Equal | Comparison::NotEqual) {
                    return fault("comparisons of values other than `=` and `!=` of agents");
                }
            }
            Literal::Positive(atom) | Literal::Negative(atom) | Literal::Guard(atom) => {
                if Some(atom.predicate) == rules.chance {
                    return fault("chance");
                }
                if declared(atom).parameters > 0 {
                    return fault("aggregates");
                }
                if !is_of_agents(atom) {
                    return fault(&format!("columns of numbers, as `{}` has", declared(atom).title()));
                }
            }
        }
    }
    if !is_of_agents(&clause.head) {
        return fault(&format!(
            "columns of numbers, as `{}` has",
            declared(&clause.head).title()
        ));
    }
    let mut terms = clause
        .head
        .terms
        .iter()
        .chain(clause.body.iter().flat_map(Literal::terms));
    match terms.any(|term| matches!(term, Term::Constant(_))) {
        true => fault("constants: its objects are those of the problem"),
        false => Ok(()),
    }
}

/// The names of the variables of a clause in PDDL.
struct Variables {
    names: Vec<String>,
}

impl Variables {
    fn of(clause: &Clause) -> Variables {
        let mut names = Names::default();
        // Names of parameters that axioms have besides.
        names.unique("taken");
        let names = clause.variables.iter().map(|name| format!("?{}", names.unique(name)));
        Variables { names: names.collect() }
    }

    fn name(&self, variable: VarId) -> &str {
        &self.names[variable.index()]
    }
}

/// The variables that stand for wildcards. Those of positive literals are bound with the variables of the clause.
#[derive(Default)]
struct Wildcards {
    count: usize,
    bound: Vec<String>,
}

impl Wildcards {
    fn name(&mut self) -> String {
        self.count += 1;
        format!("?any-{}", self.count)
    }

    fn bind(&mut self) -> String {
        let name = self.name();
        self.bound.push(name.clone());
        name
    }
}
