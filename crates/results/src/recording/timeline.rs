//! The log time of messages, by which players order them.

use super::Moment;

/// Nanoseconds per unit of simulated time, `s/v0`: players show a unit as a second.
const UNIT: f64 = 1e9;

/// Converts simulated time to nanoseconds such that each epoch begins after the last log time.
///
/// The log time is the simulated time, since plots are drawn over it. The wall clock, which
/// messages carry as the publish time, would compress or stretch a swarm that runs as fast as
/// possible, pauses for an hour or is stepped by hand. If an epoch, such as that of a reset, would
/// begin at or before the last log time, it begins one nanosecond after it.
#[derive(Clone, Debug, Default)]
pub struct Timeline {
    /// Each epoch and the log time of its time 0, in nanoseconds.
    epochs: Vec<(u64, i128)>,
    last: i128,
}

impl Timeline {
    /// Places later messages after `last`, the last log time of a recorded part in nanoseconds.
    pub fn resume(&mut self, last: u64) {
        self.last = self.last.max(i128::from(last));
    }

    /// Returns the log time of `moment`, in nanoseconds.
    pub fn at(&mut self, moment: &Moment) -> u64 {
        #[expect(clippy::cast_possible_truncation, reason = "the cast saturates")]
        let own = (moment.time * UNIT).round() as i128;
        let known = self.epochs.iter().find(|(epoch, _)| *epoch == moment.epoch);
        let offset = known.map(|(_, offset)| *offset).unwrap_or_else(|| {
            let before = self.epochs.last().map(|(_, offset)| *offset);
            let offset = match before {
                Some(offset) if own + offset > self.last => offset,
                Some(_) => self.last + 1 - own,
                None if own <= self.last && self.last > 0 => self.last + 1 - own,
                None => 0,
            };
            self.epochs.push((moment.epoch, offset));
            offset
        });
        let at = own + offset;
        self.last = self.last.max(at);
        u64::try_from(at.max(0)).unwrap_or(u64::MAX)
    }
}

#[cfg(test)]
mod tests {
    use std::time::SystemTime;

    use super::*;

    #[test]
    fn time_never_falls_however_often_a_swarm_is_reset() {
        let mut timeline = Timeline::default();
        let mut at = |epoch, time| {
            timeline.at(&Moment {
                epoch,
                number: 0,
                time,
                taken: SystemTime::UNIX_EPOCH,
            })
        };
        assert_eq!(at(0, 0.0), 0);
        assert_eq!(at(0, 1.5), 1_500_000_000);
        // A reset, and a late event of the previous epoch.
        assert_eq!(at(1, 0.0), 1_500_000_001);
        assert_eq!(at(0, 1.5), 1_500_000_000);
        assert_eq!(at(1, 2.0), 3_500_000_001);
        // An epoch that begins after the last log time keeps the previous epoch's offset.
        assert_eq!(at(2, 3.0), 4_500_000_001);
    }
}
