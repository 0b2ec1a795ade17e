//! The `README.md` of a data set.

use crate::city::Action;
use crate::task::vap::folder::{DatasetSettings, Manifest};
use crate::task::vap::table::{ENTITY_NAMES, ENTITY_NUMBERS, PAIR_NAMES};
use crate::task::vap::{FIRST_TICK, Mode, SIDE, TICKS, Worlds, percent, total};
use std::fmt::Write as _;

/// The text of the file.
pub(super) fn card(mode: Mode, manifest: &Manifest, worlds: &Worlds) -> String {
    let parts = [
        beginning(manifest),
        pictures(manifest),
        labels(mode, manifest),
        concepts(manifest),
        atoms(manifest),
        columns(worlds),
    ];
    parts.join("\n")
}

fn beginning(manifest: &Manifest) -> String {
    let DatasetSettings {
        mode,
        agents,
        split,
        seed,
        config_hash,
        rules_hash,
        drawing_hash,
        ..
    } = &manifest.settings;
    format!(
        "# Visual Action Prediction, {mode} mode, {agents} agents, {split}\n\n\
         {} worlds of {TICKS} ticks, of which the ticks from {FIRST_TICK} on are here: {} frames, {} labels of cars. Made by\n\
         `{}`, checked by `logicity vap check`. Under the MIT\n\
         licence, as the program that made it.\n\n\
         configuration {config_hash}  \nrules {rules_hash}  \ndrawing {drawing_hash}\n",
        manifest.worlds.len(),
        manifest.frames,
        total(manifest.actions),
        command(
            manifest,
            &format!("--mode {mode} --agents {agents} --split {split} --seed {seed}")
        ),
    )
}

fn command(manifest: &Manifest, which: &str) -> String {
    let settings = &manifest.settings;
    let mut command = format!("logicity vap make {which} --worlds {}", manifest.worlds.len());
    if let Some(first) = manifest.worlds.first().filter(|first| first.world > 0) {
        write!(command, " --first-world {}", first.world).expect("memory");
    }
    write!(command, " --difficulty {}", settings.difficulty).expect("memory");
    if let Some(mode) = &settings.pack_mode {
        write!(command, " --pack FOLDER --pack-mode {mode}").expect("memory");
    }
    if !settings.pictures {
        command += " --no-pictures";
    }
    command
}

fn pictures(manifest: &Manifest) -> String {
    let settings = &manifest.settings;
    let size = |extension: &str| format!("{} MB", manifest.bytes(extension).div_ceil(1_000_000));
    let mut text = "## Pictures\n\n".to_owned();
    text += &match settings.pictures {
        true => format!(
            "`world-NNNNN/frame-TTT.png` is the picture of tick TTT: {SIDE} x {SIDE} pixels of red, green and blue, the first 128 rows and columns of\n\
             the map, 8 pixels a cell. All pictures take {}, the tables {}.\n",
            size(".png"),
            size(".parquet")
        ),
        false => format!(
            "There are none. Boxes are those of pictures of {SIDE} x {SIDE} pixels, the first 128 rows and columns of the map, 8 pixels a cell. The\n\
             tables take {}.\n",
            size(".parquet")
        ),
    };
    write!(
        text,
        "Cars are 48 pixels wide and turn with their heading, pedestrians 32; which instance of its class an agent shows is drawn for every frame.\n\
         Every world has streets, meadows and buildings of its own look, every split icons of its own. The difficulty is {} of 100: how much\n\
         colours, light, sharpness and markings vary and how much lies around.\n",
        settings.difficulty
    )
    .expect("memory");
    if let (Some(hash), Some(mode)) = (&settings.pack_hash, &settings.pack_mode) {
        let beside = if mode == "replace" { "instead of" } else { "beside" };
        write!(
            text,
            "Icons of a pack {beside} those drawn are part of the pictures, and its licence is theirs; splits made with one pack share its icons.\n\n\
             pack {hash}\n"
        )
        .expect("memory");
    }
    text
}

fn labels(mode: Mode, manifest: &Manifest) -> String {
    let mut text = "## Labels\n\n\
        A label is what the rules want of a car in the state that the frame shows, not the move that followed.\n\n\
        | label | here | share | published fixed test set | share |\n|---|---|---|---|---|\n"
        .to_owned();
    let published = mode.published_actions();
    let totals = [manifest.actions, published].map(total);
    for (index, action) in Action::ALL.into_iter().enumerate() {
        let (here, there) = (manifest.actions[index], published[index]);
        let [share, share_there] = [percent(here, totals[0]), percent(there, totals[1])];
        let name = action.name();
        writeln!(text, "| {index} {name} | {here} | {share} | {there} | {share_there} |").expect("memory");
    }
    text
}

fn concepts(manifest: &Manifest) -> String {
    let mut text =
        "## Agents\n\nAgents of all frames by concept, those without one by type.\n\n| concept | here | share |\n|---|---|---|\n"
            .to_owned();
    for (concept, count) in &manifest.concepts {
        writeln!(text, "| {concept} | {count} | {} |", percent(*count, manifest.agents)).expect("memory");
    }
    text
}

fn atoms(manifest: &Manifest) -> String {
    let mut text =
        "## Facts\n\nTrue atoms of all frames, of those about two agents the ones of which the first sees the second.\n\n| predicate | true |\n|---|---|\n".to_owned();
    for (predicate, count) in &manifest.atoms {
        writeln!(text, "| `{predicate}` | {count} |").expect("memory");
    }
    text
}

fn columns(worlds: &Worlds) -> String {
    let predicates = |arity: usize| {
        let all = &worlds.world().vocabulary.predicates;
        let names = all.iter().filter(|predicate| predicate.arity == arity);
        names
            .map(|predicate| format!("`{}`", predicate.name))
            .collect::<Vec<_>>()
            .join(", ")
    };
    let mut text = "## Tables\n\n\
        `world-NNNNN/entities.parquet`: a row for each agent of each frame, in order of tick and agent.\n\n\
        | column | what it is |\n|---|---|\n"
        .to_owned();
    let numbers = ENTITY_NUMBERS.iter().map(|(name, what, _)| (*name, *what));
    for (name, what) in ENTITY_NAMES.into_iter().chain(numbers) {
        writeln!(text, "| `{name}` | {what} |").expect("memory");
    }
    write!(
        text,
        "| {} | whether it holds |\n\n\
         `world-NNNNN/pairs.parquet`: a row for each ordered pair of agents of each frame, so that the column of a predicate is a\n\
         matrix for each frame, row by row.\n\n\
         | column | what it is |\n|---|---|\n",
        predicates(1)
    )
    .expect("memory");
    for (name, what) in PAIR_NAMES {
        writeln!(text, "| `{name}` | {what} |").expect("memory");
    }
    write!(
        text,
        "| {} | whether it holds of first and second |\n\n\
         `world-NNNNN/world.json` and `manifest.json` have counts, the seed of each world, and size and SHA-256 of each file.\n",
        predicates(2)
    )
    .expect("memory");
    text
}
