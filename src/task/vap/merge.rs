//! Joins shards of a data set.

use crate::cancel::Cancel;
use crate::files::{Folder, Overwrite};
use crate::sim::Vocabulary;
use crate::task::shard;
use crate::task::vap::dataset::Monitor;
use crate::task::vap::folder::Description;
use crate::task::vap::{Dataset, DatasetError, DatasetSummary, Manifest, card, folder};
use std::num::NonZeroUsize;
use std::path::Path;

/// Joins data sets that are shards. Copies their worlds to the folder `out`, which may have some already, and compares their
/// files with the hashes of the records. `vocabulary` is that of the configuration [`Mode::config`](super::Mode::config).
///
/// `progress` receives the numbers of worlds copied and to copy; `cancel` is polled.
///
/// # Errors
/// `invalid-shard` if the shards are not all of one data set, or were made with another configuration or other rules
/// than those with the hashes `made_with`; `invalid-data-set` if a file of a shard has changed; otherwise as for
/// [`DatasetWriter::write`](super::DatasetWriter::write).
pub fn merge(
    out: &Path,
    shards: &[Dataset],
    (vocabulary, made_with): (&Vocabulary, [&str; 2]),
    overwrite: Overwrite,
    progress: &(dyn Fn(u64, u64) + Sync),
    cancel: &Cancel,
) -> Result<DatasetSummary, DatasetError> {
    let mut known = Vec::new();
    for set in shards {
        let file = folder::read_shard(set.folder())?;
        let origin = (set.manifest().settings.clone(), file.all());
        known.push((set.folder().path().display().to_string(), file.shard, origin));
    }
    let order = shard::in_order(&known)?;
    let (settings, all) = &known[order[0]].2;
    if [&settings.config_hash, &settings.rules_hash] != made_with {
        let message = "the shards were made with another version of the configuration, or other rules";
        return Err(shard::invalid(message).into());
    }
    let mut worlds = Vec::new();
    for &index in &order {
        let (name, shard, _) = &known[index];
        let records = &shards[index].manifest().worlds;
        if !records.iter().map(|record| record.world).eq(shard.part(all)) {
            let fault = shard::invalid(format!("`{name}` does not have the worlds of shard {shard}"));
            return Err(fault.help("`logicity vap make` completes it").into());
        }
        worlds.extend(records.iter().map(|record| (shards[index].folder(), record)));
    }
    let folder = &Folder::make(out)?;
    let description = Description::begin(folder, settings, overwrite)?;
    folder::note_shard(folder, None)?;
    folder::remove_partials(folder)?;
    worlds.retain(|(_, record)| !folder.has(&folder::world_name(record.world)));
    let monitor = Monitor::new(worlds.len() as u64, progress, cancel);
    monitor.run(NonZeroUsize::MIN, &worlds, |&(from, record), step| {
        folder::copy_world(from, folder, settings, record)?;
        step(1)?;
        Ok(())
    })?;
    let manifest = Manifest::new(settings.clone(), folder::records(folder)?);
    let card = card::card(shards[order[0]].mode(), &manifest, vocabulary);
    description.finish(folder, &card, &manifest)?;
    Ok(DatasetSummary {
        made: worlds.len(),
        manifest,
    })
}
