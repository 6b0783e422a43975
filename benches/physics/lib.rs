//! This package contains only benches: `step` and `large`.
