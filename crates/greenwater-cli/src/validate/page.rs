//! The page of the docs: every case with its references, bands and measured values.

use std::fmt::Write;

use super::record::{Results, Row, number};
use super::suite::CASES;

/// The page, Markdown.
pub fn page(results: &Results) -> String {
    let banded: Vec<&Row> = results.rows.iter().filter(|row| !row.verdict().is_empty()).collect();
    let passed = banded.iter().filter(|row| row.pass).count();
    let mut page = format!(
        "# Validation\n\n\
         <!-- Made by `greenwater validate --docs docs/src/validation.md`. Edit validation/*/README.md and bands.toml, not this page. -->\n\n\
         `greenwater validate` runs these cases and compares each quantity with a reference; `greenwater validate NAME --method METHOD`\n\
         runs one. A value outside its band is a miss and is shown with its number: bands are never widened to fit. Of {} values with a\n\
         band, {passed} lie inside. Values without a band are shown for what they are.\n\n",
        banded.len()
    );
    let mut methods: Vec<&str> = Vec::new();
    for row in &results.rows {
        if row.method != "all" && !methods.contains(&row.method.as_str()) {
            methods.push(&row.method);
        }
    }
    let _ = writeln!(page, "| case | {} |\n|---|{}", methods.join(" | "), "---|".repeat(methods.len()));
    for case in CASES {
        let cells: Vec<String> = methods
            .iter()
            .map(|method| {
                let rows = || banded.iter().filter(|row| row.case == case.name && row.method == *method);
                let (inside, all) = (rows().filter(|row| row.pass).count(), rows().count());
                if all == 0 { "not run".to_owned() } else { format!("{inside} of {all}") }
            })
            .collect();
        let _ = writeln!(page, "| [{0}](#{0}) | {1} |", case.name, cells.join(" | "));
    }
    for case in CASES {
        let rows: Vec<&Row> = results.rows.iter().filter(|row| row.case == case.name).collect();
        let text = case.readme.split_once('\n').map_or(case.readme, |(_, rest)| rest).trim();
        let _ = write!(page, "\n## {}\n\n{text}\n", case.name);
        if rows.is_empty() {
            page.push_str("\nNot run yet.\n");
            continue;
        }
        let mut quantities: Vec<&str> = Vec::new();
        for row in &rows {
            if !quantities.contains(&row.quantity.as_str()) {
                quantities.push(&row.quantity);
            }
        }
        let own: Vec<&str> = methods.iter().copied().filter(|method| rows.iter().any(|row| row.method == *method)).collect();
        let _ =
            writeln!(page, "\n| quantity | unit | reference | band | {} |\n|---|---|---|---|{}", own.join(" | "), "---|".repeat(own.len()));
        for quantity in &quantities {
            let same: Vec<&&Row> = rows.iter().filter(|row| row.quantity == *quantity).collect();
            let cell = |method: &str| {
                let row = same.iter().find(|row| row.method == method || row.method == "all");
                row.map_or("–".to_owned(), |row| if row.pass { row.said() } else { format!("**{}** (miss)", row.said()) })
            };
            // A run that failed has no reference of its own; another method's row has the same.
            let first = same.iter().find(|row| row.low.is_some() || row.high.is_some() || row.reference.is_some()).unwrap_or(&same[0]);
            let cells: Vec<String> = own.iter().map(|method| cell(method)).collect();
            let reference = first.reference.map_or(String::new(), number);
            let _ = writeln!(page, "| {quantity} | {} | {reference} | {} | {} |", first.unit, first.band(), cells.join(" | "));
        }
        let mut sources: Vec<(&str, Vec<&str>)> = Vec::new();
        for row in &rows {
            match sources.iter_mut().find(|(source, _)| *source == row.source) {
                Some((_, quantities)) if quantities.contains(&row.quantity.as_str()) => {}
                Some((_, quantities)) => quantities.push(&row.quantity),
                None => sources.push((&row.source, vec![&row.quantity])),
            }
        }
        page.push_str("\nReferences and bands:\n\n");
        for (source, quantities) in sources {
            let _ = writeln!(page, "- {}: {source}.", quantities.join(", "));
        }
        let mut problems: Vec<String> =
            rows.iter().filter_map(|row| Some(format!("`{}`, run {}: {}", row.method, row.run, row.problem.as_ref()?))).collect();
        problems.dedup();
        for problem in problems {
            let _ = writeln!(page, "- Not measured: {problem}.");
        }
    }
    page.push_str(CODE);
    page
}

/// What tests hold beside the cases.
const CODE: &str = include_str!("page-tests.md");

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn misses_stand_out_and_sources_are_named() {
        let row = |method: &str, value: f64, pass: bool| Row {
            case: "couette".into(),
            method: method.into(),
            run: "50".into(),
            quantity: "error".into(),
            unit: "1".into(),
            value: Some(value),
            reference: Some(0.0),
            low: None,
            high: Some(0.005),
            pass,
            source: "theory".into(),
            seconds: Some(1.0),
            problem: None,
        };
        let page = page(&Results { rows: vec![row("a", 0.002, true), row("b", 0.02, false)] });
        assert!(page.contains("| error | 1 | 0 | <= 0.005 | 0.002 | **0.02** (miss) |"), "{page}");
        assert!(page.contains("| [couette](#couette) | 1 of 1 | 0 of 1 |") && page.contains("- error: theory."));
    }
}
