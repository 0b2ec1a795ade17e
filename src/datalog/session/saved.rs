//! Sessions as files: everything that a session holds but its settings.

use super::Session;
use crate::check::{Atom, Literal, PredicateId, Rules};
use crate::eval::limits::Limits;
use crate::plan::Compiled;
use crate::program::Program;
use crate::snapshot::{Decoder, Encoder, Fingerprint, SnapshotError};
use crate::symbol::{Symbols, WordSize};
use sha2::{Digest as _, Sha256};
use std::fmt::Write as _;
use std::io::{self, Read, Write};

/// The memory of a symbol besides its text.
const SYMBOL_BYTES: usize = 128;

impl Session {
    /// Writes the session: all facts, what follows from them, the pending changes, and the memory of earlier ticks.
    ///
    /// [`Program::load_session`] reads it without deriving anything again. The settings of the session (limits, threads,
    /// strategy) are not saved. `out` needs no buffer.
    ///
    /// ```
    /// # use logicity_datalog::{Limits, Program};
    /// let program = Program::parse(
    ///     ".decl edge(x: number, y: number) .input edge
    ///      .decl path(x: number, y: number)
    ///      path(x, y) :- edge(x, y).
    ///      path(x, z) :- path(x, y), edge(y, z).",
    /// )?;
    /// let mut session = program.session();
    /// session.insert_all("edge", [(1, 2), (2, 3)])?;
    /// session.commit()?;
    /// let mut file = Vec::new();
    /// session.save(&mut file)?;
    ///
    /// let mut loaded = program.load_session(&mut &file[..], Limits::default())?;
    /// assert!(loaded.contains("path", (1, 3)));
    /// loaded.retract("edge", (2, 3))?;
    /// loaded.commit()?;
    /// assert_eq!(loaded.len("path"), 1);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// If writing to `out` fails.
    pub fn save(&self, out: &mut dyn Write) -> io::Result<()> {
        let mut encoder = Encoder::new(out, &fingerprint(&self.program.0))?;
        encoder.count(self.symbols.len())?;
        for id in 0..self.symbols.len() as u32 {
            encoder.text(self.symbols.resolve(crate::symbol::Symbol(id)).unwrap_or_default())?;
        }
        self.store.save(&mut encoder)?;
        self.history.save(&mut encoder)?;
        encoder.finish()
    }
}

impl Program {
    /// Reads a session that [`Session::save`] wrote.
    ///
    /// The rules must be those of the saved session; layout, comments and the names of variables do not matter. The
    /// session gets the limits. The checksum finds accidental changes of the file only: a program that writes such files
    /// can store rows that the rules do not derive.
    ///
    /// ```
    /// # use logicity_datalog::{Limits, Program};
    /// let program = Program::parse(".decl p(x: number) p(1).")?;
    /// let other = Program::parse(".decl p(x: number) p(2).")?;
    /// let mut file = Vec::new();
    /// program.session().save(&mut file)?;
    /// let error = other.load_session(&mut &file[..], Limits::default()).unwrap_err();
    /// assert_eq!(error.to_string(), "the saved session is one of another program");
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// If the input cannot be read, is no saved session of this program or is damaged, or if the session takes more
    /// memory than the limit.
    pub fn load_session(&self, input: &mut dyn Read, limits: Limits) -> Result<Session, SnapshotError> {
        let mut decoder = Decoder::new(input, &fingerprint(&self.0), limits.bytes)?;
        let symbols = Symbols::of_words(self.rules().symbols.word_size());
        let count = decoder.long()?;
        let mut text = String::new();
        for number in 0..count {
            decoder.room(1, SYMBOL_BYTES)?;
            decoder.text(&mut text)?;
            if u64::from(symbols.intern(&text).0) != number {
                return Err(SnapshotError::Corrupt);
            }
        }
        let own = &self.rules().symbols;
        let same = |id: u32| own.resolve(crate::symbol::Symbol(id)) == symbols.resolve(crate::symbol::Symbol(id));
        if !(0..own.len() as u32).all(same) {
            return Err(SnapshotError::Corrupt);
        }
        let known = symbols.len();
        let mut session = self.session_with(symbols);
        session.store.load(&mut decoder, self.rules(), known)?;
        session.history.load(&mut decoder, self.rules(), known)?;
        decoder.finish()?;
        session.set_limits(limits);
        Ok(session)
    }
}

/// Returns a digest of all that decides what the rows of a session mean: predicates, clauses, types and constants, and
/// how the planner stores rows.
fn fingerprint(compiled: &Compiled) -> Fingerprint {
    let Rules {
        types,
        predicates,
        clauses,
        symbols,
        functors,
        pasts,
        chance,
        ..
    } = &compiled.rules;
    let mut text = format!("{chance:?}\n");
    if symbols.word_size() == WordSize::Bits64 {
        text += "64 bits\n";
    }
    let mut hash = Sha256::new();
    // Writing to a string cannot fail.
    for (ty, id) in types.iter().zip(0..) {
        let _ = writeln!(
            text,
            "type {id} {:?} {:?} {:?} {:?} {:?}",
            ty.name, ty.base, ty.parent, ty.members, ty.shapes
        );
    }
    for (predicate, id) in predicates.iter().zip((0..).map(PredicateId)) {
        let columns: Vec<_> = predicate
            .columns
            .iter()
            .map(|column| (column.ty, column.base))
            .collect();
        let _ = writeln!(
            text,
            "predicate {:?} {columns:?} {} {:?} {} {} {:?} {:?} {:?} {:?} {} {}",
            predicate.name,
            predicate.input,
            predicate.edb,
            predicate.derived,
            predicate.parameters,
            predicate.choices,
            predicate.subsumption,
            predicate.numbering,
            predicate.size_limit,
            compiled.plans.indexes.arity(id),
            compiled.plans.indexes.is_grouped(id),
        );
    }
    for functor in functors.iter() {
        let arguments: Vec<_> = functor
            .arguments
            .iter()
            .map(|column| (column.ty, column.base))
            .collect();
        let _ = writeln!(text, "functor {:?} {arguments:?} {:?}", functor.name, functor.result);
    }
    let _ = writeln!(text, "{pasts:?}");
    for id in 0..symbols.len() as u32 {
        let _ = writeln!(text, "{:?}", symbols.resolve(crate::symbol::Symbol(id)));
    }
    let atom = |Atom { predicate, terms, .. }: &Atom| format!("{predicate:?}{terms:?}");
    for clause in clauses {
        hash.update(&text);
        text.clear();
        let _ = write!(text, "clause {}", atom(&clause.head));
        for literal in &clause.body {
            let _ = match literal {
                Literal::Positive(of) => write!(text, " + {}", atom(of)),
                Literal::Negative(of) => write!(text, " - {}", atom(of)),
                Literal::Guard(of) => write!(text, " ? {}", atom(of)),
                Literal::Compare {
                    op,
                    left,
                    right,
                    base,
                    span: _,
                } => write!(text, " {op:?} {left:?} {right:?} {base:?}"),
                Literal::Compute {
                    to,
                    functor,
                    base,
                    arguments,
                    span: _,
                } => write!(text, " {to:?} {functor:?} {base:?} {arguments:?}"),
                Literal::Aggregate {
                    to,
                    op,
                    base,
                    atom: of,
                    column,
                } => write!(text, " {to:?} {op:?} {base:?} {} {column:?}", atom(of)),
            };
        }
        text.push('\n');
    }
    hash.update(&text);
    hash.finalize().into()
}
