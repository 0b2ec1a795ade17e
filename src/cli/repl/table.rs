//! Text tables with aligned columns.

use crate::diag::neutral;
use unicode_width::UnicodeWidthStr;

/// A column: its title, and whether it is numeric and so aligned to the right.
pub struct Column {
    pub title: String,
    pub numeric: bool,
}

/// Formats a table with a title line and a rule below it; every line ends with a line break.
pub fn draw(columns: &[Column], rows: &[Vec<String>]) -> String {
    let mut widths: Vec<usize> = columns.iter().map(|column| column.title.width()).collect();
    let rows: Vec<Vec<String>> = (rows.iter())
        .map(|row| row.iter().map(|cell| printable(cell)).collect())
        .collect();
    for row in &rows {
        for (width, cell) in widths.iter_mut().zip(row) {
            *width = (*width).max(cell.width());
        }
    }
    let line = |cells: &mut dyn Iterator<Item = &str>| {
        let mut line = String::new();
        for (cell, (column, &width)) in cells.zip(columns.iter().zip(&widths)) {
            let space = " ".repeat(width - cell.width());
            let (before, after) = if column.numeric {
                (space, String::new())
            } else {
                (String::new(), space)
            };
            line += &format!("{before}{cell}{after}  ");
        }
        line.truncate(line.trim_end().len());
        line + "\n"
    };
    let rules: Vec<String> = widths.iter().map(|&width| "-".repeat(width)).collect();
    let mut out = line(&mut columns.iter().map(|column| column.title.as_str()));
    out += &line(&mut rules.iter().map(String::as_str));
    for row in &rows {
        out += &line(&mut row.iter().map(String::as_str));
    }
    out
}

/// Escapes characters that would break the table or control the terminal.
fn printable(text: &str) -> String {
    neutral(&text.replace('\n', "\\n").replace('\t', "\\t")).into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_are_as_wide_as_their_widest_cell() {
        let column = |title: &str, numeric| Column {
            title: title.to_owned(),
            numeric,
        };
        let rows = [["東京", "7"], ["a\tb\u{1b}[1m", "-12"]].map(|row| row.map(str::to_owned).to_vec());
        let drawn = draw(&[column("name", false), column("n", true)], &rows);
        let lines: Vec<&str> = drawn.lines().collect();
        assert_eq!(lines.len(), 4);
        assert!(lines[0].starts_with("name ") && lines[0].ends_with(" n"), "{drawn}");
        assert_eq!(lines[1], "-------------  ---");
        let ends: Vec<usize> = lines.iter().map(|line| line.width()).collect();
        assert!(ends.iter().all(|&end| end == ends[0]), "{drawn}");
        assert!(lines[3].starts_with("a\\tb\\u001b[1m"), "{drawn}");
    }
}
