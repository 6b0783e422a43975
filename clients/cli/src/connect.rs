//! The options of the command line as those of the client.

use jostle_client::{CommandOptions, ConnectOptions};

use crate::arguments::{GlobalArguments, SenderArguments, SendingArguments};

impl From<&GlobalArguments> for ConnectOptions {
    fn from(global: &GlobalArguments) -> Self {
        ConnectOptions {
            endpoint: global.endpoint.clone(),
            credentials: global.credentials.clone(),
            node: global.node.clone(),
            prefix: global.prefix.clone(),
            timeout: std::time::Duration::from_secs_f64(global.timeout),
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
