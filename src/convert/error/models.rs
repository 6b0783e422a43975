//! Requests that concern what an earlier version of the model has computed or accepted.

use jostle_convert::error::object;
use jostle_physics::model::MODEL_VERSION;
use serde_json::{Map, Value, json};
use thiserror::Error as ThisError;

/// Why what an earlier version of the model did cannot be repeated.
#[derive(Clone, Debug, ThisError)]
pub enum EarlierModelError {
    /// The history before a state that is asked for begins there.
    #[error(
        "version {model_version} of the model computed the state of step {step}, and this daemon has \
         version {MODEL_VERSION}, which computes other steps from there: name a later step"
    )]
    Computed {
        /// The version that computed it.
        model_version: u32,
        /// The step from which the history would be replayed.
        step: u64,
    },
    /// The command was accepted once, and is not executed again.
    #[error(
        "version {model_version} of the model accepted this command at step {step}, and its reply was \
         lost when that daemon was killed: `jostle journal` shows the command"
    )]
    Accepted {
        /// The version that accepted it.
        model_version: u32,
        /// The step at which it was accepted.
        step: u64,
    },
}

impl EarlierModelError {
    pub(super) fn details(&self) -> Map<String, Value> {
        let (Self::Computed {
            model_version,
            step,
        }
        | Self::Accepted {
            model_version,
            step,
        }) = self;
        object(json!({"model_version": model_version, "step": step}))
    }
}
