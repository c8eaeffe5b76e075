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

/// What an impact did: the numbers of a series of pressures or loads. Units: those of the series, and s.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Impact {
    /// Greatest sample in size, with its sign, and its time.
    pub peak: Peak,
    /// Greatest mean over the window of [`MEAN_WINDOW`], with its sign, at the middle of the window: unlike the raw peak it does not
    /// depend on the time step. Absent without scales of the case.
    pub mean_peak: Option<Peak>,
    /// Time from a tenth to nine tenths of the peak on the way to it, s.
    pub rise_time: Option<f64>,
    /// Time at which a tenth of the peak is first reached.
    pub arrival: f64,
    /// Integral over the whole run.
    pub impulse: f64,
    /// Mean over the window of [`QUASI_STATIC`] after the arrival; absent without scales or if the run ends before.
    pub quasi_static: Option<f64>,
}

/// Width of the window of a mean peak, in `√(H/g)`.
pub const MEAN_WINDOW: f64 = 0.05;
/// Start and end of the quasi-static load after the arrival of the water, in `√(H/g)`: past the first impact, before the wave that
/// went up the wall falls back (dam breaks, De Courcy et al. 2024).
pub const QUASI_STATIC: [f64; 2] = [1.1, 1.9];

impl Impact {
    /// The numbers of a series; `unit` is `√(H/g)` of the case, s.
    pub fn of(times: &[f64], values: &[f64], unit: Option<f64>) -> Option<Self> {
        let samples: Vec<[f64; 2]> =
            times.iter().zip(values).map(|(&t, &v)| [t, v]).filter(|p| p[0].is_finite() && p[1].is_finite()).collect();
        let sign = if samples.iter().map(|p| p[1]).fold(0.0, |most: f64, v| if v.abs() > most.abs() { v } else { most }) < 0.0 {
            -1.0
        } else {
            1.0
        };
        let upright: Vec<[f64; 2]> = samples.iter().map(|p| [p[0], sign * p[1]]).collect();
        let (ts, vs): (Vec<f64>, Vec<f64>) = upright.iter().map(|p| (p[0], p[1])).unzip();
        let top = peak(&ts, &vs)?;
        // Backwards from the peak: the last time below a share of it.
        let before: Vec<[f64; 2]> = upright.iter().copied().filter(|p| p[0] <= top.time).collect();
        let passes = |share: f64| {
            let last = before.iter().rposition(|p| p[1] < share * top.value)?;
            crossing(&before[last..], share * top.value)
        };
        let rise_time = passes(0.1).zip(passes(0.9)).map(|(start, end)| end - start);
        let arrival = crossing(&upright, 0.1 * top.value).unwrap_or(top.time);
        let between = |from: f64, to: f64| window_mean(&ts, &vs, from, to);
        let mean_peak = unit.and_then(|unit| {
            let half = 0.5 * MEAN_WINDOW * unit;
            let means: Vec<f64> = ts.iter().map(|t| between(t - half, t + half).unwrap_or(f64::NAN)).collect();
            peak(&ts, &means)
        });
        let quasi_static = unit.and_then(|unit| between(arrival + QUASI_STATIC[0] * unit, arrival + QUASI_STATIC[1] * unit));
        let span = ts.last().zip(ts.first()).map_or(0.0, |(end, start)| end - start);
        Some(Self {
            peak: Peak { value: sign * top.value, time: top.time },
            mean_peak: mean_peak.map(|mean| Peak { value: sign * mean.value, time: mean.time }),
            rise_time,
            arrival,
            impulse: sign * time_mean(&ts, &vs).unwrap_or(0.0) * span,
            quasi_static: quasi_static.map(|value| sign * value),
        })
    }
}

/// Mean over time of a series between `from` and `to`, by the trapezoidal rule with interpolated ends. `None` where the series does
/// not cover the window. Times rise; values are finite.
pub fn window_mean(times: &[f64], values: &[f64], from: f64, to: f64) -> Option<f64> {
    let (first, last) = (*times.first()?, *times.last()?);
    if !(first <= from && to <= last && from < to) {
        return None;
    }
    let at = |t: f64| {
        let k = times.partition_point(|&time| time < t).clamp(1, times.len() - 1);
        let share = if times[k] > times[k - 1] { (t - times[k - 1]) / (times[k] - times[k - 1]) } else { 1.0 };
        values[k - 1] + share * (values[k] - values[k - 1])
    };
    let inside = times.partition_point(|&t| t <= from)..times.partition_point(|&t| t < to);
    let points = std::iter::once((from, at(from))).chain(inside.map(|k| (times[k], values[k]))).chain(std::iter::once((to, at(to))));
    let points: Vec<(f64, f64)> = points.collect();
    let area: f64 = points.windows(2).map(|pair| 0.5 * (pair[0].1 + pair[1].1) * (pair[1].0 - pair[0].0)).sum();
    Some(area / (to - from))
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
    /// Particles that left the tank.
    pub lost_particles: Option<u64>,
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
            let end = end_time?;
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
            Some(ProbeNumbers { name: name.to_owned(), peak, mean, impact: Impact::of(times, values, unit)? })
        };
        let load = |name: &str| {
            let impact = Impact::of(run.loads.numbers("time"), run.loads.numbers(name), unit)?;
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
            lost_particles: summary.lost_particles.or_else(|| column("lost_particles").next_back().map(|n| n as u64)),
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
            let impact = Impact::of(&times, &values, Some(1.0)).expect("finite");
            assert_eq!(impact.peak, Peak { value: sign * 10.0, time: 2.0 });
            assert!((impact.arrival - 1.1).abs() < 1e-9, "{impact:?}");
            assert!((impact.rise_time.unwrap() - 0.8).abs() < 1e-9, "{impact:?}");
            // One interval between 10 and 4 at the edge: half of 6 times 1 ms.
            assert!((impact.impulse - sign * (5.0 + 16.0 + 0.003)).abs() < 1e-9, "{impact:?}");
            assert!((impact.quasi_static.unwrap() - sign * 4.0).abs() < 1e-9, "{impact:?}");
            // The best window of 0.05 s lies just before the edge: 10 - 0.25.
            assert!((impact.mean_peak.unwrap().value - sign * 9.75).abs() < 0.1, "{impact:?}");
        }
        assert_eq!(window_mean(&[0.0, 1.0, 2.0], &[0.0, 1.0, 2.0], 0.25, 1.25), Some(0.75));
        assert_eq!(window_mean(&[0.0, 1.0], &[0.0, 1.0], 0.5, 1.5), None);
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
