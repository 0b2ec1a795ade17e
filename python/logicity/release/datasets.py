"""The data sets of a release: episodes, demonstrations, language questions, and worlds with pictures."""

from __future__ import annotations

import json
import re
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from .. import _logicity
from ..errors import checked_integer, did_you_mean, extra
from ..files import write_text
from ..modes import MODES
from ..offline import demonstrations
from ..shards import run_command
from ..tasks import load_task
from ..types import Split
from ..vap.make import Drawing, check_dataset, make_dataset
from .croissant import Column, DataFile, FilePattern, Kind, Records

__all__ = ["DataSet", "DataSetOptions", "data_sets"]

SPLITS: tuple[Split, ...] = ("train", "val", "test")

#: Receives a line of progress.
Say = Callable[[str], object]


@dataclass(frozen=True)
class DataSetOptions:
    """The sizes of the data sets.

    Attributes:
        modes: The modes of Safe Path Following.
        episodes: The number of episodes of each mode and split, drawn with `seed`; `None` for the recorded ones.
        questions: The number of questions of each set.
        worlds: The number of worlds of each split; `None` for 100 in `train` and 20 in others.
        vap_modes: The modes of Visual Action Prediction.
        agents: The sets of agents: `fixed` and `random`.
        difficulties: The difficulties of the pictures, from 0 to 100.
        pictures: Whether to draw pictures.
        seed: The seed of what is drawn.
        threads: The number of threads that draw pictures; 0 means one per core. It does not affect the files.
    """

    modes: tuple[str, ...] = tuple(MODES.values())
    episodes: int | None = None
    questions: int = 1000
    worlds: int | None = None
    vap_modes: tuple[Literal["easy", "hard"], ...] = ("easy", "hard")
    agents: tuple[Literal["fixed", "random"], ...] = ("fixed", "random")
    difficulties: tuple[int, ...] = (0, 50, 100)
    pictures: bool = True
    seed: int = 0
    threads: int = 0

    def __post_init__(self) -> None:
        """Raise `ValueError` for an unknown name or a number that is out of range."""
        for what, given, known in (
            ("mode", self.modes, list(MODES.values())),
            ("mode of pictures", self.vap_modes, ["easy", "hard"]),
            ("set of agents", self.agents, ["fixed", "random"]),
        ):
            if unknown := [name for name in given if name not in known]:
                raise ValueError(f"unknown {what} `{unknown[0]}`{did_you_mean(unknown[0], known)}")
        for name, least, most in (("episodes", 1, 100_000), ("questions", 1, 20_000), ("worlds", 1, 100_000)):
            if (value := getattr(self, name)) is not None:
                checked_integer(name, value, least, most)
        for difficulty in self.difficulties:
            checked_integer("difficulties", difficulty, 0, 100)
        checked_integer("seed", self.seed)


@dataclass(frozen=True)
class DataSet:
    """A data set of a release.

    Attributes:
        name: The name, which is that of its folder.
        title: The title of its card.
        description: A paragraph for the card.
        keywords: Keywords for hubs.
        responsible: Fields of responsible AI that are its own.
        settings: What its files depend on, as JSON.
        command: The options of `logicity release` that make it.
        make: Makes the files that are not there yet. Receives the folder and a function for lines of progress.
        records: Returns what Croissant describes: patterns of files, and records, given the files by path.
        configs: The tables that a hub shows.
        usage: A block of the card that shows how to read the data.
    """

    name: str
    title: str
    description: str
    keywords: tuple[str, ...]
    responsible: Mapping[str, Any]
    settings: Mapping[str, Any]
    command: str
    make: Callable[[Path, Say], None]
    records: Callable[[Path, Mapping[str, DataFile]], tuple[list[FilePattern], list[Records]]]
    configs: Sequence[Mapping[str, Any]]
    usage: str


#: The fields of responsible AI that all data sets share.
_RESPONSIBLE: dict[str, Any] = {
    "dataUseCases": [
        "research on neuro-symbolic learning, planning and perception",
        "comparison with published results",
    ],
    "hasSyntheticData": True,
    "personalSensitiveInformation": "None. Agents and streets are simulated; no person was recorded.",
    "dataCollection": "A simulator draws cities from a seed and evaluates rules in first-order logic on each tick.",
    "dataCollectionType": ["Software Collection"],
    "dataCollectionMissingData": "None.",
    "dataPreprocessingProtocol": "None: the program writes the values of its simulation.",
    "dataAnnotationProtocol": "Labels are derived from the facts by the rules of the city. No person labels anything.",
    "machineAnnotationTools": ["the Datalog engine of logicity"],
    "dataBiases": "Starts, goals and concepts of agents are drawn from the distributions of the configuration, which "
    "are those of the benchmark and not those of real traffic.",
    "dataLimitations": "The rules are simple, agents pass through each other where no rule stops them, and only a few "
    "kinds of streets occur. Results say little about driving on real roads.",
    "dataSocialImpact": "Policies trained on the data must not control vehicles. Rules such as a right of way by "
    "priority are for study only.",
    "dataReleaseMaintenancePlan": "A new version of the program makes the data sets again. The version and the hashes "
    "of configurations and rules, in `release.json` or in the data, tell releases apart.",
}


def data_sets(options: DataSetOptions | None = None) -> list[DataSet]:
    """Return the data sets of a release."""
    options = options or DataSetOptions()
    return [_episodes(options), _demonstrations(options), _questions(options), *_pictures(options)]


def _options(options: DataSetOptions, names: Sequence[str]) -> str:
    """Return the options of the command that are not the default ones."""
    default, words = DataSetOptions(), []
    flags = {"vap_modes": "--vap-modes", "pictures": "--no-pictures"}
    for name in names:
        value = getattr(options, name)
        if value == getattr(default, name):
            continue
        flag = flags.get(name, f"--{name}")
        words.append(
            flag
            if isinstance(value, bool)
            else f"{flag} {','.join(map(str, value))}"
            if isinstance(value, tuple)
            else f"{flag} {value}"
        )
    return " ".join(words)


def _command(name: str, options: DataSetOptions, names: Sequence[str]) -> str:
    return " ".join(filter(None, [f"logicity release DIR --only {name}", _options(options, names)]))


def _episode_file(options: DataSetOptions, mode: str, split: Split) -> str | None:
    """Return the text of the recorded episodes, or `None` if they are drawn."""
    return _logicity.read_file(f"<builtin>/configs/episodes/{mode}-{split}.jsonl") if options.episodes is None else None


def _drawn_episodes(options: DataSetOptions, mode: str, split: Split) -> str:
    """Return the text of a file of drawn episodes."""
    words = ["episodes", "make", mode, "--split", split, "--count", str(options.episodes)]
    return run_command([*words, "--seed", str(options.seed), "--output", "-"])


def _parts(folder: Path, names: Sequence[str], say: Say, make: Callable[[str, Path], None]) -> None:
    """Make the files that a folder lacks. Files get their names only when they are complete."""
    for done, name in enumerate(names):
        path = folder / name
        if not path.exists():
            path.parent.mkdir(parents=True, exist_ok=True)
            make(name, path)
            say(f"{folder.name}: [{done + 1}/{len(names)}] {name}")


def _episodes(options: DataSetOptions) -> DataSet:
    names = {f"{mode}-{split}": (mode, split) for mode in options.modes for split in SPLITS}

    def make_one(name: str, path: Path) -> None:
        folder, stem = path.parent.parent, path.stem
        mode, split = names[stem]
        recorded = _episode_file(options, mode, split)
        file = folder / "episodes" / f"{stem}.jsonl"
        if path.parent.name == "episodes":
            if recorded is not None:
                write_text(path, recorded)
                return
            write_text(path, _drawn_episodes(options, mode, split))
        else:
            rows = _episode_rows(mode, file.read_text(encoding="utf-8"))
            write_text(path, "".join(json.dumps(row) + "\n" for row in rows))

    def make(folder: Path, say: Say) -> None:
        paths = [f"{kind}/{name}.jsonl" for kind in ("episodes", "table") for name in names]
        _parts(folder, paths, say, make_one)

    def records(folder: Path, files: Mapping[str, DataFile]) -> tuple[list[FilePattern], list[Records]]:
        text = "The episodes of {} mode, {} split: what the agents are, where they start and go, and the oracle's run."
        return [], [
            Records(name, text.format(mode, split), files[f"table/{name}.jsonl"], _EPISODE_COLUMNS)
            for name, (mode, split) in names.items()
        ]

    return DataSet(
        name="spf-episodes",
        title="LogiCity: episodes of Safe Path Following",
        description=(
            "A car drives to a goal in a city that first-order rules govern, and must break no rule. An episode fixes "
            "the start, goal, concepts and priority of every agent. Each is solvable: the oracle, which does what the "
            "rules require, reaches the goal. `episodes` has the files that logicity reads, and `table` the same as "
            "one JSON object per episode."
        ),
        keywords=("planning", "reinforcement-learning"),
        responsible=_RESPONSIBLE,
        settings={"episodes": options.episodes, "seed": _seed(options), "hashes": _hashes(options)},
        command=_command("spf-episodes", options, ("modes", "episodes", "seed")),
        make=make,
        records=records,
        configs=_configs({mode: {split: f"table/{mode}-{split}.jsonl" for split in SPLITS} for mode in options.modes}),
        usage="A configuration names the files under `task: {episodes: {test: FILE}}`; `logicity evaluate --modes "
        "CONFIGURATION` measures policies on them.",
    )


def _hashes(options: DataSetOptions) -> dict[str, dict[str, str]]:
    """Return the hashes of the configuration and of the rules of each mode."""
    described = {mode: _logicity.describe(load_task(mode)) for mode in options.modes}
    return {mode: {key: each[f"{key}_hash"] for key in ("config", "rules")} for mode, each in described.items()}


def _seed(options: DataSetOptions) -> int | None:
    """Return the seed of drawn episodes; recorded ones have none."""
    return None if options.episodes is None else options.seed


def _configs(files: Mapping[str, Mapping[str, str]]) -> list[dict[str, Any]]:
    """Return the tables for hubs: files by split and table."""
    hub = {"val": "validation"}
    return [
        {
            "config_name": name,
            "data_files": [{"split": hub.get(split, split), "path": path} for split, path in splits.items()],
        }
        for name, splits in files.items()
    ]


_EPISODE_COLUMNS = (
    Column("mode", "Text", "the mode: the rules and the agents"),
    Column("split", "Text", "the split"),
    Column("episode", "Integer", "the number of the episode in its file, from 0"),
    Column("seed", "Integer", "the seed of the random events during the episode"),
    Column("map", "Text", "the name of the map"),
    Column("agents", "Text", "the names of the agents; the first is the ego", 0),
    Column("concepts", "Text", "the concepts of each agent, joined by `+`", 0),
    Column("priorities", "Integer", "the priority of each agent; smaller numbers go first", 0),
    Column("start_rows", "Integer", "the row of the cell where each agent starts", 0),
    Column("start_columns", "Integer", "its column", 0),
    Column("goal_rows", "Integer", "the row of the goal of each agent", 0),
    Column("goal_columns", "Integer", "its column", 0),
    Column("oracle_steps", "Integer", "the number of steps of the oracle"),
    Column("oracle_return", "Float", "the sum of its rewards"),
    Column("constrained_steps", "Integer", "the number of its steps in which the rules derived an action"),
)


def _episode_rows(mode: str, text: str) -> Iterator[dict[str, Any]]:
    """Yield the rows of the table of a file of episodes."""
    # Other line breaks can occur in strings.
    header, *lines = map(json.loads, text.removesuffix("\n").split("\n"))
    for number, line in enumerate(lines):
        agents = [{**agent, **line["changes"].get(agent["id"], {})} for agent in header["agents"]]
        starts_and_goals = zip(*line["trips"], strict=True)
        yield {
            "mode": mode,
            "split": header["split"],
            "episode": number,
            "seed": line["seed"],
            "map": header["map"]["name"],
            "agents": [agent["id"] for agent in agents],
            "concepts": ["+".join(agent["concepts"]) for agent in agents],
            "priorities": [agent["priority"] for agent in agents],
            **dict(
                zip(
                    ("start_rows", "start_columns", "goal_rows", "goal_columns"),
                    map(list, starts_and_goals),
                    strict=True,
                )
            ),
            "oracle_steps": line["oracle"]["steps"],
            "oracle_return": line["oracle"]["return"],
            "constrained_steps": sum(line["oracle"]["constrained"].values()),
        }


def _demonstrations(options: DataSetOptions) -> DataSet:
    names = {f"{mode}-{split}": (mode, split) for mode in options.modes for split in SPLITS}

    def make_one(name: str, path: Path) -> None:
        mode, split = names[path.stem]
        with tempfile.TemporaryDirectory() as drawn, extra("release"):
            overrides = None
            if options.episodes is not None:
                file = Path(drawn) / "episodes.jsonl"
                file.write_text(_drawn_episodes(options, mode, split), encoding="utf-8")
                overrides = {"task": {"episodes": {split: str(file)}}}
            demonstrations(mode, split=split, overrides=overrides).to_parquet(path)
        # Releases have no records of the commands that wrote files.
        (path.parent / ".logicity.json").unlink(missing_ok=True)

    def make(folder: Path, say: Say) -> None:
        _parts(folder, [f"data/{name}.parquet" for name in names], say, make_one)

    def records(folder: Path, files: Mapping[str, DataFile]) -> tuple[list[FilePattern], list[Records]]:
        text = (
            "The steps of the oracle in {} mode, {} split: one row per step. The metadata of the table names the atom "
        )
        text += "of each number of an observation."
        return [], [
            Records(name, text.format(mode, split), files[path], _columns_of(folder / path, _STEP_MEANINGS))
            for name, (mode, split) in names.items()
            for path in (f"data/{name}.parquet",)
        ]

    return DataSet(
        name="spf-demonstrations",
        title="LogiCity: demonstrations of Safe Path Following",
        description=(
            "The oracle's runs of the recorded episodes, for imitation and offline reinforcement learning: what the "
            "car observes, the action that it takes, and the reward. In an observation, each number is the truth value "
            "of an atom about the car and four other agents in its view."
        ),
        keywords=("imitation-learning", "offline-reinforcement-learning"),
        responsible=_RESPONSIBLE
        | {"dataCollection": "The oracle drives a simulated car: it takes the action that the rules derive."},
        settings={"episodes": options.episodes, "seed": _seed(options), "hashes": _hashes(options)},
        command=_command("spf-demonstrations", options, ("modes", "episodes", "seed")),
        make=make,
        records=records,
        configs=_configs({mode: {split: f"data/{mode}-{split}.parquet" for split in SPLITS} for mode in options.modes}),
        usage='```python\nimport pandas\n\ntable = pandas.read_parquet("data/expert-train.parquet")\n```\n\n'
        "`logicity induce data/expert-train.parquet` learns rules from them.",
    )


_STEP_MEANINGS = {
    "episode": "the number of the episode in the recorded set, from 0",
    "step": "the number of the step, from 0",
    "observation": "the observation before the step",
    "action": "the action: 0 Slow, 1 Normal, 2 Fast, 3 Stop",
    "reward": "the reward of the step",
    "terminated": "whether the step ended the episode at the goal or by a violation",
    "truncated": "whether the step ended the episode at its horizon",
    "oracle_action": "the action that the rules require before the step",
    "progress": "the share of the route behind the car, before the step",
    "success": "whether the car has reached its goal, before the step",
    "steps": "the number of steps before this one",
}


def _columns_of(path: Path, meanings: Mapping[str, str], other: str = "whether the predicate holds") -> list[Column]:
    """Return the columns of a Parquet table. Columns without a meaning get the one of the others."""
    with extra("release"):
        import pyarrow
        import pyarrow.parquet

    columns = []
    for name, type in ((field.name, field.type) for field in pyarrow.parquet.read_schema(path)):
        length = type.list_size if pyarrow.types.is_fixed_size_list(type) else None
        value = type if length is None else type.value_type
        kind: Kind = (
            "Boolean"
            if pyarrow.types.is_boolean(value)
            else "Integer"
            if pyarrow.types.is_integer(value)
            else "Float"
            if pyarrow.types.is_floating(value)
            else "Text"
        )
        columns.append(Column(name, kind, meanings.get(name, other), length))
    return columns


#: The sets of questions: the suffix of the name, and the options.
_QUESTION_SETS = {
    "atoms": ("--style", "atoms"),
    "words": ("--style", "words"),
    "paper": ("--style", "paper"),
    "rules": ("--style", "words", "--prompt", "rules"),
}


def _questions(options: DataSetOptions) -> DataSet:
    names = {
        f"{mode}-{name}": ("questions", f"vap-{mode}", *words, "--seed", str(options.seed))
        for mode in options.vap_modes
        for name, words in _QUESTION_SETS.items()
    }

    def make_one(name: str, path: Path) -> None:
        # In easy mode, the rules never require Fast.
        arguments = [*names[path.stem], "--count", str(options.questions)]
        write_text(path, run_command([*arguments, "--output", "-"]))

    def make(folder: Path, say: Say) -> None:
        _parts(folder, [f"data/{name}.jsonl" for name in names], say, make_one)

    def records(folder: Path, files: Mapping[str, DataFile]) -> tuple[list[FilePattern], list[Records]]:
        return [], [
            Records(
                name, f"The questions of `logicity {' '.join(words)}`.", files[f"data/{name}.jsonl"], _QUESTION_COLUMNS
            )
            for name, words in names.items()
        ]

    return DataSet(
        name="questions",
        title="LogiCity: language questions",
        description=(
            "Multiple-choice questions for language models: given the agents that a car sees and all facts about them, "
            "what does the car do next? Solved examples show the rules, which a reader must infer; the set `rules` "
            "states them. The agents of questions are composed otherwise than those of the examples."
        ),
        keywords=("question-answering", "reasoning", "text"),
        responsible=_RESPONSIBLE
        | {
            "dataUseCases": ["evaluation of reasoning by language models"],
            "dataBiases": "All answers are equally frequent, as far as the rules permit, unlike in simulated traffic.",
        },
        settings={"modes": list(options.vap_modes), "questions": options.questions, "seed": options.seed},
        command=_command("questions", options, ("vap_modes", "questions", "seed")),
        make=make,
        records=records,
        configs=_configs({name: {"test": f"data/{name}.jsonl"} for name in names}),
        usage="`logicity ask --questions data/hard-atoms.jsonl` sends them to a chat endpoint, and `logicity grade` "
        "grades the replies.",
    )


_QUESTION_COLUMNS = (
    Column("id", "Text", "the identifier of the question"),
    Column("prompt", "Text", "what the instructions state: only examples, or the rules"),
    Column("system", "Text", "the instructions"),
    Column("question", "Text", "the facts, the question and the options"),
    Column("answer", "Text", "the letter of the correct option: A Slow, B Normal, C Fast, D Stop"),
    Column("action", "Text", "the action that the rules derive"),
    Column("clauses", "Text", "the labels of the clauses that derive it", 0),
)


def _pictures(options: DataSetOptions) -> Iterator[DataSet]:
    for mode in options.vap_modes:
        for agents in options.agents:
            for difficulty in options.difficulties:
                yield _picture_set(options, mode, agents, difficulty)


def _picture_set(
    options: DataSetOptions, mode: Literal["easy", "hard"], agents: Literal["fixed", "random"], difficulty: int
) -> DataSet:
    name = f"vap-{mode}-{agents}-{difficulty}"
    # Data sets of the default difficulties need no option.
    usual = DataSetOptions().difficulties
    shown = usual if difficulty in usual else (difficulty,)

    def make(folder: Path, say: Say) -> None:
        for split in SPLITS:
            shown = [0]

            def progress(done: int, total: int, split: Split = split, shown: list[int] = shown) -> None:
                # A line for every tenth of the frames.
                if total and done * 10 // total > shown[0]:
                    shown[0] = done * 10 // total
                    say(f"{name}: {split}: {done} of {total} frames")

            make_dataset(
                folder / split,
                mode,
                split,
                agents=agents,
                worlds=options.worlds,
                seed=options.seed,
                images=options.pictures,
                drawing=Drawing(difficulty),
                threads=options.threads,
                progress=progress,
            )
            check_dataset(folder / split, threads=options.threads)

    def records(folder: Path, files: Mapping[str, DataFile]) -> tuple[list[FilePattern], list[Records]]:
        patterns, found = [], []
        for split in SPLITS:
            for kind, what in (
                ("entities", "one row per agent and frame"),
                ("pairs", "one row per ordered pair of agents and frame"),
            ):
                pattern = FilePattern(
                    f"{split}-{kind}-files", f"{split}/world-*/{kind}.parquet", "application/x-parquet"
                )
                first = next((folder / split).glob(f"world-*/{kind}.parquet"))
                columns = _columns_of(first, _meanings(folder / split / "README.md"))
                patterns.append(pattern)
                found.append(Records(f"{split}-{kind}", f"The tables of the {split} split: {what}.", pattern, columns))
            if options.pictures:
                pattern = FilePattern(f"{split}-pictures-files", f"{split}/world-*/frame-*.png", "image/png")
                column = Column("picture", "ImageObject", "a picture of 1024 x 1024 pixels; its name has the tick")
                patterns.append(pattern)
                found.append(Records(f"{split}-pictures", f"The pictures of the {split} split.", pattern, (column,)))
        return patterns, found

    return DataSet(
        name=name,
        title=f"LogiCity: Visual Action Prediction, {mode} mode, {agents} agents, difficulty {difficulty}",
        description=(
            "Pictures of a simulated city, with boxes and concepts of all agents, all true facts about them, and the "
            f"action that the rules derive for each car. The rules are those of {mode} mode; the agents of a world are "
            f"{'those of the configuration' if agents == 'fixed' else 'drawn at random'}. The difficulty, from 0 to "
            f"100, controls how much colors, light, sharpness, markings and clutter vary: here {difficulty}."
        ),
        keywords=("visual-reasoning", "object-detection", "image"),
        responsible=_RESPONSIBLE
        | {"dataUseCases": ["visual action prediction with perception and reasoning", "learning of concepts"]},
        settings={
            "mode": mode,
            "agents": agents,
            "difficulty": difficulty,
            "worlds": options.worlds,
            "seed": options.seed,
            "pictures": options.pictures,
        },
        command=_command(name, replace(options, difficulties=shown), ("worlds", "difficulties", "seed", "pictures")),
        make=make,
        records=records,
        configs=_configs(
            {kind: {split: f"{split}/world-*/{kind}.parquet" for split in SPLITS} for kind in ("entities", "pairs")}
        ),
        usage="```python\nfrom logicity.vap import VapDataset\n\n"
        f'samples = VapDataset("train", images={options.pictures})\n```\n\n'
        "`logicity vap webdataset` and `logicity vap coco` convert them.",
    )


def _meanings(readme: Path) -> dict[str, str]:
    """Return the meanings of columns that the card of a data set of `vap make` lists."""
    lines = readme.read_text(encoding="utf-8").splitlines()
    found = (re.fullmatch(r"\| `(\w+)` \| (.+) \|", line) for line in lines)
    return {row[1]: row[2] for row in found if row is not None}
