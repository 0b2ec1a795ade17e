//! Messages over standard input and output. Their size is bounded, since a header can announce any length.

use crate::files;
use lsp_server::{Connection, ErrorCode, Message};
use serde_json::json;
use std::io::{self, BufRead, Read, Write};
use std::sync::{Arc, Mutex};
use std::thread::{self, JoinHandle};
use std::time::Duration;

/// The maximum size of a message: 64 MiB, like that of a rule file.
const MESSAGE_MAX: u64 = 64 << 20;
/// The maximum size of the header of a message.
const HEADER_MAX: u64 = 4096;
/// The number of unanswered messages above which the server stops reading.
const WAITING_MAX: usize = 64;

/// The threads that read and write.
pub struct Transport {
    writer: JoinHandle<io::Result<()>>,
    /// Why the reader stopped before the end of the input.
    fault: Arc<Mutex<Option<String>>>,
}

/// Starts the threads and connects them.
pub fn start() -> (Connection, Transport) {
    let (server, Connection { sender, receiver }) = Connection::memory();
    let fault = Arc::new(Mutex::new(None));
    let slot = Arc::clone(&fault);
    thread::spawn(move || {
        let mut input = io::stdin().lock();
        loop {
            let message = match read(&mut input) {
                Ok(None) => return,
                Ok(Some(bytes)) => serde_json::from_slice::<Message>(&bytes),
                Err(message) => {
                    refuse(ErrorCode::InvalidRequest, &message);
                    *slot.lock().expect("no thread panics with it") = Some(message);
                    return;
                }
            };
            let message = match message {
                Ok(message) => message,
                Err(error) => {
                    refuse(ErrorCode::ParseError, &format!("not a message: {error}"));
                    continue;
                }
            };
            let is_exit = matches!(&message, Message::Notification(message) if message.method == "exit");
            while sender.len() > WAITING_MAX {
                thread::sleep(Duration::from_millis(1));
            }
            if sender.send(message).is_err() || is_exit {
                return;
            }
        }
    });
    let writer = thread::spawn(move || {
        receiver.into_iter().try_for_each(|message| {
            let mut bytes = Vec::new();
            message.write(&mut bytes)?;
            write(&bytes)
        })
    });
    (server, Transport { writer, fault })
}

/// The time between two looks at the process of the editor.
const PARENT_POLL: Duration = Duration::from_secs(1);

/// Ends this process when another one ends: the editor, whose end may leave the connection open.
pub fn end_with(process: Option<u64>) {
    let Some(process) = process
        .and_then(|number| i32::try_from(number).ok())
        .filter(|number| *number > 0)
    else {
        return;
    };
    // In another container, the number may mean nothing here.
    if !is_alive(process) {
        return;
    }
    thread::spawn(move || {
        while is_alive(process) {
            thread::sleep(PARENT_POLL);
        }
        crate::files::end(1);
    });
}

#[cfg(unix)]
fn is_alive(process: i32) -> bool {
    let signalled = nix::sys::signal::kill(nix::unistd::Pid::from_raw(process), None);
    signalled != Err(nix::errno::Errno::ESRCH)
}

#[cfg(not(unix))]
fn is_alive(_: i32) -> bool {
    true
}

impl Transport {
    /// Waits until all messages are written. Returns why the connection failed, if it did.
    pub fn finish(self) -> Result<(), String> {
        let written = self.writer.join().expect("the thread does not panic");
        match self.fault.lock().expect("no thread panics with it").take() {
            Some(fault) => Err(fault),
            None => written.map_err(|error| error.to_string()),
        }
    }
}

fn write(bytes: &[u8]) -> io::Result<()> {
    let mut out = io::stdout().lock();
    out.write_all(bytes)?;
    out.flush()
}

/// Answers a message that cannot be read, and so has no id.
fn refuse(code: ErrorCode, message: &str) {
    let answer = json!({ "jsonrpc": "2.0", "id": null, "error": { "code": code as i32, "message": message } });
    let answer = answer.to_string();
    // A failure to write ends the writer, too.
    let _ = write(format!("Content-Length: {}\r\n\r\n{answer}", answer.len()).as_bytes());
}

/// Reads the content of a message, or `None` at the end of the input.
fn read(input: &mut impl BufRead) -> Result<Option<Vec<u8>>, String> {
    let fail = |error: io::Error| error.to_string();
    let mut header = input.by_ref().take(HEADER_MAX);
    let mut length: Option<u64> = None;
    loop {
        let mut line = Vec::new();
        header.read_until(b'\n', &mut line).map_err(fail)?;
        let Some(line) = line.strip_suffix(b"\r\n") else {
            return match line.is_empty() && header.limit() == HEADER_MAX {
                true => Ok(None),
                false => Err("the header of a message is malformed, truncated or too long".to_owned()),
            };
        };
        if line.is_empty() {
            break;
        }
        let line = String::from_utf8_lossy(line);
        let Some((name, value)) = line.split_once(':') else {
            return Err(format!("the header of a message is malformed: `{line}`"));
        };
        if name.eq_ignore_ascii_case("Content-Length") {
            let value = value.trim();
            let known = value.parse().ok().filter(|&length: &u64| length <= MESSAGE_MAX);
            let limit = MESSAGE_MAX >> 20;
            length = Some(known.ok_or_else(|| {
                format!("a message has the Content-Length `{value}`; expected a number of bytes, at most {limit} MiB")
            })?);
        }
    }
    let length = length.ok_or("the header of a message has no Content-Length")?;
    // The memory grows as the content arrives.
    let content = files::read_bytes(input.take(length)).map_err(|error| error.to_string())?;
    match content.len() as u64 == length {
        true => Ok(Some(content)),
        false => Err("the input ends within a message".to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn content(mut input: &[u8]) -> Result<Option<Vec<u8>>, String> {
        read(&mut input)
    }

    #[test]
    fn messages_are_bounded() {
        assert_eq!(content(b""), Ok(None));
        assert_eq!(content(b"Content-Length: 2\r\n\r\n{}rest"), Ok(Some(b"{}".to_vec())));
        assert_eq!(
            content(b"content-length:2\r\nContent-Type: x\r\n\r\n{}"),
            Ok(Some(b"{}".to_vec()))
        );
        let long = [b"X: ", &[b'x'; 5000][..]].concat();
        let faults: [(&[u8], &str); 8] = [
            (b"Content-Length: 99999999999999\r\n\r\n", "at most 64 MiB"),
            (b"Content-Length: -1\r\n\r\n", "`-1`"),
            (b"Content-Length: 99999999999999999999999\r\n\r\n", "at most 64 MiB"),
            (b"Content-Length: 5\r\n\r\n{}", "ends within"),
            (b"Content-Length: 5", "malformed"),
            (b"nonsense\r\n\r\n", "nonsense"),
            (b"\r\n", "no Content-Length"),
            (&long, "too long"),
        ];
        for (input, words) in faults {
            let fault = content(input).expect_err("it is malformed");
            assert!(fault.contains(words), "{fault}");
        }
    }
}
