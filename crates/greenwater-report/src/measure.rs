//! Numbers from series: crossings, leads, peaks, means, medians. Cells that are not finite are skipped everywhere.

use crate::run::{Percentiles, Reference, Run, Spread};

/// Time at which a polyline of `[time, value]` first reaches `level`, by linear interpolation.
///
/// Units: those of the points. `None` if the level is never reached.
pub fn crossing(points: &[[f64; 2]], level: f64) -> Option<f64> {
    let mut finite = points.iter().filter(|p| p[0].is_finite() && p[1].is_finite());
    let mut last = finite.next()?;
    if last[1] == level {
        return Some(last[0]);
    }
    for point in finite {
        let (below, above) = (last[1] - level, point[1] - level);
        if above == 0.0 || (below < 0.0) != (above < 0.0) {
            return Some(last[0] + (point[0] - last[0]) * below / (below - above));
        }
        last = point;
    }
    None
}

/// How much earlier `run` reaches `level` than `reference`, in percent of the reference's time:
/// `100 (T_ref - T_run) / T_ref`. Positive: the run is ahead. Both polylines share axes.
///
/// `None` if either does not reach the level, or the reference reaches it at time 0.
pub fn lead(run: &[[f64; 2]], reference: &[[f64; 2]], level: f64) -> Option<f64> {
    let (run, reference) = (crossing(run, level)?, crossing(reference, level)?);
    (reference > 0.0).then(|| 100.0 * (reference - run) / reference)
}

/// Median of the finite values; of an even count, the mean of the middle two.
pub fn median(values: impl IntoIterator<Item = f64>) -> Option<f64> {
    let mut finite: Vec<f64> = values.into_iter().filter(|v| v.is_finite()).collect();
    finite.sort_by(f64::total_cmp);
    let n = finite.len();
    (n > 0).then(|| 0.5 * (finite[(n - 1) / 2] + finite[n / 2]))
}

/// Largest value and the time at which it is first reached.
pub fn peak(times: &[f64], values: &[f64]) -> Option<Peak> {
    let mut best: Option<Peak> = None;
    for (&time, &value) in times.iter().zip(values) {
        if time.is_finite() && value.is_finite() && best.is_none_or(|b| value > b.value) {
            best = Some(Peak { value, time });
        }
    }
    best
}

/// A maximum and its time, in the units of the series.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Peak {
    /// Largest value.
    pub value: f64,
    /// Time of the first sample with that value.
    pub time: f64,
}

/// Mean over time by the trapezoidal rule, `∫ v dt / ∫ dt`, over the intervals with two finite ends.
/// A single sample is its own mean.
pub fn time_mean(times: &[f64], values: &[f64]) -> Option<f64> {
    let samples: Vec<(f64, f64)> =
        times.iter().copied().zip(values.iter().copied()).filter(|(t, v)| t.is_finite() && v.is_finite()).collect();
    let (mut area, mut span) = (0.0, 0.0);
    for pair in samples.windows(2) {
        let dt = pair[1].0 - pair[0].0;
        area += 0.5 * (pair[0].1 + pair[1].1) * dt;
        span += dt;
    }
    if span > 0.0 { Some(area / span) } else { samples.first().map(|s| s.1) }
}

/// Energy at the start and the end, and its highest rise above the start.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EnergyBudget {
    /// Total at the first sample, in the unit of the file (J, or J/m in 2D).
    pub initial: f64,
    /// Total at the last sample, same unit.
    pub last: f64,
    /// `max(E(t) / E(0)) - 1`, dimensionless, >= 0.
    pub max_rise: f64,
}

impl EnergyBudget {
    /// The budget of a series of totals; `None` without a finite, positive start.
    pub fn of(totals: &[f64]) -> Option<Self> {
        let mut finite = totals.iter().copied().filter(|e| e.is_finite());
        let initial = finite.next().filter(|e| *e > 0.0)?;
        let (mut last, mut highest) = (initial, initial);
        for energy in finite {
            last = energy;
            highest = highest.max(energy);
        }
        Some(Self { initial, last, max_rise: highest / initial - 1.0 })
    }

    /// Part of the initial energy that is gone at the end, dimensionless: `1 - E(end) / E(0)`.
    pub fn loss(&self) -> f64 {
        1.0 - self.last / self.initial
    }
}

/// Front positions, dimensionless, at which leads are read.
pub const FRONT_LEVELS: [f64; 5] = [1.5, 2.0, 2.5, 3.0, 3.5];
/// Residual heights, dimensionless, at which leads are read.
pub const HEIGHT_LEVELS: [f64; 6] = [0.9, 0.8, 0.7, 0.6, 0.5, 0.4];

/// How much earlier a run passes a level than a reference.
#[derive(Clone, Debug, PartialEq)]
pub struct Lead {
    /// `front` or `residual_height`.
    pub quantity: String,
    /// Name of the reference.
    pub reference: String,
    /// The level, in the reference's dimensionless axis.
    pub level: f64,
    /// The lead in percent of the reference's time; positive: the run is ahead.
    pub percent: f64,
}

/// What the rows of a series are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rows {
    /// Values at the times of the rows: probes and gauges.
    Instants,
    /// Means since the row before: loads. The first row has nothing before it and does not count.
    Means,
}

/// A series and its integral over time. Cells that are not finite are left out; a mean then counts since the finite row before.
struct Signal {
    /// `[time, value]`: instants as they are, means in the middle of their time.
    points: Vec<[f64; 2]>,
    pieces: Vec<Piece>,
}

/// The series between two rows, straight from the first value to the last.
struct Piece {
    times: [f64; 2],
    values: [f64; 2],
    /// Integral of the series up to the start of the piece.
    before: f64,
}

impl Piece {
    /// Integral from the start of the piece to `time`.
    fn area(&self, time: f64) -> f64 {
        let ([start, end], [first, last]) = (self.times, self.values);
        let share = (time - start) / (end - start);
        (first + 0.5 * share * (last - first)) * (time - start)
    }
}

impl Signal {
    fn of(times: &[f64], values: &[f64], rows: Rows) -> Self {
        let finite: Vec<[f64; 2]> =
            times.iter().zip(values).map(|(&t, &v)| [t, v]).filter(|p| p[0].is_finite() && p[1].is_finite()).collect();
        let mut pieces: Vec<Piece> = Vec::new();
        let mut sum = 0.0;
        for pair in finite.windows(2).filter(|pair| pair[0][0] < pair[1][0]) {
            let first = if rows == Rows::Means { pair[1][1] } else { pair[0][1] };
            let piece = Piece { times: [pair[0][0], pair[1][0]], values: [first, pair[1][1]], before: sum };
            sum += piece.area(piece.times[1]);
            pieces.push(piece);
        }
        let points = match rows {
            Rows::Instants => finite,
            Rows::Means => pieces.iter().map(|piece| [0.5 * (piece.times[0] + piece.times[1]), piece.values[1]]).collect(),
        };
        Self { points, pieces }
    }

    /// First and last time, s; both 0 without rows.
    fn span(&self) -> [f64; 2] {
        self.pieces.first().zip(self.pieces.last()).map_or([0.0; 2], |(first, last)| [first.times[0], last.times[1]])
    }

    /// Integral from the start to `time`, which lies in the span.
    fn integral(&self, time: f64) -> f64 {
        let k = self.pieces.partition_point(|piece| piece.times[1] < time);
        self.pieces.get(k).map_or(0.0, |piece| piece.before + piece.area(time))
    }

    /// Mean between two times; `None` where the series does not cover them.
    fn mean(&self, from: f64, to: f64) -> Option<f64> {
        let [start, end] = self.span();
        (start <= from && from < to && to <= end).then(|| (self.integral(to) - self.integral(from)) / (to - from))
    }

    /// Greatest mean in size over a window of the given width, at its middle. All windows that begin or end at a row are looked at.
    fn greatest_mean(&self, width: f64) -> Option<Peak> {
        let rows = self.pieces.iter().map(|piece| piece.times[0]).chain(self.pieces.last().map(|piece| piece.times[1]));
        let windows = rows.flat_map(|row| [[row - width, row], [row, row + width]]);
        greatest(windows.filter_map(|[from, to]| Some([0.5 * (from + to), self.mean(from, to)?])))
    }
}

/// Greatest of `[time, value]` in size, the first of equals.
fn greatest(points: impl Iterator<Item = [f64; 2]>) -> Option<Peak> {
    points.map(|[time, value]| Peak { value, time }).reduce(|best, next| if next.value.abs() > best.value.abs() { next } else { best })
}

/// What an impact did: the numbers of a series of pressures or loads. Units: those of the series, and s.
///
/// The greatest mean over [`MEAN_WINDOW`] is the scale of all others (the peak where the case has no scales): it depends neither on the
/// time step nor on how often a row is written. An impact has an arrival. A load that stands from the start, such as the weight of the
/// water, has none, and no rise time: its mean over the first such window is a tenth of the greatest or more.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Impact {
    /// Greatest row in size, with its sign, and its time; for means the middle of theirs.
    pub peak: Peak,
    /// Greatest mean in size over the window of [`MEAN_WINDOW`], with its sign, at the middle of the window. Absent without scales of
    /// the case, and where the run is shorter than the window.
    pub mean_peak: Option<Peak>,
    /// Time at which the series first rises through a tenth of the greatest mean, in its direction.
    pub arrival: Option<f64>,
    /// Time from a tenth to nine tenths of the greatest mean, s: from the last rise through the one before the other is first reached.
    pub rise_time: Option<f64>,
    /// Integral over the whole run: the sum of mean times interval for means, which is exact, else the trapezoidal rule.
    pub impulse: f64,
    /// Mean over the window of [`QUASI_STATIC`] after the arrival; absent without an arrival or scales, or if the run ends before.
    pub quasi_static: Option<f64>,
    /// Mean over the same window after the start of the run: for loads that stand from the start.
    pub from_start: Option<f64>,
}

/// Width of the window of a mean peak, in `√(H/g)`.
pub const MEAN_WINDOW: f64 = 0.05;
/// Start and end of the quasi-static load after the arrival of the water, in `√(H/g)`: past the first impact, before the wave that
/// went up the wall falls back (dam breaks, De Courcy et al. 2024).
pub const QUASI_STATIC: [f64; 2] = [1.1, 1.9];

impl Impact {
    /// The numbers of a series; `unit` is `√(H/g)` of the case, s. `None` without a row that counts.
    pub fn of(times: &[f64], values: &[f64], rows: Rows, unit: Option<f64>) -> Option<Self> {
        let signal = Signal::of(times, values, rows);
        let peak = greatest(signal.points.iter().copied())?;
        let window = unit.map(|unit| MEAN_WINDOW * unit);
        let mean_peak = window.and_then(|width| signal.greatest_mean(width));
        let [start, end] = signal.span();
        let scale = mean_peak.unwrap_or(peak).value;
        let first = window.and_then(|width| signal.mean(start, start + width)).unwrap_or(signal.points[0][1]);
        let upright: Vec<[f64; 2]> = signal.points.iter().map(|p| [p[0], scale.signum() * p[1]]).collect();
        let stands = first.abs() >= 0.1 * scale.abs();
        let rise = if stands { None } else { Rise::of(&upright, scale.abs()) };
        let after = |time: f64| signal.mean(time + QUASI_STATIC[0] * unit?, time + QUASI_STATIC[1] * unit?);
        Some(Self {
            peak,
            mean_peak,
            arrival: rise.map(|rise| rise.arrival),
            rise_time: rise.map(|rise| rise.time),
            impulse: signal.integral(end),
            quasi_static: rise.and_then(|rise| after(rise.arrival)),
            from_start: after(start),
        })
    }

    /// Whether there is a load, and it has no arrival.
    pub fn stands_from_the_start(&self) -> bool {
        self.arrival.is_none() && self.peak.value != 0.0
    }
}

/// How a series that begins low comes up.
#[derive(Clone, Copy)]
struct Rise {
    /// First time at a tenth of the scale.
    arrival: f64,
    /// From there, or a later rise through it, to nine tenths, s.
    time: f64,
}

impl Rise {
    /// `None` where the points never are below a tenth of `scale`, or do not reach nine tenths of it after that.
    fn of(points: &[[f64; 2]], scale: f64) -> Option<Self> {
        let (low, high) = (0.1 * scale, 0.9 * scale);
        let rest = &points[points.iter().position(|p| p[1] < low)?..];
        let top = rest.iter().position(|p| p[1] >= high)?;
        let foot = rest[..top].iter().rposition(|p| p[1] < low)?;
        let time = crossing(&rest[top - 1..=top], high)? - crossing(&rest[foot..=top], low)?;
        Some(Self { arrival: crossing(rest, low)?, time })
    }
}

/// Mean over time of a series between `from` and `to`, by the trapezoidal rule with interpolated ends. `None` where the series does
/// not cover the window. Times rise.
pub fn window_mean(times: &[f64], values: &[f64], from: f64, to: f64) -> Option<f64> {
    Signal::of(times, values, Rows::Instants).mean(from, to)
}

/// Numbers of one pressure probe.
#[derive(Clone, Debug, PartialEq)]
pub struct ProbeNumbers {
    /// Name of the probe.
    pub name: String,
    /// Highest pressure, Pa, and its time, s.
    pub peak: Peak,
    /// Mean pressure over time, Pa.
    pub mean: f64,
    /// What the impact did.
    pub impact: Impact,
}

/// Numbers of one component of a load.
#[derive(Clone, Debug, PartialEq)]
pub struct LoadNumbers {
    /// Name of the column: `NAME.fx`.
    pub name: String,
    /// Its unit.
    pub unit: String,
    /// What the impact did.
    pub impact: Impact,
}

/// Everything that the report says about one run as a number. What the run did not leave is `None` or empty.
#[derive(Clone, Debug)]
pub struct Measured {
    /// Short name of the run.
    pub name: String,
    /// Preset.
    pub preset: String,
    /// Whether the run reached its end.
    pub completed: bool,
    /// Time reached, s.
    pub end_time: Option<f64>,
    /// Steps taken.
    pub steps: Option<u64>,
    /// Wall-clock time, s.
    pub wall_seconds: Option<f64>,
    /// Time steps, s.
    pub dt: Spread,
    /// Solver iterations a step.
    pub iterations: Option<Spread>,
    /// Particles, fluid and wall.
    pub particles: u64,
    /// Pressure noise over `ρ g H`, dimensionless: the median of the frames from a quarter to half of the end time.
    pub pressure_noise: Option<f64>,
    /// Density over rest density, dimensionless.
    pub density: Percentiles,
    /// Relative volume error at the end, dimensionless.
    pub volume_error: Option<f64>,
    /// The greatest in size of all frames, with its sign, dimensionless.
    pub worst_volume_error: Option<f64>,
    /// Particles that left the tank.
    pub lost_particles: Option<u64>,
    /// Whether something does work on the fluid.
    pub driven: bool,
    /// Energy at start and end, and its highest rise.
    pub energy: Option<EnergyBudget>,
    /// Unit of the energies.
    pub energy_unit: String,
    /// `[t, x]`, s and m.
    pub front: Vec<[f64; 2]>,
    /// `[t, height]`, s and m.
    pub residual_height: Vec<[f64; 2]>,
    /// One entry a probe with data.
    pub probes: Vec<ProbeNumbers>,
    /// One entry a component of a load.
    pub loads: Vec<LoadNumbers>,
    /// Leads over the references.
    pub leads: Vec<Lead>,
    /// Wall-clock seconds by phase, dearest first.
    pub phases: Vec<(String, f64)>,
    /// Hydrostatic pressure at the foot of the column, `ρ g H`, Pa.
    pub pressure_scale: Option<f64>,
}

impl Measured {
    /// Measures a run against the references.
    pub fn of(run: &Run, references: &[Reference]) -> Self {
        let summary = &run.summary;
        let end_time = run.end_time();
        let front = run.front.against_time("front");
        let residual_height = run.front.against_time("residual_height");
        let column = |name| run.quality.numbers(name).iter().copied().filter(|v: &f64| v.is_finite());
        let early = || {
            // A run that stopped early may not have come that far.
            let end = end_time.filter(|_| run.completed())?;
            let inside = |t: f64| t >= 0.25 * end && t <= 0.5 * end;
            let noise = run.quality.against_time("pressure_noise");
            median(noise.into_iter().filter(|p| inside(p[0])).map(|p| p[1]))
        };
        let mut phases: Vec<(String, f64)> = summary
            .phases
            .iter()
            .filter_map(|(name, seconds)| Some((name.clone(), seconds.filter(|s| s.is_finite() && *s >= 0.0)?)))
            .collect();
        phases.sort_by(|a, b| b.1.total_cmp(&a.1));
        let percentiles = summary.density_percentiles.unwrap_or_default();
        let times = run.probes.numbers("time");
        let scales = &run.provenance.scales;
        let unit = scales.height.zip(scales.gravity).map(|(height, g)| (height / g).sqrt()).filter(|unit| unit.is_finite() && *unit > 0.0);
        let probe = |name: &str| {
            let values = run.probes.numbers(name);
            let (peak, mean) = (peak(times, values)?, time_mean(times, values)?);
            Some(ProbeNumbers { name: name.to_owned(), peak, mean, impact: Impact::of(times, values, Rows::Instants, unit)? })
        };
        let load = |name: &str| {
            let impact = Impact::of(run.loads.numbers("time"), run.loads.numbers(name), Rows::Means, unit)?;
            Some(LoadNumbers { name: name.to_owned(), unit: run.loads.unit(name).to_owned(), impact })
        };
        Self {
            name: run.label.clone(),
            preset: run.provenance.preset.clone(),
            completed: run.completed(),
            end_time,
            steps: run.step_count(),
            wall_seconds: run.wall_seconds(),
            dt: run.dt(),
            iterations: summary.iterations.or_else(|| {
                let logged = run.steps.numbers("iterations");
                logged.iter().any(|n| *n > 0.0).then(|| Spread::of(logged))
            }),
            particles: run.particle_count(),
            pressure_noise: summary.pressure_noise.or_else(early),
            density: Percentiles {
                p01: percentiles.p01.or_else(|| column("density_p01").reduce(f64::min)),
                p99: percentiles.p99.or_else(|| column("density_p99").reduce(f64::max)),
            },
            volume_error: summary.volume_error.or_else(|| column("volume_error").next_back()),
            worst_volume_error: column("volume_error").max_by(|a, b| a.abs().total_cmp(&b.abs())).or(summary.volume_error),
            lost_particles: summary.lost_particles.or_else(|| column("lost_particles").next_back().map(|n| n as u64)),
            driven: run.provenance.driven,
            energy: EnergyBudget::of(run.energy.numbers("total")),
            energy_unit: run.energy.unit("total").to_owned(),
            leads: leads(&front, &residual_height, references),
            front,
            residual_height,
            probes: run.probes.names().filter(|name| *name != "time").filter_map(probe).collect(),
            loads: run.loads.names().filter(|name| *name != "time").filter_map(load).collect(),
            phases,
            pressure_scale: run.provenance.scales.pressure(),
        }
    }

    /// Wall-clock seconds a step.
    pub fn seconds_per_step(&self) -> Option<f64> {
        let steps = self.steps.filter(|n| *n > 0)?;
        Some(self.wall_seconds? / steps as f64)
    }

    /// `seconds` of the whole run as microseconds per particle and step, all particles counted.
    pub fn per_particle_step(&self, seconds: f64) -> Option<f64> {
        let work = self.steps? as f64 * self.particles as f64;
        (work > 0.0).then(|| 1e6 * seconds / work)
    }

    /// Largest departure of the two density percentiles from rest, dimensionless.
    pub fn density_error(&self) -> Option<f64> {
        Some((self.density.p01? - 1.0).abs().max((self.density.p99? - 1.0).abs()))
    }
}

fn leads(front: &[[f64; 2]], residual_height: &[[f64; 2]], references: &[Reference]) -> Vec<Lead> {
    let mut leads = Vec::new();
    for reference in references {
        let (series, levels): (&[[f64; 2]], &[f64]) = match reference.quantity.as_str() {
            "front" => (front, &FRONT_LEVELS),
            "residual_height" => (residual_height, &HEIGHT_LEVELS),
            _ => continue,
        };
        let Some((time_scale, value_scale)) = reference.scaling() else { continue };
        let scaled: Vec<[f64; 2]> = series.iter().map(|p| [p[0] * time_scale, p[1] * value_scale]).collect();
        for &level in levels {
            if let Some(percent) = lead(&scaled, &reference.points, level) {
                let (quantity, reference) = (reference.quantity.clone(), reference.name.clone());
                leads.push(Lead { quantity, reference, level, percent });
            }
        }
    }
    leads
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_crossing_is_interpolated_and_works_in_both_directions() {
        // Midway between samples of a straight line: exact in binary.
        assert_eq!(crossing(&[[0.0, 1.0], [1.0, 2.0]], 1.5), Some(0.5));
        assert_eq!(crossing(&[[0.0, 1.0], [f64::NAN, 9.0], [2.0, 0.0]], 0.5), Some(1.0));
        assert_eq!(crossing(&[[0.0, 1.0], [1.0, 2.0]], 2.5), None);
        assert_eq!(crossing(&[], 1.0), None);
    }

    fn close(value: f64, exact: f64, tolerance: f64, what: &str) {
        assert!((value - exact).abs() <= tolerance, "{what}: {value}, but {exact} within {tolerance:e}");
    }

    /// A triangle from 0 at t = 1 to 10 at t = 2, then 4 until t = 6: every number by hand. 1e-9: round-off.
    #[test]
    fn an_impact_is_reduced_to_its_numbers() {
        let times: Vec<f64> = (0..=6000).map(|i| 1e-3 * f64::from(i)).collect();
        let shape = |t: f64| {
            if t < 1.0 {
                0.0
            } else if t <= 2.0 {
                10.0 * (t - 1.0)
            } else {
                4.0
            }
        };
        for sign in [1.0, -1.0] {
            let values: Vec<f64> = times.iter().map(|&t| sign * shape(t)).collect();
            let impact = Impact::of(&times, &values, Rows::Instants, Some(1.0)).expect("finite");
            assert_eq!(impact.peak, Peak { value: sign * 10.0, time: 2.0 });
            // The best window of 0.05 s ends at the edge: 10 - 0.25. A tenth of it is reached at 1.0975, nine tenths at 1.8775.
            let mean = impact.mean_peak.expect("the run is longer than the window");
            close(mean.value, sign * 9.75, 1e-9, "peak of means");
            close(mean.time, 1.975, 1e-9, "its time");
            close(impact.arrival.expect("an impact"), 1.0975, 1e-9, "arrival");
            close(impact.rise_time.expect("an impact"), 0.78, 1e-9, "rise time");
            // One interval between 10 and 4 at the edge: half of 6 times 1 ms.
            close(impact.impulse, sign * (5.0 + 16.0 + 0.003), 1e-9, "impulse");
            close(impact.quasi_static.expect("the run is long enough"), sign * 4.0, 1e-9, "quasi-static mean");
        }
        assert_eq!(window_mean(&[0.0, 1.0, 2.0], &[0.0, 1.0, 2.0], 0.25, 1.25), Some(0.75));
        assert_eq!(window_mean(&[0.0, 1.0], &[0.0, 1.0], 0.5, 1.5), None);
    }

    /// Rows that hold means since the row before of a force with the impulse `impulse(t)`; the first row as given.
    fn mean_rows(times: &[f64], first: f64, impulse: impl Fn(f64) -> f64) -> Vec<f64> {
        let means = times.windows(2).map(|pair| (impulse(pair[1]) - impulse(pair[0])) / (pair[1] - pair[0]));
        std::iter::once(first).chain(means).collect()
    }

    /// `-1000 (1 - exp(-t))` and a bump of 50 between 0.31 and 0.33: rows every 50 ms and every 0.3 ms, a first row of zero and one with
    /// a load. 1e-9: round-off of sums of up to 7000 rows.
    #[test]
    fn the_impulse_of_means_does_not_depend_on_how_often_they_are_written() {
        let impulse = |t: f64| -1000.0 * (t + (-t).exp() - 1.0) + 50.0 * (t.clamp(0.31, 0.33) - 0.31);
        for interval in [0.05, 3e-4] {
            let times: Vec<f64> = (0..).map(|i| interval * f64::from(i)).take_while(|t| *t < 2.0).chain([2.0]).collect();
            for first in [0.0, -700.0] {
                let impact = Impact::of(&times, &mean_rows(&times, first, impulse), Rows::Means, Some(0.3)).expect("finite");
                close(impact.impulse, impulse(2.0), 1e-9 * 1000.0, "impulse");
            }
        }
    }

    /// A step from 0 to 5 at t = 1, which is a row of both tables: it arrives there within one row, whatever the first row says.
    #[test]
    fn a_step_arrives_when_it_comes_for_means_and_instants() {
        let times: Vec<f64> = (0..=500).map(|i| 0.01 * f64::from(i)).collect();
        let instants: Vec<f64> = times.iter().map(|&t| if t < 0.999 { 0.0 } else { 5.0 }).collect();
        let means = mean_rows(&times, -3.0, |t| 5.0 * (t - 1.0).max(0.0));
        for (values, rows) in [(instants, Rows::Instants), (means, Rows::Means)] {
            let impact = Impact::of(&times, &values, rows, Some(1.0)).expect("finite");
            close(impact.arrival.expect("an impact"), 1.0, 0.01, "arrival");
            close(impact.rise_time.expect("an impact"), 0.0, 0.01, "rise time");
            close(impact.quasi_static.expect("the run is long enough"), 5.0, 1e-9, "quasi-static mean");
            close(impact.peak.value, 5.0, 1e-9, "peak");
        }
    }

    /// The weight of the tank, with a first row of zero as `isph` writes it and one with the load as `delta-sph` does: the same numbers,
    /// no arrival, and a mean over the window after the start. The weight falls by 2 each s: -100 + 2 · 1.5 in the middle of the window.
    #[test]
    fn a_load_that_stands_from_the_start_has_no_arrival() {
        let times: Vec<f64> = (0..=400).map(|i| 0.01 * f64::from(i)).collect();
        let [released, still] = [0.0, -100.0]
            .map(|first| Impact::of(&times, &mean_rows(&times, first, |t| -100.0 * t + t * t), Rows::Means, Some(1.0)).expect("finite"));
        assert_eq!(released, still);
        assert!(still.stands_from_the_start());
        assert_eq!((still.arrival, still.rise_time, still.quasi_static), (None, None, None));
        close(still.from_start.expect("the run is long enough"), -97.0, 1e-9, "mean from the start");
    }

    /// A spike of one row, twenty times the load that follows: the peak tells it, arrival and quasi-static mean do not.
    #[test]
    fn a_single_spike_moves_the_peak_alone() {
        let times: Vec<f64> = (0..=4000).map(|i| 1e-3 * f64::from(i)).collect();
        let impulse = |t: f64| (t - 1.0).max(0.0);
        let plain = mean_rows(&times, 0.0, impulse);
        let mut spiky = plain.clone();
        spiky[1200] = 20.0;
        let [plain, spiky] = [plain, spiky].map(|values| Impact::of(&times, &values, Rows::Means, Some(1.0)).expect("finite"));
        assert_eq!(spiky.peak.value, 20.0);
        close(spiky.arrival.expect("an impact"), plain.arrival.expect("an impact"), 1e-3, "arrival");
        close(spiky.quasi_static.expect("long enough"), plain.quasi_static.expect("long enough"), 1e-9, "quasi-static mean");
    }

    #[test]
    fn no_load_and_no_row_have_no_impact() {
        let dry = Impact::of(&[0.0, 1.0, 2.0], &[0.0; 3], Rows::Instants, Some(1.0)).expect("finite");
        assert!(dry.arrival.is_none() && !dry.stands_from_the_start() && dry.impulse == 0.0);
        assert_eq!(Impact::of(&[0.0], &[7.0], Rows::Means, Some(1.0)), None);
        // A cell that is not finite: the next mean counts since the row before.
        let gap = Impact::of(&[0.0, 1.0, 2.0, 3.0], &[0.0, 1.0, f64::NAN, 2.0], Rows::Means, None).expect("finite");
        assert_eq!(gap.impulse, 5.0);
        // Without scales the peak is the scale: a tenth of it is reached between the middles of the first two rows.
        let bare = Impact::of(&[0.0, 1.0, 2.0], &[9.0, 0.0, 10.0], Rows::Means, None).expect("finite");
        assert_eq!((bare.arrival, bare.mean_peak), (Some(0.6), None));
    }

    #[test]
    fn a_run_that_arrives_early_has_a_positive_lead() {
        let run = [[0.0, 1.0], [0.8, 2.0]];
        let reference = [[0.0, 1.0], [1.0, 2.0]];
        let lead = lead(&run, &reference, 1.5).expect("both reach 1.5");
        assert!((lead - 20.0).abs() < 1e-12, "lead {lead} %, expected 20 by construction");
    }

    #[test]
    fn a_time_mean_weighs_uneven_steps_and_skips_bad_cells() {
        // v = t on [0, 4] has mean 2 whatever the sampling; the trapezoid is exact for it.
        let mean = time_mean(&[0.0, 1.0, 1.5, 4.0], &[0.0, 1.0, f64::NAN, 4.0]);
        assert_eq!(mean, Some(2.0));
        assert_eq!(time_mean(&[], &[]), None);
    }

    #[test]
    fn an_energy_budget_needs_a_positive_start() {
        let budget = EnergyBudget::of(&[2.0, 2.5, 1.0]).expect("starts at 2");
        assert_eq!((budget.max_rise, budget.loss()), (0.25, 0.5));
        assert_eq!(EnergyBudget::of(&[0.0, 1.0]), None);
        assert_eq!(EnergyBudget::of(&[f64::NAN]), None);
    }

    #[test]
    fn a_median_ignores_what_is_not_finite() {
        assert_eq!(median([3.0, f64::NAN, 1.0, 2.0]), Some(2.0));
        assert_eq!(median([4.0, 1.0]), Some(2.5));
        assert_eq!(median([f64::NAN]), None);
    }
}
