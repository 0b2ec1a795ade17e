//! Icon packs: PNG and SVG files by third parties, one folder per class.
// Decision: docs/decisions/pictures.md#d063

use crate::render::class::Class;
use resvg::tiny_skia::{IntSize, Pixmap, Transform};
use resvg::usvg::{self, ImageHrefResolver, Options, Tree, roxmltree};
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;
use std::fmt;
use std::ops::Range;
use std::panic::{AssertUnwindSafe, catch_unwind};

/// The largest file of a pack, in bytes.
pub const PACK_FILE_MAX: usize = 4 << 20;
/// The longest side of a picture in a pack, in pixels.
const SIDE_MAX: u32 = 2048;
/// The longest side of a stored icon, in pixels. Drawings are rasterized once at this size.
const KEPT_MAX: u32 = 384;
/// The largest ratio of an icon's sides.
const ASPECT_MAX: f32 = 6.0;
/// The most XML nodes of a drawing, and the most elements that it draws: each time that it refers to one counts.
const NODES_MAX: u32 = 20_000;
const DRAWN_MAX: usize = 20_000;
/// The maximum number of pixels of the pictures that drawing needs besides its result: of layers, masks and tiles of
/// patterns.
const PIXELS_MAX: f32 = 1e8;
/// The longest style sheets of a drawing, in bytes: each of their rules is tried on each element.
const STYLE_MAX: usize = 16 << 10;
/// The deepest nesting of elements, including referenced ones.
const DEPTH_MAX: usize = 48;
const SVG: &str = "http://www.w3.org/2000/svg";
/// The maximum number of files of a pack.
pub const PACK_FILES_MAX: usize = 2_000;

/// The combination of a pack with generated icons.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mode {
    /// Adds the icons of the pack to the generated ones.
    Extend,
    /// Replaces the generated icons of the classes in the pack.
    Replace,
}

impl Mode {
    /// Both modes.
    pub const ALL: [Mode; 2] = [Mode::Extend, Mode::Replace];

    /// Returns the name on the command line.
    pub const fn name(self) -> &'static str {
        match self {
            Mode::Extend => "extend",
            Mode::Replace => "replace",
        }
    }
}

/// An unusable file of a pack.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PackFault {
    /// Path in the pack.
    pub file: String,
    /// Why the file is unusable.
    pub reason: String,
}

impl fmt::Display for PackFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "icon `{}`: {}", self.file, self.reason)
    }
}

impl std::error::Error for PackFault {}

/// The icons of a pack. In a file, a car heads up and the short side of the picture is its width.
#[derive(Clone, Debug)]
pub struct Pack {
    mode: Mode,
    hash: String,
    classes: BTreeMap<Class, Vec<Pixmap>>,
}

impl Pack {
    /// Builds a pack from files, each with its path in the pack, `CLASS/NAME.png` or `CLASS/NAME.svg`. The paths order
    /// the instances of a class. A drawing must be self-contained, without references to other files, text or filters.
    ///
    /// # Errors
    /// All unusable files with reasons; a pack without icons.
    pub fn new(mode: Mode, mut files: Vec<(String, Vec<u8>)>) -> Result<Pack, Vec<PackFault>> {
        let hash = hash(&files);
        files.sort();
        let mut faults = Vec::new();
        let mut classes: BTreeMap<Class, Vec<Pixmap>> = BTreeMap::new();
        for (file, bytes) in files {
            match icon(&file, &bytes) {
                Ok((class, art)) => classes.entry(class).or_default().push(art),
                Err(reason) => faults.push(PackFault { file, reason }),
            }
        }
        if classes.is_empty() && faults.is_empty() {
            faults.push(PackFault {
                file: "*/*".into(),
                reason:
                    "no icons found; a pack has one folder per class, for example `ambulance/1.png` or `bus+tiro/a.svg`"
                        .into(),
            });
        }
        if faults.is_empty() {
            Ok(Pack { mode, hash, classes })
        } else {
            Err(faults)
        }
    }

    /// Returns how the pack combines with generated icons.
    pub fn mode(&self) -> Mode {
        self.mode
    }

    /// The SHA-256 of the paths and bytes of its files, in the order in which they were given.
    pub fn hash(&self) -> &str {
        &self.hash
    }

    /// The classes it has icons of, each with their number.
    pub fn classes(&self) -> impl Iterator<Item = (&Class, usize)> {
        self.classes.iter().map(|(class, icons)| (class, icons.len()))
    }

    pub(super) fn of(&self, class: &Class) -> &[Pixmap] {
        self.classes.get(class).map_or(&[], Vec::as_slice)
    }
}

fn hash(files: &[(String, Vec<u8>)]) -> String {
    let mut hash = Sha256::new();
    for (name, bytes) in files {
        // The lengths separate consecutive paths and contents.
        for part in [name.as_bytes(), bytes] {
            hash.update((part.len() as u64).to_le_bytes());
            hash.update(part);
        }
    }
    format!("{:x}", hash.finalize())
}

/// The class and the icon of a file, or why there is none.
fn icon(file: &str, bytes: &[u8]) -> Result<(Class, Pixmap), String> {
    let (folder, name) = file
        .split_once('/')
        .ok_or("it is in no folder; the folder names the class")?;
    let class = Class::from_name(folder).ok_or_else(|| {
        let known: Vec<String> = Class::known().iter().map(Class::to_string).collect();
        format!(
            "unknown class `{folder}`; the classes are {}, and concepts joined by `+`",
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
        Some("png") => picture(bytes)?,
        Some("svg") => {
            let text = std::str::from_utf8(bytes).map_err(|_| "not UTF-8 text")?;
            drawing(text).map_err(|fault| match &fault.place {
                Some(place) => {
                    let line = 1 + text[..place.start].matches('\n').count();
                    format!("line {line}: {}", fault.reason)
                }
                None => fault.reason,
            })?
        }
        _ => return Err("it is neither `.png` nor `.svg`".into()),
    };
    let largest = art.width().max(art.height());
    if largest <= KEPT_MAX {
        return Ok((class, art));
    }
    let side = |length: u32| (length * KEPT_MAX / largest).max(1);
    let art = shrunk(&art, side(art.width()), side(art.height()));
    Ok((class, art))
}

fn picture(bytes: &[u8]) -> Result<Pixmap, String> {
    let fault = |error: png::DecodingError| format!("not a valid PNG: {error}");
    let mut decoder = png::Decoder::new(std::io::Cursor::new(bytes));
    // Converts any depth and palette to 8-bit grayscale or color.
    decoder.set_transformations(png::Transformations::normalize_to_color8());
    let mut reader = decoder.read_info().map_err(fault)?;
    let (width, height) = (reader.info().width, reader.info().height);
    // Checks the size before decoding.
    if width.max(height) > SIDE_MAX {
        return Err(format!(
            "{width} x {height} pixels; no side may have more than {SIDE_MAX}"
        ));
    }
    let mut data = vec![0; reader.output_buffer_size().ok_or("its size overflows")?];
    let info = reader.next_frame(&mut data).map_err(fault)?;
    let samples = info.color_type.samples();
    let pixels = data
        .chunks_exact(samples)
        .take((width * height) as usize)
        .flat_map(|pixel| {
            let [r, g, b, alpha] = match *pixel {
                [gray] => [gray, gray, gray, 255],
                [gray, alpha] => [gray, gray, gray, alpha],
                [r, g, b] => [r, g, b, 255],
                [r, g, b, alpha] => [r, g, b, alpha],
                _ => [0; 4],
            };
            let times = |channel: u8| ((u32::from(channel) * u32::from(alpha) + 127) / 255) as u8;
            [times(r), times(g), times(b), alpha]
        });
    #[allow(clippy::cast_precision_loss)]
    check_aspect(width as f32, height as f32)?;
    let size = IntSize::from_wh(width, height).ok_or("it has no pixels")?;
    Pixmap::from_vec(pixels.collect(), size).ok_or_else(|| "it is truncated".into())
}

/// Rejects extreme aspect ratios, because a rotated icon needs a square.
fn check_aspect(width: f32, height: f32) -> Result<(), String> {
    match width.max(height) > width.min(height) * ASPECT_MAX {
        true => Err(format!(
            "{width} x {height}: one side is more than {ASPECT_MAX} times the other"
        )),
        false => Ok(()),
    }
}

/// Why a drawing cannot be used.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DrawingFault {
    /// The reason.
    pub reason: String,
    /// The bytes of its text to which the reason applies, if it does not apply to all.
    pub place: Option<Range<usize>>,
}

impl From<String> for DrawingFault {
    fn from(reason: String) -> DrawingFault {
        DrawingFault { reason, place: None }
    }
}

impl From<&str> for DrawingFault {
    fn from(reason: &str) -> DrawingFault {
        reason.to_owned().into()
    }
}

/// Checks the text of an SVG drawing: it must be self-contained, without references to other files, text, filters or
/// scripts, and within the limits of packs.
///
/// # Errors
/// The reason why it cannot be used.
pub fn check_drawing(text: &str) -> Result<(), DrawingFault> {
    drawing(text).map(|_| ())
}

/// Returns the bytes of the character at a line and a column, which count from 1.
fn place_of(text: &str, at: roxmltree::TextPos) -> Range<usize> {
    let line = text
        .split_inclusive('\n')
        .take(at.row.saturating_sub(1) as usize)
        .map(str::len)
        .sum::<usize>();
    let rest = &text[line..];
    let column = rest.char_indices().nth(at.col.saturating_sub(1) as usize);
    let start = line + column.map_or(rest.len(), |(start, _)| start);
    start..start + text[start..].chars().next().map_or(0, char::len_utf8)
}

/// Draws the text of an SVG drawing.
pub(super) fn drawing(text: &str) -> Result<Pixmap, DrawingFault> {
    // Forbids entities, which can expand without bounds, and limits the nodes.
    let limits = roxmltree::ParsingOptions {
        allow_dtd: false,
        nodes_limit: NODES_MAX,
        ..roxmltree::ParsingOptions::default()
    };
    let document = roxmltree::Document::parse_with_options(text, limits).map_err(|error| DrawingFault {
        reason: format!("not an SVG drawing: {error}"),
        place: Some(place_of(text, error.pos())),
    })?;
    check_elements(&document)?;
    check_nesting(&document)?;
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
    check_aspect(width, height)?;
    let extent = tree.root().abs_stroke_bounding_box();
    let far = [extent.left(), extent.top(), extent.right(), extent.bottom()];
    if far.into_iter().any(|at| at.abs() > 100.0 * width.max(height)) {
        return Err("it extends more than 100 times beyond its view box".into());
    }
    if tree.root().children().is_empty() {
        return Err("it draws nothing".into());
    }
    #[allow(clippy::cast_precision_loss)]
    let scale = KEPT_MAX as f32 / width.max(height);
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    let side = |length: f32| ((length * scale).round() as u32).clamp(1, KEPT_MAX);
    let mut pixmap = Pixmap::new(side(width), side(height)).ok_or("it has no size")?;
    let pixels = pixels(
        tree.root(),
        Transform::from_scale(scale, scale),
        (pixmap.width() * pixmap.height()) as f32,
    );
    if pixels.is_nan() || pixels > PIXELS_MAX {
        return Err("it has too many layers, masks or patterns, or too large ones".into());
    }
    // The rasterizer panics on extreme coordinates, also in clips and masks, which have no extent here.
    let painted = catch_unwind(AssertUnwindSafe(|| {
        resvg::render(&tree, Transform::from_scale(scale, scale), &mut pixmap.as_mut());
    }));
    painted.map_err(|_| "it cannot be drawn; check it for very large or very small numbers")?;
    Ok(pixmap)
}

/// Rejects elements with external or expensive content.
fn check_elements(document: &roxmltree::Document<'_>) -> Result<(), DrawingFault> {
    let mut styles = 0;
    let patterns = document.descendants().any(|node| node.has_tag_name((SVG, "pattern")));
    for node in document.descendants().filter(roxmltree::Node::is_element) {
        let name = node.tag_name().name();
        let fault = |reason: String| {
            let start = node.range().start;
            let place = Some(start..start + 1 + name.len());
            Err(DrawingFault { reason, place })
        };
        match name {
            "image" | "feImage" => return fault(format!("`{name}` embeds another picture; draw it instead")),
            "text" => return fault("text is not supported; convert it to paths".into()),
            "filter" | "foreignObject" | "script" => return fault(format!("`{name}` is not supported")),
            _ => {}
        }
        let outside = |value: &str| value.contains("@import") || urls(value).any(|url| !url.starts_with('#'));
        let style = node.text().filter(|_| name == "style").unwrap_or_default();
        styles += style.len();
        let foreign = node.attributes().any(|attribute| {
            let link = attribute.name() == "href" && !attribute.value().starts_with('#');
            link || outside(attribute.value())
        });
        if foreign || outside(style) {
            return fault(format!("`{name}` refers to another file"));
        }
        // The elements do not show the depth of these references.
        let deep = ["mask", "clip-path", "marker"];
        if let Some(property) = deep.into_iter().find(|property| style.contains(property)) {
            return fault(format!("`{property}` in a style sheet; write it as an attribute"));
        }
        if patterns && urls(style).next().is_some() {
            return fault("a style sheet and a `pattern`; write `fill` and `stroke` as attributes".into());
        }
    }
    match styles > STYLE_MAX {
        true => Err(format!("style sheets of {styles} bytes; the limit is {STYLE_MAX}").into()),
        false => Ok(()),
    }
}

/// Returns the pixels of the pictures that the rasterizer makes besides the result: one of `whole` pixels for each layer
/// and each mask, and one for each tile.
fn pixels(group: &usvg::Group, transform: Transform, whole: f32) -> f32 {
    let of_node = |node: &usvg::Node| match node {
        usvg::Node::Group(group) => {
            let transform = transform.pre_concat(group.transform());
            let of_mask = |root: &usvg::Group| whole + pixels(root, transform, whole);
            let clips = std::iter::successors(group.clip_path(), |clip| clip.clip_path());
            let masks = std::iter::successors(group.mask(), |mask| mask.mask());
            let outer: f32 = clips.map(|clip| of_mask(clip.root())).sum();
            let outer: f32 = outer + masks.map(|mask| of_mask(mask.root())).sum::<f32>();
            let layer = if group.should_isolate() { whole } else { 0.0 };
            layer + outer + pixels(group, transform, whole)
        }
        usvg::Node::Path(path) => {
            let fill = path.fill().map(usvg::Fill::paint);
            let paints = fill.into_iter().chain(path.stroke().map(usvg::Stroke::paint));
            let tile = |paint: &usvg::Paint| match paint {
                usvg::Paint::Pattern(pattern) => {
                    let (x, y) = transform.pre_concat(pattern.transform()).get_scale();
                    let size = pattern.rect().width() * x * pattern.rect().height() * y;
                    size + pixels(pattern.root(), Transform::from_scale(x, y), size)
                }
                _ => 0.0,
            };
            paints.map(tile).sum()
        }
        _ => 0.0,
    };
    group.children().iter().map(of_node).sum()
}

/// Returns the contents of `url(..)`.
fn urls(text: &str) -> impl Iterator<Item = &str> {
    let inner = |rest: &'_ str| -> Option<usize> { rest.find(')') };
    (text.split("url(").skip(1))
        .map(move |rest| rest[..inner(rest).unwrap_or(rest.len())].trim_matches([' ', '\'', '"']))
}

/// Rejects elements and references that nest too deep, because the rasterizer recurses as deep, and those that multiply.
fn check_nesting(document: &roxmltree::Document<'_>) -> Result<(), String> {
    type SvgNode<'a> = roxmltree::Node<'a, 'a>;
    /// Returns the depth below a node, and the number of elements drawn for it; `None` if the depth exceeds `left`.
    fn below<'a>(
        node: SvgNode<'a>,
        left: usize,
        ids: &BTreeMap<&str, Vec<SvgNode<'a>>>,
        known: &mut BTreeMap<usize, (usize, usize)>,
    ) -> Option<(usize, usize)> {
        if let Some(&(depth, drawn)) = known.get(&node.id().get_usize()) {
            return (depth <= left).then_some((depth, drawn));
        }
        let left = left.checked_sub(1)?;
        let links = node.attributes().flat_map(|attribute| {
            let href = Some(attribute.value()).filter(|_| attribute.name() == "href");
            href.into_iter().chain(urls(attribute.value()))
        });
        let targets = links
            .filter_map(|link| ids.get(link.strip_prefix('#')?))
            .flatten()
            .copied();
        let (mut deepest, mut sum) = (0, 1_usize);
        for next in node.children().filter(SvgNode::is_element).chain(targets) {
            let (depth, drawn) = below(next, left, ids, known)?;
            deepest = deepest.max(depth);
            sum = sum.saturating_add(drawn);
        }
        known.insert(node.id().get_usize(), (deepest + 1, sum));
        Some((deepest + 1, sum))
    }
    let elements = || document.descendants().filter(SvgNode::is_element);
    // Several elements may have one name; readers differ in which they choose.
    let mut ids: BTreeMap<&str, Vec<SvgNode<'_>>> = BTreeMap::new();
    for node in elements() {
        if let Some(id) = node.attribute("id") {
            ids.entry(id).or_default().push(node);
        }
    }
    match below(document.root_element(), DEPTH_MAX, &ids, &mut BTreeMap::new()) {
        None => Err(format!("elements and references nest more than {DEPTH_MAX} deep")),
        Some((_, drawn)) if drawn > DRAWN_MAX => {
            Err(format!("references repeat elements: it draws more than {DRAWN_MAX}"))
        }
        Some(_) => Ok(()),
    }
}

/// Returns a picture downsampled by averaging; no side grows.
pub(super) fn shrunk(picture: &Pixmap, width: u32, height: u32) -> Pixmap {
    let (from_w, from_h) = (picture.width(), picture.height());
    let (width, height) = (width.min(from_w), height.min(from_h));
    let mut small = Pixmap::new(width, height).expect("no side is 0");
    let span = |at: u32, to: u32, from: u32| {
        let (at, to, from) = (u64::from(at), u64::from(to), u64::from(from));
        let start = at * from / to;
        (start as usize, ((at + 1) * from).div_ceil(to).max(start + 1) as usize)
    };
    for y in 0..height {
        let (top, bottom) = span(y, height, from_h);
        for x in 0..width {
            let (left, right) = span(x, width, from_w);
            let mut sum = [0_u64; 4];
            for row in top..bottom {
                let row = row * from_w as usize;
                for pixel in picture.data()[4 * (row + left)..4 * (row + right)].chunks_exact(4) {
                    // No inner loop: without optimization, it takes most of the time of the tests that draw icons.
                    sum[0] += u64::from(pixel[0]);
                    sum[1] += u64::from(pixel[1]);
                    sum[2] += u64::from(pixel[2]);
                    sum[3] += u64::from(pixel[3]);
                }
            }
            let count = ((bottom - top) * (right - left)) as u64;
            let at = 4 * (y * width + x) as usize;
            for (to, sum) in small.data_mut()[at..at + 4].iter_mut().zip(sum) {
                *to = ((sum + count / 2) / count) as u8;
            }
        }
    }
    small
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
    fn what_cannot_be_used_is_reported_with_the_file_and_why() {
        // Each level shows the one before four times.
        let bomb = (1..16).fold(svg_group(0, r#"<rect width="1" height="1"/>"#), |all, level| {
            let before = format!("<use href='#g{}'/>", level - 1);
            all + &svg_group(level, &before.repeat(4))
        });
        let masks: String = (1..9)
            .map(|level| {
                let masked = format!("<rect width='9' height='9' mask='url(#m{})'/>", level - 1);
                format!("<mask id='m{level}'>{}</mask>", masked.repeat(8))
            })
            .collect();
        let masks = masks + "<mask id='m0'/><rect width='9' height='9' mask='url(#m8)'/>";
        let layers = "<rect width='9' height='9' opacity='0.5'/>".repeat(9_000);
        let tile = "<pattern id='p' width='90000' height='90000' patternUnits='userSpaceOnUse'>\
            <rect width='1' height='1'/></pattern><rect width='9' height='9' fill='url(#p)'/>";
        let style = format!("<style>{}</style>", "rect{fill:red}   ".repeat(1_000));
        let nested = svg(&("<g>".repeat(100_000) + &"</g>".repeat(100_000)));
        let deep = svg(&("<g>".repeat(5_000) + r#"<rect width="1" height="1"/>"# + &"</g>".repeat(5_000)));
        let chain: String = (1..60)
            .map(|at| format!("<mask id='m{at}' mask='url(#m{})'/>", at - 1))
            .collect();
        let chain = svg(&chain);
        let entities =
            r#"<!DOCTYPE s [<!ENTITY a "aaaa">]><svg xmlns="http://www.w3.org/2000/svg"><g id="&a;"/></svg>"#;
        let long = svg("<rect width='1' height='1'/>").replace("0 0 10 20", "0 0 10 61");
        for (file, bytes, reason) in [
            ("car.png", String::new(), "no folder"),
            (
                "plane/1.png",
                String::new(),
                "unknown class `plane`; the classes are car, ambulance,",
            ),
            ("car/1.gif", String::new(), "neither `.png` nor `.svg`"),
            ("car/1.png", "no".into(), "not a valid PNG"),
            ("car/1.svg", "<svg".into(), "not an SVG drawing"),
            ("car/1.svg", svg(""), "draws nothing"),
            ("car/1.svg", long, "more than 6 times"),
            ("car/1.svg", svg("\n<image href='/etc/passwd'/>"), "line 2: `image`"),
            ("car/1.svg", svg("<text>a</text>"), "convert it to paths"),
            ("car/1.svg", svg("<filter/>"), "`filter` is not supported"),
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
            ("car/1.svg", svg(&bomb), "references repeat elements"),
            ("car/1.svg", svg(&masks), "references repeat elements"),
            ("car/1.svg", svg(&layers), "too many layers, masks or patterns"),
            ("car/1.svg", svg(tile), "too many layers, masks or patterns"),
            ("car/1.svg", svg(&style), "style sheets of 17000 bytes"),
            ("car/1.svg", nested, "not an SVG drawing"),
            ("car/1.svg", deep, "more than 48 deep"),
            ("car/1.svg", chain, "more than 48 deep"),
            ("car/1.svg", svg("<g id='a'><use href='#a'/></g>"), "more than 48 deep"),
            (
                "car/1.svg",
                svg("<style>.a { mask: url(#m) }</style>"),
                "`mask` in a style sheet",
            ),
            (
                "car/1.svg",
                svg("<pattern/><style>.a { fill: url(#m) }</style>"),
                "a style sheet and a `pattern`",
            ),
            ("car/1.svg", entities.into(), "not an SVG drawing"),
        ] {
            let message = fault(file, bytes.as_bytes());
            assert!(message.contains(reason), "{message}");
        }
        assert!(fault("car/1.svg", &vec![b' '; PACK_FILE_MAX + 1]).contains("larger than 4 MiB"));
        assert!(
            Pack::new(Mode::Replace, Vec::new()).expect_err("empty")[0]
                .reason
                .contains("no icons found")
        );
    }

    fn svg_group(level: usize, body: &str) -> String {
        format!(r#"<g id="g{level}">{body}</g>"#)
    }

    #[test]
    fn a_picture_too_large_is_not_decoded() {
        let grayscale = |width: u32| {
            let mut bytes = Vec::new();
            let mut encoder = png::Encoder::new(&mut bytes, width, 1);
            encoder.set_color(png::ColorType::Grayscale);
            encoder
                .write_header()
                .and_then(|mut writer| writer.write_image_data(&vec![7; width as usize]))
                .expect("written");
            bytes
        };
        assert!(fault("old/1.png", &grayscale(40_000)).contains("40000 x 1 pixels"));
        assert!(fault("old/1.png", &grayscale(7)).contains("7 x 1: one side is more than 6 times"));
    }
}
