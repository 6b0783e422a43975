//! Paces a swarm by the monotonic clock, and measures the rate that it reaches.

use std::time::{Duration, Instant};

use jostle_physics::simulation::Rate;

use super::Need;

/// How far behind its rate a swarm may be and still catch up. It absorbs the jitter of wake-ups; steps
/// due before that are dropped, so that no long burst follows a stall.
pub const MAX_BACKLOG: Duration = Duration::from_millis(50);

/// The period over which the rate is measured.
const WINDOW: Duration = Duration::from_secs(1);

/// The shorter period of the first measurement after a start.
const FIRST_WINDOW: Duration = Duration::from_millis(200);

/// The longest period, a century: a later time could overflow the clock.
const MAX_PERIOD: Duration = Duration::from_secs(100 * 365 * 86_400);

/// When the next step is due, and the rate of recent steps.
#[derive(Clone, Debug)]
pub struct Pace {
    period: Option<Duration>,
    next: Instant,
    /// When steps that were due were last dropped.
    dropped_at: Option<Instant>,
    window_began: Instant,
    window_steps: u32,
    reached: Option<f64>,
    dt: f64,
}

impl Pace {
    /// A pace of `rate` time units per second in steps of `dt` from `now` on.
    pub fn new(rate: Rate, dt: f64, now: Instant) -> Self {
        let period = rate.map(|rate| {
            // A rate is finite and positive; a period that the clock cannot represent becomes the longest.
            let period = Duration::try_from_secs_f64(dt / rate);
            period.map_or(MAX_PERIOD, |period| period.min(MAX_PERIOD))
        });
        Pace {
            period,
            next: now,
            dropped_at: None,
            window_began: now,
            window_steps: 0,
            reached: None,
            dt,
        }
    }

    /// Time until the next step is due; `None` if it is.
    pub fn until_due(&self, now: Instant) -> Option<Duration> {
        self.period?;
        self.next
            .checked_duration_since(now)
            .filter(|wait| !wait.is_zero())
    }

    /// How long a step has been due; `None` without a rate.
    pub fn late_by(&self, now: Instant) -> Option<Duration> {
        self.period?;
        Some(now.saturating_duration_since(self.next))
    }

    /// Whether it has a rate, and recently dropped steps.
    pub fn is_behind(&self, now: Instant) -> bool {
        let lately = |at| now.saturating_duration_since(at) < WINDOW;
        self.period.is_some() && self.dropped_at.is_some_and(lately)
    }

    /// How much it needs a turn.
    pub fn need(&self, now: Instant) -> Need {
        match self.period {
            None => Need::Unpaced,
            Some(_) if self.is_behind(now) => Need::Behind,
            Some(_) => Need::OnTime,
        }
    }

    /// Records a step.
    pub fn stepped(&mut self, now: Instant) {
        if let Some(period) = self.period {
            self.next += period;
            let allowed = period.max(MAX_BACKLOG);
            if now.saturating_duration_since(self.next) > allowed {
                self.next = now.checked_sub(allowed).unwrap_or(now);
                self.dropped_at = Some(now);
            }
        }
        self.window_steps += 1;
        let elapsed = now.saturating_duration_since(self.window_began);
        let is_first = self.reached.is_none() && elapsed >= FIRST_WINDOW;
        if elapsed >= WINDOW || is_first {
            self.reached = Some(f64::from(self.window_steps) * self.dt / elapsed.as_secs_f64());
        }
        if elapsed >= WINDOW {
            self.window_began = now;
            self.window_steps = 0;
        }
    }

    /// Time units per second of wall clock in the last window; `None` before the first measurement.
    pub fn real_time_factor(&self) -> Option<f64> {
        self.reached
    }
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use super::*;

    const MS: Duration = Duration::from_millis(1);

    #[test]
    fn steps_are_due_at_the_rate() {
        let start = Instant::now();
        let mut pace = Pace::new(Some(2.0), 0.02, start);
        assert_eq!(pace.until_due(start), None);
        pace.stepped(start);
        assert_eq!(pace.until_due(start), Some(10 * MS));
        assert_eq!(pace.until_due(start + 4 * MS), Some(6 * MS));
    }

    #[test]
    fn steps_after_a_late_wake_up_are_caught_up_and_those_of_a_stall_dropped() {
        let start = Instant::now();
        let mut pace = Pace::new(Some(2.0), 0.02, start);
        pace.stepped(start + 30 * MS);
        assert_eq!(pace.until_due(start + 30 * MS), None, "two more are due");
        assert!(!pace.is_behind(start + 30 * MS));
        pace.stepped(start + 1000 * MS);
        assert_eq!(pace.late_by(start + 1003 * MS), Some(53 * MS));
        let mut steps = 0;
        while pace.until_due(start + 1000 * MS).is_none() {
            pace.stepped(start + 1000 * MS);
            steps += 1;
        }
        assert_eq!(steps, 6, "no burst of a hundred");
        assert!(pace.is_behind(start + 1999 * MS) && !pace.is_behind(start + 2000 * MS));
    }

    #[test]
    fn without_a_rate_a_step_is_always_due() {
        let start = Instant::now();
        let mut pace = Pace::new(None, 0.02, start);
        pace.stepped(start);
        assert_eq!(pace.until_due(start), None);
        assert_eq!(pace.late_by(start + MS), None, "nothing was due");
        assert_eq!(pace.need(start + MS), Need::Unpaced);
    }

    #[test]
    fn the_rate_reached_is_steps_over_wall_clock() {
        let start = Instant::now();
        let mut pace = Pace::new(Some(1.0), 0.02, start);
        assert_eq!(pace.real_time_factor(), None);
        for step in 1..=50 {
            pace.stepped(start + step * 40 * MS);
        }
        assert!((pace.real_time_factor().unwrap() - 0.5).abs() < 0.01);
    }

    #[test]
    fn the_slowest_rate_does_not_overflow_the_clock() {
        let start = Instant::now();
        let mut pace = Pace::new(Some(f64::MIN_POSITIVE), 0.02, start);
        pace.stepped(start);
        assert!(pace.until_due(start).is_some());
    }
}
