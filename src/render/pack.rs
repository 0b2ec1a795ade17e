//! Icon packs: pictures and drawings of others, a folder a class.

use super::class::Class;
use resvg::tiny_skia::{IntSize, Pixmap};
use resvg::usvg::{self, ImageHrefResolver, Options, Tree, roxmltree};
use std::collections::BTreeMap;
use std::fmt;

/// The largest file of a pack, in bytes.
pub const PACK_FILE_MAX: usize = 4 << 20;
/// The longest side of a picture in a pack, in pixels.
const SIDE_MAX: u32 = 2048;
/// The most XML nodes of a drawing, and the most of them that refer to others.
const NODES_MAX: u32 = 20_000;
const USES_MAX: usize = 64;
/// The most files of a pack.
pub const PACK_FILES_MAX: usize = 10_000;

/// What a pack does to the icons that are drawn by parameters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mode {
    /// Its icons come in addition.
    Extend,
    /// A class that it has shows only its icons.
    Replace,
}

impl Mode {
    /// Both.
    pub const ALL: [Mode; 2] = [Mode::Extend, Mode::Replace];

    /// Its name on the command line.
    pub const fn name(self) -> &'static str {
        match self {
            Mode::Extend => "extend",
            Mode::Replace => "replace",
        }
    }
}

/// A file of a pack that cannot be used.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PackFault {
    /// Its path in the pack.
    pub file: String,
    /// Why.
    pub reason: String,
}

impl fmt::Display for PackFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "icon `{}`: {}", self.file, self.reason)
    }
}

impl std::error::Error for PackFault {}

/// Icons that were read. In a file a car heads up; the short side of its picture is the car's width.
#[derive(Clone, Debug)]
pub struct Pack {
    mode: Mode,
    classes: BTreeMap<Class, Vec<Art>>,
}

/// An icon of a pack.
#[derive(Clone, Debug)]
pub(super) enum Art {
    Picture(Pixmap),
    Drawing(Box<Tree>),
}

#[allow(clippy::cast_precision_loss)]
impl Art {
    /// Width and height, in units of its own.
    pub(super) fn size(&self) -> (f32, f32) {
        match self {
            Art::Picture(picture) => (picture.width() as f32, picture.height() as f32),
            Art::Drawing(tree) => (tree.size().width(), tree.size().height()),
        }
    }
}

impl Pack {
    /// Makes a pack of files, each with its path in the pack, `CLASS/NAME.png` or `CLASS/NAME.svg`. Within a class they are counted in
    /// the order of their paths. A drawing is taken for what it is alone: it may name no other file, and show no text and no filters.
    ///
    /// # Errors
    /// Every file that cannot be used, and why; a pack without icons.
    pub fn new(mode: Mode, mut files: Vec<(String, Vec<u8>)>) -> Result<Pack, Vec<PackFault>> {
        files.sort();
        let mut faults = Vec::new();
        let mut classes: BTreeMap<Class, Vec<Art>> = BTreeMap::new();
        for (file, bytes) in files {
            match icon(&file, &bytes) {
                Ok((class, art)) => classes.entry(class).or_default().push(art),
                Err(reason) => faults.push(PackFault { file, reason }),
            }
        }
        if classes.is_empty() && faults.is_empty() {
            faults.push(PackFault {
                file: "*/*".into(),
                reason: "there is none; a pack has a folder a class, such as `ambulance/1.png` or `bus+tiro/a.svg`"
                    .into(),
            });
        }
        if faults.is_empty() {
            Ok(Pack { mode, classes })
        } else {
            Err(faults)
        }
    }

    /// What it does to the icons that are drawn.
    pub fn mode(&self) -> Mode {
        self.mode
    }

    /// The classes it has icons of, each with their number.
    pub fn classes(&self) -> impl Iterator<Item = (&Class, usize)> {
        self.classes.iter().map(|(class, icons)| (class, icons.len()))
    }

    pub(super) fn of(&self, class: &Class) -> &[Art] {
        self.classes.get(class).map_or(&[], Vec::as_slice)
    }
}

/// The class and the icon of a file, or why there is none.
fn icon(file: &str, bytes: &[u8]) -> Result<(Class, Art), String> {
    let (folder, name) = file
        .split_once('/')
        .ok_or("it lies in no folder; the folder is the class")?;
    let class = Class::from_name(folder).ok_or_else(|| {
        let known: Vec<String> = Class::known().iter().map(Class::to_string).collect();
        format!(
            "there is no class `{folder}`; there are {}, and concepts joined by `+`",
            known.join(", ")
        )
    })?;
    if bytes.len() > PACK_FILE_MAX {
        return Err(format!("it is larger than {} MiB", PACK_FILE_MAX >> 20));
    }
    let art = match name
        .rsplit_once('.')
        .map(|(_, ending)| ending.to_ascii_lowercase())
        .as_deref()
    {
        Some("png") => Art::Picture(picture(bytes)?),
        Some("svg") => Art::Drawing(Box::new(drawing(bytes)?)),
        _ => return Err("it is neither `.png` nor `.svg`".into()),
    };
    Ok((class, art))
}

fn picture(bytes: &[u8]) -> Result<Pixmap, String> {
    let fault = |error: png::DecodingError| format!("not a PNG picture that can be read: {error}");
    let mut decoder = png::Decoder::new(std::io::Cursor::new(bytes));
    // Whatever the depth and the palette: bytes of grey or colours.
    decoder.set_transformations(png::Transformations::normalize_to_color8());
    let mut reader = decoder.read_info().map_err(fault)?;
    let (width, height) = (reader.info().width, reader.info().height);
    // What is not decoded cannot be too much.
    if width.max(height) > SIDE_MAX {
        return Err(format!(
            "{width} x {height} pixels; no side may have more than {SIDE_MAX}"
        ));
    }
    let mut data = vec![0; reader.output_buffer_size().ok_or("its size cannot be counted")?];
    let info = reader.next_frame(&mut data).map_err(fault)?;
    let samples = info.color_type.samples();
    let pixels = data
        .chunks_exact(samples)
        .take((width * height) as usize)
        .flat_map(|pixel| {
            let [r, g, b, alpha] = match *pixel {
                [grey] => [grey, grey, grey, 255],
                [grey, alpha] => [grey, grey, grey, alpha],
                [r, g, b] => [r, g, b, 255],
                [r, g, b, alpha] => [r, g, b, alpha],
                _ => [0; 4],
            };
            let times = |channel: u8| ((u32::from(channel) * u32::from(alpha) + 127) / 255) as u8;
            [times(r), times(g), times(b), alpha]
        });
    let size = IntSize::from_wh(width, height).ok_or("it has no pixels")?;
    Pixmap::from_vec(pixels.collect(), size).ok_or_else(|| "it ends too soon".into())
}

fn drawing(bytes: &[u8]) -> Result<Tree, String> {
    let text = std::str::from_utf8(bytes).map_err(|_| "not UTF-8 text")?;
    // Neither entities, which can grow without bounds, nor more nodes than a drawing needs.
    let limits = roxmltree::ParsingOptions {
        allow_dtd: false,
        nodes_limit: NODES_MAX,
        ..roxmltree::ParsingOptions::default()
    };
    let document = roxmltree::Document::parse_with_options(text, limits)
        .map_err(|error| format!("not an SVG drawing: {error}"))?;
    let mut uses = 0;
    for node in document.descendants().filter(roxmltree::Node::is_element) {
        let name = node.tag_name().name();
        let place = || document.text_pos_at(node.range().start);
        match name {
            "image" | "feImage" => {
                return Err(format!(
                    "line {}: `{name}` shows another picture; draw it instead",
                    place().row
                ));
            }
            "text" => return Err(format!("line {}: text is not shown; turn it into paths", place().row)),
            "filter" | "foreignObject" | "script" => {
                return Err(format!("line {}: `{name}` is not taken", place().row));
            }
            "use" => uses += 1,
            _ => {}
        }
        let outside = |value: &str| {
            let url = value
                .split("url(")
                .skip(1)
                .any(|url| !url.trim_start_matches([' ', '\'', '"']).starts_with('#'));
            url || value.contains("@import")
        };
        let text = node.text().filter(|_| name == "style");
        let foreign = node.attributes().any(|attribute| {
            attribute.name() == "href" && name != "a" && !attribute.value().starts_with('#')
                || outside(attribute.value())
        });
        if foreign || text.is_some_and(outside) {
            return Err(format!("line {}: `{name}` refers to another file", place().row));
        }
    }
    if uses > USES_MAX {
        return Err(format!("{uses} elements `use`; there may be {USES_MAX}"));
    }
    let options = Options {
        image_href_resolver: ImageHrefResolver {
            resolve_data: Box::new(|_, _, _| None),
            resolve_string: Box::new(|_, _| None),
        },
        ..Options::default()
    };
    let tree =
        Tree::from_xmltree(&document, &options).map_err(|error: usvg::Error| format!("not an SVG drawing: {error}"))?;
    let (width, height) = (tree.size().width(), tree.size().height());
    if width > height * 100.0 || height > width * 100.0 {
        return Err(format!("{width} x {height}: one side is more than 100 times the other"));
    }
    if tree.root().children().is_empty() {
        return Err("nothing is drawn in it".into());
    }
    Ok(tree)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn svg(body: &str) -> String {
        format!(
            r#"<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink" viewBox="0 0 10 20">{body}</svg>"#
        )
    }

    fn fault(file: &str, bytes: &[u8]) -> String {
        let faults = Pack::new(Mode::Extend, vec![(file.into(), bytes.to_vec())]).expect_err(file);
        assert_eq!(faults.len(), 1);
        assert_eq!(faults[0].file, file);
        faults[0].to_string()
    }

    #[test]
    fn what_cannot_be_used_is_told_with_the_file_and_why() {
        let bomb = (1..24).fold(svg_group(0, r#"<rect width="1" height="1"/>"#), |all, level| {
            let before = level - 1;
            all + &svg_group(level, &format!(r##"<use href="#g{before}"/><use href="#g{before}"/>"##))
        });
        let nested = svg(&("<g>".repeat(100_000) + &"</g>".repeat(100_000)));
        let deep = svg(&("<g>".repeat(5_000) + r#"<rect width="1" height="1"/>"# + &"</g>".repeat(5_000)));
        let entities =
            r#"<!DOCTYPE s [<!ENTITY a "aaaa">]><svg xmlns="http://www.w3.org/2000/svg"><g id="&a;"/></svg>"#;
        let long = svg("").replace("0 0 10 20", "0 0 10 20000");
        for (file, bytes, reason) in [
            ("car.png", String::new(), "no folder"),
            (
                "plane/1.png",
                String::new(),
                "no class `plane`; there are car, ambulance,",
            ),
            ("car/1.gif", String::new(), "neither `.png` nor `.svg`"),
            ("car/1.png", "no".into(), "not a PNG picture"),
            ("car/1.svg", "<svg".into(), "not an SVG drawing"),
            ("car/1.svg", svg(""), "nothing is drawn"),
            ("car/1.svg", long, "nothing is drawn"),
            ("car/1.svg", svg("\n<image href='/etc/passwd'/>"), "line 2: `image`"),
            ("car/1.svg", svg("<text>a</text>"), "turn it into paths"),
            ("car/1.svg", svg("<filter/>"), "`filter` is not taken"),
            (
                "car/1.svg",
                svg("<use xlink:href='other.svg#a'/>"),
                "`use` refers to another file",
            ),
            (
                "car/1.svg",
                svg("<rect style='fill: url( http://a/b )'/>"),
                "refers to another file",
            ),
            ("car/1.svg", svg("<style>@import 'a'</style>"), "refers to another file"),
            ("car/1.svg", svg(&"<use href='#a'/>".repeat(65)), "65 elements `use`"),
            ("car/1.svg", svg(&bomb), "not an SVG drawing"),
            ("car/1.svg", nested, "not an SVG drawing"),
            ("car/1.svg", deep, "not an SVG drawing"),
            ("car/1.svg", entities.into(), "not an SVG drawing"),
        ] {
            let told = fault(file, bytes.as_bytes());
            assert!(told.contains(reason), "{told}");
        }
        assert!(fault("car/1.svg", &vec![b' '; PACK_FILE_MAX + 1]).contains("larger than 4 MiB"));
        assert!(
            Pack::new(Mode::Replace, Vec::new()).expect_err("empty")[0]
                .reason
                .contains("there is none")
        );
    }

    fn svg_group(level: usize, body: &str) -> String {
        format!(r#"<g id="g{level}">{body}</g>"#)
    }

    #[test]
    fn a_picture_too_large_is_not_decoded() {
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, 40_000, 1);
        encoder.set_color(png::ColorType::Grayscale);
        encoder
            .write_header()
            .and_then(|mut writer| writer.write_image_data(&[7; 40_000]))
            .expect("written");
        assert!(fault("old/1.png", &bytes).contains("40000 x 1 pixels"));
    }
}
