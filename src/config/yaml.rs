//! YAML text to a tree that knows where everything stands.
//!
//! ```text
//! text --events of the YAML crate--> Node (spans, duplicate keys told, aliases expanded, size bounded)
//! ```
//!
//! The tree is built from parse events and not through serde, because serde stops at the first fault and its errors know
//! one place at most. What a key means is not known here.

use crate::diag::{Code, Diagnostic, SourceId, Sources, Span};
use serde_yaml::granit_parser::{ErrorKind, Event, Parser, ScalarStyle, Span as Mark, StructureStyle};
use std::collections::HashMap;
use std::ops::Range;

/// The largest configuration file in bytes. A map of 1000 x 1000 blocks with every building given is half of it. The caller
/// asks, so that a larger text is never looked through.
pub(crate) const MAX_BYTES: usize = 8 << 20;
/// The deepest nesting of lists and mappings.
pub(crate) const MAX_DEPTH: usize = 64;
/// The most values in a configuration with all its parts, after aliases are expanded.
pub(crate) const MAX_NODES: usize = 200_000;

/// A YAML value and where it stands.
#[derive(Clone, Debug)]
pub(crate) struct Node {
    /// A scalar; the key of a block collection, or its own first key; the first line of a collection in brackets.
    pub span: Span,
    pub value: Value,
    /// Whether this mapping came from a file of its own, so that it replaces what it overrides instead of merging with it.
    pub whole: bool,
}

#[derive(Clone, Debug)]
pub(crate) enum Value {
    Scalar {
        text: String,
        /// Without quotes: `5` is a number and `~` is nothing, `"5"` and `"~"` are text.
        plain: bool,
    },
    List(Vec<Node>),
    Map(Vec<(Key, Node)>),
    /// What a reference names could not be had; the fault is told already.
    Absent,
}

#[derive(Clone, Debug)]
pub(crate) struct Key {
    pub text: String,
    pub span: Span,
}

impl Node {
    pub fn new(span: Span, value: Value) -> Self {
        let whole = false;
        Node { span, value, whole }
    }

    /// Whether this is YAML's null.
    pub fn is_null(&self) -> bool {
        matches!(&self.value, Value::Scalar { text, plain: true } if matches!(text.as_str(), "" | "~" | "null" | "Null" | "NULL"))
    }

    /// What a message calls this value.
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

/// A collection whose end has not been met.
struct Open {
    node: Node,
    block: bool,
    anchor: usize,
    /// In a mapping, the key that waits for its value; `None` in it if the key was no text.
    key: Option<Option<Key>>,
}

/// What an alias stands for.
struct Anchored {
    node: Node,
    extent: Extent,
}

/// How large a value is.
#[derive(Clone, Copy, Default)]
struct Extent {
    /// Values, itself included.
    nodes: usize,
    /// Lists and mappings inside each other, itself included.
    depth: usize,
}

/// Whether parsing can go on; if not, the fault that stops it.
type Progress = Result<(), Box<Diagnostic>>;

struct Builder<'a> {
    source: SourceId,
    text: &'a str,
    open: Vec<Open>,
    anchors: HashMap<usize, Anchored>,
    root: Option<Node>,
    nodes_left: &'a mut usize,
    faults: &'a mut Vec<Diagnostic>,
}

/// Parses one text. `None` if there is no tree to go on with; then at least one fault was pushed. Faults that leave a tree
/// (a duplicate key) are pushed too. `nodes_left` bounds the size of all trees of one configuration.
pub(crate) fn parse(
    sources: &Sources,
    source: SourceId,
    nodes_left: &mut usize,
    faults: &mut Vec<Diagnostic>,
) -> Option<Node> {
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
        nodes_left,
        faults,
    };
    for event in Parser::new_from_str_with_options(text, options) {
        let step = match event {
            Ok((event, mark)) => builder.event(event, &mark),
            Err(error) => {
                let at = error.marker().byte_offset().unwrap_or(text.len());
                let span = builder.one_character(at);
                Err(Box::new(match error.kind() {
                    ErrorKind::RecursionLimitExceeded => too_deep(span),
                    kind => Diagnostic::new(Code::YAML_SYNTAX, kind.to_string()).at(span, ""),
                }))
            }
        };
        if let Err(fault) = step {
            builder.faults.push(*fault);
            return None;
        }
    }
    if builder.root.is_none() {
        let fault = Diagnostic::new(Code::INVALID_VALUE, "the file is empty, a mapping of keys was expected");
        builder.faults.push(fault.at(start, ""));
    }
    builder.root
}

fn too_deep(span: Span) -> Diagnostic {
    let message = format!("lists and mappings are nested more than {MAX_DEPTH} deep");
    Diagnostic::new(Code::LIMIT_EXCEEDED, message).at(span, "")
}

impl Builder<'_> {
    /// The character at a byte, so that a caret has something to stand under; nothing at the end of the text.
    fn one_character(&self, byte: usize) -> Span {
        let mut start = byte.min(self.text.len());
        while !self.text.is_char_boundary(start) {
            start -= 1;
        }
        let length = self.text[start..].chars().next().map_or(0, char::len_utf8);
        Span::new(self.source, start..start + length)
    }

    /// The range of an event, cut to its first line.
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
            Box::new(Diagnostic::new(Code::LIMIT_EXCEEDED, message).at(span, "the limit is passed here"))
        })?;
        Ok(())
    }

    fn event(&mut self, event: Event<'_>, mark: &Mark) -> Progress {
        let span = self.span(mark);
        if let Some(tag) = event.tag() {
            let fault = Diagnostic::new(
                Code::INVALID_VALUE,
                format!("tags such as `{}` have no meaning here", tag.original()),
            );
            let tag_span = mark.tag_span().map_or(span, |mark| self.span(&mark));
            self.faults.push(fault.at(tag_span, "remove it"));
        }
        let mut open = |value, style, anchor| {
            self.open.push(Open {
                node: Node::new(span, value),
                block: style == StructureStyle::Block,
                anchor,
                key: None,
            });
        };
        match event {
            Event::Scalar(text, style, anchor, _) => {
                self.spend(1, span)?;
                let (text, plain) = (text.into_owned(), style == ScalarStyle::Plain);
                self.finished(Node::new(span, Value::Scalar { text, plain }), anchor)?;
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
                    let fault = Diagnostic::new(Code::YAML_SYNTAX, "an alias stands inside what it refers to");
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
                let fault = Diagnostic::new(Code::YAML_SYNTAX, "a second document in one file");
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
            drop_duplicates(entries, self.faults);
        }
        let parent_key = self.open.last().and_then(|parent| parent.key.as_ref()?.as_ref());
        node.span = match (&node.value, parent_key) {
            // The event of the start covers only the bracket.
            _ if !block => self.first_line(node.span.range().start..end.byte_range().map_or(0, |range| range.end)),
            (_, Some(key)) => key.span,
            (Value::Map(entries), None) => entries.first().map_or(node.span, |(key, _)| key.span),
            _ => node.span,
        };
        self.finished(node, anchor)
    }

    /// Puts a complete value into the collection it belongs to.
    fn finished(&mut self, node: Node, anchor: usize) -> Progress {
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
                            let fault = Diagnostic::new(Code::INVALID_VALUE, "a key must be a single word");
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

/// Tells every key given twice and keeps the first.
fn drop_duplicates(entries: &mut Vec<(Key, Node)>, faults: &mut Vec<Diagnostic>) {
    let mut first: HashMap<String, Span> = HashMap::new();
    entries.retain(|(key, _)| match first.get(&key.text) {
        None => {
            first.insert(key.text.clone(), key.span);
            true
        }
        Some(&earlier) => {
            let fault = Diagnostic::new(Code::DUPLICATE_KEY, format!("the key `{}` is given twice", key.text));
            faults.push(fault.at(key.span, "given again").also(earlier, "first given here"));
            false
        }
    });
}

fn extent(node: &Node) -> Extent {
    let around = |inside: &mut dyn Iterator<Item = &Node>| {
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
