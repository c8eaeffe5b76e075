//! Text of pictures as outlines of the built-in font, letter by letter from left to right, with kerning.

use std::fmt::Write;

use roxmltree::{Document, Node};
use ttf_parser::{Face, GlyphId, OutlineBuilder};

/// The document `svg` with every `text` as a `path`. Of its attributes position or transform, anchor, size, weight and fill count.
///
/// # Errors
/// The document is malformed.
pub(crate) fn outlined(svg: &str) -> Result<String, roxmltree::Error> {
    let document = Document::parse(svg)?;
    let [regular, bold] =
        [dejavu::sans::regular(), dejavu::sans::bold()].map(|font| Face::parse(font, 0).expect("a font that is built in"));
    let (mut out, mut done) = (String::with_capacity(4 * svg.len()), 0);
    for text in document.descendants().filter(|node| node.has_tag_name((SVG, "text"))) {
        out.push_str(&svg[done..text.range().start]);
        let font = if text.attribute("font-weight") == Some("bold") { &bold } else { &regular };
        let _ = path(&mut out, &text, font);
        done = text.range().end;
    }
    out.push_str(&svg[done..]);
    Ok(out)
}

const SVG: &str = "http://www.w3.org/2000/svg";

/// Writes the path of `text` in the units of the font, upwards, under a transform.
fn path(out: &mut String, text: &Node<'_, '_>, font: &Face<'_>) -> std::fmt::Result {
    let number = |name: &str, other: f64| text.attribute(name).and_then(|value| value.parse().ok()).unwrap_or(other);
    let place = match text.attribute("transform") {
        Some(transform) => transform.to_owned(),
        None => format!("translate({} {})", number("x", 0.0), number("y", 0.0)),
    };
    let line = Line::of(text.text().unwrap_or_default(), font);
    let held = match text.attribute("text-anchor") {
        Some("middle") => 0.5 * line.width,
        Some("end") => line.width,
        _ => 0.0,
    };
    let scale = number("font-size", 12.0) / f64::from(font.units_per_em());
    let fill = text.attribute("fill").unwrap_or("#000000");
    write!(out, r#"<path transform="{place} scale({scale} -{scale}) translate(-{held} 0)" fill="{fill}" d="{}"/>"#, line.outline)
}

/// A line of text, in the units of its font.
struct Line {
    outline: String,
    width: f64,
}

impl Line {
    fn of(text: &str, font: &Face<'_>) -> Self {
        let mut line = Self { outline: String::new(), width: 0.0 };
        let mut before = None;
        for letter in text.chars() {
            let glyph = font.glyph_index(letter).unwrap_or_default();
            line.width += before.map_or(0.0, |before| kerning(font, before, glyph));
            font.outline_glyph(glyph, &mut line);
            line.width += f64::from(font.glyph_hor_advance(glyph).unwrap_or(0));
            before = Some(glyph);
        }
        line
    }

    /// Writes a command with points, the next letter's place added.
    fn command(&mut self, name: char, points: &[[f32; 2]]) {
        self.outline.push(name);
        for [x, y] in points {
            let _ = write!(self.outline, "{} {} ", self.width + f64::from(*x), y);
        }
    }
}

impl OutlineBuilder for Line {
    fn move_to(&mut self, x: f32, y: f32) {
        self.command('M', &[[x, y]]);
    }

    fn line_to(&mut self, x: f32, y: f32) {
        self.command('L', &[[x, y]]);
    }

    fn quad_to(&mut self, x1: f32, y1: f32, x: f32, y: f32) {
        self.command('Q', &[[x1, y1], [x, y]]);
    }

    fn curve_to(&mut self, x1: f32, y1: f32, x2: f32, y2: f32, x: f32, y: f32) {
        self.command('C', &[[x1, y1], [x2, y2], [x, y]]);
    }

    fn close(&mut self) {
        self.command('Z', &[]);
    }
}

/// How much farther apart two letters stand, in the units of the font.
fn kerning(font: &Face<'_>, left: GlyphId, right: GlyphId) -> f64 {
    let tables = font.tables().kern.iter().flat_map(|kern| kern.subtables);
    let pairs = tables.filter(|table| table.horizontal && !table.variable).filter_map(|table| table.glyphs_kerning(left, right));
    pairs.map(f64::from).next().unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_becomes_paths_where_it_stood() {
        let svg = |x: &str, anchor: &str, text: &str| {
            format!(
                r##"<svg xmlns="{SVG}"><text x="{x}" y="5" text-anchor="{anchor}" fill="#123456" font-size="12">{text}</text><g/></svg>"##
            )
        };
        let path = outlined(&svg("7", "start", "a &lt; b")).unwrap();
        assert!(
            path.contains(r##"<path transform="translate(7 5) scale(0.005859375 -0.005859375) translate(-0 0)" fill="#123456" d="M"##),
            "{path}"
        );
        assert!(path.ends_with("/><g/></svg>") && !path.contains("<text"), "{path}");
        assert_ne!(path, outlined(&svg("7", "middle", "a &lt; b")).unwrap());
        assert!(outlined("<svg").is_err());
    }

    /// Of DejaVu Sans, 2048 units an em: A is 1401 wide, and draws V closer.
    #[test]
    fn letters_stand_side_by_side_and_some_pairs_closer() {
        let font = Face::parse(dejavu::sans::regular(), 0).unwrap();
        let width = |text: &str| Line::of(text, &font).width;
        assert_eq!((width(""), width("A"), width("HH")), (0.0, 1401.0, 2.0 * width("H")));
        assert!(width("AV") < width("A") + width("V"), "{}", width("AV"));
    }
}
