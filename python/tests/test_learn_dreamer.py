from __future__ import annotations

import itertools
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import needs

from logicity.evaluation import Benchmark

torch = needs("torch", "learn")
needs("gymnasium", "learn")
needs("tensorboard", "learn")
from logicity.learn.config import TrainConfig  # noqa: E402
from logicity.learn.dreamer import (  # noqa: E402
    Batch,
    Dreamer,
    DreamerPolicy,
    DreamerSettings,
    Elu,
    EpisodeReplay,
    State,
    WorldModel,
    balanced_kl,
    lambda_returns,
    one_hot_samples,
)
from logicity.learn.interaction import Interaction, Transitions  # noqa: E402

BITS = 6
# Threads that share few cores with other processes wait for each other.
torch.set_num_threads(1)


def generator(seed: int = 0) -> Any:
    return torch.Generator().manual_seed(seed)


def small(**settings: Any) -> DreamerSettings:
    values = {"deterministic": 12, "variables": 3, "classes": 4, "layers": 1, "width": 10, "batch_size": 6}
    more = {"random_steps": 40, "train_interval": 20, "updates": 2, "imagination": 3, "buffer_size": 400}
    return DreamerSettings(**{**values, **more, **settings})


def config(settings: DreamerSettings, **more: Any) -> TrainConfig:
    values = {
        "algorithm": "dreamer",
        "mode": "easy",
        "settings": settings,
        "overrides": {"task": {"horizon": 30, "reward": {"violation": -2}}},
        "envs": 4,
        "seed": 3,
    }
    return TrainConfig(**{**values, **more})


def test_elu_and_its_gradient_are_those_of_torch() -> None:
    ends = torch.tensor([-200.0, -1e-4, -0.0, 0.0, 1e-4, 200.0])
    inputs = torch.cat([ends, 5 * torch.randn(1000, generator=generator())]).requires_grad_()
    outputs, expected = Elu()(inputs), torch.nn.functional.elu(inputs)
    # exp(x) - 1 has an error of 6e-8 where expm1(x) has none.
    assert torch.allclose(outputs, expected, rtol=1e-6, atol=1e-7)
    weights = torch.randn(len(inputs), generator=generator(1))
    gradients = [torch.autograd.grad((values * weights).sum(), inputs)[0] for values in (outputs, expected)]
    assert torch.allclose(*gradients, rtol=1e-6, atol=1e-7)


def test_lambda_returns_equal_the_recursion_of_the_paper() -> None:
    """Equation 4, and the weighted sum of n-step returns that it stands for."""
    horizon = 6
    rewards, values = torch.randn((2, horizon, 5), generator=generator())
    discounts = torch.rand((horizon, 5), generator=generator(1))
    targets = lambda_returns(rewards, discounts, values, 0.7)

    def recursion(step: int, row: int) -> float:
        reward, discount, value = (float(each[step, row]) for each in (rewards, discounts, values))
        if step == horizon - 1:
            return reward + discount * value
        return reward + discount * (0.3 * value + 0.7 * recursion(step + 1, row))

    def n_steps(step: int, steps: int, row: int) -> float:
        total, weight = 0.0, 1.0
        for at in range(step, step + steps):
            total += weight * float(rewards[at, row])
            weight *= float(discounts[at, row])
        return total + weight * float(values[step + steps - 1, row])

    for step, row in itertools.product(range(horizon), range(5)):
        left = horizon - step
        mixture = 0.7 ** (left - 1) * n_steps(step, left, row)
        mixture += sum(0.3 * 0.7 ** (steps - 1) * n_steps(step, steps, row) for steps in range(1, left))
        assert targets[step, row] == pytest.approx(recursion(step, row), abs=1e-5)
        assert targets[step, row] == pytest.approx(mixture, abs=1e-5)


def test_kl_balancing_divides_the_gradients() -> None:
    def logits(seed: int) -> Any:
        return torch.randn((7, 3, 4), generator=generator(seed), requires_grad=True)

    def divergence(posterior: Any, prior: Any) -> Any:
        total = torch.zeros(7)
        for row, variable in itertools.product(range(7), range(3)):
            p, q = (each[row, variable].exp() / each[row, variable].exp().sum() for each in (posterior, prior))
            total = total + torch.nn.functional.one_hot(torch.tensor(row), 7) * sum(
                p[number] * (p[number] / q[number]).log() for number in range(4)
            )
        return total

    posterior, prior = logits(0), logits(1)
    plain = divergence(posterior, prior)
    plain.sum().backward()
    gradients = posterior.grad.clone(), prior.grad.clone()
    posterior.grad = prior.grad = None
    balanced = balanced_kl(posterior, prior, 0.8)
    torch.testing.assert_close(balanced, plain)
    balanced.sum().backward()
    torch.testing.assert_close(posterior.grad, 0.2 * gradients[0], rtol=1e-4, atol=1e-6)
    torch.testing.assert_close(prior.grad, 0.8 * gradients[1], rtol=1e-4, atol=1e-6)


def test_samples_have_the_probabilities_and_straight_through_gradients() -> None:
    logits = torch.tensor([[1.0, 0.0, -2.0, 0.5], [-9.0, 9.0, 0.0, 0.0]], requires_grad=True)
    samples = one_hot_samples(logits.expand(20_000, 2, 4), generator())
    assert torch.equal(samples.detach().sum(-1).round(), torch.ones(20_000, 2))
    torch.testing.assert_close(samples.detach().mean(0), logits.detach().softmax(-1), atol=0.015, rtol=0)
    assert one_hot_samples(logits, None).argmax(-1).tolist() == [0, 1]
    weights = torch.randn((2, 4), generator=generator(1))
    (one_hot_samples(logits, generator()) * weights).sum().backward()
    straight_through = logits.grad.clone()
    logits.grad = None
    (logits.softmax(-1) * weights).sum().backward()
    torch.testing.assert_close(straight_through, logits.grad)


def episode(length: int, seed: int) -> dict[str, Any]:
    bits = torch.randint(2, (length, BITS), generator=generator(seed)).float()
    actions = torch.eye(4)[torch.randint(4, (length,), generator=generator(seed + 1))]
    actions[0] = 0
    return {"observations": bits, "actions": actions, "first": torch.eye(length)[0][:, None]}


def test_states_of_sequences_restart_at_first_observations() -> None:
    """The most probable states of a sequence equal those of its episodes, each inferred alone and step by step."""
    model = WorldModel(BITS, small()).requires_grad_(False)
    parts = [episode(3, 0), episode(4, 10)]
    joined = {name: torch.cat([part[name] for part in parts]) for name in parts[0]}
    # The action before a first observation belongs to the episode before.
    joined["actions"][3] = torch.tensor([0.0, 1, 0, 0])
    state, states = model.start(1), []
    for step in range(7):
        bits, action, first = (joined[name][step][None] for name in ("observations", "actions", "first"))
        state, _ = model.observe(state, action, model.encoder(bits), first, None)
        states.append(state)
    expected = []
    for part in parts:
        h, z = torch.zeros(1, 12), torch.zeros(1, 12)
        for step in range(len(part["observations"])):
            h = model.gru(model.input(torch.cat([z, part["actions"][step][None]], -1)), h)
            logits = model.posterior(torch.cat([h, model.encoder(part["observations"][step][None])], -1))
            z = torch.zeros(1, 12)
            for variable in range(3):
                z[0, 4 * variable + int(logits[0, 4 * variable : 4 * variable + 4].argmax())] = 1
            expected.append((h, z))
    for state, (h, z) in zip(states, expected, strict=True):
        torch.testing.assert_close(state.deterministic, h)
        torch.testing.assert_close(state.stochastic, z)


def test_the_loss_of_the_world_model_is_that_of_single_observations() -> None:
    settings = small(discount=0.9, kl_balance=0.6)
    model = WorldModel(BITS, settings).requires_grad_(False)
    length, count = 4, 5
    bits = torch.randint(2, (length, count, BITS), generator=generator(1)).float()
    actions = torch.eye(4)[torch.randint(4, (length, count), generator=generator(2))]
    rewards = torch.randn((length, count), generator=generator(3))
    terminated, truncated, first = torch.rand((3, length, count), generator=generator(4)) < 0.3
    batch = Batch(bits, actions, rewards, terminated.float(), truncated, first.float()[..., None])
    states, losses = model.loss(batch, generator(5))
    sums = dict.fromkeys(losses._fields, 0.0)
    for step, row in itertools.product(range(length), range(count)):
        features = torch.cat([states.deterministic[step, row], states.stochastic[step, row]])
        for bit, logit in enumerate(model.decoder(features).tolist()):
            probability = 1 / (1 + math.exp(-logit))
            sums["observations"] -= math.log(probability if bits[step, row, bit] else 1 - probability)
        if not truncated[step, row]:
            sums["rewards"] += 0.5 * (float(model.reward(features)) - float(rewards[step, row])) ** 2
        continuation = 1 / (1 + math.exp(-float(model.discount(features))))
        target = 0.0 if terminated[step, row] else 0.9
        sums["discounts"] -= target * math.log(continuation) + (1 - target) * math.log(1 - continuation)
        embedded = model.encoder(bits[step, row])
        posterior = model.posterior(torch.cat([states.deterministic[step, row], embedded])).view(3, 4)
        prior = model.prior(states.deterministic[step, row]).view(3, 4)
        sums["divergence"] += float(balanced_kl(posterior, prior, 0.6))
    for name, value in losses._asdict().items():
        assert float(value) == pytest.approx(sums[name] / (length * count), rel=1e-4), name


class Numbered:
    """Transitions whose observations are consecutive numbers, so that sequences can be checked."""

    def __init__(self, envs: int) -> None:
        self.number = np.zeros(envs, np.int64)
        self.last = [0] * envs
        self._random = np.random.default_rng(0)
        self.log: list[list[tuple[int, int, float, int]]] = [[(0, 0, 0.0, EpisodeReplay.FIRST)] for _ in range(envs)]

    @staticmethod
    def bits(numbers: Any) -> Any:
        return (np.asarray(numbers)[..., None] >> np.arange(10) & 1).astype(np.uint8)

    def step(self) -> tuple[Transitions, Any]:
        envs = len(self.number)
        before = self.bits(self.number)
        actions = self._random.integers(0, 4, envs)
        rewards = self._random.random(envs).astype(np.float32)
        terminated = self._random.random(envs) < 0.1
        truncated = ~terminated & (self._random.random(envs) < 0.1)
        self.number += 1
        after = self.bits(self.number)
        for env in range(envs):
            flags = terminated[env] * EpisodeReplay.TERMINATED + truncated[env] * EpisodeReplay.TRUNCATED
            self.log[env].append((int(self.number[env]), int(actions[env]), float(rewards[env]), int(flags)))
            if flags:
                self.number[env] += 1
                self.log[env].append((int(self.number[env]), 0, 0.0, EpisodeReplay.FIRST))
        return Transitions(before, actions, rewards, after, terminated, truncated), self.bits(self.number)


@pytest.mark.parametrize("steps", [9, 200])
def test_sequences_are_parts_of_the_log(steps: int) -> None:
    envs, length, capacity = 3, 5, 3 * 40
    source = Numbered(envs)
    replay = EpisodeReplay(capacity, 10, torch.from_numpy(source.bits(source.number)))
    for _ in range(steps):
        transitions, observations = source.step()
        replay.add(transitions, torch.from_numpy(observations))
    assert replay.ready(5) and replay.ready(10) == (int(replay.added.min()) >= 10)
    kept = {entry[0]: entry for env in range(envs) for entry in source.log[env][-40:]}
    assert replay.added.tolist() == [len(log) for log in source.log]
    seen, firsts = set(), 0
    batch = replay.sample(400, length, generator())
    logs = [{entry[0]: entry for entry in log[-40:]} for log in source.log]
    for row in range(400):
        numbers = [int((batch.observations[step, row] * 2 ** torch.arange(10)).sum()) for step in range(length)]
        assert numbers == list(range(numbers[0], numbers[0] + length))
        found = False
        for log in logs:
            entries = [log.get(number) for number in numbers]
            stored = [
                (
                    numbers[step],
                    int(batch.actions[step, row].argmax()),
                    float(batch.rewards[step, row]),
                    int(
                        batch.terminated[step, row] * 1 + batch.truncated[step, row] * 2 + batch.first[step, row, 0] * 4
                    ),
                )
                for step in range(length)
            ]
            found = found or stored == entries
        assert found
        for step in range(length):
            first = bool(batch.first[step, row, 0])
            firsts += first
            assert float(batch.actions[step, row].sum()) == (0 if first else 1)
        seen.update(numbers)
    assert seen == set(kept) and firsts > 0
    copy = EpisodeReplay(capacity, 10, torch.zeros(3, 10, dtype=torch.uint8))
    copy.restore(replay.state())
    one, other = replay.sample(50, length, generator(1)), copy.sample(50, length, generator(1))
    for name in ("observations", "actions", "rewards", "terminated", "truncated", "first"):
        assert torch.equal(getattr(one, name), getattr(other, name))


class Toy:
    """Environments in which bit 0 says which action is right, and bit 1 is random. A wrong action ends the episode.

    Action 3 is always right, but costs .3. Action 1 is right unless bit 0 is 1.
    """

    width = 2

    def __init__(self, config: Any) -> None:
        self._random = np.random.default_rng(config.seed)
        self.steps = 0
        self.observations = self._draw(config.envs)

    def _draw(self, count: int) -> Any:
        return self._random.integers(0, 2, (count, 2)).astype(np.uint8)

    def step(self, actions: Any) -> Transitions:
        before = self.observations
        wrong = np.where(before[:, 0] > 0, actions != 3, (actions != 3) & (actions != 1))
        rewards = np.where(wrong, -1.0, np.where(actions == 3, -0.3, 0.0)).astype(np.float32)
        after = self._draw(len(actions))
        self.observations = np.where(wrong[:, None], self._draw(len(actions)), after)
        self.steps += len(actions)
        return Transitions(before, actions, rewards, after, wrong, np.zeros(len(actions), bool))

    def episodes(self) -> dict[str, float]:
        return {}


def test_learns_the_optimal_actions(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("logicity.learn.interaction.Interaction", Toy)
    rates = {"model_learning_rate": 5e-3, "actor_learning_rate": 2e-3, "critic_learning_rate": 5e-3}
    training = {"random_steps": 200, "updates": 10, "batch_size": 40, "sequence_length": 3, "target_interval": 20}
    settings = small(width=24, discount=0.5, entropy_scale=0.05, buffer_size=4000, **rates, **training)
    learner = Dreamer(config(settings, envs=10))
    learner.fit(700, lambda: None)
    policy = learner.policy()
    memory, starts, right = None, np.ones(8, np.bool_), []
    random = np.random.default_rng(0)
    for _ in range(20):
        states = random.integers(0, 2, (8, 2)).astype(np.float32)
        actions, memory = policy.predict(states, memory, starts)
        right.append(actions == np.where(states[:, 0] > 0, 3, 1))
        starts = random.random(8) < 0.2
    assert np.mean(right) == 1


def parameters(learner: Dreamer) -> Any:
    return torch.cat([values.reshape(-1) for module in learner._networks for values in module.state_dict().values()])


def test_a_restored_learner_continues_exactly(tmp_path: Path) -> None:
    def run(learner: Dreamer, steps: int) -> list[Any]:
        seen: list[Any] = []
        learner.fit(steps, lambda: seen.append((learner.steps, learner._interaction.observations.copy())))
        return seen

    settings = small(buffer_size=90, target_interval=3)
    whole = Dreamer(config(settings))
    expected = run(whole, 200)
    first = Dreamer(config(settings))
    seen = run(first, 116)
    first.save(tmp_path)
    first.close()
    second = Dreamer(config(settings))
    second.restore(tmp_path)
    assert second.steps == 116
    seen += run(second, 200)
    assert len(seen) == len(expected) == 50
    for one, other in zip(seen, expected, strict=True):
        assert one[0] == other[0] and (one[1] == other[1]).all()
    assert torch.equal(parameters(second), parameters(whole))
    other = Dreamer(config(settings, seed=4))
    other.fit(200, lambda: None)
    assert not torch.equal(parameters(other), parameters(whole))
    for learner in (whole, second, other):
        learner.close()
    with pytest.raises(ValueError, match="`observations` of shape"):
        Dreamer(config(small(), mode="medium")).restore(tmp_path)
    torch.save({"algorithm": "mb-shooting"}, tmp_path / "learner.pt")
    with pytest.raises(ValueError, match="is not a checkpoint of `dreamer`"):
        Dreamer(config(small())).restore(tmp_path)


def test_a_policy_has_a_memory_of_its_own_for_every_episode(tmp_path: Path) -> None:
    learner = Dreamer(config(small()))
    learner.fit(120, lambda: None)
    policy = learner.policy()
    policy.save(tmp_path / "policy.pt")
    loaded = DreamerPolicy.load(tmp_path / "policy.pt")
    assert (loaded.settings, loaded.mode, loaded.seed) == (small(), "easy", 3)
    rows = np.random.default_rng(0).integers(0, 2, (12, 3, 85)).astype(np.float32)
    starts = np.zeros((12, 3), np.bool_)
    starts[0] = starts[5, 1] = True
    memory, batched = None, []
    for step in range(12):
        actions, memory = policy.predict(rows[step], memory, starts[step])
        batched.append((actions, memory.state))
    for column in range(3):
        alone = None
        for step in range(12):
            if starts[step, column]:
                alone = None
            action, alone = loaded.predict(rows[step, column : column + 1], alone, np.array([alone is None]))
            assert action[0] == batched[step][0][column] and action.dtype == np.int64
            torch.testing.assert_close(
                State(*(part[0] for part in alone.state)).features(), batched[step][1].features()[column]
            )
    sampled = [policy.predict(rows[0], None, starts[0], deterministic=False)[0].tolist() for _ in range(2)]
    assert sampled[0] == sampled[1]
    benchmark = Benchmark("easy", "val")
    first, second = benchmark.evaluate(policy), benchmark.evaluate(loaded)
    assert first == second and len(first.episodes) == 40
    with pytest.raises(ValueError, match=r"shape \(batch, 85\), not \(2, 140\)"):
        policy.predict(np.zeros((2, 140), np.float32))
    torch.save({"format": 1, "algorithm": "mb-shooting", "config": {}, "weights": {}}, tmp_path / "policy.pt")
    with pytest.raises(ValueError, match="is a policy of mb-shooting, not of dreamer"):
        DreamerPolicy.load(tmp_path / "policy.pt")


def test_curves_are_written(tmp_path: Path) -> None:
    learner = Dreamer(config(small(train_interval=100), envs=50), tmp_path)
    learner.fit(1000, lambda: None)
    learner.close()
    (file,) = tmp_path.glob("events.out.*")
    for name in (b"episode/return", b"loss/observations", b"loss/divergence", b"loss/critic", b"actor/entropy"):
        assert name in file.read_bytes()


def test_too_small_a_buffer_raises() -> None:
    with pytest.raises(ValueError, match="`buffer_size` 10 is too small for 4 environments .*: use at least 20"):
        Dreamer(config(small(buffer_size=10)))
    assert Interaction(config(small())).width == 85


@pytest.mark.parametrize("mode", ["easy", "medium", "hard", "expert"])
def test_training_files_have_the_settings_of_the_paper(mode: str) -> None:
    path = Path(__file__).parents[2] / "configs" / "baselines" / f"dreamer-{mode}.yaml"
    values = TrainConfig.load(path)
    settings = values.settings
    assert isinstance(settings, DreamerSettings)
    assert values.algorithm == "dreamer" and values.mode == mode and values.steps == 200_000
    assert (settings.deterministic, settings.variables, settings.classes) == (100, 16, 16)
    assert (settings.layers, settings.width) == (3, 100)
    assert (settings.model_learning_rate, settings.actor_learning_rate, settings.critic_learning_rate) == (
        2e-4,
        4e-5,
        1e-4,
    )
    assert (settings.batch_size, settings.sequence_length, settings.imagination) == (50, 5, 8)
    assert (settings.trace_decay, settings.kl_balance) == (0.95, 0.8)
    assert (settings.train_interval, settings.updates) == (50, 10)
    penalty = {"easy": -2, "medium": -4, "hard": -4, "expert": -2}[mode]
    task = values.overrides["task"]
    assert task == {"horizon": 200, "reward": {"violation": penalty, "overtime": -3}}
