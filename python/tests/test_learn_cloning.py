from __future__ import annotations

import itertools
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from conftest import needs

from logicity.evaluation import Benchmark

torch = needs("torch", "learn")
needs("torch_geometric", "learn")
needs("pydantic", "learn")
from pydantic import ValidationError  # noqa: E402

from logicity.learn.cloning import (  # noqa: E402
    ClonedPolicy,
    CloningLearner,
    GnnLearner,
    MlpLearner,
    NlmLearner,
    TransformerLearner,
    shuffled,
)
from logicity.learn.demonstrations import DemonstrationData, layout_of  # noqa: E402
from logicity.learn.gnn import GraphNetwork  # noqa: E402
from logicity.learn.run import check_start  # noqa: E402
from logicity.learn.transformer import TransformerNetwork  # noqa: E402

LEARNERS: dict[str, type[CloningLearner]] = {
    "mlp": MlpLearner,
    "gnn": GnnLearner,
    "nlm": NlmLearner,
    "transformer": TransformerLearner,
}
#: Settings that make a learner small.
SMALL: dict[str, dict[str, Any]] = {
    "mlp": {"network": [8]},
    "gnn": {"network": [8, 8]},
    "nlm": {"depth": 2, "breadth": 2, "outputs": 3},
    "transformer": {"layers": 2, "heads": 2, "head_width": 3, "feedforward": 8},
}


def config(algorithm: str, settings: dict[str, Any], **keys: Any) -> Any:
    """Return a training configuration."""
    checked = LEARNERS[algorithm].settings_class.model_validate(settings)
    defaults = {"mode": "easy", "demonstrations": 0.03, "start": None, "seed": 0}
    return SimpleNamespace(algorithm=algorithm, settings=checked, overrides={}, **{**defaults, **keys})


def nothing() -> None:
    pass


def crossing(steps: int, seed: int) -> DemonstrationData:
    """Return random scenes in which the oracle stops iff the ego is at an intersection and an entity is in one."""
    layout = layout_of("easy")
    generator = torch.Generator().manual_seed(seed)
    observations = (torch.rand(steps, layout.width, generator=generator) < 0.1).float()
    at, inside = layout.unary.index("IsAtInter"), layout.unary.index("IsInInter")
    observations[:, layout.unary_at[0, at]] = (torch.rand(steps, generator=generator) < 0.5).float()
    inside_at = torch.from_numpy(layout.unary_at[:, inside])
    stops = (observations[:, layout.unary_at[0, at]] > 0) & (observations[:, inside_at] > 0).any(1)
    return DemonstrationData(layout, observations, torch.where(stops, 3, 1), torch.zeros(steps, dtype=torch.int64))


@pytest.mark.parametrize(
    ("algorithm", "settings", "updates"),
    [
        ("mlp", {"network": [64], "learning_rate": 1e-2}, 400),
        (
            "gnn",
            {
                "network": [64, 64],
                "learning_rate": 2e-2,
                "learned_eps": True,
                "present_only": True,
                "weight_decay": 0.1,
                "batch_size": 128,
            },
            800,
        ),
        ("nlm", {"depth": 2, "breadth": 2, "outputs": 8, "learning_rate": 3e-2}, 250),
        ("transformer", {"layers": 2, "heads": 4, "head_width": 4, "feedforward": 32, "learning_rate": 1e-2}, 400),
    ],
)
def test_a_learner_learns_a_rule_exactly(
    algorithm: str, settings: dict[str, Any], updates: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(DemonstrationData, "load", lambda mode, share: crossing(8_000, seed=1))
    learner = LEARNERS[algorithm](config(algorithm, {**settings, "schedule": "cosine"}))
    learner.fit(updates, nothing)
    test = crossing(1_000, seed=2)
    actions, _ = learner.policy().predict(test.observations.numpy())
    assert np.array_equal(actions, test.actions.numpy()) and 100 < (actions == 3).sum() < 400


@pytest.mark.parametrize("algorithm", LEARNERS)
def test_an_interrupted_training_equals_an_uninterrupted_one(algorithm: str, tmp_path: Path) -> None:
    settings = {
        **SMALL[algorithm],
        "schedule": "cosine",
        "average": 0.9,
        "shuffle_entities": True,
        "balanced": algorithm == "gnn",
        "gradient_clip": 1.0,
        "weight_decay": 0.01,
    }
    whole = LEARNERS[algorithm](config(algorithm, settings))
    whole.fit(24, nothing)

    class Killed(Exception):
        pass

    def kill() -> None:
        if first.steps == 10:
            first.save(tmp_path)
        if first.steps == 15:
            raise Killed

    first = LEARNERS[algorithm](config(algorithm, settings))
    with pytest.raises(Killed):
        first.fit(24, kill)
    second = LEARNERS[algorithm](config(algorithm, settings))
    second.restore(tmp_path)
    assert second.steps == 10
    second.fit(24, nothing)
    one, other = tmp_path / "one", tmp_path / "other"
    for learner, folder in ((whole, one), (second, other)):
        folder.mkdir()
        learner.save(folder)
        learner.policy().save(folder / "policy.pt")
    for name in ("learner.pt", "policy.pt"):
        assert (one / name).read_bytes() == (other / name).read_bytes()


@pytest.mark.parametrize("algorithm", LEARNERS)
def test_the_seed_determines_the_policy(algorithm: str) -> None:
    def weights(seed: int) -> list[Any]:
        learner = LEARNERS[algorithm](config(algorithm, SMALL[algorithm], seed=seed))
        torch.rand(seed + 1)
        learner.fit(5, nothing)
        return list(learner.policy().network.parameters())

    first, again, other = weights(0), weights(0), weights(1)
    assert all(torch.equal(*pair) for pair in zip(first, again, strict=True))
    assert not all(torch.equal(*pair) for pair in zip(first, other, strict=True))


@pytest.mark.parametrize("algorithm", LEARNERS)
def test_a_saved_policy_acts_alike(algorithm: str, tmp_path: Path) -> None:
    learner = LEARNERS[algorithm](config(algorithm, SMALL[algorithm], mode="medium"))
    learner.fit(3, nothing)
    learner.policy().save(tmp_path / "policy.pt")
    loaded = ClonedPolicy.load(tmp_path / "policy.pt")
    assert (loaded.algorithm, loaded.mode) == (algorithm, "medium")
    assert loaded.settings == learner.config.settings
    observations = (np.random.default_rng(0).random((50, loaded.layout.width)) < 0.1).astype(np.float32)
    actions, state = loaded.predict(observations)
    assert np.array_equal(actions, learner.policy().predict(observations)[0])
    assert actions.dtype == np.int64 and state is None
    # One observation in a batch changes no other.
    assert np.array_equal(actions[7:8], loaded.predict(observations[7:8])[0])
    measured = Benchmark("medium", "val").evaluate(loaded)
    assert 0 <= measured.tsr.value <= 1
    with pytest.raises(ValueError, match=r"shape \(batch, 140\), not \(50, 139\): the policy was trained in `medium`"):
        loaded.predict(observations[:, 1:])


def test_actions_are_drawn_with_the_softmax_of_the_scores() -> None:
    class Constant(torch.nn.Module):  # type: ignore[misc, name-defined, unused-ignore]
        def forward(self, observations: Any) -> Any:
            return torch.tensor([0.5, 0.25, 0.0, 0.25]).log().expand(len(observations), 4)

    layout = layout_of("easy")
    policy = ClonedPolicy("mlp", "easy", MlpLearner.settings_class(), layout, Constant())
    torch.manual_seed(0)
    actions, _ = policy.predict(np.zeros((4_000, layout.width), np.float32), deterministic=False)
    # The standard deviations are at most 32.
    assert np.abs(np.bincount(actions, minlength=4) - [2_000, 1_000, 0, 1_000]).max() < 160


def test_training_starts_from_a_policy(tmp_path: Path) -> None:
    easy = config("nlm", SMALL["nlm"])
    learner = NlmLearner(easy)
    learner.fit(5, nothing)
    path = tmp_path / "policy.pt"
    learner.policy().save(path)
    started = NlmLearner(config("nlm", SMALL["nlm"], seed=3))
    started.start_from(ClonedPolicy.load(path))
    for one, other in zip(started.policy().network.parameters(), learner.policy().network.parameters(), strict=True):
        assert torch.equal(one, other)
    with pytest.raises(ValueError, match="policy of `nlm`, not of `gnn`"):
        check_start(config("gnn", SMALL["gnn"], start=str(path)))
    with pytest.raises(ValueError, match="other observations than those of `hard`"):
        NlmLearner(config("nlm", SMALL["nlm"], mode="hard")).start_from(learner.policy())
    with pytest.raises(ValueError, match="other sizes"):
        NlmLearner(config("nlm", {**SMALL["nlm"], "outputs": 4})).start_from(learner.policy())


def test_wrong_files_are_rejected(tmp_path: Path) -> None:
    path = tmp_path / "wrong.pt"
    path.write_bytes(b"no policy")
    with pytest.raises(ValueError, match="PyTorch cannot read it"):
        ClonedPolicy.load(path)
    torch.save({"weights": {}}, path)
    with pytest.raises(ValueError, match="of format None"):
        ClonedPolicy.load(path)
    torch.save({"format": 1, "algorithm": "ppo"}, path)
    with pytest.raises(ValueError, match="but of `ppo`"):
        ClonedPolicy.load(path)
    torch.save({"format": 1, "algorithm": "mlp", "settings": {"depth": 1}}, path)
    with pytest.raises(ValueError, match="damaged policy of `mlp`"):
        ClonedPolicy.load(path)
    with pytest.raises(OSError):
        ClonedPolicy.load(tmp_path / "missing.pt")
    learner = MlpLearner(config("mlp", SMALL["mlp"]))
    torch.save({"checkpoint": 2, "algorithm": "mlp", "network": {}}, tmp_path / "learner.pt")
    with pytest.raises(ValueError, match="does not fit the configuration"):
        learner.restore(tmp_path)


@pytest.mark.parametrize(
    ("algorithm", "settings"),
    [
        ("mlp", {"network": []}),
        ("mlp", {"depth": 3}),
        ("nlm", {"breadth": 1}),
        ("gnn", {"layers": 0}),
        ("transformer", {"heads": 0}),
        ("gnn", {"class_power": 1.5}),
        ("nlm", {"learning_rate": float("inf")}),
        ("nlm", {"batch_size": "64"}),
    ],
)
def test_invalid_settings_are_rejected(algorithm: str, settings: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        LEARNERS[algorithm].settings_class.model_validate(settings)


def test_the_loss_weighs_the_actions() -> None:
    learner = MlpLearner(config("mlp", {**SMALL["mlp"], "class_power": 1.0, "distinct": True, "batch_size": 9_999}))
    data = DemonstrationData.load("easy", 0.03).distinct()
    with torch.no_grad():
        scores = learner.policy().network(data.observations)
        losses = torch.nn.functional.cross_entropy(scores, data.actions, reduction="none")
        by_action = [losses[data.actions == action].mean() for action in (1, 3)]
    loss, accuracy = learner._update(0.0)
    assert loss == pytest.approx(float(sum(by_action)) / 2, rel=1e-5)
    assert accuracy == pytest.approx(float((scores.argmax(1) == data.actions).float().mean()))


def test_training_curves_are_written(tmp_path: Path) -> None:
    reader = needs("tensorboard.backend.event_processing.event_accumulator", "learn")
    learner = MlpLearner(config("mlp", SMALL["mlp"]), tmp_path)
    learner.fit(100, nothing)
    learner.close()
    curves = reader.EventAccumulator(str(tmp_path)).Reload()
    assert [point.step for point in curves.Scalars("train/loss")] == [50, 100]
    assert curves.Scalars("train/loss")[1].value < curves.Scalars("train/loss")[0].value


def test_shuffling_permutes_the_present_entities() -> None:
    layout = layout_of("expert")
    generator = torch.Generator().manual_seed(1)
    observations = (torch.rand(60, layout.width, generator=generator) < 0.03).float()
    present = observations @ torch.from_numpy(layout.occurrences()) > 0
    result = shuffled(observations, layout, torch.Generator().manual_seed(2))
    moved = 0
    for scene in range(60):
        true = {atom for atom, value in zip(layout.atoms(), observations[scene], strict=True) if value}
        after = {atom for atom, value in zip(layout.atoms(), result[scene], strict=True) if value}
        # Find the order by trying all of them, as the truth values of an entity identify it only up to symmetry.
        assert any(
            after == {(name, tuple(order[entity] for entity in entities)) for name, entities in true}
            for order in orders(present[scene].tolist())
        )
        moved += true != after
    assert moved > 20


def orders(present: list[bool]) -> list[dict[int, int]]:
    """Return the maps from the present entities to the first places, with the ego in place."""
    others = [entity for entity in range(1, 5) if present[entity]]
    return [
        {0: 0, **dict(zip(others, places, strict=True))} for places in itertools.permutations(range(1, len(others) + 1))
    ]


@pytest.mark.parametrize(("reverse", "present_only"), [(False, False), (True, False), (False, True), (True, True)])
def test_a_graph_network_equals_explicit_loops_over_edges(reverse: bool, present_only: bool) -> None:
    layout = layout_of("easy")
    torch.manual_seed(3)
    network = GraphNetwork(
        layout, 4, (6, 5), layers=2, reverse=reverse, present_only=present_only, learned_eps=reverse
    ).double()
    if reverse:
        torch.nn.init.constant_(network.convolutions[1].eps, 0.3)
    observations = (torch.rand(6, layout.width) < 0.1).double()
    fast = network(observations)
    for scene, observation in enumerate(observations):
        true = {atom: value for atom, value in zip(layout.atoms(), observation, strict=True)}
        present = [
            entity == 0 or any(value > 0 and entity in entities for (_, entities), value in true.items())
            for entity in range(5)
        ]
        nodes = [torch.stack([true[name, (entity,)] for name in layout.unary]) for entity in range(5)]
        for convolution in network.convolutions:
            after = []
            for target in range(5):
                total = nodes[target] * (1.3 if reverse and convolution is network.convolutions[1] else 1.0)
                for source in range(5):
                    if present_only and not (present[source] and present[target]):
                        continue
                    edge = [true[name, (source, target)] for name in layout.binary]
                    edge += [true[name, (target, source)] for name in layout.binary] if reverse else []
                    total = total + torch.relu(nodes[source] + convolution.lin(torch.stack(edge)))
                after.append(convolution.nn(total))
            nodes = after
        assert torch.allclose(network.readout(nodes[0]), fast[scene], atol=1e-12)


def test_a_transformer_equals_explicit_attention_between_present_entities() -> None:
    layout = layout_of("medium")
    torch.manual_seed(4)
    network = TransformerNetwork(layout, 4, layers=2, heads=2, head_width=3, feedforward=8).double()
    torch.nn.init.normal_(network.ego)
    observations = (torch.rand(30, layout.width) < 0.03).double()
    fast = network(observations)
    counts = set()
    for scene, observation in enumerate(observations):
        true = {atom: value for atom, value in zip(layout.atoms(), observation, strict=True)}
        present = [
            entity
            for entity in range(5)
            if entity == 0 or any(value > 0 and entity in entities for (_, entities), value in true.items())
        ]
        counts.add(len(present))
        tokens = {}
        for entity in present:
            atoms = [true[name, (entity,)] for name in layout.unary]
            atoms += [true[name, (0, entity)] for name in layout.binary]
            atoms += [true[name, (entity, 0)] for name in layout.binary]
            tokens[entity] = network.embedding(torch.stack(atoms)) + (network.ego if entity == 0 else 0)
        for layer in network.layers:
            queries, keys, values = (
                {entity: layer.norm(tokens[entity]) @ weight.T + bias for entity in present}
                for weight, bias in zip(layer.inputs.weight.chunk(3), layer.inputs.bias.chunk(3), strict=True)
            )
            after = {}
            for one in present:
                heads = []
                for head in range(2):
                    part = slice(3 * head, 3 * head + 3)
                    scores = torch.stack(
                        [
                            queries[one][part] @ keys[other][part] / 3**0.5
                            + layer.relations(torch.stack([true[name, (one, other)] for name in layout.binary]))[head]
                            for other in present
                        ]
                    )
                    heads.append(scores.softmax(0) @ torch.stack([values[other][part] for other in present]))
                token = tokens[one] + layer.output(torch.cat(heads))
                after[one] = token + layer.perceptron(token)
            tokens = after
        assert torch.allclose(network.readout(network.norm(tokens[0])), fast[scene], atol=1e-10)
    assert len(counts) > 2


@pytest.mark.parametrize("algorithm", list(LEARNERS))
def test_networks_learn_from_quantities(algorithm: str, patience: str) -> None:
    learner = LEARNERS[algorithm](config(algorithm, SMALL[algorithm], mode=patience))
    learner.fit(3, nothing)
    policy = learner.policy()
    observation = learner._data.observations[:1]
    other = observation + torch.from_numpy(policy.layout.unbounded)
    assert not torch.equal(policy.network(observation), policy.network(other))
