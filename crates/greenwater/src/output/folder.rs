//! A folder on disk: made once, never written over by accident.

use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use thiserror::Error;

/// What a run writes beside its frames, but for what tells that it is a run; how it ended comes first.
const WRITTEN: [&str; 15] = [
    "DONE",
    "FAILED.json",
    "summary.json",
    "status.json",
    "energy.csv",
    "front.csv",
    "probes.csv",
    "gauges.csv",
    "loads.csv",
    "quality.csv",
    "steps.csv",
    "log.txt",
    "events.jsonl",
    "case.toml",
    "case.resolved.toml",
];

/// What happens to a run that is already there.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Existing {
    /// It stays, and is an error.
    Keep,
    /// It is removed, if it is a run of this program; anything else is an error. Files that a run does not write stay.
    Replace,
}

/// Why a run folder could not be written.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum OutputError {
    /// Something is there already.
    #[error("`{}` exists already; choose another folder with --out, or replace it with --force", path.display())]
    Exists {
        /// The folder.
        path: PathBuf,
    },
    /// Something is there, and nothing can replace it.
    #[error("`{}` exists already; choose another name", path.display())]
    InTheWay {
        /// The folder.
        path: PathBuf,
    },
    /// Something is there that is not a run, and would have been replaced.
    #[error("`{}` is not a run folder of greenwater, so --force leaves it alone; choose another folder with --out", path.display())]
    NotARun {
        /// The folder.
        path: PathBuf,
    },
    /// The system refused.
    #[error("cannot {action} `{}`: {source}", path.display())]
    Io {
        /// `create`, `write` or `remove`.
        action: &'static str,
        /// The file or folder.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
}

impl OutputError {
    /// Exit code of a program that ends with this error: 2 for a folder that is in the way, 5 for what the system refused.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Exists { .. } | Self::InTheWay { .. } | Self::NotARun { .. } => 2,
            Self::Io { .. } => 5,
        }
    }
}

/// The folder of one run.
#[derive(Clone, Debug)]
pub struct RunFolder {
    path: PathBuf,
}

impl RunFolder {
    /// Makes the folder at `path`. An empty folder may be there already.
    ///
    /// # Errors
    /// Something is there (see [`Existing`]), or the system refuses.
    pub fn create(path: &Path, existing: Existing) -> Result<Self, OutputError> {
        Self::check(path, existing)?;
        let io = |action| move |source| OutputError::Io { action, path: path.to_owned(), source };
        if is_run(path) {
            remove_run(path).map_err(io("remove"))?;
        }
        fs::create_dir_all(path.join("frames")).map_err(io("create"))?;
        Ok(Self { path: path.to_owned() })
    }

    /// Whether [`create`](Self::create) would find `path` free; changes nothing.
    ///
    /// # Errors
    /// Something is there.
    pub fn check(path: &Path, existing: Existing) -> Result<(), OutputError> {
        let empty = fs::read_dir(path).is_ok_and(|mut entries| entries.next().is_none());
        match existing {
            _ if path.is_file() => Err(OutputError::InTheWay { path: path.to_owned() }),
            _ if !path.exists() || empty => Ok(()),
            Existing::Keep => Err(OutputError::Exists { path: path.to_owned() }),
            Existing::Replace if is_run(path) => Ok(()),
            Existing::Replace => Err(OutputError::NotARun { path: path.to_owned() }),
        }
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Writes `bytes` to `name` inside: under a temporary name first, then renamed.
    pub(super) fn write(&self, name: &str, bytes: &[u8]) -> io::Result<()> {
        let path = self.path.join(name);
        let temporary = path.with_extension("part");
        let mut file = fs::File::create(&temporary)?;
        file.write_all(bytes)?;
        drop(file);
        fs::rename(&temporary, &path)
    }

    /// `error` of the file `name`, with its path.
    pub(super) fn error(&self, name: &str, source: io::Error) -> OutputError {
        OutputError::Io { action: "write", path: self.path.join(name), source }
    }
}

/// Removes what a run writes. What tells that it is a run goes last, so that a removal that was cut short can be taken up again.
fn remove_run(path: &Path) -> io::Result<()> {
    let frames = path.join("frames");
    for entry in fs::read_dir(&frames).into_iter().flatten() {
        let name = entry?.file_name();
        let text = name.to_string_lossy();
        if text.starts_with("frame-") || text == "frames.pvd" || text.ends_with(".part") {
            fs::remove_file(frames.join(&name))?;
        }
    }
    for name in WRITTEN.iter().chain(&["provenance.json"]) {
        let file = path.join(name);
        for file in [file.with_extension("part"), file] {
            match fs::remove_file(file) {
                Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
                _ => {}
            }
        }
    }
    Ok(())
}

/// Whether `path` holds a run that this program wrote.
fn is_run(path: &Path) -> bool {
    let text = fs::read(path.join("provenance.json")).unwrap_or_default();
    serde_json::from_slice::<serde_json::Value>(&text).is_ok_and(|value| value["program"] == "greenwater")
}
