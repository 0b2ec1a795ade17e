//! Standard output and standard error. Text of others cannot control the terminal: every command prints through this
//! module.

use crate::diag::neutral;
use crate::files::Output;
use indicatif::{ProgressBar, ProgressStyle};
use std::io::{self, IsTerminal, Write};
use std::thread;
use std::time::Duration;

/// Returns standard output for text that people read. It is always [`neutral`].
pub fn out() -> Screen<io::Stdout> {
    Screen::new(io::stdout(), true)
}

/// Returns standard error. It is always [`neutral`].
pub fn err() -> Screen<io::Stderr> {
    Screen::new(io::stderr(), true)
}

/// Returns standard output for data that programs read. A file or a pipe gets every byte; a terminal gets [`neutral`]
/// text.
pub fn data() -> Screen<io::Stdout> {
    Screen::new(io::stdout(), io::stdout().is_terminal())
}

/// Returns standard output for results that are data, such as JSON, or text for people.
pub fn results(are_data: bool) -> Screen<io::Stdout> {
    if are_data { data() } else { out() }
}

/// Returns whether messages have styles.
pub fn has_color() -> bool {
    anstream::AutoStream::choice(&io::stderr()) != anstream::ColorChoice::Never
}

/// Prints a line to standard error that is neutral except for styles.
pub fn print_styled(line: &str) {
    let _ = writeln!(io::stderr(), "{line}");
}

/// Shows a message on a terminal until `wait` returns.
#[cfg(feature = "repl")]
pub fn print_passing(message: &str, wait: impl FnOnce()) {
    let _ = write!(err(), "{message}");
    wait();
    // Erases the line.
    let _ = write!(io::stderr(), "\r\u{1b}[K");
}

/// Prints the message of a command line that does not parse, or help. It repeats arguments, which have no styles if
/// `is_plain`.
pub fn print_usage(error: &clap::Error, is_plain: bool) -> io::Result<()> {
    let text = error.render().ansi().to_string();
    match (is_plain, error.use_stderr()) {
        (true, true) => err().write_all(text.as_bytes())?,
        (true, false) => out().write_all(text.as_bytes())?,
        (false, _) => error.print()?,
    }
    // The end of the process would ignore that the last line cannot be written.
    io::stdout().flush()
}

/// Returns an output as it is, but neutral if it is a terminal.
pub fn screened(output: Output) -> Output {
    output.through(|stream, is_terminal| match is_terminal {
        true => Box::new(Screen::new(stream, true)),
        false => stream,
    })
}

/// Returns a progress bar.
pub fn progress(what: &str, count: u64) -> ProgressBar {
    let template = format!("{{bar:30}} {what} {{pos}} of {{len}}, {{eta}} left");
    let bar = ProgressBar::new(count).with_style(ProgressStyle::with_template(&template).expect("a valid template"));
    with_lines(bar, what)
}

/// The time between two lines of progress.
const BETWEEN_LINES: Duration = Duration::from_secs(30);

/// Returns a progress bar that writes lines instead if standard error is not a terminal: `what`, the position and the
/// length.
pub fn with_lines(bar: ProgressBar, what: &str) -> ProgressBar {
    if !io::stderr().is_terminal() {
        let (watched, what) = (bar.downgrade(), what.to_owned());
        // The thread ends with the bar or the process.
        thread::spawn(move || {
            loop {
                thread::sleep(BETWEEN_LINES);
                let Some(bar) = watched.upgrade().filter(|bar| !bar.is_finished()) else {
                    break;
                };
                let length = bar.length().filter(|length| *length > 0);
                let of = length.map_or_else(String::new, |length| format!(" of {length}"));
                if writeln!(err(), "{what} {}{of}", bar.position()).is_err() {
                    break;
                }
            }
        });
    }
    bar
}

/// A writer of text. Unless it is for data, the text is [`neutral`], and `U+FFFD` stands in place of bytes that are not
/// UTF-8, or of a character that is incomplete at the end.
pub struct Screen<W: Write> {
    inner: W,
    is_neutral: bool,
    /// The beginning of a character whose other bytes are not written yet.
    rest: Vec<u8>,
}

impl<W: Write> Screen<W> {
    fn new(inner: W, is_neutral: bool) -> Screen<W> {
        Screen {
            inner,
            is_neutral,
            rest: Vec::new(),
        }
    }
}

impl<W: Write> Write for Screen<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if !self.is_neutral {
            return self.inner.write(bytes);
        }
        let mut text = std::mem::take(&mut self.rest);
        text.extend_from_slice(bytes);
        self.rest = text.split_off(end_of_characters(&text));
        self.inner
            .write_all(neutral(&String::from_utf8_lossy(&text)).as_bytes())?;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        self.inner.flush()
    }
}

impl<W: Write> Drop for Screen<W> {
    fn drop(&mut self) {
        if !self.rest.is_empty() {
            // A drop cannot report an error.
            let _ = self.inner.write_all("\u{fffd}".as_bytes());
        }
    }
}

/// Returns where the last character begins if its bytes are incomplete, otherwise the end.
fn end_of_characters(text: &[u8]) -> usize {
    let last = text.len().saturating_sub(3)..text.len();
    let begins = last.rev().find(|&at| text[at] & 0xc0 != 0x80);
    let is_incomplete = |&at: &usize| match text[at] {
        0xc2..=0xdf => text.len() < at + 2,
        0xe0..=0xef => text.len() < at + 3,
        0xf0..=0xf4 => text.len() < at + 4,
        _ => false,
    };
    begins.filter(is_incomplete).unwrap_or(text.len())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn characters_may_be_written_in_parts() {
        let text = "a\u{1b}[2J\u{9b}\u{202e}東京😀\n";
        for size in 1..=text.len() {
            let (mut shown, mut exact) = (Vec::new(), Vec::new());
            let (mut screen, mut data) = (Screen::new(&mut shown, true), Screen::new(&mut exact, false));
            for part in text.as_bytes().chunks(size) {
                screen.write_all(part).expect("memory");
                data.write_all(part).expect("memory");
            }
            drop((screen, data));
            assert_eq!(
                String::from_utf8(shown).expect("text"),
                "a\\u001b[2J\\u009b\\u202e東京😀\n"
            );
            assert_eq!(exact, text.as_bytes());
        }
        let mut shown = Vec::new();
        Screen::new(&mut shown, true)
            .write_all(b"\x9b31m\xff\xf0\x9f")
            .expect("memory");
        assert_eq!(String::from_utf8(shown).expect("text"), "\u{fffd}31m\u{fffd}\u{fffd}");
    }
}
