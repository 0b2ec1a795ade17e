//! The rule language: rule files, fixtures, reference, round trip, hostile texts.

use std::path::{Path, PathBuf};

use logicity::diag::{Code, Diagnostic, Severity, Sources, render};
use logicity::files::{ReadError, read_text};
use logicity::lang::{BUILTIN, Loaded, Rules, load};

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// Reads files; under [`BUILTIN`] those of `rules/`.
fn read(path: &Path) -> Result<String, ReadError> {
    match path.strip_prefix(BUILTIN) {
        Ok(name) => read_text(&root().join("rules").join(name)),
        Err(_) => read_text(path),
    }
}

fn load_text(name: &str, text: &str) -> (Sources, Loaded) {
    let mut sources = Sources::new();
    let entry = sources.add(name, text);
    let loaded = load(&mut sources, entry, &read);
    (sources, loaded)
}

/// The rules of a text that must have no fault at all.
fn load_clean(name: &str, text: &str) -> Rules {
    let (sources, loaded) = load_text(name, text);
    assert!(
        loaded.diagnostics.is_empty(),
        "{}",
        render(&loaded.diagnostics, &sources, false)
    );
    loaded.rules.expect("no diagnostic, so there are rules")
}

fn load_rule_file(name: &str) -> Rules {
    let path = root().join("rules").join(name);
    load_clean(
        &path.display().to_string(),
        &read_text(&path).expect("the file is there"),
    )
}

fn strata(rules: &Rules) -> Vec<Vec<&str>> {
    (rules.strata.iter())
        .map(|stratum| {
            stratum
                .relations
                .iter()
                .map(|id| rules.relations[id.index()].name.as_str())
                .collect()
        })
        .collect()
}

#[test]
fn all_rule_files_load_without_a_diagnostic() {
    let mut count = 0;
    for entry in std::fs::read_dir(root().join("rules")).expect("rules/ is there") {
        let name = entry
            .expect("a readable folder")
            .file_name()
            .into_string()
            .expect("UTF-8");
        if name.ends_with(".dl") {
            load_rule_file(&name);
            count += 1;
        }
    }
    assert_eq!(count, 10);
}

#[test]
fn stopping_comes_before_slowing_before_speeding() {
    assert_eq!(
        strata(&load_rule_file("expert.dl")),
        [["Stop"], ["Slow"], ["Fast"], ["Normal"]]
    );
    assert_eq!(strata(&load_rule_file("easy.dl")), [["Stop"], ["Normal"]]);
}

// --- expectations beside the input

/// Loads the first of some texts, the others being the files beside it.
fn load_files(files: &[(String, String)]) -> (Sources, Loaded) {
    let read_one = |path: &Path| {
        let clean: PathBuf = path
            .components()
            .filter(|part| *part != std::path::Component::CurDir)
            .collect();
        let name = clean.to_string_lossy();
        let name = name.strip_prefix("x/../").unwrap_or(&name);
        match files.iter().find(|(file, _)| file == name) {
            Some((_, text)) => Ok(text.clone()),
            None => read(path),
        }
    };
    let mut sources = Sources::new();
    let entry = sources.add(files[0].0.as_str(), files[0].1.as_str());
    let loaded = load(&mut sources, entry, &read_one);
    (sources, loaded)
}

/// Splits a text at the lines `// file: NAME`.
fn split_files(name: &str, text: &str) -> Vec<(String, String)> {
    let mut files = vec![(name.to_owned(), String::new())];
    for line in text.lines() {
        if let Some(name) = line.strip_prefix("// file: ") {
            files.push((name.to_owned(), String::new()));
        } else {
            let (_, text) = files.last_mut().expect("one was put there");
            text.push_str(line);
            text.push('\n');
        }
    }
    files
}

/// `error[code]: part of the message`, `warning[code]`, `label[code]: part of the label`, said of a line.
#[derive(Debug)]
struct Expectation {
    file: String,
    line: usize,
    kind: String,
    code: String,
    part: String,
}

fn expectations(file: &str, text: &str) -> Vec<Expectation> {
    let mut found = Vec::new();
    for (index, line) in text.lines().enumerate() {
        let Some(at) = ["// error[", "// warning[", "// label["]
            .iter()
            .filter_map(|mark| line.find(mark))
            .min()
        else {
            continue;
        };
        let marks = line[at + 3..]
            .replace(", error[", "\0error[")
            .replace(", warning[", "\0warning[");
        for mark in marks.replace(", label[", "\0label[").split('\0') {
            let (kind, rest) = mark.split_once('[').expect("a mark has a bracket");
            let (code, part) = rest.split_once(']').expect("a mark has both brackets");
            found.push(Expectation {
                file: file.to_owned(),
                line: index + 1,
                kind: kind.to_owned(),
                code: code.to_owned(),
                part: part.trim_start_matches(':').trim().to_owned(),
            });
        }
    }
    found
}

/// Every diagnostic is expected on its line, and every expectation met. Labels may be more than are expected.
fn check_expectations(what: &str, files: &[(String, String)]) -> Result<(), String> {
    let (sources, loaded) = load_files(files);
    let drawn = render(&loaded.diagnostics, &sources, false);
    let expected: Vec<Expectation> = files.iter().flat_map(|(name, text)| expectations(name, text)).collect();
    let matches = |expectation: &Expectation, diagnostic: &Diagnostic| {
        if diagnostic.code.name() != expectation.code {
            return false;
        }
        let on_line = |span| {
            let name = Path::new(sources.name(span))
                .file_name()
                .map(|name| name.to_string_lossy().into_owned());
            name.as_deref() == Path::new(&expectation.file).file_name().and_then(|name| name.to_str())
        };
        if expectation.kind == "label" {
            return diagnostic.secondary.iter().any(|label| {
                on_line(label.span.source)
                    && sources.position(label.span).line == expectation.line
                    && label.message.contains(&expectation.part)
            });
        }
        let severity = if expectation.kind == "error" {
            Severity::Error
        } else {
            Severity::Warning
        };
        diagnostic.severity() == severity
            && diagnostic.message.contains(&expectation.part)
            && diagnostic.primary.as_ref().is_some_and(|label| {
                on_line(label.span.source) && sources.position(label.span).line == expectation.line
            })
    };
    let mut met = vec![false; loaded.diagnostics.len()];
    for expectation in &expected {
        let index = loaded.diagnostics.iter().enumerate().position(|(index, diagnostic)| {
            (expectation.kind == "label" || !met[index]) && matches(expectation, diagnostic)
        });
        let index = index.ok_or_else(|| format!("{what}: not met: {expectation:?}\n{drawn}"))?;
        if expectation.kind != "label" {
            met[index] = true;
        }
    }
    let unexpected: Vec<_> = (loaded.diagnostics.iter().zip(&met))
        .filter(|(_, met)| !**met)
        .map(|(one, _)| one.clone())
        .collect();
    if !unexpected.is_empty() {
        return Err(format!(
            "{what}: not expected:\n{}",
            render(&unexpected, &sources, false)
        ));
    }
    let failed = loaded.diagnostics.iter().any(Diagnostic::is_error);
    assert_eq!(
        loaded.rules.is_none(),
        failed,
        "{what}: rules exactly if there is no error"
    );
    Ok(())
}

/// The codes that this room produces.
fn rule_codes() -> impl Iterator<Item = Code> {
    Code::ALL.iter().copied().filter(|code| *code <= Code::DeadClause)
}

#[test]
fn each_code_has_a_fixture_that_produces_it() {
    let folder = root().join("tests/fixtures/diagnostics");
    let mut failures = Vec::new();
    for code in rule_codes() {
        let name = code.name();
        let mut files = Vec::new();
        let single = folder.join(format!("{name}.dl"));
        if single.exists() {
            files = split_files(
                &format!("{name}.dl"),
                &read_text(&single).expect("a fixture can be read"),
            );
        } else {
            let path = folder.join(name).join("main.dl");
            let text = read_text(&path).unwrap_or_else(|error| panic!("no fixture for {name}: {error}"));
            files.push((path.display().to_string(), text));
        }
        failures.extend(check_expectations(name, &files).err());
        let marked = files.iter().flat_map(|(name, text)| expectations(name, text));
        assert!(
            marked.into_iter().any(|mark| mark.code == name && mark.kind != "label"),
            "{name}.dl expects no {name}"
        );
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}
