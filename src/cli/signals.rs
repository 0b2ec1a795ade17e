//! Requests to end: Ctrl-C, SIGTERM and SIGHUP. The exit code is 128 plus the number of the signal, as in shells: 130,
//! 143 and 129. Windows has no SIGHUP.
//!
//! Every command ends at once on SIGTERM and SIGHUP. One that calls [`cancel`] stops its work instead, writes its
//! results and then ends; a second request ends it at once. A signal that the caller ignores, as `nohup` does, stays
//! ignored.

use crate::cancel::Cancel;
#[cfg(unix)]
use signal_hook::consts::SIGHUP;
use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::flag;
use std::io;
use std::os::raw::c_int;
use std::sync::Once;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

/// Whether the next request ends the process at once.
static AT_ONCE: AtomicBool = AtomicBool::new(false);

/// The number of the signal that a polling command got; 0 before.
static SIGNAL: AtomicUsize = AtomicUsize::new(0);

/// Makes SIGTERM and SIGHUP end the process with its code, also where the system ignores the default action, as for the
/// first process of a container.
pub fn end_at_once() {
    static LISTEN: Once = Once::new();
    AT_ONCE.store(true, Ordering::SeqCst);
    // Where this fails, the default action ends the process.
    LISTEN.call_once(|| {
        let _ = listen(SIGTERM);
        #[cfg(unix)]
        let _ = listen(SIGHUP);
    });
}

/// Returns a request that arrives when the user interrupts the command or the system asks it to end.
pub fn cancel() -> Cancel {
    static LISTEN: Once = Once::new();
    SIGNAL.store(0, Ordering::SeqCst);
    AT_ONCE.store(false, Ordering::SeqCst);
    LISTEN.call_once(|| drop(listen(SIGINT)));
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

/// Handles a signal for the whole life of the process.
fn listen(signal: c_int) -> io::Result<()> {
    if is_ignored(signal) {
        return Ok(());
    }
    let number = usize::try_from(signal).expect("signals have positive numbers");
    // In this order, so that the first request does not end a polling command at once.
    flag::register_conditional_shutdown(signal, 128 + signal, &AT_ONCE)?;
    flag::register_usize(signal, &SIGNAL, number)?;
    flag::register(signal, &AT_ONCE).map(drop)
}

/// Returns whether the caller of this process made it ignore a signal, which only Linux shows.
fn is_ignored(signal: c_int) -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let mask = mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok());
    mask.is_some_and(|mask| mask >> (signal - 1) & 1 == 1)
}
