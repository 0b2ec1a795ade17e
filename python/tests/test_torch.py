"""Rules as a layer, compared with the engine and with loops over their definition."""

from __future__ import annotations

import copy
import itertools
import math
import pickle
import random
from typing import Any

import numpy as np
import pytest
import yaml
from conftest import ROOT, needs

from logicity import Program, Session

torch = needs("torch", "learn")
from logicity.torch import DEFAULT, PRIORITY, RuleLayer  # noqa: E402

SEMANTICS = ("godel", "product", "lukasiewicz")
EXACT = ("exact", "top-k")
DECLARED = """
.type agent <: symbol
.decl A, B, C(x: agent)
.decl R, S(x: agent, y: agent)
.input A, B, C, R, S
"""
UNARY, BINARY = ("A", "B", "C"), ("R", "S")

#: A literal: the predicate, its variables (None is `_`), and whether it holds; or `=` with two variables.
Clause = tuple[str, tuple[str, ...], list[tuple[str, tuple[str | None, ...], bool]]]


def random_clauses(chance: random.Random, past: bool = False) -> tuple[str, list[Clause], dict[str, int]]:
    """Return declarations, clauses in the order of strata, and the arities of derived predicates."""
    arities: dict[str, int] = {}
    clauses: list[Clause] = []
    text = ""
    known = dict.fromkeys(UNARY, 1) | dict.fromkeys(BINARY, 2)
    for number in range(chance.randint(2, 4)):
        name, arity = f"D{number}", chance.choice([1, 1, 2])
        for _ in range(chance.randint(1, 3)):
            variables = ["X", "Y", "Z"][: chance.randint(arity, 3)]
            head: tuple[str, ...] = ("X",) if arity == 1 else chance.choice([("X", "Y"), ("Y", "X"), ("X", "X")])
            body: list[tuple[str, tuple[str | None, ...], bool]] = []
            for variable in variables:
                chosen = chance.choice([*known])
                others = [variable, *(chance.choice(variables) for _ in range(known[chosen] - 1))]
                chance.shuffle(others)
                body.append((chosen, tuple(others), True))
            for _ in range(chance.randint(0, 3)):
                chosen, holds = chance.choice([*known, "="]), chance.random() < 0.5
                if chosen == "=":
                    body.append(("=", (chance.choice(variables), chance.choice(variables)), holds))
                    continue
                places: list[str | None] = [chance.choice(variables) for _ in range(known[chosen])]
                if chance.random() < 0.3:
                    places[-1] = None
                body.append((chosen, tuple(places), holds))
            clauses.append((name, head, body))
        arities[name] = known[name] = arity
        text += f".decl {name}({', '.join(f'c{column}: agent' for column in range(arity))})\n.output {name}\n"
    operators = ["once[1,2] ", "previous ", "historically[1,2] ", "for[2] ", "once "]
    for name, head, body in clauses:
        literals = []
        for predicate, terms, holds in body:
            if predicate == "=":
                literals.append(f"{terms[0]} {'=' if holds else '!='} {terms[1]}")
                continue
            atom = f"{predicate}({', '.join(term or '_' for term in terms)})"
            if past and chance.random() < 0.3:
                atom = chance.choice(operators) + atom
            elif past and chance.random() < 0.1 and len(terms) == 1:
                atom = f"A({terms[0] or '_'}) since[1,2] {atom}" if terms[0] else atom
            literals.append(atom if holds else f"Not({atom})")
        text += f"{name}({', '.join(head)}) :- {', '.join(literals)}.\n"
    return DECLARED + text, clauses, arities


def facts(shape: tuple[int, ...], seed: int, crisp: bool, dtype: Any = None) -> tuple[Any, Any]:
    """Return random degrees: unary of `shape` with three columns, and binary with two."""
    generator = torch.Generator().manual_seed(seed)
    unary = torch.rand(*shape, len(UNARY), generator=generator, dtype=dtype)
    binary = torch.rand(*shape, shape[-1], len(BINARY), generator=generator, dtype=dtype)
    return ((unary < 0.5).to(unary), (binary < 0.4).to(binary)) if crisp else (unary, binary)


def insert(session: Session, unary: Any, binary: Any, sign: bool = True) -> None:
    """Insert or retract the facts of one scene."""
    change = session.insert if sign else session.retract
    for column, name in enumerate(UNARY):
        change(name, [(f"e{x}",) for x in range(len(unary)) if unary[x, column] > 0.5])
    for column, name in enumerate(BINARY):
        rows = itertools.product(range(len(unary)), repeat=2)
        change(name, [(f"e{x}", f"e{y}") for x, y in rows if binary[x, y, column] > 0.5])


def derived(session: Session, name: str, arity: int, count: int) -> Any:
    """Return the rows of a predicate as degrees."""
    degrees = torch.zeros([count] * arity)
    for row in session.rows(name):
        degrees[tuple(int(str(entity)[1:]) for entity in row)] = 1.0
    return degrees


def combine(semantics: str, degrees: list[float], conjunction: bool) -> float:
    """Return the conjunction or disjunction of degrees."""
    if semantics == "godel":
        return min(degrees, default=1.0) if conjunction else max(degrees, default=0.0)
    if semantics == "product":
        return math.prod(degrees) if conjunction else 1 - math.prod(1 - degree for degree in degrees)
    if conjunction:
        total = 1.0
        for degree in degrees:
            total = max(0.0, total + degree - 1)
        return total
    return min(1.0, sum(degrees))


def by_definition(clauses: list[Clause], arities: dict[str, int], unary: Any, binary: Any, semantics: str) -> Any:
    """Return the degrees of all derived atoms by loops over entities."""
    count = len(unary)
    values: dict[str, Any] = {name: unary[:, at].tolist() for at, name in enumerate(UNARY)}
    values |= {name: binary[..., at].tolist() for at, name in enumerate(BINARY)}

    def degree(name: str, row: tuple[int, ...]) -> float:
        found: Any = values[name]
        for entity in row:
            found = found[entity]
        return float(found)

    for name, arity in arities.items():
        found = torch.zeros(*[count] * arity, dtype=torch.float64)
        for row in itertools.product(range(count), repeat=arity):
            of_clauses = []
            for head_name, head, body in clauses:
                if head_name != name:
                    continue
                variables = list(dict.fromkeys([*head, *(term for _, terms, _ in body for term in terms if term)]))
                # Each `_` of a positive literal is a variable of its own.
                atoms = []
                for number, (predicate, terms, holds) in enumerate(body):
                    if holds and None in terms:
                        variables.append(f"_{number}")
                        terms = tuple(term or f"_{number}" for term in terms)
                    atoms.append((predicate, terms, holds))
                bodies = []
                for entities in itertools.product(range(count), repeat=len(variables)):
                    at = dict(zip(variables, entities, strict=True))
                    if tuple(at[variable] for variable in head) != row:
                        continue
                    literals = []
                    for predicate, terms, holds in atoms:
                        if predicate == "=":
                            value = float(at[terms[0] or ""] == at[terms[1] or ""])
                        else:
                            free = [range(count) if term is None else [at[term]] for term in terms]
                            options = [degree(predicate, chosen) for chosen in itertools.product(*free)]
                            value = options[0] if None not in terms else combine(semantics, options, False)
                        literals.append(value if holds else 1 - value)
                    bodies.append(combine(semantics, literals, True))
                of_clauses.append(combine(semantics, bodies, False))
            found[row] = combine(semantics, of_clauses, False)
        values[name] = found.tolist()
    return {name: torch.tensor(values[name]) for name in arities}


@pytest.mark.parametrize("semantics", [*SEMANTICS, *EXACT])
def test_degrees_0_and_1_are_the_rules(semantics: Any) -> None:
    held = total = 0
    for seed in range(40):
        text, _, arities = random_clauses(random.Random(seed))
        program = Program(text)
        layer = RuleLayer(program, semantics, queries=arities)
        unary, binary = facts((6, 4), seed, True)
        _, found = layer.degrees(unary, binary)
        for at in range(len(unary)):
            session = Session(program)
            insert(session, unary[at], binary[at])
            session.commit()
            for name, arity in arities.items():
                expected = derived(session, name, arity, 4)
                assert torch.equal(found[name][at], expected), text
                held, total = held + int(expected.sum()), total + expected.numel()
    assert 0.1 * total < held < 0.9 * total


@pytest.mark.parametrize("semantics", SEMANTICS)
def test_degrees_are_those_of_the_definition(semantics: Any) -> None:
    for seed in range(12):
        text, clauses, arities = random_clauses(random.Random(100 + seed))
        layer = RuleLayer(Program(text), semantics, queries=arities)
        unary, binary = facts((1, 3), seed, False, torch.float64)
        _, found = layer.degrees(unary**2, binary**2)
        expected = by_definition(clauses, arities, unary[0] ** 2, binary[0] ** 2, semantics)
        for name in arities:
            torch.testing.assert_close(found[name][0], expected[name].double())


@pytest.mark.parametrize("semantics", SEMANTICS)
def test_gradients_are_right(semantics: Any) -> None:
    for seed in range(6):
        text, _, arities = random_clauses(random.Random(200 + seed))
        layer = RuleLayer(Program(text), semantics, queries=arities, learn_weights=True).double()
        unary, binary = (each.requires_grad_() for each in facts((2, 3), seed, False, torch.float64))

        def run(*given: Any, layer: Any = layer) -> Any:
            return tuple(layer.degrees(*given[:2])[1].values())

        assert torch.autograd.gradcheck(run, (unary, binary, layer.weight_logits))


@pytest.mark.parametrize("semantics", ["godel", "product", "exact"])
def test_second_derivatives_are_refused(semantics: Any) -> None:
    text = DECLARED + ".decl D(x: agent)\nD(X) :- A(X), B(X).\nD(X) :- B(X), Not(A(X)).\n"
    layer = RuleLayer(Program(text), semantics, queries=["D"])
    unary, binary = facts((1, 2), 0, False, torch.float64)
    degrees = layer.degrees(unary.requires_grad_(), binary)[1]["D"].sum()
    with pytest.raises(RuntimeError, match="RuleLayer has no second derivatives"):
        torch.autograd.grad(degrees, unary, create_graph=True)


def test_gradients_are_right_where_facts_are_certain() -> None:
    layer = RuleLayer(Program(DECLARED + ".decl D(x: agent)\nD(X) :- A(X), R(X, Y), B(Y).\n"), "product", queries=["D"])
    for seed in range(5):
        unary, binary = facts((3, 3), seed, True, torch.float64)
        unary.requires_grad_(), binary.requires_grad_()
        layer.degrees(unary, binary)[1]["D"].sum().backward()
        # The degree is linear in the facts of B and R, which occur once in the disjunction.
        for given in (unary, binary):
            for at in itertools.product(*map(range, given.shape)):
                if given is unary and UNARY[at[-1]] == "A":
                    continue
                ends = []
                for degree in (0.0, 1.0):
                    changed = [unary.detach().clone(), binary.detach().clone()]
                    changed[given is binary][at] = degree
                    ends.append(layer.degrees(*changed)[1]["D"].sum())
                assert given.grad[at] == pytest.approx(float(ends[1] - ends[0]))


@pytest.mark.parametrize("semantics", [*SEMANTICS, *EXACT])
def test_windows_of_time_are_those_of_sessions(semantics: Any) -> None:
    compared = 0
    for seed in range(30):
        text, _, arities = random_clauses(random.Random(300 + seed), past=True)
        program = Program(text)
        layer = RuleLayer(program, semantics, queries=arities)
        if not layer.temporal:
            continue
        compared += 1
        unary, binary = facts((2, 5, 3), seed, True)
        _, found = layer.degrees(unary, binary)
        for at in range(2):
            session = Session(program)
            for tick in range(5):
                insert(session, unary[at, tick], binary[at, tick])
                if tick:
                    insert(
                        session,
                        unary[at, tick - 1] * (1 - unary[at, tick]),
                        binary[at, tick - 1] * (1 - binary[at, tick]),
                        False,
                    )
                session.commit() if not tick else session.advance()
                for name, arity in arities.items():
                    assert torch.equal(found[name][at, tick], derived(session, name, arity, 3)), (
                        seed,
                        tick,
                        name,
                        text,
                    )
    assert compared > 15


@pytest.mark.parametrize("mode", ["easy", "expert", "vap-hard"])
@pytest.mark.parametrize("semantics", SEMANTICS)
def test_egos_are_a_part_of_all(mode: str, semantics: Any) -> None:
    layer = RuleLayer(f"rules/{mode}.dl", semantics)
    generator = torch.Generator().manual_seed(0)
    unary = torch.rand(4, 6, len(layer.unary), generator=generator)
    binary = torch.rand(4, 6, 6, len(layer.binary), generator=generator)
    mask = torch.rand(4, 6, generator=generator) < 0.8
    everyone = layer(unary, binary, mask)
    assert everyone.shape == (4, 6, 4) and layer.actions == PRIORITY
    for egos in ([0], [2, 5], [-1]):
        torch.testing.assert_close(layer(unary, binary, mask, egos), everyone[:, egos])
    # Absent entities do not matter.
    unary[~mask] = 0.7
    binary[~mask] = 0.3
    binary.transpose(1, 2)[~mask] = 0.9
    torch.testing.assert_close(layer(unary, binary, mask), everyone)
    if semantics != "lukasiewicz":
        answers = everyone.sum(-1) if semantics == "product" else everyone.amax(-1)
        assert (answers > 0.49).all()


def test_the_order_of_actions_is_that_of_the_configuration() -> None:
    read = yaml.safe_load((ROOT / "configs" / "common.yaml").read_text())
    assert list(PRIORITY) == read["actions"]["priority"] and read["actions"]["default"] == DEFAULT


def test_answers_follow_the_priority() -> None:
    text = '.include "vocabulary.dl"\nStop(X) :- IsAtInter(X).\nSlow(X) :- IsTiro(X).\n'
    unary, binary = torch.zeros(1, 2, 11), torch.zeros(1, 2, 2, 7)
    layer = RuleLayer(Program(text))
    unary, binary = torch.zeros(1, 2, len(layer.unary)), torch.zeros(1, 2, 2, len(layer.binary))
    unary[0, 0, layer.unary.index("IsAtInter")], unary[0, 0, layer.unary.index("IsTiro")] = 0.6, 0.5
    answer, found = layer.degrees(unary, binary, egos=[0])
    assert answer[0, 0].tolist() == pytest.approx([0.6, 0.4 * 0.5, 0.0, 0.4 * 0.5])
    assert found["Stop"].tolist() == [[pytest.approx(0.6)]] and found["Slow"].tolist() == [[0.5]]
    other = RuleLayer(Program(text), priority=("Slow", "Stop"), default="Fast")
    assert other.actions == ("Slow", "Stop", "Fast")
    assert other(unary, binary, egos=[0])[0, 0].tolist() == pytest.approx([0.5, 0.5 * 0.6, 0.5 * 0.4])


def test_the_default_is_what_the_others_leave() -> None:
    # Rules without clauses for Slow and Fast, whose negations the clause of Normal names nevertheless.
    layer = RuleLayer(Program('.include "vocabulary.dl"\nStop(X) :- IsAtInter(X).\n'), priority=("Normal", "Stop"))
    unary = torch.zeros(1, 1, len(layer.unary))
    unary[..., layer.unary.index("IsAtInter")] = 0.25
    answer = layer(unary, torch.zeros(1, 1, 1, len(layer.binary)))
    assert answer[0, 0].tolist() == pytest.approx([0.75, 0.25]) and layer.actions == ("Normal", "Stop")


def test_probabilities_and_weights_are_conjuncts() -> None:
    text = DECLARED + ".decl D, E(x: agent)\n0.8 :: D(X) :- A(X).\n0.3 :: D(X); 0.5 :: E(X) :- B(X).\n"
    layer: Any = RuleLayer(Program(text), queries=["D", "E"], learn_weights=True)
    unary, binary = torch.zeros(1, 1, 3), torch.zeros(1, 1, 1, 2)
    unary[..., 0], unary[..., 1] = 0.5, 1.0
    assert layer.weights() is not None and layer.weights().shape == (3,) and len(layer.clauses) == 3
    with torch.no_grad():
        layer.weight_logits.copy_(torch.tensor([0.0, 100.0, 100.0]))
    found = layer.degrees(unary, binary)[1]
    assert found["D"].item() == pytest.approx(1 - (1 - 0.5 * 0.8 * 0.5) * (1 - 0.3))
    assert found["E"].item() == pytest.approx(0.5)
    found["D"].sum().backward()
    assert layer.weight_logits.grad.abs().gt(0).tolist() == [True, False, False]


@pytest.mark.parametrize("semantics", [*SEMANTICS, *EXACT])
def test_predicates_may_have_no_column_or_three(semantics: Any) -> None:
    text = (
        DECLARED
        + """
    .decl Jam()
    .decl Chain(x: agent, y: agent, z: agent)
    .decl D(x: agent)
    Jam() :- A(X), B(X).
    Chain(X, Y, Z) :- R(X, Y), S(Y, Z), X != Z.
    D(X) :- C(X), Not(Jam()).
    D(Y) :- Chain(X, Y, _), Jam().
    D(Z) :- Chain(X, X, Z).
    """
    )
    program, arities = Program(text), {"Jam": 0, "Chain": 3, "D": 1}
    layer = RuleLayer(program, semantics, queries=arities)
    unary, binary = facts((20, 3), 7, True)
    found = layer.degrees(unary, binary)[1]
    for at in range(len(unary)):
        session = Session(program)
        insert(session, unary[at], binary[at])
        session.commit()
        for name, arity in arities.items():
            assert torch.equal(found[name][at], derived(session, name, arity, 3)), name


@pytest.mark.parametrize("semantics", ["product", *EXACT])
def test_copies_are_equal(semantics: Any) -> None:
    layer: Any = RuleLayer("rules/expert.dl", semantics, learn_weights=True, k=3)
    with torch.no_grad():
        layer.weight_logits.normal_()
    # Diagrams of two entities about which nothing is certain, with weights, are too large.
    count = 1 if semantics == "exact" else 4
    unary, binary = torch.rand(2, count, len(layer.unary)), torch.rand(2, count, count, len(layer.binary))
    for other in (copy.deepcopy(layer), pickle.loads(pickle.dumps(layer))):
        assert torch.equal(other(unary, binary), layer(unary, binary))
    fresh = RuleLayer("rules/expert.dl", semantics, learn_weights=True, k=3)
    fresh.load_state_dict(layer.state_dict())
    assert torch.equal(fresh(unary, binary), layer(unary, binary))


def test_recursion_has_a_depth() -> None:
    text = DECLARED + ".decl P(x: agent, y: agent)\nP(X, Y) :- R(X, Y).\nP(X, Z) :- P(X, Y), R(Y, Z).\n"
    with pytest.raises(ValueError, match="`P` is recursive: give the `depth`"):
        RuleLayer(Program(text), queries=["P"])
    unary, binary = facts((3, 5), 1, True)
    # The engine needs no depth.
    exact: list[Any] = [RuleLayer(Program(text), name, queries=["P"]) for name in ("exact", "top-k")]
    every = [layer.degrees(unary, binary)[1]["P"] for layer in exact]
    for depth in (1, 2, 4):
        layer = RuleLayer(Program(text), "godel", queries=["P"], depth=depth)
        edges = binary[..., 0] > 0.5
        reached = edges
        for _ in range(depth - 1):
            reached = edges | ((reached.float() @ edges.float()) > 0)
        assert torch.equal(layer.degrees(unary, binary)[1]["P"] > 0.5, reached)
        # Paths between five entities have at most four edges.
        assert depth < 4 or all(torch.equal(each > 0.5, reached) for each in every)


@pytest.mark.parametrize("dtype", [torch.bfloat16, torch.float16, torch.float64])
@pytest.mark.parametrize("semantics", ["product", "exact"])
def test_precisions(dtype: Any, semantics: Any) -> None:
    layer = RuleLayer("rules/expert.dl", semantics)
    unary, binary = torch.rand(2, 2, len(layer.unary)), torch.rand(2, 2, 2, len(layer.binary))
    expected = layer(unary, binary)
    found = layer(unary.to(dtype).requires_grad_(), binary.to(dtype))
    assert found.dtype == dtype
    torch.testing.assert_close(found.float(), expected, atol=0.05, rtol=0)
    found.sum().backward()


@pytest.mark.filterwarnings("ignore:The .grad attribute of a Tensor:UserWarning")
@pytest.mark.parametrize("semantics", [*SEMANTICS, "exact"])
def test_compiled_layers_are_equal(semantics: Any) -> None:
    layer = RuleLayer("rules/expert.dl", semantics)
    unary, binary = torch.rand(2, 2, len(layer.unary)), torch.rand(2, 2, 2, len(layer.binary))
    # The engine computes exact probabilities, which PyTorch calls between two graphs, about which it may warn.
    compiled = torch.compile(layer, backend="aot_eager", fullgraph=semantics != "exact")
    given = [(unary.clone().requires_grad_(), run) for run in (layer, compiled)]
    answers = [run(each, binary) for each, run in given]
    torch.testing.assert_close(answers[0], answers[1])
    for answer in answers:
        answer[..., 0].sum().backward()
    torch.testing.assert_close(given[0][0].grad, given[1][0].grad)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("D(X) :- A(X), n = count : { R(X, Y) }, n > 2.", r"rules.dl:\d+:1: .*it aggregates"),
        ("D(X) :- A(X), V(X, n), n > 2.", "it reads values of `V`"),
        ('D(X) :- R(X, "e1").', "it names a constant"),
        ('D("e1"). D(X) :- A(X).', "it is a fact about constants"),
        ('D(X) :- A(X), X = "e1".', "it names a constant"),
        ("D(X) :- A(X), T(X, Y, Z).", "it reads `T`, an input over 3 entities"),
    ],
)
def test_clauses_without_degrees_are_refused(text: str, message: str) -> None:
    declared = ".decl V(x: agent, n: number)\n.decl T(x: agent, y: agent, z: agent)\n.input V, T\n.decl D(x: agent)\n"
    with pytest.raises(ValueError, match=message):
        RuleLayer(Program(DECLARED + declared + text, "rules.dl"), queries=["D"])
    # Clauses on which nothing depends may be of any kind.
    RuleLayer(Program(DECLARED + declared + text, "rules.dl"))


def test_faulty_arguments_are_reported() -> None:
    layer = RuleLayer("rules/easy.dl")
    unary, binary = torch.zeros(2, 3, len(layer.unary)), torch.zeros(2, 3, 3, len(layer.binary))
    for arguments, message in [
        ((unary[..., 1:], binary), r"unary: expected the shape \(B, N, "),
        ((unary, binary[:, :2]), r"binary: expected the shape \(2, 3, 3, "),
        ((unary, binary, unary), r"mask: expected the shape \(2, 3\)"),
        ((unary, binary, None, [3]), "egos: there are 3 entities, so 3 does not exist"),
        ((unary, binary, None, [-4]), "egos: there are 3 entities, so -4 does not exist: expected -3 to 2"),
        ((unary, binary, None, []), "egos: expected at least one entity"),
        ((unary[:, :0], binary[:, :0, :0], None, [0]), "egos: there are 0 entities"),
        ((unary.bool(), binary), "unary: expected degrees of a floating-point type, not torch.bool"),
    ]:
        with pytest.raises(ValueError, match=message):
            layer(*arguments)
    with pytest.raises(ValueError, match="expected one of godel, product, lukasiewicz, exact, top-k, not 'fuzzy'"):
        RuleLayer("rules/easy.dl", "fuzzy")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="k: expected at least 1, not 0"):
        RuleLayer("rules/easy.dl", "top-k", k=0)
    with pytest.raises(ValueError, match="nodes_max: expected at least 1, not 0"):
        RuleLayer("rules/easy.dl", "exact", nodes_max=0)
    with pytest.raises(ValueError, match="priority: expected a sequence of actions, not the string 'Stop'"):
        RuleLayer("rules/easy.dl", priority="Stop")
    with pytest.raises(ValueError, match=r"priority: the rules declare no action `Stpo`; did you mean `Stop`\?"):
        RuleLayer("rules/easy.dl", priority=("Stpo", "Slow"))
    with pytest.raises(ValueError, match="priority: `IsCar` is an input, not an action"):
        RuleLayer("rules/easy.dl", priority=("IsCar",))
    for default, message in [
        ("Norml", r"the rules declare no action `Norml`; did you mean `Normal`\?"),
        ("IsCar", "`IsCar` is an input, not an action"),
        ("HigherPri", "`HigherPri` is not a predicate over one entity"),
    ]:
        with pytest.raises(ValueError, match=f"^default: {message}"):
            RuleLayer("rules/easy.dl", default=default)
    assert RuleLayer("rules/easy.dl", default="Wait").actions[-1] == "Wait"
    with pytest.raises(ValueError, match=r"no predicate `Stopp`; did you mean `Stop`\?"):
        RuleLayer("rules/easy.dl", queries=["Stopp"])
    with pytest.raises(ValueError, match="queries: expected a sequence of predicates, not the string 'Stop'"):
        RuleLayer("rules/easy.dl", queries="Stop")
    with pytest.raises(ValueError, match="no predicate `Halt`"):
        RuleLayer("rules/easy.dl", queries=["Halt"])
    with pytest.raises(ValueError, match="no clause derives `IsCar`"):
        RuleLayer("rules/easy.dl", queries=["IsCar"])
    with pytest.raises(ValueError, match="depth: expected at least 1"):
        RuleLayer("rules/easy.dl", depth=0)


def test_arguments_of_other_types_are_reported() -> None:
    layer = RuleLayer("rules/easy.dl")
    unary, binary = torch.zeros(2, 3, len(layer.unary)), torch.zeros(2, 3, 3, len(layer.binary))
    for arguments, message in [
        ((unary.numpy(), binary), "unary: expected torch.Tensor, not ndarray"),
        ((unary, binary.tolist()), "binary: expected torch.Tensor, not list"),
        ((unary, binary, [[1, 1, 1]] * 2), "mask: expected torch.Tensor, not list"),
        ((unary, binary, None, 0), "egos: expected a sequence of integers, not int"),
        ((unary, binary, None, "Car_1"), "egos: expected a sequence of integers, not str"),
        ((unary, binary, None, ["Car_1"]), "egos: expected an integer, not str"),
        ((unary, binary, None, [True, False, False]), "egos: expected an integer, not bool"),
    ]:
        with pytest.raises(TypeError, match=f"^{message}"):
            layer(*arguments)
    for egos in (range(1, 3), np.array([1, 2]), torch.tensor([1, 2])):
        assert torch.equal(layer(unary, binary, egos=egos), layer(unary, binary, egos=[1, 2]))
    with pytest.raises(TypeError, match="^unary: expected torch.Tensor, not list"):
        layer.proofs(unary[0].tolist(), binary[0], action="Stop")
    for name, value, message in [
        ("rules", 5, "expected str or os.PathLike"),
        ("priority", 5, "expected a sequence of actions, not int"),
        ("queries", [5], "expected str, not int"),
        ("default", None, "expected str, not NoneType"),
        ("depth", "3", "expected an integer, not str"),
        ("k", 1.5, "expected an integer, not float"),
        ("nodes_max", None, "expected an integer, not NoneType"),
    ]:
        given: dict[str, Any] = {"rules": "rules/easy.dl", name: value}
        with pytest.raises(TypeError, match=f"^{name}: {message}"):
            RuleLayer(**given)


@pytest.mark.parametrize("semantics", EXACT)
def test_probabilities_out_of_range_are_refused(semantics: Any) -> None:
    layer = RuleLayer("rules/easy.dl", semantics)
    unary, binary = torch.zeros(1, 2, len(layer.unary)), torch.zeros(1, 2, 2, len(layer.binary))
    for name, value in itertools.product(("unary", "binary"), (1.5, -0.25, math.nan, math.inf)):
        given = {"unary": unary.clone(), "binary": binary.clone()}
        given[name].view(-1)[-1] = value
        with pytest.raises(ValueError, match=f"^{name}: expected probabilities from 0 to 1, not {value}$"):
            layer(**given)
        with pytest.raises(ValueError, match=f"^{name}: expected probabilities"):
            layer.proofs(given["unary"][0], given["binary"][0], action="Stop")
    with pytest.raises(ValueError, match="ego: there are 2 entities, so -3 does not exist: expected -2 to 1"):
        layer.proofs(unary[0], binary[0], action="Stop", ego=-3)


@pytest.mark.parametrize("semantics", [*SEMANTICS, *EXACT])
def test_scenes_may_lack_entities_but_not_ticks(semantics: Any) -> None:
    layer = RuleLayer("expert", semantics)
    unary, binary = torch.zeros(2, 0, len(layer.unary)), torch.zeros(2, 0, 0, len(layer.binary))
    assert layer(unary, binary).shape == (2, 0, 4)
    past = RuleLayer(Program(DECLARED + ".decl Stop(x: agent)\nStop(X) :- once A(X), B(X).\n"), semantics)
    with pytest.raises(ValueError, match="unary: expected at least one tick"):
        past(torch.zeros(2, 0, 3, 3), torch.zeros(2, 0, 3, 3, 2))


def test_bare_names_are_built_in_rule_files() -> None:
    assert RuleLayer("easy").clauses == RuleLayer("rules/easy.dl").clauses
    with pytest.raises(FileNotFoundError, match="cannot read `esay`"):
        RuleLayer("esay")


def uncertain_facts(seed: int, count: int, uncertain: int, ticks: tuple[int, ...] = ()) -> tuple[Any, Any]:
    """Return facts of which some are uncertain, with probabilities from 0.2 to 0.8."""
    unary, binary = facts((1, *ticks, count), seed, True, torch.float64)
    generator = torch.Generator().manual_seed(seed)
    for _ in range(uncertain):
        for given in (unary, binary):
            at = tuple(int(torch.randint(length, (), generator=generator)) for length in given.shape)
            given[at] = 0.2 + 0.6 * torch.rand((), generator=generator, dtype=torch.float64)
    return unary, binary


def marginals(session: Session, name: str, unary: Any, binary: Any) -> dict[tuple[int, ...], float]:
    """Return the probabilities of the rows of a predicate, by the entities."""
    uncertain: dict[str, list[tuple[tuple[str, ...], float]]] = {}
    for given, names in ((unary, UNARY), (binary, BINARY)):
        for at in itertools.product(*map(range, given.shape)):
            if given[at] > 0:
                row = tuple(f"e{entity}" for entity in at[:-1])
                uncertain.setdefault(names[at[-1]], []).append((row, float(given[at])))
    found = session.marginals(name, uncertain=uncertain)
    return {tuple(int(str(entity)[1:]) for entity in row): value for row, value in found.rows[name].items()}


@pytest.mark.parametrize("semantics", EXACT)
def test_exact_degrees_are_marginals(semantics: Any) -> None:
    compared = 0
    for seed in range(30):
        text, _, arities = random_clauses(random.Random(400 + seed))
        program = Program(text)
        layer = RuleLayer(program, semantics, queries=arities, k=10_000)
        unary, binary = uncertain_facts(seed, 3, 3)
        found = layer.degrees(unary, binary)[1]
        for name, arity in arities.items():
            expected = torch.zeros([3] * arity, dtype=torch.float64)
            for row, value in marginals(Session(program), name, unary[0], binary[0]).items():
                expected[row] = value
            torch.testing.assert_close(found[name][0], expected)
            compared += int(((expected > 0) & (expected < 1)).sum())
    assert compared > 100


@pytest.mark.parametrize("semantics", EXACT)
@pytest.mark.parametrize("past", [False, True])
def test_exact_gradients_are_right(semantics: Any, past: bool) -> None:
    for seed in range(8):
        text, _, arities = random_clauses(random.Random(500 + seed), past=past)
        layer: Any = RuleLayer(Program(text), semantics, queries=arities, k=1000, learn_weights=True).double()
        unary, binary = uncertain_facts(seed, 3, 3, (3,) if layer.temporal else ())
        places = [(given > 0) & (given < 1) for given in (unary, binary)]
        free = [given[place].requires_grad_() for given, place in zip((unary, binary), places, strict=True)]

        def run(*parts: Any, layer: Any = layer, given: Any = (unary, binary), places: Any = places) -> Any:
            full = [
                each.detach().masked_scatter(place, part)
                for each, place, part in zip(given, places, parts, strict=False)
            ]
            return tuple(layer.degrees(*full)[1].values())

        assert torch.autograd.gradcheck(run, (*free, layer.weight_logits))


def test_proofs_are_the_most_probable_reasons() -> None:
    text = (
        DECLARED
        + """.decl Stop(x: agent)
    .decl Slow(x: agent)
    Stop(X) :- R(X, Y), Not(B(Y)).
    Slow(X) :- A(X), Not(Stop(X)).
    """
    )
    layer = RuleLayer(Program(text), "exact")
    unary, binary = torch.zeros(3, 3), torch.zeros(3, 3, 2)
    unary[0, 0], unary[1, 1] = 0.9, 0.3
    binary[0, 1, 0], binary[0, 2, 0] = 0.5, 0.25
    proofs = layer.proofs(unary, binary, action="Stop")
    assert [proof.literals for proof in proofs] == [("not B(e1)", "R(e0, e1)"), ("R(e0, e2)",)]
    assert [proof.probability for proof in proofs] == pytest.approx([0.5 * 0.7, 0.25])
    best = layer.proofs(unary, binary, action="Slow")[0]
    assert best.probability == pytest.approx(0.9 * 0.5 * 0.75)
    assert set(best.literals) == {"A(e0)", "not R(e0, e1)", "not R(e0, e2)"}
    answer = layer(unary[None], binary[None], egos=[0])[0, 0]
    assert answer[0].item() == pytest.approx(1 - (1 - 0.5 * 0.7) * 0.75)
    assert layer.proofs(unary, binary, ego=1, action="Normal")[0].probability == 1
    with pytest.raises(ValueError, match="action: expected one of Stop, Slow, Fast, Normal, not 'Go'"):
        layer.proofs(unary, binary, action="Go")
    with pytest.raises(ValueError, match="ego: there are 3 entities, so 3 does not exist"):
        layer.proofs(unary, binary, ego=3, action="Stop")
    with pytest.raises(ValueError, match="unary: proofs concern one scene"):
        layer.proofs(unary[None], binary[None], action="Stop")
    for given in (unary * float("nan"), unary / 0):
        for call in (
            lambda given=given: layer(given[None], binary[None]),
            lambda g=given: layer.proofs(g, binary, action="Stop"),
        ):
            with pytest.raises(ValueError, match="unary: expected probabilities from 0 to 1, not (nan|inf)"):
                call()
    # With one proof, what may derive Stop otherwise is not considered.
    few = RuleLayer(Program(text), "top-k", k=1)
    assert few.proofs(unary, binary, action="Slow")[0].literals == ("A(e0)", "not R(e0, e1)")


def test_proofs_look_back() -> None:
    text = DECLARED + ".decl Stop(x: agent)\nStop(X) :- once[1,2] A(X), Not(B(X)).\n"
    layer = RuleLayer(Program(text), "top-k")
    for ticks in (1, 2, 3):
        unary, binary = torch.zeros(ticks, 1, 3), torch.zeros(ticks, 1, 1, 2)
        unary[:, 0, 0], unary[-1, 0, 1] = 0.5, 0.25
        proofs = layer.proofs(unary, binary, action="Stop")
        last = ticks - 1
        expected = [{f"A(e0) in tick {tick}", f"not B(e0) in tick {last}"} for tick in range(last)]
        assert [set(proof.literals) for proof in proofs] == expected


def test_kept_circuits_do_not_depend_on_other_scenes() -> None:
    layer = RuleLayer("rules/expert.dl", "exact")
    generator = torch.Generator().manual_seed(0)
    given = []
    for count in (2, 3, 2, 3):
        unary = torch.rand(3, count, len(layer.unary), generator=generator).round(decimals=0).double()
        binary = torch.rand(3, count, count, len(layer.binary), generator=generator).round(decimals=0).double()
        unary[:, :, 9:] = 0.3 + 0.4 * torch.rand(3, count, 2, generator=generator)
        given.append((unary, binary, torch.rand(3, count, generator=generator) < 0.8))
    fresh = [RuleLayer("rules/expert.dl", "exact")(*each) for each in given]
    for _ in range(2):
        for each, expected in zip(given, fresh, strict=True):
            assert torch.equal(layer(*each), expected)


@pytest.mark.parametrize("semantics", EXACT)
def test_kept_circuits_tell_absent_entities_apart(semantics: Any) -> None:
    text = DECLARED + ".decl Stop(x: agent)\nStop(X) :- A(X).\n"
    layer = RuleLayer(Program(text), semantics)
    unary, binary = torch.tensor([[[0.5, 0.0, 0.0]]]), torch.zeros(1, 1, 1, 2)
    for mask, expected in ((None, 0.5), (torch.zeros(1, 1), 0.0), (torch.ones(1, 1), 0.5), (torch.zeros(1, 1), 0.0)):
        assert layer(unary, binary, mask)[0, 0, 0] == expected


def test_queries_of_too_many_rows_are_refused() -> None:
    text = DECLARED + ".decl P(a: agent, b: agent, c: agent, d: agent)\nP(A, B, C, D) :- R(A, B), R(C, D).\n"
    layer = RuleLayer(Program(text), "exact", queries=["P"])
    with pytest.raises(ValueError, match="queries: `P` has 2560000 rows over 40 entities"):
        layer.degrees(torch.zeros(1, 40, 3), torch.zeros(1, 40, 40, 2))


def test_large_diagrams_are_refused() -> None:
    layer = RuleLayer("rules/expert.dl", "exact", nodes_max=100)
    unary, binary = torch.full((1, 4, len(layer.unary)), 0.5), torch.full((1, 4, 4, len(layer.binary)), 0.5)
    with pytest.raises(ValueError, match="`nodes_max`.*`top-k`"):
        layer(unary, binary)
