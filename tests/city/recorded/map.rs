//! The map, its road graph and its start cells equal those of the published program.

use super::{folder, square_5x5};
use logicity::city::{AgentKind, Building, Routing, TripEnds};
use logicity::city::{Cell, CityMap, Ground, Lane, Places, Router};
use ndarray::{Array2, Array3, Axis};
use ndarray_npy::NpzReader;
use std::collections::BTreeSet;
use std::fs::File;
use std::sync::Arc;

/// The value of a function for each cell of a map.
fn layer<T>(map: &CityMap, of: impl Fn(Cell) -> T) -> Array2<T> {
    let shape = (map.rows() as usize, map.cols() as usize);
    Array2::from_shape_fn(shape, |(row, col)| of(Cell::new(row as i32, col as i32)))
}

#[test]
fn every_layer_of_the_map_equals_the_recorded_one() {
    let map = square_5x5();
    let mut npz = NpzReader::new(File::open(folder().join("map_square_5x5.npz")).unwrap()).unwrap();
    let street: Array2<f32> = npz.by_name("street").unwrap();
    let building: Array2<i16> = npz.by_name("building").unwrap();
    let block: Array2<i16> = npz.by_name("block").unwrap();
    let mid_line: Array2<bool> = npz.by_name("midline").unwrap();
    let intersection: Array3<i16> = npz.by_name("intersection").unwrap();

    assert_eq!(layer(&map, |cell| map.is_mid_line(cell)), mid_line);
    let ground = street.mapv(|code| match code {
        0.0 => Ground::Other,
        1.0 => Ground::Walking,
        -1.0 => Ground::Crossing,
        _ => Ground::Traffic,
    });
    assert_eq!(layer(&map, |cell| map.ground_at(cell).unwrap()), ground);
    let building = building.mapv(|code| match code {
        3 => Some(Building::House),
        4 => Some(Building::GasStation),
        5 => Some(Building::Office),
        6 => Some(Building::Garage),
        7 => Some(Building::Store),
        _ => None,
    });
    assert_eq!(layer(&map, |cell| map.building_at(cell)), building);
    let block_of_building = |cell| {
        map.building_at(cell)
            .and_then(|_| map.layout().unwrap().block_at(cell))
            .unwrap_or(0)
    };
    assert_eq!(layer(&map, block_of_building), block.mapv(|number| number as u32));
    let recorded = |mask: usize| intersection.index_axis(Axis(0), mask).mapv(|number| number as u32);
    let at = |kind| layer(&map, |cell| map.at_intersection(kind, cell).unwrap_or(0));
    assert_eq!(at(AgentKind::Car), recorded(0));
    assert_eq!(at(AgentKind::Pedestrian), recorded(1));
    assert_eq!(layer(&map, |cell| map.in_intersection(cell).unwrap_or(0)), recorded(2));
}

#[test]
fn the_number_of_start_cells_equals_that_of_the_published_program() {
    let router = Router::new(Arc::new(square_5x5()), Routing::Weighted);
    let count = |ends, kind| {
        let regions = [Some(60), Some(100), Some(120), Some(140), None];
        regions.map(|region| Places::new(&router, ends, region, None).count(kind))
    };
    assert_eq!(count(TripEnds::Curb, AgentKind::Car), [90, 160, 220, 360, 980]);
    assert_eq!(count(TripEnds::Lane, AgentKind::Car), [50, 100, 120, 160, 520]);
    for ends in TripEnds::ALL {
        assert_eq!(count(ends, AgentKind::Pedestrian), [44, 352, 616, 792, 2244]);
    }
}

#[test]
fn the_road_graph_equals_that_of_the_paper() {
    let router = Router::new(Arc::new(square_5x5()), Routing::Weighted);
    let lanes: Vec<Lane> = router.lanes().collect();
    assert_eq!(lanes.len(), 120);
    assert!(lanes.iter().all(|lane| lane.length() == 26));
    let nodes: BTreeSet<Cell> = lanes.iter().flat_map(|lane| [lane.start, lane.end]).collect();
    assert_eq!(nodes.len(), 240);

    // The connectors are exactly the pairs within reach, and no other pair is close.
    let connectors: BTreeSet<(Cell, Cell)> = router
        .connectors()
        .map(|(from, to)| (lanes[from].end, lanes[to].start))
        .collect();
    assert_eq!(connectors.len(), 416);
    let near = |from: &Lane, to: &Lane| from.end.distance(to.start) <= 25.6;
    let within_reach: BTreeSet<(Cell, Cell)> = (lanes.iter())
        .flat_map(|from| {
            lanes
                .iter()
                .filter(move |to| near(from, to))
                .map(|to| (from.end, to.start))
        })
        .collect();
    assert_eq!(connectors, within_reach);
}
