//! What every processor can do.

use super::{Entry, LANES, Lanes};

all_slices!();

fn spread<C: Entry, const S: usize>(columns: &[C], w: [&[Lanes<f32>]; S], x: &[f32]) -> [Lanes<f32>; S] {
    let mut total = [Lanes::default(); S];
    for (k, columns) in columns.iter().enumerate() {
        let x: [f32; LANES] = std::array::from_fn(|lane| x[columns.column(lane) as usize]);
        for (total, w) in total.iter_mut().zip(w) {
            for lane in 0..LANES {
                total.0[lane] += w[k].0[lane] * x[lane];
            }
        }
    }
    total
}

fn join<C: Entry, const S: usize>(columns: &[C], w: [&[Lanes<f32>]; S], x: &[[f32; S]]) -> Lanes<f32> {
    let mut total = Lanes::default();
    for (k, columns) in columns.iter().enumerate() {
        for (s, w) in w.iter().enumerate() {
            for lane in 0..LANES {
                total.0[lane] += w[k].0[lane] * x[columns.column(lane) as usize][s];
            }
        }
    }
    total
}

pub(super) fn rise<C: Entry, const S: usize>(columns: &[C], w: [&[Lanes<f32>]; S], x: &[f64], own: &Lanes<f64>) -> [Lanes<f64>; S] {
    let mut total = [Lanes::default(); S];
    for (k, columns) in columns.iter().enumerate() {
        for lane in 0..LANES {
            let rise = x[columns.column(lane) as usize] - own.0[lane];
            for (total, w) in total.iter_mut().zip(w) {
                total.0[lane] += f64::from(w[k].0[lane]) * rise;
            }
        }
    }
    total
}

pub(super) fn strain<C: Entry, const S: usize>(
    columns: &[C],
    w: [&[Lanes<f32>]; S],
    x: &[[f64; S]],
    own: &[Lanes<f64>; S],
) -> [[Lanes<f64>; S]; S] {
    let mut total = [[Lanes::default(); S]; S];
    for (k, columns) in columns.iter().enumerate() {
        for lane in 0..LANES {
            let x = &x[columns.column(lane) as usize];
            for (i, total) in total.iter_mut().enumerate() {
                let rise = x[i] - own[i].0[lane];
                for (total, w) in total.iter_mut().zip(w) {
                    total.0[lane] += f64::from(w[k].0[lane]) * rise;
                }
            }
        }
    }
    total
}

fn sum<C: Entry>(columns: &[C], w: &[Lanes<f32>], x: &[f64]) -> Lanes<f64> {
    let mut total = Lanes::default();
    for (columns, w) in columns.iter().zip(w) {
        for lane in 0..LANES {
            total.0[lane] += f64::from(w.0[lane]) * x[columns.column(lane) as usize];
        }
    }
    total
}
