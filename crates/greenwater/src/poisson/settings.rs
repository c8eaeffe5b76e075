//! What a user may choose about the solver.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::SolveError;

/// Method for `A p = b`.
#[derive(Serialize, Deserialize, JsonSchema, Clone, Copy, Debug, PartialEq, Eq)]
#[serde(rename_all = "kebab-case")]
pub enum SolverMethod {
    /// Gaussian elimination with row pivoting on the dense matrix: `O(n³)` work, `8 n²` bytes, any regular matrix.
    /// An iteration is one pair of triangular solves; more than one is iterative refinement.
    Gauss,
    /// Restarted GMRES, preconditioned from the right: any matrix. Source: Saad & Schultz, SIAM J. Sci. Stat. Comput. 7
    /// (1986) 856.
    Gmres,
    /// Preconditioned conjugate gradients: symmetric positive definite matrices only, the cheapest there. Source:
    /// Hestenes & Stiefel, J. Res. NBS 49 (1952) 409.
    Cg,
    /// BiCGStab, preconditioned from the right: any matrix, short recurrences, two products an iteration. Source: van der
    /// Vorst, SIAM J. Sci. Stat. Comput. 13 (1992) 631.
    Bicgstab,
    /// Defect correction, `p += ω M⁻¹ (b − A p)`: any matrix whose preconditioner `M` comes close, such as multigrid for the symmetric
    /// part of a pressure equation; `ω` leaves the least residual. Source: Stetter, Numer. Math. 29 (1978) 425.
    DefectCorrection,
}

/// Preconditioner of a Krylov method; Gauss needs none and ignores it.
#[derive(Serialize, Deserialize, JsonSchema, Clone, Copy, Debug, PartialEq, Eq)]
#[serde(rename_all = "kebab-case")]
pub enum PreconditionerKind {
    /// Identity.
    None,
    /// Inverse of the diagonal: robust against fragments and scale, no set-up to speak of.
    Jacobi,
    /// Incomplete LU on the pattern of the matrix: any matrix with regular pivots. Source: Meijerink & van der Vorst, Math.
    /// Comp. 31 (1977) 148.
    Ilu0,
    /// Incomplete Cholesky on the pattern of the lower triangle: (nearly) symmetric matrices with a positive diagonal. Where
    /// a pivot is lost the diagonal is shifted, and the report says by how much. Source: Manteuffel, Math. Comp. 34 (1980)
    /// 473.
    Ic0,
    /// Smoothed-aggregation multigrid: symmetric positive matrices whose iterations would grow with their size; from some 10⁴
    /// unknowns on the fastest. In `isph` Jacobi stands in for it where it is cheaper. Source: Vaněk, Mandel & Brezina, Computing 56 (1996) 179.
    Multigrid,
}

/// How `A p = b` is solved. The default, conjugate gradients with IC(0) to a residual of 1e-6, fits symmetric pressure equations of 10³ to 10⁵ unknowns.
#[derive(Serialize, Deserialize, JsonSchema, Clone, Debug, PartialEq)]
#[serde(default, deny_unknown_fields)]
pub struct SolverSettings {
    /// Method.
    pub method: SolverMethod,
    /// Preconditioner.
    pub preconditioner: PreconditionerKind,
    /// Largest relative true residual `|b − A p| / |b|` of a solution, dimensionless, in (0, 1).
    pub tolerance: f64,
    /// Most iterations of one solve, at least 1. Gauss stops refining after 10.
    pub max_iterations: usize,
    /// Krylov vectors kept by GMRES before it restarts, at least 1. Memory: `8 n (restart + 1)` bytes.
    pub restart: usize,
}

impl Default for SolverSettings {
    fn default() -> Self {
        Self { method: SolverMethod::Cg, preconditioner: PreconditionerKind::Ic0, tolerance: 1e-6, max_iterations: 2000, restart: 30 }
    }
}

impl SolverSettings {
    /// Method and preconditioner in words: "conjugate gradients with IC(0) preconditioner".
    pub fn name(&self) -> String {
        let method = match self.method {
            SolverMethod::Gauss => return "Gauss elimination".to_owned(),
            SolverMethod::Gmres => "GMRES",
            SolverMethod::Cg => "conjugate gradients",
            SolverMethod::Bicgstab => "BiCGStab",
            SolverMethod::DefectCorrection => "defect correction",
        };
        match self.preconditioner {
            PreconditionerKind::None => method.to_owned(),
            PreconditionerKind::Jacobi => format!("{method} with Jacobi preconditioner"),
            PreconditionerKind::Ilu0 => format!("{method} with ILU(0) preconditioner"),
            PreconditionerKind::Ic0 => format!("{method} with IC(0) preconditioner"),
            PreconditionerKind::Multigrid => format!("{method} with multigrid preconditioner"),
        }
    }

    /// Checks every value against its documented range.
    ///
    /// # Errors
    /// [`SolveError::Setting`] names the key, its value and its rule.
    pub fn check(&self) -> Result<(), SolveError> {
        let rule = |holds: bool, key, value: f64, rule| match holds {
            true => Ok(()),
            false => Err(SolveError::Setting { key, value, rule }),
        };
        rule(self.tolerance > 0.0 && self.tolerance < 1.0, "tolerance", self.tolerance, "in (0, 1)")?;
        rule(self.max_iterations > 0, "max_iterations", self.max_iterations as f64, "at least 1")?;
        rule(self.restart > 0, "restart", self.restart as f64, "at least 1")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_are_read_with_defaults_and_unknown_keys_are_errors() {
        let read: SolverSettings = serde_json::from_str(r#"{"method": "bicgstab", "preconditioner": "ilu0"}"#).unwrap();
        assert_eq!(read.method, SolverMethod::Bicgstab);
        assert_eq!(read.preconditioner, PreconditionerKind::Ilu0);
        assert_eq!(read.restart, SolverSettings::default().restart);
        assert!(serde_json::from_str::<SolverSettings>(r#"{"tolerence": 1e-3}"#).is_err());
    }

    #[test]
    fn a_value_out_of_range_names_its_key() {
        for tolerance in [0.0, 1.0, f64::NAN] {
            let error = SolverSettings { tolerance, ..Default::default() }.check().unwrap_err();
            assert!(matches!(error, SolveError::Setting { key: "tolerance", .. }), "{error}");
        }
        assert!(SolverSettings { restart: 0, ..Default::default() }.check().is_err());
    }
}
