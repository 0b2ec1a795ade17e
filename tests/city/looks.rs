//! The looks of concepts and kinds in pictures: `picture` in a configuration.

use crate::config::{load_memory, refused};
use logicity::city::{AgentKind, Look, OwnLook};
use logicity::config::Scenario;
use logicity::diag::render;
use std::sync::Arc;

const SVG: &str = r#"<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 20 50"><rect width="20" height="50"/></svg>"#;

fn load(files: &[(&str, &str)]) -> Scenario {
    let (sources, loaded) = load_memory(files);
    loaded.unwrap_or_else(|faults| panic!("{}", render(&faults, &sources, false)))
}

fn look(name: &str, of: AgentKind, look: Look) -> OwnLook {
    OwnLook {
        of,
        name: name.to_owned(),
        look,
    }
}

/// A drawing has the path of the file that names it, here in another folder.
#[test]
fn pictures_of_concepts_and_kinds_are_read() {
    let main = r##"
base: expert
kinds:
  Tram: {of: Car, picture: {icon: bus, color: "#8a1030", badge: t5}}
  Cyclist: {of: Car, picture: bicycle}
predicates: parts/own.yaml
"##;
    let parts = "
base: standard
define:
  IsTaxi: {concept: taxi, of: Car, picture: {color: yellow, badge: 05}}
  IsFire: {concept: fire, of: Car, picture: fire.svg}
  IsGuide: {concept: guide, of: Pedestrian, picture: {file: ../guide.SVG, badge: G}}
  IsVan: {concept: van, of: Car, picture: bus}
";
    let files = [
        ("main.yaml", main),
        ("parts/own.yaml", parts),
        ("parts/fire.svg", SVG),
        ("guide.SVG", SVG),
    ];
    let scenario = load(&files);
    let drawing = Some(Arc::from(SVG));
    let text = |text: &str| Some(text.to_owned());
    use AgentKind::{Car, Pedestrian};
    let expected = [
        look(
            "Tram",
            Car,
            Look {
                icon: text("bus"),
                color: Some([0x8a, 0x10, 0x30]),
                badge: text("T5"),
                drawing: None,
            },
        ),
        look(
            "taxi",
            Car,
            Look {
                color: Some([0xf5, 0xcf, 0x1d]),
                badge: text("05"),
                ..Look::default()
            },
        ),
        look(
            "fire",
            Car,
            Look {
                drawing: drawing.clone(),
                ..Look::default()
            },
        ),
        look(
            "guide",
            Pedestrian,
            Look {
                badge: text("G"),
                drawing,
                ..Look::default()
            },
        ),
        look(
            "van",
            Car,
            Look {
                icon: text("bus"),
                ..Look::default()
            },
        ),
    ];
    assert_eq!(scenario.looks, expected);
    let pictures: Vec<&str> = scenario.kinds.own().iter().map(|own| own.picture.as_str()).collect();
    assert_eq!(pictures, ["Tram", "bicycle"]);
    // The recorded configuration has the drawings, and no path.
    let mut recorded = scenario.composed.clone();
    recorded["rules"] = "expert".into();
    let recorded = recorded.to_string();
    assert!(!recorded.contains("parts") && !recorded.contains("../"), "{recorded}");
    let again = load(&[("main.yaml", &recorded)]);
    assert_eq!((&again.looks, &again.hash), (&scenario.looks, &scenario.hash));
}

#[test]
fn pictures_are_part_of_the_hash() {
    let of = |picture: &str| {
        let define = format!("IsTaxi: {{concept: taxi, of: Car{picture}}}");
        let text = format!("base: expert\npredicates: {{base: standard, define: {{{define}}}}}\n");
        load(&[("main.yaml", &text)]).hash
    };
    let plain = of("");
    assert_eq!(of(", picture: ~"), plain);
    let others = [
        of(", picture: bus"),
        of(", picture: {color: red}"),
        of(", picture: {badge: T}"),
    ];
    for (position, hash) in others.iter().enumerate() {
        assert!(*hash != plain && !others[..position].contains(hash));
    }
}

/// The text of a definition or of a kind, and what the message says.
#[test]
fn faulty_pictures_have_messages_with_places() {
    for (picture, expected) in [
        ("bycicle", "did you mean `bicycle`?"),
        ("old", "`{color: yellow, badge: TX}`"),
        ("{color: yelow}", "expected a color: `red`"),
        ("{color: \"#12345\"}", "expected a color"),
        ("{badge: TAXI}", "expected one or two letters or digits"),
        ("{badge: \"é\"}", "expected one or two letters or digits"),
        ("{}", "an empty picture"),
        ("{colr: red}", "did you mean `color`?"),
        ("{icon: gull}", "expected one of `ambulance`"),
        ("[bus]", "expected a picture (a mapping), found a list"),
        ("{svg: nothing}", "not an SVG drawing"),
        ("{svg: \"<svg/>\", color: red}", "`icon` and `color` do not apply"),
        ("no.svg", "cannot read `no.svg`: no such file"),
        ("{file: no.svg}", "cannot read `no.svg`: no such file"),
    ] {
        for (text, place) in [
            (
                format!(
                    "base: expert\npredicates:\n  base: standard\n  define:\n    IsTaxi: {{concept: taxi, of: Car, picture: {picture}}}\n"
                ),
                "main.yaml:5:",
            ),
            (
                format!("base: expert\nkinds:\n  Taxi: {{of: Car, picture: {picture}}}\n"),
                "main.yaml:3:",
            ),
        ] {
            let message = refused(&text);
            assert!(
                message.contains(expected) && message.contains(place),
                "{picture}\n{message}"
            );
        }
    }
    let define = |define: &str| {
        refused(&format!(
            "base: expert\npredicates:\n  base: standard\n  define:\n{define}"
        ))
    };
    let message = define("    IsBus: {picture: {color: red}}\n");
    assert!(
        message.contains("`bus` is a built-in concept, whose picture cannot be changed"),
        "{message}"
    );
    let message = define("    IsX: {near: House, within: 5, picture: bus}\n");
    assert!(message.contains("only a concept has a `picture`"), "{message}");
    let message =
        define("    IsA: {concept: a, of: Car, picture: bus}\n    IsB: {concept: a, of: Car, picture: tiro}\n");
    assert!(message.contains("`a` has two pictures"), "{message}");
    let message =
        define("    IsA: {concept: a, of: Car, picture: bus}\n    IsB: {concept: b, of: Car, picture: bus}\n");
    assert!(message.contains("`a` and `b` have the same picture"), "{message}");
    assert!(message.contains("main.yaml:6:"), "{message}");
}

/// A message about a drawing names the file of the drawing, with line and column.
#[test]
fn faulty_drawings_have_messages_with_places() {
    let main = "base: expert\npredicates:\n  base: standard\n  define:\n    IsTaxi: {concept: taxi, of: Car, picture: a.svg}\n";
    let svg =
        |content: &str| format!("<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 20 50\">\n{content}\n</svg>");
    let large = svg(&format!("<path d=\"{}\"/>", "M0 0".repeat(1 << 17)));
    for (drawing, expected, place) in [
        (
            svg("  <image href=\"/etc/passwd\"/>"),
            "`image` embeds another picture",
            "a.svg:2:3",
        ),
        (svg("<rect/><text>a</text>"), "text is not supported", "a.svg:2:8"),
        (svg("<script/>"), "`script` is not supported", "a.svg:2:1"),
        (
            svg("<use href=\"http://a/b.svg#c\"/>"),
            "refers to another file",
            "a.svg:2:1",
        ),
        (svg("<rect width=\"3\""), "not an SVG drawing", "a.svg:3:1"),
        (
            "<!DOCTYPE a [<!ENTITY b \"c\">]><svg/>".to_owned(),
            "not an SVG drawing",
            "a.svg:1:",
        ),
        (svg(""), "it draws nothing", "a.svg:1:1"),
        (String::new(), "not an SVG drawing", "a.svg:1:1"),
        (large, "bytes, the limit is 262144", "main.yaml:5:"),
    ] {
        let (sources, loaded) = load_memory(&[("main.yaml", main), ("a.svg", &drawing)]);
        let message = render(&loaded.expect_err(expected), &sources, false);
        assert!(
            message.contains(expected) && message.contains(place),
            "{place}\n{message}"
        );
    }
}
