from __future__ import annotations

import hashlib
import json
import shutil
import subprocess
import sys
from dataclasses import replace
from itertools import islice
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from conftest import ROOT, needs, picture

from logicity import _logicity
from logicity.__main__ import main
from logicity.release import DataSetOptions, Release, ResultsFile, pack_policies, release
from logicity.release.datasets import SPLITS, _episode_rows, data_sets
from logicity.release.write import write_documents

needs("pyarrow", "release")
needs("gymnasium", "release")

SMALL = DataSetOptions(
    modes=("easy",),
    episodes=4,
    questions=12,
    worlds=1,
    vap_modes=("easy",),
    agents=("random",),
    difficulties=(50,),
    pictures=False,
)
NAMES = ("spf-episodes", "spf-demonstrations", "questions", "vap-easy-random-50")

#: Libraries of mlcroissant warn about what they use of each other.
THIRD_PARTY = pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::FutureWarning")


@pytest.fixture(scope="module")
def released(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("release") / "release"
    lines: list[str] = []
    done = release(folder, SMALL, date="2026-12-01", url="https://example.org/logicity", progress=lines.append)
    assert done == Release(NAMES, (), (), {})
    assert lines[:2] == ["spf-episodes: begins", "spf-episodes: [1/6] episodes/easy-train.jsonl"]
    return folder


def front_matter(path: Path) -> dict[str, Any]:
    yaml = pytest.importorskip("yaml")
    _, matter, text = path.read_text().split("---\n", 2)
    assert text.startswith("\n# ")
    return dict(yaml.safe_load(matter))


@pytest.mark.parametrize("name", NAMES)
def test_a_data_set_has_its_documents(name: str, released: Path) -> None:
    folder = released / name
    assert {"README.md", "DATASHEET.md", "LICENSE", "SHA256SUMS", "croissant.json", "release.json"} <= {
        path.name for path in folder.iterdir()
    }
    assert (folder / "LICENSE").read_bytes() == (ROOT / "LICENSE").read_bytes()
    lines = [line.split("  ") for line in (folder / "SHA256SUMS").read_text().splitlines()]
    listed = {path: sha256 for sha256, path in lines}
    paths = {path.relative_to(folder).as_posix(): path for path in folder.rglob("*") if path.is_file()}
    assert listed.keys() == paths.keys() - {"SHA256SUMS"}
    assert all(
        hashlib.sha256(path.read_bytes()).hexdigest() == listed.get(key, "")
        for key, path in paths.items()
        if key != "SHA256SUMS"
    )
    matter = front_matter(folder / "README.md")
    assert matter["license"] == "mit" and "logicity" in matter["tags"]
    for config in matter["configs"]:
        for each in config["data_files"]:
            assert list(folder.glob(each["path"])), each
    sheet = (folder / "DATASHEET.md").read_text()
    assert "## Motivation" in sheet and "- **Whether it is synthetic**: yes" in sheet


@THIRD_PARTY
@pytest.mark.parametrize("name", NAMES)
def test_croissant_is_valid_and_loads_ten_records(name: str, released: Path) -> None:
    mlcroissant = needs("mlcroissant", "croissant")
    path = released / name / "croissant.json"
    dataset = mlcroissant.Dataset(jsonld=str(path))
    assert not dataset.metadata.ctx.issues.errors and not dataset.metadata.ctx.issues.warnings
    document = json.loads(path.read_text())
    assert document["conformsTo"] == ["http://mlcommons.org/croissant/1.1", "http://mlcommons.org/croissant/RAI/1.0"]
    assert document["rai:hasSyntheticData"] is True and document["rai:personalSensitiveInformation"]
    assert dataset.metadata.data_biases and dataset.metadata.data_limitations
    assert document["url"] == "https://example.org/logicity" and document["datePublished"] == "2026-12-01"
    for file in document["distribution"]:
        if "sha256" in file:
            content = (released / name / file["contentUrl"]).read_bytes()
            assert (hashlib.sha256(content).hexdigest(), f"{len(content)} B") == (file["sha256"], file["contentSize"])
    count = 4 if name == "spf-episodes" else 10
    for records in document["recordSet"]:
        found = list(islice(dataset.records(records["@id"]), 10))
        assert len(found) == count
        assert all(set(each) == {field["@id"] for field in records["field"]} for each in found)


@THIRD_PARTY
def test_the_records_are_those_of_the_files(released: Path) -> None:
    mlcroissant = needs("mlcroissant", "croissant")
    folder = released / "spf-episodes"
    recorded = [json.loads(line) for line in (folder / "episodes/easy-test.jsonl").read_text().splitlines()]
    records = list(mlcroissant.Dataset(jsonld=str(folder / "croissant.json")).records("easy-test"))
    for record, line in zip(records, recorded[1:], strict=True):
        assert record["easy-test/seed"] == line["seed"]
        rows, columns = record["easy-test/start_rows"], record["easy-test/start_columns"]
        assert [[row, col] for row, col in zip(rows, columns, strict=True)] == [trip[:2] for trip in line["trips"]]
        assert record["easy-test/oracle_return"] == pytest.approx(line["oracle"]["return"])
    entities = mlcroissant.Dataset(jsonld=str(released / "vap-easy-random-50" / "croissant.json"))
    first = next(iter(entities.records("test-entities")))
    assert (first["test-entities/name"], first["test-entities/tick"]) == (b"Car_1", 11)
    assert type(first["test-entities/IsCar"]) is bool and first["test-entities/IsCar"]


@THIRD_PARTY
def test_croissant_loads_pictures(shown: Path, tmp_path: Path) -> None:
    mlcroissant = needs("mlcroissant", "croissant")
    needs("PIL", "icons")
    for split in SPLITS:
        shutil.copytree(shown, tmp_path / split)
    (tmp_path / "release.json").write_text("{}")
    write_documents(tmp_path, data_sets(replace(SMALL, pictures=True))[3], "2026-12-01", None)
    dataset = mlcroissant.Dataset(jsonld=str(tmp_path / "croissant.json"))
    assert not dataset.metadata.ctx.issues.errors and not dataset.metadata.ctx.issues.warnings
    records = list(islice(dataset.records("train-pictures"), 10))
    assert [record["train-pictures/picture"].size for record in records] == [(1024, 1024)] * 10
    assert records[0]["train-pictures/picture"].getpixel((0, 0)) == tuple(map(int, picture(0, 11)[0, 0]))


def test_a_complete_release_is_kept_and_an_interrupted_one_resumed(released: Path, tmp_path: Path) -> None:
    done = release(released, SMALL)
    assert done == Release((), NAMES, (), {})
    copy, only = tmp_path / "copy", ["spf-episodes", "questions"]

    def stop(line: str) -> None:
        if line == "questions: [2/4] data/easy-words.jsonl":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        release(copy, SMALL, only=only, date="2026-12-01", url="https://example.org/logicity", progress=stop)
    assert not (copy / "questions" / "SHA256SUMS").exists()
    lines: list[str] = []
    done = release(copy, SMALL, only=only, url="https://example.org/logicity", progress=lines.append)
    assert done == Release(("questions",), ("spf-episodes",), (), {})
    # The day of the interrupted call, and only the missing files.
    assert [line for line in lines if "/4]" in line] == [
        "questions: [3/4] data/easy-paper.jsonl",
        "questions: [4/4] data/easy-rules.jsonl",
    ]
    for name in only:
        assert (copy / name / "SHA256SUMS").read_text() == (released / name / "SHA256SUMS").read_text()


def test_other_folders_are_not_touched(released: Path, tmp_path: Path) -> None:
    other = DataSetOptions(modes=("easy",), episodes=5)
    with pytest.raises(FileExistsError, match="has another release, with other settings"):
        release(released, other, only=["spf-episodes"])
    (tmp_path / "questions").mkdir()
    (tmp_path / "questions" / "mine.txt").touch()
    with pytest.raises(FileExistsError, match="has files that are not of a release"):
        release(tmp_path, SMALL, only=["questions"])
    with pytest.raises(ValueError, match="unknown data set `episodes`"):
        release(tmp_path, SMALL, only=["episodes"])
    with pytest.raises(ValueError, match="Invalid isoformat"):
        release(tmp_path, SMALL, only=[], date="today")


def test_a_full_release_has_all_data_sets() -> None:
    names = [each.name for each in data_sets()]
    assert names[:3] == list(NAMES[:3])
    assert names[3:] == [
        f"vap-{mode}-{agents}-{difficulty}"
        for mode in ("easy", "hard")
        for agents in ("fixed", "random")
        for difficulty in (0, 50, 100)
    ]
    # The command on a card makes the data set.
    (episodes, *_) = data_sets(SMALL)
    assert episodes.command == "logicity release DIR --only spf-episodes --modes easy --episodes 4"
    assert data_sets(SMALL)[3].command == ("logicity release DIR --only vap-easy-random-50 --worlds 1 --no-pictures")
    other = data_sets(replace(SMALL, difficulties=(7,)))[3]
    assert other.command == "logicity release DIR --only vap-easy-random-7 --worlds 1 --difficulties 7 --no-pictures"


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"modes": ("simple",)}, "unknown mode `simple`"),
        ({"agents": ("all",)}, "unknown set of agents `all`; known: fixed, random"),
        ({"vap_modes": ("expert",)}, "unknown mode of pictures `expert`"),
        ({"difficulties": (101,)}, "difficulties: expected 0 to 100, not 101"),
        ({"episodes": 0}, "episodes: expected 1 to 100000, not 0"),
    ],
)
def test_faulty_options_are_refused(values: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        DataSetOptions(**values)


def test_the_command(tmp_path: Path, released: Path, capfd: pytest.CaptureFixture[str]) -> None:
    options = ["--only", "spf-episodes", "--modes", "easy", "--episodes", "4", "--date", "2026-12-01"]
    options += ["--url", "https://example.org/logicity"]
    assert main(["release", str(tmp_path / "out"), *options]) == 0
    assert capfd.readouterr().out == f"data sets written: 1, complete already: 0, in {tmp_path / 'out'}\n"
    sums = [folder / "spf-episodes" / "SHA256SUMS" for folder in (tmp_path / "out", released)]
    assert sums[0].read_text() == sums[1].read_text()
    assert main(["release", str(tmp_path / "out"), *options, "--seed", "1"]) == 2
    assert "has another release, with other settings" in capfd.readouterr().err
    for words, message in [
        (["--only", "x"], "unknown data set `x`"),
        (["--only", "policies"], "name the published results with `--results`"),
        (["--difficulties", "101"], "expected an integer from 0 to 100"),
        (["--agents", "all"], "expected fixed or random, found `all`"),
        (["--date", "now"], "expected a day such as 2026-12-01"),
        (["--results", "none.json"], "no such file"),
    ]:
        try:
            code = main(["release", str(tmp_path / "out"), *words])
        except SystemExit as error:
            code = error.code  # type: ignore[assignment]
        assert code == 2 and message in capfd.readouterr().err


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """The folder of an experiment with a learner of rules and a small network, and results with both."""
    needs("stable_baselines3", "learn")
    from test_learn_cloning import LEARNERS, config, nothing
    from test_learn_cloning import SMALL as NETWORKS

    from logicity.experiments.cells import prepare
    from logicity.experiments.experiment import Selection
    from logicity.experiments.registry import load_experiment
    from logicity.learn.storage import policy_hash

    folder = tmp_path_factory.mktemp("policies")
    runs = folder / "runs" / "spf"
    words = ["experiment", "spf", "--only", "induce,easy", "--seeds", "0", "--run", str(runs)]
    subprocess.run([sys.executable, "-m", "logicity", *words], check=True, cwd=folder, capture_output=True)
    # A network of another size than the published one, as if its run had made it.
    (cell,) = load_experiment("spf").cells(Selection((("mlp", "easy"),), (0,)))
    run = prepare(cell, runs)
    learner = LEARNERS["mlp"](config("mlp", NETWORKS["mlp"]))
    learner.fit(3, nothing)
    learner.policy().save(run / "best.pt")
    (run / "config.json").write_text(json.dumps({"mode": "easy", "observation": "groundings"}))
    (run / "measured.json").write_text(json.dumps({"identity": cell.identity}))
    results = json.loads((ROOT / "results" / "spf.json").read_text())
    wanted = [row for row in results["rows"] if (row["learner"], row["mode"], row["seed"]) == ("mlp", "easy", 0)]
    for row in wanted:
        row["sha256_of"], row["sha256"] = policy_hash(learner.policy())
    (folder / "spf.json").write_text(json.dumps(results))
    return SimpleNamespace(folder=folder, runs=runs, results=folder / "spf.json", policy=learner.policy())


def test_policies_of_published_rows_are_packed(trained: Any, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    needs("safetensors", "learn")
    from logicity.learn import load_policy
    from logicity.learn.storage import policy_hash

    out = tmp_path / "policies"
    packed, left_out = pack_policies(out, [ResultsFile(trained.results, trained.runs)], lambda line: None)
    assert sorted(packed) == ["spf-induce-easy-0", "spf-mlp-easy-0"]
    assert set(left_out.values()) == {f"not trained in {trained.runs}"}
    loaded = load_policy(out / "spf-mlp-easy-0")
    assert (loaded.algorithm, loaded.mode, loaded.path.suffix) == ("mlp", "easy", ".safetensors")
    assert policy_hash(loaded.policy) == policy_hash(trained.policy)
    card = (out / "spf-mlp-easy-0" / "README.md").read_text()
    assert "logicity experiment spf --only mlp,easy --seeds 0" in card
    assert policy_hash(trained.policy)[1] in card
    matter = front_matter(out / "spf-induce-easy-0" / "README.md")
    (result, *_) = matter["model-index"][0]["results"]
    assert {"type": "tsr", "value": 1.0} in result["metrics"]
    # All of them, those of one mode, and one.
    capfd.readouterr()
    report = tmp_path / "report.json"
    assert main(["evaluate", "--policy", str(out), "--split", "val", "--json", str(report)]) == 0
    assert [(each["policy"], each["mode"]) for each in json.loads(report.read_text())] == [
        ("spf-induce-easy-0", "easy"),
        ("spf-mlp-easy-0", "easy"),
    ]
    assert main(["evaluate", "--policy", str(out), "--modes", "hard"]) == 2
    assert "has no policy for these modes" in capfd.readouterr().err
    assert main(["evaluate", "--policy", str(out / "spf-mlp-easy-0"), "--split", "val"]) == 0
    # Packing again replaces them.
    again, _ = pack_policies(out, [ResultsFile(trained.results, trained.runs)], lambda line: None)
    assert again == packed
    listed = (out / "SHA256SUMS").read_text()
    for line in listed.splitlines():
        sha256, path = line.split("  ")
        assert hashlib.sha256((out / path).read_bytes()).hexdigest() == sha256


def test_only_the_published_policies_are_packed(trained: Any, tmp_path: Path) -> None:
    published = [ResultsFile(ROOT / "results" / "spf.json", trained.runs)]
    packed, left_out = pack_policies(tmp_path / "out", published, lambda line: None)
    assert packed == ["spf-induce-easy-0"]
    assert "its weights differ from the published ones: " in left_out["spf-mlp-easy-0"]
    with pytest.raises(ValueError, match="only results of Safe Path Following have policies to pack"):
        pack_policies(tmp_path / "out", [ResultsFile(ROOT / "results" / "vap.json", trained.runs)], lambda line: None)
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "mine").touch()
    with pytest.raises(FileExistsError, match="has files that are not packed policies"):
        pack_policies(tmp_path / "other", published, lambda line: None)


def test_policies_that_are_left_out_later_are_removed(trained: Any, tmp_path: Path) -> None:
    def pack(results: Path, runs: Path) -> tuple[dict[str, str], set[str], set[str]]:
        _, left_out = pack_policies(out, [ResultsFile(results, runs)], lambda line: None)
        index = json.loads((out / "policies.json").read_text())["policies"]
        folders = {path.name for path in out.iterdir() if path.is_dir()}
        summed = {line.split("  ")[1].split("/")[0] for line in (out / "SHA256SUMS").read_text().splitlines()}
        assert summed == {*folders, "policies.json"}
        return left_out, {entry["name"] for entry in index}, folders

    out, both = tmp_path / "out", {"spf-induce-easy-0", "spf-mlp-easy-0"}
    assert pack(trained.results, trained.runs)[1:] == (both, both)
    # Their published rows are still those.
    left_out, *found = pack(trained.results, tmp_path / "none")
    assert both < left_out.keys() and found == [both, both]
    (out / "spf-mlp-easy-0" / "mine").touch()
    left_out, *found = pack(ROOT / "results" / "spf.json", trained.runs)
    assert "its weights differ" in left_out["spf-mlp-easy-0"]
    # A file of another program stays.
    assert found == [{"spf-induce-easy-0"}, both]
    assert [path.name for path in (out / "spf-mlp-easy-0").iterdir()] == ["mine"]
    (out / "spf-mlp-easy-0" / "mine").unlink()
    (out / "spf-mlp-easy-0").rmdir()
    pack(trained.results, trained.runs)
    assert pack(ROOT / "results" / "spf.json", tmp_path / "none")[1:] == ({"spf-induce-easy-0"},) * 2


def test_rows_of_episodes_can_have_all_characters() -> None:
    header, *lines = _logicity.read_file("configs/episodes/easy-test.jsonl").splitlines()
    named = json.loads(header)
    named["map"]["name"] = "a\u2028b\u0085c"
    text = "\n".join([json.dumps(named, ensure_ascii=False), *lines]) + "\n"
    rows = list(_episode_rows("easy", text))
    assert len(rows) == len(lines) and rows[0]["map"] == "a\u2028b\u0085c"


def test_a_faulty_index_is_refused(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    def index(*names: str) -> str:
        policies = [{"name": name, "mode": "easy", "file": "policy.pt"} for name in names]
        return json.dumps({"format": 1, "policies": policies})

    for text in (
        "{",
        "[]",
        '{"format": 2, "policies": []}',
        json.dumps({"format": 1, "policies": [{"name": "a", "mode": "easy", "file": "../../etc/passwd"}]}),
        # The traces of a policy are in a folder of its name.
        *map(index, ("../../x", "..", ".", "", "/x", "a/b", "a/", "a\\b", "c:x", "a\0b")),
        index("a", "a"),
    ):
        (tmp_path / "policies.json").write_text(text)
        assert main(["evaluate", "--policy", str(tmp_path)]) == 1
        assert "is not an index of policies" in capfd.readouterr().err


def test_safetensors_hold_tensors_and_plain_data(tmp_path: Path) -> None:
    torch, safetensors = needs("torch", "learn"), needs("safetensors", "learn")
    from logicity.files import read_tensors, write_safetensors

    content = {
        "a": [torch.arange(3), 1, None, True, 0.1],
        "b": ("x", torch.zeros((2, 0), dtype=torch.bool)),
        "c": {1: torch.tensor(2.5), "$x": []},
        "d": {"e": {"f": torch.ones(2, 2).t()}},
    }
    path = tmp_path / "a.safetensors"
    write_safetensors(path, content)
    found = read_tensors(path, "a policy")
    assert repr(found) == repr(content)
    with safetensors.safe_open(path, framework="pt") as file:
        assert set(file.keys()) == {"a.0", "b.1", "c.1", "d.e.f"}
    with pytest.raises(TypeError, match="x: set is neither a tensor nor plain data"):
        write_safetensors(path, {"x": {1}})
    one = torch.zeros(1)
    for same, name in (
        ({1: one, "1": one}, "1"),
        ({"a": {"b": one}, "a.b": one}, "a.b"),
        ({"a": [one], "a.0": one}, "a.0"),
    ):
        with pytest.raises(ValueError, match=f"two tensors have the name `{name}`"):
            write_safetensors(tmp_path / "b.safetensors", same)
        assert not (tmp_path / "b.safetensors").exists()
    for bytes in (b"", b"hello", path.read_bytes()[:-1], path.read_bytes().replace(b"$tensor", b"$tonsor")):
        path.write_bytes(bytes)
        if bytes.find(b"$tonsor") < 0:
            with pytest.raises(ValueError, match="is not a policy: "):
                read_tensors(path, "a policy")
    assert _logicity.__version__
