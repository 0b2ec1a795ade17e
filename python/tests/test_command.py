"""The command `logicity`, which combines the Rust and the Python commands."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import sysconfig
import time
from pathlib import Path

import pytest
from conftest import COUNTING

from logicity.__main__ import main
from logicity.commands import _COMMANDS, SUMMARIES

COMMAND = str(Path(sysconfig.get_path("scripts")) / "logicity")


def logicity(*arguments: str, program: tuple[str, ...] = (COMMAND,)) -> subprocess.CompletedProcess[str]:
    return subprocess.run([*program, *arguments], capture_output=True, text=True, check=False)


def listed(help: str) -> dict[str, str]:
    lines = help.partition("Commands:\n")[2].partition("\n\n")[0].splitlines()
    return {name: summary.strip() for name, _, summary in (line.strip().partition(" ") for line in lines)}


def test_one_help_lists_the_commands_of_both_languages() -> None:
    top = listed(logicity("--help").stdout)
    groups = {name: listed(logicity(name, "--help").stdout) for name in {words[0] for words in SUMMARIES if words[1:]}}
    vap = groups["vap"]
    assert {"run", "check", "query", "infer", "vap", "lsp", "completions"} <= set(top) and {"make", "check"} <= set(vap)
    assert set(_COMMANDS) == set(SUMMARIES)
    for words, summary in SUMMARIES.items():
        assert (top if len(words) == 1 else groups[words[0]])[words[-1]] == summary
    assert all(summary for group in [top, *groups.values()] for summary in group.values())


@pytest.mark.parametrize("words", SUMMARIES)
def test_every_python_command_has_help(words: tuple[str, ...]) -> None:
    done = logicity(*words, "--help")
    assert done.returncode == 0 and done.stdout.startswith(f"usage: logicity {' '.join(words)} ")
    assert " ".join(done.stdout.split("\n\n")[1].split()) == f"{SUMMARIES[words]}."
    assert logicity(*words[:-1], "help", words[-1]).stdout == done.stdout


def test_the_module_is_the_same_command() -> None:
    module = (sys.executable, "-m", "logicity")
    for arguments in (["--help"], ["--version"], ["describe"], ["check", "no-such.dl"], ["trian"], []):
        one, other = logicity(*arguments), logicity(*arguments, program=module)
        assert (one.stdout, one.stderr, one.returncode) == (other.stdout, other.stderr, other.returncode)


def test_exit_codes(tmp_path: Path) -> None:
    (tmp_path / "faulty.dl").write_text("Stop(X) :- IsCar(X).\n")
    (tmp_path / "p.dl").write_text('.decl p(x: symbol)\n.output p\np("a").\n')
    for arguments, code, message in [
        (["--version"], 0, ""),
        (["query", str(tmp_path / "p.dl"), "-D", "-"], 0, ""),
        (["check", str(tmp_path / "faulty.dl")], 1, "unknown-predicate"),
        (["evaluate", "--policy", "foo", "--modes", "easy"], 2, "unknown policy `foo`"),
        (["evaluate", "--policy", "orcle", "--modes", "easy"], 2, "did you mean `oracle`?"),
        (["check", "no-such.dl"], 2, "no-such.dl"),
        (["grade", "no-such.jsonl"], 2, "error: cannot read `no-such.jsonl`: no such file"),
        (["vap", "baselines", "--train", "a", "--test", "b", "--epochs", "0"], 2, "expected an integer from 1"),
        (["vap", "webdataset", "a", "b", "--shard-size", "-1"], 2, "expected an integer from 1"),
        (["trian"], 2, "'train'"),
        (["vap", "cocos"], 2, "'coco'"),
        (["evaluate"], 2, "--policy"),
        ([], 2, "Usage: logicity <COMMAND>"),
    ]:
        done = logicity(*arguments)
        assert done.returncode == code and message in done.stderr, (arguments, done)


def test_completions_include_python_commands() -> None:
    script = logicity("completions", "bash").stdout
    assert "logicity,evaluate)" in script and "logicity__subcmd__vap,coco)" in script


def test_run_writes_its_files(tmp_path: Path) -> None:
    done = logicity("run", "expert", "--seed", "4", "--ticks", "3", "--out", str(tmp_path / "out"))
    assert done.returncode == 0 and "dense executor" in done.stdout
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        *(".logicity.json", "city.gif", "last.png", "trace.jsonl")
    }


def test_rust_commands_import_neither_numpy_nor_gymnasium() -> None:
    text = """
import sys
from logicity.__main__ import main
code = main(["--version"])
print(code, [name for name in ("numpy", "gymnasium", "torch", "argparse") if name in sys.modules])
"""
    done = logicity("-c", text, program=(sys.executable,))
    assert done.stdout.splitlines()[1] == "0 []" and done.stderr == ""


@pytest.mark.skipif(sys.platform == "win32", reason="pipes and signals of POSIX")
@pytest.mark.parametrize("arguments", [["describe"], ["completions", "bash"]])
def test_a_closed_pipe_is_not_an_error(arguments: list[str]) -> None:
    with subprocess.Popen([COMMAND, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout is not None and process.stderr is not None
        process.stdout.close()
        assert (process.stderr.read(), process.wait()) == (b"", 0)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="/dev/full")
@pytest.mark.parametrize(
    "arguments", [["--help"], ["--version"], ["describe"], ["evaluate", "--help"], ["vap", "coco", "-h"], ["codes"]]
)
def test_a_full_standard_output_is_reported(arguments: list[str]) -> None:
    with open("/dev/full", "wb") as full:
        done = subprocess.run([COMMAND, *arguments], stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert done.returncode == 2, done.stderr
    assert done.stderr.lower().startswith("error: cannot write to standard output: no space left on device")
    assert len(done.stderr.splitlines()) == 1


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="/dev/full")
@pytest.mark.parametrize("redirection", ["2>&-", "2>/dev/full"])
def test_lost_messages_change_neither_results_nor_the_exit_code(redirection: str, tmp_path: Path) -> None:
    command = f'"$0" evaluate --policy oracle --modes easy --split val --json result.json {redirection}'
    done = subprocess.run(["sh", "-c", command, COMMAND], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0 and (tmp_path / "result.json").exists()
    assert "oracle" in done.stdout and "wrote" not in done.stdout and done.stderr == ""


@pytest.mark.skipif(sys.platform == "win32", reason="descriptors of POSIX")
def test_no_file_takes_the_place_of_a_closed_standard_stream(tmp_path: Path) -> None:
    code = "from logicity.__main__ import main; main(['codes']); print(open('file', 'w').fileno())"
    words = ["sh", "-c", '"$0" -c "$1" <&- 2>&-', sys.executable, code]
    done = subprocess.run(words, cwd=tmp_path, stdout=subprocess.PIPE, text=True, check=True)
    assert int(done.stdout.splitlines()[-1]) > 2


@pytest.mark.skipif(sys.platform == "win32", reason="pipes and signals of POSIX")
def test_sigterm_ends_commands_in_rust(tmp_path: Path) -> None:
    (tmp_path / "count.dl").write_text(".decl n(x: number)\n.output n\nn(0).\nn(x + 1) :- n(x), x < 90000000.\n")
    query = ["query", str(tmp_path / "count.dl"), "-D", str(tmp_path / "out")]
    with subprocess.Popen([COMMAND, *query], stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        while not (tmp_path / "out").exists():
            assert process.poll() is None
            time.sleep(0.01)
        process.send_signal(signal.SIGTERM)
        try:
            process.communicate(timeout=30)
        finally:
            process.kill()
    assert process.returncode == 143
    assert not list((tmp_path / "out").glob("*.csv"))


def handle_ctrl_c() -> None:
    """Undo that a shell starts commands in the background with SIGINT ignored."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


@pytest.mark.skipif(sys.platform == "win32", reason="pipes and signals of POSIX")
def test_ctrl_c_ends_every_command(tmp_path: Path) -> None:
    (tmp_path / "count.dl").write_text(".decl n(x: number)\n.output n\nn(0).\nn(x + 1) :- n(x), x < 90000000.\n")
    (tmp_path / "slow.dl").write_text(COUNTING)
    (tmp_path / "slow.yaml").write_text("base: configs/easy.yaml\nrules: slow.dl\n")
    out = str(tmp_path / "out")
    for arguments, code in [
        # `query` does not handle the signal, so the default action ends the process.
        (["query", str(tmp_path / "count.dl"), "-D", "-"], -signal.SIGINT),
        # `run` handles the signal, and writes the completed ticks.
        (["run", "expert", "--ticks", "100000000", "--no-trace", "--out", out], 130),
        (["evaluate", "--policy", "random", "--modes", str(tmp_path / "slow.yaml")], 130),
    ]:
        with subprocess.Popen(
            [COMMAND, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, preexec_fn=handle_ctrl_c
        ) as process:
            time.sleep(2)
            process.send_signal(signal.SIGINT)
            try:
                process.communicate(timeout=30)
            finally:
                process.kill()
        assert process.returncode == code, arguments


def test_missing_files_are_reported_with_similar_names(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "answers.jsonl").write_text('{"id": "0", "answer": "A"}\n')
    typo = tmp_path / "anwsers.jsonl"
    assert main(["grade", str(typo)]) == 2
    help = f"help: did you mean `{tmp_path / 'answers.jsonl'}`?"
    assert capsys.readouterr().err == f"error: cannot read `{typo}`: no such file\n{help}\n"
    assert main(["grade", str(tmp_path / "answers.jsonl"), "--questions", str(tmp_path / "none.jsonl")]) == 2
    assert "name the questions with --questions" in capsys.readouterr().err


@pytest.mark.skipif(not hasattr(os, "fork"), reason="forks")
def test_a_process_forked_after_a_command_ends_on_sigterm() -> None:
    """A command off the main thread cannot restore the handlers of signals, whose thread a fork lacks."""
    program = (
        "import os, signal, sys, threading, time\n"
        "from logicity.__main__ import main\n"
        "worker = threading.Thread(target=main, args=(['codes'],))\n"
        "worker.start()\n"
        "worker.join()\n"
        "ready, begin = os.pipe()\n"
        "child = os.fork()\n"
        "if child == 0:\n"
        "    os.write(begin, b'.')\n"
        "    time.sleep(60)\n"
        "    os._exit(0)\n"
        "os.read(ready, 1)\n"
        "os.kill(child, signal.SIGTERM)\n"
        "print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), file=sys.stderr)\n"
    )
    begun = time.monotonic()
    ran = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=100)
    assert ran.returncode == 0 and ran.stderr.endswith("143\n"), ran.stderr
    assert time.monotonic() - begun < 50


def test_videos_use_the_encoder_of_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The command finds the program that `imageio_ffmpeg` brings, unless the user has one."""
    (tmp_path / "imageio_ffmpeg.py").write_text("def get_ffmpeg_exe():\n    return '/brought/ffmpeg'\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "imageio_ffmpeg", raising=False)
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setenv("LOGICITY_FFMPEG", "/own/ffmpeg")
    main(["run", "--video=a.mp4", "--help"])
    assert os.environ["LOGICITY_FFMPEG"] == "/own/ffmpeg"
    monkeypatch.delenv("LOGICITY_FFMPEG")
    main(["run", "--help"])
    assert "LOGICITY_FFMPEG" not in os.environ
    main(["run", "--video", "a.mp4", "--help"])
    assert os.environ["LOGICITY_FFMPEG"] == "/brought/ffmpeg"
    monkeypatch.delenv("LOGICITY_FFMPEG")
    program = tmp_path / "ffmpeg"
    program.write_text("#!/bin/sh\n")
    program.chmod(0o755)
    main(["run", "--video", "a.mp4", "--help"])
    assert "LOGICITY_FFMPEG" not in os.environ
