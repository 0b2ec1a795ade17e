//! Writes the `README.md` of a data set.

use crate::city::Action;
use crate::sim::Vocabulary;
use crate::task::vap::folder;
use crate::task::vap::folder::{DatasetSettings, Manifest};
use crate::task::vap::table::{ENTITY_NAMES, ENTITY_NUMBERS, PAIR_NAMES, VISIBLE};
use crate::task::vap::{FIRST_TICK, Mode, SIDE, TICKS, percent, total};
use std::fmt::Write as _;

/// Returns the text of the file.
pub(super) fn card(mode: Mode, manifest: &Manifest, vocabulary: &Vocabulary) -> String {
    let parts = [
        beginning(manifest),
        pictures(manifest),
        labels(mode, manifest),
        concepts(manifest),
        atoms(manifest),
        columns(vocabulary),
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
         {} of {TICKS} ticks each. The data set contains the ticks from {FIRST_TICK} on:\n\
         {} frames, {} labels of cars.\n\
         `{}` made it; `logicity vap check` checks it.\n\
         It has the MIT license, like the program that made it.\n\n\
         configuration {config_hash}  \nrules {rules_hash}  \ndrawing {drawing_hash}\n",
        match manifest.worlds.len() {
            1 => "1 world".to_owned(),
            count => format!("{count} worlds"),
        },
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
    let (difficulty, drawing) = (settings.difficulty, settings.drawing_version);
    write!(command, " --difficulty {difficulty} --drawing-version {drawing}").expect("memory");
    if let Some(mode) = &settings.pack_mode {
        write!(command, " --pack FOLDER --pack-mode {mode}").expect("memory");
    }
    if !settings.pictures {
        command += " --no-pictures";
    }
    if settings.masks {
        command += " --masks";
    }
    command
}

fn pictures(manifest: &Manifest) -> String {
    let settings = &manifest.settings;
    let size = |begin: &str, end: &str| format!("{} MB", manifest.bytes(begin, end).div_ceil(1_000_000));
    let mut text = "## Pictures\n\n".to_owned();
    text += &match settings.pictures {
        true => format!(
            "`world-NNNNN/frame-TTT.png` is the picture of tick TTT: {SIDE} x {SIDE} pixels in RGB. It shows\n\
             the first 128 rows and columns of the map, with 8 pixels per cell. All pictures take {}, the\n\
             tables {}.\n",
            size("frame-", ".png"),
            size("", ".parquet")
        ),
        false => format!(
            "There are no pictures. Boxes refer to pictures of {SIDE} x {SIDE} pixels that show the first 128\n\
             rows and columns of the map, with 8 pixels per cell. The tables take {}.\n",
            size("", ".parquet")
        ),
    };
    if settings.masks {
        write!(
            text,
            "`world-NNNNN/mask-TTT.png` is the mask of tick TTT, in grayscale and of the same size: a pixel has the\n\
             value 0 where no agent shows, and otherwise the number of the agent's row among those of the tick in\n\
             `entities.parquet`, from 1. All masks take {}.\n",
            size(folder::MASK, ".png")
        )
        .expect("memory");
    }
    write!(
        text,
        "Cars are 48 pixels wide and turn with their heading; pedestrians are 32 pixels wide. Each frame\n\
         draws anew which instance of its class an agent shows. Each world has its own streets, meadows\n\
         and buildings, and each split its own icons. The difficulty is {} of 100: it controls how much\n\
         colors, light, sharpness, markings and clutter vary.\n",
        settings.difficulty
    )
    .expect("memory");
    if settings.has_framings() {
        text += "Each frame also draws anew the size of an agent, the sides of its box, and what hides a part of it.\n\
                 A box contains the icon but is larger. At difficulties from 50 on, its sides are from 72 to 120\n\
                 pixels, independent of each other and of the agent. Each world has its own weather. Above 50,\n\
                 icons of the test split increasingly have a style that the other splits lack.\n";
    }
    if let (Some(hash), Some(mode)) = (&settings.pack_hash, &settings.pack_mode) {
        let relation = if mode == "replace" {
            "instead of"
        } else {
            "in addition to"
        };
        write!(
            text,
            "The pictures contain icons of a pack {relation} the generated ones, so the license of the pack\n\
             applies to them. Splits with the same pack share its icons.\n\n\
             pack {hash}\n"
        )
        .expect("memory");
    }
    text
}

fn labels(mode: Mode, manifest: &Manifest) -> String {
    let mut text = "## Labels\n\n\
        A label is the action that the rules choose for a car in the state of the frame, not the move that follows.\n\n\
        | label | here | share | published fixed test set | share |\n|---|---|---|---|---|\n"
        .to_owned();
    let published = mode.published_actions();
    let totals = [manifest.actions, published].map(total);
    for (index, action) in Action::STANDARD.into_iter().enumerate() {
        let (here, there) = (manifest.actions[index], published[index]);
        let [share, share_there] = [percent(here, totals[0]), percent(there, totals[1])];
        let name = action.name();
        writeln!(text, "| {index} {name} | {here} | {share} | {there} | {share_there} |").expect("memory");
    }
    text
}

fn concepts(manifest: &Manifest) -> String {
    let mut text = "## Agents\n\nAgents of all frames by concept. Agents without a concept count by type.\n\n\
         | concept | here | share |\n|---|---|---|\n"
        .to_owned();
    for (concept, count) in &manifest.concepts {
        writeln!(text, "| {concept} | {count} | {} |", percent(*count, manifest.agents)).expect("memory");
    }
    text
}

fn atoms(manifest: &Manifest) -> String {
    let mut text = "## Facts\n\nTrue atoms of all frames. An atom about two agents counts if both\n\
         stand in the view of one agent, which may be one of the two.\n\n\
         | predicate | true |\n|---|---|\n"
        .to_owned();
    for (predicate, count) in &manifest.atoms {
        writeln!(text, "| `{predicate}` | {count} |").expect("memory");
    }
    text
}

fn columns(vocabulary: &Vocabulary) -> String {
    let predicates = |arity: usize| {
        let all = &vocabulary.predicates;
        let names = all.iter().filter(|predicate| predicate.arity == arity);
        names
            .map(|predicate| format!("`{}`", predicate.name))
            .collect::<Vec<_>>()
            .join(", ")
    };
    let mut text = "## Tables\n\n\
        `world-NNNNN/entities.parquet` has one row per agent and frame, in order of tick and agent.\n\n\
        | column | meaning |\n|---|---|\n"
        .to_owned();
    let numbers = ENTITY_NUMBERS.iter().map(|(name, what, _)| (*name, *what));
    for (name, what) in ENTITY_NAMES.into_iter().chain(numbers).chain([VISIBLE]) {
        writeln!(text, "| `{name}` | {what} |").expect("memory");
    }
    write!(
        text,
        "| {} | whether the predicate holds |\n\n\
         `world-NNNNN/pairs.parquet` has one row per ordered pair of agents and frame. The column of a\n\
         predicate is thus one matrix per frame, row by row.\n\n\
         | column | meaning |\n|---|---|\n",
        predicates(1)
    )
    .expect("memory");
    for (name, what) in PAIR_NAMES {
        writeln!(text, "| `{name}` | {what} |").expect("memory");
    }
    write!(
        text,
        "| {} | whether the predicate holds for first and second |\n\n\
         `world-NNNNN/world.json` and `manifest.json` have counts, the seed of each world, and the size and\n\
         SHA-256 of each file.\n",
        predicates(2)
    )
    .expect("memory");
    text
}
