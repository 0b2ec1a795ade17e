//! Composes a frame: the map once, the agents every time.

use super::agent::{Size, Sprite, Wardrobe};
use super::canvas::Frame;
use super::ground::{self, Zoom};
use super::ink::Ink;
use super::label::{self, PixelArea};
use super::legend;
use crate::city::{CityMap, Heading};
use crate::config::AgentKind;
use embedded_graphics::mono_font::iso_8859_1::FONT_5X8;
use embedded_graphics::text::Alignment;
use std::fmt;

/// A map without cells cannot be drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EmptyMap;

impl fmt::Display for EmptyMap {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "the map has no cells")
    }
}

impl std::error::Error for EmptyMap {}

/// Space around everything, and between map and legend, in pixels.
const MARGIN: i32 = 14;
/// Height of the line above the map, in pixels.
const STATUS: i32 = 30;
/// Width of the row numbers and height of the column numbers, in pixels.
const RULER: (i32, i32) = (20, 12);
/// A legend with the known concepts of an ordinary scenario needs about this much, in pixels.
const LEAST_HEIGHT: i32 = 760;
/// The line above the map needs about this much, in pixels.
const LEAST_WIDTH: i32 = 440;

/// Draws frames of one map.
///
/// A picture is a line of numbers, the map with row and column numbers, and a legend. The longer side of the map
/// becomes up to 1000 pixels (square-5x5: 4 pixels a cell, 964 x 964), with cells of at most 12. A map of more than
/// 1600 cells is sampled down to at most 1600 pixels, so a picture takes at most 4 MB whatever the map; agents never
/// shrink below some 9 x 5 pixels.
#[derive(Clone, Debug)]
pub struct Painter {
    /// The picture without agents.
    base: Frame,
    zoom: Zoom,
    /// Rows and columns of the map.
    cells: (i32, i32),
    /// Where the map is in the picture.
    map: PixelArea,
    /// Where the legend of the agents begins (left, top).
    agents: (i32, i32),
}

impl Painter {
    /// Draws the map.
    ///
    /// # Errors
    /// If the map has no rows or no columns.
    pub fn new(map: &CityMap) -> Result<Painter, EmptyMap> {
        let (rows, cols) = (map.rows(), map.cols());
        if rows == 0 || cols == 0 {
            return Err(EmptyMap);
        }
        let zoom = Zoom::fit(rows.max(cols));
        let area = PixelArea {
            left: MARGIN + RULER.0,
            top: STATUS + RULER.1,
            width: zoom.length(cols),
            height: zoom.length(rows),
        };
        let legend = (area.left + area.width.max(LEAST_WIDTH) + MARGIN, STATUS);
        let width = legend.0 + legend::WIDTH + MARGIN;
        let height = (area.top + area.height).max(LEAST_HEIGHT) + MARGIN;
        let side = |length: i32| u16::try_from(length).expect("the zoom bounds the map, and all else is constant");
        let mut base = Frame::new(side(width), side(height), Ink::PAPER);
        ground::draw(map, zoom, &mut base, area.left, area.top);
        rulers(&mut base, zoom, area, (rows, cols));
        legend::draw_title(&map.name, &mut base, legend.0, STATUS / 2);
        let agents = (legend.0, legend::draw_static(map, &mut base, legend.0, legend.1));
        Ok(Painter {
            base,
            zoom,
            cells: (rows, cols),
            map: area,
            agents,
        })
    }

    /// Width and height of every frame in pixels.
    pub fn size(&self) -> (u16, u16) {
        (self.base.width(), self.base.height())
    }

    /// The picture of a state. It depends on the arguments alone, not on frames drawn before.
    ///
    /// Cars lie under pedestrians, and otherwise agents that come later lie on those before. The first 300 agents get a
    /// label, except where it would cover another one.
    pub fn frame(&self, tick: u64, agents: &[Sprite<'_>]) -> Frame {
        let mut frame = self.base.clone();
        let size = Size::for_cell(self.zoom.pixels);
        let wardrobe = Wardrobe::of(agents);
        let mut drawn: Vec<(Sprite<'_>, PixelArea)> = agents
            .iter()
            .filter_map(|sprite| Some((*sprite, self.area(sprite, size)?)))
            .collect();
        drawn.sort_by_key(|(sprite, _)| sprite.kind == AgentKind::Pedestrian);
        for (sprite, area) in &drawn {
            wardrobe.draw(
                sprite,
                area.left + area.width / 2,
                area.top + area.height / 2,
                size,
                &mut frame,
            );
        }
        label::draw(&label::place(&drawn, self.map), &mut frame);
        legend::draw_status(
            tick,
            agents,
            agents.len() - drawn.len(),
            &mut frame,
            self.map.left,
            STATUS / 2,
        );
        legend::draw_agents(
            &wardrobe,
            &mut frame,
            self.agents.0,
            self.agents.1,
            i32::from(self.base.height()) - MARGIN,
        );
        frame
    }

    /// What an agent covers, without its dashes; `None` if it is off the map.
    fn area(&self, sprite: &Sprite<'_>, size: Size) -> Option<PixelArea> {
        let on_map = (0..self.cells.0).contains(&sprite.at.row) && (0..self.cells.1).contains(&sprite.at.col);
        on_map.then(|| {
            let (x, y) = (self.zoom.middle(sprite.at.col), self.zoom.middle(sprite.at.row));
            let (right, down) = size.reach(sprite);
            PixelArea {
                left: self.map.left + x - right,
                top: self.map.top + y - down,
                width: 2 * right + 1,
                height: 2 * down + 1,
            }
        })
    }
}

/// Row numbers left of the map and column numbers above it.
fn rulers(frame: &mut Frame, zoom: Zoom, map: PixelArea, (rows, cols): (i32, i32)) {
    // Room for a number of five digits.
    let step = [10, 20, 50, 100, 200, 500, 1000, 2000, 5000]
        .into_iter()
        .find(|&step| zoom.length(step) >= 36)
        .unwrap_or(10_000);
    for (heading, side) in [(Heading::Down, rows), (Heading::Right, cols)] {
        for cell in (0..side).step_by(step as usize) {
            let (at, text) = (zoom.middle(cell), cell.to_string());
            if heading == Heading::Down {
                frame.text(
                    &text,
                    map.left - 5,
                    map.top + at,
                    &FONT_5X8,
                    Ink::MUTED,
                    Alignment::Right,
                );
                frame.fill(map.left - 3, map.top + at, 3, 1, Ink::MUTED);
            } else {
                frame.text(
                    &text,
                    map.left + at,
                    map.top - 8,
                    &FONT_5X8,
                    Ink::MUTED,
                    Alignment::Center,
                );
                frame.fill(map.left + at, map.top - 3, 1, 3, Ink::MUTED);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::city::Cell;
    use crate::config::{Building, Buildings, Located, MapConfig, Speed, Widths};
    use crate::diag::{Sources, Span};

    fn painter() -> Painter {
        let mut sources = Sources::new();
        let span = Span::new(sources.add("map", ""), 0..0);
        let widths = Widths {
            street: 11,
            sidewalk: 5,
            building: 10,
            inner_sidewalk: 5,
        };
        let buildings = Buildings::Fixed(vec![vec![Building::House; 6]; 6]);
        let config = MapConfig {
            name: "test".into(),
            blocks: Located { value: [3, 3], span },
            widths: Located { value: widths, span },
            buildings: Located { value: buildings, span },
        };
        let map = CityMap::generate(&config).unwrap_or_else(|fault| panic!("{fault:?}"));
        Painter::new(&map).expect("it has cells")
    }

    fn car<'a>(name: &'a str, at: Cell, heading: Heading) -> Sprite<'a> {
        Sprite {
            name,
            kind: AgentKind::Car,
            concepts: &[],
            at,
            heading: Some(heading),
            action: Some(Speed::Stop),
        }
    }

    #[test]
    fn the_map_changes_only_where_an_agent_and_its_label_are() {
        let painter = painter();
        let size = Size::for_cell(painter.zoom.pixels);
        for heading in Heading::ALL {
            let sprite = car("Car_1", Cell::new(48, 51), heading);
            let figure = painter.area(&sprite, size).expect("it is on the map");
            let labels = label::place(&[(sprite, figure)], painter.map);
            let frame = painter.frame(0, &[sprite]);
            let ring = 3;
            let mut changed = 0;
            for y in painter.map.top..painter.map.top + painter.map.height {
                for x in painter.map.left..painter.map.left + painter.map.width {
                    let at = (y * i32::from(frame.width()) + x) as usize;
                    if frame.pixels()[at] == painter.base.pixels()[at] {
                        continue;
                    }
                    changed += 1;
                    let inside = |area: PixelArea, more: i32| {
                        (area.left - more..area.left + area.width + more).contains(&x)
                            && (area.top - more..area.top + area.height + more).contains(&y)
                    };
                    assert!(
                        inside(figure, ring) || labels.iter().any(|(_, area)| inside(*area, 0)),
                        "{heading:?} ({x}, {y})"
                    );
                }
            }
            assert!(
                changed > figure.width * figure.height / 2,
                "{heading:?}: the agent is there"
            );
        }
    }

    #[test]
    fn headings_turn_the_same_figure() {
        let painter = painter();
        let crop = |heading: Heading| {
            let sprite = Sprite {
                name: "",
                ..car("", Cell::new(48, 51), heading)
            };
            let frame = painter.frame(0, &[sprite]);
            let area = painter
                .area(&sprite, Size::for_cell(painter.zoom.pixels))
                .expect("on the map");
            let (x, y) = (area.left + area.width / 2, area.top + area.height / 2);
            let (dr, dc) = heading.delta();
            let half = area.width.max(area.height) / 2 - 1;
            // Along the axis of the car the same colours follow, from rear to front.
            (-half..=half)
                .map(|along| frame.pixels()[((y + along * dr) * i32::from(frame.width()) + x + along * dc) as usize])
                .collect::<Vec<_>>()
        };
        let right = crop(Heading::Right);
        for heading in Heading::ALL {
            assert_eq!(crop(heading), right, "{heading:?}");
        }
        let mut turned = right.clone();
        turned.reverse();
        assert_ne!(turned, right, "front and rear differ");
    }

    #[test]
    fn labels_stay_on_the_map_and_apart_even_in_a_crowd() {
        let painter = painter();
        let names: Vec<String> = (1..=400).map(|number| format!("Car_{number}")).collect();
        for spread in [1, 10, 149] {
            let size = Size::for_cell(painter.zoom.pixels);
            let crowd: Vec<(Sprite<'_>, PixelArea)> = names
                .iter()
                .zip(0..)
                .map(|(name, at)| car(name, Cell::new(at * 7 % spread, at * 13 % spread), Heading::Up))
                .map(|sprite| (sprite, painter.area(&sprite, size).expect("on the map")))
                .collect();
            let labels = label::place(&crowd, painter.map);
            assert!(!labels.is_empty());
            for (position, (text, area)) in labels.iter().enumerate() {
                assert!(painter.map.contains(*area), "{text}");
                let apart = labels[..position].iter().all(|(_, other)| area.overlap(*other) == 0);
                assert!(apart, "{text}");
            }
        }
    }

    #[test]
    fn every_zoom_is_bounded() {
        for cells in 1..100_000 {
            let zoom = Zoom::fit(cells);
            assert!((1..=1600).contains(&zoom.length(cells)), "{cells}");
            assert!(zoom.middle(cells - 1) < zoom.length(cells), "{cells}");
        }
        assert_eq!(Zoom::fit(241), Zoom { pixels: 4, cells: 1 });
    }
}
