//! Cancellation: one type for requests to stop long work.
//!
//! A function that can be cancelled takes `cancel: &Cancel` as its last argument. If it also exists without that
//! argument, its name ends in `_with`: `commit` cannot be cancelled, `commit_with` can.
//!
//! ```
//! use logicity_datalog::cancel::Cancel;
//! use std::sync::Arc;
//! use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
//!
//! let interrupted = Arc::new(AtomicBool::new(false));
//! let flag = Arc::clone(&interrupted);
//! let cancel = Cancel::when(move || flag.load(Relaxed));
//! assert!(!cancel.requested());
//! interrupted.store(true, Relaxed);
//! assert!(cancel.requested());
//! ```
// Decision: docs/decisions/safety.md#d022

use std::fmt;
use std::sync::Arc;

type Requested = dyn Fn() -> bool + Send + Sync;

/// A request to stop long work, polled by the worker.
///
/// The callback should be cheap: workers poll up to some thousands of times per second, on the calling thread or on the
/// threads of a pool. Clones share it.
#[derive(Clone, Default)]
pub struct Cancel(Option<Arc<Requested>>);

impl Cancel {
    /// Returns a request that never arrives. Polling it costs one branch.
    pub const fn never() -> Cancel {
        Cancel(None)
    }

    /// Returns a request that arrives as soon as `requested` returns true.
    pub fn when(requested: impl Fn() -> bool + Send + Sync + 'static) -> Cancel {
        Cancel(Some(Arc::new(requested)))
    }

    /// Returns whether the work should stop now.
    #[inline]
    pub fn requested(&self) -> bool {
        self.0.as_ref().is_some_and(|requested| requested())
    }

    /// Returns whether the request comes from [`Cancel::never`], so that polling is pointless.
    #[inline]
    pub(crate) fn is_never(&self) -> bool {
        self.0.is_none()
    }
}

impl fmt::Debug for Cancel {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(if self.is_never() {
            "Cancel::never()"
        } else {
            "Cancel::when(..)"
        })
    }
}
