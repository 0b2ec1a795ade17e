//! Pictures of a city, or a part of it, with rulers, a legend and labels.

use crate::city::{ActionTable, AgentKind};
use crate::city::{Cell, CityMap, Heading};
use crate::render::icon::Icons;
use crate::render::label;
use crate::render::label::PAPER;
use crate::render::legend;
use crate::render::legend::{MUTED, Slot};
use crate::render::picture::Picture;
use crate::render::picture::PixelBox;
use crate::render::renderer::Renderer;
use crate::render::sprite::Sprite;
use crate::render::view::{Extent, Scale, Viewport, ViewportError};
use embedded_graphics::mono_font::iso_8859_1::FONT_5X8;
use embedded_graphics::text::Alignment;
use std::sync::Arc;

/// Space around the picture's parts, and between map and legend, in pixels.
const MARGIN: i32 = 14;
/// Height of the status line, in pixels.
const STATUS: i32 = 30;
/// Width of the row numbers and height of the column numbers, in pixels.
const RULER: (i32, i32) = (20, 12);
/// Approximate height of a legend with the known concepts, in pixels.
const LEAST_HEIGHT: i32 = 800;
/// Approximate width of the status line, in pixels.
const LEAST_WIDTH: i32 = 440;
/// The longer side of a map with enlarged cells, in pixels; that of other maps is at most [`MOST`].
const ENLARGED: i32 = 1000;
const MOST: i32 = 1600;
/// The largest cell, in pixels.
const LARGEST_CELL: i32 = 12;

/// A controlled agent to mark.
#[derive(Clone, Debug)]
pub struct Marked {
    /// Its position among the agents of the picture.
    pub agent: usize,
    /// The cells of its remaining route; the goal is the last.
    pub way: Vec<Cell>,
}

/// Draws overviews of one city.
///
/// A picture has a status line, the map or a part of it with row and column numbers, and a legend. Unless a scale is
/// given, cells are enlarged to at most 12 pixels, as long as the longer side of the map has at most 1000 pixels
/// (square-5x5: 4 pixels per cell, 974 x 964), and a side of more than 1600 cells is downsampled to at most 1600
/// pixels, so every picture takes at most 12 MB. Agents have a minimum size in pixels. A colored dot beside every agent
/// shows its action. Zones are tinted, with an outline.
#[derive(Clone, Debug)]
pub struct Overview {
    /// The picture without the map.
    frame: Picture,
    map: Renderer,
    /// The place of the map on the picture.
    area: PixelBox,
    /// The parts of the picture for the legend of agents.
    agents: Vec<Slot>,
}

impl Overview {
    /// Draws what does not change in pictures of the whole map.
    ///
    /// # Errors
    /// If the map has no rows or no columns.
    pub fn new(map: &CityMap, icons: Arc<Icons>) -> Result<Overview, ViewportError> {
        Overview::of_part(map, icons, Extent::whole(map), None)
    }

    /// Draws what does not change in pictures of a part of the map, at a scale if one is given.
    ///
    /// # Errors
    /// If the part has no cells, or the picture too many pixels.
    pub fn of_part(
        map: &CityMap,
        icons: Arc<Icons>,
        part: Extent,
        scale: Option<Scale>,
    ) -> Result<Overview, ViewportError> {
        Overview::of_city((map, &ActionTable::default()), icons, part, scale)
    }

    /// Draws what does not change in pictures of a part of a city, whose legend lists these actions.
    ///
    /// # Errors
    /// As [`Overview::of_part`].
    pub fn of_city(
        (map, actions): (&CityMap, &ActionTable),
        icons: Arc<Icons>,
        part: Extent,
        scale: Option<Scale>,
    ) -> Result<Overview, ViewportError> {
        let longer = part.rows.max(part.cols);
        if part.rows <= 0 || part.cols <= 0 {
            return Err(ViewportError::Empty);
        }
        let most = if longer > ENLARGED { MOST } else { ENLARGED };
        let scale = scale.unwrap_or_else(|| Scale::fit(longer, most, LARGEST_CELL));
        let view = Viewport::of(part, scale)?;
        let (width, height) = view.size();
        let area = PixelBox {
            x: MARGIN + RULER.0,
            y: STATUS + RULER.1,
            width,
            height,
        };
        let (map_wide, map_high) = (width.cast_signed(), height.cast_signed());
        let left = area.x + map_wide.max(LEAST_WIDTH) + MARGIN;
        let width = left + legend::WIDTH + MARGIN;
        let height = (area.y + map_high)
            .max(LEAST_HEIGHT + legend::zones_height(map) + legend::actions_height(actions))
            + MARGIN;
        let mut frame = Picture::new(width.cast_unsigned(), height.cast_unsigned(), PAPER);
        rulers(&mut frame, view, area);
        legend::draw_title(&map.name, &mut frame, left, STATUS / 2);
        let fine = scale.cells == 1;
        let top = legend::draw_static((map, actions), &icons, fine, &mut frame, left, STATUS);
        let bottom = height - MARGIN;
        let beside = Slot { left, top, bottom };
        let agents = [beside].into_iter().chain(Slot::below(area, left, bottom));
        Ok(Overview {
            frame,
            map: Renderer::with_zones(map, icons, view),
            area,
            agents: agents.collect(),
        })
    }

    /// Returns width and height of every picture, in pixels.
    pub fn size(&self) -> (u32, u32) {
        (self.frame.width(), self.frame.height())
    }

    /// Draws a state. The picture depends only on the arguments.
    ///
    /// Pedestrians cover cars, and later agents cover earlier ones of the same type. The first 300 agents get a label,
    /// except where it would cover another.
    pub fn draw(&self, tick: u64, agents: &[Sprite<'_>]) -> Picture {
        self.draw_marked(tick, agents, &[])
    }

    /// Draws a state like [`Overview::draw`], and marks controlled agents: a frame, a line along the route, a square
    /// around the goal.
    ///
    /// # Panics
    /// If a marked agent is not among `agents`.
    pub fn draw_marked(&self, tick: u64, agents: &[Sprite<'_>], driven: &[Marked]) -> Picture {
        let mut picture = self.frame.clone();
        picture.lay(&self.map.draw(agents), self.area.x, self.area.y);
        for Marked { agent, way } in driven {
            self.mark(&agents[*agent], way, &mut picture);
        }
        let shown = self.figures(agents);
        for (sprite, area) in &shown {
            if let Some(action) = sprite.action {
                legend::draw_action(action, (area.x + area.width.cast_signed(), area.y), &mut picture);
            }
        }
        label::draw(&label::place(&shown, self.area, label::LONGEST), &mut picture);
        let off_map = agents.len() - shown.len();
        legend::draw_status(tick, agents, off_map, &mut picture, self.area.x, STATUS / 2);
        let labels = Some(["C1, C2, ..", "P1, P2, .."]);
        legend::draw_agents(agents, labels, self.map.icons(), &mut picture, &self.agents);
        picture
    }

    fn mark(&self, sprite: &Sprite<'_>, way: &[Cell], picture: &mut Picture) {
        let around = |cell: Cell, reach: i32| {
            let (x, y) = self.map.view().middle(cell)?;
            let side = (2 * reach).cast_unsigned();
            let (x, y) = (self.area.x + x - reach, self.area.y + y - reach);
            Some(PixelBox {
                x,
                y,
                width: side,
                height: side,
            })
        };
        for area in way.iter().filter_map(|cell| around(*cell, 1)) {
            picture.fill(area, label::MARK);
        }
        let goal = way.last().and_then(|goal| around(*goal, 6));
        if let Some(goal) = goal {
            label::border(goal, picture);
        }
        if let Some(area) = self.map.pixel_box(sprite) {
            let (x, y) = (area.x + self.area.x, area.y + self.area.y);
            label::frame(PixelBox { x, y, ..area }, picture);
        }
    }

    /// Returns the agents on the map in drawing order, each with its box in the picture.
    fn figures<'a>(&self, agents: &[Sprite<'a>]) -> Vec<(Sprite<'a>, PixelBox)> {
        let on_picture = |agent: &Sprite<'a>| {
            let area = self.map.pixel_box(agent)?;
            let (x, y) = (area.x + self.area.x, area.y + self.area.y);
            Some((*agent, PixelBox { x, y, ..area }))
        };
        let mut figures: Vec<_> = agents.iter().filter_map(on_picture).collect();
        figures.sort_by_key(|(sprite, _)| sprite.kind == AgentKind::Pedestrian);
        figures
    }
}

/// Draws row numbers left of the map and column numbers above it.
fn rulers(frame: &mut Picture, view: Viewport, map: PixelBox) {
    // Leaves room for a five-digit number.
    let step = [10, 20, 50, 100, 200, 500, 1000, 2000, 5000]
        .into_iter()
        .find(|&step| view.scale.length(step) >= 36)
        .unwrap_or(10_000);
    let Viewport { corner, rows, cols, .. } = view;
    for (heading, first, side) in [(Heading::Down, corner.row, rows), (Heading::Right, corner.col, cols)] {
        let after = (step - first.rem_euclid(step)) % step;
        for cell in (after..side).map(|cell| first + cell).step_by(step as usize) {
            // The cells fit the picture.
            let at = (view.scale.middle(cell) - view.scale.start(first)) as i32;
            let (x, y, text) = (map.x + at, map.y + at, cell.to_string());
            let (place, align, tick) = if heading == Heading::Down {
                ((map.x - 5, y), Alignment::Right, (map.x - 3, y, 3, 1))
            } else {
                ((x, map.y - 8), Alignment::Center, (x, map.y - 3, 1, 3))
            };
            frame.text(&text, place, &FONT_5X8, MUTED, align);
            let (x, y, width, height) = tick;
            frame.fill(PixelBox { x, y, width, height }, MUTED);
        }
    }
}
