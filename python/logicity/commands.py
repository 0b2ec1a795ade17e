"""`python -m logicity`: policies, questions for language models, data sets of pictures, and tables of environments."""

from __future__ import annotations

import argparse
import json
import os
import sys
from pathlib import Path
from typing import cast

import gymnasium

from . import InputError, __version__
from .describe import describe
from .evaluation import Benchmark, Evaluation, Policy, check_no_traces, table
from .files import write_json
from .modes import ENVIRONMENTS, checked_mode
from .questions import Endpoint, ask_with_progress, grade, load_answers, load_questions
from .vap import baseline_table, measure_baselines, to_coco, to_webdataset

QUESTIONS = "as `logicity questions` writes it; default: questions.jsonl"


def main(arguments: list[str] | None = None) -> int:
    """Run a command and return its exit status: 0, 1 for faulty input, 2 for faulty arguments, 130 if interrupted."""
    parser = _parser()
    given = parser.parse_args(arguments)
    try:
        commands = {
            **{"evaluate": _evaluate, "train": _train, "ask": _ask, "grade": _grade},
            **{"vap": _vap, "describe": _describe},
        }
        return commands[given.command](given)
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 130
    except (InputError, ImportError, OSError, ValueError, gymnasium.error.Error) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m logicity", description="Policies for the city, from Python.")
    parser.add_argument("--version", action="version", version=__version__)
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    measure = _add(commands, "evaluate", "measure a policy on recorded episodes, as the paper does")
    measure.add_argument("--policy", required=True, help="oracle, random, or the .zip of a DQN, PPO or A2C model")
    measure.add_argument(
        "--modes",
        type=_modes,
        default="all",
        help=f"all (default), or any of {','.join(ENVIRONMENTS)}, or configuration files",
    )
    measure.add_argument("--split", choices=("train", "val", "test"), default="test", help="default: test")
    measure.add_argument("--json", type=Path, metavar="FILE", help="write the results, episode by episode")
    measure.add_argument(
        "--traces",
        type=Path,
        metavar="FOLDER",
        help="write the trace of every episode into a folder for each mode, which must have none",
    )

    learn = _add(commands, "train", "train a model, or go on with a run that was killed")
    learn.add_argument("config", type=Path, help="for example configs/baselines/dqn-easy.yaml")
    learn.add_argument("--run", type=Path, metavar="FOLDER", help="of the run; default: runs/CONFIG-SEED")
    learn.add_argument("--seed", type=int, help="instead of the configuration's")

    put = _add(commands, "ask", "put questions of `logicity questions` to a chat endpoint, or go on doing so")
    put.add_argument("--questions", type=Path, default=Path("questions.jsonl"), metavar="FILE", help=QUESTIONS)
    put.add_argument("--url", required=True, help="such as http://localhost:8000/v1")
    put.add_argument("--model", required=True, help="the name that the server knows the model by")
    put.add_argument("-o", "--output", type=Path, required=True, metavar="FILE", help="where replies are added")
    put.add_argument(
        "--key-from",
        metavar="VARIABLE",
        help="the environment variable with the key of the server; none is sent unless given",
    )
    put.add_argument(
        "--settings", type=_object, default={"temperature": 0}, metavar="JSON", help='default: {"temperature": 0}'
    )
    put.add_argument("--timeout", type=float, default=120.0, metavar="SECONDS", help="default: 120")
    put.add_argument("--tries", type=int, default=6, help="how often a failed request is made; default: 6")

    mark = _add(commands, "grade", "compare answers with what the rules want")
    mark.add_argument("answers", type=Path, help='JSON lines {"id": .., "answer": ..}: letters or whole replies')
    mark.add_argument("--questions", type=Path, default=Path("questions.jsonl"), metavar="FILE", help=QUESTIONS)
    mark.add_argument("--json", type=Path, metavar="FILE", help="write the figures")

    _add_vap(commands)
    _add(commands, "describe", "print tables of environments, observations and rewards, as Markdown")
    return parser


def _add_vap(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the commands about data sets of Visual Action Prediction."""
    vap = _add(commands, "vap", "convert data sets of `logicity vap make`, or measure what predictors reach on them")
    kinds = vap.add_subparsers(dest="what", required=True, metavar="COMMAND")

    shards = _add(kinds, "webdataset", "write tar files as the package webdataset reads them")
    shards.add_argument("folder", type=Path, help="the data set")
    shards.add_argument("out", type=Path, help="the folder to make")
    shards.add_argument("--shard-size", type=int, default=1000, help="samples of a file; default: 1000")

    boxes = _add(kinds, "coco", "write boxes as COCO has them")
    boxes.add_argument("folder", type=Path, help="the data set")
    boxes.add_argument("out", type=Path, help="the JSON file to write")
    for kind, told in [
        (shards, "leave pictures out, as has to be if the data set has none"),
        (boxes, "the data set may have none: `file_name`s are written all the same, and `info` tells it"),
    ]:
        kind.add_argument("--no-pictures", action="store_true", help=told)

    simple = _add(kinds, "baselines", "measure the most frequent action, a small network on the facts, and the rules")
    simple.add_argument("--train", type=Path, required=True, metavar="FOLDER", help="the data set to learn on")
    simple.add_argument("--test", type=Path, required=True, metavar="FOLDER", help="the data set to measure on")
    simple.add_argument("--seed", type=int, default=0, help="of the network; default: 0")
    simple.add_argument("--epochs", type=int, default=30, help="of the network; default: 30")
    simple.add_argument("--json", type=Path, metavar="FILE", help="write the figures")


def _add(
    commands: argparse._SubParsersAction[argparse.ArgumentParser], name: str, told: str
) -> argparse.ArgumentParser:
    """Add a command, of which its own help says what the list of commands says."""
    return commands.add_parser(name, help=told, description=f"{told[0].upper()}{told[1:]}.")


def _modes(text: str) -> list[str]:
    modes = list(ENVIRONMENTS) if text == "all" else text.split(",")
    try:
        return [checked_mode(mode) for mode in modes]
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def _named_policy(text: str) -> tuple[Policy, str]:
    """The policy that an argument means, and what to call it."""
    if text in ("oracle", "random"):
        return cast(Policy, text), text
    path = Path(text)
    if not path.is_file():
        if path.suffix == ".zip" or len(path.parts) > 1:
            raise FileNotFoundError(f"`{text}`: no such file")
        raise ValueError(f"unknown policy `{text}`: oracle, random, or a file that Stable-Baselines3 saved")
    from .train import load_model

    return load_model(text), path.stem


def _object(text: str) -> dict[str, object]:
    try:
        value = json.loads(text)
    except json.JSONDecodeError as error:
        raise argparse.ArgumentTypeError(f"not JSON: {error}") from None
    if not isinstance(value, dict):
        raise argparse.ArgumentTypeError("not an object of JSON")
    return value


def _evaluate(given: argparse.Namespace) -> int:
    policy, name = _named_policy(given.policy)
    results: list[Evaluation] = []
    stems = [Path(mode).stem for mode in given.modes]
    if given.traces is not None and len(set(stems)) < len(stems):
        raise ValueError("modes of one name would have their traces in one folder: give one of them at a time")
    folders = [None if given.traces is None else given.traces / stem for stem in stems]
    for folder in folders:
        # Of the last mode, too, it is told at once.
        if folder is not None:
            check_no_traces(folder)
    for mode, folder in zip(given.modes, folders, strict=True):
        results.append(Benchmark(mode, given.split).evaluate(policy, name=name, traces=folder))
    print(table(results))
    if given.json is not None:
        write_json(given.json, [result.to_dict() for result in results])
    return 0


def _train(given: argparse.Namespace) -> int:
    from dataclasses import replace

    from .train import TrainConfig, train

    config = TrainConfig.load(given.config)
    if given.seed is not None:
        config = replace(config, seed=given.seed)
    run = given.run or Path("runs") / f"{given.config.stem}-{config.seed}"
    try:
        result = train(config, run, progress=sys.stderr.isatty())
    except ValueError as error:
        raise ValueError(f"{given.config}: {error}") from error
    tsr = result["test"]["tsr"]
    print(f"{result['steps']} steps in {result['minutes']} minutes; best after {result['best']['steps']}")
    print(f"TSR on test episodes: {tsr['value']:.2f} [{tsr['low']:.2f}, {tsr['high']:.2f}]")
    print(f"all in {run / 'result.json'}")
    return 0


def _ask(given: argparse.Namespace) -> int:
    key = None
    if given.key_from is not None:
        key = os.environ.get(given.key_from, "").strip()
        if not key:
            raise ValueError(f"the environment variable `{given.key_from}` is not set")
    questions = load_questions(given.questions)
    endpoint = Endpoint(given.url, given.model, key, given.settings, given.timeout, given.tries)
    print(grade(questions, ask_with_progress(questions, endpoint, given.output)))
    return 0


def _grade(given: argparse.Namespace) -> int:
    graded = grade(load_questions(given.questions), load_answers(given.answers))
    print(graded)
    for what, names in [
        ("counted as wrong, without an answer", graded.missing),
        ("counted as wrong, with an answer that chooses no option", graded.unread),
        ("left out, answers to no question", graded.unknown),
    ]:
        if names:
            print(f"{what}: {len(names)}: {', '.join(names[:5])}{', ...' * (len(names) > 5)}", file=sys.stderr)
    if given.json is not None:
        write_json(given.json, graded.to_dict())
    return 0


def _vap(given: argparse.Namespace) -> int:
    match given.what:
        case "webdataset":
            shards = to_webdataset(given.folder, given.out, given.shard_size, images=not given.no_pictures)
            print(f"{len(shards)} files in {given.out}")
        case "coco":
            to_coco(given.folder, given.out, images=not given.no_pictures)
        case "baselines":
            return _baselines(given)
    return 0


def _baselines(given: argparse.Namespace) -> int:
    results = measure_baselines(given.train, given.test, given.seed, given.epochs)
    print(baseline_table(results))
    if given.json is not None:
        write_json(given.json, [result.to_dict() for result in results])
    by_rules = next(result for result in results if result.name == "rules")
    if set(by_rules.metrics.recall.values()) != {1.0}:
        print(f"error: the labels of {given.test} are not what the rules derive from its facts", file=sys.stderr)
        return 1
    return 0


def _describe(given: argparse.Namespace) -> int:
    print(describe(), end="")
    return 0


if __name__ == "__main__":
    sys.exit(main())
