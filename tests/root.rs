//! The folder of the repository.

use std::path::Path;

/// Returns the root of the repository: the folder of this crate or one above it.
pub fn root() -> &'static Path {
    let mut folders = Path::new(env!("CARGO_MANIFEST_DIR")).ancestors();
    let found = folders.find(|folder| folder.join("rust-toolchain.toml").is_file());
    found.expect("tests run in the repository")
}
