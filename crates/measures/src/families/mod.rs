//! The measures, by family; and histograms.

pub mod alignment;
mod clusters;
pub mod histograms;
mod informed;
mod motion;
mod neighbours;
mod shape;

use crate::definition::Definition;

/// The definitions of all families, in the order of lists of measures.
pub(crate) const ALL: [&[Definition]; 6] = [
    &alignment::DEFINITIONS,
    &informed::DEFINITIONS,
    &shape::DEFINITIONS,
    &neighbours::DEFINITIONS,
    &clusters::DEFINITIONS,
    &motion::DEFINITIONS,
];
