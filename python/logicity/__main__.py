"""`python -m logicity`: measure policies, train them, and print the tables of what they are trained in."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import gymnasium

from . import InputError, __version__
from .describe import describe
from .evaluation import Benchmark, Evaluation, Policy, table, write_json
from .modes import ENVIRONMENTS


def main(arguments: list[str] | None = None) -> int:
    """Run a command and return its exit status: 0, 1 for faulty input, 2 for faulty arguments, 130 if interrupted."""
    parser = _parser()
    given = parser.parse_args(arguments)
    try:
        return {"evaluate": _evaluate, "train": _train, "describe": _describe}[given.command](given)
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 130
    except ImportError as error:
        print(f"error: {error}\nhelp: pip install 'logicity[train]'", file=sys.stderr)
        return 1
    except (InputError, OSError, ValueError, gymnasium.error.Error) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m logicity", description="Policies for the city, from Python.")
    parser.add_argument("--version", action="version", version=__version__)
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    measure = commands.add_parser("evaluate", help="measure a policy on recorded episodes, as the paper does")
    measure.add_argument("--policy", required=True, help="oracle, random, or the .zip of a DQN, PPO or A2C model")
    measure.add_argument(
        "--modes", type=_modes, default="all", help=f"all (default), or any of {','.join(ENVIRONMENTS)}"
    )
    measure.add_argument("--split", choices=("train", "val", "test"), default="test", help="default: test")
    measure.add_argument("--json", type=Path, metavar="FILE", help="write the results, episode by episode")

    learn = commands.add_parser("train", help="train a model, or go on with a run that was killed")
    learn.add_argument("config", type=Path, help="for example configs/baselines/dqn-easy.yaml")
    learn.add_argument("--run", type=Path, metavar="FOLDER", help="of the run; default: runs/CONFIG-SEED")
    learn.add_argument("--seed", type=int, help="instead of the configuration's")

    commands.add_parser("describe", help="print tables of environments, observations and rewards, as Markdown")
    return parser


def _modes(text: str) -> list[str]:
    modes = list(ENVIRONMENTS) if text == "all" else text.split(",")
    for mode in modes:
        if mode not in ENVIRONMENTS:
            raise argparse.ArgumentTypeError(f"unknown mode `{mode}`: it is one of {', '.join(ENVIRONMENTS)}")
    return modes


def _evaluate(given: argparse.Namespace) -> int:
    policy: Policy = given.policy
    name = given.policy
    if policy not in ("oracle", "random"):
        from .train import load_model

        policy, name = load_model(given.policy), Path(given.policy).stem
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
    try:
        result = train(config, run, progress=sys.stderr.isatty())
    except ValueError as error:
        raise ValueError(f"{given.config}: {error}") from error
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
