//! A self-contained HTML page: sections of text, tables and figures, with a table of contents.
//!
//! Everything is inline; the page needs no network, no script and no font. It follows the reader's choice of
//! light or dark, and prints.

use std::fmt::Write;

use crate::plot::escape;

/// A page. [`Page::html`] writes it.
#[derive(Clone, Debug, Default)]
pub struct Page {
    /// Title, also of the window.
    pub title: String,
    /// One line below it.
    pub subtitle: String,
    /// What stands before the first section.
    pub head: Vec<Block>,
    /// The sections, in order.
    pub sections: Vec<Section>,
    /// One line at the end.
    pub footer: String,
}

/// A section with an entry in the table of contents.
#[derive(Clone, Debug)]
pub struct Section {
    /// Name in links: lower-case ASCII letters, digits and hyphens.
    pub id: String,
    /// Title.
    pub title: String,
    /// What stands in it.
    pub blocks: Vec<Block>,
}

impl Section {
    /// A section; its id is made from the title.
    pub fn new(title: impl Into<String>, blocks: Vec<Block>) -> Self {
        let title = title.into();
        let dashed: String = title.to_ascii_lowercase().chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '-' }).collect();
        let id = dashed.split('-').filter(|part| !part.is_empty()).collect::<Vec<_>>().join("-");
        Self { id, title, blocks }
    }
}

/// A part of a page. All text is plain: it is escaped when written.
#[derive(Clone, Debug)]
pub enum Block {
    /// A paragraph.
    Text(String),
    /// A list.
    List(Vec<String>),
    /// A sentence that must not be overlooked, such as what is missing.
    Notice(String),
    /// Cards with a bold sentence and the numbers behind it.
    Cards(Vec<(String, String)>),
    /// A table.
    Table(Table),
    /// A figure over the full width.
    Figure(Figure),
    /// Figures side by side where there is room.
    Figures(Vec<Figure>),
    /// Text as typed, such as a command.
    Code(String),
    /// Links: `(text, address)`; addresses are relative.
    Links(Vec<(String, String)>),
}

/// A table: the first column names the row, the others hold values.
#[derive(Clone, Debug, Default)]
pub struct Table {
    /// What the table shows.
    pub caption: String,
    /// Heads of the columns.
    pub head: Vec<String>,
    /// Rows; short rows are filled up.
    pub rows: Vec<Vec<String>>,
    /// How the cells after the first stand.
    pub cells: Cells,
}

/// How the cells of a table stand.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Cells {
    /// To the right, digits under digits.
    #[default]
    Numbers,
    /// To the left.
    Words,
}

/// A figure: an SVG with a caption.
#[derive(Clone, Debug)]
pub struct Figure {
    /// File name without extension, for the links below the figure; empty: no links.
    pub name: String,
    /// The SVG document.
    pub svg: String,
    /// What it shows and what to look at.
    pub caption: String,
}

impl Page {
    /// The page as one HTML document. It is well-formed XML, too.
    pub fn html(&self) -> String {
        let mut out = String::with_capacity(1 << 20);
        let title = escape(&self.title);
        let _ = write!(
            out,
            "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"/>\
             <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\"/>\
             <meta name=\"color-scheme\" content=\"light dark\"/>\
             <title>{title}</title><style>{STYLE}</style></head>\n<body>\n<header><h1>{title}</h1>\
             <p class=\"subtitle\">{}</p></header>\n<nav aria-label=\"Contents\"><ol>",
            escape(&self.subtitle)
        );
        for section in &self.sections {
            let _ = write!(out, "<li><a href=\"#{}\">{}</a></li>", section.id, escape(&section.title));
        }
        out.push_str("</ol></nav>\n<main>\n");
        for block in &self.head {
            block.write(&mut out);
        }
        for section in &self.sections {
            let _ = writeln!(out, "<section id=\"{}\"><h2>{}</h2>", section.id, escape(&section.title));
            for block in &section.blocks {
                block.write(&mut out);
            }
            out.push_str("</section>\n");
        }
        let _ = write!(out, "</main>\n<footer>{}</footer>\n</body></html>\n", escape(&self.footer));
        out
    }

    /// All figures of the page, in order.
    pub fn figures(&self) -> impl Iterator<Item = &Figure> {
        self.head.iter().chain(self.sections.iter().flat_map(|section| &section.blocks)).flat_map(|block| match block {
            Block::Figure(figure) => std::slice::from_ref(figure),
            Block::Figures(figures) => figures.as_slice(),
            _ => &[],
        })
    }
}

impl Block {
    fn write(&self, out: &mut String) {
        match self {
            Self::Text(text) => {
                let _ = writeln!(out, "<p>{}</p>", escape(text));
            }
            Self::Notice(text) => {
                let _ = writeln!(out, "<p class=\"notice\">{}</p>", escape(text));
            }
            Self::List(items) => {
                out.push_str("<ul>");
                for item in items {
                    let _ = write!(out, "<li>{}</li>", escape(item));
                }
                out.push_str("</ul>\n");
            }
            Self::Cards(cards) => {
                out.push_str("<div class=\"cards\">");
                for (head, detail) in cards {
                    let _ = write!(out, "<div class=\"card\"><p class=\"headline\">{}</p><p>{}</p></div>", escape(head), escape(detail));
                }
                out.push_str("</div>\n");
            }
            Self::Table(table) => table.write(out),
            Self::Figure(figure) => figure.write(out),
            Self::Figures(figures) => {
                out.push_str("<div class=\"pair\">");
                for figure in figures {
                    figure.write(out);
                }
                out.push_str("</div>\n");
            }
            Self::Code(text) => {
                let _ = writeln!(out, "<pre><code>{}</code></pre>", escape(text));
            }
            Self::Links(links) => {
                out.push_str("<ul class=\"links\">");
                for (text, address) in links {
                    let _ = write!(out, "<li><a href=\"{}\">{}</a></li>", escape(address), escape(text));
                }
                out.push_str("</ul>\n");
            }
        }
    }
}

impl Table {
    fn write(&self, out: &mut String) {
        let class = match self.cells {
            Cells::Numbers => "numbers",
            Cells::Words => "words",
        };
        let _ = write!(out, "<div class=\"scroll\"><table class=\"{class}\"><caption>{}</caption><thead><tr>", escape(&self.caption));
        for cell in &self.head {
            let _ = write!(out, "<th scope=\"col\">{}</th>", escape(cell));
        }
        out.push_str("</tr></thead><tbody>");
        for row in &self.rows {
            out.push_str("<tr>");
            for i in 0..self.head.len() {
                let cell = escape(row.get(i).map_or("", String::as_str));
                let _ = match i {
                    0 => write!(out, "<th scope=\"row\">{cell}</th>"),
                    _ => write!(out, "<td>{cell}</td>"),
                };
            }
            out.push_str("</tr>");
        }
        out.push_str("</tbody></table></div>\n");
    }
}

impl Figure {
    fn write(&self, out: &mut String) {
        let _ = write!(out, "<figure>{}<figcaption>{}", self.svg, escape(&self.caption));
        if !self.name.is_empty() {
            let name = escape(&self.name);
            let _ =
                write!(out, " <span class=\"files\"><a href=\"figures/{name}.svg\">SVG</a> <a href=\"figures/{name}.png\">PNG</a></span>");
        }
        out.push_str("</figcaption></figure>\n");
    }
}

const STYLE: &str = include_str!("page.css");
