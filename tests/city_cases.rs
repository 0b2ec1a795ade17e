//! The city against recorded runs of the published simulator.
//!
//! The recorded cases are large and not part of the repository. They are looked for in the folder that the environment variable
//! `LOGICITY_CASES` names, else in `../shared/cases` beside the repository; without them each check says that it was skipped.

use logicity::city::{CityMap, Ground};
use logicity::config::{Building, Buildings, Located, MapConfig, Widths};
use logicity::diag::{Sources, Span};
use ndarray::{Array2, Array3, Axis};
use ndarray_npy::NpzReader;
use std::fs::File;
use std::path::PathBuf;

/// The folder of recorded cases, if there is one.
fn cases() -> Option<PathBuf> {
    let folder = std::env::var_os("LOGICITY_CASES").map_or_else(
        || PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../shared/cases"),
        PathBuf::from,
    );
    if folder.join("map_square_5x5.npz").is_file() {
        return Some(folder);
    }
    eprintln!(
        "SKIPPED: no recorded cases in {} (LOGICITY_CASES names another folder)",
        folder.display()
    );
    None
}

/// The map of the paper.
fn square_5x5() -> CityMap {
    let letters = [
        "OSHHOHSAHS",
        "GASHHOSHHS",
        "SASOOASOGH",
        "HOHSOHHHHS",
        "SOHSSSGHGO",
        "SSOAASASHH",
        "SASOASGOOO",
        "HOOHOHOSAO",
        "OASSOSSSSO",
        "OHOSAHSOSO",
    ];
    let building = |letter| match letter {
        'H' => Building::House,
        'O' => Building::Office,
        'A' => Building::Garage,
        'S' => Building::Store,
        _ => Building::GasStation,
    };
    let mut sources = Sources::new();
    let span = Span::new(sources.add("map", ""), 0..0);
    let widths = Widths {
        street: 11,
        sidewalk: 5,
        building: 10,
        inner_sidewalk: 5,
    };
    let config = MapConfig {
        name: "square-5x5".into(),
        blocks: Located { value: [5, 5], span },
        widths: Located { value: widths, span },
        buildings: Located {
            value: Buildings::Fixed(letters.map(|row| row.chars().map(building).collect()).to_vec()),
            span,
        },
    };
    CityMap::generate(&config).expect("the map of the paper can be generated")
}

#[test]
fn the_map_is_the_recorded_one_in_every_layer() {
    let Some(folder) = cases() else { return };
    let map = square_5x5();
    let mut npz = NpzReader::new(File::open(folder.join("map_square_5x5.npz")).unwrap()).unwrap();
    let street: Array2<f32> = npz.by_name("street").unwrap();
    let building: Array2<i16> = npz.by_name("building").unwrap();
    let block: Array2<i16> = npz.by_name("block").unwrap();
    let mid_line: Array2<bool> = npz.by_name("midline").unwrap();
    let intersection: Array3<i16> = npz.by_name("intersection").unwrap();

    assert_eq!(map.mid_line, mid_line);
    let ground = street.mapv(|code| match code {
        0.0 => Ground::Other,
        1.0 => Ground::Walking,
        -1.0 => Ground::Crossing,
        _ => Ground::Traffic,
    });
    assert_eq!(map.ground, ground);
    let building = building.mapv(|code| match code {
        3 => Some(Building::House),
        4 => Some(Building::GasStation),
        5 => Some(Building::Office),
        6 => Some(Building::Garage),
        7 => Some(Building::Store),
        _ => None,
    });
    assert_eq!(map.building, building);
    assert_eq!(map.block, block.mapv(|number| number as u32));
    let recorded = |mask: usize| intersection.index_axis(Axis(0), mask).mapv(|number| number as u32);
    assert_eq!(map.entrance, recorded(0));
    assert_eq!(map.outline, recorded(1));
    assert_eq!(map.inside, recorded(2));
}
