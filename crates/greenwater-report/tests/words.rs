//! The sentences follow the numbers: sign, size and absence.

mod common;

use common::{Synthetic, scratch};
use greenwater_report::measure::{EnergyBudget, Lead, Measured};
use greenwater_report::run::Run;
use greenwater_report::words::{duration, findings, number, signed_percent};

/// Two finished methods with equal numbers.
fn twins(name: &str) -> [Measured; 2] {
    let dir = scratch(name);
    ["wcsph", "isph-paper"].map(|method| {
        let run = Run::read(&Synthetic::new(method).write(&dir.join(method))).unwrap();
        Measured { wall_seconds: Some(5.0), steps: Some(100), leads: Vec::new(), ..Measured::of(&run, &[]) }
    })
}

fn headlines(methods: &[Measured]) -> String {
    findings(methods).into_iter().map(|f| f.headline).collect::<Vec<_>>().join("\n")
}

#[test]
fn equal_numbers_are_called_no_clear_difference() {
    let text = headlines(&twins("words-equal"));
    assert!(text.contains("Both methods reached the end"), "{text}");
    assert_eq!(text.matches("No clear difference").count(), 5, "{text}");
}

#[test]
fn the_better_method_is_named_whichever_comes_first() {
    let [a, b] = twins("words-better");
    for (x, y, best) in [(0.1, 0.02, "isph-paper"), (0.02, 0.1, "wcsph")] {
        let methods = [Measured { pressure_noise: Some(x), ..a.clone() }, Measured { pressure_noise: Some(y), ..b.clone() }];
        let text = headlines(&methods);
        assert!(text.contains(&format!("The {best} pressure is 5.0 times smoother")), "{text}");
    }
}

#[test]
fn leads_and_lags_are_worded_by_their_sign() {
    let [mut a, mut b] = twins("words-sign");
    let lead = |percent| Lead { quantity: "front".into(), reference: "the tank test".into(), level: 2.0, percent };
    a.leads = vec![lead(4.0), lead(9.0)];
    b.leads = vec![lead(-6.0), lead(-6.2)];
    let text = headlines(&[a.clone(), b]);
    assert!(text.contains("wcsph is 4 to 9 % ahead; isph-paper is 6 % behind"), "{text}");
    a.leads = vec![lead(-3.0), lead(2.0)];
    assert!(headlines(&[a]).contains("between 3 % behind and 2 % ahead"));
}

#[test]
fn what_is_missing_is_said_to_be_missing() {
    let [a, b] = twins("words-missing");
    let empty = |m: &Measured| Measured {
        completed: false,
        pressure_noise: None,
        density: Default::default(),
        energy: None,
        probes: Vec::new(),
        loads: Vec::new(),
        wall_seconds: None,
        ..m.clone()
    };
    let text = headlines(&[empty(&a), empty(&b)]);
    assert!(text.contains("wcsph and isph-paper did not reach the end"), "{text}");
    assert!(text.contains("the runs left no noise figure") && text.contains("no density percentiles"), "{text}");
    assert!(!text.contains("NaN") && !text.contains("inf "), "{text}");
}

#[test]
fn energy_that_appears_from_nowhere_is_pointed_out() {
    let [a, _] = twins("words-energy");
    let energy = Some(EnergyBudget { initial: 1.0, last: 1.2, max_rise: 0.25 });
    let driven = findings(&[Measured { energy, driven: true, ..a.clone() }]);
    let finding = driven.iter().find(|f| f.headline.contains("energy")).unwrap();
    assert!(finding.detail.contains("do work on the fluid: wcsph by 25 %"), "{}", finding.detail);
    let all = findings(&[Measured { energy, ..a }]);
    let finding = all.iter().find(|f| f.headline.contains("energy")).unwrap();
    assert_eq!(finding.headline, "wcsph gains 20 % of its initial energy");
    assert!(finding.detail.contains("which no passive flow does: wcsph by 25 %"), "{}", finding.detail);
}

#[test]
fn numbers_have_three_digits_and_no_false_ones() {
    let cases = [
        (0.0, "0"),
        (0.004, "0.004"),
        (14715.0, "14715"),
        (9.999, "10"),
        (0.056_01, "0.056"),
        (-1.5, "\u{2212}1.5"),
        (1e-9, "10\u{207b}\u{2079}"),
        (2.5e7, "2.5\u{d7}10\u{2077}"),
        (f64::NAN, "no value"),
    ];
    for (value, text) in cases {
        assert_eq!(number(value), text, "{value}");
    }
    assert_eq!(signed_percent(0.012), "+1.2 %");
    assert_eq!(signed_percent(-0.5), "\u{2212}50 %");
    assert_eq!(duration(200.0), "3 min 20 s");
}

#[test]
fn a_run_that_stopped_early_is_left_out_of_comparisons() {
    let [a, b] = twins("words-stopped");
    let stopped = Measured { completed: false, name: "isph-exact".into(), pressure_noise: Some(1e-6), ..b.clone() };
    let text = headlines(&[a, b, stopped]);
    assert!(text.contains("isph-exact did not reach the end"), "{text}");
    assert!(text.contains("No clear difference in pressure smoothness"), "{text}");
}

/// The paper's two complaints: each is answered only where an old and a new method of its family stand side by side, with the values of
/// both and the rule.
#[test]
fn the_papers_complaints_are_answered_by_the_numbers() {
    let [old, new] = twins("words-complaints");
    assert!(!headlines(&[old.clone(), new.clone()]).contains("complaint"));
    let of = |name: &str, noise: f64, lost: u64, volume: f64| Measured {
        name: name.into(),
        pressure_noise: Some(noise),
        lost_particles: Some(lost),
        worst_volume_error: Some(volume),
        ..new.clone()
    };
    let four = |noise: [f64; 2], fluid: [(u64, f64); 2]| {
        headlines(&[
            of("wcsph", noise[0], 0, 0.0),
            of("isph-paper", 0.05, fluid[0].0, fluid[0].1),
            of("delta-sph", noise[1], 0, 0.0),
            of("isph", 0.001, fluid[1].0, fluid[1].1),
        ])
    };
    let holds = |text: &str, what: &[&str]| what.iter().for_each(|part| assert!(text.contains(part), "no `{part}` in\n{text}"));
    let gone = four([0.7, 0.01], [(3, -0.3), (0, 0.003)]);
    holds(
        &gone,
        &[
            "no usable loads is gone with delta-sph: pressure noise 0.7 of \u{3c1}gH with wcsph (preset water, repaired), 0.01 with delta-sph; up \
             to 0.03 is usable",
            "after the impact is gone with isph: 3 particles lost and a volume error of 30 % with isph-paper (preset water, repaired), 0 and \
             0.3 % with isph; none lost and up to 1 % counts as kept",
        ],
    );
    holds(&four([0.7, 0.2], [(3, 0.0), (2, 0.0)]), &["no usable loads stands with delta-sph:", "after the impact stands with isph:"]);
    // The later method is judged by the same rule as the one of the paper, whatever that one does.
    let worse = four([0.01, 0.04], [(0, 0.001), (0, -0.02)]);
    holds(
        &worse,
        &["does not arise with wcsph, but does with delta-sph", "does not arise with isph-paper, but does with isph: 0 particles"],
    );
    let both = four([0.01, 0.02], [(0, 0.001), (0, 0.001)]);
    holds(&both, &["loads does not arise here, and delta-sph does worse than wcsph", "impact does not arise here: 0 particles lost"]);
    let stopped = Measured { completed: false, preset: "paper".into(), ..of("isph-paper", 0.05, 0, 0.0) };
    let text = headlines(&[stopped, of("isph", 0.001, 0, 0.0)]);
    holds(&text, &["is gone with isph: 0 particles lost and a volume error of 0 % with isph-paper, which did not reach its end, 0 and"]);
}
