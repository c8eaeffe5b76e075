//! Tables that grow while a run goes on.

use std::fs::File;
use std::io::{self, BufWriter, Write};

use super::folder::RunFolder;

/// A cell of a table.
pub(super) enum Cell<'a> {
    /// A number, written so that reading gives the same bits; nothing if it is not finite.
    Number(f64),
    /// A whole number.
    Count(u64),
    /// A word without commas.
    Text(&'a str),
    /// Nothing.
    Empty,
}

/// A CSV file with one header line, `name [unit]` a column.
pub(super) struct Table {
    file: BufWriter<File>,
}

impl Table {
    /// Starts the table `name` in a run folder.
    pub fn create(folder: &RunFolder, name: &str, header: &str) -> io::Result<Self> {
        let mut file = BufWriter::new(File::create(folder.path().join(name))?);
        writeln!(file, "{header}")?;
        Ok(Self { file })
    }

    /// Adds a row.
    pub fn row(&mut self, cells: &[Cell]) -> io::Result<()> {
        for (i, cell) in cells.iter().enumerate() {
            if i > 0 {
                self.file.write_all(b",")?;
            }
            match cell {
                Cell::Number(value) if value.is_finite() => write!(self.file, "{value}")?,
                Cell::Number(_) | Cell::Empty => {}
                Cell::Count(value) => write!(self.file, "{value}")?,
                Cell::Text(text) => self.file.write_all(text.as_bytes())?,
            }
        }
        self.file.write_all(b"\n")
    }

    /// Adds a row of numbers.
    pub fn numbers(&mut self, values: impl IntoIterator<Item = f64>) -> io::Result<()> {
        let cells: Vec<Cell> = values.into_iter().map(Cell::Number).collect();
        self.row(&cells)
    }

    /// Puts everything on disk.
    pub fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}
