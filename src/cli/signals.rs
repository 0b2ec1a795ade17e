//! Requests to end: Ctrl-C, SIGTERM and SIGHUP. The exit code is 128 plus the number of the signal, as in shells: 130,
//! 143 and 129. Windows has no SIGHUP.
//!
//! Every command ends at once, without its temporary files. One that calls [`cancel`] stops its work instead, writes its
//! results and then ends; a second request ends it at once. A signal that the caller ignores, as `nohup` does, stays
//! ignored.

use crate::cancel::Cancel;
#[cfg(unix)]
use crate::files;
#[cfg(unix)]
use signal_hook::consts::SIGHUP;
use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::flag;
#[cfg(unix)]
use signal_hook::{iterator::Signals, low_level};
use std::io;
use std::os::raw::c_int;
use std::sync::Once;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

/// Whether the next request ends the process at once.
static AT_ONCE: AtomicBool = AtomicBool::new(false);

/// The number of the signal that a polling command got; 0 before.
static SIGNAL: AtomicUsize = AtomicUsize::new(0);

/// Makes requests end the process at once with their code, also where the system ignores the default action, as for the
/// first process of a container.
pub fn end_at_once() {
    static LISTEN: Once = Once::new();
    AT_ONCE.store(true, Ordering::SeqCst);
    // Where this fails, the default action ends the process.
    LISTEN.call_once(|| drop(listen()));
}

/// Returns a request that arrives when the user interrupts the command or the system asks it to end.
pub fn cancel() -> Cancel {
    SIGNAL.store(0, Ordering::SeqCst);
    AT_ONCE.store(false, Ordering::SeqCst);
    Cancel::when(|| SIGNAL.load(Ordering::Relaxed) != 0)
}

/// Returns the exit code of an interrupted command.
pub fn code() -> u8 {
    let signal = match SIGNAL.load(Ordering::SeqCst) {
        0 => SIGINT.unsigned_abs() as usize,
        signal => signal,
    };
    128 + u8::try_from(signal).unwrap_or(0)
}

/// Handles requests for the whole life of the process, on a thread: a handler of a signal must not remove files.
///
/// A request ends the process without that thread if it has not noticed the one before: it may wait for a file system,
/// and a forked process has no such thread.
#[cfg(unix)]
fn listen() -> io::Result<()> {
    static UNNOTICED: AtomicBool = AtomicBool::new(false);
    let masks = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let handled = [SIGINT, SIGTERM, SIGHUP].into_iter().filter(|&signal| {
        // Python restores its own handler of Ctrl-C only if a command runs on its main thread.
        let is_of_python = signal == SIGINT && is_in(&masks, "SigCgt:", signal);
        !is_of_python && !is_in(&masks, "SigIgn:", signal)
    });
    let mut signals = Signals::new([0; 0])?;
    let handle = signals.handle();
    std::thread::Builder::new().spawn(move || {
        for signal in signals.forever() {
            UNNOTICED.store(false, Ordering::SeqCst);
            if AT_ONCE.swap(true, Ordering::SeqCst) {
                files::without_temporaries(|| {
                    // A shell leaves its loop only if Ctrl-C ends a command by the signal itself.
                    if signal == SIGINT && SIGNAL.load(Ordering::SeqCst) == 0 {
                        let _ = low_level::emulate_default_handler(signal);
                    }
                    low_level::exit(128 + signal)
                })
            }
            SIGNAL.store(signal.unsigned_abs() as usize, Ordering::SeqCst);
        }
    })?;
    for signal in handled {
        // In this order, so that the thread notices the first request, and it does not end the process.
        flag::register_conditional_shutdown(signal, 128 + signal, &UNNOTICED)?;
        flag::register(signal, &UNNOTICED)?;
        handle.add_signal(signal)?;
    }
    Ok(())
}

/// Handles requests for the whole life of the process. Temporary files remain; the next command removes them.
#[cfg(windows)]
fn listen() -> io::Result<()> {
    for signal in [SIGINT, SIGTERM] {
        // In this order, so that the first request does not end a polling command at once.
        flag::register_conditional_shutdown(signal, 128 + signal, &AT_ONCE)?;
        flag::register_usize(signal, &SIGNAL, signal.unsigned_abs() as usize)?;
        flag::register(signal, &AT_ONCE)?;
    }
    Ok(())
}

/// Returns whether a signal is in a mask of `/proc/self/status`, which only Linux has.
#[cfg(unix)]
fn is_in(masks: &str, name: &str, signal: c_int) -> bool {
    let mask = masks.lines().find_map(|line| line.strip_prefix(name));
    let mask = mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok());
    mask.is_some_and(|mask| mask >> (signal - 1) & 1 == 1)
}
