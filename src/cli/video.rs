//! Videos of runs, which the program ffmpeg encodes.

use crate::cancel::Cancel;
use crate::city::codes;
use crate::cli::failure::Failure;
use crate::cli::frames::{Drawn, Frame};
use crate::cli::icons::IconOptions;
use crate::cli::inputs::Inputs;
use crate::cli::outputs::{ForceOption, finish, is_stdout};
use crate::cli::terminal;
use crate::cli::trace::TraceReader;
use crate::cli::values::integer;
use crate::datalog::Limits;
use crate::diag::{self, Diagnostic, Sources};
use crate::files::Output;
use crate::render::{Extent, Marked, Overview, Scale, beside};
use crate::rng::Seed;
use std::env;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::thread::{self, JoinHandle};

/// The environment variable that names the encoder.
const ENCODER: &str = "LOGICITY_FFMPEG";

/// The number of cells between the agents and the edge of a cropped picture, so that their icons and labels fit.
pub const CROP_MARGIN: u32 = 4;

/// The most decisions, agents times ticks, of a video: all are in memory, since an agent faces its next move.
pub const DECISIONS_MAX: u64 = 4_000_000;

/// The options that make a video.
#[derive(clap::Args)]
pub struct VideoOptions {
    /// Also write a video in H.264 to FILE, for example city.mp4. Needs the program ffmpeg
    #[arg(long, value_name = "FILE")]
    pub video: Option<PathBuf>,
    /// Ticks per second in the video, 1 to 60
    #[arg(long, value_name = "TICKS", value_parser = integer(1..=60_u32), default_value_t = 10, requires = "video")]
    video_speed: u32,
}

/// A video that is not begun yet: its file, and the program that encodes it.
pub struct Video {
    path: PathBuf,
    out: Output,
    program: PathBuf,
    speed: u32,
}

/// The part of the map that pictures show, and its scale.
#[derive(Clone, Copy)]
pub struct Part {
    /// Whether they show only the part that agents visit.
    pub crop: bool,
    pub scale: Option<Scale>,
}

impl VideoOptions {
    /// Creates the file of the video, if one is wanted, and finds the program that encodes it: before a run begins, so
    /// that a long run does not end without its video.
    pub fn begin(&self, force: &ForceOption, by: &str, inputs: &Inputs) -> Result<Option<Video>, Failure> {
        let Some(path) = &self.video else { return Ok(None) };
        if is_stdout(path) {
            let message = "a video cannot go to standard output, since the encoder needs a seekable file";
            return Err(Failure::Usage(format!(
                "{message}\nhelp: name a file: `--video city.mp4`"
            )));
        }
        let program = encoder()?;
        Ok(Some(Video {
            path: path.clone(),
            out: force.create(by, path, inputs)?,
            program,
            speed: self.video_speed,
        }))
    }
}

/// Returns the program that encodes videos.
fn encoder() -> Result<PathBuf, Failure> {
    let get = "install it (Debian: `apt-get install ffmpeg`), or run `pip install 'logicity[video]'`, which installs \
               a copy";
    if let Some(program) = env::var_os(ENCODER).filter(|program| !program.is_empty()) {
        let program = PathBuf::from(program);
        return match program.is_file() {
            true => Ok(program),
            false => Err(Failure::Usage(format!(
                "`{ENCODER}` names `{}`, which is no file\nhelp: set it to the program ffmpeg; or unset it and {get}",
                program.display()
            ))),
        };
    }
    let name = format!("ffmpeg{}", env::consts::EXE_SUFFIX);
    let folders = env::var_os("PATH").unwrap_or_default();
    let found = env::split_paths(&folders)
        .map(|folder| folder.join(&name))
        .find(|program| program.is_file());
    found.ok_or_else(|| {
        let message = "`--video` needs the program `ffmpeg`, which is not on the path";
        Failure::Usage(format!(
            "{message}\nhelp: {get}; the variable {ENCODER} can name the program"
        ))
    })
}

/// A run to show: its trace, in a picture of its own.
struct Shown {
    title: String,
    drawn: Vec<Drawn>,
    frames: Vec<Frame>,
    overview: Overview,
}

/// The traces to show, with the files that replace their configuration and rules.
pub struct Traces<'a> {
    /// Path, configuration and rules of each trace.
    pub files: Vec<(&'a Path, [Option<&'a Path>; 2])>,
    /// The titles of several traces.
    pub names: Vec<String>,
    /// The first tick, and the number of ticks.
    pub range: (u64, u64),
}

impl Video {
    /// Writes the video of a trace, or of several side by side.
    ///
    /// # Errors
    /// [`Failure::Interrupted`] if `cancel` is requested.
    pub fn write(
        self,
        traces: &Traces<'_>,
        part: Part,
        icons: &IconOptions,
        cancel: &Cancel,
    ) -> Result<PathBuf, Failure> {
        let mut shown = Vec::new();
        for (number, (path, files)) in traces.files.iter().enumerate() {
            let name = traces.names.get(number).map_or("", String::as_str);
            let mut sources = Sources::new();
            shown.push(load(path, *files, &mut sources, traces.range, name, part, icons)?);
            if files.iter().any(Option::is_some) {
                // The files that these name are known only now.
                Inputs::of(&sources).refuse(&self.path)?;
            }
        }
        let first = shown.iter().map(|run| run.frames[0].tick).max().unwrap_or(0);
        let end = |run: &Shown| run.frames[0].tick + run.frames.len() as u64;
        let end = shown.iter().map(end).min().unwrap_or(0);
        if first >= end {
            return Err(Failure::Usage("the traces have no tick in common".to_owned()));
        }
        let Video {
            path,
            out,
            program,
            speed,
        } = self;
        let bar = terminal::progress("frame", end - first);
        let mut encoder: Option<Encoder> = None;
        for tick in first..end {
            let frames = frames_of(&shown, tick);
            let titled: Vec<_> = (shown.iter().zip(&frames))
                .map(|(run, picture)| (&*run.title, picture))
                .collect();
            let picture = beside(&titled);
            let encoder = match &mut encoder {
                Some(encoder) => encoder,
                None => encoder.insert(Encoder::start(
                    &program,
                    out.temporary(),
                    [picture.width(), picture.height()],
                    speed,
                )?),
            };
            let pushed = encoder.push(picture.pixels());
            // The encoder gets the same signal, and may end first.
            if cancel.requested() {
                return Err(Failure::Interrupted);
            }
            pushed?;
            bar.inc(1);
        }
        bar.finish_and_clear();
        if let Some(encoder) = encoder {
            let finished = encoder.finish();
            if cancel.requested() {
                return Err(Failure::Interrupted);
            }
            finished?;
        }
        finish(out, &path)?;
        Ok(path)
    }
}

/// Returns the pictures of a tick. Agents that act differently in two runs of the same agents have a frame.
fn frames_of(shown: &[Shown], tick: u64) -> Vec<crate::render::Picture> {
    let frame = |run: &Shown| -> usize { usize::try_from(tick - run.frames[0].tick).expect("a position") };
    let marked: Vec<Marked> = match shown {
        [one, other]
            if one
                .drawn
                .iter()
                .map(|drawn| &drawn.name)
                .eq(other.drawn.iter().map(|drawn| &drawn.name)) =>
        {
            let actions = [one, other].map(|run| run.frames[frame(run)].agents.iter().map(|(.., action)| action));
            let [left, right] = actions;
            let differ = left.zip(right).enumerate().filter(|(_, (left, right))| left != right);
            differ.map(|(agent, _)| Marked { agent, way: Vec::new() }).collect()
        }
        _ => Vec::new(),
    };
    let draw = |run: &Shown| {
        let frame = &run.frames[frame(run)];
        run.overview
            .draw_marked(frame.tick, &frame.sprites(&run.drawn), &marked)
    };
    shown.iter().map(draw).collect()
}

/// Fails if a video of so many decisions would need too much memory.
pub fn refuse_large(decisions: u64, help: &str) -> Result<(), Failure> {
    if decisions <= DECISIONS_MAX {
        return Ok(());
    }
    let message = format!("a video of {decisions} decisions would be too large; the limit is {DECISIONS_MAX}");
    Err(Diagnostic::new(diag::codes::LIMIT_EXCEEDED, message).help(help).into())
}

fn load(
    path: &Path,
    [config, rules]: [Option<&Path>; 2],
    sources: &mut Sources,
    (from, most): (u64, u64),
    name: &str,
    part: Part,
    icons: &IconOptions,
) -> Result<Shown, Failure> {
    let mut reader = TraceReader::open(path)?;
    let replay = reader.replay(sources, config, rules, true, Limits::default())?;
    let mut ticks = Vec::new();
    while (ticks.len() as u64) < most
        && let Some(tick) = reader.tick()?
    {
        if tick.agents.len() != reader.header.agents.len() {
            let (found, expected) = (tick.agents.len(), reader.header.agents.len());
            let message = format!("tick {} has {found} agents, not {expected}", tick.tick);
            return Err(reader.placed(Diagnostic::new(crate::sim::codes::INVALID_TRACE, message)));
        }
        if tick.tick >= from {
            ticks.push(tick);
            let decisions = (ticks.len() as u64).saturating_mul(reader.header.agents.len() as u64);
            refuse_large(decisions, "make a video of some ticks: `--from N --ticks N`")?;
        }
    }
    if ticks.is_empty() {
        return Err(Failure::Usage(format!(
            "`{}` has no tick from {from} on",
            path.display()
        )));
    }
    let frames = Frame::of_trace(&ticks, &replay).map_err(|fault| reader.placed(fault))?;
    let map = replay.world().map();
    let extent = match part.crop {
        false => Extent::whole(map),
        true => {
            let cells = frames.iter().flat_map(|frame| frame.agents.iter().map(|(at, ..)| *at));
            Extent::around(map, cells, CROP_MARGIN)
        }
    };
    let icons = Arc::new(icons.load(Seed(reader.header.seed), &replay.world().scenario.looks)?);
    let city = (map, replay.world().vocabulary.actions());
    let overview = Overview::of_city(city, icons, extent, part.scale).map_err(|error| match part.scale {
        Some(_) => Failure::Usage(format!("{error}\nhelp: use a smaller `--scale`, or `--crop`")),
        None => Diagnostic::new(codes::INVALID_MAP, error.to_string()).into(),
    })?;
    let rules = reader.header.rules.rsplit('/').next().unwrap_or_default();
    let title = match name {
        "" => String::new(),
        name => format!("{name}: {rules}, seed {}", reader.header.seed),
    };
    Ok(Shown {
        title,
        drawn: Drawn::of_trace(&reader.header, &replay),
        frames,
        overview,
    })
}

/// Returns a path that the encoder does not read as an address: `10:00/city.mp4` would name a protocol.
fn plain_path(file: &Path) -> PathBuf {
    match file.is_absolute() {
        true => file.to_owned(),
        false => Path::new(".").join(file),
    }
}

/// The running encoder. Dropping it ends the process.
struct Encoder {
    program: PathBuf,
    process: Child,
    /// What it says about errors.
    said: Option<JoinHandle<String>>,
}

impl Encoder {
    fn start(program: &Path, file: &Path, [width, height]: [u32; 2], speed: u32) -> Result<Encoder, Failure> {
        let size = format!("{width}x{height}");
        let speed = speed.to_string();
        let input = [
            "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", &size, "-r", &speed, "-i", "-",
        ];
        let output = [
            "-c:v",
            "libx264",
            "-crf",
            "18",
            "-pix_fmt",
            "yuv420p",
            "-movflags",
            "+faststart",
        ];
        let process = Command::new(program)
            .args(["-hide_banner", "-loglevel", "error"])
            .args(input)
            .args(output)
            .args(["-fflags", "+bitexact", "-f", "mp4", "-y"])
            .arg(plain_path(file))
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn();
        let mut process = process.map_err(|error| {
            let program = program.display();
            Failure::Usage(format!(
                "cannot run `{program}`: {error}\nhelp: the variable {ENCODER} can name another program"
            ))
        })?;
        let mut errors = process.stderr.take().expect("it is a pipe");
        let said = thread::spawn(move || {
            let mut said = Vec::new();
            // What cannot be read is lost; the exit status tells that it failed.
            let _ = errors.read_to_end(&mut said);
            String::from_utf8_lossy(&said).trim().to_owned()
        });
        Ok(Encoder {
            program: program.to_owned(),
            process,
            said: Some(said),
        })
    }

    fn push(&mut self, pixels: &[u8]) -> Result<(), Failure> {
        let input = self.process.stdin.as_mut().expect("it is a pipe");
        input.write_all(pixels).map_err(|error| self.failed(&error.to_string()))
    }

    fn finish(mut self) -> Result<(), Failure> {
        drop(self.process.stdin.take());
        let status = self.process.wait();
        match status {
            Ok(status) if status.success() => Ok(()),
            Ok(status) => Err(self.failed(&status.to_string())),
            Err(error) => Err(self.failed(&error.to_string())),
        }
    }

    fn failed(&mut self, how: &str) -> Failure {
        let _ = self.process.kill();
        let said = self.said.take().and_then(|said| said.join().ok()).unwrap_or_default();
        let said = if said.is_empty() { how.to_owned() } else { said };
        let program = self.program.display();
        Failure::Usage(format!(
            "`{program}` failed: {said}\nhelp: it must have the encoder libx264"
        ))
    }
}

impl Drop for Encoder {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}
