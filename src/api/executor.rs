//! Threads for work on files, which may take long: one for each kind of file.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::mpsc::{Sender, channel};
use std::thread;

use tracing::warn;

/// Work on `T`.
type Job<T> = Box<dyn FnOnce(&T) + Send>;

/// Executes jobs on a thread, in order. Clones share the thread.
pub struct Executor<T>(Sender<Job<T>>);

impl<T> Clone for Executor<T> {
    fn clone(&self) -> Self {
        Executor(self.0.clone())
    }
}

impl<T: Send + 'static> Executor<T> {
    /// Starts the thread; it ends when the last clone is dropped.
    ///
    /// # Errors
    ///
    /// When the system starts no thread.
    pub fn start(name: &str, files: T) -> std::io::Result<Self> {
        let (jobs, receiver) = channel::<Job<T>>();
        thread::Builder::new()
            .name(name.to_owned())
            .spawn(move || {
                while let Ok(job) = receiver.recv() {
                    if catch_unwind(AssertUnwindSafe(|| job(&files))).is_err() {
                        warn!("a defect: a job panicked");
                    }
                }
            })?;
        Ok(Executor(jobs))
    }

    /// Queues a job.
    pub fn submit(&self, job: impl FnOnce(&T) + Send + 'static) {
        // An error means that the daemon is stopping.
        let _ = self.0.send(Box::new(job));
    }
}
