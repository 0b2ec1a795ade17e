"""One ego's decision by z3 and by clingo: the meaning of the rules in the solvers' terms, and how they are asked."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from itertools import product
from typing import Any, Generic, TypeVar

import clingo
import z3  # type: ignore[import-untyped]

from rules import Clause, Literal, Rules
from scenes import EGO, ENTITIES, Atom, Scene, all_atoms

Facts = TypeVar("Facts")


class Decider(ABC, Generic[Facts]):
    """One way to decide."""

    name: str
    every = 1
    """Of so many scenes one is timed: more than one where a decision takes long."""

    @abstractmethod
    def __init__(self, rules: Rules) -> None:
        """What can be done before there are scenes."""

    @abstractmethod
    def prepare(self, scenes: Sequence[Scene]) -> list[Facts]:
        """The facts of each scene, as ready for the solver as they can be. This is not timed.

        They are then given to `decide` in this order, after the last the first again.
        """

    @abstractmethod
    def decide(self, facts: Facts) -> set[str]:
        """The actions that are derived for the ego."""


def _bindings(clause: Clause) -> Iterator[dict[str, str]]:
    """All that the variables of a clause can stand for."""
    others = clause.others()
    for row in product(ENTITIES, repeat=len(others)):
        yield {clause.ego: EGO, **dict(zip(others, row, strict=True))}


def _atom(literal: Literal, binding: dict[str, str]) -> Atom:
    return literal.predicate, tuple(binding[variable] for variable in literal.variables)


def _needed(rules: Rules) -> list[Atom]:
    """The base atoms on which the decision about the ego can depend."""
    read = {
        _atom(literal, binding)
        for group in rules.clauses.values()
        for clause in group
        for binding in _bindings(clause)
        for literal in clause.body
    }
    return [atom for atom in all_atoms(rules) if atom in read]


def _signed(formula: Any, positive: bool) -> Any:
    return formula if positive else z3.Not(formula)


class Afresh(Decider[Scene]):
    """Makes a solver for every decision."""

    def __init__(self, rules: Rules) -> None:
        self.rules = rules

    def prepare(self, scenes: Sequence[Scene]) -> list[Scene]:
        return list(scenes)


class Quantified(Afresh):
    """As the published simulator does it.

    Its ontology is an uninterpreted sort with a constant for each entity. Every base atom is asserted or denied; every
    action of the ego is defined by its clauses, whose other variables are quantified; and nobody else exists.
    """

    name = "z3, made afresh, quantifiers (as published)"
    every = 5

    def decide(self, facts: Scene) -> set[str]:
        solver = z3.Solver()
        sort = z3.DeclareSort("Entity")
        entities = {name: z3.Const(name, sort) for name in ENTITIES}
        ego = entities[EGO]
        predicates = {
            predicate: z3.Function(predicate, *[sort] * arity, z3.BoolSort())
            for predicate, arity in self.rules.arities.items()
        }
        for predicate, row in all_atoms(self.rules):
            atom = predicates[predicate](*(entities[name] for name in row))
            solver.add(_signed(atom, (predicate, row) in facts.facts))
        variables: dict[str, Any] = {}
        for head, clauses in self.rules.clauses.items():
            ways = []
            for clause in clauses:
                others = {variable: z3.Const(variable, sort) for variable in clause.others()}
                variables |= others
                terms = {clause.ego: ego, **others}
                body = z3.And(
                    [
                        _signed(predicates[literal.predicate](*(terms[v] for v in literal.variables)), literal.positive)
                        for literal in clause.body
                    ]
                )
                ways.append(z3.Exists(list(others.values()), body) if others else body)
            solver.add(predicates[head](ego) == z3.Or(ways))
        for variable in variables.values():
            solver.add(z3.ForAll([variable], z3.Or([variable == entity for entity in entities.values()])))
        _expect(solver.check() == z3.sat)
        model = solver.model()
        return {action for action in self.rules.actions if z3.is_true(model.evaluate(predicates[action](ego)))}


class _Propositional:
    """The rules for the ego without variables: every clause once for each binding."""

    def __init__(self, rules: Rules) -> None:
        self.atoms = {atom: z3.Bool(f"{atom[0]}({','.join(atom[1])})") for atom in _needed(rules)}
        self.derived = {head: z3.Bool(head) for head in rules.clauses}
        self.actions = [(action, self.derived[action]) for action in rules.actions]
        self.definitions = [
            self.derived[head] == z3.Or([self._clause(clause) for clause in clauses])
            for head, clauses in rules.clauses.items()
        ]

    def _clause(self, clause: Clause) -> Any:
        """What is asked of the ego alone once, the rest for each binding."""
        own = [literal for literal in clause.body if set(literal.variables) <= {clause.ego}]
        rest = [literal for literal in clause.body if literal not in own]
        formula = [self._literal(literal, {clause.ego: EGO}) for literal in own]
        if rest:
            ways = [z3.And([self._literal(literal, binding) for literal in rest]) for binding in _bindings(clause)]
            formula.append(z3.Or(ways))
        return z3.And(formula)

    def _literal(self, literal: Literal, binding: dict[str, str]) -> Any:
        known = self.derived.get(literal.predicate)
        return _signed(self.atoms[_atom(literal, binding)] if known is None else known, literal.positive)

    def facts(self, scene: Scene) -> list[Any]:
        return [_signed(variable, atom in scene.facts) for atom, variable in self.atoms.items()]

    def answer(self, solver: Any) -> set[str]:
        model = solver.model()
        return {action for action, variable in self.actions if z3.is_true(model[variable])}


class Expanded(Afresh):
    """Without quantifiers, and with no more atoms than the decision can depend on."""

    name = "z3, made afresh, expanded"
    every = 5

    def decide(self, facts: Scene) -> set[str]:
        rules = _Propositional(self.rules)
        solver = z3.SolverFor("QF_FD")
        solver.add(*rules.definitions, *rules.facts(facts))
        _expect(solver.check() == z3.sat)
        return rules.answer(solver)


class Prebuilt(Decider[Any]):
    """One solver for all decisions, without quantifiers. The one for finite domains is z3's fastest here."""

    def __init__(self, rules: Rules) -> None:
        self.rules = _Propositional(rules)
        self.solver = z3.SolverFor("QF_FD")
        self.solver.add(*self.rules.definitions)

    def prepare(self, scenes: Sequence[Scene]) -> list[Any]:
        return [self.rules.facts(scene) for scene in scenes]


class Pushed(Prebuilt):
    """Facts are asserted and taken back."""

    name = "z3, built once, push and pop"

    def decide(self, facts: list[Any]) -> set[str]:
        self.solver.push()
        self.solver.add(*facts)
        _expect(self.solver.check() == z3.sat)
        answer = self.rules.answer(self.solver)
        self.solver.pop()
        return answer


class Assumed(Prebuilt):
    """Facts are assumptions."""

    name = "z3, built once, assumptions"

    def decide(self, facts: list[Any]) -> set[str]:
        _expect(self.solver.check(*facts) == z3.sat)
        return self.rules.answer(self.solver)


class AssumedBare(Prebuilt):
    """The same by bare calls of the C interface, with arrays that are ready: Python has next to nothing to do."""

    name = "z3, built once, assumptions, C interface"

    def __init__(self, rules: Rules) -> None:
        super().__init__(rules)
        self.constants = [(action, variable.decl().ast) for action, variable in self.rules.actions]

    def prepare(self, scenes: Sequence[Scene]) -> list[Any]:
        # The arrays hold no references: the formulas have to be kept.
        self.kept = super().prepare(scenes)
        return [(z3.Ast * len(facts))(*(fact.as_ast() for fact in facts)) for facts in self.kept]

    def decide(self, facts: Any) -> set[str]:
        context, solver = self.solver.ctx.ref(), self.solver.solver
        _expect(z3.Z3_solver_check_assumptions(context, solver, len(facts), facts) == z3.Z3_L_TRUE)
        model = z3.Z3_solver_get_model(context, solver)
        z3.Z3_model_inc_ref(context, model)
        answer = set()
        for action, constant in self.constants:
            value = z3.Z3_model_get_const_interp(context, model, constant)
            if value and z3.Z3_get_bool_value(context, value) == z3.Z3_L_TRUE:
                answer.add(action)
        z3.Z3_model_dec_ref(context, model)
        return answer


class MultiShot(Decider[Facts]):
    """Grounded once, with an atom for every fact that the decision can depend on."""

    atom_statement: str
    """What says of an atom that it may hold."""

    def __init__(self, rules: Rules) -> None:
        self.control = clingo.Control(["--warn=none"])
        self.control.add("base", [], "\n".join(_program(rules, self.atom_statement)))
        self.control.ground([("base", [])])
        known = {found.symbol: found.literal for found in self.control.symbolic_atoms}
        self.literals = {atom: known[_symbol(atom)] for atom in _needed(rules)}
        # An action that no clause derives is no atom.
        actions = [(action, _symbol((action, (EGO,)))) for action in rules.actions]
        self.actions = [(action, known[symbol]) for action, symbol in actions if symbol in known]
        self.found: set[str] = set()

    def _solve(self, assumptions: Sequence[int] = ()) -> set[str]:
        _expect(bool(self.control.solve(assumptions=assumptions, on_model=self._note).satisfiable))
        return self.found

    def _note(self, model: clingo.Model) -> None:
        self.found = {action for action, literal in self.actions if model.is_true(literal)}


class External(MultiShot[list[tuple[int, bool]]]):
    """Facts are externals; those that differ from the scene before are set."""

    name = "clingo, multi-shot, externals"
    atom_statement = "#external {}."

    def prepare(self, scenes: Sequence[Scene]) -> list[list[tuple[int, bool]]]:
        for atom, literal in self.literals.items():
            self.control.assign_external(literal, atom in scenes[-1].facts)
        return [
            [(self.literals[atom], atom in now.facts) for atom in self.literals.keys() & (before.facts ^ now.facts)]
            for before, now in zip([scenes[-1], *scenes[:-1]], scenes, strict=True)
        ]

    def decide(self, facts: list[tuple[int, bool]]) -> set[str]:
        for literal, holds in facts:
            self.control.assign_external(literal, holds)
        return self._solve()


class Chosen(MultiShot[list[int]]):
    """Facts are free choices, and assumed."""

    name = "clingo, multi-shot, assumptions"
    atom_statement = "{{{}}}."

    def prepare(self, scenes: Sequence[Scene]) -> list[list[int]]:
        return [
            [literal if atom in scene.facts else -literal for atom, literal in self.literals.items()]
            for scene in scenes
        ]

    def decide(self, facts: list[int]) -> set[str]:
        return self._solve(facts)


def _expect(satisfiable: bool) -> None:
    if not satisfiable:
        raise AssertionError("facts and definitions contradict each other")


def _program(rules: Rules, atom_statement: str) -> Iterator[str]:
    """The rules for the ego as an answer set program."""
    yield f"entity({';'.join(ENTITIES)})."
    for atom in _needed(rules):
        yield atom_statement.format(_symbol(atom))
    for head, clauses in rules.clauses.items():
        for clause in clauses:
            names = {clause.ego: EGO, **{variable: f"V{n}" for n, variable in enumerate(clause.others())}}
            body = [f"entity({names[variable]})" for variable in clause.others()]
            for literal in clause.body:
                row = ",".join(names[variable] for variable in literal.variables)
                body.append(f"{'' if literal.positive else 'not '}{_named(literal.predicate)}({row})")
            yield f"{_named(head)}({EGO}){' :- ' if body else ''}{', '.join(body)}."


def _named(predicate: str) -> str:
    """A name that begins with a small letter, as clingo wants it, and is no other's."""
    return f"p_{predicate}"


def _symbol(atom: Atom) -> clingo.Symbol:
    return clingo.Function(_named(atom[0]), [clingo.Function(name) for name in atom[1]])


DECIDERS: list[type[Decider[Any]]] = [Quantified, Expanded, Pushed, Assumed, AssumedBare, External, Chosen]
