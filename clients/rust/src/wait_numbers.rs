//! The numbers of waits for conditions.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

/// How long the number of a wait that has ended is not used again: the daemon may still know the wait.
///
/// Numbers are used again since zenoh keeps something for each key of a liveliness token, in a table of
/// 65,535 keys.
const REUSE_DELAY: Duration = Duration::from_secs(15);

/// The numbers of waits.
#[derive(Debug, Default)]
pub(crate) struct WaitNumbers {
    count: u64,
    /// Those of waits that have ended, the first one first.
    free: VecDeque<(Instant, u64)>,
}

impl WaitNumbers {
    /// A number that no other wait has.
    pub fn take(&mut self) -> u64 {
        match self.free.front() {
            Some((since, number)) if since.elapsed() >= REUSE_DELAY => {
                let number = *number;
                self.free.pop_front();
                number
            }
            _ => {
                self.count += 1;
                self.count
            }
        }
    }

    /// Notes that a wait has ended.
    pub fn give_back(&mut self, number: u64) {
        self.free.push_back((Instant::now(), number));
    }
}
