//! Kernels compiled for several vector widths and selected by the features of the processor.
//!
//! A kernel is written once, in plain loops over arrays of [`WIDTH`] lanes, and wrapped in
//! `multiversion!`. Every version does the same operations on the same numbers in the same
//! order: the compiler neither reorders sums nor fuses products with them, and `sqrt` and `/`
//! are correctly rounded on every processor. So all versions give the same bytes and differ only
//! in speed.

use std::sync::OnceLock;

/// Number of lanes of a kernel: one register of the widest version.
pub const WIDTH: usize = 8;

/// One number in each lane.
pub type Lanes = [f64; WIDTH];

/// Selects the version of the kernels. A level that the processor lacks cannot be constructed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Level(Width);

/// Public only for the macro.
#[doc(hidden)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Width {
    Baseline,
    #[cfg(target_arch = "x86_64")]
    Avx2,
    #[cfg(target_arch = "x86_64")]
    Avx512,
}

impl Level {
    /// The level that every processor supports.
    pub const BASELINE: Self = Self(Width::Baseline);

    /// Returns all levels of this processor, the widest last.
    #[must_use]
    pub fn available() -> Vec<Self> {
        let levels = [
            Some(Self::BASELINE),
            #[cfg(target_arch = "x86_64")]
            has_avx2().then_some(Self(Width::Avx2)),
            #[cfg(target_arch = "x86_64")]
            has_avx512().then_some(Self(Width::Avx512)),
        ];
        levels.into_iter().flatten().collect()
    }

    #[doc(hidden)]
    #[inline(always)]
    #[must_use]
    pub fn width(self) -> Width {
        self.0
    }
}

impl Default for Level {
    /// Returns the level of this process.
    fn default() -> Self {
        level()
    }
}

/// The level of this process.
static LEVEL: OnceLock<Level> = OnceLock::new();

/// Returns the level of this process: the widest of this processor, unless [`set_level`] has chosen
/// another.
#[inline]
#[must_use]
pub fn level() -> Level {
    *LEVEL.get_or_init(|| *Level::available().last().unwrap_or(&Level::BASELINE))
}

/// Chooses the level of this process, before the first kernel has used it. This changes the duration
/// of a step and no bit of its result.
///
/// # Errors
///
/// The level that is already in use, if it is another one.
pub fn set_level(level: Level) -> Result<(), Level> {
    let used = *LEVEL.get_or_init(|| level);
    if used == level { Ok(()) } else { Err(used) }
}

#[cfg(target_arch = "x86_64")]
fn has_avx2() -> bool {
    is_x86_feature_detected!("avx2")
}

#[cfg(target_arch = "x86_64")]
fn has_avx512() -> bool {
    is_x86_feature_detected!("avx512f")
        && is_x86_feature_detected!("avx512vl")
        && is_x86_feature_detected!("avx512dq")
}

/// Defines a free function once for each [`Level`]; the level is its first argument.
///
/// ```text
/// multiversion! {
///     /// Adds `from` to `to`.
///     pub fn add(level, to: &mut [f64], from: &[f64]) {
///         for (to, from) in to.iter_mut().zip(from) {
///             *to += from;
///         }
///     }
/// }
/// add(simd::level(), &mut to, &from);
/// ```
///
/// Constant parameters may follow the name, `fn name<const N: usize>(level, …)`. Functions that
/// the body calls in its loops must be `#[inline(always)]`, or they stay at the baseline.
macro_rules! multiversion {
    (
        $(#[$meta:meta])*
        $vis:vis fn $name:ident $(<$(const $g:ident: $gt:ty),+>)? (
            level, $($arg:ident: $type:ty),* $(,)?
        ) $(-> $result:ty)? $body:block
    ) => {
        $(#[$meta])*
        #[inline]
        #[cfg_attr(target_arch = "x86_64", expect(
            unsafe_code,
            reason = "a version runs only with a level, which needs its features to be detected"
        ))]
        $vis fn $name $(<$(const $g: $gt),+>)? (
            level: $crate::model::simd::Level, $($arg: $type),*
        ) $(-> $result)? {
            #[inline(always)]
            fn body $(<$(const $g: $gt),+>)? ($($arg: $type),*) $(-> $result)? $body

            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx2")]
            fn avx2 $(<$(const $g: $gt),+>)? ($($arg: $type),*) $(-> $result)? {
                body $(::<$($g),+>)? ($($arg),*)
            }

            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx512f,avx512vl,avx512dq")]
            fn avx512 $(<$(const $g: $gt),+>)? ($($arg: $type),*) $(-> $result)? {
                body $(::<$($g),+>)? ($($arg),*)
            }

            match level.width() {
                $crate::model::simd::Width::Baseline => body $(::<$($g),+>)? ($($arg),*),
                // SAFETY: a level is constructed only if its features were detected.
                #[cfg(target_arch = "x86_64")]
                $crate::model::simd::Width::Avx2 => unsafe { avx2 $(::<$($g),+>)? ($($arg),*) },
                // SAFETY: as above.
                #[cfg(target_arch = "x86_64")]
                $crate::model::simd::Width::Avx512 => unsafe {
                    avx512 $(::<$($g),+>)? ($($arg),*)
                },
            }
        }
    };
}
pub(crate) use multiversion;

#[cfg(test)]
mod tests {
    use super::*;

    multiversion! {
        /// Uses every operation that kernels use.
        fn mixed<const N: usize>(level, to: &mut [f64], from: &[f64]) -> f64 {
            let mut sum = 0.0;
            for (to, from) in to.iter_mut().zip(from) {
                *to += from * N as f64 + 1.0 / (from * from + *to * *to).sqrt();
                sum += *to;
            }
            sum
        }
    }

    #[test]
    fn every_level_gives_the_same_bytes() {
        let from: Vec<f64> = (1..100).map(|k| f64::from(k).ln()).collect();
        let at = |level| {
            let mut to: Vec<f64> = (1..100).map(|k| f64::from(k).cbrt()).collect();
            let sum = mixed::<3>(level, &mut to, &from);
            (
                sum.to_bits(),
                to.into_iter().map(f64::to_bits).collect::<Vec<_>>(),
            )
        };
        for level in Level::available() {
            assert_eq!(at(level), at(Level::BASELINE), "{level:?}");
        }
    }

    #[test]
    fn the_level_is_the_widest_available_and_stays() {
        let widest = *Level::available().last().expect("the baseline");
        assert_eq!(level(), widest);
        assert_eq!(set_level(widest), Ok(()));
        if widest != Level::BASELINE {
            assert_eq!(set_level(Level::BASELINE), Err(widest));
        }
        assert_eq!(level(), widest);
    }
}
