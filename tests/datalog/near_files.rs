//! Random variants of the files of the repository.

use crate::root::root;
use proptest::prelude::*;
use proptest::sample::Index;
use std::fs;
use std::sync::LazyLock;

/// The files of these folders and their subfolders.
pub fn files(folders: &[&str]) -> Vec<Vec<u8>> {
    let mut folders: Vec<_> = folders.iter().map(|folder| root().join(folder)).collect();
    let mut paths = Vec::new();
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).expect("a readable folder") {
            let path = entry.expect("a readable entry").path();
            if path.is_dir() { &mut folders } else { &mut paths }.push(path);
        }
    }
    paths.sort();
    assert!(!paths.is_empty());
    paths
        .iter()
        .map(|path| fs::read(path).expect("a readable file"))
        .collect()
}

/// One of the files with some bytes replaced, removed, doubled or inserted, and some lines swapped.
pub fn near(files: &'static LazyLock<Vec<Vec<u8>>>) -> impl Strategy<Value = Vec<u8>> {
    let edit = (any::<Index>(), any::<Index>(), 0..5u8, any::<u8>());
    (any::<Index>(), prop::collection::vec(edit, 0..8)).prop_map(|(file, edits)| {
        let mut bytes = file.get(files).clone();
        for (at, other, kind, byte) in edits {
            bytes.push(b'\n');
            let (at, other) = (at.index(bytes.len()), other.index(bytes.len()));
            match kind {
                0 => bytes[at] = byte,
                1 => drop(bytes.remove(at)),
                2 => bytes.insert(at, bytes[other]),
                3 => bytes.insert(at, byte % 128),
                _ => {
                    let mut lines: Vec<&[u8]> = bytes.split(|byte| *byte == b'\n').collect();
                    let count = lines.len();
                    lines.swap(at % count, other % count);
                    bytes = lines.join(&b'\n');
                }
            }
        }
        bytes
    })
}

/// A few bytes of any kind.
pub fn any_bytes() -> impl Strategy<Value = Vec<u8>> {
    prop::collection::vec(any::<u8>(), 0..300)
}
