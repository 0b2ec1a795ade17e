"""The package as a whole: public names, docstrings and stubs."""

from __future__ import annotations

import copy
import pickle
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import logicity


def test_the_package_module_only_re_exports() -> None:
    assert set(logicity.__all__) <= set(dir(logicity))
    for name in logicity.__all__:
        home = getattr(getattr(logicity, name), "__module__", "logicity")
        assert home.startswith(("logicity", "typing")), name


def test_everything_public_is_documented() -> None:
    for name in logicity.__all__:
        thing = getattr(logicity, name)
        if isinstance(thing, type):
            assert thing.__doc__, name
            for member, value in vars(thing).items():
                if not member.startswith("_") and (callable(value) or isinstance(value, property)):
                    assert value.__doc__, f"{name}.{member}"


def test_missing_extras_are_named() -> None:
    # Hide the optional packages, so that the test does not depend on what is installed.
    text = """
import sys
for name in ("stable_baselines3", "pettingzoo", "minari", "pyarrow", "diffusers"):
    sys.modules[name] = None

import logicity
few = logicity.demonstrations("easy", 1)
for use in (
    lambda: logicity.icons.load_pipeline("model"),
    lambda: logicity.envs.sb3.make_vec_env,
    lambda: logicity.learn.learner_class("dqn"),
    lambda: logicity.envs.parallel,
    logicity.parallel_env,
    few.to_minari,
    lambda: few.to_parquet("steps.parquet"),
):
    try:
        use()
    except ImportError as error:
        print(str(error).partition("install ")[2])
"""
    done = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True)
    extras = ["icons", "learn", "learn", "pettingzoo", "pettingzoo", "offline", "offline"]
    expected = [f"the extra `{extra}`: pip install 'logicity[{extra}]'" for extra in extras]
    assert (done.stdout.splitlines(), done.stderr) == (expected, "")


@pytest.mark.parametrize(
    ("hidden", "module", "extra"),
    [
        *[
            (hidden, f"vap.{name}", "vap")
            for hidden in ("torch", "pydantic")
            for name in ("concepts", "training", "stages")
        ],
        *[(hidden, "experiments.vap", "vap") for hidden in ("torch", "pydantic")],
        ("pydantic", "learn.settings", "learn"),
        ("torch", "learn.nlm", "learn"),
    ],
)
def test_modules_of_an_extra_name_it(hidden: str, module: str, extra: str) -> None:
    text = f"import sys; sys.modules['{hidden}'] = None; import logicity.{module}"
    done = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True)
    assert done.returncode == 1
    assert f"install the extra `{extra}`: pip install 'logicity[{extra}]'" in done.stderr.splitlines()[-1]


def test_the_core_works_without_gymnasium() -> None:
    text = """
import sys
sys.modules["gymnasium"] = None
from logicity import *
import logicity

session = Session(Program('.decl p(x: number) .output p p(1).'))
session.commit()
print(session.rows("p"), infer({"entities": ["a"], "ego": "a"}, "easy")["egos"]["a"]["action"])
print(evaluate("oracle", "easy", "val").tsr.value)
for use in (lambda: logicity.envs.single, lambda: demonstrations("easy", 1), lambda: parallel_env("easy")):
    try:
        use()
    except ImportError as error:
        print(str(error).partition("install ")[2])
"""
    done = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True)
    extras = ["gym", "gym", "pettingzoo"]
    expected = [f"the extra `{extra}`: pip install 'logicity[{extra}]'" for extra in extras]
    assert (done.stdout.splitlines(), done.stderr) == (["[(1,)] Normal", "1.0", *expected], "")


@pytest.mark.parametrize(
    "order", ["gymnasium, logicity", "logicity, gymnasium", "logicity, gymnasium.envs.registration"]
)
def test_environments_are_registered_in_any_order_of_imports(order: str) -> None:
    # The registration hook removes itself and restores the loader of gymnasium.
    text = f"""
import {order}
import importlib, sys
assert logicity.envs.registration._RegisterOnImport not in map(type, sys.meta_path)
assert "exec_module" not in vars(gymnasium.__spec__.loader)
env = gymnasium.make("logicity/SPF-Easy-v0")
importlib.reload(gymnasium)
print(sum(name.startswith("logicity/") for name in gymnasium.registry), env.unwrapped.__class__.__name__)
"""
    done = subprocess.run([sys.executable, "-W", "error", "-c", text], capture_output=True, text=True)
    assert (done.stdout, done.stderr) == ("8 SPFEnv\n", "")


def test_gymnasium_is_imported_on_demand() -> None:
    text = "import sys, logicity; print([name for name in ('gymnasium', 'numpy', 'torch') if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True)
    assert (done.stdout, done.stderr) == ("[]\n", "")


def test_the_core_imports_only_numpy() -> None:
    """The modules of the core, and of `envs` those that need no extra. `benches/imports.py` measures their time."""
    text = """
import importlib, pkgutil, sys, logicity
names = [module.name for module in pkgutil.iter_modules(logicity.__path__) if not module.ispkg]
names += ["envs", "envs.config", "envs.layout", "envs.registration", "envs.views"]
known = {"logicity", "numpy", *sys.stdlib_module_names}
for name in names:
    if name not in ("_logicity", "__main__"):
        importlib.import_module(f"logicity.{name}")
        found = {each.partition(".")[0] for each, module in sys.modules.items() if module is not None} - known
        found = {each for each in found if not each.startswith("_")}
        if found:
            sys.exit(f"{name} imports {sorted(found)}")
print(len(names))
"""
    done = subprocess.run(
        [sys.executable, "-S", "-c", f"import sys; sys.path[:] = {sys.path!r}\n{text}"], capture_output=True, text=True
    )
    assert done.returncode == 0 and int(done.stdout) > 20, done.stderr


def test_lazy_names_equal_all() -> None:
    assert sorted(["__version__", *logicity._HOMES]) == logicity.__all__ == sorted(logicity.__all__)
    with pytest.raises(AttributeError, match="has no attribute 'sb4'"):
        getattr(logicity, "sb4")  # noqa: B009


def test_the_stubs_match_the_module(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "mypy.stubtest", "logicity._logicity"],
        capture_output=True,
        text=True,
        cwd=tmp_path,
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_types_of_controls(tmp_path: Path) -> None:
    text = """
from logicity import Action, Simulation

city = Simulation("easy")
by_name: dict[str, str] = {"Car_1": "Stop"}
by_action: dict[str, Action] = {"Car_1": "Stop"}
by_number: dict[int, int] = {0: 3}
by_either: dict[str | int, str | int] = {"Car_1": 3, 1: "Stop"}
for controls in (by_name, by_action):
    city.tick(controls)
city.tick(by_number)
city.tick(by_either)
city.tick({"Car_1": "Stop", 1: 3})
city.tick({})
city.tick(None)
city.tick({1.5: "Stop"})  # type: ignore[type-var]
city.tick({"Car_1": 1.5})  # type: ignore[dict-item]
"""
    (tmp_path / "use.py").write_text(text)
    checked = [sys.executable, "-m", "mypy", "--strict", "--warn-unused-ignores", "use.py"]
    done = subprocess.run(checked, capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr


@logicity.predicate("IsAnywhere")
def anywhere(state: logicity.CityState) -> Any:
    """Hold for all agents."""
    return np.ones(len(state), dtype=bool)


def public_objects() -> list[Any]:
    """Return an object of every public class."""
    program = logicity.Program(".decl p(x: number)\n.input p\n.decl q(x: number)\n.output q\nq(x) :- p(x).\n")
    session = logicity.Session(program)
    session.insert("p", [(1,)])
    change = session.commit()["q"]
    city = logicity.Simulation("easy")
    measured = logicity.evaluate("oracle", "easy", "val")
    shown = logicity.demonstrations("easy", 1)
    errors: list[Exception] = [
        kind("text", []) for kind in (logicity.InputError, logicity.LimitError, logicity.UnsupportedError)
    ]
    errors += [logicity.UntrustedError("text"), logicity.PredicateError("text")]
    vector, pair = np.zeros(1, dtype=np.int32), np.zeros((1, 2), dtype=np.int32)
    byte, flags = np.zeros(1, dtype=np.int8), np.zeros((1, 0), dtype=np.bool_)
    state = logicity.CityState(0, (1, 1), byte, pair, byte, pair, vector, vector, vector, vector, (), flags)
    predicate = program.predicates["p"]
    rules = logicity.induce(logicity.demonstrations("easy", 10))
    return [
        *[program, predicate, predicate.columns[0], session, change, change.added, session.explain("q(1)")],
        *[session.marginals("q"), anywhere, state],
        *[city, city.tick(), city.agents[0], city.explain(0), logicity.Inference("easy")],
        *[logicity.Benchmark("easy", "val"), measured, measured.episodes[0], measured.tsr, shown, shown[0], *errors],
        *[rules, rules.clauses[0], logicity.Oracle("rules/easy.dl"), logicity.RulePolicy.from_text(rules.text, "easy")],
        *logicity.shipped_policies().values(),
    ]


def test_every_public_object_can_be_copied_or_says_why_not() -> None:
    classes = {name for name in logicity.__all__ if isinstance(getattr(logicity, name), type)}
    typed = {name for name in classes if issubclass(getattr(logicity, name), dict)}
    objects = public_objects()
    ways: list[Callable[[Any], Any]] = [copy.deepcopy, lambda it: pickle.loads(pickle.dumps(it))]
    assert {type(one).__name__ for one in objects} == classes - typed
    for one in objects:
        for copied in ways:
            if isinstance(one, (logicity.Session, logicity.Change, logicity.Rows)):
                with pytest.raises(TypeError, match="cannot be pickled or copied, because .*: "):
                    copied(one)
            else:
                assert type(copied(one)) is type(one)
