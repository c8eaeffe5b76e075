//! Plots draw what they are given, and nothing breaks them.

use greenwater_report::flow::color;
use greenwater_report::plot::{Axis, LinePlot, Series, png_from_svg};

/// The x and y of every vertex of the first line of a plot.
fn vertices(svg: &str) -> Vec<[f64; 2]> {
    let document = roxmltree::Document::parse(svg).unwrap();
    let line = document.descendants().find(|n| n.attribute("stroke-linejoin").is_some()).unwrap();
    let text = line.attribute("d").unwrap().replace(['M', 'L'], " ; ");
    let numbers = |part: &str| part.split_whitespace().map(|n| n.parse().unwrap()).collect::<Vec<f64>>();
    text.split(';').map(numbers).filter(|p| p.len() == 2).map(|p| [p[0], p[1]]).collect()
}

#[test]
fn a_power_law_is_straight_on_logarithmic_axes() {
    let mut plot = LinePlot::new("search", "particles", "time [s]");
    (plot.x, plot.y) = (Axis::log("particles"), Axis::log("time [s]"));
    plot.series.push(Series::line("direct", 0, (1..=3).map(|i| 10f64.powi(i)).map(|n| [n, 1e-6 * n * n]).collect()));
    let [a, b, c] = vertices(&plot.svg())[..] else { panic!("three points") };
    // Coordinates are written with one decimal.
    assert!((a[0] + c[0] - 2.0 * b[0]).abs() <= 0.2 && (a[1] + c[1] - 2.0 * b[1]).abs() <= 0.2, "{a:?} {b:?} {c:?}");
}

#[test]
fn a_long_series_is_thinned_but_keeps_its_peak() {
    let mut plot = LinePlot::new("pressure", "time [s]", "pressure [Pa]");
    let spike = |i: usize| if i == 61_803 { 1000.0 } else { (i as f64 * 0.01).sin() };
    plot.series.push(Series::line("P1", 0, (0..100_000).map(|i| [i as f64, spike(i)]).collect()));
    let drawn = vertices(&plot.svg());
    assert!(drawn.len() < 6000, "{} points for a plot 720 px wide", drawn.len());
    let highest = drawn.iter().map(|p| p[1]).fold(f64::INFINITY, f64::min);
    let second = drawn.iter().map(|p| p[1]).filter(|y| *y > highest).fold(f64::INFINITY, f64::min);
    assert!(second - highest > 100.0, "the spike of 1000 among values below 1 was lost");
}

#[test]
fn odd_data_is_drawn_without_breaking_the_picture() {
    let odd: [Vec<[f64; 2]>; 6] = [
        vec![],
        vec![[f64::NAN, 1.0], [1.0, f64::INFINITY]],
        vec![[1.0, 5.0]],
        vec![[0.0, -1.0], [1.0, 0.0]],
        vec![[0.0, 1e300], [1e-300, -1e300]],
        vec![[1.0, 1.0], [0.0, 2.0], [1.0, 1.0]],
    ];
    for points in odd {
        for y in [Axis::linear("y [1] <&>"), Axis::log("y [1]")] {
            let mut plot = LinePlot::new("odd", "x [1]", "y");
            plot.y = y;
            plot.series.push(Series::both("a \"series\"", 7, points.clone()));
            let svg = plot.svg();
            roxmltree::Document::parse(&svg).expect("well formed");
            assert!(!svg.contains("NaN") && !svg.contains("inf"), "{points:?}");
            png_from_svg(&svg, 1.0).expect("can be drawn");
        }
    }
}

#[test]
fn a_png_without_size_is_refused() {
    let svg = LinePlot::new("t", "x", "y").svg();
    for scale in [0.0, -1.0, 1e6, f32::NAN] {
        png_from_svg(&svg, scale).expect_err("no picture");
    }
    png_from_svg("<svg", 1.0).expect_err("no svg");
}

#[test]
fn colours_run_from_dark_to_light_and_clip() {
    // The ends of viridis as published.
    assert_eq!([color(-1.0), color(0.0), color(1.0), color(9.0)], ["#440154", "#440154", "#fde725", "#fde725"]);
    let light = |f: f64| {
        let rgb = u32::from_str_radix(&color(f)[1..], 16).unwrap();
        let part = |shift: u32| f64::from((rgb >> shift) & 255);
        0.2126 * part(16) + 0.7152 * part(8) + 0.0722 * part(0)
    };
    let steps: Vec<f64> = (0..=64).map(|i| light(f64::from(i) / 64.0)).collect();
    assert!(steps.windows(2).all(|w| w[1] > w[0] - 0.5), "lightness must not fall");
}

#[test]
fn a_series_that_drowns_the_others_is_cut_and_named() {
    let line = |name: &str, n, most: f64| Series::line(name, n, vec![[0.0, 0.0], [1.0, most], [2.0, -0.5 * most]]);
    let plot = |peaks: &[f64]| {
        let mut plot = LinePlot::new("pressure", "t [s]", "p [Pa]");
        plot.series.extend(peaks.iter().enumerate().map(|(n, &most)| line(&format!("m{n}"), n, most)));
        plot
    };
    let mut loud = plot(&[40.0, 700.0, 50.0, 90.0]);
    assert_eq!(loud.cut_to_quieter(), [("m1".to_owned(), [-350.0, 700.0])]);
    // The next one goes from -45 to 90; a twentieth of that on both sides.
    assert_eq!(loud.y.range, Some([-51.75, 96.75]));
    for whole in [&[700.0, 40.0][..], &[120.0, 90.0, 50.0], &[700.0, 0.0, 0.0], &[]] {
        let mut plot = plot(whole);
        assert!(plot.cut_to_quieter().is_empty() && plot.y.range.is_none(), "{whole:?}");
    }
}
