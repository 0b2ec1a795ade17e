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
/// The least height of a row, if otherwise classes of agents had no place, in pixels.
const LOWEST_ROW: i32 = 18;
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

/// A part of a picture where the legend can continue: its left side, the center of its first row at the full height of
/// rows, and its lower end, in pixels.
#[derive(Clone, Copy, Debug)]
pub(super) struct Slot {
    pub left: i32,
    pub top: i32,
    pub bottom: i32,
}

impl Slot {
    /// Returns the columns below a map, as far as the picture is higher than the map: those between the left side of the
    /// map and `right`.
    pub fn below(map: PixelBox, right: i32, bottom: i32) -> impl Iterator<Item = Slot> {
        let top = map.y + map.height.cast_signed() + BREAK + ROW / 2;
        let count = if top + 3 * ROW > bottom {
            0
        } else {
            (right - map.x) / (WIDTH + BREAK)
        };
        (0..count).map(move |number| Slot {
            left: map.x + number * (WIDTH + BREAK),
            top,
            bottom,
        })
    }
}

/// The agents of a type in the legend.
struct Section<'a> {
    kind: AgentKind,
    heading: &'static str,
    label: Option<&'a str>,
    /// Names, classes and counts.
    classes: Vec<(String, &'a Class, usize)>,
    /// The number of classes with a row. One more row counts the others.
    shown: usize,
}

impl Section<'_> {
    /// Returns the number of rows, with the heading.
    fn rows(&self) -> usize {
        1 + self.shown + usize::from(self.shown < self.classes.len())
    }
}

/// For each section and each of its rows: the position of the slot, and the center.
type Places = Vec<Vec<(usize, i32)>>;

/// Returns the places of the rows of sections. `None` if there is not enough space. A heading stands above at least one
/// row.
fn arranged(sections: &[Section<'_>], slots: &[Slot], row: i32) -> Option<Places> {
    let (mut slot, mut y) = (0, slots.first()?.top);
    let mut places = Vec::new();
    for section in sections {
        let mut of_section = Vec::new();
        for number in 0..section.rows() {
            let needed = if number == 0 { 2 * row } else { row };
            if y - row / 2 + needed > slots[slot].bottom {
                slot += 1;
                y = slots.get(slot)?.top;
            }
            of_section.push((slot, y));
            y += row;
        }
        y += BREAK;
        places.push(of_section);
    }
    Some(places)
}

/// Returns the height of rows, and the places of the rows of sections as [`arranged`]. Omits as many classes as it must,
/// of the sections with the most, and then whole sections. `None` without slots.
fn fitted(sections: &mut Vec<Section<'_>>, slots: &[Slot]) -> Option<(i32, Places)> {
    loop {
        let found = (LOWEST_ROW..=ROW)
            .rev()
            .find_map(|row| Some((row, arranged(sections, slots, row)?)));
        if found.is_some() {
            return found;
        }
        let longest = (0..sections.len()).max_by_key(|&section| sections[section].shown)?;
        match sections[longest].shown {
            1 => {
                sections.pop();
                for section in sections.iter_mut() {
                    section.shown = section.classes.len();
                }
            }
            _ => sections[longest].shown -= 1,
        }
    }
}

/// Draws the classes of agents and their counts into the slots, in order. Rows become lower if there is not enough
/// space; if that is not enough, the last row of a type counts the omitted classes. `labels` are those of cars and of
/// pedestrians.
pub(super) fn draw_agents(
    agents: &[Sprite<'_>],
    labels: Option<[&str; 2]>,
    icons: &Icons,
    picture: &mut Picture,
    slots: &[Slot],
) {
    let kinds = [(AgentKind::Car, "CARS"), (AgentKind::Pedestrian, "PEDESTRIANS")];
    let counts = kinds.map(|(kind, _)| {
        let mut classes: BTreeMap<(Option<&str>, Class), usize> = BTreeMap::new();
        for agent in agents.iter().filter(|agent| agent.kind == kind) {
            *classes.entry((agent.kind_name, agent.class())).or_default() += 1;
        }
        classes
    });
    let sections = (kinds.iter().zip(&counts).enumerate()).filter(|(_, (_, classes))| !classes.is_empty());
    let mut sections: Vec<Section<'_>> = sections
        .map(|(position, (&(kind, heading), classes))| {
            let named = classes.iter().map(|((kind_name, class), &count)| {
                let name = match (kind_name, labels) {
                    (None, _) => class.to_string(),
                    (Some(own), None) => (*own).to_owned(),
                    (Some(own), Some(_)) => format!("{own} {}1, ..", own_prefix(own)),
                };
                (capitalised(&one_line(&name, NAME)), class, count)
            });
            Section {
                kind,
                heading,
                label: labels.map(|labels| labels[position]),
                shown: classes.len(),
                classes: named.collect(),
            }
        })
        .collect();
    let Some((row, places)) = fitted(&mut sections, slots) else {
        return;
    };
    for (section, places) in sections.iter().zip(places) {
        let columns = |(slot, y): (usize, i32)| (slots[slot].left, y);
        let (left, y) = columns(places[0]);
        if let Some(label) = section.label {
            picture.text(label, (left + WIDTH - 8, y), &FONT_6X13, MUTED, Alignment::Right);
        }
        Column { picture, left, y }.heading(section.heading);
        let left_over = section.classes.len() - section.shown;
        for (at, (name, class, count)) in places[1..].iter().zip(&section.classes[..section.shown]) {
            let (left, y) = columns(*at);
            Column { picture, left, y }.row(name, Some(*count), |picture, x, y| {
                let size = match section.kind {
                    AgentKind::Car => 15.min(row - 4),
                    AgentKind::Pedestrian => 23.min(row),
                };
                picture.stamp(&icons.stamp(class, 0, Facing::Right, size.cast_unsigned()), x, y);
            });
        }
        if let (Some(at), 1..) = (places.last(), left_over) {
            let (left, y) = columns(*at);
            Column { picture, left, y }.row(&format!("and {left_over} more"), None, |_, _, _| {});
        }
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

#[cfg(test)]
mod tests {
    use super::*;

    fn slot(left: i32, rows: i32) -> Slot {
        Slot {
            left,
            top: 100,
            bottom: 100 - ROW / 2 + rows * ROW,
        }
    }

    /// Returns the height of rows, the slots of the rows of each section, and the number of classes with a row.
    fn fit(classes: [usize; 2], slots: &[Slot]) -> Option<(i32, Vec<Vec<usize>>, Vec<usize>)> {
        let class = Class::building(Building::House);
        let mut sections: Vec<Section<'_>> = (AgentKind::ALL.into_iter().zip(classes))
            .map(|(kind, count)| Section {
                kind,
                heading: "",
                label: None,
                classes: vec![(String::new(), &class, 1); count],
                shown: count,
            })
            .collect();
        let (row, places) = fitted(&mut sections, slots)?;
        for (slot, slots_row) in places.iter().flatten().map(|(slot, y)| (slot, y)) {
            assert!(slots_row + row / 2 <= slots[*slot].bottom + 1, "{places:?}");
        }
        for (section, places) in sections.iter().zip(&places) {
            assert_eq!(places.len(), section.rows());
            assert_eq!(places[0].0, places[1].0, "a heading stands above a row");
        }
        let of_slots = places.iter().map(|rows| rows.iter().map(|(slot, _)| *slot).collect());
        Some((
            row,
            of_slots.collect(),
            sections.iter().map(|section| section.shown).collect(),
        ))
    }

    #[test]
    fn the_legend_continues_where_there_is_space() {
        // Two headings, and a break of less than a row.
        assert_eq!(
            fit([3, 2], &[slot(0, 8)]).unwrap(),
            (ROW, vec![vec![0; 4], vec![0; 3]], vec![3, 2])
        );
        let (row, slots, shown) = fit([6, 3], &[slot(0, 5), slot(300, 7)]).unwrap();
        assert_eq!((row, shown), (ROW, vec![6, 3]));
        assert_eq!(slots, [vec![0, 0, 0, 0, 0, 1, 1], vec![1, 1, 1, 1]]);
        // A heading would be alone at the end of the first slot.
        let (_, slots, _) = fit([3, 2], &[slot(0, 5), slot(300, 7)]).unwrap();
        assert_eq!(slots[1], [1, 1, 1]);
    }

    #[test]
    fn rows_become_lower_before_classes_are_omitted() {
        let (row, _, shown) = fit([6, 3], &[slot(0, 10)]).unwrap();
        assert!((LOWEST_ROW..ROW).contains(&row), "{row}");
        assert_eq!(shown, [6, 3]);
        let (row, _, shown) = fit([20, 3], &[slot(0, 10)]).unwrap();
        assert!(row < LOWEST_ROW + 3, "{row}");
        assert!(shown[0] >= 6 && shown[1] == 3, "{shown:?}");
        assert_eq!(fit([20, 20], &[slot(0, 5)]).unwrap().2, [1, 1]);
        assert_eq!(fit([20, 20], &[slot(0, 4)]).unwrap().2, [3]);
        assert!(fit([20, 20], &[slot(0, 2)]).unwrap().2.is_empty());
        assert_eq!(fit([20, 20], &[]), None);
    }

    #[test]
    fn slots_lie_below_a_low_map() {
        let map = PixelBox {
            x: 30,
            y: 40,
            width: 500,
            height: 300,
        };
        let slots: Vec<Slot> = Slot::below(map, 560, 800).collect();
        assert_eq!(
            slots.iter().map(|slot| slot.left).collect::<Vec<_>>(),
            [30, 30 + WIDTH + BREAK]
        );
        assert!(slots.iter().all(|slot| slot.top > 340 && slot.bottom == 800));
        assert_eq!(Slot::below(map, 560, 380).count(), 0);
    }
}
