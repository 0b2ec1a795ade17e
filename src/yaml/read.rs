//! Reads typed values from a tree and collects all faults instead of stopping at the first.
//!
//! A function returns `None` after it has pushed a fault. The caller continues with the other keys, so that one run
//! reports all faults. This module does not know the contents of configurations.

use crate::diag::{Diagnostic, MAX_FAULTS, Span, did_you_mean};
use crate::yaml::codes;
use crate::yaml::mistakes::assignment;
use crate::yaml::{Key, Value, YamlNode};
use std::borrow::Cow;
use std::fmt::Display;
use std::ops::RangeInclusive;

/// The maximum number of names among which a message searches a similar one.
const SEARCHED: usize = 1000;

/// Reports that a value is not what was expected.
pub(crate) fn invalid(node: &YamlNode, expected: impl Display, faults: &mut Vec<Diagnostic>) {
    let message = format!("expected {expected}, found {}", node.describe());
    let mut fault = Diagnostic::new(codes::INVALID_VALUE, message).at(node.span, "");
    fault.help.extend(node.missing_space().or_else(|| extra_bracket(node)));
    faults.push(fault);
}

/// Returns the help for a plain text such as `40}`, which ends with a bracket that it does not open.
fn extra_bracket(node: &YamlNode) -> Option<String> {
    let Value::Scalar { text, plain: true } = &node.value else {
        return None;
    };
    let end = text.chars().last().filter(|end| "]}".contains(*end))?;
    (!text.contains(['[', '{'])).then(|| format!("remove the `{end}`: nothing opens it"))
}

/// [`invalid`] with further help.
fn invalid_form(node: &YamlNode, expected: impl Display, help: Option<String>, faults: &mut Vec<Diagnostic>) {
    invalid(node, expected, faults);
    if let Some(fault) = faults.last_mut() {
        fault.help.extend(help);
    }
}

/// Returns the help for a list, or a text, where a mapping is expected.
fn mapping_form(node: &YamlNode) -> Option<String> {
    match &node.value {
        Value::List(items) => Some(match items.first().map(|item| &item.value) {
            Some(Value::Map(entries)) if !entries.is_empty() => {
                format!(
                    "write its keys without a dash or brackets: `{}: ...`",
                    entries[0].0.text
                )
            }
            _ => "a mapping has keys with values: `key: value`, or `{key: value}` in one line".to_owned(),
        }),
        Value::Scalar { text, plain: true } => {
            let (key, value) = assignment(text.lines().next()?).filter(|_| text.contains('='))?;
            Some(format!("write `{key}: {}`", value.split(' ').next().unwrap_or(value)))
        }
        _ => None,
    }
}

/// Returns the help for a mapping, or a text, where a list is expected.
fn list_form(node: &YamlNode) -> Option<String> {
    match &node.value {
        Value::Map(entries) => Some(match entries.first() {
            Some((key, _)) => format!(
                "write a list of mappings: `[{{{}: ...}}]`, or a dash before each",
                key.text
            ),
            None => "write an empty list as `[]`".to_owned(),
        }),
        Value::Scalar { text, plain: true } if !node.is_null() && text.parse::<f64>().is_err() => {
            match text.strip_prefix('-') {
                Some(entry) => {
                    let entry = entry.split(' ').next().unwrap_or(entry);
                    Some(format!("put a space after each dash: `- {entry}`"))
                }
                None => is_name(text).then(|| format!("write a list: `[{text}]`")),
            }
        }
        _ => None,
    }
}

/// A mapping that the caller reads key by key.
pub(crate) struct Fields<'n> {
    /// The name of the mapping in messages, with its article: `a map`.
    what: &'static str,
    span: Span,
    entries: &'n [(Key, YamlNode)],
    allowed: Vec<Cow<'n, str>>,
    missing: Vec<&'static str>,
    /// Whether keys may be missing because the base could not be loaded.
    partial: bool,
    /// The help for unknown keys.
    hint: Hint,
}

/// Returns the help for an unknown key: where it belongs.
type Hint = fn(&str) -> Option<String>;

impl<'n> Fields<'n> {
    pub fn open(node: &'n YamlNode, what: &'static str, faults: &mut Vec<Diagnostic>) -> Option<Self> {
        Some(Fields {
            what,
            span: node.span,
            entries: entries(node, what, faults)?,
            allowed: Vec::new(),
            missing: Vec::new(),
            partial: node.partial,
            hint: |_| None,
        })
    }

    /// Adds help to messages about unknown keys that resemble no other.
    pub fn hint(&mut self, hint: Hint) {
        self.hint = hint;
    }

    /// Returns the value of a key; a null value counts as absent.
    pub fn optional(&mut self, key: impl Into<Cow<'n, str>>) -> Option<&'n YamlNode> {
        let key = key.into();
        let found = self.find(&key);
        self.allowed.push(key);
        let (_, node) = found?;
        (!matches!(node.value, Value::Absent) && !node.is_null()).then_some(node)
    }

    pub fn required(&mut self, key: &'static str, faults: &mut Vec<Diagnostic>) -> Option<&'n YamlNode> {
        let node = self.optional(key);
        if node.is_some() {
            return node;
        }
        match self.find(key) {
            None => self.missing.push(key),
            Some((_, node)) if matches!(node.value, Value::Absent) => {}
            Some((given, _)) => {
                let message = format!("the key `{key}` has no value in {}", self.what);
                faults.push(Diagnostic::new(codes::MISSING_KEY, message).at(given.span, ""));
            }
        }
        None
    }

    /// [`Fields::close_with`] without help.
    pub fn close(self, faults: &mut Vec<Diagnostic>) {
        self.close_with(None, faults);
    }

    fn find(&self, key: &str) -> Option<&'n (Key, YamlNode)> {
        self.entries.iter().find(|(given, _)| given.text == key)
    }

    /// Reports missing required keys, with the help, and unknown keys. A missing key that an unknown one resembles is
    /// no second fault.
    pub fn close_with(mut self, help: Option<&str>, faults: &mut Vec<Diagnostic>) {
        let allowed = || self.allowed.iter().map(Cow::as_ref);
        let unknown = self.entries.iter().map(|(key, _)| key.text.as_str()).take(SEARCHED);
        let unknown = unknown.filter(|key| allowed().all(|allowed| allowed != *key));
        let meant: Vec<&str> = unknown.filter_map(|key| did_you_mean(key, allowed())).collect();
        self.missing.retain(|key| !meant.contains(key));
        let quoted: Vec<_> = self.missing.iter().map(|key| format!("`{key}`")).collect();
        let quoted = quoted.join(", ");
        if !self.missing.is_empty() && !self.partial {
            let subject = if self.missing.len() == 1 { "the key" } else { "the keys" };
            let verb = if self.missing.len() == 1 { "is" } else { "are" };
            let message = format!("{subject} {quoted} {verb} missing in {}", self.what);
            let mut fault = Diagnostic::new(codes::MISSING_KEY, message).at(self.span, "");
            fault.help.extend(help.map(str::to_owned));
            faults.push(fault);
        }
        for (key, _) in self.entries {
            if self.allowed.iter().any(|allowed| *allowed == key.text) {
                continue;
            }
            let mut fault = Diagnostic::new(
                codes::UNKNOWN_KEY,
                format!("unknown key `{}` in {}", key.text, self.what),
            )
            .at(key.span, "")
            .note(format!("allowed keys: {}", self.allowed.join(", ")));
            if let Some(near) = did_you_mean(&key.text, self.allowed.iter().map(Cow::as_ref)) {
                fault = fault.did_you_mean(near, &[key.span]);
            } else if let Some(help) = (self.hint)(&key.text) {
                fault = fault.help(help);
            }
            faults.push(fault);
        }
    }
}

/// Returns the entries of a mapping with arbitrary keys.
pub(crate) fn entries<'n>(
    node: &'n YamlNode,
    what: &str,
    faults: &mut Vec<Diagnostic>,
) -> Option<&'n [(Key, YamlNode)]> {
    match &node.value {
        Value::Map(entries) => Some(entries),
        _ => {
            invalid_form(node, format_args!("{what} (a mapping)"), mapping_form(node), faults);
            None
        }
    }
}

/// Returns the entries of a mapping with arbitrary keys, without those that remove an entry of the base. Reports a null
/// value (`~`) where the base has no such entry, except for the names `usual`, which exist without one. `each` names an
/// entry in messages: `predicate`.
pub(crate) fn present<'n>(
    node: &'n YamlNode,
    what: &str,
    each: &str,
    usual: &[&str],
    faults: &mut Vec<Diagnostic>,
) -> Option<Vec<&'n (Key, YamlNode)>> {
    let (removed, present): (Vec<_>, Vec<_>) = entries(node, what, faults)?
        .iter()
        .partition(|(_, node)| node.is_null());
    let is_usual = |key: &Key| usual.contains(&key.text.as_str());
    for (key, _) in removed.into_iter().filter(|(key, _)| !node.partial && !is_usual(key)) {
        if faults.len() > MAX_FAULTS {
            break;
        }
        let message = format!("the base has no {each} `{}`", key.text);
        let fault = Diagnostic::new(codes::UNKNOWN_KEY, message).at(key.span, "so `~` removes nothing");
        let known = present.iter().take(SEARCHED).map(|(key, _)| key.text.as_str());
        faults.push(match did_you_mean(&key.text, known) {
            Some(near) => fault.did_you_mean(near, &[key.span]),
            None => fault.help("remove it"),
        });
    }
    Some(present)
}

pub(crate) fn list<'n>(node: &'n YamlNode, what: &str, faults: &mut Vec<Diagnostic>) -> Option<&'n [YamlNode]> {
    match &node.value {
        Value::List(items) => Some(items),
        _ => {
            invalid_form(node, format_args!("a list of {what}"), list_form(node), faults);
            None
        }
    }
}

pub(crate) fn text<'n>(node: &'n YamlNode, what: &str, faults: &mut Vec<Diagnostic>) -> Option<&'n str> {
    match &node.value {
        Value::Scalar { text, .. } if !node.is_null() => Some(text),
        _ => {
            invalid(node, what, faults);
            None
        }
    }
}

/// Reads a word that is valid in rule files and scenes: letters, digits and `_`, no digit first.
pub(crate) fn name<'n>(node: &'n YamlNode, what: &str, faults: &mut Vec<Diagnostic>) -> Option<&'n str> {
    let text = text(node, what, faults)?;
    if is_name(text) {
        return Some(text);
    }
    invalid(
        node,
        format_args!("{what} (letters, digits and `_`, no digit first)"),
        faults,
    );
    None
}

pub(crate) fn is_name(text: &str) -> bool {
    text.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_')
        && text.chars().all(|c| c.is_ascii_alphanumeric() || c == '_')
}

/// Reads one of a few words, ignoring case.
pub(crate) fn choice<T: Copy>(node: &YamlNode, choices: &[(&str, T)], faults: &mut Vec<Diagnostic>) -> Option<T> {
    let words = || choices.iter().map(|&(word, _)| word);
    let list = || words().map(|word| format!("`{word}`")).collect::<Vec<_>>().join(", ");
    let text = match &node.value {
        Value::Scalar { text, .. } => text,
        _ => {
            invalid(node, format_args!("one of {}", list()), faults);
            return None;
        }
    };
    let found = choices.iter().find(|(word, _)| word.eq_ignore_ascii_case(text));
    if found.is_none() {
        invalid(node, format_args!("one of {}", list()), faults);
        if let (Some(near), Some(fault)) = (did_you_mean(text, words()), faults.last_mut()) {
            fault.help.push(format!("did you mean `{near}`?"));
        }
    }
    found.map(|&(_, value)| value)
}

/// Reads an integer within a range.
pub(crate) fn integer<T>(node: &YamlNode, range: RangeInclusive<T>, faults: &mut Vec<Diagnostic>) -> Option<T>
where
    T: std::str::FromStr + PartialOrd + Display + Copy,
{
    let value = match &node.value {
        Value::Scalar { text, plain: true } => text.parse().ok().filter(|value| range.contains(value)),
        _ => None,
    };
    if value.is_none() {
        invalid(
            node,
            format_args!("a whole number from {} to {}", range.start(), range.end()),
            faults,
        );
    }
    value
}

/// Reads a finite number within a range; `what` describes it in messages.
pub(crate) fn number(
    node: &YamlNode,
    range: RangeInclusive<f64>,
    what: &str,
    faults: &mut Vec<Diagnostic>,
) -> Option<f64> {
    let value = match &node.value {
        Value::Scalar { text, plain: true } => text.parse().ok().filter(|value| range.contains(value)),
        _ => None,
    };
    if value.is_none() {
        invalid(node, what, faults);
    }
    value.filter(|value: &f64| value.is_finite())
}
