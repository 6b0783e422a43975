//! Cost against the number of individuals, as an SVG.

use super::table::Row;
pub fn svg(_rows: &[Row]) -> String {
    String::new()
}
