//! Evaluates the measures in `/metrics` in the lane of `get/measures`, which has a low priority.

use std::sync::Arc;
use std::time::Duration;

use tokio::sync::{Semaphore, oneshot};
use tokio::time::timeout;

use super::openmetrics::MAX_LABELLED;
use crate::health::metrics::DaemonMetrics;
use crate::lanes::{Lane, Lanes, Task};
use crate::swarm::frame::Frame;

/// Whose turn it takes in the lane; no user has this name.
const TURN: &str = "/metrics";

/// How long a request waits for the measures.
const MAX_WAIT: Duration = Duration::from_secs(2);

/// Evaluates measures for one request at a time.
pub struct Evaluations {
    lanes: Lanes,
    free: Arc<Semaphore>,
}

impl Evaluations {
    pub fn new(lanes: Lanes) -> Self {
        let free = Arc::new(Semaphore::new(1));
        Evaluations { lanes, free }
    }

    /// Evaluates the measures of the swarms that `/metrics` lists. It returns at once while those of
    /// another request are evaluated, and after [`MAX_WAIT`] in any case; what is not evaluated then
    /// remains so.
    pub async fn evaluate(&self, metrics: &DaemonMetrics) {
        let swarms = metrics.swarms.iter().take(MAX_LABELLED);
        let frames = swarms.filter_map(|swarm| swarm.measured.clone());
        let frames = frames.filter(|frame| frame.values.get().is_none());
        let evaluate = |frame: Arc<Frame>| {
            frame.values();
        };
        self.execute(frames.collect(), evaluate).await;
    }

    async fn execute<T: Send + 'static>(&self, items: Vec<T>, work: fn(T)) {
        if items.is_empty() {
            return;
        }
        let Ok(permit) = self.free.clone().try_acquire_owned() else {
            return;
        };
        let (done, executed) = oneshot::channel();
        let task = Task::new(&TURN.into(), move |_| {
            let _permit = permit;
            for item in items {
                // The request waits no longer, or its connection is closed.
                if done.is_closed() {
                    return;
                }
                work(item);
            }
            let _ = done.send(());
        });
        // What is not evaluated remains so.
        if self.lanes.submit(Lane::Measures, task).is_err() {
            return;
        }
        let _ = timeout(MAX_WAIT, executed).await;
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use std::sync::mpsc::{Receiver, Sender, channel};
    use std::time::Instant;

    use super::*;

    /// An item that reports its number.
    type Item = (Sender<u32>, u32);

    fn report((sender, number): Item) {
        sender.send(number).unwrap();
    }

    #[tokio::test]
    async fn one_request_at_a_time_waits_and_its_work_ends_with_it() {
        let lanes = Lanes::start().unwrap();
        let (release, blocked): (_, Receiver<()>) = channel();
        let task = Task::new(&"other".into(), move |_| blocked.recv().unwrap());
        lanes.submit(Lane::Measures, task).unwrap();
        let evaluations = Evaluations::new(lanes.clone());
        let (sender, executed) = channel();
        let items = |number: u32| vec![(sender.clone(), number)];
        let began = Instant::now();
        let second = async {
            evaluations.execute(items(2), report).await;
            began.elapsed()
        };
        // The thread is occupied by another request.
        let ((), second) = tokio::join!(evaluations.execute(items(1), report), second);
        assert!(second < MAX_WAIT / 2, "{second:?}");
        assert!(began.elapsed() >= MAX_WAIT, "{:?}", began.elapsed());
        release.send(()).unwrap();
        // What was not begun in time is not executed.
        while evaluations.free.available_permits() == 0 {
            tokio::task::yield_now().await;
        }
        evaluations.execute(items(3), report).await;
        assert_eq!(executed.try_iter().collect::<Vec<_>>(), [3]);
        lanes.stop();
    }
}
