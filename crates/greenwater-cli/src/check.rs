//! `greenwater check`.

use std::path::PathBuf;

use clap::Args;
use greenwater::case::{AnySetup, Setup};
use greenwater::scheme::{MethodName, Preset};
use greenwater::with_setup;
use greenwater_report::flow::preview;
use greenwater_report::run::{Frame, Scales};
use serde_json::json;

use crate::console::{self, bytes, duration};
use crate::error::CliError;
use crate::run::{CaseArgs, method};

#[derive(Clone, Debug, Args)]
pub struct CheckArgs {
    #[command(flatten)]
    case: CaseArgs,
    /// Method, or method:preset; left out: that of the case
    #[arg(long, value_name = "METHOD", value_parser = method)]
    method: Option<(MethodName, Option<Preset>)>,
    /// Picture of the initial particles, .svg or .png; left out: an SVG file in the temporary folder
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Replace a picture that is already there
    #[arg(long)]
    force: bool,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

/// `greenwater check`.
pub fn check(args: &CheckArgs) -> Result<(), CliError> {
    let mut case = args.case.load()?;
    if let Some((method, preset)) = args.method {
        case = case.with_method(method, preset)?;
    }
    let setup = case.checked()?;
    let picture = draw(&setup, args)?;
    let estimate = setup.estimate();
    let audit = with_setup!(&setup, setup => setup.audit());
    let method = setup.method();
    if args.json {
        return console::print_json(&json!({
            "format": 1, "case": setup.name(), "title": setup.title(), "dimension": setup.dimension(), "method": method.method().name(),
            "preset": method.preset_name().name(), "estimate": estimate, "audit": audit, "preview": picture,
        }));
    }
    let known = |value: Option<String>| value.unwrap_or_else(|| "not known beforehand".to_owned());
    let mut lines = vec![
        format!("{}: ok", setup.title()),
        format!("method:    {} with preset {}", method.method().name(), method.preset_name().name()),
        format!("particles: {} fluid, {} wall, about {:.0} neighbours each", estimate.fluid, estimate.walls, estimate.neighbours),
        format!("geometry:  {}", audit.text),
        format!("memory:    about {}", bytes(estimate.memory_bytes)),
        format!("disk:      about {} before compression", bytes(estimate.disk_bytes)),
        format!("steps:     {}", known(estimate.steps.map(|steps| format!("about {steps:.0}")))),
        format!("time:      {}", known(estimate.seconds.map(|seconds| format!("about {} on one core", duration(seconds))))),
    ];
    lines.extend(audit.warnings.iter().map(|warning| format!("warning:   {warning}")));
    lines.push(format!("preview:   {}", picture.display()));
    console::print(&lines.join("\n"))
}

/// Draws the initial particles; gives the path of the picture.
fn draw(setup: &AnySetup, args: &CheckArgs) -> Result<PathBuf, CliError> {
    let path = args
        .out
        .clone()
        .unwrap_or_else(|| std::env::temp_dir().join(format!("greenwater-check-{}-{}.svg", setup.name(), std::process::id())));
    let is = |format: &str| path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case(format));
    let png = is("png");
    if !png && !is("svg") {
        return Err(CliError::NotAPicture { path });
    }
    let svg = with_setup!(setup, setup => picture(setup));
    let picture = if png { greenwater_report::png(setup.name(), &svg)? } else { svg.into_bytes() };
    crate::export::write_new(&path, &picture, args.force)?;
    Ok(path)
}

fn picture<const D: usize>(setup: &Setup<D>) -> String {
    let p = &setup.particles;
    let frame = Frame {
        points: p.x.iter().map(|x| std::array::from_fn(|d| x.0.get(d).copied().unwrap_or(0.0))).collect(),
        pressure: p.pressure.clone(),
        kind: p.kind.iter().map(|&kind| kind as u8).collect(),
    };
    let scales = Scales {
        rest_density: Some(setup.rest_density),
        gravity: Some(setup.gravity.norm()),
        height: Some(setup.depth),
        spacing: Some(setup.spacing),
        ..Scales::default()
    };
    preview(&setup.title, D, frame, &scales)
}
