from __future__ import annotations

import itertools
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import needs
from numpy.typing import NDArray

needs("torch", "learn")
import torch  # noqa: E402

from logicity import _logicity  # noqa: E402
from logicity.envs import SPFVectorEnv  # noqa: E402
from logicity.envs.layout import atoms_of  # noqa: E402
from logicity.evaluation import Benchmark  # noqa: E402
from logicity.learn import TrainConfig  # noqa: E402
from logicity.learn.fast_ppo import (  # noqa: E402
    ENDINGS,
    Batch,
    FastPPO,
    FastPPOPolicy,
    FastPPOSettings,
    Network,
    advantages,
    grouped,
    losses,
    slots,
)
from logicity.tasks import load_task  # noqa: E402


def learner(log: Path | None = None, **changes: Any) -> FastPPO:
    settings = {"network": (16,), "rollout_steps": 8, **changes.pop("settings", {})}
    keys = {"mode": "easy", "envs": 8, "steps": 4096, **changes}
    return FastPPO(TrainConfig(algorithm="ppo-fast", settings=FastPPOSettings(**settings), **keys), log)


def network_of(inputs: int, widths: list[int], seed: int = 0) -> Network:
    """Return a network with larger weights than the initial ones, and biases."""
    torch.manual_seed(seed)
    network = Network(inputs, widths)
    network.parameters += 0.3 * torch.randn_like(network.parameters)
    return network


def outputs_of(network: Network, parameters: torch.Tensor, inputs: torch.Tensor) -> torch.Tensor:
    """Compute the outputs layer by layer, for automatic differentiation with respect to the parameters."""
    start, values = 0, inputs
    for number, (weights, bias) in enumerate(network.layers):
        end = start + weights.numel()
        values = values @ parameters[start:end].view(weights.shape) + parameters[end : end + len(bias)]
        start = end + len(bias)
        if number == 0:
            values = values.amax(1)
        if number < len(network.layers) - 1:
            values = values.relu()
    return values


def random_steps(rng: np.random.Generator, observations: int, count: int) -> tuple[NDArray[Any], ...]:
    """Return the observation, action, advantage and return of each step; each observation occurs."""
    states = np.concatenate([np.arange(observations), rng.integers(0, observations, count - observations)])
    actions = rng.integers(0, 4, count).astype(np.uint8)
    return states.astype(np.uint32), actions, *rng.normal(size=(2, count)).astype(np.float32)


@pytest.mark.parametrize(("slot_count", "widths"), [(1, [16]), (4, [16, 8]), (3, [8, 8, 8])])
def test_the_update_over_distinct_observations_equals_that_over_steps(slot_count: int, widths: list[int]) -> None:
    """The reference is PPO's loss as in the paper, step by step, with automatic differentiation."""
    rng, inputs = np.random.default_rng(slot_count), 7
    network = network_of(inputs, widths)
    given = (rng.random((12, slot_count, inputs)) < 0.3).astype(np.float32)
    # Probabilities in the rollouts that differ from those of the network, so that both sides of the clip occur.
    old = (network.forward(torch.from_numpy(given)) + 0.5 * torch.randn(12, 5)).numpy()
    states, actions, gains, returns = random_steps(rng, 12, 300)
    clip, vf_coef, ent_coef = 0.2, 0.4, 0.03

    parameters = network.parameters.clone().requires_grad_()
    position = torch.from_numpy(states.astype(np.int64))
    outputs = outputs_of(network, parameters, torch.from_numpy(given)[position])
    log_probs = torch.log_softmax(outputs[:, :4], 1)
    chosen = torch.from_numpy(actions.astype(np.int64)).unsqueeze(1)
    before = torch.log_softmax(torch.from_numpy(old)[position][:, :4], 1)
    ratio = (log_probs - before).gather(1, chosen).squeeze(1).exp()
    gain = torch.from_numpy(gains)
    policy = -torch.minimum(ratio * gain, ratio.clamp(1 - clip, 1 + clip) * gain).sum()
    value = 0.5 * ((outputs[:, 4] - torch.from_numpy(returns)) ** 2).sum()
    entropy = -(log_probs.exp() * log_probs).sum()
    (policy + vf_coef * value - ent_coef * entropy).backward()
    clipped = ((ratio > 1 + clip) & (gain > 0)) | ((ratio < 1 - clip) & (gain < 0))
    assert 0.1 < clipped.float().mean() < 0.9

    batch = grouped(given, old, states, actions, gains, returns)
    parts, derivative = losses(network.forward(batch.inputs), batch, clip, vf_coef, ent_coef)
    network.backward(derivative)
    variance = sum(((of := returns[states == state]) - of.mean()) @ (of - of.mean()) for state in range(12))
    assert parts.policy == pytest.approx(policy.item(), rel=1e-4)
    assert parts.value + 0.5 * variance == pytest.approx(value.item(), rel=1e-4)
    assert parts.entropy == pytest.approx(entropy.item(), rel=1e-4)
    assert parameters.grad is not None
    torch.testing.assert_close(network.gradient, parameters.grad, rtol=1e-3, atol=1e-4)


def test_a_step_is_that_of_adam_with_a_shortened_gradient() -> None:
    network = network_of(5, [8, 6])
    parameters = torch.nn.Parameter(network.parameters.clone())
    optimizer = torch.optim.Adam([parameters], lr=0.01, eps=1e-5)
    for size in (3.0, 0.001, 1.0):
        network.gradient.copy_(size * torch.randn_like(network.gradient))
        parameters.grad = network.gradient.clone()
        torch.nn.utils.clip_grad_norm_([parameters], 0.5)
        optimizer.step()
        network.step(0.01, 0.5)
        torch.testing.assert_close(network.parameters, parameters.data)


def test_advantages_equal_the_sum_over_later_errors() -> None:
    """The reference is the definition: the errors of the steps until the end of the episode, discounted."""
    rng, gamma, lam = np.random.default_rng(0), 0.9, 0.8
    rewards, values, next_values = rng.normal(size=(3, 6, 9)).astype(np.float32)
    ended = rng.random((6, 9)) < 0.3
    found = advantages(rewards, values, next_values, ended, gamma, lam)
    for env, first in itertools.product(range(6), range(9)):
        expected, weight = 0.0, 1.0
        for step in range(first, 9):
            expected += weight * (rewards[env, step] + gamma * next_values[env, step] - values[env, step])
            weight *= gamma * lam
            if ended[env, step]:
                break
        assert found[env, first] == pytest.approx(expected, abs=1e-5)


def test_grouping_adds_up_the_steps_of_an_observation() -> None:
    rng = np.random.default_rng(1)
    given, old = rng.random((5, 1, 3)).astype(np.float32), rng.normal(size=(5, 5)).astype(np.float32)
    states, actions, gains, returns = random_steps(rng, 5, 60)
    batch = grouped(given, old, states, actions, gains, returns)
    for state in range(5):
        of = states == state
        assert batch.counts[state] == of.sum()
        assert batch.returns[state] == pytest.approx(returns[of].mean(), abs=1e-5)
        for action in range(4):
            some = gains[of & (actions == action)]
            assert batch.positive_advantages[state, action] == pytest.approx(some[some > 0].sum(), abs=1e-5)
            assert batch.negative_advantages[state, action] == pytest.approx(some[some < 0].sum(), abs=1e-5)
    assert isinstance(batch.part(torch.tensor([3, 1])), Batch)
    assert batch.part(torch.tensor([3, 1])).counts.tolist() == [batch.counts[3], batch.counts[1]]


@pytest.mark.parametrize("others", [1, 2, 4])
def test_slots_select_the_atoms_about_some_entities(others: int) -> None:
    description = _logicity.describe(load_task("expert", overrides={"task": {"route_length": True}}))
    atoms = list(atoms_of(description))
    found = slots(description, others)
    assert len(found) == math.comb(4, others)
    assert set(found.ravel()) >= {at for at, (_, of) in enumerate(atoms) if len(of) == 1} | {len(atoms)}
    for slot, entities in zip(found, itertools.combinations(range(1, 5), others), strict=True):
        about = [atoms[at] for at in slot[:-1]]
        expected = [atom for atom in atoms if set(atom[1]) <= {0, *entities} and len(set(atom[1])) == len(atom[1])]
        assert sorted(about) == sorted(expected) and slot[-1] == len(atoms)
        names = {0: 0, **dict(zip(entities, itertools.count(1), strict=False))}
        assert [(name, tuple(names[at] for at in of)) for name, of in about] == [
            (name, of) for name, of in atoms if max(of) <= others and len(set(of)) == len(of)
        ]


def test_the_order_of_entities_has_no_effect() -> None:
    """Slots of one entity are permuted with the entities."""
    description = _logicity.describe(load_task("expert"))
    atoms = list(atoms_of(description))
    network = network_of(slots(description, 1).shape[1], [16, 8]).native(len(atoms), slots(description, 1))
    rng = np.random.default_rng(0)
    observations = (rng.random((20, len(atoms))) < 0.2).astype(np.float32)
    for order in itertools.islice(itertools.permutations(range(1, 5)), 1, 24, 5):
        of = (0, *order)
        moved = [atoms.index((name, tuple(of[at] for at in entities))) for name, entities in atoms]
        np.testing.assert_allclose(network.evaluate(observations[:, moved]), network.evaluate(observations), rtol=1e-5)


@pytest.mark.parametrize("others", [1, 2, 4])
@pytest.mark.parametrize("route_length", [False, True])
def test_the_network_in_rust_equals_that_in_torch(others: int, route_length: bool) -> None:
    description = _logicity.describe(load_task("medium", overrides={"task": {"route_length": route_length}}))
    chosen, width = slots(description, others), description["width"]
    network = network_of(chosen.shape[1], [16, 8])
    observations = (np.random.default_rng(0).random((65, width)) < 0.15).astype(np.float32)
    if route_length:
        observations[:, -1] = np.linspace(0, 1, 65)
    expected = network.forward(torch.from_numpy(observations[:, chosen].copy()))
    found = network.native(width, chosen).evaluate(observations)
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-5)


def loop(envs: SPFVectorEnv, network: Network, chosen: NDArray[Any], random: NDArray[np.float32]) -> dict[str, Any]:
    """Collect steps with a call of Python per step, as a reference for `SPFVectorEnv.collect`."""

    def outputs(observations: NDArray[Any]) -> NDArray[np.float32]:
        found: NDArray[np.float32] = network.forward(torch.from_numpy(observations[:, chosen].copy())).numpy()
        return found

    done: dict[str, list[Any]] = {
        key: [] for key in ("inputs", "outputs", "actions", "rewards", "endings", "next_values")
    }
    observations = envs._observations.copy()
    for numbers in random.T:
        found = outputs(observations)
        probabilities = torch.softmax(torch.from_numpy(found[:, :4]), 1).numpy()
        actions = (probabilities.cumsum(1)[:, :3] <= numbers[:, None]).sum(1)
        done["inputs"].append(observations[:, chosen])
        done["outputs"].append(found)
        done["actions"].append(actions)
        observations, rewards, terminated, truncated, infos = envs.step(actions)
        endings, values = np.zeros(len(actions), np.uint8), outputs(observations)[:, 4].copy()
        for at in np.flatnonzero(terminated | truncated):
            success = infos["final_info"]["success"][at]
            endings[at] = 3 if truncated[at] else 2 if success else 1
            values[at] = outputs(infos["final_obs"][at][None])[0, 4] if truncated[at] else 0
        done["rewards"].append(rewards)
        done["endings"].append(endings)
        done["next_values"].append(values)
    return {key: np.stack(value, 1) for key, value in done.items()}


@pytest.mark.parametrize(("mode", "others", "route_length"), [("easy", 2, False), ("expert", 1, True)])
def test_rollouts_in_rust_equal_those_through_python(mode: str, others: int, route_length: bool) -> None:
    overrides = {"task": {"route_length": route_length, "horizon": 30}}
    description = _logicity.describe(load_task(mode, overrides=overrides))
    chosen = slots(description, others)
    network = network_of(chosen.shape[1], [16, 8])
    rng = np.random.default_rng(0)
    made = [
        SPFVectorEnv(9, mode, split="train", overrides=overrides, autoreset_mode="SameStep", num_threads=threads)
        for threads in (1, 1, 2)
    ]
    for envs in made:
        envs.reset(seed=5)
    one, fast, threaded = made
    endings = set()
    for _ in range(3):
        random = rng.random((9, 40), np.float32)
        expected = loop(one, network, chosen, random)
        native = network.native(description["width"], chosen)
        found = fast.collect(native, random)
        for key in ("actions", "rewards", "endings", "next_values"):
            np.testing.assert_allclose(found[key], expected[key], rtol=1e-4, atol=1e-5, err_msg=key)
        np.testing.assert_array_equal(found["inputs"][found["states"]], expected["inputs"])
        np.testing.assert_allclose(found["outputs"][found["states"]], expected["outputs"], rtol=1e-4, atol=1e-5)
        assert len(np.unique(found["inputs"].reshape(len(found["inputs"]), -1), axis=0)) <= len(found["inputs"]) < 360
        assert sorted(set(found["states"].ravel())) == list(range(len(found["inputs"])))
        for key, value in threaded.collect(native, random).items():
            np.testing.assert_array_equal(value, found[key], err_msg=key)
        endings |= set(found["endings"].ravel())
        # The environments continue from the same states.
        np.testing.assert_array_equal(one._observations, fast._observations)
    assert endings >= {0, 1, 3}


def test_collect_rejects_what_does_not_fit() -> None:
    description = _logicity.describe(load_task("easy"))
    chosen, width = slots(description, 4), description["width"]
    layers = [(weights.numpy(), bias.numpy()) for weights, bias in Network(chosen.shape[1], [4]).layers]
    network = _logicity.PolicyNetwork(width, chosen, layers)
    envs = SPFVectorEnv(2, "easy", autoreset_mode="SameStep")
    with pytest.raises(Exception, match="has ended or not started"):
        envs.collect(network, np.zeros((2, 3), np.float32))
    envs.reset(seed=0)
    with pytest.raises(ValueError, match=r"expected random numbers of shape \(2, steps\), not \(3, 3\)"):
        envs.collect(network, np.zeros((3, 3), np.float32))
    other = SPFVectorEnv(2, "expert", autoreset_mode="SameStep")
    other.reset(seed=0)
    with pytest.raises(ValueError, match=f"observations of 205 numbers, not {width}"):
        other.collect(network, np.zeros((2, 3), np.float32))
    late = SPFVectorEnv(2, "easy")
    late.reset(seed=0)
    with pytest.raises(ValueError, match="SameStep"):
        late.collect(network, np.zeros((2, 3), np.float32))
    for wrong, message in [
        ((width, chosen, layers[:1]), "the last layer must have 5 outputs"),
        ((width, chosen, [layers[0], layers[0]]), "layer 1 has 4 inputs"),
        ((10, chosen, layers), "of an observation of 10"),
        ((width, chosen, []), "at least one layer"),
    ]:
        with pytest.raises(ValueError, match=message):
            _logicity.PolicyNetwork(*wrong)
    with pytest.raises(ValueError, match="not 3"):
        network.evaluate(np.zeros((1, 3), np.float32))


def test_it_learns_easy_mode() -> None:
    """After 150,000 steps the policy solves nearly all validation episodes; random actions solve about 2 %."""
    training = learner(
        envs=128,
        steps=300_000,
        overrides={"task": {"reward": {"progress": 5}}},
        settings={"network": (64, 64), "rollout_steps": 16, "epochs": 4},
    )
    training.fit(150_000, lambda: None)
    assert training.steps >= 150_000
    assert Benchmark("easy", "val").evaluate(training.policy()).tsr.value > 0.8
    training.close()


@pytest.mark.parametrize("minibatches", [1, 3])
def test_an_interrupted_run_equals_an_uninterrupted_one(minibatches: int, tmp_path: Path) -> None:
    changes: dict[str, Any] = {"settings": {"minibatches": minibatches, "epochs": 2}}
    whole, begun = learner(**changes), learner(**changes)
    whole.fit(640, lambda: None)
    begun.fit(320, lambda: None)
    begun.save(tmp_path)
    begun.fit(640, lambda: None)
    resumed = learner(**changes)
    resumed.restore(tmp_path)
    assert resumed.steps == 320
    resumed.fit(640, lambda: None)
    for other in (begun, resumed):
        assert torch.equal(other._networks[0].parameters, whole._networks[0].parameters)
        assert torch.equal(other._networks[0].moments, whole._networks[0].moments)
        np.testing.assert_array_equal(other._envs._observations, whole._envs._observations)
    assert not torch.equal(
        learner(**changes, seed=1)._networks[0].parameters, learner(**changes)._networks[0].parameters
    )


def test_progress_is_reported_after_each_batch() -> None:
    training, seen = learner(), []
    training.fit(200, lambda: seen.append(training.steps))
    assert seen == [64, 128, 192, 256]


def test_policies_survive_files(tmp_path: Path) -> None:
    training = learner()
    training.fit(128, lambda: None)
    path = tmp_path / "best.pt"
    training.policy().save(path)
    observations = (np.random.default_rng(0).random((30, 85)) < 0.2).astype(np.float32)
    loaded = FastPPOPolicy.load(path)
    expected, state = training.policy().predict(observations)
    assert state is None and expected.dtype == np.int64
    np.testing.assert_array_equal(loaded.predict(observations)[0], expected)
    assert len(np.unique(loaded.predict(observations[:1].repeat(200, 0), deterministic=False)[0])) > 1
    assert (loaded.mode, loaded.settings) == ("easy", training.config.settings)
    started = learner(seed=3)
    started.start_from(loaded)
    assert torch.equal(started._networks[0].parameters, training._networks[0].parameters)
    with pytest.raises(ValueError, match="its layers do not fit"):
        learner(settings={"network": [8]}).start_from(loaded)
    with pytest.raises(ValueError, match=r"shape \(batch, 85\), not \(30, 80\): the policy was trained in `easy`"):
        loaded.predict(observations[:, :80])


def test_wrong_files_are_named(tmp_path: Path) -> None:
    path = tmp_path / "best.pt"
    with pytest.raises(FileNotFoundError):
        FastPPOPolicy.load(path)
    path.write_bytes(b"no policy")
    with pytest.raises(ValueError, match="is not a policy of `ppo-fast`"):
        FastPPOPolicy.load(path)
    learner().policy().save(path)
    content = torch.load(path, weights_only=True)
    wrong: list[tuple[dict[str, Any], str]] = [
        ({"algorithm": "mlp"}, "is not a policy of `ppo-fast`"),
        ({"format": 2}, "has the format 2"),
        ({"weights": torch.zeros(1)}, "is a damaged policy"),
        ({"width": 10}, "is a damaged policy"),
        ({"settings": {"network": [0]}}, "is a damaged policy"),
    ]
    for changes, message in wrong:
        torch.save({**content, **changes}, path)
        with pytest.raises(ValueError, match=message):
            FastPPOPolicy.load(path)


def test_training_curves_are_written(tmp_path: Path) -> None:
    training = learner(tmp_path)
    training.fit(64 * 50, lambda: None)
    training.close()
    assert list((tmp_path / "ppo-fast").glob("events*"))


def test_a_resumed_run_continues_its_training_curves(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No point repeats. The first means after the resume are over its updates, not over all of the interval."""
    reader = needs("tensorboard.backend.event_processing.event_accumulator", "learn")

    def curves(folder: Path) -> dict[str, dict[int, float]]:
        read = reader.EventAccumulator(str(folder / "ppo-fast")).Reload()
        points = {tag: read.Scalars(tag) for tag in read.Tags()["scalars"]}
        for found in points.values():
            assert len({point.step for point in found}) == len(found)
        return {tag: {point.step: point.value for point in found} for tag, found in points.items()}

    changes: dict[str, Any] = {"overrides": {"task": {"horizon": 20}}}
    size = 64  # steps of a batch
    whole = learner(tmp_path / "whole", **changes)
    whole.fit(200 * size, lambda: None)
    whole.close()

    # It stops after 170 updates. Its last checkpoint is at 80 updates, so the points at 100 and 150 updates repeat.
    killed = learner(tmp_path / "resumed", **changes)
    killed.fit(80 * size, lambda: None)
    killed.save(tmp_path)
    killed.fit(170 * size, lambda: None)
    killed.close()
    resumed = learner(tmp_path / "resumed", **changes)
    resumed.restore(tmp_path)
    resumed.fit(200 * size, lambda: None)
    resumed.close()

    # The reference for the point at 100 updates: the values of the 20 updates since the checkpoint.
    since: dict[str, list[float]] = {}
    part = learner(tmp_path / "part", **changes)
    part.restore(tmp_path)

    def record(values: dict[str, float]) -> None:
        for name, value in values.items():
            since.setdefault(name, []).append(float(value))

    monkeypatch.setattr(part._curves, "add", record)
    part.fit(100 * size, lambda: None)

    expected, found = curves(tmp_path / "whole"), curves(tmp_path / "resumed")
    assert found.keys() == expected.keys() == since.keys()
    for tag, points in found.items():
        assert list(points) == [50 * size, 100 * size, 150 * size, 200 * size]
        if tag.startswith("cpu_seconds"):
            continue
        assert len(since[tag]) == (20 if tag.startswith("batches") else 1)
        assert points.pop(100 * size) == pytest.approx(np.mean(since[tag]), rel=1e-5)
        assert points.items() <= expected[tag].items()
    assert sum(since[f"episodes/{name}"][0] for name in ENDINGS.values()) == pytest.approx(1)
