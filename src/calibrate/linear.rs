//! Small symmetric systems of equations.

/// A square matrix, row by row.
pub(super) type Matrix<const N: usize> = [[f64; N]; N];

/// The lower triangle of Cholesky's decomposition of a symmetric matrix; None where it is not
/// positive definite.
#[derive(Debug, Clone, Copy)]
pub(super) struct Cholesky<const N: usize>(Matrix<N>);

impl<const N: usize> Cholesky<N> {
    pub fn new(matrix: &Matrix<N>) -> Option<Self> {
        let mut lower = [[0.0; N]; N];
        for i in 0..N {
            for j in 0..=i {
                let known: f64 = (0..j).map(|k| lower[i][k] * lower[j][k]).sum();
                let rest = matrix[i][j] - known;
                if i == j {
                    // Not a number is not above 0 either.
                    if !(rest > 0.0 && rest.is_finite()) {
                        return None;
                    }
                    lower[i][i] = rest.sqrt();
                } else {
                    lower[i][j] = rest / lower[j][j];
                }
            }
        }
        Some(Self(lower))
    }

    /// Solves the system for this right side.
    pub fn solve(&self, right: &[f64; N]) -> [f64; N] {
        let lower = &self.0;
        let mut solution = *right;
        for i in 0..N {
            let known: f64 = (0..i).map(|k| lower[i][k] * solution[k]).sum();
            solution[i] = (solution[i] - known) / lower[i][i];
        }
        for i in (0..N).rev() {
            let known: f64 = (i + 1..N).map(|k| lower[k][i] * solution[k]).sum();
            solution[i] = (solution[i] - known) / lower[i][i];
        }
        solution
    }

    /// The inverse of the matrix.
    pub fn inverse(&self) -> Matrix<N> {
        // The inverse is symmetric: its columns are its rows.
        std::array::from_fn(|row| {
            let unit = std::array::from_fn(|i| f64::from(u8::from(i == row)));
            self.solve(&unit)
        })
    }
}

/// Adds `weight * a aᵀ` to a matrix.
pub(super) fn add_outer<const N: usize>(matrix: &mut Matrix<N>, a: &[f64; N], weight: f64) {
    for (row, left) in matrix.iter_mut().zip(a) {
        for (value, right) in row.iter_mut().zip(a) {
            *value += weight * left * right;
        }
    }
}

/// `aᵀ M b`.
pub(super) fn form<const N: usize>(matrix: &Matrix<N>, a: &[f64; N], b: &[f64; N]) -> f64 {
    let row_sum = |row: &[f64; N]| dot(row, b);
    matrix.iter().zip(a).map(|(row, a)| a * row_sum(row)).sum()
}

/// `a b a` of symmetric matrices: how the spread `b` of what a system is solved for becomes that of
/// its solution.
pub(super) fn sandwich<const N: usize>(a: &Matrix<N>, b: &Matrix<N>) -> Matrix<N> {
    std::array::from_fn(|i| std::array::from_fn(|j| form(b, &a[i], &a[j])))
}

/// The sum of the products of two vectors' components.
pub(super) fn dot<const N: usize>(a: &[f64; N], b: &[f64; N]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    const MATRIX: Matrix<3> = [[4.0, 2.0, -1.0], [2.0, 5.0, 0.5], [-1.0, 0.5, 3.0]];

    #[test]
    fn a_solution_and_an_inverse_reproduce_what_was_given() {
        let cholesky = Cholesky::new(&MATRIX).unwrap();
        let solution = cholesky.solve(&[1.0, -2.0, 0.25]);
        for (row, right) in MATRIX.iter().zip([1.0, -2.0, 0.25]) {
            assert!((dot(row, &solution) - right).abs() < 1e-12);
        }
        let inverse = cholesky.inverse();
        for i in 0..3 {
            for j in 0..3 {
                let product = dot(&MATRIX[i], &inverse[j]);
                assert!((product - f64::from(u8::from(i == j))).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn matrices_that_are_not_positive_definite_have_no_decomposition() {
        assert!(Cholesky::new(&[[1.0, 2.0], [2.0, 1.0]]).is_none());
        assert!(Cholesky::new(&[[0.0, 0.0], [0.0, 0.0]]).is_none());
        assert!(Cholesky::new(&[[f64::NAN, 0.0], [0.0, 1.0]]).is_none());
    }
}
