//! Requests to end: Ctrl-C, SIGTERM and SIGHUP. The exit code is 128 plus the number of the signal, as in shells: 130,
//! 143 and 129. Windows has no SIGHUP.
//!
//! Every command removes its temporary files and ends at once; after Ctrl-C, by SIGINT itself. One that calls [`cancel`]
//! stops its work instead, writes its results and then ends; a second request ends it at once. A signal that the caller
//! ignores, as `nohup` does, stays ignored.

use crate::cancel::Cancel;
#[cfg(unix)]
use crate::files;
#[cfg(unix)]
use signal_hook::consts::SIGHUP;
use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::flag;
#[cfg(unix)]
use signal_hook::{
    iterator::{Handle, Signals},
    low_level,
};
use std::io;
use std::os::raw::c_int;
use std::sync::Once;
#[cfg(unix)]
use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

/// Whether the next request ends the process at once.
static AT_ONCE: AtomicBool = AtomicBool::new(false);

/// The number of the signal that a polling command got; 0 before.
static SIGNAL: AtomicUsize = AtomicUsize::new(0);

/// Ends the process on the next request, with its exit code, even where the system ignores the default action, as for
/// the first process of a container.
pub fn end_at_once() {
    static LISTEN: Once = Once::new();
    AT_ONCE.store(true, Ordering::SeqCst);
    // Where this fails, the default action ends the process.
    LISTEN.call_once(|| {
        let _ = listen(SIGTERM);
        #[cfg(unix)]
        let _ = listen(SIGHUP);
    });
    // Other systems do not show whether the caller ignores Ctrl-C, as a shell does for its background jobs.
    if cfg!(target_os = "linux") {
        listen_for_interrupts();
    }
}

/// Returns a request that arrives when the user interrupts the command or the system asks it to end.
pub fn cancel() -> Cancel {
    SIGNAL.store(0, Ordering::SeqCst);
    AT_ONCE.store(false, Ordering::SeqCst);
    listen_for_interrupts();
    Cancel::when(|| SIGNAL.load(Ordering::Relaxed) != 0)
}

/// Makes the next request end a forked process at once: it has no thread that handles requests.
pub fn end_forked() {
    #[cfg(unix)]
    UNNOTICED.store(true, Ordering::SeqCst);
}

fn listen_for_interrupts() {
    static LISTEN: Once = Once::new();
    LISTEN.call_once(|| drop(listen(SIGINT)));
}

/// Returns the exit code of an interrupted command.
pub fn code() -> u8 {
    let signal = match SIGNAL.load(Ordering::SeqCst) {
        0 => SIGINT.unsigned_abs() as usize,
        signal => signal,
    };
    128 + u8::try_from(signal).unwrap_or(0)
}

/// Whether the thread that handles requests has not noticed the last one yet.
#[cfg(unix)]
static UNNOTICED: AtomicBool = AtomicBool::new(false);

/// Handles a signal for the whole life of the process, on a thread, because a signal handler must not remove files. If
/// the thread has not noticed the previous request, the handler ends the process: the thread may wait for a file system.
#[cfg(unix)]
fn listen(signal: c_int) -> io::Result<()> {
    static HANDLE: OnceLock<Option<Handle>> = OnceLock::new();
    let masks = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    // Python restores its own handler of Ctrl-C only if a command runs on its main thread.
    let is_of_python = signal == SIGINT && is_in(&masks, "SigCgt:", signal);
    if is_of_python || is_in(&masks, "SigIgn:", signal) {
        return Ok(());
    }
    if let Some(handle) = HANDLE.get_or_init(|| handle_on_thread().ok()) {
        // In this order, so that the first request reaches the thread instead of ending the process.
        flag::register_conditional_shutdown(signal, 128 + signal, &UNNOTICED)?;
        flag::register(signal, &UNNOTICED)?;
        handle.add_signal(signal)?;
    }
    Ok(())
}

/// Starts the thread that handles requests.
#[cfg(unix)]
fn handle_on_thread() -> io::Result<Handle> {
    let mut signals = Signals::new([0; 0])?;
    let handle = signals.handle();
    std::thread::Builder::new().name("signals".into()).spawn(move || {
        for signal in signals.forever() {
            UNNOTICED.store(false, Ordering::SeqCst);
            if AT_ONCE.swap(true, Ordering::SeqCst) {
                files::without_temporaries(|| {
                    // A shell ends its loops only if Ctrl-C ends a command by the signal itself. The first process of a
                    // container cannot end so.
                    if signal == SIGINT && SIGNAL.load(Ordering::SeqCst) == 0 && std::process::id() != 1 {
                        let _ = low_level::emulate_default_handler(signal);
                    }
                    low_level::exit(128 + signal)
                })
            }
            SIGNAL.store(signal.unsigned_abs() as usize, Ordering::SeqCst);
        }
    })?;
    Ok(handle)
}

/// Handles a signal for the whole life of the process. Temporary files remain until the next command that writes to
/// their folder.
#[cfg(windows)]
fn listen(signal: c_int) -> io::Result<()> {
    // In this order, so that the first request does not end a polling command at once.
    flag::register_conditional_shutdown(signal, 128 + signal, &AT_ONCE)?;
    flag::register_usize(signal, &SIGNAL, signal.unsigned_abs() as usize)?;
    flag::register(signal, &AT_ONCE).map(drop)
}

/// Returns whether a signal is in a mask of `/proc/self/status`, which only Linux has.
#[cfg(unix)]
fn is_in(masks: &str, name: &str, signal: c_int) -> bool {
    let mask = masks.lines().find_map(|line| line.strip_prefix(name));
    let mask = mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok());
    mask.is_some_and(|mask| mask >> (signal - 1) & 1 == 1)
}
