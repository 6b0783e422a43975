//! The errors of starts and changes.

use thiserror::Error;

use crate::model::injection::InjectionError;
use crate::model::parameters::ParametersError;
use crate::model::reshape::ReshapeError;
use crate::model::selection::SelectionError;
use crate::model::start::StartError;
use crate::plural::counted;

/// The reason for which a start or a change was rejected. The simulation is unchanged.
#[derive(Clone, Debug, Error)]
pub enum ChangeError {
    /// A parameter is outside its range.
    #[error(transparent)]
    Parameters(#[from] ParametersError),
    /// The start cannot be built.
    #[error(transparent)]
    Start(#[from] StartError),
    /// The selection cannot be made.
    #[error(transparent)]
    Selection(#[from] SelectionError),
    /// The new individuals do not fit.
    #[error(transparent)]
    Injection(#[from] InjectionError),
    /// Bodies of the new shape do not fit.
    #[error(transparent)]
    Reshape(#[from] ReshapeError),
    /// Axes cross, which the new contact rule does not allow.
    #[error(
        "the axes of {} cross, which only `closest` allows: run it until none do, or reset",
        counted(*.pairs, "pair")
    )]
    AxesCross {
        /// The number of pairs whose axes cross.
        pairs: usize,
    },
    /// All individuals would be removed.
    #[error(
        "this would remove {}, which is all: leave one, or delete the swarm",
        counted(*.0, "individual")
    )]
    NoneLeft(usize),
    /// The individuals would be informed with `pi2`, which is 0; see
    /// [`check_weights`](super::change::check_weights).
    #[error("a weight of 0 informs no individual: set pi2 above 0")]
    Weightless,
    /// A column of set points does not have one value for each id.
    #[error("{column} has {}, ids has {ids}: give one for each id", counted(*.length, "value"))]
    Column {
        /// The column.
        column: &'static str,
        /// Its length.
        length: usize,
        /// The number of ids.
        ids: usize,
    },
    /// The caller's [`ReserveMemory`](super::change::ReserveMemory) rejects the new size.
    #[error(transparent)]
    Reserve(#[from] ReserveError),
}

/// The reason for which the caller rejects a group of another size.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum ReserveError {
    /// The group would be larger than the limit.
    #[error(
        "{n} individuals are more than one swarm may have, {limit}: add fewer, or raise max_individuals"
    )]
    TooMany {
        /// The requested size.
        n: usize,
        /// The limit.
        limit: usize,
    },
    /// The group would take more memory than is free.
    #[error(
        "a swarm of {} needs up to {needed} bytes, {free} are free: add fewer, delete another \
         swarm, or raise max_memory_mb",
        counted(*.n, "individual")
    )]
    NoMemory {
        /// The requested size.
        n: usize,
        /// Bytes that a group of this size needs.
        needed: u64,
        /// Bytes that are free.
        free: u64,
    },
}
