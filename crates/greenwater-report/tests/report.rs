//! Whole reports from synthetic run folders.

mod common;

use std::fs;
use std::path::PathBuf;

use common::{PRESSURE, Synthetic, scratch, vtp};
use greenwater_report::run::Run;
use greenwater_report::{ReportError, write_report};
use serde_json::Value;

fn pair(name: &str) -> (PathBuf, Vec<PathBuf>) {
    pair_of(name, 12)
}

/// Two runs with so many particles over the width of the column.
fn pair_of(name: &str, columns: usize) -> (PathBuf, Vec<PathBuf>) {
    let dir = scratch(name);
    let wcsph = Synthetic { columns, pace: 0.9, noise: 0.056, ..Synthetic::new("wcsph") };
    let isph = Synthetic { columns, pace: 0.85, noise: 0.004, ..Synthetic::new("isph-paper") };
    let runs = vec![wcsph.write(&dir.join("wcsph")), isph.write(&dir.join("isph-paper"))];
    (dir, runs)
}

fn json(path: &std::path::Path) -> Value {
    serde_json::from_str(&fs::read_to_string(path).unwrap()).unwrap()
}

#[test]
fn a_report_holds_a_page_numbers_and_figures_that_decode() {
    // 3200 fluid particles, as in the finest of the shipped sizes.
    let (dir, runs) = pair_of("complete", 40);
    let paths = write_report(&runs, &dir.join("report")).unwrap();
    let html = fs::read_to_string(&paths.html).unwrap();
    assert!(html.len() < 6_000_000, "page of {} bytes", html.len());
    // XML without a DOCTYPE is what roxmltree reads; the page is written to be both.
    roxmltree::Document::parse(html.trim_start_matches("<!DOCTYPE html>")).expect("the page is well formed");
    let resources = html.replace("xmlns=\"http://www.w3.org/2000/svg\"", "");
    assert!(!resources.contains("http://") && !resources.contains("https://"), "the page refers to the network");
    assert!(!html.contains("<shifting>"), "text of a run was not escaped");
    for name in ["flow", "front", "probe-1-p1", "energy-wcsph", "density", "pressure-noise", "cost", "time-step"] {
        for extension in ["svg", "png"] {
            let path = dir.join(format!("report/figures/{name}.{extension}"));
            assert!(paths.figures.contains(&path), "{} is not listed", path.display());
        }
    }
    let front = fs::read_to_string(dir.join("report/figures/front.svg")).unwrap();
    assert!(front.contains("Made-up experiment, with its spread") && front.contains("fill-opacity=\"0.18\""), "the spread is not drawn");
    for path in &paths.figures {
        let bytes = fs::read(path).unwrap();
        if path.extension().is_some_and(|e| e == "png") {
            let picture = resvg::tiny_skia::Pixmap::decode_png(&bytes).expect("the PNG decodes");
            let dark = picture.pixels().iter().filter(|p| p.red() < 80 && p.green() < 90 && p.blue() < 100).count();
            assert!(dark > 200, "{}: {dark} dark pixels, so text is missing", path.display());
        } else {
            roxmltree::Document::parse(std::str::from_utf8(&bytes).unwrap()).expect("the SVG is well formed");
        }
    }
    let left: Vec<_> = fs::read_dir(dir.join("report")).unwrap().flatten().map(|e| e.file_name()).collect();
    assert_eq!(left.len(), 3, "temporary files were left: {left:?}");
}

#[test]
fn report_json_states_what_the_series_hold() {
    let (dir, runs) = pair("numbers");
    let report = json(&write_report(&runs, &dir.join("report")).unwrap().json);
    assert_eq!(report["format"], 1);
    let wcsph = &report["methods"][0];
    assert_eq!((wcsph["name"].as_str(), wcsph["steps"].as_u64()), (Some("wcsph"), Some(4000)));
    assert_eq!(wcsph["front"][0], serde_json::json!([0.0, 0.75]));
    assert_eq!(wcsph["lost_particles"], 0);
    let near = |value: &Value, expected: f64, tolerance: f64| {
        let value = value.as_f64().unwrap();
        assert!((value - expected).abs() <= tolerance, "{value}, expected {expected} within {tolerance}");
    };
    // Written as 8000 at the start and 4000 * 0.2 + 8000 * 0.3 + 10 at the end.
    near(&wcsph["energy"]["initial"], 8000.0, 1e-9);
    near(&wcsph["energy"]["final"], 3210.0, 1e-9);
    // The peak of 1.2 rho g H carries the speckle of 0.056.
    near(&wcsph["probes"]["P1"]["peak"], 1.2 * PRESSURE, 0.06 * PRESSURE);
    near(&wcsph["probes"]["P1"]["peak_time"], 0.75, 0.03);
    // A front that runs as T / pace leads by 100 (1 - pace) % at every level; linear interpolation of the
    // reference (every 0.2 in T) shifts a crossing by at most 1.2 % at Z = 1.5.
    for (method, lead) in [(0, 10.0), (1, 15.0)] {
        let leads = report["methods"][method]["leads"].as_array().unwrap();
        assert_eq!(leads.len(), 5, "Z = 1.5 ... 3.5");
        for entry in leads {
            near(&entry["lead_percent"], lead, 1.2);
        }
    }
    let checks = report["acceptance"].as_array().unwrap();
    assert_eq!(checks.len(), 6, "finished, lost particles and lead for two methods");
    assert!(checks.iter().all(|check| check["pass"] == true), "{checks:?}");
    let headline = report["findings"][1]["headline"].as_str().unwrap();
    assert_eq!(headline, "The isph-paper pressure is 14 times smoother than that of wcsph: noise 0.004 against 0.056 of \u{3c1}gH");
}

#[test]
fn a_lead_beyond_the_band_fails_its_check() {
    let dir = scratch("too-early");
    let run = Synthetic { pace: 0.7, ..Synthetic::new("wcsph") }.write(&dir.join("wcsph"));
    let report = json(&write_report(&[run], &dir.join("report")).unwrap().json);
    let check = &report["acceptance"].as_array().unwrap()[2];
    assert_eq!(check["pass"], false, "{check}");
}

#[test]
fn a_failed_run_is_shown_up_to_its_last_frame_with_its_error() {
    let (dir, mut runs) = pair("failed");
    runs.push(Synthetic { failed: true, end: 0.5, ..Synthetic::new("isph-exact") }.write(&dir.join("isph-exact")));
    let paths = write_report(&runs, &dir.join("report")).unwrap();
    let html = fs::read_to_string(paths.html).unwrap();
    assert!(html.contains("isph-exact stopped early: velocity of particle 17 is not finite"));
    assert!(html.contains("last frame; 0.65 s was asked"));
    assert!(html.contains("the run ended at 0.5 s"));
    let report = json(&paths.json);
    assert_eq!(report["methods"][2]["completed"], false);
    assert_eq!(report["acceptance"].as_array().unwrap().iter().filter(|c| c["pass"] == false).count(), 1);
}

#[test]
fn a_run_with_nothing_but_provenance_gives_sentences_and_no_panic() {
    let dir = scratch("bare");
    let run = Synthetic::new("wcsph").write(&dir.join("wcsph"));
    for file in ["summary.json", "energy.csv", "front.csv", "probes.csv", "quality.csv", "steps.csv", "DONE"] {
        fs::remove_file(run.join(file)).unwrap();
    }
    fs::remove_dir_all(run.join("frames")).unwrap();
    fs::write(run.join("provenance.json"), r#"{"format": 1, "method": "wcsph"}"#).unwrap();
    let paths = write_report(&[run], &dir.join("report")).unwrap();
    let html = fs::read_to_string(paths.html).unwrap();
    assert!(html.contains("energy.csv is missing"));
    assert!(html.contains("No frames were stored"));
    assert!(json(&paths.json)["methods"][0]["pressure_noise"].is_null());
}

#[test]
fn bad_cells_broken_frames_and_short_files_are_survived() {
    let (dir, runs) = pair("broken");
    fs::write(runs[0].join("front.csv"), "time [s],front [m],residual_height [m]\n0,0.75,1.5\n0.1,NaN,inf\n0.2,abc\n0.3,1.2,1.0\n")
        .unwrap();
    fs::write(runs[0].join("energy.csv"), "time [s],kinetic [J/m]\n").unwrap();
    fs::write(runs[0].join("summary.json"), "{ not json").unwrap();
    fs::write(runs[0].join("quality.csv"), "").unwrap();
    fs::write(runs[0].join("frames/frame-000000.vtp"), "<VTKFile type=\"PolyData\"><Piece").unwrap();
    fs::remove_file(runs[0].join("frames/frame-000001.vtp")).unwrap();
    fs::write(runs[1].join("frames/frames.pvd"), "<VTKFile><Collection/></VTKFile>").unwrap();
    let paths = write_report(&runs, &dir.join("report")).unwrap();
    let html = fs::read_to_string(paths.html).unwrap();
    roxmltree::Document::parse(html.trim_start_matches("<!DOCTYPE html>")).expect("the page is well formed");
    assert!(html.contains("summary.json cannot be understood"));
    assert!(html.contains("front.csv has 2 cells that are not finite"));
}

#[test]
fn a_path_that_is_no_run_folder_is_an_error_with_its_cure() {
    let (dir, runs) = pair("wrong-path");
    let error = write_report(std::slice::from_ref(&dir), &dir.join("report")).unwrap_err();
    assert!(matches!(error, ReportError::NotARun { .. }));
    let text = error.to_string();
    assert!(text.contains("provenance.json") && text.contains("isph-paper"), "{text}");
    let error = write_report(&[dir.join("nowhere")], &dir.join("report")).unwrap_err();
    assert!(matches!(error, ReportError::NotFound { .. }), "{error}");
    assert!(matches!(write_report(&[], &dir.join("report")).unwrap_err(), ReportError::NoRuns));
    fs::write(runs[0].join("provenance.json"), r#"{"format": 2}"#).unwrap();
    let error = write_report(&runs, &dir.join("report")).unwrap_err();
    assert!(matches!(error, ReportError::Format { format: 2, .. }), "{error}");
    assert!(!dir.join("report").exists(), "nothing is written when a run cannot be read");
}

#[test]
fn a_frame_reads_back_as_it_was_written_whatever_the_block_size() {
    let dir = scratch("frame");
    let run = Synthetic { frames: 1, ..Synthetic::new("wcsph") }.write(&dir);
    let points: Vec<[f64; 3]> = (0..50).map(|i| [0.1 * f64::from(i), -1.0 / f64::from(i + 1), 0.0]).collect();
    let pressure: Vec<f64> = (0..50).map(|i| 0.25 * f64::from(i)).collect();
    let kind: Vec<u8> = (0..50).map(|i| u8::from(i % 3 == 0)).collect();
    // 1 and 2 blocks give headers of 32 and 40 bytes, with and without padding in base64; 1200 is a whole block.
    for block in [32768, 700, 1200, 400, 7] {
        fs::write(run.join("frames/frame-000000.vtp"), vtp(&points, &pressure, &kind, block)).unwrap();
        let frame = Run::read(&run).unwrap().frame(0).unwrap();
        assert_eq!(frame.points, points, "blocks of {block} bytes");
        // Quarters are exact in Float32.
        assert_eq!(frame.pressure, pressure);
        assert_eq!(frame.kind, kind);
    }
}

#[test]
fn a_frame_that_lies_about_its_size_is_refused() {
    let dir = scratch("lying-frame");
    let run = Synthetic { frames: 1, ..Synthetic::new("wcsph") }.write(&dir);
    let text = vtp(&[[0.0; 3]; 20], &[0.0; 20], &[0; 20], 4096);
    for count in ["3", "4000000000000", "18446744073709551615", "x"] {
        let lie = text.replace("NumberOfPoints=\"20\"", &format!("NumberOfPoints=\"{count}\""));
        fs::write(run.join("frames/frame-000000.vtp"), lie).unwrap();
        Run::read(&run).unwrap().frame(0).expect_err(count);
    }
    let shorter = text.replace("AAAA", "");
    fs::write(run.join("frames/frame-000000.vtp"), shorter).unwrap();
    Run::read(&run).unwrap().frame(0).expect_err("cut data");
}

#[test]
fn an_index_that_points_outside_the_run_is_not_followed() {
    let dir = scratch("outside");
    let run = Synthetic { frames: 1, ..Synthetic::new("wcsph") }.write(&dir);
    let index = r#"<VTKFile><Collection><DataSet timestep="0" file="../../secret.vtp"/><DataSet timestep="1" file="/etc/passwd"/></Collection></VTKFile>"#;
    fs::write(run.join("frames/frames.pvd"), index).unwrap();
    let run = Run::read(&run).unwrap();
    assert!(run.frames.is_empty());
    assert_eq!(run.notes.len(), 2, "{:?}", run.notes);
}

#[test]
fn a_three_dimensional_run_is_seen_from_the_side() {
    let dir = scratch("three-dimensions");
    let run = Synthetic { dimension: 3, ..Synthetic::new("wcsph") }.write(&dir.join("wcsph"));
    let paths = write_report(&[run], &dir.join("report")).unwrap();
    assert!(fs::read_to_string(paths.html).unwrap().contains("Side view on the x-z plane"));
}

#[test]
fn two_runs_of_one_method_are_told_apart() {
    let dir = scratch("same-method");
    let water = Synthetic::new("wcsph").write(&dir.join("a"));
    let printed = Synthetic { preset: "paper", ..Synthetic::new("wcsph") }.write(&dir.join("b"));
    let runs = Run::read_all(&[water.clone(), printed]).unwrap();
    assert_eq!([runs[0].label.as_str(), runs[1].label.as_str()], ["wcsph (water)", "wcsph (paper)"]);
    let copies = Run::read_all(&[water, Synthetic::new("wcsph").write(&dir.join("c"))]).unwrap();
    assert_eq!([copies[0].label.as_str(), copies[1].label.as_str()], ["a", "c"]);
}

#[test]
fn a_reference_without_a_column_is_said_to_be_missing() {
    let dir = scratch("no-column");
    let run = Synthetic::new("isph").write(&dir.join("isph"));
    let mut provenance = json(&run.join("provenance.json"));
    let references = provenance["compare"]["references"].as_array_mut().unwrap();
    for quantity in ["load:tank.fq", "load:tank.fy", "probe:P9", "gauge:h1"] {
        references.push(serde_json::json!({"name": format!("Curve of {quantity}"), "quantity": quantity, "time_scale": 1.0,
            "value_scale": 1.0, "points": [[0.0, 0.0], [1.0, 1.0]]}));
    }
    fs::write(run.join("provenance.json"), provenance.to_string()).unwrap();
    fs::write(run.join("loads.csv"), "time [s],tank.fx [N/m],tank.fy [N/m]\n0,0,0\n0.8,0,-100\n1.6,2,-100\n").unwrap();
    let html = fs::read_to_string(write_report(&[run], &dir.join("report")).unwrap().html).unwrap();
    for said in [
        "Curve of load:tank.fq is not drawn: its quantity is `load:tank.fq`, and there is no column `tank.fq` in loads.csv, which has \
         `tank.fx` and `tank.fy`.",
        "Curve of probe:P9 is not drawn",
        "no column `h1` in gauges.csv, which no run has.",
    ] {
        assert!(html.contains(said), "no `{said}`");
    }
    assert!(!html.contains("Curve of load:tank.fy is not drawn") && html.contains("Curve of load:tank.fy"));
}

/// Rows of one load as two methods write them: they differ in the first, which has no time behind it.
#[test]
fn a_load_that_stands_has_the_same_numbers_with_and_without_a_first_row() {
    let (dir, runs) = pair("standing-load");
    for (run, first) in runs.iter().zip(["0", "-100"]) {
        let rows: Vec<String> = (1..=100).map(|i| format!("{},-100", 0.02 * f64::from(i))).collect();
        fs::write(run.join("loads.csv"), format!("time [s],tank.fy [N/m]\n0,{first}\n{}\n", rows.join("\n"))).unwrap();
    }
    let paths = write_report(&runs, &dir.join("report")).unwrap();
    let html = fs::read_to_string(paths.html).unwrap();
    assert_eq!(html.matches("stands from the start</td>").count(), 2);
    assert!(html.contains("tank.fy: mean from the start") && !html.contains("tank.fy: quasi-static mean"));
    let report = json(&paths.json);
    let [a, b] = [0, 1].map(|i| report["methods"][i]["loads"]["tank.fy"].clone());
    assert_eq!(a, b);
    // 100 N/m over 2 s. 1e-9: round-off.
    assert!((a["impulse"].as_f64().unwrap() + 200.0).abs() < 1e-9 * 200.0, "{a}");
    assert!(a["arrival"].is_null());
}

#[test]
fn a_probe_with_the_name_of_the_first_column_is_kept_apart() {
    let dir = scratch("probe-time");
    let run = Synthetic::new("isph").write(&dir.join("isph"));
    fs::write(run.join("probes.csv"), "time [s],time [Pa]\n0,5\n1,7\n").unwrap();
    let report = json(&write_report(&[run], &dir.join("report")).unwrap().json);
    assert_eq!(report["methods"][0]["probes"]["time (column 2)"]["peak"], 7.0);
}
