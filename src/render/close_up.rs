//! Pictures of some agents of a city with their names, and one of them in a frame.

use crate::city::{Cell, CityMap};
use crate::render::icon::Icons;
use crate::render::label::{self, PAPER};
use crate::render::legend::{self, Slot};
use crate::render::picture::{Picture, PixelBox};
use crate::render::renderer::Renderer;
use crate::render::sprite::Sprite;
use crate::render::view::{Scale, Viewport};
use std::sync::Arc;

/// Space around the map and the legend, in pixels.
const SPACE: i32 = 14;
/// Cells around the agents, so that the picture contains their icons.
const MARGIN: i32 = 3;
/// The longer side of the map with enlarged cells, in pixels; that of other maps is at most one pixel per cell.
const LONGEST: i32 = 1000;
/// The largest cell, in pixels.
const LARGEST_CELL: i32 = 12;
/// The longest name, in characters.
const LONGEST_NAME: usize = 24;
/// The height that a legend with the known concepts needs, in pixels.
const LEAST_HEIGHT: i32 = 500;

/// Draws the surroundings of agents. A picture has the map, where each agent has its name as in an
/// [`Overview`](super::Overview) but in full, and a legend of the agents.
#[derive(Clone, Debug)]
pub struct CloseUp {
    icons: Arc<Icons>,
    reach: i32,
}

impl CloseUp {
    /// Pictures show at least the cells up to `reach` rows and columns from the marked agent.
    pub fn new(icons: Arc<Icons>, reach: u32) -> CloseUp {
        CloseUp {
            icons,
            reach: i32::try_from(reach).unwrap_or(i32::MAX),
        }
    }

    /// Draws agents on a map, the marked one in a frame. The picture contains all of them.
    ///
    /// # Panics
    /// If the marked agent is not among them, or the map has no cells.
    pub fn draw(&self, map: &CityMap, agents: &[Sprite<'_>], marked: usize) -> Picture {
        let (top, rows) = self.span(agents, marked, |cell| cell.row, map.rows());
        let (left, cols) = self.span(agents, marked, |cell| cell.col, map.cols());
        let scale = Scale::fit(rows.max(cols), LONGEST, LARGEST_CELL);
        let view = Viewport::new(Cell::new(top, left), rows.cast_unsigned(), cols.cast_unsigned(), scale);
        let map = Renderer::new(
            map,
            Arc::clone(&self.icons),
            view.expect("it has cells, and few pixels"),
        );
        let (width, height) = map.view().size();
        let area = PixelBox {
            x: SPACE,
            y: SPACE,
            width,
            height,
        };
        let right = area.x + width.cast_signed() + SPACE;
        let bottom = area.y + height.cast_signed().max(LEAST_HEIGHT);
        let size = [right + legend::WIDTH + SPACE, bottom + SPACE].map(i32::cast_unsigned);
        let mut picture = Picture::new(size[0], size[1], PAPER);
        picture.lay(&map.draw(agents), area.x, area.y);
        let boxes = map.boxes(agents).into_iter();
        let boxes: Vec<Option<PixelBox>> = boxes
            .map(|area_on_map| {
                area_on_map.map(|on_map| PixelBox {
                    x: on_map.x + area.x,
                    y: on_map.y + area.y,
                    ..on_map
                })
            })
            .collect();
        if let Some(figure) = boxes[marked] {
            label::frame(figure, &mut picture);
        }
        let shown = agents.iter().zip(boxes);
        let shown: Vec<_> = shown.filter_map(|(agent, figure)| Some((*agent, figure?))).collect();
        label::draw(&label::place(&shown, area, LONGEST_NAME), &mut picture);
        let (left, top) = (right, area.y + SPACE);
        let beside = Slot { left, top, bottom };
        let slots: Vec<Slot> = [beside].into_iter().chain(Slot::below(area, left, bottom)).collect();
        legend::draw_agents(agents, None, &self.icons, &mut picture, &slots);
        picture
    }

    /// Returns the first row or column, and their number.
    fn span(&self, agents: &[Sprite<'_>], marked: usize, of: fn(Cell) -> i32, most: i32) -> (i32, i32) {
        let middle = of(agents[marked].at);
        let places = || agents.iter().map(|agent| of(agent.at));
        let first = places().map(|at| at - MARGIN).min().unwrap_or(middle);
        let last = places().map(|at| at + MARGIN).max().unwrap_or(middle);
        let first = first.min(middle.saturating_sub(self.reach)).clamp(0, most - 1);
        let last = last.max(middle.saturating_add(self.reach)).clamp(first, most - 1);
        (first, last - first + 1)
    }
}
