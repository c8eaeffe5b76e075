//! The machine a program runs on: for provenance, limits, and `greenwater doctor`.

use serde::Serialize;

/// What is known about this machine.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Machine {
    /// Operating system.
    pub os: &'static str,
    /// Processor architecture.
    pub arch: &'static str,
    /// Model of the processor; the architecture where it cannot be read.
    pub cpu: String,
    /// Number of cores this process may use.
    pub cores: usize,
}

impl Machine {
    /// This machine.
    pub fn here() -> Self {
        let model = std::fs::read_to_string("/proc/cpuinfo").ok().and_then(|text| {
            let line = text.lines().find(|line| line.starts_with("model name"))?;
            line.split_once(':').map(|(_, name)| name.trim().to_owned())
        });
        Self {
            os: std::env::consts::OS,
            arch: std::env::consts::ARCH,
            cpu: model.unwrap_or_else(|| std::env::consts::ARCH.to_owned()),
            cores: std::thread::available_parallelism().map_or(1, usize::from),
        }
    }
}

/// Memory of this machine (or of the control group it runs in, if that is less), bytes; 8 GiB where it cannot be read.
pub fn memory() -> f64 {
    let total = std::fs::read_to_string("/proc/meminfo").ok().and_then(|text| {
        let line = text.lines().find(|line| line.starts_with("MemTotal:"))?;
        line.split_whitespace().nth(1)?.parse::<f64>().ok().map(|kib| 1024.0 * kib)
    });
    let group = std::fs::read_to_string("/sys/fs/cgroup/memory.max").ok().and_then(|text| text.trim().parse::<f64>().ok());
    total.unwrap_or(8.0 * 1_073_741_824.0).min(group.unwrap_or(f64::INFINITY))
}
