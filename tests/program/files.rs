//! Files: what the program writes, and what it leaves alone. Traces that explain themselves.

use serde_json::Value;
use sha2::{Digest, Sha256};
use std::fs;
use std::os::unix::fs::{PermissionsExt, symlink};
use std::os::unix::process::ExitStatusExt;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::thread;
use std::time::Duration;

/// Runs the program in `folder`.
fn logicity(folder: &Path, line: &str) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_logicity"));
    let done = command
        .args(line.split_whitespace())
        .current_dir(folder)
        .stdin(Stdio::null())
        .output();
    done.unwrap()
}

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

fn succeeds(folder: &Path, line: &str) -> String {
    let output = logicity(folder, line);
    assert_eq!(output.status.code(), Some(0), "{line}: {}", said(&output));
    String::from_utf8(output.stdout).unwrap()
}

fn fails(folder: &Path, line: &str, code: i32, words: &[&str]) {
    let output = logicity(folder, line);
    let said = said(&output);
    assert_eq!(output.status.code(), Some(code), "{line}: {said}");
    for word in words {
        assert!(said.contains(word), "{line}: `{word}` is missing in:\n{said}");
    }
}

/// Prepares what the writers read: rules with outputs, a trace, and episodes' configuration.
fn inputs(folder: &Path) {
    fs::write(folder.join("in.dl"), ".decl A(x: number)\n.output A\nA(1).\n").unwrap();
    fs::write(folder.join("scene.jsonl"), "").unwrap();
    succeeds(folder, "run easy --ticks 2 --no-pictures --out in");
}

/// A bare name of rules means the built-in file, unless a file has the name.
#[test]
fn bare_names_of_rules_mean_built_in_files() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let scene = r#"{"entities":["a"],"ego":"a","facts":{"IsCar":["a"]}}"#;
    fs::write(folder.join("scene.jsonl"), scene).unwrap();
    for line in [
        "diff hard expert --scene",
        "diff easy easy",
        "query hard",
        "repl hard",
        "fmt --check hard",
        "check vocabulary",
        "run expert --rules hard --ticks 1 --no-pictures --no-trace",
        "infer scene.jsonl --config expert --rules hard",
        "episodes show expert --rules hard --episode 3",
        "bench tick --config expert --rules hard --repeats 1 --ticks 1",
    ] {
        let mut is_value = false;
        let full: Vec<String> = (line.split(' ').enumerate())
            .map(|(index, word)| {
                let is_rules = is_value || index > 0 && line.starts_with(['d', 'q', 'f', 'c']) || line == "repl hard";
                is_value = word == "--rules";
                match word {
                    "hard" | "expert" | "easy" | "vocabulary" if is_rules => format!("rules/{word}.dl"),
                    word => word.to_owned(),
                }
            })
            .collect();
        let [short, long] = [line.to_owned(), full.join(" ")].map(|line| logicity(folder, &line));
        // `query` finds the rules, but no facts.
        assert!(!said(&short).contains("cannot read `"), "{line}: {}", said(&short));
        assert_eq!(short.status.code(), long.status.code(), "{line}: {}", said(&short));
        if !line.starts_with("bench") {
            let texts = [&short, &long].map(|output| String::from_utf8_lossy(&output.stdout).into_owned());
            // `diff` names the rules as the command line does.
            let texts = texts.map(|text| text.replace("rules/", "").replace(".dl", ""));
            let [short, long] = texts.each_ref().map(|text| {
                let lines = text.lines().filter(|line| !line.contains(" per second"));
                lines.collect::<Vec<_>>()
            });
            assert_eq!(short, long, "{line}");
        }
    }
    fails(folder, "query hrad", 2, &["cannot read `hrad`: no such file"]);
    fs::write(folder.join("hard"), "A(").unwrap();
    fails(folder, "query hard", 1, &["hard:1"]);
    fails(folder, "run expert --rules hard --ticks 1", 1, &["hard:1"]);
}

/// The recorded episodes of a mode are for its map, whatever its name.
#[test]
fn recorded_episodes_belong_to_a_map() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    fs::write(folder.join("map.yaml"), "base: easy\nmap: random-8x8\n").unwrap();
    let refused = &[
        "for the map `square-5x5`, and the configuration has the map `random-8x8`",
        "draw your own",
        "`logicity episodes make map.yaml --split val`",
    ];
    fails(folder, "episodes check map.yaml --split val", 1, refused);
    fails(folder, "episodes show map.yaml --split val", 1, refused);
    fails(folder, "induce --config map.yaml --split val", 1, refused);
    // The same map in another file is the same map, and a change of one width makes another map.
    fs::write(folder.join("copy.yaml"), "base: square-5x5\n").unwrap();
    fs::write(folder.join("same.yaml"), "base: easy\nmap: copy.yaml\n").unwrap();
    succeeds(folder, "episodes show same.yaml --split val --episode 0");
    let wide = "base: configs/maps/square-5x5.yaml\nwidths: {sidewalk: 6}\n";
    fs::write(folder.join("square-5x5.yaml"), wide).unwrap();
    fs::write(folder.join("wide.yaml"), "base: easy\nmap: square-5x5.yaml\n").unwrap();
    let earlier = "for an earlier version of the map `square-5x5`";
    fails(folder, "episodes check wide.yaml --split val", 1, &[earlier]);
    // Episodes of its own fit.
    let own = "base: map.yaml\ntask: {episodes: {val: own-val.jsonl}}\n";
    fs::write(folder.join("own.yaml"), own).unwrap();
    succeeds(folder, "episodes make own.yaml --split val --count 2");
    let checked = succeeds(folder, "episodes check own.yaml --split val");
    assert!(checked.starts_with("2 episodes match"), "{checked}");
    // A file of an earlier version names no map.
    let text = fs::read_to_string(folder.join("own-val.jsonl")).unwrap();
    let (begin, end) = (text.find("\"map\"").unwrap(), text.find("\"seed\"").unwrap());
    fs::write(folder.join("own-val.jsonl"), text[..begin].to_owned() + &text[end..]).unwrap();
    let missing = [
        "own-val.jsonl:1",
        "does not contain the `map`",
        "draw the episodes again",
    ];
    fails(folder, "episodes check own.yaml --split val", 1, &missing);
}

/// The map in the guide is large enough for every kind of agent.
#[test]
fn the_map_in_the_guide_has_room() {
    let guide = include_str!("../../docs/how-to/compose-configurations.md");
    let map = guide
        .split("```")
        .find(|block| block.contains("# two-blocks.yaml: a map"));
    let map = map.unwrap().strip_prefix("yaml\n").unwrap();
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    fs::write(folder.join("two-blocks.yaml"), map).unwrap();
    let agents = "agents: {train: ~, val: ~, test: {cars: [{priority: 1}], pedestrians: [{count: 2}]}}\n";
    let city = |agents: &str| format!("base: expert\nmap: two-blocks.yaml\n{agents}");
    fs::write(folder.join("city.yaml"), city(agents)).unwrap();
    succeeds(folder, "run city.yaml --ticks 30 --no-pictures --out out");
    // All houses in one block: the region of 120 cells covers the map, so a larger one cannot help.
    fs::write(folder.join("two-blocks.yaml"), map.replace("HO HG", "HO SG")).unwrap();
    let nowhere = [
        "no-route",
        "on the whole map",
        "the map has none: add a house or office in a second block to the map",
    ];
    fails(folder, "run city.yaml --ticks 1 --out out", 1, &nowhere);
    let crowd = agents.replace("priority: 1", "priority: 1, count: 999");
    fs::write(folder.join("city.yaml"), city(&crowd)).unwrap();
    let room = ["no-start-cell", "on the whole map", "add such buildings to the map"];
    fails(folder, "run city.yaml --ticks 1 --out out", 1, &room);
}

/// Every command that writes, with the files that it writes.
const WRITERS: [(&str, &[&str]); 8] = [
    (
        "run easy --ticks 2 --out new --html new/page.html",
        &["trace.jsonl", "city.gif", "last.png", "page.html"],
    ),
    ("view in/trace.jsonl -o new/page.html", &["page.html"]),
    ("icons sheet -o new/sheet.png", &["sheet.png"]),
    (
        "episodes make easy --count 1 -o new/episodes.jsonl",
        &["episodes.jsonl"],
    ),
    (
        "questions --count 8 --shots 0 -o new/questions.jsonl --csv new/table.csv --demonstrations-csv new/dev.csv",
        &["questions.jsonl", "table.csv", "dev.csv"],
    ),
    ("infer scene.jsonl --out new/answers.jsonl", &["answers.jsonl"]),
    ("query in.dl -D new", &["A.csv"]),
    (
        "vap make --mode easy --split test --worlds 1 --no-pictures --threads 1 --out new",
        &["README.md", "manifest.json"],
    ),
];

#[test]
fn slow_no_command_replaces_a_file_of_another_program() {
    let folder = tempfile::tempdir().unwrap();
    inputs(folder.path());
    let new = folder.path().join("new");
    for (line, files) in WRITERS {
        for file in files {
            fs::create_dir(&new).unwrap();
            fs::write(new.join(file), "foreign").unwrap();
            fails(folder.path(), line, 2, &[file, "--force"]);
            assert_eq!(fs::read(new.join(file)).unwrap(), b"foreign", "{line}");
            let names = fs::read_dir(&new).unwrap().count();
            assert_eq!(names, 1, "{line}: no file is written before the refusal");
            fs::remove_dir_all(&new).unwrap();
        }
        fs::create_dir(&new).unwrap();
        for file in files {
            fs::write(new.join(file), "foreign").unwrap();
        }
        let output = logicity(folder.path(), &format!("{line} --force"));
        let printed = said(&output) + &String::from_utf8_lossy(&output.stdout);
        assert_eq!(output.status.code(), Some(0), "{line}: {printed}");
        let is_data_set = files.contains(&"manifest.json");
        for file in files {
            let path = if is_data_set { "new" } else { file };
            assert!(printed.contains(path), "{line}: `{path}` is missing in:\n{printed}");
            assert_ne!(fs::read(new.join(file)).unwrap(), b"foreign", "{line}");
        }
        // Its own files are replaced without `--force`.
        succeeds(folder.path(), line);
        // Not after an edit.
        fs::write(new.join(files[0]), "edited").unwrap();
        fails(folder.path(), line, 2, &[files[0], "--force"]);
        assert_eq!(fs::read(new.join(files[0])).unwrap(), b"edited", "{line}");
        fs::remove_dir_all(&new).unwrap();
    }
}

/// Rules can come from others, so they write only to the folder that the user names.
#[test]
fn rules_write_only_to_the_folder_of_results() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    for name in ["work/out/inner", "outside"] {
        fs::create_dir_all(folder.join(name)).unwrap();
    }
    let work = folder.join("work");
    for (link, target) in [
        ("out/to-folder", "../../outside"),
        ("out/to-file.csv", "../../outside/kept.csv"),
        ("out/to-nothing.csv", "../../outside/new.csv"),
        ("out/round.csv", "round.csv"),
        ("out/to-inner", "inner"),
    ] {
        symlink(target, work.join(link)).unwrap();
    }
    fs::write(folder.join("outside/kept.csv"), "kept").unwrap();
    let absolute = folder.join("outside/absolute.csv").display().to_string();
    let rules = |directive: &str| {
        fs::write(work.join("main.dl"), ".include \"part.dl\"\nA(1).\n").unwrap();
        fs::write(work.join("part.dl"), format!(".decl A(x: number)\n{directive}\n")).unwrap();
    };
    let outside = || {
        let entries = fs::read_dir(folder.join("outside")).unwrap();
        entries.map(|entry| entry.unwrap().file_name()).collect::<Vec<_>>()
    };
    for name in [
        "../../outside/up.csv",
        "../main.csv",
        "inner/../../../outside/up.csv",
        "new/../../../outside/up.csv",
        "to-folder/a.csv",
        "to-folder/new/a.csv",
        "to-file.csv",
        "to-nothing.csv",
        &absolute,
    ] {
        for more in ["", ", compress=true"] {
            rules(&format!(".output A(filename=\"{name}\"{more})"));
            let words = [
                "error[invalid-output]",
                "part.dl:2:20",
                "outside of the folder of results",
                "--output-anywhere",
            ];
            fails(&work, "query main.dl -D out", 1, &words);
            fails(&work, "query main.dl -D out --force", 1, &words);
            assert_eq!(outside(), ["kept.csv"], "{name}");
        }
    }
    assert_eq!(fs::read(folder.join("outside/kept.csv")).unwrap(), b"kept");
    // The usual name can be a link, too.
    symlink("../../outside/A.csv", work.join("out/A.csv")).unwrap();
    rules(".output A");
    fails(
        &work,
        "query main.dl -D out",
        1,
        &["error[invalid-output]", "part.dl:2:9"],
    );
    assert_eq!(outside(), ["kept.csv"]);
    // No folder, so no other place.
    succeeds(&work, "query main.dl -D -");
    rules(".output A(filename=\"round.csv\")");
    fails(&work, "query main.dl -D out", 2, &["round.csv"]);
    // Inside, and streams.
    for (name, path) in [
        ("rows.csv", "out/rows.csv"),
        ("./inner/../rows.csv", "out/rows.csv"),
        ("deep/down/rows.csv", "out/deep/down/rows.csv"),
        ("to-inner/rows.csv", "out/inner/rows.csv"),
        ("/dev/stdout", ""),
    ] {
        rules(&format!(".output A(filename=\"{name}\")"));
        let output = logicity(&work, "query main.dl -D out");
        assert_eq!(output.status.code(), Some(0), "{name}: {}", said(&output));
        match path {
            "" => assert_eq!((&*output.stdout, said(&output)), (&b"1\n"[..], String::new())),
            path => {
                assert!(said(&output).starts_with("wrote out/"), "{}", said(&output));
                assert_eq!(fs::read(work.join(path)).unwrap(), b"1\n", "{name}");
            }
        }
    }
    // With permission; the path is printed.
    for name in ["../../outside/up.csv", "to-folder/a.csv", &absolute] {
        rules(&format!(".output A(filename=\"{name}\")"));
        let output = logicity(&work, "query main.dl -D out --output-anywhere");
        assert_eq!(output.status.code(), Some(0), "{name}: {}", said(&output));
        assert!(said(&output).contains(name), "{}", said(&output));
    }
    assert_eq!(
        outside().len(),
        5,
        "three outputs, a record and the earlier file: {:?}",
        outside()
    );
    // What another program wrote stays.
    rules(".output A(filename=\"to-file.csv\")");
    fails(
        &work,
        "query main.dl -D out --output-anywhere",
        2,
        &["to-file.csv", "--force"],
    );
    assert_eq!(fs::read(folder.join("outside/kept.csv")).unwrap(), b"kept");
}

#[test]
fn two_outputs_do_not_share_a_file() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    fs::create_dir(folder.join("inner")).unwrap();
    symlink("inner", folder.join("link")).unwrap();
    let begin = ".decl A(x: number)\n.decl B(x: number)\nA(1).\nB(2).\n";
    for outputs in [
        ".output A, B(filename=\"rows.csv\")",
        ".output A\n.output B(filename=\"./A.csv\")",
        ".output A(filename=\"link/rows.csv\")\n.output B(filename=\"inner/rows.csv\")",
        ".output A(filename=\"rows.csv\")\n.output A(filename=\"rows.csv\", headers=true)",
    ] {
        fs::write(folder.join("rows.dl"), format!("{begin}{outputs}\n")).unwrap();
        fails(
            folder,
            "query rows.dl",
            1,
            &["error[invalid-output]", "have the same file", "also written here"],
        );
    }
    assert!(!folder.join("rows.csv").exists());
    fs::write(folder.join("rows.dl"), format!("{begin}.output A\n.output A, B\n")).unwrap();
    let output = logicity(folder, "query rows.dl");
    assert_eq!(said(&output), "wrote A.csv\nwrote B.csv\n");
}

#[test]
fn no_command_replaces_a_file_of_another_command() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    succeeds(
        folder,
        "run easy --ticks 1 --no-pictures --out out --html out/page.html",
    );
    let trace = fs::read(folder.join("out/trace.jsonl")).unwrap();
    let rules = ".decl A(x: number)\nA(1).\n.output A(filename=\"trace.jsonl\")\n";
    fs::write(folder.join("rows.dl"), rules).unwrap();
    fs::write(folder.join("scene.jsonl"), "").unwrap();
    for line in [
        "query rows.dl -D out",
        "infer scene.jsonl --out out/trace.jsonl",
        "episodes make easy --count 1 -o out/trace.jsonl",
    ] {
        let words = ["out/trace.jsonl", "the file exists, and `run` wrote it", "--force"];
        fails(folder, line, 2, &words);
    }
    assert!(fs::read(folder.join("out/trace.jsonl")).unwrap() == trace);
    succeeds(
        folder,
        "run easy --ticks 1 --no-pictures --out out --html out/page.html",
    );
    succeeds(folder, "query rows.dl -D out --force");
    succeeds(folder, "query rows.dl -D out");
    fails(
        folder,
        "run easy --ticks 1 --no-pictures --out out",
        2,
        &["`query` wrote it"],
    );
}

/// Pictures of an earlier run would not fit the new trace: `run` removes those that it made, and no other file.
#[test]
fn a_run_without_pictures_removes_its_earlier_ones() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    succeeds(folder, "run easy --ticks 2 --scale 1 --out out");
    fs::write(folder.join("out/last.png"), "mine").unwrap();
    fs::write(folder.join("out/notes.txt"), "mine").unwrap();
    assert!(folder.join("out/city.gif").exists());
    succeeds(folder, "run easy --ticks 1 --seed 3 --no-pictures --out out");
    assert!(!folder.join("out/city.gif").exists());
    assert_eq!(fs::read_to_string(folder.join("out/last.png")).unwrap(), "mine");
    assert!(folder.join("out/notes.txt").exists() && folder.join("out/trace.jsonl").exists());
    // The record forgets what is gone.
    let record = fs::read_to_string(folder.join("out/.logicity.json")).unwrap();
    assert!(
        record.contains("trace.jsonl") && !record.contains("city.gif"),
        "{record}"
    );
}

/// The exit code is 128 plus the number of the signal, whether a command polls or not. Outputs are complete or absent.
#[test]
fn commands_end_with_the_code_of_their_signal() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let endless = ".decl N(x: number)\n.output N\nN(0).\nN(X + 1) :- N(X), X < 100000000.\n";
    fs::write(folder.join("endless.dl"), endless).unwrap();
    let mask = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = mask.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let mask = mask.map_or(0, |mask| u64::from_str_radix(mask.trim(), 16).unwrap());
    for (line, begun) in [
        ("query endless.dl -D out", "out"),
        ("query endless.dl -D out --threads 4", "out"),
        ("run expert --ticks 1000000000 --no-pictures --out out", "out/trace"),
        (
            "run expert --ticks 1000000000 --no-pictures --out out --threads 2",
            "out/trace",
        ),
        ("questions --count 20000 --output out/questions.jsonl", "out/questions"),
    ] {
        for (name, number) in [("HUP", 1), ("INT", 2), ("TERM", 15)] {
            if mask >> (number - 1) & 1 == 1 {
                println!("the caller of this test ignores SIG{name}");
                continue;
            }
            if line.starts_with("questions") {
                fs::create_dir(folder.join("out")).unwrap();
            }
            let mut process = Command::new(env!("CARGO_BIN_EXE_logicity"))
                .args(line.split(' '))
                .current_dir(folder)
                .stdout(Stdio::null())
                .stderr(Stdio::null())
                .spawn()
                .unwrap();
            let has_begun = || match begun {
                "out" => folder.join("out").exists(),
                _ => fs::read_dir(folder.join("out")).is_ok_and(|mut names| names.next().is_some()),
            };
            while !has_begun() {
                assert!(process.try_wait().unwrap().is_none(), "{line}");
                thread::sleep(Duration::from_millis(5));
            }
            let sent = Command::new("kill")
                .args([&format!("-{name}"), &process.id().to_string()])
                .status();
            assert!(sent.unwrap().success());
            let ended = process.wait().unwrap();
            // A shell ends its loops only if Ctrl-C ended a command by the signal itself.
            let is_by_signal = name == "INT" && !line.starts_with("run");
            let expected = if is_by_signal {
                (None, Some(number))
            } else {
                (Some(128 + number), None)
            };
            assert_eq!((ended.code(), ended.signal()), expected, "{line} {name}");
            let mut files = fs::read_dir(folder.join("out")).into_iter().flatten().flatten();
            let left = files.find(|file| file.file_name().to_string_lossy().contains(".logicity-"));
            assert!(left.is_none(), "{line} {name} leaves {left:?}");
            let trace = folder.join("out/trace.jsonl");
            if line.starts_with("run") {
                let text = fs::read_to_string(trace).unwrap();
                assert!(
                    text.ends_with('\n') && text.lines().all(|line| line.ends_with('}')),
                    "{line}"
                );
            }
            assert!(!folder.join("out/N.csv").exists());
            fs::remove_dir_all(folder.join("out")).unwrap();
        }
    }
    // A caller that ignores a signal, as `nohup` does, keeps the command.
    if cfg!(target_os = "linux") {
        let script = "trap '' HUP TERM; exec \"$0\" run expert --ticks 1000000000 --no-pictures --out out";
        let mut process = Command::new("sh")
            .args(["-c", script, env!("CARGO_BIN_EXE_logicity")])
            .current_dir(folder)
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let id = process.id().to_string();
        let written = || {
            let files = fs::read_dir(folder.join("out")).into_iter().flatten().flatten();
            files
                .map(|file| file.metadata().map_or(0, |file| file.len()))
                .sum::<u64>()
        };
        // Waits until the command writes more than it has written.
        let mut proceeds = || {
            let before = written();
            while written() == before {
                assert!(process.try_wait().unwrap().is_none(), "it has ended");
                thread::sleep(Duration::from_millis(5));
            }
        };
        proceeds();
        for signal in ["-HUP", "-TERM"] {
            assert!(Command::new("kill").args([signal, &id]).status().unwrap().success());
            proceeds();
        }
        assert!(Command::new("kill").args(["-KILL", &id]).status().unwrap().success());
        process.wait().unwrap();
    }
}

/// Results that cannot be written are no success.
#[cfg(target_os = "linux")]
#[test]
fn a_full_standard_output_is_reported() {
    for line in [
        "--help",
        "--version",
        "help",
        "run --help",
        "vap make --help",
        "induce --version",
        "help query",
        "completions bash",
        "reference",
        "schema",
        "codes",
        "codes syntax",
        "check hard",
        "diff hard hard",
        "run easy --ticks 1 --no-trace",
        "route --help",
    ] {
        let output = Command::new(env!("CARGO_BIN_EXE_logicity"))
            .args(line.split(' '))
            .stdout(fs::OpenOptions::new().write(true).open("/dev/full").unwrap())
            .output()
            .unwrap();
        assert_eq!(output.status.code(), Some(2), "{line}: {}", said(&output));
        let message = "error: cannot write to standard output: No space left on device";
        assert!(said(&output).contains(message), "{line}: {}", said(&output));
    }
}

/// The kernel's files claim to be regular, and a file can be larger than any text. Both are refused before they are
/// read.
#[cfg(target_os = "linux")]
#[test]
fn files_without_an_end_are_refused_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| fs::write(folder.path().join(name), text).unwrap();
    for (link, target) in [
        ("kernel", "/proc/kmsg"),
        ("status", "/proc/self/status"),
        ("module", "/sys/kernel"),
    ] {
        symlink(target, folder.path().join(link)).unwrap();
    }
    write("include.dl", ".include \"status\"\n");
    write(
        "facts.dl",
        ".decl A(x: symbol)\n.input A(filename=\"/proc/self/status\")\n.output A\n",
    );
    write("base.yaml", "base: status\n");
    write("rules.yaml", "base: configs/easy.yaml\nrules: status\n");
    write("scene.jsonl", "");
    for name in ["kernel", "status", "module/notes"] {
        for command in [
            "check",
            "fmt",
            "query",
            "run",
            "infer",
            "infer scene.jsonl --config",
            "explain --agent a",
            "view",
            "induce",
            "check --coverage",
            "route",
            "icons sheet --pack",
            "vap check",
            "induce --popper",
        ] {
            let output = logicity(folder.path(), &format!("{command} {name}"));
            assert!(
                matches!(output.status.code(), Some(1 | 2)),
                "{command} {name}: {}",
                said(&output)
            );
        }
    }
    for (line, code) in [
        ("check status", 2),
        ("check include.dl", 1),
        ("query facts.dl -D -", 2),
        ("check base.yaml", 1),
        ("check rules.yaml", 1),
        ("explain status --agent a", 2),
        ("infer status", 2),
        ("induce status", 2),
    ] {
        fails(folder.path(), line, code, &["which may never end"]);
    }
    let sparse = fs::File::create(folder.path().join("sparse")).unwrap();
    sparse.set_len(100 << 30).unwrap();
    for (line, code, word) in [
        ("check sparse", 2, "larger than 1024 MiB"),
        ("run sparse", 1, "larger than 1024 MiB"),
        ("infer sparse", 1, "too long: the limit is 64 MiB"),
        ("explain sparse --agent a", 1, "a line of more than 256 MiB"),
        ("induce --ask true --log sparse", 2, "last line is longer than 64 MiB"),
    ] {
        fails(folder.path(), line, code, &[word]);
    }
}

/// A command replaces no file that it reads, under no name and not with `--force`.
#[test]
fn no_command_replaces_its_input() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| fs::write(folder.path().join(name), text).unwrap();
    inputs(folder.path());
    write("part.dl", ".include \"vocabulary.dl\"\n");
    write(
        "rules.dl",
        ".include \"part.dl\"\nStop(X) :- IsCar(X), CollidingClose(X, Y).\n",
    );
    write("agents.yaml", "test: {cars: [{count: 1, priority: 1}]}\n");
    write("base.yaml", "base: configs/easy.yaml\nagents: agents.yaml\n");
    write("city.yaml", "base: base.yaml\nrules: rules.dl\n");
    write(
        "rows.dl",
        ".decl A(x: number)\n.input A\n.output A(filename=\"A.facts\")\n",
    );
    write("own.dl", ".decl A(x: number)\nA(1).\n.output A(filename=\"own.dl\")\n");
    write("A.facts", "1\n");
    fs::create_dir_all(folder.path().join("pack/car")).unwrap();
    let icon = "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 9 9\"><rect width=\"9\" height=\"5\"/></svg>";
    write("pack/car/icon.svg", icon);
    let icon = folder.path().join("pack/car/icon.svg");
    for (link, target) in [
        ("soft.dl", "part.dl"),
        ("soft.yaml", "agents.yaml"),
        ("soft.jsonl", "scene.jsonl"),
    ] {
        symlink(target, folder.path().join(link)).unwrap();
    }
    fs::hard_link(folder.path().join("rules.dl"), folder.path().join("hard.dl")).unwrap();
    fs::create_dir(folder.path().join("out")).unwrap();
    symlink("../base.yaml", folder.path().join("out/trace.jsonl")).unwrap();
    let all = [
        "part.dl",
        "rules.dl",
        "agents.yaml",
        "base.yaml",
        "city.yaml",
        "A.facts",
        "own.dl",
        "scene.jsonl",
    ];
    let all = all.map(|name| folder.path().join(name));
    let content = || {
        all.iter()
            .chain([&icon])
            .map(|path| fs::read(path).unwrap())
            .collect::<Vec<_>>()
    };
    let before = content();
    for line in [
        "infer scene.jsonl --out scene.jsonl",
        "infer scene.jsonl --out soft.jsonl",
        "infer scene.jsonl --rules rules.dl --out soft.dl",
        "infer scene.jsonl --rules rules.dl --out hard.dl",
        "infer scene.jsonl --config city.yaml --out rules.dl",
        "infer scene.jsonl --config city.yaml --out soft.yaml",
        "run city.yaml --ticks 1 --no-pictures --out out",
        "run city.yaml --ticks 1 --no-pictures --out new --html city.yaml",
        "run city.yaml --ticks 1 --out new --pack pack --html pack/car/icon.svg",
        "questions city.yaml --count 8 --shots 0 -o rules.dl",
        "questions city.yaml --count 8 --shots 0 --csv agents.yaml",
        "icons sheet --pack pack -o pack/car/icon.svg",
        "view in/trace.jsonl -o in/trace.jsonl",
        "query rows.dl -F . -D .",
        "query own.dl -D .",
    ] {
        fails(folder.path(), &format!("{line} --force"), 2, &["this command reads it"]);
        assert!(content() == before, "{line}");
    }
    let episodes = "base: configs/easy.yaml\nrules: rules.dl\n";
    write("task.yaml", episodes);
    fails(
        folder.path(),
        "episodes make task.yaml --count 1 -o task.yaml --force",
        2,
        &["this command reads it"],
    );
    assert_eq!(fs::read_to_string(folder.path().join("task.yaml")).unwrap(), episodes);
    // Also through standard input.
    let output = Command::new("sh")
        .args(["-c", "\"$0\" infer --out scene.jsonl --force < scene.jsonl"])
        .arg(env!("CARGO_BIN_EXE_logicity"))
        .current_dir(folder.path())
        .output()
        .unwrap();
    assert!(said(&output).contains("this command reads it"), "{}", said(&output));
}

/// `-` and the names of open descriptors are streams: no file of that name, no temporary file, no record.
#[test]
fn slow_outputs_may_be_streams() {
    let folder = tempfile::tempdir().unwrap();
    inputs(folder.path());
    fs::write(
        folder.path().join("scene.jsonl"),
        "{\"entities\": [\"a\"], \"ego\": \"a\", \"facts\": {\"IsCar\": [\"a\"]}}\n",
    )
    .unwrap();
    let count = || fs::read_dir(folder.path()).unwrap().count();
    for (line, option) in [
        ("infer scene.jsonl", "--out"),
        ("questions --count 8 --shots 0", "--output"),
        ("questions --count 8 --shots 0 -o q.jsonl", "--csv"),
        ("episodes make easy --count 1", "--output"),
        ("icons sheet", "--output"),
        ("view in/trace.jsonl", "--output"),
    ] {
        succeeds(folder.path(), &format!("{line} {option} file"));
        let expected = fs::read(folder.path().join("file")).unwrap();
        let before = count();
        for stream in ["-", "/dev/stdout", "/dev/fd/1"] {
            let output = logicity(folder.path(), &format!("{line} {option} {stream}"));
            assert_eq!(output.status.code(), Some(0), "{line}: {}", said(&output));
            assert!(output.stdout == expected, "{line} {stream}: {}", said(&output));
        }
        let output = logicity(folder.path(), &format!("{line} {option} /dev/stderr"));
        assert!(
            output.stderr.starts_with(&expected) || output.stderr.ends_with(&expected),
            "{line}"
        );
        succeeds(folder.path(), &format!("{line} {option} /dev/null"));
        fails(
            folder.path(),
            &format!("{line} {option} /dev/full"),
            2,
            &["cannot write `/dev/full`", "No space left"],
        );
        assert_eq!(count(), before, "{line}");
        // The reader may close the stream.
        let closed = Command::new("bash")
            .args(["-c", "set -o pipefail; \"$0\" $1 | true"])
            .arg(env!("CARGO_BIN_EXE_logicity"))
            .arg(format!("{line} {option} -"))
            .current_dir(folder.path())
            .output()
            .unwrap();
        assert_eq!(closed.status.code(), Some(0), "{line}: {}", said(&closed));
        fs::remove_file(folder.path().join("file")).unwrap();
    }
    for (line, words) in [
        ("questions --count 8 --shots 0 --csv -", "both write to standard output"),
        (
            "questions --count 8 --shots 0 -o q.jsonl --csv - --demonstrations-csv /dev/stdout",
            "both write to standard output",
        ),
        (
            "run easy --ticks 1 --out out --html -",
            "the summary goes to standard output",
        ),
        ("run easy --ticks 1 --out -", "several files"),
        ("vap make --mode easy --split test --worlds 1 --out -", "several files"),
    ] {
        fails(folder.path(), line, 2, &[words]);
    }
    assert!(!folder.path().join("-").exists());
}

#[test]
fn paths_that_cannot_be_written_are_reported_before_the_work() {
    let folder = tempfile::tempdir().unwrap();
    inputs(folder.path());
    fs::create_dir(folder.path().join("dir")).unwrap();
    // Each would take minutes.
    for (line, path) in [
        (
            "run expert --ticks 20000 --no-pictures --html no/page.html",
            "no/page.html",
        ),
        ("run expert --ticks 20000 --no-pictures --html dir", "dir"),
        ("run expert --ticks 1000000 --out in.dl", "in.dl"),
        ("episodes make expert --count 100000 -o no/e.jsonl", "no/e.jsonl"),
        ("questions --count 20000 --csv no/q.csv", "no/q.csv"),
        ("questions --count 20000 -o dir", "dir"),
        ("infer scene.jsonl --out no/a.jsonl", "no/a.jsonl"),
        ("view in/trace.jsonl -o no/page.html", "no/page.html"),
        ("icons sheet -o no/sheet.png", "no/sheet.png"),
        ("vap make --mode hard --split train --out in.dl", "in.dl"),
        ("query endless.dl -D in.dl", "in.dl"),
    ] {
        let endless = ".decl N(x: number)\n.output N\nN(0).\nN(X + 1) :- N(X), X < 100000000.\n";
        fs::write(folder.path().join("endless.dl"), endless).unwrap();
        let mut process = Command::new(env!("CARGO_BIN_EXE_logicity"))
            .args(line.split_whitespace())
            .current_dir(folder.path())
            .stdin(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut waited = 0;
        while process.try_wait().unwrap().is_none() {
            thread::sleep(Duration::from_millis(20));
            waited += 1;
            if waited == 1000 {
                process.kill().unwrap();
            }
        }
        let output = process.wait_with_output().unwrap();
        assert_eq!(output.status.code(), Some(2), "{line}: {}", said(&output));
        assert!(said(&output).contains(path), "{line}: {}", said(&output));
    }
}

#[test]
fn a_second_writer_learns_who_writes_since_when() {
    let folder = tempfile::tempdir().unwrap();
    let busy = |line: &str, temporary: &str, again: &str| {
        let mut first = Command::new(env!("CARGO_BIN_EXE_logicity"))
            .args(line.split_whitespace())
            .current_dir(folder.path())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let has = || {
            let entries = fs::read_dir(folder.path().join("out")).into_iter().flatten().flatten();
            let mut names = entries.map(|entry| entry.file_name().into_string().unwrap());
            names.any(|name| name.starts_with(temporary))
        };
        while !has() {
            assert!(first.try_wait().unwrap().is_none(), "{line}");
            thread::sleep(Duration::from_millis(5));
        }
        let process = format!("process {} has been writing it since 20", first.id());
        fails(folder.path(), again, 2, &[&process, " UTC"]);
        first.kill().unwrap();
        first.wait().unwrap();
        // The process is dead. The next writer takes over and removes what it has left.
        assert!(has(), "the killed run leaves files");
        succeeds(folder.path(), again);
        assert!(!has(), "no leftovers");
        fs::remove_dir_all(folder.path().join("out")).unwrap();
    };
    let run = "run expert --ticks 1000000000 --out out";
    busy(run, ".city.gif.logicity-", "run easy --ticks 1 --out out");
    let make = "vap make --mode hard --split train --out out --threads 1";
    let other = "vap make --mode easy --split test --worlds 1 --no-pictures --out out --threads 1";
    busy(make, ".manifest.json.logicity-", other);
}

#[test]
fn formatting_keeps_links_and_permissions() {
    let folder = tempfile::tempdir().unwrap();
    let (file, link) = (folder.path().join("file.dl"), folder.path().join("link.dl"));
    fs::write(&file, ".decl A(x:number)").unwrap();
    fs::set_permissions(&file, fs::Permissions::from_mode(0o640)).unwrap();
    symlink("file.dl", &link).unwrap();
    assert_eq!(said(&logicity(folder.path(), "fmt link.dl")), "wrote link.dl\n");
    assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
    assert_eq!(fs::read_to_string(&file).unwrap(), ".decl A(x: number)\n");
    assert_eq!(fs::metadata(&file).unwrap().permissions().mode() & 0o7777, 0o640);
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 2);
    // The outputs of other commands, too.
    let sheet = folder.path().join("sheet.png");
    symlink("real.png", &sheet).unwrap();
    succeeds(folder.path(), "icons sheet -o sheet.png");
    fs::set_permissions(folder.path().join("real.png"), fs::Permissions::from_mode(0o600)).unwrap();
    let before = fs::metadata(folder.path().join("real.png")).unwrap().len();
    succeeds(folder.path(), "icons sheet -o sheet.png --seed 1");
    let after = fs::metadata(folder.path().join("real.png")).unwrap();
    assert!(fs::symlink_metadata(&sheet).unwrap().is_symlink() && after.len() != before);
    assert_eq!(after.permissions().mode() & 0o7777, 0o600);
}

/// Writes rules in several folders, with an absolute and with colliding names, and a configuration that uses them.
fn own_city(folder: &Path) {
    for name in ["cfg", "lib", "lib/more"] {
        fs::create_dir(folder.join(name)).unwrap();
    }
    let root = folder.display();
    let rules = "/// W1: the file of another folder\n.include \"../lib/vocabulary.dl\"\n\
         .include \"../lib/more/rules.dl\"\n\
         /// S1: stop for a pedestrian\nStop(X) :- IsCar(X), IsClose(X, Y), IsPedestrian(Y).\n";
    fs::write(folder.join("cfg/rules.dl"), rules).unwrap();
    // The name of a built-in file, and the other form of an include.
    fs::write(folder.join("lib/vocabulary.dl"), "#include \"more/../types.dl\"\n").unwrap();
    let shipped = fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/rules/vocabulary.dl")).unwrap();
    fs::write(folder.join("lib/types.dl"), shipped).unwrap();
    fs::write(
        folder.join("lib/more/rules.dl"),
        "/// S2: drive slowly as a novice\nSlow(X) :- IsTiro(X).\n",
    )
    .unwrap();
    let config = format!("base: {root}/cfg/base.yaml\nrules: {root}/cfg/rules.dl\nagents: {{base: agents.yaml}}\n");
    fs::write(folder.join("cfg/own.yaml"), config).unwrap();
    fs::write(folder.join("cfg/base.yaml"), "base: configs/expert.yaml\nview: 20\n").unwrap();
    let agents = "test: {cars: [{count: 3, priority: 1, concepts: [tiro]}], pedestrians: [{count: 4}]}\n";
    fs::write(folder.join("cfg/agents.yaml"), agents).unwrap();
}

#[test]
fn a_trace_explains_itself_without_the_files_of_the_run() {
    let folder = tempfile::tempdir().unwrap();
    own_city(folder.path());
    let config = folder.path().join("cfg/own.yaml");
    succeeds(
        folder.path(),
        &format!("run {} --ticks 12 --out out --html out/run.html", config.display()),
    );
    let trace = fs::read_to_string(folder.path().join("out/trace.jsonl")).unwrap();
    let questions = [
        "explain trace.jsonl --agent Car_1",
        "explain trace.jsonl --agent Car_2 --tick 3 --why-not Stop --json",
        "check --coverage trace.jsonl --json",
        "view trace.jsonl -o page.html",
    ];
    // On another machine: another folder, and the files of the run are gone.
    let ask = |here: &Path| questions.map(|line| succeeds(here, line));
    let beside = folder.path().join("out");
    let before = ask(&beside);
    let other = tempfile::tempdir().unwrap();
    fs::copy(beside.join("trace.jsonl"), other.path().join("trace.jsonl")).unwrap();
    let root = folder.path().to_str().unwrap().to_owned();
    let pages = [beside.join("page.html"), beside.join("run.html")].map(|page| fs::read_to_string(page).unwrap());
    drop(folder);
    assert_eq!(ask(other.path()), before);
    assert!(before[0].contains("S1") || before[0].contains("S2"), "{}", before[0]);
    assert_eq!(fs::read_to_string(other.path().join("page.html")).unwrap(), pages[0]);
    // No path of the machine of the run.
    assert!(!trace.contains(&root), "{}", trace.lines().next().unwrap());
    for page in &pages {
        let data = page.lines().map(str::len).max().unwrap();
        assert!(data > 1000 && !page.contains(&root));
    }
    let header: Value = serde_json::from_str(trace.lines().next().unwrap()).unwrap();
    let names = |key: &str| -> Vec<&str> {
        let files = header[key].as_array().unwrap().iter();
        files.map(|file| file["name"].as_str().unwrap()).collect()
    };
    assert_eq!(
        names("rule_files"),
        ["rules.dl", "vocabulary.dl", "types.dl", "2-rules.dl"]
    );
    assert_eq!(
        (&header["rules"], &header["config"]),
        (&"rules.dl".into(), &"own".into())
    );
    let clauses = header["clauses"].as_array().unwrap();
    assert!(clauses.iter().any(|clause| clause["file"] == "2-rules.dl"));
    assert_eq!(header["configuration"]["view"], 20);
}

#[test]
fn edited_rules_do_not_make_a_trace_unexplainable() {
    let folder = tempfile::tempdir().unwrap();
    own_city(folder.path());
    succeeds(folder.path(), "run cfg/own.yaml --ticks 3 --no-pictures --out out");
    let ask = || succeeds(folder.path(), "explain out/trace.jsonl --agent Car_1");
    let before = ask();
    let rules = folder.path().join("cfg/rules.dl");
    fs::write(&rules, fs::read_to_string(&rules).unwrap().replace("S1:", "S9:")).unwrap();
    assert_eq!(ask(), before);
    // Given rules must be those of the run.
    let line = "explain out/trace.jsonl --agent Car_1 --rules cfg/rules.dl";
    fails(folder.path(), line, 1, &["trace-mismatch", "omit --rules"]);
}

/// Returns the hash of the rule files in the header of a trace.
pub fn rules_hash(header: &Value) -> String {
    let mut hash = Sha256::new();
    for file in header["rule_files"].as_array().unwrap() {
        let text = file["text"].as_str().unwrap();
        hash.update((text.len() as u64).to_le_bytes());
        hash.update(text);
    }
    format!("{:x}", hash.finalize())
}

/// Every reader of traces compares the configuration and the rules in the header with their hashes.
#[test]
fn a_trace_with_other_content_than_its_hashes_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    own_city(folder.path());
    succeeds(folder.path(), "run cfg/own.yaml --ticks 3 --no-pictures --out out");
    let trace = fs::read_to_string(folder.path().join("out/trace.jsonl")).unwrap();
    let (header, ticks) = trace.split_once('\n').unwrap();
    let header: Value = serde_json::from_str(header).unwrap();
    assert_eq!(header["rules_hash"], rules_hash(&header));
    type Change<'a> = &'a dyn Fn(&mut Value);
    let changes: [(Change<'_>, &str); 7] = [
        (&|header| header["configuration"]["view"] = 7.into(), "configuration"),
        (&|header| header["config_hash"] = "0".repeat(64).into(), "configuration"),
        (&|header| header["rules_hash"] = "".into(), "rules"),
        (
            &|header| header["rule_files"][0]["text"] = "Stop(X) :- IsCar(X).\n".into(),
            "rules",
        ),
        (&|header| header["rule_files"][3]["text"] = "".into(), "rules"),
        (
            &|header| drop(header["rule_files"].as_array_mut().unwrap().pop()),
            "rules",
        ),
        (
            &|header| {
                let files = header["rule_files"].as_array_mut().unwrap();
                files.push(serde_json::json!({"name": "more.dl", "text": ""}));
            },
            "rules",
        ),
    ];
    let commands = [
        "explain bad.jsonl --agent Car_1",
        "view bad.jsonl -o page.html",
        "view out/trace.jsonl bad.jsonl -o page.html",
        "check --coverage bad.jsonl",
        "check expert --coverage bad.jsonl",
        "induce bad.jsonl -o learned.dl",
        "induce --config expert bad.jsonl -o learned.dl",
    ];
    for (index, (change, what)) in changes.iter().enumerate() {
        let mut header = header.clone();
        change(&mut header);
        fs::write(folder.path().join("bad.jsonl"), format!("{header}\n{ticks}")).unwrap();
        let commands = if index == 0 { &commands[..] } else { &commands[..1] };
        for line in commands {
            let words = ["error[trace-mismatch]", "bad.jsonl:1", what, "the trace was edited"];
            fails(folder.path(), line, 1, &words);
        }
    }
    // Names decide which file an include reaches.
    let mut header = header.clone();
    header["rule_files"][2]["name"] = "vocabulary.dl".into();
    header["rule_files"][1]["name"] = "types.dl".into();
    fs::write(folder.path().join("bad.jsonl"), format!("{header}\n{ticks}")).unwrap();
    fails(folder.path(), commands[0], 1, &["error["]);
    for written in ["page.html", "learned.dl"] {
        assert!(!folder.path().join(written).exists());
    }
}

/// A trace is input from elsewhere. Nothing in it makes the program open a file.
#[test]
fn no_file_that_a_trace_names_is_opened() {
    let folder = tempfile::tempdir().unwrap();
    succeeds(folder.path(), "run easy --ticks 2 --no-pictures --out .");
    let trace = fs::read_to_string(folder.path().join("trace.jsonl")).unwrap();
    let (header, ticks) = trace.split_once('\n').unwrap();
    let secret = folder.path().join("secret");
    fs::write(&secret, "password: hunter2\n").unwrap();
    let path = secret.to_str().unwrap();
    type Change<'a> = &'a dyn Fn(&mut Value);
    let changes: [Change<'_>; 8] = [
        &|header| header["configuration"]["rules"] = path.into(),
        &|header| header["configuration"]["base"] = path.into(),
        &|header| header["configuration"]["map"] = path.into(),
        &|header| header["configuration"] = path.into(),
        &|header| header["config"] = path.into(),
        &|header| {
            header["rule_files"][0]["text"] = format!(".include \"{path}\"\n").into();
            header["rules_hash"] = rules_hash(header).into();
        },
        &|header| header["rule_files"][0]["name"] = path.into(),
        &|header| {
            // The fields of version 1.
            header["version"] = 1.into();
            header["config_file"] = path.into();
            header["rules"] = path.into();
        },
    ];
    for (index, change) in changes.iter().enumerate() {
        let mut header: Value = serde_json::from_str(header).unwrap();
        change(&mut header);
        fs::write(folder.path().join("bad.jsonl"), format!("{header}\n{ticks}")).unwrap();
        for line in [
            "view bad.jsonl -o page.html --force",
            "explain bad.jsonl --agent Car_1",
            "check --coverage bad.jsonl",
        ] {
            let output = logicity(folder.path(), line);
            let all = said(&output) + &String::from_utf8_lossy(&output.stdout);
            assert!(
                !all.contains("hunter2") && !all.contains("panicked"),
                "{index} {line}: {all}"
            );
            let code = output.status.code();
            assert!(matches!(code, Some(0..=2)), "{index} {line}: {all}");
        }
        let page = fs::read_to_string(folder.path().join("page.html")).unwrap_or_default();
        assert!(!page.contains("hunter2"));
    }
}

#[test]
fn traces_of_the_first_version_need_their_configuration() {
    let folder = tempfile::tempdir().unwrap();
    own_city(folder.path());
    succeeds(folder.path(), "run cfg/own.yaml --ticks 3 --no-pictures --out out");
    let path = folder.path().join("out/trace.jsonl");
    let trace = fs::read_to_string(&path).unwrap();
    let (header, ticks) = trace.split_once('\n').unwrap();
    let mut header: Value = serde_json::from_str(header).unwrap();
    header["version"] = 1.into();
    header["config_file"] = "cfg/own.yaml".into();
    header["rules"] = "cfg/rules.dl".into();
    for key in ["configuration", "rule_files"] {
        header.as_object_mut().unwrap().shift_remove(key);
    }
    let now = succeeds(folder.path(), "explain out/trace.jsonl --agent Car_1");
    fs::write(&path, format!("{header}\n{ticks}")).unwrap();
    for line in [
        "explain out/trace.jsonl --agent Car_1",
        "view out/trace.jsonl -o p.html",
        "check --coverage out/trace.jsonl",
    ] {
        fails(folder.path(), line, 1, &["invalid-trace", "version 1", "--config"]);
    }
    let line = "explain out/trace.jsonl --agent Car_1 --config cfg/own.yaml";
    assert_eq!(succeeds(folder.path(), line), now.replace("2-rules.dl", "rules.dl"));
    fs::write(folder.path().join("cfg/rules.dl"), ".include \"vocabulary.dl\"\n").unwrap();
    fails(folder.path(), line, 1, &["trace-mismatch", "rules"]);
}

#[test]
fn the_header_of_a_trace_is_compact() {
    let folder = tempfile::tempdir().unwrap();
    succeeds(folder.path(), "run expert --ticks 1 --no-pictures --out .");
    let trace = fs::read_to_string(folder.path().join("trace.jsonl")).unwrap();
    let header = trace.lines().next().unwrap().len();
    println!("the header of an expert run has {header} bytes");
    assert!(header < 24 << 10, "{header}");
}

/// A pipe that a file names could make the program wait forever. A user may name one on the command line.
#[test]
fn pipes_are_read_only_where_the_user_names_them() {
    let folder = tempfile::tempdir().unwrap();
    let pipe = |name: &str| {
        let path = folder.path().join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        assert!(Command::new("mkfifo").arg(&path).status().unwrap().success());
    };
    let write = |name: &str, text: &str| fs::write(folder.path().join(name), text).unwrap();
    pipe("pipe");
    pipe("pack/car/icon.png");
    pipe("pack/car/icon.svg");
    pipe("facts/A.facts");
    pipe("set/manifest.json");
    write("include.dl", ".include \"pipe\"\n");
    write("facts.dl", ".decl A(x: number)\n.input A\n");
    write("rules.yaml", "base: configs/easy.yaml\nrules: pipe\n");
    write("base.yaml", "base: pipe\n");
    write("map.yaml", "base: configs/easy.yaml\nmap: pipe\n");
    symlink("/dev/null", folder.path().join("null")).unwrap();
    symlink("/dev/zero", folder.path().join("zero")).unwrap();
    write("null.dl", ".include \"null\"\n");
    write("zero.dl", ".include \"zero\"\n");
    for (line, code) in [
        ("check include.dl", 1),
        ("check null.dl", 1),
        ("check zero.dl", 1),
        ("query include.dl", 1),
        ("query facts.dl -F facts", 2),
        ("run rules.yaml --no-trace --ticks 1", 1),
        ("run base.yaml --no-trace --ticks 1", 1),
        ("run map.yaml --no-trace --ticks 1", 1),
        ("icons sheet --pack pack -o sheet.png", 2),
        ("vap check set", 2),
    ] {
        fails(folder.path(), line, code, &["pipe or a device"]);
    }
    let make = "vap make --mode easy --split test --out set";
    fails(folder.path(), make, 2, &["not a regular file"]);
    for line in ["icons sheet -o pipe", "fmt pipe"] {
        let mut writer = Command::new("sh")
            .args(["-c", "printf '.decl A(x:number)' > pipe"])
            .current_dir(folder.path())
            .spawn()
            .unwrap();
        fails(folder.path(), line, 2, &["not a regular file"]);
        let _ = writer.kill();
        writer.wait().unwrap();
    }
    // Not a device, which may never end, and not a link to no file.
    symlink("nowhere", folder.path().join("dangling.dl")).unwrap();
    for (line, words) in [
        ("check zero", "it is a device"),
        ("fmt zero", "it is a device"),
        ("infer zero", "it is a device"),
        ("infer --config zero", "it is a device"),
        ("infer --rules zero", "it is a device"),
        ("query zero", "it is a device"),
        ("view zero -o page.html", "it is a device"),
        ("explain zero --agent Car_1", "it is a device"),
        ("bench infer --scenes zero", "a device"),
        (
            "check dangling.dl",
            "it is a symbolic link to `nowhere`, which does not exist",
        ),
    ] {
        fails(folder.path(), line, 2, &[words]);
        assert!(!said(&logicity(folder.path(), line)).contains("did you mean"), "{line}");
    }
    // Process substitution, as in `check <(command)`.
    let output = Command::new("bash")
        .args(["-c", "\"$0\" check --json <(printf '.decl A(x: number)\\nA(1).\\n')"])
        .arg(env!("CARGO_BIN_EXE_logicity"))
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", said(&output));
}

/// A folder with the bare name of a built-in file does not hide the file.
#[test]
fn folders_do_not_hide_built_in_names() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["expert", "hard", "square-5x5"] {
        fs::create_dir(folder.path().join(name)).unwrap();
    }
    fs::write(
        folder.path().join("mine.yaml"),
        "base: expert\nrules: hard\nmap: square-5x5\n",
    )
    .unwrap();
    for line in [
        "run expert --ticks 1 --no-trace",
        "check hard",
        "run mine.yaml --ticks 1 --no-trace",
    ] {
        let output = logicity(folder.path(), line);
        assert!(output.status.success(), "{line}: {}", said(&output));
    }
    fs::create_dir(folder.path().join("other")).unwrap();
    for line in ["run other --ticks 1 --no-trace", "check other"] {
        fails(folder.path(), line, 2, &["it is a folder, not a file"]);
    }
}
