//! Loads a city: one call from the path of a configuration to a scenario with its compiled rules.
// Decision: docs/decisions/city.md#d002

use crate::config::{Scenario, load_scenario, rule_file};
use crate::datalog::codes::UNKNOWN_PREDICATE;
use crate::datalog::{Declaration, InputPolicy, Limits, Program, Workspace};
use crate::diag::{Diagnostic, SourceId, Sources, Span};
use crate::files::{ReadError, ReadFile};
use crate::located::Located;
use crate::sim::codes;
use crate::sim::tick::vocabulary::{base_of, declaration, other_declarations};
use crate::sim::tick::world::{TICK_LIMITS, World};
use crate::sim::trace::{TraceHeader, hash_sources};
use std::path::{Path, PathBuf};

/// A scenario and the program of its rules. [`LoadedCity::world`] joins them.
#[derive(Clone, Debug)]
pub struct LoadedCity {
    /// The configuration.
    pub scenario: Scenario,
    /// The rules.
    pub program: Program,
    /// The rule file, then the files it includes.
    pub rule_files: Vec<SourceId>,
    /// The hash of the rule files ([`hash_sources`]).
    pub rules_hash: String,
    /// The warnings of the rules.
    pub warnings: Vec<Diagnostic>,
    /// The limits of each evaluation of the rules by the relational executor; [`TICK_LIMITS`] after loading.
    pub limits: Limits,
}

/// Why a city cannot be loaded.
#[derive(Clone, Debug)]
pub enum LoadError {
    /// The configuration has errors. [`missing_file`](crate::config::missing_file) detects that it does not exist.
    Config(Vec<Diagnostic>),
    /// The rule file cannot be read.
    RuleFile(PathBuf, ReadError),
    /// The rules have errors.
    Rules(Vec<Diagnostic>),
}

impl LoadedCity {
    /// Loads a configuration and its rules and adds every file to `sources`. `rules` overrides the configured rule
    /// file.
    ///
    /// `config` is a path or the name of a built-in configuration, for example `expert`. A rule file that `files` does
    /// not find is looked up among the built-in files.
    ///
    /// # Errors
    /// See [`LoadError`].
    pub fn load(
        sources: &mut Sources,
        config: &Path,
        rules: Option<&Path>,
        files: &dyn ReadFile,
    ) -> Result<LoadedCity, LoadError> {
        let scenario = load_scenario(sources, config, files).map_err(LoadError::Config)?;
        LoadedCity::with_rules(sources, scenario, rules, files)
    }

    /// Loads the rules of a configuration, which `rules` overrides: a path, or a bare name such as `hard`. See
    /// [`LoadedCity::load`].
    ///
    /// # Errors
    /// [`LoadError::RuleFile`] and [`LoadError::Rules`].
    pub fn with_rules(
        sources: &mut Sources,
        mut scenario: Scenario,
        rules: Option<&Path>,
        files: &dyn ReadFile,
    ) -> Result<LoadedCity, LoadError> {
        let rules = rules.map(|path| rule_file(path, files));
        let path = rules.as_ref().unwrap_or(&scenario.rules.value).clone();
        let text = match &rules {
            Some(path) => files.read_or_builtin(path),
            // The configuration names it, and has found it.
            None => files.read(&path),
        };
        let text = text.map_err(|error| LoadError::RuleFile(path.clone(), error))?;
        let entry = sources.add(path.display().to_string(), text);
        let mut workspace = Workspace::new(InputPolicy::Fixed);
        workspace.add(sources, entry, files);
        let declared = workspace.declared();
        let loaded = workspace.into_checked();
        let mut diagnostics = loaded.diagnostics;
        let program = loaded.rules.map(Program::new).transpose();
        let Some(program) = program.unwrap_or_else(|fault| {
            diagnostics.push(fault);
            None
        }) else {
            help_to_declare(&mut diagnostics, sources, (&declared, &scenario));
            return Err(LoadError::Rules(diagnostics));
        };
        if rules.is_some() {
            // A mismatch is reported in the rule file that the caller named, not in the configuration.
            let span = Span::new(entry, 0..0);
            scenario.rules = Located { value: path, span };
        }
        let rule_files: Vec<SourceId> = sources.ids().skip_while(|&id| id != entry).collect();
        Ok(LoadedCity {
            scenario,
            program,
            rules_hash: hash_sources(sources, &rule_files),
            rule_files,
            warnings: diagnostics,
            limits: TICK_LIMITS,
        })
    }

    /// Loads the city of a trace: the configuration and the rules in its header, or `config` and `rules` from `files`
    /// instead. Opens no file that the trace names. Otherwise like [`LoadedCity::load`].
    ///
    /// # Errors
    /// See [`LoadError`]; `invalid-trace` for a trace of version 1 without `config`.
    pub fn of_trace(
        sources: &mut Sources,
        header: &TraceHeader,
        config: Option<&Path>,
        rules: Option<&Path>,
        files: &dyn ReadFile,
    ) -> Result<LoadedCity, LoadError> {
        let scenario = match (config, &header.archive) {
            (None, Some(archive)) => {
                let mut scenario = archive.scenario(sources, &header.config).map_err(LoadError::Config)?;
                scenario.map.name.clone_from(&header.map);
                scenario
            }
            (Some(config), _) => load_scenario(sources, config, files).map_err(LoadError::Config)?,
            (None, None) => {
                let message = "a trace of version 1, which does not contain its configuration and rules";
                let fault = Diagnostic::new(codes::INVALID_TRACE, message);
                let help = "specify the configuration of the run with `--config`, or run again";
                return Err(LoadError::Config(vec![fault.help(help)]));
            }
        };
        match (rules, &header.archive) {
            (None, Some(archive)) => {
                let rules = archive.rule_files.first().map(|file| Path::new(&file.name));
                let city = LoadedCity::with_rules(sources, scenario, rules, archive)?;
                // The header verifies the sources, and this verifies which file includes which.
                match city.rules_hash == header.rules_hash {
                    true => Ok(city),
                    false => {
                        let message = "the rule files of the trace are not those of the run: they have other names";
                        let fault = Diagnostic::new(codes::TRACE_MISMATCH, message);
                        Err(LoadError::Rules(vec![fault.help("run again")]))
                    }
                }
            }
            (rules, _) => LoadedCity::with_rules(sources, scenario, rules, files),
        }
    }

    /// Generates the map and binds the predicates of the configuration to the rules.
    ///
    /// # Errors
    /// As [`World::new`].
    pub fn world(self) -> Result<World, Vec<Diagnostic>> {
        let mut world = World::new(self.scenario, self.program)?;
        world.limits = self.limits;
        Ok(world)
    }
}

/// Explains faults of rules by the configuration: adds one for each declaration that does not fit it, and replaces the
/// help of those about undeclared predicates that it defines. `declared` are the declarations of the rules.
pub fn help_to_declare(
    faults: &mut Vec<Diagnostic>,
    sources: &Sources,
    (declared, scenario): (&[Declaration], &Scenario),
) {
    // Faults at the uses follow from those of the declarations.
    faults.splice(0..0, other_declarations(declared, scenario));
    for fault in faults.iter_mut().filter(|fault| fault.code == UNKNOWN_PREDICATE) {
        let Some(name) = fault.primary.as_ref().map(|label| sources.slice(label.span)) else {
            continue;
        };
        let mut defined = scenario.predicates.iter();
        let Some(predicate) = defined.find(|predicate| predicate.name.value == name) else {
            continue;
        };
        // Without the vocabulary of the city, to include it may be all that is missing.
        if fault.help.iter().any(|help| help.contains("vocabulary")) {
            continue;
        }
        let definition = &predicate.definition;
        let declaration = declaration(name, definition.arity(), definition.unit().map(base_of));
        fault.fixes.clear();
        fault.help = vec![format!(
            "the configuration defines it: declare it with `{declaration}` and `.input {name}`"
        )];
    }
}
