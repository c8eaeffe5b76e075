//! The results of a validation: rows, table, JSON.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use super::error::ValidateError;
use super::measure::Band;
use super::suite::{Bands, Measure, Number, Quantity};

/// What became of one quantity.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// Its value, if it could be measured.
    pub value: Option<f64>,
    /// Its band.
    pub band: Band,
    /// Why it could not be measured.
    pub problem: Option<String>,
    /// Wall-clock time of the run, s.
    pub seconds: f64,
    /// Whether the value lies in its band.
    pub pass: bool,
}

impl Default for Outcome {
    fn default() -> Self {
        Self { value: None, band: Band { reference: None, low: None, high: None }, problem: None, seconds: f64::NAN, pass: false }
    }
}

/// A row of the results: one quantity of one run by one method.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub struct Row {
    /// Name of the case.
    pub case: String,
    /// Name of the method.
    pub method: String,
    /// Name of the run.
    pub run: String,
    /// Name of the quantity.
    pub quantity: String,
    /// Its unit.
    pub unit: String,
    /// Its value; null where it could not be measured.
    pub value: Option<f64>,
    /// What it should be.
    pub reference: Option<f64>,
    /// Lower end of the band; null: none.
    pub low: Option<f64>,
    /// Upper end of the band; null: none.
    pub high: Option<f64>,
    /// Whether the value lies in its band.
    pub pass: bool,
    /// Where reference and band come from.
    pub source: String,
    /// Wall-clock time of the run, s.
    pub seconds: Option<f64>,
    /// Why the value is missing.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub problem: Option<String>,
}

impl Row {
    /// The band in words.
    pub fn band(&self) -> String {
        match (self.low, self.high) {
            (Some(low), Some(high)) => format!("{} to {}", number(low), number(high)),
            (Some(low), None) => format!(">= {}", number(low)),
            (None, Some(high)) => format!("<= {}", number(high)),
            (None, None) => "shown".to_owned(),
        }
    }

    /// The value in words.
    pub fn said(&self) -> String {
        self.value.map_or_else(|| "none".to_owned(), number)
    }

    /// `pass`, `MISS`, or nothing where there is no band.
    pub fn verdict(&self) -> &'static str {
        match (self.low, self.high) {
            (None, None) if self.pass => "",
            _ if self.pass => "pass",
            _ => "MISS",
        }
    }
}

/// A number with four significant digits.
pub fn number(value: f64) -> String {
    let size = value.abs();
    if value == 0.0 {
        "0".to_owned()
    } else if (1e-3..1e5).contains(&size) {
        let digits = (3 - size.log10().floor() as i32).clamp(0, 8) as usize;
        let text = format!("{value:.digits$}");
        if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
    } else {
        format!("{value:.3e}")
    }
}

/// All rows.
#[derive(Clone, Debug, Default)]
pub struct Results {
    /// In the order of cases, quantities, runs and methods.
    pub rows: Vec<Row>,
}

impl Results {
    /// Adds what became of a quantity.
    pub fn add(&mut self, case: &str, method: &str, run: &str, name: &str, quantity: &Quantity, outcome: Outcome) {
        self.rows.push(Row {
            case: case.to_owned(),
            method: method.to_owned(),
            run: run.to_owned(),
            quantity: name.to_owned(),
            unit: quantity.unit.clone(),
            value: outcome.value,
            reference: outcome.band.reference,
            low: outcome.band.low,
            high: outcome.band.high,
            pass: outcome.pass,
            source: quantity.source.clone(),
            seconds: Some(outcome.seconds).filter(|seconds| seconds.is_finite()),
            problem: outcome.problem,
        });
    }

    /// Adds the quantities that compare methods: the largest relative difference from the mean of all methods of this call.
    pub fn between_methods(&mut self, case: &str, bands: &Bands, known: &BTreeMap<(String, String, String), f64>) {
        for quantity in &bands.quantity {
            let Measure::Methods { of } = &quantity.measure else { continue };
            for run in bands.run.iter().filter(|run| quantity.runs.is_empty() || quantity.runs.contains(&run.name)) {
                let values: Vec<f64> =
                    known.iter().filter(|((name, in_run, _), _)| name == of && *in_run == run.name).map(|(_, v)| *v).collect();
                if values.len() < 2 {
                    continue;
                }
                let mean = values.iter().sum::<f64>() / values.len() as f64;
                let spread = values.iter().map(|value| (value - mean).abs()).fold(0.0, f64::max);
                let plain = |number: &Option<Number>| match number {
                    Some(Number::Plain(value)) => Some(*value),
                    _ => None,
                };
                let band = Band { reference: plain(&quantity.reference), low: plain(&quantity.low), high: plain(&quantity.high) };
                let value = Some(spread / mean.abs());
                let outcome = Outcome { value, band, pass: band.holds(value), ..Outcome::default() };
                let name = if bands.run.len() > 1 { format!("{} ({})", quantity.name, run.name) } else { quantity.name.clone() };
                self.add(case, "all", &run.name, &name, quantity, outcome);
            }
        }
    }

    /// Takes in other results. Those of a case, method and run that are there already are replaced.
    pub fn take_in(&mut self, other: Self) {
        let same = |a: &Row, b: &Row| a.case == b.case && a.method == b.method && a.run == b.run;
        self.rows.retain(|row| !other.rows.iter().any(|new| same(row, new)));
        self.rows.extend(other.rows);
    }

    /// Reads what [`json`](Self::json) wrote.
    pub fn read(path: &Path) -> Result<Self, ValidateError> {
        let wrong = |problem: String| ValidateError::Results { path: path.to_owned(), problem };
        let text = fs::read_to_string(path).map_err(|e| wrong(e.to_string()))?;
        let mut value: Value = serde_json::from_str(&text).map_err(|e| wrong(e.to_string()))?;
        if value["format"] != 1 {
            return Err(wrong(format!("its format is {}, but must be 1", value["format"])));
        }
        let mut rows: Vec<Row> = serde_json::from_value(value["results"].take()).map_err(|e| wrong(e.to_string()))?;
        for row in &mut rows {
            row.pass = Band { reference: row.reference, low: row.low, high: row.high }.holds(row.value) && row.problem.is_none();
        }
        Ok(Self { rows })
    }

    /// For scripts.
    pub fn json(&self) -> Value {
        json!({"format": 1, "version": env!("CARGO_PKG_VERSION"), "results": self.rows})
    }

    /// Number of quantities that have a band.
    pub fn banded(&self) -> usize {
        self.rows.iter().filter(|row| !row.verdict().is_empty()).count()
    }

    /// Number of values outside their bands.
    pub fn missed(&self) -> usize {
        self.rows.iter().filter(|row| !row.pass).count()
    }

    /// For people.
    pub fn table(&self) -> String {
        let head = ["case", "method", "quantity", "value", "band", "unit", ""].map(str::to_owned);
        let row = |row: &Row| {
            let verdict = row.problem.as_ref().map_or(row.verdict().to_owned(), |problem| format!("{} {problem}", row.verdict()));
            [row.case.clone(), row.method.clone(), row.quantity.clone(), row.said(), row.band(), row.unit.clone(), verdict]
        };
        let rows: Vec<[String; 7]> = std::iter::once(head).chain(self.rows.iter().map(row)).collect();
        let width = |k: usize| rows.iter().map(|cells| cells[k].chars().count()).max().unwrap_or(0);
        let widths: [usize; 7] = std::array::from_fn(width);
        let mut lines: Vec<String> = rows
            .iter()
            .map(|cells| {
                let padded: Vec<String> = cells.iter().zip(widths).map(|(cell, width)| format!("{cell:width$}")).collect();
                padded.join("  ").trim_end().to_owned()
            })
            .collect();
        let banded = self.banded();
        lines.push(format!("{} of {banded} quantities with a band are inside it", banded - self.missed()));
        lines.join("\n")
    }
}
