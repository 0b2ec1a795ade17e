//! Recorded runs of the published simulator. They are large and not part of the repository.

mod decisions;
mod moves;

use std::io::Write;
use std::path::PathBuf;

/// The folder that the environment variable `LOGICITY_CASES` names, else `../shared/cases` beside the repository. Without it,
/// says so; the caller checks nothing.
pub fn folder() -> Option<PathBuf> {
    let folder = std::env::var_os("LOGICITY_CASES").map_or_else(
        || PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../shared/cases"),
        PathBuf::from,
    );
    if folder.is_dir() {
        return Some(folder);
    }
    // Not `eprintln!`, whose output is hidden when a test passes.
    let _ = writeln!(
        std::io::stderr(),
        "SKIPPED: no recorded cases in {} (the environment variable LOGICITY_CASES names another folder)",
        folder.display()
    );
    None
}
