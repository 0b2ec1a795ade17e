//! What stands beside and above the map: the legend and the line that says what happens.

use super::agent::{Look, Sprite, Wardrobe, sample_action};
use super::canvas::Frame;
use super::ground::{BUILDINGS, BuildingStyle, letter_font};
use super::ink::Ink;
use super::label::one_line;
use crate::city::CityMap;
use crate::config::{AgentKind, Speed};
use embedded_graphics::mono_font::iso_8859_1::{FONT_6X13, FONT_7X13_BOLD, FONT_9X15_BOLD};
use embedded_graphics::text::Alignment;

/// Width of the legend in pixels.
pub(super) const WIDTH: i32 = 200;
/// Height of a row of the legend in pixels.
const ROW: i32 = 22;
/// Extra space above a heading in pixels.
const BREAK: i32 = 10;

/// The longest name in characters that fits beside a picture and a count.
const NAME: usize = 16;

/// A column of rows, filled from the top.
struct Column<'a> {
    frame: &'a mut Frame,
    left: i32,
    /// Middle of the next row.
    y: i32,
}

impl Column<'_> {
    fn heading(&mut self, text: &str) {
        self.frame
            .text(text, self.left, self.y, &FONT_7X13_BOLD, Ink::MUTED, Alignment::Left);
        self.y += ROW;
    }

    /// A row whose picture is drawn by `picture` around a middle.
    fn row(&mut self, text: &str, count: Option<usize>, picture: impl FnOnce(&mut Frame, i32, i32)) {
        picture(self.frame, self.left + 24, self.y);
        self.frame
            .text(text, self.left + 58, self.y, &FONT_6X13, Ink::TEXT, Alignment::Left);
        if let Some(count) = count {
            let right = self.left + WIDTH - 8;
            self.frame.text(
                &count.to_string(),
                right,
                self.y,
                &FONT_6X13,
                Ink::MUTED,
                Alignment::Right,
            );
        }
        self.y += ROW;
    }
}

/// A tile of ground or roof, 25 x 17 pixels.
fn tile(frame: &mut Frame, x: i32, y: i32, edge: Ink, ink: Ink) {
    frame.fill(x - 12, y - 8, 25, 17, edge);
    frame.fill(x - 11, y - 7, 23, 15, ink);
}

/// Draws the part that is the same in every frame: streets, buildings, actions. Returns where the rest begins.
pub(super) fn draw_static(map: &CityMap, frame: &mut Frame, left: i32, top: i32) -> i32 {
    let mut column = Column {
        frame,
        left,
        y: top + ROW / 2,
    };
    let occurs: Vec<&BuildingStyle> = BUILDINGS
        .iter()
        .filter(|style| map.buildings().iter().any(|block| block.contains(&style.building)))
        .collect();
    if !occurs.is_empty() {
        column.heading("BUILDINGS");
        for style in occurs {
            column.row(style.name, None, |frame, x, y| {
                tile(frame, x, y, style.edge, style.roof);
                if let Some(font) = letter_font(17) {
                    frame.text(style.letter, x, y, font, style.ink, Alignment::Center);
                }
            });
        }
        column.y += BREAK;
    }
    column.heading("STREETS");
    column.row("Sidewalk", None, |frame, x, y| {
        tile(frame, x, y, Ink::CURB, Ink::SIDEWALK)
    });
    if map.layout.has_inner_streets() {
        column.row("Crossing", None, |frame, x, y| {
            tile(frame, x, y, Ink::ASPHALT, Ink::ASPHALT);
            for stripe in 0..3 {
                frame.fill(x - 10 + 8 * stripe, y - 8, 4, 17, Ink::WHITE_PAINT);
            }
        });
    }
    column.row("Mid line", None, |frame, x, y| {
        tile(frame, x, y, Ink::ASPHALT, Ink::ASPHALT);
        frame.fill(x - 9, y - 1, 7, 2, Ink::YELLOW_PAINT);
        frame.fill(x + 2, y - 1, 7, 2, Ink::YELLOW_PAINT);
    });
    if map.layout.has_inner_streets() {
        column.row("Stop line", None, |frame, x, y| {
            tile(frame, x, y, Ink::ASPHALT, Ink::ASPHALT);
            frame.fill(x + 4, y - 8, 2, 17, Ink::WHITE_PAINT);
        });
    }
    column.y += BREAK;
    column.heading("ACTIONS");
    for action in [Speed::Stop, Speed::Slow, Speed::Normal, Speed::Fast] {
        column.row(action.name(), None, |frame, x, y| {
            frame.fill(x - 24, y - 9, 49, 19, Ink::ASPHALT);
            sample_action(AgentKind::Car, action, x + 10, y, frame);
            if action == Speed::Stop {
                sample_action(AgentKind::Pedestrian, action, x - 13, y, frame);
            }
        });
    }
    column.y + BREAK
}

/// Draws which agents there are, above `bottom`.
pub(super) fn draw_agents(wardrobe: &Wardrobe<'_>, frame: &mut Frame, left: i32, top: i32, bottom: i32) {
    let mut column = Column { frame, left, y: top };
    for (kind, heading, labels) in [
        (AgentKind::Car, "CARS", "C1, C2, .."),
        (AgentKind::Pedestrian, "PEDESTRIANS", "P1, P2, .."),
    ] {
        let looks: Vec<(Look<'_>, usize)> = wardrobe
            .looks
            .iter()
            .copied()
            .filter(|(look, _)| look.kind() == kind)
            .collect();
        // A heading, one look, and the line that says how many are left out.
        if looks.is_empty() || column.y + 3 * ROW > bottom {
            continue;
        }
        let right = left + WIDTH - 8;
        column
            .frame
            .text(labels, right, column.y, &FONT_6X13, Ink::MUTED, Alignment::Right);
        column.heading(heading);
        for (position, &(look, count)) in looks.iter().enumerate() {
            let left_over = looks.len() - position;
            if left_over > 1 && column.y + 2 * ROW > bottom {
                column.row(&format!("and {left_over} more"), None, |_, _, _| {});
                break;
            }
            let name = capitalised(&one_line(look.name(), NAME));
            column.row(&name, Some(count), |frame, x, y| wardrobe.sample(look, x, y, frame));
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
pub(super) fn draw_title(name: &str, frame: &mut Frame, left: i32, middle: i32) {
    frame.text(
        &one_line(name, NAME),
        left,
        middle,
        &FONT_9X15_BOLD,
        Ink::TEXT,
        Alignment::Left,
    );
}

/// Draws the line above the map, from `left` to the right: all that changes from tick to tick besides the agents
/// themselves.
pub(super) fn draw_status(tick: u64, agents: &[Sprite<'_>], off_map: usize, frame: &mut Frame, left: i32, middle: i32) {
    let count = |action: Speed| agents.iter().filter(|sprite| sprite.action == Some(action)).count();
    let (slow, normal, fast, stop) = (
        count(Speed::Slow),
        count(Speed::Normal),
        count(Speed::Fast),
        count(Speed::Stop),
    );
    let tick = format!("Tick {tick}");
    frame.text(&tick, left, middle, &FONT_9X15_BOLD, Ink::TEXT, Alignment::Left);
    let mut line = format!("{} agents", agents.len());
    if slow + normal + fast + stop > 0 {
        let moving = slow + normal + fast;
        line += &format!("   {stop} stop   {moving} move: {slow} slow, {normal} normal, {fast} fast");
    }
    if off_map > 0 {
        line += &format!("   {off_map} off the map");
    }
    let after = left + 9 * (tick.len() + 2).max(10) as i32;
    frame.text(&line, after, middle, &FONT_6X13, Ink::TEXT, Alignment::Left);
}
