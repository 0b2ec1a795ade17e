//! Macros and their expansion.
//!
//! Expansion follows the C standard: arguments expand before they replace the parameters, the result is read again
//! together with the text that follows, and the name of a macro does not expand within its own expansion.

use std::collections::HashMap;
use std::sync::Arc;

use crate::codes;
use crate::diag::{self, Diagnostic, Faults, MacroUse, Sources, Span};
use crate::symbol::WordSize;
use crate::syntax::lexer::{logical_line, preprocessor_word};
use crate::syntax::preprocess::piece::{Piece, PieceKind, PieceText, Pieces, Space, piece_of};

/// Maximum number of pieces that all macros of a file write, read again or take as arguments.
const MAX_WORK: usize = 10_000_000;

/// Maximum number of bytes that `#` and `##` make in a file.
const MAX_MADE: usize = 64 << 20;

/// The same for one use of a macro, with those in its arguments and its definition.
const MAX_WORK_OF_USE: usize = 1_000_000;

/// Maximum number of parameters of a macro.
const MAX_PARAMETERS: usize = 255;

/// Maximum depth of uses of macros in arguments of macros.
const MAX_DEPTH: usize = 100;

/// The name of the macro parameter for the arguments of `...`.
const VARIADIC: &str = "__VA_ARGS__";

/// The macros that the preprocessor defines.
pub(super) const BUILTIN: [&str; 4] = ["__LINE__", "__FILE__", "__COUNTER__", DOMAIN_SIZE];

/// The macro of Soufflé for the number of bits of a value.
const DOMAIN_SIZE: &str = "RAM_DOMAIN_SIZE";

/// The arguments of a use of a macro, and the `)` after them.
type Arguments = (Vec<Vec<Piece>>, Piece);

/// A limit was reached, or too many faults were found, so that the preprocessor ends.
#[derive(Debug)]
pub(super) struct Stopped;

#[derive(Clone, Debug)]
pub(super) struct Macro {
    number: u32,
    name: Arc<str>,
    /// The number of parameters, of a macro with parameters.
    parameters: Option<usize>,
    /// Whether the last parameter takes all further arguments.
    variadic: bool,
    body: Arc<[BodyPiece]>,
    /// The place of the name in the definition.
    definition: Span,
}

#[derive(Clone, Copy, Debug)]
struct BodyPiece {
    piece: Piece,
    /// The position of the parameter that the piece names.
    parameter: Option<usize>,
}

/// The macros that are defined, and the text that they wrote.
pub(super) struct Macros {
    word_size: WordSize,
    known: HashMap<String, Macro>,
    /// By number of the macro: whether it is being expanded.
    active: Vec<bool>,
    /// Text that no source contains.
    made: String,
    pub(super) uses: Vec<MacroUse>,
    work: usize,
    /// The work before the current use of a macro.
    work_before: usize,
    /// The value of the next `__COUNTER__`.
    counter: u32,
    /// Whether a use of a macro was faulty, so that text is missing.
    pub(super) faulty: bool,
}

/// What an expansion reads besides the macros: the sources of their text, and faults.
pub(super) struct Context<'a> {
    pub sources: &'a Sources,
    pub faults: &'a mut Faults,
}

impl Macros {
    pub(super) fn new(word_size: WordSize) -> Self {
        Macros {
            word_size,
            known: HashMap::new(),
            active: Vec::new(),
            made: String::new(),
            uses: Vec::new(),
            work: 0,
            work_before: 0,
            counter: 0,
            faulty: false,
        }
    }

    pub(super) fn is_defined(&self, name: &str) -> bool {
        self.known.contains_key(name) || BUILTIN.contains(&name)
    }

    pub(super) fn undefine(&mut self, name: &str) {
        self.known.remove(name);
    }

    /// Returns the text of a piece.
    pub(super) fn text<'t>(&'t self, piece: &Piece, sources: &'t Sources) -> &'t str {
        let text = match piece.text {
            PieceText::Source(source) => sources.text(source),
            PieceText::Made => &self.made,
        };
        match piece.kind {
            PieceKind::End(_) => "",
            _ => &text[piece.start as usize..piece.end as usize],
        }
    }

    fn made(&mut self, text: &str, kind: PieceKind, like: Piece) -> Piece {
        let narrow = |byte: usize| u32::try_from(byte).unwrap_or(u32::MAX);
        let start = narrow(self.made.len());
        self.made.push_str(text);
        Piece {
            kind,
            painted: false,
            text: PieceText::Made,
            start,
            end: narrow(self.made.len()),
            ..like
        }
    }

    /// Defines a macro from the pieces of a `#define` after that word.
    ///
    /// # Errors
    /// What is wrong with the definition, and where.
    pub(super) fn define(&mut self, pieces: &[Piece], sources: &Sources) -> Result<(), (Option<Span>, &'static str)> {
        let Some((name, rest)) = pieces.split_first() else {
            return Err((None, "`#define` without a name"));
        };
        let text = |piece: &Piece| self.text(piece, sources);
        let Some(definition) = name.span().filter(|_| name.kind == PieceKind::Name) else {
            return Err((name.span(), "the name of a macro is a word"));
        };
        if text(name) == "defined" || BUILTIN.contains(&text(name)) {
            return Err((name.span(), "this name cannot be defined"));
        }
        let has_parameters = rest
            .first()
            .is_some_and(|open| open.space == Space::None && text(open) == "(");
        let mut parameters: Vec<&str> = Vec::new();
        let mut variadic = false;
        let mut body = rest;
        if has_parameters {
            let close = rest.iter().position(|piece| text(piece) == ")");
            let Some(close) = close else {
                return Err((rest[0].span(), "the parameters of a macro end with `)`"));
            };
            if close > 2 * MAX_PARAMETERS {
                return Err((rest[0].span(), "a macro has at most 255 parameters"));
            }
            let (mut list, mut first) = (rest[1..close].iter().peekable(), true);
            body = &rest[close + 1..];
            while list.peek().is_some() {
                if !std::mem::take(&mut first)
                    && let Some(comma) = list.next()
                    && text(comma) != ","
                {
                    return Err((comma.span(), "a comma separates parameters"));
                }
                let dots = |list: &mut std::iter::Peekable<std::slice::Iter<'_, Piece>>| {
                    let mut ahead = list.clone();
                    let found = (0..3).all(|_| ahead.next().is_some_and(|piece| text(piece) == "."));
                    if found {
                        *list = ahead;
                    }
                    found
                };
                if dots(&mut list) {
                    variadic = true;
                    parameters.push(VARIADIC);
                } else {
                    let Some(parameter) = list.next().filter(|piece| piece.kind == PieceKind::Name) else {
                        return Err((rest[0].span(), "parameters are names between commas"));
                    };
                    if parameters.contains(&text(parameter)) {
                        return Err((parameter.span(), "this parameter has two places"));
                    }
                    parameters.push(text(parameter));
                    variadic = dots(&mut list);
                }
                if variadic && list.peek().is_some() {
                    return Err((rest[0].span(), "`...` is the last parameter"));
                }
            }
        }
        let is_paste = |piece: Option<&Piece>| piece.is_some_and(|piece| text(piece) == "##");
        if is_paste(body.first()) || is_paste(body.last()) {
            return Err((name.span(), "`##` stands between two parts of a definition"));
        }
        let body: Vec<BodyPiece> = (body.iter())
            .map(|piece| BodyPiece {
                parameter: (piece.kind == PieceKind::Name)
                    .then(|| parameters.iter().position(|parameter| *parameter == text(piece)))
                    .flatten(),
                piece: Piece { place: None, ..*piece },
            })
            .collect();
        let (name, parameters) = (text(name).to_owned(), has_parameters.then_some(parameters.len()));
        let number = u32::try_from(self.active.len()).unwrap_or(u32::MAX);
        self.active.push(false);
        let defined = Macro {
            number,
            name: name.as_str().into(),
            parameters,
            variadic,
            body: body.into(),
            definition,
        };
        self.known.insert(name, defined);
        Ok(())
    }

    fn spend(&mut self, pieces: usize, at: Option<Span>, context: &mut Context<'_>) -> Result<(), Stopped> {
        self.work = self.work.saturating_add(pieces);
        let made = self.made.len() <= MAX_MADE;
        if made && self.work <= MAX_WORK && self.work - self.work_before <= MAX_WORK_OF_USE {
            return Ok(());
        }
        let fault = Diagnostic::new(diag::codes::LIMIT_EXCEEDED, "the macros expand to too much text");
        let fault = match at {
            Some(at) => fault.at(at, "in this use"),
            None => fault,
        };
        context.faults.push(fault.note(format!(
            "one use takes and writes at most {MAX_WORK_OF_USE} words and signs, all of a file {MAX_WORK}, and `#` and \
             `##` make {} MiB",
            MAX_MADE >> 20
        )));
        Err(Stopped)
    }

    /// Expands pieces completely. `rest` is the text that follows them, from which a macro may take its arguments.
    pub(super) fn expand(
        &mut self,
        pieces: Vec<Piece>,
        mut rest: Option<&mut Pieces<'_>>,
        depth: usize,
        context: &mut Context<'_>,
    ) -> Result<Vec<Piece>, Stopped> {
        let at = pieces.first().and_then(|piece| piece.place);
        if depth == 0 {
            self.work_before = self.work;
        }
        let mut pending = pieces;
        pending.reverse();
        let mut out = Vec::new();
        while let Some(mut piece) = pending.pop() {
            self.spend(1, at, context)?;
            match piece.kind {
                PieceKind::End(number) => {
                    self.active[number as usize] = false;
                    continue;
                }
                PieceKind::Name if !piece.painted => {}
                _ => {
                    out.push(piece);
                    continue;
                }
            }
            if let Some(made) = self.builtin(&piece, context.sources) {
                out.push(made);
                continue;
            }
            let Some(found) = self.known.get(self.text(&piece, context.sources)).cloned() else {
                out.push(piece);
                continue;
            };
            if self.active[found.number as usize] {
                piece.painted = true;
                out.push(piece);
                continue;
            }
            let mut call = piece.place.or(piece.span()).unwrap_or(found.definition);
            let mut arguments = Vec::new();
            if let Some(parameters) = found.parameters {
                if !self.opens(&pending, rest.as_deref(), context.sources) {
                    out.push(piece);
                    continue;
                }
                let Some((given, close)) = self.arguments(&found, call, &mut pending, rest.as_deref_mut(), context)?
                else {
                    continue;
                };
                if let (Some(_), Some(close)) = (piece.place, close.place) {
                    call = call.to(close);
                }
                let none = parameters == 0 && given.len() == 1 && given[0].is_empty();
                arguments = if none { Vec::new() } else { given };
                if found.variadic && arguments.len() + 1 == parameters {
                    arguments.push(Vec::new());
                }
                if arguments.len() != parameters {
                    let message = format!(
                        "the macro `{}` takes {}, not {}",
                        found.name,
                        diag::counted(parameters, "argument"),
                        arguments.len()
                    );
                    let fault = Diagnostic::new(codes::PREPROCESSOR, message).at(call, "");
                    context.faults.push(fault.also(found.definition, "the macro"));
                    self.faulty = true;
                    // As written, so that the clause has no further fault.
                    let sign = |this: &mut Self, sign: &str| {
                        let like = Piece {
                            space: Space::None,
                            ..piece
                        };
                        this.made(sign, PieceKind::Other, like)
                    };
                    out.push(piece);
                    for (at, argument) in arguments.into_iter().enumerate() {
                        out.push(sign(self, if at == 0 { "(" } else { "," }));
                        out.extend(argument);
                    }
                    out.push(sign(self, ")"));
                    continue;
                }
            }
            let used = u32::try_from(self.uses.len()).unwrap_or(u32::MAX);
            self.uses.push(MacroUse {
                name: found.name.clone(),
                definition: found.definition,
                call,
                within: piece.used,
                text: 0..0,
            });
            let replaced = self.substitute(&found, &piece, &arguments, used, depth, context)?;
            self.active[found.number as usize] = true;
            pending.push(Piece {
                kind: PieceKind::End(found.number),
                ..piece
            });
            pending.extend(replaced.into_iter().rev());
        }
        Ok(out)
    }

    /// Returns the value of a macro that the preprocessor defines.
    fn builtin(&mut self, piece: &Piece, sources: &Sources) -> Option<Piece> {
        let name = BUILTIN.into_iter().find(|name| *name == self.text(piece, sources))?;
        // In the definition of a macro, the place is that of its outermost use.
        let place = match (piece.place, piece.used) {
            (Some(place), _) => place,
            (None, Some(used)) => self.root(used).call,
            (None, None) => piece.span()?,
        };
        let (text, kind) = match name {
            DOMAIN_SIZE => {
                let bits = match self.word_size {
                    WordSize::Bits32 => "32",
                    WordSize::Bits64 => "64",
                };
                (bits.to_owned(), PieceKind::Number)
            }
            "__LINE__" => (sources.position(place).line.to_string(), PieceKind::Number),
            "__FILE__" => {
                let name = sources.name(place.source).replace('\\', "\\\\").replace('"', "\\\"");
                (format!("\"{name}\""), PieceKind::String)
            }
            _ => {
                self.counter += 1;
                ((self.counter - 1).to_string(), PieceKind::Number)
            }
        };
        Some(self.made(&text, kind, *piece))
    }

    /// Returns the outermost use that a use is part of.
    pub(super) fn root(&self, mut used: u32) -> &MacroUse {
        while let Some(within) = self.uses[used as usize].within {
            used = within;
        }
        &self.uses[used as usize]
    }

    /// Mutable variant of [`root`](Macros::root).
    pub(super) fn root_mut(&mut self, mut used: u32) -> &mut MacroUse {
        while let Some(within) = self.uses[used as usize].within {
            used = within;
        }
        &mut self.uses[used as usize]
    }

    /// Returns whether the next piece is `(`.
    fn opens(&self, pending: &[Piece], rest: Option<&Pieces<'_>>, sources: &Sources) -> bool {
        let next = pending
            .iter()
            .rev()
            .find(|piece| !matches!(piece.kind, PieceKind::End(_)));
        let next = next.copied().or_else(|| rest.cloned()?.next());
        next.is_some_and(|piece| self.text(&piece, sources) == "(")
    }

    /// Reads the arguments of a macro and the `)` after them. `None` if that is missing, which it reports.
    fn arguments(
        &mut self,
        of: &Macro,
        call: Span,
        pending: &mut Vec<Piece>,
        mut rest: Option<&mut Pieces<'_>>,
        context: &mut Context<'_>,
    ) -> Result<Option<Arguments>, Stopped> {
        let mut arguments: Vec<Vec<Piece>> = Vec::new();
        let mut depth = 0_usize;
        loop {
            let mut in_rest = false;
            let next = match (pending.pop(), rest.as_deref_mut()) {
                (Some(piece), _) => Some(piece),
                (None, Some(rest)) => {
                    in_rest = true;
                    rest.next()
                }
                (None, None) => None,
            };
            let Some(piece) = next else {
                let message = format!("the use of the macro `{}` does not end", of.name);
                let fault = Diagnostic::new(codes::PREPROCESSOR, message).at(call, "these arguments have no `)`");
                context.faults.push(fault.also(of.definition, "the macro"));
                self.faulty = true;
                return Ok(None);
            };
            self.spend(1, Some(call), context)?;
            if let PieceKind::End(number) = piece.kind {
                self.active[number as usize] = false;
                continue;
            }
            let text = self.text(&piece, context.sources);
            if let (true, "#", Space::Line, Some(rest)) = (in_rest, text, piece.space, rest.as_deref_mut()) {
                let line = &rest.text[piece.start as usize..];
                if preprocessor_word(line).is_some() {
                    let message = format!("a directive among the arguments of the macro `{}`", of.name);
                    let fault = Diagnostic::new(codes::PREPROCESSOR, message).at(piece.place.unwrap_or(call), "");
                    context
                        .faults
                        .push(fault.also(call, "the use of the macro begins here"));
                    self.faulty = true;
                    rest.at = piece.start as usize + logical_line(line);
                    continue;
                }
            }
            let is_last = of.variadic && Some(arguments.len()) == of.parameters;
            match text {
                // The one before all arguments.
                "(" if arguments.is_empty() => {
                    arguments.push(Vec::new());
                    continue;
                }
                "(" => depth += 1,
                ")" if depth == 0 => return Ok(Some((arguments, piece))),
                ")" => depth -= 1,
                "," if depth == 0 && !is_last => {
                    arguments.push(Vec::new());
                    continue;
                }
                _ => {}
            }
            if let Some(argument) = arguments.last_mut() {
                argument.push(piece);
            }
        }
    }

    /// Returns the body of a macro with its arguments in place of the parameters.
    fn substitute(
        &mut self,
        of: &Macro,
        name: &Piece,
        arguments: &[Vec<Piece>],
        used: u32,
        depth: usize,
        context: &mut Context<'_>,
    ) -> Result<Vec<Piece>, Stopped> {
        if depth >= MAX_DEPTH {
            let fault = Diagnostic::new(diag::codes::LIMIT_EXCEEDED, "macros nested too deeply");
            let fault = fault.at(self.root(used).call, "");
            let note = format!("arguments of macros contain uses of macros at most {MAX_DEPTH} deep");
            context.faults.push(fault.note(note));
            return Err(Stopped);
        }
        let mut expanded: Vec<Option<Vec<Piece>>> = vec![None; arguments.len()];
        let mut out: Vec<Piece> = Vec::new();
        let mut at = 0;
        let is_paste = |this: &Self, at: usize| {
            let piece = of.body.get(at).map(|body| &body.piece);
            piece.is_some_and(|piece| this.text(piece, context.sources) == "##")
        };
        // Whether `##` joins the next part to the last one, and whether that has no text.
        let (mut joins, mut empty) = (false, false);
        while at < of.body.len() {
            if is_paste(self, at) {
                joins = true;
                at += 1;
                continue;
            }
            let BodyPiece { piece, parameter } = of.body[at];
            let named = of.body.get(at + 1).and_then(|next| next.parameter);
            let quotes = of.parameters.is_some() && self.text(&piece, context.sources) == "#";
            let made_here = Piece {
                used: Some(used),
                ..piece
            };
            let mut part = match (parameter, named.filter(|_| quotes)) {
                (_, Some(quoted)) => {
                    at += 1;
                    let text = self.quoted(&arguments[quoted], context.sources);
                    vec![self.made(&text, PieceKind::String, made_here)]
                }
                (Some(parameter), None) => {
                    // What `##` joins is not expanded.
                    let mut part = if joins || is_paste(self, at + 1) {
                        arguments[parameter].clone()
                    } else if let Some(known) = &expanded[parameter] {
                        known.clone()
                    } else {
                        let part = self.expand(arguments[parameter].clone(), None, depth + 1, context)?;
                        expanded[parameter].insert(part).clone()
                    };
                    if let Some(first) = part.first_mut() {
                        first.space = piece.space;
                    }
                    for piece in &mut part {
                        piece.used = piece.used.or(Some(used));
                    }
                    part
                }
                (None, None) => vec![made_here],
            };
            at += 1;
            self.spend(part.len() + 1, name.place, context)?;
            if !std::mem::take(&mut joins) {
                empty = part.is_empty();
                out.append(&mut part);
            } else {
                // `, ## __VA_ARGS__` joins nothing: without arguments, it drops the comma.
                let is_rest = of.variadic && parameter.map(|parameter| parameter + 1) == of.parameters;
                let after_comma = !empty && out.last().is_some_and(|last| self.text(last, context.sources) == ",");
                match (is_rest && after_comma, part.is_empty()) {
                    (true, true) => _ = out.pop(),
                    (false, false) if !empty => self.join(&mut out, part, context.sources),
                    (_, none) => {
                        empty &= none;
                        out.append(&mut part);
                    }
                }
            }
        }
        if let Some(first) = out.first_mut() {
            first.space = name.space;
        }
        Ok(out)
    }

    /// Joins the last piece with the first one of a part to one name or number. What would be several stays so.
    fn join(&mut self, out: &mut Vec<Piece>, mut part: Vec<Piece>, sources: &Sources) {
        let (Some(&left), Some(&right)) = (out.last(), part.first()) else {
            out.append(&mut part);
            return;
        };
        let text = format!("{}{}", self.text(&left, sources), self.text(&right, sources));
        let (kind, length) = match text.is_empty() {
            true => (left.kind, 0),
            false => piece_of(&text),
        };
        part[0].space = Space::None;
        if length == text.len() {
            part[0] = self.made(&text, kind, Piece { place: None, ..left });
            part[0].used = left.used.or(right.used);
            out.pop();
        }
        out.append(&mut part);
    }

    /// Returns an argument as a string: `#parameter`.
    fn quoted(&self, argument: &[Piece], sources: &Sources) -> String {
        let mut text = String::from("\"");
        for (at, piece) in argument.iter().enumerate() {
            if text.len() > MAX_MADE {
                break;
            }
            if at > 0 && piece.space > Space::None {
                text.push(' ');
            }
            let written = self.text(piece, sources);
            match piece.kind {
                PieceKind::String => text.push_str(&written.replace('\\', "\\\\").replace('"', "\\\"")),
                _ => text.push_str(written),
            }
        }
        text.push('"');
        text
    }
}
