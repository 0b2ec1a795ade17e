//! The configurations of open rule files: those in the same folder that have these rules, by themselves or from a base.

use crate::config::{Scenario, load_scenario};
use crate::diag::Sources;
use crate::files::{ReadError, ReadFile, normalize};
use crate::sim::CityTheory;
use std::cell::{OnceCell, RefCell};
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::time::SystemTime;

/// A configuration with the documents that its places refer to.
pub struct City {
    pub sources: Sources,
    pub theory: CityTheory,
}

/// The configurations beside open rule files, by path. They are read again when one of their files changes.
#[derive(Default)]
pub struct Cities(BTreeMap<PathBuf, Configuration>);

/// A configuration that was read.
struct Configuration {
    /// Its files, also those that could not be read.
    parts: BTreeMap<PathBuf, State>,
    /// What they define; `None` if it is faulty.
    content: Option<(Scenario, Sources)>,
    /// The city, once rules need it; `None` if the map cannot be generated.
    city: OnceCell<Option<Rc<City>>>,
}

/// The state of a file.
#[derive(PartialEq)]
enum State {
    /// The document in the editor.
    Open(String),
    /// The length of the file and the time of its last change; `None` if there is no such file.
    Saved(Option<(u64, Option<SystemTime>)>),
}

/// The content of an open file.
type OpenText<'o> = dyn Fn(&Path) -> Option<&'o str> + 'o;

/// The maximum number of configurations that the server reads in a folder.
const FILES_MAX: usize = 64;

/// The maximum number of bytes of each file of a configuration.
const BYTES_MAX: u64 = 1 << 20;

/// Returns whether a path is that of a configuration, or of a part of one.
pub fn is_configuration(path: &Path) -> bool {
    path.extension()
        .is_some_and(|ending| ending == "yaml" || ending == "yml")
}

impl Cities {
    /// Drops the configurations that lie beside none of these files.
    pub fn keep_beside<'p>(&mut self, files: impl Iterator<Item = &'p Path>) {
        let folders: BTreeSet<&Path> = files.filter_map(Path::parent).collect();
        self.0
            .retain(|path, _| path.parent().is_some_and(|folder| folders.contains(folder)));
    }

    /// Returns the city of the first configuration in the folder of a rule file that has these rules.
    pub fn of(&mut self, rules: &Path, read: &dyn ReadFile, open: &OpenText<'_>) -> Option<Rc<City>> {
        let rules = normalize(rules);
        let mut paths = configurations(rules.parent()?).into_iter();
        paths.find_map(|path| {
            if !self.0.get(&path).is_some_and(|known| known.is_current(open)) {
                self.0.insert(path.clone(), Configuration::read(&path, read, open));
            }
            self.0[&path].city(&rules)
        })
    }
}

impl Configuration {
    fn read(path: &Path, read: &dyn ReadFile, open: &OpenText<'_>) -> Configuration {
        let recorder = Recorder {
            files: read,
            paths: RefCell::default(),
        };
        let mut sources = Sources::new();
        let scenario = load_scenario(&mut sources, path, &recorder).ok();
        let parts = recorder.paths.into_inner().into_iter();
        Configuration {
            parts: parts.map(|path| (path.clone(), state(&path, open))).collect(),
            content: scenario.map(|scenario| (scenario, sources)),
            city: OnceCell::new(),
        }
    }

    /// Returns the city if it has these rules.
    fn city(&self, rules: &Path) -> Option<Rc<City>> {
        let (scenario, sources) = self.content.as_ref()?;
        let city = || {
            let theory = CityTheory::new(scenario.clone()).ok()?;
            let sources = sources.clone();
            Some(Rc::new(City { sources, theory }))
        };
        let is_same = normalize(&scenario.rules.value) == rules;
        is_same.then(|| self.city.get_or_init(city).clone()).flatten()
    }

    /// Returns whether no file of the configuration has changed.
    fn is_current(&self, open: &OpenText<'_>) -> bool {
        self.parts.iter().all(|(path, known)| state(path, open) == *known)
    }
}

/// Records which files are read, and refuses long ones.
struct Recorder<'r> {
    files: &'r dyn ReadFile,
    paths: RefCell<BTreeSet<PathBuf>>,
}

impl ReadFile for Recorder<'_> {
    fn read(&self, path: &Path) -> Result<String, ReadError> {
        self.paths.borrow_mut().insert(normalize(path));
        match fs::metadata(path).is_ok_and(|data| data.len() > BYTES_MAX) {
            true => Err(ReadError::TooLarge(BYTES_MAX)),
            false => self.files.read(path),
        }
    }

    fn builtin_paths(&self) -> Vec<String> {
        self.files.builtin_paths()
    }

    fn names_in(&self, folder: &Path) -> Vec<String> {
        self.files.names_in(folder)
    }
}

fn state(path: &Path, open: &OpenText<'_>) -> State {
    match open(path) {
        Some(text) => State::Open(text.to_owned()),
        None => State::Saved(fs::metadata(path).ok().map(|data| (data.len(), data.modified().ok()))),
    }
}

/// Returns the paths of the first configurations in a folder, by name.
fn configurations(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let paths = entries.map(|entry| entry.path());
    let mut paths: Vec<PathBuf> = paths.filter(|path| is_configuration(path) && path.is_file()).collect();
    paths.sort();
    paths.truncate(FILES_MAX);
    paths
}
