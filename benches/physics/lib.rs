//! Only benches: see `step`, `large` and `instructions` beside this file.
