"""One ego's decision by z3 and by clingo: encodings of the rules, and interfaces of the solvers."""

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
    """An encoding of the rules for a solver, and an interface of it."""

    name: str
    every = 1
    """Every how many scenes one is timed: more than 1 if a decision takes long."""

    @abstractmethod
    def __init__(self, rules: Rules) -> None:
        """Prepare everything that does not depend on scenes."""

    @abstractmethod
    def prepare(self, scenes: Sequence[Scene]) -> list[Facts]:
        """Convert the facts of each scene to the solver's form. This is not timed.

        `decide` then takes them in this order, repeatedly.
        """

    @abstractmethod
    def decide(self, facts: Facts) -> set[str]:
        """Return the actions that are derived for the ego."""


def _bindings(clause: Clause) -> Iterator[dict[str, str]]:
    """Yield all bindings of the variables of a clause."""
    others = clause.others()
    for row in product(ENTITIES, repeat=len(others)):
        yield {clause.ego: EGO, **dict(zip(others, row, strict=True))}


def _atom(literal: Literal, binding: dict[str, str]) -> Atom:
    return literal.predicate, tuple(binding[variable] for variable in literal.variables)


def _needed(rules: Rules) -> list[Atom]:
    """Return the base atoms on which the decision about the ego can depend."""
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
    """Encodes the decision like the published simulator.

    The entities are constants of an uninterpreted sort. Every base atom is asserted or denied. The clauses define every
    action of the ego, with quantifiers over their other variables. There are no further entities.
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
    """The ground rules for the ego: every clause once for each binding."""

    def __init__(self, rules: Rules) -> None:
        self.atoms = {atom: z3.Bool(f"{atom[0]}({','.join(atom[1])})") for atom in _needed(rules)}
        self.derived = {head: z3.Bool(head) for head in rules.clauses}
        self.actions = [(action, self.derived[action]) for action in rules.actions]
        self.definitions = [
            self.derived[head] == z3.Or([self._clause(clause) for clause in clauses])
            for head, clauses in rules.clauses.items()
        ]

    def _clause(self, clause: Clause) -> Any:
        """Encode literals about the ego alone once, the others for each binding."""
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
    """Uses no quantifiers, and only atoms on which the decision can depend."""

    name = "z3, made afresh, expanded"
    every = 5

    def decide(self, facts: Scene) -> set[str]:
        rules = _Propositional(self.rules)
        solver = z3.SolverFor("QF_FD")
        solver.add(*rules.definitions, *rules.facts(facts))
        _expect(solver.check() == z3.sat)
        return rules.answer(solver)


class Prebuilt(Decider[Any]):
    """Uses one solver for all decisions, without quantifiers. Here z3's solver for finite domains is the fastest."""

    def __init__(self, rules: Rules) -> None:
        self.rules = _Propositional(rules)
        self.solver = z3.SolverFor("QF_FD")
        self.solver.add(*self.rules.definitions)

    def prepare(self, scenes: Sequence[Scene]) -> list[Any]:
        return [self.rules.facts(scene) for scene in scenes]


class Pushed(Prebuilt):
    """Asserts facts and retracts them."""

    name = "z3, built once, push and pop"

    def decide(self, facts: list[Any]) -> set[str]:
        self.solver.push()
        self.solver.add(*facts)
        _expect(self.solver.check() == z3.sat)
        answer = self.rules.answer(self.solver)
        self.solver.pop()
        return answer


class Assumed(Prebuilt):
    """Passes facts as assumptions."""

    name = "z3, built once, assumptions"

    def decide(self, facts: list[Any]) -> set[str]:
        _expect(self.solver.check(*facts) == z3.sat)
        return self.rules.answer(self.solver)


class AssumedBare(Prebuilt):
    """Passes prepared arrays of assumptions to the C interface, with hardly any work in Python."""

    name = "z3, built once, assumptions, C interface"

    def __init__(self, rules: Rules) -> None:
        super().__init__(rules)
        self.constants = [(action, variable.decl().ast) for action, variable in self.rules.actions]

    def prepare(self, scenes: Sequence[Scene]) -> list[Any]:
        # The arrays hold no references, so this object must keep the formulas.
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
    """Grounds once, with an atom for every fact on which the decision can depend."""

    atom_statement: str
    """The statement that allows an atom to hold."""

    def __init__(self, rules: Rules) -> None:
        self.control = clingo.Control(["--warn=none"])
        self.control.add("base", [], "\n".join(_program(rules, self.atom_statement)))
        self.control.ground([("base", [])])
        known = {found.symbol: found.literal for found in self.control.symbolic_atoms}
        self.literals = {atom: known[_symbol(atom)] for atom in _needed(rules)}
        # An action without a clause has no atom.
        actions = [(action, _symbol((action, (EGO,)))) for action in rules.actions]
        self.actions = [(action, known[symbol]) for action, symbol in actions if symbol in known]
        self.found: set[str] = set()

    def _solve(self, assumptions: Sequence[int] = ()) -> set[str]:
        _expect(bool(self.control.solve(assumptions=assumptions, on_model=self._note).satisfiable))
        return self.found

    def _note(self, model: clingo.Model) -> None:
        self.found = {action for action, literal in self.actions if model.is_true(literal)}


class External(MultiShot[list[tuple[int, bool]]]):
    """Declares facts as externals, and sets those that differ from the previous scene."""

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
    """Declares facts as choices, and assumes them."""

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
    """Yield the rules for the ego as an answer set program."""
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
    """Return a unique name that begins with a lower-case letter, as clingo requires."""
    return f"p_{predicate}"


def _symbol(atom: Atom) -> clingo.Symbol:
    return clingo.Function(_named(atom[0]), [clingo.Function(name) for name in atom[1]])


DECIDERS: list[type[Decider[Any]]] = [Quantified, Expanded, Pushed, Assumed, AssumedBare, External, Chosen]
