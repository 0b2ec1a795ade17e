//! The prose of the repository is plain English: no file contains the idioms in [`IDIOMS`] or British spellings. The
//! prose of Markdown files wraps at 100 columns.

use std::fs;
use std::path::{Path, PathBuf};

use regex::Regex;

/// Files and folders to read, from the root of the repository.
const PLACES: &[&str] = &[
    ".ci",
    ".githooks",
    ".github",
    "ARCHITECTURE.md",
    "CHANGELOG.md",
    "CITATION.cff",
    "CODE_OF_CONDUCT.md",
    "CONTRIBUTING.md",
    "Cargo.toml",
    "Makefile",
    "README.md",
    "SECURITY.md",
    "benches",
    "configs",
    "deny.toml",
    "docs",
    "editors",
    "examples",
    "python",
    "rules",
    "src",
    "tests",
];

/// Endings of the files to read. Names without an ending (`Makefile`, `.ci/run`) are read, too.
const ENDINGS: &[&str] = &[
    "cff", "css", "dict", "dl", "html", "ipynb", "js", "md", "mjs", "py", "pyi", "rs", "rst", "sh", "toml", "ts",
    "yaml", "yml",
];

/// Folders that are not part of the repository, or contain only data.
const SKIPPED: &[&str] = &[
    "__pycache__",
    "_build",
    "artifacts",
    "corpus-found",
    "node_modules",
    "recorded",
    "snapshots",
    "target",
    "www",
];

/// Idioms that are wrong everywhere, at most fifteen: a regular expression for whole words, and what to write instead. A
/// space also matches a line break inside a comment, and the underscore of a name.
const IDIOMS: &[(&str, &str)] = &[
    (
        "lest|whence|thence|thereof|hitherto|heretofore|notwithstanding|albeit",
        "use a common word",
    ),
    ("whosoever|whomsoever|whomever", "name the actor"),
    ("such as (?:have|are|do)", "those that"),
    ("for ever", "forever, without end"),
    ("one and the same", "one, the same"),
    ("(?:is|are|was|were) of other", "belongs to others, has others"),
    ("acts? (?:stop|slow|fast|normal)", "chooses Stop, takes the action Stop"),
    ("ask(?:s|ed)? of", "requires, needs"),
    ("as well as they come", "drop it"),
    ("(?:of )?(?:one|thing)'s own", "separate, another, your own"),
    ("(?:is|are|was|were|be|been) looked (?:at|up as)", "scans, visits"),
    ("(?:is|are|was|were|be|been) (?:said|spoken) of", "name the actor"),
    ("(?:is|are|was|were|be|been) given up", "cancels, stops"),
    (
        "(?:colour|behaviour|neighbour|favour|honour|labell|travell|modell|centre|metre|catalogue|grey|kerb)[a-z]*",
        "American spelling",
    ),
    (
        "(?:categoris|optimis|initialis|recognis|normalis|generalis|minimis|maximis|vectoris|visualis|serialis|\
         organis|summaris|parametris|randomis|synchronis|tokenis|finalis|emphasis|materialis)(?:e|ed|es|ing|ation|ations|er|ers)",
        "American spelling",
    ),
];

/// Hits that are right: the end of a path, and text of the line. At most ten.
const ALLOWED: &[(&str, &str)] = &[];

/// Markdown files and folders of them whose prose wraps at 100 columns. The program prints the texts in `src`, and
/// generators write those in `tests`.
const WRAPPED: &[&str] = &[
    "ARCHITECTURE.md",
    "README.md",
    "configs",
    "docs",
    "editors",
    "python",
    "rules",
];

/// The number of columns of prose in Markdown.
const COLUMNS: usize = 100;

fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

/// The patterns of [`IDIOMS`].
struct Patterns {
    /// Matches where any of the others does. Most files contain none, so each is read once.
    any: Regex,
    /// Each pattern with what to write instead.
    each: Vec<(Regex, &'static str)>,
}

impl Patterns {
    fn new() -> Patterns {
        let all: Vec<&str> = IDIOMS.iter().map(|(idiom, _)| *idiom).collect();
        Patterns {
            any: pattern(&all.join("|")),
            each: IDIOMS.iter().map(|(idiom, advice)| (pattern(idiom), *advice)).collect(),
        }
    }

    /// Returns each hit in a text: its line, the words, and what to write instead.
    fn hits<'a>(&self, text: &'a str) -> Vec<(usize, &'a str, &'static str)> {
        if !self.any.is_match(text) {
            return Vec::new();
        }
        let mut found: Vec<(usize, &str, &str)> = Vec::new();
        for (pattern, advice) in &self.each {
            found.extend(pattern.find_iter(text).map(|hit| (hit.start(), hit.as_str(), *advice)));
        }
        found.sort();
        for hit in &mut found {
            hit.0 = text[..hit.0].matches('\n').count() + 1;
        }
        found
    }
}

/// Turns a line of [`IDIOMS`] into a pattern of whole words. Between two words may be a line break, with the sign of a
/// comment at the start of the next line, or an underscore: several words may be a part of a name. The boundaries of
/// words are those of ASCII, which match much faster.
fn pattern(idiom: &str) -> Regex {
    let gap = r#"(?:[ \t]+|_|[ \t]*\\?\r?\n[ \t]*(?:(?://[/!]?|#:?|\*|>|"|')[ \t]*)*)"#;
    let edge = if idiom.contains(' ') { r"(?:\b|_)" } else { r"\b" };
    Regex::new(&format!(r"(?i-u){edge}(?:{}){edge}", idiom.replace(' ', gap))).unwrap()
}

/// Adds the files below a place to `found`, in the order of their names.
fn collect(place: &Path, found: &mut Vec<PathBuf>) {
    let name = place.file_name().unwrap().to_str().unwrap();
    if place.is_dir() && !place.is_symlink() {
        if SKIPPED.contains(&name) || (name.starts_with('.') && ![".ci", ".githooks", ".github"].contains(&name)) {
            return;
        }
        let mut inside: Vec<_> = fs::read_dir(place)
            .unwrap()
            .map(|entry| entry.unwrap().path())
            .collect();
        inside.sort();
        for path in inside {
            collect(&path, found);
        }
    } else if place.is_file() {
        let ending = place.extension().map(|ending| ending.to_str().unwrap());
        if ending.is_none_or(|ending| ENDINGS.contains(&ending)) && name != "prose.rs" {
            found.push(place.to_owned());
        }
    }
}

/// Returns the numbers of the lines of prose in a Markdown text that are too long. Code, tables, HTML and lines without
/// a space, such as links, do not count.
fn long_lines(text: &str) -> Vec<usize> {
    let mut found = Vec::new();
    // The backquotes that end the current block of code.
    let mut fence: Option<usize> = None;
    for (line, number) in text.lines().zip(1..) {
        let content = line.trim_start();
        let backquotes = content.len() - content.trim_start_matches('`').len();
        match fence {
            Some(opened) => {
                if backquotes >= opened && content.trim_end().len() == backquotes {
                    fence = None;
                }
            }
            None if backquotes >= 3 => fence = Some(backquotes),
            None => {
                let words = content.trim_start_matches("- ").split_whitespace().count();
                if line.chars().count() > COLUMNS && words > 1 && !content.starts_with(['|', '<']) {
                    found.push(number);
                }
            }
        }
    }
    found
}

#[test]
fn prose_has_no_idioms_that_readers_cannot_search_for() {
    assert!(IDIOMS.len() <= 15, "at most fifteen idioms");
    assert!(ALLOWED.len() <= 10, "at most ten exceptions");
    let mut files = Vec::new();
    for place in PLACES {
        collect(&root().join(place), &mut files);
    }
    assert!(files.len() > 300, "only {} files read", files.len());
    let patterns = Patterns::new();
    let mut used = vec![false; ALLOWED.len()];
    let mut faults = Vec::new();
    for path in &files {
        // Some fixtures are not UTF-8 on purpose.
        let text = String::from_utf8_lossy(&fs::read(path).unwrap()).into_owned();
        let shown = path.strip_prefix(root()).unwrap().display().to_string();
        for (line, words, advice) in patterns.hits(&text) {
            let content = text.lines().nth(line - 1).unwrap_or_default();
            let allowed = (ALLOWED.iter()).position(|(end, part)| shown.ends_with(end) && content.contains(part));
            match allowed {
                Some(at) => used[at] = true,
                None => faults.push(format!("{shown}:{line}: `{}`: {advice}", words.replace('\n', " "))),
            }
        }
    }
    for ((end, part), used) in ALLOWED.iter().zip(used) {
        if !used {
            faults.push(format!("the exception ({end:?}, {part:?}) fits no hit: remove it"));
        }
    }
    assert!(faults.is_empty(), "{} hits\n{}", faults.len(), faults.join("\n"));
}

#[test]
fn idioms_are_found_across_lines_and_similar_words_are_not() {
    let patterns = Patterns::new();
    let found = |text| -> Vec<(usize, &str)> {
        patterns
            .hits(text)
            .into_iter()
            .map(|(line, words, _)| (line, words))
            .collect()
    };
    assert_eq!(found("a\n/// Whence\n"), [(2, "Whence")]);
    assert_eq!(found("// runs for\n    // ever"), [(1, "for\n    // ever")]);
    assert_eq!(found("\"it was given \\\n up\""), [(1, "was given \\\n up")]);
    assert_eq!(found("# the state is of other data"), [(1, "is of other")]);
    assert_eq!(found("It was asked of the map."), [(1, "asked of")]);
    assert_eq!(found("The colours of a grey car"), [(1, "colours"), (1, "grey")]);
    assert_eq!(
        found("fn runs_for_ever(such_as_are: u8)"),
        [(1, "_for_ever"), (1, "such_as_are")]
    );
    for fine in [
        "it is about 20 cells long",
        "x is about to run into y",
        "no reader told so many strangers by hand",
        "the user is asked to confirm, whatever it comes to",
        "like the others",
        "whose rows",
        "own rows, and a stranglehold",
        "behavior, color, gray, analysis",
        "the car acts slowly",
        "forever",
    ] {
        assert_eq!(found(fine), [], "{fine}");
    }
}

#[test]
fn prose_of_markdown_files_wraps() {
    let mut files = Vec::new();
    for place in WRAPPED {
        collect(&root().join(place), &mut files);
    }
    files.retain(|path| path.extension().is_some_and(|ending| ending == "md"));
    // `logicity release` writes these cards.
    files.retain(|path| !path.starts_with(root().join("python/logicity/policies")));
    assert!(files.len() > 80, "only {} files read", files.len());
    let mut faults = Vec::new();
    for path in &files {
        let shown = path.strip_prefix(root()).unwrap().display().to_string();
        let lines = long_lines(&fs::read_to_string(path).unwrap());
        faults.extend(lines.iter().map(|line| format!("{shown}:{line}")));
    }
    assert!(
        faults.is_empty(),
        "{} lines of more than {COLUMNS} columns\n{}",
        faults.len(),
        faults.join("\n")
    );
}

#[test]
fn long_lines_are_found_outside_of_code_and_tables() {
    let words = "word ".repeat(30);
    let text = format!("{words}\n````text\n```\n{words}\n````\n| {words} |\n<p>{words}\n- {words}\n");
    assert_eq!(long_lines(&text), [1, 8]);
    let link = format!("- [{}](page.md)", "x".repeat(99));
    assert!(long_lines(&format!("{} é\n{link}\n", "é".repeat(98))).is_empty());
    assert_eq!(long_lines(&format!("```sh\n{words}\n```\n{words}")), [4]);
}
