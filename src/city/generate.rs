//! Generates a map from its configuration.
//!
//! A city of n x m blocks has n + 1 streets across and m + 1 streets down, so that streets also run along all four edges of
//! the world. Where two streets meet is an intersection, except at the four corners of the world.

use super::{CityMap, Ground, Heading, Layout};
use crate::config::{Building, Buildings, Located, MapConfig, Widths};
use crate::diag::{Code, Diagnostic};
use crate::rng::{Purpose, RngExt, Seed};
use ndarray::{Array2, Axis, Slice};
use std::ops::Range;

/// The largest map in cells: 4096 x 4096, some 300 MB of layers.
const MAX_CELLS: u64 = 1 << 24;

impl CityMap {
    /// Generates the map of a configuration. Equal configurations give equal maps, whatever the seed of the run.
    ///
    /// # Errors
    /// `limit-exceeded` if it would have more than 4096 x 4096 cells (found before anything is allocated), `invalid-map` for
    /// widths that leave no room, a table of buildings of the wrong shape, or weights that cannot be drawn from.
    pub fn generate(config: &MapConfig) -> Result<CityMap, Diagnostic> {
        let layout = check_layout(&config.blocks, &config.widths)?;
        let buildings = choose_buildings(&config.buildings, &config.blocks)?;
        let shape = (layout.rows() as usize, layout.cols() as usize);
        let mut map = CityMap {
            name: config.name.clone(),
            layout,
            ground: Array2::from_elem(shape, Ground::Traffic),
            mid_line: Array2::from_elem(shape, false),
            building: Array2::from_elem(shape, None),
            block: Array2::zeros(shape),
            entrance: Array2::zeros(shape),
            outline: Array2::zeros(shape),
            inside: Array2::zeros(shape),
        };
        map.lay_blocks(&buildings);
        map.lay_intersections();
        Ok(map)
    }

    /// Walking streets, buildings and the mid lines along them. What stays untouched is traffic street.
    fn lay_blocks(&mut self, buildings: &[Vec<Building>]) {
        let layout = self.layout;
        let [block_rows, block_cols] = layout.blocks();
        for block_row in 0..block_rows {
            for block_col in 0..block_cols {
                let (top, left) = (layout.block_start(block_row), layout.block_start(block_col));
                let side = layout.block_side();
                fill(&mut self.ground, top..top + side, left..left + side, Ground::Walking);
                let number = (block_row * block_cols + block_col + 1).unsigned_abs();
                for row in 0..2 {
                    for col in 0..2 {
                        let kind = buildings[(2 * block_row + row) as usize][(2 * block_col + col) as usize];
                        let rows = layout.building_span(block_row, row);
                        let cols = layout.building_span(block_col, col);
                        fill(&mut self.ground, rows.clone(), cols.clone(), Ground::Other);
                        fill(&mut self.building, rows.clone(), cols.clone(), Some(kind));
                        fill(&mut self.block, rows, cols, number);
                    }
                }
            }
        }
        for street in 0..=block_rows {
            let middle = layout.mid_line(street);
            for block in 0..block_cols {
                fill(&mut self.mid_line, middle..middle + 1, layout.built_span(block), true);
            }
        }
        for street in 0..=block_cols {
            let middle = layout.mid_line(street);
            for block in 0..block_rows {
                fill(&mut self.mid_line, layout.built_span(block), middle..middle + 1, true);
            }
        }
    }

    /// Crossings and the three masks of intersections, numbered row by row.
    fn lay_intersections(&mut self) {
        let layout = self.layout;
        let [block_rows, block_cols] = layout.blocks();
        let mut number = 0;
        for street_row in 0..=block_rows {
            for street_col in 0..=block_cols {
                let row_at_edge = street_row == 0 || street_row == block_rows;
                let col_at_edge = street_col == 0 || street_col == block_cols;
                if row_at_edge && col_at_edge {
                    continue;
                }
                number += 1;
                let (rows, cols) = (
                    layout.intersection_span(street_row),
                    layout.intersection_span(street_col),
                );
                // The square reaches beyond the world where a street runs along its edge; what is left has no outline there.
                fill(&mut self.inside, rows.clone(), cols.clone(), number);
                for entering in Heading::ALL {
                    self.lay_side(entering, street_row, street_col, number);
                }
            }
        }
    }

    /// The side of an intersection that cars with this heading enter by, if a street leads up to it from that side.
    fn lay_side(&mut self, entering: Heading, street_row: i32, street_col: i32, number: u32) {
        let layout = self.layout;
        let (street, end) = match entering {
            Heading::Down | Heading::Up => (street_col, street_row),
            Heading::Left | Heading::Right => (street_row, street_col),
        };
        let across = layout.intersection_span(street);
        let along = layout.intersection_span(end);
        let blocks_along = match entering {
            Heading::Down | Heading::Up => layout.blocks()[0],
            Heading::Left | Heading::Right => layout.blocks()[1],
        };
        let forward = matches!(entering, Heading::Down | Heading::Right);
        // A street that comes from beyond the world is none, and a street along the edge is a through road: its cars have no
        // line to wait at, the cars of the stem have.
        let beyond = if forward { end == 0 } else { end == blocks_along };
        let through = across.start < 0
            || across.end
                > if entering.across_is_row() {
                    layout.rows()
                } else {
                    layout.cols()
                };
        if beyond || through {
            return;
        }
        let line = if forward { along.start } else { along.end - 1 };
        let middle = layout.mid_line(street);
        // Cars keep right: those that go down or left use the cells before the mid line.
        let half = match entering {
            Heading::Down | Heading::Left => across.start..middle,
            Heading::Up | Heading::Right => middle + 1..across.end,
        };
        let sidewalk = layout.sidewalk();
        let crossing = if forward {
            line..line + sidewalk
        } else {
            line + 1 - sidewalk..line + 1
        };
        let street_span = layout.street_span(street);
        if entering.across_is_row() {
            fill(&mut self.ground, street_span, crossing, Ground::Crossing);
            fill(&mut self.inside, across.clone(), line..line + 1, 0);
            fill(&mut self.outline, across, line..line + 1, number);
            fill(&mut self.entrance, half, line..line + 1, number);
        } else {
            fill(&mut self.ground, crossing, street_span, Ground::Crossing);
            fill(&mut self.inside, line..line + 1, across.clone(), 0);
            fill(&mut self.outline, line..line + 1, across, number);
            fill(&mut self.entrance, line..line + 1, half, number);
        }
    }
}

impl Heading {
    /// Whether a line across the way of this heading is counted in rows, as for cars that drive left or right.
    const fn across_is_row(self) -> bool {
        matches!(self, Heading::Left | Heading::Right)
    }
}

/// Sets a rectangle of a layer; what lies beyond the world is left out.
fn fill<T: Clone>(layer: &mut Array2<T>, rows: Range<i32>, cols: Range<i32>, value: T) {
    let clip = |range: Range<i32>, size: usize| {
        let bound = |at: i32| usize::try_from(at).unwrap_or(0).min(size);
        bound(range.start)..bound(range.end)
    };
    let (rows, cols) = (clip(rows, layer.nrows()), clip(cols, layer.ncols()));
    let mut part = layer.slice_each_axis_mut(|axis| {
        let range = if axis.axis == Axis(0) { &rows } else { &cols };
        Slice::from(range.clone())
    });
    part.fill(value);
}

/// The layout, if the sizes make sense.
fn check_layout(blocks: &Located<[u32; 2]>, widths: &Located<Widths>) -> Result<Layout, Diagnostic> {
    let invalid = |message: String, label: &str, help: &str| {
        Err(Diagnostic::new(Code::InvalidMap, message)
            .at(widths.span, label)
            .help(help))
    };
    if blocks.value.contains(&0) {
        return Err(Diagnostic::new(Code::InvalidMap, "a city needs at least one block")
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
            format!("a traffic street of {street} cells has no room for two lanes"),
            "too narrow",
            "a traffic street takes at least 3 cells: a lane, the mid line and another lane",
        );
    }
    if street.is_multiple_of(2) {
        return invalid(
            format!("a traffic street of {street} cells has no middle"),
            "the street must be an odd number of cells wide",
            &format!(
                "the mid line is a cell wide and both sides are equal: take {} or {}",
                street - 1,
                street.saturating_add(1)
            ),
        );
    }
    if sidewalk == 0 || building == 0 {
        let part = if sidewalk == 0 { "sidewalk" } else { "building" };
        return invalid(
            format!("a {part} of no width"),
            "must be at least 1",
            "pedestrians walk between street and building, and start and arrive beside buildings: give both at least 1 cell",
        );
    }
    let [street, sidewalk, building, inner_sidewalk] = [street, sidewalk, building, inner_sidewalk].map(u64::from);
    let period = street + 2 * sidewalk + 2 * building + inner_sidewalk;
    let [rows, cols] = blocks
        .value
        .map(|count| u128::from(count) * u128::from(period) + u128::from(street));
    if rows * cols > u128::from(MAX_CELLS) {
        return Err(Diagnostic::new(
            Code::LimitExceeded,
            format!("a map of {rows} x {cols} cells is too large"),
        )
        .at(blocks.span, "this many blocks")
        .also(widths.span, "of this size")
        .help(format!(
            "a map may have up to {MAX_CELLS} cells, for example 4096 x 4096: take fewer or smaller blocks"
        )));
    }
    Ok(Layout::new(blocks.value, widths.value))
}

/// The building types, two rows and two columns a block.
fn choose_buildings(
    buildings: &Located<Buildings>,
    blocks: &Located<[u32; 2]>,
) -> Result<Vec<Vec<Building>>, Diagnostic> {
    let [block_rows, block_cols] = blocks.value.map(|count| count as usize);
    let (rows, cols) = (2 * block_rows, 2 * block_cols);
    match &buildings.value {
        Buildings::Fixed(table) => {
            let wrong = |what: String| {
                Err(Diagnostic::new(Code::InvalidMap, what)
                    .at(buildings.span, format!("{rows} rows of {cols} buildings are needed"))
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
                Some(row) => wrong(format!(
                    "row {} of the buildings has {} of them",
                    row + 1,
                    table[row].len()
                )),
                None => Ok(table.clone()),
            }
        }
        Buildings::Random { seed, weights } => {
            let total: f64 = weights.iter().map(|&(_, weight)| weight).sum();
            if weights.iter().any(|&(_, weight)| weight.is_nan() || weight < 0.0) || !(total > 0.0 && total.is_finite())
            {
                return Err(
                    Diagnostic::new(Code::InvalidMap, "weights that no building can be drawn from")
                        .at(buildings.span, "here")
                        .help("give numbers that are not negative and not all zero; they need not sum to one"),
                );
            }
            let mut table = vec![vec![weights[0].0; cols]; rows];
            for block_row in 0..block_rows {
                for block_col in 0..block_cols {
                    let block = (block_row * block_cols + block_col) as u64 + 1;
                    let mut stream = Seed(*seed).stream(Purpose::Buildings, block, 0);
                    for (row, col) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
                        let drawn = draw(weights, total * stream.random::<f64>());
                        table[2 * block_row + row][2 * block_col + col] = drawn;
                    }
                }
            }
            Ok(table)
        }
    }
}

/// The building type at a point of the line on which the weights are laid end to end.
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

    fn generate(blocks: [u32; 2], widths: Widths, buildings: Buildings) -> Result<CityMap, Code> {
        let config = MapConfig {
            name: "test".into(),
            blocks: located(blocks),
            widths: located(widths),
            buildings: located(buildings),
        };
        CityMap::generate(&config).map_err(|diagnostic| diagnostic.code)
    }

    fn random(weights: &[(Building, f64)]) -> Buildings {
        let weights = weights.to_vec();
        Buildings::Random { seed: 7, weights }
    }

    /// A map with the widths of the paper's and random buildings.
    pub(in crate::city) fn square(blocks: [u32; 2]) -> CityMap {
        let weights = [(Building::House, 1.0), (Building::Store, 1.0)];
        generate(blocks, WIDTHS, random(&weights)).expect("a valid configuration")
    }

    #[test]
    fn impossible_maps_are_told() {
        let houses = || random(&[(Building::House, 1.0)]);
        let widths = |change: fn(&mut Widths)| {
            let mut widths = WIDTHS;
            change(&mut widths);
            generate([2, 2], widths, houses()).map(|map| map.ground.dim())
        };
        assert_eq!(widths(|_| ()), Ok((103, 103)));
        assert_eq!(widths(|widths| widths.street = 1), Err(Code::InvalidMap));
        assert_eq!(widths(|widths| widths.street = 10), Err(Code::InvalidMap));
        assert_eq!(widths(|widths| widths.street = u32::MAX), Err(Code::LimitExceeded));
        assert_eq!(widths(|widths| widths.sidewalk = 0), Err(Code::InvalidMap));
        assert_eq!(widths(|widths| widths.building = 0), Err(Code::InvalidMap));
        assert_eq!(
            widths(|widths| widths.building = 1_000_000_000),
            Err(Code::LimitExceeded)
        );
        assert_eq!(widths(|widths| widths.inner_sidewalk = 0), Ok((93, 93)));

        let blocks = |blocks| generate(blocks, WIDTHS, houses()).map(|map| map.ground.dim());
        assert_eq!(blocks([0, 1]), Err(Code::InvalidMap));
        assert_eq!(blocks([1, 1_000_000_000]), Err(Code::LimitExceeded));
        assert_eq!(blocks([u32::MAX, u32::MAX]), Err(Code::LimitExceeded));
        assert_eq!(blocks([1, 3]), Ok((57, 149)));
    }

    #[test]
    fn buildings_fit_the_blocks_and_the_weights() {
        let map = |buildings| generate([1, 2], WIDTHS, buildings).map(|map| map.building);
        let row = |length| vec![Building::Office; length];
        assert!(map(Buildings::Fixed(vec![row(4), row(4)])).is_ok());
        assert_eq!(map(Buildings::Fixed(vec![row(4)])), Err(Code::InvalidMap));
        assert_eq!(map(Buildings::Fixed(vec![row(4), row(3)])), Err(Code::InvalidMap));

        let house = Building::House;
        for weights in [
            &[][..],
            &[(house, 0.0)],
            &[(house, -1.0)],
            &[(house, f64::NAN)],
            &[(house, f64::INFINITY)],
        ] {
            assert_eq!(map(random(weights)), Err(Code::InvalidMap));
        }
        let layer = map(random(&[(Building::Store, 0.0), (house, 2.0)])).expect("valid weights");
        assert_eq!(layer.iter().flatten().filter(|&&building| building != house).count(), 0);
        assert_eq!(layer.iter().flatten().count(), 8 * 10 * 10);
    }

    #[test]
    fn every_building_is_drawn_for_itself() {
        let map = square([20, 20]);
        let cells_of = |building| map.building.iter().filter(|&&here| here == Some(building)).count();
        let houses = cells_of(Building::House) / (10 * 10);
        let stores = cells_of(Building::Store) / (10 * 10);
        assert_eq!(houses + stores, 1600);
        assert!((700..900).contains(&houses), "{houses} of 1600 buildings are houses");
        // More rows of blocks do not change the rows above.
        let fewer = square([3, 20]);
        assert!(
            fewer
                .building
                .indexed_iter()
                .all(|(place, &building)| map.building[place] == building)
        );
    }
}
