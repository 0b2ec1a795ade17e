"""The trained policies that the package contains."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import pytest
from conftest import ROOT, needs

import logicity
from logicity import RulePolicy, __version__, evaluate, shipped_policies
from logicity.__main__ import main
from logicity.packed import SHIPPED
from logicity.rule_policy import saved_by

NAMES = sorted(shipped_policies())
#: In the package, there are at least the policies that the documents name.
assert {"spf-induce-easy-0", "spf-induce-expert-0", "spf-nlm-tuned-easy-1"} <= set(NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_shipped_policies_are_those_of_published_rows(name: str) -> None:
    policy = shipped_policies()[name]
    experiment = name.partition("-")[0]
    results = json.loads((ROOT / "results" / f"{experiment}.json").read_text(encoding="utf-8"))["rows"]
    rows = [
        row
        for row in results
        if (row["learner"], row["mode"], row["seed"], row["variant"]) == (policy.learner, policy.mode, policy.seed, "")
    ]
    assert rows and {row["sha256"] for row in rows} == {policy.sha256}
    assert {row["command"] for row in rows} == {policy.command}
    assert policy.measures == {
        row["evaluation"]: {key: value["value"] for key, value in row["measures"].items() if isinstance(value, dict)}
        for row in rows
    }
    if policy.path.suffix == ".dl":
        assert policy.extra is None and hashlib.sha256(policy.path.read_bytes()).hexdigest() == policy.sha256
    else:
        # Without the two variables of `make policies`, the network depends on the processor.
        assert policy.extra == "learn" and "processor" in rows[0]["versions"]
        needs("torch", "learn")
        from logicity.learn import load_policy
        from logicity.learn.storage import policy_hash

        assert policy_hash(load_policy(policy.path).policy) == ("weights", policy.sha256)


def test_checksums_of_shipped_policies_hold() -> None:
    lines = (SHIPPED / "SHA256SUMS").read_text(encoding="utf-8").splitlines()
    listed = {name: sha256 for sha256, name in (line.split("  ") for line in lines)}
    files = {path.relative_to(SHIPPED).as_posix(): path for path in SHIPPED.rglob("*") if path.is_file()}
    del files["SHA256SUMS"]
    assert listed == {name: hashlib.sha256(path.read_bytes()).hexdigest() for name, path in files.items()}
    assert sum(path.stat().st_size for path in files.values()) < 1_000_000


@pytest.mark.parametrize("name", [name for name in NAMES if "-induce-" in name])
def test_training_gives_the_shipped_rules(name: str, tmp_path: Path) -> None:
    """`make policies` also trains the networks, which take longer."""
    needs("stable_baselines3", "learn")
    from logicity.learn import TrainConfig, learner_class

    policy = shipped_policies()[name]
    config = TrainConfig.load(ROOT / "configs" / "baselines" / f"induce-{policy.mode}.yaml", seed=policy.seed)
    learner = learner_class("induce")(config)
    learner.fit(1, lambda: None)
    text = learner.policy().rules()
    assert text is not None
    # The rules name the version that learned them.
    released = json.loads((SHIPPED / "policies.json").read_text(encoding="utf-8"))["version"]
    assert text.replace(f"learned by logicity {__version__} ", f"learned by logicity {released} ") == (
        policy.path.read_text(encoding="utf-8")
    )


def test_a_shipped_policy_is_evaluated_by_its_name(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    report = tmp_path / "report.json"
    assert main(["evaluate", "--policy", "spf-induce-expert-0", "--json", str(report)]) == 0
    (row,) = json.loads(report.read_text(encoding="utf-8"))
    policy = shipped_policies()["spf-induce-expert-0"]
    assert (row["policy"], row["mode"]) == (policy.name, "expert")
    assert {name: row[name]["value"] for name in policy.measures["test"]} == policy.measures["test"]
    # In another mode, too.
    capsys.readouterr()
    assert main(["evaluate", "--policy", "spf-induce-easy-0", "--modes", "hard", "--split", "val"]) == 0
    assert "spf-induce-easy-0  hard" in capsys.readouterr().out
    assert main(["evaluate", "--policy", "spf-induce-easy-1"]) == 2
    error = capsys.readouterr().err
    assert "a name that `logicity policies` lists" in error and "did you mean `spf-induce-easy-0`?" in error


def test_a_path_has_precedence_over_a_shipped_policy(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("spf-induce-easy-0").mkdir()
    assert main(["evaluate", "--policy", "spf-induce-easy-0"]) == 2
    assert "a folder without a file `best.*`" in capsys.readouterr().err


def test_the_command_lists_shipped_policies(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    report = tmp_path / "policies.json"
    assert main(["policies", "--json", str(report)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].split() == ["policy", "mode", "learner", "extra", "measured", "on", "TSR", "DSR", "Score"]
    by_name = {line.split()[0]: line.split() for line in lines[1:-2]}
    assert sorted(by_name) == NAMES and lines[-1].endswith(str(SHIPPED))
    assert by_name["spf-induce-expert-0"] == "spf-induce-expert-0 expert induce - test 1.00 1.00 4.31".split()
    assert by_name["spf-nlm-tuned-easy-1"] == "spf-nlm-tuned-easy-1 easy nlm-tuned learn test 1.00 1.00 8.62".split()
    listed = json.loads(report.read_text(encoding="utf-8"))
    assert [(each["name"], Path(each["path"]).is_file()) for each in listed] == [(name, True) for name in NAMES]


def test_shipped_rules_drive_from_python() -> None:
    policy = shipped_policies()["spf-induce-medium-0"]
    assert saved_by(policy.path) == {"algorithm": policy.learner, "mode": policy.mode}
    result = evaluate(RulePolicy(policy.path, policy.mode), policy.mode, batched=True)
    assert result.tsr.value == policy.measures["test"]["tsr"]
    assert logicity.ShippedPolicy is type(policy)
