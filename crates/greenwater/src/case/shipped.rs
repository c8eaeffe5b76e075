//! The cases that come with the program.

use std::path::PathBuf;

use super::source::Source;

/// A case that comes with the program.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ShippedCase {
    /// Its name on the command line, and of its folder in `cases/`.
    pub name: &'static str,
    /// Its `case.toml`.
    pub case: &'static str,
    /// Its `README.md`: what it is, where it comes from, what to expect.
    pub readme: &'static str,
}

macro_rules! shipped {
    ($($name:literal),* $(,)?) => {
        [$(ShippedCase {
            name: $name,
            case: include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/../../cases/", $name, "/case.toml")),
            readme: include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/../../cases/", $name, "/README.md")),
        }),*]
    };
}

static SHIPPED: [ShippedCase; 9] = shipped![
    "dam-break",
    "dam-break-20",
    "dam-break-25",
    "dam-break-30",
    "dam-break-35",
    "dam-break-40",
    "dam-break-square",
    "dam-break-printed",
    "dam-break-3d",
];

/// The cases that come with the program, the default of `compare` first.
pub fn shipped_cases() -> &'static [ShippedCase] {
    &SHIPPED
}

impl ShippedCase {
    /// Its title, from `case.toml`.
    pub fn title(&self) -> String {
        let table: toml::Table = toml::from_str(self.case).unwrap_or_default();
        table.get("title").and_then(toml::Value::as_str).unwrap_or(self.name).to_owned()
    }

    /// What it is in one line: the first line of text of its README.
    pub fn text(&self) -> &'static str {
        self.readme.lines().find(|line| !line.is_empty() && !line.starts_with('#')).unwrap_or_default()
    }

    pub(super) fn source(&self, overrides: &[(String, String)]) -> Source {
        Source {
            file: PathBuf::from("cases").join(self.name).join("case.toml").display().to_string(),
            text: self.case.to_owned(),
            folder: None,
            overrides: overrides.to_vec(),
        }
    }
}
