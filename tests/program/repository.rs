//! The files around the code agree with each other: metadata of the packages, workflows, hooks, changelog.

use std::fs;
use std::path::PathBuf;

use regex::Regex;

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
    assert_eq!(value("CITATION.cff", "^version: (.*)$"), version);
    let changes = value("CHANGELOG.md", r"^## (.*)$");
    assert!(
        changes.starts_with(&format!("{version} - ")) || changes == "Unreleased",
        "{changes}"
    );

    let repository = value("Cargo.toml", r#"^repository = "(.*)""#);
    assert_eq!(value("python/Cargo.toml", r#"^repository = "(.*)""#), repository);
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
    assert!(read("CONTRIBUTING.md").contains(&format!("Rust {oldest} or later")));
    assert_eq!(read("LICENSE"), read("python/LICENSE.txt"));
    let summary = value("Cargo.toml", r#"^description = "(.*)""#);
    assert_eq!(value("python/pyproject.toml", r#"^description = "(.*)""#), summary);
}

/// The registry of crates takes at most five keywords of at most 20 characters; cargo does not check that.
#[test]
fn keywords_of_the_crate_are_accepted() {
    let keywords = value("Cargo.toml", r"^keywords = \[(.*)\]");
    let keywords: Vec<&str> = keywords.split(", ").map(|keyword| keyword.trim_matches('"')).collect();
    assert!(keywords.len() <= 5, "{keywords:?}");
    let form = Regex::new(r"^[a-z][a-z0-9_+-]{0,19}$").unwrap();
    for keyword in keywords {
        assert!(form.is_match(keyword), "{keyword}");
    }
}

/// Workflows and hooks run targets of the Makefile and files of the repository, and set up tools.
#[test]
fn workflows_run_what_runs_here() {
    let makefile = read("Makefile");
    let target = |name: &str| {
        let rule = Regex::new(&format!(
            r"(?m)^(?:[a-z -]* )?{}(?: [a-z -]*)?:(?:[^=]|$)",
            regex::escape(name)
        ))
        .unwrap();
        rule.is_match(&makefile)
    };
    assert!(target("test") && target("msrv") && !target("tset"));
    let mut commands: Vec<(String, String)> = Vec::new();
    let folder = root().join(".github/workflows");
    let mut workflows: Vec<PathBuf> = fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    workflows.sort();
    assert!(workflows.len() >= 4);
    for path in workflows {
        let name = path.file_name().unwrap().to_str().unwrap().to_owned();
        let text = fs::read_to_string(&path).unwrap();
        let mut lines = text.lines().peekable();
        while let Some(line) = lines.next() {
            let trimmed = line.trim_start();
            let Some(run) = trimmed.strip_prefix("- ").unwrap_or(trimmed).strip_prefix("run: ") else {
                continue;
            };
            if run != "|" {
                commands.push((name.clone(), run.to_owned()));
                continue;
            }
            let indent = line.len() - trimmed.len();
            while let Some(inner) = lines.next_if(|next| next.len() - next.trim_start().len() > indent) {
                commands.push((name.clone(), inner.trim().to_owned()));
            }
        }
    }
    for entry in read(".pre-commit-config.yaml")
        .lines()
        .filter_map(|line| line.trim().strip_prefix("entry: "))
    {
        commands.push((".pre-commit-config.yaml".to_owned(), entry.to_owned()));
    }
    assert!(commands.len() >= 15, "{commands:?}");
    for (file, command) in &commands {
        let words: Vec<&str> = command.split_whitespace().collect();
        match words[0] {
            "make" => {
                for name in words[1..].iter().take_while(|word| !word.contains('=')) {
                    assert!(target(name), "{file}: the Makefile has no target `{name}`");
                }
            }
            "python" if words[1] != "-m" => assert!(root().join(words[1]).is_file(), "{file}: {command}"),
            // These install tools, collect files or create a release.
            "python" | "rustup" | "choco" | "gh" | "mkdir" | "cp" => {}
            "cargo" => assert_eq!(words[1], "install", "{file}: {command}"),
            path => assert!(root().join(path).is_file(), "{file}: {command}"),
        }
    }
}
