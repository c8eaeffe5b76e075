//! Results as numbers: what repeated measurements say, power laws, and the JSON that scripts read.

use std::borrow::Cow;
use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

/// Least, median and greatest of repeated times, s.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Seconds {
    /// Least: the one to compare on a machine that does other things too.
    pub min: f64,
    /// Median.
    pub median: f64,
    /// Greatest.
    pub max: f64,
}

impl Seconds {
    /// Of at least one time; all zero for none.
    pub fn of(times: &[f64]) -> Self {
        let mut sorted = times.to_vec();
        sorted.sort_by(f64::total_cmp);
        match sorted.as_slice() {
            [] => Self { min: 0.0, median: 0.0, max: 0.0 },
            [min, ..] => {
                let n = sorted.len();
                Self { min: *min, median: 0.5 * (sorted[(n - 1) / 2] + sorted[n / 2]), max: sorted[n - 1] }
            }
        }
    }
}

/// One row of `results`; what does not apply is left out.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Record {
    /// `neighbors`, `poisson`, `step`, `second`, `impact` or `flow`.
    pub bench: Cow<'static, str>,
    /// What was worked on.
    pub workload: String,
    /// How.
    pub method: String,
    /// Dimensions of space.
    pub dimension: u32,
    /// Particles; rows of a matrix.
    pub particles: usize,
    /// Threads.
    pub threads: usize,
    /// Time of one search, one solve, one step.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub seconds: Option<Seconds>,
    /// How many were timed.
    pub repetitions: usize,
    /// Particles times steps over seconds.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub particle_steps_per_s: Option<f64>,
    /// Pairs within the support of the kernel over the least time: listed, or gone through by the pair loops of an evaluation, by each of
    /// them once.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pair_evaluations_per_s: Option<f64>,
    /// Memory of what is measured, over particles.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bytes_per_particle: Option<f64>,
    /// Iterations of a solve; their mean over steps.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub iterations: Option<f64>,
    /// How many times faster than the plain way on one thread: the plain pair loop, the plain list, Jacobi-CG; for the paper the direct
    /// search and Gauss.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ratio_to_naive: Option<f64>,
    /// Seconds of all repetitions by phase.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub phases: BTreeMap<Cow<'static, str>, f64>,
    /// Keys that only one kind of row has.
    #[serde(flatten)]
    pub extra: Map<String, Value>,
}

/// The JSON file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Document {
    format: u32,
    program: Cow<'static, str>,
    version: Cow<'static, str>,
    /// The rows.
    pub results: Vec<Record>,
    /// Keys beside them: machine, commit, date.
    #[serde(flatten)]
    pub extra: Map<String, Value>,
}

/// The format of the file.
const FORMAT: u32 = 1;

impl Document {
    /// A file with these rows, and `extra` keys beside them.
    pub fn new(results: Vec<Record>, extra: Map<String, Value>) -> Self {
        Self { format: FORMAT, program: "greenwater".into(), version: env!("CARGO_PKG_VERSION").into(), results, extra }
    }

    /// Reads a file.
    ///
    /// # Errors
    /// A sentence: not JSON, another format, missing keys.
    pub fn parse(text: &str) -> Result<Self, String> {
        let document: Self = serde_json::from_str(text).map_err(|error| error.to_string())?;
        if document.format == FORMAT { Ok(document) } else { Err(format!("`format` is {}, but must be {FORMAT}", document.format)) }
    }

    /// The file on one line.
    pub fn line(&self) -> String {
        serde_json::to_string(self).unwrap_or_default()
    }

    /// The file.
    pub fn text(&self) -> String {
        // Strings and numbers only: serialising cannot fail, and a number that is not finite becomes null.
        let mut text = serde_json::to_string_pretty(self).unwrap_or_default();
        text.push('\n');
        text
    }
}

/// Exponent `k` of the power law `y = c x^k` that fits best: the slope of the least-squares line through the logarithms.
/// `None` for fewer than two different, positive `x`.
pub fn exponent(points: impl IntoIterator<Item = (f64, f64)>) -> Option<f64> {
    let logs: Vec<(f64, f64)> = points.into_iter().filter(|&(x, y)| x > 0.0 && y > 0.0).map(|(x, y)| (x.ln(), y.ln())).collect();
    let n = logs.len() as f64;
    let (x_mean, y_mean) = (logs.iter().map(|p| p.0).sum::<f64>() / n, logs.iter().map(|p| p.1).sum::<f64>() / n);
    let spread: f64 = logs.iter().map(|p| (p.0 - x_mean) * (p.0 - x_mean)).sum();
    let both: f64 = logs.iter().map(|p| (p.0 - x_mean) * (p.1 - y_mean)).sum();
    (spread > 0.0).then(|| both / spread)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_exponent_of_an_exact_power_law_is_found() {
        for k in [-0.5f64, 1.0, 1.9, 3.0] {
            let fitted = exponent([1.0f64, 3.0, 10.0, 500.0].map(|x| (x, 7.0 * x.powf(k)))).expect("four points");
            // 1e-12: round-off of a handful of logarithms.
            assert!((fitted - k).abs() < 1e-12, "{fitted} for {k}");
        }
        assert_eq!(exponent([(2.0, 1.0), (2.0, 3.0)]), None);
        assert_eq!(exponent([]), None);
    }

    #[test]
    fn times_are_sorted_into_least_median_and_greatest() {
        assert_eq!(Seconds::of(&[3.0, 1.0, 2.0]), Seconds { min: 1.0, median: 2.0, max: 3.0 });
        assert_eq!(Seconds::of(&[3.0, 1.0]).median, 2.0);
    }

    #[test]
    fn a_file_names_its_format_and_leaves_out_what_does_not_apply() {
        let record = Record { bench: "poisson".into(), seconds: Some(Seconds::of(&[1.0])), iterations: Some(4.0), ..Record::default() };
        let json: Value = serde_json::from_str(&Document::new(vec![record], Map::new()).text()).expect("JSON");
        assert_eq!(json["format"], 1);
        assert_eq!(json["results"][0]["seconds"]["median"], 1.0);
        assert_eq!(json["results"][0]["iterations"], 4.0);
        assert!(json["results"][0].get("phases").is_none() && json["results"][0].get("ratio_to_naive").is_none());
    }
}
