//! Files: what the program writes, and what it leaves alone. Traces that explain themselves.

use serde_json::Value;
use std::fs;
use std::os::unix::fs::{PermissionsExt, symlink};
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
        succeeds(folder.path(), &format!("{line} --force"));
        for file in files {
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
    succeeds(folder.path(), "fmt link.dl");
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
    // The name of a built-in file.
    fs::write(folder.join("lib/vocabulary.dl"), ".include \"more/../types.dl\"\n").unwrap();
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
        &|header| header["rule_files"][0]["text"] = format!(".include \"{path}\"\n").into(),
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
