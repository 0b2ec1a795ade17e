//! Generates a map from its configuration.
//!
//! A city of n x m blocks has n + 1 horizontal and m + 1 vertical streets, so that streets also run along all four
//! edges of the world. Two streets meet at an intersection, except at the four corners of the world.

use crate::city::codes;
use crate::city::road_map::RoadMap;
use crate::city::zone;
use crate::city::{Blocks, Building, Buildings, MapConfig, Terrain, Widths};
use crate::city::{CityMap, Layout};
use crate::diag::{self, Diagnostic};
use crate::located::Located;
use crate::rng::{Purpose, RngExt, Seed};
use std::sync::Arc;

impl Purpose {
    /// The building types of a generated map; index: block.
    pub const BUILDINGS: Purpose = Purpose::new(1);
}

/// The maximum length of a side, in cells.
const MAX_SIDE: u64 = 1 << 20;
/// The maximum number of blocks. The buildings of a block take 4 bytes.
const MAX_BLOCKS: u64 = 1 << 20;

impl CityMap {
    /// Generates the map of a configuration. Equal configurations give equal maps, whatever the seed of the run.
    ///
    /// # Errors
    /// `limit-exceeded` if the map would have more than 2^20 rows, columns or blocks; the function checks this before
    /// it allocates memory. `invalid-map` for widths that leave no room, a table of buildings of the wrong shape,
    /// unusable weights, or zones that the map has no place for.
    pub fn generate(config: &MapConfig) -> Result<CityMap, Diagnostic> {
        let map = match &config.terrain {
            Terrain::Blocks(Blocks {
                blocks,
                widths,
                buildings,
            }) => {
                let layout = check_layout(blocks, widths)?;
                let buildings = choose_buildings(buildings, blocks)?;
                CityMap::of_blocks(config.name.clone(), layout, buildings)
            }
            Terrain::Roads { roads } => {
                let map = RoadMap::new(Arc::clone(&roads.value));
                CityMap::of_roads(config.name.clone(), map)
            }
        };
        let zones = zone::locate(config, &map)?;
        Ok(map.with_zones(zones))
    }
}

/// Returns the layout if the sizes are valid.
fn check_layout(blocks: &Located<[u32; 2]>, widths: &Located<Widths>) -> Result<Layout, Diagnostic> {
    let invalid = |message: String, label: &str, help: &str| {
        Err(Diagnostic::new(codes::INVALID_MAP, message)
            .at(widths.span, label)
            .help(help))
    };
    if blocks.value.contains(&0) {
        return Err(Diagnostic::new(codes::INVALID_MAP, "a city needs at least one block")
            .at(blocks.span, "no block in one of the two directions")
            .help("give two numbers, each at least 1: rows and columns of blocks"));
    }
    let Widths {
        street,
        sidewalk,
        building,
        inner_sidewalk,
    } = widths.value;
    if street < 3 {
        return invalid(
            format!("a traffic street of {street} cells is too narrow for two lanes"),
            "too narrow",
            "a traffic street needs at least 3 cells: two lanes and the mid line",
        );
    }
    if street.is_multiple_of(2) {
        return invalid(
            format!("a traffic street of {street} cells has no middle cell"),
            "the width must be odd",
            &format!(
                "the mid line is one cell wide and both sides are equal: use {} or {}",
                street - 1,
                street.saturating_add(1)
            ),
        );
    }
    if sidewalk == 0 || building == 0 {
        let part = if sidewalk == 0 { "sidewalk" } else { "building" };
        return invalid(
            format!("the {part} has no width"),
            "must be at least 1",
            "pedestrians walk between street and building, and start beside buildings: both need at least 1 cell",
        );
    }
    let [street, sidewalk, building, inner_sidewalk] = [street, sidewalk, building, inner_sidewalk].map(u64::from);
    let period = street + 2 * sidewalk + 2 * building + inner_sidewalk;
    let [rows, cols] = blocks
        .value
        .map(|count| u128::from(count) * u128::from(period) + u128::from(street));
    let count = u64::from(blocks.value[0]) * u64::from(blocks.value[1]);
    if rows.max(cols) > u128::from(MAX_SIDE) || count > MAX_BLOCKS {
        return Err(Diagnostic::new(
            diag::codes::LIMIT_EXCEEDED,
            format!("a map of {rows} x {cols} cells and {count} blocks is too large"),
        )
        .at(blocks.span, "this many blocks")
        .also(widths.span, "of this size")
        .help(format!(
            "the limits are {MAX_SIDE} rows, {MAX_SIDE} columns and {MAX_BLOCKS} blocks: use fewer or smaller blocks"
        )));
    }
    Ok(Layout::new(blocks.value, widths.value))
}

/// Returns the four buildings of each block, row by row; the blocks are in row order too.
fn choose_buildings(
    buildings: &Located<Buildings>,
    blocks: &Located<[u32; 2]>,
) -> Result<Vec<[Building; 4]>, Diagnostic> {
    let [block_rows, block_cols] = blocks.value.map(|count| count as usize);
    let (rows, cols) = (2 * block_rows, 2 * block_cols);
    match &buildings.value {
        Buildings::Fixed(table) => {
            let wrong = |what: String| {
                Err(Diagnostic::new(codes::INVALID_MAP, what)
                    .at(buildings.span, format!("expected {rows} rows of {cols} buildings"))
                    .also(blocks.span, format!("{block_rows} x {block_cols} blocks"))
                    .help("a block has four buildings: give two rows of two buildings for each block"))
            };
            if table.len() != rows {
                return wrong(format!(
                    "{} rows of buildings for {block_rows} rows of blocks",
                    table.len()
                ));
            }
            match table.iter().position(|row| row.len() != cols) {
                Some(row) => wrong(format!("row {} has {} buildings", row + 1, table[row].len())),
                None => {
                    let of_block = |row: usize, col: usize| {
                        let [upper, lower] = [&table[2 * row], &table[2 * row + 1]];
                        [upper[2 * col], upper[2 * col + 1], lower[2 * col], lower[2 * col + 1]]
                    };
                    let rows = (0..block_rows).map(|row| (0..block_cols).map(move |col| of_block(row, col)));
                    Ok(rows.flatten().collect())
                }
            }
        }
        Buildings::Random { seed, weights } => {
            let total: f64 = weights.iter().map(|&(_, weight)| weight).sum();
            if weights.iter().any(|&(_, weight)| weight.is_nan() || weight < 0.0) || !(total > 0.0 && total.is_finite())
            {
                return Err(
                    Diagnostic::new(codes::INVALID_MAP, "the weights of the buildings are unusable")
                        .at(buildings.span, "here")
                        .help("give non-negative numbers that are not all zero; they need not sum to one"),
                );
            }
            let blocks = 1..=(block_rows * block_cols) as u64;
            Ok(blocks
                .map(|block| {
                    let mut stream = Seed(*seed).stream(Purpose::BUILDINGS, block, 0);
                    std::array::from_fn(|_| draw(weights, total * stream.random::<f64>()))
                })
                .collect())
        }
    }
}

/// Returns the building type at a point of the line on which the weights are laid end to end.
fn draw(weights: &[(Building, f64)], point: f64) -> Building {
    let mut end = 0.0;
    let mut last = weights[0].0;
    for &(building, weight) in weights.iter().filter(|&&(_, weight)| weight > 0.0) {
        end += weight;
        last = building;
        if point < end {
            break;
        }
    }
    last
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::diag::{Sources, Span};

    const WIDTHS: Widths = Widths {
        street: 11,
        sidewalk: 5,
        building: 10,
        inner_sidewalk: 5,
    };

    fn located<T>(value: T) -> Located<T> {
        let span = Span::new(Sources::new().add("map", ""), 0..0);
        Located { value, span }
    }

    fn generate(blocks: [u32; 2], widths: Widths, buildings: Buildings) -> Result<CityMap, diag::Code> {
        let config = MapConfig {
            name: "test".into(),
            terrain: Terrain::Blocks(Blocks {
                blocks: located(blocks),
                widths: located(widths),
                buildings: located(buildings),
            }),
            zones: Vec::new(),
        };
        CityMap::generate(&config).map_err(|diagnostic| diagnostic.code)
    }

    fn random(weights: &[(Building, f64)]) -> Buildings {
        let weights = weights.to_vec();
        Buildings::Random { seed: 7, weights }
    }

    /// Generates a map with the paper's widths and random buildings.
    pub(in crate::city) fn square(blocks: [u32; 2]) -> CityMap {
        let weights = [(Building::House, 1.0), (Building::Store, 1.0)];
        generate(blocks, WIDTHS, random(&weights)).expect("a valid configuration")
    }

    #[test]
    fn impossible_maps_are_rejected() {
        let houses = || random(&[(Building::House, 1.0)]);
        let widths = |change: fn(&mut Widths)| {
            let mut widths = WIDTHS;
            change(&mut widths);
            generate([2, 2], widths, houses()).map(|map| (map.rows(), map.cols()))
        };
        assert_eq!(widths(|_| ()), Ok((103, 103)));
        assert_eq!(widths(|widths| widths.street = 1), Err(codes::INVALID_MAP));
        assert_eq!(widths(|widths| widths.street = 10), Err(codes::INVALID_MAP));
        assert_eq!(
            widths(|widths| widths.street = u32::MAX),
            Err(diag::codes::LIMIT_EXCEEDED)
        );
        assert_eq!(widths(|widths| widths.sidewalk = 0), Err(codes::INVALID_MAP));
        assert_eq!(widths(|widths| widths.building = 0), Err(codes::INVALID_MAP));
        assert_eq!(
            widths(|widths| widths.building = 1_000_000_000),
            Err(diag::codes::LIMIT_EXCEEDED)
        );
        assert_eq!(widths(|widths| widths.inner_sidewalk = 0), Ok((93, 93)));

        let blocks = |blocks| generate(blocks, WIDTHS, houses()).map(|map| (map.rows(), map.cols()));
        assert_eq!(blocks([0, 1]), Err(codes::INVALID_MAP));
        assert_eq!(blocks([1, 1_000_000_000]), Err(diag::codes::LIMIT_EXCEEDED));
        assert_eq!(blocks([u32::MAX, u32::MAX]), Err(diag::codes::LIMIT_EXCEEDED));
        assert_eq!(blocks([1, 3]), Ok((57, 149)));
    }

    #[test]
    fn buildings_fit_the_blocks_and_the_weights() {
        let map = |buildings| generate([1, 2], WIDTHS, buildings).map(|map| map.buildings().to_vec());
        let row = |length| vec![Building::Office; length];
        assert!(map(Buildings::Fixed(vec![row(4), row(4)])).is_ok());
        assert_eq!(map(Buildings::Fixed(vec![row(4)])), Err(codes::INVALID_MAP));
        assert_eq!(map(Buildings::Fixed(vec![row(4), row(3)])), Err(codes::INVALID_MAP));

        let house = Building::House;
        for weights in [
            &[][..],
            &[(house, 0.0)],
            &[(house, -1.0)],
            &[(house, f64::NAN)],
            &[(house, f64::INFINITY)],
        ] {
            assert_eq!(map(random(weights)), Err(codes::INVALID_MAP));
        }
        assert_eq!(
            map(random(&[(Building::Store, 0.0), (house, 2.0)])),
            Ok(vec![[house; 4]; 2])
        );
    }

    #[test]
    fn buildings_are_drawn_independently() {
        let map = square([20, 20]);
        let all = map.buildings();
        let houses = all
            .iter()
            .flatten()
            .filter(|&&building| building == Building::House)
            .count();
        assert_eq!(all.len(), 400);
        assert!((700..900).contains(&houses), "{houses} of 1600 buildings are houses");
        // More rows of blocks do not change the rows above.
        assert_eq!(square([3, 20]).buildings(), &all[..60]);
    }
}
