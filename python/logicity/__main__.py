"""`python -m logicity`: measure policies, train them, and print the tables of what they are trained in."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import cast

import gymnasium

from . import InputError, __version__
from .describe import describe
from .evaluation import Benchmark, Evaluation, Policy, table, write_json
from .modes import ENVIRONMENTS, checked_mode


def main(arguments: list[str] | None = None) -> int:
    """Run a command and return its exit status: 0, 1 for faulty input, 2 for faulty arguments, 130 if interrupted."""
    parser = _parser()
    given = parser.parse_args(arguments)
    try:
        return {"evaluate": _evaluate, "train": _train, "describe": _describe}[given.command](given)
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

    learn = _add(commands, "train", "train a model, or go on with a run that was killed")
    learn.add_argument("config", type=Path, help="for example configs/baselines/dqn-easy.yaml")
    learn.add_argument("--run", type=Path, metavar="FOLDER", help="of the run; default: runs/CONFIG-SEED")
    learn.add_argument("--seed", type=int, help="instead of the configuration's")

    _add(commands, "describe", "print tables of environments, observations and rewards, as Markdown")
    return parser


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


def _evaluate(given: argparse.Namespace) -> int:
    policy, name = _named_policy(given.policy)
    results: list[Evaluation] = []
    for mode in given.modes:
        results.append(Benchmark(mode, given.split).evaluate(policy, name=name))
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
    result = train(config, run, progress=sys.stderr.isatty())
    tsr = result["test"]["tsr"]
    print(f"{result['steps']} steps in {result['minutes']} minutes; best after {result['best']['steps']}")
    print(f"TSR on test episodes: {tsr['value']:.2f} [{tsr['low']:.2f}, {tsr['high']:.2f}]")
    print(f"all in {run / 'result.json'}")
    return 0


def _describe(given: argparse.Namespace) -> int:
    print(describe(), end="")
    return 0


if __name__ == "__main__":
    sys.exit(main())
