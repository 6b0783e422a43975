//! The options of the command line as those of the client.

use std::pin::pin;
use std::time::Duration;

use jostle_client::{Client, CommandOptions, ConnectOptions};
use tokio::time::sleep;

use crate::arguments::{GlobalArguments, SenderArguments, SendingArguments};
use crate::failure::Failure;
use crate::output::Output;

/// The longest wait for a daemon that is not there: `--timeout` of a verb that waits may be hours.
const MAX_WAIT: Duration = Duration::from_secs(60);
/// How long it waits before it prints that it waits.
const NOTE_DELAY: Duration = Duration::from_secs(1);

/// Connects, and notes if that takes long.
pub async fn connect(global: &GlobalArguments, output: Output) -> Result<Client, Failure> {
    let options = ConnectOptions::from(global);
    let endpoint = options.resolved_endpoint()?;
    let secs = options.wait.min(options.timeout).as_secs_f64();
    let mut connecting = pin!(Client::connect(options));
    tokio::select! {
        client = &mut connecting => return Ok(client?),
        () = sleep(NOTE_DELAY) => output.note(&format!(
            "waiting up to {secs} s for a daemon at {endpoint}; Ctrl-C ends"
        )),
    }
    Ok(connecting.await?)
}

impl From<&GlobalArguments> for ConnectOptions {
    fn from(global: &GlobalArguments) -> Self {
        ConnectOptions {
            endpoint: global.endpoint.clone(),
            credentials: global.credentials.clone(),
            node: global.node.clone(),
            prefix: global.prefix.clone(),
            timeout: Duration::from_secs_f64(global.timeout),
            wait: MAX_WAIT,
            ..ConnectOptions::default()
        }
    }
}

impl From<&SenderArguments> for CommandOptions {
    fn from(sender: &SenderArguments) -> Self {
        CommandOptions {
            request_id: sender.request_id.clone(),
            client: sender.client.clone(),
            ..Self::default()
        }
    }
}

impl From<&SendingArguments> for CommandOptions {
    fn from(sending: &SendingArguments) -> Self {
        CommandOptions {
            at_step: sending.at_step,
            expect_epoch: sending.expect_epoch,
            expect_step: sending.expect_step,
            ..(&sending.sender).into()
        }
    }
}
