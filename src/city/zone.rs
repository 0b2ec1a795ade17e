//! Finds the cells of zones.

use crate::city::codes;
use crate::city::{Area, Building, Buildings, CityMap, Landmarks, Layout, MapConfig, Rectangle};
use crate::city::{Sample, ZoneConfig, ZonePart};
use crate::diag::{self, Diagnostic};
use crate::located::Located;
use crate::rng::{Purpose, RngExt, Seed};
use std::sync::Arc;

impl Purpose {
    /// The samples of zones; index: 0 for blocks, otherwise the kind of building from 1.
    pub const ZONES: Purpose = Purpose::new(60);
}

/// The maximum number of rectangles in all zones of a map.
const RECTANGLES_MAX: usize = 1 << 22;

/// Returns the name and the cells of each zone of a configuration, in its order. `map` has no zones yet.
///
/// # Errors
/// `invalid-map` for a part that refers to something which is not on the map, and for a zone without cells.
/// `limit-exceeded` if the zones take too much memory.
pub(super) fn locate(config: &MapConfig, map: &CityMap) -> Result<Vec<(String, Arc<Area>)>, Diagnostic> {
    let mut room = RECTANGLES_MAX;
    let zone = |zone: &ZoneConfig| Ok((zone.name.value.clone(), Arc::new(cells(zone, config, map, &mut room)?)));
    config.zones.iter().map(zone).collect()
}

/// Returns the cells of a zone. `room` is what remains of [`RECTANGLES_MAX`].
fn cells(zone: &ZoneConfig, config: &MapConfig, map: &CityMap, room: &mut usize) -> Result<Area, Diagnostic> {
    let name = &zone.name;
    let too_large = |fault: Diagnostic| {
        let fault = fault.at(name.span, "this zone");
        fault.help("use fewer parts, or a smaller map")
    };
    let mut rectangles: Vec<Rectangle> = Vec::new();
    for part in &zone.parts {
        let around = landmarks(part, config, map)?;
        *room = room.checked_sub(around.len()).ok_or_else(|| {
            let message = format!("the zones of the map have more than {RECTANGLES_MAX} rectangles");
            too_large(Diagnostic::new(diag::codes::LIMIT_EXCEEDED, message))
        })?;
        rectangles.extend(around.iter().map(|rectangle| rectangle.grown(part.value.within)));
    }
    let area = Area::of_rectangles([map.rows(), map.cols()], &rectangles).ok_or_else(|| {
        let message = format!("the zone `{}` takes too much memory", name.value);
        too_large(Diagnostic::new(diag::codes::LIMIT_EXCEEDED, message))
    })?;
    if !area.is_empty() {
        return Ok(area);
    }
    let missing: Vec<&str> = (zone.parts.iter())
        .filter_map(|part| match part.value.around {
            Landmarks::Buildings(kind) => Some(kind.name()),
            _ => None,
        })
        .collect();
    let message = format!(
        "the zone `{}` has no cells: the map has no {}",
        name.value,
        missing.join(" and no ")
    );
    let fault = Diagnostic::new(codes::INVALID_MAP, message).at(name.span, "this zone");
    let fault = match config.blocks() {
        Some(blocks) => fault.also(blocks.buildings.span, "the buildings"),
        None => fault,
    };
    Err(fault.help("add such a building to the map, choose another kind, or remove the zone"))
}

/// Returns the landmarks of a part.
fn landmarks(part: &Located<ZonePart>, config: &MapConfig, map: &CityMap) -> Result<Vec<Rectangle>, Diagnostic> {
    let [rows, cols] = [map.rows(), map.cols()];
    let invalid = |message: String, help: String| {
        let fault = Diagnostic::new(codes::INVALID_MAP, message).at(part.span, "this part of the zone");
        fault.help(help)
    };
    let layout = map.layout().ok_or_else(|| {
        invalid(
            "the map is a road network, which has no blocks, streets with numbers or buildings".into(),
            "give the cells of the zone, for example `{rows: [41, 61], cols: [41, 61]}`".into(),
        )
    });
    let block = |layout: &Layout, [row, col]: [i32; 2]| Rectangle {
        rows: layout.block_start(row)..layout.block_start(row) + layout.block_side(),
        cols: layout.block_start(col)..layout.block_start(col) + layout.block_side(),
    };
    let street = |layout: &Layout, number: u32, blocks: i32, direction: &str, edge: &str| {
        let streets = blocks.unsigned_abs() + 1;
        match (1..=streets).contains(&number) {
            true => Ok(layout.street_span(number.cast_signed() - 1)),
            false => Err(invalid(
                format!("the map has no {direction} street {number}"),
                format!("its {direction} streets have the numbers 1 to {streets}, from the {edge} edge"),
            )),
        }
    };
    Ok(match part.value.around {
        Landmarks::Cells {
            rows: [top, bottom],
            cols: [left, right],
        } => {
            let on_axis = |last: u32, cells: i32| i64::from(last) < i64::from(cells);
            if !on_axis(bottom, rows) || !on_axis(right, cols) {
                let message = format!("rows {top} to {bottom} and columns {left} to {right} are not all on the map");
                let help = format!(
                    "the map has the rows 0 to {} and the columns 0 to {}",
                    rows - 1,
                    cols - 1
                );
                return Err(invalid(message, help));
            }
            let span = |first: u32, last: u32| first.cast_signed()..last.cast_signed() + 1;
            vec![Rectangle {
                rows: span(top, bottom),
                cols: span(left, right),
            }]
        }
        Landmarks::Block([row, col]) => {
            let layout = layout?;
            let [block_rows, block_cols] = layout.blocks().map(i32::unsigned_abs);
            if !(1..=block_rows).contains(&row) || !(1..=block_cols).contains(&col) {
                let message = format!("the map has no block [{row}, {col}]");
                let help = format!("its blocks are [1, 1] to [{block_rows}, {block_cols}]: row and column of blocks");
                return Err(invalid(message, help));
            }
            vec![block(layout, [row, col].map(|number| number.cast_signed() - 1))]
        }
        Landmarks::HorizontalStreet(number) => {
            let layout = layout?;
            vec![Rectangle {
                rows: street(layout, number, layout.blocks()[0], "horizontal", "upper")?,
                cols: 0..cols,
            }]
        }
        Landmarks::VerticalStreet(number) => {
            let layout = layout?;
            vec![Rectangle {
                rows: 0..rows,
                cols: street(layout, number, layout.blocks()[1], "vertical", "left")?,
            }]
        }
        Landmarks::Buildings(kind) => {
            layout?;
            map.buildings_of(kind).collect()
        }
        Landmarks::SomeBuildings(kind, sample) => {
            layout?;
            let all = map.buildings_of(kind).collect();
            let index = Building::ALL.iter().zip(1..).find(|(known, _)| **known == kind);
            drawn(all, sample, config, index.map_or(0, |(_, index)| index)).map_err(|count| {
                let message = format!(
                    "cannot draw {} of the kind {}: the map has {count}",
                    sample.count,
                    kind.name()
                );
                invalid(
                    message,
                    "use a smaller `sample`, or add such buildings to the map".into(),
                )
            })?
        }
        Landmarks::SomeBlocks(sample) => {
            let layout = layout?;
            let blocks = layout.blocks();
            let all = (0..blocks[0]).flat_map(|row| (0..blocks[1]).map(move |col| [row, col]));
            drawn(all.map(|place| block(layout, place)).collect(), sample, config, 0).map_err(|count| {
                let message = format!("cannot draw {} blocks: the map has {count}", sample.count);
                invalid(message, "use a smaller `sample_blocks`".into())
            })?
        }
    })
}

/// Draws a sample. If there are fewer elements, returns their number as error.
fn drawn(mut all: Vec<Rectangle>, sample: Sample, config: &MapConfig, index: u64) -> Result<Vec<Rectangle>, usize> {
    let (count, available) = (sample.count as usize, all.len());
    if count > available {
        return Err(available);
    }
    let seed = sample
        .seed
        .unwrap_or(match config.blocks().map(|blocks| &blocks.buildings.value) {
            Some(Buildings::Random { seed, .. }) => *seed,
            Some(Buildings::Fixed(_)) | None => 0,
        });
    let mut stream = Seed(seed).stream(Purpose::ZONES, index, 0);
    for at in 0..count {
        all.swap(at, stream.random_range(at..available));
    }
    all.truncate(count);
    Ok(all)
}
