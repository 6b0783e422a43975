//! Selects the published states to record, and counts missed ones.

use jostle_proto::State;

/// Filters states by the distance in steps, and counts gaps.
#[derive(Debug, Default)]
pub struct FrameFilter {
    every: Option<u64>,
    /// Epoch, step and number of the newest state.
    newest: Option<(u64, u64, u64)>,
    /// Epoch and step of the last recorded state.
    recorded: Option<(u64, u64)>,
    /// The number of published states that were not received.
    pub missed: u64,
    /// The steps of the swarm so far, resets included.
    pub steps: u64,
}

impl FrameFilter {
    /// Selects states that are at least this many steps apart, or all.
    pub fn new(every: Option<u64>) -> Self {
        FrameFilter {
            every,
            ..FrameFilter::default()
        }
    }

    /// Whether a state is to be recorded.
    pub fn accepts(&mut self, state: &State) -> bool {
        let position = (state.epoch, state.step, state.frame);
        let mut newest = state.frame;
        if let Some((epoch, step, frame)) = self.newest {
            // Published before the first queried state was taken.
            if position <= (epoch, step, frame) {
                self.newest = Some((epoch, step, state.frame.max(frame)));
                return false;
            }
            // A restarted daemon counts from 0, in a later epoch. In the same one nothing is missing: an
            // earlier daemon numbers a queried state after it took it.
            let is_restarted = state.epoch > epoch && state.frame <= frame;
            let before = if is_restarted { 0 } else { frame };
            self.missed += state.frame.saturating_sub(before.saturating_add(1));
            newest = newest.max(before);
            if state.epoch == epoch {
                self.steps += state.step - step;
            }
        }
        self.newest = Some((state.epoch, state.step, newest));
        let is_far = match (self.every, self.recorded) {
            (Some(every), Some((epoch, step))) if epoch == state.epoch => {
                state.step - step >= every
            }
            _ => true,
        };
        if is_far {
            self.recorded = Some((state.epoch, state.step));
        }
        is_far
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures;

    fn state(epoch: u64, step: u64, frame: u64) -> State {
        State {
            epoch,
            step,
            frame,
            ..fixtures::state()
        }
    }

    #[test]
    fn states_published_before_the_first_query_are_ignored() {
        let mut filter = FrameFilter::new(None);
        assert!(filter.accepts(&state(0, 12, 2)));
        assert!(!filter.accepts(&state(0, 5, 1)));
        assert!(!filter.accepts(&state(0, 10, 2)));
        assert!(!filter.accepts(&state(0, 11, 3)));
        assert!(filter.accepts(&state(0, 15, 4)));
        assert_eq!((filter.missed, filter.steps), (0, 3));
    }

    #[test]
    fn missing_numbers_are_counted_also_after_a_restart() {
        let mut filter = FrameFilter::new(None);
        filter.accepts(&state(0, 5, 1));
        filter.accepts(&state(0, 30, 4));
        assert_eq!(filter.missed, 2);
        filter.accepts(&state(1, 25, 2));
        assert_eq!((filter.missed, filter.steps), (3, 25));
    }

    #[test]
    fn a_state_without_a_higher_number_than_the_queried_one_misses_none() {
        for frame in [113, 114] {
            let mut filter = FrameFilter::new(None);
            assert!(filter.accepts(&state(0, 12, 114)));
            assert!(filter.accepts(&state(0, 15, frame)));
            assert!(filter.accepts(&state(0, 18, 115)));
            assert_eq!((filter.missed, filter.steps), (0, 6), "{frame}");
            filter.accepts(&state(0, 24, 117));
            assert_eq!(filter.missed, 1, "116 is missing");
            // The daemon is restarted: 1 to 3 are missing.
            filter.accepts(&state(1, 20, 4));
            assert_eq!(filter.missed, 4);
        }
    }

    #[test]
    fn states_too_near_to_the_last_are_left_out() {
        let mut filter = FrameFilter::new(Some(10));
        let states = [(0, 0), (0, 5), (0, 10), (0, 19), (0, 21), (1, 0), (1, 5)];
        let accepted: Vec<bool> = (1..)
            .zip(states)
            .map(|(frame, (epoch, step))| filter.accepts(&state(epoch, step, frame)))
            .collect();
        assert_eq!(accepted, [true, false, true, false, true, true, false]);
        assert_eq!(filter.missed, 0);
    }
}
