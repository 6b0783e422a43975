//! The stop of the daemon.

use std::sync::mpsc::channel;
use std::thread;
use std::time::Duration;

use tokio::task::{JoinHandle, spawn_blocking};
use tracing::{error, info, warn};

use crate::app::server::{Connection, Server};
use crate::transport::zenoh::messages::DispatchMessage;

/// How long swarms may take to finish their current step.
const SWARM_STOP_TIMEOUT: Duration = Duration::from_millis(500);

/// How long experiments may take to finish the current steps of their runs, and to write the tables.
const EXPERIMENT_STOP_TIMEOUT: Duration = Duration::from_secs(1);

/// How long recordings may take to write what is queued.
const RECORDING_STOP_TIMEOUT: Duration = Duration::from_secs(1);

/// How long the store may take to write what is queued.
const STORE_STOP_TIMEOUT: Duration = Duration::from_secs(1);

/// How long closing the session may take; with a frozen client it would take ten seconds.
const SESSION_CLOSE_TIMEOUT: Duration = Duration::from_secs(1);

impl Server {
    /// Stops the daemon: it accepts no more commands, pauses every swarm between two steps, writes
    /// everything that is queued, and closes the session. Takes less than two seconds whatever the
    /// clients do. Returns whether everything is written.
    pub async fn stop(self) -> bool {
        info!("stopping");
        self.reject_requests();
        let (experiments, registry) = (self.experiments.clone(), self.registry.clone());
        let experiments = spawn_blocking(move || experiments.stop(EXPERIMENT_STOP_TIMEOUT));
        let swarms = spawn_blocking(move || registry.stop(SWARM_STOP_TIMEOUT));
        warn_of_late(swarms, "swarms were still in a step").await;
        warn_of_late(experiments, "experiments were still in a step").await;

        // After the swarms, so that recordings and the store receive their last states.
        let (recordings, store) = (self.recordings.clone(), self.store.clone());
        let audit = self.audit.clone();
        let recordings = spawn_blocking(move || recordings.close(RECORDING_STOP_TIMEOUT));
        let stored = spawn_blocking(move || {
            audit.write_changes();
            store.stop(STORE_STOP_TIMEOUT)
        });
        let is_written = stored.await.unwrap_or(false);
        if !is_written {
            self.log_unwritten();
        }
        warn_of_late(recordings, "recordings were not completely written").await;

        self.publisher.stop();
        self.replies.stop();
        close(self.connection).await;
        is_written
    }

    /// Logs the swarms whose last steps are not written.
    fn log_unwritten(&self) {
        error!("the store is not completely written, because the disk is full or slow");
        for (swarm, handle) in self.registry.handles().0 {
            let Some(summary) = handle.summary().filter(|it| !it.is_replay) else {
                continue;
            };
            let (step, durable_step) = (summary.stamp.step, handle.durable_step());
            if durable_step < step {
                error!(
                    swarm,
                    step, durable_step, "the steps after `durable_step` are lost, as after a crash"
                );
            }
        }
    }

    /// Stops the threads that receive requests, and the health checks.
    fn reject_requests(&self) {
        self.replies.close();
        self.watch.stop();
        self.bus.stop();
        if let Some(gateway) = &self.gateway {
            gateway.stop();
        }
        let _ = self.messages.try_send(DispatchMessage::Stop);
    }
}

/// Logs how many of these were late.
async fn warn_of_late(late: JoinHandle<usize>, what: &str) {
    if let Ok(count @ 1..) = late.await {
        warn!(count, "{what}");
    }
}

/// Closes the connection, on a thread of its own: it waits for every client and blocks its thread, and
/// a frozen client must delay neither timers nor the end of the process.
async fn close(connection: Connection) {
    let (closed, is_closed) = channel();
    thread::spawn(move || {
        drop(connection);
        let _ = closed.send(());
    });
    let closing = move || is_closed.recv_timeout(SESSION_CLOSE_TIMEOUT);
    match spawn_blocking(closing).await {
        Ok(Ok(())) => {}
        Ok(Err(_)) => warn!("a client did not close its session in time"),
        failed => warn!(?failed, "failed to close the session"),
    }
}
