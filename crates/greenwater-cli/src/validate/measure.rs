//! Takes quantities from run folders, as `bands.toml` says. No method and no case is treated on its own.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::path::Path;
use std::rc::Rc;

use greenwater::formula::Formula;
use greenwater::kernel::{Kernel, WendlandC2};
use greenwater::observe::solve_small;
use greenwater_report::measure::{crossing, time_mean, window_mean};
use greenwater_report::run::{FrameColumns, Run, Table, read_columns};
use serde_json::Value;

use super::suite::{Bands, Curve, CurvePick, Field, Line, Measure, Norm, Number, Over, Pick, Quantity, Series};

/// Why a quantity could not be measured: a sentence.
type Problem = String;

/// A measured quantity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Measured {
    /// The value.
    pub value: f64,
    /// What it should be, where the measure itself says so.
    pub reference: Option<f64>,
}

/// A finished run, read: its tables, its frames as they are asked for, and the constants of its formulas.
pub struct Reading {
    run: Run,
    summary: Value,
    /// Names and values of the constants.
    pub constants: Vec<(String, f64)>,
    frames: RefCell<BTreeMap<usize, Rc<FrameColumns>>>,
    dimension: usize,
    spacing: f64,
}

impl Reading {
    /// Reads the run folder at `folder`.
    pub fn of(folder: &Path, bands: &Bands) -> Result<Self, Problem> {
        let run = Run::read(folder).map_err(|e| e.to_string())?;
        let summary = std::fs::read_to_string(folder.join("summary.json")).ok().and_then(|text| serde_json::from_str(&text).ok());
        let scales = &run.provenance.scales;
        let known =
            [("dx", scales.spacing), ("g", scales.gravity), ("rho0", scales.rest_density), ("H", scales.height), ("L", scales.width)];
        let mut constants: Vec<(String, f64)> = known.iter().filter_map(|(name, value)| Some(((*name).to_owned(), (*value)?))).collect();
        // Constants may name each other: as often as there are, so that every order works.
        let mut left: Vec<(&String, &Number)> = bands.constants.iter().collect();
        while !left.is_empty() {
            let before = left.len();
            let mut problem = String::new();
            left.retain(|(name, number)| match evaluate(number, &constants) {
                Ok(value) => {
                    constants.retain(|(known, _)| known != *name);
                    constants.push(((*name).clone(), value));
                    false
                }
                Err(e) => {
                    problem = format!("constant `{name}`: {e}");
                    true
                }
            });
            if left.len() == before {
                return Err(problem);
            }
        }
        Ok(Self {
            dimension: run.provenance.dimension,
            spacing: scales.spacing.unwrap_or(f64::NAN),
            summary: summary.unwrap_or(Value::Null),
            constants,
            frames: RefCell::default(),
            run,
        })
    }

    /// Whether the run reached its end; else why not.
    pub fn failure(&self) -> Option<String> {
        use greenwater_report::run::Outcome;
        match &self.run.outcome {
            Outcome::Finished => None,
            Outcome::Failed(failure) => Some(failure.error.clone()),
            Outcome::Unfinished => Some("the run is not finished".to_owned()),
        }
    }

    /// Wall-clock time of the run, s.
    pub fn seconds(&self) -> f64 {
        self.run.summary.wall_seconds.unwrap_or(f64::NAN)
    }

    /// The value of a number or formula of constants.
    pub fn number(&self, number: &Number) -> Result<f64, Problem> {
        evaluate(number, &self.constants)
    }

    fn optional(&self, number: Option<&Number>) -> Result<Option<f64>, Problem> {
        number.map(|number| self.number(number)).transpose()
    }

    /// Measures what needs this run alone. `tables` are the curves of the case.
    pub fn measure(&self, measure: &Measure, tables: &[(&str, &str)]) -> Result<Measured, Problem> {
        let value = match measure {
            Measure::Field(field) => self.field(field)?,
            Measure::Line(line) => self.line(line)?,
            Measure::Series(series) => self.series(series)?,
            Measure::Curve(curve) => return self.curve(curve, tables),
            Measure::Summary(key) => self.summary(key)?,
            Measure::Order { .. } | Measure::Change { .. } | Measure::Ratio { .. } | Measure::Methods { .. } => {
                return Err("needs other quantities".to_owned());
            }
        };
        if value.is_finite() { Ok(Measured { value, reference: None }) } else { Err("the value is not finite".to_owned()) }
    }

    fn summary(&self, key: &str) -> Result<f64, Problem> {
        let value = key.split('.').fold(&self.summary, |value, part| &value[part]);
        value.as_f64().ok_or_else(|| format!("summary.json has no number `{key}`"))
    }

    // ---- frames -----------------------------------------------------------------------------------------------

    fn frame(&self, index: usize) -> Result<Rc<FrameColumns>, Problem> {
        if let Some(frame) = self.frames.borrow().get(&index) {
            return Ok(frame.clone());
        }
        let frame = Rc::new(read_columns(&self.run.frames[index].path).map_err(|e| e.to_string())?);
        self.frames.borrow_mut().insert(index, frame.clone());
        Ok(frame)
    }

    fn nearest_frame(&self, time: f64) -> Result<usize, Problem> {
        let away = |i: &usize| (self.run.frames[*i].time - time).abs();
        let nearest = (0..self.run.frames.len()).min_by(|a, b| away(a).total_cmp(&away(b))).ok_or("the run has no frame")?;
        // Steps are not cut to hit a time: a frame may be late by one, here at most 2 % of the run. Formulas know its own time.
        let end = self.run.frames.last().map_or(0.0, |frame| frame.time);
        if away(&nearest) <= 0.02 * end.max(time) { Ok(nearest) } else { Err(format!("the run has no frame near t = {time} s")) }
    }

    fn frames_of(&self, at: Option<&Number>, from: Option<&Number>, to: Option<&Number>) -> Result<Vec<usize>, Problem> {
        let (at, from, to) = (self.optional(at)?, self.optional(from)?, self.optional(to)?);
        let last = self.run.frames.len().checked_sub(1).ok_or("the run has no frame")?;
        match (at, from, to) {
            (Some(time), None, None) => Ok(vec![self.nearest_frame(time)?]),
            (None, None, None) => Ok(vec![last]),
            (None, from, to) => {
                let (from, to) = (from.unwrap_or(0.0), to.unwrap_or(f64::INFINITY));
                let inside: Vec<usize> = (0..=last).filter(|&i| (from..=to).contains(&self.run.frames[i].time)).collect();
                if inside.is_empty() { Err(format!("the run has no frame from t = {from} to {to} s")) } else { Ok(inside) }
            }
            _ => Err("`at` excludes `from` and `to`".to_owned()),
        }
    }

    /// A formula of the state of a particle.
    fn of_state(&self, text: &str) -> Result<StateFormula, Problem> {
        let names: Vec<&str> = STATE.iter().copied().chain(self.constants.iter().map(|(name, _)| name.as_str())).collect();
        let formula = Formula::parse(text, &names).map_err(|e| format!("formula {text:?}: {e}"))?;
        let values = STATE.iter().map(|_| 0.0).chain(self.constants.iter().map(|(_, value)| *value)).collect();
        Ok(StateFormula { formula, values })
    }

    fn field(&self, field: &Field) -> Result<f64, Problem> {
        let frames = self.frames_of(field.at.as_ref(), field.from.as_ref(), field.to.as_ref())?;
        let of_frame = |index: usize| self.reduce(field, index);
        let scale = self.optional(field.scale.as_ref())?.unwrap_or(1.0);
        let start = if field.relative_to_start || field.less_start { of_frame(0)? } else { 0.0 };
        let mut values = Vec::new();
        for index in frames {
            let mut value = of_frame(index)?;
            if field.relative_to_start {
                value /= start;
            }
            if field.less_start {
                value -= start;
            }
            values.push(value / scale);
        }
        over(field.over, &values)
    }

    fn reduce(&self, field: &Field, index: usize) -> Result<f64, Problem> {
        let frame = self.frame(index)?;
        let state = State::of(&frame, self.run.frames[index].time)?;
        let mut value = self.of_state(&field.value)?;
        let mut exact = field.exact.as_deref().map(|text| self.of_state(text)).transpose()?;
        let mut only = field.only.as_deref().map(|text| self.of_state(text)).transpose()?;
        let (mut results, mut squares) = (Vec::new(), 0.0);
        for a in 0..frame.points.len() {
            if state.kind[a] != 0.0 || only.as_mut().is_some_and(|only| only.value(&state.at(a)) <= 0.0) {
                continue;
            }
            let row = state.at(a);
            let expected = exact.as_mut().map_or(0.0, |exact| exact.value(&row));
            squares += expected * expected;
            results.push(value.value(&row) - expected);
        }
        reduce(field.norm, &results, squares)
    }

    fn line(&self, line: &Line) -> Result<f64, Problem> {
        let index = match self.optional(line.at.as_ref())? {
            Some(time) => self.nearest_frame(time)?,
            None => self.run.frames.len().checked_sub(1).ok_or("the run has no frame")?,
        };
        let frame = self.frame(index)?;
        let state = State::of(&frame, self.run.frames[index].time)?;
        let end = |numbers: &[Number]| -> Result<[f64; 3], Problem> {
            let mut x = [0.0; 3];
            for (d, number) in numbers.iter().enumerate().take(3) {
                x[d] = self.number(number)?;
            }
            Ok(x)
        };
        let (from, to) = (end(&line.from)?, end(&line.to)?);
        let mut value = self.of_state(&line.value)?;
        let mut exact = line.exact.as_deref().map(|text| self.of_state(text)).transpose()?;
        let values: Vec<f64> =
            (0..frame.points.len()).map(|a| if state.kind[a] == 0.0 { value.value(&state.at(a)) } else { f64::NAN }).collect();
        let length = (0..3).map(|d| (to[d] - from[d]) * (to[d] - from[d])).sum::<f64>().sqrt();
        let pieces = (length / (0.25 * self.spacing)).ceil().max(1.0);
        let (mut results, mut squares) = (Vec::new(), 0.0);
        for i in 0..=pieces as usize {
            let share = i as f64 / pieces;
            let x: [f64; 3] = std::array::from_fn(|d| from[d] + share * (to[d] - from[d]));
            let Some(found) = fit(&frame.points, &values, x, self.spacing, self.dimension) else { continue };
            let mut row = [0.0; STATE.len()];
            (row[0], row[1], row[2], row[STATE.len() - 1]) = (x[0], x[1], x[2], state.time);
            let expected = exact.as_mut().map_or(0.0, |exact| exact.value(&row));
            squares += expected * expected;
            results.push(found - expected);
        }
        Ok(reduce(line.norm, &results, squares)? / self.optional(line.scale.as_ref())?.unwrap_or(1.0))
    }

    // ---- tables -----------------------------------------------------------------------------------------------

    fn column(&self, table: &str, column: &str) -> Result<Vec<[f64; 2]>, Problem> {
        let table_of: &Table = match table {
            "energy" => &self.run.energy,
            "front" => &self.run.front,
            "probes" => &self.run.probes,
            "gauges" => &self.run.gauges,
            "loads" => &self.run.loads,
            "quality" => &self.run.quality,
            "steps" => &self.run.steps,
            other => return Err(format!("a run has no table `{other}`")),
        };
        let rows: Vec<[f64; 2]> =
            table_of.against_time(column).into_iter().filter(|row| row[0].is_finite() && row[1].is_finite()).collect();
        if rows.is_empty() { Err(format!("{table}.csv has no numbers in the column `{column}`")) } else { Ok(rows) }
    }

    fn series(&self, series: &Series) -> Result<f64, Problem> {
        let all = self.column(&series.table, &series.column)?;
        let (from, to) = (
            self.optional(series.from.as_ref())?.unwrap_or(f64::NEG_INFINITY),
            self.optional(series.to.as_ref())?.unwrap_or(f64::INFINITY),
        );
        let at = self.optional(series.at.as_ref())?;
        let scale = self.optional(series.scale.as_ref())?.unwrap_or(1.0);
        let less = self.optional(series.less.as_ref())?.unwrap_or(0.0);
        let rows: Vec<[f64; 2]> = all.into_iter().filter(|row| (from..=to).contains(&row[0])).collect();
        if rows.is_empty() {
            return Err(format!("{}.csv has no rows from t = {from} to {to} s", series.table));
        }
        Ok((pick(series.pick, &rows, at)? - less) / scale)
    }

    fn curve(&self, curve: &Curve, tables: &[(&str, &str)]) -> Result<Measured, Problem> {
        let text = tables.iter().find(|(name, _)| *name == curve.curve).map(|(_, text)| *text);
        let reference = points(text.ok_or_else(|| format!("the case has no curve `{}`", curve.curve))?);
        let (time, value) = (self.number(&curve.time_scale)?, self.number(&curve.value_scale)?);
        let mut rows: Vec<[f64; 2]> =
            self.column(&curve.table, &curve.column)?.into_iter().map(|row| [row[0] * time, row[1] * value]).collect();
        if let Some(level) = curve.align {
            let start = crossing(&rows, level).ok_or_else(|| format!("the run does not reach {level}"))?;
            rows.iter_mut().for_each(|row| row[0] -= start);
        }
        let window = || curve.from.zip(curve.to).ok_or_else(|| "`from` and `to` are missing".to_owned());
        let level = || curve.level.ok_or_else(|| "`level` is missing".to_owned());
        let mean = |rows: &[[f64; 2]], what: &str| -> Result<f64, Problem> {
            let (from, to) = window()?;
            let (times, values): (Vec<f64>, Vec<f64>) = rows.iter().map(|row| (row[0], row[1])).unzip();
            window_mean(&times, &values, from, to).ok_or_else(|| format!("{what} does not cover {from} to {to}"))
        };
        let with = |value: f64, reference: f64| Measured { value, reference: Some(reference) };
        Ok(match curve.pick {
            CurvePick::Mean => with(mean(&rows, "the run")?, mean(&reference, "the curve")?),
            CurvePick::Integral => {
                let (from, to) = window()?;
                with((to - from) * mean(&rows, "the run")?, (to - from) * mean(&reference, "the curve")?)
            }
            CurvePick::Arrival => {
                let reached = |rows: &[[f64; 2]], what: &str| {
                    let level = level()?;
                    crossing(rows, level).ok_or_else(|| format!("{what} does not reach {level}"))
                };
                with(reached(&rows, "the run")?, reached(&reference, "the curve")?)
            }
            CurvePick::Difference => {
                let (from, to) = window()?;
                let (times, values): (Vec<f64>, Vec<f64>) = rows.iter().map(|row| (row[0], row[1])).unzip();
                let (mut sum, mut count) = (0.0, 0);
                for point in reference.iter().filter(|point| (from..=to).contains(&point[0])) {
                    let told = interpolate(&times, &values, point[0]).ok_or_else(|| format!("the run does not reach {}", point[0]))?;
                    sum += (told - point[1]) * (told - point[1]);
                    count += 1;
                }
                if count == 0 {
                    return Err(format!("the curve has no point from {from} to {to}"));
                }
                with((sum / f64::from(count)).sqrt(), 0.0)
            }
            CurvePick::Lead => {
                let (low, high) = window()?;
                let leads: Vec<f64> = (0..=20)
                    .map(|i| low + (high - low) * f64::from(i) / 20.0)
                    .filter_map(|level| Some((crossing(&reference, level)?, crossing(&rows, level)?)))
                    .map(|(theirs, ours)| 100.0 * (theirs - ours) / theirs)
                    .collect();
                if leads.is_empty() {
                    return Err(format!("run and curve share no value from {low} to {high}"));
                }
                with(leads.iter().sum::<f64>() / leads.len() as f64, 0.0)
            }
        })
    }
}

/// Names of the state of a particle in formulas.
const STATE: [&str; 10] = ["x", "y", "z", "u", "v", "w", "p", "rho", "m", "t"];

/// A formula of the state of a particle and of constants.
struct StateFormula {
    formula: Formula,
    values: Vec<f64>,
}

impl StateFormula {
    fn value(&mut self, state: &[f64; STATE.len()]) -> f64 {
        self.values[..STATE.len()].copy_from_slice(state);
        self.formula.value(&self.values)
    }
}

/// The columns of a frame that formulas know.
struct State<'a> {
    points: &'a [[f64; 3]],
    velocity: &'a [f64],
    pressure: &'a [f64],
    density: &'a [f64],
    mass: &'a [f64],
    kind: &'a [f64],
    time: f64,
}

impl<'a> State<'a> {
    fn of(frame: &'a FrameColumns, time: f64) -> Result<Self, Problem> {
        let column = |name: &str| {
            let found = frame.columns.iter().find(|column| column.name == name);
            found.map(|column| column.values.as_slice()).ok_or_else(|| format!("frames have no column `{name}`"))
        };
        Ok(Self {
            points: &frame.points,
            velocity: column("velocity")?,
            pressure: column("pressure")?,
            density: column("density")?,
            mass: column("mass")?,
            kind: column("kind")?,
            time,
        })
    }

    fn at(&self, a: usize) -> [f64; STATE.len()] {
        let ([x, y, z], v) = (self.points[a], &self.velocity[3 * a..3 * a + 3]);
        [x, y, z, v[0], v[1], v[2], self.pressure[a], self.density[a], self.mass[a], self.time]
    }
}

/// The value of a number or formula of constants.
fn evaluate(number: &Number, constants: &[(String, f64)]) -> Result<f64, Problem> {
    match number {
        Number::Plain(value) => Ok(*value),
        Number::Formula(text) => {
            let (names, values): (Vec<&str>, Vec<f64>) = constants.iter().map(|(name, value)| (name.as_str(), *value)).unzip();
            let value = Formula::parse(text, &names).map_err(|e| format!("formula {text:?}: {e}"))?.value(&values);
            if value.is_finite() { Ok(value) } else { Err(format!("formula {text:?} is not finite")) }
        }
    }
}

/// Reduces values; `squares` is the sum of squares of what they should be.
fn reduce(norm: Norm, values: &[f64], squares: f64) -> Result<f64, Problem> {
    if values.is_empty() {
        return Err("no particle counts".to_owned());
    }
    let count = values.len() as f64;
    let sum_of_squares = || values.iter().map(|v| v * v).sum::<f64>();
    let percentile = |share: f64| {
        let mut sorted = values.to_vec();
        sorted.sort_by(f64::total_cmp);
        sorted[(share * (count - 1.0)).round() as usize]
    };
    Ok(match norm {
        Norm::Sum => values.iter().sum(),
        Norm::Mean => values.iter().sum::<f64>() / count,
        Norm::Max => values.iter().copied().fold(f64::NEG_INFINITY, f64::max),
        Norm::Min => values.iter().copied().fold(f64::INFINITY, f64::min),
        Norm::Linf => values.iter().map(|v| v.abs()).fold(0.0, f64::max),
        Norm::Rms => (sum_of_squares() / count).sqrt(),
        Norm::L2 => (sum_of_squares() / squares).sqrt(),
        Norm::P01 => percentile(0.01),
        Norm::P99 => percentile(0.99),
    })
}

/// Reduces the values of frames.
fn over(over: Over, values: &[f64]) -> Result<f64, Problem> {
    let last = *values.last().ok_or("no frame counts")?;
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    Ok(match over {
        Over::Last => last,
        Over::Max => values.iter().copied().fold(f64::NEG_INFINITY, f64::max),
        Over::Min => values.iter().copied().fold(f64::INFINITY, f64::min),
        Over::Mean => mean(values),
        Over::Trend => {
            let (first, second) = values.split_at(values.len() / 2);
            if first.is_empty() {
                return Err("a trend needs two frames".to_owned());
            }
            mean(second) / mean(first)
        }
        Over::Rise => rise(values.iter().copied()),
    })
}

/// Greatest rise above what was the least before.
fn rise(values: impl Iterator<Item = f64>) -> f64 {
    let (mut least, mut most) = (f64::INFINITY, 0.0_f64);
    for value in values {
        least = least.min(value);
        most = most.max(value - least);
    }
    most
}

/// Amplitude of the sine of which the span of the rows holds `periods`, fitted with a constant in the mean over time, and the mean square that
/// it leaves.
fn sine(rows: &[[f64; 2]], periods: f64) -> Result<(f64, f64), Problem> {
    if rows.len() < 4 {
        return Err(format!("{} rows do not make a sine", rows.len()));
    }
    let (start, end) = (rows[0][0], rows[rows.len() - 1][0]);
    let (mut matrix, mut right, mut square) = ([[0.0; 5]; 4], [0.0; 3], 0.0);
    for (i, &[t, value]) in rows.iter().enumerate() {
        let weight = 0.5 * (rows[(i + 1).min(rows.len() - 1)][0] - rows[i.saturating_sub(1)][0]) / (end - start);
        let (sin, cos) = (2.0 * std::f64::consts::PI * periods * (t - start) / (end - start)).sin_cos();
        let shapes = [1.0, sin, cos];
        for j in 0..3 {
            for k in 0..3 {
                matrix[j][k] += weight * shapes[j] * shapes[k];
            }
            right[j] += weight * shapes[j] * value;
            matrix[j][3] = right[j];
        }
        square += weight * value * value;
    }
    let fit = solve_small(&mut matrix, 3).ok_or_else(|| format!("too few rows for a sine of {periods} periods"))?;
    Ok((fit[1].hypot(fit[2]), square - (0..3).map(|k| fit[k] * right[k]).sum::<f64>()))
}

/// How many periods of the sine that fits best the span of the rows holds: one to fifty, to a thousandth.
fn best_periods(rows: &[[f64; 2]]) -> Result<f64, Problem> {
    let mut best = (f64::INFINITY, 1.0);
    // The misfit has valleys about one period wide.
    for (middle, width, steps) in [(Some(25.5), 24.5, 490), (None, 0.1, 200)] {
        let middle = middle.unwrap_or(best.1);
        for step in 0..=steps {
            let periods = middle + width * (2.0 * f64::from(step) / f64::from(steps) - 1.0);
            let left = sine(rows, periods)?.1;
            if left < best.0 {
                best = (left, periods);
            }
        }
    }
    Ok(best.1)
}

/// One number of a series of `[time, value]`, not empty.
fn pick(pick: Pick, rows: &[[f64; 2]], at: Option<f64>) -> Result<f64, Problem> {
    let (times, values): (Vec<f64>, Vec<f64>) = rows.iter().map(|row| (row[0], row[1])).unzip();
    let mean = time_mean(&times, &values).unwrap_or(f64::NAN);
    let max = || values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let min = || values.iter().copied().fold(f64::INFINITY, f64::min);
    let needed = || at.ok_or_else(|| "`at` is missing".to_owned());
    Ok(match pick {
        Pick::At => {
            let time = needed()?;
            interpolate(&times, &values, time).ok_or_else(|| format!("the run has no row at t = {time} s"))?
        }
        Pick::Last => values[values.len() - 1],
        Pick::Mean => mean,
        Pick::Integral => mean * (times[times.len() - 1] - times[0]),
        Pick::Max => max(),
        Pick::Min => min(),
        Pick::Linf => max().max(-min()),
        Pick::Amplitude => 0.5 * (max() - min()),
        Pick::Harmonic => match at {
            Some(periods) => sine(rows, periods)?.0,
            None => sine(rows, best_periods(rows)?)?.0,
        },
        Pick::Noise => {
            let squares: Vec<f64> = values.iter().map(|v| (v - mean) * (v - mean)).collect();
            time_mean(&times, &squares).unwrap_or(f64::NAN).sqrt()
        }
        Pick::Period => (times[times.len() - 1] - times[0]) / best_periods(rows)?,
        Pick::First => {
            let level = needed()?;
            crossing(rows, level).ok_or_else(|| format!("the value {level} is never reached"))?
        }
        Pick::Rise => rise(values.iter().copied()),
        Pick::Drift => {
            let tenth = (values.len() / 10).max(1);
            let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
            mean(&values[values.len() - tenth..]) - mean(&values[..tenth])
        }
    })
}

/// The value at `time`, between rows by a straight line.
fn interpolate(times: &[f64], values: &[f64], time: f64) -> Option<f64> {
    if !(*times.first()? <= time && time <= *times.last()?) {
        return None;
    }
    let k = times.partition_point(|&t| t < time);
    if times[k] == time {
        return Some(values[k]);
    }
    let share = (time - times[k - 1]) / (times[k] - times[k - 1]);
    Some(values[k - 1] + share * (values[k] - values[k - 1]))
}

/// Pairs of a CSV file of two columns with a header; lines that start with `#` are comments.
fn points(text: &str) -> Vec<[f64; 2]> {
    let rows = text.lines().filter(|line| !line.starts_with('#'));
    rows.filter_map(|line| {
        let (first, second) = line.split_once(',')?;
        Some([first.trim().parse().ok()?, second.trim().parse().ok()?])
    })
    .collect()
}

/// Value at `x` of the plane fitted to finite values within 2.6 spacings, weighted with a Wendland C2 kernel; `None` with fewer than
/// twice as many neighbours as unknowns.
fn fit(points: &[[f64; 3]], values: &[f64], x: [f64; 3], spacing: f64, dimension: usize) -> Option<f64> {
    let h = 1.3 * spacing;
    let order = dimension + 1;
    let (mut matrix, mut count) = ([[0.0; 5]; 4], 0);
    for (point, &value) in points.iter().zip(values) {
        let away: [f64; 3] = std::array::from_fn(|d| (point[d] - x[d]) / spacing);
        let distance = spacing * away.iter().map(|a| a * a).sum::<f64>().sqrt();
        if !value.is_finite() || distance >= 2.0 * h {
            continue;
        }
        let weight = Kernel::<2>::w(WendlandC2, distance, h) * spacing * spacing;
        let row = [1.0, away[0], away[1], away[2]];
        for i in 0..order {
            for j in 0..order {
                matrix[i][j] += weight * row[i] * row[j];
            }
            matrix[i][order] += weight * row[i] * value;
        }
        count += 1;
    }
    if count < 2 * order {
        return None;
    }
    solve_small(&mut matrix, order).map(|plane| plane[0])
}

/// Low end, high end and reference of a quantity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Band {
    /// What it should be.
    pub reference: Option<f64>,
    /// Lower end.
    pub low: Option<f64>,
    /// Upper end.
    pub high: Option<f64>,
}

impl Band {
    /// The band of `quantity` in the run `reading`; `own` is the reference that its measure gave.
    pub fn of(quantity: &Quantity, reading: &Reading, own: Option<f64>) -> Result<Self, Problem> {
        let reference = reading.optional(quantity.reference.as_ref())?.or(own);
        let (mut low, mut high) = (reading.optional(quantity.low.as_ref())?, reading.optional(quantity.high.as_ref())?);
        if let (Some(within), Some(reference)) = (quantity.within, reference) {
            let width = within * reference.abs();
            (low, high) = (low.or(Some(reference - width)), high.or(Some(reference + width)));
        }
        Ok(Self { reference, low, high })
    }

    /// Whether `value` lies inside; what has no band passes.
    pub fn holds(&self, value: Option<f64>) -> bool {
        match value {
            Some(value) => self.low.is_none_or(|low| value >= low) && self.high.is_none_or(|high| value <= high),
            None => self.low.is_none() && self.high.is_none(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SINE: usize = 1000;

    fn sine() -> Vec<[f64; 2]> {
        (0..=SINE).map(|i| 5.0 * i as f64 / SINE as f64).map(|t| [t, 1.0 + 0.3 * (2.0 * std::f64::consts::PI * t).sin()]).collect()
    }

    /// Five periods of a sine, sampled 200 times each: its numbers to the error of sampling, 1e-3.
    #[test]
    fn numbers_of_a_series() {
        for (which, at, expected) in [
            (Pick::Mean, None, 1.0),
            (Pick::Amplitude, None, 0.3),
            (Pick::Noise, None, 0.3 / 2.0_f64.sqrt()),
            (Pick::Period, None, 1.0),
            (Pick::Integral, None, 5.0),
            (Pick::At, Some(0.25), 1.3),
            (Pick::First, Some(1.3 - 1e-9), 0.25),
            (Pick::Rise, None, 0.6),
            (Pick::Min, None, 0.7),
            (Pick::Linf, None, 1.3),
            // A tenth is half a period: its means are 1 + 0.6/pi and 1 - 0.6/pi.
            (Pick::Drift, None, -1.2 / std::f64::consts::PI),
        ] {
            let value = pick(which, &sine(), at).unwrap();
            assert!((value - expected).abs() < 1e-3, "{which:?}: {value} instead of {expected}");
        }
        // Noise or not, a whole number of periods or not.
        let noisy: Vec<[f64; 2]> = sine().into_iter().enumerate().map(|(i, [t, y])| [t, y + 0.1 * [1.0, -1.0][i % 2]]).collect();
        assert!((pick(Pick::Harmonic, &noisy, Some(5.0)).unwrap() - 0.3).abs() < 1e-3);
        for rows in [&noisy[..], &noisy[..870]] {
            assert!((pick(Pick::Harmonic, rows, None).unwrap() - 0.3).abs() < 1e-3);
            assert!((pick(Pick::Period, rows, None).unwrap() - 1.0).abs() < 1e-3);
        }
        assert!(pick(Pick::At, &sine(), Some(6.0)).is_err() && pick(Pick::At, &sine(), None).is_err());
    }

    #[test]
    fn norms_of_values() {
        let values = [3.0, -4.0];
        for (norm, expected) in [
            (Norm::Sum, -1.0),
            (Norm::Mean, -0.5),
            (Norm::Max, 3.0),
            (Norm::Min, -4.0),
            (Norm::Linf, 4.0),
            (Norm::Rms, 12.5_f64.sqrt()),
            (Norm::L2, 0.5),
        ] {
            assert_eq!(reduce(norm, &values, 100.0), Ok(expected), "{norm:?}");
        }
        assert!(reduce(Norm::Sum, &[], 0.0).is_err());
        assert_eq!(over(Over::Trend, &[4.0, 2.0, 1.0, 0.5]), Ok(0.25));
        assert_eq!(over(Over::Rise, &[4.0, 2.0, 3.0, 1.0, 1.5]), Ok(1.0));
    }

    #[test]
    fn a_plane_is_fitted_exactly() {
        let points: Vec<[f64; 3]> = (0..100).map(|i| [0.1 * f64::from(i % 10), 0.1 * f64::from(i / 10), 0.0]).collect();
        let values: Vec<f64> = points.iter().map(|x| 2.0 - x[0] + 3.0 * x[1]).collect();
        let found = fit(&points, &values, [0.43, 0.27, 0.0], 0.1, 2).unwrap();
        assert!((found - (2.0 - 0.43 + 0.81)).abs() < 1e-12, "{found}");
        assert_eq!(fit(&points, &values, [5.0, 5.0, 0.0], 0.1, 2), None);
    }

    #[test]
    fn bands_hold_what_lies_inside() {
        let band = Band { reference: Some(1.0), low: Some(0.9), high: Some(1.1) };
        assert!(
            band.holds(Some(1.0)) && !band.holds(Some(1.2)) && !band.holds(Some(0.8)) && !band.holds(None) && !band.holds(Some(f64::NAN))
        );
        let shown = Band { reference: Some(1.0), low: None, high: None };
        assert!(shown.holds(Some(7.0)) && shown.holds(None));
        assert_eq!(points("# a\nT,Z\n0, 1\n2,3\n"), [[0.0, 1.0], [2.0, 3.0]]);
    }
}
