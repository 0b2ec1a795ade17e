//! The configurations of open rule files: those beside them.

use crate::config::load_scenario;
use crate::diag::Sources;
use crate::files::{ReadFile, normalize};
use crate::sim::CityTheory;
use std::collections::HashMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::time::SystemTime;

/// A configuration with the texts that its places refer to.
pub struct City {
    pub sources: Sources,
    pub theory: CityTheory,
}

/// The cities of rule files, which are read again when a configuration in the folder changes.
#[derive(Default)]
pub struct Cities(HashMap<PathBuf, (Vec<Stamp>, Option<Rc<City>>)>);

/// A file with the time of its last change.
type Stamp = (PathBuf, Option<SystemTime>);

/// The most configurations that the server reads, and the most bytes of each.
const FILES_MAX: usize = 64;
const BYTES_MAX: u64 = 64 << 10;

impl Cities {
    /// Returns the city of the first configuration in the folder of a rule file that names this file.
    pub fn of(&mut self, rules: &Path, read: &dyn ReadFile) -> Option<Rc<City>> {
        let stamps = configurations(rules.parent()?);
        if let Some((known, city)) = self.0.get(rules)
            && *known == stamps
        {
            return city.clone();
        }
        let name = rules.file_name()?.to_string_lossy().into_owned();
        let open = |(path, _): &Stamp| {
            let text = fs::read_to_string(path).ok()?;
            if !text.contains(&name) {
                return None;
            }
            let mut sources = Sources::new();
            let scenario = load_scenario(&mut sources, path, read).ok()?;
            let is_same = normalize(&scenario.rules.value) == normalize(rules);
            let theory = is_same.then(|| CityTheory::new(scenario).ok()).flatten()?;
            Some(Rc::new(City { sources, theory }))
        };
        let city = stamps.iter().find_map(open);
        self.0.insert(rules.to_owned(), (stamps, city.clone()));
        city
    }
}

/// Returns the configurations in a folder, by name.
fn configurations(folder: &Path) -> Vec<Stamp> {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let stamp = |entry: fs::DirEntry| {
        let path = entry.path();
        let is_yaml = path.extension().is_some_and(|end| end == "yaml" || end == "yml");
        let data = is_yaml.then(|| fs::metadata(&path).ok()).flatten()?;
        (data.is_file() && data.len() <= BYTES_MAX).then(|| (path, data.modified().ok()))
    };
    let mut stamps: Vec<Stamp> = entries.filter_map(stamp).collect();
    stamps.sort();
    stamps.truncate(FILES_MAX);
    stamps
}
