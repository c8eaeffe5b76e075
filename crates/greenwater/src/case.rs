//! Cases: what a user writes in `case.toml`, checked once and turned into what runs.
//!
//! [`Case`] is what was written, [`Case::checked`] the only way to a [`Setup`], and code behind a [`Setup`] trusts it.
//! A case is data: it cannot run a command, reads at most one table of particles and that from its own folder, and declares
//! how much it may allocate.
//!
//! ```
//! use greenwater::case::{AnySetup, Case};
//!
//! let case = Case::load("dam-break", &[("time.end".into(), "0.5".into())])?;
//! let AnySetup::D2(setup) = case.checked()? else { unreachable!("the dam break is two-dimensional") };
//! assert_eq!((setup.estimate.fluid, setup.time.end), (1800, 0.5));
//! # Ok::<(), greenwater::case::CaseError>(())
//! ```

mod audit;
mod error;
mod instruments;
mod method;
mod packing;
mod particle_file;
mod reference;
mod sections;
mod setup;
mod shape;
mod shipped;
mod source;
mod wall_shape;

use std::io::Read;
use std::path::{Path, PathBuf};

use toml::Value;

pub use audit::Audit;
pub use error::{CaseError, Choices, Place};
pub use reference::{KeyRow, reference, schema};
pub use sections::{
    Arrangement, Compare, Domain, Fluid, Gauge, GaugeQuantity, Gravity, InitialPressure, Kernel, Limits, Load, Method, Output, Precision,
    Probe, Reference, Sections, Time, Walls,
};
pub use setup::{AnySetup, Bounds, ComparePlan, Estimate, OutputPlan, Setup};
pub use shape::Shape;
pub use shipped::{ShippedCase, shipped_cases};
pub use wall_shape::{WallShape, Written};

use crate::scheme::{MethodName, Preset};
use source::Source;

/// A case as written: the right keys with the right types, values not checked yet.
#[derive(Clone, Debug)]
pub struct Case {
    /// Short name: of the case's folder, or of its file.
    pub name: String,
    /// What it says.
    pub sections: Sections,
    source: Source,
}

/// Longest case file, bytes: a polygon of a hundred thousand points fits.
const LONGEST_CASE: u64 = 16 << 20;

impl Case {
    /// Reads the case at `given`: a file, a folder with a `case.toml`, or the name of a shipped case. `overrides` are
    /// `key`, `value` pairs applied to the text first (`fluid.spacing`, `0.02`); a value that is not TOML is taken as text.
    ///
    /// # Errors
    /// No such case, an unreadable file, text that is not TOML, unknown keys (with the nearest known one), wrong types,
    /// missing keys.
    pub fn load(given: &str, overrides: &[(String, String)]) -> Result<Self, CaseError> {
        let path = Path::new(given);
        let in_folder = path.join("case.toml");
        let file = if in_folder.is_file() { in_folder } else { path.to_owned() };
        if !file.is_file() {
            if let Some(shipped) = shipped_cases().iter().find(|shipped| shipped.name == given) {
                return Self::from_source(shipped.name, shipped.source(overrides));
            }
            if file.is_dir() {
                let source = std::io::Error::new(std::io::ErrorKind::NotFound, "the folder has no case.toml");
                return Err(CaseError::Unreadable { path: file, source });
            }
        }
        let text = read_text(&file, given)?;
        let folder = file.parent().map(|folder| if folder.as_os_str().is_empty() { Path::new(".") } else { folder });
        Self::parse(&file.display().to_string(), text, folder, overrides)
    }

    /// Reads the text of a case. `file` names it in messages and gives it its name; `folder` is where it may read a table of particles.
    ///
    /// # Errors
    /// As [`Case::load`], but for those of files.
    pub fn parse(file: &str, text: String, folder: Option<&Path>, overrides: &[(String, String)]) -> Result<Self, CaseError> {
        let path = Path::new(file);
        let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let parent = || folder.and_then(|folder| folder.canonicalize().ok()?.file_name().map(|name| name.to_string_lossy().into_owned()));
        let name = if stem == "case" { parent().unwrap_or(stem) } else { stem };
        let source = Source { file: file.to_owned(), text, folder: folder.map(PathBuf::from), overrides: overrides.to_vec() };
        Self::from_source(&name, source)
    }

    fn from_source(name: &str, source: Source) -> Result<Self, CaseError> {
        let table = source.table()?;
        match table.get("format") {
            // A later format may have other keys, so this comes before them.
            Some(Value::Integer(1)) | None => {}
            Some(other) => return Err(source.broken("format", other, "1, the only format that this version reads")),
        }
        let sections: Sections = source.read("", Value::Table(table))?;
        Ok(Self { name: name.to_owned(), sections, source })
    }

    /// The same case with another method. The keys of `[method]` stay if they are for this method; `preset` replaces the
    /// written one, which otherwise stays too with its method.
    pub fn for_method(&self, name: MethodName, preset: Option<Preset>) -> Self {
        let mut case = self.clone();
        let method = &mut case.sections.method;
        if method.name != name {
            *method = Method { name, ..Method::default() };
        }
        method.preset = preset.unwrap_or(method.preset);
        case
    }

    /// The same case with the method a user asks for on the command line: as [`for_method`](Self::for_method), but what overrides say
    /// of `[method]` is meant for this method.
    ///
    /// # Errors
    /// An override that cannot be read.
    pub fn with_method(&self, name: MethodName, preset: Option<Preset>) -> Result<Self, CaseError> {
        let mut case = self.for_method(name, preset);
        if self.sections.method.name != name {
            case.sections.method = self.source.overridden_method(name)?;
            case.sections.method.preset = preset.unwrap_or(case.sections.method.preset);
        }
        Ok(case)
    }

    /// Checks every value and makes the particles: the only place where a case is checked.
    ///
    /// # Errors
    /// A value against its rule, shapes that overlap, a bad table of particles, or more memory or particles than
    /// `[limits]` allows.
    pub fn checked(&self) -> Result<AnySetup, CaseError> {
        let sections = self.sections.clone();
        match sections.dimension {
            2 => Setup::checked(&self.name, sections, &self.source).map(AnySetup::D2),
            3 => Setup::checked(&self.name, sections, &self.source).map(AnySetup::D3),
            other => Err(self.source.broken("dimension", other, "2 or 3")),
        }
    }
}

/// The text of `file`, which the user called `given`.
fn read_text(file: &Path, given: &str) -> Result<String, CaseError> {
    let unreadable = |source| CaseError::Unreadable { path: file.to_owned(), source };
    let input = std::fs::File::open(file).map_err(|source| match source.kind() {
        std::io::ErrorKind::NotFound => {
            let choices = error::Choices::new(given, shipped_cases().iter().map(|case| case.name));
            CaseError::NotFound { given: given.to_owned(), choices }
        }
        _ => unreadable(source),
    })?;
    let mut bytes = Vec::new();
    input.take(LONGEST_CASE + 1).read_to_end(&mut bytes).map_err(unreadable)?;
    let problem = match String::from_utf8(bytes) {
        Ok(text) if text.len() as u64 <= LONGEST_CASE => return Ok(text),
        Ok(_) => format!("longer than {LONGEST_CASE} bytes; put particles into a table and name it in `fluid.from_file`"),
        Err(_) => "not UTF-8 text".to_owned(),
    };
    Err(CaseError::Syntax { place: Place::File(file.display().to_string()), problem })
}
