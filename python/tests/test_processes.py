"""Forked processes, and threads: what a copy of this process can do with the objects that it inherits."""

from __future__ import annotations

import multiprocessing
import os
import pickle
import select
import signal
import threading
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
from conftest import needs

import logicity
from logicity.envs import SPFVectorEnv

pytestmark = [
    pytest.mark.skipif(not hasattr(os, "fork"), reason="this system cannot fork"),
    # Python warns of a fork in a process with several threads. These tests fork such a process on purpose.
    pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning"),
    pytest.mark.filterwarnings("ignore:.*fork:RuntimeWarning"),
]

#: A child that takes longer than this many seconds hangs.
SECONDS = 60

CHAINS = """.decl edge(x: number, y: number)
.decl path(x: number, y: number)
path(x, y) :- edge(x, y).
path(x, z) :- path(x, y), edge(y, z).
"""


#: More agents than one thread decides for.
LARGE = """base: configs/metropolis.yaml
map: configs/maps/random-8x8.yaml
agents: {base: configs/agents/expert.yaml, train: ~, val: ~, test: {repeat: 16, trip: 80}}
"""


def forked(work: Callable[[], Any]) -> Any:
    """Return the result of `work` in a forked process."""
    read, write = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            data = pickle.dumps(work())
        except BaseException as error:
            data = pickle.dumps(f"raised {error!r}")
        with os.fdopen(write, "wb") as file:
            file.write(data)
        os._exit(0)
    os.close(write)
    with os.fdopen(read, "rb") as file:
        ready, _, _ = select.select([file], [], [], SECONDS)
        if not ready:
            os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        assert ready, "the forked process hangs"
        return pickle.loads(file.read())


def environments() -> Callable[[], Any]:
    envs = SPFVectorEnv(24, "easy", num_threads=2)
    envs.reset(seed=3)
    return lambda: [np.sum(envs.step(np.full(24, 1))[0]) for _ in range(5)]


def unused_environments() -> Callable[[], Any]:
    envs = SPFVectorEnv(24, "easy", num_threads=2)
    return lambda: np.sum(envs.reset(seed=3)[0])


def rollouts() -> Callable[[], Any]:
    from logicity import _logicity
    from logicity.tasks import load_task

    width = _logicity.describe(load_task("easy"))["width"]
    rng = np.random.default_rng(0)
    layers = [(rng.random((width, 5), np.float32), np.zeros(5, np.float32))]
    network = _logicity.PolicyNetwork(width, np.arange(width)[None], layers)
    envs = SPFVectorEnv(24, "easy", autoreset_mode="SameStep", num_threads=2)
    envs.reset(seed=3)
    return lambda: envs.collect(network, rng.random((24, 8), np.float32))["rewards"].sum()


def session() -> Callable[[], Any]:
    rows = logicity.Session(logicity.Program(CHAINS), threads=2)
    edges = [(at, at + step) for at in range(400) for step in (1, 7, 50)]
    rows.insert("edge", edges)
    rows.commit()
    numbers = iter(range(1000, 9000))

    def add() -> int:
        rows.insert("edge", [(at, next(numbers)) for at in range(0, 400, 10)])
        rows.commit()
        return len(rows.rows("path"))

    return add


def city() -> Callable[[], Any]:
    with TemporaryDirectory() as folder:
        config = Path(folder) / "large.yaml"
        config.write_text(LARGE)
        simulation = logicity.Simulation(config, threads=2)
    simulation.run(1)

    def run() -> Any:
        simulation.run(2)
        return simulation.positions.sum()

    return run


def measure() -> Callable[[], Any]:
    benchmark = logicity.Benchmark("easy", "val")
    return lambda: benchmark.evaluate(lambda observations: 1).tsr


def learner() -> Callable[[], Any]:
    examples = logicity.demonstrations("easy", 10, "val")
    return lambda: str(logicity.induce(examples, "easy", threads=2))


Use = Callable[[], Callable[[], Any]]


@pytest.mark.parametrize("use", [environments, unused_environments, rollouts, session, city])
def test_a_forked_process_has_threads_of_its_own(use: Use) -> None:
    work = use()
    found, of_grandchild = forked(work), forked(lambda: forked(work))
    # The parent keeps its threads.
    assert found == of_grandchild == work()
    assert forked(work) == work(), "a fork after the parent has continued"


@pytest.mark.parametrize("use", [measure, learner])
def test_threads_of_one_call_start_in_a_forked_process(use: Use) -> None:
    work = use()
    assert work() == forked(work)


def test_a_forked_process_makes_a_data_set(tmp_path: Path) -> None:
    from logicity.vap import make_dataset

    made = forked(lambda: repr(make_dataset(tmp_path / "set", "easy", "val", worlds=2, images=False, threads=2)))
    assert made == "<VapDataset easy, fixed agents, val: 178 samples>"


def test_a_thread_can_fork() -> None:
    work, results = environments(), []
    thread = threading.Thread(target=lambda: results.append(forked(work)))
    thread.start()
    thread.join()
    assert results == [work()]


def test_a_use_during_the_fork_is_reported_in_the_child() -> None:
    envs = SPFVectorEnv(64, "expert", num_threads=2)
    envs.reset(seed=0)
    stop, running = threading.Event(), threading.Event()

    def drive() -> None:
        while not stop.is_set():
            envs.step(np.ones(64, np.int64))
            running.set()

    thread = threading.Thread(target=drive)
    thread.start()
    running.wait()
    try:
        results = [forked(lambda: str(envs.step(np.ones(64, np.int64))[1].shape)) for _ in range(10)]
    finally:
        stop.set()
        thread.join()
    # The child either gets all of the environments between two steps, or learns that it cannot use them.
    assert set(results) <= {"(64,)"} | {text for text in results if "another thread is using" in text}


def step_once(envs: Any, results: Any) -> None:
    results.put(float(envs.step(np.full(envs.num_envs, 1))[0].sum()))


@pytest.mark.parametrize("method", ["fork", "spawn"])
def test_processes_of_multiprocessing(method: str) -> None:
    envs = SPFVectorEnv(16, "easy", num_threads=2)
    envs.reset(seed=1)
    context: Any = multiprocessing.get_context(method)
    results = context.SimpleQueue()
    process = context.Process(target=step_once, args=(envs, results))
    process.start()
    process.join(SECONDS)
    if process.is_alive():
        process.kill()
    assert process.exitcode == 0
    assert results.get() == float(envs.step(np.full(16, 1))[0].sum())


def test_workers_of_a_data_loader() -> None:
    torch = needs("torch", "learn")
    envs = SPFVectorEnv(16, "easy", num_threads=2)
    envs.reset(seed=1)

    class Steps(torch.utils.data.IterableDataset):  # type: ignore[misc, name-defined]
        def __iter__(self) -> Any:
            for _ in range(4):
                yield envs.step(np.full(16, 1))[0]

    loader = torch.utils.data.DataLoader(
        Steps(), batch_size=None, num_workers=2, multiprocessing_context="fork", timeout=SECONDS
    )
    found = [batch.sum().item() for batch in loader]
    expected = [envs.step(np.full(16, 1))[0].sum().item() for _ in range(4)]
    # Each worker has its own copy of the environments.
    assert sorted(found) == sorted(2 * expected)
