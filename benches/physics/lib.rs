//! This package contains only benches: `step`, `large` and `instructions`.
