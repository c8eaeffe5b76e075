//! Says in plain words what the numbers show. Every word is chosen by the sign and size of a measured number.

use crate::measure::Measured;

/// Ratios below this are called no clear difference.
const CLEAR_RATIO: f64 = 1.1;

/// A sentence to remember, and the numbers behind it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finding {
    /// What the numbers say.
    pub headline: String,
    /// The numbers.
    pub detail: String,
}

/// A number with three significant digits; powers of ten outside 0.001 ... 999999.
pub fn number(value: f64) -> String {
    if !value.is_finite() {
        return "no value".into();
    }
    if value == 0.0 {
        return "0".into();
    }
    let sign = if value < 0.0 { "\u{2212}" } else { "" };
    // Scientific notation rounds first, so that 9.999 becomes 10 and not 10.00.
    let text = format!("{:.2e}", value.abs());
    let (mantissa, exponent) = text.split_once('e').unwrap_or((&text, "0"));
    let exponent: i32 = exponent.parse().unwrap_or(0);
    if (-3..6).contains(&exponent) {
        let digits = (2 - exponent).max(0) as usize;
        return format!("{sign}{}", trim(&format!("{:.digits$}", value.abs())));
    }
    let mantissa = trim(mantissa);
    let power = format!("10{}", superscript(exponent));
    if mantissa == "1" { format!("{sign}{power}") } else { format!("{sign}{mantissa}\u{d7}{power}") }
}

fn trim(text: &str) -> &str {
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.') } else { text }
}

fn superscript(exponent: i32) -> String {
    let digit = |c: char| match c {
        '-' => '\u{207b}',
        '1' => '\u{b9}',
        '2' => '\u{b2}',
        '3' => '\u{b3}',
        c => char::from_u32(0x2070 + c.to_digit(10).unwrap_or(0)).unwrap_or(c),
    };
    exponent.to_string().chars().map(digit).collect()
}

/// A number with its unit, or `not known`.
pub fn quantity(value: Option<f64>, unit: &str) -> String {
    match value {
        Some(value) if value.is_finite() => format!("{} {unit}", number(value)).trim_end().to_owned(),
        _ => "not known".into(),
    }
}

/// A fraction as percent with sign: `+1.2 %`.
pub fn signed_percent(fraction: f64) -> String {
    let sign = if fraction > 0.0 { "+" } else { "" };
    format!("{sign}{} %", number(round_to(100.0 * fraction, 0.01)))
}

/// A duration: `0.21 s`, `12.3 s`, `3 min 20 s`, `2 h 5 min`.
pub fn duration(seconds: f64) -> String {
    if !seconds.is_finite() || seconds < 120.0 {
        return quantity(Some(seconds), "s");
    }
    let whole = seconds.round() as u64;
    if whole < 7200 { format!("{} min {} s", whole / 60, whole % 60) } else { format!("{} h {} min", whole / 3600, whole % 3600 / 60) }
}

/// Names joined: `a`, `a and b`, `a, b and c`.
pub fn join(items: &[String]) -> String {
    match items {
        [] => String::new(),
        [one] => one.clone(),
        [most @ .., last] => format!("{} and {last}", most.join(", ")),
    }
}

fn round_to(value: f64, step: f64) -> f64 {
    (value / step).round() * step
}

/// A ratio >= 1 in words, `None` if it is no clear difference.
fn times(ratio: f64) -> Option<String> {
    if !ratio.is_finite() || ratio < CLEAR_RATIO {
        return None;
    }
    let digits = usize::from(ratio < 9.95);
    Some(format!("{ratio:.digits$} times"))
}

/// The key findings, in order of what users ask first.
pub fn findings(methods: &[Measured]) -> Vec<Finding> {
    // A run that stopped early has seen less of the flow: its totals are compared only if none got further.
    let finished: Vec<Measured> = methods.iter().filter(|m| m.completed).cloned().collect();
    let compared = if finished.is_empty() { methods } else { &finished };
    let mut all = vec![completion(methods)];
    all.push(noise(compared));
    all.extend(fronts(methods));
    all.extend(peaks(compared));
    all.push(density(compared));
    all.extend(energy(compared));
    all.extend(cost(compared));
    all.extend(complaints(methods));
    all
}

fn each(methods: &[Measured], say: impl Fn(&Measured) -> String) -> String {
    match methods {
        [one] => say(one),
        _ => methods.iter().map(|m| format!("{} {}", m.name, say(m))).collect::<Vec<_>>().join("; "),
    }
}

fn completion(methods: &[Measured]) -> Finding {
    let stopped: Vec<String> = methods.iter().filter(|m| !m.completed).map(|m| m.name.clone()).collect();
    let headline = if stopped.is_empty() {
        match methods {
            [one] => format!("{} reached its end", one.name),
            [_, _] => "Both methods reached the end".into(),
            _ => format!("All {} methods reached the end", methods.len()),
        }
    } else {
        format!("{} did not reach the end", join(&stopped))
    };
    let lost: u64 = methods.iter().filter_map(|m| m.lost_particles).sum();
    let unknown = methods.iter().any(|m| m.lost_particles.is_none());
    let particles = match (lost, unknown) {
        (0, false) => "No particle was lost".to_owned(),
        (0, true) => "Whether particles were lost is not known for every method".to_owned(),
        _ => format!("Particles lost: {}", each(methods, |m| m.lost_particles.map_or("not known".into(), |n| n.to_string()))),
    };
    let ends = each(methods, |m| quantity(m.end_time, "s"));
    let left_out = if stopped.is_empty() || stopped.len() == methods.len() {
        ""
    } else {
        " Noise, pressure peaks, density, energy and cost are compared between the finished runs only."
    };
    Finding { headline, detail: format!("Time reached: {ends}. {particles}.{left_out}") }
}

/// Least and greatest of a measured value with the methods they belong to; at least one must have it.
fn extremes(methods: &[Measured], of: impl Fn(&Measured) -> Option<f64>) -> Option<[(&Measured, f64); 2]> {
    let mut with: Vec<(&Measured, f64)> = methods.iter().filter_map(|m| Some((m, of(m).filter(|v| v.is_finite())?))).collect();
    with.sort_by(|a, b| a.1.total_cmp(&b.1));
    Some([*with.first()?, *with.last()?])
}

fn noise(methods: &[Measured]) -> Finding {
    let detail = format!(
        "Pressure noise over \u{3c1}gH: {}. It is the RMS residual of a local linear fit of the pressure over \
         neighbours within 3 spacings, interior fluid; the median of the frames from a quarter to half of the end time.",
        each(methods, |m| quantity(m.pressure_noise, ""))
    );
    let headline = match extremes(methods, |m| m.pressure_noise) {
        None => "How smooth the pressure is cannot be said: the runs left no noise figure".into(),
        Some([(m, noise), _]) if methods.len() == 1 => {
            format!("The pressure of {} has a noise of {} of \u{3c1}gH", m.name, number(noise))
        }
        Some([(best, low), (worst, high)]) => {
            if std::ptr::eq(best, worst) {
                format!("Only {} left a pressure noise: {} of \u{3c1}gH", best.name, number(low))
            } else if low <= 0.0 && high > 0.0 {
                format!("The pressure of {} has no noise at all, that of {} {}", best.name, worst.name, number(high))
            } else {
                match times(high / low) {
                    Some(ratio) => format!(
                        "The {} pressure is {ratio} smoother than that of {}: noise {} against {} of \u{3c1}gH",
                        best.name,
                        worst.name,
                        number(low),
                        number(high)
                    ),
                    None => "No clear difference in pressure smoothness".into(),
                }
            }
        }
    };
    Finding { headline, detail }
}

fn fronts(methods: &[Measured]) -> Option<Finding> {
    let range = |m: &Measured| {
        let leads = || m.leads.iter().filter(|lead| lead.quantity == "front").map(|lead| lead.percent);
        Some((leads().reduce(f64::min)?, leads().reduce(f64::max)?))
    };
    let say = |m: &Measured| {
        let Some((low, high)) = range(m) else { return format!("{} cannot be compared", m.name) };
        let (low, high) = (low.round(), high.round());
        let span = |a: f64, b: f64| if a == b { format!("{a:.0} %") } else { format!("{a:.0} to {b:.0} %") };
        if low > 0.0 {
            format!("{} is {} ahead", m.name, span(low, high))
        } else if high < 0.0 {
            format!("{} is {} behind", m.name, span(-high, -low))
        } else if low == 0.0 && high == 0.0 {
            format!("{} agrees within half a percent", m.name)
        } else {
            format!("{} lies between {:.0} % behind and {high:.0} % ahead", m.name, -low)
        }
    };
    methods.iter().any(|m| range(m).is_some()).then(|| {
        let mut references: Vec<&str> = Vec::new();
        for lead in methods.iter().flat_map(|m| &m.leads).filter(|lead| lead.quantity == "front") {
            if !references.contains(&lead.reference.as_str()) {
                references.push(&lead.reference);
            }
        }
        let said: Vec<String> = methods.iter().map(say).collect();
        let mut detail = format!(
            "Lead in time over {}, at the front positions where both have data.",
            join(&references.iter().map(|name| (*name).to_owned()).collect::<Vec<_>>())
        );
        if let Some(gap) = front_gap(methods) {
            detail.push(' ');
            detail.push_str(&gap);
        }
        Finding { headline: format!("Front against the references: {}", said.join("; ")), detail }
    })
}

/// How far the fronts of the first two methods lie apart at the end of what both have, in percent of time.
fn front_gap(methods: &[Measured]) -> Option<String> {
    let [a, b, ..] = methods else { return None };
    let reach = |m: &Measured| m.front.iter().map(|p| p[1]).filter(|x| x.is_finite()).reduce(f64::max);
    let start = a.front.iter().map(|p| p[1]).find(|x| x.is_finite())?;
    let level = start + 0.8 * (reach(a)?.min(reach(b)?) - start);
    let (ta, tb) = (crate::measure::crossing(&a.front, level)?, crate::measure::crossing(&b.front, level)?);
    let (first, second, gap) = if ta <= tb { (a, b, (tb - ta) / tb) } else { (b, a, (ta - tb) / ta) };
    if !gap.is_finite() {
        return None;
    }
    Some(if gap < 0.005 {
        format!("The two fronts reach x = {} m within half a percent of each other.", number(level))
    } else {
        format!(
            "The front of {} reaches x = {} m {} % earlier than that of {}.",
            first.name,
            number(level),
            number(round_to(100.0 * gap, 0.1)),
            second.name
        )
    })
}

fn peaks(methods: &[Measured]) -> Option<Finding> {
    let peak = |m: &Measured, name: &str| m.probes.iter().find(|p| p.name == name).map(|p| p.peak.value);
    let mut names: Vec<&str> = Vec::new();
    for probe in methods.iter().flat_map(|m| &m.probes) {
        if !names.contains(&probe.name.as_str()) {
            names.push(&probe.name);
        }
    }
    let detail = names
        .iter()
        .map(|name| {
            let said = each(methods, |m| match m.probes.iter().find(|p| p.name == *name) {
                Some(p) => format!("{} Pa at {} s, mean {} Pa", number(p.peak.value), number(p.peak.time), number(p.mean)),
                None => "no data".into(),
            });
            format!("Highest pressure at {name}: {said}.")
        })
        .collect::<Vec<_>>()
        .join(" ");
    // The probe at which the methods differ most.
    let spread = |name: &str| {
        let [(low, least), (high, most)] = extremes(methods, |m| peak(m, name))?;
        Some((most / least, low, high)).filter(|(ratio, ..)| ratio.is_finite() && least > 0.0)
    };
    let widest = names.iter().filter_map(|name| Some((*name, spread(name)?))).max_by(|a, b| a.1.0.total_cmp(&b.1.0));
    let headline = match widest {
        _ if names.is_empty() => return None,
        Some((name, (ratio, low, high))) if !std::ptr::eq(low, high) => match times(ratio) {
            Some(ratio) => {
                format!("At {name} the pressure peak of {} is {ratio} that of {}", high.name, low.name)
            }
            None => "No clear difference in the pressure peaks at the probes".into(),
        },
        _ => {
            let (name, peak) =
                methods.iter().flat_map(|m| &m.probes).map(|p| (p.name.as_str(), p.peak)).max_by(|a, b| a.1.value.total_cmp(&b.1.value))?;
            if peak.value == 0.0 {
                "No probe felt any pressure".into()
            } else {
                format!("The highest wall pressure is {} Pa, at {name} at {} s", number(peak.value), number(peak.time))
            }
        }
    };
    Some(Finding { headline, detail })
}

fn density(methods: &[Measured]) -> Finding {
    let spread = |m: &Measured| match (m.density.p01, m.density.p99) {
        (Some(low), Some(high)) => format!("{} to {} of rest", signed_percent(low - 1.0), signed_percent(high - 1.0)),
        _ => "not known".into(),
    };
    let volume = each(methods, |m| m.volume_error.map_or("not known".into(), signed_percent));
    let detail = format!("1st to 99th percentile of the density: {}. Volume error at the end: {volume}.", each(methods, spread));
    let percent = |error: f64| format!("{} %", number(round_to(100.0 * error, 0.01)));
    let headline = match extremes(methods, Measured::density_error) {
        None => "How well the density is kept cannot be said: the runs left no density percentiles".into(),
        Some([(best, low), (worst, high)]) => {
            let clear = !std::ptr::eq(best, worst) && times(high / low).is_some();
            if clear {
                format!(
                    "{} keeps its density closest to rest: within {}, against {} for {}",
                    best.name,
                    percent(low),
                    percent(high),
                    worst.name
                )
            } else if methods.len() == 1 || std::ptr::eq(best, worst) {
                format!("{} keeps its density within {} of rest", best.name, percent(low))
            } else {
                format!("No clear difference in density: within {} of rest", percent(high))
            }
        }
    };
    Finding { headline, detail }
}

fn energy(methods: &[Measured]) -> Option<Finding> {
    let [(low, least), (high, most)] = extremes(methods, |m| m.energy.map(|e| e.loss()))?;
    let percent = |fraction: f64| format!("{} %", number(round_to(100.0 * fraction, 0.1)));
    let changed = |m: &Measured, loss: f64| {
        if loss >= 0.0 { format!("{} loses {}", m.name, percent(loss)) } else { format!("{} gains {}", m.name, percent(-loss)) }
    };
    let headline = if methods.len() == 1 || std::ptr::eq(low, high) {
        format!("{} of its initial energy", changed(high, most))
    } else if (most - least).abs() < 0.01 {
        format!("No clear difference in energy: {} of its initial energy at the end", changed(high, most))
    } else {
        format!("{} of its initial energy, {}", changed(high, most), changed(low, least))
    };
    let rising: Vec<String> = methods
        .iter()
        .filter_map(|m| Some((m, m.energy?.max_rise)).filter(|(_, rise)| *rise > 0.01))
        .map(|(m, rise)| format!("{} by {}", m.name, percent(rise)))
        .collect();
    let detail = if rising.is_empty() {
        "The total energy never rises more than 1 % above its start.".into()
    } else if methods.iter().any(|m| m.driven) {
        format!(
            "The total energy rises above its start, since walls that move, or gravity along a repeating axis, do work on the fluid: {}.",
            join(&rising)
        )
    } else {
        format!("The total energy rises above its start, which no passive flow does: {}.", join(&rising))
    };
    Some(Finding { headline, detail })
}

fn cost(methods: &[Measured]) -> Option<Finding> {
    let [(quick, short), (slow, long)] = extremes(methods, |m| m.wall_seconds)?;
    let headline = if std::ptr::eq(quick, slow) {
        format!("{} took {}", slow.name, duration(long))
    } else if let Some(ratio) = times(long / short) {
        format!("{} took {ratio} as long as {}: {} against {}", slow.name, quick.name, duration(long), duration(short))
    } else {
        format!("No clear difference in computing time: {} and {}", duration(short), duration(long))
    };
    let mut detail = vec![format!("Steps: {}.", each(methods, |m| m.steps.map_or("not known".into(), |n| n.to_string())))];
    if let Some([(cheap, low), (dear, high)]) = extremes(methods, Measured::seconds_per_step)
        && !std::ptr::eq(cheap, dear)
        && low > 0.0
    {
        let compared = match times(high / low) {
            Some(ratio) => format!("One step of {} costs {ratio} one of {}.", dear.name, cheap.name),
            None => "One step costs the same within 10 %.".into(),
        };
        detail.push(compared);
    }
    for method in methods {
        if let (Some((phase, seconds)), Some(wall)) = (method.phases.first(), method.wall_seconds.filter(|w| *w > 0.0)) {
            detail.push(format!("{} spends {:.0} % of its time in {phase}.", method.name, 100.0 * seconds / wall));
        }
    }
    Some(Finding { headline, detail: detail.join(" ") })
}

/// Pressure noise over `ρ g H` up to which a wall pressure serves for loads: a tenth of the margin that the usual partial factor
/// of 1.3 on environmental loads leaves (DNV-OS-C101, ultimate limit state).
const USABLE_NOISE: f64 = 0.03;
/// Volume error up to which the fluid counts as kept: the band of the validation suite.
const KEPT_VOLUME: f64 = 0.01;

/// The two complaints with which Afanasiev, Makarchuk & Popov (2008) end, and what the methods of this comparison make of them: the
/// explicit method has no usable pressure, the incompressible one loses particles after the impact.
fn complaints(methods: &[Measured]) -> Vec<Finding> {
    let pair = |old: &str, new: &str| {
        let find = |name: &str| methods.iter().find(|m| m.name == name);
        Some([find(old)?, find(new)?])
    };
    let loads = pair("wcsph", "delta-sph").and_then(loads_complaint);
    loads.into_iter().chain(pair("isph-paper", "isph").and_then(fluid_complaint)).collect()
}

fn loads_complaint(methods: [&Measured; 2]) -> Option<Finding> {
    let [before, after] = [methods[0].pressure_noise?, methods[1].pressure_noise?];
    let keeps = |m: &Measured, noise: f64| m.completed && noise <= USABLE_NOISE;
    let headline = answer(Answer {
        complaint: "SPH gives no usable loads",
        methods,
        keeps: [keeps(methods[0], before), keeps(methods[1], after)],
        worse: after > CLEAR_RATIO * before,
        values: [format!("pressure noise {} of \u{3c1}gH", number(before)), number(after)],
        rule: format!("up to {} is usable", number(USABLE_NOISE)),
    });
    Some(Finding {
        headline,
        detail: "Usable: a tenth of the margin that the usual partial factor of 1.3 on environmental loads leaves.".into(),
    })
}

/// Of what a run folder holds, lost particles and the volume answer the complaint. The percentiles of the density do not: they tell how
/// unevenly particles lie where it is worst, and no fluid is lost there.
fn fluid_complaint(methods: [&Measured; 2]) -> Option<Finding> {
    let fluid = |m: &Measured| Some((m.lost_particles?, m.worst_volume_error?.abs()));
    let [before, after] = [fluid(methods[0])?, fluid(methods[1])?];
    let keeps = |m: &Measured, (lost, error): (u64, f64)| m.completed && lost == 0 && error <= KEPT_VOLUME;
    let percent = |error: f64| format!("{} %", number(round_to(100.0 * error, 0.01)));
    let headline = answer(Answer {
        complaint: "ISPH loses its fluid after the impact",
        methods,
        keeps: [keeps(methods[0], before), keeps(methods[1], after)],
        worse: after.0 > before.0 || after.0 == before.0 && after.1 > CLEAR_RATIO * before.1,
        values: [
            format!("{} particles lost and a volume error of {}", before.0, percent(before.1)),
            format!("{} and {}", after.0, percent(after.1)),
        ],
        rule: format!("none lost and up to {} counts as kept", percent(KEPT_VOLUME)),
    });
    let density = |m: &Measured| m.density_error().map_or("not known".into(), percent);
    let detail = format!(
        "Volume error: mean volume of the fluid away from its surface, in the worst frame, measured alike for every method. It is not the \
         density of single places, which departs from rest where particles lie least evenly (1st and 99th percentile, worst frame): by {} with \
         {}, {} with {}.",
        density(methods[0]),
        methods[0].name,
        density(methods[1]),
        methods[1].name
    );
    Some(Finding { headline, detail })
}

/// What a method of the paper and the one after it make of a complaint.
struct Answer<'a> {
    complaint: &'a str,
    methods: [&'a Measured; 2],
    /// Whether each keeps to the rule.
    keeps: [bool; 2],
    /// Whether the later method is clearly the worse of the two.
    worse: bool,
    values: [String; 2],
    rule: String,
}

/// The verdict, both values and the rule.
fn answer(answer: Answer) -> String {
    let Answer { complaint, methods: [old, new], keeps, worse, values: [before, after], rule } = answer;
    let mut verdict = match keeps {
        [true, true] => "does not arise here".to_owned(),
        [true, false] => format!("does not arise with {}, but does with {}", old.name, new.name),
        [false, true] => format!("is gone with {}", new.name),
        [false, false] => format!("stands with {}", new.name),
    };
    if worse && keeps[0] == keeps[1] {
        verdict.push_str(&format!(", and {} does worse than {}", new.name, old.name));
    }
    let printed = old.preset.is_empty() || old.preset == "paper";
    let preset = if printed { String::new() } else { format!(" (preset {}, repaired)", old.preset) };
    let early = |m: &Measured| if m.completed { "" } else { ", which did not reach its end" };
    format!(
        "The paper's complaint that {complaint} {verdict}: {before} with {}{preset}{}, {after} with {}{}; {rule}",
        old.name,
        early(old),
        new.name,
        early(new)
    )
}
