from __future__ import annotations

import itertools
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
from logicity.learn.interaction import Interaction, Transitions  # noqa: E402
from logicity.learn.shooting import (  # noqa: E402
    Ensemble,
    Shooting,
    ShootingPolicy,
    ShootingSettings,
    WorldModel,
    planned_actions,
    predicted_returns,
)

BITS = 5
# Threads that share few cores with other processes wait for each other.
torch.set_num_threads(1)


def generator(seed: int = 0) -> Any:
    return torch.Generator().manual_seed(seed)


def small(**settings: Any) -> ShootingSettings:
    values = {"members": 3, "width": 8, "sequences": 6, "horizon": 3, "random_steps": 40, "batch_size": 16}
    return ShootingSettings(**{**values, "model_interval": 8, "reward_interval": 4, **settings})


def config(settings: ShootingSettings, **more: Any) -> TrainConfig:
    values = {
        "algorithm": "mb-shooting",
        "mode": "easy",
        "settings": settings,
        "overrides": {"task": {"horizon": 30, "reward": {"violation": -1}}},
        "envs": 4,
        "seed": 3,
    }
    return TrainConfig(**{**values, **more})


def member(ensemble: Ensemble, at: int) -> Any:
    """Return one network of an ensemble as a sequence of layers."""
    layers: list[Any] = []
    for weight, bias in zip(ensemble.weights, ensemble.biases, strict=True):
        layer = torch.nn.Linear(weight.shape[1], weight.shape[2])
        layer.weight.data, layer.bias.data = weight[at].detach().T.clone(), bias[at, 0].detach().clone()
        layers += [layer, torch.nn.ReLU()]
    return torch.nn.Sequential(*layers[:-1])


def with_action(bits: Any, action: int) -> Any:
    return torch.cat([bits, torch.eye(4)[action]])


def test_an_ensemble_is_a_batch_of_networks() -> None:
    ensemble = Ensemble(50, BITS, 7, 6, generator()).requires_grad_(False)
    bits = torch.randint(2, (50, 9, BITS), generator=generator(1)).float()
    actions = torch.randint(4, (50, 9), generator=generator(2))
    outputs, of_all = ensemble(bits, actions), ensemble.all_actions(bits)
    assert outputs.shape == (50, 9, 6) and of_all.shape == (50, 9, 4, 6)
    for at in range(50):
        network = member(ensemble, at).requires_grad_(False)
        for row in range(9):
            expected = network(with_action(bits[at, row], int(actions[at, row])))
            torch.testing.assert_close(outputs[at, row], expected)
            for action in range(4):
                torch.testing.assert_close(of_all[at, row, action], network(with_action(bits[at, row], action)))


def test_the_members_train_as_separate_networks() -> None:
    """The gradient of the sum of the members' losses is that of each member's own loss."""
    settings = small()
    model = WorldModel(BITS, settings, generator())
    networks = [(member(model.changes, at), member(model.outcomes, at)) for at in range(3)]
    bits, after = (torch.randint(2, (3, 11, BITS), generator=generator(seed)) for seed in (1, 2))
    actions = torch.randint(4, (3, 11), generator=generator(3))
    rewards = torch.randn((3, 11), generator=generator(4))
    terminated, truncated = torch.rand((2, 3, 11), generator=generator(5)) < 0.3
    model.changes_loss(bits.float(), actions, after.float()).backward()
    sum(model.outcomes_loss(bits.float(), actions, rewards, terminated.float(), truncated)).backward()
    for at, (changes, outcomes) in enumerate(networks):
        entropy = error = termination = torch.zeros(())
        for row in range(11):
            inputs = with_action(bits[at, row].float(), int(actions[at, row]))
            logits = changes(inputs)
            for bit in range(BITS):
                three = torch.stack([logits[bit], logits[BITS + bit], logits[2 * BITS + bit]])
                change = int(after[at, row, bit]) - int(bits[at, row, bit])
                entropy = entropy - three.log_softmax(0)[change + 1] / (11 * BITS)
            reward, terminates = outcomes(inputs)
            if not truncated[at, row]:
                error = error + (reward - rewards[at, row]) ** 2 / 11
            probability = torch.sigmoid(terminates)
            termination = termination - (probability if terminated[at, row] else 1 - probability).log() / 11
        entropy.backward()
        (error + termination).backward()
        for network, ensemble in ((changes, model.changes), (outcomes, model.outcomes)):
            layers = [layer for layer in network if isinstance(layer, torch.nn.Linear)]
            for layer, weight, bias in zip(layers, ensemble.weights, ensemble.biases, strict=True):
                torch.testing.assert_close(weight.grad[at], layer.weight.grad.T, rtol=1e-4, atol=1e-6)
                torch.testing.assert_close(bias.grad[at, 0], layer.bias.grad, rtol=1e-4, atol=1e-6)


def slow_returns(model: WorldModel, states: Any, sequences: Any, discount: float) -> Any:
    """Roll out every sequence with every member, one step at a time."""
    returns = torch.zeros(len(states), len(sequences))
    changes = [member(model.changes, at).requires_grad_(False) for at in range(model.members)]
    outcomes = [member(model.outcomes, at).requires_grad_(False) for at in range(model.members)]
    for row, at, (number, sequence) in itertools.product(
        range(len(states)), range(model.members), enumerate(sequences.tolist())
    ):
        bits, weight, total = states[row].float(), 1.0, 0.0
        for action in sequence:
            reward, terminates = outcomes[at](with_action(bits, action)).tolist()
            total += weight * reward
            weight *= discount * (1 - 1 / (1 + np.exp(-terminates)))
            logits = changes[at](with_action(bits, action))
            for bit in range(model.bits):
                falls, stays, rises = (float(logits[place * model.bits + bit]) for place in range(3))
                changed = falls > stays if bits[bit] else rises > stays
                bits = torch.cat(
                    [bits[:bit], bits[bit : bit + 1] if not changed else 1 - bits[bit : bit + 1], bits[bit + 1 :]]
                )
        returns[row, number] += total / model.members
    return returns


@pytest.mark.parametrize("stays", [0.0, 4.4, 4.6])
def test_returns_equal_those_of_single_rollouts(stays: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """The fewer bits stay, the more states the search reaches."""
    monkeypatch.setattr("logicity.learn.shooting._Graph.BATCH", 2)
    model = WorldModel(BITS, small(), generator())
    with torch.no_grad():
        model.changes.biases[-1][:, :, BITS : 2 * BITS] -= 4.6 - stays
        for weight in model.changes.weights:
            weight *= 3
    states = torch.randint(2, (7, BITS), dtype=torch.uint8, generator=generator(1))
    sequences = torch.randint(4, (9, 5), generator=generator(2))
    fast = predicted_returns(model, states, sequences, 0.9)
    torch.testing.assert_close(fast, slow_returns(model, states, sequences, 0.9))


class Corridor(WorldModel):
    """A known model: a place from 0 to 7 in binary numbers, moved by -1, 0, 1 or 2. Place 6 ends the episode."""

    def __init__(self, rewards: Any) -> None:
        super().__init__(3, small(members=2), generator())
        self.rewards = rewards

    @staticmethod
    def places(states: Any) -> Any:
        return (states * torch.tensor([4.0, 2, 1])).sum(-1).long()

    def outcomes_of(self, states: Any) -> Any:
        places = self.places(states)
        return self.rewards[places], (places != 6).float()[..., None].expand(*places.shape, 4)

    def flips_of(self, states: Any) -> Any:
        after = (self.places(states)[..., None] + torch.tensor([-1, 0, 1, 2])).clamp(0, 7)
        return (after[..., None] // torch.tensor([4, 2, 1]) % 2) != states[:, :, None]


def best_action(rewards: Any, place: int, depth: int) -> tuple[float, int]:
    """Search all action sequences."""
    best = (-np.inf, 0)
    for action in range(4):
        value = float(rewards[place, action])
        if depth > 1 and place != 6:
            value += 0.8 * best_action(rewards, min(7, max(0, place + action - 1)), depth - 1)[0]
        best = max(best, (value, action))
    return best


def test_plans_are_optimal_if_all_sequences_are_drawn() -> None:
    rewards = torch.randn((8, 4), generator=generator(7))
    states = torch.tensor([[place // 4, place // 2 % 2, place % 2] for place in range(8)], dtype=torch.uint8)
    every = torch.tensor(list(itertools.product(range(4), repeat=4)))
    returns = predicted_returns(Corridor(rewards), states, every, 0.8)
    for place in range(8):
        value, action = best_action(rewards, place, 4)
        assert returns[place].max() == pytest.approx(value, abs=1e-5)
        assert every[returns[place].argmax(), 0] == action
    # With thousands of random sequences of this length, each of the 256 occurs.
    planned = planned_actions(
        Corridor(rewards), states.numpy(), small(sequences=5000, horizon=4, discount=0.8), generator()
    )
    assert planned.tolist() == [best_action(rewards, place, 4)[1] for place in range(8)]


class Toy:
    """Environments in which bit 0 says which action is right, and bit 1 is random. A wrong action ends the episode.

    Action 3 is always right, but costs .2. Action 1 is right unless bit 0 is 1.
    """

    width = 2

    def __init__(self, config: Any) -> None:
        self._random = np.random.default_rng(config.seed)
        self.steps = 0
        self.observations = self._draw(config.envs)

    def __len__(self) -> int:
        return len(self.observations)

    def _draw(self, count: int) -> Any:
        return self._random.integers(0, 2, (count, 2)).astype(np.uint8)

    def step(self, actions: Any) -> Transitions:
        before = self.observations
        wrong = np.where(before[:, 0] > 0, actions != 3, (actions != 3) & (actions != 1))
        rewards = np.where(wrong, -1.0, np.where(actions == 3, -0.2, 0.0)).astype(np.float32)
        self.observations = self._draw(len(actions))
        self.steps += len(actions)
        return Transitions(before, actions, rewards, self.observations, wrong, np.zeros(len(actions), bool))

    def episodes(self) -> dict[str, float]:
        return {}

    def close(self) -> None:
        pass


def test_learns_the_optimal_actions(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("logicity.learn.interaction.Interaction", Toy)
    settings = small(
        sequences=64, reward_learning_rate=3e-3, model_learning_rate=3e-3, width=16, random_steps=400, exploration=0.1
    )
    learner = Shooting(config(settings, envs=16))
    learner.fit(3200, lambda: None)
    states = np.array(list(itertools.product([0.0, 1.0], repeat=2)), np.float32)
    for state in range(20):
        actions, after = learner.policy().predict(states, state)
        assert actions.tolist() == [1, 1, 3, 3] and after == state + 1


def parameters(learner: Shooting) -> Any:
    return torch.cat([values.detach().reshape(-1) for values in learner._model.parameters()])


def test_a_restored_learner_continues_exactly(tmp_path: Path) -> None:
    def run(learner: Shooting, steps: int) -> list[Any]:
        seen: list[Any] = []
        learner.fit(steps, lambda: seen.append((learner.steps, learner._interaction.observations.copy())))
        return seen

    whole = Shooting(config(small(buffer_size=90)))
    expected = run(whole, 200)
    first = Shooting(config(small(buffer_size=90)))
    seen = run(first, 120)
    first.save(tmp_path)
    first.close()
    second = Shooting(config(small(buffer_size=90)))
    second.restore(tmp_path)
    assert second.steps == 120
    seen += run(second, 200)
    assert len(seen) == len(expected) == 50
    for one, other in zip(seen, expected, strict=True):
        assert one[0] == other[0] and (one[1] == other[1]).all()
    assert torch.equal(parameters(second), parameters(whole))
    other = Shooting(config(small(buffer_size=90), seed=4))
    other.fit(200, lambda: None)
    assert not torch.equal(parameters(other), parameters(whole))
    for learner in (whole, second, other):
        learner.close()
    with pytest.raises(ValueError, match="`observations` of shape"):
        Shooting(config(small(), mode="medium")).restore(tmp_path)


def test_policies_are_saved_and_evaluated(tmp_path: Path) -> None:
    learner = Shooting(config(small()))
    learner.fit(80, lambda: None)
    policy = learner.policy()
    policy.save(tmp_path / "policy.pt")
    loaded = ShootingPolicy.load(tmp_path / "policy.pt")
    assert (loaded.settings, loaded.mode, loaded.seed) == (small(), "easy", 3)
    benchmark = Benchmark("easy", "val")
    first, second = benchmark.evaluate(policy), benchmark.evaluate(loaded)
    assert first == second and len(first.episodes) == 40
    observations = np.zeros((2, 85), np.float32)
    with pytest.raises(ValueError, match=r"shape \(batch, 85\), not \(2, 140\)"):
        policy.predict(np.zeros((2, 140), np.float32))
    with pytest.raises(ValueError, match="binary"):
        policy.predict(observations + 0.5)


def test_other_files_are_not_policies(tmp_path: Path) -> None:
    path = tmp_path / "policy.pt"
    with pytest.raises(OSError):
        ShootingPolicy.load(path)
    path.write_text("no policy")
    with pytest.raises(ValueError, match="policy.pt is not a policy"):
        ShootingPolicy.load(path)
    torch.save({"weights": {}}, path)
    with pytest.raises(ValueError, match="policy.pt is not a policy"):
        ShootingPolicy.load(path)
    torch.save({"format": 1, "algorithm": "dreamer", "config": {}, "weights": {}}, path)
    with pytest.raises(ValueError, match="is a policy of dreamer, not of mb-shooting"):
        ShootingPolicy.load(path)
    torch.save({"format": 9, "algorithm": "mb-shooting", "config": {}, "weights": {}}, path)
    with pytest.raises(ValueError, match="has version 9 of the format"):
        ShootingPolicy.load(path)
    torch.save({"format": 1, "algorithm": "mb-shooting", "config": {}, "weights": {}}, path)
    with pytest.raises(ValueError, match="is not a complete policy of mb-shooting: 'settings'"):
        ShootingPolicy.load(path)


def test_curves_are_written(tmp_path: Path) -> None:
    learner = Shooting(config(small(), envs=50), tmp_path)
    learner.fit(1000, lambda: None)
    learner.close()
    (file,) = tmp_path.glob("events.out.*")
    for name in (b"episode/return", b"loss/changes", b"loss/rewards", b"loss/terminations"):
        assert name in file.read_bytes()


def test_transitions_have_the_last_observation_of_an_episode(monkeypatch: pytest.MonkeyPatch) -> None:
    interaction = Interaction(config(small()))
    infos: list[dict[str, Any]] = []
    step = interaction.envs.step

    def watched(actions: Any) -> Any:
        result = step(actions)
        infos.append(result[-1])
        return result

    monkeypatch.setattr(interaction.envs, "step", watched)
    ends = 0
    while ends < 10:
        transitions = interaction.step(np.ones(4, np.int64))
        for at in np.flatnonzero(transitions.terminated | transitions.truncated):
            ends += 1
            assert (transitions.next_observations[at] == infos[-1]["final_obs"][at]).all()
        still = ~(transitions.terminated | transitions.truncated)
        assert (transitions.next_observations[still] == interaction.observations[still]).all()
    assert interaction.episodes().keys() == {"episode/return", "episode/length", "episode/success"}
    assert interaction.episodes() == {}
    with pytest.raises(ValueError, match="binary observations"):
        Interaction(config(small(), overrides={"task": {"route_length": True}}))


@pytest.mark.parametrize("mode", ["easy", "medium", "hard", "expert"])
def test_training_files_have_the_settings_of_the_paper(mode: str) -> None:
    path = Path(__file__).parents[2] / "configs" / "baselines" / f"mb-shooting-{mode}.yaml"
    values = TrainConfig.load(path)
    horizons = {"easy": 10, "medium": 14, "hard": 8, "expert": 8}
    settings = values.settings
    assert isinstance(settings, ShootingSettings)
    assert values.algorithm == "mb-shooting" and values.mode == mode and values.steps == 200_000
    assert (settings.members, settings.width, settings.sequences) == (50, 64, 100)
    assert (settings.model_learning_rate, settings.reward_learning_rate) == (1e-5, 1e-4)
    assert settings.horizon == horizons[mode]
    task = values.overrides["task"]
    assert task["horizon"] == {"easy": 100, "medium": 150, "hard": 200, "expert": 200}[mode]
    assert task["reward"] == {"violation": -1 if mode in ("easy", "medium") else -2, "overtime": -3}
