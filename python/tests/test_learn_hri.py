from __future__ import annotations

import itertools
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from conftest import needs
from numpy.typing import NDArray

torch = needs("torch", "learn")
needs("gymnasium", "learn")

import logicity  # noqa: E402
from logicity.city import ACTIONS  # noqa: E402
from logicity.envs.layout import Layout  # noqa: E402
from logicity.learn import TrainConfig, hri, load_policy, train  # noqa: E402
from logicity.learn.demonstrations import layout_of  # noqa: E402
from logicity.learn.hri import HRI, HriPolicy, HriSettings, Hypothesis, ProgramTemplate  # noqa: E402

Bools = NDArray[np.bool_]


def layout(entities: int, unary: list[str], binary: list[str]) -> Layout:
    atoms = [(name, (i,)) for name in unary for i in range(entities)]
    pairs = list(itertools.product(range(entities), repeat=2))
    return Layout.of_atoms([*atoms, *((name, pair) for name in binary for pair in pairs)])


def config(mode: str = "easy", steps: int = 4, seed: int = 0, **settings: Any) -> Any:
    """Stand in for a training configuration."""
    return SimpleNamespace(
        algorithm="hri",
        mode=mode,
        observation="groundings",
        settings=HriSettings(**settings),
        steps=steps,
        seed=seed,
        overrides={},
        demonstrations=0.1,
        start=None,
    )


def scenes(random: np.random.Generator, of: Layout, count: int, density: float = 0.3) -> NDArray[np.float32]:
    """Random observations. Entities are absent with the probability one half, and no binary atom is reflexive."""
    observations = random.random((count, of.width)) < density
    for i, j in itertools.product(range(of.entities), repeat=2):
        observations[:, of.binary_at[i, j]] &= i != j
    absent = random.random((count, of.entities)) < 0.5
    for entity in range(1, of.entities):
        observations[np.ix_(absent[:, entity], of.occurrences()[:, entity] > 0)] = False
    return observations.astype(np.float32)


def slow_inference(
    program: ProgramTemplate, degrees: Any, unary: Bools, binary: Bools, exist: Bools, conjunction: str
) -> float:
    """Soft inference on one scene by loops over layers, entities and predicates, as `InventedPredicate` says."""
    n = len(exist)

    def both(a: float, b: float) -> float:
        return min(a, b) if conjunction == "min" else a * b

    values: list[dict[tuple[int, int], float]] = []
    # The unary symbols, then the binary ones.
    for negated in (False, True) if program.negation else (False,):
        for p in range(unary.shape[-1]):
            values.append({(x, y): float(unary[x, p] != negated) for x in range(n) for y in range(n)})
    values += [{(x, y): constant for x in range(n) for y in range(n)} for constant in (1.0, 0.0)]
    for negated in (False, True) if program.negation else (False,):
        for p in range(binary.shape[-1]):
            values.append({(x, y): float(binary[x, y, p] != negated) for x in range(n) for y in range(n)})
    slot = 0
    for invented in program.invented:
        held = []
        for _ in range(1 if invented.template == "Inv" else 3):
            pairs = {}
            for x, y in itertools.product(range(n), repeat=2):
                visible = values[: invented.visible]
                pairs[x, y] = sum(float(degrees[slot, p]) * value[x, y] for p, value in enumerate(visible))
            held.append(pairs)
            slot += 1
        defined = {}
        for x, y in itertools.product(range(n), repeat=2):
            if invented.template == "Inv":
                defined[x, y] = held[0][y, x]
                continue
            one, two, alternative = held
            if invented.template == "A00+":
                defined[x, y] = max(max(both(one[x, z], two[z, x]), alternative[x, z]) for z in range(n) if exist[z])
            elif invented.template == "B00+":
                chain = max(both(one[x, z], two[z, y]) for z in range(n) if exist[z])
                defined[x, y] = max(chain, alternative[x, y])
            else:
                defined[x, y] = max(both(one[x, y], two[y, x]), alternative[x, y])
        values.append(defined)
    return values[-1][0, 0]


@pytest.mark.parametrize("conjunction", ["min", "product"])
@pytest.mark.parametrize(
    "settings",
    [
        HriSettings(),
        HriSettings(negation=True, depth=2),
        HriSettings(copies=2, depth=2),
        HriSettings(binary=[], depth=3),
        HriSettings(binary=["Inv", "B00+"], depth=4, negation=True),
        HriSettings(depth=1),
    ],
)
def test_soft_inference_agrees_with_loops_over_entities(settings: HriSettings, conjunction: Any) -> None:
    of = layout(3, ["P", "Q"], ["R"])
    program = ProgramTemplate(of, settings, settings.depth)
    random = np.random.default_rng(1)
    observations = scenes(random, of, 5, 0.5)
    unary, binary = hri.relations(of, observations)
    exist = hri.present(unary, binary)
    one, two = (torch.from_numpy(values).float() for values in program.facts(unary, binary))
    generator = torch.Generator().manual_seed(2)
    weights = torch.randn(2, program.slots, program.predicates, generator=generator)
    degrees = torch.softmax(weights.masked_fill(~program.visible(), -torch.inf), -1)
    fast = program.infer(degrees, one, two, torch.from_numpy(exist).float(), conjunction)
    for model, scene in itertools.product(range(2), range(5)):
        slow = slow_inference(program, degrees[model], unary[scene], binary[scene], exist[scene], conjunction)
        assert float(fast[model, scene]) == pytest.approx(slow, abs=1e-5)


def random_rules(random: np.random.Generator, program: ProgramTemplate) -> Hypothesis:
    """Random choices, which prefer predicates of lower layers to symbols."""
    first = len(program.unary) + len(program.binary)
    choices = []
    for invented in program.invented:
        for _ in range(invented.slots.start, invented.slots.stop):
            below = invented.visible > first and random.random() < 0.6
            choices.append(int(random.integers(first if below else 0, invented.visible if below else first)))
    return Hypothesis(program, tuple(choices))


def stops_by_the_engine(text: str, of: Layout, observations: NDArray[np.float32]) -> Bools:
    """Evaluate rules with the engine. All scenes are in one session, because entities see only those of their scene."""
    program = logicity.Program(text)
    session = logicity.Session(program)
    unary, binary = hri.relations(of, observations)
    exist = hri.present(unary, binary)
    for number, name in enumerate(of.unary):
        session.insert(name, [(f"s{scene}e{i}",) for scene, i in np.argwhere(unary[..., number])])
    for number, name in enumerate(of.binary):
        session.insert(name, [(f"s{s}e{i}", f"s{s}e{j}") for s, i, j in np.argwhere(binary[..., number])])
    session.insert("Sees", [(f"s{scene}e0", f"s{scene}e{i}") for scene, i in np.argwhere(exist)])
    session.commit()
    return np.array([session.contains("Stop", (f"s{scene}e0",)) for scene in range(len(observations))])


@pytest.mark.parametrize("limits", [(64, 64), (1, 64), (64, 1)])
@pytest.mark.parametrize("negation", [False, True])
def test_rules_decide_as_the_discretized_model_and_as_the_engine(
    monkeypatch: pytest.MonkeyPatch, negation: bool, limits: tuple[int, int]
) -> None:
    monkeypatch.setattr(hri, "CLAUSES", limits[0])
    monkeypatch.setattr(hri, "LITERALS", limits[1])
    of = layout_of("easy")
    settings = HriSettings(negation=negation, depth=4)
    program = ProgramTemplate(of, settings, 4)
    random = np.random.default_rng(3)
    observations = scenes(random, of, 60, 0.25)
    unary, binary = hri.relations(of, observations)
    one, two = (torch.from_numpy(values).float() for values in program.facts(unary, binary))
    exist = torch.from_numpy(hri.present(unary, binary)).float()
    shares, defined = [], 0
    for _ in range(25):
        rules = random_rules(random, program)
        holds = rules.holds(unary, binary)
        degrees = torch.nn.functional.one_hot(torch.tensor([rules.choices]), program.predicates).float()
        np.testing.assert_array_equal(program.infer(degrees, one, two, exist, "min")[0].numpy() > 0.5, holds)
        text = HriPolicy("easy", of, settings, {"Stop": rules}).rules()
        assert not [fault for fault in logicity.check(text) if fault["severity"] == "error"], text
        np.testing.assert_array_equal(stops_by_the_engine(text, of, observations), holds, err_msg=text)
        shares.append(holds.mean())
        defined += text.count(".decl")
    # The test compares something: not all rules are constant, and low limits lead to definitions.
    assert sum(0 < share < 1 for share in shares) > 8
    assert (defined > 0) == (1 in limits)


def test_clauses_are_reduced_and_variables_are_bound() -> None:
    def body(*literals: str) -> hri.Body:
        atoms = []
        for literal in literals:
            name, *variables = literal.lstrip("!").split()
            atoms.append((literal[0] != "!", name, tuple(map(int, variables))))
        return frozenset(atoms)

    assert hri._pruned([body("P 0", "R 0 10", "R 0 11", "Q 11")], 1) == [body("P 0", "R 0 10", "Q 10")]
    assert hri._pruned([body("P 0", "Q 10"), body("P 0")], 1) == [body("P 0")]
    assert hri._pruned([body("P 0", "!P 0"), body("P 0", "!P 10")], 1) == [body("P 0", "!P 10")]
    # A second argument of the head is no local variable.
    assert len(hri._pruned([body("R 0 1"), body("R 0 10")], 2)) == 1
    assert hri._pruned([body("R 0 1"), body("R 1 0")], 2) == [body("R 0 1"), body("R 1 0")]
    assert hri._clause("Stop", (0,), body("P 0", "!Q 10")) == "Stop(X) :- P(X), Not(Q(Y)), Sees(X, Y)."
    assert hri._clause("Stop", (0,), body("!P 0", "Q 10")) == "Stop(X) :- Not(P(X)), Q(Y), Sees(X, X)."
    assert hri._clause("Stop", (0,), body()) == "Stop(X) :- Sees(X, X)."


def test_a_synthetic_rule_is_learned_exactly() -> None:
    of = layout(4, ["IsBus", "IsOld", "IsAtInter", "IsInInter"], ["NextTo", "HigherPri"])
    settings = HriSettings(
        depth=2,
        restarts=8,
        batch=64,
        conjunction="product",
        temperatures=(0.1, 0.1),
        noise=(0.1, 0.1),
        embedding_rates=(0.05, 0.02),
        rule_rates=(0.05, 0.02),
    )
    random = np.random.default_rng(4)
    observations = np.concatenate([scenes(random, of, 1000, density) for density in (0.1, 0.25)])
    unary, binary = hri.relations(of, observations)
    bus, old, at, inside = np.moveaxis(unary, -1, 0)
    next_to = binary[..., 0]
    wanted = at[:, 0] & (inside | (old & next_to[:, 0])).any(1)
    program = ProgramTemplate(of, settings, settings.depth)
    examples = hri.Examples(program, of, observations, wanted, np.arange(len(wanted)) // 20)
    generator = torch.Generator().manual_seed(0)
    model = hri._ActionTrainer(program, settings, generator)
    for step in range(400):
        model.update(examples, step / 400, generator)
        if step % 50 == 49:
            model.extract(examples)
            if model.quality.reproduced == 1.0:
                break
    assert model.quality == (1.0, 1.0)
    clauses = HriPolicy("synthetic", of, settings, {"Stop": model.best}).rules().splitlines()[3:]
    assert sorted(clauses) == [
        "Stop(X) :- IsAtInter(X), IsInInter(Y).",
        "Stop(X) :- IsAtInter(X), IsOld(Y), NextTo(X, Y).",
    ]


def weights(learner: HRI) -> list[NDArray[Any]]:
    return [w.detach().numpy() for model in learner._trainers.values() for w in (model.predicates, model.rules)]


def test_an_interrupted_run_equals_an_uninterrupted_one(tmp_path: Path) -> None:
    settings = {"restarts": 2, "batch": 16, "generation": 3, "extract_every": 1}
    whole = HRI(config("expert", 8, 5, **settings))
    whole.fit(8, lambda: None)
    first = HRI(config("expert", 8, 5, **settings))
    first.fit(5, lambda: None)
    first.save(tmp_path)
    torch.rand(3)
    second = HRI(config("expert", 8, 6, **settings))
    second.restore(tmp_path)
    assert second.steps == 5
    seen = []
    second.fit(8, lambda: seen.append(second.steps))
    assert seen == [6, 7, 8]
    for one, two in zip(weights(whole), weights(second), strict=True):
        np.testing.assert_array_equal(one, two)
    assert whole.policy().rules() == second.policy().rules()
    other = HRI(config("expert", 8, 5, **{**settings, "restarts": 3}))
    with pytest.raises(ValueError, match="other settings"):
        other.restore(tmp_path)
    with pytest.raises(ValueError, match="models of other actions"):
        HRI(config("easy", 8, 5, **settings)).restore(tmp_path)
    (tmp_path / "learner.pt").write_bytes(b"no weights")
    with pytest.raises(ValueError, match="is not a checkpoint: PyTorch cannot read it"):
        other.restore(tmp_path)
    (tmp_path / "learner.pt").unlink()
    with pytest.raises(FileNotFoundError):
        other.restore(tmp_path)


def test_policies_are_saved_and_actions_have_precedence(tmp_path: Path) -> None:
    of = layout_of("expert")
    settings = HriSettings(depth=2)
    program = ProgramTemplate(of, settings, 2)
    names = [name for name, _ in program.unary]
    true, false = len(names) - 2, len(names) - 1
    models = {}
    for action, predicate in (("Stop", "IsAtInter"), ("Slow", "IsTiro"), ("Fast", "IsBus")):
        at = names.index(predicate)
        models[action] = Hypothesis(program, (*[false] * (program.slots - 3), at, true, false))
    policy = HriPolicy("expert", of, settings, models)
    policy.save(tmp_path / "policy.pt")
    loaded = HriPolicy.load(tmp_path / "policy.pt")
    assert loaded.rules() == policy.rules()
    assert policy.rules().splitlines()[2:] == [
        "",
        "Stop(X) :- IsAtInter(X).",
        "",
        "Slow(X) :- Not(Stop(X)), IsTiro(X).",
        "",
        "Fast(X) :- Not(Stop(X)), Not(Slow(X)), IsBus(X).",
    ]
    assert logicity.check(policy.rules()) == []
    observations = np.zeros((8, of.width), np.float32)
    for number, name in enumerate(("IsAtInter", "IsTiro", "IsBus")):
        observations[:, of.unary_at[0, of.unary.index(name)]] = np.arange(8) >> number & 1
    actions, state = loaded.predict(observations)
    assert state is None and actions.dtype == np.int64
    assert [ACTIONS[action] for action in actions] == [
        "Normal", "Stop", "Slow", "Stop", "Fast", "Stop", "Slow", "Stop",
    ]  # fmt: skip
    with pytest.raises(ValueError, match=r"shape \(batch, 205\), not \(8, 204\): the policy was trained in `expert`"):
        loaded.predict(observations[:, :-1])
    torch.save({"format": "another"}, tmp_path / "other.pt")
    with pytest.raises(ValueError, match="expected the format"):
        HriPolicy.load(tmp_path / "other.pt")
    plain = torch.load(tmp_path / "policy.pt", weights_only=True)
    plain["models"][0][2][0] = 10_000
    torch.save(plain, tmp_path / "other.pt")
    with pytest.raises(ValueError, match="is not a policy of hri"):
        HriPolicy.load(tmp_path / "other.pt")
    plain["models"][0] = ("Stop", 17, [])
    torch.save(plain, tmp_path / "other.pt")
    with pytest.raises(ValueError, match="expected 1 to 16 layers, not 17"):
        HriPolicy.load(tmp_path / "other.pt")


def test_training_writes_a_rule_file_that_decides_as_the_policy(tmp_path: Path) -> None:
    given = TrainConfig(algorithm="hri", mode="easy", steps=100, demonstrations=0.1, validate_every=100)
    train(given, tmp_path, tensorboard=False)
    saved = load_policy(tmp_path)
    assert saved.path.name == "best.pt"
    text = (tmp_path / "rules.dl").read_text(encoding="utf-8")
    assert text == saved.policy.rules() and ":-" in text
    rules = logicity.RulePolicy(tmp_path / "rules.dl", "easy")
    steps = np.concatenate([each.observations for each in logicity.demonstrations("easy", 20, "test")])
    actions, _ = saved.policy.predict(steps)
    assert np.array_equal(rules(steps), actions) and len(set(actions.tolist())) > 1


def test_faulty_settings_are_errors() -> None:
    with pytest.raises(ValueError, match="`Stop` occurs twice"):
        HriSettings(order=["Stop", "Slow", "Stop"])
    cases: list[dict[str, Any]] = [
        {"depth": 0},
        {"noise": [0.1]},
        {"rule_rates": [0.1, -1.0]},
        {"unary": []},
        {"binary": ["A00+"]},
    ]
    for faulty in cases:
        with pytest.raises(ValueError):
            HriSettings.model_validate(faulty)
    # As YAML and JSON have them.
    settings = HriSettings(noise=(0.2, 0.1), depth_of={"Stop": 6})
    assert HriSettings.model_validate(settings.model_dump(mode="json")) == settings
