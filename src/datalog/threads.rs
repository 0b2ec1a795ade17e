//! Pools of threads that a forked process can use.
//!
//! A forked process has a copy of each pool, but not its threads: work that it sends to the copy never ends. A [`Pool`]
//! notices that the process has changed, and starts new threads. Only this module starts pools.

use rayon::{ThreadPool, ThreadPoolBuilder};
use std::io;
use std::mem::forget;
use std::sync::{Arc, Mutex, PoisonError};

/// Starts a pool of `count` threads for use within one call; 0 means one per core.
///
/// # Errors
/// If the operating system cannot start the threads.
pub fn start(count: usize) -> io::Result<ThreadPool> {
    let pool = ThreadPoolBuilder::new().num_threads(count).build();
    pool.map_err(io::Error::other)
}

/// A pool of threads that outlives a call.
#[derive(Debug)]
pub struct Pool {
    count: usize,
    started: Mutex<Started>,
}

impl Pool {
    /// Starts `count` threads, at least one.
    ///
    /// # Errors
    /// If the operating system cannot start them.
    pub fn new(count: usize) -> io::Result<Pool> {
        let started = Started::new(count)?;
        Ok(Pool {
            // rayon may start fewer threads than requested.
            count: started.pool.current_num_threads(),
            started: Mutex::new(started),
        })
    }

    /// Returns the number of threads.
    pub fn count(&self) -> usize {
        self.count
    }

    /// Returns the threads of this process. Starts them first if the process was forked since the last call.
    ///
    /// # Errors
    /// If the operating system cannot start them.
    pub fn threads(&self) -> io::Result<Arc<ThreadPool>> {
        let mut started = self.started.lock().unwrap_or_else(PoisonError::into_inner);
        if started.process != process() {
            *started = Started::new(self.count)?;
        }
        Ok(Arc::clone(&started.pool))
    }
}

/// The threads of one process.
#[derive(Debug)]
struct Started {
    process: u32,
    pool: Arc<ThreadPool>,
}

impl Started {
    fn new(count: usize) -> io::Result<Started> {
        Ok(Started {
            process: process(),
            pool: Arc::new(start(count.max(1))?),
        })
    }
}

impl Drop for Started {
    /// Keeps the pool of another process in memory: to end its threads could wait for a lock that one of them held
    /// during the fork.
    fn drop(&mut self) {
        if self.process != process() {
            forget(Arc::clone(&self.pool));
        }
    }
}

/// Returns the number of this process; only Unix can fork.
fn process() -> u32 {
    if cfg!(unix) { std::process::id() } else { 0 }
}
