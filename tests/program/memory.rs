//! Peak memory: an evaluation that runs away stays within its limit and ends with a message.

use std::fs;
use std::path::Path;
use std::process::Command;

/// The variable that names the arguments of [`measured`].
const ARGUMENTS: &str = "LOGICITY_MEASURED_ARGUMENTS";

/// The memory that the process may use besides what an evaluation counts, for buffers of fixed size.
const MARGIN: u64 = 24 << 20;

/// A finished process.
struct Measured {
    code: i32,
    error: String,
    /// The peak of its resident memory, in bytes.
    peak: u64,
}

/// Runs the program and measures its peak memory. The system reports the largest peak of all child processes, so a
/// separate process runs this test program again, for [`measured`] alone.
fn measure(arguments: &[&str]) -> Measured {
    let output = Command::new(std::env::current_exe().unwrap())
        .args(["--exact", "memory::measured", "--ignored", "--nocapture"])
        .env(ARGUMENTS, arguments.join("\n"))
        .output()
        .unwrap();
    let printed = String::from_utf8(output.stdout).unwrap();
    let line = printed.lines().find_map(|line| line.strip_prefix("measured "));
    let (code, peak) = line
        .and_then(|line| line.split_once(' '))
        .unwrap_or_else(|| panic!("{printed}"));
    Measured {
        code: code.parse().unwrap(),
        error: String::from_utf8(output.stderr).unwrap(),
        peak: peak.parse().unwrap(),
    }
}

#[test]
#[ignore = "a part of the other tests, in a separate process"]
fn measured() {
    let arguments = std::env::var(ARGUMENTS).expect("another test sets it");
    let status = Command::new(env!("CARGO_BIN_EXE_logicity"))
        .args(arguments.lines())
        .status()
        .unwrap();
    let usage = nix::sys::resource::getrusage(nix::sys::resource::UsageWho::RUSAGE_CHILDREN).unwrap();
    println!("\nmeasured {} {}", status.code().unwrap_or(-1), usage.max_rss() << 10);
}

fn write(folder: &Path, name: &str, text: &str) -> String {
    let path = folder.join(name);
    fs::write(&path, text).unwrap();
    path.to_str().unwrap().to_owned()
}

/// Programs that run away, each in another part of the evaluation.
const RUNAWAYS: [(&str, &str); 9] = [
    (
        "dense rows",
        "N(x) :- x = range(0, 2000). P(x, y, z) :- N(x), N(y), N(z).",
    ),
    (
        "sparse rows",
        "N(x * 1000003) :- x = range(0, 2000). P(x, y, z) :- N(x), N(y), N(z).",
    ),
    (
        "repeated rows",
        "N(x) :- x = range(0, 3000). P(x * 7919 % 1000003 * 2003, y, x) :- N(x), N(y), N(z), z < 40.",
    ),
    (
        "a closure",
        "N(x) :- x = range(0, 6000). Q(x, (x * 7 + 1) % 6000) :- N(x). Q(x, (x * 13 + 5) % 6000) :- N(x).
        P(x, y, 0) :- Q(x, y). P(x, z, 0) :- P(x, y, 0), Q(y, z).",
    ),
    (
        "a sparse closure",
        "N(x) :- x = range(0, 6000). Q(x * 300007, (x * 7 + 1) % 6000 * 300007) :- N(x).
        Q(x * 300007, (x * 13 + 5) % 6000 * 300007) :- N(x).
        P(x, y, 0) :- Q(x, y). P(x, z, 0) :- P(x, y, 0), P(y, z, 0).",
    ),
    (
        "doubling",
        "N(1). N(x * 2) :- N(x), x > 0. N(x * 2 + 1) :- N(x), x > 0.",
    ),
    ("texts", "T(\"a\"). T(cat(x, \"b\")) :- T(x). T(cat(x, \"c\")) :- T(x)."),
    (
        "groups",
        "N(x) :- x = range(0, 3000). P(x, y, n) :- N(x), N(y), n = sum z : { Q(x, z), N(y), z > y }.
        Q(x, x + 1) :- N(x).",
    ),
    (
        "indexes",
        "N(x) :- x = range(0, 700). Q(x, y) :- N(x), N(y).
        P(a, b, 0) :- N(a), a < 3, Q(x, a), Q(x, b), Q(b, x), Q(a, b).
        P(a, b, c) :- Q(a, b), Q(b, c), Q(c, a).",
    ),
];

const DECLARATIONS: &str = ".decl N(x: number)
.decl Q(x: number, y: number)
.decl P(x: number, y: number, z: number)
.decl T(x: symbol)
.printsize P
";

#[test]
fn runaways_stay_within_the_limit() {
    const LIMIT: u64 = 24;
    let folder = tempfile::tempdir().unwrap();
    let small = write(folder.path(), "small.dl", &format!("{DECLARATIONS}P(1, 2, 3)."));
    let least = measure(&["query", &small, "-F", folder.path().to_str().unwrap(), "-D", "-"]);
    assert_eq!(least.code, 0, "{}", least.error);
    for (name, rules) in RUNAWAYS {
        let file = write(folder.path(), "runaway.dl", &format!("{DECLARATIONS}{rules}"));
        for threads in ["1", "3"] {
            let limit = LIMIT.to_string();
            let run = measure(&["query", &file, "--max-memory", &limit, "--threads", threads, "-D", "-"]);
            assert_eq!(run.code, 1, "{name}: {}", run.error);
            assert!(run.error.contains("take more than 24 MiB"), "{name}: {}", run.error);
            // Texts grow without end, so a larger limit does not help.
            let help = if name == "texts" { "bound them" } else { "--max-memory" };
            assert!(run.error.contains(help), "{name}: {}", run.error);
            let extra = run.peak.saturating_sub(least.peak);
            println!("{name}, {threads} threads: {} MiB", extra >> 20);
            assert!(
                extra < (LIMIT << 20) + MARGIN,
                "{name}, {threads} threads: {} MiB",
                extra >> 20
            );
        }
    }
}

#[test]
fn rows_of_a_file_count() {
    let folder = tempfile::tempdir().unwrap();
    let rows: String = (0..1_500_000).map(|row| format!("{row}\t{}\n", row % 1_000)).collect();
    write(folder.path(), "Q.facts", &rows);
    let file = write(folder.path(), "input.dl", &format!("{DECLARATIONS}.input Q"));
    let folder = folder.path().to_str().unwrap();
    let limited = |limit| measure(&["query", &file, "-F", folder, "-D", "-", "--max-memory", limit]);
    let (enough, less) = (limited("40"), limited("8"));
    assert_eq!(enough.code, 0, "{}", enough.error);
    assert_eq!(less.code, 1, "{}", less.error);
    assert!(
        less.error.contains("the inserted rows take more than 8 MiB"),
        "{}",
        less.error
    );
    let least = measure(&["--version"]);
    // 18 MB of rows, without their text.
    assert!(
        enough.peak - least.peak < 44 << 20,
        "{}",
        (enough.peak - least.peak) >> 20
    );
    // The text of 17 MiB, the limit, and pages of code.
    assert!(less.peak - least.peak < 36 << 20, "{}", (less.peak - least.peak) >> 20);
}

/// The memory that any command may use besides its limit: for the program itself and buffers of fixed size.
const BESIDES: u64 = 96 << 20;

/// Asserts that a command with `--max-memory` fails with a diagnostic, within the memory that the limit allows.
fn stays_bounded(limit: u64, arguments: &[&str], words: &str) {
    let size = limit.to_string();
    let run = measure(&[arguments, &["--max-memory", &size]].concat());
    assert_eq!(run.code, 1, "{arguments:?}: {}", run.error);
    assert!(run.error.contains("error["), "{arguments:?}: {}", run.error);
    assert!(run.error.contains(words), "{arguments:?}: {}", run.error);
    assert!(
        run.peak < (limit << 20) + BESIDES,
        "{arguments:?}: {} MiB",
        run.peak >> 20
    );
}

/// Every command that reads files, on a file far larger than the limit.
#[test]
fn every_command_stays_within_its_limit() {
    let folder = tempfile::tempdir().unwrap();
    let sparse = |name: &str| {
        let path = folder.path().join(name);
        fs::File::create(&path).unwrap().set_len(400 << 20).unwrap();
        path.to_str().unwrap().to_owned()
    };
    let (rules, data) = (&sparse("large.dl"), &sparse("large.jsonl"));
    let small = &write(folder.path(), "small.jsonl", "");
    let target = folder.path().join("out");
    let out = target.to_str().unwrap();
    let page = &format!("{out}.html");
    let map = &sparse("large.yaml");
    fs::create_dir(folder.path().join("set")).unwrap();
    sparse("set/manifest.json");
    let set = folder.path().join("set");
    let commands: [&[&str]; 18] = [
        &["bench", "tick", "--rules", rules],
        &["check", rules],
        &["episodes", "make", "expert", "--rules", rules, "--output", out],
        &["diff", rules, rules],
        &["shortcuts", rules],
        &["explain", data, "--agent", "Car_1"],
        &["fmt", rules],
        &["induce", data],
        &["induce", small, "--rules", rules],
        &["infer", data],
        &["infer", small, "--rules", rules],
        &["query", rules],
        &["questions", "--rules", rules],
        &["repl", rules],
        &["route", "--map", map, "--type", "car", "--from", "1,1", "--to", "2,2"],
        &["run", "expert", "--rules", rules],
        &["view", data, "-o", page],
        &["run", data],
    ];
    for command in commands {
        stays_bounded(16, command, "");
    }
    let check = measure(&["vap", "check", set.to_str().unwrap(), "--max-memory", "16"]);
    assert!(
        check.code == 2 && check.error.contains("larger than 48 MiB"),
        "{}",
        check.error
    );
    assert!(check.peak < (16 << 20) + BESIDES, "{} MiB", check.peak >> 20);
    let names = fs::read_dir(folder.path()).unwrap();
    let mut names = names.map(|entry| entry.unwrap().file_name().into_string().unwrap());
    assert_eq!(
        names.find(|name| name.starts_with('.')),
        None,
        "no temporary file remains"
    );
}

/// Facts are counted while they are read, however well they are compressed.
#[test]
fn compressed_facts_count() {
    use std::io::Write;
    let folder = tempfile::tempdir().unwrap();
    let facts = |parts: &mut dyn Iterator<Item = Vec<u8>>| {
        let file = fs::File::create(folder.path().join("S.facts.gz")).unwrap();
        let mut file = flate2::write::GzEncoder::new(file, flate2::Compression::fast());
        parts.for_each(|part| file.write_all(&part).unwrap());
        file.finish().unwrap();
    };
    let here = folder.path().to_str().unwrap();
    let program = |columns: &str| {
        write(
            folder.path(),
            "facts.dl",
            &format!(".decl S({columns})\n.input S\n.printsize S"),
        )
    };
    let (texts, pairs) = (program("x: symbol"), "x: symbol, y: symbol");
    // Empty texts, one text of 300 MB, and an empty line where two values are expected.
    facts(&mut (0..20).map(|_| vec![b'\n'; 1 << 20]));
    stays_bounded(
        16,
        &["query", &texts, "-F", here, "-D", "-"],
        "the inserted rows take more than 16 MiB",
    );
    facts(&mut (0..300).map(|_| vec![b'a'; 1 << 20]));
    stays_bounded(
        16,
        &["query", &texts, "-F", here, "-D", "-"],
        "the inserted rows take more than 16 MiB",
    );
    stays_bounded(
        16,
        &["query", &program(pairs), "-F", here, "-D", "-"],
        "the inserted rows take more than 16 MiB",
    );
    facts(&mut (0..300).map(|_| vec![b'\t'; 1 << 20]));
    stays_bounded(
        16,
        &["query", &program(pairs), "-F", here, "-D", "-"],
        "the inserted rows take more than 16 MiB",
    );
    facts(&mut (0..300).map(|_| vec![b'\n'; 1 << 20]));
    stays_bounded(
        16,
        &["query", &program(pairs), "-F", here, "-D", "-"],
        "more than 1001 errors",
    );
}

/// A search for an explanation counts the texts that it makes, its indexes and its steps.
#[test]
fn explanations_stay_within_the_limits() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path().to_str().unwrap();
    let rules = ".decl r(x: symbol)\n.decl q(x: symbol, n: number)\nr(x) :- r(cat(x, x)), q(x, n).\n.output r";
    let rules = write(folder.path(), "rules.dl", rules);
    let question = ["query", &rules, "-F", here, "-D", "-", "--why-not", "r(\"A\")"];
    stays_bounded(16, &question, "the search for an explanation takes more than 16 MiB");
    stays_bounded(16, &[&question[..], &["--max-steps", "20"]].concat(), "--max-steps");
    let rules = ".decl n(x: number)\n.decl p(x: number)\n.decl r(x: number)\nn(x) :- x = range(0, 300000).
        p(x) :- n(x), x != 7.\nr(x) :- n(x), p(x), x < 0.\n.output r";
    let rules = write(folder.path(), "rules.dl", rules);
    let question = ["query", &rules, "-F", here, "-D", "-", "--explain", "p(9)"];
    stays_bounded(32, &question, "the search for an explanation takes more than 32 MiB");
}

/// What the egos of a crowd see together is far more than the scene says; `infer` writes it ego by ego.
#[test]
fn a_crowd_is_answered_ego_by_ego() {
    let folder = tempfile::tempdir().unwrap();
    let agent = |number| {
        serde_json::json!({
            "id": format!("Car_{number}"), "type": "Car", "at": [102, 20], "heading": "Up", "priority": number
        })
    };
    let agents: Vec<_> = (0..50).map(agent).collect();
    let scene = serde_json::json!({ "map": "square-5x5", "agents": agents }).to_string();
    let scene = write(folder.path(), "crowd.jsonl", &scene);
    let answers = folder.path().join("answers.jsonl");
    let run = measure(&["infer", &scene, "--max-memory", "8", "--out", answers.to_str().unwrap()]);
    assert_eq!(run.code, 0, "{}", run.error);
    assert!(run.peak < (8 << 20) + BESIDES / 2, "{} MiB", run.peak >> 20);
    let answers: serde_json::Value = serde_json::from_str(&fs::read_to_string(answers).unwrap()).unwrap();
    let egos = answers["egos"].as_object().unwrap();
    assert_eq!(egos.len(), 50);
    assert!(egos.values().all(|ego| ego["sees"].as_array().unwrap().len() == 50));
}

/// Runs the program with an address space of `kib` KiB.
fn in_address_space(kib: u64, arguments: &[&str]) -> (Option<i32>, String) {
    let output = Command::new("sh")
        .args(["-c", "ulimit -v \"$0\" && exec \"$@\"", &kib.to_string()])
        .arg(env!("CARGO_BIN_EXE_logicity"))
        .args(arguments)
        .output()
        .unwrap();
    (output.status.code(), String::from_utf8(output.stderr).unwrap())
}

#[test]
fn runaways_in_a_small_address_space_end_with_a_message() {
    let folder = tempfile::tempdir().unwrap();
    let runaways = RUNAWAYS
        .into_iter()
        .filter(|(name, _)| ["sparse rows", "a closure", "texts"].contains(name));
    for (name, rules) in runaways {
        let file = write(folder.path(), "runaway.dl", &format!("{DECLARATIONS}{rules}"));
        let (code, error) = in_address_space(280_000, &["query", &file, "-D", "-"]);
        assert_eq!(code, Some(1), "{name}: {error}");
        let help = if name == "texts" { "bound them" } else { "`ulimit -v`" };
        assert!(error.contains(help), "{name}: {error}");
    }
}

/// An abort that no failed allocation causes keeps its signal.
#[test]
fn other_aborts_stay_visible() {
    use std::os::unix::process::ExitStatusExt;
    use std::process::Stdio;
    let mut process = Command::new("sh")
        .args(["-c", "ulimit -c 0; exec \"$0\" repl"])
        .arg(env!("CARGO_BIN_EXE_logicity"))
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut input = process.stdin.take().unwrap();
    let mut output = process.stdout.take().unwrap();
    std::io::Write::write_all(&mut input, b".help\n").unwrap();
    // Its first output shows that it has begun.
    std::io::Read::read_exact(&mut output, &mut [0]).unwrap();
    let id = process.id().to_string();
    assert!(Command::new("kill").args(["-ABRT", &id]).status().unwrap().success());
    let status = process.wait().unwrap();
    assert_eq!((status.code(), status.signal()), (None, Some(6)));
    drop(input);
}

/// Where no limit applies, a failed allocation ends the process with a message and code 1.
#[test]
fn a_failed_allocation_ends_with_a_message() {
    let folder = tempfile::tempdir().unwrap();
    let facts: String = (0..400_000).map(|row| format!("Q({row}, 1).\n")).collect();
    let file = write(folder.path(), "facts.dl", &format!("{DECLARATIONS}{facts}"));
    for command in ["check", "query"] {
        let (code, error) = in_address_space(100_000, &[command, &file]);
        assert_eq!(code, Some(1), "{command}: {error}");
        assert!(error.contains("memory allocation of"), "{command}: {error}");
    }
}
