//! logicity in a web worker: checks rules as they are typed, and runs a city under them.
//!
//! The page holds two workers with an instance of this module each. One calls [`check`], which may take seconds for
//! costly rules. The other one calls [`City`]. Results are JSON. Long work ends at a deadline with a diagnostic, so
//! neither worker hangs; the page restarts a worker that fails.
// Decision: docs/decisions/tools.md#d052

use logicity::builtin::{self, BuiltinFiles, ReadWith};
use logicity::cancel::Cancel;
use logicity::city::{Agent, Split};
use logicity::config::codes;
use logicity::diag::{self, Diagnostic, Sources, render, to_json};
use logicity::files::{BUILTIN_FOLDER, ReadError, ReadFile};
use logicity::page::{LIVE_TICKS, Live};
use logicity::render::{Difficulty, Icons};
use logicity::rng::Seed;
use logicity::sim::{
    CityTheory, LoadError, LoadedCity, Settings, Simulation, World, conflict_lints, conflicts, examine,
};
use logicity::yaml;
use serde_json::{Value, json};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use wasm_bindgen::prelude::*;

/// The modes, by the names of their configurations, with the line that describes each.
const MODES: [(&str, &str); 9] = [
    ("easy", "Safe Path Following, easy"),
    ("medium", "Safe Path Following, medium"),
    ("hard", "Safe Path Following, hard"),
    ("expert", "Safe Path Following, expert"),
    ("transfer-easy", "transfer, easy"),
    ("transfer-medium", "transfer, medium"),
    ("transfer-hard", "transfer, hard"),
    ("vap-easy", "Visual Action Prediction, easy"),
    ("vap-hard", "Visual Action Prediction, hard"),
];

/// The name of the edited file.
const FILE: &str = "rules.dl";

/// The time limit of the work of one call, in milliseconds.
const TIME_MAX: f64 = 3000.0;

#[wasm_bindgen]
extern "C" {
    #[wasm_bindgen(js_namespace = performance)]
    fn now() -> f64;
    #[wasm_bindgen(js_namespace = globalThis, js_name = reportPanic)]
    fn report_panic(message: &str);
}

/// Makes panics report their message and place to the page.
#[wasm_bindgen(start)]
pub fn start() {
    std::panic::set_hook(Box::new(|info| report_panic(&info.to_string())));
}

/// The time when the current call must end, as the bits of a number of milliseconds.
static DEADLINE: AtomicU64 = AtomicU64::new(0);

/// Starts the clock of a call, and returns the request to stop at its end.
fn deadline() -> Cancel {
    DEADLINE.store((now() + TIME_MAX).to_bits(), Ordering::Relaxed);
    Cancel::when(|| now() > f64::from_bits(DEADLINE.load(Ordering::Relaxed)))
}

/// Returns the modes as JSON: name, description, and rules in one file.
#[wasm_bindgen]
pub fn modes() -> String {
    let modes = MODES.map(|(name, about)| json!({"name": name, "about": about, "rules": rules_of(name)}));
    json!(modes).to_string()
}

/// Returns the rules of a mode with the included files in place, apart from the vocabulary.
fn rules_of(mode: &str) -> String {
    let mut text = String::new();
    append(&mut text, &format!("{mode}.dl"));
    text
}

/// Appends a file. The first lines of an included file describe another mode, so they are left out.
fn append(text: &mut String, file: &str) {
    let is_included = !text.is_empty();
    for line in builtin::text(&format!("rules/{file}")).unwrap_or_default().lines() {
        let included = line.strip_prefix(".include \"").and_then(|rest| rest.strip_suffix('"'));
        match included {
            Some("vocabulary.dl") => text.push_str(".include \"vocabulary.dl\"\n"),
            Some(file) => append(text, file),
            None if is_included && line.starts_with("// ") => {}
            None => {
                text.push_str(line);
                text.push('\n');
            }
        }
    }
}

/// Diagnostics, and whether the rules can be used.
fn report(diagnostics: &[Diagnostic], sources: &Sources) -> Value {
    let rendered: Vec<String> = (diagnostics.iter())
        .map(|one| render(std::slice::from_ref(one), sources, false))
        .collect();
    json!({
        "ok": !diagnostics.iter().any(Diagnostic::is_error),
        "diagnostics": to_json(diagnostics, sources),
        "rendered": rendered,
    })
}

/// Loads a mode with the edited rules. Nothing is read from a disk.
fn load(mode: &str, rules: &str, sources: &mut Sources) -> Result<LoadedCity, Vec<Diagnostic>> {
    let files = ReadWith(|path: &Path| match path {
        path if path == Path::new(FILE) => Ok(rules.to_owned()),
        path if path.starts_with(BUILTIN_FOLDER) => BuiltinFiles.read(path),
        _ => Err(ReadError::NotFound),
    });
    let config = Path::new(BUILTIN_FOLDER).join(format!("configs/{mode}.yaml"));
    LoadedCity::load(sources, &config, Some(Path::new(FILE)), &files).map_err(|error| match error {
        LoadError::Config(faults) | LoadError::Rules(faults) => faults,
        LoadError::RuleFile(path, error) => {
            vec![Diagnostic::new(
                codes::MISSING_FILE,
                format!("{}: {error}", path.display()),
            )]
        }
    })
}

/// Checks rules as `logicity check` does: errors, warnings, and conflicts between actions.
#[wasm_bindgen]
pub fn check(mode: &str, rules: &str) -> String {
    let mut sources = Sources::new();
    let found = match load(mode, rules, &mut sources) {
        Ok(city) => judge(city, &sources),
        Err(faults) => faults,
    };
    report(&found, &sources).to_string()
}

fn judge(city: LoadedCity, sources: &Sources) -> Vec<Diagnostic> {
    let LoadedCity {
        scenario,
        program,
        warnings: mut found,
        ..
    } = city;
    let theory = match CityTheory::new(scenario.clone()) {
        Ok(theory) => theory,
        Err(fault) => return vec![fault],
    };
    let examined = examine(program.rules(), Some(&theory), sources);
    found.extend(examined.diagnostics);
    match conflicts(&examined.in_city, &scenario.actions.table) {
        Ok(overlaps) => found.extend(conflict_lints(&overlaps, program.rules(), &scenario.actions)),
        Err(faults) => found.extend(faults),
    }
    found.extend(World::new(scenario, program).err().unwrap_or_default());
    found
}

/// A running city.
#[wasm_bindgen]
pub struct City {
    mode: String,
    live: Live,
}

/// The result of work that may fail: JSON, or a report as JSON.
type Outcome<T> = Result<T, String>;

fn failed(faults: &[Diagnostic], sources: &Sources) -> String {
    report(faults, sources).to_string()
}

/// Returns a city that begins a run, or continues one at a tick with these agents. One tick of a copy shows that the
/// rules can be evaluated in time.
fn run(mode: &str, rules: &str, seed: Seed, start: Option<(u64, Vec<Agent>)>) -> Outcome<Live> {
    let mut sources = Sources::new();
    let cancel = deadline();
    let city = load(mode, rules, &mut sources).map_err(|faults| failed(&faults, &sources))?;
    let rule_files = city.rule_files.clone();
    let world = Arc::new(city.world().map_err(|faults| failed(&faults, &sources))?);
    let settings = Settings {
        count_firings: true,
        ..Settings::default()
    };
    let begin = || {
        let split = Split::Test;
        let start = match start {
            Some(start) => start,
            None => {
                let first = Simulation::new_with(Arc::clone(&world), split, seed, settings, &cancel)?;
                (0, first.agents().to_vec())
            }
        };
        let resume = |start| Simulation::resume(Arc::clone(&world), split, seed, settings, start, &cancel);
        resume(start.clone())?.tick(&[])?;
        resume(start)
    };
    let simulation = begin().map_err(|fault| failed(&[timed(fault)], &sources))?;
    Live::new(simulation, sources, &rule_files).map_err(|fault| failed(&[fault], &Sources::new()))
}

/// Says why work was cancelled: only the deadline cancels.
fn timed(fault: Diagnostic) -> Diagnostic {
    match fault.code == diag::codes::CANCELLED {
        true => Diagnostic::new(
            diag::codes::LIMIT_EXCEEDED,
            format!("the rules take more than {} s", TIME_MAX / 1000.0),
        )
        .help("use fewer variables or more selective atoms"),
        false => fault,
    }
}

#[wasm_bindgen]
impl City {
    /// Begins a run of a mode under the edited rules.
    ///
    /// # Errors
    /// The report of the diagnostics, as JSON.
    #[wasm_bindgen(constructor)]
    pub fn new(mode: &str, rules: &str, seed: u64) -> Outcome<City> {
        Ok(City {
            live: run(mode, rules, Seed(seed), None)?,
            mode: mode.to_owned(),
        })
    }

    /// Continues the run at a recent tick under other rules. On error the city and its rules are unchanged.
    ///
    /// # Errors
    /// The report of the diagnostics, as JSON.
    pub fn change(&mut self, rules: &str, tick: u32) -> Outcome<()> {
        let seed = self.live.simulation().seed();
        let Some(agents) = self.live.agents_before(tick.into()) else {
            let fault = Diagnostic::new(
                yaml::codes::INVALID_VALUE,
                format!("tick {tick} is not one of the last"),
            );
            return Err(self.failed(fault));
        };
        self.live = run(&self.mode, rules, seed, Some((tick.into(), agents.to_vec())))?;
        Ok(())
    }

    /// Returns the map and the icons, as JSON.
    pub fn scenery(&self) -> String {
        let icons = Icons::new(self.live.simulation().seed(), Difficulty::default());
        json!(self.live.scenery(&icons)).to_string()
    }

    /// Returns names, agents, predicates and clauses, as JSON.
    pub fn header(&self) -> String {
        let mut header = json!(self.live.header());
        header["first"] = self.live.simulation().now().into();
        // The page lags behind the worker by some ticks.
        header["kept"] = (LIVE_TICKS - 100).into();
        header.to_string()
    }

    /// Runs a tick and returns it as JSON.
    ///
    /// # Errors
    /// The report of the diagnostics, as JSON. The city is unchanged.
    pub fn tick(&mut self) -> Outcome<String> {
        deadline();
        let tick = self.live.tick();
        Ok(json!(tick.map_err(|fault| self.failed(fault))?).to_string())
    }

    /// Explains what an agent did in a recent tick, as JSON; `null` for another tick or an unknown agent.
    ///
    /// # Errors
    /// The report of the diagnostics, as JSON.
    pub fn explain(&mut self, tick: u32, agent: usize) -> Outcome<String> {
        let explained = self.live.explain(tick.into(), agent);
        Ok(json!(explained.map_err(|fault| self.failed(fault))?).to_string())
    }

    fn failed(&self, fault: Diagnostic) -> String {
        failed(&[timed(fault)], self.live.sources())
    }
}
