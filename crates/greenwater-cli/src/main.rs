//! The `greenwater` command.
fn main() {}
