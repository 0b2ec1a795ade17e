//! `logicity induce --ask`: learns from the answers of an oracle.

use crate::builtin::BuiltinFiles;
use crate::cancel::Cancel;
use crate::city::Action;
use crate::cli::failure::Failure;
use crate::cli::inputs::Inputs;
use crate::cli::limits::LimitOptions;
use crate::cli::report::report;
use crate::cli::values::integer;
use crate::config::Scenario;
use crate::diag::{Diagnostic, Sources, json_error};
use crate::files::{self, Journal};
use crate::induce::State;
use crate::induce::ask::{AskSettings, Bound, Event};
use crate::rng::Seed;
use crate::sim::{Executor, Inference, LoadedCity, hash_sources};
use crate::task::induction::codes;
use crate::task::induction::{Asked, InductionTask, Inquiry, LogError, OracleError, RuleOracle};
use clap::builder::NonEmptyStringValueParser;
use indicatif::{ProgressBar, ProgressStyle};
use serde_json::Value;
use sha2::{Digest, Sha256};
use std::io::{self, BufRead, BufReader, Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, SyncSender, TryRecvError, channel, sync_channel};
use std::thread;
use std::time::{Duration, Instant};

/// The options about questions. Each but `ask` requires `ask`, but clap does not check that while another option
/// excludes `ask`: such an option has to exclude all of them.
pub const ASK_OPTIONS: [&str; 6] = ["ask", "questions", "agreements", "sweep", "answer_timeout", "log"];

#[derive(clap::Args)]
pub struct AskOptions {
    /// Ask an oracle which action it takes in scenes that the learner makes up. A value that ends in `.dl` is a rule
    /// file; the learner does not see its clauses. Any other value is a command for the shell, which runs once: it
    /// reads one scene per line, as `logicity infer` does, and answers each with a line such as `{"action": "Stop"}`
    #[arg(long, value_name = "ORACLE", value_parser = NonEmptyStringValueParser::new())]
    ask: Option<String>,
    /// Maximum number of questions, including those of an earlier run in the log
    #[arg(long, value_name = "COUNT", requires = "ask", value_parser = integer(0..=usize::MAX),
        default_value_t = AskSettings::default().questions)]
    questions: usize,
    /// End the questions when the rules agree with the oracle on this many random scenes in a row
    #[arg(long, value_name = "COUNT", requires = "ask", value_parser = integer(0..=usize::MAX),
        default_value_t = AskSettings::default().agreements)]
    agreements: usize,
    /// Then ask all scenes of at most this many facts and entities, for example `3,2`: a certificate. Facts that follow
    /// from others and facts of `.covering` predicates do not count
    #[arg(long, value_name = "FACTS,ENTITIES", requires = "ask", value_parser = bound)]
    sweep: Option<Bound>,
    /// Maximum time for one answer
    #[arg(long, value_name = "SECONDS", requires = "ask", value_parser = seconds, default_value = "60")]
    answer_timeout: Duration,
    /// Append each question with its answer to FILE at once. The same command with an existing log continues where it
    /// stopped. A log can also be given as DATA
    #[arg(long, value_name = "FILE", requires = "ask")]
    log: Option<PathBuf>,
}

/// Reads the value of `--sweep`.
fn bound(text: &str) -> Result<Bound, String> {
    let numbers = text.split_once(',');
    let bound = numbers.and_then(|(facts, entities)| {
        Some(Bound {
            facts: facts.trim().parse().ok().filter(|facts| *facts <= FACTS_MAX)?,
            entities: entities
                .trim()
                .parse()
                .ok()
                .filter(|entities| (1..=ENTITIES_MAX).contains(entities))?,
        })
    });
    bound.ok_or_else(|| {
        format!("expected numbers of facts, at most {FACTS_MAX}, and of entities, from 1 to {ENTITIES_MAX}: `3,2`")
    })
}

/// The largest scenes of a sweep. Beyond them, scenes that differ in the names of entities would not be recognized.
const ENTITIES_MAX: usize = 5;
const FACTS_MAX: usize = 1000;

/// Reads the value of `--answer-timeout`.
fn seconds(text: &str) -> Result<Duration, String> {
    let seconds = text.parse().ok().filter(|seconds| (0.001..=1e6).contains(seconds));
    seconds
        .map(Duration::from_secs_f64)
        .ok_or_else(|| "expected a number of seconds from 0.001 to 1000000".to_owned())
}

/// The oracle that the options name.
pub enum OracleSource {
    /// Rules for the configuration of the learner.
    Rules { name: String, city: Box<LoadedCity> },
    /// A command for the shell.
    Command(String),
}

/// An oracle with the log of its answers.
pub struct Session<'a> {
    options: &'a AskOptions,
    source: OracleSource,
    log: Option<(Journal, &'a Path)>,
}

impl AskOptions {
    /// Returns whether the options name an oracle.
    pub fn is_asked(&self) -> bool {
        self.ask.is_some()
    }

    /// Loads the rules of the oracle for a configuration, if it follows rules.
    pub fn load(
        &self,
        sources: &mut Sources,
        scenario: &Scenario,
        limits: &LimitOptions,
    ) -> Result<Option<OracleSource>, Failure> {
        let Some(oracle) = &self.ask else { return Ok(None) };
        if !oracle.ends_with(".dl") {
            return Ok(Some(OracleSource::Command(oracle.clone())));
        }
        let rules = Some(Path::new(oracle));
        let mut city = LoadedCity::with_rules(sources, scenario.clone(), rules, &BuiltinFiles)?;
        city.limits = limits.limits(city.limits);
        report(&city.warnings, sources);
        Ok(Some(OracleSource::Rules {
            name: files::portable_name(oracle),
            city: city.into(),
        }))
    }

    /// Opens the log. `outputs` are the other files that the command writes.
    pub fn open(&self, source: OracleSource, inputs: &Inputs, outputs: &[&Path]) -> Result<Session<'_>, Failure> {
        let open = |path: &PathBuf| -> Result<Journal, Failure> {
            if path == Path::new("-") {
                let message = "--log needs a file, because a later run reads it; `./-` is the file with that name";
                return Err(Failure::Usage(message.to_owned()));
            }
            inputs.refuse(path)?;
            if outputs.iter().any(|output| files::is_same_file(output, path)) {
                let message = format!("`{}` cannot be both the log and another output", path.display());
                return Err(Failure::Usage(message));
            }
            Journal::open(path).map_err(|error| Failure::file("write", path, error))
        };
        let log = match &self.log {
            Some(path) => Some((open(path)?, path.as_path())),
            None => None,
        };
        Ok(Session {
            options: self,
            source,
            log,
        })
    }
}

impl OracleSource {
    /// Returns the oracle in words, for reports. A command may contain secrets.
    fn name(&self) -> String {
        match self {
            OracleSource::Rules { name, .. } => format!("the rules in {name}"),
            OracleSource::Command(_) => "a command".to_owned(),
        }
    }

    /// Returns what identifies the oracle in a log.
    fn identity(&self, sources: &Sources) -> String {
        let (kind, hash) = match self {
            OracleSource::Rules { city, .. } => ("rules", hash_sources(sources, &city.rule_files)),
            OracleSource::Command(command) => ("command", format!("{:x}", Sha256::digest(command))),
        };
        format!("{kind} {}", hash.chars().take(12).collect::<String>())
    }
}

impl Session<'_> {
    /// Learns from the examples of `inquiry` and from questions. Its answers are those of the log.
    pub fn ask(
        mut self,
        task: &InductionTask,
        mut inquiry: Inquiry,
        sources: &Sources,
        cancel: &Cancel,
    ) -> Result<Asked, Failure> {
        inquiry.asking.questions = self.options.questions;
        inquiry.asking.agreements = self.options.agreements;
        inquiry.asking.sweep = self.options.sweep;
        inquiry.oracle = self.source.name();
        if let Some((log, path)) = &mut self.log {
            let identity = self.source.identity(sources);
            let answers = task.resume(&inquiry, &identity, log, &path.display().to_string());
            inquiry.answers = answers.map_err(|error| unusable(error, path))?;
        }

        let bar = ProgressBar::no_length();
        let plain = ProgressStyle::with_template("{pos} questions{msg}").expect("a valid template");
        bar.set_style(plain);
        let mut is_sweep = false;
        let mut observe = |event: Event<'_>| match event {
            Event::Answered { .. } => bar.inc(1),
            Event::Learned(rules) => {
                let clauses: usize = rules.actions.iter().map(|rules| rules.clauses.len()).sum();
                bar.set_message(format!(", {clauses} clauses"));
            }
            Event::Sweep(bound, most) => {
                is_sweep = true;
                let Bound { facts, entities } = bound;
                let template = format!(
                    "{{bar:30}} {{pos}} of at most {{len}} questions{{msg}}; all scenes of at most {facts} facts and \
                     {entities} entities"
                );
                bar.set_style(ProgressStyle::with_template(&template).expect("a valid template"));
                bar.set_length(bar.position().saturating_add(u64::try_from(most).unwrap_or(u64::MAX)));
            }
        };
        let log = self.log.as_mut().map(|(log, _)| log);
        let timeout = self.options.answer_timeout;
        let asked = match self.source {
            OracleSource::Rules { city, .. } => {
                let limits = city.limits;
                let mut inference = Inference::new(city.scenario, city.program, Seed(0), Executor::Auto, BuiltinFiles)?;
                inference.set_limits(limits);
                inference.name_clauses(sources);
                let rules = RuleOracle::new(task, inference)?;
                let mut oracle = |state: &State| {
                    let (end, request) = (Instant::now() + timeout, cancel.clone());
                    let limited = Cancel::when(move || request.requested() || Instant::now() > end);
                    match rules.action(state, &limited) {
                        Err(OracleError::Cancelled) if !cancel.requested() => Err(too_slow(timeout)),
                        result => result,
                    }
                };
                task.ask(inquiry, &mut oracle, log, &mut observe, cancel)
            }
            OracleSource::Command(command) => {
                // A log that is complete needs no process.
                let mut process: Option<CommandOracle> = None;
                let mut oracle = |state: &State| {
                    let oracle = match &mut process {
                        Some(oracle) => oracle,
                        None => process.insert(CommandOracle::start(&command, timeout)?),
                    };
                    let action = oracle.action(&task.scene(state), cancel)?;
                    task.answered_action(action)
                };
                task.ask(inquiry, &mut oracle, log, &mut observe, cancel)
            }
        };
        bar.finish_and_clear();
        Ok(asked)
    }
}

/// Returns the failure to continue a log.
fn unusable(error: LogError, path: &Path) -> Failure {
    match error {
        LogError::Io(error) => Failure::file("use", path, error),
        LogError::Other(what) => Failure::Usage(format!(
            "cannot continue `{}`: it {what}\nhelp: choose another file; a log can be given as DATA, too",
            path.display()
        )),
        LogError::Faults(faults, sources) => {
            report(&faults, &sources);
            Failure::Reported
        }
    }
}

fn too_slow(timeout: Duration) -> OracleError {
    let seconds = timeout.as_secs_f64();
    OracleError::Silent(format!(
        "the oracle gave no answer in {seconds} s\nhelp: `--answer-timeout` changes the limit"
    ))
}

/// The longest line of an answer, in bytes.
const ANSWER_MAX: u64 = 1 << 20;
/// The maximum number of characters of an answer that a message shows.
const SHOWN_MAX: usize = 200;
/// How often a waiting oracle looks for an interrupt.
const POLL: Duration = Duration::from_millis(20);
/// The time that a process has to end after its input ended.
const GRACE: Duration = Duration::from_millis(500);

/// An oracle that is a process: it gets a scene per line and answers each with an action.
///
/// One thread writes scenes and another one reads answers, so that no process can block this one.
struct CommandOracle {
    child: Child,
    /// Whether the process and those that it starts are a process group.
    is_group: bool,
    scenes: Option<Sender<String>>,
    answers: Receiver<Vec<u8>>,
    timeout: Duration,
}

impl CommandOracle {
    fn start(command: &str, timeout: Duration) -> Result<CommandOracle, OracleError> {
        let mut shell = shell(command);
        shell.stdin(Stdio::piped()).stdout(Stdio::piped());
        let is_group = separate(&mut shell);
        let cannot = |error: io::Error| OracleError::Silent(format!("the oracle cannot be started: {error}"));
        let mut child = shell.spawn().map_err(cannot)?;
        let mut input = child.stdin.take().expect("a pipe");
        let mut output = BufReader::new(child.stdout.take().expect("a pipe"));
        let (scenes, written) = channel::<String>();
        let (answered, answers) = sync_channel(1);
        let write = move || {
            for scene in written {
                // The reader notices that the process ended.
                if input.write_all(scene.as_bytes()).and_then(|()| input.flush()).is_err() {
                    break;
                }
            }
        };
        let read = move || while pass_line(&mut output, &answered) {};
        for (name, work) in [
            ("scenes", Box::new(write) as Box<dyn FnOnce() + Send>),
            ("answers", Box::new(read)),
        ] {
            thread::Builder::new()
                .name(name.to_owned())
                .spawn(work)
                .map_err(cannot)?;
        }
        Ok(CommandOracle {
            child,
            is_group,
            scenes: Some(scenes),
            answers,
            timeout,
        })
    }

    /// Sends a scene and waits for the action.
    fn action(&mut self, scene: &Value, cancel: &Cancel) -> Result<Action, OracleError> {
        match self.answers.try_recv() {
            Ok(line) => return Err(invalid("the oracle writes a line before it is asked", &line, None)),
            Err(TryRecvError::Disconnected) => return Err(self.ended(cancel)),
            Err(TryRecvError::Empty) => {}
        }
        if let Some(scenes) = &self.scenes {
            let _ = scenes.send(format!("{scene}\n"));
        }
        let end = Instant::now() + self.timeout;
        loop {
            let left = end.saturating_duration_since(Instant::now());
            match self.answers.recv_timeout(left.min(POLL)) {
                Ok(line) => return read_action(&line),
                Err(RecvTimeoutError::Disconnected) => return Err(self.ended(cancel)),
                Err(RecvTimeoutError::Timeout) if cancel.requested() => return Err(OracleError::Cancelled),
                Err(RecvTimeoutError::Timeout) if left.is_zero() => return Err(too_slow(self.timeout)),
                Err(RecvTimeoutError::Timeout) => {}
            }
        }
    }

    /// Returns the error of a process that ended. An interrupt from the terminal reaches it, too, and possibly first.
    fn ended(&mut self, cancel: &Cancel) -> OracleError {
        let status = self.wait();
        if cancel.requested() {
            return OracleError::Cancelled;
        }
        OracleError::Silent(match status {
            Some(status) => format!("the oracle ended without an answer ({status})"),
            None => "the oracle closed its output without an answer".to_owned(),
        })
    }

    /// Waits a short time for the process to end.
    fn wait(&mut self) -> Option<ExitStatus> {
        let end = Instant::now() + GRACE;
        loop {
            match self.child.try_wait() {
                Ok(Some(status)) => return Some(status),
                Ok(None) if Instant::now() < end => thread::sleep(POLL),
                _ => return None,
            }
        }
    }
}

impl Drop for CommandOracle {
    /// Closes the input of the process, kills the process if it does not end soon, and kills what it has started.
    fn drop(&mut self) {
        self.scenes = None;
        let has_ended = self.wait().is_some();
        if self.is_group {
            kill_group(&self.child);
        }
        if !has_ended {
            let _ = self.child.kill();
            let _ = self.child.wait();
        }
    }
}

/// Puts a process into a process group of its own, so that [`kill_group`] reaches all that it starts. Returns whether
/// that is possible: on a terminal, a process of another group could not ask the user.
#[cfg(unix)]
fn separate(shell: &mut Command) -> bool {
    use std::io::IsTerminal;
    use std::os::unix::process::CommandExt;
    let is_interactive = io::stdin().is_terminal() || io::stderr().is_terminal();
    if !is_interactive {
        shell.process_group(0);
    }
    !is_interactive
}

#[cfg(unix)]
fn kill_group(child: &Child) {
    use nix::sys::signal::{Signal, killpg};
    use nix::unistd::Pid;
    if let Ok(group) = i32::try_from(child.id()) {
        let _ = killpg(Pid::from_raw(group), Signal::SIGKILL);
    }
}

#[cfg(not(unix))]
fn separate(_: &mut Command) -> bool {
    // `taskkill` finds what a process has started without a group.
    cfg!(windows)
}

/// On Windows, ends what a process has started, too. Elsewhere there are no processes.
#[cfg(not(unix))]
fn kill_group(child: &Child) {
    let mut command = Command::new("taskkill");
    command.args(["/F", "/T", "/PID", &child.id().to_string()]);
    let _ = command.stdout(Stdio::null()).stderr(Stdio::null()).status();
}

/// Passes a line of an oracle on. Returns false at the end.
fn pass_line(output: &mut impl BufRead, answered: &SyncSender<Vec<u8>>) -> bool {
    let mut line = Vec::new();
    let read = output.by_ref().take(ANSWER_MAX).read_until(b'\n', &mut line);
    read.is_ok_and(|length| length > 0) && answered.send(line).is_ok()
}

#[cfg(unix)]
fn shell(command: &str) -> Command {
    let mut shell = Command::new("/bin/sh");
    shell.args(["-c", command]);
    shell
}

#[cfg(windows)]
fn shell(command: &str) -> Command {
    use std::os::windows::process::CommandExt;
    let mut shell = Command::new("cmd");
    // `cmd` removes the outer quotes and reads the rest as it is.
    shell.raw_arg(format!("/D /S /C \"{command}\""));
    shell
}

#[cfg(not(any(unix, windows)))]
fn shell(command: &str) -> Command {
    Command::new(command)
}

/// Reads the line of an answer: `{"action": "Stop"}`.
fn read_action(line: &[u8]) -> Result<Action, OracleError> {
    let is_not = "the answer of the oracle is not an action";
    let value: Value = serde_json::from_slice(line).map_err(|error| invalid(is_not, line, Some(json_error(&error))))?;
    let name = value.get("action").and_then(Value::as_str);
    name.and_then(Action::standard_ignoring_case)
        .ok_or_else(|| invalid(is_not, line, None))
}

fn invalid(what: &str, line: &[u8], cause: Option<String>) -> OracleError {
    let text = String::from_utf8_lossy(line);
    let shown: String = text.trim_end().chars().take(SHOWN_MAX).collect();
    let names: Vec<&str> = Action::STANDARD.iter().map(|action| action.name()).collect();
    let help = format!(
        "expected a line such as {{\"action\": \"Stop\"}}, with one of {}",
        names.join(", ")
    );
    let fault = Diagnostic::new(codes::INVALID_ANSWER, format!("{what}: `{shown}`")).help(help);
    OracleError::Invalid(
        match cause {
            Some(cause) => fault.note(cause),
            None => fault,
        }
        .into(),
    )
}

/// Returns the failure of a command whose oracle failed.
pub fn failure(error: OracleError, asked: usize) -> Failure {
    match error {
        OracleError::Cancelled => Failure::Interrupted,
        OracleError::Invalid(fault) => Failure::Input(vec![*fault]),
        OracleError::Silent(text) => Failure::Usage(format!("question {}: {text}", asked + 1)),
        OracleError::Log(_) => Failure::Usage(error.to_string()),
    }
}
