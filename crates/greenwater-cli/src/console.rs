//! Printing: results to standard output, everything else to standard error. Neither panics when nobody reads.

use std::io::{self, Write};

use serde_json::Value;

use crate::error::CliError;

/// Prints a result.
pub fn print(text: &str) -> Result<(), CliError> {
    let mut out = io::stdout().lock();
    writeln!(out, "{text}")?;
    Ok(out.flush()?)
}

/// Prints a result for scripts.
pub fn print_json(value: &Value) -> Result<(), CliError> {
    print(&format!("{value:#}"))
}

/// Says something on the side.
pub fn note(text: &str) {
    // Nobody is there to be told that nobody listens.
    let _ = writeln!(io::stderr().lock(), "{text}");
}

/// Seconds as a person would say them.
pub fn duration(seconds: f64) -> String {
    match seconds {
        s if s < 0.0095 => format!("{:.1} ms", 1e3 * s),
        s if s < 9.95 => format!("{s:.2} s"),
        s if s < 120.0 => format!("{s:.0} s"),
        s if s < 7200.0 => format!("{:.0} min", s / 60.0),
        s if s < 172_800.0 => format!("{:.1} h", s / 3600.0),
        s => format!("{:.1} days", s / 86_400.0),
    }
}

/// Bytes as a person would say them.
pub fn bytes(count: f64) -> String {
    const UNITS: [&str; 5] = ["B", "KiB", "MiB", "GiB", "TiB"];
    let step = (count.max(1.0).log2() / 10.0).floor().min(4.0);
    let digits = usize::from(step > 0.0);
    format!("{:.digits$} {}", count / 1024f64.powf(step), UNITS[step as usize])
}
