//! What can be wrong with a case.

use std::fmt;
use std::path::PathBuf;

use thiserror::Error;

/// Where in a case something is wrong.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Place {
    /// A line of a file.
    Line {
        /// The file, as the user named it.
        file: String,
        /// Counted from 1.
        line: usize,
    },
    /// A file as a whole.
    File(String),
    /// A `key=value` of the command line.
    Override(String),
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Line { file, line } => write!(f, "{file}:{line}"),
            Self::File(file) => write!(f, "{file}"),
            Self::Override(text) => write!(f, "--set {text}"),
        }
    }
}

/// Why a case cannot run. Nothing has been written when one of these is returned.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum CaseError {
    /// Neither a file nor a shipped case.
    #[error("{given}: no such file, and no shipped case of this name{}; shipped cases: {}", choices.hint(), choices.known.join(", "))]
    NotFound {
        /// What was asked for.
        given: String,
        /// The shipped cases.
        choices: Box<Choices>,
    },
    /// A file exists but cannot be read.
    #[error("{}: cannot be read: {source}", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// Not TOML.
    #[error("{place}: not valid TOML: {problem}")]
    Syntax {
        /// Where reading stopped.
        place: Place,
        /// What was found or expected.
        problem: String,
    },
    /// A key that no section has.
    #[error("{place}: unknown key `{key}`{}; known here: {}", choices.hint(), choices.known.join(", "))]
    UnknownKey {
        /// Where it stands.
        place: Place,
        /// The whole path of the key.
        key: String,
        /// The keys that may stand there.
        choices: Box<Choices>,
    },
    /// A name that is none of the choices of a key.
    #[error("{place}: `{key}` is \"{value}\", which is unknown{}; choose one of: {}", choices.hint(), choices.known.join(", "))]
    UnknownChoice {
        /// Where it stands.
        place: Place,
        /// The key.
        key: String,
        /// What was written.
        value: String,
        /// What may stand there.
        choices: Box<Choices>,
    },
    /// A required key is not there.
    #[error("{place}: `{key}` is missing{}", note(meaning))]
    Missing {
        /// Its section, or the file.
        place: Place,
        /// The key.
        key: String,
        /// What the key says; empty if unknown.
        meaning: String,
    },
    /// A value of another type than the key has.
    #[error("{place}: `{key}` has a value of the wrong type: {problem}")]
    WrongType {
        /// Where it stands.
        place: Place,
        /// The key.
        key: String,
        /// What was found and what is expected.
        problem: String,
    },
    /// A value that breaks the rule of its key.
    #[error("{place}: `{key}` is {value}, but must be {rule}")]
    Rule {
        /// Where it stands.
        place: Place,
        /// The key.
        key: String,
        /// What was written.
        value: String,
        /// What is allowed.
        rule: String,
    },
    /// A side of a box or tank that the spacing does not divide.
    #[error(
        "{place}: `{key}` is {extent} m long along {axis}, which is {spacings:.6} spacings of {spacing} m, but must be a whole number \
         of them; the nearest `fluid.spacing` that fits is {nearest} m"
    )]
    NotWholeSpacings {
        /// Where the shape stands.
        place: Place,
        /// The shape.
        key: String,
        /// Length of the side, m.
        extent: f64,
        /// Name of the axis.
        axis: char,
        /// `extent / spacing`.
        spacings: f64,
        /// Spacing of the case, m.
        spacing: f64,
        /// A spacing that divides every side of the case or, if there is none near, this side, m.
        nearest: f64,
    },
    /// Two shapes give particles in one place.
    #[error(
        "{place}: `{first}` and `{second}` overlap near {position:?} m: two particles are {distance:.3e} m apart there, but must be at \
         least half a spacing, {least:.3e} m; move or shrink one of the two"
    )]
    Overlap {
        /// Where the second shape stands.
        place: Place,
        /// One shape.
        first: String,
        /// The other shape.
        second: String,
        /// Position of one of the two particles, m.
        position: Vec<f64>,
        /// Distance of the two particles, m.
        distance: f64,
        /// Smallest distance allowed, m.
        least: f64,
    },
    /// A file named in a case lies outside its folder.
    #[error(
        "{place}: `{key}` is \"{path}\", which is outside the folder of the case; copy the file beside the case and name it without folders"
    )]
    OutsideFolder {
        /// Where it stands.
        place: Place,
        /// The key.
        key: String,
        /// What was written.
        path: String,
    },
    /// A table of particles without the right columns or rows.
    #[error("{file}:{row}: {problem}")]
    ParticleTable {
        /// The table.
        file: String,
        /// Line in the table, counted from 1.
        row: usize,
        /// What is wrong, and the rule.
        problem: String,
    },
    /// A value in a table of particles.
    #[error("{file}:{row}: column `{column}` is {value}, but must be {rule}")]
    ParticleValue {
        /// The table.
        file: String,
        /// Line in the table, counted from 1.
        row: usize,
        /// Name of the column.
        column: String,
        /// What was written.
        value: String,
        /// What is allowed.
        rule: String,
    },
    /// The case is too large for what it may use.
    #[error(
        "{place}: the case needs about {} {unit} ({} particles), but `{key}` allows {} {unit}; \
         choose a larger `fluid.spacing` or raise `{key}`",
        plain(*needed), plain(*particles), plain(*limit)
    )]
    OverLimit {
        /// The case.
        place: Place,
        /// The limit.
        key: &'static str,
        /// What the case needs, in `unit`.
        needed: f64,
        /// What it may use, in `unit`.
        limit: f64,
        /// Unit of both.
        unit: &'static str,
        /// Predicted number of particles.
        particles: f64,
    },
    /// A `--set` that cannot be applied.
    #[error("--set {text}: {problem}; write --set section.key=value, for example --set fluid.spacing=0.02")]
    Override {
        /// What was written.
        text: String,
        /// Why not.
        problem: String,
    },
}

impl CaseError {
    /// Exit code of a program that ends with this error: 7 over a resource limit, 5 for a file that exists but cannot be
    /// read, otherwise 2.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::OverLimit { .. } => 7,
            Self::Unreadable { source, .. } if source.kind() != std::io::ErrorKind::NotFound => 5,
            _ => 2,
        }
    }
}

fn note(meaning: &str) -> String {
    if meaning.is_empty() { String::new() } else { format!(": {meaning}") }
}

/// The names that may stand somewhere, and the one that was probably meant.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Choices {
    /// The name nearest to what was written, if any is near enough.
    pub nearest: Option<String>,
    /// All names.
    pub known: Vec<String>,
}

impl Choices {
    /// The choices `known` for someone who wrote `given`. Of names equally near the first is taken.
    pub(super) fn new<'a>(given: &str, known: impl IntoIterator<Item = &'a str>) -> Box<Self> {
        let known: Vec<String> = known.into_iter().map(String::from).collect();
        let likeness = |name: &String| strsim::jaro_winkler(given, name);
        let nearer = |best: Option<(f64, usize)>, (i, likeness): (usize, f64)| match best {
            Some((most, _)) if most >= likeness => best,
            _ => Some((likeness, i)),
        };
        let nearest = known.iter().map(likeness).enumerate().fold(None, nearer);
        let nearest = nearest.filter(|(likeness, _)| *likeness > 0.75).map(|(_, i)| known[i].clone());
        Box::new(Self { nearest, known })
    }

    /// `, did you mean ...?`, or nothing.
    pub(super) fn hint(&self) -> String {
        self.nearest.as_ref().map(|name| format!(", did you mean `{name}`?")).unwrap_or_default()
    }
}

/// `value` as a person writes it: three or more digits, powers of ten from a million on.
fn plain(value: f64) -> String {
    match value.abs() {
        size if size >= 1e6 => format!("{value:.3e}"),
        size if size >= 100.0 || value.fract() == 0.0 => format!("{value:.0}"),
        _ => format!("{value:.3}"),
    }
}
