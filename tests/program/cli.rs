//! The command line: runs the binary on files and checks its output and exit codes.

use flate2::Compression;
use flate2::read::GzDecoder;
use flate2::write::GzEncoder;
use serde_json::Value;
use std::fs;
use std::io::{Read, Write};
use std::path::Path;
use std::process::{Command, Output, Stdio};

/// Runs the program in the repository's folder.
pub fn logicity<const N: usize>(arguments: [&str; N]) -> Output {
    run(&arguments, b"")
}

fn with_input<const N: usize>(arguments: [&str; N], input: &[u8]) -> Output {
    run(&arguments, input)
}

pub fn run(arguments: &[&str], input: &[u8]) -> Output {
    let mut process = Command::new(env!("CARGO_BIN_EXE_logicity"))
        .args(arguments)
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut stdin = process.stdin.take().unwrap();
    let input = input.to_owned();
    // The program may end before it has read all input.
    let writer = std::thread::spawn(move || drop(stdin.write_all(&input)));
    let output = process.wait_with_output().unwrap();
    writer.join().unwrap();
    output
}

pub fn code(output: &Output) -> i32 {
    output.status.code().expect("no signal ended it")
}

pub fn out(output: &Output) -> String {
    String::from_utf8(output.stdout.clone()).unwrap()
}

pub fn err(output: &Output) -> String {
    String::from_utf8(output.stderr.clone()).unwrap()
}

/// Asserts that a command succeeded.
fn succeeds(output: &Output) {
    assert_eq!(code(output), 0, "{}", err(output));
}

/// Asserts that a command failed with this exit code and printed all of `words`, without a panic.
pub fn fails(output: &Output, exit: i32, words: &[&str]) {
    let said = err(output);
    assert_eq!(code(output), exit, "{said}");
    assert!(!said.contains("panicked"), "{said}");
    for word in words {
        assert!(said.contains(word), "`{word}` is missing in:\n{said}");
    }
}

pub fn write(folder: &Path, name: &str, text: impl AsRef<[u8]>) -> String {
    let path = folder.join(name);
    fs::write(&path, text).unwrap();
    path.to_str().unwrap().to_owned()
}

#[test]
fn run_writes_a_trace_an_animation_and_a_picture() {
    let folder = tempfile::tempdir().unwrap();
    let target = folder.path().join("deep/er");
    let output = logicity([
        "run",
        "configs/expert.yaml",
        "--ticks",
        "20",
        "--out",
        target.to_str().unwrap(),
    ]);
    assert_eq!(code(&output), 0, "{}", err(&output));
    let summary = out(&output);
    for word in [
        "20 ticks",
        "360 decisions",
        "decisions per second",
        "pedestrians",
        "Stop",
        "expert.dl:",
        "city.gif",
    ] {
        assert!(summary.contains(word), "`{word}` is missing in:\n{summary}");
    }
    let trace = fs::read_to_string(target.join("trace.jsonl")).unwrap();
    let lines: Vec<Value> = trace.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(lines.len(), 21);
    assert_eq!(lines[0]["config"], "expert");
    assert_eq!(lines[0]["config_hash"].as_str().unwrap().len(), 64);
    assert_eq!(lines[0]["rules_hash"].as_str().unwrap().len(), 64);
    assert_eq!(lines[0]["agents"].as_array().unwrap().len(), 18);
    for pair in lines[1..].windows(2) {
        for (before, after) in pair[0]["agents"]
            .as_array()
            .unwrap()
            .iter()
            .zip(pair[1]["agents"].as_array().unwrap())
        {
            assert_eq!(before["next"], after["at"]);
        }
    }
    assert!(fs::read(target.join("city.gif")).unwrap().starts_with(b"GIF89a"));
    assert!(fs::read(target.join("last.png")).unwrap().starts_with(b"\x89PNG"));
    let mut names: Vec<_> = (fs::read_dir(&target).unwrap())
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    let written = [".logicity.json", "city.gif", "last.png", "trace.jsonl"];
    assert_eq!(names, written, "no temporary file remains");
}

/// Returns width and height of a PNG.
fn size_of_png(path: &Path) -> [u32; 2] {
    let bytes = fs::read(path).unwrap();
    [16, 20].map(|at| u32::from_be_bytes(bytes[at..at + 4].try_into().unwrap()))
}

#[test]
fn a_cropped_run_shows_where_agents_are() {
    let folder = tempfile::tempdir().unwrap();
    let sizes = |name: &str, options: &[&str]| {
        let target = folder.path().join(name);
        let ticks = ["run", "expert", "--ticks", "3", "--out", target.to_str().unwrap()];
        let output = run(&[&ticks, options].concat(), b"");
        assert_eq!(code(&output), 0, "{}", err(&output));
        let gif = fs::read(target.join("city.gif")).unwrap();
        let sides = [6, 8].map(|at| u32::from(u16::from_le_bytes([gif[at], gif[at + 1]])));
        let png = size_of_png(&target.join("last.png"));
        assert_eq!(sides, png, "{name}");
        png
    };
    let whole = sizes("whole", &["--scale", "2"]);
    let part = sizes("part", &["--scale", "2", "--crop"]);
    assert!(part[0] <= whole[0] && part[1] <= whole[1], "{part:?} {whole:?}");
    let large = sizes("large", &["--scale", "8", "--crop"]);
    assert!(large[0] < 4 * whole[0], "{large:?} {whole:?}");
    assert_ne!(large, sizes("all", &["--scale", "8"]));
    for (options, word) in [
        (vec!["--scale", "0"], "from 1 to 64"),
        (vec!["--scale", "64"], "use a smaller `--scale`, or `--crop`"),
        (vec!["--crop", "--no-pictures"], "have no effect with"),
    ] {
        let target = folder.path().join("none");
        let ticks = ["run", "expert", "--ticks", "1", "--out", target.to_str().unwrap()];
        let output = run(&[&ticks, options.as_slice()].concat(), b"");
        assert_eq!(code(&output), 2, "{}", err(&output));
        assert!(err(&output).contains(word), "{}", err(&output));
    }
}

#[cfg(unix)]
#[test]
fn an_interrupted_run_keeps_its_ticks() {
    let folder = tempfile::tempdir().unwrap();
    let process = Command::new(env!("CARGO_BIN_EXE_logicity"))
        .args(["run", "expert", "--ticks", "1000000000", "--out"])
        .arg(folder.path())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    // The program creates the files before the first tick, so the test interrupts once they exist.
    while fs::read_dir(folder.path()).unwrap().count() < 3 {
        std::thread::sleep(std::time::Duration::from_millis(10));
    }
    let kill = Command::new("kill")
        .args(["-INT", &process.id().to_string()])
        .status()
        .unwrap();
    assert!(kill.success());
    let output = process.wait_with_output().unwrap();
    assert_eq!(code(&output), 130, "{}", err(&output));
    assert!(out(&output).contains("interrupted"), "{}", out(&output));
    let mut names: Vec<_> = fs::read_dir(folder.path())
        .unwrap()
        .map(|entry| entry.unwrap().file_name())
        .collect();
    names.sort();
    assert_eq!(names, [".logicity.json", "city.gif", "last.png", "trace.jsonl"]);
    let trace = fs::read_to_string(folder.path().join("trace.jsonl")).unwrap();
    assert!(trace.lines().all(|line| serde_json::from_str::<Value>(line).is_ok()));
}

#[test]
fn the_same_seed_gives_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let run = |name: &str, seed: &str| {
        let target = folder.path().join(name);
        let target = target.to_str().unwrap();
        let output = logicity([
            "run",
            "configs/expert.yaml",
            "--ticks",
            "60",
            "--seed",
            seed,
            "--no-pictures",
            "--out",
            target,
        ]);
        assert_eq!(code(&output), 0, "{}", err(&output));
        fs::read(Path::new(target).join("trace.jsonl")).unwrap()
    };
    assert_eq!(run("a", "7"), run("b", "7"));
    assert_ne!(run("a", "7"), run("c", "8"));
}

/// Every tick of a trace, written as a scene, gets the same decisions from `infer`.
#[test]
fn a_trace_can_be_replayed_through_infer() {
    let folder = tempfile::tempdir().unwrap();
    let target = folder.path().to_str().unwrap();
    let output = logicity([
        "run",
        "configs/expert.yaml",
        "--ticks",
        "40",
        "--seed",
        "3",
        "--no-pictures",
        "--out",
        target,
    ]);
    assert_eq!(code(&output), 0, "{}", err(&output));
    let trace = fs::read_to_string(folder.path().join("trace.jsonl")).unwrap();
    let mut lines = trace.lines().map(|line| serde_json::from_str::<Value>(line).unwrap());
    let header = lines.next().unwrap();
    let ticks: Vec<Value> = lines.collect();
    let scenes: String = ticks
        .iter()
        .map(|tick| {
            let mut agents = header["agents"].clone();
            for (agent, state) in agents
                .as_array_mut()
                .unwrap()
                .iter_mut()
                .zip(tick["agents"].as_array().unwrap())
            {
                agent["at"] = state["at"].clone();
                agent["heading"] = state["heading"].clone();
            }
            // Once with the recorded draws, once drawing them again.
            let given = serde_json::json!({ "map": header["map"], "agents": agents, "given": tick["given"] });
            let drawn = serde_json::json!({ "map": header["map"], "agents": agents, "tick": tick["tick"] });
            format!("{given}\n{drawn}\n")
        })
        .collect();
    let output = with_input(
        ["infer", "--config", "configs/expert.yaml", "--seed", "3"],
        scenes.as_bytes(),
    );
    assert_eq!(code(&output), 0, "{}", err(&output));
    let text = out(&output);
    assert_eq!(text.lines().count(), 2 * ticks.len());
    let twice = ticks.iter().flat_map(|tick| [tick, tick]);
    for (answer, tick) in text.lines().zip(twice) {
        let answer: Value = serde_json::from_str(answer).unwrap();
        for (agent, state) in header["agents"]
            .as_array()
            .unwrap()
            .iter()
            .zip(tick["agents"].as_array().unwrap())
        {
            let ego = &answer["egos"][agent["id"].as_str().unwrap()];
            assert_eq!((&ego["action"], &ego["derived"]), (&state["action"], &state["derived"]));
        }
    }
}

#[test]
fn explain_shows_why_and_why_not() {
    let folder = tempfile::tempdir().unwrap();
    let target = folder.path().to_str().unwrap();
    let output = logicity([
        "run",
        "configs/expert.yaml",
        "--no-pictures",
        "--ticks",
        "30",
        "--out",
        target,
    ]);
    assert_eq!(code(&output), 0, "{}", err(&output));
    let trace = folder.path().join("trace.jsonl");
    let trace = trace.to_str().unwrap();

    let output = logicity(["explain", trace, "--tick", "5", "--agent", "Car_3"]);
    assert_eq!((code(&output), err(&output).as_str()), (0, ""));
    assert!(out(&output).starts_with("tick 5: Car_3 at [53, 41], heading Right: Stop\n\nStop(\"Car_3\")  by S1: "));
    let output = logicity(["explain", trace, "--agent", "Car_3", "--why-not", "Normal", "--json"]);
    let printed: Value = serde_json::from_str(&out(&output)).unwrap();
    assert_eq!(
        (&printed["tick"], &printed["agent"]),
        (&Value::from(29), &Value::from("Car_3"))
    );
    let node = &printed["explanations"][0]["nodes"][0];
    assert!(
        node["holds"] == "Normal(Car_3)" || node["absent"] == "Normal(Car_3)",
        "{printed}"
    );

    fails(
        &logicity(["explain", trace, "--tick", "30", "--agent", "Car_3"]),
        2,
        &["no tick 30", "0 to 29"],
    );
    fails(
        &logicity(["explain", trace, "--agent", "Car3"]),
        2,
        &["no agent `Car3`", "did you mean `Car_3`", "Pedestrian_8"],
    );
    fails(
        &logicity(["explain", trace, "--agent", "Car_3", "--why-not", "Fly"]),
        2,
        &["unknown-predicate", "no predicate `Fly` is declared", "--why-not:1:1"],
    );
    fails(
        &logicity(["explain", "no/such.jsonl", "--agent", "Car_3"]),
        2,
        &["no/such.jsonl"],
    );
    fails(
        &logicity(["explain", trace, "--agent", "Car_3", "--config", "configs/easy.yaml"]),
        1,
        &["trace-mismatch", "configs/easy.yaml", "--config"],
    );
    fails(
        &logicity(["explain", trace, "--agent", "Car_3", "--rules", "rules/hard.dl"]),
        1,
        &["trace-mismatch", "rules/hard.dl", "--rules"],
    );
}

#[test]
fn hostile_traces_are_errors() {
    let folder = tempfile::tempdir().unwrap();
    let target = folder.path().to_str().unwrap();
    let output = logicity([
        "run",
        "configs/easy.yaml",
        "--no-pictures",
        "--ticks",
        "1",
        "--out",
        target,
    ]);
    assert_eq!(code(&output), 0, "{}", err(&output));
    let good = fs::read_to_string(folder.path().join("trace.jsonl")).unwrap();
    let (header, tick) = good.split_once('\n').unwrap();
    let at = |cell: &str| {
        let mut tick: Value = serde_json::from_str(tick).unwrap();
        tick["agents"][0]["at"] = serde_json::from_str(cell).unwrap();
        format!("{header}\n{tick}\n")
    };
    let moved = {
        let mut tick: Value = serde_json::from_str(tick).unwrap();
        tick["agents"][0]["derived"] = serde_json::json!(["Slow"]);
        format!("{header}\n{tick}\n")
    };
    let drawn = {
        let mut tick: Value = serde_json::from_str(tick).unwrap();
        tick["given"] = serde_json::json!({ "CollidingClose": [["Car_99", "Car_1"]] });
        format!("{header}\n{tick}\n")
    };
    for (text, words) in [
        (String::new(), ["empty", ""]),
        ("[".repeat(100_000), ["bad.jsonl:1", "not the header"]),
        (format!("{header}\n{{\"tick\":0"), ["bad.jsonl:2", "not a tick"]),
        (
            format!("{header}\n{{\"tick\":0,\"agents\":[]}}"),
            ["bad.jsonl:2", "0 agents"],
        ),
        (at("[-1, 5]"), ["bad.jsonl:2", "not on the map"]),
        (at("[1, 99999999999]"), ["bad.jsonl:2", "not a tick"]),
        (
            header.replace("\"Pedestrian_2\"", "\"Car_1\""),
            ["bad.jsonl:1", "twice"],
        ),
        (
            header.replacen("\"type\":\"Pedestrian\"", "\"type\":\"Bird\"", 1),
            ["bad.jsonl:1", "Bird"],
        ),
        (
            header.replace("\"Pedestrian\"", "\"Bird\""),
            ["in the configuration of the trace", "Bird"],
        ),
        (
            header.replace("\"version\":2", "\"version\":9"),
            ["bad.jsonl:1", "version 9"],
        ),
        (drawn, ["bad.jsonl:2", "CollidingClose"]),
        (moved, ["bad.jsonl:2", "trace-mismatch"]),
    ] {
        let path = write(folder.path(), "bad.jsonl", &text);
        fails(&logicity(["explain", &path, "--agent", "Car_1"]), 1, &words);
    }
    let path = write(folder.path(), "bad.jsonl", format!("{header}\n"));
    fails(&logicity(["explain", &path, "--agent", "Car_1"]), 2, &["no ticks"]);
    let path = write(folder.path(), "bad.jsonl", [header.as_bytes(), b"\n\xff\n"].concat());
    fails(&logicity(["explain", &path, "--agent", "Car_1"]), 1, &["not-text"]);
}

#[test]
fn a_page_does_not_overwrite_its_trace() {
    let folder = tempfile::tempdir().unwrap();
    let target = folder.path().to_str().unwrap();
    let run = ["run", "easy", "--no-pictures", "--ticks", "3", "--out", target];
    assert_eq!(code(&logicity(run)), 0);
    let trace = folder.path().join("trace.jsonl");
    let before = fs::read(&trace).unwrap();
    let output = logicity(["view", trace.to_str().unwrap(), "-o", trace.to_str().unwrap()]);
    assert_eq!(code(&output), 2);
    assert!(err(&output).contains("this command reads it"), "{}", err(&output));
    assert_eq!(fs::read(&trace).unwrap(), before);
    let copy = write(folder.path(), "copy.jsonl", &before);
    let output = logicity(["view", &copy, trace.to_str().unwrap(), "-o", trace.to_str().unwrap()]);
    fails(&output, 2, &["this command reads it"]);
    assert_eq!(fs::read(&trace).unwrap(), before);
}

#[test]
fn two_traces_are_compared() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let trace = |config: &str, name: &str, seed: &str| {
        let options = ["--no-pictures", "--ticks", "4", "--seed", seed, "--out", &path(name)];
        let output = run(&[&["run", config][..], &options].concat(), b"");
        assert_eq!(code(&output), 0, "{}", err(&output));
        path(&format!("{name}/trace.jsonl"))
    };
    let easy = trace("easy", "easy", "0");
    let (hard, other) = (trace("hard", "hard", "0"), trace("easy", "other", "1"));
    let page = path("page.html");
    let view = |traces: &[&str], options: &[&str]| run(&[&["view", "-o", &page][..], traces, options].concat(), b"");
    let said = out(&view(&[&easy, &other], &[]));
    assert!(
        said.starts_with("the runs differ in ") && said.ends_with("page.html\n"),
        "{said}"
    );
    assert!(
        fs::read_to_string(&page)
            .unwrap()
            .contains("<title>easy and other</title>")
    );
    let said = out(&view(
        &[&easy, &easy],
        &["--from", "1", "--config", "easy", "--rules", "rules/easy.dl"],
    ));
    assert!(said.starts_with("the runs agree in all "), "{said}");
    assert!(fs::read_to_string(&page).unwrap().contains("<title>A and B</title>"));
    fs::remove_file(&page).unwrap();
    fails(
        &view(&[&easy, &hard], &[]),
        1,
        &["trace-mismatch", "different agents", "in `hard`"],
    );
    let twice = ["--config", "easy", "--config", "easy"];
    fails(&view(&[&easy], &twice), 2, &["--config is given 2 times for 1 trace"]);
    fails(&view(&[&easy, &easy, &easy], &[]), 2, &["TRACE"]);
    fails(&view(&[], &[]), 2, &["TRACE"]);
    assert!(!Path::new(&page).exists());
}

#[test]
fn the_summary_reports_deadlocks() {
    let folder = tempfile::tempdir().unwrap();
    let target = folder.path().to_str().unwrap();
    let run = |ticks: &str, seed: &str| {
        let output = logicity([
            "run",
            "configs/expert.yaml",
            "--no-pictures",
            "--ticks",
            ticks,
            "--seed",
            seed,
            "--out",
            target,
        ]);
        assert_eq!(code(&output), 0, "{}", err(&output));
        out(&output)
    };
    let summary = run("300", "6");
    for words in [
        "stuck (no move in the last 50 ticks): Car_3",
        "starving: Car_3 (S1, S7, S2)",
    ] {
        assert!(summary.contains(words), "`{words}` is missing in:\n{summary}");
    }
    assert!(!summary.contains("deadlock"), "{summary}");
    let summary = run("300", "10");
    for words in [
        "deadlock since tick 5: Car_6 (S7) -> Car_9 (S4) -> Car_10 (S7) -> Car_6",
        "behind: Car_5 (S7) -> Car_10",
    ] {
        assert!(summary.contains(words), "`{words}` is missing in:\n{summary}");
    }
}

#[test]
fn check_prints_the_strata() {
    let output = logicity(["check", "rules/expert.dl"]);
    assert_eq!((code(&output), err(&output).as_str()), (0, ""));
    assert!(out(&output).contains("Stop < Slow < Fast < Normal"), "{}", out(&output));
}

#[test]
fn check_reports_conflicts() {
    let output = logicity(["check", "rules/expert.dl"]);
    assert!(out(&output).ends_with("  conflicts: none\n"), "{}", out(&output));
    let output = logicity(["check", "rules/vap-hard.dl"]);
    let said = err(&output);
    assert_eq!((code(&output), said.matches("warning").count()), (0, 1), "{said}");
    for words in [
        "warning[action-conflict]: the rules can derive Slow and Fast for one agent, and Slow wins",
        "vap-hard.dl:48:1",
    ] {
        assert!(said.contains(words), "{said}");
    }
    assert!(
        out(&output).contains("conflicts: Slow and Fast can be derived together, and Slow wins"),
        "{}",
        out(&output)
    );
    let output = logicity(["check", "--json", "rules/vap-hard.dl"]);
    let line: Value = serde_json::from_str(&out(&output)).unwrap();
    let together: Vec<&Value> = (line["conflicts"].as_array().unwrap().iter())
        .filter(|conflict| conflict["finding"] == "together")
        .collect();
    assert_eq!(together.len(), 1);
    assert_eq!(together[0]["scene"]["ego"], "e0");
    assert!(together[0]["clauses"][1]["doc"].as_str().unwrap().starts_with("VF4"));
    assert_eq!(together[0]["winner"], "Slow");
    // The order of the configuration decides: Stop comes first by default, and last in the picture modes.
    let both = "tests/fixtures/diagnostics/action-conflict.dl";
    for (more, wins) in [
        (&[][..], "Stop"),
        (&["--config", "easy"], "Stop"),
        (&["--config", "vap-hard"], "Slow"),
    ] {
        let output = run(&[&["check", both], more].concat(), b"");
        assert!(err(&output).contains(&format!("and {wins} wins")), "{}", err(&output));
        assert!(out(&output).contains(&format!("and {wins} wins")), "{}", out(&output));
    }
    fails(&logicity(["check", both, "--config", "no-such"]), 2, &["no-such"]);
    // Programs without actions have no conflicts.
    let folder = tempfile::tempdir().unwrap();
    let rules = write(
        folder.path(),
        "a.dl",
        ".decl a(x: number)\n.input a\n.decl b(x: number)\nb(x) :- a(x).\n",
    );
    assert!(!out(&logicity(["check", &rules])).contains("conflicts"));
}

/// The summary counts the decisions with several derived actions, as the trace lists them, and names the winner.
#[test]
fn run_counts_conflicts() {
    let folder = tempfile::tempdir().unwrap();
    let target = folder.path().to_str().unwrap();
    let rules = write(
        folder.path(),
        "both.dl",
        ".include \"vocabulary.dl\"\nStop(X) :- CollidingClose(X, Y).\nStop(X) :- IsAtInter(X).\nSlow(X) :- IsCar(X).\n",
    );
    for (config, wins, loses) in [("expert", "Stop", "Slow"), ("vap-hard", "Slow", "Stop")] {
        let output = logicity([
            "run",
            config,
            "--rules",
            &rules,
            "--ticks",
            "30",
            "--no-pictures",
            "--out",
            target,
        ]);
        assert_eq!(code(&output), 0, "{}", err(&output));
        let trace = fs::read_to_string(folder.path().join("trace.jsonl")).unwrap();
        let ticks = trace
            .lines()
            .skip(1)
            .map(|line| serde_json::from_str::<Value>(line).unwrap());
        let (mut count, mut example) = (0, None);
        for tick in ticks {
            for (agent, state) in tick["agents"].as_array().unwrap().iter().enumerate() {
                if state["derived"].as_array().unwrap().len() > 1 {
                    assert_eq!(state["action"], wins);
                    count += 1;
                    example = Some((tick["tick"].to_string(), agent));
                }
            }
        }
        assert!(count > 1);
        let summary = out(&output);
        let line = format!("conflicts: {wins} won over {loses} in {count} decisions\n");
        assert!(summary.contains(&line), "{line}{summary}");

        // The explanation of such a decision names the winner, too.
        let header: Value = serde_json::from_str(trace.lines().next().unwrap()).unwrap();
        let (tick, agent) = example.unwrap();
        let name = header["agents"][agent]["id"].as_str().unwrap();
        let trace = folder.path().join("trace.jsonl");
        let output = logicity(["explain", trace.to_str().unwrap(), "--tick", &tick, "--agent", name]);
        let text = out(&output);
        assert!(
            text.contains(&format!("derived: Slow, Stop; {wins} is first in the configured order")),
            "{text}"
        );
        // Its atoms can be copied into rules.
        assert!(text.contains(&format!("\n{wins}(\"{name}\")  by ")), "{text}");
    }
}

#[test]
fn check_reports_coverage() {
    let folder = tempfile::tempdir().unwrap();
    let target = folder.path().to_str().unwrap();
    let output = logicity([
        "run",
        "configs/easy.yaml",
        "--no-pictures",
        "--ticks",
        "60",
        "--out",
        target,
    ]);
    assert_eq!(code(&output), 0, "{}", err(&output));
    let summary = out(&output);
    let trace = folder.path().join("trace.jsonl");
    let trace = trace.to_str().unwrap();
    let output = logicity(["check", "--coverage", trace]);
    assert_eq!((code(&output), err(&output).as_str()), (0, ""));
    assert!(out(&output).contains("coverage: 60 ticks of"), "{}", out(&output));
    let output = logicity(["check", "--json", "--coverage", trace]);
    let line: Value = serde_json::from_str(&out(&output)).unwrap();
    let clauses = line["coverage"]["clauses"].as_array().unwrap();
    // The summary of the run counts the same firings.
    for (clause, printed) in clauses
        .iter()
        .zip(summary.lines().skip_while(|line| !line.contains("fired")).skip(1))
    {
        assert_eq!(printed.split_whitespace().next().unwrap(), clause["fired"].to_string());
    }

    // `explain --clause` lists each of these firings, and agrees with the decision of every tick that it names.
    for clause in clauses {
        let doc = clause["clause"]["doc"].as_str().unwrap();
        let label = doc.split(':').next().unwrap();
        let output = logicity(["explain", "--json", trace, "--clause", label]);
        assert_eq!(code(&output), 0, "{}", err(&output));
        let listed: Value = serde_json::from_str(&out(&output)).unwrap();
        assert_eq!(listed["ticks"], 60);
        let [found] = listed["clauses"].as_array().unwrap().as_slice() else {
            panic!("{listed}")
        };
        for key in ["clause", "fired", "ticks"] {
            assert_eq!(found[key], clause[key], "{label}");
        }
        let Some(row) = found["rows"].get(0) else { continue };
        let run = row["ticks"][0].as_array().unwrap();
        let (first, last) = (run[0].to_string(), run[1].as_u64().unwrap());
        let fact = row["fact"].as_str().unwrap();
        let agent = fact.split('"').nth(1).unwrap();
        let output = logicity(["explain", trace, "--clause", label, "--agent", agent, "--tick", &first]);
        assert_eq!(
            out(&output).lines().skip(1).collect::<Vec<_>>(),
            [&format!("fired 1 time in tick {first}"), &format!("  {fact}")]
        );
        if last < 59 {
            let after = (last + 1).to_string();
            let output = logicity(["explain", trace, "--clause", label, "--agent", agent, "--tick", &after]);
            assert!(out(&output).contains("fired 0 times in tick"), "{}", out(&output));
        }
    }
    let first = &clauses[0]["clause"];
    let file = first["file"].as_str().unwrap().rsplit('/').next().unwrap();
    let place = format!("{file}:{}", first["line"]);
    let output = logicity(["explain", trace, "--clause", &place]);
    assert_eq!(code(&output), 0, "{}", err(&output));
    assert!(out(&output).contains(&format!("[{place}]")), "{}", out(&output));
    fails(
        &logicity(["explain", trace, "--clause", "s1"]),
        2,
        &["no clause is called `s1`", "did you mean `S1`?"],
    );
    fails(
        &logicity(["explain", trace, "--clause", "S1", "--why", "Stop"]),
        2,
        &["cannot be used with"],
    );

    // Of two equivalent literals, neither matters.
    let rules = write(
        folder.path(),
        "mine.dl",
        ".include \"vocabulary.dl\"\nStop(X) :- IsCar(X), Not(IsPedestrian(X)), IsAtInter(X), CollidingClose(Y, X), Y != X.\n",
    );
    let output = logicity(["check", "--json", "--coverage", trace, &rules]);
    assert_eq!(code(&output), 0, "{}", err(&output));
    let line: Value = serde_json::from_str(&out(&output)).unwrap();
    let clause = &line["coverage"]["clauses"][1];
    assert!(clause["clause"]["file"].as_str().unwrap().ends_with("mine.dl"));
    let idle = clause["never_mattered"].as_array().unwrap();
    assert!(idle.contains(&Value::from("Y != X")), "{idle:?}");
    assert!(!idle.contains(&Value::from("IsAtInter(X)")), "{idle:?}");
    // Conflicts are between the actions of the configuration in the trace. What no agent of a kind can take is none.
    let config = write(
        folder.path(),
        "city.yaml",
        "base: configs/expert.yaml\nrules: own.dl\nactions:\n  define: {Wave: {cells: {Car: 0}}}\n  \
         priority: [Stop, Wave, Slow, Fast, Normal]\npredicates:\n  define: {Waited: {quantity: waited}}\n",
    );
    write(
        folder.path(),
        "own.dl",
        ".include \"vocabulary.dl\"\n.decl Wave(x: agent)\n.output Wave\nStop(X) :- IsAtInter(X).\n\
         Wave(X) :- IsAtInter(X).\nNormal(X) :- IsPedestrian(X).\n",
    );
    let own = folder.path().join("own");
    let own = own.to_str().unwrap();
    let output = logicity(["run", &config, "--no-pictures", "--ticks", "60", "--out", own]);
    assert_eq!(code(&output), 0, "{}", err(&output));
    let summary = out(&output);
    assert!(summary.contains("Stop won over Wave in"), "{summary}");
    assert!(!summary.contains("Normal won over Wave"), "{summary}");
    let own = format!("{own}/trace.jsonl");
    let rules = folder.path().join("own.dl");
    for given in [None, rules.to_str()] {
        let command = ["check", "--json", "--coverage", &own].into_iter().chain(given);
        let output = run(&command.collect::<Vec<_>>(), b"");
        let line: Value = serde_json::from_str(&out(&output)).unwrap();
        assert!(line["conflicts"].to_string().contains("\"Wave\""), "{line}");
    }
    let explained = |tick: u64, agent: &str| {
        let output = logicity(["explain", &own, "--tick", &tick.to_string(), "--agent", agent]);
        out(&output)
    };
    let at_entrance = (0..60).map(|tick| explained(tick, "Pedestrian_1"));
    let mut told = at_entrance.filter(|text| text.contains("Wave"));
    let told = told.next().expect("it passes an intersection");
    assert!(told.contains("; pedestrians cannot take Wave"), "{told}");
    write(
        folder.path(),
        "own.dl",
        ".include \"vocabulary.dl\"\nStop(X) :- Waited(X, n), n > 3, IsCar(Y).\n",
    );
    for command in [
        &["check", &config][..],
        &["run", &config, "--no-pictures", "--out", "none"],
    ] {
        fails(
            &run(command, b""),
            1,
            &[
                "own.dl:2:12",
                "declare it with `.decl Waited(x: agent, n: number)` and `.input Waited`",
            ],
        );
    }
    fails(
        &logicity(["check", "--coverage", trace, "--config", "configs/hard.yaml"]),
        1,
        &["trace-mismatch"],
    );
    fails(
        &logicity(["check", "--coverage", "no/such.jsonl"]),
        2,
        &["no/such.jsonl"],
    );
    fails(&logicity(["check"]), 2, &["FILES"]);
}

#[test]
fn all_rule_files_of_all_modes_are_clean() {
    for file in fs::read_dir(concat!(env!("CARGO_MANIFEST_DIR"), "/rules")).unwrap() {
        let path = file.unwrap().path();
        if path.extension().is_some_and(|extension| extension == "dl") {
            let output = logicity(["check", "--json", path.to_str().unwrap()]);
            let line: Value = serde_json::from_str(&out(&output)).unwrap();
            let found = line["diagnostics"].as_array().unwrap().iter();
            let found: Vec<&str> = found.map(|one| one["code"].as_str().unwrap()).collect();
            let expected: &[&str] = match path.file_name().unwrap().to_str() {
                // The published rules of this mode derive two actions for some ambulances.
                Some("vap-hard.dl") => &["action-conflict"],
                // Cars keep their distance by a predicate of their configuration.
                Some("town.dl") => &["no-collision-clause"],
                _ => &[],
            };
            assert_eq!((code(&output), found.as_slice()), (0, expected), "{}", path.display());
        }
    }
}

#[test]
fn check_reports_all_faults_and_exits_with_1() {
    let folder = tempfile::tempdir().unwrap();
    let one = write(
        folder.path(),
        "one.dl",
        ".include \"vocabulary.dl\"\nStop(X) :- IsCarr(X).\nStop(X) :- IsClose(X).\n",
    );
    let two = write(folder.path(), "two.dl", ".decl a(x: number)\na(x) :- !a(x).\n");
    let output = logicity(["check", &one, &two]);
    fails(
        &output,
        1,
        &[
            "unknown-predicate",
            "did you mean `IsCar`",
            "arity-mismatch",
            "unbound-variable",
            "one.dl:2",
            "two.dl:2",
        ],
    );
    let output = logicity(["check", "--json", &one, &two]);
    let lines: Vec<Value> = out(&output)
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    assert_eq!((code(&output), lines.len()), (1, 2));
    assert_eq!(lines[0]["diagnostics"][0]["labels"][0]["line"], 2);
}

#[test]
fn check_reports_incomplete_searches() {
    // The search for redundant clauses looks for a closed walk of nine steps in a bipartite graph, which has none.
    let graph: Vec<String> = (0..16)
        .map(|at| format!("E(a{0}, b{1}), E(b{1}, a{0})", at / 4, at % 4))
        .collect();
    let walk: Vec<String> = (0..9).map(|at| format!("E(c{at}, c{})", (at + 1) % 9)).collect();
    let folder = tempfile::tempdir().unwrap();
    let text = format!(
        ".decl E(x: symbol, y: symbol)\n.input E\n.decl P(x: symbol)\n.output P\nP(a0) :- {}.\nP(c0) :- {}.\n",
        graph.join(", "),
        walk.join(", ")
    );
    let path = write(folder.path(), "hard.dl", text);
    let output = logicity(["check", &path]);
    assert_eq!(code(&output), 0, "{}", err(&output));
    assert!(
        out(&output).contains("incomplete: the search for clauses that derive nothing new "),
        "{}",
        out(&output)
    );
    let line: Value = serde_json::from_str(&out(&logicity(["check", "--json", &path]))).unwrap();
    assert_eq!(
        line["unfinished"],
        serde_json::json!(["clauses that derive nothing new"])
    );
    let line: Value = serde_json::from_str(&out(&logicity(["check", "--json", "rules/hard.dl"]))).unwrap();
    assert_eq!(line.get("unfinished"), None);
}

#[test]
fn wrong_usage_exits_with_2() {
    let folder = tempfile::tempdir().unwrap();
    let file = write(folder.path(), "file", "");
    let inside = format!("{file}/out");
    fails(&logicity(["check", "no/such.dl"]), 2, &["no/such.dl"]);
    fails(&logicity(["check", "rules"]), 2, &["rules", "folder"]);
    fails(&logicity(["run", "no/such.yaml"]), 2, &["no/such.yaml"]);
    fails(&logicity(["run", "configs"]), 2, &["configs"]);
    fails(
        &logicity(["run", "configs/easy.yaml", "--ticks", "1", "--out", &inside]),
        2,
        &["out"],
    );
    fails(&logicity(["run", "configs/easy.yaml", "--ticks", "0"]), 2, &["--ticks"]);
    fails(&logicity(["infer", "no/such.jsonl"]), 2, &["no/such.jsonl"]);
    fails(&logicity(["query", "no/such.dl"]), 2, &["no/such.dl"]);
    fails(
        &logicity(["route", "--type", "car", "--from", "1", "--to", "2,3"]),
        2,
        &["row and column"],
    );
    fails(&logicity(["fly"]), 2, &["fly"]);
    for command in [
        ["run", "expert"],
        ["bench", "tick"],
        ["bench", "scale"],
        ["query", "no/such.dl"],
    ] {
        for threads in ["65535", "1025", "-1", "many"] {
            let [command, what] = command;
            let output = logicity([command, what, "--threads", threads]);
            fails(&output, 2, &["--threads", "expected an integer from 0 to 1024"]);
        }
    }
    fails(
        &logicity(["infer", "--check-constraints", "--executor", "dense"]),
        2,
        &["--check-constraints", "--executor dense"],
    );
    let empty = write(folder.path(), "empty.dl", "");
    fails(
        &logicity(["query", &empty, "-F", "no/such"]),
        2,
        &["no/such", "no such folder"],
    );
    for ticks in ["0", "-1", "1000000001", "many"] {
        fails(
            &logicity(["run", "expert", "--ticks", ticks, "--out", &inside]),
            2,
            &["--ticks", "expected an integer from 1 to 1000000000"],
        );
    }
}

#[test]
fn every_option_says_which_numbers_it_takes() {
    for (line, expected) in [
        ("run easy --seed", "an integer from 0 to 18446744073709551615"),
        ("infer --seed", "an integer from 0 to 18446744073709551615"),
        ("questions --seed", "an integer from 0 to 18446744073709551615"),
        ("questions --count", "an integer from 1 to 20000"),
        ("questions --shots", "an integer from 0 to 100"),
        (
            "explain trace --agent Car_1 --tick",
            "an integer from 0 to 18446744073709551615",
        ),
        ("view trace --from", "an integer from 0 to 18446744073709551615"),
        ("view trace --ticks", "an integer from 1 to 18446744073709551615"),
        ("episodes show --episode", "an integer from 0 to 18446744073709551615"),
        ("episodes make --count", "an integer from 1 to 100000"),
        ("episodes spread --sets", "an integer from 2 to 100000"),
        (
            "vap make --mode easy --split test --out x --worlds",
            "an integer from 1 to 100000",
        ),
        (
            "vap make --mode easy --split test --out x --first-world",
            "an integer from 0 to 99999",
        ),
        ("bench tick --agents", "an integer from 1 to 1000000"),
        ("bench tick --seconds", "a number from 0.01 to 86400"),
        ("icons sheet --difficulty", "an integer from 0 to 100"),
        ("diff a b --effort", "an integer from 0 to 18446744073709551615"),
        ("route --type car --to 1,1 --from", "row and column as two integers"),
    ] {
        let arguments: Vec<&str> = line.split(' ').chain(["-1"]).collect();
        fails(&run(&arguments, b""), 2, &[&format!("expected {expected}")]);
    }
    // The coordinates of a cell may be negative, but no such cell is on a map.
    let outside = logicity(["route", "--type", "car", "--from", "-1,5", "--to", "2,2"]);
    fails(&outside, 2, &["[-1, 5] is not on the map"]);
}

/// A rule that counts up to a billion.
const RUNAWAY: &str = ".include \"vocabulary.dl\"\n.decl N(x: number)\nN(0).\nN(X + 1) :- N(X), X < 1000000000.\n\
                       Stop(X) :- IsCar(X), CollidingClose(X, Y), N(500000000).\n";

#[test]
fn a_costly_rule_ends_infer_and_run_at_a_limit() {
    let folder = tempfile::tempdir().unwrap();
    let rules = write(folder.path(), "rules.dl", RUNAWAY);
    let config = write(folder.path(), "own.yaml", "base: configs/easy.yaml\nrules: rules.dl\n");
    let target = folder.path().join("out");
    let scene = b"{\"entities\": [\"a\"], \"ego\": \"a\", \"facts\": {\"IsCar\": [\"a\"]}}\n";
    for (option, limit, message) in [
        ("--max-rows", "20K", "the rules derive more than 20000 rows"),
        ("--max-steps", "20K", "the rules scan more than 20000 rows"),
        ("--max-memory", "1", "rows, indexes and symbols take more than 1 MiB"),
    ] {
        let raise = format!("raise the limit with `{option}`");
        let output = with_input(["infer", "--rules", &rules, option, limit], scene);
        let clause = format!("in the evaluation of N(X + 1) :- N(X), X < 1000000000.    {rules}:4:1");
        fails(&output, 1, &["error[limit-exceeded]", message, &clause, &raise]);
        // Answers stay aligned with scenes.
        let answer: Value = serde_json::from_str(out(&output).trim()).unwrap();
        assert_eq!(answer["error"][0]["code"], "limit-exceeded");
        for command in [
            vec![
                "run",
                "easy",
                "--ticks",
                "1",
                "--out",
                target.to_str().unwrap(),
                "--rules",
                &rules,
            ],
            vec!["bench", "tick", "--config", &config],
            vec!["bench", "infer", "--config", &config, "--scenes", "-"],
            vec!["bench", "env", "--config", &config],
            vec!["episodes", "make", &config, "-o", "-"],
            vec!["questions", &config],
        ] {
            let output = run(&[&command[..], &[option, limit]].concat(), scene);
            fails(&output, 1, &["error[limit-exceeded]", message, "rules.dl:4:1", &raise]);
        }
        assert!(fs::read_dir(&target).unwrap().next().is_none(), "no file remains");
    }
    let enough = with_input(
        [
            "infer",
            "--max-rows",
            "1K",
            "--max-steps",
            "10K",
            "--executor",
            "relational",
        ],
        scene,
    );
    assert_eq!(code(&enough), 0, "{}", err(&enough));
}

/// A rule that counts up to `most`. Explanations need only its first row.
fn counting(most: u32) -> String {
    let counting = RUNAWAY.replace("X < 1000000000", &format!("X < {most}"));
    counting.replace("N(500000000)", "N(0)")
}

/// The arguments of a run of one tick with some rules.
fn one_tick<'a>(rules: &'a str, out: &'a str) -> [&'a str; 9] {
    [
        "run",
        "easy",
        "--ticks",
        "1",
        "--no-pictures",
        "--out",
        out,
        "--rules",
        rules,
    ]
}

#[test]
fn every_command_that_reads_a_trace_takes_limits() {
    let folder = tempfile::tempdir().unwrap();
    let rules = write(folder.path(), "rules.dl", counting(3_000));
    let made = folder.path().join("run");
    let made = made.to_str().unwrap();
    let page = folder.path().join("page.html");
    let page = page.to_str().unwrap();
    succeeds(&logicity(one_tick(&rules, made)));
    let trace = format!("{made}/trace.jsonl");
    let explain = ["explain", &trace, "--agent", "Car_1"];
    let view = ["view", &trace, "-o", page, "--force"];
    let coverage = ["check", "--coverage", &trace];
    for command in [&explain[..], &view, &coverage] {
        succeeds(&run(command, b""));
        for (option, limit, message) in [
            ("--max-rows", "2K", "the rules derive more than 2000 rows"),
            ("--max-steps", "2K", "the rules scan more than 2000 rows"),
            ("--max-memory", "0", "take more than 0 MiB"),
        ] {
            let raise = format!("raise the limit with `{option}`");
            let output = run(&[command, &[option, limit]].concat(), b"");
            fails(&output, 1, &["error[limit-exceeded]", message, &raise]);
            // The same holds for rules that the command line names.
            if command[0] != "check" {
                let output = run(&[command, &["--rules", &rules, option, limit]].concat(), b"");
                fails(&output, 1, &["error[limit-exceeded]", message, &raise]);
            }
        }
    }
}

#[test]
fn rules_in_a_trace_have_lower_default_limits() {
    let folder = tempfile::tempdir().unwrap();
    let rules = write(folder.path(), "rules.dl", counting(150_000));
    let made = folder.path().join("run");
    let made = made.to_str().unwrap();
    let page = folder.path().join("page.html");
    // The page of a run is made under the limits of the run.
    let html = ["--html", page.to_str().unwrap()];
    succeeds(&run(&[&one_tick(&rules, made)[..], &html].concat(), b""));
    let trace = format!("{made}/trace.jsonl");
    let explain = ["explain", &trace, "--agent", "Car_1"];
    fails(
        &logicity(explain),
        1,
        &["error[limit-exceeded]", "raise the limit with `--max-rows`"],
    );
    for more in [["--max-rows", "1M"], ["--rules", &rules]] {
        succeeds(&run(&[&explain[..], &more].concat(), b""));
    }
}

#[test]
fn option_values_that_do_not_fit_the_input_exit_with_2() {
    for (arguments, words) in [
        (
            vec!["run", "metropolis", "--split", "val", "--no-trace"],
            vec!["error[unknown-split]"],
        ),
        (
            vec!["bench", "tick", "--config", "metropolis", "--split", "val"],
            vec!["error[unknown-split]"],
        ),
        (
            vec!["diff", "rules/easy.dl", "rules/medium.dl", "--predicates", "stop"],
            vec!["`stop`", "did you mean `Stop`?"],
        ),
        (
            vec!["diff", "rules/easy.dl", "rules/medium.dl", "--predicates", "Fly"],
            vec!["`--predicates NAME,...`"],
        ),
        (
            vec!["diff", "rules/easy.dl", "rules/medium.dl", "--entities", "0"],
            vec!["expected an integer from 1"],
        ),
        (
            vec!["diff", "rules/easy.dl", "rules/medium.dl", "--entities", "-1"],
            vec!["expected an integer from 1"],
        ),
        (vec!["questions", "--shots", "1"], vec!["`--shots 0`"]),
        (vec!["questions", "--about", "Tiro"], vec!["did you mean `tiro`?"]),
    ] {
        fails(&run(&arguments, b""), 2, &words);
    }
}

#[test]
fn fixed_words_may_be_in_upper_or_lower_case() {
    let cells = |kind: &str, routing: &str| {
        let arguments = [
            "route",
            "--type",
            kind,
            "--routing",
            routing,
            "--from",
            "46,20",
            "--to",
            "46,80",
        ];
        let output = logicity(arguments);
        assert_eq!(code(&output), 0, "{}", err(&output));
        out(&output)
    };
    assert_eq!(cells("car", "weighted"), cells("Car", "Weighted"));
    assert_eq!(cells("car", "hops"), cells("CAR", "HOPS"));
    fails(
        &logicity(["route", "--type", "pedestrain", "--from", "46,20", "--to", "46,80"]),
        2,
        &[
            "possible values: car, pedestrian",
            "a similar value exists: 'pedestrian'",
        ],
    );

    let scene = |kind: &str, heading: &str| {
        let scene = format!(
            "{{\"map\": \"square-5x5\", \"agents\": [{{\"id\": \"Car_1\", \"type\": \"{kind}\", \"at\": [102, 20], \
             \"heading\": \"{heading}\"}}]}}\n"
        );
        let output = with_input(["infer", "--executor", "Dense"], scene.as_bytes());
        assert_eq!(code(&output), 0, "{}", err(&output));
        out(&output)
    };
    assert_eq!(scene("Car", "Up"), scene("car", "UP"));

    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().to_str().unwrap();
    let output = logicity([
        "run",
        "easy",
        "--ticks",
        "2",
        "--split",
        "Test",
        "--no-pictures",
        "--out",
        place,
    ]);
    assert_eq!(code(&output), 0, "{}", err(&output));
    let trace = format!("{place}/trace.jsonl");
    let why_not = |action: &str| out(&logicity(["explain", &trace, "--agent", "Car_1", "--why-not", action]));
    assert!(!why_not("Stop").is_empty());
    assert_eq!(why_not("Stop"), why_not("stop"));
}

#[test]
fn a_missing_file_is_reported_in_one_wording_with_a_similar_name() {
    let folder = tempfile::tempdir().unwrap();
    let mine = write(folder.path(), "mine.dl", "");
    let traces = write(folder.path(), "trace.jsonl", "");
    let near = |path: &str, change: (&str, &str)| path.replace(change.0, change.1);
    let typo = near(&mine, ("mine.dl", "mien.dl"));
    let bare = near(&mine, ("mine.dl", "mine"));
    let trace = near(&traces, ("trace.jsonl", "trcae.jsonl"));
    let (typo, bare, mine) = (typo.as_str(), bare.as_str(), mine.as_str());
    let (trace, traces) = (trace.as_str(), traces.as_str());
    for (arguments, path, help) in [
        (vec!["check", typo], typo, mine),
        (vec!["fmt", bare], bare, mine),
        (vec!["query", typo], typo, mine),
        (vec!["repl", typo], typo, mine),
        (vec!["diff", typo, "rules/easy.dl"], typo, mine),
        (vec!["check", "expert.dl"], "expert.dl", "rules/expert.dl"),
        (vec!["check", "rules/exprt.dl"], "rules/exprt.dl", "rules/expert.dl"),
        (
            vec!["run", "expert", "--rules", "rules/exprt.dl", "--no-trace"],
            "rules/exprt.dl",
            "rules/expert.dl",
        ),
        (vec!["run", "exprt", "--no-trace"], "exprt", "expert"),
        (vec!["check", "exprt"], "exprt", "rules/expert.dl"),
        (vec!["diff", "hrd", "expert"], "hrd", "rules/hard.dl"),
        (vec!["shortcuts", "hrd"], "hrd", "rules/hard.dl"),
        (
            vec!["check", "configs/exprt.yaml"],
            "configs/exprt.yaml",
            "configs/expert.yaml",
        ),
        (
            vec![
                "route",
                "--map",
                "square5x5",
                "--type",
                "car",
                "--from",
                "0,0",
                "--to",
                "0,0",
            ],
            "square5x5",
            "square-5x5",
        ),
        (vec!["infer", trace], trace, traces),
        (vec!["bench", "infer", "--scenes", trace], trace, traces),
        (vec!["explain", trace, "--agent", "Car_1"], trace, traces),
        (vec!["view", trace], trace, traces),
        (vec!["check", "--coverage", trace], trace, traces),
    ] {
        let message = format!("error: cannot read `{path}`: no such file\nhelp: did you mean `{help}`?");
        fails(&run(&arguments, b""), 2, &[&message]);
    }
    let output = logicity(["run", "square-5x5", "--no-trace"]);
    fails(
        &output,
        2,
        &[
            "`square-5x5` is a map",
            "write one with `base: expert` and `map: square-5x5`",
        ],
    );
    let output = logicity(["run", "configs/maps/square-5x5.yaml", "--no-trace"]);
    fails(
        &output,
        1,
        &[
            "expected a run configuration, found a map",
            "`map: configs/maps/square-5x5.yaml`",
        ],
    );
    let output = logicity(["run", "rules/expert.dl", "--no-trace"]);
    fails(&output, 1, &["`rules/expert.dl` is a rule file"]);
}

#[test]
fn check_examines_configurations_with_their_rules() {
    let folder = tempfile::tempdir().unwrap();
    let output = logicity(["check", "configs/expert.yaml", "expert", "square-5x5"]);
    assert_eq!((code(&output), err(&output).as_str()), (0, ""));
    let said = out(&output);
    for words in [
        "configs/expert.yaml: a run configuration\n",
        "expert: a run configuration\n",
        "  map: square-5x5, 5 x 5 blocks, 241 x 241 cells\n",
        "test 10 cars and 8 pedestrians",
        "  task: Safe Path Following\n",
        "rules/expert.dl: 14 clauses\n",
        "square-5x5: a map of 5 x 5 blocks, 241 x 241 cells\n",
    ] {
        assert!(said.contains(words), "`{words}` is missing in:\n{said}");
    }
    let output = logicity(["check", "configs/maps/metropolis.yaml", "--json"]);
    let line: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!((code(&output), &line["ok"]), (0, &Value::Bool(true)));
    assert_eq!(line["configuration"]["map"]["cells"], serde_json::json!([28301, 28301]));

    write(
        folder.path(),
        "rules.dl",
        ".include \"vocabulary.dl\"\nStop(X) :- IsCra(X).\n",
    );
    let faulty = write(folder.path(), "faulty.yaml", "base: expert\nrules: rules.dl\n");
    fails(
        &logicity(["check", &faulty]),
        1,
        &["unknown-predicate", "rules.dl:2:12", "did you mean `IsCar`?"],
    );
    let small = "base: expert\nmap: {blocks: [1, 1], buildings: {rows: [HO, SG]}}\nagents: {test: {cars: [{priority: 1, count: 9999}]}}\n";
    let small = write(folder.path(), "small.yaml", small);
    let output = logicity(["check", &small, "--json"]);
    let line: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!((code(&output), &line["ok"]), (1, &Value::Bool(false)), "{line}");
    let codes: Vec<&Value> = (line["diagnostics"].as_array().unwrap().iter())
        .map(|fault| &fault["code"])
        .collect();
    // Pedestrians of the other splits have nowhere to go, and the cars of the test split no room.
    // A map of one block has no intersection.
    assert_eq!(
        codes,
        [
            "empty-predicate",
            "empty-predicate",
            "no-route",
            "no-route",
            "no-start-cell"
        ],
        "{line}"
    );
    let taxi = "base: expert\nrules: taxi.dl\n";
    write(
        folder.path(),
        "taxi.dl",
        ".include \"vocabulary.dl\"\n.decl IsTaxi(x: agent)\n.input IsTaxi\nStop(X) :- IsTaxi(X).\n",
    );
    let taxi = write(folder.path(), "taxi.yaml", taxi);
    fails(&logicity(["check", &taxi]), 1, &["rule-mismatch", "IsTaxi"]);
    let agents = write(folder.path(), "agents.yaml", "test: {cars: [{priority: 1}]}\n");
    fails(&logicity(["check", &agents]), 1, &["found agent sets", "agents: "]);
}

#[test]
fn new_creates_files_whose_next_commands_work() {
    let program = env!("CARGO_BIN_EXE_logicity");
    for name in ["city", "a city/it's mine"] {
        let folder = tempfile::tempdir().unwrap();
        let shell = |line: &str| {
            let line = line.replacen("logicity", &format!("'{program}'"), 1);
            let output = Command::new("sh")
                .args(["-c", &line])
                .current_dir(folder.path())
                .output();
            output.unwrap()
        };
        let create = || {
            Command::new(program)
                .args(["new", name])
                .current_dir(folder.path())
                .output()
                .unwrap()
        };
        let output = create();
        assert_eq!(code(&output), 0, "{}", err(&output));
        let said = out(&output);
        let commands: Vec<&str> = said.lines().filter_map(|line| line.strip_prefix("  ")).collect();
        assert!(
            commands.len() == 4 && commands.iter().all(|line| line.starts_with("logicity ")),
            "{said}"
        );
        for command in &commands {
            let output = shell(command);
            // A slow machine writes lines of progress.
            let said = err(&output);
            let messages: Vec<&str> = said.lines().filter(|line| !line.starts_with("tick ")).collect();
            assert_eq!((code(&output), messages), (0, vec![]), "{command}\n{}", out(&output));
            if command.contains(" check ") {
                assert!(out(&output).contains("conflicts: none"), "{}", out(&output));
            }
            if command.contains(" infer ") {
                let answers: Vec<Value> = out(&output)
                    .lines()
                    .map(|line| serde_json::from_str(line).unwrap())
                    .collect();
                assert_eq!(answers[0]["egos"]["Car_1"]["action"], "Stop");
                assert_eq!(answers[1]["egos"]["ambulance"]["action"], "Fast");
            }
        }
        let rules = folder.path().join(name).join("rules.dl");
        let formatted = Command::new(program)
            .args(["fmt", "--check"])
            .arg(&rules)
            .output()
            .unwrap();
        assert_eq!(code(&formatted), 0, "the rules are formatted");
        fs::write(&rules, "// mine\n").unwrap();
        fails(&create(), 2, &["exists", "overwrites nothing"]);
        assert_eq!(fs::read_to_string(&rules).unwrap(), "// mine\n");
    }
}

#[test]
fn a_file_that_is_not_text_exits_with_1() {
    let folder = tempfile::tempdir().unwrap();
    let bytes = b"\n.decl \xff\xfe";
    let rules = write(folder.path(), "a.dl", bytes);
    let config = write(folder.path(), "a.yaml", bytes);
    let facts = write(folder.path(), "a.facts", bytes);
    fails(&logicity(["check", &rules]), 1, &["not-text", "line 2"]);
    fails(&logicity(["run", &config]), 1, &["not-text"]);
    fails(&with_input(["infer"], bytes), 1, &["not-text", "line 2"]);
    let program = write(folder.path(), "b.dl", ".decl a(x: symbol)\n.input a\n.output a\n");
    let parent = Path::new(&facts).parent().unwrap().to_str().unwrap();
    fails(
        &logicity(["query", &program, "-F", parent]),
        1,
        &["not-text", "a.facts:2:7"],
    );
    // The fault does not hide others.
    write(folder.path(), "n.facts", b"1\n\xff\nthree\n4\n");
    let program = write(folder.path(), "n.dl", ".decl n(x: number)\n.input n\n.output n\n");
    let output = logicity(["query", &program, "-F", parent]);
    fails(&output, 1, &["not-text", "n.facts:2:1", "n.facts:3:1", "holds numbers"]);
}

#[test]
fn query_explains_in_the_language() {
    let folder = tempfile::tempdir().unwrap();
    let rules = write(
        folder.path(),
        "path.dl",
        ".decl edge(x: symbol, y: symbol)\n.decl path(x: symbol, y: symbol)\nedge(\"a\", \"b \\\"c\\\"\").\n\
         path(x, y) :- edge(x, y).\npath(x, z) :- path(x, y), path(y, z).\n",
    );
    let given = write(folder.path(), "given.dl", ".decl fact(x: number)\n.input fact\n");
    write(folder.path(), "fact.facts", "1\n");
    for (option, fact, answer) in [
        ("--explain", "fact(1)", "fact(1)  a given fact\n"),
        (
            "--why-not",
            "fact(1)",
            "fact(1) holds, because:\nfact(1)  a given fact\n",
        ),
        (
            "--why-not",
            "fact(2)",
            "Not(fact(2)): not a given fact, and no clause derives it\n",
        ),
    ] {
        let facts = folder.path().to_str().unwrap();
        assert_eq!(out(&logicity(["query", &given, "-F", facts, option, fact])), answer);
    }
    let why = |option: &str, fact: &str| out(&logicity(["query", &rules, option, fact]));
    let printed = why("--explain", "path(\"a\", _)");
    assert!(
        printed.starts_with("path(\"a\", \"b \\\"c\\\"\")  by path(x, y)"),
        "{printed}"
    );
    let (fact, _) = printed.split_once("  by").unwrap();
    assert_eq!(why("--explain", fact), printed, "a printed fact can be queried");
    let printed = why("--why-not", "path(\"b\", \"a\")");
    assert!(printed.contains("path(\"b\", y) does not hold"), "{printed}");
}

#[test]
fn memory_is_given_in_mebibytes_or_with_a_unit() {
    let folder = tempfile::tempdir().unwrap();
    let rules = write(
        folder.path(),
        "n.dl",
        ".decl n(x: number)\n.printsize n\nn(x) :- x = range(0, 30000).\n",
    );
    let with = |option: &str, value: &str| logicity(["query", &rules, option, value]);
    for enough in ["100", "50M", "50MiB", "1G", "2gib", "1T", "99999999999T"] {
        let output = with("--max-memory", enough);
        assert_eq!((code(&output), out(&output).as_str()), (0, "n\t30000\n"), "{enough}");
    }
    for little in ["0", "1K", "1kib"] {
        fails(
            &with("--max-memory", little),
            1,
            &["limit-exceeded", "raise the limit with `--max-memory`"],
        );
    }
    for wrong in ["", "M", "-1", "5 potatoes", "1.5G", "50MB"] {
        let output = with("--max-memory", wrong);
        fails(
            &output,
            2,
            &["expected an integer number of MiB, or one with a suffix", "50M"],
        );
    }
    for (little, printed) in [
        ("0", "more than 0 MiB"),
        ("3K", "more than 3 KiB"),
        ("20k", "more than 20 KiB"),
    ] {
        fails(&with("--max-memory", little), 1, &[printed]);
    }
    for option in ["--max-rows", "--max-steps"] {
        for wrong in ["-1", "", "K", "1.5K", "3 MiB", "99999999999999999999"] {
            fails(
                &with(option, wrong),
                2,
                &["expected a nonnegative integer, optionally with a suffix"],
            );
        }
        assert_eq!(code(&with(option, "1g")), 0);
        fails(&with(option, "29K"), 1, &["limit-exceeded", "29000 rows"]);
    }
}

#[test]
fn query_follows_souffle() {
    let folder = tempfile::tempdir().unwrap();
    let rules = write(
        folder.path(),
        "tc.dl",
        ".decl edge(x: number, y: symbol)\n.input edge\n.decl path(x: number, y: symbol)\n.output path\n.printsize path\n\
         path(x, y) :- edge(x, y).\n",
    );
    write(folder.path(), "edge.facts", "10\tb\n-2\ta b\n9\tb\n");
    let here = folder.path().to_str().unwrap();
    let output = logicity(["query", &rules, "-F", here, "-D", here]);
    assert_eq!(
        (code(&output), out(&output).as_str()),
        (0, "path\t3\n"),
        "{}",
        err(&output)
    );
    assert_eq!(
        fs::read_to_string(folder.path().join("path.csv")).unwrap(),
        "-2\ta b\n9\tb\n10\tb\n"
    );
    let output = logicity(["query", &rules, "-F", here, "-D", "-"]);
    let expected = "---------------\npath\nx\ty\n===============\n-2\ta b\n9\tb\n10\tb\n===============\npath\t3\n";
    assert_eq!(out(&output), expected);

    write(folder.path(), "edge.facts", "10\tb\nten\tb\n1\n");
    fails(
        &logicity(["query", &rules, "-F", here, "-D", here]),
        1,
        &["invalid-fact", "edge.facts:2:1", "edge.facts:3:1"],
    );
    fs::remove_file(folder.path().join("edge.facts")).unwrap();
    fails(&logicity(["query", &rules, "-F", here, "-D", here]), 2, &["edge.facts"]);
}

#[test]
fn query_shows_plans_and_work() {
    let folder = tempfile::tempdir().unwrap();
    let rules = write(
        folder.path(),
        "path.dl",
        ".decl edge(x: number, y: symbol)\n.decl to(x: symbol, y: number)\n.decl path(x: number, y: symbol)\n.printsize path\n\
         edge(1, \"a\"). to(\"a\", 2). edge(2, \"b\").\n\
         path(x, y) :- edge(x, y).\npath(x, z) :- path(x, y), to(y, n), !to(\"b\", n),\n  n < 5, edge(n, z).\n",
    );
    let output = logicity(["query", &rules, "--plan"]);
    let expected = format!(
        "\
stratum 3: path (recursive)

  path(x, y) :- edge(x, y).    {rules}:6:1
    once
      scan   edge(x, y)
      derive path(x, y)

  path(x, z) :- path(x, y), to(y, n), !to(\"b\", n), n < 5, edge(n, z).    {rules}:7:1
    for the new rows of path
      scan   path(x, y), new
      scan   to(y, n) by x
      test   n < 5
      absent to(\"b\", n) by x, y
      scan   edge(n, z) by x
      derive path(x, z)

"
    );
    let shown = out(&output);
    let shown = &shown[shown.find("stratum 3").unwrap_or_default()..];
    assert_eq!((code(&output), shown), (0, expected.as_str()));

    let computed = write(
        folder.path(),
        "computed.dl",
        ".decl e(a: symbol)\n.decl q(x: number)\n.output q\ne(\"it\").\nq(strlen(a) * 2 + 1) :- e(a).\n",
    );
    let shown = out(&logicity(["query", &computed, "--plan"]));
    let lets: Vec<&str> = shown
        .lines()
        .filter_map(|line| line.trim().strip_prefix("let    "))
        .collect();
    assert_eq!(lets, ["b = strlen(a)", "c = b * 2", "d = c + 1"]);
    assert!(shown.ends_with("derive q(d)\n\n"), "{shown}");

    let output = logicity(["query", &rules, "--profile"]);
    assert_eq!((code(&output), out(&output).as_str()), (0, "path\t3\n"));
    let lines: Vec<String> = err(&output).lines().map(str::to_owned).collect();
    assert!(
        lines[0].ends_with("new rows in  rows scanned       derived   runs  clause") && lines.len() == 5,
        "{lines:?}"
    );
    let find = |what: &str| lines.iter().find(|line| line.contains(what)).unwrap().as_str();
    assert!(find("path(x, z) :- path(x, y)").ends_with(":7:1"), "{lines:?}");
    assert!(lines[3].ends_with("(sorting, merging, indexes)") && lines[4].contains(" ms 100.0% "));
    let numbers: Vec<&str> = find("path(x, y) :- edge").split_whitespace().skip(3).take(4).collect();
    assert_eq!(numbers, ["0", "2", "2", "1"]);
}

#[test]
fn query_takes_threads_and_limits() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path().to_str().unwrap();
    let facts: String = (0..300).map(|n| format!("a({n}). ")).collect();
    let text = ".decl a(x: number)\n.decl b(x: number, y: number)\n.output b\nb(x, y) :- a(x), a(y).\n";
    let rules = write(folder.path(), "product.dl", &(text.to_owned() + &facts));
    let answer = out(&logicity(["query", &rules, "-D", "-"]));
    assert!(answer.lines().count() > 90_000);
    for threads in ["0", "1", "2", "9"] {
        let output = logicity(["query", &rules, "-D", "-", "--threads", threads]);
        assert_eq!((code(&output), out(&output)), (0, answer.clone()));
    }
    fails(&logicity(["query", &rules, "--threads", "5000"]), 2, &["--threads"]);
    let output = logicity(["query", &rules, "-D", here, "--max-memory", "0"]);
    fails(
        &output,
        1,
        &["limit-exceeded", "the inserted rows take", "--max-memory"],
    );
    for (option, value) in [("--max-rows", "89999"), ("--max-steps", "90000")] {
        for threads in ["1", "2"] {
            let output = logicity(["query", &rules, "-D", here, option, value, "--threads", threads]);
            fails(
                &output,
                1,
                &[
                    "limit-exceeded",
                    "product.dl:4",
                    option,
                    "shares no variable",
                    "the join is a Cartesian product",
                ],
            );
            assert!(!folder.path().join("b.csv").exists());
        }
    }
    let output = logicity(["query", &rules, "-D", here, "--max-rows", "90000", "--max-memory", "20"]);
    assert_eq!(code(&output), 0);
}

#[test]
fn query_shows_plans_for_its_facts() {
    let folder = tempfile::tempdir().unwrap();
    let rules = write(
        folder.path(),
        "cycle.dl",
        ".decl edge(x: number, y: number)\n.input edge\n.decl mark(x: number)\n.input mark\n\
         .decl cycle(x: number, y: number, z: number)\n.decl near(x: number)\n\
         cycle(x, y, z) :- edge(x, y), edge(y, z), edge(x, z).\n\
         near(x) :- edge(x, y), mark(y).\n",
    );
    let star: String = (1..1000).map(|node| format!("0\t{node}\n{node}\t0\n")).collect();
    write(folder.path(), "edge.facts", &star);
    write(folder.path(), "mark.facts", "7\n");
    let here = folder.path().to_str().unwrap();
    let output = logicity(["query", &rules, "-F", here, "--plan"]);
    let expected = format!(
        "\
stratum 1: cycle
  over edge 1998

  cycle(x, y, z) :- edge(x, y), edge(y, z), edge(x, z).    {rules}:7:1
    once
      scan   edge(x, y)
      join   edge(y, z) by x
         and edge(x, z) by x
      derive cycle(x, y, z)

stratum 2: near
  over edge 1998, mark 1

  near(x) :- edge(x, y), mark(y).    {rules}:8:1
    once
      scan   mark(y)
      scan   edge(x, y) by y, index (y, x)
      derive near(x)

"
    );
    assert_eq!((code(&output), out(&output)), (0, expected));
    // Before there are facts, the plans depend on the text alone.
    let output = logicity(["query", &rules, "--plan"]);
    assert_eq!((code(&output), out(&output).contains("meet")), (0, false));
    assert!(!folder.path().join("cycle.csv").exists());
}

#[test]
fn query_follows_the_options_of_directives() {
    let folder = tempfile::tempdir().unwrap();
    let rules = write(
        folder.path(),
        "main.dl",
        ".pragma \"legacy\"\n\
         .decl speed(name: symbol, v: float)\n\
         .input speed(IO=file, filename=\"in.csv\", delimiter=\",\", headers=true)\n\
         .input speed(IO=stdin)\n\
         .decl fast(name: symbol, v: float) brie\n\
         .output fast(IO=stdout, headers=true)\n\
         .output fast(filename=\"out.csv\", rfc4180=true)\n\
         .decl any()\n\
         .output any\n\
         .printsize fast(IO=stdoutprintsize)\n\
         fast(x, v), any() :- speed(x, v), v > 0.1.\n",
    );
    write(folder.path(), "in.csv", "name,v\na,0.5\nb,0.1\n");
    let here = folder.path().to_str().unwrap();
    let output = with_input(["query", &rules, "-F", here, "-D", here], b"say \"c\"\t1e10\n");
    let expected =
        "---------------\nfast\nname\tv\n===============\na\t0.5\nsay \"c\"\t1e+10\n===============\nfast\t2\n";
    assert_eq!(
        (code(&output), out(&output).as_str()),
        (0, expected),
        "{}",
        err(&output)
    );
    assert!(err(&output).contains("warning[ignored]"), "{}", err(&output));
    let written = |name: &str| fs::read_to_string(folder.path().join(name)).unwrap();
    assert_eq!(written("out.csv"), "\"a\",0.5\n\"say \"\"c\"\"\",1e+10\n");
    assert_eq!(written("any.csv"), "()\n");

    let rules = write(
        folder.path(),
        "bad.dl",
        ".decl a(x: number)\n.input a(IO=sqlite)\na(x) :- a(y), x = y + \"1\".\n",
    );
    fails(
        &logicity(["query", &rules, "-F", here]),
        1,
        &["unsupported", "type-mismatch"],
    );
}

/// Rows go through JSON and Parquet and come back as the same text.
#[test]
fn query_reads_and_writes_json_and_tables() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path().to_str().unwrap();
    let declared = ".type P = [n: number, s: symbol]\n.decl a(n: number, u: unsigned, f: float, s: symbol, p: P)\n";
    let first = write(
        folder.path(),
        "first.dl",
        format!(
            "{declared}.input a\n\
             .output a(filename=\"text.csv\")\n\
             .output a(filename=\"a.parquet\")\n\
             .output a(IO=jsonfile, filename=\"list.json\")\n\
             .output a(IO=jsonfile, format=object)\n\
             .output a(IO=jsonfile, filename=\"list.json.gz\", compress=true)\n"
        ),
    );
    let rows = "-1\t4294967295\t0.5\tsay \"é\"\t[3, x]\n2\t0\t1e+10\t\tnil\n";
    write(folder.path(), "a.facts", rows);
    let output = logicity(["query", &first, "-F", here, "-D", here]);
    assert_eq!(code(&output), 0, "{}", err(&output));
    let written = |name: &str| fs::read_to_string(folder.path().join(name)).unwrap();
    assert_eq!(written("text.csv"), rows);
    assert_eq!(
        written("list.json"),
        "[[-1, 4294967295, 0.5, \"say \\\"é\\\"\", \"[3, x]\"],\n[2, 0, 1e+10, \"\", \"nil\"]]\n"
    );
    assert!(written("a.json").starts_with("[{\"n\": -1, \"u\": 4294967295, \"f\": 0.5, "));
    for (name, options) in [
        ("json", "(IO=jsonfile)"),
        ("compressed", "(IO=jsonfile, filename=\"list.json.gz\")"),
        ("table", "(format=parquet)"),
        ("named", "(filename=\"a.parquet\")"),
    ] {
        let rules = format!("{declared}.input a{options}\n.output a(filename=\"{name}.csv\")\n");
        let rules = write(folder.path(), &format!("{name}.dl"), &rules);
        let output = logicity(["query", &rules, "-F", here, "-D", here]);
        assert_eq!(
            (code(&output), written(&format!("{name}.csv"))),
            (0, rows.to_owned()),
            "{}",
            err(&output)
        );
    }
    // Columns of the same names in another order.
    let rules = ".decl a(u: unsigned, n: number, f: float, s: symbol, p: symbol)\n.input a(format=parquet)\n\
                 .output a(filename=\"by_name.csv\")\n";
    let rules = write(folder.path(), "by_name.dl", rules);
    assert_eq!(code(&logicity(["query", &rules, "-F", here, "-D", here])), 0);
    assert!(written("by_name.csv").ends_with("4294967295\t-1\t0.5\tsay \"é\"\t[3, x]\n"));

    for (declared, options, messages) in [
        (
            "a(n: number)",
            "(format=parquet)",
            vec!["invalid-fact", "expected the columns [n] of `a`, not [n, u"],
        ),
        (
            "a(n: number, u: number, f: float, s: symbol, p: symbol)",
            "(format=parquet)",
            vec!["row 0: column `u` of `a` holds numbers, not 4294967295", "a.parquet"],
        ),
        (
            "a(n: number, u: unsigned, f: float, s: unsigned, p: symbol)",
            "(IO=jsonfile)",
            vec![
                "column `s` of `a` holds unsigned numbers",
                "in line 1, column ",
                "a.json",
            ],
        ),
        (
            "a(n: number)",
            "(filename=\"a.parquet\", format=text)",
            vec!["not-text"],
        ),
        (
            "a(n: number)",
            "(filename=\"text.csv\", format=parquet)",
            vec!["not a readable Parquet table", "text.csv"],
        ),
        (
            "a(n: number)",
            "(filename=\"gone.parquet\")",
            vec!["gone.parquet", "no such file"],
        ),
        (
            "a(n: number)",
            "(IO=jsonfile, format=parquet)",
            vec!["unsupported", "use `list` or `object`"],
        ),
        (
            "a(n: number)",
            "(format=xml)",
            vec!["unsupported", "`text` or `parquet`"],
        ),
    ] {
        let rules = write(
            folder.path(),
            "bad.dl",
            format!(".decl {declared}\n.input a{options}\n.output a\n"),
        );
        let output = logicity(["query", &rules, "-F", here, "-D", here]);
        assert_ne!(code(&output), 0, "{options}");
        for message in messages {
            assert!(err(&output).contains(message), "{options}: {message}\n{}", err(&output));
        }
    }
    // A table that ends early is refused.
    let table = fs::read(folder.path().join("a.parquet")).unwrap();
    let rules = format!("{declared}.input a(filename=\"damaged.parquet\")\n.output a(IO=stdout)\n");
    let rules = write(folder.path(), "damaged.dl", &rules);
    for at in (0..table.len()).step_by(table.len() / 12) {
        fs::write(folder.path().join("damaged.parquet"), &table[..at]).unwrap();
        let output = logicity(["query", &rules, "-F", here]);
        assert_eq!(code(&output), 1, "{at}: {}", err(&output));
    }
}

#[test]
fn query_reads_rows_as_souffle_writes_them() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path().to_str().unwrap();
    let rules = write(
        folder.path(),
        "main.dl",
        ".decl note(who: symbol, text: symbol, n: number)\n\
         .input note(rfc4180=true)\n\
         .decl any()\n\
         .input any\n\
         .decl none()\n\
         .input none\n\
         .decl edge(x: number, y: number)\n\
         .input edge\n\
         .decl out(who: symbol, text: symbol)\n\
         .output out(rfc4180=true, compress=true)\n\
         .printsize any, none, edge\n\
         out(x, y) :- note(x, y, n), edge(n, _).\n",
    );
    // A quoted value extends over lines, and a number may be quoted. An empty line is the row of a predicate without
    // columns. The facts of `edge` are compressed.
    write(
        folder.path(),
        "note.facts",
        "\"a\",\"two\r\nlines, \"\"quoted\"\"\",\"1\"\r\nb,5\" pipe,1\n",
    );
    write(folder.path(), "any.facts", "\n");
    write(folder.path(), "none.facts", "");
    let mut compressed = GzEncoder::new(Vec::new(), Compression::default());
    compressed.write_all(b"1\t2\n").unwrap();
    let compressed = compressed.finish().unwrap();
    fs::write(folder.path().join("edge.facts.gz"), &compressed).unwrap();

    let output = logicity(["query", &rules, "-F", here, "-D", here]);
    assert_eq!((code(&output), err(&output)), (0, format!("wrote {here}/out.csv.gz\n")));
    assert_eq!(out(&output), "any\t1\nnone\t0\nedge\t1\n");
    let mut text = String::new();
    let written = fs::File::open(folder.path().join("out.csv.gz")).unwrap();
    GzDecoder::new(written).read_to_string(&mut text).unwrap();
    assert_eq!(text, "\"a\",\"two\r\nlines, \"\"quoted\"\"\"\n\"b\",\"5\"\" pipe\"\n");

    // A truncated file and faulty quotes.
    fs::write(folder.path().join("edge.facts.gz"), &compressed[..compressed.len() - 9]).unwrap();
    fails(&logicity(["query", &rules, "-F", here]), 2, &["edge.facts.gz"]);
    fs::write(folder.path().join("edge.facts.gz"), &compressed).unwrap();
    write(folder.path(), "note.facts", "\"a\"b,c,1\nd,\"e,2\nf,g,3\n");
    let output = logicity(["query", &rules, "-F", here]);
    fails(&output, 1, &["note.facts:1:4", "note.facts:2:3", "2 errors"]);
}

#[test]
fn a_million_facts_load() {
    let folder = tempfile::tempdir().unwrap();
    let rules = write(
        folder.path(),
        "big.dl",
        ".decl e(x: number, y: number)\n.input e\n.decl twice(x: number)\n.printsize twice\ntwice(x) :- e(x, y), e(y, x).\n",
    );
    let facts: String = (0..1_000_000).map(|n| format!("{n}\t{}\n", n ^ 1)).collect();
    write(folder.path(), "e.facts", facts);
    let here = folder.path().to_str().unwrap();
    let output = logicity(["query", &rules, "-F", here, "-D", here]);
    assert_eq!(
        (code(&output), out(&output).as_str()),
        (0, "twice\t1000000\n"),
        "{}",
        err(&output)
    );
}

#[test]
fn a_faulty_scene_still_gives_one_line() {
    let scene = r#"{"entities":["e0","e1"],"ego":"e0","facts":{"IsCar":["e0"],"HigherPri":[["e1","e0"]]}}"#;
    let faulty = [
        "{",
        "[1,2]",
        r#"{"map":"square-5x5"}"#,
        r#"{"map":"nowhere","agents":[]}"#,
        r#"{"map":"square-5x5","agents":[{"id":"a","type":"Bird","at":[1,1]}]}"#,
        r#"{"map":"square-5x5","agents":[{"id":"a","type":"Car","at":[1,99999]}]}"#,
        r#"{"map":"square-5x5","agents":[{"id":"a","type":"Car","at":[1,99999999999999999999]}]}"#,
        r#"{"map":"square-5x5","agents":[{"id":"a","type":"Car","at":[1,1]},{"id":"a","type":"Car","at":[1,1]}]}"#,
        r#"{"map":"square-5x5","agents":[{"id":"a","type":"Car","at":[1,1],"concepts":["ambulence"]}]}"#,
        r#"{"map":"square-5x5","agents":[{"id":"a","type":"Car","at":[1,1]}],"egos":["b"]}"#,
        r#"{"map":"square-5x5","agents":[{"id":"a","type":"Car","at":[1,1]}],"given":{"IsClose":[["a"]]}}"#,
        r#"{"map":"square-5x5","agents":[{"id":"a","type":"Car","at":[1,1]}],"given":{"IsClosed":[]}}"#,
        r#"{"entities":["e0"],"ego":"e1"}"#,
    ];
    for line in faulty {
        let input = format!("{scene}\n{line}\n{scene}\n");
        let output = with_input(["infer"], input.as_bytes());
        fails(&output, 1, &["invalid-scene"]);
        if !line.contains("nowhere") {
            assert!(err(&output).contains("<stdin>:2:"), "{line}\n{}", err(&output));
        }
        let answers: Vec<Value> = out(&output)
            .lines()
            .map(|line| serde_json::from_str(line).unwrap())
            .collect();
        assert_eq!(answers.len(), 3);
        assert_eq!(answers[0], answers[2]);
        assert_eq!(answers[0]["egos"]["e0"]["action"], "Normal");
        assert_eq!(answers[1]["error"][0]["code"], "invalid-scene", "{line}");
    }
    let many = r#"{"map":"/etc/hosts","agents":[{"id":"a","type":"Lorry","at":[1],"priority":"x"},{"id":"b","type":"Car","at":[1,1],"heading":"North"}]}"#;
    let output = with_input(["infer"], many.as_bytes());
    fails(&output, 1, &["not a map", "`Lorry`", "`North`", "5 errors"]);
    fails(&with_input(["infer"], b"{}"), 1, &["\"agents\"", "\"entities\""]);
    fails(&with_input(["infer"], b"5"), 1, &["a scene is a JSON object"]);
    let deep = "[".repeat(100_000);
    fails(&with_input(["infer"], deep.as_bytes()), 1, &["invalid-scene"]);
}

#[test]
fn a_scene_names_the_map_of_a_configuration() {
    let scene = |map: &str| format!(r#"{{"map": {map}, "agents": [{{"id": "a", "type": "Car", "at": [25, 8]}}]}}"#);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("town.yaml");
    let config = "base: expert\nmap: {blocks: [1, 1], buildings: {rows: [HO, SG]}}\n";
    fs::write(&path, config).unwrap();
    let town = format!(r#"{{"config": {}}}"#, Value::from(path.to_str().unwrap()));
    let lines = [
        scene(r#""square-5x5""#),
        scene(r#"{"config": "expert"}"#),
        scene(r#"{"config": "school-zone"}"#),
        scene(&town),
    ];
    let output = with_input(["infer"], lines.join("\n").as_bytes());
    assert_eq!(code(&output), 0, "{}", err(&output));
    let answers: Vec<String> = out(&output).lines().map(str::to_owned).collect();
    assert_eq!((answers.len(), &answers[0]), (4, &answers[1]));
    for (map, place, words) in [
        (
            r#"{"config": "nowhere"}"#,
            ":1:9",
            "the map of the configuration `nowhere` cannot be used",
        ),
        (r#"{"config": "/etc/hosts"}"#, ":1:20", "not a configuration"),
        (r#"{"config": 5}"#, ":1:20", "expected a string"),
        (r#"{"file": "a"}"#, ":1:", "unknown field `file`"),
    ] {
        let output = with_input(["infer"], scene(map).as_bytes());
        fails(&output, 1, &["invalid-scene", place, words]);
    }
    // The road of one block ends before this cell.
    let off = scene(&town).replace("[25, 8]", "[25, 90]");
    fails(&with_input(["infer"], off.as_bytes()), 1, &["is not on the map"]);
    // Nor can an agent be in a building.
    for (kind, street) in [("Car", "a street"), ("Pedestrian", "a sidewalk")] {
        let inside = format!(
            "{{\"map\": \"square-5x5\", \"agents\": [{{\"id\": \"A\", \"type\": \"{kind}\", \"at\": [20, 20]}}]}}"
        );
        let words = [
            "`A` is in a building of the map `square-5x5`",
            "[20, 20]",
            "the nearest cell on ",
            street,
        ];
        fails(&with_input(["infer"], inside.as_bytes()), 1, &words);
    }
}

/// Constraints are not rules: commands report violations only with `--check-constraints`.
#[test]
fn constraints_are_checked_on_request() {
    let bus = r#"{"entities":["e0","e1"],"ego":"e0","facts":{"IsPedestrian":["e0","e1"],"IsBus":["e1"]}}"#;
    let car = r#"{"entities":["e0","e1"],"ego":"e0","facts":{"IsBus":["e1"],"IsCar":["e0","e1"]}}"#;
    let input = format!("{bus}\n{car}\n");
    let plain = with_input(["infer"], input.as_bytes());
    assert_eq!(plain.status.code(), Some(0), "{}", err(&plain));
    let checked = with_input(["infer", "--check-constraints"], input.as_bytes());
    fails(
        &checked,
        1,
        &[
            "constraint-violation",
            "`IsBus(\"e1\")` holds, `IsCar(\"e1\")` does not",
            "<stdin>:1:",
        ],
    );
    let answers = |output: &Output| -> Vec<Value> {
        out(output)
            .lines()
            .map(|line| serde_json::from_str(line).unwrap())
            .collect()
    };
    assert_eq!(answers(&checked)[0]["error"][0]["code"], "constraint-violation");
    assert_eq!(answers(&checked)[1], answers(&plain)[1]);

    let folder = tempfile::tempdir().unwrap();
    let rules = write(
        folder.path(),
        "odd.dl",
        ".include \"expert.dl\"\n.disjoint IsCar, IsPedestrian, IsTiro\n.irreflexive Sees\n",
    );
    let to = folder.path().join("out").to_str().unwrap().to_owned();
    let unchecked = logicity([
        "run",
        "configs/expert.yaml",
        "--ticks",
        "3",
        "--no-pictures",
        "--out",
        &to,
        "--rules",
        &rules,
    ]);
    assert_eq!(unchecked.status.code(), Some(0), "{}", err(&unchecked));
    let check = "--check-constraints";
    let kept = logicity([
        "run",
        "configs/expert.yaml",
        "--ticks",
        "3",
        "--no-pictures",
        "--out",
        &to,
        "--rules",
        "rules/expert.dl",
        check,
    ]);
    assert_eq!(kept.status.code(), Some(0), "{}", err(&kept));
    let output = logicity([
        "run",
        "configs/expert.yaml",
        "--ticks",
        "3",
        "--no-pictures",
        "--out",
        &to,
        "--rules",
        &rules,
        check,
    ]);
    fails(
        &output,
        1,
        &[
            "constraint-violation",
            "odd.dl:3:1",
            "first violated in tick 0; violated in 3 of 3 ticks",
        ],
    );
    assert!(out(&output).contains("3 ticks"), "the summary is still printed");
}

#[test]
fn scenes_beyond_the_limits_are_reported_and_the_next_scene_gets_an_answer() {
    let scene = r#"{"entities":["e0"],"ego":"e0"}"#;
    let names: Vec<String> = (0..2001).map(|number| format!("\"e{number}\"")).collect();
    let crowd = format!(r#"{{"entities":[{}],"ego":"e0"}}"#, names.join(","));
    let long = format!("{scene}{}", " ".repeat(70 << 20));
    let keys: String = (0..100_000).map(|number| format!("\"k{number}\":0,")).collect();
    let keys = format!("{{{keys}\"k\":0}}");
    for (line, code) in [
        (crowd, "limit-exceeded"),
        (long, "limit-exceeded"),
        (keys, "invalid-scene"),
    ] {
        let output = with_input(["infer"], format!("{line}\n{scene}\n").as_bytes());
        fails(&output, 1, &[code]);
        let answers: Vec<Value> = out(&output)
            .lines()
            .map(|line| serde_json::from_str(line).unwrap())
            .collect();
        assert_eq!(
            (answers.len(), &answers[0]["error"][0]["code"]),
            (2, &Value::from(code))
        );
        assert_eq!(answers[1]["egos"]["e0"]["action"], "Normal");
    }
}

/// `check` accepts only rules that can be evaluated.
#[test]
fn check_reports_rules_too_large_to_evaluate() {
    let folder = tempfile::tempdir().unwrap();
    let columns: Vec<String> = (0..40).map(|number| format!("c{number}: number")).collect();
    let text = format!(".decl wide({})\n.output wide\n", columns.join(", "));
    let file = write(folder.path(), "wide.dl", text);
    fails(&logicity(["check", &file]), 1, &["limit-exceeded", "wide.dl:1"]);
    fails(&logicity(["query", &file]), 1, &["limit-exceeded", "wide.dl:1"]);
}

#[test]
fn route_prints_the_cells() {
    let output = logicity(["route", "--type", "pedestrian", "--from", "26,20", "--to", "86,61"]);
    let text = out(&output);
    assert_eq!(
        (code(&output), text.lines().next(), text.lines().last()),
        (0, Some("26,20"), Some("86,61"))
    );
    assert_eq!(text.lines().count(), 1 + 60 + 41);
    fails(
        &logicity(["route", "--type", "car", "--from", "0,0", "--to", "46,34"]),
        2,
        &["no-route"],
    );
    fails(
        &logicity(["route", "--type", "car", "--from=-1,0", "--to", "46,999999"]),
        2,
        &["no-route"],
    );
}

#[test]
fn impossible_cities_are_reported() {
    let folder = tempfile::tempdir().unwrap();
    let config = |changes: &str| {
        let config = format!("base: configs/expert.yaml\n{changes}");
        write(folder.path(), "mine.yaml", config)
    };
    let agents = |cars: &str| format!("agents:\n  test:\n    cars: {cars}\n    pedestrians: []\n");
    fails(
        &logicity(["run", &config(&agents("[]"))]),
        1,
        &["mine.yaml:", "no agents"],
    );
    fails(
        &logicity(["run", &config("region: {test: 1}\n")]),
        1,
        &["no-start-cell", "mine.yaml:2"],
    );
    fails(
        &logicity(["run", &config("region: {test: 1000000000000}\n")]),
        1,
        &["invalid-value", "mine.yaml:2"],
    );
    fails(
        &logicity(["run", &config("regoin: {test: 1}\n")]),
        1,
        &["unknown-key", "did you mean `region`", "mine.yaml:2:1"],
    );
    let huge = "map: {blocks: [1000000000, 1000000000], buildings: {random: {seed: 1}}}\n";
    let output = logicity(["run", &config(huge)]);
    fails(&output, 1, &["mine.yaml:2"]);
    let many = agents("[{priority: 1, count: 1000}]");
    fails(
        &logicity(["run", &config(&many)]),
        1,
        &["no-start-cell", "or fewer cars"],
    );
    let repeated = "region: ~\nagents: {test: {cars: [{priority: 1}], pedestrians: [], repeat: 100000}}\n";
    fails(
        &logicity(["run", &config(repeated)]),
        1,
        &["no-start-cell", "use a larger map, or a smaller `repeat`"],
    );
    let map = "blocks: [30, 30]\nwidths: {street: 11, sidewalk: 5, building: 10, inner_sidewalk: 5}\n\
               buildings: {random: {seed: 1, weights: {House: 1, Garage: 1}}}\n";
    write(folder.path(), "big.yaml", map);
    let crowd = format!("map: big.yaml\nregion: ~\n{}", agents("[{priority: 1, count: 3000}]"));
    fails(
        &logicity(["run", &config(&crowd), "--executor", "relational"]),
        1,
        &["limit-exceeded", "the limit of the relational executor", "mine.yaml:5"],
    );
}

/// `columns` selects columns; the reader ignores the other values of a row.
#[test]
fn query_reads_the_requested_columns() {
    let folder = tempfile::tempdir().unwrap();
    let rules = write(
        folder.path(),
        "main.dl",
        ".decl a(x: number, y: symbol)\n.input a(columns=\"2:0\", delimiter=\",\")\n.output a\n",
    );
    let here = folder.path().to_str().unwrap();
    write(folder.path(), "a.facts", "p,?,1\nq,,2,more\n");
    let output = logicity(["query", &rules, "-F", here, "-D", "-"]);
    let expected = "---------------\na\nx\ty\n===============\n1\tp\n2\tq\n===============\n";
    assert_eq!(
        (code(&output), out(&output).as_str()),
        (0, expected),
        "{}",
        err(&output)
    );

    write(folder.path(), "a.facts", "p,?,1\nq,2\nr,,s\n");
    let output = logicity(["query", &rules, "-F", here, "-D", "-"]);
    fails(
        &output,
        1,
        &[
            "invalid-fact",
            "a.facts:2:1",
            "a row of 2 values where value 2 is read",
            "a.facts:3:4",
        ],
    );
}

/// Parses a measurement, by key. The documents must explain each key.
fn measured(output: &Output) -> Value {
    assert_eq!(code(output), 0, "{}", err(output));
    let printed: Value = serde_json::from_str(&out(output)).unwrap();
    let page = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/how-to/measure-speed.md");
    let page = fs::read_to_string(page).unwrap();
    let (_, keys) = page
        .split_once("## Keys of `bench --json`")
        .expect("a list of the keys");
    for key in printed.as_object().unwrap().keys() {
        let unit = key.trim_end_matches("_per_cpu_s").trim_end_matches("_per_s");
        let known = |name: &str| keys.contains(&format!("`{name}`"));
        assert!(
            known(key) || known(unit),
            "docs/how-to/measure-speed.md does not explain `{key}`"
        );
    }
    printed
}

#[test]
fn bench_measures_the_requested_case() {
    let bench = |arguments: &[&str]| {
        let mut all = vec!["bench"];
        all.extend(arguments);
        all.extend(["--seconds", "0.05", "--json"]);
        run(&all, b"")
    };
    // `--agents` repeats the list of 18 agents, whatever the configuration's `repeat` is.
    for config in ["configs/metropolis.yaml", "configs/expert.yaml"] {
        let printed = measured(&bench(&["tick", "--config", config, "--agents", "300"]));
        assert_eq!(
            (&printed["agents"], &printed["threads"]),
            (&306.into(), &1.into()),
            "{config}"
        );
        assert!(printed["ticks"].as_u64() > Some(0));
    }
    let several = |agents| measured(&bench(&["tick", "--agents", agents, "--threads", "2"]))["threads"].clone();
    assert_eq!((several("18"), several("300")), (1.into(), 2.into()));
    for what in ["infer", "ground"] {
        let printed = measured(&bench(&[what]));
        assert_eq!(
            (&printed["agents"], &printed["executor"]),
            (&18.into(), &"dense".into()),
            "{what}"
        );
        fails(
            &bench(&[what, "--threads", "2"]),
            2,
            &["--threads is for `bench tick|scale` only"],
        );
    }
    assert_eq!(measured(&bench(&["infer"]))["states"], 64);
    fails(
        &bench(&["ground", "--agents", "300"]),
        2,
        &["up to 256 agents", "306", "--agents"],
    );
    fails(
        &bench(&["ground", "--executor", "relational"]),
        2,
        &["omit --executor relational"],
    );
    fails(&bench(&["infer", "--agents", "5000"]), 2, &["4096", "--agents"]);
    // A rule file replaces that of the configuration.
    let own = "tests/fixtures/rules/traffic-code.dl";
    for what in ["infer", "tick", "env"] {
        let printed = measured(&bench(&[what, "--rules", own]));
        assert_eq!(printed["rules"], own, "{what}");
    }
    fails(&bench(&["tick", "--rules", "none.dl"]), 2, &["cannot read `none.dl`"]);
    let printed = measured(&bench(&["env"]));
    assert_eq!(printed["rules"], Value::Null);
    assert!(
        printed["what"] == "env" && printed["steps"].as_u64() > Some(0),
        "{printed}"
    );
    fails(
        &bench(&["env", "--config", "vap-easy"]),
        1,
        &["has no `task`", "tasks/expert.yaml"],
    );
}

/// `make` writes the file of the repository and leaves no partial file. `show` prints the results of the oracle.
#[test]
fn episodes_are_made_checked_and_shown() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("mine.jsonl");
    let episodes = |arguments: &[&str]| run(&[&["episodes"], arguments].concat(), b"");
    let ok = |output: &Output| {
        assert_eq!(code(output), 0, "{}", err(output));
        out(output)
    };
    let output = file.to_str().unwrap();
    let made = ok(&episodes(&["make", "easy", "--split", "val", "--output", output]));
    let shipped = fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/configs/episodes/easy-val.jsonl")).unwrap();
    assert!(fs::read_to_string(&file).unwrap() == shipped, "made with seed 0");
    let hash = made.rsplit(' ').next().unwrap().trim();
    assert!(ok(&episodes(&["check", "easy", "--split", "val"])).contains(hash));
    let shown = ok(&episodes(&["show", "easy", "--split", "val", "--json"]));
    let shown: Value = serde_json::from_str(&shown).unwrap();
    assert_eq!(
        (&shown["hash"], &shown["oracle"]["tsr"]["value"]),
        (&hash.into(), &1.0.into())
    );
    assert!(shown["random"]["tsr"]["value"].as_f64() < Some(0.3));
    let spread = ok(&episodes(&[
        "spread", "easy", "--split", "val", "--sets", "3", "--count", "5", "--json",
    ]));
    let spread: Value = serde_json::from_str(&spread).unwrap();
    let score = |part: &str| spread["measures"]["score"][part].as_f64().unwrap();
    assert!(score("min") < score("mean") && score("mean") < score("max") && score("standard_deviation") > 0.0);
    assert!(ok(&episodes(&["show", "easy", "--episode", "3"])).contains("Pedestrian_2"));
    fails(
        &episodes(&["show", "easy", "--episode", "100"]),
        2,
        &["the numbers are 0 to 99"],
    );
    fails(&episodes(&["check", "vap-easy"]), 1, &["has no `task`"]);
    fails(
        &episodes(&["make", "easy", "--output", "/nowhere/x.jsonl"]),
        2,
        &["/nowhere/x.jsonl"],
    );
    // Under other rules, the oracle's results differ.
    fails(
        &episodes(&["check", "easy", "--rules", "rules/expert.dl"]),
        1,
        &["error"],
    );
}

#[test]
fn bench_takes_scenes() {
    let scene = r#"{"entities":["e0","e1"],"ego":"e0","facts":{"IsCar":["e0"]}}"#;
    let folder = tempfile::tempdir().unwrap();
    let file = write(folder.path(), "scenes.jsonl", format!("{scene}\n\n{scene}\n"));
    let bench = |file: &str, more: &[&str], input: &[u8]| {
        let mut all = vec!["bench", "infer", "--seconds", "0.05", "--json", "--scenes", file];
        all.extend(more);
        run(&all, input)
    };
    let printed = measured(&bench(&file, &[], b""));
    assert_eq!((&printed["scenes"], &printed["entities"]), (&2.into(), &2.into()));
    assert_eq!(measured(&bench("-", &[], scene.as_bytes()))["scenes"], 1);
    for more in [["--agents", "20"], ["--split", "val"], ["--threads", "2"]] {
        fails(&bench(&file, &more, b""), 2, &[more[0], "--scenes"]);
    }
    fails(
        &bench("-", &[], b" \n"),
        1,
        &["invalid-scene", "`<stdin>` contains no scene"],
    );
    fails(&bench("-", &[], b"{}"), 1, &["invalid-scene", "<stdin>:1"]);
    let names: Vec<String> = (0..65).map(|number| format!("\"e{number}\"")).collect();
    let crowd = format!(r#"{{"entities":[{}],"ego":"e0"}}"#, names.join(","));
    fails(
        &bench("-", &[], crowd.as_bytes()),
        1,
        &["limit-exceeded", "65 entities; the limit is 64"],
    );
    let relational = ["--executor", "relational"];
    let printed = measured(&bench("-", &relational, crowd.as_bytes()));
    assert_eq!(
        (&printed["entities"], &printed["executor"]),
        (&65.into(), &"relational".into())
    );
    // The dense executor takes no recursive rules.
    let rules = write(
        folder.path(),
        "far.dl",
        ".include \"vocabulary.dl\"\n.decl Far(x: agent, y: agent)\nFar(X, Y) :- NextTo(X, Y).\n\
         Far(X, Z) :- Far(X, Y), NextTo(Y, Z).\nStop(X) :- Far(X, Y), IsBus(Y).\n",
    );
    let config = write(
        folder.path(),
        "far.yaml",
        format!(
            "base: {}/configs/expert.yaml\nrules: {rules}\n",
            env!("CARGO_MANIFEST_DIR")
        ),
    );
    let output = bench(&file, &["--config", &config], b"");
    assert_eq!(measured(&output)["executor"], "relational");
    let output = bench(&file, &["--config", &config, "--executor", "dense"], b"");
    fails(&output, 1, &["because `Far` depends on itself", "far.dl:4:14"]);
}

/// Seven groups without predicates inside have no clique of eight; to find out takes the dense executor more steps than
/// it may take. The relational one begins with the entity that is both car and
/// pedestrian.
#[test]
fn infer_falls_back_to_the_relational_executor() {
    let folder = tempfile::tempdir().unwrap();
    let names = ["A", "B", "C", "D", "E", "F", "G", "H"];
    let chain: Vec<String> = (1..9).map(|at| format!("NextTo(P{at}, P{})", at + 1)).collect();
    let pairs: Vec<String> = (names.iter().enumerate())
        .flat_map(|(at, one)| {
            names[at + 1..]
                .iter()
                .map(move |other| format!("IsClose({one}, {other})"))
        })
        .collect();
    let text = format!(
        ".include \"vocabulary.dl\"\n/// CL: a clique\nStop(X) :- IsCar(X), IsCar(P1), IsPedestrian(P1), {}, {}.\n",
        chain.join(", "),
        pairs.join(", ")
    );
    let rules = write(folder.path(), "clique.dl", text);
    let entities: Vec<String> = (0..14).map(|entity| format!("e{entity}")).collect();
    let close: Vec<[&String; 2]> = (0..14 * 14)
        .map(|pair| (pair / 14, pair % 14))
        .filter(|(x, y)| x % 7 != y % 7)
        .map(|(x, y)| [&entities[x], &entities[y]])
        .collect();
    let facts = serde_json::json!({
        "IsCar": ["e0", "e1"],
        "IsPedestrian": ["e2"],
        "IsClose": close,
        "NextTo": [["e0", "e1"], ["e1", "e0"]],
    });
    let scene = serde_json::json!({ "entities": entities, "ego": "e0", "facts": facts }).to_string();
    let infer = |executor: &str| with_input(["infer", "--rules", &rules, "--executor", executor], scene.as_bytes());

    let auto = infer("auto");
    assert_eq!(code(&auto), 0, "{}", err(&auto));
    let words = [
        "note: the relational executor decided line 1",
        "took more than 1048576 steps",
    ];
    assert!(words.iter().all(|words| err(&auto).contains(words)), "{}", err(&auto));
    let relational = infer("relational");
    assert_eq!((out(&auto), err(&relational)), (out(&relational), String::new()));
    fails(&infer("dense"), 1, &["limit-exceeded", "gave up", "--executor auto"]);
    // Without an edge there is nothing to search.
    let easy = scene.replace("IsClose", "LeftOf");
    let easy = with_input(["infer", "--rules", &rules], easy.as_bytes());
    assert_eq!((code(&easy), err(&easy)), (0, String::new()));

    let check = logicity(["check", &rules]);
    assert!(
        out(&check).contains("executor: dense\n    relational if 64 agents or more"),
        "{}",
        out(&check)
    );
    assert!(out(&check).contains("CL: a clique"), "{}", out(&check));
    let check: serde_json::Value = serde_json::from_str(&out(&logicity(["check", "--json", &rules]))).unwrap();
    let costly = check["costly"].as_array().unwrap();
    assert_eq!(
        (costly.len(), &costly[0]["doc"]),
        (1, &serde_json::json!("CL: a clique"))
    );
    let check: serde_json::Value =
        serde_json::from_str(&out(&logicity(["check", "--json", "rules/expert.dl"]))).unwrap();
    assert_eq!(check["costly"], serde_json::json!([]));
}

#[test]
fn query_unfolds_and_restricts() {
    let folder = tempfile::tempdir().unwrap();
    let text = ".decl A(x: number)\n.decl Pair(x: number, y: number) inline\n.decl B(x: number, y: number)\n\
        .decl Path(x: number, y: number) magic\n.output B\n\
        A(x) :- x = range(0, 3000).\nPair(x, y) :- A(x), A(y).\n\
        B(x, y) :- Pair(x, y), x + y = 2.\n\
        Path(x, x + 1) :- A(x).\nPath(x, z) :- Path(x, y), Path(y, z).\n\
        B(-1, y) :- Path(2990, y).\n";
    let rules = write(folder.path(), "rules.dl", text);
    let query = |more: &[&str]| {
        run(
            &[&["query", &rules, "-D", "-", "--max-rows", "20000"], more].concat(),
            b"",
        )
    };
    let output = query(&[]);
    assert_eq!(code(&output), 0, "{}", err(&output));
    assert!(
        out(&output).contains("\n2\t0\n") && out(&output).contains("\n-1\t3000\n"),
        "{}",
        out(&output)
    );
    // An explanation evaluates the clauses as they are written.
    fails(&query(&["--explain", "B(1, 1)"]), 1, &["limit-exceeded"]);

    let large = write(folder.path(), "large.dl", text.replace(" magic", ""));
    let output = logicity(["query", &large, "-D", "-", "--max-rows", "20000"]);
    fails(&output, 1, &["limit-exceeded", "magic-transform"]);
    // An aggregate needs the rows.
    let counted = text
        .replace("x + y = 2", "x + y = count : { Pair(_, _) }")
        .replace("3000", "9");
    let output = logicity(["query", &write(folder.path(), "counted.dl", counted), "-D", "-"]);
    assert!(
        err(&output).contains("warning[ignored]: `Pair` is inline"),
        "{}",
        err(&output)
    );
}

#[test]
fn the_summary_names_the_executor() {
    let folder = tempfile::tempdir().unwrap();
    let rules = write(
        folder.path(),
        "far.dl",
        ".include \"vocabulary.dl\"\n.decl Far(x: agent, y: agent)\nFar(X, Y) :- NextTo(X, Y).\n\
         Far(X, Z) :- Far(X, Y), NextTo(Y, Z).\nStop(X) :- Far(X, Y), IsBus(Y).\n",
    );
    let summary = |more: &[&str]| {
        let mut all = vec!["run", "expert", "--ticks", "2", "--no-trace"];
        all.extend(more);
        let output = run(&all, b"");
        assert_eq!(code(&output), 0, "{}", err(&output));
        out(&output)
    };
    assert!(summary(&["--threads", "2"]).contains("\ndense executor, 1 thread\n"));
    assert!(summary(&["--executor", "relational"]).contains("\nrelational executor, 1 thread\n"));
    let reason = "dense executor, 1 thread: the relational executor evaluates some clauses, the first because `Far` \
                  depends on itself at ";
    let summary = summary(&["--rules", &rules]);
    assert!(
        summary.contains(reason) && summary.contains("far.dl:4:14\n"),
        "{summary}"
    );
}

#[test]
fn slow_icons_come_from_a_pack_and_its_faults_are_reported() {
    let folder = tempfile::tempdir().unwrap();
    let sheet = |arguments: &[&str], name: &str| {
        let path = folder.path().join(name);
        let all = [&["icons", "sheet", "-o", path.to_str().unwrap()], arguments].concat();
        (run(&all, b""), fs::read(path).unwrap_or_default())
    };
    let (output, drawn) = sheet(&["--class", "bus+tiro", "--seed", "2"], "drawn.png");
    assert_eq!(code(&output), 0, "{}", err(&output));
    assert!(drawn.starts_with(b"\x89PNG"));
    assert!(sheet(&["--class", "bus+tiro", "--seed", "2"], "again.png").1 == drawn);
    assert!(sheet(&["--class", "bus+tiro", "--seed", "3"], "other.png").1 != drawn);
    assert!(
        sheet(
            &["--class", "bus+tiro", "--seed", "2", "--difficulty", "40"],
            "noisy.png"
        )
        .1 != drawn
    );

    // Only above difficulty 50, the test split has a style of its own; version 1 has none.
    for (more, differs) in [
        (&["--difficulty", "50"][..], false),
        (&["--difficulty", "100"], true),
        (&["--difficulty", "100", "--drawing-version", "1"], false),
    ] {
        let [train, test] = ["train", "test"].map(|split| {
            let name = format!("{split}{}.png", more.join(""));
            sheet(&[more, &["--split", split]].concat(), &name).1
        });
        assert_eq!(train != test, differs, "{more:?}");
    }

    let pack = folder.path().join("pack");
    fs::create_dir_all(pack.join("police")).unwrap();
    let svg = r#"<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 2 4"><rect width="2" height="4"/></svg>"#;
    write(&pack, "police/black.svg", svg);
    write(&pack, "README", "beside the folders");
    let pack_path = pack.to_str().unwrap();
    let (output, extended) = sheet(&["--pack", pack_path], "extended.png");
    assert_eq!(code(&output), 0, "{}", err(&output));
    assert!(
        err(&output).contains("has no icons for car, ambulance, bus, tiro"),
        "{}",
        err(&output)
    );
    let (_, replaced) = sheet(&["--pack", pack_path, "--pack-mode", "replace"], "replaced.png");
    assert!(!replaced.is_empty() && replaced != extended);

    let out = folder.path().join("out");
    let out = out.to_str().unwrap();
    let output = logicity([
        "run",
        "configs/easy.yaml",
        "--ticks",
        "3",
        "--pack",
        pack_path,
        "--out",
        out,
    ]);
    assert_eq!(code(&output), 0, "{}", err(&output));

    let broken = write(&pack, "police/white.png", "not a picture");
    fs::create_dir(pack.join("plane")).unwrap();
    write(&pack, "plane/1.svg", svg);
    let (output, _) = sheet(&["--pack", pack_path], "broken.png");
    fails(
        &output,
        1,
        &[&broken, "not a valid PNG", "plane/1.svg", "unknown class `plane`"],
    );
    let (output, _) = sheet(&["--pack", "nowhere"], "none.png");
    fails(&output, 2, &["`nowhere`", "no such folder"]);
    for (option, value, printed) in [
        ("--difficulty", "101", "0 to 100"),
        ("--drawing-version", "3", "expected 1 or 2"),
        ("--class", "plane", "concepts joined by `+`"),
    ] {
        let (output, _) = sheet(&[option, value], "wrong.png");
        fails(&output, 2, &[printed]);
    }
}

/// A predicate that the configuration computes but that is no input of the rules would stay empty.
#[test]
fn a_predicate_that_is_never_filled_is_reported() {
    let folder = tempfile::tempdir().unwrap();
    let rules = ".include \"vocabulary.dl\"\n.decl IsTaxi(x: agent)\nStop(X) :- IsTaxi(X).\n";
    write(folder.path(), "taxi.dl", rules);
    let config =
        "base: configs/expert.yaml\nrules: taxi.dl\npredicates: {define: {IsTaxi: {concept: taxi, of: Car}}}\n";
    let config = write(folder.path(), "taxis.yaml", config);
    fails(
        &run(&["run", &config, "--no-trace", "--ticks", "1"], b""),
        1,
        &[
            "rule-mismatch",
            "`IsTaxi` is never filled",
            "write `.input IsTaxi`",
            "taxi.dl:2:7",
        ],
    );
    let page = folder.path().join("no/such/city.html");
    let page = page.to_str().unwrap();
    let out = folder.path().to_str().unwrap();
    fails(
        &run(
            &[
                "run",
                "easy",
                "--ticks",
                "1",
                "--no-pictures",
                "--out",
                out,
                "--html",
                page,
            ],
            b"",
        ),
        2,
        &["there is no folder", "no/such"],
    );
}

#[test]
fn fmt_writes_checks_and_pipes() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("a.dl");
    std::fs::write(&file, "A(1) .\n").unwrap();
    let run = |arguments: &[&str]| {
        Command::new(env!("CARGO_BIN_EXE_logicity"))
            .arg("fmt")
            .args(arguments)
            .arg(&file)
            .output()
            .unwrap()
    };
    let output = run(&["--check"]);
    assert_eq!(output.status.code(), Some(1));
    assert!(String::from_utf8(output.stdout).unwrap().contains("a.dl"));
    assert_eq!(std::fs::read_to_string(&file).unwrap(), "A(1) .\n");
    assert_eq!(run(&[]).status.code(), Some(0));
    assert_eq!(std::fs::read_to_string(&file).unwrap(), "A(1).\n");
    assert_eq!(run(&["--check"]).status.code(), Some(0));
    std::fs::write(&file, "A(1").unwrap();
    assert_eq!(run(&[]).status.code(), Some(1));
    assert_eq!(std::fs::read_to_string(&file).unwrap(), "A(1");
}

/// The scene that `check` prints is valid input of `infer`.
#[test]
fn infer_accepts_the_scene_of_check() {
    let folder = tempfile::tempdir().unwrap();
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let command = "logicity check rules/vap-hard.dl | grep '^ *{' | logicity infer --config configs/vap-hard.yaml";
    let program = Path::new(env!("CARGO_BIN_EXE_logicity")).parent().unwrap();
    let output = std::process::Command::new("sh")
        .args(["-c", command])
        .env(
            "PATH",
            std::env::join_paths(
                std::iter::once(program.to_owned()).chain(std::env::split_paths(&std::env::var_os("PATH").unwrap())),
            )
            .unwrap(),
        )
        .env("TMPDIR", folder.path())
        .current_dir(root)
        .output()
        .unwrap();
    let answer: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(answer["egos"]["e0"]["derived"], serde_json::json!(["Slow", "Fast"]));
}

#[test]
fn commands_of_the_python_package_refer_to_it() {
    for arguments in [
        &["train", "x.yaml"] as &[&str],
        &["describe"],
        &["vap", "coco", "a", "b"],
    ] {
        let package = match arguments[0] {
            "train" => "`pip install 'logicity[learn]'`",
            _ => "`pip install 'logicity'`",
        };
        fails(&run(arguments, b""), 2, &["requires the Python package", package]);
    }
    let output = run(&["--help"], b"");
    assert!(!out(&output).contains("train"), "{}", out(&output));
    fails(&run(&["vap", "cocos"], b""), 2, &["unrecognized subcommand"]);
}

/// One message names the kind of a file that the command does not read.
#[test]
fn files_of_another_kind_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let rules = write(folder.path(), "my.dl", ".decl P(x: number)\nP(1).\n");
    let config = write(folder.path(), "town.yaml", "base: easy\n# a comment\n");
    let trace = folder.path().join("trace.jsonl");
    let out_folder = folder.path().to_str().unwrap();
    let ran = run(
        &["run", "easy", "--ticks", "2", "--no-pictures", "--out", out_folder],
        b"",
    );
    assert_eq!(ran.status.code(), Some(0));
    let trace = trace.to_str().unwrap();
    let page = folder.path().join("page.html");
    let page = page.to_str().unwrap();
    for (arguments, kinds) in [
        (vec!["query", &config], "is a configuration, not a rule file"),
        (vec!["fmt", &config], "is a configuration, not a rule file"),
        (vec!["diff", &rules, &config], "is a configuration, not a rule file"),
        (vec!["repl", &config], "is a configuration, not a rule file"),
        (vec!["query", trace], "is a trace, not a rule file"),
        (vec!["fmt", "--check", trace], "is a trace, not a rule file"),
        (vec!["diff", trace, &rules], "is a trace, not a rule file"),
        (vec!["check", trace], "is a trace, not a rule file"),
        (vec!["view", &rules, "-o", page], "is a rule file, not a trace"),
        (vec!["view", &config, "-o", page], "is a configuration, not a trace"),
        (
            vec!["explain", &rules, "--agent", "Car_1"],
            "is a rule file, not a trace",
        ),
        (
            vec!["explain", &config, "--agent", "Car_1"],
            "is a configuration, not a trace",
        ),
        (vec!["infer", &rules], "is a rule file, not a file of scenes"),
        (vec!["infer", &config], "is a configuration, not a file of scenes"),
        (vec!["infer", trace], "is a trace, not a file of scenes"),
    ] {
        let output = run(&arguments, b"");
        fails(&output, 1, &[kinds, "help: "]);
        let said = String::from_utf8(output.stderr).unwrap();
        assert_eq!(said.matches("error").count(), 1, "{arguments:?}: {said}");
    }
    assert!(!Path::new(page).exists());
    // The text counts more than the name.
    let scene = write(folder.path(), "scene.dl", r#"{"map": "square-5x5", "agents": []}"#);
    fails(&run(&["query", &scene], b""), 1, &["is a JSON file, not a rule file"]);
    succeeds(&run(&["infer", &scene], b""));
    let empty = write(folder.path(), "empty.dl", "\n");
    succeeds(&run(&["infer", &empty], b""));
    let latin = write(folder.path(), "latin1.dl", b"P(\xe9).\n");
    fails(&run(&["infer", &latin], b""), 1, &["not-text"]);
}

/// The table of `check --coverage` has columns as wide as the names need.
#[test]
fn long_names_do_not_run_into_the_clauses() {
    let folder = tempfile::tempdir().unwrap();
    let text = ".include \"vocabulary.dl\"\n.decl LongQueueOfCars(x: agent)\n\
                LongQueueOfCars(X) :- IsCar(X), Sees(X, X).\nStop(X) :- LongQueueOfCars(X), CollidingClose(X, Y).\n";
    let rules = write(folder.path(), "queue.dl", text);
    let out_folder = folder.path().to_str().unwrap();
    let arguments = [
        "run",
        "easy",
        "--rules",
        &rules,
        "--ticks",
        "2",
        "--no-pictures",
        "--out",
        out_folder,
    ];
    assert_eq!(run(&arguments, b"").status.code(), Some(0));
    let trace = folder.path().join("trace.jsonl");
    let output = run(&["check", "--coverage", trace.to_str().unwrap()], b"");
    let table = out(&output);
    assert!(table.contains("  LongQueueOfCars  LongQueueOfCars(X) :- "), "{table}");
    assert!(table.contains("  Stop             Stop(X) :- "), "{table}");
}

/// A fact of an action fires in every tick.
#[test]
fn the_summary_counts_facts_of_actions() {
    let folder = tempfile::tempdir().unwrap();
    let text = ".include \"vocabulary.dl\"\n/// F: it is parked\nStop(\"Car_2\").\nStop(\"Car_99\").\n\
                Stop(X) :- CollidingClose(X, Y).\n";
    let rules = write(folder.path(), "parked.dl", text);
    let out_folder = folder.path().to_str().unwrap();
    let arguments = [
        "run",
        "easy",
        "--rules",
        &rules,
        "--ticks",
        "7",
        "--no-pictures",
        "--out",
        out_folder,
    ];
    let output = run(&arguments, b"");
    let table = out(&output);
    let row = |title: &str| {
        table
            .lines()
            .find(|line| line.ends_with(title))
            .unwrap_or_default()
            .to_owned()
    };
    assert!(
        row("F: it is parked").starts_with("         7  Stop    parked.dl:3 "),
        "{table}"
    );
    assert!(
        row("Stop(\"Car_99\").").starts_with("         0  Stop    parked.dl:4 "),
        "{table}"
    );
    let trace = std::fs::read_to_string(folder.path().join("trace.jsonl")).unwrap();
    let lines: Vec<Value> = trace.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let agents = lines[0]["agents"].as_array().unwrap();
    let parked = agents.iter().position(|agent| agent["id"] == "Car_2").unwrap();
    let clauses = lines[0]["clauses"].as_array().unwrap();
    let fact = clauses
        .iter()
        .position(|clause| clause["doc"] == "F: it is parked")
        .unwrap();
    for tick in &lines[1..] {
        let fired = tick["agents"][parked]["clauses"].as_array().unwrap();
        assert!(fired.contains(&Value::from(fact)), "{tick}");
    }
    // The facts follow the rules, so that traces of rules alone keep their numbers.
    assert!(
        clauses[..fact]
            .iter()
            .any(|clause| clause["text"] == "Stop(X) :- CollidingClose(X, Y).")
    );
}

#[test]
fn a_folder_instead_of_a_file_is_answered_with_its_files() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("place");
    fs::create_dir_all(path.join("empty")).unwrap();
    let rules = write(&path, "own.dl", ".decl p(x: number)\np(1).\n");
    write(&path, "notes.txt", "");
    let (place, empty) = (path.to_str().unwrap(), path.join("empty"));
    let named = format!("help: name a file in it: `{rules}`");
    let lines: [&[&str]; 5] = [
        &["check", place],
        &["query", place],
        &["explain", place, "--agent", "Car_1"],
        &["run", place],
        &["infer", place],
    ];
    for line in lines {
        let output = run(line, b"");
        let said = err(&output);
        assert_eq!(code(&output), 2, "{line:?}: {said}");
        assert!(said.contains("it is a folder, not a file"), "{line:?}: {said}");
        assert!(said.contains(&named) && !said.contains("notes"), "{line:?}: {said}");
    }
    let config = write(folder.path(), "own.yaml", "base: place\n");
    fails(&logicity(["run", &config]), 1, &["name a file in it: `", "own.dl`"]);
    let nothing = logicity(["check", empty.to_str().unwrap()]);
    fails(&nothing, 2, &["it is a folder, not a file"]);
    assert!(!err(&nothing).contains("help"), "{}", err(&nothing));
}

#[test]
fn missing_facts_are_named_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let text = ".decl A, B, C, D(x: symbol)\n.input A, B, C, D\n.output C\n.printsize B\nC(x) :- A(x).\n";
    let rules = write(folder.path(), "rules.dl", text);
    let facts = folder.path().to_str().unwrap();
    let query = || logicity(["query", &rules, "-F", facts, "-D", "-"]);
    let ask = || logicity(["query", &rules, "-F", facts, "--explain", "D(\"a\")"]);
    fails(
        &query(),
        2,
        &[
            "3 files of facts are missing",
            "A.facts`",
            "B.facts`",
            "C.facts`",
            "`-F FOLDER` names the folder",
            "a file without rows",
        ],
    );
    write(folder.path(), "A.facts", "");
    write(folder.path(), "C.facts", "");
    fails(&query(), 2, &["cannot read the facts of `B`", "no such file"]);
    write(folder.path(), "B.facts", "");
    // No result depends on D, but a question does; a constraint or an earlier tick may make it matter.
    assert_eq!(code(&query()), 0);
    fails(&ask(), 2, &["cannot read the facts of `D`", "no such file"]);
    for more in [
        ".disjoint A, D\n",
        ".type T <: symbol\n.decl E, F(x: T)\n.reflexive G\n.decl G(x: T, y: T)\n.input E\n",
        "C(x) :- A(x), previous D(x).\n",
        ".decl N(x: number)\nN(autoinc()) :- D(_).\n.decl M(x: number)\n.output M\nM(autoinc()) :- A(_).\n",
    ] {
        write(folder.path(), "rules.dl", &(text.to_owned() + more));
        fails(&query(), 2, &["cannot read the facts of", "no such file"]);
    }
    write(folder.path(), "rules.dl", text);
    write(folder.path(), "D.facts", "a\tb\n");
    fails(&query(), 1, &["D.facts"]);
}

#[test]
fn check_names_executors_only_for_cities() {
    let folder = tempfile::tempdir().unwrap();
    let general = ".decl A(x: number, y: number)\n.input A\n.decl B(x: number)\n.output B\nB(x) :- A(x, 7).\n";
    let general = write(folder.path(), "general.dl", general);
    let city = ".include \"vocabulary.dl\"\nStop(X) :- CollidingClose(X, \"Car_1\").\nSlow(X) :- IsCar(X).\n";
    let city = write(folder.path(), "city.dl", city);
    let printed = |rules: &str| out(&logicity(["check", rules]));
    assert!(printed(&general).ends_with("strata: B\n"), "{}", printed(&general));
    let executors = "executor: dense; relational for these clauses and what they read\n    \
                     Stop: a clause of `Stop` names a constant at ";
    assert!(printed(&city).contains(executors), "{}", printed(&city));
    let json: Value = serde_json::from_str(&out(&logicity(["check", "--json", &city]))).unwrap();
    let executor = |name: &str| {
        let strata = json["executors"].as_array().unwrap();
        let found = strata.iter().find(|stratum| stratum["predicates"][0] == name);
        (
            found.unwrap()["executor"].clone(),
            found.unwrap()["relational"].as_array().unwrap().len(),
        )
    };
    assert_eq!(executor("Stop"), ("relational".into(), 1));
    assert_eq!(executor("Slow"), ("dense".into(), 0));
}

#[test]
fn a_fault_in_many_places_is_printed_once() {
    let folder = tempfile::tempdir().unwrap();
    let text =
        ".decl insert(x: number)\n.decl other(x: number) provenance\n".to_owned() + &"insert(id(1)).\n".repeat(150);
    let rules = write(folder.path(), "rules.dl", text);
    let check = logicity(["check", &rules]);
    fails(
        &check,
        1,
        &["there is no functor `id`", "and 146 more places", "151 errors"],
    );
    assert_eq!(err(&check).matches("error[").count(), 2, "{}", err(&check));
    let json = logicity(["check", "--json", &rules]);
    assert_eq!(out(&json).matches("there is no functor `id`").count(), 150);
}

/// Several folders of `query` have the facts of successive ticks.
#[test]
fn folders_of_facts_are_ticks() {
    let folder = tempfile::tempdir().unwrap();
    let declared = ".decl Button(x: symbol)\n.input Button\n.decl Light(x: symbol)\n.output Light\n";
    let rules = format!("{declared}Light(x) :- once[1,2] Button(x).\nButton(\"always\").\n");
    let rules = write(folder.path(), "light.dl", rules);
    let tick = |name: &str, facts: &str| {
        let tick = folder.path().join(name);
        fs::create_dir(&tick).unwrap();
        write(&tick, "Button.facts", facts);
        tick.to_str().unwrap().to_owned()
    };
    let ticks = [
        tick("0", "hall\nattic\n"),
        tick("1", "attic\n"),
        tick("2", ""),
        tick("3", ""),
    ];
    let asked = |rules: &str, ticks: &[&String], more: &[&str]| {
        let folders = ticks.iter().flat_map(|tick| ["-F", tick]);
        let arguments: Vec<&str> = ["query", rules]
            .into_iter()
            .chain(folders)
            .chain(more.iter().copied())
            .collect();
        run(&arguments, b"")
    };
    let lights = |ticks: &[&String]| {
        let output = asked(&rules, ticks, &["-D", "-"]);
        succeeds(&output);
        let out = out(&output);
        let rows = out
            .lines()
            .filter(|line| !line.starts_with(['-', '=']) && !["Light", "x"].contains(line));
        rows.map(str::to_owned).collect::<Vec<_>>()
    };
    let [zero, one, two, three] = &ticks;
    assert_eq!(lights(&[zero]), [""; 0]);
    assert_eq!(lights(&[zero, one]), ["always", "attic", "hall"]);
    assert_eq!(lights(&[zero, one, two]), ["always", "attic", "hall"]);
    assert_eq!(lights(&[zero, one, two, three]), ["always", "attic"]);
    assert_eq!(lights(&[zero, one, two, three, two]), ["always"]);
    let why = asked(&rules, &[zero, one], &["--explain", "Light(\"hall\")"]);
    assert!(out(&why).contains("in tick 0"), "{}", out(&why));
    let profiled = asked(&rules, &[zero, one], &["-D", "-", "--profile"]);
    assert!(
        err(&profiled).contains("Light(x) :- once[1,2] Button(x)."),
        "{}",
        err(&profiled)
    );
    // All folders are looked for before the first tick.
    fails(&asked(&rules, &[zero, &"no/such".to_owned()], &[]), 2, &["no/such"]);
    let stdin = format!("{declared}.input Button(filename=\"/dev/stdin\")\n").replace(".input Button\n", "");
    let stdin = write(folder.path(), "stdin.dl", stdin);
    fails(
        &asked(&stdin, &[zero, one], &[]),
        2,
        &["standard input, which has the facts of one tick"],
    );
    let drawn = format!("{declared}0.5 :: Light(x) :- Button(x).\nLight(x) :- previous Light(x).\n");
    let drawn = write(folder.path(), "drawn.dl", drawn);
    fails(
        &asked(&drawn, &[zero, one], &["--marginals"]),
        2,
        &["`Light` of the earlier ticks, which is uncertain"],
    );
    succeeds(&asked(&drawn, &[zero], &["--marginals"]));
}

/// A map repeats the phases of signals that follow the traffic, which the import says.
#[test]
fn import_warns_of_signals_that_follow_the_traffic() {
    let folder = tempfile::tempdir().unwrap();
    let [network, map] = ["town.net.xml", "town.yaml"].map(|name| folder.path().join(name));
    let [network, map] = [network, map].map(|path| path.to_str().unwrap().to_owned());
    let text = fs::read_to_string("tests/fixtures/networks/grid-signals.net.xml").unwrap();
    fs::write(&network, &text).unwrap();
    let quiet = logicity(["map", "import", &network, "-o", &map]);
    succeeds(&quiet);
    assert!(!err(&quiet).contains("warning"), "{}", err(&quiet));
    fs::write(&network, text.replace("type=\"static\"", "type=\"actuated\"")).unwrap();
    let warned = logicity(["map", "import", &network, "-o", &map, "--force"]);
    succeeds(&warned);
    let said = String::from_utf8_lossy(&warned.stderr);
    assert!(
        said.contains("warning[ignored]: the phases of this signal follow the traffic"),
        "{said}"
    );
    assert!(said.contains("further signals like it"), "{said}");
}

/// Several networks become one map with a zone for each, which regions can name.
#[test]
fn networks_are_imported_side_by_side() {
    let folder = tempfile::tempdir().unwrap();
    let map = folder.path().join("towns.yaml");
    let map = map.to_str().unwrap();
    let network = |name: &str| format!("tests/fixtures/networks/{name}.net.xml");
    let [junction, ring] = ["t-junction", "roundabout"].map(network);
    succeeds(&logicity(["map", "import", &junction, &ring, "-o", map]));
    let text = fs::read_to_string(map).unwrap();
    assert!(text.contains("zones:\n  t_junction:\n    - {rows: [0, "), "{text}");
    succeeds(&logicity(["check", map]));
    let config = |region: &str| {
        let file = folder.path().join("city.yaml");
        let agents = "agents: {test: {cars: [{priority: 1, count: 6}]}}";
        let text = format!("base: right-of-way-roads\nmap: towns.yaml\nregion: {region}\n{agents}\n");
        fs::write(&file, text).unwrap();
        file.to_str().unwrap().to_owned()
    };
    let trace = folder.path().join("run");
    let trace = trace.to_str().unwrap();
    let run = [
        "run",
        &config("roundabout"),
        "--ticks",
        "50",
        "--no-pictures",
        "--out",
        trace,
    ];
    succeeds(&logicity(run));
    fails(
        &logicity(["check", &config("roundabuot")]),
        1,
        &[
            "city.yaml:3:9",
            "has no zone `roundabuot`",
            "did you mean `roundabout`?",
        ],
    );
    fails(
        &logicity(["map", "import", &ring, &ring, "-o", map, "--force"]),
        2,
        &["two networks have the name `roundabout`", "rename a file"],
    );
}
