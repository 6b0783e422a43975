//! A source of numbers that is the same everywhere.

/// A stream of numbers.
pub struct Numbers(blake3::OutputReader);

impl Numbers {
    /// Creates the stream of a seed within a set.
    pub fn new(set: &str, seed: u64) -> Self {
        let mut hasher = blake3::Hasher::new();
        hasher.update(set.as_bytes()).update(&seed.to_le_bytes());
        Self(hasher.finalize_xof())
    }

    /// Returns a whole number below a limit.
    pub fn below(&mut self, limit: u64) -> u64 {
        let mut bytes = [0; 8];
        self.0.fill(&mut bytes);
        u64::from_le_bytes(bytes) % limit
    }

    /// Returns a number in [0, 1).
    pub fn share(&mut self) -> f64 {
        self.below(1 << 53) as f64 / (1u64 << 53) as f64
    }

    /// Returns a number between two.
    pub fn within(&mut self, from: f64, to: f64) -> f64 {
        from + (to - from) * self.share()
    }

    /// Returns whether one of `in_how_many` equal chances occurred.
    pub fn chance(&mut self, in_how_many: u64) -> bool {
        self.below(in_how_many) == 0
    }
}
