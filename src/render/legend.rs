//! The legend beside the map and the status line above it.

use crate::city::{Action, ActionTable, AgentKind, Building};
use crate::city::{CityMap, Layout};
use crate::render::class::{Class, Facing};
use crate::render::ground::{MID_LINE, PAINT, Texture, roof};
use crate::render::icon::Icons;
use crate::render::label::{TEXT, one_line, own_prefix};
use crate::render::picture::PixelBox;
use crate::render::picture::{Picture, Rgb};
use crate::render::sprite::Sprite;
use crate::render::zone::ZoneLook;
use embedded_graphics::mono_font::iso_8859_1::{FONT_6X13, FONT_7X13_BOLD, FONT_9X15_BOLD};
use embedded_graphics::text::Alignment;
use std::collections::BTreeMap;

/// Width of the legend, in pixels.
pub(super) const WIDTH: i32 = 210;
/// Height of a row of the legend, in pixels.
const ROW: i32 = 24;
/// Extra space above a heading, in pixels.
const BREAK: i32 = 8;
/// The longest name that fits beside a sample and a count, in characters.
const NAME: usize = 18;
/// The longest name that fits beside a sample, in characters.
const LONG_NAME: usize = 24;
/// The maximum number of zones with a name.
const MOST_ZONES: usize = 12;
pub(super) const MUTED: Rgb = [0x74, 0x7a, 0x85];

/// Returns the color of an action.
pub(super) const fn action_color(action: Action) -> Rgb {
    /// The colors of actions that a configuration defines, by turns.
    const OWN: [Rgb; 4] = [
        [0xb0, 0x4f, 0xe0],
        [0x14, 0xb8, 0xb8],
        [0xf0, 0x5f, 0xb4],
        [0x8a, 0x6a, 0x4f],
    ];
    match action {
        Action::Stop => [0xe5, 0x23, 0x2b],
        Action::Slow => [0xff, 0xb4, 0x1f],
        Action::Normal => [0x2f, 0xb8, 0x4f],
        Action::Fast => [0x2f, 0x7f, 0xff],
        _ => OWN[action.index() % OWN.len()],
    }
}

/// Draws the mark of an action around a place.
pub(super) fn draw_action(action: Action, (x, y): (i32, i32), picture: &mut Picture) {
    for (reach, rgb) in [(3, [0x20, 0x25, 0x2d]), (2, action_color(action))] {
        for (wide, high) in [(reach, reach - 1), (reach - 1, reach)] {
            picture.fill(around(x, y, wide, high), rgb);
        }
    }
}

/// Returns the rectangle that reaches `wide` and `high` pixels from a pixel to either side.
fn around(x: i32, y: i32, wide: i32, high: i32) -> PixelBox {
    PixelBox {
        x: x - wide,
        y: y - high,
        width: (2 * wide + 1).cast_unsigned(),
        height: (2 * high + 1).cast_unsigned(),
    }
}

/// A column of rows, filled from the top.
struct Column<'a> {
    picture: &'a mut Picture,
    left: i32,
    /// Center of the next row.
    y: i32,
}

impl Column<'_> {
    fn heading(&mut self, text: &str) {
        (self.picture).text(text, (self.left, self.y), &FONT_7X13_BOLD, MUTED, Alignment::Left);
        self.y += ROW;
    }

    /// Adds a row; `sample` draws its picture around a center.
    fn row(&mut self, text: &str, count: Option<usize>, sample: impl FnOnce(&mut Picture, i32, i32)) {
        sample(self.picture, self.left + 24, self.y);
        let name = (self.left + 58, self.y);
        (self.picture).text(text, name, &FONT_6X13, TEXT, Alignment::Left);
        if let Some(count) = count {
            let right = (self.left + WIDTH - 8, self.y);
            (self.picture).text(&count.to_string(), right, &FONT_6X13, MUTED, Alignment::Right);
        }
        self.y += ROW;
    }
}

/// Draws a tile of ground, 25 x 17 pixels.
fn tile(picture: &mut Picture, x: i32, y: i32, edge: Rgb, rgb: Rgb) {
    picture.fill(around(x, y, 12, 8), edge);
    picture.fill(around(x, y, 11, 7), rgb);
}

/// Returns the height of the list of zones, in pixels; 0 without zones.
pub(super) fn zones_height(map: &CityMap) -> i32 {
    match map.zones().count().min(MOST_ZONES + 1) {
        0 => 0,
        // One row for the heading, and one for the number of omitted zones.
        count => ROW * (count as i32 + 1) + BREAK,
    }
}

/// Returns the height of the list of actions that the configuration defines, in pixels.
pub(super) fn actions_height(actions: &ActionTable) -> i32 {
    ROW * i32::try_from(actions.own().len()).expect("at most 12")
}

/// Draws the names of zones.
fn draw_zones(map: &CityMap, ground: Texture, column: &mut Column<'_>) {
    let count = map.zones().count();
    if count == 0 {
        return;
    }
    column.heading("ZONES");
    for (position, name) in map.zones().take(MOST_ZONES).enumerate() {
        let look = ZoneLook::of(position);
        column.row(&one_line(name, LONG_NAME), None, |picture, x, y| {
            let area = around(x, y, 12, 8);
            picture.fill(area, ground.sidewalk);
            let (right, bottom) = (x + 12, y + 8);
            for (x, y) in (area.y..=bottom).flat_map(|y| (area.x..=right).map(move |x| (x, y))) {
                let is_along_row = y == area.y || y == bottom;
                let is_along_col = x == area.x || x == right;
                let is_line = is_along_row && look.has_line(i64::from(x - area.x))
                    || is_along_col && look.has_line(i64::from(y - area.y));
                let pixel = picture.pixel_mut(x as usize, y as usize);
                match is_line {
                    true => pixel.copy_from_slice(&look.color),
                    false => look.tint(pixel),
                }
            }
        });
    }
    if count > MOST_ZONES {
        column.row(&format!("and {} more", count - MOST_ZONES), None, |_, _, _| {});
    }
    column.y += BREAK;
}

/// Draws the part that is the same in every picture: buildings, streets, zones and actions. Returns where the rest
/// begins.
pub(super) fn draw_static(
    (map, actions): (&CityMap, &ActionTable),
    icons: &Icons,
    fine: bool,
    picture: &mut Picture,
    left: i32,
    top: i32,
) -> i32 {
    let mut column = Column {
        picture,
        left,
        y: top + ROW / 2,
    };
    let occurs = |building: &Building| map.buildings().iter().any(|block| block.contains(building));
    let buildings: Vec<Building> = Building::ALL.into_iter().filter(occurs).collect();
    if !buildings.is_empty() {
        column.heading("BUILDINGS");
        for building in buildings {
            let class = Class::building(building);
            column.row(
                &capitalised(&class.to_string().replace('-', " ")),
                None,
                |picture, x, y| {
                    if fine {
                        picture.stamp(&icons.stamp(&class, 0, Facing::Up, 22), x, y);
                    } else {
                        tile(picture, x, y, MUTED, roof(building));
                    }
                },
            );
        }
        column.y += BREAK;
    }
    let ground = Texture::new(icons.seed(), 0.0);
    column.heading("STREETS");
    column.row("Sidewalk", None, |picture, x, y| {
        tile(picture, x, y, ground.curb, ground.sidewalk)
    });
    let street = |picture: &mut Picture, x, y| tile(picture, x, y, ground.asphalt, ground.asphalt);
    if map.has_crossings() {
        column.row("Crossing", None, |picture, x, y| {
            street(picture, x, y);
            for stripe in [-8, 0, 8] {
                picture.fill(around(x + stripe, y, 1, 8), PAINT);
            }
        });
    }
    column.row("Mid line", None, |picture, x, y| {
        street(picture, x, y);
        for dash in [-6, 6] {
            picture.fill(around(x + dash, y, 3, 0), MID_LINE);
        }
    });
    if map.layout().is_some_and(Layout::has_inner_streets) {
        column.row("Stop line", None, |picture, x, y| {
            street(picture, x, y);
            picture.fill(around(x + 5, y, 1, 8), PAINT);
        });
    }
    column.y += BREAK;
    draw_zones(map, ground, &mut column);
    column.heading("ACTIONS");
    let own = actions.all().filter(|action| !action.is_standard());
    for action in [Action::Stop, Action::Slow, Action::Normal, Action::Fast]
        .into_iter()
        .chain(own)
    {
        column.row(&one_line(actions.name(action), LONG_NAME), None, |picture, x, y| {
            draw_action(action, (x, y), picture)
        });
    }
    column.y + BREAK
}

/// Draws the classes of agents and their counts, above `bottom`. `labels` are those of cars and of pedestrians.
pub(super) fn draw_agents(
    agents: &[Sprite<'_>],
    labels: Option<[&str; 2]>,
    icons: &Icons,
    picture: &mut Picture,
    (left, top): (i32, i32),
    bottom: i32,
) {
    let mut column = Column { picture, left, y: top };
    let sections = [(AgentKind::Car, "CARS"), (AgentKind::Pedestrian, "PEDESTRIANS")];
    for (section, (kind, heading)) in sections.into_iter().enumerate() {
        let mut classes: BTreeMap<(Option<&str>, Class), usize> = BTreeMap::new();
        for agent in agents.iter().filter(|agent| agent.kind == kind) {
            *classes.entry((agent.kind_name, agent.class())).or_default() += 1;
        }
        // A section needs a heading, one class, and the line that counts the omitted ones.
        if classes.is_empty() || column.y + 3 * ROW > bottom {
            continue;
        }
        let right = (left + WIDTH - 8, column.y);
        if let Some(labels) = labels {
            (column.picture).text(labels[section], right, &FONT_6X13, MUTED, Alignment::Right);
        }
        column.heading(heading);
        for (position, ((kind_name, class), count)) in classes.iter().enumerate() {
            let left_over = classes.len() - position;
            if left_over > 1 && column.y + 2 * ROW > bottom {
                column.row(&format!("and {left_over} more"), None, |_, _, _| {});
                break;
            }
            let name = match (kind_name, labels) {
                (None, _) => class.to_string(),
                (Some(own), None) => (*own).to_owned(),
                (Some(own), Some(_)) => format!("{own} {}1, ..", own_prefix(own)),
            };
            let name = capitalised(&one_line(&name, NAME));
            column.row(&name, Some(*count), |picture, x, y| {
                let size = match kind {
                    AgentKind::Car => 15,
                    AgentKind::Pedestrian => 23,
                };
                picture.stamp(&icons.stamp(class, 0, Facing::Right, size), x, y);
            });
        }
        column.y += BREAK;
    }
}

fn capitalised(name: &str) -> String {
    let mut chars = name.chars();
    chars
        .next()
        .map_or_else(String::new, |first| first.to_uppercase().chain(chars).collect())
}

/// Draws the name of the map.
pub(super) fn draw_title(name: &str, picture: &mut Picture, left: i32, middle: i32) {
    let name = one_line(name, NAME);
    picture.text(&name, (left, middle), &FONT_9X15_BOLD, TEXT, Alignment::Left);
}

/// Draws the status line above the map, from `left` to the right: tick, counts of agents, and their actions.
pub(super) fn draw_status(
    tick: u64,
    agents: &[Sprite<'_>],
    off_map: usize,
    picture: &mut Picture,
    left: i32,
    middle: i32,
) {
    let count = |action: Action| agents.iter().filter(|sprite| sprite.action == Some(action)).count();
    let (slow, normal, fast, stop) = (
        count(Action::Slow),
        count(Action::Normal),
        count(Action::Fast),
        count(Action::Stop),
    );
    let tick = format!("Tick {tick}");
    picture.text(&tick, (left, middle), &FONT_9X15_BOLD, TEXT, Alignment::Left);
    let mut line = format!("{} agents", agents.len());
    let own = agents
        .iter()
        .filter(|sprite| sprite.action.is_some_and(|action| !action.is_standard()))
        .count();
    if slow + normal + fast + stop + own > 0 {
        let moving = slow + normal + fast;
        line += &format!("   {stop} stop   {moving} move: {slow} slow, {normal} normal, {fast} fast");
    }
    if own > 0 {
        line += &format!("   {own} other actions");
    }
    if off_map > 0 {
        line += &format!("   {off_map} off the map");
    }
    let after = left + 9 * (tick.len() + 2).max(10) as i32;
    picture.text(&line, (after, middle), &FONT_6X13, TEXT, Alignment::Left);
}
