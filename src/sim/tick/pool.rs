//! Pools of threads, with diagnostics.

use crate::diag::{self, Diagnostic};
use crate::threads::Pool;
use rayon::ThreadPool;
use std::io;
use std::sync::{Arc, mpsc};
use std::time::Duration;

/// Starts a thread pool; `None` for a single thread.
///
/// # Errors
/// `limit-exceeded` if the threads cannot be started.
pub(crate) fn start_threads(threads: usize) -> Result<Option<Pool>, Diagnostic> {
    let pool = (threads > 1).then(|| Pool::new(threads));
    pool.transpose().map_err(|error| no_threads(threads, &error))
}

/// Returns the threads of a pool. A forked process starts them on its first call.
///
/// # Errors
/// `limit-exceeded` if the threads cannot be started.
pub(crate) fn threads_of(pool: Option<&Pool>) -> Result<Option<Arc<ThreadPool>>, Diagnostic> {
    let threads = |pool: &Pool| pool.threads().map_err(|error| no_threads(pool.count(), &error));
    pool.map(threads).transpose()
}

fn no_threads(count: usize, error: &io::Error) -> Diagnostic {
    let message = format!("{count} threads cannot be started: {error}");
    Diagnostic::new(diag::codes::LIMIT_EXCEEDED, message).help("use fewer threads")
}

/// The interval between polls of the thread that waits for a pool.
const POLL_INTERVAL: Duration = Duration::from_millis(50);

/// Runs work in a pool while the calling thread waits and calls `poll`. Some callbacks work on the calling thread only;
/// for example, Python checks for signals on its main thread.
pub(crate) fn run_polled<R: Send>(pool: &ThreadPool, poll: &(dyn Fn() + Sync), work: impl FnOnce() -> R + Send) -> R {
    let (done, result) = mpsc::channel();
    let received = pool.in_place_scope(|scope| {
        scope.spawn(move |_| done.send(work()).expect("the caller waits for it"));
        loop {
            match result.recv_timeout(POLL_INTERVAL) {
                Err(mpsc::RecvTimeoutError::Timeout) => poll(),
                received => break received,
            }
        }
    });
    received.expect("the scope resumes a panic of the work")
}
