//! `logicity icons`, and the icon options of other commands.

use crate::city::{OwnLook, Split};
use crate::cli::failure::Failure;
use crate::cli::inputs::Inputs;
use crate::cli::limits::MemoryOption;
use crate::cli::outputs::{ForceOption, finish, messages, unwritable};
use crate::cli::terminal;
use crate::cli::values::{integer, one_of};
use crate::diag::Diagnostic;
use crate::files;
use crate::render::{
    Class, Difficulty, DrawingVersion, Icons, Mode, PACK_FILE_MAX, PACK_FILES_MAX, Pack, PackFault, sheet, write_png,
};
use crate::rng::Seed;
use crate::yaml::codes;
use std::io::Write;
use std::path::{Path, PathBuf};

/// The options that select icons.
#[derive(clap::Args)]
pub struct IconOptions {
    /// Folder of icons: CLASS/NAME.png or .svg, where CLASS is car, ambulance, bus+tiro, old, gas-station, ...
    #[arg(long, value_name = "DIR")]
    pack: Option<PathBuf>,
    /// How to use the icons of the pack. extend: add them to the generated icons. replace: use only them, for the
    /// classes that the pack has
    #[arg(long, value_parser = one_of(&Mode::ALL, Mode::name), default_value = "extend", requires = "pack")]
    pack_mode: Mode,
    /// Difficulty of pictures from 0 (clean) to 100, in percent: colors, light, sharpness, weather, markings and clutter
    /// vary more. In data sets, the sides of boxes are independent of the class from 50 on. From 50 to 100, the share
    /// of icons of the test split in a different style increases from none to all
    #[arg(long, value_name = "PERCENT", value_parser = difficulty, default_value = "0")]
    difficulty: Difficulty,
    /// Version of the drawing code: 2, or 1 to make a data set of format 3 again
    #[arg(long, value_name = "NUMBER", value_parser = drawing_version, default_value = "2")]
    drawing_version: DrawingVersion,
}

impl Default for IconOptions {
    fn default() -> IconOptions {
        IconOptions {
            pack: None,
            pack_mode: Mode::Extend,
            difficulty: Difficulty::default(),
            drawing_version: DrawingVersion::default(),
        }
    }
}

fn difficulty(text: &str) -> Result<Difficulty, String> {
    let percent = text.parse().ok().and_then(Difficulty::percent);
    percent.ok_or_else(|| "expected an integer from 0 to 100".to_owned())
}

fn drawing_version(text: &str) -> Result<DrawingVersion, String> {
    let version = text.parse().ok().and_then(DrawingVersion::from_number);
    version.ok_or_else(|| "expected 1 or 2".to_owned())
}

impl IconOptions {
    /// Returns the paths of the files in the pack.
    pub fn files(&self) -> Vec<PathBuf> {
        // Loading the pack reports what cannot be read.
        let inside = |folder: &Path| std::fs::read_dir(folder).into_iter().flatten().flatten();
        let folders = self.pack.iter().flat_map(|pack| inside(pack));
        let files = folders.flat_map(|folder| inside(&folder.path()));
        files.map(|file| file.path()).collect()
    }

    /// The icons of a seed, with the looks of a configuration. A note on standard error names the classes that a pack
    /// lacks.
    pub fn load(&self, seed: Seed, looks: &[OwnLook]) -> Result<Icons, Failure> {
        let icons = with_looks(Icons::new(seed, self.difficulty), looks)?.with_version(self.drawing_version);
        let Some(folder) = &self.pack else {
            return Ok(icons);
        };
        let pack = load_pack(folder, self.pack_mode)?;
        let lacks: Vec<String> = (Class::known().into_iter())
            .filter(|class| !pack.classes().any(|(has, _)| has == class))
            .map(|class| class.to_string())
            .collect();
        if !lacks.is_empty() {
            let place = folder.display();
            let _ = writeln!(
                terminal::err(),
                "note: `{place}` has no icons for {}; logicity draws those",
                lacks.join(", ")
            );
        }
        Ok(icons.with_pack(pack))
    }
}

/// Returns icons with the looks of a configuration.
pub fn with_looks(icons: Icons, looks: &[OwnLook]) -> Result<Icons, Failure> {
    icons.with_looks(looks).map_err(|fault| {
        let message = format!("a drawing of the configuration cannot be used: {}", fault.reason);
        Diagnostic::new(codes::INVALID_VALUE, message).into()
    })
}

fn load_pack(folder: &Path, mode: Mode) -> Result<Pack, Failure> {
    let files = files::read_folders(folder, PACK_FILES_MAX, PACK_FILE_MAX as u64)
        .map_err(|(path, error)| Failure::file("read", &path, error))?;
    Pack::new(mode, files).map_err(|faults| {
        for PackFault { file, reason } in faults {
            let icon = folder.join(file);
            let _ = writeln!(terminal::err(), "error: icon `{}`: {reason}", icon.display());
        }
        Failure::Reported
    })
}

#[derive(clap::Args)]
pub struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(clap::Subcommand)]
enum Command {
    /// Draw a sheet with eight icons of each class
    Sheet(SheetArguments),
}

#[derive(clap::Args)]
struct SheetArguments {
    #[command(flatten)]
    icons: IconOptions,
    /// Seed of the icons
    #[arg(long, value_parser = integer(0..=u64::MAX), default_value_t = 0)]
    seed: u64,
    /// Split whose style the icons have; that of the test split differs above difficulty 50
    #[arg(long, value_parser = one_of(&Split::ALL, Split::name), default_value = "train")]
    split: Split,
    /// Additional class, for example bus+tiro or car+taxi; can be repeated
    #[arg(long = "class", value_name = "CLASS", value_parser = class)]
    classes: Vec<Class>,
    /// Write the sheet to FILE; `-` means standard output
    #[arg(short, long, value_name = "FILE", default_value = "sheet.png")]
    output: PathBuf,
    #[command(flatten)]
    force: ForceOption,
    #[command(flatten)]
    _memory: MemoryOption,
}

fn class(text: &str) -> Result<Class, String> {
    let unknown = || {
        "expected a building type, an agent type, or concepts joined by `+`; \
            the first must be a known concept or an agent type"
    };
    let class = Class::from_name(text).or_else(|| Class::from_name(&text.to_ascii_lowercase()));
    class.ok_or_else(|| unknown().to_owned())
}

pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    let Command::Sheet(sheet_of) = &arguments.command;
    let path = &sheet_of.output;
    let inputs = Inputs::new(sheet_of.icons.files());
    let mut out = sheet_of.force.create("icons", path, &inputs)?;
    let icons = sheet_of
        .icons
        .load(Seed(sheet_of.seed), &[])?
        .with_split(sheet_of.split);
    let picture = sheet(&icons, &sheet_of.classes);
    write_png(&picture, &mut out).map_err(|error| unwritable(path, &error))?;
    finish(out, path)?;
    writeln!(messages(&[path]), "wrote {}", path.display())?;
    Ok(())
}
