//! Converts the states of earlier steps from and to their message.

use jostle_measures::{Frame, Past, PastError};
use jostle_proto::snapshot::PastFrame;

/// Returns the frames of a past.
#[must_use]
pub fn to_proto(past: &Past) -> Vec<PastFrame> {
    let frames = past.frames();
    frames
        .map(|frame| PastFrame {
            step: frame.step,
            origin: frame.origin,
            id: frame.id.clone(),
            x: frame.x.clone(),
            y: frame.y.clone(),
            alpha: frame.alpha.clone(),
        })
        .collect()
}

/// Returns the past with these frames, which reaches `lag_steps` steps back.
///
/// # Errors
///
/// [`PastError::Frame`].
pub fn from_proto(
    lag_steps: u64,
    frames: impl IntoIterator<Item = PastFrame>,
) -> Result<Past, PastError> {
    let frames = frames.into_iter().map(|frame| Frame {
        step: frame.step,
        origin: frame.origin,
        id: frame.id,
        x: frame.x,
        y: frame.y,
        alpha: frame.alpha,
    });
    Past::from_frames(lag_steps, frames)
}
