//! The registry: all measures by name.

use std::sync::LazyLock;

use crate::definition::Definition;
use crate::families;

/// Returns all definitions, by family.
#[must_use]
pub fn definitions() -> &'static [Definition] {
    static ALL: LazyLock<Vec<Definition>> = LazyLock::new(|| families::ALL.concat());
    &ALL
}
