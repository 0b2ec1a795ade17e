//! Sets of cells that consist of rectangles.

use crate::city::Cell;
use std::ops::Range;

/// A rectangle of cells.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Rectangle {
    pub rows: Range<i32>,
    pub cols: Range<i32>,
}

impl Rectangle {
    /// Returns the cells at most `cells` rows and columns away.
    pub fn grown(&self, cells: u32) -> Rectangle {
        let cells = i32::try_from(cells).unwrap_or(i32::MAX);
        let grown = |span: &Range<i32>| span.start.saturating_sub(cells)..span.end.saturating_add(cells);
        Rectangle {
            rows: grown(&self.rows),
            cols: grown(&self.cols),
        }
    }

    /// Returns whether the cell is in the rectangle.
    pub fn contains(&self, cell: Cell) -> bool {
        self.rows.contains(&cell.row) && self.cols.contains(&cell.col)
    }
}

/// A set of cells of a map.
///
/// Rows with the same members form a class, and so do columns; a table of bits says which classes meet in members. So
/// the memory depends on the rectangles, and on the sum of the sides of the map, not on the number of its cells.
#[derive(Clone, Debug, Default)]
pub(crate) struct Area {
    /// The class of each row.
    rows: Box<[u32]>,
    /// The class of each column.
    cols: Box<[u32]>,
    /// The words of `bits` for each class of rows.
    words: usize,
    bits: Box<[u64]>,
}

/// The maximum number of words of an [`Area`]: 16 MiB.
const WORDS_MAX: usize = 1 << 21;

impl Area {
    /// Returns the cells of rectangles, as far as they are on a map with this number of rows and columns. `None` if they
    /// take too much memory.
    pub fn of_rectangles(size: [i32; 2], rectangles: &[Rectangle]) -> Option<Area> {
        let (rows, row_classes) = classes(size[0], rectangles.iter().map(|rectangle| &rectangle.rows));
        let (cols, col_classes) = classes(size[1], rectangles.iter().map(|rectangle| &rectangle.cols));
        let words = col_classes.div_ceil(64);
        if row_classes.saturating_mul(words) > WORDS_MAX {
            return None;
        }
        let spans = rectangles.iter().filter_map(|rectangle| {
            let (across, along) = (ends(&rectangle.rows, &rows)?, ends(&rectangle.cols, &cols)?);
            Some([across, along])
        });
        // By their first class of rows, and by the one after the last.
        let mut begins: Vec<[[usize; 2]; 2]> = spans.collect();
        let mut stops = begins.clone();
        begins.sort_unstable_by_key(|[[first, _], _]| *first);
        stops.sort_unstable_by_key(|[[_, stop], _]| *stop);
        let (mut begins, mut stops) = (begins.into_iter().peekable(), stops.into_iter().peekable());
        // The number of rectangles in a class of columns, less that in the class before it.
        let mut changes = vec![0_i32; col_classes + 1];
        let mut bits = vec![0; row_classes * words];
        for (row, bits) in bits.chunks_exact_mut(words).enumerate() {
            while let Some([_, [first, stop]]) = begins.next_if(|[[begin, _], _]| *begin == row) {
                changes[first] += 1;
                changes[stop] -= 1;
            }
            while let Some([_, [first, stop]]) = stops.next_if(|[[_, end], _]| *end == row) {
                changes[first] -= 1;
                changes[stop] += 1;
            }
            let mut count = 0;
            for (col, change) in changes[..col_classes].iter().enumerate() {
                count += change;
                bits[col / 64] |= u64::from(count > 0) << (col % 64);
            }
        }
        Some(Area {
            rows,
            cols,
            words,
            bits: bits.into(),
        })
    }

    /// Returns the cells for which `holds` is true of the classes of row and column.
    pub fn of_classes(
        [rows, cols]: [Box<[u32]>; 2],
        [row_classes, col_classes]: [u32; 2],
        holds: impl Fn(u32, u32) -> bool,
    ) -> Area {
        let words = (col_classes as usize).div_ceil(64);
        let mut bits = vec![0; row_classes as usize * words];
        for row in 0..row_classes {
            for col in (0..col_classes).filter(|&col| holds(row, col)) {
                bits[row as usize * words + col as usize / 64] |= 1 << (col % 64);
            }
        }
        Area {
            rows,
            cols,
            words,
            bits: bits.into(),
        }
    }

    /// Returns whether the cell is a member; a cell off the map is none. Takes constant time.
    #[inline]
    pub fn contains(&self, cell: Cell) -> bool {
        // A negative number becomes one beyond the end.
        let (Some(&row), Some(&col)) = (self.rows.get(cell.row as usize), self.cols.get(cell.col as usize)) else {
            return false;
        };
        self.bits[row as usize * self.words + col as usize / 64] >> (col % 64) & 1 != 0
    }

    /// Returns the smallest rectangle around its members.
    pub fn bounds(&self) -> Rectangle {
        let has = |row: u32, col: u32| self.bits[row as usize * self.words + col as usize / 64] >> (col % 64) & 1 != 0;
        let all = |classes: &[u32]| 0..classes.iter().max().map_or(0, |last| last + 1);
        let (rows, cols) = (all(&self.rows), all(&self.cols));
        let span = |classes: &[u32], holds: &dyn Fn(u32) -> bool| {
            let first = classes.iter().position(|&class| holds(class));
            let last = classes.iter().rposition(|&class| holds(class));
            #[allow(clippy::cast_possible_truncation, clippy::cast_possible_wrap)] // a number of a row of a map
            match (first, last) {
                (Some(first), Some(last)) => first as i32..last as i32 + 1,
                _ => 0..0,
            }
        };
        let in_row: Vec<bool> = rows.clone().map(|row| cols.clone().any(|col| has(row, col))).collect();
        let in_col: Vec<bool> = cols.map(|col| rows.clone().any(|row| has(row, col))).collect();
        Rectangle {
            rows: span(&self.rows, &|class| in_row[class as usize]),
            cols: span(&self.cols, &|class| in_col[class as usize]),
        }
    }

    /// Returns whether it has no members.
    pub fn is_empty(&self) -> bool {
        self.bits.iter().all(|word| *word == 0)
    }

    /// Returns the class of each row and of each column: rows of one class have the same members, and so do columns.
    pub fn classes(&self) -> [&[u32]; 2] {
        [&self.rows, &self.cols]
    }
}

/// Splits the numbers below `size` into classes, so that each of the ranges consists of whole classes. Returns the class
/// of each number, in ascending order, and the number of classes.
fn classes<'r>(size: i32, ranges: impl Iterator<Item = &'r Range<i32>>) -> (Box<[u32]>, usize) {
    let mut begins = vec![false; size as usize];
    for at in ranges.flat_map(|range| [range.start, range.end]) {
        if let Some(begins) = usize::try_from(at).ok().and_then(|at| begins.get_mut(at)) {
            *begins = true;
        }
    }
    let mut class = 0;
    let classes = begins.iter().enumerate().map(|(at, begins)| {
        class += u32::from(*begins && at > 0);
        class
    });
    let classes: Box<[u32]> = classes.collect();
    (classes, class as usize + 1)
}

/// Returns the first class of a range and the one after its last, as far as it is on the map; `None` if it is not.
fn ends(range: &Range<i32>, classes: &[u32]) -> Option<[usize; 2]> {
    let end = usize::try_from(range.end).unwrap_or(0).min(classes.len());
    let start = usize::try_from(range.start).unwrap_or(0);
    (start < end).then(|| [classes[start] as usize, classes[end - 1] as usize + 1])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::{Purpose, RngExt, Seed};

    #[test]
    fn an_area_has_the_cells_of_its_rectangles() {
        let mut random = Seed(1).stream(Purpose::TEST, 0, 0);
        let mut counts = [0; 2];
        for round in 0..60 {
            let size = [(); 2].map(|()| random.random_range(1..150));
            let mut span = |size: i32| {
                let start = random.random_range(-9..size + 5);
                start..start + random.random_range(0..size.min(40))
            };
            let rectangle = |_| Rectangle {
                rows: span(size[0]),
                cols: span(size[1]),
            };
            let rectangles: Vec<Rectangle> = (0..round).map(rectangle).collect();
            let area = Area::of_rectangles(size, &rectangles).expect("it is small");
            for cell in (-2..size[0] + 2).flat_map(|row| (-2..size[1] + 2).map(move |col| Cell::new(row, col))) {
                let on_map = (0..size[0]).contains(&cell.row) && (0..size[1]).contains(&cell.col);
                let holds = on_map && rectangles.iter().any(|rectangle| rectangle.contains(cell));
                assert_eq!(area.contains(cell), holds, "{cell:?} {rectangles:?}");
                counts[usize::from(holds)] += 1;
            }
            let is_empty = rectangles.iter().all(|one| {
                let on_axis = |span: &Range<i32>, size: i32| span.start.max(0) < span.end.min(size);
                !on_axis(&one.rows, size[0]) || !on_axis(&one.cols, size[1])
            });
            assert_eq!(area.is_empty(), is_empty);
            let bounds = area.bounds();
            let members = || {
                let all = (0..size[0]).flat_map(|row| (0..size[1]).map(move |col| Cell::new(row, col)));
                all.filter(|&cell| area.contains(cell))
            };
            if !is_empty {
                let [low, high] = [
                    members().map(|cell| cell.row).min(),
                    members().map(|cell| cell.row).max(),
                ];
                assert_eq!(bounds.rows, low.unwrap()..high.unwrap() + 1);
                let [low, high] = [
                    members().map(|cell| cell.col).min(),
                    members().map(|cell| cell.col).max(),
                ];
                assert_eq!(bounds.cols, low.unwrap()..high.unwrap() + 1);
            }
        }
        assert!(counts.iter().all(|count| *count > 10_000), "{counts:?}");
    }

    #[test]
    fn few_rectangles_take_little_memory_on_any_map() {
        let size = [1 << 20; 2];
        let side = |at: i32| at * 1000..at * 1000 + 100;
        let rectangle = |at| Rectangle {
            rows: side(at),
            cols: side(at),
        };
        let few: Vec<Rectangle> = (0..1000).map(rectangle).collect();
        assert!(Area::of_rectangles(size, &few).expect("it is small").bits.len() < 1 << 17);
        let many: Vec<Rectangle> = (0..100_000)
            .map(|at| Rectangle {
                rows: at * 10..at * 10 + 3,
                cols: at * 10..at * 10 + 3,
            })
            .collect();
        assert!(Area::of_rectangles(size, &many).is_none());
    }
}
