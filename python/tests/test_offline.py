from __future__ import annotations

import re
import shutil
import subprocess
from collections import defaultdict
from itertools import product
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from conftest import needs

import logicity
from logicity import ENVIRONMENTS, Demonstrations, demonstrations
from logicity.types import ArrayKind


@pytest.fixture(scope="module")
def few() -> Demonstrations:
    return demonstrations("easy", 6)


@pytest.mark.parametrize("mode", list(ENVIRONMENTS))
def test_every_mode_has_a_hundred_demonstrations(mode: str) -> None:
    trajectories = demonstrations(mode)
    assert len(trajectories) == 100
    env = gymnasium.make(ENVIRONMENTS[mode], split="train")
    for trajectory in trajectories[:3]:
        steps = len(trajectory)
        assert trajectory.observations.shape == (steps + 1, *env.observation_space.shape)  # type: ignore[misc]
        assert trajectory.terminations.tolist() == [False] * (steps - 1) + [True]
        assert not trajectory.truncations.any() and trajectory.infos["success"].tolist() == [False] * steps + [True]
        assert (trajectory.actions == trajectory.infos["oracle_action"][:-1]).all()
        env.reset(options={"episode": trajectory.episode})
        recorded: Any = env.unwrapped
        oracle = recorded.episode["oracle"]
        assert steps == oracle["steps"] and trajectory.rewards.sum() == pytest.approx(oracle["return"])


def test_demonstrations_have_a_short_repr(few: Demonstrations) -> None:
    steps = sum(len(trajectory) for trajectory in few)
    assert repr(few) == f"<Demonstrations of easy, train: 6 trajectories, {steps} steps>"


def test_demonstrations_can_be_replayed(few: Demonstrations) -> None:
    env = gymnasium.make(few.env)
    for trajectory in few:
        observation, _ = env.reset(options={"episode": trajectory.episode})
        for step, action in enumerate(trajectory.actions):
            assert (observation == trajectory.observations[step]).all()
            observation, reward, *_ = env.step(action)
            assert reward == trajectory.rewards[step]
        assert (observation == trajectory.observations[-1]).all()


def test_demonstrations_of_a_configuration_file(
    own_city: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    own, easy = demonstrations(own_city, split="val"), demonstrations("easy", 5, "val")
    assert len(own) == 5 and own.mode == str(own_city) and own.atoms == easy.atoms
    for one, other in zip(own, easy, strict=True):
        assert (one.observations == other.observations).all() and (one.actions == other.actions).all()
    assert [folder.name for folder in own.to_popper(tmp_path)] == ["stop"]
    # The spec of the environment works in another directory, although the path was relative.
    monkeypatch.chdir(own_city.parent)
    spec = demonstrations(own_city.name, 1, "val").env
    monkeypatch.chdir("/")
    gymnasium.make(spec).reset(options={"episode": 4})


@pytest.mark.parametrize(
    ("arguments", "error"),
    [
        ({"mode": "simple"}, ValueError),
        ({"mode": "no-such.yaml"}, OSError),
        ({"mode": "configs/vap-easy.yaml"}, logicity.InputError),
        ({"mode": "easy", "n": 0}, ValueError),
        ({"mode": "easy", "n": 101}, ValueError),
        ({"mode": "easy", "n": 41, "split": "val"}, ValueError),
        ({"mode": "easy", "overrides": {"task": {"episodes": {"train": None}}}}, ValueError),
        ({"mode": "easy", "split": "exam"}, ValueError),
        ({"mode": "easy", "observation": "pixels"}, ValueError),
        ({"mode": "easy", "rules": "no.dl"}, OSError),
        ({"mode": "easy", "overrides": {"task": {"horizon": 0}}}, logicity.InputError),
    ],
)
def test_invalid_arguments_raise(arguments: dict[str, Any], error: type[Exception]) -> None:
    with pytest.raises(error):
        demonstrations(**arguments)


FACT = re.compile(r"(\w+)\(([\w,]+)\)\.")


def read_facts(file: Path) -> dict[str, set[tuple[str, ...]]]:
    facts: dict[str, set[tuple[str, ...]]] = defaultdict(set)
    for line in file.read_text().splitlines():
        if match := FACT.fullmatch(line):
            assert tuple(match[2].split(",")) not in facts[match[1]]
            facts[match[1]].add(tuple(match[2].split(",")))
        else:
            assert line.startswith(":- dynamic "), line
    return facts


def test_easy_rules_hold_in_the_popper_files(few: Demonstrations, tmp_path: Path) -> None:
    (folder,) = few.to_popper(tmp_path / "ilp")
    facts = read_facts(folder / "bk.pl")
    examples = [line[:-2].split("(") for line in (folder / "exs.pl").read_text().splitlines()]
    positive = {(one[2][:-1],) for one in examples if one[:2] == ["pos", "stop"]}
    negative = {(one[2][:-1],) for one in examples if one[:2] == ["neg", "stop"]}
    assert len(examples) == sum(map(len, few)) == len(positive) + len(negative) and positive and negative
    # S1, S2 and S7 of rules/easy.dl, scoped by `sees`.
    sees, at, inside = facts["sees"], facts["is_at_inter"], facts["is_in_inter"]
    stops = {(x,) for x, y in sees if (x,) in at and (y,) in inside}
    stops |= {(x,) for x, y in sees if (x,) in at and (y,) in at and (y, x) in facts["higher_pri"]}
    stops |= {(x,) for x, y in sees if (x, y) in facts["colliding_close"]}
    assert stops == positive


#: Loads the files as Popper does, and counts the examples that rules of rules/easy.dl cover: S1; and S1, S2 or S7.
PROLOG = """
:- [bk], [exs], [bias].

s1(X) :- is_at_inter(X), sees(X, Y), is_in_inter(Y).
stops(X) :- s1(X).
stops(X) :- is_at_inter(X), sees(X, Y), is_at_inter(Y), higher_pri(Y, X).
stops(X) :- sees(X, Y), colliding_close(X, Y).

ego(Sign, X) :- member(Sign, [pos, neg]), head_pred(Head, 1), Example =.. [Head, X], call(Sign, Example).
covered(Sign, Rule, Count) :- aggregate_all(count, (ego(Sign, X), once(call(Rule, X))), Count).

main :-
    forall(body_pred(Name, Arity), (functor(Goal, Name, Arity), predicate_property(Goal, defined))),
    forall(ego(_, X), (sees(X, X), is_car(X))),
    forall(member(Rule, [s1, stops]), (covered(pos, Rule, Good), covered(neg, Rule, Bad), writeln([Rule, Good, Bad]))).
"""


def test_prolog_reads_the_popper_files(tmp_path: Path) -> None:
    swipl = shutil.which("swipl")
    if swipl is None:
        pytest.skip("needs SWI-Prolog: `apt-get install swi-prolog-nox`")
    (folder,) = demonstrations("easy", 6).to_popper(tmp_path)
    (folder / "check.pl").write_text(PROLOG)
    command = [swipl, "-q", "--on-warning=halt", "--on-error=halt", "-g", "main", "-t", "halt", "check.pl"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=folder, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    scores = dict(re.findall(r"\[(\w+),(\d+,\d+)\]", done.stdout))
    positive = (folder / "exs.pl").read_text().count("pos(")
    (s1, s1_wrong), (all_rules, wrong) = ([int(count) for count in scores[rule].split(",")] for rule in ("s1", "stops"))
    assert 0 < s1 < all_rules == positive and s1_wrong == wrong == 0


def test_false_atoms_are_explicit_facts(few: Demonstrations, tmp_path: Path) -> None:
    (folder,) = few.to_popper(tmp_path)
    facts = read_facts(folder / "bk.pl")
    seen = defaultdict(set)
    for ego, entity in facts["sees"]:
        seen[ego].add(entity)
    assert all(ego in entities for ego, entities in seen.items()) and {len(s) for s in seen.values()} > {1}
    for name, arity in {(name, len(entities)) for name, entities in few.atoms}:
        snake = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name).lower()
        true, false = facts[snake], facts[f"not_{snake}"]
        assert not true & false
        assert true | false == {pair for entities in seen.values() for pair in product(entities, repeat=arity)}
    bias = (folder / "bias.pl").read_text().splitlines()
    assert "head_pred(stop,1)." in bias and "body_pred(not_higher_pri,2)." in bias and "body_pred(sees,2)." in bias
    assert len(bias) == 2 + 2 * len({name for name, _ in few.atoms})


def test_positive_literals_and_variables_are_a_choice(few: Demonstrations, tmp_path: Path) -> None:
    (folder,) = few.to_popper(tmp_path / "all", max_vars=2)
    (positive,) = few.to_popper(tmp_path / "positive", negated=False)
    both, some = (read_facts(path / "bk.pl") for path in (folder, positive))
    assert some == {name: rows for name, rows in both.items() if not name.startswith("not_")}
    assert (folder / "exs.pl").read_text() == (positive / "exs.pl").read_text()
    declared, fewer = ((path / "bias.pl").read_text().splitlines() for path in (folder, positive))
    assert "max_vars(2)." in declared
    assert set(fewer) == {line for line in declared if "not_" not in line and "max_vars" not in line}
    with pytest.raises(ValueError, match="`max_vars`: expected at least 1, not 0"):
        few.to_popper(tmp_path, max_vars=0)


def test_expert_rules_require_three_actions(tmp_path: Path) -> None:
    written = demonstrations("expert", 4).to_popper(tmp_path, distinct=True)
    assert [folder.name for folder in written] == ["slow", "fast", "stop"]
    counts = {len((folder / "exs.pl").read_text().splitlines()) for folder in written}
    assert len(counts) == 1
    again = demonstrations("expert", 4).to_popper(tmp_path)
    assert again == written and len((again[0] / "exs.pl").read_text().splitlines()) > counts.pop()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["fast", "slow", "stop"]
    names = {path.name for path in (tmp_path / "fast").iterdir()}
    assert names == {"bk.pl", "exs.pl", "bias.pl", ".logicity.json"}
    (tmp_path / "fast" / "notes.txt").write_text("mine")
    (tmp_path / "fast" / "exs.pl").write_text("mine")
    before = (tmp_path / "fast" / "bk.pl").read_text()
    with pytest.raises(FileExistsError, match=r"exs\.pl"):
        demonstrations("expert", 3).to_popper(tmp_path)
    assert (tmp_path / "fast" / "bk.pl").read_text() == before
    demonstrations("expert", 4).to_popper(tmp_path, overwrite=True)
    assert (tmp_path / "fast" / "notes.txt").read_text() == "mine"


def test_state_observations_cannot_be_exported_to_popper(tmp_path: Path) -> None:
    trajectories = demonstrations("easy", 1, observation="state")
    assert trajectories[0].observations.shape[1:] == (20, 15)
    with pytest.raises(ValueError):
        trajectories.to_popper(tmp_path)


@pytest.mark.parametrize("observation", ["groundings", "state"])
def test_a_table_has_every_step(observation: ArrayKind, tmp_path: Path) -> None:
    parquet = needs("pyarrow.parquet", "offline")
    trajectories = demonstrations("easy", 3, "val", observation=observation)
    trajectories.to_parquet(tmp_path / "steps.parquet")
    table = parquet.read_table(tmp_path / "steps.parquet")
    assert table.num_rows == sum(map(len, trajectories))
    observations = np.array(table["observation"].to_pylist(), np.float32)
    assert (observations == np.concatenate([t.observations[:-1].reshape(len(t), -1) for t in trajectories])).all()
    for name, values in [("action", "actions"), ("reward", "rewards"), ("terminated", "terminations")]:
        assert (table[name].to_numpy() == np.concatenate([getattr(t, values) for t in trajectories])).all()
    assert table["step"].to_numpy()[: len(trajectories[0])].tolist() == list(range(len(trajectories[0])))
    assert table.schema.metadata[b"episodes_hash"].decode() == trajectories.episodes_hash
    assert {path.name for path in tmp_path.iterdir()} == {"steps.parquet", ".logicity.json"}
    with pytest.raises(OSError):
        trajectories.to_parquet(tmp_path / "no" / "such.parquet")


@pytest.mark.parametrize("mode", list(ENVIRONMENTS))
def test_minari_restores_data_and_environment(mode: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    minari = needs("minari", "offline")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    trajectories = demonstrations(mode, 2)
    author = {"author": "A", "author_email": "a@example.org", "code_permalink": "https://example.org"}
    trajectories.to_minari(**author)
    dataset = minari.load_dataset(f"logicity/spf-{mode}/oracle-v0")
    assert dataset.total_episodes == 2 and dataset.total_steps == sum(map(len, trajectories))
    env = dataset.recover_environment()
    assert env.spec.id == ENVIRONMENTS[mode]
    for episode, trajectory in zip(dataset.iterate_episodes(), trajectories, strict=True):
        assert (episode.observations == trajectory.observations).all()
        assert (episode.actions == trajectory.actions).all() and (episode.rewards == trajectory.rewards).all()
        assert (episode.infos["progress"] == trajectory.infos["progress"]).all()
        observation, _ = env.reset(options={"episode": trajectory.episode})
        assert (observation == episode.observations[0]).all()
    with pytest.raises(ValueError):
        trajectories.to_minari(**author)


def test_minari_stores_a_configuration_file(own_city: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    minari = needs("minari", "offline")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    trajectories = demonstrations(own_city, split="val")
    trajectories.to_minari(author="A", author_email="a@example.org", code_permalink="https://example.org")
    dataset = minari.load_dataset("logicity/spf-own/oracle-v0")
    assert dataset.total_episodes == 5
    for env in (dataset.recover_environment(), dataset.recover_environment(eval_env=True)):
        observation, _ = env.reset(options={"episode": 4})
        assert (observation == trajectories[4].observations[0]).all()


def test_trajectories_compare_by_identity() -> None:
    data = logicity.demonstrations("easy", n=2)
    assert data[1] in data
    assert data.index(data[1]) == 1
    assert len({data[0], data[1]}) == 2
