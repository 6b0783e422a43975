//! Power series of far groups: the moments of a source group and the local series of a target
//! group.
//!
//! These are the operators of a fast multipole method: `gather` is P2M, `raise` M2M, `transfer`
//! M2L, `lower` L2L and `evaluate` L2P.
//!
//! Points are complex numbers. The unit vector along `D` is `D^(1/2) conj(D)^(-1/2)`. Let
//! `D = Z + s - t`, where the target is at `t` from its group's centre, the source at `s` from its
//! own, and `Z` is the vector between the centres. Both powers expand in `(s - t) / Z` by the
//! binomial series. The first is cut at power `N`; of the second, all terms are kept in which the
//! powers of `s` and of `t` are below `N`. The sum over all sources becomes
//!
//!   `sum over k, q of L[k][q] t^k conj(t)^q`, and `L` is linear in
//!   `M[a][b] = sum over sources of s^a conj(s)^b`,
//!
//! where the coefficients factor into real ones of `(k, a)` and of `(q, b)` and powers of `Z`.

#![expect(
    clippy::needless_range_loop,
    reason = "the indices of rows and columns are the powers"
)]

use crate::model::simd::{Lanes, Level, WIDTH, multiversion};

/// Coefficients of `z^row conj(z)^column`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Series<const N: usize> {
    re: [[f64; N]; N],
    im: [[f64; N]; N],
}

impl<const N: usize> Series<N> {
    pub const ZERO: Self = Self {
        re: [[0.0; N]; N],
        im: [[0.0; N]; N],
    };
}

/// The real coefficients of order `N`.
struct Table<const N: usize>;

impl<const N: usize> Table<N> {
    /// By `[n][k]`: `C(n, k)`, 0 for k > n.
    const BINOMIAL: [[f64; N]; N] = {
        let mut table = [[0.0; N]; N];
        let mut n = 0;
        while n < N {
            let mut k = 0;
            while k <= n {
                table[n][k] = binomial(n as f64, k);
                k += 1;
            }
            n += 1;
        }
        table
    };

    /// By `[k][a]`: `C(1/2, a + k) C(a + k, k) (-1)^k`, 0 from power `N` on.
    const ROOT: [[f64; N]; N] = Self::power(0.5, N);

    /// By `[b][q]`: `C(-1/2, b + q) C(b + q, q) (-1)^q`. Not cut: all `b, q < N`, since
    /// `transfer_columns` sums whole rows, and the terms from power `N` on cost nothing.
    const INVERSE_ROOT: [[f64; N]; N] = {
        let by_q = Self::power(-0.5, 2 * N);
        let mut table = [[0.0; N]; N];
        let mut b = 0;
        while b < N {
            let mut q = 0;
            while q < N {
                table[b][q] = by_q[q][b];
                q += 1;
            }
            b += 1;
        }
        table
    };

    const fn power(exponent: f64, cut: usize) -> [[f64; N]; N] {
        let mut table = [[0.0; N]; N];
        let mut k = 0;
        while k < N {
            let mut a = 0;
            while a < N && a + k < cut {
                let sign = if k % 2 == 0 { 1.0 } else { -1.0 };
                table[k][a] = sign * binomial(exponent, a + k) * binomial((a + k) as f64, k);
                a += 1;
            }
            k += 1;
        }
        table
    }
}

const fn binomial(n: f64, k: usize) -> f64 {
    let (mut product, mut i) = (1.0, 0);
    while i < k {
        product *= (n - i as f64) / (i as f64 + 1.0);
        i += 1;
    }
    product
}

/// The powers of `(re, im)` from 0 to `N - 1`.
#[inline(always)]
fn powers<const N: usize>([re, im]: [f64; 2]) -> [[f64; N]; 2] {
    let (mut powers_re, mut powers_im) = ([0.0; N], [0.0; N]);
    powers_re[0] = 1.0;
    for k in 1..N {
        powers_re[k] = powers_re[k - 1] * re - powers_im[k - 1] * im;
        powers_im[k] = powers_re[k - 1] * im + powers_im[k - 1] * re;
    }
    [powers_re, powers_im]
}

/// `to += factor * row`, all complex.
#[inline(always)]
fn add_row<const N: usize>(to: [&mut [f64; N]; 2], factor: [f64; 2], row: [&[f64; N]; 2]) {
    let ([to_re, to_im], [re, im]) = (to, row);
    for k in 0..N {
        to_re[k] += factor[0] * re[k] - factor[1] * im[k];
    }
    for k in 0..N {
        to_im[k] += factor[0] * im[k] + factor[1] * re[k];
    }
}

/// `factor * row`, entry by entry, complex.
#[inline(always)]
fn product<const N: usize>(factor: [&[f64; N]; 2], row: [&[f64; N]; 2]) -> [[f64; N]; 2] {
    let (mut re, mut im) = ([0.0; N], [0.0; N]);
    for k in 0..N {
        re[k] = factor[0][k] * row[0][k] - factor[1][k] * row[1][k];
    }
    for k in 0..N {
        im[k] = factor[0][k] * row[1][k] + factor[1][k] * row[0][k];
    }
    [re, im]
}

multiversion! {
    /// Returns the moments `M` of `places` about `centre`.
    pub(super) fn gather<const N: usize>(
        level,
        centre: [f64; 2],
        places: [&[f64]; 2],
    ) -> Series<N> {
        let mut moments = Series::ZERO;
        for (&x, &y) in places[0].iter().zip(places[1]) {
            let [re, im] = powers::<N>([x - centre[0], y - centre[1]]);
            let conjugate = [&re, &im.map(|it| -it)];
            for a in 0..N {
                let to = [&mut moments.re[a], &mut moments.im[a]];
                add_row(to, [re[a], im[a]], conjugate);
            }
        }
        moments
    }
}

multiversion! {
    /// Adds to the moments of `whole` those of a part whose centre is at `offset` from its own.
    pub(super) fn raise<const N: usize>(
        level,
        whole: &mut Series<N>,
        part: &Series<N>,
        offset: [f64; 2],
    ) {
        let [re, im] = powers::<N>(offset);
        let binomial = &Table::<N>::BINOMIAL;
        // (s + offset)^a conj(s + offset)^b, first by a, then by b; entry b of `across` is the
        // coefficient of conj(s)^j in it.
        for a in 0..N {
            let (mut row_re, mut row_im) = ([0.0; N], [0.0; N]);
            for i in 0..=a {
                let factor = [binomial[a][i] * re[a - i], binomial[a][i] * im[a - i]];
                add_row([&mut row_re, &mut row_im], factor, [&part.re[i], &part.im[i]]);
            }
            for j in 0..N {
                let (mut across_re, mut across_im) = ([0.0; N], [0.0; N]);
                for b in j..N {
                    across_re[b] = binomial[b][j] * re[b - j];
                    across_im[b] = -(binomial[b][j] * im[b - j]);
                }
                let to = [&mut whole.re[a], &mut whole.im[a]];
                add_row(to, [row_re[j], row_im[j]], [&across_re, &across_im]);
            }
        }
    }
}

/// The factors of a transfer: the powers of `1/Z`, their conjugates and `Z/|Z|`.
struct TransferFactors<const N: usize> {
    powers: [[f64; N]; 2],
    conjugate: [[f64; N]; 2],
    unit: [f64; 2],
}

impl<const N: usize> TransferFactors<N> {
    #[inline(always)]
    fn new([x, y]: [f64; 2]) -> Self {
        let square = x * x + y * y;
        let length = square.sqrt();
        let [re, im] = powers::<N>([x / square, -y / square]);
        Self {
            powers: [re, im],
            conjugate: [re, im.map(|it| -it)],
            unit: [x / length, y / length],
        }
    }

    /// Returns the products of `factor` and the powers of the conjugate, by column.
    #[inline(always)]
    fn row(&self, factor: [f64; 2]) -> [[f64; N]; 2] {
        let [mut re, mut im] = [[0.0; N]; 2];
        add_row(
            [&mut re, &mut im],
            factor,
            [&self.conjugate[0], &self.conjugate[1]],
        );
        [re, im]
    }
}

multiversion! {
    /// The first half of a transfer: divides every moment by its powers of `Z` and sums over `a`.
    fn transfer_rows<const N: usize>(
        level,
        halfway: &mut Series<N>,
        moments: &Series<N>,
        apart: &TransferFactors<N>,
    ) {
        let mut scaled = Series::<N>::ZERO;
        for a in 0..N {
            let factor = apart.row([apart.powers[0][a], apart.powers[1][a]]);
            let row = [&moments.re[a], &moments.im[a]];
            [scaled.re[a], scaled.im[a]] = product([&factor[0], &factor[1]], row);
        }
        for k in 0..N {
            let (mut re, mut im) = ([0.0; N], [0.0; N]);
            for a in 0..N - k {
                let factor = Table::<N>::ROOT[k][a];
                for b in 0..N {
                    re[b] += factor * scaled.re[a][b];
                }
                for b in 0..N {
                    im[b] += factor * scaled.im[a][b];
                }
            }
            (halfway.re[k], halfway.im[k]) = (re, im);
        }
    }
}

multiversion! {
    /// The second half of a transfer: sums over `b` and divides by the target's powers of `Z`.
    fn transfer_columns<const N: usize>(
        level,
        local: &mut Series<N>,
        halfway: &Series<N>,
        apart: &TransferFactors<N>,
    ) {
        for k in 0..N {
            let (mut re, mut im) = ([0.0; N], [0.0; N]);
            for b in 0..N {
                let factors = &Table::<N>::INVERSE_ROOT[b];
                for q in 0..N {
                    re[q] += halfway.re[k][b] * factors[q];
                }
                for q in 0..N {
                    im[q] += halfway.im[k][b] * factors[q];
                }
            }
            let ([unit_re, unit_im], [re_k, im_k]) = (apart.unit, apart.powers.map(|it| it[k]));
            let factor = [
                unit_re * re_k - unit_im * im_k,
                unit_re * im_k + unit_im * re_k,
            ];
            let factor = apart.row(factor);
            let row = product([&factor[0], &factor[1]], [&re, &im]);
            for q in 0..N {
                local.re[k][q] += row[0][q];
            }
            for q in 0..N {
                local.im[k][q] += row[1][q];
            }
        }
    }
}

/// Adds to the local series of a target the pull of a source with these `moments`; `apart` is the
/// vector from the target's centre to the source's.
///
/// The two halves pass `halfway` in memory: if its rows stayed in registers, extracting single
/// numbers from them would cost more than reading them from memory.
pub(super) fn transfer<const N: usize>(
    level: Level,
    local: &mut Series<N>,
    halfway: &mut Series<N>,
    moments: &Series<N>,
    apart: [f64; 2],
) {
    let apart = TransferFactors::new(apart);
    transfer_rows(level, halfway, moments, &apart);
    transfer_columns(level, local, halfway, &apart);
}

multiversion! {
    /// Returns the local series of a part whose centre is at `offset` from the whole's.
    pub(super) fn lower<const N: usize>(
        level,
        whole: &Series<N>,
        offset: [f64; 2],
    ) -> Series<N> {
        let [re, im] = powers::<N>(offset);
        let binomial = &Table::<N>::BINOMIAL;
        let mut part = Series::ZERO;
        for k in 0..N {
            let (mut row_re, mut row_im) = ([0.0; N], [0.0; N]);
            for i in k..N {
                let factor = [binomial[i][k] * re[i - k], binomial[i][k] * im[i - k]];
                add_row([&mut row_re, &mut row_im], factor, [&whole.re[i], &whole.im[i]]);
            }
            for j in 0..N {
                let (mut across_re, mut across_im) = ([0.0; N], [0.0; N]);
                for q in 0..=j {
                    across_re[q] = binomial[j][q] * re[j - q];
                    across_im[q] = -(binomial[j][q] * im[j - q]);
                }
                let to = [&mut part.re[k], &mut part.im[k]];
                add_row(to, [row_re[j], row_im[j]], [&across_re, &across_im]);
            }
        }
        part
    }
}

multiversion! {
    /// Evaluates the local series about `centre` at the targets `at` and adds it to `sums`.
    ///
    /// - Shapes: targets and sums in lanes; two axes, x and y.
    pub(super) fn evaluate<const N: usize>(
        level,
        local: &Series<N>,
        centre: [f64; 2],
        at: [&[Lanes]; 2],
        sums: [&mut [Lanes]; 2],
    ) {
        let [sums_x, sums_y] = sums;
        for (((at_x, at_y), sum_x), sum_y) in at[0].iter().zip(at[1]).zip(sums_x).zip(sums_y) {
            let (mut re, mut im) = ([0.0; WIDTH], [0.0; WIDTH]);
            for lane in 0..WIDTH {
                re[lane] = at_x[lane] - centre[0];
            }
            for lane in 0..WIDTH {
                im[lane] = at_y[lane] - centre[1];
            }
            let conjugate = [&re, &im.map(|it| -it)];
            let mut value = [[0.0; WIDTH]; 2];
            for k in (0..N).rev() {
                let mut row = [[0.0; WIDTH]; 2];
                for q in (0..N).rev() {
                    row = product(conjugate, [&row[0], &row[1]]);
                    for lane in 0..WIDTH {
                        row[0][lane] += local.re[k][q];
                    }
                    for lane in 0..WIDTH {
                        row[1][lane] += local.im[k][q];
                    }
                }
                value = product([&re, &im], [&value[0], &value[1]]);
                for lane in 0..WIDTH {
                    value[0][lane] += row[0][lane];
                }
                for lane in 0..WIDTH {
                    value[1][lane] += row[1][lane];
                }
            }
            for lane in 0..WIDTH {
                sum_x[lane] += value[0][lane];
            }
            for lane in 0..WIDTH {
                sum_y[lane] += value[1][lane];
            }
        }
    }
}
