//! Which of the published states go into a recording, and which never came.

use jostle_proto::State;

/// Tells what is new, what is far enough from the last, and what is missing.
#[derive(Debug, Default)]
pub struct Intake {
    every: Option<u64>,
    /// Epoch, step and number of the newest state.
    newest: Option<(u64, u64, u64)>,
    /// Epoch and step of the last that was recorded.
    recorded: Option<(u64, u64)>,
    /// States that were published and did not come.
    pub missed: u64,
    /// Steps the swarm has gone, whatever it was put back to.
    pub steps: u64,
}

impl Intake {
    /// Takes states that are at least so many steps apart, or all.
    pub fn new(every: Option<u64>) -> Self {
        Intake {
            every,
            ..Intake::default()
        }
    }

    /// Whether a state is to be recorded.
    pub fn takes(&mut self, state: &State) -> bool {
        let position = (state.epoch, state.step, state.frame);
        if let Some((epoch, step, frame)) = self.newest {
            // Published before the first was asked for.
            if position <= (epoch, step, frame) {
                return false;
            }
            // A daemon that came back counts anew.
            let before = if state.frame > frame { frame } else { 0 };
            self.missed += (state.frame - before).saturating_sub(1);
            if state.epoch == epoch {
                self.steps += state.step - step;
            }
        }
        self.newest = Some(position);
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
    use jostle_proto::{Certificate, Order, Phase};

    use super::*;

    fn state(epoch: u64, step: u64, frame: u64) -> State {
        State {
            swarm: "demo".into(),
            epoch,
            frame,
            step,
            time: 0.0,
            phase: Phase::Running,
            origin: [0, 0],
            id: vec![],
            x: vec![],
            y: vec![],
            alpha: vec![],
            weight: vec![],
            direction: vec![],
            order: Order {
                order: 0.0,
                mean_order: None,
                velocity: [0.0, 0.0],
                mean_velocity: None,
                direction: None,
                drift: None,
                mean_drift: None,
            },
            certificate: Certificate {
                worst_gap: None,
                residual: 0.0,
                degraded: 0,
                crossed: 0,
                contacts: 0,
                iterations: 0,
            },
        }
    }

    #[test]
    fn what_was_published_before_the_first_look_is_neither_taken_nor_missed() {
        let mut intake = Intake::new(None);
        assert!(intake.takes(&state(0, 12, 2)));
        assert!(!intake.takes(&state(0, 5, 1)));
        assert!(!intake.takes(&state(0, 10, 2)));
        assert!(intake.takes(&state(0, 15, 3)));
        assert_eq!((intake.missed, intake.steps), (0, 3));
    }

    #[test]
    fn numbers_that_lack_are_counted_and_a_daemon_that_came_back_counts_anew() {
        let mut intake = Intake::new(None);
        intake.takes(&state(0, 5, 1));
        intake.takes(&state(0, 30, 4));
        assert_eq!(intake.missed, 2);
        intake.takes(&state(1, 25, 2));
        assert_eq!((intake.missed, intake.steps), (3, 25));
    }

    #[test]
    fn states_too_near_to_the_last_are_left_out() {
        let mut intake = Intake::new(Some(10));
        let taken = [(0, 0), (0, 5), (0, 10), (0, 19), (0, 21), (1, 0), (1, 5)];
        let taken: Vec<bool> = (1..)
            .zip(taken)
            .map(|(frame, (epoch, step))| intake.takes(&state(epoch, step, frame)))
            .collect();
        assert_eq!(taken, [true, false, true, false, true, true, false]);
        assert_eq!(intake.missed, 0);
    }
}
