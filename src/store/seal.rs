//! Checksums: a record that is not what was written does not pass for it.

/// What a record is sealed with.
pub(super) type Seal = [u8; 16];

/// Hashes a record field by field; every field is preceded by its length, so that no two records
/// have the same bytes.
pub(super) struct Sealer(blake3::Hasher);

impl Sealer {
    /// Begins the seal of a record of the table `kind`.
    pub(super) fn new(kind: &str) -> Sealer {
        Sealer(blake3::Hasher::new()).bytes(kind.as_bytes())
    }

    /// Adds a field.
    pub(super) fn bytes(mut self, field: &[u8]) -> Sealer {
        self.0.update(&(field.len() as u64).to_le_bytes());
        self.0.update(field);
        self
    }

    /// Adds numbers.
    pub(super) fn numbers<const N: usize>(mut self, fields: [u64; N]) -> Sealer {
        for field in fields {
            self.0.update(&field.to_le_bytes());
        }
        self
    }

    /// The seal of what was added.
    pub(super) fn seal(self) -> Seal {
        let mut seal = [0; 16];
        seal.copy_from_slice(&self.0.finalize().as_bytes()[..16]);
        seal
    }
}

/// The hash of a checkpoint's body. It is sealed in the body's place, so that a list of
/// checkpoints can be trusted without reading their bodies.
pub(super) fn digest(body: &[u8]) -> Seal {
    Sealer::new("body").bytes(body).seal()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn moving_a_byte_from_one_field_to_the_next_changes_the_seal() {
        let one = Sealer::new("row").bytes(b"ab").bytes(b"c").seal();
        let other = Sealer::new("row").bytes(b"a").bytes(b"bc").seal();
        assert_ne!(one, other);
        assert_ne!(
            Sealer::new("row").numbers([1, 2]).seal(),
            Sealer::new("row").numbers([2, 1]).seal()
        );
    }
}
