//! This package contains only tests: `daemon` and `measured`.
