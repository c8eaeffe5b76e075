//! The page of `bench paper`: its sections 11-13 as measured here, beside its own numbers.

use std::path::Path;

use greenwater::kernel::{CubicSpline, Kernel};
use greenwater::neighbors::Search;
use greenwater::scheme::MethodName;
use greenwater_report::page::{Block, Cells, Figure, Page, Section, Table};
use greenwater_report::plot::{Axis, LinePlot, Series, png_from_svg};
use greenwater_report::words::{duration, number};

use super::flows::{AFTER_IMPACT, Flow, IMPACT, Sample, WALL_SHARE};
use super::printed::{self, at};
use super::solvers::Solver;
use super::{BenchError, Measured, claims::Verdict, flows, methods, search, solvers};

/// Pixels of a PNG for one of the SVG.
const PNG_SCALE: f32 = 2.0;

/// Writes `index.html` and `figures/*.svg|png` to the folder `out`.
pub fn write(measured: &Measured, out: &Path) -> Result<(), BenchError> {
    let page = page(measured);
    for figure in page.figures() {
        let png = png_from_svg(&figure.svg, PNG_SCALE).map_err(|source| BenchError::Figure { figure: figure.name.clone(), source })?;
        super::write(&out.join(format!("figures/{}.svg", figure.name)), &figure.svg)?;
        super::write(&out.join(format!("figures/{}.png", figure.name)), png)?;
    }
    super::write(&out.join("index.html"), page.html())
}

fn page(measured: &Measured) -> Page {
    let count = |verdict| measured.claims.iter().filter(|claim| claim.verdict == verdict).count();
    let verdicts = [Verdict::Holds, Verdict::HoldsWithALimit, Verdict::DoesNotHold, Verdict::NotMeasured]
        .into_iter()
        .filter(|verdict| count(*verdict) > 0)
        .map(|verdict| format!("{} {}", count(verdict), verdict.text()))
        .collect::<Vec<_>>()
        .join(", ");
    let cores = if measured.threads == 1 { "one core".to_owned() } else { format!("{} cores", measured.threads) };
    Page {
        title: "SPH and ISPH on this machine".into(),
        subtitle: format!(
            "Sections 11-13 of {}, measured with greenwater {} on {cores} in {}",
            printed::PAPER,
            env!("CARGO_PKG_VERSION"),
            duration(measured.seconds)
        ),
        head: vec![
            Block::Cards(cards(measured)),
            Block::Text(format!(
                "Of the {} claims of the paper that are tested below, {verdicts}. Every number on this page comes from this run; numbers of the \
                 paper are marked as such. Times are the least of several repetitions, with one thread unless said: what else the machine \
                 does can only add to a time.",
                measured.claims.len()
            )),
        ],
        sections: vec![
            kernel_section(),
            search_section(&measured.search),
            solver_section(&measured.solvers),
            method_section(&measured.methods),
            flow_section(&measured.flows),
            claim_section(measured),
        ],
        footer: format!("Made by greenwater {} bench paper; the numbers are in bench.json.", env!("CARGO_PKG_VERSION")),
    }
}

fn cards(measured: &Measured) -> Vec<(String, String)> {
    let mut cards = Vec::new();
    if let (Some(direct), Some(grid)) = (measured.search.direct_exponent(), measured.search.grid_exponent()) {
        let most = measured.search.acceleration().last().copied();
        let detail = most.map_or_else(String::new, |(n, ratio)| format!("The grid is {} times faster at {n} particles.", number(ratio)));
        cards.push((format!("Search: direct N^{direct:.2}, grid N^{grid:.2}"), detail));
    }
    let largest = measured.solvers.sizes.iter().copied().max();
    let solve = |solver| measured.solvers.find(solver, largest?, 1);
    if let (Some(gauss), Some(gmres)) = (solve(Solver::Gauss), solve(Solver::Pgmres)) {
        cards.push((
            format!("Pressure: PGMRES {} times faster than Gauss", number(gauss.seconds.min / gmres.seconds.min)),
            format!("{} s against {} s at {} rows, both on one thread.", number(gmres.seconds.min), number(gauss.seconds.min), gauss.rows),
        ));
    }
    let ratios = measured.methods.ratios();
    if let (Some(low), Some(high)) =
        (ratios.iter().copied().min_by(|a, b| a.1.total_cmp(&b.1)), ratios.iter().copied().max_by(|a, b| a.1.total_cmp(&b.1)))
    {
        cards.push((
            format!("A step of ISPH costs {} to {} of SPH", number(low.1), number(high.1)),
            format!("Least at {} particles, greatest at {}. The paper: 4.3 to 38.", low.0, high.0),
        ));
    }
    cards
}

/// A log-log plot in the size of half a page.
fn log_log(title: &str, x: &str, y: &str, series: Vec<Series>) -> LinePlot {
    LinePlot { x: Axis::log(x), y: Axis::log(y), series, ..half(title) }
}

/// Size of a figure that stands alone, px.
const WIDE: [f64; 2] = [1240.0, 420.0];

fn half(title: &str) -> LinePlot {
    LinePlot { size: [620.0, 400.0], ..LinePlot::new(title, "", "") }
}

fn figure(name: &str, plot: &LinePlot, caption: impl Into<String>) -> Figure {
    Figure { name: name.into(), svg: plot.svg(), caption: caption.into() }
}

fn table(caption: impl Into<String>, head: &[&str], rows: Vec<Vec<String>>) -> Table {
    Table { caption: caption.into(), head: head.iter().map(|&cell| cell.to_owned()).collect(), rows, cells: Cells::Numbers }
}

fn cell(value: Option<f64>) -> String {
    value.map_or_else(|| "\u{2013}".into(), number)
}

/// What a dash among the paper's numbers means.
const NOT_KNOWN: &str = "A dash under the paper's name: not in our copy of it.";

fn threads_text(threads: usize) -> String {
    if threads == 1 { "1 thread".into() } else { format!("{threads} threads") }
}

// ---- Fig. 2 -----------------------------------------------------------------------------------------------------------------

fn kernel_section() -> Section {
    let at = |f: &dyn Fn(f64) -> f64| (0..=250).map(|i| 0.01 * f64::from(i)).map(|q| [q, f(q)]).collect::<Vec<_>>();
    let w = at(&|q| Kernel::<2>::w(CubicSpline, q, 1.0));
    let slope = at(&|q| q * Kernel::<2>::dw_over_r(CubicSpline, q, 1.0));
    let mut plot = LinePlot::new("Fig. 2: the cubic spline and its derivative", "q = r/h", "W h\u{b2}, W' h\u{b3}");
    plot.series = vec![Series::line("kernel W", 0, w), Series::line("derivative W'", 1, slope)];
    plot.size = WIDE;
    let caption = "Equation (12) in two dimensions: W = 15/(7\u{3c0}h\u{b2}) (2/3 \u{2212} q\u{b2} + q\u{b3}/2) for q \u{2264} 1, \
                   15/(7\u{3c0}h\u{b2}) (2 \u{2212} q)\u{b3}/6 for q \u{2264} 2, and nothing beyond: the support is 2h.";
    Section::new("Fig. 2: the kernel", vec![Block::Figure(figure("fig-2-kernel", &plot, caption))])
}

// ---- Figs. 3-5 --------------------------------------------------------------------------------------------------------------

fn search_section(results: &search::Results) -> Section {
    let line = |name: &str, ink, search, threads| {
        let points = results.line(search, threads).map(|p| [p.particles as f64, search::STEPS * p.seconds.min]).collect();
        Series::both(name, ink, points)
    };
    let fitted = |exponent: Option<f64>| exponent.map_or_else(String::new, |k| format!(" Fitted exponent: {k:.3}."));
    let direct = log_log("Fig. 3: direct search, 1000 steps", "particles N", "time [s]", vec![line("direct", 1, Search::Direct, 1)]);
    let most = results.most_threads();
    let mut grid_lines = vec![line("grid, 1 thread", 0, Search::Grid, 1)];
    if most > 1 {
        grid_lines.push(line(&format!("grid, {most} threads"), 2, Search::Grid, most));
    }
    let grid = log_log("Fig. 4: grid search, 1000 steps", "particles N", "time [s]", grid_lines);
    let acceleration = results.acceleration().into_iter().map(|(n, ratio)| [n as f64, ratio]).collect();
    let mut ratio =
        log_log("Fig. 5: acceleration by the grid", "particles N", "direct / grid", vec![Series::both("direct / grid", 3, acceleration)]);
    ratio.size = WIDE;
    let mut blocks = vec![
        Block::Text(
            "Particles of a square lattice with a little disorder (each moved by up to a tenth of a spacing), with the 20 neighbours of the \
             methods. A search builds the list of all neighbours of all particles anew."
                .into(),
        ),
        Block::Figures(vec![
            figure(
                "fig-3-search-direct",
                &direct,
                format!("A few searches were timed, at least three of each size, and scaled to 1000.{}", fitted(results.direct_exponent())),
            ),
            figure("fig-4-search-grid", &grid, format!("Scaled to 1000 in the same way.{}", fitted(results.grid_exponent()))),
        ]),
        Block::Figure(figure("fig-5-search-acceleration", &ratio, "Time of the direct search over that of the grid, both on one thread.")),
    ];
    blocks.extend(search_tables(results).into_iter().map(Block::Table));
    Section::new("Figs. 3-5: neighbour search", blocks)
}

/// The numbers behind Figs. 3-5.
pub fn search_tables(results: &search::Results) -> Vec<Table> {
    let most = results.most_threads();
    let accelerations = results.acceleration();
    let mut sizes: Vec<usize> = results.points.iter().map(|point| point.particles).collect();
    sizes.sort_unstable();
    sizes.dedup();
    let rows = sizes.into_iter().map(|n| {
        let find = |search, threads| results.line(search, threads).find(|point| point.particles == n);
        let time = |search, threads| cell(find(search, threads).map(|point| search::STEPS * point.seconds.min));
        let per_particle = find(Search::Grid, 1).map(|point| 1e9 * point.seconds.min / n as f64);
        let mut row = vec![
            n.to_string(),
            time(Search::Direct, 1),
            time(Search::Grid, 1),
            cell(accelerations.iter().find(|(size, _)| *size == n).map(|(_, ratio)| *ratio)),
            cell(per_particle),
        ];
        if most > 1 {
            row.push(time(Search::Grid, most));
        }
        row
    });
    let mut head = vec!["particles", "direct [s]", "grid [s]", "direct / grid", "grid [ns a particle]"];
    let parallel = format!("grid, {} [s]", threads_text(most));
    if most > 1 {
        head.push(&parallel);
    }
    let exponents = match (results.direct_exponent(), results.grid_exponent()) {
        (Some(direct), Some(grid)) => format!(" Fitted: direct N^{direct:.3}, grid N^{grid:.3}."),
        _ => String::new(),
    };
    vec![table(
        format!("Time of 1000 searches, scaled from the least time of one; \u{2013}: not measured.{exponents}"),
        &head,
        rows.collect(),
    )]
}

// ---- Figs. 6-8, Table 2 -----------------------------------------------------------------------------------------------------

fn solver_section(results: &solvers::Results) -> Section {
    let line = |solver: Solver, ink| {
        let points = results.serial(solver).map(|s| [s.rows as f64, s.seconds.min]).collect();
        Series::both(solver.name(), ink, points)
    };
    let paper = |name: &str, mark, cells: &[(usize, f64)]| {
        Series::reference(name, mark, cells.iter().map(|&(n, seconds)| [n as f64, seconds]).collect())
    };
    let gauss = log_log(
        "Fig. 6: Gauss elimination",
        "matrix dimension",
        "time of one solve [s]",
        vec![line(Solver::Gauss, 1), paper("the paper", 0, printed::GAUSS)],
    );
    let gmres = log_log(
        "Fig. 7: PGMRES",
        "matrix dimension",
        "time of one solve [s]",
        vec![line(Solver::Pgmres, 0), line(Solver::Default, 2), paper("PGMRES, the paper", 1, printed::PGMRES)],
    );
    let mut blocks = vec![
        Block::Text(format!(
            "Pressure equations (31) of the dam break with columns of {} particles, as ISPH meets them {} s into the flow: a row a particle, wall \
             particles included, so that the dimension is the number of particles, as in the paper. Each is solved from zero to a relative \
             residual of 1e-6. Gauss: elimination with row pivoting on the dense matrix, in blocks (the paper's is the plain one). PGMRES: \
             GMRES restarted after 30 vectors, ILU(0). CG with IC(0), which the symmetry of (16) and (17) allows, is what this program \
             uses unless told otherwise.",
            columns_text(results),
            number(results.solves.first().map_or(0.0, |solve| solve.time))
        )),
        Block::Figures(vec![
            figure("fig-6-gauss", &gauss, exponent_caption(results, Solver::Gauss)),
            figure("fig-7-pgmres", &gmres, exponent_caption(results, Solver::Pgmres)),
        ]),
        Block::Figures(speed_up_figures(results)),
    ];
    blocks.extend(solver_tables(results).into_iter().map(Block::Table));
    Section::new("Figs. 6-8 and Table 2: the pressure equation", blocks)
}

fn columns_text(results: &solvers::Results) -> String {
    let columns = || results.serial(Solver::Gauss).map(|s| s.columns);
    format!("m = {} to {} by 2m", columns().min().unwrap_or(0), columns().max().unwrap_or(0))
}

fn exponent_caption(results: &solvers::Results, solver: Solver) -> String {
    let fitted = super::record::exponent(results.serial(solver).map(|s| (s.rows as f64, s.seconds.min)));
    let fitted = fitted.map_or_else(String::new, |k| format!(" Fitted exponent of {} here: {k:.2}.", solver.name()));
    format!("One thread.{fitted}")
}

fn speed_up_figures(results: &solvers::Results) -> Vec<Figure> {
    let Some(largest) = results.sizes.iter().copied().max() else { return Vec::new() };
    let rows = results.find(Solver::Gauss, largest, 1).map_or(0, |solve| solve.rows);
    let most = results.most_threads() as f64;
    let lines = |value: &dyn Fn(f64, f64) -> f64| {
        let of = |(i, solver): (usize, Solver)| {
            let points = results.threads.iter().filter_map(|&m| Some([m as f64, value(results.speed_up(solver, largest, m)?, m as f64)]));
            Series::both(solver.name(), [1, 0, 2][i], points.collect())
        };
        Solver::ALL.into_iter().enumerate().map(of).collect::<Vec<_>>()
    };
    let mut speed_up = half("Fig. 8: speed-up");
    speed_up.x = Axis { range: Some([1.0, most.max(2.0)]), ..Axis::linear("threads m") };
    speed_up.y = Axis { range: Some([0.0, 1.1 * most.max(2.0)]), ..Axis::linear("S_m = T_1/T_m") };
    speed_up.series = lines(&|speed_up, _| speed_up);
    speed_up.series.push(Series::line("ideal", 3, results.threads.iter().map(|&m| [m as f64, m as f64]).collect()));
    let mut efficiency = half("Fig. 8: efficiency");
    efficiency.x = speed_up.x.clone();
    efficiency.y = Axis { range: Some([0.0, 1.2]), ..Axis::linear("E_m = S_m/m") };
    efficiency.series = lines(&|speed_up, m| speed_up / m);
    let paper = format!("The paper: a speed-up of {} on 32 processors at every size.", printed::GAUSS_32_SPEED_UP);
    vec![
        figure("fig-8-speed-up", &speed_up, format!("{rows} rows. {paper}")),
        figure("fig-8-efficiency", &efficiency, format!("{rows} rows. The paper: 0.99 on 32 processors.")),
    ]
}

/// Table 2, and the speed-up at every size.
pub fn solver_tables(results: &solvers::Results) -> Vec<Table> {
    let most = results.most_threads();
    let seconds = |solver, m, threads| cell(results.find(solver, m, threads).map(|s| s.seconds.min));
    let rows = results.sizes.iter().map(|&m| {
        let rows = results.find(Solver::Gauss, m, 1).map_or(0, |s| s.rows);
        let iterations = results.find(Solver::Pgmres, m, 1).map(|s| s.iterations as f64);
        vec![
            rows.to_string(),
            seconds(Solver::Gauss, m, 1),
            seconds(Solver::Gauss, m, most),
            seconds(Solver::Pgmres, m, 1),
            cell(iterations),
            seconds(Solver::Default, m, 1),
            cell(at(printed::GAUSS, rows)),
            cell(at(printed::GAUSS_32, rows)),
            cell(at(printed::PGMRES, rows)),
        ]
    });
    let parallel = format!("Gauss, {}", threads_text(most));
    let head =
        ["particles", "Gauss", &parallel, "PGMRES", "iterations", "CG, IC(0)", "paper: Gauss", "paper: Gauss, 32 CPUs", "paper: PGMRES"];
    let caption = format!(
        "Table 2: time of one solve of the pressure equation at the paper's numbers of particles, in seconds; iterations of PGMRES. {NOT_KNOWN}"
    );
    let table_2 = table(caption, &head, rows.collect());
    let scaling = results.sizes.iter().flat_map(|&m| {
        Solver::ALL.into_iter().flat_map(move |solver| {
            results.threads.iter().filter(|&&threads| threads > 1).filter_map(move |&threads| {
                let (solve, speed_up) = (results.find(solver, m, threads)?, results.speed_up(solver, m, threads)?);
                Some(vec![
                    solve.rows.to_string(),
                    solver.name().to_owned(),
                    threads.to_string(),
                    number(solve.seconds.min),
                    number(speed_up),
                    number(speed_up / threads as f64),
                ])
            })
        })
    });
    let scaling =
        table("Speed-up and efficiency at every size.", &["particles", "solver", "threads m", "time [s]", "S_m", "E_m"], scaling.collect());
    if scaling.rows.is_empty() { vec![table_2] } else { vec![table_2, scaling] }
}

// ---- Table 3 ----------------------------------------------------------------------------------------------------------------

fn method_section(results: &methods::Results) -> Section {
    let line = |name: &str, ink, method| {
        Series::both(name, ink, results.serial(method).map(|c| [c.particles as f64, c.of_2000_steps()]).collect())
    };
    let paper = |name: &str, mark, cells: &[(usize, f64)]| {
        Series::reference(name, mark, cells.iter().map(|&(n, seconds)| [n as f64, seconds]).collect())
    };
    let cost = log_log(
        "Table 3: 2000 steps",
        "particles N",
        "time [s]",
        vec![
            line("SPH", 0, MethodName::Wcsph),
            line("ISPH", 1, MethodName::IsphPaper),
            paper("SPH, the paper", 0, printed::SPH_2000_STEPS),
            paper("ISPH, the paper", 1, printed::ISPH_2000_STEPS),
        ],
    );
    let mut ratio = half("Cost of a step of ISPH over one of SPH");
    ratio.x = Axis::linear("particles N");
    ratio.y = Axis { range: Some([0.0, 40.0]), ..Axis::linear("ISPH / SPH") };
    let paper_ratio = printed::ISPH_2000_STEPS.iter().filter_map(|&(n, isph)| Some([n as f64, isph / at(printed::SPH_2000_STEPS, n)?]));
    ratio.series = vec![
        Series::both("here", 1, results.ratios().into_iter().map(|(n, ratio)| [n as f64, ratio]).collect()),
        Series::reference("the paper", 1, paper_ratio.collect()),
    ];
    let steps = results.costs.first().map_or(0, |cost| cost.steps);
    let scaled = if steps as f64 == methods::STEPS {
        "All 2000 steps were made.".to_owned()
    } else {
        format!(
            "{steps} steps were made and their time scaled to 2000: early steps, while the water still falls freely, are cheap for ISPH."
        )
    };
    let runs = if results.runs == 1 { "One run of each.".to_owned() } else { format!("The fastest of {} runs of each.", results.runs) };
    let mut blocks = vec![
        Block::Text(format!(
            "The dam break from its start. {scaled} {runs} Steps of SPH are shorter, by the ratio of the flow's speed to that of sound: 2000 of \
             them are a fraction of the flow, as in the paper."
        )),
        Block::Figures(vec![
            figure("table-3-cost", &cost, "One thread."),
            figure("table-3-ratio", &ratio, "One thread. At most 8 is what this program asks of itself."),
        ]),
    ];
    blocks.extend(method_tables(results).into_iter().map(Block::Table));
    Section::new("Table 3: the cost of both methods", blocks)
}

/// Table 3, and where the time goes.
pub fn method_tables(results: &methods::Results) -> Vec<Table> {
    let most = results.most_threads();
    let (sph, isph) = (MethodName::Wcsph, MethodName::IsphPaper);
    let ratios = results.ratios();
    let rows = results.serial(sph).map(|cost| {
        let n = cost.particles;
        let of = |method, threads| results.find(method, n, threads);
        let total = |method, threads| cell(of(method, threads).map(methods::Cost::of_2000_steps));
        let each = |method| cell(of(method, 1).map(methods::Cost::per_particle_step));
        vec![
            n.to_string(),
            total(sph, 1),
            total(isph, 1),
            each(sph),
            each(isph),
            cell(ratios.iter().find(|(size, _)| *size == n).map(|(_, ratio)| *ratio)),
            cell(of(isph, 1).and_then(|cost| cost.iterations)),
            cell(at(printed::SPH_2000_STEPS, n)),
            cell(at(printed::ISPH_2000_STEPS, n)),
        ]
    });
    let head =
        ["particles", "SPH [s]", "ISPH [s]", "SPH [us]", "ISPH [us]", "ISPH / SPH", "iterations", "paper: SPH [s]", "paper: ISPH [s]"];
    let caption = format!(
        "Table 3: time of 2000 steps on one thread, in seconds; microseconds for a particle and a step; mean iterations of the pressure solver. \
         {NOT_KNOWN}"
    );
    let cost = table(caption, &head, rows.collect());

    let parallel = results.serial(sph).map(|cost| {
        let times = |method| {
            let [one, all] = [1, most].map(|threads| results.find(method, cost.particles, threads).map(methods::Cost::of_2000_steps));
            [cell(one), cell(all), cell(one.zip(all).map(|(one, all)| one / all))]
        };
        [vec![cost.particles.to_string()], times(sph).to_vec(), times(isph).to_vec()].concat()
    });
    let with = |name: &str| format!("{name}, {} [s]", threads_text(most));
    let head = ["particles", "SPH [s]", &with("SPH"), "speed-up", "ISPH [s]", &with("ISPH"), "speed-up"];
    let parallel = table("2000 steps on one thread and on all.", &head, parallel.collect());

    let mut names: Vec<&str> = Vec::new();
    for (name, _) in results.costs.iter().flat_map(|cost| &cost.phases) {
        if !names.contains(name) {
            names.push(name);
        }
    }
    let largest = results.costs.iter().map(|cost| cost.particles).max().unwrap_or(0);
    let phases = names.into_iter().map(|name| {
        let share = |method| {
            let cost = results.find(method, largest, 1)?;
            let (_, seconds) = cost.phases.iter().find(|(known, _)| *known == name)?;
            Some(1e6 * seconds / (cost.steps as f64 * cost.particles as f64))
        };
        vec![name.to_owned(), cell(share(sph)), cell(share(isph))]
    });
    let caption = format!("Microseconds for a particle and a step by phase, {largest} particles, one thread.");
    let phases = table(caption, &["phase", "SPH [us]", "ISPH [us]"], phases.collect());
    if most > 1 { vec![cost, parallel, phases] } else { vec![cost, phases] }
}

// ---- flows ------------------------------------------------------------------------------------------------------------------

fn flow_section(results: &flows::Results) -> Section {
    let over_time = |title: &str, y: &str, flows: &[&Flow], value: &dyn Fn(&Flow, &Sample) -> f64| {
        let mut plot = half(title);
        plot.x = Axis::linear("t [s]");
        plot.y = Axis::linear(y);
        plot.series =
            flows.iter().enumerate().map(|(i, flow)| Series::line(&*flow.name, i, flow.series(|sample| value(flow, sample)))).collect();
        plot
    };
    let water = [&results.sph, &results.isph, &results.isph_17];
    let sph_and_isph = [&results.sph, &results.isph];
    let all = results.all();

    let mut fronts = over_time("Front", "x / L", &all, &|flow, sample| {
        flow.references.first().map_or(f64::NAN, |reference| sample.front * reference.value_scale)
    });
    let references = results.sph.references.iter().filter(|reference| reference.quantity == "front");
    fronts.x.range = Some([0.0, 0.8]);
    fronts.y.range = Some([1.0, 4.0]);
    fronts.series.extend(references.enumerate().map(|(mark, reference)| {
        Series::reference(&*reference.name, mark, reference.points.iter().map(|p| [p[0] / reference.time_scale, p[1]]).collect())
    }));
    let height = over_time("Height of the water at the back wall", "height [m]", &all, &|_, sample| sample.residual_height);
    let mut noise = over_time("Pressure noise", "noise / \u{3c1}gH", &water, &|_, sample| sample.quality.pressure_noise);
    // The lattice at the start has none.
    noise.y = Axis { range: Some([1e-3, 10.0]), ..Axis::log("noise / \u{3c1}gH") };
    let pressure = over_time("Pressure on the right wall at 0.1 H", "p / \u{3c1}gH", &water, &|flow, sample| {
        sample.wall_pressure / flow.pressure_scale
    });
    let energy = over_time("Energy of the fluid", "E / E(0)", &water, &|flow, sample| {
        flow.samples.first().map_or(f64::NAN, |first| sample.energy / first.energy)
    });
    let gap = over_time("Gap at the right wall", "gap [spacings]", &sph_and_isph, &|_, sample| sample.gap);
    let density = [(&results.sph, 0), (&results.sph_printed, 1)].map(|(flow, ink)| {
        let bands = flow.samples.iter().map(|s| [s.time, s.quality.density_p01, s.quality.density_p99]);
        Series { band: bands.collect(), ..Series::line(&*flow.name, ink, flow.series(|sample| sample.quality.density_mean)) }
    });
    let mut densities = half("Density of SPH");
    densities.x = Axis::linear("t [s]");
    densities.y = Axis::linear("density / rest");
    densities.series = density.to_vec();

    let (columns_ready, columns_printed) = (results.sph.particles, results.sph_printed.particles);
    let rows = all.iter().map(|flow| {
        let (low, high) = flow
            .samples
            .iter()
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), sample| (low.min(sample.density[0]), high.max(sample.density[1])));
        let leads = flow.leads();
        let ends = [leads.iter().copied().reduce(f64::min), leads.iter().copied().reduce(f64::max)];
        vec![
            flow.name.clone(),
            flow.particles.to_string(),
            flow.steps.to_string(),
            format!("{:.3}", flow.end),
            match ends {
                [Some(low), Some(high)] => format!("{low:+.0} to {high:+.0}"),
                _ => "\u{2013}".into(),
            },
            cell(super::claims::noise(flow, 0.0, IMPACT)),
            cell(super::claims::noise(flow, IMPACT, f64::INFINITY)),
            format!("{low:.3} to {high:.3}"),
            flow.samples.last().map_or(0, |sample| sample.quality.lost_particles).to_string(),
        ]
    });
    let mut blocks = vec![
        Block::Text(format!(
            "Dam breaks run for the claims below: with little dissipation (preset water, {columns_ready} particles), ISPH with the pressure \
             operators (16) and (17), and both methods exactly as printed (case dam-break-printed, {columns_printed} particles)."
        )),
        Block::Table(table(
            "The flows. Leads in time over the experiments, in percent; median pressure noise over \u{3c1}gH before and after impact; least and \
             greatest density of any fluid particle over rest; particles lost.",
            &["flow", "particles", "steps", "reached [s]", "lead [%]", "noise before", "noise after", "density", "lost"],
            rows.collect(),
        )),
    ];
    let stopped: Vec<String> =
        all.iter().filter_map(|flow| Some(format!("{} ended early: {}.", flow.name, flow.stopped.as_deref()?))).collect();
    blocks.extend(stopped.into_iter().map(Block::Notice));
    blocks.extend([
        Block::Figures(vec![
            figure("fronts", &fronts, "Front against the experiments, in widths L of the column."),
            figure("residual-height", &height, "Height of the water at the wall that the column stood at."),
        ]),
        Block::Figures(vec![
            figure("pressure-noise", &noise, "Root mean square residual of a local linear fit of the pressure, interior fluid."),
            figure("wall-pressure", &pressure, "Sampled every 0.02 s: peaks shorter than that are not shown."),
        ]),
        Block::Figures(vec![
            figure("density", &densities, "Mean and, shaded, 1st to 99th percentile of interior fluid."),
            figure("energy", &energy, "Kinetic, potential and, for SPH, that of compression."),
        ]),
        Block::Figure(figure(
            "wall-gap",
            &LinePlot { size: WIDE, ..gap },
            format!(
                "Mean distance of the nearest fluid particles from the first line of the right wall, up to {WALL_SHARE} H above the floor; read \
                 from {} to {} s for the claim.",
                AFTER_IMPACT[0], AFTER_IMPACT[1]
            ),
        )),
    ]);
    Section::new("The flows", blocks)
}

// ---- claims -----------------------------------------------------------------------------------------------------------------

fn claim_section(measured: &Measured) -> Section {
    let rows = measured
        .claims
        .iter()
        .map(|claim| vec![claim.claim.to_owned(), claim.verdict.text().to_owned(), claim.measured.clone(), claim.rule.clone()]);
    let claims = Table {
        caption: "What the paper says, whether it is so here, the numbers, and the rule that decides.".into(),
        head: ["claim", "verdict", "measured", "rule"].map(str::to_owned).to_vec(),
        rows: rows.collect(),
        cells: Cells::Words,
    };
    Section::new("Claims of the paper", vec![Block::Table(claims)])
}
