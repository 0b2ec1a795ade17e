from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from conftest import needs

import logicity

torch = needs("torch", "learn")
from logicity.learn.demonstrations import (  # noqa: E402
    DemonstrationData,
    GraphView,
    RelationalView,
    Sampler,
    layout_of,
)


@pytest.fixture(scope="module")
def data() -> DemonstrationData:
    return DemonstrationData.load("expert", 0.05)


def atoms(mode: str) -> list[tuple[str, tuple[int, ...]]]:
    """Return the predicate and the entities of each number, from the names that `describe` prints."""
    names = logicity.observation_names(mode)
    return [(name.partition("(")[0], tuple(map(int, name.partition("(")[2][:-1].split(",")))) for name in names]


def test_the_steps_are_those_of_the_trajectories(data: DemonstrationData) -> None:
    expected = logicity.demonstrations("expert", n=5)
    assert len(data) == sum(map(len, expected))
    for number, trajectory in enumerate(expected):
        chosen = data.trajectories == number
        assert np.array_equal(data.observations[chosen].numpy(), trajectory.observations[:-1])
        assert np.array_equal(data.actions[chosen].numpy(), trajectory.actions)


@pytest.mark.parametrize(("share", "count"), [(1.0, 100), (0.5, 50), (0.01, 1), (0.0001, 1), (0.126, 13)])
def test_a_share_is_at_least_one_trajectory(share: float, count: int) -> None:
    assert int(DemonstrationData.load("easy", share).trajectories.max()) + 1 == count


@pytest.mark.parametrize("share", [0.0, -0.5, 1.5, float("nan")])
def test_shares_out_of_range_are_rejected(share: float) -> None:
    with pytest.raises(ValueError, match="share"):
        DemonstrationData.load("easy", share)


@pytest.mark.parametrize("mode", ["easy", "medium", "expert"])
def test_relational_views_equal_a_loop_over_the_atoms(mode: str) -> None:
    layout = layout_of(mode)
    observations = (torch.rand(30, layout.width, generator=torch.Generator().manual_seed(3)) < 0.05).double()
    unary, binary, mask = RelationalView(layout)(observations)
    expected_unary, expected_binary = torch.zeros_like(unary), torch.zeros_like(binary)
    expected_mask = torch.zeros_like(mask)
    for scene in range(30):
        expected_mask[scene, 0] = True
        for at, (name, entities) in enumerate(atoms(mode)):
            value = observations[scene, at]
            if len(entities) == 1:
                expected_unary[scene, entities[0], layout.unary.index(name)] = value
            else:
                expected_binary[scene, entities[0], entities[1], layout.binary.index(name)] = value
            for entity in entities:
                expected_mask[scene, entity] |= bool(value)
    assert torch.equal(unary, expected_unary) and torch.equal(binary, expected_binary)
    assert torch.equal(mask, expected_mask) and not mask.all()


@pytest.mark.parametrize("reverse", [False, True])
def test_graphs_equal_a_loop_over_the_edges(data: DemonstrationData, reverse: bool) -> None:
    view, layout = GraphView(data.layout, reverse), data.layout
    names = atoms("expert")
    # A smaller batch after a larger one needs another index.
    for observations in (data.observations[:7], data.observations[7:10], data.observations[100:107]):
        nodes, index, edges, mask = view(observations)
        assert nodes.shape == (len(mask), len(layout.unary)) and edges.shape == (index.shape[1], view.edge_width)
        found: dict[tuple[int, int], Any] = {}
        for (source, target), features in zip(index.T.tolist(), edges, strict=True):
            assert source // 5 == target // 5
            found[source, target] = features
        assert len(found) == 25 * len(observations)
        for scene, observation in enumerate(observations):
            for at, (name, entities) in enumerate(names):
                if len(entities) == 1:
                    assert nodes[5 * scene + entities[0], layout.unary.index(name)] == observation[at]
                    continue
                i, j = (5 * scene + entity for entity in entities)
                column = layout.binary.index(name)
                assert found[i, j][column] == observation[at]
                if reverse:
                    assert found[j, i][len(layout.binary) + column] == observation[at]


def test_distinct_steps_keep_their_first_occurrence(data: DemonstrationData) -> None:
    seen, first = set(), []
    for step in range(len(data)):
        key = (data.observations[step].numpy().tobytes(), int(data.actions[step]))
        if key not in seen:
            seen.add(key)
            first.append(step)
    distinct = data.distinct()
    assert 1 < len(first) < len(data)
    assert torch.equal(distinct.observations, data.observations[first])
    assert torch.equal(distinct.actions, data.actions[first])
    assert torch.equal(distinct.trajectories, data.trajectories[first])


def test_class_weights_balance_the_actions(data: DemonstrationData) -> None:
    assert torch.equal(data.class_weights(0.0), torch.ones(4))
    totals = data.class_weights(1.0) * data.counts
    assert torch.allclose(totals, totals[0])
    easy = DemonstrationData.load("easy", 0.02)
    weights = easy.class_weights(0.5)
    # The oracle never chooses Slow or Fast in easy mode.
    assert weights[0] == weights[2] == 0 and weights[1] < 1 < weights[3]


def test_a_sampler_goes_through_all_steps(data: DemonstrationData) -> None:
    sampler = Sampler(data, 64, seed=0)
    drawn = torch.cat([sampler.next() for _ in range(len(data))])
    for start in range(0, len(drawn) - len(data), len(data)):
        assert torch.equal(drawn[start : start + len(data)].sort().values, torch.arange(len(data)))
    assert not torch.equal(drawn[: len(data)], drawn[len(data) : 2 * len(data)])


def test_a_balanced_sampler_draws_all_actions_equally_often(data: DemonstrationData) -> None:
    sampler = Sampler(data, 250, seed=0, balanced=True)
    drawn = torch.cat([data.actions[sampler.next()] for _ in range(40)])
    # The standard deviation of each count is 43.
    assert (torch.bincount(drawn, minlength=4) - 2_500).abs().max() < 250


@pytest.mark.parametrize("balanced", [False, True])
def test_a_restored_sampler_continues_exactly(data: DemonstrationData, balanced: bool) -> None:
    sampler = Sampler(data, 300, seed=1, balanced=balanced)
    sampler.next()
    state = {name: value.clone() for name, value in sampler.state_dict().items()}
    expected = [sampler.next() for _ in range(5)]
    other = Sampler(data, 300, seed=2, balanced=balanced)
    other.load_state_dict(state)
    assert all(torch.equal(other.next(), batch) for batch in expected)
    if not balanced:
        with pytest.raises(ValueError, match="different demonstrations"):
            Sampler(data[torch.arange(10)], 300, seed=1).load_state_dict(state)
