//! Parses YAML to a tree with the place of each value.
//!
//! ```text
//! text --events of the YAML crate--> YamlNode (spans, duplicate keys reported, aliases expanded, size bounded)
//! ```
//!
//! The parser builds the tree from events rather than through serde, because serde stops at the first fault and its
//! errors have at most one place. This module does not know what the keys mean.
// Decision: docs/decisions/city.md#d056

use crate::diag::{self, Diagnostic, SourceId, Sources, Span};
use crate::yaml::codes;
use crate::yaml::mistakes::{Stop, dash_fault, glued, space_help};
use serde_json::{Map, Value as Json};
use serde_yaml::granit_parser::{ErrorKind, Event, Parser, ScalarStyle, Span as Mark, StructureStyle};
use std::collections::HashMap;
use std::ops::Range;

/// The maximum size of a configuration file, in bytes. A map of 1000 x 1000 blocks with all buildings given takes half
/// of it. The caller checks the size before it adds the text.
pub(crate) const MAX_BYTES: usize = 8 << 20;
/// The maximum nesting of lists and mappings.
pub(crate) const MAX_DEPTH: usize = 64;
/// The maximum number of values in a configuration with all its parts, after alias expansion.
pub(crate) const MAX_NODES: usize = 200_000;

/// A YAML value and its place.
#[derive(Clone, Debug)]
pub(crate) struct YamlNode {
    /// The scalar; for a block collection its key, or else its own first key; for a collection in brackets its first
    /// line.
    pub span: Span,
    pub value: Value,
    /// Whether this mapping came from a separate file, so that it replaces what it overrides instead of merging.
    pub whole: bool,
    /// Whether the base of this mapping could not be loaded, so that keys may be missing.
    pub partial: bool,
}

#[derive(Clone, Debug)]
pub(crate) enum Value {
    Scalar {
        text: String,
        /// Whether it has no quotes: `5` is a number and `~` is null, but `"5"` and `"~"` are text.
        plain: bool,
    },
    List(Vec<YamlNode>),
    Map(Vec<(Key, YamlNode)>),
    /// The reference could not be loaded; its diagnostic has been pushed.
    Absent,
}

#[derive(Clone, Debug)]
pub(crate) struct Key {
    pub text: String,
    pub span: Span,
}

impl YamlNode {
    pub fn new(span: Span, value: Value) -> Self {
        YamlNode {
            span,
            value,
            whole: false,
            partial: false,
        }
    }

    /// Marks this mapping, and those in it that would merge with mappings of the base, as partial.
    pub fn mark_partial(&mut self) {
        self.partial = true;
        if let Value::Map(entries) = &mut self.value {
            let merging = entries.iter_mut().filter(|(_, node)| !node.whole);
            merging.for_each(|(_, node)| node.mark_partial());
        }
    }

    /// Returns the help for a text such as `view:40`, which is no key and value because a space is missing.
    pub fn missing_space(&self) -> Option<String> {
        match &self.value {
            Value::Scalar { text, plain: true } => space_help(text),
            _ => None,
        }
    }

    /// Whether this is YAML's null.
    pub fn is_null(&self) -> bool {
        let Value::Scalar { text, plain: true } = &self.value else {
            return false;
        };
        matches!(text.as_str(), "" | "~" | "null" | "Null" | "NULL")
    }

    /// Returns the value as JSON. Plain scalars follow the core schema of YAML 1.2; numbers that JSON cannot represent
    /// become text.
    pub fn to_json(&self) -> Json {
        match &self.value {
            Value::Absent => Json::Null,
            _ if self.is_null() => Json::Null,
            Value::Scalar { text, plain: false } => Json::from(text.as_str()),
            Value::Scalar { text, plain: true } => plain_to_json(text),
            Value::List(items) => items.iter().map(YamlNode::to_json).collect(),
            Value::Map(entries) => {
                let entries = entries.iter().map(|(key, value)| (key.text.clone(), value.to_json()));
                Json::Object(entries.collect::<Map<_, _>>())
            }
        }
    }

    /// Describes this value in messages.
    pub fn describe(&self) -> String {
        const SHOWN: usize = 40;
        match &self.value {
            Value::Absent => "nothing".into(),
            _ if self.is_null() => "nothing".into(),
            Value::List(items) if items.is_empty() => "an empty list".into(),
            Value::List(_) => "a list".into(),
            Value::Map(_) => "a mapping".into(),
            Value::Scalar { text, plain } => {
                let mut shown: String = text.chars().take(SHOWN).collect();
                if shown.len() < text.len() {
                    shown.push('…');
                }
                if *plain {
                    format!("`{shown}`")
                } else {
                    format!("the text `{shown}`")
                }
            }
        }
    }
}

/// Converts a scalar without quotes.
fn plain_to_json(text: &str) -> Json {
    match text {
        "true" | "True" | "TRUE" => return Json::Bool(true),
        "false" | "False" | "FALSE" => return Json::Bool(false),
        _ => {}
    }
    let radix = |prefix, radix| {
        text.strip_prefix(prefix)
            .and_then(|digits| i64::from_str_radix(digits, radix).ok())
    };
    let integer = (text.parse().ok())
        .or_else(|| radix("0x", 16))
        .or_else(|| radix("0o", 8));
    if let Some(integer) = integer {
        return Json::from(integer);
    }
    if let Ok(large) = text.parse::<u64>() {
        return Json::from(large);
    }
    // Rust also parses names such as `inf`, which are text in YAML.
    let numeric = text.starts_with(|c: char| c.is_ascii_digit() || "+-.".contains(c))
        && text.chars().all(|c| c.is_ascii_digit() || "+-.eE".contains(c));
    let float = numeric
        .then(|| text.parse().ok())
        .flatten()
        .and_then(serde_json::Number::from_f64);
    float.map_or_else(|| Json::from(text), Json::Number)
}

/// A collection whose end has not been parsed.
struct Open {
    node: YamlNode,
    block: bool,
    anchor: usize,
    /// In a mapping: the key that waits for its value; the inner `None` if the key is not text.
    key: Option<Option<Key>>,
}

/// The value of an alias.
struct Anchored {
    node: YamlNode,
    extent: Extent,
}

/// The size of a value.
#[derive(Clone, Copy, Default)]
struct Extent {
    /// The number of values, itself included.
    nodes: usize,
    /// The nesting of lists and mappings, itself included.
    depth: usize,
}

/// The result of a parsing step: the error is the fault that stops the parser.
type Progress = Result<(), Box<Diagnostic>>;

struct Builder<'a> {
    source: SourceId,
    text: &'a str,
    open: Vec<Open>,
    anchors: HashMap<usize, Anchored>,
    root: Option<YamlNode>,
    /// The end of the last event.
    parsed: usize,
    nodes_left: &'a mut usize,
    faults: &'a mut Vec<Diagnostic>,
}

/// Parses one text. Returns `None` if there is no usable tree; then it has pushed at least one fault. It also pushes
/// faults that leave a tree, such as duplicate keys. `nodes_left` bounds the size of all trees of one configuration.
pub(crate) fn parse(
    sources: &Sources,
    source: SourceId,
    nodes_left: &mut usize,
    faults: &mut Vec<Diagnostic>,
) -> Option<YamlNode> {
    let text = sources.text(source);
    let start = Span::new(source, 0..0);
    let mut options = serde_yaml::granit_parser::Options::default();
    options.set_emit_comments(false);
    options.flow_nesting_limit = MAX_DEPTH;
    options.block_nesting_limit = MAX_DEPTH;
    let mut builder = Builder {
        source,
        text,
        open: Vec::new(),
        anchors: HashMap::new(),
        root: None,
        parsed: 0,
        nodes_left,
        faults,
    };
    for event in Parser::new_from_str_with_options(text, options) {
        let step = match event {
            Ok((event, mark)) => {
                let step = builder.event(event, &mark);
                let end = mark.byte_range().map_or(0, |range| range.end);
                builder.parsed = builder.parsed.max(end);
                step
            }
            Err(error) => {
                let stop = Stop {
                    source,
                    text,
                    at: error.marker().byte_offset().unwrap_or(text.len()),
                    bracket: builder.bracket(),
                    parsed: builder.parsed,
                };
                Err(Box::new(match error.kind() {
                    ErrorKind::RecursionLimitExceeded => too_deep(stop.character(stop.at)),
                    kind => stop.explain(kind),
                }))
            }
        };
        if let Err(fault) = step {
            builder.faults.push(*fault);
            return None;
        }
    }
    if builder.root.is_none() {
        let fault = Diagnostic::new(codes::INVALID_VALUE, "the file is empty; expected a mapping");
        builder.faults.push(fault.at(start, ""));
    }
    builder.root
}

fn too_deep(span: Span) -> Diagnostic {
    let message = format!("lists and mappings are nested more than {MAX_DEPTH} deep");
    Diagnostic::new(diag::codes::LIMIT_EXCEEDED, message).at(span, "")
}

impl Builder<'_> {
    /// Returns the place of the innermost open bracket.
    fn bracket(&self) -> Option<usize> {
        let innermost = self.open.last().filter(|open| !open.block)?;
        Some(innermost.node.span.range().start)
    }

    /// The span of an event, clipped to its first line.
    fn span(&self, mark: &Mark) -> Span {
        self.first_line(mark.byte_range().unwrap_or(0..0))
    }

    fn first_line(&self, range: Range<usize>) -> Span {
        let line = self.text.get(range.clone()).and_then(|text| text.lines().next());
        let length = line.map_or(0, |line| line.trim_end().len());
        Span::new(self.source, range.start..range.start + length)
    }

    fn spend(&mut self, nodes: usize, span: Span) -> Progress {
        *self.nodes_left = self.nodes_left.checked_sub(nodes).ok_or_else(|| {
            let message = format!("more than {MAX_NODES} values in one configuration");
            Box::new(Diagnostic::new(diag::codes::LIMIT_EXCEEDED, message).at(span, "the limit is exceeded here"))
        })?;
        Ok(())
    }

    fn event(&mut self, event: Event<'_>, mark: &Mark) -> Progress {
        let span = self.span(mark);
        if let Some(tag) = event.tag() {
            let fault = Diagnostic::new(
                codes::INVALID_VALUE,
                format!("tags such as `{}` are not supported", tag.original()),
            );
            let tag_span = mark.tag_span().map_or(span, |mark| self.span(&mark));
            self.faults.push(fault.at(tag_span, "remove it"));
        }
        let mut open = |value, style, anchor| {
            self.open.push(Open {
                node: YamlNode::new(span, value),
                block: style == StructureStyle::Block,
                anchor,
                key: None,
            });
        };
        match event {
            Event::Scalar(text, style, anchor, _) => {
                self.spend(1, span)?;
                let (text, plain) = (text.into_owned(), style == ScalarStyle::Plain);
                self.finished(YamlNode::new(span, Value::Scalar { text, plain }), anchor)?;
            }
            Event::SequenceStart(style, anchor, _) => open(Value::List(Vec::new()), style, anchor),
            Event::MappingStart(style, anchor, _) => open(Value::Map(Vec::new()), style, anchor),
            Event::SequenceEnd | Event::MappingEnd => {
                if let Some(open) = self.open.pop() {
                    self.close(open, mark)?;
                }
            }
            Event::Alias(anchor) => {
                let Some(Anchored { node, extent }) = self.anchors.get(&anchor) else {
                    let fault = Diagnostic::new(codes::YAML_SYNTAX, "an alias is inside the value that it refers to");
                    return Err(Box::new(fault.at(span, "")));
                };
                if self.open.len() + extent.depth > MAX_DEPTH {
                    return Err(Box::new(too_deep(span)));
                }
                let (node, nodes) = (node.clone(), extent.nodes);
                self.spend(nodes, span)?;
                self.finished(node, 0)?;
            }
            Event::DocumentStart(..) if self.root.is_some() => {
                let fault = Diagnostic::new(codes::YAML_SYNTAX, "the file has a second document");
                return Err(Box::new(fault.at(span, "the file must end before this")));
            }
            _ => {}
        }
        if self.open.len() > MAX_DEPTH {
            return Err(Box::new(too_deep(span)));
        }
        Ok(())
    }

    fn close(&mut self, open: Open, end: &Mark) -> Progress {
        let Open {
            mut node,
            block,
            anchor,
            ..
        } = open;
        self.spend(1, node.span)?;
        if let Value::Map(entries) = &mut node.value {
            if let Some(fault) = self.glued_dash(entries).filter(|_| block) {
                return Err(Box::new(fault));
            }
            // The value of such a key is unknown, so its absence is no fault.
            node.partial = drop_glued(entries, self.faults);
            drop_duplicates(entries, self.faults);
        }
        let parent_key = self.open.last().and_then(|parent| parent.key.as_ref()?.as_ref());
        node.span = match (&node.value, parent_key) {
            // The start event covers only the bracket.
            _ if !block => self.first_line(node.span.range().start..end.byte_range().map_or(0, |range| range.end)),
            (_, Some(key)) => key.span,
            (Value::Map(entries), None) => entries.first().map_or(node.span, |(key, _)| key.span),
            _ => node.span,
        };
        self.finished(node, anchor)
    }

    /// Reports a key such as `-{priority`, which is the entry of a list with a missing space.
    fn glued_dash(&self, entries: &[(Key, YamlNode)]) -> Option<Diagnostic> {
        entries.iter().find_map(|(key, _)| {
            let start = key.span.range().start;
            let line = self.text.get(start..)?.lines().next()?;
            dash_fault(self.source, start, line)
        })
    }

    /// Adds a complete value to its collection.
    fn finished(&mut self, node: YamlNode, anchor: usize) -> Progress {
        if anchor != 0 {
            let extent = extent(&node);
            self.spend(extent.nodes, node.span)?;
            let node = node.clone();
            self.anchors.insert(anchor, Anchored { node, extent });
        }
        let Some(parent) = self.open.last_mut() else {
            self.root = Some(node);
            return Ok(());
        };
        match &mut parent.node.value {
            Value::List(items) => items.push(node),
            Value::Map(entries) => match parent.key.take() {
                None => {
                    let span = node.span;
                    parent.key = Some(match node.value {
                        Value::Scalar { text, .. } => Some(Key { text, span }),
                        _ => {
                            let fault = Diagnostic::new(codes::INVALID_VALUE, "a key must be a single word");
                            self.faults.push(fault.at(span, format!("this is {}", node.describe())));
                            None
                        }
                    });
                }
                Some(None) => {}
                Some(Some(key)) => entries.push((key, node)),
            },
            Value::Scalar { .. } | Value::Absent => unreachable!("only collections are opened"),
        }
        Ok(())
    }
}

/// Removes and reports keys without a value, such as `{view:40}`, that lack a space after the colon. Returns whether there
/// are any.
fn drop_glued(entries: &mut Vec<(Key, YamlNode)>, faults: &mut Vec<Diagnostic>) -> bool {
    let before = entries.len();
    entries.retain(|(key, value)| {
        let help = space_help(&key.text).filter(|_| value.is_null());
        let (Some(help), Some((word, _))) = (help, glued(&key.text)) else {
            return true;
        };
        let fault = Diagnostic::new(codes::YAML_SYNTAX, format!("expected a space after `{word}:`"));
        faults.push(fault.at(key.span, "").help(help));
        false
    });
    entries.len() < before
}

/// Reports duplicate keys and keeps the first of each.
fn drop_duplicates(entries: &mut Vec<(Key, YamlNode)>, faults: &mut Vec<Diagnostic>) {
    let mut first: HashMap<String, Span> = HashMap::new();
    entries.retain(|(key, _)| match first.get(&key.text) {
        None => {
            first.insert(key.text.clone(), key.span);
            true
        }
        Some(&earlier) => {
            let fault = Diagnostic::new(codes::DUPLICATE_KEY, format!("the key `{}` is given twice", key.text));
            faults.push(fault.at(key.span, "given again").also(earlier, "first given here"));
            false
        }
    });
}

fn extent(node: &YamlNode) -> Extent {
    let around = |inside: &mut dyn Iterator<Item = &YamlNode>| {
        let sum = inside.map(extent).fold(Extent::default(), |sum, one| Extent {
            nodes: sum.nodes + one.nodes,
            depth: sum.depth.max(one.depth),
        });
        Extent {
            nodes: sum.nodes + 1,
            depth: sum.depth + 1,
        }
    };
    match &node.value {
        Value::Scalar { .. } | Value::Absent => Extent { nodes: 1, depth: 0 },
        Value::List(items) => around(&mut items.iter()),
        Value::Map(entries) => around(&mut entries.iter().map(|(_, node)| node)),
    }
}
