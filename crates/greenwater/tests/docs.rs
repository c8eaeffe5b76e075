//! The pages of the docs that are made from the code are those that the code makes.

use std::fs;
use std::path::{Path, PathBuf};

#[path = "../examples/reference.rs"]
mod reference;

const COMMITTED: &str = include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/src/reference/case.md"));

#[test]
fn the_reference_of_the_case_format_is_what_the_code_says() {
    let made = reference::page();
    let first = made.lines().zip(COMMITTED.lines()).find(|(made, committed)| made != committed);
    assert!(
        made == COMMITTED,
        "docs/src/reference/case.md is out of date (first difference: {first:?}); \
         run `cargo run -p greenwater --example reference > docs/src/reference/case.md`"
    );
}

/// The pages: those of the book, and the Markdown files at the root.
fn pages() -> Vec<PathBuf> {
    fn add(folder: &Path, deep: bool, pages: &mut Vec<PathBuf>) {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() && deep {
                add(&path, deep, pages);
            } else if path.extension().is_some_and(|end| end == "md") {
                pages.push(path);
            }
        }
    }
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let mut pages = Vec::new();
    add(&root, false, &mut pages);
    add(&root.join("docs/src"), true, &mut pages);
    pages.sort();
    pages
}

/// Targets of the links `[text](target)` of a page.
fn links(text: &str) -> impl Iterator<Item = &str> {
    text.split("](").skip(1).filter_map(|rest| rest.split(')').next())
}

/// The name by which a heading is linked: letters, digits and dashes of it, in lower case.
fn anchor(heading: &str) -> String {
    let plain = heading.trim_start_matches('#').trim().to_lowercase();
    plain.chars().filter(|c| c.is_alphanumeric() || "- _".contains(*c)).map(|c| if c == ' ' { '-' } else { c }).collect()
}

#[test]
fn every_link_between_pages_leads_somewhere() {
    let mut seen = 0;
    for page in pages() {
        let text = fs::read_to_string(&page).unwrap();
        for link in links(&text).filter(|link| !link.contains("://")) {
            let (file, heading) = link.split_once('#').unwrap_or((link, ""));
            let target = if file.is_empty() { page.clone() } else { page.parent().unwrap().join(file) };
            assert!(target.exists(), "{}: `{link}` does not exist", page.display());
            let headings = |text: &str| text.lines().any(|line| line.starts_with('#') && anchor(line) == heading);
            assert!(
                heading.is_empty() || headings(&fs::read_to_string(&target).unwrap()),
                "{}: `{link}` names no heading of its page",
                page.display()
            );
            seen += 1;
        }
    }
    assert!(seen > 20, "only {seen} links found: the search is broken");
}

#[test]
fn every_page_of_the_book_stands_in_its_summary() {
    let summary = include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/src/SUMMARY.md"));
    for page in pages() {
        let Some((_, name)) = page.to_str().and_then(|path| path.split_once("docs/src/")) else { continue };
        assert!(name == "SUMMARY.md" || links(summary).any(|link| link == name), "{name} is missing in docs/src/SUMMARY.md");
    }
}
