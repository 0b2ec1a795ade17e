"""Rules learned from demonstrations and questions."""

import json
import pickle
import subprocess
import sys
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from conftest import needs

import logicity

pytest.importorskip("gymnasium")


@pytest.fixture(scope="module")
def demonstrations() -> logicity.Demonstrations:
    return logicity.demonstrations("hard")


def test_rules_from_demonstrations_solve_the_test_episodes(
    demonstrations: logicity.Demonstrations, tmp_path: Path
) -> None:
    rules = logicity.induce(demonstrations)
    assert len(rules.clauses) == 7
    assert {clause.action for clause in rules.clauses} == {"Stop"}
    assert "Stop(X) :- IsAmbulance(X), IsOld(Y), RightOf(Y, X)." in map(str, rules.clauses)
    result = logicity.evaluate(rules.policy(), "hard", batched=True)
    assert (result.tsr.value, result.compliance.value) == (1.0, 1.0)
    # With the saved rules, the city is another one: they also govern pedestrians.
    path = tmp_path / "learned.dl"
    rules.save(path)
    assert path.read_text() == rules.text
    oracle = logicity.evaluate("oracle", "hard", rules=path)
    assert oracle.compliance.value == 1.0
    assert "Stop" in rules.program().predicates


def test_rules_choose_the_action_of_every_example(demonstrations: logicity.Demonstrations) -> None:
    rules = logicity.induce(demonstrations[:10], "hard", threads=1)
    assert repr(rules).startswith("<InducedRules: ")
    for trajectory in demonstrations[:10]:
        np.testing.assert_array_equal(rules(trajectory.observations[:-1]), trajectory.actions)
    again = logicity.induce(demonstrations[:10], "hard", threads=3)
    assert again.text == rules.text


def test_copies_decide_alike(demonstrations: logicity.Demonstrations) -> None:
    rules = logicity.induce(demonstrations, noise="auto")
    restored = pickle.loads(pickle.dumps(rules))
    assert (restored.text, restored.report, restored.clauses) == (rules.text, rules.report, rules.clauses)
    for trajectory in demonstrations:
        np.testing.assert_array_equal(restored(trajectory.observations), rules(trajectory.observations))


def test_wrong_actions_are_tolerated(demonstrations: logicity.Demonstrations) -> None:
    observations = np.concatenate([trajectory.observations[:-1] for trajectory in demonstrations])
    actions = np.concatenate([trajectory.actions for trajectory in demonstrations])
    random = np.random.default_rng(0)
    wrong = random.random(len(actions)) < 0.005
    # 3 is Stop, 1 is Normal: the actions of the hard mode.
    noisy = np.where(wrong, 4 - actions, actions)
    episodes = [SimpleNamespace(observations=observations, actions=noisy)]
    rules = logicity.induce(episodes, "hard", noise=0.005)
    assert np.mean(rules(observations) == actions) > 0.999
    assert rules.report["noise"] == 0.005
    with pytest.raises(ValueError, match=r"0\.5"):
        logicity.induce(episodes, "hard", noise=0.5)
    with pytest.raises(TypeError, match="noise: expected a number"):
        logicity.induce(episodes, "hard", noise=[0.1])  # type: ignore[arg-type]


def test_literals_that_the_examples_leave_open_are_reported(demonstrations: logicity.Demonstrations) -> None:
    rules = logicity.induce(demonstrations)
    # The ego is always a car, so the examples cannot show the condition `Not(IsOld(X))` of the rules. It follows from
    # `IsCar(X)`.
    stop = next(clause for clause in rules.clauses if clause.body[:2] == ("IsAtInter(X)", "IsInInter(Y)"))
    assert stop.undecided[0] == "IsCar(X)" and "Not(IsOld(X))" not in stop.undecided
    # `.disjoint IsAtInter, IsInInter` decides this literal.
    assert "Not(IsInInter(X))" not in stop.undecided
    assert stop.notes[-1].startswith("Never seen without IsCar(X)") and f"// {stop.notes[-1][:40]}" in rules.text
    assert rules.report["wrong"] == 0
    assert rules.report["complete"] is True


def test_constraints_that_the_examples_violate_are_reported(
    demonstrations: logicity.Demonstrations, tmp_path: Path
) -> None:
    path = tmp_path / "false.dl"
    path.write_text('.include "hard.dl"\n.implies IsOld, IsAmbulance\n.disjoint IsPedestrian, IsOld\n')
    plain, rules = (logicity.induce(demonstrations[:30], "hard", rules=file) for file in (None, path))
    assert plain.report["broken_constraints"] == []
    broken = rules.report["broken_constraints"]
    names = [".implies IsOld, IsAmbulance", ".disjoint IsPedestrian, IsOld"]
    assert sorted(each["constraint"] for each in broken) == sorted(names)
    assert all(each["first"].startswith("episode ") for each in broken)
    assert f"the examples violate `{broken[0]['constraint']}` of the rules" in " ".join(rules.text.split("\n// "))
    # Nothing follows from them, so the same literals are undecided.
    assert rules.clauses == plain.clauses and rules.report["unseen"] == plain.report["unseen"]


def test_other_objects_are_episodes() -> None:
    width = len(logicity.observation_names("easy"))
    seen = np.zeros((3, width), np.float32)
    names = logicity.observation_names("easy")
    seen[:, names.index("IsCar(0)")] = 1
    seen[1, names.index("IsAmbulance(0)")] = 1
    rules = logicity.induce([SimpleNamespace(observations=seen, actions=np.array([1, 3, 1]))], "easy")
    assert [str(clause) for clause in rules.clauses] == ["Stop(X) :- IsAmbulance(X)."]
    assert rules(seen).tolist() == [1, 3, 1]


def bodies(rules: logicity.InducedRules) -> list[object]:
    return [(str(clause), clause.examples, clause.alone, clause.undecided) for clause in rules.clauses]


FIXTURE = Path(__file__).parents[2] / "tests/fixtures/easy-steps.parquet"


def test_a_table_of_steps_is_a_source(tmp_path: Path) -> None:
    direct = logicity.induce(logicity.demonstrations("easy", 2))
    recorded = logicity.induce(FIXTURE)
    assert bodies(recorded) == bodies(direct)
    assert "from 2 episodes of easy (train) in easy-steps.parquet." in recorded.text
    assert bodies(logicity.induce(str(FIXTURE), "easy")) == bodies(direct)
    with pytest.raises(ValueError, match=r"IsOld\(0\) instead of IsBus\(0\)"):
        logicity.induce(FIXTURE, "hard")
    with pytest.raises(FileNotFoundError, match=r"none\.parquet"):
        logicity.induce(tmp_path / "none.parquet")
    with pytest.raises(FileNotFoundError, match="neither"):
        logicity.induce(tmp_path)
    (tmp_path / "broken.parquet").write_bytes(FIXTURE.read_bytes()[:-9])
    with pytest.raises(logicity.InputError, match="not a table of steps"):
        logicity.induce(tmp_path / "broken.parquet")


def test_a_written_table_is_a_source(demonstrations: logicity.Demonstrations, tmp_path: Path) -> None:
    needs("pyarrow", "offline")
    demonstrations.to_parquet(tmp_path / "steps.parquet")
    assert bodies(logicity.induce(tmp_path / "steps.parquet")) == bodies(logicity.induce(demonstrations))
    logicity.demonstrations("easy", 1, observation="state").to_parquet(tmp_path / "state.parquet")
    with pytest.raises(logicity.InputError, match="groundings"):
        logicity.induce(tmp_path / "state.parquet")


def test_a_minari_dataset_is_a_source(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    minari = needs("minari", "offline")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    author = {"author": "A", "author_email": "a@example.org", "code_permalink": "https://example.org"}
    demonstrations = logicity.demonstrations("easy", 3)
    dataset = demonstrations.to_minari(**author)
    expected = bodies(logicity.induce(demonstrations))
    name = "logicity/spf-easy/oracle-v0"
    for source in (dataset, name, tmp_path / name, tmp_path / name / "data"):
        rules = logicity.induce(source)
        assert bodies(rules) == expected
        assert f"from 3 episodes of {name}." in rules.text
    assert bodies(logicity.induce(list(minari.load_dataset(name)), "easy")) == expected
    logicity.demonstrations("easy", 1, observation="state").to_minari("logicity/state-v0", **author)
    with pytest.raises(ValueError, match="groundings"):
        logicity.induce("logicity/state-v0")
    with pytest.raises(FileNotFoundError, match="none-v0"):
        logicity.induce("logicity/none-v0")


def test_faults_of_a_minari_dataset_name_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    needs("minari", "offline")
    h5py = needs("h5py", "offline")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    author = {"author": "A", "author_email": "a@example.org", "code_permalink": "https://example.org"}
    logicity.demonstrations("easy", 2).to_minari("logicity/steps-v0", **author)
    folder = tmp_path / "logicity" / "steps-v0" / "data"
    metadata, content = (folder / name for name in ("metadata.json", "main_data.hdf5"))
    text, data = metadata.read_text(), content.read_bytes()
    spec = json.loads(json.loads(text)["env_spec"])

    def described(**keys: Any) -> None:
        metadata.write_text(json.dumps({**json.loads(text), **keys}))

    canary = tmp_path / "canary"

    def without_spaces() -> None:
        """Let Minari make an environment by a function of Python that the file names."""
        described(
            env_spec=json.dumps({**spec, "entry_point": "os:mkdir", "kwargs": {"path": str(canary)}}),
            observation_space=None,
        )
        kept = {key: value for key, value in json.loads(metadata.read_text()).items() if value is not None}
        metadata.write_text(json.dumps(kept))

    def linked(link: object) -> None:
        with h5py.File(content, "r+") as file:
            del file["episode_0/observations"]
            file["words"] = ["a", "b"]
            file["episode_0/observations"] = file[link] if isinstance(link, str) else link

    def external() -> None:
        with h5py.File(content, "r+") as file:
            del file["episode_0/observations"]
            place = [("/dev/zero", 0, 85 * 4 * 9)]
            file["episode_0"].create_dataset("observations", shape=(9, 85), dtype="f4", external=place)

    def unallocated() -> None:
        """Claim 32 GiB, of which the file has nothing."""
        with h5py.File(content, "r+") as file:
            del file["episode_0/observations"]
            file["episode_0"].create_dataset("observations", shape=(10**8, 85), dtype="f4", chunks=(1000, 85))

    faults: list[tuple[Callable[[], object], str]] = [
        (lambda: metadata.write_text("{"), "Expecting property name"),
        (lambda: metadata.write_text("[" * 10**6), "recursion"),
        (lambda: described(data_format="none"), "none"),
        (lambda: described(total_episodes=10**12), "it claims 1000000000000 episodes, and has 2"),
        (lambda: described(env_spec=json.dumps({**spec, "kwargs": [1]})), "no mapping of arguments"),
        (lambda: content.write_bytes(data[:1000]), "truncated"),
        (without_spaces, "lacks `observation_space`"),
        (lambda: linked(h5py.ExternalLink("other.hdf5", "/x")), "`episode_0/observations` is a link"),
        (lambda: linked(h5py.SoftLink("/episode_1/observations")), "`episode_0/observations` is a link"),
        (lambda: linked("/"), "`episode_0/observations` has no numbers"),
        (lambda: linked("words"), "`episode_0/observations` has no numbers"),
        (external, "`episode_0/observations` has its values in another file"),
        (unallocated, "its values take more than 2048 MiB"),
    ]
    for damage, message in faults:
        damage()
        with pytest.raises(ValueError, match=f"cannot read the Minari dataset `.*steps-v0.*`: .*{message}"):
            logicity.induce(folder)
        metadata.write_text(text)
        content.write_bytes(data)
    assert len(logicity.induce(folder).clauses) > 0
    assert not canary.exists()
    # What is not needed is not read: a thousand references to one text of 4 MB.
    with h5py.File(content, "r+") as file:
        texts = file.require_group("episode_0/infos").create_dataset("text", (1000,), h5py.string_dtype())
        texts[0] = "a" * 4_000_000
        reference = file["episode_0/infos/text"].id.get_offset()
    data = content.read_bytes()
    content.write_bytes(data[:reference] + data[reference : reference + 16] * 1000 + data[reference + 16_000 :])
    with h5py.File(content) as file:
        assert len(file["episode_0/infos/text"][999]) == 4_000_000
    tracemalloc.start()
    assert len(logicity.induce(folder).clauses) > 0
    assert tracemalloc.get_traced_memory()[1] < 100_000_000
    tracemalloc.stop()


@pytest.mark.parametrize("kind", ["arrow", "parquet"])
def test_tables_of_a_minari_dataset_are_bounded(kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    needs("minari", "offline")
    needs("PIL", "icons")
    pyarrow = needs("pyarrow", "offline")
    tables = needs("pyarrow.parquet", "offline")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    author = {"author": "A", "author_email": "a@example.org", "code_permalink": "https://example.org"}
    demonstrations = logicity.demonstrations("easy", 2)
    demonstrations.to_minari("logicity/tables-v0", data_format=kind, **author)
    folder = tmp_path / "logicity" / "tables-v0" / "data"
    assert bodies(logicity.induce(folder)) == bodies(logicity.induce(demonstrations))
    (file,) = (folder / "0").glob(f"*.{kind}")

    def write(table: Any, **options: Any) -> None:
        if kind == "parquet":
            tables.write_table(table, file, **options)
            return
        with pyarrow.ipc.new_file(file, table.schema, options=pyarrow.ipc.IpcWriteOptions(**options)) as writer:
            writer.write_table(table)

    good = tables.read_table(file) if kind == "parquet" else pyarrow.ipc.open_file(file).read_all()

    def replaced(name: str, column: Any) -> Any:
        return good.set_column(good.column_names.index(name), name, column)

    rows = len(good)
    empty = pyarrow.Array.from_buffers(pyarrow.null(), rows, [None])
    words = pyarrow.array(["a"] * rows)
    faults: list[tuple[Any, dict[str, Any], str]] = [
        (replaced("observations", empty), {}, "observations of episode 0 have the type null, not numbers"),
        (replaced("observations", pyarrow.array([[1.0]] * rows)), {}, "have the type list<.*>, not numbers"),
        (replaced("observations", words), {}, "have the type string, not numbers"),
        (replaced("actions", words), {}, "actions of episode 0 have the type string, not integers"),
        (replaced("actions", pyarrow.array([None] * rows, pyarrow.int64())), {}, "episode 0 lacks values"),
        (good.drop_columns(["actions"]), {}, "actions"),
    ]
    if kind == "arrow":
        faults += [
            (good, {"compression": "zstd"}, f"`{file.name}` is compressed"),
            (replaced("rewards", words.dictionary_encode()), {}, f"`{file.name}` has a dictionary"),
        ]
    for table, options, message in faults:
        write(table, **options)
        with pytest.raises(ValueError, match=f"cannot read the Minari dataset `.*tables-v0.*`: .*{message}"):
            logicity.induce(folder)
    write(replaced("infos" if "infos" in good.column_names else "rewards", words))
    assert bodies(logicity.induce(folder)) == bodies(logicity.induce(demonstrations))
    monkeypatch.setattr(logicity.minari_files, "BYTES_MAX", 1000)
    with pytest.raises(ValueError, match="its values take more than 0 MiB"):
        logicity.induce(folder)
    file.write_bytes(b"none")
    with pytest.raises(ValueError, match="cannot read the Minari dataset"):
        logicity.induce(folder)


def test_the_options_of_the_environment_are_those_of_the_rules() -> None:
    # With fewer entities, an observation has fewer numbers.
    overrides = {"task": {"entities": 3}}
    demonstrations = logicity.demonstrations("easy", 3, overrides=overrides)
    assert bodies(logicity.induce(demonstrations)) == bodies(
        logicity.induce(demonstrations[:], "easy", overrides=overrides)
    )


@pytest.mark.parametrize(
    ("arguments", "options", "error", "message"),
    [
        (([],), {}, TypeError, "mode"),
        (("easy",), {}, ValueError, r'`easy` is a mode, not a dataset: pass `logicity.demonstrations\("easy"\)`'),
        (([], "easy"), {}, ValueError, "no demonstrations"),
        (([3], "easy"), {}, TypeError, "observations"),
        (([SimpleNamespace(observations=np.zeros((2, 85)), actions=[1, 1, 1])], "easy"), {}, ValueError, "shape"),
        (([SimpleNamespace(observations=np.zeros((1, 85)), actions=[1.5])], "easy"), {}, TypeError, "integer"),
        (([SimpleNamespace(observations=np.zeros((1, 85)), actions=[4])], "easy"), {}, ValueError, "actions 0 to 3"),
        (([SimpleNamespace(observations=np.zeros((1, 84)), actions=[1])], "easy"), {}, ValueError, "85 numbers"),
        (([SimpleNamespace(observations=np.zeros((1, 85)), actions=[1])], "esay"), {}, Exception, "esay"),
        (([SimpleNamespace(observations=np.zeros((1, 85)), actions=[1])], "easy"), {"variables": 1}, ValueError, "2"),
        (([SimpleNamespace(observations=np.zeros((1, 85)), actions=[1])], "easy"), {"effort": 0}, ValueError, "1"),
        (([SimpleNamespace(observations=np.zeros((1, 85)), actions=[1])], "easy"), {"seed": "a"}, TypeError, "seed"),
        (
            ([SimpleNamespace(observations=np.zeros((2, 85)), actions=[1, 3])], "easy"),
            {},
            logicity.InputError,
            "same facts",
        ),
    ],
)
def test_bad_arguments(arguments: Any, options: Any, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        logicity.induce(*arguments, **options)


def ambulance(scene: logicity.SymbolicScene) -> str:
    return "Stop" if "IsAmbulance" in scene["facts"] else "Normal"


def test_functions_and_rule_files_are_oracles(tmp_path: Path) -> None:
    asked: list[logicity.SymbolicScene] = []

    def oracle(scene: logicity.SymbolicScene) -> str:
        asked.append(scene)
        answer = logicity.infer(scene, "easy")
        return answer["egos"][scene["ego"]]["action"]

    options: Any = {"agreements": 30, "questions": 500, "sweep": (1, 2)}
    rules = logicity.induce([], "easy", oracle=logicity.Oracle(oracle, **options))
    questions = rules.report["questions"]
    assert (questions["end"], questions["asked"]) == ("certified", len(asked))
    assert questions["certificate"] == {"facts": 1, "entities": 2, "scenes": 57}
    assert "// Certificate: " in rules.text
    assert rules.text.startswith(
        f"// Rules learned by logicity {logicity.__version__} from questions about scenes of easy."
    )
    same = logicity.induce(mode="easy", oracle=logicity.Oracle("rules/easy.dl", **options))
    assert [str(clause) for clause in same.clauses] == [str(clause) for clause in rules.clauses]
    # Before the certificate, lines are wrapped at other places.
    assert same.text.partition("// Certificate")[2] == rules.text.partition("// Certificate")[2]
    assert same.report["questions"] == {**questions, "oracle": "the rules in easy.dl"}
    learned = tmp_path / "learned.dl"
    rules.save(learned)
    command = [sys.executable, "-m", "logicity", "diff", str(learned), "rules/easy.dl"]
    assert "equivalent: proved" in subprocess.run(command, check=True, capture_output=True, text=True).stdout
    restored = pickle.loads(pickle.dumps(rules))
    assert (restored.text, restored.report) == (rules.text, rules.report)


def test_questions_refine_demonstrations() -> None:
    demonstrations = logicity.demonstrations("easy", 3)
    rules = logicity.induce(demonstrations, oracle=logicity.Oracle("rules/easy.dl", agreements=5))
    assert rules.report["examples"] > rules.report["questions"]["asked"]
    assert "from 3 episodes of easy" in rules.text


def test_logs_continue(tmp_path: Path) -> None:
    log = tmp_path / "log.jsonl"
    whole = logicity.induce(mode="easy", oracle=logicity.Oracle(ambulance, agreements=10, log=log))
    lines = log.read_text().splitlines(keepends=True)
    assert len(lines) == 1 + whole.report["questions"]["asked"]
    scenes = [json.loads(line) for line in lines[1:]]
    assert all(scene["actions"] == {"e0": ambulance(scene)} for scene in scenes)
    log.write_text("".join(lines[:9]) + lines[9][:20])
    again = logicity.induce(mode="easy", oracle=logicity.Oracle(ambulance, agreements=10, log=log))
    assert (again.text, again.report) == (whole.text, whole.report)
    assert log.read_text() == "".join(lines)
    with pytest.raises(ValueError, match="other questions: its `oracle` is .*ambulance.* this run .*lambda"):
        logicity.induce(mode="easy", oracle=logicity.Oracle(lambda scene: "Stop", log=log))
    with pytest.raises(ValueError, match="`seed` is 0"):
        logicity.induce(mode="easy", oracle=logicity.Oracle(ambulance, log=log), seed=1)
    foreign = tmp_path / "foreign"
    foreign.write_text("text")
    with pytest.raises(ValueError, match="not a log of questions"):
        logicity.induce(mode="easy", oracle=logicity.Oracle(ambulance, log=foreign))
    assert foreign.read_text() == "text"
    with pytest.raises(OSError, match="not a regular file"):
        logicity.induce(mode="easy", oracle=logicity.Oracle(ambulance, log=tmp_path))
    log.write_text(lines[0] + lines[1].replace("Normal", "Jump").replace("Stop", "Jump"))
    with pytest.raises(logicity.InputError, match="`Jump` is not an action"):
        logicity.induce(mode="easy", oracle=logicity.Oracle(ambulance, log=log))


class Weather(Exception):
    pass


@pytest.mark.parametrize(
    ("answer", "error", "message"),
    [
        (Weather("rain"), Weather, "rain"),
        (KeyboardInterrupt("stopped"), KeyboardInterrupt, "stopped"),
        ("Jump", ValueError, "Jump"),
        (3, TypeError, "not int"),
        (None, TypeError, "not NoneType"),
    ],
)
def test_faults_of_functions_keep_the_rules(answer: Any, error: type[BaseException], message: str) -> None:
    count = 0

    def oracle(scene: logicity.SymbolicScene) -> Any:
        nonlocal count
        count += 1
        if count <= 14:
            return ambulance(scene)
        if isinstance(answer, BaseException):
            raise answer
        return answer

    with pytest.raises(error, match=message) as raised:
        logicity.induce(mode="easy", oracle=logicity.Oracle(oracle))
    assert count == 15
    rules: logicity.InducedRules = raised.value.rules  # type: ignore[attr-defined]
    assert rules.report["questions"]["asked"] == 14
    assert len(rules.clauses) == 1
    assert pickle.loads(pickle.dumps(rules)).text == rules.text


def test_contradictions_of_functions_keep_the_rules() -> None:
    count = 0

    def oracle(scene: logicity.SymbolicScene) -> str:
        nonlocal count
        count += 1
        return ambulance(scene) if count <= 100 else "Fast"

    with pytest.raises(logicity.InputError, match="questions [0-9]+ and 101 are about the same scene") as raised:
        logicity.induce(mode="easy", oracle=logicity.Oracle(oracle))
    assert raised.value.diagnostics[0]["code"] == "contradicting-examples"
    assert raised.value.rules.report["questions"]["end"] == "contradiction"  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("asking", "options", "error", "message"),
    [
        ({"sweep": 3}, {}, TypeError, "sweep: expected the numbers of facts and entities"),
        ({"sweep": (3,)}, {}, TypeError, "sweep: expected the numbers of facts and entities"),
        ({"sweep": (3, 2, 1)}, {}, TypeError, "sweep: expected the numbers of facts and entities"),
        ({}, {"order": "Stop"}, TypeError, "order: expected names of actions, not str"),
        ({}, {"order": [1]}, TypeError, "order: expected names of actions, not int"),
        ({}, {"order": ["Stop", "Stop"]}, ValueError, "order: `Stop` occurs twice"),
        ({}, {"noise": 0.1}, ValueError, "noise"),
        ({"sweep": (1, 9)}, {}, ValueError, "sweep"),
        ({"agreements": -1}, {}, ValueError, "agreements"),
        ({"questions": "many"}, {}, TypeError, "questions"),
        ({"decide": 3}, {}, TypeError, "decide"),
        ({"decide": "missing.dl"}, {}, OSError, "missing.dl"),
        ({}, {"oracle": ambulance}, TypeError, "oracle: expected an Oracle, not function"),
    ],
)
def test_bad_options_of_questions(asking: Any, options: Any, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        logicity.induce(mode="easy", **{"oracle": logicity.Oracle(**{"decide": ambulance, **asking}), **options})


@pytest.mark.parametrize(
    ("source", "error", "message"),
    [
        (None, TypeError, "expected episodes, not NoneType"),
        (5, TypeError, "expected episodes, not int"),
        ([5], TypeError, "expected episodes with `observations` and `actions`, not int"),
        ([], ValueError, "no demonstrations"),
    ],
)
def test_other_sources_are_refused(source: Any, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        logicity.induce(source, "easy")


def test_demonstrations_of_another_mode_are_refused(demonstrations: logicity.Demonstrations) -> None:
    with pytest.raises(
        ValueError, match=r"of hard do not fit easy: they have the atom IsBus\(0\) instead of IsOld\(0\)"
    ):
        logicity.induce(demonstrations, "easy")


def test_the_rule_file_names_the_rules_of_the_configuration(demonstrations: logicity.Demonstrations) -> None:
    rules = logicity.induce(demonstrations[:3], "hard", rules="rules/expert.dl")
    assert "// The configuration has the rules in expert.dl.\n" in rules.text


def test_observations_are_finite(demonstrations: logicity.Demonstrations) -> None:
    episode = demonstrations[0]
    unknown = SimpleNamespace(observations=np.full_like(episode.observations, np.nan), actions=episode.actions)
    with pytest.raises(ValueError, match="episode 0: observations that are not finite"):
        logicity.induce([unknown], "hard")


def test_a_batch_has_two_dimensions(demonstrations: logicity.Demonstrations) -> None:
    rules = logicity.induce(demonstrations[:1], "hard")
    with pytest.raises(ValueError, match="pass `batched=True` to `evaluate`"):
        logicity.evaluate(rules.policy(), "hard", "val")
    with pytest.raises(ValueError, match="batch"):
        rules(demonstrations[0].observations[0])
    with pytest.raises(ValueError, match="numbers"):
        rules(np.zeros((1, 3)))
