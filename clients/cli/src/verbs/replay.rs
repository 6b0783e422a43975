//! `replay` and `seek`: playback of a recording as a swarm.

use std::fs::File;
use std::io::{ErrorKind, Read};
use std::path::Path;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use jostle_proto::verbs::{DeleteArgs, EmptyResult, RunArgs, RunResult};
use jostle_proto::{
    NodeReply, OpenArgs, Replay, ReplayArgs, ReplayResult, Reply, SeekArgs, UploadArgs, keys,
};
use jostle_results::recording::{self, PARTIAL};

use crate::arguments::{ReplayArguments, SeekArguments, SenderArguments};
use crate::context::Context;
use crate::failure::Failure;
use crate::format;
use crate::progress;
use crate::values::Rate;
use crate::verbs::record::check_fetched;

/// The bytes of a file per message: in base64 below every daemon's limit.
const CHUNK: u64 = 180 * 1024;

pub async fn replay(context: &Context, arguments: &ReplayArguments) -> Result<(), Failure> {
    let Context { client, output } = context;
    if let Some(file) = &arguments.file {
        check_finished(file)?;
    }
    let name = name(arguments)?;
    // A request id is unique; the request that opens the playback has the one given.
    let unnamed = SenderArguments {
        request_id: None,
        ..arguments.sender.clone()
    };
    if let Some(file) = &arguments.file {
        upload(context, file, &name, &unnamed).await?;
    }
    let open = ReplayArgs::Open(OpenArgs {
        name: name.clone(),
        recording: arguments.recording.clone(),
    });
    let answer = client
        .command_node("replay", &open, &arguments.sender)
        .await?;
    let opened: NodeReply<ReplayResult> = answer.read()?;
    let mut rate = None;
    if !arguments.paused {
        let args = RunArgs {
            rate: arguments.rate.map(|Rate(rate)| rate),
            ..RunArgs::default()
        };
        let answer = match client.command(&name, "run", &args, &unnamed).await {
            Ok(answer) => answer,
            Err(error) => {
                // Deletes the playback that could not be started.
                let _ = client
                    .command(&name, "delete", &DeleteArgs {}, &unnamed)
                    .await;
                return Err(error.into());
            }
        };
        let reply: Reply<RunResult> = answer.read()?;
        rate = Some(reply.result.rate);
    }
    output.reply(&answer, |_: &NodeReply<ReplayResult>| {
        describe(&name, opened.result.replay.as_ref(), rate)
    })
}

pub async fn seek(context: &Context, arguments: &SeekArguments) -> Result<(), Failure> {
    let SeekArguments {
        name,
        place,
        sender,
    } = arguments;
    let args = SeekArgs {
        step: place.step,
        time: place.time,
        fraction: place.fraction,
    };
    let answer = context.client.command(name, "seek", &args, sender).await?;
    let describe = format::standing::<EmptyResult>;
    context.output.reply(&answer, describe)
}

fn name(arguments: &ReplayArguments) -> Result<String, Failure> {
    if let Some(name) = &arguments.name {
        return Ok(name.clone());
    }
    if let Some(recording) = &arguments.recording {
        return Ok(recording.clone());
    }
    let file = arguments.file.as_deref().unwrap_or(Path::new(""));
    let stem = file.file_stem().unwrap_or_default().to_string_lossy();
    let stem = stem.to_lowercase();
    if keys::is_name(&stem) {
        return Ok(stem);
    }
    Err(Failure::argument(
        file.display(),
        "its name is not a valid name of a swarm: name the playback with --as NAME",
    ))
}

/// Rejects an incomplete recording, with the command that recovers it.
fn check_finished(path: &Path) -> Result<(), Failure> {
    check_fetched(path)?;
    let partial = recording::partial(path);
    let is_partial = path.extension().is_some_and(|it| it == PARTIAL);
    let unfinished = if !path.exists() && partial.exists() {
        partial.as_path()
    } else if is_partial || (path.is_file() && recording::is_unfinished(path).unwrap_or(false)) {
        path
    } else {
        return Ok(());
    };
    let file = unfinished.display().to_string();
    Err(Failure::argument(
        &file,
        format!(
            "is incomplete: its recorder was killed or is still running; if it was killed, \
             `jostle record --recover {file}` recovers it"
        ),
    ))
}

/// Sends a file to the daemon in pieces.
async fn upload(
    context: &Context,
    path: &Path,
    name: &str,
    sender: &SenderArguments,
) -> Result<(), Failure> {
    let wrong = |problem: &str| Failure::argument(path.display(), problem.to_owned());
    if path.extension().is_some_and(|it| it == "parquet") {
        return Err(wrong(
            "is Parquet, which is for data frames: record to .mcap to replay it",
        ));
    }
    let unreadable = |error: std::io::Error| match error.kind() {
        ErrorKind::NotFound => wrong("does not exist"),
        _ => wrong(&error.to_string()),
    };
    let metadata = path.metadata().map_err(unreadable)?;
    if !metadata.is_file() {
        return Err(wrong("is not a file"));
    }
    let length = metadata.len();
    let mut file = File::open(path).map_err(unreadable)?;
    let template = "{prefix} {bar:20} {percent:>3}%  {bytes} of {total_bytes} {eta} left";
    let bar = progress::bar(context.output, Some(length), template, name);
    let mut offset = 0;
    loop {
        let mut chunk = Vec::new();
        let read = (&mut file).take(CHUNK).read_to_end(&mut chunk);
        let bytes = read.map_err(unreadable)? as u64;
        let args = ReplayArgs::Upload(UploadArgs {
            name: name.to_owned(),
            offset,
            length,
            bytes: STANDARD.encode(&chunk),
        });
        let client = &context.client;
        client.command_node("replay", &args, sender).await?;
        offset += bytes;
        bar.set_position(offset);
        if offset >= length || bytes == 0 {
            bar.finish_and_clear();
            return Ok(());
        }
    }
}

fn describe(name: &str, replay: Option<&Replay>, rate: Option<Option<f64>>) -> String {
    let Some(replay) = replay else {
        return format!("{name} is playing");
    };
    let goes = match rate {
        Some(rate) => format!("runs at rate {}", format::rate(rate)),
        None => "is paused at its first frame".to_owned(),
    };
    format!(
        "{name} replays {}, {} over {} of time, and {goes}\n`jostle watch {name}` shows it, \
         `jostle seek {name} --time T` moves it, `jostle delete {name}` ends it",
        replay.of,
        format::count(replay.frames, "frame"),
        format::time(replay.duration)
    )
}
