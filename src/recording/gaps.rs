//! What a recording lacks after a crash of the daemon.
//!
//! The metadata of each part state up to which state the recording is complete, or has counted what it
//! lacks ([`CountedTo`]). A recovered swarm continues at another state. The steps between the two that the
//! recording should contain are a [`Gap`].

use std::path::Path;

use jostle_proto::State;
use jostle_results::recording::{self, About, Format, RecordingError};
use serde::{Deserialize, Serialize};

use super::status::{Gap, Position, Status};

/// The metadata key for the gaps, as a JSON list.
const GAPS: &str = "gaps";

/// The metadata key for [`CountedTo`], as JSON.
const COUNTED_TO: &str = "counted_to";

/// The metadata key for the number of missed states.
const MISSED: &str = "missed";

/// Gaps that are named, the newest: with more of them the metadata of each part would grow.
const MAX_GAPS: usize = 100;

/// Up to which state a recording contains all states, or has counted those that it lacks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct CountedTo {
    #[serde(flatten)]
    pub at: Position,
    /// The steps that it is to record after this state, if their number is limited.
    pub steps_left: Option<u64>,
    /// The missing states of all gaps.
    pub lost: u64,
}

impl CountedTo {
    /// Adds it to the metadata of a part, with the number of all missed states.
    pub fn describe(&self, missed: u64) -> About {
        let json = serde_json::to_string(self).unwrap_or_default();
        About::from([
            (MISSED.to_owned(), missed.to_string()),
            (COUNTED_TO.to_owned(), json),
        ])
    }
}

/// Adds the gaps of a recording to the metadata of its next part.
pub(super) fn describe(gaps: &[Gap], about: &mut About) {
    if !gaps.is_empty() {
        let json = serde_json::to_string(gaps).unwrap_or_default();
        about.insert(GAPS.to_owned(), json);
    }
}

impl Status {
    /// Counts what the recording lacks between its last part and the state at which it resumes. Returns
    /// whether the swarm has already taken the steps that were to be recorded.
    ///
    /// `resets` are the states at which the swarm was reset, oldest first.
    pub(super) fn count_lost(
        &mut self,
        folder: &Path,
        resets: &[Position],
        until: Position,
    ) -> Result<bool, RecordingError> {
        let last = recording::parts(folder)?.pop();
        let (from, after) = match last {
            Some(part) => match self.counted_to(&part)? {
                Some(at) => (at, Some(at)),
                // An earlier version wrote it as Parquet.
                None => return Ok(false),
            },
            None => match self.began_at {
                Some(at) => (at, None),
                None => return Ok(false),
            },
        };
        let every = self.every.unwrap_or(1).max(1);
        let lost = Lost::between(from, after.is_some(), every, self.steps_left, resets, until);
        self.steps_left = lost.steps_left;
        if lost.missed > 0 {
            self.missed += lost.missed;
            self.lost += lost.missed;
            self.gaps.push(Gap {
                after,
                until,
                missed: lost.missed,
            });
            let too_many = self.gaps.len().saturating_sub(MAX_GAPS);
            self.gaps.drain(..too_many);
        }
        Ok(lost.is_over)
    }

    /// Reads from the last part up to which state the recording is complete, and replaces the counts of
    /// the status file, which may be older.
    fn counted_to(&mut self, part: &Path) -> Result<Option<Position>, RecordingError> {
        let about = recording::metadata(part)?;
        let Some(counted) = parse::<CountedTo>(&about, COUNTED_TO) else {
            return match Format::of(part)? {
                Format::Mcap => last_state(part),
                Format::Parquet => Ok(None),
            };
        };
        self.steps_left = counted.steps_left;
        self.lost = counted.lost;
        self.missed = parse(&about, MISSED).unwrap_or(self.missed);
        self.gaps = parse(&about, GAPS).unwrap_or_default();
        Ok(Some(counted.at))
    }
}

fn parse<T: for<'a> Deserialize<'a>>(about: &About, key: &str) -> Option<T> {
    serde_json::from_str(about.get(key)?).ok()
}

/// The last state of a part by an earlier version.
fn last_state(part: &Path) -> Result<Option<Position>, RecordingError> {
    let mut last = None;
    recording::read(part, |message| {
        if message.topic == "state" {
            let state = State::from_cbor(message.bytes).map_err(|error| error.to_string())?;
            last = Some((state.epoch, state.step).into());
        }
        Ok(())
    })?;
    Ok(last)
}

/// What a recording lost between two states.
#[derive(Debug, PartialEq, Eq)]
struct Lost {
    missed: u64,
    steps_left: Option<u64>,
    /// Whether the swarm has taken all steps that were to be recorded.
    is_over: bool,
}

impl Lost {
    /// Counts the multiples of `every` after `from`, or from it on unless it is counted, and before
    /// `until`. A swarm that a crash has rolled back behind `from` has lost nothing.
    fn between(
        from: Position,
        is_counted: bool,
        every: u64,
        mut steps_left: Option<u64>,
        resets: &[Position],
        until: Position,
    ) -> Self {
        // The multiples from 0 on that are less than `step`.
        let below = |step: u64| step.div_ceil(every);
        let (mut start, mut next) = (from.step, from.step + u64::from(is_counted));
        let mut missed = 0;
        for reset in resets.iter().filter(|it| it.epoch >= from.epoch) {
            let steps = reset.step.saturating_sub(start);
            let taken = steps_left.map_or(steps, |left| left.min(steps));
            missed += below(start + taken + 1).saturating_sub(below(next));
            steps_left = steps_left.map(|left| left - taken);
            (start, next) = (0, 0);
            if steps_left == Some(0) {
                return Lost {
                    missed,
                    steps_left,
                    is_over: true,
                };
            }
        }
        let Some(steps) = until.step.checked_sub(start) else {
            // Rolled back: these steps are taken and recorded once more.
            let again = start - until.step;
            return Lost {
                missed,
                steps_left: steps_left.map(|left| left + again),
                is_over: false,
            };
        };
        let is_over = steps_left.is_some_and(|left| left < steps);
        let end = match steps_left {
            Some(left) if is_over => start + left + 1,
            _ => until.step,
        };
        Lost {
            missed: missed + below(end).saturating_sub(below(next)),
            steps_left: steps_left.map(|left| left.saturating_sub(steps)),
            is_over,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(epoch: u64, step: u64) -> Position {
        Position { epoch, step }
    }

    fn lost(missed: u64, steps_left: Option<u64>, is_over: bool) -> Lost {
        Lost {
            missed,
            steps_left,
            is_over,
        }
    }

    #[test]
    fn multiples_between_the_last_state_and_the_recovered_one_are_missed() {
        let between = |from, until, every| {
            Lost::between(at(1, from), true, every, None, &[], at(2, until)).missed
        };
        // 11 to 19.
        assert_eq!(between(10, 20, 1), 9);
        // 12, 15, 18; the state at 21 is recorded when it resumes.
        assert_eq!(between(9, 20, 3), 3);
        assert_eq!(between(9, 21, 3), 3);
        assert_eq!(between(9, 22, 3), 4);
        // An orderly stop, and one rolled back.
        assert_eq!(between(10, 10, 1), 0);
        assert_eq!(between(10, 11, 1), 0);
        assert_eq!(between(10, 4, 1), 0);
        // Nothing is recorded: from step 10 on.
        let from_begin = |until| Lost::between(at(1, 10), false, 5, None, &[], at(2, until)).missed;
        assert_eq!([from_begin(10), from_begin(11), from_begin(16)], [0, 1, 2]);
        assert_eq!(from_begin(3), 0);
    }

    #[test]
    fn a_reset_begins_again_at_step_0() {
        let resets = [at(0, 7), at(1, 25), at(2, 10)];
        // 21 to 25, 0 to 10, 0 to 3; the reset of epoch 0 was before the last state.
        let found = Lost::between(at(1, 20), true, 1, None, &resets, at(3, 4));
        assert_eq!(found, lost(5 + 11 + 4, None, false));
        // 25, 0, 5, 10, 0.
        let found = Lost::between(at(1, 20), true, 5, None, &resets, at(3, 4));
        assert_eq!(found, lost(5, None, false));
        // Rolled back to 12 before the reset at 15: the steps up to 20 are in the file.
        let found = Lost::between(at(1, 20), true, 1, None, &[at(2, 15)], at(4, 2));
        assert_eq!(found, lost(2, None, false));
    }

    #[test]
    fn the_limit_of_steps_counts_lost_steps_and_not_those_taken_twice() {
        let between =
            |until, left| Lost::between(at(1, 10), true, 1, Some(left), &[], at(2, until));
        assert_eq!(between(14, 10), lost(3, Some(6), false));
        assert_eq!(between(4, 10), lost(0, Some(16), false));
        // The last state to record is that at which it resumes, and one before it.
        assert_eq!(between(20, 10), lost(9, Some(0), false));
        assert_eq!(between(21, 10), lost(10, Some(0), true));
        assert_eq!(between(500, 10), lost(10, Some(0), true));
        let resets = [at(1, 15)];
        // 11 to 15, 0 to 2 of the five steps that are left after the reset.
        let found = Lost::between(at(1, 10), true, 1, Some(10), &resets, at(3, 3));
        assert_eq!(found, lost(8, Some(2), false));
        let found = Lost::between(at(1, 10), true, 1, Some(5), &resets, at(3, 3));
        assert_eq!(found, lost(5, Some(0), true));
    }
}
