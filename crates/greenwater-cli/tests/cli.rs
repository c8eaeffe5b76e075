//! The program as its users meet it: every test runs the real binary.

use std::fs;
use std::path::PathBuf;
use std::process::{Command, Output};

use serde_json::Value;
use tempfile::TempDir;

/// A still pool of 8 x 4 fluid particles in a tank of two lines, some fifty steps of it.
const POOL: &str = r#"
format = 1
title = "Small pool"
dimension = 2

[fluid]
spacing = 0.1
shapes = [{ box = { min = [0.0, 0.0], max = [0.8, 0.4] } }]

[walls]
layers = 2
shapes = [{ tank = { min = [0.0, 0.0], max = [1.2, 0.8], open = ["top"] } }]

[time]
end = 0.05

[[probe]]
name = "corner"
position = [1.2, 0.05]

[output]
fields = ["velocity", "density", "pressure", "kind", "id", "acceleration", "density_rate", "surface"]
"#;

struct Place(TempDir);

impl Place {
    /// A folder with the pool in `pool/case.toml`.
    fn new() -> Self {
        let place = Self(TempDir::new().unwrap());
        place.put("pool/case.toml", POOL);
        place
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn put(&self, name: &str, text: &str) {
        let path = self.path(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, text).unwrap();
    }

    fn read(&self, name: &str) -> String {
        fs::read_to_string(self.path(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
    }

    /// Runs `greenwater` with the words of `command` in the folder.
    fn run(&self, command: &str) -> Output {
        let words = command.split_whitespace();
        Command::new(env!("CARGO_BIN_EXE_greenwater")).args(words).current_dir(self.0.path()).output().unwrap()
    }

    /// Runs a command that must succeed; gives its standard output.
    fn ok(&self, command: &str) -> String {
        let output = self.run(command);
        assert!(output.status.success(), "{command}: {}", text(&output.stderr));
        text(&output.stdout)
    }

    /// Runs a command that must fail; gives its exit code and the error line.
    fn fails(&self, command: &str) -> (i32, String) {
        let output = self.run(command);
        let stderr = text(&output.stderr);
        let error = stderr.lines().find(|line| line.starts_with("error: ")).unwrap_or_else(|| panic!("{command}: {stderr}"));
        (output.status.code().unwrap(), error.to_owned())
    }

    /// Everything in the folder `name`, by path, but what tells the time or the machine.
    fn contents(&self, name: &str) -> Vec<(PathBuf, Vec<u8>)> {
        let mut found = Vec::new();
        let mut folders = vec![self.path(name)];
        while let Some(folder) = folders.pop() {
            for entry in fs::read_dir(folder).unwrap() {
                let path = entry.unwrap().path();
                if path.is_dir() {
                    folders.push(path);
                } else {
                    found.push((path.strip_prefix(self.path(name)).unwrap().to_owned(), fs::read(&path).unwrap()));
                }
            }
        }
        found.sort();
        found
    }
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).unwrap()
}

fn json(text: &str) -> Value {
    serde_json::from_str(text).unwrap_or_else(|error| panic!("{error} in {text}"))
}

/// Rows of a CSV table, the header first.
fn rows(table: &str) -> Vec<Vec<&str>> {
    table.lines().map(|line| line.split(',').collect()).collect()
}

#[test]
fn the_help_lists_every_verb_and_nothing_that_does_not_work() {
    let place = Place::new();
    let help = place.ok("--help");
    for verb in ["new", "check", "run", "compare", "validate", "bench", "report", "export", "cases", "methods", "kernels", "doctor"] {
        assert!(help.lines().any(|line| line.trim_start().starts_with(verb)), "{verb} is missing in\n{help}");
        assert!(place.ok(&format!("{verb} --help")).contains("Usage:"));
    }
    for later in ["resume", "view"] {
        assert!(!help.lines().any(|line| line.trim_start().starts_with(later)), "{later} in\n{help}");
    }
}

#[test]
fn lists_have_one_line_each_and_json() {
    let place = Place::new();
    for (verb, name) in [("cases", "dam-break-20"), ("methods", "isph-paper"), ("kernels", "wendland-c2")] {
        let list = place.ok(verb);
        assert!(list.lines().any(|line| line.split_whitespace().next() == Some(name)), "{list}");
        let rows = json(&place.ok(&format!("{verb} --json")));
        assert_eq!(rows[verb].as_array().unwrap().len(), list.lines().count());
    }
    assert!(place.ok("cases --keys").contains("fluid.spacing"));
    assert!(place.ok("doctor").contains(env!("CARGO_PKG_VERSION")));
    assert!(json(&place.ok("doctor --json"))["machine"]["cores"].as_u64().unwrap() >= 1);
}

#[test]
fn a_bad_case_is_one_clear_error_with_exit_code_2_and_leaves_nothing() {
    let place = Place::new();
    let pool = |from: &str, to: &str| POOL.replace(from, to);
    let overlap = r#"shapes = [{ box = { min = [0.0, 0.0], max = [0.8, 0.4] } }, { box = { min = [0.0, 0.0], max = [0.2, 0.2] } }]"#;
    for (case, wanted) in [
        (pool("spacing = 0.1", "spacing = -0.1"), "`fluid.spacing` is -0.1, but must be > 0"),
        (pool("spacing = 0.1", "spacign = 0.1"), "unknown key `fluid.spacign`, did you mean `spacing`?"),
        (pool("spacing = 0.1", "spacing = \"10 cm\""), "`fluid.spacing` has a value of the wrong type"),
        (pool("shapes = [{ box = { min = [0.0, 0.0], max = [0.8, 0.4] } }]", overlap), "overlap near"),
        (pool("max = [0.8, 0.4] } }]", "max = [0.0, 0.4] } }]"), "fluid.shapes[0]"),
        (pool("format = 1", "format = 2"), "`format` is 2"),
        (pool("[time]", "[time"), "not valid TOML"),
        (pool("end = 0.05", ""), "`time.end` is missing"),
    ] {
        place.put("bad/case.toml", &case);
        for verb in ["check bad", "run bad --out made", "compare bad --out made"] {
            let (code, error) = place.fails(verb);
            assert_eq!(code, 2, "{error}");
            assert!(error.contains(wanted), "{error}");
            assert!(!place.path("made").exists());
        }
    }
    let (code, error) = place.fails("run dam-brake");
    assert!(code == 2 && error.contains("did you mean `dam-break`?"), "{error}");
    let (code, error) = place.fails("run missing/case.toml");
    assert!(code == 2 && error.contains("no such file"), "{error}");
    let (code, error) = place.fails("run pool --set fluid.spacing=-0.1");
    assert!(code == 2 && error.contains("--set fluid.spacing=-0.1: `fluid.spacing` is -0.1"), "{error}");
    let (code, error) = place.fails("run pool --threads 0");
    assert!(code == 2 && error.contains("--threads is 0, but must be 1 to 1024"), "{error}");
    assert_eq!(place.fails("run pool --method sph").0, 2);
    assert_eq!(place.fails("run pool --set spacing").0, 2);
    assert_eq!(place.fails("compare pool --methods wcsph,wcsph --out made").0, 2);
    assert!(!place.path("runs").exists() && !place.path("made").exists());
}

#[test]
fn a_bad_table_of_particles_is_named_by_row_and_column() {
    let place = Place::new();
    let case = POOL.replace(r#"shapes = [{ box = { min = [0.0, 0.0], max = [0.8, 0.4] } }]"#, r#"from_file = "p.csv""#);
    place.put("table/case.toml", &case);
    place.put("table/p.csv", "id,kind,x,y,vx,vy,density,pressure,mass,h\n0,fluid,0.4,NaN,0,0,1000,0,10,0.12\n");
    let (code, error) = place.fails("run table --out made");
    assert!(code == 2 && error.contains("p.csv:2: column `y` is NaN, but must be a finite number"), "{error}");
    place.put("table/p.csv", "id,kind,x,y,vx,vy,density,pressure,mass,h\n");
    let (code, error) = place.fails("run table --out made");
    assert!(code == 2 && error.contains("without a particle"), "{error}");
    fs::remove_file(place.path("table/p.csv")).unwrap();
    assert_eq!(place.fails("run table --out made").0, 2);
    assert!(!place.path("made").exists());
}

#[test]
fn a_case_of_a_terabyte_is_refused_with_exit_code_7() {
    let place = Place::new();
    for verb in ["check", "run", "compare"] {
        // 1.125 m2 of fluid in squares of 17 um: 4e9 particles of 600 bytes and more.
        let (code, error) = place.fails(&format!("{verb} dam-break --set fluid.spacing=0.0000170454545454545454"));
        assert_eq!(code, 7, "{error}");
        assert!(error.contains("limits.memory_gib") && error.contains("fluid.spacing"), "{error}");
    }
    assert!(!place.path("runs").exists());
}

#[test]
fn check_says_what_a_run_takes_and_draws_it() {
    let place = Place::new();
    let said = place.ok("check pool --out pool.svg");
    assert!(said.contains("32 fluid") && said.contains("memory:") && said.contains("steps:") && said.contains("pool.svg"), "{said}");
    assert!(!said.contains("kernel reaches"), "two lines of walls miss less than a hundredth of the weight: {said}");
    let thin = place.ok("check pool --out thin.svg --set walls.layers=1");
    assert!(thin.contains("the kernel reaches beyond the 1 line(s) of the walls"), "{thin}");
    assert!(place.read("pool.svg").starts_with("<svg"));
    assert!(place.fails("check pool --out pool.svg").1.contains("exists already"));
    let (code, said) = place.fails("check pool --out pool.pdf");
    assert!(code == 2 && said.contains("must end in .svg or .png"), "{said}");
    place.ok("check pool --out pool.png");
    assert_eq!(fs::read(place.path("pool.png")).unwrap()[..4], *b"\x89PNG");
    let answer = json(&place.ok("check pool --out pool.svg --force --json"));
    assert_eq!(answer["estimate"]["fluid"], 32);
    assert!(!place.path("runs").exists());
}

#[test]
fn a_new_case_runs_unedited_and_nothing_is_written_over() {
    let place = Place::new();
    place.ok("new mine --case dam-break-20");
    assert!(place.read("mine/case.toml").contains('#'), "a case to learn from has comments");
    assert!(place.read("mine/case.toml").contains("name = \"delta-sph\""), "a case of one's own begins with a usable pressure");
    place.ok("run mine --steps 1");
    assert!(place.path("runs/mine-delta-sph/DONE").exists());
    place.ok("new printed --case dam-break-printed");
    assert!(place.read("printed/case.toml").contains("name = \"wcsph\"\npreset = \"paper\""), "what is as printed stays so");
    let before = place.contents("mine");
    assert!(place.fails("new mine").1.contains("exists already"));
    assert!(place.fails("new other --case dam").1.contains("must be a shipped case"));
    assert_eq!(place.contents("mine"), before);
    assert!(!place.path("other").exists());
}

#[test]
fn a_run_is_never_written_over_without_force() {
    let place = Place::new();
    place.ok("run pool --out made");
    let before = place.contents("made");
    let (code, error) = place.fails("run pool --out made");
    assert!(code == 2 && error.contains("--force"), "{error}");
    assert_eq!(place.contents("made"), before);
    // What the user put there stays, and no frame of the old run does.
    place.put("made/notes.txt", "mine");
    place.put("made/frames/picture.png", "mine");
    place.ok("run pool --out made --steps 0 --force");
    assert_eq!(json(&place.read("made/summary.json"))["steps"], 0);
    assert_eq!((place.read("made/notes.txt").as_str(), place.read("made/frames/picture.png").as_str()), ("mine", "mine"));
    assert!(place.path("made/frames/frame-000000.vtp").exists() && !place.path("made/frames/frame-000001.vtp").exists());
    // Force replaces runs only.
    place.put("precious/thesis.txt", "years of work");
    let (code, error) = place.fails("run pool --out precious --force");
    assert!(code == 2 && error.contains("not a run folder"), "{error}");
    assert_eq!(place.read("precious/thesis.txt"), "years of work");
    assert_eq!(place.fails("run pool --out precious/thesis.txt --force").0, 2);
    // All fluid gone is no success either.
    let (code, error) = place.fails("run pool --method wcsph --out gone --end 2 --set time.step=0.1");
    assert!(code == 4 && error.contains("outside the domain"), "{error}");
}

#[test]
fn a_run_folder_holds_what_it_should() {
    let place = Place::new();
    let answer = json(&place.ok("run pool --method wcsph --out made --json"));
    assert_eq!((answer["completed"].as_bool(), answer["exit_code"].as_u64()), (Some(true), Some(0)));
    assert_eq!(place.read("made/case.toml"), POOL);
    assert!(place.read("made/case.resolved.toml").contains("alpha = 0.05"));
    let provenance = json(&place.read("made/provenance.json"));
    assert_eq!(provenance["program"], "greenwater");
    assert_eq!(provenance["particles"]["fluid"], 32);
    assert_eq!(provenance["scales"]["up_axis"], 1);
    assert!(provenance["departures"].as_array().unwrap().iter().any(|text| text.as_str().unwrap().contains("in place of the printed")));
    assert_eq!(json(&place.read("made/status.json"))["state"], "finished");
    let summary = json(&place.read("made/summary.json"));
    let steps = summary["steps"].as_u64().unwrap();
    assert!(steps > 5 && summary["energy"]["initial"].as_f64().unwrap() > 0.0);
    for (name, header) in [
        ("energy.csv", "time [s],kinetic [J/m],potential [J/m],elastic [J/m],total [J/m]"),
        ("front.csv", "time [s],front [m],residual_height [m]"),
        ("probes.csv", "time [s],corner [Pa]"),
        ("steps.csv", "step,time [s],dt [s],limit,iterations,residual [1],maximum_speed [m/s],wall_clock [s]"),
    ] {
        let table = place.read(&format!("made/{name}"));
        assert_eq!(table.lines().next(), Some(header));
        assert!(table.lines().count() > 2, "{name}: {table}");
        assert!(rows(&table).iter().all(|row| row.len() == header.split(',').count()), "{table}");
    }
    assert_eq!(rows(&place.read("made/steps.csv")).len() as u64, steps + 1);
    for line in place.read("made/events.jsonl").lines() {
        json(line);
    }
    let left: Vec<_> = place.contents("made").into_iter().filter(|(path, _)| path.extension().is_some_and(|e| e == "part")).collect();
    assert!(left.is_empty(), "temporary files left: {left:?}");
    // The resolved case is a case, and gives the same run.
    place.put("again/case.toml", &place.read("made/case.resolved.toml"));
    place.ok("run again --out second");
    assert_eq!(place.read("second/frames/frame-000001.vtp"), place.read("made/frames/frame-000001.vtp"));
}

#[test]
fn no_step_writes_the_initial_state_with_accelerations_and_reads_back_bit_by_bit() {
    let place = Place::new();
    for method in ["wcsph", "isph-paper"] {
        let first = format!("first-{method}");
        place.ok(&format!("run pool --method {method} --steps 0 --out {first}"));
        place.ok(&format!("export {first} --to csv --all-fields"));
        let table = place.read(&format!("{first}/particles.csv"));
        let header = table.lines().next().unwrap();
        assert!(header.starts_with("id,kind,x,y,vx,vy,density,pressure,mass,h,layer"), "{header}");
        for name in ["acceleration_x", "acceleration_y", "density_rate", "surface"] {
            assert!(header.split(',').any(|column| column == name), "{name} is missing in {header}");
        }
        // The same state again, from the table: `given` density, so that nothing is made anew.
        let case = POOL
            .replace(r#"shapes = [{ box = { min = [0.0, 0.0], max = [0.8, 0.4] } }]"#, r#"from_file = "particles.csv""#)
            .replace(r#"shapes = [{ tank = { min = [0.0, 0.0], max = [1.2, 0.8], open = ["top"] } }]"#, "");
        let back = format!("back-{method}");
        place.put(&format!("{back}/case.toml"), &case);
        place.put(&format!("{back}/particles.csv"), &table);
        place.ok(&format!("run {back} --method {method} --steps 0 --out second-{method}"));
        assert_eq!(place.read(&format!("second-{method}/particles.csv")), table, "the copy of the table belongs to the run");
        place.ok(&format!("export second-{method} --to csv --all-fields --out again.csv --force"));
        assert_eq!(place.read("again.csv"), table, "{method}");
    }
}

#[test]
fn export_says_what_it_cannot_do() {
    let place = Place::new();
    place.ok("run pool --out made --steps 2");
    let (code, error) = place.fails("export made --to csv --frame 9");
    assert!(code == 2 && error.contains("has frames 0 to"), "{error}");
    place.ok("export made --to csv --frame 0 --out start.csv");
    assert!(place.fails("export made --to csv --frame 0 --out start.csv").1.contains("exists already"));
    place.ok("export made --to vtp");
    assert!(place.read("made/particles.vtp").contains("PolyData"));
    assert_eq!(place.fails("export pool --to csv").0, 2);
    place.ok("run pool --out bare --steps 0 --set output.fields=['velocity']");
    let (code, error) = place.fails("export bare --to csv");
    assert!(code == 2 && error.contains("no `density`") && error.contains("output.fields"), "{error}");
}

#[test]
fn compare_writes_a_folder_a_method_and_the_report() {
    let place = Place::new();
    let said = place.ok("compare pool --out both");
    assert!(said.contains("both/report/index.html"), "{said}");
    let page = place.read("both/report/index.html");
    assert!(page.contains("wcsph") && page.contains("isph-paper") && page.contains("Small pool"));
    let report = json(&place.read("both/report/report.json"));
    assert_eq!(report["methods"].as_array().unwrap().len(), 4);
    let start = |name: &str| {
        place.ok(&format!("export both/{name} --to csv --frame 0 --out {name}.csv"));
        let table = place.read(&format!("{name}.csv"));
        rows(&table).iter().skip(1).map(|row| row[..4].join(",")).collect::<Vec<_>>()
    };
    assert_eq!(start("wcsph"), start("isph-paper"), "the same initial particles");
    assert_eq!(place.fails("compare pool --out both").0, 2);
    assert_eq!(place.fails("report both").0, 2, "the report is there already");
    place.ok("report both --out elsewhere");
    assert_eq!(json(&place.read("elsewhere/report.json"))["methods"], report["methods"]);
    place.ok("report both --force");
    place.ok("compare pool --methods wcsph,wcsph:paper --out presets --end 0.002");
    assert!(place.path("presets/wcsph-water/DONE").exists() && place.path("presets/wcsph-paper/DONE").exists());
}

/// A comparison killed while it wrote its report leaves `report.json`, its first file, or that under its temporary name.
#[test]
fn force_replaces_an_interrupted_report_and_nothing_else() {
    let place = Place::new();
    place.ok("compare pool --methods wcsph --out one --steps 1");
    let left = place.read("one/report/report.json");
    fs::remove_dir_all(place.path("one/report")).unwrap();
    for begun in ["one/report/report.json", "one/report/.report.json.123.tmp"] {
        place.put(begun, &left);
        place.ok("report one --out one/report --force");
        assert!(place.path("one/report/index.html").is_file());
        place.ok("compare pool --methods wcsph --out one --steps 1 --force");
        fs::remove_dir_all(place.path("one/report")).unwrap();
    }
    place.put("precious/figures/thesis.svg", "years of work");
    place.put("other/report.json", "{}");
    for folder in ["precious", "other", "one/wcsph"] {
        let before = place.contents(folder);
        for force in ["", "--force"] {
            let (code, error) = place.fails(&format!("report one --out {folder} {force}"));
            assert!(code == 2 && error.contains("holds no report of greenwater"), "{error}");
        }
        assert_eq!(place.contents(folder), before);
    }
}

/// The pool is 1.48 wide in the variables of the reference, which takes 17 s to 1.5: a lead of nearly 100 %. The report says so; to
/// judge is for `validate`.
#[test]
fn a_comparison_outside_a_band_says_so_in_its_report() {
    let place = Place::new();
    let reference = r#"
[[compare.reference]]
name = "A slow front"
quantity = "front"
source = "made up"
time_scale = 1.0
value_scale = 1.85
time_label = "t"
value_label = "x/L"
points = [[0.0, 1.0], [100.0, 4.0]]
"#;
    place.put("slow/case.toml", &format!("{POOL}{reference}"));
    place.ok("compare slow --methods wcsph --out both --end 0.1");
    let report: Value = serde_json::from_str(&place.read("both/report/report.json")).unwrap();
    let missed: Vec<&Value> = report["acceptance"].as_array().unwrap().iter().filter(|check| check["pass"] == false).collect();
    assert!(missed.len() == 1 && missed[0]["what"].as_str().unwrap().contains("A slow front"), "{missed:?}");
}

#[test]
fn frames_do_not_depend_on_the_number_of_threads() {
    let place = Place::new();
    for threads in 1..=3 {
        place.ok(&format!("compare pool --threads {threads} --out t{threads}"));
    }
    for method in ["wcsph", "isph-paper"] {
        let one = place.contents(&format!("t1/{method}/frames"));
        assert!(one.len() > 3);
        assert!(one == place.contents(&format!("t2/{method}/frames")), "{method}: frames of 1 and 2 threads differ");
        assert!(one == place.contents(&format!("t3/{method}/frames")), "{method}: frames of 1 and 3 threads differ");
    }
}

#[test]
fn an_instability_ends_with_code_4_and_leaves_the_last_good_frame() {
    let place = Place::new();
    // A step of 0.01 s: sound crosses three spacings in it, an explicit method allows a fraction of one.
    let (code, error) = place.fails("run pool --method wcsph --set time.step=0.01 --end 1 --out made");
    assert_eq!(code, 4, "{error}");
    assert!(error.contains("particle") && error.contains("t = 0.0") && error.contains("step "), "{error}");
    assert!(!place.path("made/DONE").exists());
    let failed = json(&place.read("made/FAILED.json"));
    assert_eq!(failed["exit_code"], 4);
    assert!(failed["field"].is_string() && failed["particle"].is_u64() && failed["time"].is_f64() && failed["step"].is_u64(), "{failed}");
    assert_eq!(json(&place.read("made/status.json"))["state"], "failed");
    assert_eq!(json(&place.read("made/summary.json"))["completed"], false);
    let exported = json(&place.ok("export made --to csv --json"));
    assert_eq!(exported["time"], failed["time"]);
    let table = place.read("made/particles.csv");
    assert!(!table.contains("NaN") && !table.contains("inf"));
    // A comparison goes on with the other methods, shows all of them, and still fails.
    let (code, error) = place.fails("compare pool --set time.step=0.01 --end 1 --out both");
    assert!(code == 4 && error.contains("wcsph"), "{error}");
    assert!(place.path("both/isph-paper/provenance.json").exists());
    assert!(place.read("both/report/index.html").contains("wcsph"));
}

#[test]
fn a_reader_that_goes_away_is_no_error() {
    let place = Place::new();
    let command = format!("{} cases --keys | head -1", env!("CARGO_BIN_EXE_greenwater"));
    let output = Command::new("sh").args(["-c", &command]).current_dir(place.0.path()).output().unwrap();
    assert_eq!(text(&output.stderr), "");
    assert_eq!(text(&output.stdout).lines().count(), 1);
}

/// A whole validation: a case that runs in a moment inside its bands, then the same results with a value outside.
#[test]
fn validate_measures_a_case_and_tells_a_miss_by_its_exit_code() {
    let place = Place::new();
    assert!(place.ok("validate --list").contains("free-fall"));
    let table = place.ok("validate free-fall --method wcsph --json results.json --docs page.md");
    assert!(table.contains("centre of mass against free fall") && table.contains("3 of 3 quantities with a band are inside it"), "{table}");
    let results: Value = serde_json::from_str(&place.read("results.json")).unwrap();
    let row = &results["results"][0];
    assert_eq!((&row["case"], &row["method"], &row["pass"]), (&"free-fall".into(), &"wcsph".into(), &true.into()));
    for key in ["quantity", "unit", "source"] {
        assert!(row[key].is_string(), "{key}");
    }
    for key in ["value", "reference", "low", "high", "seconds"] {
        assert!(row[key].is_f64(), "{key}: {row}");
    }
    let page = place.read("page.md");
    assert!(page.starts_with("# Validation") && page.contains("| [free-fall](#free-fall) | 3 of 3 |"), "{page}");

    // The same numbers against a narrower band: a miss, whatever the file says of it.
    let mut narrow = results.clone();
    narrow["results"][0]["high"] = narrow["results"][0]["low"].clone();
    place.put("narrow.json", &narrow.to_string());
    assert_eq!(place.fails("validate --from narrow.json"), (3, "error: 1 of 3 quantities are outside their bands".to_owned()));
    assert_eq!(place.fails("validate free-fal").0, 2);
    let (code, error) = place.fails("validate free-fall --method wcsph --json results.json");
    assert!(code == 2 && error.contains("results.json` exists already; name another file, or replace it with --force"), "{error}");
    let (code, error) = place.fails("validate wedge couette --quick");
    assert!(code == 2 && error.contains("no short run of wedge, couette; leave --quick out"), "{error}");
    let output = place.run("validate wedge free-fall --quick --method wcsph");
    let said = text(&output.stderr);
    assert!(output.status.success() && said.contains("wedge: passed over") && !said.contains("free-fall: passed over"), "{said}");
    place.put("wrong.json", "{}");
    assert_eq!(place.fails("validate --from wrong.json").0, 2);
}

/// The rows of a bench file, each with what every row must have.
fn bench_rows(text: &str) -> Vec<Value> {
    let file = json(text);
    assert_eq!(file["format"], 1);
    for key in ["commit", "date", "machine", "ceilings"] {
        assert!(!file[key].is_null(), "{key} is missing");
    }
    for ceiling in file["ceilings"].as_array().unwrap() {
        assert!(ceiling["bytes_per_s"].as_f64().unwrap() > 1e8 && ceiling["flops"].as_f64().unwrap() > 1e8, "{ceiling}");
    }
    let rows = file["results"].as_array().unwrap().clone();
    for row in &rows {
        let seconds = ["min", "median", "max"].map(|key| row["seconds"][key].as_f64().unwrap());
        assert!(seconds[0] > 0.0 && seconds.is_sorted(), "{row}");
        assert!(row["workload"].is_string() && row["method"].is_string() && row["threads"].as_u64().unwrap() > 0, "{row}");
    }
    rows
}

fn positive(row: &Value, key: &str) -> f64 {
    let value = row[key].as_f64().unwrap_or_else(|| panic!("{key} in {row}"));
    assert!(value > 0.0, "{key} in {row}");
    value
}

#[test]
fn bench_measures_a_step_with_threads_pairs_memory_and_the_plain_loop() {
    let place = Place::new();
    let table = place.ok("bench step --quick --only 2d-10k --only isph-1k4 --threads 1,2 --repeats 1 --json step.json --history h.jsonl");
    assert!(table.contains("dam-break-2d-10k") && table.contains("M particle-steps/s"), "{table}");
    let rows = bench_rows(&place.read("step.json"));
    assert_eq!(rows.len(), 4);
    for row in &rows {
        assert_eq!(row["bench"], "step");
        let allowed = positive(row, "particle_steps_per_s") > 0.0 && positive(row, "bytes_per_particle") > 50.0;
        assert!(allowed && row["phases"].as_object().unwrap().len() > 2, "{row}");
        assert_eq!(row["speed_up"].is_number(), row["threads"] == 2, "{row}");
    }
    let delta: Vec<&Value> = rows.iter().filter(|row| row["method"] == "delta-sph").collect();
    for row in &delta {
        for key in ["pair_evaluations_per_s", "ratio_to_naive", "step_ratio_to_naive", "multiply_add_share", "bandwidth_share"] {
            positive(row, key);
        }
        // A step of the flow holds several sound steps; the list holds more than the support of the kernel.
        assert!(positive(row, "evaluations") > positive(row, "steps"), "{row}");
        assert!(positive(row, "listed_pairs") >= positive(row, "pairs"), "{row}");
        assert!((20.0..25.0).contains(&positive(row, "neighbours")), "{row}");
    }
    assert!(rows.iter().any(|row| row["method"] == "isph" && row["iterations"].as_f64().unwrap() > 0.0));
    assert_eq!(place.read("h.jsonl").lines().count(), 1);
}

#[test]
fn bench_measures_lists_and_equations_and_makes_its_page_from_the_history() {
    let place = Place::new();
    place.ok("bench neighbors --quick --only 3d-5k --threads 1 --repeats 1 --json neighbors.json --history h.jsonl");
    let rows = bench_rows(&place.read("neighbors.json"));
    assert_eq!((rows.len(), &rows[0]["particles"]), (1, &Value::from(17 * 17 * 17)));
    for key in ["pair_evaluations_per_s", "bytes_per_particle", "ratio_to_naive", "bandwidth_share"] {
        positive(&rows[0], key);
    }

    place.ok("bench poisson --quick --only 2d-1k --threads 1 --repeats 1 --json poisson.json --history h.jsonl");
    let rows = bench_rows(&place.read("poisson.json"));
    let iterations = |method: &str| rows.iter().find(|row| row["method"] == method).map(|row| positive(row, "iterations")).unwrap();
    assert!(iterations("multigrid-cg") < iterations("ic0-cg") && iterations("ic0-cg") < iterations("jacobi-cg"), "{rows:?}");
    assert!(rows.iter().all(|row| row["phases"]["setup"].is_number() && positive(row, "ratio_to_naive") > 0.0));

    place.ok("bench page --history h.jsonl --docs speed.md");
    let page = place.read("speed.md");
    for part in ["# Speed", "cloud-3d-5k", "column-2d-1k", "## Ceilings", "## Goals", "commit "] {
        assert!(page.contains(part), "{part} is missing in\n{page}");
    }
    let (code, error) = place.fails("bench page --history h.jsonl --docs speed.md");
    assert!(code == 2 && error.contains("--force"), "{error}");
}

#[test]
fn bench_sets_error_against_time_and_draws_it() {
    let place = Place::new();
    place.ok("bench impact --sizes 10 --json impact.json --out figures --history h.jsonl --docs docs/speed.md");
    let rows = bench_rows(&place.read("impact.json"));
    for method in ["isph", "delta-sph"] {
        let row = rows.iter().find(|row| row["method"] == method).unwrap();
        assert_eq!(row["impulse"].as_array().unwrap().len(), 4, "{row}");
        // One or two particles across the jet: an error of a few times the pressure itself.
        assert!(positive(row, "impulse_error") < 5.0 && positive(row, "plateau_error") < 5.0, "{row}");
    }
    let foam: Vec<&Value> = rows.iter().filter(|row| row["method"] == "interFoam").collect();
    assert!(foam.len() == 3 && foam.iter().all(|row| row["origin"].as_str().unwrap().contains("OpenFOAM")));
    for folder in ["figures", "docs/figures"] {
        for figure in ["error-time-impulse", "error-time-plateau"] {
            assert!(place.read(&format!("{folder}/{figure}.svg")).contains("interFoam"));
            assert!(place.path(&format!("{folder}/{figure}.png")).is_file());
        }
    }
    assert!(place.read("docs/speed.md").contains("figures/error-time-impulse.svg"));
}

#[test]
fn bench_names_what_it_cannot_do() {
    let place = Place::new();
    place.put("broken.jsonl", "{\"format\": 1}\n");
    place.put("there.json", "{}");
    for (command, code, parts) in [
        ("bench step --only dam-brake", 2, vec!["--only is dam-brake", "dam-break-2d-10k"]),
        ("bench neighbors --quick --threads 0", 2, vec!["--threads is 0", "1 to 1024"]),
        ("bench poisson --quick --json there.json", 2, vec!["there.json", "--force"]),
        ("bench impact --sizes 3", 2, vec!["--sizes has 3", "10 to 400"]),
        ("bench page --history broken.jsonl --docs page.md", 5, vec!["broken.jsonl", "line 1"]),
        ("bench page --history none.jsonl --docs page.md", 2, vec!["none.jsonl", "no results"]),
    ] {
        let (found, error) = place.fails(command);
        assert_eq!(found, code, "{command}: {error}");
        for part in parts {
            assert!(error.contains(part), "{command}: {error}");
        }
    }
    assert!(place.ok("bench step --list").contains("dam-break-3d-300k"));
}
