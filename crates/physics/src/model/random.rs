//! Random numbers without generator state: every draw is a function of its key.
//!
//! A stream is ChaCha with eight rounds, keyed by (seed, step or command, individual, purpose),
//! so no order of evaluation, thread or restart changes a draw. It is not for cryptographic use.

use chacha20::ChaCha8;
use chacha20::cipher::{KeyIvInit, StreamCipher};

/// The purpose of a draw. Recorded runs depend on the discriminants: do not renumber them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u64)]
pub enum Purpose {
    /// Position and heading of an individual at the start.
    Start = 1,
    /// Individuals of a random selection.
    Selection = 2,
    /// Position and heading of an injected individual.
    Injection = 3,
    /// Noise on the turning rate in a step.
    Noise = 4,
}

/// The draws of one purpose, one after the other.
pub struct Stream {
    cipher: ChaCha8,
    block: [u8; 64],
    used: usize,
}

impl Stream {
    /// Opens the stream of (seed, step or command number, individual, purpose).
    #[must_use]
    pub fn new(seed: u64, occasion: u64, individual: u64, purpose: Purpose) -> Self {
        let mut key = [0; 32];
        for (bytes, word) in
            key.chunks_exact_mut(8)
                .zip([seed, occasion, individual, purpose as u64])
        {
            bytes.copy_from_slice(&word.to_le_bytes());
        }
        Self {
            cipher: ChaCha8::new(&key.into(), &[0; 12].into()),
            block: [0; 64],
            used: 64,
        }
    }

    /// Draws 64 bits.
    pub fn bits(&mut self) -> u64 {
        if self.used == self.block.len() {
            self.block = [0; 64];
            self.cipher.apply_keystream(&mut self.block);
            self.used = 0;
        }
        let mut word = [0; 8];
        word.copy_from_slice(&self.block[self.used..self.used + 8]);
        self.used += 8;
        u64::from_le_bytes(word)
    }

    /// Draws a number in [0, 1), a multiple of 2⁻⁵³.
    pub fn uniform(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Draws a number from the standard normal distribution, by Box and Muller from two uniform
    /// ones.
    pub fn normal(&mut self) -> f64 {
        let radius = (-2.0 * libm::log(1.0 - self.uniform())).sqrt();
        radius * libm::cos(std::f64::consts::TAU * self.uniform())
    }

    /// Draws an integer in [0, `bound`), every one with equal probability.
    ///
    /// # Panics
    ///
    /// When `bound` is 0.
    pub fn below(&mut self, bound: u64) -> u64 {
        assert!(bound > 0, "no integer is below zero");
        // The high half of the product is uniform if products whose low half is below
        // 2⁶⁴ mod `bound` are rejected.
        let uneven = bound.wrapping_neg() % bound;
        loop {
            let product = u128::from(self.bits()) * u128::from(bound);
            #[expect(
                clippy::cast_possible_truncation,
                reason = "the two halves of 128 bits"
            )]
            let (high, low) = ((product >> 64) as u64, product as u64);
            if low >= uneven {
                return high;
            }
        }
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    /// Recorded runs depend on these words: a change of any requires a new model version.
    #[test]
    fn the_golden_words_do_not_change() {
        let mut stream = Stream::new(1, 2, 3, Purpose::Start);
        let words: Vec<u64> = (0..9).map(|_| stream.bits()).collect();
        assert_eq!(words, GOLDEN);
        let mut stream = Stream::new(1, 2, 3, Purpose::Start);
        assert_eq!(stream.uniform(), (GOLDEN[0] >> 11) as f64 * 2f64.powi(-53));
        assert_eq!(
            u128::from(stream.below(1000)),
            (u128::from(GOLDEN[1]) * 1000) >> 64
        );
    }

    const GOLDEN: [u64; 9] = [
        0x9174d24963ff5496,
        0xa26288986641c63b,
        0x172a9c7c8a003333,
        0x282b3e4698c9f2f3,
        0x5a3e68c4557f08af,
        0x4de628d792f90548,
        0x5614992b972e91b3,
        0xe7fe0c946a331b94,
        0xfa167ffb6020a977,
    ];

    /// The first bytes of eight rounds under the all-zero key, from the cipher's published test
    /// vectors.
    #[test]
    fn the_cipher_is_chacha_with_eight_rounds() {
        let mut cipher = ChaCha8::new(&[0; 32].into(), &[0; 12].into());
        let mut block = [0; 8];
        cipher.apply_keystream(&mut block);
        assert_eq!(block, [0x3e, 0x00, 0xef, 0x2f, 0x89, 0x5f, 0x40, 0xd6]);
    }

    /// The same value in another part of the key gives other draws.
    #[test]
    fn every_part_of_the_key_changes_the_draws() {
        let first = |s, o, i, p| Stream::new(s, o, i, p).bits();
        let words = [
            first(0, 0, 0, Purpose::Start),
            first(1, 0, 0, Purpose::Start),
            first(0, 1, 0, Purpose::Start),
            first(0, 0, 1, Purpose::Start),
            first(0, 0, 0, Purpose::Selection),
            first(0, 0, 0, Purpose::Injection),
        ];
        for (k, word) in words.iter().enumerate() {
            assert!(!words[..k].contains(word));
        }
    }

    #[test]
    fn bounded_integers_are_uniform() {
        let mut stream = Stream::new(5, 0, 0, Purpose::Selection);
        let mut counts = [0i32; 7];
        (0..70_000).for_each(|_| counts[usize::try_from(stream.below(7)).unwrap()] += 1);
        // Six standard deviations of a count are 556.
        assert!(
            counts.iter().all(|count| (count - 10_000).abs() < 556),
            "{counts:?}"
        );
        assert_eq!(stream.below(1), 0);
    }

    #[test]
    fn uniform_numbers_fill_the_unit_interval() {
        let mut stream = Stream::new(6, 0, 0, Purpose::Start);
        let draws: Vec<f64> = (0..10_000).map(|_| stream.uniform()).collect();
        assert!(draws.iter().all(|u| (0.0..1.0).contains(u)));
        let mean = draws.iter().sum::<f64>() / 10_000.0;
        assert!((mean - 0.5).abs() < 6.0 * 0.2887 / 100.0, "{mean}");
    }
}
