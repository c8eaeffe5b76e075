//! Which preconditioner costs less, told by work that is counted.

use super::solver::OLDEST;

/// Work of building multigrid, in products with the matrix: 37 to 89 were measured in 2D and 3D at 20 000 particles (`greenwater bench poisson`, share of the
/// set-up). A solve carries a twentieth of it, so that little depends on it.
const BUILD: f64 = 50.0;

/// Most builds of multigrid between two trials of Jacobi: a trial that fails costs as much as a solve, one in 20 of a build's.
const LONGEST_PAUSE: u32 = 64;

/// Whether Jacobi should stand in for multigrid. Once multigrid has shown what it needs, Jacobi is tried when a build is due; it stays while each
/// solve is done within the work multigrid would have taken, its share of a build included. After a trial that failed, twice as many builds go by as
/// after the one before.
#[derive(Debug, Default)]
pub(super) struct Thrift {
    /// Products with the matrix that multigrid takes for a decade of the residual.
    products: Option<f64>,
    jacobi: bool,
    /// Builds until the next trial, and between the last two.
    wait: u32,
    pause: u32,
}

impl Thrift {
    /// Multigrid took so many products for a decade of the residual.
    pub(super) fn measured(&mut self, products: f64) {
        self.products = Some(products);
    }

    /// A build is due: whether to do without.
    pub(super) fn chooses_jacobi(&mut self) -> bool {
        if self.jacobi {
            // It has served since the build before.
            self.pause = 0;
        } else if self.wait > 0 {
            self.wait -= 1;
        } else {
            self.jacobi = self.products.is_some();
        }
        self.jacobi
    }

    /// Iterations in which Jacobi is to reduce the residual by so many decades.
    pub(super) fn allowance(&self, decades: f64) -> usize {
        self.products.map_or(0, |products| (products * decades + BUILD / OLDEST as f64) as usize).max(1)
    }

    /// Jacobi has failed.
    pub(super) fn dismiss_jacobi(&mut self) {
        self.jacobi = false;
        self.pause = (2 * self.pause).clamp(1, LONGEST_PAUSE);
        self.wait = self.pause;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn trials_that_fail_grow_rare_and_success_makes_them_frequent_again() {
        let mut thrift = Thrift::default();
        assert!(!thrift.chooses_jacobi(), "nothing to compare with yet");
        thrift.measured(12.0);
        let mut between = Vec::new();
        for _ in 0..9 {
            between.push((0..).take_while(|_| !thrift.chooses_jacobi()).count());
            thrift.dismiss_jacobi();
        }
        assert_eq!(between, [0, 1, 2, 4, 8, 16, 32, 64, 64]);
        assert!((0..=64).any(|_| thrift.chooses_jacobi()));
        assert!(thrift.chooses_jacobi(), "it serves");
        thrift.dismiss_jacobi();
        assert!(!thrift.chooses_jacobi() && thrift.chooses_jacobi());
        assert_eq!(thrift.allowance(4.0), 50, "four decades and a twentieth of a build");
    }
}
