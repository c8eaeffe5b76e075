//! Writes synthetic run folders: a column that spreads like a dam break, with known numbers.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use flate2::Compression;
use flate2::write::ZlibEncoder;
use serde_json::json;

/// Width and height of the column, m, and of the tank (4 L).
const WIDTH: f64 = 0.75;
const HEIGHT: f64 = 1.5;
const TANK: f64 = 3.0;
/// `ρ g H` of the synthetic case, Pa.
pub const PRESSURE: f64 = 1000.0 * 9.81 * HEIGHT;

/// What a synthetic run looks like.
#[derive(Clone)]
pub struct Synthetic {
    pub method: &'static str,
    pub preset: &'static str,
    /// Particles over the width of the column.
    pub columns: usize,
    /// Noise of the pressure, fraction of `ρ g H`.
    pub noise: f64,
    /// Time at which `x / L = 2` is passed, as a fraction of the reference's.
    pub pace: f64,
    pub end: f64,
    pub frames: usize,
    pub dimension: usize,
    pub failed: bool,
}

impl Synthetic {
    pub fn new(method: &'static str) -> Self {
        Self { method, preset: "water", columns: 12, noise: 0.05, pace: 0.9, end: 1.64, frames: 9, dimension: 2, failed: false }
    }

    /// Front position at a time, m: `x = L (1 + (T / pace)² / 4)`, `T = t √(2g/L)`, so that the reference
    /// (pace 1) passes `Z = 2` at `T = 2`.
    pub fn front(&self, time: f64) -> f64 {
        let t = time * time_scale() / self.pace;
        (WIDTH * (1.0 + 0.25 * t * t)).min(TANK)
    }

    /// Writes the run folder.
    pub fn write(&self, dir: &Path) -> PathBuf {
        fs::create_dir_all(dir.join("frames")).unwrap();
        let put = |name: &str, text: String| fs::write(dir.join(name), text).unwrap();
        put("case.toml", "format = 1\n".into());
        put("case.resolved.toml", "format = 1\n".into());
        put("provenance.json", self.provenance().to_string());
        put("summary.json", self.summary().to_string());
        let samples: Vec<f64> = (0..=400).map(|i| self.end * f64::from(i) / 400.0).collect();
        let table = |head: &str, row: &dyn Fn(f64) -> Vec<f64>| {
            let mut text = format!("{head}\n");
            for &t in &samples {
                let cells: Vec<String> = std::iter::once(t).chain(row(t)).map(|v| v.to_string()).collect();
                text.push_str(&(cells.join(",") + "\n"));
            }
            text
        };
        put(
            "energy.csv",
            table("time [s],kinetic [J/m],potential [J/m],elastic [J/m],total [J/m]", &|t| {
                let part = (t / self.end).min(1.0);
                let (kinetic, potential, elastic) = (4000.0 * part * (1.2 - part), 8000.0 * (1.0 - 0.7 * part), 10.0 * part);
                vec![kinetic, potential, elastic, kinetic + potential + elastic]
            }),
        );
        put("front.csv", table("time [s],front [m],residual_height [m]", &|t| vec![self.front(t), HEIGHT * WIDTH / self.front(t)]));
        put(
            "probes.csv",
            table("time [s],P1 [Pa],P2 [Pa]", &|t| {
                let hit = |at: f64| PRESSURE * 1.2 * (-(t - at) * (t - at) / 0.004).exp();
                let speckle = self.noise * PRESSURE * (977.0 * t).sin();
                vec![if t > 0.6 { hit(0.75) + speckle } else { 0.0 }, if t > 0.65 { 0.5 * hit(0.85) + speckle } else { 0.0 }]
            }),
        );
        put(
            "quality.csv",
            table(
                "time [s],pressure_noise [1],density_p01 [1],density_p99 [1],density_mean [1],volume_error [1],lost_particles [1]",
                &|t| vec![self.noise * (1.0 + 0.3 * (9.0 * t).sin()), 1.0 - 0.2 * self.noise, 1.0 + 0.1 * self.noise, 1.0, -0.01 * t, 0.0],
            ),
        );
        let mut steps = String::from("step,time [s],dt [s],limit,iterations,residual [1],maximum_speed [m/s],wall_clock [s]\n");
        for i in 0..400 {
            let limit = if i % 3 == 0 { "acoustic" } else { "force" };
            steps.push_str(&format!("{},{},{},{limit},{},1e-9,4.1,{}\n", 10 * i, samples[i], 4e-4, 12 + i % 7, 0.01 * i as f64));
        }
        put("steps.csv", steps);
        let mut index = String::from("<?xml version=\"1.0\"?>\n<VTKFile type=\"Collection\" version=\"0.1\"><Collection>\n");
        for i in 0..self.frames {
            let time = self.end * i as f64 / (self.frames.max(2) - 1) as f64;
            let (points, pressure, kind) = self.particles(time);
            put(&format!("frames/frame-{i:06}.vtp"), vtp(&points, &pressure, &kind, 700));
            index.push_str(&format!("<DataSet timestep=\"{time}\" group=\"\" part=\"0\" file=\"frame-{i:06}.vtp\"/>\n"));
        }
        put("frames/frames.pvd", index + "</Collection></VTKFile>\n");
        if self.failed {
            put(
                "FAILED.json",
                json!({"format": 1, "error": "velocity of particle 17 is not finite", "exit_code": 4,
                "field": "velocity", "particle": 17, "time": self.end, "step": 400})
                .to_string(),
            );
        } else {
            put("DONE", String::new());
        }
        dir.to_owned()
    }

    fn provenance(&self) -> serde_json::Value {
        let (low, high) = if self.dimension == 2 { (vec![0.0, 0.0], vec![TANK, TANK]) } else { (vec![0.0; 3], vec![TANK, 0.5, TANK]) };
        json!({
            "format": 1, "program": "greenwater", "version": "0.1.0",
            "command": ["greenwater", "compare", "dam-break", "--methods", "wcsph,isph-paper"],
            "case": "dam-break", "title": "Dam break, column 0.75 m x 1.5 m in a 3 m tank", "method": self.method,
            "method_title": if self.method == "wcsph" { "Weakly compressible SPH (the paper)" } else { "Incompressible SPH (the paper)" },
            "preset": self.preset, "dimension": self.dimension, "started": "2026-11-22T01:00:00Z",
            "machine": {"os": "linux", "arch": "x86_64", "cpu": "Example CPU", "cores": 2}, "threads": 2,
            "kernel": {"name": "cubic-spline", "smoothing_length_m": 0.045, "h_over_spacing": 1.2},
            "particles": self.counts(), "time_step_rule": "least of the acoustic, force and viscous limits",
            "departures": if self.method == "wcsph" { vec![] } else { vec!["<shifting> of particles after each step & nothing else"] },
            "distinctions": [
                {"aspect": "pressure", "value": if self.method == "wcsph" { "equation of state (25)" } else { "Poisson equation (30)" }},
                {"aspect": "walls", "value": if self.method == "wcsph" { "Lennard-Jones force (33)" } else { "three rows of wall particles" }},
            ],
            "scales": {"rest_density": 1000.0, "gravity": 9.81, "height": HEIGHT, "width": WIDTH, "spacing": self.spacing(),
                "fluid_volume": WIDTH * HEIGHT, "box": {"min": low, "max": high}},
            "compare": {"times": [0.0, 0.21, 0.65, 1.31, 1.5, 1.64], "references": [
                {"name": "Made-up experiment", "quantity": "front", "source": "synthetic, Z = 1 + T²/4", "time_scale": time_scale(),
                 "value_scale": 1.0 / WIDTH, "time_label": "t sqrt(2g/L)", "value_label": "x/L",
                 "points": (0..=16).map(|i| { let t = 0.2 * f64::from(i); [t, 1.0 + 0.25 * t * t] }).collect::<Vec<_>>(),
                 "spread": vec![0.1; 17]},
            ]},
            "probes": [{"name": "P1", "position": [TANK, 0.05]}, {"name": "P2", "position": [TANK, 0.4]}],
        })
    }

    fn counts(&self) -> serde_json::Value {
        let (_, _, kind) = self.particles(0.0);
        let wall = kind.iter().filter(|k| **k == 1).count();
        json!({"fluid": kind.len() - wall, "wall": wall})
    }

    fn summary(&self) -> serde_json::Value {
        let isph = self.method != "wcsph";
        json!({
            "format": 1, "method": self.method, "preset": self.preset, "completed": !self.failed,
            "steps": if isph { 400 } else { 4000 }, "end_time": self.end, "wall_seconds": if isph { 9.0 } else { 20.0 }, "threads": 2,
            "dt": {"min": 1e-4, "median": 4e-4, "max": 5e-4},
            "phases": if isph { json!({"neighbours": 1.0, "pressure solve": 6.5, "gradient": 0.8}) }
                      else { json!({"neighbours": 4.0, "forces": 11.0, "density": 4.2}) },
            "iterations": isph.then(|| json!({"min": 8, "median": 14, "max": 31})),
            "particles": self.counts(), "lost_particles": 0, "pressure_noise": self.noise,
            "density_percentiles": {"p01": 1.0 - 0.2 * self.noise, "p99": 1.0 + 0.1 * self.noise}, "volume_error": -0.0164,
            "energy": {"initial": 8000.0, "final": 5610.0, "max_rise": 0.02},
        })
    }

    fn spacing(&self) -> f64 {
        WIDTH / self.columns as f64
    }

    fn particles(&self, time: f64) -> (Vec<[f64; 3]>, Vec<f64>, Vec<u8>) {
        let (dx, stretch) = (self.spacing(), self.front(time) / WIDTH);
        let layers = if self.dimension == 3 { 6 } else { 1 };
        let (mut points, mut pressure, mut kind) = (Vec::new(), Vec::new(), Vec::new());
        let place = |x: f64, up: f64, k: usize| if self.dimension == 3 { [x, 0.05 + dx * k as f64, up] } else { [x, up, 0.0] };
        for k in 0..layers {
            for j in 0..2 * self.columns {
                for i in 0..self.columns {
                    let wobble = 0.1 * dx * ((i * 7 + j * 13 + k) as f64).sin();
                    let (x, y) = ((i as f64 + 0.5) * dx, (j as f64 + 0.5) * dx);
                    points.push(place(x * stretch + wobble, y / stretch, k));
                    let speckle = self.noise * PRESSURE * ((i * 31 + j * 57) as f64).sin();
                    pressure.push((1000.0 * 9.81 * (HEIGHT - y) / stretch + speckle).max(0.0));
                    kind.push(0);
                }
            }
            let count = (TANK / dx).round() as usize;
            for i in 0..=count {
                for [x, y] in [[i as f64 * dx, -0.5 * dx], [-0.5 * dx, i as f64 * dx], [TANK + 0.5 * dx, i as f64 * dx]] {
                    points.push(place(x, y, k));
                    pressure.push(0.0);
                    kind.push(1);
                }
            }
        }
        (points, pressure, kind)
    }
}

/// `√(2g/L)`, 1/s.
fn time_scale() -> f64 {
    (2.0 * 9.81 / WIDTH).sqrt()
}

/// A VTK XML PolyData file as the run folder holds it: inline base64, zlib blocks of `block` bytes.
pub fn vtp(points: &[[f64; 3]], pressure: &[f64], kind: &[u8], block: usize) -> String {
    let floats = |values: &mut dyn Iterator<Item = f64>| values.flat_map(f64::to_le_bytes).collect::<Vec<u8>>();
    let positions = compressed(&floats(&mut points.iter().flatten().copied()), block);
    let pressures = compressed(&pressure.iter().flat_map(|p| (*p as f32).to_le_bytes()).collect::<Vec<u8>>(), block);
    let kinds = compressed(kind, block);
    format!(
        r#"<?xml version="1.0"?>
<VTKFile type="PolyData" version="1.0" byte_order="LittleEndian" header_type="UInt64" compressor="vtkZLibDataCompressor">
<PolyData><Piece NumberOfPoints="{}" NumberOfVerts="0">
<PointData>
<DataArray type="Float32" Name="pressure" format="binary">
{pressures}
</DataArray>
<DataArray type="UInt8" Name="kind" format="binary">{kinds}</DataArray>
</PointData>
<Points><DataArray type="Float64" Name="Points" NumberOfComponents="3" format="binary">{positions}</DataArray></Points>
</Piece></PolyData></VTKFile>
"#,
        points.len()
    )
}

fn compressed(bytes: &[u8], block: usize) -> String {
    let blocks: Vec<Vec<u8>> = bytes
        .chunks(block)
        .map(|chunk| {
            let mut encoder = ZlibEncoder::new(Vec::new(), Compression::fast());
            encoder.write_all(chunk).unwrap();
            encoder.finish().unwrap()
        })
        .collect();
    let mut header = vec![blocks.len() as u64, block as u64, (bytes.len() % block) as u64];
    header.extend(blocks.iter().map(|b| b.len() as u64));
    let header: Vec<u8> = header.into_iter().flat_map(u64::to_le_bytes).collect();
    STANDARD.encode(header) + &STANDARD.encode(blocks.concat())
}

/// A fresh folder for a test under the target directory.
pub fn scratch(name: &str) -> PathBuf {
    let dir = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(name);
    let _ = fs::remove_dir_all(&dir);
    fs::create_dir_all(&dir).unwrap();
    dir
}
