//! The files around the code agree with each other: metadata of the packages, workflows, hooks, changelog.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use regex::Regex;
use serde_json::Value;

fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

fn read(path: &str) -> String {
    fs::read_to_string(root().join(path)).unwrap_or_else(|error| panic!("{path}: {error}"))
}

/// Returns the first group of the first match in a file.
fn value(path: &str, pattern: &str) -> String {
    let pattern = Regex::new(&format!("(?m){pattern}")).unwrap();
    let text = read(path);
    let found = pattern
        .captures(&text)
        .unwrap_or_else(|| panic!("{path} has no {pattern}"));
    found[1].to_owned()
}

#[test]
fn manifests_agree() {
    let version = value("Cargo.toml", r#"^version = "(.*)""#);
    assert_eq!(value("python/Cargo.toml", r#"^version = "(.*)""#), version);
    assert_eq!(value("src/datalog/Cargo.toml", r#"^version = "(.*)""#), version);
    let engine = value(
        "Cargo.toml",
        r#"^logicity-datalog = \{ path = "src/datalog", version = "(.*?)""#,
    );
    assert_eq!(engine, version);
    assert_eq!(value("CITATION.cff", "^version: (.*)$"), version);
    let changes = value("CHANGELOG.md", r"^## (.*)$");
    assert!(
        changes.starts_with(&format!("{version} - ")) || changes == "Unreleased",
        "{changes}"
    );

    let repository = value("Cargo.toml", r#"^repository = "(.*)""#);
    assert_eq!(value("python/Cargo.toml", r#"^repository = "(.*)""#), repository);
    assert_eq!(value("src/datalog/Cargo.toml", r#"^repository = "(.*)""#), repository);
    assert_eq!(value("python/pyproject.toml", r#"^Repository = "(.*)""#), repository);
    assert_eq!(value("CITATION.cff", r#"^repository-code: "(.*)""#), repository);
    let private = value(".github/ISSUE_TEMPLATE/config.yml", "^    url: (.*)$");
    assert_eq!(private, format!("{repository}/security/advisories/new"));
    for link in Regex::new(r#"= "(https://github.com/[^"]*)""#)
        .unwrap()
        .captures_iter(&read("python/pyproject.toml"))
    {
        assert!(link[1].starts_with(&repository), "{}", &link[1]);
    }

    let oldest = value("Cargo.toml", r#"^rust-version = "(.*)""#);
    assert_eq!(value("python/Cargo.toml", r#"^rust-version = "(.*)""#), oldest);
    assert_eq!(value("src/datalog/Cargo.toml", r#"^rust-version = "(.*)""#), oldest);
    assert!(read("CONTRIBUTING.md").contains(&format!("Rust {oldest} or later")));
    assert_eq!(read("LICENSE"), read("python/LICENSE.txt"));
    assert_eq!(read("LICENSE"), read("src/datalog/LICENSE"));
    let summary = value("Cargo.toml", r#"^description = "(.*)""#);
    assert_eq!(value("python/pyproject.toml", r#"^description = "(.*)""#), summary);
}

/// Every file that describes the project to a catalog says the same, as `CITATION.cff` does.
#[test]
fn catalogs_agree() {
    let yaml = |path: &str| -> Value { serde_yaml::from_str(&read(path)).unwrap() };
    let json = |path: &str| -> Value { serde_json::from_str(&read(path)).unwrap() };
    let (cited, software, archived) = (yaml("CITATION.cff"), json("codemeta.json"), json(".zenodo.json"));
    let (recipe, article) = (yaml("python/recipe/recipe.yaml"), read("docs/paper/paper.md"));
    let text = |value: &Value| value.as_str().unwrap().to_owned();
    let head: Value = serde_yaml::from_str(article.split("---\n").nth(1).unwrap()).unwrap();

    let title = text(&cited["title"]);
    assert_eq!(title, value("Cargo.toml", r#"^name = "(.*)""#));
    for named in [&software["name"], &archived["title"], &recipe["package"]["name"]] {
        assert_eq!(text(named), title);
    }
    assert!(text(&head["title"]).starts_with(&format!("{title}: ")));

    let version = text(&cited["version"]);
    assert_eq!(version, value("Cargo.toml", r#"^version = "(.*)""#));
    for stated in [
        &software["version"],
        &archived["version"],
        &recipe["context"]["version"],
    ] {
        assert_eq!(text(stated), version);
    }

    let license = text(&cited["license"]);
    assert_eq!(license, value("Cargo.toml", r#"^license = "(.*)""#));
    assert_eq!(
        text(&software["license"]),
        format!("https://spdx.org/licenses/{license}")
    );
    assert_eq!(text(&archived["license"]), license);
    assert_eq!(text(&recipe["about"]["license"]), license);
    assert!(article.contains(&format!("license {license}")));
    let image = read("Dockerfile");
    assert!(image.contains(&format!("licenses=\"{license}\"")));

    let names = |list: &Value| -> Vec<String> {
        let names = list.as_array().unwrap().iter().map(|author| text(&author["name"]));
        names.collect()
    };
    let authors = names(&cited["authors"]);
    assert_eq!(names(&software["author"]), authors);
    assert_eq!(names(&archived["creators"]), authors);
    assert_eq!(names(&head["authors"]), authors);

    let summary = value("Cargo.toml", r#"^description = "(.*)""#);
    assert_eq!(text(&cited["abstract"]), format!("{summary}."));
    for described in [
        &software["description"],
        &archived["description"],
        &recipe["about"]["summary"],
    ] {
        assert_eq!(text(described), summary);
    }
    assert!(image.contains(&format!("description=\"{summary}\"")));
    assert_eq!(software["keywords"], cited["keywords"]);
    assert_eq!(archived["keywords"], cited["keywords"]);

    let repository = text(&cited["repository-code"]);
    for address in [
        &software["codeRepository"],
        &recipe["about"]["repository"],
        &recipe["about"]["homepage"],
    ] {
        assert_eq!(text(address), repository);
    }
    let paper = &cited["references"][0];
    assert_eq!(software["referencePublication"]["name"], paper["title"]);
    assert_eq!(software["referencePublication"]["url"], paper["url"]);
    assert_eq!(
        archived["related_identifiers"][0]["identifier"],
        paper["identifiers"][0]["value"]
    );

    // The dependencies of the conda package are those of the Python package.
    let run = recipe["requirements"]["run"].to_string();
    let python = value("python/pyproject.toml", r#"^requires-python = "(.*)""#);
    assert!(run.contains(&format!("python {python}")), "{run}");
    for dependency in value("python/pyproject.toml", r"^dependencies = \[(.*)\]").split(", ") {
        assert!(
            run.contains(&dependency.trim_matches('"').replace(">=", " >=")),
            "{run}"
        );
    }
}

/// Each citation of the article is in its bibliography, and the other way round.
#[test]
fn citations_of_the_article_are_listed() {
    let keys = |path: &str, pattern: &str| -> BTreeSet<String> {
        let pattern = Regex::new(pattern).unwrap();
        let text = read(path);
        pattern.captures_iter(&text).map(|found| found[1].to_owned()).collect()
    };
    let cited = keys("docs/paper/paper.md", r"@([a-z]+\d{4}[a-z]+)");
    assert!(cited.len() >= 5, "{cited:?}");
    assert_eq!(cited, keys("docs/paper/paper.bib", r"(?m)^@[a-z]+\{([^,]+),"));
}

/// The image is built with the toolchain of the repository from the manifests of the workspace.
#[test]
fn the_image_has_all_manifests() {
    let image = read("Dockerfile");
    let channel = value("rust-toolchain.toml", r#"^channel = "(.*)"$"#);
    assert!(image.contains(&format!("rust:{channel}-")) && image.contains(&format!("RUSTUP_TOOLCHAIN={channel} ")));
    for member in value("Cargo.toml", r"^members = \[(.*)\]").split(", ") {
        let manifest = format!("{}/Cargo.toml", member.trim_matches('"'));
        assert!(image.contains(&format!("COPY {manifest} ")), "{manifest}");
    }
}

/// The registry of crates takes at most five keywords of at most 20 characters; cargo does not check that.
#[test]
fn keywords_of_the_crates_are_accepted() {
    let form = Regex::new(r"^[a-z][a-z0-9_+-]{0,19}$").unwrap();
    for manifest in ["Cargo.toml", "src/datalog/Cargo.toml"] {
        let keywords = value(manifest, r"^keywords = \[(.*)\]");
        let keywords: Vec<&str> = keywords.split(", ").map(|keyword| keyword.trim_matches('"')).collect();
        assert!(keywords.len() <= 5, "{manifest}: {keywords:?}");
        for keyword in keywords {
            assert!(form.is_match(keyword), "{manifest}: {keyword}");
        }
    }
}

/// A workflow of the repository: its file name, its text, and its content.
struct Workflow {
    name: String,
    text: String,
    content: Value,
}

fn workflows() -> Vec<Workflow> {
    let mut paths: Vec<PathBuf> = fs::read_dir(root().join(".github/workflows"))
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    paths.sort();
    assert!(paths.len() >= 5);
    paths
        .into_iter()
        .map(|path| {
            let text = fs::read_to_string(&path).unwrap();
            let content = serde_yaml::from_str(&text).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
            let name = path.file_name().unwrap().to_str().unwrap().to_owned();
            Workflow { name, text, content }
        })
        .collect()
}

/// Returns the commands of a job, once for each value of the variables that its matrix sets.
fn commands_of(job: &Value) -> Vec<String> {
    let mut commands = Vec::new();
    for step in job["steps"].as_array().into_iter().flatten() {
        let Some(run) = step["run"].as_str() else { continue };
        let mut variants = vec![run.to_owned()];
        for (variable, value) in step["env"].as_object().into_iter().flatten() {
            let Some(key) = value.as_str().and_then(|value| value.strip_prefix("${{ matrix.")) else {
                continue;
            };
            let values = job["strategy"]["matrix"][key.trim_end_matches(" }}")].as_array();
            let values = values.map_or(&[][..], |values| values);
            variants = variants
                .iter()
                .flat_map(|run| {
                    values
                        .iter()
                        .map(move |value| run.replace(&format!("${variable}"), value.as_str().unwrap()))
                })
                .collect();
        }
        let lines = variants.iter().flat_map(|run| run.lines());
        commands.extend(lines.map(|line| line.replace('"', "")));
    }
    commands
}

/// Workflows and hooks run targets of the Makefile and files of the repository, and set up tools.
#[test]
fn workflows_run_what_runs_here() {
    let makefile = read("Makefile");
    let fuzz_targets = value("Makefile", "^FUZZ_TARGETS := (.*)$");
    let target = |name: &str| {
        let rule = Regex::new(&format!(
            r"(?m)^(?:[a-z -]* )?{}(?: [a-z -]*)?:(?:[^=]|$)",
            regex::escape(name)
        ))
        .unwrap();
        let fuzz_target = name.strip_prefix("fuzz-");
        rule.is_match(&makefile) || fuzz_target.is_some_and(|name| fuzz_targets.split(' ').any(|known| known == name))
    };
    assert!(target("test") && target("msrv") && target("fuzz-parse") && !target("tset") && !target("fuzz-tset"));
    let mut commands: Vec<(String, String)> = Vec::new();
    for workflow in workflows() {
        for (_, job) in workflow.content["jobs"].as_object().unwrap() {
            let name = &workflow.name;
            commands.extend(commands_of(job).into_iter().map(|command| (name.clone(), command)));
        }
    }
    for hook in ["pre-commit", "pre-push"].map(|name| format!(".githooks/{name}")) {
        let text = read(&hook);
        let lines = text.lines().map(str::trim).filter(|line| line.starts_with("make "));
        commands.extend(lines.map(|line| (hook.clone(), line.to_owned())));
    }
    assert!(commands.len() >= 30, "{commands:?}");
    for (file, command) in &commands {
        let words: Vec<&str> = command.split_whitespace().collect();
        match words[0] {
            "make" => {
                for name in words[1..].iter().take_while(|word| !word.contains('=')) {
                    assert!(target(name), "{file}: the Makefile has no target `{name}`");
                }
            }
            "python" if words[1] == "-m" => {
                if let Some(list) = words.iter().find(|word| word.ends_with(".txt")) {
                    assert!(root().join(list).is_file(), "{file}: {command}");
                }
            }
            "python" => assert!(root().join(words[1]).is_file(), "{file}: {command}"),
            // These install tools or create a release.
            "rustup" | "choco" | "gh" => {}
            "cargo" => assert!(
                words[1..3] == ["install", "--locked"] && words[3].contains('@'),
                "{file}: `{command}` installs no fixed version"
            ),
            path => assert!(root().join(path).is_file(), "{file}: {command}"),
        }
    }
}

/// Runs a program in another repository than this one. git sets the removed variables when a hook runs the tests.
fn run_in(repository: &Path, program: &Path, arguments: &[&str]) -> Output {
    let mut command = Command::new(program);
    for name in ["GIT_DIR", "GIT_INDEX_FILE", "GIT_WORK_TREE"] {
        command.env_remove(name);
    }
    command.current_dir(repository).args(arguments).output().unwrap()
}

fn git(repository: &Path, arguments: &[&str]) {
    let options = ["-c", "user.name=A Name", "-c", "user.email=name@example.org"];
    let output = run_in(repository, Path::new("git"), &[&options, arguments].concat());
    assert!(output.status.success(), "{arguments:?}: {output:?}");
}

/// Returns the complaints of a script, and checks that it fails if there are any.
fn complaints(repository: &Path, script: &str, argument: &str) -> Vec<String> {
    let output = run_in(repository, &root().join(script), &[argument]);
    let text = String::from_utf8(output.stderr).unwrap();
    let prefix = format!("{}: ", script.rsplit_once('/').unwrap().1);
    let found: Vec<String> = (text.lines().filter_map(|line| line.strip_prefix(&prefix)))
        .map(str::to_owned)
        .collect();
    assert_eq!(output.status.success(), found.is_empty(), "{text}");
    found
}

#[test]
fn the_hook_checks_messages_of_commits() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    git(folder, &["init", "--quiet"]);
    let of = |message: &str, lines: usize| {
        fs::write(folder.join("added"), "line\n".repeat(lines)).unwrap();
        fs::write(folder.join("message"), message).unwrap();
        git(folder, &["add", "added"]);
        complaints(folder, ".githooks/commit-msg", "message")
    };
    let long = |length: usize| format!("Add {}\n", "é".repeat(length - 4));
    for accepted in [
        "Add leapfrog joins to the planner\n",
        "Process one row at a time\n\nIt is faster.\n# A comment of git\n",
        "Bring the decisions up to date\n",
        "Merge branch 'joins'\n",
        "fixup! Add joins\n",
        &long(72),
    ] {
        assert_eq!(of(accepted, 200), [""; 0], "{accepted}");
    }
    assert_eq!(of(&long(73), 1), ["the subject has 73 characters; at most 72 fit"]);
    assert_eq!(of("Add joins.\n", 1), ["the subject ends with a period"]);
    assert_eq!(
        of("add joins\n", 1),
        ["the subject does not begin with a capital letter"]
    );
    for other in ["Added joins\n", "Adds joins\n", "Adding joins\n"] {
        assert!(of(other, 1)[0].contains("is not an imperative"), "{other}");
    }
    assert_eq!(
        of("Add joins\nto the planner\n", 1),
        ["the line after the subject is not empty"]
    );
    let no_body = ["the change has 201 lines: say why in a body"];
    assert_eq!(of("Add joins\n\n# Changes to be committed:\n", 201), no_body);
    assert_eq!(
        of("Add joins\n\nSigned-off-by: A Name <name@example.org>\n", 201),
        no_body
    );
    assert_eq!(of("Add joins\n\nScans were slow.\n", 201), [""; 0]);
}

#[test]
fn a_release_needs_equal_versions_a_date_and_an_owner() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let write = |name: &str, text: &str| {
        let path = folder.join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, text).unwrap();
        git(folder, &["add", name]);
    };
    git(folder, &["init", "--quiet"]);
    let files = [
        (
            "Cargo.toml",
            "version = \"0.2.0\"\n\n[dependencies]\na = { path = \"a\", version = \"0.2.0\" }\nb = \"3\"\n",
        ),
        ("python/Cargo.toml", "version = \"0.2.0\"\n"),
        ("benches/peers/Cargo.toml", "version = \"0.0.0\"\n"),
        ("CITATION.cff", "cff-version: 1.2.0\nversion: 0.2.0\n"),
        ("codemeta.json", "{\n  \"version\": \"0.2.0\",\n}\n"),
        (".zenodo.json", "{\n  \"version\": \"0.2.0\",\n}\n"),
        ("python/recipe/recipe.yaml", "context:\n  version: \"0.2.0\"\n"),
        ("python/pyproject.toml", "dynamic = [\"version\"]\n"),
        (
            "CHANGELOG.md",
            "# Changelog\n\n## 0.2.0 - 2024-02-29\n\n## 0.1.0 - Unreleased\n",
        ),
    ];
    for (name, text) in files {
        write(name, text);
    }
    git(folder, &["commit", "--quiet", "--message", "Add files"]);
    let check = || complaints(folder, ".ci/release-check", "0.2.0");
    assert_eq!(check(), [""; 0]);

    for (name, text, reason) in [
        (
            "python/Cargo.toml",
            "version = \"0.1.0\"\n",
            "python/Cargo.toml has version 0.1.0, not 0.2.0",
        ),
        (
            "Cargo.toml",
            "version = \"0.2.0\"\n\n[dependencies]\na = { path = \"a\", version = \"0.1.0\" }\n",
            "Cargo.toml depends on version 0.1.0 of a crate of this repository",
        ),
        (
            "CITATION.cff",
            "version: 0.1.0\n",
            "CITATION.cff has version 0.1.0, not 0.2.0",
        ),
        (
            "codemeta.json",
            "{\n  \"version\": \"0.1.0\",\n}\n",
            "codemeta.json has version 0.1.0, not 0.2.0",
        ),
        (
            "python/recipe/recipe.yaml",
            "context:\n  version: \"0.1.0\"\n",
            "python/recipe/recipe.yaml has version 0.1.0, not 0.2.0",
        ),
        (
            "python/pyproject.toml",
            "version = \"0.2.0\"\n",
            "python/pyproject.toml states a version of its own",
        ),
        (
            "CHANGELOG.md",
            "## 0.2.0 - Unreleased\n",
            "the first section of CHANGELOG.md is \"0.2.0 - Unreleased\", not \"0.2.0 - DATE\"",
        ),
        (
            "CHANGELOG.md",
            "## 0.2.0 - 9999-01-01\n",
            "the date of the first section of CHANGELOG.md is in the future",
        ),
        (
            "SECURITY.md",
            "\nhttps://github.com/OWNER/logicity\n",
            "SECURITY.md:2 names the placeholder OWNER",
        ),
    ] {
        write(name, text);
        git(folder, &["commit", "--quiet", "--message", "Break a file"]);
        assert_eq!(check(), [reason]);
        git(folder, &["reset", "--quiet", "--hard", "HEAD~1"]);
    }
    fs::write(folder.join("new"), "").unwrap();
    assert_eq!(check(), ["the working tree has changes; commit or remove them"]);
    git(folder, &["add", "new"]);
    git(folder, &["tag", "v0.2.0"]);
    git(folder, &["commit", "--quiet", "--message", "Add a file"]);
    assert_eq!(check(), ["the tag v0.2.0 is on another commit"]);
}

/// Workflows use only actions of GitHub itself, each pinned by its commit, so a moved tag changes nothing. A job has no
/// permission that it does not list, and no checkout leaves a token behind.
#[test]
fn actions_are_pinned_by_commit() {
    let pinned = Regex::new(r"^\s*(?:- )?uses: actions/[a-z/-]+@[0-9a-f]{40} # v\d+\.\d+\.\d+$").unwrap();
    let mut used = 0;
    for Workflow { name, text, content } in workflows() {
        for line in text.lines().filter(|line| line.contains("uses:")) {
            let own = line.trim_start().starts_with("uses: ./.github/workflows/");
            assert!(own || pinned.is_match(line), "{name}: {line}");
            used += 1;
        }
        assert_eq!(content["permissions"], serde_json::json!({}), "{name}");
        for (id, job) in content["jobs"].as_object().unwrap() {
            assert!(
                job["permissions"].is_object(),
                "{name}: the job `{id}` lists no permissions"
            );
            for step in job["steps"].as_array().into_iter().flatten() {
                if step["uses"]
                    .as_str()
                    .is_some_and(|uses| uses.starts_with("actions/checkout@"))
                {
                    assert_eq!(step["with"]["persist-credentials"], false, "{name}: {id}");
                }
            }
        }
    }
    assert!(used >= 20, "{used}");
}

/// Jobs with a secret compile nothing: build scripts of dependencies would see it.
#[test]
fn no_build_script_sees_a_secret() {
    let compiles_nothing = value(
        "Makefile",
        r"^publish:\n\t(cargo publish --locked --no-verify \$\(CRATES\))$",
    );
    assert!(!compiles_nothing.is_empty());
    for Workflow { name, content, .. } in workflows() {
        for (id, job) in content["jobs"].as_object().unwrap() {
            if job.to_string().contains("secrets.") {
                let commands = commands_of(job);
                let is_known =
                    |command: &String| ["rustup toolchain install", "make publish"].contains(&command.as_str());
                assert!(commands.iter().all(is_known), "{name}: {id}: {commands:?}");
            }
        }
    }
}

/// One toolchain compiles everywhere, and it is not older than the oldest supported one.
#[test]
fn the_toolchain_is_pinned() {
    let channel = value("rust-toolchain.toml", r#"^channel = "(\d+\.\d+\.\d+)"$"#);
    let numbers = |version: &str| -> Vec<u32> { version.split('.').map(|part| part.parse().unwrap()).collect() };
    assert!(numbers(&channel) >= numbers(&value("Cargo.toml", r#"^rust-version = "(.*)""#)));
    assert_eq!(
        value(
            ".github/workflows/nightly.yml",
            r"^    container: rust:([\d.]*)-bookworm$"
        ),
        channel
    );
}

/// The nightly workflow fuzzes every target.
#[test]
fn all_targets_are_fuzzed() {
    let listed: Vec<String> = value("Makefile", "^FUZZ_TARGETS := (.*)$")
        .split(' ')
        .map(str::to_owned)
        .collect();
    let nightly = value(".github/workflows/nightly.yml", r"^        target: \[(.*)\]$");
    assert_eq!(nightly.split(", ").collect::<Vec<_>>(), listed);
    let manifest = read("tests/fuzz/Cargo.toml");
    let mut programs: Vec<&str> = Regex::new(r#"path = "targets/(.*)\.rs""#)
        .unwrap()
        .captures_iter(&manifest)
        .map(|found| found.get(1).unwrap().as_str())
        .collect();
    let mut listed: Vec<&str> = listed.iter().map(String::as_str).collect();
    programs.sort_unstable();
    listed.sort_unstable();
    assert_eq!(programs, listed);
}

/// Updates are configured for every list of dependencies, and the jobs that build and publish packages install nothing
/// that is not pinned by hash.
#[test]
fn dependencies_are_updated_and_pinned() {
    let content: Value = serde_yaml::from_str(&read(".github/dependabot.yml")).unwrap();
    let mut folders: Vec<(String, String)> = Vec::new();
    for update in content["updates"].as_array().unwrap() {
        let kind = update["package-ecosystem"].as_str().unwrap();
        let many = update["directories"].as_array().into_iter().flatten();
        for folder in many.chain(update.get("directory")) {
            folders.push((kind.to_owned(), folder.as_str().unwrap().to_owned()));
        }
    }
    let updated = |kind: &str, folder: &str| folders.contains(&(kind.to_owned(), folder.to_owned()));
    for (kind, file) in [
        ("cargo", "Cargo.lock"),
        ("cargo", "benches/peers/Cargo.lock"),
        ("rust-toolchain", "rust-toolchain.toml"),
        ("pip", ".github/requirements/publish.txt"),
        ("pip", "benches/solvers/requirements.txt"),
        ("pip", "python/pyproject.toml"),
        ("npm", "editors/vscode/package-lock.json"),
        ("github-actions", ".github/workflows/test.yml"),
    ] {
        assert!(root().join(file).is_file(), "{file}");
        let folder = match kind {
            "github-actions" => "",
            _ => file.rsplit_once('/').map_or("", |(folder, _)| folder),
        };
        assert!(updated(kind, &format!("/{folder}")), "no updates for {file}");
    }
    let hashed = Regex::new(r"(?m)^[a-z][^=\n]*==.*(\n    --hash=sha256:[0-9a-f]{64}( \\)?)+$").unwrap();
    for name in ["publish", "wheels"] {
        let text = read(&format!(".github/requirements/{name}.txt"));
        let mut packages = 0;
        for package in hashed.find_iter(&text) {
            packages += usize::from(!package.is_empty());
        }
        let lines = text
            .lines()
            .filter(|line| line.starts_with(|c: char| c.is_alphanumeric()))
            .count();
        assert!(
            packages == lines && lines > 0,
            "{name}: {packages} of {lines} packages have a hash"
        );
    }
    for Workflow { name, content, .. } in workflows() {
        if ["release.yml", "wheels.yml"].contains(&name.as_str()) {
            for command in content["jobs"].as_object().unwrap().values().flat_map(commands_of) {
                let installs = command.contains("pip install") && !command.ends_with("target/wheels/*.whl");
                assert!(!installs || command.contains("--require-hashes"), "{name}: {command}");
            }
            assert!(!content.to_string().contains("actions/cache"), "{name} reads a cache");
        }
    }
}

/// The table of executions has rows of each target and 10^8 executions in total, and none failed.
#[test]
fn executions_of_the_fuzzer_are_recorded() {
    let table = read("tests/fuzz/executions.csv");
    let mut lines = table.lines();
    assert_eq!(
        lines.next(),
        Some("commit,date,target,corpus,longest,executions,seconds,result")
    );
    let row = Regex::new(r"^[0-9a-f]{8},\d{4}-\d\d-\d\d,(\w+),\d+,\d+,(\d+),\d+,(passed|interrupted)$").unwrap();
    let (mut recorded, mut total) = (BTreeSet::new(), 0);
    for line in lines {
        let columns = row.captures(line).unwrap_or_else(|| panic!("{line}"));
        recorded.insert(columns[1].to_owned());
        total += columns[2].parse::<u64>().unwrap();
    }
    let listed = value("Makefile", "^FUZZ_TARGETS := (.*)$");
    assert_eq!(recorded, listed.split(' ').map(str::to_owned).collect());
    assert!(total >= 100_000_000, "{total}");
}
