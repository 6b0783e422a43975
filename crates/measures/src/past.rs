//! Positions and headings of earlier steps.

use std::cmp::Ordering;
use std::collections::VecDeque;

use jostle_physics::model::{CELL, Configuration, State};
use thiserror::Error;

/// The most poses of earlier steps: for each step of a [`Past`] the number of individuals and
/// [`FRAME_POSES`].
///
/// A pose has 28 bytes in memory, so a past takes about 7 MB at most, with the frame of the newest step
/// beside it. A checkpoint contains the past with at most 32 bytes for each pose, 8 MB.
/// [`Past`] does not apply this limit: its user calls [`check_past`], also when individuals are added.
pub const MAX_PAST: u64 = 250_000;

/// How many poses take as much memory as a frame without its individuals.
pub const FRAME_POSES: u64 = 8;

/// Returns for how many poses a frame of `n` individuals counts.
fn poses_of(n: usize) -> u64 {
    (n as u64).saturating_add(FRAME_POSES)
}

/// Checks that a past of `lag_steps` steps of `n` individuals is within [`MAX_PAST`].
///
/// # Errors
///
/// [`PastError::TooLarge`].
pub fn check_past(lag_steps: u64, n: usize) -> Result<(), PastError> {
    let poses = lag_steps.saturating_mul(poses_of(n));
    match poses <= MAX_PAST {
        true => Ok(()),
        false => Err(PastError::TooLarge { poses }),
    }
}

/// Why a past is rejected.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum PastError {
    /// It has more than [`MAX_PAST`] poses.
    #[error(
        "the measures need {poses} poses of earlier steps (for each step the individuals and {FRAME_POSES}), the limit is {MAX_PAST}: choose a shorter lag or a smaller group"
    )]
    TooLarge {
        /// Their number; `u64::MAX` if it is larger.
        poses: u64,
    },
    /// A stored frame is invalid.
    #[error("the stored frame of step {step} is invalid: {reason}")]
    Frame {
        /// Its step.
        step: u64,
        /// What is wrong.
        reason: &'static str,
    },
}

/// The positions and headings of all individuals at one step. The columns have one entry per
/// individual, and ids strictly increase, as in a [`Configuration`].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Frame {
    /// Number of steps taken.
    pub step: u64,
    /// The cell to whose origin positions are relative: absolute positions are
    /// `CELL * origin + (x, y)`.
    pub origin: [i64; 2],
    /// Ids of the individuals.
    pub id: Vec<u32>,
    /// Centres relative to the origin, in body sizes.
    pub x: Vec<f64>,
    /// Centres relative to the origin, in body sizes.
    pub y: Vec<f64>,
    /// Headings in radians, never wrapped.
    pub alpha: Vec<f64>,
}

impl Frame {
    /// Copies a state into the buffers of this frame.
    fn copy(&mut self, state: &State) {
        let configuration = &state.configuration;
        self.step = state.step;
        self.origin = configuration.origin;
        self.id.clone_from(&configuration.id);
        self.x.clone_from(&configuration.x);
        self.y.clone_from(&configuration.y);
        self.alpha.clone_from(&configuration.alpha);
    }

    fn check(&self) -> Result<(), PastError> {
        let n = self.id.len();
        let columns = [&self.x, &self.y, &self.alpha];
        let is_rectangular = columns.iter().all(|column| column.len() == n);
        let mut numbers = columns.into_iter().flatten();
        let reason = if n == 0 {
            "it has no individuals"
        } else if !is_rectangular {
            "its columns have different lengths"
        } else if !self.id.is_sorted_by(|one, next| one < next) {
            "its ids do not increase"
        } else if !numbers.all(|number| number.is_finite()) {
            "it has a number that is not finite"
        } else {
            return Ok(());
        };
        let step = self.step;
        Err(PastError::Frame { step, reason })
    }

    /// Returns the indices of the individuals that are present in `now` and in this frame, as pairs of
    /// the index in `now` and that in this frame.
    pub(crate) fn matched<'a>(
        &'a self,
        now: &'a Configuration,
    ) -> impl Iterator<Item = (usize, usize)> + 'a {
        let mut then = 0;
        now.id.iter().enumerate().filter_map(move |(index, id)| {
            while self.id.get(then).is_some_and(|earlier| earlier < id) {
                then += 1;
            }
            (self.id.get(then) == Some(id)).then_some((index, then))
        })
    }

    /// Returns the displacement of an individual from its place in this frame, at index `then`, to
    /// that in `now`, at `index`; in body sizes.
    pub(crate) fn displacement(&self, then: usize, now: &Configuration, index: usize) -> [f64; 2] {
        let shift = |axis: usize| CELL * now.origin[axis].wrapping_sub(self.origin[axis]) as f64;
        [
            shift(0) + now.x[index] - self.x[then],
            shift(1) + now.y[index] - self.y[then],
        ]
    }
}

/// Positions and headings of earlier steps, as far back as measures need them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Past {
    lag_steps: u64,
    /// Their steps strictly increase.
    frames: VecDeque<Frame>,
    /// For how many poses the frames count.
    poses: u64,
}

impl Past {
    /// Creates an empty past that reaches `lag_steps` steps back, the largest lag of the measures
    /// ([`Measure::lag`](crate::Measure::lag)). With 0 it stores nothing.
    #[must_use]
    pub fn new(lag_steps: u64) -> Self {
        Self {
            lag_steps,
            ..Self::default()
        }
    }

    /// Restores a past from the frames of an earlier one.
    ///
    /// # Errors
    ///
    /// [`PastError::Frame`] if columns have different lengths or numbers that are not finite, if there
    /// are no individuals, or if ids or steps do not increase.
    pub fn from_frames(
        lag_steps: u64,
        frames: impl IntoIterator<Item = Frame>,
    ) -> Result<Self, PastError> {
        let mut past = Self::new(lag_steps);
        let mut last = None;
        for frame in frames {
            frame.check()?;
            let step = frame.step;
            if last.is_some_and(|last| last >= step) {
                let reason = "it does not follow the frame before it";
                return Err(PastError::Frame { step, reason });
            }
            last = Some(step);
            past.drop_before(step);
            if lag_steps > 0 {
                past.push(frame);
            }
        }
        Ok(past)
    }

    /// Appends the positions, headings and ids of `state`, and drops what is older than the lag.
    ///
    /// Call it for the first state and after every step. A state of the same step as the last replaces
    /// it, since commands change a state between two steps. A state of a lower step comes from a reset
    /// and clears the past.
    pub fn observe(&mut self, state: &State) {
        if self.lag_steps == 0 {
            return;
        }
        let mut replaced = None;
        match self.frames.back().map(|last| last.step.cmp(&state.step)) {
            Some(Ordering::Greater) => self.clear(),
            Some(Ordering::Equal) => replaced = self.pop(VecDeque::pop_back),
            Some(Ordering::Less) | None => {}
        }
        // The buffers of a frame that is no longer needed are used again.
        let dropped = self.drop_before(state.step);
        let mut frame = replaced.or(dropped).unwrap_or_default();
        frame.copy(state);
        self.push(frame);
    }

    /// Appends a state as [`Past::observe`], and changes how far the past reaches back. So that it
    /// never has more than [`MAX_PAST`] poses beside those of `state`, it drops the oldest ones.
    pub fn observe_with(&mut self, state: &State, lag_steps: u64) {
        self.lag_steps = lag_steps;
        if lag_steps == 0 {
            return self.clear();
        }
        self.observe(state);
        while self.earlier_poses() > MAX_PAST {
            self.pop(VecDeque::pop_front);
        }
    }

    /// Returns for how many poses the frames before the newest one count; see [`MAX_PAST`].
    #[must_use]
    pub fn earlier_poses(&self) -> u64 {
        let newest = self.frames.back();
        self.poses - newest.map_or(0, |frame| poses_of(frame.id.len()))
    }

    fn push(&mut self, frame: Frame) {
        self.poses += poses_of(frame.id.len());
        self.frames.push_back(frame);
    }

    fn pop(&mut self, end: fn(&mut VecDeque<Frame>) -> Option<Frame>) -> Option<Frame> {
        let frame = end(&mut self.frames)?;
        self.poses -= poses_of(frame.id.len());
        Some(frame)
    }

    fn clear(&mut self) {
        self.frames.clear();
        self.poses = 0;
    }

    /// Drops the frames that `step` does not need; returns one of them.
    fn drop_before(&mut self, step: u64) -> Option<Frame> {
        let oldest = step.saturating_sub(self.lag_steps);
        let mut dropped = None;
        while self.frames.front().is_some_and(|first| first.step < oldest) {
            dropped = self.pop(VecDeque::pop_front);
        }
        dropped
    }

    /// Returns the frame of a step; none if it was not observed or is older than the lag.
    #[must_use]
    pub fn at(&self, step: u64) -> Option<&Frame> {
        let index = self.frames.partition_point(|frame| frame.step < step);
        self.frames.get(index).filter(|frame| frame.step == step)
    }

    /// Returns all frames by ascending step, for a checkpoint. [`Past::from_frames`] restores them.
    pub fn frames(&self) -> impl ExactSizeIterator<Item = &Frame> {
        self.frames.iter()
    }

    /// Returns the number of steps that it reaches back.
    #[must_use]
    pub fn lag_steps(&self) -> u64 {
        self.lag_steps
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests;
