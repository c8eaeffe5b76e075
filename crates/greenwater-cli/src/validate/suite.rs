//! What a validation case says: its runs, and the quantities with their references and bands. Data, read from `bands.toml`.

use std::collections::BTreeMap;

use greenwater::scheme::MethodName;
use serde::Deserialize;

use super::error::ValidateError;

/// A validation case as it comes with the program.
#[derive(Clone, Copy, Debug)]
pub struct Shipped {
    /// Its name on the command line, and of its folder in `validation/`.
    pub name: &'static str,
    /// Its `case.toml`.
    pub case: &'static str,
    /// Its `bands.toml`.
    pub bands: &'static str,
    /// Its `README.md`.
    pub readme: &'static str,
    /// Its tables of reference values: name and text.
    pub tables: &'static [(&'static str, &'static str)],
}

macro_rules! shipped {
    ($($name:literal: [$($table:literal),*]),* $(,)?) => {
        &[$(Shipped {
            name: $name,
            case: include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/../../validation/", $name, "/case.toml")),
            bands: include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/../../validation/", $name, "/bands.toml")),
            readme: include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/../../validation/", $name, "/README.md")),
            tables: &[$(($table, include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/../../validation/", $name, "/", $table)))),*],
        }),*]
    };
}

/// The validation cases, in the order in which they run.
pub static CASES: &[Shipped] = shipped! {
    "free-fall": [],
    "hydrostatic": [],
    "hydrostatic-3d": [],
    "wedge": [],
    "poiseuille": [],
    "couette": [],
    "taylor-green": [],
    "lid-cavity": [],
    "rotating-square": [],
    "elliptic-drop": [],
    "standing-wave": [],
    "solitary-wave": [],
    "sloshing": ["side.csv", "tank.csv"],
    "hydraulic-jump": [],
    "colliding-patches": [],
    "jet": [],
    "dam-break-front": ["martin-moyce-n1.csv", "martin-moyce-n2.csv", "koshizuka.csv"],
    "dam-break-noise": [],
    "dam-break-long": [],
    "dam-break-3d": [],
    "cylinder": [],
    "dam-break-impact": ["p1.csv", "p2.csv", "p3.csv", "p4.csv", "buchner.csv", "zhou-h1.csv", "zhou-h2.csv"],
};

/// What `bands.toml` says.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Bands {
    /// One line about the case.
    pub title: String,
    /// Names for formulas. Known in every case: `dx`, `g`, `rho0`, and `H`, `L`, the height and width of the fluid at the start.
    #[serde(default)]
    pub constants: BTreeMap<String, Number>,
    /// The runs.
    pub run: Vec<RunPlan>,
    /// What is measured.
    pub quantity: Vec<Quantity>,
}

/// A run of a case.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RunPlan {
    /// Its name, unique in the case.
    pub name: String,
    /// Whether it is short enough for `--quick`.
    #[serde(default)]
    pub quick: bool,
    /// The methods that make it; left out: all.
    #[serde(default)]
    pub methods: Vec<MethodName>,
    /// Keys of the case that it sets; those of `method` count for the method that `method.name` says.
    #[serde(default)]
    pub set: BTreeMap<String, toml::Value>,
}

impl RunPlan {
    /// Whether `method` makes it.
    pub fn makes(&self, method: MethodName) -> bool {
        self.methods.is_empty() || self.methods.contains(&method)
    }
}

/// A number, or a formula of the constants of the case.
#[derive(Clone, Debug, Deserialize)]
#[serde(untagged)]
pub enum Number {
    /// As it is.
    Plain(f64),
    /// A formula of constants.
    Formula(String),
}

/// A quantity with its reference and its band.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Quantity {
    /// Its name, unique in the case.
    pub name: String,
    /// Its unit; `1` for pure numbers.
    pub unit: String,
    /// The runs in which it is measured; left out: all.
    #[serde(default)]
    pub runs: Vec<String>,
    /// The methods it is measured of, where families of methods owe different things; left out: all.
    #[serde(default)]
    pub methods: Vec<MethodName>,
    /// What it should be; left out where the measure gives its own reference.
    pub reference: Option<Number>,
    /// Lower end of the band.
    pub low: Option<Number>,
    /// Upper end of the band.
    pub high: Option<Number>,
    /// The band as a share of the reference, either way.
    pub within: Option<f64>,
    /// Where reference and band come from.
    pub source: String,
    /// How it is measured.
    pub measure: Measure,
}

/// How a quantity is measured.
#[derive(Clone, Debug, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum Measure {
    /// A reduction over the fluid particles of frames.
    Field(Field),
    /// A quantity along a line through a frame.
    Line(Line),
    /// A number of a column of a table.
    Series(Series),
    /// A column of a table against a curve.
    Curve(Curve),
    /// A number of `summary.json`: its key, nested keys with dots.
    Summary(String),
    /// Order of convergence: `ln(coarse/fine) / ln(ratio)` of a quantity in two runs.
    Order {
        /// Name of the quantity, an error.
        of: String,
        /// Name of the coarse run.
        coarse: String,
        /// Name of the fine run.
        fine: String,
        /// Coarse spacing over fine spacing.
        ratio: f64,
    },
    /// Relative difference of a quantity between two runs, `|a - b| / |b|`.
    Change {
        /// Name of the quantity.
        of: String,
        /// Name of one run.
        from: String,
        /// Name of the other run.
        to: String,
    },
    /// A quantity over another of the same run.
    Ratio {
        /// Name of the quantity.
        of: String,
        /// Name of what it is divided by.
        over: String,
    },
    /// Largest relative difference of a quantity from that of the other methods in this call.
    Methods {
        /// Name of the quantity.
        of: String,
    },
}

/// A reduction over the fluid particles of frames. Formulas know `x y z u v w p rho m t` of a particle and the constants.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Field {
    /// What is reduced.
    pub value: String,
    /// What it should be; `value - exact` is reduced then.
    pub exact: Option<String>,
    /// Particles count where this is above 0; left out: all.
    #[serde(rename = "where")]
    pub only: Option<String>,
    /// How the particles of a frame are reduced.
    pub norm: Norm,
    /// What the result is divided by; left out: 1, or the norm of `exact` for `l2`.
    pub scale: Option<Number>,
    /// The frame nearest to this time, s; left out with `from` and `to`: the last.
    pub at: Option<Number>,
    /// Frames from here, s.
    pub from: Option<Number>,
    /// Frames to here, s.
    pub to: Option<Number>,
    /// How frames are reduced; left out: the last of them.
    #[serde(default)]
    pub over: Over,
    /// Whether the result is divided by that of the first frame.
    #[serde(default)]
    pub relative_to_start: bool,
    /// Whether that of the first frame is taken away.
    #[serde(default)]
    pub less_start: bool,
}

/// How values of particles become one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Norm {
    /// Their sum.
    Sum,
    /// Their mean.
    Mean,
    /// The greatest.
    Max,
    /// The least.
    Min,
    /// The greatest in size.
    Linf,
    /// Root of the mean of squares.
    Rms,
    /// Root of the sum of squares over that of `exact`.
    L2,
    /// First percentile.
    P01,
    /// 99th percentile.
    P99,
}

/// How values of frames become one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Over {
    /// The last.
    #[default]
    Last,
    /// The greatest.
    Max,
    /// The least.
    Min,
    /// The mean.
    Mean,
    /// Mean of the second half over mean of the first half.
    Trend,
    /// Greatest rise above what was the least before.
    Rise,
}

/// A quantity along a line through a frame, from a local linear fit.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Line {
    /// Start, m.
    pub from: Vec<Number>,
    /// End, m.
    pub to: Vec<Number>,
    /// The quantity: a formula as in `field`.
    pub value: String,
    /// `max`, `min`, `mean`, or `l2` of the difference from `exact`.
    pub norm: Norm,
    /// What it should be.
    pub exact: Option<String>,
    /// What the result is divided by.
    pub scale: Option<Number>,
    /// Time of the frame, s; left out: the last.
    pub at: Option<Number>,
}

/// A number of a column of a table.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Series {
    /// Name of the table, without `.csv`.
    pub table: String,
    /// Name of the column.
    pub column: String,
    /// Which number.
    pub pick: Pick,
    /// From here, s.
    pub from: Option<Number>,
    /// To here, s.
    pub to: Option<Number>,
    /// A time (`at`), a value (`first`) or a number of periods (`harmonic`).
    pub at: Option<Number>,
    /// What the result is divided by; left out: 1.
    pub scale: Option<Number>,
    /// What is taken away before that; left out: 0.
    pub less: Option<Number>,
}

/// Which number of a series.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Pick {
    /// The value at the time `at`, between rows by a straight line.
    At,
    /// The last value.
    Last,
    /// The mean over time.
    Mean,
    /// The integral over time.
    Integral,
    /// The greatest.
    Max,
    /// The least.
    Min,
    /// The greatest in size.
    Linf,
    /// Half of the difference between greatest and least.
    Amplitude,
    /// Amplitude of the sine of which the span of the rows holds `at` periods; left out: of the one that fits best.
    Harmonic,
    /// Root of the mean square departure from the mean.
    Noise,
    /// Period of the sine that fits best, of one to fifty periods.
    Period,
    /// The time at which the value `at` is first reached.
    First,
    /// Greatest rise above what was the least before.
    Rise,
    /// Mean of the last tenth of the rows less that of the first tenth.
    Drift,
}

/// A column of a table against a curve, in the scaled variables of the curve.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Curve {
    /// Name of the table, without `.csv`.
    pub table: String,
    /// Name of the column.
    pub column: String,
    /// The curve: name of a table of the case with two columns.
    pub curve: String,
    /// Scaled time over time, 1/s.
    pub time_scale: Number,
    /// Scaled value over value.
    pub value_scale: Number,
    /// Times of the run count from when it first reaches this scaled value; left out: from its start.
    pub align: Option<f64>,
    /// Which number.
    pub pick: CurvePick,
    /// Start of the window, scaled time.
    pub from: Option<f64>,
    /// End of the window, scaled time.
    pub to: Option<f64>,
    /// A scaled value.
    pub level: Option<f64>,
}

/// Which number of a comparison with a curve.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum CurvePick {
    /// The mean of the run over the window; that of the curve is the reference.
    Mean,
    /// The integral over the window; that of the curve is the reference.
    Integral,
    /// The scaled time of `level`; that of the curve is the reference.
    Arrival,
    /// Root mean square difference over the points of the curve in the window; the reference is 0.
    Difference,
    /// Mean lead in time over the levels that both reach, percent of the curve's time.
    Lead,
}

impl Shipped {
    /// Its bands, read and checked.
    ///
    /// # Errors
    /// The file does not hold what it should; a test reads every shipped one.
    pub fn read(&self) -> Result<Bands, ValidateError> {
        read(self.name, self.bands)
    }
}

/// Reads the bands of the case `name`.
pub fn read(name: &str, text: &str) -> Result<Bands, ValidateError> {
    let broken = |problem: String| ValidateError::Bands { case: name.to_owned(), problem };
    let bands: Bands = toml::from_str(text).map_err(|e| broken(e.to_string()))?;
    for (i, run) in bands.run.iter().enumerate() {
        if bands.run[..i].iter().any(|other| other.name == run.name) {
            return Err(broken(format!("two runs are called `{}`", run.name)));
        }
    }
    for (i, quantity) in bands.quantity.iter().enumerate() {
        if bands.quantity[..i].iter().any(|other| other.name == quantity.name) {
            return Err(broken(format!("two quantities are called `{}`", quantity.name)));
        }
        if let Some(unknown) = quantity.runs.iter().find(|name| bands.run.iter().all(|run| run.name != **name)) {
            return Err(broken(format!("`{}` names the run `{unknown}`, which there is not", quantity.name)));
        }
    }
    Ok(bands)
}

#[cfg(test)]
mod tests {
    use super::*;
    use greenwater::case::Case;

    #[test]
    fn every_shipped_case_reads_and_checks() {
        for shipped in CASES {
            let bands = shipped.read().unwrap_or_else(|e| panic!("{e}"));
            assert!(shipped.readme.starts_with("# ") && shipped.readme.contains("Source"), "{}: README.md", shipped.name);
            for run in &bands.run {
                let set: Vec<(String, String)> = run.set.iter().map(|(key, value)| (key.clone(), value.to_string())).collect();
                let case =
                    Case::parse(shipped.name, shipped.case.to_owned(), None, &set).unwrap_or_else(|e| panic!("{}: {e}", shipped.name));
                if let Err(error) = case.checked() {
                    panic!("{}, run {}: {error}", shipped.name, run.name);
                }
            }
        }
    }

    /// Force (over ρ g h²) on a tank that sways and pressure (over ρ g h) on its left side 0.1 m above the floor: formulas in `validation/sloshing/README.md`.
    fn swaying(t: f64) -> (f64, f64) {
        let (g, width, depth, amplitude, w) = (9.81, 1.0, 0.3, 0.01, 3.3);
        let push = amplitude * w * w * f64::cos(w * t);
        let (mut force, mut pressure) = (push, g * (depth - 0.1));
        for n in (1..=41).step_by(2) {
            let k = f64::from(n) * std::f64::consts::PI / width;
            let (own, a) = ((g * k * (k * depth).tanh()).sqrt(), -4.0 / (k * k * width));
            let c = -own * own * a * amplitude * w * w / (g * (own * own - w * w));
            let level = c * ((w * t).cos() - (own * t).cos());
            force -= c * (own * own * (own * t).cos() - w * w * (w * t).cos()) * 2.0 / (k * k * width * depth);
            pressure += (g * level + push * a) * (0.1 * k).cosh() / (depth * k).cosh() - push * a;
        }
        (-force * width / (g * depth), pressure / (g * depth))
    }

    /// To the five digits of the tables.
    #[test]
    fn tables_of_sloshing_are_those_of_the_theory() {
        let shipped = CASES.iter().find(|case| case.name == "sloshing").unwrap();
        for (name, text) in shipped.tables {
            let rows = text.lines().skip(2).map(|line| line.split_once(',').unwrap());
            let mut count = 0;
            for (t, value) in rows {
                let (force, pressure) = swaying(t.parse().unwrap());
                let exact = if *name == "tank.csv" { force } else { pressure };
                assert!((value.parse::<f64>().unwrap() - exact).abs() <= 0.501e-5, "{name}, t = {t} s: {value} instead of {exact}");
                count += 1;
            }
            assert_eq!(count, 121);
        }
    }

    #[test]
    fn doubled_and_unknown_names_are_refused() {
        let good = "title = \"t\"\n[[run]]\nname = \"a\"\n[[quantity]]\nname = \"q\"\nunit = \"1\"\nsource = \"s\"\nmeasure = { summary = \"steps\" }\n";
        assert!(read("c", good).is_ok());
        for wrong in [
            good.replace("[[quantity]]", "[[run]]\nname = \"a\"\n[[quantity]]"),
            good.replace("unit", "runs = [\"b\"]\nunit"),
            good.replace("summary", "sumary"),
            good.replace("unit", "units"),
        ] {
            assert!(read("c", &wrong).is_err(), "{wrong}");
        }
    }
}
