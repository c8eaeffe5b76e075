//! Results as plain text for a terminal.

use std::fmt::Write;
use std::path::Path;

use greenwater_report::page::Table;
use greenwater_report::words::duration;

use super::Measured;
use super::page;

/// Width of the text, characters.
const WIDTH: usize = 110;

/// Tables, one under the other.
pub fn text(tables: &[Table]) -> String {
    let mut out = String::new();
    for table in tables {
        let width = |column: usize| {
            let cells = table.rows.iter().chain([&table.head]).filter_map(|row| row.get(column));
            cells.map(|cell| cell.chars().count()).max().unwrap_or(0)
        };
        let widths: Vec<usize> = (0..table.head.len()).map(width).collect();
        wrap(&mut out, "", &table.caption);
        for row in [&table.head].into_iter().chain(&table.rows) {
            for (i, width) in widths.iter().enumerate() {
                let cell = row.get(i).map_or("", String::as_str);
                let _ = if i == 0 { write!(out, "  {cell:<width$}") } else { write!(out, "  {cell:>width$}") };
            }
            out.push('\n');
        }
        out.push('\n');
    }
    out
}

/// The whole of `bench paper`: tables, claims, and where the page is.
pub fn paper(measured: &Measured, out: &Path) -> String {
    let mut summary = String::new();
    for tables in [page::search_tables(&measured.search), page::solver_tables(&measured.solvers), page::method_tables(&measured.methods)] {
        summary.push_str(&text(&tables));
    }
    summary.push_str("Claims of the paper\n");
    for claim in &measured.claims {
        let _ = writeln!(summary, "\n  {}: {}", claim.verdict.text().to_uppercase(), claim.claim);
        wrap(&mut summary, "    ", &claim.measured);
        wrap(&mut summary, "    Rule: ", &claim.rule);
    }
    let _ = writeln!(summary, "\n{} in {}", out.join("index.html").display(), duration(measured.seconds));
    summary
}

/// Appends `text` in lines of [`WIDTH`] characters after `start`, the later ones indented as far.
fn wrap(out: &mut String, start: &str, text: &str) {
    let indent = " ".repeat(start.chars().count());
    let mut line = start.to_owned();
    let mut empty = true;
    for word in text.split_whitespace() {
        if !empty && line.chars().count() + 1 + word.chars().count() > WIDTH {
            out.push_str(line.trim_end());
            out.push('\n');
            line.clone_from(&indent);
            empty = true;
        }
        if !empty {
            line.push(' ');
        }
        line.push_str(word);
        empty = false;
    }
    out.push_str(line.trim_end());
    out.push('\n');
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_stand_under_each_other_and_long_text_is_wrapped() {
        let table = Table {
            caption: "word ".repeat(40),
            head: vec!["N".into(), "time [s]".into()],
            rows: vec![vec!["1000".into(), "1".into()], vec!["2".into()]],
            ..Table::default()
        };
        let text = text(&[table]);
        assert!(text.lines().all(|line| line.chars().count() <= WIDTH), "{text}");
        assert!(text.contains("  N     time [s]\n  1000         1\n"), "{text}");
    }
}
