//! Frames as tables of particles, which a case can start from.

use std::fmt::Write;
use std::path::Path;

use crate::error::ReportError;
use crate::run::{FrameError, read_columns};

/// A frame as a CSV table.
#[derive(Clone, Debug)]
pub struct ParticleTable {
    /// One header line, a row a particle, 17 significant digits: reading gives the same bits as the frame.
    pub text: String,
    /// Particles that had left the domain, and are left out.
    pub lost: usize,
}

/// Columns with a name of their own in the table, after `id` and `kind`.
const NAMED: [&str; 8] = ["id", "kind", "velocity", "density", "pressure", "mass", "smoothing_length", "layer"];

/// The frame at `path` as the table `id,kind,x,y[,z],vx,vy[,vz],density,pressure,mass,h`, with `layer` where walls have more than
/// one line of particles. `all_fields` adds every other column of the frame under its own name, vectors as `name_x`, `name_y`.
///
/// # Errors
/// The frame cannot be read, or lacks a column that the table needs.
pub fn particle_table(path: &Path, dimension: usize, all_fields: bool) -> Result<ParticleTable, ReportError> {
    let frame = read_columns(path).map_err(|error| match error {
        FrameError::Io { path, source } => ReportError::Io { action: "read", path, source },
        FrameError::Malformed { path, reason } => ReportError::Malformed { path, reason },
    })?;
    let column = |name: &str| {
        frame.columns.iter().find(|column| column.name == name).ok_or_else(|| ReportError::Malformed {
            path: path.to_owned(),
            reason: format!("the frame has no `{name}`, which a table of particles needs; add it to `output.fields`"),
        })
    };
    let (id, kind, velocity) = (column("id")?, column("kind")?, column("velocity")?);
    let state = [column("density")?, column("pressure")?, column("mass")?, column("smoothing_length")?];
    let layer = frame.columns.iter().find(|column| column.name == "layer");
    let layer = layer.filter(|layer| all_fields || layer.values.iter().any(|&line| line > 1.0));
    let others: Vec<_> = frame.columns.iter().filter(|column| all_fields && !NAMED.contains(&column.name.as_str())).collect();

    let axes = &["x", "y", "z"][..dimension.clamp(2, 3)];
    let mut text = format!("id,kind,{},v{},density,pressure,mass,h", axes.join(","), axes.join(",v"));
    text.push_str(if layer.is_some() { ",layer" } else { "" });
    for column in &others {
        match column.components {
            1 => text.push_str(&format!(",{}", column.name)),
            _ => axes.iter().for_each(|axis| text.push_str(&format!(",{}_{axis}", column.name))),
        }
    }
    text.push('\n');
    let mut lost = 0;
    for a in 0..frame.points.len() {
        let kind = match kind.values[a] as u8 {
            0 => "fluid",
            1 => "wall",
            _ => {
                lost += 1;
                continue;
            }
        };
        let _ = write!(text, "{},{kind}", id.values[a]);
        let mut push = |value: f64| {
            let _ = write!(text, ",{value:.16e}");
        };
        (0..axes.len()).for_each(|d| push(frame.points[a][d]));
        (0..axes.len()).for_each(|d| push(velocity.values[3 * a + d]));
        state.iter().for_each(|column| push(column.values[a]));
        if let Some(layer) = layer {
            let _ = write!(text, ",{}", layer.values[a]);
        }
        for column in &others {
            let shown = if column.components == 1 { 1 } else { axes.len() };
            for d in 0..shown {
                let value = column.values[column.components * a + d];
                let _ = if column.whole { write!(text, ",{value}") } else { write!(text, ",{value:.16e}") };
            }
        }
        text.push('\n');
    }
    Ok(ParticleTable { text, lost })
}
