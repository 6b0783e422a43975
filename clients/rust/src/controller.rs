//! A controller of a swarm in lock-step.

use std::collections::VecDeque;
use std::time::Duration;

use jostle_proto::verbs::{
    AdvanceArgs, AdvanceResult, JoinArgs, JoinResult, LeaveArgs, Mode, Return, Select, SetPoints,
};
use jostle_proto::{ControllerList, ErrorCode, Reply, State, keys};
use serde_json::value::{RawValue, to_raw_value};
use serde_json::{Map, Value};
use zenoh::liveliness::LivelinessToken;

use crate::client::Client;
use crate::error::Error;
use crate::requests::CommandOptions;

/// Advances that a crash of the daemon may take back. They are dropped when they are durable, a few
/// milliseconds later, so that there are this many only if the daemon's disk is full.
const MAX_UNSAVED: usize = 10_000;

/// A controller that has joined a swarm in lock-step: the swarm steps when every controller has
/// advanced.
///
/// It holds a liveliness token. If the process ends or the controller is dropped, the daemon removes
/// the controller, and the swarm does not wait for it.
///
/// After a restart of the daemon [`advance`](Controller::advance) continues: it sends the advances
/// again that a crash took back.
///
/// # After an error or a cancellation
///
/// A future of [`advance`](Controller::advance) that is dropped, such as by a timeout, leaves the
/// advance pending, as a `deadline_exceeded` does.
///
/// | outcome of [`advance`](Controller::advance) | cause | remedy |
/// |---|---|---|
/// | its future is dropped, [`Error::Rejected`] with `deadline_exceeded`, [`Error::TimedOut`], [`Error::NoDaemon`] | other controllers, the steps or an outage take longer; the advance remains, or was executed | the same call continues it, and returns its reply. A different `advance` replaces it while the swarm waits for another controller. [`cancel`](Controller::cancel) gives it up |
/// | [`Error::Rejected`] with `conflict` | the swarm stepped without this controller, which missed a deadline, was reset, or took the steps of an earlier advance; nothing has changed | `sync` |
/// | the same, again after `sync` | the swarm takes the steps of an earlier advance | wait, or `cancel` |
/// | [`Error::Rejected`] with `not_found` | the controller was removed: it was late three times, or its connection was lost | `sync` joins again |
/// | [`Error::Rejected`] with `invalid_argument` on `set.ids` | an individual was removed from the swarm | `sync` updates [`ids`](Controller::ids) |
#[derive(Debug)]
pub struct Controller {
    client: Client,
    swarm: String,
    terms: JoinArgs,
    ids: Vec<u32>,
    step: u64,
    /// The advance without a reply: its future may have been dropped.
    unacknowledged: Option<Advance>,
    /// The advances that are not durable yet, oldest first.
    unsaved: VecDeque<Unsaved>,
    _token: LivelinessToken,
}

/// An advance: its request id, the step it is for, and its arguments as JSON.
#[derive(Clone, Debug)]
struct Advance {
    request_id: String,
    step: u64,
    args: Box<RawValue>,
}

/// An advance that is not durable yet, and its result.
#[derive(Clone, Debug)]
struct Unsaved {
    advance: Advance,
    reached: u64,
    state_hash: String,
}

impl Client {
    /// Joins a swarm as a controller in lock-step; the result has the individuals that it steers.
    ///
    /// The mode in `args` has no effect: a [`Controller`] is always in lock-step. To put set-points
    /// while the swarm runs, send [`JoinArgs`] with [`Mode::FreeRunning`] by [`Client::execute`].
    ///
    /// Cancel safety: the controller may have joined; the daemon removes it, since its token is gone.
    ///
    /// # Errors
    ///
    /// As [`Client::command`]; the daemon rejects individuals that another controller steers.
    pub async fn join(
        &self,
        swarm: &str,
        args: JoinArgs,
    ) -> Result<(Controller, Reply<JoinResult>), Error> {
        let key = keys::ctl_alive(self.prefix(), swarm, &args.controller);
        let token = self.session().liveliness().declare_token(key).await;
        let token = token.map_err(Error::internal)?;
        let mode = Mode::Lockstep;
        let args = JoinArgs { mode, ..args };
        let reply = self.execute(swarm, &args).await?;
        let controller = Controller {
            client: self.clone(),
            swarm: swarm.to_owned(),
            terms: args,
            ids: reply.result.ids.clone(),
            step: reply.step,
            unacknowledged: None,
            unsaved: VecDeque::new(),
            _token: token,
        };
        Ok((controller, reply))
    }
}

impl Controller {
    /// The step of the swarm in the last reply.
    pub fn step(&self) -> u64 {
        self.step
    }

    /// The individuals that it steers, by id, without those that the last reply reports as removed.
    pub fn ids(&self) -> &[u32] {
        &self.ids
    }

    /// Sets set-points, if any, and permits so many steps; returns after them, with the state if
    /// requested. It may take the timeout of the client.
    ///
    /// Cancel safety: the advance remains, and the same call continues it; see [After an error or a
    /// cancellation](Controller#after-an-error-or-a-cancellation).
    ///
    /// # Errors
    ///
    /// As [`Client::command`]; see [After an error or a
    /// cancellation](Controller#after-an-error-or-a-cancellation). A set-point that is not finite is
    /// rejected before anything is sent. `conflict` also if the reply with the state was lost, the
    /// daemon sent it again without (it stores replies of at most 4 KiB), and the swarm has changed.
    pub async fn advance(
        &mut self,
        steps: u64,
        set: Option<SetPoints>,
        return_: Return,
    ) -> Result<Reply<AdvanceResult>, Error> {
        self.send(steps, set, return_, None).await
    }

    /// [`advance`](Controller::advance) that may take `timeout`, at most an hour.
    ///
    /// Cancel safety: as [`advance`](Controller::advance).
    ///
    /// # Errors
    ///
    /// As [`advance`](Controller::advance).
    pub async fn advance_within(
        &mut self,
        steps: u64,
        set: Option<SetPoints>,
        return_: Return,
        timeout: Duration,
    ) -> Result<Reply<AdvanceResult>, Error> {
        self.send(steps, set, return_, Some(timeout)).await
    }

    async fn send(
        &mut self,
        steps: u64,
        set: Option<SetPoints>,
        return_: Return,
        timeout: Option<Duration>,
    ) -> Result<Reply<AdvanceResult>, Error> {
        if let Some(set) = &set {
            check_finite(set)?;
        }
        let args = AdvanceArgs {
            controller: self.terms.controller.clone(),
            steps,
            set,
            return_,
        };
        let args = to_raw_value(&args).map_err(Error::internal)?;
        // A call that repeats an advance without a reply repeats its request id.
        let pending = self.unacknowledged.take();
        let same = pending.filter(|it| it.step == self.step && it.args.get() == args.get());
        let advance = same.unwrap_or_else(|| Advance {
            request_id: self.client.new_id(),
            step: self.step,
            args,
        });
        self.unacknowledged = Some(advance.clone());
        let mut reply = self.sent(&advance, timeout).await?;
        if return_ == Return::State && reply.result.state.is_none() {
            // The reply was lost, and the one that the daemon stored has no state. In lock-step the
            // swarm waits for this controller.
            reply.result.state = Some(self.state_of(&reply).await?);
        }
        // From here on nothing awaits: a dropped future has changed all of this or nothing.
        self.unacknowledged = None;
        self.step = reply.step;
        let result = &reply.result;
        self.ids.retain(|id| !result.news.removed.contains(id));
        let is_saved = |it: &Unsaved| it.reached <= result.durable_step;
        while self.unsaved.front().is_some_and(is_saved) {
            self.unsaved.pop_front();
        }
        if result.steps > 0 && reply.step > result.durable_step {
            if self.unsaved.len() == MAX_UNSAVED {
                self.unsaved.pop_front();
            }
            self.unsaved.push_back(Unsaved {
                advance,
                reached: reply.step,
                state_hash: result.state_hash.clone(),
            });
        }
        Ok(reply)
    }

    /// Sends an advance until it is replied to, also by a restarted daemon.
    async fn sent(
        &mut self,
        advance: &Advance,
        timeout: Option<Duration>,
    ) -> Result<Reply<AdvanceResult>, Error> {
        // The connection by which the unsaved advances were sent again: once is enough.
        let mut resent = None;
        loop {
            let error = match self.sent_once(advance, timeout).await {
                Err(Error::Rejected(error)) if error.code == ErrorCode::Conflict => error,
                outcome => return outcome,
            };
            let is_behind = error.step.is_some_and(|step| step < self.step);
            let connection = Some(self.client.connections_lost());
            if !is_behind || self.unsaved.is_empty() || connection == resent {
                return Err(Error::Rejected(error));
            }
            resent = connection;
            self.catch_up(timeout).await?;
        }
    }

    /// Sends the unsaved advances again after a crash of the daemon, which executes those that the
    /// crash took back, and repeats its reply to the others. All are kept until they are durable, since
    /// the daemon may crash again.
    async fn catch_up(&mut self, timeout: Option<Duration>) -> Result<(), Error> {
        for index in 0..self.unsaved.len() {
            let before = self.unsaved[index].clone();
            let reply = self.sent_once(&before.advance, timeout).await?;
            if reply.result.state_hash != before.state_hash {
                self.unsaved.clear();
                return Err(Error::rejected(jostle_proto::Error {
                    code: ErrorCode::Conflict,
                    message: format!(
                        "the daemon was restarted, and the other controllers do not repeat their \
                         advances: step {} has another state now: `sync` resumes",
                        before.reached
                    ),
                    details: Map::new(),
                    step: Some(reply.step),
                }));
            }
        }
        Ok(())
    }

    async fn sent_once(
        &self,
        advance: &Advance,
        timeout: Option<Duration>,
    ) -> Result<Reply<AdvanceResult>, Error> {
        let options = CommandOptions {
            expect_step: Some(advance.step),
            request_id: Some(advance.request_id.clone()),
            timeout,
            ..CommandOptions::default()
        };
        let reply = self
            .client
            .command(&self.swarm, "advance", &advance.args, options);
        reply.await?.read()
    }

    /// The state that an advance reached, if the swarm is still in it.
    async fn state_of(&self, reply: &Reply<AdvanceResult>) -> Result<State, Error> {
        let state: State = self.client.state(&self.swarm).await?.read()?;
        let status = self.client.status(&self.swarm).await?;
        let is_same = state.step == reply.step
            && status.step == reply.step
            && status.result.state_hash == reply.result.state_hash;
        if is_same {
            return Ok(state);
        }
        Err(Error::rejected(jostle_proto::Error {
            code: ErrorCode::Conflict,
            message: format!(
                "the advance was executed and led to step {}, but its reply with the state was lost, \
                 and the swarm has changed since: it is at step {}: `sync` resumes",
                reply.step, status.step
            ),
            details: Map::new(),
            step: Some(status.step),
        }))
    }

    /// Gives up the advance that has no reply, and returns the current state, whose step the next
    /// advance is for. The swarm takes no further steps for that advance, and waits for this controller
    /// again; the steps that it has taken and the set-points remain. Without such an advance it is
    /// [`sync`](Controller::sync).
    ///
    /// Cancel safety: call it again.
    ///
    /// # Errors
    ///
    /// As [`sync`](Controller::sync).
    pub async fn cancel(&mut self) -> Result<State, Error> {
        let (this, step) = self.listed().await?;
        let is_pending =
            |this: &jostle_proto::Controller| this.target_step.is_some_and(|it| it > step);
        if this.is_some_and(|this| is_pending(&this) || self.unacknowledged.is_some()) {
            // A controller that joins again keeps its individuals, and has not advanced.
            let args = JoinArgs {
                select: None,
                again: true,
                ..self.terms.clone()
            };
            self.client.execute(&self.swarm, &args).await?;
        }
        self.sync().await
    }

    /// Resumes after an error, and returns the current state, whose step the next advance is for.
    /// If the controller has left, it joins again with those of its individuals that exist.
    ///
    /// Cancel safety: call it again.
    ///
    /// # Errors
    ///
    /// As [`Client::command`]; the daemon rejects individuals that another controller steers now.
    pub async fn sync(&mut self) -> Result<State, Error> {
        let (this, _) = self.listed().await?;
        let mut state: State = self.client.state(&self.swarm).await?.read()?;
        self.ids = match this {
            Some(this) => this.ids,
            None => {
                let exists = |id: &u32| state.id.contains(id);
                let ids: Vec<u32> = self.ids.iter().copied().filter(exists).collect();
                let args = JoinArgs {
                    select: (!ids.is_empty()).then_some(Select::Ids(ids)),
                    again: true,
                    ..self.terms.clone()
                };
                let joined = self.client.execute(&self.swarm, &args).await?;
                state = self.client.state(&self.swarm).await?.read()?;
                joined.result.ids
            }
        };
        self.unacknowledged = None;
        self.unsaved.clear();
        self.step = state.step;
        Ok(state)
    }

    /// The daemon's record of this controller, `None` if it has left, and the step of the swarm.
    async fn listed(&self) -> Result<(Option<jostle_proto::Controller>, u64), Error> {
        let list = self.client.get(&self.swarm, "controllers").await?;
        let list: Reply<ControllerList> = list.read()?;
        let mut listed = list.result.controllers.into_iter();
        let this = listed.find(|it| it.controller == self.terms.controller);
        Ok((this, list.step))
    }

    /// Leaves the swarm.
    ///
    /// Cancel safety: it leaves nevertheless, since its token is gone.
    ///
    /// # Errors
    ///
    /// As [`Client::command`].
    pub async fn leave(self) -> Result<(), Error> {
        let controller = self.terms.controller.clone();
        let args = LeaveArgs { controller };
        self.client.execute(&self.swarm, &args).await?;
        Ok(())
    }
}

/// Rejects numbers that JSON does not have: it would send them as `null`, which for some columns is
/// the value of the model.
fn check_finite(set: &SetPoints) -> Result<(), Error> {
    let given = |column: &Option<Vec<f64>>| column.iter().flatten().copied().collect();
    let driven = |column: &Option<Vec<Option<f64>>>| {
        let values = column.iter().flatten();
        values.map(|it| it.unwrap_or_default()).collect()
    };
    let columns: [(&str, Vec<f64>); 4] = [
        ("direction", set.direction.clone()),
        ("weight", given(&set.weight)),
        ("turn", driven(&set.turn)),
        ("speed", driven(&set.speed)),
    ];
    for (name, column) in columns {
        if let Some(index) = column.iter().position(|value| !value.is_finite()) {
            let field = format!("set.{name}");
            return Err(Error::rejected(jostle_proto::Error {
                code: ErrorCode::InvalidArgument,
                message: format!("{field}[{index}] is not finite: give a finite number"),
                details: Map::from_iter([("field".to_owned(), Value::from(field))]),
                step: None,
            }));
        }
    }
    Ok(())
}
