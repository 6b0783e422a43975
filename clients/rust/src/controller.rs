//! A controller of a swarm in lock-step.

use std::time::Duration;

use jostle_proto::verbs::{
    AdvanceArgs, AdvanceResult, JoinArgs, JoinResult, LeaveArgs, Mode, Return, Select, SetPoints,
};
use jostle_proto::{ControllerList, ErrorCode, Reply, State, keys};
use serde_json::{Map, Value};
use zenoh::liveliness::LivelinessToken;

use crate::client::Client;
use crate::error::Error;
use crate::requests::CommandOptions;

/// A controller that has joined a swarm in lock-step: the swarm steps when every controller has
/// advanced.
///
/// It holds a liveliness token. If the process ends or the controller is dropped, the daemon removes
/// the controller, and the swarm does not wait for it.
///
/// # After an error
///
/// | error of [`advance`](Controller::advance) | cause | remedy |
/// |---|---|---|
/// | [`Error::Rejected`] with `deadline_exceeded`, [`Error::TimedOut`] | other controllers, or the steps, take longer than the timeout; the advance remains | call `advance` again, which replaces it while the swarm waits; `conflict` then means that the steps were taken: `sync` |
/// | [`Error::Rejected`] with `conflict` | the swarm stepped without this controller, which missed a deadline, or was reset; nothing has changed | `sync` |
/// | the same, again after `sync` | the swarm takes the steps of an earlier advance | wait, or `pause` the swarm, then `sync` |
/// | [`Error::Rejected`] with `not_found` | the controller was removed: it was late three times, or its connection was lost | `sync` joins again |
/// | [`Error::Rejected`] with `invalid_argument` on `set.ids` | an individual was removed from the swarm | `sync` updates [`ids`](Controller::ids) |
/// | another [`transient`](Error::is_transient) error | the daemon is unreachable | `sync` when it is back |
#[derive(Debug)]
pub struct Controller {
    client: Client,
    swarm: String,
    terms: JoinArgs,
    ids: Vec<u32>,
    step: u64,
    _token: LivelinessToken,
}

impl Client {
    /// Joins a swarm as a controller in lock-step; the result has the individuals that it steers.
    ///
    /// The mode in `args` has no effect: a [`Controller`] is always in lock-step. To put set-points
    /// while the swarm runs, send [`JoinArgs`] with [`Mode::FreeRunning`] by [`Client::execute`].
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
    /// # Errors
    ///
    /// As [`Client::command`]; see [After an error](Controller#after-an-error). A set-point that is
    /// not finite is rejected before anything is sent.
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
        let options = CommandOptions {
            expect_step: Some(self.step),
            timeout,
            ..CommandOptions::default()
        };
        let reply = self.client.command(&self.swarm, "advance", &args, options);
        let reply: Reply<AdvanceResult> = reply.await?.read()?;
        self.step = reply.step;
        let removed = &reply.result.news.removed;
        self.ids.retain(|id| !removed.contains(id));
        Ok(reply)
    }

    /// Resumes after an error, and returns the current state, whose step the next advance is for.
    /// If the controller has left, it joins again with those of its individuals that exist.
    ///
    /// # Errors
    ///
    /// As [`Client::command`]; the daemon rejects individuals that another controller steers now.
    pub async fn sync(&mut self) -> Result<State, Error> {
        let list = self.client.get(&self.swarm, "controllers").await?;
        let list: Reply<ControllerList> = list.read()?;
        let mut listed = list.result.controllers.into_iter();
        let mut state: State = self.client.state(&self.swarm).await?.read()?;
        match listed.find(|it| it.controller == self.terms.controller) {
            Some(this) => self.ids = this.ids,
            None => {
                self.ids.retain(|id| state.id.contains(id));
                let args = JoinArgs {
                    select: (!self.ids.is_empty()).then(|| Select::Ids(self.ids.clone())),
                    again: true,
                    ..self.terms.clone()
                };
                self.ids = self.client.execute(&self.swarm, &args).await?.result.ids;
                state = self.client.state(&self.swarm).await?.read()?;
            }
        }
        self.step = state.step;
        Ok(state)
    }

    /// Leaves the swarm.
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
