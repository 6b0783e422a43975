//! The units of the columns of a table of results.

/// The unit of lengths.
pub const LENGTH_UNIT: &str = "body sizes";

/// The unit of speeds: the free speed.
pub const SPEED_UNIT: &str = "v0";

/// The unit of times: a body size over the free speed.
pub const TIME_UNIT: &str = "s/v0";

/// The unit of a number without unit.
pub const NO_UNIT: &str = "1";
