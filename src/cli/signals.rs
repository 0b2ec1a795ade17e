//! Requests to end: Ctrl-C, SIGTERM and SIGHUP. The exit code is 128 plus the number of the signal, as in shells: 130,
//! 143 and 129.
//!
//! Every command ends at once on SIGTERM and SIGHUP. One that calls [`cancel`] stops its work instead, writes its
//! results and then ends; a second request ends it at once. A signal that the caller ignores, as `nohup` does, stays
//! ignored.

use crate::cancel::Cancel;

/// Makes SIGTERM and SIGHUP end the process with its code, also where the system ignores the default action, as for the
/// first process of a container.
pub fn end_at_once() {
    #[cfg(unix)]
    posix::end_at_once();
}

/// Returns a request that arrives when the user interrupts the command or the system asks it to end.
pub fn cancel() -> Cancel {
    #[cfg(unix)]
    return posix::cancel();
    #[cfg(not(unix))]
    Cancel::never()
}

/// Returns the exit code of an interrupted command.
pub fn code() -> u8 {
    #[cfg(unix)]
    return posix::code();
    #[cfg(not(unix))]
    130
}

#[cfg(unix)]
mod posix {
    use crate::cancel::Cancel;
    use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
    use signal_hook::flag;
    use std::io;
    use std::os::raw::c_int;
    use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
    use std::sync::{Arc, LazyLock, Once};

    /// The requests of this process. Its handlers stay for its whole life.
    static REQUESTS: LazyLock<Requests> = LazyLock::new(Requests::default);

    #[derive(Default)]
    struct Requests {
        /// Whether the next request ends the process at once.
        at_once: Arc<AtomicBool>,
        /// The number of the signal that a polling command got; 0 before.
        signal: Arc<AtomicUsize>,
    }

    impl Requests {
        fn listen(&self, signal: c_int) -> io::Result<()> {
            if is_ignored(signal) {
                return Ok(());
            }
            let number = usize::try_from(signal).expect("signals have positive numbers");
            // In this order, so that the first request does not end a polling command at once.
            flag::register_conditional_shutdown(signal, 128 + signal, Arc::clone(&self.at_once))?;
            flag::register_usize(signal, Arc::clone(&self.signal), number)?;
            flag::register(signal, Arc::clone(&self.at_once)).map(drop)
        }
    }

    pub fn end_at_once() {
        static LISTEN: Once = Once::new();
        REQUESTS.at_once.store(true, Ordering::SeqCst);
        // Where this fails, the default action ends the process.
        LISTEN.call_once(|| {
            [SIGTERM, SIGHUP]
                .into_iter()
                .for_each(|signal| drop(REQUESTS.listen(signal)))
        });
    }

    pub fn cancel() -> Cancel {
        static LISTEN: Once = Once::new();
        REQUESTS.signal.store(0, Ordering::SeqCst);
        REQUESTS.at_once.store(false, Ordering::SeqCst);
        LISTEN.call_once(|| drop(REQUESTS.listen(SIGINT)));
        Cancel::when(|| REQUESTS.signal.load(Ordering::Relaxed) != 0)
    }

    pub fn code() -> u8 {
        let signal = match REQUESTS.signal.load(Ordering::SeqCst) {
            0 => SIGINT.unsigned_abs() as usize,
            signal => signal,
        };
        128 + u8::try_from(signal).unwrap_or(0)
    }

    /// Returns whether the caller of this process made it ignore a signal, which only Linux shows.
    fn is_ignored(signal: c_int) -> bool {
        let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
        let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
        let mask = mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok());
        mask.is_some_and(|mask| mask >> (signal - 1) & 1 == 1)
    }
}
