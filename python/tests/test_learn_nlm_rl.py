from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import needs

torch = needs("torch", "learn")
gymnasium = needs("gymnasium", "learn")
needs("stable_baselines3", "learn")

from logicity.learn import TrainConfig, load_policy, train  # noqa: E402
from logicity.learn.cloning import LogicNetwork  # noqa: E402
from logicity.learn.demonstrations import layout_of  # noqa: E402
from logicity.learn.extractor import LogicFeatures  # noqa: E402
from logicity.learn.nlm_rl import NlmDqnLearner, NlmPpoLearner  # noqa: E402
from logicity.learn.stable_baselines import algorithm_of  # noqa: E402

SETTINGS = {
    "depth": 2,
    "outputs": 3,
    "network": [8],
    "batch_size": 16,
    "learning_starts": 40,
    "buffer_size": 500,
    "train_freq": 4,
    "target_update_interval": 50,
}


def config(**keys: Any) -> TrainConfig:
    values = {"algorithm": "nlm-dqn", "mode": "easy", "settings": SETTINGS, "steps": 240, "validate_every": 80}
    return TrainConfig(**{**values, **keys})


def test_the_features_are_the_predicates_of_the_ego() -> None:
    layout = layout_of("medium")
    space = gymnasium.spaces.Box(0.0, 1.0, (layout.width,), np.float32)
    torch.manual_seed(1)
    features = LogicFeatures(space, layout.atoms(), depth=3, outputs=5)
    observations = (torch.rand(20, layout.width) < 0.1).float()
    result = features(observations)
    assert result.shape == (20, 5) and features.features_dim == 5
    unary, binary, mask = features.network.view(observations)
    assert torch.allclose(result, features.network.machine([None, unary, binary], mask)[1][:, 0])
    assert features.network.machine.layers[0].linear["3"].in_features == 6 * len(layout.binary)
    with pytest.raises(ValueError, match=r"shape \(140,\), not \(85,\)"):
        LogicFeatures(gymnasium.spaces.Box(0.0, 1.0, (85,), np.float32), layout.atoms())


@pytest.mark.parametrize("density", [0.002, 0.02, 0.2])
@pytest.mark.parametrize("options", [{"depth": 3}, {"depth": 4, "exclude_self": False}, {"depth": 2, "residual": True}])
def test_few_entities_and_equal_observations_take_less_work_for_the_same_result(
    density: float, options: dict[str, Any]
) -> None:
    layout = layout_of("hard")
    torch.manual_seed(3)
    network = LogicNetwork(layout, outputs=4, **options)
    observations = (torch.rand(40, layout.width) < density).float()
    observations = torch.cat([observations, observations[:10], torch.zeros(2, layout.width)])
    factors = torch.rand(len(observations), network.width)
    results, gradients = [], []
    for evaluate in (network.padded, network.forward):
        network.zero_grad()
        result = evaluate(observations)
        (result * factors).sum().backward()
        results.append(result.detach())
        gradients.append(torch.cat([each.grad.flatten() for each in network.parameters() if each.grad is not None]))
    torch.testing.assert_close(results[1], results[0])
    torch.testing.assert_close(gradients[1], gradients[0], rtol=1e-4, atol=1e-4)
    for row in (0, 51):
        torch.testing.assert_close(network(observations[row : row + 1]), results[0][row : row + 1])


def test_ppo_has_an_nlm_and_separate_layers_for_policy_and_value(tmp_path: Path) -> None:
    settings = {"depth": 2, "outputs": 3, "network": [8], "batch_size": 16, "n_steps": 8}
    learner = NlmPpoLearner(config(algorithm="nlm-ppo", settings=settings, envs=2))
    try:
        model = learner.policy().model
        assert isinstance(model.policy.features_extractor, LogicFeatures)
        for layers in (model.policy.mlp_extractor.policy_net, model.policy.mlp_extractor.value_net):
            linear = [layer for layer in layers if isinstance(layer, torch.nn.Linear)]
            assert [(layer.in_features, layer.out_features) for layer in linear] == [(3, 8)]
        model.save(tmp_path / "model.zip")
        assert algorithm_of(tmp_path / "model.zip") == "nlm-ppo"
    finally:
        learner.close()


def test_the_network_has_the_layers_of_the_settings() -> None:
    learner = NlmDqnLearner(config())
    try:
        network = learner.policy().model.policy.q_net
        assert isinstance(network.features_extractor, LogicFeatures)
        widths = [layer.out_features for layer in network.q_net if isinstance(layer, torch.nn.Linear)]
        assert widths == [8, 4] and network.q_net[0].in_features == 3
    finally:
        learner.close()


def test_an_interrupted_training_equals_an_uninterrupted_one(tmp_path: Path) -> None:
    class Killed(Exception):
        pass

    whole, first, second = (NlmDqnLearner(config()) for _ in range(3))

    def kill() -> None:
        if first.steps == 120:
            first.save(tmp_path)
        if first.steps == 160:
            raise Killed

    try:
        whole.fit(240, lambda: None)
        first = NlmDqnLearner(config())
        with pytest.raises(Killed):
            first.fit(240, kill)
        second = NlmDqnLearner(config())
        second.restore(tmp_path)
        second.fit(240, lambda: None)
        one, other = (learner.policy().model.policy.state_dict() for learner in (whole, second))
        assert all(torch.equal(one[name], other[name]) for name in one)
    finally:
        for learner in (whole, first, second):
            learner.close()


def test_a_run_saves_a_policy_that_names_its_learner(tmp_path: Path) -> None:
    result = train(config(), tmp_path / "run", tensorboard=False)
    assert result["config"]["settings"]["depth"] == 2
    saved = load_policy(tmp_path / "run")
    assert (saved.algorithm, saved.mode) == ("nlm-dqn", "easy")
    observations = np.zeros((7, layout_of("easy").width), np.float32)
    actions, _ = saved.policy.predict(observations)
    assert actions.shape == (7,)
    # Another learner's policy is no start.
    with pytest.raises(ValueError, match="policy of `nlm-dqn`, not of `dqn`"):
        train(
            config(algorithm="dqn", settings={"network": [8]}, start=str(tmp_path / "run" / "best.pt")),
            tmp_path / "other",
        )
