//! A contact sheet: instances of every class, with names.

use crate::city::AgentKind;
use crate::render::class::{Class, Facing, Subject};
use crate::render::icon::Icons;
use crate::render::picture::Picture;
use crate::render::picture::{PixelBox, Stamp};
use embedded_graphics::mono_font::iso_8859_1::{FONT_6X10, FONT_9X15_BOLD};
use embedded_graphics::text::Alignment;

/// Instances per class, in one row.
const COUNT: u32 = 8;
/// Side of the square around an instance, and width of the names, in pixels.
const SLOT: u32 = 100;
const NAMES: u32 = 150;
const GAP: i32 = 12;

/// Draws eight instances of every class with its own looks and of the classes in `more`. Cars appear in eight facings,
/// pedestrians from both sides and the front.
pub fn sheet(icons: &Icons, more: &[Class]) -> Picture {
    let mut classes = Class::known();
    for class in more {
        if !classes.contains(class) {
            classes.push(class.clone());
        }
    }
    #[allow(clippy::cast_possible_truncation)]
    let rows = classes.len() as u32;
    let mut picture = Picture::new(NAMES + COUNT * SLOT, rows * SLOT, [150, 153, 158]);
    for (class, row) in classes.iter().zip(0_i32..) {
        let top = row * SLOT.cast_signed();
        let middle = top + SLOT.cast_signed() / 2;
        let shade = if row % 2 == 0 { [140, 144, 150] } else { [160, 163, 168] };
        let band = PixelBox {
            x: 0,
            y: top,
            width: picture.width(),
            height: SLOT,
        };
        picture.fill(band, shade);
        let name = class.to_string();
        picture.text(&name, (GAP, middle - 8), &FONT_9X15_BOLD, [20, 22, 26], Alignment::Left);
        let count = format!("{} instances", icons.instances(class));
        picture.text(&count, (GAP, middle + 10), &FONT_6X10, [50, 54, 60], Alignment::Left);
        for (instance, facing) in (0..COUNT).zip(Facing::ALL) {
            let (facing, size) = match &class.0 {
                Subject::Agent(AgentKind::Car, _) => (facing, 40),
                Subject::Agent(AgentKind::Pedestrian, _) if instance % 4 == 0 => (Facing::Down, 80),
                Subject::Agent(AgentKind::Pedestrian, _) => (facing, 80),
                Subject::Building(_) => (Facing::Up, 88),
            };
            let stamp = icons.stamp(class, instance, facing, size);
            let stamp = if stamp.area.width.max(stamp.area.height) > SLOT - 4 {
                icons.stamp(
                    class,
                    instance,
                    facing,
                    size * (SLOT - 4) / stamp.area.width.max(stamp.area.height),
                )
            } else {
                stamp
            };
            let (left, centered) = (
                NAMES.cast_signed() + instance.cast_signed() * SLOT.cast_signed(),
                center(&stamp),
            );
            picture.stamp(&stamp, left + SLOT.cast_signed() / 2 - centered.0, middle - centered.1);
        }
    }
    picture
}

/// Returns the center of an icon's area, relative to the icon's origin.
fn center(stamp: &Stamp) -> (i32, i32) {
    let PixelBox { x, y, width, height } = stamp.area;
    (x + width.cast_signed() / 2, y + height.cast_signed() / 2)
}
