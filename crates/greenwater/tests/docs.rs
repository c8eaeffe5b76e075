//! The pages of the docs that are made from the code are those that the code makes.

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
         run `cargo run --example reference > docs/src/reference/case.md` in crates/greenwater"
    );
}
