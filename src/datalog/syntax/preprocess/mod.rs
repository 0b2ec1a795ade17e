//! The preprocessor: the directives and the macros of C, which programs for Soufflé use.
//!
//! A file with directives becomes one text together with the files that it includes by `#include`, in which no
//! directive is left and all macros are expanded. That text is a source of its own, which maps each of its bytes to the
//! file that the user wrote ([`Sources::written`]), so that later stages need to know nothing of the preprocessor.
//!
//! `piece` reads words and signs, `expand` has the macros, and `condition` evaluates `#if`.
// Decision: docs/decisions/language.md#d080

mod condition;
mod expand;
mod piece;

use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::codes;
use crate::diag::{self, Diagnostic, Expansion, Faults, Part, SourceId, Sources, Span};
use crate::files::{ReadError, ReadFile, normalize};
use crate::symbol::WordSize;
use crate::syntax::lexer::{is_name, is_name_part, is_name_start, logical_line, preprocessor_word};
use crate::syntax::locate::Wanted;
use crate::syntax::preprocess::expand::{BUILTIN, Context, Macros, Stopped};
use crate::syntax::preprocess::piece::{Piece, PieceKind, Pieces, Space, space_of, string_length, word_length};

/// Maximum length of a chain of `#include`.
const MAX_DEPTH: usize = 64;

/// Maximum number of `#include` of a program that are followed.
const MAX_INCLUDES: usize = 10_000;

/// Maximum length in bytes of a path that macros make.
const MAX_PATH: usize = 4096;

/// Maximum size in bytes of the text that the preprocessor makes of a file and those it includes.
const MAX_TEXT_BYTES: usize = 64 << 20;

/// The name under which messages show the macros of [`Preprocessing::define`].
const OPTION: &str = "--macro";

/// How rule files are preprocessed, and where included files are.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Preprocessing {
    /// Whether directives such as `#define` are followed; otherwise they are errors.
    pub enabled: bool,
    /// The folders of included files that are not in the folder of the including one, in order.
    pub folders: Vec<PathBuf>,
    /// The text that defines the macros of [`Preprocessing::define`].
    definitions: String,
    /// The size of numbers, which the macro `RAM_DOMAIN_SIZE` states.
    pub(crate) word_size: WordSize,
}

impl Default for Preprocessing {
    fn default() -> Self {
        Preprocessing {
            enabled: true,
            folders: Vec::new(),
            definitions: String::new(),
            word_size: WordSize::default(),
        }
    }
}

impl Preprocessing {
    /// Defines macros in all files: `NAME=VALUE`, or `NAME` for the value 1, with spaces between several.
    ///
    /// # Errors
    /// The word that is no such definition.
    pub fn define(&mut self, macros: &str) -> Result<(), String> {
        for word in macros.split_whitespace() {
            let (name, value) = word.split_once('=').unwrap_or((word, "1"));
            if !is_name(name) || name == "defined" || BUILTIN.contains(&name) {
                return Err(word.to_owned());
            }
            self.definitions += &format!("#define {name} {value}\n");
        }
        Ok(())
    }

    /// Returns whether preprocessing may change a text.
    fn concerns(&self, text: &str) -> bool {
        self.enabled && (!self.definitions.is_empty() || has_directive(text) || has_builtin(text))
    }
}

fn has_builtin(text: &str) -> bool {
    text.contains("\\\n") || text.contains("\\\r\n") || BUILTIN.iter().any(|name| text.contains(name))
}

/// Returns whether a line begins with a directive.
fn has_directive(text: &str) -> bool {
    text.match_indices('#').any(|(at, _)| {
        let before = text[..at].trim_end_matches([' ', '\t']);
        let begins = before.is_empty() || before.ends_with('\n') || before == "\u{feff}";
        begins && preprocessor_word(&text[at..]).is_some()
    })
}

/// A preprocessed file.
pub(crate) struct Unit {
    /// The source to parse: the file itself, if there was nothing to do.
    pub source: SourceId,
    /// The normalized paths of the files that are part of it.
    pub included: Vec<PathBuf>,
    /// Whether text is missing, so that names may be declared that are not.
    pub incomplete: bool,
}

/// The sources of the files read so far, by normalized path. Only for lookup, never iterated.
pub(crate) type Files = HashMap<PathBuf, SourceId>;

/// Preprocesses a file. `files` are those that the program has read already, and those that this adds.
pub(crate) fn preprocess(
    sources: &mut Sources,
    id: SourceId,
    read: &dyn ReadFile,
    settings: &Preprocessing,
    files: &mut Files,
    faults: &mut Faults,
) -> Unit {
    let unit = Unit {
        source: id,
        included: Vec::new(),
        incomplete: false,
    };
    if !settings.concerns(sources.text(id)) {
        return unit;
    }
    let mut preprocessor = Preprocessor {
        sources,
        read,
        settings,
        files,
        faults,
        macros: Macros::new(settings.word_size),
        open: Vec::new(),
        once: HashSet::new(),
        includes: 0,
        unit,
        out: String::new(),
        parts: Vec::new(),
        after_expansion: false,
    };
    if !settings.definitions.is_empty() {
        let key = PathBuf::from(OPTION);
        let definitions = match preprocessor.files.get(&key) {
            Some(&known) => known,
            None => {
                let id = preprocessor.sources.add(OPTION, settings.definitions.clone());
                preprocessor.files.insert(key, id);
                id
            }
        };
        // The text consists of definitions, so nothing can stop it.
        let _ = preprocessor.file(definitions);
        preprocessor.out.clear();
        preprocessor.parts.clear();
    }
    if preprocessor.file(id).is_err() {
        preprocessor.unit.incomplete = true;
    }
    let Preprocessor {
        macros,
        out,
        parts,
        mut unit,
        ..
    } = preprocessor;
    unit.incomplete |= macros.faulty;
    let name = sources.name(id).to_owned();
    let expansion = Expansion {
        parts,
        uses: macros.uses,
    };
    unit.source = sources.add_expanded(&name, out, expansion);
    unit
}

struct Preprocessor<'a> {
    sources: &'a mut Sources,
    read: &'a dyn ReadFile,
    settings: &'a Preprocessing,
    files: &'a mut Files,
    faults: &'a mut Faults,
    macros: Macros,
    /// The normalized paths of the files that are open.
    open: Vec<PathBuf>,
    /// The normalized paths of the files with `#pragma once`. Only for lookup, never iterated.
    once: HashSet<PathBuf>,
    includes: usize,
    unit: Unit,
    out: String,
    parts: Vec<Part>,
    /// Whether the text so far ends with an expansion, so that the next character could continue its last word.
    after_expansion: bool,
}

/// A file that is being read.
struct Reading {
    id: SourceId,
    text: Arc<String>,
    at: usize,
    /// The start of the text that is to be copied.
    from: usize,
    conditions: Vec<Condition>,
}

/// An open `#if`.
struct Condition {
    /// Whether one of its branches was taken.
    taken: bool,
    has_else: bool,
    span: Span,
}

impl Preprocessor<'_> {
    fn fault(&mut self, span: Span, message: impl Into<String>, label: &str) {
        self.unit.incomplete = true;
        self.faults
            .push(Diagnostic::new(codes::PREPROCESSOR, message).at(span, label));
    }

    /// Reports that a limit is exceeded, and ends the preprocessor.
    fn limit(&mut self, span: Span, message: &str, note: String) -> Stopped {
        let fault = Diagnostic::new(diag::codes::LIMIT_EXCEEDED, message).at(span, "");
        self.faults.push(fault.note(note));
        Stopped
    }

    /// Appends the text of a file with all that it includes.
    fn file(&mut self, id: SourceId) -> Result<(), Stopped> {
        let text = self.sources.shared_text(id);
        let start = if text.starts_with('\u{feff}') {
            '\u{feff}'.len_utf8()
        } else {
            0
        };
        self.open.push(normalize(Path::new(self.sources.name(id))));
        let mut file = Reading {
            id,
            text: text.clone(),
            at: start,
            from: start,
            conditions: Vec::new(),
        };
        let bytes = text.as_bytes();
        let mut line_start = true;
        while let Some(&byte) = bytes.get(file.at) {
            match byte {
                b'\n' => {
                    line_start = true;
                    file.at += 1;
                }
                b' ' | b'\t' | b'\r' => file.at += 1,
                b'#' if line_start && preprocessor_word(&text[file.at..]).is_some() => {
                    self.copy(&mut file)?;
                    self.directive(&mut file)?;
                    line_start = false;
                }
                b'"' => {
                    file.at += string_length(&text[file.at..]);
                    line_start = false;
                }
                b'/' | b'\\' => match space_of(&text[file.at..]) {
                    Some((length, _)) if byte == b'\\' => {
                        self.copy(&mut file)?;
                        file.at += length;
                        file.from = file.at;
                    }
                    Some((length, _)) => file.at += length,
                    None => {
                        file.at += 1;
                        line_start = false;
                    }
                },
                _ if is_name_start(byte) => {
                    line_start = false;
                    let length = word_length(&text[file.at..]);
                    let name = &text[file.at..file.at + length];
                    match self.macros.is_defined(name) {
                        true => self.expansion(&mut file, length)?,
                        false => file.at += length,
                    }
                }
                _ if is_name_part(byte) => {
                    line_start = false;
                    file.at += word_length(&text[file.at..]);
                }
                _ => {
                    line_start = false;
                    file.at += 1;
                }
            }
        }
        self.copy(&mut file)?;
        for condition in file.conditions {
            self.fault(
                condition.span,
                "a condition without `#endif`",
                "this condition does not end",
            );
        }
        self.open.pop();
        Ok(())
    }

    /// Appends the text up to the current place.
    fn copy(&mut self, file: &mut Reading) -> Result<(), Stopped> {
        let text = &file.text[file.from..file.at];
        let place = Span::new(file.id, file.from..file.at);
        file.from = file.at;
        if text.is_empty() {
            return Ok(());
        }
        if std::mem::take(&mut self.after_expansion) {
            self.separate(text, place);
        }
        self.part(place, true, None);
        self.out.push_str(text);
        self.bounded(place)
    }

    fn bounded(&mut self, place: Span) -> Result<(), Stopped> {
        if self.out.len() <= MAX_TEXT_BYTES {
            return Ok(());
        }
        let note = format!(
            "a file has at most {} MiB with its includes and macros",
            MAX_TEXT_BYTES >> 20
        );
        Err(self.limit(place, "the preprocessed file is too large", note))
    }

    fn part(&mut self, place: Span, copied: bool, used: Option<u32>) {
        let start = u32::try_from(self.out.len()).unwrap_or(u32::MAX);
        let same = |last: &Part| !copied && !last.copied && last.place == place && last.used == used;
        if !self.parts.last().is_some_and(same) {
            self.parts.push(Part {
                start,
                place,
                copied,
                used,
            });
        }
    }

    /// Appends a space, if `next` would otherwise continue the last word or sign.
    fn separate(&mut self, next: &str, place: Span) {
        let (Some(&last), Some(&first)) = (self.out.as_bytes().last(), next.as_bytes().first()) else {
            return;
        };
        let signs = b":<>=!-/*&|+.\\";
        let joins = (is_name_part(last) && is_name_part(first)) || (signs.contains(&last) && signs.contains(&first));
        if joins && (last, first) != (b'.', b'.') {
            self.part(
                Span {
                    end: place.start,
                    ..place
                },
                false,
                None,
            );
            self.out.push(' ');
        }
    }

    /// Appends the expansion of the macro whose name has `length` bytes at the current place.
    fn expansion(&mut self, file: &mut Reading, length: usize) -> Result<(), Stopped> {
        let text = file.text.clone();
        let start = file.at;
        let mut pieces = Pieces {
            source: file.id,
            text: &text,
            at: start + length,
            end: text.len(),
        };
        let name = Pieces {
            at: start,
            end: start + length,
            ..pieces
        };
        let name: Vec<Piece> = name.collect();
        let mut context = Context {
            sources: &*self.sources,
            faults: &mut *self.faults,
        };
        let expanded = self.macros.expand(name, Some(&mut pieces), 0, &mut context)?;
        let unchanged = pieces.at == start + length
            && matches!(expanded[..], [only] if only.span() == Some(Span::new(file.id, start..start + length)));
        file.at = pieces.at;
        if unchanged {
            return Ok(());
        }
        let after = std::mem::replace(&mut file.at, start);
        self.copy(file)?;
        (file.at, file.from) = (after, after);
        let whole = Span::new(file.id, start..after);
        let mut before: Option<&Piece> = None;
        for piece in &expanded {
            self.append(piece, before, whole)?;
            before = Some(piece);
        }
        self.after_expansion = true;
        Ok(())
    }

    /// Appends a piece of the expansion of the macro at `whole`, in which it follows the piece `before`.
    fn append(&mut self, piece: &Piece, before: Option<&Piece>, whole: Span) -> Result<(), Stopped> {
        let (place, copied) = match (piece.place, piece.used) {
            (Some(place), _) => (place, piece.span() == Some(place)),
            (None, Some(used)) => (self.macros.root(used).call, false),
            (None, None) => (whole, false),
        };
        let text = self.macros.text(piece, self.sources).to_owned();
        // Two signs of one text, such as `:-`, belong together.
        let adjoins = |before: &Piece| (before.text, before.end) == (piece.text, piece.start);
        match (before, piece.space) {
            (Some(before), Space::None) if adjoins(before) => {}
            (None, _) | (_, Space::None) => self.separate(&text, place),
            (_, space) => {
                let before = if copied {
                    Span {
                        end: place.start,
                        ..place
                    }
                } else {
                    place
                };
                self.part(before, false, piece.used);
                self.out.push(if space == Space::Line { '\n' } else { ' ' });
            }
        }
        self.part(place, copied, piece.used);
        let start = self.out.len();
        self.out.push_str(&text);
        let end = self.out.len();
        if let Some(used) = piece.used {
            let range = &mut self.macros.root_mut(used).text;
            *range = match range.end {
                0 => start..end,
                _ => range.start..end,
            };
        }
        self.bounded(whole)
    }

    /// Follows the directive at the current place, up to the end of its line.
    fn directive(&mut self, file: &mut Reading) -> Result<(), Stopped> {
        let text = file.text.clone();
        let line = &text[file.at..file.at + logical_line(&text[file.at..])];
        let start = file.at;
        let word = preprocessor_word(line).unwrap_or_default();
        let after = start + line.find(word).unwrap_or(0) + word.len();
        let span = Span::new(file.id, start..after);
        file.at += line.len();
        file.from = file.at;
        let rest = Pieces {
            source: file.id,
            text: &text,
            at: after,
            end: file.at,
        };
        let pieces: Vec<Piece> = rest.clone().collect();
        match word {
            "include" => self.include(rest, span)?,
            "define" => {
                if let Err((at, message)) = self.macros.define(&pieces, self.sources) {
                    self.fault(at.unwrap_or(span), message, "");
                }
            }
            "undef" => match pieces.first().filter(|name| name.kind == PieceKind::Name) {
                Some(name) => {
                    let name = self.macros.text(name, self.sources).to_owned();
                    self.macros.undefine(&name);
                }
                None => self.fault(span, "`#undef` without a name", ""),
            },
            "if" | "ifdef" | "ifndef" => {
                let taken = self.holds(word, pieces, span)?;
                file.conditions.push(Condition {
                    taken,
                    has_else: false,
                    span,
                });
                if !taken {
                    self.skip(file)?;
                }
            }
            "elif" | "elifdef" | "elifndef" | "else" | "endif" => {
                if file.conditions.is_empty() {
                    self.fault(span, format!("`#{word}` without `#if`"), "");
                } else if self.branch(file, word, Vec::new(), span)? {
                    self.skip(file)?;
                }
            }
            "error" => {
                let message = text[after..file.at].trim();
                self.unit.incomplete = true;
                let fault = Diagnostic::new(codes::PREPROCESSOR, format!("`#error`: {message}"));
                let fault = fault.at(Span::new(file.id, start..start + line.trim_end().len()), "");
                self.faults
                    .push(fault.help("define the macros that the program needs with the option `-M`"));
            }
            "pragma" => {
                let once = pieces
                    .first()
                    .is_some_and(|word| self.macros.text(word, self.sources) == "once");
                if let (true, Some(key)) = (once, self.open.last()) {
                    self.once.insert(key.clone());
                }
            }
            // `#line`, `#warning`, and the markers of lines that the preprocessor of C writes.
            _ => {}
        }
        Ok(())
    }

    /// Returns whether the condition of a directive holds.
    fn holds(&mut self, word: &str, pieces: Vec<Piece>, span: Span) -> Result<bool, Stopped> {
        if word.ends_with("def") {
            let Some(name) = pieces.first().filter(|name| name.kind == PieceKind::Name) else {
                self.fault(span, format!("`#{word}` without a name"), "");
                return Ok(false);
            };
            let defined = self.macros.is_defined(self.macros.text(name, self.sources));
            return Ok(defined != word.ends_with("ndef"));
        }
        // The names after `defined` do not expand.
        let mut guarded = Vec::with_capacity(pieces.len());
        let (mut after, mut open) = (false, false);
        for mut piece in pieces {
            let text = self.macros.text(&piece, self.sources);
            match (after, text) {
                (true, "(") if !open => open = true,
                (true, _) => {
                    piece.painted = true;
                    after = false;
                }
                _ => {
                    after = text == "defined";
                    open = false;
                }
            }
            guarded.push(piece);
        }
        let mut context = Context {
            sources: &*self.sources,
            faults: &mut *self.faults,
        };
        let expanded = self.macros.expand(guarded, None, 0, &mut context)?;
        match condition::value(&expanded, &self.macros, self.sources) {
            Ok(value) => Ok(value != 0),
            Err((at, message)) => {
                self.fault(at.unwrap_or(span), message, "");
                Ok(false)
            }
        }
    }

    /// Goes on with the next branch of the innermost condition. Returns whether that branch is to be skipped.
    fn branch(&mut self, file: &mut Reading, word: &str, pieces: Vec<Piece>, span: Span) -> Result<bool, Stopped> {
        let Some(condition) = file.conditions.last_mut() else {
            return Ok(false);
        };
        if word == "endif" {
            file.conditions.pop();
            return Ok(false);
        }
        let begun = condition.span;
        let after_else = condition.has_else;
        condition.has_else |= word == "else";
        if after_else {
            let fault = Diagnostic::new(codes::PREPROCESSOR, format!("`#{word}` after `#else`")).at(span, "");
            self.faults.push(fault.also(begun, "the condition begins here"));
            return Ok(true);
        }
        if condition.taken {
            return Ok(true);
        }
        let holds = match word {
            "else" => true,
            _ => self.holds(word.strip_prefix("el").unwrap_or(word), pieces, span)?,
        };
        if let Some(condition) = file.conditions.last_mut() {
            condition.taken = holds;
        }
        Ok(!holds)
    }

    /// Skips branches up to one that is taken, or to the end of the condition.
    fn skip(&mut self, file: &mut Reading) -> Result<(), Stopped> {
        let text = file.text.clone();
        let mut depth = 0_usize;
        while file.at < text.len() {
            // The end of the line before.
            file.at += usize::from(text[file.at..].starts_with('\n'));
            let indent = text[file.at..].len() - text[file.at..].trim_start_matches([' ', '\t']).len();
            let start = file.at + indent;
            let line = &text[start..start + logical_line(&text[start..])];
            file.at = start + line.len();
            let word = if line.starts_with('#') {
                preprocessor_word(line)
            } else {
                None
            };
            match word.unwrap_or_default() {
                "if" | "ifdef" | "ifndef" => depth += 1,
                "endif" if depth > 0 => depth -= 1,
                word @ ("elif" | "elifdef" | "elifndef" | "else" | "endif") if depth == 0 => {
                    let after = start + line.find(word).unwrap_or(0) + word.len();
                    let pieces = Pieces {
                        source: file.id,
                        text: &text,
                        at: after,
                        end: file.at,
                    };
                    let span = Span::new(file.id, start..after);
                    if !self.branch(file, word, pieces.collect(), span)? {
                        break;
                    }
                }
                _ => {}
            }
        }
        file.from = file.at;
        Ok(())
    }

    /// Appends the file that an `#include` names. `rest` is the text after that word.
    fn include(&mut self, rest: Pieces<'_>, span: Span) -> Result<(), Stopped> {
        let pieces: Vec<Piece> = rest.clone().collect();
        let is_direct = pieces
            .first()
            .is_some_and(|first| first.kind == PieceKind::String || self.macros.text(first, self.sources) == "<");
        let mut span = match (
            pieces.first().and_then(Piece::span),
            pieces.last().and_then(Piece::span),
        ) {
            (Some(first), Some(last)) => first.to(last),
            _ => span,
        };
        let written = match is_direct {
            true => self.sources.slice(span).to_owned(),
            false => {
                let mut context = Context {
                    sources: &*self.sources,
                    faults: &mut *self.faults,
                };
                let expanded = self.macros.expand(pieces, None, 0, &mut context)?;
                let mut text = String::new();
                for piece in &expanded {
                    if text.len() > MAX_PATH {
                        break;
                    }
                    if piece.space > Space::None && !text.is_empty() {
                        text.push(' ');
                    }
                    text.push_str(self.macros.text(piece, self.sources));
                }
                text
            }
        };
        let (path, elsewhere) = match written.as_bytes() {
            [b'"', ..] => (written[1..].split('"').next(), false),
            [b'<', ..] => (written[1..].split_once('>').map(|(path, _)| path), true),
            _ => (None, false),
        };
        let Some(path) = path.filter(|path| !path.is_empty()) else {
            self.fault(
                span,
                "`#include` without a file",
                "write `#include \"file\"` or `#include <file>`",
            );
            return Ok(());
        };
        if is_direct {
            // Without a comment or other text behind the name.
            span.end = span.start + u32::try_from(path.len() + 2).unwrap_or(u32::MAX);
        }
        self.includes += 1;
        if self.includes > MAX_INCLUDES {
            return Err(self.limit(
                span,
                "too many included files",
                format!("a program has at most {MAX_INCLUDES} files"),
            ));
        }
        let from = self.sources.name(span.source).to_owned();
        let wanted = Wanted {
            path,
            from: &from,
            elsewhere,
            span,
        };
        let folders = &self.settings.folders;
        let candidates = wanted.candidates(folders);
        let mut error = (candidates.first().cloned().unwrap_or_default(), ReadError::NotFound);
        for candidate in candidates {
            let key = normalize(&candidate);
            if self.once.contains(&key) {
                return Ok(());
            }
            let id = match self.files.get(&key) {
                Some(&id) => id,
                None => match self.read.read(&candidate) {
                    Ok(text) => {
                        let id = self.sources.add(candidate.display().to_string(), text);
                        self.files.insert(key.clone(), id);
                        id
                    }
                    Err(ReadError::NotFound) => continue,
                    Err(other) => {
                        error = (candidate, other);
                        break;
                    }
                },
            };
            if self.open.len() >= MAX_DEPTH {
                return Err(match self.open.contains(&key) {
                    true => {
                        let fault = Diagnostic::new(codes::INCLUDE_CYCLE, format!("`{path}` includes itself"));
                        let fault = fault.at(span, "this include never ends");
                        self.faults.push(fault.help("begin the file with `#pragma once`"));
                        Stopped
                    }
                    false => {
                        let note = format!("a chain of includes has at most {MAX_DEPTH} files");
                        self.limit(span, "includes nested too deeply", note)
                    }
                });
            }
            self.unit.included.push(key);
            self.file(id)?;
            return Ok(());
        }
        self.unit.incomplete = true;
        let fault = wanted.unreadable(folders, (&error.0, error.1), self.read);
        self.faults.push(fault);
        Ok(())
    }
}
