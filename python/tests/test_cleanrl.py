"""The single-file examples in the style of CleanRL."""

from __future__ import annotations

import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import needs

torch = needs("torch", "learn")
needs("tensorboard", "learn")

EXAMPLES = Path(__file__).parents[1] / "examples"


def example(name: str, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Import an example as a module."""
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    # Data classes look up their module.
    monkeypatch.setitem(sys.modules, name, module)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize(("name", "steps"), [("cleanrl_ppo", 500_000), ("cleanrl_dqn", 150_000)])
def test_an_example_learns(name: str, steps: int, tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, str(EXAMPLES / f"{name}.py"), "--steps", str(steps), "--log", str(tmp_path / "log")],
        cwd=tmp_path,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
        capture_output=True,
        encoding="utf-8",
    )
    assert done.returncode == 0, done.stderr
    before, after = map(float, re.findall(r"^(?:before|after) .*: .* TSR ([\d.]+)", done.stdout, re.MULTILINE))
    # No constant action reaches more than 0.3.
    assert before <= 0.4 and after >= 0.6, done.stdout
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    curves = EventAccumulator(str(tmp_path / "log"))
    curves.Reload()
    success = curves.Scalars("episode/success")
    assert len(success) > 10 and success[-1].value > success[0].value + 0.2


def test_advantages_equal_their_definition(monkeypatch: pytest.MonkeyPatch) -> None:
    ppo = example("cleanrl_ppo", monkeypatch)
    torch.manual_seed(0)
    steps, count, gamma, decay = 9, 4, 0.9, 0.8
    rewards, values, following = (torch.randn(steps, count) for _ in range(3))
    ended = (torch.rand(steps, count) < 0.3).float()
    found = ppo.advantages(rewards, values, following, ended, gamma, decay)
    for step in range(steps):
        for env in range(count):
            # The discounted sum of temporal-difference errors, up to the end of the episode.
            expected = 0.0
            for later in range(step, steps):
                error = rewards[later, env] + gamma * following[later, env] - values[later, env]
                expected += (gamma * decay) ** (later - step) * float(error)
                if ended[later, env]:
                    break
            assert float(found[step, env]) == pytest.approx(expected, abs=1e-5)


def test_the_buffer_keeps_the_last_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    buffer = example("cleanrl_dqn", monkeypatch).ReplayBuffer(10, 1)
    for step in range(6):
        number = np.float32(3 * step) + np.arange(3, dtype=np.float32)
        buffer.add(number[:, None], np.ones(3, np.int64), number, number[:, None] + 1, np.zeros(3, np.bool_))
        stored = set(buffer.arrays[2][: buffer.count].tolist())
        assert stored == set(np.arange(max(0, 3 * step + 3 - 10), 3 * step + 3, dtype=float))
    seen, taken, reward, following, terminal = buffer.sample(500, np.random.default_rng(0))
    assert set(reward.tolist()) == set(range(8, 18)) and (seen[:, 0] == reward).all()
    assert (following == seen + 1).all() and (taken == 1).all() and not terminal.any()


def test_options_are_checked() -> None:
    done = subprocess.run(
        [sys.executable, str(EXAMPLES / "cleanrl_dqn.py"), "--envs", "many"], capture_output=True, encoding="utf-8"
    )
    assert done.returncode == 2 and "--envs: invalid int value: 'many'" in done.stderr
