//! `restore`: a new swarm from a snapshot file.

use std::fs;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use jostle_proto::verbs::{CreateResult, RestoreArgs};
use jostle_proto::{Reply, Snapshot};

use crate::arguments::RestoreArguments;
use crate::context::Context;
use crate::failure::Failure;
use crate::verbs::create::describe_copy;

pub async fn restore(context: &Context, arguments: &RestoreArguments) -> Result<(), Failure> {
    let Context { client, output } = context;
    let RestoreArguments { file, name, sender } = arguments;
    let wrong = |problem: String| Failure::argument(file.display(), problem);
    let bytes = fs::read(file).map_err(|error| wrong(error.to_string()))?;
    let snapshot = Snapshot::from_file(&bytes).map_err(|error| {
        wrong(format!(
            "not a snapshot, or not all of one ({error}): `jostle snapshot` writes one"
        ))
    })?;
    let args = RestoreArgs {
        name: name.clone().unwrap_or(snapshot.swarm),
        snapshot: STANDARD.encode(&bytes),
    };
    let answer = client.command_node("restore", &args, sender).await?;
    output.reply(&answer, |reply: &Reply<CreateResult>| {
        describe_copy("restored", "", reply)
    })
}
