//! The run folder: everything a run leaves behind, so that it can be looked at, reported and repeated without the solver.
//!
//! [`record`] makes a run and writes its folder; [`Recorder`] is the observer behind it. Layout (all units SI, in the headers):
//!
//! - `case.toml` as written, `case.resolved.toml` with every default (and the table of particles that the case names, if any);
//! - `provenance.json`: program, command, machine, method and its departures from print, scales of the case;
//! - `frames/frames.pvd` and `frames/frame-*.vtp`: particles, for ParaView and everything that reads VTK files;
//! - `energy.csv`, `front.csv` at the sampling interval, `probes.csv`, `gauges.csv`, `loads.csv` at that of the instruments,
//!   `quality.csv` at each frame, `steps.csv`;
//! - `status.json` while it runs, `log.txt` and `events.jsonl`, `summary.json` at the end;
//! - `DONE`, or `FAILED.json` with what went wrong.
//!
//! Tables grow line by line and are flushed at each frame; every other file is written under a temporary name and renamed. Steps
//! are never cut short: a frame is written at the first step that reaches its time, and carries the time it has.

mod folder;
mod frames;
mod instruments;
mod provenance;
mod recorder;
mod tables;

pub use folder::{Existing, OutputError, RunFolder};
pub use recorder::{Finished, Recorder, Spread, Summary, record};
