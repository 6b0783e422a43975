//! What verbs work with: the connection to a daemon and the output.

use jostle_client::{Client, Command};
use jostle_proto::Reply;

use crate::arguments::{CommandArguments, SendingArguments};
use crate::failure::Failure;
use crate::output::Output;

pub struct Context {
    pub client: Client,
    pub output: Output,
}

impl Context {
    /// Sends a command to a swarm, and prints the outcome as JSON, as scheduled, or as `describe`
    /// formats it.
    pub async fn execute<C: Command>(
        &self,
        CommandArguments { name, sending }: &CommandArguments,
        args: &C,
        describe: impl FnOnce(&Reply<C::Result>) -> String,
    ) -> Result<(), Failure> {
        self.send(name, sending, args, describe).await
    }

    /// As [`Context::execute`].
    pub async fn send<C: Command>(
        &self,
        swarm: &str,
        sending: &SendingArguments,
        args: &C,
        describe: impl FnOnce(&Reply<C::Result>) -> String,
    ) -> Result<(), Failure> {
        let reply = self
            .client
            .command(swarm, C::VERB.name(), args, sending)
            .await?;
        self.output.outcome(&reply, C::VERB.name(), describe)
    }
}
