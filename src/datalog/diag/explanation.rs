//! Explanations of codes: what a message means, why it matters, and examples.
//!
//! Each module with codes has a Markdown file with one section per code, which [`explanations`] parses:
//!
//! ````text
//! ## unknown-key
//!
//! The meaning, in paragraphs.
//!
//! Why: The reason, in one paragraph.
//!
//! Command: `logicity check main.yaml`
//!
//! ```yaml wrong
//! (a file that causes exactly this message)
//! ```
//!
//! ```yaml right
//! (a file that causes no message)
//! ```
//! ````
//!
//! `Command:` is the command that reports the message; without it, that is `logicity check`. A line `// file: NAME` or
//! `# file: NAME` in an example begins another file. Tests run every example.

use crate::diag::Code;

/// The explanation of a code.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Explanation {
    /// The code.
    pub code: Code,
    /// One sentence.
    pub summary: &'static str,
    /// The meaning of the message, as Markdown.
    pub meaning: &'static str,
    /// Why the program reports it, as Markdown.
    pub reason: &'static str,
    /// The command that reports it; `None` for `logicity check`.
    pub command: Option<&'static str>,
    /// An input that causes the message.
    pub wrong: Example,
    /// A similar input that causes none.
    pub right: Example,
}

/// An example of an explanation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Example {
    /// The language: `dl`, `yaml`, `json`, `prolog`, `sh` or `rust`. It is the extension of the first file, `main.dl`
    /// for `dl`.
    pub language: &'static str,
    /// The text.
    pub text: &'static str,
}

/// Parses the explanations of a module from its Markdown file. Codes without a complete section are omitted.
pub fn explanations(catalog: &Catalog) -> Vec<Explanation> {
    let sections = || {
        catalog
            .text
            .split("\n## ")
            .map(|section| section.trim_start_matches("## "))
    };
    let explanation = |&(code, summary): &(Code, &'static str)| {
        let (_, section) = sections()
            .filter_map(|section| section.split_once('\n'))
            .find(|(heading, _)| *heading == code.name())?;
        let (prose, examples) = section.split_once("\n```")?;
        let (meaning, rest) = prose.split_once("\n\nWhy: ")?;
        let (reason, command) = match rest.split_once("\n\nCommand: `") {
            Some((reason, command)) => (reason, Some(command.trim_end().strip_suffix('`')?)),
            None => (rest, None),
        };
        let (wrong, rest) = example(examples, "wrong")?;
        let (right, _) = example(rest.split_once("\n```")?.1, "right")?;
        Some(Explanation {
            code,
            summary: summary.trim(),
            meaning: meaning.trim(),
            reason: reason.trim(),
            command,
            wrong,
            right,
        })
    };
    catalog.summaries.iter().filter_map(explanation).collect()
}

/// Parses `dl wrong\n...\n```\n...`. Returns also the text after it.
fn example(text: &'static str, kind: &str) -> Option<(Example, &'static str)> {
    let (info, rest) = text.split_once('\n')?;
    let language = info.strip_suffix(kind)?.trim_end();
    let (text, rest) = rest.split_once("\n```\n")?;
    Some((Example { language, text }, rest))
}

/// The codes of a module with one sentence each, and the text of its Markdown file.
#[derive(Clone, Copy, Debug)]
pub struct Catalog {
    /// The codes with one sentence each.
    pub summaries: &'static [(Code, &'static str)],
    /// The sections.
    pub text: &'static str,
}
