//! The HTML file: style, script, and data in parts, which the script unpacks one after the other.
//!
//! A part is JSON, compressed with zlib and encoded in base 64. The browser draws the first frame after `scenery` and
//! `run`; the parts `proofs` follow in the order of ticks.
//!
//! The Content-Security-Policy of the page names this style and this script by their hashes: the browser runs no other
//! script and loads nothing, whatever the names in a trace contain.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use flate2::Compression;
use flate2::write::ZlibEncoder;
use serde::Serialize;
use sha2::{Digest, Sha256};
use std::io::{self, BufWriter, Write};

const TEMPLATE: &str = include_str!("page.html");
const STYLE: &str = include_str!("page.css");
/// The parts of the script, each after the parts that it depends on.
const SCRIPT: &str = concat!(
    include_str!("script/elements.js"),
    include_str!("script/data.js"),
    include_str!("script/run.js"),
    include_str!("script/recorded.js"),
    include_str!("script/svg.js"),
    include_str!("script/ground.js"),
    include_str!("script/roster.js"),
    include_str!("script/map.js"),
    include_str!("script/agent.js"),
    include_str!("script/chart.js"),
    include_str!("script/summary.js"),
    include_str!("script/difference.js"),
    include_str!("script/figure.js"),
    include_str!("script/split.js"),
    include_str!("script/viewer.js"),
    include_str!("script/page.js"),
);

/// The kind of a part, the number of its run, and its packed data.
pub type PagePart = (&'static str, usize, String);

/// Returns data as compressed JSON in base 64.
pub fn packed(data: &impl Serialize) -> io::Result<String> {
    // The buffer collects the many small writes of the serializer for the encoder.
    let mut packed = BufWriter::with_capacity(1 << 16, ZlibEncoder::new(Vec::new(), Compression::best()));
    serde_json::to_writer(&mut packed, data)?;
    Ok(STANDARD.encode(packed.into_inner()?.finish()?))
}

/// Writes a page with these parts.
///
/// # Errors
/// Errors of `out`.
pub fn write_parts(title: &str, parts: &[PagePart], out: &mut impl Write) -> io::Result<()> {
    let title = title.replace('&', "&amp;").replace('<', "&lt;");
    let (start, rest) = split(TEMPLATE, "{{POLICY}}");
    let (before, rest) = split(rest, "{{TITLE}}");
    let (head, rest) = split(rest, "{{STYLE}}");
    let (body, rest) = split(rest, "{{DATA}}");
    let (data_end, end) = split(rest, "{{SCRIPT}}");
    for text in [start, &policy(), before, &title, head, STYLE, body] {
        out.write_all(text.as_bytes())?;
    }
    for (kind, run, data) in parts {
        writeln!(
            out,
            r#"<script class="data" type="text/plain" data-kind="{kind}" data-run="{run}">{data}</script>"#
        )?;
    }
    for text in [data_end, SCRIPT, end] {
        out.write_all(text.as_bytes())?;
    }
    Ok(())
}

/// Returns the Content-Security-Policy of a page.
fn policy() -> String {
    let hash = |text: &str| format!("'sha256-{}'", STANDARD.encode(Sha256::digest(text)));
    format!(
        "default-src 'none'; script-src {}; style-src {}; img-src data: blob:; base-uri 'none'; form-action 'none'",
        hash(SCRIPT),
        hash(STYLE)
    )
}

fn split<'a>(text: &'a str, mark: &str) -> (&'a str, &'a str) {
    text.split_once(mark).expect("the template has all marks in order")
}
