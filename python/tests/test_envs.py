from __future__ import annotations

import copy
import json
import pickle
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from functools import partial
from itertools import compress
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from conftest import COUNTING, Interrupt
from gymnasium.error import InvalidAction, ResetNeeded, UnsupportedMode
from gymnasium.utils.env_checker import check_env, data_equivalence
from gymnasium.utils.env_match import check_environments_match
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers.vector import DictInfoToList, RecordEpisodeStatistics
from numpy.typing import NDArray

import logicity
from logicity import _logicity
from logicity.__main__ import main
from logicity.envs.single import SPFEnv
from logicity.envs.vector import SPFVectorEnv

IDS = [f"logicity/SPF-{mode}-v0" for mode in logicity.MODES]
WIDTHS = dict(zip(IDS, [85, 140, 205, 205, 205, 205, 205, 150], strict=True))


@pytest.mark.parametrize("id", IDS)
def test_gymnasium_checker_passes(id: str) -> None:
    env = gymnasium.make(id)
    check_env(env.unwrapped)
    assert env.observation_space.shape == (WIDTHS[id],)
    check_environments_match(env, gymnasium.make(id), 200)


@pytest.mark.parametrize("observation", ["groundings", "state"])
def test_gymnasium_checker_passes_with_options(observation: str) -> None:
    options: dict[str, Any] = {"observation": observation, "atoms": True, "split": "val", "episodes": "recorded"}
    overrides = {"task": {"route_length": True, "reward": {"overtime": -6}}}
    env = gymnasium.make("logicity/SPF-Hard-v0", render_mode="ansi", overrides=overrides, **options)
    check_env(env.unwrapped)
    assert env.observation_space.shape == ((206,) if observation == "groundings" else (20, 19))


def play(env: SPFEnv, steps: int, seed: int) -> list[Any]:
    """Take random steps, reset at the end of each episode, and return all results."""
    generator = np.random.default_rng(seed)
    results: list[Any] = []
    for _ in range(steps):
        results.append(env.step(int(generator.integers(4))))
        if results[-1][2] or results[-1][3]:
            results.append(env.reset())
    return results


def test_a_seed_determines_the_sequence_of_episodes() -> None:
    a, b = SPFEnv(), SPFEnv()
    assert data_equivalence(a.reset(seed=4), b.reset(seed=4), exact=True)
    assert data_equivalence(play(a, 500, 0), play(b, 500, 0), exact=True)
    seeds = {a.reset(seed=seed)[1]["seed"] for seed in range(20)}
    assert len(seeds) == 20


def test_the_oracle_succeeds() -> None:
    env = SPFEnv("easy", split="test", episodes="recorded")
    for episode in range(5):
        _, info = env.reset(options={"episode": episode})
        start = env.episode
        total, done = 0.0, False
        while not done:
            _, reward, terminated, truncated, info = env.step(info["oracle_action"])
            total, done = total + reward, terminated or truncated
        assert info["success"] and info["progress"] == 1.0 and not info["violations"].any()
        assert start["oracle"] is not None
        assert info["steps"] == start["oracle"]["steps"]
        assert total == pytest.approx(start["oracle"]["return"], abs=1e-9)


def test_an_episode_can_be_restarted() -> None:
    env, other = SPFEnv("medium"), SPFEnv("medium")
    first = env.reset(seed=9)
    assert data_equivalence(first, other.reset(options={"episode": env.episode}), exact=True)
    assert data_equivalence(play(env, 10, 1)[:5], play(other, 10, 1)[:5], exact=True)
    # A given episode does not advance the sequence.
    env.reset(seed=9)
    following = env.reset()[1]["seed"]
    env.reset(seed=9)
    env.reset(options={"episode": other.episode})
    assert env.reset()[1]["seed"] == following


def test_terminations_and_truncations() -> None:
    env = SPFEnv("easy", overrides={"task": {"horizon": 3, "reward": {"overtime": -7}}})
    ends = set()
    for seed in range(60):
        env.reset(seed=seed)
        for step in range(3):
            _, reward, terminated, truncated, info = env.step(1)
            if terminated:
                assert (reward <= -10) == info["violations"].any()
                assert info["success"] != info["violations"].any()
                ends.add("terminated")
                break
            assert truncated == (step == 2)
            if truncated:
                assert reward == -7 and not info["success"]
                ends.add("truncated")
    assert ends == {"terminated", "truncated"}


def test_violations_have_a_value_per_clause() -> None:
    env = SPFEnv("expert")
    violated = [env.reset(seed=0)[1]["violations"], *(step[-1]["violations"] for step in play(env, 3000, 0))]
    assert not violated[0].any() and {each.dtype for each in violated} == {np.dtype(np.bool_)}
    assert {each.shape for each in violated} == {(len(env.clauses),)} and len(set(env.clauses)) == len(env.clauses)
    names = set(compress(env.clauses, np.any(violated, axis=0)))
    assert {"S1", "S7", "L1", "F2"} <= names <= set(env.clauses) <= {f"{of}{at}" for of in "SLF" for at in range(1, 8)}
    # The names are reachable from every kind of environment.
    vector: Any = gymnasium.make_vec(IDS[3], num_envs=2)
    single: Any = gymnasium.make(IDS[3])
    assert env.clauses == single.unwrapped.clauses == vector.clauses == logicity.parallel_env("expert").clauses


def test_true_atoms_are_returned_on_request() -> None:
    env = SPFEnv("easy", atoms=True)
    observation, info = env.reset(seed=2)
    assert len(info["true_atoms"]) == observation.sum()
    assert "IsCar(Car_1)" in info["true_atoms"]


def test_another_map_and_other_agents_for_one_episode() -> None:
    env = SPFEnv("easy")
    env.reset(seed=3)
    agents = {"train": {"cars": [{"priority": 1}, {"priority": 2}], "pedestrians": [{"count": 1}]}}
    env.reset(options={"map": "configs/maps/random-8x8.yaml", "agents": agents})
    there = env.episode
    assert [agent["id"] for agent in there["agents"]] == ["Car_1", "Pedestrian_1", "Car_2"]
    twin = copy.deepcopy(env)
    assert data_equivalence(env.step(1), twin.step(1), exact=True)
    assert len(env.reset()[1]) == 6
    assert len(env.episode["agents"]) == 8


def test_explain_and_render_show_the_current_state() -> None:
    env = SPFEnv(render_mode="rgb_array")
    _, info = env.reset(seed=1)
    name = ["Slow", "Normal", "Fast", "Stop"][info["oracle_action"]]
    first, *proof = env.explain().splitlines()
    assert first.startswith("tick 0: Car_1 at [") and first.endswith(f": {name}") and proof
    assert env.explain("IsCar").startswith('IsCar("Car_1") holds: it is a base fact, ')
    with pytest.raises(logicity.InputError, match="did you mean `IsBus`"):
        env.explain("IsBuss")
    before = env.render()
    assert before.dtype == np.uint8 and before.ndim == 3
    env.step(info["oracle_action"])
    assert (env.render() != before).any()
    text = SPFEnv(render_mode="ansi")
    text.reset(seed=1)
    assert "Car_1 at [" in text.render()


def test_the_picture_marks_the_controlled_car_its_route_and_its_goal() -> None:
    env = SPFEnv(render_mode="rgb_array")
    _, info = env.reset(seed=1)
    start, goal = env.episode["agents"][0]["start"], env.episode["agents"][0]["goal"]
    mark = np.array([0xC8, 0x1E, 0xB4], np.uint8)

    def marked(picture: NDArray[np.uint8]) -> NDArray[np.bool_]:
        found: NDArray[np.bool_] = (picture == mark).all(axis=-1)
        return found

    before = marked(env.render())
    # Cells are 4 pixels wide, after the rulers at the edge.
    for row, column in (start, goal):
        top, left = 42 + 4 * row, 34 + 4 * column
        assert before[top - 20 : top + 20, left - 20 : left + 20].sum() > 60
    for _ in range(20):
        *_, info = env.step(info["oracle_action"])
    assert info["progress"] > 0
    after = marked(env.render())
    assert (before & ~after).any() and (after & ~before).any(), (
        "what lies behind is no longer marked, the frame has moved"
    )


def test_a_trace_records_the_episode(tmp_path: Path) -> None:
    env = SPFEnv("hard", split="test")
    with pytest.raises(ResetNeeded):
        env.write_trace(tmp_path / "early.jsonl")
    env.reset(seed=4)
    with pytest.raises(ValueError, match="no steps yet"):
        env.write_trace(tmp_path / "early.jsonl")
    names, infos = ["Slow", "Normal", "Fast", "Stop"], []
    info, done = env.reset(seed=4)[1], False
    while not done:
        wanted = names[info["oracle_action"]]
        _, _, terminated, truncated, info = env.step(2)
        infos.append((wanted, tuple(compress(env.clauses, info["violations"]))))
        done = terminated or truncated
    env.write_trace(tmp_path / "fast.jsonl")
    header, *ticks = [json.loads(line) for line in (tmp_path / "fast.jsonl").read_text().splitlines()]
    assert [agent["id"] for agent in header["agents"]] == [agent["id"] for agent in env.episode["agents"]]
    assert header["seed"] == env.episode["seed"] and header["config"] == "hard" and len(ticks) == len(infos)
    cars = [tick["agents"][0] for tick in ticks]
    assert tuple(cars[0]["at"]) == env.episode["agents"][0]["start"] and {car["action"] for car in cars} == {"Fast"}
    labels = [clause["doc"].split(":")[0] for clause in header["clauses"]]
    recorded = [(car["driven"]["wanted"], tuple(labels[at] for at in car["driven"]["broken"])) for car in cars]
    assert recorded == infos and infos[-1][1]
    assert all(car["driven"]["observes"][0] == "Car_1" for car in cars)
    assert not any("driven" in agent for tick in ticks for agent in tick["agents"][1:])

    # The header equals that of a simulation trace with the same configuration and rules.
    logicity.Simulation("hard", count_firings=True).run(1, trace=tmp_path / "run.jsonl")
    run = json.loads((tmp_path / "run.jsonl").read_text().splitlines()[0])
    keys = ("config_hash", "rules_hash", "rules", "clauses", "version", "configuration", "rule_files")
    assert [header[key] for key in keys] == [run[key] for key in keys]
    with pytest.raises(OSError, match="missing"):
        env.write_trace(tmp_path / "missing" / "trace.jsonl")


def test_a_trace_contains_the_overridden_configuration(tmp_path: Path) -> None:
    env = SPFEnv("easy", overrides={"view": 30})
    env.reset(seed=1, options={"map": "configs/maps/random-8x8.yaml"})
    env.step(1)
    env.write_trace(tmp_path / "trace.jsonl")
    header = json.loads((tmp_path / "trace.jsonl").read_text().splitlines()[0])
    assert header["map"] == "random-8x8" and header["config"] == "easy"
    assert header["configuration"]["view"] == 30 and header["configuration"]["map"]["blocks"] == [8, 8]
    # The configuration in the trace, written to a file, is that of the episode.
    (tmp_path / "config.yaml").write_text(json.dumps(header["configuration"]))
    city = logicity.Simulation(tmp_path / "config.yaml", count_firings=True)
    city.run(1, trace=tmp_path / "run.jsonl")
    assert json.loads((tmp_path / "run.jsonl").read_text().splitlines()[0])["config_hash"] == header["config_hash"]
    done = subprocess.run(
        [sys.executable, "-m", "logicity", "explain", "trace.jsonl", "--agent", "Car_1"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=True,
    )
    assert "Car_1" in done.stdout


@pytest.mark.parametrize("tampered", ["rules", "configuration"])
def test_a_trace_with_other_content_than_its_hashes_is_refused(
    tampered: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    env = SPFEnv("easy")
    env.reset(seed=1)
    env.step(1)
    trace, written = tmp_path / "trace.jsonl", tmp_path / "written"
    env.write_trace(trace)
    header, *ticks = trace.read_text().splitlines()
    content = json.loads(header)
    if tampered == "rules":
        content["rule_files"][0]["text"] = "Stop(X) :- IsCar(X).\n"
    else:
        content["configuration"]["view"] = 7
    trace.write_text("\n".join([json.dumps(content), *ticks]))
    for words in (
        ["explain", trace, "--agent", "Car_1"],
        ["view", trace, "-o", written],
        ["check", "--coverage", trace],
        ["induce", trace, "-o", written],
    ):
        assert main(list(map(str, words))) == 1
        said = capfd.readouterr().err
        assert "error[trace-mismatch]" in said and tampered in said, said
    assert not written.exists()


def test_a_trace_replaces_own_files_only(tmp_path: Path) -> None:
    env = SPFEnv("easy")
    env.reset(seed=1)
    env.step(1)
    trace = tmp_path / "easy.jsonl"
    for _ in range(2):
        env.write_trace(trace)
    trace.write_text("foreign")
    with pytest.raises(FileExistsError, match=r"easy\.jsonl.*overwrite"):
        env.write_trace(trace)
    city = logicity.Simulation("easy", count_firings=True)
    with pytest.raises(FileExistsError):
        city.run(1, trace=trace)
    assert city.tick().tick == 0, "no tick ran before the refusal"
    assert trace.read_text() == "foreign"
    env.write_trace(trace, overwrite=True)
    assert trace.read_text() != "foreign"
    with pytest.raises(FileExistsError, match="`write_trace` wrote it"):
        city.run(1, trace=trace)


def test_concurrent_use_of_an_environment_raises() -> None:
    envs = SPFVectorEnv(64, "expert", autoreset_mode=AutoresetMode.SAME_STEP)
    envs.reset(seed=1)
    actions, messages = np.ones(64, np.int64), []
    stop = threading.Event()

    def drive() -> None:
        while not stop.is_set():
            try:
                envs.step(actions)
            except RuntimeError as error:
                messages.append(str(error))
                stop.set()

    threads = [threading.Thread(target=drive) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(20)
        stop.set()
    message = "another thread is using this environment; create one per thread, or guard it with a lock"
    assert messages and all(message in text for text in messages)
    # The exception leaves the environments usable.
    envs.reset(seed=1)
    assert envs.step(actions)[0].shape == (64, 205)


def test_overrides_accept_numpy_values(tmp_path: Path) -> None:
    plain = {"task": {"horizon": 3, "reward": {"overtime": -1.5, "actions": {"Stop": -4}}}}
    horizon, reward = np.int64(3), {"overtime": np.float32(-1.5), "actions": {"Stop": np.array(-4)}}
    ends = []
    for overrides in (plain, {"task": {"horizon": horizon, "reward": reward}}):
        env = SPFEnv("easy", overrides=overrides)
        env.reset(seed=1)
        ends.append([env.step(3)[1:4] for _ in range(3)])
    assert ends[0] == ends[1] and ends[0][2][2]
    with pytest.raises(TypeError, match="a configuration cannot hold a complex"):
        SPFEnv("easy", overrides={"task": {"horizon": 3j}})
    with pytest.raises(logicity.InputError, match="nowhere.yaml"):
        SPFEnv("easy", overrides={"agents": tmp_path / "nowhere.yaml"})


@pytest.mark.parametrize(
    ("make", "name", "message"),
    [
        (partial(gymnasium.make, IDS[0]), "observations", "did you mean `observation`"),
        (partial(gymnasium.make, IDS[0]), "episode", "did you mean `episodes`"),
        (partial(gymnasium.make, IDS[0]), "hue", "known: split, rules, .*, episodes, atoms, render_mode"),
        (partial(gymnasium.make_vec, IDS[0], num_envs=2), "num_thread", "did you mean `num_threads`"),
        (partial(logicity.demonstrations, "easy", 1), "rule", "did you mean `rules`"),
    ],
)
def test_unknown_options_raise(make: Any, name: str, message: str) -> None:
    with pytest.raises(TypeError, match=f"got an unexpected keyword argument '{name}'; {message}"):
        make(**{name: 1})


def test_rules_must_be_a_path() -> None:
    for text in ("Stop(X) :- IsCar(X).", "// no rules\n"):
        for use in (partial(SPFEnv, "easy"), partial(logicity.Simulation, "easy"), partial(logicity.Inference, "easy")):
            with pytest.raises(ValueError, match="`rules` must be the path of a rule file, not source text"):
                use(rules=text)


WAYS: dict[str, Callable[[Any], Any]] = {
    "copy": copy.copy,
    "deepcopy": copy.deepcopy,
    "pickle": lambda it: pickle.loads(pickle.dumps(it)),
}


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("episodes", ["drawn", "drawn-demanding", "recorded"])
def test_a_copy_continues_identically(way: str, episodes: Any) -> None:
    overrides = {"task": {"curriculum": [{"until": 9, "agents": 5}]}}
    env = SPFEnv("hard", atoms=True, episodes=episodes, action_masks=True, overrides=overrides)
    untouched = WAYS[way](env)
    with pytest.raises(ResetNeeded):
        untouched.step(0)
    env.reset(seed=5)
    play(env, 137, 2)
    twin = WAYS[way](env)
    assert twin.episode == env.episode
    assert data_equivalence(play(env, 200, 3), play(twin, 200, 3), exact=True)
    assert env.np_random.integers(1000) == twin.np_random.integers(1000)
    # A copy after an invalid reset needs a reset, too.
    with pytest.raises(ValueError):
        env.reset(options={"episode": -1})
    with pytest.raises(ResetNeeded):
        WAYS[way](env).step(0)


def test_a_pickled_environment_reads_no_rule_file(tmp_path: Path) -> None:
    (tmp_path / "mine.dl").write_text('.include "vocabulary.dl"\nStop(X) :- IsCar(X).\n')
    (tmp_path / "mine.yaml").write_text("base: configs/easy.yaml\nrules: mine.dl\n")
    env = SPFEnv(tmp_path / "mine.yaml", overrides={"view": 30})
    assert env.reset(seed=0)[1]["oracle_action"] == 3
    data = pickle.dumps(env)
    for file in tmp_path.iterdir():
        file.unlink()
    twin = pickle.loads(data)
    assert data_equivalence(play(env, 20, 1)[0], play(twin, 20, 1)[0], exact=True)
    assert twin.explain() == env.explain()


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("mode", AutoresetMode)
def test_a_copied_vector_environment_continues_identically(way: str, mode: AutoresetMode) -> None:
    envs = SPFVectorEnv(5, "easy", autoreset_mode=mode, atoms=True, num_threads=2)
    with pytest.raises(ResetNeeded):
        WAYS[way](envs).step(np.zeros(5, int))
    generator = np.random.default_rng(0)

    def proceed(of: SPFVectorEnv, actions: NDArray[np.int64], done: NDArray[np.bool_]) -> Any:
        if mode is AutoresetMode.DISABLED and done.any():
            of.reset(options={"reset_mask": done})
        return of.step(actions)

    envs.reset(seed=3)
    done = np.zeros(5, np.bool_)
    for _ in range(30):
        results = proceed(envs, generator.integers(4, size=5), done)
        done = results[2] | results[3]
    twin = WAYS[way](envs)
    ends = 0
    for _ in range(150):
        actions = generator.integers(4, size=5)
        one, other = proceed(envs, actions, done), proceed(twin, actions, done)
        assert data_equivalence(one, other, exact=True)
        done = one[2] | one[3]
        ends += int(done.sum())
    assert ends > 10
    one, other = envs.reset(), twin.reset()
    assert data_equivalence(one, other, exact=True)


def test_the_spec_has_the_horizon_of_the_environment(tmp_path: Path) -> None:
    for id in IDS:
        env = gymnasium.make(id)
        horizon = 400 if id in (IDS[0], IDS[1], "logicity/SPF-Town-v0") else 200
        assert env.spec is not None and env.spec.max_episode_steps == horizon, id
        # The environment truncates itself: gymnasium adds no `TimeLimit`.
        assert "TimeLimit" not in str(env)
        envs = gymnasium.make_vec(id, num_envs=2)
        assert envs.spec is not None and envs.spec.max_episode_steps == horizon
    with pytest.raises(ValueError, match='the horizon is .*`overrides={"task": {"horizon": 50}}`'):
        gymnasium.make_vec(IDS[0], num_envs=2, max_episode_steps=50)
    env = gymnasium.make(IDS[0], overrides={"task": {"horizon": 7}})
    assert env.spec is not None and env.spec.max_episode_steps == 7
    again = gymnasium.make(env.spec)
    assert again.spec == env.spec or again.spec is not None and again.spec.max_episode_steps == 7
    # The longest of the recorded episodes of the test set takes the oracle 462 steps.
    env = gymnasium.make(IDS[0], episodes="recorded", split="test")
    assert env.spec is not None and env.spec.max_episode_steps == 924
    lines = (Path(__file__).parents[2] / "configs" / "episodes" / "easy-test.jsonl").read_text().splitlines()[1:]
    longest = max(range(100), key=lambda number: json.loads(lines[number])["oracle"]["steps"])
    for made in (env, gymnasium.make(env.spec)):
        made.reset(options={"episode": longest})
        for step in range(1, 925):  # noqa: B007
            *_, terminated, truncated, info = made.step(3)
            assert not terminated or info["violations"].any()
            if terminated or truncated:
                break
        assert terminated or step == 924


def test_autoreset_modes_have_several_spellings() -> None:
    spellings: dict[AutoresetMode, list[Any]] = {
        AutoresetMode.SAME_STEP: ["SameStep", "SAME_STEP", "same_step", "AutoresetMode.SAME_STEP"],
        AutoresetMode.NEXT_STEP: ["NextStep", "NEXT_STEP", "next_step"],
        AutoresetMode.DISABLED: ["Disabled", "DISABLED", "disabled"],
    }
    for mode, names in spellings.items():
        for name in (mode, *names):
            envs = gymnasium.make_vec(IDS[0], num_envs=1, autoreset_mode=name)
            assert isinstance(envs, SPFVectorEnv) and envs.autoreset_mode is mode
            assert envs.metadata["autoreset_mode"] is mode
    for wrong in ("Never", "same", "", 1, None):
        with pytest.raises(ValueError, match='autoreset_mode must be one of "NextStep", "SameStep", "Disabled", not'):
            SPFVectorEnv(1, autoreset_mode=wrong)  # type: ignore[arg-type]


def test_wrappers_find_the_info_of_ended_episodes() -> None:
    """In SameStep mode, the step's info is that of the next episode, and `final_info` that of the ended one."""
    for vectorization in ("vector_entry_point", "sync"):
        arguments: dict[str, Any] = {"autoreset_mode": AutoresetMode.SAME_STEP}
        if vectorization == "sync":
            arguments = {"vector_kwargs": arguments}
        made = gymnasium.make_vec(IDS[0], num_envs=3, vectorization_mode=vectorization, **arguments)
        envs = DictInfoToList(RecordEpisodeStatistics(made))
        envs.reset(seed=0)
        ended = 0
        while ended < 5:
            _, _, terminated, truncated, infos = envs.step(np.full(3, 2))
            for at in np.flatnonzero(terminated | truncated):
                final = infos[at]["final_info"]
                assert infos[at]["progress"] == 0 and infos[at]["steps"] == 0 and infos[at]["episode"]["l"] >= 1
                assert final["steps"] == infos[at]["episode"]["l"] and 0 < final["progress"] <= 1
                assert final["violations"].any() or final["success"] or truncated[at]
                ended += 1


def test_invalid_use_raises_gymnasium_errors() -> None:
    env = SPFEnv("easy")
    for use in (lambda: env.step(0), env.explain, lambda: env.episode):
        with pytest.raises(ResetNeeded):
            use()
    env.reset(seed=0)
    for action in (4, -1, 2**70, float("nan"), 1.0, True, np.True_, "1", None, np.zeros(2, int)):
        with pytest.raises(InvalidAction):
            env.step(action)  # type: ignore[arg-type]
    assert env.step(np.int64(1))[4]["steps"] == 1
    while not any(env.step(2)[2:4]):
        pass
    with pytest.raises(ResetNeeded):
        env.step(1)
    env.reset()
    with pytest.raises(gymnasium.error.Error, match="render_mode"):
        env.render()
    with pytest.raises(gymnasium.error.Error):
        env.reset(seed=-1)
    with pytest.raises(gymnasium.error.Error):
        env.reset(seed=2**64)
    for options in (5, 0, "", [("episode", 1)]):
        with pytest.raises(TypeError, match=f"^options: expected dict, not {type(options).__name__}"):
            env.reset(options=options)  # type: ignore[arg-type]


def test_invalid_arguments_raise() -> None:
    with pytest.raises(FileNotFoundError, match="did you mean `expert`"):
        SPFEnv("expret")
    with pytest.raises(ValueError, match='split must be one of .*, not "dev"'):
        SPFEnv(split="dev")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="observation must be one of"):
        SPFEnv(observation="pixels")  # type: ignore[arg-type]
    for make in (SPFEnv, SPFVectorEnv):
        with pytest.raises(ValueError, match="known: `drawn`, `drawn-demanding`, `recorded`"):
            make(episodes="all")  # type: ignore[arg-type]
        with pytest.raises(ValueError, match="did you mean `drawn-demanding`"):
            make(episodes="drawn_demanding")  # type: ignore[arg-type]
    with pytest.raises(UnsupportedMode):
        SPFEnv(render_mode="window")
    with pytest.raises(ValueError, match="base"):
        SPFEnv(overrides={"base": "easy"})
    with pytest.raises(logicity.InputError) as caught:
        SPFEnv(overrides={"task": {"horizn": 3}})
    assert caught.value.diagnostics[0]["code"] == "unknown-key"
    with pytest.raises(logicity.InputError):
        SPFEnv("easy", overrides={"task": {"reward": {"clauses": {"S9": -1}}}})


def test_invalid_rule_files_are_reported_with_their_location(tmp_path: Any) -> None:
    rules = tmp_path / "mine.dl"
    rules.write_text('.include "vocabulary.dl"\nStop(X) :- IsCarr(X).\n')
    with pytest.raises(logicity.InputError) as caught:
        SPFEnv(rules=rules)
    assert caught.value.diagnostics[0]["labels"][0]["line"] == 2
    rules.write_text('.include "vocabulary.dl"\nStop(X) :- IsCar(X).\n')
    env = SPFEnv(rules=rules)
    assert env.reset(seed=0)[1]["oracle_action"] == 3


def test_invalid_episodes_raise_and_the_environment_stays_usable() -> None:
    env = SPFEnv("easy")
    env.reset(seed=0)
    good = env.episode
    for wrong in (-1, 1.5, True, "first"):
        with pytest.raises(ValueError, match="expected an episode number"):
            env.reset(options={"episode": wrong})
    with pytest.raises(IndexError, match="no episode 1000"):
        env.reset(options={"episode": 1000})
    with pytest.raises(ValueError, match="unknown option"):
        env.reset(options={"epsiode": 1})
    for number in (2**64, np.uint64(2**64 - 1), 10**30):
        with pytest.raises(IndexError, match=f"no episode {number}: the split `train` has 100 episodes, from 0"):
            env.reset(options={"episode": number})
    oracle = {"steps": 3, "return": 1.5, "constrained": {"Stop": 1}}

    def first(**changes: Any) -> dict[str, Any]:
        return {**good, "agents": [{**good["agents"][0], **changes}, *good["agents"][1:]]}

    faulty: list[tuple[dict[str, Any], str]] = [
        ({"seed": 1}, "the episode has no `agents`"),
        ({**good, "oracel": oracle}, "unknown key `oracel`(.|\n)*did you mean `oracle`"),
        ({**good, "seed": -1}, "`seed` of the episode cannot be read"),
        ({**good, "seed": "1"}, "`seed` of the episode cannot be read"),
        ({**good, "agents": 3}, "`agents` of the episode cannot be read"),
        ({**good, "agents": [3]}, "agent 0 of the episode must be a mapping"),
        ({**good, "agents": good["agents"][:-1]}, "7 agents, the split has 8"),
        (first(id="Car_77"), "no agent `Car_77`(.|\n)*did you mean"),
        (first(start=(1, 2, 3)), "`start` of agent 0"),
        (first(goal=(-1, 10**6)), "cannot go from"),
        (first(hue="red"), "agent 0 of the episode has an unknown key `hue`"),
        ({**good, "oracle": {**oracle, "steps": 1.5}}, "`steps` of the oracle's run"),
        ({**good, "oracle": {**oracle, "constrained": {"Stpo": 1}}}, "`Stpo`(.|\n)*did you mean `Stop`"),
    ]
    for episode, message in faulty:
        with pytest.raises(logicity.InputError, match=message) as caught:
            env.reset(options={"episode": episode})
        assert caught.value.diagnostics[0]["code"] == "invalid-episode"
        with pytest.raises(ResetNeeded):
            env.step(1)
    env.reset(options={"episode": {**good, "seed": np.uint64(good["seed"]), "oracle": oracle}})
    assert env.episode == {**good, "oracle": oracle}
    env.reset(options={"episode": good})
    env.step(1)


def singles(count: int, id: str, mode: AutoresetMode, **options: Any) -> SyncVectorEnv:
    def make() -> gymnasium.Env[Any, Any]:
        return gymnasium.make(id, **options)

    return SyncVectorEnv([make] * count, autoreset_mode=mode)


@pytest.mark.parametrize("mode", AutoresetMode)
@pytest.mark.parametrize(
    ("id", "threads", "options"),
    [
        ("logicity/SPF-Expert-v0", 1, {}),
        ("logicity/SPF-Expert-v0", 3, {"split": "test", "episodes": "recorded"}),
        ("logicity/SPF-Easy-v0", 2, {"observation": "state", "atoms": True}),
        (
            "logicity/SPF-Hard-v0",
            2,
            {
                "episodes": "drawn-demanding",
                "oracle": False,
                "action_masks": True,
                "overrides": {
                    "task": {
                        "order": "nearest",
                        "curriculum": [{"until": 3, "agents": 4}, {"until": 9, "agents": 7}],
                        "reward": {"progress": 5, "goal": 1, "potential": {"weight": 2, "gamma": 0.9}},
                    }
                },
            },
        ),
    ],
)
def test_vectorized_results_equal_single_environments(
    mode: AutoresetMode, id: str, threads: int, options: dict[str, Any]
) -> None:
    """Compare about 10^5 steps over all cases with gymnasium's `SyncVectorEnv`."""
    count, steps = 16, 700
    batch = gymnasium.make_vec(id, num_envs=count, autoreset_mode=mode, num_threads=threads, **options)
    assert isinstance(batch, SPFVectorEnv) and batch.metadata["autoreset_mode"] is mode
    alone = singles(count, id, mode, **options)
    assert batch.observation_space == alone.observation_space and batch.action_space == alone.action_space
    assert data_equivalence(batch.reset(seed=11), alone.reset(seed=11), exact=True)
    generator, ends, done = np.random.default_rng(0), 0, np.zeros(count, np.bool_)
    for _ in range(steps):
        if mode is AutoresetMode.DISABLED and done.any():
            results = [envs.reset(options={"reset_mask": done.copy()}) for envs in (batch, alone)]
            assert data_equivalence(results[0], results[1], exact=True)
        actions = generator.integers(4, size=count)
        one, other = batch.step(actions), alone.step(actions)
        for a, b in zip(one, other, strict=True):
            assert data_equivalence(a, b, exact=True)
        done = one[2] | one[3]
        ends += int(done.sum())
    assert ends > 100


def test_the_order_of_environments_does_not_matter() -> None:
    seeds = [5, 6, 7, 8, 9, 10]
    order = np.array([3, 1, 5, 0, 2, 4])
    a, b = (SPFVectorEnv(6, autoreset_mode="SameStep", num_threads=threads) for threads in (1, 4))
    observations = a.reset(seed=seeds)[0], b.reset(seed=[seeds[at] for at in order])[0]
    generator = np.random.default_rng(1)
    for _ in range(300):
        assert (observations[0][order] == observations[1]).all()
        actions = generator.integers(4, size=6)
        one, other = a.step(actions), b.step(actions[order])
        observations = one[0], other[0]
        for x, y in zip(one[1:4], other[1:4], strict=True):
            assert (x[order] == y).all()


def test_a_shared_buffer_is_opt_in() -> None:
    for shared in (False, True):
        envs = SPFVectorEnv(4, copy=not shared)
        first, _ = envs.reset(seed=0)
        second = envs.step(np.zeros(4, int))[0]
        assert np.shares_memory(first, second) == shared


def test_vector_reset_starts_given_episodes() -> None:
    envs = SPFVectorEnv(3, "easy", split="test")
    envs.reset(seed=0, options={"episodes": [7, None, 8]})
    single = SPFEnv("easy", split="test")
    single.reset(options={"episode": 7})
    assert envs.episode(0) == single.episode
    assert envs.episode(1)["oracle"] is None
    assert envs.explain(2).startswith("tick 0: Car_1 at [")


def test_invalid_use_of_a_vector_environment_raises() -> None:
    envs = SPFVectorEnv(3, "easy", autoreset_mode=AutoresetMode.DISABLED)
    with pytest.raises(ResetNeeded, match="environment 0"):
        envs.step(np.zeros(3, int))
    envs.reset(seed=0)
    nan = np.full(3, np.nan)
    for actions in (
        np.zeros(2, int),
        np.zeros((3, 1), int),
        np.zeros(3),
        nan,
        [0, 1, 4],
        [0, -1, 0],
        None,
        [0, "1", 2],
        [True, False, True],
    ):
        with pytest.raises(InvalidAction):
            envs.step(actions)  # type: ignore[arg-type]
    done = np.zeros(3, np.bool_)
    while not done.any():
        _, _, terminated, truncated, _ = envs.step([2, 2, 2])
        done = terminated | truncated
    with pytest.raises(ResetNeeded):
        envs.step([1, 1, 1])
    for mask, error in (
        (np.zeros(3, np.bool_), ValueError),
        (np.ones(2, np.bool_), ValueError),
        ([True] * 3, TypeError),
    ):
        with pytest.raises(error):
            envs.reset(options={"reset_mask": mask})
    for seed in ("x", b"abc", 1.5, {0: 1}, np.array(3)):
        with pytest.raises(gymnasium.error.Error, match="^seed: expected an integer or a list, not "):
            envs.reset(seed=seed)  # type: ignore[arg-type]
    for options, message in (
        (5, "options: expected dict, not int"),
        ("", "options: expected dict, not str"),
        ({"episodes": 5}, "episodes: expected a list, not int"),
        ({"episodes": "abc"}, "episodes: expected a list, not str"),
    ):
        with pytest.raises(TypeError, match=f"^{message}"):
            envs.reset(options=options)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="2 seeds"):
        envs.reset(seed=[1, 2])
    with pytest.raises(ValueError, match="give one of them"):
        envs.reset(options={"episode": 1, "episodes": [1, 2, 3]})
    for at in (-1, 3, 2**70):
        for method in (envs.episode, envs.explain):
            with pytest.raises(IndexError, match=f"no environment {at}: expected 0 to 2"):
                method(at)
    for seed in (-1, 2**64, 1.5, "1"):
        with pytest.raises(gymnasium.error.Error, match=r"^seed: expected (0 to 2\*\*64 - 1|an integer), not "):
            envs.reset(seed=[1, seed, 2])  # type: ignore[list-item]
    for name, value in [("num_envs", 0), ("num_envs", -1), ("num_threads", 0), ("num_threads", 1025)]:
        with pytest.raises(ValueError, match=f"{name}: expected 1 to .*, not {value}"):
            wrong: dict[str, Any] = {name: value}
            SPFVectorEnv(**wrong)


def test_ctrl_c_ends_a_step_and_a_reset_recovers(tmp_path: Path, ctrl_c: Interrupt) -> None:
    (tmp_path / "counting.dl").write_text(COUNTING)
    env = SPFEnv("easy", rules=tmp_path / "counting.dl")
    env.reset(seed=0)
    ctrl_c(lambda: env.step(3))
    assert pickle.loads(pickle.dumps(env)).observation_space == env.observation_space
    for use in (lambda: env.step(1), env.explain, lambda: env.episode):
        with pytest.raises(ResetNeeded):
            use()
    env.reset()
    env.step(1)
    for threads in (1, 2):
        envs = SPFVectorEnv(40, "easy", rules=tmp_path / "counting.dl", num_threads=threads)
        envs.reset(seed=0)
        envs.step(np.ones(40, int))
        ctrl_c(partial(envs.step, np.where(np.arange(40) < 20, 1, 3)))
        with pytest.raises(ResetNeeded):
            envs.step(np.ones(40, int))
        envs.reset()
        envs.step(np.ones(40, int))
    cars = logicity.parallel_env("easy", rules=tmp_path / "counting.dl")
    cars.reset(seed=0)
    ctrl_c(lambda: cars.step(dict.fromkeys(cars.agents, 3)))
    cars.reset()
    cars.step(dict.fromkeys(cars.agents, 1))


@pytest.mark.skipif(sys.platform == "win32", reason="signals are sent as POSIX has them")
@pytest.mark.parametrize("kind", [TypeError, OverflowError])
def test_exceptions_of_signal_handlers_propagate(kind: type[Exception], tmp_path: Path) -> None:
    def handle(signum: int, frame: Any) -> None:
        raise kind("of the handler")

    (tmp_path / "counting.dl").write_text(COUNTING)
    env = SPFEnv("easy", rules=tmp_path / "counting.dl")
    env.reset(seed=0)
    cars = logicity.parallel_env("easy", rules=tmp_path / "counting.dl")
    cars.reset(seed=0)
    previous = signal.signal(signal.SIGALRM, handle)
    uses: list[Callable[[], object]] = [
        lambda: env.step(3),
        lambda: cars.step(dict.fromkeys(cars.agents, 3)),
    ]
    try:
        for use in uses:
            signal.setitimer(signal.ITIMER_REAL, 0.3)
            with pytest.raises(kind, match="of the handler"):
                use()
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, previous)


def test_a_vector_environment_needs_a_reset_first() -> None:
    envs = SPFVectorEnv(3, "easy", render_mode="ansi", autoreset_mode=AutoresetMode.DISABLED)
    for use in (partial(envs.episode, 0), partial(envs.explain, 0), envs.render):
        with pytest.raises(ResetNeeded, match="of environment 0 has not started"):
            use()
    envs.reset(seed=0, options={"reset_mask": np.array([True, False, True])})
    assert envs.episode(2)["agents"] and envs.explain(0)
    for use in (partial(envs.episode, 1), partial(envs.explain, 1), envs.render):
        with pytest.raises(ResetNeeded, match="of environment 1 has not started"):
            use()
    envs.reset()
    assert len(envs.render() or ()) == 3


def test_ctrl_c_ends_the_creation_of_many_environments(ctrl_c: Interrupt) -> None:
    task = _logicity.Task("expert", None, None, (None, None, None))
    ctrl_c(lambda: _logicity.VectorEnv(task, "train", 1_000_000, "Disabled", "groundings", "drawn", 1, False))


def test_recorded_seeds_keep_all_bits(tmp_path: Path) -> None:
    path = Path(__file__).parents[2] / "configs" / "episodes" / "easy-val.jsonl"
    recorded = [json.loads(line)["seed"] for line in path.read_text().splitlines()[1:]]
    assert max(recorded) > 2**63 and all(int(float(seed)) != seed for seed in recorded)
    env = SPFEnv("easy", split="val")
    # `info` has the 64 bits as a signed number, so that collectors can store it.
    signed = np.array(recorded, np.uint64).astype(np.int64).tolist()
    single = [env.reset(options={"episode": number})[1]["seed"] for number in range(40)]
    again = env.reset(options={"episode": json.loads(json.dumps(env.episode))})[1]["seed"]
    assert single == signed and again == signed[-1] and all(type(seed) is np.int64 for seed in single)
    assert [int(seed) % 2**64 for seed in single] == recorded
    assert copy.deepcopy(env).episode["seed"] == pickle.loads(pickle.dumps(env)).episode["seed"] == recorded[-1]
    envs = SPFVectorEnv(40, "easy", split="val")
    infos = envs.reset(options={"episodes": list(range(40))})[1]
    assert infos["seed"].dtype == np.int64 and infos["seed"].tolist() == signed
    assert envs.step(np.ones(40, int))[4]["seed"].tolist() == signed
    assert [trajectory.seed for trajectory in logicity.demonstrations("easy", 40, "val")] == recorded


def test_limits_apply_to_environments(tmp_path: Path) -> None:
    rules = tmp_path / "rules.dl"
    counted = ".decl N(x: number)\nN(0).\nN(X + 1) :- N(X), X < 5000.\n"
    rules.write_text(f'.include "vocabulary.dl"\n{counted}Stop(X) :- IsCar(X), CollidingClose(X, Y), N(6000).\n')
    little: logicity.Limits = {"max_rows": 100}
    for env in (
        gymnasium.make("logicity/SPF-Easy-v0", rules=rules, limits=little),
        pickle.loads(pickle.dumps(SPFEnv("easy", rules=rules, limits=little))),
        SPFVectorEnv(2, "easy", rules=rules, limits=little),
    ):
        with pytest.raises(logicity.LimitError, match="raise the limit `max_rows`"):
            env.reset(seed=0)
    with pytest.raises(logicity.LimitError, match="raise the limit `max_rows`"):
        logicity.evaluate(lambda observations: 1, "easy", "val", rules=rules, limits=little)
    SPFEnv("easy", rules=rules, limits={"max_rows": 50_000}).reset(seed=0)
