//! The commands that keys send.

use jostle_client::Client;
use jostle_proto::verbs::{InformArgs, PauseArgs, Return, RunArgs, StepArgs};

use crate::failure::Failure;
use crate::format;

#[derive(Clone, Debug, PartialEq)]
pub struct Command {
    pub swarm: String,
    pub verb: Verb,
}

/// A verb with its arguments.
#[derive(Clone, Debug, PartialEq)]
pub enum Verb {
    /// `run`, at the rate it has.
    Run,
    /// `pause`.
    Pause,
    /// `step`.
    Step(u64),
    /// `inform`.
    Inform(InformArgs),
}

impl Command {
    /// Sends it and describes the outcome.
    pub async fn send(&self, client: &Client) -> Result<String, Failure> {
        let swarm = &self.swarm;
        Ok(match &self.verb {
            Verb::Run => {
                let reply = client.execute(swarm, &RunArgs::default()).await?;
                format!("{swarm} runs, rate {}", format::rate(reply.result.rate))
            }
            Verb::Pause => format::standing(&client.execute(swarm, &PauseArgs {}).await?),
            Verb::Step(steps) => {
                let args = StepArgs {
                    steps: *steps,
                    return_: Return::None,
                };
                format::standing(&client.execute(swarm, &args).await?)
            }
            Verb::Inform(args) => {
                let reply = client.execute(swarm, args).await?;
                let (count, step) = (reply.result.ids.len() as u64, reply.step);
                let individuals = format::count(count, "individual");
                format!("informed {individuals} of {swarm} at step {step}")
            }
        })
    }
}
