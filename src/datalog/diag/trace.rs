//! Diagnostics at places that users wrote.

use crate::diag::source::{Expansion, MacroUse, Origin};
use crate::diag::{Code, Diagnostic, Label, SourceId, Sources, Span};
use std::collections::HashSet;
use std::ops::Range;

/// The number of macros to name, the innermost first, where one stands in the definition of another.
const MACROS_SHOWN: usize = 3;

/// The number of characters of an expansion to show.
const EXPANSION_SHOWN: usize = 100;

impl Sources {
    /// Returns the diagnostic with places that the user wrote. Macros and instances of components that its primary place
    /// comes from become labels of their own, and fixes of text that a macro wrote are dropped.
    pub fn traced(&self, diagnostic: &Diagnostic) -> Diagnostic {
        let mut traced = diagnostic.clone();
        if let Some(label) = &diagnostic.primary {
            let mut source = label.span.source;
            while let Origin::Instance { of, made, label } = self.origin(source) {
                traced = traced.also(*made, label.clone());
                source = *of;
            }
            if let Origin::Expanded(expansion) = self.origin(source) {
                traced = self.in_expansion(traced, source, expansion, label.span.range());
            }
        }
        let mut labels: Vec<&mut Label> = traced.primary.iter_mut().chain(&mut traced.secondary).collect();
        for label in &mut labels {
            label.span = self.written(label.span);
        }
        let exact = |span: &Span| {
            let source = self.base(span.source);
            match self.origin(source) {
                Origin::Expanded(expansion) => expansion
                    .part(span.start as usize)
                    .is_some_and(|(part, end)| part.copied && span.end <= end),
                _ => true,
            }
        };
        traced.fixes.retain(|fix| fix.edits.iter().all(|(span, _)| exact(span)));
        for (span, _) in traced.fixes.iter_mut().flat_map(|fix| &mut fix.edits) {
            *span = self.written(*span);
        }
        traced
    }

    /// Returns the diagnostics as [`traced`](Sources::traced) does. What says the same about one place of a component in
    /// several instances is there once.
    pub fn all_traced(&self, diagnostics: &[Diagnostic]) -> Vec<Diagnostic> {
        let mut known: HashSet<(Code, String, Span)> = HashSet::new();
        let mut all = Vec::with_capacity(diagnostics.len());
        for diagnostic in diagnostics {
            let traced = self.traced(diagnostic);
            let source = diagnostic.primary.as_ref().map(|label| label.span.source);
            let in_instance = source.is_some_and(|source| matches!(self.origin(source), Origin::Instance { .. }));
            let place = traced.primary.as_ref().filter(|_| in_instance).map(|label| label.span);
            if place.is_none_or(|place| known.insert((traced.code, traced.message.clone(), place))) {
                all.push(traced);
            }
        }
        all
    }

    /// Adds the macros whose expansion contains a range of the expanded source `id`.
    fn in_expansion(
        &self,
        mut fault: Diagnostic,
        id: SourceId,
        expansion: &Expansion,
        range: Range<usize>,
    ) -> Diagnostic {
        let used = expansion.part(range.start).and_then(|(part, _)| part.used);
        let last = expansion.part(range.end.max(range.start + 1) - 1);
        let (Some(used), Some(last)) = (used, last.and_then(|(part, _)| part.used)) else {
            return fault;
        };
        let chain = |from: u32| {
            std::iter::successors(Some(from), |&used| expansion.uses[used as usize].within).collect::<Vec<u32>>()
        };
        let (chain, other) = (chain(used), chain(last));
        let (Some(&outer), true) = (chain.last(), chain.last() == other.last()) else {
            return fault;
        };
        for &used in chain.iter().take(MACROS_SHOWN) {
            let MacroUse { name, definition, .. } = &expansion.uses[used as usize];
            fault = fault.also(
                *definition,
                format!("in the expansion of the macro `{name}`, defined here"),
            );
        }
        let MacroUse { name, text, .. } = &expansion.uses[outer as usize];
        let words: Vec<&str> = self.text(id)[text.clone()].split_whitespace().collect();
        let text = words.join(" ");
        let text = match text.char_indices().nth(EXPANSION_SHOWN) {
            Some((cut, _)) => format!("{}...", &text[..cut]),
            None => text,
        };
        fault.note(format!("`{name}` expands to `{text}`"))
    }
}
