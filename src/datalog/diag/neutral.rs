//! Text of others on a terminal.

use std::borrow::Cow;
use std::fmt::Write;

/// Returns a text with escapes such as `\\u001b` in place of characters on which a terminal acts: controls other than
/// tabs and line breaks, and marks that reorder or break lines.
///
/// Prefixes map to prefixes: `neutral` of a prefix of a text is a prefix of `neutral` of the text.
pub fn neutral(text: &str) -> Cow<'_, str> {
    let Some(first) = text.find(is_active) else {
        return Cow::Borrowed(text);
    };
    let mut shown = text[..first].to_owned();
    for c in text[first..].chars() {
        if is_active(c) {
            let _ = write!(shown, "\\u{:04x}", u32::from(c));
        } else {
            shown.push(c);
        }
    }
    Cow::Owned(shown)
}

/// Returns whether a terminal acts on a character. The Python package escapes the same characters.
fn is_active(c: char) -> bool {
    match c {
        '\n' | '\t' => false,
        '\u{61c}' | '\u{200e}' | '\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{206f}' => true,
        '\u{fff9}'..='\u{fffb}' => true,
        c => c.is_control(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn active_characters_become_escapes() {
        assert_eq!(
            neutral("a\tb\nc\u{1b}[31m\u{202e}\u{9b}\r"),
            "a\tb\nc\\u001b[31m\\u202e\\u009b\\u000d"
        );
        assert!(matches!(neutral("東京 é\t\n"), Cow::Borrowed(_)));
        for c in (0..=u32::from(char::MAX)).filter_map(char::from_u32) {
            let text = c.to_string();
            assert!(!neutral(&text).chars().any(is_active));
            assert_eq!(neutral(&text) != text, is_active(c));
        }
    }
}
