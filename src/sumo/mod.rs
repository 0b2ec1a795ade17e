//! Files of SUMO: road networks (`.net.xml`) as map files and back, and runs as positions over time (FCD output).
//!
//! SUMO is a traffic simulator: <https://eclipse.dev/sumo/>. Its positions are in meters, and y grows upward; cells
//! count from the upper left corner of a map, whose position is [`Network::origin`](crate::city::Network::origin).

mod export;
mod fcd;
mod import;

pub use export::network_file;
pub use fcd::{FcdWriter, Moving, Plane};
pub use import::{Imported, import, map_file};

use crate::city::Point;

/// Returns a point in cells as a position in meters, from the position of the upper left corner and the side of a cell.
fn meters([left, top]: [f64; 2], cell: f64, point: Point) -> [f64; 2] {
    [left + point.x * cell, top - point.y * cell]
}

/// Returns a text as the value of an attribute of XML.
fn escaped(text: &str) -> String {
    let mut value = String::with_capacity(text.len());
    for letter in text.chars() {
        match letter {
            '&' => value.push_str("&amp;"),
            '<' => value.push_str("&lt;"),
            '>' => value.push_str("&gt;"),
            '"' => value.push_str("&quot;"),
            // XML has no other control characters, and attributes lose line breaks.
            letter if letter.is_control() => value.push(' '),
            letter => value.push(letter),
        }
    }
    value
}
