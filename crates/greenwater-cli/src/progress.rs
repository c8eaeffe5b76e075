//! What is shown while a run goes on.

use std::io::{self, IsTerminal};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use greenwater::case::Setup;
use greenwater::observe::{Observer, View, energy};
use greenwater::physics::pressure::Elasticity;
use greenwater::scheme::Medium;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use crate::console;

/// Set by Ctrl-C.
static STOP: AtomicBool = AtomicBool::new(false);

/// Lets Ctrl-C end a run in good order; pressed again it ends the program at once.
pub fn catch_ctrl_c() {
    // Without a handler Ctrl-C ends the program as usual.
    let _ = ctrlc::set_handler(|| {
        if STOP.swap(true, Ordering::Relaxed) {
            std::process::exit(130);
        }
    });
}

/// How much is shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Show {
    /// Progress on standard error.
    Progress,
    /// Nothing.
    Nothing,
}

/// Steps of the bar.
const TICKS: u64 = 1000;
/// Share of the run between two lines where there is no terminal.
const LINE_SHARE: f64 = 0.05;
/// Longest time between two such lines.
const LINE_EVERY: Duration = Duration::from_secs(10);
/// Least time between two such lines, and between two looks at the energy.
const LINE_LEAST: Duration = Duration::from_millis(500);
/// Time between two redrawings of the bar.
const BAR_EVERY: Duration = Duration::from_millis(100);

/// A bar on a terminal, plain lines elsewhere.
pub struct Progress<const D: usize> {
    label: String,
    end: f64,
    medium: Medium<D>,
    elasticity: Elasticity,
    energy: Option<f64>,
    bar: Option<ProgressBar>,
    show: Show,
    last: Instant,
    next_share: f64,
}

impl<const D: usize> Progress<D> {
    /// Progress of a run called `label`.
    pub fn new(setup: &Setup<D>, label: &str, show: Show) -> Self {
        let on_terminal = show == Show::Progress && io::stderr().is_terminal();
        let bar = on_terminal.then(|| {
            let bar = ProgressBar::with_draw_target(Some(TICKS), ProgressDrawTarget::stderr());
            let style = ProgressStyle::with_template("{prefix} {bar:24} {msg}").unwrap_or_else(|_| ProgressStyle::default_bar());
            bar.set_style(style);
            bar.set_prefix(label.to_owned());
            bar
        });
        Self {
            label: label.to_owned(),
            end: setup.time.end,
            medium: setup.medium(),
            elasticity: setup.method.elasticity(&setup.medium()),
            energy: None,
            bar,
            show,
            last: Instant::now(),
            next_share: LINE_SHARE,
        }
    }

    fn message(&mut self, view: &View<D>) -> String {
        let now = energy(view.particles, &self.medium, self.elasticity).total();
        let before = *self.energy.get_or_insert(now);
        let step = view.limit.map(|limit| format!(", dt {:.2e} s ({})", limit.dt, limit.name)).unwrap_or_default();
        let iterations = view.report.iterations.map(|n| format!(", {n} iterations")).unwrap_or_default();
        let change = if before == 0.0 { String::new() } else { format!(", energy {:+.1} %", 100.0 * (now - before) / before.abs()) };
        let left = if view.time > 0.0 { view.elapsed * (self.end / view.time - 1.0) } else { f64::NAN };
        let eta = if left.is_finite() { format!(", {} left", console::duration(left.max(0.0))) } else { String::new() };
        let particles = view.particles.owned();
        format!("t {:.4}/{} s, step {}{step}, {particles} particles{iterations}{change}{eta}", view.time, self.end, view.step)
    }
}

impl<const D: usize> Observer<D> for Progress<D> {
    fn observe(&mut self, view: &View<D>) -> io::Result<()> {
        if STOP.load(Ordering::Relaxed) {
            return Err(io::Error::new(io::ErrorKind::Interrupted, "Ctrl-C"));
        }
        let share = view.time / self.end;
        let due = match (&self.bar, self.show) {
            (_, Show::Nothing) => false,
            (Some(_), _) => self.last.elapsed() >= BAR_EVERY,
            (None, _) => self.last.elapsed() >= LINE_EVERY || share >= self.next_share && self.last.elapsed() >= LINE_LEAST,
        };
        if view.step == 0 || due {
            let message = self.message(view);
            match (&self.bar, self.show) {
                (Some(bar), _) => {
                    bar.set_position((share * TICKS as f64) as u64);
                    bar.set_message(message);
                }
                (None, Show::Progress) => console::note(&format!("{}: {message}", self.label)),
                (None, Show::Nothing) => {}
            }
            self.last = Instant::now();
            self.next_share = share + LINE_SHARE;
        }
        Ok(())
    }

    fn finish(&mut self, _view: &View<D>) -> io::Result<()> {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
        Ok(())
    }
}
