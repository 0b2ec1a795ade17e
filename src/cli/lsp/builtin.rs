//! Copies of built-in files, which an editor can open.

use crate::files::{BUILTIN_FOLDER, Output, read_text};
use std::io::Write;
use std::path::{Path, PathBuf};

/// Returns the path of a read-only copy of a built-in file in the cache folder of the user, and writes it if it is
/// missing or differs. `None` if the file is not built in, or if the folder cannot be written.
pub fn copy(name: &Path, text: &str) -> Option<PathBuf> {
    let inside = name.strip_prefix(BUILTIN_FOLDER).ok()?;
    let path = folder()?.join(inside);
    if read_text(&path).as_deref() != Ok(text) {
        std::fs::create_dir_all(path.parent()?).ok()?;
        // An older copy is read-only.
        let _ = std::fs::remove_file(&path);
        let mut file = Output::edit(&path).ok()?;
        file.write_all(text.as_bytes()).ok()?;
        file.finish().ok()?;
        let mut permissions = std::fs::metadata(&path).ok()?.permissions();
        permissions.set_readonly(true);
        std::fs::set_permissions(&path, permissions).ok()?;
    }
    Some(path)
}

/// Returns `$XDG_CACHE_HOME/logicity/VERSION`, by default in `~/.cache`, and on Windows in `%LOCALAPPDATA%`.
pub fn folder() -> Option<PathBuf> {
    let named = |name: &str| {
        std::env::var_os(name)
            .map(PathBuf::from)
            .filter(|path| path.is_absolute())
    };
    let cache = named("XDG_CACHE_HOME");
    let cache = cache.or_else(|| named("LOCALAPPDATA").filter(|_| cfg!(windows)));
    let cache = cache.or_else(|| Some(std::env::home_dir()?.join(".cache")))?;
    Some(cache.join("logicity").join(env!("CARGO_PKG_VERSION")))
}
