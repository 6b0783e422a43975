//! Waits for a condition of a swarm.

use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use jostle_proto::keys;
use zenoh::liveliness::LivelinessToken;

use crate::client::{Client, TIMEOUT_MARGIN, Target};
use crate::error::Error;
use crate::payload::Payload;
use crate::wait_numbers::WaitNumbers;

/// A wait for a condition, such as `order > 0.9 for 20`. It changes nothing, and the daemon forgets it shortly
/// after it is dropped or its process ends.
#[derive(Debug)]
pub struct ConditionWait {
    client: Client,
    swarm: String,
    condition: String,
    number: u64,
    id: String,
    _token: LivelinessToken,
}

impl Client {
    /// Begins a wait for a condition, which [`ConditionWait::query`] sends.
    ///
    /// Cancel safety: the wait has not begun; call it again.
    ///
    /// # Errors
    ///
    /// [`Error::Internal`] after the session was closed.
    pub async fn wait_for(&self, swarm: &str, condition: &str) -> Result<ConditionWait, Error> {
        let number = lock(&self.0.waits).take();
        let id = format!("{}-{number}", self.session().zid());
        let key = keys::wait_alive(self.prefix(), swarm, &id);
        let token = self.session().liveliness().declare_token(key).await;
        Ok(ConditionWait {
            client: self.clone(),
            swarm: swarm.to_owned(),
            condition: condition.to_owned(),
            number,
            id,
            _token: token.map_err(Error::internal)?,
        })
    }
}

impl ConditionWait {
    /// The status of the swarm once the condition holds, in the present state or after a later step, or once
    /// the swarm has faulted: look at its phase. The daemon holds the query for at most `held`, 30 s at most,
    /// and then rejects it with `deadline_exceeded`. Not retried: call it again within 10 s to continue, also
    /// after an error that a retry may resolve. A duration in the condition goes on, unless the daemon was
    /// not reachable meanwhile: then it starts again.
    ///
    /// Cancel safety: the wait remains, and a query within 10 s continues it.
    ///
    /// # Errors
    ///
    /// As [`Client::command`]; `resource_exhausted` if too many clients wait, or if the conditions for which
    /// they wait cost too much together.
    pub async fn query(&self, held: Duration) -> Result<Payload, Error> {
        let key = keys::get(self.client.prefix(), &self.swarm, "wait");
        let selector = format!(
            "{key}?condition={};id={};timeout_secs={}",
            self.condition,
            self.id,
            held.as_secs_f64()
        );
        let target = Target::Swarm(&self.swarm);
        self.client
            .query_once(target, &selector, None, held + TIMEOUT_MARGIN)
            .await
    }
}

/// A panic leaves the numbers as they are.
fn lock(numbers: &Mutex<WaitNumbers>) -> MutexGuard<'_, WaitNumbers> {
    numbers.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Drop for ConditionWait {
    fn drop(&mut self) {
        lock(&self.client.0.waits).give_back(self.number);
    }
}
