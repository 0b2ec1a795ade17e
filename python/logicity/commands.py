"""The commands that Python implements. `logicity.__main__` runs them."""

from __future__ import annotations

import argparse
import errno
import json
import math
import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from datetime import date
from difflib import get_close_matches
from functools import cache, partial, reduce
from pathlib import Path
from typing import Any, NoReturn, cast

import numpy as np

from . import _logicity
from .cluster import check_jobs
from .errors import CommandError, InputError, UntrustedError, extra
from .evaluation import Benchmark, Evaluation, Interval, Policy, Progress, Shape, action_table, model_shape, table
from .figures import ENDINGS, plot_returns
from .files import check_writable, write_json
from .modes import ENVIRONMENTS, checked_mode
from .packed import SHIPPED, packed_policies, shipped_policies
from .signals import ending_on_signals
from .terminal import aligned, flush, neutral, print_message, print_text
from .types import ObservationKind, Split

__all__ = ["SUMMARIES", "parser_of", "run"]

SUMMARIES = {tuple(words): summary for words, summary in _logicity.python_commands()}
"""The summaries of the commands, keyed by their words: `("vap", "coco")` for `logicity vap coco`."""

QUESTIONS = "output of `logicity questions`; default: questions.jsonl"


def run(words: tuple[str, ...], arguments: Sequence[str]) -> int:
    """Run a command, a key of `SUMMARIES`, and return the exit code as `logicity.__main__.main` does.

    Raises:
        SystemExit: If the arguments are invalid or contain `--help`, or on SIGTERM and SIGHUP.
    """
    parser, command = parser_of(words)
    try:
        try:
            args = parser.parse_args(arguments)
        finally:
            # The end of the process would ignore that the help cannot be written.
            flush()
        with ending_on_signals():
            code = command(args)
        flush()
    except KeyboardInterrupt:
        print_message("interrupted")
        return 130
    except BrokenPipeError:
        # The reader has closed the pipe. Python flushes standard output again at exit, which must not fail.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except (_UsageError, ValueError, ImportError, OSError) as error:
        # The message of an `InputError` begins with `error[CODE]`.
        print_message(error if isinstance(error, InputError) else f"error: {_described(error)}")
        if isinstance(error, CommandError):
            return error.code
        return 1 if isinstance(error, ValueError) and not isinstance(error, UntrustedError) else 2
    return code


def _described(error: Exception) -> str:
    """Describe an error of the system without its number, and a missing file with a similar name from its folder."""
    if not isinstance(error, OSError) or error.filename is None:
        return str(error)
    name = os.fsdecode(error.filename)
    if not isinstance(error, FileNotFoundError):
        return f"cannot use `{name}`: {error.strerror.lower()}" if error.strerror else str(error)
    path = Path(name)
    message = f"cannot read `{path}`: no such file"
    beside = [entry.name for entry in path.parent.iterdir()] if path.parent.is_dir() else []
    near = get_close_matches(path.name, sorted(beside), n=1)
    return f"{message}\nhelp: did you mean `{path.parent / near[0]}`?" if near else message


class _UsageError(Exception):
    """The value of an option that does not fit the input."""


class _Parser(argparse.ArgumentParser):
    """A parser whose messages cannot control the terminal: they repeat arguments."""

    add = argparse.ArgumentParser.add_argument

    def error(self, message: str) -> NoReturn:
        super().error(neutral(message))

    def _print_message(self, message: str, file: Any = None) -> None:
        """Print help to standard output, or a message. Unlike the original, raise if the help cannot be written."""
        if message and file is sys.stdout:
            print_text(message, end="")
        else:
            super()._print_message(message, file)


def parser_of(words: tuple[str, ...]) -> tuple[argparse.ArgumentParser, Callable[[argparse.Namespace], int]]:
    """Return the parser of a command, and the function that runs it. The reference of commands reads the parser."""
    parser = _Parser(prog=" ".join(["logicity", *words]), description=f"{SUMMARIES[words]}.")
    add_arguments, command = _COMMANDS[words]
    add_arguments(parser)
    return parser, command


def _add_evaluate(to: _Parser) -> None:
    help = (
        "oracle, random, a name that `logicity policies` lists, the file of a policy (.pt, .safetensors), a rule file "
        "(.dl), the folder of a run of `logicity train`, a folder of policies of `logicity release`, or, with "
        "`--trust`, a model of Stable-Baselines3 (.zip)"
    )
    to.add("--policy", required=True, help=help)
    _add_trust(to, "the policy")
    help = (
        f"all, or any of {','.join(ENVIRONMENTS)}, or configuration files; default: the mode that the run of a "
        "model records, or all"
    )
    to.add("--modes", type=_modes, help=help)
    to.add("--split", type=str.lower, choices=("train", "val", "test"), default="test", help="default: test")
    help = "the kind of observation; default: that of the model, or groundings"
    to.add("--observation", choices=("groundings", "state"), help=help)
    _add_json(to, "write the results, with one record per episode")
    help = (
        "also print, for each action, the share of steps in which the policy chose it and in which the rules "
        "required it, and its DSR"
    )
    to.add("--by-action", action="store_true", help=help)
    to.add("--traces", type=Path, metavar="FOLDER", help="write one trace per episode into one folder per mode")
    help = "draw the return of every episode, and how it ended, in a .svg or .png file"
    to.add("--plot", type=_figure, metavar="FILE", help=help)


def _add_policies(to: _Parser) -> None:
    _add_json(to, "write the list, with the commands that train the policies")


def _add_train(to: _Parser) -> None:
    to.add("config", type=Path, help="a YAML file, or a built-in one such as dqn-easy")
    to.add("--run", type=Path, metavar="FOLDER", help="folder of the run; default: runs/CONFIG-SEED")
    to.add("--seed", type=_seed, help="replace the seed of the configuration")
    _add_wandb(to)
    _add_trust(to, "the policy that the configuration names under `start`")


def _add_trust(to: _Parser, what: str) -> None:
    help = f"load {what} also if it is a model of Stable-Baselines3, a pickle, which can run any code"
    to.add("--trust", action="store_true", help=help)


def _add_wandb(to: _Parser) -> None:
    to.add("--wandb", metavar="PROJECT", help="also send the curves to Weights & Biases, if it is installed")


def _add_experiment(to: _Parser) -> None:
    help = (
        "spf, transfer, composition, town, observations, noise, communication, egos, vap, vap-50, "
        "vap-backbone, vap-continual, vap-steps, vap-concepts, language, or a YAML file; `logicity schema "
        "experiment` prints its keys"
    )
    to.add("experiment", help=help)
    exclusive = to.add_mutually_exclusive_group()
    exclusive.add_argument("--list", action="store_true", help="list the cells and which are finished, and run none")
    exclusive.add_argument("--report", action="store_true", help="print the table of the finished cells, and run none")
    help = (
        "evaluate the policies of the finished cells again, and write their rows to a file such as "
        "results/spf.json; run none"
    )
    exclusive.add_argument("--submit", type=Path, metavar="RESULTS", help=help)
    help = (
        "evaluate the policies of the finished cells again, and write only the hashes of their weights to rows of "
        "a file such as results/spf.json with the same figures; run none"
    )
    exclusive.add_argument("--rehash", type=Path, metavar="RESULTS", help=help)
    help = (
        "compare the finished cells with the rows of a file such as results/spf.json, and exit with 1 if a model or a "
        "figure differs; run none"
    )
    exclusive.add_argument("--compare", type=Path, metavar="RESULTS", help=help)
    help = "copy equal trainings from the folder of another experiment of Safe Path Following, for example runs/spf"
    exclusive.add_argument("--reuse", type=Path, metavar="FOLDER", help=help)
    to.add("--quick", action="store_true", help="tiny budgets and one seed: a test of every cell")
    help = (
        "run only the cells of a row, of a row in one mode (for `language` with one prompt), or of one variant "
        "there; can be repeated"
    )
    to.add("--only", type=_cells, action="append", default=[], metavar="LEARNER[,MODE[,VARIANT]]", help=help)
    to.add("--seeds", type=_seeds, metavar="LIST", help="replace the seeds, for example 0,1,2")
    help = "select at random COUNT of these cells, and those that they start from; default of SEED: 0"
    to.add("--sample", type=_sample, metavar="COUNT[,SEED]", help=help)
    help = (
        "change a key of every selected training configuration, for example threads=2, or with `--only dqn` "
        "settings.gamma=0.9; for `vap` a setting, for example training.epochs=3; for `language` a key of the "
        "experiment, for example models.NAME.url=http://localhost:8000/v1"
    )
    to.add("--set", type=_assignment, action="append", default=[], metavar="KEY=VALUE", help=help)
    help = "processes; default: the number of processors; the Ray cluster at ADDRESS has its own number"
    to.add("--jobs", type=_positive, metavar="N", help=help)
    where = "at ADDRESS, or on a new one on this machine with as many workers as `--jobs`"
    to.add("--ray", nargs="?", const="local", metavar="ADDRESS", help=f"run the cells on the Ray cluster {where}")
    _add_wandb(to)
    _add_trust(to, "a policy that a training configuration names under `start`")
    to.add("--run", type=Path, metavar="FOLDER", help="folder of the results; default: runs/EXPERIMENT")


def _add_release(to: _Parser) -> None:
    to.add("folder", type=Path, help="the folder to write; each data set has its own folder in it")
    help = (
        "data sets to write, separated by commas: spf-episodes, spf-demonstrations, questions, "
        "vap-MODE-AGENTS-DIFFICULTY, vap for all of these, policies for none; default: all"
    )
    to.add("--only", type=_names, metavar="NAMES", help=help)
    to.add("--modes", type=_modes, help=f"modes of episodes and demonstrations; default: {','.join(ENVIRONMENTS)}")
    help = "number of episodes of each mode and split, drawn with `--seed`; default: the recorded episodes"
    to.add("--episodes", type=_positive, metavar="N", help=help)
    to.add("--questions", type=_positive, default=1000, metavar="N", help="questions of each set; default: 1000")
    help = "worlds of each split; default: 100 for train, 20 for val and test"
    to.add("--worlds", type=_positive, metavar="N", help=help)
    help = "modes of questions and pictures: easy, hard; default: both"
    to.add("--vap-modes", type=partial(_choices, known=("easy", "hard")), default=("easy", "hard"), help=help)
    help = "sets of agents of the worlds: fixed, random; default: both"
    to.add("--agents", type=partial(_choices, known=("fixed", "random")), default=("fixed", "random"), help=help)
    help = "difficulties of the pictures, from 0 to 100; default: 0,50,100"
    to.add("--difficulties", type=_difficulties, default=(0, 50, 100), help=help)
    to.add("--no-pictures", action="store_true", help="write only the tables of worlds")
    to.add("--seed", type=_seed, default=0, help="seed of what is drawn; default: 0")
    help = "number of threads that draw pictures; 0 means one per core; default: 0"
    to.add("--threads", type=partial(_whole, least=0), default=0, metavar="N", help=help)
    help = (
        "also pack the trained policies of published results, such as results/spf.json, to the folder `policies`; can "
        "be repeated"
    )
    to.add("--results", type=Path, action="append", metavar="FILE", help=help)
    help = "folder with the folders of the experiments in which the policies were trained; default: runs"
    to.add("--runs", type=Path, default=Path("runs"), metavar="FOLDER", help=help)
    help = "day of the release; default: today, or that of the interrupted command"
    to.add("--date", type=_date, metavar="YYYY-MM-DD", help=help)
    to.add("--url", help="address of the release or of the project, for its metadata")


def _add_import_episodes(to: _Parser) -> None:
    to.add("file", type=Path, help="the pickle, such as test_100_episodes.pkl")
    help = "the mode whose agents and rules the episodes have, or a configuration file"
    to.add("--mode", type=_mode, required=True, help=help)
    to.add("--split", type=str.lower, choices=("train", "val", "test"), default="test", help="default: test")
    to.add("--seed", type=_seed, default=0, help="seed of the random events during the episodes; default: 0")
    help = "the file of episodes to write"
    to.add("-o", "--output", type=Path, required=True, metavar="FILE", help=help)
    _add_force(to)


def _add_shards(to: _Parser) -> None:
    to.add("count", type=_positive, metavar="N", help="the number of shards")
    help = (
        "processes, or simultaneous jobs of Slurm; default: the number of processors, or what Slurm permits; the Ray "
        "cluster at ADDRESS has its own number"
    )
    to.add("--jobs", type=_positive, metavar="N", help=help)
    where = "at ADDRESS, whose machines share the folder, or on a new one on this machine"
    to.add("--ray", nargs="?", const="local", metavar="ADDRESS", help=f"make the shards on the Ray cluster {where}")
    help = (
        "make the shards as an array of jobs of Slurm; the values are parameters of submitit, for example "
        "timeout_min=60,slurm_partition=cpu"
    )
    to.add("--slurm", nargs="?", const={}, type=_parameters, metavar="KEY=VALUE,...", help=help)
    help = (
        "the command after `--`: `episodes make`, `questions` or `vap make` with its options and `--output`; the "
        "shards lie in the folder OUTPUT-shards"
    )
    to.add("command", nargs="+", metavar="COMMAND", help=help)


def _add_ask(to: _Parser) -> None:
    to.add("--questions", type=Path, default=Path("questions.jsonl"), metavar="FILE", help=QUESTIONS)
    to.add("--url", required=True, help="for example http://localhost:8000/v1")
    to.add("--model", required=True, help="the name of the model on the server")
    to.add("-o", "--output", type=Path, required=True, metavar="FILE", help="append the replies to FILE")
    to.add("--key-from", metavar="VARIABLE", help="environment variable with the API key; by default no key is sent")
    help = 'more fields of the request; default: {"temperature": 0}'
    to.add("--settings", type=_object, default={"temperature": 0}, metavar="JSON", help=help)
    help = "time for an attempt, from the name of the server to the end of the reply; default: 120"
    to.add("--timeout", type=_positive_float, default=120.0, metavar="SECONDS", help=help)
    to.add("--tries", type=_positive, default=6, help="attempts per request; default: 6")


def _add_grade(to: _Parser) -> None:
    to.add("answers", type=Path, help='JSON lines {"id": .., "answer": ..}; an answer is a letter or a whole reply')
    to.add("--questions", type=Path, default=Path("questions.jsonl"), metavar="FILE", help=QUESTIONS)
    _add_json(to, "write the measures")


def _add_study(to: _Parser) -> None:
    to.add("questions", type=Path, nargs="?", default=Path("questions.jsonl"), help=QUESTIONS)
    help = "the sheet to write: .html, which needs no other file, or .docx; default: study.html"
    sheet = partial(_document, is_key=False)
    to.add("-o", "--output", type=sheet, default=Path("study.html"), metavar="FILE", help=help)
    help = "the key with the answers to write: .html, .docx or .csv; default: study-answers.csv"
    key = partial(_document, is_key=True)
    to.add("--answers", type=key, default=Path("study-answers.csv"), metavar="FILE", help=help)
    to.add("--seed", type=_seed, default=0, help="seed of the order of questions and examples; default: 0")
    help = "the largest number of solved examples, spread over the actions; default: all of the questions"
    to.add("--examples", type=partial(_whole, least=0), metavar="N", help=help)
    _add_force(to)


def _document(text: str, is_key: bool) -> Path:
    from .study import KEYS, SHEETS

    known = KEYS if is_key else SHEETS
    if Path(text).suffix not in known:
        raise argparse.ArgumentTypeError(f"expected a file that ends in {' or '.join(known)}, not `{text}`")
    return Path(text)


def _add_webdataset(to: _Parser) -> None:
    to.add("folder", type=Path, help="the data set")
    to.add("out", type=Path, help="the folder to create")
    to.add("--shard-size", type=_positive, default=1000, help="samples per file; default: 1000")
    to.add("--no-pictures", action="store_true", help="omit pictures; required if the data set has none")


def _add_coco(to: _Parser) -> None:
    to.add("folder", type=Path, help="the data set")
    to.add("out", type=Path, help="the JSON file to write")
    help = "accept a data set without pictures; the output still has `file_name`s, and `info.pictures` is false"
    to.add("--no-pictures", action="store_true", help=help)
    _add_force(to)


def _add_baselines(to: _Parser) -> None:
    to.add("--train", type=Path, required=True, metavar="FOLDER", help="the data set to train on")
    to.add("--test", type=Path, required=True, metavar="FOLDER", help="the data set to measure on")
    to.add("--seed", type=_seed, default=0, help="seed of the network; default: 0")
    to.add("--epochs", type=_positive, default=30, help="epochs of the network; default: 30")
    _add_json(to, "write the measures")


def _add_features(to: _Parser) -> None:
    to.add("folder", type=Path, help="a data set with pictures")
    to.add("-o", "--out", type=Path, metavar="FOLDER", help="folder to write; default: FOLDER-BACKBONE")
    help = "crops of the boxes, or region features of a frozen ResNet50 with a feature pyramid; default: crops"
    to.add("--backbone", choices=["crops", "resnet50"], default="crops", help=help)
    help = "weights of torchvision's ResNet50 or Faster R-CNN with ResNet50; default: those in torchvision's cache"
    to.add("--weights", type=Path, metavar="FILE", help=help)
    to.add("--device", default="cpu", help="device of PyTorch, for example cuda; default: cpu")
    help = "number of threads; 0 means one per core; default: 1"
    to.add("--threads", type=partial(_whole, least=0), default=1, metavar="N", help=help)
    where = "at ADDRESS, whose machines share FOLDER, or on this machine"
    to.add("--ray", nargs="?", const="local", metavar="ADDRESS", help=f"compute the worlds on the Ray cluster {where}")


def _add_distill(to: _Parser) -> None:
    help = (
        "SUMO's FCD output (.xml) or CSV with the columns t, id, kind, x, y, heading and speed; also compressed (.gz)"
    )
    to.add("trajectories", nargs="+", help=help)
    help = "the folder of the city to write"
    to.add("-o", "--out", type=Path, required=True, metavar="FOLDER", help=help)
    to.add(
        "--map", metavar="MAP", help="map file, or the name of a built-in map; default: the map of the configuration"
    )
    help = (
        "configuration that defines the predicates, and whose rules define the words of learned clauses; default: "
        "right-of-way, and right-of-way-roads for a road network"
    )
    to.add("--config", help=help)
    to.add("--columns", type=Path, metavar="FILE", help="YAML file with the columns, units and classes of CSV files")
    to.add("--cell", type=_positive_float, metavar="METERS", help="side of a cell of a map of blocks; default: 1")
    help = "position of the upper left corner of a map of blocks; default: 0,0"
    to.add("--origin", type=_position, metavar="X,Y", help=help)
    help = "where y grows on a map of blocks: up, as on road maps, or down; default: up"
    to.add("--y", choices=("up", "down"), help=help)
    help = "length of a tick, from 0.01 to 3600; default: 1"
    to.add("--tick", type=_tick, default=1.0, metavar="SECONDS", help=help)
    to.add("--begin", type=_nonnegative_float, default=0.0, metavar="SECONDS", help="leave out earlier samples")
    to.add("--end", type=_positive_float, default=math.inf, metavar="SECONDS", help="leave out later samples")
    help = "an agent whose mean speed in a tick is less takes Stop; default: 0.5"
    to.add("--stop", type=_positive_float, default=0.5, metavar="M/S", help=help)
    help = "an agent with at most this mean speed in a tick has halted; default: 0.1, as in SUMO"
    to.add("--halt", type=_positive_float, default=0.1, metavar="M/S", help=help)
    help = "a moving one whose mean speed is less takes Slow; by default none does"
    to.add("--slow", type=_positive_float, metavar="M/S", help=help)
    help = "one whose mean speed is greater takes Fast; by default none does"
    to.add("--fast", type=_positive_float, metavar="M/S", help=help)
    help = "a car that stands at most this far before the end of its lane is on the line; default: 6"
    to.add("--line", type=_positive_float, default=6.0, metavar="METERS", help=help)
    to.add("--length", type=_nonnegative_float, default=5.0, metavar="METERS", help="length of a car; default: 5")
    help = "positions are those of the centers of cars, not of their fronts as in SUMO"
    to.add("--centers", action="store_true", help=help)
    help = "predicates that clauses may use, separated by commas; default: those that the rules derive, those about one"
    to.add("--use", type=_names, metavar="NAMES", help=f"{help} agent, and SameInter")
    help = (
        "learn from cars that decide at the line of an intersection, or from all cars in all ticks; default: junctions"
    )
    to.add("--moments", choices=("junctions", "all"), default="junctions", help=help)
    help = "leave out the ticks at a line before a start, in which the driver may have been free already; default: 2"
    to.add("--reaction", type=partial(_whole, least=0), default=2, metavar="TICKS", help=help)
    to.add("--test", type=_share, default=0.3, metavar="SHARE", help="share of the recording to hold out; default: 0.3")
    help = "hold out the last part of the time, or agents drawn by the seed; default: time"
    to.add("--split", choices=("time", "agents"), default="time", help=help)
    help = "share of moments with a wrong action, from 0 to 0.4, or auto to estimate it; default: auto"
    to.add("--noise", type=_noise, default="auto", metavar="RATE", help=help)
    to.add("--variables", type=partial(_whole, least=2, most=7), default=2, metavar="N", help="of a clause; default: 2")
    to.add("--seed", type=_seed, default=0, help="of the learner, and of the split by agents; default: 0")
    _add_force(to)


def _add_map_export(to: _Parser) -> None:
    to.add("map", help="map file, configuration, or the name of a built-in map or configuration")
    to.add("-o", "--out", type=Path, required=True, metavar="NAME.net.xml", help="the network; others lie beside it")
    help = "of a map of blocks, the right of way at intersections; default: right_before_left"
    kinds = ("right_before_left", "priority", "allway_stop", "traffic_light")
    to.add("--junctions", choices=kinds, help=help)
    to.add("--main", metavar="ZONE", help="with `--junctions priority`: the zone of the streets that have right of way")
    help = "side of a cell of a map of blocks; default: 1"
    to.add("--cell", type=_positive_float, metavar="METERS", help=help)
    help = "speed limit on a map of blocks; default: 30"
    to.add("--speed", type=_positive_float, metavar="KM/H", help=help)
    _add_force(to)


def _add_force(to: _Parser) -> None:
    help = "replace output files that this command did not write, or that have changed since"
    to.add("--force", action="store_true", help=help)


def _add_json(to: _Parser, help: str) -> None:
    to.add("--json", type=Path, metavar="FILE", help=help)
    _add_force(to)


def _check_json(given: argparse.Namespace, by: str) -> None:
    """Report now if the file of `--json`, which the command `by` writes at the end, cannot be written."""
    if given.json is not None:
        check_writable(given.json, by=by, overwrite=given.force)


def _write_json(given: argparse.Namespace, by: str, value: object) -> None:
    """Write the file of `--json`, if there is one, and print its path."""
    if given.json is not None:
        write_json(given.json, value, by=by, overwrite=given.force)
        print_message(f"wrote {given.json}")


def _figure(text: str) -> Path:
    path = Path(text)
    if path.suffix not in ENDINGS:
        raise argparse.ArgumentTypeError(f"expected a file that ends in {' or '.join(ENDINGS)}, not `{text}`")
    return path


def _modes(text: str) -> list[str]:
    modes = list(ENVIRONMENTS) if text == "all" else text.split(",")
    try:
        return [checked_mode(mode) for mode in modes]
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def _named_policy(text: str, trust: bool) -> tuple[Policy, str, str | None, ObservationKind | None, int | None]:
    """Return the policy that an argument names, its name for tables, and mode, observation and egos of its training."""
    if text in ("oracle", "random"):
        return cast("Policy", text), text, None, None, None
    path = Path(text)
    if not path.exists():
        if path.suffix or len(path.parts) > 1:
            raise FileNotFoundError(errno.ENOENT, "no such file", text)
        near = get_close_matches(text, ("oracle", "random", *shipped_policies()), n=1)
        help = f"\nhelp: did you mean `{near[0]}`?" if near else ""
        expected = "oracle, random, a name that `logicity policies` lists, the file of a policy, or the folder of a run"
        raise _UsageError(f"unknown policy `{text}`: expected {expected}{help}")
    from .rule_policy import policy_files

    if path.is_dir() and not policy_files(path):
        what = "a folder without a file `best.*`, which `logicity train` writes at the end of a run"
        raise _UsageError(f"`{text}` is {what}\nhelp: name the file of a policy")
    if path.is_file() and path.suffix in (".yaml", ".yml", ".json", ".jsonl", ".gz", ".txt"):
        raise _UsageError(f"`{text}` is no policy\nhelp: name a rule file (`.dl`), weights, or the folder of a run")
    from .learn import load_policy

    saved = load_policy(path, trust=trust)
    return saved.policy, _name_of(saved.path), saved.mode, saved.observation, saved.egos


def _name_of(file: Path) -> str:
    """Return the name of a policy for tables: that of its file, or of its folder if it is packed."""
    return (file.parent.name if file.stem == "policy" else "") or file.stem


def _rule_file(text: str) -> Path | None:
    """Return the rule file, possibly a built-in one or the best policy of a run, that `--policy` names, if any."""
    path = Path(text)
    files = [path / "best.dl", path / "policy.dl"] if path.is_dir() else [path]
    for file in (each for each in files if each.suffix == ".dl"):
        with suppress(FileNotFoundError):
            _logicity.read_file(os.fspath(file))
            return file
    return None


def _check_kind(given: ObservationKind | None, trained: ObservationKind | None, policy: Policy) -> ObservationKind:
    """Check the value of `--observation`, and return the kind that the policy takes or its file records."""
    if isinstance(policy, str):
        return given or "groundings"
    expected, shape = trained, model_shape(policy)
    if expected is None and isinstance(shape, dict):
        # The names of the views differ. `state` has two axes, and `groundings` has one.
        expected = "graph" if "nodes" in shape else "relational"
    elif expected is None:
        expected = "state" if shape is not None and len(shape) == 2 else "groundings"
    if given not in (None, expected):
        what = f"this policy takes observations of the kind `{expected}`, not `{given}`"
        raise _UsageError(f"--observation: {what}\nhelp: leave out `--observation {given}`")
    return expected


def _check_prediction(policy: Policy, name: str, trained: str | None, benchmark: Benchmark) -> None:
    """Check with one observation that a policy without an observation space takes those of a mode."""
    predict, shape = getattr(policy, "predict", None), benchmark.observation_shape
    # A planner decides on states of the city.
    if predict is None or isinstance(shape, dict) or model_shape(policy) is not None or hasattr(policy, "plan"):
        return
    try:
        # A policy of several egos takes a row for each.
        rows = getattr(policy, "egos", None) or 1
        starts = np.ones(rows, np.bool_)
        predict(np.zeros((rows, *shape), np.float32), state=None, episode_start=starts, deterministic=True)
    except InputError:
        raise
    except ValueError as error:
        message = f"the policy `{name}` cannot act in `{benchmark.mode}`: {error}"
        raise _UsageError(message if trained is None else f"{message}\nhelp: name `--modes {trained}`") from None


def _check_fit(policy: Policy, trained: str | None, benchmarks: Sequence[Benchmark]) -> None:
    """Check that a model takes the observations of all modes."""
    shape = model_shape(policy)
    other = next((each for each in benchmarks if shape not in (None, each.observation_shape)), None)
    if shape is None or other is None:
        return
    what = "this model takes" if trained is None else f"this model was trained for `{trained}`:"
    message = f"{what} {_numbers(shape)}, and `{other.mode}` has {_numbers(other.observation_shape)}"
    modes = [each.mode for each in benchmarks if each.observation_shape == shape] if trained is None else [trained]
    raise _UsageError(f"{message}\nhelp: name `--modes {','.join(modes)}`" if modes else message)


def _numbers(shape: Shape) -> str:
    if isinstance(shape, dict):
        return ", ".join(f"`{name}` of {_numbers(each)}" for name, each in shape.items())
    return f"{shape[0]} numbers" if len(shape) == 1 else f"{' x '.join(map(str, shape))} numbers"


def _check_folder(option: str, path: Path) -> None:
    """Check that a path is a folder or can become one."""
    existing = next((each for each in (path, *path.parents) if each.exists()), None)
    if existing is not None and not existing.is_dir():
        raise _UsageError(f"{option}: `{existing}` is a file, not a folder\nhelp: name a folder; it need not exist")


def _whole(text: str, least: int, most: int | None = None) -> int:
    if not text.isdecimal() or int(text) < least or (most is not None and int(text) > most):
        to = "" if most is None else f" to {most}"
        raise argparse.ArgumentTypeError(f"expected an integer from {least}{to}, found `{text}`")
    return int(text)


_positive = partial(_whole, least=1)
_seed = partial(_whole, least=0, most=2**32 - 1)


def _seeds(text: str) -> tuple[int, ...]:
    return tuple(dict.fromkeys(_seed(each) for each in text.split(",")))


def _sample(text: str) -> tuple[int, int]:
    count, comma, seed = text.partition(",")
    return _positive(count), _seed(seed) if comma else 0


def _cells(text: str) -> tuple[str, ...]:
    names = tuple(text.split(",", 2))
    if not all(names):
        raise argparse.ArgumentTypeError(f"expected LEARNER, LEARNER,MODE or LEARNER,MODE,VARIANT, found `{text}`")
    return names


def _assignment(text: str) -> dict[str, object]:
    keys, equals, value = text.partition("=")
    if not keys or not equals:
        raise argparse.ArgumentTypeError(f"expected KEY=VALUE, found `{text}`")
    parsed: object = value
    with suppress(RecursionError, ValueError):
        parsed = json.loads(value)
    for key in reversed(keys.split(".")):
        parsed = {key: parsed}
    return cast("dict[str, object]", parsed)


def _positive_float(text: str) -> float:
    with suppress(ValueError):
        if 0 < (value := float(text)) < math.inf:
            return value
    raise argparse.ArgumentTypeError(f"expected a positive number, found `{text}`")


def _tick(text: str) -> float:
    with suppress(ValueError):
        if 0.01 <= (value := float(text)) <= 3600:
            return value
    raise argparse.ArgumentTypeError(f"expected a number from 0.01 to 3600, found `{text}`")


def _object(text: str) -> dict[str, object]:
    try:
        value = json.loads(text)
    except (RecursionError, ValueError) as error:
        raise argparse.ArgumentTypeError(f"not JSON: {error}") from None
    if not isinstance(value, dict):
        raise argparse.ArgumentTypeError("not a JSON object")
    return value


def _choices(text: str, known: tuple[str, ...]) -> tuple[str, ...]:
    names = tuple(dict.fromkeys(text.split(",")))
    if unknown := [name for name in names if name not in known]:
        raise argparse.ArgumentTypeError(f"expected {' or '.join(known)}, found `{unknown[0]}`")
    return names


def _difficulties(text: str) -> tuple[int, ...]:
    return tuple(dict.fromkeys(_whole(each, 0, 100) for each in text.split(",")))


def _date(text: str) -> str:
    try:
        return date.fromisoformat(text).isoformat()
    except ValueError:
        raise argparse.ArgumentTypeError(f"expected a day such as 2026-12-01, found `{text}`") from None


def _mode(text: str) -> str:
    (mode,) = _modes(text) if "," not in text and text != "all" else ("",)
    if not mode:
        raise argparse.ArgumentTypeError(f"expected one mode, found `{text}`")
    return mode


def _parameters(text: str) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for each in text.split(","):
        found |= _assignment(each)
    return found


def _nonnegative_float(text: str) -> float:
    return 0.0 if text in ("0", "0.0") else _positive_float(text)


def _share(text: str) -> float:
    with suppress(ValueError):
        if 0 < (value := float(text)) < 1:
            return value
    raise argparse.ArgumentTypeError(f"expected a number between 0 and 1, found `{text}`")


def _noise(text: str) -> Any:
    if text == "auto":
        return text
    with suppress(ValueError):
        if 0 <= (value := float(text)) <= _logicity.NOISE_MAX:
            return value
    raise argparse.ArgumentTypeError(f"expected auto or a number from 0 to {_logicity.NOISE_MAX}, found `{text}`")


def _position(text: str) -> tuple[float, float]:
    with suppress(ValueError):
        x, y = map(float, text.split(","))
        if math.isfinite(x) and math.isfinite(y):
            return x, y
    raise argparse.ArgumentTypeError(f"expected X,Y in meters, found `{text}`")


def _names(text: str) -> tuple[str, ...]:
    names = tuple(name.strip() for name in text.split(","))
    if not all(names):
        raise argparse.ArgumentTypeError(f"expected names separated by commas, found `{text}`")
    return names


@contextmanager
def _usage() -> Iterator[None]:
    """Report options that do not fit each other as faulty usage."""
    try:
        yield
    except (CommandError, InputError):
        raise
    except ValueError as error:
        raise _UsageError(str(error)) from error


def _distill(given: argparse.Namespace) -> int:
    from .distill import Settings, config_for, distill
    from .placement import Thresholds, load_map
    from .trajectories import read_columns, read_trajectories

    _check_folder("--out", given.out)
    columns, where = read_columns(given.columns) if given.columns is not None else (None, {})
    cell = where.get("cell") if given.cell is None else given.cell
    origin = given.origin or (tuple(map(float, where["origin"])) if "origin" in where else None)
    y = where.get("y") if given.y is None else given.y
    file = given.map or given.config or "right-of-way"
    with _usage():
        grid = load_map(file, cell, origin, None if y is None else y == "up")
    given.config = given.config or config_for(grid)
    with _usage():
        rates = given.stop, given.halt, given.slow, given.fast
        thresholds = Thresholds(*rates, given.line, given.length, not given.centers)
    settings = Settings(
        **{name: getattr(given, name) for name in ("config", "map", "use", "moments", "reaction", "test", "split")},
        **{name: getattr(given, name) for name in ("noise", "variables", "seed")},
        thresholds=thresholds,
    )
    print_message(f"reading {', '.join(given.trajectories)}")
    recording = read_trajectories(given.trajectories, columns, tick=given.tick, begin=given.begin, end=given.end)
    if recording.assumed:
        kind = (columns.default_kind if columns is not None else None) or "Car"
        classes = ", ".join(f"{neutral(name)} ({count})" for name, count in sorted(recording.assumed.items())[:20])
        print_message(f"samples of unknown classes that count as {kind}: {classes}; name them in `--columns`")
    source = ", ".join(Path(path).name for path in given.trajectories)
    done = distill(recording, grid, given.out, settings, overwrite=given.force, source=source, progress=print_message)
    for clause in done.clauses:
        print_text(clause)
    parts = {"all": "", "line": " at lines", "free": " at lines of free intersections"}
    # All moments to learn from at lines are those at lines.
    for part in parts if given.moments == "all" else ("line", "free"):
        row = done.report["test"][part]
        if row["moments"]:
            constant = f"{row['most_frequent_action']:.1%} by the most frequent action"
            shares = f"{row['explained']:.1%} of {row['moments']} explained, {constant}"
            print_text(f"held-out moments{parts[part]}: {shares}")
    print_message(f"wrote {given.out}")
    return 0


def _map_export(given: argparse.Namespace) -> int:
    from .placement import Roads, load_map
    from .sumo import export_network, export_roads, find_program

    if not str(given.out).endswith(".net.xml"):
        raise _UsageError(f"--out: expected a name that ends in .net.xml, not `{given.out}`")
    if given.junctions == "priority" and given.main is None:
        raise _UsageError("--junctions priority: name the zone of the main streets with `--main ZONE`")
    with _usage():
        grid = load_map(given.map, given.cell)
    if isinstance(grid, Roads):
        for option in ("junctions", "main", "speed"):
            if getattr(given, option) is not None:
                raise _UsageError(f"--{option}: `{given.map}` is a road network, which states it; omit the option")
        export_roads(given.map, given.out, overwrite=given.force)
        print_message(f"wrote {given.out}")
        return 0
    options = {"speed": given.speed or 30.0, "main": given.main, "overwrite": given.force}
    paths = export_network(grid, given.out, given.junctions or "right_before_left", **options)
    for path in paths:
        print_message(f"wrote {path}")
    if find_program("netconvert") is None:
        print_message("netconvert is not installed: the extra `sumo` has it, pip install 'logicity[sumo]'")
    return 0


def _evaluate(given: argparse.Namespace) -> int:
    _check_json(given, "evaluate")
    if given.plot is not None:
        with extra("learn"):
            import matplotlib  # noqa: F401
        check_writable(given.plot, by="evaluate", overwrite=given.force)
    if given.traces is not None:
        _check_folder("--traces", given.traces)
    packed = packed_policies(Path(given.policy)) if Path(given.policy).is_dir() else None
    runs: list[_Run] = []
    # A benchmark runs the random policy once for all policies.
    benchmark_of = cache(_benchmark)
    if packed is None:
        shipped = None if Path(given.policy).exists() else shipped_policies().get(given.policy)
        runs = _runs(given, given.policy if shipped is None else str(shipped.path), None, None, benchmark_of)
    for entry in packed or []:
        runs += _runs(given, str(Path(given.policy) / entry["file"]), entry["name"], entry["mode"], benchmark_of)
    if not runs:
        raise _UsageError(f"`{given.policy}` has no policy for these modes\nhelp: leave out `--modes`")
    for run in runs:
        if run.traces is not None:
            run.benchmark.check_traces(run.traces, given.force)
    results: list[Evaluation] = []
    try:
        for run in runs:
            benchmark = run.benchmark
            results.append(benchmark.evaluate(run.policy, name=run.name, traces=run.traces, overwrite=given.force))
    finally:
        # An error must not hide the results of the modes before.
        if results:
            print_text(table(results))
            if given.by_action:
                print_text(f"\n{action_table(results)}")
    if given.traces is not None:
        print_message(f"wrote {given.traces}")
    if given.plot is not None:
        plot_returns(given.plot, results, by="evaluate", overwrite=given.force)
        print_message(f"wrote {given.plot}")
    _write_json(given, "evaluate", [result.to_dict() for result in results])
    return 0


def _policies(given: argparse.Namespace) -> int:
    _check_json(given, "policies")
    rows: list[tuple[str, ...]] = [("policy", "mode", "learner", "extra", "measured on", "TSR", "DSR", "Score")]
    policies = shipped_policies().values()
    for policy in policies:
        for evaluation, measures in policy.measures.items():
            values = (f"{measures[name]:.2f}" if name in measures else "-" for name in ("tsr", "dsr", "score"))
            rows.append((policy.name, policy.mode, policy.learner, policy.extra or "-", evaluation, *values))
    print_text(aligned(rows))
    print_text(f"\nfiles and model cards: {SHIPPED}")
    listed = [{**asdict(policy), "path": str(policy.path)} for policy in policies]
    _write_json(given, "policies", listed)
    return 0


@dataclass(frozen=True)
class _Run:
    """A policy to evaluate on a benchmark."""

    benchmark: Benchmark
    policy: Policy
    name: str
    traces: Path | None


def _runs(
    given: argparse.Namespace,
    named: str,
    packed: str | None,
    mode: str | None,
    benchmark_of: Callable[[str, Split, ObservationKind, int | None], Benchmark],
) -> list[_Run]:
    """Return the evaluations of a policy, after a check that it fits. A packed one has a name and a mode."""
    from .rule_policy import rule_policies

    trained = kind = egos = None
    modes = given.modes
    if mode is not None:
        if modes is not None and mode not in modes:
            return []
        modes = [mode]
    rules = _rule_file(named)
    if rules is not None:
        # The same rules read the observations of each mode in another order.
        compiled = rule_policies(rules, modes)
        name, modes = _name_of(rules), [each.mode for each in compiled]
        policies: list[Policy] = list(compiled)
    else:
        policy, name, trained, kind, egos = _named_policy(named, given.trust)
        modes = modes or ([checked_mode(trained)] if trained is not None else list(ENVIRONMENTS))
        policies = [policy] * len(modes)
    policy = policies[0]
    stems = [Path(mode).stem for mode in modes]
    if given.traces is not None and len(set(stems)) < len(stems):
        raise _UsageError("modes with the same name would write traces to the same folder: evaluate one at a time")
    if given.traces is not None and policy == "random":
        raise _UsageError("the random policy runs every episode ten times and supports no traces")
    observation = _check_kind(given.observation, kind, policy)
    benchmarks = [benchmark_of(mode, given.split, observation, egos) for mode in modes]
    _check_fit(policy, trained, benchmarks)
    root = given.traces if given.traces is None or packed is None else given.traces / packed
    folders = [None if root is None else root / stem for stem in stems]
    runs = [
        _Run(benchmark, each, packed or name, folder)
        for benchmark, each, folder in zip(benchmarks, policies, folders, strict=True)
    ]
    # Check everything before the first mode runs, so that no mode fails late.
    for run in runs:
        _check_prediction(run.policy, named, trained, run.benchmark)
    return runs


def _benchmark(mode: str, split: Split, observation: ObservationKind, egos: int | None) -> Benchmark:
    # As in the validation and the test of the run.
    overrides = None if egos is None else {"task": {"egos": egos}}
    return Benchmark(mode, split, observation=observation, overrides=overrides)


def _train(given: argparse.Namespace) -> int:
    from .learn import TrainConfig, train
    from .learn.config import located
    from .learn.run import FolderError

    config = TrainConfig.load(given.config, seed=given.seed)
    run = given.run or Path("runs") / f"{given.config.stem}-{config.seed}"
    _check_folder("--run", run)
    try:
        result = train(config, run, progress=True, wandb=given.wandb, trust=given.trust)
    except (FolderError, UntrustedError):
        raise
    except ValueError as error:
        raise located(given.config, config, error) from error
    spent = f"{result['cpu_seconds']:,.0f} CPU seconds"
    print_text(f"{result['steps']} {result['unit']} in {spent}; best after {result['best']['steps']}")
    for name, label in {"compliance": "compliance", "tsr": "TSR", "joint_tsr": "joint TSR", "dsr": "DSR"}.items():
        if name not in result["test"]:
            continue
        print_text(f"{label} on test episodes: {Interval(**result['test'][name])}")
    print_text(f"all results in {run / 'result.json'}")
    return 0


def _experiment(given: argparse.Namespace) -> int:
    from .experiments.cells import finished, sampled
    from .experiments.experiment import Selection
    from .experiments.jobs import run
    from .experiments.registry import load_experiment
    from .experiments.report import Report
    from .experiments.results import compare, submit
    from .learn.faults import merged

    with _usage():
        check_jobs(given.jobs, given.ray)
    changes: dict[str, object] = reduce(merged, given.set, {})
    rows = {"learners": changes.pop("learners")} if "learners" in changes else {}
    try:
        loaded = load_experiment(given.experiment, rows)
        cells = loaded.cells(Selection(tuple(given.only), given.seeds, changes, given.quick, given.trust))
    except InputError:
        raise
    except ValueError as error:
        raise _UsageError(str(error)) from None
    if given.reuse is not None and not loaded.task.reusable:
        raise _UsageError("--reuse: only experiments of Safe Path Following can reuse trainings")
    if given.wandb is not None and not loaded.task.sends_curves:
        raise _UsageError("--wandb: only experiments of Safe Path Following send curves")
    if given.sample is not None:
        cells = sampled(cells, *given.sample)
    root = _results_folder(given, loaded.file)
    if given.list:
        for cell in cells:
            print_text(f"{'finished' if finished(cell, root) else 'not run ':8}  {cell.name}  {cell.identity[:12]}")
        return 0
    options = {"--submit": given.submit, "--rehash": given.rehash, "--compare": given.compare}
    # At most one is given.
    for option, results in ((option, path) for option, path in options.items() if path is not None):
        if given.quick or given.set:
            raise _UsageError(f"{option}: rows have the budgets of the experiment: remove `--quick` and `--set`")
        if not any(finished(cell, root) for cell in cells if not cell.hidden):
            help = "run the experiment first, or name its folder with `--run`"
            raise _UsageError(f"{option}: none of the cells is finished in `{root}`\nhelp: {help}")
        if option == "--compare":
            equal = True
            for same, line in compare(loaded, cells, root, results):
                print_text(line)
                equal &= same
            return int(not equal)
        for line in submit(loaded, cells, root, results, only_hashes=option == "--rehash"):
            print_text(line)
        return 0
    failed: dict[str, str] = {}
    if not given.report:
        jobs = given.jobs or os.cpu_count() or 1
        failed = run(cells, root, jobs, print_message, given.ray, given.wandb, given.reuse, given.trust)
    report = Report(loaded, cells, root, failed)
    print_text(report.text(), flush=True)
    written = report.write(root)
    print_text(f"written: {', '.join(str(path) for path in written)}")
    return int(any(cell.identity in failed and not cell.optional for cell in cells))


def _release(given: argparse.Namespace) -> int:
    from .experiments.results import read_results
    from .release import DataSetOptions, release
    from .release.policies import ResultsFile
    from .release.write import selected_sets

    _check_folder("FOLDER", given.folder)
    if given.only is not None and "policies" in given.only and not given.results:
        raise _UsageError("--only policies: name the published results with `--results`, such as results/spf.json")
    with _usage():
        options = DataSetOptions(
            episodes=given.episodes,
            questions=given.questions,
            worlds=given.worlds,
            vap_modes=given.vap_modes,
            agents=given.agents,
            difficulties=given.difficulties,
            pictures=not given.no_pictures,
            seed=given.seed,
            threads=given.threads,
            **({} if given.modes is None else {"modes": tuple(given.modes)}),
        )
        selected_sets(given.only, options)
    results = [
        ResultsFile(file, given.runs / str(read_results(file)["experiment"]))
        for file in map(_existing, given.results or [])
    ]
    try:
        done = release(
            given.folder,
            options,
            only=given.only,
            results=results,
            date=given.date,
            url=given.url,
            progress=print_message,
        )
    except FileExistsError as error:
        raise _UsageError(str(error)) from None
    print_text(f"data sets written: {len(done.made)}, complete already: {len(done.kept)}, in {given.folder}")
    if results:
        print_text(f"policies packed: {len(done.policies)}, left out: {len(done.left_out)}")
    return 0


def _existing(path: Path) -> Path:
    if not path.exists():
        raise FileNotFoundError(errno.ENOENT, "no such file", str(path))
    return path


def _import_episodes(given: argparse.Namespace) -> int:
    from .published import import_episodes

    done = import_episodes(given.file, given.mode, given.split, given.output, seed=given.seed, overwrite=given.force)
    print_text(done)
    print_message(f"wrote {given.output}")
    return 0


def _shards(given: argparse.Namespace) -> int:
    from .shards import make_shards

    if given.ray is not None and given.slurm is not None:
        raise _UsageError("--ray, --slurm: choose one")
    with _usage():
        made = make_shards(
            given.command, given.count, jobs=given.jobs, ray=given.ray, slurm=given.slurm, progress=print_message
        )
    print_text(made, end="")
    return 0


def _results_folder(given: argparse.Namespace, file: Path) -> Path:
    """Return the folder of the results of an experiment, after a check that it fits the options."""
    folder: Path = given.run or Path("runs") / (f"{file.stem}-quick" if given.quick else file.stem)
    _check_folder("--run", folder)
    begun = (folder / "cells").is_dir()
    foreign = sorted(path.name for path in folder.iterdir() if path.name[0] != ".") if folder.is_dir() else []
    if foreign and not begun and foreign != ["running"]:
        help = "name another folder; it need not exist"
        raise _UsageError(f"--run: `{folder}` is not empty (`{foreign[0]}`) and has no experiment\nhelp: {help}")
    if given.report and not begun:
        help = "run the experiment first, or name its folder with `--run`"
        raise _UsageError(f"--report: `{folder}` has no experiment\nhelp: {help}")
    return folder


def _ask(given: argparse.Namespace) -> int:
    from .questions import Endpoint, ask, grade, key_from, load_logprobs, load_questions

    try:
        key = key_from(given.key_from)
    except ValueError as error:
        raise _UsageError(f"--key-from: {error}") from None
    questions = load_questions(given.questions)
    endpoint = Endpoint(given.url, given.model, key, given.settings, given.timeout, given.tries)
    with Progress(f"questions answered by {endpoint.model}", len(questions)) as progress:
        answers = ask(questions, endpoint, given.output, progress.update)
    print_text(grade(questions, answers, load_logprobs(given.output)))
    print_message(f"wrote {given.output}")
    return 0


def _grade(given: argparse.Namespace) -> int:
    from .questions import grade, load_answers, load_logprobs, load_questions

    _check_json(given, "grade")
    answers = load_answers(given.answers)
    if not answers:
        raise ValueError(f"{given.answers} has no answers")
    if not given.questions.exists():
        help = "name the questions with --questions; `logicity questions --output questions.jsonl` writes some"
        raise _UsageError(f"cannot read `{given.questions}`: no such file\nhelp: {help}")
    graded = grade(load_questions(given.questions), answers, load_logprobs(given.answers))
    print_text(graded)
    for what, ids in [
        ("counted as wrong, no answer", graded.missing),
        ("counted as wrong, the answer chooses no option", graded.unread),
        ("ignored, unknown question", graded.unknown),
    ]:
        if ids:
            shown = ", ".join(neutral(name[:100], lines=False) for name in ids[:5])
            print_message(f"{what}: {len(ids)}: {shown}{', ...' * (len(ids) > 5)}")
    _write_json(given, "grade", graded.to_dict())
    return 0


def _study(given: argparse.Namespace) -> int:
    from .questions import load_questions
    from .study import write_study

    if given.output.resolve() == given.answers.resolve():
        raise _UsageError("--output and --answers: name two files")
    questions = load_questions(_existing(given.questions))
    done = write_study(
        questions, given.output, given.answers, seed=given.seed, examples=given.examples, overwrite=given.force
    )
    print_text(f"questions: {len(done.ids)}, solved examples: {done.examples}, in {given.output}")
    print_text(f"answers: {given.answers}")
    return 0


def _describe(given: argparse.Namespace) -> int:
    from .describe import describe

    print_text(describe(), end="")
    return 0


def _webdataset(given: argparse.Namespace) -> int:
    from .vap import to_webdataset

    shards = to_webdataset(given.folder, given.out, given.shard_size, images=not given.no_pictures)
    print_text(f"{len(shards)} {'file' if len(shards) == 1 else 'files'} in {given.out}")
    return 0


def _coco(given: argparse.Namespace) -> int:
    from .vap import to_coco

    to_coco(given.folder, given.out, images=not given.no_pictures, overwrite=given.force)
    print_message(f"wrote {given.out}")
    return 0


def _baselines(given: argparse.Namespace) -> int:
    from .vap import baseline_table, measure_baselines

    _check_json(given, "vap baselines")
    results = measure_baselines(given.train, given.test, given.seed, given.epochs)
    print_text(baseline_table(results))
    _write_json(given, "vap baselines", [result.to_dict() for result in results])
    by_rules = next(result for result in results if result.name == "rules")
    if set(by_rules.metrics.recall.values()) != {1.0}:
        print_message(f"error: {given.test} has labels that the rules do not derive from its facts")
        return 1
    return 0


def _features(given: argparse.Namespace) -> int:
    from .vap.features import compute_features, output_folder

    try:
        folder = output_folder(given.folder, given.backbone, given.out, given.weights, given.device)
    except ValueError as error:
        raise _UsageError(str(error)) from None
    begun = time.monotonic()
    out = compute_features(
        given.folder,
        folder,
        kind=given.backbone,
        weights=given.weights,
        device=given.device,
        threads=given.threads,
        ray=given.ray,
        progress=lambda done, total: print_message(f"[{done}/{total}] worlds"),
    )
    print_text(f"written: {out}, in {time.monotonic() - begun:.0f} s")
    return 0


_COMMANDS: dict[tuple[str, ...], tuple[Callable[[_Parser], None], Callable[[argparse.Namespace], int]]] = {
    ("evaluate",): (_add_evaluate, _evaluate),
    ("policies",): (_add_policies, _policies),
    ("train",): (_add_train, _train),
    ("experiment",): (_add_experiment, _experiment),
    ("distill",): (_add_distill, _distill),
    ("map", "export"): (_add_map_export, _map_export),
    ("release",): (_add_release, _release),
    ("import-episodes",): (_add_import_episodes, _import_episodes),
    ("shards",): (_add_shards, _shards),
    ("ask",): (_add_ask, _ask),
    ("grade",): (_add_grade, _grade),
    ("study",): (_add_study, _study),
    ("describe",): (lambda to: None, _describe),
    ("vap", "webdataset"): (_add_webdataset, _webdataset),
    ("vap", "coco"): (_add_coco, _coco),
    ("vap", "baselines"): (_add_baselines, _baselines),
    ("vap", "features"): (_add_features, _features),
}
