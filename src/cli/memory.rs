//! The memory that this process may use: `--max-memory`, and what the system allows.
//!
//! Evaluations, readers and searches count their memory and report the place at which it runs out. [`watch`] bounds the
//! rest: it ends a process whose resident memory exceeds the limit nevertheless.
//!
//! An evaluation that the system stops for its memory ends without a message. So the default of `--max-memory` is below
//! the limits of the system, with room for what the evaluation does not count: the program itself, the stacks of
//! threads and address space that is reserved and not used.
// Decision: docs/decisions/safety.md#d021

use std::sync::OnceLock;
use std::thread;
use std::time::Duration;

/// A limit of the system on the memory of an evaluation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SystemLimit {
    /// The bytes that an evaluation may use.
    pub bytes: u64,
    /// The source of the limit, for messages.
    pub origin: &'static str,
}

/// The memory that this process needs besides what an evaluation counts.
const OVERHEAD: u64 = 32 << 20;

/// Returns the lowest limit of the system; `None` if there is none.
pub fn system_limit() -> Option<SystemLimit> {
    static LIMIT: OnceLock<Option<SystemLimit>> = OnceLock::new();
    *LIMIT.get_or_init(|| {
        let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
        let address_space = address_space_limit().map(|limit| SystemLimit {
            // Growing lists reserve address space beyond what they use.
            bytes: left(limit, in_status(&status, "VmSize:")) / 8 * 5,
            origin: "the limit on the address space of this process (`ulimit -v`)",
        });
        let group = control_group_limit().map(|limit| SystemLimit {
            bytes: left(limit, in_status(&status, "VmRSS:")) / 8 * 7,
            origin: "the memory limit of this process's control group",
        });
        address_space.into_iter().chain(group).min_by_key(|limit| limit.bytes)
    })
}

/// The resident memory beyond the limit at which [`watch`] ends the process: that of the program itself, and of
/// buffers of fixed size.
const BESIDES: u64 = 80 << 20;

/// The part of [`BESIDES`] that buffers may need, also in a process that was larger when its command began.
pub const BUFFERS: u64 = 32 << 20;

/// Calls `end` once the resident memory of this process exceeds `limit` by more than the program itself needs.
///
/// A thread reads the size, more often when less memory is left, so that even the fastest growth does not exceed the
/// limit by much between two readings. Works where `/proc/self/status` exists.
pub fn watch(limit: u64, end: impl FnOnce(u64) + Send + 'static) {
    /// The bytes by which a process may grow in a microsecond, with time to wake this thread on a busy machine.
    const GROWTH: u64 = 16 << 10;
    /// The shortest and the longest interval, in microseconds.
    const INTERVALS: (u64, u64) = (500, 250_000);
    let Some(begin) = resident() else { return };
    let most = limit.saturating_add(BESIDES.max(begin + BUFFERS));
    let until_exceeded = move || {
        while let Some(size) = resident() {
            match most.checked_sub(size) {
                Some(left) => thread::sleep(Duration::from_micros((left / GROWTH).clamp(INTERVALS.0, INTERVALS.1))),
                None => return end(size),
            }
        }
    };
    // If the system starts no thread, the counts alone bound the memory.
    let _ = thread::Builder::new().name("memory".into()).spawn(until_exceeded);
}

/// Returns the resident memory of this process in bytes, if the system reports it.
fn resident() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    Some(in_status(&status, "VmRSS:"))
}

/// Makes the process end with code 1 when memory cannot be allocated. Otherwise it aborts, after the same message.
///
/// The signal of an abort does not name its cause. Allocations fail only under a limit on the address space, so without
/// one every abort keeps its signal. After a panic it does, too: a panic during another one aborts.
pub fn exit_when_exhausted() {
    #[cfg(unix)]
    {
        use std::panic;
        use std::sync::Arc;
        use std::sync::atomic::{AtomicBool, Ordering};
        if address_space_limit().is_none() {
            return;
        }
        let no_panic = Arc::new(AtomicBool::new(true));
        let flag = Arc::clone(&no_panic);
        let print = panic::take_hook();
        panic::set_hook(Box::new(move |panic| {
            flag.store(false, Ordering::Relaxed);
            print(panic);
        }));
        // If this fails, the process aborts as it would without.
        let _ = signal_hook::flag::register_conditional_shutdown(signal_hook::consts::SIGABRT, 1, no_panic);
    }
}

/// The bytes that a limit leaves for an evaluation.
fn left(limit: u64, used: u64) -> u64 {
    limit.saturating_sub(used).saturating_sub(OVERHEAD)
}

#[cfg(unix)]
fn address_space_limit() -> Option<u64> {
    use nix::sys::resource::{RLIM_INFINITY, Resource, getrlimit};
    let (soft, _) = getrlimit(Resource::RLIMIT_AS).ok()?;
    (soft != RLIM_INFINITY).then_some(soft)
}

#[cfg(not(unix))]
fn address_space_limit() -> Option<u64> {
    None
}

/// Returns a size from the text of `/proc/self/status`, in bytes.
fn in_status(status: &str, key: &str) -> u64 {
    let line = status.lines().find_map(|line| line.strip_prefix(key));
    let number = line.and_then(|line| line.split_whitespace().next()?.parse().ok());
    number.unwrap_or(0_u64) << 10
}

/// Returns the lowest memory limit of the process's control group and the groups around it.
fn control_group_limit() -> Option<u64> {
    let groups = std::fs::read_to_string("/proc/self/cgroup").ok()?;
    let files = groups.lines().flat_map(limit_files);
    files
        .filter_map(|path| std::fs::read_to_string(path).ok()?.trim().parse().ok())
        .min()
}

/// Returns the files that may hold the limits that a line of `/proc/self/cgroup` names, from the innermost group out.
/// A line is `0::/path` in version 2 and `4:memory:/path` in version 1.
fn limit_files(line: &str) -> Vec<String> {
    let mut parts = line.splitn(3, ':').skip(1);
    let (Some(controllers), Some(path)) = (parts.next(), parts.next()) else {
        return Vec::new();
    };
    let (root, name) = match controllers {
        "" => ("/sys/fs/cgroup", "memory.max"),
        _ if controllers.split(',').any(|one| one == "memory") => ("/sys/fs/cgroup/memory", "memory.limit_in_bytes"),
        _ => return Vec::new(),
    };
    let mut path = path.trim_end_matches('/');
    let mut files = vec![format!("{root}{path}/{name}")];
    while let Some((outer, _)) = path.rsplit_once('/') {
        path = outer;
        files.push(format!("{root}{path}/{name}"));
    }
    files
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn limits_of_all_groups_around_the_process_are_read() {
        let files = [
            "/sys/fs/cgroup/a/b/memory.max",
            "/sys/fs/cgroup/a/memory.max",
            "/sys/fs/cgroup/memory.max",
        ];
        assert_eq!(limit_files("0::/a/b"), files);
        assert_eq!(limit_files("0::/"), ["/sys/fs/cgroup/memory.max"]);
        let files = [
            "/sys/fs/cgroup/memory/a/memory.limit_in_bytes",
            "/sys/fs/cgroup/memory/memory.limit_in_bytes",
        ];
        assert_eq!(limit_files("4:memory:/a"), files);
        assert!(limit_files("5:cpu:/a").is_empty() && limit_files("").is_empty());
    }

    #[test]
    fn sizes_of_the_process_are_read() {
        assert_eq!(in_status("Name:\tx\nVmSize:\t    2048 kB\n", "VmSize:"), 2 << 20);
        assert_eq!(in_status("", "VmSize:"), 0);
    }
}
