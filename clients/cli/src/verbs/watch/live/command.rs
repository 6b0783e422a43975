//! What keys send to a swarm.

use jostle_proto::Reply;
use jostle_proto::verbs::{
    EmptyResult, IdsResult, InformArgs, PauseArgs, Return, RunArgs, RunResult, StepArgs, StepResult,
};

use crate::arguments::SendingArguments;
use crate::bus::Bus;
use crate::failure::Failure;
use crate::format;
use crate::verbs::place;

/// A command to a swarm.
#[derive(Clone, Debug, PartialEq)]
pub struct Command {
    /// Which.
    pub swarm: String,
    /// What it is to do.
    pub what: What,
}

/// What a swarm is to do.
#[derive(Clone, Debug, PartialEq)]
pub enum What {
    /// Run on at its rate.
    Run,
    /// Stand still.
    Pause,
    /// Take so many steps.
    Step(u64),
    /// Inform some.
    Inform(InformArgs),
}

impl Command {
    /// Sends it and returns what came of it, in words.
    ///
    /// # Errors
    ///
    /// Why nothing came of it.
    pub async fn send(&self, bus: &Bus) -> Result<String, Failure> {
        let (swarm, sending) = (&self.swarm, &SendingArguments::default());
        Ok(match &self.what {
            What::Run => {
                let args = RunArgs::default();
                let answer = bus.command(swarm, "run", &args, sending);
                let reply: Reply<RunResult> = answer.await?.read()?;
                format!("{swarm} runs, rate {}", format::rate(reply.result.rate))
            }
            What::Pause => {
                let answer = bus.command(swarm, "pause", &PauseArgs {}, sending);
                let reply: Reply<EmptyResult> = answer.await?.read()?;
                format!("{swarm} is {}", place(&reply))
            }
            What::Step(steps) => {
                let args = StepArgs {
                    steps: *steps,
                    return_: Return::None,
                };
                let answer = bus.command(swarm, "step", &args, sending);
                let reply: Reply<StepResult> = answer.await?.read()?;
                format!("{swarm} is {}", place(&reply))
            }
            What::Inform(args) => {
                let answer = bus.command(swarm, "inform", args, sending);
                let reply: Reply<IdsResult> = answer.await?.read()?;
                let (count, step) = (reply.result.ids.len() as u64, reply.step);
                let individuals = format::count(count, "individual");
                format!("informed {individuals} of {swarm} at step {step}")
            }
        })
    }
}
