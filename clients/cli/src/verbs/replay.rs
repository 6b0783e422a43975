//! `replay` and `seek`: a recording shown as if it were a swarm.

use std::fs::File;
use std::io::{ErrorKind, Read};
use std::path::Path;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use jostle_proto::verbs::{DeleteArgs, EmptyResult, RunArgs, RunResult};
use jostle_proto::{
    NodeReply, OpenArgs, Replay, ReplayArgs, ReplayResult, Reply, SeekArgs, UploadArgs, keys,
};
use jostle_results::recording::{self, PARTIAL};

use crate::arguments::{ReplayArguments, SeekArguments, SenderArguments, SendingArguments};
use crate::bus::Bus;
use crate::failure::Failure;
use crate::format;
use crate::output::Output;
use crate::values::Rate;
use crate::verbs::record::check_fetched;
use crate::verbs::{place, print};

/// A piece of a file, in bytes: in base64 it passes every daemon's limit.
const PIECE: usize = 180 * 1024;

/// Shows a recording.
///
/// # Errors
///
/// Why it is not shown.
pub async fn replay(bus: &Bus, output: Output, arguments: &ReplayArguments) -> Result<(), Failure> {
    if let Some(file) = &arguments.file {
        check_finished(file)?;
    }
    let name = name(arguments)?;
    // A request has its name alone; the one that begins the replay has the name given.
    let unnamed = SenderArguments {
        request_id: None,
        ..arguments.sender.clone()
    };
    if let Some(file) = &arguments.file {
        upload(bus, output, file, &name, &unnamed).await?;
    }
    let open = ReplayArgs::Open(OpenArgs {
        name: name.clone(),
        recording: arguments.recording.clone(),
    });
    let answer = bus.command_node("replay", &open, &arguments.sender).await?;
    let opened: NodeReply<ReplayResult> = answer.read()?;
    let mut rate = None;
    if !arguments.paused {
        let args = RunArgs {
            rate: arguments.rate.map(|Rate(rate)| rate),
            ..RunArgs::default()
        };
        let sending = SendingArguments {
            sender: unnamed,
            ..SendingArguments::default()
        };
        let answer = match bus.command(&name, "run", &args, &sending).await {
            Ok(answer) => answer,
            Err(failure) => {
                // Nothing is left of what was not done.
                let _ = bus.command(&name, "delete", &DeleteArgs {}, &sending).await;
                return Err(failure);
            }
        };
        let reply: Reply<RunResult> = answer.read()?;
        rate = Some(reply.result.rate);
    }
    print(output, &answer, |_: &NodeReply<ReplayResult>| {
        tell(&name, opened.result.replay.as_ref(), rate)
    })
}

/// Has a replay go somewhere.
///
/// # Errors
///
/// Why it does not go there.
pub async fn seek(bus: &Bus, output: Output, arguments: &SeekArguments) -> Result<(), Failure> {
    let place_ = &arguments.place;
    let args = SeekArgs {
        step: place_.step,
        time: place_.time,
        fraction: place_.fraction,
    };
    let sending = SendingArguments {
        sender: arguments.sender.clone(),
        ..SendingArguments::default()
    };
    let answer = bus
        .command(&arguments.name, "seek", &args, &sending)
        .await?;
    print(output, &answer, |reply: &Reply<EmptyResult>| {
        format!("{} is {}", reply.swarm, place(reply))
    })
}

/// What it is to be called.
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
    Err(Failure::Argument {
        argument: file.display().to_string(),
        problem: "its name cannot be a swarm's: say what to show it as with --as NAME".into(),
    })
}

/// Refuses a recording that has no end, with the command that makes a whole file of it.
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
    Err(Failure::Argument {
        problem: format!(
            "is incomplete: its recorder was killed or is still running; if it was killed, \
             `jostle record --recover {file}` recovers it"
        ),
        argument: file,
    })
}

/// Sends a file to the daemon, piece by piece.
async fn upload(
    bus: &Bus,
    output: Output,
    path: &Path,
    name: &str,
    sender: &SenderArguments,
) -> Result<(), Failure> {
    let wrong = |problem: &str| Failure::Argument {
        argument: path.display().to_string(),
        problem: problem.to_owned(),
    };
    if path.extension().is_some_and(|it| it == "parquet") {
        return Err(wrong(
            "is Parquet, which is for data frames: record to .mcap what is to be replayed",
        ));
    }
    let unreadable = |error: std::io::Error| match error.kind() {
        ErrorKind::NotFound => wrong("is not there"),
        _ => wrong(&error.to_string()),
    };
    let metadata = path.metadata().map_err(unreadable)?;
    if !metadata.is_file() {
        return Err(wrong("is no file"));
    }
    let length = metadata.len();
    let mut file = File::open(path).map_err(unreadable)?;
    let bar = bar(output, length, name);
    let (mut piece, mut offset) = (vec![0; PIECE], 0);
    loop {
        let bytes = fill(&mut file, &mut piece).map_err(unreadable)?;
        let args = ReplayArgs::Upload(UploadArgs {
            name: name.to_owned(),
            offset,
            length,
            bytes: STANDARD.encode(&piece[..bytes]),
        });
        bus.command_node("replay", &args, sender).await?;
        offset += bytes as u64;
        bar.set_position(offset);
        if offset >= length || bytes == 0 {
            bar.finish_and_clear();
            return Ok(());
        }
    }
}

/// Reads until the piece is full or the file at its end.
fn fill(file: &mut File, piece: &mut [u8]) -> std::io::Result<usize> {
    let mut filled = 0;
    while filled < piece.len() {
        match file.read(&mut piece[filled..]) {
            Ok(0) => break,
            Ok(bytes) => filled += bytes,
            Err(error) if error.kind() == ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
    Ok(filled)
}

fn tell(name: &str, replay: Option<&Replay>, rate: Option<Option<f64>>) -> String {
    let Some(replay) = replay else {
        return format!("{name} is shown");
    };
    let goes = match rate {
        Some(rate) => format!("runs at rate {}", format::rate(rate)),
        None => "is paused at its first frame".to_owned(),
    };
    format!(
        "{name} replays {}, {} over {} of time, and {goes}\n`jostle watch {name}` shows it, \
         `jostle seek {name} --time T` goes elsewhere, `jostle delete {name}` ends it",
        replay.of,
        format::count(replay.frames, "frame"),
        format::time(replay.duration)
    )
}

/// How much of the file is sent; hidden unless stderr is a terminal.
fn bar(output: Output, bytes: u64, name: &str) -> ProgressBar {
    if output.json {
        return ProgressBar::hidden();
    }
    let bar = ProgressBar::with_draw_target(Some(bytes), ProgressDrawTarget::stderr());
    let template = "{prefix} {bar:20} {percent:>3}%  {bytes} of {total_bytes} {eta} left";
    bar.set_style(ProgressStyle::with_template(template).expect("a constant"));
    bar.set_prefix(name.to_owned());
    bar
}
