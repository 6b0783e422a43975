//! The time that players lay messages out by.

use super::Moment;

/// Nanoseconds of a unit of simulated time: players show seconds.
const UNIT: f64 = 1e9;

/// Turns simulated time into nanoseconds that never fall.
///
/// It is the simulated time, because plots are to be over that: a swarm that runs as fast as it
/// can, stands still for an hour or is stepped by hand would be squeezed or torn by the wall
/// clock, which messages carry as the time of publishing. What begins anew, such as a reset, is
/// laid a nanosecond behind all that was before.
#[derive(Clone, Debug, Default)]
pub struct Timeline {
    /// Where each epoch's time 0 lies.
    epochs: Vec<(u64, i128)>,
    last: i128,
}

impl Timeline {
    /// Lays what is to come behind what ended there.
    pub fn go_on(&mut self, last: u64) {
        self.last = self.last.max(i128::from(last));
    }

    /// When something comes, in nanoseconds.
    pub fn at(&mut self, moment: &Moment) -> u64 {
        #[expect(clippy::cast_possible_truncation, reason = "a float becomes what fits")]
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
        // A reset, and an event of before that comes late.
        assert_eq!(at(1, 0.0), 1_500_000_001);
        assert_eq!(at(0, 1.5), 1_500_000_000);
        assert_eq!(at(1, 2.0), 3_500_000_001);
        // What goes on further ahead goes on there.
        assert_eq!(at(2, 3.0), 4_500_000_001);
    }
}
